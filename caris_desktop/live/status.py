"""Status values of the console, as read by panels from LiveState. Plain frozen values; reasons are for ``tr``."""

from dataclasses import field
from pathlib import Path
from typing import Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.control_definitions import ControlValue
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
    TrialDetails,
    UtteranceChanged,
    VoiceOutput,
)
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.intents import AsBefore
from caris_desktop.domain.sound_values import Role
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.people.people_store import HistoryEntry
from caris_desktop.recording.studies.study_query import SearchHit, SessionEntry, SessionQuery
from caris_desktop.scenario.scenario_model import NamedText


class LinkStatus(Value):
    """Link status. ``starts``: the robot's program is being started, so that nothing can answer yet."""

    state: LinkState = "connecting"
    robot: str = ""
    address: str = ""
    detail: str = ""
    round_trip_ms: float | None = None
    clock_offset_ms: float | None = None
    clock_uncertainty_ms: float | None = None
    starts: bool = False


class DriveStatus(Value):
    """Drive status. ``allowed`` is False with a ``reason`` for the wizard; ``cap_reason`` says why speed is limited.

    ``target_*``: current command, after caps; ``driver``: who drives, empty for nobody; the gate refuses the base to
    others. ``max_left_mps`` is 0 for a base that cannot move sideways. ``guard_distance_m``: clearance of the footprint
    in the direction of motion, if measured; ``guard_detail``: why it is blind. ``goal_limit_mps``: speed limit of the
    robot's navigation; None for its own configuration. ``movement``: agreement of odometry and commands;
    ``velocity_publishers``: other nodes that publish velocities; ``stopped``: whether this happens under a stop.
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


class HeadStatus(Value):
    """Commanded head angles; ``present`` is False if the robot has no movable head."""

    present: bool = False
    pan_rad: float = 0.0
    tilt_rad: float = 0.0


class MapStatus(Value):
    """Mapping status. ``mapping`` is None if unknown; operations are those that the robot offers."""

    can_save: bool = False
    can_load: bool = False
    can_switch: bool = False
    mapping: bool | None = None
    busy: str = ""


class ControlStatus(Value):
    """Result of the last use of a control."""

    state: RequestState
    value: ControlValue
    detail: str = ""


class GamepadStatus(Value):
    """Gamepad status. ``name`` is empty without a gamepad; ``device``: hardware id, the key of its mapping."""

    device: str = ""
    name: str = ""
    detail: str = ""


class MicrophoneStatus(Value):
    """Microphone status; open unless ``state`` is off. ``level``: recent loudness, 0 to 1.

    ``name`` is empty for the system's default; ``source``: name of its audio stream.
    """

    state: Literal["off", "starting", "on", "failed"] = "off"
    name: str = ""
    level: float = 0.0
    detail: str = ""
    role: Role = "participant"
    source: str = ""


class ListeningStatus(Value):
    """Speech recognition status; off until a microphone is open. ``detail``: problem."""

    state: Literal["off", "loading", "ready", "failed"] = "off"
    model: str = ""
    language: str = ""
    detail: str = ""


class SoundStatus(Value):
    """Sound status. ``hearing``: the participant's microphone is played to the wizard, at ``volume`` (0 to 1).
    ``talking``: destination of the wizard's voice, empty for none.
    """

    hearing: bool = False
    volume: float = 1.0
    talking: Literal["", "robot", "dictation"] = ""


class RecordingStatus(Value):
    """Recording status. ``room_s``: remaining disk time at ``bytes_per_s``; ``dropped``: missing values by stream;
    ``covered_whole``: cameras that are entirely blurred in the record. ``detail`` is English, for ``tr``.
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
"""Recording states that belong to a session."""


class CrashRecoveryStatus(Value):
    """Crash recovery of a trial in the session ``folder``: offered, then resumed.

    ``unconfirmed``: conditions not confirmed yet; ``people``: ids of those present before, and ``unconfirmed_people``
    those of them not confirmed.
    """

    state: Literal["", "offered", "unconfirmed", "confirmed"] = ""
    folder: str = ""
    details: TrialDetails = field(default_factory=TrialDetails)
    unconfirmed: tuple[AsBefore, ...] = ()
    people: tuple[str, ...] = ()
    unconfirmed_people: tuple[str, ...] = ()


