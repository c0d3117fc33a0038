"""Training data in the LeRobot dataset format v3.0: frames as Parquet, a video per camera, metadata and statistics.

The format: https://huggingface.co/docs/lerobot/lerobot-dataset-v3
"""

import json
import logging
import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import astuple
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.events import CommandSent, GoalChanged, HeadMoved
from caris_desktop.domain.geometry import Twist2D
from caris_desktop.domain.schema import to_jsonable
from caris_desktop.domain.sensing import HeadState, LaserScan, Odometry, People, PeopleInMap, RobotPose
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.exporters.exported_pictures import camera_file_name
from caris_desktop.recording.recorder.video_writer import KEY_FRAME_EVERY_S, x264
from caris_desktop.recording.replay.video_reader import RecordedFrame, VideoReader
from caris_desktop.recording.session.robot_clock_mapping import robot_clock
from caris_desktop.recording.session.session_data import SessionData, read_data
from caris_desktop.recording.session.session_header import SessionError
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session.session_robot import COMMAND_HOLDS_S
from caris_desktop.recording.session_export import attempt
from caris_desktop.recording.tables.catalog import key_values, plain_text

_log = logging.getLogger(__name__)
MAX_AGE_S = 1.0
"""A frame has no value that arrived longer before it."""
FPS_WITHOUT_CAMERA = 10
_MOST_HZ = 250.0  # of the fastest cameras
PICTURE_WIDTH_PX = 640
"""Videos are no wider: what learns from them makes them smaller still."""
EPISODE_MARK = "episode"
"""Interval marks with a label that begins so are the episodes of their session."""
_QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)
# Statistics use about so many frames and images at most, and of an image about so many columns.
_SAMPLES, _IMAGE_SAMPLES, _SAMPLE_WIDTH_PX = 10_000, 500, 40
_ROWS_PER_WRITE = 1000
_DATA, _EPISODES = (
    f"{folder}/chunk-{{chunk_index:03d}}/file-{{file_index:03d}}.parquet" for folder in ("data", "meta/episodes")
)
_VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
_FIRST = {"chunk_index": 0, "file_index": 0}
_CHUNK_FILES = 1000
_POSE, _TWIST, _HEAD = ("x_m", "y_m", "heading_rad"), ("forward_mps", "left_mps", "turn_radps"), ("pan_rad", "tilt_rad")
_STATE: dict[str, tuple[type[Any], tuple[str, ...], Callable[[Any], tuple[float, ...]]]] = {
    "odometry": (Odometry, (*_POSE, *_TWIST), lambda value: (*astuple(value.pose_in_odom), *astuple(value.twist))),
    "head": (HeadState, _HEAD, lambda value: (value.pan_rad, value.tilt_rad)),
    "map": (RobotPose, _POSE, lambda value: astuple(value.pose_in_map)),
    "goal": (
        GoalChanged,
        _POSE,
        lambda value: astuple(value.target_in_map) if value.state in ("requested", "active") else (),
    ),
}
"""Parts of the state: type of their values, names of the numbers, and the numbers; none if the value has ended."""
_STREAMS = tuple(
    BY_TYPE[kind].name
    for kind in (*(kind for kind, _, _ in _STATE.values()), LaserScan, People, PeopleInMap, HeadMoved, CommandSent)
)
_Samples = dict[str, list[NDArray[Any]]]


class Dataset(Value):
    """Files written, numbers of episodes and frames, and frames per second."""

    paths: tuple[Path, ...]
    episodes: int
    frames: int
    fps: int


class _Layout(Value, eq=False):
    """What all sessions of a dataset share: the rate, the sizes of the videos by the keys of their features, and the
    beams that all scans are given in. ``frames`` is about how many there are.
    """

    fps: int
    sizes_px: dict[str, tuple[int, int]]
    scan: LaserScan | None
    frames: int


