"""Set-up page of the first start: try the program, or connect everything. Not a dialog: the red button stays usable."""

from collections.abc import Callable

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QMouseEvent
from PySide6.QtWidgets import QBoxLayout, QButtonGroup, QHBoxLayout, QLabel, QStackedWidget, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.live.status import PreflightCheck
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.first_use.choice_buttons import ChoiceButton, StepButton
from caris_desktop.ui.first_use.step_pages import StepPage, page_maker
from caris_desktop.ui.first_use.steps import SetUpStep, StepName, steps_for
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.preflight.preflight_words import worst
from caris_desktop.ui.robot_choice import RobotChooser
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.scroll_areas import Scrolled

_WIDTH_PX, _WELCOME_PX, _HEIGHT_PX, _STEPS_PX = 880, 430, 600, 220
_BESIDE_FROM_PX, _NARROW_STEPS_PX = 700, 184


class SetUpPage(Overlay):
    """``simulated_wanted``: try the simulated robot; ``finished(bool)``: closed, True if all steps were completed."""

    simulated_wanted = Signal()
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
        heading = QLabel(tr("Welcome"))
        heading.setFont(theme.font(24, tokens.WEIGHT_SEMIBOLD))
        about = QLabel(tr("Drive a robot, see what it sees and speak through it. How would you like to start?"))
        about.setWordWrap(True)
        self._simulated = ChoiceButton(
            theme, tr("Try it with the simulated robot"),
            tr("A robot, rooms and people on this computer. Nothing can break, and you can drive within seconds."),
            "rocket-launch", primary=True,
        )  # fmt: skip
        self._simulated.setObjectName("first_use_simulated")
        self._simulated.clicked.connect(self._on_simulated)
        own = ChoiceButton(
            theme, tr("Connect my robot"),
            tr("Set up robot, camera, sound and language model step by step. Each step is tested, and you can "
                "do it later."),
            "robot",
        )  # fmt: skip
        own.setObjectName("first_use_own")
        own.clicked.connect(self._on_own)
        later = ActionButton(theme, tr("Not now"), key="Esc", look="ghost")
        later.setObjectName("first_use_later")
        later.clicked.connect(self.close_overlay)
        again = QLabel(tr("You can find this again in the Window menu: Set up."), wordWrap=True)
        again.setFont(theme.font(tokens.STATUS_PX))
        self._choices = choices = QBoxLayout(QBoxLayout.Direction.LeftToRight)
        choices.setSpacing(16)
        choices.addWidget(self._simulated)
        choices.addWidget(own)
        self._choice_buttons = (self._simulated, own)
        foot = QHBoxLayout()
        foot.addWidget(again, 1)
        foot.addWidget(later)
        column = layouts.vbox(page, margins_px=0, spacing_px=12)
        content = QWidget()
        upper = layouts.vbox(content, margins_px=0, spacing_px=12)
        upper.addWidget(heading)
        upper.addWidget(about)
        upper.addStretch(1)
        upper.addLayout(choices)
        upper.addStretch(2)
        column.addWidget(Scrolled(content), 1)
        column.addLayout(foot)
        return page

    def _on_simulated(self) -> None:
        self._through = True
        self.simulated_wanted.emit()
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
            button.clicked.connect(self._shower(step.name))
            group.addButton(button)
            side.addWidget(button)
            self._stack.addWidget(self._make_page[step.name](step))
        side.addStretch(1)
        self._back = ActionButton(theme, tr("Back"), icon="caret-left", look="ghost")
        self._back.setObjectName("first_use_back")
        self._back.clicked.connect(self._on_back)
        self._next = ActionButton(theme, tr("Next"), look="primary")
        self._next.setObjectName("first_use_next")
        self._next.clicked.connect(self._on_next)
        foot = QHBoxLayout()
        foot.addWidget(self._back)
        foot.addStretch(1)
        close = ActionButton(theme, tr("Close"), key="Esc", look="ghost")
        close.setObjectName("first_use_close")
        close.clicked.connect(self.close_overlay)
        foot.addWidget(close)
        foot.addWidget(self._next)
        rail = self._rail = QWidget()
        rail.setLayout(side)
        rail.setFixedWidth(_STEPS_PX)
        side.setContentsMargins(0, 0, 0, 0)
        upper = layouts.hbox(spacing_px=28)
        upper.addWidget(rail)
        upper.addWidget(self._stack, 1)
        column = layouts.vbox(page, margins_px=0)
        content = QWidget()
        content.setLayout(upper)
        upper.setContentsMargins(0, 0, 8, 0)
        column.addWidget(Scrolled(content), 1)
        column.addLayout(foot)
        self._step_page = page
        self._pages.addWidget(page)

    def _shower(self, name: StepName) -> Callable[[], None]:
        return lambda: self.show_step(name)

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
            own = step.of(checks)
            if own:
                self._step_buttons[step.name].show_state(worst(own))
        place = self._stack.currentIndex()
        passed = worst(self._steps[place].of(checks)) == "passed"
        if place == len(self._steps) - 1:
            self._next.set_label(tr("Done"), look="primary")
        else:
            self._next.set_label(tr("Next") if passed else tr("Skip for now"), look="primary" if passed else "plain")
