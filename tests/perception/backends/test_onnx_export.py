"""Export of ultralytics weights to equivalent ONNX networks: offline, without unneeded packages."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.perception.backends.runtime_selection import open_detector
from caris_desktop.perception.weights import Weights
from tests.perception.shared_data import bus_picture

pytestmark = pytest.mark.long  # three exports in a separate process take half a minute

# In a separate process, since ultralytics changes global state; it must not use the network.
_SCRIPT = """
import json, sys
from pathlib import Path

def refuse(event, arguments):
    if event in ("socket.getaddrinfo", "socket.connect"):
        raise OSError("no network in this test")

sys.addaudithook(refuse)
folder = Path(sys.argv[1])
from caris_desktop.perception.backends.ultralytics_runtime import ModelExportError, export_onnx
from caris_desktop.perception.backends.ultralytics_runtime import prepare_ultralytics
from caris_desktop.perception.weights import Weights
prepare_ultralytics(threads=1, cache_dir=folder)
import numpy as np, onnxruntime, torch
from caris_desktop.perception.backends.network import decode
from ultralytics import YOLO

for name in ("yolov8n", "yolov8n-pose", "yolov8n-cls"):
    torch.manual_seed(1)
    untrained = YOLO(f"{name}.yaml")
    if name == "yolov8n-pose":
        untrained.model.names = {0: "person"}
    if name == "yolov8n":
        untrained.model.names = {0: "person"} | {number: f"thing {number}" for number in range(1, 80)}
    path, target = folder / f"{name}.pt", folder / f"{name}.onnx"
    untrained.save(str(path))
    told = {"name": name}
    try:
        export_onnx(Weights(path, name, 640), target, threads=1)
        session = onnxruntime.InferenceSession(target, providers=["CPUExecutionProvider"])
        network = YOLO(str(path)).model.float().eval()
        told["differences"] = []
        for height, width in ((192, 256), (320, 224)):
            picture = torch.rand(1, 3, height, width)
            with torch.no_grad():
                expected = network(picture)[0].numpy()
            (found,) = session.run(None, {"images": picture.numpy()})
            if session.get_modelmeta().custom_metadata_map.get("caris_undecoded") == "true":
                found, told["undecoded"] = decode(found, (height, width), 1e-6), True
            told["differences"].append(float(np.abs(found - expected).max()))
            told["shape"] = [list(found.shape), list(expected.shape)]
    except ModelExportError as error:
        told["error"] = str(error)
    told["onnx"] = "onnx" in sys.modules
    print(json.dumps(told))
"""


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, dict[str, Any]]]:
    folder = tmp_path_factory.mktemp("exported")
    words = [sys.executable, "-c", _SCRIPT, str(folder)]
    finished = subprocess.run(words, capture_output=True, text=True, check=False)
    assert finished.returncode == 0, finished.stderr
    told = [json.loads(line) for line in finished.stdout.splitlines() if line.startswith("{")]
    return folder, {one["name"]: one for one in told}


@pytest.mark.parametrize("name", ["yolov8n", "yolov8n-pose"])
def test_an_exported_network_computes_the_same_for_pictures_of_any_size(
    exported: tuple[Path, dict[str, dict[str, Any]]], name: str
) -> None:
    told = exported[1][name]
    assert "error" not in told
    found, expected = told["shape"]
    assert found == expected
    assert max(told["differences"]) < 1e-2, "pixels"
    assert told.get("undecoded", False) == (name == "yolov8n"), "what decodes places that do not matter is left out"


def test_a_model_without_boxes_is_not_exported(exported: tuple[Path, dict[str, dict[str, Any]]]) -> None:
    folder, told = exported
    assert told["yolov8n-cls"]["error"] == "it is not a bounding-box detector"
    assert not (folder / "yolov8n-cls.onnx").exists()


def test_an_exported_detector_knows_its_classes(exported: tuple[Path, dict[str, dict[str, Any]]]) -> None:
    detector = open_detector(Weights(exported[0] / "yolov8n.onnx", "exported", 416), confidence=0.1, threads=1)
    assert detector.label == "exported, onnxruntime on CPU, 416 px"
    assert detector.class_names[:2] == ("person", "thing 1")
    assert len(detector.class_names) == 80
    assert detector.detect(bus_picture()).keypoints is None


def test_an_exported_pose_network_gives_each_person_17_points_in_the_picture(
    exported: tuple[Path, dict[str, dict[str, Any]]],
) -> None:
    # Untrained weights give equal confidence everywhere: all positions are detections.
    detector = open_detector(Weights(exported[0] / "yolov8n-pose.onnx", "pose", 416), confidence=0.0, threads=1)
    assert detector.class_names == ("person",)
    picture = bus_picture()
    found = detector.detect(picture)
    assert found.keypoints is not None
    assert found.keypoints.shape == (len(found.confidences), 17, 3)
    assert len(found.confidences) > 0
    assert ((found.keypoints[..., 2] >= 0) & (found.keypoints[..., 2] <= 1)).all()
