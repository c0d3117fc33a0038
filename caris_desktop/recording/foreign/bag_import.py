"""Import of foreign bags as session folders, for replay, annotation and export."""

import json
import logging
import math
import shutil
import tempfile
from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from caris_desktop import __version__
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import SessionEnded, SessionStarted
from caris_desktop.domain.file_replacement import no_room
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.foreign.bag_files import (
    REORDER_NS,
    Bag,
    BagChannel,
    BagError,
    BagMessage,
    ReadNotes,
    in_order_of_time,
    open_bag,
    sorted_by_time,
)
from caris_desktop.recording.foreign.bag_messages import MessageReader, NotUnderstoodError
from caris_desktop.recording.foreign.bag_values import (
    SESSION_TOPIC,
    BagPicture,
    MessageConverter,
    TopicMapping,
    TopicRole,
    has_mountings,
    map_bag_topics,
)
from caris_desktop.recording.recorder.event_log import EventLog
from caris_desktop.recording.recorder.plain_files import PlainFiles
from caris_desktop.recording.recorder.video_writer import VideoFileWriter, x264
from caris_desktop.recording.session.manifest import write_manifest
from caris_desktop.recording.session.media_files import video_file_name
from caris_desktop.recording.session.session_header import (
    SessionClock,
    SessionError,
    SessionHeader,
    VideoInfo,
    header_of,
    recorded_files,
)
from caris_desktop.ros.message_fields import MessageError, message_of, text

_log = logging.getLogger(__name__)
REASON = "imported"
_FIRST_STAMP_NS = 1_000_000_000
_LATEST_UTC_NS = 4_102_444_800_000_000_000  # the year 2100
_NEAR_NS = 3600 * 1_000_000_000
_MINUTE_NS = 60 * 1_000_000_000
_MOST_MINUTES = 500_000
_MOST_STRAYS, _FEW = 10, 20
"""So few messages, and less than a twentieth of all, far from the others are a fault and no part of the recording."""
_APART_NS = 1_000_000_000
_STEADY, _LOOKED_BACK, _MOST_WAITING = 3, 100, 10_000
"""So many messages of a topic tell a clock that was set from one wrong stamp, at most so many of all until then; rare
messages before the first of them belong to the new time, too.
"""
_SURVEY_SHARE = 0.2
_TELL_EVERY = 100
_FLUSH_EVERY_NS = 1_000_000_000
_SUFFIX = ".importing"
_SIMULATED_BEFORE_NS = 631_152_000_000_000_000  # the year 1990
_MAX_TOPICS_TOLD = 1000
_MAX_MOUNTS, _MAX_MOUNT_BYTES = 1000, 100_000


class TopicReport(Value):
    """Result for one topic: ``became`` is its stream; empty if ``reason`` says why it was not used.

    ``used`` of ``messages`` could be read; then ``reason`` is the error of the first one that could not.
    """

    topic: str
    type: str
    messages: int
    used: int
    became: str = ""
    reason: str = ""


class ImportReport(Value):
    """Imported bag. ``values`` counts written values per stream; ``notes`` are sentences."""

    folder: Path
    kind: str
    started_utc: str
    duration_s: float
    values: dict[str, int]
    topics: tuple[TopicReport, ...]
    notes: tuple[str, ...] = field(default=())

    @property
    def not_understood(self) -> tuple[TopicReport, ...]:
        return tuple(topic for topic in self.topics if not topic.became)


def import_bag(path: Path, folder: Path, progress: Callable[[float], None] = lambda _fraction: None) -> ImportReport:
    """Convert the bag at ``path`` to a session in ``folder``, which must not exist; the bag's folder is not written to.

    ``path`` is a ROS 1 ``.bag``, a rosbag2 folder or file (SQLite or MCAP), or an MCAP file with ROS messages.
    ``progress`` gets 0..1; if it raises, the import is cancelled and removed.

    Raises BagError if the bag cannot be read, or holds nothing that this program knows, or ``folder`` cannot be made.
    """
    path, folder = path.absolute(), folder.absolute()
    if folder.exists() or folder.is_symlink():
        raise BagError(f"{folder} already exists. Nothing was written; choose another name.")
    if path.is_dir() and path.resolve() in (folder.parent.resolve(), *folder.parent.resolve().parents):
        raise BagError(f"{folder} would be inside the bag. Nothing was written; choose another folder.")
    partial: Path | None = None
    try:
        # A file is opened before any folder is created; a rosbag2 folder may need scratch space for decompression.
        file = None if path.is_dir() else open_bag(path, scratch=Path())
        folder.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name[:80]}.", suffix=_SUFFIX))
        scratch = partial / ".scratch"
        scratch.mkdir()
        place = partial / folder.name
        place.mkdir()
        bag = file or open_bag(path, scratch=scratch)
        report = _import(bag, path, folder, place, scratch, progress)
        place.rename(folder)
    except OSError as error:
        _log.info("importing %s", path, exc_info=True)
        advice = " Free some room, or choose another disk." if no_room(error) else ""
        raise BagError(
            f"{path} could not be imported: {error.strerror or error}. Nothing was saved.{advice}"
        ) from error
    finally:
        if partial is not None:
            shutil.rmtree(partial, ignore_errors=True)
    progress(1.0)
    return report


