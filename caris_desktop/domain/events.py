"""Discrete events of a session. All are recorded, none may be lost.

People appear as opaque ``person_id``; names are only in the study's database.
``actor`` requested what the event reports; events without a request, such as an arrival, have none.

"""

from typing import Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.control_definitions import ControlValue
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.value_class import Value


class Event(Value, eq=False):
    """Base class of events. ``stamp_ns`` is the session clock."""

    stamp_ns: int


# Events of the robot and its link.
LinkState = Literal["connecting", "connected", "trouble", "lost", "closed"]
CommandSource = Literal["keyboard", "gamepad", "onscreen", "rehearsal", "stop", "lease", "none"]
GoalState = Literal["requested", "active", "reached", "cancelled", "failed"]
GuardState = Literal["absent", "clear", "slowing", "blocked", "blind", "overridden"]
MovementState = Literal[
    "unknown", "silent", "standing", "moving", "not_following", "uncommanded", "commanded_elsewhere"
]
MapOperation = Literal["save", "load", "start_mapping", "start_localization"]
RequestState = Literal["requested", "succeeded", "failed"]


class TopicTraffic(Value):
    """Traffic of one topic in the last second. ``age_ms`` is the age of its newest message on arrival, from the robot's
    timestamp and the estimated clock offset; None without a timestamp. ``encoding`` is empty before the first message.
    """

    topic: str
    type: str
    rate_hz: float
    bytes_per_s: float
    last_heard_s: float | None
    age_ms: float | None
    refused: int
    encoding: Literal["", "cbor", "json"] = ""


class LinkChanged(Event):
    """The robot link changed state; ``detail`` gives the reason in words."""

    link: str
    state: LinkState
    address: str
    detail: str = ""


class LinkQuality(Event):
    """Ping result: round trip time, and robot clock minus session clock with its uncertainty."""

    round_trip_ms: float
    clock_offset_ms: float | None = None
    clock_uncertainty_ms: float | None = None


class CommandSent(Event):
    """One velocity command exactly as handed to the socket. ``actor`` held or released it, or stopped."""

    sequence: int
    twist: Twist2D
    source: CommandSource
    actor: Actor = ""


class DriveEnded(Event):
    """Manual driving ended without a release by the wizard, or because ``actor`` set a goal.

    ``drive_id`` is the id of the drive that ended; 0 in recordings before drives had ids.
    """

    reason: str
    actor: Actor = ""
    drive_id: int = 0


class StopRequested(Event):
    """The wizard pressed stop."""

    actor: Actor = ""


class EmergencyStopChanged(Event):
    """The latched emergency stop was set or cleared. ``by`` is wizard or robot."""

    latched: bool
    by: Literal["wizard", "robot"]
    actor: Actor = ""


class GoalChanged(Event):
    """A navigation goal changed state. ``actor`` set it, or cancelled it if it is cancelled."""

    goal_id: str
    state: GoalState
    target_in_map: Pose2D
    place: str | None = None
    distance_left_m: float | None = None
    detail: str = ""
    actor: Actor = ""


class NavigationSpeedChanged(Event):
    """Speed limit of the robot's navigation to goals; None: as configured on the robot."""

    limit_mps: float | None
    actor: Actor = ""


class GuardChanged(Event):
    """The obstacle guard changed its limits on motion.

    ``absent``: the profile names no LIDAR. ``blind``: no fresh scan, so the speed is capped; ``detail`` gives the
    reason. ``overridden``: the wizard turned it off. ``distance_m`` is the clearance between footprint and obstacle in
    the direction of motion. ``actor`` turned it on or off, else the console.
    """

    state: GuardState
    distance_m: float | None = None
    detail: str = ""
    actor: Actor = ""


class MovementChanged(Event):
    """The agreement of the robot's odometry with this console's commands changed.

    ``unknown``: no odometry, or none yet. ``silent``: odometry no longer arrives. ``standing``: at rest. ``moving``: as
    commanded from here. ``not_following``: not as commanded. ``uncommanded``: moving without a command from here.
    ``commanded_elsewhere``: another source sends velocities. ``stopped``: under a stop or the emergency stop.
    ``publishers`` are the nodes that publish velocities, if the robot reports them.
    """

    state: MovementState
    stopped: bool = False
    publishers: tuple[str, ...] = ()


