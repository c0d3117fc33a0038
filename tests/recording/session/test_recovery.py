"""Repair of interrupted sessions: recovered data, saved originals, and interrupted repairs."""

import json
import os
import re
import shutil
import subprocess
import sys
import wave
from collections import Counter
from hashlib import sha256
from pathlib import Path

import av
import numpy as np
import pytest
from mcap.reader import make_reader

from caris_desktop.domain.events import SessionEnded
from caris_desktop.domain.sensing import FrameRef, RobotPose
from caris_desktop.domain.translation import LocalizedText, localized
from caris_desktop.live.frame_ring import FrameRings
from caris_desktop.recording.recorder.disk_watch import DiskLimits
from caris_desktop.recording.recorder.plain_files import PlainFiles
from caris_desktop.recording.recorder.session_recorder import SessionRecorder
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session import events_file, recovery
from caris_desktop.recording.session.folder_lock import hold
from caris_desktop.recording.session.loss_messages import LOSSES, read_loss
from caris_desktop.recording.session.manifest import MANIFEST_NAME, progress_counts, store_counts, verify_manifest
from caris_desktop.recording.session.media_files import content_of, read_frame_times
from caris_desktop.recording.session.recovery import needs_repair, repair_session
from caris_desktop.recording.session.session_header import SessionError
from caris_desktop.recording.session.session_reader import Session, open_session
from tests.recording.driving import start
from tests.support.recorded_session import RecordedSession

REPOSITORY = Path(__file__).parents[3]


@pytest.fixture
def folder(killed_session: RecordedSession, tmp_path: Path) -> Path:
    """A copy of a killed session."""
    shutil.copytree(killed_session.folder, tmp_path / "session")
    return tmp_path / "session"


