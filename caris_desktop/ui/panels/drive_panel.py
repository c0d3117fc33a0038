"""Drive panel: arrows and stick, speed, obstacle guard, head, and the current command."""

import math
from functools import partial
from typing import Literal

from PySide6.QtCore import QElapsedTimer, QEvent, QPoint, QPointF, QRectF, QSize, Qt, QTimer, Signal
from PySide6.QtGui import (
    QAccessible,
    QFocusEvent,
    QHideEvent,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPen,
    QPolygonF,
    QResizeEvent,
    QTouchEvent,
)
from PySide6.QtWidgets import QBoxLayout, QFrame, QGridLayout, QProgressBar, QPushButton, QSizePolicy, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.gamepad import AT_REST, TeleopCommand
from caris_desktop.live.status import DriveStatus, HeadStatus
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.scenario.scenario_model import PanelSettings
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_rows import SPEED_FRACTIONS, SPEED_NAMES, speed_step
from caris_desktop.ui.input.drive_input_filter import STOPS, DriveInputFilter
from caris_desktop.ui.panel import Panel, PanelContext, card_margins
from caris_desktop.ui.status_bar import owner_sentence
from caris_desktop.ui.theme import Theme, draw_icon
from caris_desktop.ui.widgets.accessible_descriptions import ThrottledAccessibleDescription
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.labels import HEIGHT_PX, KeyCap, draw_key_cap, key_cap_width, label, named, restyle

StickUse = Literal["base", "head"]

_DEAD_ZONE = 0.08
_RING = 0.74  # the ring outside this share of the radius moves sideways
_KNOB = 0.28


def stick_command(across: float, up: float, *, use: StickUse, sideways: bool) -> TeleopCommand:
    """Command for a stick at (right, up), each -1..1; with a round dead zone, the rest is rescaled."""
    reach = math.hypot(across, up)
    if reach <= _DEAD_ZONE:
        return AT_REST
    scale = min(1.0, (reach - _DEAD_ZONE) / (1.0 - _DEAD_ZONE)) / reach
    right, ahead = round(across * scale, 2) + 0.0, round(up * scale, 2) + 0.0
    if use == "head":
        return TeleopCommand(pan=-right, tilt=-ahead)
    return TeleopCommand(forward=ahead, left=-right) if sideways else TeleopCommand(forward=ahead, turn=-right)