class InitialPoseSet(Event):
    """The wizard set the robot's pose for localization."""

    pose_in_map: Pose2D
    actor: Actor = ""


class MapRequestChanged(Event):
    """State of a request to save or load a map, or switch mapping. ``request_id`` is the same in each state."""

    request_id: str
    operation: MapOperation
    name: str
    state: RequestState
    detail: str = ""
    actor: Actor = ""


class MappingChanged(Event):
    """Mapping state: the robot builds its map (True) or only localizes in it; None: not reported.

    Also sent with each connection; includes the operations that the robot offers.
    """

    mapping: bool | None
    can_save: bool = False
    can_load: bool = False
    can_switch: bool = False


class PlacesChanged(Event):
    """A named place was added to the scenario, moved, or removed (``pose_in_map`` None)."""

    name: str
    pose_in_map: Pose2D | None
    actor: Actor = ""


class HeadMoved(Event):
    """The wizard turned the head to these angles, pan left and tilt down positive."""

    pan_rad: float
    tilt_rad: float
    actor: Actor = ""


class ControlUsed(Event):
    """A control of the Robot panel was used. The same ``request_id`` returns with each state."""

    request_id: str
    control: str
    value: ControlValue
    state: RequestState
    detail: str = ""
    actor: Actor = ""


class TrafficMeasured(Event):
    """The topics of one link, once a second. ``refused`` counts all unusable messages so far."""

    link: str
    encoding: Literal["cbor", "json", "both"]
    refused: int
    topics: tuple[TopicTraffic, ...]


class GamepadChanged(Event):
    """A gamepad was connected or removed; ``device`` is its hardware id."""

    device: str
    name: str
    connected: bool


# Events of the conversation and of the language model.
Speaker = Literal["robot", "participant", "wizard"]
UtteranceOrigin = Literal[
    "typed", "phrase", "filler", "assistant", "suggestion", "heard", "dictated", "own_voice"
]  # fmt: skip
UtteranceState = Literal["requested", "started", "finished", "interrupted", "failed"]
UTTERANCE_ENDS: tuple[UtteranceState, ...] = ("finished", "interrupted", "failed")
"""Final states of an utterance, the best outcome first."""
LlmOutcome = Literal["answered", "cancelled", "failed"]
ReplyMeans = Literal[
    "typed", "phrase", "suggestion", "edited_suggestion", "filler", "assistant", "own_voice", "dictated"
]
SuggestionState = Literal["displayed", "taken", "edited", "dismissed", "superseded", "expired"]
ProposalState = Literal["displayed", "counting", "confirmed", "vetoed", "lapsed", "refused"]
AssistedFunction = Literal["replies", "fillers", "actions"]
AssistanceLevel = Literal["off", "suggest", "act"]
VoiceOutput = Literal["robot", "computer", "both"]


class ChatMessage(Value):
    """One message of a prompt to a language model."""

    role: Literal["system", "user", "assistant"]
    content: str


class UtteranceChanged(Event):
    """State of an utterance. The same ``utterance_id`` returns with each new state.

    ``actor`` requested the utterance or, if it is interrupted, silenced it. ``person_id`` is the person addressed, or
    the speaker; empty if unknown. ``{p-...}`` in ``text`` replaces the name of the person with that id. ``source`` is
    the microphone that picked it up. ``estimated``: the time is an estimate. ``confidence`` (0 to 1) and ``language``
    come from the speech recogniser. ``gesture`` accompanies the utterance.
    """

    utterance_id: str
    speaker: Speaker
    text: str
    origin: UtteranceOrigin
    state: UtteranceState
    voice: str = ""
    detail: str = ""
    actor: Actor = ""
    person_id: str = ""
    source: str = ""
    estimated: bool = False
    confidence: float | None = None
    language: str = ""
    gesture: str = ""


