"""Bar of a replay: keys, jumps, rates, and scrubbing with a preview at the pointer."""

import dataclasses
import itertools
from collections.abc import Iterator

import pytest
from PySide6.QtCore import QEvent, QPoint, Qt
from PySide6.QtGui import QHelpEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QComboBox, QLabel, QLineEdit, QToolTip
from pytestqt.qtbot import QtBot

from caris_desktop.recording.annotation.timeline_overview import Moment
from caris_desktop.scenario.scenario_model import PanelLeaf, Scenario
from caris_desktop.ui.action_rows import ACTIONS, REPLAY_ACTIONS, TIMELINE_ACTIONS
from caris_desktop.ui.key_choices import conflicts, normalized
from caris_desktop.ui.replay.replay_bar import RATES, ReplayTimes, SeekPreview
from caris_desktop.ui.theme import Theme, icon_names
from tests.ui.conftest import click, find
from tests.ui.fake_replay import STARTED_NS, FakeReplay, ReplayScene, open_scene, sample_coding, sample_overview

LEFT = Qt.MouseButton.LeftButton
CTRL, SHIFT = Qt.KeyboardModifier.ControlModifier, Qt.KeyboardModifier.ShiftModifier


@pytest.fixture
def replay() -> FakeReplay:
    return FakeReplay(overview=sample_overview(), coding=sample_coding(120_000))


@pytest.fixture
def scene(qtbot: QtBot, theme: Theme, replay: FakeReplay) -> Iterator[ReplayScene]:
    yield open_scene(qtbot, theme, replay)


def test_no_key_of_a_replay_belongs_to_two_actions() -> None:
    rows = (*ACTIONS, *REPLAY_ACTIONS, *TIMELINE_ACTIONS)
    assert conflicts(rows) == []
    assert all(normalized(key) for row in rows for key in row.keys)
    assert {row.icon for row in rows if row.icon} <= icon_names()
    assert len({row.id for row in rows}) == len(rows)


def test_a_conflict_inside_the_timeline_would_be_found() -> None:
    split = next(row for row in TIMELINE_ACTIONS if row.id == "annotation_split")
    assert conflicts((split, next(row for row in ACTIONS if row.id == "drive_back"))) == [], "other parts, other keys"
    fit = next(row for row in TIMELINE_ACTIONS if row.id == "timeline_fit")
    same = type(fit)("other", "Other", keys=("F",), within="timeline")
    assert conflicts((fit, same)) == [("F", ("timeline_fit", "other"))]


def test_it_says_that_this_is_a_replay_and_of_what(scene: ReplayScene) -> None:
    title = scene.findChild(QLabel, "replay_title")
    assert title is not None
    assert title.text().startswith("Replay · P07 · 21 Nov 2026")


def test_play_and_pause_by_button_and_by_space(qtbot: QtBot, scene: ReplayScene, replay: FakeReplay) -> None:
    click(qtbot, find(scene, "replay_play"))
    assert replay.playback.value.playing
    assert find(scene, "replay_play").property("text") == "Pause"
    QTest.keyClick(scene.timeline.canvas, Qt.Key.Key_Space)
    assert not replay.playback.value.playing
    assert [name for name, _ in replay.calls if name in ("play", "pause")] == ["play", "pause"]


def test_space_types_in_a_field_and_presses_a_button_that_has_the_focus(
    qtbot: QtBot, scene: ReplayScene, replay: FakeReplay
) -> None:
    field = scene.findChild(QLineEdit, "tier_filter")
    assert field is not None
    field.setFocus()
    QTest.keyClicks(field, "ana , .")
    assert field.text() == "ana , ."
    assert [name for name, _ in replay.calls if name in ("play", "step")] == []
    button = find(scene, "replay_frame_on")
    button.setFocus()
    QTest.keyClick(button, Qt.Key.Key_Space)
    assert replay.named("step") == [1]
    assert replay.named("play") == []
    rates = find(scene, "replay_rate")
    assert isinstance(rates, QComboBox)
    rates.setFocus()
    QTest.keyClick(rates, Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: rates.view().isVisible())
    rates.hidePopup()
    assert replay.named("play") == []


def test_frames_jumps_and_rates_by_key(scene: ReplayScene, replay: FakeReplay) -> None:
    canvas = scene.timeline.canvas
    replay.at_ms(30_000)
    QTest.keyClick(canvas, Qt.Key.Key_Period)
    QTest.keyClick(canvas, Qt.Key.Key_Comma)
    assert replay.named("step") == [1, -1]
    QTest.keyClick(canvas, Qt.Key.Key_Right, CTRL)
    assert replay.position_ms == 47_000
    QTest.keyClick(canvas, Qt.Key.Key_Left, CTRL)
    assert replay.position_ms == 12_500
    QTest.keyClick(canvas, Qt.Key.Key_Right, CTRL | SHIFT)
    assert replay.position_ms == 14_100
    QTest.keyClick(canvas, Qt.Key.Key_Greater)
    QTest.keyClick(canvas, Qt.Key.Key_Greater)
    QTest.keyClick(canvas, Qt.Key.Key_Less)
    assert replay.named("set_rate") == [2.0, 4.0, 2.0]
    rates = find(scene, "replay_rate")
    assert isinstance(rates, QComboBox)
    assert rates.currentText() == "2×"


