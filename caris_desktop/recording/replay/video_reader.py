"""Video frames of a session by session time or frame number."""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.media_checks import FILM_OPTIONS
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session.media_files import (
    NO_ROBOT_STAMP,
    UNKNOWN,
    FrameTimes,
    camera_of_video,
    content_of,
    frame_times_of,
    index_path,
    read_frame_times,
    video_file_name,
)
from caris_desktop.recording.session.session_header import inside
from caris_desktop.recording.session.session_reader import Session

_log = logging.getLogger(__name__)
# Decoding this many frames is cheaper than a seek.
_FRAMES_PER_SEEK = 4


class RecordedFrame(Value):
    """One frame of a camera. ``number`` counts the camera's frames from 0 across all of its files."""

    camera: str
    number: int
    stamp_ns: int
    robot_stamp_ns: int | None
    file_name: str
    video_s: float


class VideoPicture(Value, eq=False):
    """Frame with its pixels: uint8 BGR, shape (height, width, 3)."""

    info: RecordedFrame
    image_bgr: NDArray[np.uint8]


class VideoReader:
    """Frames by time or number. One thread at a time; ``close`` when done.

    Files are opened on first use. An unreadable file counts as empty, with an entry in ``problems``.
    """

    def __init__(self, session: Session) -> None:
        self._videos: dict[str, list[_Video]] = {}
        self._firsts: dict[str, NDArray[np.int64]] = {}
        self._stamps: dict[str, NDArray[np.int64]] = {}
        self.problems: list[str] = [
            f"session.json contains an invalid entry for a video: {entry}" for entry in session.header.invalid_videos
        ]
        files = _files_of(session, self.problems)
        for path, camera, first_ns in sorted(files, key=lambda file: (file[2], file[0].name)):
            video = _Video(path, first_ns, session.header.size_of(path.name))
            self._videos.setdefault(camera, []).append(video)

    @property
    def cameras(self) -> tuple[str, ...]:
        """Cameras with video, in order of their start."""
        return tuple(self._videos)

    def frame_times_ns(self, camera: str) -> list[int]:
        """Stamps of all frames of a camera, ascending; empty without video."""
        times_ns: list[int] = self._stamps_ns(camera).tolist()
        return times_ns

    def info_at(self, camera: str, stamp_ns: int) -> RecordedFrame | None:
        """Info of the newest frame up to that time; None before the first."""
        number = int(np.searchsorted(self._stamps_ns(camera), stamp_ns, side="right")) - 1
        return None if number < 0 else self._info(camera, number)

    def frame_at(self, camera: str, stamp_ns: int, *, nearest_key: bool = False) -> VideoPicture | None:
        """Frame of :meth:`info_at` with its image.

        ``nearest_key`` returns the key frame at or before it, which is fast to seek; the info identifies it.
        """
        found = self.info_at(camera, stamp_ns)
        return None if found is None else self.frame(camera, found.number, nearest_key=nearest_key)

    def frame(self, camera: str, number: int, *, nearest_key: bool = False) -> VideoPicture | None:
        """Frame by number; None if there is none or it cannot be decoded."""
        decoded = self._decoded(camera, number, nearest_key=nearest_key)
        info = None if decoded is None else self._info(camera, decoded[0])
        if decoded is None or info is None:
            return None
        return VideoPicture(info, decoded[1].to_ndarray(format="bgr24"))

    def thumbnail(self, camera: str, stamp_ns: int, width_px: int) -> NDArray[np.uint8] | None:
        """Thumbnail for about that time: the key frame at or before it, ``width_px`` wide."""
        found = self.info_at(camera, stamp_ns)
        decoded = None if found is None else self._decoded(camera, found.number, nearest_key=True)
        if decoded is None:
            return None
        _, picture = decoded
        height_px = max(1, round(picture.height * width_px / picture.width))
        small = picture.reformat(width=width_px, height=height_px, format="bgr24", interpolation="AREA")
        image_bgr: NDArray[np.uint8] = small.to_ndarray()
        return image_bgr

    def packets(self, camera: str) -> Iterator[tuple[RecordedFrame, bytes]]:
        """Encoded frames of a camera in order: H.264 in Annex B, with parameter sets before each key frame. Empty for
        other codecs and with B frames; ends where a video is damaged.
        """
        videos = self._known(camera)
        for first, video in zip(self._firsts[camera].tolist(), videos, strict=True):
            for at, packet in zip(range(video.times.count), video.packets(), strict=False):
                info = self._info(camera, first + at)
                if info is not None:
                    yield info, packet

    def close(self) -> None:
        for videos in self._videos.values():
            for video in videos:
                video.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _stamps_ns(self, camera: str) -> NDArray[np.int64]:
        if camera not in self._stamps:
            parts = [video.times.stamps_ns for video in self._known(camera)]
            self._stamps[camera] = np.concatenate(parts) if parts else np.zeros(0, np.int64)
        return self._stamps[camera]

    def _known(self, camera: str) -> list["_Video"]:
        """The camera's videos with their frame times read."""
        videos = self._videos.get(camera, [])
        if camera not in self._firsts:
            for video in videos:
                problem = video.prepare()
                if problem:
                    _log.warning("%s", problem)
                    self.problems.append(problem)
            counts = [video.times.count for video in videos]
            self._firsts[camera] = np.cumsum([0, *counts])[:-1]
        return videos

    def _place(self, camera: str, number: int) -> tuple["_Video", int] | None:
        videos = self._known(camera)
        firsts = self._firsts[camera]
        which = int(np.searchsorted(firsts, number, side="right")) - 1
        # Of files without frames, the search finds the last; the one with the frame begins at the same number.
        while which >= 0 and number - firsts[which] >= videos[which].times.count:
            which -= 1
        if which < 0 or number < 0:
            return None
        return videos[which], number - int(firsts[which])

    def _decoded(self, camera: str, number: int, *, nearest_key: bool) -> tuple[int, Any] | None:
        """Number and image (PyAV) of a frame, or of the key frame at or before it."""
        place = self._place(camera, number)
        decoded = None if place is None else place[0].decode(place[1], nearest_key=nearest_key)
        return None if place is None or decoded is None else (number - place[1] + decoded[0], decoded[1])

    def _info(self, camera: str, number: int) -> RecordedFrame | None:
        place = self._place(camera, number)
        if place is None:
            return None
        video, at = place
        robot_stamp_ns = int(video.times.robot_stamps_ns[at])
        return RecordedFrame(
            camera=camera,
            number=number,
            stamp_ns=int(video.times.stamps_ns[at]),
            robot_stamp_ns=None if robot_stamp_ns == NO_ROBOT_STAMP else robot_stamp_ns,
            file_name=video.path.name,
            video_s=float(video.times.video_s[at]),
        )