class Joystick(QWidget):
    """Joystick. On a holonomic base, a drag from the outer ring or with Shift moves sideways.

    ``moved(TeleopCommand)`` on each change, and AT_REST at once on release, hiding or disabling.
    """

    accessible_role = QAccessible.Role.Graphic

    moved = Signal(object)

    def __init__(self, theme: Theme, *, use: StickUse) -> None:
        super().__init__()
        self._theme = theme
        self._use: StickUse = use
        self._can_go_sideways = False
        self._sideways = False
        self.held = False
        self._touch: int | None = None
        self._knob = QPointF()  # right and down, as shares of the reach
        self.command = AT_REST
        self.setAttribute(Qt.WidgetAttribute.WA_AcceptTouchEvents)
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Preferred)
        self.setAccessibleName(tr("Driving stick") if use == "base" else tr("Head stick"))
        self.setToolTip(tr("Drag to drive, release to stop") if use == "base" else tr("Drag to turn the head"))
        self._description = ThrottledAccessibleDescription(self, self.command_text)

    def command_text(self) -> str:
        """Current command as text."""
        if not self.isEnabled():
            return tr("Off")
        forward, left, turn = self.command.base
        pan, tilt = self.command.head
        shares = (
            (forward, QT_TR_NOOP("{percent} % forward"), QT_TR_NOOP("{percent} % backward")),
            (left, QT_TR_NOOP("{percent} % sideways to the left"), QT_TR_NOOP("{percent} % sideways to the right")),
            (turn, QT_TR_NOOP("turning left at {percent} %"), QT_TR_NOOP("turning right at {percent} %")),
            (pan, QT_TR_NOOP("head to the left at {percent} %"), QT_TR_NOOP("head to the right at {percent} %")),
            (tilt, QT_TR_NOOP("head down at {percent} %"), QT_TR_NOOP("head up at {percent} %")),
        )  # fmt: skip
        parts = [
            tr(one if share > 0 else other).format(percent=f"{abs(share) * 100:.0f}")
            for share, one, other in shares
            if share
        ]
        return ", ".join(parts) or tr("At rest")

    def set_sideways(self, possible: bool) -> None:
        """Set whether the base is holonomic."""
        if possible != self._can_go_sideways:
            self._can_go_sideways = possible
            self.setToolTip(
                tr("Drag to drive, release to stop. Drag from the outer ring or hold Shift to move sideways.")
                if possible
                else tr("Drag to drive, release to stop")
            )
            self.update()

    def let_go(self) -> None:
        """Return to centre at once."""
        self.held, self._touch, self._knob = False, None, QPointF()
        self._notify(AT_REST)

    def sizeHint(self) -> QSize:
        return QSize(128, 128)

    def minimumSizeHint(self) -> QSize:
        return QSize(92, 62)

    def changeEvent(self, event: QEvent) -> None:
        # A disabled widget receives no mouse release.
        if event.type() == QEvent.Type.EnabledChange and not self.isEnabled():
            self.let_go()
        if event.type() == QEvent.Type.EnabledChange:
            self._description.changed()
        super().changeEvent(event)

    def hideEvent(self, event: QHideEvent) -> None:
        self.let_go()
        super().hideEvent(event)

    def leaveEvent(self, event: QEvent) -> None:
        # Qt grabs the pointer while the button is down; a leave event means that the grab was lost.
        if self.held and self._touch is None:
            self.let_go()
        super().leaveEvent(event)

    def event(self, event: QEvent) -> bool:
        if isinstance(event, QTouchEvent):
            if event.type() == QEvent.Type.TouchCancel:
                self.let_go()
                return True
            for point in event.points():
                if event.type() == QEvent.Type.TouchBegin and not self.held:
                    self._touch = point.id()
                    self._begin(point.position(), shift=False)
                elif point.id() == self._touch and self.held:
                    if point.state() == point.State.Released:
                        self.let_go()
                    elif point.state() != point.State.Stationary:
                        self._move(point.position())
            if event.type() == QEvent.Type.TouchEnd and self.held:
                self.let_go()
            event.accept()
            return True
        if event.type() == QEvent.Type.UngrabMouse and self.held and self._touch is None:
            self.let_go()
        return bool(super().event(event))

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton and self._touch is None:
            self._begin(event.position(), shift=bool(event.modifiers() & Qt.KeyboardModifier.ShiftModifier))

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        if self.held and self._touch is None:
            self._move(event.position())

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton and self._touch is None:
            self.let_go()

    def _begin(self, at: QPointF, *, shift: bool) -> None:
        self.held = True
        offset = at - self._center()
        in_ring = math.hypot(offset.x(), offset.y()) > self._radius() * _RING
        self._sideways = self._can_go_sideways and (in_ring or shift)
        self._move(at)

    def _move(self, at: QPointF) -> None:
        offset = (at - self._center()) / max(1.0, self._reach())
        length = math.hypot(offset.x(), offset.y())
        self._knob = offset / length if length > 1.0 else offset
        self._notify(stick_command(self._knob.x(), -self._knob.y(), use=self._use, sideways=self._sideways))

    def _notify(self, wish: TeleopCommand) -> None:
        self.update()
        if wish != self.command:
            self.command = wish
            self.moved.emit(wish)
            self._description.changed()

    def _center(self) -> QPointF:
        return QRectF(self.rect()).center()

    def _radius(self) -> float:
        return min(self.width(), self.height()) / 2 - 2

    def _reach(self) -> float:
        """Maximum displacement of the knob's centre."""
        ring = _RING if self._can_go_sideways else 1.0
        return self._radius() * (ring - _KNOB)

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme, center, radius = self._theme, self._center(), self._radius()
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if not self.isEnabled():
            painter.setOpacity(0.5)
        painter.setPen(QPen(theme.color("blue" if self.held else "line"), 2 if self.held else 1))
        painter.setBrush(theme.color("raised"))
        painter.drawEllipse(center, radius, radius)
        inner = radius
        if self._can_go_sideways:
            inner = radius * _RING
            painter.setPen(QPen(theme.color("line_strong"), 1))
            painter.setBrush(theme.color("panel"))
            painter.drawEllipse(center, inner, inner)
            middle = radius * (1 + _RING) / 2
            ink = theme.color("blue" if self.held and self._sideways else "dim")
            for icon, side in (("caret-double-left", -1), ("caret-double-right", 1)):
                size = min(14.0, radius - inner)
                rect = QRectF(center.x() + side * middle - size / 2, center.y() - size / 2, size, size)
                draw_icon(painter, rect, icon, ink)
        self._paint_directions(painter, center, inner)
        knob = center + self._knob * self._reach()
        size = radius * _KNOB
        painter.setPen(QPen(theme.color("blue" if self.held else "line_strong"), 1.5))
        painter.setBrush(theme.color("blue" if self.held else "raised_hover"))
        painter.drawEllipse(knob, size, size)
        if self._use == "head":
            ink = theme.color("on_blue" if self.held else "text")
            draw_icon(painter, QRectF(knob.x() - 9, knob.y() - 9, 18, 18), "eye", ink)

    def _paint_directions(self, painter: QPainter, center: QPointF, inner: float) -> None:
        painter.setFont(self._theme.font(tokens.STATUS_PX))
        turns = self._use == "base"
        size = min(14.0, inner * 0.3)
        offset = inner - size * 0.85
        for icon, x, y in (
            ("caret-up", 0, -1), ("caret-down", 0, 1),
            ("arrow-counter-clockwise" if turns else "caret-left", -1, 0),
            ("arrow-clockwise" if turns else "caret-right", 1, 0),
        ):  # fmt: skip
            rect = QRectF(center.x() + x * offset - size / 2, center.y() + y * offset - size / 2, size, size)
            draw_icon(painter, rect, icon, self._theme.color("dim"))


