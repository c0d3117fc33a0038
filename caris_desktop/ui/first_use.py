"""First-start sequence with the driving hint, and the practice strip; the settings that record their completion."""

import json
import math
from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QObject, Qt, QTimer, Signal
from PySide6.QtGui import QAccessible
from PySide6.QtWidgets import QLabel, QSizePolicy, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import Odometry
from caris_desktop.domain.translation import tr
from caris_desktop.live.services.practice_service import STEPS
from caris_desktop.live.status import PracticeStatus, PracticeStepStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.banners import Banner
from caris_desktop.ui.focus_widget import Bar
from caris_desktop.ui.preferences import WizardProfiles
from caris_desktop.ui.text_formatting import shortened
from caris_desktop.ui.theme import Theme, icon
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.labels import label, named, restyle
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
        hint: "DriveHint",
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
        self.hint = hint
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


class DriveHint(Banner):
    """Hint on how to drive; it disappears after the first metre.

    ``driven`` after a metre of driving; then ``practise_requested`` if the wizard continues with the practice. Hidden
    until ``begin``.
    """

    driven = Signal()
    practise_requested = Signal()

    def __init__(self, theme: Theme, console: WizardConsole, actions: Actions) -> None:
        super().__init__(theme, "drive_hint", role="blue")
        self._console = console
        self._actions = actions
        self._from: Pose2D | None = None
        self._driven_m = 0.0
        self._waits = False
        restyle(self.text, role="small")
        self._practise = self.add_button(
            "drive_hint_practise", tr("Practise the rest"), self._on_practise, icon="student"
        )
        self._practise.hide()
        close = tr("Close this hint")
        self.add_button("drive_hint_close", "", self.end, icon="x", role="ghost", accessibleName=close, toolTip=close)
        self._leave = QTimer(self, singleShot=True, interval=_PRAISED_MS)
        self._leave.timeout.connect(self.hide)
        state = console.state
        state.odometry.changed.connect(self._on_odometry)
        state.drive.changed.connect(self._show)
        state.link.changed.connect(self._show)
        state.practice.changed.connect(self._on_practice)
        state.scenario.changed.connect(self._on_scenario)
        actions.keys_changed.connect(self._show)

    def begin(self) -> None:
        """Show the hint and wait for a metre of driving."""
        if self._console.scenario.permissions.driving:
            self._from, self._driven_m = None, 0.0
            self._waits = True
            self._leave.stop()
            self._practise.hide()
            self._show()

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
            # Two lines, so that it fits beside the photo button.
            text = tr("Hold {drive_forward} to drive, {turn_left} or {turn_right} to turn.\nRelease the key to stop.")
            text = text.format(**keys)
        if text != self.text.text():
            self.say(text)
        if self._waits:
            state = self._console.state
            hindered = state.drive.value.emergency_stop or state.link.value.state == "lost"  # which is shown larger
            self.setVisible(self._console.scenario.permissions.driving and not hindered)


_BUTTON_PX = 30
_DOT_PX, _DOT_ICON_PX, _GAP_PX = 22, 12, 4
_LOOKS = {
    "done": ("check", "green"),
    "skipped": ("skip-forward", "dim"),
    "now": ("", "blue"),
    "open": ("", "dim"),
}


class StepDots(QWidget):
    """Progress indicator: done, skipped, current or open, distinguished by shape as well as colour."""

    accessible_role = QAccessible.Role.Indicator

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._theme = theme
        self._steps: tuple[PracticeStepStatus, ...] = ()
        self._dots: list[QLabel] = []
        self._row = layouts.hbox(self, margins_px=0, spacing_px=_GAP_PX)
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)
        theme.changed.connect(self._draw)

    def show_steps(self, steps: tuple[PracticeStepStatus, ...]) -> None:
        self._steps = steps
        layouts.adjust_count(self._dots, len(steps), self._new_dot)
        self._draw()
        done = sum(step.state == "done" for step in steps)
        self.setAccessibleName(tr("{done} of {count} steps done").format(done=done, count=len(steps)))
        self.setToolTip(self.accessibleName())

    def _new_dot(self) -> QLabel:
        dot = named(QLabel(alignment=Qt.AlignmentFlag.AlignCenter), "step_dot")
        dot.setFixedSize(_DOT_PX, _DOT_PX)
        self._row.addWidget(dot)
        return dot

    def _draw(self) -> None:
        for number, (dot, step) in enumerate(zip(self._dots, self._steps, strict=True), start=1):
            name, role = _LOOKS[step.state]
            dot.setPixmap(icon(name, self._theme.color(role), _DOT_ICON_PX).pixmap(_DOT_ICON_PX))
            if step.state == "now":
                dot.setText(str(number))
            restyle(dot, tone=role)


