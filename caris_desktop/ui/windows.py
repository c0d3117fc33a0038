"""Windows opened from the main window, one of each, imported at first use: robot discovery, start dialog, session list,
export dialog, gamepad dialog, face and its editor, scenario editor.
"""

import logging
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Qt, Signal
from PySide6.QtWidgets import QMenu, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.events import GoalChanged, TrialDetails
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.translation import tr
from caris_desktop.live.gamepad import Gamepads
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import (
    IN_SESSION,
    CrashRecoveryStatus,
    DriveStatus,
    FaceStatus,
    LibraryStatus,
    LinkStatus,
    RecordingStatus,
)
from caris_desktop.live.wizard_console import BeforeRecording, WizardConsole
from caris_desktop.recording.studies.study_query import SessionEntry, SessionQuery
from caris_desktop.robot.profile import ListedProfile
from caris_desktop.scenario.scenario_file import own_file
from caris_desktop.ui.background_reading import Remembered, read_for
from caris_desktop.ui.banners import QuestionBanner
from caris_desktop.ui.input.drive_input_filter import DriveInputFilter
from caris_desktop.ui.menus import add_choices
from caris_desktop.ui.preferences import WizardProfiles
from caris_desktop.ui.text_formatting import UNDER_WAY, in_menu, shortened
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.window_place import bring_up, raise_window

if TYPE_CHECKING:
    from caris_desktop.live.robot_explorer import LiveRobotExplorer
    from caris_desktop.live.session_library import LiveSessionLibrary
    from caris_desktop.ui.export_dialog import ExportDialog
    from caris_desktop.ui.face_window import FaceWindow
    from caris_desktop.ui.scenario_editor.editor_window import ScenarioEditor
    from caris_desktop.ui.scenario_editor.saving import Opened
    from caris_desktop.ui.sessions_window import SessionsWindow
    from caris_desktop.ui.start_dialog import StartDialog

RECENT_SESSIONS = 8
_log = logging.getLogger(__name__)


class _Windows(QObject):
    """Windows owned by ``window``."""

    def __init__(self, theme: Theme, console: WizardConsole, window: QWidget) -> None:
        super().__init__(window)
        self._theme = theme
        self._console = console
        self._window = window


def motion_that_ends(state: LiveState) -> list[str]:
    """Motions that would end with the current link, as sentences."""
    drive: DriveStatus = state.drive.value
    goal: GoalChanged | None = state.goal.value
    present = shortened(state.link.value.robot, 40) or tr("The current robot")
    if goal is not None and goal.state in UNDER_WAY:
        place = shortened(goal.place or "", 40) or tr("a point on the map")
        return [tr("{robot} is on its way to {place} and will stop.").format(robot=present, place=place)]
    if drive.target_forward_mps or drive.target_left_mps or drive.target_turn_radps:
        return [tr("{robot} is being driven and will stop.").format(robot=present)]
    return []


class RobotChooser(_Windows):
    """Connects another robot. Discovery of robots without a profile needs an explorer."""

    def __init__(self, theme: Theme, console: WizardConsole, question: QuestionBanner, window: QWidget) -> None:
        super().__init__(theme, console, window)
        self._question = question
        self._explorer: LiveRobotExplorer | None = None
        self.choices = Remembered(console, self._read, self)

    def _read(self) -> Sequence[ListedProfile]:
        return self._console.robots()

    @property
    def can_detect(self) -> bool:
        """Whether discovery is available."""
        return self._explorer is not None

    def use_explorer(self, explorer: "LiveRobotExplorer") -> None:
        """Enable robot discovery and saving profiles."""
        self._explorer = explorer

    def choose(self, choice: ListedProfile) -> None:
        """Connect another robot, after confirmation if that ends something."""
        lost = motion_that_ends(self._console.state)
        if self._console.state.recording.value.state in ("recording", "starting"):
            lost.append(tr("The recording continues with the other robot."))
        ends = " ".join(lost)
        if not ends:
            self._use(choice)
            return
        self._question.ask(
            tr("Connect to {robot} now? {consequences}").format(robot=choice.title, consequences=ends),
            tr("Connect to {robot}").format(robot=choice.title),
            lambda: self._use(choice),
        )

    def others(self) -> list[ListedProfile]:
        """Robots to which the console can switch."""
        return [choice for choice in self.choices.now() if not self._is_current(choice) and not choice.error]

    def fill_menu(self, menu: QMenu) -> None:
        """Fill the menu with the robots and an entry for discovery."""
        menu.clear()
        menu.setToolTipsVisible(True)
        choices, unusable = self.choices.now(), tr("{robot} · cannot be used")
        titles = [unusable.format(robot=each.title) if each.error else each.title for each in choices]
        rows = zip(titles, choices, strict=True)
        actions = add_choices(
            menu, ((in_menu(title), self._is_current(each), partial(self.choose, each)) for title, each in rows)
        )
        for action, choice in zip(actions, choices, strict=True):
            action.setEnabled(not choice.error)
            action.setToolTip(choice.error or choice.address)
        if self.can_detect:
            menu.addSeparator()
            menu.addAction(tr("Connect another robot…")).triggered.connect(self.open_dialog)

    def open_dialog(self) -> None:
        """Open the discovery dialog. One at a time."""
        if self._explorer is None:
            return
        from caris_desktop.ui.robot_dialog import RobotDialog

        dialog = self._window.findChild(RobotDialog)
        if dialog is None:
            link: LinkStatus = self._console.state.link.value
            dialog = RobotDialog(self._theme, self._explorer, self._window, address=link.address)
            dialog.saved.connect(self._on_saved)
        raise_window(dialog)

    def _on_saved(self, choice: ListedProfile) -> None:
        self.choices.renew()  # an open list gets the new profile
        self.choose(choice)

    def _use(self, choice: ListedProfile) -> None:
        # Opening a refused profile has reported the reason.
        self._console.do(intents.UseRobot(choice.name))

    def _is_current(self, choice: ListedProfile) -> bool:
        robot = self._console.state.robot.value
        if robot is not None:
            return bool(robot.name == choice.name)
        return bool(self._console.state.link.value.robot == choice.title)