@dataclass(slots=True)
class _Survey:
    """Result of a first pass over the whole bag. Times are UTC as in the bag."""

    counts: Counter[BagChannel]
    steps: "_ClockSteps"
    first_ns: int = _LATEST_UTC_NS
    last_ns: int = 0
    own_session: SessionHeader | None = None
    mounts: list[tuple[BagChannel, bytes]] = field(default_factory=list)
    stretches: list["_BagPart"] = field(default_factory=list)
    in_order: bool = True

    def moved(self, messages: Iterable[BagMessage]) -> Iterator[BagMessage]:
        """Messages without hour-long gaps between them, in order where the clock was set back, and without strays."""
        firsts = [(stretch.run, stretch.first_ns) for stretch in self.stretches]
        for number, message in enumerate(messages):
            run = self.steps.run_of(number)
            at = bisect_right(firsts, (run, message.at_ns)) - 1
            stretch = self.stretches[at] if at >= 0 else None
            if stretch is None or stretch.run != run or stretch.moved_ns is None or message.at_ns > stretch.last_ns:
                continue
            yield message._replace(at_ns=message.at_ns + stretch.moved_ns)


class _ClockSteps:
    """Places in the file where the clock was set back: the times of a topic go back there and stay so."""

    def __init__(self) -> None:
        self._firsts: list[int] = []
        self._recent: dict[BagChannel, deque[int]] = {}
        self._back: dict[BagChannel, list[int]] = {}
        self.waiting: deque[tuple[int, int]] = deque()
        """Numbers and times of the last messages."""

    def run_of(self, number: int) -> int:
        """Number of steps before a message."""
        return bisect_right(self._firsts, number)

    def process(self, number: int, message: BagMessage) -> Iterator[tuple[int, int]]:
        """Numbers and times of earlier messages whose run is known now."""
        self.waiting.append((number, message.at_ns))
        recent = self._recent.setdefault(message.channel, deque(maxlen=_STEADY))
        before_ns = min(recent) - REORDER_NS if len(recent) == _STEADY else 0
        if message.at_ns < before_ns:
            self._back.setdefault(message.channel, []).append(number)
        else:
            self._back.pop(message.channel, None)
            recent.append(message.at_ns)
        if len(self._back.get(message.channel, ())) == _STEADY:
            first = min(numbers[0] for numbers in self._back.values())
            for earlier, at_ns in reversed(self.waiting):
                if earlier < first and at_ns >= before_ns:
                    break
                first = min(first, earlier)
            self._firsts.append(first)
            self._recent.clear()
            self._back.clear()
        undecided = _MOST_WAITING if self._back else _LOOKED_BACK
        while len(self.waiting) > undecided:
            yield self.waiting.popleft()


@dataclass(slots=True)
class _BagPart:
    """Part of a bag without hour-long gaps. ``run`` counts the times that the clock was set back before it; ``number``
    is that of its first message in the file; ``moved_ns`` shifts its times, None if it is left out.
    """

    run: int
    first_ns: int
    last_ns: int
    count: int
    number: int
    moved_ns: int | None = 0


