"""Robot: the buttons, toggles, sliders, choices, texts and readouts that the profile and the scenario bind to it."""

import time
from collections.abc import Callable

from PySide6.QtCore import QRectF, QSignalBlocker, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QKeyEvent, QPainter, QPaintEvent, QPen, QResizeEvent, QWheelEvent
from PySide6.QtWidgets import (
    QAbstractButton,
    QBoxLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QScrollArea,
    QSizePolicy,
    QSlider,
    QStackedLayout,
    QVBoxLayout,
    QWidget,
)

from caris_desktop.domain import intents
from caris_desktop.domain.controls import Choice, ControlValue, RobotControl
from caris_desktop.domain.sensing import ControlReadings
from caris_desktop.live.status import ControlStatus, DriveStatus, LinkStatus
from caris_desktop.ui import tokens
from caris_desktop.ui.panel import Panel, PanelContext
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.drop_down import DropDown
from caris_desktop.ui.widgets.flow_layout import FlowRow

SEND_EVERY_MS = 100
ASKING_ENDS_AFTER_MS = 10_000
_DONE_SHOWN_MS = 1500
_SETTLE_S = 1.5  # how long a robot may take to tell the value that it was just given
_SLIDER_STEPS = 200
_CHOICES_SIDE_BY_SIDE = 4
_NARROW_PX = 340
_WIDEST_HEADING_PX = 110
_TITLE_PX = 92
_COMPACT = ("button", "toggle", "readout")
_NOT_USABLE = {
    "connecting": "Still connecting to the robot.",
    "lost": "The robot is out of reach.",
    "closed": "No robot is connected.",
}
_HELD = "The emergency stop is on. What moves the robot works again when you release it."


def value_words(control: RobotControl, value: ControlValue) -> str:
    """The value as a wizard reads it: on, 62 %, Welcome."""
    for choice in control.choices:
        if choice.value == value and isinstance(choice.value, bool) == isinstance(value, bool):
            return choice.title
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, str):
        return value or "empty"
    number = f"{value:.{_decimals(control, value)}f}"
    return f"{number} {control.unit}" if control.unit else number


def _decimals(control: RobotControl, value: float) -> int:
    if control.step > 0:
        return len(f"{control.step:.3f}".rstrip("0").partition(".")[2])
    if control.kind != "slider" and float(value).is_integer():
        return 0
    size = control.highest - control.lowest if control.kind == "slider" else abs(value)
    return 0 if size >= 100 else 1 if size >= 10 else 2


