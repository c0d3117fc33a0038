"""Gamepad dialog: live axes and buttons, and their bindings."""

from dataclasses import replace

from PySide6.QtCore import QRectF, QSignalBlocker, QSize, Qt
from PySide6.QtGui import QAccessible, QCloseEvent, QFontMetricsF, QHideEvent, QPainter, QPaintEvent, QPen, QResizeEvent
from PySide6.QtWidgets import QBoxLayout, QGridLayout, QLabel, QSlider, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.gamepad import (
    AXIS_ACTIONS,
    BUTTON_ACTIONS,
    TRIGGERS,
    AxisAction,
    ButtonAction,
    GamepadDevice,
    Gamepads,
    GamepadSample,
    RawInputs,
    binding_words,
    let_go_since,
    moved_input,
    part_names,
    with_rests,
)
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import GamepadStatus
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.form_dialog import FormDialog, lay_out_form, resize_to
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import list_area
from caris_desktop.ui.widgets.labels import label, restyle

_LEAST_ROWS_PX, _BESIDE_ROWS_PX, _BETWEEN_PX = 160, 96, 32
_TITLES: dict[AxisAction | ButtonAction, str] = {
    "forward": QT_TR_NOOP("Drive forward and back"), "turn": QT_TR_NOOP("Turn left and right"),
    "left": QT_TR_NOOP("Move sideways"), "pan": QT_TR_NOOP("Turn the head"), "tilt": QT_TR_NOOP("Tilt the head"),
    "boost": QT_TR_NOOP("Full speed"), "slow": QT_TR_NOOP("Slow speed"),
    "stop": QT_TR_NOOP("Stop the robot"), "emergency_stop": QT_TR_NOOP("Emergency stop"),
    "phrase_1": QT_TR_NOOP("Say phrase 1"), "phrase_2": QT_TR_NOOP("Say phrase 2"),
    "phrase_3": QT_TR_NOOP("Say phrase 3"),
    "phrase_4": QT_TR_NOOP("Say phrase 4"), "filler": QT_TR_NOOP("Say the filler"),
    "silence": QT_TR_NOOP("Silence"), "photo": QT_TR_NOOP("Photo"), "mark": QT_TR_NOOP("Mark"),
    "slower": QT_TR_NOOP("Slower"), "faster": QT_TR_NOOP("Faster"),
    "look_ahead": QT_TR_NOOP("Look ahead"), "push_to_talk": QT_TR_NOOP("Speak through the robot (hold)"),
}  # fmt: skip
_WANTED: dict[AxisAction | ButtonAction, str] = {
    "forward": QT_TR_NOOP("push the stick in the direction for driving forward"),
    "turn": QT_TR_NOOP("push the stick in the direction for turning left"),
    "left": QT_TR_NOOP("push the stick in the direction for moving left, or press a button"),
    "pan": QT_TR_NOOP("push the stick in the direction for looking left"),
    "tilt": QT_TR_NOOP("push the stick in the direction for looking down"),
    "boost": QT_TR_NOOP("pull the trigger"),
    "slow": QT_TR_NOOP("pull the trigger"),
}


