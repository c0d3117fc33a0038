"""Intents: all requests to the console, as data, and one table of what each may do.

Keys, buttons, the palette, gamepads, proposals of a language model, a second wizard and the record use these types
only. A new function is one dataclass and one table line here, and one handler in its service.
"""

import math
import secrets
from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import Literal, get_args

from caris_desktop.domain.control_definitions import ControlValue
from caris_desktop.domain.corrections import WhoSpoke
from caris_desktop.domain.events import (
    AssistanceLevel,
    AssistedFunction,
    CommandSource,
    ConsentKind,
    MarkKind,
    UtteranceOrigin,
    VoiceOutput,
)
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.intent import AsBefore, Bounds, Intent, IntentSpec, IntentTable, Permission
from caris_desktop.domain.sound_values import Role, TalkTo
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.trial_details import TrialDetails
from caris_desktop.domain.value_class import Value

# Intents of manual driving, stops and the head.


class Drive(Intent):
    """Hold to drive: each of -1..1 of the speed setting, all zero releases. Sent on each change only."""

    forward: float
    left: float
    turn: float
    source: CommandSource

    @property
    def reduces_motion(self) -> bool:
        return not (self.forward or self.left or self.turn)


class ReleaseDrive(Intent):
    """Release all controls: zero at once."""

    reason: str = ""

    @property
    def reduces_motion(self) -> bool:
        return True


class SetSpeed(Intent):
    """Set the speed, 0.1..1 of the scenario's limits."""

    fraction: float


class Stop(Intent):
    """Halt motion and cancel goals, always."""

    @property
    def reduces_motion(self) -> bool:
        return True


class EmergencyStop(Intent):
    """Latch the emergency stop."""

    @property
    def reduces_motion(self) -> bool:
        return True


class ReleaseEmergencyStop(Intent):
    """Release the latched emergency stop."""


class SetGuard(Intent):
    """Turn the obstacle guard on or off; off lasts until link loss, a change of scenario, or turning it on."""

    on: bool

    @property
    def reduces_motion(self) -> bool:
        return self.on


class LookAt(Intent):
    """Point the head: pan left positive, tilt down positive."""

    pan_rad: float
    tilt_rad: float


class TurnHead(Intent):
    """Turn the head while a control is held: each of -1..1 of its speed, zero stops. Sent on each change only."""

    pan: float
    tilt: float

    @property
    def reduces_motion(self) -> bool:
        return not (self.pan or self.tilt)


class Nod(Intent):
    """Nod once: a brief yes while somebody speaks."""


_SHARE: Bounds = (-1.0, 1.0)

DRIVING: IntentTable = {
    Drive: IntentSpec(
        QT_TR_NOOP("Driving"), "driving", moves="base", needs_link=True, quiet=True,
        bounds={"forward": _SHARE, "left": _SHARE, "turn": _SHARE},
    ),
    ReleaseDrive: IntentSpec(QT_TR_NOOP("Releasing the drive controls"), in_replay=True),
    SetSpeed: IntentSpec(QT_TR_NOOP("Setting the speed"), "driving", bounds={"fraction": (0.0, 1.0)}),
    Stop: IntentSpec(QT_TR_NOOP("Stopping"), in_replay=True),
    EmergencyStop: IntentSpec(QT_TR_NOOP("Activating the emergency stop"), in_replay=True),
    ReleaseEmergencyStop: IntentSpec(QT_TR_NOOP("Releasing the emergency stop")),
    SetGuard: IntentSpec(QT_TR_NOOP("Turning off the obstacle guard"), "driving", needs_link=True),
    LookAt: IntentSpec(
        QT_TR_NOOP("Aiming the head"), "driving", moves="head", needs_link=True, proposable=True,
        bounds={"pan_rad": (-math.tau, math.tau), "tilt_rad": (-math.tau, math.tau)},
    ),
    TurnHead: IntentSpec(
        QT_TR_NOOP("Turning the head"), "driving", moves="head", needs_link=True, quiet=True,
        bounds={"pan": _SHARE, "tilt": _SHARE},
    ),
    Nod: IntentSpec(QT_TR_NOOP("Nodding"), "driving", moves="head", needs_link=True, proposable=True),
}  # fmt: skip


