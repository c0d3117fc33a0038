"""Scenario editor window: opens it, and confirms before unsaved changes are lost."""

import logging
from functools import partial
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.translation import tr
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.scenario_library import own_file
from caris_desktop.ui.background_reading import read_for
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.window_place import bring_up

if TYPE_CHECKING:  # imported at first use
    from caris_desktop.ui.scenario_editor.editor_window import ScenarioEditor
    from caris_desktop.ui.scenario_editor.saving import Opened

_log = logging.getLogger(__name__)


class ScenarioEditorWindow(QObject):
    """One scenario editor owned by ``window``. Non-modal: the robot can be driven and stopped meanwhile."""

    def __init__(self, theme: Theme, console: WizardConsole, window: QWidget) -> None:
        super().__init__(window)
        self._theme = theme
        self._console = console
        self._window = window
        self.editor: ScenarioEditor | None = None
        self._opening = False

    def open(self) -> None:
        """Edit the current scenario. An open editor is raised with its contents; one of another scenario is closed,
        after a question about unsaved changes.
        """
        from caris_desktop.ui.scenario_editor.saving import opened_as_form

        if self.editor is not None:
            self._show_again(self.editor)
        elif not self._opening:
            self._opening = True
            read_for(self, self._console, partial(opened_as_form, self._console.scenario), self._show, self._on_failed)

    def _show_again(self, editor: "ScenarioEditor") -> None:
        scenario = self._console.scenario
        if editor.document.path == own_file(scenario.path) or editor.document.path == scenario.path:
            bring_up(editor)
        elif editor.unsaved:
            bring_up(editor)
            message = tr("The editor shows a different scenario than “{open}”, and your changes in it are not saved.")
            editor.ask_before_closing(message.format(open=scenario.title), self.open)
        else:
            editor.close()
            self.open()

    def _show(self, found: "tuple[Opened, str]") -> None:
        from caris_desktop.ui.scenario_editor.editor_window import ScenarioEditor

        if not self._opening:
            return  # the window is closing
        self._opening = False
        opened, problem = found
        self.editor = ScenarioEditor(self._theme, self._console, opened, self._window)
        self.editor.closed.connect(self._on_closed)
        if problem:
            self.editor.report_not_read(problem)
        bring_up(self.editor)

    def _on_failed(self, failure: UserFacingError) -> None:
        self._opening = False
        _log.error("the scenario does not open for editing: %s", failure)

    def asks_first(self, *, by_a_person: bool) -> bool:
        """Whether a person closes the main window and is now asked about unsaved changes."""
        if self.editor is None or not by_a_person or not self.editor.unsaved:
            return False
        bring_up(self.editor)
        self.editor.ask_before_closing()
        return True

    def close(self) -> None:
        self._opening = False
        if self.editor is not None:
            self.editor.close()

    def _on_closed(self) -> None:
        if self.editor is not None:
            then = self.editor.after_closing
            self.editor.deleteLater()
            self.editor = None
            if then is not None:
                then()
