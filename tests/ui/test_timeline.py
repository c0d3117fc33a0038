"""Timeline: annotation by pointer and keyboard, in a window, with real events."""

import itertools
import random
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from PySide6.QtCore import QPoint, QPointF, Qt
from PySide6.QtGui import QWheelEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QComboBox, QLineEdit, QMenu, QPlainTextEdit, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain.translation import tr
from caris_desktop.recording.annotation.annotation_editing import EditHistory, tier_of
from caris_desktop.recording.annotation.annotation_model import (
    DEFAULT_TIER,
    Annotation,
    AnnotationDocument,
    Tier,
    Vocabulary,
    VocabularyEntry,
)
from caris_desktop.recording.annotation.coder_agreement import NOTHING
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.replay.replay_dialogs import UNIT_MS, AgreementDialog, TierDialog
from caris_desktop.ui.replay.timeline_commands import NUDGE_MS, LabelCard
from caris_desktop.ui.replay.timeline_items import NAMES_PX, RULER_PX, SCENARIO_LABELS, TimeScale
from caris_desktop.ui.replay.timeline_view import TimelineView
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from tests.support.examples import examples
from tests.ui.conftest import MemorySettings, click, find, open_window
from tests.ui.fake_console import FakeConsole
from tests.ui.fake_replay import STANCE, FakeReplay, ReplayScene, open_scene, sample_coding, sample_overview

LEFT = Qt.MouseButton.LeftButton
CTRL, SHIFT, NONE = (
    Qt.KeyboardModifier.ControlModifier,
    Qt.KeyboardModifier.ShiftModifier,
    Qt.KeyboardModifier.NoModifier,
)
ANA, REMARKS, BEN = "c-Ana-tier-1", "c-Ana-tier-2", "c-Ben-tier-1"


class Coder:
    """Coder with mouse and keyboard, who finds items by their position on the screen."""

    def __init__(self, timeline: TimelineView, replay: FakeReplay) -> None:
        self.timeline, self.replay, self.canvas = timeline, replay, timeline.canvas

    @property
    def document(self) -> AnnotationDocument:
        return self.timeline.acts.document

    def values(self, tier_id: str) -> list[tuple[int, int, str]]:
        return [(item.start_ms, item.end_ms, item.value) for item in self.document.of_tier(tier_id)]

    def y_of(self, tier_id: str) -> int:
        index = self.canvas.index_of(f"tier {tier_id}")
        assert index is not None, f"{tier_id} is not on show"
        return self.canvas.row_top(index) + self.canvas.rows[index].height_px // 2

    def point(self, tier_id: str, at_ms: float) -> QPoint:
        return QPoint(NAMES_PX + round(self.canvas.scale.to_px(at_ms)), self.y_of(tier_id))

    def ms_at(self, point: QPoint) -> float:
        return self.canvas.scale.to_ms(point.x() - NAMES_PX)

    def drag(self, start: QPoint, end: QPoint) -> None:
        QTest.mousePress(self.canvas, LEFT, pos=start)
        QTest.mouseMove(self.canvas, (start + end) / 2)
        QTest.mouseMove(self.canvas, end)
        QTest.mouseRelease(self.canvas, LEFT, pos=end)

    def click(self, tier_id: str, at_ms: float) -> None:
        QTest.mouseClick(self.canvas, LEFT, pos=self.point(tier_id, at_ms))

    def key(self, key: Qt.Key, modifiers: Qt.KeyboardModifier = NONE) -> None:
        QTest.keyClick(self.canvas, key, modifiers)

    def type(self, text: str) -> None:
        """Type into the label card."""
        field = QApplication.focusWidget()
        assert isinstance(field, QLineEdit), "no field asks for a label"
        QTest.keyClicks(field, text)

    def enter(self) -> None:
        focused = QApplication.focusWidget()
        assert focused is not None
        QTest.keyClick(focused, Qt.Key.Key_Return)

    def show(self, start_ms: float, end_ms: float) -> None:
        self.canvas.set_scale(TimeScale(start_ms, self.canvas.room_px / (end_ms - start_ms)))


@pytest.fixture
def replay() -> FakeReplay:
    return FakeReplay(overview=sample_overview(), coding=sample_coding(120_000))


@pytest.fixture
def scene(qtbot: QtBot, theme: Theme, replay: FakeReplay) -> Iterator[ReplayScene]:
    yield open_scene(qtbot, theme, replay)


@pytest.fixture
def coder(scene: ReplayScene, replay: FakeReplay) -> Coder:
    return Coder(scene.timeline, replay)


def test_dragging_on_a_tier_adds_an_annotation_and_requests_its_label(coder: Coder) -> None:
    start, end = coder.point(ANA, 95_000), coder.point(ANA, 99_000)
    coder.drag(start, end)
    card = coder.timeline.window().findChild(LabelCard)
    assert card is not None
    assert card.isVisible()
    coder.type("res")
    coder.enter()
    assert not card.isVisible()
    assert coder.values(ANA)[-1] == (round(coder.ms_at(start)), round(coder.ms_at(end)), "reserved")
    assert coder.canvas.hasFocus(), "the next key is for the timeline again"


