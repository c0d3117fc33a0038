"""Painted rows in the accessibility interface: each visible row with text, state and press action."""

from collections.abc import Iterator

import pytest
from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QAccessible, QAccessibleInterface
from PySide6.QtWidgets import QApplication, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.ui.conversation.transcript_view import TranscriptView
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.palette.command_palette import CommandPalette
from caris_desktop.ui.panels.conversation_panel import ConversationPanel
from caris_desktop.ui.panels.people_panel import PeoplePanel
from tests.ui import samples
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole


def told(root: QWidget, *roles: QAccessible.Role) -> Iterator[QAccessibleInterface]:
    """Visible accessible interfaces below ``root``."""
    interface = QAccessible.queryAccessibleInterface(root)
    assert interface is not None
    yield from _below(interface, roles)


def _below(node: QAccessibleInterface, roles: tuple[QAccessible.Role, ...]) -> Iterator[QAccessibleInterface]:
    for number in range(node.childCount()):
        child = node.child(number)
        if child is None or not child.isValid() or child.state().invisible:
            continue
        if not roles or child.role() in roles:
            yield child
        yield from _below(child, roles)


def name(node: QAccessibleInterface) -> str:
    return node.text(QAccessible.Text.Name)


def press(node: QAccessibleInterface, act: str = "Press") -> None:
    acts = node.actionInterface()
    assert acts is not None
    acts.doAction(act)


def test_the_lines_of_the_palette_are_found_with_kind_and_key_and_can_be_chosen(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    qtbot.keyClick(window, Qt.Key.Key_K, Qt.KeyboardModifier.ControlModifier)
    palette = window.findChild(CommandPalette)
    assert palette is not None
    palette.field.setText("photo")
    lines = list[QAccessibleInterface]()

    def shown() -> bool:
        lines[:] = told(palette.list, QAccessible.Role.ListItem)
        return len(lines) == min(9, len(palette.list.entries))

    qtbot.waitUntil(shown)
    entries = palette.list.entries
    assert [name(line) for line in lines] == [entry.spoken for entry in entries[: len(lines)]]
    assert all(
        entry.kind in name(line) and entry.key in name(line) for line, entry in zip(lines, entries, strict=False)
    )
    assert [bool(line.state().selected) for line in lines[:2]] == [True, False]
    tops = [line.rect().top() for line in lines]
    assert tops == sorted(set(tops)) and all(line.rect().height() == 40 for line in lines)
    photo = next(line for line in lines if name(line).startswith("Photo"))
    assert entries[lines.index(photo)].key in name(photo) and entries[lines.index(photo)].key
    press(lines[1], "Toggle")
    assert palette.list.current is entries[1]
    assert palette.field.accessibleDescription() == entries[1].spoken
    press(photo, "Toggle")
    qtbot.keyClick(palette.field, Qt.Key.Key_Return)
    assert console.named("take_photo") and palette.isHidden()


def test_the_rows_of_people_are_complete_and_their_buttons_can_be_pressed(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    panel = window.findChild(PeoplePanel)
    assert panel is not None
    rows = list(told(panel, QAccessible.Role.Cell))
    persons = panel.model.persons
    assert len(rows) >= 2
    for row, person in zip(rows, persons, strict=False):
        assert all(word in name(row) for word in (person.group, *person.tags, panel.model.seen(person)))
    wanted = panel.list.buttons(0)
    assert wanted
    for spec, control in zip(wanted, panel.list.controls[persons[0].person_id].buttons.values(), strict=True):
        button = next(one for one in told(panel, QAccessible.Role.Button) if name(one) == spec.tip)
        assert button.rect().topLeft() == control.mapToGlobal(control.rect().topLeft())
        assert (
            panel.list.viewport()
            .visibleRegion()
            .contains(control.mapTo(panel.list.viewport(), control.rect().center()))
        )
    meant = next(one for one in told(panel, QAccessible.Role.Button) if name(one).startswith("Select "))
    press(meant)
    qtbot.waitUntil(lambda: console.named("attend_person") == [persons[0].person_id])


def test_the_turns_are_found_complete_and_can_be_chosen(window: MainWindow, console: FakeConsole, qtbot: QtBot) -> None:
    window.open_panel("conversation")
    samples.converse(console)
    panel, transcript = window.findChild(ConversationPanel), window.findChild(TranscriptView)
    assert panel is not None and transcript is not None and transcript.rows

    def shown() -> bool:
        found = {name(one) for one in told(transcript, QAccessible.Role.ListItem)}
        return {transcript.rows[row].spoken for row in transcript.visible_rows()} <= found

    qtbot.waitUntil(shown)
    last = transcript.rows[max(transcript.visible_rows())]
    assert last.time in last.spoken and last.who in last.spoken and last.words in last.spoken
    turn = next(one for one in told(transcript) if name(one) == last.spoken)
    press(turn, "Toggle")
    qtbot.waitUntil(lambda: transcript.current == last.utterance_id)
    # Actions on the current turn are found and pressed in the same way.
    qtbot.waitUntil(lambda: any(name(one).startswith("Tags (T)") for one in told(panel)))
    press(next(one for one in told(panel) if name(one).startswith("Tags (T)")))
    qtbot.waitUntil(lambda: transcript.writing)


@pytest.mark.usefixtures("screen_reader")
def test_video_and_map_describe_their_contents(window: MainWindow, console: FakeConsole, qtbot: QtBot) -> None:
    video, plan = find(window, "video_view"), find(window, "map_view")
    qtbot.waitUntil(lambda: "The robot is at 6.5 m, 3.5 m." in plan.accessibleDescription())
    assert "Places: " in plan.accessibleDescription() and "Robot arm" in plan.accessibleDescription()
    qtbot.waitUntil(lambda: "Luis" in video.accessibleDescription() or "Nobody" in video.accessibleDescription())


@pytest.mark.panels("video", "speak", "people")
def test_people_are_reported_and_have_their_card_wherever_the_panel_is(window: MainWindow) -> None:
    """Its floating window is deleted on docking, with PySide's references to its parts."""
    panel = window.findChild(PeoplePanel)
    assert panel is not None
    person_id = panel.model.persons[0].person_id
    for _ in range(3):
        window.dock_host.toggle_floating("people")
        QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete.value)
        assert any(name(one).startswith("Select ") for one in told(panel, QAccessible.Role.Button))
        panel.open_card(person_id)
        assert panel.card is not None and panel.card.isVisible()
        panel.card.close_card()
