"""What the robot says next: one queue in front of whichever voice the scenario uses. GUI thread, but for reports."""

import secrets
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Literal, Protocol

from PySide6.QtCore import QObject

from caris_desktop.domain import clock
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import UtteranceChanged, UtteranceOrigin
from caris_desktop.live.addressee import addressee
from caris_desktop.live.state import LiveState

VoiceKind = Literal["robot", "computer"]
_ENDS = ("finished", "interrupted", "failed")


class Voice(Protocol):
    """Speaks one utterance at a time. Its UtteranceChanged events come by ``SpeechQueue.report``."""

    @property
    def held_up(self) -> bool:
        """Whether it will be known in a moment if this voice can speak; what is to be said waits until then."""

    def say(self, utterance: UtteranceChanged) -> bool:
        """False when this voice cannot take it now; nothing is queued then."""

    def silence(self, actor: Actor) -> bool:
        """Interrupt what is being said."""


class SpeechQueue(QObject):
    """Queues utterances, hands one at a time to the voice and keeps ``state.speech``."""

    def __init__(
        self,
        state: LiveState,
        voices: dict[VoiceKind, Voice],
        publish: Callable[[UtteranceChanged, bytes | None], None],
        parent: QObject | None = None,
    ) -> None:
        """``publish`` takes an event, with its pickled form where there is one, in any thread."""
        super().__init__(parent)
        self._state = state
        self._voices = voices
        self._publish = publish
        self._kind: VoiceKind = "robot"
        self._waiting: deque[UtteranceChanged] = deque()
        self._now: UtteranceChanged | None = None
        self._reporting = threading.Lock()
        self._reported_on = ""

    def use_voice(self, kind: VoiceKind) -> None:
        self._kind = kind
        self._state.speech.set(replace(self._state.speech.value, voice=kind))

    def say(self, text: str, origin: UtteranceOrigin, actor: Actor = CONSOLE, *, person_id: str = "") -> str:
        """The new utterance's id; empty text says nothing and gives an empty id.

        Without a ``person_id`` it is said to whom the wizard means, or who is nearest.
        """
        text = " ".join(text.split())
        if not text:
            return ""
        utterance = UtteranceChanged(
            clock.now_ns(),
            f"u-{secrets.token_hex(4)}",
            "robot",
            text,
            origin,
            "requested",
            voice=self._kind,
            actor=actor,
            person_id=person_id or addressee(self._state),
        )
        self._publish(utterance, None)
        self._waiting.append(utterance)
        self._next()
        return utterance.utterance_id

    def silence(self, actor: Actor = CONSOLE) -> None:
        dropped, self._waiting = list(self._waiting), deque()
        for utterance in dropped:
            self._publish(replace(utterance, stamp_ns=clock.now_ns(), state="interrupted", actor=actor), None)
        if self._now is not None:
            self._voices[self._kind_of(self._now)].silence(actor)
        self._show()

    def report(self, reported: UtteranceChanged, raw: bytes | None = None) -> None:
        """A voice tells of what it says: that goes on, until the end of the utterance. Any thread.

        What a voice tells that was given up by ``on_voice_lost`` comes too late, and is dropped.
        """
        # Held while it goes on: nothing else can come behind the end.
        with self._reporting:
            if reported.utterance_id != self._reported_on:
                return
            if reported.state in _ENDS:
                self._reported_on = ""
            self._publish(reported, raw)

    def on_utterance(self, event: UtteranceChanged) -> None:
        """What was published reaches the GUI thread."""
        if self._now is None or event.utterance_id != self._now.utterance_id:
            return
        self._now = event
        if event.state in _ENDS:
            self._now = None
            self._next()
        self._show()

    def on_voice_changed(self) -> None:
        """A voice is held up no longer: it speaks again, or is gone and what waited for it has failed."""
        self._next()

    def on_voice_lost(self, kind: VoiceKind, detail: str) -> None:
        """The voice went away in mid-sentence, and nobody will tell what became of it."""
        if self._now is not None and self._kind_of(self._now) == kind:
            self.report(replace(self._now, stamp_ns=clock.now_ns(), state="failed", detail=detail))
            self._now = None
            self._next()
            self._show()

    def _next(self) -> None:
        while self._now is None and self._waiting and not self._voices[self._kind_of(self._waiting[0])].held_up:
            utterance = self._waiting.popleft()
            with self._reporting:
                self._reported_on = utterance.utterance_id
            if self._voices[self._kind_of(utterance)].say(utterance):
                self._now = utterance
            else:
                detail = f"the {self._kind} has no voice now"
                self.report(replace(utterance, stamp_ns=clock.now_ns(), state="failed", detail=detail))
        self._show()

    def _kind_of(self, utterance: UtteranceChanged) -> VoiceKind:
        return "computer" if utterance.voice == "computer" else "robot"

    def _show(self) -> None:
        self._state.speech.set(replace(self._state.speech.value, now=self._now, waiting=tuple(self._waiting)))