# Intents of navigation, places and maps.


class GoToPlace(Intent):
    """Navigate to a place of the scenario."""

    place: str


class GoToPoint(Intent):
    """Navigate to a point with a heading."""

    target_in_map: Pose2D


class CancelGoal(Intent):
    """Cancel the navigation goal."""

    @property
    def reduces_motion(self) -> bool:
        return True


class SetInitialPose(Intent):
    """Set the robot's pose for localization."""

    pose_in_map: Pose2D


class SavePlace(Intent):
    """Add a place, or move the one of that name, in the wizard's copy of the scenario."""

    place: str
    pose_in_map: Pose2D


class RemovePlace(Intent):
    """Remove a place."""

    place: str


class SaveMap(Intent):
    """Save the map on the robot, by name."""

    name: str


class LoadMap(Intent):
    """Load a map saved on the robot."""

    name: str


class SetMapping(Intent):
    """Continue mapping, or only localize in the map."""

    mapping: bool


PLACES: IntentTable = {
    GoToPlace: IntentSpec(
        QT_TR_NOOP("Driving to the place"), "driving", moves="base", needs_link=True, proposable=True
    ),
    GoToPoint: IntentSpec(QT_TR_NOOP("Driving there"), "driving", moves="base", needs_link=True, proposable=True),
    CancelGoal: IntentSpec(QT_TR_NOOP("Cancelling the goal")),
    SetInitialPose: IntentSpec(QT_TR_NOOP("Setting the robot's position"), "driving", needs_link=True),
    SavePlace: IntentSpec(QT_TR_NOOP("Saving the place"), "driving"),
    RemovePlace: IntentSpec(QT_TR_NOOP("Removing the place"), "driving"),
    SaveMap: IntentSpec(QT_TR_NOOP("Saving the map"), "driving", needs_link=True),
    LoadMap: IntentSpec(QT_TR_NOOP("Loading the map"), "driving", needs_link=True),
    SetMapping: IntentSpec(QT_TR_NOOP("Turning mapping on or off"), "driving", needs_link=True),
}


# Intents to select a robot and use its controls.


class UseControl(Intent):
    """Use a Robot panel control; a button's value is True."""

    control: str
    value: ControlValue


class UseRobot(Intent):
    """Connect to another robot instead of the current one."""

    robot: str


class UseSimulatedRobot(Intent):
    """Connect to the simulated robot of this computer; start it if needed."""


ROBOT: IntentTable = {
    # Whether it moves the robot is decided for each control.
    UseControl: IntentSpec(QT_TR_NOOP("Using the control"), "robot_controls", needs_link=True, proposable=True),
    UseRobot: IntentSpec(QT_TR_NOOP("Connecting to another robot")),
    UseSimulatedRobot: IntentSpec(QT_TR_NOOP("Connecting to the simulated robot")),
}


# Intents of the robot's speech: utterances, queue and voice.


class Say(Intent):
    """Speak after the queued utterances. ``{name}`` and ``{place}`` are filled in."""

    text: str
    origin: UtteranceOrigin
    person_id: str = ""
    """Person addressed; empty: the attended person, or else the nearest."""
    gesture: str = ""
    """Gesture at the start: a control, ``nod`` or ``look``."""
    face: str = ""
    """Expression of the face at the start."""


class DraftSpeech(Intent):
    """Synthesise a text in advance that is being typed and may be said at any moment. Never recorded."""

    text: str


class FillGap(Intent):
    """Fill the placeholder that was asked for; empty: do not say it."""

    words: str


class MoveQueued(Intent):
    """Move a queued utterance to another place, 0 for the next."""

    utterance_id: str
    place: int


