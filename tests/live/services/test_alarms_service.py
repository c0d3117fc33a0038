"""Alarms from the state and from events, with a simulated clock."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from PySide6.QtWidgets import QApplication

from caris_desktop.domain import clock, intents
from caris_desktop.domain.events import AlarmChanged, LinkQuality, Problem, RecordingPaused, RobotChosen, SessionStarted
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import BatteryState, FrameRef, LaserScan
from caris_desktop.live.services.alarms_service import AlarmsService
from caris_desktop.live.state import LiveState, PresentClock
from caris_desktop.live.status import DriveStatus, LinkStatus, RecordingStatus

S = 1_000_000_000
FRAME = FrameRef(0, None, "front", "ring", 0, 1, 640, 480)


class Desk:
    def __init__(self) -> None:
        self.now_ns = clock.now_ns()
        self.state = LiveState(present=PresentClock(now_ns=lambda: self.now_ns))
        self.state.close()
        self.told: list[AlarmChanged] = []
        self.service = AlarmsService(self.state, self.told.append, now_ns=lambda: self.now_ns)  # type: ignore[arg-type]
        self.state.link.set(LinkStatus("connected"))

    def wait(self, seconds: float) -> None:
        self.now_ns += round(seconds * S)
        self.state.check_freshness()
        self.service.evaluate()

    def happens(self, event: object) -> None:
        self.service.follows()[type(event)](event)

    @property
    def alarms(self) -> list[str]:
        return [alarm.cause for alarm in self.state.alarms.value]


@pytest.fixture
def desk(qapp: QApplication) -> Iterator[Desk]:
    desk = Desk()
    yield desk
    desk.service.stop()


def test_a_picture_that_stays_away_is_an_alarm_though_nobody_reports_it(desk: Desk) -> None:
    desk.state.add(replace(FRAME, stamp_ns=desk.now_ns))
    desk.wait(3)
    assert desk.state.frame.freshness == "lost"
    assert desk.alarms == [], "pictures break off for a moment"
    desk.wait(6)
    assert desk.alarms == ["picture"]
    assert desk.state.alarms.value[0].what == "No video from the camera front."
    desk.state.add(replace(FRAME, stamp_ns=desk.now_ns))
    desk.service.evaluate()
    assert desk.alarms == []
    assert [(change.state, change.told) for change in desk.told] == [("raised", False), ("ended", False)]


def test_with_the_link_its_silent_streams_are_no_alarms(desk: Desk) -> None:
    desk.state.add(replace(FRAME, stamp_ns=desk.now_ns))
    desk.wait(1)
    desk.state.link.set(LinkStatus("trouble"))
    desk.wait(2)
    desk.state.link.set(LinkStatus("lost"))
    desk.wait(60)
    assert desk.alarms == ["link"]
    desk.state.link.set(LinkStatus("connecting"))
    desk.wait(60)
    assert desk.alarms == ["link"], "looking for it is not having it"
    desk.state.link.set(LinkStatus("connected"))
    desk.wait(2.5)
    assert "link" not in desk.alarms


def test_a_picture_of_which_nothing_is_retained_is_an_alarm_as_long_as_it_is_so(desk: Desk) -> None:
    desk.state.recording.set(RecordingStatus("recording", covered_whole=("front",)))
    assert desk.alarms == ["covered_whole"]
    desk.wait(600)
    assert desk.alarms == ["covered_whole"]
    desk.state.recording.set(
        RecordingStatus("recording")
    )  # another scenario without blurring, or the people were detected
    assert desk.alarms == []
    desk.state.recording.set(RecordingStatus("recording", covered_whole=("front",)))
    desk.state.recording.set(RecordingStatus("stopping", covered_whole=("front",)))
    desk.wait(60)
    assert desk.alarms == []


def test_a_low_battery_is_reported_once_until_it_was_charged(desk: Desk) -> None:
    for charge in (0.16, 0.149, 0.151, 0.149, 0.19):
        desk.state.add(BatteryState(desk.now_ns, charge))
        desk.wait(10)
    assert desk.alarms == ["battery"]
    desk.state.add(BatteryState(desk.now_ns, 0.21))
    assert desk.alarms == []
    assert [change.state for change in desk.told] == ["raised", "ended"]


def test_a_problem_of_one_robot_is_not_one_of_the_next(desk: Desk) -> None:
    desk.happens(Problem(1, "warning", "Nobody has said whether it stops.", "", "", cause="robot_timeout"))
    desk.happens(Problem(1, "warning", "Classes unknown to the detector: cake.", "", ""))
    desk.happens(RobotChosen(1, "other", "Other", "ws://127.0.0.1:1"))
    assert [alarm.what for alarm in desk.state.alarms.value] == ["Classes unknown to the detector: cake."]


def test_a_robot_that_never_answered_is_not_called_lost_and_the_reason_goes_with_the_robot(desk: Desk) -> None:
    why = "No response from ws://127.0.0.1:1."
    desk.happens(RobotChosen(1, "other", "Other", "ws://127.0.0.1:1"))
    desk.state.link.set(LinkStatus("connecting", "Other"))
    desk.happens(Problem(1, "error", why, "", "Switch it on.", until="connected"))
    (alarm,) = desk.state.alarms.value
    assert (alarm.what, alarm.why, alarm.folded) == ("Other does not respond.", f"{why} Switch it on.", ())
    desk.happens(RobotChosen(1, "third", "Third", "ws://127.0.0.1:2"))
    desk.state.link.set(LinkStatus("connecting", "Third"))
    (alarm,) = desk.state.alarms.value
    assert (alarm.what, alarm.why) == ("Third does not respond.", "")
    desk.state.link.set(LinkStatus("connected", "Third"))
    desk.wait(3)
    desk.state.link.set(LinkStatus("lost", "Third"))
    assert desk.state.alarms.value[0].what == "The connection to the robot is lost."


def test_a_robot_that_is_being_started_is_no_alarm(desk: Desk) -> None:
    why = "Nothing listens at ws://127.0.0.1:1."
    desk.state.link.set(LinkStatus("lost", "Simulated robot"))
    desk.happens(Problem(1, "error", why, "", "Start one.", until="connected"))
    assert desk.alarms == ["link"]
    desk.state.link.set(LinkStatus("connecting", "Simulated robot", starts=True))
    assert desk.alarms == []
    desk.happens(Problem(1, "error", why, "", "Start one.", until="connected"))  # the previous link, which is closing
    desk.state.link.set(LinkStatus("lost", "Simulated robot", starts=True))
    desk.wait(3)
    assert desk.alarms == []
    desk.state.link.set(LinkStatus("connecting", "Simulated robot", "ws://127.0.0.1:2"))
    desk.wait(3)
    assert desk.alarms == [], "it has only just been connected to"
    desk.state.link.set(LinkStatus("lost", "Simulated robot", "ws://127.0.0.1:2"))
    assert desk.alarms == ["link"]


def test_a_record_begins_with_what_is_wrong_already(desk: Desk) -> None:
    desk.state.link.set(LinkStatus("lost"))
    desk.happens(SessionStarted(1, "session"))
    first, again = desk.told
    assert (again.state, again.alarm_id, again.times) == ("raised", first.alarm_id, 1)


def test_after_a_pause_the_record_has_what_is_wrong_still(desk: Desk) -> None:
    desk.state.link.set(LinkStatus("lost"))
    desk.happens(RecordingPaused(1, paused=True))
    assert len(desk.told) == 1
    desk.happens(RecordingPaused(2, paused=False))
    first, again = desk.told
    assert (again.state, again.alarm_id, again.times) == ("raised", first.alarm_id, 1)


def test_an_alarm_that_ends_automatically_is_not_acknowledged(desk: Desk) -> None:
    desk.state.link.set(LinkStatus("lost"))
    with pytest.raises(UserFacingError, match="still exists"):
        desk.service.dismiss(intents.DismissAlarm(desk.state.alarms.value[0].alarm_id))
    assert desk.alarms == ["link"]


@pytest.mark.parametrize(
    ("drive", "cause", "severity", "said"),
    [
        (DriveStatus(movement="uncommanded"), "uncommanded", "warning", "without a command from this console"),
        (
            DriveStatus(movement="uncommanded", stopped=True, emergency_stop=True, velocity_publishers=("/joy",)),
            "uncommanded", "error", "although the emergency stop is active",
        ),
        (DriveStatus(movement="uncommanded", stopped=True), "uncommanded", "error", "although it was stopped"),
        (DriveStatus(movement="commanded_elsewhere", stopped=True), "commanded_elsewhere", "error", "Something else"),
        (DriveStatus(movement="not_following"), "not_following", "warning", "does not follow"),
    ],
)  # fmt: skip
def test_movement_that_contradicts_the_commands_is_an_alarm_at_once(
    desk: Desk, drive: DriveStatus, cause: str, severity: str, said: str
) -> None:
    desk.state.drive.set(drive)
    [alarm] = desk.state.alarms.value
    assert (alarm.cause, alarm.severity, said in alarm.what) == (cause, severity, True)
    for publisher in drive.velocity_publishers:
        assert publisher in alarm.meaning
    desk.state.drive.set(DriveStatus(movement="standing"))
    desk.wait(60)
    assert desk.alarms == []
    assert [change.state for change in desk.told] == ["raised", "ended"]


def test_silent_odometry_is_an_alarm_and_a_lost_link_is_its_own(desk: Desk) -> None:
    desk.state.drive.set(DriveStatus(movement="silent"))
    desk.wait(2)
    assert desk.alarms == ["movement_silent"]
    desk.state.link.set(LinkStatus("lost"))
    desk.wait(60)
    assert desk.alarms == ["link"]


def test_an_alarm_reported_as_over_ends(desk: Desk) -> None:
    desk.happens(Problem(1, "warning", "The robot lacks something.", "", "", cause="robot_lacks"))
    desk.wait(2)
    assert desk.alarms == ["robot_lacks"]
    desk.happens(Problem(2, "info", "It has it now.", "", "", cause="robot_lacks"))
    assert desk.alarms == []


def test_a_lidar_whose_stamps_are_beyond_belief_is_reported(desk: Desk) -> None:
    desk.state.add(LinkQuality(desk.now_ns, 10.0, 0.0, 1.0))

    def scan(late_s: float) -> LaserScan:
        stamp_ns = desk.now_ns - round(late_s * S)
        return LaserScan(desk.now_ns, stamp_ns, "laser", 0.0, 0.1, 0.0, 9.0, np.ones(8, np.float32), Pose2D(0, 0, 0))

    for late_s, cause in ((3600.0, "scan_age"), (3.0, "lidar"), (0.05, "")):
        desk.state.add(scan(late_s))
        desk.service.evaluate()
        for _ in range(60):
            desk.wait(0.1)
            desk.state.add(scan(late_s))
            desk.service.evaluate()
        assert [one for one in desk.alarms if one in ("scan_age", "lidar")] == ([cause] if cause else [])
        if cause == "lidar":
            assert "LIDAR scans are delayed" in desk.state.alarms.value[0].what
