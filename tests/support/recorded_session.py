"""Generator of long, realistic sessions: synthetic values with synthetic times, written by the real writers."""

import heapq
import json
import math
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import cache
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import (
    AnswerUsed,
    ChatMessage,
    CommandSent,
    GoalChanged,
    LayoutChanged,
    LinkChanged,
    LinkQuality,
    LlmExchange,
    Marked,
    PersonAppeared,
    PersonLeft,
    PhotoTaken,
    RobotChosen,
    ScenarioOpened,
    SessionEnded,
    SessionStarted,
    UtteranceChanged,
)
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.schema import to_jsonable
from caris_desktop.domain.sensing import (
    AudioChunk,
    BatteryState,
    FrameRef,
    LaserScan,
    OccupancyGrid,
    Odometry,
    People,
    PeopleInMap,
    PersonBox,
    PersonPlace,
    RobotPose,
    StatusShown,
)
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.live.status import DriveStatus, LinkStatus, SpeechStatus
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.recorder.audio_file import AudioWriter
from caris_desktop.recording.recorder.event_log import EventLog
from caris_desktop.recording.recorder.plain_files import PlainFiles
from caris_desktop.recording.recorder.video_writer import FASTEST, VideoFileWriter
from caris_desktop.recording.session.manifest import session_files, write_manifest
from caris_desktop.recording.session.media_files import video_file_name
from caris_desktop.recording.session.session_header import FORMAT, FORMAT_VERSION, AudioInfo, SessionClock, VideoInfo

SECOND_NS = 1_000_000_000
LAYOUTS = Path(__file__).parents[2] / "layouts"
UTTERANCES = (
    ("robot", "Hello! Welcome to our laboratory."),
    ("participant", "Hi. What can you show me?"),
    ("robot", "This is a robot arm. It can pick up a cup without breaking it."),
    ("participant", "Wow, how much can it carry?"),
    ("robot", "About three kilograms. Shall we go on to the kitchen?"),
    ("participant", "Yes please, I'd like to see the kitchen."),
    ("robot", "Follow me, and mind the doorstep."),
    ("participant", "Are you controlled by a human?"),
)
_LABELS = ("greeting", "question", "laughs", "wizard: late")
_NUMBER_BITS = 24
_FLUSH_EVERY_NS = 300_000_000
# Delay between stamp and arrival at the console: longer for person detection.
_PEOPLE_AFTER_NS, _REST_AFTER_NS = 140_000_000, 900_000


@dataclass(frozen=True, slots=True)
class SessionPlan:
    """Content of a generated session; ``*_every_s`` of 0 omits a stream.

    ``robot_clock_offset_s`` and ``robot_drift_ms_per_min`` are errors of the robot clock, ``network_delay_ms`` is the
    delay of its values. Scans turn with the robot; frames contain their number (:func:`number_in`).
    """

    seconds: float = 20.0
    cameras: tuple[str, ...] = ("front", "rear")
    fps: float = 15.0
    size_px: tuple[int, int] = (160, 90)
    scans_hz: float = 10.0
    beams: int = 180
    odometry_hz: float = 10.0
    people: int = 3
    people_hz: float = 5.0
    utterance_every_s: float = 5.0
    llm_every_s: float = 12.0
    mark_every_s: float = 6.0
    person_every_s: float = 30.0
    goal_every_s: float = 25.0
    photo_every_s: float = 0.0
    battery_every_s: float = 10.0
    status_every_s: float = 2.0
    map_cells: tuple[int, int] = (100, 160)
    audio: tuple[str, ...] = ("microphone", "robot voice")
    robot_clock_offset_s: float = 2.0
    robot_drift_ms_per_min: float = 50.0
    network_delay_ms: float = 8.0
    trial: dict[str, str] = field(
        default_factory=lambda: {
            "study": "Demo", "participant": "P07", "condition": "B", "trial": "1", "wizard": "W2",
            "recording": "1", "purpose": "",
        }
    )  # fmt: skip
    started_utc_ns: int = 1_790_000_000 * SECOND_NS
    started_ns: int = 5_000 * SECOND_NS
    seed: int = 1

    @property
    def ended_ns(self) -> int:
        return self.started_ns + round(self.seconds * SECOND_NS)

    def frame_stamps_ns(self, camera: str) -> NDArray[np.int64]:
        """Capture times of a camera's frames, with jitter."""
        number = self.cameras.index(camera)
        count = int((self.seconds - 0.2) * self.fps)
        rng = np.random.default_rng([self.seed, number])
        jitter_s = rng.uniform(-0.2, 0.2, count) / self.fps
        at_s = 0.1 + 0.01 * number + np.arange(count) / self.fps + jitter_s
        return self.started_ns + np.round(at_s * SECOND_NS).astype(np.int64)

    def robot_stamp_ns(self, stamp_ns: int) -> int:
        """Robot time at the measurement of a value that arrived at ``stamp_ns``."""
        measured_ns = stamp_ns - round(self.network_delay_ms * 1e6)
        return measured_ns + round(self.robot_offset_ms(measured_ns) * 1e6)

    def robot_offset_ms(self, at_ns: int) -> float:
        """Robot clock minus session clock."""
        return 1000 * self.robot_clock_offset_s + self.robot_drift_ms_per_min * (at_ns - self.started_ns) / (
            60 * SECOND_NS
        )


