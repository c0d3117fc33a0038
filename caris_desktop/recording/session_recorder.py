"""One session being recorded: where each value goes, what is missing, and when to give up."""

import json
import logging
import shutil
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from caris_desktop.domain import clock
from caris_desktop.domain.address import without_credentials
from caris_desktop.domain.events import Gap, PhotoTaken, Problem, SessionEnded, SessionStarted, Severity
from caris_desktop.domain.ports import FrameReader
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.streams import BY_TYPE, Delivery, StreamSpec
from caris_desktop.recording.disk_file import DiskFile, Reserve, no_room, replace_file
from caris_desktop.recording.event_log import EventLog
from caris_desktop.recording.media_writer import MediaFailed, MediaWriter, PhotoKept, VideoInfo
from caris_desktop.recording.messages import RecorderReport, StartRecording
from caris_desktop.recording.plain_files import PlainFiles
from caris_desktop.recording.session_clock import SessionClock

_log = logging.getLogger(__name__)
FORMAT, FORMAT_VERSION = "caris-desktop session", 1
_FLUSH_EVERY_NS = 300_000_000
_SECOND_NS = 1_000_000_000
_LATCHED_EVERY_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class DiskLimits:
    """Free room at which the recorder warns, ends the video, and what it keeps back to close properly."""

    warn_free_bytes: int = 1024 * 1024 * 1024
    end_video_free_bytes: int = 64 * 1024 * 1024
    reserve_bytes: int = 8 * 1024 * 1024
    close_media_s: float = 4.0


