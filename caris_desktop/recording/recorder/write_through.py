"""Periodic fsync of recorded files in a thread, against data loss by a power failure."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

from caris_desktop.domain.file_replacement import bring_to_disk, no_room
from caris_desktop.recording.disk_file import DiskFile

_log = logging.getLogger(__name__)
_REMEMBER_S = 30.0


class FsyncThread:
    """Sync thread. A round begins on request, or ``every_s`` after the start of the last one."""

    def __init__(self, name: str, files: Callable[[], Iterable[DiskFile]], *, every_s: float) -> None:
        self._files = files
        self._every_s = every_s
        self._paths: deque[Path] = deque()
        self._rounds: deque[tuple[float, float]] = deque()
        self._began_s: float | None = None
        self._failed = False
        self.disk_full = False
        self._due = threading.Event()
        self._ended = False
        self._thread = threading.Thread(target=self._run, name=f"sync-{name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def ask(self) -> None:
        """Request a round soon."""
        self._due.set()

    def note(self, path: Path) -> None:
        """Note a replaced file: it and its folder entry are synced."""
        self._paths.append(path)

    def delays_s(self, now_s: float, *, within_s: float) -> list[float]:
        """Durations of the rounds within ``within_s`` (``time.monotonic``), or of the slowest write before each, and
        the elapsed time of the present one.
        """
        began_s = self._began_s
        going_s = 0.0 if began_s is None else now_s - began_s
        return [going_s, *(took_s for at_s, took_s in tuple(self._rounds) if now_s - at_s <= within_s)]

    def close(self, *, timeout_s: float) -> None:
        """End after a last round; a round that the disk does not finish is abandoned."""
        self._ended = True
        self._due.set()
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
            if self._thread.is_alive():
                _log.error("the disk has not confirmed within %.0f s what was written", timeout_s)

    def sync_now(self) -> None:
        """Run one round now."""
        paths = {self._paths.popleft() for _ in range(len(self._paths))}
        folders = {path.parent for path in paths}
        paths_in_order = (*sorted(paths), *sorted(folders))
        whole: list[Callable[[], object]] = [partial(bring_to_disk, path) for path in paths_in_order]
        for sync in [*(file.sync for file in self._files()), *whole]:
            try:
                sync()
            except FileNotFoundError:
                # Replaced by a newer file, which is noted too.
                continue
            except OSError as error:
                self.disk_full = self.disk_full or no_room(error)
                if not self._failed:
                    _log.exception("the disk did not confirm what was written")
                self._failed = True

    def _run(self) -> None:
        ended = False
        while not ended:
            self._due.wait(self._every_s)
            self._due.clear()
            ended = self._ended
            self._began_s = time.monotonic()
            self.sync_now()
            took_s = time.monotonic() - self._began_s
            self._began_s = None
            slowest_s = max([took_s, *(file.take_slowest_write_s() for file in self._files())])
            self._rounds.append((time.monotonic(), slowest_s))
            while self._rounds[0][0] < time.monotonic() - _REMEMBER_S:
                self._rounds.popleft()