@dataclass(frozen=True, slots=True)
class RecordedSession:
    """Generated session; ``values`` are the recorded values with arrival times, in order, if requested."""

    folder: Path
    plan: SessionPlan
    values: tuple[tuple[int, Any], ...]


def make_session(
    folder: Path, plan: SessionPlan | None = None, *, keep: bool = False, killed: bool = False, **fields: Any
) -> RecordedSession:
    """Record a session into the new folder ``folder``. ``fields`` are those of :class:`SessionPlan`.

    With ``keep`` the recorded values are returned for comparison: gigabytes for an hour. With ``killed`` the files are
    left as after a kill of the recorder.
    """
    plan = plan or SessionPlan(**fields)
    folder.mkdir(parents=True)
    clock = _clock_of(plan)
    videos = _start_videos(folder, plan, killed=killed)
    log = EventLog(DiskFile(folder / "events.mcap"), anchor=clock.anchor, metadata={"program_version": "0.test"})
    plain = PlainFiles(folder, clock, on_full=lambda: False)
    audio = AudioWriter(folder, on_full=lambda: False)
    kept: list[tuple[int, Any]] = []

    def put(arrived_ns: int, value: Any) -> None:
        log.write(BY_TYPE[type(value)], value, arrived_ns)
        plain.add(value)
        if keep:
            kept.append((arrived_ns, value))

    flushed_ns = plan.started_ns
    for arrived_ns, value in values_of(plan):
        if arrived_ns - flushed_ns > _FLUSH_EVERY_NS:
            log.flush()
            flushed_ns = arrived_ns
        if isinstance(value, AudioChunk):
            for block in audio.write(value):
                put(arrived_ns, block)
            continue
        if isinstance(value, PhotoTaken):
            _write_photo(folder, value)
        if not (killed and isinstance(value, SessionEnded)):
            put(arrived_ns, value)
    if killed:
        log.flush()
        for file in (log.file, *audio.files()):
            file.close()
    else:
        for block in audio.close():
            put(plan.ended_ns, block)
        log.close()
    plain.close()
    _write_header(folder, plan, clock, videos(), audio.infos(), counts=log.counts, killed=killed)
    if not killed:
        write_manifest(folder)
    return RecordedSession(folder, plan, tuple(kept))


def rerecorded(made: RecordedSession, values: list[tuple[int, Any]]) -> RecordedSession:
    """The same session with other recorded values, in order of arrival."""
    path = made.folder / "events.mcap"
    path.unlink()
    log = EventLog(DiskFile(path), anchor=_clock_of(made.plan).anchor, metadata={})
    for arrived_ns, value in values:
        log.write(BY_TYPE[type(value)], value, arrived_ns)
    log.close()
    return RecordedSession(made.folder, made.plan, tuple(values))