class PracticeStrip(Bar, QWidget):
    """Below the notice strip during a practice, until its result was read."""

    accessible_role = QAccessible.Role.Grouping

    def __init__(self, theme: Theme, console: WizardConsole, actions: Actions, wizards: WizardProfiles) -> None:
        super().__init__()
        named(self, "practice_strip", tr("Practice"))
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Maximum)
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self._console = console
        self._actions = actions
        self._wizards = wizards
        self._saved = False
        self._title = label("", "title", wraps=True, objectName="practice_title")
        self._how = label(tone="dim", wraps=True, objectName="practice_how")
        self._dots = StepDots(theme)
        button = partial(ActionButton, theme, height_px=_BUTTON_PX)
        self._again = button(tr("Practise again"), objectName="practice_again", clicked=self.begin)
        self._end = button(objectName="practice_end", clicked=lambda: console.do(intents.EndPractice()))
        self._skip = button(
            tr("Skip"), icon="skip-forward", role="ghost", objectName="practice_skip",
            toolTip=tr("Continue with the next step. A skipped step earns no points."),
            clicked=lambda: console.do(intents.SkipPracticeStep()),
        )  # fmt: skip
        words = layouts.vbox(None, self._title, self._how, spacing_px=1)
        parts = self._dots, self._skip, self._again, self._end
        layouts.hbox(self, (words, 1), *parts, margins_px=(18, 6, 15, 6), spacing_px=tokens.GRID_PX)
        actions.keys_changed.connect(self._on_keys_changed)
        console.state.practice.follow(self._show)

    def begin(self) -> None:
        """Start once the wizard is known."""
        self._console.do(intents.BeginPractice(self._wizards.current))

    def _on_keys_changed(self) -> None:
        self._show(self._console.state.practice.value)

    def _show(self, status: PracticeStatus) -> None:
        running, ended = status.state == "running", status.state == "ended"
        self._dots.show_steps(status.steps)
        self._dots.setVisible(bool(status.steps))
        self._skip.setVisible(running)
        self._again.setVisible(ended)
        self._end.set_label(self._end_words(status))
        if running:
            number = next(n for n, step in enumerate(status.steps) if step.state == "now")
            step = STEPS[number]
            self._say(
                tr("{number} of {count} · {title}").format(number=number + 1, count=len(STEPS), title=tr(step.title)),
                tr(step.how).format(key=self._actions.key_text(step.action_id) if step.action_id else ""),
            )
        elif ended:
            self._persist(status)
            self._say(*self._result(status))
        elif status.state:
            self._say(
                tr("Practice starts as soon as the simulated robot is ready."),
                tr("This is recorded as practice and excluded from the data."),
            )
        self._saved = self._saved and ended
        self.setVisible(bool(status.state) and self.parentWidget() is not None)

    def _end_words(self, status: PracticeStatus) -> str:
        if status.state != "ended":
            return tr("End practice")
        if not status.back_to:
            return tr("Close")
        return tr("Back to {scenario}").format(scenario=shortened(status.back_to, 30))

    def _result(self, status: PracticeStatus) -> tuple[str, str]:
        title = tr("Practice ended: {done} of {count} steps, {score} of 100 points, {minutes} min").format(
            done=status.done, count=len(STEPS), score=status.score, minutes=f"{status.minutes:.1f}"
        )
        runs = practised(self._wizards)
        best = max((run["score"] for run in runs[:-1]), default=None)
        if best is None:
            how = tr("A step done in its usual time earns ten points, a slower one fewer.")
        else:
            how = tr("Your previous best was {best} points, in %n runs.", "", len(runs) - 1).format(best=best)
        missing = [tr(STEPS[n].title) for n, step in enumerate(status.steps) if step.state != "done"]
        left = tr("Not done: {steps}.").format(steps=", ".join(missing)) if missing else tr("All steps were done.")
        return title, tr("{what_was_left} {comparison}").format(what_was_left=left, comparison=how)

    def _persist(self, status: PracticeStatus) -> None:
        """Save the result, once per run."""
        if not self._saved:
            self._saved = True
            run = {
                "ended_utc": datetime.now(UTC).isoformat(timespec="seconds"), "done": status.done, "steps": len(STEPS),
                "minutes": round(status.minutes, 1), "score": status.score,
            }  # fmt: skip
            self._wizards.set_value(_KEY, json.dumps([*practised(self._wizards), run][-_AT_MOST:]))

    def _say(self, title: str, how: str) -> None:
        self._title.setText(title)
        self._how.setText(how)


_KEY = "practice"
_AT_MOST = 100


def practised(wizards: WizardProfiles) -> list[dict[str, Any]]:
    """Practice results in the current wizard's profile, oldest first; unreadable ones are skipped.

    ``ended_utc``: ISO 8601; ``done`` of ``steps`` completed, in ``minutes``; ``score`` out of 100.
    """
    try:
        stored = json.loads(str(wizards.own_value(_KEY, "[]")))
    except ValueError:
        return []
    runs = stored if isinstance(stored, list) else []
    return [run for run in runs if isinstance(run, dict) and isinstance(run.get("score"), int)]
