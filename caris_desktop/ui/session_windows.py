"""Session windows: start dialog, session list, export dialog."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Signal
from PySide6.QtWidgets import QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.trial_details import TrialDetails
from caris_desktop.live.services.microphone_service import participant_microphone
from caris_desktop.live.status import IN_SESSION, CrashRecoveryStatus, LibraryStatus, RecordingStatus
from caris_desktop.live.wizard_console import BeforeRecording, SessionLibrary, WizardConsole
from caris_desktop.recording.studies.study_query import SessionEntry, SessionQuery
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.window_place import bring_up
from caris_desktop.ui.wizard_profiles import WizardProfiles

if TYPE_CHECKING:  # imported at first use
    from caris_desktop.ui.export_dialog import ExportDialog
    from caris_desktop.ui.sessions_window import SessionsWindow
    from caris_desktop.ui.start_dialog import StartDialog

RECENT_SESSIONS = 8


class SessionWindows(QObject):
    """Opens these windows, one of each, owned by ``window``; all but the first need a library."""

    begun = Signal(object)  # TrialDetails of the recording being started
    recent_changed = Signal()

    def __init__(self, theme: Theme, console: WizardConsole, wizards: WizardProfiles, window: QWidget) -> None:
        super().__init__(window)
        self._theme = theme
        self._console = console
        self._wizards = wizards
        self._window = window
        self._library: SessionLibrary | None = None
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

    def use_library(self, library: SessionLibrary) -> None:
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
        from caris_desktop.ui.start_dialog import RecordingOffer, StartDialog, last_details

        console = self._console
        offer = RecordingOffer(
            console.scenario.permissions, console.microphones(), console.microphone, console.scenario.blur,
            participant_microphone(console.scenario, console.state.robot.value) == "computer",
        )  # fmt: skip
        dialog = self._start = StartDialog(self._theme, self._window, offer, console)

        def know(before: BeforeRecording) -> None:
            if self._start is dialog:
                wizard = self._wizards.current or before.suggested.wizard
                before = replace(before, suggested=replace(before.suggested, wizard=wizard))
                dialog.know(before, last_details(before.suggested, self._last))

        self._start.microphone_chosen.connect(lambda name: console.do(intents.UseMicrophone(name)))
        self._start.begin.connect(self._on_begin)
        self._start.finished.connect(self._on_start_finished)
        self._start.open()
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
