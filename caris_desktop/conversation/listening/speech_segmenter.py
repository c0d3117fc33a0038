"""Speech segmentation of one microphone: sound in; turns, transcripts and reports to the console out.

No thread and no clock: the caller passes in sound, requests the interval to transcribe, and returns its words.
"""

import itertools
import math
import re
import secrets
from collections import deque
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.listening.echo import CleanSound, EchoCanceller
from caris_desktop.conversation.listening.endpointing import RATE_HZ, WINDOW, TurnTaking, VoiceActivity
from caris_desktop.conversation.listening.endpointing import SECONDS as JUDGED_S
from caris_desktop.conversation.listening.engines import Recognised
from caris_desktop.conversation.listening.recognised_words import (
    AgreedWords,
    RecognisedWord,
    within_voice,
    without_repetition,
)
from caris_desktop.conversation.listening.robot_speech_filter import RobotSpeechFilter
from caris_desktop.domain.actor import CONSOLE
from caris_desktop.domain.events import UtteranceChanged, UtteranceCorrected, UtteranceState
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import WIZARD_MICROPHONE, Hearing
from caris_desktop.domain.translation import QT_TR_NOOP
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


_WINDOW_NS = WINDOW * 1_000_000_000 // RATE_HZ
_BEFORE_VOICE_NS = 400_000_000
"""The first sound of a word is weak: this much before the voice goes along."""
_HOLE_NS = 60_000_000
_LONGEST_HOLE_NS = 12_000_000_000
_SETTLED_NS = 500_000_000
"""After so long a silence the words before it are not going to be others."""
_ROBOT_RINGS_NS = 200_000_000
"""How long a room repeats what the robot has said; until then its words show whose voice it is."""
_EARLIER_TURNS = 4
"""Number of turns as which a robot sentence with pauses may be reported."""
_ONLY_ROBOT = 0.9
_ROBOTS_WORDS = 0.6
_NOTHING_BEYOND = 0.1
"""A participant over a robot that is 6 dB louder makes up 0.15 of the energy beyond it."""


class _Finished(Value):
    """Turn that was reported as the participant's."""

    turn_id: str
    text: str
    began_ns: int


