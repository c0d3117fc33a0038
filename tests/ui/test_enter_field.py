"""Enter in a field does not trigger the shortcuts of the window."""

import pytest
from PySide6.QtCore import Qt
from PySide6.QtGui import QKeyEvent, QShortcut
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QVBoxLayout, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.ui.widgets.inputs import SubmitLineEdit

ENTER, RETURN, UP, ESC = Qt.Key.Key_Enter, Qt.Key.Key_Return, Qt.Key.Key_Up, Qt.Key.Key_Escape


class Around(QWidget):
    """Parent that binds both Enter keys and records propagated keys."""

    def __init__(self) -> None:
        super().__init__()
        self.field = SubmitLineEdit()
        QVBoxLayout(self).addWidget(self.field)
        self.heard: list[int] = []
        for key in (ENTER, RETURN):
            QShortcut(key, self, lambda key=key: self.heard.append(key))

    def keyPressEvent(self, event: QKeyEvent) -> None:
        self.heard.append(event.key())


@pytest.fixture
def around(qtbot: QtBot) -> Around:
    around = Around()
    qtbot.addWidget(around)
    around.show()
    around.activateWindow()
    around.field.setFocus()
    qtbot.waitUntil(around.field.hasFocus)
    return around


@pytest.mark.parametrize("key", [ENTER, RETURN])
def test_enter_ends_the_line_and_is_no_key_of_the_window(around: Around, qtbot: QtBot, key: Qt.Key) -> None:
    QTest.keyClicks(around.field, "Mara")
    with qtbot.waitSignal(around.field.returnPressed, timeout=5000):
        QTest.keyClick(around.field, key)
    assert around.heard == []
    assert around.field.text() == "Mara"


def test_of_other_keys_only_esc_continues(around: Around) -> None:
    for key in (UP, Qt.Key.Key_PageDown, ESC):
        QTest.keyClick(around.field, key)
    assert around.heard == [ESC]