def test_free_text_is_written_and_saved_when_the_focus_goes(coder: Coder) -> None:
    coder.drag(coder.point(REMARKS, 60_000), coder.point(REMARKS, 62_000))
    coder.type("looks at the arm 1 2")
    coder.canvas.setFocus()
    assert coder.values(REMARKS)[-1][2] == "looks at the arm 1 2"


def test_a_new_annotation_ends_where_its_neighbour_begins(coder: Coder) -> None:
    first, second = coder.values(ANA)[0], coder.values(ANA)[1]
    assert first[1] + 1000 < second[0]
    coder.drag(coder.point(ANA, first[1] + 600), coder.point(ANA, second[0] + 2000))
    coder.timeline.acts.give_up()
    assert coder.values(ANA)[1][1:] == (second[0], "")


def test_a_click_selects_and_next_to_it_goes_there(qtbot: QtBot, coder: Coder) -> None:
    item = coder.document.of_tier(ANA)[2]
    coder.click(ANA, (item.start_ms + item.end_ms) / 2)
    assert coder.canvas.selected == item
    assert find(coder.timeline, "timeline_fact").property("text").startswith(item.value)
    assert coder.replay.named("seek") == []
    coder.click(ANA, 110_000)
    assert coder.canvas.selected is None
    qtbot.waitUntil(lambda: abs(coder.replay.position_ms - 110_000) < 200)


def test_dragging_moves_and_keeps_the_length(coder: Coder) -> None:
    last = coder.values(ANA)[-1]
    middle = coder.point(ANA, (last[0] + last[1]) / 2)
    coder.drag(middle, middle + QPoint(60, 0))
    moved = coder.values(ANA)[-1]
    assert moved[1] - moved[0] == last[1] - last[0]
    assert moved[0] - last[0] == pytest.approx(60 / coder.canvas.scale.px_per_ms, abs=1)


def test_dragging_an_edge_changes_that_edge_alone(coder: Coder) -> None:
    coder.show(0, 30_000)
    first = coder.values(ANA)[0]
    end = coder.point(ANA, first[1]) - QPoint(2, 0)
    coder.drag(end, end + QPoint(20, 0))
    changed = coder.values(ANA)[0]
    assert changed[0] == first[0]
    assert changed[1] - first[1] == pytest.approx(20 / coder.canvas.scale.px_per_ms, abs=1)
    start = coder.point(ANA, first[0]) + QPoint(2, 0)
    coder.drag(start, start - QPoint(15, 0))
    assert coder.values(ANA)[0][0] - first[0] == pytest.approx(-15 / coder.canvas.scale.px_per_ms, abs=1)
    assert coder.values(ANA)[0][1] == changed[1]


def test_an_edge_snaps_to_the_playhead(coder: Coder) -> None:
    coder.show(0, 30_000)
    first = coder.values(ANA)[0]
    coder.replay.at_ms(first[1] + 700)
    end = coder.point(ANA, first[1]) - QPoint(2, 0)
    coder.drag(end, coder.point(ANA, first[1] + 650) - QPoint(2, 0))
    assert coder.values(ANA)[0][1] == first[1] + 700


def test_an_annotation_goes_to_another_tier_of_its_coder_only(coder: Coder) -> None:
    last = coder.values(ANA)[-1]
    middle = coder.point(ANA, (last[0] + last[1]) / 2)
    coder.drag(middle, QPoint(middle.x(), coder.y_of(REMARKS)))
    assert last in coder.values(REMARKS)
    assert last not in coder.values(ANA)
    before = coder.document
    middle = coder.point(REMARKS, (last[0] + last[1]) / 2)
    coder.drag(middle, QPoint(middle.x(), coder.y_of(BEN)))
    assert coder.document == before, "what Ana saw does not become Ben's"


def test_an_overlap_is_refused_in_words_next_to_it(coder: Coder) -> None:
    before, first = coder.document, coder.values(ANA)[0]
    middle = coder.point(ANA, (first[0] + first[1]) / 2)
    coder.drag(middle, middle + QPoint(40, 0))
    assert coder.document == before
    assert "is already on the tier" in coder.timeline.acts.words
    bubble = find(coder.canvas, "words_bubble")
    rect = coder.canvas.rect_of(coder.document.of_tier(ANA)[0])
    assert rect is not None
    assert abs(bubble.geometry().top() - rect.bottom()) < 60
    coder.timeline.acts.give_up()
    assert coder.timeline.acts.words == ""


def test_the_record_can_be_looked_at_but_not_changed(qtbot: QtBot, coder: Coder) -> None:
    row = next(row for row in coder.canvas.rows if row.name == "Robot speech")
    index = coder.canvas.index_of(row.key)
    assert index is not None
    item = coder.canvas.track_of(row).annotations[3]
    x = NAMES_PX + round(coder.canvas.scale.to_px((item.start_ms + item.end_ms) / 2))
    at = QPoint(x, coder.canvas.row_top(index) + 12)
    before = coder.document
    coder.drag(at, at + QPoint(80, 0))
    qtbot.waitUntil(lambda: coder.replay.position_ms == item.start_ms)
    assert coder.canvas.selected == item
    active = coder.canvas.active
    assert active is not None
    assert active.own, "the tier to code on stays chosen"
    QTest.mouseDClick(coder.canvas, LEFT, pos=at)
    coder.key(Qt.Key.Key_Delete)
    assert "from the record" in coder.timeline.acts.words
    assert coder.document == before