def write_lerobot(
    sessions: Sequence[Session],
    out: Path,
    progress: Callable[[float], None],
    warn: Callable[[str], None] = _log.warning,
) -> Dataset:
    """Write one dataset of these sessions into the new folder ``out``; nothing if they have no frames.

    Cameras, scans and the rate are those of all sessions: a camera that a session lacks is black and not observed, and
    scans are given in the beams of the first. ``warn`` gets a sentence on each session that was left out.

    Raises OSError, and SessionError if no session could be read.
    """
    if len(sessions) == 1:
        dataset = _Writer(out, _layout_of(sessions[0]))
        dataset.add(sessions[0], progress)
        return dataset.finish()
    layouts: list[_Layout] = []
    readable = [one for one in sessions if attempt(one, lambda each: layouts.append(_layout_of(each)), warn)]
    dataset = _Writer(out, _shared(layouts))
    added = 0
    for number, session in enumerate(readable):

        def add(one: Session, number: int = number) -> bool:
            dataset.add(one, lambda fraction: progress((number + fraction) / len(readable)))
            return True

        added += attempt(session, add, warn)
    if not added:
        raise SessionError(QT_TR_NOOP("No session could be read, so there is no dataset."))
    return dataset.finish()


def _layout_of(session: Session) -> _Layout:
    """Layout of a dataset of this session alone. Raises SessionError."""
    rates_hz: list[float] = []
    sizes_px: dict[str, tuple[int, int]] = {}
    with VideoReader(session) as videos:
        for key, camera in _keys_of(videos.cameras).items():
            stamps_ns = np.array(videos.frame_times_ns(camera), np.int64)
            steps_ns = np.diff(stamps_ns)
            if (steps_ns := steps_ns[steps_ns > 0]).size:  # a robot's stamps may be whole seconds, or step back
                rates_hz.append(min(_MOST_HZ, 1e9 / float(np.median(steps_ns))))
            # Not all of them: a damaged video has no frame that can be decoded.
            pictures = (videos.frame(camera, number) for number in range(len(stamps_ns))[:50])
            if (first := next((picture for picture in pictures if picture is not None), None)) is not None:
                height_px, width_px = first.image_bgr.shape[:2]
                scale = min(1.0, PICTURE_WIDTH_PX / width_px)
                sizes_px[key] = max(2, round(width_px * scale) // 2 * 2), max(2, round(height_px * scale) // 2 * 2)
    fps = max(1, round(max(rates_hz, default=FPS_WITHOUT_CAMERA)))
    scan = next((scan for _, scan in session.values("scan") if len(scan.ranges_m)), None)
    return _Layout(fps, sizes_px, scan, round(session.duration_s * fps))


def _shared(layouts: Sequence[_Layout]) -> _Layout:
    """Layout of all sessions: the highest rate, all cameras, and the beams and sizes of the first that has them."""
    fps = max((layout.fps for layout in layouts), default=FPS_WITHOUT_CAMERA)
    sizes_px = {key: size_px for layout in reversed(layouts) for key, size_px in layout.sizes_px.items()}
    scan = next((layout.scan for layout in layouts if layout.scan is not None), None)
    return _Layout(fps, sizes_px, scan, round(sum(layout.frames / layout.fps for layout in layouts) * fps))


def _keys_of(cameras: Iterable[str]) -> dict[str, str]:
    """Key of the feature of each camera."""
    keys: dict[str, str] = {}
    for camera in cameras:
        key = f"observation.images.{camera_file_name(camera)}"
        keys[f"{key}-{len(keys) + 1}" if key in keys else key] = camera
    return keys


def _episodes(data: SessionData, fps: int) -> Iterator[tuple[int, int]]:
    """Start and number of frames of each episode: the marked intervals, else the whole trial, without pauses."""
    session = data.session
    marked = [
        (mark.start_ns, mark.end_ns)
        for mark in data.marks
        if mark.end_ns is not None and mark.label.strip().casefold().startswith(EPISODE_MARK)
    ]
    begin_ns = session.started_ns
    for start_ns, end_ns in marked or [(session.started_ns, session.ended_ns)]:
        begin_ns, last_ns = max(begin_ns, start_ns), min(end_ns, session.ended_ns)
        for pause_ns, resumed_ns in (*data.pauses, (last_ns, last_ns)):
            frames = (min(pause_ns, last_ns) - begin_ns) * fps // 1_000_000_000
            if frames > 0:
                yield begin_ns, frames
            begin_ns = max(begin_ns, min(resumed_ns, last_ns))


class _Video:
    """Video of one camera at the rate of the dataset; black where there is no frame, and without a ``camera``."""

    def __init__(self, videos: VideoReader, camera: str | None, path: Path, size_px: tuple[int, int], fps: int) -> None:
        import av

        self.path = path
        self.size_px = size_px
        self._videos, self._camera, self._fps = videos, camera, fps
        self._black = np.zeros((*self.size_px[::-1], 3), np.uint8)
        self._image_bgr, self._number, self._frames = self._black, -1, 0
        path.parent.mkdir(parents=True, exist_ok=True)
        self._container = av.open(str(path), "w", options={"movflags": "faststart"})
        encoder = x264("veryfast")
        options = {**dict(encoder.options), "g": str(max(1, round(KEY_FRAME_EVERY_S * fps)))}
        self._stream: Any = self._container.add_stream(encoder.name, rate=fps, options=options)
        self._stream.width, self._stream.height = self.size_px
        self._stream.pix_fmt = encoder.pixel_format

    def __enter__(self) -> "_Video":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self._container.mux(self._stream.encode(None))
        self._container.close()

    def write(self, at_ns: int) -> RecordedFrame | None:
        """Encode the newest frame that had arrived by ``at_ns``, and return it; None if there was none."""
        import av
        import cv2

        found = None if self._camera is None else self._videos.info_at(self._camera, at_ns)
        if self._camera is None or found is None or at_ns - found.stamp_ns > MAX_AGE_S * 1e9:
            self._image_bgr, self._number = self._black, -1
        elif found.number != self._number:
            self._image_bgr, self._number = self._black, found.number
            picture = self._videos.frame(self._camera, found.number)
            if picture is not None:
                resized = cv2.resize(picture.image_bgr, self.size_px, interpolation=cv2.INTER_AREA)
                self._image_bgr = np.asarray(resized, np.uint8)
        frame = av.VideoFrame.from_ndarray(self._image_bgr, format="bgr24")
        frame.pts, frame.time_base = self._frames, Fraction(1, self._fps)
        self._frames += 1
        self._container.mux(self._stream.encode(frame))
        return None if self._image_bgr is self._black else found

    def pixels(self) -> NDArray[np.uint8]:
        """Some pixels of the newest image: RGB, shape (pixels, 3)."""
        every = max(1, self.size_px[0] // _SAMPLE_WIDTH_PX)
        return self._image_bgr[::every, ::every, ::-1].reshape(-1, 3)


def _video_feature(size_px: tuple[int, int], fps: int) -> dict[str, Any]:
    width_px, height_px = size_px
    video = {"height": height_px, "width": width_px, "codec": "h264", "pix_fmt": "yuv420p", "is_depth_map": False}
    video |= {"fps": fps, "channels": 3}
    info = {**{f"video.{name}": value for name, value in video.items()}, "has_audio": False}
    return {"dtype": "video", "shape": [height_px, width_px, 3], "names": ["height", "width", "channels"], "info": info}


class _Situation:
    """Newest value of each type and camera by arrival: what the console knew at a time. Times ascend."""

    def __init__(self, session: Session) -> None:
        self._clock = robot_clock(session)
        self._arrivals = session.arrivals(*_STREAMS)
        self._next = next(self._arrivals, None)
        self._newest: dict[Any, tuple[Any, int]] = {}

    def advance(self, until_ns: int) -> None:
        while self._next is not None and self._next[0] <= until_ns:
            arrival_ns, _, value = self._next
            self._newest[type(value), getattr(value, "camera", "")] = value, arrival_ns
            self._next = next(self._arrivals, None)

    def newest(self, kind: type[Any], at_ns: int, most_s: float = MAX_AGE_S, camera: str = "") -> Any:
        """Value and its age in seconds; (None, None) if there is none, or it arrived longer ago than ``most_s``."""
        value, arrival_ns = self._newest.get((kind, camera), (None, 0))
        if value is None or at_ns - arrival_ns > most_s * 1e9:
            return None, None
        return value, self.age_s(getattr(value, "robot_stamp_ns", None), arrival_ns, at_ns)

    def json_of(self, kind: type[Any], at_ns: int) -> str:
        """Values of all cameras."""
        cameras = [camera for known, camera in self._newest if known is kind]
        values = [self.newest(kind, at_ns, camera=camera)[0] for camera in cameras]
        content = [to_jsonable(value) for value in values if value is not None]
        return plain_text(json.dumps(content, ensure_ascii=False))

    def age_s(self, robot_stamp_ns: int | None, arrival_ns: int, at_ns: int) -> float:
        """Time since the measurement if the robot's clock is known, else since the arrival."""
        measured = self._clock.measured(robot_stamp_ns, arrival_ns=arrival_ns)
        return (at_ns - (arrival_ns if measured is None else measured.stamp_ns)) / 1e9


class _Writer:
    """Writes a dataset, session by session: each has files of its own, so that one that fails leaves none.

    Raises OSError.
    """

    def __init__(self, out: Path, layout: _Layout) -> None:
        import pyarrow

        self._out, self._layout = out, layout
        self._features = _features(layout)
        self._stored = {key: feature for key, feature in self._features.items() if feature["dtype"] != "video"}
        types = {key: pyarrow.type_for_alias(feature["dtype"]) for key, feature in self._stored.items()}
        sizes = {key: feature["shape"][0] for key, feature in self._stored.items()}
        self._schema = pyarrow.schema(
            {key: one if sizes[key] == 1 else pyarrow.list_(one, sizes[key]) for key, one in types.items()}
        )
        self._files, self._paths, self._robots = 0, list[Path](), dict[str, None]()
        self._tasks: dict[str, int] = {}
        self._records: list[dict[str, Any]] = []
        self._samples: _Samples = {}

    def add(self, session: Session, progress: Callable[[float], None]) -> int:
        """Add the episodes of a session; return their number. Raises SessionError, and then adds none."""
        data, fps = read_data(session), self._layout.fps
        episodes = list(_episodes(data, fps))
        if not episodes:
            progress(1.0)
            return 0
        place = {"chunk_index": self._files // _CHUNK_FILES, "file_index": self._files % _CHUNK_FILES}
        videos_of = {key: self._out / _VIDEO.format(video_key=key, **place) for key in self._layout.sizes_px}
        paths, tasks = [*videos_of.values(), self._out / _DATA.format(**place)], dict(self._tasks)
        paths[-1].parent.mkdir(parents=True, exist_ok=True)
        try:
            with VideoReader(session) as videos, ExitStack() as files:
                cameras = _keys_of(videos.cameras)
                written = {
                    key: files.enter_context(_Video(videos, cameras.get(key), path, self._layout.sizes_px[key], fps))
                    for key, path in videos_of.items()
                }
                source = _Frames(data, self._layout, written, tasks)
                records, samples = self._write(source, place, episodes, progress)
        except BaseException:
            for path in paths:
                path.unlink(missing_ok=True)
            raise
        self._robots[session.header.robot.profile] = None
        self._files, self._tasks = self._files + 1, tasks
        self._paths += paths
        self._records += records
        for key, values in samples.items():
            self._samples.setdefault(key, []).extend(values)
        return len(episodes)

    def _write(
        self,
        source: "_Frames",
        place: dict[str, int],
        episodes: Sequence[tuple[int, int]],
        progress: Callable[[float], None],
    ) -> tuple[list[dict[str, Any]], _Samples]:
        """Write the frames of a session; return what is known of its episodes, and samples."""
        import pyarrow
        from pyarrow.parquet import ParquetWriter

        fps, total = self._layout.fps, sum(frames for _, frames in episodes)
        first = index = self._records[-1]["dataset_to_index"] if self._records else 0
        records: list[dict[str, Any]] = []
        samples_of_all: _Samples = {}
        with ParquetWriter(self._out / _DATA.format(**place), self._schema) as file:
            for number, (start_ns, frames) in enumerate(episodes, start=len(self._records)):
                samples: _Samples = {}
                rows: list[dict[str, Any]] = []
                tasks: dict[int, None] = {}
                for at in range(frames):
                    row = source.values(start_ns, at)
                    row |= {"timestamp": at / fps, "frame_index": at, "episode_index": number, "index": index}
                    rows.append(row)
                    tasks[row["task_index"]] = None
                    index += 1
                    self._sample(row, samples, source.cameras)
                    if len(rows) == _ROWS_PER_WRITE or at == frames - 1:
                        file.write_table(pyarrow.Table.from_pylist(rows, self._schema))
                        rows.clear()
                        progress((index - first) / total)
                record = {"episode_index": number, "tasks": [[*source.tasks][task] for task in tasks], "length": frames}
                record |= {"dataset_from_index": index - frames, "dataset_to_index": index}
                record |= {f"data/{name}": value for name, value in place.items()}
                record |= {f"meta/episodes/{name}": value for name, value in _FIRST.items()}
                times_s = {"from_timestamp": (index - frames - first) / fps, "to_timestamp": (index - first) / fps}
                for key in source.cameras:
                    record |= {f"videos/{key}/{name}": value for name, value in {**place, **times_s}.items()}
                record |= {
                    f"stats/{key}/{name}": value
                    for key, its in _statistics(samples).items()
                    for name, value in its.items()
                }
                records.append(record | source.about_episode(start_ns))
                for key, values in samples.items():
                    samples_of_all.setdefault(key, []).extend(values)
        return records, samples_of_all

    def _sample(self, row: dict[str, Any], samples: _Samples, cameras: dict[str, _Video]) -> None:
        """Add the frame to the samples if it is its turn."""
        if not row["frame_index"] % max(1, self._layout.frames // _SAMPLES):
            for key, feature in self._stored.items():
                if feature["dtype"] != "string":
                    samples.setdefault(key, []).append(np.atleast_1d(row[key]))
        if not row["frame_index"] % max(1, self._layout.frames // _IMAGE_SAMPLES):
            for key, video in cameras.items():
                samples.setdefault(key, []).append(video.pixels())

    def finish(self) -> Dataset:
        """Write what describes the dataset."""
        if not self._records:
            return Dataset((), 0, 0, self._layout.fps)
        self._write_metadata(self._records, _statistics(self._samples))
        frames = self._records[-1]["dataset_to_index"]
        return Dataset(tuple(self._paths), len(self._records), frames, self._layout.fps)

    def _write_metadata(self, records: list[dict[str, Any]], statistics: dict[str, Any]) -> None:
        import pyarrow
        from pyarrow.parquet import write_table

        write_table(pyarrow.Table.from_pylist(records), self._new(_EPISODES))
        tasks = pyarrow.table({"task_index": list(self._tasks.values()), "task": list(self._tasks)})
        # For pandas, with which the lerobot package reads the table: the text is the index.
        columns = [
            dict.fromkeys(("name", "field_name"), name) | dict.fromkeys(("pandas_type", "numpy_type"))
            for name in tasks.column_names
        ]
        of_pandas = json.dumps({"index_columns": ["task"], "column_indexes": [], "columns": columns})
        write_table(tasks.replace_schema_metadata({"pandas": of_pandas}), self._new("meta/tasks.parquet"))
        info = {
            "codebase_version": "v3.0",
            "robot_type": ", ".join(self._robots),
            "total_episodes": len(records),
            "total_frames": records[-1]["dataset_to_index"],
            "total_tasks": len(self._tasks),
            "chunks_size": _CHUNK_FILES,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self._layout.fps,
            "splits": {"train": f"0:{len(records)}"},
            "data_path": _DATA,
            "video_path": _VIDEO if self._layout.sizes_px else None,
            "features": self._features,
        }
        for name, content in (("info", info), ("stats", statistics)):
            text = json.dumps(content, indent=2, allow_nan=False)
            self._new(f"meta/{name}.json").write_text(text, encoding="utf-8")

    def _new(self, name: str) -> Path:
        path = self._out / name.format(**_FIRST)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._paths.append(path)
        return path


class _Frames:
    """Frames of one session: the situation at a time, and the action in effect then. Times ascend.

    ``cameras`` by the keys of their features; ``tasks`` grows with new ones.
    """

    def __init__(self, data: SessionData, layout: _Layout, cameras: dict[str, _Video], tasks: dict[str, int]) -> None:
        self.cameras, self.tasks = cameras, tasks
        self._session, self._layout = data.session, layout
        self._situation = _Situation(data.session)
        self._steps = data.step_visits
        said = [each for each in data.utterances if each.said and each.speaker == "participant" and each.text]
        self._heard = sorted((each.end_ns, each.text) for each in said if each.end_ns is not None)

    def values(self, start_ns: int, at: int) -> dict[str, Any]:
        """Values of a frame: the situation at its time, and the action in effect at its end."""
        at_ns, end_ns = (start_ns + number * 1_000_000_000 // self._layout.fps for number in (at, at + 1))
        situation = self._situation
        situation.advance(at_ns)
        ages_s: list[float | None] = []
        for video in self.cameras.values():
            frame = video.write(at_ns)
            ages_s.append(None if frame is None else situation.age_s(frame.robot_stamp_ns, frame.stamp_ns, at_ns))
        state: list[float] = []
        for kind, names, numbers_of in _STATE.values():
            value, age_s = situation.newest(kind, at_ns, math.inf if kind is GoalChanged else MAX_AGE_S)
            numbers = () if value is None else numbers_of(value)
            state += numbers or [0.0] * len(names)
            ages_s.append(age_s if numbers else None)
        values: dict[str, Any] = {"observation.state": np.array(state, np.float32)}
        if self._layout.scan is not None:
            scan, age_s = situation.newest(LaserScan, at_ns)
            values["observation.environment_state"] = _ranges_m(scan, self._layout.scan)
            ages_s.append(age_s)
        # Title of the step, else what a participant said last, else nothing.
        said = bisect_right(self._heard, at_ns, key=lambda each: each[0])
        heard = self._heard[said - 1][1] if said else ""
        values |= {
            "observed": np.array([age_s is not None for age_s in ages_s]),
            "age_s": np.array([age_s or 0.0 for age_s in ages_s], np.float32),
            "session_s": self._session.clock.session_s(at_ns),
            "people_in_map": situation.json_of(PeopleInMap, at_ns),
            "people_in_view": situation.json_of(People, at_ns),
            "task_index": self.tasks.setdefault(
                plain_text(next((step.title for step in self._steps if step.start_ns <= at_ns < step.end_ns), heard)),
                len(self.tasks),
            ),
        }
        situation.advance(end_ns)
        command, _ = situation.newest(CommandSent, end_ns, COMMAND_HOLDS_S)
        head = situation.newest(HeadMoved, end_ns, math.inf)[0] or situation.newest(HeadState, end_ns)[0]
        angles_rad = (0.0, 0.0) if head is None else (head.pan_rad, head.tilt_rad)
        twist = Twist2D() if command is None else command.twist
        values["action"] = np.array([*astuple(twist), *angles_rad], np.float32)
        return values | {"command_source": "none" if command is None else command.source}

    def about_episode(self, start_ns: int) -> dict[str, Any]:
        clock = self._session.clock
        return key_values(self._session) | {"start_s": clock.session_s(start_ns), "start_utc": clock.utc(start_ns)}


def _features(layout: _Layout) -> dict[str, Any]:
    """Features of the dataset; the order of ``observed`` and ``age_s`` is that of the cameras, states and scan."""
    state = [f"{part}.{name}" for part, (_, names, _) in _STATE.items() for name in names]
    streams = [*(key.removeprefix("observation.") for key in layout.sizes_px), *_STATE]
    features = {key: _video_feature(size_px, layout.fps) for key, size_px in layout.sizes_px.items()}
    features["observation.state"] = _feature("float32", state)
    if (scan := layout.scan) is not None:
        streams.append("scan")
        names = [f"range_m at {angle_rad:.4f} rad" for angle_rad in _angles_rad(scan)]
        info = {"no_return_m": _no_return_m(scan), "robot_from_laser": to_jsonable(scan.robot_from_laser)}
        features["observation.environment_state"] = {**_feature("float32", names), "info": info}
    return {
        **features,
        "action": _feature("float32", [*_TWIST, *(f"head.{name}" for name in _HEAD)]),
        "observed": _feature("bool", streams),
        "age_s": _feature("float32", streams),
        "session_s": _feature("float64"),
        **{name: _feature("string") for name in ("command_source", "people_in_map", "people_in_view")},
        "timestamp": _feature("float32"),
        **{name: _feature("int64") for name in ("frame_index", "episode_index", "index", "task_index")},
    }


def _feature(dtype: str, names: Sequence[str] | None = None) -> dict[str, Any]:
    return {"dtype": dtype, "shape": [1 if names is None else len(names)], "names": names}


def _statistics(samples: _Samples) -> dict[str, Any]:
    """Statistics of each feature; of images by colour, 0 to 1, shape (3, 1, 1)."""
    found = {}
    for key, values in samples.items():
        rows = np.vstack(values).astype(np.float64)
        of_images = values[0].ndim > 1
        if of_images:
            rows /= 255.0
        numbers = {"min": rows.min(0), "max": rows.max(0), "mean": rows.mean(0), "std": rows.std(0)}
        numbers |= {f"q{100 * share:02.0f}": np.quantile(rows, share, axis=0) for share in _QUANTILES}
        shape = (3, 1, 1) if of_images else (-1,)
        found[key] = {name: value.reshape(shape).tolist() for name, value in numbers.items()} | {"count": [len(values)]}
    return found


def _angles_rad(scan: LaserScan) -> NDArray[np.float64]:
    return np.float64(scan.angle_min_rad) + scan.angle_increment_rad * np.arange(len(scan.ranges_m), dtype=np.float64)


def _no_return_m(layout: LaserScan) -> float:
    return layout.range_max_m if math.isfinite(layout.range_max_m) else 0.0


def _ranges_m(scan: LaserScan | None, layout: LaserScan) -> NDArray[np.float32]:
    """Range at the nearest beam for each of ``layout``: float32, shape (beams,). Zeros without a scan."""
    if scan is None:
        return np.zeros(len(layout.ranges_m), np.float32)
    beams = np.round((_angles_rad(layout) - scan.angle_min_rad) / (scan.angle_increment_rad or 1.0)).astype(np.int64)
    there = (beams >= 0) & (beams < len(scan.ranges_m))
    there[there] = scan.returned()[beams[there]]
    ranges = np.full(len(beams), _no_return_m(layout), np.float32)
    ranges[there] = scan.ranges_m[beams[there]]
    return ranges
