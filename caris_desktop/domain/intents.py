"""Everything that can be asked of the console, as data, and one table that says what each of them may do.

Keys, buttons, the palette, gamepads, proposals of a language model, a second wizard and the record use these types and
no others. A new function is one dataclass here, one line of the table, and one handler in the service that does it.
"""

import math
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from caris_desktop.domain.actor import WIZARD, Actor
from caris_desktop.domain.controls import ControlValue
from caris_desktop.domain.events import CommandSource, ConsentKind, MarkKind, UtteranceOrigin
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.trial import TrialDetails

Permission = Literal[
    "photos", "video_recording", "audio_recording", "driving", "assistant", "naming_people", "robot_controls"
]
"""What a scenario can switch off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Intent:
    """Something that somebody asks the console for."""

    actor: Actor = WIZARD

    @property
    def lets_go(self) -> bool:
        """Whether it can only make the robot move less, or more carefully. Nothing ever refuses that."""
        return False


# Driving


@dataclass(frozen=True, slots=True)
class Drive(Intent):
    """Hold to drive: each of -1..1 of the speed setting, all zero releases. Asked on each change only."""

    forward: float
    left: float
    turn: float
    source: CommandSource

    @property
    def lets_go(self) -> bool:
        return not (self.forward or self.left or self.turn)


@dataclass(frozen=True, slots=True)
class ReleaseDrive(Intent):
    """Nothing is held any more: zero at once."""

    reason: str = ""

    @property
    def lets_go(self) -> bool:
        return True


@dataclass(frozen=True, slots=True)
class SetSpeed(Intent):
    """Speed setting, 0.1..1 of the scenario's limits."""

    fraction: float


@dataclass(frozen=True, slots=True)
class Stop(Intent):
    """Halt motion and cancel goals, always."""

    @property
    def lets_go(self) -> bool:
        return True


@dataclass(frozen=True, slots=True)
class EmergencyStop(Intent):
    """Latch the emergency stop."""

    @property
    def lets_go(self) -> bool:
        return True


@dataclass(frozen=True, slots=True)
class ReleaseEmergencyStop(Intent):
    """Release the latched emergency stop."""


@dataclass(frozen=True, slots=True)
class SetGuard(Intent):
    """Switch the obstacle guard; off lasts until the link is lost, the scenario changes, or it is switched on."""

    on: bool

    @property
    def lets_go(self) -> bool:
        return self.on


# The head


@dataclass(frozen=True, slots=True)
class LookAt(Intent):
    """Turn the head there: pan left positive, tilt down positive."""

    pan_rad: float
    tilt_rad: float


@dataclass(frozen=True, slots=True)
class TurnHead(Intent):
    """Turn the head while something is held: each of -1..1 of its speed, zero stops. Asked on each change only."""

    pan: float
    tilt: float

    @property
    def lets_go(self) -> bool:
        return not (self.pan or self.tilt)


@dataclass(frozen=True, slots=True)
class Nod(Intent):
    """Nod once: yes, in passing, while somebody speaks."""


# Where to


@dataclass(frozen=True, slots=True)
class GoToPlace(Intent):
    """Navigate to a place of the scenario."""

    place: str


@dataclass(frozen=True, slots=True)
class GoToPoint(Intent):
    """Navigate to a point with a heading."""

    target_in_map: Pose2D


@dataclass(frozen=True, slots=True)
class CancelGoal(Intent):
    """Go no further towards the goal."""

    @property
    def lets_go(self) -> bool:
        return True


@dataclass(frozen=True, slots=True)
class SetInitialPose(Intent):
    """Tell the localization where the robot is."""

    pose_in_map: Pose2D


@dataclass(frozen=True, slots=True)
class SavePlace(Intent):
    """Add a place, or move the one of that name, in the wizard's copy of the scenario."""

    place: str
    pose_in_map: Pose2D


@dataclass(frozen=True, slots=True)
class RemovePlace(Intent):
    """Forget a place."""

    place: str


@dataclass(frozen=True, slots=True)
class SaveMap(Intent):
    """Let the robot keep its map under a name."""

    name: str


@dataclass(frozen=True, slots=True)
class LoadMap(Intent):
    """Let the robot use a map that it has."""

    name: str


