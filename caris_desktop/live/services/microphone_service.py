"""Microphone service: which microphone records participant and wizard, and when they are open. GUI thread."""

from collections.abc import Callable
from functools import partial
from typing import Literal

from PySide6.QtCore import QObject, QTimer

from caris_desktop.domain import clock, intents
from caris_desktop.domain.events import LinkChanged
from caris_desktop.domain.link_commands import ListenToRobot
from caris_desktop.domain.sound_values import MICROPHONE, WIZARD_MICROPHONE
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ChildProcess
from caris_desktop.live.local_microphone import LocalMicrophone, MicrophoneChoice
from caris_desktop.live.process_manager import ProcessManager
from caris_desktop.live.remote_microphone import RemoteMicrophone, participant_microphone
from caris_desktop.live.service import PANELS_FIRST_MS, Follows, Handlers, Restarts, Service
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.scenario_model import Scenario

_OPENS_WITHIN_MS = 4000
_TRIED_FOR_MS = 20_000
Need = Literal["recording", "transcription", "hearing", "trying"]
"""Purpose of an open microphone. Each has its own permission."""


class MicrophoneAdapters(Value):
    """Microphones of this computer."""

    participant: MicrophoneChoice
    wizard: MicrophoneChoice


class MicrophoneService(Service):
    """Opens the participant's microphone while any permitted purpose needs it, recording or not."""

    def __init__(
        self,
        state: LiveState,
        bus: Bus,
        children: ProcessManager,
        parts: MicrophoneAdapters,
        *,
        to_robot: Callable[[ListenToRobot], object],
        hear_camera: Callable[[str, bool], None],
        parent: QObject,
    ) -> None:
        """``to_robot`` sends to the link with the robot's audio; ``hear_camera`` switches a camera's microphone."""
        super().__init__(parent)
        self._state = state
        self._problem = bus.problem
        self._to_robot = to_robot
        self._hear_camera = hear_camera
        self._distant = RemoteMicrophone(state.microphone, bus, settled=self._on_settled, parent=self)
        self._participant = LocalMicrophone(
            state.microphone, MICROPHONE, bus, children, parts.participant, settled=self._on_settled, parent=self
        )
        self._wizard = LocalMicrophone(
            state.wizard_microphone, WIZARD_MICROPHONE, bus, children, parts.wizard,
            settled=lambda: None, parent=self,
        )  # fmt: skip
        self._needs: set[Need] = set()
        self._scenario: Scenario | None = None
        self._started = False
        self._then: Callable[[], None] | None = None
        self._missing_since_ns: int | None = None
        self._soon = QTimer(self, singleShot=True, interval=PANELS_FIRST_MS)
        self._soon.timeout.connect(self._get_ready)
        self._patience = QTimer(self, singleShot=True, interval=_OPENS_WITHIN_MS)
        self._patience.timeout.connect(self._on_missing_timeout)
        self._tried = QTimer(self, singleShot=True, interval=_TRIED_FOR_MS)
        self._tried.timeout.connect(self._try_no_longer)
        state.robot.changed.connect(self._on_robot_changed)

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
        return "none" if self._scenario is None else participant_microphone(self._scenario, self._state.robot.value)

    @property
    def records(self) -> bool:
        """Whether it is open for a recording."""
        return "recording" in self._needs

    def handlers(self) -> Handlers:
        return {intents.UseMicrophone: self._use, intents.TryMicrophone: lambda intent: self._try(intent.on)}

    def follows(self) -> Follows:
        return {LinkChanged: self._on_link_changed}

    def processes(self) -> dict[str, ChildProcess]:
        microphones = (self._participant, self._wizard)
        return {each.child.body.name: each.child for each in microphones if each.child is not None}

    def restarts(self) -> dict[str, Restarts]:
        return {each.process_name: each.restarts for each in (self._participant, self._wizard)}

    def use_scenario(self, scenario: Scenario) -> None:
        """Apply a scenario; without a purpose the inputs are only listed."""
        self._scenario = scenario
        if not scenario.permissions.audio_recording:
            self.wait_no_longer()
            self._try_no_longer()
            self.close()
        elif self._is_to_record(scenario) and not (self._started and self._is_to_be_started):
            self.open()
        if self._started:
            self._begin_with(scenario)
            self._soon.start()

    def start(self) -> None:
        self._started = True
        if self._scenario is not None:
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
        if self._scenario is None:
            return
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
        return self.current == "computer" and self._participant.child is None

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
        scenario, robot = self._scenario, self._state.robot.value
        if scenario is not None and scenario.sound.ear == "auto" and robot is None and not self.records:
            source = "none"  # the robot is not known yet
        if source != "computer":
            self._participant.close()
        if source in ("computer", "none"):
            self._distant.close()
        camera = source.removeprefix("camera:")
        if source == "robot":
            self._distant.open("the robot's microphone", self._ask_robot, reachable=self._robot_is_linked)
        elif camera != source:
            self._distant.open(f"the microphone of the camera {camera}", partial(self._hear_camera, camera))
        elif source == "computer":
            self._participant.open()

    def _robot_is_linked(self) -> bool:
        linked: bool = self._state.link.value.state == "connected"
        return linked

    def _ask_robot(self, on: bool) -> None:
        self._to_robot(ListenToRobot(clock.now_ns(), on))

    def _on_link_changed(self, event: LinkChanged) -> None:
        # A restarted link process has lost earlier requests.
        if event.link == "media" and event.state == "connecting":
            self._distant.ask_again()

    def _on_robot_changed(self, _robot: object) -> None:
        if self._started and self._scenario is not None:
            self._begin_with(self._scenario)
            self._get_ready()

    def _on_missing_timeout(self) -> None:
        self._missing_since_ns = clock.now_ns()
        self.wait_no_longer()

    def _on_settled(self) -> None:
        if self._state.microphone.value.state == "on":
            self._report_missing()
        self.wait_no_longer()

    def _report_missing(self) -> None:
        if self._missing_since_ns is None:
            return
        missing_s = (clock.now_ns() - self._missing_since_ns) / 1e9
        self._missing_since_ns = None
        self._problem(
            "info",
            tr("The microphone started {late} s after the recording.").format(late=f"{missing_s:.1f}"),
            tr("Its sound before that is missing from the recording."),
            "",
        )

    def stop(self) -> None:
        self._soon.stop()
        self._patience.stop()
        self._tried.stop()
        self._distant.close()
        self._participant.ask_to_end()
        self._wizard.ask_to_end()

    def end(self) -> None:
        self._participant.end()
        self._wizard.end()


def _may_record_wizard(scenario: Scenario) -> bool:
    return scenario.permissions.own_voice or scenario.permissions.transcription
