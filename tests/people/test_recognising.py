"""Re-identification: returning people are recognised and not confused, with simulated time and appearance."""

from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.domain import intents
from caris_desktop.domain.events import PersonAppeared, PersonIdentified, PersonLeft, PersonSplit, PersonSuggested
from caris_desktop.people.identities import Gallery
from caris_desktop.people.people_store import PeopleStore
from caris_desktop.people.presence import RecognitionSettings
from tests.people.crowd import Room

ASK_FIRST = RecognitionSettings(confirm_at=1.0)
ADA, BO, CY = 1, 2, 3


def named(room: Room, **names: int) -> dict[str, str]:
    """Let people come one after another and name them; returns the ids."""
    ids = {}
    for name, number in names.items():
        (visit,) = room.visit(number)
        room.presence.do(intents.NamePerson(visit, name), room.now_ns)
        ids[name] = visit
    room.events.clear()
    return ids


def test_a_returning_person_gets_their_name_after_several_embeddings() -> None:
    room = Room()
    ids = named(room, Ada=ADA, Bo=BO)
    room.visit(BO, frames=4, leaves=False)
    assert room.of(PersonIdentified) == [], "not by a glance"
    room.visit(ADA, leaves=False)
    (row,) = [row for row in room.presence.persons() if row.name == "Ada"]
    (event,) = room.of(PersonIdentified)
    assert isinstance(event, PersonIdentified)
    assert (event.person_id, event.is_person_id, event.by, event.actor) == (
        row.visit_id,
        ids["Ada"],
        "console",
        "console",
    )
    assert event.confidence >= 0.95 > event.runner_up
    assert (row.person_id, row.known, row.suggestions) == (ids["Ada"], True, ())


def test_boxes_bear_the_id_of_who_it_is() -> None:
    room = Room()
    ids = named(room, Ada=ADA)
    room.visit(ADA, leaves=False)
    room.events.clear()
    (row,) = room.presence.persons()
    assert row.person_id == ids["Ada"] != row.visit_id
    room.see({row.track: ADA}, frames=1)
    assert room.events == [], "the same person is not news"


def test_a_wizard_who_decides_alone_gets_suggestions_only() -> None:
    room = Room(settings=ASK_FIRST)
    ids = named(room, Ada=ADA, Bo=BO)
    (visit,) = room.visit(ADA, leaves=False)
    (event,) = room.of(PersonSuggested)
    assert isinstance(event, PersonSuggested)
    assert (event.person_id, event.is_person_id, event.kind) == (visit, ids["Ada"], "clothing")
    assert room.of(PersonIdentified) == []
    (row,) = room.presence.persons()
    assert row.suggestion is not None
    assert (row.suggestion.name, row.suggestion.person_id) == ("Ada", ids["Ada"])
    assert row.suggestion.confidence > 0.9
    (event,) = room.presence.do(intents.ConfirmPerson(visit, ids["Ada"]), room.now_ns)
    assert isinstance(event, PersonIdentified)
    assert (event.by, event.actor, event.is_person_id) == ("wizard", "wizard", ids["Ada"])
    (row,) = room.presence.persons()
    assert (row.name, row.suggestions) == ("Ada", ())


def test_a_stranger_is_nobody_known_and_is_known_again_as_the_same_stranger() -> None:
    room = Room()
    named(room, Ada=ADA, Bo=BO)
    (first,) = room.visit(CY)
    assert room.of(PersonIdentified) == room.of(PersonSuggested) == []
    room.visit(CY, leaves=False)
    (event,) = room.of(PersonIdentified)
    assert isinstance(event, PersonIdentified) and event.is_person_id == first
    (row,) = room.presence.persons()
    assert (row.name, row.known) == ("Person 3", False)


