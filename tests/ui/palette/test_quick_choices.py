"""Quick choices by two keys: one opens the list, a digit selects."""

import dataclasses

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from caris_desktop.people.presence import PersonRow
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.palette.command_palette import CommandPalette
from caris_desktop.ui.palette.palette_entries import nearest_person
from tests.ui import samples
from tests.ui.fake_console import FakeConsole

HERE = PersonRow("a", 1, "Person 1", here=True, since_ns=5, last_seen_ns=9)


def row(person_id: str, **more: object) -> PersonRow:
    return dataclasses.replace(HERE, person_id=person_id, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("persons", "selected", "expected"),
    [
        ([], "", None),
        ([row("gone", here=False)], "gone", None),
        ([row("far", distance_m=4.0), row("near", distance_m=1.0)], "", "near"),
        ([row("far", distance_m=4.0), row("near", distance_m=1.0)], "far", "far"),
        ([row("unknown", distance_m=4.0), row("named", distance_m=1.0, name="Ana", known=True)], "", "unknown"),
        ([row("aside", bearing_rad=1.0), row("ahead", bearing_rad=-0.1)], "", "ahead"),
        ([row("later", since_ns=8), row("longest")], "", "longest"),
    ],
)
def test_the_nearest_person(persons: list[PersonRow], selected: str, expected: str | None) -> None:
    person = nearest_person(persons, selected=selected)
    assert (None if person is None else person.person_id) == expected


def test_a_digit_chooses_only_while_nothing_is_typed(window: MainWindow, console: FakeConsole) -> None:
    palette = window.findChild(CommandPalette)
    assert palette is not None
    window.actions_table.run("choose_place")
    names = [place.name for place in samples.TOUR.places]
    assert [(entry.text, entry.key) for entry in palette.list.entries] == [
        (f"Go to {name}", str(number)) for number, name in enumerate(names, start=1)
    ]
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert console.named("go_to_place") == [], "nothing is chosen beforehand, and Enter alone drives nowhere"
    QTest.keyClicks(palette.field, f"{names[2][:3]}1")
    assert console.named("go_to_place") == []
    palette.field.clear()
    QTest.keyClick(palette.field, Qt.Key.Key_9)
    assert palette.isVisible(), "there is no ninth place"
    palette.field.clear()
    QTest.keyClick(palette.field, Qt.Key.Key_3)
    assert console.named("go_to_place") == [names[2]]
    assert not palette.isVisible()
    window.actions_table.run("choose_scenario")
    assert {entry.text for entry in palette.list.entries} == {
        "Open scenario Tour guide",
        "Open scenario Mental health check",
    }
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert console.named("open_scenario") == [], "Enter alone does not begin the present scenario anew"
    QTest.keyClicks(palette.field, "mental")
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert console.named("open_scenario") == [samples.MENTAL.path]


def test_a_letter_and_enter_choose_where_the_list_says_what_is_done(window: MainWindow, console: FakeConsole) -> None:
    palette = window.findChild(CommandPalette)
    assert palette is not None
    window.actions_table.run("choose_place")
    QTest.keyClicks(palette.field, "k")
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert console.named("go_to_place") == ["Kitchen"]


def test_a_digit_typed_into_find_anything_is_a_digit(window: MainWindow, console: FakeConsole) -> None:
    palette = window.findChild(CommandPalette)
    assert palette is not None
    window.actions_table.run("choose_place")
    window.hold.escape_pressed.emit()
    window.show_command_palette()
    QTest.keyClick(palette.field, Qt.Key.Key_2)
    assert palette.field.text() == "2"
    assert console.named("go_to_place") == []


def test_without_places_there_is_no_key_for_them(window: MainWindow, console: FakeConsole) -> None:
    assert window.actions_table.spec("choose_place") is not None
    console.state.places.set(())
    assert window.actions_table.spec("choose_place") is None
