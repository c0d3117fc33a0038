"""Check of a window for text that is cut off, and for texts that overlap.

Texts of labels and buttons are read from their properties. Painted texts, also of self-painting widgets, are taken from
a drawing of the window that preserves text as text.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from PySide6.QtCore import QBuffer, QByteArray, QIODevice, QPoint, QPointF, QRect, QRectF, QSize, Qt
from PySide6.QtGui import QFont, QFontMetricsF, QPainter, QRegion, QTransform
from PySide6.QtSvg import QSvgGenerator
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractScrollArea,
    QComboBox,
    QLabel,
    QLineEdit,
    QScrollArea,
    QTabBar,
    QWidget,
)

from caris_desktop.ui.notifications import NotificationPopup
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.inputs import DropDown
from caris_desktop.ui.widgets.labels import ElidedLabel
from caris_desktop.ui.widgets.popups import FloatingCard

_SPARE_PX = 1.5
_OVERLAP = 0.2
"""Minimum overlap as a share of the smaller text: boxes of letters may touch without a visible overlap."""

_SEEN = 0.3
"""Minimum visible share of a text: a row of a list may be scrolled partly out of view."""


@dataclass(frozen=True, slots=True)
class PaintedText:
    """A painted piece of text and its box."""

    text: str
    box: QRectF
    card: QWidget | None = None
    """The card that contains the text; its background hides the texts below it."""


def text_flaws(window: QWidget) -> list[str]:
    """One line for each text that is cut off or overlaps another one."""
    painted = [(widget, painted_by(widget)) for widget in _shown(window)]
    beyond = [
        f"{_name(widget)} paints {text.text!r} beyond its edge"
        for widget, texts in painted
        if texts and not _scrolled(widget)
        for text in texts
        if _sticks_out(text.box, widget)
    ]
    outside = [
        f"{_name(widget)} paints {text.text!r} outside the window"
        for widget, texts in painted
        if texts and not _scrolled(widget)
        for text in texts
        if _sticks_out(text.box.translated(QPointF(widget.mapTo(window, QPoint()))), window)
    ]
    return [*cut_off(window), *beyond, *outside, *overlapping_texts(_in_view(painted, window))]


def cut_off(window: QWidget) -> list[str]:
    """Labels, buttons and placeholder texts with less space than their text needs."""
    found = []
    for widget in _shown(window):
        lacking = _lacking_px(widget)
        if lacking is not None:
            found.append(f"{_name(widget)} lacks {lacking[0]:.0f} x {lacking[1]:.0f} px for {_text_of(widget)!r}")
        beside = _out_of_reach_px(widget)
        if beside > _SPARE_PX:
            found.append(f"{_name(widget)} has {beside:.0f} px at its side that cannot be scrolled to")
    return found


def _out_of_reach_px(area: QWidget) -> float:
    """Width that is cut off in an area that scrolls only vertically."""
    off = Qt.ScrollBarPolicy.ScrollBarAlwaysOff
    if not isinstance(area, QScrollArea) or area.horizontalScrollBarPolicy() != off or area.widget() is None:
        return 0.0
    return float(area.widget().width() - area.viewport().width())


def overlapping_texts(texts: list[PaintedText]) -> list[str]:
    found = []
    for number, one in enumerate(texts):
        for other in texts[number + 1 :]:
            if one.card is not other.card:
                continue  # one of them is below a card
            both = one.box.intersected(other.box)
            smaller = min(_area(one.box), _area(other.box))
            if not both.isEmpty() and _area(both) > _OVERLAP * smaller:
                found.append(f"{one.text!r} and {other.text!r} overlap at {both.topLeft().toPoint()}")
    return found


def painted_texts(window: QWidget) -> list[PaintedText]:
    """Visible texts that the widgets of the window paint."""
    return _in_view(((widget, painted_by(widget)) for widget in _shown(window)), window)


def _in_view(painted: Iterable[tuple[QWidget, list[PaintedText]]], window: QWidget) -> list[PaintedText]:
    """Convert to window coordinates and drop texts that are not visible."""
    texts = []
    for widget, own in painted:
        seen = QRectF(widget.visibleRegion().boundingRect())
        origin = QPointF(widget.mapTo(window, QPoint()))
        for text in own:
            box = text.box.intersected(seen)
            if _area(box) > _SEEN * _area(text.box):
                texts.append(PaintedText(text.text, box.translated(origin), _card_of(widget)))
    return texts


def _card_of(widget: QWidget) -> QWidget | None:
    parent: QWidget | None = widget
    while parent is not None and not isinstance(parent, (NotificationPopup, FloatingCard)):
        parent = parent.parentWidget()
    return parent


def painted_by(widget: QWidget) -> list[PaintedText]:
    """Texts that the widget paints, in its own coordinates."""
    if type(widget) is QWidget or widget.width() < 1 or widget.height() < 1:
        return []
    drawn = QByteArray()
    buffer = QBuffer(drawn)
    buffer.open(QIODevice.OpenModeFlag.WriteOnly)
    generator = QSvgGenerator()
    generator.setOutputDevice(buffer)
    generator.setSize(widget.size())
    generator.setViewBox(QRect(QPoint(), widget.size()))
    painter = QPainter(generator)
    with _pictures_left_out():
        widget.render(painter, QPoint(), QRegion(), QWidget.RenderFlag(0))
    painter.end()
    texts = _texts_below(ET.fromstring(bytes(drawn.data())), QTransform())  # noqa: S314 - drawn just now
    # Selected text is drawn twice, once for each colour.
    return list({(text.text, text.box.left(), text.box.top()): text for text in texts}.values())


@contextmanager
def _pictures_left_out() -> Iterator[None]:
    """Skip images while drawing: they contain no text, and encoding a camera frame as PNG takes longest."""
    kept = QPainter.drawImage, QPainter.drawPixmap
    QPainter.drawImage = QPainter.drawPixmap = lambda *_: None  # type: ignore[assignment]
    try:
        yield
    finally:
        QPainter.drawImage, QPainter.drawPixmap = kept  # type: ignore[method-assign]


def _texts_below(element: ET.Element, transform: QTransform) -> Iterator[PaintedText]:
    matrix = re.fullmatch(r"matrix\(([^)]*)\)", element.get("transform", ""))
    if matrix is not None:
        a, b, c, d, e, f = (float(number) for number in matrix.group(1).split(","))
        transform = QTransform(a, b, c, d, e, f) * transform
    if element.tag.endswith("text") and (element.text or "").strip():
        text = element.text or ""
        font = QFont((element.get("font-family") or "").strip("'"))
        font.setPixelSize(max(1, round(float(element.get("font-size", "12")))))
        font.setWeight(QFont.Weight(int(element.get("font-weight", "400"))))
        metrics = QFontMetricsF(font)
        x, baseline = float(element.get("x", "0")), float(element.get("y", "0"))
        box = QRectF(x, baseline - metrics.ascent() * 0.75, metrics.horizontalAdvance(text), metrics.ascent() * 0.75)
        if len(text.strip()) > 1:
            yield PaintedText(text.strip(), transform.mapRect(box))
    for child in element:
        yield from _texts_below(child, transform)


def _shown(window: QWidget) -> Iterator[QWidget]:
    """Visible widgets of the window, without those scrolled out of view."""
    for widget in window.findChildren(QWidget):
        if widget.isVisibleTo(window) and not widget.visibleRegion().isEmpty() and widget.window() is window.window():
            yield widget


def _text_of(widget: QWidget) -> str:
    if isinstance(widget, QLineEdit):
        return widget.placeholderText() if not widget.text() else ""
    if isinstance(widget, QComboBox):
        return widget.currentText()
    return widget.text() if isinstance(widget, (QLabel, QAbstractButton)) else ""


def _name(widget: QWidget) -> str:
    return f"{type(widget).__name__} {widget.objectName() or _named_by(widget)!r}"


def _scrolled(widget: QWidget) -> bool:
    """True if a scroll area can bring the widget into view."""
    parent: QWidget | None = widget
    while parent is not None:
        if isinstance(parent, QTabBar) or (isinstance(parent, QAbstractScrollArea) and not _shows_all(parent)):
            return True
        parent = parent.parentWidget()
    return False


def _shows_all(area: QAbstractScrollArea) -> bool:
    """True of a panel's scroll area without anything to scroll to."""
    bars = (area.horizontalScrollBar(), area.verticalScrollBar())
    return area.objectName() == "panel_scroll" and all(bar.maximum() == 0 for bar in bars)


