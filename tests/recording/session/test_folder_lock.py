"""Lock of a folder in use, seen from other processes."""

import subprocess
import sys
import threading
from pathlib import Path

import pytest

from caris_desktop.recording.session.folder_lock import LOCK_NAME, FolderHeldError, hold, is_held

_HOLDER = """
import sys, time
from pathlib import Path
from caris_desktop.recording.session.folder_lock import hold
lock = hold(Path(sys.argv[1]))
print("held", flush=True)
time.sleep(60)
"""


def test_a_lock_is_seen_by_others_and_leaves_nothing_behind(tmp_path: Path) -> None:
    assert not is_held(tmp_path)
    with hold(tmp_path) as lock:
        assert is_held(tmp_path)
        assert is_held(tmp_path)
        with pytest.raises(FolderHeldError):
            hold(tmp_path)
        lock.release()
        lock.release()
    assert not is_held(tmp_path)
    assert not any(tmp_path.iterdir())


def test_a_killed_holder_holds_nothing(tmp_path: Path) -> None:
    holder = subprocess.Popen([sys.executable, "-c", _HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    assert is_held(tmp_path)
    holder.kill()
    holder.wait()
    holder.stdout.close()
    assert (tmp_path / LOCK_NAME).exists()
    assert not is_held(tmp_path)
    hold(tmp_path).release()
    assert not any(tmp_path.iterdir())


def test_a_reader_does_not_keep_a_recording_from_starting(tmp_path: Path) -> None:
    ended = threading.Event()

    def look() -> None:
        while not ended.is_set():
            is_held(tmp_path)

    looking = threading.Thread(target=look)
    looking.start()
    try:
        for _ in range(50):
            hold(tmp_path).release()
    finally:
        ended.set()
        looking.join()
