"""Disk monitor of a session: remaining time at the present rate, write latency, and the expected size per hour."""

import logging
from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import numpy as np

from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session.session_header import SessionError, read_header

Stage = Literal["ample", "scarce", "low", "out"]
_STAGES: tuple[Stage, ...] = ("ample", "scarce", "low", "out")
_WINDOW_NS = 60_000_000_000
_SAMPLE_EVERY_NS = 900_000_000
# Before this time the growth of new files is not representative.
_FORECAST_AFTER_NS = 15_000_000_000
_RATE_AFTER_NS = 2_000_000_000
_BETTER_BY = 1.5
_SLOW_S, _VERY_SLOW_S, _FAST_AGAIN_S = 1.0, 2.0, 0.5


class DiskLimits(Value):
    """Thresholds of free space, or of time until the disk is full, for the recorder's reactions.

    ``reserve_bytes`` is set aside at the start for events (less on a small disk), ``closing_bytes`` of it for closing
    the session.
    """

    warn_free_bytes: int = 1024 * 1024 * 1024
    warn_room_s: float = 15 * 60.0
    lower_video_free_bytes: int = 256 * 1024 * 1024
    lower_video_room_s: float = 60.0
    end_video_free_bytes: int = 64 * 1024 * 1024
    end_video_room_s: float = 8.0
    reserve_bytes: int = 64 * 1024 * 1024
    reserve_steps: int = 8
    closing_bytes: int = 8 * 1024 * 1024
    close_media_s: float = 4.0


class DiskState(Value):
    """``bytes_per_s`` is the recent growth of the session; ``room_s`` includes what other programs write.

    ``stage``: at ``scarce`` the wizard is notified, at ``low`` video is reduced, at ``out`` it ends. ``delay_s`` is the
    longest recent write latency, ``slow`` whether that is too long.
    """

    free_bytes: int | None = None
    bytes_per_s: float = 0.0
    room_s: float | None = None
    stage: Stage = "ample"
    delay_s: float = 0.0
    slow: bool = False


class DiskWatch:
    """Evaluates measurements of the recorder, several per second."""

    def __init__(self, limits: DiskLimits) -> None:
        self._limits = limits
        self._samples: deque[tuple[int, int, int]] = deque()
        self.state = DiskState()

    def observe(self, now_ns: int, *, free_bytes: int, written_bytes: int, delays_s: Iterable[float]) -> DiskState:
        """Add a measurement. ``delays_s`` are recent latencies of writes and syncs; a single short delay does not make
        the disk slow.
        """
        longest_s, second_s, *_ = (*sorted(delays_s, reverse=True), 0.0, 0.0)
        if not self._samples or now_ns - self._samples[-1][0] >= _SAMPLE_EVERY_NS:
            self._samples.append((now_ns, free_bytes, written_bytes))
            while now_ns - self._samples[0][0] > _WINDOW_NS:
                self._samples.popleft()
        first_ns, first_free_bytes, first_written_bytes = self._samples[0]
        bytes_per_s, room_s = 0.0, None
        span_ns = now_ns - first_ns
        if span_ns >= _RATE_AFTER_NS:
            bytes_per_s = (written_bytes - first_written_bytes) / (span_ns / 1e9)
            shrinks_by = max(bytes_per_s, (first_free_bytes - free_bytes) / (span_ns / 1e9))
            room_s = free_bytes / shrinks_by if shrinks_by > 0 else None
        slow = longest_s > _VERY_SLOW_S or second_s > _SLOW_S
        if self.state.slow and not slow:
            slow = longest_s > _FAST_AGAIN_S
        forecast_s = room_s if span_ns >= _FORECAST_AFTER_NS else None
        self.state = DiskState(free_bytes, bytes_per_s, room_s, self._stage(free_bytes, forecast_s), longest_s, slow)
        return self.state

    def _stage(self, free_bytes: int, room_s: float | None) -> Stage:
        limits = self._limits
        worst_first: tuple[tuple[Stage, int, float], ...] = (
            ("out", limits.end_video_free_bytes, limits.end_video_room_s),
            ("low", limits.lower_video_free_bytes, limits.lower_video_room_s),
            ("scarce", limits.warn_free_bytes, limits.warn_room_s),
        )
        for stage, least_bytes, least_s in worst_first:
            # Hysteresis: leaving a stage takes more free space than entering it.
            margin = _BETTER_BY if _STAGES.index(self.state.stage) >= _STAGES.index(stage) else 1.0
            if free_bytes < least_bytes * margin or (room_s is not None and room_s < least_s * margin):
                return stage
        return "ample"


_log = logging.getLogger(__name__)
_SESSIONS_LOOKED_AT = 5
_LEAST_S = 20.0
# Measured with the simulated robot: LIDAR, poses, people and events; one 640x480 camera at 30 Hz; 16 kHz audio.
_EVENTS_BYTES_PER_HOUR = 60e6
_VIDEO_BYTES_PER_HOUR = 900e6
_SOUND_BYTES_PER_HOUR = 16_000 * 2 * 3600.0


def expected_bytes_per_hour(sessions: Path, *, scenario: str, video: bool, audio: bool) -> float:
    """Median of the newest sessions of this scenario in the folder ``sessions``; an estimate without any."""
    rates = []
    try:
        newest = sorted((path for path in sessions.iterdir() if path.is_dir()), reverse=True)
    except OSError as error:
        _log.info("sessions of the study: %s", error)
        newest = []
    for folder in newest[: 4 * _SESSIONS_LOOKED_AT]:
        rate = _bytes_per_hour(folder, scenario)
        if rate is not None:
            rates.append(rate)
        if len(rates) >= _SESSIONS_LOOKED_AT:
            break
    if rates:
        return float(np.median(rates))
    return _EVENTS_BYTES_PER_HOUR + _VIDEO_BYTES_PER_HOUR * video + _SOUND_BYTES_PER_HOUR * audio


def _bytes_per_hour(folder: Path, scenario: str) -> float | None:
    try:
        header = read_header(folder)
        if header.scenario.title != scenario or header.duration_s is None or header.duration_s < _LEAST_S:
            return None
        size = sum(path.stat().st_size for path in folder.iterdir() if path.is_file())
    except (SessionError, OSError) as error:
        _log.debug("%s does not count: %s", folder, error)
        return None
    return float(size / header.duration_s * 3600.0)