class _Video:
    """One file. ``times`` is valid after :meth:`prepare`; the file is opened for the first image."""

    def __init__(self, path: Path, first_ns: int, recorded_bytes: int | None) -> None:
        """``recorded_bytes`` is the file's size when its session was closed."""
        self.path = path
        self._recorded_bytes = recorded_bytes
        self.times = FrameTimes.none()
        self._first_ns = first_ns
        self._container: Any = None
        self._stream: Any = None
        self._shown_ticks: list[int] = []
        self._frames: Iterator[Any] = iter(())
        self._at: tuple[int, Any] | None = None
        self._failed = False

    def prepare(self) -> str:
        """Read the frame times; return a problem with the file as text, or an empty one."""
        try:
            self.times = read_frame_times(index_path(self.path))
        except FileNotFoundError:
            # Sessions of older versions have none; the video's own times are good to 11 µs.
            return self._read_own_times()
        except (OSError, ValueError) as error:
            return self._read_own_times() or f"The frame times of {self.path.name} cannot be read: {error}."
        if not self.path.is_file():
            return f"{self.path.name} is missing."
        if self._recorded_bytes is not None and self.path.stat().st_size < self._recorded_bytes:
            content = content_of(self.path)
            left = 0 if content is None else len(content.times_s)
            if left < self.times.count:  # otherwise it was encoded again
                self.times = self.times.first(left)
                return f"{self.path.name} is truncated: {left} frames are left."
        return ""

    def decode(self, number: int, *, nearest_key: bool) -> tuple[int, Any] | None:
        """Number and image (PyAV) of a frame, or of the key frame at or before it."""
        if self._failed or not self._opened():
            return None
        try:
            return self._decoded(number, nearest_key=nearest_key)
        except Exception as error:
            # PyAV raises its own error types, and a damaged file may raise any of them.
            _log.warning("%s cannot be read at frame %d: %s", self.path, number, error)
            self._at, self._frames = None, iter(())
            return None

    def packets(self) -> Iterator[bytes]:
        """Encoded frames in order."""
        import av
        from av.bitstream import BitStreamFilterContext

        try:
            with av.open(str(self.path), options=FILM_OPTIONS) as container:
                stream = container.streams.video[0]
                if stream.codec_context.codec.canonical_name != "h264" or stream.codec_context.has_b_frames:
                    return
                to_annex_b = BitStreamFilterContext("h264_mp4toannexb", stream)
                for packet in container.demux(stream):
                    # The last packet is empty and flushes the filter.
                    yield from map(bytes, to_annex_b.filter(packet) if packet.size else ())
        except (av.error.FFmpegError, OSError, IndexError) as error:
            _log.warning("%s cannot be read: %s", self.path, error)

    def close(self) -> None:
        if self._container is not None:
            self._container.close()
            self._container, self._stream, self._at, self._frames = None, None, None, iter(())

    def _opened(self) -> bool:
        if self._container is not None:
            return True
        import av

        try:
            self._container = av.open(str(self.path), options=FILM_OPTIONS)
            self._stream = self._container.streams.video[0]
            self._stream.thread_type = "SLICE"
            if self._stream.codec_context.has_b_frames:
                packets = self._container.demux(self._stream)
                self._shown_ticks = sorted(packet.pts for packet in packets if packet.pts is not None)
        except (av.error.FFmpegError, OSError, IndexError) as error:
            _log.warning("%s cannot be read: %s", self.path, error)
            self._failed = True
            return False
        return True

    def _read_own_times(self) -> str:
        if not self._opened():
            return f"{self.path.name} cannot be read: the session is shown without this video."
        numbers = range(len(self._shown_ticks or self._stream.index_entries))
        video_s = np.array([self._tick(number) for number in numbers]) * float(self._stream.time_base)
        stamps_ns = self._first_ns + np.round(video_s * 1e9).astype(np.int64)
        unknown = np.full(len(stamps_ns), UNKNOWN, np.int64)
        self.times = FrameTimes(video_s, stamps_ns, unknown, unknown, np.full(len(stamps_ns), np.nan))
        return ""

    def _tick(self, number: int) -> int:
        """Time of a frame in the video. The index has times of decoding, which differ with B frames: most programs that
        encode a video again add them.
        """
        if self._shown_ticks:
            return self._shown_ticks[number]
        return int(self._stream.index_entries[number].timestamp)

    def _decoded(self, number: int, *, nearest_key: bool) -> tuple[int, Any] | None:
        entries = self._stream.index_entries
        if number >= len(entries):
            return None
        tick = self._tick(number)
        key = entries.search_timestamp(entries[number].timestamp, backward=True)
        target = key if nearest_key and key >= 0 else number
        if self._at is not None and self._at[0] == target:
            return self._at
        ahead = None if self._at is None else target - self._at[0]
        if ahead is None or ahead < 0 or ahead > target - key + _FRAMES_PER_SEEK:
            self._container.seek(tick, stream=self._stream)
            self._frames = self._container.decode(self._stream)
        target_tick = self._tick(target)
        self._at = None
        for picture in self._frames:
            if picture.pts is not None and picture.pts >= target_tick:
                self._at = (target, picture)
                return self._at
        return None


