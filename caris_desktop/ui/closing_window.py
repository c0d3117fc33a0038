"""Progress window for work that is completed while the program quits."""

import time
from collections.abc import Callable

from PySide6.QtCore import QEventLoop, Qt
from PySide6.QtWidgets import QApplication, QProgressBar, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.live.background_worker import do_in_parallel
from caris_desktop.ui import layouts
from caris_desktop.ui.widgets.labels import label

SHOWN_AFTER_S = 0.7
_STEP_MS = 50


class ClosingWindow(QWidget):
    """Runs slow work in a thread and becomes visible if it takes longer than a moment."""

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("closing_window")
        self.setWindowTitle(tr("CARIS Desktop is closing"))
        self.setWindowFlag(Qt.WindowType.WindowCloseButtonHint, on=False)
        self._began_s = time.monotonic()
        self._label = label("", wraps=True, objectName="closing_what")
        self._since = label("", "small", objectName="closing_since")
        busy = QProgressBar(textVisible=False)
        busy.setRange(0, 0)
        layouts.vbox(self, self._label, busy, self._since, margins_px=(24, 20, 24, 20), spacing_px=12)
        self.setFixedWidth(420)

    def during(self, text: str, work: Callable[[], None]) -> None:
        """Run ``work``, which must not use Qt, and show ``text`` meanwhile. Returns when it is done."""
        self._label.setText(text)
        do_in_parallel(work, self._wait)

    def _wait(self) -> None:
        elapsed_s = time.monotonic() - self._began_s
        if elapsed_s > SHOWN_AFTER_S:
            self._since.setText(
                tr("Running for {time} s. Do not turn off the computer.").format(time=f"{elapsed_s:.0f}")
            )
            self.show()
        # No user input is processed: the program is quitting.
        QApplication.processEvents(QEventLoop.ProcessEventsFlag.ExcludeUserInputEvents, _STEP_MS)
