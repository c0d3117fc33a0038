"""Recording of one session: destination of each value, missing data, and the end on failure.

Long because it decides where each value goes, and when to give up.
"""

import logging
import shutil
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import clock
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.address import without_credentials
from caris_desktop.domain.events import (
    ANSWER,
    Gap,
    PhotoTaken,
    Problem,
    ProblemEnd,
    RecordingPaused,
    SessionEnded,
    SessionStarted,
    Severity,
    UtteranceChanged,
)
from caris_desktop.domain.file_replacement import bring_to_disk, no_room
from caris_desktop.domain.ports import FrameReader
from caris_desktop.domain.sensing import AudioBlock, AudioChunk, FrameRef
from caris_desktop.domain.streams import BY_TYPE, StreamSpec
from caris_desktop.domain.translation import QT_TR_NOOP, joined, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.disk_file import DiskFile, Reserve
from caris_desktop.recording.recorder.audio_file import AudioWriter
from caris_desktop.recording.recorder.blurring import Blurring
from caris_desktop.recording.recorder.disk_watch import DiskLimits, DiskState, DiskWatch
from caris_desktop.recording.recorder.event_log import EventLog
from caris_desktop.recording.recorder.media_writer import (
    IMAGE_LOST,
    MediaFailed,
    MediaWriter,
    VideoRateChanged,
    photo_event,
    texts_for,
)
from caris_desktop.recording.recorder.plain_files import PlainFiles
from caris_desktop.recording.recorder.recorder_messages import BlurDemand, RecorderReport, StartRecording, TakePhoto
from caris_desktop.recording.recorder.video_writer import Encoders
from caris_desktop.recording.session import loss_messages
from caris_desktop.recording.session.folder_lock import LOCK_NAME, hold
from caris_desktop.recording.session.manifest import HashingStopped, forget_counts, store_counts, write_manifest
from caris_desktop.recording.session.session_header import HEADER_NAME, TRIAL_METADATA, RecordedPause, recorded_files

_REMEMBER_S = 30.0