@dataclass(frozen=True, slots=True)
class SetMapping(Intent):
    """Build the map on, or only find the place in it."""

    mapping: bool


# The robot


@dataclass(frozen=True, slots=True)
class UseControl(Intent):
    """A control of the Robot panel; a button's value is True."""

    control: str
    value: ControlValue


@dataclass(frozen=True, slots=True)
class UseRobot(Intent):
    """Connect to another robot instead of the present one."""

    robot: str


# Speaking


@dataclass(frozen=True, slots=True)
class Say(Intent):
    """Speak after whatever is waiting."""

    text: str
    origin: UtteranceOrigin
    person_id: str = ""
    """To whom; empty: to whom the wizard attends, or else to whoever is nearest."""


@dataclass(frozen=True, slots=True)
class Silence(Intent):
    """Interrupt speech at once and drop what is waiting."""


@dataclass(frozen=True, slots=True)
class Ask(Intent):
    """Ask the language model; the answer streams into ``state.assistant``."""

    question: str


@dataclass(frozen=True, slots=True)
class CancelAnswer(Intent):
    """Let the language model end its answer."""


@dataclass(frozen=True, slots=True)
class SayAnswer(Intent):
    """Say the language model's answer, possibly edited by the wizard."""

    text: str


# People


@dataclass(frozen=True, slots=True)
class NamePerson(Intent):
    """Give somebody a name, or take it back with an empty one. The name goes into the study's database alone."""

    person_id: str
    name: str


@dataclass(frozen=True, slots=True)
class AttendPerson(Intent):
    """What is said from now on is said to this person; empty: to whoever is nearest."""

    person_id: str


@dataclass(frozen=True, slots=True)
class ConfirmPerson(Intent):
    """Who is here is somebody known: ``is_person_id``."""

    person_id: str
    is_person_id: str


@dataclass(frozen=True, slots=True)
class RejectPerson(Intent):
    """Who is here is not ``is_person_id``, whether that was suggested or taken for granted already. Remembered."""

    person_id: str
    is_person_id: str


@dataclass(frozen=True, slots=True)
class SetPersonGroup(Intent):
    """Somebody belongs to this group, or with an empty one to none."""

    person_id: str
    group: str


@dataclass(frozen=True, slots=True)
class TagPerson(Intent):
    """Somebody has these tags and no others."""

    person_id: str
    tags: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class NotePerson(Intent):
    """What the wizard wants to remember about somebody, instead of what was noted before."""

    person_id: str
    note: str


@dataclass(frozen=True, slots=True)
class MergePeople(Intent):
    """Two who were taken for different people are one: ``into_person_id``."""

    person_id: str
    into_person_id: str


@dataclass(frozen=True, slots=True)
class SplitPerson(Intent):
    """Who is here now is somebody else: of this visit, or of the one named, nothing belongs to ``person_id``."""

    person_id: str
    visit_id: str = ""


@dataclass(frozen=True, slots=True)
class NoteConsent(Intent):
    """Somebody gave their consent, or took it back."""

    person_id: str
    kind: ConsentKind
    given: bool


@dataclass(frozen=True, slots=True)
class UndoPeople(Intent):
    """Take back the last decision about people; forgetting cannot be."""


@dataclass(frozen=True, slots=True)
class LookUpPerson(Intent):
    """Find what there was with somebody over all sessions: entries with all these words, or with none everything."""

    person_id: str
    text: str = ""


@dataclass(frozen=True, slots=True)
class ForgetPerson(Intent):
    """Erase everything that the study's database knows of somebody, and cover them in its recordings, for good."""

    person_id: str


# The session


@dataclass(frozen=True, slots=True)
class StartRecording(Intent):
    """Begin a session."""

    details: TrialDetails


@dataclass(frozen=True, slots=True)
class StopRecording(Intent):
    """End the session."""


@dataclass(frozen=True, slots=True)
class PauseRecording(Intent):
    """Record nothing for a while, or go on."""

    paused: bool


@dataclass(frozen=True, slots=True)
class UseMicrophone(Intent):
    """Record from this input, where the scenario permits; None: from none. Kept for the next time."""

    microphone: str | None


@dataclass(frozen=True, slots=True)
class TakePhoto(Intent):
    """Keep the picture on show."""