def _import(  # noqa: PLR0917 - all of one call
    bag: Bag, path: Path, folder: Path, place: Path, scratch: Path, progress: Callable[[float], None]
) -> ImportReport:
    notes = ReadNotes()
    survey = _surveyed(bag, path, notes, progress)
    readers: dict[BagChannel, MessageReader] = {}
    unreadable: dict[BagChannel, str] = {}
    for channel in survey.counts:
        try:
            readers[channel] = MessageReader(channel)
        except NotUnderstoodError as error:
            unreadable[channel] = str(error)
    casting = map_bag_topics(survey.counts, unreadable, from_caris=survey.own_session is not None)
    if not any(role.kind not in ("session", "camera_info") for role in casting.roles.values()):
        names = ", ".join(sorted({channel.type or "no type" for channel in survey.counts})[:8])
        raise BagError(
            f"{path.name} contains no supported data ({len(survey.counts)} topics of the types {names}). "
            "Nothing was written."
        )
    origin = survey.own_session
    anchor = origin.clock if origin is not None else ClockAnchor(_FIRST_STAMP_NS, survey.first_ns)
    clock = SessionClock(anchor, origin.started_ns if origin is not None else anchor.monotonic_ns)
    writer = _SessionWriter(place, clock)
    maker = MessageConverter(casting.roles.values(), origin)
    used: Counter[BagChannel] = Counter()
    faults: dict[BagChannel, str] = {}
    try:
        writer.put(SessionStarted(clock.started_ns, folder.name), clock.started_ns)
        for channel, data in survey.mounts:
            if channel in casting.roles:
                # Errors are noted in the second pass.
                with suppress(MessageError):
                    maker.take_mounts(readers[channel].read(data))
        messages = survey.moved(bag.messages(notes))
        in_order = in_order_of_time(messages) if survey.in_order else sorted_by_time(messages, scratch)
        for number, message in enumerate(in_order):
            if not number % _TELL_EVERY:
                progress(_SURVEY_SHARE + (1.0 - _SURVEY_SHARE) * min(1.0, message.fraction))
            role = casting.roles.get(message.channel)
            if role is None:
                continue
            stamp_ns = anchor.monotonic_ns + (message.at_ns - anchor.utc_ns)
            try:
                for value in maker.make(role, readers[message.channel].read(message.data), stamp_ns, message.channel):
                    writer.put(value, stamp_ns)
                used[message.channel] += 1
            except MessageError as error:
                faults.setdefault(message.channel, str(error))
        last_ns = anchor.monotonic_ns + (survey.last_ns - anchor.utc_ns)
        ended_ns = max(last_ns, clock.started_ns)
        if origin is not None and origin.ended_ns is not None and ended_ns < origin.ended_ns < ended_ns + _NEAR_NS:
            ended_ns = origin.ended_ns
        if not writer.counts["pose"] and all(casting.roles[channel].kind in ("tf", "session") for channel in used):
            first = next(iter(faults.values()), "no message could be read")
            raise BagError(  # noqa: TRY301 - its files are closed as for any other error
                f"{path.name} contains no usable message ({first}). Nothing was written."
            )
        videos = writer.close(SessionEnded(ended_ns, folder.name, REASON))
    except BaseException:
        writer.abandon()
        raise
    _add_notes(notes, writer, maker, survey)
    topics = _topics(survey, casting, used, faults)
    report = ImportReport(
        folder=folder,
        kind=bag.kind,
        started_utc=clock.utc(clock.started_ns),
        duration_s=clock.session_s(ended_ns),
        values=dict(sorted(writer.counts.items())),
        topics=topics,
        notes=tuple(notes.sentences),
    )
    known = SessionHeader(anchor) if origin is None else origin
    header = SessionHeader(anchor, program_version=__version__, scenario=known.scenario, trial=known.trial)
    source = {
        "kind": report.kind,
        "name": path.name,
        "imported_utc": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        "topics": [asdict(topic) for topic in report.topics[:_MAX_TOPICS_TOLD]],
        "not_understood": [topic.topic for topic in report.not_understood[:_MAX_TOPICS_TOLD]],
        "notes": list(report.notes),
    }
    header.started(clock.started_ns).ended(
        ended_ns, REASON, counts=dict(report.values), videos=videos, source=source, files=recorded_files(place)
    ).write(place)
    write_manifest(place)
    return report


