"""Speech segmenter of one microphone, from sound to messages, with model doubles."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.conversation.listening.echo import CleanSound, EchoCanceller
from caris_desktop.conversation.listening.endpointing import SilenceOfPeople, TurnTaking
from caris_desktop.conversation.listening.engines import Recognised
from caris_desktop.conversation.listening.recognised_words import RecognisedWord
from caris_desktop.conversation.listening.recogniser_messages import UseSilence
from caris_desktop.conversation.listening.robot_speech_filter import RobotSpeechFilter
from caris_desktop.conversation.listening.speech_segmenter import SpeechSegmenter, TurnInterval, with_words
from caris_desktop.domain.actor import CONSOLE
from caris_desktop.domain.events import UtteranceChanged, UtteranceCorrected, UtteranceState
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE, WIZARD_MICROPHONE, Hearing

RATE_HZ = 16_000
CHUNK_S = 0.1
WORDS_A_SECOND = 2


class Loud:
    """Voice activity double: loud sound is voice."""

    def probability(self, window: NDArray[np.float32]) -> float:
        return float(np.abs(window).max() > 0.1)


class Plain(EchoCanceller):
    """Echo canceller double that changes nothing; ``share`` is its estimate of the robot's part."""

    share = 0.0
    again = np.zeros(0, np.float32)

    def process(self, chunk: AudioChunk) -> CleanSound:
        again, self.again = self.again, Plain.again
        return CleanSound(chunk.stamp_ns, chunk.samples[:, 0].astype(np.float32) / 32768, self.share, again)

    def share_between(self, started_ns: int, ended_ns: int) -> float | None:
        return None


class Known(RobotSpeechFilter):
    """Filter double that treats ``words`` as robot speech."""

    words = ""

    def was_heard(self, text: str, started_ns: int, ended_ns: int) -> list[tuple[str, bool, bool]]:
        return []

    def is_robots(self, text: str, started_ns: int, ended_ns: int, *_told: object, **_more: object) -> float:
        return float(text.strip() in self.words and bool(text.strip()))


def _word(number: int) -> str:
    return f"w{number}{'.' * (number % 5 == 4)}"


class Bench:
    """Segmenter whose recogniser returns two words per second of voice: w0, w1, ... of each turn, five per sentence."""

    def __init__(
        self, source: str = ROBOT_MICROPHONE, turn_over: float = 0.95, own_words: RobotSpeechFilter | None = None
    ) -> None:
        self.canceller = Plain()
        self.own_words: Any = own_words or Known()
        self.told: list[Any] = []
        self.now_s = 10.0
        self.asked: list[TurnInterval] = []
        self.answer: Callable[[TurnInterval], Recognised | None] = self.words
        self.ear = SpeechSegmenter(
            source,
            TurnTaking(SilenceOfPeople(), UseSilence()),
            Loud(),
            canceller=self.canceller,
            robot_speech=self.own_words,
            turn_over=lambda _sound: turn_over,
            report=self.told.append,
        )

    def words(self, stretch: TurnInterval) -> Recognised:
        loud = np.flatnonzero(np.abs(stretch.sound) > 0.1) / RATE_HZ
        if not len(loud):
            return Recognised((), "en")
        first = round(stretch.from_s * WORDS_A_SECOND)
        starts = loud[0] + np.arange(int((loud[-1] - loud[0]) * WORDS_A_SECOND)) / WORDS_A_SECOND
        words = [RecognisedWord(_word(first + at), start_s, start_s + 0.4, 0.8) for at, start_s in enumerate(starts)]
        return Recognised(tuple(words), "en")

    def hear(self, seconds: float, level: int = 0, *, missing: bool = False) -> "Bench":
        until_s = self.now_s + seconds
        while self.now_s < until_s - 1e-6:
            samples = np.full((round(CHUNK_S * RATE_HZ), 1), level, np.int16)
            if not missing:
                self.ear.process(AudioChunk(round(self.now_s * 1e9), self.ear.source, RATE_HZ, samples))
            self.now_s += CHUNK_S
            self.ear.judge()
            stretch = self.ear.next_interval(0.5)
            if stretch is not None:
                self.asked.append(stretch)
                self.ear.add_result(stretch, self.answer(stretch))
        return self

    def say(self, seconds: float) -> "Bench":
        return self.hear(seconds, 8000)

    @property
    def utterances(self) -> list[UtteranceChanged]:
        return [each for each in self.told if isinstance(each, UtteranceChanged)]

    @property
    def hearings(self) -> list[Hearing]:
        return [each for each in self.told if isinstance(each, Hearing)]