class GamepadDialog(FormDialog):
    """Non-modal, so that the red button and all else keep working; the gamepad being configured does not drive."""

    def __init__(self, theme: Theme, state: LiveState, gamepads: Gamepads, parent: QWidget) -> None:
        super().__init__(theme, parent, "gamepad_dialog", tr("Gamepad"))
        self._state = state
        self._gamepads = gamepads
        self._learned: AxisAction | ButtonAction | None = None
        self._rests = RawInputs()
        self._before = RawInputs()
        self._first_way = ""
        self._name = label("", "heading", objectName="gamepad_name")
        self._hint = label("", "note", wraps=True, objectName="gamepad_hint")
        self._view = GamepadView(theme)
        self._rows: dict[str, BindingRow] = {}
        shown_buttons = [action for action in BUTTON_ACTIONS if action in _TITLES]
        self._sides: list[QWidget] = []
        for actions in ((*AXIS_ACTIONS, *shown_buttons[:3]), shown_buttons[3:]):
            side = QWidget()
            lines = layouts.vbox(side, margins_px=0, spacing_px=2)
            for action in actions:
                row = self._rows[action] = BindingRow(theme, action, tr(_TITLES[action]))
                row.change.clicked.connect(lambda _checked=False, action=action: self._learn(action))
                lines.addWidget(row)
            self._sides.append(side)
        rows = QWidget()
        self._columns = layouts.hbox(None, *((side, 1, layouts.TOP) for side in self._sides), spacing_px=2)
        layouts.vbox(rows, self._columns, 1, margins_px=(0, 0, 8, 0))
        sliders = QGridLayout()
        sliders.setHorizontalSpacing(16)
        self._dead_zone, self._dead_zone_words = self._slider(sliders, "gamepad_dead_zone", tr("Dead zone"), 0, 40)
        self._speed, self._speed_words = self._slider(sliders, "gamepad_speed", tr("Speed without a trigger"), 20, 100)
        self._reset = ActionButton(
            theme, tr("Reset to defaults"), icon="arrow-counter-clockwise", objectName="gamepad_reset",
            clicked=self._on_reset,
        )  # fmt: skip
        close = ActionButton(theme, tr("Close"), role="primary", objectName="gamepad_close", clicked=self.close)
        lay_out_form(
            self,
            self._name,
            self._hint,
            self._view,
            (list_area(rows, least_px=_LEAST_ROWS_PX), 1),
            sliders,
            buttons=(self._reset, 1, close),
        )
        state.gamepad.changed.connect(self._on_status_changed)
        gamepads.mapping_changed.connect(self._refresh)
        gamepads.sampled.connect(self._on_sampled)
        self._refresh()
        resize_to(self, QSize(860, 760))

    @property
    def learned_action(self) -> str:
        """Action whose new binding is awaited; empty if none."""
        return self._learned or ""

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Arrange the rows in two columns if both fit."""
        super().resizeEvent(event)
        room_px = self.width() - _BESIDE_ROWS_PX
        beside = sum(side.minimumSizeHint().width() for side in self._sides) + _BETWEEN_PX <= room_px
        self._columns.setSpacing(_BETWEEN_PX if beside else 2)
        direction = QBoxLayout.Direction.LeftToRight if beside else QBoxLayout.Direction.TopToBottom
        self._columns.setDirection(direction)

    def hideEvent(self, event: QHideEvent) -> None:
        self._end_learning()
        super().hideEvent(event)

    def closeEvent(self, event: QCloseEvent) -> None:
        self._end_learning()
        super().closeEvent(event)

    def _slider(self, grid: QGridLayout, name: str, title: str, lowest: int, highest: int) -> tuple[QSlider, QLabel]:
        """Slider in a new row, and the label of its value."""
        slider, words = QSlider(Qt.Orientation.Horizontal), QLabel()
        slider.setObjectName(name)
        slider.setAccessibleName(title)
        slider.setRange(lowest, highest)
        slider.valueChanged.connect(
            lambda: self._gamepads.set_mapping(
                replace(
                    self._gamepads.mapping, dead_zone=self._dead_zone.value() / 100, speed=self._speed.value() / 100
                )
            )
        )
        words.setMinimumWidth(56)
        row = grid.rowCount()
        for column, part in enumerate((QLabel(title), slider, words)):
            grid.addWidget(part, row, column)
        return slider, words

    # ---- changing a binding

    def _learn(self, action: AxisAction | ButtonAction) -> None:
        if self._gamepads.device is None:
            return
        again = action == self._learned
        self._end_learning()
        if not again:
            self._learned = action
            now = self._gamepads.sample.raw
            self._rests = with_rests(self._rests, now)
            self._before = let_go_since(RawInputs((), now.buttons, now.hats), now, self._rests)
            self._gamepads.set_learning(learning=True)
        self._refresh()

    def _end_learning(self) -> None:
        self._learned, self._first_way = None, ""
        self._gamepads.set_learning(learning=False)

    def _on_sampled(self, sample: GamepadSample) -> None:
        self._rests = with_rests(self._rests, sample.raw)
        if not self.isVisible():
            return
        self._view.show_sample(sample, self._gamepads.device, self._gamepads.mapping.dead_zone)
        if self._learned is None:
            return
        found = self._found(sample.raw)
        self._before = let_go_since(self._before, sample.raw, self._rests)
        if found:
            action = self._learned
            self._end_learning()
            self._gamepads.set_mapping(self._gamepads.mapping.with_binding(action, found))
            self._refresh()

    def _found(self, raw: RawInputs) -> str:
        """The complete new binding, once all inputs that it needs were pressed."""
        button = moved_input(self._before, raw, buttons=True)
        if self._learned not in AXIS_ACTIONS:
            return button
        if not button:
            return moved_input(self._before, raw, buttons=False) if not self._first_way else ""
        if self._learned in TRIGGERS:
            return button
        if not self._first_way:
            self._first_way = button
            self._show_hint()
        return f"{self._first_way}|{button}" if button != self._first_way else ""

    # ---- display

    def _on_status_changed(self, _status: GamepadStatus) -> None:
        self._end_learning()
        self._rests = RawInputs()
        self._refresh()

    def _refresh(self) -> None:
        device, mapping = self._gamepads.device, self._gamepads.mapping
        status: GamepadStatus = self._state.gamepad.value
        self._name.setText(device.name if device is not None else tr("No gamepad is plugged in"))
        names = part_names(device.controller if device is not None else None)
        for action, row in self._rows.items():
            row.show_binding(binding_words(mapping.bound(action), names), learning=action == self._learned)
            row.setEnabled(device is not None)
        for slider, value in ((self._dead_zone, mapping.dead_zone), (self._speed, mapping.speed)):
            with QSignalBlocker(slider):
                slider.setValue(round(value * 100))
            slider.setEnabled(device is not None)
        self._dead_zone_words.setText(f"{mapping.dead_zone * 100:.0f} %")
        self._speed_words.setText(f"{mapping.speed * 100:.0f} %")
        self._reset.setEnabled(device is not None)
        self._show_hint(status)
        self._view.show_sample(self._gamepads.sample, device, mapping.dead_zone)

    def _show_hint(self, status: GamepadStatus | None = None) -> None:
        status = status or self._state.gamepad.value
        role = "note"
        if self._gamepads.device is None:
            text = tr(status.detail) or tr("Plug in or turn on a gamepad. It is detected automatically.")
        elif self._learned is not None:
            role = "news"
            wanted = _WANTED.get(self._learned, QT_TR_NOOP("press a button to assign it"))
            if self._first_way:
                wanted = QT_TR_NOOP("now press the button for the opposite direction")
            text = tr("{action}: {wanted}.").format(action=tr(_TITLES[self._learned]), wanted=tr(wanted))
        elif status.detail:
            text, role = tr("This gamepad is {what}.").format(what=tr(status.detail)), "warning"
        else:
            text = tr("The gamepad does not drive while this window is in front. Changes are saved for this gamepad.")
        self._hint.setText(text)
        restyle(self._hint, role=role)

    def _on_reset(self) -> None:
        self._end_learning()
        self._gamepads.reset_mapping()
        self._refresh()


class BindingRow(QWidget):
    """Binding of one action, and a button to change it."""

    def __init__(self, theme: Theme, action: str, title: str) -> None:
        super().__init__()
        self.setObjectName(f"binding_{action}")
        self._bound = label("", "note", alignment=Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        self.change = ActionButton(
            theme, tr("Change"), height_px=30, text_px=tokens.STATUS_PX, objectName=f"change_{action}",
            accessibleName=tr("Change: {action}").format(action=title),
        )  # fmt: skip
        layouts.hbox(self, QLabel(title), (self._bound, 1), self.change, margins_px=0, spacing_px=12)

    @property
    def bound_text(self) -> str:
        return self._bound.text()

    def show_binding(self, words: str, *, learning: bool) -> None:
        self._bound.setText(tr("waiting…") if learning else words)
        self.change.set_label(tr("Cancel") if learning else tr("Change"), role="amber" if learning else "plain")


class GamepadView(QWidget):
    """Bar with dead zone per axis, lamp per button."""

    accessible_role = QAccessible.Role.Graphic

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._theme = theme
        self._raw = RawInputs()
        self._names: dict[str, str] = {}
        self._dead_zone = 0.0
        self.setObjectName("gamepad_view")
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self.setFixedHeight(112)
        self.setAccessibleName(tr("Live gamepad input"))

    def show_sample(self, sample: GamepadSample, device: GamepadDevice | None, dead_zone: float) -> None:
        self._raw = sample.raw if device is not None else RawInputs()
        self._dead_zone = dead_zone
        self._names = part_names(device.controller if device is not None else None)
        self.setVisible(device is not None)
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme = self._theme
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setFont(theme.font(tokens.STATUS_PX))
        self._paint_axes(painter, QRectF(14, 10, self.width() * 0.56 - 14, self.height() - 20))
        left = self.width() * 0.56 + 14
        self._paint_buttons(painter, QRectF(left, 10, self.width() - left - 14, self.height() - 20))

    def _paint_axes(self, painter: QPainter, area: QRectF) -> None:
        theme = self._theme
        axes = self._raw.axes[:8]
        columns = 2 if len(axes) > 4 else 1
        lines = -(-len(axes) // columns) or 1
        height = min(26.0, area.height() / lines)
        for index, value in enumerate(axes):
            left = area.left() + (index // lines) * (area.width() / columns)
            width = area.width() / columns - 14
            top = area.top() + (index % lines) * height
            name = self._names.get(f"a{index}", tr("Axis {number}").format(number=index + 1))
            short = _short_names().get(name, name)
            painter.setPen(theme.color("dim" if value is None else "text"))
            painter.drawText(QRectF(left, top, 96, height), int(Qt.AlignmentFlag.AlignVCenter), short)
            bar = QRectF(left + 98, top + height / 2 - 4, width - 98, 8)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(theme.color("field"))
            painter.drawRoundedRect(bar, 4, 4)
            dead = bar.width() / 2 * self._dead_zone
            painter.setBrush(theme.color("line_strong"))
            painter.drawRect(QRectF(bar.center().x() - dead, bar.top(), 2 * dead, bar.height()))
            if value is not None:
                painter.setBrush(theme.color("blue"))
                painter.drawEllipse(QRectF(bar.center().x() + value * (bar.width() / 2 - 6) - 6, bar.top() - 2, 12, 12))

    def _paint_buttons(self, painter: QPainter, area: QRectF) -> None:
        theme = self._theme
        metrics = QFontMetricsF(painter.font())
        left, top = area.left(), area.top()
        lamps = [(self._names.get(f"b{index}", str(index + 1)), down) for index, down in enumerate(self._raw.buttons)]
        short = _short_names()
        for hat, bits in enumerate(self._raw.hats):
            lamps += [(self._names.get(f"h{hat}.{bit}", name), bool(bits & bit))
                      for bit, name in ((1, "↑"), (2, "→"), (4, "↓"), (8, "←"))]  # fmt: skip
        for name, down in lamps:
            text = short.get(name, name)
            width = max(26.0, metrics.horizontalAdvance(text) + 14)
            if left + width > area.right():
                left, top = area.left(), top + 30
            rect = QRectF(left, top, width, 24)
            painter.setPen(QPen(theme.color("blue" if down else "line_strong"), 1))
            painter.setBrush(theme.color("blue" if down else "panel"))
            painter.drawRoundedRect(rect, 12, 12)
            painter.setPen(theme.color("on_blue" if down else "text"))
            painter.drawText(rect, Qt.AlignmentFlag.AlignCenter, text)
            left += width + 6


def _short_names() -> dict[str, str]:
    """Short labels of gamepad inputs, by their full names."""
    return {
        tr("Left stick sideways"): tr("Left ↔"), tr("Left stick up and down"): tr("Left ↕"),
        tr("Right stick sideways"): tr("Right ↔"), tr("Right stick up and down"): tr("Right ↕"),
        tr("Left shoulder"): "L1", tr("Right shoulder"): "R1", tr("Left stick pressed"): "L3",
        tr("Right stick pressed"): "R3", tr("Pad up"): "↑", tr("Pad right"): "→", tr("Pad down"): "↓",
        tr("Pad left"): "←",
    }  # fmt: skip