class EditQueued(Intent):
    """Replace the text of a queued utterance."""

    utterance_id: str
    text: str


class CancelQueued(Intent):
    """Drop a queued utterance."""

    utterance_id: str


class Silence(Intent):
    """Interrupt speech at once and drop the queue."""


class SetVoice(Intent):
    """Set who speaks from the next utterance on, and this computer's voice, as in the scenario."""

    output: VoiceOutput
    name: str = ""
    language: str = ""
    rate: float = 1.0
    volume: float = 1.0


SPEAKING: IntentTable = {
    Say: IntentSpec(QT_TR_NOOP("Speaking"), "speech", proposable=True),
    DraftSpeech: IntentSpec(QT_TR_NOOP("Preparing speech"), "speech", quiet=True),
    FillGap: IntentSpec(QT_TR_NOOP("Filling in the placeholder"), "speech"),
    MoveQueued: IntentSpec(QT_TR_NOOP("Reordering the speech queue"), "speech", bounds={"place": (0, 1000)}),
    EditQueued: IntentSpec(QT_TR_NOOP("Editing a queued utterance"), "speech"),
    CancelQueued: IntentSpec(QT_TR_NOOP("Removing a queued utterance")),
    Silence: IntentSpec(QT_TR_NOOP("Interrupting speech")),
    SetVoice: IntentSpec(QT_TR_NOOP("Changing the voice"), "speech", bounds={"rate": (0.5, 2.0), "volume": (0.0, 1.0)}),
}


class CorrectUtterance(Intent):
    """Correct an utterance's text or speaker, or set its tags; None leaves a value as it is.

    ``speaker`` and ``person_id`` may be empty for "not sure".
    """

    utterance_id: str
    text: str | None = None
    speaker: WhoSpoke | None = None
    person_id: str | None = None
    tags: tuple[str, ...] | None = None


CONVERSATION: IntentTable = {CorrectUtterance: IntentSpec(QT_TR_NOOP("Correcting the transcript"))}


# Intents of microphones, the robot's sound and the wizard's own voice.


class UseMicrophone(Intent):
    """Use this input of this computer for the participant, or the wizard; None: none. Saved for the next time.

    The scenario selects a participant microphone that is not of this computer.
    """

    microphone: str | None
    role: Role = "participant"


class PushToTalk(Intent):
    """Send the wizard's speech to the robot, or as text to the Speak field, until it is off."""

    on: bool
    to: TalkTo = "robot"

    @property
    def reduces_motion(self) -> bool:
        return not self.on

    @property
    def needs_permissions(self) -> tuple[Permission, ...]:
        # Dictation is meant to be spoken.
        return ("own_voice",) if self.to == "robot" else ("transcription", "speech")


class HearRobot(Intent):
    """Start or stop playing the participant's microphone to the wizard, at this volume."""

    on: bool
    volume: float = 1.0


SOUND: IntentTable = {
    PushToTalk: IntentSpec(QT_TR_NOOP("Speaking through the robot"), "own_voice"),
    HearRobot: IntentSpec(QT_TR_NOOP("Listening to the robot"), bounds={"volume": (0.0, 1.0)}),
    UseMicrophone: IntentSpec(QT_TR_NOOP("Choosing a microphone")),
}


# Intents of the language model: questions, answers and prompts.


PromptPart = Literal["conversation", "step", "people", "history", "things", "notes"]
"""Context of a question unless left out: the conversation, the current step of the protocol, the people present, their
history, other things in view, and the notes."""
CAMERA_PICTURE = "camera "
"""Prefix of a camera name among the images of a question: its current frame."""


class Ask(Intent):
    """Ask the language model, in parallel to other questions; the answer streams into ``state.assistant``.

    ``pictures`` are file names of photos, or CAMERA_PICTURE and the name of a camera.
    """

    question: str
    leave_out: tuple[PromptPart, ...] = ()
    pictures: tuple[str, ...] = ()


