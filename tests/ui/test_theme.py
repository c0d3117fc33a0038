"""Colours: contrast, one place, both themes."""

import re
from pathlib import Path

import pytest
from PySide6.QtCore import Qt
from PySide6.QtGui import QGuiApplication, QPalette
from PySide6.QtWidgets import QApplication, QLabel
from pytestqt.qtbot import QtBot

import caris_desktop.ui
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.theme import Theme, ThemeChoice, as_choice, colors_for
from caris_desktop.ui.tokens import DARK, LIGHT, TEXT_PAIRS, Colors, contrast
from tests.ui.conftest import MemorySettings


@pytest.mark.parametrize("colors", [DARK, LIGHT], ids=["dark", "light"])
def test_text_has_contrast(colors: Colors) -> None:
    poor = {
        (ink, ground): round(contrast(getattr(colors, ink), getattr(colors, ground)), 2)
        for ink, ground in TEXT_PAIRS
        if contrast(getattr(colors, ink), getattr(colors, ground)) < 4.5
    }
    assert poor == {}


def test_contrast_is_that_of_the_standard() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)


def test_colours_live_in_the_tokens_alone() -> None:
    folder = Path(caris_desktop.ui.__file__).parent
    literal = re.compile(r"""["'{ ]#[0-9a-fA-F]{3,8}\b|rgba?\(|GlobalColor\.(?!transparent)""")
    offenders = [
        f"{path.name}: {line.strip()}"
        for path in folder.rglob("*.py")
        if path.name != "tokens.py"
        for line in path.read_text().splitlines()
        if literal.search(line)
    ]
    assert offenders == []


def test_the_choice_is_kept_and_drawn(window: MainWindow, settings: MemorySettings, qapp: QApplication) -> None:
    for choice, colors in (("light", LIGHT), ("dark", DARK)):
        window.set_theme_choice(as_choice(choice))
        assert settings.values["theme"] == choice
        assert qapp.palette().color(QPalette.ColorRole.Window).name() == colors.window
        assert window.grab().toImage().pixelColor(2, window.height() // 2).name() == colors.window


def colours_across(label: QLabel) -> set[str]:
    image = label.grab().toImage()
    return {image.pixelColor(x, image.height() // 2).name() for x in range(image.width())}


@pytest.mark.parametrize("choice", ["light", "dark"])
def test_a_text_is_drawn_in_the_colour_of_its_role(qtbot: QtBot, theme: Theme, choice: ThemeChoice) -> None:
    theme.set_choice(choice)
    label = QLabel("█" * 20)
    qtbot.addWidget(label)
    theme.color_text(label, "amber")
    assert theme.colors.amber in colours_across(label)
    theme.color_text(label, "dim")
    assert theme.colors.dim in colours_across(label)
    assert theme.colors.amber not in colours_across(label)
    theme.set_choice("dark")


def test_an_unknown_choice_follows_the_system() -> None:
    assert as_choice("purple") == "system"
    assert as_choice(None) == "system"


def test_the_system_s_choice_is_followed_while_running(theme: Theme, qapp: QApplication) -> None:
    hints = QGuiApplication.styleHints()
    theme.set_choice("system")
    for scheme, colors in ((Qt.ColorScheme.Light, LIGHT), (Qt.ColorScheme.Dark, DARK)):
        hints.colorSchemeChanged.emit(scheme)
        assert theme.colors is colors
        assert qapp.palette().color(QPalette.ColorRole.Window).name() == colors.window
    theme.set_choice("light")
    hints.colorSchemeChanged.emit(Qt.ColorScheme.Dark)
    assert theme.colors is LIGHT


def test_a_system_that_does_not_say_reads_as_dark() -> None:
    assert colors_for("system", Qt.ColorScheme.Unknown) is DARK
    assert colors_for("light", Qt.ColorScheme.Dark) is LIGHT
