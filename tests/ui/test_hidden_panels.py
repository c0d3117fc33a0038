"""A hidden panel does no work, and is up to date once it is shown."""

from collections import Counter
from dataclasses import replace

import pytest
from PySide6.QtCore import QEvent, QObject, QTimer
from PySide6.QtWidgets import QApplication, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.events import GoalChanged, Marked, TopicTraffic, TrafficMeasured, UtteranceChanged
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.live.status import AssistantStatus, MicrophoneStatus, PerceptionStatus, PersonHistory, SpeechStatus
from caris_desktop.scenario.scenario_model import PanelName
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panel import Panel
from caris_desktop.ui.panel_table import PANELS
from tests.ui import samples
from tests.ui.conftest import freshen
from tests.ui.fake_console import FakeConsole


class Work(QObject):
    """Counts events of a panel's widgets and timeouts of its timers."""

    def __init__(self, app: QApplication, panel: Panel) -> None:
        super().__init__()
        self.of: Counter[str] = Counter()
        self._app = app
        self._panel = panel
        app.installEventFilter(self)

    def end(self) -> dict[str, int]:
        self._app.removeEventFilter(self)
        return dict(self.of)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        owner: QObject | None = watched
        while owner is not None and owner is not self._panel:
            owner = owner.parent()
        if owner is self._panel:
            self.of[f"{type(watched).__name__} {watched.objectName()}: {event.type().name}"] += 1
        return False


def put_aside(window: MainWindow, name: PanelName) -> Panel:
    """Open the panel, and another one in a tab in front of it."""
    window.open_panel(name)
    QApplication.processEvents()
    other: PanelName = "session" if name != "session" else "people"
    host = window.dock_host
    host.move_panel(other, name, "tab")
    window.open_panel(other)
    for _ in range(5):
        QApplication.processEvents()
    assert host.docks[name].visibleRegion().isEmpty()
    return window.panels[name]


def go_on(console: FakeConsole, number: int) -> None:
    """Change every value that a panel displays."""
    state, now_ns = console.state, clock.now_ns()
    freshen(console)
    samples.refresh_people_in_map(console)
    state.persons.set(
        tuple(replace(person, name=f"{person.name} {number}", last_seen_ns=now_ns) for person in state.persons.value)
    )
    state.everybody.set(state.persons.value)
    state.selected_person.set(state.persons.value[number % 2].person_id)
    state.person_history.reset_value(PersonHistory("p1", f"{number}"))
    state.drive.set(replace(state.drive.value, target_forward_mps=0.1 + number / 100, guard="slowing"))
    state.perception.set(PerceptionStatus("ready", "yolov8n", "", 20.0 + number))
    utterance = UtteranceChanged(now_ns, f"later{number}", "robot", f"Sentence {number}", "typed", "started")
    waiting = tuple(replace(utterance, utterance_id=f"waits{place}") for place in range(number % 3))
    state.speech.set(SpeechStatus(True, "robot", utterance, waiting))
    state.assistant.set(AssistantStatus("answering", "SmolLM2", "x9", "Why?", "Because " * number))
    state.microphone.set(MicrophoneStatus("on", "mic", number / 100))
    state.recording.set(replace(state.recording.value, written_bytes=state.recording.value.written_bytes + 1_000_000))
    state.link.set(replace(state.link.value, state="connected", round_trip_ms=3.0 + number))
    state.goal.set(GoalChanged(now_ns, "g", "active", Pose2D(1.0, 2.0, 0.0), place="Lab", distance_left_m=6.0 - number))
    topic = TopicTraffic("/scan", "sensor_msgs/LaserScan", 10.0 + number, 1000.0, 0.1, 5.0, 0)
    state.traffic.set({"control": TrafficMeasured(now_ns, "control", "cbor", 0, (topic,))})
    state.add(utterance)
    state.add(Marked(now_ns, f"Mark {number}", mark_id=f"m{number}"))


@pytest.mark.parametrize("name", [name for name in PANELS if name != "robot"])
@pytest.mark.long("motion", "photos", "session", "face", "assistant")
def test_a_panel_behind_another_tab_does_nothing(
    qtbot: QtBot, window: MainWindow, console: FakeConsole, name: PanelName
) -> None:
    panel = put_aside(window, name)
    go_on(console, 1)
    # Pending paint events of the hidden panel are processed first.
    qtbot.waitUntil(lambda: not any(timer.isActive() for timer in panel.findChildren(QTimer)))
    for _ in range(3):  # so are calls that a graphics scene has queued
        QApplication.processEvents()
    app = QApplication.instance()
    assert isinstance(app, QApplication)
    work = Work(app, panel)
    for number in range(2, 8):
        go_on(console, number)
        QApplication.processEvents()
    assert work.end() == {}
    assert [timer.objectName() for timer in panel.findChildren(QTimer) if timer.isActive()] == []


def test_a_closed_panel_is_out_of_view_too(window: MainWindow) -> None:
    panel = window.panels["people"]
    assert panel.in_view
    window.dock_host.close_panel("people")
    assert not panel.in_view
    window.dock_host.show_panel("people")
    assert panel.in_view


def test_people_who_came_meanwhile_are_there_when_the_panel_is_seen(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    panel = put_aside(window, "people")
    console.state.persons.set(console.state.persons.value[:1])
    window.open_panel("people")
    qtbot.waitUntil(lambda: panel.in_view)
    assert panel.fact[0] == "1 here"


def test_the_log_is_complete_when_it_is_seen_again(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    panel = put_aside(window, "session")
    for number in range(40):
        console.state.add(Marked(clock.now_ns(), f"Mark {number}"))
    window.open_panel("session")
    log = panel.findChild(QWidget, "event_log")
    qtbot.waitUntil(lambda: log.model().rowCount() >= 40)
    bar = log.verticalScrollBar()
    qtbot.waitUntil(lambda: bar.maximum() > 0 and bar.value() == bar.maximum())
