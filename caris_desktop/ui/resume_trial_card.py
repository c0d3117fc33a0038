"""Popup to resume a trial after a crash: offers the trial, then confirms each condition that may have changed."""

from collections.abc import Callable

from PySide6.QtCore import QEvent, QObject
from PySide6.QtGui import QAccessible, QPaintEvent
from PySide6.QtWidgets import QLabel, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.intents import AsBefore
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.trial_details import TrialDetails
from caris_desktop.live.status import CrashRecoveryStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import event_messages, layouts, tokens
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.check_box import CheckBox

_WIDTH_PX, _FROM_EDGE_PX = 520, 20
_FROM_TOP_PX = 82
"""Below the tabs and title bars of the top panels, so that these stay usable."""
_ASKED: dict[AsBefore, str] = {
    "map": QT_TR_NOOP("The robot is where the map shows it"),
    "people": QT_TR_NOOP("People are identified correctly"),
    "permissions": QT_TR_NOOP("The recording settings are correct. {kept}"),
    "consent": QT_TR_NOOP(
        "The participant agrees to continue being recorded, and the consents in People are still valid"
    ),
}


def trial_in_words(details: TrialDetails) -> str:
    """Trial name as shown to the wizard."""
    if details.participant and details.trial:
        return tr("{participant}, trial {trial}").format(participant=details.participant, trial=details.trial)
    return details.participant or (tr("trial {trial}").format(trial=details.trial) if details.trial else tr("a trial"))


def permissions_in_words(console: WizardConsole) -> str:
    """Sentences on what a recording will contain and what the language model may do, with the current settings."""
    from caris_desktop.ui.start_dialog import contents_sentence

    scenario = console.scenario
    permissions, levels = scenario.permissions, console.state.levels.value
    sentences = [
        contents_sentence(permissions, console.microphone, scenario.blur),
        tr("Participants’ speech is transcribed.") if permissions.transcription
        else tr("Participants’ speech is not transcribed."),
    ]  # fmt: skip
    if not permissions.assistant:
        sentences.append(tr("No language model."))
    elif permissions.cloud_models:
        sentences.append(tr("Language models may be used, including on other computers."))
    else:
        sentences.append(tr("Language models are used on this computer only."))
    for function, title in event_messages.FUNCTIONS.items():
        if getattr(scenario.assistance, function) != "off":
            level = tr(event_messages.LEVELS[getattr(levels, function)])
            sentences.append(tr("{function}: {level}.").format(function=tr(title), level=level))
    return " ".join(sentences)


