"""Intents: all requests to the console, as data, and what each may do.

Keys, buttons, the palette, gamepads, proposals of a language model, a second wizard and the record use these types
only. A new function is one class here, and one handler in its service.
"""

import math
import secrets
from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import ClassVar, Literal, get_args

from caris_desktop.domain.actor import WIZARD, Actor
from caris_desktop.domain.control_definitions import ControlValue
from caris_desktop.domain.corrections import WhoSpoke
from caris_desktop.domain.events import (
    AssistanceLevel,
    AssistedFunction,
    CommandSource,
    ConsentKind,
    MarkKind,
    TrialDetails,
    UtteranceOrigin,
    VoiceOutput,
)
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sound_values import Role, TalkTo
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value

Permission = Literal[
    "photos",
    "video_recording",
    "audio_recording",
    "driving",
    "assistant",
    "naming_people",
    "robot_controls",
    "transcription",
    "own_voice",
    "cloud_models",
    "face",
    "speech",
    "notes",
]
"""Functions a scenario can disable."""
AsBefore = Literal["map", "people", "permissions", "consent"]
"""Conditions that a person must confirm before a trial resumes: the robot's position, who is there, what is recorded
and what a language model may do, and the consent.
"""
Bounds = tuple[float, float]
Moves = Literal["base", "head"]


class IntentSpec(Value):
    """Properties of a kind of intent.

    ``words`` name the request, as the subject of a sentence ("Driving is not possible: ..."). ``permission`` is what
    the scenario must allow, and ``also`` another one that it must allow too. ``moves`` is the part of the robot that it
    may move, so the emergency stop refuses it. While somebody drives by hand, intents that move the base are refused to
    others. ``needs_link``: it is for the robot and never waits for a missing one. ``in_replay``: a replay does it too.
    ``quiet``: refusals are frequent, as while a key is held, and not reported each time; the window shows the reason.
    ``reduces_motion``: all of its kind do (:attr:`Intent.reduces_motion`). ``proposable``: a language model may propose
    it. ``bounds`` are the least and the greatest value of its numeric fields. ``confirmed``: conditions to confirm
    first when a trial resumes after the program ended.
    """

    words: str
    permission: Permission | None = None
    also: Permission | None = None
    moves: Moves | None = None
    needs_link: bool = False
    in_replay: bool = False
    quiet: bool = False
    reduces_motion: bool = False
    proposable: bool = False
    bounds: Mapping[str, Bounds] = field(default_factory=dict)
    confirmed: tuple[AsBefore, ...] = ()

    @property
    def permissions(self) -> tuple[Permission, ...]:
        """All permissions required of the scenario."""
        return tuple(one for one in (self.permission, self.also) if one is not None)


class Intent(Value, kw_only=True):
    """Request to the console from an actor."""

    spec: ClassVar[IntentSpec]
    actor: Actor = WIZARD

    @property
    def reduces_motion(self) -> bool:
        """Whether it can only reduce motion or increase caution. Such intents are never refused."""
        return self.spec.reduces_motion

    @property
    def needs_permissions(self) -> tuple[Permission, ...]:
        """Permissions required where they differ within the type; empty: those of the spec."""
        return ()


_SHARE: Bounds = (-1.0, 1.0)
_MOMENT: Mapping[str, Bounds] = {"earlier_s": (0.0, 86_400.0)}


# Intents of manual driving, stops and the head.


class Drive(Intent):
    """Hold to drive: each of -1..1 of the speed setting, all zero releases. Sent on each change only."""

    spec = IntentSpec(
        QT_TR_NOOP("Driving"),
        "driving",
        moves="base",
        needs_link=True,
        quiet=True,
        bounds={"forward": _SHARE, "left": _SHARE, "turn": _SHARE},
    )
    forward: float
    left: float
    turn: float
    source: CommandSource

    @property
    def reduces_motion(self) -> bool:
        return not (self.forward or self.left or self.turn)


class ReleaseDrive(Intent):
    """Release all controls: zero at once."""

    spec = IntentSpec(QT_TR_NOOP("Releasing the drive controls"), in_replay=True, reduces_motion=True)
    reason: str = ""