def test_a_turn_is_reported_with_the_moments_of_its_voice() -> None:
    bench = Bench().hear(1).say(2.2).hear(1.5)
    started, finished = bench.utterances
    assert (started.state, finished.state) == ("started", "finished")
    assert started.stamp_ns / 1e9 == pytest.approx(11.0, abs=0.04)
    assert finished.stamp_ns / 1e9 == pytest.approx(13.2, abs=0.04)
    assert finished.text == "w0 w1 w2 w3"
    assert finished.confidence == pytest.approx(0.8)
    assert bench.hearings[-1].utterance_id == ""


def test_an_ended_turn_has_its_words_so_far() -> None:
    bench = Bench().hear(1).say(2.2)
    bench.ear.end_turn()
    bench.say(3.0).hear(1.5)
    assert [each.state for each in bench.utterances] == ["started", "finished"] * 2
    assert bench.utterances[1].utterance_id == bench.utterances[0].utterance_id != bench.utterances[2].utterance_id
    assert bench.utterances[1].stamp_ns / 1e9 == pytest.approx(13.2, abs=0.1)
    assert bench.utterances[1].text == "w0 w1 w2 w3"
    assert bench.utterances[2].stamp_ns >= bench.utterances[1].stamp_ns


def test_words_are_committed_while_a_person_speaks_and_stay() -> None:
    bench = Bench().hear(1).say(6).hear(1.5)
    shown = [each.committed for each in bench.hearings if each.utterance_id]
    assert len(set(shown)) > 4
    assert all(later.startswith(earlier) for earlier, later in itertools.pairwise(shown))
    assert any(each.speaking and each.committed and each.tentative for each in bench.hearings)


def test_speaking_on_after_a_pause_is_the_same_turn_and_another_revision() -> None:
    bench = Bench(turn_over=0.1).hear(1).say(2).hear(0.6).say(2).hear(4)
    assert [each.state for each in bench.utterances] == ["started", "finished"]
    pauses = [each for each in bench.hearings if not each.speaking and each.turn_over is not None]
    texts = {f"{each.committed} {each.tentative}" for each in pauses}
    assert {each.turn_over for each in pauses} == {with_words(0.1, text, "en") for text in texts}
    revisions = [each.revision for each in bench.hearings if each.utterance_id]
    assert revisions == sorted(revisions)
    assert revisions[-1] > revisions[0]
    ends_s = sorted({round((each.silent_since_ns or 0) / 1e9, 1) for each in pauses})
    assert ends_s == pytest.approx([13.0, 15.6], abs=0.1)


def test_a_pause_is_reported_within_a_third_of_a_second() -> None:
    bench = Bench().hear(1).say(2)
    assert bench.hearings[-1].speaking
    bench.hear(0.3)
    pauses = [each for each in bench.hearings if each.utterance_id and not each.speaking]
    assert pauses[-1].turn_over == with_words(0.95, "w0 w1 w2", "en")
    assert {each.silent_since_ns for each in pauses} == {pauses[0].silent_since_ns}
    assert pauses[0].silent_since_ns is not None
    assert pauses[0].silent_since_ns / 1e9 == pytest.approx(13.0, abs=0.07)


def test_a_silence_commits_words_before_the_turn_is_over() -> None:
    bench = Bench(turn_over=0.0).hear(1).say(2).hear(0.6)
    last = bench.hearings[-1]
    assert last.utterance_id
    assert (last.committed, last.tentative) == ("w0 w1 w2", "")


def test_the_robots_own_voice_makes_no_turn() -> None:
    bench = Bench()
    bench.canceller.share = 0.97
    bench.hear(1).say(3).hear(2)
    assert bench.told == []
    bench.canceller.share = 0.5
    bench.say(2).hear(2)
    assert bench.utterances[-1].state == "finished", "somebody who speaks over the robot is heard"


def test_words_that_the_robot_says_are_not_the_participants() -> None:
    bench = Bench()
    bench.own_words.words = "w0 w1 w2 w3"
    bench.hear(1).say(2.2).hear(2)
    last = bench.utterances[-1]
    assert (last.state, last.text) == ("failed", "")
    assert "robot" in last.detail
    assert {each.speaker for each in bench.hearings if each.committed} == {"robot"}


def test_while_the_robot_speaks_nobody_is_notified_of_a_voice_that_turns_out_to_be_its_own() -> None:
    bench = Bench()
    bench.own_words.words = "w0 w1 w2 w3"
    bench.hear(1).ear.another_spoke()
    bench.say(2.2).ear.another_ended(round(bench.now_s * 1e9))
    bench.hear(2)
    assert bench.told == []