class CancelAnswer(Intent):
    """Cancel an answer of the language model; all answers in progress if none is named."""

    exchange_id: str = ""


class SayAnswer(Intent):
    """Say an answer of the language model, possibly edited by the wizard; the newest if none is named."""

    text: str
    exchange_id: str = ""


class DismissAnswer(Intent):
    """Dismiss a question and its answer, unsaid; cancel it if in progress."""

    exchange_id: str


class AskAboutPhoto(Intent):
    """Ask the language model about a photo, which is sent with the question."""

    file_name: str
    question: str


class AddModel(Intent):
    """Add a GGUF file that the user chose as a model of the embedded server, after asking it a question."""

    file: Path


class ChooseModel(Intent):
    """Ask this model from now on, named as in a scenario: ``embedded``, ``embedded:NAME``, ``ollama:NAME``, ..."""

    model: str


class ChoosePrompt(Intent):
    """Use this role or style of the scenario from now on; none if the name is empty."""

    kind: Literal["role", "style"]
    name: str


class EditPrompt(Intent):
    """Change a text for this session: the system prompt, the notes, or the role or style of that name."""

    kind: Literal["system_prompt", "notes", "role", "style"]
    text: str
    name: str = ""


class ResetPrompts(Intent):
    """Restore all texts, model, role and style of the scenario."""


ASSISTANT: IntentTable = {
    Ask: IntentSpec(QT_TR_NOOP("Asking the assistant"), "assistant"),
    CancelAnswer: IntentSpec(QT_TR_NOOP("Cancelling the answer")),
    SayAnswer: IntentSpec(QT_TR_NOOP("Speaking the answer"), "assistant", also="speech"),
    DismissAnswer: IntentSpec(QT_TR_NOOP("Dismissing the answer")),
    AskAboutPhoto: IntentSpec(QT_TR_NOOP("Asking about the photo"), "assistant", also="photos"),
    AddModel: IntentSpec(QT_TR_NOOP("Adding a language model"), "assistant"),
    ChooseModel: IntentSpec(QT_TR_NOOP("Choosing the language model"), "assistant"),
    ChoosePrompt: IntentSpec(QT_TR_NOOP("Choosing the assistant's role or style"), "assistant"),
    EditPrompt: IntentSpec(QT_TR_NOOP("Changing the assistant's prompts"), "assistant"),
    ResetPrompts: IntentSpec(QT_TR_NOOP("Resetting the assistant"), "assistant"),
}


# Intents of suggested replies and proposals of the language model: the wizard decides on them.


class SaySuggestion(Intent):
    """Say this suggested reply, which was read at that rank."""

    rank: int
    suggestion_id: str


class SayEditedSuggestion(Intent):
    """Say an edited suggested reply."""

    suggestion_id: str
    text: str


class DismissSuggestions(Intent):
    """Dismiss all suggested replies, and the filler to be said automatically."""

    @property
    def reduces_motion(self) -> bool:
        return True


class ConfirmProposal(Intent):
    """Carry out a proposal of the model."""

    proposal_id: str


class VetoProposal(Intent):
    """Reject a proposal of the language model."""

    proposal_id: str

    @property
    def reduces_motion(self) -> bool:
        return True


class SetLevel(Intent):
    """Set the automation of the language model, up to what the scenario allows."""

    function: AssistedFunction
    level: AssistanceLevel

    @property
    def reduces_motion(self) -> bool:
        return self.level == "off"


SUGGESTIONS: IntentTable = {
    SaySuggestion: IntentSpec(QT_TR_NOOP("Saying the suggestion"), "assistant", also="speech"),
    SayEditedSuggestion: IntentSpec(QT_TR_NOOP("Saying the edited suggestion"), "assistant", also="speech"),
    DismissSuggestions: IntentSpec(QT_TR_NOOP("Dismissing the suggestions")),
    ConfirmProposal: IntentSpec(QT_TR_NOOP("Confirming the proposal"), "assistant"),
    VetoProposal: IntentSpec(QT_TR_NOOP("Rejecting the proposal")),
    SetLevel: IntentSpec(QT_TR_NOOP("Setting the assistance level"), "assistant"),
}


