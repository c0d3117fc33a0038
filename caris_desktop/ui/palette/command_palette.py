"""Command palette popup: search field and results."""

import sys
from collections.abc import Callable, Sequence

from PySide6.QtCore import QRect, QRectF, Qt
from PySide6.QtGui import QFocusEvent, QKeyEvent, QMouseEvent, QPainter, QPaintEvent
from PySide6.QtWidgets import QLineEdit, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.key_positions import key_code, position_of
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.palette.palette_item import PaletteItem
from caris_desktop.ui.palette.palette_memory import PaletteMemory
from caris_desktop.ui.palette.palette_search import Finder, says_what_to_do
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.accessible_regions import AccessibleRegion, AccessibleRegions
from caris_desktop.ui.widgets.key_cap import draw_key_cap, key_cap_width

_ROW_PX = 40
_ROWS = 9
_NONE = -1
_ENTER = (Qt.Key.Key_Return, Qt.Key.Key_Enter)


class CommandPalette(Overlay):
    """Search field with a result list; Enter runs the selected result."""

    DIGITS = 9

    def __init__(self, theme: Theme, window: QWidget, memory: PaletteMemory) -> None:
        super().__init__(theme, window, width_px=620)
        self.setObjectName("command_palette")
        self._memory = memory
        self._finder = Finder(())
        self._new: Callable[[str], PaletteItem] | None = None
        self._by_digit: Sequence[PaletteItem] = ()
        self.field = _PaletteField(self)
        self.field.setObjectName("palette_field")
        self.field.setMinimumHeight(46)
        self.field.textChanged.connect(self._on_text_changed)
        self.list = _EntryList(theme, self)
        layout = layouts.vbox(self.card, margins_px=12, spacing_px=8)
        layout.addWidget(self.field)
        layout.addWidget(self.list, 1)

    def card_height_px(self) -> int:
        return 46 + 32 + _ROWS * _ROW_PX

    def open_with(self, entries: Sequence[PaletteItem]) -> None:
        """Search these items, recently used ones first."""
        self._new, self._by_digit = None, ()
        self._open(
            Finder(entries, self._memory.used), tr("Find an action, phrase, place, person, setting or session…"),
            tr("Find anything"),
        )  # fmt: skip

    def ask(self, question: str, entries: Sequence[PaletteItem], new: Callable[[str], PaletteItem]) -> None:
        """Choose one of ``entries`` or type a new one, created by ``new``."""
        self._new, self._by_digit = new, ()
        self._open(Finder(entries), question, question)

    def choose_from(self, question: str, entries: Sequence[PaletteItem]) -> None:
        """Choose one of ``entries``; while nothing is typed, digit N selects the Nth."""
        self._new, self._by_digit = None, entries[: self.DIGITS]
        self._open(Finder(entries), question, question)

    def takes_digit(self, digit: str) -> bool:
        """Run the item of a digit; returns whether there was one."""
        if self.field.text() or not 1 <= int(digit) <= len(self._by_digit):
            return False
        self.choose(self._by_digit[int(digit) - 1])
        return True

    def _open(self, finder: Finder, placeholder: str, name: str) -> None:
        self._finder = finder
        self.field.setPlaceholderText(placeholder)
        self.field.setAccessibleName(name)
        self.field.clear()
        self._on_text_changed("")
        self.open()
        self.field.setFocus(Qt.FocusReason.OtherFocusReason)

    def renew(self, entries: Sequence[PaletteItem]) -> None:
        """Replace the items after the available commands changed."""
        if self._new is None and not self._by_digit:
            self._finder = Finder(entries, self._memory.used)
            self._on_text_changed(self.field.text())

    def choose(self, entry: PaletteItem | None) -> None:
        if entry is None:
            return
        if entry.deliberate and self.list.pending_entry != entry:
            self.list.ask_again(entry)
            return
        self.close_overlay()
        if self._new is None:
            self._memory.note(entry)
        entry.do()

    def report_current(self) -> None:
        """Describe the current item on the field, the only widget that a screen reader follows."""
        entry = self.list.current
        self.field.setAccessibleDescription("" if entry is None else entry.spoken)

    def _on_text_changed(self, text: str) -> None:
        typed = " ".join(text.split())
        found = self._finder.matching(typed)
        if self._new is not None and typed:
            found.append(self._new(typed))
        breaks = () if typed else self._finder.breaks
        selected = bool(typed) and bool(found) and says_what_to_do(found[0], typed)
        self.list.show_entries(found, breaks=breaks, selected=selected, by_digit=bool(self._by_digit) and not typed)


