"""Speech service: speech queue in front of the robot's or this computer's voice."""

import re
import textwrap
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from caris_desktop.conversation.synthesis_messages import (
    Draft,
    Prepare,
    SynthesisReady,
    SynthesisSettings,
    UseVoice,
    VoicesFound,
)
from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import (
    UTTERANCE_ENDS,
    LinkChanged,
    Problem,
    SuggestionChanged,
    UtteranceChanged,
    VoiceChanged,
)
from caris_desktop.domain.link_commands import Say, Silence
from caris_desktop.domain.ports import RobotPort
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.service import (
    PANELS_FIRST_MS,
    ContextService,
    Follows,
    Handlers,
    ServiceContext,
    SupervisedProcess,
    localize_problem,
)
from caris_desktop.live.speech_queue import NO_VOICE, SpeechQueue, Voice, VoiceKind
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import VoiceStatus
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.scenario.phrases import sentences
from caris_desktop.scenario.scenario_model import Scenario


class PortVoice:
    """Voice of this computer, or base of the robot's, as used by the queue. The process behind the port reports."""

    def __init__(self, state: LiveState, port: RobotPort | SupervisedProcess) -> None:
        self._state = state
        self._port = port

    @property
    def held_up(self) -> bool:
        return False

    def say(self, utterance: UtteranceChanged, spoken: str) -> bool:
        return self._port.send(
            Say(
                utterance.stamp_ns, utterance.utterance_id, spoken, utterance.actor, utterance.origin,
                utterance.person_id, recorded=utterance.text, language=self._state.voice.value.language,
            )
        )  # fmt: skip

    def silence(self, actor: Actor) -> bool:
        return self._port.send(Silence(clock.now_ns(), actor))


class LinkVoice(PortVoice):
    """Robot text-to-speech; its link reports."""

    @property
    def held_up(self) -> bool:
        return bool(self._state.link.value.state == "trouble")

    def say(self, utterance: UtteranceChanged, spoken: str) -> bool:
        return self._state.link.value.state == "connected" and super().say(utterance, spoken)


