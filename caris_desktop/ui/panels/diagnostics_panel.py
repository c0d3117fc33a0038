"""Diagnostics panel: traffic per topic and per link. The only panel with ROS names."""

import math
import time
from collections import deque
from collections.abc import Callable
from operator import attrgetter
from typing import Any

from PySide6.QtCore import QSize, Qt, QTimer
from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import QAbstractItemView, QSizePolicy, QTableView, QWidget

from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import TopicTraffic, TrafficMeasured
from caris_desktop.domain.process_settings import title_of
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.child_process import Health
from caris_desktop.live.status import LinkStatus, PerceptionStatus
from caris_desktop.ros.dialect import same_type
from caris_desktop.ros.message_conversion import republish_advice
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.panel import Panel, PanelContext
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.labels import label, named
from caris_desktop.ui.widgets.rows import Column, ColumnModel, Index, set_up_table

_ROOM_FOR_TOTALS_PX = 230
_SECONDS_TO_BE_USUAL = 3
_OLD_MEASUREMENT_S = 3.0
_HEAVY_BYTES_PER_S = 1e6
_TAKEN_TOGETHER_MS, _NOTHING_TOLD_MS = 200, 1500


class TopicRow(Value):
    """Topic of a link; ``state``: its reception as text."""

    link: str
    traffic: TopicTraffic
    state: str

    @property
    def stale(self) -> bool:
        return self.state.startswith(("stale", "link"))


def bandwidth(bytes_per_s: float) -> str:
    """Bandwidth as 0 B/s, 34 kB/s, 1.2 MB/s."""
    if bytes_per_s < 1000:
        return f"{bytes_per_s:.0f} B/s"
    if bytes_per_s < 1e6:
        return f"{bytes_per_s / 1e3:.1f} kB/s"
    return f"{bytes_per_s / 1e6:.1f} MB/s"


def state_words(traffic: TopicTraffic, *, usual_hz: float, link_silent_s: float) -> str:
    """Reception of a topic as text. Low-rate topics (maps, paths) are never called stale."""
    if link_silent_s > _OLD_MEASUREMENT_S:
        return tr("link silent")
    if traffic.last_heard_s is None:
        return tr("nothing")
    if usual_hz >= 0.9 and traffic.last_heard_s > max(0.5, 3.0 / usual_hz) and traffic.rate_hz < 0.5 * usual_hz:
        return tr("stale")
    if traffic.rate_hz < 0.05:
        return tr("infrequent")
    return tr("flowing")


_LINK_STATES = {
    "connecting": QT_TR_NOOP("connecting"),
    "connected": QT_TR_NOOP("connected"),
    "trouble": QT_TR_NOOP("trouble"),
    "lost": QT_TR_NOOP("lost"),
    "closed": QT_TR_NOOP("closed"),
}
_ENCODINGS = {"cbor": "CBOR", "json": "JSON", "both": QT_TR_NOOP("CBOR and JSON")}


def clock_words(link: LinkStatus, anchor: ClockAnchor) -> str:
    """Clock offset of the robot as text."""
    if link.clock_offset_ms is None:
        return tr("robot clock not measured")
    offset = text_formatting.clock_offset(link.clock_offset_ms, link.clock_uncertainty_ms, anchor)
    return tr("robot clock {offset}").format(offset=offset)


def link_words(measured: TrafficMeasured) -> str:
    """Traffic of a link as text."""
    total = sum(topic.bytes_per_s for topic in measured.topics)
    messages = sum(topic.rate_hz for topic in measured.topics)
    template = tr(
        "{name} link: {encoding}, {topics} topics, {messages:.0f} messages/s, {bandwidth}, {refused} rejected"
    )
    return template.format(
        name=measured.link,
        encoding=tr(_ENCODINGS[measured.encoding]),
        topics=len(measured.topics),
        messages=messages,
        bandwidth=bandwidth(total),
        refused=measured.refused,
    )


def raw_picture_words(traffic: dict[str, TrafficMeasured]) -> list[str]:
    """Advice on uncompressed images, which delay everything else on a wireless link."""
    return [
        tr("{topic} is not compressed, {bandwidth}: {advice}").format(
            topic=topic.topic, bandwidth=bandwidth(topic.bytes_per_s), advice=republish_advice(topic.topic)
        )
        for measured in traffic.values()
        for topic in measured.topics
        if same_type(topic.type, "sensor_msgs/Image") and topic.bytes_per_s >= _HEAVY_BYTES_PER_S
    ]


