"""Robot panel: buttons, toggles, sliders, choices, texts and readouts defined by the profile and scenario."""

import time
from collections import deque
from collections.abc import Callable

from PySide6.QtCore import QRectF, QSignalBlocker, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import (
    QBoxLayout,
    QLabel,
    QScrollArea,
    QSizePolicy,
    QSlider,
    QStackedLayout,
    QWidget,
)

from caris_desktop.domain import intents
from caris_desktop.domain.control_definitions import Choice, ControlValue, RobotControl
from caris_desktop.domain.sensing import ControlReadings
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import ControlStatus, DriveStatus, LinkStatus
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.panel import PAUSE_MS, Panel, PanelContext
from caris_desktop.ui.text_formatting import question_for, value_words
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import FlowRow
from caris_desktop.ui.widgets.inputs import DropDown, SubmitLineEdit
from caris_desktop.ui.widgets.labels import label, named, restyle

ASKING_ENDS_AFTER_MS = 10_000
_DONE_SHOWN_MS = 1500
_NARROW_PX = 340
_WIDEST_HEADING_PX = 110
_AT_ONCE = 3
_COMPACT = ("button", "toggle", "readout")
_NOT_USABLE = {
    "connecting": QT_TR_NOOP("Still connecting to the robot."),
    "lost": QT_TR_NOOP("The robot is out of reach."),
    "closed": QT_TR_NOOP("No robot is connected."),
}
_HELD = QT_TR_NOOP("Controls that move the robot work again when you release the emergency stop.")


class RobotPanel(Panel):
    """Creates a widget per control in ``state.controls``, by kind; not specific to any robot."""

    title = QT_TR_NOOP("Robot")
    preferred_size, least_size = QSize(340, 260), QSize(180, 80)
    reads = ()

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("robot_panel")
        self._entries: dict[str, ControlEntry] = {}
        self._groups: list[_Group] = []
        self._to_come: deque[tuple[_Group, RobotControl]] = deque()
        self._adding = QTimer(self, singleShot=True, interval=PAUSE_MS)
        self._adding.timeout.connect(self._add_some)
        self._held: bool = self.state.drive.value.emergency_stop
        self._empty = label(tone="dim", wraps=True, objectName="robot_empty", alignment=Qt.AlignmentFlag.AlignCenter)
        self._reason = label("", "warning", wraps=True, objectName="robot_reason")
        self._reason.hide()
        self._scroll = QScrollArea(widgetResizable=True)
        self._scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self._scroll.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        holder = QWidget()
        self._stack = QStackedLayout(holder)
        centered = QWidget()
        layouts.vbox(centered, self._empty, margins_px=(24, 8, 24, 8))
        self._stack.addWidget(centered)
        self._stack.addWidget(self._scroll)
        layouts.vbox(self, self._reason, (holder, 1), margins_px=(2, 0, 2, 2), spacing_px=0)
        self._reason.setContentsMargins(12, 8, 12, 0)
        self.state.control_states.changed.connect(self._on_states_changed)
        self.state.readings.changed.connect(self._on_readings_changed)
        self.state.readings.freshness_changed.connect(self._on_readings_freshness_changed)
        self.state.link.changed.connect(self._refresh)
        self.state.drive.changed.connect(self._on_drive_changed)
        self.state.robot.changed.connect(self._refresh)
        self.hold.escape_pressed.connect(self._on_escape)
        self.state.controls.follow(self._on_controls_changed)

    def fit(self) -> None:
        for block in self._groups:
            block.set_narrow(self.width() < _NARROW_PX)

    def entry(self, control_id: str) -> "ControlEntry | None":
        self.complete()
        return self._entries.get(control_id)

    def _on_controls_changed(self, controls: tuple[RobotControl, ...]) -> None:
        self._entries = {}
        self._to_come.clear()
        groups: dict[str, list[RobotControl]] = {}
        for control in controls:
            groups.setdefault(control.group, []).append(control)
        heading_px = max((_heading(group).sizeHint().width() for group in groups), default=0)
        self._groups = []
        for group, members in groups.items():
            block = _Group(group, heading_px=min(_WIDEST_HEADING_PX, heading_px))
            self._to_come.extend((block, control) for control in members)
            self._groups.append(block)
        body = QWidget()
        layouts.vbox(body, *self._groups, 1, margins_px=(12, 10, 12, 12), spacing_px=8)
        old = self._scroll.takeWidget()
        if old is not None:
            old.deleteLater()
        self._scroll.setWidget(body)
        self._add_some()

    def _add_some(self) -> None:
        """Add a few controls per turn: a robot may have any number, and keys must not wait."""
        for _ in range(min(_AT_ONCE, len(self._to_come))):
            block, control = self._to_come.popleft()
            entry = ControlEntry(self.theme, control)
            entry.used.connect(lambda control_id, value: self.console.do(intents.UseControl(control_id, value)))
            self._entries[control.id] = entry
            block.add(entry)
        self.fit()
        self._on_states_changed(self.state.control_states.value)
        self._on_readings_changed(self.state.readings.value)
        if self._to_come:
            self._adding.start()

    def complete(self) -> None:
        while self._to_come:
            self._add_some()

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

    def _on_escape(self) -> None:
        for entry in self._entries.values():
            entry.stop_asking()

    def _refresh(self) -> None:
        link: LinkStatus = self.state.link.value
        reason = _NOT_USABLE.get(link.state, "") if self.state.present.live else ""
        held = ""
        for entry in self._entries.values():
            entry_held = tr(_HELD) if self._held and entry.control.is_held_by_stop else ""
            entry.set_usable(reason or entry_held)
            held = held or entry_held
        again = tr("{reason} These controls work again once the robot responds.").format(reason=reason)
        message = again if reason else held
        self._reason.setText(message)
        self._reason.setVisible(bool(message and self._entries))
        self._stack.setCurrentIndex(1 if self._entries else 0)
        none = tr(
            "{robot} has no controls.\nIts profile or the scenario can add buttons, switches, sliders and readouts."
        )
        self._empty.setText(none.format(robot=link.robot or tr("This robot")))
        failed = sum(entry.failed for entry in self._entries.values())
        busy = [entry for entry in self._entries.values() if entry.busy]
        if reason:
            self.set_fact(tr("not connected"), "amber")
        elif held:
            self.set_fact(tr("motion is off"), "amber")
        elif busy:
            self.set_fact(tr("{control}: requested").format(control=busy[0].control.title), "blue")
        elif failed:
            self.set_fact(tr("%n failed", "", failed), "amber")
        else:
            self.set_fact(tr("%n controls", "", len(self._entries)) if self._entries else "", "dim")