def test_every_rate_can_be_chosen_and_the_ends_hold(scene: ReplayScene, replay: FakeReplay) -> None:
    rates = find(scene, "replay_rate")
    assert isinstance(rates, QComboBox)
    assert [rates.itemText(number) for number in range(rates.count())] == [
        "0.1×", "0.25×", "0.5×", "1×", "2×", "4×", "8×", "16×",
    ]  # fmt: skip
    rates.activated.emit(0)
    assert replay.playback.value.rate == RATES[0]
    scene.bar.change_rate(-1)
    assert replay.playback.value.rate == RATES[0]
    replay.set_rate(3.0)
    assert rates.currentText() == "3×"


def test_a_missing_next_mark_is_reported(scene: ReplayScene, replay: FakeReplay) -> None:
    replay.at_ms(119_000)
    QTest.keyClick(scene.timeline.canvas, Qt.Key.Key_Right, CTRL)
    assert find(scene, "replay_hint").property("text") == "No later mark"


def test_times_are_those_of_the_session_and_of_the_wall(scene: ReplayScene, replay: FakeReplay) -> None:
    replay.at_ms(61_250)
    times = scene.findChild(ReplayTimes)
    assert times is not None
    assert (times.now.text(), times.total.text()) == ("01:01.2", "of 02:00")
    assert times.wall.text().endswith(replay.session.clock.wall(STARTED_NS + 61_250_000_000)[:8])


def test_a_click_on_the_scrubber_goes_there(scene: ReplayScene, replay: FakeReplay) -> None:
    scrubber = scene.bar.scrubber
    at = QPoint(round(scrubber.x_of(STARTED_NS + 60_000_000_000)), 16)
    QTest.mouseClick(scrubber, LEFT, pos=at)
    assert replay.position_ms == pytest.approx(60_000, abs=120_000 / scrubber.width())
    assert scrubber.shown_ns == replay.playback.value.position_ns


def test_dragging_seeks_now_and_then_and_ends_where_it_was_let_go(
    qtbot: QtBot, scene: ReplayScene, replay: FakeReplay
) -> None:
    scrubber = scene.bar.scrubber
    QTest.mousePress(scrubber, LEFT, pos=QPoint(100, 16))
    for x in range(101, 701):
        QTest.mouseMove(scrubber, QPoint(x, 16))
    last = scrubber.moment_at(700)
    assert scrubber.shown_ns == last, "the handle is where the pointer is, however late the pictures come"
    QTest.mouseRelease(scrubber, LEFT, pos=QPoint(700, 16))
    qtbot.waitUntil(lambda: replay.named("seek")[-1] == last)
    assert len(replay.named("seek")) < 200


def test_arrows_and_ends_move_a_focused_scrubber(scene: ReplayScene, replay: FakeReplay) -> None:
    scrubber = scene.bar.scrubber
    scrubber.setFocus()
    replay.at_ms(30_000)
    QTest.keyClick(scrubber, Qt.Key.Key_Right)
    assert replay.position_ms == 35_000
    QTest.keyClick(scrubber, Qt.Key.Key_Home)
    assert replay.position_ms == 0
    QTest.keyClick(scrubber, Qt.Key.Key_End)
    assert replay.position_ms == 120_000
    QTest.keyClick(scrubber, Qt.Key.Key_Tab)
    assert not scrubber.hasFocus(), "the focus is never trapped"


def test_the_position_after_a_key_is_announced_and_playback_is_not(scene: ReplayScene, replay: FakeReplay) -> None:
    """A screen reader reads each changed description of the focused widget, and on focus."""
    scrubber = scene.bar.scrubber
    scrubber.setFocus()
    replay.at_ms(30_000)
    QTest.keyClick(scrubber, Qt.Key.Key_Right)
    description = scrubber.accessibleDescription()
    assert description.startswith("00:35.0")
    replay.at_ms(50_000)
    assert scrubber.accessibleDescription() == description
    assert scrubber.accessible_words().startswith("00:50.0")
    QTest.keyClick(scrubber, Qt.Key.Key_End)
    assert scrubber.accessibleDescription().startswith("02:00.0")


