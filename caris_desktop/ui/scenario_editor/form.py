"""Form of a scenario, made from the schema: fields by kind of value, groups and lists, nested."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from html import escape
from typing import Any

from PySide6.QtCore import QEvent, QObject, QSignalBlocker, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QKeyEvent, QKeySequence, QResizeEvent
from PySide6.QtWidgets import QLabel, QLineEdit, QPlainTextEdit, QSizePolicy, QWidget

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.schema_fields import (
    Group,
    Key,
    KeyPath,
    Known,
    ValueForm,
    is_group,
    keys_of,
    name_of,
    plain_number,
)
from caris_desktop.domain.schema_paths import (
    ABSENT,
    allowed_by,
    blank_group,
    blank_of,
    default_of,
    entry_name,
    noun_of,
    said_of,
    section_of,
    text_key,
    title_of,
    unit_of,
    value_at,
    word_of,
    words_of,
)
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.domain.yaml_files import parse_yaml, yaml_text
from caris_desktop.scenario.document import Mistake
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.action_bindings import cap_text
from caris_desktop.ui.action_rows import ACTIONS
from caris_desktop.ui.scenario_editor.saving import EditedDocument
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.inputs import CheckBox, DropDown, KeyCommandEdit
from caris_desktop.ui.widgets.labels import KeyCap, named, restyle

_MORE_PX = 104
_ROWS_AT_ONCE = 4
_MOST_IN_A_ROW = 5
_CAP_COLUMN_PX: dict[str | int, int] = {"phrases": 34, "places": 48}
_PROSE_LINES = (3, 14)
_POSE_KEYS = {"x_m", "y_m", "heading_deg"}
"""Keys of a group that is a pose in the map."""
_SHORT_UNITS = {"metres": "m", "degrees": "°", "seconds": "s", "minutes": "min", "pixels": "px"}
_BOTTOM, _TOP = Qt.AlignmentFlag.AlignBottom, Qt.AlignmentFlag.AlignTop
_BY_PROGRAM = Qt.FocusReason.OtherFocusReason


class Names(Value):
    """Known names; ``all_of_them``: any other name does not exist."""

    names: tuple[str, ...] = ()
    all_of_them: bool = False


class InputKeys(QObject):
    """Event filter of the text inputs of a document: undo is the document's, Ctrl+Up and Ctrl+Down move the entry, and
    leaving an input ends an undo step.
    """

    def __init__(self, document: EditedDocument, parent: QObject) -> None:
        super().__init__(parent)
        self._document = document

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if event.type() == QEvent.Type.FocusOut:
            self._document.pause()
        elif isinstance(event, QKeyEvent) and event.type() != QEvent.Type.KeyRelease:
            undoes = event.matches(QKeySequence.StandardKey.Undo) or event.matches(QKeySequence.StandardKey.Redo)
            if undoes or (isinstance(watched, QLineEdit) and _moves_entry(event)):
                event.ignore()  # goes on to the entry and the window
                return True
        return False


def _moves_entry(event: QKeyEvent) -> bool:
    ctrl = event.modifiers() & ~Qt.KeyboardModifier.KeypadModifier == Qt.KeyboardModifier.ControlModifier
    return ctrl and event.key() in (Qt.Key.Key_Up, Qt.Key.Key_Down)


class FormContext(Value):
    """Context of the form's widgets. ``robot_pose``: current map pose or None; ``known``: existing names of a kind.
    ``within``: titles of the enclosing parts, innermost first, for screen readers.
    """

    theme: Theme
    document: EditedDocument
    input_keys: InputKeys
    robot_pose: Callable[[], Pose2D | None]
    known: Callable[[Known], Names]
    within: str = ""

    def inside(self, title: str) -> "FormContext":
        """Context for parts within an enclosing title."""
        return replace(self, within=self.spoken(title)) if title else self

    def spoken(self, name: str) -> str:
        """Accessible name of a field."""
        return f"{name}, {self.within}" if self.within else name


class FormPart(QWidget):
    """Form widget for one path of the file, with the errors there and the parts inside."""

    def __init__(
        self, context: FormContext, path: KeyPath, form: ValueForm, key: Key | None = None, *, spacing_px: int
    ) -> None:
        super().__init__()
        self.context = context
        self.document = context.document
        self.path = path
        self.form = form
        self.key = key
        self.title = title_of(key) if key is not None else ""
        self.parts: Sequence[FormPart] = ()
        self.column = self.texts = layouts.vbox(self, margins_px=0, spacing_px=spacing_px)
        self.mistake = ""
        self._mistake_label: QLabel | None = None

    def add_text(self, text: str, style: str) -> QLabel:
        label = named(QLabel(text, wordWrap=True), style)
        self.texts.addWidget(label)
        return label

    def refresh(self) -> None:
        """Show the document's current value."""
        for part in self.parts:
            part.refresh()
        self.show_mistakes()

    def show_mistakes(self) -> None:
        here = (each for each in self.document.mistakes if each.path == self.path)
        self.mistake = "\n".join(_sentence_at(mistake, self.title) for mistake in here)
        if self._mistake_label is None and self.mistake:
            self._mistake_label = self.add_text("", "mistake")
        if self._mistake_label is not None:
            self._mistake_label.setText(self.mistake)
            self._mistake_label.setVisible(bool(self.mistake))

    def reveal(self, path: KeyPath) -> "FormPart | None":
        """Part where the value of a path is entered, created and unfolded."""
        return next((part.reveal(path) for part in self.parts if path[: len(part.path)] == part.path), None)

    def enter(self, value: Any) -> None:
        """Enter a value as a user would."""
        raise NotImplementedError


