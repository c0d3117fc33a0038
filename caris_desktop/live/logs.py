"""Log file shared by the console and its child processes."""

import contextlib
import logging
import os
import sys
import threading
from pathlib import Path
from types import TracebackType

import platformdirs

from caris_desktop.domain.foreign_text import printable

_ENVIRONMENT_KEY = "CARIS_LOG_FILE"
_FORMAT = "%(asctime)s.%(msecs)03d %(levelname)-7s {who} %(name)s: %(message)s"
_MAX_BYTES = 5_000_000


def log_file() -> Path:
    """Log file of this user."""
    return Path(platformdirs.user_log_dir("caris-desktop", appauthor=False)) / "console.log"


def configure_logging(path: Path, *, verbose: bool = False, terminal: bool = True) -> None:
    """Log to ``path`` (rotated to ``.1`` when large), and warnings to stderr.

    Without ``terminal``, stderr is reserved for a command's output. A log that cannot be written must not prevent the
    start: stderr then gets everything.
    """
    stderr = logging.StreamHandler(sys.stderr)
    stderr.setLevel(logging.INFO if verbose else logging.WARNING)
    handlers: list[logging.Handler] = [stderr] if terminal else []
    # A full disk must not flood the terminal.
    logging.raiseExceptions = terminal
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and path.stat().st_size > _MAX_BYTES:
            path.replace(path.with_suffix(path.suffix + ".1"))
        handlers.append(logging.FileHandler(path, encoding="utf-8"))
        os.environ[_ENVIRONMENT_KEY] = str(path)
    except OSError as error:
        os.environ.pop(_ENVIRONMENT_KEY, None)
        print(f"The log {path} cannot be written ({error}); details are shown in this terminal only.", file=sys.stderr)
        handlers = [stderr]
    _install(handlers, "console")

    def report(kind: type[BaseException], value: BaseException, trace: TracebackType | None) -> None:
        logging.getLogger("caris_desktop").critical("unhandled error", exc_info=(kind, value, trace))
        if not terminal and issubclass(kind, Exception):
            why = printable(str(value))
            print(f"The command failed unexpectedly ({kind.__name__}: {why}). Log: {path}", file=sys.stderr)

    sys.excepthook = report
    threading.excepthook = lambda failure: logging.getLogger("caris_desktop").critical(
        "unhandled error in thread %s", failure.thread.name if failure.thread else "?", exc_info=failure.exc_value
    )


def configure_child_logging(name: str) -> None:
    """Log to the same file from a child process; appends of short lines are sufficiently atomic.

    A log that has been deleted or locked since must not keep a process, such as a robot link, from starting.
    """
    handlers: list[logging.Handler] = []
    if path := os.environ.get(_ENVIRONMENT_KEY):
        with contextlib.suppress(OSError):
            handlers.append(logging.FileHandler(path, encoding="utf-8"))
    stderr = logging.StreamHandler(sys.stderr)
    stderr.setLevel(logging.ERROR)
    _install([*handlers, stderr], name)


class _PrintableFormatter(logging.Formatter):
    """Formatter whose texts, which may come from others, add no lines and do not control a terminal."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - the name that logging calls
        return printable(super().formatMessage(record))

    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record), lines=True)


def _install(handlers: list[logging.Handler], who: str) -> None:
    root = logging.getLogger()
    for old in root.handlers[:]:
        root.removeHandler(old)
    for handler in handlers:
        handler.setFormatter(_PrintableFormatter(_FORMAT.replace("{who}", who), datefmt="%Y-%m-%d %H:%M:%S"))
        root.addHandler(handler)
    root.setLevel(logging.INFO)
    logging.getLogger("httpx").setLevel(logging.WARNING)
