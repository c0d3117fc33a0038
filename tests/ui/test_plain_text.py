"""Foreign text is never displayed as HTML: image tags stay plain text."""

import dataclasses
import itertools
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shiboken6
from PySide6.QtCore import QEvent, QPoint, QRect, Qt
from PySide6.QtGui import QColor, QHelpEvent, QImage, QTextDocument
from PySide6.QtWidgets import (
    QAbstractItemView,
    QApplication,
    QGraphicsTextItem,
    QGraphicsView,
    QHeaderView,
    QLabel,
    QMenu,
    QMessageBox,
    QProgressDialog,
    QTableView,
    QTextBrowser,
    QTextEdit,
    QWidget,
)

from caris_desktop.app.qt_application import the_application
from caris_desktop.domain.events import Problem
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.state import LiveValue
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.ui import window_appearance
from caris_desktop.ui.help_window import GuideBrowser
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.inputs import CheckBox
from tests.ui import every_window, samples
from tests.ui.every_window import EveryWindow
from tests.ui.fake_console import FakeConsole

# Not a colour of a theme: visible only if the image of the mark was loaded.
_PICTURE_COLOR = QColor(255, 0, 254)
_WORDS_OF_THE_TOUR = (
    "Tour guide", "A visitor", "Walk ahead", "Let me think", "That is", "Hello!", "Please", "Nice to", "Reception",
    "Entrance", "Kitchen", "Robot arm", "Lab bench", "Greet", "Farewell", "Answer questions", "Visitor knows",
    "Consent form", "Give the visitor", "Interested", "Slip", "You did", "Expert", "You know robots", "Shorter",
    "What is meant", "Wave", "Asks about",
)  # fmt: skip


@pytest.fixture
def mark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    picture = QImage(24, 24, QImage.Format.Format_RGB32)
    picture.fill(_PICTURE_COLOR)
    file = tmp_path / "seen.png"
    assert picture.save(str(file))
    os.utime(file, (1, file.stat().st_mtime))
    # A short name: names of places and phrases are limited.
    monkeypatch.chdir(tmp_path)
    yield "<b><img src=seen.png>"
    # A label that is laid out before it is polished reads the image without displaying it.
    assert file.stat().st_atime == 1, "the file was read"


@pytest.fixture
def windows(theme: Theme, mark: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[EveryWindow]:
    """Every window of a session with a mark in each text of program, scenario and session."""
    text = (layouts_dir() / "tour-guide.yaml").read_text()
    for words in _WORDS_OF_THE_TOUR:
        assert words in text
        text = text.replace(words, f"{mark}&{words}")
    scenario_file = tmp_path / "tour-guide.yaml"
    scenario_file.write_text(text)
    fill = samples.fill_console

    def fill_marked(console: FakeConsole) -> None:
        fill(console)
        for value in vars(console.state).values():
            if isinstance(value, LiveValue) and value is not console.state.scenario:
                value.set(_marked(value.value, f"{mark}&"))
        console.state.add(Problem(1, "error", f"{mark}what", f"{mark}meaning", f"{mark}advice"))

    monkeypatch.setattr(samples, "fill_console", fill_marked)
    monkeypatch.setattr(every_window, "load_scenario", lambda _path: load_scenario(scenario_file))
    monkeypatch.setattr(
        window_appearance, "in_trial_language",
        lambda text, _meant, number: f"{mark}{text}".replace("%n", str(number)) if text else "",
    )  # fmt: skip
    opened = EveryWindow(theme, window_appearance.TRIAL)
    yield opened
    opened.close()
    QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)


def _marked(value: Any, mark: str) -> Any:
    """``value`` with a mark in every text that starts as a name or a sentence."""
    if isinstance(value, str):
        return f"{mark}{value}" if value[:1].isupper() else value
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [field.name for field in dataclasses.fields(value) if field.init and field.name != "key"]
        return dataclasses.replace(value, **{name: _marked(getattr(value, name), mark) for name in fields})
    if isinstance(value, tuple) and type(value) is tuple:
        return tuple(_marked(part, mark) for part in value)
    return value


@pytest.mark.long
def test_no_window_shows_a_marked_text_as_html(windows: EveryWindow) -> None:
    found, marked = list[str](), 0
    main = windows.window
    parts = itertools.chain([("main", main)], ((seen.name, seen.part) for seen in windows.seen()))
    for name, part in parts:
        windows.settle()
        flaws, count = _rich_in(part)
        found += [f"{name}: {flaw}" for flaw in flaws]
        marked += count
    assert found == []
    assert marked > 1000, "hardly a text was marked: the walk saw nothing"


def test_no_menu_of_the_window_shows_html(windows: EveryWindow) -> None:
    found, shown = list[str](), 0
    for menu in windows.window.findChildren(QMenu):
        menu.aboutToShow.emit()
        menu.popup(QPoint(0, 0))
        flaws, count = _rich_in(menu)
        texts = [action.text() for action in menu.actions()]
        flaws += [f"{text} loses its &" for text in texts if "&" in text.replace("&&", "")]
        found += flaws
        shown += count + sum("<img src=seen" in text for text in texts)
        menu.close()
    assert found == []
    assert shown > 0