def test_between_two_who_look_alike_only_the_wizard_decides() -> None:
    room = Room(settings=ASK_FIRST)
    named(room, Ada=ADA, Anna=-ADA)
    room.presence.use_settings(RecognitionSettings())
    room.visit(ADA, frames=30, leaves=False)
    assert room.of(PersonIdentified) == []
    (row,) = room.presence.persons()
    assert row.suggestions == (), "and who is no more likely than the other is not asked about"


def test_a_tracker_that_takes_one_for_another_passes_no_name_on() -> None:
    room = Room()
    (visit,) = room.visit(ADA, leaves=False)
    room.presence.do(intents.NamePerson(visit, "Ada"), room.now_ns)
    room.events.clear()
    room.see({1: BO}, frames=2)
    assert [row.name for row in room.presence.persons()] == ["Ada"], "not by a glance"
    room.see({1: ADA}, frames=2)
    room.see({1: BO}, frames=4)
    left, split, came = room.events
    assert isinstance(left, PersonLeft) and isinstance(split, PersonSplit) and isinstance(came, PersonAppeared)
    assert (left.person_id, split.from_person_id, split.actor) == (visit, visit, "console")
    (row,) = room.presence.persons()
    assert (row.name, row.person_id, row.known) == ("Person 2", came.person_id, False)
    room.wait(4.0)
    room.visit(ADA, leaves=False)
    assert room.presence.persons()[0].name == "Ada", "the other's looks were not taken for hers"


def test_those_who_were_mistaken_for_one_another_are_distinguished_with_more_care() -> None:
    found = []
    for mistaken in (False, True):
        room = Room(settings=ASK_FIRST)
        ids = named(room, Ada=ADA, Anna=1000 + ADA)
        if mistaken:
            room.presence.do(intents.RejectPerson(ids["Anna"], ids["Ada"]), room.now_ns)
        room.presence.use_settings(RecognitionSettings())
        room.visit(ADA, leaves=False)
        found += [len(room.of(PersonIdentified))]
        assert room.presence.persons()[0].name == "Ada" if not mistaken else room.of(PersonSuggested)
    assert found == [1, 0]


def test_poor_views_teach_nothing_and_decide_nothing() -> None:
    room = Room()
    named(room, Ada=ADA)
    room.visit(ADA, frames=40, quality=0.2)
    assert room.of(PersonIdentified) == room.of(PersonSuggested) == []


def test_a_present_person_cannot_enter_again() -> None:
    room = Room()
    named(room, Ada=ADA)
    room.visit(ADA, leaves=False)
    assert len(room.of(PersonIdentified)) == 1
    here = room.presence.persons()[0].track
    room.events.clear()
    room.see({here: ADA, 99: ADA}, frames=20)
    assert room.of(PersonIdentified) == room.of(PersonSuggested) == []
    assert len(room.presence.persons()) == 2


def test_of_two_who_come_together_and_both_look_like_one_neither_is_named() -> None:
    room = Room()
    named(room, Ada=ADA)
    room.visit(ADA, ADA, frames=20, leaves=False)
    assert room.of(PersonIdentified) == []


def test_a_rejected_identity_is_remembered_for_that_visit() -> None:
    room = Room()
    ids = named(room, Ada=ADA)
    (visit,) = room.visit(ADA, leaves=False)
    (row,) = room.presence.persons()
    assert row.person_id == ids["Ada"]
    (event,) = room.presence.do(intents.RejectPerson(row.person_id, ids["Ada"]), room.now_ns)
    assert (event.person_id, event.is_person_id) == (visit, ids["Ada"])  # type: ignore[union-attr]
    room.events.clear()
    room.see({row.track: ADA}, frames=20)
    (row,) = room.presence.persons()
    assert (row.person_id, row.name, row.suggestions) == (visit, "Person 2", ())
    assert room.events == []


def test_yesterdays_clothes_decide_nothing(tmp_path: Path) -> None:
    late = datetime(2026, 11, 23, 23, 59)
    store = PeopleStore(tmp_path / "people.sqlite")
    room = Room(store, morning=late)
    named(room, Ada=ADA)
    room.wait(120.0)
    room.visit(ADA, leaves=False)
    assert room.of(PersonIdentified) == room.of(PersonSuggested) == []
    room.presence.close()


