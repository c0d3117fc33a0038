"""One queue in front of the voices."""

from dataclasses import replace
from typing import Any

from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.live.speech_queue import SpeechQueue
from caris_desktop.live.state import LiveState
from caris_desktop.people.presence import PersonRow


class TestVoice:
    __test__ = False

    def __init__(self) -> None:
        self.available = True
        self.held_up = False
        self.said: list[UtteranceChanged] = []
        self.silenced: list[str] = []

    def say(self, utterance: UtteranceChanged) -> bool:
        if self.available:
            self.said.append(utterance)
        return self.available

    def silence(self, actor: Actor) -> bool:
        self.silenced.append(actor)
        return True


def _setup() -> tuple[SpeechQueue, TestVoice, list[UtteranceChanged], LiveState]:
    voice, published, state = TestVoice(), [], LiveState()

    def publish(event: UtteranceChanged, _raw: bytes | None) -> None:
        published.append(event)

    queue = SpeechQueue(state, {"robot": voice, "computer": TestVoice()}, publish, state)
    return queue, voice, published, state


def _report(queue: SpeechQueue, utterance: UtteranceChanged, what: Any, actor: Actor = "wizard") -> None:
    """The voice tells, and what is published of it reaches the GUI thread."""
    told = replace(utterance, stamp_ns=clock.now_ns(), state=what, actor=actor)
    queue.report(told)
    queue.on_utterance(told)


def test_one_after_the_other_with_the_origin_the_wizard_gave(qtbot: QtBot) -> None:
    queue, voice, published, state = _setup()
    queue.say("  Hello\n there ", "phrase")
    queue.say("Goodbye", "typed")
    assert [utterance.text for utterance in voice.said] == ["Hello there"]
    assert state.speech.value.now.text == "Hello there" and len(state.speech.value.waiting) == 1
    _report(queue, voice.said[0], "started")
    _report(queue, voice.said[0], "finished")
    assert [utterance.text for utterance in voice.said] == ["Hello there", "Goodbye"]
    assert [(event.text, event.state, event.origin) for event in published] == [
        ("Hello there", "requested", "phrase"),
        ("Goodbye", "requested", "typed"),
        ("Hello there", "started", "phrase"),
        ("Hello there", "finished", "phrase"),
    ]


def test_silence_interrupts_and_drops_what_waits(qtbot: QtBot) -> None:
    queue, voice, published, state = _setup()
    queue.say("One", "typed")
    queue.say("Two", "typed")
    queue.silence("wizard:b")
    assert voice.silenced == ["wizard:b"]
    assert ("Two", "interrupted", "wizard:b") in [(event.text, event.state, event.actor) for event in published]
    _report(queue, voice.said[0], "interrupted", "wizard:b")
    assert (published[-1].text, published[-1].state, published[-1].actor) == ("One", "interrupted", "wizard:b")
    assert state.speech.value.now is None and state.speech.value.waiting == ()
    assert len(voice.said) == 1


def test_a_voice_that_is_not_there_fails_the_sentence_and_says_so(qtbot: QtBot) -> None:
    queue, voice, published, state = _setup()
    voice.available = False
    queue.say("Hello", "typed")
    assert [(event.state, bool(event.detail)) for event in published] == [("requested", False), ("failed", True)]
    assert state.speech.value.now is None


def test_what_is_said_while_a_voice_is_held_up_waits_for_it(qtbot: QtBot) -> None:
    queue, voice, published, state = _setup()
    queue.say("One", "typed")
    voice.held_up = True
    _report(queue, voice.said[0], "finished")
    queue.say("Two", "typed")
    queue.say("Three", "typed")
    assert [utterance.text for utterance in voice.said] == ["One"]
    assert [utterance.text for utterance in state.speech.value.waiting] == ["Two", "Three"]
    voice.held_up = False
    queue.on_voice_changed()
    assert [utterance.text for utterance in voice.said] == ["One", "Two"]
    assert "failed" not in [event.state for event in published]


def test_what_waited_for_a_voice_that_does_not_come_back_has_failed(qtbot: QtBot) -> None:
    queue, voice, published, state = _setup()
    voice.held_up = True
    queue.say("One", "typed")
    voice.held_up = voice.available = False
    queue.on_voice_changed()
    assert [(event.text, event.state) for event in published] == [("One", "requested"), ("One", "failed")]
    assert state.speech.value.waiting == ()


def test_a_voice_lost_in_mid_sentence_does_not_block_the_next(qtbot: QtBot) -> None:
    queue, voice, published, _state = _setup()
    queue.say("One", "typed")
    queue.say("Two", "typed")
    queue.on_voice_lost("robot", "the link was lost")
    assert published[-1].state == "failed" and published[-1].text == "One"
    assert [utterance.text for utterance in voice.said] == ["One", "Two"]


def test_what_a_lost_voice_tells_late_is_dropped(qtbot: QtBot) -> None:
    queue, voice, published, _state = _setup()
    queue.say("One", "typed")
    _report(queue, voice.said[0], "started")
    queue.on_voice_lost("robot", "the link was lost")
    queue.say("Two", "typed")
    _report(queue, voice.said[0], "finished")
    queue.report(replace(voice.said[0], utterance_id="u-of-nobody", state="started"))
    assert [(event.text, event.state) for event in published] == [
        ("One", "requested"),
        ("One", "started"),
        ("One", "failed"),
        ("Two", "requested"),
    ]


def test_a_voice_that_is_lost_after_it_has_told_the_end_has_not_failed(qtbot: QtBot) -> None:
    queue, voice, published, _state = _setup()
    queue.say("One", "typed")
    queue.report(replace(voice.said[0], state="finished"))  # the GUI thread does not know it yet
    queue.on_voice_lost("robot", "the link was lost")
    assert [event.state for event in published] == ["requested", "finished"]


def test_blank_text_says_nothing(qtbot: QtBot) -> None:
    queue, voice, published, _state = _setup()
    assert queue.say("  \n", "typed") == ""
    assert not voice.said and not published


def _row(person_id: str, distance_m: float | None = None, *, here: bool = True) -> PersonRow:
    return PersonRow(person_id, 1, "Person 1", here, 0, 0, distance_m=distance_m)


def test_what_is_said_names_to_whom(qtbot: QtBot) -> None:
    """Who was asked for, or else who is meant and here, or else who is nearest or the only one; and nobody in doubt."""
    queue, voice, published, state = _setup()

    def addressed(person_id: str = "") -> str:
        published.clear()
        queue.silence()
        queue.say("Hello", "typed", person_id=person_id)
        _report(queue, voice.said[-1], "finished")
        (told,) = {event.person_id for event in published}
        return told

    assert addressed() == ""
    state.persons.set((_row("p-1"),))
    assert addressed() == "p-1"
    state.persons.set((_row("p-1"), _row("p-2")))
    assert addressed() == "", "nobody knows which of the two"
    state.persons.set((_row("p-1", 2.5), _row("p-2", 1.2), _row("p-3")))
    assert addressed() == "p-2"
    state.selected_person.set("p-3")
    assert addressed() == "p-3"
    assert addressed("p-1") == "p-1"
    state.persons.set((_row("p-1", 4.0), _row("p-3", here=False), _row("p-4", 5.0)))
    assert addressed() == "", "who is meant has left, and nobody else is near"
