"""The robot's face: its view, the window for a screen on the robot, and the editor."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, assert_never

import numpy as np
from PySide6.QtCore import QPointF, QRectF, QSignalBlocker, QSize, Qt, QTimer, Signal
from PySide6.QtGui import (
    QAccessible,
    QCloseEvent,
    QColor,
    QFont,
    QGuiApplication,
    QImage,
    QMouseEvent,
    QPainter,
    QPainterPath,
    QPaintEvent,
    QPen,
    QScreen,
)
from PySide6.QtWidgets import QFormLayout, QLineEdit, QSlider, QWidget

from caris_desktop.conversation.face.drawing import Box, Drawing, FaceMotion, Lips, SpokenLoudness, Words, drawing_of
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
from caris_desktop.live.state import LiveState
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts
from caris_desktop.ui.form_dialog import FormDialog
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import list_area
from caris_desktop.ui.widgets.inputs import DropDown
from caris_desktop.ui.widgets.labels import label, named
from caris_desktop.ui.widgets.pictures import image_of


class FaceView(QWidget):
    """Displays a face drawing, a text or a picture."""

    accessible_role = QAccessible.Role.Graphic

    def __init__(self) -> None:
        super().__init__()
        self._drawing: Drawing | None = None
        self._picture: QImage | None = None
        self.setAccessibleName(tr("The robot's face"))

    def sizeHint(self) -> QSize:
        return QSize(320, 240)

    def show_drawing(self, drawing: Drawing | None) -> None:
        if drawing != self._drawing or self._picture is not None:
            self._drawing, self._picture = drawing, None
            self.update()

    def show_picture(self, picture: QImage) -> None:
        self._picture = picture
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
        if self._picture is not None:
            painter.fillRect(self.rect(), QColor("black"))
            size = self._picture.size().scaled(self.size(), Qt.AspectRatioMode.KeepAspectRatio)
            left, top = (self.width() - size.width()) / 2, (self.height() - size.height()) / 2
            painter.drawImage(QRectF(left, top, size.width(), size.height()), self._picture)
            return
        drawing = self._drawing
        painter.fillRect(self.rect(), QColor(drawing.background if drawing is not None else "black"))
        if drawing is None:
            return
        unit = min(self.width(), self.height()) / 100
        painter.translate(self.width() / 2, self.height() / 2)
        for shape in drawing.shapes:
            draw_shape(painter, shape, unit)


def draw_shape(painter: QPainter, shape: Box | Lips | Words, unit: float) -> None:
    """Draw a shape around the painter's origin; ``unit``: pixels per hundredth of the shorter side."""
    ink = QColor(shape.ink)
    match shape:
        case Box():
            painter.save()
            painter.translate(shape.x * unit, shape.y * unit)
            painter.rotate(shape.turn_deg)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(ink)
            width, height, radius = shape.width * unit, shape.height * unit, shape.radius * unit
            painter.drawRoundedRect(QRectF(-width / 2, -height / 2, width, height), radius, radius)
            painter.restore()
        case Lips():
            path = QPainterPath(QPointF(shape.left * unit, shape.y * unit))
            middle = (shape.left + shape.right) / 2 * unit
            path.quadTo(middle, _through(shape.y, shape.upper) * unit, shape.right * unit, shape.y * unit)
            path.quadTo(middle, _through(shape.y, shape.lower) * unit, shape.left * unit, shape.y * unit)
            pen = QPen(ink, shape.stroke * unit, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap)
            pen.setJoinStyle(Qt.PenJoinStyle.RoundJoin)
            painter.setPen(pen)
            painter.setBrush(ink)
            painter.drawPath(path)
        case Words():
            font = QFont(painter.font())
            font.setPixelSize(max(1, round(shape.size * unit)))
            painter.setFont(font)
            painter.setPen(ink)
            width = shape.width * unit
            box = QRectF(-width / 2, shape.y * unit, width, 100 * unit)
            flags = Qt.AlignmentFlag.AlignHCenter | Qt.AlignmentFlag.AlignTop
            painter.drawText(box, int(flags) | int(Qt.TextFlag.TextWordWrap), shape.text)
        case _:
            assert_never(shape)


def _through(y: float, middle: float) -> float:
    """Control point of a curve whose midpoint is ``middle``."""
    return 2 * middle - y


