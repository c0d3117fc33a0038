"""Robot speech filter: recognises the robot's own words in a transcript.

The transcript is aligned with the robot's utterances, in order, by sound similarity; it counts as the robot's if the
times match too. A participant who answers "the kitchen" to "the kitchen or the lab?" says the same words, but later.

On a busy machine reports and sound may be seconds apart. So times alone decide only where they agree: each utterance is
heard once, and its words not heard yet are the robot's even if late. The delay is learned from whole sentences.
"""

import re
import unicodedata
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from statistics import median

from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.domain.value_class import Value

_MAX_UTTERANCES = 40
_ROBOT_ONLY = 0.97
_LETTERS_OF_RESIDUE = 45.0
"""A word or two may be made out of what is left of the robot: nine letters where seven tenths of it were the robot."""
_HARDLY_RESIDUE, _MORE_LETTERS = 0.87, 300.0
"""And a sentence where next to nothing else was heard: a participant is never so much softer than the robot."""
_LEAST_BESIDE_ROBOT_NS = 450_000_000
"""While the robot speaks less voice than that may be its own first syllable, in a room that is not known yet."""
_UNSURE, _UNSURE_WITHIN_NS, _UNSURE_SHARE = 0.45, 1_800_000_000, 0.8
"""Of what is left of the robot a recogniser makes words that it does not believe itself: a few, or where nearly all of
the sound was the robot.
"""
_SAME_MOMENT_S = 0.7
"""So exactly it is known when a word is heard and when the robot says it, with a pause in its sentence."""
_LETTERS_A_SECOND = 22.0
"""Nobody speaks faster: more was made out than was said."""
_MOSTLY_OTHERS = 0.5
_SHORT_ANSWER_LETTERS = 18
"""So much of what the robot says may be an answer to it; who says more of it in the same order is the robot."""
_SECONDS_A_LETTER = 0.07
_LEAST_ALIKE = 0.6
_STARTS_AFTER_NS = 300_000_000
_RINGS_NS, _RINGS_ABOUT_NS = 600_000_000, 2_500_000_000
"""How long after its end the robot's last word may be recognised: for a reported end, and for an estimated one."""
_WHOLE_LATE_S, _PART_LATE_S, _EARLY_S = 4.0, 1.5, 1.5
"""Longest delay from reported to heard robot speech on a busy machine: a whole sentence, some words. Last: how early,
if reported late."""
_WHOLE, _WHOLE_WORDS, _NOTHING_ELSE = 0.8, 3, 0.8
_REPORTED_LATE_S, _LATE_ALIKE = 3.0, 0.72
"""How late after its end a robot may report an unprompted sentence."""
_SOUNDS_ALIKE, _SOUNDS_ALIKE_COUNT = 0.45, 0.6
"""Of consonants in order: 288 pairs of other sentences have 0.2 in common, 0.41 at most. So much counts as enough."""
_SOUNDS_WITHIN_NS, _LEAST_SOUNDS = 700_000_000, 6
_LEARN_FROM_LETTERS = 12
_CAPTURED_SHARE = 0.6
_BREATH_NS = 150_000_000
"""Between two words of one sentence."""
_LATE_BY_SHARE = 0.3
"""Where the canceller found less of the robot than this, some words of its sentence are somebody else's."""
_BEGINNING_IS_ROBOTS, _ALL_OF_IT, _NEAR_ITS_END = 0.8, 0.95, 0.7
_GAP = re.compile(r"\{[^}]*\}")
_WORD = re.compile(r"[^\W_]+(?:['’][^\W_]+)*")
_NAME = "{"
"""Placeholder for a spoken name: not recorded, so it may be any word."""
_NUMBERS = dict(
    zip(
        map(str, range(13)),
        ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"),
        strict=True,
    )
)
_SOUNDS = (
    ("ph", "f"), ("gh", ""), ("wh", "w"), ("kn", "n"), ("wr", "r"), ("ck", "k"), ("qu", "kw"), ("x", "ks"), ("c", "k"),
    ("z", "s"), ("v", "f"), ("d", "t"), ("b", "p"), ("g", "k"), ("y", "i"),
)  # fmt: skip


