"""Speech queue in front of the speech backends."""

import random
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import UtteranceChanged, UtteranceOrigin
from caris_desktop.domain.sound_values import PlayedSound
from caris_desktop.live.speech_queue import SpeechQueue
from caris_desktop.live.state import LiveState
from caris_desktop.people.presence import PersonRow


class TestVoice:
    __test__ = False

    def __init__(self) -> None:
        self.available = True
        self.held_up = False
        self.said: list[UtteranceChanged] = []
        self.spoken: list[str] = []
        self.silenced: list[str] = []

    def say(self, utterance: UtteranceChanged, spoken: str) -> bool:
        if self.available:
            self.said.append(utterance)
            self.spoken.append(spoken)
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
    """Report of the speech backend, received by the GUI thread."""
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


@pytest.mark.parametrize(("origin", "cleaned"), [("assistant", True), ("suggestion", True), ("typed", False)])
def test_of_what_a_model_wrote_no_markdown_is_spoken(qtbot: QtBot, origin: UtteranceOrigin, *, cleaned: bool) -> None:
    queue, voice, published, _ = _setup()
    written = "<think>secret</think>**The lab** closes at six.\n\n- Bring `your card`\n- Ask [Ada](https://lab.example)"
    queue.say(written, origin, recorded=written.replace("Ada", "{p-1f}"))
    spoken_text = "The lab closes at six. Bring your card. Ask Ada"
    assert voice.spoken == [spoken_text if cleaned else " ".join(written.split())]
    assert published[0].text == (
        spoken_text.replace("Ada", "{p-1f}") if cleaned else " ".join(published[0].text.split())
    )
    queue.say("<img src='/dev/zero'>", origin)
    assert len(published) == (1 if cleaned else 2), "nothing of it can be said"


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


def test_a_voice_that_is_not_there_fails_the_sentence_and_reports_it(qtbot: QtBot) -> None:
    queue, voice, published, state = _setup()
    voice.available = False
    queue.say("Hello", "typed")
    assert [(event.state, bool(event.detail)) for event in published] == [("requested", False), ("failed", True)]
    assert state.speech.value.now is None


def test_an_utterance_waits_for_a_held_voice(qtbot: QtBot) -> None:
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


def test_utterances_of_a_voice_that_does_not_return_have_failed(qtbot: QtBot) -> None:
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
    queue.on_voice_lost("robot", "the connection was lost")
    assert published[-1].state == "failed" and published[-1].text == "One"
    assert [utterance.text for utterance in voice.said] == ["One", "Two"]


def test_late_reports_of_a_lost_voice_are_dropped(qtbot: QtBot) -> None:
    queue, voice, published, _state = _setup()
    queue.say("One", "typed")
    _report(queue, voice.said[0], "started")
    queue.on_voice_lost("robot", "the connection was lost")
    queue.say("Two", "typed")
    _report(queue, voice.said[0], "finished")
    queue.report(replace(voice.said[0], utterance_id="u-of-nobody", state="started"))
    assert [(event.text, event.state) for event in published] == [
        ("One", "requested"),
        ("One", "started"),
        ("One", "failed"),
        ("Two", "requested"),
    ]


def test_a_voice_that_is_lost_after_it_has_reported_the_end_has_not_failed(qtbot: QtBot) -> None:
    queue, voice, published, _state = _setup()
    queue.say("One", "typed")
    queue.report(replace(voice.said[0], state="finished"))  # the GUI thread does not know it yet
    queue.on_voice_lost("robot", "the connection was lost")
    assert [event.state for event in published] == ["requested", "finished"]


def test_blank_text_says_nothing(qtbot: QtBot) -> None:
    queue, voice, published, _state = _setup()
    assert queue.say("  \n", "typed") == ""
    assert not voice.said and not published


def _row(person_id: str, distance_m: float | None = None, *, here: bool = True) -> PersonRow:
    return PersonRow(person_id, 1, "Person 1", here, 0, 0, distance_m=distance_m)


def test_an_utterance_names_its_addressee(qtbot: QtBot) -> None:
    """Addressee: the requested person, else the selected one if present, else the nearest or only one, else nobody."""
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


def test_a_name_is_spoken_and_its_id_is_recorded(qtbot: QtBot) -> None:
    queue, voice, published, state = _setup()
    queue.say("Hello, Ada!", "phrase", recorded="Hello, {p-12}!", gesture="wave")
    assert voice.spoken == ["Hello, Ada!"]
    assert [(event.text, event.gesture) for event in published] == [("Hello, {p-12}!", "wave")]
    assert state.speech.value.now.text == "Hello, {p-12}!"


def _waiting(state: LiveState) -> list[str]:
    return [utterance.text for utterance in state.speech.value.waiting]


def _ids(state: LiveState) -> dict[str, str]:
    return {utterance.text: utterance.utterance_id for utterance in state.speech.value.waiting}