# Intents of the robot's face.


class UseFace(Intent):
    """Use another face, by name."""

    face: str


class KeepFace(Intent):
    """Save the face that ``content`` describes, as the text of a face file, under this name, and use it."""

    name: str
    content: str


class ShowExpression(Intent):
    """Show an expression of the current face, by its name, from now on."""

    expression: str


class ShowOnFace(Intent):
    """Replace the face: by a text, a photo by its file name, the robot's camera; or show the face again."""

    what: Literal["face", "text", "photo", "live"]
    text: str = ""


class ShowFaceWindow(Intent):
    """Open or close the face window."""

    on: bool


class ServeFace(Intent):
    """Serve the face as a page for a phone or tablet on the robot, or stop."""

    on: bool


FACE: IntentTable = {
    UseFace: IntentSpec(QT_TR_NOOP("Changing the face"), "face"),
    KeepFace: IntentSpec(QT_TR_NOOP("Saving the face"), "face"),
    ShowExpression: IntentSpec(QT_TR_NOOP("Showing the expression"), "face", proposable=True),
    ShowOnFace: IntentSpec(QT_TR_NOOP("Showing content on the face"), "face"),
    ShowFaceWindow: IntentSpec(QT_TR_NOOP("Opening the face window"), "face"),
    ServeFace: IntentSpec(QT_TR_NOOP("Serving the face page"), "face"),
}


# Intents of people: naming, identification, consent.


class NamePerson(Intent):
    """Name a person, or remove the name with an empty one. Only the study's database stores the name."""

    person_id: str
    name: str


class AttendPerson(Intent):
    """Address this person from now on; empty: the nearest one."""

    person_id: str


class ConfirmPerson(Intent):
    """Identify a person as a known one: ``is_person_id``."""

    person_id: str
    is_person_id: str


class RejectPerson(Intent):
    """Record that a person is not ``is_person_id``, whether suggested or already identified. Permanent."""

    person_id: str
    is_person_id: str


class SetPersonGroup(Intent):
    """Assign a person to this group; empty: to none."""

    person_id: str
    group: str


class TagPerson(Intent):
    """Set a person's tags, and no others."""

    person_id: str
    tags: tuple[str, ...]


class NotePerson(Intent):
    """Set the wizard's note about a person, which replaces the earlier one."""

    person_id: str
    note: str


class MergePeople(Intent):
    """Merge two identities of one person into ``into_person_id``."""

    person_id: str
    into_person_id: str


class SplitPerson(Intent):
    """Split off the person present: nothing of this visit, or of the named one, belongs to ``person_id``."""

    person_id: str
    visit_id: str = ""


class NoteConsent(Intent):
    """Record a person's consent, or its end."""

    person_id: str
    kind: ConsentKind
    given: bool


class UndoPeople(Intent):
    """Undo the last decision about people, except erasing."""


class LookUpPerson(Intent):
    """Search all sessions with a person: entries with all these words, or everything without words."""

    person_id: str
    text: str = ""


class ForgetPerson(Intent):
    """Erase all data about a person from the study's database, and blur them in its recordings, for good."""

    person_id: str