ROBOT_SAYS = "Hello! Welcome to our lab."
PARTICIPANT_SAYS = "Thank you. What is there to see?"


def _said(sound: NDArray[np.float32], texts: dict[int, str]) -> Recognised:
    """Words of each loud interval: its level selects the text."""
    words: list[RecognisedWord] = []
    for level, text in texts.items():
        at = np.flatnonzero(np.abs(np.abs(sound) - level / 32768) < 1e-3) / RATE_HZ
        if len(at):
            each_s = (at[-1] - at[0]) / len(text.split())
            words += [
                RecognisedWord(word, at[0] + number * each_s, at[0] + (number + 1) * each_s)
                for number, word in enumerate(text.split())
            ]
    return Recognised(tuple(words), "en")


@pytest.mark.parametrize("between_s", [0.1, 1.2], ids=["at once", "after a pause"])
@pytest.mark.parametrize("late_s", [-1.0, 0.0, 0.8, 1.6, 2.4, 3.2])
def test_the_robots_words_are_not_the_participants_however_late_they_are_heard(late_s: float, between_s: float) -> None:
    """On-board robot speech on a busy machine: the sound comes ``late_s`` after its report."""
    own_words = RobotSpeechFilter()
    bench = Bench(own_words=own_words)
    bench.answer = lambda stretch: _said(stretch.sound, {7000: ROBOT_SAYS, 9000: PARTICIPANT_SAYS})
    bench.hear(2)
    started_ns = round((bench.now_s - late_s) * 1e9)

    def tell(state: UtteranceState, after_s: float) -> None:
        told = UtteranceChanged(started_ns + round(after_s * 1e9), "u-1", "robot", ROBOT_SAYS, "typed", state)
        own_words.robot_says(told)
        if state == "started":
            bench.ear.another_spoke()
        elif state == "finished":
            bench.ear.another_ended(told.stamp_ns)

    tell("requested", -0.4)
    tell("started", 0.0)
    if late_s > 1.8:
        tell("finished", 1.8)
    bench.hear(1.8, 7000)
    if late_s <= 1.8:
        tell("finished", 1.8)
    bench.hear(between_s).hear(2.4, 9000).hear(3)
    finished = [each.text for each in bench.utterances if each.state == "finished"]
    assert finished == [PARTICIPANT_SAYS]


def _unasked(own_words: RobotSpeechFilter, at_s: float, text: str = ROBOT_SAYS, *, estimated: bool = True) -> None:
    """Report of unprompted robot speech."""
    told = UtteranceChanged(round(at_s * 1e9), "r-1", "robot", text, "heard", "started", estimated=estimated)
    own_words.robot_says(told)


@pytest.mark.parametrize("pause_s", [0.0, 1.0], ids=["one turn", "two turns"])
def test_a_robot_that_reports_its_sentence_afterwards_gets_its_turns_back(pause_s: float) -> None:
    own_words = RobotSpeechFilter()
    bench = Bench(own_words=own_words)
    first, rest = ROBOT_SAYS.split(maxsplit=1)
    texts = {6000: "Yes.", 7000: "No.", 9000: ROBOT_SAYS} | ({8000: first, 9000: rest} if pause_s else {})
    bench.answer = lambda stretch: _said(stretch.sound, texts)
    bench.hear(1).hear(1.2, 7000).hear(2.5)
    if pause_s:
        bench.hear(0.8, 8000).hear(pause_s)
    bench.hear(1.6, 9000).hear(1.5).hear(0.4, 6000).hear(1.5)
    before, *robots, after = (each.utterance_id for each in bench.utterances if each.state == "finished")
    assert len(robots) == (2 if pause_s else 1)
    _unasked(own_words, bench.now_s - 2.5)
    bench.ear.reassign_robot_turns()
    corrected = [each for each in bench.told if isinstance(each, UtteranceCorrected)]
    assert [(each.utterance_id, each.speaker, each.actor) for each in corrected] == [
        (each, "robot", CONSOLE) for each in robots
    ]
    assert not {before, after} & {each.utterance_id for each in corrected}
    bench.ear.reassign_robot_turns()
    assert len([each for each in bench.told if isinstance(each, UtteranceCorrected)]) == len(corrected)


