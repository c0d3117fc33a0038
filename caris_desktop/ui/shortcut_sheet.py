"""Shortcut sheet: all key bindings of the action table, each editable and saved in the wizard's profile."""

from collections import deque
from collections.abc import Callable, Iterable
from functools import partial

from PySide6.QtCore import QObject, QRectF, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QMouseEvent, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import (
    QAbstractButton,
    QHBoxLayout,
    QScrollArea,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_rows import ActionSpec
from caris_desktop.ui.input.drive_input_filter import DriveInputFilter
from caris_desktop.ui.input.teleop_input import PressedKey
from caris_desktop.ui.key_choices import (
    COLUMNS,
    Column,
    Keys,
    as_text,
    changed,
    from_text,
    name_of_row,
    owners,
    refusal,
    with_keys,
    without,
)
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.preferences import WizardProfiles
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.labels import ElidedLabel, draw_key_cap, key_cap_width, label, line_edit, restyle

_KEY = "shortcuts"
_UNREAD_KEY = "shortcuts unread"


class WizardKeys(QObject):
    """Key bindings of the current wizard. ``tell`` receives what happened, its meaning and advice if saved keys cannot
    be used.
    """

    changed = Signal()

    def __init__(
        self, wizards: WizardProfiles, actions: Actions, tell: Callable[[str, str, str], None], parent: QObject
    ) -> None:
        super().__init__(parent)
        self._wizards = wizards
        self._actions = actions
        self._tell = tell
        self._choices: dict[str, Keys] = {}
        self._reported: frozenset[str] = frozenset()
        wizards.changed.connect(self.take_up)
        actions.rebuilt.connect(self._report_fallbacks)
        self.take_up()

    @property
    def wizard(self) -> str:
        return self._wizards.current

    def take_up(self) -> None:
        """Apply the current wizard's bindings."""
        stored = str(self._wizards.value(_KEY, "") or "")
        try:
            choices = from_text(stored) if stored else {}
        except ValueError:
            choices = {}
            self._wizards.set_value(_UNREAD_KEY, stored)
            self._wizards.set_value(_KEY, "")
            self._tell(
                tr("Your custom keys could not be read."),
                tr("All commands use their default keys. The unreadable data stays in the settings."),
                tr("Set your keys again in All shortcuts."),
            )
        if choices != self._choices:
            self._use(choices)

    def is_changed(self, spec: ActionSpec) -> bool:
        return name_of_row(spec) in self._choices

    @property
    def any_changed(self) -> bool:
        return bool(self._choices)

    def choose(self, spec: ActionSpec, keys: Keys) -> None:
        """Set the row's keys; other rows lose conflicting ones."""
        rows = {row.id: row for row in self._actions.all_specs}
        choices = dict(self._choices)
        for key, other in owners(rows.values(), spec, keys):
            left = without(rows[other.id], key)
            choices[name_of_row(other)] = left
            rows[other.id] = with_keys(rows[other.id], left)
        choices[name_of_row(spec)] = keys
        for row in (*rows.values(), spec):
            standard = self._actions.standard_row(row.id)
            if choices.get(name_of_row(row)) == Keys(standard.keys, standard.driving_keys):
                del choices[name_of_row(row)]
        self._persist(choices)

    def reset(self, spec: ActionSpec) -> None:
        """Restore the row's default keys."""
        standard = self._actions.standard_row(spec.id)
        self.choose(spec, Keys(standard.keys, standard.driving_keys))

    def reset_all(self) -> None:
        self._persist({})

    def _persist(self, choices: dict[str, Keys]) -> None:
        self._wizards.set_value(_KEY, as_text(choices))
        self._use(choices)

    def _use(self, choices: dict[str, Keys]) -> None:
        self._choices = choices
        self._actions.use_choices(choices)
        self._report_fallbacks()
        self.changed.emit()

    def _report_fallbacks(self) -> None:
        fallen_back = frozenset(self._actions.settled.fallen_back)
        news = fallen_back - self._reported
        self._reported = fallen_back
        if news:
            self._tell(
                tr("Some of your keys cannot be used here."),
                " ".join(sorted(news)),
                tr("These commands use their default keys. View and change them in All shortcuts."),
            )


_WIDTH_PX = 1120
_BESIDE_FROM_PX = 900


_CELL_PX = 28
_CELL_WIDTHS_PX: dict[Column, int] = {"keys": 148, "driving_keys": 84}
_PUT_BACK_PX = 30


class KeyCell(QAbstractButton):
    """Key caps of one column; a click asks for another key."""

    def __init__(self, theme: Theme, column: Column) -> None:
        super().__init__()
        self._theme = theme
        self.caps: tuple[str, ...] = ()
        self._asks = False
        self.column: Column = column
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)

    def show_caps(self, caps: Iterable[str]) -> None:
        self.caps = tuple(dict.fromkeys(caps))  # both Enter keys read alike
        self.updateGeometry()
        self.update()

    def set_asks(self, asks: bool) -> None:
        """Set whether it waits for a key."""
        self._asks = asks
        self.update()

    def sizeHint(self) -> QSize:
        caps = sum(round(key_cap_width(self._theme, cap)) + 4 for cap in self.caps) + 8
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
        if self._asks or not self.caps:
            words = tr("Press keys…") if self._asks else tr("add") if lit else "–" if self.isEnabled() else ""
            painter.drawText(room, int(Qt.AlignmentFlag.AlignVCenter), words)
            return
        for cap in self.caps:
            left += draw_key_cap(painter, theme, cap, left, self.height() / 2) + 4