def test_waiting_utterances_can_be_moved_changed_and_withdrawn(qtbot: QtBot) -> None:
    queue, voice, published, state = _setup()
    for text in ("One", "Two", "Three", "Four"):
        queue.say(text, "typed")
    ids = _ids(state)
    assert queue.move(ids["Four"], 0) and queue.move(ids["Two"], 9)
    assert _waiting(state) == ["Four", "Three", "Two"]
    assert queue.edit(ids["Three"], "Hello Ada", "wizard:b", recorded="Hello {p-1}")
    assert queue.cancel(ids["Two"], "wizard:b")
    assert _waiting(state) == ["Four", "Hello {p-1}"]
    assert [(event.utterance_id, event.text, event.state, event.actor) for event in published[-2:]] == [
        (ids["Three"], "Hello {p-1}", "requested", "wizard:b"),
        (ids["Two"], "Two", "interrupted", "wizard:b"),
    ]
    for _ in range(3):
        _report(queue, voice.said[-1], "finished")
    assert voice.spoken == ["One", "Four", "Hello Ada"]


def test_emptied_it_is_taken_back(qtbot: QtBot) -> None:
    queue, _voice, published, state = _setup()
    queue.say("One", "typed")
    queue.say("Two", "typed")
    assert queue.edit(_ids(state)["Two"], "  ")
    assert (published[-1].text, published[-1].state) == ("Two", "interrupted")


def test_a_current_utterance_is_not_waiting(qtbot: QtBot) -> None:
    queue, voice, published, _state = _setup()
    spoken = queue.say("One", "typed")
    before = list(published)
    assert not queue.move(spoken, 0) and not queue.edit(spoken, "Two") and not queue.cancel(spoken)
    assert published == before and voice.spoken == ["One"]


def test_a_gap_is_never_spoken(qtbot: QtBot) -> None:
    queue, voice, published, state = _setup()
    queue.say("Hello, {name}!", "suggestion")
    assert [(event.state, event.detail) for event in published] == [
        ("requested", ""), ("failed", "no value was entered for {name}"),
    ]  # fmt: skip
    assert voice.spoken == [] and state.speech.value.waiting == ()


def test_the_end_is_estimated_and_then_reported_to_the_sample(qtbot: QtBot) -> None:
    queue, voice, _published, state = _setup()
    queue.say("Hello there, how are you?", "typed")
    assert state.speech.value.ends_ns is None
    _report(queue, voice.said[0], "started")
    started_ns = state.speech.value.now.stamp_ns
    assert 1.0 < (state.speech.value.ends_ns - started_ns) / 1e9 < 4.0
    sound = PlayedSound(started_ns, voice.said[0].utterance_id, "", 16_000, np.zeros((24_000, 1), np.int16))
    queue.on_played(sound)
    qtbot.waitUntil(lambda: state.speech.value.ends_ns == started_ns + 1_500_000_000)
    _report(queue, voice.said[0], "finished")
    assert state.speech.value.ends_ns is None


@pytest.mark.parametrize("seed", range(5))
def test_any_change_of_the_queue_speaks_or_withdraws_each_once(qtbot: QtBot, seed: int) -> None:
    """500 utterances that are queued, moved, edited, cancelled, interrupted and lost at random."""
    queue, voice, published, state = _setup()
    chance = random.Random(seed)  # noqa: S311 - a test, not cryptography
    asked: list[str] = []

    def over(what: str) -> None:
        now = state.speech.value.now
        if now is not None:
            _report(queue, now, what)

    while len(asked) < 100 or state.speech.value.now is not None:
        ids = [utterance.utterance_id for utterance in state.speech.value.waiting]
        act = chance.choice(("say", "say", "say", "finish", "move", "edit", "cancel", "silence", "lose", "hold"))
        if act == "say" and len(asked) < 100:
            asked.append(queue.say(f"Sentence {len(asked)}", "typed"))
        elif act == "silence":
            queue.silence()
            over("interrupted")
        elif act == "lose":
            queue.on_voice_lost("robot", "lost")
        elif act == "hold":
            voice.held_up = not voice.held_up
            queue.on_voice_changed()
        elif act == "move" and ids:
            assert queue.move(chance.choice(ids), chance.randrange(9))
        elif act == "edit" and ids:
            assert queue.edit(chance.choice(ids), "Other")
        elif act == "cancel" and ids:
            assert queue.cancel(chance.choice(ids))
        elif act == "finish":
            over("started")
            over("finished")
    voice.held_up = False
    queue.silence()
    ends = Counter(event.utterance_id for event in published if event.state in ("finished", "interrupted", "failed"))
    assert ends == Counter(asked)
    assert len(voice.said) == len({utterance.utterance_id for utterance in voice.said}), "nothing is said twice"
    speaking = ""
    for event in published:
        if event.state == "started":
            assert speaking == "", "one at a time"
            speaking = event.utterance_id
        elif event.utterance_id == speaking and event.state in ("finished", "interrupted", "failed"):
            speaking = ""
