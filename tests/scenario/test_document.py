"""Scenario file in the editor: single fields, undo and redo, and mistakes without data loss."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from caris_desktop.domain.schema_fields import KeyPath, ValueForm
from caris_desktop.domain.schema_paths import ABSENT, differences, value_at
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui.scenario_editor.saving import EditedDocument
from tests.support.scenario_edits import (
    assert_only_that_field_changed,
    comments,
    edited_leaves,
    lists_of,
    other_value,
    sampled,
)

__all__ = ["sampled"]  # a fixture
SHIPPED = sorted(layouts_dir().glob("*.yaml"))
SMALL = """\
# By Anna
version: 1
title: Small   # and good
phrases:
  # the first
  - Hello
  - {say: Bye, key: Ctrl+B}   # the last
permissions:
  photos: false   # no consent
layout: {panel: video}
"""


def document(text: str = SMALL) -> EditedDocument:
    return EditedDocument(text, Path("small.yaml"))


@pytest.mark.long("reception", "mental-health-check", "practice")
@pytest.mark.parametrize("shipped", SHIPPED, ids=lambda path: path.stem)
def test_each_field_changes_its_own_lines_alone(
    shipped: Path, sampled: Callable[[list[tuple[KeyPath, ValueForm]]], list[tuple[KeyPath, ValueForm]]]
) -> None:
    text = shipped.read_text(encoding="utf-8")
    edit = EditedDocument(text, shipped)
    for path, form in sampled(edited_leaves(edit)):
        value = other_value(edit, path, form)
        if value is ABSENT:
            # Only together with another value: a place for a camera without a mount.
            edit.set(path, "Other words")
            assert edit.mistakes
        else:
            edit.set(path, value)
            assert_only_that_field_changed(edit, edit.text, path, value)
            assert edit.value(path) == value
        edit.undo()
        assert edit.text == text


@pytest.mark.long
@pytest.mark.parametrize("shipped", SHIPPED, ids=lambda path: path.stem)
def test_nearly_every_field_has_another_value_that_may_stand_there_alone(shipped: Path) -> None:
    edit = EditedDocument(shipped.read_text(encoding="utf-8"), shipped)
    all_of_them = edited_leaves(edit)
    alone = [path for path, form in all_of_them if other_value(edit, path, form) is not ABSENT]
    assert len(alone) > 0.9 * len(all_of_them)


@pytest.mark.long("reception", "mental-health-check", "practice")
@pytest.mark.parametrize("shipped", SHIPPED, ids=lambda path: path.stem)
def test_entries_come_move_and_go_and_take_no_comment_of_others_along(shipped: Path) -> None:
    text = shipped.read_text(encoding="utf-8")
    edit = EditedDocument(text, shipped)
    for path, _form in lists_of(edit):
        entries = edit.value(path)
        if not isinstance(entries, list) or not entries:
            continue
        edit.add((*path, len(entries)), entries[-1])
        assert edit.value(path) == [*entries, entries[-1]]
        assert comments(edit.text) == comments(text)
        edit.undo()
        edit.move((*path, 0), len(entries) - 1)
        assert edit.value(path) == [*entries[1:], entries[0]]
        assert sorted(re.findall(r"\w+", edit.text)) == sorted(re.findall(r"\w+", text))
        edit.undo()
        edit.remove((*path, 0))
        assert edit.value(path) in (entries[1:], ABSENT)
        edit.undo()
        assert edit.text == text


def test_a_text_with_more_along_becomes_a_group_and_a_text_again() -> None:
    edit = document()
    edit.set(("phrases", 0, "key"), "Ctrl+G")
    assert "\n  # the first\n  - {say: Hello, key: Ctrl+G}\n" in edit.text
    edit.clear(("phrases", 0, "key"))
    assert edit.text == SMALL
    edit.set(("phrases", 0, "say"), "Good morning")
    assert edit.data["phrases"][0] == "Good morning"


def test_a_value_set_to_its_default_leaves_the_file_as_it_was() -> None:
    edit = document()
    edit.set(("recording", "lsl"), True)
    assert edit.text != SMALL
    edit.set(("recording", "lsl"), False)
    assert edit.text == SMALL
    # Explicit values stay in the file.
    edit.set(("permissions", "photos"), True)
    assert "  photos: true   # no consent\n" in edit.text


def test_typing_in_one_place_is_one_step() -> None:
    edit = document()
    for text in ("S", "Sm", "Sma"):
        edit.set(("title",), text)
    edit.set(("filler",), "Hm")
    assert edit.undo() is not None
    assert edit.data["title"] == "Sma"
    step = edit.undo()
    assert step is not None
    assert (step.path, step.words) == (("title",), ("Title",))
    assert (edit.text, edit.changed) == (SMALL, False)
    edit.redo()
    edit.redo()
    assert (edit.data["title"], edit.data["filler"], edit.to_redo) == ("Sma", "Hm", None)
    edit.pause()
    edit.set(("filler",), "Hmm")
    edit.undo()
    assert edit.data["filler"] == "Hm"


TWO_STEPS = """\
version: 1
title: Small
places:
  - {name: Door, x_m: 1, y_m: 2}
