"""Command palette popup: search field and results."""

import sys
from collections.abc import Callable, Sequence

from PySide6.QtCore import QModelIndex, QPersistentModelIndex, QRectF, QSize, QStringListModel, Qt
from PySide6.QtGui import QFocusEvent, QKeyEvent, QPainter
from PySide6.QtWidgets import QLabel, QLineEdit, QListView, QStyledItemDelegate, QStyleOptionViewItem, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.key_choices import key_code, position_of
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.palette.palette_search import Finder, PaletteItem, PaletteMemory, says_what_to_do
from caris_desktop.ui.theme import Theme, draw_icon
from caris_desktop.ui.widgets.key_cap import draw_key_cap, key_cap_width

_ROW_PX = 40
_ROWS = 9
Index = QModelIndex | QPersistentModelIndex
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
        self.list = _ItemList(theme, self)
        self._nothing = QLabel(tr("No matching entries."), alignment=Qt.AlignmentFlag.AlignCenter)
        self._nothing.setEnabled(False)
        layout = layouts.vbox(self.card, margins_px=12, spacing_px=8)
        layout.addWidget(self.field)
        layout.addWidget(self.list, 1)
        layout.addWidget(self._nothing, 1)

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
        self.list.setVisible(bool(found))
        self._nothing.setHidden(bool(found))
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


class _ItemList(QListView):
    """Results. The field keeps the focus and moves the current row."""

    def __init__(self, theme: Theme, owner: CommandPalette) -> None:
        super().__init__()
        self._owner = owner
        self.entries: tuple[PaletteItem, ...] = ()
        self.breaks: Sequence[int] = ()
        self.pending_entry: PaletteItem | None = None
        self._double_click = False
        self._spoken = QStringListModel(self)
        self.setModel(self._spoken)
        self.setItemDelegate(_ItemDelegate(theme, self))
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setEditTriggers(QListView.EditTrigger.NoEditTriggers)
        self.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setUniformItemSizes(True)
        self.setMouseTracking(True)
        self.entered.connect(self._choose_row)
        self.selectionModel().selectionChanged.connect(self._on_selected)
        # One command, however often the button is pressed.
        self.pressed.connect(lambda: self._set_double_click(False))
        self.doubleClicked.connect(lambda: self._set_double_click(True))
        self.clicked.connect(self._on_clicked)

    @property
    def current(self) -> PaletteItem | None:
        """Item that Enter runs; None if none is selected."""
        row = self.currentIndex().row()
        return self.entries[row] if row >= 0 else None

    def show_entries(
        self, entries: Sequence[PaletteItem], *, breaks: Sequence[int], selected: bool, by_digit: bool
    ) -> None:
        """Show results. ``breaks``: indices of divider lines. ``selected``: the query names what the first item does.

        ``by_digit``: while nothing is typed, digits select and Enter selects nothing.
        """
        self.entries, self.breaks = tuple(entries), breaks
        self._spoken.setStringList([entry.spoken for entry in entries])
        # A dangerous item is never preselected, so that a quick Enter runs neither it nor another one; an item that
        # speaks or moves the robot is preselected only if the query names it.
        can_be_chosen = bool(entries) and not entries[0].deliberate and (selected or not (entries[0].acts or by_digit))
        self._choose_row(self._spoken.index(0) if can_be_chosen else QModelIndex())

    def ask_again(self, entry: PaletteItem) -> None:
        """Ask for confirmation: choosing the same item again runs it."""
        self.pending_entry = entry
        self._spoken.setData(self.currentIndex(), entry.again)

    def move_by(self, step: int) -> None:
        if self.entries:
            row = self.currentIndex().row()
            before = row if row >= 0 or step > 0 else 0
            self._choose_row(self._spoken.index((before + step) % len(self.entries)))

    def _choose_row(self, index: QModelIndex) -> None:
        self.setCurrentIndex(index)
        if self.pending_entry is not None and self.current is not self.pending_entry:
            if self.pending_entry in self.entries:
                row = self.entries.index(self.pending_entry)
                self._spoken.setData(self._spoken.index(row), self.pending_entry.spoken)
            self.pending_entry = None
        self._owner.report_current()

    def _on_selected(self) -> None:
        """Follow a selection by a screen reader."""
        for index in self.selectedIndexes():
            if index != self.currentIndex():
                self._choose_row(index)

    def _set_double_click(self, double_click: bool) -> None:
        self._double_click = double_click

    def _on_clicked(self, index: QModelIndex) -> None:
        if not self._double_click:
            self._choose_row(index)
            self._owner.choose(self.current)


class _ItemDelegate(QStyledItemDelegate):
    def __init__(self, theme: Theme, items: _ItemList) -> None:
        super().__init__(items)
        self._theme = theme
        self._items = items

    def sizeHint(self, _option: QStyleOptionViewItem, _index: Index) -> QSize:
        return QSize(0, _ROW_PX)

    def paint(self, painter: QPainter, option: QStyleOptionViewItem, index: Index) -> None:
        theme, entry, rect = self._theme, self._items.entries[index.row()], QRectF(option.rect)
        again = entry == self._items.pending_entry
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if index.row() and index.row() in self._items.breaks:
            painter.setPen(theme.color("line"))
            painter.drawLine(rect.topLeft(), rect.topRight())
        if index == self._items.currentIndex():
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(theme.color("amber_soft" if again else "blue_soft"))
            painter.drawRoundedRect(rect, 8, 8)
        draw_icon(painter, QRectF(12, rect.center().y() - 9, 18, 18), entry.icon, theme.color("dim"))
        cap = key_cap_width(theme, entry.key)
        draw_key_cap(painter, theme, entry.key, rect.width() - cap - 12, rect.center().y())
        painter.setFont(theme.font(tokens.STATUS_PX))
        painter.setPen(theme.color("dim"))
        kind_rect = rect.adjusted(0, 0, -cap - 24, 0)
        painter.drawText(kind_rect, int(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter), entry.kind)
        painter.setFont(theme.font(tokens.BODY_PX))
        painter.setPen(theme.color("text"))
        words = entry.again if again else entry.text
        room = int(rect.width() - cap - 160)
        text = painter.fontMetrics().elidedText(words, Qt.TextElideMode.ElideRight, room)
        painter.drawText(rect.adjusted(42, 0, 0, 0), int(Qt.AlignmentFlag.AlignVCenter), text)