def _last_heard(row: TopicRow) -> str:
    return "–" if row.traffic.last_heard_s is None else text_formatting.age(row.traffic.last_heard_s)


def _age(row: TopicRow) -> str:
    return "–" if row.traffic.age_ms is None else f"{row.traffic.age_ms:.0f} ms"


def _type(row: TopicRow) -> str:
    traffic = row.traffic
    return f"{traffic.type} · {_ENCODINGS[traffic.encoding]}" if traffic.encoding else traffic.type


def _texts(title: str, tip: str, text: Callable[[TopicRow], str], width_px: int) -> Column:
    return Column(title, text, lambda row: text(row).casefold(), width_px, tip=tip)


def _numbers(
    title: str, tip: str, text: Callable[[TopicRow], str], number: Callable[[TopicRow], float | None], width_px: int
) -> Column:
    """Column sorted by a number; an unknown one is the largest."""

    def key(row: TopicRow) -> float:
        value = number(row)
        return math.inf if value is None else value

    return Column(title, text, key, width_px, right=True, tip=tip)


_COLUMNS = (
    _texts(QT_TR_NOOP("Topic"), QT_TR_NOOP("Name of the topic on the robot"), lambda row: row.traffic.topic, 170),
    _texts(QT_TR_NOOP("State"), QT_TR_NOOP("Whether messages still arrive at the usual rate"), attrgetter("state"), 84),
    _numbers(
        QT_TR_NOOP("Rate"), QT_TR_NOOP("Messages in the last second"),
        lambda row: f"{row.traffic.rate_hz:.1f} Hz", attrgetter("traffic.rate_hz"), 66,
    ),
    _numbers(
        QT_TR_NOOP("Last"), QT_TR_NOOP("Time since the newest message"),
        _last_heard, attrgetter("traffic.last_heard_s"), 60,
    ),
    _numbers(
        QT_TR_NOOP("Age on arrival"),
        QT_TR_NOOP("Age of the newest message on arrival, from the robot's timestamp and the estimated clock offset"),
        _age, attrgetter("traffic.age_ms"), 112,
    ),
    _numbers(
        QT_TR_NOOP("Bandwidth"), QT_TR_NOOP("Bytes received over the link in the last second"),
        lambda row: bandwidth(row.traffic.bytes_per_s), attrgetter("traffic.bytes_per_s"), 86,
    ),
    _numbers(
        QT_TR_NOOP("Rejected"),
        QT_TR_NOOP("Unusable messages so far: malformed, too large or of another type"),
        lambda row: str(row.traffic.refused), attrgetter("traffic.refused"), 70,
    ),
    _texts(QT_TR_NOOP("Type"), QT_TR_NOOP("Message type"), _type, 210),
    _texts(QT_TR_NOOP("Link"), QT_TR_NOOP("Connection that carries the topic"), attrgetter("link"), 64),
)  # fmt: skip
_TOPIC, _STATE, _LAST, _REFUSED = 0, 1, 3, 6


