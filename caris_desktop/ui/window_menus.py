"""Menus of the top bar: scenarios, window and panels, robots. Filled on opening."""

from collections.abc import Callable
from pathlib import Path

from PySide6.QtGui import QActionGroup
from PySide6.QtWidgets import QDialog, QDialogButtonBox, QLabel, QLineEdit, QMenu, QVBoxLayout, QWidget

from caris_desktop.domain.intents import SizeClass
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.scenario.scenario_model import PanelName
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.app_context import THEME_WORDS, AppContext
from caris_desktop.ui.layout_store import LayoutStore
from caris_desktop.ui.observer.observer_window import SEES_WORDS
from caris_desktop.ui.panel_manager import PanelManager
from caris_desktop.ui.panel_table import PANELS
from caris_desktop.ui.sound_menu import SoundMenu
from caris_desktop.ui.tab_order import VisualTabOrderMixin
from caris_desktop.ui.text_formatting import in_menu
from caris_desktop.ui.theme import CHOICES, SCALES, Theme, ThemeChoice
from caris_desktop.ui.top_bar import TopBar, as_menu
from caris_desktop.ui.window_appearance import scale_words


class WindowMenus:
    """Menus below the buttons of ``top_bar``."""

    def __init__(self, parts: AppContext, top_bar: TopBar, show_shortcuts: Callable[[], None], window: QWidget) -> None:
        self._parts = parts
        self._top_bar = top_bar
        self._show_shortcuts = show_shortcuts
        self._sound = SoundMenu(parts.console)
        self._layout = LayoutMenu(parts.layout, parts.panels, parts.actions, parts.theme, window)
        parts.layout.changed.connect(self._show_layout_state)
        self._scenario_menu = as_menu(parts.theme, window, "scenario_menu")
        self._window_menu = as_menu(parts.theme, window, "window_menu")
        self._robot_menu = as_menu(parts.theme, window, "robot_menu")
        self._robots_submenu: QMenu | None = None
        parts.scenarios.changed.connect(self._on_files_read)
        parts.robots.choices.changed.connect(self._on_files_read)

    def open_scenario_menu(self) -> None:
        self._fill_scenario_menu()
        self._top_bar.popup_below(self._scenario_menu, self._top_bar.scenario_button)

    def _fill_scenario_menu(self) -> None:
        menu, parts = self._scenario_menu, self._parts
        menu.clear()
        group = QActionGroup(menu)
        current = parts.console.scenario
        for choice in parts.scenarios.now():
            action = menu.addAction(in_menu(choice.title))
            action.setCheckable(True)
            action.setChecked(current.path is not None and choice.path.absolute() == current.path.absolute())
            action.setActionGroup(group)
            action.triggered.connect(self._scenario_opener(choice.path))
        menu.addSeparator()
        menu.addAction(tr("Edit this scenario…")).triggered.connect(parts.editor.open)
        menu.addAction(tr("Import a scenario…")).triggered.connect(parts.scenario_files.choose_import)
        menu.addAction(tr("Export this scenario as one file…")).triggered.connect(parts.scenario_files.choose_share)

    def _on_files_read(self) -> None:
        """Refill open menus after the files on disk were read."""
        if self._scenario_menu.isVisible():
            self._fill_scenario_menu()
        for menu in (self._robot_menu, self._robots_submenu):
            if menu is not None and menu.isVisible():
                self._parts.robots.fill_menu(menu)

    def open_window_menu(self) -> None:
        menu, parts = self._window_menu, self._parts
        menu.clear()
        self._robots_submenu = None
        for submenu in menu.findChildren(QMenu):  # submenus of the last opening
            submenu.deleteLater()
        # One flat list of all panels would be taller than a small screen.
        panels = menu.addMenu(tr("Panels"))
        panels.setObjectName("panels_menu")
        for name in parts.panels.possible():
            action = panels.addAction(tr(PANELS[name].title))
            action.setCheckable(True)
            action.setChecked(parts.panels.is_open(name))
            action.triggered.connect(parts.panels.toggler(name))
        self._layout.fill(menu.addMenu(self._layout.title()))
        if parts.sessions.has_library:
            self._add_sessions(menu)
        menu.addSection(tr("Robot"))
        present = parts.console.state.link.value.robot
        robots = tr("Robot: {name}").format(name=in_menu(present)) if present else tr("Choose a robot")
        self._robots_submenu = menu.addMenu(robots)
        parts.robots.fill_menu(self._robots_submenu)
        self._sound.fill(menu)
        menu.addSection(tr("Appearance"))
        group = QActionGroup(menu)
        # The subject is part of the name: this style draws section titles as bare lines.
        themes = menu.addMenu(tr("Appearance: {theme}").format(theme=tr(THEME_WORDS[parts.theme.choice])))
        for choice in CHOICES:
            action = themes.addAction(tr(THEME_WORDS[choice]))
            action.setCheckable(True)
            action.setChecked(choice == parts.theme.choice)
            action.setActionGroup(group)
            action.triggered.connect(self._theme_chooser(choice))
        self._add_sizes(menu)
        self._add_wizards(menu)
        menu.addSeparator()
        if parts.gamepad.offered:
            menu.addAction(tr("Gamepad…")).triggered.connect(parts.gamepad.open)
        menu.addAction(tr("Practise on the simulated robot")).triggered.connect(parts.practise)
        for sees, text in SEES_WORDS.items():
            menu.addAction(tr(text)).triggered.connect(parts.observers.opener(sees))
        set_up = menu.addAction(tr("Set up…"))
        set_up.setEnabled(parts.actions.available("set_up"))
        set_up.triggered.connect(lambda: parts.actions.run("set_up"))
        menu.addAction(tr("All shortcuts")).triggered.connect(self._show_shortcuts)
        menu.addAction(tr("Help")).triggered.connect(lambda: parts.actions.run("help"))
        menu.addSeparator()
        close = tr("Close the console") if parts.console.state.present.live else tr("Close this window")
        menu.addAction(close).triggered.connect(parts.close_window)
        self._top_bar.popup_below(menu, self._top_bar.window_button)

    def _show_layout_state(self) -> None:
        self._top_bar.show_layout(changed=self._parts.layout.is_unsaved, locked=self._parts.layout.locked)

    def open_robot_menu(self) -> None:
        self._parts.robots.fill_menu(self._robot_menu)
        self._top_bar.popup_below(self._robot_menu, self._top_bar.window_button)

    def _add_sessions(self, menu: QMenu) -> None:
        windows = self._parts.sessions
        menu.addSection(tr("Sessions"))
        menu.addAction(tr("All sessions…")).triggered.connect(windows.open_sessions)
        status = self._parts.console.state.recording.value
        last = menu.addAction(tr("Export the last session…"))
        last.setEnabled(status.folder is not None and status.state in ("idle", "failed"))
        last.triggered.connect(windows.export_last_session)

    def _add_sizes(self, menu: QMenu) -> None:
        appearance = self._parts.appearance
        group = QActionGroup(menu)
        sizes = menu.addMenu(scale_words(appearance.scale))
        for scale in SCALES:
            action = sizes.addAction(scale_words(scale))
            action.setCheckable(True)
            action.setChecked(scale == appearance.scale)
            action.setActionGroup(group)
            action.triggered.connect(self._scale_chooser(scale))

    def _scale_chooser(self, scale: str) -> Callable[[], None]:
        return lambda: self._parts.appearance.choose_scale(scale)

    def _add_wizards(self, menu: QMenu) -> None:
        """Add the choice of the wizard."""
        wizards = self._parts.wizards
        group = QActionGroup(menu)
        current = wizards.current
        names = menu.addMenu(
            tr("Wizard: {name}").format(name=in_menu(current)) if current else tr("Who is the wizard?")
        )
        for name in (*wizards.names, ""):
            action = names.addAction(in_menu(name) or tr("Not specified"))
            action.setCheckable(True)
            action.setChecked(name == current)
            action.setActionGroup(group)
            action.triggered.connect(self._wizard_chooser(name))
        names.addSeparator()
        names.addAction(tr("Another wizard…")).triggered.connect(lambda: self._parts.actions.run("choose_wizard"))

    def _wizard_chooser(self, name: str) -> Callable[[], None]:
        return lambda: self._parts.wizards.choose(name)

    def _scenario_opener(self, path: Path) -> Callable[[], None]:
        return lambda: self._parts.open_scenario(path)

    def _theme_chooser(self, choice: ThemeChoice) -> Callable[[], None]:
        return lambda: self._parts.appearance.choose_theme(choice)