@dataclass(frozen=True, slots=True)
class TagPhoto(Intent):
    """Give a photo these tags and no others. Photos go by their file names, as in PhotoTaken."""

    file_name: str
    tags: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class DeletePhoto(Intent):
    """Take a photo away. It can be brought back until the session ends."""

    file_name: str


@dataclass(frozen=True, slots=True)
class RestorePhoto(Intent):
    """Bring a photo back that was deleted."""

    file_name: str


@dataclass(frozen=True, slots=True)
class AskAboutPhoto(Intent):
    """Ask the language model about a photo, which it gets with the question."""

    file_name: str
    question: str


@dataclass(frozen=True, slots=True)
class KeepLayout(Intent):
    """The wizard arranged the panels: for the record. ``layout`` is an arrangement as in scenario files, as JSON."""

    layout: str


@dataclass(frozen=True, slots=True)
class OpenScenario(Intent):
    """Switch the scenario; the link and a running recording stay."""

    path: Path


# Marks


def new_mark_id() -> str:
    return f"m-{secrets.token_hex(4)}"


@dataclass(frozen=True, slots=True)
class Mark(Intent):
    """Mark this moment, or one ``earlier_s`` ago."""

    label: str
    kind: MarkKind = "mark"
    earlier_s: float = 0.0
    note: str = ""
    mark_id: str = field(default_factory=new_mark_id)


@dataclass(frozen=True, slots=True)
class BeginMark(Intent):
    """Mark a stretch that begins now, or ``earlier_s`` ago, and goes on until it is ended."""

    label: str
    kind: MarkKind = "mark"
    earlier_s: float = 0.0
    mark_id: str = field(default_factory=new_mark_id)


@dataclass(frozen=True, slots=True)
class StretchMark(Intent):
    """The moment that was marked becomes a stretch, which goes on until it is ended."""

    mark_id: str


@dataclass(frozen=True, slots=True)
class EndMark(Intent):
    """The stretch ends now."""

    mark_id: str


@dataclass(frozen=True, slots=True)
class ChangeMark(Intent):
    """Change a mark of this session: another label, a note, or an earlier beginning."""

    mark_id: str
    label: str | None = None
    earlier_s: float = 0.0
    note: str | None = None


@dataclass(frozen=True, slots=True)
class WithdrawMark(Intent):
    """The mark was a slip."""

    mark_id: str


# The table

Bounds = tuple[float, float]
_SHARE: Bounds = (-1.0, 1.0)


@dataclass(frozen=True, slots=True)
class IntentSpec:
    """One line of the table.

    ``words`` say what is asked for, as the subject of a sentence ("Driving is not possible: ..."). ``permission`` is
    what the scenario must allow. ``moves``: the robot may move of it, so the emergency stop refuses it. ``needs_link``:
    it is for the robot, so nothing waits for one that is not there. ``in_replay``: a replay does it too. ``quiet``: it
    is refused so often, as while a key is held, that nobody is told each time; the window shows the reason all the
    while. ``proposable``: a language model may propose it. ``bounds`` are the least and the greatest value of numbers
    among its fields.
    """

    words: str
    permission: Permission | None = None
    moves: bool = False
    needs_link: bool = False
    in_replay: bool = False
    quiet: bool = False
    proposable: bool = False
    bounds: Mapping[str, Bounds] = field(default_factory=dict)


_MOMENT: Mapping[str, Bounds] = {"earlier_s": (0.0, 86_400.0)}

