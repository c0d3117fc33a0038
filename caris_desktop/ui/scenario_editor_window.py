"""Opens the window in which the scenario is edited, and asks before what was changed in it goes."""

from typing import TYPE_CHECKING

from PySide6.QtCore import QObject
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.yaml_writing import yaml_text
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.file import scenario_data
from caris_desktop.scenario.library import own_file
from caris_desktop.ui.session_windows import bring_up
from caris_desktop.ui.theme import Theme

if TYPE_CHECKING:  # imported when it is first opened
    from caris_desktop.ui.scenario_editor.window import Opened, ScenarioEditor


class ScenarioEditorWindow(QObject):
    """One editor beside ``window``. It is not modal: the robot can be driven and stopped meanwhile."""

    def __init__(self, theme: Theme, console: WizardConsole, window: QWidget) -> None:
        super().__init__(window)
        self._theme = theme
        self._console = console
        self._window = window
        self._editor: ScenarioEditor | None = None

    @property
    def editor(self) -> "ScenarioEditor | None":
        return self._editor

    def open(self) -> None:
        """Edit the scenario in force. An editor that is open already comes to the front with what is in it."""
        from caris_desktop.ui.scenario_editor.window import ScenarioEditor

        if self._editor is None:
            opened, problem = self._opened()
            self._editor = ScenarioEditor(self._theme, self._console, opened, self._window)
            self._editor.closed.connect(self._on_closed)
            if problem:
                self._editor.tell_not_read(problem)
        bring_up(self._editor)

    def _opened(self) -> "tuple[Opened, str]":
        """The file of the scenario in force; where that cannot be read, what is in force, and why."""
        from caris_desktop.ui.scenario_editor.window import Opened, opened_file, shows_as_form

        scenario = self._console.scenario
        problem, sha256 = "", ""
        if scenario.path is not None:
            try:
                opened = opened_file(scenario.path)
                sha256 = opened.sha256
                shows_as_form(opened)
            except (OSError, ValueError) as error:
                problem = str(error)
            else:
                return opened, ""
        path = scenario.path if scenario.path is not None else own_file(None)
        return Opened(path, yaml_text(scenario_data(scenario)), sha256), problem

    def asks_first(self, event: QCloseEvent) -> bool:
        """Whether a person closes the main window, and is now asked about what was changed here and not saved."""
        if self._editor is None or not event.spontaneous() or not self._editor.unsaved:
            return False
        bring_up(self._editor)
        self._editor.ask_before_closing()
        return True

    def close(self) -> None:
        if self._editor is not None:
            self._editor.close()

    def _on_closed(self) -> None:
        if self._editor is not None:
            self._editor.deleteLater()
            self._editor = None
