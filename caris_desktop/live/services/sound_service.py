"""Sound service: playback of the robot's microphone to the wizard, and push-to-talk. GUI thread."""

from dataclasses import replace

from PySide6.QtCore import QObject, QTimer

from caris_desktop.domain import intents
from caris_desktop.domain.events import ANSWER, LinkChanged
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import PARTICIPANT_SOURCES
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import dataclass
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ChildProcess, ProcessSpec
from caris_desktop.live.playback_client import Playback
from caris_desktop.live.process_manager import ProcessManager
from caris_desktop.live.push_to_talk import Outlet, PushToTalkVoice
from caris_desktop.live.service import PANELS_FIRST_MS, Follows, Handlers, Restarts, Service
from caris_desktop.live.services.microphone_service import MicrophoneService
from caris_desktop.live.services.robot_service import RobotService
from caris_desktop.live.services.speech_service import SpeechService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import MicrophoneStatus, SoundStatus
from caris_desktop.scenario.scenario_model import Scenario

# A wizard often speaks again soon, and opening a microphone takes a moment.
_OPEN_FOR_MS = 20_000
# The robot's microphone receives the end of the wizard's voice with a delay.
_DEAF_FOR_MS = 500
_HEARING = "hearing"


@dataclass(frozen=True, slots=True)
class SoundAdapters:
    """Playback of the robot's audio to the wizard, and of the wizard's voice to the participant."""

    hearing: ProcessSpec
    own_voice: ProcessSpec


