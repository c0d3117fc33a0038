"""Drive: arrow pad, speed setting and what the robot is asked to do now."""

from PySide6.QtCore import QEvent, QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QHideEvent, QMouseEvent, QPainter, QPaintEvent, QPen, QPolygonF, QResizeEvent
from PySide6.QtWidgets import QBoxLayout, QGridLayout, QHBoxLayout, QLabel, QSizePolicy, QSlider, QVBoxLayout, QWidget

from caris_desktop.domain.events import GoalChanged
from caris_desktop.live.status import DriveStatus
from caris_desktop.ui import tokens, words
from caris_desktop.ui.actions import Actions
from caris_desktop.ui.drive_keys import HoldToDrive
from caris_desktop.ui.panel import Panel, PanelContext, card_margins
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.key_cap import HEIGHT_PX, draw_key_cap, key_cap_width

_CELLS = (("drive_forward", 0, 1), ("turn_left", 1, 0), ("drive_back", 1, 1), ("turn_right", 1, 2))
_ANGLES_DEG = {"drive_forward": 0.0, "turn_right": 90.0, "drive_back": 180.0, "turn_left": 270.0}
_NAMES = {
    "drive_forward": "Forward", "turn_left": "Turn left", "drive_back": "Backward", "turn_right": "Turn right",
}  # fmt: skip


