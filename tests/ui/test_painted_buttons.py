"""Pixmap cache of equal buttons: every change of a button is visible."""

import itertools
from collections.abc import Callable

import pytest
from PySide6.QtCore import QPoint, QSize, Qt
from PySide6.QtGui import QImage, QPainter, QPixmapCache, QRegion
from PySide6.QtWidgets import QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton

CHANGES: dict[str, Callable[[ActionButton], object]] = {
    "text": lambda button: button.set_label("Another"),
    "icon": lambda button: button.set_label("Mark", icon="camera"),
    "dot": lambda button: button.set_label("Mark", dot="red"),
    "look": lambda button: button.set_label("Mark", role="primary"),
    "key": lambda button: button.set_key("F7"),
    "no key": lambda button: button.set_key_shown(False),
    "badge": lambda button: button.set_badge("dot"),
    "lock": lambda button: button.set_badge("lock"),
    "checked": lambda button: (button.setCheckable(True), button.setChecked(True)),
    "down": lambda button: button.setDown(True),
    "disabled": lambda button: button.setEnabled(False),
    "size": lambda button: button.set_size(height_px=26, text_px=12),
    "room": lambda button: button.resize(90, 36),
    "focus": lambda button: button.setFocus(Qt.FocusReason.TabFocusReason),
}


def looks(button: QWidget) -> QImage:
    image = QImage(QSize(240, 40), QImage.Format.Format_RGB32)
    image.fill(Qt.GlobalColor.transparent)
    painter = QPainter(image)
    button.render(painter, QPoint(), QRegion(), QWidget.RenderFlag.DrawChildren)
    painter.end()
    return image


@pytest.fixture
def button(qtbot: QtBot, theme: Theme) -> ActionButton:
    window = QWidget()
    window.resize(400, 300)
    window.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
    qtbot.addWidget(window)
    made = ActionButton(theme, "Mark", icon="bookmark-simple", key="M", parent=window)
    made.resize(180, 36)
    made.move(200, 250)
    window.show()
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    window.setFocus()
    return made


@pytest.mark.parametrize("what", CHANGES)
def test_each_change_is_visible_and_looks_as_if_nothing_were_saved(
    button: ActionButton, theme: Theme, what: str
) -> None:
    before = looks(button)
    assert looks(button) == before
    CHANGES[what](button)
    changed = looks(button)
    assert changed != before
    QPixmapCache.clear()
    assert looks(button) == changed


def test_two_changes_never_look_like_one(button: ActionButton) -> None:
    seen: list[QImage] = []
    for what in ("text", "icon", "dot", "look", "key"):
        CHANGES[what](button)
        seen.append(looks(button))
    assert all(one != other for one, other in itertools.combinations(seen, 2))


def test_another_theme_paints_again(button: ActionButton, theme: Theme) -> None:
    dark = looks(button)
    theme.set_choice("light")
    assert looks(button) != dark
    theme.set_choice("dark")
    assert looks(button) == dark
