"""What the robot says: one queue, in front of the robot's own voice or this computer's."""

from dataclasses import replace
from typing import Any

from PySide6.QtCore import QObject

from caris_desktop.conversation.speech_messages import SilenceSpeech, Speak, SpeechFailed, SpeechReady
from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import Actor
from caris_desktop.domain.commands import Say, Silence
from caris_desktop.domain.events import LinkChanged, Problem, UtteranceChanged
from caris_desktop.domain.ports import RobotPort
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ChildProcess, ProcessBody
from caris_desktop.live.children import Children
from caris_desktop.live.service import Follows, Handlers, Restarts, Service
from caris_desktop.live.speech_queue import SpeechQueue, Voice, VoiceKind
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.model import Scenario


class RobotVoice:
    """The robot speaks; its link reports."""

    def __init__(self, state: LiveState, robot: RobotPort) -> None:
        self._state = state
        self._robot = robot

    @property
    def held_up(self) -> bool:
        return bool(self._state.link.value.state == "trouble")

    def say(self, utterance: UtteranceChanged) -> bool:
        return self._state.link.value.state == "connected" and self._robot.send(
            Say(
                utterance.stamp_ns,
                utterance.utterance_id,
                utterance.text,
                utterance.actor,
                utterance.origin,
                utterance.person_id,
            )
        )

    def silence(self, actor: Actor) -> bool:
        return self._robot.send(Silence(clock.now_ns(), actor))


class SpeechService(Service):
    """Runs this computer's voice, and has the queue in front of both."""

    def __init__(
        self, state: LiveState, bus: Bus, children: Children, body: ProcessBody, *, robot: RobotPort, parent: QObject
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._bus = bus
        self._children = children
        self._body = body
        self._child: ChildProcess | None = None
        self._restarts = Restarts()
        self._voice = ""
        self._held_problem: Problem | None = None
        voices: dict[VoiceKind, Voice] = {"robot": RobotVoice(state, robot), "computer": _Computer(self)}
        self.queue = SpeechQueue(state, voices, bus.publish, self)

    def handlers(self) -> Handlers:
        return {
            intents.Say: self._say,
            intents.Silence: lambda asked: self.queue.silence(asked.actor),
        }

    def follows(self) -> Follows:
        return {LinkChanged: self._on_link_changed, UtteranceChanged: self.queue.on_utterance}

    def processes(self) -> dict[str, ChildProcess]:
        return {} if self._child is None else {self._body.name: self._child}

    def use_scenario(self, scenario: Scenario) -> None:
        self._voice = scenario.voice
        self.queue.use_voice(scenario.voice)
        if self._voice == "computer" and self._held_problem is not None:
            self._bus.publish(replace(self._held_problem, stamp_ns=clock.now_ns()))
            self._held_problem = None

    def start(self) -> None:
        self._child = self._children.start(self._body, ended=self._on_ended, heard=self.on_heard, reads=self._read_own)

    def stop(self) -> None:
        if self._child is not None:
            self._child.ask_to_end()

    def end(self) -> None:
        if self._child is not None:
            self._child.stop(grace_s=1.5)

    def send(self, message: Speak | SilenceSpeech) -> bool:
        """To the computer's voice, now or not at all."""
        return self._child is not None and self._child.send(message)

    def on_heard(self, message: Any) -> None:
        """What this computer's voice says of itself."""
        match message:
            case SpeechReady():
                detail = "" if message.audible else "no sound device: nobody hears it"
                self._state.speech.set(replace(self._state.speech.value, ready=True, detail=detail))
            case SpeechFailed(problem):
                self._tell(problem)
                self.queue.on_voice_lost("computer", problem.what)
            case Problem():
                self._tell(message)

    def _say(self, asked: intents.Say) -> None:
        self.queue.say(asked.text, asked.origin, asked.actor, person_id=asked.person_id)

    def read(self, value: Any, raw: bytes) -> None:  # reader thread
        """What a process with a voice sends. What became of an utterance is on record whatever the GUI thread does."""
        if isinstance(value, UtteranceChanged):
            self.queue.report(value, raw)
        else:
            self._children.pass_on(self.on_heard, value, raw)

    def _read_own(self, value: Any, raw: bytes) -> None:  # reader thread
        if isinstance(value, Problem):
            self._children.tell(self.on_heard, value)
        else:
            self.read(value, raw)

    def _tell(self, problem: Problem) -> None:
        """What is wrong with this computer's voice matters once a scenario speaks with it."""
        if self._voice == "computer":
            self._bus.publish(problem)
        else:
            self._held_problem = problem

    def _on_link_changed(self, event: LinkChanged) -> None:
        if event.link != "control":
            return
        if event.state in ("connecting", "closed"):
            # Of what was asked of another link process nobody tells; a lost link's own process still does.
            self.queue.on_voice_lost("robot", "the link was lost")
        self.queue.on_voice_changed()

    def _on_ended(self, child: ChildProcess) -> None:
        if child is not self._child:
            return  # it was replaced while the news of its end was on its way
        self._child = None
        again = self._restarts.another()
        self._state.speech.set(replace(self._state.speech.value, ready=False, detail="the voice stopped"))
        self._tell(
            Problem(
                clock.now_ns(),
                "warning",
                "This computer's voice stopped unexpectedly.",
                "What it was saying is cut off; the session goes on.",
                self._restarts.advice,
                until="voice",
            )
        )
        if again:
            self.start()
        self.queue.on_voice_lost("computer", "speech stopped unexpectedly")


class _Computer:
    """The computer's voice, as the queue sees it."""

    held_up = False

    def __init__(self, service: SpeechService) -> None:
        self._service = service

    def say(self, utterance: UtteranceChanged) -> bool:
        return self._service.send(
            Speak(utterance.utterance_id, utterance.text, utterance.origin, utterance.actor, utterance.person_id)
        )

    def silence(self, actor: Actor) -> bool:
        return self._service.send(SilenceSpeech(actor))
