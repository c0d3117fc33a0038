"""Form fields for single values: display the document's value and write edits back."""

from html import escape
from typing import Any

from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QLabel, QWidget

from caris_desktop.domain.key_path import KeyPath
from caris_desktop.domain.schema_fields import Key, ValueForm, plain_number
from caris_desktop.domain.schema_labels import title_of, unit_of, word_of
from caris_desktop.domain.schema_paths import ABSENT, default_of, value_at
from caris_desktop.domain.translation import tr
from caris_desktop.domain.yaml_source import YamlSourceError, parse_yaml
from caris_desktop.domain.yaml_writing import yaml_text
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.scenario_editor.editing_context import FormContext, Names, help_of, sentence_at
from caris_desktop.ui.scenario_editor.inputs import Line, Prose
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.check_box import CheckBox
from caris_desktop.ui.widgets.drop_down import DropDown

_SHORT_UNITS = {"metres": "m", "degrees": "°", "seconds": "s", "minutes": "min", "pixels": "px"}


class FormPart(QWidget):
    """Form widget for one path of the file."""

    def __init__(self, context: FormContext, path: KeyPath) -> None:
        super().__init__()
        self.context = context
        self.path = path

    def refresh(self) -> None:
        """Show the document's current value."""
        raise NotImplementedError

    def reveal(self, path: KeyPath) -> "Field | None":
        """Field of a path, created, unfolded and scrolled to."""
        raise NotImplementedError


class Field(FormPart):
    """Field with title, help and error message.

    ``compact``: for rows, with help in the tooltip only.
    """

    def __init__(
        self, context: FormContext, path: KeyPath, form: ValueForm, key: Key | None = None, *, compact: bool = False
    ) -> None:
        super().__init__(context, path)
        self.form = form
        self.key = key
        self.compact = compact
        self.title = title_of(key) if key is not None else ""
        self.help = help_of(form)
        self.setObjectName("field_" + "_".join(map(str, path)))
        self.column = layouts.vbox(self, margins_px=0, spacing_px=4)
        # Created on demand: most fields have no error, and compact ones no help.
        self._title_label: QLabel | None = None
        self._help_label: QLabel | None = None
        self._mistake_label: QLabel | None = None
        self._back: ActionButton | None = None
        self._arrange()
        context.theme.changed.connect(self._style)
        self._style()

    # ---- subclass interface

    @property
    def control(self) -> QWidget:
        """Widget that gets the focus."""
        raise NotImplementedError

    def make(self) -> QWidget:
        """Create the control, with widgets next to it."""
        raise NotImplementedError

    def show_value(self, value: Any) -> None:
        raise NotImplementedError

    def enter(self, value: Any) -> None:
        """Enter a value as a user would."""
        raise NotImplementedError

    # ---- common behaviour

    def _arrange(self) -> None:
        made = self.make()
        if self.title and not self.heads_itself:
            unit = _SHORT_UNITS.get(self.form.rule.unit, "") if self.compact else ""
            self._title_label = QLabel(f"{self.title} ({unit})" if unit else self.title)
            self._title_label.setBuddy(self.control)
        self._top = layouts.hbox(spacing_px=6)
        if self._title_label is not None:
            self._top.addWidget(self._title_label)
            self._top.addStretch(1)
            self.column.addLayout(self._top)
            self.column.addWidget(made)
        else:
            self._top.addWidget(made, 1)
            self.column.addLayout(self._top)
        if self.help and not self.compact:
            self._help_label = self._words(self.help)
        name = self.title or tr("Entry")
        name = f"{name} ({unit_of(self.form)})" if self.form.rule.unit else name
        self.control.setAccessibleName(self.context.spoken(name))
        self.control.setAccessibleDescription(self.help)
        if self.compact:
            self.control.setToolTip(self.help)

    def _words(self, text: str) -> QLabel:
        label = QLabel(text, wordWrap=True)
        self.column.addWidget(label)
        return label

    def without_title(self) -> None:
        """Hide the title in a table with column headings."""
        if self._title_label is not None:
            self._title_label.hide()

    @property
    def heads_itself(self) -> bool:
        """Whether the control shows its own title."""
        return False

    @property
    def document(self) -> Any:
        return self.context.editing.document

    def put(self, value: Any) -> None:
        """Write to the document; ABSENT removes the key."""
        if value is ABSENT:
            self.context.editing.clear(self.path)
        else:
            self.context.editing.set(self.path, value)

    @property
    def may_be_left_out(self) -> bool:
        return self.key is not None and not self.key.required

    def _take_back(self) -> None:
        saved = value_at(self.document.saved_data, self.path)
        self.document.pause()
        self.put(saved if saved is not ABSENT else self._default())
        self.document.pause()

    def _default(self) -> Any:
        return ABSENT if self.key is None else default_of(self.key)

    def refresh(self) -> None:
        self.show_value(self.document.value(self.path))
        self._show_mistakes(
            "\n".join(sentence_at(each, self.title) for each in self.context.editing.mistakes_at(self.path))
        )
        changed = value_at(self.document.saved_data, self.path) != value_at(self.document.data, self.path)
        if not self.compact and (changed or self._back is not None):
            self._show_back(changed)

    def _show_mistakes(self, message: str) -> None:
        if self._mistake_label is None:
            if not message:
                return
            self._mistake_label = self._words("")
            self._mistake_label.setObjectName("mistake")
            self._style()
        if message != self._mistake_label.text():
            self._mistake_label.setText(message)
            # A screen reader reads the error at the field, not only on leaving it.
            self.control.setAccessibleDescription(f"{message} {self.help}".strip())
        self._mistake_label.setVisible(bool(message))

    def _show_back(self, changed: bool) -> None:
        if self._back is None:
            back = ActionButton(self.context.theme, icon="arrow-counter-clockwise", role="ghost", height_px=22)
            as_saved = tr("{title}: restore the saved value").format(title=self.title or tr("Entry"))
            back.setAccessibleName(self.context.spoken(as_saved))
            back.setToolTip(tr("Restore the saved value"))
            back.clicked.connect(self._take_back)
            self._top.insertWidget(1, back)
            self._back = back
        self._back.setVisible(changed)

    def reveal(self, path: KeyPath) -> "Field | None":
        return self if path == self.path else None

    def _style(self) -> None:
        theme = self.context.theme
        if self._title_label is not None:
            small = (tokens.STATUS_PX, tokens.WEIGHT_NORMAL) if self.compact else (tokens.BODY_PX, tokens.WEIGHT_MEDIUM)
            theme.style_text(self._title_label, "dim" if self.compact else "text", *small)
        for label, role in ((self._help_label, "dim"), (self._mistake_label, "red")):
            if label is not None:
                theme.style_text(label, role, tokens.STATUS_PX)