def _files_of(session: Session, problems: list[str]) -> list[tuple[Path, str, int]]:
    """Path, camera and first stamp of each video: by the header, else by the files present."""
    files: dict[str, tuple[Path, str, int]] = {}
    for video in session.header.videos:
        name = video.file_name
        if not inside(session.folder, name):
            problems.append(f"{name} is outside the session folder. It is skipped.")
        elif not (session.folder / name).is_file():
            problems.append(f"{name} is missing.")
        else:
            files[name] = (session.folder / name, video.camera, video.first_stamp_ns)
    # The header of an interrupted recording does not list them.
    others = [path for path in sorted(session.folder.glob("video-*.mp4")) if path.name not in files]
    others = [path for path in others if inside(session.folder, path.name)]
    if others and session.header.ended_ns is None:
        files |= {path.name: file for path in others if (file := _unnamed(session, path)) is not None}
    return list(files.values())


def _unnamed(session: Session, path: Path) -> tuple[Path, str, int] | None:
    """Video missing in the header: its camera is a recorded one, its start comes from its index or the log."""
    cameras: dict[str, int] = {}
    for _, value in session.values("frame"):
        if isinstance(value, FrameRef) and value.camera not in cameras:
            cameras[value.camera] = value.stamp_ns
            if video_file_name(value.camera, set()) == path.name:
                break
    camera = camera_of_video(path.name, cameras)
    times = frame_times_of(path)
    return path, camera, int(times.stamps_ns[0]) if times.count else cameras.get(camera, session.started_ns)
