"""Diagnostics: topics in words, sorted by value, and as a report to copy."""

import pytest
from PySide6.QtCore import QPoint, Qt
from PySide6.QtGui import QGuiApplication
from PySide6.QtTest import QTest
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import TopicTraffic, TrafficMeasured
from caris_desktop.live.status import LinkStatus, PerceptionStatus
from caris_desktop.ui import text_formatting
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.diagnostics_panel import DiagnosticsPanel, bandwidth, detection_words, state_words
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("video", "session")

ANCHOR = ClockAnchor.take()


def topic(
    name: str, rate_hz: float, *, last_s: float | None = 0.05, refused: int = 0, size: float = 1000
) -> TopicTraffic:
    return TopicTraffic(name, "std_msgs/String", rate_hz, size, last_s, 4.2, refused)


def measure(console: FakeConsole, *topics: TopicTraffic, refused: int = 0, link: str = "control") -> None:
    measured = TrafficMeasured(clock.now_ns(), link, "cbor", refused, topics)
    console.state.traffic.set({**console.state.traffic.value, link: measured})


def tell(panel: DiagnosticsPanel, console: FakeConsole, *topics: TopicTraffic, refused: int = 0) -> None:
    """Update the panel, which otherwise waits because both links report at about the same time."""
    measure(console, *topics, refused=refused)
    panel.update_view()


@pytest.fixture
def panel(window: MainWindow, console: FakeConsole) -> DiagnosticsPanel:
    # With the anchor of the panel, as the system time may be adjusted in between.
    clock_offset_ms = text_formatting.session_clock_ms(console.state.present.anchor) + 3.14
    console.state.link.set(LinkStatus("connected", "Lab robot", "ws://lab:9090", "", 12.0, clock_offset_ms, 0.4))
    window.open_panel("diagnostics")
    panel = window.panels["diagnostics"]
    assert isinstance(panel, DiagnosticsPanel)
    return panel


def shown(panel: DiagnosticsPanel, column: int = 0) -> list[str]:
    model = panel.view.model()
    return [model.index(row, column).data() for row in range(model.rowCount())]


def test_each_topic_is_a_row_and_a_click_on_a_heading_sorts_by_the_value(
    panel: DiagnosticsPanel, console: FakeConsole
) -> None:
    measure(console, topic("/b", 9.0), topic("/a", 30.0), topic("/c", 100.0))
    assert shown(panel) == ["/a", "/b", "/c"]
    header = panel.view.horizontalHeader()
    QTest.mouseClick(header.viewport(), Qt.MouseButton.LeftButton, pos=QPoint(header.sectionViewportPosition(2) + 9, 9))
    rates = shown(panel, 2)
    assert rates in (["9.0 Hz", "30.0 Hz", "100.0 Hz"], ["100.0 Hz", "30.0 Hz", "9.0 Hz"])


def test_tab_leaves_the_table(qtbot: QtBot, panel: DiagnosticsPanel, console: FakeConsole) -> None:
    measure(console, topic("/a", 30.0), topic("/b", 9.0))
    panel.view.setFocus()
    qtbot.waitUntil(panel.view.hasFocus)
    QTest.keyClick(panel.view, Qt.Key.Key_Tab)
    assert not panel.view.hasFocus()


def test_a_topic_that_fell_silent_is_called_stale_in_words(panel: DiagnosticsPanel, console: FakeConsole) -> None:
    latched = topic("/map", 0.0, last_s=40.0)
    tell(panel, console, topic("/scan", 10.0), topic("/map", 1.0), topic("/path", 0.0, last_s=None))
    for _second in range(3):
        tell(panel, console, topic("/scan", 10.0), latched, topic("/path", 0.0, last_s=None))
    assert shown(panel, 1) == ["infrequent", "nothing", "flowing"]
    tell(
        panel,
        console,
        topic("/scan", 0.0, last_s=2.0),
        topic("/map", 0.0, last_s=41.0),
        topic("/path", 0.0, last_s=None),
    )
    assert shown(panel, 1) == ["infrequent", "nothing", "stale"]
    assert panel.fact == ("1 stale", "amber")


def test_pictures_that_are_not_compressed_come_with_what_to_do(
    qtbot: QtBot, panel: DiagnosticsPanel, console: FakeConsole
) -> None:
    raw = TopicTraffic("/camera/image_raw", "sensor_msgs/msg/Image", 15.0, 13.8e6, 0.05, 9.0, 0)
    measure(console, raw, TopicTraffic("/depth", "sensor_msgs/msg/Image", 1.0, 40e3, 0.05, 9.0, 0), link="media")
    click(qtbot, find(panel.window(), "diagnostics_copy"))
    [advice] = [line for line in QGuiApplication.clipboard().text().split("\n") if "republish" in line]
    assert advice.startswith("/camera/image_raw is not compressed, 13.8 MB/s")
    assert advice in panel._summary.toolTip()