def values_of(plan: SessionPlan) -> Iterator[tuple[int, Any]]:
    """All values with their arrival time at the console, ordered by it."""
    streams: list[Iterator[tuple[int, Any]]] = [
        _initial_values(plan),
        *(_frames(plan, camera) for camera in plan.cameras),
        _regular(plan, plan.scans_hz, _scan),
        _regular(plan, plan.odometry_hz, _odometry),
        _regular(plan, plan.odometry_hz / 2, _pose),
        _regular(plan, plan.people_hz, _people, after_ns=_PEOPLE_AFTER_NS),
        _regular(plan, plan.people_hz, _people_in_map, after_ns=_PEOPLE_AFTER_NS + 1),
        _regular(plan, plan.odometry_hz * 2, _command),
        _regular(plan, 1.0, _quality),
        _regular(plan, _rate(plan.battery_every_s), _battery),
        _regular(plan, _rate(plan.status_every_s), _drive_status),
        _regular(plan, _rate(plan.photo_every_s), _photo),
        *(iter(sorted(make(plan), key=_arrival)) for make in (_marks, _speech, _exchanges, _visits, _goals)),
        *(_sound(plan, source) for source in plan.audio),
        iter([(plan.ended_ns, SessionEnded(plan.ended_ns, "session", "wizard"))]),
    ]
    before_ns = plan.started_ns
    for arrived_ns, value in heapq.merge(*streams, key=_arrival):
        if arrived_ns > plan.ended_ns:
            return
        assert arrived_ns >= before_ns
        before_ns = arrived_ns
        yield arrived_ns, value


def _arrival(pair: tuple[int, Any]) -> int:
    return pair[0]


