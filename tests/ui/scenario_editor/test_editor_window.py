"""Scenario editor: typing, lists, text, undo, comparison, saving, closing, and the preview for the wizard."""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import Qt, QUrl
from PySide6.QtGui import QCloseEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLabel, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.control_definitions import RobotControl
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import RobotPose
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.status import LinkStatus, SavedScenario
from caris_desktop.scenario.scenario_file import load_scenario, user_scenarios_dir
from caris_desktop.ui.scenario_editor.editor_window import ScenarioEditor
from caris_desktop.ui.scenario_editor.form import ListPart
from caris_desktop.ui.scenario_editor.preview import consequences
from caris_desktop.ui.scenario_editor.saving import opened_file
from caris_desktop.ui.theme import Theme
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole

TEXT = """\
# Written by Anna.
version: 1
title: Small   # and good
phrases:
  # the first
  - Hello
  - {say: Bye, key: Ctrl+B}   # the last
places:
  - {name: Door, x_m: 1.00, y_m: 2.00}
permissions:
  photos: true   # they agreed
protocol:
  steps:
    - {title: Greet, minutes: 2, go_to: Door}
layout: {panel: video}
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(TEXT, encoding="utf-8")
    return path


@pytest.fixture
def console(path: Path) -> FakeConsole:
    return FakeConsole(load_scenario(path))


@pytest.fixture
def editor(qtbot: QtBot, theme: Theme, console: FakeConsole, path: Path) -> Iterator[ScenarioEditor]:
    theme.set_choice("dark")
    window = ScenarioEditor(theme, console, opened_file(path))
    qtbot.addWidget(window)
    window.show()
    window.activateWindow()
    qtbot.waitUntil(lambda: QApplication.activeWindow() is window)
    yield window
    console.state.close()


def field(editor: ScenarioEditor, *path: str | int) -> Any:
    found = editor.reveal(path)
    assert found is not None, path
    return found


def type_over(editor: ScenarioEditor, text: str, *path: str | int) -> None:
    line = field(editor, *path).control
    line.selectAll()
    QTest.keyClicks(line, text) if text else QTest.keyClick(line, Qt.Key.Key_Delete)


def list_part(editor: ScenarioEditor, *path: str | int) -> ListPart:
    return next(part for part in editor.findChildren(ListPart) if part.path == path)


def wrong(editor: ScenarioEditor) -> list[str]:
    return [label.text() for label in editor.findChildren(QLabel, "mistake") if label.isVisible()]


def test_typing_is_in_the_file_the_title_and_the_preview_at_once(editor: ScenarioEditor) -> None:
    type_over(editor, "Large", "title")
    assert editor.document.text == TEXT.replace("title: Small", "title: Large")
    assert editor.windowTitle().startswith("Large")
    assert "“Small” → “Large”" in editor.preview.toPlainText()
    type_over(editor, "Good morning", "phrases", 0, "say")
    assert "Good morning" in editor.preview.toPlainText()
    assert "F1" in editor.preview.toPlainText()


def test_bad_input_is_refused_at_its_field_and_nothing_of_it_is_lost(
    editor: ScenarioEditor, console: FakeConsole
) -> None:
    type_over(editor, "fast", "driving", "max_forward_mps")
    assert wrong(editor) == ["“Top forward speed” must be a number, found 'fast'."]
    assert "Line 15: 'driving.max_forward_mps' must be a number" in editor.preview.toPlainText()
    editor.show_page(editor.pages[0])
    editor.save_button.click()
    assert console.named("save_scenario") == []
    assert "Errors to correct first: 1" in editor.notice.text.text()
    # Shown in place with the invalid text.
    assert QApplication.focusWidget() is field(editor, "driving", "max_forward_mps").control
    assert field(editor, "driving", "max_forward_mps").control.text() == "fast"
    type_over(editor, "0,25", "driving", "max_forward_mps")
    assert wrong(editor) == []
    assert editor.document.data["driving"] == {"max_forward_mps": 0.25}
    editor.preview.anchorClicked.emit(QUrl("change:0"))
    assert QApplication.focusWidget() is field(editor, "driving", "max_forward_mps").control


def test_fields_of_a_row_stay_in_line_beside_an_error(editor: ScenarioEditor) -> None:
    type_over(editor, "east", "places", 0, "x_m")
    row = [field(editor, "places", 0, name).control for name in ("name", "x_m", "y_m")]
    assert wrong(editor) == ["“x” must be a number, found 'east'."]
    editor.grab()
    assert len({control.mapTo(editor, control.rect().topLeft()).y() for control in row}) == 1


def test_undo_and_redo_go_over_fields_lists_and_text_alike(editor: ScenarioEditor) -> None:
    type_over(editor, "Large", "title")
    type_over(editor, "Hm", "filler")
    QTest.keyClick(QApplication.focusWidget(), Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
    assert "filler" not in editor.document.data
    assert field(editor, "filler").control.text() == ""
    QTest.keyClick(field(editor, "title").control, Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
    assert editor.document.text == TEXT
    assert not editor.undo_button.isEnabled()
    line = field(editor, "title").control
    QTest.keyClick(line, Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier)
    assert line.text() == "Large"
    editor.revert_button.click()
    assert editor.document.text == TEXT


def test_the_buttons_name_the_step_that_they_undo_or_redo(editor: ScenarioEditor) -> None:
    assert (editor.undo_button.toolTip(), editor.redo_button.isEnabled()) == ("", False)
    type_over(editor, "Large", "title")
    assert editor.undo_button.toolTip() == "Undo: Title"
    editor.show_page(editor.text_page)
    editor.text_page.editor.setPlainText(editor.document.text.replace("Hello", "Good day"))
    editor.undo()
    assert editor.document.text == TEXT.replace("Small", "Large")
    assert (editor.undo_button.toolTip(), editor.redo_button.toolTip()) == ("Undo: Title", "Redo: the text")
    editor.redo_button.click()
    assert "Good day" in editor.document.text
    assert editor.undo_button.toolTip() == "Undo: the text"


def test_entries_are_added_moved_and_taken_out_by_keys(editor: ScenarioEditor) -> None:
    line = field(editor, "phrases", 0, "say").control
    QTest.keyClick(line, Qt.Key.Key_Return)
    QTest.keyClicks(QApplication.focusWidget(), "Between")
    assert editor.document.data["phrases"] == ["Hello", "Between", {"say": "Bye", "key": "Ctrl+B"}]
    QTest.keyClick(QApplication.focusWidget(), Qt.Key.Key_Up, Qt.KeyboardModifier.ControlModifier)
    assert editor.document.data["phrases"][:2] == ["Between", "Hello"]
    assert "\n  - Between\n  # the first\n  - Hello\n" in editor.document.text
    row = list_part(editor, "phrases").rows[0]
    take_out = next(each for each in row.findChildren(QWidget) if each.accessibleName() == "Remove: entry 1")
    take_out.setFocus()
    QTest.keyClick(take_out, Qt.Key.Key_Space)
    assert editor.document.text == TEXT


def test_more_along_with_a_phrase_is_entered_by_pressing_its_key(editor: ScenarioEditor) -> None:
    key = field(editor, "phrases", 0, "key").control
    QTest.keyClick(key, Qt.Key.Key_P, Qt.KeyboardModifier.ControlModifier)
    assert editor.document.data["phrases"][0] == {"say": "Hello", "key": "Ctrl+P"}
    assert "Ctrl+P already has another function: Photo" in editor.preview.toPlainText()
    # Commands of the window without an intent have keys too.
    QTest.keyClick(key, Qt.Key.Key_K, Qt.KeyboardModifier.ControlModifier)
    assert "Ctrl+K already has another function: Find anything" in editor.preview.toPlainText()
    QTest.keyClick(key, Qt.Key.Key_B, Qt.KeyboardModifier.ControlModifier)
    assert [mistake.message for mistake in editor.document.mistakes] == [
        "the key Ctrl+B is already assigned to 'Hello'."
    ]
    # The last valid state is shown, instead of a list without phrases.
    told = editor.preview.toPlainText()
    assert "Hello" in told and "Bye" in told and "No phrases yet" not in told
    key.selectAll()
    QTest.keyClick(key, Qt.Key.Key_Delete)
    assert editor.document.text == TEXT


def test_known_names_are_offered_and_missing_ones_reported(editor: ScenarioEditor, console: FakeConsole) -> None:
    console.state.link.set(LinkStatus("connected", "Simulated robot"))
    console.state.controls.set((RobotControl("volume", "Volume", "slider"), RobotControl("wave", "Wave", "button")))
    gesture = field(editor, "phrases", 0, "gesture")
    offered: QLabel = gesture.findChild(QLabel, "known_names")
    assert offered.accessibleName().startswith("Available: nod, look, wave")
    type_over(editor, "wawe", "phrases", 0, "gesture")
    assert offered.accessibleName().startswith("Unknown: wawe. Available: nod, look, wave")
    assert editor.document.mistakes == (), "another robot may have it"
    assert "Unknown: wawe." in gesture.control.accessibleDescription()
    offered.linkActivated.emit("wave")
    assert editor.document.data["phrases"][0] == {"say": "Hello", "gesture": "wave"}
    assert offered.accessibleName().startswith("Available:") and not offered.isVisible()
    console.state.link.set(LinkStatus("lost"))
    type_over(editor, "bow", "phrases", 0, "gesture")
    assert offered.accessibleName().startswith("Available:"), "nobody knows what the robot has"
    robots = field(editor, "robot").findChild(QLabel, "known_names")
    assert "simulated" in robots.accessibleName() and "tiago" in robots.accessibleName()


def test_a_place_is_where_the_robot_is_now(editor: ScenarioEditor, console: FakeConsole) -> None:
    field(editor, "places", 0, "name")
    here = find(editor, "place_from_robot")
    assert not here.isEnabled()
    console.state.add(RobotPose(clock.now_ns(), None, Pose2D(3.456, -1.0, 1.5708)))
    editor.document.history.changed.emit()
    QTest.mouseClick(here, Qt.MouseButton.LeftButton)
    assert editor.document.data["places"] == [{"name": "Door", "x_m": 3.46, "y_m": -1, "heading_deg": 90}]


def test_switching_off_is_reported_with_all_that_disappears(editor: ScenarioEditor) -> None:
    field(editor, "permissions", "photos").enter(False)
    told = editor.preview.toPlainText()
    assert "Photos is now off. This disappears:" in told
    assert [each.key for each in consequences("photos") if each.words == "Photo"] == ["Ctrl+P"]
    for each in consequences("photos"):
        assert each.words in told
    assert {each.words for each in consequences("driving") if each.sort == "panel"} == {"Drive"}
    # Each list has entries, otherwise the table lacks the permission.
    assert all(consequences(name) for name in ("photos", "driving", "assistant", "face", "robot_controls"))


def test_the_steps_of_the_protocol_are_reported_as_the_strip_has_them(editor: ScenarioEditor) -> None:
    field(editor, "protocol", "steps", 0, "minutes").enter(3)
    told = editor.preview.toPlainText()
    assert "3 min · go to Door" in told
    names = field(editor, "protocol", "steps", 0, "go_to")
    assert [names.control.itemText(number) for number in range(names.control.count())] == ["none", "Door"]
    then = field(editor, "protocol", "steps", 0, "then")
    assert [then.control.itemText(number) for number in range(then.control.count())] == ["not set", "Greet", "End"]
    then.enter("end")
    assert editor.document.data["protocol"]["steps"][0]["then"] == "end"


def test_places_prompts_and_marks_are_reported_as_the_wizard_has_them(editor: ScenarioEditor) -> None:
    type_over(editor, "Gate", "places", 0, "name")
    assert "Alt+1  Gate · used in step Greet" in told_now(editor)
    field(editor, "recording", "lsl")
    editor.document.set(("recording",), {"labels": ["Laughs"], "errors": [{"kind": "Slip", "meaning": "A wrong key."}]})
    editor.document.set(("preflight",), ["The form is signed"])
    told = told_now(editor)
    assert "Shift+F1  Laughs" in told and "F  Slip\nA wrong key." in told and "☐ The form is signed" in told
    field(editor, "assistant", "system_prompt").enter("Be kind.")
    editor.document.set(("assistant", "templates"), [{"name": "Meant", "text": "What is {said}?"}])
    editor.document.set(("assistance",), {"replies": "act", "countdown_s": 5})
    told = told_now(editor)
    assert "Instructions to the model before a question\n“Be kind.”" in told
    assert "Meant: “What is the participant's last utterance?”" in told
    assert "The first reply is said after 5 s, unless the wizard stops it." in told
    field(editor, "permissions", "assistant").enter(False)
    field(editor, "assistant", "system_prompt")
    assert "does not allow the assistant" in told_now(editor)


def told_now(editor: ScenarioEditor) -> str:
    return editor.preview.toPlainText().replace("\N{NO-BREAK SPACE}", " ")


def test_a_step_is_renamed_with_what_leads_to_it_in_one_step(editor: ScenarioEditor) -> None:
    field(editor, "protocol", "steps", 0, "then")
    editor.document.add(("protocol", "steps", 1), {"title": "Wait", "then": "Greet"})
    before = editor.document.text
    type_over(editor, "Welcome", "protocol", "steps", 0, "title")
    assert editor.document.text == before.replace("Greet", "Welcome")
    assert wrong(editor) == []
    editor.undo_button.click()
    assert editor.document.text == before


def test_text_and_form_are_two_sides_of_one_thing(editor: ScenarioEditor) -> None:
    type_over(editor, "Large", "title")
    editor.show_page(editor.text_page)
    code = editor.text_page.editor
    assert code.toPlainText() == editor.document.text
    assert code._changed == {2}
    code.setPlainText(code.toPlainText().replace("- Hello", "- Good day"))
    editor.show_page(editor.pages[1])
    assert field(editor, "phrases", 0, "say").control.text() == "Good day"
    editor.undo()
    assert field(editor, "phrases", 0, "say").control.text() == "Hello"


def test_text_with_a_mistake_leaves_the_form_as_it_was_and_says_where(
    editor: ScenarioEditor, console: FakeConsole
) -> None:
    editor.show_page(editor.text_page)
    broken = TEXT.replace("phrases:", "phrases: [")
    editor.text_page.editor.setPlainText(broken)
    editor.show_page(editor.pages[1])
    assert editor.notice.text.text().startswith("Line 6 of the text: not valid YAML")
    phrase_field = field(editor, "phrases", 0, "say")
    assert (phrase_field.control.text(), phrase_field.control.isEnabled()) == ("Hello", False)
    editor.save()
    assert console.named("save_scenario") == []
    editor.notice.answers[0].click()
    assert editor.stack.currentWidget() is editor.text_page
    assert editor.text_page.editor.toPlainText() == broken
    assert editor.text_page.editor.textCursor().blockNumber() == 5
    editor.undo()
    assert (editor.document.text, editor.notice.isVisible()) == (TEXT, False)


def test_fields_are_taken_over_from_what_it_is_compared_with(editor: ScenarioEditor) -> None:
    type_over(editor, "Large", "title")
    field(editor, "permissions", "photos").enter(False)
    page = editor.compare_page
    editor.show_page(page)
    assert page.choice.itemText(0) == "Saved version"
    assert page.summary.text().startswith("Differences: 2.")
    assert "-title: Small   # and good\n+title: Large   # and good" in page.diff.toPlainText()
    take = [row.findChild(QWidget, "take_value") for row in page.rows]
    assert [each.accessibleName() for each in take if each] == [
        "Take theirs: Title",
        "Take theirs: Permissions › Photos",
    ]
    QTest.mouseClick(take[0], Qt.MouseButton.LeftButton)
    assert editor.document.text == TEXT.replace("photos: true", "photos: false")
    shipped = next(number for number in range(page.choice.count()) if "tour-guide" in page.choice.itemText(number))
    page.choice.setCurrentIndex(shipped)
    page.choice.activated.emit(shipped)
    assert any("Tour guide" in label.text() for row in page.rows for label in row.findChildren(QLabel))


def test_ones_own_file_of_a_shipped_name_is_compared_with_the_shipped_one_first(
    qtbot: QtBot, theme: Theme, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    path = user_scenarios_dir() / "tour-guide.yaml"
    path.parent.mkdir(parents=True)
    shipped = (layouts_dir() / path.name).read_text("utf-8")
    path.write_text(shipped.replace("title: Tour guide", "title: My tour"), "utf-8")
    console = FakeConsole(load_scenario(path))
    editor = ScenarioEditor(theme, console, opened_file(path))
    qtbot.addWidget(editor)
    editor.show()
    page = editor.compare_page
    editor.show_page(page)
    offered = [page.choice.itemText(row) for row in range(page.choice.count())]
    assert offered[:2] == ["tour-guide, built-in version", "Saved version"]
    assert sorted(offered[2:]) == offered[2:] and "tour-guide, built-in version" not in offered[2:]
    assert "-title: Tour guide\n+title: My tour" in page.diff.toPlainText()
    QTest.mouseClick(take_value(page.rows[0]), Qt.MouseButton.LeftButton)
    assert editor.document.text == shipped
    console.state.close()


def take_value(row: QWidget) -> QWidget:
    button = row.findChild(QWidget, "take_value")
    assert button is not None
    return button


def acknowledge(console: FakeConsole, *, problem: str = "", taken: bool = False) -> None:
    text, path, _edited, _replaces = console.named("save_scenario")[-1]
    sha256 = hashlib.sha256(text.encode()).hexdigest()
    saved = SavedScenario(path, problem=problem, taken=taken) if problem else SavedScenario(path, text, sha256)
    console.state.saved_scenario.reset_value(saved)


def test_saving_is_reported_and_what_was_not_saved_stays(
    editor: ScenarioEditor, console: FakeConsole, path: Path
) -> None:
    type_over(editor, "Large", "title")
    QTest.keyClick(editor, Qt.Key.Key_S, Qt.KeyboardModifier.ControlModifier)
    acknowledge(console, problem="The disk is full.")
    assert editor.notice.text.text() == "Not saved: The disk is full. Your changes are still here."
    assert editor.document.changed
    editor.save_button.click()
    assert console.named("save_scenario")[-1][3] == opened_file(path).sha256
    acknowledge(console)
    assert (editor.document.changed, editor.save_button.isEnabled()) == (False, False)
    assert "Saved in" in editor.notice.text.text()
    # The next change replaces the message about saving.
    type_over(editor, "Larger", "title")
    assert not editor.notice.isVisible()
    editor.save_button.click()
    assert console.named("save_scenario")[-1][3] == hashlib.sha256(TEXT.replace("Small", "Large").encode()).hexdigest()


def test_typing_during_a_save_stays(editor: ScenarioEditor, console: FakeConsole) -> None:
    type_over(editor, "Large", "title")
    editor.save_button.click()
    type_over(editor, "Larger", "title")
    # In sequence: a second save would find another file than the one that was loaded.
    editor.save_button.click()
    assert len(console.named("save_scenario")) == 1
    acknowledge(console)
    assert editor.document.data["title"] == "Larger"
    assert editor.document.changed and editor.save_button.isEnabled()


def test_a_refusal_of_the_console_is_reported(
    editor: ScenarioEditor, console: FakeConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(console, "do", lambda _intent: "Nothing is saved in a replay.")
    type_over(editor, "Large", "title")
    editor.save_button.click()
    assert "Nothing is saved in a replay." in editor.notice.text.text()
    assert editor.document.changed


def test_a_copy_gets_a_title_of_its_own(editor: ScenarioEditor, console: FakeConsole) -> None:
    editor.save_as_button.click()
    assert QApplication.focusWidget() is editor.name
    assert editor.name.text() == "Small 2"
    for title in (" ", "x" * 500):
        editor.name.setText(title)
        QTest.keyClick(editor.name, Qt.Key.Key_Return)
        assert console.named("save_scenario") == []
    assert "'title' has 500 characters" in editor.notice.text.text()
    editor.name.setText("../Second  study")
    QTest.keyClick(editor.name, Qt.Key.Key_Return)
    ((text, target, _edited, replaces),) = console.named("save_scenario")
    assert (target, replaces) == (user_scenarios_dir() / "second-study.yaml", "")
    assert text == TEXT.replace("title: Small", "title: ../Second study")
    # If the new name is taken, the present file keeps its title, and another one is requested.
    acknowledge(console, problem="It is there already.", taken=True)
    assert "“second-study.yaml” already contains a scenario" in editor.notice.text.text()
    assert QApplication.focusWidget() is editor.name
    assert editor.document.text == TEXT
    editor.name.setText("Third")
    QTest.keyClick(editor.name, Qt.Key.Key_Return)
    acknowledge(console)
    assert editor.document.path == user_scenarios_dir() / "third.yaml"
    assert (editor.document.data["title"], editor.document.changed) == ("Third", False)
    assert QApplication.focusWidget() is editor.nav


def test_unseen_changes_of_another_writer_are_read_before_saving(
    editor: ScenarioEditor, console: FakeConsole, path: Path
) -> None:
    type_over(editor, "Large", "title")
    path.write_text(TEXT.replace("Hello", "Good morning"), encoding="utf-8")
    editor.save_button.click()
    acknowledge(console, problem="It was changed.", taken=True)
    assert "Not saved yet: the file was changed elsewhere" in editor.notice.text.text()
    assert "It includes your own changes: 1" in editor.notice.text.text()
    editor.save_button.click()
    text, _path, _edited, replaces = console.named("save_scenario")[-1]
    assert text == TEXT.replace("Hello", "Good morning").replace("title: Small", "title: Large")
    assert replaces == opened_file(path).sha256


def test_a_file_that_another_person_broke_is_written_over_only_when_asked(
    editor: ScenarioEditor, console: FakeConsole, path: Path
) -> None:
    type_over(editor, "Large", "title")
    path.write_text(TEXT + "]", encoding="utf-8")
    editor.save_button.click()
    acknowledge(console, problem="It was changed.", taken=True)
    assert "changed elsewhere and cannot be read: line 16: not valid YAML" in editor.notice.text.text()
    assert editor.document.text == TEXT.replace("title: Small", "title: Large")
    over, save_as = editor.notice.answers
    assert (over.text(), save_as.text()) == ("Overwrite", "Save as…")
    over.click()
    text, _path, _edited, replaces = console.named("save_scenario")[-1]
    assert (text, replaces) == (editor.document.text, opened_file(path).sha256)


def test_the_comparison_is_with_the_last_save(editor: ScenarioEditor, console: FakeConsole) -> None:
    type_over(editor, "Large", "title")
    editor.show_page(editor.compare_page)
    assert len(editor.compare_page.rows) == 1
    editor.save_button.click()
    acknowledge(console)
    assert editor.compare_page.rows == []
    assert editor.compare_page.summary.text() == "Both are identical."


def test_unsaved_changes_are_asked_about_before_closing(
    editor: ScenarioEditor, console: FakeConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(QCloseEvent, "spontaneous", lambda _event: True)
    type_over(editor, "Large", "title")
    assert not editor.close()
    assert editor.notice.text.text() == "Your changes are not saved."
    go_on = editor.notice.answers[2]
    go_on.click()
    assert editor.isVisible() and editor.document.changed
    editor.close()
    editor.notice.answers[0].click()
    assert editor.isVisible()
    acknowledge(console)
    assert not editor.isVisible()


def test_thrown_away_it_closes(editor: ScenarioEditor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(QCloseEvent, "spontaneous", lambda _event: True)
    type_over(editor, "Large", "title")
    editor.close()
    editor.notice.answers[1].click()
    assert not editor.isVisible()


def test_a_place_that_the_console_saves_meanwhile_stays(
    editor: ScenarioEditor, console: FakeConsole, path: Path
) -> None:
    type_over(editor, "Large", "title")
    theirs = TEXT.replace("permissions:", "  - {name: Window, x_m: 3, y_m: 4}\npermissions:")
    path.write_text(theirs, encoding="utf-8")
    console.state.scenario.reset_value(load_scenario(path))
    assert editor.document.text == theirs.replace("title: Small", "title: Large")
    assert editor.document.saved_text == theirs
    assert editor.notice.isVisible()
    editor.save_button.click()
    assert console.named("save_scenario")[-1][3] == opened_file(path).sha256


def test_a_place_that_comes_while_the_disk_is_slow_is_read_once_nothing_is_being_saved(
    editor: ScenarioEditor, console: FakeConsole, path: Path
) -> None:
    type_over(editor, "Large", "title")
    theirs = TEXT.replace("permissions:", "  - {name: Window, x_m: 3, y_m: 4}\npermissions:")
    path.write_text(theirs, encoding="utf-8")
    console.disk_is_slow = True
    console.state.scenario.reset_value(load_scenario(path))
    console.scenario = load_scenario(path)
    assert "Window" not in editor.document.text
    editor.save_button.click()
    console.answer_of_disk()
    assert "Window" not in editor.document.text, "what is being saved was made from the file before"
    acknowledge(console, problem="The file has changed.")
    console.answer_of_disk()
    assert editor.document.text == theirs.replace("title: Small", "title: Large")


def test_everything_can_be_reached_and_heard_without_a_mouse(editor: ScenarioEditor) -> None:
    for page in editor.pages:
        page.build()
    focusable = [each for each in editor.findChildren(QWidget) if each.focusPolicy() & Qt.FocusPolicy.TabFocus]
    own = [each for each in focusable if type(each).__module__.startswith("caris_desktop")]
    assert len(own) > 60
    assert [f"{type(each).__name__} {each.objectName()}" for each in own if not each.accessibleName()] == []
    editor.show_page(editor.pages[0])
    first, second = field(editor, "description").control, field(editor, "title").control
    QTest.keyClick(second, Qt.Key.Key_Tab)
    assert QApplication.focusWidget() is first