def _sentence_at(mistake: Mistake, title: str) -> str:
    """Error message at its own field, without the full path."""
    named, text = name_of(mistake.path), mistake.message
    if text.startswith(named):
        text = f"“{title}”{text[len(named) :]}"
    return text[:1].upper() + text[1:]


def readable(text: str) -> str:
    """Schema text with quotes in place of code marks."""
    pieces = text.split("`")
    return "".join(piece if number % 2 == 0 else f"“{piece}”" for number, piece in enumerate(pieces))


def help_of(form: ValueForm) -> str:
    """Help text below a field: meaning and permitted values."""
    rule = form.rule
    parts = [readable(said_of(form))]
    if rule.allowed:
        parts.append(tr("Allowed: {allowed}").format(allowed=readable(allowed_by(form))))
    least, most = rule.at_least, rule.at_most
    if least is not None and most is not None:
        parts.append(tr("From {least} to {most}.").format(least=f"{least:g}", most=f"{most:g}"))
    elif rule.more_than is not None and most is not None:
        parts.append(tr("More than {least}, up to {most}.").format(least=f"{rule.more_than:g}", most=f"{most:g}"))
    return " ".join(part for part in parts if part)


# ---- fields of single values


class Field(FormPart):
    """Field of a single value, with title and help. ``compact``: for rows, with help in the tooltip only."""

    names_itself = False
    """Whether the control shows the title."""

    def __init__(
        self, context: FormContext, path: KeyPath, form: ValueForm, key: Key | None = None, *, compact: bool = False
    ) -> None:
        super().__init__(context, path, form, key, spacing_px=4)
        self.compact = compact
        self.help = help_of(form)
        self.remark = ""
        self.may_be_left_out = key is not None and not key.required
        self.default = ABSENT if key is None else default_of(key)
        self.setObjectName("field_" + "_".join(map(str, path)))
        self.control, shown = self.make()
        self.setFocusProxy(self.control)
        self._back: ActionButton | None = None
        self._title_label: QLabel | None = None
        self._head = layouts.hbox(spacing_px=6)
        self.column.addLayout(self._head)
        if self.title and not self.names_itself:
            unit = _SHORT_UNITS.get(form.rule.unit, "") if compact else ""
            title = QLabel(f"{self.title} ({unit})" if unit else self.title)
            self._title_label = named(title, "row_title" if compact else "field_title")
            self._title_label.setBuddy(self.control)
            layouts.fill(self._head, self._title_label, 1)
            self.column.addWidget(shown)
        else:
            self._head.addWidget(shown, 1)
        if compact:
            self.control.setToolTip(self.help)
        elif self.help:
            self.add_text(self.help, "switch_help" if self.names_itself else "help")
        name = self.title or tr("Entry")
        self.control.setAccessibleName(context.spoken(f"{name} ({unit_of(form)})" if form.rule.unit else name))

    def make(self) -> tuple[QWidget, QWidget]:
        """Create the control that gets the focus, and the widget that contains it."""
        raise NotImplementedError

    def show_value(self, value: Any) -> None:
        raise NotImplementedError

    def without_title(self) -> None:
        """Hide the title in a table with column headings."""
        if self._title_label is not None:
            self._title_label.hide()

    def reveal(self, path: KeyPath) -> FormPart | None:
        return self if path == self.path else None

    def refresh(self) -> None:
        self.show_value(self.document.value(self.path))
        self.show_mistakes()
        # A screen reader reads the error at the field, not only on leaving it.
        self.control.setAccessibleDescription(" ".join(filter(None, (self.mistake, self.help, self.remark))))
        changed = value_at(self.document.saved_data, self.path) != value_at(self.document.data, self.path)
        if not self.compact and (changed or self._back is not None):
            if self._back is None:
                back = ActionButton(self.context.theme, icon="arrow-counter-clockwise", role="ghost", height_px=22)
                as_saved = tr("{title}: restore the saved value").format(title=self.title or tr("Entry"))
                back.setAccessibleName(self.context.spoken(as_saved))
                back.setToolTip(tr("Restore the saved value"))
                back.clicked.connect(self._restore_saved)
                self._head.insertWidget(1, back)
                self._back = back
            self._back.setVisible(changed)

    def _restore_saved(self) -> None:
        saved = value_at(self.document.saved_data, self.path)
        self.document.replace(self.path, self.default if saved is ABSENT else saved)


