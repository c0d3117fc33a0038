"""Motion panel: commanded and measured velocity over the last half minute."""

import math
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QSize, Qt
from PySide6.QtGui import QAccessible, QBrush, QColor, QPen
from PySide6.QtWidgets import QGraphicsItem, QSizePolicy, QVBoxLayout, QWidget

from caris_desktop.domain.events import CommandSent
from caris_desktop.domain.geometry import moves
from caris_desktop.domain.sensing import Odometry
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import DriveStatus
from caris_desktop.ui import text_formatting, tokens
from caris_desktop.ui.accessibility import has_role
from caris_desktop.ui.panel import Panel, PanelContext, card_margins
from caris_desktop.ui.widgets.accessible_descriptions import ThrottledAccessibleDescription
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.labels import label

SPAN_S = 30.0
POINTS = 3000
"""Maximum points per line: 100 Hz for half a minute."""

_REDRAW_MS = 200
_LOW_PX = 190
_GAP_S = 0.5
_COMMANDS_END_S = 0.6  # the link repeats a command, then sends zero for half a second; silence means no command


class RollingBuffer:
    """Rolling buffer of stamped values of the last half minute."""

    def __init__(self, values: int) -> None:
        self._values = values
        self._rows: deque[tuple[float, ...]] = deque(maxlen=POINTS)

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, stamp_ns: int, *values: float) -> None:
        self._rows.append((stamp_ns / 1e9, *values))

    def window(self, now_s: float, *, gap_s: float) -> NDArray[np.float64]:
        """Rows of (seconds before now, values...), oldest first; a row of NaN for each gap longer than ``gap_s``."""
        if not self._rows:
            return np.empty((0, 1 + self._values))
        rows = np.array(self._rows)
        rows = rows[rows[:, 0] >= now_s - SPAN_S - gap_s]
        rows[:, 0] -= now_s
        gaps = np.flatnonzero(np.diff(rows[:, 0]) > gap_s) + 1
        return np.insert(rows, gaps, np.nan, axis=0)


def limited_why(drive: DriveStatus) -> str:
    """Reason why the robot moves slower than commanded; empty if it does not."""
    match drive.guard:
        case "blocked":
            return tr("guard: blocked")
        case "slowing":
            return tr("guard: slowing")
        case _:
            return tr(drive.cap_reason)


