"""Sound service: playback of the robot's microphone to the wizard, and push-to-talk. GUI thread."""

import secrets
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from PySide6.QtCore import QObject

from caris_desktop.conversation.resampling import Resampler
from caris_desktop.conversation.sound_devices import (
    BeginPlaying,
    EndPlaying,
    PlaybackAlive,
    PlaybackFailed,
    PlaybackStarted,
    PlayedOut,
    PlayThis,
    SetVolume,
)
from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import ANSWER, LinkChanged, UtteranceChanged
from caris_desktop.domain.failure import RefusedError
from caris_desktop.domain.link_commands import PlayOnRobot
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import PARTICIPANT_SOURCES, WIZARD_MICROPHONE, PlayedSound
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.service import (
    PANELS_FIRST_MS,
    ContextService,
    Follows,
    Handlers,
    ServiceContext,
    SupervisedProcess,
)
from caris_desktop.live.services.microphone_service import MicrophoneService
from caris_desktop.live.services.robot_service import RobotService
from caris_desktop.live.services.speech_service import SpeechService
from caris_desktop.live.speech_queue import addressee
from caris_desktop.live.status import MicrophoneStatus, SoundStatus
from caris_desktop.scenario.scenario_model import Scenario

# A wizard often speaks again soon, and opening a microphone takes a moment.
_OPEN_FOR_MS = 20_000
# The robot's microphone receives the end of the wizard's voice with a delay.
_DEAF_FOR_MS = 500
_HEARING = "hearing"


class SoundAdapters(Value):
    """Playback of the robot's audio to the wizard, and of the wizard's voice to the participant."""

    hearing: ProcessSpec
    own_voice: ProcessSpec


WIZARDS_VOICE = "(the wizard’s own voice)"
"""Text in the record in place of a transcript."""
Outlet = Literal["robot", "computer"]

# For the last word: the microphone delivers audio in chunks.
_TAIL_MS = 200
_PLAYED_WITHIN_MS = 2500
# Estimated delay to the robot's loudspeaker, which is not reported.
_ROBOT_DELAY_NS = 150_000_000
# Speech is played in full, including what came before the loudspeaker was open.
_MOST_LATE_S = 1.5