PEOPLE: IntentTable = {
    NamePerson: IntentSpec(QT_TR_NOOP("Naming the person"), "naming_people"),
    AttendPerson: IntentSpec(QT_TR_NOOP("Addressing the person")),
    ConfirmPerson: IntentSpec(QT_TR_NOOP("Confirming the identity"), "naming_people"),
    RejectPerson: IntentSpec(QT_TR_NOOP("Rejecting the identity"), "naming_people"),
    SetPersonGroup: IntentSpec(QT_TR_NOOP("Changing the person's group"), "naming_people"),
    TagPerson: IntentSpec(QT_TR_NOOP("Tagging the person"), "naming_people"),
    NotePerson: IntentSpec(QT_TR_NOOP("Changing the note about the person"), "naming_people"),
    MergePeople: IntentSpec(QT_TR_NOOP("Merging the two people"), "naming_people"),
    SplitPerson: IntentSpec(QT_TR_NOOP("Splitting the person"), "naming_people"),
    # Consent and erasure are the participant's decision in every scenario.
    NoteConsent: IntentSpec(QT_TR_NOOP("Noting consent")),
    UndoPeople: IntentSpec(QT_TR_NOOP("Undoing the last decision about people")),
    LookUpPerson: IntentSpec(QT_TR_NOOP("Searching the person's history"), "naming_people", quiet=True),
    ForgetPerson: IntentSpec(QT_TR_NOOP("Erasing the person")),
}


# Intents of the session: recording, photos, scenario, layout.


class StartRecording(Intent):
    """Start a session. ``anyway``: the wizard was asked about open problems and starts nevertheless.

    Without it a recording is refused while a required check is open, for every actor.
    """

    details: TrialDetails
    anyway: bool = False


class StopRecording(Intent):
    """End the session."""


class PauseRecording(Intent):
    """Pause or resume the recording."""

    paused: bool


class TakePhoto(Intent):
    """Save the current frame."""


class TagPhoto(Intent):
    """Set a photo's tags, and no others. Photos are named by their file, as in PhotoTaken."""

    file_name: str
    tags: tuple[str, ...]


class DeletePhoto(Intent):
    """Delete a photo. It can be restored until the session ends."""

    file_name: str


class RestorePhoto(Intent):
    """Restore a deleted photo."""

    file_name: str


class KeepLayout(Intent):
    """Record the panel layout that the wizard made. ``layout`` is a layout as in scenario files, as JSON."""

    layout: str


SizeClass = Literal["compact", "usual", "large"]
"""Screen size for which a panel layout is made."""


class SaveLayout(Intent):
    """Save the layout (as in KeepLayout) in the scenario, for screens of that size. With a ``title`` it is saved in
    another scenario of this name, which is opened.
    """

    layout: str
    size_class: SizeClass = "usual"
    title: str = ""


class ResetLayout(Intent):
    """Restore the scenario's own layout, where another one was saved in its place."""


class OpenScenario(Intent):
    """Open a scenario; the link and a running recording stay."""

    path: Path


class SaveScenario(Intent):
    """Write a scenario file. If it is the one in force, or was ``edited`` from that, it is in force from then on. A
    recording continues with its own scenario if this one is saved as a separate file.

    ``replaces`` is the checksum of the file that may be replaced; empty if none may exist.
    """

    text: str
    path: Path
    edited: Path | None = None
    replaces: str = ""


class SameName(Value):
    """Decision about a part (``kind`` scenario, robot or face) whose ``name`` is taken: it is saved as ``new_name``. If
    that is empty, it replaces the other, which is moved aside, not deleted.
    """

    kind: str
    name: str
    new_name: str = ""


class ImportScenario(Intent):
    """Unpack a scenario from one file into the user's own, and open it. On name conflicts the user is asked first;
    nothing is done until the intent is sent again with everything ``decided``.
    """

    path: Path
    decided: tuple[SameName, ...] = ()


class ConfirmFile(Intent):
    """The user's answer about the references of a file: if accepted, the file of this checksum may use them."""

    sha256: str
    accepted: bool


class ShareScenario(Intent):
    """Write the scenario in force, with the user's files that it refers to, as one file."""

    path: Path


class DismissAlarm(Intent):
    """Mark a problem as resolved, where nothing else would show that it is over."""

    alarm_id: str


class GoOnWithTrial(Intent):
    """Resume the trial that an unexpected end interrupted."""


