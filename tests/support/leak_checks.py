"""What a test leaves behind fails that test: threads, timers, child processes, temporary files, words above INFO.

Each is looked for after every test against what was there before it, and once more after a file's shared fixtures.
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
"""What is on its way out may take this long on a full machine."""
_POLL_S = 0.02

# Said where the machine cannot keep up, which no test is about.
_OF_A_FULL_MACHINE = re.compile(r"The computer is too slow|did not end within \S+ s: killed")
# Threads of libraries that live as long as the process that used them.
_LASTING_THREADS = re.compile(r"ThreadPoolExecutor|asyncio_|tqdm|pytest|execnet|Dummy-|roslibpy-asyncio")
# Processes that multiprocessing starts once and keeps.
_LASTING_PROCESSES = ("multiprocessing.resource_tracker", "multiprocessing.forkserver")
_LASTING_FILES = ("pytest-of-", "pymp-", "run")


_private_folder: list[Path] = []


def use_private_folder() -> None:
    """Temporary files of this run, its children included, lie in a folder of its own, where what is left is seen."""
    os.environ["PYTEST_DEBUG_TEMPROOT"] = tempfile.gettempdir()
    # Short: the paths of sockets in it may have 107 characters.
    folder = Path(tempfile.mkdtemp(prefix="ct-"))
    tempfile.tempdir = os.environ["TMPDIR"] = str(folder)
    _private_folder.append(folder)
    # Where this is missing, sound libraries make a folder in TMPDIR for each process.
    runtime = folder / "run"
    runtime.mkdir(mode=0o700)
    os.environ["XDG_RUNTIME_DIR"] = str(runtime)
    # What a file's tests share begins before any of them has a home of its own.
    for name in ("XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_STATE_HOME", "XDG_DOCUMENTS_DIR"):
        os.environ[name] = str(folder / "run" / name.lower())
    # After multiprocessing, which keeps a folder of its own in it to the end, at -100.
    multiprocessing.util.Finalize(None, shutil.rmtree, (folder,), {"ignore_errors": True}, exitpriority=-200)


@dataclass
class _Timers:
    """Every QTimer that was started, with the line that did it."""

    started: "weakref.WeakKeyDictionary[Any, str]" = field(default_factory=weakref.WeakKeyDictionary)
    watching: bool = False

    def watch(self) -> None:
        """Once Qt is imported; what does not use Qt does not pay for it."""
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


def _children() -> dict[int, str]:
    """Of this process, from the kernel's own list: looking through all processes would cost each test 10 ms."""
    found = {}
    # By names: paths would take longer to make than these files to be read.
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
            # One without a command line has ended and was not waited for.
            if not any(name in command for name in _LASTING_PROCESSES):
                found[pid] = f"child process {pid} {command[:200] or '(ended, never waited for)'}"
    return found


def _files() -> dict[str, str]:
    [folder] = _private_folder  # not what a test may call the temporary folder
    return {
        entry.name: f"temporary {'folder' if entry.is_dir() else 'file'} {entry.name}"
        for entry in folder.iterdir()
        if not entry.name.startswith(_LASTING_FILES)
    }


_Look = Callable[[], dict[Any, str]]
_LOOKS_AFTER_FILE: tuple[_Look, ...] = (_threads, _children, _files, _timers.running)


def _destroy_deleted_widgets() -> None:
    if "PySide6.QtWidgets" not in sys.modules:
        return
    from PySide6.QtCore import QCoreApplication, QEvent

    if QCoreApplication.instance() is not None:
        QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)  # type: ignore[arg-type]


def _let_timers_fire() -> None:
    """What rings once, of a console that a file's tests share, is over by itself; what rings again is left behind."""
    if "PySide6.QtCore" in sys.modules:
        from PySide6.QtCore import QCoreApplication

        if QCoreApplication.instance() is not None:
            QCoreApplication.processEvents()


def _new(look: _Look, before: dict[Any, str]) -> list[str]:
    return [what for key, what in look().items() if key not in before]


_shared_in_file: set[int | str] = set()


def share_in_file(pid: int, folder: str) -> None:
    """A child process and its folder that one test made for those after it in its file, which ends it."""
    _shared_in_file.update((pid, folder))


def _own(look: _Look) -> _Look:
    return lambda: {key: what for key, what in look().items() if key not in _shared_in_file}


_FAILED = pytest.StashKey[bool]()


def remember_failure(item: pytest.Item, report: pytest.TestReport) -> None:
    """What failed is still held by its traceback, and has its message already."""
    item.stash[_FAILED] = item.stash.get(_FAILED, False) or report.failed


_LOOKS: tuple[_Look, ...] = (_threads, _own(_children), _own(_files), _timers.running)


def _nothing_stays(looks: tuple[_Look, ...], let_go: Callable[[], None] = lambda: None) -> Iterator[None]:
    _timers.watch()
    before = [look() for look in looks]
    yield
    let_go()
    _destroy_deleted_widgets()
    deadline_s = time.monotonic() + _GRACE_S
    left = [_new(look, known) for look, known in zip(looks, before, strict=True)]
    if any(left):
        # What a test let go of in a circle of references is not kept by anybody.
        gc.collect()
    while any(left) and time.monotonic() < deadline_s:
        time.sleep(_POLL_S)
        _let_timers_fire()
        left = [_new(look, known) for look, known in zip(looks, before, strict=True)]
    if any(left):
        pytest.fail("left behind: " + "; ".join(what for found in left for what in found), pytrace=False)


@pytest.fixture(autouse=True, scope="module")
def nothing_of_the_file_stays() -> Iterator[None]:
    yield from _nothing_stays(_LOOKS_AFTER_FILE)


@pytest.fixture(autouse=True)
def nothing_stays(
    request: pytest.FixtureRequest,
    caplog: pytest.LogCaptureFixture,
    own_settings: Path,  # begun before and ended after: Qt keeps what a dialog remembers in it until that is destroyed
    nothing_of_the_file_stays: None,
) -> Iterator[None]:
    def let_go() -> None:
        request.node.funcargs.clear()
        for record in (*caplog.get_records("setup"), *caplog.get_records("call")):
            record.exc_info = None

    look = _nothing_stays(_LOOKS, let_go)
    yield next(look)
    # The fixtures have ended, and only pytest still holds what they gave.
    if not request.node.stash.get(_FAILED, False):
        next(look, None)


class _Words(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.said: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.said.append(f"{record.levelname} {record.name}: {record.getMessage()}")


@pytest.fixture(autouse=True)
def no_unexpected_words(request: pytest.FixtureRequest) -> Iterator[None]:
    """No log line above INFO and no warning of Qt but those that ``@pytest.mark.logs("pattern", ...)`` expects."""
    expected = [_OF_A_FULL_MACHINE]
    expected += [re.compile(pattern) for mark in request.node.iter_markers("logs") for pattern in mark.args]
    words = _Words()
    logging.getLogger().addHandler(words)
    said_by_qt = getattr(request.node, "qt_log_capture", None)  # pytest-qt takes it away before a fixture ends
    yield
    logging.getLogger().removeHandler(words)
    said = words.said + _said_by_qt(said_by_qt)
    unexpected = [line for line in said if not any(pattern.search(line) for pattern in expected)]
    if unexpected:
        pytest.fail("said unexpectedly: " + "\n".join(unexpected), pytrace=False)


def _said_by_qt(capture: Any) -> list[str]:
    if capture is None:
        return []
    return [
        f"Qt: {record.message}" for record in capture.records if not record.ignored and record.matches_level("WARNING")
    ]