class SessionRecorder:
    """Writes one session folder. One thread; only :meth:`sync` may be called from another.

    ``report`` takes the events that the recorder makes itself, after they were written. ``full`` turns True when the
    disk is: whoever drives the recorder then closes it.
    """

    def __init__(
        self, start: StartRecording, *, frames: FrameReader, report: Callable[[Any], None], limits: DiskLimits
    ) -> None:
        """Raises OSError when the folder cannot be used."""
        self.folder = start.folder
        self.full = False
        self.started_ns = clock.now_ns()
        self.dropped: Counter[str] = Counter()
        self._header = start.header
        self._frames = frames
        self._report = report
        self._limits = limits
        self._video_permitted, self._photos_permitted = start.video, start.photos
        self._video_ended = False
        self._warned = False
        self._clock = SessionClock(start.header.anchor, self.started_ns)
        self._latched: dict[str, tuple[int, Any]] = {}
        self._missed: Counter[tuple[str, str]] = Counter()
        self._photos = 0
        self._free_bytes: int | None = None
        self._flushed_ns = self._housekept_ns = 0
        self.folder.mkdir(parents=True, exist_ok=True)
        if any(self.folder.iterdir()):
            raise FileExistsError(17, "the folder holds files already", str(self.folder))
        self._reserve = Reserve(self.folder, limits.reserve_bytes)
        try:
            self._write_header(ended_ns=None, reason=None, videos=())
            self._log = EventLog(
                DiskFile(self.folder / "events.mcap", on_full=self._make_room),
                anchor=start.header.anchor,
                metadata={"program_version": start.header.program_version, "scenario": start.header.scenario_title},
            )
            self._plain = PlainFiles(self.folder, self._clock, on_full=self._make_room)
        except OSError:
            self._reserve.release()
            raise
        self._media = MediaWriter(self.folder, on_full=self._make_room)
        self._record(SessionStarted(self.started_ns, self.folder.name))
        self.tick()

    def write(self, value: Any) -> None:
        """Record one value of the stream table."""
        spec = BY_TYPE.get(type(value))
        if spec is None:
            self._miss(type(value).__name__, "this kind is not in the stream table")
        elif spec.delivery is Delivery.MEDIA:
            self._write_frame(spec, value)
        elif spec.record_every_s:
            # Large, and stands until replaced: the newest one per second is kept.
            last_ns, _ = self._latched.get(spec.name, (0, None))
            if time.monotonic_ns() - last_ns >= _LATCHED_EVERY_NS:
                self._latched[spec.name] = (time.monotonic_ns(), None)
                self._put(spec, value)
            else:
                self._latched[spec.name] = (last_ns, value)
        else:
            if isinstance(value, Gap):
                self.dropped[value.stream] += value.count
            self._put(spec, value)

    def take_photo(self, ref: FrameRef) -> None:
        """Keep one frame as a PNG; ``PhotoTaken`` follows when it is on disk."""
        if not self._photos_permitted:
            self.problem("warning", "No photo was taken.", "This scenario does not permit photos.", "Nothing to do.")
            return
        image_bgr = self._frames.read(ref)
        if image_bgr is not None:
            file_name = f"photos/{self._photos + 1:04d}.png"
            if self._media.add_photo(ref, image_bgr, file_name):
                self._photos += 1
                return
        self.problem(
            "warning", "No photo was taken.", "The picture was gone before it could be kept.", "Take it again."
        )

    def set_permissions(self, *, video: bool, photos: bool) -> None:
        if self._video_permitted and not video:
            self._media.end_videos()
        self._video_permitted, self._photos_permitted = video, photos

    def tick(self) -> None:
        """Whatever is due by time. To be called at least ten times per second."""
        now_ns = time.monotonic_ns()
        self._take_media_results()
        if now_ns - self._flushed_ns >= _FLUSH_EVERY_NS:
            self._flushed_ns = now_ns
            self._guarded(self._log.flush)
            self._watch_disk()
        if now_ns - self._housekept_ns >= _SECOND_NS:
            self._housekept_ns = now_ns
            for name, (last_ns, waiting) in list(self._latched.items()):
                if waiting is not None and now_ns - last_ns >= _LATCHED_EVERY_NS:
                    self._latched[name] = (now_ns, None)
                    self._put(BY_TYPE[type(waiting)], waiting)
            self._tell_missed()
            self._guarded(self._plain.write_people)

    def sync(self) -> None:
        """Bring everything written to the disk itself. Any thread; may take as long as the disk does."""
        for sync in (self._log.sync, self._plain.sync, self._media.sync):
            try:
                sync()
            except OSError:
                _log.exception("the disk did not confirm what was written")

    def status(self) -> RecorderReport:
        return RecorderReport(
            stamp_ns=clock.now_ns(),
            state="recording",
            folder=self.folder,
            started_ns=self.started_ns,
            written_bytes=self._log.written_bytes + self._plain.written_bytes + self._media.written_bytes,
            free_bytes=self._free_bytes,
            dropped=dict(self.dropped),
            detail="video ended: the disk is nearly full" if self._video_ended else "",
        )

    def close(self, reason: str) -> None:
        """End the session. Does what can be done; what cannot is logged."""
        for waiting in [value for _, value in self._latched.values() if value is not None]:
            self._put(BY_TYPE[type(waiting)], waiting)
        self._latched.clear()
        # The video first: its index needs room, and the reserve is for the events that come after it.
        videos = self._media.close(timeout_s=self._limits.close_media_s)
        self._take_media_results()
        self._tell_missed()
        ended_ns = clock.now_ns()
        self._record(SessionEnded(ended_ns, self.folder.name, reason))
        self._reserve.release()
        for step in (
            self._log.close,
            self._plain.close,
            lambda: self._write_header(ended_ns=ended_ns, reason=reason, videos=videos),
        ):
            try:
                step()
            except OSError:
                _log.exception("closing the session %s", self.folder)

    # Values on their way to the disk

    def _write_frame(self, spec: StreamSpec, ref: FrameRef) -> None:
        if not self._video_permitted or self._video_ended:
            return
        image_bgr = self._frames.read(ref)
        if image_bgr is None:
            self._miss(spec.name, f"{ref.camera}: overwritten before it could be read")
        elif not self._media.add_frame(ref, image_bgr):
            self._miss(spec.name, f"{ref.camera}: the video encoder could not keep up")
        else:
            self._put(spec, ref)

    def _record(self, event: Any) -> None:
        """An event of the recorder's own: written, then told."""
        self._put(BY_TYPE[type(event)], event)
        self._report(event)

    def _put(self, spec: StreamSpec, value: Any) -> None:
        try:
            self._log.write(spec, value)
        except OSError as error:
            self._on_write_error(error)
            self._miss(spec.name, "the disk did not take it")
        except (TypeError, ValueError) as error:
            _log.exception("a value of %s could not be written", spec.name)
            self._miss(spec.name, f"not writable: {error}"[:200])
        self._guarded(lambda: self._plain.add(value))

    def _guarded(self, write: Callable[[], None]) -> None:
        try:
            write()
        except OSError as error:
            self._on_write_error(error)

    def _on_write_error(self, error: OSError) -> None:
        if not self.full:
            _log.error("recording: %s", error)
        self.full = True

    def _make_room(self) -> bool:
        """The disk is full: give the reserve back, so that what is being written is written whole."""
        self.full = True
        return self._reserve.release()

    def _miss(self, stream: str, reason: str, count: int = 1) -> None:
        self.dropped[stream] += count
        self._missed[(stream, reason)] += count

    def _tell_missed(self) -> None:
        missed, self._missed = self._missed, Counter()
        for (stream, reason), count in missed.items():
            self._record(Gap(clock.now_ns(), stream, count, reason))

    def problem(self, severity: Severity, what: str, meaning: str, advice: str) -> None:
        """Tell the wizard, and the record."""
        _log.warning("%s %s %s", what, meaning, advice)
        self._record(Problem(clock.now_ns(), severity, what, meaning, advice))

    def _take_media_results(self) -> None:
        for result in self._media.results():
            match result:
                case PhotoKept(ref=ref, file_name=file_name):
                    self._record(PhotoTaken(ref.stamp_ns, ref.camera, ref.sequence, file_name))
                case MediaFailed():
                    self._on_media_failed(result)

    def _on_media_failed(self, failure: MediaFailed) -> None:
        if failure.kind == "photo":
            self.problem(
                "error",
                "The photo could not be kept.",
                "The session goes on without it.",
                "Free some room on the disk." if failure.disk_full else f"Try again. ({failure.detail})",
            )
            return
        if failure.lost:
            self._miss("frame", f"{failure.camera}: {failure.detail}"[:200], failure.lost)
        if failure.disk_full:
            self._end_video("The disk is full.")
        elif failure.detail != "the video has ended":
            self.problem(
                "error",
                f"The video of {failure.camera} ended: {failure.detail}.",
                "What was recorded up to now is kept. Events and robot data go on.",
                "Stop and start the recording to have video again.",
            )

    # The disk

    def _watch_disk(self) -> None:
        try:
            self._free_bytes = shutil.disk_usage(self.folder).free
        except OSError:
            _log.exception("free room of %s", self.folder)
            return
        if self._free_bytes < self._limits.end_video_free_bytes:
            self._end_video(f"The disk is nearly full: {_megabytes(self._free_bytes)} are left.")
        elif self._free_bytes < self._limits.warn_free_bytes and not self._warned:
            self._warned = True
            self.problem(
                "warning",
                f"The disk is filling up: {_megabytes(self._free_bytes)} are left.",
                f"The video ends when {_megabytes(self._limits.end_video_free_bytes)} are left.",
                "Delete or move files that you do not need.",
            )

    def _end_video(self, what: str) -> None:
        if self._video_ended or not self._video_permitted:
            return
        self._video_ended = self._warned = True
        self._media.end_videos()
        self.problem(
            "error",
            what,
            "Video is no longer recorded; events, robot data and speech still are.",
            "Free some room on the disk, then stop and start the recording.",
        )

    # session.json

    def _write_header(self, *, ended_ns: int | None, reason: str | None, videos: tuple[VideoInfo, ...]) -> None:
        header = self._header
        data = {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "program_version": header.program_version,
            "scenario": {
                "title": header.scenario_title,
                "file": header.scenario_file,
                "sha256": header.scenario_sha256,
            },
            "robot": {"profile": header.robot_profile, "address": without_credentials(header.robot_address)},
            "trial": header.trial,
            "clock": {
                "monotonic_ns": header.anchor.monotonic_ns,
                "utc_ns": header.anchor.utc_ns,
                "note": "UTC of a stamp is utc_ns + (stamp_ns - monotonic_ns).",
            },
            "started_ns": self.started_ns,
            "started_utc": self._clock.utc(self.started_ns),
            "ended_ns": ended_ns,
            "ended_utc": None if ended_ns is None else self._clock.utc(ended_ns),
            "duration_s": None if ended_ns is None else round(self._clock.session_s(ended_ns), 3),
            "reason": reason,
            "counts": {} if ended_ns is None else dict(sorted(self._log.counts.items())),
            "dropped": dict(sorted(self.dropped.items())),
            "videos": [asdict(video) for video in videos],
            "files": [] if ended_ns is None else _files(self.folder),
        }
        text = json.dumps(data, indent=2, ensure_ascii=False) + "\n"
        replace_file(
            self.folder / "session.json", text.encode("utf-8", "replace"), durable=True, on_full=self._make_room
        )


def explain_start_error(error: OSError, folder: Path) -> tuple[str, str, str]:
    """What happened, what it means and what to do, for the wizard."""
    meaning = "Nothing is being recorded. Driving and speaking still work."
    if no_room(error):
        return "The disk is full.", meaning, "Free some room, or choose another study folder, then record again."
    if isinstance(error, FileExistsError):
        return f"{folder} holds files already.", meaning, "Record again: the next session gets a folder of its own."
    return (
        f"{folder} cannot be written: {error.strerror or error}.",
        meaning,
        "Choose a study folder that you may write to, then record again.",
    )


def _files(folder: Path) -> list[dict[str, Any]]:
    return [
        {"name": path.relative_to(folder).as_posix(), "bytes": path.stat().st_size}
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "session.json"
    ]


def _megabytes(count: int) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"
