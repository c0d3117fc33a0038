"""Schedule of detection requests among cameras, with simulated time."""

from collections import Counter

from caris_desktop.domain.sensing import FrameRef
from caris_desktop.perception.camera_schedule import (
    OTHERS_EVERY_NS,
    SILENT_AFTER_NS,
    TO_COVER_EVERY_NS,
    CameraSchedule,
    DetectionRate,
)

MS = 1_000_000


def frame(camera: str, sequence: int = 1) -> FrameRef:
    return FrameRef(sequence, None, camera, "ring", 0, sequence, 4, 3)


def looks(turns: CameraSchedule, cameras: tuple[str, ...], *, seconds: int, start_ns: int = 0) -> Counter[str]:
    """Number of requests per camera if each sends ten frames a second and detection takes no time."""
    looked: Counter[str] = Counter()
    for number in range(10 * seconds):
        now_ns = start_ns + number * 100 * MS
        for camera in cameras:
            turns.offer(frame(camera, number), now_ns=now_ns)
            ref = turns.pop(now_ns=now_ns)
            if ref is not None:
                looked[ref.camera] += 1
    return looked


def test_one_camera_gets_every_look_and_its_newest_picture() -> None:
    turns = CameraSchedule()
    assert looks(turns, ("front",), seconds=2) == {"front": 20}
    assert turns.pop(now_ns=2000 * MS) is None
    assert turns.offer(frame("front", 50), now_ns=2000 * MS), "a look is due"
    assert not turns.offer(frame("front", 51), now_ns=2001 * MS), "it is due already"
    assert turns.pop(now_ns=2002 * MS) == frame("front", 51)


def test_two_cameras_make_no_more_work_than_one() -> None:
    turns = CameraSchedule()
    turns.show("front")
    looked = looks(turns, ("front", "rear"), seconds=10)
    assert looked.total() <= 101
    assert looked["front"] >= 60
    assert 20 <= looked["rear"] <= 40, "often enough to follow somebody"


def test_with_blurring_the_other_camera_is_scheduled_as_often() -> None:
    turns = CameraSchedule()
    turns.show("front")
    turns.others_every_ns = TO_COVER_EVERY_NS
    looked = looks(turns, ("front", "rear"), seconds=10)
    assert looked.total() <= 101
    assert looked["rear"] >= 45 and looked["front"] >= 45


def test_each_of_several_others_has_its_turn() -> None:
    turns = CameraSchedule()
    turns.show("front")
    looked = looks(turns, ("front", "left", "right", "rear"), seconds=10)
    assert looked.total() <= 101
    assert min(looked[camera] for camera in ("left", "right", "rear")) >= 12


def test_a_slow_detector_sees_both_cameras() -> None:
    """Detection takes half a second: frames of both always wait."""
    turns = CameraSchedule()
    turns.show("front")
    looked: Counter[str] = Counter()
    for number in range(20):
        now_ns = number * 500 * MS
        for camera in ("front", "rear"):
            turns.offer(frame(camera, number), now_ns=now_ns)
        ref = turns.pop(now_ns=now_ns)
        assert ref is not None
        looked[ref.camera] += 1
    assert abs(looked["front"] - looked["rear"]) <= 1


def test_the_camera_that_is_shown_leads_from_then_on() -> None:
    turns = CameraSchedule()
    turns.show("front")
    looks(turns, ("front", "rear"), seconds=2)
    turns.show("rear")
    looked = looks(turns, ("front", "rear"), seconds=10, start_ns=2000 * MS)
    assert looked["rear"] > looked["front"]


def test_nobody_waits_for_a_camera_on_show_that_sends_nothing() -> None:
    turns = CameraSchedule()
    turns.show("front")
    turns.offer(frame("front"), now_ns=0)
    assert turns.pop(now_ns=0) is not None
    turns.offer(frame("rear"), now_ns=OTHERS_EVERY_NS)
    assert turns.pop(now_ns=OTHERS_EVERY_NS) is None, "its own next picture may come any moment"
    assert turns.pop(now_ns=SILENT_AFTER_NS) == frame("rear")


def test_a_removed_camera_is_not_scheduled() -> None:
    turns = CameraSchedule()
    turns.show("front")
    turns.offer(frame("front"), now_ns=0)
    turns.forget()
    assert turns.pop(now_ns=SILENT_AFTER_NS) is None
    turns.offer(frame("head"), now_ns=SILENT_AFTER_NS)
    assert turns.pop(now_ns=SILENT_AFTER_NS) == frame("head")


def test_the_detection_rate_of_each_camera_is_reported() -> None:
    turns, rates = CameraSchedule(), DetectionRate()
    turns.show("front")
    for number in range(100):
        now_ns = number * 100 * MS
        for camera in ("front", "left", "right", "rear"):
            turns.offer(frame(camera, number), now_ns=now_ns)
        ref = turns.pop(now_ns=now_ns)
        if ref is not None:
            rates.note(ref.camera, now_ns=now_ns)
    told = rates.per_second(now_ns=9900 * MS)
    assert sum(told.values()) <= 10.1, "no more looks than one camera alone would get"
    assert told["front"] >= 4.5
    others = [told[camera] for camera in ("left", "right", "rear")]
    assert max(others) - min(others) <= 0.5, "none of the others comes off worse"
    assert rates.per_second(now_ns=20_000 * MS) == dict.fromkeys(told, 0.0), "it is of the last seconds"
    rates.forget()
    assert rates.per_second(now_ns=20_000 * MS) == {}