def _surveyed(bag: Bag, path: Path, notes: ReadNotes, progress: Callable[[float], None]) -> _Survey:
    """Read every message once for topics and times; problems are noted in the second pass."""
    survey = _Survey(Counter(), _ClockSteps())
    minutes = _Minutes(survey, notes)
    without_time = 0
    for number, message in enumerate(bag.messages(notes)):
        if not number % _TELL_EVERY:
            progress(_SURVEY_SHARE * min(1.0, message.fraction))
        survey.counts[message.channel] += 1
        few = len(survey.mounts) < _MAX_MOUNTS and len(message.data) < _MAX_MOUNT_BYTES
        if has_mountings(message.channel) and few:
            survey.mounts.append((message.channel, message.data))
        if not 0 < message.at_ns < _LATEST_UTC_NS:
            without_time += 1
            continue
        minutes.add(survey.steps.process(number, message))
        if survey.own_session is None and message.channel.topic == SESSION_TOPIC:
            survey.own_session = _own_session(message)
    minutes.add(survey.steps.waiting)
    if without_time:
        notes.add(f"{without_time} message{'s' * (without_time != 1)} with a zero or invalid time were skipped.")
    survey.stretches = _intervals(minutes.parts)
    if survey.own_session is None:
        _take_out_gaps(survey.stretches, notes)
    used = [(each, each.moved_ns) for each in survey.stretches if each.moved_ns is not None]
    survey.first_ns = min((each.first_ns + moved_ns for each, moved_ns in used), default=_LATEST_UTC_NS)
    survey.last_ns = max((each.last_ns + moved_ns for each, moved_ns in used), default=0)
    if not survey.counts or not survey.last_ns:
        note = f" {notes.sentences[0]}" if notes.sentences else ""
        raise BagError(f"{path.name} contains no messages.{note} Nothing was written.")
    if survey.last_ns < _SIMULATED_BEFORE_NS:
        notes.add("The bag uses simulation time: its dates are not the dates of the recording.")
    return survey


