"""Popups of a trial: resume it after a crash, with each condition confirmed that may have changed; after a recording,
what can be done with the session next.
"""

from collections.abc import Callable
from functools import partial

from PySide6.QtCore import QUrl
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.events import TrialDetails
from caris_desktop.domain.intents import AsBefore
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import IN_SESSION, CrashRecoveryStatus, RecordingStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import event_messages, layouts, text_formatting, tokens
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.inputs import CheckBox
from caris_desktop.ui.widgets.popups import DockCard
from caris_desktop.ui.windows import SessionWindows

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


class ResumeTrialCard(DockCard):
    """``start_recording`` starts the next part of the trial."""

    def __init__(
        self, theme: Theme, over: QWidget, console: WizardConsole, start_recording: Callable[[], None]
    ) -> None:
        super().__init__(theme, over, tone="amber")
        self.setObjectName("going_on_card")
        self._console = console
        self.heading.setObjectName("going_on_heading")
        self.text.setObjectName("going_on_text")
        self._boxes: dict[AsBefore, CheckBox] = {}
        for condition, text in _ASKED.items():
            confirm = partial(self._confirm, condition)
            box = CheckBox(theme, tr(text), wraps=True, objectName=f"going_on_{condition}", clicked=confirm)
            self._boxes[condition] = box
        button = partial(ActionButton, theme, height_px=38)
        self._yes = button(tr("Resume the trial"), role="primary", objectName="going_on_yes")
        self._yes.clicked.connect(lambda: console.do(intents.GoOnWithTrial()))
        self._start = button(tr("Record the next part"), icon="record", role="primary", objectName="going_on_start")
        self._start.clicked.connect(start_recording)
        self._no = button(tr("Do not resume"), role="ghost", objectName="going_on_no")
        self._no.clicked.connect(lambda: console.do(intents.LeaveTrial()))
        layouts.fill(self.column, *self._boxes.values())
        self.column.addSpacing(4)
        self.column.addLayout(layouts.hbox(None, self._no, 1, self._start, self._yes, spacing_px=tokens.GRID_PX))
        for value in (console.state.scenario, console.state.levels, console.state.microphone):
            value.changed.connect(self._show_permissions)
        console.state.going_on.follow(self._show)

    def _confirm(self, condition: AsBefore, _checked: bool) -> None:
        self._console.do(intents.ConfirmAsBefore(condition))
        self._show(self._console.state.going_on.value)  # a confirmation cannot be withdrawn

    def _show(self, status: CrashRecoveryStatus) -> None:
        if not status.state:
            self.hide()
            return
        offered, trial = status.state == "offered", trial_in_words(status.details)
        if offered:
            self.heading.setText(tr("The program ended during a recording."))
            self.text.setText(
                tr(
                    "The program was recording {trial}. The data recorded until then is safe. You can resume "
                    "with the same participant: the emergency stop then holds the robot until you release it."
                ).format(trial=trial)
            )
        else:
            self.heading.setText(tr("Resuming {trial}").format(trial=trial))
            self.text.setText(
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
        self.open()

    def _show_permissions(self, _changed: object = None) -> None:
        if self._console.state.going_on.value.state not in ("unconfirmed", "confirmed"):
            return
        box, text = self._boxes["permissions"], tr(_ASKED["permissions"])
        text = text.format(kept=permissions_in_words(self._console))
        if text != box.text():
            box.setText(text)
            self.place()


class SavedSessionCard(DockCard):
    """Stays until it is closed, one of its buttons is used, or the next recording starts."""

    def __init__(self, theme: Theme, over: QWidget, sessions: SessionWindows, now_ns: Callable[[], int]) -> None:
        super().__init__(theme, over, tone="green")
        self.setObjectName("saved_session_card")
        self.text.setObjectName("saved_session_text")
        self._sessions = sessions
        self._now_ns = now_ns
        self._status = RecordingStatus()
        self._lasted = ""
        self._replay = self._button("replay", tr("Replay"), "play", self._open_replay)
        export = self._button("export", tr("Export…"), "export", sessions.export_last_session)
        folder = self._button("folder", tr("Open folder"), "folder-open", self._open_folder)
        close = self._button("close", tr("Close"), "x", self.hide)
        self.column.addSpacing(4)
        self.column.addLayout(layouts.hbox(None, self._replay, export, folder, 1, close, spacing_px=tokens.GRID_PX))

    def show_recording(self, status: RecordingStatus) -> None:
        """Open the card when a recording has ended as it should; failures have a message of their own."""
        before, self._status = self._status, status
        if status.state == "stopping" and before.state != "stopping":
            self._lasted = text_formatting.elapsed((self._now_ns() - status.started_ns) / 1e9)
        if status.state in IN_SESSION:
            self.hide()
        elif status.state == "idle" and before.state == "stopping" and status.folder is not None:
            self.heading.setText(tr("The session is saved"))
            size, missing = text_formatting.size(status.written_bytes), text_formatting.all_missing(status.dropped)
            self.text.setText(" · ".join(part for part in (status.folder.name, self._lasted, size, missing) if part))
            self._replay.setVisible(self._sessions.has_library)
            self.open()

    def put_away(self) -> None:
        self.hide()

    def _button(self, name: str, text: str, icon: str, act: Callable[[], None]) -> ActionButton:
        name = f"saved_session_{name}"
        button = ActionButton(self._theme, text, icon=icon, height_px=34, objectName=name, clicked=self.hide)
        button.clicked.connect(act)
        return button

    def _open_replay(self) -> None:
        if self._status.folder is not None:
            self._sessions.open_replay(self._status.folder)

    def _open_folder(self) -> None:
        QDesktopServices.openUrl(QUrl.fromLocalFile(str(self._status.folder)))
