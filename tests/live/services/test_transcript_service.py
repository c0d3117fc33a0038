"""Transcript with corrections in the panels, and the response time of each answer."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import pytest
from PySide6.QtCore import QObject

from caris_desktop.conversation.conversation_transcript import Turn, in_order
from caris_desktop.domain import clock, intents
from caris_desktop.domain.events import (
    ResponseTimed,
    SessionStarted,
    SuggestionChanged,
    UtteranceChanged,
    UtteranceCorrected,
)
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.live.bus import Bus
from caris_desktop.live.services.people_service import ResponseTimeService, TranscriptService
from caris_desktop.live.state import LiveState
from tests.support.service_context import context_of

pytestmark = pytest.mark.usefixtures("qapp")
HEARD = UtteranceChanged(0, "p", "participant", "Can it hurd people?", "heard", "finished")


@dataclass
class Desk:
    bus: Bus
    state: LiveState
    transcript: TranscriptService
    told: list[Any]

    def say(self, *events: Any) -> None:
        for event in events:
            self.bus.publish(replace(event, stamp_ns=event.stamp_ns or clock.now_ns()))
        # Events caused by the first ones are drained in the second pass.
        self.bus.take_in()
        self.bus.take_in()

    def correct(self, utterance_id: str = "p", **made: Any) -> None:
        self.transcript.handlers()[intents.CorrectUtterance](intents.CorrectUtterance(utterance_id, **made))
        self.bus.take_in()


@pytest.fixture
def desk() -> Iterator[Desk]:
    owner, told = QObject(), []
    state = LiveState(owner)
    bus = Bus(state, owner)
    bus.tap(lambda value, _raw: told.append(value))
    transcript = TranscriptService(context_of(state, bus, owner))
    for service in (transcript, ResponseTimeService(bus, owner)):
        bus.follow(service.follows())
    yield Desk(bus, state, transcript, told)
    state.close()


def test_corrections_are_recorded_and_shown(desk: Desk) -> None:
    desk.say(HEARD)
    desk.correct(text="  Can it hurt\npeople? ", actor="wizard:b")
    (turn,) = desk.state.transcript.value
    assert (turn.text, turn.heard_text) == ("Can it hurt people?", "Can it hurd people?")
    assert [(event.text, event.actor) for event in desk.told if isinstance(event, UtteranceCorrected)] == [
        ("Can it hurt people?", "wizard:b")
    ]
    desk.correct(speaker="", person_id="")
    assert desk.state.transcript.value[0].speaker == ""


def test_a_sentence_whose_end_is_not_known_stays_in_the_conversation(desk: Desk) -> None:
    """rosbridge was killed during the utterance. A turn that was heard, but not recognised, is omitted."""
    asked = UtteranceChanged(0, "r", "robot", "Follow me.", "typed", "requested")
    desk.say(asked, replace(asked, state="started"), replace(asked, state="failed", detail="the connection was lost"))
    desk.say(replace(HEARD, state="started"), replace(HEARD, state="failed"))
    desk.say(replace(asked, utterance_id="never"), replace(asked, utterance_id="never", state="failed"))
    assert [turn.utterance_id for turn in in_order(desk.state.transcript.value)] == ["r"]


def test_turns_of_another_session_are_not_corrected(desk: Desk) -> None:
    desk.say(HEARD)
    desk.say(SessionStarted(0, "next"))
    assert desk.state.transcript.value == ()
    with pytest.raises(UserFacingError, match="belongs to another session"):
        desk.correct(text="Anything")


def test_turns_of_an_interrupted_session_stay_while_the_next_one_resumes_it(desk: Desk) -> None:
    earlier = Turn("u", "robot", "Hello.", "typed", "finished", started_ns=1, ended_ns=2)
    desk.transcript.show_earlier((earlier,))
    desk.say(SessionStarted(0, "resumed"), HEARD)
    assert [turn.text for turn in desk.state.transcript.value] == ["Hello.", HEARD.text]
    with pytest.raises(UserFacingError, match="belongs to another session"):
        desk.correct("u", text="Anything")
    desk.say(SessionStarted(clock.now_ns(), "another"))
    assert desk.state.transcript.value == ()


def test_a_turn_that_continues_as_a_session_begins_is_of_that_session(desk: Desk) -> None:
    desk.say(replace(HEARD, state="started", text=""), SessionStarted(0, "next"), HEARD)
    assert [turn.text for turn in desk.state.transcript.value] == [HEARD.text]


def test_an_answer_is_timed_once_with_every_moment(desk: Desk) -> None:
    shown = SuggestionChanged(0, "s1", "displayed", "p", 1, 1, "No.", "small")
    reply = UtteranceChanged(0, "r", "robot", "No.", "suggestion", "requested")
    desk.say(HEARD)
    desk.say(shown)
    desk.say(reply, replace(reply, state="started"), replace(reply, state="finished"))
    (timed,) = (event for event in desk.told if isinstance(event, ResponseTimed))
    assert (timed.turn_id, timed.reply_id, timed.means) == ("p", "r", "suggestion")
    moments = (timed.voice_ended_ns, timed.text_ns, timed.suggested_ns, timed.asked_ns, timed.first_sound_ns)
    assert None not in moments
    assert list(moments) == sorted(moments), "one after the other"  # type: ignore[type-var]
    assert timed.stamp_ns >= moments[-1]  # type: ignore[operator]
