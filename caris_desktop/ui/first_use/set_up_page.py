"""Set-up page of the first start: try the program, or connect everything. Not a dialog: the red button stays usable."""

from typing import Any

from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtGui import QMouseEvent
from PySide6.QtWidgets import QBoxLayout, QButtonGroup, QLabel, QPushButton, QSizePolicy, QStackedWidget, QWidget

from caris_desktop.domain.events import PreflightState
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import PreflightCheck
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts
from caris_desktop.ui.first_use.step_pages import SetUpStep, StepName, StepPage, page_maker, steps_for
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.preflight.preflight_words import ICONS, ROLES, STATES, worst
from caris_desktop.ui.robot_choice import RobotChooser
from caris_desktop.ui.text_formatting import ESC_CLOSES
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import Scrolled
from caris_desktop.ui.widgets.labels import ElidedLabel, IconLabel, label, restyle

_WIDTH_PX, _WELCOME_PX, _HEIGHT_PX, _STEPS_PX = 880, 430, 600, 220
_BESIDE_FROM_PX, _NARROW_STEPS_PX = 700, 184


class SetUpPage(Overlay):
    """``simulated_requested``: try the simulated robot; ``finished(bool)``: closed, True if all steps are complete."""

    simulated_requested = Signal()
    finished = Signal(bool)

    def __init__(self, theme: Theme, window: QWidget, console: WizardConsole, robots: RobotChooser) -> None:
        super().__init__(theme, window, width_px=_WIDTH_PX)
        self.setObjectName("first_use")
        self.setAccessibleName(tr("Set up"))
        self._console = console
        self._make_page = page_maker(theme, console, robots)
        self._through = False
        self._pages = QStackedWidget()
        self._pages.addWidget(self._make_welcome())
        column = layouts.vbox(self.card, margins_px=(28, 22, 28, 20))
        column.addWidget(self._pages)
        self._steps: tuple[SetUpStep, ...] = ()
        self._step_buttons: dict[StepName, StepButton] = {}
        self._step_page: QWidget | None = None
        console.state.preflight.changed.connect(self._show_checks)

    @property
    def step(self) -> StepName | None:
        """Current step; None on the welcome page."""
        page = self._stack.currentWidget() if self._step_page is not None else None
        on_show = self._pages.currentWidget() is self._step_page
        return page.step.name if on_show and isinstance(page, StepPage) else None

    def open_welcome(self) -> None:
        self._through = False
        self._pages.setCurrentIndex(0)
        self.open()
        self._simulated.setFocus(Qt.FocusReason.TabFocusReason)

    def card_height_px(self) -> int:
        return _WELCOME_PX if self._pages.currentIndex() == 0 else _HEIGHT_PX

    def _place(self) -> None:
        super()._place()
        narrow = self.card.width() < _BESIDE_FROM_PX
        for choice in self._choice_buttons:
            choice.set_low(narrow)
        if self._step_page is not None:
            self._rail.setFixedWidth(_NARROW_STEPS_PX if narrow else _STEPS_PX)
        self._choices.setDirection(QBoxLayout.Direction.TopToBottom if narrow else QBoxLayout.Direction.LeftToRight)

    def close_overlay(self) -> None:
        if not self.isHidden():
            super().close_overlay()
            self.finished.emit(self._through)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        event.accept()  # a click outside does not close it

    # Welcome

    def _make_welcome(self) -> QWidget:
        theme = self._theme
        page = QWidget()
        self._simulated = ChoiceButton(
            theme, tr("Try it with the simulated robot"),
            tr("A robot, rooms and people on this computer. Nothing can break, and you can drive within seconds."),
            "rocket-launch", tone="blue", objectName="first_use_simulated", clicked=self._on_simulated,
        )  # fmt: skip
        robot_button = ChoiceButton(
            theme, tr("Connect my robot"),
            tr("Set up robot, camera, sound and language model step by step. Each step is tested, and you can "
                "do it later."),
            "robot", objectName="first_use_own", clicked=self._on_own,
        )  # fmt: skip
        later = ActionButton(
            theme, tr("Not now"), key="Esc", role="ghost", toolTip=tr(ESC_CLOSES), objectName="first_use_later",
            clicked=self.close_overlay,
        )  # fmt: skip
        again = label(tr("You can find this again in the Window menu: Set up."), "small", wraps=True)
        self._choices = choices = QBoxLayout(QBoxLayout.Direction.LeftToRight)
        choices.setSpacing(16)
        self._choice_buttons = (self._simulated, robot_button)
        layouts.fill(choices, *self._choice_buttons)
        about = tr("Drive a robot, see what it sees and speak through it. How would you like to start?")
        content = QWidget()
        heading = label(tr("Welcome"), "heading", objectName="welcome")
        layouts.vbox(content, heading, label(about, wraps=True), 1, choices, 2, margins_px=0, spacing_px=12)
        layouts.vbox(page, (Scrolled(content), 1), layouts.hbox(None, (again, 1), later), margins_px=0, spacing_px=12)
        return page

    def _on_simulated(self) -> None:
        self._through = True
        self.simulated_requested.emit()
        self.close_overlay()

    def _on_own(self) -> None:
        self._build_steps()
        self.show_step(self._steps[0].name)

    # Steps

    def _build_steps(self) -> None:
        """Rebuilt each time: steps depend on the scenario."""
        if self._step_page is not None:
            self._pages.removeWidget(self._step_page)
            self._step_page.deleteLater()
        theme, page = self._theme, QWidget()
        self._steps = steps_for(self._console.state.preflight.value)
        self._stack = QStackedWidget()
        group = QButtonGroup(page)
        side = layouts.vbox(spacing_px=4)
        self._step_buttons = {}
        for step in self._steps:
            button = self._step_buttons[step.name] = StepButton(theme, tr(step.title))
            button.setObjectName(f"first_use_to_{step.name}")
            button.clicked.connect(lambda _on=False, name=step.name: self.show_step(name))
            group.addButton(button)
            side.addWidget(button)
            self._stack.addWidget(self._make_page[step.name](step))
        side.addStretch(1)
        self._back = ActionButton(
            theme, tr("Back"), icon="caret-left", role="ghost", objectName="first_use_back", clicked=self._on_back
        )
        self._next = ActionButton(theme, tr("Next"), role="primary", objectName="first_use_next", clicked=self._on_next)
        close = ActionButton(
            theme, tr("Close"), key="Esc", role="ghost", toolTip=tr(ESC_CLOSES), objectName="first_use_close",
            clicked=self.close_overlay,
        )  # fmt: skip
        rail = self._rail = QWidget()
        rail.setLayout(side)
        rail.setFixedWidth(_STEPS_PX)
        side.setContentsMargins(0, 0, 0, 0)
        content = QWidget()
        layouts.hbox(content, rail, (self._stack, 1), margins_px=(0, 0, 8, 0), spacing_px=28)
        foot = layouts.hbox(None, self._back, 1, close, self._next)
        layouts.vbox(page, (Scrolled(content), 1), foot, margins_px=0)
        self._step_page = page
        self._pages.addWidget(page)

    def show_step(self, name: StepName) -> None:
        place = [step.name for step in self._steps].index(name)
        self._stack.setCurrentIndex(place)
        if self._step_page is not None:
            self._pages.setCurrentWidget(self._step_page)
            self._place()
        self._step_buttons[name].setChecked(True)
        self._show_checks(self._console.state.preflight.value)
        self._next.setFocus(Qt.FocusReason.TabFocusReason)

    def _on_back(self) -> None:
        place = self._stack.currentIndex()
        if place:
            self.show_step(self._steps[place - 1].name)
        else:
            self._pages.setCurrentIndex(0)
            self._place()
            self._simulated.setFocus(Qt.FocusReason.TabFocusReason)

    def _on_next(self) -> None:
        place = self._stack.currentIndex() + 1
        if place < len(self._steps):
            self.show_step(self._steps[place].name)
        else:
            self._through = True
            self.close_overlay()

    def _show_checks(self, checks: tuple[PreflightCheck, ...]) -> None:
        if self._step_page is None:
            return
        for step in self._steps:
            step_checks = step.of(checks)
            if step_checks:
                self._step_buttons[step.name].show_state(worst(step_checks))
        place = self._stack.currentIndex()
        passed = worst(self._steps[place].of(checks)) == "passed"
        if place == len(self._steps) - 1:
            self._next.set_label(tr("Done"), role="primary")
        else:
            self._next.set_label(tr("Next") if passed else tr("Skip for now"), role="primary" if passed else "plain")


