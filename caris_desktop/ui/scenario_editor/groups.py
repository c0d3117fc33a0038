"""Form containers: groups of keys, lists of entries, alternative groups.

In one file because containers nest in one another: separate modules would import in a circle.
"""

import math
from collections.abc import Callable
from typing import Any

from PySide6.QtCore import Qt, QTimer
from PySide6.QtGui import QKeyEvent, QPaintEvent
from PySide6.QtWidgets import QLabel, QSizePolicy, QVBoxLayout, QWidget

from caris_desktop.domain.key_path import KeyPath
from caris_desktop.domain.schema_fields import Group, Key, ValueForm, is_group, keys_of
from caris_desktop.domain.schema_labels import noun_of, said_of, section_of, title_of, words_of
from caris_desktop.domain.schema_paths import ABSENT, blank_group, blank_of, default_of, entry_name, text_key, value_at
from caris_desktop.domain.translation import tr
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.action_rows import ACTIONS
from caris_desktop.ui.scenario_editor.editing_context import FormContext, readable, sentence_at
from caris_desktop.ui.scenario_editor.value_fields import ChoiceField, Field, FormPart, NumberField, field_for
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.drop_down import DropDown
from caris_desktop.ui.widgets.key_cap import KeyCap

_MORE_PX = 104
_ROWS_AT_ONCE = 4
_CAP_COLUMN_PX: dict[str | int, int] = {"phrases": 34, "places": 48}


def part_for(context: FormContext, path: KeyPath, key: Key) -> FormPart:
    """Create the form widget for a key of a group."""
    form = key.form
    if form.item is not None:
        return ListPart(context, path, form, key)
    grouped = is_group(form.kind) or bool(form.alternatives)
    if grouped and default_of(key) is ABSENT and not key.required:
        return OptionalGroup(context, path, form, key)
    if is_group(form.kind):
        return GroupPart(context, path, form, key)
    if form.alternatives:
        return OneOfGroups(context, path, form, key)
    return field_for(context, path, form, key)


class _Holder(FormPart):
    """Container with title, help and error message."""

    def __init__(
        self, context: FormContext, path: KeyPath, form: ValueForm, key: Key | None, help_text: str = ""
    ) -> None:
        super().__init__(context, path)
        self.form = form
        self.key = key
        self.title = title_of(key) if key is not None else ""
        # The page already has this title.
        headed = key is not None and self.title == section_of(key)
        self.context = context if headed else context.inside(self.title)
        self.parts: list[FormPart] = []
        self.column = layouts.vbox(self, margins_px=0, spacing_px=12)
        self.title_label = QLabel(self.title)
        self.help_label = QLabel(readable(help_text))
        self.mistake_label = QLabel()
        self.mistake_label.setObjectName("mistake")
        for label in (self.help_label, self.mistake_label):
            label.setWordWrap(True)
        head = layouts.vbox(spacing_px=2)
        for label in (self.title_label, self.help_label, self.mistake_label):
            head.addWidget(label)
        self.column.addLayout(head)
        # A label shown before it has its font would lose the font in the window.
        if not self.title or headed:
            self.title_label.hide()
        if not help_text or headed:
            self.help_label.hide()
        self.mistake_label.hide()
        context.theme.changed.connect(self.style_texts)
        self.style_texts()

    def style_texts(self) -> None:
        theme = self.context.theme
        self.title_label.setFont(theme.font(tokens.BODY_PX + 1, tokens.WEIGHT_SEMIBOLD))
        for label, role in ((self.help_label, "dim"), (self.mistake_label, "red")):
            theme.style_text(label, role, tokens.STATUS_PX)

    def refresh(self) -> None:
        for part in self.parts:
            part.refresh()
        mistakes = self.context.editing.mistakes_at(self.path)
        if mistakes or not self.mistake_label.isHidden():
            self.mistake_label.setText("\n".join(sentence_at(mistake, self.title) for mistake in mistakes))
            self.mistake_label.setVisible(bool(mistakes))

    def reveal(self, path: KeyPath) -> Field | None:
        if path[: len(self.path)] != self.path:
            return None
        for part in self.parts:
            if path[: len(part.path)] == part.path:
                return part.reveal(path)
        return None

    @property
    def value(self) -> Any:
        return self.context.editing.document.value(self.path)