class SetSpeed(Intent):
    """Set the speed, 0.1..1 of the scenario's limits."""

    spec = IntentSpec(QT_TR_NOOP("Setting the speed"), "driving", bounds={"fraction": (0.0, 1.0)})
    fraction: float


class Stop(Intent):
    """Halt motion and cancel goals, always."""

    spec = IntentSpec(QT_TR_NOOP("Stopping"), in_replay=True, reduces_motion=True)


class EmergencyStop(Intent):
    """Latch the emergency stop."""

    spec = IntentSpec(QT_TR_NOOP("Activating the emergency stop"), in_replay=True, reduces_motion=True)


class ReleaseEmergencyStop(Intent):
    """Release the latched emergency stop."""

    spec = IntentSpec(QT_TR_NOOP("Releasing the emergency stop"))


class SetGuard(Intent):
    """Turn the obstacle guard on or off; off lasts until link loss, a change of scenario, or turning it on."""

    spec = IntentSpec(QT_TR_NOOP("Turning off the obstacle guard"), "driving", needs_link=True)
    on: bool

    @property
    def reduces_motion(self) -> bool:
        return self.on


class LookAt(Intent):
    """Point the head: pan left positive, tilt down positive."""

    spec = IntentSpec(
        QT_TR_NOOP("Aiming the head"),
        "driving",
        moves="head",
        needs_link=True,
        proposable=True,
        bounds={"pan_rad": (-math.tau, math.tau), "tilt_rad": (-math.tau, math.tau)},
    )
    pan_rad: float
    tilt_rad: float


class TurnHead(Intent):
    """Turn the head while a control is held: each of -1..1 of its speed, zero stops. Sent on each change only."""

    spec = IntentSpec(
        QT_TR_NOOP("Turning the head"),
        "driving",
        moves="head",
        needs_link=True,
        quiet=True,
        bounds={"pan": _SHARE, "tilt": _SHARE},
    )
    pan: float
    tilt: float

    @property
    def reduces_motion(self) -> bool:
        return not (self.pan or self.tilt)


class Nod(Intent):
    """Nod once: a brief yes while somebody speaks."""

    spec = IntentSpec(QT_TR_NOOP("Nodding"), "driving", moves="head", needs_link=True, proposable=True)


# Intents of navigation, places and maps.


class GoToPlace(Intent):
    """Navigate to a place of the scenario."""

    spec = IntentSpec(QT_TR_NOOP("Driving to the place"), "driving", moves="base", needs_link=True, proposable=True)
    place: str


class GoToPoint(Intent):
    """Navigate to a point with a heading."""

    spec = IntentSpec(QT_TR_NOOP("Driving there"), "driving", moves="base", needs_link=True, proposable=True)
    target_in_map: Pose2D


class CancelGoal(Intent):
    """Cancel the navigation goal."""

    spec = IntentSpec(QT_TR_NOOP("Cancelling the goal"), reduces_motion=True)


class SetInitialPose(Intent):
    """Set the robot's pose for localization."""

    spec = IntentSpec(QT_TR_NOOP("Setting the robot's position"), "driving", needs_link=True)
    pose_in_map: Pose2D


class SavePlace(Intent):
    """Add a place, or move the one of that name, in the wizard's copy of the scenario."""

    spec = IntentSpec(QT_TR_NOOP("Saving the place"), "driving")
    place: str
    pose_in_map: Pose2D


class RemovePlace(Intent):
    """Remove a place."""

    spec = IntentSpec(QT_TR_NOOP("Removing the place"), "driving")
    place: str


class SaveMap(Intent):
    """Save the map on the robot, by name."""

    spec = IntentSpec(QT_TR_NOOP("Saving the map"), "driving", needs_link=True)
    name: str


class LoadMap(Intent):
    """Load a map saved on the robot."""

    spec = IntentSpec(QT_TR_NOOP("Loading the map"), "driving", needs_link=True)
    name: str


class SetMapping(Intent):
    """Continue mapping, or only localize in the map."""

    spec = IntentSpec(QT_TR_NOOP("Turning mapping on or off"), "driving", needs_link=True)
    mapping: bool


# Intents to select a robot and use its controls.


