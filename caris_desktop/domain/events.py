"""Discrete things that happen in a session. All of them are recorded, none may be lost.

``stamp_ns`` is the session clock. People appear as opaque ``person_id``; names live only in the study's database.
``actor`` is who asked for what the event tells of; what merely happens, such as somebody's coming, has none.

Long because every kind of event is declared here, and nowhere else.
"""

from dataclasses import dataclass
from typing import Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.controls import ControlValue
from caris_desktop.domain.geometry import Pose2D, Twist2D

LinkState = Literal["connecting", "connected", "trouble", "lost", "closed"]
CommandSource = Literal["keyboard", "gamepad", "onscreen", "rehearsal", "stop", "lease", "none"]
GoalState = Literal["requested", "active", "reached", "cancelled", "failed"]
Speaker = Literal["robot", "participant", "wizard"]
UtteranceOrigin = Literal["typed", "phrase", "filler", "assistant", "suggestion", "heard"]
UtteranceState = Literal["requested", "started", "finished", "interrupted", "failed"]
LlmOutcome = Literal["answered", "cancelled", "failed"]
Severity = Literal["info", "warning", "error"]
ProblemEnd = Literal["", "connected", "released", "picture", "recording", "voice", "assistant", "people", "microphone"]
"""What shows that a problem is over: the robot is connected, its emergency stop released, a picture comes, another
recording runs, ... Empty where nothing shows it."""
GuardState = Literal["absent", "clear", "slowing", "blocked", "blind", "overridden"]
MarkKind = Literal["mark", "wizard_error", "note"]
MarkState = Literal["done", "open", "withdrawn"]
MapOperation = Literal["save", "load", "start_mapping", "start_localization"]
RequestState = Literal["requested", "succeeded", "failed"]
IdentifiedBy = Literal["wizard", "console"]
ConsentKind = Literal["face", "photo", "video", "sound"]
PersonDetail = Literal["group", "tags", "note"]
PeopleDecision = Literal["named", "group", "tags", "note", "identified", "rejected", "merged", "split", "consent"]


@dataclass(frozen=True, slots=True)
class LinkChanged:
    """The robot link changed its state; ``detail`` says why, in words for the wizard."""

    stamp_ns: int
    link: str
    state: LinkState
    address: str
    detail: str = ""


@dataclass(frozen=True, slots=True)
class LinkQuality:
    """Measured by ping: round trip time, and robot clock minus session clock with its uncertainty."""

    stamp_ns: int
    round_trip_ms: float
    clock_offset_ms: float | None = None
    clock_uncertainty_ms: float | None = None


@dataclass(frozen=True, slots=True)
class CommandSent:
    """One velocity command that was handed to the socket, exactly as sent. ``actor`` held it, let go, or stopped."""

    stamp_ns: int
    sequence: int
    twist: Twist2D
    source: CommandSource
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class DriveEnded:
    """Direct driving ended by itself rather than by the wizard letting go, or as ``actor`` set a goal."""

    stamp_ns: int
    reason: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class StopRequested:
    """The wizard pressed stop."""

    stamp_ns: int
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class EmergencyStopChanged:
    """The latched emergency stop was set or cleared. ``by`` is wizard or robot."""

    stamp_ns: int
    latched: bool
    by: Literal["wizard", "robot"]
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class GoalChanged:
    """A navigation goal changed its state. ``actor`` set it, and where it is cancelled, cancelled it."""

    stamp_ns: int
    goal_id: str
    state: GoalState
    target_in_map: Pose2D
    place: str | None = None
    distance_left_m: float | None = None
    detail: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class NavigationSpeedChanged:
    """What the robot's navigation keeps to on its way to goals; None: it drives as fast as it is set up to."""

    stamp_ns: int
    limit_mps: float | None
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class GuardChanged:
    """The obstacle guard limits motion differently from now on.

    ``absent``: the profile names no LIDAR; ``blind``: no fresh scan, so the speed is capped; ``overridden``: the
    wizard switched it off. ``distance_m`` is the free way between footprint and obstacle in the direction of motion.
    ``detail`` says in words why it is blind. ``actor`` is who switched it, else the console.
    """

    stamp_ns: int
    state: GuardState
    distance_m: float | None = None
    detail: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class InitialPoseSet:
    """The wizard told the localization where the robot is."""

    stamp_ns: int
    pose_in_map: Pose2D
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class MapRequestChanged:
    """A map was to be saved or loaded, or mapping to be switched. The same ``request_id`` returns with each state."""

    stamp_ns: int
    request_id: str
    operation: MapOperation
    name: str
    state: RequestState
    detail: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class MappingChanged:
    """Whether the robot builds its map (True) or only finds its place in it; None: it does not tell.

    Comes with each connection too, and says which operations the robot offers.
    """

    stamp_ns: int
    mapping: bool | None
    can_save: bool = False
    can_load: bool = False
    can_switch: bool = False