class MotionPanel(Panel):
    """Two plots, forward and turning: commanded dashed, measured by odometry solid."""

    title = QT_TR_NOOP("Motion")
    preferred_size, least_size = QSize(420, 260), QSize(240, 120)
    reads = ()

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("motion_panel")
        # The import takes 0.3 s; only scenarios with this panel pay for it.
        import pyqtgraph

        self._commanded = RollingBuffer(3)
        self._measured = RollingBuffer(3)
        self._limited = RollingBuffer(1)
        self._paused_at_ns: int | None = None
        self._drawn_ns: int | None = None
        self._was_limited = 0.0
        self._limits: tuple[float, float] | None = None
        self._odometry_line = label("", "note", objectName="motion_odometry")
        self._odometry_line.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        self._pause = ActionButton(self.theme, tr("Pause"), icon="pause", height_px=30, objectName="motion_pause")
        self._pause.setCheckable(True)
        self._pause.toggled.connect(self._on_pause_toggled)
        self._widget = pyqtgraph.GraphicsLayoutWidget()
        has_role(self._widget, QAccessible.Role.Chart)
        self._widget.setAccessibleName(tr("Commanded and measured speed in the last half minute"))
        for part in (self._widget, self._widget.viewport()):
            part.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._widget.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self._description = ThrottledAccessibleDescription(self._widget, self.value_text)
        self._widget.ci.setContentsMargins(0, 0, 0, 0)
        self._widget.ci.layout.setSpacing(4)
        self._plots: list[Any] = []
        self._lines: list[tuple[Any, Any, Any]] = []
        for row in range(2):
            plot = self._widget.addPlot(row=row, col=0)
            plot.setMenuEnabled(False)
            plot.hideButtons()
            plot.setMouseEnabled(False, False)
            plot.setXRange(-SPAN_S, 0.0, padding=0.0)
            plot.getAxis("left").setWidth(52)
            for side in ("left", "bottom"):
                plot.getAxis(side).enableAutoSIPrefix(False)
                # Cached: axes are repainted only when their numbers change.
                plot.getAxis(side).setCacheMode(QGraphicsItem.CacheMode.DeviceCoordinateCache)
            plot.showGrid(x=False, y=True, alpha=0.2)
            hatch = plot.plot(connect="finite", skipFiniteCheck=False)
            commanded, measured = plot.plot(connect="finite"), plot.plot(connect="finite")
            self._plots.append(plot)
            self._lines.append((commanded, measured, hatch))
        self._side_by_side = False
        layout = QVBoxLayout(self)
        card_margins(layout)
        layout.addWidget(self._widget, 1)
        layout.addWidget(self._odometry_line)
        self.state.event_happened.connect(self._on_event)
        self.state.odometry.changed.connect(self._on_odometry_changed)
        self.theme.changed.connect(self._style)
        self._redraw = self.every(_REDRAW_MS, self._draw)
        self._style()
        self.state.drive.follow(self._on_drive_changed)
        self._draw()

    def title_widgets(self) -> list[QWidget]:
        return [self._pause]

    def fit(self) -> None:
        low = self.height() < _LOW_PX
        self._odometry_line.setVisible(not low)
        side_by_side = low and self.width() > self.height()
        if side_by_side != self._side_by_side:
            self._side_by_side = side_by_side
            turning = self._plots[1]
            self._widget.ci.removeItem(turning)
            self._widget.ci.addItem(turning, row=0 if side_by_side else 1, col=1 if side_by_side else 0)

    @property
    def sample_count(self) -> int:
        return len(self._commanded) + len(self._measured) + len(self._limited)

    def shown(self, row: int, line: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Data of a plot (0 forward, 1 turning) as ``commanded`` or ``measured``: seconds and values."""
        item = self._lines[row][0 if line == "commanded" else 1]
        xs, ys = item.getData()
        return (np.empty(0), np.empty(0)) if xs is None else (xs, ys)

    def _style(self) -> None:
        theme = self.theme
        self._widget.setBackground(theme.color("panel"))
        dim, line = theme.color("dim"), theme.color("line_strong")
        dashed = QPen(theme.color("amber"), 1.6, Qt.PenStyle.DashLine)
        solid = QPen(theme.color("blue"), 2.0)
        for pen in (dashed, solid):
            pen.setCosmetic(True)
        ground = QColor(theme.color("red"))
        ground.setAlpha(110)
        hatch = QBrush(ground, Qt.BrushStyle.BDiagPattern)
        for plot, (commanded, measured, limited) in zip(self._plots, self._lines, strict=True):
            commanded.setPen(dashed)
            measured.setPen(solid)
            limited.setPen(None)
            limited.setFillBrush(hatch)
            for side in ("left", "bottom"):
                axis = plot.getAxis(side)
                axis.setPen(line)
                axis.setTextPen(dim)
                axis.setTickFont(theme.font(tokens.KEY_CAP_PX))
            label = {"color": dim.name(), "font-size": f"{tokens.KEY_CAP_PX}px"}
            plot.setLabel("left", "m/s" if plot is self._plots[0] else "°/s", **label)
            plot.getAxis("left").setScale(1.0)

    def _on_event(self, event: object) -> None:
        if isinstance(event, CommandSent):
            twist = event.twist
            self._commanded.add(event.stamp_ns, twist.forward_mps, math.degrees(twist.turn_radps), twist.left_mps)

    def _on_odometry_changed(self, odometry: Odometry) -> None:
        twist = odometry.twist
        self._measured.add(odometry.stamp_ns, twist.forward_mps, math.degrees(twist.turn_radps), twist.left_mps)

    def update_view(self) -> None:
        self._on_drive_changed(self.state.drive.value)
        self._draw()

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        self._note_limits()
        limits = (drive.max_forward_mps, drive.max_turn_radps)
        if not self.in_view or limits == self._limits:
            return
        self._limits = limits
        for plot, limit in zip(self._plots, (drive.max_forward_mps, math.degrees(drive.max_turn_radps)), strict=True):
            reach = max(limit, 0.05) * 1.15
            plot.setYRange(-reach, reach, padding=0.0)

    def _note_limits(self) -> None:
        """Record whether the robot is limited now; like the other values, also while the panel is hidden."""
        now_ns, limited = self.state.present.now_ns(), 1.0 if limited_why(self.state.drive.value) else 0.0
        if limited != self._was_limited:
            self._limited.add(now_ns, self._was_limited)
            self._was_limited = limited
        self._limited.add(now_ns, limited)

    def _on_pause_toggled(self, paused: bool) -> None:
        """Freeze the plots; data received meanwhile is shown afterwards."""
        self._paused_at_ns = self.state.present.now_ns() if paused else None
        self._pause.set_label(tr("Resume") if paused else tr("Pause"), icon="play" if paused else "pause")
        self._draw()

    def _draw(self) -> None:
        state = self.state
        self._say()
        self._description.changed()
        self._note_limits()
        still = self._paused_at_ns is not None and self._drawn_ns == self._paused_at_ns
        if not self.isVisible() or not self.in_view or still:
            return
        now_s = (self._paused_at_ns or self.state.present.now_ns()) / 1e9
        commanded = self._commanded.window(now_s, gap_s=_COMMANDS_END_S)
        measured = self._measured.window(now_s, gap_s=_GAP_S)
        limited = self._limited.window(now_s, gap_s=math.inf)
        drive: DriveStatus = state.drive.value
        reaches = (max(drive.max_forward_mps, 0.05), math.degrees(max(drive.max_turn_radps, 0.01)))
        for column, (line_commanded, line_measured, hatch) in enumerate(self._lines, start=1):
            line_commanded.setData(commanded[:, 0], commanded[:, column])
            line_measured.setData(measured[:, 0], measured[:, column])
            reach = reaches[column - 1] * 1.15
            if limited[:, 1].any():
                hatch.setData(limited[:, 0], np.where(limited[:, 1] > 0, reach, -reach), fillLevel=-reach)
            elif hatch.xData is not None:
                hatch.clear()
        self._drawn_ns = self._paused_at_ns

    def value_text(self) -> str:
        """Current commanded and measured values as text for screen readers."""
        now_s = (self._paused_at_ns or self.state.present.now_ns()) / 1e9
        sentences = []
        for text, strip, gap_s in (
            (tr("Commanded: {motion}."), self._commanded, _COMMANDS_END_S),
            (tr("Measured: {motion}."), self._measured, _GAP_S),
        ):
            rows = strip.window(now_s, gap_s=gap_s)
            motion = tr("nothing")
            if len(rows) and rows[-1, 0] > -gap_s:
                motion = text_formatting.moving(rows[-1, 1], math.radians(rows[-1, 2])) or tr("standing still")
            sentences.append(text.format(motion=motion))
        reason = limited_why(self.state.drive.value)
        return " ".join([*sentences, *([f"{reason}."] if reason else [])])

    def _say(self) -> None:
        state = self.state
        odometry: Odometry | None = state.odometry.value
        if odometry is None:
            live = state.present.live
            self._odometry_line.setText(tr("No odometry yet") if live else tr("No odometry"))
            self.set_fact(tr("no odometry yet") if live else tr("no odometry"))
            return
        pose = odometry.pose_in_odom
        self._odometry_line.setText(
            tr(
                "Odometry: x {x:.2f} m, y {y:.2f} m, heading {heading:.0f}°"
                " · dashed: commanded, solid: measured, hatched: limited"
            ).format(x=pose.x_m, y=pose.y_m, heading=math.degrees(pose.heading_rad))
        )
        self._odometry_line.setToolTip(self._odometry_line.text())
        reason = limited_why(state.drive.value)
        if self._paused_at_ns is not None:
            paused_s = (self.state.present.now_ns() - self._paused_at_ns) / 1e9
            self.set_fact(tr("paused for {time}").format(time=text_formatting.age(paused_s)), "amber")
        elif state.odometry.freshness != "fresh":
            age = text_formatting.age(state.odometry.age_s() or 0.0)
            late = tr("odometry latency {age}").format(age=age)
            silent = text_formatting.age(state.odometry.silent_s() or 0.0)
            self.set_fact(
                late if state.odometry.arrives_late else tr("odometry silent for {age}").format(age=silent), "amber"
            )
        elif reason:
            self.set_fact(reason, "amber")
        else:
            twist = odometry.twist
            motion = text_formatting.moving(twist.forward_mps, twist.turn_radps, twist.left_mps) if moves(twist) else ""
            self.set_fact(motion or tr("standing still"))