class _Utterance(Value):
    utterance_id: str
    words: tuple[str, ...]
    started_ns: int
    ended_ns: int | None
    exactly: bool
    captured: frozenset[int] = frozenset()
    """The places of its words that a microphone has captured, until ``captured_until_ns``."""
    captured_until_ns: int = 0

    @property
    def end_ns(self) -> int:
        if self.ended_ns is not None:
            return self.ended_ns
        return self.started_ns + round(sum(len(word) + 1 for word in self.words) * _SECONDS_A_LETTER * 1e9)


class RobotSpeechFilter:
    """The robot's utterances, from its events, and the words of them that one microphone heard."""

    def __init__(self) -> None:
        self._sayings: deque[_Utterance] = deque(maxlen=_MAX_UTTERANCES)
        self._late_s = 0.0
        """Last delay from reported to heard."""
        self._captured_until_ns = 0
        """When the robot was heard last; 0 where it never was."""

    def robot_says(self, utterance: UtteranceChanged) -> None:
        """Add or update an utterance of the robot."""
        known = next((each for each in self._sayings if each.utterance_id == utterance.utterance_id), None)
        if utterance.state == "failed":
            if known is not None:
                self._sayings.remove(known)
            return
        if known is None:
            known = _Utterance(utterance.utterance_id, (), utterance.stamp_ns + _STARTS_AFTER_NS, None, exactly=False)
            self._sayings.append(known)
        words = _words(utterance.text) or known.words
        exactly = not utterance.estimated
        match utterance.state:
            case "started":
                now = replace(known, words=words, started_ns=utterance.stamp_ns, exactly=exactly)
            case "requested":
                now = replace(known, words=words)
            case _:
                now = replace(known, words=words, ended_ns=utterance.stamp_ns, exactly=known.exactly and exactly)
        self._sayings[self._sayings.index(known)] = now

    def is_robots(
        self,
        text: str,
        started_ns: int,
        ended_ns: int,
        echo_share: float | None = None,
        *,
        confidence: float | None = None,
        beside_robot: bool = False,
        late_s: float | None = None,
    ) -> float:
        """Fraction of a transcript that is the robot's: 0 nothing, 1 all of it.

        ``echo_share`` is the echo canceller's result for that time, None if unknown, as for a robot with its own voice.
        If the robot was certainly not heard, the same words are the participant's, who may repeat them; if nothing else
        was heard, all words are the robot's. ``beside_robot``: the canceller hears the robot as the voice begins.
        ``late_s`` is the delay at which the robot is heard in that very sound, None if it is not. ``confidence`` is the
        recogniser's for the words, None if unknown.
        """
        if echo_share is not None and echo_share >= _ROBOT_ONLY:
            return 1.0
        transcribed = _without_loops(_words(text))
        letters = sum(map(len, transcribed))
        if not letters:
            return 0.0
        if echo_share is not None and letters <= _letters_of_residue(echo_share):
            return 1.0
        if ended_ns - started_ns < _LEAST_BESIDE_ROBOT_NS and (beside_robot or self._speaks_at(started_ns)):
            return 1.0
        unsure = confidence is not None and confidence < _UNSURE
        if unsure and (echo_share or 0.0) >= _UNSURE_SHARE:
            return 1.0
        if unsure and late_s is not None and ended_ns - started_ns < _UNSURE_WITHIN_NS:
            return 1.0
        if (echo_share or 0.0) >= 0.3 and letters > _LETTERS_A_SECOND * (ended_ns - started_ns) / 1e9:
            return 1.0
        # If the canceller knows what was played, its timing is known too.
        slack_s, slack_of_length = (0.7, 0.15) if echo_share is None else (0.4, 0.1)
        most = 0.0
        for sayings in self._around(started_ns, ended_ns):
            spoken = [word for saying in sayings for word in saying.words]
            aligned = _aligned(transcribed, spoken)
            transcribed_late_s = _late_s(aligned, transcribed, (started_ns, ended_ns), sayings)
            if late_s is not None and aligned.pairs and abs(transcribed_late_s - late_s) <= _SAME_MOMENT_S:
                # Nobody says the robot's words with it.
                most = max(most, aligned.letters / letters)
            if aligned.letters <= _SHORT_ANSWER_LETTERS and echo_share is not None and echo_share < _MOSTLY_OTHERS:
                continue
            length_s = (sayings[-1].end_ns - sayings[0].started_ns) / 1e9
            allowed_s = slack_s + slack_of_length * length_s
            if not all(saying.exactly for saying in sayings):
                allowed_s += 2.0
            share = aligned.letters / letters
            # Remains of the robot's voice are recognised badly.
            nothing_else = max(0.5, _NOTHING_ELSE - 0.6 * max(0.0, (echo_share or 0.0) - 0.5))
            if abs(transcribed_late_s) <= allowed_s or (
                share >= nothing_else
                and self._may_be_as_late(transcribed_late_s, aligned, sayings, started_ns, echo_share)
            ):
                most = max(most, share)
            if echo_share is None or echo_share >= _MOSTLY_OTHERS:
                most = max(most, _sounds_like(transcribed, spoken, (started_ns, ended_ns), sayings))
        return most

    def _speaks_at(self, moment_ns: int) -> bool:
        """True if the robot is known to speak then, or was heard just before."""
        if 0 <= moment_ns - self._captured_until_ns <= _BREATH_NS:
            return True
        late_ns = round(self._late_s * 1e9)
        return any(
            saying.started_ns - _LEAST_BESIDE_ROBOT_NS <= moment_ns <= saying.end_ns + late_ns
            for saying in self._sayings
        )

    def _may_be_as_late(
        self,
        late_s: float,
        aligned: "_Aligned",
        sayings: Sequence[_Utterance],
        started_ns: int,
        echo_share: float | None,
    ) -> bool:
        """True if the robot's words come at a time at which they may still be heard."""
        spoken = [word for saying in sayings for word in saying.words]
        captured_before = [
            place in saying.captured and started_ns >= saying.captured_until_ns
            for saying in sayings
            for place in range(len(saying.words))
        ]
        new = [place for _at, place in aligned.pairs if not captured_before[place]]
        if len(new) < _CAPTURED_SHARE * len(aligned.pairs) or late_s < -_EARLY_S:
            return False
        left = sum(len(word) for word, before in zip(spoken, captured_before, strict=True) if not before)
        whole = aligned.letters >= _WHOLE * left and (
            len(new) >= _WHOLE_WORDS or aligned.letters > _SHORT_ANSWER_LETTERS
        )
        # No other speaker begins with words that the robot has only begun to say.
        begins = captured_before[: new[0]].count(False) <= 1 and started_ns <= sayings[-1].end_ns
        if whole or begins:
            return late_s <= _WHOLE_LATE_S + self._late_s
        if echo_share is not None and echo_share < _LATE_BY_SHARE:
            return False
        if not self._captured_until_ns and started_ns > sayings[-1].end_ns:
            return False
        return late_s <= max(_PART_LATE_S, self._late_s + 0.7)

    def late_similarity(self, text: str, started_ns: int) -> float:
        """Similarity of a transcript to a whole sentence of a robot that speaks unprompted and reports it during or
        after speaking: 1 identical, 0 certainly not.
        """
        transcribed = _without_loops(_words(text))
        most = 0.0
        for saying in self._sayings:
            since_s = (saying.started_ns - started_ns) / 1e9
            at_most_s = sum(len(word) + 1 for word in saying.words) * _SECONDS_A_LETTER + _REPORTED_LATE_S
            if saying.exactly or len(transcribed) < _WHOLE_WORDS or not -_RINGS_ABOUT_NS / 1e9 <= since_s <= at_most_s:
                continue
            # All of both: a person who says only some of the words may have asked for the robot's answer.
            alike = _aligned(transcribed, saying.words).letters / max(
                sum(map(len, transcribed)), sum(map(len, saying.words))
            )
            most = max(most, alike if alike >= _LATE_ALIKE else 0.0)
        return most

    def was_heard(self, text: str, started_ns: int, ended_ns: int) -> list[tuple[str, bool, bool]]:
        """Note words as heard from the robot: repetitions are another speaker's. Returns the utterances, and whether
        the interval begins and ends with their first and last word.
        """
        transcribed = _without_loops(_words(text))
        letters = sum(map(len, transcribed))
        found: list[tuple[str, bool, bool]] = []
        for saying in self._near(started_ns, ended_ns):
            aligned = _aligned(transcribed, saying.words)
            if not aligned.pairs or aligned.letters < _CAPTURED_SHARE * min(letters, sum(map(len, saying.words))):
                continue
            late_s = _late_s(aligned, transcribed, (started_ns, ended_ns), [saying])
            if not -_EARLY_S <= late_s <= _WHOLE_LATE_S + self._late_s:
                continue
            if saying.exactly and aligned.letters >= max(_LEARN_FROM_LETTERS, _CAPTURED_SHARE * letters):
                self._late_s = max(0.0, late_s)
            first, last = aligned.pairs[0], aligned.pairs[-1]
            begins = first[0] <= 1 and first[1] <= 1 and not saying.captured
            ends = len(transcribed) - last[0] <= 2 and len(saying.words) - last[1] <= 2
            found.append((saying.utterance_id, begins, ends))
            places = frozenset(place for _at, place in aligned.pairs)
            # Words between and before heard ones were heard, too.
            self._note_captured(saying, frozenset(range(max(places) + 1)), ended_ns)
        return found

    def was_heard_on_time(self, share_between: Callable[[int, int], float | None]) -> None:
        """Mark utterances as heard that the echo canceller found at their reported time.

        ``share_between``: the robot's share of the energy in an interval, None if unknown.
        """
        for saying in tuple(self._sayings):
            if saying.ended_ns is None or not saying.exactly or len(saying.captured) == len(saying.words):
                continue
            share = share_between(saying.started_ns, saying.ended_ns)
            if share is not None and share >= _CAPTURED_SHARE:
                self._note_captured(saying, frozenset(range(len(saying.words))), saying.ended_ns)

    def may_be_heard(self, moment_ns: int, rings_ns: int) -> bool:
        """True if a voice that begins then may be the robot's, by its utterances and delay."""
        until_ns = rings_ns + round(self._late_s * 1e9)
        return any(saying.started_ns - rings_ns <= moment_ns <= saying.end_ns + until_ns for saying in self._sayings)

    def _note_captured(self, saying: _Utterance, places: frozenset[int], until_ns: int) -> None:
        self._captured_until_ns = max(self._captured_until_ns, until_ns)
        now = replace(
            saying, captured=saying.captured | places, captured_until_ns=max(saying.captured_until_ns, until_ns)
        )
        self._sayings[self._sayings.index(saying)] = now

    def robots_beginning(
        self, words: Sequence[tuple[str, int]], started_ns: int, echo_share: float | None = None
    ) -> int:
        """Number of leading words that are the robot's, if another speaker continues; else 0.

        ``words`` are texts with their end times; the first begins at ``started_ns``.
        """
        most = 0
        for sayings in self._around(started_ns, words[-1][1]) if words else ():
            spoken = [word for saying in sayings for word in saying.words]
            ends_ns = sayings[-1].end_ns + (_RINGS_NS if sayings[-1].exactly else _RINGS_ABOUT_NS)
            ends_ns += round((_WHOLE_LATE_S + self._late_s) * 1e9)
            # By the start of a word: before silence, recognisers report word ends seconds too late.
            begin_ns = [started_ns, *(end_ns for _text, end_ns in words)]
            beginnings = [
                (count, _aligned(_words(" ".join(text for text, _end_ns in words[:count])), spoken))
                for count in range(1, len(words))
                if begin_ns[count - 1] <= ends_ns
            ]
            best_letters = max((aligned.letters for _count, aligned in beginnings), default=0.0)
            for count, aligned in beginnings:
                # The shortest complete match: a person who answers with the robot's last words repeats them.
                if aligned.letters < _ALL_OF_IT * best_letters or not aligned.pairs:
                    continue
                text, rest = (" ".join(each for each, _end_ns in part) for part in (words[:count], words[count:]))
                to_its_end = aligned.pairs[-1][1] >= _NEAR_ITS_END * (len(spoken) - 1)
                letters = sum(map(len, _words(text)))
                # The words themselves must match: short ones during loud robot speech belong to a person who continues.
                alike = aligned.letters >= _BEGINNING_IS_ROBOTS * letters
                robots = self.is_robots(text, started_ns, words[count - 1][1], echo_share)
                if to_its_end and alike and robots >= _BEGINNING_IS_ROBOTS and not _ends(spoken, rest):
                    most = max(most, count)
                break
        return most

    def _near(self, started_ns: int, ended_ns: int) -> list[_Utterance]:
        """Robot utterances around that interval, in order."""
        late_ns = (_WHOLE_LATE_S + self._late_s) * 1e9
        near = [
            saying
            for saying in self._sayings
            if saying.words and saying.started_ns - _EARLY_S * 1e9 <= ended_ns and started_ns <= saying.end_ns + late_ns
        ]
        return sorted(near, key=lambda saying: saying.started_ns)

    def _around(self, started_ns: int, ended_ns: int) -> list[list[_Utterance]]:
        """The same: each alone, and all combined."""
        near = self._near(started_ns, ended_ns)
        return [[saying] for saying in near] + ([near] if len(near) > 1 else [])


