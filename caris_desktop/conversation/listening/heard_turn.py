"""One turn at a microphone: its sound and its transcript so far."""

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.listening.endpointing import RATE_HZ, WINDOW
from caris_desktop.conversation.listening.endpointing import SECONDS as JUDGED_S
from caris_desktop.conversation.listening.engines import Recognised
from caris_desktop.conversation.listening.recognised_words import (
    AgreedWords,
    RecognisedWord,
    within_voice,
    without_repetition,
)
from caris_desktop.domain.value_class import Value

_CUT_BEYOND_S, _CUT_ANYWHERE_BEYOND_S, _OVERLAP_S = 12.0, 22.0, 8.0
_CONTEXT_WORDS = 20
_SILENCE_JUDGED = 6
"""Windows: 0.2 s, which is how much silence there is behind a turn when it is judged."""
_EDGE_WITHIN_S = 0.8
"""So far from where the network noticed it a voice may begin or end."""
_WHOLE_NS = 100_000_000
"""So much silence behind the last word, and a pass over it has heard all of it."""


class TurnInterval(Value, eq=False):
    """Interval of a turn to transcribe, starting at ``from_s``; ``before`` is the text before it.

    ``voice_ended_s`` is the end of the voice, in seconds of the turn.
    """

    turn_id: str
    sound: NDArray[np.float32]
    from_s: float
    voice_ended_s: float
    before: str
    at_pause: bool

    @property
    def voice_s(self) -> float:
        """End of the voice in the interval's sound."""
        return self.voice_ended_s - self.from_s