_CELLS = (
    ("strafe_left", 0, 0), ("drive_forward", 0, 1), ("strafe_right", 0, 2),
    ("turn_left", 1, 0), ("drive_back", 1, 1), ("turn_right", 1, 2),
)  # fmt: skip
_DIRECTIONS = ("drive_forward", "turn_left", "drive_back", "turn_right")
_ANGLES_DEG = {
    "drive_forward": 0.0, "turn_right": 90.0, "drive_back": 180.0, "turn_left": 270.0, "strafe_left": 270.0,
    "strafe_right": 90.0,
}  # fmt: skip
_NAMES = {
    "drive_forward": QT_TR_NOOP("Forward"), "turn_left": QT_TR_NOOP("Turn left"),
    "drive_back": QT_TR_NOOP("Backward"), "turn_right": QT_TR_NOOP("Turn right"),
    "strafe_left": QT_TR_NOOP("Sideways to the left"), "strafe_right": QT_TR_NOOP("Sideways to the right"),
}  # fmt: skip
_LOW_PX = 196
_VIEW_PX, _OTHERS_PX = 130, 110  # heights of arrows, stick or head, and of text and settings
_GAP_PX = 12
_ARROW_WIDTH_PX = 56
_GUARD_HINT_MS = 4000


class DrivePanel(Panel):
    """Hold-to-drive controls: hold an arrow or push the stick, on screen, keyboard or gamepad; releasing stops the
    robot.
    """

    title = QT_TR_NOOP("Drive")
    preferred_size, least_size = QSize(340, 260), QSize(250, 104)
    drives = True
    reads = ("permissions.driving",)

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("drive_panel")
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self._line = label("", "drive", wraps=True, objectName="drive_line")
        self._reason = label("", "small", wraps=True, objectName="drive_reason")
        self._pad = named(DrivePad(self.theme, self.table, self.hold), "drive_pad")
        self._stick = named(Joystick(self.theme, use="base"), "drive_stick")
        self._stick.moved.connect(partial(self.hold.motion.push_onscreen, "base"))
        self._head = named(HeadControl(self.theme, self.table), "head_control")
        self._head.stick.moved.connect(partial(self.hold.motion.push_onscreen, "head"))
        self._stop = ActionButton(self.theme, tr("Stop"), height_px=30, objectName="stop_button")
        self._stop.setProperty(STOPS, True)
        self._stop.clicked.connect(lambda: self.console.do(intents.Stop()))
        self._stop.set_key(self.table.key_text("stop"))
        self._other = ActionButton(self.theme, "", icon="game-controller", height_px=30, objectName="drive_other_view")
        self._other.clicked.connect(self._on_other_view)
        self._speed = named(SpeedSteps(self.table), "speed_steps")
        self._speed.chosen.connect(lambda fraction: self.console.do(intents.SetSpeed(fraction)))
        self._guard = HoldButton(self.theme, tr("Guard"), icon="shield-check", height_px=30, text_px=tokens.STATUS_PX)
        self._guard.setObjectName("guard_button")
        self._guard.held.connect(lambda: self.console.do(intents.SetGuard(on=False)))
        self._guard.let_go.connect(self._on_guard_let_go)
        self._guard.clicked.connect(self._on_guard_clicked)
        self.hold.escape_pressed.connect(self._guard.give_up)
        self._guard_hint = QTimer(self, singleShot=True, interval=_GUARD_HINT_MS)
        self._guard_hint.timeout.connect(self._show_now)
        # View shown if arrows, stick and head do not all fit.
        self._chosen_view = 0
        self._words = QWidget()
        layouts.vbox(self._words, self._line, self._reason, 1, margins_px=0, spacing_px=2)
        self._settings = QWidget()
        layouts.hbox(self._settings, (self._speed, 1), self._guard, margins_px=0, spacing_px=tokens.GRID_PX)
        self._views = QWidget()
        parts = (self._pad, 3), (self._stick, 2), (self._head, 2)
        self._row = layouts.hbox(self._views, *parts, margins_px=0, spacing_px=_GAP_PX)
        self._first = layouts.vbox(None, (self._words, 1), spacing_px=tokens.GRID_PX)
        self._second = layouts.vbox(None, (self._views, 1), self._settings, spacing_px=tokens.GRID_PX)
        self._layout = QBoxLayout(QBoxLayout.Direction.TopToBottom, self)
        card_margins(self._layout)
        layouts.fill(self._layout, self._first, (self._second, 1))
        self.watch(
            self._show_now, self.state.drive.changed, self.state.goal.changed, self.hold.motion.held_changed,
            self.hold.key_owner_changed, self.table.keys_changed,
        )  # fmt: skip
        self.watch(self._on_head_changed, self.state.look.changed)
        self.state.robot.follow(self._on_robot_changed)

    def title_widgets(self) -> list[QWidget]:
        return [self._other, self._stop]

    def fit(self) -> None:
        # Low and wide: text and speed next to the arrows instead of above and below.
        beside = self.height() < _LOW_PX and self.width() >= 400
        direction = QBoxLayout.Direction.LeftToRight if beside else QBoxLayout.Direction.TopToBottom
        if direction != self._layout.direction():
            self._layout.setDirection(direction)
            # When that low, a second line of text matters more than margins.
            self._layout.setContentsMargins(14, 8 if beside else 12, 14, 8 if beside else 12)
            self._layout.setSpacing(16 if beside else tokens.GRID_PX)
            self._layout.setStretch(0, 1 if beside else 0)
            target, source = (self._first, self._second) if beside else (self._second, self._first)
            source.removeWidget(self._settings)
            target.addWidget(self._settings)
            self._show_guard(self.state.drive.value)
        self._arrange_views()

    def use_settings(self, settings: PanelSettings) -> None:
        self._chosen_view = ("arrows", "stick", "head").index(settings.drive.first)
        self._arrange_views()

    def _available_views(self) -> list[QWidget]:
        robot: RobotProfile | None = self.state.robot.value
        has_head = self.state.look.value.present or (robot is not None and robot.head is not None)
        return [self._pad, self._stick, self._head] if has_head else [self._pad, self._stick]

    def _arrange_views(self) -> None:
        views = self._available_views()
        beside = self._layout.direction() == QBoxLayout.Direction.LeftToRight
        room = (self.width() - 28) * (0.56 if beside else 1.0) - (16 if beside else 0)
        order = views[self._chosen_view % len(views) :] + views[: self._chosen_view % len(views)]
        widths = [view.minimumSizeHint().width() + _GAP_PX for view in order]
        stacked = not beside and sum(widths) > room and self.height() >= _VIEW_PX * len(views) + _OTHERS_PX
        directions = QBoxLayout.Direction
        self._row.setDirection(directions.TopToBottom if stacked else directions.LeftToRight)
        visible: list[QWidget] = []
        for view, width in zip(order, widths, strict=True):
            if not visible or stacked or width <= room:
                visible.append(view)
                room -= width
        for view in (self._pad, self._stick, self._head):
            view.setVisible(view in visible)
        following = order[1] if len(order) > 1 else order[0]
        icon, name = {
            self._pad: ("arrows-out-cardinal", tr("Show the arrows")),
            self._stick: ("game-controller", tr("Show the stick")),
            self._head: ("eye", tr("Show the head")),
        }[following]  # fmt: skip
        self._other.set_label("", icon=icon, name=name, tip=name)
        self._other.setVisible(len(visible) < len(views))

    def _on_other_view(self) -> None:
        self._chosen_view = (self._chosen_view + 1) % len(self._available_views())
        self._arrange_views()

    def _on_robot_changed(self, robot: object) -> None:
        self._stick.set_sideways(robot is not None and bool(getattr(robot, "holonomic", False)))
        self._pad.show_rows()
        self._arrange_views()
        self._on_head_changed(self.state.look.value)
        self._show_now()

    def _on_head_changed(self, head: HeadStatus) -> None:
        self._head.show_angles(head.pan_rad, head.tilt_rad)

    def _on_guard_clicked(self) -> None:
        # One click switches it on; switching it off needs a long press.
        if self.state.drive.value.guard == "overridden":
            self.console.do(intents.SetGuard(on=True))

    def _on_guard_let_go(self) -> None:
        self._guard_hint.start()
        self._show_now()

    def update_view(self) -> None:
        self._on_robot_changed(self.state.robot.value)

    def _show_now(self) -> None:
        if not self.in_view:
            return
        drive: DriveStatus = self.state.drive.value
        has_goal = bool(text_formatting.goal_now(self.state.goal.value))
        navigates = has_goal and drive.allowed and not drive.emergency_stop
        navigates = navigates and drive.target_forward_mps == drive.target_turn_radps == drive.target_left_mps == 0.0
        # Picture and map say where to.
        self._line.setText(tr("Navigating") if navigates else text_formatting.drive_line(drive))
        top_mps = drive.max_forward_mps * drive.speed_fraction
        self._speed.show_fraction(drive.speed_fraction)
        text, role = self._reason_words(drive, has_goal=has_goal)
        self._reason.setText(text)
        restyle(self._reason, tone=role)
        free = drive.allowed and not drive.emergency_stop
        for view in (self._pad, self._stick, self._head):
            view.setEnabled(free)
        self._show_guard(drive)
        if not free:
            self.set_fact("")  # said below
        elif drive.guard == "overridden":
            self.set_fact(tr("guard off"), "amber")
        elif self.hold.held or self.hold.motion.command.moving:
            self.set_fact(tr("{speed:.2f} m/s at most").format(speed=top_mps), "blue")
        elif navigates and not text_formatting.goal_speed(self.state.robot.value, drive)[1]:
            self.set_fact(tr("goals: own speed"), "amber")
        elif self.state.robot.value is not None and not self.state.robot.value.stops_by_itself:
            # The notification on connecting gave the reason.
            self.set_fact(tr("{speed:.2f} m/s at most · half speed").format(speed=top_mps), "amber")
        else:
            self.set_fact(tr("{speed:.2f} m/s at most").format(speed=top_mps))

    def _reason_words(self, drive: DriveStatus, *, has_goal: bool) -> tuple[str, str]:
        """Reason line below the current activity, and its colour role."""
        guard = text_formatting.guard_line(drive)
        if drive.emergency_stop and not self.state.present.live:
            return tr("Emergency stop active"), "red"  # a replay has no banner
        if drive.emergency_stop:
            return tr("Release the emergency stop in the red bar above to drive again."), "red"
        if not drive.allowed:
            return tr(drive.reason), "amber"
        if self.hold.must_let_go and not self.hold.held:
            return tr("Release and press again to drive."), "amber"
        if guard:
            return guard, "amber"
        if self._guard_hint.isActive() and drive.guard != "overridden":
            return tr("Hold Guard for one second to turn it off."), "amber"
        if drive.cap_reason:
            limited = tr("Limited to {percent:.0f} %: {reason}")
            return limited.format(percent=drive.cap_fraction * 100, reason=tr(drive.cap_reason)), "amber"
        if self.hold.held or self.hold.motion.command.moving:
            return tr("Release to stop."), "dim"
        if has_goal:
            speed, by_speed_setting = text_formatting.goal_speed(self.state.robot.value, drive, begins=True)
            stops = tr("{key} stops the robot.").format(key=self.table.key_text("stop"))
            # The title bar has the speed setting.
            return (stops, "dim") if by_speed_setting else (f"{speed}. {stops}", "amber")
        owner = self.hold.key_owner
        sentence = owner_sentence(owner, [self.table.key_text(action_id) for action_id in _DIRECTIONS])
        return sentence, "amber" if owner in ("nowhere", "dialog", "menu", "elsewhere") else "dim"

    def _show_guard(self, drive: DriveStatus) -> None:
        self._guard.setVisible(drive.guard != "absent")
        self._guard.wants_hold = drive.guard != "overridden"
        if drive.guard == "overridden":
            # Next to the arrows only the text fits.
            beside = self._layout.direction() == QBoxLayout.Direction.LeftToRight
            self._guard.set_label(
                tr("Guard off"), icon="" if beside else "shield-slash", role="amber", name=tr("Guard is off"),
                tip=tr("Nothing stops the robot from driving into obstacles. Click to turn the guard on."),
            )  # fmt: skip
        else:
            icon = "shield-warning" if drive.guard in ("slowing", "blocked", "blind") else "shield-check"
            self._guard.set_label(
                tr("Guard"), icon=icon, role="plain", name=tr("Guard is on"),
                tip=tr("Slows and stops the robot in front of obstacles. Hold for one second to turn the guard off."),
            )  # fmt: skip

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self.setFocus(Qt.FocusReason.MouseFocusReason)
        super().mousePressEvent(event)