class ResumeTrialCard(QWidget):
    """Popup over the upper middle of the docks. Not a dialog: the stop and everything else stay usable.

    ``start_recording`` starts the next part of the trial.
    """

    accessible_role = QAccessible.Role.Dialog

    def __init__(
        self, theme: Theme, over: QWidget, console: WizardConsole, start_recording: Callable[[], None]
    ) -> None:
        super().__init__(over)
        self.setObjectName("going_on_card")
        self._theme = theme
        self._over = over
        self._console = console
        self._heading = QLabel()
        self._heading.setObjectName("going_on_heading")
        self._text = QLabel()
        self._text.setObjectName("going_on_text")
        for label in (self._heading, self._text):
            label.setWordWrap(True)
        self._boxes: dict[AsBefore, CheckBox] = {}
        column = self._column = layouts.vbox(self, margins_px=(20, 16, 20, 16), spacing_px=tokens.GRID_PX)
        column.addWidget(self._heading)
        column.addWidget(self._text)
        for condition, text in _ASKED.items():
            box = self._boxes[condition] = CheckBox(theme, tr(text), wraps=True)
            box.setObjectName(f"going_on_{condition}")
            box.clicked.connect(self._confirmer(condition))
            column.addWidget(box)
        self._yes = ActionButton(theme, tr("Resume the trial"), role="primary", height_px=38)
        self._yes.setObjectName("going_on_yes")
        self._yes.clicked.connect(lambda: console.do(intents.GoOnWithTrial()))
        self._start = ActionButton(theme, tr("Record the next part"), icon="record", role="primary", height_px=38)
        self._start.setObjectName("going_on_start")
        self._start.clicked.connect(start_recording)
        self._no = ActionButton(theme, tr("Do not resume"), role="ghost", height_px=38)
        self._no.setObjectName("going_on_no")
        self._no.clicked.connect(lambda: console.do(intents.LeaveTrial()))
        buttons = layouts.hbox(spacing_px=tokens.GRID_PX)
        buttons.addWidget(self._no)
        buttons.addStretch(1)
        buttons.addWidget(self._start)
        buttons.addWidget(self._yes)
        column.addSpacing(4)
        column.addLayout(buttons)
        over.installEventFilter(self)
        theme.changed.connect(self._style)
        self.hide()
        self._style()
        console.state.going_on.changed.connect(self._show)
        for value in (console.state.scenario, console.state.levels, console.state.microphone):
            value.changed.connect(self._show_permissions)
        self._show(console.state.going_on.value)

    def _confirmer(self, condition: AsBefore) -> Callable[[bool], None]:
        def confirm(_checked: bool) -> None:
            self._console.do(intents.ConfirmAsBefore(condition))
            self._show(self._console.state.going_on.value)  # a confirmation cannot be withdrawn

        return confirm

    def _show(self, status: CrashRecoveryStatus) -> None:
        if not status.state:
            self.hide()
            return
        offered, trial = status.state == "offered", trial_in_words(status.details)
        if offered:
            self._heading.setText(tr("The program ended during a recording."))
            self._text.setText(
                tr(
                    "The program was recording {trial}. The data recorded until then is safe. You can resume "
                    "with the same participant: the emergency stop then holds the robot until you release it."
                ).format(trial=trial)
            )
        else:
            self._heading.setText(tr("Resuming {trial}").format(trial=trial))
            self._text.setText(
                tr(
                    "Check what may have changed in the meantime. The robot is held until you release the "
                    "emergency stop."
                )
            )
        for condition, box in self._boxes.items():
            box.setVisible(not offered)
            box.setChecked(condition not in status.unconfirmed)
            box.setEnabled(condition in status.unconfirmed)
        self._show_permissions()
        self._yes.setVisible(offered)
        self._start.setVisible(not offered)
        self._start.setEnabled(status.state == "confirmed")
        self._start.setToolTip("" if status.state == "confirmed" else tr("Check and tick all items first"))
        self.setAccessibleName(f"{self._heading.text()} {self._text.text()}")
        self.show()
        self._place()

    def _show_permissions(self, _changed: object = None) -> None:
        if self._console.state.going_on.value.state not in ("unconfirmed", "confirmed"):
            return
        box, text = self._boxes["permissions"], tr(_ASKED["permissions"])
        text = text.format(kept=permissions_in_words(self._console))
        if text != box.text():
            box.setText(text)
            self._place()

    def _place(self) -> None:
        self.setFixedWidth(min(_WIDTH_PX, self._over.width() - 2 * _FROM_EDGE_PX))
        self.resize(self.width(), self._column.heightForWidth(self.width()))
        self.move((self._over.width() - self.width()) // 2, _FROM_TOP_PX)
        self.raise_()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if watched is self._over and event.type() == QEvent.Type.Resize and not self.isHidden():
            self._place()
        return False

    def _style(self) -> None:
        self._heading.setFont(self._theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        self._theme.style_text(self._text, "dim", tokens.BODY_PX)
        for box in self._boxes.values():
            box.setFont(self._theme.font(tokens.BODY_PX))
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        self._theme.paint_box(
            self, ground="panel", line="amber", radius_px=tokens.PANEL_RADIUS_PX, line_px=1.4, inset_px=(1, 1)
        )