def test_renaming_by_double_click_and_by_return(coder: Coder) -> None:
    item = coder.document.of_tier(ANA)[1]
    QTest.mouseDClick(coder.canvas, LEFT, pos=coder.point(ANA, (item.start_ms + item.end_ms) / 2))
    coder.type("4")
    assert coder.values(ANA)[1][2] == "confused"
    coder.key(Qt.Key.Key_Return)
    focused = QApplication.focusWidget()
    assert focused is not None
    QTest.keyClick(focused, Qt.Key.Key_Up)
    coder.enter()
    assert coder.values(ANA)[1][2] == "reserved"


def test_esc_gives_a_label_up(coder: Coder) -> None:
    before = coder.document
    coder.click(ANA, 5000)
    coder.key(Qt.Key.Key_Return)
    coder.type("neu")
    focused = QApplication.focusWidget()
    assert focused is not None
    QTest.keyClick(focused, Qt.Key.Key_Escape)
    assert coder.document == before
    assert coder.canvas.hasFocus()


def test_a_text_that_no_vocabulary_has_is_not_taken(coder: Coder) -> None:
    before = coder.document
    coder.click(ANA, 5000)
    coder.key(Qt.Key.Key_Return)
    coder.type("bored")
    coder.enter()
    card = coder.timeline.window().findChild(LabelCard)
    assert card is not None
    assert card.isVisible(), "nothing fits, so it still asks"
    coder.timeline.acts.give_up()
    assert coder.document == before


def test_splitting_removing_undoing(coder: Coder) -> None:
    first = coder.values(ANA)[0]
    at_ms = (first[0] + first[1]) // 2
    coder.replay.at_ms(at_ms)
    coder.key(Qt.Key.Key_S)
    assert coder.values(ANA)[:2] == [(first[0], at_ms, first[2]), (at_ms, first[1], first[2])]
    selected = coder.canvas.selected
    assert selected is not None
    assert selected.start_ms == at_ms, "the second half can be named at once"
    coder.key(Qt.Key.Key_Delete)
    assert coder.values(ANA)[0] == (first[0], at_ms, first[2])
    coder.key(Qt.Key.Key_Z, CTRL)
    coder.key(Qt.Key.Key_Z, CTRL)
    assert coder.values(ANA)[0] == first
    coder.key(Qt.Key.Key_Z, CTRL | SHIFT)
    assert coder.values(ANA)[0] == (first[0], at_ms, first[2])
    coder.key(Qt.Key.Key_Y, CTRL)
    assert coder.values(ANA)[1][0] != at_ms
    coder.key(Qt.Key.Key_Y, CTRL)
    assert coder.timeline.acts.words == "There is nothing to redo."


def test_undo_and_redo_say_which_step_they_change(coder: Coder) -> None:
    def tips() -> list[str]:
        return [find(coder.timeline, name).toolTip() for name in ("undo", "redo")]

    assert tips() == ["Undo", "Redo"]
    coder.replay.at_ms(95_000)
    coder.key(Qt.Key.Key_N)
    coder.timeline.acts.give_up()
    assert tips() == ["Undo: add annotation", "Redo"]
    coder.click(ANA, 5000)
    coder.key(Qt.Key.Key_3)
    assert tips() == ["Undo: change annotation", "Redo"]
    coder.key(Qt.Key.Key_Z, CTRL)
    assert tips() == ["Undo: add annotation", "Redo: change annotation"]
    coder.key(Qt.Key.Key_Delete)
    assert tips() == ["Undo: remove annotation", "Redo"]


def test_label_keys_start_and_end_while_it_plays(coder: Coder) -> None:
    coder.replay.play()
    coder.replay.at_ms(95_000)
    coder.key(Qt.Key.Key_2)
    assert find(coder.timeline.strip, "code_2").property("text") == "End neutral"
    coder.replay.at_ms(97_500)
    coder.key(Qt.Key.Key_3)
    coder.replay.at_ms(99_000)
    coder.key(Qt.Key.Key_3)
    assert coder.values(ANA)[-2:] == [(95_000, 97_500, "neutral"), (97_500, 99_000, "reserved")]
    coder.key(Qt.Key.Key_1)
    coder.timeline.acts.give_up()
    coder.replay.at_ms(101_000)
    coder.key(Qt.Key.Key_1)
    coder.key(Qt.Key.Key_Delete)
    assert coder.values(ANA)[-1] == (97_500, 99_000, "reserved"), "what was given up is not there"


def test_a_label_that_continues_ends_before_what_is_there_already(coder: Coder) -> None:
    second = coder.values(ANA)[1]
    free_ms = coder.values(ANA)[0][1]
    coder.replay.play()
    coder.replay.at_ms(free_ms + 100)
    coder.key(Qt.Key.Key_4)
    coder.replay.at_ms(second[1] + 300)
    coder.key(Qt.Key.Key_4)
    assert coder.values(ANA)[1] == (free_ms + 100, second[0], "confused")
    coder.replay.at_ms(second[0] + 100)
    coder.key(Qt.Key.Key_1)
    assert f"“{second[2]}” is already here" in coder.timeline.acts.words


def test_label_keys_name_what_is_selected_while_it_stands_still(coder: Coder) -> None:
    coder.click(ANA, 5000)
    coder.key(Qt.Key.Key_3)
    assert coder.values(ANA)[0][2] == "reserved"
    assert len(coder.values(ANA)) == len(sample_coding(120_000).of_tier(ANA))


