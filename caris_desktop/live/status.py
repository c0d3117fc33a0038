"""What the console knows of itself, as panels read it from LiveState. Plain frozen values; reasons are for ``tr``."""

from dataclasses import field
from pathlib import Path
from typing import Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.controls import ControlValue
from caris_desktop.domain.events import (
    AssistanceLevel,
    GuardState,
    LinkState,
    Marked,
    MovementState,
    PreflightState,
    ProblemEnd,
    RequestState,
    Severity,
    UtteranceChanged,
    VoiceOutput,
)
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.intents import AsBefore
from caris_desktop.domain.sound import Role
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.trial import TrialDetails
from caris_desktop.domain.value_class import dataclass
from caris_desktop.people.store import HistoryEntry
from caris_desktop.recording.studies.query import SearchHit, SessionEntry, SessionQuery
from caris_desktop.scenario.assistant import NamedText


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """``starts``: the program of the robot is being started, so that nothing can answer yet."""

    state: LinkState = "connecting"
    robot: str = ""
    address: str = ""
    detail: str = ""
    round_trip_ms: float | None = None
    clock_offset_ms: float | None = None
    clock_uncertainty_ms: float | None = None
    starts: bool = False


@dataclass(frozen=True, slots=True)
class DriveStatus:
    """``allowed`` is False with a ``reason`` for the wizard; ``cap_reason`` says why speed is limited, if it is.

    ``target_*`` is what is asked for now (after caps); ``driver`` is who holds it, empty for nobody: the gate refuses
    the base to everybody else. ``max_left_mps`` is 0 on a base that cannot move sideways. ``guard_distance_m`` is the
    free way ahead of the footprint, where it is measured; ``guard_detail`` says why it is blind. ``goal_limit_mps`` is
    what the robot's navigation keeps to on its way to goals; None where it drives as fast as it is set up to.
    ``movement`` is how the odometry agrees with what is commanded, ``velocity_publishers`` are the nodes that publish
    velocities where somebody else does, and ``stopped`` says whether that is under a stop.
    """

    allowed: bool = False
    reason: str = QT_TR_NOOP("Not connected")
    cap_fraction: float = 1.0
    cap_reason: str = ""
    speed_fraction: float = 0.6
    target_forward_mps: float = 0.0
    target_left_mps: float = 0.0
    target_turn_radps: float = 0.0
    driver: Actor = ""
    max_forward_mps: float = 0.5
    max_left_mps: float = 0.0
    max_turn_radps: float = 1.0
    emergency_stop: bool = False
    guard: GuardState = "absent"
    guard_distance_m: float | None = None
    guard_detail: str = ""
    goal_limit_mps: float | None = None
    movement: MovementState = "unknown"
    stopped: bool = False
    velocity_publishers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class HeadStatus:
    """Where the head was asked to look; ``present`` is False where the robot has no head to turn."""

    present: bool = False
    pan_rad: float = 0.0
    tilt_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class MapStatus:
    """``mapping`` is None where the robot does not tell; the operations are those that it offers."""

    can_save: bool = False
    can_load: bool = False
    can_switch: bool = False
    mapping: bool | None = None
    busy: str = ""


@dataclass(frozen=True, slots=True)
class ControlStatus:
    """How the last use of one control went."""

    state: RequestState
    value: ControlValue
    detail: str = ""


@dataclass(frozen=True, slots=True)
class GamepadStatus:
    """``name`` is empty while no gamepad is there; ``device`` is the hardware id that its mapping is kept under."""

    device: str = ""
    name: str = ""
    detail: str = ""


@dataclass(frozen=True, slots=True)
class MicrophoneStatus:
    """A microphone is open unless ``state`` is off. ``level`` is how loud it was lately, 0 to 1.

    ``name`` is empty for the system's default input; ``source`` is what its sound is called.
    """

    state: Literal["off", "starting", "on", "failed"] = "off"
    name: str = ""
    level: float = 0.0
    detail: str = ""
    role: Role = "participant"
    source: str = ""


@dataclass(frozen=True, slots=True)
class ListeningStatus:
    """How turning speech into text stands; off until a microphone is open. ``detail`` says what is wrong."""

    state: Literal["off", "loading", "ready", "failed"] = "off"
    model: str = ""
    language: str = ""
    detail: str = ""


@dataclass(frozen=True, slots=True)
class SoundStatus:
    """``hearing``: what the participant's microphone hears is played to the wizard, as loud as ``volume`` (0 to 1).
    ``talking`` is where the wizard's own voice goes now, empty while it goes nowhere.
    """

    hearing: bool = False
    volume: float = 1.0
    talking: Literal["", "robot", "dictation"] = ""


