"""Robot panel: buttons, toggles, sliders, choices, texts and readouts defined by the profile and scenario."""

from collections import deque

from PySide6.QtCore import QSize, Qt, QTimer, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QLabel, QScrollArea, QSizePolicy, QStackedLayout, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.control_definitions import ControlValue, RobotControl
from caris_desktop.domain.sensing import ControlReadings
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import ControlStatus, DriveStatus, LinkStatus
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.panel import PAUSE_MS, Panel, PanelContext
from caris_desktop.ui.text_formatting import question_for
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.control_widgets import create_control_widget, row_direction
from caris_desktop.ui.widgets.flow_layout import FlowRow
from caris_desktop.ui.widgets.labels import label, restyle

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
_HELD = QT_TR_NOOP("Emergency stop active. Controls that move the robot work again when you release it.")


class RobotPanel(Panel):
    """Creates a widget per control in ``state.controls``, by kind; not specific to any robot."""

    title = QT_TR_NOOP("Robot")
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
        column = layouts.vbox(centered, margins_px=(24, 8, 24, 8))
        column.addWidget(self._empty)
        self._stack.addWidget(centered)
        self._stack.addWidget(self._scroll)
        layout = layouts.vbox(self, margins_px=(2, 0, 2, 2), spacing_px=0)
        layout.addWidget(self._reason)
        layout.addWidget(holder, 1)
        self._reason.setContentsMargins(12, 8, 12, 0)
        self.state.controls.changed.connect(self._on_controls_changed)
        self.state.control_states.changed.connect(self._on_states_changed)
        self.state.readings.changed.connect(self._on_readings_changed)
        self.state.readings.freshness_changed.connect(self._on_readings_freshness_changed)
        self.state.link.changed.connect(self._refresh)
        self.state.drive.changed.connect(self._on_drive_changed)
        self.state.robot.changed.connect(self._refresh)
        self.hold.escape_pressed.connect(self._on_escape)
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
        self.complete()
        return self._entries.get(control_id)

    def _on_controls_changed(self, controls: tuple[RobotControl, ...]) -> None:
        self._entries = {}
        self._to_come.clear()
        body = QWidget()
        column = layouts.vbox(body, margins_px=(12, 10, 12, 12), spacing_px=8)
        groups: dict[str, list[RobotControl]] = {}
        for control in controls:
            groups.setdefault(control.group, []).append(control)
        heading_px = max((_heading(group).sizeHint().width() for group in groups), default=0)
        self._groups = []
        for group, members in groups.items():
            block = _Group(group, heading_px=min(_WIDEST_HEADING_PX, heading_px))
            self._to_come.extend((block, control) for control in members)
            self._groups.append(block)
            column.addWidget(block)
        column.addStretch(1)
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
        self._fold()
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
        whose = link.robot or tr("This robot")
        self._empty.setText(
            tr(
                "{robot} has no controls.\nIts profile or the scenario can add buttons, switches, sliders and readouts."
            ).format(robot=whose)
        )
        failed = sum(entry.failed for entry in self._entries.values())
        busy = [entry for entry in self._entries.values() if entry.busy]
        if reason:
            self.set_fact(tr("not connected"), "amber")
        elif held:
            self.set_fact(tr("emergency stop active"), "amber")
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
        self._note = label("", "small", wraps=True, objectName="control_note")
        self._note.hide()
        self._question = _Question(theme)
        self._question.answered.connect(self._on_answered)
        self._question.hide()
        self._face = create_control_widget(theme, control, self._on_used)
        column = layouts.vbox(self, margins_px=0, spacing_px=4)
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
        self._show()

    @property
    def note(self) -> QLabel:
        """State as text; for a small control, in the line below its row."""
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

    def _on_done_shown(self) -> None:
        self._show(done=False)

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
        self._note.setText(f"{control.title} {note_text}" if compact and note_text else note_text)
        self._note.setVisible(bool(note_text) and not asking)
        restyle(self._note, tone="amber" if state == "failed" else "dim")
        tip = self._reason or words
        self._face.setToolTip(f"{control.title}: {tip}" if tip else self._face.tip)
        self._note.setToolTip(words)
        self._face.setAccessibleDescription(tip)
        self.updateGeometry()


class _Question(QWidget):
    answered = Signal(bool)

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._words = label("", "medium")
        self.yes = ActionButton(theme, tr("Do it"), role="amber", height_px=30)
        self.yes.setObjectName("control_confirm")
        self.yes.clicked.connect(lambda: self.answered.emit(True))
        no = ActionButton(theme, tr("Cancel"), role="ghost", height_px=30)
        no.setObjectName("control_cancel")
        no.clicked.connect(lambda: self.answered.emit(False))
        row = layouts.hbox(self, margins_px=(0, 2, 0, 2), spacing_px=6)
        row.addWidget(self._words)
        row.addWidget(self.yes)
        row.addWidget(no)
        row.addStretch(1)

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
        named = bool(self._heading.text())
        self._heading.setVisible(named or not narrow)
        if narrow:
            self._heading.setMinimumSize(0, 0)
            self._heading.setMaximumSize(16777215, 16777215)
        else:
            self._heading.setFixedSize(self._heading_px, tokens.CONTROL_HEIGHT_PX)


def _heading(text: str) -> QLabel:
    return label(text, "caption", tone="dim")
