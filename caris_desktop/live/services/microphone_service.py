"""Microphone service: which microphone records participant and wizard, and when they are open. GUI thread.

The inputs of this computer have a process each; the participant's microphone may also be on the robot or a camera.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np
from PySide6.QtCore import QObject

from caris_desktop.conversation.sound_devices import (
    CloseMicrophone,
    MicrophoneFailed,
    MicrophoneLevel,
    MicrophoneList,
    MicrophoneOpened,
    OpenMicrophone,
)
from caris_desktop.domain import clock, intents
from caris_desktop.domain.events import LinkChanged
from caris_desktop.domain.link_commands import ListenToRobot
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import MICROPHONE, ROBOT_MICROPHONE, WIZARD_MICROPHONE
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.service import (
    PANELS_FIRST_MS,
    ContextService,
    Follows,
    Handlers,
    Restarts,
    ServiceContext,
    SupervisedProcess,
    localize_problem,
)
from caris_desktop.live.state import LiveValue
from caris_desktop.live.status import MicrophoneStatus
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.scenario.scenario_model import Scenario

_OPENS_WITHIN_MS = 4000
_TRIED_FOR_MS = 20_000
Need = Literal["recording", "transcription", "hearing", "trying"]
"""Purpose of an open microphone. Each has its own permission."""


class MicrophoneChoice(Value):
    """``chosen`` returns the saved selection (None: no microphone, empty: the system's), ``keep`` saves it."""

    body: ProcessSpec
    chosen: Callable[[], str | None]
    keep: Callable[[str | None], None]


class MicrophoneAdapters(Value):
    """Microphones of this computer."""

    participant: MicrophoneChoice
    wizard: MicrophoneChoice


class MicrophoneService(ContextService):
    """Opens the participant's microphone while any permitted purpose needs it, recording or not."""

    def __init__(
        self,
        context: ServiceContext,
        parts: MicrophoneAdapters,
        *,
        to_robot: Callable[[ListenToRobot], object],
        hear_camera: Callable[[str, bool], None],
    ) -> None:
        """``to_robot`` sends to the link with the robot's audio; ``hear_camera`` switches a camera's microphone."""
        super().__init__(context)
        self._to_robot = to_robot
        self._hear_camera = hear_camera
        self._distant = RemoteMicrophone(self._state.microphone, self._bus, settled=self._on_settled, parent=self)
        self._participant = LocalMicrophone(
            self._state.microphone, MICROPHONE, context, parts.participant, settled=self._on_settled
        )
        self._wizard = LocalMicrophone(self._state.wizard_microphone, WIZARD_MICROPHONE, context, parts.wizard)
        self._needs: set[Need] = set()
        self._started = False
        self._then: Callable[[], None] | None = None
        self._missing_since_ns: int | None = None
        self._soon = new_timer(self, self._get_ready, PANELS_FIRST_MS, single_shot=True)
        self._patience = new_timer(self, self._on_missing_timeout, _OPENS_WITHIN_MS, single_shot=True)
        self._tried = new_timer(self, self._try_no_longer, _TRIED_FOR_MS, single_shot=True)
        self._state.robot.changed.connect(self._on_robot_changed)

    @property
    def names(self) -> tuple[str, ...]:
        """Inputs of this computer."""
        return self._participant.names or self._wizard.names

    @property
    def chosen(self) -> str | None:
        """Participant's microphone on this computer. None for no microphone, also if the computer has none."""
        match self.current:
            case "computer":
                return self._participant.chosen
            case "none":
                return None
        return ""

    @property
    def current(self) -> str:
        """Current microphone of the participant: ``robot``, ``computer``, ``camera:NAME`` or ``none``."""
        return participant_microphone(self._scenario, self._state.robot.value)

    @property
    def records(self) -> bool:
        """Whether it is open for a recording."""
        return "recording" in self._needs

    def handlers(self) -> Handlers:
        return {intents.UseMicrophone: self._use, intents.TryMicrophone: lambda intent: self._try(intent.on)}

    def follows(self) -> Follows:
        return {LinkChanged: self._on_link_changed}

    def supervised(self) -> tuple[SupervisedProcess, ...]:
        return self._participant.process, self._wizard.process

    def use_scenario(self, scenario: Scenario) -> None:
        """Apply a scenario; without a purpose the inputs are only listed."""
        self._scenario = scenario
        if not scenario.permissions.audio_recording:
            self.wait_no_longer()
            self._try(False)
            self.close()
        elif self._is_to_record(scenario) and not (self._started and self._is_to_be_started):
            self.open()
        if self._started:
            self._begin_with(scenario)
            self._soon.start()

    def start(self) -> None:
        self._started = True
        self._begin_with(self._scenario)
        self._get_ready()

    def _begin_with(self, scenario: Scenario) -> None:
        if not self._may_record_participant(scenario) and not scenario.sound.hear:
            self._participant.dismiss()
        if not _may_record_wizard(scenario):
            self.close_wizards()
            self._wizard.dismiss()
        self._need("transcription", scenario.permissions.transcription)

    def _get_ready(self) -> None:
        if self._is_to_record(self._scenario):
            self.open()
        if self._may_record_participant(self._scenario):
            self._participant.get_ready()
        if _may_record_wizard(self._scenario):
            self._wizard.get_ready()

    def _is_to_record(self, scenario: Scenario) -> bool:
        recording = self._state.recording.value.state
        return scenario.permissions.audio_recording and recording in ("starting", "recording")

    @property
    def _is_to_be_started(self) -> bool:
        """Whether audio needs a process that is not running yet, which starts more slowly than a scenario opens."""
        return self.current == "computer" and self._participant.process.child is None

    def _may_record_participant(self, scenario: Scenario) -> bool:
        permissions = scenario.permissions
        return self.current == "computer" and (permissions.audio_recording or permissions.transcription)

    def _use(self, intent: intents.UseMicrophone) -> None:
        (self._participant if intent.role == "participant" else self._wizard).use(intent.microphone)

    def open_and_then(self, then: Callable[[], None]) -> None:
        """Listen for a recording, and call ``then`` once audio arrives, none can be expected, or the timeout has
        passed.

        Closing it meanwhile cancels ``then``.
        """
        self.open()
        self._then = then
        if self._state.microphone.value.state == "starting":
            self._patience.start()
        else:
            self.wait_no_longer()

    def wait_no_longer(self) -> None:
        """Run the pending ``then`` now."""
        then, self._then = self._then, None
        self._patience.stop()
        if then is not None:
            then()

    def open(self) -> None:
        """Open for a recording."""
        self._need("recording", True)

    def close(self) -> None:
        """Close after a recording."""
        self._then = self._missing_since_ns = None
        self._patience.stop()
        self._need("recording", False)

    # Wizard's microphone

    @property
    def wizards_choice(self) -> str | None:
        """Selected microphone; None for none, also if the computer has none."""
        return self._wizard.chosen

    def open_wizards(self) -> None:
        """Open the wizard's microphone and forward its audio."""
        self._wizard.sends = True
        self._wizard.open()

    def mute_wizards(self) -> None:
        """Stop forwarding audio; the microphone stays open."""
        self._wizard.sends = False

    def close_wizards(self) -> None:
        self.mute_wizards()
        self._wizard.close()

    def _try(self, on: bool) -> None:
        """Test the microphone for some seconds; it closes automatically."""
        (self._tried.start if on else self._tried.stop)()
        self._need("trying", on)

    def _try_no_longer(self) -> None:
        self._try(False)

    def need_hearing(self, needed: bool) -> None:
        """Open or close for the wizard to listen."""
        self._need("hearing", needed)

    def _need(self, need: Need, needed: bool) -> None:
        if needed:
            self._needs.add(need)
        else:
            self._needs.discard(need)
        self._arrange()

    def _arrange(self) -> None:
        """Open what is needed, after closing the rest: both share one status."""
        source = self.current if self._needs else "none"
        robot = self._state.robot.value
        if self._scenario.sound.ear == "auto" and robot is None and not self.records:
            source = "none"  # the robot is not known yet
        if source != "computer":
            self._participant.close()
        if source in ("computer", "none"):
            self._distant.close()
        camera = source.removeprefix("camera:")
        if source == "robot":
            self._distant.open(
                "the robot's microphone",
                lambda on: self._to_robot(ListenToRobot(clock.now_ns(), on)),
                reachable=lambda: bool(self._state.link.value.state == "connected"),
            )
        elif camera != source:
            self._distant.open(f"the microphone of the camera {camera}", partial(self._hear_camera, camera))
        elif source == "computer":
            self._participant.open()

    def _on_link_changed(self, event: LinkChanged) -> None:
        # A restarted link process has lost earlier requests.
        if event.link == "media" and event.state == "connecting":
            self._distant.ask_again()

    def _on_robot_changed(self, _robot: object) -> None:
        if self._started:
            self._begin_with(self._scenario)
            self._get_ready()

    def _on_missing_timeout(self) -> None:
        self._missing_since_ns = clock.now_ns()
        self.wait_no_longer()

    def _on_settled(self) -> None:
        if self._state.microphone.value.state == "on" and self._missing_since_ns is not None:
            missing_s = (clock.now_ns() - self._missing_since_ns) / 1e9
            self._missing_since_ns = None
            self._bus.problem(
                "info",
                tr("The microphone started {late} s after the recording.").format(late=f"{missing_s:.1f}"),
                tr("Its sound before that is missing from the recording."),
                "",
            )
        self.wait_no_longer()

    def stop(self) -> None:
        self._soon.stop()
        self._patience.stop()
        self._tried.stop()
        self._distant.close()
        self._participant.ask_to_end()
        self._wizard.ask_to_end()


def _may_record_wizard(scenario: Scenario) -> bool:
    return scenario.permissions.own_voice or scenario.permissions.transcription


# The audio library may hang its process, which therefore sends a sign of life each second.
_STUCK_AFTER_MS, _STARTS_WITHIN_MS = 6000, 30_000
# After working this long, the restart limit is reset.
_WELL_AFTER_MS = 60_000


class LocalMicrophone(QObject):
    """Maintains ``status``, a MicrophoneStatus, and reports problems. Its audio goes to the bus while it ``sends``."""

    def __init__(
        self,
        status: LiveValue,
        source: str,
        context: ServiceContext,
        choice: MicrophoneChoice,
        *,
        settled: Callable[[], None] = lambda: None,
    ) -> None:
        """``settled`` is called when audio arrives, or when none can be expected for now."""
        super().__init__(context.parent)
        self._status = status
        self._off = MicrophoneStatus(role=status.value.role)
        self._source = source
        self._bus, self._children = context.bus, context.children
        self._choice = choice
        self._settled = settled
        self.process = SupervisedProcess(
            context.children,
            ended=self._on_ended,
            on_message=self.on_message,
            reads=self._read,
            name=choice.body.name,
        )
        self.sends = True
        self.names: tuple[str, ...] = ()
        self._looked = False
        self._begun = False
        """Whether the process that runs now has said anything yet."""
        self._chosen = choice.chosen()
        self._listens_to: str | None = None
        self._open = False
        self._stuck = new_timer(self, self.process.kill, _STUCK_AFTER_MS, single_shot=True)
        self._well = new_timer(self, self._on_well, _WELL_AFTER_MS, single_shot=True)

    @property
    def chosen(self) -> str | None:
        """Selected microphone; None for none, also if the computer has none."""
        return None if self._looked and not self.names else self._chosen

    def get_ready(self) -> None:
        """List the available inputs."""
        if self.process.child is None and not self.process.restarts.exhausted:
            self._begun = False
            self.process.start(self._choice.body)

    def use(self, name: str | None) -> None:
        if name != self._chosen:
            self._chosen = name
            self._choice.keep(name)
            if self._open:
                self.open()

    def open(self) -> None:
        """Start listening, if a microphone is selected."""
        status: MicrophoneStatus = self._status.value
        if self._open and self._listens_to == self._chosen and status.state in ("starting", "on"):
            return
        self._open = True
        self._listens_to = self._chosen
        if self._chosen is None:
            self._report_closed()
            self._settled()
            return
        self.get_ready()
        if self.process.child is None:
            self._show("failed", self._chosen, detail=QT_TR_NOOP("It failed too often."))
            self._settled()
        else:
            self._show("starting", self._chosen)
            self._stuck.start(_STUCK_AFTER_MS if self._begun else _STARTS_WITHIN_MS)
            self.process.send(OpenMicrophone(self._chosen))

    def close(self) -> None:
        if self._open:
            self._open = False
            self._report_closed()

    def dismiss(self) -> None:
        """End the process: this scenario does not use it."""
        self.close()
        self.process.dismiss()

    def ask_to_end(self) -> None:
        self._stuck.stop()
        self._well.stop()
        self.process.ask_to_end()

    def _report_closed(self) -> None:
        self._stuck.stop()
        self._well.stop()
        self.process.send(CloseMicrophone())
        self._status.set(self._off)

    def _show(self, state: Any, name: str, *, level: float = 0.0, detail: str = "") -> None:
        self._status.set(replace(self._off, state=state, name=name, level=level, detail=detail, source=self._source))

    def _read(self, value: Any, raw: bytes) -> None:  # reader thread
        if self.sends or not isinstance(value, AudioChunk):
            self._children.pass_on(self.on_message, value, raw)

    def on_message(self, message: Any) -> None:
        """Handle a message of the process."""
        self._begun = True
        if self._stuck.isActive():
            self._stuck.start(_STUCK_AFTER_MS)
        name = self._status.value.name
        match message:
            case MicrophoneList(names):
                self.names, self._looked = names, True
            case MicrophoneOpened(opened) if self._open:
                self._show("on", opened)
                self._well.start()
                self._settled()
            case MicrophoneLevel(peak) if self._open:
                self._show("on", name, level=round(peak, 3))
            case MicrophoneFailed(problem) if self._open:
                detail = QT_TR_NOOP("No microphone is plugged in.") if problem is None else problem.what
                self._show("failed", name, detail=detail)
                self._settled()
                if problem is not None:
                    self._bus.publish(localize_problem(problem))

    def _on_well(self) -> None:
        self.process.restarts = Restarts()

    def _on_ended(self) -> None:
        """Restart the process if it is needed."""
        restarts = self.process.restarts
        if not self._open:
            restarts.another()
            return
        self._open = False
        restarts.after_end(self._report_ended, self.open)
        if restarts.exhausted:
            self.open()  # shows the failure

    def _report_ended(self, advice: str) -> None:
        is_wizards = self._source == WIZARD_MICROPHONE
        self._bus.problem(
            "warning",
            tr("Your microphone stopped unexpectedly.") if is_wizards else tr("The microphone stopped unexpectedly."),
            tr("Its sound is missing from now on.")
            if self.process.restarts.exhausted
            else tr("A short part of its sound is missing."),
            advice,
            until="own_microphone" if is_wizards else "microphone",
        )


_POLL_EVERY_MS = 200
_SILENT_NS = 3_000_000_000
_OFF = MicrophoneStatus()


def participant_microphone(scenario: Scenario, robot: RobotProfile | None) -> str:
    """Microphone of the participant with this robot: ``robot``, ``computer``, ``camera:NAME`` or ``none``."""
    hears = robot is not None and robot.audio is not None and robot.audio.topic is not None
    return scenario.sound.resolve_microphone(robot_hears=hears)


class RemoteMicrophone(QObject):
    """Requests audio, maintains ``status``, and reports missing audio."""

    def __init__(self, status: LiveValue, bus: Bus, *, settled: Callable[[], None], parent: QObject) -> None:
        """``settled`` is called when audio arrives, or when none can be expected for now."""
        super().__init__(parent)
        self._status = status
        self._bus = bus
        self._settled = settled
        self._reachable: Callable[[], bool] = lambda: True
        self._ask: Callable[[bool], object] | None = None
        self._robot_name = ""
        self._received_ns = self._requested_ns = self._unreachable_ns = 0
        self._peak = 0
        self._silence_reported = False
        self._check_timer = new_timer(self, self.update_status, _POLL_EVERY_MS)
        bus.tap(self._on_sound, (AudioChunk,))

    def open(self, whose: str, ask: Callable[[bool], object], *, reachable: Callable[[], bool] = lambda: True) -> None:
        """Start listening. ``whose``: name of the microphone; ``ask`` requests or ends its audio.

        While the source is not ``reachable``, missing audio is not reported, as its cause is known.
        """
        if self._robot_name == whose:
            return
        self.close()
        self._robot_name, self._ask, self._reachable = whose, ask, reachable
        self._requested_ns, self._silence_reported = clock.now_ns(), False
        self._show("starting")
        self._check_timer.start()
        ask(True)

    def ask_again(self) -> None:
        """Request again after a restart of the source."""
        if self._ask is not None:
            self._ask(True)

    def close(self) -> None:
        ask, self._ask, self._robot_name = self._ask, None, ""
        self._check_timer.stop()
        if ask is not None:
            ask(False)
            self._status.set(_OFF)

    def _on_sound(self, chunk: AudioChunk, _raw: bytes | None) -> None:  # any thread
        if chunk.source == ROBOT_MICROPHONE:
            self._received_ns = clock.now_ns()
            self._peak = max(self._peak, int(np.abs(chunk.samples.astype(np.int32)).max(initial=0)))

    def update_status(self) -> None:
        """Update the status from the audio received so far."""
        now_ns = clock.now_ns()
        before: MicrophoneStatus = self._status.value
        if not self._reachable():
            self._unreachable_ns = now_ns
        if self._received_ns > self._requested_ns and now_ns - self._received_ns < _SILENT_NS:
            peak, self._peak = self._peak, 0
            self._silence_reported = False
            self._show("on", level=round(peak / 32768, 3))
            if before.state != "on":
                self._settled()
        elif now_ns - max(self._received_ns, self._requested_ns) >= _SILENT_NS and not self._silence_reported:
            if before.state != "failed":
                self._show("failed", detail=QT_TR_NOOP("It sends no sound."))
                self._settled()
            if now_ns - self._unreachable_ns <= _SILENT_NS:
                return
            self._silence_reported = True
            self._bus.problem(
                "warning",
                tr("An open microphone sends no sound: {microphone}.").format(microphone=self._robot_name),
                tr("Speech there is not heard, recorded or transcribed until the microphone works again."),
                tr("Check its connection, and check that the robot publishes its sound as specified in the profile."),
                until="microphone",
                cause="robot_sound",
            )

    def _show(self, state: Any, *, level: float = 0.0, detail: str = "") -> None:
        self._status.set(
            replace(_OFF, state=state, name=self._robot_name, level=level, detail=detail, source=ROBOT_MICROPHONE)
        )