def digests(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def labels(session: Session) -> list[str]:
    return [value.label for _, value in session.values("event/marked")]


def test_everything_that_was_saved_comes_back_and_what_was_found_is_retained(
    folder: Path, killed_session: RecordedSession
) -> None:
    found = digests(folder)
    assert needs_repair(folder)
    session = open_session(folder)
    assert not needs_repair(folder)
    assert (session.reason, session.closed_properly) == ("recovered", False)
    assert "cut off after" in session.notices[0]
    assert session.losses[0] == "The number of values missing at the end of events.mcap is unknown."
    assert [*session.header.to_json()["repairs"], *session.losses] == list(session.notices)

    read = list(session.arrivals())
    assert [(arrived_ns, type(value)) for arrived_ns, _, value in read[:-1]] == [
        (arrived_ns, type(value)) for arrived_ns, value in killed_session.values
    ]
    comparable = [(value, sent) for (_, _, value), (_, sent) in zip(read[:-1], killed_session.values, strict=True)]
    assert all(value == sent for value, sent in comparable if type(value).__eq__ is not object.__eq__)
    end = read[-1][2]
    assert isinstance(end, SessionEnded)
    assert (end.reason, end.stamp_ns) == ("recovered", session.ended_ns)
    assert session.ended_ns == killed_session.values[-1][0]
    assert sum(session.header.to_json()["counts"].values()) == len(read)

    kept = digests(folder / "recovered")
    assert kept["events.mcap.original"] == found["events.mcap"]
    assert kept["session.json.original"] == found["session.json"]
    assert verify_manifest(folder) == []
    assert not list(folder.rglob(".*"))

    again = digests(folder)
    assert open_session(folder).notices == ()
    assert digests(folder) == again


def test_other_readers_find_an_index_sound_and_frame_times(folder: Path, killed_session: RecordedSession) -> None:
    session = open_session(folder)
    with (folder / "events.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        # Each pose is also written as a transform for other programs.
        poses = sum(isinstance(value, RobotPose) for _, value in killed_session.values)
        assert summary.statistics.message_count == len(killed_session.values) + poses + 1
        assert len(summary.chunk_indexes) == summary.statistics.chunk_count
        assert sum(1 for _ in reader.iter_messages(topics=["/event/marked"])) == len(labels(session))
    for sound in session.header.to_json()["audio"]:
        with wave.open(str(folder / sound["file_name"])) as file:
            assert file.getnframes() == sound["samples"]
            assert file.getnframes() / file.getframerate() == pytest.approx(7.7, abs=0.15)
        assert sound["first_stamp_ns"] == killed_session.plan.started_ns + 150_000_000
    sent = {value.stamp_ns: value for _, value in killed_session.values if isinstance(value, FrameRef)}
    assert [video["camera"] for video in session.header.to_json()["videos"]] == ["front", "rear"]
    for video in session.header.to_json()["videos"]:
        times = read_frame_times(folder / video["index_file"])
        with av.open(str(folder / video["file_name"])) as container:
            shown_s = [float(frame.pts * frame.time_base) for frame in container.decode(video=0)]
        assert times.video_s.tolist() == pytest.approx(shown_s, abs=1e-5)
        assert len(shown_s) == video["frames"] > 60
        assert all(sent[stamp_ns].camera == video["camera"] for stamp_ns in times.stamps_ns.tolist())


def test_a_look_without_repair_changes_nothing(folder: Path) -> None:
    before = digests(folder)
    session = open_session(folder, repair=False)
    assert (session.closed_properly, session.reason, session.notices) == (False, "", ())
    assert len(labels(session)) > 0
    assert digests(folder) == before


def test_a_session_that_is_being_recorded_is_left_alone(folder: Path) -> None:
    before = digests(folder)
    with hold(folder):
        with pytest.raises(SessionError, match="still being recorded"):
            open_session(folder)
        assert labels(open_session(folder, repair=False))
    assert digests(folder) == before


@pytest.mark.long
def test_a_kill_in_the_middle_of_the_repair_does_no_harm(
    killed_session: RecordedSession, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    step = 1 if request.config.getoption("--long") else 5
    arguments = [str(killed_session.folder), str(tmp_path), "1", str(step)]
    told = subprocess.run(
        [sys.executable, "-m", "tests.recording.repair_and_die", *arguments],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=True,
        timeout=100,
    )
    assert int(told.stdout) > 20, "the repair touches its files so often that the kills come everywhere"
    original = sha256((killed_session.folder / "events.mcap").read_bytes()).hexdigest()
    expected = labels(open_session(killed_session.folder, repair=False))
    for folder in sorted(tmp_path.iterdir()):
        session = open_session(folder)
        assert labels(session) == expected, folder
        assert session.reason == "recovered"
        assert original in digests(folder / "recovered").values()
        assert verify_manifest(folder) == []
        assert not list(folder.rglob(".*.part")), folder
        assert open_session(folder).notices == ()


def test_a_half_written_repair_is_begun_again(folder: Path) -> None:
    (folder / ".events.mcap.part").write_bytes(b"\x89MCAP0\r\n half")
    (folder / ".people.json.part").write_text("{")
    session = open_session(folder)
    assert session.reason == "recovered"
    assert any("people.json.part" in notice for notice in session.notices)
    assert (folder / "recovered" / "people.json.part").read_text() == "{"


def test_frames_after_the_last_whole_part_of_a_video_are_reported_as_lost(
    folder: Path, killed_session: RecordedSession
) -> None:
    video = folder / "video-front.mp4"
    cut = video.read_bytes()[: video.stat().st_size * 2 // 3]
    video.write_bytes(cut)
    lines_before = (folder / "video-front.frames.csv").read_bytes()
    session = open_session(folder)
    times = read_frame_times(folder / "video-front.frames.csv")
    with av.open(str(video)) as container:
        assert sum(1 for _ in container.decode(video=0)) == times.count
    assert video.read_bytes() + (folder / "recovered" / "video-front.mp4.tail").read_bytes() == cut
    assert lines_before.startswith((folder / "video-front.frames.csv").read_bytes())
    assert (folder / "recovered" / "video-front.frames.csv.original").read_bytes() == lines_before
    refs = [value for _, value in killed_session.values if isinstance(value, FrameRef) and value.camera == "front"]
    lost = len(refs) - times.count
    assert lost > 20
    assert any(f"last {lost} frames of camera front" in notice for notice in session.notices)
    assert session.header.to_json()["dropped"]["frame"] >= lost


def test_frame_times_that_are_missing_come_from_the_record(folder: Path, killed_session: RecordedSession) -> None:
    index = folder / "video-front.frames.csv"
    whole = read_frame_times(index)
    lines = index.read_bytes().splitlines(keepends=True)
    for content in (None, b"".join(lines[:20]) + lines[20][:7], b"not an index\n"):
        folder_now = folder.with_name("again")
        shutil.copytree(folder, folder_now)
        path = folder_now / index.name
        path.unlink() if content is None else path.write_bytes(content)
        open_session(folder_now)
        times = read_frame_times(path)
        assert times.stamps_ns[: whole.count].tolist() == whole.stamps_ns.tolist()
        assert times.robot_stamps_ns[: whole.count].tolist() == whole.robot_stamps_ns.tolist()
        assert np.allclose(times.video_s[: whole.count], whole.video_s, atol=2e-6)
        shutil.rmtree(folder_now)


def test_zeros_after_a_power_cut_cost_only_what_they_cover(folder: Path) -> None:
    whole = Counter(spec.name for spec, _ in open_session(folder, repair=False).values())
    path = folder / "events.mcap"
    content = bytearray(path.read_bytes())
    at = len(content) // 2
    content[at : at + 4096] = bytes(4096)
    path.write_bytes(content)
    expected = labels(open_session(folder, repair=False))
    session = open_session(folder)
    assert labels(session) == expected
    # Sequence numbers show the number of missing values, although no count was written.
    left = Counter(spec.name for spec, _ in session.values())
    lost = whole - left
    assert session.header.to_json()["lost"] == dict(sorted(lost.items()))
    assert session.losses[0].startswith(f"{lost.total()} of the {whole.total()} recorded values are missing")
    stamps_ns = [value.stamp_ns for _, value in session.values("odometry")]
    assert stamps_ns[-1] - stamps_ns[0] > 7e9, "what comes behind the damage is read too"
    holes_ns = np.diff(stamps_ns)
    assert 0.1e9 < holes_ns.max() < 3e9


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"\x89MC"])
def test_a_record_without_a_single_event_is_an_empty_session(folder: Path, content: bytes) -> None:
    (folder / "events.mcap").write_bytes(content)
    session = open_session(folder)
    assert [type(value) for _, value in session.values()] == [SessionEnded]
    assert session.duration_s == 0.0


@pytest.fixture
def finished(whole_session: RecordedSession, tmp_path: Path) -> Path:
    """A copy of a properly closed session."""
    shutil.copytree(whole_session.folder, tmp_path / "finished")
    return tmp_path / "finished"


def test_a_finished_record_that_was_cut_is_reported_as_such_permanently(finished: Path) -> None:
    before = digests(finished)
    head = json.loads((finished / "session.json").read_text())
    path = finished / "events.mcap"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 50])
    cut = path.read_bytes()
    assert any(loss.startswith("events.mcap has ") for loss in open_session(finished, repair=False).losses)

    session = open_session(finished)
    left = Counter(spec.name for spec, _ in session.values())
    recorded = Counter(head["counts"])
    lost = recorded - left
    del lost["event/session_ended"]  # restored from session.json
    assert lost.total() > recorded.total() * 0.9
    # The end of the session is not counted: it is restored.
    told = f"{lost.total()} of the {recorded.total() - 1} recorded values are missing from events.mcap"
    assert session.losses[0].startswith(told)
    assert re.search(r"it ends 1[456]\.\d s before the recording did", session.losses[0])
    assert session.header.to_json()["lost"] == dict(sorted(lost.items()))
    assert (session.reason, session.ended_ns, session.header.to_json()["videos"]) == (
        "wizard",
        head["ended_ns"],
        head["videos"],
    )

    assert digests(finished)[MANIFEST_NAME] == before[MANIFEST_NAME], "the evidence is not made anew"
    assert (finished / "recovered" / "events.mcap.original").read_bytes() == cut
    assert "events.mcap was changed after the session closed." in verify_manifest(finished)
    again = open_session(finished)
    assert (again.notices, again.losses) == ((), session.losses)


