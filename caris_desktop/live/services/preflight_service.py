"""Preflight service: evaluates checks continually, handles manual checks, and records them. GUI thread."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import field, replace
from functools import partial

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.address import is_loopback, without_credentials
from caris_desktop.domain.events import Event, LinkChanged, PreflightChecked, PreflightState, RobotChosen, SessionEnded
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.streams import Freshness, streams_voided_by
from caris_desktop.domain.translation import QT_TR_NOOP, localized, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.service import ContextService, Follows, Handlers, ServiceContext
from caris_desktop.live.services.microphone_service import participant_microphone
from caris_desktop.live.status import (
    IN_SESSION,
    AssistantStatus,
    DriveStatus,
    LinkStatus,
    ListeningStatus,
    MicrophoneStatus,
    PerceptionStatus,
    PreflightCheck,
    SpeechStatus,
    VoiceStatus,
)
from caris_desktop.people.presence import PersonRow
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.scenario.scenario_model import ManualCheck, Scenario, manual_checks

_POLL_EVERY_MS = 500
_DISK_EVERY_MS = 15_000
# Peak of a quiet word at two metres; a fan or hum stays below.
_LOUD = 0.04
_LINK_LOST = QT_TR_NOOP("Unticked because the connection to the robot was lost. Check again.")
_OTHER_ROBOT = QT_TR_NOOP("Unticked because another robot is connected. Check again.")
_NEXT_RECORDING = QT_TR_NOOP("Check again for the next recording.")

Disk = tuple[int | None, float | None]


class Facts(Value):
    """Facts used by the checks.

    ``link_for_s``: time since the link's last change. ``cameras``: freshness by camera; ``robot_freshness``, ``scan``
    and ``pose``: their freshness; ``robot_silent_s``: time since the robot's last message. ``robot_ahead_ms``: offset
    of the robot's clock from this computer's, None if unknown. ``microphone_chosen`` is False if the wizard selected
    none. ``loud``: it has received sound.
    """

    scenario: Scenario
    robot: RobotProfile | None = None
    link: LinkStatus = field(default_factory=LinkStatus)
    link_for_s: float = 0.0
    robot_freshness: Freshness = "none"
    robot_silent_s: float = 0.0
    robot_ahead_ms: float | None = None
    drive: DriveStatus = field(default_factory=DriveStatus)
    cameras: Mapping[str, Freshness] = field(default_factory=dict)
    scan: Freshness = "none"
    pose: Freshness = "none"
    has_map: bool = False
    charge_fraction: float | None = None
    free_bytes: int | None = None
    bytes_per_hour: float | None = None
    microphone: MicrophoneStatus = field(default_factory=MicrophoneStatus)
    microphone_chosen: bool = True
    loud: bool = False
    listening: ListeningStatus = field(default_factory=ListeningStatus)
    speech: SpeechStatus = field(default_factory=SpeechStatus)
    voice: VoiceStatus = field(default_factory=VoiceStatus)
    perception: PerceptionStatus = field(default_factory=PerceptionStatus)
    assistant: AssistantStatus = field(default_factory=AssistantStatus)
    people: tuple[PersonRow, ...] = ()

    @property
    def connected(self) -> bool:
        return self.link.state in ("connected", "trouble")


class ChecklistItem(Value):
    """Completion of a manual check."""

    at_ns: int
    actor: Actor


class PreflightService(ContextService):
    """Maintains ``state.preflight``. During a recording the automatic checks keep their results from its start."""

    def __init__(
        self,
        context: ServiceContext,
        *,
        disk: Callable[[Scenario], Disk],
        microphone_chosen: Callable[[], bool],
    ) -> None:
        """``disk`` returns free space and usage per hour; it reads files in a background thread."""
        super().__init__(context)
        state = context.state
        self._disk_of = disk
        self._microphone_chosen = microphone_chosen
        self._in_use: Scenario | None = None
        self._disk: Disk = (None, None)
        self._ticks: dict[str, ChecklistItem] = {}
        self._reason_open = ""
        self._withdrawn: frozenset[str] = frozenset()
        self._loud = False
        self._link_state: str = state.link.value.state
        self._link_since_ns = clock.now_ns()
        self._automatic: tuple[PreflightCheck, ...] = ()
        self._timer = new_timer(self, self.evaluate, _POLL_EVERY_MS)
        self._disk_timer = new_timer(self, self._check_disk, _DISK_EVERY_MS)
        for value in (state.link, state.recording):
            value.changed.connect(self.evaluate)
        self._emergency_stop = state.drive.value.emergency_stop
        state.drive.changed.connect(self._on_drive_changed)
        state.microphone.changed.connect(self._on_microphone_changed)

    def handlers(self) -> Handlers:
        return {intents.TickCheck: self._tick}

    def follows(self) -> Follows:
        return {
            LinkChanged: self._on_link_changed,
            RobotChosen: lambda _event: self._reset(_OTHER_ROBOT),
            SessionEnded: lambda _event: self._reset(_NEXT_RECORDING),
        }

    def use_scenario(self, scenario: Scenario) -> None:
        before, self._in_use = self._in_use, scenario
        if before is not None and before.path != scenario.path:
            self._reset("")
        if self._disk_timer.isActive():
            self._check_disk()
        self.evaluate()

    def start(self) -> None:
        self._timer.start()
        self._disk_timer.start()
        self._check_disk()

    def stop(self) -> None:
        self._timer.stop()
        self._disk_timer.stop()

    def waits_for(self) -> tuple[PreflightCheck, ...]:
        """Checks that a recording should not start without."""
        self.evaluate()
        return tuple(check for check in self._state.preflight.value if check.asks_first)

    def state_events(self, *, accepted: bool) -> list[Event]:
        """Results of all checks at the start of a recording. ``accepted``: the wizard starts in spite of open ones."""
        self.evaluate()
        now_ns, ticked, open_ = clock.now_ns(), QT_TR_NOOP("It was ticked."), QT_TR_NOOP("It was not ticked.")
        return [
            PreflightChecked(
                now_ns, check.id, check.title, check.state,
                check.detail or (ticked if check.state == "passed" else open_), check.manual,
                at_start=True, accepted=accepted and check.asks_first, checked_ns=check.checked_ns,
                actor=check.actor or CONSOLE,
            )
            for check in self._state.preflight.value
        ]  # fmt: skip

    def evaluate(self, _changed: object = None) -> None:
        """Evaluate the checks now."""
        scenario = self._in_use
        if scenario is None:
            return
        if self._state.link.value.state != self._link_state:
            self._link_state, self._link_since_ns = self._state.link.value.state, clock.now_ns()
        if self._state.recording.value.state not in IN_SESSION or not self._automatic:
            self._automatic = automatic_checks(self._facts(scenario))
        ticked = ticked_checks(scenario, self._ticks, self._reason_open, self._withdrawn)
        self._state.preflight.set((*self._automatic, *ticked))

    def _facts(self, scenario: Scenario) -> Facts:
        state = self._state
        link: LinkStatus = state.link.value
        freshest = min(
            (stream for stream in (state.odometry, state.scan, state.pose) if stream.value is not None),
            key=lambda stream: stream.silent_s() or 0.0,
            default=None,
        )
        anchor, offset_ms = state.present.anchor, link.clock_offset_ms
        ahead_ms = None if offset_ms is None else offset_ms - (anchor.utc_ns - anchor.monotonic_ns) / 1e6
        free_bytes, bytes_per_hour = self._disk
        return Facts(
            scenario,
            state.robot.value,
            link,
            link_for_s=(clock.now_ns() - self._link_since_ns) / 1e9,
            robot_freshness="none" if freshest is None else freshest.freshness,
            robot_silent_s=0.0 if freshest is None else freshest.silent_s() or 0.0,
            robot_ahead_ms=ahead_ms,
            drive=state.drive.value,
            cameras={name: state.frame_of(name).freshness for name in state.cameras.value},
            scan=state.scan.freshness,
            pose=state.pose.freshness,
            has_map=state.map.value is not None,
            charge_fraction=None if state.battery.value is None else state.battery.value.charge_fraction,
            free_bytes=free_bytes,
            bytes_per_hour=bytes_per_hour,
            microphone=state.microphone.value,
            microphone_chosen=self._microphone_chosen(),
            loud=self._loud,
            listening=state.listening.value,
            speech=state.speech.value,
            voice=state.voice.value,
            perception=state.perception.value,
            assistant=state.assistant.value,
            people=state.persons.value,
        )

    def _tick(self, intent: intents.TickCheck) -> None:
        check = next((one for one in self._state.preflight.value if one.id == intent.check_id and one.manual), None)
        if check is None:
            raise UserFacingError(
                tr("This check does not exist or cannot be ticked."),
                tr("Nothing was changed."),
                tr("Check the list of checks."),
            )
        now_ns = clock.now_ns()
        if intent.done:
            self._ticks[check.id] = ChecklistItem(now_ns, intent.actor)
        else:
            self._ticks.pop(check.id, None)
        self._bus.publish(
            PreflightChecked(
                now_ns, check.id, check.title, "passed" if intent.done else "not checked", manual=True,
                checked_ns=now_ns if intent.done else None, actor=intent.actor,
            )
        )  # fmt: skip
        self.evaluate()

    def _reset(self, reason: str) -> None:
        """Reset the manual checks; ``reason`` is shown for those that were done."""
        if self._ticks or not reason:
            self._reason_open, self._withdrawn = reason, frozenset(self._ticks)
        self._ticks.clear()
        self._loud = False
        self.evaluate()

    def _on_link_changed(self, event: LinkChanged) -> None:
        if event.link == "control" and streams_voided_by(event):
            self._reset(_LINK_LOST)

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        if drive.emergency_stop != self._emergency_stop:
            self._emergency_stop = drive.emergency_stop
            self.evaluate()

    def _on_microphone_changed(self, microphone: MicrophoneStatus) -> None:
        if microphone.state == "on" and microphone.level >= _LOUD and not self._loud:
            self._loud = True
            self.evaluate()

    def _check_disk(self) -> None:
        scenario = self._in_use
        if scenario is not None and self._state.recording.value.state not in IN_SESSION:
            self._slow_work.do(lambda: self._disk_of(scenario), self._on_disk_looked_at, lambda _failure: None)

    def _on_disk_looked_at(self, disk: Disk) -> None:
        self._disk = disk
        self.evaluate()


# Checks before a recording, one plain function per check. Checks that a scenario does not need are absent. Details
# change only visibly, since each change is recorded.


SIMULATED = "simulated"
_CONNECTS_WITHIN_S = 10.0
_CLOCK_KNOWN_WITHIN_S = 30.0
_CLOCK_UNCERTAIN_MS = 50.0
_CLOCK_AHEAD_MS = 1000.0
# A simulation clock starts at zero; its offset is meaningless.
_TIME_OF_ITS_OWN_MS = 1e9
_BATTERY_EMPTY, _BATTERY_LOW = 0.15, 0.3
# Size of an hour of video, if this study has no recordings yet.
_USUAL_HOUR_BYTES = 2e9


def automatic_checks(facts: Facts) -> tuple[PreflightCheck, ...]:
    """Checks that the scenario needs, in working order."""
    return tuple(check for run_check in _CHECKS if (check := run_check(facts)) is not None)


def ticked_checks(
    scenario: Scenario, ticks: Mapping[str, ChecklistItem], reason_open: str = "", withdrawn: Collection[str] = ()
) -> tuple[PreflightCheck, ...]:
    """The scenario's manual checks. ``reason_open``: reason why those in ``withdrawn`` are open again."""
    return tuple(
        _ticked(manual, ticks.get(of), reason_open if of in withdrawn else "")
        for manual in manual_checks(scenario.preflight)
        for of in (manual_id(manual),)
    )