class Prose(QPlainTextEdit):
    """Multi-line edit that grows with its text, with the interface of a QLineEdit. Tab moves on."""

    textEdited = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.setTabChangesFocus(True)
        self.setUndoRedoEnabled(False)
        self.textChanged.connect(self.updateGeometry)
        self.textChanged.connect(self.textEdited)

    def text(self) -> str:
        return self.toPlainText()

    def setText(self, text: str) -> None:
        with QSignalBlocker(self):
            self.setPlainText(text)
        self.updateGeometry()

    def insert(self, text: str) -> None:
        self.insertPlainText(text)

    def sizeHint(self) -> QSize:
        least, most = _PROSE_LINES
        lines = max(least, min(most, round(self.document().size().height())))
        return QSize(240, lines * self.fontMetrics().lineSpacing() + 26)

    def minimumSizeHint(self) -> QSize:
        return QSize(120, self.sizeHint().height())

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self.updateGeometry()


class TextField(Field):
    """Value typed in one line, or several: text, a number with its unit, or YAML. Invalid text stays as it is."""

    control: QLineEdit | Prose

    def make(self) -> tuple[QWidget, QWidget]:
        self._known: QLabel | None = None
        self.control = control = self.make_input()
        control.installEventFilter(self.context.input_keys)
        control.textEdited.connect(lambda: self.document.set(self.path, self.read(control.text())))
        if kind_of(self.form) != "number" or self.compact:
            return control, control
        holder = QWidget()
        layouts.hbox(holder, control, named(QLabel(unit_of(self.form)), "help"), 1, margins_px=0, spacing_px=8)
        return control, holder

    def make_input(self) -> QLineEdit | Prose:
        if self.form.rule.prose or self.form.is_free:
            return Prose()
        line = QLineEdit(placeholderText=self.default if isinstance(self.default, str) else "")
        line.setMinimumHeight(tokens.CONTROL_HEIGHT_PX)
        if kind_of(self.form) == "number":
            line.setMaximumWidth(78 if self.compact else 150)
            line.setAlignment(Qt.AlignmentFlag.AlignRight)
        return line

    def read(self, text: str) -> Any:
        """Value of the text; the text if it is none."""
        bare, kind = text.strip(), kind_of(self.form)
        if not bare and kind in ("free", "mixed"):
            return {} if kind == "free" else ""
        if not bare and kind == "number" and self.may_be_left_out:
            return self.default
        if not text and self.may_be_left_out and self.default is ABSENT and not self.form.rule.prose:
            return ABSENT
        try:
            match kind:
                case "free" | "mixed":
                    return parse_yaml(text).data
                case "number" if int in self.form.scalars:
                    return int(bare)
                case "number":  # a decimal comma is accepted
                    return plain_number(float(bare.replace(",", ".")))
        except ValueError:
            return bare if kind == "number" else text
        return text

    def show_value(self, value: Any) -> None:
        text = "" if value is ABSENT else shown_text(value)
        typed = self.control.text()
        # While typing, "1." equals "1".
        if text != typed and not (self.control.hasFocus() and self.read(typed) == value):
            self.control.setText(text)
            if isinstance(self.control, QLineEdit):
                self.control.setCursorPosition(0)
        if self.form.rule.knows is not None:
            self._show_known(self.context.known(self.form.rule.knows))

    def enter(self, value: Any) -> None:
        self.control.selectAll()
        self.control.insert(shown_text(value))

    def _show_known(self, known: Names) -> None:
        """Show known names as links, and whether the current one is unknown."""
        if self._known is None:
            if not known.names:
                return
            # Without a mouse the name is typed: the links are part of the field's description, and are not tab stops.
            self._known = self.add_text("", "known_names")
            self._known.setTextInteractionFlags(Qt.TextInteractionFlag.LinksAccessibleByMouse)
            self._known.linkActivated.connect(self._on_known)
        value, theme = self.control.text(), self.context.theme
        missing = known.all_of_them and value not in ("", *known.names)
        template = tr("Unknown: {name}. Available: {names}") if missing else tr("Available: {names}")
        link = f'<a href="{{0}}" style="color:{theme.colors.blue}; text-decoration:none">{{0}}</a>'
        names = " · ".join(link.format(escape(name)) for name in known.names)
        self._known.setText(escape(template).format(name=escape(value), names=names))
        restyle(self._known, tone="amber" if missing else "dim")
        self.remark = template.format(name=value, names=", ".join(known.names))
        self._known.setAccessibleName(self.context.spoken(self.remark))
        # A row without choices left stays a row.
        self._known.setVisible(bool(known.names) and (missing or not (self.compact and value)))

    def _on_known(self, name: str) -> None:
        self.document.replace(self.path, name)
        self.setFocus(_BY_PROGRAM)