class SpeechService(ContextService):
    """Runs this computer's voice, and the queue in front of both."""

    def __init__(self, context: ServiceContext, body: ProcessSpec, *, robot: RobotPort) -> None:
        super().__init__(context)
        self._body = body
        self._process = SupervisedProcess(
            self._children,
            ended=self._on_ended,
            on_message=self.on_heard,
            reads=self._read_own,
            grace_s=1.5,
            name=body.name,
        )
        self._output: VoiceKind = "computer"
        self._settings = SynthesisSettings()
        self._mute_robot = ""
        self._begun = ""
        self._held_problem: Problem | None = None
        self._phrases: tuple[str, ...] = ()
        self._suggested: dict[str, str] = {}
        self._prepared: tuple[str, ...] = ()
        voices: dict[VoiceKind, Voice] = {
            "robot": LinkVoice(self._state, robot), "computer": PortVoice(self._state, self._process),
        }  # fmt: skip
        self._permitted = True
        self._started = self._stopped = False
        self.queue = SpeechQueue(self._state, voices, self._bus.publish, self)
        self._both = voices["both"] = DualSpeechOutput(dict(voices), self.queue.report)
        self._soon = new_timer(self, self._prepare, PANELS_FIRST_MS, single_shot=True)
        self._state.speech.changed.connect(self._prepare)
        self._state.robot.changed.connect(self._on_robot_changed)

    def handlers(self) -> Handlers:
        return {intents.SetVoice: self._set_voice, intents.DraftSpeech: self._draft}

    def follows(self) -> Follows:
        return {
            LinkChanged: self._on_link_changed,
            UtteranceChanged: self._on_utterance,
            SuggestionChanged: self._on_suggestion,
        }

    def supervised(self) -> tuple[SupervisedProcess, ...]:
        return (self._process,)

    def use_scenario(self, scenario: Scenario) -> None:
        self._phrases = (*scenario.every_filler, *sentences(scenario.phrases))
        self._permitted = scenario.permissions.speech
        if not self._permitted:
            self._fall_silent()
        settings = scenario.speech
        folder = "" if scenario.path is None else str(scenario.path.parent)
        self._use(
            scenario.voice,
            SynthesisSettings(
                settings.name, settings.language, settings.rate, settings.volume, settings.device, folder
            ),
        )
        self._begin()

    def start(self) -> None:
        self._started = True
        self._begin()

    def _begin(self) -> None:
        if not self._permitted or self._process.child is not None or not self._started or self._stopped:
            return
        self._process.start(self._body)
        self._process.send(UseVoice(self._settings))
        self._prepared = ()
        self._prepare()

    def _fall_silent(self) -> None:
        """Disable speech in this scenario: drop the queue and end this computer's voice."""
        speech = self._state.speech.value
        if speech.now is not None or speech.waiting:
            self.queue.silence(CONSOLE)
        if not self._process.dismiss():
            return
        self._state.speech.update(ready=False, detail="")
        self._on_voice_lost("computer", QT_TR_NOOP("the scenario was changed"))

    def stop(self) -> None:
        self._stopped = True
        self._soon.stop()
        self._process.ask_to_end()

    def on_heard(self, message: Any) -> None:
        """Handle a status message of this computer's voice."""
        match message:
            case SynthesisReady():
                detail = "" if message.audible else QT_TR_NOOP("no sound device: speech cannot be heard")
                self._state.speech.update(ready=True, detail=detail)
                self._state.voice.update(used=message.voice)
            case VoicesFound(voices):
                self._state.voice.update(choices=voices)
            case Problem() as problem:
                # The voice itself reports which utterances failed; one sent meanwhile it still tries to speak.
                self._notify(localize_problem(problem))

    def _set_voice(self, intent: intents.SetVoice) -> None:
        settings = replace(
            self._settings, voice=intent.name, language=intent.language, rate=intent.rate, volume=intent.volume
        )
        self._use(intent.output, settings, intent.actor)
        self._bus.publish(
            VoiceChanged(
                clock.now_ns(), intent.output, intent.name, intent.language, intent.rate, intent.volume, intent.actor
            )
        )

    def _use(self, output: VoiceKind, settings: SynthesisSettings, actor: Actor = CONSOLE) -> None:
        before, self._output = self._settings, output
        output = self._speaking_voice()
        self._settings = replace(settings, at_hand=output != "robot")
        used = self._state.voice.value.used
        if not self._settings.tunes(before):
            used = ""
            self._state.speech.update(ready=False, detail="")
        self._process.send(UseVoice(self._settings, actor))
        self.queue.use_voice(output)
        self._state.voice.set(
            VoiceStatus(
                self._output, settings.voice, settings.language, settings.rate, settings.volume,
                used, self._state.voice.value.choices,
            )
        )  # fmt: skip
        self._soon.start()
        if self._settings.at_hand and self._held_problem is not None:
            self._bus.publish(replace(self._held_problem, stamp_ns=clock.now_ns()))
            self._held_problem = None

    def _speaking_voice(self) -> VoiceKind:
        """The scenario's voice; this computer's if the robot has none, which is reported once per robot."""
        robot: RobotProfile | None = self._state.robot.value
        if self._output == "computer" or robot is None or robot.speech is not None:
            return self._output
        if self._permitted and self._mute_robot != robot.title:
            self._mute_robot = robot.title
            self._bus.inform(
                tr("{robot} has no voice.").format(robot=robot.title),
                tr("This computer speaks instead: participants hear the speech from here."),
                tr("Put a loudspeaker near the robot, or configure its speech in its profile (Window menu, Robot)."),
            )  # fmt: skip
        return "computer"

    def _on_robot_changed(self, _robot: RobotProfile | None) -> None:
        if self._speaking_voice() != self._state.speech.value.voice:
            self._use(self._output, self._settings)

    def _on_utterance(self, event: UtteranceChanged) -> None:
        self.queue.on_utterance(event)
        if event.speaker != "robot" or event.origin == "heard":
            return
        if event.state == "started":
            self._begun = event.utterance_id
        elif event.state == "failed":
            self._report_failed(event, begun=event.utterance_id == self._begun)

    def _report_failed(self, event: UtteranceChanged, *, begun: bool) -> None:
        shortened = textwrap.shorten(re.sub(r"\{[^{}]*\}", "…", event.text), 60, placeholder="…")  # names are ids in it
        what = tr("“{text}” may have been cut off.") if begun else tr("“{text}” was not said.")
        reason = tr("Speech output failed: {reason}.") if event.detail else tr("Speech output failed.")
        what, reason = what.format(text=shortened), reason.format(reason=tr(event.detail))
        advice = tr("Say it again, or choose another voice in the title of Speak.")
        self._bus.publish(Problem(clock.now_ns(), "warning", what, reason, advice, until="utterance"))

    def _on_suggestion(self, event: SuggestionChanged) -> None:
        if event.state == "displayed":
            self._suggested[event.suggestion_id] = event.text
        else:
            self._suggested.pop(event.suggestion_id, None)
        self._prepare()

    def _prepare(self, _changed: object = None) -> None:
        """Prepare likely next utterances, most likely first. Texts with a name are only known when spoken."""
        if self._soon.isActive():
            return
        waiting = (utterance.text for utterance in self._state.speech.value.waiting)
        texts = tuple(text for text in (*waiting, *self._suggested.values(), *self._phrases) if "{" not in text)
        if self._settings.at_hand and texts != self._prepared and self._process.send(Prepare(texts)):
            self._prepared = texts

    def _draft(self, intent: intents.DraftSpeech) -> None:
        if self._settings.at_hand and "{" not in intent.text:
            self._process.send(Draft(intent.text))

    def read(self, value: Any, raw: bytes) -> None:  # reader thread
        """Handle a voice process's message. Utterance events are recorded without waiting for the GUI thread."""
        if isinstance(value, UtteranceChanged) and value.origin != "heard":
            if not self._both.handle(value):
                self.queue.report(value, raw)
        else:
            self._children.pass_on(self.on_heard, value, raw)

    def _read_own(self, value: Any, raw: bytes) -> None:  # reader thread
        if isinstance(value, Problem):
            self._children.call_in_gui(self.on_heard, value)
        else:
            self.read(value, raw)

    def _notify(self, problem: Problem) -> None:
        """Report a problem of this computer's voice once a scenario uses it."""
        if self._settings.at_hand:
            self._bus.publish(problem)
        else:
            self._held_problem = problem

    def _on_link_changed(self, event: LinkChanged) -> None:
        if event.link != "control":
            return
        if event.state in ("connecting", "closed"):
            # A new link process does not report earlier requests; after a mere disconnection the process still does.
            self._on_voice_lost("robot", QT_TR_NOOP("the connection was lost"))
        self.queue.on_voice_changed()

    def _on_ended(self) -> None:
        self._state.speech.update(ready=False, detail=QT_TR_NOOP("the voice stopped"))
        self._process.restarts.after_end(self._report_ended, self._begin)
        self._on_voice_lost("computer", QT_TR_NOOP("speech stopped unexpectedly"))

    def _report_ended(self, advice: str) -> None:
        self._notify(
            Problem(
                clock.now_ns(),
                "warning",
                tr("This computer's voice stopped unexpectedly."),
                tr("The current utterance is cut off; the session continues."),
                advice,
                until="voice",
            )
        )

    def _on_voice_lost(self, kind: VoiceKind, detail: str) -> None:
        now = self._state.speech.value.now
        if now is not None:
            self._both.lost(kind, replace(now, stamp_ns=clock.now_ns()), detail)
        self.queue.on_voice_lost(kind, detail)