class DrivePanel(Panel):
    """Hold an arrow, on the screen or on the keyboard, and the robot moves; let go and it stops."""

    title = "Drive"
    drives = True

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("drive_panel")
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self._line = QLabel()
        self._line.setObjectName("drive_line")
        self._line.setWordWrap(True)
        self._reason = QLabel()
        self._reason.setObjectName("drive_reason")
        self._reason.setWordWrap(True)
        self._pad = DrivePad(self.theme, self.table, self.hold)
        self._pad.setObjectName("drive_pad")
        self._stop = ActionButton(self.theme, "Stop", icon="hand-palm", height_px=30)
        self._stop.setObjectName("stop_button")
        self._stop.clicked.connect(self.console.stop)
        self._stop.set_key(self.table.key_text("stop"))
        self._slower = ActionButton(self.theme, "", icon="minus", height_px=30)
        self._faster = ActionButton(self.theme, "", icon="plus", height_px=30)
        for button, action_id in ((self._slower, "slower"), (self._faster, "faster")):
            button.bind(self.table, action_id)
            button.setAccessibleName("Slower" if action_id == "slower" else "Faster")
        self._slider = QSlider(Qt.Orientation.Horizontal)
        self._slider.setObjectName("speed_slider")
        self._slider.setRange(10, 100)
        self._slider.setSingleStep(10)
        self._slider.setPageStep(10)
        self._slider.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._slider.setAccessibleName("Top speed")
        self._slider.setMinimumWidth(24)
        self._slider.valueChanged.connect(self._on_slider_moved)
        self._speed = QLabel()
        self._speed.setObjectName("speed_label")
        words_column = QVBoxLayout()
        words_column.setSpacing(2)
        words_column.addWidget(self._line)
        words_column.addWidget(self._reason)
        words_column.addStretch(1)
        speed_row = QHBoxLayout()
        speed_row.setSpacing(8)
        speed_row.addWidget(self._slower)
        speed_row.addWidget(self._slider, 1)
        speed_row.addWidget(self._faster)
        speed_row.addWidget(self._speed)
        self._first = QVBoxLayout()
        self._first.setSpacing(tokens.GRID_PX)
        self._first.addLayout(words_column, 1)
        self._second = QVBoxLayout()
        self._second.setSpacing(tokens.GRID_PX)
        self._second.addWidget(self._pad, 1)
        self._speed_row = speed_row
        self._second.addLayout(speed_row)
        self._layout = QBoxLayout(QBoxLayout.Direction.TopToBottom, self)
        card_margins(self._layout)
        self._layout.addLayout(self._first)
        self._layout.addLayout(self._second, 1)
        self.theme.changed.connect(self._style)
        self.state.drive.changed.connect(self._on_drive_changed)
        self.state.goal.changed.connect(self._on_goal_changed)
        self.hold.held_changed.connect(self._on_held_changed)
        self.table.keys_changed.connect(self._on_keys_changed)
        self._style()
        self._on_drive_changed(self.state.drive.value)

    def title_widgets(self) -> list[QWidget]:
        return [self._stop]

    def minimumSizeHint(self) -> QSize:
        return QSize(250, 104)

    def sizeHint(self) -> QSize:
        return QSize(340, 260)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        # Low and wide (a tab under the map, say): words and speed beside the pad instead of around it.
        beside = self.height() < 210 and self.width() >= 400
        direction = QBoxLayout.Direction.LeftToRight if beside else QBoxLayout.Direction.TopToBottom
        if direction != self._layout.direction():
            self._layout.setDirection(direction)
            # Where it is that low, a second line of words is worth more than air.
            self._layout.setContentsMargins(14, 8 if beside else 12, 14, 8 if beside else 12)
            self._layout.setSpacing(16 if beside else tokens.GRID_PX)
            self._layout.setStretch(0, 1 if beside else 0)
            target, source = (self._first, self._second) if beside else (self._second, self._first)
            # The number is in the title bar as well.
            self._speed.setVisible(not beside)
            source.removeItem(self._speed_row)
            self._speed_row.setParent(None)
            target.addLayout(self._speed_row)

    def _on_keys_changed(self) -> None:
        self._show(self.state.drive.value)

    def _style(self) -> None:
        self._line.setFont(self.theme.font(tokens.SPEECH_PX - 1, tokens.WEIGHT_SEMIBOLD))
        self._reason.setFont(self.theme.font(tokens.STATUS_PX))
        self._speed.setFont(self.theme.font(tokens.STATUS_PX))
        self._speed.setMinimumWidth(self._speed.fontMetrics().horizontalAdvance("0.00 m/s") + 2)
        self._show(self.state.drive.value)

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        self._show(drive)

    def _on_goal_changed(self, _goal: GoalChanged | None) -> None:
        self._show(self.state.drive.value)

    def _going_to(self) -> str:
        """Where the robot drives by itself; empty when it does not."""
        goal: GoalChanged | None = self.state.goal.value
        return (goal.place or "the chosen point") if goal is not None and goal.state in words.UNDER_WAY else ""

    def _on_held_changed(self, _held: object) -> None:
        self._show(self.state.drive.value)

    def _on_slider_moved(self, percent: int) -> None:
        self.console.set_speed_fraction(percent / 100)

    def _show(self, drive: DriveStatus) -> None:
        going_to = self._going_to()
        by_itself = bool(going_to) and drive.allowed and not drive.emergency_stop
        by_itself = by_itself and drive.target_forward_mps == drive.target_turn_radps == 0.0
        self._line.setText(f"Going to {going_to}" if by_itself else words.drive_line(drive))
        top_mps = drive.max_forward_mps * drive.speed_fraction
        self._speed.setText(f"{top_mps:.2f} m/s")
        self._slider.blockSignals(True)
        self._slider.setValue(round(drive.speed_fraction * 100))
        self._slider.blockSignals(False)
        role = "dim"
        if drive.emergency_stop:
            text, role = "Release it in the red bar above to drive again.", "red"
        elif not drive.allowed:
            text, role = drive.reason, "amber"
        elif drive.cap_reason:
            text, role = f"Limited to {drive.cap_fraction * 100:.0f} %: {drive.cap_reason}", "amber"
        elif self.hold.held:
            text = "Let go to stop."
        elif going_to:
            text = f"{self.table.key_text('stop')} stops it."
        else:
            text = "Hold W A S D or arrows" if self.table.driving_focus else "Alt+W A S D while you type"
        self._reason.setText(text)
        palette = self._reason.palette()
        palette.setColor(self._reason.foregroundRole(), self.theme.color(role))
        self._reason.setPalette(palette)
        self._pad.setEnabled(drive.allowed and not drive.emergency_stop)
        if drive.emergency_stop:
            self.set_fact("stopped", "red")
        elif not drive.allowed:
            self.set_fact("not possible now", "amber")
        elif self.hold.held:
            self.set_fact(f"driving · {top_mps:.2f} m/s at most", "blue")
        else:
            self.set_fact(f"{top_mps:.2f} m/s at most")

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self.setFocus(Qt.FocusReason.MouseFocusReason)
        super().mousePressEvent(event)