def test_label_buttons_do_what_their_keys_do(qtbot: QtBot, coder: Coder) -> None:
    coder.replay.at_ms(95_000)
    click(qtbot, find(coder.timeline.strip, "code_1"))
    coder.replay.at_ms(96_000)
    click(qtbot, find(coder.timeline.strip, "code_1"))
    assert coder.values(ANA)[-1] == (95_000, 96_000, "curious")
    assert coder.canvas.hasFocus()


def test_labels_without_room_are_in_a_menu_and_what_can_be_done_keeps_its_icons(qtbot: QtBot, coder: Coder) -> None:
    strip = coder.timeline.strip
    labels = [find(strip, f"code_{number}") for number in range(1, 5)]
    coder.timeline.window().resize(420, 384)
    QApplication.processEvents()
    left_out = [label for label in labels if not label.isVisible()]
    assert labels[0].isVisible() and left_out
    shown = [widget for widget in strip.findChildren(ActionButton) if widget.isVisible()]
    places = sorted((widget.geometry() for widget in shown), key=lambda place: place.left())
    assert all(one.right() < other.left() for one, other in itertools.pairwise(places))
    assert places[-1].right() <= strip.width()
    assert all(find(strip, name).accessibleName() for name in ("annotation_new", "annotation_remove"))
    more = find(strip, "coding_more")
    click(qtbot, more)
    menu = strip.findChild(QMenu)
    assert menu is not None
    words = [f"{number + 1}  {entry.value}" for number, entry in enumerate(STANCE.entries)]
    assert [action.text() for action in menu.actions()] == words[-len(left_out) :]
    coder.replay.at_ms(95_000)
    menu.actions()[-1].trigger()
    menu.close()
    coder.replay.at_ms(96_000)
    coder.key(Qt.Key.Key_4)
    assert coder.values(ANA)[-1] == (95_000, 96_000, "confused")
    coder.timeline.window().resize(1350, 620)
    QApplication.processEvents()
    assert all(label.isVisible() for label in labels)
    assert not more.isVisible()


def test_keys_change_the_ends_and_the_place_of_an_annotation(coder: Coder) -> None:
    last = coder.values(ANA)[-1]
    coder.click(ANA, last[0] + 500)
    coder.replay.at_ms(last[0] + 800)
    coder.key(Qt.Key.Key_B)
    coder.replay.at_ms(last[1] + 300)
    coder.key(Qt.Key.Key_E)
    coder.key(Qt.Key.Key_Right, SHIFT)
    assert coder.values(ANA)[-1][:2] == (last[0] + 800 + NUDGE_MS, last[1] + 300 + NUDGE_MS)
    coder.replay.at_ms(110_000)
    coder.key(Qt.Key.Key_N)
    coder.timeline.acts.give_up()
    assert coder.values(ANA)[-1] == (110_000, 111_000, "")


def test_keys_go_through_tiers_and_annotations(coder: Coder) -> None:
    coder.key(Qt.Key.Key_Down)
    active = coder.canvas.active
    assert active is not None
    assert active.name == "Remarks"
    coder.key(Qt.Key.Key_PageDown)
    assert coder.replay.position_ms == 15_000
    coder.key(Qt.Key.Key_PageDown)
    assert coder.replay.position_ms == 42_000
    coder.key(Qt.Key.Key_PageDown)
    assert coder.timeline.acts.words == "No later annotation on Remarks."
    coder.key(Qt.Key.Key_Left)
    assert coder.replay.position_ms == 41_000
    coder.key(Qt.Key.Key_2)
    assert "free text" in coder.timeline.acts.words
    QTest.keyClick(coder.canvas, Qt.Key.Key_Tab)
    assert not coder.canvas.hasFocus(), "the focus is never trapped"


def test_zoom_and_scroll(coder: Coder) -> None:
    canvas = coder.canvas
    pointer = QPointF(NAMES_PX + 300, RULER_PX + 80)
    under_ms = canvas.scale.to_ms(300)
    wheel = QWheelEvent(
        pointer, canvas.mapToGlobal(pointer), QPoint(), QPoint(0, 480), Qt.MouseButton.NoButton, CTRL,
        Qt.ScrollPhase.NoScrollPhase, False,
    )  # fmt: skip
    QApplication.sendEvent(canvas, wheel)
    assert canvas.scale.to_ms(300) == pytest.approx(under_ms)
    assert canvas.scale.px_per_ms == pytest.approx(1.25**4 * canvas.room_px / 120_000)
    coder.key(Qt.Key.Key_F)
    assert canvas.scale.to_ms(canvas.room_px) == pytest.approx(120_000)
    coder.key(Qt.Key.Key_Plus, SHIFT)
    coder.key(Qt.Key.Key_Equal)
    assert canvas.scale.px_per_ms == pytest.approx(1.5**2 * canvas.room_px / 120_000)
    coder.key(Qt.Key.Key_Minus)
    assert canvas.scale.px_per_ms == pytest.approx(1.5 * canvas.room_px / 120_000)