protocol:
  steps:
    - title: Ask   # first
      go_to: Door
      branches:
        - {title: Leaves, to: goodbye}   # by another case
        - {title: Asks for a person, to: person}
    - {title: Goodbye, then: end}
    - {title: Person, id: person, then: Goodbye}
layout: {panel: video}
"""


def test_references_follow_a_renamed_name() -> None:
    edit = document(TWO_STEPS)
    for name in ("Goodby", "", "Ask", "End", "Farewell"):  # while typing
        edit.set(("protocol", "steps", 1, "title"), name)
        assert bool(edit.mistakes) is (name in ("", "Ask")), name
    changed = TWO_STEPS.replace("to: goodbye", "to: Farewell").replace("title: Goodbye", "title: Farewell")
    assert edit.text == changed.replace("then: Goodbye", "then: Farewell")
    assert [" › ".join(edit.words(each.path)) for each in edit.differences()] == [
        "Protocol › Steps › Ask › Branches › Leaves › Next step",
        "Protocol › Steps › Farewell › Title",
        "Protocol › Steps › Person › Then",
    ]
    edit.undo()
    assert edit.text == TWO_STEPS
    edit.set(("places", 0, "name"), "Gate")
    assert edit.text == TWO_STEPS.replace("Door", "Gate")
    edit.undo()
    edit.set(("protocol", "steps", 2, "id"), "colleague")
    assert edit.text == TWO_STEPS.replace("to: person", "to: colleague").replace("id: person", "id: colleague")
    edit.undo()
    # A step with an id keeps it under another title.
    edit.set(("protocol", "steps", 2, "title"), "Colleague")
    assert edit.text == TWO_STEPS.replace("title: Person", "title: Colleague")


def test_the_last_valid_meaning_is_known_while_there_is_a_mistake() -> None:
    edit = document()
    assert edit.mistakes == ()
    edit.set(("phrases", 1, "key"), "B")
    assert edit.mistakes
    assert edit.scenario is not None
    assert [getattr(each, "say", each) for each in edit.scenario.phrases] == ["Hello", "Bye"]


def test_a_mistake_is_retained_and_reported_with_its_line() -> None:
    edit = document()
    edit.set(("driving", "max_forward_mps"), "fast")
    (mistake,) = edit.mistakes
    assert mistake.path == ("driving", "max_forward_mps")
    assert edit.text.splitlines()[mistake.line - 1] == "driving: {max_forward_mps: fast}"
    assert mistake.message == "'driving.max_forward_mps' must be a number, found 'fast'."
    assert edit.scenario is None
    edit.set(("driving", "max_forward_mps"), 0.25)
    assert not edit.mistakes
    assert edit.scenario is not None
    edit.set(("title",), "")
    # The last valid state.
    assert edit.scenario.title == "Small"


def test_text_that_no_form_can_show_keeps_the_form_as_it_was() -> None:
    edit = document()
    edit.set_text(SMALL.replace("phrases:", "phrases: ["))
    assert edit.unreadable is not None
    assert edit.mistakes == (edit.unreadable,)
    assert edit.unreadable.line > 4
    assert edit.data["phrases"][0] == "Hello"
    edit.set(("title",), "Lost")
    assert "Lost" not in edit.text
    edit.set_text(SMALL.replace("Hello", "Good day"))
    assert (edit.unreadable, edit.data["phrases"][0]) == (None, "Good day")
    edit.undo()
    assert edit.text == SMALL


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        (SMALL.replace("permissions:", "permissions: []\nx:"), 8, "a group of 'key: value' lines is expected here."),
        (SMALL.replace("- Hello", "- [Hello]"), 6, "a group of 'key: value' lines is expected here."),
        (SMALL.replace("version: 1", "version: 99"), 2, "the file has version 99"),
        ("- a\n", 1, "a scenario must be a list of 'key: value' lines, found something else."),
        ("", 1, "the file is empty"),
    ],
)
def test_a_different_structure_is_reported_with_its_line(text: str, line: int, message: str) -> None:
    edit = document()
    edit.set_text(text)
    assert edit.unreadable is not None
    assert edit.unreadable.line == line
    assert edit.unreadable.message.startswith(message)


def test_changes_of_another_writer_stay_next_to_changes_here() -> None:
    edit = document()
    edit.set(("title",), "Mine")
    edit.set(("phrases", 0), "Good morning")
    theirs = SMALL.replace("layout:", "places:\n  - {name: Door, x_m: 1, y_m: 2}   # measured\nlayout:")
    kept = edit.rebase(theirs)
    assert [difference.path for difference in kept] == [("title",), ("phrases", 0)]
    assert edit.text == theirs.replace("title: Small", "title: Mine").replace("- Hello", "- Good morning")
    assert edit.saved_text == theirs
    clean = document()
    clean.rebase(theirs)
    assert (clean.text, clean.changed, clean.to_undo) == (theirs, False, None)


def test_single_fields_are_taken_over_from_another_file() -> None:
    edit = document(SMALL.replace("title: Small", "title: Large").replace("photos: false", "photos: true"))
    other = EditedDocument(SMALL, Path("shipped.yaml"))
    found = list(differences(Scenario, other.data, edit.data))
    assert [(each.path, each.before, each.after) for each in found] == [
        (("title",), "Small", "Large"),
        (("permissions", "photos"), False, True),
    ]
    for each in found:
        edit.replace(each.path, value_at(other.data, each.path))
    assert edit.text == SMALL


def test_a_saved_text_is_what_counts_from_then_on() -> None:
    edit = document()
    edit.set(("title",), "Saved")
    edit.note_saved(edit.text, edit.text, Path("other.yaml"))
    assert (edit.changed, edit.path) == (False, Path("other.yaml"))
    edit.set(("title",), "Later")
    edit.revert()
    assert edit.data["title"] == "Saved"
    edit.undo()
    assert edit.data["title"] == "Later"


def test_typing_while_it_is_saved_is_still_to_be_saved() -> None:
    edit = document()
    edit.set(("title",), "Sent")
    sent = edit.text
    edit.set(("filler",), "Hm")
    edit.note_saved(sent, sent, edit.path)
    assert edit.changed
    assert [difference.path for difference in edit.differences()] == [("filler",)]
    # Also if the written text differs slightly from the sent one.
    edit.note_saved(sent, sent.replace("# By Anna", "# By Anna, a copy"), Path("copy.yaml"))
    assert edit.text.startswith("# By Anna, a copy\n")
    assert (edit.data["title"], edit.data["filler"]) == ("Sent", "Hm")
    assert [difference.path for difference in edit.differences()] == [("filler",)]