def test_the_pointer_shows_a_picture_and_the_time_of_a_moment(
    qtbot: QtBot, scene: ReplayScene, replay: FakeReplay
) -> None:
    scrubber = scene.bar.scrubber
    at_ns = STARTED_NS + 47_000_000_000
    QTest.mouseMove(scrubber, QPoint(round(scrubber.x_of(at_ns)), 16))
    bubble = scene.findChild(SeekPreview)
    assert bubble is not None
    qtbot.waitUntil(lambda: not bubble.picture.pixmap().isNull())
    assert bubble.isVisible()
    assert bubble.time.text().startswith(("00:47.0", "00:46.9"))
    assert scene.rect().contains(bubble.geometry())
    assert replay.calls[0][0] == "request_thumbnail"
    QTest.mouseMove(scene.timeline.canvas, QPoint(300, 100))
    qtbot.waitUntil(lambda: not bubble.isVisible())


def test_the_bubble_has_names_where_the_record_has_ids(qtbot: QtBot, scene: ReplayScene, replay: FakeReplay) -> None:
    at_ns = STARTED_NS + 47_000_000_000
    overview = replay.overview.value
    replay.overview.set(dataclasses.replace(overview, moments=(Moment("utterance", at_ns, "robot: Hello, {p-1}!"),)))
    QTest.mouseMove(scene.bar.scrubber, QPoint(round(scene.bar.scrubber.x_of(at_ns)), 16))
    bubble = scene.findChild(SeekPreview)
    assert bubble is not None
    qtbot.waitUntil(lambda: bubble.words.text() == "robot: Hello, Luis!")


def test_without_video_the_bubble_is_the_time_alone(qtbot: QtBot, theme: Theme) -> None:
    replay = FakeReplay(overview=sample_overview(video=False))
    scene = ReplayScene(theme, replay)
    qtbot.addWidget(scene)
    scene.show()
    QTest.mouseMove(scene.bar.scrubber, QPoint(400, 16))
    bubble = scene.findChild(SeekPreview)
    assert bubble is not None
    assert bubble.isVisible()
    assert bubble.height() < 60
    assert replay.named("request_thumbnail") == []


def test_the_bar_fits_a_narrow_window(qtbot: QtBot, theme: Theme, replay: FakeReplay) -> None:
    scene = ReplayScene(theme, replay)
    qtbot.addWidget(scene)
    scene.resize(1000, 500)
    scene.show()
    assert scene.width() == 1000
    title = scene.findChild(QLabel, "replay_title")
    assert title is not None
    assert title.text() == "Replay · P07"


def test_the_keys_stay_when_the_replay_comes_to_another_scenario(scene: ReplayScene, replay: FakeReplay) -> None:
    scene.actions_table.rebuild(Scenario("Another", PanelLeaf("speak")))
    QTest.keyClick(scene.timeline.canvas, Qt.Key.Key_Space)
    QTest.keyClick(scene.timeline.canvas, Qt.Key.Key_Period)
    assert replay.named("play") == [None]
    assert replay.named("step") == [1]
    assert scene.actions_table.key_text("replay_play") == "Space"


def test_in_one_line_there_is_everything_but_words_and_keys(
    qtbot: QtBot, scene: ReplayScene, replay: FakeReplay
) -> None:
    bar = scene.bar
    bar.set_one_line(True)
    scene.resize(683, 384)
    QApplication.processEvents()
    assert bar.height() == 48
    shown = [
        find(bar, name) for name in ("replay_previous_mark", "replay_frame_back", "replay_play", "replay_frame_on")
    ]
    shown += [find(bar, "replay_next_mark"), bar.scrubber, find(bar, "replay_times"), find(bar, "replay_rate")]
    places = [widget.geometry() for widget in shown]
    assert all(one.right() < other.left() for one, other in itertools.pairwise(places))
    assert bar.scrubber.width() > 120
    play = find(bar, "replay_play")
    assert (play.property("text"), play.accessibleName()) == ("", "Play")
    QToolTip.hideText()
    QApplication.sendEvent(play, QHelpEvent(QEvent.Type.ToolTip, QPoint(5, 5), play.mapToGlobal(QPoint(5, 5))))
    assert QToolTip.text() == "Play (Space)"
    QToolTip.hideText()
    replay.overview.set(None)
    QTest.keyClick(scene.timeline.canvas, Qt.Key.Key_Right, CTRL)
    hint = find(bar, "replay_hint")
    QApplication.processEvents()
    assert hint.isVisible() and hint.property("text") == "No later mark"
    assert not hint.geometry().intersects(play.geometry())
    bar.set_one_line(False)
    scene.resize(1350, 620)
    QApplication.processEvents()
    assert bar.height() == 84
    assert play.property("text") == "Play"