class RobotPanel(Panel):
    """Draws ``state.controls`` by their kinds. Nothing in here knows any robot."""

    title = "Robot"

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("robot_panel")
        self._entries: dict[str, ControlEntry] = {}
        self._groups: list[_Group] = []
        self._held: bool = self.state.drive.value.emergency_stop
        self._empty = QLabel()
        self._empty.setObjectName("robot_empty")
        self._empty.setWordWrap(True)
        self._empty.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self._reason = QLabel()
        self._reason.setObjectName("robot_reason")
        self._reason.setWordWrap(True)
        self._reason.hide()
        self._scroll = QScrollArea()
        self._scroll.setWidgetResizable(True)
        self._scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self._scroll.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        holder = QWidget()
        self._stack = QStackedLayout(holder)
        centered = QWidget()
        column = QVBoxLayout(centered)
        column.setContentsMargins(24, 8, 24, 8)
        column.addWidget(self._empty)
        self._stack.addWidget(centered)
        self._stack.addWidget(self._scroll)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(2, 0, 2, 2)
        layout.setSpacing(0)
        layout.addWidget(self._reason)
        layout.addWidget(holder, 1)
        self._reason.setContentsMargins(12, 8, 12, 0)
        self.state.controls.changed.connect(self._on_controls_changed)
        self.state.control_states.changed.connect(self._on_states_changed)
        self.state.readings.changed.connect(self._on_readings_changed)
        self.state.readings.freshness_changed.connect(self._on_readings_freshness_changed)
        self.state.link.changed.connect(self._on_link_changed)
        self.state.drive.changed.connect(self._on_drive_changed)
        self.state.robot.changed.connect(self._on_robot_changed)
        self.hold.escape_pressed.connect(self._on_escape)
        self.theme.changed.connect(self._style)
        self._on_controls_changed(self.state.controls.value)

    def sizeHint(self) -> QSize:
        return QSize(340, 260)

    def minimumSizeHint(self) -> QSize:
        return QSize(180, 80)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._fold()

    def _fold(self) -> None:
        for block in self._groups:
            block.set_narrow(self.width() < _NARROW_PX)

    def entry(self, control_id: str) -> "ControlEntry | None":
        return self._entries.get(control_id)

    def _on_controls_changed(self, controls: tuple[RobotControl, ...]) -> None:
        self._entries = {}
        body = QWidget()
        column = QVBoxLayout(body)
        column.setContentsMargins(12, 10, 12, 12)
        column.setSpacing(8)
        groups: dict[str, list[RobotControl]] = {}
        for control in controls:
            groups.setdefault(control.group, []).append(control)
        heading_px = max((_Heading(self.theme, group).sizeHint().width() for group in groups), default=0)
        self._groups = []
        for group, members in groups.items():
            block = _Group(self.theme, group, heading_px=min(_WIDEST_HEADING_PX, heading_px))
            for control in members:
                entry = ControlEntry(self.theme, control)
                entry.used.connect(lambda control_id, value: self.console.do(intents.UseControl(control_id, value)))
                self._entries[control.id] = entry
                block.add(entry)
            self._groups.append(block)
            column.addWidget(block)
        self._fold()
        column.addStretch(1)
        old = self._scroll.takeWidget()
        if old is not None:
            old.deleteLater()
        self._scroll.setWidget(body)
        self._on_states_changed(self.state.control_states.value)
        self._on_readings_changed(self.state.readings.value)
        self._refresh()

    def _on_states_changed(self, states: dict[str, ControlStatus]) -> None:
        for control_id, entry in self._entries.items():
            status = states.get(control_id)
            if status is not None:
                entry.show_status(status)
        self._refresh()

    def _on_readings_changed(self, readings: ControlReadings | None) -> None:
        values = {} if readings is None else readings.values
        for control_id, entry in self._entries.items():
            entry.show_reading(values.get(control_id))

    def _on_readings_freshness_changed(self, freshness: str) -> None:
        if freshness == "none":
            self._on_readings_changed(None)

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        if drive.emergency_stop != self._held:
            self._held = drive.emergency_stop
            self._refresh()

    def _on_link_changed(self, _link: LinkStatus) -> None:
        self._refresh()

    def _on_robot_changed(self, _robot: object) -> None:
        self._refresh()

    def _on_escape(self) -> None:
        for entry in self._entries.values():
            entry.stop_asking()

    def _refresh(self) -> None:
        link: LinkStatus = self.state.link.value
        reason = _NOT_USABLE.get(link.state, "") if self.state.present.live else ""
        held = ""
        for entry in self._entries.values():
            entry_held = _HELD if self._held and entry.control.is_motion else ""
            entry.set_usable(reason or entry_held)
            held = held or entry_held
        shown = f"{reason} These controls work again when it answers." if reason else held
        self._reason.setText(shown)
        self._reason.setVisible(bool(shown and self._entries))
        self._stack.setCurrentIndex(1 if self._entries else 0)
        whose = link.robot or "This robot"
        self._empty.setText(
            f"{whose} has no controls of its own.\nIts profile or the scenario can bind buttons, switches, sliders "
            "and readouts to it."
        )
        failed = sum(entry.failed for entry in self._entries.values())
        busy = [entry for entry in self._entries.values() if entry.busy]
        if reason:
            self.set_fact("robot away", "amber")
        elif held:
            self.set_fact("held by the emergency stop", "amber")
        elif busy:
            self.set_fact(f"{busy[0].control.title}: asked", "blue")
        elif failed:
            self.set_fact(f"{failed} did not work", "amber")
        else:
            self.set_fact(f"{len(self._entries)} controls" if self._entries else "", "dim")
        self._style()

    def _style(self) -> None:
        for label, role in ((self._empty, "dim"), (self._reason, "amber")):
            label.setFont(self.theme.font(tokens.BODY_PX if label is self._empty else tokens.STATUS_PX))
            _color(label, self.theme, role)