class SpeedSteps(QWidget):
    """Speed selector: slow, normal, fast, with its keys where they fit."""

    accessible_role = QAccessible.Role.Grouping

    chosen = Signal(float)

    def __init__(self, actions: Actions) -> None:
        super().__init__()
        self._actions = actions
        self._step = 1
        self.setFixedHeight(30)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setToolTip(tr("Top speed"))
        self._slower, self._faster = KeyCap(), KeyCap()
        frame = named(QFrame(self), "speed_frame")
        steps = layouts.hbox(frame, margins_px=0, spacing_px=0)
        self._steps: list[QPushButton] = []
        for name, fraction in zip(SPEED_NAMES, SPEED_FRACTIONS, strict=True):
            step = named(QPushButton(tr(name)), "speed_step")
            step.setCheckable(True)
            step.setFocusPolicy(Qt.FocusPolicy.NoFocus)
            step.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Expanding)
            step.clicked.connect(partial(self._on_clicked, fraction))
            steps.addWidget(step)
            self._steps.append(step)
        layouts.hbox(self, self._slower, (frame, 1), self._faster, margins_px=0, spacing_px=6)
        self._show()
        actions.keys_changed.connect(self._show_keys)

    def sizeHint(self) -> QSize:
        return QSize(260, 30)

    def minimumSizeHint(self) -> QSize:
        return QSize(sum(step.sizeHint().width() for step in self._steps), 30)

    def show_fraction(self, fraction: float) -> None:
        step = speed_step(fraction)
        if step != self._step:
            self._step = step
            self._show()

    def _on_clicked(self, fraction: float) -> None:
        self.chosen.emit(fraction)
        self._show()  # a refused speed is not checked

    def _show(self) -> None:
        for number, step in enumerate(self._steps):
            step.setChecked(number == self._step)
        self.setAccessibleName(tr("Top speed: {speed}").format(speed=self._steps[self._step].text()))

    def _show_keys(self) -> None:
        caps = {self._slower: "slower", self._faster: "faster"}
        for cap, action_id in caps.items():
            cap.setText(self._actions.key_text(action_id))
        needed_px = sum(cap.sizeHint().width() + 6 for cap in caps)
        needed_px += len(self._steps) * max(step.sizeHint().width() for step in self._steps)
        for cap in caps:
            cap.setVisible(needed_px <= self.width() and bool(cap.text()))

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._show_keys()