def test_the_view_follows_the_playhead_over_its_edge_and_to_a_jump(coder: Coder) -> None:
    coder.show(0, 20_000)
    coder.replay.play()
    coder.replay.at_ms(19_900)
    assert coder.canvas.scale.start_ms == 0
    coder.replay.at_ms(20_050)
    assert coder.canvas.scale.to_px(20_050) == pytest.approx(0.1 * coder.canvas.room_px)
    coder.replay.at_ms(80_000)
    assert 0 < coder.canvas.scale.to_px(80_000) < coder.canvas.room_px


def test_dragging_over_the_edge_scrolls(coder: Coder) -> None:
    coder.show(90_000, 100_000)
    start = coder.point(ANA, 95_000)
    began_ms = coder.ms_at(start)
    QTest.mousePress(coder.canvas, LEFT, pos=start)
    for _ in range(5):
        QTest.mouseMove(coder.canvas, QPoint(coder.canvas.width() + 60, start.y()))
        QTest.mouseMove(coder.canvas, QPoint(coder.canvas.width() + 61, start.y()))
    assert coder.canvas.scale.start_ms > 92_000
    end = QPoint(coder.canvas.width() - 100, start.y())
    QTest.mouseMove(coder.canvas, end)
    end_ms = coder.ms_at(end)
    QTest.mouseRelease(coder.canvas, LEFT, pos=end)
    coder.timeline.acts.give_up()
    assert coder.values(ANA)[-1] == (round(began_ms), round(end_ms), "")


def test_the_ruler_goes_to_a_moment(qtbot: QtBot, coder: Coder) -> None:
    x = NAMES_PX + round(coder.canvas.scale.to_px(60_000))
    QTest.mouseClick(coder.canvas, LEFT, pos=QPoint(x, 10))
    qtbot.waitUntil(lambda: abs(coder.replay.position_ms - 60_000) < 200)


def test_rows_are_filtered_hidden_and_moved(coder: Coder) -> None:
    names = [row.name for row in coder.canvas.rows]
    field = find(coder.timeline, "tier_filter")
    assert isinstance(field, QLineEdit)
    QTest.keyClicks(field, "stance")
    assert [(row.name, row.coder) for row in coder.canvas.rows] == [("Stance", "Ana"), ("Stance", "Ben")]
    field.clear()
    coder.timeline.set_row_shown("speed", shown=False)
    assert [row.name for row in coder.canvas.rows] == [name for name in names if name != "Speed"]
    index = coder.canvas.index_of(f"tier {BEN}")
    assert index is not None
    grip = QPoint(60, coder.y_of(BEN))
    coder.drag(grip, QPoint(60, coder.y_of(ANA) - 12))
    assert [row.coder for row in coder.canvas.rows if row.own] == ["Ben", "Ana", "Ana"]
    assert [tier.tier_id for tier in coder.document.tiers] == [BEN, ANA, REMARKS], "kept with the annotations"


def test_the_rows_menu_shows_and_hides(qtbot: QtBot, coder: Coder) -> None:
    click(qtbot, find(coder.timeline, "rows_menu_button"))
    menu = coder.timeline.findChild(QMenu, "rows_menu")
    assert menu is not None
    video = next(action for action in menu.actions() if action.text() == "Video")
    assert video.isChecked()
    QTest.mouseClick(menu, LEFT, pos=menu.actionGeometry(video).center())
    assert "Video" not in [row.name for row in coder.canvas.rows]
    menu.close()


def test_a_tier_is_added_with_labels_of_the_scenario_and_changed(qtbot: QtBot, coder: Coder) -> None:
    click(qtbot, find(coder.timeline, "add_tier"))
    dialog = coder.timeline.findChild(TierDialog)
    assert dialog is not None
    boxes = {box.objectName(): box for box in dialog.findChildren(QComboBox)}
    boxes["tier_coder"].setCurrentText("Cleo")
    boxes["tier_vocabulary"].setCurrentText(SCENARIO_LABELS)
    name = dialog.findChild(QLineEdit, "tier_name")
    assert name is not None
    QTest.keyClicks(name, "Acts")
    QTest.keyClick(name, Qt.Key.Key_Return)
    tier = coder.document.tiers[-1]
    assert (tier.coder, tier.name, tier.vocabulary) == ("Cleo", "Acts", SCENARIO_LABELS)
    assert [entry.value for entry in coder.document.vocabularies[-1].entries] == ["greeting", "question"]
    active = coder.canvas.active
    assert active is not None
    assert active.tier == tier, "the next key codes on it"
    qtbot.waitUntil(lambda: coder.timeline.findChild(TierDialog) is None)
    QTest.mouseDClick(coder.canvas, LEFT, pos=QPoint(60, coder.y_of(tier.tier_id)))
    dialog = coder.timeline.findChild(TierDialog)
    assert dialog is not None
    labels = dialog.findChild(QPlainTextEdit)
    assert labels is not None
    labels.setPlainText("greeting: says hello\nquestion\nfarewell")
    click(qtbot, find(dialog, "tier_save"))
    assert coder.document.vocabularies[-1].entries == (
        VocabularyEntry("greeting", "says hello"), VocabularyEntry("question"), VocabularyEntry("farewell"),
    )  # fmt: skip
    coder.timeline.window().activateWindow()  # as a window manager does
    qtbot.waitUntil(lambda: QApplication.activeWindow() is coder.timeline.window())
    coder.key(Qt.Key.Key_Z, CTRL)
    coder.key(Qt.Key.Key_Z, CTRL)
    assert len(coder.document.tiers) == 3