class _Minutes:
    """Parts of a bag by run and minute."""

    def __init__(self, survey: _Survey, notes: ReadNotes) -> None:
        self._survey, self._notes = survey, notes
        self._parts: dict[tuple[int, int], _BagPart] = {}
        self._newest_ns: dict[int, int] = {}
        self._jumped = False

    @property
    def parts(self) -> list[_BagPart]:
        return [self._parts[key] for key in sorted(self._parts)]

    def add(self, messages: Iterable[tuple[int, int]]) -> None:
        """Add messages, given by number and time."""
        for number, at_ns in messages:
            run = self._survey.steps.run_of(number)
            newest_ns = self._newest_ns.get(run, 0)
            if newest_ns - at_ns > REORDER_NS:
                self._survey.in_order = False
            # One message hours ahead is a wrong stamp, to which the others are compared in vain.
            self._jumped = at_ns - newest_ns >= _NEAR_NS and not self._jumped
            if not self._jumped:
                self._newest_ns[run] = max(newest_ns, at_ns)
            part = self._parts.get((run, at_ns // _MINUTE_NS))
            if part is not None:
                part.first_ns, part.last_ns = min(part.first_ns, at_ns), max(part.last_ns, at_ns)
                part.count += 1
            elif len(self._parts) < _MOST_MINUTES:
                self._parts[run, at_ns // _MINUTE_NS] = _BagPart(run, at_ns, at_ns, 1, number)
            else:
                self._notes.add("The times in the bag are spread too widely; messages at further times were skipped.")


def _intervals(minutes: list[_BagPart]) -> list[_BagPart]:
    """Merge parts of one run that no hour-long gap separates."""
    joined: list[_BagPart] = []
    for minute in minutes:
        if joined and joined[-1].run == minute.run and minute.first_ns - joined[-1].last_ns < _NEAR_NS:
            last = joined[-1]
            last.last_ns, last.count = minute.last_ns, last.count + minute.count
            last.number = min(last.number, minute.number)
        else:
            joined.append(minute)
    return joined


def _take_out_gaps(stretches: list[_BagPart], notes: ReadNotes) -> None:
    """Close hour-long gaps: a clock set while recording, or one wrong stamp, would make a session of years. The largest
    part keeps its times; the others follow in file order, a second apart, also those of a clock that was set back.
    """
    total = sum(stretch.count for stretch in stretches)
    of_run = Counter(stretch.run for stretch in stretches)
    for stretch in stretches:
        if stretch.count <= _MOST_STRAYS and stretch.count * _FEW < total and of_run[stretch.run] > 1:
            stretch.moved_ns = None
            notes.add(
                f"{stretch.count} message{'s' * (stretch.count != 1)} of {_utc_text(stretch.first_ns)} UTC, hours from"
                " all others, were skipped: their time is wrong."
            )
    used = sorted((each for each in stretches if each.moved_ns is not None), key=lambda stretch: stretch.number)
    largest = max(used, key=lambda stretch: stretch.count, default=None)
    if largest is None:
        return
    at = used.index(largest)
    starts_ns, ends_ns = largest.first_ns, largest.last_ns
    for stretch in reversed(used[:at]):
        stretch.moved_ns = starts_ns - _APART_NS - stretch.last_ns
        starts_ns = stretch.first_ns + stretch.moved_ns
    for stretch in used[at + 1 :]:
        stretch.moved_ns = ends_ns + _APART_NS - stretch.first_ns
        ends_ns = stretch.last_ns + stretch.moved_ns
    for stretch in used:
        if not stretch.moved_ns:
            continue
        if abs(stretch.moved_ns) < _NEAR_NS:
            notes.add(
                f"The clock was set back during the recording: the times from {_utc_text(stretch.first_ns)} to"
                f" {_utc_text(stretch.last_ns)} UTC ({stretch.count} messages) were moved by"
                f" {stretch.moved_ns / 1e9:.1f} s, in the order of the file."
            )
        else:
            notes.add(
                f"The times from {_utc_text(stretch.first_ns)} to {_utc_text(stretch.last_ns)} UTC"
                f" ({stretch.count} messages) are hours from the others, probably because the clock was set during"
                f" the recording: the gap of {abs(stretch.moved_ns) / 3.6e12:.1f} hours was removed."
            )


def _utc_text(at_ns: int) -> str:
    return f"{datetime.fromtimestamp(at_ns // 1_000_000_000, UTC):%Y-%m-%d %H:%M:%S}"


def _own_session(message: BagMessage) -> SessionHeader | None:
    """Header of the original session in the message of ``/caris/session``; None if it is not from our export."""
    try:
        content = text(message_of(MessageReader(message.channel).read(message.data), "String"), "data", "String")
        origin = header_of(json.loads(content), Path(SESSION_TOPIC))
    except (NotUnderstoodError, MessageError, SessionError, TypeError, ValueError, RecursionError):
        _log.info("%s does not describe a session", SESSION_TOPIC, exc_info=True)
        return None
    # Implausible times: the mapping would not match the messages.
    sane = 0 <= origin.clock.monotonic_ns < _LATEST_UTC_NS and 0 <= origin.started_ns < _LATEST_UTC_NS
    return origin if sane and abs(origin.clock.utc_ns_at(origin.started_ns) - message.at_ns) < _NEAR_NS else None


class _SessionWriter:
    """Session folder being filled."""

    def __init__(self, folder: Path, clock: SessionClock) -> None:
        self._folder = folder
        self._clock = clock
        self._log = EventLog(
            DiskFile(folder / "events.mcap"), anchor=clock.anchor, metadata={"program_version": __version__}
        )
        self._plain = PlainFiles(folder, clock, on_full=lambda: False)
        self._videos: dict[str, VideoFileWriter] = {}
        self._names: set[str] = set()
        self._sequences: Counter[str] = Counter()
        self._finished: list[VideoInfo] = []
        self._waiting: dict[type[Any], tuple[Any, int]] = {}
        self._written_ns: dict[type[Any], int] = {}
        self._flushed_ns = clock.started_ns
        self.without_video: dict[str, str] = {}

    @property
    def counts(self) -> Counter[str]:
        return self._log.counts

    def put(self, value: Any, arrived_ns: int) -> None:
        """Write a value. Raises OSError."""
        if self._waiting:
            self._put_waiting(arrived_ns)
        if isinstance(value, BagPicture):
            self._put_picture(value, arrived_ns)
            return
        spec = BY_TYPE[type(value)]
        due_ns = self._written_ns.get(type(value), -_LATEST_UTC_NS) + round(spec.record_every_s * 1e9)
        if spec.record_every_s and arrived_ns < due_ns:
            self._waiting[type(value)] = (value, due_ns)
            return
        self._write(value, arrived_ns)

    def close(self, end: SessionEnded) -> tuple[VideoInfo, ...]:
        """Finish the session. Raises OSError."""
        self._put_waiting(end.stamp_ns, all_of_them=True)
        for camera in tuple(self._videos):
            self._close_video(camera)
        self._write(end, end.stamp_ns)
        self._log.close()
        self._plain.close()
        return tuple(self._finished)

    def abandon(self) -> None:
        """Close the files of a folder that will be removed."""
        for video in self._videos.values():
            video.abandon()
        self._videos.clear()
        for closing in (self._log.file.close, self._plain.close):
            try:
                closing()
            except (OSError, ValueError):
                _log.debug("closing an import that is thrown away", exc_info=True)

    def _write(self, value: Any, arrived_ns: int) -> None:
        try:
            self._log.write(BY_TYPE[type(value)], value, arrived_ns)
        except (TypeError, ValueError) as error:
            raise MessageError(f"it contains data that cannot be recorded: {error}") from error
        self._written_ns[type(value)] = arrived_ns
        self._plain.add(value)
        if arrived_ns - self._flushed_ns >= _FLUSH_EVERY_NS:
            self._flushed_ns = arrived_ns
            self._log.flush()

    def _put_waiting(self, now_ns: int, *, all_of_them: bool = False) -> None:
        """Write held-back large values: the newest of each second."""
        for kind, (value, due_ns) in list(self._waiting.items()):
            if all_of_them or now_ns >= due_ns:
                del self._waiting[kind]
                self._write(value, now_ns)

    def _put_picture(self, picture: BagPicture, arrived_ns: int) -> None:
        camera = picture.camera
        if camera in self.without_video:
            raise MessageError(f"the video of this camera has ended: {self.without_video[camera]}")
        height_px, width_px = picture.image_bgr.shape[:2]
        sequence = self._sequences[camera] + 1
        ref = FrameRef(arrived_ns, picture.robot_stamp_ns, camera, "", 0, sequence, width_px, height_px)
        try:
            self._video_for(camera, width_px, height_px).write(picture.image_bgr, ref)
        except OSError:
            raise
        except Exception as error:
            # PyAV raises its own error types; other cameras continue.
            _log.warning("video of %s", camera, exc_info=True)
            self.without_video[camera] = str(error)
            if camera in self._videos:
                self._close_video(camera)
            raise MessageError(f"it cannot be encoded: {error}") from error
        self._sequences[camera] = sequence
        self._write(ref, arrived_ns)

    def _video_for(self, camera: str, width_px: int, height_px: int) -> VideoFileWriter:
        video = self._videos.get(camera)
        if video is not None and (video.width_px, video.height_px) == (width_px // 2 * 2, height_px // 2 * 2):
            return video
        if video is not None:
            self._close_video(camera)
        name = video_file_name(camera, self._names)
        video = VideoFileWriter(
            self._folder / name,
            width_px=width_px,
            height_px=height_px,
            encoder=x264("veryfast"),
            clock=self._clock,
            on_full=lambda: False,
        )
        self._names.add(name)
        self._videos[camera] = video
        return video

    def _close_video(self, camera: str) -> None:
        video = self._videos.pop(camera)
        video.close()
        self._finished.append(video.info(camera))


def _add_notes(notes: ReadNotes, writer: _SessionWriter, maker: MessageConverter, survey: _Survey) -> None:
    for frame in sorted(maker.lasers_without_place):
        notes.add(
            f"The position of the laser '{frame}' on the robot is unknown: its scans are imported, but not drawn."
        )
    if maker.odometry_without_pose:
        notes.add(
            f"{maker.odometry_without_pose} odometry messages have no rotation (a zero quaternion): their speed "
            "is imported, and their pose is computed from it."
        )
    if maker.unusable_transforms:
        which = ", ".join(sorted(maker.unusable_transforms)[:10])
        notes.add(f"Transforms without a rotation or position were skipped: {which}.")
    for frame, tilt_rad in sorted(maker.tilted_lasers.items()):
        notes.add(
            f"The laser '{frame}' is tilted by {math.degrees(tilt_rad):.0f} degrees: its scans are imported, "
            "but not drawn."
        )
    for camera, reason in writer.without_video.items():
        notes.add(f"The video of the camera {camera} ended early: {reason}.")
    if survey.own_session is None:
        notes.add(
            "Times are from the bag's clock. The robot's own timestamps are stored in addition; the offset "
            "between the two clocks is unknown."
        )


def _topics(
    survey: _Survey, casting: TopicMapping, used: Counter[BagChannel], faults: dict[BagChannel, str]
) -> tuple[TopicReport, ...]:
    reports = []
    for channel, count in sorted(survey.counts.items(), key=lambda item: (item[0].topic, item[0].type)):
        role: TopicRole | None = casting.roles.get(channel)
        became = role.stream if role is not None and used[channel] else ""
        reason = faults.get(channel, "") if role is not None else casting.reasons.get(channel, "")
        reports.append(TopicReport(channel.topic, channel.type, count, used[channel], became, reason))
    return tuple(reports)
