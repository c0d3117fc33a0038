"""Fixtures that fail a test which leaks threads, timers, child processes or temporary files, or logs warnings.

Each test is compared with the state before it, and each file with the state before its shared fixtures.
"""

import gc
import logging
import multiprocessing.util
import os
import re
import shutil
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

_GRACE_S = 5.0
"""Time for threads and processes to exit on a busy machine."""
_POLL_S = 0.02

# Logged when the machine is overloaded, independently of the test.
_OVERLOAD_MESSAGES = re.compile(r"The computer is too slow|did not end within \S+ s: killed")
# Threads of libraries that live until the process exits.
_LASTING_THREADS = re.compile(r"ThreadPoolExecutor|asyncio_|tqdm|pytest|execnet|Dummy-|roslibpy-asyncio")
# Processes that multiprocessing starts once and reuses.
_LASTING_PROCESSES = ("multiprocessing.resource_tracker", "multiprocessing.forkserver")
_LASTING_FILES = ("pytest-of-", "pymp-", "run", "torchinductor_")


_private_temp_dir: list[Path] = []


def use_private_temp_dir() -> None:
    """Create the temporary folder of this run and its child processes, in which leaked files are found."""
    os.environ["PYTEST_DEBUG_TEMPROOT"] = tempfile.gettempdir()
    # A short name: socket paths are limited to 107 characters.
    folder = Path(tempfile.mkdtemp(prefix="ct-"))
    tempfile.tempdir = os.environ["TMPDIR"] = str(folder)
    _private_temp_dir.append(folder)
    # Without it, sound libraries create a folder in TMPDIR for each process.
    runtime = folder / "run"
    runtime.mkdir(mode=0o700)
    os.environ["XDG_RUNTIME_DIR"] = str(runtime)
    # Shared fixtures of a file start before the isolated settings of its first test.
    for name in ("XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_STATE_HOME", "XDG_DOCUMENTS_DIR"):
        os.environ[name] = str(folder / "run" / name.lower())
    # After multiprocessing (-100), which uses a folder in it until it exits.
    multiprocessing.util.Finalize(None, shutil.rmtree, (folder,), {"ignore_errors": True}, exitpriority=-200)


@dataclass
class _Timers:
    """Started QTimers with the file and line that started them."""

    started: "weakref.WeakKeyDictionary[Any, str]" = field(default_factory=weakref.WeakKeyDictionary)
    watching: bool = False

    def watch(self) -> None:
        """Patch ``QTimer.start`` if Qt has been imported."""
        if self.watching or "PySide6.QtCore" not in sys.modules:
            return
        from PySide6.QtCore import QTimer

        original = QTimer.start
        started = self.started

        def start(timer: QTimer, *arguments: Any) -> None:
            caller = sys._getframe(1)
            started[timer] = f"{caller.f_code.co_filename}:{caller.f_lineno}"
            original(timer, *arguments)

        QTimer.start = start  # type: ignore[method-assign, assignment]
        self.watching = True

    def running(self) -> dict[int, str]:
        if not self.started:
            return {}
        import shiboken6

        timers = [(timer, where) for timer, where in list(self.started.items()) if shiboken6.isValid(timer)]
        return {id(timer): f"timer started at {where}" for timer, where in timers if timer.isActive()}


_timers = _Timers()


def _threads() -> dict[int, str]:
    alive = [thread for thread in threading.enumerate() if not _LASTING_THREADS.search(thread.name)]
    return {id(thread): f"thread {thread.name}" for thread in alive}


def _child_processes() -> dict[int, str]:
    """Child processes of this process from the kernel's list; a search of all processes would take 10 ms per test."""
    found = {}
    # Without Path objects, which would take longer to create than the files to read.
    for task in os.listdir("/proc/self/task") if sys.platform == "linux" else ():  # noqa: PTH208
        try:
            with open(f"/proc/self/task/{task}/children") as children:  # noqa: PTH123
                pids = [int(pid) for pid in children.read().split()]
        except OSError:  # the thread has just ended
            continue
        for pid in pids:
            try:
                command = (
                    Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
                )
            except OSError:
                continue
            # A process without a command line is a zombie.
            if not any(name in command for name in _LASTING_PROCESSES):
                found[pid] = f"child process {pid} {command[:200] or '(ended, never waited for)'}"
    return found


def _files() -> dict[str, str]:
    [folder] = _private_temp_dir  # tests may replace tempfile.tempdir
    return {
        entry.name: f"temporary {'folder' if entry.is_dir() else 'file'} {entry.name}"
        for entry in folder.iterdir()
        if not entry.name.startswith(_LASTING_FILES)
    }


