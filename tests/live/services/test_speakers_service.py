"""Attribution of speech to a detected person, from the events of other services."""

from dataclasses import replace
from typing import Any

import pytest
from PySide6.QtCore import QObject

from caris_desktop.domain import clock
from caris_desktop.domain.actor import CONSOLE
from caris_desktop.domain.events import UtteranceChanged, UtteranceCorrected
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE, WIZARD_MICROPHONE, Hearing
from caris_desktop.live.bus import Bus
from caris_desktop.live.services.people_service import SpeakersService
from caris_desktop.live.state import LiveState
from caris_desktop.people.presence import PersonRow
from tests.support.service_context import context_of

pytestmark = pytest.mark.usefixtures("qapp")


class Desk:
    def __init__(self) -> None:
        self.owner = QObject()
        self.state = LiveState(self.owner)
        self.bus = Bus(self.state, self.owner)
        self.told: list[Any] = []
        self.bus.tap(lambda value, _raw: self.told.append(value), (UtteranceCorrected,))
        self.speakers = SpeakersService(context_of(self.state, self.bus, self.owner))
        self.bus.follow(self.speakers.follows())
        self.turns = 0

    def here(self, *rows: PersonRow) -> None:
        self.state.persons.set(rows)

    def said(self, text: str = "Where is the kitchen?", **changes: Any) -> tuple[str, str]:
        """An utterance of a participant, just now. Returns the person it was attributed to at its start, and its id."""
        self.turns += 1
        now_ns = clock.now_ns()
        utterance = UtteranceChanged(
            now_ns, f"h-{self.turns}", "participant", "", "heard", "started", source=ROBOT_MICROPHONE
        )
        utterance = replace(utterance, **changes)
        self.bus.publish(utterance)
        self.bus.take_in()
        speaks = self.speakers.who_speaks(utterance)
        self.bus.publish(replace(utterance, stamp_ns=clock.now_ns() + 1, text=text, state="finished"))
        self.bus.take_in()
        return speaks, utterance.utterance_id


def _person(person_id: str, **changes: Any) -> PersonRow:
    return PersonRow(person_id, 1, "Person 1", here=True, since_ns=0, last_seen_ns=0, **changes)


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_a_person_facing_the_robot_nearby_is_the_speaker(desk: Desk) -> None:
    desk.here(_person("p-luis", facing=True, distance_m=1.0), _person("p-anna", facing=False, distance_m=2.0))
    speaks, utterance_id = desk.said()
    assert speaks == "p-luis"
    (told,) = desk.told
    assert (told.utterance_id, told.person_id, told.actor) == (utterance_id, "p-luis", CONSOLE)
    assert (told.text, told.speaker, told.tags) == (None, None, None)
    assert 0.7 <= told.person_confidence < 1.0


def test_a_person_alone_is_the_speaker_at_any_distance(desk: Desk) -> None:
    desk.here(_person("p-luis", distance_m=4.5))
    assert desk.said()[0] == "p-luis"
    (told,) = desk.told
    assert (told.person_id, told.actor, told.person_confidence) == ("p-luis", CONSOLE, 0.5)


def test_an_ambiguous_addressee_stays_open_until_the_wizard_selects_one(desk: Desk) -> None:
    desk.here(_person("p-luis", distance_m=1.0), _person("p-anna", distance_m=2.2))
    assert desk.said()[0] == ""
    assert desk.told == []
    desk.state.selected_person.set("p-luis")
    assert desk.said()[0] == "p-luis"


def test_a_person_who_left_does_not_speak(desk: Desk) -> None:
    desk.here(replace(_person("p-luis", facing=True, distance_m=1.0), here=False))
    assert desk.said()[0] == ""
    assert desk.told == []


def test_a_known_speaker_stays(desk: Desk) -> None:
    desk.here(_person("p-luis", facing=True, distance_m=1.0))
    assert desk.said(person_id="p-anna")[0] == "p-anna"
    assert desk.told == []


def test_the_wizards_own_voice_at_the_participants_microphone_is_the_wizards(desk: Desk) -> None:
    desk.here(_person("p-luis", facing=True, distance_m=1.0))
    began_ns = clock.now_ns() - 1_000_000_000
    desk.bus.publish(
        Hearing(
            clock.now_ns(), WIZARD_MICROPHONE, speaking=True, speaker="wizard", committed="follow me",
            tentative="to the kitchen", speech_started_ns=began_ns,
        )
    )  # fmt: skip
    desk.bus.take_in()
    desk.said("Follow me to the kitchen.")
    (told,) = desk.told
    assert (told.speaker, told.person_id) == ("wizard", "")