def test_a_person_before_a_restart_is_recognised_on_the_same_day_only(tmp_path: Path) -> None:
    def opened(morning: datetime) -> Room:
        room = Room(morning=morning)
        store = PeopleStore(tmp_path / "people.sqlite", utc_now_ns=lambda: room.knowing.utc_now_ns())
        room.__init__(store, morning=morning)  # type: ignore[misc]
        return room

    room = opened(datetime(2026, 11, 23, 9, 0))
    ids = named(room, Ada=ADA)
    room.presence.close()
    room = opened(datetime(2026, 11, 23, 15, 0))
    room.visit(ADA, leaves=False)
    (row,) = room.presence.persons()
    assert (row.person_id, row.name) == (ids["Ada"], "Ada")
    assert row.summary.startswith("was here once before, last on 23 November, 09:00")
    room.presence.close()
    room = opened(datetime(2026, 11, 24, 9, 0))
    room.visit(ADA, leaves=False)
    assert room.of(PersonIdentified) == room.of(PersonSuggested) == []
    room.presence.close()


def test_nobody_is_asked_about_who_left_without_a_name(tmp_path: Path) -> None:
    morning = datetime(2026, 11, 23, 9, 0)
    noon_ns = round(datetime(2026, 11, 23, 12, 0).timestamp() * 1e9)
    room = Room(PeopleStore(tmp_path / "people.sqlite", utc_now_ns=lambda: noon_ns), morning=morning)
    (stranger,) = room.visit(CY)
    room.presence.close()
    store = PeopleStore(tmp_path / "people.sqlite", utc_now_ns=lambda: noon_ns)
    room = Room(store, settings=ASK_FIRST, morning=morning)
    (visit,) = room.visit(CY, leaves=False)
    (row,) = room.presence.persons()
    assert row.suggestions == ()
    assert room.of(PersonSuggested) == []
    # The wizard may still confirm it.
    (event,) = room.presence.do(intents.ConfirmPerson(visit, stranger), room.now_ns)
    assert isinstance(event, PersonIdentified)
    assert room.presence.persons()[0].person_id == stranger
    room.presence.close()


@pytest.mark.parametrize("stray", [0.25, 0.5, 0.6, 0.7, 0.9])
def test_nobody_is_asked_about_below_the_line_of_the_scenario(stray: float) -> None:
    room = Room(settings=RecognitionSettings(confirm_at=1.0, ask_at=0.8), stray=stray)
    named(room, Ada=ADA, Anna=1000 + ADA, Bo=BO)
    for _ in range(6):
        room.visit(ADA, frames=1, leaves=False)
        track = room._track
        for _ in range(20):
            room.see({track: ADA}, frames=1)
            for row in room.presence.persons():
                assert all(row.suggestions[0].confidence >= 0.8 for row in (row,) if row.suggestions)
        room.wait(40.0)
    assert all(event.confidence >= 0.8 for event in room.of(PersonSuggested))  # type: ignore[union-attr]


def test_a_name_is_not_lost_to_those_who_left_without_one() -> None:
    """A known person was seen several times without recognition; each visit is a further similar person."""
    room = Room(settings=ASK_FIRST)
    ids = named(room, Ada=ADA, Bo=BO)
    for _ in range(6):
        room.visit(ADA, frames=5)
        room.wait(60.0)
    room.visit(ADA, leaves=False)
    (row,) = room.presence.persons()
    assert row.suggestion is not None and row.suggestion.person_id == ids["Ada"]
    assert row.suggestion.confidence >= 0.9


