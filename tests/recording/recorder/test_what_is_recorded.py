"""Pauses, sound, arrival times, and start and end of a session, with one recorder process."""

import csv
import json
import pickle
import shutil
import subprocess
import time
import wave
from collections.abc import Iterator
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from caris_desktop.domain import clock, streams
from caris_desktop.domain.events import Gap, Problem, RecordingPaused, SessionEnded, UtteranceChanged
from caris_desktop.domain.sensing import AudioChunk, BatteryState, StatusShown
from caris_desktop.domain.translation import tr
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.recording.recorder.disk_watch import DiskLimits
from caris_desktop.recording.recorder.recorder_messages import (
    ARRIVED,
    PauseRecording,
    RecorderReport,
    SetRecordingPermissions,
    StartRecording,
    StopRecording,
    TakePhoto,
)
from caris_desktop.recording.session.folder_lock import is_held
from caris_desktop.recording.session.loss_messages import read_reason
from caris_desktop.recording.session.manifest import verify_manifest
from caris_desktop.recording.session.session_data import spoken
from caris_desktop.recording.session.session_reader import open_session
from tests.recording import driving
from tests.recording.driving import RecorderUnderTest, command, feed_frames, header, mark, picture, pose, scan, start
from tests.recording.recorder.test_recorder_process import video_times_s
from tests.support.polling import wait_for

RATE_HZ = 16_000


@dataclass(frozen=True, slots=True)
class QuestionAsked:
    """Event type of another package and a later version."""

    stamp_ns: int
    question: str
    answers: tuple[str, ...]


def body_that_knows_questions(connection: Connection, ring_names: tuple[str, ...], limits: DiskLimits) -> None:
    declare_questions()
    driving.body(connection, ring_names, limits)


def declare_questions() -> streams.StreamSpec:
    spec = streams.StreamSpec("event/question_asked", QuestionAsked, streams.Delivery.LOSSLESS)
    streams.BY_TYPE[QuestionAsked] = streams.BY_NAME[spec.name] = spec
    return spec


def sound(count: int, level: int, stamp_ns: int | None = None, source: str = "microphone") -> AudioChunk:
    samples = np.full((count, 1), level, np.int16)
    return AudioChunk(clock.now_ns() if stamp_ns is None else stamp_ns, source, RATE_HZ, samples)


@dataclass
class Recorded:
    """A session with a pause, and the sent values."""

    folder: Path
    heard: list[Any]
    begin: StartRecording
    arrived_ns: int
    stamp_ns: int
    frame_stamps_ns: list[int]
    held_while_recording: bool


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recorded]:
    folder = tmp_path_factory.mktemp("study") / "s"
    ring = FrameRing.create(640 * 480 * 3)
    recorder = RecorderUnderTest(ring, target=body_that_knows_questions)
    trial = {"participant": "P07", "recording": "2", "purpose": "pilot"}
    head = header(trial=trial, software={"PySide6": "6.11.2"}, settings={"voice": "joe"})
    begin = StartRecording(folder, head)
    recorder.send(begin)
    recorder.wait_for(RecorderReport)
    held = is_held(folder)
    arrived_ns = clock.now_ns()
    stamp_ns = arrived_ns - 250_000_000
    late = BatteryState(stamp_ns, 0.5)
    recorder.connection.send_bytes(ARRIVED + arrived_ns.to_bytes(8, "little", signed=True) + pickle.dumps(late))
    recorder.connection.send_bytes(ARRIVED + bytes(8) + b"no pickle at all")
    refs = feed_frames(recorder, ring, 10, period_s=1 / 15)
    recorder.send(QuestionAsked(clock.now_ns(), "Again?", ("yes", "no")))
    recorder.send(StatusShown(1, "map", {"a": 1}), StatusShown(2, "voice", None))
    sound_ns = clock.now_ns() - 300_000_000
    recorder.send(sound(1600, 1000, sound_ns), sound(1600, 1000, sound_ns + 100_000_000))
    recorder.send(mark("before"), PauseRecording(True))
    recorder.wait_for(RecorderReport, state="paused")
    photo = ring.write(picture(1), stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera="front")
    recorder.send(
        mark("unseen"),
        command(1, 0.7),
        pose(77.0),
        sound(1600, 2000),
        photo,
        TakePhoto(photo, folder / "elsewhere.png"),
    )
    recorder.wait_for(Problem, what="No photo was taken.")
    recorder.send(PauseRecording(False), mark("after"), BatteryState(stamp_ns, 0.5))
    resumed_ns = clock.now_ns()
    recorder.send(sound(1600, 3000, resumed_ns))
    refs += feed_frames(recorder, ring, 5, period_s=1 / 15)
    recorder.send(SetRecordingPermissions(video=True, photos=True, audio=False), sound(1600, 4000))
    recorder.stop_session()
    recorder.close()
    ring.close()
    yield Recorded(folder, recorder.heard, begin, arrived_ns, stamp_ns, [ref.stamp_ns for ref in refs], held)
    shutil.rmtree(folder)