class PreflightCheck(Value):
    """Preflight check. ``detail``: its state, ``advice``: what to do.

    A ``manual`` one was ticked by ``actor`` at ``checked_ns``. ``needed``: a recording without it needs confirmation.
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
        """Whether a recording needs confirmation in this state."""
        return self.state == "major" or (self.needed and self.state != "passed")


class SavedScenario(Value):
    """Result of saving a scenario: its ``text``, or why it was not written: ``taken`` by other contents."""

    path: Path
    text: str = ""
    sha256: str = ""
    problem: str = ""
    taken: bool = False


class PracticeStepStatus(Value):
    """Step of the practice; ``took_s`` is zero until it ended."""

    step_id: str
    state: Literal["open", "now", "done", "skipped"] = "open"
    took_s: float = 0.0


class PracticeStatus(Value):
    """Practice status. ``since_ns``: start of the current step; once ``ended``, ``minutes`` and ``score`` (of 100) of
    ``wizard``. ``back_to``: the scenario to return to.
    """

    state: Literal["", "preparing", "running", "ended"] = ""
    steps: tuple[PracticeStepStatus, ...] = ()
    done: int = 0
    minutes: float = 0.0
    score: int = 0
    since_ns: int = 0
    wizard: str = ""
    back_to: str = ""


class MarksStatus(Value):
    """Marks of this session: ``last`` can still be changed, ``open`` are open intervals."""

    last: Marked | None = None
    open: tuple[Marked, ...] = ()


class ProtocolStatus(Value):
    """Protocol status: the current step's id, the ``number``-th of ``steps``; empty before the first step and after the
    last.

    ``since_ns``: its start, shifted by interruptions; ``paused_ns``: start of a pause, or None. ``done`` and
    ``skipped``: ids of other steps; ``next_title`` is empty at the last.
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
        """Time spent in the step in s."""
        until_ns = now_ns if self.paused_ns is None else self.paused_ns
        return max(0.0, (until_ns - self.since_ns) / 1e9) if self.step_id else 0.0

    def late_s(self, now_ns: int) -> float:
        """Time over the expected duration in s; zero if on time, or without expectation."""
        return max(0.0, self.elapsed_s(now_ns) - self.expected_s) if self.expected_s else 0.0


class Alarm(Value):
    """Alarm. ``why``: its reason, ``folded``: its consequences. ``times``: recent occurrences, ``asked_ns``: when it
    last blocked a command. ``until`` as in Problem; an alarm that does not end automatically is dismissed.
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


class PhotoEntry(Value):
    """Photo. ``preview_jpeg`` and ``thumbnail_jpeg``: images for the window.

    ``deleted``: can be restored. ``changeable``: can be tagged and deleted, since its session is running or it has
    none.
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


class PlaybackStatus(Value):
    """Replay status. ``position_ns``: current position, on the session clock."""

    session: str = ""
    start_ns: int = 0
    end_ns: int = 0
    position_ns: int = 0
    playing: bool = False
    rate: float = 1.0
    detail: str = ""


class LiveRobotsStatus(Value):
    """Robots driven by consoles on this computer during a replay; ``emergency_stop``: of all of them."""

    robots: tuple[str, ...] = ()
    emergency_stop: bool = False


class OpenGap(Value):
    """Text with the placeholder that the wizard must fill."""

    text: str
    gap: str


class SpeechStatus(Value):
    """Speech status. ``now``: current utterance, None if silent; ``waiting``: the queue.

    ``ends_ns``: end of ``now``, None until it has begun: exact if this computer plays it, else estimated from its
    length. ``gap``: a placeholder to be filled.
    """

    ready: bool = False
    voice: str = ""
    now: UtteranceChanged | None = None
    waiting: tuple[UtteranceChanged, ...] = ()
    detail: str = ""
    ends_ns: int | None = None
    gap: OpenGap | None = None


class VoiceStatus(Value):
    """Voice settings, as in the scenario file. ``used``: loaded voice of this computer, empty for none; ``choices``:
    available ones with their language.
    """

    output: VoiceOutput = "robot"
    name: str = ""
    language: str = ""
    rate: float = 1.0
    volume: float = 1.0
    used: str = ""
    choices: tuple[tuple[str, str], ...] = ()


class ExchangeStatus(Value):
    """Question of the wizard. ``preparing`` while its images are read; ``answer`` grows while answering.

    ``use``: what was done with the answer, empty for nothing. ``detail``: why there is none, or why it is delayed.
    """

    exchange_id: str
    question: str
    state: Literal["preparing", "answering", "answered", "cancelled", "failed"]
    model: str = ""
    answer: str = ""
    detail: str = ""
    use: Literal["", "said", "edited"] = ""

    @property
    def is_pending(self) -> bool:
        return self.state in ("preparing", "answering")


class AssistantStatus(Value):
    """Assistant status. ``exchanges``: usable questions, newest first; the other texts belong to the newest.

    ``state``: answering while any of them is, failed if the newest did or there is no model.
    """

    state: Literal["off", "starting", "ready", "answering", "failed"] = "off"
    model: str = ""
    exchange_id: str = ""
    question: str = ""
    answer: str = ""
    detail: str = ""
    exchanges: tuple[ExchangeStatus, ...] = ()