class UseControl(Intent):
    """Use a Robot panel control; a button's value is True."""

    # Whether it moves the robot is decided for each control.
    spec = IntentSpec(QT_TR_NOOP("Using the control"), "robot_controls", needs_link=True, proposable=True)
    control: str
    value: ControlValue


class UseRobot(Intent):
    """Connect to another robot instead of the current one."""

    spec = IntentSpec(QT_TR_NOOP("Connecting to another robot"))
    robot: str


class UseSimulatedRobot(Intent):
    """Connect to the simulated robot of this computer; start it if needed."""

    spec = IntentSpec(QT_TR_NOOP("Connecting to the simulated robot"))


# Intents of the robot's speech: utterances, queue and voice.


class Say(Intent):
    """Speak after the queued utterances. ``{name}`` and ``{place}`` are filled in."""

    spec = IntentSpec(QT_TR_NOOP("Speaking"), "speech", proposable=True)
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

    spec = IntentSpec(QT_TR_NOOP("Preparing speech"), "speech", quiet=True)
    text: str


class FillGap(Intent):
    """Fill the placeholder that was asked for; empty: do not say it."""

    spec = IntentSpec(QT_TR_NOOP("Filling in the placeholder"), "speech")
    words: str


class MoveQueued(Intent):
    """Move a queued utterance to another place, 0 for the next."""

    spec = IntentSpec(QT_TR_NOOP("Reordering the speech queue"), "speech", bounds={"place": (0, 1000)})
    utterance_id: str
    place: int


class EditQueued(Intent):
    """Replace the text of a queued utterance."""

    spec = IntentSpec(QT_TR_NOOP("Editing a queued utterance"), "speech")
    utterance_id: str
    text: str


class CancelQueued(Intent):
    """Drop a queued utterance."""

    spec = IntentSpec(QT_TR_NOOP("Removing a queued utterance"))
    utterance_id: str


class Silence(Intent):
    """Interrupt speech at once and drop the queue."""

    spec = IntentSpec(QT_TR_NOOP("Interrupting speech"))


class SetVoice(Intent):
    """Set who speaks from the next utterance on, and this computer's voice, as in the scenario."""

    spec = IntentSpec(QT_TR_NOOP("Changing the voice"), "speech", bounds={"rate": (0.5, 2.0), "volume": (0.0, 1.0)})
    output: VoiceOutput
    name: str = ""
    language: str = ""
    rate: float = 1.0
    volume: float = 1.0


# Intents of microphones, the robot's sound and the wizard's own voice.


class PushToTalk(Intent):
    """Send the wizard's speech to the robot, or as text to the Speak field, until it is off."""

    spec = IntentSpec(QT_TR_NOOP("Speaking through the robot"), "own_voice")
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

    spec = IntentSpec(QT_TR_NOOP("Listening to the robot"), bounds={"volume": (0.0, 1.0)})
    on: bool
    volume: float = 1.0


class UseMicrophone(Intent):
    """Use this input of this computer for the participant, or the wizard; None: none. Saved for the next time.

    The scenario selects a participant microphone that is not of this computer.
    """

    spec = IntentSpec(QT_TR_NOOP("Choosing a microphone"))
    microphone: str | None
    role: Role = "participant"


class CorrectUtterance(Intent):
    """Correct an utterance's text or speaker, or set its tags; None leaves a value as it is.

    ``speaker`` and ``person_id`` may be empty for "not sure".
    """

    spec = IntentSpec(QT_TR_NOOP("Correcting the transcript"))
    utterance_id: str
    text: str | None = None
    speaker: WhoSpoke | None = None
    person_id: str | None = None
    tags: tuple[str, ...] | None = None


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

    spec = IntentSpec(QT_TR_NOOP("Asking the assistant"), "assistant")
    question: str
    leave_out: tuple[PromptPart, ...] = ()
    pictures: tuple[str, ...] = ()


class CancelAnswer(Intent):
    """Cancel an answer of the language model; all answers in progress if none is named."""

    spec = IntentSpec(QT_TR_NOOP("Cancelling the answer"))
    exchange_id: str = ""


class SayAnswer(Intent):
    """Say an answer of the language model, possibly edited by the wizard; the newest if none is named."""

    spec = IntentSpec(QT_TR_NOOP("Speaking the answer"), "assistant", also="speech")
    text: str
    exchange_id: str = ""