class ControlEntry(QWidget):
    """One control with what became of it: asked, done, failed; and the question before it where it wants one."""

    used = Signal(str, object)  # control id, value

    def __init__(self, theme: Theme, control: RobotControl) -> None:
        super().__init__()
        self.setObjectName(f"control_{control.id}")
        self._theme = theme
        self.control = control
        self._status: ControlStatus | None = None
        self._reason = ""
        self._asking: ControlValue | None = None
        self._note = QLabel()
        self._note.setObjectName("control_note")
        self._note.setWordWrap(True)
        self._note.setTextFormat(Qt.TextFormat.PlainText)
        self._note.hide()
        self._question = _Question(theme)
        self._question.answered.connect(self._on_answered)
        self._question.hide()
        self._face = _face_for(theme, control, self._on_used)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(4)
        column.addWidget(self._face)
        column.addWidget(self._question)
        if control.kind not in _COMPACT:
            column.addWidget(self._note)
        if control.kind in _COMPACT:
            self.setSizePolicy(QSizePolicy.Policy.Maximum, QSizePolicy.Policy.Fixed)
        self._calm_down = QTimer(self, singleShot=True, interval=_DONE_SHOWN_MS)
        self._calm_down.timeout.connect(self._on_done_shown)
        self._give_up_asking = QTimer(self, singleShot=True, interval=ASKING_ENDS_AFTER_MS)
        self._give_up_asking.timeout.connect(self.stop_asking)
        theme.changed.connect(self._show)
        self._show()

    @property
    def note(self) -> QLabel:
        """What became of it, in words. That of a small control stands in the line below its row."""
        return self._note

    @property
    def busy(self) -> bool:
        return self._status is not None and self._status.state == "requested"

    @property
    def failed(self) -> bool:
        return self._status is not None and self._status.state == "failed"

    @property
    def note_text(self) -> str:
        return "" if self._note.isHidden() else self._note.text()

    @property
    def value_text(self) -> str:
        """What is shown as the present value."""
        return self._face.value_text

    def show_status(self, status: ControlStatus) -> None:
        if status == self._status:
            return
        self._status = status
        self._calm_down.stop()
        if status.state == "succeeded":
            self._calm_down.start()
        self._show()

    def show_reading(self, value: ControlValue | None) -> None:
        self._face.show_reading(value)

    def set_usable(self, reason: str) -> None:
        """Empty where it can be used."""
        if reason != self._reason:
            self._reason = reason
            if reason:
                self.stop_asking()
            self._show()

    def set_narrow(self, narrow: bool) -> None:
        self._face.set_narrow(narrow)

    def stop_asking(self) -> None:
        if self._asking is not None:
            self._asking = None
            self._give_up_asking.stop()
            self._face.forget_choice()
            self._show()

    def _on_used(self, value: ControlValue) -> None:
        if self._reason:
            return
        if not self.control.confirm:
            self.used.emit(self.control.id, value)
            return
        self._asking = value
        self._give_up_asking.start()
        self._show()

    def _on_answered(self, yes: bool) -> None:
        value, self._asking = self._asking, None
        self._give_up_asking.stop()
        if yes and value is not None:
            self.used.emit(self.control.id, value)
        else:
            self._face.forget_choice()
        self._show()

    def _on_done_shown(self) -> None:
        self._show(done=False)

    def _show(self, *, done: bool = True) -> None:
        status, control = self._status, self.control
        asking = self._asking is not None
        self._question.setVisible(asking)
        # A button gives way to the question: the next click is meant for that.
        self._face.setVisible(not (asking and control.kind == "button"))
        if self._asking is not None:
            self._question.ask(question_for(control, self._asking))
        self._face.setEnabled(not self._reason)
        state = "" if status is None else status.state
        if state == "succeeded" and not (done and self._calm_down.isActive()):
            state = ""
        self._face.show_state(state)
        words = {"requested": "asked the robot…", "failed": "did not work"}.get(state, "")
        if status is not None and state == "failed" and status.detail:
            words = f"did not work: {status.detail}"
        elif status is not None and state == "succeeded" and status.detail:
            words = f"done: {status.detail}"
        compact = control.kind in _COMPACT
        shown = "" if compact and state == "requested" else words
        self._note.setFont(self._theme.font(tokens.STATUS_PX))
        self._note.setText(f"{control.title} {shown}" if compact and shown else shown)
        self._note.setVisible(bool(shown) and not asking)
        _color(self._note, self._theme, "amber" if state == "failed" else "dim")
        tip = self._reason or words
        self._face.setToolTip(f"{control.title}: {tip}" if tip else self._face.tip)
        self._note.setToolTip(words)
        self._face.setAccessibleDescription(tip)
        self.updateGeometry()