class LlmExchange(Event):
    """One finished exchange with a language model.

    ``server`` is its host and port, without credentials. ``seed`` is the random seed, None if none was sent. ``actor``
    asked the question. ``photo`` is the file name of the attached image, as in PhotoTaken, or ``camera NAME`` for its
    frame at that time. Several are separated by commas. ``purpose``: the wizard's question, suggested replies or
    proposed actions. ``turn_id`` and ``revision`` identify the turn that it refers to. ``cut``: the answer is
    incomplete because of its length limit or the server's filter; ``detail`` says so in words. ``parameters`` are those
    that the server accepted.
    """

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
    purpose: Literal["question", "replies", "actions"] = "question"
    turn_id: str = ""
    revision: int = 0
    cut: Literal["", "length", "filter"] = ""


class AnswerUsed(Event):
    """Use of a language model's answer. ``utterance_id`` is the robot's utterance made from it."""

    exchange_id: str
    use: Literal["said", "edited", "dismissed"]
    text: str
    utterance_id: str = ""
    actor: Actor = ""


class UtteranceCorrected(Event):
    """Correction of an utterance: its text, speaker, person, tags or times. None: not changed.

    ``speaker`` and ``person_id`` may be empty for "not sure". ``person_confidence`` is the likelihood of that person, 0
    to 1, if the console identified the speaker. ``start_ns`` and ``end_ns`` are the start and end of the voice in the
    samples of a microphone.
    """

    utterance_id: str
    text: str | None = None
    speaker: Literal["", "robot", "participant", "wizard"] | None = None
    person_id: str | None = None
    tags: tuple[str, ...] | None = None
    actor: Actor = ""
    person_confidence: float | None = None
    start_ns: int | None = None
    end_ns: int | None = None


RESPONSE_LIMIT_S = 30.0
"""Speech of the robot that starts later than this after a participant is no response."""


class ResponseTimed(Event):
    """Times of the robot's response to a turn of the participant, on the session clock; None: did not occur.

    ``turn_id`` and ``reply_id`` are the utterances. ``voice_ended_ns``: acoustic end of the turn, later than the first
    sound if the robot spoke over it. ``text_ns``: final transcript. ``suggested_ns``: suggestions shown. ``asked_ns``:
    key pressed by the wizard. ``first_sound_ns``: first sound of the robot.
    """

    turn_id: str
    reply_id: str
    means: ReplyMeans
    voice_ended_ns: int
    text_ns: int | None = None
    suggested_ns: int | None = None
    asked_ns: int | None = None
    first_sound_ns: int | None = None
    person_id: str = ""


class SuggestionChanged(Event):
    """A suggested reply was shown, or its outcome is known. The same ``suggestion_id`` returns once.

    ``turn_id`` and ``revision`` identify the turn. ``rank`` is its position and the number of its key (1 to 3).
    ``latency_ms`` is from the end of the participant's voice until it was shown. ``edit_distance`` counts the
    characters that the wizard changed. ``utterance_id`` is what was said of it.
    """

    suggestion_id: str
    state: SuggestionState
    turn_id: str
    revision: int
    rank: int
    text: str
    model: str
    latency_ms: float | None = None
    edit_distance: int | None = None
    utterance_id: str = ""
    actor: Actor = ""


class ProposalChanged(Event):
    """State of an action that a language model proposed.

    ``intent`` is its type name in the table of intents, ``arguments`` its fields. ``refused``: by the gate, or because
    it was outside the list or the bounds; ``detail`` gives the reason.
    """

    proposal_id: str
    state: ProposalState
    turn_id: str
    revision: int
    intent: str
    arguments: dict[str, float | str | bool]
    model: str
    detail: str = ""
    actor: Actor = ""


class LevelChanged(Event):
    """Degree of automation of the language model."""

    function: AssistedFunction
    level: AssistanceLevel
    actor: Actor = ""


class VoiceChanged(Event):
    """Speech output changed: who speaks, and this computer's voice, rate and volume as in the scenario file."""

    output: VoiceOutput
    name: str = ""
    language: str = ""
    rate: float = 1.0
    volume: float = 1.0
    actor: Actor = ""