@pytest.mark.usefixtures("trial_language")
def test_a_tier_that_is_named_in_the_wizards_language_keeps_its_name_in_the_file(theme: Theme) -> None:
    tier, parent = Tier("t", DEFAULT_TIER, "Ana"), QWidget()
    dialog = TierDialog(theme, AnnotationDocument((tier,)), parent, apply=lambda _wish: "", tier=tier)
    name = dialog.findChild(QLineEdit, "tier_name")
    assert name is not None
    assert name.text() == tr(DEFAULT_TIER) != DEFAULT_TIER
    assert dialog.requested_tier().name == DEFAULT_TIER
    name.setText("Stance")
    assert dialog.requested_tier().name == "Stance"
    parent.deleteLater()


def test_a_label_called_otherwise_takes_its_annotations_along(coder: Coder, qtbot: QtBot) -> None:
    before = [value for _, _, value in coder.values(ANA)]
    coder.timeline._open_tier_dialog(coder.document.tiers[0])
    dialog = coder.timeline.findChild(TierDialog)
    assert dialog is not None
    labels = dialog.findChild(QPlainTextEdit)
    assert labels is not None
    labels.setPlainText(labels.toPlainText().replace("curious", "interested"))
    click(qtbot, find(dialog, "tier_save"))
    assert [value for _, _, value in coder.values(ANA)] == [
        "interested" if value == "curious" else value for value in before
    ]
    assert "curious" not in [value for _, _, value in coder.values(BEN)], "Ben’s tier has the same vocabulary"


def test_a_tier_that_cannot_be_added_says_why_and_asks_on(qtbot: QtBot, coder: Coder) -> None:
    coder.timeline.open_tier_dialog()
    dialog = coder.timeline.findChild(TierDialog)
    assert dialog is not None
    name = dialog.findChild(QLineEdit, "tier_name")
    assert name is not None
    QTest.keyClicks(name, "Stance")
    click(qtbot, find(dialog, "tier_save"))
    assert "Ana already has a tier" in find(dialog, "tier_refusal").property("text")
    assert dialog.isVisible()
    dialog.reject()


def test_a_tier_is_removed_from_its_menu_and_comes_back(coder: Coder) -> None:
    coder.timeline.open_row_menu(f"tier {BEN}", QPoint(10, 10))
    menu = coder.timeline.findChild(QMenu, "row_menu")
    assert menu is not None
    remove = next(action for action in menu.actions() if action.text().startswith("Remove the tier"))
    assert "14 annotations" in remove.text()
    QTest.mouseClick(menu, LEFT, pos=menu.actionGeometry(remove).center())
    assert BEN not in [tier.tier_id for tier in coder.document.tiers]
    coder.key(Qt.Key.Key_Z, CTRL)
    assert coder.document == sample_coding(120_000)


def test_annotations_are_taken_over_from_a_file(qtbot: QtBot, coder: Coder) -> None:
    click(qtbot, find(coder.timeline, "import_annotations"))
    dialog = coder.timeline.findChild(QWidget, "import_dialog")
    assert dialog is not None
    path = dialog.findChild(QLineEdit, "import_path")
    assert path is not None
    path.setText("/somewhere/notes.odt")
    click(qtbot, find(dialog, "import_take"))
    assert "neither an .eaf nor a CSV" in find(dialog, "import_refusal").property("text")
    path.setText("/somewhere/ben.eaf")
    box = dialog.findChild(QComboBox)
    assert box is not None
    box.setCurrentText("Ben")
    click(qtbot, find(dialog, "import_take"))
    assert coder.replay.named("import_annotations")[-1] == (Path("/somewhere/ben.eaf"), "Ben")
    assert not dialog.isVisible()


def test_agreement_of_a_likely_pair_is_shown_in_words(qtbot: QtBot, coder: Coder) -> None:
    click(qtbot, find(coder.timeline, "agreement"))
    dialog = coder.timeline.findChild(AgreementDialog)
    assert dialog is not None
    result = dialog.agreement
    assert result is not None
    assert result.coders == ("Ana", "Ben")
    assert result.per_unit.kappa is not None
    assert find(dialog, "agreement_kappa").property("text") == f"κ {result.per_unit.kappa:.2f}, substantial"
    assert "Ben starts them 380 ms later" in find(dialog, "agreement_lines").property("text")
    second = dialog.findChild(QComboBox, "agreement_second")
    assert second is not None
    second.setCurrentIndex(0)
    assert find(dialog, "agreement_lines").property("text") == "Choose two different tiers."
    dialog.reject()


