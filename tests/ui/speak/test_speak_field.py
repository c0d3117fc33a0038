"""The speak field, without its panel."""

from collections.abc import Iterator

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLineEdit, QVBoxLayout, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.ui.speak.speak_field import LONGEST, SpeakField
from caris_desktop.ui.theme import Theme

CTRL = Qt.KeyboardModifier.ControlModifier
EARLIER: list[str] = []
PHRASES = ("Could you say that again?",)


@pytest.fixture
def field(qtbot: QtBot, theme: Theme) -> Iterator[SpeakField]:
    EARLIER.clear()
    around = QWidget()
    qtbot.addWidget(around)
    field = SpeakField(
        theme, lambda _text: True, earlier=lambda: EARLIER, sentences=lambda: (*PHRASES, *reversed(EARLIER))
    )
    field.setObjectName("speak_field")  # name used in the style sheet
    column = QVBoxLayout(around)
    column.addWidget(field)
    column.addWidget(QLineEdit())
    around.resize(700, 300)
    around.show()
    around.activateWindow()
    field.setFocus()
    yield field


def test_a_text_continues_as_a_spoken_one_and_tab_accepts_it(field: SpeakField) -> None:
    EARLIER.append("It is safe to stand next to it.")
    QTest.keyClicks(field, "Could y")
    assert field.completion == "ou say that again?"
    QTest.keyClick(field, Qt.Key.Key_Tab)
    assert field.toPlainText() == "Could you say that again?" and field.completion == "" and field.hasFocus()
    field.let_go()
    QTest.keyClicks(field, "Yes, and it is safe to st")
    assert field.completion == "and next to it."
    QTest.keyClick(field, Qt.Key.Key_Left)
    assert field.completion == "", "only at the end"


def test_tab_moves_the_focus_where_nothing_is_shown(field: SpeakField) -> None:
    QTest.keyClicks(field, "Qwertz")
    QTest.keyClick(field, Qt.Key.Key_Tab)
    assert not field.hasFocus() and field.toPlainText() == "Qwertz"


def test_the_completion_is_drawn_dim_behind_the_cursor(field: SpeakField, theme: Theme) -> None:
    QTest.keyClicks(field, "Could y")
    with_it = field.viewport().grab().toImage()
    field.blockSignals(True)
    field.completion = ""
    without = field.viewport().grab().toImage()
    field.blockSignals(False)
    right_of_cursor = [x for x in range(with_it.width()) for y in range(0, with_it.height(), 3)
                       if with_it.pixel(x, y) != without.pixel(x, y)]  # fmt: skip
    assert right_of_cursor and min(right_of_cursor) * 1.0 >= field.cursorRect().left() - 1


def test_the_field_grows_with_its_text_up_to_a_few_lines(field: SpeakField) -> None:
    heights = [field.height()]
    for _ in range(8):
        QTest.keyClicks(field, "It can lift five kilos and it is safe to stand next to it while it moves. ")
        heights.append(field.height())
    assert heights == sorted(heights) and heights[-1] > heights[0]
    assert heights[-1] == heights[-2], "it stops growing"
    field.let_go()
    assert field.height() == heights[0]


@pytest.mark.parametrize("line_px", [40, 48])
def test_every_line_of_a_text_that_it_has_grown_for_is_seen_whole(field: SpeakField, line_px: int) -> None:
    field.set_line_height(line_px)
    seen = set()
    for _ in range(60):
        QTest.keyClicks(field, "lift five ")
        QApplication.processEvents()
        block = field.document().firstBlock()
        lines = block.layout().lineCount()
        if lines > 4:
            break
        seen.add(lines)
        text = field.blockBoundingGeometry(block).translated(field.contentOffset())
        assert text.top() >= 0 and text.bottom() <= field.viewport().height(), f"{lines} lines"
        assert text.left() >= 0, "nothing is moved aside"
    assert seen == {1, 2, 3, 4}


def test_in_a_tall_text_up_moves_the_cursor_before_it_brings_earlier_texts(field: SpeakField) -> None:
    EARLIER.append("Earlier")
    text = "It can lift five kilos and it is safe to stand next to it while it moves. " * 3
    field.bring(text)
    QTest.keyClick(field, Qt.Key.Key_Up)
    assert field.toPlainText() == text
    for _ in range(6):
        QTest.keyClick(field, Qt.Key.Key_Up)
    assert field.toPlainText() == "Earlier"


def test_lines_that_are_pasted_become_one_text_of_bounded_length(field: SpeakField) -> None:
    QApplication.clipboard().setText("One\ntwo\n" + "x" * 2000)
    QTest.keyClick(field, Qt.Key.Key_V, CTRL)
    assert field.toPlainText().startswith("One two x") and len(field.toPlainText()) == LONGEST


def test_dictation_goes_to_the_cursor_and_committed_words_stay(field: SpeakField) -> None:
    QTest.keyClicks(field, "Well, then.")
    for _ in range(6):
        QTest.keyClick(field, Qt.Key.Key_Left)
    field.dictate("d-1", "", "we")
    field.dictate("d-1", "we are", "her")
    assert field.toPlainText() == "Well, we are her then."
    assert len(field.extraSelections()) == 1, "what may still change looks like it"
    field.dictate("d-1", "we are here", "")
    assert field.toPlainText() == "Well, we are here then." and field.extraSelections() == []
    field.dictate("", "", "")
    field.dictate("d-2", "now", "")
    assert field.toPlainText() == "Well, we are here now then."


def test_a_draft_comes_back_with_down(field: SpeakField) -> None:
    QTest.keyClicks(field, "half a sent")
    field.bring("Other")
    QTest.keyClick(field, Qt.Key.Key_Down)
    assert field.toPlainText() == "Other", "Down is for what came later"
    QTest.keyClick(field, Qt.Key.Key_Up)
    assert field.toPlainText() == "half a sent"