class PushToTalkVoice(QObject):
    """Push-to-talk: the wizard's live voice through the robot. GUI thread except for audio.

    One utterance at a time. ``over(detail)`` is called at its end; ``detail`` describes a failure.
    """

    def __init__(
        self,
        context: ServiceContext,
        body: ProcessSpec,
        *,
        to_robot: Callable[[PlayOnRobot], bool],
        over: Callable[[str], None],
    ) -> None:
        super().__init__(context.parent)
        self._state, self._bus, self._children = context.state, context.bus, context.children
        self._to_robot = to_robot
        self._over = over
        self.playback = Playback(body, context, played=self._on_played, ended=self._on_played_out)
        self._utterance: UtteranceChanged | None = None
        self.outlets: frozenset[Outlet] = frozenset()
        self._rate_hz = 0
        self._resampler: Resampler | None = None
        self._sends_as = ""
        self._began = False
        self._tail = new_timer(self, self._on_tail_over, _TAIL_MS, single_shot=True)
        self._patience = new_timer(self, lambda: self._finish(clock.now_ns()), _PLAYED_WITHIN_MS, single_shot=True)
        self._bus.tap(self._take, (AudioChunk,))

    @property
    def is_speaking(self) -> bool:
        return self._utterance is not None

    def begin(self, outlets: frozenset[Outlet], robot_rate_hz: int, actor: Actor) -> None:
        """Route the wizard's microphone to these outputs; ends a former utterance."""
        if self._utterance is not None:
            self._finish(clock.now_ns())
        utterance = UtteranceChanged(
            clock.now_ns(),
            f"u-{secrets.token_hex(4)}",
            "robot",
            WIZARDS_VOICE,
            "own_voice",
            "requested",
            voice=" and ".join(sorted(outlets)),
            actor=actor,
            person_id=addressee(self._state),
            source=WIZARD_MICROPHONE,
        )
        self._utterance, self.outlets, self._rate_hz = utterance, outlets, robot_rate_hz
        self._resampler, self._began = None, False
        self._bus.publish(utterance)
        if "computer" in outlets:
            self.playback.begin(utterance.utterance_id, most_s=_MOST_LATE_S)
        self._sends_as = utterance.utterance_id

    def end(self) -> None:
        """Key released: play what was said so far, then end."""
        if self._utterance is not None and not self._tail.isActive():
            self._tail.start()

    def stop(self) -> None:
        """Shut down."""
        if self._utterance is not None:
            self._finish(clock.now_ns())
        self.playback.ask_to_end()

    def fail(self, detail: str) -> None:
        """End the utterance with a failure."""
        if self._utterance is not None:
            self._finish(clock.now_ns(), detail)

    def _take(self, chunk: AudioChunk, _raw: bytes | None) -> None:  # reader thread of the microphone
        utterance_id = self._sends_as
        if chunk.source != WIZARD_MICROPHONE or not utterance_id:
            return
        if "computer" in self.outlets:
            self.playback.play(chunk)
        if "robot" in self.outlets:
            if self._resampler is None:
                self._resampler = Resampler(chunk.sample_rate_hz, self._rate_hz)
            mono = chunk.samples.mean(axis=1, dtype=np.float32)
            samples = np.clip(self._resampler.process(mono), -32768, 32767).astype(np.int16)[:, None]
            now_ns = clock.now_ns()
            if self._to_robot(PlayOnRobot(now_ns, samples)) and "computer" not in self.outlets:
                self._note(PlayedSound(now_ns + _ROBOT_DELAY_NS, utterance_id, "", self._rate_hz, samples))

    def _on_played(self, played: PlaybackStarted) -> None:  # reader thread of the playback
        self._note(PlayedSound(played.stamp_ns, played.stream_id, "", played.sample_rate_hz, played.samples))

    def _note(self, sound: PlayedSound) -> None:
        self._bus.publish(sound)
        if not self._began:
            self._children.call_in_gui(self._on_heard, sound)

    def _on_heard(self, sound: PlayedSound) -> None:
        utterance = self._utterance
        if utterance is None or self._began or sound.utterance_id != utterance.utterance_id:
            return
        self._began = True
        estimated = "computer" not in self.outlets
        self._utterance = replace(utterance, stamp_ns=sound.stamp_ns, state="started", estimated=estimated)
        self._bus.publish(self._utterance)

    def _on_tail_over(self) -> None:
        self._sends_as = ""
        if "computer" in self.outlets and self._began:
            self._patience.start()
            self.playback.end()
        else:
            self._finish(clock.now_ns() + (_ROBOT_DELAY_NS if self._began else 0))

    def _on_played_out(self, stream_id: str, played_out_ns: int | None, detail: str) -> None:
        if self._utterance is None or stream_id != self._utterance.utterance_id:
            return
        if played_out_ns is None and "robot" not in self.outlets:
            self.fail(detail)
        elif self._patience.isActive():
            self._finish(played_out_ns or clock.now_ns())

    def _finish(self, at_ns: int, detail: str = "") -> None:
        utterance, self._utterance = self._utterance, None
        self._sends_as = ""
        self._tail.stop()
        self._patience.stop()
        if utterance is None:
            return
        if not self._began and not detail:
            detail = QT_TR_NOOP("no speech was played")
        state: Literal["finished", "interrupted", "failed"] = "finished"
        if detail:
            state = "interrupted" if self._began else "failed"
        if detail and "computer" in self.outlets:
            self.playback.end(at_once=True)
        self._bus.publish(replace(utterance, stamp_ns=at_ns, state=state, detail=detail))
        self._over(detail)


