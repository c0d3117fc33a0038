"""What the console and the recorder process say to one another.

Besides these, the console sends every domain value of the stream table as it happens, and the recorder sends back
the events that it makes itself: ``SessionStarted``, ``SessionEnded``, ``RecordingPaused``, ``PhotoTaken``, ``Gap`` and
``Problem``. The recorder has written those already; they are for the panels and need not be sent to it again.

``actor`` is who asked for it, and goes into the event that tells of it.

What the console sends is pickled. Where the byte ``ARRIVED`` and eight bytes (little-endian, signed) come before the
pickle, these are the moment on the session clock when the value arrived at the console; else it arrives now.
"""

from dataclasses import field
from pathlib import Path
from typing import Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.value_class import dataclass

# Before a pickle, which begins with another byte: eight bytes of the session clock follow.
ARRIVED = b"T"

BlurWho = Literal["nobody", "everybody", "without_consent"]
BlurWhat = Literal["faces", "persons"]
RecorderState = Literal["idle", "recording", "paused", "failed"]


@dataclass(frozen=True, slots=True)
class BlurDemand:
    """Who has to be covered in whatever pictures are kept, and how much of them."""

    who: BlurWho = "nobody"
    what: BlurWhat = "persons"


@dataclass(frozen=True, slots=True)
class UseConsents:
    """The ids of those who agreed to be filmed, and of those who agreed to photos: they are not covered in these where
    only those who did not have to be. Until this comes nobody has.
    """

    video: frozenset[str] = frozenset()
    photos: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class SessionHeader:
    """What heads ``session.json``. ``trial`` holds the answers of the start dialog, each under its field's name.

    ``software`` maps the names of programs and libraries to their versions; ``settings`` holds what was set in this
    run, in words. Neither holds keys or paths.
    """

    anchor: ClockAnchor
    program_version: str
    scenario_title: str = ""
    scenario_file: str = ""
    scenario_sha256: str = ""
    robot_profile: str = ""
    robot_address: str = ""
    trial: dict[str, str] = field(default_factory=dict)
    software: dict[str, str] = field(default_factory=dict)
    settings: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class StartRecording:
    """Begin a session in ``folder``, which is made if it is not there and must be empty. Ends a running one.

    The session starts at the moment of this message's arrival at the console, when the recording was asked for.
    """

    folder: Path
    header: SessionHeader
    video: bool = True
    photos: bool = True
    audio: bool = True
    lsl: bool = False
    lsl_words: bool = False
    actor: Actor = ""
    blur: BlurDemand = BlurDemand()


@dataclass(frozen=True, slots=True)
class SetRecordingPermissions:
    """What may be recorded from now on; sent when the scenario changes during a session."""

    video: bool
    photos: bool
    audio: bool = True
    blur: BlurDemand = BlurDemand()


@dataclass(frozen=True, slots=True)
class PauseRecording:
    """Record nothing until it is sent again with ``paused`` False; the pause itself is recorded."""

    paused: bool
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class OfferMarkers:
    """Show the Lab Streaming Layer outlet already, so that other recorders find it before the recording begins, or
    take it away. With ``words``, what is said goes out too. ``StartRecording`` says the same at the start.
    """

    offered: bool
    words: bool = False


@dataclass(frozen=True, slots=True)
class TakePhoto:
    """Keep this frame as ``photos/NUMBER.png`` of the session, or as ``without_session`` while there is none.

    Answered by ``PhotoTaken``, or by a ``Problem``. ``blur`` counts where there is no session. ``person_id``,
    ``person_ids`` and ``pose_in_map`` are as in ``PhotoTaken``.
    """

    ref: FrameRef
    without_session: Path
    actor: Actor = ""
    blur: BlurDemand = BlurDemand()
    person_id: str = ""
    person_ids: tuple[str, ...] = ()
    pose_in_map: Pose2D | None = None


@dataclass(frozen=True, slots=True)
class StopRecording:
    """End the session; everything sent before is in it. ``reason`` goes into ``SessionEnded``."""

    reason: str = "wizard"
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class RecorderReport:
    """How the recording stands: at each change and about once per second while recording.

    ``dropped`` counts what is missing for each stream. ``bytes_per_s`` is how fast the session grew lately and
    ``room_s`` how long the disk lasts at that rate. ``detail`` says in words what is wrong, if anything.
    ``covered_whole`` are the cameras of which nothing is to be seen, since who is where is not known in time.
    """

    stamp_ns: int
    state: RecorderState
    folder: Path | None = None
    started_ns: int = 0
    written_bytes: int = 0
    free_bytes: int | None = None
    dropped: dict[str, int] = field(default_factory=dict)
    detail: str = ""
    bytes_per_s: float = 0.0
    room_s: float | None = None
    covered_whole: tuple[str, ...] = ()