def test_a_scenario_that_recognises_nobody_learns_nothing() -> None:
    room = Room(settings=RecognitionSettings("nobody"))
    named(room, Ada=ADA)
    room.visit(ADA)
    assert room.of(PersonIdentified) == room.of(PersonSuggested) == []
    assert room.knowing.identities.held() == 0


@pytest.mark.parametrize(
    ("recognise", "agreed", "is_known"), [("faces", True, True), ("faces", False, False), ("clothing", True, False)]
)
def test_a_face_is_known_on_another_day_only_with_consent_and_where_the_scenario_wants_it(
    tmp_path: Path, recognise: str, agreed: bool, is_known: bool
) -> None:
    settings = RecognitionSettings(recognise)  # type: ignore[arg-type]
    store = PeopleStore(tmp_path / "people.sqlite")
    room = Room(store, settings=settings)
    (visit,) = room.visit(ADA, leaves=False, kind="face")
    room.presence.do(intents.NamePerson(visit, "Ada"), room.now_ns)
    room.presence.do(intents.NoteConsent(visit, "face", given=agreed), room.now_ns)
    room.see({1: ADA}, frames=12, kind="face")
    room.wait(24 * 3600.0)
    assert len(store.embeddings()) == int(is_known)
    room.visit(ADA, leaves=False, kind="face")
    assert len(room.of(PersonIdentified)) == int(is_known)
    if is_known:
        room.presence.do(intents.NoteConsent(visit, "face", given=False), room.now_ns)
        assert store.embeddings() == (), "taken back, it is gone"
    room.presence.close()


def test_no_face_is_looked_at_while_consents_are_asked_again(tmp_path: Path) -> None:
    store = PeopleStore(tmp_path / "people.sqlite")
    room = Room(store, settings=RecognitionSettings("faces"))
    (visit,) = room.visit(ADA, leaves=False, kind="face")
    room.presence.do(intents.NamePerson(visit, "Ada"), room.now_ns)
    room.presence.do(intents.NoteConsent(visit, "face", given=True), room.now_ns)
    room.see({1: ADA}, frames=12, kind="face")
    room.wait(24 * 3600.0)
    room.presence.ask_consents_again(True)
    room.visit(ADA, kind="face")
    assert room.of(PersonIdentified) == room.of(PersonSuggested) == []
    assert len(store.embeddings()) == 1, "it is kept for when they agree"
    room.presence.ask_consents_again(False)
    room.visit(ADA, leaves=False, kind="face")
    assert len(room.of(PersonIdentified)) == 1
    room.presence.close()


def test_of_a_face_nothing_is_left_when_its_owner_goes_and_has_not_agreed() -> None:
    room = Room(settings=RecognitionSettings("faces", confirm_at=1.0))
    (ada,) = room.visit(ADA, leaves=False, kind="face")
    room.presence.do(intents.NamePerson(ada, "Ada"), room.now_ns)
    room.presence.do(intents.NoteConsent(ada, "face", given=True), room.now_ns)
    room.see({1: ADA}, frames=8, kind="face")
    room.wait(4.0)
    held = room.knowing.identities.held()
    assert held > 0
    for somebody, suggested in ((BO, False), (ADA, True)):
        (visit,) = room.visit(somebody, leaves=False, kind="face")
        assert bool(room.presence.persons()[0].suggestions) == suggested
        room.wait(4.0)
        assert room.knowing.identities.views_of(visit) == {}, "also where it was left open who that was"
    assert room.knowing.identities.held() == held


def test_a_stranger_who_stays_costs_no_new_gallery_with_each_look(monkeypatch: pytest.MonkeyPatch) -> None:
    room = Room()
    named(room, Ada=ADA)
    room.visit(CY, leaves=False, frames=12)
    built: list[object] = []
    gallery_of = Gallery.of

    def counted(vectors: Any) -> Gallery:
        built.append(vectors)
        return gallery_of(vectors)

    monkeypatch.setattr(Gallery, "of", counted)
    room.see({2: CY}, frames=40)
    assert len(built) <= 1
