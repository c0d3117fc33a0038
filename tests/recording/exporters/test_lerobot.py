"""LeRobot datasets: readable by the rules of the format v3.0, and equal to what was recorded."""

import json
import shutil
from bisect import bisect_right
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pandas
import pyarrow
import pytest
from numpy.typing import NDArray
from pyarrow import parquet

from caris_desktop.domain.events import (
    CommandSent,
    GoalChanged,
    HeadMoved,
    Marked,
    ProtocolEnded,
    RecordingPaused,
    StepEntered,
    UtteranceChanged,
)
from caris_desktop.domain.sensing import FrameRef, HeadState, LaserScan, Odometry, PeopleInMap
from caris_desktop.recording.exporters import lerobot
from caris_desktop.recording.exporters.lerobot import write_lerobot
from caris_desktop.recording.recorder.video_writer import FASTEST, VideoFileWriter
from caris_desktop.recording.session.session_header import SessionError
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import ExportRequest, export_all
from tests.recording.told_session import TRIAL, drive, heard, said, tell
from tests.support.recorded_session import RecordedSession, make_session, number_in, picture_of, rerecorded

SECOND_NS = 1_000_000_000
DATA = "data/chunk-000/file-000.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
FRONT, REAR = "observation.images.front", "observation.images.rear"
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
# lerobot.datasets.feature_utils.DEFAULT_FEATURES
DEFAULT_FEATURES = {
    "timestamp": "float32", "frame_index": "int64", "episode_index": "int64", "index": "int64", "task_index": "int64"
}  # fmt: skip
# lerobot.datasets.lerobot_dataset.LeRobotDataset(tolerance_s=)
TOLERANCE_S = 1e-4


File = tuple[tuple[str, int], ...]