class SoundService(Service):
    """Maintains ``state.sound``.

    During push-to-talk the robot's microphone is not played: the wizard would hear their own voice delayed, which makes
    speaking impossible.
    """

    def __init__(
        self,
        state: LiveState,
        bus: Bus,
        children: ProcessManager,
        parts: SoundAdapters,
        *,
        microphones: MicrophoneService,
        robot: RobotService,
        speech: SpeechService,
        parent: QObject,
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._problem = bus.problem
        self._microphones = microphones
        self._speech = speech
        self._scenario: Scenario | None = None
        self._started = False
        self._hears = False
        self._hearing = Playback(parts.hearing, children, ended=self._on_hearing_ended, parent=self)
        self._voice = PushToTalkVoice(
            state, bus, children, parts.own_voice, to_robot=robot.send_sound, over=self._on_voice_over, parent=self
        )
        self._soon = QTimer(self, singleShot=True, interval=PANELS_FIRST_MS)
        self._soon.timeout.connect(self._get_ready)
        self._open_for = QTimer(self, singleShot=True, interval=_OPEN_FOR_MS)
        self._open_for.timeout.connect(microphones.close_wizards)
        self._deaf = QTimer(self, singleShot=True, interval=_DEAF_FOR_MS)
        self._deaf.timeout.connect(self._hear_or_not)
        bus.tap(self._take, (AudioChunk,))
        state.wizard_microphone.changed.connect(self._on_microphone)
        state.robot.changed.connect(self._get_ready)

    def handlers(self) -> Handlers:
        return {intents.PushToTalk: self._push_to_talk, intents.HearRobot: self._hear_robot}

    def follows(self) -> Follows:
        return {LinkChanged: self._on_link_changed}

    def processes(self) -> dict[str, ChildProcess]:
        playing = (self._hearing, self._voice.playback)
        return {each.child.body.name: each.child for each in playing if each.child is not None}

    def restarts(self) -> dict[str, Restarts]:
        return {each.process_name: each.restarts for each in (self._hearing, self._voice.playback)}

    def use_scenario(self, scenario: Scenario) -> None:
        self._scenario = scenario
        status: SoundStatus = self._state.sound.value
        permitted = {"robot": scenario.permissions.own_voice, "dictation": scenario.permissions.transcription}
        if not permitted.get(status.talking, True):
            self._let_go()
        if status.hearing and not scenario.sound.hear:
            self._hear(False)
        if not scenario.permissions.own_voice:
            self._voice.playback.dismiss()
        self._soon.start()

    def start(self) -> None:
        self._started = True
        self._get_ready()

    def _get_ready(self, _robot: object = None) -> None:
        """Start the playback of the wizard's voice in advance, once it is known to be needed."""
        scenario, robot = self._scenario, self._state.robot.value
        if not self._started or scenario is None or not scenario.permissions.own_voice:
            return
        known = robot is not None or scenario.sound.own_voice != "auto"
        if known and "computer" in self._outlets(scenario):
            self._voice.playback.get_ready()

    def stop(self) -> None:
        self._soon.stop()
        self._voice.stop()
        self._hear(False)
        self._hearing.ask_to_end()
        self._open_for.stop()
        self._deaf.stop()

    def end(self) -> None:
        self._hearing.stop()
        self._voice.playback.stop()

    # Push-to-talk

    def _push_to_talk(self, asked: intents.PushToTalk) -> None:
        if not asked.on:
            self._let_go()
            return
        scenario = self._scenario
        if scenario is None or self._state.sound.value.talking:
            return
        if self._microphones.wizards_choice is None:
            raise UserFacingError(
                tr("No microphone is selected for you."), tr("You cannot be heard."),
                tr("Choose one in the Window menu."), severity="warning",
            )  # fmt: skip
        if asked.to == "robot":
            speech = self._state.speech.value
            if speech.now is not None or speech.waiting:
                # One voice at a time: robot speech is interrupted.
                self._speech.queue.silence(asked.actor)
            robot = self._state.robot.value
            rate_hz = robot.audio.rate_hz if robot is not None and robot.audio is not None else 16_000
            self._voice.begin(self._outlets(scenario), rate_hz, asked.actor)
        self._show(talking=asked.to)
        self._hear_or_not()
        self._open_for.stop()
        self._microphones.open_wizards()

    def _outlets(self, scenario: Scenario) -> frozenset[Outlet]:
        robot = self._state.robot.value
        plays = robot is not None and robot.audio is not None and robot.audio.speaker is not None
        match scenario.sound.own_voice:
            case "both":
                return frozenset(("robot", "computer"))
            case "robot":
                return frozenset(("robot",))
            case "computer":
                return frozenset(("computer",))
        return frozenset(("robot",)) if plays else frozenset(("computer",))

    def _let_go(self) -> None:
        if not self._state.sound.value.talking:
            return
        if self._voice.is_speaking:
            self._voice.end()
            self._deaf.start()
        else:
            self._microphones.mute_wizards()
        self._show(talking="")
        self._open_for.start()
        self._hear_or_not()

    def _on_voice_over(self, detail: str) -> None:
        if self._state.sound.value.talking != "dictation":
            self._microphones.mute_wizards()
        if self._state.sound.value.talking == "robot":
            self._show(talking="")
            self._open_for.start()
        if detail and detail != "no speech was played":
            self._problem(
                "warning",
                tr("Your own voice was not played: {detail}.").format(detail=tr(detail)),
                tr("The participant heard nothing, or only part of it."),
                tr("Type the text, or hold the key again when this has changed."),
                cause=ANSWER,
            )
        self._hear_or_not()

    def _on_microphone(self, status: MicrophoneStatus) -> None:
        if status.state == "failed":
            self._voice.fail(QT_TR_NOOP("the microphone is not working"))  # reported by the microphone itself

    def _on_link_changed(self, event: LinkChanged) -> None:
        if event.link == "media" and event.state in ("lost", "closed") and self._voice.outlets == {"robot"}:
            self._voice.fail(QT_TR_NOOP("the connection to the robot was lost"))

    # Listening to the robot's microphone

    def _hear_robot(self, asked: intents.HearRobot) -> None:
        scenario = self._scenario
        if asked.on and (scenario is None or not scenario.sound.hear):
            raise UserFacingError(
                tr("This scenario does not allow listening to the robot's microphone."), tr("Nothing is played."),
                tr("Open a scenario that does."),
                severity="warning",
            )  # fmt: skip
        self._show(volume=asked.volume)
        self._hearing.set_volume(asked.volume)
        self._hear(asked.on)

    def _hear(self, on: bool) -> None:
        if on == self._state.sound.value.hearing:
            return
        self._show(hearing=on)
        self._microphones.need_hearing(on)
        if on:
            self._hearing.begin(_HEARING, volume=self._state.sound.value.volume)
        else:
            self._hearing.end(at_once=True)
        self._hear_or_not()

    def _hear_or_not(self) -> None:
        status: SoundStatus = self._state.sound.value
        self._hears = status.hearing and status.talking != "robot" and not self._deaf.isActive()

    def _take(self, chunk: AudioChunk, _raw: bytes | None) -> None:  # any thread
        if self._hears and chunk.source in PARTICIPANT_SOURCES:
            self._hearing.play(chunk)

    def _on_hearing_ended(self, _stream_id: str, _heard_out_ns: int | None, detail: str) -> None:
        if not detail or not self._state.sound.value.hearing:
            return
        self._hear(False)
        self._problem(
            "warning",
            tr("The robot's microphone cannot be played to you: {detail}.").format(detail=detail),
            tr("You cannot listen to the participant; speech is still recorded and transcribed."),
            tr("Connect headphones or start the sound server, then start listening again."),
            cause=ANSWER,
        )

    def _show(self, **changed: object) -> None:
        self._state.sound.set(replace(self._state.sound.value, **changed))