class SpeechSegmenter:
    """``report`` receives reports to the console; ``turn_over`` estimates the probability that a turn's sound is
    complete.
    """

    def __init__(
        self,
        source: str,
        turns: TurnTaking,
        voices: VoiceActivity,
        *,
        canceller: EchoCanceller,
        robot_speech: RobotSpeechFilter,
        turn_over: Callable[[NDArray[np.float32]], float] | None,
        report: Callable[[Hearing | UtteranceChanged | UtteranceCorrected], None],
    ) -> None:
        self.source = source
        self.canceller = canceller
        self._of_wizard = source == WIZARD_MICROPHONE
        self._turns = turns
        self._voices = voices
        self._robot_speech = robot_speech
        self._turn_over = turn_over
        self._report = report
        self._rest = np.zeros(0, np.float32)
        self._until_ns = 0
        self._lead: list[NDArray[np.float32]] = []
        self._to_judge = self._robot_speaks = False
        self._robot_until_ns = 0
        self._windows = 0
        """So many were heard since the beginning."""
        self._turn: TurnAudio | None = None
        self._ending: list[TurnAudio] = []
        self._finished: deque[_Finished] = deque(maxlen=_EARLIER_TURNS)

    @property
    def heard_until_ns(self) -> int:
        """End of the sound received so far; 0 before the first."""
        return self._until_ns

    @property
    def busy(self) -> bool:
        """True while a turn is in progress or being transcribed."""
        return self._turn is not None or bool(self._ending)

    def process(self, chunk: AudioChunk) -> None:
        """Process the next sound of this microphone."""
        clean: CleanSound = self.canceller.process(chunk)
        if len(clean.again):
            self._reprocess(clean.again)
        if not len(clean.samples):
            return
        hole_ns = clean.stamp_ns - self._until_ns - len(self._rest) * 1_000_000_000 // RATE_HZ
        if abs(hole_ns) > _HOLE_NS:
            if self._until_ns and hole_ns > 0:
                self.add_silence(min(clean.stamp_ns, self._until_ns + _LONGEST_HOLE_NS))
            self._rest = np.zeros(0, np.float32)
            self._until_ns = clean.stamp_ns
        sound = np.concatenate((self._rest, clean.samples))
        usable = len(sound) // WINDOW * WINDOW
        for at in range(0, usable, WINDOW):
            self._process_window(sound[at : at + WINDOW], clean.echo_share)
        self._rest = sound[usable:]

    def _reprocess(self, sound: NDArray[np.float32]) -> None:
        """Process the newest sound again after better echo cancellation: uncommitted words may change."""
        rest = len(self._rest)
        if rest:
            self._rest[-len(sound) :] = sound[-rest:]
            sound = sound[:-rest]
        count = len(sound) // WINDOW
        windows = list(sound[len(sound) - count * WINDOW :].reshape(count, WINDOW))
        for window, again in zip(reversed(self._lead), reversed(windows), strict=False):
            window[:] = again
        for turn in (*self._ending, self._turn):
            if turn is not None:
                turn.replace_windows(windows, self._windows)

    def add_silence(self, until_ns: int) -> None:
        """Count missing sound until that time as silence."""
        self._rest = np.zeros(0, np.float32)
        for _ in range((until_ns - self._until_ns) // _WINDOW_NS):
            self._process_window(np.zeros(WINDOW, np.float32), 0.0)

    def end_turn(self) -> None:
        """End the turn because a recording ends or pauses; later speech is another turn."""
        if self._turn is not None:
            turn = self._turn
            self._turns.end()
            self._end(turn)

    def another_spoke(self) -> None:
        """The robot starts an utterance."""
        self._robot_speaks = True
        self._turns.another_spoke()

    def another_ended(self, stamp_ns: int) -> None:
        """The robot's utterance ended."""
        self._robot_speaks, self._robot_until_ns = False, stamp_ns

    def reassign_robot_turns(self) -> None:
        """Reassign finished turns that were the robot's own speech, by later reports of its utterances."""
        finished = list(self._finished)
        runs = [finished[first:last] for first, last in itertools.combinations(range(len(finished) + 1), 2)]
        robots = max(runs, key=self._late_similarity, default=[])
        if not self._late_similarity(robots):
            return
        for turn in robots:
            self._finished.remove(turn)
            self._report(UtteranceCorrected(self._until_ns, turn.turn_id, speaker="robot", person_id="", actor=CONSOLE))

    def _late_similarity(self, turns: Sequence[_Finished]) -> float:
        if not turns:
            return 0.0
        text = " ".join(turn.text for turn in turns)
        return self._robot_speech.late_similarity(text, turns[0].began_ns)

    def judge(self) -> None:
        """Estimate the end of turn by sound at a new pause. It takes 0.1 s, during which its words can be recognised:
        call it after ``wanted``.
        """
        turn, to_judge, self._to_judge = self._turn, self._to_judge, False
        if to_judge and turn is not None and self._turn_over is not None and not self._turns.speaking:
            turn.sounds_over = self._turn_over(turn.sound_to_judge())
            if self._judge_words(turn):
                self._report_hearing(turn)

    def next_interval(self, every_s: float) -> TurnInterval | None:
        """Interval to transcribe now; ``every_s``: minimum new sound during continuous speech."""
        for turn in (*self._ending, self._turn):
            if turn is None or turn.requested:
                continue
            if turn.over or not self._turns.speaking:
                if not turn.known_whole:
                    return turn.ask(at_pause=True)
            elif self._turns.voiced and turn.unheard_s(self._until_ns) >= every_s:
                # Not during a silence that may become a pause: its transcription would be delayed.
                return turn.ask(at_pause=False)
        return None

    def add_result(self, stretch: TurnInterval, recognised: Recognised | None) -> None:
        """Add the transcript of an interval; None if recognition failed."""
        for turn in (*self._ending, self._turn):
            if turn is None or turn.turn_id != stretch.turn_id:
                continue
            changed = turn.add_result(stretch, recognised)
            changed |= self._leave_out_the_robot(turn)
            if not turn.reported and turn.own_words and not self._is_robots(turn):
                self._report_beginning(turn)
            if not turn.over:
                judged = self._judge_words(turn)
                if self._settle(turn) or changed or judged:
                    self._report_hearing(turn)
            elif turn.known_whole:
                self._finish(turn)

    def _process_window(self, window: NDArray[np.float32], echo_share: float) -> None:
        began_ns, self._until_ns = self._until_ns, self._until_ns + _WINDOW_NS
        self._windows += 1
        voice = self._voices.probability(window)
        if echo_share >= _ONLY_ROBOT:
            voice = 0.0
        change = self._turns.process(began_ns, _WINDOW_NS, voice)
        turn = self._turn
        if turn is None:
            self._lead.append(window)
            if change == "began":
                self._begin()
            elif len(self._lead) * _WINDOW_NS > _BEFORE_VOICE_NS + self._turns.beginning_ns:
                del self._lead[0]
            return
        turn.add_window(window, self._windows, voiced=self._turns.voiced)
        turn.voice_ended_ns = self._turns.voice_ended_ns
        match change:
            case "spoke on":
                turn.turn_over = turn.sounds_over = None
                turn.revision += 1
                self._report_hearing(turn)
            case "paused":
                self._to_judge = self._turn_over is not None
                self._report_hearing(turn)
            case "over":
                self._end(turn)
            case _ if self._settle(turn):
                self._report_hearing(turn)

    def _begin(self) -> None:
        lead, self._lead = self._lead, []
        turn_id = f"h-{secrets.token_hex(4)}"
        sound_from_ns = self._until_ns - len(lead) * _WINDOW_NS
        turn = self._turn = TurnAudio(turn_id, sound_from_ns, self._turns.started_ns, lead, self._windows)
        turn.voice_began_ns = turn.onset_ns(turn.voice_began_ns)
        turn.voice_ended_ns = self._until_ns
        self._turns.turn = turn_id
        robot_audible = (
            self._robot_speaks
            or turn.voice_began_ns <= self._robot_until_ns + _ROBOT_RINGS_NS
            or self._robot_speech.may_be_heard(turn.voice_began_ns, _ROBOT_RINGS_NS)
        )
        if self._of_wizard or not robot_audible:
            self._report_beginning(turn)

    def _judge_words(self, turn: TurnAudio) -> bool:
        """Update the end-of-turn estimate by words once the transcript reaches the pause. True if it changed."""
        if self._turns.speaking or not turn.known_whole or turn.sounds_over is None:
            return False
        before, text = turn.turn_over, " ".join(word.text for word in turn.own_words)
        turn.turn_over = with_words(turn.sounds_over, text, turn.language)
        self._turns.judge(turn.turn_over)
        return turn.turn_over != before

    def _settle(self, turn: TurnAudio) -> bool:
        """Commit the words after silence, if all sound was transcribed. True if any were committed."""
        silent_ns = self._until_ns - turn.voice_ended_ns
        return bool(turn.known_whole and silent_ns >= _SETTLED_NS and turn.words.tentative and turn.commit_all())

    def _end(self, turn: TurnAudio) -> None:
        turn.over = True
        self._turn = None
        if turn.known_whole:
            self._finish(turn)
        else:
            self._ending.append(turn)

    def _finish(self, turn: TurnAudio) -> None:
        if turn in self._ending:
            self._ending.remove(turn)
        turn.commit_all()
        text, _none = turn.texts
        robots = not self._of_wizard and self._is_robots(turn)
        if robots or turn.robots_words:
            robot_text = text if robots else ""
            began_ns = turn.sound_began_ns
            words = " ".join(word.text for word in turn.words.words[: turn.robots_words])
            until_ns = turn.voice_ended_ns if robots else turn.voice_began_ns
            captured = self._robot_speech.was_heard(f"{words} {robot_text}", began_ns, until_ns)
            if self.canceller.share_between(began_ns, until_ns) is None:
                # The robot's own speech synthesis: its reported times are not from samples.
                self._report_times(turn.onset_ns(began_ns), turn.end_ns(until_ns), captured)
        if not turn.reported:
            return
        if self._of_wizard:
            # No further report after it: only the newest is retained, and this one has all words.
            turn.turn_over = 1.0
            self._report_hearing(turn)
            return
        if not text:
            self._report_utterance(turn, "failed", turn.voice_ended_ns, detail=QT_TR_NOOP("no words were recognised"))
        elif robots:
            self._report_utterance(
                turn, "failed", turn.voice_ended_ns, detail=QT_TR_NOOP("it was the robot's own voice")
            )
        else:
            if turn.voice_began_ns != turn.reported_began_ns:
                began = UtteranceCorrected(self._until_ns, turn.turn_id, start_ns=turn.voice_began_ns, actor=CONSOLE)
                self._report(began)
            self._report_utterance(turn, "finished", max(turn.end_ns(turn.voice_ended_ns), turn.voice_began_ns), text)
            self._finished.append(_Finished(turn.turn_id, text, turn.voice_began_ns))
        if self._turn is None:
            self._report(Hearing(self._until_ns, self.source, speaking=False, revision=turn.revision + 1))

    def _leave_out_the_robot(self, turn: TurnAudio) -> bool:
        """Exclude the robot's own words at the start of a turn, as when a participant answers before its voice has
        decayed. True if the number of its words changed.
        """
        if self._of_wizard:
            return False
        words = [(word.text, turn.moment_of(word.end_s)) for word in turn.words.words]
        share = self.canceller.share_between(turn.sound_began_ns, turn.voice_ended_ns)
        count = self._robot_speech.robots_beginning(words, turn.sound_began_ns, share)
        if count == turn.robots_words:
            return False
        # Possibly fewer than before: the rest of the sentence may show that it is all the robot's.
        turn.robots_words = count
        turn.revision += 1
        if count:
            # Recognisers' word starts are inexact by half a second.
            began_ns = turn.onset_ns(turn.moment_of(turn.own_words[0].start_s), nearest=True)
        else:
            began_ns = turn.onset_ns(turn.sound_began_ns)
        turn.voice_began_ns = min(began_ns, turn.voice_ended_ns)
        return True

    def _is_robots(self, turn: TurnAudio) -> bool:
        text = " ".join(turn.texts)
        self._robot_speech.was_heard_on_time(self.canceller.share_between)
        began_ns, ended_ns = turn.voice_began_ns, turn.voice_ended_ns
        robot_sound = self.canceller.heard_in(began_ns, ended_ns) if turn.over else None
        if robot_sound is not None and robot_sound.beyond <= _NOTHING_BEYOND:
            return True
        robots = self._robot_speech.is_robots(
            text,
            began_ns,
            ended_ns,
            self.canceller.share_between(began_ns, ended_ns),
            confidence=turn.confidence,
            beside_robot=self.canceller.plays_at(began_ns),
            late_s=None if robot_sound is None else robot_sound.late_s,
        )
        return robots >= _ROBOTS_WORDS

    def _report_utterance(
        self, turn: TurnAudio, state: UtteranceState, stamp_ns: int, text: str = "", *, detail: str = ""
    ) -> None:
        if self._of_wizard:
            return
        known = state == "finished"
        self._report(
            UtteranceChanged(
                stamp_ns, turn.turn_id, "participant", text, "heard", state,
                detail=detail, source=self.source,
                confidence=turn.confidence if known else None, language=turn.language if known else "",
            )
        )  # fmt: skip

    def _report_times(self, began_ns: int, ended_ns: int, captured: Sequence[tuple[str, bool, bool]]) -> None:
        """Report measured start and end times of the robot's utterances."""
        for utterance_id, begins, ends in captured:
            start_ns, end_ns = began_ns if begins else None, ended_ns if ends else None
            if start_ns is not None or end_ns is not None:
                self._report(
                    UtteranceCorrected(self._until_ns, utterance_id, start_ns=start_ns, end_ns=end_ns, actor=CONSOLE)
                )

    def _report_beginning(self, turn: TurnAudio) -> None:
        turn.reported, turn.reported_began_ns = True, turn.voice_began_ns
        self._report_utterance(turn, "started", turn.voice_began_ns)
        self._report_hearing(turn)

    def _report_hearing(self, turn: TurnAudio) -> None:
        if not turn.reported:
            return
        speaking = turn is self._turn and self._turns.speaking
        speaker: Literal["participant", "robot", "wizard"] = "wizard" if self._of_wizard else "participant"
        if speaker == "participant" and turn.own_words and self._is_robots(turn):
            speaker = "robot"
        committed, tentative = turn.texts
        self._report(
            Hearing(
                self._until_ns, self.source, speaking, speaker, turn.turn_id,
                committed=committed,
                tentative=tentative,
                speech_started_ns=turn.voice_began_ns,
                silent_since_ns=None if speaking else turn.voice_ended_ns,
                turn_over=turn.turn_over,
                revision=turn.revision,
            )
        )  # fmt: skip


_ENGLISH = (
    "a an the every each another my your our their its his such several many few "
    "of to with at for from by as than into onto upon between among during without within towards against until per "
    "and or but because if when while although whereas unless whether that who whose which what how why where "
    "i we he she they it's i'm we're they're he's she's that's there's you're i've we've they've you've "
    "i'll we'll they'll he'll she'll you'll i'd we'd they'd "
    "very really rather quite almost just even um uh er erm uhm hmm well so not"
)
_GOES_ON = {"en": frozenset(_ENGLISH.split())}
"""Words after which people go on, nearly always; of a language that is not here the marks alone are looked at."""
_ENGLISH_VERBS = (
    "am is are was were be been being have has had do does did will would can could shall should may might must"
)
_CONTINUES_WITHOUT_PRONOUN = {"en": frozenset(_ENGLISH_VERBS.split())}
"""The same, but for short answers: "Yes, I do", "it was"."""
_ENGLISH_PRONOUNS = ("i", "you", "he", "she", "it", "we", "they", "this", "that", "there")
_PRONOUNS = {"en": frozenset(_ENGLISH_PRONOUNS)}
_ENGLISH_BEGINNINGS = """
i think, i guess, i mean, i wonder, i would say, i suppose, i believe, i am afraid, i'm afraid, i hope,
tell me, told me, asked me, ask me, show me, give me, gave me, do you think, do you know, let me,
would like, i like, can you, could you, would you, will you, can i, could i, may i,
there is, there are, there was, there were, is there, are there,
have to, had to, has to, want to, going to, able to, used to,
out of, one of, a lot of, kind of, sort of, because of, instead of, next to, how many, how much,
the first, the last, the next, the same, the most, the best, my first, in front
"""
_BEGINNINGS = {"en": tuple(tuple(each.split()) for each in _ENGLISH_BEGINNINGS.split(","))}
"""What more has to follow."""
_ENGLISH_ALONE = "yesterday sometimes usually normally actually maybe perhaps however often once then also"
_ALONE = {"en": frozenset(_ENGLISH_ALONE.split())}
"""What a sentence may begin with and is hardly one: the second word at most."""
_ENGLISH_SUBORDINATE = "when if because since after before while whenever although though once until as unless"
_SUBORDINATE = {"en": frozenset(_ENGLISH_SUBORDINATE.split())}
_ASKS = {"en": _CONTINUES_WITHOUT_PRONOUN["en"]}
_SHORT_CLAUSE = 7
"""Words: a clause that begins with "when" and is no longer has another one behind it."""
_ENDED = (".", "!", "。", "！")
_QUESTION = ("?", "？")
_OPEN = ("...", "…", ",", "，", "-", "–", ":")
_SENTENCE = re.compile(r"[.?!]\s+")
_EDGES = ".,!?…-–:;\"'"
# Log odds that a turn is over at a pause: logistic regression on synthetic turns of four voices, with sentences outside
# of the test set. The sound has a higher weight than those voices, with little melody, would give.
_AT_ANY_PAUSE, _GOING_ON, _FULL_STOP, _QUESTION_MARK, _SOUND = -1.45, -1.45, 1.7, 1.05, 0.15
_LEAST_SURE = 0.005


def with_words(turn_over: float, text: str, language: str) -> float:
    """Probability that a turn is over, from its sound and its transcript so far."""
    sound = min(1.0 - _LEAST_SURE, max(_LEAST_SURE, turn_over))
    odds = _AT_ANY_PAUSE + _SOUND * math.log(sound / (1.0 - sound))
    written = text.rstrip()
    # Recognisers hear the melody, too.
    if goes_on(written, language):
        odds += _GOING_ON
    elif written.endswith(_QUESTION):
        odds += _QUESTION_MARK
    elif written.endswith(_ENDED):
        odds += _FULL_STOP
    return 1.0 / (1.0 + math.exp(-odds))


def goes_on(text: str, language: str) -> bool:
    """True if a text ends where sentences rarely end."""
    written = text.rstrip()
    if written.endswith(_OPEN):
        return True
    words = [bare for word in written.casefold().split() if (bare := word.strip(_EDGES))]
    if not words:
        return False
    last, before = words[-1], words[-2] if len(words) > 1 else ""
    # A question may end in any of them: where are you from?
    if not written.endswith(_QUESTION) and (
        last in _GOES_ON.get(language, ())
        or (last in _CONTINUES_WITHOUT_PRONOUN.get(language, ()) and before not in _PRONOUNS.get(language, ()))
    ):
        return True
    if any(tuple(words[-len(each) :]) == each for each in _BEGINNINGS.get(language, ())):
        return True
    if len(words) <= 2 and last in _ALONE.get(language, ()):
        return True
    clause = _SENTENCE.split(written)[-1].casefold()
    first, *rest = [word.strip(_EDGES) for word in clause.split()] or [""]
    return (
        first in _SUBORDINATE.get(language, ())
        and "," not in clause
        and len(rest) < _SHORT_CLAUSE
        and not (rest and rest[0] in _ASKS.get(language, ()))
    )