class LeaveTrial(Intent):
    """Do not resume the trial."""


class ConfirmAsBefore(Intent):
    """Confirm a condition as unchanged; with a ``person_id`` of ``people``, that this one is who the list says."""

    what: AsBefore
    person_id: str = ""


SESSION: IntentTable = {
    StartRecording: IntentSpec(QT_TR_NOOP("Starting a recording"), confirmed=get_args(AsBefore)),
    StopRecording: IntentSpec(QT_TR_NOOP("Ending the recording")),
    PauseRecording: IntentSpec(QT_TR_NOOP("Pausing the recording")),
    TakePhoto: IntentSpec(
        QT_TR_NOOP("Taking a photo"), "photos", proposable=True, confirmed=("permissions", "consent")
    ),
    TagPhoto: IntentSpec(QT_TR_NOOP("Tagging the photo"), "photos"),
    DeletePhoto: IntentSpec(QT_TR_NOOP("Deleting the photo"), "photos"),
    RestorePhoto: IntentSpec(QT_TR_NOOP("Restoring the photo"), "photos"),
    KeepLayout: IntentSpec(QT_TR_NOOP("Storing the panel layout"), quiet=True),
    SaveLayout: IntentSpec(QT_TR_NOOP("Saving the panel layout")),
    ResetLayout: IntentSpec(QT_TR_NOOP("Resetting the panel layout")),
    OpenScenario: IntentSpec(QT_TR_NOOP("Opening another scenario")),
    SaveScenario: IntentSpec(QT_TR_NOOP("Saving the scenario")),
    ImportScenario: IntentSpec(QT_TR_NOOP("Importing a scenario")),
    ConfirmFile: IntentSpec(QT_TR_NOOP("Confirming a file's references")),
    ShareScenario: IntentSpec(QT_TR_NOOP("Exporting the scenario as one file")),
    DismissAlarm: IntentSpec(QT_TR_NOOP("Dismissing an alarm")),
    GoOnWithTrial: IntentSpec(QT_TR_NOOP("Resuming the trial")),
    LeaveTrial: IntentSpec(QT_TR_NOOP("Ending the interrupted trial")),
    ConfirmAsBefore: IntentSpec(QT_TR_NOOP("Confirming unchanged conditions")),
}


# Intents of marks, marked intervals and notes.


def new_mark_id() -> str:
    return f"m-{secrets.token_hex(4)}"


class Mark(Intent):
    """Mark this moment, or one ``earlier_s`` ago."""

    label: str
    kind: MarkKind = "mark"
    earlier_s: float = 0.0
    mark_id: str = field(default_factory=new_mark_id)


class BeginMark(Intent):
    """Mark an interval that starts now, or ``earlier_s`` ago, and lasts until it is ended."""

    label: str
    kind: MarkKind = "mark"
    earlier_s: float = 0.0
    mark_id: str = field(default_factory=new_mark_id)


class StretchMark(Intent):
    """Extend a marked moment to an interval, which lasts until it is ended."""

    mark_id: str


class EndMark(Intent):
    """End the interval now."""

    mark_id: str


class ChangeMark(Intent):
    """Change a mark of this session: its label, or an earlier start."""

    mark_id: str
    label: str | None = None
    earlier_s: float = 0.0


class WithdrawMark(Intent):
    """Withdraw a mark."""

    mark_id: str


class AddNote(Intent):
    """Write a note about this moment, or one ``earlier_s`` ago. Words that begin with # are its tags."""

    text: str
    earlier_s: float = 0.0
    note_id: str = field(default_factory=new_mark_id)


class ChangeNote(Intent):
    """Change a note of this session, or the note of a mark."""

    note_id: str
    text: str


class RemoveNote(Intent):
    """Remove a note; a mark itself remains."""

    note_id: str


class RestoreNote(Intent):
    """Restore a removed note."""

    note_id: str


_MOMENT: Mapping[str, Bounds] = {"earlier_s": (0.0, 86_400.0)}