_LONGEST_TITLE = 80
_UNDO_AND_REDO = 2
_SIZES: dict[SizeClass, str] = {
    "compact": QT_TR_NOOP("For a small screen"),
    "usual": QT_TR_NOOP("For a medium-sized screen"),
    "large": QT_TR_NOOP("For a large screen"),
}


class LayoutMenu:
    """Fills a menu each time it opens."""

    def __init__(
        self, keeper: LayoutStore, board: PanelManager, actions: Actions, theme: Theme, window: QWidget
    ) -> None:
        self._keeper = keeper
        self._actions = actions
        self._board = board
        self._theme = theme
        self._window = window
        keeper.title_requested.connect(self._ask_title)

    def title(self) -> str:
        return tr("Layout (changed, not saved)") if self._keeper.is_unsaved else tr("Layout")

    def fill(self, menu: QMenu) -> None:
        keeper = self._keeper
        menu.setObjectName("layout_menu")
        # Some styles do not show section titles.
        menu.addAction(tr(_SIZES[keeper.kind])).setEnabled(False)
        menu.addSeparator()
        for number, command in enumerate(keeper.commands()):
            if number == _UNDO_AND_REDO:
                menu.addSeparator()
            key = self._actions.key_text(command.action) if command.action else ""
            action = menu.addAction("\t".join(part for part in (in_menu(command.text), key) if part))
            action.setEnabled(command.possible)
            action.triggered.connect(keeper.soon(command.do))
        menu.addSeparator()
        focused = self._focused_panel()
        if focused is not None:
            self._board.fill_panel_menu(menu.addMenu(tr("Focused panel")), focused)
        locked = menu.addAction(tr("Lock for a study"))
        locked.setCheckable(True)
        locked.setChecked(keeper.locked)
        locked.triggered.connect(keeper.set_locked)
        adapts = menu.addAction(tr("Adapt to small and large screens"))
        adapts.setCheckable(True)
        adapts.setChecked(keeper.adapts)
        adapts.triggered.connect(keeper.set_adapts)

    def _focused_panel(self) -> PanelName | None:
        return next((name for name, panel in self._board.panels.items() if panel.active), None)

    def _ask_title(self) -> None:
        dialog = TitleDialog(self._theme, self._window)
        dialog.accepted.connect(lambda: self._keeper.save_as(dialog.title))
        dialog.show()