@dataclass(frozen=True, slots=True)
class PlacesChanged:
    """A named place was added to the scenario, moved, or removed (``pose_in_map`` None)."""

    stamp_ns: int
    name: str
    pose_in_map: Pose2D | None
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class HeadMoved:
    """The wizard turned the head: where it was asked to look, pan left and tilt down positive."""

    stamp_ns: int
    pan_rad: float
    tilt_rad: float
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class ControlUsed:
    """A control of the Robot panel was used. The same ``request_id`` returns with each state."""

    stamp_ns: int
    request_id: str
    control: str
    value: ControlValue
    state: RequestState
    detail: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class TopicTraffic:
    """How one topic fared in the last second. ``age_ms`` is how old its newest message was on arrival by the robot's
    own stamp and the estimated clock offset; None where it carries no stamp. ``encoding`` is empty while nothing came.
    """

    topic: str
    type: str
    rate_hz: float
    bytes_per_s: float
    last_heard_s: float | None
    age_ms: float | None
    refused: int
    encoding: Literal["", "cbor", "json"] = ""


@dataclass(frozen=True, slots=True)
class TrafficMeasured:
    """The topics of one link, once a second. ``refused`` counts all messages that could not be used so far."""

    stamp_ns: int
    link: str
    encoding: Literal["cbor", "json", "both"]
    refused: int
    topics: tuple[TopicTraffic, ...]


@dataclass(frozen=True, slots=True)
class GamepadChanged:
    """A gamepad was plugged in or out; ``device`` is its hardware id."""

    stamp_ns: int
    device: str
    name: str
    connected: bool


@dataclass(frozen=True, slots=True)
class UtteranceChanged:
    """Something is said. The same ``utterance_id`` returns with each new state.

    ``actor`` had the robot say it, and where it is interrupted, silenced it. ``person_id`` is to whom it is said, or
    who says it; empty where that is not known.
    """

    stamp_ns: int
    utterance_id: str
    speaker: Speaker
    text: str
    origin: UtteranceOrigin
    state: UtteranceState
    voice: str = ""
    detail: str = ""
    actor: Actor = ""
    person_id: str = ""


@dataclass(frozen=True, slots=True)
class ChatMessage:
    """One message of a prompt to a language model."""

    role: Literal["system", "user", "assistant"]
    content: str


@dataclass(frozen=True, slots=True)
class LlmExchange:
    """One finished exchange with a language model.

    ``server`` is the host that was asked, with its port and without credentials; ``seed`` what its choice of words
    began with, None where the server was not told one. ``actor`` asked the question. ``photo`` is the file name of the
    picture that went with it, as in PhotoTaken.
    """

    stamp_ns: int
    exchange_id: str
    provider: str
    model: str
    messages: tuple[ChatMessage, ...]
    answer: str
    outcome: LlmOutcome
    asked_ns: int
    first_token_ns: int | None
    parameters: dict[str, float | int | str]
    detail: str = ""
    model_version: str = ""
    server: str = ""
    seed: int | None = None
    actor: Actor = ""
    photo: str = ""


@dataclass(frozen=True, slots=True)
class AnswerUsed:
    """What was done with a language model's answer. ``utterance_id`` is as what the robot was to say it."""

    stamp_ns: int
    exchange_id: str
    use: Literal["said", "edited", "dismissed"]
    text: str
    utterance_id: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonAppeared:
    """A track became a person for the wizard; ``number`` is that of "Person 3", 0 where it is not known."""

    stamp_ns: int
    person_id: str
    track: int
    number: int = 0


@dataclass(frozen=True, slots=True)
class PersonLeft:
    """A person has not been seen for a while."""

    stamp_ns: int
    person_id: str
    track: int


@dataclass(frozen=True, slots=True)
class PersonRenamed:
    """The wizard named a person. The name itself is only in the study's database."""

    stamp_ns: int
    person_id: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonSuggested:
    """Who is here looks like somebody known; nothing is decided. ``confidence`` is how often such a look is right.

    ``runner_up_id`` is who comes next, empty where nobody does. ``kind`` is what told: clothing or face.
    """

    stamp_ns: int
    person_id: str
    is_person_id: str
    confidence: float
    runner_up_id: str = ""
    runner_up: float = 0.0
    kind: str = ""