_Snapshot = Callable[[], dict[Any, str]]
_MODULE_SNAPSHOTS: tuple[_Snapshot, ...] = (_threads, _child_processes, _files, _timers.running)


def _destroy_deleted_widgets() -> None:
    if "PySide6.QtWidgets" not in sys.modules:
        return
    from PySide6.QtCore import QCoreApplication, QEvent

    if QCoreApplication.instance() is not None:
        QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)  # type: ignore[arg-type]


def _let_timers_fire() -> None:
    """Let single-shot timers of a shared console expire; repeating timers are leaks."""
    if "PySide6.QtCore" in sys.modules:
        from PySide6.QtCore import QCoreApplication

        if QCoreApplication.instance() is not None:
            QCoreApplication.processEvents()


def _new(snapshot: _Snapshot, before: dict[Any, str]) -> list[str]:
    return [what for key, what in snapshot().items() if key not in before]


_shared_in_module: set[int | str] = set()


def share_in_module(pid: int, folder: str) -> None:
    """Exempt a child process and its folder that a test creates for later tests of the file, which closes them."""
    _shared_in_module.update((pid, folder))


def _without_shared(snapshot: _Snapshot) -> _Snapshot:
    return lambda: {key: what for key, what in snapshot().items() if key not in _shared_in_module}


_FAILED = pytest.StashKey[bool]()


def record_failure(item: pytest.Item, report: pytest.TestReport) -> None:
    """Record a failure: the traceback of a failed test still references its objects."""
    item.stash[_FAILED] = item.stash.get(_FAILED, False) or report.failed


_TEST_SNAPSHOTS: tuple[_Snapshot, ...] = (
    _threads,
    _without_shared(_child_processes),
    _without_shared(_files),
    _timers.running,
)


def _check_leaks(snapshots: tuple[_Snapshot, ...], release: Callable[[], None] = lambda: None) -> Iterator[None]:
    _timers.watch()
    before = [snapshot() for snapshot in snapshots]
    yield
    release()
    _destroy_deleted_widgets()
    deadline_s = time.monotonic() + _GRACE_S
    left = [_new(snapshot, known) for snapshot, known in zip(snapshots, before, strict=True)]
    if any(left):
        # Objects in reference cycles are garbage, but not collected yet.
        gc.collect()
    while any(left) and time.monotonic() < deadline_s:
        time.sleep(_POLL_S)
        _let_timers_fire()
        left = [_new(snapshot, known) for snapshot, known in zip(snapshots, before, strict=True)]
    if any(left):
        pytest.fail("left behind: " + "; ".join(what for found in left for what in found), pytrace=False)


@pytest.fixture(autouse=True, scope="module")
def no_leaks_of_module() -> Iterator[None]:
    yield from _check_leaks(_MODULE_SNAPSHOTS)


@pytest.fixture(autouse=True)
def no_leaks(
    request: pytest.FixtureRequest,
    caplog: pytest.LogCaptureFixture,
    isolated_settings: Path,  # set up first: Qt writes the settings of a dialog there until the dialog is destroyed
    no_leaks_of_module: None,
) -> Iterator[None]:
    def release() -> None:
        request.node.funcargs.clear()
        for record in (*caplog.get_records("setup"), *caplog.get_records("call")):
            record.exc_info = None

    check = _check_leaks(_TEST_SNAPSHOTS, release)
    yield next(check)
    # The other fixtures are torn down; only pytest still holds their values.
    if not request.node.stash.get(_FAILED, False):
        next(check, None)


class _WarningCollector(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(f"{record.levelname} {record.name}: {record.getMessage()}")


@pytest.fixture(autouse=True)
def no_unexpected_warnings(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail on log records above INFO and Qt warnings that ``@pytest.mark.logs("pattern", ...)`` does not expect."""
    expected = [_OVERLOAD_MESSAGES]
    expected += [re.compile(pattern) for mark in request.node.iter_markers("logs") for pattern in mark.args]
    collector = _WarningCollector()
    logging.getLogger().addHandler(collector)
    qt_capture = getattr(request.node, "qt_log_capture", None)  # pytest-qt removes it before fixtures are torn down
    yield
    logging.getLogger().removeHandler(collector)
    messages = collector.messages + _qt_warnings(qt_capture)
    unexpected = [line for line in messages if not any(pattern.search(line) for pattern in expected)]
    if unexpected:
        pytest.fail("unexpected messages: " + "\n".join(unexpected), pytrace=False)


def _qt_warnings(capture: Any) -> list[str]:
    if capture is None:
        return []
    return [
        f"Qt: {record.message}" for record in capture.records if not record.ignored and record.matches_level("WARNING")
    ]