def manual_id(manual: ManualCheck) -> str:
    return f"by hand: {manual.check}"


def _ticked(manual: ManualCheck, tick: ChecklistItem | None, reason_open: str) -> PreflightCheck:
    check = PreflightCheck(
        manual_id(manual), manual.check, detail=reason_open, advice=manual.advice, manual=True, needed=manual.needed
    )
    return check if tick is None else replace(check, state="passed", detail="", actor=tick.actor, checked_ns=tick.at_ns)


def _waits_for_robot(check: Callable[[PreflightState, str], PreflightCheck]) -> PreflightCheck:
    return check("not checked", QT_TR_NOOP("Checked once the robot is connected."))


def no_answer_advice(robot: RobotProfile | None) -> str:
    """Advice for a robot that does not answer."""
    if robot is not None and robot.name == SIMULATED:
        return QT_TR_NOOP("Start one: “Try it with the simulated robot” under Set up, in the Window menu.")
    if robot is not None and is_loopback(robot.address):
        # Shipped profiles default to this computer's address: the user has not entered the robot's yet.
        return QT_TR_NOOP(
            "Its address is this computer. Enter the robot’s own address: Window menu, Robot, “Connect "
            "another robot…”, which also offers this profile. If rosbridge runs on this computer, start it. "
            "The console tries again automatically."
        )
    return QT_TR_NOOP(
        "Turn on the robot, and check its network and its address: Window menu, Robot. The console tries "
        "again automatically."
    )


