"""States are distinguishable by shape or word, without colours and shades of grey."""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace

import pytest
from PySide6.QtCore import QRect, Qt
from PySide6.QtGui import QImage, QPainter
from PySide6.QtWidgets import QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.events import GoalChanged, GoalState, PreflightState, Severity
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.live.status import Alarm, PreflightCheck, RecordingStatus
from caris_desktop.people.presence import PersonRow, Suggestion
from caris_desktop.ui.conversation.transcript_view import RowHighlight, RowPainter, TranscriptRow, who_spoke
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.notifications import AlarmRow
from caris_desktop.ui.panels.map_panel import MapPanel
from caris_desktop.ui.panels.people_panel import PeoplePanel
from caris_desktop.ui.preflight_list import PreflightRow
from caris_desktop.ui.protocol_strip import DisplayedStep, StepPill
from caris_desktop.ui.status_bar import StatusBar
from caris_desktop.ui.theme import Theme
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole

_STANDS_OUT = 40
"""Minimum difference in brightness from the background, of 255."""

_DIFFERS_PX = 12


def shapes(image: QImage) -> list[bool]:
    """Mask of painted pixels, independent of colour and shade."""
    grey = image.convertToFormat(QImage.Format.Format_Grayscale8)
    ground = grey.pixelColor(grey.width() - 1, 0).lightness()
    return [
        abs(grey.pixelColor(x, y).lightness() - ground) > _STANDS_OUT
        for y in range(grey.height())
        for x in range(grey.width())
    ]


def assert_shapes_differ(images: Mapping[str, QImage]) -> None:
    seen = {name: shapes(image) for name, image in images.items()}
    for one, other in itertools.combinations(seen, 2):
        differs = sum(a != b for a, b in zip(seen[one], seen[other], strict=True))
        assert differs >= _DIFFERS_PX, f"{one} and {other} differ by {differs} px"


def assert_words_differ(said: Mapping[str, str]) -> None:
    assert all(said.values()) and len(set(said.values())) == len(said), said


def grabbed(part: QWidget, rect: QRect) -> QImage:
    return part.grab(rect).toImage()


@pytest.fixture(params=["dark", "light"])
def shown_theme(request: pytest.FixtureRequest, theme: Theme) -> Theme:
    theme.set_choice("light" if request.param == "light" else "dark")
    request.addfinalizer(lambda: theme.set_choice("dark"))
    return theme


def test_checks_before_a_recording(qtbot: QtBot, shown_theme: Theme, console: FakeConsole) -> None:
    states: tuple[PreflightState, ...] = ("not checked", "pending", "minor", "major", "passed")
    icons = {}
    holder = QWidget()
    qtbot.addWidget(holder)
    holder.resize(600, 60)
    holder.show()
    for state in states:
        check = PreflightCheck("robot", "Robot", state, "Detail.")
        row = PreflightRow(shown_theme, console, check, holder)
        row.show_check(check)
        row.resize(600, 50)
        row.show()
        icons[state] = grabbed(row, QRect(0, 0, 30, 36))
        row.hide()
        row.setParent(None)
        row.deleteLater()
    assert_shapes_differ(icons)


def test_steps_of_the_protocol(qtbot: QtBot, shown_theme: Theme) -> None:
    holder = QWidget()
    qtbot.addWidget(holder)
    pill = StepPill(shown_theme, holder)
    pill.resize(260, 30)
    images, names = {}, {}
    for state, time in (
        ("done", ""), ("skipped", ""), ("now", "0:40 of 2:00"), ("late", "2:40 of 2:00 · 0:40 over"), ("ahead", ""),
    ):  # fmt: skip
        pill.show_step(DisplayedStep("greet", 1, "Greet", state, time))  # type: ignore[arg-type]
        images[state], names[state] = grabbed(pill, pill.rect()), pill.accessibleName()
    assert_shapes_differ(images)
    assert_words_differ(names)


def test_the_severity_of_an_alarm(qtbot: QtBot, shown_theme: Theme, console: FakeConsole) -> None:
    holder = QWidget()
    qtbot.addWidget(holder)
    holder.resize(500, 120)
    holder.show()
    severities: tuple[Severity, ...] = ("info", "warning", "error")
    images, names = {}, {}
    row = AlarmRow(shown_theme, console, holder)
    row.resize(500, 110)
    row.show()
    for severity in severities:
        row.show_alarm(Alarm("a", "a", severity, "The microphone is silent.", "Nothing is heard.", "Look.", 0))
        images[severity], names[severity] = grabbed(row, QRect(0, 0, 33, 40)), row.accessibleName()
    assert_shapes_differ(images)
    assert_words_differ(names)


