"""Feed of all events and values to the recorder process: queue bounded in bytes, before any conflation."""

import logging
import pickle
import threading
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from caris_desktop.domain import clock
from caris_desktop.domain.events import Gap, UtteranceChanged
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.streams import BY_TYPE, Delivery
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.live.child_process import ChildProcess

_log = logging.getLogger(__name__)
# Prefix of a timestamp before a pickle, which begins with another byte: eight bytes of the session clock follow.
ARRIVED = b"T"
MAX_QUEUED_BYTES = 64 * 1024 * 1024
VERDICTS_WITHIN_S = 6.0
"""Maximum wait at the end of a session for transcripts of earlier turns: a pass of the recogniser on a busy machine
takes 2 to 4 s.
"""


class RecorderFeed:
    """Queue from any thread to one writer thread, with arrival times.

    If the recorder falls behind by ``max_bytes``, state values and frames are dropped and counted; events are still
    queued. The count follows in a ``Gap`` event once there is room.

    A heard turn is announced at its start, with speaker and transcript later. At the end of a recording, and in a
    pause, these still pass for earlier turns; the end waits for them up to ``verdicts_within_s``.
    """

    def __init__(
        self, recorder: ChildProcess, *, max_bytes: int = MAX_QUEUED_BYTES, verdicts_within_s: float = VERDICTS_WITHIN_S
    ) -> None:
        self._recorder = recorder
        self._max_bytes = max_bytes
        self._verdicts_within_s = verdicts_within_s
        self._open_turns: set[str] = set()
        self._nothing_since_ns = 0
        self._stop: Any = None
        self._stop_ns = 0
        self._stop_by_s = 0.0
        self._queue: deque[bytes] = deque()
        self._queued_bytes = 0
        self._dropped: dict[str, int] = {}
        self._recording = False
        self._paused = False
        self._ended = False
        self._latched: dict[str, bytes] = {}
        self._held: list[bytes] | None = None
        self._held_ns = 0
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._write, name="recorder-feed", daemon=True)
        self._thread.start()

    def put(self, value: Any, raw: bytes | None = None) -> None:
        """Queue a value; ``raw`` is its pickled form if available."""
        spec = BY_TYPE[type(value)]
        if isinstance(value, UtteranceChanged) and value.origin == "heard":
            self._put_utterance(value, raw)
            return
        if not (self._recording or spec.latched):
            return
        if raw is None:
            raw = pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)
        with self._changed:
            if spec.latched:
                self._latched[spec.key_of(value)] = raw
            if not self._recording or self._paused:
                return
            if spec.delivery is not Delivery.LOSSLESS and self._queued_bytes + len(raw) > self._max_bytes:
                name = "audio" if isinstance(value, AudioChunk) else spec.name
                self._dropped[name] = self._dropped.get(name, 0) + 1
                return
            self._append(raw)

    def _put_utterance(self, turn: UtteranceChanged, raw: bytes | None) -> None:
        with self._changed:
            known = turn.utterance_id in self._open_turns
            over = turn.state not in ("requested", "started")
            if self._recording and not self._paused:
                if not over:
                    self._open_turns.add(turn.utterance_id)
            elif not known:
                return
            elif turn.stamp_ns > self._nothing_since_ns:
                turn, raw = replace(turn, stamp_ns=self._nothing_since_ns), None
            self._append(pickle.dumps(turn, protocol=pickle.HIGHEST_PROTOCOL) if raw is None else raw)
            if over:
                self._open_turns.discard(turn.utterance_id)
                if not self._open_turns:
                    self._send_stop()

    def start(self, message: Any, *events: Any) -> None:
        """Begin a recording: ``message`` first, then the latched values, then everything queued."""
        with self._changed:
            self.hold(*events)
            self.begin(message)

    @property
    def records(self) -> bool:
        """Whether a recording is running, possibly paused."""
        return self._recording

    @property
    def holds(self) -> bool:
        """Whether values are held until ``begin``."""
        return self._held is not None

    def hold(self, *events: Any) -> None:
        """Hold values for a recording about to begin, after the latched values and ``events``."""
        with self._changed:
            self._send_stop()
            self._open_turns.clear()
            self._recording, self._paused = True, False
            self._held, self._held_ns = [], clock.now_ns()
            self._append_all(*events)

    def begin(self, message: Any) -> None:
        """Send ``message`` with the time of ``hold``, then all held values."""
        with self._changed:
            held, self._held = self._held or [], None
            self._append(pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL), arrived_ns=self._held_ns)
            self._queue.extend(held)

    def drop(self) -> None:
        """Discard held values: the recording does not begin."""
        with self._changed:
            self._recording = False
            self._open_turns.clear()
            self._queued_bytes -= sum(map(len, self._held or []))
            self._held = None

    def pause(self, message: Any, *events: Any, paused: bool) -> None:
        """Pause or resume; resuming sends ``message``, the latched values and ``events``."""
        with self._changed:
            if not self._recording or self._paused == paused:
                return
            self._paused = paused
            if paused:
                self._nothing_since_ns = clock.now_ns()
                self._append_gaps()
                self._append(pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL))
            else:
                self._append(pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL))
                self._append_all(*events)

    def forget_streams(self, names: Iterable[str]) -> None:
        """Drop latched values of these streams of a lost link or robot."""
        with self._changed:
            forgotten = {f"/{name}" for name in names}
            self._latched = {key: raw for key, raw in self._latched.items() if f"/{key.split('/')[1]}" not in forgotten}

    def stop(self, message: Any) -> None:
        """End the recording: queued values and pending transcripts are still written; then ``message``, with the
        current time.
        """
        with self._changed:
            if self._recording and not self._paused:
                self._nothing_since_ns = clock.now_ns()
                self._append_gaps()
            self._recording = False
            self._stop, self._stop_by_s = message, time.monotonic() + self._verdicts_within_s
            self._stop_ns = clock.now_ns()
            if self._open_turns:
                self._changed.notify()  # limits the thread's wait
            else:
                self._send_stop()

    def _send_stop(self) -> None:
        message, self._stop = self._stop, None
        if message is not None:
            self._open_turns.clear()
            self._append(pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL), arrived_ns=self._stop_ns)

    def end(self) -> None:
        """The recorder has ended the session: record nothing more."""
        with self._changed:
            self._recording = False
            self._stop = None
            self._open_turns.clear()

    def use_recorder(self, recorder: ChildProcess) -> None:
        """Switch to a new recorder process. The session of the former one is lost; queued values are dropped, except
        those held for a session that it had not started.
        """
        with self._changed:
            self._recorder = recorder
            self._recording = self.holds
            self._stop = None
            self._forget()

    def request(self, message: Any) -> None:
        """Send a request to the recorder, such as a photo, ahead of a recording about to begin."""
        with self._changed:
            held, self._held = self._held, None
            self._append(pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL))
            self._held = held

    def close(self, *, timeout_s: float = 30.0) -> None:
        """Write the queue, which may be long with a slow disk, and end the thread."""
        with self._changed:
            self._send_stop()
            self._ended = True
            self._recording = False
            self._changed.notify()
        self._thread.join(timeout_s)

    def _append_all(self, *events: Any) -> None:
        for raw in self._latched.values():
            self._append(raw)
        for event in events:
            self._append(pickle.dumps(event, protocol=pickle.HIGHEST_PROTOCOL))

    def _append_gaps(self) -> None:
        for stream, count in self._dropped.items():
            gap = Gap(clock.now_ns(), stream, count, QT_TR_NOOP("the recorder could not keep up"))
            self._append(pickle.dumps(gap, protocol=pickle.HIGHEST_PROTOCOL))
        self._dropped.clear()

    def _append(self, raw: bytes, *, arrived_ns: int | None = None) -> None:
        arrived_ns = clock.now_ns() if arrived_ns is None else arrived_ns
        raw = ARRIVED + arrived_ns.to_bytes(8, "little", signed=True) + raw
        (self._queue if self._held is None else self._held).append(raw)
        self._queued_bytes += len(raw)
        self._changed.notify()

    def _write(self) -> None:
        while True:
            with self._changed:
                while not self._queue and not self._ended:
                    left_s = None if self._stop is None else self._stop_by_s - time.monotonic()
                    if left_s is not None and left_s <= 0:
                        self._send_stop()
                    else:
                        self._changed.wait(left_s)
                if not self._queue:
                    return
                recorder = self._recorder
                raw = self._queue.popleft()
                self._queued_bytes -= len(raw)
                if self._queued_bytes < self._max_bytes // 2:
                    self._append_gaps()
            if not recorder.send_raw_waiting(raw):
                with self._changed:
                    if recorder is self._recorder:
                        _log.error("the recorder is gone: %d values were not handed over", len(self._queue) + 1)
                        self._recording = self.holds
                        self._forget()
                    if self._ended:
                        return

    def _forget(self) -> None:
        self._queue.clear()
        self._queued_bytes = sum(map(len, self._held or []))
        self._dropped.clear()