class ShortcutRow(QWidget):
    """Row of the sheet. ``wanted(KeyCell)`` asks for another key, ``put_back`` for the default ones."""

    cell_clicked = Signal(object)
    put_back = Signal()

    def __init__(self, theme: Theme, spec: ActionSpec) -> None:
        super().__init__()
        self.spec = spec
        self._words = ElidedLabel()
        self.cells: dict[Column, KeyCell] = {column: KeyCell(theme, column) for column in COLUMNS}
        self._back = ActionButton(
            theme, icon="arrow-counter-clockwise", role="ghost", height_px=_CELL_PX, clicked=self.put_back
        )
        back_room = QWidget()
        back_room.setFixedWidth(_PUT_BACK_PX)
        layouts.hbox(back_room, self._back, margins_px=0)
        layouts.hbox(self, (self._words, 1), *self.cells.values(), back_room, margins_px=0, spacing_px=4)
        for cell in self.cells.values():
            cell.clicked.connect(lambda _checked=False, cell=cell: self.cell_clicked.emit(cell))

    def show_spec(self, spec: ActionSpec, text: str, actions: Actions, keys: WizardKeys) -> None:
        """``spec``: row with its current keys; ``text``: its current text."""
        self.spec = spec
        self._words.setText(text)
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

    def __init__(self, title: str, rows: list[ShortcutRow]) -> None:
        super().__init__()
        self.rows = rows
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Maximum)
        heading = layouts.hbox(None, (label(title, "caption"), 1), spacing_px=4)
        for name, width in (
            (tr("In the list") if rows[0].spec.within == "queue" else tr("Anywhere"), _CELL_WIDTHS_PX["keys"]),
            ("" if rows[0].spec.within else tr("Driving"), _CELL_WIDTHS_PX["driving_keys"]),
        ):
            column = label(name, "note", minimumWidth=width)
            column.setContentsMargins(6, 0, 0, 0)
            heading.addWidget(column)
        heading.addSpacing(_PUT_BACK_PX + 4)
        layouts.vbox(self, heading, *rows, margins_px=(0, 0, 0, 12), spacing_px=0)

    def show_found(self, query: str) -> int:
        """Show only matching rows; returns their number."""
        found = [row for row in self.rows if row.is_found_by(query)]
        for row in self.rows:
            row.setVisible(row in found)
        self.setVisible(bool(found))
        return len(found)


