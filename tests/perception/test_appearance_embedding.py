"""Appearance embeddings, and the best view of each person."""

import hashlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.domain.sensing import FrameRef
from caris_desktop.perception.appearance_embedding import AppearanceModel, EmbeddingModelError, find_appearance
from caris_desktop.perception.detector import Detections
from caris_desktop.perception.inference_messages import DetectionRequest
from caris_desktop.perception.kalman_tracker import LOST_S
from caris_desktop.perception.perceiver import PortraitTaker
from caris_desktop.perception.tracker import PersonTracker, TrackedBox
from tests.perception.networks import colours_of_places

Image = NDArray[np.uint8]
RED, BLUE, GREEN = (30, 30, 200), (200, 40, 30), (40, 180, 40)


@pytest.fixture
def model(tmp_path: Path) -> AppearanceModel:
    (tmp_path / "osnet_test.onnx").write_bytes(colours_of_places())
    return AppearanceModel(tmp_path / "osnet_test.onnx")


def picture(people: dict[int, tuple[int, int, int]]) -> tuple[Image, NDArray[np.float64]]:
    """People as coloured rectangles, by position; and their boxes."""
    image = np.full((480, 640, 3), 128, np.uint8)
    for left, colour in people.items():
        cv2.rectangle(image, (left, 150), (left + 80, 400), colour, -1)
    return image, np.array([[left, 150.0, left + 80.0, 400.0] for left in people]).reshape(-1, 4)


def test_the_same_clothes_are_near_and_others_far_wherever_they_stand(model: AppearanceModel) -> None:
    image, boxes = picture({50: RED, 200: BLUE, 400: RED})
    looks = model.embed(image, boxes)
    assert np.linalg.norm(looks, axis=1) == pytest.approx([1.0, 1.0, 1.0])
    assert looks[0] @ looks[2] == pytest.approx(1.0, abs=1e-6)
    assert looks[0] @ looks[1] < 0.5


def test_a_network_for_one_at_a_time_is_asked_one_by_one(tmp_path: Path, model: AppearanceModel) -> None:
    (tmp_path / "single.onnx").write_bytes(colours_of_places(batch=1))
    image, boxes = picture({50: RED, 200: BLUE})
    single = AppearanceModel(tmp_path / "single.onnx")
    assert single.embed(image, boxes) == pytest.approx(model.embed(image, boxes))
    assert single.name.split("-")[-1] != model.name.split("-")[-1], "another file, another name"


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"no network", "could not be loaded"), (colours_of_places(height=64), "not a re-identification model")],
)
def test_a_file_that_is_no_such_network_is_reported_by_name(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "osnet_bad.onnx").write_bytes(content)
    with pytest.raises(EmbeddingModelError, match=f"osnet_bad.onnx.*{words}"):
        AppearanceModel(tmp_path / "osnet_bad.onnx")


def test_a_checksum_next_to_the_file_has_to_be_its_own(tmp_path: Path, model: AppearanceModel) -> None:
    path = tmp_path / "osnet_test.onnx"
    checksum = tmp_path / "osnet_test.onnx.sha256"
    checksum.write_text(f"{hashlib.sha256(path.read_bytes()).hexdigest().upper()}  osnet_test.onnx\n", encoding="ascii")
    assert AppearanceModel(path).name == model.name
    checksum.write_text("0" * 64, encoding="ascii")
    with pytest.raises(EmbeddingModelError, match="does not match its checksum"):
        AppearanceModel(path)


def test_a_network_is_found_in_the_first_folder_that_has_one(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    for folder in (first, second):
        folder.mkdir()
    assert find_appearance((tmp_path / "none", first, second)) is None
    (second / "osnet_a.onnx").touch()
    assert find_appearance((tmp_path / "none", first, second)) == second / "osnet_a.onnx"
    (first / "osnet_b.onnx").touch()
    assert find_appearance((first, second)) == first / "osnet_b.onnx"


def look(stamp_s: float) -> DetectionRequest:
    return DetectionRequest(FrameRef(round(stamp_s * 1e9), None, "front", "ring", 0, 1, 640, 480))


def test_a_person_who_returns_elsewhere_keeps_their_number(model: AppearanceModel) -> None:
    tracker = PersonTracker([0], tracker="own", appearance=model)

    def seen(people: dict[int, tuple[int, int, int]], stamp_s: float) -> list[TrackedBox]:
        image, boxes = picture(people)
        count = len(boxes)
        detections = Detections(boxes, np.full(count, 0.9), np.zeros(count, np.int64))
        return sorted(tracker.track(detections, image, look(stamp_s)), key=lambda box: box.left_px)

    first = seen({50: RED, 400: BLUE}, 0.0)
    assert [box.track for box in first] == [1, 2]
    assert all(box.embedding is not None and box.quality > 0.5 for box in first)
    assert all(box.embedding is None for box in seen({50: RED, 400: BLUE}, 0.1)), "nothing is in doubt"
    seen({}, 1.0)
    seen({50: BLUE, 400: GREEN}, LOST_S + 5.0)
    assert [box.track for box in seen({50: BLUE, 400: GREEN}, LOST_S + 5.1)] == [2, 3]


def test_a_portrait_is_made_once_a_second_at_most_and_only_of_a_better_view_or_later() -> None:
    portraits = PortraitTaker()
    image, _ = picture({50: RED})

    def extract(stamp_s: float, quality: float) -> list[float]:
        box = TrackedBox(1, 50.0, 150.0, 80.0, 250.0, 0.9, 0, quality)
        return [each.quality for each in portraits.extract(image, look(stamp_s).frame, [box])]

    assert extract(0.0, 0.1) == []
    assert extract(0.1, 0.4) == [0.4]
    assert extract(0.5, 0.9) == []
    assert extract(1.2, 0.9) == [0.9]
    assert extract(2.5, 0.95) == []
    assert extract(11.3, 0.8) == [0.8]


def test_a_portrait_shows_who_it_is_of() -> None:
    image, _ = picture({50: RED})
    box = TrackedBox(7, 50.0, 150.0, 80.0, 250.0, 0.9, 0, 0.9)
    (portrait,) = PortraitTaker().extract(image, look(3.0).frame, [box])
    assert (portrait.track, portrait.camera, portrait.stamp_ns) == (7, "front", 3_000_000_000)
    shown = cv2.imdecode(np.frombuffer(portrait.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert shown is not None
    height, width = shown.shape[:2]
    assert 270 <= height <= 280
    assert shown[height // 2, width // 2] == pytest.approx(RED, abs=12)
