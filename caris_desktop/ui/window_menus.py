"""The menus of the top bar: scenarios, the window with its panels, and robots. Each is filled when it opens."""

from collections.abc import Callable
from pathlib import Path

from PySide6.QtGui import QActionGroup
from PySide6.QtWidgets import QMenu, QWidget

from caris_desktop.ui.panel_table import PANELS
from caris_desktop.ui.theme import CHOICES, ThemeChoice
from caris_desktop.ui.top_bar import TopBar, as_menu
from caris_desktop.ui.window_parts import THEME_WORDS, WindowParts


class WindowMenus:
    """They open below the buttons of ``top_bar``."""

    def __init__(
        self, parts: WindowParts, top_bar: TopBar, show_shortcuts: Callable[[], None], window: QWidget
    ) -> None:
        self._parts = parts
        self._top_bar = top_bar
        self._show_shortcuts = show_shortcuts
        self._scenario_menu = as_menu(parts.theme, window, "scenario_menu")
        self._window_menu = as_menu(parts.theme, window, "window_menu")
        self._robot_menu = as_menu(parts.theme, window, "robot_menu")

    def open_scenario_menu(self) -> None:
        menu, parts = self._scenario_menu, self._parts
        menu.clear()
        group = QActionGroup(menu)
        current = parts.console.scenario
        for choice in parts.scenarios():
            action = menu.addAction(choice.title)
            action.setCheckable(True)
            action.setChecked(current.path is not None and choice.path.resolve() == current.path.resolve())
            action.setActionGroup(group)
            action.triggered.connect(self._scenario_opener(choice.path))
        menu.addSeparator()
        menu.addAction("Save this panel layout").triggered.connect(parts.layout.save)
        self._top_bar.popup_below(menu, self._top_bar.scenario_button)

    def open_window_menu(self) -> None:
        menu, parts = self._window_menu, self._parts
        menu.clear()
        menu.addSection("Panels")
        for name in parts.panels.possible():
            action = menu.addAction(PANELS[name].title)
            action.setCheckable(True)
            action.setChecked(parts.panels.is_open(name))
            action.triggered.connect(parts.panels.toggler(name))
        menu.addAction("Put the panels back").triggered.connect(parts.layout.put_back_soon)
        if parts.sessions.has_library:
            self._add_sessions(menu)
        menu.addSection("Robot")
        present = parts.console.state.link.value.robot
        parts.robots.fill_menu(menu.addMenu(f"Robot: {present}" if present else "Choose a robot"))
        menu.addSection("Appearance")
        group = QActionGroup(menu)
        for choice in CHOICES:
            action = menu.addAction(THEME_WORDS[choice])
            action.setCheckable(True)
            action.setChecked(choice == parts.theme.choice)
            action.setActionGroup(group)
            action.triggered.connect(self._theme_chooser(choice))
        menu.addSeparator()
        if parts.gamepad.offered:
            menu.addAction("Gamepad…").triggered.connect(parts.gamepad.open)
        menu.addAction("All shortcuts").triggered.connect(self._show_shortcuts)
        self._top_bar.popup_below(menu, self._top_bar.window_button)

    def open_robot_menu(self) -> None:
        self._parts.robots.fill_menu(self._robot_menu)
        self._top_bar.popup_below(self._robot_menu, self._top_bar.window_button)

    def _add_sessions(self, menu: QMenu) -> None:
        windows = self._parts.sessions
        menu.addSection("Sessions")
        menu.addAction("All sessions…").triggered.connect(windows.open_sessions)
        status = self._parts.console.state.recording.value
        last = menu.addAction("Export the last session…")
        last.setEnabled(status.folder is not None and status.state in ("idle", "failed"))
        last.triggered.connect(windows.export_last_session)

    def _scenario_opener(self, path: Path) -> Callable[[], None]:
        return lambda: self._parts.open_scenario(path)

    def _theme_chooser(self, choice: ThemeChoice) -> Callable[[], None]:
        return lambda: self._parts.choose_theme(choice)