class ControlEntry(QWidget):
    """A control with its state (requested, done, failed), and a confirmation where required."""

    used = Signal(str, object)  # control id, value

    def __init__(self, theme: Theme, control: RobotControl) -> None:
        super().__init__()
        self.setObjectName(f"control_{control.id}")
        self.control = control
        self._status: ControlStatus | None = None
        self._reason = ""
        self._asking: ControlValue | None = None
        self.note = label("", "small", wraps=True, objectName="control_note")
        """State as text; for a small control, in the line below its row."""
        self.note.hide()
        self._question = _Question(theme)
        self._question.answered.connect(self._on_answered)
        self._question.hide()
        self._face = _FACES[control.kind](theme, control, self._on_used)
        column = layouts.vbox(self, self._face, self._question, margins_px=0, spacing_px=4)
        if control.kind in _COMPACT:
            self.setSizePolicy(QSizePolicy.Policy.Maximum, QSizePolicy.Policy.Fixed)
        else:
            column.addWidget(self.note)
        self._calm_down = QTimer(self, singleShot=True, interval=_DONE_SHOWN_MS)
        self._calm_down.timeout.connect(lambda: self._show(done=False))
        self._give_up_asking = QTimer(self, singleShot=True, interval=ASKING_ENDS_AFTER_MS)
        self._give_up_asking.timeout.connect(self.stop_asking)
        self._show()

    @property
    def busy(self) -> bool:
        return self._status is not None and self._status.state == "requested"

    @property
    def failed(self) -> bool:
        return self._status is not None and self._status.state == "failed"

    @property
    def note_text(self) -> str:
        return "" if self.note.isHidden() else self.note.text()

    @property
    def value_text(self) -> str:
        """Text of the current value."""
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
        """Set the reason why the control is disabled; empty if usable."""
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

    def _show(self, *, done: bool = True) -> None:
        status, control = self._status, self.control
        asking = self._asking is not None
        self._question.setVisible(asking)
        # The question replaces the button: the next click is an answer.
        self._face.setVisible(not (asking and control.kind == "button"))
        if self._asking is not None:
            self._question.ask(question_for(control, self._asking))
        self._face.setEnabled(not self._reason)
        state = "" if status is None else status.state
        if state == "succeeded" and not (done and self._calm_down.isActive()):
            state = ""
        self._face.show_state(state)
        words = {"requested": tr("requested…"), "failed": tr("failed")}.get(state, "")
        if status is not None and state == "failed" and status.detail:
            words = tr("failed: {detail}").format(detail=tr(status.detail))
        elif status is not None and state == "succeeded" and status.detail:
            words = tr("done: {detail}").format(detail=tr(status.detail))
        compact = control.kind in _COMPACT
        note_text = "" if compact and state == "requested" else words
        self.note.setText(f"{control.title} {note_text}" if compact and note_text else note_text)
        self.note.setVisible(bool(note_text) and not asking)
        restyle(self.note, tone="amber" if state == "failed" else "dim")
        tip = self._reason or words
        self._face.setToolTip(f"{control.title}: {tip}" if tip else self._face.tip)
        self.note.setToolTip(words)
        self._face.setAccessibleDescription(tip)
        self.updateGeometry()