class DismissAnswer(Intent):
    """Dismiss a question and its answer, unsaid; cancel it if in progress."""

    spec = IntentSpec(QT_TR_NOOP("Dismissing the answer"))
    exchange_id: str


class AskAboutPhoto(Intent):
    """Ask the language model about a photo, which is sent with the question."""

    spec = IntentSpec(QT_TR_NOOP("Asking about the photo"), "assistant", also="photos")
    file_name: str
    question: str


class AddModel(Intent):
    """Add a GGUF file that the user chose as a model of the embedded server, after asking it a question."""

    spec = IntentSpec(QT_TR_NOOP("Adding a language model"), "assistant")
    file: Path


class ChooseModel(Intent):
    """Ask this model from now on, named as in a scenario: ``embedded``, ``embedded:NAME``, ``ollama:NAME``, ..."""

    spec = IntentSpec(QT_TR_NOOP("Choosing the language model"), "assistant")
    model: str


class ChoosePrompt(Intent):
    """Use this role or style of the scenario from now on; none if the name is empty."""

    spec = IntentSpec(QT_TR_NOOP("Choosing the assistant's role or style"), "assistant")
    kind: Literal["role", "style"]
    name: str


class EditPrompt(Intent):
    """Change a text for this session: the system prompt, the notes, or the role or style of that name."""

    spec = IntentSpec(QT_TR_NOOP("Changing the assistant's prompts"), "assistant")
    kind: Literal["system_prompt", "notes", "role", "style"]
    text: str
    name: str = ""


class ResetPrompts(Intent):
    """Restore all texts, model, role and style of the scenario."""

    spec = IntentSpec(QT_TR_NOOP("Resetting the assistant"), "assistant")


# Intents of the robot's face.


class UseFace(Intent):
    """Use another face, by name."""

    spec = IntentSpec(QT_TR_NOOP("Changing the face"), "face")
    face: str


class KeepFace(Intent):
    """Save the face that ``content`` describes, as the text of a face file, under this name, and use it."""

    spec = IntentSpec(QT_TR_NOOP("Saving the face"), "face")
    name: str
    content: str


class ShowExpression(Intent):
    """Show an expression of the current face, by its name, from now on."""

    spec = IntentSpec(QT_TR_NOOP("Showing the expression"), "face", proposable=True)
    expression: str


class ShowOnFace(Intent):
    """Replace the face: by a text, a photo by its file name, the robot's camera; or show the face again."""

    spec = IntentSpec(QT_TR_NOOP("Showing content on the face"), "face")
    what: Literal["face", "text", "photo", "live"]
    text: str = ""


class ShowFaceWindow(Intent):
    """Open or close the face window."""

    spec = IntentSpec(QT_TR_NOOP("Opening the face window"), "face")
    on: bool


class ServeFace(Intent):
    """Serve the face as a page for a phone or tablet on the robot, or stop."""

    spec = IntentSpec(QT_TR_NOOP("Serving the face page"), "face")
    on: bool


# Intents of suggested replies and proposals of the language model: the wizard decides on them.


class SaySuggestion(Intent):
    """Say this suggested reply, which was read at that rank."""

    spec = IntentSpec(QT_TR_NOOP("Saying the suggestion"), "assistant", also="speech")
    rank: int
    suggestion_id: str


class SayEditedSuggestion(Intent):
    """Say an edited suggested reply."""

    spec = IntentSpec(QT_TR_NOOP("Saying the edited suggestion"), "assistant", also="speech")
    suggestion_id: str
    text: str


class DismissSuggestions(Intent):
    """Dismiss all suggested replies, and the filler to be said automatically."""

    spec = IntentSpec(QT_TR_NOOP("Dismissing the suggestions"), reduces_motion=True)


class ConfirmProposal(Intent):
    """Carry out a proposal of the model."""

    spec = IntentSpec(QT_TR_NOOP("Confirming the proposal"), "assistant")
    proposal_id: str


class VetoProposal(Intent):
    """Reject a proposal of the language model."""

    spec = IntentSpec(QT_TR_NOOP("Rejecting the proposal"), reduces_motion=True)
    proposal_id: str


