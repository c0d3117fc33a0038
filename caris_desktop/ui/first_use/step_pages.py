"""Set-up steps, each backed by preflight checks, and their pages: make a choice and test it at once."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal

from PySide6.QtCore import QRectF, QSize, Qt, QTimer
from PySide6.QtGui import QAccessible, QImage, QPainter, QPaintEvent
from PySide6.QtWidgets import QLabel, QProgressBar, QSizePolicy, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.services.microphone_service import participant_microphone
from caris_desktop.live.status import AssistantSetup, AssistantStatus, MicrophoneStatus, PreflightCheck
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.preflight.preflight_list import PreflightRow
from caris_desktop.ui.robot_choice import RobotChooser
from caris_desktop.ui.speak.voice_choices import voice_choices
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.camera_strip import shrunk
from caris_desktop.ui.widgets.drop_down import DropDown
from caris_desktop.ui.widgets.flow_layout import FlowRow
from caris_desktop.ui.widgets.labels import label

_PICTURE_EVERY_MS = 200
_CHOICE_PX = 240
_PICTURE_PX = QSize(480, 270)


StepName = Literal["robot", "camera", "sound", "model"]


class SetUpStep(Value):
    """A set-up step. ``checks``: ids of its checks; if the scenario has none of them, the step is skipped."""

    name: StepName
    title: str
    about: str
    checks: tuple[str, ...]

    def of(self, checks: Sequence[PreflightCheck]) -> tuple[PreflightCheck, ...]:
        return tuple(check for check in checks if check.id in self.checks)


STEPS: tuple[SetUpStep, ...] = (
    SetUpStep(
        "robot",
        QT_TR_NOOP("Robot"),
        QT_TR_NOOP("Choose the robot. It must run rosbridge and be on the same network as this computer."),
        ("robot",),
    ),
    SetUpStep(
        "camera",
        QT_TR_NOOP("Camera"),
        QT_TR_NOOP("This is what the robot sees now. The scenario determines which cameras are used."),
        ("video",),
    ),
    SetUpStep(
        "sound",
        QT_TR_NOOP("Sound"),
        QT_TR_NOOP("Check that the robot speaks and that the microphone picks up sound."),
        ("voice", "microphone"),
    ),
    SetUpStep(
        "model",
        QT_TR_NOOP("Language model"),
        QT_TR_NOOP("It suggests what to say. Everything else works without it."),
        ("model",),
    ),
)


def steps_for(checks: Sequence[PreflightCheck]) -> tuple[SetUpStep, ...]:
    """Steps that the scenario needs."""
    return tuple(step for step in STEPS if step.of(checks))


class StepPage(QWidget):
    """Explanation, checks and advice of a step."""

    def __init__(self, theme: Theme, console: WizardConsole, step: SetUpStep) -> None:
        super().__init__()
        self.setObjectName(f"first_use_step_{step.name}")
        self.theme, self.console, self.step = theme, console, step
        self._rows: dict[str, PreflightRow] = {}
        title, about = label(tr(step.title), "heading"), label(tr(step.about), tone="dim", wraps=True)
        self.column = layouts.vbox(self, title, about, margins_px=0, spacing_px=10)
        self.build()
        self.column.addStretch(1)
        console.state.preflight.changed.connect(self._show_checks)
        self._show_checks(console.state.preflight.value)

    def build(self) -> None:
        """Add the widgets of this step."""

    def add_check(self, check_id: str) -> bool:
        """Add the result of this check; False if the scenario does not need it."""
        check = next((one for one in self.console.state.preflight.value if one.id == check_id), None)
        if check is not None:
            self._rows[check_id] = PreflightRow(self.theme, self.console, check, self)
            self.column.addWidget(self._rows[check_id])
        return check is not None

    def add_choice(self, title: str, choice: DropDown, *beside: QWidget, holder: QWidget | None = None) -> None:
        """Add a drop-down with its title; in ``holder`` if it can be hidden."""
        choice.setMinimumWidth(_CHOICE_PX)
        row_widget = holder or QWidget()
        layouts.hbox(row_widget, QLabel(title), choice, *beside, 1, margins_px=0, spacing_px=tokens.GRID_PX)
        self.column.addWidget(row_widget)

    def _show_checks(self, checks: tuple[PreflightCheck, ...]) -> None:
        for check in self.step.of(checks):
            if check.id in self._rows:
                self._rows[check.id].show_check(check, in_full=True)


class RobotPage(StepPage):
    """Robots with a profile, and robot discovery."""

    def __init__(self, theme: Theme, console: WizardConsole, step: SetUpStep, robots: RobotChooser) -> None:
        self._robots = robots
        super().__init__(theme, console, step)

    def build(self) -> None:
        self._flow = FlowRow()
        self._buttons: dict[str, ActionButton] = {}
        self._robots.choices.changed.connect(self._add_robots)
        self._add_robots()
        self.console.state.robot.changed.connect(self._show_present)
        self.column.addWidget(self._flow)
        if self._robots.can_detect:
            other = ActionButton(self.theme, tr("Another robot…"), icon="magnifying-glass")
            other.setObjectName("first_use_another_robot")
            other.setToolTip(tr("Inspect a robot by its address and see its data live"))
            other.clicked.connect(self._robots.open_dialog)
            self.column.addWidget(other)
        # Below the buttons: its height changes while the mouse is over them.
        self.add_check("robot")

    def _add_robots(self) -> None:
        """Add buttons for robots found on disk meanwhile."""
        for choice in self._robots.choices.now():
            if choice.name in self._buttons:
                continue
            button = self._buttons[choice.name] = ActionButton(self.theme, choice.title, icon="robot", may_shrink=True)
            button.setCheckable(True)  # the connected robot's is checked
            button.setObjectName(f"first_use_robot_{choice.name}")
            button.setEnabled(not choice.problem)
            button.setToolTip(choice.problem or choice.address)
            button.clicked.connect(self._robots.chooser(choice))
            button.clicked.connect(self._show_present)
            self._flow.add(button)
        self._show_present()

    def _show_present(self, _changed: object = None) -> None:
        robot = self.console.state.robot.value
        for name, button in self._buttons.items():
            button.setChecked(robot is not None and robot.name == name)


class CameraPage(StepPage):
    """Camera page with live video."""

    def build(self) -> None:
        self.add_check("video")
        state = self.console.state
        self._camera = DropDown(self.theme, "first_use_camera", tr("Camera"))
        self._camera.activated.connect(self._on_chosen)
        self.column.addWidget(self._camera)
        self.column.addWidget(LivePicture(self.theme, self.console))
        state.cameras.changed.connect(self._show_cameras)
        state.camera.changed.connect(self._show_cameras)
        self._show_cameras()

    def _show_cameras(self, _changed: object = None) -> None:
        names = self.console.state.cameras.value
        self._camera.clear()
        for name in names:
            self._camera.addItem(text_formatting.camera_title(name), name)
        self._camera.setCurrentIndex(max(0, self._camera.findData(self.console.state.camera.value)))
        self._camera.setVisible(len(names) > 1)

    def _on_chosen(self, index: int) -> None:
        self.console.state.choose_camera(self._camera.itemData(index))


class LivePicture(QWidget):
    """Live preview at a few Hz; text without a fresh picture."""

    accessible_role = QAccessible.Role.Graphic

    def __init__(self, theme: Theme, console: WizardConsole) -> None:
        super().__init__()
        self.setObjectName("first_use_picture")
        self.setAccessibleName(tr("Camera picture"))
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Fixed)
        self.setMaximumWidth(_PICTURE_PX.width())
        self._theme = theme
        self._console = console
        self._image: QImage | None = None
        self._timer = QTimer(self, interval=_PICTURE_EVERY_MS)
        self._timer.timeout.connect(self.refresh)
        self._timer.start()

    @property
    def shows_picture(self) -> bool:
        return self._image is not None

    def refresh(self) -> None:
        """Update the preview if visible."""
        stream = self._console.state.frame
        if not self.isVisible():
            return
        image_bgr = self._console.frames.read(stream.value) if stream.freshness in ("fresh", "stale") else None
        self._image = None if image_bgr is None else shrunk(image_bgr, self.size())
        self.update()

    def sizeHint(self) -> QSize:
        return _PICTURE_PX

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        bounds = QRectF(self.rect())
        painter.fillRect(bounds, self._theme.color("video_ground"))
        if self._image is not None:
            size = self._image.size()
            left, top = (self.width() - size.width()) / 2, (self.height() - size.height()) / 2
            painter.drawImage(QRectF(left, top, size.width(), size.height()), self._image)
            return
        painter.setPen(self._theme.color("video_dim"))
        painter.drawText(bounds, int(Qt.AlignmentFlag.AlignCenter), tr("No picture yet"))


class SoundPage(StepPage):
    """Sound page: a test sentence, and the microphone level."""

    def build(self) -> None:
        console = self.console
        self._output: DropDown | None = None
        if self.add_check("voice"):
            self._output = DropDown(self.theme, "first_use_voice", tr("Who speaks"))
            self._output.activated.connect(self._on_output)
            say = ActionButton(self.theme, tr("Say a sentence"), icon="speaker-high")
            say.setObjectName("first_use_say")
            say.clicked.connect(self._on_say)
            self.add_choice(tr("Who speaks"), self._output, say)
            console.state.voice.changed.connect(self._show_voice)
            self._show_voice()
        if not self.add_check("microphone"):
            return
        self._microphones = QWidget()
        self.add_choice(tr("Microphone"), self._make_microphones(), holder=self._microphones)
        console.state.robot.changed.connect(self._show_microphone_owner)
        self._show_microphone_owner(console.state.robot.value)
        self._level = QProgressBar(textVisible=False)
        self._level.setObjectName("first_use_level")
        self._level.setAccessibleName(tr("Microphone level"))
        self._level.setMaximumWidth(_PICTURE_PX.width())
        self.column.addWidget(self._level)
        console.state.microphone.changed.connect(self._show_level)
        self._show_level(console.state.microphone.value)

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
        if self._output is not None:
            self._output.clear()
            for number, choice in enumerate(voice_choices(self.console.state.voice.value)[0]):
                self._output.addItem(choice.text, choice.intent)
                if choice.chosen:
                    self._output.setCurrentIndex(number)

    def _on_output(self, index: int) -> None:
        if self._output is not None:
            self.console.do(self._output.itemData(index))

    def _on_say(self) -> None:
        self.console.do(intents.Say(tr("Hello. Can you hear me?"), "phrase"))

    def _show_level(self, microphone: MicrophoneStatus) -> None:
        # Square root for perceived loudness: quiet speech must show.
        self._level.setValue(round(100 * microphone.level**0.5) if microphone.state == "on" else 0)


class ModelPage(StepPage):
    """Model page: a model, and a test question."""

    def build(self) -> None:
        self.add_check("model")
        state = self.console.state
        self._models = DropDown(self.theme, "first_use_model", tr("Language model"))
        self._models.activated.connect(self._on_chosen)
        ask = ActionButton(self.theme, tr("Ask it to say hello"), icon="chat-text")
        ask.setObjectName("first_use_ask")
        ask.clicked.connect(self._on_ask)
        self.add_choice(tr("Model"), self._models, ask)
        self._answer = label("", objectName="first_use_answer")
        self.column.addWidget(self._answer)
        self._asked = False
        state.assistant_setup.changed.connect(self._show_models)
        state.assistant.changed.connect(self._show_answer)
        self._show_models(state.assistant_setup.value)

    def _show_models(self, setup: AssistantSetup) -> None:
        self._models.clear()
        for choice in setup.models:
            self._models.addItem(f"{choice.title} · {choice.where}" if choice.where else choice.title, choice.model)
        self._models.setCurrentIndex(max(0, self._models.findData(setup.model)))
        self._models.setVisible(bool(setup.models))

    def _on_chosen(self, index: int) -> None:
        self.console.do(intents.ChooseModel(self._models.itemData(index)))

    def _on_ask(self) -> None:
        self._asked = True
        self.console.do(intents.Ask(tr("Say hello in one short sentence.")))

    def _show_answer(self, assistant: AssistantStatus) -> None:
        if self._asked:
            self._answer.setText(f"“{assistant.answer}”" if assistant.answer else tr(assistant.detail))


def page_maker(
    theme: Theme, console: WizardConsole, robots: RobotChooser
) -> dict[StepName, Callable[[SetUpStep], StepPage]]:
    """Page factories by step name."""
    return {
        "robot": lambda step: RobotPage(theme, console, step, robots),
        "camera": partial(CameraPage, theme, console),
        "sound": partial(SoundPage, theme, console),
        "model": partial(ModelPage, theme, console),
    }
