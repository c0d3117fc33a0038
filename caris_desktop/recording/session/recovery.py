"""Missing data of a session, and crash recovery: makes all saved data usable without overwriting any.

Replaced files are preserved in the folder ``recovered``.
"""

import json
import logging
import os
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import field, replace
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from caris_desktop.domain.events import Gap, RecordingPaused, SessionEnded
from caris_desktop.domain.file_replacement import bring_to_disk, no_room, replace_file
from caris_desktop.domain.free_names import free_path
from caris_desktop.domain.json_encoding import TRANSFORMS_TOPIC, from_message, schema_of, to_message
from caris_desktop.domain.sensing import AudioBlock, FrameRef
from caris_desktop.domain.streams import BY_TYPE, spec_of_topic
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.session import events_file, media_files
from caris_desktop.recording.session import loss_messages as words
from caris_desktop.recording.session.events_file import MAGIC, AddedMessage, BlockIndex, rewrite
from caris_desktop.recording.session.folder_lock import FolderHeldError, hold
from caris_desktop.recording.session.loss_messages import (
    lost_values_words,
    new_index_words,
    unread_bytes_words,
    unsaved_pictures_words,
)
from caris_desktop.recording.session.manifest import MANIFEST_NAME, forget_counts, progress_counts, write_manifest
from caris_desktop.recording.session.media_files import (
    camera_of_video,
    content_of,
    index_path,
    read_frame_times,
)
from caris_desktop.recording.session.session_header import (
    HEADER_NAME,
    AudioInfo,
    RecordedFile,
    RecordedPause,
    SessionError,
    SessionHeader,
    VideoInfo,
    inside,
    read_header,
    reading,
    recorded_files,
)

_EVENTS = "events.mcap"
_MAX_TOLD = 5


def losses_of(folder: Path, header: SessionHeader, missing: Mapping[str, int]) -> tuple[str, ...]:
    """A sentence for each known data loss; empty if there is none.

    Includes the findings of a repair, :func:`missing values <missing_values>`, and files that are missing or shorter
    than at the close. Other changes are a matter of checksums.
    """
    return (*header.losses, *missing_words(header, missing), *_files_lacking(folder, header))


def missing_words(header: SessionHeader, missing: Mapping[str, int]) -> tuple[str, ...]:
    """Sentence on the number of missing values; empty if none are."""
    count = sum(missing.values())
    if not count:
        return ()
    recorded = max(count, sum(header.counts.values()))
    return (localized(words.lost_values_words(count, broken=False, early=False), recorded=recorded),)


def missing_values(folder: Path, header: SessionHeader) -> Counter[str]:
    """Missing values per stream: counted in the header of a closed session and no longer in its log.

    Excludes those that a repair found missing, since it counted the rest. Raises OSError.
    """
    if header.ended_ns is None or not header.counts:
        return Counter()
    expected = Counter(header.counts)
    path = folder / _EVENTS
    index = events_file.read_index(path)
    of_channel: Counter[int] = Counter()
    with path.open("rb") as file:
        for content in events_file.intact_blocks(file, index):
            of_channel.update(events_file.channels_in(content))
    found: Counter[str] = Counter()
    for channel, count in of_channel.items():
        its = index.channels.get(channel)
        if its is None or its.topic == TRANSFORMS_TOPIC:
            continue
        spec = spec_of_topic(its.topic)
        name = its.topic.removeprefix("/") if spec is None else spec.name
        if spec is None:
            name = next((one for one in expected if name.startswith(f"{one}/")), name)
        found[name] += count
    return expected - found


def _files_lacking(folder: Path, header: SessionHeader) -> tuple[str, ...]:
    """A sentence for each file that is missing or shorter than the header of a closed session says."""
    sentences: list[str] = []
    others: list[str] = []
    for recorded in header.files if header.ended_ns is not None else ():
        pure = PurePosixPath(recorded.name)
        if not recorded.name or pure.is_absolute() or ".." in pure.parts:
            continue
        path = folder / recorded.name
        try:
            found_bytes = path.stat().st_size
        except (OSError, ValueError):
            found_bytes = -1
        if found_bytes >= recorded.bytes:
            continue
        problem = _medium(path, header, found_bytes, recorded.bytes)
        if problem:
            sentences.append(problem)
        else:
            left = words.FILE_MISSING if found_bytes < 0 else words.FILE_SHORTER
            others.append(localized(left, file=recorded.name, left=found_bytes, all=recorded.bytes))
    sentences += others[:_MAX_TOLD]
    if len(others) > _MAX_TOLD:
        sentences.append(words.further_files_words(len(others) - _MAX_TOLD))
    return tuple(sentences)


