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
"""What shows that a problem is over: the robot is connected, its emergency stop released, a picture comes, another
recording runs, ... quiet: it is told again as long as it goes on. Empty where nothing shows it."""
ANSWER = "answer"
"""The cause of a problem that answers what was asked: it was not done, and nothing lasts of it."""
AlarmState = Literal["raised", "ended"]
MarkKind = Literal["mark", "wizard_error", "note"]
MarkState = Literal["done", "open", "withdrawn"]
OVERTAKEN = "more came at once than could be taken"
"""The reason of a gap that the link leaves where newer values replace older ones."""
LOST_ON_THE_WAY = "lost between the robot's sensor and this computer"
"""The reason of a gap that shows in the robot's stamps alone."""


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


@dataclass(frozen=True, slots=True)
class Gap:
    """Values of ``stream`` that were not recorded."""

    stamp_ns: int
    stream: str
    count: int
    reason: str


@dataclass(frozen=True, slots=True)
class Problem:
    """Something went wrong: what happened, what it means for the session, what to do. ``until`` says what ends it.

    ``info`` needs nothing to be done. Problems of one ``cause`` are one alarm; empty: what they wait for, or what
    happened. ANSWER is no alarm at all.
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
    """Something came to be wrong that needs somebody, or is over: by itself (as the console found), or as ``actor``
    saw to it.

    What came back soon after its end is the same alarm, and ``times`` tells how often it was raised. ``told``: a
    Problem told of it before. What is wrong when a recording begins is raised there again, by the same id.
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
    """Recording began. ``folder`` is the session folder's name, not its path."""

    stamp_ns: int
    folder: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class TrialResumed:
    """The program ended in the midst of a recording, and its trial goes on. ``folder`` is the name of that session's
    folder.
    """

    stamp_ns: int
    folder: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class ConfirmedAsBefore:
    """After that somebody looked: the ``map`` shows where the robot is, ``people`` are who the list says, what is
    recorded and what a model may do (``permissions``) is as wanted, and the participant gave ``consent`` once more.
    With ``person_id`` only this one of the people was looked at.
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
