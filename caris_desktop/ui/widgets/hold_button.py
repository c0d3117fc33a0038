"""Long-press button for commands that must not happen by accident."""

from PySide6.QtCore import QElapsedTimer, QPoint, QRectF, QTimer, Signal
from PySide6.QtGui import QFocusEvent, QHideEvent, QMouseEvent, QPainter, QPainterPath, QPaintEvent

from caris_desktop.ui import tokens
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton

HOLD_MS = 1000
_STEP_MS = 30


class HoldButton(ActionButton):
    """``held`` after a second of holding by mouse or Space; ``let_go`` on an earlier release.

    While ``wants_hold`` is False it is an ordinary button that emits ``clicked``.
    """

    held = Signal()
    let_go = Signal()

    def __init__(self, theme: Theme, text: str, *, icon: str, height_px: int, text_px: int) -> None:
        super().__init__(theme, text, icon=icon, height_px=height_px, text_px=text_px)
        self.wants_hold = True
        self._spent = False
        self._since = QElapsedTimer()
        self._progress = QTimer(self, interval=_STEP_MS)
        self._progress.timeout.connect(self._on_progress)
        self.pressed.connect(self._on_pressed)
        self.released.connect(self._on_released)

    @property
    def holding(self) -> bool:
        return self._progress.isActive()

    def give_up(self) -> None:
        """Cancel: a button still down does nothing."""
        if self.holding:
            self._progress.stop()
            self.update()

    def _on_pressed(self) -> None:
        if self.wants_hold:
            self._since.start()
            self._progress.start()

    def _on_progress(self) -> None:
        if self._since.elapsed() >= HOLD_MS:
            self._progress.stop()
            # The following release must not count as a click, which would do the opposite.
            self._spent = True
            self.setDown(False)
            self.held.emit()
        self.update()

    def _on_released(self) -> None:
        if self.holding:
            self.give_up()
            self.let_go.emit()

    def hitButton(self, pos: QPoint) -> bool:
        return not self._spent and super().hitButton(pos)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self._spent = False
        super().mousePressEvent(event)

    def hideEvent(self, event: QHideEvent) -> None:
        self.give_up()
        super().hideEvent(event)

    def focusOutEvent(self, event: QFocusEvent) -> None:
        self.give_up()
        super().focusOutEvent(event)

    def paintEvent(self, event: QPaintEvent) -> None:
        super().paintEvent(event)
        if self.holding:
            painter = QPainter(self)
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            whole = QPainterPath()
            whole.addRoundedRect(QRectF(self.rect()), tokens.CONTROL_RADIUS_PX, tokens.CONTROL_RADIUS_PX)
            painter.setClipPath(whole)
            done = min(1.0, self._since.elapsed() / HOLD_MS)
            painter.fillRect(QRectF(0, self.height() - 4, self.width() * done, 4), self._theme.color("amber"))