def codes_of(document: AnnotationDocument, tier_id: str) -> list[str]:
    """Codes of the tier at the middle of each time unit, computed independently of the program."""
    items = document.of_tier(tier_id)
    middles = [UNIT_MS * number + UNIT_MS / 2 for number in range(document.duration_ms // UNIT_MS)]
    return [
        next((item.value for item in items if item.start_ms <= middle < item.end_ms), NOTHING) for middle in middles
    ]


def test_an_uncoded_session_requests_a_tier(qtbot: QtBot, theme: Theme) -> None:
    scene = open_scene(qtbot, theme, FakeReplay(overview=sample_overview(video=False, sound=False)))
    assert "Nothing is coded" in find(scene, "coding_words").property("text")
    assert [row.kind for row in scene.timeline.canvas.rows][:2] == ["speed", "tier"]
    click(qtbot, find(scene, "coding_add_tier"))
    dialog = scene.timeline.findChild(TierDialog)
    assert dialog is not None
    dialog.reject()
    scene.timeline.acts.code(1)
    assert scene.timeline.acts.words == "Add a tier for coding first."


def test_before_the_session_was_searched_it_can_be_coded(qtbot: QtBot, theme: Theme) -> None:
    replay = FakeReplay(coding=sample_coding(120_000))
    scene = open_scene(qtbot, theme, replay)
    assert [row.name for row in scene.timeline.canvas.rows] == ["Stance", "Remarks", "Stance"]
    replay.overview.set(sample_overview())
    assert len(scene.timeline.canvas.rows) == 4 + 3 + 6


def test_thirty_tiers_scroll(qtbot: QtBot, theme: Theme) -> None:
    replay = FakeReplay(overview=sample_overview(more_tiers=24), coding=sample_coding(120_000))
    scene = open_scene(qtbot, theme, replay)
    canvas = scene.timeline.canvas
    canvas.show_row("record record-29")
    index = canvas.index_of("record record-29")
    assert index is not None
    assert canvas.row_top(index) + canvas.rows[index].height_px <= canvas.height()
    assert scene.timeline._down.value() == canvas.scroll_y > 0


def dense_coding(count: int, duration_ms: int) -> AnnotationDocument:
    tiers = tuple(Tier(f"c-Ana-tier-{number}", f"Tier {number}", "Ana", "stance") for number in range(10))
    step = duration_ms * len(tiers) / count
    values = [entry.value for entry in STANCE.entries]
    annotations = tuple(
        Annotation(f"{tier.tier_id}-{n}", tier.tier_id, int(n * step), int((n + 0.8) * step), values[n % 4])
        for tier in tiers
        for n in range(count // len(tiers))
    )
    return AnnotationDocument(tiers, (STANCE,), annotations, duration_ms)


@pytest.mark.long
def test_ten_thousand_annotations_are_drawn_in_time(qtbot: QtBot, theme: Theme) -> None:
    replay = FakeReplay(duration_s=3600, overview=sample_overview(3600), coding=dense_coding(10_000, 3_600_000))
    scene = open_scene(qtbot, theme, replay)
    canvas = scene.timeline.canvas
    for zoom in (1.0, 4.0, 4.0, 8.0):
        canvas.zoom(zoom)
        spent_ms = []
        for _ in range(9):
            began = time.thread_time()
            canvas.scroll_across_to(canvas.scale.start_ms + 40 / canvas.scale.px_per_ms)
            canvas.grab()
            spent_ms.append(1000 * (time.thread_time() - began))
        assert statistics.median(spent_ms) < 40, "five times what it takes on a quiet machine"


def test_a_moving_playhead_draws_nothing_again(qtbot: QtBot, theme: Theme) -> None:
    replay = FakeReplay(overview=sample_overview(video=False), coding=sample_coding(120_000))
    coder = Coder(open_scene(qtbot, theme, replay).timeline, replay)
    coder.canvas.grab()
    layer = coder.canvas._layer
    assert layer is not None
    coder.replay.play()
    for at_ms in range(10_000, 12_000, 33):
        coder.replay.at_ms(at_ms)
        QApplication.processEvents()
    assert coder.canvas._layer is layer


@pytest.fixture
def real_window(qtbot: QtBot, console: FakeConsole, settings: MemorySettings, theme: Theme) -> MainWindow:
    theme.set_choice("dark")
    return open_window(qtbot, console, settings, theme)


class Script:
    """Script of 200 annotations with the expected document."""

    def __init__(self, coder: Coder, tier_id: str, seed: int) -> None:
        self.coder, self.tier_id = coder, tier_id
        self.random = random.Random(seed)  # noqa: S311 - a test, not cryptography
        self.expected: list[tuple[int, int, str]] = []
        self.steps = 0

    def expect(self, change: Callable[[list[tuple[int, int, str]]], None]) -> None:
        change(self.expected)
        self.expected.sort()
        self.steps += 1
        assert self.coder.values(self.tier_id) == self.expected

    def add(self, start_ms: float, end_ms: float) -> tuple[int, int, str]:
        start, end = self.coder.point(self.tier_id, start_ms), self.coder.point(self.tier_id, end_ms)
        self.coder.drag(start, end)
        number = self.random.randrange(4)
        self.coder.type(str(number + 1))
        added = (round(self.coder.ms_at(start)), round(self.coder.ms_at(end)), STANCE.entries[number].value)
        self.steps += 1  # adding and naming are two steps
        self.expect(lambda values: values.append(added))
        return added

    def split(self, item: tuple[int, int, str]) -> None:
        at_ms = (item[0] + item[1]) // 2
        self.coder.replay.at_ms(at_ms)
        self.coder.click(self.tier_id, item[0] + 0.3 * (item[1] - item[0]))
        self.coder.key(Qt.Key.Key_S)

        def change(values: list[tuple[int, int, str]]) -> None:
            values.remove(item)
            values += [(item[0], at_ms, item[2]), (at_ms, item[1], item[2])]

        self.expect(change)

    def rename(self, item: tuple[int, int, str]) -> None:
        value = next(entry.value for entry in STANCE.entries if entry.value != item[2])
        QTest.mouseDClick(self.coder.canvas, LEFT, pos=self.coder.point(self.tier_id, (item[0] + item[1]) / 2))
        self.coder.type(value[:3])
        self.coder.enter()

        def change(values: list[tuple[int, int, str]]) -> None:
            values[values.index(item)] = (item[0], item[1], value)

        self.expect(change)

    def move(self, item: tuple[int, int, str]) -> None:
        self.coder.replay.at_ms(self.coder.canvas.scale.start_ms)  # in view, and without snap targets
        middle = self.coder.point(self.tier_id, (item[0] + item[1]) / 2)
        self.coder.drag(middle, middle + QPoint(9, 0))
        by_ms = 9 / self.coder.canvas.scale.px_per_ms
        start = round(item[0] + by_ms)

        def change(values: list[tuple[int, int, str]]) -> None:
            values[values.index(item)] = (start, round(item[0] + by_ms + item[1] - item[0]), item[2])

        self.expect(change)

    def undo(self, times: int) -> None:
        for _ in range(times):
            self.coder.key(Qt.Key.Key_Z, CTRL)

    def redo(self, times: int) -> None:
        for _ in range(times):
            self.coder.key(Qt.Key.Key_Z, CTRL | SHIFT)


@pytest.mark.long
def test_a_scripted_coder_codes_many_labels_in_the_real_window(
    qtbot: QtBot, real_window: MainWindow, tmp_path: Path
) -> None:
    from sklearn.metrics import cohen_kappa_score

    from caris_desktop.recording.annotation.annotation_import import read_eaf
    from caris_desktop.recording.exporters.eaf import eaf_text

    duration_ms = 700_000
    tiers = (Tier(ANA, "Stance", "Ana", "stance"), Tier(BEN, "Stance", "Ben", "stance"))
    replay = FakeReplay(duration_s=duration_ms / 1000, coding=AnnotationDocument(tiers, (STANCE,), (), duration_ms))
    real_window.use_replay(replay)
    real_window.resize(1366, 900)
    timeline = real_window.findChild(TimelineView)
    assert timeline is not None
    qtbot.waitUntil(lambda: timeline.canvas.height() > 100 and timeline.canvas.room_px > 600)
    coder = Coder(timeline, replay)
    coder.show(0, 60_000)
    coder.drag(coder.point(ANA, 10_000), coder.point(ANA, 14_000))
    coder.type("cur")
    focused = QApplication.focusWidget()
    assert focused is not None
    QTest.keyClick(focused, Qt.Key.Key_Escape)  # taken by the window before any widget
    assert coder.values(ANA) == [(*coder.values(ANA)[0][:2], "")]
    assert coder.canvas.hasFocus()
    coder.key(Qt.Key.Key_Delete)
    replay.history = EditHistory(coder.document, limit=2000)
    scripts = [Script(coder, ANA, 1), Script(coder, BEN, 2)]
    rounds = examples(100)
    for number in range(rounds):
        base_ms = 6500 * number
        if number % 10 == 0:
            coder.show(base_ms, base_ms + 66_000)
        for script in scripts:
            wobble_ms = script.random.uniform(0, 900)
            item = script.add(base_ms + 400 + wobble_ms, base_ms + 4700 + wobble_ms)
            match number % 4:
                case 1:
                    script.split(item)
                case 2:
                    script.rename(item)
                case 3:
                    script.move(item)
            if number % 10 == 9:
                before = coder.document
                script.undo(2)
                assert coder.document != before
                script.redo(2)
                assert coder.document == before
    done = coder.document
    assert len(done.annotations) >= 2 * rounds
    steps = sum(script.steps for script in scripts)
    scripts[0].undo(steps)
    assert coder.document.annotations == ()
    scripts[0].undo(1)
    assert timeline.acts.words == "There is nothing to undo."
    for _ in range(steps - 20):
        assert replay.redo()  # seven hundred key presses would be slow
    scripts[0].redo(20)
    assert coder.document == done
    file = tmp_path / "coded.eaf"
    file.write_text(eaf_text(done), encoding="utf-8", newline="\n")
    assert read_eaf(file) == done
    click(qtbot, find(timeline, "agreement"))
    dialog = timeline.findChild(AgreementDialog)
    assert dialog is not None
    assert dialog.agreement is not None
    expected = cohen_kappa_score(codes_of(done, ANA), codes_of(done, BEN))
    assert dialog.agreement.per_unit.kappa == pytest.approx(expected, abs=1e-12)
    dialog.reject()


def test_vocabularies_of_many_labels_are_found_by_typing(qtbot: QtBot, theme: Theme) -> None:
    many = Vocabulary("acts", tuple(VocabularyEntry(f"act {number}") for number in range(60)))
    tier = Tier("c-Ana-tier-1", "Acts", "Ana", "acts")
    replay = FakeReplay(coding=AnnotationDocument((tier,), (many,), (), 120_000))
    coder = Coder(open_scene(qtbot, theme, replay).timeline, replay)
    coder.drag(coder.point(tier.tier_id, 10_000), coder.point(tier.tier_id, 20_000))
    coder.type("act 41")
    coder.enter()
    assert coder.values(tier.tier_id)[0][2] == "act 41"
    assert tier_of(coder.document, tier.tier_id).name == "Acts"
