"""Dual speech output: the robot and this computer speak the same utterance."""

import threading
from collections.abc import Callable
from dataclasses import replace

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.live.speech_queue import NO_VOICE, Voice, VoiceKind

_ENDS = ("finished", "interrupted", "failed")


class DualSpeechOutput:
    """Voice composed of two. It starts with the first and ends with the last.

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
        if change.state in _ENDS:
            self._speaking.discard(change.voice)
            self._ended.append(change)
            return None if self._speaking else _last_word(self._ended)
        began, self._started = not self._started, True
        return replace(change, voice="both") if began else None


def _last_word(ended: list[UtteranceChanged]) -> UtteranceChanged:
    """Combined outcome: the utterance counts as spoken if one voice finished it; the detail has the other's outcome."""
    best = min(ended, key=lambda one: ("finished", "interrupted", "failed").index(one.state))
    return replace(
        best,
        stamp_ns=max(one.stamp_ns for one in ended),
        voice="both",
        detail="; ".join(dict.fromkeys(one.detail for one in ended if one.detail)),
        estimated=any(one.estimated for one in ended),
    )
