"""List of pending and answered questions, one line each; the selected one is shown below."""

from collections.abc import Sequence

from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtGui import QAccessible, QKeyEvent, QMouseEvent, QPainter, QPaintEvent
from PySide6.QtWidgets import QLabel, QScrollArea, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import ExchangeStatus
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.elided_label import ElidedLabel

ROW_PX = 30
_STATE_PX = 108
_WORDS = {
    "preparing": QT_TR_NOOP("Reading pictures"), "answering": QT_TR_NOOP("Writing"), "answered": QT_TR_NOOP("Answered"),
    "cancelled": QT_TR_NOOP("Cancelled"),
    "failed": QT_TR_NOOP("No answer"),
}  # fmt: skip
_USED = {"said": QT_TR_NOOP("Said"), "edited": QT_TR_NOOP("Said, edited")}


class ExchangeRows(QScrollArea):
    """Arrow keys select a row, Enter says its answer, Shift+Enter edits it first, Delete dismisses it."""

    accessible_role = QAccessible.Role.List

    chosen = Signal(str)
    say_wanted = Signal(str)
    edit_wanted = Signal(str)
    away_wanted = Signal(str)

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._theme = theme
        self._rows: dict[str, _Row] = {}
        self._current = ""
        self.setObjectName("assistant_rows")
        self.setAccessibleName(tr("Questions to the assistant"))
        self.setWidgetResizable(True)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        inner = QWidget()
        self._column = layouts.vbox(inner, margins_px=0, spacing_px=2)
        self._column.addStretch(1)
        self.setWidget(inner)

    def sizeHint(self) -> QSize:
        return QSize(200, len(self._rows) * (ROW_PX + 2))

    def minimumSizeHint(self) -> QSize:
        return QSize(100, min(len(self._rows), 2) * (ROW_PX + 2))

    def show_rows(self, exchanges: Sequence[ExchangeStatus], current: str, *, live: bool, speaks: bool = True) -> None:
        """Show the exchanges, newest first. ``live``: they can be used; ``speaks``: answers can be said."""
        count = len(self._rows)
        for exchange_id in [each for each in self._rows if each not in {row.exchange_id for row in exchanges}]:
            row = self._rows.pop(exchange_id)
            row.hide()
            row.deleteLater()
        self._current = current
        for place, exchange in enumerate(exchanges):
            row = self._rows.get(exchange.exchange_id) or self._new_row(exchange.exchange_id)
            if self._column.indexOf(row) != place:
                self._column.removeWidget(row)
                self._column.insertWidget(place, row)
            row.show_exchange(exchange, current=exchange.exchange_id == current, live=live, speaks=speaks)
        if len(self._rows) != count:
            self.updateGeometry()

    def _new_row(self, exchange_id: str) -> "_Row":
        row = self._rows[exchange_id] = _Row(self._theme)
        row.pressed.connect(lambda: self.chosen.emit(exchange_id))
        row.say.clicked.connect(lambda: self.say_wanted.emit(exchange_id))
        row.away.clicked.connect(lambda: self.away_wanted.emit(exchange_id))
        self._column.insertWidget(0, row)
        return row

    def keyPressEvent(self, event: QKeyEvent) -> None:
        order = sorted(self._rows, key=lambda each: self._column.indexOf(self._rows[each]))
        step = {Qt.Key.Key_Down: 1, Qt.Key.Key_Up: -1}.get(Qt.Key(event.key()))
        if step is not None and self._current in order:
            at = order.index(self._current) + step
            if 0 <= at < len(order):
                self.chosen.emit(order[at])
                self.ensureWidgetVisible(self._rows[order[at]])
        elif event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter) and not event.isAutoRepeat():
            edited = event.modifiers() & Qt.KeyboardModifier.ShiftModifier
            (self.edit_wanted if edited else self.say_wanted).emit(self._current)
        elif event.key() == Qt.Key.Key_Delete and not event.isAutoRepeat():
            self.away_wanted.emit(self._current)
        else:
            super().keyPressEvent(event)


class _Row(QWidget):
    """Row with state, question and two buttons."""

    pressed = Signal()

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._theme = theme
        self._current = False
        self.setFixedHeight(ROW_PX)
        self._state = QLabel()
        self._state.setFixedWidth(_STATE_PX)
        self._question = ElidedLabel()
        self.say = ActionButton(theme, "", icon="speaker-high", look="ghost", height_px=26)
        self.say.setObjectName("assistant_row_say")
        self.away = ActionButton(theme, "", icon="x", look="ghost", height_px=26)
        self.away.setObjectName("assistant_row_away")
        for label in (self._state, self._question):
            label.setFont(theme.font(tokens.STATUS_PX))
        line = layouts.hbox(self, margins_px=(8, 0, 2, 0), spacing_px=6)
        line.addWidget(self._state)
        line.addWidget(self._question, 1)
        line.addWidget(self.say)
        line.addWidget(self.away)
        theme.changed.connect(self.update)

    def show_exchange(self, exchange: ExchangeStatus, *, current: bool, live: bool, speaks: bool) -> None:
        words = tr(_USED.get(exchange.use) or _WORDS[exchange.state])
        role = {"answered": "green", "failed": "amber"}.get(exchange.state, "dim")
        if exchange.is_pending:
            role = "blue"
        self._state.setText(words)
        self._theme.color_text(self._state, "dim" if exchange.use else role)
        self._question.setText(exchange.question)
        self._theme.color_text(self._question, "text" if current else "dim")
        self.say.setVisible(speaks)
        self.say.setEnabled(live and exchange.state == "answered" and bool(exchange.answer))
        self.say.setToolTip(tr("Say this answer"))
        self.say.setAccessibleName(tr("Say the answer to: {question}").format(question=exchange.question))
        self.away.setEnabled(live)
        self.away.setToolTip(tr("Cancel this question") if exchange.is_pending else tr("Dismiss this question"))
        away = tr("Cancel: {question}") if exchange.is_pending else tr("Dismiss: {question}")
        self.away.setAccessibleName(away.format(question=exchange.question))
        if current != self._current:
            self._current = current
            self.update()

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self.pressed.emit()
        event.accept()

    def paintEvent(self, event: QPaintEvent) -> None:
        if self._current:
            painter = QPainter(self)
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(self._theme.color("raised"))
            painter.drawRoundedRect(self.rect(), 6, 6)
        super().paintEvent(event)
