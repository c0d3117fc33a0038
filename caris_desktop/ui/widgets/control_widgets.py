"""Widgets of robot controls, one per kind: button, switch, slider, choice, text, readout."""

import time
from collections.abc import Callable

from PySide6.QtCore import QRectF, QSignalBlocker, QSize, Qt, QTimer
from PySide6.QtGui import QFontMetrics, QPainter, QPaintEvent, QPen, QWheelEvent
from PySide6.QtWidgets import QAbstractButton, QBoxLayout, QLabel, QSizePolicy, QSlider, QWidget

from caris_desktop.domain.control_definitions import Choice, ControlValue, RobotControl
from caris_desktop.domain.translation import tr
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.text_formatting import value_words
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.drop_down import DropDown
from caris_desktop.ui.widgets.flow_layout import FlowRow
from caris_desktop.ui.widgets.submit_line_edit import SubmitLineEdit

SEND_EVERY_MS = 100
_SETTLE_S = 1.5  # maximum delay until a robot reports a value that was just set
_SLIDER_STEPS = 200
_CHOICES_SIDE_BY_SIDE = 4
_TITLE_PX = 92


class ControlWidget(QWidget):
    """Widget of one kind of control."""

    tip = ""

    def __init__(self, theme: Theme, control: RobotControl) -> None:
        super().__init__()
        self.theme = theme
        self.control = control
        self.value_text = ""

    def show_reading(self, value: ControlValue | None) -> None:
        """Show the reported value; None if unknown."""

    def show_state(self, state: str) -> None:
        """Show the state: ``requested``, ``succeeded``, ``failed`` or empty."""

    def forget_choice(self) -> None:
        """Discard the wizard's choice and show the actual value."""

    def set_narrow(self, narrow: bool) -> None:
        """Switch to the layout for a narrow panel."""


_STATE_ICONS = {"requested": "hourglass", "succeeded": "check", "failed": "warning"}


class _TitledFace(ControlWidget):
    """Title with the value next to it, or below in a narrow dock."""

    def __init__(self, theme: Theme, control: RobotControl) -> None:
        super().__init__(theme, control)
        self._title = QLabel(control.title)
        self._title.setToolTip(control.title)
        self.parts = layouts.hbox(spacing_px=8)
        self._row = layouts.hbox(self, margins_px=0)
        self._row.addWidget(self._title, 0, Qt.AlignmentFlag.AlignTop)
        self._row.addLayout(self.parts, 1)
        self.set_narrow(False)

    def set_narrow(self, narrow: bool) -> None:
        self._row.setDirection(row_direction(narrow=narrow))
        self._row.setSpacing(2 if narrow else 8)
        # A long title is elided instead of pushing the control out of the dock; its tooltip has it.
        self._title.setMinimumWidth(40 if narrow else _TITLE_PX)
        self._title.setMinimumHeight(0 if narrow else tokens.CONTROL_HEIGHT_PX)


def _note(text: str = "") -> QLabel:
    label = QLabel(text)
    label.setProperty("role", "note")
    return label


def row_direction(*, narrow: bool) -> QBoxLayout.Direction:
    return QBoxLayout.Direction.TopToBottom if narrow else QBoxLayout.Direction.LeftToRight


class _ButtonFace(ControlWidget):
    def __init__(self, theme: Theme, control: RobotControl, use: Callable[[ControlValue], None]) -> None:
        super().__init__(theme, control)
        self._button = ActionButton(theme, control.title, may_shrink=True)
        self._button.setObjectName(f"control_{control.id}_button")
        self._button.clicked.connect(lambda: use(True))
        self._value = _note()
        self._value.hide()
        row = layouts.hbox(self, margins_px=0)
        row.addWidget(self._button)
        row.addWidget(self._value)

    def show_reading(self, value: ControlValue | None) -> None:
        if self.control.reading is not None:
            self.value_text = "" if value is None else value_words(self.control, value)
            self._value.setText(self.value_text)
            self._value.setVisible(bool(self.value_text))

    def show_state(self, state: str) -> None:
        self._button.set_label(
            self.control.title, icon=_STATE_ICONS.get(state, ""), role="amber" if state == "failed" else "plain"
        )


