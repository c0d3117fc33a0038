"""Face windows: the one that the participant sees, and the editor."""

from typing import TYPE_CHECKING

from PySide6.QtCore import QObject
from PySide6.QtWidgets import QWidget

from caris_desktop.domain import intents
from caris_desktop.live.status import FaceStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.window_place import raise_window

if TYPE_CHECKING:  # imported at first use
    from caris_desktop.ui.face.face_editor import FaceEditor
    from caris_desktop.ui.face.face_window import FaceWindow


class FaceWindows(QObject):
    """Opens and closes the windows according to ``state.face``."""

    def __init__(self, theme: Theme, console: WizardConsole, window: QWidget) -> None:
        super().__init__(window)
        self._theme = theme
        self._console = console
        self._window = window
        self._face: FaceWindow | None = None
        self._editor: FaceEditor | None = None
        console.state.face.changed.connect(self._on_face)

    def open(self, name: str) -> None:
        """Open a window that a panel requested, by WindowName."""
        if name == "face":
            self.edit()

    def edit(self) -> None:
        """Open the face editor."""
        from caris_desktop.ui.face.face_editor import FaceEditor

        if self._editor is None:
            self._editor = FaceEditor(self._theme, self._console, self._window)
            self._editor.finished.connect(self._on_edited)
        raise_window(self._editor)

    def close(self) -> None:
        for window in (self._face, self._editor):
            if window is not None:
                window.close()
        self._face = None

    def _on_edited(self, _result: int) -> None:
        if self._editor is not None:
            self._editor.deleteLater()
            self._editor = None

    def _on_face(self, status: FaceStatus) -> None:
        if not self._console.state.present.live or status.window == (self._face is not None):
            return
        if self._face is not None:
            self._face.close()
            self._face.deleteLater()
            self._face = None
            return
        from caris_desktop.ui.face.face_window import FaceWindow

        self._face = FaceWindow(self._console.state, self._window)
        self._face.closed_by_hand.connect(self._on_closed_by_hand)
        self._face.show()

    def _on_closed_by_hand(self) -> None:
        self._console.do(intents.ShowFaceWindow(False))
