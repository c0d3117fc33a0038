"""Find anything, and the sheet of all shortcuts: cards over the window, not dialogs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher

from PySide6.QtCore import QEvent, QObject, QRect, QRectF, Qt
from PySide6.QtGui import QColor, QFocusEvent, QKeyEvent, QMouseEvent, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import (
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QScrollArea,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from caris_desktop.ui import tokens
from caris_desktop.ui.actions import Actions, ActionSpec
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.key_cap import KeyCap, draw_key_cap, key_cap_width

_ROW_PX = 40
_ROWS = 9
_NONE = -1
_ENTER = (Qt.Key.Key_Return, Qt.Key.Key_Enter)


@dataclass(frozen=True, slots=True)
class Entry:
    """Something that can be found and done; ``also`` are other words for it.

    ``acts``: it speaks or moves the robot, so it is found by its own words only and never by a guess at misspelt ones.
    ``deliberate``: it takes a protection away, so it is never chosen beforehand and wants Enter, or a click, twice;
    ``again`` is what it says between the two. ``first``: it stands before everything else that is found.
    """

    text: str
    kind: str
    icon: str
    key: str
    do: Callable[[], None]
    also: str = ""
    acts: bool = False
    deliberate: bool = False
    again: str = ""
    first: bool = False


_MEANS_NOTHING = frozenset({"the", "a", "an", "to", "please", "into"})
_ALIKE = 0.75
_LONG_ENOUGH_TO_GUESS = 4


def matching(entries: Sequence[Entry], query: str) -> list[Entry]:
    """Entries that contain all words of the query, those that begin with it first.

    Articles do not count, and a word that is nowhere may be misspelt, unless the entry speaks or moves the robot:
    "diagnotics" finds a panel, but "drive to the kichen" nothing.
    """
    words = query.casefold().split()
    wanted = [word for word in words if word not in _MEANS_NOTHING] or words
    begins = query.casefold().strip()
    found: list[tuple[float, int, Entry]] = []
    for order, entry in enumerate(entries):
        there = f"{entry.text} {entry.kind} {entry.also}".casefold()
        distances = [_distance(word, there, may_guess=not (entry.acts or entry.deliberate)) for word in wanted]
        if all(distance is not None for distance in distances):
            far = sum(distance or 0.0 for distance in distances)
            place = float("-inf") if entry.first else far - 0.5 * entry.text.casefold().startswith(begins)
            found.append((place, order, entry))
    return [entry for _far, _order, entry in sorted(found, key=lambda item: item[:2])]


def _distance(word: str, there: str, *, may_guess: bool) -> float | None:
    """0 for a word that is there, up to 10 for one that is like it, None for one that is not."""
    if word in there:
        return 0.0
    if not may_guess or len(word) < _LONG_ENOUGH_TO_GUESS:
        return None
    best = max((SequenceMatcher(None, word, known).ratio() for known in there.split()), default=0.0)
    return 1.0 + 9.0 * (1.0 - best) if best >= _ALIKE else None


class Overlay(QWidget):
    """A card in the upper middle of the window over a dimmed ground; a click beside it closes it."""

    def __init__(self, theme: Theme, window: QWidget, *, width_px: int) -> None:
        super().__init__(window)
        self._theme = theme
        self._window = window
        self._width_px = width_px
        self._focus_before: QWidget | None = None
        self.card = _Card(theme, self)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        window.installEventFilter(self)
        self.hide()

    def open(self) -> None:
        self._focus_before = self._window.focusWidget()
        self._place()
        self.show()
        self.raise_()

    def close_overlay(self) -> None:
        """Hide, and give the focus back to where it was."""
        if self.isHidden():
            return
        self.hide()
        if self._focus_before is not None and self._focus_before.isVisible():
            self._focus_before.setFocus(Qt.FocusReason.OtherFocusReason)

    def card_height_px(self) -> int:
        return self.card.sizeHint().height()

    def _place(self) -> None:
        # The top bar stays free, so that the red button can always be reached.
        self.setGeometry(QRect(0, 56, self._window.width(), self._window.height() - 56))
        width = min(self._width_px, self.width() - 32)
        height = min(self.card_height_px(), self.height() - 48)
        self.card.setGeometry((self.width() - width) // 2, 24, width, height)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if watched is self._window and event.type() == QEvent.Type.Resize and self.isVisible():
            self._place()
        return False

    def mousePressEvent(self, _event: QMouseEvent) -> None:
        self.close_overlay()

    def paintEvent(self, _event: QPaintEvent) -> None:
        QPainter(self).fillRect(self.rect(), QColor(self._theme.colors.shadow))


class _Card(QWidget):
    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(parent)
        self._theme = theme
        theme.changed.connect(self.update)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        event.accept()

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(QPen(self._theme.color("line_strong"), 1))
        painter.setBrush(self._theme.color("panel"))
        painter.drawRoundedRect(QRectF(self.rect()).adjusted(0.5, 0.5, -0.5, -0.5), 12, 12)


class CommandPalette(Overlay):
    """Type a few letters of anything the console can do, Enter does it."""

    def __init__(self, theme: Theme, window: QWidget) -> None:
        super().__init__(theme, window, width_px=620)
        self.setObjectName("command_palette")
        self._entries: Sequence[Entry] = ()
        self.field = _PaletteField(self)
        self.field.setObjectName("palette_field")
        self.field.setPlaceholderText("Find an action, phrase, place, robot or panel…")
        self.field.setAccessibleName("Find anything")
        self.field.setMinimumHeight(46)
        self.field.textChanged.connect(self._on_text_changed)
        self.list = _EntryList(theme, self)
        layout = QVBoxLayout(self.card)
        layout.setContentsMargins(12, 12, 12, 12)
        layout.setSpacing(8)
        layout.addWidget(self.field)
        layout.addWidget(self.list, 1)

    def card_height_px(self) -> int:
        return 46 + 32 + _ROWS * _ROW_PX

    def open_with(self, entries: Sequence[Entry]) -> None:
        self._entries = entries
        self.field.clear()
        self._on_text_changed("")
        self.open()
        self.field.setFocus(Qt.FocusReason.OtherFocusReason)

    def renew(self, entries: Sequence[Entry]) -> None:
        """What can be done has changed meanwhile."""
        self._entries = entries
        self._on_text_changed(self.field.text())

    def choose(self, entry: Entry | None) -> None:
        if entry is None:
            return
        if entry.deliberate and self.list.asked_again != entry:
            self.list.ask_again(entry)
            return
        self.close_overlay()
        entry.do()

    def _on_text_changed(self, text: str) -> None:
        self.list.show_entries(matching(self._entries, text))


class _PaletteField(QLineEdit):
    def __init__(self, palette: CommandPalette) -> None:
        super().__init__()
        self._owner = palette
        self._enter_down = False

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() in (Qt.Key.Key_Up, Qt.Key.Key_Down):
            self._owner.list.move_by(1 if event.key() == Qt.Key.Key_Down else -1)
        elif event.key() in _ENTER:
            # A key that is held, which Qt does not always tell from one that is pressed again, asks only once.
            if not self._enter_down:
                self._enter_down = True
                self._owner.choose(self._owner.list.current)
        else:
            super().keyPressEvent(event)

    def keyReleaseEvent(self, event: QKeyEvent) -> None:
        if event.key() in _ENTER and not event.isAutoRepeat():
            self._enter_down = False
        super().keyReleaseEvent(event)

    def focusOutEvent(self, event: QFocusEvent) -> None:
        self._enter_down = False
        super().focusOutEvent(event)


class _EntryList(QWidget):
    def __init__(self, theme: Theme, owner: CommandPalette) -> None:
        super().__init__()
        self._theme = theme
        self._owner = owner
        self._entries: list[Entry] = []
        self._index = _NONE
        self._double_click = False
        self.asked_again: Entry | None = None
        self.setMouseTracking(True)

    @property
    def entries(self) -> tuple[Entry, ...]:
        """What is found, in order."""
        return tuple(self._entries)

    @property
    def current(self) -> Entry | None:
        """What Enter does; None where nothing is chosen."""
        return self._entries[self._index] if 0 <= self._index < len(self._entries) else None

    def show_entries(self, entries: list[Entry]) -> None:
        self._entries = entries
        # Before what is dangerous nothing is chosen, so that a quick Enter does neither this nor something else.
        self._choose_row(0 if entries and not entries[0].deliberate else _NONE)

    def ask_again(self, entry: Entry) -> None:
        """The same once more does it; anything else does not."""
        self.asked_again = entry
        self.update()

    def move_by(self, step: int) -> None:
        if self._entries:
            before = self._index if self._index != _NONE else (_NONE if step > 0 else 0)
            self._choose_row((before + step) % len(self._entries))

    def _choose_row(self, row: int) -> None:
        self._index = row
        if self.current is not self.asked_again:
            self.asked_again = None
        self.update()

    def _first(self) -> int:
        fits = max(1, self.height() // _ROW_PX)
        return max(0, self._index - fits + 1)

    def _row_at(self, event: QMouseEvent) -> int:
        row = self._first() + int(event.position().y()) // _ROW_PX
        return row if 0 <= row < len(self._entries) else _NONE

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        row = self._row_at(event)
        if row not in (_NONE, self._index):
            self._choose_row(row)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self._double_click = False
        event.accept()

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        self._double_click = True  # one act, however often the finger comes down
        event.accept()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        row = self._row_at(event)
        if row != _NONE and not self._double_click:
            self._choose_row(row)
            self._owner.choose(self._entries[row])

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme = self._theme
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if not self._entries:
            painter.setPen(theme.color("dim"))
            painter.drawText(self.rect(), Qt.AlignmentFlag.AlignCenter, "Nothing is called that here.")
            return
        first = self._first()
        for line, entry in enumerate(self._entries[first : first + self.height() // _ROW_PX]):
            rect = QRectF(0, line * _ROW_PX, self.width(), _ROW_PX)
            again = entry == self.asked_again
            if first + line == self._index:
                painter.setPen(Qt.PenStyle.NoPen)
                painter.setBrush(theme.color("amber_soft" if again else "blue_soft"))
                painter.drawRoundedRect(rect, 8, 8)
            draw_icon(painter, QRectF(12, rect.center().y() - 9, 18, 18), entry.icon, theme.color("dim"))
            cap = key_cap_width(theme, entry.key)
            draw_key_cap(painter, theme, entry.key, self.width() - cap - 12, rect.center().y())
            painter.setFont(theme.font(tokens.STATUS_PX))
            painter.setPen(theme.color("dim"))
            kind_rect = rect.adjusted(0, 0, -cap - 24, 0)
            painter.drawText(kind_rect, int(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter), entry.kind)
            painter.setFont(theme.font(tokens.BODY_PX))
            painter.setPen(theme.color("text"))
            room = int(rect.width() - cap - 160)
            words = entry.again if again else entry.text
            text = painter.fontMetrics().elidedText(words, Qt.TextElideMode.ElideRight, room)
            painter.drawText(rect.adjusted(42, 0, 0, 0), int(Qt.AlignmentFlag.AlignVCenter), text)


class ShortcutSheet(Overlay):
    """Every key of this scenario, written out from the table."""

    def __init__(self, theme: Theme, window: QWidget) -> None:
        super().__init__(theme, window, width_px=980)
        self.setObjectName("shortcut_sheet")
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self._body: QWidget | None = None
        self._inner: QWidget | None = None
        self._layout = QVBoxLayout(self.card)
        self._layout.setContentsMargins(24, 20, 24, 20)

    def open_with(self, actions: Actions) -> None:
        if self._body is not None:
            self._layout.removeWidget(self._body)
            self._body.deleteLater()
        self._body = self._build(actions)
        self._layout.addWidget(self._body)
        self.open()
        self.setFocus(Qt.FocusReason.OtherFocusReason)

    def card_height_px(self) -> int:
        return 104 + (self._inner.sizeHint().height() if self._inner is not None else 0)

    def _build(self, actions: Actions) -> QWidget:
        body = QWidget()
        column = QVBoxLayout(body)
        column.setContentsMargins(0, 0, 0, 0)
        heading = QLabel("All shortcuts")
        heading.setFont(self._theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        column.addWidget(heading)
        column.addWidget(
            self._dim("The second key works while Drive, Video or Map has the focus. Esc closes this sheet.")
        )
        column.addSpacing(8)
        groups: dict[str, list[ActionSpec]] = {}
        for spec in actions.specs:
            groups.setdefault(spec.group, []).append(spec)
        inner = self._inner = QWidget()
        sides = QHBoxLayout(inner)
        sides.setContentsMargins(0, 0, 0, 0)
        sides.setSpacing(40)
        rows = sum(len(group) + 1 for group in groups.values())
        left, right = QVBoxLayout(), QVBoxLayout()
        for side in (left, right):
            side.setSpacing(0)  # else they take over the gap between them
        used = 0
        for name, group in groups.items():
            side = left if used + len(group) / 2 <= rows / 2 else right
            used += len(group) + 1
            side.addWidget(self._group(name, group, actions))
            side.addSpacing(16)
        for side in (left, right):
            side.addStretch(1)
            sides.addLayout(side, 1)
        scroll = QScrollArea()
        scroll.setWidgetResizable(True)
        scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        scroll.setWidget(inner)
        column.addWidget(scroll, 1)
        return body

    def _group(self, name: str, specs: Sequence[ActionSpec], actions: Actions) -> QWidget:
        holder = QWidget()
        holder.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Maximum)
        grid = QGridLayout(holder)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setHorizontalSpacing(8)
        grid.setVerticalSpacing(6)
        heading = QLabel(name)
        heading.setFont(self._theme.font(tokens.STATUS_PX, tokens.WEIGHT_SEMIBOLD))
        grid.addWidget(heading, 0, 0, 1, 3)
        for row, spec in enumerate(specs, start=1):
            text = QLabel(self.fontMetrics().elidedText(spec.text, Qt.TextElideMode.ElideRight, 250))
            grid.addWidget(text, row, 0)
            for column, keys in ((1, spec.keys), (2, spec.driving_keys)):
                caps = QHBoxLayout()
                caps.setSpacing(4)
                for cap in actions.caps(spec, keys):
                    caps.addWidget(KeyCap(self._theme, cap))
                caps.addStretch(1)
                grid.addLayout(caps, row, column)
        grid.setColumnStretch(0, 1)
        grid.setColumnMinimumWidth(2, 56)
        return holder

    def _dim(self, text: str) -> QLabel:
        label = QLabel(text)
        label.setFont(self._theme.font(tokens.STATUS_PX))
        self._theme.color_text(label, "dim")
        return label

    def keyPressEvent(self, event: QKeyEvent) -> None:
        self.close_overlay()
        event.accept()