@dataclass(frozen=True, slots=True)
class RecordingStatus:
    """``room_s`` is how long the disk lasts at ``bytes_per_s``; ``dropped`` counts what is missing, by stream; of
    the cameras ``covered_whole`` nothing is to be seen in the record. ``detail`` is English, for ``tr``.
    """

    state: Literal["idle", "starting", "recording", "paused", "stopping", "failed"] = "idle"
    folder: Path | None = None
    started_ns: int = 0
    written_bytes: int = 0
    free_bytes: int | None = None
    detail: str = ""
    bytes_per_s: float = 0.0
    room_s: float | None = None
    dropped: dict[str, int] = field(default_factory=dict)
    covered_whole: tuple[str, ...] = ()


IN_SESSION = ("starting", "recording", "paused", "stopping")
"""States of a recording in which something of a session is under way."""


@dataclass(frozen=True, slots=True)
class GoingOnStatus:
    """A trial that broke off with the program, in the session ``folder``: offered, then gone on with.

    ``unconfirmed`` is what nobody has looked at since; ``people`` are the ids of those who were there, and
    ``unconfirmed_people`` of those of them who have not been looked at.
    """

    state: Literal["", "offered", "unconfirmed", "confirmed"] = ""
    folder: str = ""
    details: TrialDetails = field(default_factory=TrialDetails)
    unconfirmed: tuple[AsBefore, ...] = ()
    people: tuple[str, ...] = ()
    unconfirmed_people: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PreflightCheck:
    """One check before a recording. ``detail`` is how it stands, ``advice`` what to do about it.

    A ``manual`` one is ticked, which ``actor`` did at ``checked_ns``. ``needed``: a recording without it asks first.
    """

    id: str
    title: str
    state: PreflightState = "not checked"
    detail: str = ""
    advice: str = ""
    manual: bool = False
    needed: bool = False
    actor: Actor = ""
    checked_ns: int | None = None

    @property
    def asks_first(self) -> bool:
        """Whether a recording should not begin as this stands."""
        return self.state == "major" or (self.needed and self.state != "passed")


@dataclass(frozen=True, slots=True)
class SavedScenario:
    """The ``text`` that a scenario file has now, or why it was not written: ``taken`` by what is not to be replaced."""

    path: Path
    text: str = ""
    sha256: str = ""
    problem: str = ""
    taken: bool = False


@dataclass(frozen=True, slots=True)
class PracticeStepStatus:
    """One step of the exercise; ``took_s`` is zero where it has not ended."""

    step_id: str
    state: Literal["open", "now", "done", "skipped"] = "open"
    took_s: float = 0.0


@dataclass(frozen=True, slots=True)
class PracticeStatus:
    """The guided exercise. ``since_ns`` is when the present step began; once it has ``ended``, ``minutes`` and
    ``score`` (of 100) are of ``wizard``. ``back_to``: the scenario that comes back."""

    state: Literal["", "preparing", "running", "ended"] = ""
    steps: tuple[PracticeStepStatus, ...] = ()
    done: int = 0
    minutes: float = 0.0
    score: int = 0
    since_ns: int = 0
    wizard: str = ""
    back_to: str = ""


@dataclass(frozen=True, slots=True)
class MarksStatus:
    """The wizard's marks of this session: ``last`` can still be changed, ``open`` are stretches that go on."""

    last: Marked | None = None
    open: tuple[Marked, ...] = ()


@dataclass(frozen=True, slots=True)
class ProtocolStatus:
    """Where the wizard is in the protocol: in the step of that id, which is the ``number``-th of ``steps``; in none
    where that is empty, before the first and once the protocol has ended.

    ``since_ns`` is when it began, later by what it was left or paused for, and ``paused_ns`` since when it is paused,
    None while its time goes on. ``done`` and ``skipped`` are ids of other steps; ``next_title`` is empty at the last.
    """

    step_id: str = ""
    title: str = ""
    number: int = 0
    steps: int = 0
    since_ns: int = 0
    paused_ns: int | None = None
    expected_s: float = 0.0
    ticked: tuple[str, ...] = ()
    next_title: str = ""
    done: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()
    ended: bool = False

    def elapsed_s(self, now_ns: int) -> float:
        """How long the step has taken by then."""
        until_ns = now_ns if self.paused_ns is None else self.paused_ns
        return max(0.0, (until_ns - self.since_ns) / 1e9) if self.step_id else 0.0

    def late_s(self, now_ns: int) -> float:
        """How much longer than expected; zero where it is in time, or nothing is expected."""
        return max(0.0, self.elapsed_s(now_ns) - self.expected_s) if self.expected_s else 0.0


