"""Window with the pending work while the program exits."""

import threading

import pytest
from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QLabel
from pytestqt.qtbot import QtBot

from caris_desktop.ui.quit_guard import ClosingWindow
from caris_desktop.ui.theme import Theme


def test_it_says_what_takes_long_and_is_gone_afterwards(qtbot: QtBot, theme: Theme) -> None:
    closing = ClosingWindow()
    qtbot.addWidget(closing)
    go_on, seen = threading.Event(), []

    def look() -> None:
        if closing.isVisible():
            seen.append([label.text() for label in closing.findChildren(QLabel)])
            go_on.set()

    watch = QTimer(interval=20)
    watch.timeout.connect(look)
    watch.start()
    closing.during("The recording is being finished.", lambda: None if go_on.wait(20) else pytest.fail("never seen"))
    watch.stop()
    assert seen[0][0] == "The recording is being finished."
    assert "Do not turn off the computer" in seen[0][1]
    closing.close()
    assert not closing.isVisible()


def test_quick_work_shows_nothing_and_a_failure_is_reported(qtbot: QtBot, theme: Theme) -> None:
    closing = ClosingWindow()
    qtbot.addWidget(closing)
    done: list[int] = []
    closing.during("Voice and models are being ended.", lambda: done.append(1))
    assert done == [1]
    assert not closing.isVisible()
    with pytest.raises(OSError, match="full"):
        closing.during("The recording is being finished.", _fail)


def _fail() -> None:
    raise OSError("the disk is full")