def question_for(control: RobotControl, value: ControlValue) -> str:
    if control.kind == "button":
        return f"{control.title}?"
    if control.kind == "toggle":
        return f"{control.title} {'on' if value else 'off'}?"
    return f"{control.title}: {value_words(control, value)}?"


class _Question(QWidget):
    answered = Signal(bool)

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._theme = theme
        self._words = QLabel()
        self._words.setTextFormat(Qt.TextFormat.PlainText)
        self.yes = ActionButton(theme, "Do it", look="amber", height_px=30)
        self.yes.setObjectName("control_confirm")
        self.yes.clicked.connect(lambda: self.answered.emit(True))
        no = ActionButton(theme, "Cancel", look="ghost", height_px=30)
        no.setObjectName("control_cancel")
        no.clicked.connect(lambda: self.answered.emit(False))
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 2, 0, 2)
        row.setSpacing(6)
        row.addWidget(self._words)
        row.addWidget(self.yes)
        row.addWidget(no)
        row.addStretch(1)

    def ask(self, words: str) -> None:
        self._words.setFont(self._theme.font(tokens.BODY_PX, tokens.WEIGHT_MEDIUM))
        self._words.setText(words)
        self.yes.setAccessibleName(f"{words} Do it")


class _Face(QWidget):
    """What is drawn for one kind of control."""

    tip = ""

    def __init__(self, theme: Theme, control: RobotControl) -> None:
        super().__init__()
        self.theme = theme
        self.control = control
        self.value_text = ""

    def show_reading(self, value: ControlValue | None) -> None:
        """What the robot tells of it; None where it does not (any more)."""

    def show_state(self, state: str) -> None:
        """``requested``, ``succeeded``, ``failed`` or empty."""

    def forget_choice(self) -> None:
        """The wizard thought better of it: show again what is."""

    def set_narrow(self, narrow: bool) -> None:
        """Whether there is only room for one thing beside another."""


_STATE_ICONS = {"requested": "hourglass", "succeeded": "check", "failed": "warning"}


class _TitledFace(_Face):
    """The title, and beside it, or in a narrow dock below it, what is set."""

    def __init__(self, theme: Theme, control: RobotControl) -> None:
        super().__init__(theme, control)
        self._title = QLabel(control.title)
        self._title.setToolTip(control.title)
        self.parts = QHBoxLayout()
        self.parts.setSpacing(8)
        self._row = QHBoxLayout(self)
        self._row.setContentsMargins(0, 0, 0, 0)
        self._row.addWidget(self._title, 0, Qt.AlignmentFlag.AlignTop)
        self._row.addLayout(self.parts, 1)
        self.set_narrow(False)

    def set_narrow(self, narrow: bool) -> None:
        self._row.setDirection(_direction(narrow=narrow))
        self._row.setSpacing(2 if narrow else 8)
        # A long title is cut short rather than pushing the control out of the dock; its tooltip has it all.
        self._title.setMinimumWidth(40 if narrow else _TITLE_PX)
        self._title.setMinimumHeight(0 if narrow else tokens.CONTROL_HEIGHT_PX)


def _direction(*, narrow: bool) -> QBoxLayout.Direction:
    return QBoxLayout.Direction.TopToBottom if narrow else QBoxLayout.Direction.LeftToRight


class _ButtonFace(_Face):
    def __init__(self, theme: Theme, control: RobotControl, use: Callable[[ControlValue], None]) -> None:
        super().__init__(theme, control)
        self._button = ActionButton(theme, control.title, may_shrink=True)
        self._button.setObjectName(f"control_{control.id}_button")
        self._button.clicked.connect(lambda: use(True))
        self._value = QLabel()
        self._value.hide()
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(self._button)
        row.addWidget(self._value)
        theme.changed.connect(self._style)
        self._style()

    def _style(self) -> None:
        self._value.setFont(self.theme.font(tokens.STATUS_PX))
        _color(self._value, self.theme, "dim")

    def show_reading(self, value: ControlValue | None) -> None:
        if self.control.reading is not None:
            self.value_text = "" if value is None else value_words(self.control, value)
            self._value.setText(self.value_text)
            self._value.setVisible(bool(self.value_text))

    def show_state(self, state: str) -> None:
        self._button.set_label(
            self.control.title, icon=_STATE_ICONS.get(state, ""), look="amber" if state == "failed" else "plain"
        )


