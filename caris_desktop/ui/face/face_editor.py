"""Face editor with preview. Controls follow from the schema of a face; the result is saved as a face of the user."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from PySide6.QtCore import Qt, QTimer
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QFormLayout, QLineEdit, QSlider, QWidget

from caris_desktop.conversation.face.drawing import FaceMotion, SpokenLoudness, drawing_of
from caris_desktop.conversation.face.face_file import (
    DEFAULT_FACE,
    Expression,
    Eyes,
    Face,
    FaceError,
    Mouth,
    checked,
    face_text,
    load_face,
)
from caris_desktop.domain import clock, intents
from caris_desktop.domain.schema_fields import Key, keys_of
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts
from caris_desktop.ui.face.face_view import FaceView
from caris_desktop.ui.form_dialog import FormDialog
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.drop_down import DropDown
from caris_desktop.ui.widgets.labels import label
from caris_desktop.ui.widgets.scroll_areas import list_area

_STEPS = 200
_DRAW_EVERY_MS = 40
_SLIDERS = {
    "eyes_open": QT_TR_NOOP("Eyes open"), "lids_deg": QT_TR_NOOP("Eyelids"), "smile": QT_TR_NOOP("Smile"),
    "mouth_open": QT_TR_NOOP("Mouth open"), "look_up": QT_TR_NOOP("Look up"), "width": QT_TR_NOOP("Width"),
    "height": QT_TR_NOOP("Height"), "apart": QT_TR_NOOP("Spacing"), "above": QT_TR_NOOP("Above"),
    "roundness": QT_TR_NOOP("Roundness"), "stroke": QT_TR_NOOP("Stroke"), "below": QT_TR_NOOP("Below"),
}  # fmt: skip
_COLOURS = {
    "background": QT_TR_NOOP("Background"),
    "ink": QT_TR_NOOP("Eyes and mouth"),
    "words": QT_TR_NOOP("Captions"),
}


class FaceEditor(FormDialog):
    """The face in use changes only on saving."""

    def __init__(self, theme: Theme, console: WizardConsole, parent: QWidget) -> None:
        super().__init__(theme, parent, "face_editor", tr("Edit the face"))
        self._console = console
        status = console.state.face.value
        self._face = _loaded(status.face)
        self._motion = FaceMotion(self._face)
        self._preview = FaceView()
        self._preview.setMinimumSize(240, 140)
        self._name = QLineEdit(self._face.name, maxLength=40)
        self._name.setObjectName("face_name")
        self._name.setAccessibleName(tr("Name"))
        self._choice = DropDown(theme, "face_expression_choice", tr("Expression to edit"))
        self._choice.addItems([one.name for one in self._face.expressions])
        self._choice.currentIndexChanged.connect(self._on_expression_chosen)
        self._sliders: dict[tuple[str, str], _ValueSlider] = {}
        rows = QWidget()
        form = self._form = QFormLayout(rows)
        form.setRowWrapPolicy(QFormLayout.RowWrapPolicy.WrapLongRows)
        form.addRow(label(tr("Expression"), "title"), self._choice)
        self._add_sliders("expression", Expression, tr("Expression"))
        form.addRow(label(tr("Eyes"), "title"), QWidget())
        self._add_sliders("eyes", Eyes, tr("Eyes"))
        form.addRow(label(tr("Mouth"), "title"), QWidget())
        self._add_sliders("mouth", Mouth, tr("Mouth"))
        form.addRow(label(tr("Colours"), "title"), QWidget())
        for key, words in _COLOURS.items():
            field = QLineEdit(getattr(self._face, key), maxLength=7)
            field.setObjectName(f"face_{key}")
            field.setAccessibleName(tr(words))
            field.textEdited.connect(self._colour_setter(key))
            form.addRow(tr(words), field)
        self._speak = ActionButton(
            theme, tr("Speak"), icon="chat-text", height_px=32, objectName="face_speak", checkable=True,
            toggled=self._on_speak,
        )  # fmt: skip
        keep = ActionButton(
            theme, tr("Save as"), icon="check", height_px=32, role="primary", objectName="face_keep",
            clicked=self._on_store,
        )  # fmt: skip
        note = tr("Your own face replaces a built-in face of the same name.")
        self._note = label(note, tone="dim", wraps=True, objectName="face_note")
        buttons = layouts.hbox(None, self._speak, 1, keep, self._name)
        layouts.hbox(self, (layouts.vbox(None, (self._preview, 1), self._note, buttons), 3), (list_area(rows), 2))
        self.resize(900, 560)
        self._drawing = QTimer(self, interval=_DRAW_EVERY_MS)
        self._drawing.timeout.connect(self._draw)
        self._drawing.start()
        self._on_expression_chosen(0)

    def _add_sliders(self, part: str, group: Any, heading: str) -> None:
        for key in keys_of(group):
            rule = key.form.rule
            if key.form.kind is not float or rule.at_least is None or rule.at_most is None:
                continue
            slider = _ValueSlider(key, self._setter(part, key.attribute))
            slider.setObjectName(f"face_{part}_{key.attribute}")
            self._sliders[part, key.attribute] = slider
            words = tr(_SLIDERS[key.attribute])
            slider.setAccessibleName(f"{heading}: {words}")
            self._form.addRow(words, slider)
            if part != "expression":
                slider.show_value(getattr(getattr(self._face, part), key.attribute))

    def _setter(self, part: str, attribute: str) -> Callable[[float], None]:
        def put(value: Any) -> None:
            if part == "expression":
                at = self._choice.currentIndex()
                changed = replace(self._face.expressions[at], **{attribute: value})
                expressions = (*self._face.expressions[:at], changed, *self._face.expressions[at + 1 :])
                self._use(replace(self._face, expressions=expressions))
            else:
                self._use(replace(self._face, **{part: replace(getattr(self._face, part), **{attribute: value})}))

        return put

    def _colour_setter(self, key: str) -> Callable[[str], None]:
        def put(text: Any) -> None:
            try:
                self._use(checked(replace(self._face, **{key: text})))
            except FaceError:
                self._say(tr("Enter the colour as #rrggbb."))

        return put

    def _use(self, face: Face) -> None:
        self._face = face
        self._motion.use(face)
        self._say("")

    def _say(self, text: str) -> None:
        self._note.setText(text)

    def _on_expression_chosen(self, index: int) -> None:
        expression = self._face.expressions[index]
        self._motion.express(expression.name)
        for (part, attribute), slider in self._sliders.items():
            if part == "expression":
                slider.show_value(getattr(expression, attribute))

    def _on_speak(self, on: bool) -> None:
        self._motion.speak(SpokenLoudness(clock.now_ns()) if on else None)

    def _on_store(self) -> None:
        name = self._name.text().strip()
        refused = self._console.do(intents.KeepFace(name, face_text(self._face)))
        self._say(refused or tr("Saved as “{name}”. The robot now shows this face.").format(name=name))

    def _draw(self) -> None:
        caption = tr("The robot's speech appears here.") if self._speak.isChecked() else ""
        self._preview.show_drawing(drawing_of(self._face, self._motion.at(clock.now_ns()), caption=caption))

    def closeEvent(self, event: QCloseEvent) -> None:
        self._drawing.stop()
        super().closeEvent(event)


class _ValueSlider(QSlider):
    """Slider within the bounds of the schema."""

    def __init__(self, key: Key, put: Callable[[float], None]) -> None:
        super().__init__(Qt.Orientation.Horizontal)
        rule = key.form.rule
        self._least, self._most = float(rule.at_least or 0.0), float(rule.at_most or 1.0)
        self._put = put
        self.setRange(0, _STEPS)
        self.setToolTip(rule.text)
        self.setMinimumWidth(120)
        self.valueChanged.connect(self._on_moved)

    def show_value(self, value: float) -> None:
        self.blockSignals(True)
        self.setValue(round((value - self._least) / (self._most - self._least) * _STEPS))
        self.blockSignals(False)

    def _on_moved(self, step: int) -> None:
        self._put(round(self._least + (self._most - self._least) * step / _STEPS, 3))


def _loaded(name: str) -> Face:
    try:
        return load_face(name)
    except FaceError:
        return load_face(DEFAULT_FACE)