class SetLevel(Intent):
    """Set the automation of the language model, up to what the scenario allows."""

    spec = IntentSpec(QT_TR_NOOP("Setting the assistance level"), "assistant")
    function: AssistedFunction
    level: AssistanceLevel

    @property
    def reduces_motion(self) -> bool:
        return self.level == "off"


# Intents of people: naming, identification, consent.


class NamePerson(Intent):
    """Name a person, or remove the name with an empty one. Only the study's database stores the name."""

    spec = IntentSpec(QT_TR_NOOP("Naming the person"), "naming_people")
    person_id: str
    name: str


class AttendPerson(Intent):
    """Address this person from now on; empty: the nearest one."""

    spec = IntentSpec(QT_TR_NOOP("Addressing the person"))
    person_id: str


class ConfirmPerson(Intent):
    """Identify a person as a known one: ``is_person_id``."""

    spec = IntentSpec(QT_TR_NOOP("Confirming the identity"), "naming_people")
    person_id: str
    is_person_id: str


class RejectPerson(Intent):
    """Record that a person is not ``is_person_id``, whether suggested or already identified. Permanent."""

    spec = IntentSpec(QT_TR_NOOP("Rejecting the identity"), "naming_people")
    person_id: str
    is_person_id: str


class SetPersonGroup(Intent):
    """Assign a person to this group; empty: to none."""

    spec = IntentSpec(QT_TR_NOOP("Changing the person's group"), "naming_people")
    person_id: str
    group: str


class TagPerson(Intent):
    """Set a person's tags, and no others."""

    spec = IntentSpec(QT_TR_NOOP("Tagging the person"), "naming_people")
    person_id: str
    tags: tuple[str, ...]


class NotePerson(Intent):
    """Set the wizard's note about a person, which replaces the earlier one."""

    spec = IntentSpec(QT_TR_NOOP("Changing the note about the person"), "naming_people")
    person_id: str
    note: str


class MergePeople(Intent):
    """Merge two identities of one person into ``into_person_id``."""

    spec = IntentSpec(QT_TR_NOOP("Merging the two people"), "naming_people")
    person_id: str
    into_person_id: str


class SplitPerson(Intent):
    """Split off the person present: nothing of this visit, or of the named one, belongs to ``person_id``."""

    spec = IntentSpec(QT_TR_NOOP("Splitting the person"), "naming_people")
    person_id: str
    visit_id: str = ""


class NoteConsent(Intent):
    """Record a person's consent, or its end."""

    # Consent and erasure are the participant's decision in every scenario.
    spec = IntentSpec(QT_TR_NOOP("Noting consent"))
    person_id: str
    kind: ConsentKind
    given: bool


class UndoPeople(Intent):
    """Undo the last decision about people, except erasing."""

    spec = IntentSpec(QT_TR_NOOP("Undoing the last decision about people"))


class LookUpPerson(Intent):
    """Search all sessions with a person: entries with all these words, or everything without words."""

    spec = IntentSpec(QT_TR_NOOP("Searching the person's history"), "naming_people", quiet=True)
    person_id: str
    text: str = ""


class ForgetPerson(Intent):
    """Erase all data about a person from the study's database, and blur them in its recordings, for good."""

    spec = IntentSpec(QT_TR_NOOP("Erasing the person"))
    person_id: str


# Intents of the session: recording, photos, scenario, layout.


class StartRecording(Intent):
    """Start a session. ``anyway``: the wizard was asked about open problems and starts nevertheless.

    Without it a recording is refused while a required check is open, for every actor.
    """

    spec = IntentSpec(QT_TR_NOOP("Starting a recording"), confirmed=get_args(AsBefore))
    details: TrialDetails
    anyway: bool = False


class StopRecording(Intent):
    """End the session."""

    spec = IntentSpec(QT_TR_NOOP("Ending the recording"))


class PauseRecording(Intent):
    """Pause or resume the recording."""

    spec = IntentSpec(QT_TR_NOOP("Pausing the recording"))
    paused: bool


class TakePhoto(Intent):
    """Save the current frame."""

    spec = IntentSpec(QT_TR_NOOP("Taking a photo"), "photos", proposable=True, confirmed=("permissions", "consent"))


