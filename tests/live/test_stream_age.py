"""Displayed age of values: late delivery counts as age."""

import pytest

from caris_desktop.domain import clock
from caris_desktop.domain.events import LinkChanged, LinkQuality
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import FrameRef, Odometry, People, PeopleInMap, PersonPlace
from caris_desktop.live.services import drive_service
from caris_desktop.live.state import LiveState, PresentClock
from caris_desktop.robot.profile_model import CameraTopic, RobotProfile
from caris_desktop.ui import text_formatting

S = 1_000_000_000
OFFSET_NS = 1_700_000_000 * S


def odometry(*, late_s: float, offset_ns: int = OFFSET_NS) -> Odometry:
    """Odometry that arrives now and was measured ``late_s`` before."""
    now_ns = clock.now_ns()
    return Odometry(now_ns, now_ns + offset_ns - int(late_s * 1e9), Pose2D(0, 0, 0), Twist2D())


@pytest.fixture
def state(qapp: object) -> LiveState:
    return LiveState()


def knows_the_clock(state: LiveState, *, uncertainty_ms: float = 1.0) -> None:
    state.add(LinkQuality(clock.now_ns(), 10.0, OFFSET_NS / 1e6, uncertainty_ms))


def test_a_value_long_in_transit_is_stale_on_arrival(state: LiveState) -> None:
    knows_the_clock(state)
    state.add(odometry(late_s=0.1))
    assert state.odometry.freshness == "fresh"
    state.add(odometry(late_s=0.9))
    assert state.odometry.freshness == "stale"
    assert 0.85 < (state.odometry.age_s() or 0.0) < 1.5
    state.add(odometry(late_s=3.0))
    assert state.odometry.freshness == "lost"


def test_without_the_robots_clock_its_arrival_counts(state: LiveState) -> None:
    state.add(odometry(late_s=3.0))
    assert state.odometry.freshness == "fresh"
    state.add(LinkQuality(clock.now_ns(), 10.0))
    state.add(odometry(late_s=3.0))
    assert state.odometry.freshness == "fresh"


def test_a_delay_that_may_be_an_error_of_the_clock_is_none(state: LiveState) -> None:
    knows_the_clock(state, uncertainty_ms=1000.0)
    state.add(odometry(late_s=0.9))
    assert state.odometry.freshness == "fresh"


@pytest.mark.parametrize(("late_s", "known"), [(3600.0, False), (10.0, False), (-3600.0, False), (-0.4, True)])
def test_a_stamp_of_another_clock_makes_nothing_old_or_young(state: LiveState, late_s: float, known: bool) -> None:
    knows_the_clock(state)
    state.add(odometry(late_s=late_s))
    assert state.odometry.freshness == "fresh"
    assert state.odometry.age_known is known
    assert (text_formatting.stream_age(state.odometry) == "age unknown") is not known
    age_s = state.odometry.age_s()
    assert age_s is not None
    assert 0.0 <= age_s < 0.4


def test_late_data_is_not_reported_as_silent(state: LiveState) -> None:
    knows_the_clock(state)
    state.add(odometry(late_s=3.0))
    assert (state.odometry.freshness, state.odometry.arrives_late) == ("lost", True)
    silent_s = state.odometry.silent_s()
    assert silent_s is not None
    assert silent_s < 1.0
    assert "delayed by 3." in drive_service._missing("odometry", state.odometry)


def test_without_a_clock_what_comes_later_than_usual_is_known_to_be_old(state: LiveState) -> None:
    """The sensor's clock is an hour off, and then the network delays its data."""
    knows_the_clock(state)
    for _ in range(3):
        state.add(odometry(late_s=3600.0))
    state.add(odometry(late_s=3601.0))
    assert (state.odometry.freshness, state.odometry.age_known) == ("stale", False)
    state.add(odometry(late_s=3600.0))
    assert state.odometry.freshness == "fresh"
    state.add(odometry(late_s=-100.0))
    assert state.odometry.freshness == "fresh", "its clock was set, and nothing is known of before"


def test_of_several_cameras_one_is_on_show(state: LiveState) -> None:
    for camera, sequence in (("front", 1), ("rear", 1), ("front", 2), ("rear", 2)):
        state.add(FrameRef(clock.now_ns(), None, camera, "ring", 0, sequence, 64, 48))
    assert (state.cameras.value, state.camera.value) == (("front", "rear"), "front")
    assert (state.frame.value.camera, state.frame.value.sequence) == ("front", 2)
    state.choose_camera("rear")
    assert state.frame.value.camera == "rear", "what it sent last is known, and young"
    state.add(FrameRef(clock.now_ns(), None, "front", "ring", 0, 3, 64, 48))
    assert state.frame.value.camera == "rear"
    state.add(FrameRef(clock.now_ns(), None, "rear", "ring", 0, 3, 64, 48))
    assert state.frame.value.camera == "rear"
    state.choose_camera("ceiling")
    assert state.camera.value == "rear"
    state.forget_cameras()
    state.add(FrameRef(clock.now_ns(), None, "head", "ring", 0, 1, 64, 48))
    assert (state.cameras.value, state.camera.value) == (("head",), "head")


