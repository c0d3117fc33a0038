"""Speech queue in front of the scenario's voice. GUI thread, except for reports."""

import secrets
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from PySide6.QtCore import QObject, Qt, Signal

from caris_desktop.conversation.spoken_text import gaps, spoken
from caris_desktop.domain import clock
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import UTTERANCE_ENDS, UtteranceChanged, UtteranceOrigin, VoiceOutput
from caris_desktop.domain.sound_values import PlayedSound
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.live.state import LiveState
from caris_desktop.people.presence import PersonRow
from caris_desktop.robot.speaking_time import estimated_duration_s

WITHIN_EARSHOT_M = 3.0


def addressee(state: LiveState) -> str:
    """Id of the selected person if present; else of the nearest within earshot, or of the only one.

    Empty if there is none, or if it is ambiguous.
    """
    here: list[PersonRow] = [row for row in state.persons.value if row.here]
    if any(row.person_id == state.selected_person.value for row in here):
        return str(state.selected_person.value)
    if len(here) == 1:
        return here[0].person_id
    placed = [(row.distance_m, row.person_id) for row in here if row.distance_m is not None]
    distance_m, nearest = min(placed, default=(WITHIN_EARSHOT_M, ""))
    return nearest if distance_m < WITHIN_EARSHOT_M else ""


VoiceKind = VoiceOutput
NO_VOICE: dict[VoiceKind, str] = {
    "robot": QT_TR_NOOP("the robot's voice is not available"),
    "computer": QT_TR_NOOP("the computer's voice is not available"),
    "both": QT_TR_NOOP("neither the robot's nor the computer's voice is available"),
}
_OF_A_MODEL: tuple[UtteranceOrigin, ...] = ("assistant", "suggestion")


class Voice(Protocol):
    """Speaks one utterance at a time; reports UtteranceChanged events to ``SpeechQueue.report``."""

    @property
    def held_up(self) -> bool:
        """Whether the voice is temporarily unavailable; the queue waits for it."""

    def say(self, utterance: UtteranceChanged, spoken: str) -> bool:
        """Speak; False if the voice cannot do so now, without queueing it.

        ``spoken`` is only spoken; events carry ``utterance.text``, with ids in place of names.
        """

    def silence(self, actor: Actor) -> bool:
        """Interrupt the current utterance."""


class _Queued(Value):
    """Utterance as recorded and as spoken."""

    utterance: UtteranceChanged
    spoken: str


