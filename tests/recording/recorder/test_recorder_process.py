"""Recorder in a separate process, fed over its pipe; the files are checked."""

import csv
import itertools
import json
import os
import random
import signal
import subprocess
import sys
import time
import wave
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import av
import cv2
import jsonschema
import numpy as np
import pytest
from mcap.reader import make_reader

from caris_desktop.domain import clock, streams
from caris_desktop.domain.events import (
    ChatMessage,
    Gap,
    LlmExchange,
    Marked,
    PersonAppeared,
    PhotoTaken,
    Problem,
    SessionEnded,
    SessionStarted,
    UtteranceChanged,
)
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import AudioChunk, OccupancyGrid, People, PersonBox
from caris_desktop.live.frame_ring import SLOT_COUNT, FrameRing
from caris_desktop.recording.recorder.disk_watch import DiskLimits
from caris_desktop.recording.recorder.recorder_messages import (
    RecorderReport,
    SetRecordingPermissions,
    StopRecording,
    TakePhoto,
)
from caris_desktop.recording.session.session_reader import open_session
from tests.recording import driving
from tests.recording.driving import RecorderUnderTest, command, feed_frames, mark, picture, pose, scan, start
from tests.support.polling import wait_for

REPOSITORY = Path(__file__).parents[3]


@pytest.fixture
def ring() -> Iterator[FrameRing]:
    ring = FrameRing.create(640 * 480 * 3)
    yield ring
    ring.close()


