"""Events of the session: recording, photos, marks, problems and alarms."""

from typing import Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.value_class import dataclass

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


@dataclass(frozen=True, slots=True)
class PhotoTaken:
    """A photo. ``file_name`` is relative to the session folder, or to the study's without a recording.

    ``person_id`` is the person attended to, or the nearest; empty if none. ``person_ids`` are all people detected then.
    ``pose_in_map`` is the pose of the robot; None if unknown.
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
    """New tags of a photo; they replace all earlier ones."""

    stamp_ns: int
    file_name: str
    tags: tuple[str, ...]
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PhotoDeleted:
    """A photo was deleted, or ``restored``, which is possible until the session ends."""

    stamp_ns: int
    file_name: str
    restored: bool = False
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class Marked:
    """The wizard marked a moment or an interval of the session.

    The same ``mark_id`` returns whenever the mark changes: an interval ends, the moment is moved back, a note is added.
    The newest one counts. ``start_ns`` is the moment meant (None: ``stamp_ns``), ``end_ns`` the end of an interval.
    ``state`` is open during an interval, and withdrawn for a mark made by mistake.
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
    """The wizard paused or resumed the recording. Nothing is recorded in between."""

    stamp_ns: int
    paused: bool
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class ScenarioOpened:
    """A scenario was opened. ``content`` is the text of its file."""

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
    """The panel layout changed. ``layout`` is the tree of splits and tabs as in a scenario file, as JSON."""

    stamp_ns: int
    layout: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class Gap:
    """Values of ``stream`` that were not recorded."""

    stamp_ns: int
    stream: str
    count: int
    reason: str


@dataclass(frozen=True, slots=True)
class Problem:
    """A problem: what happened, what it means for the session, what to do. ``until`` says what ends it.

    ``info`` requires no action. Problems of one ``cause`` are one alarm; if empty, of one ``until`` or ``what``. The
    cause ``answer`` raises no alarm.
    """

    stamp_ns: int
    severity: Severity
    what: str
    meaning: str
    advice: str
    until: ProblemEnd = ""
    cause: str = ""


@dataclass(frozen=True, slots=True)
class AlarmChanged:
    """An alarm was raised, or ended: automatically by the console, or resolved by ``actor``.

    An alarm that returns soon after its end is the same one; ``times`` counts how often it was raised. ``told``: a
    Problem reported it before. Alarms active when a recording starts are raised there again with their id.
    """

    stamp_ns: int
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


@dataclass(frozen=True, slots=True)
class SessionStarted:
    """Recording started. ``folder`` is the session folder's name, not its path."""

    stamp_ns: int
    folder: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class TrialResumed:
    """A trial continues after the program ended during its recording. ``folder`` is that session's folder name."""

    stamp_ns: int
    folder: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class ConfirmedAsBefore:
    """Confirmation by a person: the ``map`` shows where the robot is; the ``people`` are who the list says; recording
    and model ``permissions`` are as wanted; the participant gave ``consent`` again. With ``person_id``, only this one
    of the people was confirmed.
    """

    stamp_ns: int
    what: Literal["map", "people", "permissions", "consent"]
    actor: Actor = ""
    person_id: str = ""


@dataclass(frozen=True, slots=True)
class SessionEnded:
    """Recording ended; ``reason`` is wizard, console_closed, disk_full, disk_failed or recovered."""

    stamp_ns: int
    folder: str
    reason: str
    actor: Actor = ""