@pytest.mark.parametrize(
    ("says", "after_s", "estimated"),
    [
        ("Welcome to our lab. It is open until six o'clock today.", 0.2, True),
        ("Please follow me to the kitchen.", 0.2, True),
        (ROBOT_SAYS, 8.0, True),
        (ROBOT_SAYS, 0.2, False),
    ],
    ids=["it answers with their words", "it says something else", "long after", "it tells exactly when"],
)
def test_later_robot_speech_takes_no_turn_from_the_participant(says: str, after_s: float, estimated: bool) -> None:
    own_words = RobotSpeechFilter()
    bench = Bench(own_words=own_words)
    bench.answer = lambda stretch: _said(stretch.sound, {9000: ROBOT_SAYS})
    bench.hear(1).hear(1.8, 9000).hear(1.5)
    assert bench.utterances[-1].state == "finished"
    _unasked(own_words, bench.now_s + after_s, says, estimated=estimated)
    bench.ear.reassign_robot_turns()
    assert not [each for each in bench.told if isinstance(each, UtteranceCorrected)]


def test_speech_over_the_robot_is_reported_with_its_first_words_and_start() -> None:
    bench = Bench().hear(1)
    bench.ear.another_spoke()
    bench.say(3.2)
    assert [each.state for each in bench.utterances] == ["started"]
    assert bench.utterances[0].stamp_ns / 1e9 == pytest.approx(11.0, abs=0.04)
    bench.hear(2)
    assert bench.utterances[-1].state == "finished"


@pytest.mark.parametrize("silent_s", [0.3, 0.4])
def test_a_turn_that_proves_to_be_the_robot_is_not_transcribed_again(silent_s: float) -> None:
    bench = Bench(turn_over=0.0).hear(1.03).say(2).hear(silent_s)
    before = bench.asked[-1]
    known_s = np.where(np.arange(3 * RATE_HZ) < 2 * RATE_HZ, 0.0, 8000 / 32768)
    known_s[round((3 - silent_s) * RATE_HZ) :] = 0.0
    bench.canceller.again = known_s.astype(np.float32)
    bench.hear(0.1)
    after = bench.asked[-1]
    assert after is not before
    loud_before, loud_after = (np.flatnonzero(np.abs(each.sound) > 0.1) / RATE_HZ for each in (before, after))
    assert loud_before[-1] - loud_before[0] == pytest.approx(2.0, abs=0.04)
    assert loud_after[-1] - loud_after[0] == pytest.approx(1.0 - silent_s, abs=0.001)
    assert loud_after[-1] == pytest.approx(loud_before[-1], abs=0.001)


def test_sound_without_words_is_reported_as_nothing() -> None:
    bench = Bench()
    bench.answer = lambda _stretch: Recognised((), "en")
    bench.hear(1).say(1).hear(2)
    assert [each.state for each in bench.utterances] == ["started", "failed"]


def test_a_recogniser_that_does_not_answer_holds_no_turn_open() -> None:
    bench = Bench()
    bench.answer = lambda _stretch: None
    bench.hear(1).say(2).hear(2)
    assert [each.state for each in bench.utterances] == ["started", "failed"]


def test_a_turn_that_continues_and_on_costs_no_more_than_a_short_one() -> None:
    bench = Bench().hear(1).say(90).hear(2)
    longest_s = max(len(each.sound) for each in bench.asked) / RATE_HZ
    assert longest_s < 16
    words = bench.utterances[-1].text.split()
    assert len(words) == pytest.approx(180, abs=12)
    assert bench.asked[-1].before.endswith(words[-8]) or words[-8] in bench.asked[-1].before


def test_a_hole_in_the_sound_is_silence() -> None:
    bench = Bench().hear(1).say(2).hear(3, missing=True).hear(1)
    assert [each.state for each in bench.utterances] == ["started", "finished"]
    assert bench.utterances[-1].stamp_ns / 1e9 == pytest.approx(13.0, abs=0.07)


def test_the_wizard_dictates_while_the_robot_speaks() -> None:
    bench = Bench(WIZARD_MICROPHONE).hear(0.5)
    bench.ear.another_spoke()
    bench.hear(0.3, 8000)
    assert bench.hearings[-1].speaking


def test_the_wizards_own_words_are_no_utterance_and_stay_to_be_read() -> None:
    bench = Bench(WIZARD_MICROPHONE).hear(0.5).say(2)
    for _ in range(6):
        bench.hear(0.2, missing=True).ear.add_silence(round(bench.now_s * 1e9))
    assert bench.utterances == []
    last = bench.hearings[-1]
    assert (last.speaker, last.speaking, last.turn_over, last.tentative) == ("wizard", False, 1.0, "")
    assert last.committed