def _medium(path: Path, header: SessionHeader, found_bytes: int, recorded_bytes: int) -> str:
    """Loss of a video or audio file in frames and seconds; empty for other files."""
    for video in header.videos:
        if video.file_name == path.name:
            content = content_of(path) if found_bytes >= 0 else None
            left = 0 if content is None else len(content.times_s)
            if left < video.frames:  # otherwise it was encoded again
                message = words.VIDEO_MISSING if found_bytes < 0 else words.pictures_left_words(left)
                return localized(message, file=path.name, count=video.frames, camera=video.camera)
    for sound in header.audio:
        if sound.file_name == path.name:
            lasts_s = sound.samples / max(1, sound.sample_rate_hz)
            left_s = lasts_s * found_bytes / max(1, recorded_bytes)
            message = words.SOUND_MISSING if found_bytes < 0 else words.SOUND_CUT_OFF
            return localized(message, file=path.name, seconds=f"{lasts_s:.1f}", left=f"{left_s:.1f}")
    return ""


_log = logging.getLogger(__name__)
KEPT_FOLDER = "recovered"
_COPIED_BYTES = 1 << 20
_REWRITTEN = f".{_EVENTS}.part"
# Sessions of version 1 were closed without a manifest.
_MANIFEST_SINCE = 2
_LOOKED_AT = (FrameRef, AudioBlock, Gap, RecordingPaused, SessionEnded)


class RepairReport(Value):
    """``sentences`` list the repairs, or why they failed, as user texts; empty if none were needed."""

    repaired: bool
    sentences: tuple[str, ...] = ()


@dataclass(slots=True)
class _Record:
    """Data on the session's media from its events. ``highest`` is the highest sequence number per stream: the recorder
    counts from 1, so that gaps show.
    """

    counts: Counter[str] = field(default_factory=Counter)
    highest: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    frames: dict[str, list[FrameRef]] = field(default_factory=dict)
    sounds: dict[str, AudioBlock] = field(default_factory=dict)
    pauses: list[RecordingPaused] = field(default_factory=list)
    ended: SessionEnded | None = None
    newest_utc_ns: int = 0
    last_value_utc_ns: int = 0


def needs_repair(folder: Path) -> bool:
    """True for a session that was not closed properly or is being recorded. Raises SessionError."""
    return bool(_wanting(folder, read_header(folder)))


def repair_session(folder: Path) -> RepairReport:
    """Repair the session in ``folder`` if needed. Idempotent; a kill does no harm.

    Raises SessionError if ``folder`` is no session that this program can read, or one that is still being recorded.
    """
    wanting = _wanting(folder, read_header(folder))
    if not wanting:
        return RepairReport(False)
    try:
        lock = hold(folder)
    except FolderHeldError as error:
        if wanting == "manifest":
            return RepairReport(False)  # the recorder is creating it
        raise SessionError(
            QT_TR_NOOP("{folder} is still being recorded or repaired. Open it when that has finished."), folder=folder
        ) from error
    except OSError as error:
        message = QT_TR_NOOP(
            "The session is damaged and could not be repaired, because {folder} cannot be written to ({why}). It is "
            "shown as it was found."
        )
        return RepairReport(False, (localized(message, folder=folder, why=error.strerror or error),))
    with lock:
        try:
            return _Repair(folder).run()
        except SessionError:
            raise
        except Exception as error:
            # A file's effect on a repair must not hide the rest of the session.
            _log.exception("repairing %s", folder)
            reason: object = localized(QT_TR_NOOP("the damage is of an unexpected kind; see the log for details"))
            if isinstance(error, OSError):
                full = QT_TR_NOOP("there is not enough disk space")
                reason = full if no_room(error) else error.strerror or error
            message = QT_TR_NOOP(
                "The session is damaged and could not be repaired: {why}. It is shown as it was found; the attempt "
                "caused no further damage."
            )
            return RepairReport(False, (localized(message, why=reason),))
        finally:
            path = folder / _REWRITTEN
            try:
                path.unlink(missing_ok=True)
            except OSError:
                _log.debug("%s stays behind", path, exc_info=True)