class ModelChoice(Value):
    """Available model: ``model`` as in a scenario, ``title`` for the wizard, ``where``: its location."""

    model: str
    title: str
    where: str


class ContextPartStatus(Value):
    """Prompt context part: ``count`` items with ``words`` words. ``kind``: its name in ``Ask.leave_out``; ``title`` is
    translated for display.
    """

    kind: str
    title: str
    count: int
    words: int


class AssistantSetup(Value):
    """Setup of the next question. ``edited``: texts differ from the scenario's.

    ``pictures``: the model may get images. ``server``: the other computer that runs it, empty for this one.
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
    parts: tuple[ContextPartStatus, ...] = ()


class FaceStatus(Value):
    """Face status. ``what`` it shows: the face with ``expression``, ``text``, the photo with file name ``text``, or the
    robot's view. ``expressions``: those of ``face``. ``window``: has a window, ``served``: has a web page, ``pages``:
    number of open pages.
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


class LevelsStatus(Value):
    """Autonomy levels of the language model, up to the scenario's limits."""

    replies: AssistanceLevel = "off"
    fillers: AssistanceLevel = "off"
    actions: AssistanceLevel = "off"


class DisplayedReply(Value):
    """Suggested reply, as recorded. ``rank``: its position and key, valid from ``from_ns`` on."""

    suggestion_id: str
    rank: int
    text: str
    from_ns: int = 0


class SuggestionsStatus(Value):
    """Suggested replies and their basis: the last ``turns`` of the conversation, the robot's ``place``, the study's
    activity (``doing``) and the speaker. The first is said automatically at ``says_ns``; at ``filler_ns`` a reply is
    late. ``detail``: why there are none.
    """

    state: Literal["off", "idle", "asking", "shown", "failed"] = "off"
    turn_id: str = ""
    revision: int = 0
    cards: tuple[DisplayedReply, ...] = ()
    model: str = ""
    turns: int = 0
    place: str = ""
    doing: str = ""
    person_id: str = ""
    says_ns: int | None = None
    filler_ns: int | None = None
    detail: str = ""


class ProposalStatus(Value):
    """Proposed action of the language model, as text in ``words``; none while ``proposal_id`` is empty. A key confirms
    it from ``from_ns`` to ``lapses_ns``; at ``acts_ns`` it runs automatically.
    """

    proposal_id: str = ""
    words: str = ""
    moves: bool = True
    model: str = ""
    from_ns: int = 0
    lapses_ns: int = 0
    acts_ns: int | None = None


class LoadStatus(Value):
    """Load shedding status: ``step`` 0 means none; ``detail`` describes the reduction, for ``tr``."""

    step: int = 0
    detail: str = ""

    @property
    def pays_small(self) -> bool:
        """Whether thumbnails of cameras and people are refreshed less often: they are reduced first."""
        return self.step > 0


class PersonHistory(Value):
    """History of a person, newest first; entries that match ``text``."""

    person_id: str
    text: str = ""
    entries: tuple[HistoryEntry, ...] = ()


class PerceptionStatus(Value):
    """Perception status. ``looks_per_s``: detection rate by camera.

    ``server``: the other machine that receives the frames, empty for none. ``recognises``: available re-identification
    networks, clothing or face. ``plugins``: those in use, with the package and version of each.
    """

    state: Literal["off", "loading", "ready", "failed"] = "off"
    model: str = ""
    detail: str = ""
    inference_ms: float | None = None
    looks_per_s: dict[str, float] = field(default_factory=dict)
    server: str = ""
    recognises: tuple[str, ...] = ()
    plugins: tuple[tuple[str, str], ...] = ()


class ExportStatus(Value):
    """Export status. ``what``: item being written, ``written``: finished ones."""

    state: Literal["idle", "running", "done", "failed", "cancelled"] = "idle"
    fraction: float = 0.0
    what: str = ""
    written: tuple[Path, ...] = ()
    detail: str = ""


class LibraryStatus(Value):
    """Session search: sessions that match ``query``, newest first; ``updating`` while the index is updated.

    ``places``: number of text matches per session folder; ``hits`` are the first of them, grouped by session.
    """

    query: SessionQuery = field(default_factory=SessionQuery)
    sessions: tuple[SessionEntry, ...] = ()
    hits: tuple[SearchHit, ...] = ()
    total: int = 0
    updating: bool = False
    detail: str = ""
    places: dict[Path, int] = field(default_factory=dict)