class TitleDialog(VisualTabOrderMixin, QDialog):
    """Title dialog of a new scenario. Non-modal: the robot can be driven and stopped meanwhile."""

    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(parent)
        self.setObjectName("layout_title_dialog")
        self.setWindowTitle(tr("Save as another scenario"))
        column = QVBoxLayout(self)
        words = QLabel(
            tr(
                "The new scenario contains everything in this one, with the current panel layout. What should it be "
                "called?"
            )
        )
        words.setWordWrap(True)
        self._field = QLineEdit(maxLength=_LONGEST_TITLE)
        self._field.setObjectName("layout_title_field")
        self._field.setAccessibleName(tr("Title of the new scenario"))
        buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Save | QDialogButtonBox.StandardButton.Cancel)
        self._save = buttons.button(QDialogButtonBox.StandardButton.Save)
        self._save.setEnabled(False)
        self._field.textChanged.connect(lambda text: self._save.setEnabled(bool(text.strip())))
        buttons.accepted.connect(self.accept)
        buttons.rejected.connect(self.reject)
        for part in (words, self._field, buttons):
            part.setFont(theme.font())
            column.addWidget(part)
        self.setMinimumWidth(420)
        self.finished.connect(self.deleteLater)

    @property
    def title(self) -> str:
        return " ".join(self._field.text().split())
