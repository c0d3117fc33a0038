"""Each field of each shipped scenario in the form: saving changes only that field's lines."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from PySide6.QtWidgets import QApplication

from caris_desktop.domain.schema_fields import KeyPath, ValueForm, keys_of
from caris_desktop.domain.schema_paths import ABSENT
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.status import SavedScenario
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui.scenario_editor.editor_window import ScenarioEditor
from caris_desktop.ui.scenario_editor.pages import sections
from caris_desktop.ui.scenario_editor.saving import EditedDocument, opened_file
from caris_desktop.ui.theme import Theme
from tests.support.scenario_edits import assert_only_that_field_changed, edited_leaves, other_value, sampled
from tests.ui.fake_console import FakeConsole

__all__ = ["sampled"]  # a fixture
SHIPPED = sorted(layouts_dir().glob("*.yaml"))


@pytest.fixture(scope="module")
def theme(qapp: QApplication) -> Theme:
    return Theme(qapp, "dark")


@pytest.fixture(scope="module", params=SHIPPED, ids=lambda path: path.stem)
def editor(
    request: pytest.FixtureRequest, theme: Theme, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ScenarioEditor]:
    """One window for all fields of a scenario in a user's file."""
    own = tmp_path_factory.mktemp("own") / request.param.name
    own.write_bytes(request.param.read_bytes())
    console = FakeConsole(load_scenario(own))
    window = ScenarioEditor(theme, console, opened_file(own))
    window.show()
    yield window
    console.state.close()
    window.deleteLater()


def saved_text(editor: ScenarioEditor) -> str:
    """Text that the editor saves."""
    console = editor._console
    assert isinstance(console, FakeConsole)
    console.calls.clear()
    editor.save_button.click()
    ((text, path, edited, replaces),) = console.named("save_scenario")
    assert (path, edited, replaces) == (editor.document.path, editor.document.path, console.scenario.sha256)
    # The save fails, so that the next field is changed in the same file.
    console.state.saved_scenario.reset_value(SavedScenario(path, problem="It is only looked at."))
    return str(text)


@pytest.mark.long("reception", "practice", "mental-health-check")
def test_each_field_is_in_the_form_and_changes_its_own_lines_alone(
    editor: ScenarioEditor, sampled: Callable[[list[tuple[KeyPath, ValueForm]]], list[tuple[KeyPath, ValueForm]]]
) -> None:
    text = editor.document.text
    judge = EditedDocument(text, editor.document.path)
    for path, form in sampled(edited_leaves(judge)):
        field = editor.reveal(path)
        assert field is not None and field.path == path, path
        value = other_value(judge, path, form)
        if value is ABSENT:
            # Only valid together with another value, as a referenced name.
            continue
        field.enter(value)
        assert_only_that_field_changed(judge, saved_text(editor), path, value)
        editor.undo()
        assert editor.document.text == text, path


def test_every_key_of_the_file_has_its_place_in_the_form() -> None:
    placed = [key.name for section in sections() for key in section.keys]
    assert sorted(placed) == sorted(key.name for key in keys_of(Scenario) if key.name != "version")
    assert placed.index("title") < placed.index("phrases") < placed.index("protocol") < placed.index("places")
    assert all(section.words for section in sections())


def test_shipped_files_are_written_only_as_a_copy_of_ones_own(theme: Theme, isolated_settings: Path) -> None:
    shipped = SHIPPED[-1]
    console = FakeConsole(load_scenario(shipped))
    window = ScenarioEditor(theme, console, opened_file(shipped))
    window.document.set(("title",), "Mine")
    window.save()
    ((text, path, edited, replaces),) = console.named("save_scenario")
    assert "title: Mine" in text
    assert (path.is_relative_to(isolated_settings), path.name, edited, replaces) == (True, shipped.name, shipped, "")
    console.state.close()
    window.deleteLater()
