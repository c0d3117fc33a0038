"""Recorded data reaches the disk: verified by system calls, and with a slow disk."""

import json
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections import defaultdict
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from caris_desktop.domain.events import Problem
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.recorder.disk_watch import DiskLimits
from caris_desktop.recording.recorder.recorder_messages import RecorderReport
from caris_desktop.recording.recorder.session_recorder import FsyncThread
from tests.recording import driving
from tests.recording.driving import RecorderUnderTest, mark, start
from tests.support.polling import wait_for

REPOSITORY = Path(__file__).parents[3]
_CALLS = "write,pwrite64,fdatasync,fsync"
_LINE = re.compile(r"(\d+) +([\d.]+) (?:(\w+)\(\d+<([^>]*)>|<\.\.\. (\w+) resumed>)(.*)")


def traced(folder: Path, trace: Path) -> None:
    """Record a session under ``strace``; skips if that is missing or not permitted."""
    if shutil.which("strace") is None:
        pytest.skip("needs strace to see the system calls")
    probe = subprocess.run(["strace", "-f", "-o", os.devnull, "true"], capture_output=True, check=False)
    if probe.returncode:
        pytest.skip("strace may not trace here")
    subprocess.run(
        [
            *("strace", "-f", "-y", "-ttt", "-e", f"trace={_CALLS}", "-e", "signal=none", "-s", "0", "-o", str(trace)),
            *(sys.executable, "-m", "tests.support.run_module", "tests.recording.session_to_trace", str(folder)),
        ],
        cwd=REPOSITORY,
        check=True,
        timeout=90,
    )


def calls(trace: Path) -> list[tuple[str, str, float, float]]:
    """Call, path, start and end of every successful call."""
    begun: dict[str, tuple[str, str, float]] = {}
    found = []
    for line in trace.read_text(errors="replace").splitlines():
        match = _LINE.match(line)
        if match is None:
            continue
        thread, at, call, path, resumed, rest = match.groups()
        if resumed:
            call, path, begin_s = begun.pop(thread, ("", "", 0.0))
        else:
            begin_s = float(at)
            if rest.endswith("<unfinished ...>"):
                begun[thread] = (call, path, begin_s)
                continue
        if call and "= -1" not in rest:
            found.append((call, path, begin_s, float(at)))
    return found


def test_all_that_is_written_is_on_the_disk_within_a_second(tmp_path: Path) -> None:
    folder, trace = tmp_path / "s", tmp_path / "trace"
    traced(folder, trace)
    written, synced = defaultdict(list), defaultdict(list)
    for call, path, begin_s, end_s in calls(trace):
        if not path.startswith(str(folder)):
            continue
        # A file that is replaced as a whole is written under another name.
        name = re.sub(r"\.(.+)\.[0-9a-f]{8}\.part", r"\1", Path(path).name)
        (written if "write" in call else synced)[name].append((begin_s, end_s))
    grown = {"events.mcap", "video-front.mp4", "video-front.frames.csv", "audio-microphone.wav", "movement.txt"}
    assert grown | {"speech.txt", "session.json", "0001.png", "people.json"} <= written.keys()
    delays_s = []
    for name, writes in written.items():
        for _, end_s in writes:
            done_s = [sync_end_s for sync_begin_s, sync_end_s in synced[name] if sync_begin_s >= end_s]
            assert done_s, f"{name} was written and never brought to the disk"
            delays_s.append(min(done_s) - end_s)
    assert {"s", "photos"} <= synced.keys()  # folder entries too
    # A busy machine may delay single calls, but not one in ten.
    within = sum(delay_s <= 1.0 for delay_s in delays_s) / len(delays_s)
    assert within > 0.9, sorted(delays_s)[-20:]


def body_on_a_slow_disk(connection: Connection, ring_names: tuple[str, ...], limits: DiskLimits) -> None:
    """Every sync of the disk takes longer, until a file named ``fast`` appears in the parent folder."""
    sync = os.fdatasync

    def sync_slowly(descriptor: int) -> None:
        path = Path(f"/proc/self/fd/{descriptor}").readlink()
        if not (path.parents[1] / "fast").exists():
            time.sleep(1.1)
        sync(descriptor)

    os.fdatasync = sync_slowly
    driving.body(connection, ring_names, limits)


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc to tell which file is synced")
@pytest.mark.long
def test_a_slow_disk_is_reported_once_and_costs_no_event(tmp_path: Path) -> None:
    recorder = RecorderUnderTest(target=body_on_a_slow_disk)
    recorder.send(start(tmp_path / "s"))
    recorder.wait_for(RecorderReport)
    number, deadline = 0, time.monotonic() + 30
    while not any(isinstance(message, Problem) for message in recorder.heard) and time.monotonic() < deadline:
        recorder.send(mark(str(number)))
        number += 1
        time.sleep(0.02)
        recorder.drain()
    problem = recorder.wait_for(Problem)
    assert problem.what.startswith("The disk is slow: writing the recorded data took")
    assert "every second video frame" in problem.meaning
    wait_for(
        lambda: recorder.drain() or reports(recorder)[-1].detail.endswith("the disk is slow"), "the report says so"
    )
    (tmp_path / "fast").touch()
    recorder.stop_session()
    recorder.close()
    assert sum(isinstance(message, Problem) for message in recorder.heard) == 1
    head = json.loads((tmp_path / "s" / "session.json").read_text())
    assert head["counts"]["event/marked"] == number
    assert head["dropped"] == {}


def reports(recorder: RecorderUnderTest) -> list[RecorderReport]:
    return [message for message in recorder.heard if isinstance(message, RecorderReport)]


def test_a_round_in_progress_counts_as_long_as_it_takes_already(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    release = threading.Event()
    monkeypatch.setattr(os, "fdatasync", lambda _descriptor: release.wait(20))
    file = DiskFile(tmp_path / "f")
    lane = FsyncThread("test", lambda: [file], every_s=0.01)
    file.write(b"x")
    lane.start()
    wait_for(lambda: max(lane.delays_s(time.monotonic(), within_s=1.0)) > 0.1, "the round takes long")
    release.set()
    lane.close(timeout_s=5)
    file.close()
    assert max(lane.delays_s(time.monotonic(), within_s=30.0)) > 0.1


@pytest.mark.logs(r"recorder\.session_recorder: ")
def test_a_disk_error_is_remembered_and_the_rest_is_synced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[str] = []

    def refuse_bad(descriptor: int) -> None:
        name = Path(f"/proc/self/fd/{descriptor}").readlink().name
        if name == "bad":
            raise OSError(28, "No space left on device")
        synced.append(name)

    monkeypatch.setattr(os, "fdatasync", refuse_bad)
    files = [DiskFile(tmp_path / name) for name in ("bad", "good")]
    lane = FsyncThread("test", lambda: files, every_s=1.0)
    for file in files:
        file.write(b"x")
    lane.note(tmp_path / "gone meanwhile")
    lane.sync_now()
    assert lane.disk_full
    assert synced == ["good"]
    for file in files:
        file.close()