def test_texts_of_qt_itself_are_plain(theme: Theme, mark: str, qapp: QApplication) -> None:
    theme.set_choice("dark")
    box = QMessageBox(QMessageBox.Icon.Warning, "title", f"{mark}text")
    box.setInformativeText(f"{mark}more")
    progress = QProgressDialog(f"{mark}label", f"{mark}cancel", 0, 1)
    for dialog in (box, progress):
        dialog.show()
        qapp.processEvents()
        assert _rich_in(dialog)[0] == []
        dialog.close()
        dialog.deleteLater()


def test_no_name_with_an_ampersand_gives_its_button_a_key(theme: Theme, qapp: QApplication) -> None:
    assert the_application() is qapp
    for text in ("Say &What", "Q&A", "Lights & sound"):
        buttons = ActionButton(theme, text), CheckBox(theme, text)
        assert [button.shortcut().toString() for button in buttons] == ["", ""]
        assert [button.text() for button in buttons] == [text, text]


def test_a_tooltip_of_many_words_takes_several_lines(theme: Theme, qapp: QApplication) -> None:
    from caris_desktop.ui.text_formatting import wrapped_tip

    assert max(map(len, wrapped_tip("word <b> " * 60).splitlines())) < 100
    assert wrapped_tip("first\nsecond") == "first\nsecond"


def _rich_in(part: QWidget) -> tuple[list[str], int]:
    """Parts displayed as HTML, and the number of checked texts."""
    found, marked = list[str](), 0
    if _has_picture(part.grab().toImage()):
        found.append(f"{part.objectName()}: the picture is seen")
    for widget in (part, *part.findChildren(QWidget)):
        if not shiboken6.isValid(widget):
            continue  # deleted by the events of a tooltip
        who = f"{type(widget).__name__} {widget.objectName()!r}"
        if isinstance(widget, QLabel) and "<img src=seen" in widget.text():
            marked += 1
            if widget.isVisible() and widget.textFormat() != Qt.TextFormat.PlainText:
                found.append(f"{who}: {widget.text()[:60]}")
        # The guide displays images of the program only.
        if isinstance(widget, QTextBrowser | QTextEdit) and not isinstance(widget, GuideBrowser):
            found += [f"{who}: has a picture"] * _holds_picture(widget.document())
        if isinstance(widget, QGraphicsView) and widget.scene() is not None:
            texts = [item for item in widget.scene().items() if isinstance(item, QGraphicsTextItem)]
            found += [f"{who}: {text.toPlainText()}" for text in texts if _holds_picture(text.document())]
        for tip_at in _tips_of(widget):
            marked += 1
            QApplication.sendEvent(*tip_at)
            found += [f"{who}: the tooltip {tip}" for tip in _rich_tips()]
    return found, marked


def _tips_of(widget: QWidget) -> Iterator[tuple[QWidget, QHelpEvent]]:
    """Events that open the tooltips of the widget and of its rows or tabs."""

    def event_at(place: QPoint, at: QWidget) -> tuple[QWidget, QHelpEvent]:
        return at, QHelpEvent(QEvent.Type.ToolTip, place, at.mapToGlobal(place))

    if widget.isVisible() and "<img src=seen" in widget.toolTip():
        yield event_at(widget.rect().center(), widget)
    if isinstance(widget, QMenu) and widget.toolTipsVisible():
        for action in widget.actions():
            yield event_at(widget.actionGeometry(action).center(), widget)
    if isinstance(widget, QHeaderView) or not isinstance(widget, QAbstractItemView):
        return
    model = widget.model()
    if model is None or not widget.isVisible():
        return
    for row in range(min(model.rowCount(), 20)):
        for column in range(widget.horizontalHeader().count() if isinstance(widget, QTableView) else 1):
            rect: QRect = widget.visualRect(model.index(row, column))
            if rect.isValid() and widget.viewport().rect().intersects(rect):
                yield event_at(rect.center(), widget.viewport())


def _rich_tips() -> list[str]:
    tips = [tip for tip in QApplication.topLevelWidgets() if tip.metaObject().className() == "QTipLabel"]
    return [
        tip.text()[:60] for tip in tips
        if isinstance(tip, QLabel) and tip.isVisible()
        and (tip.textFormat() != Qt.TextFormat.PlainText or _has_picture(tip.grab().toImage()))
    ]  # fmt: skip


def _has_picture(image: QImage) -> bool:
    image = image.convertToFormat(QImage.Format.Format_RGB32)
    pixels = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), -1)[:, : 4 * image.width()]
    blue, green, red = (pixels[:, channel::4] for channel in range(3))
    return bool(((red > 250) & (green < 5) & (blue > 250)).any())


def _holds_picture(document: QTextDocument) -> bool:
    return "￼" in document.toPlainText()