class KeyField(TextField):
    """Key combination, entered by pressing it."""

    def make_input(self) -> QLineEdit | Prose:
        line = KeyCommandEdit(_combination, placeholderText=tr("Press a key"), maximumWidth=170)
        line.setMinimumHeight(tokens.CONTROL_HEIGHT_PX)
        line.commanded.connect(partial(self.document.set, self.path))
        return line


def _combination(event: QKeyEvent) -> str:
    """Ctrl, optionally Shift, and a letter or digit without a function in text fields."""
    modifiers = event.modifiers()
    if not modifiers & Qt.KeyboardModifier.ControlModifier or modifiers & Qt.KeyboardModifier.AltModifier:
        return ""
    letter = chr(event.key()) if 0x30 <= event.key() <= 0x5A else ""
    shift = modifiers & Qt.KeyboardModifier.ShiftModifier
    if not letter.isalnum() or letter == "Z" or (letter in "ACVXY" and not shift):
        return ""
    return f"Ctrl+{'Shift+' if shift else ''}{letter}"


class SwitchField(Field):
    """Check box."""

    control: CheckBox
    names_itself = True

    def make(self) -> tuple[QWidget, QWidget]:
        box = CheckBox(self.context.theme, self.title or tr("On"))
        box.clicked.connect(lambda: self.document.replace(self.path, box.isChecked()))
        return box, box

    def show_value(self, value: Any) -> None:
        self.control.setChecked(value is True)

    def enter(self, value: Any) -> None:
        if self.control.isChecked() is not value:
            self.control.click()


class ChoiceField(Field):
    """Choice of several words, or of names defined elsewhere in the file."""

    control: DropDown

    def make(self) -> tuple[QWidget, QWidget]:
        box = DropDown(self.context.theme, "", self.title, maximumWidth=360)
        box.setSizeAdjustPolicy(DropDown.SizeAdjustPolicy.AdjustToContents)
        box.setMinimumSize(120, tokens.CONTROL_HEIGHT_PX)
        box.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self._offered: list[Any] = []
        box.activated.connect(lambda index: self.document.replace(self.path, self._offered[index]))
        return box, box

    def show_value(self, value: Any) -> None:
        offered = self._offers(value)
        if offered != self._offered:
            self._offered = offered
            self.control.clear()
            for each in offered:
                self.control.addItem(self._word_for(each), each)
        self.control.setCurrentIndex(offered.index(value) if value in offered else -1)

    def _offers(self, value: Any) -> list[Any]:
        words: list[Any] = list(self.form.choices) or self._names()
        if self.may_be_left_out and self.default is ABSENT:
            words.insert(0, ABSENT)
        elif self.may_be_left_out and not self.form.choices:
            words.insert(0, "")
        return words if value in words or value is ABSENT else [*words, value]

    def _word_for(self, value: Any) -> str:
        rule = self.form.rule
        if value == "" and rule.else_one_of:
            return tr("not set")  # different from "none"
        if value is ABSENT or value == "":
            return tr("none")
        return str(value) if rule.refers and value not in rule.else_one_of else word_of(value)

    def _names(self) -> list[Any]:
        *above, last = self.form.rule.refers
        entries = self.document.value(tuple(above))
        names = [value_at(entry, (last,)) for entry in entries] if isinstance(entries, list) else []
        return list(dict.fromkeys(name for name in (*names, *self.form.rule.else_one_of) if isinstance(name, str)))

    def enter(self, value: Any) -> None:
        self.refresh()
        self.control.setCurrentIndex(self._offered.index(value))
        self.control.activated.emit(self.control.currentIndex())