def test_speakers_and_their_certainty(shown_theme: Theme) -> None:
    assert_words_differ({speaker: who_spoke(speaker, "", {}) for speaker in ("robot", "wizard", "participant", "")})
    heard_row = TranscriptRow("u", 0, "10:00:01", "Participant", "participant", "Where is the kitchen")
    rows = {
        "heard": heard_row,
        "still being transcribed": replace(heard_row, text="Where", tentative="is the kitchen"),
        "cut short": replace(heard_row, cut_short=True),
        "corrected": replace(heard_row, heard_text="Where is the kitten"),
        "not sure": replace(heard_row, who=who_spoke("", "", {}), speaker=""),
    }
    assert_words_differ({name: row.spoken for name, row in rows.items()})
    painter_of_rows, images = RowPainter(shown_theme), {}
    rect = QRect(0, 0, 420, painter_of_rows.height(heard_row, 420))
    for name, row in {**rows, "found": heard_row}.items():
        image = QImage(rect.size(), QImage.Format.Format_RGB32)
        image.fill(shown_theme.color("panel"))
        painter = QPainter(image)
        painter_of_rows.paint_turn(
            painter,
            rect,
            row,
            RowHighlight(
                raised=False,
                focused=False,
                ahead=False,
                words_hidden=False,
                found=("where",) if name == "found" else (),
            ),
        )
        painter.end()
        images[name] = image
    assert_shapes_differ(images)
    # Paler letters have other edges; a dotted line below them is a difference.
    surely, maybe = (shapes(images[name]) for name in ("heard", "still being transcribed"))
    lines = range(0, len(surely), rect.width())
    assert any(sum(maybe[at : at + rect.width()]) - sum(surely[at : at + rect.width()]) > 20 for at in lines)


@pytest.mark.panels("people")
def test_named_suggested_unconfirmed_and_former_people(window: MainWindow, console: FakeConsole, qtbot: QtBot) -> None:
    panel = window.findChild(PeoplePanel)
    assert panel is not None
    now_ns = clock.now_ns()
    third = PersonRow("p-3", 3, "Person 3", True, now_ns, now_ns, number=3)
    persons = {
        "nobody known": third,
        "named": replace(third, name="Ana Torres", known=True),
        "suggested": replace(third, suggestions=(Suggestion("p-mara", "Mara Silva", 0.82),)),
        "gone": replace(third, name="Ana Torres", known=True, here=False, last_seen_ns=now_ns - 60_000_000_000),
    }
    names, images = {}, {}

    def take(name: str) -> None:
        index = panel.model.index(0)
        row = panel.list.row_rect(0)
        names[name] = str(index.data(Qt.ItemDataRole.AccessibleTextRole))
        images[name] = grabbed(panel.list.viewport(), row)

    for name, person in persons.items():
        console.state.persons.set((person,))
        qtbot.waitUntil(lambda person=person: list(panel.model.persons) == [person])  # type: ignore[misc]
        take(name)
    console.state.persons.set((persons["named"],))
    qtbot.waitUntil(lambda: list(panel.model.persons) == [persons["named"]])
    panel.model.show_unconfirmed(frozenset(["p-3"]))
    take("unconfirmed")
    assert_words_differ(names)
    assert_shapes_differ(images)


@pytest.mark.panels("drive")
def test_the_state_of_the_recording(window: MainWindow, console: FakeConsole) -> None:
    began_ns, names, button = clock.now_ns(), {}, find(window, "record_button")
    for status in (
        RecordingStatus("idle"), RecordingStatus("starting"), RecordingStatus("recording", started_ns=began_ns),
        RecordingStatus("paused", started_ns=began_ns), RecordingStatus("stopping"), RecordingStatus("failed"),
    ):  # fmt: skip
        console.state.recording.set(status)
        names[status.state] = button.accessibleName()
    assert_words_differ(names)


class Aged:
    """Stream with an age set by the test."""

    age_known = True

    def __init__(self, freshness: str, *, arrives_late: bool = False) -> None:
        self.freshness, self.arrives_late = freshness, arrives_late

    def age_s(self) -> float:
        return 0.7

    silent_s = age_s


@pytest.mark.panels("drive")
def test_the_age_of_a_stream(window: MainWindow) -> None:
    bar = window.findChild(StatusBar)
    assert bar is not None
    words_of: Callable[..., tuple[str, str]] = bar._stream_words
    names = {each: words_of("LIDAR", Aged(each))[0] for each in ("fresh", "stale", "lost", "absent")}
    names["late"] = words_of("LIDAR", Aged("stale", arrives_late=True))[0]
    unknown = Aged("fresh")
    unknown.age_known = False
    names["age unknown"] = words_of("LIDAR", unknown)[0]
    assert_words_differ(names)


@pytest.mark.panels("map")
def test_the_state_of_a_goal_on_the_map(window: MainWindow, console: FakeConsole) -> None:
    panel = window.findChild(MapPanel)
    assert panel is not None
    names, states = {}, ("requested", "active", "reached", "cancelled", "failed")
    target = Pose2D(6.2, 6.4, 0)
    for state in states:
        reached: GoalState = state  # type: ignore[assignment]
        begun = GoalChanged(clock.now_ns(), state, "requested", target, place="Kitchen")
        ended = replace(begun, state=reached, detail="The way is blocked." if state == "failed" else "")
        for goal in (begun, ended):
            console.state.add(goal)
            console.state.goal.set(goal)
        names[state] = f"{panel.fact[0]} {panel.view.map_state.chips} {panel.view.map_state.goal is not None}"
    assert_words_differ(names)