class _ToggleFace(_Face):
    def __init__(self, theme: Theme, control: RobotControl, use: Callable[[ControlValue], None]) -> None:
        super().__init__(theme, control)
        self._use = use
        self._told: bool | None = None
        self._asked: bool | None = None
        self._asked_at_s = float("-inf")
        self._switch = Switch(theme, control.title)
        self._switch.setObjectName(f"control_{control.id}_switch")
        self._switch.clicked.connect(self._on_clicked)
        self._settle = QTimer(self, singleShot=True, interval=round(_SETTLE_S * 1000))
        self._settle.timeout.connect(self._refresh)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(self._switch)
        self._refresh()

    def _shown(self) -> bool | None:
        asked_lately = time.monotonic() - self._asked_at_s < _SETTLE_S
        if self._asked is not None and (asked_lately or self.control.reading is None):
            return self._asked
        return self._told

    def _on_clicked(self) -> None:
        wanted = not self._shown()
        self._asked, self._asked_at_s = wanted, time.monotonic()
        self._settle.start()
        self._use(wanted)
        self._refresh()

    def show_reading(self, value: ControlValue | None) -> None:
        self._told = None if value is None else bool(value)
        self._refresh()

    def show_state(self, state: str) -> None:
        self._switch.show_state(state)
        if state == "failed":
            self.forget_choice()

    def forget_choice(self) -> None:
        self._asked = None
        self._refresh()

    def _refresh(self) -> None:
        shown = self._shown()
        self.value_text = "unknown" if shown is None else "on" if shown else "off"
        self._switch.show_value(shown)


class Switch(QAbstractButton):
    """A sliding switch with its name, and on, off or unknown in words. Takes no focus from a click."""

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
        return "?" if self._value is None else "on" if self._value else "off"

    def sizeHint(self) -> QSize:
        metrics = self.fontMetrics()
        return QSize(64 + metrics.horizontalAdvance(self._title) + 8 + metrics.horizontalAdvance("off") + 12,
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
        word_width = self.fontMetrics().horizontalAdvance("off")
        text = QRectF(54, 0, self.width() - 54 - word_width - 20, self.height())
        shown = self.fontMetrics().elidedText(self._title, Qt.TextElideMode.ElideRight, int(text.width()) + 1)
        painter.drawText(text, int(Qt.AlignmentFlag.AlignVCenter), shown)
        painter.setPen(theme.color("amber" if self._state == "failed" else "dim"))
        painter.drawText(
            QRectF(self.width() - word_width - 12, 0, word_width + 4, self.height()),
            int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft), self._word(),
        )  # fmt: skip


class _SliderFace(_TitledFace):
    """Sends while it is dragged, ten times a second at most, and always the value that it is left at."""

    def __init__(self, theme: Theme, control: RobotControl, use: Callable[[ControlValue], None]) -> None:
        super().__init__(theme, control)
        self._use = use
        self._steps = _SLIDER_STEPS
        if control.step > 0:
            self._steps = max(1, round((control.highest - control.lowest) / control.step))
        self._told: float | None = None
        self._set: float | None = None
        self._sent: float | None = None
        self._last_use_s = float("-inf")
        self._value = QLabel()
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
        theme.changed.connect(self._style)
        self._style()
        self._follow()

    def _style(self) -> None:
        self._value.setFont(self.theme.font(tokens.STATUS_PX))
        _color(self._value, self.theme, "dim")

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
        self._told = None if value is None or isinstance(value, str) else float(value)
        self._follow()

    def show_state(self, state: str) -> None:
        if state == "failed":
            self._sent = None  # the same value may be tried again

    def forget_choice(self) -> None:
        self._set = self._sent = None
        self._last_use_s = float("-inf")
        self._follow()

    def _follow(self) -> None:
        """Go where the robot says that it is, unless the wizard has just moved it."""
        lately = time.monotonic() - self._last_use_s < _SETTLE_S or self._slider.isSliderDown()
        shown = self._set if lately or self._told is None else self._told
        if shown is not None and not lately:
            control = self.control
            share = (shown - control.lowest) / (control.highest - control.lowest or 1.0)
            with QSignalBlocker(self._slider):
                self._slider.setValue(round(min(1.0, max(0.0, share)) * self._steps))
            self._sent = self._set = None if self._told is not None else self._set
        self._refresh()

    def _refresh(self) -> None:
        shown = self._set if self._set is not None else self._told
        self.value_text = "not set yet" if shown is None else value_words(self.control, shown)
        self._value.setText(self.value_text)