def picture_of(camera_number: int, number: int, size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """Frame with its number as bars in the upper third, which survive any compression, and a moving square."""
    image_bgr = _background(camera_number, size_px).copy()
    height_px, width_px = image_bgr.shape[:2]
    bars = np.where(number >> _bit_of_column(width_px) & 1, 235, 20).astype(np.uint8)
    image_bgr[: height_px // 3] = bars[None, :, None]
    side_px = max(4, height_px // 8)
    left = number * 2 % (width_px - side_px)
    image_bgr[height_px // 2 : height_px // 2 + side_px, left : left + side_px] = (40, 220, 240)
    return image_bgr


@cache
def _background(camera_number: int, size_px: tuple[int, int]) -> NDArray[np.uint8]:
    width_px, height_px = size_px
    image_bgr = np.empty((height_px, width_px, 3), np.uint8)
    image_bgr[:] = ((np.arange(width_px) * 200 // width_px) + 20)[None, :, None]
    image_bgr[:, :, camera_number % 3] = 90
    return image_bgr


@cache
def _bit_of_column(width_px: int) -> NDArray[np.int64]:
    return np.arange(width_px) * _NUMBER_BITS // width_px


def number_in(image_bgr: NDArray[np.uint8]) -> int:
    """Number drawn by :func:`picture_of`, also in a scaled-down frame."""
    height_px, width_px = image_bgr.shape[:2]
    number = 0
    for bit in range(_NUMBER_BITS):
        middle = (2 * bit + 1) * width_px // (2 * _NUMBER_BITS)
        if image_bgr[height_px // 12 : height_px // 4, middle].mean() > 128:
            number |= 1 << bit
    return number


def robot_pose(plan: SessionPlan, at_ns: int) -> Pose2D:
    """True pose of the robot, which drives in circles with pauses."""
    at_s = (at_ns - plan.started_ns) / 1e9
    driven_s = at_s - at_s % 20.0 / 2 if at_s % 20.0 > 10 else at_s
    angle = 0.1 * driven_s
    return Pose2D(8.0 + 4.0 * math.cos(angle), 5.0 + 3.0 * math.sin(angle), math.remainder(angle + math.pi / 2, 6.2832))


def _rate(every_s: float) -> float:
    return 1.0 / every_s if every_s else 0.0


def _regular(
    plan: SessionPlan,
    rate_hz: float,
    make: Callable[[SessionPlan, int, int], Any],
    *,
    after_ns: int = _REST_AFTER_NS,
) -> Iterator[tuple[int, Any]]:
    """``make(plan, number, stamp_ns)`` at a constant rate."""
    if not rate_hz:
        return
    for number in range(int(plan.seconds * rate_hz)):
        stamp_ns = plan.started_ns + round((number + 0.37) / rate_hz * SECOND_NS)
        yield stamp_ns + after_ns, make(plan, number, stamp_ns)


def _initial_values(plan: SessionPlan) -> Iterator[tuple[int, Any]]:
    """State at the start of recording: values with earlier stamps that are recorded at once."""
    start_ns, earlier_ns = plan.started_ns, plan.started_ns - 40 * SECOND_NS
    height, width = plan.map_cells
    cells = np.full(plan.map_cells, 0, np.int8)
    cells[0, :] = cells[-1, :] = cells[:, 0] = cells[:, -1] = 100
    cells[height // 3 : height // 3 + 4, width // 4 : width // 2] = 100
    scenario = (LAYOUTS / "tour-guide.yaml").read_text(encoding="utf-8")
    link = LinkStatus("connected", "Temi", "ws://robot.local:9090", "", 4.0, 2000.0, 3.0)
    yield start_ns, SessionStarted(start_ns, "session")
    for value in (
        OccupancyGrid(earlier_ns, plan.robot_stamp_ns(earlier_ns), 0.1, Pose2D(0.0, 0.0, 0.0), cells),
        BatteryState(earlier_ns, 0.93),
        LinkChanged(earlier_ns, "robot", "connected", "ws://robot.local:9090"),
        RobotChosen(earlier_ns, "temi", "Temi", "ws://robot.local:9090", "name: temi\n"),
        ScenarioOpened(
            earlier_ns, "tour-guide.yaml", "Tour guide", sha256(scenario.encode()).hexdigest(), content=scenario
        ),
        LayoutChanged(earlier_ns, json.dumps({"split": "horizontal", "children": []})),
        StatusShown(earlier_ns, "link", to_jsonable(link)),
        StatusShown(earlier_ns, "speech", to_jsonable(SpeechStatus(True, "espeak-ng"))),
    ):
        yield start_ns + 1000, value


def _frames(plan: SessionPlan, camera: str) -> Iterator[tuple[int, Any]]:
    for number, stamp in enumerate(plan.frame_stamps_ns(camera).tolist()):
        ref = FrameRef(stamp, plan.robot_stamp_ns(stamp), camera, "ring", number % 24, number + 1, *plan.size_px)
        yield stamp + _REST_AFTER_NS, ref


def _scan(plan: SessionPlan, number: int, stamp_ns: int) -> LaserScan:
    pose = robot_pose(plan, stamp_ns)
    angles = np.linspace(-math.pi, math.pi, plan.beams, endpoint=False) + pose.heading_rad
    with np.errstate(divide="ignore"):
        to_x = np.where(np.cos(angles) > 0, 16.0 - pose.x_m, pose.x_m) / np.abs(np.cos(angles))
        to_y = np.where(np.sin(angles) > 0, 10.0 - pose.y_m, pose.y_m) / np.abs(np.sin(angles))
    ranges_m = np.round(np.minimum(to_x, to_y), 3).astype(np.float32)
    ranges_m[number % plan.beams] = np.inf
    return LaserScan(
        stamp_ns=stamp_ns,
        robot_stamp_ns=plan.robot_stamp_ns(stamp_ns),
        frame_id="laser",
        angle_min_rad=-math.pi,
        angle_increment_rad=2 * math.pi / plan.beams,
        range_min_m=0.1,
        range_max_m=20.0,
        ranges_m=ranges_m,
        robot_from_laser=Pose2D(0.1, 0.0, 0.0),
        map_from_laser=pose,
    )


def _odometry(plan: SessionPlan, number: int, stamp_ns: int) -> Odometry:
    return Odometry(stamp_ns, plan.robot_stamp_ns(stamp_ns), robot_pose(plan, stamp_ns), _twist(plan, stamp_ns))


def _pose(plan: SessionPlan, number: int, stamp_ns: int) -> RobotPose:
    return RobotPose(stamp_ns, plan.robot_stamp_ns(stamp_ns), robot_pose(plan, stamp_ns))


def _twist(plan: SessionPlan, stamp_ns: int) -> Twist2D:
    driving = (stamp_ns - plan.started_ns) / 1e9 % 20.0 <= 10
    return Twist2D(0.4, 0.0, 0.1) if driving else Twist2D(0.0, 0.0, 0.0)


def _command(plan: SessionPlan, number: int, stamp_ns: int) -> CommandSent:
    return CommandSent(stamp_ns, number + 1, _twist(plan, stamp_ns), "keyboard" if number % 400 < 300 else "gamepad")


def _quality(plan: SessionPlan, number: int, stamp_ns: int) -> LinkQuality:
    wrong_ms = float(np.random.default_rng([plan.seed, 7, number]).uniform(-2.0, 2.0))
    return LinkQuality(stamp_ns, 6.0, round(plan.robot_offset_ms(stamp_ns) + wrong_ms, 3), 3.0)


def _battery(plan: SessionPlan, number: int, stamp_ns: int) -> BatteryState:
    return BatteryState(stamp_ns, round(0.92 - 0.001 * number % 0.9, 4))


def _drive_status(plan: SessionPlan, number: int, stamp_ns: int) -> StatusShown:
    status = DriveStatus(allowed=True, reason="", speed_fraction=(number % 10 + 1) / 10)
    return StatusShown(stamp_ns, "drive", to_jsonable(status))


def _photo(plan: SessionPlan, number: int, stamp_ns: int) -> PhotoTaken:
    return PhotoTaken(stamp_ns, plan.cameras[0], number + 1, f"photos/{number + 1:04d}.png")


def _person_id(plan: SessionPlan, number: int, stamp_ns: int) -> str:
    """Identity of a person; the first one is replaced by a new person every ``person_every_s``."""
    rounds = int((stamp_ns - plan.started_ns) / 1e9 / plan.person_every_s) if plan.person_every_s else 0
    return f"p-{1 + number + (rounds * plan.people if number == 0 else 0)}"


def _people(plan: SessionPlan, number: int, stamp_ns: int) -> People:
    at_s = (stamp_ns - plan.started_ns) / 1e9
    width_px, height_px = plan.size_px
    boxes = tuple(
        PersonBox(
            track=1 + person,
            person_id=_person_id(plan, person, stamp_ns),
            left_px=round((0.5 + 0.4 * math.sin(0.3 * at_s + person)) * 0.8 * width_px, 2),
            top_px=round(0.2 * height_px, 2),
            width_px=round(0.15 * width_px, 2),
            height_px=round(0.6 * height_px, 2),
            confidence=0.87,
        )
        for person in range(plan.people)
    )
    camera = plan.cameras[0] if plan.cameras else "front"
    return People(stamp_ns, camera, number + 1, width_px, height_px, boxes, 24.0)


def _people_in_map(plan: SessionPlan, number: int, stamp_ns: int) -> PeopleInMap:
    at_s = (stamp_ns - plan.started_ns) / 1e9
    return PeopleInMap(
        stamp_ns,
        tuple(
            PersonPlace(
                _person_id(plan, person, stamp_ns), round(5 + math.cos(0.2 * at_s + person), 3), 4.0, 0.2, "lidar"
            )
            for person in range(plan.people)
        ),
    )


def _times(plan: SessionPlan, every_s: float, *, margin_s: float) -> Iterator[tuple[int, int]]:
    count = int((plan.seconds - margin_s) / every_s) if every_s else 0
    for number in range(max(0, count)):
        yield number, plan.started_ns + round((number + 0.41) * every_s * SECOND_NS)


def _marks(plan: SessionPlan) -> Iterator[tuple[int, Any]]:
    for number, at_ns in _times(plan, plan.mark_every_s, margin_s=3.0):
        label, mark_id = _LABELS[number % len(_LABELS)], f"m{number + 1}"
        if number % 4 == 3:
            yield at_ns, Marked(at_ns, label, "wizard_error", mark_id, start_ns=at_ns - SECOND_NS, note="too slow")
        elif number % 4 == 2:
            until_ns = at_ns + 2 * SECOND_NS
            yield at_ns, Marked(at_ns, label, "mark", mark_id, start_ns=at_ns, state="open")
            yield until_ns, Marked(until_ns, label, "mark", mark_id, start_ns=at_ns, end_ns=until_ns)
        else:
            yield at_ns, Marked(at_ns, label, "mark", mark_id)


def _speech(plan: SessionPlan) -> Iterator[tuple[int, Any]]:
    for number, at_ns in _times(plan, plan.utterance_every_s, margin_s=5.0):
        speaker, text = UTTERANCES[number % len(UTTERANCES)]
        utterance_id, took_ns = f"u{number + 1}", round(min(0.06 * len(text), 3.0) * SECOND_NS)
        end_ns = at_ns + 100_000_000 + took_ns
        if speaker == "robot":
            for stamp_ns, state in ((at_ns, "requested"), (at_ns + 100_000_000, "started"), (end_ns, "finished")):
                yield stamp_ns, UtteranceChanged(stamp_ns, utterance_id, "robot", text, "typed", state, "espeak-ng")
        else:
            yield at_ns, UtteranceChanged(at_ns, utterance_id, "participant", "", "heard", "started")
            yield end_ns, UtteranceChanged(end_ns, utterance_id, "participant", text, "heard", "finished")


def _exchanges(plan: SessionPlan) -> Iterator[tuple[int, Any]]:
    for number, at_ns in _times(plan, plan.llm_every_s, margin_s=5.0):
        answered_ns, used_ns = at_ns + 900_000_000, at_ns + 2 * SECOND_NS
        exchange_id, question = f"x{number + 1}", UTTERANCES[(2 * number + 1) % len(UTTERANCES)][1]
        yield (
            answered_ns,
            LlmExchange(
                stamp_ns=answered_ns,
                exchange_id=exchange_id,
                provider="ollama",
                model="llama3.2",
                messages=(ChatMessage("system", "You are a friendly tour guide."), ChatMessage("user", question)),
                answer="It can carry about three kilograms.",
                outcome="answered",
                asked_ns=at_ns,
                first_token_ns=at_ns + 200_000_000,
                parameters={"temperature": 0.4, "max_tokens": 120},
                model_version="sha256:1a2b",
            ),
        )
        use = ("said", "edited", "dismissed")[number % 3]
        text = "" if use == "dismissed" else "About three kilograms."
        yield used_ns, AnswerUsed(used_ns, exchange_id, use, text)  # type: ignore[arg-type]


def _visits(plan: SessionPlan) -> Iterator[tuple[int, Any]]:
    at_ns = plan.started_ns + 500_000_000
    for person in range(plan.people):
        yield at_ns, PersonAppeared(at_ns, _person_id(plan, person, at_ns), 1 + person)
    if not (plan.people and plan.person_every_s):
        return
    for rounds in range(1, int(plan.seconds / plan.person_every_s) + 1):
        at_ns = plan.started_ns + round(rounds * plan.person_every_s * SECOND_NS) + SECOND_NS
        yield at_ns, PersonLeft(at_ns, f"p-{1 + (rounds - 1) * plan.people}", 1)
        yield at_ns, PersonAppeared(at_ns, f"p-{1 + rounds * plan.people}", 1)


def _goals(plan: SessionPlan) -> Iterator[tuple[int, Any]]:
    for number, at_ns in _times(plan, plan.goal_every_s, margin_s=10.0):
        for after_s, state in ((0.0, "requested"), (0.2, "active"), (9.0, "reached")):
            stamp_ns = at_ns + round(after_s * SECOND_NS)
            target = Pose2D(14.75, 2.0, 0.0)
            yield stamp_ns, GoalChanged(stamp_ns, f"g{number + 1}", state, target, "kitchen")  # type: ignore[arg-type]


_SAMPLE_RATE_HZ, _CHUNK_S = 16_000, 0.1
_SPEAKERS = {"robot voice": "robot", "microphone": "participant"}


def _sound(plan: SessionPlan, source: str) -> Iterator[tuple[int, Any]]:
    """Tone during speech, quiet noise otherwise; the microphone also records the robot's speech."""
    count = int(_SAMPLE_RATE_HZ * _CHUNK_S)
    rng = np.random.default_rng([plan.seed, 11])
    tone = 6000 * np.sin(np.arange(count) * 2 * math.pi * 220 / _SAMPLE_RATE_HZ)
    murmur = rng.normal(0.0, 60.0, count)
    spoken = [
        (begin_ns, end_ns, 1.0 if speaker == _SPEAKERS.get(source) else 0.3 if source == "microphone" else 0.0)
        for begin_ns, end_ns, speaker in _spoken(plan)
    ]
    for number in range(int((plan.seconds - 0.3) / _CHUNK_S)):
        stamp_ns = plan.started_ns + round((0.15 + number * _CHUNK_S) * SECOND_NS)
        while spoken and spoken[0][1] <= stamp_ns:
            spoken.pop(0)
        loud = spoken[0][2] if spoken and spoken[0][0] <= stamp_ns else 0.0
        samples = np.round(tone * loud + murmur).astype(np.int16)[:, None]
        arrived_ns = stamp_ns + round(_CHUNK_S * SECOND_NS)
        yield arrived_ns, AudioChunk(stamp_ns, source, _SAMPLE_RATE_HZ, samples)


def _spoken(plan: SessionPlan) -> list[tuple[int, int, str]]:
    """Start, end and speaker of each utterance."""
    begins: dict[str, int] = {}
    spoken = []
    for stamp_ns, event in _speech(plan):
        if event.state == "started":
            begins[event.utterance_id] = stamp_ns
        elif event.state == "finished":
            spoken.append((begins[event.utterance_id], stamp_ns, event.speaker))
    return spoken


def _clock_of(plan: SessionPlan) -> SessionClock:
    anchor = ClockAnchor(plan.started_ns - 100 * SECOND_NS, plan.started_utc_ns - 100 * SECOND_NS)
    return SessionClock(anchor, plan.started_ns)


def _start_videos(folder: Path, plan: SessionPlan, *, killed: bool) -> Callable[[], list[VideoInfo]]:
    """Write the videos, long ones in parallel; the returned function waits for them."""
    jobs = [(folder, plan, camera, killed) for camera in plan.cameras]
    if plan.seconds * plan.fps < 10_000:
        written = [_write_video(*job) for job in jobs]
        return lambda: written
    pool = ProcessPoolExecutor(2, mp_context=get_context("spawn"))
    futures = [pool.submit(_write_video, *job) for job in jobs]

    def wait() -> list[VideoInfo]:
        with pool:
            return [future.result() for future in futures]

    return wait


def _write_video(folder: Path, plan: SessionPlan, camera: str, killed: bool) -> VideoInfo:
    width_px, height_px = plan.size_px
    path = folder / video_file_name(camera, set())
    video = VideoFileWriter(
        path, width_px=width_px, height_px=height_px, encoder=FASTEST, clock=_clock_of(plan), on_full=lambda: False
    )
    number_of_camera = plan.cameras.index(camera)
    for number, (_, ref) in enumerate(_frames(plan, camera)):
        video.write(picture_of(number_of_camera, number, plan.size_px), ref)
    if killed:
        video.abandon()
    else:
        video.close()
    return VideoInfo(
        file_name=path.name,
        camera=camera,
        frames=video.frames,
        width_px=video.width_px,
        height_px=video.height_px,
        first_stamp_ns=video.first_stamp_ns,
        last_stamp_ns=video.last_stamp_ns,
        index_file=video.index.path.name,
        encoder=FASTEST.title,
        rate_hz=plan.fps,
        left_out=0,
    )


def _write_photo(folder: Path, photo: PhotoTaken) -> None:
    import cv2

    path = folder / photo.file_name
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), picture_of(0, photo.frame_sequence, (160, 90)))


def _write_header(
    folder: Path,
    plan: SessionPlan,
    clock: SessionClock,
    videos: list[VideoInfo],
    sounds: tuple[AudioInfo, ...],
    *,
    counts: Counter[str],
    killed: bool,
) -> None:
    data = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "program_version": "0.test",
        "scenario": {"title": "Tour guide", "file": "tour-guide.yaml", "sha256": ""},
        "robot": {"profile": "temi", "address": "ws://robot.local:9090"},
        "trial": plan.trial,
        "software": {"caris-desktop": "0.test", "python": "3.11"},
        "settings": {},
        "clock": asdict(clock.anchor),
        "started_ns": plan.started_ns,
        "started_utc": clock.utc(plan.started_ns),
        "ended_ns": None if killed else plan.ended_ns,
        "ended_utc": None if killed else clock.utc(plan.ended_ns),
        "duration_s": None if killed else round(plan.seconds, 3),
        "reason": None if killed else "wizard",
        "pauses": [],
        "counts": {} if killed else dict(sorted(counts.items())),
        "dropped": {},
        "videos": [] if killed else [asdict(video) for video in videos],
        "audio": [] if killed else [asdict(sound) for sound in sounds],
        "files": []
        if killed
        else [
            {"name": name, "bytes": (folder / name).stat().st_size}
            for name in session_files(folder)
            if name != "session.json"
        ],
    }
    replace_file(folder / "session.json", (json.dumps(data, indent=2) + "\n").encode(), durable=False)
