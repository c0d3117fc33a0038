"""ONNX networks by onnxruntime, with sleeping instead of spinning threads, and without their decoding head."""

import logging
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.onnx_graph import cut_graph, describe
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.perception.backends.network import ModelFacts, UnknownFormError, facts_of
from caris_desktop.perception.backends.outputs import BINS

log = logging.getLogger(__name__)

# Detection head of YOLOv8, 9 and 11 before box decoding: (1, 4 * bins + classes, anchors).
_RAW_HEAD = re.compile(r"/model\.\d+/Concat_3_output_0")
_CUDA, _CPU = "CUDAExecutionProvider", "CPUExecutionProvider"


def session_options(threads: int) -> Any:
    """Session options with a thread limit and no spinning, which delayed other processes on two
    cores by up to 11 ms.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3
    return options


class OnnxNetwork:
    """``Network`` by onnxruntime. An export for a single input size is opened for any size if its head is known.

    Raises UnknownFormError, and what onnxruntime raises for a bad file.
    """

    channels_last = False
    relative = False

    def __init__(self, path: Path, *, threads: int, device: str = "cpu") -> None:
        import onnxruntime

        options = session_options(threads)
        on_gpu = device in ("auto", "cuda") and _CUDA in onnxruntime.get_available_providers()
        content = path.read_bytes()
        # On a GPU, the exported size costs little.
        cut = None if on_gpu else _resizable(path, content, options)
        self._session = cut or onnxruntime.InferenceSession(
            content, options, providers=[_CUDA, _CPU] if on_gpu else [_CPU]
        )
        on_gpu = _CUDA in self._session.get_providers()
        (given, *more) = self._session.get_inputs()
        if more or given.type not in ("tensor(float)", "tensor(float16)") or len(given.shape) != 4:
            raise UnknownFormError(QT_TR_NOOP("its input is not a single image"))
        facts = facts_of(self._session.get_modelmeta().custom_metadata_map)
        self.facts: ModelFacts = facts if cut is None else replace(facts, undecoded=True)
        self.runtime = f"onnxruntime on {'CUDA' if on_gpu else 'CPU'}"
        self._input, self._type = given.name, np.float16 if given.type == "tensor(float16)" else np.float32
        height, width = given.shape[2:]
        fixed = isinstance(height, int) and isinstance(width, int)
        self.fixed_size: tuple[int, int] | None = (height, width) if fixed else None
        self._output = self._session.get_outputs()[0].name

    def run(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        (output,) = self._session.run([self._output], {self._input: values.astype(self._type, copy=False)})
        result: NDArray[np.float32] = output.astype(np.float32, copy=False)
        return result


def _resizable(path: Path, content: bytes, options: Any) -> Any:
    """Session without the last nodes, for input of any size; None if the head is unknown."""
    import onnxruntime

    cut = without_decoding(content)
    if cut is None:
        return None
    try:
        session = onnxruntime.InferenceSession(cut, options, providers=[_CPU])
    except Exception as error:  # onnxruntime raises its own types
        log.info("%s keeps the input size that it was exported for: %s", path.name, error)
        return None
    (shape,) = (output.shape for output in session.get_outputs())
    classes = len(facts_of(session.get_modelmeta().custom_metadata_map).class_names)
    return session if len(shape) == 3 and shape[1] == 4 * BINS + classes else None


def without_decoding(content: bytes) -> bytes | None:
    """ONNX network without the nodes that decode boxes, which fix its input size.

    None if the input size is dynamic already, the head is unknown, or it is not an ONNX network.
    """
    try:
        known = describe(content)
        heads = [name for name in known.tensors if _RAW_HEAD.fullmatch(name)]
        facts = facts_of(known.metadata)
        if len(heads) != 1 or None in known.input_dims[2:] or facts.keypoint_values or not facts.class_names:
            return None
        return cut_graph(content, output=heads[0], input_dims=(1, 3, "height", "width"))
    except ValueError:
        return None
