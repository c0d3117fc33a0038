"""Card after a recording: the session is saved, and what can be done with it next."""

from collections.abc import Callable

from PySide6.QtCore import QUrl
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.live.status import IN_SESSION, RecordingStatus
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.session_windows import SessionWindows
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.popups import DockCard


class SavedSessionCard(DockCard):
    """Stays until it is closed, one of its buttons is used, or the next recording starts."""

    def __init__(self, theme: Theme, over: QWidget, sessions: SessionWindows, now_ns: Callable[[], int]) -> None:
        super().__init__(theme, over, tone="green")
        self.setObjectName("saved_session_card")
        self.text.setObjectName("saved_session_text")
        self._sessions = sessions
        self._now_ns = now_ns
        self._status = RecordingStatus()
        self._lasted = ""
        self._replay = self._button("replay", tr("Replay"), "play", self._open_replay)
        export = self._button("export", tr("Export…"), "export", sessions.export_last_session)
        folder = self._button("folder", tr("Open folder"), "folder-open", self._open_folder)
        close = self._button("close", tr("Close"), "x", lambda: None)
        self.column.addSpacing(4)
        self.column.addLayout(layouts.hbox(None, self._replay, export, folder, 1, close, spacing_px=tokens.GRID_PX))

    def show_recording(self, status: RecordingStatus) -> None:
        """Open the card when a recording has ended as it should; failures have a message of their own."""
        before, self._status = self._status, status
        if status.state == "stopping" and before.state != "stopping":
            self._lasted = text_formatting.elapsed((self._now_ns() - status.started_ns) / 1e9)
        if status.state in IN_SESSION:
            self.hide()
        elif status.state == "idle" and before.state == "stopping" and status.folder is not None:
            self.heading.setText(tr("The session is saved"))
            size, missing = text_formatting.size(status.written_bytes), text_formatting.all_missing(status.dropped)
            self.text.setText(" · ".join(part for part in (status.folder.name, self._lasted, size, missing) if part))
            self._replay.setVisible(self._sessions.has_library)
            self.open()

    def put_away(self) -> None:
        self.hide()

    def _button(self, name: str, text: str, icon: str, act: Callable[[], None]) -> ActionButton:
        def clicked() -> None:
            self.hide()
            act()

        return ActionButton(
            self._theme, text, icon=icon, height_px=34, objectName=f"saved_session_{name}", clicked=clicked
        )

    def _open_replay(self) -> None:
        if self._status.folder is not None:
            self._sessions.open_replay(self._status.folder)

    def _open_folder(self) -> None:
        QDesktopServices.openUrl(QUrl.fromLocalFile(str(self._status.folder)))
