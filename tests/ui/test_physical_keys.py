"""Presses and repeats with an X server that reports only physical releases."""

import pytest
from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QApplication

from caris_desktop.ui.input.physical_keys import PhysicalKeys

_ESCAPE_CODE = 9


def event(kind: QEvent.Type, at_ms: int, *, auto: bool = False) -> QKeyEvent:
    made = QKeyEvent(kind, Qt.Key.Key_Escape, Qt.KeyboardModifier.NoModifier, _ESCAPE_CODE, 0xFF1B, 0, "", auto)
    made.setTimestamp(at_ms)
    return made


def press(at_ms: int, *, auto: bool = False) -> QKeyEvent:
    return event(QEvent.Type.KeyPress, at_ms, auto=auto)


@pytest.fixture
def exact(qapp: QApplication, monkeypatch: pytest.MonkeyPatch) -> PhysicalKeys:
    keys = PhysicalKeys()
    monkeypatch.setattr(keys, "_x11", object())  # detectable auto-repeat is active
    return keys


def test_a_release_and_a_press_of_one_millisecond_are_no_repeat(exact: PhysicalKeys) -> None:
    assert not exact.repeated(press(1000))
    assert exact.released(event(QEvent.Type.KeyRelease, 1004, auto=True)), "Qt marks both"
    assert not exact.repeated(press(1004, auto=True))
    assert not exact.repeated(press(1004, auto=True)), "the same press, at the next who may take it"


def test_a_held_key_repeats_by_the_clock_of_the_server(exact: PhysicalKeys) -> None:
    assert [exact.repeated(press(at_ms)) for at_ms in (1000, 1660, 1690, 2880)] == [False, True, True, True]
    assert not exact.repeated(press(2880 + 1200)), "its release went elsewhere"


def test_elsewhere_a_repeat_is_what_qt_says(qapp: QApplication) -> None:
    keys = PhysicalKeys()
    assert [keys.repeated(press(at_ms, auto=auto)) for at_ms, auto in ((1000, False), (1500, True))] == [False, True]
    assert not keys.released(event(QEvent.Type.KeyRelease, 1500, auto=True))
