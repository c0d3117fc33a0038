"""What is heard and played, on its way to the recogniser: nobody waits for it, and it never comes late."""

import threading
from collections import deque
from collections.abc import Callable

from caris_desktop.domain import clock
from caris_desktop.domain.events import Gap
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.live.child_process import ChildProcess

STREAM = "transcription"
_PIECES_AT_MOST = 20
"""Two seconds of sound: words that come later than that are of no use to anybody."""


class ListeningFeed:
    """Any thread puts, one thread writes. Where the recogniser does not keep up, sound is left out and a ``Gap`` tells
    how much; all else waits.
    """

    def __init__(self, recogniser: ChildProcess, tell: Callable[[Gap], None]) -> None:
        self._recogniser = recogniser
        self._tell = tell
        self._queue: deque[tuple[bytes, bool]] = deque()
        self._pieces = self._left_out = 0
        self._ended = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._write, name="listening-feed", daemon=True)
        self._thread.start()

    def put(self, raw: bytes, *, sound: bool = False) -> None:
        """A pickled message; ``sound`` may be left out."""
        with self._changed:
            if sound and self._pieces >= _PIECES_AT_MOST:
                self._left_out += 1
                return
            self._pieces += sound
            self._queue.append((raw, sound))
            self._changed.notify()

    def end(self) -> None:
        """Write nothing more. The recogniser has been asked to end before, so that nothing is waited for."""
        with self._changed:
            self._ended = True
            self._changed.notify()

    def join(self) -> None:
        """Wait for the thread, which ends with the recogniser."""
        self._thread.join(2.0)

    def _write(self) -> None:
        while True:
            with self._changed:
                while not self._queue and not self._ended:
                    self._changed.wait()
                if self._ended:
                    return
                raw, sound = self._queue.popleft()
                self._pieces -= sound
                left_out = self._left_out if self._pieces <= _PIECES_AT_MOST // 2 else 0
                self._left_out -= left_out
            if left_out:
                self._tell(Gap(clock.now_ns(), STREAM, left_out, QT_TR_NOOP("speech recognition did not keep up")))
            if not self._recogniser.send_raw_waiting(raw):
                return