def shown_text(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (dict, list)):
        return yaml_text(value).rstrip("\n") if value != {} else ""
    return f"{plain_number(value):.10g}" if isinstance(value, float) else str(value)


FIELDS: dict[str, type[Field]] = {
    "choice": ChoiceField, "free": TextField, "key": KeyField, "mixed": TextField, "number": TextField,
    "switch": SwitchField, "text": TextField,
}  # fmt: skip


def kind_of(form: ValueForm) -> str:
    """Kind of a single value, which decides its field."""
    if form.is_free:
        return "free"
    if form.rule.refers or form.choices:
        return "choice"
    if len(form.scalars) > 1:
        return "mixed"
    if form.scalars == (str,):
        return "key" if form.rule.pressed and not form.rule.prose else "text"
    return "switch" if form.scalars == (bool,) else "number"


def field_for(
    context: FormContext, path: KeyPath, form: ValueForm, key: Key | None = None, *, compact: bool = False
) -> Field:
    return FIELDS[kind_of(form)](context, path, form, key, compact=compact)


def part_for(context: FormContext, path: KeyPath, key: Key) -> FormPart:
    """Create the form widget for a key of a group."""
    form = key.form
    if form.item is not None:
        return ListPart(context, path, form, key)
    if form.groups:
        return GroupPart(context, path, form, key, optional=default_of(key) is ABSENT and not key.required)
    return field_for(context, path, form, key)


# ---- groups and lists


class Holder(FormPart):
    """Group or list, with title and help above its parts."""

    def __init__(self, context: FormContext, path: KeyPath, form: ValueForm, key: Key | None = None) -> None:
        super().__init__(context, path, form, key, spacing_px=12)
        self.texts = layouts.vbox(spacing_px=2)
        self.column.addLayout(self.texts)
        if key is not None and self.title != section_of(key):  # the title of the page
            self.context = context.inside(self.title)
            self.add_text(self.title, "group_title").setWordWrap(False)
            if said_of(form):
                self.add_text(readable(said_of(form)), "help")

    @property
    def value(self) -> Any:
        return self.document.value(self.path)


class GroupPart(Holder):
    """Keys of a group, one below another; dependent keys are shown while permitted. The group may be ``optional`` as a
    whole, and one of several: the choice is above the keys. ``group`` is known if a list entry shows it.
    """

    def __init__(
        self, context: FormContext, path: KeyPath, form: ValueForm, key: Key | None = None, *,
        optional: bool = False, group: Group | None = None,
    ) -> None:  # fmt: skip
        super().__init__(context, path, form, key)
        self._known_group = group
        self._group: Group | None = None
        self._keys: Sequence[Key] = ()
        self._button = ActionButton(context.theme, icon="plus") if optional else None
        if self._button is not None:
            self._button.clicked.connect(
                lambda: self.document.replace(self.path, ABSENT if self.value is not ABSENT else blank_of(self.form))
            )
            self.column.addWidget(self._button)
        chooses = group is None and form.alternatives
        self._kind = DropDown(context.theme, "", self.context.spoken(tr("Kind"))) if chooses else None
        if self._kind is not None:
            self._kind.setSizeAdjustPolicy(DropDown.SizeAdjustPolicy.AdjustToContents)
            self._kind.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
            self._kind.addItems([words_of(each) for each in form.alternatives])
            self._kind.activated.connect(self._on_chosen)
            self._kind.hide()
            self.column.addWidget(self._kind)

    def _on_chosen(self, index: int) -> None:
        group = self.form.alternatives[index]
        if group is not self._group:
            self.document.replace(self.path, blank_group(group))

    def refresh(self) -> None:
        data = self.value
        absent = self._button is not None and data is ABSENT
        self._use_group(None if absent else self._known_group or self.form.group_at(data))
        if self._button is not None:
            words = tr("Add: {title}") if absent else tr("Remove: {title}")
            self._button.set_label(words.format(title=self.title), icon="plus" if absent else "x")
        for key, part in zip(self._keys, self.parts, strict=True):
            shown = is_permitted(key, data) or value_at(data, (key.name,)) is not ABSENT
            if part.isHidden() is shown:
                part.setVisible(shown)
        super().refresh()

    def _use_group(self, group: Group | None) -> None:
        if group is self._group:
            return
        self._group = group
        self._keys = () if group is None else keys_of(group)
        for part in self.parts:
            drop(part)
        self.parts = [part_for(self.context, (*self.path, each.name), each) for each in self._keys]
        for part in self.parts:
            self.column.addWidget(part)
            show_at_once(part)
        if self._kind is not None:
            self._kind.setVisible(group is not None)
            self._kind.setCurrentIndex(self.form.alternatives.index(group) if group is not None else -1)

    def reveal(self, path: KeyPath) -> FormPart | None:
        return self if path == self.path and self._button is not None else super().reveal(path)

    def enter(self, _value: Any) -> None:
        if self._button is not None:
            self._button.click()


