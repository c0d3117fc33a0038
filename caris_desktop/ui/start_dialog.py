"""Start dialog of a recording: trial details and a summary of what will be recorded. All fields are optional."""

from collections.abc import Sequence
from dataclasses import replace

from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QBoxLayout, QFormLayout, QLineEdit, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.events import TrialDetails
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.services.microphone_service import participant_microphone
from caris_desktop.live.status import PreflightCheck
from caris_desktop.live.wizard_console import BeforeRecording, WizardConsole
from caris_desktop.scenario.scenario_model import BlurSettings, Permissions
from caris_desktop.ui import layouts, text_formatting
from caris_desktop.ui.accessibility import announce
from caris_desktop.ui.event_messages import checks_summary, open_checks
from caris_desktop.ui.form_dialog import FormDialog, resize_to
from caris_desktop.ui.preflight_list import PreflightList
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.containers import Scrolled
from caris_desktop.ui.widgets.inputs import CheckBox, DropDown
from caris_desktop.ui.widgets.labels import label, line_edit, restyle

_FIELDS = (
    ("study", QT_TR_NOOP("Study"), QT_TR_NOOP("for example Lab visit")),
    ("participant", QT_TR_NOOP("Participant"), QT_TR_NOOP("for example P07")),
    ("condition", QT_TR_NOOP("Condition"), QT_TR_NOOP("for example B")),
    ("trial", QT_TR_NOOP("Trial"), QT_TR_NOOP("for example 2 of 4")),
    ("wizard", QT_TR_NOOP("Wizard"), QT_TR_NOOP("your name or initials")),
)
PRACTICE = QT_TR_NOOP("practice")
_FORM_PX, _CHECKS_PX, _SIDE_PX = 560, 400, 24
_BOTH_PX = _FORM_PX + _CHECKS_PX + 3 * _SIDE_PX
_WITH_CHECKS_PX, _LEAST_CHECKS_PX = 660, 320


def last_details(suggested: TrialDetails, begun: TrialDetails | None) -> TrialDetails | None:
    """Details of the previous session: one of this run, else derived from the suggested trial number."""
    if begun is not None:
        return begun if begun.trial or begun.participant else None
    if suggested.trial.isdecimal() and int(suggested.trial) > 1:
        return replace(suggested, trial=str(int(suggested.trial) - 1))
    return None


_BLURRED = {
    ("persons", "everybody"): QT_TR_NOOP("people pixelated"),
    ("faces", "everybody"): QT_TR_NOOP("faces pixelated"),
    ("persons", "without_consent"): QT_TR_NOOP("people without consent pixelated"),
    ("faces", "without_consent"): QT_TR_NOOP("faces of people without consent pixelated"),
}


def contents_sentence(permissions: Permissions, microphone: str | None, blur: BlurSettings) -> str:
    """Sentence on what a recording will contain and omit."""
    who_is_blurred = _BLURRED.get((blur.what, blur.who), "")
    blurred = tr(who_is_blurred)
    recorded = [tr("robot actions and sensor data"), tr("speech as text"), tr("your actions")]
    absent: list[str] = []
    for permitted, name, how in (
        (permissions.video_recording, tr("video"), blurred),
        (permissions.photos, tr("photos"), blurred),
        (permissions.audio_recording and microphone is not None, tr("sound"), ""),
    ):
        (recorded if permitted else absent).append(f"{name} ({how})" if permitted and how else name)
    sentences = [tr("Records {kept}.").format(kept=_listed(recorded, tr("{some} and {last}")))]
    if absent:
        sentences.append(tr("No {absent}.").format(absent=_listed(absent, tr("{some} or {last}"))))
    return " ".join(sentences)


def _listed(parts: Sequence[str], several: str) -> str:
    return parts[0] if len(parts) == 1 else several.format(some=", ".join(parts[:-1]), last=parts[-1])


