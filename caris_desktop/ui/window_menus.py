"""Menus of the top bar: scenarios, window and panels, robots. Filled on opening, from parts of the window."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from PySide6.QtWidgets import QDialogButtonBox, QMenu, QWidget

from caris_desktop.domain.intents import SizeClass
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.background_reading import Remembered
from caris_desktop.ui.form_dialog import FormDialog
from caris_desktop.ui.layout_store import LayoutStore
from caris_desktop.ui.menus import add_choices, add_sound_menus, add_switch
from caris_desktop.ui.observer_window import SEES_WORDS, ObserverWindows
from caris_desktop.ui.panel_manager import PanelManager
from caris_desktop.ui.panel_table import PANELS
from caris_desktop.ui.preferences import WizardProfiles
from caris_desktop.ui.scenario_files import ScenarioFiles
from caris_desktop.ui.text_formatting import in_menu
from caris_desktop.ui.theme import CHOICES, SCALES, Theme, ThemeChoice
from caris_desktop.ui.top_bar import TopBar, as_menu
from caris_desktop.ui.widgets.labels import label, line_edit
from caris_desktop.ui.window_appearance import Appearance, scale_words
from caris_desktop.ui.windows import GamepadWindow, RobotChooser, ScenarioEditorWindow, SessionWindows

THEME_WORDS: dict[ThemeChoice, str] = {
    "system": QT_TR_NOOP("Same as system"),
    "dark": QT_TR_NOOP("Dark"),
    "light": QT_TR_NOOP("Light"),
}


class AppContext(Value):
    console: WizardConsole
    theme: Theme
    actions: Actions
    panels: PanelManager
    layout: LayoutStore
    sessions: SessionWindows
    robots: RobotChooser
    gamepad: GamepadWindow
    editor: ScenarioEditorWindow
    wizards: WizardProfiles
    scenarios: Remembered  # of ScenarioChoice
    open_scenario: Callable[[Path], None]
    appearance: Appearance
    practise: Callable[[], None]
    scenario_files: ScenarioFiles
    observers: ObserverWindows
    close_window: Callable[[], None]


_LONGEST_TITLE = 80
_UNDO_AND_REDO = 2
_SIZES: dict[SizeClass, str] = {
    "compact": QT_TR_NOOP("For a small screen"),
    "usual": QT_TR_NOOP("For a medium-sized screen"),
    "large": QT_TR_NOOP("For a large screen"),
}


class WindowMenus:
    """Menus below the buttons of ``top_bar``."""

    def __init__(self, parts: AppContext, top_bar: TopBar, show_shortcuts: Callable[[], None], window: QWidget) -> None:
        self._parts = parts
        self._top_bar = top_bar
        self._show_shortcuts = show_shortcuts
        self._window = window
        layout = parts.layout
        layout.changed.connect(lambda: top_bar.show_layout(changed=layout.is_unsaved, locked=layout.locked))
        parts.layout.title_requested.connect(self._ask_title)
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
        path = parts.console.scenario.path
        current = None if path is None else path.absolute()
        add_choices(
            menu,
            (
                (in_menu(choice.title), choice.path.absolute() == current, partial(parts.open_scenario, choice.path))
                for choice in parts.scenarios.now()
            ),
        )
        menu.addSeparator()
        menu.addAction(tr("Edit this scenario…"), parts.editor.open)
        menu.addAction(tr("Import a scenario…"), parts.scenario_files.choose_import)
        menu.addAction(tr("Export this scenario as one file…"), parts.scenario_files.choose_share)

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
            set_open = partial(parts.panels.set_open, name)
            add_switch(panels, tr(PANELS[name].title), parts.panels.is_open(name), set_open)
        self.fill_layout_menu(menu.addMenu(self.layout_title()))
        if parts.sessions.has_library:
            self._add_sessions(menu)
        menu.addSection(tr("Robot"))
        present = parts.console.state.link.value.robot
        robots = tr("Robot: {name}").format(name=in_menu(present)) if present else tr("Choose a robot")
        self._robots_submenu = menu.addMenu(robots)
        parts.robots.fill_menu(self._robots_submenu)
        add_sound_menus(parts.console, menu)
        self._add_appearance(menu)
        self._add_wizards(menu)
        menu.addSeparator()
        if parts.gamepad.offered:
            menu.addAction(tr("Gamepad…"), parts.gamepad.open)
        menu.addAction(tr("Practise on the simulated robot"), parts.practise)
        for sees, text in SEES_WORDS.items():
            menu.addAction(tr(text), partial(parts.observers.open, sees))
        set_up = menu.addAction(tr("Set up…"), partial(parts.actions.run, "set_up"))
        set_up.setEnabled(parts.actions.available("set_up"))
        menu.addAction(tr("All shortcuts"), self._show_shortcuts)
        menu.addAction(tr("Help"), partial(parts.actions.run, "help"))
        menu.addSeparator()
        close = tr("Close the console") if parts.console.state.present.live else tr("Close this window")
        menu.addAction(close, parts.close_window)
        self._top_bar.popup_below(menu, self._top_bar.window_button)

    def open_robot_menu(self) -> None:
        self._parts.robots.fill_menu(self._robot_menu)
        self._top_bar.popup_below(self._robot_menu, self._top_bar.window_button)

    def _add_sessions(self, menu: QMenu) -> None:
        windows = self._parts.sessions
        menu.addSection(tr("Sessions"))
        menu.addAction(tr("All sessions…"), windows.open_sessions)
        status = self._parts.console.state.recording.value
        last = menu.addAction(tr("Export the last session…"), windows.export_last_session)
        last.setEnabled(status.folder is not None and status.state in ("idle", "failed"))

    def _add_appearance(self, menu: QMenu) -> None:
        appearance, current = self._parts.appearance, self._parts.theme.choice
        menu.addSection(tr("Appearance"))
        # The subject is part of the name: this style draws section titles as bare lines.
        add_choices(
            menu.addMenu(tr("Appearance: {theme}").format(theme=tr(THEME_WORDS[current]))),
            (
                (tr(THEME_WORDS[choice]), choice == current, partial(appearance.choose_theme, choice))
                for choice in CHOICES
            ),
        )
        add_choices(
            menu.addMenu(scale_words(appearance.scale)),
            (
                (scale_words(scale), scale == appearance.scale, partial(appearance.choose_scale, scale))
                for scale in SCALES
            ),
        )

    def _add_wizards(self, menu: QMenu) -> None:
        """Add the choice of the wizard."""
        wizards = self._parts.wizards
        current = wizards.current
        names = menu.addMenu(
            tr("Wizard: {name}").format(name=in_menu(current)) if current else tr("Who is the wizard?")
        )
        add_choices(
            names,
            (
                (in_menu(name) or tr("Not specified"), name == current, partial(wizards.choose, name))
                for name in (*wizards.names, "")
            ),
        )
        names.addSeparator()
        names.addAction(tr("Another wizard…"), partial(self._parts.actions.run, "choose_wizard"))

    def layout_title(self) -> str:
        return tr("Layout (changed, not saved)") if self._parts.layout.is_unsaved else tr("Layout")

    def fill_layout_menu(self, menu: QMenu) -> None:
        keeper, board = self._parts.layout, self._parts.panels
        menu.setObjectName("layout_menu")
        # Some styles do not show section titles.
        menu.addAction(tr(_SIZES[keeper.kind])).setEnabled(False)
        menu.addSeparator()
        for number, command in enumerate(keeper.commands()):
            if number == _UNDO_AND_REDO:
                menu.addSeparator()
            key = self._parts.actions.key_text(command.action) if command.action else ""
            action = menu.addAction("\t".join(part for part in (in_menu(command.text), key) if part))
            action.setEnabled(command.possible)
            action.triggered.connect(keeper.soon(command.do))
        menu.addSeparator()
        focused = next((name for name, panel in board.panels.items() if panel.active), None)
        if focused is not None:
            board.docks.fill_menu(menu.addMenu(tr("Focused panel")), focused)
        add_switch(menu, tr("Lock for a study"), keeper.locked, keeper.set_locked)
        add_switch(menu, tr("Adapt to small and large screens"), keeper.adapts, keeper.set_adapts)

    def _ask_title(self) -> None:
        dialog = TitleDialog(self._parts.theme, self._window)
        dialog.accepted.connect(lambda: self._parts.layout.save_as(dialog.title))
        dialog.show()


class TitleDialog(FormDialog):
    """Title dialog of a new scenario."""

    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(theme, parent, "layout_title_dialog", tr("Save as another scenario"))
        words = tr(
            "The new scenario contains everything in this one, with the current panel layout. What should it be called?"
        )
        buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Save | QDialogButtonBox.StandardButton.Cancel)
        save = buttons.button(QDialogButtonBox.StandardButton.Save)
        save.setEnabled(False)
        self._field = line_edit(
            "layout_title_field", tr("Title of the new scenario"), maxLength=_LONGEST_TITLE,
            textChanged=lambda text: save.setEnabled(bool(text.strip())),
        )  # fmt: skip
        buttons.accepted.connect(self.accept)
        buttons.rejected.connect(self.reject)
        layouts.vbox(self, label(words, wraps=True), self._field, buttons)
        self.setMinimumWidth(420)

    @property
    def title(self) -> str:
        return " ".join(self._field.text().split())