def test_the_table_shows_both_links_at_a_glance(qtbot: QtBot, panel: DiagnosticsPanel, console: FakeConsole) -> None:
    measure(console, topic("/scan", 10.0))
    looks: list[object] = []
    panel.model.dataChanged.connect(lambda *_: looks.append(None))
    panel.model.modelReset.connect(lambda: looks.append(None))
    for rate_hz in (9.0, 8.0, 7.0):
        measure(console, topic("/scan", rate_hz))
    measure(console, topic("/map", 1.0), link="media")
    assert looks == []
    qtbot.waitUntil(lambda: shown(panel) == ["/map", "/scan"])
    assert len(looks) == 1


def test_a_link_that_measures_nothing_any_more_says_so() -> None:
    assert state_words(topic("/scan", 10.0), usual_hz=10.0, link_silent_s=5.0) == "link silent"


def test_the_report_has_everything(qtbot: QtBot, panel: DiagnosticsPanel, console: FakeConsole) -> None:
    measure(console, topic("/scan", 10.0, refused=3), refused=3)
    assert panel.fact == ("3 rejected", "amber")
    click(qtbot, find(panel.window(), "diagnostics_copy"))
    text = QGuiApplication.clipboard().text()
    assert "Lab robot at ws://lab:9090: connected" in text
    assert "round trip 12.0 ms, robot clock 3.1 ± 0.4 ms ahead" in text
    assert "control link: CBOR, 1 topics, 10 messages/s, 1.0 kB/s, 3 rejected" in text
    assert "/scan\tflowing\t10.0 Hz\t50 ms\t4 ms\t1.0 kB/s\t3\tstd_msgs/String\tcontrol" in text


def test_it_says_how_often_people_are_looked_for_in_each_camera() -> None:
    shown = PerceptionStatus("ready", inference_ms=41.2, looks_per_s={"front": 7.5, "desk": 3.25})
    assert detection_words(shown) == ["Detector runs per second: front camera 7.5, desk camera 3.2 · 41 ms per run"]
    named = PerceptionStatus("ready", "yolo11s.pt, onnxruntime on CPU, 640 px, 31 ms (torch 52 ms)")
    assert detection_words(named) == ["Person detector: yolo11s.pt, onnxruntime on CPU, 640 px, 31 ms (torch 52 ms)"]
    assert detection_words(PerceptionStatus("failed", looks_per_s={"front": 0.0})) == []


def test_it_says_which_process_of_the_program_failed(
    qtbot: QtBot, panel: DiagnosticsPanel, console: FakeConsole
) -> None:
    summary = find(panel.window(), "diagnostics_summary")
    assert "Processes" not in summary.toolTip()
    console.state.health.set({"recorder": "running", "speech": "failed", "camera desk": "restarting"})
    assert "Processes: camera desk restarting, speech failed too often" in summary.toolTip()
    click(qtbot, find(panel.window(), "diagnostics_copy"))
    text = QGuiApplication.clipboard().text()
    assert "camera desk restarting, speech failed too often, recording running" in text
    console.state.health.set({"recorder": "running"})
    assert "Processes" not in summary.toolTip()


def test_before_anything_came_it_says_that(panel: DiagnosticsPanel) -> None:
    assert not panel.view.isVisible()


def test_it_opens_from_the_connection_card(qtbot: QtBot, window: MainWindow) -> None:
    assert "diagnostics" not in window.panels
    click(qtbot, find(window, "status_link"))
    click(qtbot, find(window, "connection_diagnostics"))
    qtbot.waitUntil(lambda: find(window, "diagnostics_panel").isVisible())
    assert not window.findChild(type(window._connection)).isVisible()


def test_values_are_words() -> None:
    assert [bandwidth(value) for value in (0, 999, 34_500, 1_200_000)] == ["0 B/s", "999 B/s", "34.5 kB/s", "1.2 MB/s"]
    now_ms = text_formatting.session_clock_ms(ANCHOR)
    assert text_formatting.clock_offset(now_ms - 12_345.6, 20.0, ANCHOR) == "12,346 ± 20 ms behind"
    assert text_formatting.clock_offset(now_ms + 3.14, None, ANCHOR) == "3.1 ms ahead"
    assert text_formatting.clock_offset(-5000.0, 1.0, ANCHOR) == "on a separate time base, known to ± 1.0 ms", (
        "a simulation"
    )