class TextField(Field):
    """Single-line text field."""

    def make(self) -> QWidget:
        self._known: QLabel | None = None
        self.line = Line(self.context)
        self.line.textEdited.connect(self._on_edited)
        default = self._default()
        if isinstance(default, str) and default:
            self.line.setPlaceholderText(default)
        return self.line

    @property
    def control(self) -> QWidget:
        return self.line

    def refresh(self) -> None:
        super().refresh()
        if self.form.rule.knows is not None:
            self._show_known(self.context.known(self.form.rule.knows))

    def _show_known(self, known: Names) -> None:
        """Show known names as links, and whether the current one is unknown."""
        if self._known is None:
            if not known.names:
                return
            self._known = self._words("")
            self._known.setObjectName("known_names")
            # Without a mouse the name is typed: the links are part of the field's description, and are not tab stops.
            self._known.setTextInteractionFlags(Qt.TextInteractionFlag.LinksAccessibleByMouse)
            self._known.linkActivated.connect(self._on_known)
        value = self.line.text()
        template = tr("Available: {names}")
        missing = known.all_of_them and value not in ("", *known.names)
        if missing:
            template = tr("Unknown: {name}. Available: {names}")
        theme = self.context.theme
        link = f'<a href="{{0}}" style="color:{theme.color("blue").name()}; text-decoration:none">{{0}}</a>'
        names = " · ".join(link.format(escape(name)) for name in known.names)
        self._known.setText(escape(template).format(name=escape(value), names=names))
        spoken = template.format(name=value, names=", ".join(known.names))
        self._known.setAccessibleName(self.context.spoken(spoken))
        wrong = "" if self._mistake_label is None else self._mistake_label.text()
        self.control.setAccessibleDescription(" ".join(part for part in (wrong, self.help, spoken) if part))
        theme.style_text(self._known, "amber" if missing else "dim", tokens.STATUS_PX)
        # A row without choices left stays a row.
        self._known.setVisible(bool(known.names) and (missing or not (self.compact and value)))

    def _on_known(self, name: str) -> None:
        self.document.pause()
        self.enter(name)
        self.document.pause()
        self.line.setFocus(Qt.FocusReason.OtherFocusReason)

    def show_value(self, value: Any) -> None:
        text = "" if value is ABSENT else shown_text(value)
        typed = self.line.text()
        # While typing, "1." equals "1".
        if text != typed and not (self.line.hasFocus() and self._read(typed) == value):
            self.line.setText(text)
            self.line.setCursorPosition(0)

    def enter(self, value: Any) -> None:
        self.line.selectAll()
        self.line.insert(shown_text(value))

    def _read(self, text: str) -> Any:
        return ABSENT if not text and self.may_be_left_out and self._default() is ABSENT else text

    def _on_edited(self, text: str) -> None:
        self.put(self._read(text))