def messages(folder: Path, topic: str) -> list[tuple[int, int, dict[str, Any]]]:
    """Log time, publish time and content of a topic, read by the ``mcap`` package."""
    with (folder / "events.mcap").open("rb") as file:
        return [
            (message.log_time, message.publish_time, json.loads(message.data))
            for _, _, message in make_reader(file).iter_messages(topics=[topic])
        ]


def test_a_message_keeps_when_it_was_made_and_when_it_arrived(recorded: Recorded) -> None:
    anchor = recorded.begin.header.clock
    log_time, publish_time, data = messages(recorded.folder, "/battery")[0]
    assert publish_time == anchor.utc_ns_at(recorded.stamp_ns)
    assert log_time == anchor.utc_ns_at(recorded.arrived_ns)
    assert data["stamp_ns"] == recorded.stamp_ns
    # Unreadable messages are counted, and have no other effect.
    ((_, _, gap),) = messages(recorded.folder, "/event/gap")
    assert (gap["stream"], gap["count"]) == ("unknown", 1)


def test_an_event_of_ones_own_needs_only_its_line_in_the_stream_table(
    recorded: Recorded, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = streams.StreamSpec("event/question_asked", QuestionAsked, streams.Delivery.LOSSLESS)
    monkeypatch.setitem(streams.BY_NAME, spec.name, spec)
    ((found, value),) = open_session(recorded.folder).values(spec.name)
    assert found == spec
    assert (value.question, value.answers) == ("Again?", ("yes", "no"))


def test_nothing_of_a_pause_is_recorded_and_everything_around_it(recorded: Recorded) -> None:
    session = open_session(recorded.folder)
    assert [value.label for _, value in session.values("event/marked")] == ["before", "after"]
    assert [value.paused for _, value in session.values("event/recording_paused")] == [True, False]
    assert not list(session.values("pose", "event/command_sent"))
    assert "0.700" not in (recorded.folder / "movement.txt").read_text()
    assert [value.charge_fraction for _, value in session.values("battery")] == [0.5, 0.5]
    assert not list(recorded.folder.rglob("*.png"))
    assert [report.paused for report in recorded.heard if isinstance(report, RecordingPaused)] == [True, False]
    head = json.loads((recorded.folder / "session.json").read_text())
    (pause,) = head["pauses"]
    assert head["started_ns"] < pause["paused_ns"] < pause["resumed_ns"] < head["ended_ns"]
    assert head["dropped"] == {"unknown": 1}
    labels = [data["label"] for _, _, data in messages(recorded.folder, "/event/marked")]
    assert labels == ["before", "after"]


def test_the_video_and_its_index_stay_true_across_the_pause(recorded: Recorded) -> None:
    times_s, _ = video_times_s(recorded.folder / "video-front.mp4")
    first_ns = recorded.frame_stamps_ns[0]
    expected_s = [(stamp_ns - first_ns) / 1e9 for stamp_ns in recorded.frame_stamps_ns]
    assert times_s == pytest.approx(expected_s, abs=0.001)
    with (recorded.folder / "video-front.frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["stamp_ns"]) for row in rows] == recorded.frame_stamps_ns
    assert [float(row["video_s"]) for row in rows] == pytest.approx(times_s, abs=1e-4)


def test_sound_lies_where_it_was_heard_and_silence_where_none_was_recorded(recorded: Recorded) -> None:
    (entry,) = json.loads((recorded.folder / "session.json").read_text())["audio"]
    assert (entry["file_name"], entry["source"], entry["channels"]) == ("audio-microphone.wav", "microphone", 1)
    with wave.open(str(recorded.folder / entry["file_name"])) as file:
        assert file.getnframes() == entry["samples"]
        found = np.frombuffer(file.readframes(entry["samples"]), dtype="<i2")
    assert set(found.tolist()) == {0, 1000, 3000}
    blocks = [value for _, value in open_session(recorded.folder).values("audio")]
    assert {block.source for block in blocks} == {"microphone"}
    assert sum(block.sample_count for block in blocks) == np.count_nonzero(found)
    for block in blocks:
        samples = found[block.first_sample : block.first_sample + block.sample_count]
        assert samples.all()
        assert block.stamp_ns == pytest.approx(
            entry["first_stamp_ns"] + block.first_sample * 1e9 / RATE_HZ, abs=2_000_000
        )


def test_session_json_says_with_what_and_why_it_was_recorded(recorded: Recorded) -> None:
    head = json.loads((recorded.folder / "session.json").read_text())
    assert head["format_version"] == 3
    assert head["software"] == {"PySide6": "6.11.2"}
    assert head["settings"] == {"voice": "joe"}
    assert (head["trial"]["recording"], head["trial"]["purpose"]) == ("2", "pilot")
    (video,) = head["videos"]
    assert (video["camera"], video["frames"], video["index_file"]) == ("front", 15, "video-front.frames.csv")
    assert video["encoder"].startswith("libx264")
    assert 5 < video["rate_hz"] < 16
    assert head["counts"]["frame"] == 15
    assert head["counts"]["status"] == 2
    assert len(messages(recorded.folder, "/status/map")) == 1


def test_checksums_close_the_session_and_nobody_holds_it_any_more(recorded: Recorded) -> None:
    assert recorded.held_while_recording
    wait_for(lambda: not is_held(recorded.folder), "the lock is released")
    assert not list(recorded.folder.glob(".*"))
    assert verify_manifest(recorded.folder) == []
    if shutil.which("sha256sum"):
        subprocess.run(
            ["sha256sum", "--strict", "--quiet", "-c", "manifest-sha256.txt"], cwd=recorded.folder, check=True
        )


@pytest.mark.usefixtures("trial_language")
@pytest.mark.logs(r"recorder\.session_recorder: ")
def test_with_little_room_left_every_second_frame_is_recorded_and_that_is_reported(tmp_path: Path) -> None:
    ring = FrameRing.create(640 * 480 * 3)
    recorder = RecorderUnderTest(ring, limits=DiskLimits(lower_video_free_bytes=1 << 60), in_thread=True)
    recorder.send(driving.start(tmp_path / "s"))
    assert recorder.wait_for(Problem).what.startswith("The disk is filling up:")
    feed_frames(recorder, ring, 10, period_s=1 / 30)
    recorder.send(mark("all the same"))
    report = recorder.stop_session()
    recorder.close()
    ring.close()
    assert report.detail == "every second frame is recorded: the disk is nearly full"
    assert report.dropped == {"frame": 5}
    ((_, _, gap),) = messages(tmp_path / "s", "/event/gap")
    assert gap["reason"] == "front: skipped because the disk is nearly full"
    (told,) = (message for message in recorder.heard if isinstance(message, Gap))
    assert tr(told.reason) == tr("{camera}: skipped because {why}").format(
        camera="front", why=tr("the disk is nearly full")
    )
    assert tr(read_reason(gap["reason"])) == tr(told.reason), "out of the record as well"
    assert tr(report.detail).startswith("["), "the window says it in its language, the record in English"
    assert len(video_times_s(tmp_path / "s" / "video-front.mp4")[0]) == 5
    assert len(messages(tmp_path / "s", "/event/marked")) == 1


def test_values_of_a_pause_that_come_after_it_are_left_out_but_what_stands_is_not(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    recorder = RecorderUnderTest(in_thread=True)
    recorder.send(StartRecording(folder, header()))
    recorder.wait_for(RecorderReport, state="recording")
    recorder.send(PauseRecording(True))
    recorder.wait_for(RecorderReport, state="paused")
    private_ns = clock.now_ns()
    recorder.send(PauseRecording(False))
    resumed: RecordingPaused = recorder.wait_for(RecordingPaused, paused=False)
    recorder.send(scan(stamp_ns=private_ns), scan(stamp_ns=resumed.stamp_ns), BatteryState(private_ns, 0.5))
    recorder.stop_session()
    recorder.close()
    session = open_session(folder)
    assert [value.stamp_ns for _, value in session.values("scan")] == [resumed.stamp_ns]
    assert [value.charge_fraction for _, value in session.values("battery")] == [0.5]


def test_sound_of_a_pause_that_comes_after_it_is_cut_off(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    recorder = RecorderUnderTest(in_thread=True)
    recorder.send(StartRecording(folder, header()))
    recorder.wait_for(RecorderReport, state="recording")
    recorder.send(PauseRecording(True))
    recorder.wait_for(RecorderReport, state="paused")
    private_ns = clock.now_ns()
    time.sleep(0.01)
    recorder.send(PauseRecording(False))
    resumed: RecordingPaused = recorder.wait_for(RecordingPaused, paused=False)
    # One block that begins in the pause and ends well after it.
    recorder.send(sound(RATE_HZ, 7000, stamp_ns=private_ns))
    recorder.stop_session()
    recorder.close()
    (path,) = folder.glob("audio-*.wav")
    with wave.open(str(path)) as file:
        kept = np.frombuffer(file.readframes(file.getnframes()), np.int16)
    private = round((resumed.stamp_ns - private_ns) * RATE_HZ / 1e9)
    assert int((kept == 7000).sum()) == pytest.approx(RATE_HZ - private, abs=2)
    assert private > 0


def test_speech_before_a_pause_is_recorded_in_it(
    tmp_path: Path,
) -> None:
    recorder = RecorderUnderTest(in_thread=True)
    recorder.send(start(tmp_path / "s"))
    begun = UtteranceChanged(clock.now_ns(), "h-1", "participant", "", "heard", "started")
    recorder.send(begun, PauseRecording(paused=True))
    recorder.wait_for(RecorderReport, state="paused")
    recorder.send(replace(begun, text="Where is the lab?", state="finished"), mark("within"))
    recorder.send(PauseRecording(paused=False))
    asked_ns = clock.now_ns()
    raw = pickle.dumps(StopRecording())
    recorder.connection.send_bytes(ARRIVED + (asked_ns - 2 * 10**9).to_bytes(8, "little", signed=True) + raw)
    recorder.wait_for(SessionEnded, stamp_ns=asked_ns - 2 * 10**9)
    recorder.wait_for(RecorderReport, state="idle")
    recorder.close()
    session = open_session(tmp_path / "s")
    assert [(one.text, one.said) for one in spoken(session)] == [("Where is the lab?", True)]
    assert not list(session.values("event/marked"))
    assert session.ended_ns == asked_ns - 2 * 10**9


@pytest.mark.logs(r"recorder\.session_recorder: ")
def test_a_value_that_nobody_could_read_is_reported_at_once_and_once_a_stream(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    recorder = RecorderUnderTest(in_thread=True)
    recorder.send(StartRecording(folder, header()))
    recorder.wait_for(RecorderReport, state="recording")
    recorder.send(replace(scan(), ranges_m={"dtype": "float32"}))
    told: Problem = recorder.wait_for(Problem)
    assert (told.severity, told.what.startswith("scan cannot be recorded: ")) == ("error", True)
    recorder.send(scan(), replace(scan(), ranges_m=[1.0, "far"]), BatteryState(clock.now_ns(), 0.5))
    report = recorder.stop_session()
    recorder.close()
    assert report.dropped == {"scan": 2}
    assert sum(isinstance(message, Problem) for message in recorder.heard) == 1
    session = open_session(folder)
    assert len(list(session.values("scan"))) == len(list(session.values("battery"))) == 1
    assert session.header.to_json()["counts"]["scan"] == 1