@dataclass(frozen=True, slots=True)
class Alarm:
    """Something that is wrong now and needs somebody. ``why`` is what was told of its reason, ``folded`` what came of
    it. ``times`` tells how often it came lately, ``asked_ns`` when something was last asked for that it stands
    in the way of. ``until`` as in Problem; where it does not end by itself somebody says that it was seen to.
    """

    alarm_id: str
    cause: str
    severity: Severity
    what: str
    meaning: str
    advice: str
    began_ns: int
    until: ProblemEnd = ""
    ends_by_itself: bool = False
    times: int = 1
    folded: tuple[str, ...] = ()
    asked_ns: int = 0
    why: str = ""


@dataclass(frozen=True, slots=True)
class PhotoEntry:
    """One photo at hand. ``preview_jpeg`` and ``thumbnail_jpeg`` are pictures of it for the window.

    ``deleted``: it can still be brought back. ``changeable``: tags and deleting are possible, as its session runs, or
    it is of none.
    """

    file_name: str
    utc_ns: int
    camera: str = ""
    person_ids: tuple[str, ...] = ()
    pose_in_map: Pose2D | None = None
    tags: tuple[str, ...] = ()
    preview_jpeg: bytes = b""
    thumbnail_jpeg: bytes = b""
    deleted: bool = False
    changeable: bool = True


@dataclass(frozen=True, slots=True)
class PlaybackStatus:
    """How a replay stands. ``position_ns`` is the moment on show, on the session's own clock."""

    session: str = ""
    start_ns: int = 0
    end_ns: int = 0
    position_ns: int = 0
    playing: bool = False
    rate: float = 1.0
    detail: str = ""


@dataclass(frozen=True, slots=True)
class LiveRobotsStatus:
    """The robots that consoles on this computer drive while a replay is on show; ``emergency_stop``: of all of them."""

    robots: tuple[str, ...] = ()
    emergency_stop: bool = False


@dataclass(frozen=True, slots=True)
class AskedGap:
    """What is to be said, and of its gaps the one for which the wizard has to find the words."""

    text: str
    gap: str


@dataclass(frozen=True, slots=True)
class SpeechStatus:
    """``now`` is the utterance that is being spoken, None when quiet; ``waiting`` are those after it.

    ``ends_ns`` is when ``now`` will have been said, None until it has begun: to the sample where this computer plays
    it, else reckoned from its length. ``gap`` is what is asked for before something can be said.
    """

    ready: bool = False
    voice: str = ""
    now: UtteranceChanged | None = None
    waiting: tuple[UtteranceChanged, ...] = ()
    detail: str = ""
    ends_ns: int | None = None
    gap: AskedGap | None = None


@dataclass(frozen=True, slots=True)
class VoiceStatus:
    """Who speaks and how, as in the scenario file. ``used`` is the voice of this computer that is loaded, empty while
    none is; ``choices`` are those that there are, each with its language.
    """

    output: VoiceOutput = "robot"
    name: str = ""
    language: str = ""
    rate: float = 1.0
    volume: float = 1.0
    used: str = ""
    choices: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True)
class ExchangeStatus:
    """One question of the wizard. ``preparing`` while its pictures are read; ``answer`` grows while it is answering.

    ``use`` is what became of the answer, empty as long as nothing did. ``detail`` says why there is none, or why it is
    still waited for.
    """

    exchange_id: str
    question: str
    state: Literal["preparing", "answering", "answered", "cancelled", "failed"]
    model: str = ""
    answer: str = ""
    detail: str = ""
    use: Literal["", "said", "edited"] = ""

    @property
    def under_way(self) -> bool:
        return self.state in ("preparing", "answering")


@dataclass(frozen=True, slots=True)
class AssistantStatus:
    """``exchanges`` are the questions that can still be used, the newest first; of that one are the texts beside.

    ``state`` is answering while any of them is, and failed where the newest did or there is no model.
    """

    state: Literal["off", "starting", "ready", "answering", "failed"] = "off"
    model: str = ""
    exchange_id: str = ""
    question: str = ""
    answer: str = ""
    detail: str = ""
    exchanges: tuple[ExchangeStatus, ...] = ()


@dataclass(frozen=True, slots=True)
class ModelChoice:
    """A model that can be chosen: ``model`` as in a scenario, ``title`` for the wizard, ``where`` it is."""

    model: str
    title: str
    where: str


@dataclass(frozen=True, slots=True)
class PartAlong:
    """Something that goes along with the next question; ``count`` of them in ``words`` words. ``kind`` is its name in
    ``Ask.leave_out``, ``title`` is translated where it is shown.
    """

    kind: str
    title: str
    count: int
    words: int