def _robot_check(facts: Facts) -> PreflightCheck:
    check = partial(PreflightCheck, "robot", QT_TR_NOOP("Robot is connected"))
    link = facts.link
    name = link.robot or QT_TR_NOOP("the robot")
    way = no_answer_advice(facts.robot)
    match link.state:
        case "connecting" if facts.link_for_s < _CONNECTS_WITHIN_S:
            return check("pending", localized(QT_TR_NOOP("Connecting to {robot}."), robot=name))
        case "connecting":
            if link.address:
                address = without_credentials(link.address)
                silent = localized(QT_TR_NOOP("{robot} does not respond at {address}."), robot=name, address=address)
            else:
                silent = localized(QT_TR_NOOP("{robot} does not respond yet."), robot=name)
            return check("major", silent, way)
        case "lost" | "closed":
            return check("major", localized(QT_TR_NOOP("{robot} is not connected."), robot=name), way)
        case "trouble":
            return check(
                "minor",
                localized(QT_TR_NOOP("The connection to {robot} is unstable."), robot=name),
                QT_TR_NOOP("Move closer to the router."),
            )
    if facts.robot_freshness in ("stale", "lost"):
        return check(
            "minor" if facts.robot_freshness == "stale" else "major",
            localized(QT_TR_NOOP("{robot} last sent data %n s ago.", "", round(facts.robot_silent_s)), robot=name),
            QT_TR_NOOP("Check the robot’s computer and the network."),
        )
    sends_state = facts.robot is None or facts.robot.odometry is not None or facts.robot.scan is not None
    if facts.robot_freshness == "none" and sends_state:
        silent = localized(QT_TR_NOOP("{robot} is connected and has not sent any data yet."), robot=name)
        if facts.link_for_s < _CONNECTS_WITHIN_S:
            return check("pending", silent)
        return check("minor", silent, QT_TR_NOOP("Start its sensors, and check the topic names in its profile."))
    return check("passed", localized(QT_TR_NOOP("{robot} is connected."), robot=name))