class NumberField(TextField):
    """Number with unit. Invalid text stays, with the permitted range below."""

    def make(self) -> QWidget:
        line = super().make()
        self.line.setMaximumWidth(78 if self.compact else 150)
        self.line.setAlignment(Qt.AlignmentFlag.AlignRight)
        if self.compact:
            return line
        self._unit: QLabel | None = QLabel(unit_of(self.form))
        row = layouts.hbox(margins_px=0, spacing_px=8)
        row.addWidget(line)
        row.addWidget(self._unit)
        row.addStretch(1)
        holder = QWidget()
        holder.setLayout(row)
        return holder

    def _style(self) -> None:
        super()._style()
        if not self.compact and self._unit is not None:
            self.context.theme.style_text(self._unit, "dim", tokens.STATUS_PX)

    def _read(self, text: str) -> Any:
        """Parse a number; a decimal comma is accepted."""
        text = text.strip()
        if not text and self.may_be_left_out:
            return self._default()
        try:
            return int(text) if int in self.form.scalars else plain_number(float(text.replace(",", ".")))
        except ValueError:
            return text


class MixedField(TextField):
    """Value that may be a number, boolean or text, by its appearance."""

    def _read(self, text: str) -> Any:
        try:
            return parse_yaml(text).data if text.strip() else ""
        except YamlSourceError:
            return text


class KeyField(TextField):
    """Key combination, entered by pressing it."""

    def make(self) -> QWidget:
        made = super().make()
        self.line.setPlaceholderText(tr("Press a key"))
        self.line.setMaximumWidth(170)
        self.line.installEventFilter(self)
        return made

    def eventFilter(self, watched: Any, event: QEvent) -> bool:
        if event.type() in (QEvent.Type.ShortcutOverride, QEvent.Type.KeyPress) and isinstance(event, QKeyEvent):
            pressed = _combination(event)
            if pressed and event.type() == QEvent.Type.KeyPress:
                self.put(pressed)
            if pressed:
                event.accept()
                return True
        return super().eventFilter(watched, event)


def _combination(event: QKeyEvent) -> str:
    """Ctrl, optionally Shift, and a letter or digit without a function in text fields."""
    modifiers = event.modifiers()
    if not modifiers & Qt.KeyboardModifier.ControlModifier or modifiers & Qt.KeyboardModifier.AltModifier:
        return ""
    letter = chr(event.key()) if 0x30 <= event.key() <= 0x5A else ""
    if not letter.isalnum():
        return ""
    shift = modifiers & Qt.KeyboardModifier.ShiftModifier
    if letter in "ACVXYZ" and not shift:
        return ""
    if letter == "Z":
        return ""
    return f"Ctrl+{'Shift+' if shift else ''}{letter}"


class ProseField(Field):
    """Multi-line text field."""

    def make(self) -> QWidget:
        self.prose = Prose(self.context)
        self.prose.textChanged.connect(self._on_changed)
        return self.prose

    @property
    def control(self) -> QWidget:
        return self.prose

    def show_value(self, value: Any) -> None:
        text = "" if value is ABSENT else self._shown(value)
        typed = self.prose.toPlainText()
        if text != typed and not (self.prose.hasFocus() and self._read(typed) == value):
            self.prose.blockSignals(True)
            self.prose.setPlainText(text)
            self.prose.blockSignals(False)
            self.prose.updateGeometry()

    def enter(self, value: Any) -> None:
        self.prose.selectAll()
        self.prose.insertPlainText(self._shown(value))

    def _shown(self, value: Any) -> str:
        return shown_text(value)

    def _read(self, text: str) -> Any:
        return text

    def _on_changed(self) -> None:
        self.put(self._read(self.prose.toPlainText()))