class _ToggleFace(ControlWidget):
    def __init__(self, theme: Theme, control: RobotControl, use: Callable[[ControlValue], None]) -> None:
        super().__init__(theme, control)
        self._use = use
        self._reported: bool | None = None
        self._requested: bool | None = None
        self._requested_at_s = float("-inf")
        self._switch = Switch(theme, control.title)
        self._switch.setObjectName(f"control_{control.id}_switch")
        self._switch.clicked.connect(self._on_clicked)
        self._settle = QTimer(self, singleShot=True, interval=round(_SETTLE_S * 1000))
        self._settle.timeout.connect(self._refresh)
        row = layouts.hbox(self, margins_px=0)
        row.addWidget(self._switch)
        self._refresh()

    def _shown(self) -> bool | None:
        recently_set = time.monotonic() - self._requested_at_s < _SETTLE_S
        if self._requested is not None and (recently_set or self.control.reading is None):
            return self._requested
        return self._reported

    def _on_clicked(self) -> None:
        on = not self._shown()
        self._requested, self._requested_at_s = on, time.monotonic()
        self._settle.start()
        self._use(on)
        self._refresh()

    def show_reading(self, value: ControlValue | None) -> None:
        self._reported = None if value is None else bool(value)
        self._refresh()

    def show_state(self, state: str) -> None:
        self._switch.show_state(state)
        if state == "failed":
            self.forget_choice()

    def forget_choice(self) -> None:
        self._requested = None
        self._refresh()

    def _refresh(self) -> None:
        value = self._shown()
        self.value_text = tr("unknown") if value is None else tr("on") if value else tr("off")
        self._switch.show_value(value)


def _word_width(metrics: QFontMetrics) -> int:
    """Width of the switch's state text."""
    return max(metrics.horizontalAdvance(word) for word in (tr("on"), tr("off")))


class Switch(QAbstractButton):
    """Toggle switch with name and state (on, off, unknown). A click does not take the focus."""

    def __init__(self, theme: Theme, title: str) -> None:
        super().__init__()
        self._theme = theme
        self._title = title
        self._value: bool | None = None
        self._state = ""
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setSizePolicy(QSizePolicy.Policy.Maximum, QSizePolicy.Policy.Fixed)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)
        theme.changed.connect(self.update)

    def show_value(self, value: bool | None) -> None:
        self._value = value
        self.setAccessibleName(f"{self._title}: {self._word()}")
        self.update()

    def show_state(self, state: str) -> None:
        self._state = state
        self.update()

    def _word(self) -> str:
        return "?" if self._value is None else tr("on") if self._value else tr("off")

    def sizeHint(self) -> QSize:
        metrics = self.fontMetrics()
        return QSize(64 + metrics.horizontalAdvance(self._title) + 8 + _word_width(metrics) + 12,
                     tokens.CONTROL_HEIGHT_PX)  # fmt: skip

    def minimumSizeHint(self) -> QSize:
        return QSize(110, tokens.CONTROL_HEIGHT_PX)

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme, painter = self._theme, QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        rect = QRectF(self.rect()).adjusted(0.5, 0.5, -0.5, -0.5)
        if not self.isEnabled():
            painter.setOpacity(0.75)
        painter.setPen(QPen(theme.color("blue" if self.hasFocus() else "line"), 2 if self.hasFocus() else 1))
        hover = self.underMouse() and self.isEnabled()
        painter.setBrush(theme.color("raised_hover" if hover else "raised"))
        painter.drawRoundedRect(rect, tokens.CONTROL_RADIUS_PX, tokens.CONTROL_RADIUS_PX)
        track = QRectF(10, self.height() / 2 - 9, 34, 18)
        on = bool(self._value)
        dashed = self._value is None or self._state == "requested"
        pen = QPen(theme.color("blue" if on else "dim"), 1.4, Qt.PenStyle.DotLine if dashed else Qt.PenStyle.SolidLine)
        painter.setPen(pen)
        painter.setBrush(theme.color("blue") if on and self._state != "requested" else Qt.BrushStyle.NoBrush)
        painter.drawRoundedRect(track, 9, 9)
        left = track.center().x() - 6 if self._value is None else track.right() - 15 if on else track.left() + 3
        painter.setPen(Qt.PenStyle.NoPen)
        solid = on and self._state != "requested"
        painter.setBrush(theme.color("on_blue" if solid else "blue" if on else "dim"))
        painter.drawEllipse(QRectF(left, track.center().y() - 6, 12, 12))
        painter.setFont(theme.font())
        painter.setPen(theme.color("text" if self.isEnabled() else "dim"))
        word_width = _word_width(self.fontMetrics())
        text = QRectF(54, 0, self.width() - 54 - word_width - 20, self.height())
        elided = self.fontMetrics().elidedText(self._title, Qt.TextElideMode.ElideRight, int(text.width()) + 1)
        painter.drawText(text, int(Qt.AlignmentFlag.AlignVCenter), elided)
        painter.setPen(theme.color("amber" if self._state == "failed" else "dim"))
        painter.drawText(
            QRectF(self.width() - word_width - 12, 0, word_width + 4, self.height()),
            int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft), self._word(),
        )  # fmt: skip


