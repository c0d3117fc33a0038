"""Label popup of an annotation: free text, or a vocabulary value."""

from collections.abc import Sequence

from PySide6.QtCore import QEvent, QObject, QPointF, QSize, Qt, Signal
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QLineEdit, QListWidget, QListWidgetItem, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.recording.annotation.annotation_model import VocabularyEntry
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.floating_card import FloatingCard

_ROW_PX = 28
_MOST_ROWS = 8
_VALUE = int(Qt.ItemDataRole.UserRole)


class LabelCard(FloatingCard):
    """``chosen(str)`` with the label; not emitted on cancel. With a vocabulary, typing searches and digits select."""

    chosen = Signal(str)

    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(theme, parent)
        self.setObjectName("label_card")
        self._entries: tuple[VocabularyEntry, ...] | None = None
        self._before = ""
        self._done = True
        self.field = QLineEdit(maxLength=10_000)
        self.field.setObjectName("label_field")
        self.field.setAccessibleName(tr("Label of the annotation"))
        self.field.setMinimumHeight(32)
        self.field.setMinimumWidth(240)
        self.field.textEdited.connect(self._on_text_edited)
        self.field.installEventFilter(self)
        self.list = QListWidget()
        self.list.setObjectName("label_list")
        self.list.setAccessibleName(tr("Labels of the vocabulary"))
        self.list.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.list.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.list.setUniformItemSizes(True)
        self.list.itemClicked.connect(self._on_item_clicked)
        column = layouts.vbox(self, margins_px=8, spacing_px=4)
        column.addWidget(self.field)
        column.addWidget(self.list)

    def ask(self, where: QPointF, value: str, entries: Sequence[VocabularyEntry] | None) -> None:
        """Open next to ``where`` with the current label; ``entries``: permitted values, None for free text."""
        self._entries = None if entries is None else tuple(entries)
        self._before = value
        self._done = False
        self.list.setVisible(self._entries is not None)
        if self._entries is None:
            self.field.setText(value)
            self.field.setPlaceholderText(tr("Describe what happens"))
            self.field.selectAll()
        else:
            self.field.clear()
            self.field.setPlaceholderText(value or tr("Type or press a number"))
            self._fill("")
        self.open_at(where)
        self.field.setFocus(Qt.FocusReason.PopupFocusReason)

    def _fill(self, typed: str) -> None:
        self.list.clear()
        entries = self._entries or ()
        wanted = typed.casefold().strip()
        # Prefix matches first.
        found = [item for item in enumerate(entries, start=1) if wanted in item[1].value.casefold()]
        found.sort(key=lambda item: not item[1].value.casefold().startswith(wanted))
        for number, entry in found:
            key = f"{number}  " if number <= 9 else ""
            meaning = f"  ·  {entry.description}" if entry.description else ""
            row = QListWidgetItem(f"{key}{entry.value}{meaning}")
            row.setData(_VALUE, entry.value)
            row.setToolTip(entry.description)
            row.setSizeHint(QSize(200, _ROW_PX))
            self.list.addItem(row)
        values = [entry.value for _, entry in found]
        self.list.setCurrentRow(values.index(self._before) if not wanted and self._before in values else 0)
        self.list.setFont(self._theme.font(tokens.STATUS_PX))
        self.list.setFixedHeight(_ROW_PX * min(_MOST_ROWS, max(1, len(entries))) + 4)
        self.list.setMinimumWidth(min(360, max(240, self.list.sizeHintForColumn(0) + 24)))

    def _on_text_edited(self, text: str) -> None:
        if self._entries is None:
            return
        if text.isdigit() and 1 <= int(text) <= min(9, len(self._entries)):
            self._finish(self._entries[int(text) - 1].value)
        else:
            self._fill(text)

    def _on_item_clicked(self, item: QListWidgetItem) -> None:
        self._finish(str(item.data(_VALUE)))

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if watched is self.field and not self._done:
            if event.type() in (QEvent.Type.KeyPress, QEvent.Type.ShortcutOverride) and isinstance(event, QKeyEvent):
                return self._filter_key(event)
            if event.type() == QEvent.Type.FocusOut:
                # Free text is saved on losing the focus, as in any field; a vocabulary value must be chosen.
                self._finish(self.field.text() if self._entries is None else None)
        return super().eventFilter(watched, event)

    def _filter_key(self, event: QKeyEvent) -> bool:
        """Keys of the popup: Return selects, arrows move, Esc cancels."""
        key = event.key()
        keys = (Qt.Key.Key_Return, Qt.Key.Key_Enter, Qt.Key.Key_Escape, Qt.Key.Key_Up, Qt.Key.Key_Down)
        if key not in keys:
            return False
        event.accept()
        if event.type() == QEvent.Type.ShortcutOverride:
            return True
        if key == Qt.Key.Key_Escape:
            self._finish(None)
        elif key in (Qt.Key.Key_Up, Qt.Key.Key_Down):
            step = 1 if key == Qt.Key.Key_Down else -1
            self.list.setCurrentRow(min(max(0, self.list.currentRow() + step), self.list.count() - 1))
        elif self._entries is None:
            self._finish(self.field.text())
        else:
            row = self.list.currentItem()
            if row is not None:
                self._finish(str(row.data(_VALUE)))
        return True

    def give_up(self) -> bool:
        """Close without a label; False if it was not open."""
        if self._done:
            return False
        self._finish(None)
        return True

    def _finish(self, value: str | None) -> None:
        if self._done:
            return
        self._done = True
        self.hide()
        if value is not None and value != self._before:
            self.chosen.emit(value)