class Read:
    """A dataset as ``LeRobotDataset`` reads it: paths from the metadata, frames of a video by their time."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.info: dict[str, Any] = json.loads((root / "meta/info.json").read_text("utf-8"))
        self.stats: dict[str, Any] = json.loads((root / "meta/stats.json").read_text("utf-8"))
        self.features: dict[str, Any] = self.info["features"]
        self.video_keys = [key for key, feature in self.features.items() if feature["dtype"] == "video"]
        self.episodes: list[dict[str, Any]] = parquet.read_table(root / EPISODES).to_pylist()
        tasks = pandas.read_parquet(root / "meta/tasks.parquet")
        assert sorted(tasks["task_index"]) == list(range(len(tasks))) == list(range(self.info["total_tasks"]))
        self.tasks = {int(number): str(text) for text, number in tasks["task_index"].items()}
        # Of each session, in order.
        self.files = list(dict.fromkeys(self.file_of(episode, "data") for episode in self.episodes))
        self.table = pyarrow.concat_tables(
            [parquet.read_table(root / self.info["data_path"].format(**dict(file))) for file in self.files]
        )
        self.frames: list[dict[str, Any]] = self.table.to_pylist()
        self.videos = {(key, file): self._decoded(key, file) for key in self.video_keys for file in self.files}

    def file_of(self, episode: dict[str, Any], place: str) -> File:
        return tuple((name, episode[f"{place}/{name}"]) for name in ("chunk_index", "file_index"))

    def images(self, key: str) -> list[NDArray[np.uint8]]:
        """Images of a camera in the order of the frames."""
        return [image for file in self.files for image in self.videos[key, file][1]]

    def _decoded(self, key: str, file: File) -> tuple[NDArray[np.float64], list[NDArray[np.uint8]]]:
        path = self.info["video_path"].format(video_key=key, **dict(file))
        with av.open(str(self.root / path)) as container:
            stream = container.streams.video[0]
            assert stream.average_rate == self.info["fps"]
            frames = [(float(frame.pts * stream.time_base), frame) for frame in container.decode(stream)]
        return np.array([at_s for at_s, _ in frames]), [frame.to_ndarray(format="bgr24") for _, frame in frames]

    def image(self, key: str, row: dict[str, Any]) -> NDArray[np.uint8]:
        episode = self.episodes[row["episode_index"]]
        begin_s = episode[f"videos/{key}/from_timestamp"]
        times_s, images = self.videos[key, self.file_of(episode, f"videos/{key}")]
        nearest = int(np.argmin(np.abs(times_s - (begin_s + row["timestamp"]))))
        assert abs(times_s[nearest] - (begin_s + row["timestamp"])) < TOLERANCE_S
        return images[nearest]

    def values(self, key: str) -> NDArray[Any]:
        return np.array([row[key] for row in self.frames]).reshape(len(self.frames), -1)

    def number(self, row: dict[str, Any], key: str, name: str) -> Any:
        """Value of a named number of a feature."""
        return row[key][self.features[key]["names"].index(name)]


def checked(root: Path) -> Read:
    """The dataset, after everything that the format prescribes was found true."""
    read = Read(root)
    info, fps = read.info, read.info["fps"]
    assert info["codebase_version"] == "v3.0"
    assert type(fps) is int and fps > 0
    assert info["total_frames"] == len(read.frames) == sum(episode["length"] for episode in read.episodes)
    assert info["total_episodes"] == len(read.episodes)
    assert info["splits"] == {"train": f"0:{len(read.episodes)}"}
    assert (info["video_path"] is None) == (not read.video_keys)
    _check_features(read)
    end = 0
    for number, episode in enumerate(read.episodes):
        assert (episode["episode_index"], episode["dataset_from_index"]) == (number, end)
        begin, end = end, episode["dataset_to_index"]
        rows = read.frames[begin:end]
        assert len(rows) == episode["length"] > 0
        assert [row["index"] for row in rows] == list(range(begin, end))
        assert [row["frame_index"] for row in rows] == list(range(len(rows)))
        assert {row["episode_index"] for row in rows} == {number}
        np.testing.assert_allclose([row["timestamp"] for row in rows], np.arange(len(rows)) / fps, atol=TOLERANCE_S)
        assert set(episode["tasks"]) == {read.tasks[row["task_index"]] for row in rows}
        assert len(set(episode["tasks"])) == len(episode["tasks"])
        file = read.file_of(episode, "data")
        assert read.file_of(episode, "meta/episodes") == (("chunk_index", 0), ("file_index", 0))
        first = next(one["dataset_from_index"] for one in read.episodes if read.file_of(one, "data") == file)
        for key in read.video_keys:
            assert read.file_of(episode, f"videos/{key}") == file
            assert episode[f"videos/{key}/from_timestamp"] == pytest.approx((begin - first) / fps)
            assert episode[f"videos/{key}/to_timestamp"] == pytest.approx((end - first) / fps)
        _check_statistics(read, begin, end, {
            key: {name: episode[f"stats/{key}/{name}"] for name in ("min", "max", "mean", "std", "count", *QUANTILES)}
            for key in read.stats
        })  # fmt: skip
    assert end == len(read.frames)
    _check_statistics(read, 0, end, read.stats)
    return read


def _check_features(read: Read) -> None:
    stored = {key: feature for key, feature in read.features.items() if feature["dtype"] != "video"}
    assert {key: read.features[key]["dtype"] for key in DEFAULT_FEATURES} == DEFAULT_FEATURES
    assert read.table.column_names == list(stored)
    for key, feature in read.features.items():
        assert "/" not in key
        assert set(feature) >= {"dtype", "shape", "names"}
        if feature["dtype"] == "video":
            for file in read.files:
                times_s, images = read.videos[key, file]
                np.testing.assert_allclose(times_s, np.arange(len(images)) / read.info["fps"], atol=TOLERANCE_S)
            assert {image.shape for image in read.images(key)} == {tuple(feature["shape"])}
            assert len(read.images(key)) == len(read.frames)
            assert feature["names"] == ["height", "width", "channels"]
            continue
        (size,) = feature["shape"]
        assert feature["names"] is None or len(set(feature["names"])) == size
        one = pyarrow.type_for_alias(feature["dtype"])
        assert read.table.schema.field(key).type == (one if size == 1 else pyarrow.list_(one, size))
        assert read.table[key].null_count == 0
        if feature["dtype"].startswith("float"):
            assert np.isfinite(read.values(key)).all()


def _check_statistics(read: Read, begin: int, end: int, stats: dict[str, Any]) -> None:
    assert set(stats) == {key for key, feature in read.features.items() if feature["dtype"] != "string"}
    for key, its in stats.items():
        if key in read.video_keys:
            images = np.stack(read.images(key)[begin:end])[..., ::-1] / 255.0
            assert np.shape(its["mean"]) == np.shape(its["q50"]) == (3, 1, 1)
            # From some pixels of each image, before they were compressed.
            np.testing.assert_allclose(np.ravel(its["mean"]), images.mean((0, 1, 2)), atol=0.02)
            assert its["count"] == [end - begin]
            assert 0.0 <= np.min(its["min"]) <= np.max(its["max"]) <= 1.0
            continue
        rows = read.values(key)[begin:end].astype(np.float64)
        expected = {"min": rows.min(0), "max": rows.max(0), "mean": rows.mean(0), "std": rows.std(0)}
        expected |= {name: np.quantile(rows, share, axis=0) for name, share in QUANTILES.items()}
        for name, values in expected.items():
            np.testing.assert_allclose(its[name], values, rtol=1e-5, atol=1e-6, err_msg=f"{key} {name}")
        assert its["count"] == [end - begin]


def add_camera(made: RecordedSession, camera: str, stamps_ns: list[int]) -> None:
    """Record another camera with frames that arrived then, numbered from 0."""
    path = made.folder / f"video-{camera}.mp4"
    clock = open_session(made.folder).clock
    video = VideoFileWriter(path, width_px=192, height_px=108, encoder=FASTEST, clock=clock, on_full=lambda: False)
    for number, stamp_ns in enumerate(stamps_ns):
        video.write(
            picture_of(1, number, (192, 108)), FrameRef(stamp_ns, None, camera, "ring", 0, number + 1, 192, 108)
        )
    video.close()
    header = json.loads((made.folder / "session.json").read_text())
    entry = {"file_name": path.name, "camera": camera, "first_stamp_ns": video.first_stamp_ns}
    header["videos"].append(header["videos"][0] | entry)
    (made.folder / "session.json").write_text(json.dumps(header))


def exported(made: RecordedSession, out: Path) -> Read:
    fractions: list[float] = []
    written = write_lerobot([open_session(made.folder)], out, fractions.append)
    assert {path for path in out.rglob("*") if path.is_file()} == set(written.paths)
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    read = checked(out)
    assert (written.episodes, written.frames, written.fps) == (len(read.episodes), len(read.frames), read.info["fps"])
    return read


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> RecordedSession:
    """Front camera at 15 Hz; rear at 5 Hz with a gap from 4 to 7 s; a pause from 8 to 9 s; steps; a goal at 2.5 s."""
    made = make_session(
        tmp_path_factory.mktemp("sessions") / "one", seconds=12.0, cameras=("front",), fps=15.0, beams=24, keep=True,
        utterance_every_s=2.0, goal_every_s=2.0,
    )  # fmt: skip
    begin_ns = made.plan.started_ns
    rear_ns = [begin_ns + round((0.15 + number / 5) * SECOND_NS) for number in range(58)]
    add_camera(made, "rear", [stamp for stamp in rear_ns if not 4.0 <= (stamp - begin_ns) / 1e9 < 7.0])

    def at(seconds: float) -> int:
        return begin_ns + round(seconds * SECOND_NS)

    events = (
        HeadMoved(at(2.97), 0.5, 0.25),
        StepEntered(at(4.0), "a", "Go to the kitchen"),
        StepEntered(at(6.0), "b", "Show the sink"),
        RecordingPaused(at(8.0), paused=True),
        RecordingPaused(at(9.0), paused=False),
        ProtocolEnded(at(10.0), "b"),
    )
    values = [
        *made.values,
        *((event.stamp_ns, event) for event in events),
        *((at(0.05 + n / 5), HeadState(at(0.05 + n / 5), None, 0.1, 0.0)) for n in range(10)),
    ]
    return rerecorded(made, sorted(values, key=lambda pair: pair[0]))


@pytest.fixture(scope="module")
def read(made: RecordedSession, tmp_path_factory: pytest.TempPathFactory) -> Read:
    return exported(made, tmp_path_factory.mktemp("lerobot") / "out")


def newest(made: RecordedSession, kind: type[Any], at_ns: int) -> Any:
    """Newest value that had arrived, if not more than a second before."""
    arrived = [(arrived_ns, value) for arrived_ns, value in made.values if isinstance(value, kind)]
    index = bisect_right(arrived, at_ns, key=lambda pair: pair[0]) - 1
    return arrived[index][1] if index >= 0 and at_ns - arrived[index][0] <= SECOND_NS else None


def test_pauses_divide_the_trial_into_episodes(made: RecordedSession, read: Read) -> None:
    assert read.info["fps"] == 15
    assert [(episode["start_s"], episode["length"]) for episode in read.episodes] == [(0.0, 120), (9.0, 45)]
    told = [
        tuple(episode[name] for name in ("session", "participant", "condition", "trial")) for episode in read.episodes
    ]
    assert set(told) == {(made.folder.name, "P07", "B", "1")}
    assert read.info["robot_type"] == "temi"


def test_images_are_the_newest_of_each_camera_and_gaps_are_told(made: RecordedSession, read: Read) -> None:
    session = open_session(made.folder)
    begin_ns = made.plan.started_ns
    stamps_ns = {FRONT: made.plan.frame_stamps_ns("front").tolist()}
    rear_ns = [begin_ns + round((0.15 + number / 5) * SECOND_NS) for number in range(58)]
    stamps_ns[REAR] = [stamp for stamp in rear_ns if not 4.0 <= (stamp - begin_ns) / 1e9 < 7.0]
    absent = []
    for row in read.frames:
        at_ns = session.started_ns + round(row["session_s"] * SECOND_NS)
        for key, stamps in stamps_ns.items():
            number = bisect_right(stamps, at_ns) - 1
            there = number >= 0 and at_ns - stamps[number] <= SECOND_NS
            name = key.removeprefix("observation.")
            assert read.number(row, "observed", name) is there
            image = read.image(key, row)
            if there:
                assert number_in(image) == number
                delay_s = made.plan.network_delay_ms / 1e3 if key == FRONT else 0.0
                age_s = (at_ns - stamps[number]) / 1e9 + delay_s
                assert read.number(row, "age_s", name) == pytest.approx(age_s, abs=0.004)
            else:
                assert image.mean() < 2
                absent.append((key, round(row["session_s"], 2)))
    assert [at_s for key, at_s in absent if key == FRONT and at_s > 1] == []
    gap_s = [at_s for key, at_s in absent if key == REAR and at_s > 1]
    assert 4.8 < gap_s[0] < 5.1
    assert 6.9 < gap_s[-1] < 7.2


def test_states_are_what_was_known_and_actions_what_was_sent(made: RecordedSession, read: Read) -> None:
    session = open_session(made.folder)
    step_ns = SECOND_NS // read.info["fps"]
    for row in read.frames:
        at_ns = session.started_ns + round(row["session_s"] * SECOND_NS)
        odometry: Odometry | None = newest(made, Odometry, at_ns)
        assert read.number(row, "observed", "odometry") is (odometry is not None)
        pose = (0.0, 0.0, 0.0) if odometry is None else (
            odometry.pose_in_odom.x_m, odometry.pose_in_odom.y_m, odometry.pose_in_odom.heading_rad
        )  # fmt: skip
        assert row["observation.state"][:3] == pytest.approx(pose)
        head: HeadState | None = newest(made, HeadState, at_ns)
        assert read.number(row, "observed", "head") is (head is not None)
        scan: LaserScan | None = newest(made, LaserScan, at_ns)
        assert read.number(row, "observed", "scan") is (scan is not None)
        if scan is not None:
            ranges = np.where(np.isfinite(scan.ranges_m), scan.ranges_m, scan.range_max_m)
            np.testing.assert_allclose(row["observation.environment_state"], ranges, atol=1e-3)
        sent: CommandSent | None = newest(made, CommandSent, at_ns + step_ns)
        assert sent is not None or row["command_source"] == "none"
        if sent is not None:
            assert row["action"][:3] == pytest.approx([sent.twist.forward_mps, 0.0, sent.twist.turn_radps])
            assert row["command_source"] == "keyboard"
        turned = row["session_s"] + 1 / read.info["fps"] >= 2.97
        angles = (0.5, 0.25) if turned else (0.1 if newest(made, HeadState, at_ns + step_ns) else 0.0, 0.0)
        assert row["action"][3:] == pytest.approx(angles)
        people = json.loads(row["people_in_map"])
        assert bool(people) is (newest(made, PeopleInMap, at_ns) is not None)
        assert all(len(entry["people"]) == made.plan.people for entry in people)
    features = read.features
    assert features["action"]["names"] == ["forward_mps", "left_mps", "turn_radps", "head.pan_rad", "head.tilt_rad"]
    assert features["observation.environment_state"]["info"]["no_return_m"] == 20.0


def test_goals_are_observed_until_they_end(made: RecordedSession, read: Read) -> None:
    goals = [value for _, value in made.values if isinstance(value, GoalChanged)]
    session = open_session(made.folder)
    for row in read.frames:
        at_ns = session.started_ns + round(row["session_s"] * SECOND_NS)
        known = [goal for goal in goals if goal.stamp_ns <= at_ns]
        active = bool(known) and known[-1].state in ("requested", "active")
        assert read.number(row, "observed", "goal") is active
        assert read.number(row, "observation.state", "goal.x_m") == pytest.approx(14.75 if active else 0.0)
    assert len({read.number(row, "observed", "goal") for row in read.frames}) == 2


def test_tasks_are_steps_and_else_what_was_heard(made: RecordedSession, read: Read) -> None:
    heard = [
        (value.stamp_ns, value.text)
        for _, value in made.values
        if isinstance(value, UtteranceChanged) and value.speaker == "participant" and value.state == "finished"
    ]
    for row in read.frames:
        at_s = row["session_s"]
        at_ns = made.plan.started_ns + round(at_s * SECOND_NS)
        step = "Go to the kitchen" if at_s < 6.0 else "Show the sink"
        said = [text for stamp_ns, text in heard if stamp_ns <= at_ns]
        expected = step if 4.0 <= at_s < 10.0 else (said or [""])[-1]
        assert read.tasks[row["task_index"]] == expected
    assert len(read.tasks) > 3


def test_marked_episodes_come_instead_of_the_trial(made: RecordedSession, tmp_path: Path) -> None:
    begin_ns = made.plan.started_ns
    spans_s = {"Episode 1": (-1.0, 2.0), "laughs": (2.2, 2.4), "episode: sink": (1.0, 3.0), "EPISODE": (7.0, 20.0)}
    marks = [
        Marked(begin_ns, label, "mark", label, begin_ns + round(1e9 * start), begin_ns + round(1e9 * end))
        for label, (start, end) in spans_s.items()
    ]
    marked = make_session(tmp_path / "s", replace(made.plan, cameras=()), keep=True)
    pauses = [pair for pair in made.values if isinstance(pair[1], RecordingPaused)]
    values = sorted([*marked.values, *pauses, *((mark.stamp_ns, mark) for mark in marks)], key=lambda pair: pair[0])
    read = exported(rerecorded(marked, values), tmp_path / "out")
    assert [(episode["start_s"], episode["length"]) for episode in read.episodes] == [
        (0.0, 20), (2.0, 10), (7.0, 10), (9.0, 30),
    ]  # fmt: skip


def test_sessions_without_cameras_and_odometry_have_ten_frames_a_second(tmp_path: Path) -> None:
    made = make_session(tmp_path / "s", seconds=3.0, cameras=(), odometry_hz=0.0, scans_hz=0.0, people=0)
    read = exported(made, tmp_path / "out")
    assert (read.info["fps"], len(read.frames), read.video_keys) == (10, 30, [])
    assert "observation.environment_state" not in read.features
    assert not read.values("observed").any()
    assert not read.values("observation.state").any()
    assert not read.values("action").any()


@pytest.mark.parametrize("step_ns", [0, -100_000_000, SECOND_NS])
def test_a_dataset_is_bounded_whatever_the_times_of_the_frames(tmp_path: Path, step_ns: int) -> None:
    """Stamps of a robot may be the same for all frames, in whole seconds, or step back."""
    made = make_session(tmp_path / "session", seconds=2.0, cameras=("front",), fps=10.0, people=0)
    index = made.folder / "video-front.frames.csv"
    head, *rows = index.read_text().splitlines()
    begin_ns = made.plan.started_ns + SECOND_NS
    cells = [row.split(",") for row in rows]
    for number, row in enumerate(cells):
        row[2] = str(begin_ns + number // 4 * step_ns)
    index.write_text("\n".join([head, *map(",".join, cells), ""]))
    dataset = write_lerobot([open_session(made.folder)], tmp_path / "out", lambda _share: None)
    assert dataset.fps == (1 if step_ns > 0 else lerobot.FPS_WITHOUT_CAMERA)


def test_scans_with_other_beams_are_given_in_those_of_the_first(tmp_path: Path) -> None:
    made = make_session(tmp_path / "s", seconds=2.0, cameras=(), beams=36, keep=True)

    def changed(value: Any) -> Any:
        """After one second, half of the beams, from 10 degrees on."""
        if not isinstance(value, LaserScan) or value.stamp_ns < made.plan.started_ns + SECOND_NS:
            return value
        ranges = np.arange(1, 19, dtype=np.float32)
        step_rad = value.angle_increment_rad
        return replace(
            value, ranges_m=ranges, angle_min_rad=value.angle_min_rad + step_rad, angle_increment_rad=2 * step_rad
        )

    read = exported(rerecorded(made, [(at, changed(value)) for at, value in made.values]), tmp_path / "out")
    assert read.features["observation.environment_state"]["shape"] == [36]
    ranges = read.frames[-1]["observation.environment_state"]
    assert [ranges[index] for index in (1, 3, 35)] == [1.0, 2.0, 18.0]


def test_large_images_are_reduced_and_cameras_without_video_left_out(tmp_path: Path) -> None:
    made = make_session(tmp_path / "s", seconds=1.0, cameras=("front", "rear"), size_px=(1280, 722), audio=())
    (made.folder / "video-rear.mp4").unlink()
    read = exported(made, tmp_path / "out")
    assert {key: read.features[key]["shape"] for key in read.video_keys} == {FRONT: [360, 640, 3]}


def test_sessions_shorter_than_a_frame_have_no_dataset(tmp_path: Path) -> None:
    made = make_session(tmp_path / "s", seconds=0.05, cameras=(), audio=())
    assert write_lerobot([open_session(made.folder)], tmp_path / "out", lambda _: None).paths == ()
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> list[RecordedSession]:
    """A session with a front camera and 24 beams, one with a front and a rear camera of other sizes and rates and 36
    beams, and one without cameras and scans.
    """
    sessions = tmp_path_factory.mktemp("study") / "sessions"
    audio: Any = {"audio": (), "keep": True}
    return [
        make_session(sessions / "a", seconds=3.0, cameras=("front",), fps=5.0, beams=24, **audio),
        make_session(
            sessions / "b", seconds=2.0, cameras=("front", "rear"), fps=10.0, beams=36, size_px=(320, 180), **audio
        ),
        make_session(sessions / "c", seconds=2.0, cameras=(), scans_hz=0.0, **audio),
    ]


def test_the_sessions_of_a_study_are_one_dataset(study: list[RecordedSession], tmp_path: Path) -> None:
    fractions: list[float] = []
    sessions = [open_session(made.folder) for made in study]
    written = write_lerobot(sessions, tmp_path / "out", fractions.append)
    assert {path for path in (tmp_path / "out").rglob("*") if path.is_file()} == set(written.paths)
    assert fractions == sorted(fractions)
    read = checked(tmp_path / "out")
    assert [(one["session"], one["length"]) for one in read.episodes] == [("a", 30), ("b", 20), ("c", 20)]
    assert (read.info["fps"], written.episodes, written.frames) == (10, 3, 70)
    assert [dict(file)["file_index"] for file in read.files] == [0, 1, 2]
    # Cameras, sizes and beams are those of the first session that has them.
    front = [2 * (study[0].plan.size_px[1] // 2), 2 * (study[0].plan.size_px[0] // 2), 3]
    assert {key: read.features[key]["shape"] for key in read.video_keys} == {FRONT: front, REAR: [180, 320, 3]}
    assert read.features["observation.environment_state"]["shape"] == [24]
    for key, there in ((FRONT, {"a", "b"}), (REAR, {"b"})):
        name = key.removeprefix("observation.")
        observed = {
            read.episodes[row["episode_index"]]["session"] for row in read.frames if read.number(row, "observed", name)
        }
        assert observed == there
    last = read.frames[-1]
    assert not read.number(last, "observed", "scan")
    assert read.image(REAR, last).mean() < 2
    for made, session in zip(study[:2], sessions, strict=False):
        rows = [row for row in read.frames if read.episodes[row["episode_index"]]["session"] == made.folder.name]
        for row in rows:
            at_ns = session.started_ns + round(row["session_s"] * SECOND_NS)
            odometry = newest(made, Odometry, at_ns)
            if odometry is not None:
                assert row["observation.state"][0] == pytest.approx(odometry.pose_in_odom.x_m)


@pytest.mark.logs(r"session_export: ")
def test_a_session_that_fails_leaves_nothing_in_the_dataset(
    study: list[RecordedSession], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sessions = [open_session(made.folder) for made in study]
    fractions, warnings = list[float](), list[str]()

    def failing(self: Any, start_ns: int, at: int) -> dict[str, Any]:
        if self._session.folder.name == "a" and at == 7:
            raise SessionError("it ends here")
        return original(self, start_ns, at)

    original = lerobot._Frames.values
    monkeypatch.setattr(lerobot._Frames, "values", failing)
    written = write_lerobot(sessions, tmp_path / "out", fractions.append, warnings.append)
    assert warnings == ["a is left out: it ends here"]
    assert {path for path in (tmp_path / "out").rglob("*") if path.is_file()} == set(written.paths)
    read = checked(tmp_path / "out")
    assert [one["session"] for one in read.episodes] == ["b", "c"]


def test_the_command_writes_one_dataset_and_the_dialogue_of_all(tmp_path: Path) -> None:
    folders = [
        tell(
            tmp_path / "sessions" / name,
            [*heard(1, 0.2, 0.6, "Hello."), *said(1, 0.8, 1.0, 1.5, "Good day."), *drive(0.5, 1.5, 0.3)],
            lasts_s=2.0,
            trial={**TRIAL, "participant": name},
            later_s=later_s,
        )
        for name, later_s in (("P1", 0.0), ("P2", 60.0))
    ]
    folders.append(shutil.copytree(folders[0], tmp_path / "sessions" / "P1 again"))
    finished = export_all(ExportRequest(tuple(folders), ("lerobot",), tmp_path / "out"))
    assert finished.problems == ()
    assert any("P1 again is a copy of P1" in sentence for sentence in finished.notices)
    (out,) = finished.written
    read = checked(out / "dataset")
    assert [one["participant"] for one in read.episodes] == ["P1", "P2"]
    assert set(read.tasks.values()) == {"", "Hello."}
    lines = [json.loads(line) for line in (out / "dialogue" / "turns.jsonl").read_text("utf-8").splitlines()]
    assert [(line["participant"], line["action"]["text"]) for line in lines] == [
        ("P1", "Good day."),
        ("P2", "Good day."),
    ]
    assert "(2 turns)" in (out / "README.md").read_text("utf-8")