@dataclass(frozen=True, slots=True)
class AssistantSetup:
    """What the next question is asked with. ``edited``: texts differ from those of the scenario.

    ``pictures`` says whether pictures may go along to this model. ``server`` is the other computer that it is on, empty
    where it is this one.
    """

    model: str = ""
    server: str = ""
    models: tuple[ModelChoice, ...] = ()
    role: str = ""
    style: str = ""
    system_prompt: str = ""
    roles: tuple[NamedText, ...] = ()
    styles: tuple[NamedText, ...] = ()
    templates: tuple[NamedText, ...] = ()
    notes: str = ""
    edited: bool = False
    pictures: bool = False
    parts: tuple[PartAlong, ...] = ()


@dataclass(frozen=True, slots=True)
class FaceStatus:
    """``what`` the face shows: itself with ``expression``, ``text``, the photo of the file name ``text``, or what the
    robot sees. ``expressions`` are those of ``face``. ``window`` is whether it has one of its own, ``served`` whether
    there is a page of it, and ``pages`` how many show that now.
    """

    face: str = ""
    title: str = ""
    expression: str = ""
    expressions: tuple[str, ...] = ()
    what: Literal["off", "face", "text", "photo", "live"] = "off"
    text: str = ""
    speaking: bool = False
    listening: bool = False
    window: bool = False
    served: bool = False
    pages: int = 0


@dataclass(frozen=True, slots=True)
class LevelsStatus:
    """How much the language model may do by itself now, up to what the scenario allows."""

    replies: AssistanceLevel = "off"
    fillers: AssistanceLevel = "off"
    actions: AssistanceLevel = "off"


@dataclass(frozen=True, slots=True)
class ShownSuggestion:
    """One suggested reply, as the record has it. ``rank`` is its place and key, which works from ``from_ns`` on."""

    suggestion_id: str
    rank: int
    text: str
    from_ns: int = 0


@dataclass(frozen=True, slots=True)
class SuggestionsStatus:
    """The replies that can be said now, and what they are made from: the last ``turns`` of the conversation, the
    ``place`` of the robot, what the study is ``doing``, and who spoke. The first of them is said without a key at
    ``says_ns``; at ``filler_ns`` a reply is late. ``detail`` says why there are none.
    """

    state: Literal["off", "idle", "asking", "shown", "failed"] = "off"
    turn_id: str = ""
    revision: int = 0
    cards: tuple[ShownSuggestion, ...] = ()
    model: str = ""
    turns: int = 0
    place: str = ""
    doing: str = ""
    person_id: str = ""
    says_ns: int | None = None
    filler_ns: int | None = None
    detail: str = ""


@dataclass(frozen=True, slots=True)
class ProposalStatus:
    """What the language model proposes to do, in ``words``; nothing while ``proposal_id`` is empty. A key confirms it
    from ``from_ns`` until ``lapses_ns``; at ``acts_ns`` it is done without one.
    """

    proposal_id: str = ""
    words: str = ""
    moves: bool = True
    model: str = ""
    from_ns: int = 0
    lapses_ns: int = 0
    acts_ns: int | None = None


@dataclass(frozen=True, slots=True)
class LoadStatus:
    """How much is given up because the machine is busy: ``step`` 0 is nothing; ``detail`` says what, for ``tr``."""

    step: int = 0
    detail: str = ""

    @property
    def pays_small(self) -> bool:
        """Whether small pictures, of other cameras and of people, are renewed less often: they pay first."""
        return self.step > 0


@dataclass(frozen=True, slots=True)
class PersonHistory:
    """What there was with a person, newest first; of all that what has the words of ``text``."""

    person_id: str
    text: str = ""
    entries: tuple[HistoryEntry, ...] = ()


@dataclass(frozen=True, slots=True)
class PerceptionStatus:
    """``looks_per_s`` says of each camera how often people are looked for in its pictures.

    ``server`` is the other machine that does it and gets the pictures for it, empty for none. ``recognises`` says by
    what people can be known again, clothing or face: for what there is a network.
    """

    state: Literal["off", "loading", "ready", "failed"] = "off"
    model: str = ""
    detail: str = ""
    inference_ms: float | None = None
    looks_per_s: dict[str, float] = field(default_factory=dict)
    server: str = ""
    recognises: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ExportStatus:
    """How exporting stands. ``what`` is being written now, ``written`` is where the finished ones are."""

    state: Literal["idle", "running", "done", "failed", "cancelled"] = "idle"
    fraction: float = 0.0
    what: str = ""
    written: tuple[Path, ...] = ()
    detail: str = ""


@dataclass(frozen=True, slots=True)
class LibraryStatus:
    """The sessions of the study that match ``query``, newest first; ``updating`` while the index is brought to date.

    ``places`` counts where its text was found, of which ``hits`` are the first.
    """

    query: SessionQuery = field(default_factory=SessionQuery)
    sessions: tuple[SessionEntry, ...] = ()
    hits: tuple[SearchHit, ...] = ()
    total: int = 0
    updating: bool = False
    detail: str = ""
    places: int = 0