def is_permitted(key: Key, data: Any) -> bool:
    """Whether the schema permits the key given the others."""
    rule = key.form.rule
    if any(value_at(data, (other,)) is not ABSENT for other in rule.instead_of):
        return False
    if not rule.beside:
        return True
    other, *words = rule.beside
    found = value_at(data, (other,))
    return found in words if words else found not in (ABSENT, "")


class ListPart(Holder):
    """List of entries with buttons to move and remove each, and a button per kind of entry to add."""

    def __init__(self, context: FormContext, path: KeyPath, form: ValueForm, key: Key) -> None:
        super().__init__(context, path, form, key)
        if form.item is None:
            raise TypeError(f"{path} is no list")
        self.item = form.item
        self.parts = self.rows = list[EntryRow]()
        self._more_rows = QTimer(self, singleShot=True, interval=0)
        self._more_rows.timeout.connect(self.refresh)
        self._box = layouts.vbox(spacing_px=8)
        self.column.addLayout(self._box)
        least, self._most = form.size
        self.fixed = least == self._most
        self._adders: list[ActionButton] = []
        if self.fixed:
            return
        for number, (words, blank) in enumerate(kinds_of_entries(form.item)):
            button = ActionButton(context.theme, tr("Add {what}").format(what=words), icon="plus", height_px=30)
            named(button, f"add_{'_'.join(map(str, path))}_{number}", self.context.spoken(button.text()))
            button.clicked.connect(lambda _checked=False, blank=blank: self.add_entry(len(self.entries), blank))
            self._adders.append(button)
        self.column.addLayout(layouts.hbox(None, *self._adders, 1, spacing_px=8))

    @property
    def entries(self) -> list[Any]:
        value = self.value
        return value if isinstance(value, list) else []

    def add_entry(self, index: int, entry: Any) -> None:
        self.document.add((*self.path, index), entry)
        self._focus_row(index)

    def move_entry(self, index: int, by: int) -> None:
        if 0 <= index + by < len(self.entries):
            self.document.move((*self.path, index), index + by)
            self._focus_row(index + by)

    def remove_entry(self, index: int) -> None:
        self.document.remove((*self.path, index))
        self._focus_row(min(index, len(self.entries) - 1))

    def _focus_row(self, index: int) -> None:
        self.complete()
        if 0 <= index < len(self.rows):
            self.rows[index].focus_first()

    def reveal(self, path: KeyPath) -> FormPart | None:
        self.complete()
        return super().reveal(path)

    def complete(self) -> None:
        """Create all rows now."""
        while self._more_rows.isActive() or len(self.rows) != len(self.entries):
            self.refresh()

    def refresh(self) -> None:
        entries = self.entries
        self._update_rows([self.item.group_at(entry) for entry in entries])
        for button in self._adders:
            button.setEnabled(self._most is None or len(entries) < self._most)
        super().refresh()

    def _update_rows(self, groups: list[Group | None]) -> None:
        """Make a row for each entry, reusing those of an unchanged group. Long lists are built a few rows per turn, so
        that keys are still handled.
        """
        self._more_rows.stop()
        while len(self.rows) > len(groups):
            drop(self.rows.pop())
        made = 0
        for number, group in enumerate(groups):
            old = self.rows[number] if number < len(self.rows) else None
            if old is not None and old.group is group:
                continue
            if made == _ROWS_AT_ONCE:
                self._more_rows.start()
                return
            made += 1
            row = EntryRow(self, number, group)
            self._box.insertWidget(number, row)
            self.rows[number : number + 1] = [row]
            if old is not None:
                drop(old)
            show_at_once(row)