def _letters_of_residue(echo_share: float) -> float:
    """Number of letters that may be recognised while only the robot speaks."""
    beyond = max(0.0, echo_share - _HARDLY_RESIDUE)
    return _LETTERS_OF_RESIDUE * (echo_share - 0.5) + _MORE_LETTERS * beyond


def _words(text: str) -> tuple[str, ...]:
    plain = unicodedata.normalize("NFKC", _GAP.sub(f" {_NAME} ", text)).lower()
    found = re.findall(rf"{re.escape(_NAME)}|{_WORD.pattern}", plain)
    return tuple(_NUMBERS.get(word, word.replace("'", "").replace("’", "")) for word in found)


def _ends(spoken: Sequence[str], text: str) -> bool:
    """True if a text is just the end of the robot's sentence."""
    transcribed = _words(text)
    return not transcribed or list(transcribed) == list(spoken[-len(transcribed) :])


def _without_loops(words: tuple[str, ...]) -> tuple[str, ...]:
    """Words without immediate repetitions, which recognisers produce on unintelligible sound."""
    remaining: list[str] = []
    for word in words:
        remaining.append(word)
        for length in range(1, len(remaining) // 2 + 1):
            if remaining[-length:] == remaining[-2 * length : -length]:
                del remaining[-length:]
                break
    return tuple(remaining)


def _sounds_like(
    transcribed: Sequence[str], spoken: Sequence[str], interval_ns: tuple[int, int], sayings: Sequence[_Utterance]
) -> float:
    """Phonetic similarity of a transcript to the robot's simultaneous words, 0 if too low. Recognisers that hear a
    robot badly produce similar-sounding words: "That's him, I've got the quest" for "That is a good question".
    """
    one, other = ("".join(_sound_of(word).replace("a", "") for word in words) for words in (transcribed, spoken))
    if len(one) < _LEAST_SOUNDS or not other:
        return 0.0
    alike, first, end = _local_alignment(one, other)
    lasts_ns = max(1, sayings[-1].end_ns - sayings[0].started_ns)
    expected_ns = sayings[0].started_ns + lasts_ns * first / len(other)
    takes = (interval_ns[1] - interval_ns[0]) / max(1.0, lasts_ns * (end - first) / len(other))
    on_time = abs(interval_ns[0] - expected_ns) <= _SOUNDS_WITHIN_NS and 0.5 <= takes <= 2.0
    return max(alike, _SOUNDS_ALIKE_COUNT) if on_time and alike >= _SOUNDS_ALIKE else 0.0


def _local_alignment(one: str, other: str) -> tuple[float, int, int]:
    """Best local alignment of ``one`` with a part of ``other``: score and position (Smith and Waterman 1981)."""
    row: list[tuple[float, int]] = [(0.0, at) for at in range(len(other) + 1)]
    best, first, end = 0.0, 0, 0
    for letter in one:
        before, row = row, [(0.0, 0)]
        for at, against in enumerate(other, 1):
            score, begin = max(
                (before[at - 1][0] + (1.0 if letter == against else -0.7), before[at - 1][1]),
                (before[at][0] - 0.6, before[at][1]),
                (row[at - 1][0] - 0.6, row[at - 1][1]),
            )
            row.append((score, begin) if score > 0.0 else (0.0, at))
            if score > best:
                best, first, end = score, begin, at
    return best / len(one), first, end


def likeness(text: str, of: str) -> float:
    """Fraction of a text that matches another one, in order and phonetically, 0 to 1."""
    words = _words(text)
    return _aligned(words, _words(of)).letters / max(1, sum(map(len, words)))


class _Aligned(Value):
    """``letters`` of the transcript are the robot's; ``pairs`` are the indices of matching words."""

    letters: float
    pairs: tuple[tuple[int, int], ...]


def _aligned(transcribed: Sequence[str], spoken: Sequence[str]) -> _Aligned:
    """Global alignment (Needleman and Wunsch 1970). Similar words match, and two words may match one."""
    best: list[list[tuple[float, tuple[int, int, float] | None]]] = [
        [(0.0, None)] * (len(spoken) + 1) for _ in range(len(transcribed) + 1)
    ]
    for i in range(1, len(transcribed) + 1):
        for j in range(1, len(spoken) + 1):
            options: list[tuple[float, tuple[int, int, float] | None]] = [
                (best[i - 1][j][0], (1, 0, 0.0)),
                (best[i][j - 1][0], (0, 1, 0.0)),
            ]
            for step_i, step_j in ((1, 1), (2, 1), (1, 2)):
                if step_i <= i and step_j <= j:
                    one, other = "".join(transcribed[i - step_i : i]), "".join(spoken[j - step_j : j])
                    alike = len(one) * _alike(one, other)
                    if alike:
                        options.append((best[i - step_i][j - step_j][0] + alike, (step_i, step_j, alike)))
            best[i][j] = max(options, key=lambda option: option[0])
    i, j, pairs = len(transcribed), len(spoken), []
    while i and j:
        step = best[i][j][1]
        if step is None:
            break
        if step[2]:
            pairs.append((i - 1, j - 1))
        i, j = i - step[0], j - step[1]
    return _Aligned(best[len(transcribed)][len(spoken)][0], tuple(reversed(pairs)))


@lru_cache(maxsize=4096)
def _alike(transcribed: str, spoken: str) -> float:
    """Phonetic similarity of two words, 0 below a threshold."""
    if transcribed == spoken or _NAME in (transcribed, spoken):
        return 1.0
    one, other = _sound_of(transcribed), _sound_of(spoken)
    longer = max(len(one), len(other))
    if not longer or abs(len(one) - len(other)) > longer * (1 - _LEAST_ALIKE):
        return 0.0
    alike = 1.0 - _distance(one, other) / longer
    return alike if alike >= _LEAST_ALIKE else 0.0


def _sound_of(word: str) -> str:
    """Phonetic code: confusable consonants are merged, all vowels are equal."""
    for letters, sound in _SOUNDS:
        word = word.replace(letters, sound)
    return re.sub(r"(.)\1+", r"\1", re.sub(r"[aeiouäöü]+", "a", word))


def _distance(one: str, other: str) -> int:
    """Levenshtein distance."""
    row = list(range(len(other) + 1))
    for i, letter in enumerate(one, 1):
        before, row[0] = row[0], i
        for j, against in enumerate(other, 1):
            before, row[j] = row[j], min(row[j] + 1, row[j - 1] + 1, before + (letter != against))
    return row[-1]


def _late_s(
    aligned: _Aligned, transcribed: Sequence[str], interval_ns: tuple[int, int], sayings: Sequence[_Utterance]
) -> float:
    """Median delay of heard words relative to the robot's."""
    transcribed_at_s = _moments(transcribed, *interval_ns)
    spoken_at_s = [moment for saying in sayings for moment in _moments(saying.words, saying.started_ns, saying.end_ns)]
    return median([transcribed_at_s[i] - spoken_at_s[j] for i, j in aligned.pairs] or [0.0])


def _moments(words: Sequence[str], start_ns: int, end_ns: int) -> list[float]:
    """Time of each word in seconds, assuming a constant time per letter."""
    total = sum(len(word) + 1 for word in words)
    moments, before = [], 0.0
    for word in words:
        moments.append((start_ns + (end_ns - start_ns) * (before + len(word) / 2) / total) / 1e9)
        before += len(word) + 1
    return moments