class SoundService(ContextService):
    """Maintains ``state.sound``.

    During push-to-talk the robot's microphone is not played: the wizard would hear their own voice delayed, which makes
    speaking impossible.
    """

    def __init__(
        self,
        context: ServiceContext,
        parts: SoundAdapters,
        *,
        microphones: MicrophoneService,
        robot: RobotService,
        speech: SpeechService,
    ) -> None:
        super().__init__(context)
        self._problem = self._bus.problem
        self._microphones = microphones
        self._speech = speech
        self._started = False
        self._hears = False
        self._hearing = Playback(parts.hearing, context, ended=self._on_hearing_ended)
        self._voice = PushToTalkVoice(context, parts.own_voice, to_robot=robot.send_sound, over=self._on_voice_over)
        self._soon = new_timer(self, self._get_ready, PANELS_FIRST_MS, single_shot=True)
        self._open_for = new_timer(self, microphones.close_wizards, _OPEN_FOR_MS, single_shot=True)
        self._deaf = new_timer(self, self._update_hearing, _DEAF_FOR_MS, single_shot=True)
        self._bus.tap(self._take, (AudioChunk,))
        self._state.wizard_microphone.changed.connect(self._on_microphone)
        self._state.robot.changed.connect(self._get_ready)

    def handlers(self) -> Handlers:
        return {intents.PushToTalk: self._push_to_talk, intents.HearRobot: self._hear_robot}

    def follows(self) -> Follows:
        return {LinkChanged: self._on_link_changed}

    def supervised(self) -> tuple[SupervisedProcess, ...]:
        return self._hearing.process, self._voice.playback.process

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
        if not self._started or not scenario.permissions.own_voice:
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

    # Push-to-talk

    def _push_to_talk(self, intent: intents.PushToTalk) -> None:
        if not intent.on:
            self._let_go()
            return
        scenario = self._scenario
        if self._state.sound.value.talking:
            return
        if self._microphones.wizards_choice is None:
            raise RefusedError(
                tr("No microphone is selected for you."), tr("You cannot be heard."),
                tr("Choose one in the Window menu."),
            )  # fmt: skip
        if intent.to == "robot":
            speech = self._state.speech.value
            if speech.now is not None or speech.waiting:
                # One voice at a time: robot speech is interrupted.
                self._speech.queue.silence(intent.actor)
            robot = self._state.robot.value
            rate_hz = robot.audio.rate_hz if robot is not None and robot.audio is not None else 16_000
            self._voice.begin(self._outlets(scenario), rate_hz, intent.actor)
        self._state.sound.update(talking=intent.to)
        self._update_hearing()
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
        self._state.sound.update(talking="")
        self._open_for.start()
        self._update_hearing()

    def _on_voice_over(self, detail: str) -> None:
        if self._state.sound.value.talking != "dictation":
            self._microphones.mute_wizards()
        if self._state.sound.value.talking == "robot":
            self._state.sound.update(talking="")
            self._open_for.start()
        if detail and detail != "no speech was played":
            self._problem(
                "warning",
                tr("Your own voice was not played: {detail}.").format(detail=tr(detail)),
                tr("The participant heard nothing, or only part of it."),
                tr("Type the text, or hold the key again when this has changed."),
                cause=ANSWER,
            )
        self._update_hearing()

    def _on_microphone(self, status: MicrophoneStatus) -> None:
        if status.state == "failed":
            self._voice.fail(QT_TR_NOOP("the microphone is not working"))  # reported by the microphone itself

    def _on_link_changed(self, event: LinkChanged) -> None:
        if event.link == "media" and event.state in ("lost", "closed") and self._voice.outlets == {"robot"}:
            self._voice.fail(QT_TR_NOOP("the connection to the robot was lost"))

    # Listening to the robot's microphone

    def _hear_robot(self, intent: intents.HearRobot) -> None:
        if intent.on and not self._scenario.sound.hear:
            raise RefusedError(
                tr("This scenario does not allow listening to the robot's microphone."), tr("Nothing is played."),
                tr("Open a scenario that does."),
            )  # fmt: skip
        self._state.sound.update(volume=intent.volume)
        self._hearing.set_volume(intent.volume)
        self._hear(intent.on)

    def _hear(self, on: bool) -> None:
        if on == self._state.sound.value.hearing:
            return
        self._state.sound.update(hearing=on)
        self._microphones.need_hearing(on)
        if on:
            self._hearing.begin(_HEARING, volume=self._state.sound.value.volume)
        else:
            self._hearing.end(at_once=True)
        self._update_hearing()

    def _update_hearing(self) -> None:
        status: SoundStatus = self._state.sound.value
        self._hears = status.hearing and status.talking != "robot" and not self._deaf.isActive()

    def _take(self, chunk: AudioChunk, _raw: bytes | None) -> None:  # any thread
        if self._hears and chunk.source in PARTICIPANT_SOURCES:
            self._hearing.play(chunk)

    def _on_hearing_ended(self, _stream_id: str, _played_out_ns: int | None, detail: str) -> None:
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


