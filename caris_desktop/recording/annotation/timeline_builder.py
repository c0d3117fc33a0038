"""Build the overview of a session for its timeline: tiers, waveforms and speed curve in one pass."""

import logging
import math
import os
import re
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.events import CommandSent
from caris_desktop.domain.sensing import AudioBlock, Odometry, RobotPose
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.recording.annotation.session_tiers import tiers_of, types_of_tiers
from caris_desktop.recording.annotation.timeline_overview import Moment, SessionOverview, Waveform
from caris_desktop.recording.session.media_files import WavReader
from caris_desktop.recording.session.session_conversation import SpokenUtterance
from caris_desktop.recording.session.session_data import SessionData
from caris_desktop.recording.session.session_marks import FinalMark
from caris_desktop.recording.session.session_reader import Session

BUCKET_NS = 20_000_000
_SPEED_EVERY_NS = 50_000_000
_POSE_EVERY_NS = 200_000_000  # the speed between closer poses is mostly noise
_LONGEST_STEP_NS = 2_000_000_000
_LONGEST_NS = 48 * 3600 * 1_000_000_000  # a stamp far outside the session must not exhaust memory
_SPEAKERS = {"participant": QT_TR_NOOP("participant"), "robot": QT_TR_NOOP("robot"), "wizard": QT_TR_NOOP("wizard")}
_MARKS = {"wizard_error": QT_TR_NOOP("Wizard error"), "note": QT_TR_NOOP("Note"), "mark": QT_TR_NOOP("Mark")}
_log = logging.getLogger(__name__)


def build_overview(session: Session) -> SessionOverview:
    """Build the overview. Raises SessionError.

    Reads events, odometry (else poses, else commands) and the audio index; skips scans, maps and video. An unreadable
    audio file is logged and left out.
    """
    data, speed, sound = SessionData(session), _Speed(session.started_ns), _Sound(session)
    streams = [BY_TYPE[kind].name for kind in types_of_tiers()]
    for _, value in session.values(*streams, "odometry", "pose", "audio"):
        match value:
            case Odometry() | RobotPose():
                speed.add(value)
            case AudioBlock():
                sound.add(value)
            case _:
                data.add(value)
                if isinstance(value, CommandSent):
                    speed.add(value)
    moments = [Moment("mark", mark.start_ns, _mark_text(mark)) for mark in data.marks]
    moments += [
        Moment("utterance", item.start_ns, _said(item))
        for item in data.utterances
        if item.said and item.start_ns is not None
    ]
    moments.sort(key=lambda moment: moment.at_ns)
    there = (video.camera for video in session.header.videos if (session.folder / video.file_name).is_file())
    cameras = tuple(dict.fromkeys(camera for camera in there if camera))
    return SessionOverview(tiers_of(data), tuple(moments), tuple(sound.waveforms()), speed.curve(), cameras, data.steps)


def run_overview(connection: Connection, session: Session) -> None:
    """Process entry point: send the SessionOverview and exit."""
    if hasattr(os, "nice"):
        os.nice(5)
    connection.send(build_overview(session))


def _said(item: SpokenUtterance) -> str:
    who = localized(_SPEAKERS[item.speaker]) if item.speaker in _SPEAKERS else item.speaker
    return localized(QT_TR_NOOP("{who}: {text}"), who=who, text=item.text)


def _mark_text(mark: FinalMark) -> str:
    label = mark.label or localized(_MARKS[mark.kind])
    return localized(QT_TR_NOOP("{label}: {note}"), label=label, note=mark.note) if mark.note else label


class _Speed:
    """Speed curve, at most 20 points per second."""

    def __init__(self, started_ns: int) -> None:
        self._started_ns = started_ns
        self._points: dict[type[Any], list[tuple[float, float, float]]] = {Odometry: [], RobotPose: [], CommandSent: []}
        self._next_ns: dict[type[Any], int] = {}
        self._pose: RobotPose | None = None

    def add(self, value: Odometry | RobotPose | CommandSent) -> None:
        if value.stamp_ns < self._next_ns.get(type(value), value.stamp_ns):
            return
        every_ns = _POSE_EVERY_NS if isinstance(value, RobotPose) else _SPEED_EVERY_NS
        self._next_ns[type(value)] = value.stamp_ns + every_ns
        second = (value.stamp_ns - self._started_ns) / 1e9
        if isinstance(value, RobotPose):
            before, self._pose = self._pose, value
            step_ns = value.stamp_ns - before.stamp_ns if before is not None else 0
            if before is None or not 0 < step_ns <= _LONGEST_STEP_NS:
                return
            was, now = before.pose_in_map, value.pose_in_map
            speed_mps = math.hypot(now.x_m - was.x_m, now.y_m - was.y_m) / step_ns * 1e9
            turn_radps = math.remainder(now.heading_rad - was.heading_rad, 2 * math.pi) / step_ns * 1e9
            self._points[RobotPose].append((second, speed_mps, turn_radps))
        else:
            twist = value.twist
            speed_mps = math.copysign(math.hypot(twist.forward_mps, twist.left_mps), twist.forward_mps)
            self._points[type(value)].append((second, speed_mps, twist.turn_radps))

    def curve(self) -> NDArray[np.float32]:
        points = next((points for points in self._points.values() if points), [])
        return np.array(points, np.float32).reshape(-1, 3)


