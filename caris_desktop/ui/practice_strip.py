"""Practice strip: current step, instruction and progress in two lines."""

import json
from collections.abc import Callable
from dataclasses import asdict, fields
from datetime import UTC, datetime
from typing import Any

from PySide6.QtCore import QRectF, QSize, Qt
from PySide6.QtGui import QAccessible, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QSizePolicy, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.services.practice_service import STEPS, PracticeStep
from caris_desktop.live.status import PracticeStatus, PracticeStepStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.focus_widget import Bar
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.preferences import WizardProfiles
from caris_desktop.ui.text_formatting import shortened
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.labels import label

_BUTTON_PX = 30
_DOT_PX, _GAP_PX = 22, 4
_LOOKS = {
    "done": ("check", "green"),
    "skipped": ("skip-forward", "dim"),
    "now": ("circle", "blue"),
    "open": ("", "dim"),
}


class StepDots(QWidget):
    """Progress indicator: done, skipped, current or open, distinguished by shape as well as colour."""

    accessible_role = QAccessible.Role.Indicator

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._theme = theme
        self._steps: tuple[PracticeStepStatus, ...] = ()
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)
        theme.changed.connect(self.update)

    def show_steps(self, steps: tuple[PracticeStepStatus, ...]) -> None:
        self._steps = steps
        done = sum(step.state == "done" for step in steps)
        self.setAccessibleName(tr("{done} of {count} steps done").format(done=done, count=len(steps)))
        self.setToolTip(self.accessibleName())
        self.updateGeometry()
        self.update()

    def sizeHint(self) -> QSize:
        return QSize(len(self._steps) * (_DOT_PX + _GAP_PX), _DOT_PX)

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        for number, step in enumerate(self._steps):
            icon, role = _LOOKS[step.state]
            dot = QRectF(number * (_DOT_PX + _GAP_PX) + 1, 1, _DOT_PX - 2, _DOT_PX - 2)
            painter.setPen(QPen(self._theme.color(role), 2.4 if step.state == "now" else 1.2))
            painter.setBrush(self._theme.color("raised"))
            painter.drawEllipse(dot)
            if icon and step.state != "now":
                draw_icon(painter, dot.adjusted(4, 4, -4, -4), icon, self._theme.color(role))
            elif step.state == "now":
                painter.setFont(self._theme.font(tokens.STATUS_PX - 2, tokens.WEIGHT_SEMIBOLD))
                painter.drawText(dot, Qt.AlignmentFlag.AlignCenter, str(number + 1))


class PracticeStrip(Bar, QWidget):
    """Below the notice strip during a practice, until its result was read."""

    accessible_role = QAccessible.Role.Grouping

    def __init__(self, theme: Theme, console: WizardConsole, actions: Actions, wizards: WizardProfiles) -> None:
        super().__init__()
        self.setObjectName("practice_strip")
        self.setAccessibleName(tr("Practice"))
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Maximum)
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self._console = console
        self._actions = actions
        self._wizards = wizards
        self._saved = False
        self._title = label("", "title", wraps=True, objectName="practice_title")
        self._how = label(tone="dim", wraps=True, objectName="practice_how")
        self._theme = theme
        self._dots = StepDots(theme)
        self._again = self._button("again", tr("Practise again"), self.begin)
        self._end = self._button("end", tr("End practice"), lambda: console.do(intents.EndPractice()))
        self._skip = self._button("skip", tr("Skip"), lambda: console.do(intents.SkipPracticeStep()))
        self._skip.set_label(tr("Skip"), icon="skip-forward", role="ghost")
        self._skip.setToolTip(tr("Continue with the next step. A skipped step earns no points."))
        words = layouts.vbox(None, self._title, self._how, spacing_px=1)
        parts = self._dots, self._skip, self._again, self._end
        layouts.hbox(self, (words, 1), *parts, margins_px=(18, 6, 15, 6), spacing_px=tokens.GRID_PX)
        console.state.practice.changed.connect(self._show)
        actions.keys_changed.connect(self._on_keys_changed)
        self._show(console.state.practice.value)

    def _button(self, name: str, text: str, run: Callable[[], object]) -> ActionButton:
        return ActionButton(self._theme, text, height_px=_BUTTON_PX, objectName=f"practice_{name}", clicked=run)

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
                self._how_to(step),
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

    def _how_to(self, step: PracticeStep) -> str:
        return tr(step.how).format(key=self._actions.key_text(step.action_id) if step.action_id else "")

    def _result(self, status: PracticeStatus) -> tuple[str, str]:
        title = tr("Practice ended: {done} of {count} steps, {score} of 100 points, {minutes} min").format(
            done=status.done, count=len(STEPS), score=status.score, minutes=f"{status.minutes:.1f}"
        )
        runs = practised(self._wizards)
        best = max((run.score for run in runs[:-1]), default=None)
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
            now = datetime.now(UTC).isoformat(timespec="seconds")
            save_run(self._wizards, PracticeRun(now, status.done, len(STEPS), round(status.minutes, 1), status.score))

    def _say(self, title: str, how: str) -> None:
        self._title.setText(title)
        self._how.setText(how)


_KEY = "practice"
_AT_MOST = 100


class PracticeRun(Value):
    """Practice results, saved in the wizard's profile.

    Practice result. ``ended_utc``: ISO 8601; ``done`` of ``steps`` completed; ``score`` out of 100.
    """

    ended_utc: str
    done: int
    steps: int
    minutes: float
    score: int


def practised(wizards: WizardProfiles) -> tuple[PracticeRun, ...]:
    """Results of the current wizard, oldest first; unreadable ones are skipped."""
    try:
        stored = json.loads(str(wizards.own_value(_KEY, "[]")))
    except ValueError:
        return ()
    runs = [_run(item) for item in stored] if isinstance(stored, list) else []
    return tuple(run for run in runs if run is not None)


def save_run(wizards: WizardProfiles, run: PracticeRun) -> None:
    runs = (*practised(wizards), run)[-_AT_MOST:]
    wizards.set_value(_KEY, json.dumps([asdict(one) for one in runs]))


def _run(item: Any) -> PracticeRun | None:
    if not isinstance(item, dict) or {field.name for field in fields(PracticeRun)} - set(item):
        return None
    try:
        return PracticeRun(
            str(item["ended_utc"]), int(item["done"]), int(item["steps"]), float(item["minutes"]), int(item["score"])
        )
    except (TypeError, ValueError):
        return None