class SessionWindows(_Windows):
    """Opens these windows, one of each, owned by ``window``; all but the first need a library."""

    begun = Signal(object)  # TrialDetails of the recording being started
    recent_changed = Signal()

    def __init__(self, theme: Theme, console: WizardConsole, wizards: WizardProfiles, window: QWidget) -> None:
        super().__init__(theme, console, window)
        self._wizards = wizards
        self._library: LiveSessionLibrary | None = None
        self._start: StartDialog | None = None
        self._sessions: SessionsWindow | None = None
        self._export: ExportDialog | None = None
        self._last: TrialDetails | None = None
        self._looked = False
        self.recent: tuple[SessionEntry, ...] = ()
        """The newest sessions of the study, as far as somebody asked for them."""
        console.state.recording.changed.connect(self._on_recording_changed)

    @property
    def has_library(self) -> bool:
        return self._library is not None

    def use_library(self, library: "LiveSessionLibrary") -> None:
        self._library = library
        library.found.changed.connect(self._on_found)

    def find_recent(self) -> None:
        """Refresh ``recent`` in the background: once after each recording, never during one."""
        recording = self._console.state.recording.value.state in IN_SESSION
        visible = self._sessions is not None and self._sessions.isVisible()
        if self._library is not None and not (self._looked or recording or visible):
            self._looked = True
            self._library.find(SessionQuery())

    def _on_found(self, status: LibraryStatus) -> None:
        newest = status.sessions[:RECENT_SESSIONS]
        if status.query == SessionQuery() and not status.updating and newest != self.recent:
            self.recent = newest
            self.recent_changed.emit()

    def open_replay(self, folder: Path) -> None:
        """Open the replay in a separate window."""
        if self._library is not None:
            self._library.open_replay(folder)

    def open(self, name: str) -> None:
        """Open a window that a panel requested, by WindowName."""
        match name:
            case "start":
                self.open_start_dialog()
            case "export":
                self.export_last_session()
            case "sessions":
                self.open_sessions()

    def open_start_dialog(self) -> None:
        """Open the start dialog, which then starts recording. One at a time."""
        if self._start is not None:
            self._start.raise_()
            return
        if self._console.state.going_on.value.unconfirmed:
            # The refusal comes before anything is filled in.
            self._console.do(intents.StartRecording(TrialDetails()))
            return
        from caris_desktop.ui.start_dialog import StartDialog, last_details

        console = self._console
        dialog = self._start = StartDialog(self._theme, self._window, console)

        def know(before: BeforeRecording) -> None:
            if self._start is dialog:
                wizard = self._wizards.current or before.suggested.wizard
                before = replace(before, suggested=replace(before.suggested, wizard=wizard))
                dialog.know(before, last_details(before.suggested, self._last))

        self._start.begin.connect(self._on_begin)
        self._start.finished.connect(self._on_start_finished)
        dialog.setWindowModality(Qt.WindowModality.WindowModal)
        dialog.resize(dialog.sizeHint())
        bring_up(dialog)
        console.check_before_recording(know)

    def record_next_part(self) -> None:
        """Record the next part of a resumed trial at once. The start dialog, with the last trial filled in, opens only
        where a check asks first.
        """
        status: CrashRecoveryStatus = self._console.state.going_on.value
        if status.state == "confirmed" and not any(check.asks_first for check in self._console.state.preflight.value):
            wizard = self._wizards.current or status.details.wizard
            self._on_begin(replace(status.details, wizard=wizard, recording=""), anyway=False)
            return
        self.open_start_dialog()
        if self._start is not None:
            self._start.use_last_trial()

    def _on_begin(self, details: TrialDetails, anyway: bool) -> None:
        self._last = details
        if details.wizard:
            self._wizards.choose(details.wizard)
        self.begun.emit(details)
        self._console.do(intents.StartRecording(details, anyway))

    def _on_start_finished(self, _result: int) -> None:
        self._start = None

    def open_sessions(self) -> None:
        """Open the session list in a separate window."""
        if self._library is None:
            return
        from caris_desktop.ui.sessions_window import SessionsWindow

        if self._sessions is None:
            self._sessions = SessionsWindow(self._theme, self._library, self._window)
            self._sessions.export_requested.connect(self.open_export)
            self._on_recording_changed(self._console.state.recording.value)
        bring_up(self._sessions)

    def open_export(self, sessions: Sequence[Path]) -> None:
        """Open the export dialog for these sessions in a separate window."""
        if self._library is None:
            return
        from caris_desktop.ui.export_dialog import ExportDialog

        if self._export is None:
            self._export = ExportDialog(self._theme, self._library, sessions, self._window)
        else:
            self._export.show_sessions(sessions)
        bring_up(self._export)

    def export_last_session(self) -> None:
        folder = self._console.state.recording.value.folder
        if folder is not None:
            self.open_export([folder])

    def close(self) -> None:
        for window in (self._export, self._sessions):
            if window is not None:
                window.close()

    def close_the_active_one(self) -> None:
        """Close the active one; a stop from the main window leaves them open."""
        for window in (self._export, self._sessions):
            if window is not None and window.isActiveWindow():
                window.close()

    def _on_recording_changed(self, status: RecordingStatus) -> None:
        if status.state in IN_SESSION:
            self._looked = False
        if self._sessions is None:
            return
        self._sessions.show_recording(status.folder if status.state in IN_SESSION else None)
        if status.state == "idle" and self._sessions.isVisible():
            self._sessions.refresh()  # includes the new session