class AssistantChanged(Event):
    """The assistant's settings changed: model, role, style, a prompt or the notes.

    ``name`` is the selection, or names the changed text; ``text`` is the new one. ``reset``: all is as in the scenario.
    """

    setting: Literal["model", "role", "style", "system_prompt", "notes", "reset"]
    name: str = ""
    text: str = ""
    actor: Actor = ""


class FaceChanged(Event):
    """The robot's face changed, on ``screens`` windows and pages.

    ``image`` is the file name of an image, ``live`` whether the robot's camera image is shown.
    """

    expression: str
    text: str = ""
    image: str = ""
    live: bool = False
    screens: int = 0
    actor: Actor = ""


# Events of people: appearance, identification, consent.
IdentifiedBy = Literal["wizard", "console"]
ConsentKind = Literal["face", "photo", "video", "sound"]
PersonDetail = Literal["group", "tags", "note"]
PeopleDecision = Literal["named", "group", "tags", "note", "identified", "rejected", "merged", "split", "consent"]


class PersonAppeared(Event):
    """A track was confirmed as a person; ``number`` is that of "Person 3", 0 if unknown."""

    person_id: str
    track: int
    number: int = 0


class PersonLeft(Event):
    """A person counts as gone. ``last_seen_ns`` is the last detection; None in old recordings."""

    person_id: str
    track: int
    last_seen_ns: int | None = None


class PersonRenamed(Event):
    """The wizard named a person. The name itself is only in the study's database."""

    person_id: str
    actor: Actor = ""


class PersonSuggested(Event):
    """A person resembles a known one; nothing is decided. ``confidence`` is how often such a match is right.

    ``runner_up_id`` is the next best match, empty if none. ``kind`` is the evidence: clothing or face.
    """

    person_id: str
    is_person_id: str
    confidence: float
    runner_up_id: str = ""
    runner_up: float = 0.0
    kind: str = ""


class PersonIdentified(Event):
    """``person_id`` of this visit was identified as ``is_person_id``, the id in rows and boxes from now on.

    ``runner_up`` is the confidence of the next best match. ``actor`` confirmed it; the console if it was certain.
    """

    person_id: str
    is_person_id: str
    by: IdentifiedBy
    confidence: float
    runner_up: float = 0.0
    actor: Actor = ""


class PersonRejected(Event):
    """A person is not ``is_person_id``. If already identified as such, the visit is ``person_id``'s again."""

    person_id: str
    is_person_id: str
    actor: Actor = ""


class PersonDescribed(Event):
    """A person's group, tags or note changed. The new values are only in the study's database."""

    person_id: str
    detail: PersonDetail
    actor: Actor = ""


class PeopleMerged(Event):
    """``person_id`` was merged into ``into_person_id``, in the past too."""

    person_id: str
    into_person_id: str
    actor: Actor = ""


class PersonSplit(Event):
    """A visit was moved from ``from_person_id`` to ``person_id``."""

    person_id: str
    from_person_id: str
    actor: Actor = ""


class ConsentNoted(Event):
    """A person gave or withdrew consent of this kind."""

    person_id: str
    kind: ConsentKind
    given: bool
    actor: Actor = ""


class PersonAttended(Event):
    """Person that the wizard attends to from now on; empty: the nearest."""

    person_id: str
    actor: Actor = ""


class PeopleUndone(Event):
    """The last decision about people was undone: ``person_id`` is as before."""

    person_id: str
    decision: PeopleDecision
    is_person_id: str = ""
    actor: Actor = ""


class PersonForgotten(Event):
    """All data about a person were erased from the study's database."""

    person_id: str
    actor: Actor = ""


