"""Preflight service: evaluates checks continually, handles manual checks, and records them. GUI thread."""

from collections.abc import Callable

from PySide6.QtCore import QObject, QTimer

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE
from caris_desktop.domain.events import Event, LinkChanged, PreflightChecked, RobotChosen, SessionEnded
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.streams import streams_voided_by
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.preflight_checks import ChecklistItem, Facts, automatic_checks, ticked_checks
from caris_desktop.live.service import Follows, Handlers, Service
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import IN_SESSION, DriveStatus, LinkStatus, MicrophoneStatus, PreflightCheck
from caris_desktop.scenario.scenario_model import Scenario

_POLL_EVERY_MS = 500
_DISK_EVERY_MS = 15_000
# Peak of a quiet word at two metres; a fan or hum stays below.
_LOUD = 0.04
_LINK_LOST = QT_TR_NOOP("Unticked because the connection to the robot was lost. Check again.")
_OTHER_ROBOT = QT_TR_NOOP("Unticked because another robot is connected. Check again.")
_NEXT_RECORDING = QT_TR_NOOP("Check again for the next recording.")

Disk = tuple[int | None, float | None]


class PreflightService(Service):
    """Maintains ``state.preflight``. During a recording the automatic checks keep their results from its start."""

    def __init__(
        self,
        state: LiveState,
        publish: Callable[[Event], None],
        slow_work: BackgroundWorker,
        *,
        disk: Callable[[Scenario], Disk],
        microphone_chosen: Callable[[], bool],
        parent: QObject | None = None,
    ) -> None:
        """``disk`` returns free space and usage per hour; it reads files in a background thread."""
        super().__init__(parent)
        self._state = state
        self._publish = publish
        self._slow_work = slow_work
        self._disk_of = disk
        self._microphone_chosen = microphone_chosen
        self._scenario: Scenario | None = None
        self._disk: Disk = (None, None)
        self._ticks: dict[str, ChecklistItem] = {}
        self._reason_open = ""
        self._withdrawn: frozenset[str] = frozenset()
        self._loud = False
        self._link_state: str = state.link.value.state
        self._link_since_ns = clock.now_ns()
        self._automatic: tuple[PreflightCheck, ...] = ()
        self._timer = QTimer(self, interval=_POLL_EVERY_MS)
        self._timer.timeout.connect(self.evaluate)
        self._disk_timer = QTimer(self, interval=_DISK_EVERY_MS)
        self._disk_timer.timeout.connect(self._check_disk)
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
            RobotChosen: self._on_robot_chosen,
            SessionEnded: self._on_session_ended,
        }

    def use_scenario(self, scenario: Scenario) -> None:
        before, self._scenario = self._scenario, scenario
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
        now_ns = clock.now_ns()
        return [
            PreflightChecked(
                now_ns, check.id, check.title, check.state, check.detail or _ticked_words(check), check.manual,
                at_start=True, accepted=accepted and check.asks_first, checked_ns=check.checked_ns,
                actor=check.actor or CONSOLE,
            )
            for check in self._state.preflight.value
        ]  # fmt: skip

    def evaluate(self, _changed: object = None) -> None:
        """Evaluate the checks now."""
        scenario = self._scenario
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
        self._publish(
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

    def _on_link_changed(self, event: LinkChanged) -> None:
        if event.link == "control" and streams_voided_by(event):
            self._reset(_LINK_LOST)
            self.evaluate()

    def _on_robot_chosen(self, _event: RobotChosen) -> None:
        self._reset(_OTHER_ROBOT)
        self.evaluate()

    def _on_session_ended(self, _event: SessionEnded) -> None:
        self._reset(_NEXT_RECORDING)
        self.evaluate()

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        if drive.emergency_stop != self._emergency_stop:
            self._emergency_stop = drive.emergency_stop
            self.evaluate()

    def _on_microphone_changed(self, microphone: MicrophoneStatus) -> None:
        if microphone.state == "on" and microphone.level >= _LOUD and not self._loud:
            self._loud = True
            self.evaluate()

    def _check_disk(self) -> None:
        scenario = self._scenario
        if scenario is not None and self._state.recording.value.state not in IN_SESSION:
            self._slow_work.do(lambda: self._disk_of(scenario), self._on_disk_looked_at, lambda _failure: None)

    def _on_disk_looked_at(self, disk: Disk) -> None:
        self._disk = disk
        self.evaluate()


def _ticked_words(check: PreflightCheck) -> str:
    return QT_TR_NOOP("It was ticked.") if check.state == "passed" else QT_TR_NOOP("It was not ticked.")
