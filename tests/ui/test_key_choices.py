"""Key choices of a wizard: refusals with reasons, replaced bindings, and robustness against stored text."""

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from caris_desktop.scenario.phrases import Phrase
from caris_desktop.ui.action_bindings import rows_of
from caris_desktop.ui.action_rows import ACTIONS, REPLAY_ACTIONS, TIMELINE_ACTIONS, ActionSpec
from caris_desktop.ui.key_choices import (
    COLUMNS,
    Column,
    Keys,
    as_text,
    changed,
    conflicts,
    from_text,
    name_of_row,
    normalized,
    owners,
    refusal,
    settle,
    without,
)
from tests.ui import samples

BY_ID = {spec.id: spec for spec in (*ACTIONS, *REPLAY_ACTIONS, *TIMELINE_ACTIONS)}


@pytest.mark.parametrize(
    ("row", "column", "key", "why"),
    [
        ("photo", "keys", "Esc", "stop the robot"),
        ("photo", "keys", "Ctrl+Pause", "stop the robot"),
        ("stop", "keys", "F11", "cannot be changed"),
        ("emergency_stop", "keys", "Ctrl+E", "cannot be changed"),
        ("photo", "keys", "P", "types in a text field"),
        ("photo", "keys", "Shift+P", "types in a text field"),
        ("photo", "keys", "Return", "types in a text field"),
        ("photo", "keys", "Ctrl+V", "is used for editing text"),
        ("photo", "keys", "Alt+P", "Alt is for driving"),
        ("photo", "keys", "Ctrl+Alt+P", "Alt is for driving"),
        ("photo", "keys", "Tab", "moves the focus through the window"),
        ("photo", "driving_keys", "W", "drives the robot"),
        ("photo", "driving_keys", "Up", "drives the robot"),
        ("drive_forward", "driving_keys", "Ctrl+W", "a single letter or digit"),
        ("drive_forward", "keys", "F3", "a single letter or digit"),
        ("place_1", "driving_keys", "Up", "a single letter or digit"),
        ("mark", "driving_keys", "S", "drives the robot"),
        ("phrase_1", "keys", "Space", "types in a text field"),
    ],
)
def test_reserved_keys_are_refused_with_the_reason(row: str, column: Column, key: str, why: str) -> None:
    assert why in refusal(BY_ID[row], column, key, ACTIONS)


def test_a_letter_on_a_driving_key_is_refused_too() -> None:
    assert refusal(BY_ID["photo"], "driving_keys", "Y", ACTIONS, position="Z"), "a German keyboard"
    assert not refusal(BY_ID["photo"], "driving_keys", "X", ACTIONS, position="X")


@pytest.mark.parametrize(
    ("row", "column", "key"),
    [
        ("photo", "keys", "Ctrl+F5"), ("photo", "keys", "F11"), ("photo", "keys", "Shift+F11"),
        ("photo", "driving_keys", "X"), ("drive_forward", "driving_keys", "T"), ("drive_forward", "driving_keys", "Up"),
        ("replay_play", "keys", "X"), ("annotation_new", "keys", "X"), ("push_to_talk", "keys", "Ctrl+X"[:-1] + "5"),
    ],
)  # fmt: skip
def test_others_are_not(row: str, column: Column, key: str) -> None:
    assert refusal(BY_ID[row], column, key, ACTIONS) == ""


def test_no_key_of_the_table_would_be_refused_to_its_own_row() -> None:
    for spec in BY_ID.values():
        if spec.kind == "safety":
            continue
        for column in COLUMNS:
            for key in getattr(spec, column):
                bare = key.removeprefix("Alt+") if spec.by_position else normalized(key)
                assert refusal(spec, column, bare, [spec] if spec.kind == "hold" else ACTIONS) == "", (spec.id, key)


def test_a_drive_key_keeps_its_arrow_and_gets_its_chord() -> None:
    forward = BY_ID["drive_forward"]
    assert changed(forward, "keys", "E") == Keys(("Alt+E", "Alt+Up"), ("E", "Up"))
    assert changed(forward, "driving_keys", "Left") == Keys(("Alt+W", "Alt+Left"), ("W", "Left"))
    assert without(forward, "W") == Keys(("Alt+Up",), ("Up",))
    assert without(BY_ID["photo"], "P") == Keys(("Ctrl+P",), ())