class DualSpeechOutput:
    """Dual speech output: the robot and this computer speak the same utterance.

    Voice composed of two. It starts with the first and ends with the last.

    ``report`` receives the resulting events, in the reporting voice's thread.
    """

    def __init__(self, voices: dict[VoiceKind, Voice], report: Callable[[UtteranceChanged], None]) -> None:
        self._voices = voices
        self._report = report
        self._lock = threading.Lock()
        self._utterance_id = ""
        self._started = False
        self._speaking: set[str] = set()
        self._ended: list[UtteranceChanged] = []

    @property
    def held_up(self) -> bool:
        return any(voice.held_up for voice in self._voices.values())

    def say(self, utterance: UtteranceChanged, spoken: str) -> bool:
        with self._lock:
            self._utterance_id, self._started, self._ended = utterance.utterance_id, False, []
            self._speaking = set(self._voices)
        refused = [kind for kind, voice in self._voices.items() if not voice.say(utterance, spoken)]
        if len(refused) == len(self._voices):
            return False
        for kind in refused:
            self.lost(kind, utterance, NO_VOICE[kind])
        return True

    def silence(self, actor: Actor) -> bool:
        silenced = [voice.silence(actor) for voice in self._voices.values()]
        return any(silenced)

    def lost(self, kind: VoiceKind, utterance: UtteranceChanged, detail: str) -> None:
        """Handle the loss of one voice."""
        self.handle(replace(utterance, voice=kind, state="failed", detail=detail))

    def handle(self, change: UtteranceChanged) -> bool:
        """Handle an event of one voice; False if it is not about a shared utterance. Any thread."""
        with self._lock:
            if change.utterance_id != self._utterance_id:
                return False
            follows = self._follows(change) if change.voice in self._speaking else None
        if follows is not None:
            self._report(follows)
        return True

    def _follows(self, change: UtteranceChanged) -> UtteranceChanged | None:
        if change.state in UTTERANCE_ENDS:
            self._speaking.discard(change.voice)
            self._ended.append(change)
            return None if self._speaking else _last_word(self._ended)
        began, self._started = not self._started, True
        return replace(change, voice="both") if began else None


def _last_word(ended: list[UtteranceChanged]) -> UtteranceChanged:
    """Combined outcome: the utterance counts as spoken if one voice finished it; the detail has the other's outcome."""
    best = min(ended, key=lambda one: UTTERANCE_ENDS.index(one.state))
    return replace(
        best,
        stamp_ns=max(one.stamp_ns for one in ended),
        voice="both",
        detail="; ".join(dict.fromkeys(one.detail for one in ended if one.detail)),
        estimated=any(one.estimated for one in ended),
    )
