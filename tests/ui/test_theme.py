"""Colours: contrast and a single definition in both themes."""

import re
from pathlib import Path

import pytest
from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QFont, QGuiApplication, QPalette
from PySide6.QtWidgets import QApplication, QLabel, QLineEdit, QPlainTextEdit, QPushButton, QWidget
from pytestqt.qtbot import QtBot

import caris_desktop.ui
from caris_desktop.ui.event_watch import EventWatch
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.theme import Theme, ThemeChoice, as_choice, colors_for
from caris_desktop.ui.tokens import DARK, LIGHT, Colors
from caris_desktop.ui.widgets.labels import ElidedLabel, restyle
from caris_desktop.ui.window_menus import TitleDialog
from tests.ui.conftest import MemorySettings

# Text and background colours: every pair must reach 4.5:1 in both themes.
TEXT_PAIRS: tuple[tuple[str, str], ...] = (
    ("text", "window"), ("text", "panel"), ("text", "raised"), ("text", "raised_hover"), ("text", "field"),
    ("text", "blue_soft"), ("text", "green_soft"), ("text", "amber_soft"), ("text", "red_soft"),
    ("text", "key_ground"),
    ("dim", "window"), ("dim", "panel"), ("dim", "raised"), ("dim", "field"), ("dim", "key_ground"),
    ("blue", "panel"), ("green", "panel"), ("amber", "panel"), ("red", "panel"),
    ("green", "window"), ("amber", "window"), ("red", "window"),
    ("blue", "blue_soft"), ("amber", "amber_soft"), ("red", "red_soft"), ("green", "green_soft"),
    ("on_blue", "blue"), ("on_red", "red_fill"), ("on_red", "red_hover"),
    ("video_text", "video_ground"), ("video_dim", "video_ground"),
    ("on_box", "box_named"), ("on_box", "box_unnamed"),
    ("text", "map_free"), ("text", "map_unknown"), ("text", "line"),
)  # fmt: skip


def contrast(first: str, second: str) -> float:
    """WCAG 2 contrast ratio of two opaque colours given as ``#rrggbb``."""
    lighter, darker = sorted((_luminance(first), _luminance(second)), reverse=True)
    return (lighter + 0.05) / (darker + 0.05)


def _luminance(color: str) -> float:
    channels = [int(color[index : index + 2], 16) / 255 for index in (1, 3, 5)]
    linear = [value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4 for value in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


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


@pytest.mark.long
def test_the_choice_is_saved_and_drawn(window: MainWindow, settings: MemorySettings, qapp: QApplication) -> None:
    for choice, colors in (("light", LIGHT), ("dark", DARK)):
        window.appearance.choose_theme(as_choice(choice))
        assert settings.values["appearance/theme"] == choice
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
    restyle(label, tone="amber")
    assert theme.colors.amber in colours_across(label)
    restyle(label, tone="dim")
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


def test_a_size_is_saved_for_the_next_start(window: MainWindow, settings: MemorySettings) -> None:
    assert window.appearance.scale == ""
    entry = next(entry for entry in window.palette_entries() if entry.text == "Size: 150 % after a restart")
    entry.do()
    assert window.appearance.scale == "1.5" and settings.values["appearance/scale"] == "1.5"
    settings.values["appearance/scale"] = "enormous"
    assert window.appearance.scale == ""


@pytest.mark.parametrize("choice", ["dark", "light"])
def test_a_placeholder_can_be_read(qtbot: QtBot, theme: Theme, choice: ThemeChoice) -> None:
    theme.set_choice(choice)
    for field in (QLineEdit(), QPlainTextEdit()):
        qtbot.addWidget(field)
        field.ensurePolished()
        ink = field.palette().color(QPalette.ColorRole.PlaceholderText).name()
        assert contrast(ink, theme.colors.field) >= 4.5


def test_a_widget_is_repainted_in_its_new_look(qtbot: QtBot, theme: Theme) -> None:
    holder = QWidget()
    card = QWidget(holder)
    card.setProperty("role", "panel")
    card.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
    painted: list[object] = []
    EventWatch(card, painted.append, QEvent.Type.Paint).add(card)
    qtbot.addWidget(holder)
    holder.show()
    qtbot.waitUntil(lambda: bool(painted))
    qtbot.wait(100)
    painted.clear()
    restyle(card, active=True)
    qtbot.waitUntil(lambda: bool(painted))


def test_the_card_of_the_focused_panel_is_outlined_in_blue(window: MainWindow) -> None:
    panel = window.panels["map"]
    bar = window.dock_host.docks["map"].title_bar

    def edges() -> set[str]:
        return {part.grab().toImage().pixelColor(0, part.height() // 2).name() for part in (bar, panel)}

    colors = window.theme.colors
    assert edges() == {colors.line}
    panel.set_active(True)
    assert edges() == {colors.blue}
    panel.set_active(False)
    assert edges() == {colors.line}


def test_titles_of_panels_are_semibold_from_the_start(window: MainWindow) -> None:
    titles = [label for label in window.findChildren(ElidedLabel) if label.text() in ("Map", "Speak", "Conversation")]
    assert titles and all(label.font().weight() == QFont.Weight.DemiBold for label in titles)


def test_buttons_of_qt_s_dialogs_have_no_icons_of_another_family(window: MainWindow) -> None:
    dialog = TitleDialog(window.theme, window)
    dialog.show()
    buttons = dialog.findChildren(QPushButton)
    assert len(buttons) == 2 and all(button.icon().isNull() for button in buttons)
    dialog.close()