class TrafficModel(ColumnModel[TopicRow]):
    """Table model of the latest measurements."""

    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(_COLUMNS, parent)
        self._theme = theme
        self._usual_hz: dict[tuple[str, str], float] = {}
        self._lately: dict[tuple[str, str], tuple[int, deque[float]]] = {}

    def forget(self) -> None:
        """Reset the usual rates for another robot."""
        self._usual_hz.clear()
        self._lately.clear()

    def show_traffic(self, traffic: dict[str, TrafficMeasured], *, now_ns: int) -> None:
        rows = []
        for link, measured in traffic.items():
            silent_s = (now_ns - measured.stamp_ns) / 1e9
            for topic in measured.topics:
                key = link, topic.topic
                usual_hz = self._usual(key, topic.rate_hz, measured.stamp_ns)
                rows.append(TopicRow(link, topic, state_words(topic, usual_hz=usual_hz, link_silent_s=silent_s)))
        if {(row.link, row.traffic.topic) for row in rows} != {(row.link, row.traffic.topic) for row in self.rows}:
            self.show_rows(rows)
        elif rows:
            self.set_rows(rows)
            self.dataChanged.emit(self.index(0, 0), self.index(len(rows) - 1, len(_COLUMNS) - 1))

    def _usual(self, key: tuple[str, str], rate_hz: float, stamp_ns: int) -> float:
        """Best rate sustained for some seconds: a latched topic arrives once and is not stale afterwards."""
        newest_ns, rates = self._lately.setdefault(key, (0, deque(maxlen=_SECONDS_TO_BE_USUAL)))
        if stamp_ns != newest_ns:
            rates.append(rate_hz)
            self._lately[key] = stamp_ns, rates
            if len(rates) == _SECONDS_TO_BE_USUAL:
                self._usual_hz[key] = max(self._usual_hz.get(key, 0.0), min(rates))
        return self._usual_hz.get(key, 0.0)

    def data(self, index: Index, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        row, column = self.rows[index.row()], index.column()
        if role == Qt.ItemDataRole.ToolTipRole:
            return f"{row.traffic.topic}\n{row.traffic.type}\n{row.state}"
        if role == Qt.ItemDataRole.ForegroundRole:
            if (row.stale and column in (_TOPIC, _STATE, _LAST)) or (column == _REFUSED and row.traffic.refused):
                return self._theme.color("amber")
            return self._theme.color("text" if column == _TOPIC else "dim")
        return super().data(index, role)


def detection_words(perception: PerceptionStatus) -> list[str]:
    """Detector and detection rate per camera; empty while detection is off."""
    if perception.state != "ready":
        return []
    lines = [tr("Person detector: {model}").format(model=perception.model)] if perception.model else []
    if not perception.looks_per_s:
        return lines
    rates = ", ".join(
        f"{text_formatting.camera_in_text(camera)} {rate:.1f}" for camera, rate in perception.looks_per_s.items()
    )
    rates_text = tr("Detector runs per second: {told}").format(told=rates)
    took = [] if perception.inference_ms is None else [tr("{took:.0f} ms per run").format(took=perception.inference_ms)]
    return [*lines, " · ".join((rates_text, *took))]


_HEALTH_WORDS: dict[Health, str] = {
    "running": QT_TR_NOOP("running"),
    "restarting": QT_TR_NOOP("restarting"),
    "failed": QT_TR_NOOP("failed too often"),
}


def process_words(health: dict[str, Health]) -> list[str]:
    """Child processes, named as in a system monitor; failed ones first."""
    in_order = sorted(health.items(), key=lambda each: (each[1] == "running", each[0]))
    parts = ", ".join(f"{title_of(name)} {tr(_HEALTH_WORDS[how])}" for name, how in in_order)
    return [tr("Processes: {parts}").format(parts=parts)] if parts else []


def totals(traffic: dict[str, TrafficMeasured], perception: PerceptionStatus, health: dict[str, Health]) -> list[str]:
    """Links, advice on images, person detection and processes as lines of text."""
    links = (link_words(measured) for measured in traffic.values())
    return [*links, *raw_picture_words(traffic), *detection_words(perception), *process_words(health)]


class DiagnosticsPanel(Panel):
    """Sortable topic table below the totals of each link."""

    title = QT_TR_NOOP("Diagnostics")
    preferred_size, least_size = QSize(520, 260), QSize(220, 90)
    reads = ()

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("diagnostics_panel")
        self._copied_at_s = float("-inf")
        self._link_state = ""
        self._summary = label("", "note", objectName="diagnostics_summary")
        self._summary.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self._summary.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.model = TrafficModel(self.theme, self)
        self.view = named(QTableView(), "diagnostics_table", tr("Topics of the robot"))
        self.view.setModel(self.model)
        self.view.setSortingEnabled(True)
        self.view.sortByColumn(_TOPIC, Qt.SortOrder.AscendingOrder)
        set_up_table(self.view, row_px=24)
        self.view.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self.view.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.view.setTextElideMode(Qt.TextElideMode.ElideMiddle)
        for number, column in enumerate(_COLUMNS):
            self.view.setColumnWidth(number, column.width_px)
        nothing = tr("No data from the robot.\nIts topics appear here once data arrives.")
        self._empty = label(nothing, tone="dim", wraps=True, alignment=Qt.AlignmentFlag.AlignCenter)
        self._copy = ActionButton(self.theme, tr("Copy report"), icon="copy", height_px=28, text_px=tokens.STATUS_PX)
        self._copy.setObjectName("diagnostics_copy")
        self._copy.setToolTip(tr("Copy all values as text"))
        self._copy.clicked.connect(self.copy_report)
        layouts.vbox(self, self._summary, (self.view, 1), (self._empty, 1), margins_px=(12, 6, 12, 8), spacing_px=4)
        # Both links report once a second, and ages grow: one update soon after the first report, as the table is slow
        # to paint.
        self._soon = QTimer(self, singleShot=True, interval=_TAKEN_TOGETHER_MS)
        self._soon.timeout.connect(self.update_view)
        self._overdue = self.every(_NOTHING_TOLD_MS, self.update_view)
        self.watch(self._on_traffic_changed, self.state.traffic.changed)
        self.watch(self._on_link_changed, self.state.link.changed)
        self.watch(self.update_view, self.state.health.changed)
        self.state.robot.changed.connect(self._on_robot_changed)
        self.update_view()

    def title_widgets(self) -> list[QWidget]:
        return [self._copy]

    def focus_target(self) -> QWidget:
        return self.view

    def copy_report(self) -> None:
        """Copy the contents of the panel as text for robot support."""
        state = self.state
        link: LinkStatus = state.link.value
        round_trip = tr("not measured") if link.round_trip_ms is None else f"{link.round_trip_ms:.1f} ms"
        robot = tr("{robot} at {address}: {state} {detail}").format(
            robot=link.robot or tr("Robot"),
            address=link.address or tr("no address"),
            state=tr(_LINK_STATES[link.state]),
            detail=tr(link.detail),
        )
        clock = clock_words(link, state.present.anchor)
        lines = [
            robot.rstrip(),
            tr("round trip {round_trip}, {clock}").format(round_trip=round_trip, clock=clock),
            *totals(state.traffic.value, state.perception.value, state.health.value),
            "",
            "\t".join(tr(column.title) for column in _COLUMNS),
            *("\t".join(column.text(row) for column in _COLUMNS) for row in self.model.rows),
        ]
        QGuiApplication.clipboard().setText("\n".join(lines) + "\n")
        self._copied_at_s = time.monotonic()
        self._copy.set_label(tr("Copied"), icon="check")

    def _on_robot_changed(self, _robot: object) -> None:
        self.model.forget()
        self.update_view()

    def _on_traffic_changed(self, _traffic: object) -> None:
        if not self.model.rows:
            self.update_view()
        elif not self._soon.isActive():
            self._soon.start()

    def _on_link_changed(self, link: LinkStatus) -> None:
        """Update at once if the link state changes; traffic waits for the next refresh."""
        if link.state != self._link_state:
            self.update_view()

    def update_view(self) -> None:
        """Refresh, also because ages grow."""
        if not self.in_view:
            return
        self._soon.stop()
        self._overdue.start()
        link: LinkStatus = self.state.link.value
        self._link_state = link.state
        traffic: dict[str, TrafficMeasured] = self.state.traffic.value
        connected = link.state in ("connected", "trouble")
        round_trip = (
            f"{link.round_trip_ms:.0f} ms" if connected and link.round_trip_ms is not None else tr("not measured")
        )
        robot_clock = clock_words(link, self.state.present.anchor) if connected else tr("robot clock not measured")
        lines = [tr("Round trip {round_trip} · {clock}").format(round_trip=round_trip, clock=robot_clock)]
        if not connected:
            lines = [text_formatting.with_detail(tr("The robot is not connected"), link.detail)]
        health = {name: how for name, how in self.state.health.value.items() if how != "running"}
        lines += totals(traffic, self.state.perception.value, health)
        self._summary.setToolTip("\n".join(lines))
        # A low panel has room for rows or totals; rows are more informative.
        self._summary.setText("\n".join(lines if self.height() >= _ROOM_FOR_TOTALS_PX else lines[:1]))
        self.model.show_traffic(traffic, now_ns=self.state.present.now_ns())
        self.view.setVisible(bool(self.model.rows))
        self._empty.setVisible(not self.model.rows)
        refused = sum(measured.refused for measured in traffic.values())
        stale = sum(row.stale for row in self.model.rows)
        if refused or stale:
            parts = [tr("%n stale", "", stale)] * bool(stale) + [tr("%n rejected", "", refused)] * bool(refused)
            self.set_fact(" · ".join(parts), "amber")
        else:
            total = sum(topic.bytes_per_s for measured in traffic.values() for topic in measured.topics)
            self.set_fact(bandwidth(total) if traffic else "", "dim")
        if self._copy.text() == tr("Copied") and time.monotonic() - self._copied_at_s > 1.5:
            self._copy.set_label(tr("Copy report"), icon="copy")
