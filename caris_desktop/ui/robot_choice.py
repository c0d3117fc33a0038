"""Robot selection: connects another robot, after confirmation if that ends something, and opens robot discovery."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject
from PySide6.QtWidgets import QMenu, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.events import GoalChanged
from caris_desktop.domain.translation import tr
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import DriveStatus, LinkStatus
from caris_desktop.live.wizard_console import RobotChoice, WizardConsole
from caris_desktop.ui.background_reading import Remembered
from caris_desktop.ui.banners import QuestionBanner
from caris_desktop.ui.menu_choices import add_choices
from caris_desktop.ui.text_formatting import UNDER_WAY, in_menu, shortened
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.window_place import raise_window

if TYPE_CHECKING:  # imported at first use
    from caris_desktop.ui.robot_dialog import RobotDialog, RobotExplorer


def motion_that_ends(state: LiveState) -> list[str]:
    """Motions that would end with the current link, as sentences."""
    drive: DriveStatus = state.drive.value
    goal: GoalChanged | None = state.goal.value
    present = shortened(state.link.value.robot, 40) or tr("The current robot")
    if goal is not None and goal.state in UNDER_WAY:
        place = shortened(goal.place or "", 40) or tr("a point on the map")
        return [tr("{robot} is on its way to {place} and will stop.").format(robot=present, place=place)]
    if drive.target_forward_mps or drive.target_left_mps or drive.target_turn_radps:
        return [tr("{robot} is being driven and will stop.").format(robot=present)]
    return []


class RobotChooser(QObject):
    """Connects another robot. Discovery of robots without a profile needs an explorer."""

    def __init__(self, theme: Theme, console: WizardConsole, question: QuestionBanner, window: QWidget) -> None:
        super().__init__(window)
        self._theme = theme
        self._console = console
        self._question = question
        self._window = window
        self._explorer: RobotExplorer | None = None
        self._dialog: RobotDialog | None = None
        self.choices = Remembered(console, self._read, self)

    def _read(self) -> Sequence[RobotChoice]:
        return self._console.robots()

    @property
    def can_detect(self) -> bool:
        """Whether discovery is available."""
        return self._explorer is not None

    @property
    def dialog_open(self) -> bool:
        return self._dialog is not None

    def use_explorer(self, explorer: "RobotExplorer") -> None:
        """Enable robot discovery and saving profiles."""
        self._explorer = explorer

    def choose(self, choice: RobotChoice) -> None:
        """Connect another robot, after confirmation if that ends something."""
        ends = self._what_ends()
        if not ends:
            self._use(choice)
            return
        self._question.ask(
            tr("Connect to {robot} now? {consequences}").format(robot=choice.title, consequences=ends),
            tr("Connect to {robot}").format(robot=choice.title),
            lambda: self._use(choice),
        )

    def chooser(self, choice: RobotChoice) -> Callable[[], None]:
        return partial(self.choose, choice)

    def others(self) -> list[RobotChoice]:
        """Robots to which the console can switch."""
        return [choice for choice in self.choices.now() if not self._is_current(choice) and not choice.problem]

    def fill_menu(self, menu: QMenu) -> None:
        """Fill the menu with the robots and an entry for discovery."""
        menu.clear()
        menu.setToolTipsVisible(True)
        choices, unusable = self.choices.now(), tr("{robot} · cannot be used")
        titles = [unusable.format(robot=each.title) if each.problem else each.title for each in choices]
        rows = zip(titles, choices, strict=True)
        actions = add_choices(
            menu, ((in_menu(title), self._is_current(each), self.chooser(each)) for title, each in rows)
        )
        for action, choice in zip(actions, choices, strict=True):
            action.setEnabled(not choice.problem)
            action.setToolTip(choice.problem or choice.address)
        if self.can_detect:
            menu.addSeparator()
            menu.addAction(tr("Connect another robot…")).triggered.connect(self.open_dialog)

    def open_dialog(self) -> None:
        """Open the discovery dialog. One at a time."""
        if self._explorer is None:
            return
        from caris_desktop.ui.robot_dialog import RobotDialog

        if self._dialog is None:
            link: LinkStatus = self._console.state.link.value
            self._dialog = RobotDialog(self._theme, self._explorer, self._window, address=link.address)
            self._dialog.saved.connect(self._on_saved)
            self._dialog.finished.connect(self._on_dialog_finished)
        raise_window(self._dialog)

    def _on_saved(self, choice: RobotChoice) -> None:
        self.choices.renew()  # an open list gets the new profile
        self.choose(choice)

    def _on_dialog_finished(self, _result: int) -> None:
        if self._dialog is not None:
            self._dialog.deleteLater()
        self._dialog = None

    def _use(self, choice: RobotChoice) -> None:
        # Opening a refused profile has reported the reason.
        self._console.do(intents.UseRobot(choice.name))

    def _what_ends(self) -> str:
        ends = motion_that_ends(self._console.state)
        if self._console.state.recording.value.state in ("recording", "starting"):
            ends.append(tr("The recording continues with the other robot."))
        return " ".join(ends)

    def _is_current(self, choice: RobotChoice) -> bool:
        robot = self._console.state.robot.value
        if robot is not None:
            return bool(robot.name == choice.name)
        return bool(self._console.state.link.value.robot == choice.title)
