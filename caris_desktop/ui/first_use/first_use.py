"""First-start sequence, and the settings that record its completion."""

from typing import TYPE_CHECKING

from PySide6.QtCore import QObject
from PySide6.QtWidgets import QWidget

from caris_desktop.domain import intents
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.first_use.drive_hint import DriveHint
from caris_desktop.ui.robot_choice import RobotChooser
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.window_place import Settings

if TYPE_CHECKING:  # imported at first use
    from caris_desktop.ui.first_use.set_up_page import SetUpPage

SET_UP_KEY, DRIVEN_KEY = "first_use/set_up", "first_use/driven"


class FirstUse(QObject):
    """First-start sequence. Without ``settings`` nothing is saved, and nothing opens automatically."""

    def __init__(
        self,
        theme: Theme,
        console: WizardConsole,
        actions: Actions,
        robots: RobotChooser,
        window: QWidget,
        *,
        settings: Settings | None,
    ) -> None:
        super().__init__(window)
        self._theme = theme
        self._console = console
        self._robots = robots
        self._window = window
        self._settings = settings
        self._page: SetUpPage | None = None
        self.hint = DriveHint(theme, console, actions)
        self.hint.driven.connect(self._on_driven)

    def begin(self, *, with_simulated_robot: bool) -> None:
        """Start after the window is shown. With the simulated robot, only the driving hint appears."""
        if with_simulated_robot:
            self._show_how_to_drive()
        elif self._settings is not None and not self._settings.value(SET_UP_KEY, ""):
            self.open()

    def open(self) -> None:
        """Open the set-up page at its beginning."""
        from caris_desktop.ui.first_use.set_up_page import SetUpPage

        if self._page is None:
            self._page = SetUpPage(self._theme, self._window, self._console, self._robots)
            self._page.simulated_wanted.connect(self._on_simulated_wanted)
            self._page.finished.connect(self._on_finished)
        self._page.open_welcome()

    def close(self) -> None:
        """Close the page (Esc)."""
        if self._page is not None:
            self._page.close_overlay()

    def _on_simulated_wanted(self) -> None:
        self._console.do(intents.UseSimulatedRobot())
        self._show_how_to_drive()

    def _on_finished(self, through: bool) -> None:
        self._persist(SET_UP_KEY, "done" if through else "skipped")

    def _show_how_to_drive(self) -> None:
        if self._settings is not None and not self._settings.value(DRIVEN_KEY, ""):
            self.hint.begin()

    def _on_driven(self) -> None:
        self._persist(DRIVEN_KEY, "yes")

    def _persist(self, key: str, value: str) -> None:
        if self._settings is not None:
            self._settings.setValue(key, value)
