"""Selection of the fastest equivalent runtime, with cached measurements."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.perception.backends import runtime_selection
from caris_desktop.perception.backends.runtime_selection import open_fastest
from caris_desktop.perception.detector import Detections
from caris_desktop.perception.weights import Weights, WeightsError

_PICTURES = [np.zeros((48, 64, 3), np.uint8)] * 2
_BOX = (10.0, 10.0, 30.0, 40.0)


@dataclass
class Fake:
    """Detector with one box and a simulated duration."""

    ms: float
    clock: list[int]
    label: str = "fake"
    corners: tuple[float, ...] = _BOX
    confidence: float = 0.8
    class_names: tuple[str, ...] = field(default=("person",))

    def detect(self, image_bgr: NDArray[np.uint8]) -> Detections:
        self.clock[0] += round(self.ms * 1e6)
        return Detections(np.array([self.corners]), np.array([self.confidence]), np.zeros(1, np.int64))


class Setup:
    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.weights = Weights(folder / "weights.pt", "weights", 416)
        self.weights.path.write_bytes(b"weights")
        self.cache = folder / "cache"
        self.clock = [0]
        self.opened: list[str] = []
        self.runtimes: dict[str, Fake | Exception] = {}
        monkeypatch.setattr(
            runtime_selection, "_openers", lambda *_, **__: {name: self._opener(name) for name in self.runtimes}
        )
        monkeypatch.setattr(runtime_selection.time, "perf_counter_ns", lambda: self.clock[0])

    def _opener(self, name: str) -> Any:
        def open_it() -> Fake:
            self.opened.append(name)
            made = self.runtimes[name]
            if isinstance(made, Exception):
                raise made
            return made

        return open_it

    def fake(self, ms: float, **changed: Any) -> Fake:
        return Fake(ms, self.clock, **changed)

    def open(self, threads: int = 1) -> str:
        for made in self.runtimes.values():
            if isinstance(made, Fake):
                made.label = "fake"
        self.opened.clear()
        return open_fastest(
            self.weights, confidence=0.1, threads=threads, cache_dir=self.cache, pictures=_PICTURES
        ).label


@pytest.fixture
def setup(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Setup:
    return Setup(tmp_path, monkeypatch)


def test_the_fastest_is_selected_and_reported(setup: Setup) -> None:
    setup.runtimes = {"torch": setup.fake(50), "onnxruntime": setup.fake(20), "OpenVINO": setup.fake(12)}
    assert setup.open() == "fake, 12 ms (torch 50 ms; onnxruntime 20 ms)"


@pytest.mark.parametrize(("torch_ms", "shown"), [(19, "20 ms (torch 19 ms)"), (10, "10 ms (onnxruntime 20 ms)")])
def test_torch_must_be_worth_its_start(setup: Setup, torch_ms: float, shown: str) -> None:
    setup.runtimes = {"torch": setup.fake(torch_ms), "onnxruntime": setup.fake(20)}
    assert setup.open() == f"fake, {shown}"


@pytest.mark.parametrize(
    "changed",
    [{"corners": (10.0, 10.0, 30.0, 36.0)}, {"confidence": 0.7}, {"corners": (50.0, 0.0, 60.0, 40.0)}],
    ids=["smaller", "less sure", "elsewhere"],
)
def test_one_that_finds_something_else_is_not_taken_however_fast(setup: Setup, changed: dict[str, Any]) -> None:
    setup.runtimes = {"torch": setup.fake(50), "onnxruntime": setup.fake(2, **changed)}
    assert setup.open() == "fake (onnxruntime: its detections differ)"


def test_without_a_runtime_nothing_is_exchanged(setup: Setup) -> None:
    setup.runtimes = {"torch": setup.fake(50, confidence=0.12), "onnxruntime": setup.fake(2, confidence=0.12)}
    assert "no people were detected in the comparison photos" in setup.open()


def test_one_that_cannot_be_opened_is_reported_and_the_other_runs(setup: Setup) -> None:
    setup.runtimes = {"torch": setup.fake(50), "onnxruntime": WeightsError("it cannot be exported (no room)")}
    assert setup.open() == "fake (onnxruntime: it cannot be exported (no room))"


def test_a_measurement_is_stored_until_something_changes(setup: Setup) -> None:
    setup.runtimes = {"torch": setup.fake(50), "onnxruntime": setup.fake(20)}
    first = setup.open()
    assert setup.opened == ["torch", "onnxruntime"]
    assert (setup.open(), setup.opened) == (first, ["onnxruntime"])
    setup.open(threads=2)
    assert setup.opened == ["torch", "onnxruntime"], "other circumstances"
    setup.weights.path.write_bytes(b"other weights")
    setup.open()
    assert setup.opened == ["torch", "onnxruntime"]


@pytest.mark.logs("does not open any more")
@pytest.mark.parametrize("content", ["", "[]", json.dumps({"runtime": "torch"}), json.dumps({"runtime": 3, "ms": []})])
def test_a_memory_that_is_broken_or_wrong_by_now_is_measured_again(setup: Setup, content: str) -> None:
    setup.runtimes = {"torch": setup.fake(50), "onnxruntime": setup.fake(20)}
    first = setup.open()
    (remembered,) = setup.cache.glob("*.json")
    remembered.write_text(content)
    assert setup.open() == first
    setup.runtimes = {"torch": setup.fake(50), "onnxruntime": WeightsError("the file has gone")}
    assert "the file has gone" in setup.open()


@pytest.mark.skipif(runtime_selection.openvino_installed(), reason="OpenVINO is compared with")
@pytest.mark.logs("could not load")
def test_other_files_are_opened_without_a_measurement(tmp_path: Path) -> None:
    path = tmp_path / "broken.onnx"
    path.write_bytes(b"nothing")
    with pytest.raises(WeightsError, match=r"broken\.onnx could not be loaded"):
        open_fastest(Weights(path, "broken", 416), confidence=0.1, threads=1, cache_dir=tmp_path / "cache")
    assert not (tmp_path / "cache").exists()