class ShortcutSheet(Overlay):
    """Shortcut sheet of this scenario. Click a key, then press the new one; conflicts are reported at once."""

    def __init__(
        self, theme: Theme, window: QWidget, actions: Actions, keys: WizardKeys, hold: DriveInputFilter
    ) -> None:
        super().__init__(theme, window, width_px=_WIDTH_PX)
        self.setObjectName("shortcut_sheet")
        self._actions = actions
        self._keys = keys
        self._hold = hold
        self._asked: tuple[ShortcutRow, KeyCell] | None = None
        """Line and column that wait for a key."""
        self._doubtful: Keys | None = None
        """Choice that awaits confirmation because other rows have it."""
        self._rows: dict[str, ShortcutRow] = {}
        self._groups: list[ShortcutGroup] = []
        self._sides: tuple[QWidget, ...] = ()
        self._turned = False
        self._ids: list[str] = []
        self._letters = actions.letters
        self._to_build: deque[tuple[QVBoxLayout, str, list[ActionSpec]]] = deque()
        self._building = QTimer(self, interval=0)
        self._building.timeout.connect(self._build_next)
        self._heading = label("", "heading")
        find = tr("Find a command or key")
        self.search = line_edit("shortcut_search", find, placeholderText=find, textChanged=self._show_found)
        self.search.setFixedWidth(260)
        button = partial(ActionButton, theme, height_px=32)
        self._reset_all = button(tr("Reset all keys"), objectName="shortcut_reset_all", clicked=self._on_reset_all)
        top = layouts.hbox(None, (self._heading, 1), self._reset_all, self.search, spacing_px=12)
        self._clashes = label("", "warning", wraps=True, objectName="shortcut_clashes")
        self._nothing = label(tr("No matching entries."), "note", wraps=True, objectName="shortcut_nothing")
        self._scroll = QScrollArea(widgetResizable=True)
        self._scroll.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self._message_label = label(wraps=True, objectName="shortcut_says")
        self._reassign = button(tr("Reassign"), objectName="shortcut_reassign", clicked=self._on_reassign)
        self._remove = button(tr("No key"), objectName="shortcut_remove", clicked=self._on_remove)
        self._leave = button(tr("Cancel"), objectName="shortcut_leave", clicked=self.stop_asking)
        answers = self._reassign, self._remove, self._leave
        below = layouts.hbox(None, (self._message_label, 1), *answers, spacing_px=8)
        parts = top, self._clashes, self._nothing, (self._scroll, 1), below
        layouts.vbox(self.card, *parts, margins_px=(24, 18, 20, 16), spacing_px=8)
        keys.changed.connect(self._on_changed)
        actions.rows_changed.connect(self._on_changed)
        actions.rebuilt.connect(self._on_changed)
        actions.keys_changed.connect(self._on_keys_changed)
        self.stop_asking()

    def open(self) -> None:
        self.search.clear()
        self.stop_asking()
        self._build()
        super().open()
        self.search.setFocus(Qt.FocusReason.OtherFocusReason)

    def step_back(self) -> None:
        """Esc: cancel a key choice first, then close the sheet."""
        if self._asked is not None:
            self.stop_asking()
        else:
            self.close_overlay()

    def close_overlay(self) -> None:
        self.stop_asking()
        self._building.stop()
        self._to_build.clear()
        super().close_overlay()

    def _place(self) -> None:
        super()._place()
        self._arrange_sides()

    def card_height_px(self) -> int:
        return self._window.height()  # all there is; Overlay keeps a margin

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if self._asked is None:
            super().mousePressEvent(event)
        else:
            self.stop_asking()

    # ---- rows

    def _build(self) -> None:
        """Rebuild the rows, one group per turn: all at once would block driving for too long."""
        specs = self._actions.specs
        self._ids = [spec.id for spec in specs]
        groups: dict[str, list[ActionSpec]] = {}
        for spec in specs:
            groups.setdefault(spec.group, []).append(spec)
        inner = QWidget()
        sides = self._columns = layouts.hbox(inner, margins_px=(0, 0, 8, 0), spacing_px=32)
        self._sides = (QWidget(), QWidget())
        left, right = (layouts.vbox(side, margins_px=0, spacing_px=0) for side in self._sides)
        for side, column in ((self._sides[0], left), (self._sides[1], right)):
            column.addStretch(1)
            sides.addWidget(side, 1)
        self._rows, self._groups = {}, []
        self._to_build.clear()
        half, used = (len(specs) + len(groups)) / 2, 0
        for name, group in groups.items():
            self._to_build.append((left if used + len(group) / 2 <= half else right, name, group))
            used += len(group) + 1
        self._scroll.setWidget(inner)
        self._show_rows()
        self._building.start()

    def _build_next(self) -> None:
        if not self._to_build:
            self._building.stop()
            return
        side, name, specs = self._to_build.popleft()
        bound = {spec.id: spec for spec in self._actions.all_specs}
        rows = []
        for spec in specs:
            row = self._rows[spec.id] = ShortcutRow(self._theme, spec)
            row.show_spec(bound.get(spec.id, spec), spec.text, self._actions, self._keys)
            row.cell_clicked.connect(lambda cell, row=row: self.ask_for(row, cell))
            row.put_back.connect(lambda row=row: self._keys.reset(row.spec))
            rows.append(row)
        group = ShortcutGroup(tr(name), rows)
        self._groups.append(group)
        side.insertWidget(side.count() - 1, group)
        self._show_found()

    @property
    def is_built(self) -> bool:
        return not self._to_build

    def _on_changed(self) -> None:
        if not self.isVisible():
            return
        if [spec.id for spec in self._actions.specs] == self._ids:
            self._show_rows()
        else:
            self.stop_asking()
            self._build()

    def _on_keys_changed(self) -> None:
        """Only a changed keyboard layout matters: the sheet shows the keys of every focus."""
        if self._actions.letters != self._letters:
            self._letters = self._actions.letters
            self._on_changed()

    def _show_rows(self) -> None:
        bound = {spec.id: spec for spec in self._actions.all_specs}
        for spec in self._actions.specs:
            if spec.id in self._rows:
                self._rows[spec.id].show_spec(bound[spec.id], spec.text, self._actions, self._keys)
        wizard = self._keys.wizard
        self._heading.setText(tr("All shortcuts of {wizard}").format(wizard=wizard) if wizard else tr("All shortcuts"))
        self._reset_all.setVisible(self._keys.any_changed)
        self._clashes.setText(
            "\n".join(
                tr("“{what}” is not on {key}, because “{act}” uses this key. Give one of them another key.").format(
                    what=phrase.text, key=self._actions.caps(phrase, phrase.keys)[0], act=other.text
                )
                for phrase, other in self._actions.settled.clashes
            )
        )
        self._clashes.setVisible(bool(self._clashes.text()))
        self._show_found()

    def _show_found(self, _text: str = "") -> None:
        found = sum([group.show_found(self.search.text()) for group in self._groups])
        # Move the column with results to the left, where users look first.
        left = any(not group.isHidden() for group in self._groups if group.parentWidget() is self._sides[0])
        self._turned = bool(found) and not left
        self._arrange_sides()
        self._nothing.setVisible(not found and self.is_built)

    def _arrange_sides(self) -> None:
        """Columns side by side, or stacked in a narrow window."""
        if self.card.width() < _BESIDE_FROM_PX:
            self._columns.setDirection(QHBoxLayout.Direction.TopToBottom)
        else:
            beside = QHBoxLayout.Direction.RightToLeft if self._turned else QHBoxLayout.Direction.LeftToRight
            self._columns.setDirection(beside)

    # ---- choosing a key

    def ask_for(self, row: ShortcutRow, cell: KeyCell) -> None:
        """Wait for the new key of this row."""
        self.stop_asking()
        self._asked = row, cell
        cell.set_asks(True)
        self._say(
            tr("Press the new key for “{act}”. Esc leaves the key unchanged.").format(act=row.spec.text),
            remove=bool(getattr(row.spec, cell.column)),
        )
        self._hold.release_all(QT_TR_NOOP("A shortcut is being set"))
        self._hold.captures = self._on_pressed

    def stop_asking(self) -> None:
        if self._asked is not None:
            self._asked[1].set_asks(False)
        self._asked = self._doubtful = None
        self._hold.captures = None
        self._say(
            tr("Click a key to change it. “Driving” applies while Drive, Video or Map has the focus."), waits=False
        )

    def _on_pressed(self, pressed: PressedKey) -> None:
        if self._asked is None:
            return
        spec, column, key = self._asked[0].spec, self._asked[1].column, pressed.key
        if self._doubtful is not None and key == "Return":
            self._on_reassign()
            return
        self._doubtful = None
        if spec.by_position and key.removeprefix("Alt+").count("+") == 0:
            key = pressed.position or key.removeprefix("Alt+")
        rows = self._actions.all_specs
        reason = refusal(spec, column, key, rows, position=pressed.position) if key else tr("That key has no name.")
        if reason:
            self._say(tr("{why} Press another key.").format(why=reason), wrong=True)
            return
        keys = changed(spec, column, key)
        others = {other.id: other for _key, other in owners(rows, spec, keys)}
        safe = [other for other in others.values() if other.kind == "safety"]
        if safe:
            self._say(tr("This key stops the robot. Press another key."), wrong=True)
        elif others:
            self._doubtful = keys
            names = tr(", ", "between names of acts").join(f"“{other.text}”" for other in others.values())
            cap = self._actions.caps(spec, [key])[0]
            self._say(
                tr("{key} is already assigned to {acts}. Reassigning removes it there.").format(key=cap, acts=names),
                wrong=True, reassign=True,
            )  # fmt: skip
        else:
            self._choose(spec, keys)

    def _on_reassign(self) -> None:
        if self._asked is not None and self._doubtful is not None:
            self._choose(self._asked[0].spec, self._doubtful)

    def _on_remove(self) -> None:
        if self._asked is not None:
            spec, column = self._asked[0].spec, self._asked[1].column
            emptied = {"keys": (), "driving_keys": ()} if spec.by_position else {column: ()}
            self._choose(spec, Keys(**({"keys": spec.keys, "driving_keys": spec.driving_keys} | emptied)))

    def _choose(self, spec: ActionSpec, keys: Keys) -> None:
        self.stop_asking()
        self._keys.choose(spec, keys)

    def _on_reset_all(self) -> None:
        self.stop_asking()
        self._keys.reset_all()

    # ---- messages

    def _say(
        self, text: str, *, waits: bool = True, wrong: bool = False, reassign: bool = False, remove: bool = False
    ) -> None:
        self._message_label.setText(text)
        restyle(self._message_label, tone="amber" if wrong else "text" if waits else "dim")
        self._reassign.setVisible(reassign)
        self._reassign.set_key("Enter" if reassign else "")
        self._remove.setVisible(remove)
        self._leave.setVisible(waits)