class _Question(QWidget):
    answered = Signal(bool)

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._words = label("", "medium")
        self.yes = ActionButton(theme, tr("Do it"), role="amber", height_px=30, objectName="control_confirm")
        self.yes.clicked.connect(lambda: self.answered.emit(True))
        no = ActionButton(theme, tr("Cancel"), role="ghost", height_px=30, objectName="control_cancel")
        no.clicked.connect(lambda: self.answered.emit(False))
        layouts.hbox(self, self._words, self.yes, no, 1, margins_px=(0, 2, 0, 2), spacing_px=6)

    def ask(self, words: str) -> None:
        self._words.setText(words)
        self.yes.setAccessibleName(tr("{question} Do it").format(question=words))


class _Group(QWidget):
    """Heading with its controls side by side, or stacked in a narrow dock."""

    def __init__(self, name: str, *, heading_px: int) -> None:
        super().__init__()
        self._heading_px = heading_px
        self._entries: list[ControlEntry] = []
        self._heading = _heading(name)
        self._column = layouts.vbox(spacing_px=6)
        self._flow: FlowRow | None = None
        self._row = layouts.hbox(self, margins_px=0)
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
        self._row.setDirection(row_direction(narrow=narrow))
        for entry in self._entries:
            entry.set_narrow(narrow)
        self._row.setSpacing(4 if narrow else 12)
        self._heading.setVisible(bool(self._heading.text()) or not narrow)
        if narrow:
            self._heading.setMinimumSize(0, 0)
            self._heading.setMaximumSize(16777215, 16777215)
        else:
            self._heading.setFixedSize(self._heading_px, tokens.CONTROL_HEIGHT_PX)


def _heading(text: str) -> QLabel:
    return label(text, "caption", tone="dim")


SEND_EVERY_MS = 100
_SETTLE_S = 1.5  # maximum delay until a robot reports a value that was just set
_SLIDER_STEPS = 200
_CHOICES_SIDE_BY_SIDE = 4
_TITLE_PX = 92


Use = Callable[[ControlValue], None]


class ControlWidget(QWidget):
    """Widget of one kind of control."""

    tip = ""

    def __init__(self, theme: Theme, control: RobotControl, use: Use) -> None:
        """``use``: sends a value to the robot."""
        super().__init__()
        self._use = use
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

    def __init__(self, theme: Theme, control: RobotControl, use: Use) -> None:
        super().__init__(theme, control, use)
        self._title = label(control.title, toolTip=control.title)
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


def row_direction(*, narrow: bool) -> QBoxLayout.Direction:
    return QBoxLayout.Direction.TopToBottom if narrow else QBoxLayout.Direction.LeftToRight


class _ButtonFace(ControlWidget):
    def __init__(self, theme: Theme, control: RobotControl, use: Use) -> None:
        super().__init__(theme, control, use)
        self._button = ActionButton(theme, control.title, may_shrink=True, objectName=f"control_{control.id}_button")
        self._button.clicked.connect(lambda: use(True))
        self._value = label("", "note")
        self._value.hide()
        layouts.hbox(self, self._button, self._value, margins_px=0)

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
    def __init__(self, theme: Theme, control: RobotControl, use: Use) -> None:
        super().__init__(theme, control, use)
        self._reported: bool | None = None
        self._requested: bool | None = None
        self._requested_at_s = float("-inf")
        self._switch = named(Switch(theme, control.title), f"control_{control.id}_switch")
        self._switch.clicked.connect(self._on_clicked)
        self._settle = QTimer(self, singleShot=True, interval=round(_SETTLE_S * 1000))
        self._settle.timeout.connect(self._refresh)
        layouts.hbox(self, self._switch, margins_px=0)
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