def mcap_messages(folder: Path) -> list[tuple[str, int, dict[str, Any]]]:
    """Topic, publish time and content of every message, read by the ``mcap`` package; each validated by its schema."""
    found = []
    with (folder / "events.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            assert schema.encoding == "jsonschema"
            data = json.loads(message.data)
            jsonschema.validate(data, json.loads(schema.data))
            found.append((channel.topic, message.publish_time, data))
    return found


def mcap_counts(folder: Path) -> Counter[str]:
    """Number of messages of each topic, read sequentially by the ``mcap`` package."""
    counts: Counter[str] = Counter()
    with (folder / "events.mcap").open("rb") as file:
        for _, channel, _ in make_reader(file).iter_messages(log_time_order=False):
            counts[channel.topic] += 1
    return counts


def video_times_s(path: Path) -> tuple[list[float], list[float]]:
    """Times of all decodable frames, and of the key frames."""
    times, keys = [], []
    with av.open(str(path)) as container:
        try:
            for frame in container.decode(video=0):
                times.append(float(frame.pts * frame.time_base))
                if frame.key_frame:
                    keys.append(times[-1])
        except av.error.InvalidDataError:
            pass
    return times, keys


def exchange() -> LlmExchange:
    now_ns = clock.now_ns()
    return LlmExchange(
        stamp_ns=now_ns,
        exchange_id="x1",
        provider="embedded",
        model="smollm2",
        messages=(ChatMessage("system", "Be brief."), ChatMessage("user", "What is this?")),
        answer="A robot arm.",
        outcome="answered",
        asked_ns=now_ns - 500_000_000,
        first_token_ns=now_ns - 300_000_000,
        parameters={"temperature": 0.4},
    )


def test_a_session_is_a_folder_that_ordinary_programs_can_read(tmp_path: Path, ring: FrameRing) -> None:
    side = FrameRing.create(320 * 240 * 3)
    recorder = RecorderUnderTest(ring, side)
    folder = tmp_path / "2026-11-21_10-14-02_P07"
    begin = start(folder)
    recorder.send(begin)
    assert recorder.wait_for(RecorderReport).state == "recording"
    side_ref = side.write(picture(1, width_px=320, height_px=240), stamp_ns=1, robot_stamp_ns=None, camera="../side")
    recorder.send(side_ref)
    refs = feed_frames(recorder, ring, 30, period_s=1 / 15)
    scans = [scan() for _ in range(5)]
    recorder.send(*scans, pose(1.5), command(1), command(2), command(3, 0.0), mark("now"))
    utterance = UtteranceChanged(clock.now_ns(), "u1", "robot", "Hello!", "phrase", "started", "espeak")
    recorder.send(utterance, exchange(), PersonAppeared(clock.now_ns(), "p-1", 4))
    recorder.send(People(clock.now_ns(), "front", 3, 640, 480, (PersonBox(4, "p-1", 1, 2, 3, 4, 0.9),), 12.0))
    recorder.send(TakePhoto(refs[-1], tmp_path / "elsewhere.png"))
    photo = recorder.wait_for(PhotoTaken)
    report = recorder.stop_session()
    recorder.close()
    side.close()

    messages = mcap_messages(folder)
    by_topic: dict[str, list[tuple[int, dict[str, Any]]]] = {}
    for topic, publish_time, data in messages:
        by_topic.setdefault(topic, []).append((publish_time, data))
    assert len(by_topic["/scan"]) == 5
    publish_time, data = by_topic["/scan"][0]
    assert publish_time == begin.header.clock.utc_ns_at(scans[0].stamp_ns)
    assert data["stamp_ns"] == scans[0].stamp_ns
    assert data["ranges"][0] == 1e39, "nothing returned"
    assert data["ranges"][1] == pytest.approx(float(scans[0].ranges_m[1]))
    assert [data["sequence"] for _, data in by_topic["/event/command_sent"]] == [1, 2, 3]
    assert by_topic["/event/utterance_changed"][0][1]["text"] == "Hello!"
    assert by_topic["/event/llm_exchange"][0][1]["messages"][1]["content"] == "What is this?"
    assert by_topic["/people"][0][1]["boxes"][0]["person_id"] == "p-1"
    assert by_topic["/event/session_ended"][0][1]["reason"] == "wizard"
    assert "/event/gap" not in by_topic

    times_s, keys_s = video_times_s(folder / "video-front.mp4")
    assert times_s == pytest.approx([(ref.stamp_ns - refs[0].stamp_ns) / 1e9 for ref in refs], abs=0.001)
    assert max(b - a for a, b in itertools.pairwise(keys_s)) <= 0.5
    assert len(by_topic["/frame"]) == 31
    assert video_times_s(folder / "video-side.mp4") == ([0.0], [0.0])

    kept = cv2.imread(str(folder / photo.file_name))
    assert kept is not None
    assert np.array_equal(kept, picture(29))
    assert photo.frame_sequence == refs[-1].sequence

    movement = (folder / "movement.txt").read_text().splitlines()
    assert [line.split()[2:4] for line in movement if " command " in line] == [
        ["command", "0.300"],
        ["command", "0.000"],
    ]
    assert "robot: Hello!" in (folder / "speech.txt").read_text()
    assert json.loads((folder / "llm" / "0001.json").read_text())["answer"] == "A robot arm."
    people = json.loads((folder / "people.json").read_text())["people"]
    assert [(person["person_id"], person["tracks"]) for person in people] == [("p-1", [4])]

    head = json.loads((folder / "session.json").read_text())
    assert (head["reason"], head["trial"]["participant"]) == ("wizard", "P07")
    assert {file["name"] for file in head["files"]} == {
        path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()
    } - {"session.json", "manifest-sha256.txt"}
    assert report.folder == folder
    assert report.written_bytes > 10_000
    assert not report.dropped
    assert recorder.wait_for(SessionStarted).folder == folder.name

    session = open_session(folder)
    assert session.closed_properly
    assert [value.sequence for _, value in session.values("event/command_sent")] == [1, 2, 3]
    replayed = next(value for _, value in session.values("scan"))
    assert np.array_equal(replayed.ranges_m, scans[0].ranges_m)


@dataclass(frozen=True, slots=True)
class GazeMeasured:
    """Type of values unknown to the program."""

    stamp_ns: int
    angle_rad: float


def body_that_knows_gaze(connection: Connection, ring_names: tuple[str, ...], limits: DiskLimits) -> None:
    spec = streams.StreamSpec("gaze", GazeMeasured, streams.Delivery.LATEST, 0.1)
    streams.BY_TYPE[GazeMeasured] = spec
    streams.BY_NAME[spec.name] = spec
    driving.body(connection, ring_names, limits)


def test_a_stream_that_is_added_to_the_table_is_recorded_and_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = RecorderUnderTest(target=body_that_knows_gaze)
    recorder.send(start(tmp_path / "s"), *(GazeMeasured(clock.now_ns(), 0.1 * n) for n in range(10)))
    recorder.stop_session()
    recorder.close()

    gaze = [data for topic, _, data in mcap_messages(tmp_path / "s") if topic == "/gaze"]
    assert [data["angle_rad"] for data in gaze] == pytest.approx([0.1 * n for n in range(10)])
    monkeypatch.setitem(streams.BY_NAME, "gaze", streams.StreamSpec("gaze", GazeMeasured, streams.Delivery.LATEST, 0.1))
    read = [value for _, value in open_session(tmp_path / "s").values("gaze")]
    assert isinstance(read[3], GazeMeasured)
    assert read[3].angle_rad == pytest.approx(0.3)


def test_unrecordable_values_are_counted_and_written_down(tmp_path: Path, ring: FrameRing) -> None:
    refs = [
        ring.write(picture(number), stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera="front")
        for number in range(SLOT_COUNT + 6)
    ]
    recorder = RecorderUnderTest(ring)
    recorder.send(start(tmp_path / "s"), *refs, GazeMeasured(1, 2.0))
    recorder.send(Gap(clock.now_ns(), "scan", 3, "the recorder could not keep up"))
    assert recorder.wait_for(Gap, stream="frame").count == 6
    assert recorder.wait_for(Gap, stream="GazeMeasured").count == 1
    assert recorder.stop_session().dropped == {"frame": 6, "GazeMeasured": 1, "scan": 3}
    recorder.close()
    gaps = [data for topic, _, data in mcap_messages(tmp_path / "s") if topic == "/event/gap"]
    assert {(gap["stream"], gap["count"]) for gap in gaps} == {
        ("frame", 6),
        ("GazeMeasured", 1),
        ("scan", 3),
    }
    # A machine too slow for one encoder continues with another, in another file.
    assert sum(len(video_times_s(path)[0]) for path in (tmp_path / "s").glob("video-front*.mp4")) == SLOT_COUNT


def test_forbidden_streams_are_not_recorded(tmp_path: Path, ring: FrameRing) -> None:
    recorder = RecorderUnderTest(ring)
    recorder.send(start(tmp_path / "s", video=False, photos=False))
    ref = ring.write(picture(1), stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera="front")
    recorder.send(ref, TakePhoto(ref, tmp_path / "elsewhere.png"))
    assert "does not permit" in recorder.wait_for(Problem).meaning
    recorder.send(SetRecordingPermissions(video=True, photos=True))
    feed_frames(recorder, ring, 3, period_s=0.0)
    recorder.send(SetRecordingPermissions(video=False, photos=True))
    feed_frames(recorder, ring, 3, period_s=0.0)
    recorder.stop_session()
    recorder.close()
    assert [path.name for path in (tmp_path / "s").rglob("*.mp4")] == ["video-front.mp4"]
    assert len(video_times_s(tmp_path / "s" / "video-front.mp4")[0]) == 3
    assert not list((tmp_path / "s").rglob("*.png"))


def test_without_a_session_a_photo_goes_to_the_given_folder(tmp_path: Path, ring: FrameRing) -> None:
    recorder = RecorderUnderTest(ring)
    ref = ring.write(picture(1), stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera="front")
    target = tmp_path / "study" / "photos" / "2026-11-22_10-14-02.png"
    recorder.send(TakePhoto(ref, target), TakePhoto(ref, target))
    first = recorder.wait_for(PhotoTaken, file_name="photos/2026-11-22_10-14-02.png")
    assert (first.camera, first.frame_sequence) == ("front", ref.sequence)
    recorder.wait_for(PhotoTaken, file_name="photos/2026-11-22_10-14-02-2.png")
    (tmp_path / "file").write_text("not a folder")
    recorder.send(TakePhoto(ref, tmp_path / "file" / "a.png"))
    assert "cannot be written" in recorder.wait_for(Problem, what="The photo could not be saved.").meaning
    recorder.close()
    image_bgr = cv2.imread(str(target))
    assert image_bgr is not None
    assert np.array_equal(image_bgr, picture(1))
    assert sorted(path.name for path in target.parent.iterdir()) == [
        "2026-11-22_10-14-02-2.png", "2026-11-22_10-14-02.png",
    ]  # fmt: skip


def test_one_process_serves_sessions_one_after_the_other(tmp_path: Path) -> None:
    recorder = RecorderUnderTest()
    recorder.send(mark("before any session"), start(tmp_path / "a"), mark("in a"), start(tmp_path / "b"), mark("in b"))
    recorder.wait_for(SessionEnded, folder="a")
    recorder.send(StopRecording())
    recorder.wait_for(SessionEnded, folder="b")
    recorder.send(start(tmp_path / "a"))
    failed = recorder.wait_for(RecorderReport, state="failed")
    assert "already contains files" in failed.detail
    (tmp_path / "file").write_text("not a folder")
    recorder.send(start(tmp_path / "file" / "c"))
    problem = recorder.wait_for(Problem, what=f"{tmp_path / 'file' / 'c'} cannot be written to: Not a directory.")
    assert "Nothing is being recorded" in problem.meaning
    recorder.close()
    for name in ("a", "b"):
        labels = [data["label"] for topic, _, data in mcap_messages(tmp_path / name) if topic == "/event/marked"]
        assert labels == [f"in {name}"]


def test_maps_are_retained_once_per_second_and_the_newest_is_never_lost(tmp_path: Path) -> None:
    recorder = RecorderUnderTest()
    recorder.send(start(tmp_path / "s"))
    recorder.wait_for(RecorderReport)
    for number in range(20):
        cells = np.full((20, 30), number, dtype=np.int8)
        recorder.send(OccupancyGrid(clock.now_ns(), None, 0.05, Pose2D(0, 0, 0), cells))
    recorder.stop_session()
    recorder.close()
    maps = [value for _, value in open_session(tmp_path / "s").values("map")]
    assert len(maps) <= 3
    assert maps[0].cells.shape == (20, 30)
    assert maps[-1].cells[0, 0] == 19


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.long("2", "3")
def test_kill_of_the_recorder_costs_at_most_the_last_moment(tmp_path: Path, ring: FrameRing, seed: int) -> None:
    recorder = RecorderUnderTest(ring)
    recorder.send(start(tmp_path / "s"))
    recorder.wait_for(RecorderReport)
    kill_after_s = random.Random(seed).uniform(1.0, 2.5)  # noqa: S311 - a test, not cryptography
    begun_s, number, first_frame_ns, frame_ns, sent_ns = time.monotonic(), 0, 0, 0, 0
    first_ns = clock.now_ns()
    while time.monotonic() - begun_s < kill_after_s:
        sent_ns = clock.now_ns()
        recorder.send(Marked(sent_ns, str(number)), scan())
        recorder.send(AudioChunk(sent_ns, "microphone", 16_000, np.ones((256, 1), np.int16)))
        if number % 4 == 0:
            frame_ns = clock.now_ns()
            first_frame_ns = first_frame_ns or frame_ns
            ref = ring.write(picture(number), stamp_ns=frame_ns, robot_stamp_ns=None, camera="front")
            recorder.send(ref)
        number += 1
        time.sleep(0.016)
    assert recorder.process.pid is not None
    os.kill(recorder.process.pid, signal.SIGKILL)
    recorder.process.join()

    # Before any repair.
    assert json.loads((tmp_path / "s" / "session.json").read_text())["ended_ns"] is None
    times_s, _ = video_times_s(tmp_path / "s" / "video-front.mp4")
    with (tmp_path / "s" / "video-front.frames.csv").open(newline="") as file:
        shown_s = [float(row["video_s"]) for row in csv.DictReader(file)]
    assert shown_s[: len(times_s)] == pytest.approx(times_s, abs=1e-4)
    assert 0 <= len(shown_s) - len(times_s) <= 15
    with wave.open(str(tmp_path / "s" / "audio-microphone.wav")) as sound:
        assert (sent_ns - first_ns) / 1e9 - sound.getnframes() / 16_000 < 1.0

    session = open_session(tmp_path / "s")
    assert not session.closed_properly
    marks = [value for _, value in session.values("event/marked")]
    assert [value.label for value in marks] == [str(index) for index in range(len(marks))]
    assert sent_ns - marks[-1].stamp_ns < 1e9
    assert sent_ns - session.ended_ns < 1e9
    assert (frame_ns - first_frame_ns) / 1e9 - times_s[-1] < 2.0


def test_a_terminated_recorder_closes_the_session(tmp_path: Path) -> None:
    recorder = RecorderUnderTest()
    recorder.send(start(tmp_path / "s"), mark("kept"))
    recorder.wait_for(RecorderReport)
    recorder.process.terminate()
    assert recorder.wait_for(SessionEnded).reason == "console_closed"
    recorder.close()
    assert open_session(tmp_path / "s").closed_properly


def test_kill_of_the_console_closes_the_session_properly(tmp_path: Path) -> None:
    console = subprocess.Popen(
        [sys.executable, "-m", "tests.support.run_module", "tests.recording.console_to_kill", str(tmp_path / "s")],
        stdout=subprocess.PIPE,
        text=True,
        cwd=REPOSITORY,
    )
    assert console.stdout is not None
    assert console.stdout.readline() == "recording\n"
    last = int(console.stdout.readline())
    console.kill()
    console.wait()
    console.stdout.close()

    def closed() -> bool:
        return bool(json.loads((tmp_path / "s" / "session.json").read_text())["reason"])

    wait_for(closed, "the recorder closes the session", timeout_s=20)
    session = open_session(tmp_path / "s")
    assert (session.closed_properly, session.reason) == (True, "console_closed")
    labels = [int(value.label) for _, value in session.values("event/marked")]
    assert labels == list(range(len(labels)))
    assert labels[-1] >= last
    assert len(video_times_s(tmp_path / "s" / "video-front.mp4")[0]) >= 5


def in_own_mounts(script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run ``script`` in a separate mount namespace; skips if that is not permitted."""
    command_line = ["unshare", "--mount", "--propagation", "private", "sh", "-ec", script, "sh", *arguments]
    try:
        probe = subprocess.run([*command_line[:5], "-c", "mount -t tmpfs none /mnt"], capture_output=True, check=False)
    except FileNotFoundError:
        pytest.skip("needs unshare (util-linux) to make a small disk")
    if probe.returncode:
        pytest.skip("needs the right to mount a small disk of its own (root)")
    return subprocess.run(command_line, capture_output=True, text=True, check=False, timeout=90, cwd=REPOSITORY)


def fill_disk(tmp_path: Path, how: str) -> tuple[dict[str, Any], Path]:
    """Messages of the recorder while a disk of 12 MiB filled up, and a copy of the session."""
    disk, kept = tmp_path / "disk", tmp_path / "kept"
    disk.mkdir()
    result = in_own_mounts(
        'mount -t tmpfs -o size=12m none "$1"; "$3" -m tests.support.run_module tests.recording.fill_disk "$1/s" "$4"; '
        'cp -r "$1/s" "$2"',
        str(disk),
        str(kept),
        sys.executable,
        how,
    )
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout), kept


@pytest.mark.long
def test_a_disk_that_fills_up_ends_the_video_first_and_then_the_session(tmp_path: Path) -> None:
    said, kept = fill_disk(tmp_path, "slowly")
    # On a busy machine a problem about the video rate is reported too.
    told = [problem for problem in said["problems"] if problem.startswith("The disk")]
    assert told[0].startswith("The disk is filling up")
    assert told[1].startswith("The disk is nearly full")
    assert told[2].startswith("The disk is full: from now on, only events")
    assert told[3:] == ["The disk is full."]
    head = check_session_of_full_disk(said, kept)
    # The video had space for its index and is an ordinary mp4.
    assert len(video_times_s(kept / "video-front.mp4")[0]) == head["videos"][0]["frames"] > 0


def test_a_disk_that_is_suddenly_full_keeps_what_was_recorded(tmp_path: Path) -> None:
    said, kept = fill_disk(tmp_path, "suddenly")
    assert said["problems"][-1] == "The disk is full."
    head = check_session_of_full_disk(said, kept)
    # For the last half second the recorder could not report whether it was written.
    assert len(video_times_s(kept / "video-front.mp4")[0]) >= head["videos"][0]["frames"] > 0


def check_session_of_full_disk(said: dict[str, Any], kept: Path) -> dict[str, Any]:
    assert (said["state"], said["reason"]) == ("failed", "disk_full")
    head: dict[str, Any] = json.loads((kept / "session.json").read_text())
    assert head["reason"] == "disk_full"
    messages = mcap_messages(kept)
    labels = [int(data["label"].split()[0]) for topic, _, data in messages if topic == "/event/marked"]
    assert labels == list(range(len(labels)))
    assert len(labels) > 10
    assert messages[-1][0] == "/event/session_ended"
    return head


def test_read_only_disk_is_reported_and_the_recorder_lives_on(tmp_path: Path) -> None:
    disk, good = tmp_path / "disk", tmp_path / "good"
    disk.mkdir()
    result = in_own_mounts(
        'mount -t tmpfs -o ro none "$1"; "$3" -m tests.support.run_module tests.recording.read_only_disk "$1/s" "$2"',
        str(disk),
        str(good),
        sys.executable,
    )
    assert result.returncode == 0, result.stderr
    said = json.loads(result.stdout)
    assert said["problem"].endswith("cannot be written to: Read-only file system.")
    assert open_session(good).closed_properly