class TurnAudio:
    """Turn that grows by windows. Costs are bounded: committed sound is not processed again."""

    def __init__(
        self,
        turn_id: str,
        sound_from_ns: int,
        voice_began_ns: int,
        sound: list[NDArray[np.float32]],
        last_window: int = 0,
    ) -> None:
        self.turn_id = turn_id
        self.sound_began_ns = voice_began_ns
        """Where the voice began, also where that was the robot's."""
        self.voice_began_ns = voice_began_ns
        self.voice_ended_ns = voice_began_ns
        self.words = AgreedWords()
        self.language = ""
        self.turn_over: float | None = None
        self.sounds_over: float | None = None
        """The same by its sound alone."""
        self.revision = 0
        self.over = False
        self.reported = False
        """Whether it was reported: not while it may be the robot's own voice."""
        self.reported_began_ns = 0
        self.robots_words = 0
        """So many of its first words are the robot's, whose sentence somebody took up at once."""
        self.requested = False
        self._sound_from_ns = sound_from_ns
        self._windows = sound
        self._last_window = last_window
        self._to_judge = deque(sound, maxlen=JUDGED_S * RATE_HZ // WINDOW)
        self._silent = 0
        self._dropped = 0
        self._from_s = 0.0
        self._requested_until_ns = 0
        self._known_until_ns = 0

    def add_window(self, window: NDArray[np.float32], number: int, *, voiced: bool) -> None:
        """Add the microphone's window ``number``."""
        self._windows.append(window)
        self._last_window = number
        self._silent = 0 if voiced else self._silent + 1
        if self._silent <= _SILENCE_JUDGED:
            self._to_judge.append(window)

    def replace_windows(self, windows: Sequence[NDArray[np.float32]], last: int) -> None:
        """Replace recent windows up to ``last`` after better echo cancellation; changed ones must
        be transcribed again.
        """
        own_windows = windows[: max(0, len(windows) - (last - self._last_window))]
        changed = 0
        for window, again in zip(reversed(self._windows), reversed(own_windows), strict=False):
            window[:] = again
            changed += 1
        if changed:
            from_ns = self._sound_from_ns + round((self._seconds - changed * WINDOW / RATE_HZ) * 1e9)
            self._requested_until_ns = min(self._requested_until_ns, from_ns)
            self._known_until_ns = min(self._known_until_ns, from_ns)

    @property
    def known_whole(self) -> bool:
        """True if everything up to the end of the voice has been transcribed."""
        needed_ns = self.voice_ended_ns + _WHOLE_NS
        if self.over:  # a turn that was ended within speech has no silence after it
            needed_ns = min(needed_ns, self._sound_from_ns + round(self._seconds * 1e9))
        return self._known_until_ns >= needed_ns

    @property
    def texts(self) -> tuple[str, str]:
        """Committed and tentative text, without the robot's words."""
        return self.words.texts_from(self.robots_words)

    @property
    def own_words(self) -> tuple[RecognisedWord, ...]:
        """All words except the robot's."""
        return self.words.words[self.robots_words :]

    def moment_of(self, seconds: float) -> int:
        """Session time of a position in its sound."""
        return self._sound_from_ns + round(seconds * 1e9)

    @property
    def confidence(self) -> float | None:
        """Mean word probability, 0 to 1."""
        known = [word.probability for word in self.own_words if word.probability is not None]
        return sum(known) / len(known) if known else None

    def unheard_s(self, until_ns: int) -> float:
        """Seconds of voice not yet transcribed."""
        return (until_ns - max(self._requested_until_ns, self.voice_began_ns)) / 1e9

    def sound_to_judge(self) -> NDArray[np.float32]:
        """Sound for the end-of-turn model. Silences are shortened: long ones would be mistaken for the end, and
        displace speech.
        """
        return np.concatenate(self._to_judge)

    def ask(self, *, at_pause: bool) -> TurnInterval:
        """Interval to transcribe now. ``take`` must follow."""
        self.requested = True
        self._requested_until_ns = self._sound_from_ns + round(self._seconds * 1e9)
        self._cut()
        before = " ".join(self.words.committed.split()[-_CONTEXT_WORDS:]) if self._from_s else ""
        ended_s = (self.voice_ended_ns - self._sound_from_ns) / 1e9
        return TurnInterval(self.turn_id, self._sound_of(self._from_s), self._from_s, ended_s, before, at_pause)

    def add_result(self, stretch: TurnInterval, recognised: Recognised | None) -> bool:
        """Add a transcript; None if recognition failed. True if the words changed."""
        self.requested = False
        self._known_until_ns = self._requested_until_ns
        if recognised is None:
            return False
        self.language = recognised.language
        before = self.words.committed, self.words.tentative
        words = [word.later_by(stretch.from_s) for word in recognised.words]
        self.words.add(without_repetition(within_voice(words, stretch.voice_ended_s)))
        return self._changed_since(before)

    def commit_all(self) -> bool:
        """Commit all words. True if this changed anything."""
        before = self.words.committed, self.words.tentative
        self.words.commit_all()
        return self._changed_since(before)

    def _changed_since(self, before: tuple[str, str]) -> bool:
        changed = before != (self.words.committed, self.words.tentative)
        self.revision += changed
        return changed

    def onset_ns(self, about_ns: int, *, nearest: bool = False) -> int:
        """Sample-accurate onset of a voice detected at about that time."""
        sound, from_ns = self._around(about_ns)
        return from_ns + round(onset_s(sound, (about_ns - from_ns) / 1e9, nearest=nearest) * 1e9)

    def end_ns(self, about_ns: int) -> int:
        """Sample-accurate end of a voice that ended at about that time."""
        sound, from_ns = self._around(about_ns)
        return from_ns + round(end_s(sound, (about_ns - from_ns) / 1e9) * 1e9)

    def _around(self, about_ns: int) -> tuple[NDArray[np.float32], int]:
        from_s = max(0.0, (about_ns - self._sound_from_ns) / 1e9 - _EDGE_WITHIN_S)
        from_s = int(from_s * RATE_HZ) // WINDOW * WINDOW / RATE_HZ
        first = max(from_s, self._dropped * WINDOW / RATE_HZ)
        sound = self._sound_of(first)[: round((2 * _EDGE_WITHIN_S) * RATE_HZ)]
        return sound, self._sound_from_ns + round(first * 1e9)

    @property
    def _seconds(self) -> float:
        return (self._dropped + len(self._windows)) * WINDOW / RATE_HZ

    def _sound_of(self, from_s: float) -> NDArray[np.float32]:
        first = max(0, int(from_s * RATE_HZ) // WINDOW - self._dropped)
        windows = self._windows[first:]
        return np.concatenate(windows) if windows else np.zeros(0, np.float32)

    def _cut(self) -> None:
        long_s = self._seconds - self._from_s
        if long_s <= _CUT_BEYOND_S:
            return
        at_s = self.words.cut_at_s()
        if (at_s is None or at_s <= self._from_s) and long_s > _CUT_ANYWHERE_BEYOND_S:
            # No sentence ends, or passes never agree: use what there is.
            self.words.commit_all()
            at_s = self.words.cut_at_s(sentences=False)
            if at_s is None or at_s <= self._from_s:
                at_s = self._seconds - _OVERLAP_S
        if at_s is not None and at_s > self._from_s:
            self._from_s = int(at_s * RATE_HZ) // WINDOW * WINDOW / RATE_HZ
            unneeded = int(self._from_s * RATE_HZ) // WINDOW - self._dropped
            del self._windows[:unneeded]
            self._dropped += unneeded


_FRAME = RATE_HZ // 100
_ABOVE_NOISE, _BELOW_TOP = 3.0, 0.02
"""A voice is 10 dB above the noise around it, and not 34 dB below its loudest moment: that is the room's echo."""
_MIN_MARGIN = 2.0
"""If the loudest is hardly above that, voice and noise are indistinguishable."""
_CLOSED_FRAMES = 15
"""A plosive, or the breath between two words, ends no voice."""
_CLICK_FRAMES = 3


def voiced_spans(sound: NDArray[np.float32]) -> list[tuple[float, float]]:
    """Voice intervals in seconds, without clicks; empty if noise cannot be distinguished."""
    frames = sound[: len(sound) // _FRAME * _FRAME].reshape(-1, _FRAME)
    if not len(frames):
        return []
    levels = np.sqrt((frames.astype(np.float64) ** 2).mean(axis=1))
    top = float(np.quantile(levels, 0.95))
    least = max(_ABOVE_NOISE * float(np.quantile(levels, 0.1)), _BELOW_TOP * top)
    if top < _MIN_MARGIN * least or not top:
        return []
    edges = np.flatnonzero(np.diff(np.concatenate(([0], levels > least, [0])).astype(np.int8)))
    spans: list[tuple[int, int]] = []
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if spans and first - spans[-1][1] <= _CLOSED_FRAMES:
            spans[-1] = spans[-1][0], end
        else:
            spans.append((first, end))
    frame_s = _FRAME / RATE_HZ
    return [(first * frame_s, end * frame_s) for first, end in spans if end - first > _CLICK_FRAMES]


def onset_s(sound: NDArray[np.float32], about_s: float, *, nearest: bool = False) -> float:
    """Start of the voice that was detected at about that time, or of the ``nearest`` one; ``about_s`` if none is found.
    In seconds of ``sound``.
    """
    spans = voiced_spans(sound)
    if nearest:
        return min((first for first, _ in spans), key=lambda first: abs(first - about_s), default=about_s)
    return next((first for first, end in spans if end > about_s), about_s)


def end_s(sound: NDArray[np.float32], about_s: float) -> float:
    """End of the voice that was expected at about that time; ``about_s`` if none is found. In seconds of ``sound``."""
    return next((end for first, end in reversed(voiced_spans(sound)) if first < about_s), about_s)