def _practice(facts: Facts) -> PreflightCheck | None:
    """Report a simulated robot, so that practice is not mistaken for data."""
    if facts.robot is None or facts.robot.name != SIMULATED:
        return None
    return PreflightCheck(
        "practice",
        QT_TR_NOOP("A real robot"),
        "minor",
        QT_TR_NOOP("The robot is simulated: recordings are practice, not data."),
        QT_TR_NOOP("Tick “Practice run” when you start, or connect your robot."),
    )


def _emergency_stop(facts: Facts) -> PreflightCheck | None:
    if not facts.scenario.permissions.driving:
        return None
    check = partial(PreflightCheck, "emergency_stop", QT_TR_NOOP("Emergency stop is released"))
    if facts.drive.emergency_stop:
        return check(
            "major",
            QT_TR_NOOP("The emergency stop is active: the robot will not move."),
            QT_TR_NOOP("Release it at the top right when everybody is clear of the robot."),
        )
    if not facts.connected:
        return _waits_for_robot(check)
    return check("passed", QT_TR_NOOP("The robot can move."))


def _video(facts: Facts) -> PreflightCheck | None:
    permissions = facts.scenario.permissions
    if not (permissions.video_recording or permissions.photos or permissions.driving):
        return None
    check = partial(PreflightCheck, "video", QT_TR_NOOP("Video arrives"))
    if not facts.cameras and facts.robot is not None and not facts.robot.cameras and not permissions.video_recording:
        return None  # no camera, and none needed
    late = [name for name, freshness in facts.cameras.items() if freshness == "stale"]
    missing = [name for name, freshness in facts.cameras.items() if freshness in ("none", "lost")]
    of_robot = {camera.name for camera in facts.robot.cameras} if facts.robot is not None else set()
    if not facts.connected and (not facts.cameras or (missing and of_robot.issuperset(missing))):
        return _waits_for_robot(check)
    if not facts.cameras:
        if facts.link_for_s < _CONNECTS_WITHIN_S:
            return check("pending", QT_TR_NOOP("Waiting for the first video."))
        return check("major", QT_TR_NOOP("No camera has sent video."), QT_TR_NOOP("Check the camera and its cable."))
    if missing:
        return check(
            "major",
            localized(QT_TR_NOOP("No video from {cameras}."), cameras=", ".join(missing)),
            QT_TR_NOOP("Check the camera and its cable."),
        )
    if late:
        return check(
            "minor",
            localized(QT_TR_NOOP("Video from {cameras} is delayed."), cameras=", ".join(late)),
            QT_TR_NOOP("Check the network; other programs may be using its bandwidth."),
        )
    return check("passed", localized(QT_TR_NOOP("Video arrives from {cameras}."), cameras=", ".join(facts.cameras)))


