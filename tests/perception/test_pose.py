"""Poses of synthetic skeletons: in one frame, and over time."""

from itertools import count
from typing import Any

import numpy as np
import pytest

from caris_desktop.perception.pose import Points, Pose, Poses, faces_camera, posture_of, raises_hand

# A person of 180 px who stands in front of the camera and looks into it: x, y by name.
_STANDING = {
    "nose": (100, 20), "eye": (97, 16, 103, 16), "ear": (93, 18, 107, 18), "shoulder": (84, 40, 116, 40),
    "elbow": (80, 66, 120, 66), "wrist": (80, 90, 120, 90), "hip": (90, 95, 110, 95), "knee": (90, 137, 110, 137),
    "ankle": (90, 178, 110, 178),
}  # fmt: skip
_ORDER = ("nose", "eye", "ear", "shoulder", "elbow", "wrist", "hip", "knee", "ankle")


def body(*, hidden: tuple[str, ...] = (), scale: float = 1.0, **changed: Any) -> Points:
    """Keypoints in the order of COCO, with the person's left first, which is on the image's right for a frontal
    view.
    """
    rows = []
    for name in _ORDER:
        values = changed.get(name, _STANDING[name])
        pairs = [values[at : at + 2] for at in reversed(range(0, len(values), 2))]
        rows += [(x * scale, y * scale, 0.0 if name in hidden else 0.9) for x, y in pairs]
    return np.array(rows, np.float64)


SITS_BEFORE_THE_CAMERA = body(knee=(86, 108, 114, 108), ankle=(88, 150, 112, 150))
SITS_SIDEWAYS = body(
    shoulder=(98, 40, 102, 40), hip=(98, 95, 102, 95), knee=(140, 97, 143, 97), ankle=(140, 140, 143, 140)
)


@pytest.mark.parametrize("scale", [0.3, 1.0, 8.0])
def test_a_standing_person_stands_at_any_distance(scale: float) -> None:
    assert posture_of(body(scale=scale)) == "standing"


@pytest.mark.parametrize("points", [SITS_BEFORE_THE_CAMERA, SITS_SIDEWAYS], ids=["towards us", "sideways"])
def test_a_sitting_person_sits(points: Points) -> None:
    assert posture_of(points) == "sitting"


def test_an_ambiguous_posture_stays_as_it_was() -> None:
    crouching = body(knee=(88, 125, 112, 125))
    assert [posture_of(crouching, before) for before in ("", "standing", "sitting")] == ["", "standing", "sitting"]


@pytest.mark.parametrize(
    "points",
    [
        body(hidden=("knee",)),
        body(hidden=("hip",)),
        body(shoulder=(40, 90, 40, 100), knee=(130, 95, 130, 97)),
        np.zeros((17, 3)),
    ],
    ids=["behind a table", "hips hidden", "lying", "nothing seen"],
)
def test_an_invisible_joint_is_not_reported(points: Points) -> None:
    assert posture_of(points, "standing") == ""


def test_a_raised_hand_is_as_high_as_the_head_and_stays_raised_until_it_is_lower_than_the_shoulders() -> None:
    assert raises_hand(body()) is False
    assert raises_hand(body(wrist=(80, 90, 125, 5))) is True
    at_the_chin = body(wrist=(80, 90, 125, 32))
    assert raises_hand(at_the_chin) is False
    assert raises_hand(at_the_chin, before=True) is True
    assert raises_hand(body(wrist=(80, 90, 125, 60)), before=True) is False
    assert raises_hand(body(hidden=("wrist",)), before=True) is None
    headless = body(wrist=(80, 90, 125, 5), hidden=("nose", "eye", "ear"))
    assert raises_hand(headless) is True


def test_a_face_is_turned_one_way_or_another() -> None:
    assert faces_camera(body()) is True
    half_turned = body(nose=(102.5, 20))
    assert [faces_camera(half_turned, before) for before in (None, True, False)] == [None, True, False]
    assert faces_camera(body(nose=(105, 20))) is False
    assert faces_camera(body(hidden=("nose", "eye"))) is False, "from behind"
    assert faces_camera(body(hidden=("nose", "eye", "ear"))) is None, "head outside the picture"
    assert faces_camera(body(eye=(100, 16, 100, 16))) is False


def _told(*spans: tuple[float, Points], fps: float = 10.0) -> list[Pose]:
    """Reported poses of one person with these keypoints for these durations, in sequence."""
    poses, number = Poses(), count()
    return [poses.of(1, points, next(number) / fps) for seconds, points in spans for _ in range(round(seconds * fps))]


def test_a_pose_is_reported_once_it_was_seen_for_half_a_second() -> None:
    told = _told((1.0, body()), (1.0, SITS_BEFORE_THE_CAMERA))
    assert told[0] == Pose()
    assert told[9] == Pose("standing", False, True)
    assert [pose.posture for pose in told[10:]] == ["standing"] * 5 + ["sitting"] * 5


def test_single_bad_pictures_change_nothing() -> None:
    bad = np.zeros((17, 3))
    told = _told((1.0, body()), *[(0.1, SITS_SIDEWAYS), (0.2, body()), (0.1, bad), (0.2, body())] * 3)
    assert {pose.posture for pose in told[9:]} == {"standing"}
    assert {pose.facing for pose in told[9:]} == {True}


def test_a_joint_no_longer_visible_is_soon_not_reported() -> None:
    told = _told((1.0, body()), (4.0, body(hidden=("knee", "wrist"))))
    assert told[20].posture == "standing"
    assert told[-1] == Pose("", None, True)


def test_tracks_do_not_share_and_are_forgotten() -> None:
    poses = Poses()
    for number in range(100):
        poses.of(1, body(), number / 10)
    assert poses.of(1, body(), 10.0).posture == "standing"
    assert poses.of(2, SITS_SIDEWAYS, 10.0).posture == ""
    assert poses.of(3, body(), 30.0) == Pose()
    assert poses.of(1, body(), 30.1) == Pose(), "somebody else by now"
