"""Popups of the protocol strip: list of steps, and branches of the current step."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from PySide6.QtCore import QEvent, QObject, QPoint, Qt, Signal
from PySide6.QtGui import QAccessible, QHideEvent
from PySide6.QtWidgets import QApplication, QFrame, QLabel, QScrollArea, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.protocol.step_pills import ShownStep, StepState
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.check_box import CheckBox
from caris_desktop.ui.widgets.floating_card import FloatingCard

Part = TypeVar("Part", bound=QWidget)

MOST_DIGITS = 9
_ROW_PX = 34
_WIDE_PX = 440
_MOST_HIGH_PX = 420
_ICONS: dict[StepState, str] = {
    "done": "check", "skipped": "skip-forward", "now": "play", "late": "play", "ahead": "circle",
}  # fmt: skip


class _CardBelow(FloatingCard):
    """Popup below a part of the strip; a click elsewhere closes it and keeps its usual effect."""

    accessible_role = QAccessible.Role.Dialog

    def open_below(self, part: QWidget) -> None:
        self._strip = part.parentWidget()
        app = QApplication.instance()
        if app is not None and self.isHidden():
            app.installEventFilter(self)
        self.adjustSize()
        where = part.mapTo(self._room, QPoint(0, part.height() + 6))
        room = self._room.rect()
        self.move(max(6, min(where.x(), room.width() - self.width() - 6)), where.y())
        self.show()
        self.raise_()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        pressed = event.type() == QEvent.Type.MouseButtonPress and isinstance(watched, QWidget)
        if pressed and not self._is_of(watched):
            self.hide()
        return False

    def _is_of(self, widget: QObject) -> bool:
        """Whether a widget belongs to the popup, or to the strip that opens and closes it."""
        return any(
            isinstance(widget, QWidget) and (widget is whole or whole.isAncestorOf(widget))
            for whole in (self, self._strip)
            if whole is not None
        )

    def hideEvent(self, event: QHideEvent) -> None:
        app = QApplication.instance()
        if app is not None:
            app.removeEventFilter(self)
        super().hideEvent(event)


class StepsCard(_CardBelow):
    """List of steps to choose from, below the note and checklist of the current step."""

    chosen = Signal(str)
    ticked = Signal(str, bool)

    def __init__(self, theme: Theme, window: QWidget) -> None:
        super().__init__(theme, window)
        self.setObjectName("steps_card")
        self.setAccessibleName(tr("All steps of the protocol"))
        self._note = QLabel(wordWrap=True, textFormat=Qt.TextFormat.PlainText)
        self._note.setObjectName("step_note")
        self._boxes = layouts.vbox(spacing_px=2)
        self._ticks: list[CheckBox] = []
        self._rows: list[ActionButton] = []
        self._list = layouts.vbox(margins_px=0, spacing_px=2)
        inside = QWidget()
        inside.setLayout(self._list)
        self._scroll = QScrollArea(widgetResizable=True)
        self._scroll.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._scroll.setFrameShape(QFrame.Shape.NoFrame)
        self._scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self._scroll.setWidget(inside)
        column = layouts.vbox(self, margins_px=10, spacing_px=8)
        column.addWidget(self._note)
        column.addLayout(self._boxes)
        column.addWidget(self._scroll)
        self.setFixedWidth(_WIDE_PX)
        theme.restyle_on_change(self._style)

    def show_steps(
        self, steps: Sequence[ShownStep], note: str, ticks: Sequence[tuple[str, bool]], *, digits: bool, live: bool
    ) -> None:
        """``digits``: the next digit selects one of the first nine. ``live``: the checklist can be edited."""
        self._note.setText(note)
        self._note.setVisible(bool(note))
        _fit(self._ticks, len(ticks), self._new_box)
        for box, (item, on) in zip(self._ticks, ticks, strict=True):
            box.setText(item)
            box.setChecked(on)
            box.setEnabled(live)
        _fit(self._rows, len(steps), self._new_row)
        for row, step in zip(self._rows, steps, strict=True):
            row.setObjectName(f"step_row_{step.number}")
            row.set_key(str(step.number) if digits and step.number <= MOST_DIGITS else "")
            text = step.title if row.key else f"{step.number}  {step.title}"
            row.set_label(f"{text} · {step.time}" if step.time else text, icon=_ICONS[step.state])
            row.setProperty("step_id", step.step_id)
            row.setChecked(step.state in ("now", "late"))
            row.setAccessibleName(step.words)
            row.setToolTip(step.words)
        self._scroll.setFixedHeight(min(_MOST_HIGH_PX, len(steps) * (_ROW_PX + 2)))

    def _new_box(self) -> CheckBox:
        box = CheckBox(self._theme)
        box.clicked.connect(lambda on, box=box: self.ticked.emit(box.text(), on))
        self._boxes.addWidget(box)
        return box

    def _new_row(self) -> ActionButton:
        row = ActionButton(self._theme, look="ghost", height_px=_ROW_PX, may_shrink=True, key_first=True)
        row.setCheckable(True)
        row.setMaximumWidth(_WIDE_PX - 24)
        row.clicked.connect(lambda _checked=False, row=row: self._on_row(row))
        self._list.addWidget(row, 0, Qt.AlignmentFlag.AlignLeft)
        return row

    def _on_row(self, row: ActionButton) -> None:
        self.hide()
        self.chosen.emit(row.property("step_id"))

    def _style(self) -> None:
        self._note.setFont(self._theme.font(tokens.BODY_PX))


class BranchesCard(_CardBelow):
    """Branches of the current step, each with its digit."""

    chosen = Signal(int)

    def __init__(self, theme: Theme, window: QWidget) -> None:
        super().__init__(theme, window)
        self.setObjectName("branches_card")
        self.setAccessibleName(tr("Actions of the participant"))
        self._rows: list[ActionButton] = []
        self._column = layouts.vbox(self, margins_px=8, spacing_px=4)

    def show_branches(self, texts: Sequence[str]) -> None:
        _fit(self._rows, len(texts), self._new_row)
        for number, (row, text) in enumerate(zip(self._rows, texts, strict=True), start=1):
            row.setObjectName(f"branch_{number}")
            row.set_label(text)
            row.set_key(str(number))

    def _new_row(self) -> ActionButton:
        number = len(self._rows) + 1
        row = ActionButton(self._theme, key_first=True, height_px=_ROW_PX)
        row.clicked.connect(lambda: self.chosen.emit(number))
        self._column.addWidget(row)
        return row


def _fit(parts: list[Part], count: int, new: Callable[[], Part]) -> None:
    """Adjust the number of widgets, reusing existing ones."""
    for part in parts[count:]:
        part.hide()
        part.deleteLater()
    del parts[count:]
    while len(parts) < count:
        parts.append(new())
