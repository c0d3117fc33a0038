"""The console's window: top bar, dock panels, status bar, and what the actions of the table do."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Protocol

from PySide6.QtCore import QEvent, QPoint, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QActionGroup, QCloseEvent, QPainter, QPaintEvent
from PySide6.QtWidgets import QApplication, QMenu, QSplitter, QVBoxLayout, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.controls import ControlValue, RobotControl
from caris_desktop.domain.events import GoalChanged, Problem
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.domain.trial import TrialDetails
from caris_desktop.live.gamepad import Gamepads
from caris_desktop.live.status import IN_SESSION, DriveStatus, LinkStatus, MapStatus, RecordingStatus
from caris_desktop.live.wizard_console import ReplayControls, RobotChoice, SessionLibrary, WizardConsole
from caris_desktop.scenario.layout import layout_text
from caris_desktop.scenario.model import LayoutNode, PanelLeaf, PanelName, Permissions, Scenario, SplitNode
from caris_desktop.ui.actions import Actions, Feature
from caris_desktop.ui.bands import EmergencyBand, GuardBand, QuestionBand
from caris_desktop.ui.connection_card import ConnectionCard
from caris_desktop.ui.dock_host import DockHost, panels_in, without
from caris_desktop.ui.drive_keys import HoldToDrive
from caris_desktop.ui.emergency_over_dialogs import EmergencyOverDialogs
from caris_desktop.ui.export_dialog import ExportDialog
from caris_desktop.ui.gamepad_dialog import GamepadDialog
from caris_desktop.ui.icons import icon
from caris_desktop.ui.marking import Marking
from caris_desktop.ui.notice_strip import NoticeStrip
from caris_desktop.ui.overlays import CommandPalette, Entry, ShortcutSheet
from caris_desktop.ui.panel import Panel, PanelContext
from caris_desktop.ui.panels.assistant import AssistantPanel
from caris_desktop.ui.panels.diagnostics import DiagnosticsPanel
from caris_desktop.ui.panels.drive import DrivePanel
from caris_desktop.ui.panels.map import MapPanel
from caris_desktop.ui.panels.motion import MotionPanel
from caris_desktop.ui.panels.people import PeoplePanel
from caris_desktop.ui.panels.robot import RobotPanel, question_for
from caris_desktop.ui.panels.session import LogEntry, SessionPanel
from caris_desktop.ui.panels.speak import SpeakPanel
from caris_desktop.ui.panels.video import VideoPanel
from caris_desktop.ui.problems import ProblemCards
from caris_desktop.ui.replay.replay_bar import ReplayBar
from caris_desktop.ui.replay.replay_panels import ReplayPanels
from caris_desktop.ui.replay.timeline_view import TimelineView
from caris_desktop.ui.robot_dialog import RobotDialog, RobotExplorer
from caris_desktop.ui.sessions_window import SessionsWindow
from caris_desktop.ui.speed_steps import fraction_after
from caris_desktop.ui.start_dialog import RecordingOffer, StartDialog, last_details
from caris_desktop.ui.status_bar import StatusBar
from caris_desktop.ui.theme import CHOICES, Theme, ThemeChoice, as_choice
from caris_desktop.ui.top_bar import TopBar, as_menu
from caris_desktop.ui.widgets.key_owner import KeyOwnerChip
from caris_desktop.ui.words import UNDER_WAY, shortened

logger = logging.getLogger(__name__)

PANELS: dict[PanelName, type[Panel]] = {
    "video": VideoPanel,
    "map": MapPanel,
    "drive": DrivePanel,
    "people": PeoplePanel,
    "speak": SpeakPanel,
    "assistant": AssistantPanel,
    "session": SessionPanel,
    "robot": RobotPanel,
    "motion": MotionPanel,
    "diagnostics": DiagnosticsPanel,
}
_PANEL_ICONS: dict[PanelName, str] = {
    "video": "video-camera", "map": "map-trifold", "drive": "game-controller", "people": "users",
    "speak": "chat-text", "assistant": "sparkle", "session": "list-bullets", "robot": "sliders",
    "motion": "chart-line", "diagnostics": "gauge",
}  # fmt: skip
# Where a panel that the scenario does not have is put: in a tab with the first of these that is open.
_NEIGHBOURS: dict[PanelName, tuple[PanelName, ...]] = {
    "video": ("map", "people"), "map": ("people", "session", "drive"), "drive": ("map", "people", "session"),
    "people": ("session", "drive", "map"), "speak": ("assistant",), "assistant": ("people", "session", "map"),
    "session": ("people", "drive", "assistant", "map"), "robot": ("people", "drive", "session", "map"),
    "motion": ("map", "drive", "people", "session"), "diagnostics": ("session", "people", "assistant", "drive", "map"),
}  # fmt: skip
_ROOMY = QSize(1680, 1000)
LAYOUT_AT_REST_MS = 1000
_SAME_WEIGHT = 0.01  # a pixel here or there is no other arrangement
_FRAME = QSize(16, 48)  # what a window manager may put around a window
_PANELS_AND_TIMELINE_PX = (600, 260)
_TWICE = "choose it, then Enter twice"
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
    explorer
        Looks at robots that have no profile yet. It can also be given later, with ``use_explorer``.
    gamepads
        The gamepad that drives too. It can also be given later, with ``use_gamepads``.
    """

    layout_save_requested = Signal(object)  # LayoutNode
    layout_reset_requested = Signal()
    closed = Signal()

    def __init__(
        self,
        console: WizardConsole,
        *,
        settings: Settings | None = None,
        scenarios: Callable[[], Sequence[ScenarioChoice]] = shipped_scenarios,
        theme: Theme | None = None,
        gamepads: Gamepads | None = None,
        explorer: RobotExplorer | None = None,
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
        self.marking = Marking(self.theme, console, self.actions_table, self.hold, self)
        self._context = PanelContext(console, self.theme, self.actions_table, self.hold)
        self._panels: dict[PanelName, Panel] = {}
        self._replay_title = ""
        self._timeline: TimelineView | None = None
        self._replay_panels: ReplayPanels | None = None
        self._replay: ReplayControls | None = None
        self._geometry_key = "window/geometry"
        self._log: list[LogEntry] = []
        self._dialog: StartDialog | None = None
        self._begun: TrialDetails | None = None
        self._robot_dialog: RobotDialog | None = None
        self._explorer = explorer
        self._library: SessionLibrary | None = None
        self._sessions: SessionsWindow | None = None
        self._export: ExportDialog | None = None
        self._top_bar = TopBar(self.theme, console, self.actions_table)
        self._question = QuestionBand(self.theme)
        self.dock_host = DockHost()
        self._status_bar = StatusBar(self.theme, console, KeyOwnerChip(self.theme, self.hold))
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(0)
        layout.addWidget(self._top_bar)
        bands = {EmergencyBand(self.theme, console): 3, GuardBand(self.theme, console): 2, self._question: 4}
        self._strip = NoticeStrip(self.theme, console, bands)
        layout.addWidget(self._strip)
        holder = QVBoxLayout()
        holder.setContentsMargins(8, 6, 8, 8)
        self._middle = QSplitter(Qt.Orientation.Vertical)
        self._middle.setObjectName("middle")
        self._middle.setHandleWidth(8)
        self._middle.setChildrenCollapsible(False)
        self._middle.addWidget(self.dock_host)
        holder.addWidget(self._middle)
        layout.addLayout(holder, 1)
        layout.addWidget(self._status_bar)
        self._told_layout: LayoutNode | None = None
        self._scenario_layout: LayoutNode | None = None
        self._layout_rest = QTimer(self, singleShot=True, interval=LAYOUT_AT_REST_MS)
        self._layout_rest.timeout.connect(self._tell_layout)
        self.dock_host.layout_changed.connect(self._layout_rest.start)
        self._problems = ProblemCards(self.theme, self.dock_host, console.state)
        self._palette_overlay = CommandPalette(self.theme, self)
        self._sheet = ShortcutSheet(self.theme, self)
        self._connection = ConnectionCard(self.theme, self, console.state)
        self._connection.diagnostics_requested.connect(self._open_diagnostics)
        self._connection.robots_requested.connect(self._open_robot_menu)
        self._status_bar.connection_clicked.connect(self._connection.open)
        self._scenario_menu = as_menu(self.theme, self, "scenario_menu")
        self._window_menu = as_menu(self.theme, self, "window_menu")
        self._robot_menu = as_menu(self.theme, self, "robot_menu")
        self._shown_scenario: Scenario | None = None
        self._top_bar.start_requested.connect(self.open_start_dialog)
        self._top_bar.scenario_menu_requested.connect(self._open_scenario_menu)
        self._top_bar.window_menu_requested.connect(self._open_window_menu)
        self.hold.escape_pressed.connect(self._palette_overlay.close_overlay)
        self.hold.escape_pressed.connect(self._sheet.close_overlay)
        self.hold.escape_pressed.connect(self._connection.close_overlay)
        self.hold.escape_pressed.connect(self._question.put_away)
        self.hold.escape_pressed.connect(self._close_session_windows)
        self.hold.close_refused.connect(self._on_close_refused)
        self.theme.changed.connect(self.update)
        self.setWindowIcon(icon("robot", self.theme.color("blue"), 64))
        self.hold.set_emergency_button(self._top_bar.emergency)
        self._emergency_copy = EmergencyOverDialogs(self.theme, self._top_bar.emergency, self.hold)
        self._emergency_copy.pressed.connect(self.emergency_stop)
        console.state.event_happened.connect(self._on_event)
        console.state.recording.changed.connect(self._on_recording_changed)
        console.state.robot.changed.connect(self._on_robot_changed)
        console.state.places.changed.connect(self._on_places_changed)
        self._on_robot_changed(console.state.robot.value)
        self._on_places_changed(console.state.places.value)
        console.state.scenario.changed.connect(self._on_scenario_changed)
        self._palette_latched = console.state.drive.value.emergency_stop
        console.state.drive.changed.connect(self._on_drive_changed)
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

    def use_replay(self, replay: ReplayControls) -> None:
        """Show a recorded session: the timeline below the panels, the bar that moves through it below that."""
        self._replay = replay
        self.actions_table.keep_only(("Safety", "Window", "Speaking"))
        self.actions_table.rebuild(self._console.scenario)
        self._top_bar.show_replay(replay.live_robots)
        self._status_bar.show_replay()
        self._strip.hide()
        timeline = TimelineView(self.theme, replay, self._console.state, self.actions_table)
        bar = ReplayBar(self.theme, replay, self._console.state, self.actions_table)
        # Built anew with what a replay can do: no Photo, for one.
        self.show_scenario(self._console.scenario)
        panels = self._replay_panels = ReplayPanels(self.dock_host)
        self._middle.insertWidget(0, panels)
        self._middle.addWidget(timeline)
        self._middle.setStretchFactor(0, 1)
        self._middle.setStretchFactor(1, 0)
        self._middle.setSizes(list(_PANELS_AND_TIMELINE_PX))
        outer = self.layout()
        if isinstance(outer, QVBoxLayout):
            outer.insertWidget(outer.indexOf(self._status_bar), bar)
        self._timeline = timeline
        replay.noticed.connect(self._problems.show_problem)
        self.hold.escape_pressed.connect(timeline.give_up)
        self._geometry_key = "replay/geometry"
        if self._settings is not None:
            self._restore_place()
        self._focus_first()
        self._replay_title = f"Replay of {replay.session.folder.name}"
        self.setWindowTitle(self._title(self._console.scenario))

    def _title(self, scenario: Scenario) -> str:
        return " · ".join(part for part in (self._replay_title, scenario.title, "CARIS Desktop") if part)

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
        self._shown_scenario = scenario
        self._keep_log()
        self.hold.release_all("The scenario was changed")
        self.actions_table.forget_driving_panels()
        self.hold.set_driving_panels(())
        self.dock_host.clear()
        self.actions_table.rebuild(scenario)
        absent = frozenset(panels_in(scenario.layout)) - frozenset(self.possible_panels())
        tree = without(scenario.layout, absent) or PanelLeaf("video")
        self._panels = {}
        for name in panels_in(tree):
            self._make_panel(name)
        self.dock_host.show_layout(self._panels, tree)
        if self._replay_panels is not None:
            self._replay_panels.fit()
        # How much room each panel really gets is seen once they are at rest; that is not the wizard's doing.
        self._told_layout, self._scenario_layout = None, tree
        self._layout_rest.start()
        self._bind_driving_panels()
        self._top_bar.show_scenario()
        self._status_bar.refresh()
        self.setWindowTitle(self._title(scenario))
        self._focus_first()

    def _make_panel(self, name: PanelName) -> Panel:
        panel = self._panels[name] = PANELS[name](self._context)
        if isinstance(panel, SessionPanel):
            panel.start_requested.connect(self.open_start_dialog)
            panel.export_requested.connect(self.export_last_session)
            panel.sessions_requested.connect(self.open_sessions)
            panel.use_library(present=self._library is not None)
            panel.restore_log(self._log)
        return panel

    def _keep_log(self) -> None:
        session = self._panels.get("session")
        if isinstance(session, SessionPanel):
            self._log = session.log_entries()

    def _bind_driving_panels(self) -> None:
        driving = [panel for panel in self._panels.values() if panel.drives]
        self.actions_table.bind_driving_panels(driving)
        self.hold.set_driving_panels(driving)

    def possible_panels(self) -> tuple[PanelName, ...]:
        """Every panel that this scenario's permissions allow, whether its layout has it or not."""
        absent = absent_panels(self._console.scenario.permissions)
        return tuple(name for name in PANELS if name not in absent)

    def open_panel(self, name: PanelName) -> None:
        """Bring the panel to the front; one that the scenario does not have is added in a tab."""
        if name not in self.possible_panels():
            return
        if name not in self._panels:
            self.dock_host.add_panel(name, self._make_panel(name), _NEIGHBOURS[name])
            self._bind_driving_panels()
        self.dock_host.show_panel(name)

    def close_panel(self, name: PanelName) -> None:
        """Close the panel; one that was added goes away altogether."""
        if name not in self._panels:
            return
        if name in panels_in(self._console.scenario.layout):
            self.dock_host.close_panel(name)
            return
        self._keep_log()
        panel = self._panels.pop(name)
        if panel.drives:
            self._bind_driving_panels()
        self.dock_host.remove_panel(name)

    def current_layout(self) -> LayoutNode | None:
        """The docks as the wizard arranged them, as a scenario would say it."""
        return self.dock_host.tree

    def _focus_first(self) -> None:
        if self._timeline is not None:
            # In a replay no field takes what is typed, and Space plays.
            self._timeline.setFocus(Qt.FocusReason.OtherFocusReason)
            return
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
            self.open_panel(name)
            panel.focus_target().setFocus(Qt.FocusReason.ShortcutFocusReason)

    def stop(self) -> None:
        self._console.do(intents.Stop())

    def emergency_stop(self) -> None:
        self._console.do(intents.EmergencyStop())

    def change_speed(self, direction: int) -> None:
        """One of the three steps up (1) or down (-1)."""
        before = self._console.state.drive.value.speed_fraction
        self._console.do(intents.SetSpeed(fraction_after(before, direction)))

    def look_ahead(self) -> None:
        self._console.do(intents.LookAt(0.0, 0.0))

    def go_to_nth_place(self, number: int) -> None:
        places = self._console.state.places.value
        if number <= len(places):
            self._console.do(intents.GoToPlace(places[number - 1].name))

    def say_phrase(self, number: int) -> None:
        self._console.do(intents.Say(self._console.scenario.phrases[number - 1], "phrase"))

    def say_filler(self) -> None:
        self._console.do(intents.Say(self._console.scenario.filler, "filler"))

    def silence(self) -> None:
        self._console.do(intents.Silence())

    def take_photo(self) -> None:
        video = self._panels.get("video")
        if isinstance(video, VideoPanel):
            video.remember_photo()
        self._console.do(intents.TakePhoto())

    def mark_moment(self) -> None:
        self.marking.mark_moment()

    def mark_label(self, number: int) -> None:
        self.marking.mark_label(number)

    def toggle_stretch(self) -> None:
        self.marking.toggle_stretch()

    def mark_earlier(self) -> None:
        self.marking.mark_earlier()

    def withdraw_mark(self) -> None:
        self.marking.withdraw_mark()

    def write_note(self) -> None:
        self.marking.write_note()

    def mark_wizard_error(self) -> None:
        self.marking.mark_wizard_error()

    def show_command_palette(self) -> None:
        self._palette_overlay.open_with(self._entries())

    def show_shortcuts(self) -> None:
        self._sheet.open_with(self.actions_table)

    def open_start_dialog(self) -> None:
        """Ask who takes part, then start recording. One dialog at a time."""
        if self._dialog is not None:
            self._dialog.raise_()
            return
        console, suggested = self._console, self._console.suggested_details()
        offer = RecordingOffer(
            console.scenario.permissions, last_details(suggested, self._begun), console.expected_bytes_per_hour(),
            console.free_bytes(), console.microphones(), console.microphone,
        )  # fmt: skip
        self._dialog = StartDialog(self.theme, suggested, self, offer)
        self._dialog.microphone_chosen.connect(lambda name: console.do(intents.UseMicrophone(name)))
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
        self._begun = details
        self._top_bar.show_details(details)
        self._console.do(intents.StartRecording(details))

    def _on_dialog_finished(self, _result: int) -> None:
        self._dialog = None

    # ---- menus

    def _entries(self) -> list[Entry]:
        """Everything that can be done now."""
        table = self.actions_table
        says = ("say_phrase", "say_filler")
        left_out: set[str] = set()
        if self._replay is not None:
            left_out = {"Speaking"} if self._replay.live_robots.value.robots else {"Speaking", "Safety"}
        entries = [
            Entry(spec.text, "Say" if spec.callback in says else "Do", spec.icon, table.key_text(spec.id),
                  self._runner(spec.id), acts=spec.callback in (*says, "look_ahead"))
            for spec in table.specs
            # The places come below, all of them; a replay says nothing, and stops what another console drives.
            if spec.callback not in ("", "go_to_nth_place") and spec.id != "find" and table.available(spec.id)
            and spec.group not in left_out
        ]  # fmt: skip
        if self._replay is not None:
            return entries + self._panel_entries() + self._theme_entries()
        scenario = self._console.scenario
        drive: DriveStatus = self._console.state.drive.value
        goal: GoalChanged | None = self._console.state.goal.value
        if drive.emergency_stop:
            release = Entry(
                "Release emergency stop", _TWICE, "lock-open", "", self._doer(intents.ReleaseEmergencyStop()),
                also="unlock free reset clear drive again", deliberate=True, first=True,
                again="Press Enter again to release the emergency stop",
            )  # fmt: skip
            entries.insert(0, release)
        if goal is not None and goal.state in UNDER_WAY:
            entries.append(
                Entry(f"Stop going to {goal.place or 'the chosen point'}", "Do", "x", "",
                      self._doer(intents.CancelGoal()), also="cancel goal way")
            )  # fmt: skip
        if scenario.permissions.driving:
            entries += [
                Entry(
                    f"Go to {place.name}",
                    "Place",
                    "flag",
                    table.key_text(f"place_{number}"),
                    self._goer(place.name),
                    also="drive move navigate send take robot",
                    acts=True,
                )
                for number, place in enumerate(self._console.state.places.value, start=1)
            ]
        if scenario.permissions.robot_controls:
            entries += self._control_entries()
        entries += self._map_entries()
        entries += self._camera_entries()
        entries += self._panel_entries()
        entries.append(Entry("Save this panel layout", "Window", "floppy-disk", "", self._on_save_layout))
        entries += [
            Entry(
                f"Connect to {choice.title}",
                "Robot",
                "robot",
                "",
                self._robot_chooser(choice),
                also="use switch another",
                acts=True,
            )
            for choice in self._console.robots()
            if not self._is_current(choice) and not choice.problem
        ]
        if self._explorer is not None:
            entries.append(Entry("Connect another robot…", "Robot", "plus", "", self.open_robot_dialog, also="new add"))
        if drive.guard == "overridden":
            entries.append(Entry("Switch the obstacle guard on", "Do", "shield-check", "", self._switch_guard_on))
        elif drive.guard != "absent" and scenario.permissions.driving:
            entries.append(
                Entry("Switch the obstacle guard off", _TWICE, "shield-slash", "", self._switch_guard_off,
                      deliberate=True, again="Press Enter again to switch the guard off")
            )  # fmt: skip
        entries.append(Entry("Connection in the last minute", "Window", "wifi-high", "", self._connection.open))
        if self._gamepads is not None and scenario.permissions.driving:
            entries.append(Entry("Gamepad", "Window", "game-controller", "", self.open_gamepad_dialog))
        entries += self._session_entries()
        entries += [
            Entry(f"Open scenario {choice.title}", "Scenario", "map-trifold", "", self._scenario_opener(choice.path))
            for choice in self._scenarios()
        ]
        return entries + self._theme_entries()

    def _panel_entries(self) -> list[Entry]:
        possible = self.possible_panels()
        shown = [name for name in possible if self.dock_host.is_open(name)]
        opened = [
            Entry(PANELS[name].title, "Panel", _PANEL_ICONS[name], "", self._panel_opener(name),
                  also="" if name in shown else "add open show")
            for name in possible
        ]  # fmt: skip
        closed = [
            Entry(f"Close {PANELS[name].title}", "Panel", "x", "", self._panel_closer(name), also="hide remove")
            for name in shown
        ]
        return [*opened, *closed, Entry("Put the panels back", "Window", "layout", "", self._on_reset_layout)]

    def _theme_entries(self) -> list[Entry]:
        return [
            Entry(f"Appearance: {words.lower()}", "Window", "moon", "", self._theme_setter(choice))
            for choice, words in _THEME_WORDS.items()
        ]

    def _camera_entries(self) -> list[Entry]:
        state = self._console.state
        return [
            Entry(f"Show the camera {name}", "Video", "video-camera", "", self._camera_chooser(name), also="picture")
            for name in state.cameras.value
            if name != state.camera.value
        ]

    def _camera_chooser(self, name: str) -> Callable[[], None]:
        return lambda: self._console.state.choose_camera(name)

    def _panel_closer(self, name: PanelName) -> Callable[[], None]:
        return lambda: self.close_panel(name)

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        if drive.emergency_stop != self._palette_latched and self._palette_overlay.isVisible():
            self._palette_overlay.renew(self._entries())
        self._palette_latched = drive.emergency_stop

    def _doer(self, intent: intents.Intent) -> Callable[[], None]:
        def do() -> None:
            self._console.do(intent)

        return do

    def _runner(self, action_id: str) -> Callable[[], None]:
        return lambda: self.actions_table.run(action_id)

    def _goer(self, place: str) -> Callable[[], None]:
        return self._doer(intents.GoToPlace(place))

    def _control_entries(self) -> list[Entry]:
        """Every control of the robot that needs no more than a choice."""
        entries = []
        held = self._console.state.drive.value.emergency_stop
        for control in self._console.state.controls.value:
            if held and control.is_motion:
                continue
            if control.kind == "button":
                uses: list[tuple[str, ControlValue]] = [(control.title, True)]
            elif control.kind == "toggle":
                uses = [(f"{control.title} on", True), (f"{control.title} off", False)]
            elif control.kind == "choice":
                uses = [(f"{control.title}: {choice.title}", choice.value) for choice in control.choices]
            else:
                entries.append(Entry(f"Robot: {control.title}", "Control", "sliders", "", self._panel_opener("robot")))
                continue
            entries += [
                Entry(
                    f"Robot: {words}",
                    control.group or "Control",
                    "sliders",
                    "",
                    self._control_user(control, value),
                    also="control",
                    acts=True,
                )
                for words, value in uses
            ]
        return entries

    def _control_user(self, control: RobotControl, value: ControlValue) -> Callable[[], None]:
        use = self._doer(intents.UseControl(control.id, value))
        if not control.confirm:
            return use
        return lambda: self._question.ask(question_for(control, value), "Do it", use)

    def _map_entries(self) -> list[Entry]:
        """What the robot can do with its map, as far as it needs no name."""
        status: MapStatus = self._console.state.mapping.value
        if not self._console.scenario.permissions.driving:
            return []
        entries = []
        if status.can_save:
            name = f"map-{datetime.now():%Y-%m-%d-%H-%M}"
            entries.append(
                Entry(f"Save the map as {name}", "Map", "floppy-disk", "", self._doer(intents.SaveMap(name)))
            )
        if status.can_switch and status.mapping is not True:
            entries.append(
                Entry("Start mapping", "Map", "map-trifold", "", self._doer(intents.SetMapping(mapping=True)))
            )
        if status.can_switch and status.mapping is not False:
            entries.append(
                Entry("Stop mapping, keep the map", "Map", "map-trifold", "",
                      self._doer(intents.SetMapping(mapping=False)), also="localization localisation end")
            )  # fmt: skip
        return entries

    def _switch_guard_on(self) -> None:
        self._console.do(intents.SetGuard(on=True))

    def _switch_guard_off(self) -> None:
        self._console.do(intents.SetGuard(on=False))

    def _panel_opener(self, name: PanelName) -> Callable[[], None]:
        return lambda: self._open_and_focus(name)

    def _open_and_focus(self, name: PanelName) -> None:
        self.open_panel(name)
        self._focus_panel(name)

    def _open_diagnostics(self) -> None:
        self._connection.close_overlay()
        self._open_and_focus("diagnostics")

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
        if not self._console.do(intents.OpenScenario(path)):
            self._on_scenario_changed(self._console.scenario)

    def _on_scenario_changed(self, scenario: Scenario) -> None:
        shown = self._shown_scenario
        if scenario is shown:
            return
        if shown is not None and (_only_other_places(shown, scenario) or self._only_saves_the_layout(shown, scenario)):
            # Nothing is rebuilt, so that what is typed and not yet said stays.
            self._shown_scenario = scenario
            self._top_bar.show_scenario()
            return
        self.show_scenario(scenario)

    def _only_saves_the_layout(self, before: Scenario, after: Scenario) -> bool:
        tree = self.current_layout()
        return (
            tree is not None
            and set(panels_in(after.layout)) == set(panels_in(tree))
            and replace(after, layout=before.layout, path=before.path, sha256=before.sha256, places=before.places)
            == before
        )

    def _on_save_layout(self) -> None:
        tree = self.current_layout()
        if tree is not None:
            self.layout_save_requested.emit(tree)

    def _open_window_menu(self) -> None:
        menu = self._window_menu
        menu.clear()
        menu.addSection("Panels")
        for name in self.possible_panels():
            action = menu.addAction(PANELS[name].title)
            action.setCheckable(True)
            action.setChecked(self.dock_host.is_open(name))
            action.triggered.connect(self._panel_toggler(name))
        menu.addAction("Put the panels back").triggered.connect(self._on_reset_layout)
        self._fill_session_menu(menu)
        menu.addSection("Robot")
        present = self._console.state.link.value.robot
        self._fill_robot_menu(menu.addMenu(f"Robot: {present}" if present else "Choose a robot"))
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

    def _panel_toggler(self, name: PanelName) -> Callable[[bool], None]:
        # After the menu has closed, so that the panel gets its size and the focus can go there.
        def toggle(shown: bool) -> None:
            QTimer.singleShot(0, self, lambda: self.open_panel(name) if shown else self.close_panel(name))

        return toggle

    # ---- sessions

    def use_library(self, library: SessionLibrary) -> None:
        """Let the wizard find, replay and export the sessions of the study."""
        self._library = library
        panel = self._panels.get("session")
        if isinstance(panel, SessionPanel):
            panel.use_library(present=True)

    def open_sessions(self) -> None:
        """Show all sessions, in a window beside this one."""
        if self._library is None:
            return
        if self._sessions is None:
            self._sessions = SessionsWindow(self.theme, self._library, self)
            self._sessions.export_requested.connect(self.open_export)
            self._on_recording_changed(self._console.state.recording.value)
        _bring_up(self._sessions)

    def open_export(self, sessions: Sequence[Path]) -> None:
        """Ask in which formats to write these sessions, in a window beside this one."""
        if self._library is None:
            return
        if self._export is None:
            self._export = ExportDialog(self.theme, self._library, sessions, self)
        else:
            self._export.show_sessions(sessions)
        _bring_up(self._export)

    def export_last_session(self) -> None:
        folder = self._console.state.recording.value.folder
        if folder is not None:
            self.open_export([folder])

    def _session_entries(self) -> list[Entry]:
        status = self._console.state.recording.value
        entries = []
        if status.state in ("recording", "paused"):
            paused = status.state == "paused"
            entries.append(
                Entry("Go on recording" if paused else "Pause recording", "Do", "record" if paused else "pause", "",
                      self._doer(intents.PauseRecording(not paused)), also="resume continue break")
            )  # fmt: skip
            entries.append(Entry("Stop recording", "Do", "stop", "", self._doer(intents.StopRecording())))
        else:
            entries.append(Entry("Start recording", "Do", "record", "", self.open_start_dialog))
            if status.folder is not None:
                entries.append(Entry("Export the last session…", "Window", "export", "", self.export_last_session))
        if self._library is not None:
            entries.append(
                Entry("All sessions…", "Window", "archive", "", self.open_sessions, also="replay search study export")
            )
        return entries

    def _fill_session_menu(self, menu: QMenu) -> None:
        if self._library is None:
            return
        menu.addSection("Sessions")
        menu.addAction("All sessions…").triggered.connect(self.open_sessions)
        status = self._console.state.recording.value
        last = menu.addAction("Export the last session…")
        last.setEnabled(status.folder is not None and status.state in ("idle", "failed"))
        last.triggered.connect(self.export_last_session)

    def _close_session_windows(self) -> None:
        # Who stops the robot from the main window keeps them.
        for window in (self._export, self._sessions):
            if window is not None and window.isActiveWindow():
                window.close()

    def _tell_layout(self) -> None:
        """For the record: how the wizard has arranged the panels, once they are at rest."""
        if not self.dock_host.isVisible():
            self._layout_rest.start()
            return
        tree, before = self.dock_host.read_layout(), self._told_layout
        self._told_layout = tree
        if tree is None:
            return
        if before is None and self._scenario_layout is not None:
            arranged = _differs(tree, self._scenario_layout, by=None)
        else:
            arranged = before is None or _differs(tree, before, by=_SAME_WEIGHT)
        if arranged:
            self._console.do(intents.KeepLayout(layout_text(tree)))

    # ---- robots

    def use_explorer(self, explorer: RobotExplorer) -> None:
        """Let the wizard look for robots and save profiles of them."""
        self._explorer = explorer

    def open_robot_dialog(self) -> None:
        """Look at a robot that has no profile yet. One dialog at a time."""
        if self._explorer is None:
            return
        if self._robot_dialog is not None:
            self._robot_dialog.raise_()
            self._robot_dialog.activateWindow()
            return
        link: LinkStatus = self._console.state.link.value
        self._robot_dialog = RobotDialog(self.theme, self._explorer, self, address=link.address)
        self._robot_dialog.saved.connect(self._on_robot_saved)
        self._robot_dialog.finished.connect(self._on_robot_dialog_finished)
        self._robot_dialog.show()

    def _on_robot_saved(self, choice: RobotChoice) -> None:
        self.choose_robot(choice)

    def _on_robot_dialog_finished(self, _result: int) -> None:
        if self._robot_dialog is not None:
            self._robot_dialog.deleteLater()
        self._robot_dialog = None

    def choose_robot(self, choice: RobotChoice) -> None:
        """Connect to another robot; asks first where that ends something."""
        ends = self._what_another_robot_ends()
        if not ends:
            self._use_robot(choice)
            return
        self._question.ask(
            f"Connect to {choice.title} now? {ends}",
            f"Connect to {choice.title}",
            lambda: self._use_robot(choice),
        )

    def _use_robot(self, choice: RobotChoice) -> None:
        # A profile that was refused has told why.
        self._console.do(intents.UseRobot(choice.name))

    def _what_another_robot_ends(self) -> str:
        ends = self._motion_that_ends()
        if self._console.state.recording.value.state in ("recording", "starting"):
            ends.append("The recording goes on with the other robot.")
        return " ".join(ends)

    def _motion_that_ends(self) -> list[str]:
        """What moves the robot now and would end with its link."""
        state = self._console.state
        drive: DriveStatus = state.drive.value
        goal: GoalChanged | None = state.goal.value
        present = shortened(state.link.value.robot, 40) or "The present robot"
        if goal is not None and goal.state in UNDER_WAY:
            place = shortened(goal.place or "", 40) or "a point on the map"
            return [f"{present} is on its way to {place} and will stop."]
        if drive.target_forward_mps or drive.target_left_mps or drive.target_turn_radps:
            return [f"{present} is being driven and will stop."]
        return []

    def _is_current(self, choice: RobotChoice) -> bool:
        robot = self._console.state.robot.value
        if robot is not None:
            return bool(robot.name == choice.name)
        return bool(self._console.state.link.value.robot == choice.title)

    def _robot_chooser(self, choice: RobotChoice) -> Callable[[], None]:
        return lambda: self.choose_robot(choice)

    def _fill_robot_menu(self, menu: QMenu) -> None:
        menu.clear()
        menu.setToolTipsVisible(True)
        group = QActionGroup(menu)
        for choice in self._console.robots():
            action = menu.addAction(f"{choice.title} · cannot be used" if choice.problem else choice.title)
            action.setCheckable(True)
            action.setChecked(self._is_current(choice))
            action.setActionGroup(group)
            action.setEnabled(not choice.problem)
            action.setToolTip(choice.problem or choice.address)
            action.triggered.connect(self._robot_chooser(choice))
        if self._explorer is not None:
            menu.addSeparator()
            menu.addAction("Connect another robot…").triggered.connect(self.open_robot_dialog)

    def _open_robot_menu(self) -> None:
        self._connection.close_overlay()
        self._fill_robot_menu(self._robot_menu)
        self._top_bar.popup_below(self._robot_menu, self._top_bar.window_button)

    def _on_reset_layout(self) -> None:
        # After the menu has closed: its own actions belong to the docks that go away.
        QTimer.singleShot(0, self, self._put_panels_back)

    def _put_panels_back(self) -> None:
        # Whoever listens gives the scenario its own arrangement back, where another one was saved in its place.
        self.layout_reset_requested.emit()
        self.show_scenario(self._console.scenario)
        self._console.do(intents.KeepLayout(layout_text(self._console.scenario.layout)))

    def set_theme_choice(self, choice: ThemeChoice) -> None:
        self.theme.set_choice(choice)
        if self._settings is not None:
            self._settings.setValue("theme", choice)

    # ---- what happens

    def _on_recording_changed(self, status: RecordingStatus) -> None:
        self._offer_photo()
        if self._sessions is None:
            return
        self._sessions.show_recording(status.folder if status.state in IN_SESSION else None)
        if status.state == "idle" and self._sessions.isVisible():
            self._sessions.refresh()  # one more

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
        # In a replay the problems of the session are history; there is nothing to do about them.
        if isinstance(event, Problem) and self._timeline is None:
            self._problems.show_problem(event)

    def _on_video_freshness_changed(self, freshness: str) -> None:
        self.actions_table.set_condition("video", freshness == "fresh")
        self._offer_photo()

    def _offer_photo(self) -> None:
        """In a pause nothing is to be kept of whoever is there."""
        state = self._console.state
        paused = state.recording.value.state == "paused"
        self.actions_table.set_condition("photo", state.frame.freshness == "fresh" and not paused)

    def _on_focus_changed(self, _old: QWidget | None, new: QWidget | None) -> None:
        for panel in self._panels.values():
            panel.set_active(new is not None and (panel is new or panel.isAncestorOf(new)))

    def changeEvent(self, event: QEvent) -> None:
        super().changeEvent(event)
        if event.type() == QEvent.Type.WindowStateChange and self.isMinimized():
            self.hold.release_all("The window was minimised")

    def show_in_place(self) -> None:
        """Show it where it was last time. The first time it fills a small screen, where every pixel is needed."""
        if self._fills_screen:
            self.showMaximized()
        else:
            self.show()

    def _restore_place(self) -> None:
        geometry = self._settings.value(self._geometry_key) if self._settings is not None else None
        if geometry:
            self.restoreGeometry(geometry)
        else:
            self.resize(_ROOMY)
        room = self.screen().availableSize() - _FRAME
        # A window taller than its screen hides the status bar below the edge, title bar included.
        self.resize(self.size().boundedTo(room))
        self._fills_screen = not geometry and self.size() != _ROOMY

    # ---- closing

    def _what_closing_ends(self) -> list[str]:
        if self._replay is not None:
            return []  # it was recorded and driven long ago
        saved = self._console.state.recording.value.state in ("starting", "recording", "paused")
        return [*(["The recording ends and is saved."] if saved else []), *self._motion_that_ends()]

    def _ask_before_closing(self, ends: list[str]) -> None:
        for overlay in (self._palette_overlay, self._sheet, self._connection):
            overlay.close_overlay()
        if self.isMinimized():
            self.showNormal()
        self._question.ask(
            f"Close the console? {' '.join(ends)}", "Close the console", lambda: self._on_close_agreed(ends)
        )

    def _on_close_agreed(self, asked: list[str]) -> None:
        ends = self._what_closing_ends()
        if set(ends) <= set(asked):
            self.close()
        else:
            self._ask_before_closing(ends)

    def _on_close_refused(self) -> None:
        self._problems.show_problem(
            Problem(
                self._console.state.present.now_ns(), "info", "The window stays open while you drive.", "",
                "Let go of the drive keys and of Alt, then close it.",
            )
        )  # fmt: skip

    def closeEvent(self, event: QCloseEvent) -> None:
        ends = self._what_closing_ends() if event.spontaneous() else []
        if ends:
            # Asked by a person, not by the program itself.
            event.ignore()
            self._ask_before_closing(ends)
            return
        if self._settings is not None:
            self._settings.setValue(self._geometry_key, self.saveGeometry())
        self._layout_rest.stop()
        for window in (self._export, self._sessions):
            if window is not None:
                window.close()
        self.hold.close()
        self.closed.emit()
        super().closeEvent(event)

    def paintEvent(self, _event: QPaintEvent) -> None:
        QPainter(self).fillRect(self.rect(), self.theme.color("window"))


def _bring_up(window: QWidget) -> None:
    parent = window.parentWidget()
    if parent is not None and not window.isVisible():
        # A window manager would put it into a corner.
        room = window.screen().availableGeometry()
        place = window.geometry()
        place.moveCenter(parent.frameGeometry().center())
        place.moveTopLeft(QPoint(max(room.left(), place.left()), max(room.top() + _FRAME.height(), place.top())))
        window.move(place.topLeft())
    window.show()
    window.raise_()
    window.activateWindow()


def _differs(tree: LayoutNode, other: LayoutNode, *, by: float | None) -> bool:
    """Whether panels lie elsewhere, or have a share of the window that is another one ``by`` more than this."""
    if isinstance(tree, SplitNode) and isinstance(other, SplitNode):
        if (tree.split, len(tree.children)) != (other.split, len(other.children)):
            return True
        shares = zip(_shares(tree), _shares(other), strict=True)
        if by is not None and any(abs(before - after) > by for before, after in shares):
            return True
        return any(_differs(*children, by=by) for children in zip(tree.children, other.children, strict=True))
    return tree != other


def _shares(node: SplitNode) -> list[float]:
    return [weight / sum(node.weights) for weight in node.weights]


def _only_other_places(before: Scenario, after: Scenario) -> bool:
    """Whether a place was saved or removed: panels follow ``state.places``, and none of them is built anew."""
    moved = replace(after, places=before.places, path=before.path, sha256=before.sha256)
    return before.places != after.places and moved == before
