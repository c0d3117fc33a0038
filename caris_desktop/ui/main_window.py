"""Main window of the console: top bar, dock area, status bar, and their connections."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QEvent, Qt, QTimer, Signal
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QSplitter, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.events import Problem
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.gamepad import Gamepads
from caris_desktop.live.status import IN_SESSION, DriveStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.scenario_file import ScenarioChoice, ScenarioError, list_scenarios, load_scenario
from caris_desktop.scenario.scenario_model import LayoutNode, PanelName, Scenario, panels_in
from caris_desktop.ui import layouts, text_formatting
from caris_desktop.ui.accessibility import Announcements, install_accessible_roles
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_rows import SAFETY_GROUP, SPEAKING_GROUP, WINDOW_GROUP
from caris_desktop.ui.background_reading import Remembered, read_for
from caris_desktop.ui.banners import EmergencyBanner, GuardBanner, Hints, NoticeStrip, QuestionBanner
from caris_desktop.ui.dock_host import DockHost
from caris_desktop.ui.event_watch import EventWatch
from caris_desktop.ui.first_use import DriveHint, FirstUse, PracticeStrip
from caris_desktop.ui.focus_widget import PanelWindow, application
from caris_desktop.ui.help_window import HelpWindows
from caris_desktop.ui.input.drive_input_filter import DriveInputFilter
from caris_desktop.ui.input.talk_key import Talking
from caris_desktop.ui.layout_store import LayoutStore
from caris_desktop.ui.marking import Marking
from caris_desktop.ui.notifications import AlarmList, AlarmsButton, NotificationLine, NotificationPopups
from caris_desktop.ui.observer_window import ObserverWindows
from caris_desktop.ui.palette.command_palette import CommandPalette, PaletteItem, PaletteMemory
from caris_desktop.ui.palette.palette_entries import PaletteEntries, QuickChoices
from caris_desktop.ui.panel import Panel, PanelContext
from caris_desktop.ui.panel_manager import LateImports, PanelManager
from caris_desktop.ui.people.shown_people import PendingIdentityQuestion, name_of
from caris_desktop.ui.preferences import Preferences, WizardProfiles
from caris_desktop.ui.preflight_list import PreflightButton, PreflightCard
from caris_desktop.ui.protocol_strip import ProtocolStrip
from caris_desktop.ui.quit_guard import QuitGuard
from caris_desktop.ui.scenario_files import ScenarioFiles
from caris_desktop.ui.shortcut_sheet import ShortcutSheet, WizardKeys
from caris_desktop.ui.status_bar import ConnectionCard, KeyOwnerChip, StatusBar
from caris_desktop.ui.theme import THEME_KEY, Theme, as_choice, icon
from caris_desktop.ui.top_bar import EmergencyOverDialogs, TopBar
from caris_desktop.ui.trial_cards import ResumeTrialCard, SavedSessionCard
from caris_desktop.ui.window_appearance import Appearance
from caris_desktop.ui.window_menus import AppContext, WindowMenus
from caris_desktop.ui.window_place import Settings, WindowPlace
from caris_desktop.ui.windows import FaceWindows, GamepadWindow, RobotChooser, ScenarioEditorWindow, SessionWindows

if TYPE_CHECKING:  # imported at first use
    from caris_desktop.live.replay_console import ReplayConsole
    from caris_desktop.live.robot_explorer import LiveRobotExplorer
    from caris_desktop.live.session_library import LiveSessionLibrary
    from caris_desktop.ui.replay.timeline_view import ReplayWidgets


class MainWindow(PanelWindow, QWidget):
    """The wizard's main window. Displays ``console.state`` and turns input into intents.

    ``settings`` stores theme and window geometry; without it nothing is saved. ``scenarios`` returns the entries of the
    scenario menu each time it opens, by default those of the library. ``explorer`` discovers robots without a profile,
    and ``gamepads`` adds gamepad input; both can be set later. ``all_panels``: create panels behind other tabs now
    instead of after the first paint.
    """

    closed = Signal()
    painted = Signal()  # first paint

    def __init__(
        self,
        console: WizardConsole,
        *,
        settings: Settings | None = None,
        scenarios: Callable[[], Sequence[ScenarioChoice]] = list_scenarios,
        theme: Theme | None = None,
        gamepads: Gamepads | None = None,
        explorer: "LiveRobotExplorer | None" = None,
        all_panels: bool = True,
    ) -> None:
        super().__init__()
        app = application()
        install_accessible_roles()
        self.setObjectName("main_window")
        self._console = console
        choice = as_choice(settings.value(THEME_KEY, "system")) if settings is not None else "system"
        self.theme = theme if theme is not None else Theme(app, choice, self)
        self.appearance = Appearance(self.theme, settings)
        self._began = False
        self._first_paint = EventWatch(self, self._on_first_paint, QEvent.Type.Paint)
        self._first_paint.add(self)
        self._shown_scenario: Scenario | None = None
        self._replay: ReplayConsole | None = None
        self._replay_parts: ReplayWidgets | None = None
        self.wizards = WizardProfiles(settings, self)
        # Keys
        self.actions_table = Actions(self, console, self)
        self.actions_table.rebuild(console.scenario)
        self.hold = DriveInputFilter(console, self.actions_table, self)
        self.marking = Marking(self.theme, console, self.actions_table, self.hold, self)
        self.talking = Talking(console, self.actions_table, self.hold, self)
        # Permanent parts
        self._top_bar = TopBar(self.theme, console, self.actions_table)
        self._question = QuestionBanner(self.theme)
        hint = DriveHint(self.theme, console, self.actions_table)
        self.dock_host = DockHost()
        banners = EmergencyBanner(self.theme, console), GuardBanner(self.theme, console), self._question, hint
        self._strip = NoticeStrip(self.dock_host, *banners)
        self._protocol = ProtocolStrip(self.theme, console, self.actions_table, self.hold)
        self.marking.card.lie_on(self.dock_host, below=(self._protocol, self._strip))
        self.practice = PracticeStrip(self.theme, console, self.actions_table, self.wizards)
        to_check = PreflightButton(self.theme, console)
        to_check.clicked.connect(self.show_preflight)
        alarms_button = AlarmsButton(self.theme, console)
        line = NotificationLine(self.theme)
        first = KeyOwnerChip(self.theme, self.hold), alarms_button, to_check
        self.status_bar = StatusBar(self.theme, console, *first, news=line)
        self._arrange()
        Hints(self.dock_host, self.actions_table, self.hold)
        self.problems = NotificationPopups(self.theme, self.dock_host, console.state, line)
        self._palette_overlay = CommandPalette(self.theme, self, PaletteMemory(self.wizards))
        warn = partial(self.problems.notify, severity="warning")
        self.wizard_keys = WizardKeys(self.wizards, self.actions_table, warn, self)
        self._sheet = ShortcutSheet(self.theme, self, self.actions_table, self.wizard_keys, self.hold)
        self._connection = ConnectionCard(self.theme, self, console.state)
        self._preflight = PreflightCard(self.theme, self, console)
        self._alarms = AlarmList(self.theme, self, console, self.actions_table)
        alarms_button.clicked.connect(self._alarms.show_alarms)
        # Popups and panels
        self.board = PanelManager(PanelContext(console, self.theme, self.actions_table, self.hold), self.dock_host)
        self.status_bar.picture_seen = self._picture_seen
        self.dock_host.layout_changed.connect(self.status_bar.refresh)
        self.layout_keeper = LayoutStore(self.dock_host, self.board, console, self.wizards, self.show_scenario)
        self.preferences = Preferences(console, self.wizards, self.board, self)
        self.help = HelpWindows(self.theme, self)
        self.sessions = SessionWindows(self.theme, console, self.wizards, self)
        self._going_on = ResumeTrialCard(self.theme, self.dock_host, console, self.sessions.record_next_part)
        self._saved = SavedSessionCard(self.theme, self.dock_host, self.sessions, console.state.present.now_ns)
        for card in (self._going_on, self._saved, self.marking.card):
            self.problems.stay_clear_of(card)
        self.robots = RobotChooser(self.theme, console, self._question, self)
        self.first_use = FirstUse(self.theme, console, hint, self.robots, self, settings=settings)
        self.layout_keeper.lend_room_to(self.practice)
        self.first_use.hint.practise_requested.connect(self.practice.begin)
        self.gamepad = GamepadWindow(self.theme, console, self.hold, self)
        self.faces = FaceWindows(self.theme, console, self)
        self.observers = ObserverWindows(
            self.theme, console, self.hold, self, settings if console.state.present.live else None
        )
        self.editor = ScenarioEditorWindow(self.theme, console, self)
        self._scenarios = Remembered(console, scenarios, self)
        overlays = (self._palette_overlay, self._sheet, self._connection, self._preflight, self._alarms)
        self.closing = QuitGuard(self, console, self._question, self.problems, overlays)
        parts = AppContext(
            console, self.theme, self.actions_table, self.board, self.layout_keeper, self.sessions, self.robots,
            self.gamepad, self.editor, self.wizards, self._scenarios, self._open_scenario, self.appearance,
            self.practice.begin, ScenarioFiles(console, self, self.theme), self.observers, self.closing.close_window,
        )  # fmt: skip
        self.menus = WindowMenus(parts, self._top_bar, self.show_shortcuts, self)
        self._entries = PaletteEntries(parts, self._question, self._connection.open)
        QuickChoices(parts, self._entries, self._palette_overlay)
        Announcements(self, console)
        self._emergency_copy = EmergencyOverDialogs(self.theme, self._top_bar.emergency, self.hold)
        self._connect()
        if gamepads is not None:
            self.use_gamepads(gamepads)
        if explorer is not None:
            self.use_explorer(explorer)
        self.setWindowIcon(icon("robot", self.theme.color("blue"), 64))
        PendingIdentityQuestion(console.state, self)
        self._begin_scenario(console.scenario)
        if all_panels:
            self.board.complete()
        else:
            self.board.complete_seen()
            self.painted.connect(self.board.go_on)
        app.installEventFilter(self.hold)
        soon = self._scenarios.renew, self.robots.choices.renew, self.observers.restore
        self._late = LateImports(lambda: self.hold.motion.moving, self, first=soon)
        self._place = WindowPlace(self, settings)
        self._place.restore()

    def _arrange(self) -> None:
        self._column = layouts.vbox(self, margins_px=0, spacing_px=0)
        self._column.addWidget(self._top_bar)
        self._column.addWidget(self._protocol)
        self._column.addWidget(self.practice)
        holder = layouts.vbox(margins_px=(8, 4, 8, 4))
        self._middle = QSplitter(Qt.Orientation.Vertical, childrenCollapsible=False)
        self._middle.setObjectName("middle")
        self._middle.setHandleWidth(8)
        self._middle.addWidget(self.dock_host)
        holder.addWidget(self._middle)
        self._column.addLayout(holder, 1)
        self._column.addWidget(self.status_bar)

    def _connect(self) -> None:
        top_bar, state = self._top_bar, self._console.state
        top_bar.start_requested.connect(self.sessions.open_start_dialog)
        top_bar.scenario_menu_requested.connect(self.menus.open_scenario_menu)
        top_bar.window_menu_requested.connect(self.menus.open_window_menu)
        self.sessions.begun.connect(top_bar.show_details)
        if state.present.live:
            state.recording.changed.connect(self._saved.show_recording)
        for known in (self.sessions.recent_changed, self._scenarios.changed, self.robots.choices.changed):
            known.connect(self._renew_palette)
        self.status_bar.connection_clicked.connect(self._connection.open)
        self._connection.diagnostics_requested.connect(partial(self.board.open_and_focus, "diagnostics"))
        self._alarms.log_requested.connect(partial(self.board.open_and_focus, "session"))
        self._connection.robots_requested.connect(self.menus.open_robot_menu)
        self.board.window_requested.connect(self.sessions.open)
        self.board.window_requested.connect(self.faces.open)
        self.layout_keeper.noticed.connect(self.problems.show_problem)
        for step_back in (
            self._palette_overlay.close_overlay, self._sheet.step_back, self._connection.close_overlay,
            self._preflight.close_overlay, self._alarms.close_overlay, self.first_use.close,
            self._question.put_away, self._saved.put_away, self.sessions.close_the_active_one,
            partial(self.help.close, only_active=True),
        ):  # fmt: skip
            self.hold.escape_pressed.connect(step_back)
        self.hold.help_requested.connect(self.help.open)
        self.hold.close_refused.connect(self.closing.report_refused)
        self.hold.set_emergency_button(top_bar.emergency)
        self._emergency_copy.pressed.connect(lambda: self._console.do(intents.EmergencyStop()))
        state.event_happened.connect(self._on_event)
        state.scenario.changed.connect(self._on_scenario_changed)
        self._palette_latched = state.drive.value.emergency_stop
        state.drive.changed.connect(self._on_drive_changed)

    def _picture_seen(self) -> bool:
        video = self.board.made_so_far.get("video")
        return video is not None and video.in_view and not self.board.building

    # ---- late wiring

    def use_gamepads(self, gamepads: Gamepads) -> None:
        """Connect the gamepad: driving, stop and button bindings, and its dialog."""
        self.gamepad.use_gamepads(gamepads)
        self.talking.use_gamepads(gamepads)

    def use_explorer(self, explorer: "LiveRobotExplorer") -> None:
        """Enable robot discovery and saving profiles."""
        self.robots.use_explorer(explorer)

    def use_library(self, library: "LiveSessionLibrary") -> None:
        """Enable the session library: find, replay and export sessions."""
        self.sessions.use_library(library)
        self.board.use_library()

    def use_replay(self, replay: "ReplayConsole") -> None:
        """Show a recorded session, with the timeline and the replay bar below the panels."""
        from caris_desktop.ui.replay.timeline_view import ReplayWidgets

        self._replay = replay
        self.actions_table.drop_all_but((SAFETY_GROUP, WINDOW_GROUP, SPEAKING_GROUP))
        self.actions_table.rebuild(self._console.scenario)
        self._top_bar.show_replay(replay.live_robots)
        self.status_bar.show_replay()
        self._strip.use_replay()
        self._protocol.show_replay(replay.overview)
        self._protocol.moment_requested.connect(replay.seek)
        self.closing.use_replay()
        self.layout_keeper.use_replay()
        parts = ReplayWidgets(self.theme, replay, self._console.state, self.actions_table)
        # Rebuilt for a replay, without Photo for example.
        self.show_scenario(self._console.scenario)
        parts.arrange(self.dock_host, self._middle, self._column, self.status_bar)
        self._replay_parts = parts
        replay.noticed.connect(self.problems.show_problem)
        self.problems.line.clicked.connect(parts.show_panels)
        self.board.moment_requested.connect(replay.seek)
        self.hold.escape_pressed.connect(parts.timeline.acts.give_up)
        self._place.use_replay()
        self._focus_first()
        self.setWindowTitle(self._title(self._console.scenario))

    # ---- display

    @property
    def panels(self) -> dict[PanelName, Panel]:
        """Panels of the current scenario."""
        return self.board.panels

    def show_scenario(self, scenario: Scenario) -> None:
        """Rebuild panels, actions and shortcuts for ``scenario``, now; everything else keeps running."""
        self._begin_scenario(scenario)
        self.board.complete()
        self.observers.complete()

    def _begin_scenario(self, scenario: Scenario) -> None:
        """Like :meth:`show_scenario`, over several turns of the event loop; what is not permitted
        disappears at once.
        """
        self._shown_scenario = scenario
        self.board.begin(scenario, self._on_arranged, self.layout_keeper.begin)
        self._top_bar.show_scenario()
        self.status_bar.refresh()
        self.observers.show_scenario()
        self.setWindowTitle(self._title(scenario))

    def _on_arranged(self, tree: LayoutNode) -> None:
        if self._replay_parts is not None:
            self._replay_parts.fit()
        self.layout_keeper.begin_with(tree)
        if not self._began:
            self._began = True
            self._focus_first()

    def _title(self, scenario: Scenario) -> str:
        session = "" if self._replay is None else self._replay.session.folder.name
        replay = tr("Replay of {session}").format(session=session) if session else ""
        return " · ".join(part for part in (replay, scenario.title, "CARIS Desktop") if part)

    def open_panel(self, name: PanelName) -> None:
        """Raise the panel; one that the scenario does not have is added in a tab."""
        self.board.open(name)

    def close_panel(self, name: PanelName) -> None:
        """Close the panel; an added one is removed."""
        self.board.close(name)

    def _open_scenario(self, path: Path) -> None:
        """Open another scenario; confirms first if that would end the video or sound of a running recording."""

        def switch() -> None:
            self._console.do(intents.OpenScenario(path))

        def compare(scenario: Scenario | None) -> None:
            ends = [] if scenario is None else _ends_of_recording(self._console.scenario, scenario)
            if scenario is None or not ends:
                switch()
                return
            question = tr(
                "“{title}” does not record {what}, so the rest of this recording will not contain it. Switch the "
                "scenario?"
            )
            title = text_formatting.shortened(scenario.title, 40)
            self._question.ask(question.format(title=title, what=", ".join(ends)), tr("Switch"), switch)

        if self._console.state.recording.value.state in IN_SESSION:
            read_for(self, self._console, partial(_read_scenario, path), compare)
        else:
            switch()

    def _on_scenario_changed(self, scenario: Scenario) -> None:
        before = self._shown_scenario
        if scenario is before:
            return
        reset = self.layout_keeper.takes_reset()
        if before is not None and not reset and same_panels(before, scenario, self.dock_host.tree):
            self._shown_scenario = scenario
            self.layout_keeper.follow(scenario)
            self._top_bar.show_scenario()
            return
        self._begin_scenario(scenario)

    def _focus_first(self) -> None:
        if self._replay_parts is not None:
            self._replay_parts.take_focus()
        elif not self.focus_driving():
            self.focus_speak()

    # ---- callbacks of the action table

    def focus_driving(self) -> bool:
        """Focus a panel where the bare keys drive; False if the scenario has none."""
        return self.board.focus_driving()

    def focus_speak(self) -> None:
        self.board.focus("speak")

    def focus_queue(self) -> None:
        panel = self.board.panels.get("speak")
        if panel is not None:
            self.board.open("speak")
            panel.focus_list()

    def edit_suggestion(self, rank: int) -> str:
        """Edit a suggested reply in the Speak field before it is said."""
        console, panel = self._console, self.board.panels.get("speak")
        card = next((card for card in console.state.suggestions.value.cards if card.rank == rank), None)
        if card is None or panel is None:
            return tr("This suggestion is not available now.")
        self.board.open("speak")
        text = text_formatting.with_names(card.text, lambda person_id: name_of(console, person_id))
        panel.edit_first(
            text, lambda edited_text: not console.do(intents.SayEditedSuggestion(card.suggestion_id, edited_text))
        )
        return ""

    def show_next_phrases(self) -> None:
        state = self._console.state
        state.choose_phrases(state.phrase_group.value + 1)

    def show_next_camera(self) -> None:
        self._console.state.choose_next_camera()

    def show_command_palette(self) -> None:
        self._palette_overlay.open_with(self.palette_entries())
        self.sessions.find_recent()

    def search_said(self) -> None:
        """Raise the conversation panel and focus its search field."""
        self.open_panel("conversation")
        self.panels["conversation"].open_search()

    def show_shortcuts(self) -> None:
        self._sheet.open()

    def show_help(self) -> None:
        self.help.open()

    def show_set_up(self) -> None:
        self.first_use.open()

    def undo_layout(self) -> None:
        self.layout_keeper.soon(self.layout_keeper.undo)()

    def show_preflight(self) -> None:
        self._preflight.open()

    def palette_entries(self) -> list[PaletteItem]:
        """Commands and items of the command palette now."""
        return self._entries.now() if self._replay is None else self._entries.of_replay(self._replay)

    # ---- events

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        if drive.emergency_stop != self._palette_latched:
            self._renew_palette()
        self._palette_latched = drive.emergency_stop

    def _renew_palette(self) -> None:
        if self._palette_overlay.isVisible():
            self._palette_overlay.renew(self.palette_entries())

    def _on_event(self, event: object) -> None:
        # In a replay, recorded problems are history.
        if isinstance(event, Problem) and self._replay is None:
            self.problems.add(event)

    def changeEvent(self, event: QEvent) -> None:
        super().changeEvent(event)
        if event.type() == QEvent.Type.WindowStateChange and self.isMinimized():
            self.hold.release_all(QT_TR_NOOP("The window was minimised"))

    def show_in_place(self) -> None:
        """Show the window at its last position. The first time it is maximised on a small screen."""
        self._place.show()
        if self._replay is None:
            self._late.begin()

    def closeEvent(self, event: QCloseEvent) -> None:
        if self.closing.asks_first(event) or self.editor.asks_first(by_a_person=self.closing.by_a_person(event)):
            event.ignore()
            return
        self._place.save()
        self.layout_keeper.rest.stop()
        self._late.end()
        self.sessions.close()
        self.help.close()
        self.faces.close()
        self.observers.end()
        self.editor.close()
        self.talking.let_go()
        self.hold.close()
        self.closed.emit()
        super().closeEvent(event)

    def _on_first_paint(self) -> None:
        self.removeEventFilter(self._first_paint)
        QTimer.singleShot(0, self, self.painted.emit)


def _read_scenario(path: Path) -> Scenario | None:
    """The scenario; None for an unreadable file, whose error is reported when it is opened."""
    try:
        return load_scenario(path)
    except ScenarioError:
        return None


def _ends_of_recording(before: Scenario, after: Scenario) -> list[str]:
    """Data recorded now but not with the other scenario; empty unless video or sound ends."""
    was, will_be = before.permissions, after.permissions
    ends = [tr("video")] if was.video_recording and not will_be.video_recording else []
    ends += [tr("sound")] if was.audio_recording and not will_be.audio_recording else []
    return [*ends, tr("photos")] if ends and was.photos and not will_be.photos else ends


def same_panels(before: Scenario, after: Scenario, arranged: LayoutNode | None) -> bool:
    """Whether no panel of a changed scenario needs a rebuild, so that text being typed is not lost.

    True if only a place was saved or removed (panels follow ``state.places``), or the current layout was saved.
    """
    moved = replace(after, places=before.places, path=before.path, sha256=before.sha256)
    if moved == before:
        return before.places != after.places or _has_panels_of(after, arranged)
    layouts_before = {name: getattr(before, name) for name in ("layout", "layout_compact", "layout_large")}
    return replace(moved, **layouts_before) == before and _has_panels_of(after, arranged)


def _has_panels_of(scenario: Scenario, arranged: LayoutNode | None) -> bool:
    return arranged is not None and set(panels_in(scenario.layout)) == set(panels_in(arranged))