class _CalmSlider(QSlider):
    """A slider that the wheel passes by: who scrolls the panel does not turn the robot's volume."""

    def wheelEvent(self, event: QWheelEvent) -> None:
        event.ignore()


class _ChoiceFace(_TitledFace):
    """A few choices side by side, more of them in a list."""

    def __init__(self, theme: Theme, control: RobotControl, use: Callable[[ControlValue], None]) -> None:
        super().__init__(theme, control)
        self._use = use
        self._chosen: ControlValue | None = None
        self._told: ControlValue | None = None
        self._buttons: list[tuple[Choice, ActionButton]] = []
        self._list: DropDown | None = None
        if len(control.choices) <= _CHOICES_SIDE_BY_SIDE:
            flow = FlowRow(gap_px=6)
            for number, choice in enumerate(control.choices):
                button = ActionButton(theme, choice.title, may_shrink=True)
                button.setObjectName(f"control_{control.id}_choice_{number}")
                button.setAccessibleName(f"{control.title}: {choice.title}")
                button.setCheckable(True)
                button.clicked.connect(self._chooser(choice))
                self._buttons.append((choice, button))
                flow.add(button)
            self.parts.addWidget(flow, 1)
        else:
            box = self._list = DropDown(theme, f"control_{control.id}_list", control.title)
            box.setPlaceholderText("Choose…")
            box.addItems([choice.title for choice in control.choices])
            box.activated.connect(lambda index: self._choose(control.choices[index]))
            self.parts.addWidget(box, 1)
        self._refresh()

    def _chooser(self, choice: Choice) -> Callable[[], None]:
        return lambda: self._choose(choice)

    def _choose(self, choice: Choice) -> None:
        self._chosen = choice.value
        self._use(choice.value)
        self._refresh()

    def show_reading(self, value: ControlValue | None) -> None:
        if value != self._told:
            self._told = value
            self._chosen = None
        self._refresh()

    def show_state(self, state: str) -> None:
        if state == "failed":
            self.forget_choice()

    def forget_choice(self) -> None:
        self._chosen = None
        self._refresh()

    def _refresh(self) -> None:
        value = self._chosen if self._chosen is not None else self._told
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
        self._now = QLabel()
        self._now.setTextFormat(Qt.TextFormat.PlainText)
        self._field = _SendField()
        self._field.setObjectName(f"control_{control.id}_field")
        self._field.setAccessibleName(control.title)
        self._field.setMaxLength(500)
        self._field.setMinimumHeight(tokens.CONTROL_HEIGHT_PX)
        self._field.returnPressed.connect(self._on_send)
        send = ActionButton(theme, "Send", icon="paper-plane-right")
        send.setObjectName(f"control_{control.id}_send")
        send.setAccessibleName(f"{control.title}: send")
        send.clicked.connect(self._on_send)
        self.parts.addWidget(self._field, 1)
        self.parts.addWidget(send)
        self.parts.addWidget(self._now)
        theme.changed.connect(self._style)
        self._style()

    def _style(self) -> None:
        self._now.setFont(self.theme.font(tokens.STATUS_PX))
        _color(self._now, self.theme, "dim")

    def show_reading(self, value: ControlValue | None) -> None:
        self.value_text = "" if value is None else value_words(self.control, value)
        self._now.setText(self._now.fontMetrics().elidedText(self.value_text, Qt.TextElideMode.ElideRight, 160))

    def _on_send(self) -> None:
        self._use(self._field.text())
        self._field.selectAll()