class EntryRow(FormPart):
    """List entry: a row of fields if small, a text with more behind it, else a foldable card."""

    def __init__(self, holder: ListPart, index: int, group: Group | None) -> None:
        context = holder.context.inside(tr("entry {number}").format(number=index + 1))
        super().__init__(context, (*holder.path, index), holder.item, spacing_px=8)
        self.group = group
        self._holder = holder
        self._index = index
        self._is_text = holder.item.text is not None and group is holder.item.group_at("")
        self._is_card = not (group is None or self._is_text or in_one_row(group))
        self._open = False
        self._body: QWidget | None = None
        self._toggle: ActionButton | None = None
        self._robot_button: ActionButton | None = None
        self._head = layouts.hbox(spacing_px=6)
        self.column.addLayout(self._head)
        self._add_key_cap()
        if self._is_card:
            self.setObjectName("entry_card")
            self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
            self.column.setContentsMargins(12, 10, 8, 10)
            self._toggle = ActionButton(context.theme, icon="caret-right", role="ghost", may_shrink=True, semibold=True)
            layouts.fill(self._head, (self._toggle, 1), 1)
        else:
            self._add_fields()
        if self._toggle is not None:
            self._toggle.clicked.connect(self._on_toggle)
        if not holder.fixed:
            self._add_buttons()
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Maximum)

    def _add_key_cap(self) -> None:
        """Create a column for the entry's key in the console."""
        data = self.document.data
        key = key_of_entry(data, self.path)
        if not key and (self._is_card or not key_of_entry(data, (*self._holder.path, 0))):
            return
        holder = QWidget()
        holder.setFixedWidth(_CAP_COLUMN_PX.get(self.path[0], 64))
        layouts.hbox(holder, *([KeyCap(cap_text(key))] if key else []), 1, margins_px=(0, 7, 0, 7))
        self._head.addWidget(holder, 0, _BOTTOM)

    def _add_fields(self) -> None:
        keys = keys_of(self.group) if self.group is not None else ()
        fields = self._compact_fields(keys[:1] if self._is_text else keys)
        if self.group is None:
            fields = [field_for(self.context, self.path, self.form, compact=True)]
        self.parts = fields
        for field in fields:
            field.texts = self.column  # an error below its own field would push that field out of the row
            narrow = kind_of(field.form) in (("number",) if keys else ("number", "choice"))
            self._head.addWidget(field, 0 if narrow else 1, _BOTTOM)
            if self._index or self._is_text:
                field.without_title()
        if self._is_text:
            self._toggle = ActionButton(
                self.context.theme, tr("More"), icon="caret-right", role="ghost", height_px=32,
                text_px=tokens.STATUS_PX, may_shrink=True,
            )  # fmt: skip
            self._toggle.setFixedWidth(_MORE_PX)
            self._head.addWidget(self._toggle, 0, _BOTTOM)
        elif {key.name for key in keys} >= _POSE_KEYS:
            self._robot_button = ActionButton(
                self.context.theme, tr("Here"), icon="robot", height_px=32, text_px=tokens.STATUS_PX
            )
            here = self.context.spoken(tr("Use the robot's current position"))
            named(self._robot_button, "place_from_robot", here)
            self._robot_button.clicked.connect(self._use_robot_pose)
            self._head.addWidget(self._robot_button, 0, _BOTTOM)

    def _compact_fields(self, keys: Sequence[Key]) -> list[Field]:
        return [field_for(self.context, (*self.path, key.name), key.form, key, compact=True) for key in keys]

    def _add_buttons(self) -> None:
        buttons = layouts.hbox(spacing_px=0)
        self._head.addLayout(buttons)
        for icon, words, do in (
            ("arrow-up", tr("Move up: {what}"), lambda: self._holder.move_entry(self._index, -1)),
            ("arrow-down", tr("Move down: {what}"), lambda: self._holder.move_entry(self._index, 1)),
            ("x", tr("Remove: {what}"), lambda: self._holder.remove_entry(self._index)),
        ):
            tip = words.format(what=self.context.within)
            button = ActionButton(self.context.theme, icon=icon, role="ghost", height_px=30, toolTip=tip, clicked=do)
            buttons.addWidget(button, 0, _BOTTOM)
        if self.group is None and kind_of(self.form) in ("number", "choice"):
            self._head.addStretch(1)

    # ---- display

    def refresh(self) -> None:
        super().refresh()
        if self._toggle is not None:
            data = self.document.value(self.path)
            if self._is_card:
                words = card_name(data) or tr("Entry {number}").format(number=self._index + 1)
                wrong = sum(mistake.path[: len(self.path)] == self.path for mistake in self.document.mistakes)
                if wrong:
                    words = tr("{name} · errors: %n", "", wrong).format(name=words)
            elif self._open:
                words = tr("Less")
            else:
                others = (value_at(data, (key.name,)) for key in keys_of(self.group)[1:])
                words = " · ".join(value for value in others if isinstance(value, str) and value) or tr("More")
            icon = "caret-down" if self._open else "caret-right"
            self._toggle.set_label(words, icon=icon, name=self.context.spoken(words))
        if self._robot_button is not None:
            known = self.context.robot_pose() is not None
            self._robot_button.setEnabled(known)
            where = tr("Use the robot's current position and heading")
            self._robot_button.setToolTip(where if known else tr("The robot's position in the map is unknown"))

    def show_mistakes(self) -> None:
        if self.group is not None:  # a single value has a field of the same path
            super().show_mistakes()

    def _on_toggle(self) -> None:
        self._open = not self._open
        if self._body is None:
            self._body = self._make_body()
            self.column.insertWidget(1, self._body)
        self._body.setVisible(self._open)
        self.refresh()

    def _make_body(self) -> QWidget:
        if self._is_text:
            body = QWidget()
            row = layouts.hbox(body, margins_px=(36, 0, 0, 4), spacing_px=12)
            fields = self._compact_fields(keys_of(self.group)[1:])
            for field in fields:
                row.addWidget(field, 1, _TOP)
            self.parts = [*self.parts, *fields]
            return body
        known = self.form.text is not None or is_group(self.form.kind)
        part = GroupPart(self.context, self.path, self.form, group=self.group if known else None)
        self.parts = [part]
        return part

    def reveal(self, path: KeyPath) -> FormPart | None:
        behind = self._is_text and len(path) > len(self.path) and path[-1] != text_key(self.group)
        if (self._is_card or behind) and not self._open:
            self._on_toggle()
        return self.parts[0] if path == self.path and not self._is_card else super().reveal(path)

    def focus_first(self) -> None:
        if self._is_card and not self._open:
            self._on_toggle()
        parts = self.parts[0].parts if self._is_card else self.parts
        first = next((part for part in parts if isinstance(part, Field)), self._toggle)
        if first is not None:
            first.setFocus(_BY_PROGRAM)

    # ---- user

    def _use_robot_pose(self) -> None:
        pose = self.context.robot_pose()
        if pose is None:
            return
        self.document.pause()
        for name, value in (
            ("x_m", round(pose.x_m, 2)),
            ("y_m", round(pose.y_m, 2)),
            ("heading_deg", round(math.degrees(pose.heading_rad))),
        ):
            self.document.set((*self.path, name), value)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        enters = event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter) and not event.modifiers()
        if self._holder.fixed or not (_moves_entry(event) or (enters and not self._is_card)):
            super().keyPressEvent(event)
        elif enters:
            self._holder.add_entry(self._index + 1, kinds_of_entries(self.form)[0][1])
        else:
            self._holder.move_entry(self._index, -1 if event.key() == Qt.Key.Key_Up else 1)