class _SliderFace(_TitledFace):
    """Slider that sends at most ten values per second while dragged, and always the final one."""

    def __init__(self, theme: Theme, control: RobotControl, use: Callable[[ControlValue], None]) -> None:
        super().__init__(theme, control)
        self._use = use
        self._steps = _SLIDER_STEPS
        if control.step > 0:
            self._steps = max(1, round((control.highest - control.lowest) / control.step))
        self._reported: float | None = None
        self._set: float | None = None
        self._sent: float | None = None
        self._last_use_s = float("-inf")
        self._value = _note()
        self._value.setObjectName("control_value")
        self._slider = _CalmSlider(Qt.Orientation.Horizontal)
        self._slider.setObjectName(f"control_{control.id}_slider")
        self._slider.setAccessibleName(control.title)
        self._slider.setRange(0, self._steps)
        self._slider.setSingleStep(1 if control.step > 0 else 4)
        self._slider.setPageStep(max(1, self._steps // 10))
        self._slider.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self._slider.valueChanged.connect(self._on_value_changed)
        self._slider.sliderReleased.connect(self._on_released)
        self._throttle = QTimer(self, singleShot=True, interval=SEND_EVERY_MS)
        self._throttle.timeout.connect(self._send)
        self._settle = QTimer(self, singleShot=True, interval=round(_SETTLE_S * 1000))
        self._settle.timeout.connect(self._follow)
        self._value.setMinimumWidth(64)
        self._value.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        self.parts.addWidget(self._slider, 1)
        self.parts.addWidget(self._value)
        self._slider.setMaximumWidth(420)
        self.setMinimumHeight(tokens.CONTROL_HEIGHT_PX)
        self._follow()

    def _chosen(self) -> float:
        control = self.control
        value = control.lowest + (control.highest - control.lowest) * self._slider.value() / self._steps
        return round(value, 6)

    def _on_value_changed(self, _position: int) -> None:
        self._set = self._chosen()
        self._last_use_s = time.monotonic()
        self._settle.start()
        self._refresh()
        if self.control.confirm and self._slider.isSliderDown():
            return
        if not self._throttle.isActive():
            self._send()

    def _on_released(self) -> None:
        if self.control.confirm and self._set is not None:
            self._send()

    def _send(self) -> None:
        if self._set is not None and self._set != self._sent:
            self._sent = self._set
            self._throttle.start()
            self._use(self._set)

    def show_reading(self, value: ControlValue | None) -> None:
        self._reported = None if value is None or isinstance(value, str) else float(value)
        self._follow()

    def show_state(self, state: str) -> None:
        if state == "failed":
            self._sent = None  # allow sending the same value again

    def forget_choice(self) -> None:
        self._set = self._sent = None
        self._last_use_s = float("-inf")
        self._follow()

    def _follow(self) -> None:
        """Follow the reported value, unless the wizard has just moved the slider."""
        lately = time.monotonic() - self._last_use_s < _SETTLE_S or self._slider.isSliderDown()
        value = self._set if lately or self._reported is None else self._reported
        if value is not None and not lately:
            control = self.control
            share = (value - control.lowest) / (control.highest - control.lowest or 1.0)
            with QSignalBlocker(self._slider):
                self._slider.setValue(round(min(1.0, max(0.0, share)) * self._steps))
            self._sent = self._set = None if self._reported is not None else self._set
        self._refresh()

    def _refresh(self) -> None:
        value = self._set if self._set is not None else self._reported
        self.value_text = tr("not set yet") if value is None else value_words(self.control, value)
        self._value.setText(self.value_text)


class _CalmSlider(QSlider):
    """Slider that ignores the wheel: scrolling the panel must not change the robot's volume."""

    def wheelEvent(self, event: QWheelEvent) -> None:
        event.ignore()


class _ChoiceFace(_TitledFace):
    """Few choices as buttons, more as a list."""

    def __init__(self, theme: Theme, control: RobotControl, use: Callable[[ControlValue], None]) -> None:
        super().__init__(theme, control)
        self._use = use
        self._chosen: ControlValue | None = None
        self._reported: ControlValue | None = None
        self._buttons: list[tuple[Choice, ActionButton]] = []
        self._list: DropDown | None = None
        if len(control.choices) <= _CHOICES_SIDE_BY_SIDE:
            flow = FlowRow(gap_px=6)
            for number, choice in enumerate(control.choices):
                button = ActionButton(theme, choice.title, may_shrink=True)
                button.setObjectName(f"control_{control.id}_choice_{number}")
                button.setAccessibleName(f"{control.title}: {choice.title}")
                button.setCheckable(True)
                button.clicked.connect(lambda _checked=False, choice=choice: self._choose(choice))
                self._buttons.append((choice, button))
                flow.add(button)
            self.parts.addWidget(flow, 1)
        else:
            box = self._list = DropDown(theme, f"control_{control.id}_list", control.title)
            box.setPlaceholderText(tr("Choose…"))
            box.addItems([choice.title for choice in control.choices])
            box.activated.connect(lambda index: self._choose(control.choices[index]))
            self.parts.addWidget(box, 1)
        self._refresh()

    def _choose(self, choice: Choice) -> None:
        self._chosen = choice.value
        self._use(choice.value)
        self._refresh()

    def show_reading(self, value: ControlValue | None) -> None:
        if value != self._reported:
            self._reported = value
            self._chosen = None
        self._refresh()

    def show_state(self, state: str) -> None:
        if state == "failed":
            self.forget_choice()

    def forget_choice(self) -> None:
        self._chosen = None
        self._refresh()

    def _refresh(self) -> None:
        value = self._chosen if self._chosen is not None else self._reported
        index = next((at for at, choice in enumerate(self.control.choices) if choice.value == value), -1)
        self.value_text = self.control.choices[index].title if index >= 0 else ""
        for at, (_choice, button) in enumerate(self._buttons):
            button.setChecked(at == index)
            button.set_label(button.text(), icon="check" if at == index else "")
        if self._list is not None:
            self._list.setCurrentIndex(index)


class _TextFace(_TitledFace):
    def __init__(self, theme: Theme, control: RobotControl, use: Callable[[ControlValue], None]) -> None:
        super().__init__(theme, control)
        self._use = use
        self._now = _note()
        self._field = SubmitLineEdit()
        self._field.setObjectName(f"control_{control.id}_field")
        self._field.setAccessibleName(control.title)
        self._field.setMaxLength(500)
        self._field.setMinimumHeight(tokens.CONTROL_HEIGHT_PX)
        self._field.returnPressed.connect(self._on_send)
        send = ActionButton(theme, tr("Send"), icon="paper-plane-right")
        send.setObjectName(f"control_{control.id}_send")
        send.setAccessibleName(tr("{control}: send").format(control=control.title))
        send.clicked.connect(self._on_send)
        self.parts.addWidget(self._field, 1)
        self.parts.addWidget(send)
        self.parts.addWidget(self._now)

    def show_reading(self, value: ControlValue | None) -> None:
        self.value_text = "" if value is None else value_words(self.control, value)
        self._now.setText(self._now.fontMetrics().elidedText(self.value_text, Qt.TextElideMode.ElideRight, 160))

    def _on_send(self) -> None:
        self._use(self._field.text())
        self._field.selectAll()


class _ReadoutFace(ControlWidget):
    def __init__(self, theme: Theme, control: RobotControl) -> None:
        super().__init__(theme, control)
        self.setProperty("role", "readout")
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self._title = _note(control.title)
        self._title.setMinimumWidth(40)
        self._value = QLabel()
        self._value.setObjectName("control_value")
        self._value.setProperty("role", "title")
        row = layouts.hbox(self, margins_px=(10, 4, 10, 4), spacing_px=8)
        row.addWidget(self._title)
        row.addWidget(self._value)
        self.setMinimumHeight(tokens.CONTROL_HEIGHT_PX)
        self.show_reading(None)

    def show_reading(self, value: ControlValue | None) -> None:
        self.value_text = "" if value is None else value_words(self.control, value)
        text = self.value_text or tr("no value yet")
        self._value.setText(text if len(text) <= 40 else text[:39] + "…")
        self._value.setEnabled(bool(self.value_text))
        self.tip = "" if value is None else f"{self.control.title}: {value}"
        self.setToolTip(self.tip)


def create_control_widget(theme: Theme, control: RobotControl, use: Callable[[ControlValue], None]) -> ControlWidget:
    match control.kind:
        case "button":
            return _ButtonFace(theme, control, use)
        case "toggle":
            return _ToggleFace(theme, control, use)
        case "slider":
            return _SliderFace(theme, control, use)
        case "choice":
            return _ChoiceFace(theme, control, use)
        case "text":
            return _TextFace(theme, control, use)
        case "readout":
            return _ReadoutFace(theme, control)
