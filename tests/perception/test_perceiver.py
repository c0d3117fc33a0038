"""Reports for a frame in addition to the tracks."""

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.sensing import FrameRef
from caris_desktop.perception.backends.runtime_selection import Chosen
from caris_desktop.perception.detector import Detections
from caris_desktop.perception.inference_messages import DetectionRequest
from caris_desktop.perception.perceiver import Perceiver
from caris_desktop.perception.tracker import PersonTracker

PICTURE = np.zeros((480, 640, 3), np.uint8)


class Finds:
    """Detector that finds one person with high confidence, one with low, and a chair."""

    label = "finds"
    class_names = ("person", "chair")

    def __init__(self, keypoints: NDArray[np.float64] | None = None) -> None:
        self.keypoints = keypoints

    def detect(self, image_bgr: NDArray[np.uint8]) -> Detections:
        corners = np.array([[50.0, 50, 150, 350], [300, 60, 360, 240], [400, 300, 500, 400]])
        return Detections(corners, np.array([0.9, 0.15, 0.8]), np.array([0, 0, 1]), self.keypoints)


def perceiver(detector: Finds) -> Perceiver:
    return Perceiver(Chosen(detector, (0,), None), PersonTracker((0,), tracker="own"), "")


def look(number: int, *, to_cover: bool) -> DetectionRequest:
    ref = FrameRef((number + 1) * 100_000_000, None, "front", "", 0, number, 640, 480)
    return DetectionRequest(ref, to_cover=to_cover)


def test_possible_people_are_reported_where_blurring_is_required() -> None:
    one = perceiver(Finds())
    first = one.perceive(PICTURE, look(0, to_cover=True))
    told = {round(box.left_px) for box in (*first.boxes, *first.unfollowed)}
    assert told == {50, 300}, "nobody is missing while the tracker makes up its mind, and a chair is no person"
    for number in range(1, 6):
        later = one.perceive(PICTURE, look(number, to_cover=True))
    assert [round(box.left_px) for box in later.boxes] == [50]
    assert [(round(box.left_px), box.track, box.person_id) for box in later.unfollowed] == [(300, 0, "")]
    assert one.perceive(PICTURE, look(7, to_cover=False)).unfollowed == ()


def test_a_head_is_reported_of_where_it_is_seen() -> None:
    keypoints = np.zeros((3, 17, 3))
    keypoints[0, :3] = [(100, 330, 0.9), (104, 326, 0.9), (96, 326, 0.9)]
    perceived = perceiver(Finds(keypoints)).perceive(PICTURE, look(0, to_cover=True))
    heads = [box for box in perceived.unfollowed if box.top_px > 250]
    assert len(heads) == 1
    head = heads[0]
    assert head.left_px < 90 and head.left_px + head.width_px > 110 and head.top_px + head.height_px > 340
