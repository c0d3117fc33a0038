"""Faces for a network in ArcFace's form: aligned by eyes and nose, or estimated."""

import hashlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.domain.sensing import FrameRef
from caris_desktop.perception.appearance_embedding import EmbeddingModelError
from caris_desktop.perception.faces import FaceModel, StudyFaces, face_of
from caris_desktop.perception.inference_messages import DetectionRequest
from caris_desktop.perception.tracker import TrackedBox
from tests.perception.networks import colours_of_places

SECOND_NS = 1_000_000_000
BOX = TrackedBox(1, 100.0, 40.0, 120.0, 320.0, 0.9, 0, quality=0.8)
NOSE, LEFT_EYE, RIGHT_EYE = (160.0, 95.0), (175.0, 80.0), (145.0, 80.0)


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("models") / "face.onnx"
    path.write_bytes(colours_of_places(height=112, width=112))
    return path


def frame(at_s: float = 1.0) -> FrameRef:
    return FrameRef(round(at_s * SECOND_NS), None, "front", "", 0, 1, 640, 480)


def keypoints(nose: tuple[float, float] = NOSE, *, visible: float = 0.9) -> NDArray[np.float64]:
    points = np.zeros((17, 3))
    points[:3] = [(*nose, visible), (*LEFT_EYE, 0.9), (*RIGHT_EYE, 0.9)]
    return points


def picture_of(eyes: tuple[tuple[float, float], tuple[float, float]], nose: tuple[float, float]) -> NDArray[np.uint8]:
    """White at the eye on the image's left, red at the right one, green at the nose."""
    image = np.zeros((480, 640, 3), np.uint8)
    for (x, y), color in ((eyes[0], (255, 255, 255)), (eyes[1], (0, 0, 255)), (nose, (0, 255, 0))):
        cv2.circle(image, (round(x), round(y)), 4, color, -1)
    return image


def where(image_bgr: NDArray[np.uint8], color: tuple[int, int, int]) -> tuple[float, float]:
    far = np.abs(image_bgr.astype(int) - color).sum(axis=2) < 200
    y, x = np.nonzero(far)
    return float(x.mean()), float(y.mean())


@pytest.mark.parametrize("tilt_deg", [0.0, 25.0, -40.0])
def test_eyes_and_nose_come_to_where_such_networks_expect_them(tilt_deg: float) -> None:
    turn = cv2.getRotationMatrix2D(NOSE, tilt_deg, 1.3)
    right, left, nose = (
        (float(x), float(y)) for x, y in (turn @ (*point, 1.0) for point in (RIGHT_EYE, LEFT_EYE, NOSE))
    )
    points = np.zeros((17, 3))
    points[:3] = [(*nose, 0.9), (*left, 0.9), (*right, 0.9)]
    face = face_of(picture_of((right, left), nose), BOX, points)
    assert face is not None and face.image_bgr.shape == (112, 112, 3)
    for color, place in (((255, 255, 255), (38.3, 51.7)), ((0, 0, 255), (73.5, 51.5)), ((0, 255, 0), (56.0, 71.7))):
        assert np.hypot(*np.subtract(where(face.image_bgr, color), place)) < 5.0


def test_a_person_who_turns_away_or_is_too_far_off_shows_no_face() -> None:
    image = np.zeros((480, 640, 3), np.uint8)
    assert face_of(image, BOX, keypoints(visible=0.2)) is None
    near = keypoints()
    near[2, :2] = near[1, :2] + (4.0, 0.0)
    assert face_of(image, BOX, near) is None
    small = TrackedBox(1, 100.0, 40.0, 40.0, 100.0, 0.9, 0, quality=0.8)
    assert face_of(image, small, None) is None


def test_without_keypoints_the_middle_of_the_head_has_to_do_and_is_worth_less() -> None:
    image = np.zeros((480, 640, 3), np.uint8)
    image[40:112, 124:196] = 255  # the upper end of the box, as wide as a head
    face = face_of(image, BOX, None)
    assert face is not None and face.image_bgr.mean() > 250
    known = face_of(image, BOX, keypoints())
    assert known is not None and face.quality < known.quality


def test_each_has_a_turn_and_nobody_more_than_two_a_second(network: Path) -> None:
    faces = StudyFaces(network)
    image = np.full((480, 640, 3), 128, np.uint8)
    boxes = [BOX, TrackedBox(2, 300.0, 40.0, 120.0, 320.0, 0.9, 1, quality=0.8)]
    requests = [DetectionRequest(frame(1.0 + number / 10), faces=True) for number in range(20)]
    told = [looks for request in requests for looks in faces.extract(image, request, boxes, None)]
    assert [looks.track for looks in told[:4]] == [1, 2, 1, 2]
    assert len(told) == 8
    assert {looks.kind for looks in told} == {"face"}
    assert told[0].vector.dtype == np.float32 and np.linalg.norm(told[0].vector) == pytest.approx(1.0, abs=1e-5)
    assert told[0].model.startswith("face-")


def test_no_face_is_looked_at_unless_the_scenario_says_so(network: Path) -> None:
    faces = StudyFaces(network)
    image = np.full((480, 640, 3), 128, np.uint8)
    assert faces.extract(image, DetectionRequest(frame()), [BOX], None) == []
    assert len(faces.extract(image, DetectionRequest(frame(), faces=True), [BOX], None)) == 1
    assert faces.extract(image, DetectionRequest(frame(9.0)), [BOX], None) == []
    assert (
        StudyFaces(network.with_name("none.onnx")).extract(image, DetectionRequest(frame(), faces=True), [BOX], None)
        == []
    )


@pytest.mark.parametrize(
    ("content", "checksum", "expected"),
    [
        (b"no network", None, "could not be loaded"),
        (colours_of_places(), None, "input is not 3 x 112 x 112"),
        (colours_of_places(height=112, width=112), "0" * 64, "does not match its checksum"),
    ],
)
def test_an_unusable_network_is_refused_once(
    tmp_path: Path, content: bytes, checksum: str | None, expected: str
) -> None:
    path = tmp_path / "face.onnx"
    path.write_bytes(content)
    if checksum is not None:
        (tmp_path / "face.onnx.sha256").write_text(f"{checksum}  face.onnx\n")
    faces, image = StudyFaces(path), np.zeros((480, 640, 3), np.uint8)
    with pytest.raises(EmbeddingModelError, match=expected):
        faces.extract(image, DetectionRequest(frame(), faces=True), [BOX], None)
    assert faces.extract(image, DetectionRequest(frame(2.0), faces=True), [BOX], None) == []


def test_the_right_checksum_is_no_obstacle(network: Path, tmp_path: Path) -> None:
    path = tmp_path / "face.onnx"
    path.write_bytes(network.read_bytes())
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    (tmp_path / "face.onnx.sha256").write_text(f"{digest}  face.onnx\n")
    assert FaceModel(path).name == f"face-{digest[:8]}"