def _guard(facts: Facts) -> PreflightCheck | None:
    robot, drive = facts.robot, facts.drive
    if not facts.scenario.permissions.driving or (robot is not None and robot.scan is None):
        return None
    check = partial(PreflightCheck, "guard", QT_TR_NOOP("LIDAR and obstacle guard"))
    if robot is None or not facts.connected:
        return _waits_for_robot(check)
    if facts.scan == "none" and facts.link_for_s < _CONNECTS_WITHIN_S:
        return check("pending", QT_TR_NOOP("Waiting for the first scan."))
    if facts.scan in ("none", "lost"):
        return check(
            "major",
            QT_TR_NOOP("The LIDAR sends no scans, so obstacles are not detected."),
            QT_TR_NOOP("Check the LIDAR on the robot."),
        )
    if drive.guard == "overridden":
        return check(
            "minor", QT_TR_NOOP("The obstacle guard is turned off."), QT_TR_NOOP("Turn it on in the Drive panel.")
        )
    if drive.guard == "blind":
        return check(
            "major",
            drive.guard_detail or QT_TR_NOOP("The obstacle guard has no usable scans."),
            QT_TR_NOOP("Check the LIDAR on the robot."),
        )
    if not robot.guard.on:
        return check(
            "minor",
            QT_TR_NOOP("The robot profile does not use the console’s obstacle guard."),
            QT_TR_NOOP("Make sure that the robot’s own obstacle guard works."),
        )
    if facts.scan == "stale":
        return check(
            "minor", QT_TR_NOOP("Scans are delayed, so the robot is slowed down."), QT_TR_NOOP("Check the network.")
        )
    return check("passed", QT_TR_NOOP("Obstacles are detected, and the obstacle guard is on."))


def _battery(facts: Facts) -> PreflightCheck | None:
    if facts.robot is None or facts.robot.battery is None:
        return None
    check = partial(PreflightCheck, "battery", QT_TR_NOOP("Battery is charged"))
    charge = facts.charge_fraction
    if not facts.connected:
        return _waits_for_robot(check)
    if charge is None:
        return check("pending", QT_TR_NOOP("The robot has not reported its charge yet."))
    state: PreflightState = "major" if charge < _BATTERY_EMPTY else "minor" if charge < _BATTERY_LOW else "passed"
    advice = "" if state == "passed" else QT_TR_NOOP("Charge the robot first.")
    return check(state, localized(QT_TR_NOOP("{charge} % left."), charge=round(charge * 100)), advice)


def _position(facts: Facts) -> PreflightCheck | None:
    if not (facts.scenario.permissions.driving and facts.scenario.places):
        return None
    check = partial(PreflightCheck, "position", QT_TR_NOOP("Robot position is known"))
    if not facts.connected:
        return _waits_for_robot(check)
    if facts.link_for_s < _CONNECTS_WITHIN_S and (not facts.has_map or facts.pose == "none"):
        return check("pending", QT_TR_NOOP("Waiting for the map and the robot’s position."))
    if not facts.has_map:
        return check(
            "major",
            QT_TR_NOOP("There is no map, so the robot cannot go to places."),
            QT_TR_NOOP("Start the robot’s navigation, or load a map in the Map panel."),
        )
    if facts.pose == "none":
        return check(
            "major",
            QT_TR_NOOP("The robot’s position on the map is not known, so it cannot go to places."),
            QT_TR_NOOP("Set its position with “Robot is here” in the Map panel."),
        )
    if facts.pose != "fresh":
        return check(
            "minor", QT_TR_NOOP("The robot’s position is outdated."), QT_TR_NOOP("Drive a little and watch the map.")
        )
    return check("passed", QT_TR_NOOP("Map and position are available."))