class GroupPart(_Holder):
    """Keys of a group, one below another. Dependent keys are shown while permitted."""

    def __init__(
        self, context: FormContext, path: KeyPath, form: ValueForm, key: Key | None = None, group: Group | None = None
    ) -> None:
        self.group: Group = form.kind if group is None else group
        super().__init__(context, path, form, key, said_of(form) if key is not None else "")
        self._keys = keys_of(self.group)
        for each in self._keys:
            part = part_for(self.context, (*path, each.name), each)
            self.parts.append(part)
            self.column.addWidget(part)

    def refresh(self) -> None:
        data = self.value
        for key, part in zip(self._keys, self.parts, strict=True):
            stands = may_stand(key, data) or value_at(data, (key.name,)) is not ABSENT
            if part.isHidden() is stands:
                part.setVisible(stands)
        super().refresh()


def may_stand(key: Key, data: Any) -> bool:
    """Whether the schema permits the key given the others."""
    rule = key.form.rule
    if any(value_at(data, (other,)) is not ABSENT for other in rule.instead_of):
        return False
    if not rule.beside:
        return True
    other, *words = rule.beside
    found = value_at(data, (other,))
    return found in words if words else found not in (ABSENT, "")


class OptionalGroup(_Holder):
    """Group that is optional as a whole."""

    def __init__(self, context: FormContext, path: KeyPath, form: ValueForm, key: Key) -> None:
        super().__init__(context, path, form, key, said_of(form))
        self._button = ActionButton(context.theme, icon="plus")
        self._button.clicked.connect(self._on_clicked)
        self.column.addWidget(self._button)

    @property
    def there(self) -> bool:
        return self.value is not ABSENT

    def _on_clicked(self) -> None:
        editing = self.context.editing
        editing.replace(self.path, ABSENT if self.there else blank_of(self.form))

    def enter(self, _value: Any) -> None:
        self._button.click()

    def refresh(self) -> None:
        if self.there and not self.parts:
            kind = GroupPart if is_group(self.form.kind) else OneOfGroups
            part = kind(self.context, self.path, self.form)
            self.parts.append(part)
            self.column.addWidget(part)
            show_at_once(part)
        elif not self.there and self.parts:
            drop(self.parts.pop())
        words = tr("Remove: {title}") if self.there else tr("Add: {title}")
        self._button.set_label(words.format(title=self.title), icon="x" if self.there else "plus")
        super().refresh()

    def reveal(self, path: KeyPath) -> Field | None:
        if path == self.path:
            return self  # type: ignore[return-value]  # it is entered as a field is
        return super().reveal(path)


class OneOfGroups(_Holder):
    """Alternative groups, with the choice above the keys."""

    def __init__(self, context: FormContext, path: KeyPath, form: ValueForm, key: Key | None = None) -> None:
        super().__init__(context, path, form, key, said_of(form) if key is not None else "")
        self._groups = form.alternatives
        self._visible_group: Group | None = None
        self._kind = DropDown(context.theme, "", self.context.spoken(tr("Kind")))
        self._kind.setSizeAdjustPolicy(DropDown.SizeAdjustPolicy.AdjustToContents)
        self._kind.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        for group in self._groups:
            self._kind.addItem(words_of(group))
        self._kind.activated.connect(self._on_chosen)
        self.column.addWidget(self._kind)

    def _on_chosen(self, index: int) -> None:
        group = self._groups[index]
        if group is not self.form.group_at(self.value):
            self.context.editing.replace(self.path, blank_group(group))

    def refresh(self) -> None:
        group = self.form.group_at(self.value)
        if group is not self._visible_group:
            self._visible_group = group
            while self.parts:
                drop(self.parts.pop())
            part = GroupPart(self.context, self.path, self.form, group=group)
            self.parts.append(part)
            self.column.addWidget(part)
            show_at_once(part)
            self._kind.setCurrentIndex(self._groups.index(group))
        super().refresh()