# Events of the session: recording, photos, marks, the steps of the protocol, problems and alarms.
Severity = Literal["info", "warning", "error"]
ProblemEnd = Literal[
    "",
    "connected",
    "released",
    "picture",
    "recording",
    "voice",
    "utterance",
    "assistant",
    "people",
    "microphone",
    "transcription",
    "own_microphone",
    "pose",
    "quiet",
]
"""Evidence that a problem is over: the robot is connected, its emergency stop released, a frame arrives, another
recording runs, ... ``quiet``: it is reported again while it lasts. Empty if nothing shows it."""
ANSWER = "answer"
"""Cause of a problem that answers a request: it was not carried out, without lasting effect."""
AlarmState = Literal["raised", "ended"]
MarkKind = Literal["mark", "wizard_error", "note"]
MarkState = Literal["done", "open", "withdrawn"]
OVERTAKEN = "more came at once than could be taken"
"""Reason of a gap that the link leaves when newer values replace older ones."""
LOST_ON_THE_WAY = "lost between the robot's sensor and this computer"
"""Reason of a gap that shows in the robot's timestamps alone."""
LATE_FROM_S = 1.0
"""Least overrun of a late step; a shorter one counts as in time."""
StepHow = Literal["started", "next", "skipped", "back", "branch", "chosen"]
"""How a step was entered: as the first or the next, after skipping one, back from another, by a branch, or from the
list."""


class PlannedStep(Value):
    """A step of the scenario. ``expected_s`` is zero if no time is expected; ``tick`` is its checklist."""

    step_id: str
    title: str
    expected_s: float = 0.0
    tick: tuple[str, ...] = ()


PreflightState = Literal["not checked", "pending", "minor", "major", "passed"]
"""``pending``: in progress. ``minor``: a recording lacks something. ``major``: it should not start."""


class PhotoTaken(Event):
    """A photo. ``file_name`` is relative to the session folder, or to the study's without a recording.

    ``person_id`` is the person attended to, or the nearest; empty if none. ``person_ids`` are all people detected then.
    ``pose_in_map`` is the pose of the robot; None if unknown.
    """

    camera: str
    frame_sequence: int
    file_name: str
    actor: Actor = ""
    person_id: str = ""
    person_ids: tuple[str, ...] = ()
    pose_in_map: Pose2D | None = None


class PhotoTagged(Event):
    """New tags of a photo; they replace all earlier ones."""

    file_name: str
    tags: tuple[str, ...]
    actor: Actor = ""


class PhotoDeleted(Event):
    """A photo was deleted, or ``restored``, which is possible until the session ends."""

    file_name: str
    restored: bool = False
    actor: Actor = ""


class Marked(Event):
    """The wizard marked a moment or an interval of the session.

    The same ``mark_id`` returns whenever the mark changes: an interval ends, the moment is moved back, a note is added.
    The newest one counts. ``start_ns`` is the moment meant (None: ``stamp_ns``), ``end_ns`` the end of an interval.
    ``state`` is open during an interval, and withdrawn for a mark made by mistake.
    """

    label: str
    kind: MarkKind = "mark"
    mark_id: str = ""
    start_ns: int | None = None
    end_ns: int | None = None
    state: MarkState = "done"
    note: str = ""
    actor: Actor = ""

    @property
    def moment_ns(self) -> int:
        """Moment meant."""
        return self.stamp_ns if self.start_ns is None else self.start_ns


class ProtocolOpened(Event):
    """A protocol is in force from now on; without steps: none."""

    steps: tuple[PlannedStep, ...] = ()


class StepEntered(Event):
    """A step started. ``left_step_id`` is the step before, skipped if ``how`` says so; empty if there was none.
    ``branch`` is what the participant did, if a branch led here.
    """

    step_id: str
    title: str = ""
    number: int = 0
    how: StepHow = "next"
    left_step_id: str = ""
    branch: str = ""
    actor: Actor = ""


class StepTicked(Event):
    """A checklist item of a step was ticked off, or unticked (not ``on``)."""

    step_id: str
    item: str
    on: bool = True
    actor: Actor = ""


class ProtocolEnded(Event):
    """The wizard finished the last step, or ``skipped`` it."""

    left_step_id: str
    skipped: bool = False
    actor: Actor = ""


class RecordingPaused(Event):
    """The wizard paused or resumed the recording. Nothing is recorded in between."""

    paused: bool
    actor: Actor = ""