class _Sound:
    """Computes the waveforms of the session's audio files."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._blocks: dict[str, list[AudioBlock]] = {}

    def add(self, block: AudioBlock) -> None:
        within = abs(block.stamp_ns - self._session.started_ns) < _LONGEST_NS
        if block.sample_rate_hz > 0 and block.sample_count > 0 and block.first_sample >= 0 and within:
            self._blocks.setdefault(block.file_name, []).append(block)

    def waveforms(self) -> Iterator[Waveform]:
        for file_name, blocks in self._blocks.items():
            try:
                yield _waveform(blocks, self._session.folder)
            except (OSError, ValueError) as error:
                _log.warning("%s: no waveform of %s: %s", self._session.folder, file_name, error)


def _waveform(blocks: list[AudioBlock], folder: Path) -> Waveform:
    """Waveform of one file. Raises OSError, and ValueError if it is not a session's audio file."""
    source, file_name = blocks[0].source, blocks[0].file_name
    if not re.fullmatch(r"[\w .-]+", file_name):
        raise ValueError("not a file of the session")
    times = [(block.stamp_ns, block.first_sample, block.sample_count, block.sample_rate_hz) for block in blocks]
    runs = sound_runs(times, within_ns=BUCKET_NS // 2)
    first_ns = min(stamp_ns for stamp_ns, *_ in runs)
    last_ns = max(stamp_ns + count * 1_000_000_000 // rate for stamp_ns, _, count, rate in runs)
    if last_ns - first_ns > _LONGEST_NS:
        raise ValueError("it says that it is longer than two days")
    peaks = np.zeros(((last_ns - first_ns) // BUCKET_NS + 1, 2), np.float32)
    with WavReader(folder / file_name) as wav:
        for stamp_ns, first, count, rate in runs:
            for at, samples in wav.read(first, count):
                offsets_ns = (at - first + np.arange(len(samples), dtype=np.int64)) * 1_000_000_000 // rate
                buckets = (stamp_ns - first_ns + offsets_ns) // BUCKET_NS
                starts = np.flatnonzero(np.diff(buckets, prepend=-1))
                where = buckets[starts]
                peaks[where, 0] = np.minimum(peaks[where, 0], np.minimum.reduceat(samples, starts))
                peaks[where, 1] = np.maximum(peaks[where, 1], np.maximum.reduceat(samples, starts))
    return Waveform(source, first_ns, BUCKET_NS, peaks)


def sound_runs(blocks: Sequence[tuple[int, int, int, int]], *, within_ns: int) -> list[tuple[int, int, int, int]]:
    """Continuous runs of an audio file, from blocks of (stamp_ns, first_sample, sample_count, sample_rate_hz).

    A single run if file time maps to session time within ``within_ns``, as the recorder writes it; otherwise blocks are
    joined where they are contiguous in file and in time.
    """
    begins_ns = sorted(stamp_ns - first * 1_000_000_000 // rate for stamp_ns, first, _, rate in blocks)
    begin_ns = begins_ns[len(begins_ns) // 2]
    unrest_ns = max(begin_ns - begins_ns[0], begins_ns[-1] - begin_ns)
    if unrest_ns <= within_ns and len({rate for *_, rate in blocks}) == 1:
        return [(begin_ns, 0, max(first + count for _, first, count, _ in blocks), blocks[0][3])]
    runs: list[tuple[int, int, int, int]] = []
    for block in sorted(blocks, key=lambda block: block[1]):
        if runs:
            stamp_ns, first, count, rate = runs[-1]
            due_ns = stamp_ns + count * 1_000_000_000 // rate
            if block[3] == rate and block[1] == first + count and abs(block[0] - due_ns) <= within_ns:
                runs[-1] = (stamp_ns, first, count + block[2], rate)
                continue
        runs.append(block)
    return runs