class _SendField(QLineEdit):
    """Enter in it says nothing to the rest of the window."""

    def keyPressEvent(self, event: QKeyEvent) -> None:
        super().keyPressEvent(event)
        event.accept()


class _ReadoutFace(_Face):
    def __init__(self, theme: Theme, control: RobotControl) -> None:
        super().__init__(theme, control)
        self._title = QLabel(control.title)
        self._title.setMinimumWidth(40)
        self._value = QLabel()
        self._value.setObjectName("control_value")
        self._value.setTextFormat(Qt.TextFormat.PlainText)
        row = QHBoxLayout(self)
        row.setContentsMargins(10, 4, 10, 4)
        row.setSpacing(8)
        row.addWidget(self._title)
        row.addWidget(self._value)
        self.setMinimumHeight(tokens.CONTROL_HEIGHT_PX)
        theme.changed.connect(self._style)
        self.show_reading(None)
        self._style()

    def _style(self) -> None:
        self._title.setFont(self.theme.font(tokens.STATUS_PX))
        self._value.setFont(self.theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD))
        _color(self._title, self.theme, "dim")
        _color(self._value, self.theme, "text" if self.value_text else "dim")
        self.update()

    def show_reading(self, value: ControlValue | None) -> None:
        self.value_text = "" if value is None else value_words(self.control, value)
        shown = self.value_text or "not told yet"
        self._value.setText(shown if len(shown) <= 40 else shown[:39] + "…")
        self.tip = "" if value is None else f"{self.control.title}: {value}"
        self.setToolTip(self.tip)
        self._style()

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(QPen(self.theme.color("line"), 1))
        rect = QRectF(self.rect()).adjusted(0.5, 0.5, -0.5, -0.5)
        painter.drawRoundedRect(rect, tokens.CONTROL_RADIUS_PX, tokens.CONTROL_RADIUS_PX)


def _face_for(theme: Theme, control: RobotControl, use: Callable[[ControlValue], None]) -> _Face:
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


class _Group(QWidget):
    """A heading and its controls: beside one another, in a narrow dock above one another."""

    def __init__(self, theme: Theme, name: str, *, heading_px: int) -> None:
        super().__init__()
        self._heading_px = heading_px
        self._entries: list[ControlEntry] = []
        self._heading = _Heading(theme, name)
        self._column = QVBoxLayout()
        self._column.setSpacing(6)
        self._flow: FlowRow | None = None
        self._row = QHBoxLayout(self)
        self._row.setContentsMargins(0, 0, 0, 0)
        self._row.addWidget(self._heading, 0, Qt.AlignmentFlag.AlignTop)
        self._row.addLayout(self._column, 1)
        self.set_narrow(False)

    def add(self, entry: "ControlEntry") -> None:
        self._entries.append(entry)
        if entry.control.kind not in _COMPACT:
            self._flow = None
            self._column.addWidget(entry)
            return
        if self._flow is None:
            self._flow = FlowRow(gap_px=tokens.GRID_PX)
            self._column.addWidget(self._flow)
        self._flow.add(entry)
        self._column.addWidget(entry.note)

    def set_narrow(self, narrow: bool) -> None:
        self._row.setDirection(_direction(narrow=narrow))
        for entry in self._entries:
            entry.set_narrow(narrow)
        self._row.setSpacing(4 if narrow else 12)
        named = bool(self._heading.text())
        self._heading.setVisible(named or not narrow)
        if narrow:
            self._heading.setMinimumSize(0, 0)
            self._heading.setMaximumSize(16777215, 16777215)
        else:
            self._heading.setFixedSize(self._heading_px, tokens.CONTROL_HEIGHT_PX)


class _Heading(QLabel):
    def __init__(self, theme: Theme, text: str) -> None:
        super().__init__(text)
        self._theme = theme
        theme.changed.connect(self._style)
        self._style()

    def _style(self) -> None:
        self.setFont(self._theme.font(tokens.STATUS_PX, tokens.WEIGHT_SEMIBOLD))
        _color(self, self._theme, "dim")


def _color(label: QLabel, theme: Theme, role: str) -> None:
    palette = label.palette()
    palette.setColor(label.foregroundRole(), theme.color(role))
    label.setPalette(palette)
