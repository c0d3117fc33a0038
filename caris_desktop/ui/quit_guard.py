"""Quit guard: confirms before closing the window ends something, and reports why the window stays open; progress
window for work that is completed while the program quits.
"""

import time
from collections.abc import Callable, Sequence

from PySide6.QtCore import QEventLoop, QObject, Qt
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QApplication, QProgressBar, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.live.background_worker import do_in_parallel
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts
from caris_desktop.ui.banners import QuestionBanner
from caris_desktop.ui.notifications import NotificationPopups
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.widgets.labels import label
from caris_desktop.ui.windows import motion_that_ends


class QuitGuard(QObject):
    """Quit guard of the main window; closes ``overlays``, which would cover the question."""

    def __init__(
        self,
        window: QWidget,
        console: WizardConsole,
        question: QuestionBanner,
        problems: NotificationPopups,
        overlays: Sequence[Overlay],
    ) -> None:
        super().__init__(window)
        self._window = window
        self._console = console
        self._question = question
        self._problems = problems
        self._overlays = overlays
        self._replay = self._wished = self._agreed = False

    def use_replay(self) -> None:
        """Switch to a replay, where closing ends nothing."""
        self._replay = True

    def asks_first(self, event: QCloseEvent) -> bool:
        """Whether a person closes the window and is now asked to confirm what ends with it."""
        ends = self.what_ends() if self.by_a_person(event) and not self._agreed else []
        if ends:
            self._ask(ends)
        return bool(ends)

    def by_a_person(self, event: QCloseEvent) -> bool:
        return event.spontaneous() or self._wished

    def close_window(self) -> None:
        """Close by command, with the same confirmation as the window's close button."""
        self._wished = True
        self._window.close()
        self._wished = False

    def what_ends(self) -> list[str]:
        if self._replay:
            return []
        saved = self._console.state.recording.value.state in ("starting", "recording", "paused")
        return [
            *([tr("The recording will stop and be saved.")] if saved else []),
            *motion_that_ends(self._console.state),
        ]

    def _ask(self, ends: list[str]) -> None:
        for overlay in self._overlays:
            overlay.close_overlay()
        if self._window.isMinimized():
            self._window.showNormal()
        question = " ".join((tr("Close the console?"), *ends))
        self._question.ask(question, tr("Close the console"), lambda: self._on_agreed(ends))

    def _on_agreed(self, confirmed: list[str]) -> None:
        ends = self.what_ends()
        if set(ends) <= set(confirmed):
            self._agreed = True
            self.close_window()
            self._agreed = False
        else:
            self._ask(ends)

    def report_refused(self) -> None:
        """Report that the window stays open because the robot is being driven."""
        advice = tr("Release the drive keys and Alt, then close the window.")
        self._problems.notify(tr("The window stays open while you drive."), "", advice)


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
