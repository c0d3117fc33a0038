"""The console's window: top bar, dock panels, status bar, and what the actions of the table do."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from PySide6.QtCore import QEvent, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QActionGroup, QCloseEvent, QPainter, QPaintEvent
from PySide6.QtWidgets import QApplication, QVBoxLayout, QWidget

from caris_desktop.domain.events import Problem
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.gamepad import Gamepads
from caris_desktop.live.intents import WizardIntents
from caris_desktop.scenario.model import LayoutNode, PanelName, Permissions, Scenario
from caris_desktop.study.trial import TrialDetails
from caris_desktop.ui.actions import Actions, Feature
from caris_desktop.ui.connection_card import ConnectionCard
from caris_desktop.ui.dock_host import DockHost, panels_in, without
from caris_desktop.ui.drive_keys import HoldToDrive
from caris_desktop.ui.emergency_over_dialogs import EmergencyOverDialogs
from caris_desktop.ui.gamepad_dialog import GamepadDialog
from caris_desktop.ui.icons import icon
from caris_desktop.ui.overlays import CommandPalette, Entry, ShortcutSheet
from caris_desktop.ui.panel import Panel, PanelContext
from caris_desktop.ui.panels.assistant import AssistantPanel
from caris_desktop.ui.panels.drive import DrivePanel
from caris_desktop.ui.panels.map import MapPanel
from caris_desktop.ui.panels.people import PeoplePanel
from caris_desktop.ui.panels.session import SessionPanel
from caris_desktop.ui.panels.speak import SpeakPanel
from caris_desktop.ui.panels.video import VideoPanel
from caris_desktop.ui.problems import ProblemCards
from caris_desktop.ui.speed_steps import fraction_after
from caris_desktop.ui.start_dialog import StartDialog
from caris_desktop.ui.status_bar import StatusBar
from caris_desktop.ui.theme import CHOICES, Theme, ThemeChoice, as_choice
from caris_desktop.ui.top_bar import EmergencyBand, TopBar, as_menu
from caris_desktop.ui.widgets.key_owner import KeyOwnerChip

logger = logging.getLogger(__name__)

PANELS: dict[PanelName, type[Panel]] = {
    "video": VideoPanel,
    "map": MapPanel,
    "drive": DrivePanel,
    "people": PeoplePanel,
    "speak": SpeakPanel,
    "assistant": AssistantPanel,
    "session": SessionPanel,
}
_PANEL_ICONS: dict[PanelName, str] = {
    "video": "video-camera", "map": "map-trifold", "drive": "game-controller", "people": "users",
    "speak": "chat-text", "assistant": "sparkle", "session": "list-bullets",
}  # fmt: skip
_ROOMY = QSize(1680, 1000)
_FRAME = QSize(16, 48)  # what a window manager may put around a window
_THEME_WORDS: dict[ThemeChoice, str] = {"system": "Like the system", "dark": "Dark", "light": "Light"}


@dataclass(frozen=True, slots=True)
class ScenarioChoice:
    """A line of the scenario menu."""

    title: str
    path: Path


def shipped_scenarios() -> list[ScenarioChoice]:
    """The scenario files that come with the program, named after their files."""
    return [
        ScenarioChoice(path.stem.replace("_", " ").replace("-", " ").capitalize(), path)
        for path in sorted(layouts_dir().glob("*.yaml"))
    ]


def absent_panels(permissions: Permissions) -> frozenset[str]:
    """Panels that make no sense without a permission, whatever the layout says."""
    absent = set()
    if not permissions.driving:
        absent.add("drive")
    if not permissions.assistant:
        absent.add("assistant")
    if not permissions.robot_controls:
        absent.add("robot")
    return frozenset(absent)


class Settings(Protocol):
    """What the window needs of QSettings."""

    def value(self, key: str, defaultValue: Any = None) -> Any: ...  # noqa: N803

    def setValue(self, key: str, value: Any) -> None: ...


class MainWindow(QWidget):
    """The wizard's window. Draws what ``console.state`` holds and turns input into intents.

    Parameters
    ----------
    console
        What the wizard can ask for; its ``state`` and ``scenario`` are read only.
    settings
        Where the theme and the window's place are kept; nothing is kept without.
    scenarios
        Gives the lines of the scenario menu each time it opens; by default the shipped files.
    gamepads
        The gamepad that drives too. It can also be given later, with ``use_gamepads``.
    """

    layout_save_requested = Signal(object)  # LayoutNode
    closed = Signal()

    def __init__(
        self,
        console: WizardIntents,
        *,
        settings: Settings | None = None,
        scenarios: Callable[[], Sequence[ScenarioChoice]] = shipped_scenarios,
        theme: Theme | None = None,
        gamepads: Gamepads | None = None,
    ) -> None:
        super().__init__()
        app = QApplication.instance()
        if not isinstance(app, QApplication):
            raise TypeError("the window needs a QApplication")
        self.setObjectName("main_window")
        self._console = console
        self._settings = settings
        self._scenarios = scenarios
        choice = as_choice(settings.value("theme", "system")) if settings is not None else "system"
        self.theme = theme if theme is not None else Theme(app, choice, self)
        self.actions_table = Actions(self, self)
        self.actions_table.rebuild(console.scenario)
        self.hold = HoldToDrive(console, self.actions_table, self)
        self._gamepads: Gamepads | None = None
        self._gamepad_dialog: GamepadDialog | None = None
        if gamepads is not None:
            self.use_gamepads(gamepads)
        self._context = PanelContext(console, self.theme, self.actions_table, self.hold)
        self._panels: dict[PanelName, Panel] = {}
        self._log: list[tuple[int, str, str]] = []
        self._dialog: StartDialog | None = None
        self._top_bar = TopBar(self.theme, console, self.actions_table)
        self._band = EmergencyBand(self.theme, console)
        self.dock_host = DockHost()
        self._status_bar = StatusBar(self.theme, console, KeyOwnerChip(self.theme, self.hold))
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(0)
        layout.addWidget(self._top_bar)
        layout.addWidget(self._band)
        holder = QVBoxLayout()
        holder.setContentsMargins(8, 8, 8, 8)
        holder.addWidget(self.dock_host)
        layout.addLayout(holder, 1)
        layout.addWidget(self._status_bar)
        self._problems = ProblemCards(self.theme, self.dock_host)
        self._palette_overlay = CommandPalette(self.theme, self)
        self._sheet = ShortcutSheet(self.theme, self)
        self._connection = ConnectionCard(self.theme, self, console.state)
        self._status_bar.connection_clicked.connect(self._connection.open)
        self._scenario_menu = as_menu(self.theme, self, "scenario_menu")
        self._window_menu = as_menu(self.theme, self, "window_menu")
        self._top_bar.start_requested.connect(self.open_start_dialog)
        self._top_bar.scenario_menu_requested.connect(self._open_scenario_menu)
        self._top_bar.window_menu_requested.connect(self._open_window_menu)
        self.hold.escape_pressed.connect(self._palette_overlay.close_overlay)
        self.hold.escape_pressed.connect(self._sheet.close_overlay)
        self.hold.escape_pressed.connect(self._connection.close_overlay)
        self.theme.changed.connect(self.update)
        self.setWindowIcon(icon("robot", self.theme.color("blue"), 64))
        self.hold.set_emergency_button(self._top_bar.emergency)
        self._emergency_copy = EmergencyOverDialogs(self.theme, self._top_bar.emergency)
        self._emergency_copy.pressed.connect(console.emergency_stop)
        console.state.event_happened.connect(self._on_event)
        console.state.robot.changed.connect(self._on_robot_changed)
        console.state.places.changed.connect(self._on_places_changed)
        self._on_robot_changed(console.state.robot.value)
        self._on_places_changed(console.state.places.value)
        console.state.frame.freshness_changed.connect(self._on_video_freshness_changed)
        self._on_video_freshness_changed(console.state.frame.freshness)
        app.focusChanged.connect(self._on_focus_changed)
        self.show_scenario(console.scenario)
        self._restore_place()

    def use_gamepads(self, gamepads: Gamepads) -> None:
        """Let the gamepad drive, stop and do what its buttons are set to, and its window be opened."""
        if gamepads is not self._gamepads:
            self._gamepads = gamepads
            self.hold.use_gamepads(gamepads)

    # ---- what is on show

    @property
    def panels(self) -> dict[PanelName, Panel]:
        """The panels of the current scenario."""
        return self._panels

    @property
    def problems(self) -> ProblemCards:
        return self._problems

    @property
    def status_bar(self) -> StatusBar:
        return self._status_bar

    def show_scenario(self, scenario: Scenario) -> None:
        """Rebuild panels, actions and shortcuts for ``scenario``; everything else keeps running."""
        session = self._panels.get("session")
        if isinstance(session, SessionPanel):
            self._log = session.log_entries()
        self.hold.release_all("The scenario was changed")
        self.actions_table.forget_driving_panels()
        self.hold.set_driving_panels(())
        self.dock_host.clear()
        self.actions_table.rebuild(scenario)
        tree = without(scenario.layout, absent_panels(scenario.permissions)) or scenario.layout
        self._panels = {name: PANELS[name](self._context) for name in panels_in(tree)}
        session = self._panels.get("session")
        if isinstance(session, SessionPanel):
            session.start_requested.connect(self.open_start_dialog)
            session.restore_log(self._log)
        self.dock_host.show_layout(self._panels, tree)
        driving = [panel for panel in self._panels.values() if panel.drives]
        self.actions_table.bind_driving_panels(driving)
        self.hold.set_driving_panels(driving)
        self._top_bar.show_scenario()
        self._status_bar.refresh()
        self.setWindowTitle(f"{scenario.title} · CARIS Desktop")
        self._focus_first()

    def current_layout(self) -> LayoutNode | None:
        """The docks as the wizard arranged them, as a scenario would say it."""
        return self.dock_host.tree

    def _focus_first(self) -> None:
        if not self.focus_driving():
            self.focus_speak()

    # ---- what the table's actions do

    def focus_driving(self) -> bool:
        """Put the focus where the bare keys drive; False where the scenario has no such panel."""
        if self.actions_table.spec("drive_forward") is None:
            return False
        for name in ("video", "drive", "map"):
            panel = self._panels.get(name)
            if panel is not None:
                self.dock_host.show_panel(name)
                panel.focus_target().setFocus(Qt.FocusReason.ShortcutFocusReason)
                return True
        return False

    def focus_speak(self) -> None:
        self._focus_panel("speak")

    def _focus_panel(self, name: PanelName) -> None:
        panel = self._panels.get(name)
        if panel is not None:
            self.dock_host.show_panel(name)
            panel.focus_target().setFocus(Qt.FocusReason.ShortcutFocusReason)

    def stop(self) -> None:
        self._console.stop()

    def emergency_stop(self) -> None:
        self._console.emergency_stop()

    def change_speed(self, direction: int) -> None:
        """One of the three steps up (1) or down (-1)."""
        self._console.set_speed_fraction(fraction_after(self._console.state.drive.value.speed_fraction, direction))

    def look_ahead(self) -> None:
        self._console.look_at(pan_rad=0.0, tilt_rad=0.0)

    def go_to_nth_place(self, number: int) -> None:
        places = self._console.state.places.value
        if number <= len(places):
            self._console.go_to_place(places[number - 1].name)

    def say_phrase(self, number: int) -> None:
        self._console.say(self._console.scenario.phrases[number - 1], "phrase")

    def say_filler(self) -> None:
        self._console.say(self._console.scenario.filler, "filler")

    def silence(self) -> None:
        self._console.silence()

    def take_photo(self) -> None:
        self._console.take_photo()

    def mark_moment(self) -> None:
        self._console.mark("", "mark")

    def mark_wizard_error(self) -> None:
        self._console.mark("", "wizard_error")

    def show_command_palette(self) -> None:
        self._palette_overlay.open_with(self._entries())

    def show_shortcuts(self) -> None:
        self._sheet.open_with(self.actions_table)

    def open_start_dialog(self) -> None:
        """Ask who takes part, then start recording. One dialog at a time."""
        if self._dialog is not None:
            self._dialog.raise_()
            return
        self._dialog = StartDialog(self.theme, self._console.suggested_details(), self)
        self._dialog.begin.connect(self._on_begin)
        self._dialog.finished.connect(self._on_dialog_finished)
        self._dialog.open()

    def open_gamepad_dialog(self) -> None:
        """Show the gamepad, live, and what its parts do. Not modal: the robot can be stopped meanwhile."""
        if self._gamepads is None:
            return
        if self._gamepad_dialog is None:
            self._gamepad_dialog = GamepadDialog(self.theme, self._console.state, self._gamepads, self)
        self._gamepad_dialog.show()
        self._gamepad_dialog.raise_()
        self._gamepad_dialog.activateWindow()

    def _on_begin(self, details: TrialDetails) -> None:
        self._top_bar.show_details(details)
        self._console.start_session(details)

    def _on_dialog_finished(self, _result: int) -> None:
        self._dialog = None

    # ---- menus

    def _entries(self) -> list[Entry]:
        table = self.actions_table
        entries = [
            Entry(spec.text, "Say" if spec.callback in ("say_phrase", "say_filler") else "Do", spec.icon,
                  table.key_text(spec.id), self._runner(spec.id))
            for spec in table.specs
            # The places come below, all of them.
            if spec.callback not in ("", "go_to_nth_place") and spec.id != "find"
            and (spec.kind != "command" or table.available(spec.id))
        ]  # fmt: skip
        scenario = self._console.scenario
        if scenario.permissions.driving:
            entries += [
                Entry(f"Go to {place.name}", "Place", "flag", table.key_text(f"place_{number}"), self._goer(place.name))
                for number, place in enumerate(self._console.state.places.value, start=1)
            ]
        entries += [
            Entry(panel.title, "Panel", _PANEL_ICONS[name], "", self._panel_opener(name))
            for name, panel in self._panels.items()
        ]
        entries.append(Entry("Connection in the last minute", "Window", "wifi-high", "", self._connection.open))
        if self._gamepads is not None and scenario.permissions.driving:
            entries.append(Entry("Gamepad", "Window", "game-controller", "", self.open_gamepad_dialog))
        recording = self._console.state.recording.value.state == "recording"
        entries.append(
            Entry("Stop recording", "Do", "stop", "", self._console.stop_session) if recording
            else Entry("Start recording", "Do", "record", "", self.open_start_dialog)
        )  # fmt: skip
        entries += [
            Entry(f"Open scenario {choice.title}", "Scenario", "map-trifold", "", self._scenario_opener(choice.path))
            for choice in self._scenarios()
        ]
        entries += [
            Entry(f"Appearance: {words.lower()}", "Window", "moon", "", self._theme_setter(choice))
            for choice, words in _THEME_WORDS.items()
        ]
        return entries

    def _runner(self, action_id: str) -> Callable[[], None]:
        return lambda: self.actions_table.run(action_id)

    def _goer(self, place: str) -> Callable[[], None]:
        return lambda: self._console.go_to_place(place)

    def _panel_opener(self, name: PanelName) -> Callable[[], None]:
        return lambda: self._focus_panel(name)

    def _scenario_opener(self, path: Path) -> Callable[[], None]:
        return lambda: self._open_scenario(path)

    def _theme_setter(self, choice: ThemeChoice) -> Callable[[], None]:
        return lambda: self.set_theme_choice(choice)

    def _open_scenario_menu(self) -> None:
        menu = self._scenario_menu
        menu.clear()
        group = QActionGroup(menu)
        current = self._console.scenario
        for choice in self._scenarios():
            action = menu.addAction(choice.title)
            action.setCheckable(True)
            action.setChecked(current.path is not None and choice.path.resolve() == current.path.resolve())
            action.setActionGroup(group)
            action.triggered.connect(self._scenario_opener(choice.path))
        menu.addSeparator()
        menu.addAction("Save this panel layout").triggered.connect(self._on_save_layout)
        self._top_bar.popup_below(menu, self._top_bar.scenario_button)

    def _open_scenario(self, path: Path) -> None:
        if self._console.open_scenario(path):
            self.show_scenario(self._console.scenario)

    def _on_save_layout(self) -> None:
        tree = self.current_layout()
        if tree is not None:
            self.layout_save_requested.emit(tree)

    def _open_window_menu(self) -> None:
        menu = self._window_menu
        menu.clear()
        menu.addSection("Panels")
        for action in self.dock_host.toggle_actions():
            menu.addAction(action)
        menu.addAction("Put the panels back").triggered.connect(self._on_reset_layout)
        menu.addSection("Appearance")
        group = QActionGroup(menu)
        for choice in CHOICES:
            action = menu.addAction(_THEME_WORDS[choice])
            action.setCheckable(True)
            action.setChecked(choice == self.theme.choice)
            action.setActionGroup(group)
            action.triggered.connect(self._theme_setter(choice))
        menu.addSeparator()
        if self._gamepads is not None and self._console.scenario.permissions.driving:
            menu.addAction("Gamepad…").triggered.connect(self.open_gamepad_dialog)
        menu.addAction("All shortcuts").triggered.connect(self.show_shortcuts)
        self._top_bar.popup_below(menu, self._top_bar.window_button)

    def _on_reset_layout(self) -> None:
        # After the menu has closed: its own actions belong to the docks that go away.
        QTimer.singleShot(0, self, lambda: self.show_scenario(self._console.scenario))

    def set_theme_choice(self, choice: ThemeChoice) -> None:
        self.theme.set_choice(choice)
        if self._settings is not None:
            self._settings.setValue("theme", choice)

    # ---- what happens

    def _on_robot_changed(self, robot: Any) -> None:
        features: list[Feature] = []
        if robot is not None and robot.holonomic:
            features.append("sideways")
        if robot is not None and robot.head is not None:
            features.append("head")
        self.actions_table.use_features(features)

    def _on_places_changed(self, places: Any) -> None:
        self.actions_table.use_places([place.name for place in places])

    def _on_event(self, event: Any) -> None:
        if isinstance(event, Problem):
            self._problems.show_problem(event)

    def _on_video_freshness_changed(self, freshness: str) -> None:
        self.actions_table.set_condition("video", freshness == "fresh")

    def _on_focus_changed(self, _old: QWidget | None, new: QWidget | None) -> None:
        for panel in self._panels.values():
            panel.set_active(new is not None and (panel is new or panel.isAncestorOf(new)))

    def changeEvent(self, event: QEvent) -> None:
        super().changeEvent(event)
        if event.type() == QEvent.Type.WindowStateChange and self.isMinimized():
            self.hold.release_all("The window was minimised")

    def _restore_place(self) -> None:
        geometry = self._settings.value("window/geometry") if self._settings is not None else None
        if geometry:
            self.restoreGeometry(geometry)
        else:
            self.resize(_ROOMY)
        # A window taller than its screen hides the status bar below the edge, title bar included.
        self.resize(self.size().boundedTo(self.screen().availableSize() - _FRAME))

    def closeEvent(self, event: QCloseEvent) -> None:
        if self._settings is not None:
            self._settings.setValue("window/geometry", self.saveGeometry())
        self.hold.close()
        self.closed.emit()
        super().closeEvent(event)

    def paintEvent(self, _event: QPaintEvent) -> None:
        QPainter(self).fillRect(self.rect(), self.theme.color("window"))