def _clock(facts: Facts) -> PreflightCheck:
    check = partial(PreflightCheck, "clock", QT_TR_NOOP("Robot’s clock is known"))
    link = facts.link
    if not facts.connected:
        return _waits_for_robot(check)
    if link.clock_offset_ms is None or link.clock_uncertainty_ms is None:
        if facts.link_for_s < _CLOCK_KNOWN_WITHIN_S:
            return check("pending", QT_TR_NOOP("The robot clock is being compared with this computer’s."))
        return check(
            "minor",
            QT_TR_NOOP("The robot does not report its time, so its timestamps cannot be aligned exactly."),
            QT_TR_NOOP("Start rosapi on the robot."),
        )
    if link.clock_uncertainty_ms > _CLOCK_UNCERTAIN_MS:
        return check(
            "minor",
            QT_TR_NOOP("The robot clock is uncertain by more than 50 ms."),
            QT_TR_NOOP("Check the network to the robot."),
        )
    ahead_ms = facts.robot_ahead_ms
    if ahead_ms is not None and _CLOCK_AHEAD_MS < abs(ahead_ms) < _TIME_OF_ITS_OWN_MS:
        return check(
            "minor",
            QT_TR_NOOP("The robot clock is more than a second off; the recording corrects this."),
            QT_TR_NOOP("Synchronise the robot’s clock over the network (NTP) so that its own logs match."),
        )
    return check("passed", QT_TR_NOOP("The robot clock is continuously compared with this computer’s."))


def _disk(facts: Facts) -> PreflightCheck:
    check = partial(PreflightCheck, "disk", QT_TR_NOOP("Disk space for an hour"))
    free = facts.free_bytes
    if free is None:
        return check("pending", QT_TR_NOOP("The disk is being checked."))
    hours = free / (facts.bytes_per_hour or _USUAL_HOUR_BYTES)
    if hours < 1.0:
        return check(
            "major",
            QT_TR_NOOP("There is space for %n minutes.", "", int(hours * 60)),
            QT_TR_NOOP("Free some disk space."),
        )
    if hours < 2.0:
        return check(
            "minor", QT_TR_NOOP("There is space for little more than an hour."), QT_TR_NOOP("Free some disk space.")
        )
    if hours >= 24.0:
        return check("passed", QT_TR_NOOP("There is space for more than a day."))
    return check("passed", QT_TR_NOOP("There is space for %n hours.", "", int(hours)))


def _microphone(facts: Facts) -> PreflightCheck | None:
    permissions, microphone = facts.scenario.permissions, facts.microphone
    if not (permissions.audio_recording or permissions.transcription):
        return None
    check = partial(PreflightCheck, "microphone", QT_TR_NOOP("Microphone works"))
    if not facts.microphone_chosen:
        return check(
            "minor",
            QT_TR_NOOP("No microphone is chosen: the participant’s speech is not recorded."),
            QT_TR_NOOP("Choose one in the Window menu, under Participant’s microphone."),
        )
    if not facts.connected and participant_microphone(facts.scenario, facts.robot) == "robot":
        return _waits_for_robot(check)
    match microphone.state:
        case "failed":
            return check(
                "major",
                microphone.detail or QT_TR_NOOP("The microphone cannot be opened."),
                QT_TR_NOOP("Plug it in, or choose another."),
            )
        case "starting":
            return check("pending", QT_TR_NOOP("The microphone is being opened."))
    if facts.loud:
        return check("passed", QT_TR_NOOP("The microphone picks up sound."))
    if microphone.state == "on":
        return check(
            "pending",
            QT_TR_NOOP("The microphone has not picked up any sound yet."),
            QT_TR_NOOP("Say a few words at the participant’s position."),
        )
    return check(
        "not checked",
        QT_TR_NOOP("The microphone has not been tested yet."),
        QT_TR_NOOP("Test it, and say a few words."),
    )


def _listening(facts: Facts) -> PreflightCheck | None:
    if not facts.scenario.permissions.transcription:
        return None
    check = partial(PreflightCheck, "listening", QT_TR_NOOP("Speech is transcribed"))
    listening = facts.listening
    match listening.state:
        case "ready":
            return check("passed", QT_TR_NOOP("The recogniser is ready."))
        case "failed":
            return check(
                "minor",
                listening.detail or QT_TR_NOOP("The recogniser does not work."),
                QT_TR_NOOP("Type notes instead, or restart the program."),
            )
        case "loading":
            return check("pending", QT_TR_NOOP("The recogniser is being loaded."))
    return check("not checked", QT_TR_NOOP("Transcription starts when the microphone is open."))