class _PaletteField(QLineEdit):
    def __init__(self, palette: CommandPalette) -> None:
        super().__init__()
        self._owner = palette
        self._enter_down = False

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() in (Qt.Key.Key_Up, Qt.Key.Key_Down):
            self._owner.list.move_by(1 if event.key() == Qt.Key.Key_Down else -1)
        elif event.key() in _ENTER:
            # One Enter per key press: Qt does not always mark auto-repeat.
            if not self._enter_down:
                self._enter_down = True
                self._owner.choose(self._owner.list.current)
        else:
            digit = _digit_of(event)
            if not digit or event.isAutoRepeat() or not self._owner.takes_digit(digit):
                super().keyPressEvent(event)

    def keyReleaseEvent(self, event: QKeyEvent) -> None:
        if event.key() in _ENTER and not event.isAutoRepeat():
            self._enter_down = False
        super().keyReleaseEvent(event)

    def focusOutEvent(self, event: QFocusEvent) -> None:
        self._enter_down = False
        super().focusOutEvent(event)


def _digit_of(event: QKeyEvent) -> str:
    """Digit of a key by position, whatever the layout types without Shift; empty for other keys."""
    if event.modifiers() & ~Qt.KeyboardModifier.KeypadModifier:
        return ""
    code = key_code(sys.platform, scan_code=event.nativeScanCode(), virtual_key=event.nativeVirtualKey())
    digit = position_of(sys.platform, code) or event.text()
    return digit if digit in tuple("123456789") else ""


class _EntryList(QWidget):
    def __init__(self, theme: Theme, owner: CommandPalette) -> None:
        super().__init__()
        self._theme = theme
        self._owner = owner
        self._entries: list[PaletteItem] = []
        self._index = _NONE
        self._double_click = False
        self._breaks: Sequence[int] = ()
        self.pending_entry: PaletteItem | None = None
        self.setMouseTracking(True)
        self._regions = AccessibleRegions(self, self, self._spots, self._on_accessible_press)

    @property
    def entries(self) -> tuple[PaletteItem, ...]:
        """Results in order."""
        return tuple(self._entries)

    @property
    def current(self) -> PaletteItem | None:
        """Item that Enter runs; None if none is selected."""
        return self._entries[self._index] if 0 <= self._index < len(self._entries) else None

    def show_entries(
        self, entries: list[PaletteItem], *, breaks: Sequence[int], selected: bool, by_digit: bool
    ) -> None:
        """Show results. ``breaks``: indices of divider lines. ``selected``: the query names what the first item does.

        ``by_digit``: while nothing is typed, digits select and Enter selects nothing.
        """
        self._entries = entries
        self._breaks = breaks
        # A dangerous item is never preselected, so that a quick Enter runs neither it nor another one; an item that
        # speaks or moves the robot is preselected only if the query names it.
        can_be_chosen = bool(entries) and not entries[0].deliberate and (selected or not (entries[0].acts or by_digit))
        self._choose_row(0 if can_be_chosen else _NONE)

    def ask_again(self, entry: PaletteItem) -> None:
        """Ask for confirmation: choosing the same item again runs it."""
        self.pending_entry = entry
        self.update()

    def move_by(self, step: int) -> None:
        if self._entries:
            before = self._index if self._index != _NONE else (_NONE if step > 0 else 0)
            self._choose_row((before + step) % len(self._entries))

    def _choose_row(self, row: int) -> None:
        self._index = row
        if self.current is not self.pending_entry:
            self.pending_entry = None
        self._owner.report_current()
        self.update()

    def _first(self) -> int:
        fits = max(1, self.height() // _ROW_PX)
        return max(0, self._index - fits + 1)

    def _row_at(self, event: QMouseEvent) -> int:
        row = self._first() + int(event.position().y()) // _ROW_PX
        return row if 0 <= row < len(self._entries) else _NONE

    def _spots(self) -> list[AccessibleRegion]:
        first = self._first()
        visible_entries = self._entries[first : first + self.height() // _ROW_PX]
        return [
            AccessibleRegion(
                (str(first + line), entry.text),
                entry.again if entry == self.pending_entry else entry.spoken,
                QRect(0, line * _ROW_PX, self.width(), _ROW_PX),
                tr("Selected: press Enter to run it") if first + line == self._index else "",
            )
            for line, entry in enumerate(visible_entries)
        ]

    def _on_accessible_press(self, key: tuple[str, ...]) -> None:
        row = int(key[0])
        # The list may have changed since the region was reported.
        if row < len(self._entries) and self._entries[row].text == key[1]:
            self._choose_row(row)
            self._owner.choose(self._entries[row])

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        row = self._row_at(event)
        if row not in (_NONE, self._index):
            self._choose_row(row)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self._double_click = False
        event.accept()

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        self._double_click = True  # one command, however often the button is pressed
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
            painter.drawText(self.rect(), Qt.AlignmentFlag.AlignCenter, tr("No matching entries."))
            return
        first = self._first()
        for line, entry in enumerate(self._entries[first : first + self.height() // _ROW_PX]):
            rect = QRectF(0, line * _ROW_PX, self.width(), _ROW_PX)
            again = entry == self.pending_entry
            if line and first + line in self._breaks:
                painter.setPen(theme.color("line"))
                painter.drawLine(rect.topLeft(), rect.topRight())
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