def _wanting(folder: Path, header: SessionHeader) -> Literal["", "end", "manifest"]:
    """What the session lacks: a proper end, or only its manifest."""
    path = folder / _EVENTS
    with reading(path):
        if header.ended_ns is None or not events_file.has_summary(path):
            return "end"
        if path.stat().st_size != (header.size_of(_EVENTS) or path.stat().st_size):
            return "end"
    lacks_manifest = header.format_version >= _MANIFEST_SINCE and not (folder / MANIFEST_NAME).exists()
    return "manifest" if lacks_manifest else ""


class _Repair:
    """One repair, with the folder held. Every step leaves a session that the next attempt can continue from."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._header = read_header(folder)
        self._clock = self._header.session_clock
        self._sentences: list[str] = []
        self._losses = [*self._header.losses]
        self._lost: Counter[str] = Counter()
        # A closed session was complete: it was damaged later, and its header is the reference.
        self._finished = self._header.ended_ns is not None
        self._expected = (Counter(self._header.counts) or None) if self._finished else progress_counts(folder)
        self._record = _Record()
        self._ended_ns = 0
        self._reason = ""
        self._damaged_bytes: int | None = None
        self._complete = False

    def run(self) -> RepairReport:
        wanting = _wanting(self._folder, self._header)
        if not wanting:
            return RepairReport(False)  # another process was first
        begun_s = time.monotonic()
        losses_before = len(self._losses)
        if wanting == "end":
            self._repair_events()
            header = replace(self._header, counts=dict(sorted(self._record.counts.items())))
            if self._finished:
                # Of a closed session, only the events change; incomplete media are reported on each reading.
                others = [file for file in header.files if file.name != _EVENTS]
                events = RecordedFile(_EVENTS, (self._folder / _EVENTS).stat().st_size)
                header = replace(header, files=(*others, events))
            else:
                sounds = tuple(self._repair_sounds())
                recorded = {video.file_name: video.camera for video in self._header.videos}
                videos = []
                for frames in self._record.frames.values():
                    frames.sort(key=lambda ref: ref.stamp_ns)
                for path in sorted(self._folder.glob("video-*.mp4")):
                    if inside(self._folder, path.name):
                        video = self._repair_video(path, recorded.get(path.name, ""))
                        if video is not None:
                            videos.append(video)
                self._count_lost_frames(videos)
                self._move_leftovers()
                pauses: list[RecordedPause] = []
                for event in self._record.pauses:
                    if event.paused:
                        pauses.append(RecordedPause(event.stamp_ns))
                    elif pauses:
                        pauses[-1] = RecordedPause(pauses[-1].paused_ns, event.stamp_ns)
                header = header.ended(
                    self._ended_ns,
                    self._reason,
                    dropped=dict(sorted(self._record.dropped.items())),
                    pauses=tuple(pauses),
                    videos=tuple(videos),
                    audio=sounds,
                    files=recorded_files(self._folder),
                )
            self._replace_header(header)
        else:
            self._say(
                QT_TR_NOOP("The list of checksums was missing and has been created now: it shows changes from now on.")
            )
        forget_counts(self._folder)
        # The manifest from the close shows later changes. It is never rewritten.
        if not (self._folder / MANIFEST_NAME).exists():
            write_manifest(self._folder)
        sentences = (*self._sentences, *self._losses[losses_before:])
        for sentence in sentences:
            _log.info("%s: %s", self._folder, sentence)
        _log.info("%s: repaired in %.1f s", self._folder, time.monotonic() - begun_s)
        return RepairReport(True, sentences)

    def _say(self, text: str, **values: object) -> None:
        self._sentences.append(localized(text, **values))

    # Events

    def _repair_events(self) -> None:
        path = self._folder / _EVENTS
        with path.open("rb") as file:
            magic = file.read(len(MAGIC))
            broken = not events_file.has_summary(path)
            index = events_file.scan(file) if broken else events_file.read_index(path)
            if broken and not index.count and magic != MAGIC[: len(magic)]:
                raise SessionError(
                    QT_TR_NOOP("{path} is not an event log: nothing in it can be read. Nothing was changed."), path=path
                )
            if broken:
                self._rewrite_events(file, index)
            else:
                for content in events_file.intact_blocks(file, index):
                    self._inspect(index, content)
        if not broken:
            self._complete = self._record.ended is not None
            self._settle_end()
        self._report_events()

    def _rewrite_events(self, file: Any, index: BlockIndex) -> None:
        self._damaged_bytes = index.damaged_bytes
        part = self._folder / _REWRITTEN
        part.unlink(missing_ok=True)
        for number in range(index.count):
            self._record.newest_utc_ns = max(self._record.newest_utc_ns, int(index.ends_utc_ns[number]))
        with DiskFile(part) as target:
            end = self._end_event(index, file)
            rewrite(file, index, target, lambda content: self._inspect(index, content), added=end)
            target.sync()
        if end is not None:
            self._record.counts[BY_TYPE[SessionEnded].name] += 1
        self._preserve(self._folder / _EVENTS)
        part.replace(self._folder / _EVENTS)
        bring_to_disk(self._folder)

    def _end_event(self, index: BlockIndex, file: Any) -> AddedMessage | None:
        """End event, if the log lacks it."""
        spec = BY_TYPE[SessionEnded]
        for channel, its in index.channels.items():
            for number in index.blocks_of.get(channel, ()) if its.topic == f"/{spec.name}" else ():
                self._inspect(index, events_file.read_block(file, index, number), only=channel)
        self._settle_end()
        self._complete = self._record.ended is not None
        if self._record.ended is not None:
            self._record = _Record(newest_utc_ns=self._record.newest_utc_ns)
            return None
        event = SessionEnded(self._ended_ns, self._folder.name, self._reason)
        ended_utc_ns = self._clock.anchor.utc_ns_at(self._ended_ns)
        schema_name, schema = schema_of(spec)
        return AddedMessage(
            topic=f"/{spec.name}",
            schema_name=schema_name,
            schema=json.dumps(schema).encode(),
            data=json.dumps(to_message(spec, event, at_utc_ns=ended_utc_ns), separators=(",", ":")).encode(),
            log_ns=max(self._record.newest_utc_ns, ended_utc_ns),
            publish_ns=ended_utc_ns,
        )

    def _settle_end(self) -> None:
        newest_ns = self._clock.at_utc(self._record.newest_utc_ns)
        if self._header.ended_ns is not None:
            self._ended_ns, self._reason = self._header.ended_ns, self._header.reason or ""
        elif self._record.ended is not None:
            self._ended_ns, self._reason = self._record.ended.stamp_ns, self._record.ended.reason
        else:
            self._ended_ns, self._reason = max(newest_ns, self._clock.started_ns), "recovered"

    def _inspect(self, index: BlockIndex, content: bytes, *, only: int | None = None) -> bytes:
        """Note what the messages of a chunk say of the session; return the chunk."""
        record = self._record
        for message in events_file.messages_of(content):
            channel = index.channels.get(message.channel)
            if channel is None or channel.topic == TRANSFORMS_TOPIC or (only is not None and message.channel != only):
                continue
            spec = spec_of_topic(channel.topic)
            name = channel.topic.removeprefix("/") if spec is None else spec.name
            record.counts[name] += 1
            record.highest[name] = max(record.highest[name], message.sequence)
            record.newest_utc_ns = max(record.newest_utc_ns, message.log_ns)
            if spec is None or spec.value_type is not SessionEnded:
                record.last_value_utc_ns = max(record.last_value_utc_ns, message.log_ns)
            if spec is None or spec.value_type not in _LOOKED_AT:
                continue
            try:
                value = from_message(spec, json.loads(content[message.start : message.end]))
            except (ValueError, RecursionError):
                continue
            match value:
                case FrameRef():
                    record.frames.setdefault(value.camera, []).append(value)
                case Gap():
                    record.dropped[value.stream] += value.count
                case AudioBlock():
                    record.sounds.setdefault(value.file_name, value)
                case RecordingPaused():
                    record.pauses.append(value)
                case SessionEnded():
                    record.ended = value
        return content

    def _report_events(self) -> None:
        if self._damaged_bytes is None and self._preserved_name(_EVENTS):
            # An earlier attempt came this far and was interrupted.
            with (self._folder / KEPT_FOLDER / self._preserved_name(_EVENTS)).open("rb") as original:
                self._damaged_bytes = events_file.scan(original).damaged_bytes
        left, recorded = self._count_lost_values()
        lasted_s = self._clock.session_s(self._ended_ns)
        if self._preserved_name(_EVENTS):
            message = new_index_words(left, finished=self._finished)
            self._say(message, seconds=f"{lasted_s:.1f}")
        elif self._finished:
            self._say(QT_TR_NOOP("events.mcap is not the file that was recorded; it contains %n values.", "", left))
        lost = self._lost.total()
        if lost:
            last_value_ns = self._clock.at_utc(self._record.last_value_utc_ns)
            early_s = lasted_s - max(0.0, self._clock.session_s(last_value_ns))
            message = lost_values_words(lost, broken=bool(self._damaged_bytes), early=self._finished and early_s > 1.0)
            values = {"recorded": recorded, "bytes": self._damaged_bytes, "seconds": f"{early_s:.1f}"}
            self._losses.append(localized(message, **values))
        elif self._expected is None and not self._complete:
            self._losses.append(QT_TR_NOOP("The number of values missing at the end of events.mcap is unknown."))
        elif self._damaged_bytes:
            self._losses.append(unread_bytes_words(self._damaged_bytes))

    def _count_lost_values(self) -> tuple[int, int]:
        """Values left and values expected, as far as known; also notes the lost ones."""
        # Except for the end event, which the repair adds.
        end = BY_TYPE[SessionEnded].name
        left = Counter({name: count for name, count in self._record.counts.items() if name != end})
        expected = Counter({name: self._record.highest[name] for name in left})
        for name, count in (self._expected or Counter()).items():
            if name != end:
                expected[name] = max(expected[name], count)
        lost = {name: count - left[name] for name, count in expected.items() if count > left[name]}
        self._lost = Counter(lost)
        return left.total(), left.total() + self._lost.total()

    # Sound and video

    def _repair_sounds(self) -> Iterator[AudioInfo]:
        for path in sorted(self._folder.glob("audio-*.wav")):
            if not inside(self._folder, path.name):
                continue
            try:
                sound, repaired = media_files.repair_wav(path)
            except ValueError as error:
                self._say(QT_TR_NOOP("{file} was not changed: {error}."), file=path.name, error=error)
                continue
            rate_hz = sound.sample_rate_hz
            if repaired:
                message = QT_TR_NOOP("{file} had no length in its header; it contains {seconds} s of audio.")
                self._say(message, file=path.name, seconds=f"{sound.samples / rate_hz:.1f}")
            first = self._record.sounds.get(path.name)
            source = path.stem.removeprefix("audio-") if first is None else first.source
            first_ns = self._clock.started_ns
            if first is not None:
                first_ns = first.stamp_ns - first.first_sample * 1_000_000_000 // rate_hz
            last_ns = first_ns + sound.samples * 1_000_000_000 // rate_hz
            yield AudioInfo(path.name, source, sound.sample_rate_hz, sound.channels, sound.samples, first_ns, last_ns)

    def _repair_video(self, path: Path, camera: str) -> VideoInfo | None:
        self._cut_tail(path)
        content = media_files.content_of(path)
        if content is None or not content.times_s:
            self._say(QT_TR_NOOP("{file} contains no complete frame; it was not changed."), file=path.name)
            return None
        camera = camera or camera_of_video(path.name, self._record.frames)
        recorded = self._record.frames.get(camera, [])
        index = index_path(path)
        lines = media_files.index_lines(path, content, recorded, self._clock)
        if lines is not None:
            if index.exists():
                self._preserve(index)
            replace_file(index, lines, durable=True)
            self._say(QT_TR_NOOP("The frame times of {file} were matched to its frames."), file=path.name)
        times = read_frame_times(index)
        stamps_ns, shown_ns = times.stamps_ns, times.shown_ns
        first_ns, last_ns = int(shown_ns[0]), int(shown_ns[-1])
        frame_stamps_ns = set(stamps_ns.tolist())
        return VideoInfo(
            file_name=path.name,
            camera=camera,
            frames=len(stamps_ns),
            width_px=content.width_px,
            height_px=content.height_px,
            first_stamp_ns=first_ns,
            last_stamp_ns=last_ns,
            index_file=index.name,
            encoder="",
            rate_hz=round((len(stamps_ns) - 1) / max(1e-9, (last_ns - first_ns) / 1e9), 3),
            left_out=sum(first_ns < ref.shown_ns < last_ns and ref.stamp_ns not in frame_stamps_ns for ref in recorded),
            delay_ms=times.delay_ms,
            uncertainty_ms=times.worst_uncertainty_ms,
        )

    def _cut_tail(self, path: Path) -> None:
        """Move an incomplete fragment at the end of a video aside: it is unusable and breaks some players."""
        complete = media_files.whole_bytes(path)
        if complete in (0, path.stat().st_size):
            return
        with path.open("rb") as file:
            file.seek(complete)
            tail = file.read()
        copy = self._folder / KEPT_FOLDER / f"{path.name}.tail"
        copy.parent.mkdir(exist_ok=True)
        if not (copy.exists() and copy.read_bytes() == tail):
            replace_file(free_path(copy), tail, durable=True)
        with path.open("rb+") as file:
            file.truncate(complete)
            os.fsync(file.fileno())
        message = QT_TR_NOOP("The last part of {file} was incomplete and was moved to {place}.")
        self._say(message, file=path.name, place=f"{KEPT_FOLDER}/{copy.name}")

    def _count_lost_frames(self, videos: list[VideoInfo]) -> None:
        """Count logged frames after the last complete part of the video."""
        for camera, frames in self._record.frames.items():
            last_ns = max((video.last_stamp_ns for video in videos if video.camera == camera), default=0)
            lost = sum(ref.shown_ns > last_ns for ref in frames)
            if lost:
                self._record.dropped[BY_TYPE[FrameRef].name] += lost
                from_ns = max(last_ns, frames[0].shown_ns)
                lost_s = (frames[-1].shown_ns - from_ns) / 1e9
                self._losses.append(localized(unsaved_pictures_words(lost), camera=camera, seconds=f"{lost_s:.1f}"))

    # The rest

    def _move_leftovers(self) -> None:
        """Move half-written files aside without deleting them."""
        for path in sorted(self._folder.rglob(".*.part")):
            if path.name != _REWRITTEN and path.is_file() and not path.is_symlink():
                target = free_path(self._folder / KEPT_FOLDER / path.name.removeprefix("."))
                target.parent.mkdir(exist_ok=True)
                path.replace(target)
                message = QT_TR_NOOP("A half-written file was moved to {place}.")
                self._say(message, place=f"{KEPT_FOLDER}/{target.name}")

    def _replace_header(self, changed: SessionHeader) -> None:
        lost = dict(sorted((Counter(self._header.lost) + self._lost).items()))
        repairs = (*self._header.repairs, *self._sentences)
        # Written even if nothing is lost.
        as_read = {**changed.as_read, "lost": lost, "losses": self._losses}
        path = self._folder / HEADER_NAME
        if path.exists() and not (self._folder / KEPT_FOLDER / f"{path.name}.original").exists():
            self._preserve(path)
        replace(changed, lost=lost, losses=tuple(self._losses), repairs=repairs, as_read=as_read).write(self._folder)

    def _preserved_name(self, name: str) -> str:
        """Name of the newest preserved original of a file; empty if there is none."""
        found = sorted((self._folder / KEPT_FOLDER).glob(f"{name}.original*"), key=lambda path: path.stat().st_mtime_ns)
        return found[-1].name if found else ""

    def _preserve(self, path: Path) -> None:
        """Preserve a file that will be replaced."""
        backup_folder = self._folder / KEPT_FOLDER
        backup_folder.mkdir(exist_ok=True)
        for backup in backup_folder.glob(f"{path.name}.original*"):
            if backup.samefile(path):
                return  # an earlier attempt came this far
        backup = free_path(backup_folder / f"{path.name}.original")
        try:
            os.link(path, backup)
        except OSError:
            # Removable disks may lack hard links.
            with path.open("rb") as file:
                replace_file(backup, iter(lambda: file.read(_COPIED_BYTES), b""), durable=True)
        bring_to_disk(backup_folder)
