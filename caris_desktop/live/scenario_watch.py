"""File watcher of the scenario: detects a change by another program, once writing has finished."""

import hashlib
from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import QObject, QTimer

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.live.background_worker import BackgroundWorker

LOOK_EVERY_MS = 1000
AT_REST_MS = 250

Touched = tuple[int, int, int]
"""modification time in ns, size, inode"""


class ScenarioWatch(QObject):
    """Calls ``changed(path)`` once per new content of the file. GUI thread; files are read in the background.

    Polls the file once a second instead of using notifications: cheap, works on network drives and with editors that
    replace the file, and QFileSystemWatcher was seen to hang and crash the program. A change counts if it is the same
    twice, so that a file being written is left alone. The program's own writes are announced by :meth:`use`, in the
    order of background work.
    """

    def __init__(
        self, slow_work: BackgroundWorker, changed: Callable[[Path], None], parent: QObject | None = None
    ) -> None:
        super().__init__(parent)
        self._slow_work = slow_work
        self._changed = changed
        self._path: Path | None = None
        self._known = ""
        self._seen = ""
        self._touched: Touched | None = None
        self._asking = False
        self._clock = QTimer(self, interval=LOOK_EVERY_MS)
        self._clock.timeout.connect(self._ask)
        self._rest = QTimer(self, singleShot=True, interval=AT_REST_MS)
        self._rest.timeout.connect(self.check_contents)

    def start(self) -> None:
        self._clock.start()

    def stop(self) -> None:
        self._clock.stop()
        self._rest.stop()

    def use(self, path: Path | None, sha256: str) -> None:
        """Watch this file, with this checksum."""
        if path != self._path:
            self._touched = None
        self._path, self._known, self._seen = path, sha256, ""

    def check_contents(self) -> None:
        """Check the contents now."""
        path = self._path
        if path is None:
            return

        def looked(sha256: str) -> None:
            if path == self._path:
                self._on_looked(path, sha256)

        self._slow_work.do(lambda: _checksum(path), looked, lambda _failure: None)

    def _ask(self) -> None:
        path = self._path
        if path is None or self._asking:
            return  # an unresponsive disk is queried once
        self._asking = True

        def on_answer(touched: Touched | None) -> None:
            self._asking = False
            if path == self._path and touched != self._touched:
                self._touched = touched
                self._rest.start()

        def failed(_failure: UserFacingError) -> None:
            self._asking = False

        self._slow_work.do(lambda: _touched(path), on_answer, failed)

    def _on_looked(self, path: Path, sha256: str) -> None:
        if sha256 in ("", self._known):
            self._seen = ""  # temporarily missing, or unchanged
        elif sha256 != self._seen:
            self._seen = sha256
            if self._clock.isActive():
                self._rest.start()
        else:
            self._known, self._seen = sha256, ""
            self._changed(path)


def _touched(path: Path) -> Touched | None:
    """File metadata; None if the file is missing."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino


def _checksum(path: Path) -> str:
    """Checksum; empty if the file is missing."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""
