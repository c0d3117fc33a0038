"""Set-up page of the first start: try the program, or connect everything. Each step is backed by preflight checks. Not
a dialog: the red button stays usable.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal

from PySide6.QtCore import QSize, Qt, QTimer, Signal
from PySide6.QtGui import QAccessible, QMouseEvent, QPixmap
from PySide6.QtWidgets import (
    QBoxLayout,
    QButtonGroup,
    QLabel,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QStackedWidget,
    QWidget,
)

from caris_desktop.domain import intents
from caris_desktop.domain.events import PreflightState
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.services.microphone_service import participant_microphone
from caris_desktop.live.status import AssistantSetup, AssistantStatus, MicrophoneStatus, PreflightCheck
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.event_messages import CHECK_ICONS, CHECK_ROLES, CHECK_STATES, worst_check
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.preflight_list import PreflightRow
from caris_desktop.ui.speak.speak_field import voice_choices
from caris_desktop.ui.text_formatting import ESC_CLOSES
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.camera_strip import shrunk
from caris_desktop.ui.widgets.containers import FlowRow, Scrolled
from caris_desktop.ui.widgets.inputs import DropDown
from caris_desktop.ui.widgets.labels import ElidedLabel, IconLabel, label, named, restyle
from caris_desktop.ui.windows import RobotChooser

_PICTURE_EVERY_MS = 200
_CHOICE_PX = 240
_PICTURE_PX = QSize(480, 270)


StepName = Literal["robot", "camera", "sound", "model"]


class StepPage(QWidget):
    """A set-up step: explanation, checks and advice. ``checks``: ids of its checks; if the scenario has none of them,
    the step is skipped.
    """

    name: StepName
    title: str
    about: str
    checks: tuple[str, ...]

    def __init__(self, theme: Theme, console: WizardConsole, robots: RobotChooser) -> None:
        super().__init__()
        self.setObjectName(f"first_use_step_{self.name}")
        self.theme, self.console, self.robots = theme, console, robots
        self._rows: dict[str, PreflightRow] = {}
        title, about = label(tr(self.title), "heading"), label(tr(self.about), tone="dim", wraps=True)
        self.column = layouts.vbox(self, title, about, margins_px=0, spacing_px=10)
        self.build()
        self.column.addStretch(1)
        console.state.preflight.follow(self._show_checks)

    @classmethod
    def of(cls, checks: Sequence[PreflightCheck]) -> tuple[PreflightCheck, ...]:
        """The checks of this step."""
        return tuple(check for check in checks if check.id in cls.checks)

    def build(self) -> None:
        """Add the widgets of this step."""

    def add_check(self, check_id: str) -> bool:
        """Add the result of this check; False if the scenario does not need it."""
        check = next((one for one in self.console.state.preflight.value if one.id == check_id), None)
        if check is not None:
            self._rows[check_id] = PreflightRow(self.theme, self.console, check, self)
            self.column.addWidget(self._rows[check_id])
        return check is not None

    def button(self, name: str, text: str, icon: str, run: Callable[[], object], **more: Any) -> ActionButton:
        return ActionButton(self.theme, text, icon=icon, objectName=f"first_use_{name}", clicked=run, **more)

    def add_choice(self, title: str, choice: DropDown, *beside: QWidget, holder: QWidget | None = None) -> None:
        """Add a drop-down with its title; in ``holder`` if it can be hidden."""
        choice.setMinimumWidth(_CHOICE_PX)
        row_widget = holder or QWidget()
        layouts.hbox(row_widget, QLabel(title), choice, *beside, 1, margins_px=0, spacing_px=tokens.GRID_PX)
        self.column.addWidget(row_widget)

    def _show_checks(self, checks: tuple[PreflightCheck, ...]) -> None:
        for check in self.of(checks):
            if check.id in self._rows:
                self._rows[check.id].show_check(check, in_full=True)


class RobotPage(StepPage):
    """Robots with a profile, and robot discovery."""

    name, title, checks = "robot", QT_TR_NOOP("Robot"), ("robot",)
    about = QT_TR_NOOP("Choose the robot. It must run rosbridge and be on the same network as this computer.")

    def build(self) -> None:
        self._flow = FlowRow()
        self._buttons: dict[str, ActionButton] = {}
        self.robots.choices.changed.connect(self._add_robots)
        self._add_robots()
        self.console.state.robot.changed.connect(self._show_present)
        self.column.addWidget(self._flow)
        if self.robots.can_detect:
            other = self.button("another_robot", tr("Another robot…"), "magnifying-glass", self.robots.open_dialog)
            other.setToolTip(tr("Inspect a robot by its address and see its data live"))
            self.column.addWidget(other)
        # Below the buttons: its height changes while the mouse is over them.
        self.add_check("robot")

    def _add_robots(self) -> None:
        """Add buttons for robots found on disk meanwhile."""
        for choice in self.robots.choices.now():
            if choice.name in self._buttons:
                continue
            # The button of the connected robot is checked.
            button = self._buttons[choice.name] = self.button(
                f"robot_{choice.name}", choice.title, "robot", partial(self.robots.choose, choice), may_shrink=True,
                checkable=True, enabled=not choice.error, toolTip=choice.error or choice.address,
            )  # fmt: skip
            button.clicked.connect(self._show_present)
            self._flow.add(button)
        self._show_present()

    def _show_present(self, _changed: object = None) -> None:
        robot = self.console.state.robot.value
        for name, button in self._buttons.items():
            button.setChecked(robot is not None and robot.name == name)


class CameraPage(StepPage):
    """Camera page with live video."""

    name, title, checks = "camera", QT_TR_NOOP("Camera"), ("video",)
    about = QT_TR_NOOP("This is what the robot sees now. The scenario determines which cameras are used.")

    def build(self) -> None:
        self.add_check("video")
        state = self.console.state
        camera = self._camera = DropDown(self.theme, "first_use_camera", tr("Camera"))
        camera.activated.connect(lambda index: state.choose_camera(camera.itemData(index)))
        self.column.addWidget(self._camera)
        self.column.addWidget(LivePicture(self.console))
        state.cameras.changed.connect(self._show_cameras)
        state.camera.changed.connect(self._show_cameras)
        self._show_cameras()

    def _show_cameras(self, _changed: object = None) -> None:
        names = self.console.state.cameras.value
        cameras = [(text_formatting.camera_title(name), name) for name in names]
        self._camera.fill(cameras, self.console.state.camera.value)
        self._camera.setVisible(len(names) > 1)


class LivePicture(QLabel):
    """Live preview at a few Hz; text without a fresh picture."""

    accessible_role = QAccessible.Role.Graphic

    def __init__(self, console: WizardConsole) -> None:
        super().__init__(tr("No picture yet"), alignment=Qt.AlignmentFlag.AlignCenter)
        named(self, "first_use_picture", tr("Camera picture"))
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.setMaximumWidth(_PICTURE_PX.width())
        self._console = console
        self._timer = QTimer(self, interval=_PICTURE_EVERY_MS)
        self._timer.timeout.connect(self.refresh)
        self._timer.start()

    def refresh(self) -> None:
        """Update the preview if visible."""
        stream = self._console.state.frame
        if not self.isVisible():
            return
        image_bgr = self._console.frames.read(stream.value) if stream.freshness in ("fresh", "stale") else None
        if image_bgr is None:
            self.setText(tr("No picture yet"))
        else:
            self.setPixmap(QPixmap.fromImage(shrunk(image_bgr, self.size())))

    def sizeHint(self) -> QSize:
        return _PICTURE_PX


class SoundPage(StepPage):
    """Sound page: a test sentence, and the microphone level."""

    name, title, checks = "sound", QT_TR_NOOP("Sound"), ("voice", "microphone")
    about = QT_TR_NOOP("Check that the robot speaks and that the microphone picks up sound.")

    def build(self) -> None:
        console = self.console
        if self.add_check("voice"):
            output = self._output = DropDown(self.theme, "first_use_voice", tr("Who speaks"))
            output.activated.connect(lambda index: console.do(output.itemData(index)))
            sentence = intents.Say(tr("Hello. Can you hear me?"), "phrase")
            say = self.button("say", tr("Say a sentence"), "speaker-high", lambda: console.do(sentence))
            self.add_choice(tr("Who speaks"), self._output, say)
            console.state.voice.changed.connect(self._show_voice)
            self._show_voice()
        if not self.add_check("microphone"):
            return
        self._microphones = QWidget()
        self.add_choice(tr("Microphone"), self._make_microphones(), holder=self._microphones)
        console.state.robot.follow(self._show_microphone_owner)
        self._level = named(QProgressBar(textVisible=False), "first_use_level", tr("Microphone level"))
        self._level.setMaximumWidth(_PICTURE_PX.width())
        self.column.addWidget(self._level)
        console.state.microphone.follow(self._show_level)

    def _make_microphones(self) -> DropDown:
        choice = DropDown(self.theme, "first_use_microphone", tr("Microphone"))
        choice.addItem(tr("No microphone"), None)
        for name in dict.fromkeys(("", *self.console.microphones())):
            choice.addItem(text_formatting.microphone(name), name)
        choice.setCurrentIndex(max(0, choice.findData(self.console.microphone)))
        choice.activated.connect(lambda index: self.console.do(intents.UseMicrophone(choice.itemData(index))))
        return choice

    def _show_microphone_owner(self, robot: RobotProfile | None) -> None:
        """Hidden if the robot, chosen in an earlier step, has a microphone."""
        self._microphones.setVisible(participant_microphone(self.console.scenario, robot) == "computer")

    def _show_voice(self, _changed: object = None) -> None:
        outputs = voice_choices(self.console.state.voice.value)[0]
        chosen = next((choice.intent for choice in outputs if choice.chosen), None)
        self._output.fill([(choice.text, choice.intent) for choice in outputs], chosen)

    def _show_level(self, microphone: MicrophoneStatus) -> None:
        # Square root for perceived loudness: quiet speech must show.
        self._level.setValue(round(100 * microphone.level**0.5) if microphone.state == "on" else 0)


class ModelPage(StepPage):
    """Model page: a model, and a test question."""

    name, title, checks = "model", QT_TR_NOOP("Language model"), ("model",)
    about = QT_TR_NOOP("It suggests what to say. Everything else works without it.")

    def build(self) -> None:
        self.add_check("model")
        state = self.console.state
        models = self._models = DropDown(self.theme, "first_use_model", tr("Language model"))
        models.activated.connect(lambda index: self.console.do(intents.ChooseModel(models.itemData(index))))
        ask = self.button("ask", tr("Ask it to say hello"), "chat-text", self._on_ask)
        self.add_choice(tr("Model"), self._models, ask)
        self._answer = label("", objectName="first_use_answer")
        self.column.addWidget(self._answer)
        self._asked = False
        state.assistant.changed.connect(self._show_answer)
        state.assistant_setup.follow(self._show_models)

    def _show_models(self, setup: AssistantSetup) -> None:
        self._models.fill(text_formatting.models_offered(setup.models), setup.model)
        self._models.setVisible(bool(setup.models))

    def _on_ask(self) -> None:
        self._asked = True
        self.console.do(intents.Ask(tr("Say hello in one short sentence.")))

    def _show_answer(self, assistant: AssistantStatus) -> None:
        if self._asked:
            self._answer.setText(f"“{assistant.answer}”" if assistant.answer else tr(assistant.detail))


def steps_for(checks: Sequence[PreflightCheck]) -> tuple[type[StepPage], ...]:
    """Steps that the scenario needs."""
    pages: tuple[type[StepPage], ...] = (RobotPage, CameraPage, SoundPage, ModelPage)
    return tuple(page for page in pages if page.of(checks))


_WIDTH_PX, _WELCOME_PX, _HEIGHT_PX, _STEPS_PX = 880, 430, 600, 220
_BESIDE_FROM_PX, _NARROW_STEPS_PX = 700, 184


class SetUpPage(Overlay):
    """``simulated_requested``: try the simulated robot; ``finished(bool)``: closed, True if all steps are complete."""

    simulated_requested = Signal()
    finished = Signal(bool)

    def __init__(self, theme: Theme, window: QWidget, console: WizardConsole, robots: RobotChooser) -> None:
        super().__init__(theme, window, width_px=_WIDTH_PX)
        named(self, "first_use", tr("Set up"))
        self._console = console
        self._robots = robots
        self._through = False
        self._pages = QStackedWidget()
        self._pages.addWidget(self._make_welcome())
        column = layouts.vbox(self.card, margins_px=(28, 22, 28, 20))
        column.addWidget(self._pages)
        self._steps: tuple[type[StepPage], ...] = ()
        self._step_buttons: dict[StepName, StepButton] = {}
        self._step_page: QWidget | None = None
        console.state.preflight.changed.connect(self._show_checks)

    @property
    def step(self) -> StepName | None:
        """Current step; None on the welcome page."""
        page = self._stack.currentWidget() if self._step_page is not None else None
        on_show = self._pages.currentWidget() is self._step_page
        return page.name if on_show and isinstance(page, StepPage) else None

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
        # Rebuilt each time: steps depend on the scenario.
        if self._step_page is not None:
            self._pages.removeWidget(self._step_page)
            self._step_page.deleteLater()
        theme, page = self._theme, QWidget()
        self._steps = steps_for(self._console.state.preflight.value)
        self._stack = QStackedWidget()
        group = QButtonGroup(page)
        rail = self._rail = QWidget()
        rail.setFixedWidth(_STEPS_PX)
        side = layouts.vbox(rail, margins_px=0, spacing_px=4)
        self._step_buttons = {}
        for step in self._steps:
            button = self._step_buttons[step.name] = StepButton(theme, tr(step.title))
            button.setObjectName(f"first_use_to_{step.name}")
            button.clicked.connect(lambda _on=False, name=step.name: self.show_step(name))
            group.addButton(button)
            side.addWidget(button)
            self._stack.addWidget(step(theme, self._console, self._robots))
        side.addStretch(1)
        self._back = ActionButton(
            theme, tr("Back"), icon="caret-left", role="ghost", objectName="first_use_back", clicked=self._on_back
        )
        self._next = ActionButton(theme, tr("Next"), role="primary", objectName="first_use_next", clicked=self._on_next)
        close = ActionButton(
            theme, tr("Close"), key="Esc", role="ghost", toolTip=tr(ESC_CLOSES), objectName="first_use_close",
            clicked=self.close_overlay,
        )  # fmt: skip
        content = QWidget()
        layouts.hbox(content, rail, (self._stack, 1), margins_px=(0, 0, 8, 0), spacing_px=28)
        foot = layouts.hbox(None, self._back, 1, close, self._next)
        layouts.vbox(page, (Scrolled(content), 1), foot, margins_px=0)
        self._step_page = page
        self._pages.addWidget(page)
        self.show_step(self._steps[0].name)

    # Steps

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
                self._step_buttons[step.name].show_state(worst_check(step_checks))
        place = self._stack.currentIndex()
        passed = worst_check(self._steps[place].of(checks)) == "passed"
        if place == len(self._steps) - 1:
            self._next.set_label(tr("Done"), role="primary")
        else:
            self._next.set_label(tr("Next") if passed else tr("Skip for now"), role="primary" if passed else "plain")


_PAD_PX, _LOW_PAD_PX, _CHOICES_PX = 20, 12, 230


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
        return QSize(340, max(64 if self._low else _CHOICES_PX, self.heightForWidth(340)))

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
        self._icon.show_icon(CHECK_ICONS[state], CHECK_ROLES[state])
        self._words.setText(tr(CHECK_STATES[state]))
        restyle(self._words, tone=CHECK_ROLES[state])
        self.setAccessibleName(tr("{step}: {state}").format(step=self._title, state=tr(CHECK_STATES[state])))

    def sizeHint(self) -> QSize:
        return QSize(180, self._row.sizeHint().height())
