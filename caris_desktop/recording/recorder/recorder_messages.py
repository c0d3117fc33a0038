"""Messages between the console and the recorder process.

The console also sends every value of the stream table, and the recorder returns the events that it creates:
``SessionStarted``, ``SessionEnded``, ``RecordingPaused``, ``PhotoTaken``, ``Gap`` and ``Problem``. Those are recorded
already; they are for the panels and must not be sent back.

``actor`` is who requested it, and is recorded in the resulting event.

The console sends pickles. A prefix of the byte ``ARRIVED`` and eight bytes (little-endian, signed) gives the value's
arrival at the console on the session clock; without it the value arrives now.
"""

from dataclasses import field
from pathlib import Path
from typing import Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session.session_header import SessionHeader

# Cannot begin a pickle; eight bytes of session time follow.
ARRIVED = b"T"

BlurWho = Literal["nobody", "everybody", "without_consent"]
BlurWhat = Literal["faces", "persons"]
RecorderState = Literal["idle", "recording", "paused", "failed"]


class BlurDemand(Value):
    """Whom to blur in stored images, and how much of them."""

    who: BlurWho = "nobody"
    what: BlurWhat = "persons"


class UseConsents(Value):
    """Ids of people who consented to video and to photos: not blurred there if only people without consent must be.
    None before the first message.
    """

    video: frozenset[str] = frozenset()
    photos: frozenset[str] = frozenset()


class StartRecording(Value):
    """Begin a session in ``folder``, which is created if missing and must be empty. Ends a running one.

    The session starts when this message arrived at the console, which is when the recording was requested.
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


class SetRecordingPermissions(Value):
    """Set what may be recorded from now on; sent when the scenario changes during a session."""

    video: bool
    photos: bool
    audio: bool = True
    blur: BlurDemand = BlurDemand()


class PauseRecording(Value):
    """Pause recording, or resume with ``paused`` False; the pause itself is recorded."""

    paused: bool
    actor: Actor = ""


class OfferMarkers(Value):
    """Open the Lab Streaming Layer outlet before a recording, so that other recorders find it, or close it. With
    ``words``, texts are sent too. ``StartRecording`` has the same fields.
    """

    offered: bool
    words: bool = False


class TakePhoto(Value):
    """Save this frame as ``photos/NUMBER.png`` of the session, or as ``without_session`` if there is none.

    Answered by ``PhotoTaken`` or ``Problem``. ``blur`` applies without a session. ``person_id``, ``person_ids`` and
    ``pose_in_map`` as in ``PhotoTaken``.
    """

    ref: FrameRef
    without_session: Path
    actor: Actor = ""
    blur: BlurDemand = BlurDemand()
    person_id: str = ""
    person_ids: tuple[str, ...] = ()
    pose_in_map: Pose2D | None = None


class StopRecording(Value):
    """End the session after everything sent before. ``reason`` goes into ``SessionEnded``."""

    reason: str = "wizard"
    actor: Actor = ""


class RecorderReport(Value):
    """State of the recorder: at each change and about once per second while recording.

    ``dropped`` counts missing values per stream. ``bytes_per_s`` is the recent growth of the session, ``room_s`` the
    time until the disk is full at that rate. ``detail`` describes a problem, if any. ``covered_whole`` lists cameras
    whose frames are entirely covered because detections are late.
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
