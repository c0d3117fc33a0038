"""Feed of heard and played audio to the speech recogniser: never blocks, and never delivers late."""

import threading
from collections import deque
from collections.abc import Callable

from caris_desktop.domain import clock
from caris_desktop.domain.events import Gap
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.live.child_process import ChildProcess

STREAM = "transcription"
_PIECES_AT_MOST = 20
"""Two seconds of audio: later words would be useless."""


class ListeningFeed:
    """Queue with one writer thread. If the recogniser is too slow, audio is dropped and counted in a ``Gap``; other
    messages wait.
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
        """Queue a pickled message; ``sound`` may be dropped. Any thread."""
        with self._changed:
            if sound and self._pieces >= _PIECES_AT_MOST:
                self._left_out += 1
                return
            self._pieces += sound
            self._queue.append((raw, sound))
            self._changed.notify()

    def end(self) -> None:
        """Stop writing. The recogniser was asked to end before, so that nothing blocks."""
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
                self._tell(Gap(clock.now_ns(), STREAM, left_out, QT_TR_NOOP("speech recognition could not keep up")))
            if not self._recogniser.send_raw_waiting(raw):
                return