class TagPhoto(Intent):
    """Set a photo's tags, and no others. Photos are named by their file, as in PhotoTaken."""

    spec = IntentSpec(QT_TR_NOOP("Tagging the photo"), "photos")
    file_name: str
    tags: tuple[str, ...]


class DeletePhoto(Intent):
    """Delete a photo. It can be restored until the session ends."""

    spec = IntentSpec(QT_TR_NOOP("Deleting the photo"), "photos")
    file_name: str


class RestorePhoto(Intent):
    """Restore a deleted photo."""

    spec = IntentSpec(QT_TR_NOOP("Restoring the photo"), "photos")
    file_name: str


class KeepLayout(Intent):
    """Record the panel layout that the wizard made. ``layout`` is a layout as in scenario files, as JSON."""

    spec = IntentSpec(QT_TR_NOOP("Storing the panel layout"), quiet=True)
    layout: str


SizeClass = Literal["compact", "usual", "large"]
"""Screen size for which a panel layout is made."""


class SaveLayout(Intent):
    """Save the layout (as in KeepLayout) in the scenario, for screens of that size. With a ``title`` it is saved in
    another scenario of this name, which is opened.
    """

    spec = IntentSpec(QT_TR_NOOP("Saving the panel layout"))
    layout: str
    size_class: SizeClass = "usual"
    title: str = ""


class ResetLayout(Intent):
    """Restore the scenario's own layout, where another one was saved in its place."""

    spec = IntentSpec(QT_TR_NOOP("Resetting the panel layout"))


class OpenScenario(Intent):
    """Open a scenario; the link and a running recording stay."""

    spec = IntentSpec(QT_TR_NOOP("Opening another scenario"))
    path: Path


class SaveScenario(Intent):
    """Write a scenario file. If it is the one in force, or was ``edited`` from that, it is in force from then on. A
    recording continues with its own scenario if this one is saved as a separate file.

    ``replaces`` is the checksum of the file that may be replaced; empty if none may exist.
    """

    spec = IntentSpec(QT_TR_NOOP("Saving the scenario"))
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

    spec = IntentSpec(QT_TR_NOOP("Importing a scenario"))
    path: Path
    decided: tuple[SameName, ...] = ()


class ConfirmFile(Intent):
    """The user's answer about the references of a file: if accepted, the file of this checksum may use them."""

    spec = IntentSpec(QT_TR_NOOP("Confirming a file's references"))
    sha256: str
    accepted: bool


class ShareScenario(Intent):
    """Write the scenario in force, with the user's files that it refers to, as one file."""

    spec = IntentSpec(QT_TR_NOOP("Exporting the scenario as one file"))
    path: Path


class DismissAlarm(Intent):
    """Mark a problem as resolved, where nothing else would show that it is over."""

    spec = IntentSpec(QT_TR_NOOP("Dismissing an alarm"))
    alarm_id: str


class GoOnWithTrial(Intent):
    """Resume the trial that an unexpected end interrupted."""

    spec = IntentSpec(QT_TR_NOOP("Resuming the trial"))


class LeaveTrial(Intent):
    """Do not resume the trial."""

    spec = IntentSpec(QT_TR_NOOP("Ending the interrupted trial"))


class ConfirmAsBefore(Intent):
    """Confirm a condition as unchanged; with a ``person_id`` of ``people``, that this one is who the list says."""

    spec = IntentSpec(QT_TR_NOOP("Confirming unchanged conditions"))
    what: AsBefore
    person_id: str = ""


class TickCheck(Intent):
    """Tick or untick one of the scenario's own checks."""

    spec = IntentSpec(QT_TR_NOOP("Ticking a check"))
    check_id: str
    done: bool = True


class TryMicrophone(Intent):
    """Test the participant's microphone for a short time; nothing is recorded."""

    spec = IntentSpec(QT_TR_NOOP("Testing the microphone"), "audio_recording")
    on: bool = True

    @property
    def reduces_motion(self) -> bool:
        return not self.on


# Intents of marks, marked intervals and notes.


def new_mark_id() -> str:
    return f"m-{secrets.token_hex(4)}"