@pytest.mark.logs(r"session\.recovery: ")
def test_a_repair_of_a_finished_record_that_was_cut_off_itself_still_reports(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = finished / "events.mcap"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])

    def stop(*_: object) -> None:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patched:
        patched.setattr(recovery._Repair, "_replace_header", stop)
        assert "could not be repaired" in open_session(finished).notices[0]
    assert "recorded values are missing" in open_session(finished).losses[0]


def test_counts_of_the_recorder_reveal_the_gaps_of_a_cut_recording(folder: Path) -> None:
    whole = Counter(spec.name for spec, _ in open_session(folder, repair=False).values())
    store_counts(folder, whole)
    path = folder / "events.mcap"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    session = open_session(folder)
    left = Counter(spec.name for spec, _ in session.values())
    del left["event/session_ended"]
    assert session.losses[0].startswith(
        f"{whole.total() - left.total()} of the {whole.total()} recorded values are missing from events.mcap"
    )
    assert not list(folder.rglob(".*"))


def test_a_recorder_counts_what_it_has_written(tmp_path: Path) -> None:
    recorder = SessionRecorder(
        start(tmp_path / "s"), frames=FrameRings(()), report=lambda _: None, limits=DiskLimits(reserve_bytes=4096)
    )
    assert progress_counts(tmp_path / "s") == {"event/session_started": 1}
    recorder.close("wizard")
    assert progress_counts(tmp_path / "s") is None
    assert not needs_repair(tmp_path / "s")