class FreeField(ProseField):
    """Keys outside the schema, as YAML."""

    def _shown(self, value: Any) -> str:
        return "" if value in ({}, "") else value if isinstance(value, str) else yaml_text(value).rstrip("\n")

    def _read(self, text: str) -> Any:
        try:
            return parse_yaml(text).data if text.strip() else {}
        except YamlSourceError:
            return text


class SwitchField(Field):
    """Check box."""

    def make(self) -> QWidget:
        self.box = CheckBox(self.context.theme, self.title or tr("On"))
        self.box.clicked.connect(self._on_clicked)
        return self.box

    @property
    def control(self) -> QWidget:
        return self.box

    @property
    def heads_itself(self) -> bool:
        return True

    def show_value(self, value: Any) -> None:
        self.box.setChecked(value is True)

    def enter(self, value: Any) -> None:
        if self.box.isChecked() is not value:
            self.box.click()

    def _on_clicked(self) -> None:
        self.document.pause()
        self.put(self.box.isChecked())

    def _style(self) -> None:
        super()._style()
        self.box.setFont(self.context.theme.font(tokens.BODY_PX, tokens.WEIGHT_MEDIUM))
        if self._help_label is not None:
            self._help_label.setContentsMargins(28, 0, 0, 4)


class ChoiceField(Field):
    """Choice of several words, or of names defined elsewhere in the file."""

    def make(self) -> QWidget:
        self.box = DropDown(self.context.theme, "", self.title)
        self.box.setSizeAdjustPolicy(DropDown.SizeAdjustPolicy.AdjustToContents)
        self.box.setMinimumWidth(120)
        self.box.setMaximumWidth(360)
        self.box.setMinimumHeight(tokens.CONTROL_HEIGHT_PX)
        self.box.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self._offered: list[Any] = []
        self.box.activated.connect(self._on_activated)
        return self.box

    @property
    def control(self) -> QWidget:
        return self.box

    def show_value(self, value: Any) -> None:
        offered = self._offers(value)
        if offered != self._offered:
            self._offered = offered
            self.box.clear()
            for each in offered:
                self.box.addItem(self._word_for(each), each)
        self.box.setCurrentIndex(offered.index(value) if value in offered else -1)

    def _offers(self, value: Any) -> list[Any]:
        words: list[Any] = list(self.form.choices) or self._names()
        if self.may_be_left_out and self._default() is ABSENT:
            words.insert(0, ABSENT)
        elif self.may_be_left_out and not self.form.choices:
            words.insert(0, "")
        return words if value in words or value is ABSENT else [*words, value]

    def _word_for(self, value: Any) -> str:
        rule = self.form.rule
        if value == "" and rule.else_one_of:
            return tr("not set")  # different from "none"
        return word_for(value, named=bool(rule.refers) and value not in rule.else_one_of)

    def _names(self) -> list[Any]:
        above, last = self.form.rule.refers[:-1], self.form.rule.refers[-1]
        entries = self.document.value(above)
        names = [value_at(entry, (last,)) for entry in entries] if isinstance(entries, list) else []
        names += self.form.rule.else_one_of
        return [name for number, name in enumerate(names) if isinstance(name, str) and name not in names[:number]]

    def enter(self, value: Any) -> None:
        self.refresh()
        self.box.setCurrentIndex(self._offered.index(value))
        self.box.activated.emit(self.box.currentIndex())

    def _on_activated(self, index: int) -> None:
        self.document.pause()
        self.put(self._offered[index])


def shown_text(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (dict, list)):
        return yaml_text(value).rstrip("\n")
    return f"{plain_number(value):.10g}" if isinstance(value, float) else str(value)


def word_for(value: Any, *, named: bool) -> str:
    """Translated word of a file value; a name (``named``) unchanged."""
    if value is ABSENT or value == "":
        return tr("none")
    return str(value) if named else word_of(value)


def field_for(
    context: FormContext, path: KeyPath, form: ValueForm, key: Key | None = None, *, compact: bool = False
) -> Field:
    """Create the field for a schema type."""
    return _kind_of_field(form)(context, path, form, key, compact=compact)


def _kind_of_field(form: ValueForm) -> type[Field]:
    kinds = form.scalars
    if form.is_free:
        return FreeField
    if form.rule.refers or form.choices:
        return ChoiceField
    if len(kinds) > 1:
        return MixedField
    if kinds == (bool,):
        return SwitchField
    if kinds == (str,):
        return ProseField if form.rule.prose else KeyField if form.rule.pressed else TextField
    return NumberField
