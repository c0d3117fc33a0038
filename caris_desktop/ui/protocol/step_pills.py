"""Protocol steps in a row: as many around the current one as fit."""

from collections.abc import Sequence
from typing import Literal

from PySide6.QtCore import QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QFont, QFontMetricsF, QPainter, QPaintEvent, QPen, QResizeEvent
from PySide6.QtWidgets import QAbstractButton, QSizePolicy, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.ui import tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.theme import Theme

StepState = Literal["done", "skipped", "now", "late", "ahead"]

HEIGHT_PX = 28
_SIDE_PX, _ICON_PX, _GAP_PX = 12, 14, 6
_LEAST_PX = 130
_ICONS: dict[StepState, str] = {"done": "check", "skipped": "skip-forward", "now": "", "late": "", "ahead": ""}


class DisplayedStep(Value):
    """Step as displayed; ``time`` is set for the current one."""

    step_id: str
    number: int
    title: str
    state: StepState
    time: str = ""

    @property
    def text(self) -> str:
        if self.state in ("done", "skipped"):
            return self.title
        return f"{self.number} {self.title}" + (f" · {self.time}" if self.time else "")

    @property
    def words(self) -> str:
        """Accessible name and tooltip."""
        named = {
            "done": tr("Step {number}, {title}: done"),
            "skipped": tr("Step {number}, {title}: skipped"),
            "now": tr("Step {number}, {title}: now, {time}"),
            "late": tr("Step {number}, {title}: now, {time}"),
            "ahead": tr("Step {number}, {title}: not done yet"),
        }[self.state]
        return named.format(number=self.number, title=self.title, time=self.time)


class StepPill(QAbstractButton):
    """Button of a step. A click does not take the focus."""

    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(parent)
        self._theme = theme
        self._step = DisplayedStep("", 0, "", "ahead")
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)
        theme.changed.connect(self.update)

    @property
    def step(self) -> DisplayedStep:
        return self._step

    def show_step(self, step: DisplayedStep) -> None:
        if step != self._step:
            self._step = step
            self.setText(step.text)
            self.setAccessibleName(step.words)
            self.setToolTip(step.words)
            self.update()

    def wanted_px(self) -> int:
        # Measured with wide digits, so that a running time moves nothing.
        text = "".join("0" if sign.isdigit() else sign for sign in self.text())
        width = QFontMetricsF(self._font()).horizontalAdvance(text) + 2 * _SIDE_PX + 1
        width += _ICON_PX + 6 if _ICONS[self._step.state] else 0
        return round(width + (_ICON_PX + 4 if self._is_present else 0))

    def sizeHint(self) -> QSize:
        return QSize(self.wanted_px(), HEIGHT_PX)

    @property
    def _is_present(self) -> bool:
        return self._step.state in ("now", "late")

    def _font(self) -> QFont:
        return self._theme.font(
            tokens.STATUS_PX + 1, tokens.WEIGHT_SEMIBOLD if self._is_present else tokens.WEIGHT_NORMAL
        )

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme, state = self._theme, self._step.state
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        role = {"now": "blue", "late": "amber"}.get(state, "")
        ground = theme.color(f"{role}_soft") if role else theme.color("raised_hover" if self.underMouse() else "raised")
        ink = theme.color("text" if role else "dim")
        painter.setPen(QPen(theme.color(role), 1.4) if role else Qt.PenStyle.NoPen)
        painter.setBrush(ground)
        rect = QRectF(self.rect()).adjusted(0.7, 0.7, -0.7, -0.7)
        painter.drawRoundedRect(rect, rect.height() / 2, rect.height() / 2)
        if self.hasFocus():
            painter.setPen(QPen(theme.color("blue"), 2))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(rect.adjusted(1, 1, -1, -1), rect.height() / 2 - 1, rect.height() / 2 - 1)
        self._draw_content(painter, ink)

    def _draw_content(self, painter: QPainter, ink: QColor) -> None:
        left, right, middle = float(_SIDE_PX), self.width() - float(_SIDE_PX), self.height() / 2
        icon = _ICONS[self._step.state]
        if icon:
            draw_icon(painter, QRectF(left, middle - _ICON_PX / 2, _ICON_PX, _ICON_PX), icon, ink)
            left += _ICON_PX + 6
        if self._is_present:
            right -= _ICON_PX
            draw_icon(painter, QRectF(right + 2, middle - 6, 12, 12), "caret-down", ink)
            right -= 4
        font = self._font()
        painter.setFont(font)
        painter.setPen(ink)
        text = QFontMetricsF(font).elidedText(self.text(), Qt.TextElideMode.ElideRight, right - left + 1)
        painter.drawText(
            QRectF(left, 0, right - left + 2, self.height()),
            int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft),
            text,
        )


class StepPills(QWidget):
    """Row of steps. ``chosen``: a step was clicked; ``list_requested``: the current one was."""

    chosen = Signal(str)
    list_requested = Signal()

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self.setObjectName("step_pills")
        self._theme = theme
        self._pills: list[StepPill] = []
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.setFixedHeight(HEIGHT_PX)
        theme.changed.connect(self._arrange)

    def minimumSizeHint(self) -> QSize:
        return QSize(_LEAST_PX, HEIGHT_PX)

    @property
    def shown(self) -> list[DisplayedStep]:
        """Visible steps, from left to right."""
        return [pill.step for pill in self._pills if not pill.isHidden()]

    @property
    def buttons(self) -> Sequence[StepPill]:
        """Buttons of all steps, in order."""
        return tuple(self._pills)

    @property
    def present_px(self) -> int:
        """Width of the current or first step."""
        return self._pills[self._middle].wanted_px() if self._pills else 0

    def show_steps(self, steps: Sequence[DisplayedStep]) -> None:
        while len(self._pills) < len(steps):
            pill = StepPill(self._theme, self)
            pill.clicked.connect(lambda _checked=False, pill=pill: self._on_clicked(pill))
            self._pills.append(pill)
        for pill in self._pills[len(steps) :]:
            pill.hide()
            pill.deleteLater()
        del self._pills[len(steps) :]
        for pill, step in zip(self._pills, steps, strict=True):
            pill.show_step(step)
            pill.setObjectName(f"step_{step.number}")
        self._arrange()

    @property
    def _middle(self) -> int:
        """Index of the current step; the first before the start, the last after the end."""
        states = [pill.step.state for pill in self._pills]
        present = [index for index, state in enumerate(states) if state in ("now", "late")]
        return present[0] if present else 0 if "ahead" in states else len(states) - 1

    def _arrange(self) -> None:
        if not self._pills:
            return
        middle = self._middle
        first = last = middle
        widths_px = [pill.wanted_px() for pill in self._pills]
        room = self.width() - widths_px[middle]
        # Following steps take precedence over former ones.
        for _ in self._pills:
            for after in (True, False):
                beside = last + 1 if after else first - 1
                if 0 <= beside < len(widths_px) and room >= widths_px[beside] + _GAP_PX:
                    room -= widths_px[beside] + _GAP_PX
                    first, last = min(first, beside), max(last, beside)
        left = 0
        for index, pill in enumerate(self._pills):
            pill.setVisible(first <= index <= last)
            if first <= index <= last:
                width = min(widths_px[index], self.width())
                pill.setGeometry(left, 0, width, HEIGHT_PX)
                left += width + _GAP_PX

    def _on_clicked(self, pill: StepPill) -> None:
        if pill.step.state in ("now", "late"):
            self.list_requested.emit()
        else:
            self.chosen.emit(pill.step.step_id)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._arrange()