def test_using_the_last_room_leaves_that_of_the_header(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = SessionRecorder(
        start(tmp_path / "s"), frames=FrameRings(()), report=lambda _: None, limits=DiskLimits(reserve_bytes=4096)
    )
    while recorder._make_room():
        pass
    held, close = [], PlainFiles.close

    def closing(files: PlainFiles) -> None:
        held.append((recorder._reserve.left_bytes, recorder._reserve.held_bytes > 100_000))
        close(files)

    monkeypatch.setattr(PlainFiles, "close", closing)
    recorder.close("disk_full")
    assert held == [(0, True)], "a film may take what the others gave back, up to the moment of the header"
    assert not recorder._reserve.held_bytes
    assert open_session(tmp_path / "s").reason == "disk_full"


@pytest.mark.logs(r"session\.session_header: ")
@pytest.mark.parametrize("content", [None, b"", b'{"format": '])
def test_a_lost_head_is_made_again_from_the_events(finished: Path, content: bytes | None) -> None:
    whole = open_session(finished)
    path = finished / "session.json"
    path.unlink() if content is None else path.write_bytes(content)
    before = digests(finished)
    looked_at = open_session(finished, repair=False)
    assert digests(finished) == before
    session = open_session(finished)
    for one in (looked_at, session):
        assert (one.started_ns, one.ended_ns, one.identity[:2]) == (
            whole.started_ns,
            whole.ended_ns,
            whole.identity[:2],
        )
        assert (one.reason, one.closed_properly) == ("wizard", True)
        assert one.header.to_json()["scenario"]["title"] == "Tour guide"
        assert one.header.to_json()["robot"]["profile"] == "temi"
        assert f"session.json was {'missing' if content is None else 'damaged'}" in one.losses[0]
    assert session.header.to_json()["counts"] == whole.header.to_json()["counts"]
    assert [video["frames"] for video in session.header.to_json()["videos"]] == [
        video["frames"] for video in whole.header.to_json()["videos"]
    ]
    assert labels(session) == labels(whole)
    assert len(session.losses) == 1
    assert "session.json was changed after the session closed." in verify_manifest(finished)
    assert open_session(finished).losses == session.losses


def test_a_session_shows_who_took_part_even_without_its_head(tmp_path: Path) -> None:
    recorder = SessionRecorder(
        start(tmp_path / "s"), frames=FrameRings(()), report=lambda _: None, limits=DiskLimits(reserve_bytes=4096)
    )
    recorder.close("wizard")
    trial = open_session(tmp_path / "s").trial
    (tmp_path / "s" / "session.json").unlink()
    assert open_session(tmp_path / "s").trial == {key: text for key, text in trial.items() if key != "wizard" and text}


@pytest.mark.logs(r"replay\.video_reader: ")
def test_media_that_are_gone_or_cut_are_reported_each_time(finished: Path) -> None:
    front, rear = finished / "video-front.mp4", finished / "video-rear.mp4"
    sound = finished / "audio-microphone.wav"
    front.unlink()
    rear.write_bytes(rear.read_bytes()[: rear.stat().st_size // 2])
    sound.write_bytes(sound.read_bytes()[: sound.stat().st_size // 2])
    (finished / "speech.txt").unlink()
    content = content_of(rear)
    assert content is not None
    left, before = len(content.times_s), digests(finished)
    assert left > 50
    expected = (
        "audio-microphone.wav is cut off: of 15.6 s of audio, 7.8 s are left.",
        "video-front.mp4 is missing: all 189 frames of camera front.",
        f"video-rear.mp4 is cut off: of 189 frames of camera rear, {left} are left.",
        "speech.txt is missing.",
    )
    for _ in range(2):
        session = open_session(finished)
        assert (session.notices, session.losses) == ((), expected)
    assert digests(finished) == before
    with VideoReader(session) as videos:
        assert len(videos.frame_times_ns("rear")) == left


def test_recorded_losses_are_found_again_for_another_language() -> None:
    values = {"file": "a.mp4", "camera": "front, rear", "count": 9, "recorded": 8, "bytes": 7, "seconds": "6.5"}
    for text in LOSSES:
        sentence = localized(text, **values, left="0.1", all=3, values=2)
        kept = read_loss("".join(sentence))
        assert isinstance(kept, LocalizedText)
        assert (kept, kept.template) == (sentence, sentence.template)


@pytest.mark.logs(r"session\.session_reader: ")
def test_damaged_values_are_counted_when_they_are_read(finished: Path) -> None:
    whole = Counter(spec.name for spec, _ in open_session(finished).values())
    path = finished / "events.mcap"
    content = bytearray(path.read_bytes())
    index = events_file.read_index(path)
    for number in (3, 9):
        content[int(index.offsets[number]) + 100] ^= 0xFF
    path.write_bytes(content)
    session = open_session(finished)
    lost = whole - Counter(spec.name for spec, _ in session.values())
    assert lost.total() > 0
    assert session.lost == lost
    assert session.losses == (f"{lost.total()} of the {whole.total()} recorded values are missing from events.mcap.",)


@pytest.mark.logs(r"session\.(session_reader|events_file|recovery): ")
@pytest.mark.parametrize("size", [1, 100, 5000])
@pytest.mark.parametrize("tenths", range(1, 10))
def test_overwritten_values_are_counted(finished: Path, size: int, tenths: int) -> None:
    head = json.loads((finished / "session.json").read_text("utf-8"))
    path = finished / "events.mcap"
    content = bytearray(path.read_bytes())
    at = len(content) * tenths // 10
    content[at : at + size] = b"\xff" * size
    path.write_bytes(content)
    session = open_session(finished)
    left = sum(1 for _ in session.values())
    assert sum(session.lost.values()) == sum(head["counts"].values()) - left
    told = [loss for loss in session.losses if "recorded values are missing" in loss]
    assert [int(loss.split()[0]) for loss in told] == [count for count in [sum(session.lost.values())] if count]
    again = open_session(finished)
    assert (again.lost, again.losses) == (session.lost, session.losses)


@pytest.mark.logs(r"session\.recovery: ")
def test_a_repair_that_meets_what_nobody_foresaw_says_so(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stumble(*_: object) -> None:
        raise ValueError("invalid literal for int() with base 10: b'x'")

    monkeypatch.setattr(recovery, "read_frame_times", stumble)
    before = digests(folder)["events.mcap"]
    session = open_session(folder)
    assert session.notices == (
        "The session is damaged and could not be repaired: the damage is of an unexpected kind; see the log for "
        "details. It is shown as it was found; the attempt caused no further damage.",
    )
    assert before in digests(folder).values()


def test_a_record_that_is_none_is_refused_and_left_alone(folder: Path) -> None:
    (folder / "events.mcap").write_bytes(b"This is no MCAP file at all." * 100)
    before = digests(folder)
    with pytest.raises(SessionError, match=r"events\.mcap is not an event log"):
        open_session(folder)
    assert digests(folder) == before


def test_only_missing_checksums_are_made(whole_session: RecordedSession, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    shutil.copytree(whole_session.folder, folder)
    (folder / MANIFEST_NAME).unlink()
    before = digests(folder)
    report = repair_session(folder)
    assert (report.repaired, len(report.sentences)) == (True, 1)
    assert verify_manifest(folder) == []
    assert {name: digest for name, digest in digests(folder).items() if name != MANIFEST_NAME} == before


def test_an_index_that_a_full_disk_prevented_is_made_up_for(whole_session: RecordedSession, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    shutil.copytree(whole_session.folder, folder)
    head = json.loads((folder / "session.json").read_text())
    (folder / "session.json").write_text(json.dumps({**head, "reason": "disk_full"}))
    index = events_file.read_index(folder / "events.mcap")
    cut_at = int(index.offsets[index.count * 4 // 5]) + 50
    (folder / "events.mcap").write_bytes((folder / "events.mcap").read_bytes()[:cut_at])
    session = open_session(folder)
    assert (session.reason, session.closed_properly) == ("disk_full", True)
    assert session.ended_ns == head["ended_ns"]
    assert [value.reason for _, value in session.values("event/session_ended")] == ["disk_full"]


def test_without_write_access_the_session_is_shown_as_it_was_left(folder: Path, tmp_path: Path) -> None:
    size_kb = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) // 1024 + 120
    script = (
        'mkdir "$2"; mount -t tmpfs -o size="$3"k none "$2"; cp -r "$1"/. "$2";'
        '"$4" -m tests.recording.open_and_tell "$2";'
        'mount -o remount,ro "$2"; "$4" -m tests.recording.open_and_tell "$2"'
    )
    told = in_own_mounts(script, str(folder), str(tmp_path / "small"), str(size_kb), sys.executable)
    assert told.returncode == 0, told.stderr
    full, read_only = (json.loads(line) for line in told.stdout.splitlines())
    expected = len(labels(open_session(folder, repair=False)))
    for answer, why in ((full, "not enough disk space"), (read_only, "cannot be written")):
        assert why in answer["notices"][0]
        assert "as it was found" in answer["notices"][0]
        assert (answer["reason"], answer["marks"]) == ("", expected)
        assert answer["files"] == sorted(digests(folder)), "nothing was added, nothing is missing"


def in_own_mounts(script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run ``script`` in a separate mount namespace; skips if that is not permitted."""
    command = ["unshare", "--mount", "--propagation", "private", "sh", "-ec", script, "sh", *arguments]
    try:
        probe = subprocess.run([*command[:5], "-c", "mount -t tmpfs none /mnt"], capture_output=True, check=False)
    except FileNotFoundError:
        pytest.skip("needs unshare (util-linux) to make a small disk")
    if probe.returncode:
        pytest.skip("needs the right to mount a small disk of its own (root)")
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=90, cwd=REPOSITORY)


def test_links_that_lead_out_of_the_session_are_not_followed(folder: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside.mcap"
    shutil.move(folder / "events.mcap", outside)
    content = outside.read_bytes()
    (folder / "events.mcap").symlink_to(outside)
    with pytest.raises(SessionError, match="a link to a location outside"):
        open_session(folder)
    assert outside.read_bytes() == content


@pytest.mark.parametrize("name", ["session.json", "people.json", "photos/0001.png"])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_a_session_with_a_pipe_or_a_device_is_refused_before_one_is_read(folder: Path, name: str, kind: str) -> None:
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    with pytest.raises(SessionError, match="is a pipe or a device"):
        open_session(folder)
