"""What the console knows of itself, as panels read it from LiveState. Plain frozen values."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from caris_desktop.domain.controls import ControlValue
from caris_desktop.domain.events import GuardState, LinkState, Marked, RequestState, UtteranceChanged
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.people.store import HistoryEntry
from caris_desktop.recording.studies.query import SearchHit, SessionEntry, SessionQuery

Freshness = Literal["none", "fresh", "stale", "lost"]


@dataclass(frozen=True, slots=True)
class LinkStatus:
    state: LinkState = "connecting"
    robot: str = ""
    address: str = ""
    detail: str = ""
    round_trip_ms: float | None = None
    clock_offset_ms: float | None = None
    clock_uncertainty_ms: float | None = None


@dataclass(frozen=True, slots=True)
class DriveStatus:
    """``allowed`` is False with a ``reason`` for the wizard; ``cap_reason`` says why speed is limited, if it is.

    ``target_*`` is what is asked for now (after caps), zero when nothing is held. ``max_left_mps`` is 0 on a base that
    cannot move sideways. ``guard_distance_m`` is the free way ahead of the footprint, where the guard measures it;
    ``guard_detail`` says in words why it is blind. ``goal_limit_mps`` is what the robot's navigation keeps to on its
    way to goals; None where it drives as fast as it is set up to.
    """

    allowed: bool = False
    reason: str = "Not connected"
    cap_fraction: float = 1.0
    cap_reason: str = ""
    speed_fraction: float = 0.6
    target_forward_mps: float = 0.0
    target_left_mps: float = 0.0
    target_turn_radps: float = 0.0
    max_forward_mps: float = 0.5
    max_left_mps: float = 0.0
    max_turn_radps: float = 1.0
    emergency_stop: bool = False
    guard: GuardState = "absent"
    guard_distance_m: float | None = None
    guard_detail: str = ""
    goal_limit_mps: float | None = None


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
    """``level`` is how loud it was lately, 0 to 1. ``name`` is empty for the system's default input."""

    state: Literal["off", "starting", "on", "failed"] = "off"
    name: str = ""
    level: float = 0.0
    detail: str = ""


@dataclass(frozen=True, slots=True)
class RecordingStatus:
    """``room_s`` is how long the disk lasts at ``bytes_per_s``; ``dropped`` counts what is missing, by stream."""

    state: Literal["idle", "starting", "recording", "paused", "stopping", "failed"] = "idle"
    folder: Path | None = None
    started_ns: int = 0
    written_bytes: int = 0
    free_bytes: int | None = None
    detail: str = ""
    bytes_per_s: float = 0.0
    room_s: float | None = None
    dropped: dict[str, int] = field(default_factory=dict)


IN_SESSION = ("starting", "recording", "paused", "stopping")
"""States of a recording in which something of a session is under way."""


@dataclass(frozen=True, slots=True)
class MarksStatus:
    """The wizard's marks of this session: ``last`` can still be changed, ``open`` are stretches that go on."""

    last: Marked | None = None
    open: tuple[Marked, ...] = ()


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
class SpeechStatus:
    """``now`` is the utterance that is being spoken, None when quiet; ``waiting`` are those after it."""

    ready: bool = False
    voice: str = ""
    now: UtteranceChanged | None = None
    waiting: tuple[UtteranceChanged, ...] = ()
    detail: str = ""


@dataclass(frozen=True, slots=True)
class AssistantStatus:
    """``answer`` grows while ``state`` is answering and stays until the next question."""

    state: Literal["off", "starting", "ready", "answering", "failed"] = "off"
    model: str = ""
    exchange_id: str = ""
    question: str = ""
    answer: str = ""
    detail: str = ""


@dataclass(frozen=True, slots=True)
class LoadStatus:
    """How much is given up because the machine is busy: ``step`` 0 is nothing; ``detail`` says what, in words."""

    step: int = 0
    detail: str = ""


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
    """The sessions of the study that match ``query``, newest first, and where its text was found.

    ``updating`` while the index is brought up to date.
    """

    query: SessionQuery = field(default_factory=SessionQuery)
    sessions: tuple[SessionEntry, ...] = ()
    hits: tuple[SearchHit, ...] = ()
    total: int = 0
    updating: bool = False
    detail: str = ""
