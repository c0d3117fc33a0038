"""Speech on robot and computer at once: an utterance starts once and ends once, in any order of the reports."""

import itertools
from dataclasses import replace

import pytest

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import UtteranceChanged, UtteranceState
from caris_desktop.live.services.speech_service import DualSpeechOutput

ASKED = UtteranceChanged(1, "u-1", "robot", "Hello", "typed", "requested", voice="both")


class OneOfThem:
    held_up = False

    def __init__(self, *, takes: bool = True) -> None:
        self.takes = takes
        self.asked: list[str] = []

    def say(self, utterance: UtteranceChanged, spoken: str) -> bool:
        self.asked.append(f"{utterance.utterance_id}: {spoken}")
        return self.takes

    def silence(self, actor: Actor) -> bool:
        self.asked.append(f"silenced by {actor}")
        return self.takes


def both(
    *, robot: bool = True, computer: bool = True
) -> tuple[DualSpeechOutput, list[UtteranceChanged], list[OneOfThem]]:
    told: list[UtteranceChanged] = []
    voices = [OneOfThem(takes=robot), OneOfThem(takes=computer)]
    return DualSpeechOutput({"robot": voices[0], "computer": voices[1]}, told.append), told, voices


def of(voice: str, state: UtteranceState, stamp_ns: int, detail: str = "") -> UtteranceChanged:
    return replace(ASKED, voice=voice, state=state, stamp_ns=stamp_ns, detail=detail)


STORIES = [("robot", "started"), ("robot", "finished"), ("computer", "started"), ("computer", "finished")]


@pytest.mark.parametrize(
    "order",
    [
        order
        for order in itertools.permutations(STORIES)
        if order.index(STORIES[0]) < order.index(STORIES[1]) and order.index(STORIES[2]) < order.index(STORIES[3])
    ],
)
def test_it_starts_with_the_first_and_ends_with_the_last(order: tuple[tuple[str, UtteranceState], ...]) -> None:
    voice, told, voices = both()
    assert voice.say(ASKED, "Hello, Ada")
    assert [each.asked for each in voices] == [["u-1: Hello, Ada"]] * 2
    for stamp_ns, (kind, state) in enumerate(order, 10):
        assert voice.handle(of(kind, state, stamp_ns))
    assert [(event.state, event.stamp_ns, event.voice) for event in told] == [
        ("started", 10, "both"),
        ("finished", 13, "both"),
    ]


def test_the_end_says_what_became_of_it_with_each() -> None:
    voice, told, _ = both()
    voice.say(ASKED, "Hello")
    voice.handle(of("robot", "started", 10))
    voice.lost("computer", replace(ASKED, stamp_ns=11), "speech stopped unexpectedly")
    voice.handle(of("robot", "finished", 12))
    assert [(event.state, event.detail) for event in told[1:]] == [("finished", "speech stopped unexpectedly")]
    assert voice.handle(of("computer", "finished", 13)), "what comes too late changes nothing"
    assert len(told) == 2


def test_one_that_refuses_leaves_it_to_the_other_and_two_that_refuse_say_so() -> None:
    voice, told, _ = both(robot=False)
    assert voice.say(ASKED, "Hello")
    voice.handle(of("computer", "started", 10))
    voice.handle(of("computer", "interrupted", 11))
    assert [(event.state, event.detail) for event in told] == [
        ("started", ""),
        ("interrupted", "the robot's voice is not available"),
    ]
    nobody, told, _ = both(robot=False, computer=False)
    assert not nobody.say(ASKED, "Hello")
    assert told == [], "whoever asked reports it"


def test_both_are_silenced_and_utterances_of_others_pass_by() -> None:
    voice, told, voices = both(robot=False)
    assert voice.silence("wizard:a")
    assert [each.asked for each in voices] == [["silenced by wizard:a"]] * 2
    assert not voice.handle(replace(of("robot", "started", 1), utterance_id="u-2"))
    assert told == []
