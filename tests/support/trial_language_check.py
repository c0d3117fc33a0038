"""Check of a window in the trial language for texts without its marks: brackets and accents.

Texts of widgets are read from their properties, and painted texts from a drawing of the widget. The report names the
file below ``caris_desktop`` that creates the widget or its container.
"""

import ast
import dataclasses
import html
import re
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from PySide6.QtCore import QAbstractItemModel, QAbstractListModel, QAbstractTableModel, QModelIndex, Qt
from PySide6.QtGui import QAction
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractItemView,
    QComboBox,
    QGroupBox,
    QHeaderView,
    QLabel,
    QLineEdit,
    QMenu,
    QPlainTextEdit,
    QProgressBar,
    QTabBar,
    QTextEdit,
    QWidget,
)

from caris_desktop.ui.dock_area import Dock
from tests.support.window_check import painted_by

_FILL = {"ēx", "ìpsum", "lörem", "dölor", "sît"}
_TRANSLATED = re.compile(r"\[[^\[\]]*\]")
_WORD = re.compile(r"[^\W\d_]{2,}")
_KEYS = re.compile(
    r"\b(?:(?:Ctrl|Alt|Shift|Meta)(?:\+|\b)|Esc\b|Enter\b|Space\b|Pause\b|Return\b|Del(?:ete)?\b|Ins\b|Home\b|End\b|Tab\b|"
    r"Backspace\b|Pg(?:Up|Down)\b|F\d+\b|(?:Up|Down|Left|Right)\b)"
)
_UNITS = re.compile(r"(?<=\d)[\s\u00a0\u202f]*(?:ms|s|min|h|Hz|kHz|[kMG]?B(?:/s)?|m/s|m|rad/s|rad|px|dB|fps|V|x)\b")
_ROLES = (Qt.ItemDataRole.DisplayRole, Qt.ItemDataRole.ToolTipRole, Qt.ItemDataRole.AccessibleTextRole)
_ROWS = 60
_PARTS = ("widgets/", "layout/", "panel.py", "overlay.py")
"""Generic widgets, which are reported with the file of their container."""


class StudyTexts:
    """Texts of studies, scenarios and robots, which are the same in every language."""

    def __init__(self, *values: object) -> None:
        found = {text.strip() for value in values for text in _strings(value)}
        self._texts = sorted((text for text in found if _WORD.search(text)), key=len, reverse=True)
        self._words = {word for text in self._texts for word in _WORD.findall(text)}
        self._without: dict[str, str] = {}  # a cache: most texts occur in several windows

    def without(self, text: str) -> str:
        left = self._without.get(text)
        if left is None:
            left = text
            for known in self._texts:
                if known in left:
                    left = re.sub(rf"(?<!\w){re.escape(known)}(?!\w)", " ", left)
            self._without[text] = left
        return left

    def contains_word(self, word: str) -> bool:
        return word in self._words or any(known.startswith(word) for known in self._words if len(word) > 2)


def strings_of(source: Path) -> list[str]:
    """All strings of a source file with sample data."""
    tree = ast.parse(source.read_text("utf-8"))
    return [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)]


def unmarked_texts(windows: Iterable[QWidget], data: StudyTexts, drawn: set[int] | None = None) -> dict[str, set[str]]:
    """Texts of the windows without marks of the trial language, by file, with # for numbers.

    Widgets whose id is in ``drawn`` are not drawn again; others are added to it.
    """
    found: dict[str, set[str]] = defaultdict(set)
    drawn = set() if drawn is None else drawn
    for window in windows:
        for widget in (window, *window.findChildren(QWidget)):
            texts = {text for text in _texts_of(widget) if text and is_unmarked(text, data)}
            if id(widget) not in drawn and _paints(widget):
                drawn.add(id(widget))
                texts |= {painted.text for painted in painted_by(widget) if is_unmarked_fragment(painted.text, data)}
            if texts:
                found[_made_in(widget)] |= {re.sub(r"\d+(?:[.,:]\d+)*", "#", text) for text in texts}
    return dict(found)


def is_unmarked(text: str, data: StudyTexts) -> bool:
    """True if the text contains untranslated words."""
    bare = html.unescape(re.sub(r"<[^<>]*>", " ", text))
    while _TRANSLATED.search(bare):
        bare = _TRANSLATED.sub(" ", bare)
    if "…" in bare and ("[" in bare or "]" in bare):  # elided
        return is_unmarked_fragment(bare, data)
    return bool(_WORD.search(_words_only(data.without(bare))))