class GamepadWindow(_Windows):
    """Connects a gamepad to driving, and opens the dialog in scenarios that drive."""

    def __init__(self, theme: Theme, console: WizardConsole, hold: DriveInputFilter, window: QWidget) -> None:
        super().__init__(theme, console, window)
        self._hold = hold
        self._gamepads: Gamepads | None = None

    @property
    def offered(self) -> bool:
        return self._gamepads is not None and self._console.scenario.permissions.driving

    def use_gamepads(self, gamepads: Gamepads) -> None:
        """Connect the gamepad: driving, stop and button bindings, and its dialog."""
        if gamepads is not self._gamepads:
            self._gamepads = gamepads
            self._hold.use_gamepads(gamepads)

    def open(self) -> None:
        """Show the gamepad dialog. Non-modal: the robot can be stopped meanwhile."""
        if self._gamepads is None:
            return
        from caris_desktop.ui.gamepad_dialog import GamepadDialog

        raise_window(
            self._window.findChild(GamepadDialog)
            or GamepadDialog(self._theme, self._console.state, self._gamepads, self._window)
        )


class FaceWindows(_Windows):
    """Opens and closes the windows according to ``state.face``."""

    def __init__(self, theme: Theme, console: WizardConsole, window: QWidget) -> None:
        super().__init__(theme, console, window)
        self._face: FaceWindow | None = None
        console.state.face.changed.connect(self._on_face)

    def open(self, name: str) -> None:
        """Open a window that a panel requested, by WindowName."""
        if name == "face":
            self.edit()

    def edit(self) -> None:
        """Open the face editor."""
        from caris_desktop.ui.face_window import FaceEditor

        raise_window(self._window.findChild(FaceEditor) or FaceEditor(self._theme, self._console, self._window))

    def close(self) -> None:
        for window in (self._face, self._window.findChild(QWidget, "face_editor")):
            if window is not None:
                window.close()
        self._face = None

    def _on_face(self, status: FaceStatus) -> None:
        if not self._console.state.present.live or status.window == (self._face is not None):
            return
        if self._face is not None:
            self._face.close()
            self._face.deleteLater()
            self._face = None
            return
        from caris_desktop.ui.face_window import FaceWindow

        self._face = FaceWindow(self._console.state, self._window)
        self._face.closed_by_hand.connect(lambda: self._console.do(intents.ShowFaceWindow(False)))
        self._face.show()


class ScenarioEditorWindow(_Windows):
    """One scenario editor owned by ``window``. Non-modal: the robot can be driven and stopped meanwhile."""

    def __init__(self, theme: Theme, console: WizardConsole, window: QWidget) -> None:
        super().__init__(theme, console, window)
        self.editor: ScenarioEditor | None = None
        self._opening = False

    def open(self) -> None:
        """Edit the current scenario. An open editor is raised with its contents; one of another scenario is closed,
        after a question about unsaved changes.
        """
        from caris_desktop.ui.scenario_editor.saving import opened_as_form

        if self.editor is not None:
            scenario = self._console.scenario
            if self.editor.document.path == own_file(scenario.path) or self.editor.document.path == scenario.path:
                bring_up(self.editor)
            elif self.editor.unsaved:
                bring_up(self.editor)
                message = tr(
                    "The editor shows a different scenario than “{open}”, and your changes in it are not saved."
                )
                self.editor.ask_before_closing(message.format(open=scenario.title), self.open)
            else:
                self.editor.close()
                self.open()
        elif not self._opening:
            self._opening = True
            read_for(self, self._console, partial(opened_as_form, self._console.scenario), self._show, self._on_failed)

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
