"""Networks by onnxruntime, OpenVINO (if installed) and LiteRT.

onnxruntime's threads sleep instead of spinning, and ONNX networks run without their decoding head.
"""

import importlib.util
import io
import logging
import re
import sys
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.model_files import onnx_options
from caris_desktop.domain.onnx_graph import cut_graph, describe
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.yaml_files import YamlSourceError, parse_yaml
from caris_desktop.perception.backends.network import (
    BINS,
    ModelFacts,
    Network,
    UnknownFormError,
    facts_of,
    parsed_metadata,
)
from caris_desktop.perception.inference_messages import Device
from caris_desktop.perception.weights import Weights, WeightsError

log = logging.getLogger(__name__)

# Detection head of YOLOv8, 9 and 11 before box decoding: (1, 4 * bins + classes, anchors).
_RAW_HEAD = re.compile(r"/model\.\d+/Concat_3_output_0")
_CUDA, _CPU = "CUDAExecutionProvider", "CPUExecutionProvider"


def open_network(weights: Weights, *, threads: int, device: Device) -> Network | None:
    """Network of a file by the thinnest runtime; None for other formats. Raises WeightsError without the runtime."""
    path, suffix = weights.path, weights.path.suffix.lower()
    if suffix == ".onnx":
        return OnnxNetwork(path, threads=threads, device=device)
    if suffix == ".tflite":
        return TfliteNetwork(path, threads=threads)
    if suffix != ".xml" and not path.is_dir():
        return None
    if openvino_installed():
        return OpenvinoNetwork(path, threads=threads)
    raise WeightsError(
        localized(QT_TR_NOOP("The detector {name} needs OpenVINO, which is not installed"), name=path.name),
        searched=(str(path),),
        advice=QT_TR_NOOP("Run: pip install openvino, or choose an .onnx file"),
    )


class OnnxNetwork:
    """``Network`` by onnxruntime. An export for a single input size is opened for any size if its head is known.

    Raises UnknownFormError, and what onnxruntime raises for a bad file.
    """

    channels_last = False
    relative = False

    def __init__(self, path: Path, *, threads: int, device: str = "cpu") -> None:
        import onnxruntime

        options = onnx_options(threads)
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


def openvino_installed() -> bool:
    return importlib.util.find_spec("openvino") is not None


def network_file(path: Path) -> Path:
    """Graph file in an OpenVINO export folder. Raises FileNotFoundError."""
    if path.is_dir():
        found = sorted(path.glob("*.xml"))
        if not found:
            raise FileNotFoundError(f"no .xml file in {path}")
        return found[0]
    return path


class OpenvinoNetwork:
    """``Network`` by OpenVINO, from a folder in its format or an ONNX file.

    Raises UnknownFormError, and what OpenVINO raises for a bad file.
    """

    channels_last = False
    relative = False

    def __init__(self, path: Path, *, threads: int) -> None:
        # A placeholder module makes OpenVINO use its telemetry stub.
        sys.modules.setdefault("openvino_telemetry", cast(Any, None))
        import openvino

        core = openvino.Core()
        file = network_file(path)
        if file.suffix == ".onnx":
            # OpenVINO reads an ONNX file without its metadata.
            content = file.read_bytes()
            model, facts = _read_onnx(core, content), facts_of(describe(content).metadata)
        else:
            model, facts = core.read_model(str(file)), facts_of(_metadata_alongside(file))
        if len(model.inputs) != 1 or len(model.input().get_partial_shape()) != 4:
            raise UnknownFormError(QT_TR_NOOP("its input is not a single image"))
        undecoded = facts.undecoded or model.output().get_partial_shape()[1] == 4 * BINS + len(facts.class_names)
        self.facts: ModelFacts = replace(facts, undecoded=undecoded and bool(facts.class_names))
        _, _, height, width = model.input().get_partial_shape()
        fixed = height.is_static and width.is_static
        self.fixed_size: tuple[int, int] | None = (height.get_length(), width.get_length()) if fixed else None
        self._compiled = core.compile_model(
            model, "CPU", {"PERFORMANCE_HINT": "LATENCY", "INFERENCE_NUM_THREADS": threads, "ENABLE_CPU_PINNING": False}
        )
        self.runtime = "OpenVINO on CPU"

    def run(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(self._compiled(values)[0], np.float32)


def _read_onnx(core: Any, content: bytes) -> Any:
    """Network for input of any size, if its head is known."""
    cut = without_decoding(content)
    if cut is not None:
        try:
            return core.read_model(io.BytesIO(cut))
        except RuntimeError as error:
            log.info("the network keeps the input size that it was exported for: %s", error)
    return core.read_model(io.BytesIO(content))


def _metadata_alongside(file: Path) -> Mapping[str, object]:
    try:
        found = parse_yaml((file.parent / "metadata.yaml").read_text(encoding="utf-8")).data
    except (OSError, YamlSourceError, UnicodeDecodeError):
        return {}
    return found if isinstance(found, dict) else {}


_WHOLE = (np.dtype(np.int8), np.dtype(np.uint8), np.dtype(np.int16))


class TfliteNetwork:
    """``Network`` of TensorFlow Lite (float or int8) by LiteRT.

    Raises UnknownFormError, and what LiteRT raises for a bad file.
    """

    def __init__(self, path: Path, *, threads: int) -> None:
        from ai_edge_litert.interpreter import Interpreter

        self._interpreter: Any = Interpreter(str(path), num_threads=threads)
        self._interpreter.allocate_tensors()
        (self._input, *more) = self._interpreter.get_input_details()
        if more or len(self._input["shape"]) != 4:
            raise UnknownFormError(QT_TR_NOOP("its input is not a single image"))
        self._given = self._interpreter.get_output_details()[0]
        self.runtime = "LiteRT on CPU"
        self.facts: ModelFacts = facts_of(metadata_of(path))
        shape = [int(side) for side in self._input["shape"]]
        self.channels_last = shape[3] == 3
        self.fixed_size: tuple[int, int] | None = (shape[1], shape[2]) if self.channels_last else (shape[2], shape[3])
        # As in ultralytics: relative coordinates, except for boxes of a channels-first network with built-in
        # suppression.
        chosen = int(self._given["shape"][-1]) == 6 + self.facts.keypoint_values
        self.relative = self.channels_last or not chosen

    def run(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        if self._input["dtype"] in _WHOLE:
            limits = np.iinfo(self._input["dtype"])
            scale, zero = self._input["quantization"]
            values = np.rint(values / scale + zero).clip(limits.min, limits.max).astype(self._input["dtype"])
        self._interpreter.set_tensor(self._input["index"], values)
        self._interpreter.invoke()
        output = self._interpreter.get_tensor(self._given["index"])
        if self._given["dtype"] in _WHOLE:
            scale, zero = self._given["quantization"]
            output = (output.astype(np.float32) - zero) * scale
        result: NDArray[np.float32] = output.astype(np.float32, copy=False)
        return result


_MAX_METADATA_BYTES = 1 << 20  # a class name has some ten


def metadata_of(path: Path) -> Mapping[str, object]:
    """Metadata that ultralytics appended to the file as a zip archive; empty if there is none."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            with archive.open("metadata.json" if "metadata.json" in names else names[0]) as file:
                text = file.read(_MAX_METADATA_BYTES).decode()
    except (zipfile.BadZipFile, OSError, IndexError, UnicodeDecodeError):
        return {}
    found = parsed_metadata(text)
    return found if isinstance(found, dict) else {}