class ListPart(_Holder):
    """List of entries with buttons to move and remove each, and a button per kind of entry to add."""

    def __init__(self, context: FormContext, path: KeyPath, form: ValueForm, key: Key) -> None:
        super().__init__(context, path, form, key, said_of(form))
        item = form.item
        if item is None:
            raise TypeError(f"{path} is no list")
        self.item = item
        self.rows: list[EntryRow] = []
        self._stale = True
        self._more_rows = QTimer(self, singleShot=True, interval=0)
        self._more_rows.timeout.connect(self.refresh)
        self._box = layouts.vbox(spacing_px=8)
        self.column.addLayout(self._box)
        least, most = form.size
        self.fixed = least == most
        self._most = most
        self._adders: list[ActionButton] = []
        buttons = layouts.hbox(spacing_px=8)
        for words, blank in kinds_of_entries(item):
            button = ActionButton(context.theme, tr("Add {what}").format(what=words), icon="plus", height_px=30)
            button.setObjectName(f"add_{'_'.join(map(str, path))}_{len(self._adders)}")
            button.setAccessibleName(self.context.spoken(button.text()))
            button.clicked.connect(self._adder(blank))
            buttons.addWidget(button)
            self._adders.append(button)
        buttons.addStretch(1)
        if not self.fixed:
            self.column.addLayout(buttons)
        context.editing.reshaped.connect(self._on_reshaped)

    @property
    def entries(self) -> list[Any]:
        value = self.value
        return value if isinstance(value, list) else []

    def _on_reshaped(self) -> None:
        self._stale = True

    def _adder(self, blank: Callable[[], Any]) -> Callable[[], None]:
        return lambda: self.add_entry(blank())

    def add_entry(self, entry: Any) -> None:
        place = len(self.entries)
        self.context.editing.add((*self.path, place), entry)
        self._focus_row(place)

    def reveal(self, path: KeyPath) -> Field | None:
        self.complete()
        return super().reveal(path)

    def _focus_row(self, place: int) -> None:
        self.complete()
        if 0 <= place < len(self.rows):
            self.rows[place].unfold()
            self.rows[place].focus_first()

    def move_entry(self, index: int, by: int) -> None:
        if 0 <= index + by < len(self.entries):
            self.context.editing.move((*self.path, index), index + by)
            self._focus_row(index + by)

    def remove_entry(self, index: int) -> None:
        self.context.editing.remove((*self.path, index))
        self._focus_row(min(index, len(self.rows) - 1))

    def refresh(self) -> None:
        entries = self.entries
        kinds = [self.item.group_at(entry) if not isinstance(entry, str) else str for entry in entries]
        if self._stale or len(kinds) != len(self.rows):
            self._rebuild(kinds)
        for button in self._adders:
            button.setEnabled(self._most is None or len(entries) < self._most)
        super().refresh()

    def _rebuild(self, kinds: list[Any]) -> None:
        """Rebuild rows, reusing those of unchanged kind. Long lists are built a few rows per turn, so that keys are
        still handled.
        """
        while len(self.rows) > len(kinds):
            drop(self.rows.pop())
            self.parts.pop()
        made = 0
        for number, kind in enumerate(kinds):
            row = self.rows[number] if number < len(self.rows) else None
            if row is not None and row.suits(kind):
                continue
            made += 1
            if made > _ROWS_AT_ONCE:
                self._more_rows.start()
                break
            fresh = EntryRow(self, number, kind if kind is not str else None)
            if row is not None:
                self._box.replaceWidget(row, fresh)
                drop(row)
                self.rows[number] = self.parts[number] = fresh
            else:
                self._box.addWidget(fresh)
                self.rows.append(fresh)
                self.parts.append(fresh)
            show_at_once(fresh)
        else:
            self._stale = False

    def complete(self) -> None:
        """Create all rows now."""
        while self._stale or len(self.rows) < len(self.entries):
            self.refresh()


