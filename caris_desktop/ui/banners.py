"""Banners under the top bar: states that last until the wizard decides, each with the one button that ends it."""

from collections.abc import Callable

from PySide6.QtGui import QAccessible, QPaintEvent, QShowEvent
from PySide6.QtWidgets import QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import DriveStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.announcing import announce
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.elided_label import ElidedLabel

_BUTTON_PX = 28


class Banner(QWidget):
    """Banner with one sentence and its buttons, in a colour for its severity."""

    accessible_role = QAccessible.Role.AlertMessage

    def __init__(self, theme: Theme, name: str, *, role: str) -> None:
        super().__init__()
        self.setObjectName(name)
        self._theme = theme
        self._role = role
        self.text = ElidedLabel()
        self.row = layouts.hbox(self, margins_px=(14, 0, 4, 0), spacing_px=tokens.GRID_PX)
        self.row.addWidget(self.text, 1)
        theme.restyle_on_change(self._style)
        self.hide()

    def say(self, text: str) -> None:
        self.text.setText(text)
        self.setAccessibleName(text)
        if self.isVisible():
            announce(self, text)

    @property
    def needed_px(self) -> int:
        """Width with the whole sentence."""
        # The row's own hint leaves out the sentence, which may be elided.
        return self.sizeHint().width() + self.text.sizeHint().width() + 4

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        if not event.spontaneous():
            announce(self, self.accessibleName())

    def _style(self) -> None:
        self.text.setFont(self._theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD))
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        self._theme.paint_box(
            self,
            ground=f"{self._role}_soft",
            line=self._role,
            radius_px=tokens.PANEL_RADIUS_PX,
            line_px=1.4,
            inset_px=(0.7, 0.7),
        )


class EmergencyBanner(Banner):
    """Banner while the emergency stop is latched, with the only button that releases it.

    It is apart from the red button, so that a frightened second press never releases the stop.
    """

    def __init__(self, theme: Theme, console: WizardConsole) -> None:
        super().__init__(theme, "emergency_band", role="red")
        self.release = ActionButton(theme, tr("Release emergency stop"), height_px=_BUTTON_PX)
        self.release.setObjectName("emergency_release")
        self.release.clicked.connect(lambda: console.do(intents.ReleaseEmergencyStop()))
        self.row.addWidget(self.release)
        console.state.drive.changed.connect(self._on_drive_changed)
        self._on_drive_changed(console.state.drive.value)

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        match drive.movement:
            case "uncommanded":
                text = tr("Emergency stop active, but the robot is moving. Use the stop on the robot itself.")
            case "standing":
                text = tr("Emergency stop active, robot stationary. No motion until you release the stop.")
            case _:
                text = tr("Emergency stop active. No motion commands until you release it.")
        if text != self.accessibleName():
            self.say(text)
        self.setVisible(drive.emergency_stop)


class GuardBanner(Banner):
    """Banner that reminds the wizard while the obstacle guard is switched off."""

    def __init__(self, theme: Theme, console: WizardConsole) -> None:
        super().__init__(theme, "guard_band", role="amber")
        self.say(tr("Obstacle guard is off. Nothing stops the robot at obstacles."))
        on = ActionButton(theme, tr("Turn on"), icon="shield-check", height_px=_BUTTON_PX)
        on.setAccessibleName(tr("Turn on the guard"))
        on.setToolTip(tr("Turn on the guard"))
        on.setObjectName("guard_on")
        on.clicked.connect(lambda: console.do(intents.SetGuard(on=True)))
        self.row.addWidget(on)
        console.state.drive.changed.connect(self._on_drive_changed)
        self._on_drive_changed(console.state.drive.value)

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        self.setVisible(drive.guard == "overridden")


class QuestionBanner(Banner):
    """Confirmation before something irreversible. Not a dialog: driving and Stop keep working."""

    def __init__(self, theme: Theme) -> None:
        super().__init__(theme, "question_band", role="amber")
        self._do: Callable[[], object] | None = None
        self.yes = ActionButton(theme, tr("Yes"), height_px=_BUTTON_PX)
        self.yes.setObjectName("question_yes")
        self.yes.clicked.connect(self._on_yes)
        no = ActionButton(theme, tr("Cancel"), role="ghost", height_px=_BUTTON_PX)
        no.setObjectName("question_no")
        no.clicked.connect(self.put_away)
        self.row.addWidget(self.yes)
        self.row.addWidget(no)

    def ask(self, question: str, answer: str, do: Callable[[], object]) -> None:
        """Show the question; ``answer`` labels the button that runs ``do``. Replaces an earlier question."""
        self._do = do
        self.say(question)
        self.yes.set_label(answer)
        self.show()

    def put_away(self) -> None:
        self._do = None
        self.hide()

    def _on_yes(self) -> None:
        do = self._do
        self.put_away()
        if do is not None:
            do()