class Mark(Intent):
    """Mark this moment, or one ``earlier_s`` ago."""

    spec = IntentSpec(QT_TR_NOOP("Marking the moment"), bounds=_MOMENT)
    label: str
    kind: MarkKind = "mark"
    earlier_s: float = 0.0
    mark_id: str = field(default_factory=new_mark_id)


class BeginMark(Intent):
    """Mark an interval that starts now, or ``earlier_s`` ago, and lasts until it is ended."""

    spec = IntentSpec(QT_TR_NOOP("Marking an interval"), bounds=_MOMENT)
    label: str
    kind: MarkKind = "mark"
    earlier_s: float = 0.0
    mark_id: str = field(default_factory=new_mark_id)


class StretchMark(Intent):
    """Extend a marked moment to an interval, which lasts until it is ended."""

    spec = IntentSpec(QT_TR_NOOP("Making the mark an interval"))
    mark_id: str


class EndMark(Intent):
    """End the interval now."""

    spec = IntentSpec(QT_TR_NOOP("Ending the mark"), quiet=True)
    mark_id: str


class ChangeMark(Intent):
    """Change a mark of this session: its label, or an earlier start."""

    spec = IntentSpec(QT_TR_NOOP("Changing the mark"), bounds=_MOMENT)
    mark_id: str
    label: str | None = None
    earlier_s: float = 0.0


class WithdrawMark(Intent):
    """Withdraw a mark."""

    spec = IntentSpec(QT_TR_NOOP("Withdrawing the mark"))
    mark_id: str


class AddNote(Intent):
    """Write a note about this moment, or one ``earlier_s`` ago. Words that begin with # are its tags."""

    spec = IntentSpec(QT_TR_NOOP("Writing a note"), "notes", bounds=_MOMENT)
    text: str
    earlier_s: float = 0.0
    note_id: str = field(default_factory=new_mark_id)


class ChangeNote(Intent):
    """Change a note of this session, or the note of a mark."""

    spec = IntentSpec(QT_TR_NOOP("Changing the note"), "notes")
    note_id: str
    text: str


class RemoveNote(Intent):
    """Remove a note; a mark itself remains."""

    spec = IntentSpec(QT_TR_NOOP("Removing the note"), "notes")
    note_id: str


class RestoreNote(Intent):
    """Restore a removed note."""

    spec = IntentSpec(QT_TR_NOOP("Restoring the note"), "notes")
    note_id: str


# Intents of the study protocol: moving between steps.


class NextStep(Intent):
    """Continue with the next step: the first if none has started, the end after the last."""

    spec = IntentSpec(QT_TR_NOOP("Going to the next step"))


class PreviousStep(Intent):
    """Return to the step before this one, as after a mistake: its time and ticks continue."""

    spec = IntentSpec(QT_TR_NOOP("Going back to the previous step"))


class SkipStep(Intent):
    """Skip this step and start the next one."""

    spec = IntentSpec(QT_TR_NOOP("Skipping the step"))


class TakeBranch(Intent):
    """Follow this branch of the current step, as the participant did, to its step."""

    spec = IntentSpec(QT_TR_NOOP("Taking the branch"))
    branch: str


class GoToStep(Intent):
    """Start this step, by its id; restart it if current."""

    spec = IntentSpec(QT_TR_NOOP("Going to the step"))
    step_id: str


class TickItem(Intent):
    """Tick or untick a checklist item of the current step."""

    spec = IntentSpec(QT_TR_NOOP("Ticking off the item"))
    item: str
    on: bool = True


class BeginPractice(Intent):
    """Start the exercise on the simulated robot. ``wizard`` is the trainee."""

    spec = IntentSpec(QT_TR_NOOP("Starting the practice"))
    wizard: str = ""


class SkipPracticeStep(Intent):
    """Continue with the next step without completing this one."""

    spec = IntentSpec(QT_TR_NOOP("Skipping a practice step"))


class EndPractice(Intent):
    """End the exercise, or dismiss its result."""

    spec = IntentSpec(QT_TR_NOOP("Ending the practice"))


INTENTS: Mapping[type[Intent], IntentSpec] = {
    kind: kind.spec
    for kind in vars().copy().values()
    if isinstance(kind, type) and issubclass(kind, Intent) and kind is not Intent
}
"""All intents."""