class Switch(ActionButton):
    """Toggle switch with name and state (on, off, unknown)."""

    def __init__(self, theme: Theme, title: str) -> None:
        super().__init__(theme)
        self._title = title
        self._value: bool | None = None
        self._state = ""

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
        width = 64 + self.fontMetrics().horizontalAdvance(self._title) + 8 + self._word_width() + 12
        return QSize(width, tokens.CONTROL_HEIGHT_PX)

    def _word_width(self) -> int:
        return max(self.fontMetrics().horizontalAdvance(word) for word in (tr("on"), tr("off")))

    def minimumSizeHint(self) -> QSize:
        return QSize(110, tokens.CONTROL_HEIGHT_PX)

    def paintEvent(self, event: QPaintEvent) -> None:
        super().paintEvent(event)
        theme, painter = self._theme, QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if not self.isEnabled():
            painter.setOpacity(0.75)
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
        word_width = self._word_width()
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

    def __init__(self, theme: Theme, control: RobotControl, use: Use) -> None:
        super().__init__(theme, control, use)
        self._steps = _SLIDER_STEPS
        if control.step > 0:
            self._steps = max(1, round((control.highest - control.lowest) / control.step))
        self._reported: float | None = None
        self._set: float | None = None
        self._sent: float | None = None
        self._last_use_s = float("-inf")
        self._value = label("", "note", objectName="control_value")
        self._slider = named(QSlider(Qt.Orientation.Horizontal), f"control_{control.id}_slider", control.title)
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
        layouts.fill(self.parts, (self._slider, 1), self._value)
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


class _ChoiceFace(_TitledFace):
    """Few choices as buttons, more as a list."""

    def __init__(self, theme: Theme, control: RobotControl, use: Use) -> None:
        super().__init__(theme, control, use)
        self._chosen: ControlValue | None = None
        self._reported: ControlValue | None = None
        self._buttons: list[tuple[Choice, ActionButton]] = []
        self._list: DropDown | None = None
        if len(control.choices) <= _CHOICES_SIDE_BY_SIDE:
            flow = FlowRow(gap_px=6)
            for number, choice in enumerate(control.choices):
                button = ActionButton(theme, choice.title, may_shrink=True, checkable=True)
                button.setObjectName(f"control_{control.id}_choice_{number}")
                button.setAccessibleName(f"{control.title}: {choice.title}")
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
    def __init__(self, theme: Theme, control: RobotControl, use: Use) -> None:
        super().__init__(theme, control, use)
        self._now = label("", "note")
        self._field = SubmitLineEdit(
            objectName=f"control_{control.id}_field", accessibleName=control.title, maxLength=500
        )
        self._field.setMinimumHeight(tokens.CONTROL_HEIGHT_PX)
        self._field.returnPressed.connect(self._on_send)
        send = ActionButton(theme, tr("Send"), icon="paper-plane-right", objectName=f"control_{control.id}_send")
        send.setAccessibleName(tr("{control}: send").format(control=control.title))
        send.clicked.connect(self._on_send)
        layouts.fill(self.parts, (self._field, 1), send, self._now)

    def show_reading(self, value: ControlValue | None) -> None:
        self.value_text = "" if value is None else value_words(self.control, value)
        self._now.setText(self._now.fontMetrics().elidedText(self.value_text, Qt.TextElideMode.ElideRight, 160))

    def _on_send(self) -> None:
        self._use(self._field.text())
        self._field.selectAll()


class _ReadoutFace(ControlWidget):
    def __init__(self, theme: Theme, control: RobotControl, use: Use) -> None:
        super().__init__(theme, control, use)
        self.setProperty("role", "readout")
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self._title = label(control.title, "note", minimumWidth=40)
        self._value = label("", "title", objectName="control_value")
        layouts.hbox(self, self._title, self._value, margins_px=(10, 4, 10, 4), spacing_px=8)
        self.setMinimumHeight(tokens.CONTROL_HEIGHT_PX)
        self.show_reading(None)

    def show_reading(self, value: ControlValue | None) -> None:
        self.value_text = "" if value is None else value_words(self.control, value)
        text = self.value_text or tr("no value yet")
        self._value.setText(text if len(text) <= 40 else text[:39] + "…")
        self._value.setEnabled(bool(self.value_text))
        self.tip = "" if value is None else f"{self.control.title}: {value}"
        self.setToolTip(self.tip)


_FACES: dict[str, type[ControlWidget]] = {
    "button": _ButtonFace, "toggle": _ToggleFace, "slider": _SliderFace, "choice": _ChoiceFace, "text": _TextFace,
    "readout": _ReadoutFace,
}  # fmt: skip
