"""Networks by OpenVINO, if installed: folders in its format, or ONNX files."""

import importlib.util
import io
import logging
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.onnx_graph import describe
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.yaml_source import YamlSourceError, parse_yaml
from caris_desktop.perception.backends.network import ModelFacts, UnknownFormError, facts_of
from caris_desktop.perception.backends.onnx import without_decoding
from caris_desktop.perception.backends.outputs import BINS

log = logging.getLogger(__name__)


def is_installed() -> bool:
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
    """``Network`` by OpenVINO.

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