class FsyncThread:
    """Periodic fsync of recorded files in a thread, against data loss by a power failure.

    Sync thread. A round begins on request, or ``every_s`` after the start of the last one.
    """

    def __init__(self, name: str, files: Callable[[], Iterable[DiskFile]], *, every_s: float) -> None:
        self._files = files
        self._every_s = every_s
        self._paths: deque[Path] = deque()
        self._rounds: deque[tuple[float, float]] = deque()
        self._began_s: float | None = None
        self._failed = False
        self.disk_full = False
        self._due = threading.Event()
        self._ended = False
        self._thread = threading.Thread(target=self._run, name=f"sync-{name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def ask(self) -> None:
        """Request a round soon."""
        self._due.set()

    def note(self, path: Path) -> None:
        """Note a replaced file: it and its folder entry are synced."""
        self._paths.append(path)

    def delays_s(self, now_s: float, *, within_s: float) -> list[float]:
        """Durations of the rounds within ``within_s`` (``time.monotonic``), or of the slowest write before each, and
        the elapsed time of the present one.
        """
        began_s = self._began_s
        going_s = 0.0 if began_s is None else now_s - began_s
        return [going_s, *(took_s for at_s, took_s in tuple(self._rounds) if now_s - at_s <= within_s)]

    def close(self, *, timeout_s: float) -> None:
        """End after a last round; a round that the disk does not finish is abandoned."""
        self._ended = True
        self._due.set()
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
            if self._thread.is_alive():
                _log.error("the disk has not confirmed within %.0f s what was written", timeout_s)

    def sync_now(self) -> None:
        """Run one round now."""
        paths = {self._paths.popleft() for _ in range(len(self._paths))}
        folders = {path.parent for path in paths}
        paths_in_order = (*sorted(paths), *sorted(folders))
        steps: list[Callable[[], object]] = [partial(bring_to_disk, path) for path in paths_in_order]
        for sync in [*(file.sync for file in self._files()), *steps]:
            try:
                sync()
            except FileNotFoundError:
                # Replaced by a newer file, which is noted too.
                continue
            except OSError as error:
                self.disk_full = self.disk_full or no_room(error)
                if not self._failed:
                    _log.exception("the disk did not confirm what was written")
                self._failed = True

    def _run(self) -> None:
        ended = False
        while not ended:
            self._due.wait(self._every_s)
            self._due.clear()
            ended = self._ended
            self._began_s = time.monotonic()
            self.sync_now()
            took_s = time.monotonic() - self._began_s
            self._began_s = None
            slowest_s = max([took_s, *(file.take_slowest_write_s() for file in self._files())])
            self._rounds.append((time.monotonic(), slowest_s))
            while self._rounds[0][0] < time.monotonic() - _REMEMBER_S:
                self._rounds.popleft()


_log = logging.getLogger(__name__)
# A kill loses data since the last flush; each flush makes a chunk with an index entry.
_FLUSH_EVERY_NS = 450_000_000
_SYNC_MEDIA_EVERY_S, _SYNC_LOG_EVERY_S = 0.4, 0.9
_SECOND_NS = 1_000_000_000
_COVERED_WHOLE_TOLD_S = 5.0
_DELAYS_WITHIN_S = 15.0
_BEHIND_S = 2.0
_LEAST_RESERVE_BYTES = 1024 * 1024
_HEADER_BYTES = 256 * 1024
"""Many times what the header takes: a session says why it ended, also where nothing else finds room any more."""
_RESERVE_SHARE = 8
_CLOSE_SYNC_S = 2.0
# A repair derives missing data from these counts, as of their last update; each update writes a small file.
_COUNT_EVERY_NS = 5 * _SECOND_NS


class SessionRecorder:
    """Writes one session folder. One thread, except :meth:`finish`.

    ``report`` receives the recorder's own events after they were written. ``full`` becomes True when even the reserve
    for events is used up; the caller then closes it. ``offer`` receives everything written to the log.
    """

    def __init__(
        self,
        start: StartRecording,
        *,
        frames: FrameReader,
        report: Callable[[Any], None],
        limits: DiskLimits,
        encoders: Encoders | None = None,
        offer: Callable[[StreamSpec, Any], None] | None = None,
        started_ns: int | None = None,
        blurring: Blurring | None = None,
    ) -> None:
        """``started_ns`` is the time of the request; None: now. Without ``blurring`` none may be demanded. Raises
        OSError if the folder is unusable.
        """
        if blurring is None and start.blur != BlurDemand():
            raise ValueError("pixelating is not available")
        self.folder = start.folder
        self.full = False
        self._broken: OSError | None = None
        self.started_ns = clock.now_ns() if started_ns is None else started_ns
        self._waited_until_ns = 0 if started_ns is None else clock.now_ns()
        # Progress of the record in arrival time: behind the clock on a slow disk or computer. The recorder's own events
        # get this time: arrivals never decrease, and queued values arrived before now.
        self._written_until_ns = self.started_ns
        self.dropped: Counter[str] = Counter()
        robot = replace(start.header.robot, address=without_credentials(start.header.robot.address))
        self._header = replace(start.header, robot=robot).started(self.started_ns)
        self._frames = frames
        self._blurring = blurring
        self._report = report
        self._offer = offer
        self._limits = limits
        self._video_permitted, self._photos_permitted = start.video, start.photos
        self._audio_permitted = start.audio
        self._sound_from_ns = self.started_ns
        self._goes_on_ns = 0
        self._video_ended = self._audio_ended = False
        self._on_reserve = False
        self._behind_ns = 0
        self._spared_because = ""
        self._lowered: dict[str, int] = {}
        self._pauses: list[RecordedPause] = []
        self._clock = self._header.session_clock
        self._latched: dict[str, _Held] = {}
        self._missed: Counter[tuple[str, str]] = Counter()
        self._reported: set[str] = set()
        self._photos = 0
        self._disk = DiskWatch(limits)
        self._flushed_ns = self._housekept_ns = self._counted_ns = 0
        self._ended_ns: int | None = None
        self._reason = ""
        self.folder.mkdir(parents=True, exist_ok=True)
        if any(path.name != LOCK_NAME for path in self.folder.iterdir()):
            raise FileExistsError(17, "the folder already contains files", str(self.folder))
        self._lock = hold(self.folder)
        if blurring is not None:
            blurring.use_demand(start.blur)
        with ExitStack() as undo:
            undo.callback(self._lock.release)
            room_bytes = _room_bytes(self.folder, limits)
            self._reserve = Reserve(
                self.folder,
                room_bytes + _HEADER_BYTES,
                steps=limits.reserve_steps,
                kept_bytes=min(limits.closing_bytes, room_bytes // 2) + _HEADER_BYTES,
            )
            undo.callback(self._reserve.release)
            self._media = MediaWriter(self.folder, self._clock, encoders or Encoders(()), on_full=self._make_room)
            self._write_header()
            self._log = EventLog(
                DiskFile(self.folder / "events.mcap", on_full=self._make_room),
                anchor=start.header.clock,
                metadata={
                    "program_version": start.header.program_version,
                    "scenario": start.header.scenario.title,
                    **trial_metadata(start.header.trial),
                },
            )
            self._plain = PlainFiles(self.folder, self._clock, on_full=self._make_room)
            undo.pop_all()
        self._audio = AudioWriter(self.folder, on_full=lambda: False)
        self._log_sync = FsyncThread("log", lambda: [self._log.file, *self._plain.files()], every_s=_SYNC_LOG_EVERY_S)
        self._media_sync = FsyncThread(
            "media", lambda: [*self._audio.files(), *self._media.files()], every_s=_SYNC_MEDIA_EVERY_S
        )
        self._log_sync.note(self.folder / HEADER_NAME)
        self._record(SessionStarted(self.started_ns, self.folder.name, start.actor), arrived_ns=self.started_ns)
        self.tick()
        self._log_sync.start()
        self._media_sync.start()

    def write(self, value: Any, arrived_ns: int | None = None) -> None:
        """Record one value of the stream table. ``arrived_ns`` is its arrival at the console; None: now."""
        if self.paused and not isinstance(value, UtteranceChanged):
            return  # Speech before the pause may be recognised during it; the console lets no other values through.
        now_ns = clock.now_ns()
        arrived_ns = now_ns if arrived_ns is None else arrived_ns
        # Values between the request and the creation of the folder could not be written earlier.
        self._behind_ns = max(self._behind_ns, now_ns - max(arrived_ns, self._waited_until_ns))
        self._written_until_ns = max(self._written_until_ns, arrived_ns)
        spec = BY_TYPE.get(type(value))
        if spec is None:
            self._miss(type(value).__name__, QT_TR_NOOP("this type is not in the stream table"))
        elif spec.expected_period_s is not None and value.stamp_ns < self._goes_on_ns:
            pass  # belongs to the pause and is merely late
        elif isinstance(value, FrameRef):
            self._write_frame(spec, value, arrived_ns)
        elif isinstance(value, AudioChunk):
            self._write_sound(value)
        elif spec.record_every_s:
            # Large, and valid until replaced: written periodically; values in between wait.
            topic = spec.topic_of(value)
            held = self._latched.get(topic)
            if held is None or time.monotonic_ns() - held.put_ns >= spec.record_every_s * 1e9:
                self._latched[topic] = _Held(spec, time.monotonic_ns(), None, 0)
                self._put(spec, value, arrived_ns)
            else:
                self._latched[topic] = _Held(spec, held.put_ns, value, arrived_ns)
        else:
            if isinstance(value, Gap):
                self.dropped[value.stream] += value.count
            self._put(spec, value, arrived_ns)

    def note_unreadable(self) -> None:
        """Note an undecodable value from the console."""
        if not self.paused:
            self._miss("unknown", QT_TR_NOOP("the message from the console could not be decoded"))

    def take_photo(self, request: TakePhoto) -> None:
        """Save one frame as a PNG; ``PhotoTaken`` follows when it is on disk."""
        if not self._photos_permitted:
            self._refuse_photo(
                QT_TR_NOOP("This scenario does not permit photos."),
                QT_TR_NOOP("To take photos, permit them in the scenario."),
            )
            return
        if self.paused:
            self._refuse_photo(
                QT_TR_NOOP("The recording is paused."), QT_TR_NOOP("Resume the recording, then try again.")
            )
            return
        image_bgr = self._frames.read(request.ref)
        if image_bgr is None:
            self._refuse_photo(*IMAGE_LOST)
            return
        self._when_covered(request.ref, image_bgr, lambda covered: self._store_photo(request, covered), photo=True)

    def _store_photo(self, request: TakePhoto, image_bgr: NDArray[np.uint8]) -> None:
        photo = photo_event(request, f"photos/{self._photos + 1:04d}.png")
        if self._media.add_photo(photo, image_bgr, texts_for(request, self._clock.utc(request.ref.stamp_ns))):
            self._photos += 1
        else:
            self._refuse_photo(*IMAGE_LOST)

    def _refuse_photo(self, meaning: str, advice: str) -> None:
        self.problem("warning", QT_TR_NOOP("No photo was taken."), meaning, advice, cause=ANSWER)

    def _when_covered(
        self,
        ref: FrameRef,
        image_bgr: NDArray[np.uint8],
        then: Callable[[NDArray[np.uint8]], None],
        *,
        photo: bool = False,
    ) -> None:
        """Pass the image on: at once, or after blurring where demanded."""
        if self._blurring is None:
            then(image_bgr)
        else:
            self._blurring.add(ref, image_bgr, clock.now_ns(), then, photo=photo)

    def _let_go_of_pictures(self) -> None:
        """Pass on all waiting images with what is known by now."""
        if self._blurring is not None:
            self._blurring.flush()

    def set_permissions(self, *, video: bool, photos: bool, audio: bool, blur: BlurDemand | None = None) -> None:
        """Set the permissions; ``blur`` None: unchanged."""
        self._let_go_of_pictures()
        if self._blurring is not None and blur is not None:
            self._blurring.use_demand(blur)
        if self._video_permitted and not video:
            self._media.end_videos()
        if self._audio_permitted and not audio:
            self._put_blocks(self._audio.finish_blocks())
        if audio and not self._audio_permitted:
            self._sound_from_ns = clock.now_ns()
        self._video_permitted, self._photos_permitted, self._audio_permitted = video, photos, audio

    # Pauses

    @property
    def paused(self) -> bool:
        return bool(self._pauses) and self._pauses[-1].resumed_ns is None

    def pause(self, *, paused: bool, at_ns: int, actor: Actor) -> None:
        """Pause or resume. Both are recorded."""
        if paused == self.paused:
            return
        if paused:
            self._let_go_of_pictures()
            self._put_held()
            self._put_blocks(self._audio.finish_blocks())
            self._report_missed()
            self._record(RecordingPaused(at_ns, True, actor), arrived_ns=at_ns)
            self._pauses.append(RecordedPause(at_ns))
            self._guarded(self._log.flush)
            self._log_sync.ask()
        else:
            self._pauses[-1] = RecordedPause(self._pauses[-1].paused_ns, at_ns)
            self._sound_from_ns = self._goes_on_ns = at_ns
            # Latched values that the console sends again are new in the record, however recent the last write.
            self._latched.clear()
            self._record(RecordingPaused(at_ns, False, actor), arrived_ns=at_ns)

    # By time

    def tick(self) -> None:
        """Do periodic work. Call at least ten times per second."""
        now_ns = time.monotonic_ns()
        self._take_media_results()
        if self._on_reserve and self._is_first("reserve"):
            self._live_on_reserve()
        if now_ns - self._flushed_ns >= _FLUSH_EVERY_NS:
            self._flushed_ns = now_ns
            self._guarded(self._log.flush)
            self._store_counts(now_ns)
            self._update_sound_headers()
            self._log_sync.ask()
            self._watch_disk(now_ns)
        if now_ns - self._housekept_ns >= _SECOND_NS:
            self._housekept_ns = now_ns
            self._put_held(older_than_ns=now_ns)
            self._report_missed()
            self._guarded(self._plain.write_people)
            for path in self._plain.take_replaced():
                self._log_sync.note(path)

    def status(self) -> RecorderReport:
        disk = self._disk.state
        return RecorderReport(
            stamp_ns=clock.now_ns(),
            state="paused" if self.paused else "recording",
            folder=self.folder,
            started_ns=self.started_ns,
            written_bytes=self._written_bytes(),
            free_bytes=disk.free_bytes,
            dropped=dict(self.dropped),
            detail=joined(self._troubles(), "; "),
            bytes_per_s=disk.bytes_per_s,
            room_s=disk.room_s,
            covered_whole=self._covered_whole(),
        )

    def close(self, reason: str, actor: Actor = CONSOLE) -> None:
        """End the session, checksums included."""
        self.end(reason, actor)
        self.finish()

    def end(self, reason: str, actor: Actor, at_ns: int | None = None) -> None:
        """End the session as of ``at_ns``, or of the closing of its media. Failures are logged. :meth:`finish` must
        follow.
        """
        self._let_go_of_pictures()
        self._put_held()
        # Media first: their indexes need disk space, and the reserve is for the events after them.
        try:
            self._put_blocks(self._audio.close())
        except OSError:
            _log.exception("closing the sound of %s", self.folder)
        self._media.close(timeout_s=self._limits.close_media_s)
        self._take_media_results()
        self._log_sync.close(timeout_s=_CLOSE_SYNC_S)
        self._media_sync.close(timeout_s=_CLOSE_SYNC_S)
        # On a full disk the first writer gets the space: nothing else is waited for from here on.
        self._reserve.release(down_to_bytes=_HEADER_BYTES)
        self._report_missed()
        now_ns = clock.now_ns()
        self._ended_ns, self._reason = now_ns if at_ns is None else at_ns, reason
        self._record(SessionEnded(self._ended_ns, self.folder.name, reason, actor), arrived_ns=now_ns)
        for step in (self._log.close, self._plain.close, self._write_last_header):
            try:
                step()
            except OSError:
                _log.exception("closing the session %s", self.folder)

    def finish(self, *, may_go_on: Callable[[], bool] = lambda: True) -> None:
        """Write the checksums after :meth:`end`; may take long. Any thread.

        The folder stays held until then, so that the session does not count as interrupted.
        """
        try:
            for path in (*self._plain.take_replaced(), self.folder / HEADER_NAME):
                self._log_sync.note(path)
            self._log_sync.sync_now()
            if not self._media.wait(timeout_s=0.0):
                while not self._media.wait(timeout_s=0.1) and may_go_on():
                    pass
                self._write_header()
            write_manifest(self.folder, may_go_on=may_go_on)
        except HashingStopped:
            _log.warning("%s is closed, but its checksums are not written: the program ends", self.folder)
        except OSError:
            _log.exception("the checksums of %s could not be written", self.folder)
        finally:
            self._lock.release()

    def give_up(self) -> str:
        """End the session once ``full``, reporting the reason; return it as text for the report."""
        error = self._broken
        message = QT_TR_NOOP("The disk is full.")
        if error is not None:
            message = localized(QT_TR_NOOP("The disk failed: {why}."), why=error.strerror or error)
        self.problem(
            "error",
            message,
            QT_TR_NOOP(
                "The recording has ended; everything recorded so far is saved. Driving and speaking still work."
            ),
            QT_TR_NOOP("Free some disk space, or choose another study folder, then record again.")
            if error is None
            else QT_TR_NOOP("Choose a study folder on another disk, then record again."),
        )
        self.end("disk_full" if error is None else "disk_failed", CONSOLE)
        return message

    # Values on their way to the disk

    def _write_frame(self, spec: StreamSpec, ref: FrameRef, arrived_ns: int) -> None:
        if not self._video_permitted or self._video_ended:
            return
        if not self._media.wants(ref.camera):
            reason = self._spared_because or loss_messages.ENCODING_SLOW
            self._miss(spec.name, localized(loss_messages.LEFT_OUT, camera=ref.camera, why=reason))
            return
        image_bgr = self._frames.read(ref)
        if image_bgr is None:
            self._miss(spec.name, localized(loss_messages.OVERWRITTEN, camera=ref.camera))
            return

        waits = self._blurring is not None and self._blurring.demanded
        if waits:
            # Arrivals never decrease: a replay would show the frame after values that came meanwhile.
            self._put(spec, ref, arrived_ns)

        def write(covered: NDArray[np.uint8]) -> None:
            if self._video_ended:
                return
            if not self._media.add_frame(ref, covered):
                self._miss(spec.name, localized(loss_messages.ENCODER_LATE, camera=ref.camera))
            elif not waits:
                self._put(spec, ref, arrived_ns)

        self._when_covered(ref, image_bgr, write)

    def _write_sound(self, chunk: AudioChunk) -> None:
        if not self._audio_permitted or self._audio_ended:
            return
        chunk = _since(chunk, self._sound_from_ns)
        if not len(chunk.samples):
            return
        try:
            blocks = self._audio.write(chunk)
        except OSError as error:
            _log.exception("sound of %s", chunk.source)
            self._miss("audio", localized(loss_messages.SOUND_REFUSED, source=chunk.source))
            self._end_audio(error)
        except ValueError as error:
            self._miss("audio", localized(loss_messages.OF_SOUND, source=chunk.source, why=_short(error)))
        else:
            self._put_blocks(blocks)

    def _put_blocks(self, blocks: list[AudioBlock]) -> None:
        for block in blocks:
            # With the chunk that completed it; later it would be out of order.
            self._put(BY_TYPE[AudioBlock], block, self._written_until_ns)

    def _put_held(self, *, older_than_ns: int | None = None) -> None:
        """Write throttled latched values: those due at ``older_than_ns``, or all."""
        for topic, held in list(self._latched.items()):
            if held.value is None:
                continue
            if older_than_ns is None or older_than_ns - held.put_ns >= held.spec.record_every_s * 1e9:
                self._latched[topic] = _Held(held.spec, time.monotonic_ns(), None, 0)
                self._put(held.spec, held.value, held.arrived_ns)

    def _record(self, event: Any, *, arrived_ns: int | None = None) -> None:
        """Write and report an event of the recorder. Problems during a pause are only reported."""
        if not (self.paused and isinstance(event, Problem)):
            self._put(BY_TYPE[type(event)], event, self._written_until_ns if arrived_ns is None else arrived_ns)
        self._report(event)

    def _put(self, spec: StreamSpec, value: Any, arrived_ns: int) -> None:
        try:
            self._log.write(spec, value, arrived_ns)
        except OSError as error:
            self._on_write_error(error)
            self._miss(spec.name, QT_TR_NOOP("it could not be written to the disk"))
        except (TypeError, ValueError) as error:
            _log.exception("a value of %s could not be written", spec.name)
            self._miss(spec.name, localized(loss_messages.NOT_WRITABLE, why=_short(error)))
            if self._is_first(f"unwritable {spec.name}"):
                self.problem(
                    "error",
                    QT_TR_NOOP("{stream} cannot be recorded: {why}."),
                    QT_TR_NOOP("These values are missing from this session. Everything else is recorded."),
                    QT_TR_NOOP("Do not rely on this session until the cause is known; see the log for details."),
                    stream=spec.name,
                    why=_short(error),
                )
        self._guarded(lambda: self._plain.add(value))
        if self._offer is not None:
            self._offer(spec, value)

    def _guarded(self, write: Callable[[], None]) -> None:
        try:
            write()
        except OSError as error:
            self._on_write_error(error)

    def _on_write_error(self, error: OSError) -> None:
        if not self.full:
            _log.error("recording: %s", error)
            self._broken = None if no_room(error) else error
        self.full = True

    def _make_room(self) -> bool:
        """Release a step of the reserve on a full disk, except the part for closing."""
        self._on_reserve = True
        self._media.stop_video()
        if self._reserve.release_step():
            return True
        self.full = True
        return False

    def _miss(self, stream: str, reason: str, count: int = 1) -> None:
        self.dropped[stream] += count
        self._missed[(stream, reason)] += count

    def _report_missed(self) -> None:
        missed, self._missed = self._missed, Counter()
        for (stream, reason), count in missed.items():
            self._record(Gap(clock.now_ns(), stream, count, reason))

    def problem(
        self,
        severity: Severity,
        what: str,
        meaning: str,
        advice: str,
        *,
        until: ProblemEnd = "recording",
        cause: str = "",
        **values: object,
    ) -> None:
        """Report a problem to the wizard and record it; ``cause`` as in Problem, ``values`` fill the texts."""
        what, meaning, advice = (localized(text, **values) for text in (what, meaning, advice))
        _log.warning("%s %s %s", what, meaning, advice)
        # Whatever it is, it ends with this recording at the latest.
        self._record(Problem(clock.now_ns(), severity, what, meaning, advice, until, cause))

    def _is_first(self, what: str) -> bool:
        """True once for each ``what`` to report."""
        is_first = what not in self._reported
        self._reported.add(what)
        return is_first

    def _troubles(self) -> list[str]:
        troubles: list[str] = []
        if self._on_reserve:
            troubles.append(QT_TR_NOOP("the disk is full: only events are recorded, in reserved space"))
        elif self._video_ended:
            troubles.append(QT_TR_NOOP("video stopped: the disk is nearly full"))
        elif self._spared_because:
            every_second = QT_TR_NOOP("every second frame is recorded: {why}")
            troubles.append(localized(every_second, why=self._spared_because))
        else:
            troubles += [
                localized(
                    _EVERY.get(step, QT_TR_NOOP("{camera}: every {step}th frame is recorded")), camera=camera, step=step
                )
                for camera, step in self._lowered.items()
                if step > 1
            ]
        return troubles

    # Pictures

    def _take_media_results(self) -> None:
        for result in self._media.results():
            match result:
                case PhotoTaken():
                    self._log_sync.note(self.folder / result.file_name)
                    self._record(result)
                case MediaFailed():
                    self._on_media_failed(result)
                case VideoRateChanged():
                    self._on_rate_changed(result)

    def _on_media_failed(self, failure: MediaFailed) -> None:
        if failure.kind == "photo":
            self.problem(
                "error",
                QT_TR_NOOP("The photo could not be saved."),
                QT_TR_NOOP("The session continues without the photo."),
                QT_TR_NOOP("Free some disk space.") if failure.disk_full else QT_TR_NOOP("Try again. ({detail})"),
                cause=ANSWER,
                detail=failure.detail,
            )
            return
        if failure.lost:
            reason = localized(loss_messages.OF_CAMERA, camera=failure.camera, why=_short(failure.detail))
            self._miss("frame", reason, failure.lost)
        if failure.disk_full:
            self._end_video(QT_TR_NOOP("The disk is full."))
        elif failure.kind == "video" and failure.detail != loss_messages.VIDEO_ENDED:
            self.problem(
                "error",
                QT_TR_NOOP("Video recording of {camera} stopped: {detail}."),
                QT_TR_NOOP("Everything recorded so far is saved. Events and robot data are still recorded."),
                QT_TR_NOOP("Stop and restart the recording to record video again."),
                camera=failure.camera,
                detail=failure.detail,
            )

    def _on_rate_changed(self, change: VideoRateChanged) -> None:
        _log.info("video of %s: every %d. frame (%s)", change.camera, change.step, change.change)
        self._lowered[change.camera] = change.step
        # Once per session: the recorder's report has updates, and every dropped frame is counted.
        if change.change == "lowered" and self._is_first("lowered"):
            self.problem(
                "warning",
                QT_TR_NOOP("This computer cannot keep up with the video of {camera}."),
                QT_TR_NOOP(
                    "Frames are skipped evenly and counted until the computer can record all of them again. "
                    "Nothing else is missing."
                ),
                QT_TR_NOOP("Close other programs, or choose a lower resolution or frame rate for this camera."),
                until="quiet",
                cause="busy",
                camera=change.camera,
            )

    def _covered_whole(self) -> tuple[str, ...]:
        """Cameras whose frames have been entirely covered for more than a moment."""
        if self._blurring is None or self.paused:
            return ()
        covered_s = self._blurring.covered_whole_s(clock.now_ns())
        return tuple(camera for camera, seconds in covered_s.items() if seconds > _COVERED_WHOLE_TOLD_S)

    # The disk

    def _store_counts(self, now_ns: int) -> None:
        """Store the counts of flushed values; they do not justify using the reserve."""
        if now_ns - self._counted_ns < _COUNT_EVERY_NS or self._on_reserve:
            return
        self._counted_ns = now_ns
        try:
            self._log_sync.note(store_counts(self.folder, self._log.counts))
        except OSError:
            _log.warning("the counts of %s", self.folder, exc_info=True)

    def _update_sound_headers(self) -> None:
        try:
            self._audio.update_headers()
        except OSError as error:
            _log.exception("the sound of %s", self.folder)
            self._end_audio(error)

    def _watch_disk(self, now_ns: int) -> None:
        try:
            free_bytes = shutil.disk_usage(self.folder).free
        except OSError:
            _log.exception("free room of %s", self.folder)
            return
        before = self._disk.state
        now_s = time.monotonic()
        delays_s = [
            delay_s
            for lane in (self._log_sync, self._media_sync)
            for delay_s in lane.delays_s(now_s, within_s=_DELAYS_WITHIN_S)
        ]
        disk = self._disk.observe(now_ns, free_bytes=free_bytes, written_bytes=self._written_bytes(), delays_s=delays_s)
        self._report_disk(disk)
        if (before.slow, before.stage) != (disk.slow, disk.stage):
            _log.info("disk: %s", disk)
        behind_s, self._behind_ns = self._behind_ns / 1e9, 0
        self._report_behind(behind_s)
        self._spared_because = (
            loss_messages.DISK_NEARLY_FULL
            if disk.stage in ("low", "out")
            else loss_messages.DISK_SLOW
            if disk.slow
            else loss_messages.RECORDER_BEHIND
            if behind_s > _BEHIND_S
            else ""
        )
        self._media.limit_rate(2 if self._spared_because else 1)
        if self._log_sync.disk_full or self._media_sync.disk_full:
            self._on_reserve = True

    def _report_behind(self, behind_s: float) -> None:
        if behind_s < _BEHIND_S or not self._is_first("behind"):
            return
        self.problem(
            "warning",
            QT_TR_NOOP("The recording is {behind_s} s behind."),
            QT_TR_NOOP(
                "Events wait in memory with their original times. Only frames are skipped, and they are counted."
            ),
            QT_TR_NOOP("Close other programs. If this continues, record fewer cameras or lower their resolution."),
            until="quiet",
            cause="busy",
            behind_s=round(behind_s, 1),
        )

    def _live_on_reserve(self) -> None:
        """Restrict the recording to events."""
        self._end_video(QT_TR_NOOP("The disk is full."))
        self._end_audio(None)
        self.problem(
            "error",
            QT_TR_NOOP("The disk is full: from now on, only events and robot data are recorded."),
            QT_TR_NOOP("{megabytes} are reserved for them. When this space is full, the recording ends."),
            QT_TR_NOOP("Free some disk space now, or stop the recording."),
            cause="disk",
            megabytes=_megabytes(self._reserve.left_bytes),
        )

    def _report_disk(self, disk: DiskState) -> None:
        free = _megabytes(disk.free_bytes or 0)
        if disk.stage == "out" and self._video_permitted:
            self._end_video(localized(QT_TR_NOOP("The disk is nearly full: {free} left."), free=free))
        elif disk.stage != "ample" and self._is_first("scarce"):
            self.problem(
                "warning",
                QT_TR_NOOP("The disk is filling up: {free} left.")
                if disk.room_s is None
                else QT_TR_NOOP("The disk is filling up: {free} left, enough for {time} at the current rate."),
                QT_TR_NOOP("The video frame rate is reduced when {lower} are left, and video stops at {end}."),
                QT_TR_NOOP("Delete or move files that you do not need."),
                cause="disk",
                free=free,
                time=_minutes(disk.room_s or 0.0),
                lower=_megabytes(self._limits.lower_video_free_bytes),
                end=_megabytes(self._limits.end_video_free_bytes),
            )
        if disk.slow and self._is_first("slow"):
            self.problem(
                "warning",
                localized(
                    QT_TR_NOOP("The disk is slow: writing the recorded data took {delay_s} s."),
                    delay_s=f"{disk.delay_s:.1f}",
                ),
                localized(
                    QT_TR_NOOP(
                        "Meanwhile, every second video frame is skipped. A power failure now could lose the "
                        "last {delay_s} s."
                    ),
                    delay_s=f"{disk.delay_s + 1:.0f}",
                ),
                QT_TR_NOOP(
                    "Close programs that use this disk, or choose a study folder on another disk for the next session."
                ),
                until="quiet",
                cause="disk",
            )

    def _end_video(self, message: str) -> None:
        if self._video_ended or not self._video_permitted:
            return
        self._video_ended = True
        self._reported.add("scarce")
        self._media.end_videos()
        self.problem(
            "error",
            message,
            QT_TR_NOOP("Video is no longer recorded; events, robot data and speech still are."),
            QT_TR_NOOP("Free some disk space, then stop and restart the recording."),
            cause="disk",
        )

    def _end_audio(self, error: OSError | None) -> None:
        if self._audio_ended or not self._audio_permitted:
            return
        self._audio_ended = True
        try:
            self._put_blocks(self._audio.close())
        except OSError:
            _log.exception("closing the sound of %s", self.folder)
        if error is not None and not no_room(error):
            self.problem(
                "error",
                QT_TR_NOOP("Audio is no longer recorded: {error}."),
                QT_TR_NOOP("Everything recorded so far is saved. Events and robot data are still recorded."),
                QT_TR_NOOP("Stop and restart the recording to record audio again."),
                error=error.strerror or error,
            )
        elif error is not None:
            self._on_reserve = True

    def _written_bytes(self) -> int:
        return (
            self._log.file.written_bytes
            + self._plain.written_bytes
            + self._media.written_bytes
            + self._audio.written_bytes
        )

    # session.json

    def _write_last_header(self) -> None:
        # A video that waited for space takes all that others released.
        self._reserve.release()
        self._write_header()
        forget_counts(self.folder)

    def _write_header(self) -> None:
        """Write the session header, before the session or after its end."""
        header = replace(self._header, pauses=tuple(self._pauses), dropped=dict(sorted(self.dropped.items())))
        if self._ended_ns is not None:
            header = header.ended(
                self._ended_ns,
                self._reason,
                counts=dict(sorted(self._log.counts.items())),
                videos=self._media.infos(),
                audio=self._audio.infos(),
                files=recorded_files(self.folder),
            )
        header.write(self.folder, on_full=self._make_room)


class _Held(Value):
    """Throttle of a topic: time of the last write, and the value waiting for the next."""

    spec: StreamSpec
    put_ns: int
    value: Any
    arrived_ns: int


def trial_metadata(trial: dict[str, str]) -> dict[str, str]:
    """Trial fields for the event log, in case session.json is lost; without the wizard, since the log is shared
    unchanged.
    """
    return {f"{TRIAL_METADATA}{key}": value for key, value in trial.items() if value and key != "wizard"}


_EVERY = {
    2: QT_TR_NOOP("{camera}: every second frame is recorded"),
    4: QT_TR_NOOP("{camera}: every fourth frame is recorded"),
}
_LONGEST_REASON = 200


def _short(reason: Exception | str) -> str:
    """Reason for the record. Longer texts come from elsewhere and are not translatable."""
    text = str(reason)
    return text if len(text) <= _LONGEST_REASON else text[:_LONGEST_REASON]


def _room_bytes(folder: Path, limits: DiskLimits) -> int:
    """Reserve size: as in the limits if the disk is large enough."""
    share_bytes = max(shutil.disk_usage(folder).free // _RESERVE_SHARE, _LEAST_RESERVE_BYTES)
    return min(limits.reserve_bytes, share_bytes)


def explain_start_error(error: OSError, folder: Path) -> tuple[str, str, str]:
    """What happened, what it means and what to do, as user texts."""
    meaning = QT_TR_NOOP("Nothing is being recorded. Driving and speaking still work.")
    if no_room(error):
        return (
            QT_TR_NOOP("The disk is full."),
            meaning,
            QT_TR_NOOP("Free some disk space, or choose another study folder, then record again."),
        )
    if isinstance(error, FileExistsError):
        return (
            localized(QT_TR_NOOP("{folder} already contains files."), folder=folder),
            meaning,
            QT_TR_NOOP("Record again: the next session gets its own folder."),
        )
    return (
        localized(QT_TR_NOOP("{folder} cannot be written to: {error}."), folder=folder, error=error.strerror or error),
        meaning,
        QT_TR_NOOP("Choose a writable study folder, then record again."),
    )


def _megabytes(count: int) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"


def _minutes(room_s: float) -> str:
    return f"{room_s / 60:.0f} min" if room_s >= 120 else f"{room_s:.0f} s"


def _since(chunk: AudioChunk, from_ns: int) -> AudioChunk:
    """Part of the chunk after ``from_ns``: the first chunk may have begun before audio was permitted."""
    missing_ns = from_ns - chunk.stamp_ns
    if missing_ns <= 0:
        return chunk
    first = -(-missing_ns * chunk.sample_rate_hz // 1_000_000_000)
    stamp_ns = chunk.stamp_ns + first * 1_000_000_000 // chunk.sample_rate_hz
    return replace(chunk, stamp_ns=stamp_ns, samples=chunk.samples[first:])