class HeadControl(QWidget):
    """Head stick, commanded angles, and a button to look ahead."""

    def __init__(self, theme: Theme, actions: Actions) -> None:
        super().__init__()
        self.stick = named(Joystick(theme, use="head"), "head_stick")
        self._angles = label("", "small", objectName="head_angles", alignment=Qt.AlignmentFlag.AlignCenter)
        ahead = ActionButton(theme, tr("Ahead"), height_px=28, text_px=tokens.STATUS_PX, objectName="look_ahead_button")
        ahead.setMinimumWidth(128)  # includes its longest key cap
        ahead.bind(actions, "look_ahead")
        column = layouts.vbox(None, 1, self._angles, spacing_px=4)
        column.addWidget(ahead, 0, Qt.AlignmentFlag.AlignHCenter)
        column.addStretch(1)
        layouts.hbox(self, (self.stick, 1), column, margins_px=0, spacing_px=6)

    def minimumSizeHint(self) -> QSize:
        return QSize(self.stick.minimumSizeHint().width() + 138, self.stick.minimumSizeHint().height())

    def show_angles(self, pan_rad: float, tilt_rad: float) -> None:
        self._angles.setText(text_formatting.head_angles(pan_rad, tilt_rad))


class DrivePad(QWidget):
    """Arrow pad with four arrows, or six for a holonomic base. Arrows can be held with the mouse and
    reflect held keys.
    """

    def __init__(self, theme: Theme, actions: Actions, hold: DriveInputFilter) -> None:
        super().__init__()
        self._actions = actions
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(6)
        self.arrows: dict[str, HoldArrow] = {}
        for action_id, row, column in _CELLS:
            arrow = named(HoldArrow(theme, actions, hold, action_id), f"hold_{action_id}")
            self.arrows[action_id] = arrow
            grid.addWidget(arrow, row, column)
        for column in range(3):
            grid.setColumnStretch(column, 1)
        for row in range(2):
            grid.setRowStretch(row, 1)
        self.setMaximumHeight(176)
        actions.rows_changed.connect(self.show_rows)
        self.show_rows()

    def minimumSizeHint(self) -> QSize:
        return QSize(3 * _ARROW_WIDTH_PX + 12, 62)

    def show_rows(self) -> None:
        """Show sideways arrows only for a holonomic base."""
        for action_id, arrow in self.arrows.items():
            arrow.setVisible(self._actions.spec(action_id) is not None)