class EntryRow(FormPart):
    """List entry: a row if small, else a foldable card."""

    def __init__(self, holder: ListPart, index: int, group: Group | None) -> None:
        super().__init__(holder.context.inside(tr("entry {number}").format(number=index + 1)), (*holder.path, index))
        self._holder = holder
        self._index = index
        self._form = holder.item
        self._text = holder.item.text is not None
        self._group = holder.item.group_at("") if group is None and self._text else group
        self._is_text_group = self._text and self._group is holder.item.group_at("")
        self._in_row = self._group is None or in_one_row(self._group) or self._is_text_group
        self._folds = not self._in_row
        self._open = False
        self._body: FormPart | None = None
        self.fields: list[Field] = []
        self._more: QWidget | None = None
        self._mistake: QLabel | None = None
        self._robot_button: RobotHere | None = None
        self._column = QVBoxLayout(self)
        self._column.setContentsMargins(12, 10, 8, 10) if self._folds else self._column.setContentsMargins(0, 0, 0, 0)
        self._column.setSpacing(8)
        self._head = layouts.hbox(spacing_px=6)
        self._column.addLayout(self._head)
        self._make_cap()
        if self._folds:
            self._make_card_head()
        else:
            self._make_row()
        self._make_buttons()
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Maximum)
        self.context.theme.changed.connect(self._style)
        self._style()

    def suits(self, kind: Any) -> bool:
        if kind is str or (self._is_text_group and kind is self._group):
            return self._is_text_group or self._group is None
        return kind is self._group and not self._is_text_group

    # ---- construction

    def _make_cap(self) -> None:
        """Create a column for the entry's key in the console."""
        data = self.context.editing.document.data
        key = key_of_entry(data, self.path)
        if not key and (self._folds or not key_of_entry(data, (*self._holder.path, 0))):
            return
        holder = QWidget()
        holder.setFixedWidth(_CAP_COLUMN_PX.get(self.path[0], 64))
        inside = layouts.hbox(holder, margins_px=(0, 7, 0, 7))
        inside.addWidget(KeyCap(self.context.theme, key))
        inside.addStretch(1)
        self._head.addWidget(holder, 0, Qt.AlignmentFlag.AlignBottom)

    def _make_card_head(self) -> None:
        self._fold = ActionButton(self.context.theme, icon="caret-right", role="ghost", may_shrink=True, semibold=True)
        self._fold.clicked.connect(self._on_fold)
        self._head.addWidget(self._fold, 1)
        self._head.addStretch(1)

    def _make_row(self) -> None:
        if self._group is None:
            field = field_for(self.context, self.path, self._form, None, compact=True)
            short = isinstance(field, (NumberField, ChoiceField))
            self._add_field(field, 0 if short else 1)
            return
        first, *others = keys_of(self._group)
        if not self._is_text_group:
            for key in (first, *others):
                stretch = 0 if key.form.scalars in ((float,), (int,)) else 1
                self._add_field(field_for(self.context, (*self.path, key.name), key.form, key, compact=True), stretch)
            if self._index:
                for field in self.fields:
                    field.without_title()
            if {key.name for key in keys_of(self._group)} >= POSE_KEYS:
                self._robot_button = RobotHere(self.context, self.path)
                self._head.addWidget(self._robot_button, 0, Qt.AlignmentFlag.AlignBottom)
            return
        say = field_for(self.context, (*self.path, first.name), first.form, first, compact=True)
        say.without_title()
        self._add_field(say, 1)
        self._unfold = ActionButton(
            self.context.theme, tr("More"), icon="caret-right", role="ghost", height_px=32, text_px=tokens.STATUS_PX,
            may_shrink=True,
        )  # fmt: skip
        self._unfold.setFixedWidth(_MORE_PX)
        self._unfold.clicked.connect(self._on_more)
        self._head.addWidget(self._unfold, 0, Qt.AlignmentFlag.AlignBottom)
        self._others = others

    def _add_field(self, field: Field, stretch: int) -> None:
        self.fields.append(field)
        self._head.addWidget(field, stretch, Qt.AlignmentFlag.AlignBottom)

    def _make_buttons(self) -> None:
        if self._holder.fixed:
            return
        name = self.context.within
        buttons = layouts.hbox(spacing_px=0)
        for icon, words, do in (
            ("arrow-up", tr("Move up: {what}"), lambda: self._holder.move_entry(self._index, -1)),
            ("arrow-down", tr("Move down: {what}"), lambda: self._holder.move_entry(self._index, 1)),
            ("x", tr("Remove: {what}"), lambda: self._holder.remove_entry(self._index)),
        ):
            button = ActionButton(self.context.theme, icon=icon, role="ghost", height_px=30)
            button.setAccessibleName(words.format(what=name))
            button.setToolTip(words.format(what=name))
            button.clicked.connect(do)
            buttons.addWidget(button, 0, Qt.AlignmentFlag.AlignBottom)
        self._head.addLayout(buttons)
        if not self._folds and len(self.fields) == 1 and isinstance(self.fields[0], (NumberField, ChoiceField)):
            self._head.addStretch(1)

    # ---- display

    def refresh(self) -> None:
        document = self.context.editing.document
        data = document.value(self.path)
        for field in self.fields:
            field.refresh()
        if self._folds:
            self._refresh_card(data)
        if self._is_text_group:
            self._refresh_more(data)
        mistakes = self.context.editing.mistakes_at(self.path) if self._group is not None else []
        self._show_mistakes("\n".join(sentence_at(mistake, "") for mistake in mistakes))
        if self._robot_button is not None:
            self._robot_button.refresh()

    def _show_mistakes(self, message: str) -> None:
        if self._mistake is None:
            if not message:
                return
            self._mistake = QLabel(wordWrap=True)
            self._mistake.setObjectName("mistake")
            self._column.addWidget(self._mistake)
            self._style()
        self._mistake.setText(message)
        self._mistake.setVisible(bool(message))

    def _refresh_card(self, data: Any) -> None:
        name = card_name(data) or tr("Entry {number}").format(number=self._index + 1)
        wrong = len(self.context.editing.mistakes_within(self.path))
        label = tr("{name} · errors: %n", "", wrong).format(name=name) if wrong else name
        self._fold.set_label(label, icon="caret-down" if self._open else "caret-right")
        self._fold.setAccessibleName(self.context.spoken(label))
        if self._body is not None:
            self._body.refresh()

    def _refresh_more(self, data: Any) -> None:
        values = [value_at(data, (key.name,)) for key in self._others]
        there = " · ".join(value for value in values if isinstance(value, str) and value)
        words, caret = (tr("Less"), "caret-down") if self._open else (there or tr("More"), "caret-right")
        self._unfold.set_label(words, icon=caret)
        self._unfold.setAccessibleName(self.context.spoken(words))
        if self._more is not None:
            self._more.setVisible(self._open)

    # ---- folding

    def unfold(self) -> None:
        if self._folds and not self._open:
            self._on_fold()

    def _on_fold(self) -> None:
        self._open = not self._open
        if self._open and self._body is None:
            self._body = self._make_body()
            self._column.insertWidget(1, self._body)
        if self._body is not None:
            self._body.setVisible(self._open)
        self.refresh()

    def _make_body(self) -> FormPart:
        if self._group is not None and (self._form.text is not None or is_group(self._form.kind)):
            return GroupPart(self.context, self.path, self._form, group=self._group)
        return OneOfGroups(self.context, self.path, self._form)

    def _on_more(self) -> None:
        self._open = not self._open
        if self._open and self._more is None:
            self._more = QWidget()
            row = layouts.hbox(self._more, margins_px=(36, 0, 0, 4), spacing_px=12)
            for key in self._others:
                field = field_for(self.context, (*self.path, key.name), key.form, key, compact=True)
                self.fields.append(field)
                row.addWidget(field, 1, Qt.AlignmentFlag.AlignTop)
            self._column.insertWidget(1, self._more)
        self.refresh()

    def reveal(self, path: KeyPath) -> Field | None:
        further = self._is_text_group and len(path) > len(self.path) and path[-1] != text_key(self._group)
        if further and not self._open:
            self._on_more()
        if self._folds:
            if not self._open:
                self._on_fold()
            return self._body.reveal(path) if self._body is not None else None
        if path == self.path and self.fields:
            return self.fields[0]
        return next((field for field in self.fields if field.path == path), None)

    def focus_first(self) -> None:
        first = self.fields[0].control if self.fields else None
        if first is None and isinstance(self._body, _Holder):
            first = next((part.control for part in self._body.parts if isinstance(part, Field)), None)
        if first is None and self._folds:
            first = self._fold
        if first is not None:
            first.setFocus(Qt.FocusReason.OtherFocusReason)

    # ---- keyboard and style

    def keyPressEvent(self, event: QKeyEvent) -> None:
        ctrl = event.modifiers() & ~Qt.KeyboardModifier.KeypadModifier == Qt.KeyboardModifier.ControlModifier
        if ctrl and event.key() in (Qt.Key.Key_Up, Qt.Key.Key_Down) and not self._holder.fixed:
            self._holder.move_entry(self._index, -1 if event.key() == Qt.Key.Key_Up else 1)
            event.accept()
            return
        plain = event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter) and not event.modifiers()
        if plain and self._in_row and not self._holder.fixed:
            entry = kinds_of_entries(self._form)[0][1]()
            self.context.editing.add((*self._holder.path, self._index + 1), entry)
            self._holder._focus_row(self._index + 1)
            event.accept()
            return
        super().keyPressEvent(event)

    def _style(self) -> None:
        if self._mistake is not None:
            self.context.theme.style_text(self._mistake, "red", tokens.STATUS_PX)
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        if not self._folds:
            return
        self.context.theme.paint_box(self, ground="panel", line="line", radius_px=tokens.CONTROL_RADIUS_PX)