class PreflightChecked(Event):
    """State of one check. A recording starts with all of them (``at_start``); manual ticks may follow.

    ``checked_ns`` is when ``actor`` ticked a ``manual`` check, possibly before the recording; None if not ticked.
    ``accepted``: the wizard was asked about it and started anyway.
    """

    check_id: str
    title: str
    state: PreflightState
    detail: str = ""
    manual: bool = False
    at_start: bool = False
    accepted: bool = False
    checked_ns: int | None = None
    actor: Actor = ""


class ScenarioOpened(Event):
    """A scenario was opened. ``content`` is the text of its file."""

    file_name: str
    title: str
    sha256: str
    content: str = ""
    actor: Actor = ""


class RobotChosen(Event):
    """The console connects to this robot from now on. ``profile`` is its profile as the text of a profile file."""

    name: str
    title: str
    address: str
    profile: str = ""
    actor: Actor = ""


class LayoutChanged(Event):
    """The panel layout changed. ``layout`` is the tree of splits and tabs as in a scenario file, as JSON."""

    layout: str
    actor: Actor = ""


class Gap(Event):
    """Values of ``stream`` that were not recorded."""

    stream: str
    count: int
    reason: str


class Problem(Event):
    """A problem: what happened, what it means for the session, what to do. ``until`` says what ends it.

    ``info`` requires no action. Problems of one ``cause`` are one alarm; if empty, of one ``until`` or ``what``. The
    cause ``answer`` raises no alarm.
    """

    severity: Severity
    what: str
    meaning: str
    advice: str
    until: ProblemEnd = ""
    cause: str = ""


class AlarmChanged(Event):
    """An alarm was raised, or ended: automatically by the console, or resolved by ``actor``.

    An alarm that returns soon after its end is the same one; ``times`` counts how often it was raised. ``told``: a
    Problem reported it before. Alarms active when a recording starts are raised there again with their id.
    """

    alarm_id: str
    cause: str
    state: AlarmState
    severity: Severity
    what: str
    meaning: str
    advice: str
    times: int = 1
    told: bool = True
    actor: Actor = ""


class SessionStarted(Event):
    """Recording started. ``folder`` is the session folder's name, not its path."""

    folder: str
    actor: Actor = ""


class SessionEnded(Event):
    """Recording ended; ``reason`` is wizard, console_closed, disk_full, disk_failed or recovered."""

    folder: str
    reason: str
    actor: Actor = ""


class TrialResumed(Event):
    """A trial continues after the program ended during its recording. ``folder`` is that session's folder name."""

    folder: str
    actor: Actor = ""


class ConfirmedAsBefore(Event):
    """Confirmation by a person: the ``map`` shows where the robot is; the ``people`` are who the list says; recording
    and model ``permissions`` are as wanted; the participant gave ``consent`` again. With ``person_id``, only this one
    of the people was confirmed.
    """

    what: Literal["map", "people", "permissions", "consent"]
    actor: Actor = ""
    person_id: str = ""


class PracticeStepEnded(Event):
    """A step was completed (``done``) or skipped, ``took_s`` after its start."""

    step_id: str
    number: int
    done: bool = True
    took_s: float = 0.0
    actor: Actor = ""


class PracticeEnded(Event):
    """The exercise ended: ``done`` of ``steps`` completed, in ``minutes``. ``score`` is out of 100."""

    done: int
    steps: int
    minutes: float
    score: int
    actor: Actor = ""


EVENTS: tuple[type[Event], ...] = tuple(
    kind for kind in vars().copy().values() if isinstance(kind, type) and issubclass(kind, Event) and kind is not Event
)
"""All kinds; tables and tiers come in this order."""


# Trial details: study, participant and condition of a session.


class TrialDetails(Value):
    """Answers of the start dialog; all of them may be left empty.

    ``recording`` counts the recordings of one trial. ``purpose`` is practice for a wizard's training, else empty.
    """

    study: str = ""
    participant: str = ""
    condition: str = ""
    trial: str = ""
    wizard: str = ""
    recording: str = ""
    purpose: str = ""