class HoldArrow(QWidget):
    """Arrow of the pad; drives while the mouse button is held."""

    accessible_role = QAccessible.Role.Button

    def __init__(self, theme: Theme, actions: Actions, hold: DriveInputFilter, action_id: str) -> None:
        super().__init__()
        self._theme = theme
        self._actions = actions
        self._hold = hold
        self._action_id = action_id
        self._shown_held = False
        self.setMinimumSize(_ARROW_WIDTH_PX, 28)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setAccessibleName(tr(_NAMES[action_id]))
        self.setToolTip(tr("{direction}: hold").format(direction=tr(_NAMES[action_id])))
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)
        actions.keys_changed.connect(self.update)
        hold.motion.held_changed.connect(self._on_held_changed)

    def _on_held_changed(self, held: frozenset[str]) -> None:
        if (self._action_id in held) != self._shown_held:
            self.update()

    def changeEvent(self, event: QEvent) -> None:
        # A disabled widget receives no mouse release.
        if event.type() == QEvent.Type.EnabledChange and not self.isEnabled():
            self._hold.motion.let_go_onscreen(self._action_id)
        super().changeEvent(event)

    def hideEvent(self, event: QHideEvent) -> None:
        self._hold.motion.let_go_onscreen(self._action_id)
        super().hideEvent(event)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton:
            self._hold.motion.hold_onscreen(self._action_id)
            event.accept()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton:
            self._hold.motion.let_go_onscreen(self._action_id)
            event.accept()

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme = self._theme
        held = self._shown_held = self._action_id in self._hold.held
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if not self.isEnabled():
            painter.setOpacity(0.5)
        rect = QRectF(self.rect()).adjusted(0.5, 0.5, -0.5, -0.5)
        ground = "blue_soft" if held else ("raised_hover" if self.underMouse() and self.isEnabled() else "raised")
        painter.setPen(QPen(theme.color("blue" if held else "line"), 2 if held else 1))
        painter.setBrush(theme.color(ground))
        painter.drawRoundedRect(rect, tokens.CONTROL_RADIUS_PX, tokens.CONTROL_RADIUS_PX)
        key = self._actions.key_text(self._action_id)
        cap = key_cap_width(theme, key)
        beside = rect.height() < 62
        arrow_px = min(20.0, rect.height() * 0.4, rect.width() - cap - 12 if beside else rect.width())
        center = rect.center()
        arrow_center = (
            QPointF(center.x() - (cap + 8) / 2, center.y()) if beside else QPointF(center.x(), center.y() - 13)
        )
        self._paint_arrow(painter, arrow_center, arrow_px, "blue" if held else "text")
        if beside:
            draw_key_cap(painter, theme, key, arrow_center.x() + arrow_px / 2 + 8, center.y(), pressed=held)
        else:
            draw_key_cap(painter, theme, key, center.x() - cap / 2, center.y() + 8 + HEIGHT_PX / 2, pressed=held)

    def _paint_arrow(self, painter: QPainter, center: QPointF, size_px: float, role: str) -> None:
        half = size_px / 2
        painter.save()
        painter.translate(center)
        painter.rotate(_ANGLES_DEG[self._action_id])
        painter.setPen(
            QPen(
                self._theme.color(role), 2.4, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap, Qt.PenJoinStyle.RoundJoin
            )
        )
        painter.drawLine(QPointF(0, half), QPointF(0, -half))
        if self._action_id.startswith("strafe"):
            painter.drawLine(QPointF(-half * 0.7, -half * 1.3), QPointF(half * 0.7, -half * 1.3))
        painter.drawPolyline(
            QPolygonF([QPointF(-half * 0.7, -half * 0.3), QPointF(0, -half), QPointF(half * 0.7, -half * 0.3)])
        )
        painter.restore()