def test_each_camera_has_an_age_of_its_own(qapp: object) -> None:
    now_ns = [100 * S]
    state = LiveState(present=PresentClock(now_ns=lambda: now_ns[0]))
    changes: list[str] = []
    state.frame_of("desk").freshness_changed.connect(changes.append)
    for camera in ("front", "desk"):
        state.add(FrameRef(now_ns[0], None, camera, "ring", 0, 1, 64, 48))
        state.add(People(now_ns[0], camera, 1, 64, 48, (), 9.0))
    now_ns[0] += 4 * S
    state.add(FrameRef(now_ns[0], None, "front", "ring", 0, 2, 64, 48))
    state.check_freshness()
    assert [state.frame_of(camera).freshness for camera in ("front", "desk")] == ["fresh", "lost"]
    assert state.frame_of("desk").age_s() == pytest.approx(4.0)
    assert (state.frame.freshness, state.people_of("desk").value.camera) == ("fresh", "desk")
    assert state.people.value.camera == "front"
    state.choose_camera("desk")
    assert state.frame.freshness == "lost", "nothing old is shown as if it were live"
    state.add(FrameRef(now_ns[0], None, "desk", "ring", 0, 2, 64, 48))
    assert changes == ["fresh", "lost", "fresh"], "it returns by itself"
    state.close()


def test_the_robots_link_takes_only_the_robots_pictures_along(state: LiveState) -> None:
    state.own_cameras.set({"desk": None})
    for camera in ("head", "desk"):
        state.add(frame_of(camera))
    state.forget_received(LinkChanged(clock.now_ns(), "media", "lost", "ws://robot"))
    assert (state.frame_of("head").value, state.frame.value) == (None, None)
    assert state.frame_of("desk").freshness == "fresh"
    state.choose_camera("desk")
    state.forget_received(LinkChanged(clock.now_ns(), "media", "lost", "ws://robot"))
    assert state.frame.freshness == "fresh"
    state.forget_camera("desk")
    assert state.frame_of("desk").value is None
    assert (state.cameras.value, state.camera.value) == (("head",), "head")


def frame_of(camera: str) -> FrameRef:
    return FrameRef(clock.now_ns(), None, camera, "ring", 0, 1, 64, 48)


def test_the_robots_first_camera_is_shown_whichever_is_quicker(state: LiveState) -> None:
    cameras = (CameraTopic("head", "/head"), CameraTopic("base", "/base"), CameraTopic("rear", "/rear"))
    state.robot.set(RobotProfile("r", "R", cameras=cameras))
    state.add(frame_of("rear"))
    assert state.camera.value == "rear", "better this one than none"
    state.add(frame_of("head"))
    assert (state.cameras.value, state.camera.value) == (("head", "rear"), "head")
    state.add(frame_of("rear"))
    assert state.camera.value == "head"
    state.choose_camera("rear")
    state.add(frame_of("base"))
    assert (state.cameras.value, state.camera.value) == (("head", "base", "rear"), "rear"), "what was chosen stays"


def test_the_map_shows_whom_all_cameras_see(state: LiveState) -> None:
    now_ns = clock.now_ns()

    def seen(camera: str, person: str, *, at_ns: int) -> PeopleInMap:
        return PeopleInMap(at_ns, (PersonPlace(person, 1.0, 2.0, 0.1, "lidar"),), camera)

    state.add(seen("front", "p-1", at_ns=now_ns))
    state.add(seen("rear", "p-2", at_ns=now_ns + S // 10))
    assert {place.person_id for place in state.people_in_map.value.people} == {"p-1", "p-2"}
    state.add(seen("front", "p-3", at_ns=now_ns + S // 5))
    assert {place.person_id for place in state.people_in_map.value.people} == {"p-2", "p-3"}
    state.add(seen("front", "p-3", at_ns=now_ns + 2 * S))
    assert {place.person_id for place in state.people_in_map.value.people} == {"p-3"}, "that was too long ago"


def test_a_person_seen_by_two_cameras_is_on_the_map_once(state: LiveState) -> None:
    now_ns = clock.now_ns()
    state.add(PeopleInMap(now_ns, (PersonPlace("p-1", 1.0, 2.0, 0.4, "floor", 3),), "desk"))
    by_front = (PersonPlace("p-1", 1.1, 2.0, 0.1, "lidar", 7), PersonPlace("", 5.0, 2.0, 0.1, "lidar", 8))
    state.add(PeopleInMap(now_ns, by_front, "front"))
    by_desk = (PersonPlace("p-1", 1.0, 2.0, 0.4, "floor", 3), PersonPlace("", 5.1, 2.0, 0.4, "floor", 4))
    state.add(PeopleInMap(now_ns, by_desk, "desk"))
    shown = sorted((place.person_id, place.x_m) for place in state.people_in_map.value.people)
    assert shown == [("", 5.0), ("", 5.1), ("p-1", 1.1)], "where the surer one says; who is not known may be anybody"


def test_cameras_of_this_computer_come_in_the_requested_order(state: LiveState) -> None:
    state.own_cameras.set({"mast": None, "desk": None, "door": None})
    for camera in ("door", "desk", "mast"):
        state.add(frame_of(camera))
    assert (state.cameras.value, state.camera.value) == (("mast", "desk", "door"), "mast")