class StartDialog(FormDialog):
    """Emits ``begin(TrialDetails, bool)`` to start, with empty details after Skip; True if the wizard starts in spite
    of open checks.

    The dialog opens before the suggestions are read from disk; :meth:`know` fills them in without changing typed text,
    and an earlier start waits for them.
    """

    begin = Signal(object, bool)

    def __init__(self, theme: Theme, parent: QWidget, console: WizardConsole) -> None:
        super().__init__(theme, parent, "start_dialog", tr("Start recording"))
        self._prefilled = TrialDetails()
        self._last: TrialDetails | None = None
        self._known = self._wants_last = self._wants_begin = False
        self._console = console
        self._scenario = console.scenario
        self._microphone_before = console.microphone
        hint = tr(
            "These details identify the recording. Use codes rather than names for participants. Fields may be empty."
        )
        form = self._form = QFormLayout(horizontalSpacing=16, verticalSpacing=10)
        form.setLabelAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        self._fields: dict[str, QLineEdit] = {}
        for name, title, placeholder in _FIELDS:
            line = self._fields[name] = line_edit(
                f"start_{name}", tr(title), placeholderText=tr(placeholder), maxLength=120, returnPressed=self._on_begin
            )
            form.addRow(tr(title), line)
        self._again = CheckBox(theme, wraps=True, objectName="start_again", toggled=self._on_again)
        self._practice = CheckBox(
            theme, tr("Practice run (counts as wizard training, not as data)"), wraps=True, objectName="start_practice"
        )
        # Never preselected: data marked as practice by mistake is lost to the study.
        form.addRow("", self._again)
        form.setRowVisible(self._again, False)
        for name in ("study", "participant", "condition", "trial"):
            self._fields[name].textEdited.connect(self._on_edited)
        self._fields["participant"].textEdited.connect(self._on_participant_edited)
        form.addRow("", self._practice)
        self._microphone = self._make_microphones()
        if self._microphone is not None:
            form.addRow(tr("Microphone"), self._microphone)
        self._contents = label("", "note", wraps=True, objectName="start_kept")
        self._room = label("", "note", wraps=True, objectName="start_room")
        self._question = label("", "warning", wraps=True, objectName="start_asked")
        for part in (self._room, self._question):
            part.hide()
        self._begin_button = self.button(
            "start_dialog_begin", tr("Start recording"), self._on_begin, icon="record", key="Enter", role="primary"
        )
        skip = self.button("start_dialog_skip", tr("Start without details"), self._on_skip)
        cancel = self.button("start_dialog_cancel", tr("Cancel"), self.reject, role="ghost")
        content = QWidget()
        sides = self._sides = QBoxLayout(QBoxLayout.Direction.LeftToRight, content)
        sides.setContentsMargins(_SIDE_PX, 20, _SIDE_PX, 8)
        sides.setSpacing(28)
        head = label(tr("Who takes part?"), "heading"), label(hint, "note", wraps=True)
        amount = layouts.vbox(None, self._contents, self._room, spacing_px=4)
        sides.addLayout(layouts.vbox(None, *head, form, amount, 1, spacing_px=14), _FORM_PX)
        self._checks = console.state.preflight
        if self._checks.value:
            sides.addWidget(self._make_checks(), _CHECKS_PX)
        buttons = layouts.hbox(None, cancel, 1, skip, self._begin_button, spacing_px=8)
        foot = layouts.vbox(None, self._question, buttons, margins_px=(_SIDE_PX, 8, _SIDE_PX, 20), spacing_px=10)
        layouts.vbox(self, (Scrolled(content), 1), foot, margins_px=0, spacing_px=0)
        self._show_contents()
        resize_to(self, self.sizeHint())
        # The field that changes from session to session.
        self._fields["participant"].setFocus(Qt.FocusReason.OtherFocusReason)

    def know(self, before: BeforeRecording, last: TrialDetails | None = None) -> None:
        """Fill in the suggested details, and keep those of the previous session."""
        self._known, self._prefilled, self._last = True, before.suggested, last
        for name, line in self._fields.items():
            if not line.isModified():
                line.setText(str(getattr(before.suggested, name)))
        participant = self._fields["participant"]
        if participant.isModified():
            self._on_participant_edited(participant.text())
        else:
            participant.selectAll()
        if last is not None:
            self._again.setText(again_words(last))
            self._form.setRowVisible(self._again, True)
            self._again.setChecked(self._wants_last)
        self._show_room(before.bytes_per_hour, before.free_bytes)
        resize_to(self, self.size().expandedTo(self.sizeHint()))
        if self._wants_begin:
            self._on_begin()

    def _show_room(self, bytes_per_hour: float | None, free_bytes: int | None) -> None:
        expected = text_formatting.expectation(bytes_per_hour, free_bytes)
        self._room.setVisible(bool(expected))
        if bytes_per_hour and free_bytes is not None and free_bytes < bytes_per_hour:
            restyle(self._room, role="warning")
            expected = tr("{expected}. Free some disk space before a long session.").format(expected=expected)
        self._room.setText(expected)

    def sizeHint(self) -> QSize:
        least = QSize(_BOTH_PX, _WITH_CHECKS_PX) if self._checks.value else QSize(_FORM_PX, 0)
        return least.expandedTo(super().sizeHint())

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Put the checks beside the trial details, or below them where the dialog is narrow."""
        super().resizeEvent(event)
        directions = QBoxLayout.Direction
        self._sides.setDirection(directions.LeftToRight if self.width() >= _BOTH_PX else directions.TopToBottom)

    def _make_checks(self) -> QWidget:
        """List of preflight checks."""
        side = QWidget(minimumWidth=_CHECKS_PX, minimumHeight=_LEAST_CHECKS_PX)
        self._summary = label("", "note", wraps=True, objectName="start_summary")
        heading, checks = label(tr("Is everything ready?"), "heading"), PreflightList(self._theme, self._console)
        layouts.vbox(side, heading, self._summary, (checks, 1), margins_px=0, spacing_px=8)
        self._checks.follow(self._show_checks)
        return side

    def _show_checks(self, checks: tuple[PreflightCheck, ...]) -> None:
        self._summary.setText(checks_summary(checks))
        if not self._question.isHidden():
            self._ask_about_open(checks)

    def _ask_about_open(self, checks: tuple[PreflightCheck, ...]) -> None:
        """Name the checks that are not passed."""
        waits = any(check.asks_first for check in checks)
        if waits and self._question.isHidden():
            announce(self, open_checks(checks))
        self._question.setText(open_checks(checks) if waits else "")
        self._question.setVisible(waits)
        if waits:
            self._begin_button.set_label(tr("Record anyway"), role="amber")
        else:
            self._begin_button.set_label(tr("Start recording"), role="primary")

    def _make_microphones(self) -> DropDown | None:
        """Microphone selection, if the scenario records sound from one of this computer."""
        robot, current = self._console.state.robot.value, self._microphone_before
        by_computer = participant_microphone(self._scenario, robot) == "computer"
        if not (self._scenario.permissions.audio_recording and by_computer):
            return None
        present = self._console.microphones()
        choice = DropDown(self._theme, "start_microphone", tr("Microphone"))
        choice.setMinimumHeight(36)
        choice.addItem(tr("No microphone"), None)
        names = list(present)
        if current is not None and current not in names:
            names.append(current)  # unplugged, but still the selected one
        for name in names:
            # Until the inputs are listed, none can be reported missing.
            unplugged = bool(name and present and name not in present)
            template = tr("{microphone} (not plugged in)") if unplugged else "{microphone}"
            choice.addItem(template.format(microphone=text_formatting.microphone(name)), name)
        choice.setCurrentIndex(0 if current is None else 1 + names.index(current))
        choice.currentIndexChanged.connect(self._show_contents)
        return choice

    @property
    def microphone(self) -> str | None:
        """Selected sound input; None for none."""
        chosen: str | None = self._microphone_before if self._microphone is None else self._microphone.currentData()
        return chosen

    def use_last_trial(self) -> None:
        """Repeat the previous trial, if there is one."""
        self._wants_last = True
        if self._last is not None:
            self._again.setChecked(True)

    def details(self) -> TrialDetails:
        return TrialDetails(
            **{name: " ".join(line.text().split()) for name, line in self._fields.items()},
            purpose=PRACTICE if self._practice.isChecked() else "",
        )

    def _show_contents(self, _index: int = 0) -> None:
        self._contents.setText(contents_sentence(self._scenario.permissions, self.microphone, self._scenario.blur))

    def _on_again(self, again: bool) -> None:
        """Fill in the previous session's details for a repeated trial."""
        source = self._last if again else self._prefilled
        if source is None:
            return
        for name in ("study", "participant", "condition", "trial"):
            self._fields[name].setText(str(getattr(source, name)))

    def _on_participant_edited(self, participant: str) -> None:
        """Reset a suggested trial number to 1 for another participant."""
        suggested, trial = self._prefilled, self._fields["trial"]
        if not suggested.trial.isdecimal() or trial.text() not in (suggested.trial, "1"):
            return
        same = " ".join(participant.split()) == suggested.participant
        trial.setText(suggested.trial if same or not suggested.participant else "1")

    def _on_edited(self, _text: str) -> None:
        # Typing another trial means it is not a repetition.
        self._wants_last = False
        if self._again.isChecked():
            self._again.blockSignals(True)
            self._again.setChecked(False)
            self._again.blockSignals(False)

    def _finish(self, details: TrialDetails) -> None:
        checks = self._checks.value
        waits = any(check.asks_first for check in checks)
        if waits and self._question.isHidden():
            self._ask_about_open(checks)
            return
        self.accept()
        if self._microphone is not None and self.microphone != self._microphone_before:
            self._console.do(intents.UseMicrophone(self.microphone))
        self.begin.emit(details, waits)

    def _on_begin(self) -> None:
        self._wants_begin = not self._known
        if self._wants_begin:
            self._room.setText(
                tr(
                    "The details of the study’s last session are still being read. The recording starts with "
                    "them in a moment."
                )
            )
            self._room.show()
        elif self.isVisible():
            self._finish(self.details())

    def _on_skip(self) -> None:
        self._wants_begin = False
        self._finish(TrialDetails(purpose=self.details().purpose))


def again_words(last: TrialDetails) -> str:
    """Text such as "Same trial again: P07, trial 2 (2nd recording)"."""
    before = int(last.recording) if last.recording.isdecimal() else 1
    trial = tr("trial {trial}").format(trial=last.trial) if last.trial else ""
    which, nth = ", ".join(part for part in (last.participant, trial) if part), _ordinal(before + 1)
    if not which:
        return tr("Same trial again ({nth} recording)").format(nth=nth)
    return tr("Same trial again: {which} ({nth} recording)").format(which=which, nth=nth)


def _ordinal(number: int) -> str:
    endings = {1: tr("{number}st"), 2: tr("{number}nd"), 3: tr("{number}rd")}
    ordinal = tr("{number}th") if 10 <= number % 100 <= 20 else endings.get(number % 10, tr("{number}th"))
    return ordinal.format(number=number)