HOLD_MS = 1000
_STEP_MS = 30


class HoldButton(ActionButton):
    """Long-press button for commands that must not happen by accident.

    ``held`` after a second of holding by mouse or Space; ``let_go`` on an earlier release.

    While ``wants_hold`` is False it is an ordinary button that emits ``clicked``.
    """

    held = Signal()
    let_go = Signal()

    def __init__(self, theme: Theme, text: str, *, icon: str, height_px: int, text_px: int) -> None:
        super().__init__(theme, text, icon=icon, height_px=height_px, text_px=text_px)
        self.wants_hold = True
        self._spent = False
        self._since = QElapsedTimer()
        self._progress = QTimer(self, interval=_STEP_MS)
        self._progress.timeout.connect(self._on_progress)
        self._bar = named(QProgressBar(textVisible=False, maximum=HOLD_MS), "hold_progress", text)
        self._bar.hide()
        layouts.vbox(self, 1, self._bar, margins_px=0)
        self.pressed.connect(self._on_pressed)
        self.released.connect(self._on_released)

    @property
    def holding(self) -> bool:
        return self._progress.isActive()

    def give_up(self) -> None:
        """Cancel: a button still down does nothing."""
        if self.holding:
            self._progress.stop()
            self._bar.hide()

    def _on_pressed(self) -> None:
        if self.wants_hold:
            self._since.start()
            self._progress.start()
            self._bar.reset()
            self._bar.show()

    def _on_progress(self) -> None:
        if self._since.elapsed() >= HOLD_MS:
            self.give_up()
            # The following release must not count as a click, which would do the opposite.
            self._spent = True
            self.setDown(False)
            self.held.emit()
        self._bar.setValue(self._since.elapsed())

    def _on_released(self) -> None:
        if self.holding:
            self.give_up()
            self.let_go.emit()

    def hitButton(self, pos: QPoint) -> bool:
        return not self._spent and super().hitButton(pos)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self._spent = False
        super().mousePressEvent(event)

    def hideEvent(self, event: QHideEvent) -> None:
        self.give_up()
        super().hideEvent(event)

    def focusOutEvent(self, event: QFocusEvent) -> None:
        self.give_up()
        super().focusOutEvent(event)
