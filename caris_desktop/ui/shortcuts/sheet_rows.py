"""Rows of the shortcut sheet: command, keys, reset."""

from collections.abc import Iterable

from PySide6.QtCore import QRectF, QSize, Qt, Signal
from PySide6.QtGui import QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QAbstractButton, QLabel, QSizePolicy, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_spec import ActionSpec
from caris_desktop.ui.key_choices import COLUMNS, Column
from caris_desktop.ui.shortcuts.wizard_keys import WizardKeys
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.elided_label import ElidedLabel
from caris_desktop.ui.widgets.key_cap import draw_key_cap, key_cap_width

_CELL_PX = 28
_CELL_WIDTHS_PX: dict[Column, int] = {"keys": 148, "driving_keys": 84}
_PUT_BACK_PX = 30


class KeyCell(QAbstractButton):
    """Key caps of one column; a click asks for another key."""

    def __init__(self, theme: Theme, column: Column) -> None:
        super().__init__()
        self._theme = theme
        self._caps: tuple[str, ...] = ()
        self._asks = False
        self.column: Column = column
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)

    @property
    def caps(self) -> tuple[str, ...]:
        return self._caps

    def show_caps(self, caps: Iterable[str]) -> None:
        self._caps = tuple(dict.fromkeys(caps))  # both Enter keys read alike
        self.updateGeometry()
        self.update()

    def set_asks(self, asks: bool) -> None:
        """Set whether it waits for a key."""
        self._asks = asks
        self.update()

    def sizeHint(self) -> QSize:
        caps = sum(round(key_cap_width(self._theme, cap)) + 4 for cap in self._caps) + 8
        return QSize(max(_CELL_WIDTHS_PX[self.column], caps), _CELL_PX)

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme, painter = self._theme, QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        lit = self._asks or (self.isEnabled() and (self.underMouse() or self.hasFocus()))
        if lit:
            painter.setPen(QPen(theme.color("blue"), 2 if self._asks or self.hasFocus() else 1))
            painter.setBrush(theme.color("blue_soft"))
            painter.drawRoundedRect(QRectF(self.rect()).adjusted(1, 1, -1, -1), 6, 6)
        painter.setFont(theme.font(tokens.STATUS_PX))
        painter.setPen(theme.color("text" if lit else "dim"))
        left = 6.0
        room = QRectF(self.rect()).adjusted(left, 0, -4, 0)
        if self._asks or not self._caps:
            words = tr("Press keys…") if self._asks else tr("add") if lit else "–" if self.isEnabled() else ""
            painter.drawText(room, int(Qt.AlignmentFlag.AlignVCenter), words)
            return
        for cap in self._caps:
            left += draw_key_cap(painter, theme, cap, left, self.height() / 2) + 4


class ShortcutRow(QWidget):
    """Row of the sheet. ``wanted(KeyCell)`` asks for another key, ``put_back`` for the default ones."""

    wanted = Signal(object)
    put_back = Signal()

    def __init__(self, theme: Theme, spec: ActionSpec) -> None:
        super().__init__()
        self.spec = spec
        self._words = ElidedLabel()
        self.cells: dict[Column, KeyCell] = {column: KeyCell(theme, column) for column in COLUMNS}
        self._back = ActionButton(theme, "", icon="arrow-counter-clockwise", look="ghost", height_px=_CELL_PX)
        self._back.clicked.connect(self.put_back)
        self._back_room = QWidget()
        self._back_room.setFixedWidth(_PUT_BACK_PX)
        back = layouts.hbox(self._back_room, margins_px=0)
        back.addWidget(self._back)
        line = layouts.hbox(self, margins_px=0, spacing_px=4)
        line.addWidget(self._words, 1)
        for cell in self.cells.values():
            line.addWidget(cell)
            cell.clicked.connect(lambda _checked=False, asked=cell: self.wanted.emit(asked))
        line.addWidget(self._back_room)

    def show_spec(self, spec: ActionSpec, text: str, actions: Actions, keys: WizardKeys) -> None:
        """``spec``: row with its current keys; ``text``: its current text."""
        self.spec = spec
        self._words.setText(text)
        self._words.setToolTip(text)
        fixed = spec.kind == "safety"
        titles: dict[Column, str] = {"keys": tr("anywhere"), "driving_keys": tr("while driving")}
        for column, cell in self.cells.items():
            caps = actions.caps(spec, getattr(spec, column))
            cell.show_caps(caps)
            # Keys of a part of the window work only there.
            cell.setEnabled(not fixed and not (spec.within and column == "driving_keys"))
            cell.setObjectName(f"{spec.id}_{column}")
            cell.setAccessibleName(
                tr("{act}, {where}: {keys}").format(
                    act=text, where=titles[column], keys=", ".join(caps) or tr("no key")
                )
            )
        is_changed = keys.is_changed(spec)
        self._back.setVisible(is_changed)
        self._back.setObjectName(f"{spec.id}_put_back")
        self._back.setAccessibleName(tr("Default keys for {act}").format(act=text))
        self._back.setToolTip(tr("Reset to the default keys"))

    def is_found_by(self, query: str) -> bool:
        """Whether text, group or keys contain every word of the query."""
        caps = " ".join(cap for cell in self.cells.values() for cap in cell.caps)
        there = f"{self._words.text()} {tr(self.spec.group)} {caps} {caps.replace(' ', '+')}".casefold()
        return all(word in there for word in query.casefold().split())


class ShortcutGroup(QWidget):
    """Rows of one group below its heading."""

    def __init__(self, theme: Theme, title: str, rows: list[ShortcutRow]) -> None:
        super().__init__()
        self.rows = rows
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Maximum)
        column = layouts.vbox(self, margins_px=(0, 0, 0, 12), spacing_px=0)
        heading = layouts.hbox(spacing_px=4)
        words = QLabel(title)
        words.setFont(theme.font(tokens.STATUS_PX, tokens.WEIGHT_SEMIBOLD))
        heading.addWidget(words, 1)
        for name, width in (
            (tr("In the list") if rows[0].spec.within == "queue" else tr("Anywhere"), _CELL_WIDTHS_PX["keys"]),
            ("" if rows[0].spec.within else tr("Driving"), _CELL_WIDTHS_PX["driving_keys"]),
        ):
            label = QLabel(name)
            label.setFont(theme.font(tokens.STATUS_PX))
            label.setContentsMargins(6, 0, 0, 0)
            label.setMinimumWidth(width)
            theme.color_text(label, "dim")
            heading.addWidget(label)
        heading.addSpacing(_PUT_BACK_PX + 4)
        column.addLayout(heading)
        for row in rows:
            column.addWidget(row)

    def show_found(self, query: str) -> int:
        """Show only matching rows; returns their number."""
        found = [row for row in self.rows if row.is_found_by(query)]
        for row in self.rows:
            row.setVisible(row in found)
        self.setVisible(bool(found))
        return len(found)