def _voice(facts: Facts) -> PreflightCheck | None:
    if not facts.scenario.permissions.speech:
        return None
    check = partial(PreflightCheck, "voice", QT_TR_NOOP("Robot can speak"))
    speech, robot = facts.speech, facts.robot
    mute = facts.voice.output != "computer" and robot is not None and robot.speech is None
    if facts.voice.output == "robot" and not mute:
        if robot is None or not facts.connected:
            return _waits_for_robot(check)
        return check("passed", QT_TR_NOOP("The robot speaks with its own voice."))
    if speech.ready and speech.detail:
        return check("major", speech.detail, QT_TR_NOOP("Check this computer’s sound output."))
    if speech.ready and mute:
        return check(
            "minor",
            QT_TR_NOOP("The robot has no voice: this computer speaks instead."),
            QT_TR_NOOP("Put a loudspeaker near the robot, or configure its speech in its profile."),
        )
    if speech.ready:
        return check("passed", QT_TR_NOOP("The voice is ready."))
    if speech.detail:
        return check("major", speech.detail, QT_TR_NOOP("Choose another voice in the Speak panel."))
    return check("pending", QT_TR_NOOP("The voice is being loaded."))


def _people(facts: Facts) -> PreflightCheck | None:
    scenario, perception = facts.scenario, facts.perception
    covers = scenario.covers_people
    if not (covers or scenario.permissions.naming_people):
        return None
    check = partial(
        PreflightCheck,
        "people",
        QT_TR_NOOP("People are detected and pixelated") if covers else QT_TR_NOOP("People are detected"),
    )
    match perception.state:
        case "ready":
            return check("passed", QT_TR_NOOP("The detector is ready."))
        case "failed" if covers:
            return check(
                "major",
                QT_TR_NOOP("The detector does not work: every saved picture is completely pixelated."),
                QT_TR_NOOP("Restart the program; the Diagnostics panel has the details."),
            )
        case "failed":
            return check(
                "minor",
                QT_TR_NOOP("The detector does not work: people are not detected."),
                QT_TR_NOOP("Restart the program; the Diagnostics panel has the details."),
            )
    return check("pending", QT_TR_NOOP("The detector is being loaded."))


def _consent(facts: Facts) -> PreflightCheck | None:
    """Only if the scenario leaves consenting people unblurred."""
    scenario = facts.scenario
    if not (scenario.covers_people and scenario.blur.who == "without_consent"):
        return None
    check = partial(PreflightCheck, "consent", QT_TR_NOOP("Consent is noted"))
    here = [person for person in facts.people if person.here]
    kind = "video" if scenario.permissions.video_recording else "photo"
    without = sum(kind not in person.consents for person in here)
    if not here:
        return check("pending", QT_TR_NOOP("Checked once a person is in front of the robot."))
    if without:
        return check(
            "minor",
            localized(QT_TR_NOOP("People here pixelated because no consent is noted: {count}."), count=without),
            QT_TR_NOOP("If they have agreed, note it in the People panel."),
        )
    return check("passed", QT_TR_NOOP("Everybody here has given consent."))


def _model(facts: Facts) -> PreflightCheck | None:
    if not facts.scenario.permissions.assistant:
        return None
    check = partial(PreflightCheck, "model", QT_TR_NOOP("Language model answers"))
    assistant = facts.assistant
    match assistant.state:
        case "ready" | "answering":
            return check("passed", localized(QT_TR_NOOP("{model} is ready."), model=assistant.model or "–"))
        case "failed":
            return check(
                "minor",
                assistant.detail or QT_TR_NOOP("The model does not respond."),
                QT_TR_NOOP("Choose another model in the Assistant panel; you can speak without one."),
            )
    return check("pending", QT_TR_NOOP("The model is being loaded."))


_CHECKS: tuple[Callable[[Facts], PreflightCheck | None], ...] = (
    _robot_check,
    _practice,
    _emergency_stop,
    _video,
    _guard,
    _battery,
    _position,
    _clock,
    _disk,
    _microphone,
    _listening,
    _voice,
    _people,
    _consent,
    _model,
)
