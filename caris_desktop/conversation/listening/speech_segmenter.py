"""Speech segmentation of one microphone: sound in; turns, transcripts and reports to the console out.

No thread and no clock: the caller passes in sound, requests the interval to transcribe, and returns its words.
"""

import itertools
import math
import re
import secrets
from collections import deque
from collections.abc import Callable, Sequence
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.listening.echo import CleanSound, EchoCanceller
from caris_desktop.conversation.listening.endpointing import RATE_HZ, WINDOW, TurnTaking
from caris_desktop.conversation.listening.engines import Recognised
from caris_desktop.conversation.listening.heard_turn import TurnAudio, TurnInterval
from caris_desktop.conversation.listening.robot_speech_filter import RobotSpeechFilter
from caris_desktop.domain.actor import CONSOLE
from caris_desktop.domain.events import UtteranceChanged, UtteranceCorrected, UtteranceState
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import WIZARD_MICROPHONE, Hearing
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value

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


class Voices(Protocol):
    """Voice activity detector."""

    def probability(self, window: NDArray[np.float32]) -> float:
        """Probability of voice in the next window."""


class SpeechSegmenter:
    """``report`` receives reports to the console; ``turn_over`` estimates the probability that a turn's sound is
    complete.
    """

    def __init__(
        self,
        source: str,
        turns: TurnTaking,
        voices: Voices,
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
