"""Hint line on how to drive; it disappears after the first metre."""

import math

from PySide6.QtCore import QRectF, Qt, QTimer, Signal
from PySide6.QtGui import QAccessible, QPaintEvent
from PySide6.QtWidgets import QLabel, QSizePolicy, QWidget

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import Odometry
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import PracticeStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui import layouts
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.focus_widget import Bar
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton

_FIRST_METRE_M = 1.0
_PRAISED_MS = 20_000


class DriveHint(Bar, QWidget):
    """``driven`` after a metre of driving; then ``practise_wanted`` if the wizard continues with the practice. Hidden
    until ``begin``.
    """

    accessible_role = QAccessible.Role.StaticText

    driven = Signal()
    practise_wanted = Signal()

    def __init__(self, theme: Theme, console: WizardConsole, actions: Actions) -> None:
        super().__init__()
        self.setObjectName("drive_hint")
        self._theme = theme
        self._console = console
        self._actions = actions
        self._from: Pose2D | None = None
        self._gone_m = 0.0
        self._waits = False
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self._text = QLabel(textFormat=Qt.TextFormat.PlainText, wordWrap=True)
        self._practise = ActionButton(theme, tr("Practise the rest"), icon="student", height_px=28)
        self._practise.setObjectName("drive_hint_practise")
        self._practise.clicked.connect(self._on_practise)
        self._practise.hide()
        close = ActionButton(theme, "", icon="x", look="ghost", height_px=28)
        close.setObjectName("drive_hint_close")
        close.setAccessibleName(tr("Close this hint"))
        close.clicked.connect(self.end)
        row = layouts.hbox(self, margins_px=(48, 5, 10, 5))
        row.addWidget(self._text, 1)
        row.addWidget(self._practise)
        row.addWidget(close)
        self._leave = QTimer(self, singleShot=True, interval=_PRAISED_MS)
        self._leave.timeout.connect(self.hide)
        state = console.state
        state.odometry.changed.connect(self._on_odometry)
        state.drive.changed.connect(self._show)
        state.link.changed.connect(self._show)
        state.practice.changed.connect(self._on_practice)
        state.scenario.changed.connect(self._on_scenario)
        actions.keys_changed.connect(self._show)
        theme.changed.connect(self._show)
        self.hide()

    @property
    def text(self) -> str:
        return self._text.text()

    def begin(self) -> None:
        """Show the hint and wait for a metre of driving."""
        if self._console.scenario.permissions.driving:
            self._from, self._gone_m = None, 0.0
            self._waits = True
            self._leave.stop()
            self._practise.hide()
            self._show()
            self.show()

    def end(self) -> None:
        """Hide the hint for good."""
        self._waits = False
        self.hide()
        self.driven.emit()

    def _on_odometry(self, odometry: Odometry) -> None:
        if self.isHidden() or self._leave.isActive():
            return
        here, before = odometry.pose_in_odom, self._from
        self._from = here
        if before is not None and (self._console.state.drive.value.target_forward_mps or self._gone_m):
            self._gone_m += math.hypot(here.x_m - before.x_m, here.y_m - before.y_m)
        if self._gone_m >= _FIRST_METRE_M:
            self._waits = False
            self._leave.start()
            self._practise.show()
            self._show()
            self.driven.emit()

    def _on_practice(self, status: PracticeStatus) -> None:
        """End: the practice explains driving."""
        if status.state and not self.isHidden():
            self.end()

    def _on_scenario(self, scenario: Scenario | None) -> None:
        """Hide without driving permission."""
        if scenario is not None and not scenario.permissions.driving:
            self.hide()
        elif self._waits and self.isHidden():
            self.begin()

    def _on_practise(self) -> None:
        self.hide()
        self.practise_wanted.emit()

    def _show(self, _changed: object = None) -> None:
        self._theme.color_text(self._text, "text")
        keys = {name: self._actions.key_text(name) for name in ("drive_forward", "turn_left", "turn_right", "stop")}
        if self._leave.isActive():
            text = tr("You have driven the first metre.")
        elif self._console.state.link.value.state != "connected":
            text = tr("Connecting to the robot…")
        else:
            text = tr("Hold {drive_forward} to drive, {turn_left} or {turn_right} to turn. Release the key to stop.")
            text = text.format(**keys)
        if text != self._text.text():
            self._text.setText(text)
            self.setAccessibleName(text)
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme = self._theme
        painter = theme.paint_box(self, ground="blue_soft", line="blue", radius_px=8, inset_px=(8.5, 3.5))
        icon = "check-circle" if self._leave.isActive() else "game-controller"
        draw_icon(painter, QRectF(20, self.height() / 2 - 9, 18, 18), icon, theme.color("blue"))
