"""Alarm service: alarms from reported problems and from the state. GUI thread."""

from collections.abc import Callable, Iterator

from PySide6.QtCore import QObject

from caris_desktop.domain import clock, intents
from caris_desktop.domain.events import ANSWER, Event, Problem, ProblemEnd, RecordingPaused, RobotChosen, SessionStarted
from caris_desktop.domain.failure import RefusedError
from caris_desktop.domain.translation import tr
from caris_desktop.live.alarm_causes import AlarmBook, Condition
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.service import Follows, Handlers, Service
from caris_desktop.live.services.preflight_service import no_answer_advice
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import DriveStatus
from caris_desktop.robot.profile_model import RobotProfile

BATTERY_LOW, BATTERY_WELL = 0.15, 0.20
_SILENT_AFTER_S = 5.0
_OF_ROBOT = (
    "robot_timeout", "robot_lacks", "robot_speed", "pose", "battery", "lidar", "scan_age",
    "uncommanded", "commanded_elsewhere", "not_following", "movement_silent",
)  # fmt: skip


class AlarmsService(Service):
    """Maintains ``state.alarms``, and publishes each alarm's start and end."""

    def __init__(
        self,
        state: LiveState,
        publish: Callable[[Event], None],
        parent: QObject | None = None,
        *,
        now_ns: Callable[[], int] = clock.now_ns,
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._publish = publish
        self._now_ns = now_ns
        self._book = AlarmBook()
        self._met_robot: tuple[str, str] | None = None
        self._again = new_timer(self, self.evaluate, single_shot=True)
        self._stopped = False
        for value in (
            state.link, state.drive, state.recording, state.speech, state.assistant, state.perception,
            state.microphone, state.wizard_microphone, state.listening, state.battery,
        ):  # fmt: skip
            value.changed.connect(self.evaluate)
        for stream in (state.frame, state.scan, state.pose):
            stream.freshness_changed.connect(self.evaluate)
        self.evaluate()

    def follows(self) -> Follows:
        return {
            Problem: self.add,
            RobotChosen: self._on_robot_chosen,
            SessionStarted: self._on_recording,
            RecordingPaused: self._on_recording,
        }

    def handlers(self) -> Handlers:
        return {intents.DismissAlarm: self.dismiss}

    def add(self, problem: Problem) -> None:
        if problem.severity == "info" and problem.cause not in ("", ANSWER):
            self._book.forget((problem.cause,), self._now_ns())  # reports the end of a problem
        self._book.add(problem, self._now_ns())
        self.evaluate()

    def evaluate(self, _changed: object = None) -> None:
        """Evaluate the conditions: raise and end alarms."""
        state, now_ns = self._state, self._now_ns()
        link = state.link.value
        if link.state == "connected":
            self._met_robot = link.robot, link.address
        if link.starts:
            self._book.forget(("link",), now_ns)
        met = self._met_robot == (link.robot, link.address)
        found = conditions(state, self._book.causes(), met_robot=met)
        self._book.evaluate(tuple(found), endings(state), now_ns)
        self._notify()

    def dismiss(self, intent: intents.DismissAlarm) -> None:
        if not self._book.dismiss(intent.alarm_id, intent.actor, self._now_ns()):
            raise RefusedError(
                tr("The problem still exists, or it has already ended."), tr("Nothing was changed."),
                tr("Alarms that end automatically leave the list when the problem is over."),
            )  # fmt: skip
        self._notify()

    def stop(self) -> None:
        self._stopped = True  # services that stop later may still change what an alarm is about
        self._again.stop()

    def _on_robot_chosen(self, _robot: RobotChosen) -> None:
        self._book.forget(_OF_ROBOT, self._now_ns())
        self.evaluate()

    def _on_recording(self, event: SessionStarted | RecordingPaused) -> None:
        """At the start of a session and on resuming, record again what is still wrong."""
        if isinstance(event, SessionStarted) or not event.paused:
            self._book.report_all(self._now_ns())
            self._notify()

    def _notify(self) -> None:
        for change in self._book.take_changes():
            self._publish(change)
        self._state.alarms.set(self._book.alarms)
        wait_s = self._book.wait_s(self._now_ns())
        if wait_s is None or self._stopped:
            self._again.stop()
        else:
            self._again.start(max(50, round(wait_s * 1000)))


def endings(state: LiveState) -> frozenset[ProblemEnd]:
    """Conditions that can end a problem and hold now."""
    now: dict[ProblemEnd, bool] = {
        "connected": state.link.value.state == "connected",
        "released": not state.drive.value.emergency_stop,
        "picture": state.frame.freshness == "fresh",
        # From the start on: problems while starting belong to it. Resuming continues the same recording.
        "recording": state.recording.value.state in ("starting", "recording", "paused"),
        "voice": state.speech.value.ready and not state.speech.value.detail,
        "utterance": state.speech.value.now is not None and state.speech.value.now.state == "started",
        "assistant": state.assistant.value.state in ("ready", "answering"),
        "people": state.perception.value.state == "ready",
        "microphone": state.microphone.value.state == "on",
        "own_microphone": state.wizard_microphone.value.state == "on",
        "transcription": state.listening.value.state == "ready",
        "pose": state.pose.freshness == "fresh",
    }
    return frozenset(end for end, true in now.items() if true)


def conditions(state: LiveState, standing: frozenset[str], *, met_robot: bool = True) -> Iterator[Condition]:
    """Alarm conditions of the state, reported or not. ``standing``: causes of current alarms; ``met_robot``: whether
    the robot was connected since it was chosen.
    """
    recording = state.recording.value
    if recording.state == "recording" and recording.covered_whole:
        yield Condition(
            "covered_whole", "warning",
            tr("The whole picture of {camera} is pixelated.").format(camera=recording.covered_whole[0]),
            tr("People must be pixelated in recordings, but they are not being detected in time. The recording "
                "continues; it pixelates only people again once detection is fast enough."),
            tr("Check people detection in Diagnostics; close other programs if this computer is busy."),
        )  # fmt: skip
    link = state.link.value
    if link.starts:
        return
    if link.state == "lost" or ("link" in standing and link.state in ("connecting", "trouble")):
        if not met_robot:
            yield _no_link_yet(state)
        else:
            yield Condition(
                "link", "error", tr("The connection to the robot is lost."),
                tr("The robot cannot drive or speak; video, map and LIDAR are missing. All other recording continues."),
                tr("Check the robot and its network. The console reconnects automatically; press the key again to "
                    "drive."),
                until="connected", prevails=True,
            )  # fmt: skip
    if link.state != "connected":
        return
    yield from _movement(state.drive.value, state.robot.value)
    if state.frame.freshness == "lost" and state.frame.arrives_late:
        yield Condition(
            "picture", "warning", tr("The video from the camera {camera} is delayed.").format(
                camera=state.camera.value),
            tr("You cannot see the current view in front of the robot."),
            tr("Do not drive by this video. Check what slows down the network or the robot, or choose another "
                "camera (V)."),
            _SILENT_AFTER_S, until="picture",
        )  # fmt: skip
    elif state.frame.freshness == "lost":
        yield Condition(
            "picture", "warning", tr("No video from the camera {camera}.").format(camera=state.camera.value),
            tr("You cannot see what is in front of the robot, and no video is recorded."),
            tr("Do not drive without video. Check the camera, or choose another one (V)."),
            _SILENT_AFTER_S, until="picture",
        )  # fmt: skip
    if state.scan.freshness == "lost" and state.scan.arrives_late:
        yield Condition(
            "lidar", "warning", tr("The LIDAR scans are delayed."),
            tr("Obstacles are detected too late: the robot drives slowly."),
            tr("Check what slows down the network or the robot, and synchronise its clocks (NTP)."), _SILENT_AFTER_S,
        )  # fmt: skip
    elif state.scan.freshness == "lost":
        yield Condition(
            "lidar", "warning", tr("The LIDAR has stopped sending scans."),
            tr("Obstacles are not detected: the robot drives slowly or not at all."),
            tr("Check the LIDAR on the robot, and drive by sight only."), _SILENT_AFTER_S,
        )  # fmt: skip
    if not state.scan.age_known:
        yield Condition(
            "scan_age", "warning", tr("The age of the LIDAR scans is not known."),
            tr("Their timestamps differ from the robot’s clock by seconds or more. The obstacle guard uses "
                "their arrival time."),
            tr("Synchronise the clocks of the robot’s computers (NTP)."), _SILENT_AFTER_S,
        )  # fmt: skip
    charge = state.battery.value.charge_fraction if state.battery.value is not None else None
    if charge is not None and charge < (BATTERY_WELL if "battery" in standing else BATTERY_LOW):
        yield Condition(
            "battery", "warning", tr("The robot’s battery is at {percent} %.").format(percent=round(charge * 100)),
            tr("The robot may stop in the middle of the session."), tr("End the session, then charge the robot."),
        )  # fmt: skip


def _movement(drive: DriveStatus, robot: RobotProfile | None) -> Iterator[Condition]:
    """Alarm if odometry or the command topic contradicts our commands."""
    topic = robot.velocity.topic if robot is not None else "cmd_vel"
    who = tr("Nodes that publish {topic}: {nodes}.").format(topic=topic, nodes=", ".join(drive.velocity_publishers))
    if not drive.velocity_publishers:
        who = tr("The robot does not report which nodes publish {topic}.").format(topic=topic)
    stop_it = tr(
        "Press Stop (Esc). If the robot keeps moving, press the emergency stop (Esc Esc). Then find out what is "
        "driving it."
    )
    if drive.stopped:
        stop_it = tr("Use the stop on the robot itself.")
        if not drive.emergency_stop and robot is not None and robot.emergency_stop is not None:
            stop_it = tr(
                "Press the emergency stop (Esc Esc), which also activates the robot’s own, or use the stop "
                "on the robot."
            )
    match drive.movement:
        case "uncommanded" if drive.stopped:
            what = tr("The robot is moving although the emergency stop is active.")
            if not drive.emergency_stop:
                what = tr("The robot is moving although it was stopped.")
            yield Condition(
                "uncommanded", "error", what,
                tr(
                    "This console continuously sends zero velocity; something else is driving the "
                    "robot. {who}").format(who=who), stop_it,
            )  # fmt: skip
        case "uncommanded":
            yield Condition(
                "uncommanded", "warning", tr("The robot is moving without a command from this console."),
                tr("Someone is pushing the robot, or something else is driving it. {who}").format(who=who), stop_it,
            )  # fmt: skip
        case "commanded_elsewhere":
            yield Condition(
                "commanded_elsewhere", "error" if drive.stopped else "warning",
                tr("Something else is sending drive commands to the robot."),
                tr(
                    "The robot may move at any moment without a command from this console. "
                    "{who}").format(who=who), stop_it,
            )  # fmt: skip
        case "not_following":
            yield Condition(
                "not_following", "warning", tr("The robot does not follow the drive commands."),
                tr("The commands are sent, but the odometry does not show the movement."),
                tr("Check whether the robot’s own stop, a joystick, a lock (twist_mux) or a wall holds it. "
                    "Check that its rosbridge allows {topic} (topics_glob).").format(topic=topic),
            )  # fmt: skip
        case "silent":
            yield Condition(
                "movement_silent", "warning", tr("The robot does not report its movement: no odometry is received."),
                tr("The console does not know whether the robot is moving, and does not track its position."),
                tr("Watch the robot itself. Check its base driver, and 'odometry' in its profile."), 1.0,
            )  # fmt: skip


def _no_link_yet(state: LiveState) -> Condition:
    robot, advice = state.link.value.robot or tr("The robot"), no_answer_advice(state.robot.value)
    return Condition(
        "link", "error", tr("{robot} does not respond.").format(robot=robot),
        tr("Until it responds, the robot cannot be driven or seen, and its utterances wait."),
        tr(advice), until="connected", prevails=True,
    )  # fmt: skip