def show_on(view: FaceView, contents: Any) -> None:
    """Show a drawing, an image array or JPEG data, or nothing."""
    if isinstance(contents, bytes):
        view.show_picture(image_of(contents))
    elif isinstance(contents, np.ndarray):
        height, width = contents.shape[:2]
        # The array may be freed before the widget paints.
        view.show_picture(QImage(contents.data, width, height, 3 * width, QImage.Format.Format_BGR888).copy())
    else:
        view.show_drawing(contents if isinstance(contents, Drawing) else None)


class FaceWindow(QWidget):
    """Full screen on a second screen if there is one. A double click toggles full screen."""

    accessible_role = QAccessible.Role.Window

    closed_by_hand = Signal()

    def __init__(self, state: LiveState, beside: QWidget) -> None:
        super().__init__(None, Qt.WindowType.Window | Qt.WindowType.WindowDoesNotAcceptFocus)
        self.setObjectName("face_window")
        self.setWindowTitle(tr("Robot’s face"))
        self.setAttribute(Qt.WidgetAttribute.WA_ShowWithoutActivating)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._view = FaceView()
        layouts.vbox(self, self._view, margins_px=0)
        state.face_drawing.follow(self._on_shown)
        other = next((one for one in QGuiApplication.screens() if one is not beside.screen()), None)
        self.resize(640, 400)
        if other is None:
            corner = beside.screen().availableGeometry().bottomRight()
            self.move(corner.x() - 680, corner.y() - 460)
        else:
            self._fill(other)

    def _fill(self, screen: QScreen) -> None:
        self.setGeometry(screen.geometry())
        self.showFullScreen()

    def _on_shown(self, contents: Any) -> None:
        show_on(self._view, contents)

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        if self.isFullScreen():
            self.showNormal()
        else:
            self._fill(self.screen())
        event.accept()

    def closeEvent(self, event: QCloseEvent) -> None:
        if event.spontaneous():
            self.closed_by_hand.emit()
        super().closeEvent(event)


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
        self._name = named(QLineEdit(self._face.name, maxLength=40), "face_name", tr("Name"))
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
            field = named(QLineEdit(getattr(self._face, key), maxLength=7), f"face_{key}", tr(words))
            field.textEdited.connect(partial(self._set_colour, key))
            form.addRow(tr(words), field)
        self._speak = ActionButton(
            theme, tr("Speak"), icon="chat-text", height_px=32, objectName="face_speak", checkable=True,
            toggled=lambda on: self._motion.speak(SpokenLoudness(clock.now_ns()) if on else None),
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
            put = partial(self._set, part, key.attribute)
            slider = named(_ValueSlider(key, put), f"face_{part}_{key.attribute}")
            self._sliders[part, key.attribute] = slider
            words = tr(_SLIDERS[key.attribute])
            slider.setAccessibleName(f"{heading}: {words}")
            self._form.addRow(words, slider)
            if part != "expression":
                slider.show_value(getattr(getattr(self._face, part), key.attribute))

    def _set(self, part: str, attribute: str, value: Any) -> None:
        if part == "expression":
            at = self._choice.currentIndex()
            changed = replace(self._face.expressions[at], **{attribute: value})
            expressions = (*self._face.expressions[:at], changed, *self._face.expressions[at + 1 :])
            self._use(replace(self._face, expressions=expressions))
        else:
            self._use(replace(self._face, **{part: replace(getattr(self._face, part), **{attribute: value})}))

    def _set_colour(self, key: str, text: Any) -> None:
        try:
            self._use(checked(replace(self._face, **{key: text})))
        except FaceError:
            self._note.setText(tr("Enter the colour as #rrggbb."))

    def _use(self, face: Face) -> None:
        self._face = face
        self._motion.use(face)
        self._note.setText("")

    def _on_expression_chosen(self, index: int) -> None:
        expression = self._face.expressions[index]
        self._motion.express(expression.name)
        for (part, attribute), slider in self._sliders.items():
            if part == "expression":
                slider.show_value(getattr(expression, attribute))

    def _on_store(self) -> None:
        name = self._name.text().strip()
        refused = self._console.do(intents.KeepFace(name, face_text(self._face)))
        self._note.setText(refused or tr("Saved as “{name}”. The robot now shows this face.").format(name=name))

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
        with QSignalBlocker(self):
            self.setValue(round((value - self._least) / (self._most - self._least) * _STEPS))

    def _on_moved(self, step: int) -> None:
        self._put(round(self._least + (self._most - self._least) * step / _STEPS, 3))


def _loaded(name: str) -> Face:
    try:
        return load_face(name)
    except FaceError:
        return load_face(DEFAULT_FACE)