MARKS: IntentTable = {
    Mark: IntentSpec(QT_TR_NOOP("Marking the moment"), bounds=_MOMENT),
    BeginMark: IntentSpec(QT_TR_NOOP("Marking an interval"), bounds=_MOMENT),
    StretchMark: IntentSpec(QT_TR_NOOP("Making the mark an interval")),
    EndMark: IntentSpec(QT_TR_NOOP("Ending the mark"), quiet=True),
    ChangeMark: IntentSpec(QT_TR_NOOP("Changing the mark"), bounds=_MOMENT),
    WithdrawMark: IntentSpec(QT_TR_NOOP("Withdrawing the mark")),
    AddNote: IntentSpec(QT_TR_NOOP("Writing a note"), "notes", bounds=_MOMENT),
    ChangeNote: IntentSpec(QT_TR_NOOP("Changing the note"), "notes"),
    RemoveNote: IntentSpec(QT_TR_NOOP("Removing the note"), "notes"),
    RestoreNote: IntentSpec(QT_TR_NOOP("Restoring the note"), "notes"),
}


# Intents of the study protocol: moving between steps.


class NextStep(Intent):
    """Continue with the next step: the first if none has started, the end after the last."""


class PreviousStep(Intent):
    """Return to the step before this one, as after a mistake: its time and ticks continue."""


class SkipStep(Intent):
    """Skip this step and start the next one."""


class TakeBranch(Intent):
    """Follow this branch of the current step, as the participant did, to its step."""

    branch: str


class GoToStep(Intent):
    """Start this step, by its id; restart it if current."""

    step_id: str


class TickItem(Intent):
    """Tick or untick a checklist item of the current step."""

    item: str
    on: bool = True


PROTOCOL: IntentTable = {
    NextStep: IntentSpec(QT_TR_NOOP("Going to the next step")),
    PreviousStep: IntentSpec(QT_TR_NOOP("Going back to the previous step")),
    SkipStep: IntentSpec(QT_TR_NOOP("Skipping the step")),
    TakeBranch: IntentSpec(QT_TR_NOOP("Taking the branch")),
    GoToStep: IntentSpec(QT_TR_NOOP("Going to the step")),
    TickItem: IntentSpec(QT_TR_NOOP("Ticking off the item")),
}


class BeginPractice(Intent):
    """Start the exercise on the simulated robot. ``wizard`` is the trainee."""

    wizard: str = ""


class SkipPracticeStep(Intent):
    """Continue with the next step without completing this one."""


class EndPractice(Intent):
    """End the exercise, or dismiss its result."""


PRACTICE: IntentTable = {
    BeginPractice: IntentSpec(QT_TR_NOOP("Starting the practice")),
    SkipPracticeStep: IntentSpec(QT_TR_NOOP("Skipping a practice step")),
    EndPractice: IntentSpec(QT_TR_NOOP("Ending the practice")),
}


class TickCheck(Intent):
    """Tick or untick one of the scenario's own checks."""

    check_id: str
    done: bool = True


class TryMicrophone(Intent):
    """Test the participant's microphone for a short time; nothing is recorded."""

    on: bool = True

    @property
    def reduces_motion(self) -> bool:
        return not self.on


PREFLIGHT: IntentTable = {
    TickCheck: IntentSpec(QT_TR_NOOP("Ticking a check")),
    TryMicrophone: IntentSpec(QT_TR_NOOP("Testing the microphone"), "audio_recording"),
}

INTENTS: IntentTable = {
    **DRIVING,
    **PLACES,
    **ROBOT,
    **SPEAKING,
    **SOUND,
    **CONVERSATION,
    **ASSISTANT,
    **FACE,
    **SUGGESTIONS,
    **PEOPLE,
    **SESSION,
    **PREFLIGHT,
    **MARKS,
    **PROTOCOL,
    **PRACTICE,
}
"""Table of all intents, from one part per subject."""
