"""Expected size per hour of recording, from the study's sessions or else from typical values."""

import logging
from pathlib import Path

import numpy as np

from caris_desktop.recording.session.session_header import SessionError, read_header

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