def test_the_owner_of_a_key_is_known_in_both_columns() -> None:
    keys = changed(BY_ID["photo"], "keys", "Ctrl+M")
    assert [(key, row.id) for key, row in owners(ACTIONS, BY_ID["photo"], keys)] == [("Ctrl+M", "mark")]
    keys = changed(BY_ID["drive_forward"], "driving_keys", "P")
    assert [(key, row.id) for key, row in owners(ACTIONS, BY_ID["drive_forward"], keys)] == [("P", "photo")]
    keys = changed(BY_ID["photo"], "keys", "Ctrl+F5")
    assert owners(ACTIONS, BY_ID["photo"], keys) == []


def test_a_choice_goes_before_the_key_of_a_phrase_and_the_phrase_is_reported() -> None:
    scenario = dataclasses.replace(samples.TOUR, phrases=(Phrase("Goodbye.", "Ctrl+F5"),))
    settled = settle(rows_of(scenario), {"photo": Keys(("Ctrl+F5",), ("P",))})
    assert [(phrase.text, other.id) for phrase, other in settled.clashes] == [("Goodbye.", "photo")]
    assert settled.fallen_back == ()
    settled = settle(rows_of(scenario), {"phrase: Goodbye.": Keys(("Ctrl+6",))})
    assert [spec.keys for spec in settled.rows if spec.text == "Goodbye." and spec.group == "Speaking"][-1] == (
        "Ctrl+6",
    )
    assert settled.clashes == ()


@pytest.mark.parametrize(
    ("choices", "told"),
    [
        ({"photo": Keys(("Ctrl+M",))}, "“Photo”: Ctrl+M is already assigned to “Mark”."),
        ({"photo": Keys(("Ctrl+F5",)), "mark": Keys(("Ctrl+F5",))}, "“Mark”: Ctrl+F5 is already assigned to “Photo”."),
        ({"photo": Keys(("W",))}, "types in a text field"),
        ({"photo": Keys(("Ctrl+Nonsense",))}, "Ctrl+Nonsense is not a key."),
        ({"photo": Keys(("Ctrl+F5, Ctrl+6",))}, "is not a key."),
        ({"stop": Keys(("Ctrl+F5",))}, "cannot be changed"),
        ({"stop": Keys()}, "cannot be changed"),
        ({"drive_forward": Keys(("Ctrl+F5",), ("W",))}, "cannot be used for driving"),
        ({"drive_forward": Keys(("Alt+F5",), ("F5",))}, "a single letter or digit"),
    ],
)
def test_unusable_keys_fall_back_and_are_reported(choices: dict[str, Keys], told: str) -> None:
    settled = settle(ACTIONS, choices)
    (sentence,) = settled.fallen_back
    assert told in sentence
    assert conflicts(settled.rows) == []
    unused = {"photo", "stop", "drive_forward"} & set(choices) if len(choices) == 1 else {"mark"}
    assert all(spec == BY_ID[spec.id] for spec in settled.rows if spec.id in unused)


def test_rows_of_another_scenario_are_left_in_peace() -> None:
    assert settle(ACTIONS, {"no such row": Keys(("Ctrl+F5",)), "phrase: Gone.": Keys(("Ctrl+6",))}).fallen_back == ()


_NAMES = "Ctrl+F5 Ctrl+M Ctrl+P P M W Esc F1 Alt+W Up Alt+Up x Ctrl+ä"
_SOME_KEYS = st.lists(st.sampled_from([*_NAMES.split(), ""]), max_size=3).map(tuple)


@given(st.dictionaries(st.sampled_from([spec.id for spec in ACTIONS]), st.builds(Keys, _SOME_KEYS, _SOME_KEYS)))
def test_no_saved_key_does_two_things_and_the_robot_can_be_stopped(choices: dict[str, Keys]) -> None:
    rows = settle(ACTIONS, from_text(as_text(choices))).rows
    assert conflicts(rows) == []
    assert [spec for spec in rows if spec.kind == "safety"] == [spec for spec in ACTIONS if spec.kind == "safety"]
    assert {spec.id for spec in rows} == {spec.id for spec in ACTIONS}


@pytest.mark.parametrize(
    "text", ["", "no json", "[]", '{"photo": 3}', '{"photo": {"keys": "Ctrl+P"}}', '{"photo": {"keys": [4]}}',
             '{"photo": {"keys": ["a","b","c","d","e"]}}', "[" * 100_000]
)  # fmt: skip
def test_broken_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError):
        from_text(text)


def test_a_phrase_is_known_by_its_sentence() -> None:
    scenario = dataclasses.replace(samples.TOUR, phrases=(Phrase("Goodbye.", "Ctrl+F5"),))
    named: list[ActionSpec] = [spec for spec in rows_of(scenario) if name_of_row(spec) == "phrase: Goodbye."]
    assert [spec.keys for spec in named] == [("Ctrl+F5",)]