_KEYS = {spec.id: spec.keys[0] for spec in ACTIONS if spec.keys}


def key_of_entry(data: Any, path: KeyPath) -> str:
    """Key bindings of list entries in the console, for display in the form.

    Key of the entry; empty if none.
    """
    match path:
        case ("phrases", int(index)):
            entries = value_at(data, ("phrases",))
            if not isinstance(entries, list) or not 0 <= index < len(entries) or "group" in _keys_in(entries[index]):
                return ""
            return _KEYS.get(f"phrase_{sum('group' not in _keys_in(each) for each in entries[: index + 1])}", "")
        case ("phrases", int(), "phrases", int(index)):
            return _KEYS.get(f"phrase_{index + 1}", "")
        case ("recording", "labels", int(index)):
            return _KEYS.get(f"label_{index + 1}", "")
        case ("gestures", int(index)):
            key = _keys_in(value_at(data, path)).get("key")
            return str(key) if key else _KEYS.get(f"gesture_{index + 1}", "")
        case ("places", int(index)):
            return _KEYS.get(f"place_{index + 1}", "")
    return ""


def _keys_in(entry: Any) -> Any:
    return entry if isinstance(entry, dict) else {}


_MOST_IN_A_ROW = 5


def card_name(entry: Any) -> str:
    """Title of a folded entry: its name, else its contents, as for a part of the dock layout."""
    if not isinstance(entry, dict):
        return entry if isinstance(entry, str) else ""
    if entry_name(entry):
        return entry_name(entry)
    inside = [card_name(each) for value in entry.values() if isinstance(value, list) for each in value]
    return ", ".join(name for name in inside if name) or next(
        (str(value) for value in entry.values() if isinstance(value, str)), ""
    )


