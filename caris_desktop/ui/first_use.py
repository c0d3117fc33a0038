"""First-start sequence, and the settings that record its completion."""

import math
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Qt, QTimer, Signal
from PySide6.QtGui import QAccessible
from PySide6.QtWidgets import QSizePolicy, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import Odometry
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import PracticeStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui import layouts
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.focus_widget import Bar
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.icon_label import IconLabel
from caris_desktop.ui.widgets.labels import label
from caris_desktop.ui.window_place import Settings
from caris_desktop.ui.windows import RobotChooser

if TYPE_CHECKING:  # imported at first use
    from caris_desktop.ui.set_up_page import SetUpPage

SET_UP_KEY, DRIVEN_KEY = "first_use/set_up", "first_use/driven"


class FirstUse(QObject):
    """First-start sequence. Without ``settings`` nothing is saved, and nothing opens automatically."""

    def __init__(
        self,
        theme: Theme,
        console: WizardConsole,
        actions: Actions,
        robots: RobotChooser,
        window: QWidget,
        *,
        settings: Settings | None,
    ) -> None:
        super().__init__(window)
        self._theme = theme
        self._console = console
        self._robots = robots
        self._window = window
        self._settings = settings
        self._page: SetUpPage | None = None
        self.hint = DriveHint(theme, console, actions)
        self.hint.driven.connect(lambda: self._persist(DRIVEN_KEY, "yes"))

    def begin(self, *, with_simulated_robot: bool) -> None:
        """Start after the window is shown. With the simulated robot, only the driving hint appears."""
        if with_simulated_robot:
            self._show_how_to_drive()
        elif self._settings is not None and not self._settings.value(SET_UP_KEY, ""):
            self.open()

    def open(self) -> None:
        """Open the set-up page at its beginning."""
        from caris_desktop.ui.set_up_page import SetUpPage

        if self._page is None:
            self._page = SetUpPage(self._theme, self._window, self._console, self._robots)
            self._page.simulated_requested.connect(self._on_simulated_requested)
            self._page.finished.connect(lambda through: self._persist(SET_UP_KEY, "done" if through else "skipped"))
        self._page.open_welcome()

    def close(self) -> None:
        """Close the page (Esc)."""
        if self._page is not None:
            self._page.close_overlay()

    def _on_simulated_requested(self) -> None:
        self._console.do(intents.UseSimulatedRobot())
        self._show_how_to_drive()

    def _show_how_to_drive(self) -> None:
        if self._settings is not None and not self._settings.value(DRIVEN_KEY, ""):
            self.hint.begin()

    def _persist(self, key: str, value: str) -> None:
        if self._settings is not None:
            self._settings.setValue(key, value)


_FIRST_METRE_M = 1.0
_PRAISED_MS = 20_000


class DriveHint(Bar, QWidget):
    """Hint line on how to drive; it disappears after the first metre.

    ``driven`` after a metre of driving; then ``practise_requested`` if the wizard continues with the practice. Hidden
    until ``begin``.
    """

    accessible_role = QAccessible.Role.StaticText

    driven = Signal()
    practise_requested = Signal()

    def __init__(self, theme: Theme, console: WizardConsole, actions: Actions) -> None:
        super().__init__()
        self.setObjectName("drive_hint")
        self._console = console
        self._actions = actions
        self._from: Pose2D | None = None
        self._driven_m = 0.0
        self._waits = False
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self._icon = IconLabel(theme)
        self._text = label("", wraps=True)
        self._practise = ActionButton(
            theme, tr("Practise the rest"), icon="student", height_px=28, objectName="drive_hint_practise",
            clicked=self._on_practise,
        )  # fmt: skip
        self._practise.hide()
        close = ActionButton(
            theme, icon="x", role="ghost", height_px=28, objectName="drive_hint_close",
            accessibleName=tr("Close this hint"), clicked=self.end,
        )  # fmt: skip
        parts = self._icon, (self._text, 1), self._practise, close
        layouts.hbox(self, *parts, margins_px=(20, 5, 10, 5), spacing_px=10)
        self._leave = QTimer(self, singleShot=True, interval=_PRAISED_MS)
        self._leave.timeout.connect(self.hide)
        state = console.state
        state.odometry.changed.connect(self._on_odometry)
        state.drive.changed.connect(self._show)
        state.link.changed.connect(self._show)
        state.practice.changed.connect(self._on_practice)
        state.scenario.changed.connect(self._on_scenario)
        actions.keys_changed.connect(self._show)
        self.hide()

    @property
    def text(self) -> str:
        return self._text.text()

    def begin(self) -> None:
        """Show the hint and wait for a metre of driving."""
        if self._console.scenario.permissions.driving:
            self._from, self._driven_m = None, 0.0
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
        if before is not None and (self._console.state.drive.value.target_forward_mps or self._driven_m):
            self._driven_m += math.hypot(here.x_m - before.x_m, here.y_m - before.y_m)
        if self._driven_m >= _FIRST_METRE_M:
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
        self.practise_requested.emit()

    def _show(self, _changed: object = None) -> None:
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
        self._icon.show_icon("check-circle" if self._leave.isActive() else "game-controller", "blue")
