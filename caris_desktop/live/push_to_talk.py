"""Push-to-talk: the wizard's live voice through the robot. GUI thread except for audio."""

import secrets
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
from PySide6.QtCore import QObject, QTimer

from caris_desktop.conversation.sound.playback_messages import PlaybackStarted
from caris_desktop.conversation.sound.resampling import Resampler
from caris_desktop.domain import clock
from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.domain.link_commands import PlayOnRobot
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import WIZARD_MICROPHONE, PlayedSound
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.live.addressee import addressee
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.playback_client import Playback
from caris_desktop.live.process_manager import ProcessManager
from caris_desktop.live.state import LiveState

OWN_VOICE_WORDS = "(the wizard’s own voice)"
"""Text in the record in place of a transcript."""
Outlet = Literal["robot", "computer"]

# For the last word: the microphone delivers audio in chunks.
_TAIL_MS = 200
_HEARD_OUT_WITHIN_MS = 2500
# Estimated delay to the robot's loudspeaker, which is not reported.
_ROBOT_DELAY_NS = 150_000_000
# Speech is played in full, including what came before the loudspeaker was open.
_MOST_LATE_S = 1.5


class PushToTalkVoice(QObject):
    """One utterance at a time. ``over(detail)`` is called at its end; ``detail`` describes a failure."""

    def __init__(
        self,
        state: LiveState,
        bus: Bus,
        children: ProcessManager,
        body: ProcessSpec,
        *,
        to_robot: Callable[[PlayOnRobot], bool],
        over: Callable[[str], None],
        parent: QObject,
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._bus = bus
        self._children = children
        self._to_robot = to_robot
        self._over = over
        self.playback = Playback(body, children, played=self._on_played, ended=self._on_played_out, parent=self)
        self._utterance: UtteranceChanged | None = None
        self.outlets: frozenset[Outlet] = frozenset()
        self._rate_hz = 0
        self._resampler: Resampler | None = None
        self._sends_as = ""
        self._began = False
        self._tail = QTimer(self, singleShot=True, interval=_TAIL_MS)
        self._tail.timeout.connect(self._on_tail_over)
        self._patience = QTimer(self, singleShot=True, interval=_HEARD_OUT_WITHIN_MS)
        self._patience.timeout.connect(lambda: self._finish(clock.now_ns()))
        bus.tap(self._take, (AudioChunk,))

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
            OWN_VOICE_WORDS,
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
            self._play_on_robot(chunk, utterance_id)

    def _play_on_robot(self, chunk: AudioChunk, utterance_id: str) -> None:  # reader thread of the microphone
        if self._resampler is None:
            self._resampler = Resampler(chunk.sample_rate_hz, self._rate_hz)
        mono = chunk.samples.mean(axis=1, dtype=np.float32)
        samples = np.clip(self._resampler.take(mono), -32768, 32767).astype(np.int16)[:, None]
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

    def _on_played_out(self, stream_id: str, heard_out_ns: int | None, detail: str) -> None:
        if self._utterance is None or stream_id != self._utterance.utterance_id:
            return
        if heard_out_ns is None and "robot" not in self.outlets:
            self.fail(detail)
        elif self._patience.isActive():
            self._finish(heard_out_ns or clock.now_ns())

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