def in_one_row(group: Group) -> bool:
    """Whether the keys are few and short enough for one row."""
    keys = keys_of(group)
    return len(keys) <= _MOST_IN_A_ROW and all(
        key.form.scalars and not key.form.rule.prose and not key.form.is_free for key in keys
    )


def kinds_of_entries(item: ValueForm) -> list[tuple[str, Callable[[], Any]]]:
    """Kinds of entries that can be added, with factories of initial values."""
    groups = item.groups
    if not groups:
        return [(tr("an entry"), lambda: blank_of(item))]
    text = item.text
    kinds: list[tuple[str, Callable[[], Any]]] = []
    for number, group in enumerate(groups):
        blank: Callable[[], Any] = (lambda: "") if text is not None and number == 0 else _blank_of_group(item, group)
        kinds.append((noun_of(group), blank))
    return kinds


def _blank_of_group(item: ValueForm, group: Group) -> Callable[[], Any]:
    return (lambda: blank_of(item)) if is_group(item.kind) else (lambda: blank_group(group))


POSE_KEYS = {"x_m", "y_m", "heading_deg"}
"""Keys of a group that is a pose in the map."""


class RobotHere(ActionButton):
    """Button that sets a place to the robot's current pose.

    Button for the group at ``path``.
    """

    def __init__(self, context: FormContext, path: KeyPath) -> None:
        super().__init__(context.theme, tr("Here"), icon="robot", height_px=32, text_px=tokens.STATUS_PX)
        self._context = context
        self._path = path
        self.setObjectName("place_from_robot")
        self.setAccessibleName(context.spoken(tr("Use the robot's current position")))
        self.clicked.connect(self._use_position)

    def refresh(self) -> None:
        known = self._context.robot_pose() is not None
        self.setEnabled(known)
        where = tr("Use the robot's current position and heading")
        self.setToolTip(where if known else tr("The robot's position in the map is unknown"))

    def _use_position(self) -> None:
        pose = self._context.robot_pose()
        if pose is None:
            return
        document = self._context.editing.document
        document.pause()
        for name, value in (
            ("x_m", round(pose.x_m, 2)),
            ("y_m", round(pose.y_m, 2)),
            ("heading_deg", round(math.degrees(pose.heading_rad))),
        ):
            document.set((*self._path, name), value)
        self._context.editing.emit_changes()


def drop(part: QWidget) -> None:
    """Remove and delete a form widget."""
    part.hide()
    part.setParent(None)
    part.deleteLater()


def show_at_once(part: QWidget) -> None:
    """Show a new form widget now: Qt shows it only with the next event, and a hidden one cannot be focused."""
    parent = part.parentWidget()
    if parent is not None and parent.isVisible():
        part.show()