@dataclass(frozen=True, slots=True)
class PersonIdentified:
    """Who was ``person_id`` so far in this visit is ``is_person_id``, whose id rows and boxes bear from now on.

    ``runner_up`` is the confidence of whom it was next likely to be. ``actor`` confirmed it; the console, where it was
    sure by itself.
    """

    stamp_ns: int
    person_id: str
    is_person_id: str
    by: IdentifiedBy
    confidence: float
    runner_up: float = 0.0
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonRejected:
    """Who is here is not ``is_person_id``. Where that was taken for granted, the visit is ``person_id``'s again."""

    stamp_ns: int
    person_id: str
    is_person_id: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonDescribed:
    """A person's group, tags or note changed. What they are now is only in the study's database."""

    stamp_ns: int
    person_id: str
    detail: PersonDetail
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PeopleMerged:
    """``person_id`` is ``into_person_id`` from now on, in the past too."""

    stamp_ns: int
    person_id: str
    into_person_id: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonSplit:
    """A visit that was ``from_person_id``'s belongs to ``person_id``."""

    stamp_ns: int
    person_id: str
    from_person_id: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class ConsentNoted:
    """A person gave consent of this kind, or took it back."""

    stamp_ns: int
    person_id: str
    kind: ConsentKind
    given: bool
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonAttended:
    """Whom the wizard deals with from now on; empty: whoever is nearest."""

    stamp_ns: int
    person_id: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PeopleUndone:
    """The last decision about people was taken back: ``person_id`` is as before it."""

    stamp_ns: int
    person_id: str
    decision: PeopleDecision
    is_person_id: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonForgotten:
    """Everything that the study's database knew of a person was erased."""

    stamp_ns: int
    person_id: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PhotoTaken:
    """``file_name`` is relative to the session folder, and without a recording to the study's.

    ``person_id`` is whom the wizard attended to, or who was nearest; empty where nobody was. ``person_ids`` are all who
    were seen then, ``pose_in_map`` is where the robot was, None where that was not known.
    """

    stamp_ns: int
    camera: str
    frame_sequence: int
    file_name: str
    actor: Actor = ""
    person_id: str = ""
    person_ids: tuple[str, ...] = ()
    pose_in_map: Pose2D | None = None


@dataclass(frozen=True, slots=True)
class PhotoTagged:
    """From now on a photo has these tags and no others."""

    stamp_ns: int
    file_name: str
    tags: tuple[str, ...]
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PhotoDeleted:
    """A photo was taken out of the folder, or brought back (``restored``), which can be done until the session ends."""

    stamp_ns: int
    file_name: str
    restored: bool = False
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class Marked:
    """The wizard marked a moment, or a stretch of the session.

    The same ``mark_id`` returns whenever the mark changes: a stretch ends, the moment was a little earlier, a note is
    added. The newest one counts. ``start_ns`` is the moment meant (None: ``stamp_ns``), ``end_ns`` where a stretch
    ends. ``state`` is open while a stretch goes on, and withdrawn for a mark that was a slip itself.
    """

    stamp_ns: int
    label: str
    kind: MarkKind = "mark"
    mark_id: str = ""
    start_ns: int | None = None
    end_ns: int | None = None
    state: MarkState = "done"
    note: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class RecordingPaused:
    """The wizard paused the recording, or went on with it. In between nothing is recorded."""

    stamp_ns: int
    paused: bool
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class ScenarioOpened:
    """A scenario became the current one. ``content`` is the text of its file."""

    stamp_ns: int
    file_name: str
    title: str
    sha256: str
    content: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class RobotChosen:
    """The console connects to this robot from now on. ``profile`` is its profile as the text of a profile file."""

    stamp_ns: int
    name: str
    title: str
    address: str
    profile: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class LayoutChanged:
    """The wizard arranged the panels. ``layout`` is the tree of splits and tabs as in a scenario file, as JSON."""

    stamp_ns: int
    layout: str
    actor: Actor = ""


OVERTAKEN = "more came at once than could be taken"
"""The reason of a gap that the link leaves where newer values replace older ones."""


@dataclass(frozen=True, slots=True)
class Gap:
    """Values of ``stream`` that were not recorded."""

    stamp_ns: int
    stream: str
    count: int
    reason: str


@dataclass(frozen=True, slots=True)
class Problem:
    """Something went wrong: what happened, what it means for the session, what to do. ``until`` says what ends it."""

    stamp_ns: int
    severity: Severity
    what: str
    meaning: str
    advice: str
    until: ProblemEnd = ""


@dataclass(frozen=True, slots=True)
class SessionStarted:
    """Recording began. ``folder`` is the session folder's name, not its path."""

    stamp_ns: int
    folder: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class SessionEnded:
    """Recording ended; ``reason`` is wizard, console_closed, disk_full, disk_failed or recovered."""

    stamp_ns: int
    folder: str
    reason: str
    actor: Actor = ""


Event = (
    LinkChanged
    | LinkQuality
    | CommandSent
    | DriveEnded
    | StopRequested
    | EmergencyStopChanged
    | GoalChanged
    | NavigationSpeedChanged
    | GuardChanged
    | InitialPoseSet
    | MapRequestChanged
    | MappingChanged
    | PlacesChanged
    | HeadMoved
    | ControlUsed
    | TrafficMeasured
    | GamepadChanged
    | UtteranceChanged
    | LlmExchange
    | AnswerUsed
    | PersonAppeared
    | PersonLeft
    | PersonRenamed
    | PersonSuggested
    | PersonIdentified
    | PersonRejected
    | PersonDescribed
    | PeopleMerged
    | PersonSplit
    | ConsentNoted
    | PersonAttended
    | PeopleUndone
    | PersonForgotten
    | PhotoTaken
    | PhotoTagged
    | PhotoDeleted
    | Marked
    | RecordingPaused
    | ScenarioOpened
    | RobotChosen
    | LayoutChanged
    | Gap
    | Problem
    | SessionStarted
    | SessionEnded
)