_PAD_PX, _LOW_PAD_PX, _CHOICE_PX = 20, 12, 230


class ChoiceButton(QPushButton):
    """Large button with icon, title and explanation."""

    def __init__(self, theme: Theme, title: str, about: str, icon: str, *, tone: str = "", **qt: Any) -> None:
        super().__init__(**qt)
        self.setAccessibleName(title)
        self.setAccessibleDescription(about)
        self.setProperty("role", "choice")
        self.setProperty("tone", tone)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setCursor(Qt.CursorShape.PointingHandCursor)
        policy = QSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Minimum)
        policy.setHeightForWidth(True)
        self.setSizePolicy(policy)
        self._icon = IconLabel(theme, icon, tone or "dim", size_px=40)
        words = layouts.vbox(
            None, label(title, "heading", wraps=True), label(about, tone="dim", wraps=True), spacing_px=8
        )
        self._box = QBoxLayout(QBoxLayout.Direction.TopToBottom, self)
        self._box.addWidget(self._icon, 0, Qt.AlignmentFlag.AlignTop)
        self._box.addLayout(words, 1)
        words.addStretch(1)
        for part in self.findChildren(QLabel):
            part.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.set_low(False)

    def set_low(self, low: bool) -> None:
        """Switch to a compact layout with the icon on the left."""
        self._low = low
        above = _LOW_PAD_PX if low else _PAD_PX
        self._box.setContentsMargins(_PAD_PX, above, _PAD_PX, above)
        self._box.setSpacing(_PAD_PX if low else 14)
        self._box.setDirection(QBoxLayout.Direction.LeftToRight if low else QBoxLayout.Direction.TopToBottom)

    def sizeHint(self) -> QSize:
        return QSize(340, max(64 if self._low else _CHOICE_PX, self.heightForWidth(340)))

    def minimumSizeHint(self) -> QSize:
        return QSize(240, 64 if self._low else 120)

    def heightForWidth(self, width: int) -> int:
        return self._box.heightForWidth(width)


class StepButton(QPushButton):
    """Step with its state as shape and word."""

    def __init__(self, theme: Theme, title: str) -> None:
        super().__init__()
        self.setCheckable(True)
        self._title = title
        self.setProperty("role", "step")
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setCursor(Qt.CursorShape.PointingHandCursor)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self._icon, self._heading, self._words = IconLabel(theme, size_px=22), ElidedLabel(), label("", "small")
        self._heading.setText(title)
        words = layouts.vbox(None, self._heading, self._words, spacing_px=1)
        self._row = layouts.hbox(self, self._icon, (words, 1), margins_px=(12, 9, 8, 9), spacing_px=10)
        for part in self.findChildren(QLabel):
            part.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.toggled.connect(lambda on: restyle(self._heading, role="title" if on else ""))
        self.show_state("not checked")

    def show_state(self, state: PreflightState) -> None:
        self._icon.show_icon(ICONS[state], ROLES[state])
        self._words.setText(tr(STATES[state]))
        restyle(self._words, tone=ROLES[state])
        self.setAccessibleName(tr("{step}: {state}").format(step=self._title, state=tr(STATES[state])))

    def sizeHint(self) -> QSize:
        return QSize(180, self._row.sizeHint().height())
