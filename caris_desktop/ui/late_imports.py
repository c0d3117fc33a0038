"""Deferred imports: modules not needed by the first window are imported piece by piece while nobody drives, so that
they cause no stall later.
"""

import importlib
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial

from PySide6.QtCore import QObject, QTimer

from caris_desktop.ui.panel_table import PANELS

BEGIN_AFTER_MS = 3000
EVERY_MS = 250

MODULES: tuple[str, ...] = (
    "caris_desktop.ui.start_dialog",
    "caris_desktop.ui.first_use.set_up_page",
    "caris_desktop.ui.gamepad_dialog",
    *(f"caris_desktop.ui.panels.{spec.name}_panel" for spec in PANELS.values()),
    # Dependencies of the dialogs below, in pieces that import quickly.
    "caris_desktop.recording.session.recovery",
    "caris_desktop.recording.annotation.annotation_store",
    "caris_desktop.recording.pseudonyms",
    "caris_desktop.recording.session_export",
    "caris_desktop.robot.profile_proposal",
    "caris_desktop.ui.sessions_window",
    "caris_desktop.ui.export_dialog",
    "caris_desktop.ui.robot_dialog",
    "caris_desktop.scenario.document",
    "caris_desktop.ui.scenario_editor.form",
    "caris_desktop.ui.scenario_editor.editor_window",
)


class LateImports(QObject):
    """Imports modules in idle turns of the event loop. ``busy`` says whether a stall would be felt now: a blocked GUI
    thread ends teleoperation.
    """

    def __init__(
        self,
        busy: Callable[[], bool],
        parent: QObject,
        modules: Sequence[str] = MODULES,
        *,
        first: Sequence[Callable[[], object]] = (),
    ) -> None:
        """``first`` are called before the imports: they load menus and reopen windows."""
        super().__init__(parent)
        self._first = tuple(first)
        self._busy = busy
        self._modules = tuple(modules)
        self._left: deque[Callable[[], object]] = deque()
        self._next = QTimer(self, interval=EVERY_MS)
        self._next.timeout.connect(self.import_next)
        self._begin = QTimer(self, singleShot=True, interval=BEGIN_AFTER_MS)
        self._begin.timeout.connect(self._next.start)

    def begin(self) -> None:
        """Start after the window is shown and idle."""
        imports = (partial(importlib.import_module, module) for module in self._modules)
        self._left = deque((*self._first, *imports))
        self._begin.start()

    def end(self) -> None:
        self._begin.stop()
        self._next.stop()

    def import_next(self) -> None:
        if self._busy():
            return
        if self._left:
            self._left.popleft()()
        if not self._left:
            self.end()
