"""Microphone of a served camera over WebRTC, for clients that request audio."""

import asyncio
import contextlib
import fractions
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

RATE_HZ = 48_000
PIECE = 960
"""Samples of one packet, 20 ms."""
_MOST_PIECES = 10
Take = Callable[[NDArray[np.int16]], None]


class SoundSource(Protocol):
    """Delivers chunks of ``PIECE`` samples of one channel, shape (PIECE,), at ``RATE_HZ``, in any thread."""

    def begin(self, take: Take) -> None:
        """Start. Raises OSError without audio input."""

    def end(self) -> None: ...


class LocalSound:
    """Audio input of this computer, by a part of its name; empty: the system default."""

    def __init__(self, name: str) -> None:
        self._name = name or None
        self._stream: Any = None

    def begin(self, take: Take) -> None:
        try:
            import sounddevice

            self._stream = sounddevice.InputStream(
                samplerate=RATE_HZ, channels=1, dtype="int16", device=self._name, blocksize=PIECE,
                callback=lambda samples, _frames, _times, _status: take(samples[:, 0].copy()),
            )  # fmt: skip
            self._stream.start()
        except Exception as error:
            # PortAudio raises its own types, and ValueError for a missing device.
            raise OSError(" ".join(str(error).split()) or type(error).__name__) from error

    def end(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            with contextlib.suppress(Exception):
                stream.abort()
                stream.close()


class ServedSound:
    """One source for all clients, open only while there is one. In one event loop."""

    def __init__(self, source: SoundSource) -> None:
        self._source = source
        self._listeners: set[_Listener] = set()
        self._loop: asyncio.AbstractEventLoop | None = None

    def track(self) -> Any:
        """Audio track for one client. Raises OSError without audio input."""
        self._loop = asyncio.get_running_loop()
        if not self._listeners:
            self._source.begin(self._take)
        listener = _Listener()
        self._listeners.add(listener)
        return _track(listener, lambda: self._leave(listener))

    def _leave(self, listener: "_Listener") -> None:
        if listener in self._listeners:
            self._listeners.discard(listener)
            if not self._listeners:
                self._source.end()

    def _take(self, samples: NDArray[np.int16]) -> None:  # the source's thread
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the event loop has ended
                self._loop.call_soon_threadsafe(self._give, samples)

    def _give(self, samples: NDArray[np.int16]) -> None:
        for listener in self._listeners:
            listener.add(samples)


class _Listener:
    """Numbered chunks for one client; the oldest are dropped if it is slow."""

    def __init__(self) -> None:
        self._number = 0
        self._pieces: deque[tuple[int, NDArray[np.int16]]] = deque(maxlen=_MOST_PIECES)
        self._came = asyncio.Event()

    def add(self, samples: NDArray[np.int16]) -> None:
        self._pieces.append((self._number, samples))
        self._number += 1
        self._came.set()

    async def next(self) -> tuple[int, NDArray[np.int16]]:
        while not self._pieces:
            self._came.clear()
            await self._came.wait()
        return self._pieces.popleft()


def _track(listener: _Listener, ended: Callable[[], None]) -> Any:
    import aiortc
    import av

    class MicrophoneTrack(aiortc.MediaStreamTrack):  # type: ignore[misc]
        """Audio track; dropped chunks leave gaps in the frame times."""

        kind = "audio"

        async def recv(self) -> Any:
            number, samples = await listener.next()
            frame = av.AudioFrame.from_ndarray(samples[None, :], format="s16", layout="mono")
            frame.sample_rate = RATE_HZ
            frame.pts = number * PIECE
            frame.time_base = fractions.Fraction(1, RATE_HZ)
            return frame

        def stop(self) -> None:
            super().stop()
            ended()

    return MicrophoneTrack()