class SpeechQueue(QObject):
    """Queues utterances, passes them to the voice one by one, and maintains ``state.speech``."""

    _end_reported = Signal(str, object)  # utterance_id, ends_ns

    def __init__(
        self,
        state: LiveState,
        voices: dict[VoiceKind, Voice],
        publish: Callable[[UtteranceChanged, bytes | None], None],
        parent: QObject | None = None,
    ) -> None:
        """``publish`` receives an event, with its pickled form if available, in any thread."""
        super().__init__(parent)
        self._state = state
        self._voices = voices
        self._publish = publish
        self._kind: VoiceKind = "robot"
        self._waiting: deque[_Queued] = deque()
        self._now: UtteranceChanged | None = None
        self._ends_ns: int | None = None
        self._reported_end: tuple[str, int] = ("", 0)
        self._end_reported.connect(self._on_end_reported, Qt.ConnectionType.QueuedConnection)
        self._reporting = threading.Lock()
        self._reported_on = ""

    def use_voice(self, kind: VoiceKind) -> None:
        self._kind = kind
        self._state.speech.update(voice=kind)

    def say(
        self,
        text: str,
        origin: UtteranceOrigin,
        actor: Actor = CONSOLE,
        *,
        person_id: str = "",
        gesture: str = "",
        recorded: str = "",
    ) -> str:
        """Queue an utterance; returns its id, empty for empty text.

        Without a ``person_id`` it is addressed to the selected or nearest person. ``recorded`` replaces ``text`` in the
        record if that contains a name, with ``{p-...}`` in its place. ``gesture`` accompanies it. A text with an
        unfilled placeholder is never spoken: the utterance fails. Markdown of a model is removed.
        """
        if origin in _OF_A_MODEL:
            text, recorded = spoken(text), spoken(recorded)
        text = " ".join(text.split())
        if not text:
            return ""
        utterance = UtteranceChanged(
            clock.now_ns(),
            f"u-{secrets.token_hex(4)}",
            "robot",
            " ".join(recorded.split()) or text,
            origin,
            "requested",
            voice=self._kind,
            actor=actor,
            person_id=person_id or addressee(self._state),
            gesture=gesture,
        )
        self._publish(utterance, None)
        if gaps(text):
            detail = f"no value was entered for {{{gaps(text)[0]}}}"
            self._publish(replace(utterance, stamp_ns=clock.now_ns(), state="failed", detail=detail), None)
            return utterance.utterance_id
        self._waiting.append(_Queued(utterance, text))
        self._next()
        return utterance.utterance_id

    def waiting(self, utterance_id: str) -> UtteranceChanged | None:
        """Queued utterance as requested; None if not queued."""
        return next((one.utterance for one in self._waiting if one.utterance.utterance_id == utterance_id), None)

    def move(self, utterance_id: str, place: int) -> bool:
        """Move to this index, 0 for next. Here and below: False if not queued."""
        queued = self._taken_out(utterance_id)
        if queued is None:
            return False
        self._waiting.insert(place, queued)
        self._show()
        return True

    def edit(self, utterance_id: str, text: str, actor: Actor = CONSOLE, *, recorded: str = "") -> bool:
        """Replace the text; an empty one cancels it."""
        text = " ".join(text.split())
        if not text:
            return self.cancel(utterance_id, actor)
        for place, queued in enumerate(self._waiting):
            if queued.utterance.utterance_id == utterance_id:
                changed = replace(
                    queued.utterance, stamp_ns=clock.now_ns(), text=" ".join(recorded.split()) or text, actor=actor
                )
                self._publish(changed, None)
                self._waiting[place] = _Queued(changed, text)
                self._show()
                return True
        return False

    def cancel(self, utterance_id: str, actor: Actor = CONSOLE) -> bool:
        queued = self._taken_out(utterance_id)
        if queued is None:
            return False
        self._publish(replace(queued.utterance, stamp_ns=clock.now_ns(), state="interrupted", actor=actor), None)
        self._show()
        return True

    def _taken_out(self, utterance_id: str) -> _Queued | None:
        queued = next((one for one in self._waiting if one.utterance.utterance_id == utterance_id), None)
        if queued is not None:
            self._waiting.remove(queued)
        return queued

    def silence(self, actor: Actor = CONSOLE) -> None:
        dropped, self._waiting = [queued.utterance for queued in self._waiting], deque()
        for utterance in dropped:
            self._publish(replace(utterance, stamp_ns=clock.now_ns(), state="interrupted", actor=actor), None)
        if self._now is not None:
            self._voices[self._kind_of(self._now)].silence(actor)
        self._show()

    def report(self, reported: UtteranceChanged, raw: bytes | None = None) -> None:
        """Handle a report of a voice and publish it, up to the end of the utterance. Any thread.

        Reports of a voice after ``on_voice_lost`` are dropped.
        """
        # Held during publication: nothing can follow the end.
        with self._reporting:
            if reported.utterance_id != self._reported_on:
                return
            if reported.state in UTTERANCE_ENDS:
                self._reported_on = ""
            self._publish(reported, raw)

    def on_utterance(self, event: UtteranceChanged) -> None:
        """Handle a published event in the GUI thread."""
        if self._now is None or event.utterance_id != self._now.utterance_id:
            return
        self._now = event
        if event.state in UTTERANCE_ENDS:
            self._now = self._ends_ns = None
            self._next()
        elif event.state == "started" and self._ends_ns is None:
            ended_id, ends_ns = self._reported_end
            if ended_id != event.utterance_id:
                ends_ns = event.stamp_ns + round(estimated_duration_s(event.text) * 1e9)
            self._ends_ns = ends_ns
        self._show()

    def on_played(self, sound: PlayedSound, _raw: bytes | None = None) -> None:
        """Set the end time from audio played on this computer, exact to the sample. Any thread."""
        if sound.utterance_id:
            self._end_reported.emit(
                sound.utterance_id, sound.stamp_ns + len(sound.samples) * 10**9 // sound.sample_rate_hz
            )

    def _on_end_reported(self, utterance_id: str, ends_ns: int) -> None:
        self._reported_end = utterance_id, ends_ns
        if self._now is not None and self._now.utterance_id == utterance_id and self._now.state == "started":
            self._ends_ns = ends_ns
            self._show()

    def on_voice_changed(self) -> None:
        """Try again after a voice became available or was lost."""
        self._next()

    def on_voice_lost(self, kind: VoiceKind, detail: str) -> None:
        """Fail the current utterance of a voice that went away."""
        if self._now is not None and self._kind_of(self._now) == kind:
            self.report(replace(self._now, stamp_ns=clock.now_ns(), state="failed", detail=detail))
            self._now = self._ends_ns = None
            self._next()
            self._show()

    def _next(self) -> None:
        while self._now is None and self._waiting:
            queued = self._waiting[0]
            utterance = queued.utterance
            if self._voices[self._kind_of(utterance)].held_up:
                break
            self._waiting.popleft()
            with self._reporting:
                self._reported_on = utterance.utterance_id
            if self._voices[self._kind_of(utterance)].say(utterance, queued.spoken):
                self._now = utterance
            else:
                detail = NO_VOICE[self._kind]
                self.report(replace(utterance, stamp_ns=clock.now_ns(), state="failed", detail=detail))
        self._show()

    def _kind_of(self, utterance: UtteranceChanged) -> VoiceKind:
        return next((kind for kind in self._voices if kind == utterance.voice), "robot")

    def _show(self) -> None:
        waiting = tuple(queued.utterance for queued in self._waiting)
        self._state.speech.update(now=self._now, ends_ns=self._ends_ns, waiting=waiting)
