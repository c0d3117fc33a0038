"""Identity decisions: each is an event without names and can be undone, except an erasure."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.domain import intents
from caris_desktop.domain.events import (
    ConsentNoted,
    Event,
    PeopleMerged,
    PeopleUndone,
    PersonAppeared,
    PersonDescribed,
    PersonForgotten,
    PersonIdentified,
    PersonLeft,
    PersonRejected,
    PersonRenamed,
    PersonSplit,
    PhotoTaken,
    Problem,
    SessionStarted,
    UtteranceChanged,
    UtteranceCorrected,
)
from caris_desktop.domain.person_values import PersonPortrait
from caris_desktop.people.decisions import MOST_UNDONE, PeopleIntent
from caris_desktop.people.people_store import About, PeopleStore
from caris_desktop.people.presence import PersonRow, RecognitionSettings
from tests.people.crowd import Room

ADA, BO = 1, 2


@pytest.fixture
def room(tmp_path: Path) -> Iterator[Room]:
    room = Room(
        PeopleStore(tmp_path / "people.sqlite", utc_now_ns=lambda: 42), settings=RecognitionSettings(confirm_at=1.0)
    )
    yield room
    room.presence.close()


def do(room: Room, asked: PeopleIntent) -> list[Event]:
    return room.presence.do(asked, room.now_ns)


def rows(room: Room) -> dict[str, PersonRow]:
    return {row.person_id: row for row in room.presence.everybody()}


def stored(room: Room, person_id: str) -> About:
    assert room.knowing.store is not None
    person = room.knowing.store.get(person_id)
    assert person is not None
    return person.about


def test_name_group_tags_and_note_are_retained_shown_and_taken_back_one_by_one(room: Room) -> None:
    (ada,) = room.visit(ADA, leaves=False)
    asked = (
        intents.NamePerson(ada, " Ada  Lovelace "),
        intents.SetPersonGroup(ada, "Control"),
        intents.TagPerson(ada, ("shy", "tall", "shy", "")),
        intents.NotePerson(ada, "Likes trains\nand maps\n"),
    )
    events = [event for each in asked for event in do(room, each)]
    assert [type(event) for event in events] == [PersonRenamed, *3 * [PersonDescribed]]
    assert not any(word in repr(events) for word in ("Ada", "Control", "shy", "trains"))
    row = rows(room)[ada]
    assert (row.name, row.group, row.tags, row.note) == (
        "Ada Lovelace", "Control", ("shy", "tall"), "Likes trains\nand maps",
    )  # fmt: skip
    assert row.known
    assert stored(room, ada) == About("Ada Lovelace", "Control", ("shy", "tall"), "Likes trains\nand maps")
    for about in (
        About("Ada Lovelace", "Control", ("shy", "tall")),
        About("Ada Lovelace", "Control"),
        About("Ada Lovelace"),
        About(),
    ):
        (undone,) = do(room, intents.UndoPeople(actor="wizard:b"))
        assert isinstance(undone, PeopleUndone) and (undone.person_id, undone.actor) == (ada, "wizard:b")
        assert stored(room, ada) == about
    assert rows(room)[ada].name == "Person 1"
    (told,) = do(room, intents.UndoPeople())
    assert isinstance(told, Problem) and told.severity == "info"


def test_two_of_one_name_stay_two_and_the_wizard_is_notified(room: Room) -> None:
    ada, bo = room.visit(ADA, BO, leaves=False)
    do(room, intents.NamePerson(ada, "Alex"))
    renamed, told = do(room, intents.NamePerson(bo, "Alex"))
    assert renamed == PersonRenamed(room.now_ns, bo, "wizard")
    assert isinstance(told, Problem) and told.severity == "info"
    assert "Alex" not in repr(told), "problems are recorded"
    assert [row.name for row in room.presence.persons()] == ["Alex", "Alex"]


def test_a_confirmation_merges_the_history_and_can_be_undone(room: Room) -> None:
    (ada,) = room.visit(ADA)
    do(room, intents.NamePerson(ada, "Ada"))
    (guest,) = room.visit(BO, leaves=False)
    say(room, guest, "Welcome!")
    (event,) = do(room, intents.ConfirmPerson(guest, ada))
    assert event == PersonIdentified(room.now_ns, guest, ada, "wizard", 0.0, 0.0, "wizard")
    say(room, ada, "Welcome back!")
    store = room.knowing.store
    assert store is not None
    assert {entry.text for entry in store.history(ada) if entry.kind == "said"} == {"Welcome!", "Welcome back!"}
    (undone,) = do(room, intents.UndoPeople())
    assert isinstance(undone, PeopleUndone) and undone.decision == "identified"
    assert [row.person_id for row in room.presence.persons()] == [guest]
    assert [entry.kind for entry in store.history(ada)] == ["visit"], "what was said to them went along"
    assert {entry.text for entry in store.history(guest)} == {"Welcome!", "Welcome back!"}


def test_a_confirmed_person_is_not_called_recognised(room: Room) -> None:
    room.presence.use_settings(RecognitionSettings(confirm_at=1.0))
    (ada,) = room.visit(ADA)
    do(room, intents.NamePerson(ada, "Ada"))
    (guest,) = room.visit(ADA, leaves=False)
    (row,) = room.presence.persons()
    assert row.suggestion is not None and row.suggestion.confidence > 0.5
    (event,) = do(room, intents.ConfirmPerson(guest, ada))
    assert isinstance(event, PersonIdentified) and event.confidence > 0.5, "the record has how sure the console was"
    (row,) = room.presence.persons()
    assert (row.name, row.confidence) == ("Ada", 0.0)


def test_only_what_people_decided_is_undone_and_the_console_does_not_decide_it_then(room: Room) -> None:
    room.presence.use_settings(RecognitionSettings())
    (ada,) = room.visit(ADA)
    do(room, intents.NamePerson(ada, "Ada"))
    (guest,) = room.visit(ADA, leaves=False, frames=3)
    do(room, intents.ConfirmPerson(guest, ada))
    do(room, intents.UndoPeople())
    room.see({2: ADA}, frames=20)
    assert room.of(PersonIdentified) == [], "the wizard has it in hand"
    assert rows(room)[guest].suggestion is not None
    room.wait(4.0)
    room.visit(ADA, leaves=False)
    assert len(room.of(PersonIdentified)) == 1
    (undone,) = do(room, intents.UndoPeople())
    assert isinstance(undone, PeopleUndone) and undone.decision == "named", "the wizard's last, not the console's"


def say(room: Room, person_id: str, text: str) -> None:
    for state in ("requested", "started", "finished"):
        room.presence.note(
            UtteranceChanged(room.now_ns, f"u-{text}", "robot", text, "typed", state, person_id=person_id)  # type: ignore[arg-type]
        )


def test_nobody_can_be_here_twice(room: Room) -> None:
    (ada,) = room.visit(ADA, leaves=False)
    do(room, intents.NamePerson(ada, "Ada"))
    room.see({1: ADA, 2: BO}, frames=3)
    other = next(row.person_id for row in room.presence.persons() if row.person_id != ada)
    (told,) = do(room, intents.ConfirmPerson(other, ada))
    assert isinstance(told, Problem)
    assert {row.person_id for row in room.presence.persons()} == {ada, other}


def test_two_rows_become_one_and_two_again(room: Room) -> None:
    ada, bo = room.visit(ADA, BO, leaves=False)
    do(room, intents.NamePerson(ada, "Ada"))
    do(room, intents.TagPerson(bo, ("tall",)))
    (event,) = do(room, intents.MergePeople(bo, ada))
    assert event == PeopleMerged(room.now_ns, bo, ada, "wizard")
    (row,) = room.presence.persons()
    assert (row.person_id, row.name, row.tags) == (ada, "Ada", ("tall",))
    room.events.clear()
    room.see({1: ADA}, frames=8)
    assert room.of(PersonLeft) == [], "one of the two is still there"
    do(room, intents.UndoPeople())
    assert rows(room)[ada].tags == ()
    assert rows(room)[bo].tags == ("tall",)


def test_a_person_in_the_same_place_may_be_another(room: Room) -> None:
    (ada,) = room.visit(ADA, leaves=False)
    do(room, intents.NamePerson(ada, "Ada"))
    left, split, came = do(room, intents.SplitPerson(ada))
    assert isinstance(left, PersonLeft) and isinstance(split, PersonSplit) and isinstance(came, PersonAppeared)
    assert (left.person_id, split.from_person_id, split.person_id) == (ada, ada, came.person_id)
    (row,) = room.presence.persons()
    assert (row.person_id, row.name) == (came.person_id, "Person 2")
    room.events.clear()
    room.see({1: BO}, frames=3)
    assert room.events == []
    do(room, intents.UndoPeople())
    assert [row.person_id for row in room.presence.persons()] == [ada]
    room.see({1: BO}, frames=3)
    assert [row.person_id for row in room.presence.persons()] == [ada]


def test_a_visit_that_was_a_persons_is_split_off(room: Room) -> None:
    (ada,) = room.visit(ADA)
    do(room, intents.NamePerson(ada, "Ada"))
    (guest,) = room.visit(BO)
    do(room, intents.ConfirmPerson(guest, ada))
    (event,) = do(room, intents.SplitPerson(ada, visit_id=guest))
    assert event == PersonSplit(room.now_ns, guest, ada, "wizard")
    assert set(rows(room)) == {ada, guest}
    do(room, intents.UndoPeople())
    assert set(rows(room)) == {ada}


def test_a_rejection_is_taken_back(room: Room) -> None:
    (ada,) = room.visit(ADA)
    do(room, intents.NamePerson(ada, "Ada"))
    (guest,) = room.visit(ADA, leaves=False)
    assert rows(room)[guest].suggestion is not None
    (event,) = do(room, intents.RejectPerson(guest, ada))
    assert event == PersonRejected(room.now_ns, guest, ada, "wizard")
    room.see({2: ADA}, frames=6)
    assert rows(room)[guest].suggestion is None
    do(room, intents.UndoPeople())
    room.see({2: ADA}, frames=2)
    assert rows(room)[guest].suggestion is not None


def test_consent_is_noted_with_who_and_when_and_its_newest_answer_counts(room: Room) -> None:
    (ada,) = room.visit(ADA, leaves=False)
    (event,) = do(room, intents.NoteConsent(ada, "video", given=True, actor="wizard:b"))
    assert event == ConsentNoted(room.now_ns, ada, "video", True, "wizard:b")
    assert rows(room)[ada].consents == ("video",)
    store = room.knowing.store
    assert store is not None
    consent = store.consents()[ada]["video"]
    assert (consent.given, consent.actor, consent.noted_utc_ns) == (True, "wizard:b", 42)
    do(room, intents.NoteConsent(ada, "video", given=False))
    assert rows(room)[ada].consents == ()
    do(room, intents.UndoPeople())
    assert rows(room)[ada].consents == ("video",)


def test_events_of_a_person_are_their_history(room: Room) -> None:
    room.presence.note(SessionStarted(room.now_ns, "2026-11-23_P1"))
    (ada,) = room.visit(ADA, leaves=False)
    say(room, ada, "This is the Mona Lisa.")
    room.presence.note(
        UtteranceChanged(room.now_ns, "u2", "participant", "Is it real?", "heard", "started", person_id=ada)
    )
    assert rows(room)[ada].speaking
    room.presence.note(
        UtteranceChanged(room.now_ns, "u2", "participant", "Is it real?", "heard", "finished", person_id=ada)
    )
    assert not rows(room)[ada].speaking
    room.presence.note(PhotoTaken(room.now_ns, "front", 3, "photos/1.png", person_ids=(ada,)))
    room.wait(4.0)
    store = room.knowing.store
    assert store is not None
    history = store.history(ada)
    assert {(entry.kind, entry.text) for entry in history} == {
        ("visit", ""), ("said", "This is the Mona Lisa."), ("heard", "Is it real?"), ("photo", "photos/1.png"),
    }  # fmt: skip
    assert {entry.session for entry in history} == {"2026-11-23_P1"}
    assert [entry.text for entry in store.history(ada, "real")] == ["Is it real?"]


def test_a_correction_is_in_the_right_history(room: Room) -> None:
    ada, bo = room.visit(ADA, BO, leaves=False)

    def heard() -> dict[str, list[str]]:
        store = room.knowing.store
        assert store is not None
        return {
            name: [entry.text for entry in store.history(person_id) if entry.kind == "heard"]
            for name, person_id in (("ada", ada), ("bo", bo))
        }

    def correct(actor: str = "wizard", **made: Any) -> None:
        room.presence.note(UtteranceCorrected(room.now_ns, "u2", actor=actor, **made))

    utterance = UtteranceChanged(room.now_ns, "u2", "participant", "Is it reel?", "heard", "finished", person_id=ada)
    room.presence.note(utterance)
    correct(text="Is it real?")
    assert heard() == {"ada": ["Is it real?"], "bo": []}
    correct(person_id=bo)
    assert heard() == {"ada": [], "bo": ["Is it real?"]}
    correct("console", person_id=ada)
    assert heard() == {"ada": [], "bo": ["Is it real?"]}, "the wizard knows better"
    correct(speaker="robot")
    assert heard() == {"ada": [], "bo": []}


def test_notes_are_history_also_when_another_one_has_taken_their_place(room: Room) -> None:
    (ada,) = room.visit(ADA, leaves=False)
    for note in ("Likes trains", "Likes maps"):
        do(room, intents.NotePerson(ada, note))
    store = room.knowing.store
    assert store is not None
    assert {entry.text for entry in store.history(ada, "likes") if entry.kind == "note"} == {
        "Likes trains", "Likes maps",
    }  # fmt: skip
    do(room, intents.UndoPeople())
    assert [entry.text for entry in store.history(ada) if entry.kind == "note"] == ["Likes trains"]


def test_forgetting_is_for_good_and_who_still_stands_there_is_nobody_known(room: Room) -> None:
    ada, bo = room.visit(ADA, BO, leaves=False)
    do(room, intents.NamePerson(ada, "Ada"))
    do(room, intents.NamePerson(bo, "Bo"))
    room.presence.add_portrait(PersonPortrait(room.now_ns, "front", 1, b"\xff\xd8picture", 0.9))
    portrait = rows(room)[ada].portrait
    assert room.presence.portraits.get(portrait) == b"\xff\xd8picture"
    forgotten, came = do(room, intents.ForgetPerson(ada))
    assert forgotten == PersonForgotten(room.now_ns, ada, "wizard")
    assert isinstance(came, PersonAppeared)
    assert room.presence.portraits.get(portrait) is None
    assert ada not in rows(room)
    held = room.knowing.identities.held()
    room.see({1: ADA}, frames=5)
    room.presence.add_portrait(PersonPortrait(room.now_ns, "front", 1, b"\xff\xd8picture", 0.95))
    assert rows(room)[came.person_id].portrait == ""
    assert room.knowing.identities.held() == held, "nothing about how they look is learned any more"
    (undone,) = do(room, intents.UndoPeople())
    assert isinstance(undone, PeopleUndone) and undone.person_id == bo, "the others' decisions can be"
    assert isinstance(do(room, intents.UndoPeople())[0], Problem)


@pytest.mark.parametrize(
    "asked",
    [
        intents.NamePerson("p-unknown", "Ada"),
        intents.ConfirmPerson("p-unknown", "p-other"),
        intents.RejectPerson("p-unknown", "p-other"),
        intents.TagPerson("p-unknown", ("a",)),
        intents.MergePeople("p-unknown", "p-other"),
        intents.SplitPerson("p-unknown"),
        intents.NoteConsent("p-unknown", "face", given=True),
        intents.ForgetPerson("p-unknown"),
    ],
    ids=lambda asked: type(asked).__name__,
)
def test_of_a_person_unknown_nothing_is_decided(room: Room, asked: PeopleIntent) -> None:
    (told,) = do(room, asked)
    assert isinstance(told, Problem) and told.what == "That person is no longer known."


def test_so_many_decisions_can_be_taken_back_and_none_where_people_are_not_named(room: Room) -> None:
    (ada,) = room.visit(ADA, leaves=False)
    for number in range(MOST_UNDONE + 10):
        do(room, intents.NotePerson(ada, f"Note {number}"))
    undone = 0
    while isinstance(do(room, intents.UndoPeople())[0], PeopleUndone):
        undone += 1
    assert undone == MOST_UNDONE
    assert rows(room)[ada].note == "Note 9"
    do(room, intents.NamePerson(ada, "Ada"))
    room.presence.use_settings(RecognitionSettings("nobody"), may_decide=False)
    assert isinstance(do(room, intents.UndoPeople())[0], Problem)


@pytest.mark.long
def test_ten_minutes_of_people_coming_and_going_leave_no_more_than_the_first_minute(room: Room) -> None:
    def held() -> tuple[int, int, int]:
        known = room.knowing
        names = len(known._last_seen_utc_ns) + len(known._rejections)
        return known.identities.held(), names, len(room.presence.portraits)

    room.presence.use_settings(RecognitionSettings())
    sizes = []
    for _ in range(10):
        for number in range(40, 50):
            room.visit(number, frames=8)
            track = room._track
            room.presence.add_portrait(PersonPortrait(room.now_ns, "front", track, b"x", 0.9))
        room.events.clear()
        sizes.append(held())
    assert max(size[0] for size in sizes[4:]) <= 1.1 * sizes[3][0]
    assert len(room.presence.everybody()) <= 300


def test_a_known_person_without_a_name_has_a_number(tmp_path: Path) -> None:
    store = PeopleStore(tmp_path / "people.sqlite")
    for about in (About("Ada"), About(note="Likes trains")):
        store.describe(store.add().person_id, about)
    room = Room(store)
    assert {(row.name, row.note, row.known) for row in room.presence.everybody()} == {
        ("Ada", "", True), ("Person 1", "Likes trains", True),
    }  # fmt: skip
    room.presence.close()