class DrivePad(QWidget):
    """Four arrows. Each may be held with the mouse, and shows when its key is held."""

    def __init__(self, theme: Theme, actions: Actions, hold: HoldToDrive) -> None:
        super().__init__()
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(tokens.GRID_PX)
        self.arrows: dict[str, HoldArrow] = {}
        for action_id, row, column in _CELLS:
            arrow = HoldArrow(theme, actions, hold, action_id)
            arrow.setObjectName(f"hold_{action_id}")
            self.arrows[action_id] = arrow
            grid.addWidget(arrow, row, column)
        for column in range(3):
            grid.setColumnStretch(column, 1)
        self.setMaximumHeight(176)


class HoldArrow(QWidget):
    """One arrow of the pad; moves the robot for as long as the mouse button is down on it."""

    held_changed = Signal(bool)

    def __init__(self, theme: Theme, actions: Actions, hold: HoldToDrive, action_id: str) -> None:
        super().__init__()
        self._theme = theme
        self._actions = actions
        self._hold = hold
        self._action_id = action_id
        self.setMinimumSize(82, 36)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setAccessibleName(_NAMES[action_id])
        self.setToolTip(f"{_NAMES[action_id]}: hold")
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)
        theme.changed.connect(self.update)
        actions.keys_changed.connect(self.update)
        hold.held_changed.connect(self._on_held_changed)

    def _on_held_changed(self, _held: object) -> None:
        self.update()

    def changeEvent(self, event: QEvent) -> None:
        # A disabled widget is not told that the mouse button went up.
        if event.type() == QEvent.Type.EnabledChange and not self.isEnabled():
            self._hold.let_go_onscreen(self._action_id)
        super().changeEvent(event)

    def hideEvent(self, event: QHideEvent) -> None:
        self._hold.let_go_onscreen(self._action_id)
        super().hideEvent(event)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton:
            self._hold.hold_onscreen(self._action_id)
            event.accept()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton:
            self._hold.let_go_onscreen(self._action_id)
            event.accept()

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme = self._theme
        held = self._action_id in self._hold.held
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if not self.isEnabled():
            painter.setOpacity(0.5)
        rect = QRectF(self.rect()).adjusted(0.5, 0.5, -0.5, -0.5)
        ground = "blue_soft" if held else ("raised_hover" if self.underMouse() and self.isEnabled() else "raised")
        painter.setPen(QPen(theme.color("blue" if held else "line"), 2 if held else 1))
        painter.setBrush(theme.color(ground))
        painter.drawRoundedRect(rect, tokens.CONTROL_RADIUS_PX, tokens.CONTROL_RADIUS_PX)
        key = self._actions.key_text(self._action_id)
        cap = key_cap_width(theme, key)
        beside = rect.height() < 62
        arrow_px = min(20.0, rect.height() * 0.4)
        center = rect.center()
        arrow_center = (
            QPointF(center.x() - (cap + 8) / 2, center.y()) if beside else QPointF(center.x(), center.y() - 13)
        )
        self._paint_arrow(painter, arrow_center, arrow_px, "blue" if held else "text")
        if beside:
            draw_key_cap(painter, theme, key, arrow_center.x() + arrow_px / 2 + 8, center.y(), pressed=held)
        else:
            draw_key_cap(painter, theme, key, center.x() - cap / 2, center.y() + 8 + HEIGHT_PX / 2, pressed=held)

    def _paint_arrow(self, painter: QPainter, center: QPointF, size_px: float, role: str) -> None:
        half = size_px / 2
        painter.save()
        painter.translate(center)
        painter.rotate(_ANGLES_DEG[self._action_id])
        painter.setPen(
            QPen(
                self._theme.color(role), 2.4, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap, Qt.PenJoinStyle.RoundJoin
            )
        )
        painter.drawLine(QPointF(0, half), QPointF(0, -half))
        painter.drawPolyline(
            QPolygonF([QPointF(-half * 0.7, -half * 0.3), QPointF(0, -half), QPointF(half * 0.7, -half * 0.3)])
        )
        painter.restore()