def in_one_row(group: Group) -> bool:
    """Whether the keys are few and short enough for one row."""
    keys = keys_of(group)
    return len(keys) <= _MOST_IN_A_ROW and all(
        key.form.scalars and not key.form.rule.prose and not key.form.is_free for key in keys
    )


def kinds_of_entries(item: ValueForm) -> list[tuple[str, Any]]:
    """Kinds of entries that can be added, with their initial values."""
    if not item.groups:
        return [(tr("an entry"), blank_of(item))]
    blanks = [blank_of(item) if is_group(item.kind) else blank_group(group) for group in item.groups]
    if item.text is not None:
        blanks[0] = ""
    return [(noun_of(group), blank) for group, blank in zip(item.groups, blanks, strict=True)]


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


_KEYS = {spec.id: spec.keys[0] for spec in ACTIONS if spec.keys}


def key_of_entry(data: Any, path: KeyPath) -> str:
    """Key of a list entry in the console; empty if none."""
    match path:
        case ("phrases", int(index)):
            entries = value_at(data, ("phrases",))
            entries = entries if isinstance(entries, list) else []
            sentences = [value_at(each, ("group",)) is ABSENT for each in entries]
            number = sum(sentences[: index + 1]) if index < len(sentences) and sentences[index] else 0
            return _KEYS.get(f"phrase_{number}", "")
        case ("phrases", int(), "phrases", int(index)):
            return _KEYS.get(f"phrase_{index + 1}", "")
        case ("gestures", int(index)):
            key = value_at(data, (*path, "key"))
            return _KEYS.get(f"gesture_{index + 1}", "") if key in (ABSENT, "") else str(key)
        case ("recording", "labels", int(index)):
            return _KEYS.get(f"label_{index + 1}", "")
        case ("places", int(index)):
            return _KEYS.get(f"place_{index + 1}", "")
    return ""


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