_STUCK_AFTER_MS = 5000


class Playback(QObject):
    """Playback process for streamed audio: started on demand, restarted when hung. GUI thread.

    Plays one stream at a time, identified by an id.
    """

    def __init__(
        self,
        body: ProcessSpec,
        context: ServiceContext,
        *,
        played: Callable[[PlaybackStarted], None] = lambda _played: None,
        ended: Callable[[str, int | None, str], None],
    ) -> None:
        """``played`` receives what is audible, in another thread. ``ended(stream_id, played_out_ns, detail)``: the
        stream has ended; ``played_out_ns`` is None for a failure, explained by ``detail``.
        """
        super().__init__(context.parent)
        self._body = body
        self._children = context.children
        self._played = played
        self._ended = ended
        self._stream_id = ""
        self.process = SupervisedProcess(
            context.children, ended=self._on_ended, on_message=self.on_message, reads=self._read, name=body.name
        )
        self._stuck = new_timer(self, self._on_stuck, _STUCK_AFTER_MS, single_shot=True)

    def get_ready(self) -> None:
        """Start the process in advance, so that playback begins at once."""
        if self.process.child is None and not self.process.restarts.exhausted:
            self.process.start(self._body)

    def dismiss(self) -> None:
        """End the process: this scenario does not use it."""
        self._stuck.stop()
        self.process.dismiss()

    def begin(self, stream_id: str, *, volume: float = 1.0, most_s: float = 0.25) -> None:
        self.get_ready()
        self._stream_id = stream_id
        if self.process.child is None:
            self._give_up(tr("it failed too often"))
        else:
            self.process.send(BeginPlaying(stream_id, volume, most_s))

    def play(self, chunk: AudioChunk) -> None:
        """Play the next chunk, or drop it. Any thread."""
        self.process.send(PlayThis(chunk.sample_rate_hz, chunk.samples))

    def set_volume(self, volume: float) -> None:
        self.process.send(SetVolume(volume))

    def end(self, *, at_once: bool = False) -> None:
        """End the stream; ``ended`` follows once everything was played."""
        if self._stream_id and self.process.child is not None:
            self._stuck.start()
            self.process.send(EndPlaying(at_once))

    def ask_to_end(self) -> None:
        self._stuck.stop()
        self.process.ask_to_end()

    def _read(self, value: Any, raw: bytes) -> None:  # reader thread
        if isinstance(value, PlaybackStarted):
            self._played(value)
        else:
            self._children.pass_on(self.on_message, value, raw)

    def on_message(self, message: Any) -> None:
        """Handle a message of the process."""
        match message:
            case PlayedOut(stream_id, stamp_ns) if stream_id == self._stream_id:
                self._stream_id = ""
                self._stuck.stop()
                self._ended(stream_id, stamp_ns, "")
            case PlaybackFailed(stream_id, detail) if stream_id == self._stream_id:
                self._give_up(detail)
            case PlaybackAlive():
                self._stuck.start()

    def _give_up(self, detail: str) -> None:
        self._stuck.stop()
        stream_id, self._stream_id = self._stream_id, ""
        if stream_id:
            self._ended(stream_id, None, detail)

    def _on_stuck(self) -> None:
        if self._stream_id:
            self.process.kill()

    def _on_ended(self) -> None:
        self.process.restarts.another()  # restarted at the next playback; reported by the owner of the stream
        self._give_up(tr("the sound system stopped responding"))