def _sticks_out(box: QRectF, widget: QWidget) -> bool:
    room = QRectF(widget.rect())
    return (
        box.left() < room.left() - _SPARE_PX
        or box.right() > room.right() + _SPARE_PX
        or box.top() < room.top() - _SPARE_PX
        or box.bottom() > room.bottom() + _SPARE_PX
    )


def _named_by(widget: QWidget) -> str:
    parent = widget.parentWidget()
    while parent is not None and not parent.objectName():
        parent = parent.parentWidget()
    return f"in {parent.objectName()}" if parent is not None else ""


def _lacking_px(widget: QWidget) -> tuple[float, float] | None:
    if isinstance(widget, QComboBox):
        return _lacking_in_combo_box(widget)
    text = _text_of(widget)
    if not text.strip() or isinstance(widget, ElidedLabel):
        return None  # elided on purpose, with the complete text in its tooltip
    room = widget.contentsRect()
    if isinstance(widget, QLabel) and widget.textFormat() is not Qt.TextFormat.RichText:
        flags = int(widget.alignment())
        if widget.wordWrap():
            flags |= int(Qt.TextFlag.TextWordWrap)
        margin = 2 * widget.margin()
        within = QRectF(0, 0, room.width() - margin if widget.wordWrap() else 100_000, 100_000)
        needed = QFontMetricsF(widget.font()).boundingRect(within, flags, text)
        lacks = needed.width() + margin - room.width(), needed.height() + margin - room.height()
    elif isinstance(widget, QLineEdit):
        needed_px = QFontMetricsF(widget.font()).horizontalAdvance(text)
        lacks = needed_px + 8 - room.width(), 0.0
    else:
        hint = widget.sizeHint()
        if widget.hasHeightForWidth():  # word wrap
            hint = QSize(widget.minimumSizeHint().width(), widget.heightForWidth(widget.width()))
        if isinstance(widget, ActionButton) and widget.may_shrink:
            return None
        lacks = float(hint.width() - widget.width()), float(hint.height() - widget.height())
    beyond = _beyond_parent(widget)
    lacks = max(lacks[0], beyond[0]), max(lacks[1], beyond[1])
    return (max(0.0, lacks[0]), max(0.0, lacks[1])) if max(lacks) > _SPARE_PX else None


_LONGEST_CHOICE = 34
"""Longer items, such as model names of servers, may be elided with the complete text in the tooltip."""


def _lacking_in_combo_box(widget: QComboBox) -> tuple[float, float] | None:
    if not isinstance(widget, DropDown) or len(widget.currentText()) > _LONGEST_CHOICE:
        return None
    lacks_px = widget.lacks_px()
    return (float(lacks_px), 0.0) if lacks_px > _SPARE_PX else None


def _beyond_parent(widget: QWidget) -> tuple[float, float]:
    """Width and height outside the parent; zero in a scroll area."""
    parent, place = widget.parentWidget(), QRect(widget.geometry())
    while parent is not None and not parent.isWindow():
        if isinstance(parent.parentWidget(), QAbstractScrollArea):
            return 0.0, 0.0
        out = (
            max(0, place.right() - parent.rect().right(), -place.left()),
            max(0, place.bottom() - parent.rect().bottom(), -place.top()),
        )
        if max(out) > _SPARE_PX:
            return float(out[0]), float(out[1])
        place.translate(parent.pos())
        parent = parent.parentWidget()
    return 0.0, 0.0


def _area(box: QRectF) -> float:
    return box.width() * box.height()
