"""Connection popup: round trip, video age and LIDAR age of the last minute as curves."""

import html
import time
from collections import deque
from typing import Any

from PySide6.QtCore import Qt, QTimer, Signal
from PySide6.QtGui import QAccessible
from PySide6.QtWidgets import QFrame, QLabel, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.state import LiveState
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.accessible_roles import has_role
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.panel_table import possible_panels
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import FlowRow
from caris_desktop.ui.widgets.labels import label

SPAN_S = 60.0
_SAMPLE_MS = 250
_CURVES = (
    ("round_trip", QT_TR_NOOP("Round trip to the robot"), "blue", Qt.PenStyle.SolidLine),
    ("video", QT_TR_NOOP("Age of the picture"), "green", Qt.PenStyle.DashLine),
    ("lidar", QT_TR_NOOP("Age of the LIDAR scan"), "amber", Qt.PenStyle.DotLine),
)


class ConnectionHistory(QWidget):
    """Samples of the last minute at 4 Hz: (monotonic seconds, milliseconds or nan)."""

    def __init__(self, state: LiveState, parent: QWidget) -> None:
        super().__init__(parent)
        self.hide()
        self._state = state
        length = round(SPAN_S * 1000 / _SAMPLE_MS)
        self.times_s: deque[float] = deque(maxlen=length)
        self.values_ms: dict[str, deque[float]] = {name: deque(maxlen=length) for name, *_ in _CURVES}
        timer = QTimer(self, interval=_SAMPLE_MS)
        timer.timeout.connect(self.sample)
        timer.start()

    def sample(self) -> None:
        state = self._state
        self.times_s.append(time.monotonic())
        link = state.link.value
        linked = link.state in ("connected", "trouble") and link.round_trip_ms is not None
        self.values_ms["round_trip"].append(link.round_trip_ms if linked else float("nan"))
        for name, stream in (("video", state.frame), ("lidar", state.scan)):
            age_s = stream.age_s()
            self.values_ms[name].append(float("nan") if age_s is None else age_s * 1000)


class ConnectionCard(Overlay):
    """Popup with the curves. The plotting library is imported when it is first opened."""

    diagnostics_requested = Signal()
    robots_requested = Signal()

    def __init__(self, theme: Theme, window: QWidget, state: LiveState) -> None:
        super().__init__(theme, window, width_px=860)
        self.setObjectName("connection_card")
        self.setAccessibleName(tr("Connection in the last minute"))
        self._history = ConnectionHistory(state, self)
        self._plot: Any = None
        self._curves: dict[str, Any] = {}
        self._legend: dict[str, _LegendEntry] = {}
        self._state = state
        self._facts = label("", "note", wraps=True, objectName="connection_facts")
        self._diagnostics = ActionButton(
            theme, tr("All topics"), icon="gauge", objectName="connection_diagnostics",
            toolTip=tr("Open the Diagnostics panel: rate, age and size of all incoming data"),
            clicked=self.diagnostics_requested,
        )  # fmt: skip
        robots = ActionButton(
            theme, tr("Another robot…"), icon="robot", objectName="connection_robots", clicked=self.robots_requested
        )
        heading = label(tr("Connection in the last minute"), "heading", wraps=True)
        head = layouts.hbox(None, (heading, 1), self._diagnostics, robots, spacing_px=8)
        self._layout = layouts.vbox(self.card, head, self._facts, margins_px=(20, 16, 20, 16), spacing_px=10)
        row = FlowRow(gap_px=16)
        for name, text, *_ in _CURVES:
            self._legend[name] = _LegendEntry(tr(text), name)
            row.add(self._legend[name])
        row.set_gap(4)
        self._layout.addWidget(row)
        self._refresh = QTimer(self, interval=_SAMPLE_MS)
        self._refresh.timeout.connect(self.refresh)
        theme.changed.connect(self._style)

    @property
    def history(self) -> ConnectionHistory:
        return self._history

    def open(self) -> None:
        self._diagnostics.setVisible("diagnostics" in possible_panels(self._state.scenario.value))
        if self._plot is None:
            self._build_plot()
        self._style()
        self.refresh()
        self._refresh.start()
        super().open()
        self.setFocus(Qt.FocusReason.OtherFocusReason)

    def close_overlay(self) -> None:
        self._refresh.stop()
        super().close_overlay()

    def card_height_px(self) -> int:
        return 420

    def _build_plot(self) -> None:
        import pyqtgraph

        self._plot = pyqtgraph.PlotWidget()
        has_role(self._plot, QAccessible.Role.Chart)
        self._plot.setObjectName("connection_plot")
        self._plot.setAccessibleName(tr("Connection in the last minute"))
        for part in (self._plot, self._plot.viewport()):
            part.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._plot.setMouseEnabled(x=False, y=False)
        self._plot.setMenuEnabled(False)
        self._plot.hideButtons()
        self._plot.setXRange(-SPAN_S, 0, padding=0)
        # pyqtgraph interprets axis labels as HTML.
        self._plot.setLabel("bottom", html.escape(tr("seconds ago")))
        self._plot.setLabel("left", html.escape(tr("milliseconds")))
        self._plot.showGrid(x=False, y=True, alpha=0.25)
        for name, *_ in _CURVES:
            self._curves[name] = self._plot.plot([], [], connect="finite")
        self._layout.addWidget(self._plot, 1)

    def _style(self) -> None:
        if self._plot is None:
            return
        import pyqtgraph

        self._plot.setBackground(self._theme.color("panel"))
        for side in ("bottom", "left"):
            axis = self._plot.getAxis(side)
            axis.setPen(self._theme.color("line_strong"))
            axis.setTextPen(self._theme.color("dim"))
            axis.setStyle(tickFont=self._theme.font(tokens.STATUS_PX - 1))
        for name, _, role, dash in _CURVES:
            self._curves[name].setPen(pyqtgraph.mkPen(self._theme.color(role), width=2, style=dash))

    def refresh(self) -> None:
        """Redraw the samples so far."""
        self._facts.setText(
            text_formatting.link_facts(self._state.link.value, self._state.traffic.value, self._state.present.anchor)
        )
        if self._plot is None or not self._history.times_s:
            return
        now_s = self._history.times_s[-1]
        ago = [moment - now_s for moment in self._history.times_s]
        highest = 50.0
        for name, *_ in _CURVES:
            values = list(self._history.values_ms[name])
            self._curves[name].setData(ago, values)
            highest = max([highest, *(value for value in values if value == value)])  # noqa: PLR0124 (not a number)
            self._legend[name].show_value(values[-1])
        self._plot.setYRange(0, min(highest * 1.1, 3000.0), padding=0)


class _LegendEntry(QWidget):
    """Legend entry: line sample, label, latest value."""

    accessible_role = QAccessible.Role.StaticText

    def __init__(self, text: str, name: str) -> None:
        super().__init__()
        self._name = text
        self._words = QLabel()
        sample = QFrame()
        sample.setObjectName(f"curve_{name}")
        sample.setFixedSize(24, 2)
        layouts.hbox(self, sample, self._words, margins_px=0, spacing_px=10)
        # Room for the longest value, so that nothing moves.
        self._words.setFixedSize(self.fontMetrics().horizontalAdvance(f"{text}  0000 ms") + 6, 24)

    def show_value(self, milliseconds: float) -> None:
        value = "–" if milliseconds != milliseconds else f"{milliseconds:.0f} ms"  # noqa: PLR0124 (not a number)
        self._words.setText(f"{self._name}  {value}")
        self.setAccessibleName(f"{self._name} {value}")
