"""Files that are not person detectors: a message with the file and advice for each."""

import hashlib
import os
import pickle
import zipfile
from pathlib import Path

import pytest

from caris_desktop.domain.onnx_graph import with_metadata
from caris_desktop.perception.backends.runtime_selection import open_chosen
from caris_desktop.perception.inference_messages import DetectorSettings
from caris_desktop.perception.weights import DetectorChoice, WeightsError
from tests.perception.shared_data import INT8_WEIGHTS, OSNET_WEIGHTS, YOLOX_WEIGHTS, needs_int8_weights

needs_yolox = pytest.mark.skipif(not YOLOX_WEIGHTS.is_file(), reason=f"needs {YOLOX_WEIGHTS}")


def refused(path: Path) -> WeightsError:
    with pytest.raises(WeightsError, match=path.name.replace(".", r"\.")) as caught:
        open_chosen(path, DetectorSettings(), confidence=0.1, threads=1, allow_download=False)
    assert caught.value.advice
    return caught.value


@pytest.mark.logs("could not load")
@pytest.mark.parametrize("part", [0.0, 0.001, 0.5, 0.99])
@pytest.mark.parametrize(
    "source", [pytest.param(YOLOX_WEIGHTS, marks=needs_yolox), INT8_WEIGHTS], ids=["onnx", "tflite"]
)
@needs_int8_weights
def test_a_truncated_model_is_reported(tmp_path: Path, source: Path, part: float) -> None:
    content = source.read_bytes()
    path = tmp_path / f"torn{source.suffix}"
    # The data that ultralytics appends to a .tflite file is not part of the network.
    path.write_bytes(content[: round(len(content) * part)])
    assert "could not be loaded" in str(refused(path))


@needs_yolox
def test_a_model_without_people_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "animals.onnx"
    names = repr({number: f"animal {number}" for number in range(80)})
    path.write_bytes(with_metadata(YOLOX_WEIGHTS.read_bytes(), {"names": names, "task": "detect"}))
    assert "does not detect people" in str(refused(path))


@pytest.mark.skipif(not OSNET_WEIGHTS.is_file(), reason=f"needs {OSNET_WEIGHTS}")
def test_a_network_for_something_else_is_reported() -> None:
    assert "is not a supported detector" in str(refused(OSNET_WEIGHTS))


def test_a_missing_model_is_reported(tmp_path: Path) -> None:
    assert "does not exist" in str(refused(tmp_path / "missing.onnx"))


@needs_yolox
def test_the_size_of_a_scenario_is_that_of_a_network_that_takes_any_and_of_no_other() -> None:
    settings = DetectorSettings(DetectorChoice(input_px=640))
    chosen = open_chosen(YOLOX_WEIGHTS, settings, confidence=0.1, threads=1, allow_download=False)
    assert "416x416 px" in chosen.detector.label
    assert chosen.people == (0,)
    assert chosen.folder == YOLOX_WEIGHTS.parent


class _Touch:
    """Unpickling it runs a command of its author."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, (f"touch {self.marker}",)


def _pickled(marker: Path, path: Path, form: str) -> None:
    content = {"model": _Touch(marker), "ema": None, "train_args": {}}
    if form == "zip":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("archive/data.pkl", pickle.dumps(content, protocol=2))
            archive.writestr("archive/version", "3")
    else:
        path.write_bytes(pickle.dumps(content, protocol=2))


@pytest.mark.logs("could not load")
@pytest.mark.parametrize("form", ["zip", "old"])
@pytest.mark.parametrize("name", ["model.pt", "model.PT"])
def test_a_scenario_that_vouches_for_its_own_pickle_runs_nothing(tmp_path: Path, name: str, form: str) -> None:
    path, marker = tmp_path / name, tmp_path / "it-ran"
    _pickled(marker, path, form)
    choice = DetectorChoice(str(path), hashlib.sha256(path.read_bytes()).hexdigest())
    with pytest.raises(WeightsError, match="could not be loaded"):
        open_chosen(None, DetectorSettings(choice), confidence=0.1, threads=1, allow_download=False)
    assert not marker.exists()


@pytest.mark.logs("could not load|brings code of its maker")
def test_the_user_s_own_file_may_bring_code_and_the_log_says_so(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path, marker = tmp_path / "own.pt", tmp_path / "it-ran"
    _pickled(marker, path, "old")
    refused(path)  # It is not a detector, but its code ran.
    assert marker.exists()
    assert "the command line names this file" in caplog.text