def is_unmarked_fragment(text: str, data: StudyTexts) -> bool:
    """The same for a line of a longer text, which may have lost its brackets."""
    words = _WORD.findall(_words_only(data.without(text)))
    return any(word.isascii() and re.search(r"[aeiouAEIOU]", word) and not data.contains_word(word) for word in words)


def _words_only(text: str) -> str:
    text = _UNITS.sub(" ", _KEYS.sub(" ", text))
    return re.sub(r"\S*(?:://|[/\\@_])\S*|\S+\.(?:yaml|py|mcap|db|png|md)\b", " ", text)


def _texts_of(widget: QWidget) -> Iterator[str]:
    yield from (widget.toolTip(), widget.accessibleName(), widget.accessibleDescription(), widget.statusTip())
    if widget.isWindow():
        yield widget.windowTitle()
    if isinstance(widget, (QLabel, QAbstractButton, QLineEdit)):
        yield widget.text()
    if isinstance(widget, (QLineEdit, QPlainTextEdit, QTextEdit)):
        yield widget.placeholderText()
    if isinstance(widget, (QGroupBox, QMenu)):
        yield widget.title()
    if isinstance(widget, QProgressBar):
        yield widget.format().replace("%p", "").replace("%v", "").replace("%m", "")
    if isinstance(widget, QTabBar):
        for index in range(widget.count()):
            yield from (widget.tabText(index), widget.tabToolTip(index))
    for action in widget.actions():
        yield from (action.text(), action.statusTip())
        if action.toolTip() != QAction(action.text()).toolTip():  # Qt's default tooltip: the text without dots
            yield action.toolTip()
    if isinstance(widget, QComboBox):
        yield from (widget.itemText(index) for index in range(widget.count()))
        yield from (str(widget.itemData(index, _ROLES[1]) or "") for index in range(widget.count()))
    elif isinstance(widget, QHeaderView):
        yield from _headers(widget)
    elif isinstance(widget, QAbstractItemView) and widget.model() is not None:
        yield from _cells(widget.model(), QModelIndex())


def _headers(header: QHeaderView) -> Iterator[str]:
    model = header.model()
    if model is not None and not header.isHidden():
        for section in range(min(_ROWS, header.count())):
            for role in _ROLES:
                yield str(model.headerData(section, header.orientation(), role) or "")


def _cells(model: QAbstractItemModel, parent: QModelIndex) -> Iterator[str]:
    for row in range(min(_ROWS, model.rowCount(parent))):
        for column in range(1 if isinstance(model, QAbstractListModel) else model.columnCount(parent)):
            index = model.index(row, column, parent)
            for role in _ROLES:
                value = index.data(role)
                if isinstance(value, str):
                    yield value
        below = model.index(row, 0, parent)
        if not isinstance(model, (QAbstractListModel, QAbstractTableModel)) and model.hasChildren(below):
            yield from _cells(model, below)


def _paints(widget: QWidget) -> bool:
    """True if the widget draws text itself; texts of labels, buttons and lists are in their properties."""
    ours = type(widget).__module__.startswith("caris_desktop") and "paintEvent" in _methods(type(widget))
    return ours and widget.isVisible() and not isinstance(widget, (QLabel, QLineEdit, QPlainTextEdit, QTextEdit))


def _methods(kind: type) -> set[str]:
    ours = (one for one in kind.__mro__ if one.__module__.startswith("caris_desktop"))
    return {name for one in ours for name in vars(one)}


def _made_in(widget: QWidget) -> str:
    holder: QWidget | None = widget
    last = ""
    while holder is not None:
        if isinstance(holder, Dock):
            holder = holder.widget()
        file = sys.modules[type(holder).__module__].__file__ or ""
        if "caris_desktop/" in file:
            last = file.rpartition("caris_desktop/")[2]
            if not last.removeprefix("ui/").startswith(_PARTS):
                return last
        holder = holder.parentWidget()
    return last


def _strings(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            yield from _strings(getattr(value, field.name))
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from (*_strings(key), *_strings(item))
    elif isinstance(value, (list, tuple, set, frozenset)):
        for item in value:
            yield from _strings(item)
    elif isinstance(value, Path):
        yield from (str(value), value.name, value.stem)


def listed(found: dict[str, set[str]]) -> list[str]:
    return [f"{file}: {text!r}" for file, texts in sorted(found.items()) for text in sorted(texts)]


def merged(*all_found: dict[str, set[str]]) -> dict[str, set[str]]:
    both: dict[str, Any] = defaultdict(set)
    for found in all_found:
        for file, texts in found.items():
            both[file] |= texts
    return dict(both)