INTENTS: Mapping[type[Intent], IntentSpec] = {
    Drive: IntentSpec(
        "Driving", "driving", moves=True, needs_link=True, quiet=True,
        bounds={"forward": _SHARE, "left": _SHARE, "turn": _SHARE},
    ),
    ReleaseDrive: IntentSpec("Letting go", in_replay=True),
    SetSpeed: IntentSpec("Setting the speed", "driving", bounds={"fraction": (0.0, 1.0)}),
    Stop: IntentSpec("Stopping", in_replay=True),
    EmergencyStop: IntentSpec("Latching the emergency stop", in_replay=True),
    ReleaseEmergencyStop: IntentSpec("Releasing the emergency stop"),
    SetGuard: IntentSpec("Switching the obstacle guard off", "driving", needs_link=True),
    LookAt: IntentSpec(
        "Looking there", "driving", moves=True, needs_link=True, proposable=True,
        bounds={"pan_rad": (-math.tau, math.tau), "tilt_rad": (-math.tau, math.tau)},
    ),
    TurnHead: IntentSpec(
        "Turning the head", "driving", moves=True, needs_link=True, quiet=True, bounds={"pan": _SHARE, "tilt": _SHARE}
    ),
    Nod: IntentSpec("Nodding", "driving", moves=True, needs_link=True, proposable=True),
    GoToPlace: IntentSpec("Driving to the place", "driving", moves=True, needs_link=True, proposable=True),
    GoToPoint: IntentSpec("Driving there", "driving", moves=True, needs_link=True, proposable=True),
    CancelGoal: IntentSpec("Cancelling the goal"),
    SetInitialPose: IntentSpec("Setting the robot's position", "driving", needs_link=True),
    SavePlace: IntentSpec("Saving the place", "driving"),
    RemovePlace: IntentSpec("Removing the place", "driving"),
    SaveMap: IntentSpec("Saving the map", "driving", needs_link=True),
    LoadMap: IntentSpec("Loading the map", "driving", needs_link=True),
    SetMapping: IntentSpec("Switching mapping on or off", "driving", needs_link=True),
    # Whether it moves the robot is said of each control.
    UseControl: IntentSpec("Using the control", "robot_controls", needs_link=True, proposable=True),
    UseRobot: IntentSpec("Connecting to another robot"),
    Say: IntentSpec("Speaking", proposable=True),
    Silence: IntentSpec("Interrupting speech"),
    Ask: IntentSpec("Asking the assistant", "assistant"),
    CancelAnswer: IntentSpec("Cancelling the answer"),
    SayAnswer: IntentSpec("Saying the answer", "assistant"),
    NamePerson: IntentSpec("Naming the person", "naming_people"),
    AttendPerson: IntentSpec("Attending to the person"),
    ConfirmPerson: IntentSpec("Confirming who it is", "naming_people"),
    RejectPerson: IntentSpec("Saying who it is not", "naming_people"),
    SetPersonGroup: IntentSpec("Putting the person into a group", "naming_people"),
    TagPerson: IntentSpec("Tagging the person", "naming_people"),
    NotePerson: IntentSpec("Noting something about the person", "naming_people"),
    MergePeople: IntentSpec("Merging the two people", "naming_people"),
    SplitPerson: IntentSpec("Splitting the person", "naming_people"),
    # What a person agrees to, and that they are forgotten, is theirs to decide in every scenario.
    NoteConsent: IntentSpec("Noting the consent"),
    UndoPeople: IntentSpec("Undoing the last decision about people"),
    LookUpPerson: IntentSpec("Looking the person up", "naming_people", quiet=True),
    ForgetPerson: IntentSpec("Forgetting the person"),
    StartRecording: IntentSpec("Starting a recording"),
    StopRecording: IntentSpec("Ending the recording"),
    PauseRecording: IntentSpec("Pausing the recording"),
    UseMicrophone: IntentSpec("Choosing a microphone"),
    TakePhoto: IntentSpec("Taking a photo", "photos", proposable=True),
    TagPhoto: IntentSpec("Tagging the photo", "photos"),
    DeletePhoto: IntentSpec("Deleting the photo", "photos"),
    RestorePhoto: IntentSpec("Bringing the photo back", "photos"),
    AskAboutPhoto: IntentSpec("Asking about the photo", "assistant"),
    KeepLayout: IntentSpec("Keeping the arrangement of the panels", quiet=True),
    OpenScenario: IntentSpec("Opening another scenario"),
    Mark: IntentSpec("Marking the moment", bounds=_MOMENT),
    BeginMark: IntentSpec("Marking a stretch", bounds=_MOMENT),
    StretchMark: IntentSpec("Making a stretch of the mark"),
    EndMark: IntentSpec("Ending the mark", quiet=True),
    ChangeMark: IntentSpec("Changing the mark", bounds=_MOMENT),
    WithdrawMark: IntentSpec("Taking the mark back"),
}  # fmt: skip
