"""WebRTC camera, by WHEP or by a plain HTTP offer (JSON with ``sdp`` and ``type``, answered alike)."""

import asyncio
import bisect
import contextlib
import json
import logging
import urllib.parse
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import clock
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.sound_values import SoundClock
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.perception.cameras.camera_source import (
    SILENCE_S,
    SOUND_RATE_HZ,
    CameraError,
    ChosenCamera,
    Picture,
    stopped_sending,
)
from caris_desktop.perception.cameras.http_camera import CLOCK_HEADER, CameraConnection, ServedClock
from caris_desktop.perception.cameras.stream_camera import bgr_of

_FIRST_PICTURE_S = 10.0
_STAMPS_EVERY_NS = 500_000_000
# aiortc buffers four audio packets of 20 ms to restore their order.
_BUFFERED_NS = 80_000_000
_ROUNDED_TICKS = 9  # 0.1 ms
_log = logging.getLogger(__name__)


class WebRtcCamera:
    """WebRTC source; its event loop runs while an image is awaited."""

    fps: float | None = None

    def __init__(self, chosen: ChosenCamera) -> None:
        """Raises CameraError."""
        try:
            import aiortc
        except ImportError as error:
            raise CameraError(
                QT_TR_NOOP("WebRTC cameras need the package aiortc."), QT_TR_NOOP("Install it: pip install aiortc")
            ) from error
        logging.getLogger("aioice").setLevel(logging.WARNING)  # it logs every packet
        self._chosen = chosen
        self._parts = urllib.parse.urlsplit(chosen.target)
        self._resource = ""
        self._clock: ServedClock | None = None
        self._stamps_requested_ns = 0
        self._moments = CaptureMoments()
        self._newest: Any = None
        self._came = asyncio.Event()
        self.on_sound: Callable[[int, NDArray[np.int16]], None] = lambda _stamp_ns, _samples: None
        self._reading: asyncio.Task[None] | None = None
        self._listening: asyncio.Task[None] | None = None
        self._loop = asyncio.new_event_loop()
        # Without external STUN or TURN servers: the camera is in the same network.
        self._connection = aiortc.RTCPeerConnection(aiortc.RTCConfiguration(iceServers=[]))
        self._connection.on("track", self._on_track)
        try:
            self._loop.run_until_complete(self._connect())
            self._first: Any = self._next(_FIRST_PICTURE_S)
        except CameraError:
            self.close()
            raise
        self.width_px, self.height_px = self._first.width, self._first.height

    def read(self) -> Picture | None:
        frame = self._first if self._first is not None else self._next(SILENCE_S)
        self._first = None
        moment = self._capture_time(frame)
        image_bgr = bgr_of(frame)
        if moment is None:
            return Picture(image_bgr)
        return Picture(image_bgr, taken_ns=moment[0], taken_uncertainty_ns=moment[1])

    def close(self) -> None:
        if self._resource:
            with contextlib.suppress(CameraError), CameraConnection(self._chosen) as connection:
                connection.ask("DELETE", self._resource)
        if self._clock is not None:
            self._clock.close()
        self._loop.run_until_complete(self._end())
        self._loop.close()

    async def _end(self) -> None:
        for task in (self._reading, self._listening):
            if task is not None:
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)
        await self._connection.close()

    async def _connect(self) -> None:
        import aiortc

        self._connection.addTransceiver("video", direction="recvonly")
        if self._chosen.sound:
            self._connection.addTransceiver("audio", direction="recvonly")
        await self._connection.setLocalDescription(await self._connection.createOffer())
        sdp = self._connection.localDescription.sdp
        plain = self._chosen.kind == "webrtc"
        body = json.dumps({"sdp": sdp, "type": "offer"}) if plain else sdp
        kind = "application/json" if plain else "application/sdp"
        with CameraConnection(self._chosen) as connection:
            response, content = connection.ask("POST", body=body.encode(), head={"Content-Type": kind})
        if response.status not in (200, 201):
            raise self._refused(response.status, content)
        try:
            answer = parse_json(content)["sdp"] if plain else content.decode()
            description = aiortc.RTCSessionDescription(sdp=str(answer), type="answer")
            await self._connection.setRemoteDescription(description)
        except Exception as error:
            # aiortc raises many kinds of errors for an unusable answer.
            raise CameraError(
                localized(
                    QT_TR_NOOP("The camera at {name} did not return a valid WebRTC answer."), name=self._chosen.name
                ),
                QT_TR_NOOP("Check the address: it must be the one for WHEP or for WebRTC offers."),
            ) from error
        location = urllib.parse.urljoin(self._chosen.target, response.headers.get("Location", ""))
        if response.headers.get("Location") and urllib.parse.urlsplit(location).netloc == self._parts.netloc:
            self._resource = urllib.parse.urlsplit(location).path
            clock_path = response.headers.get(CLOCK_HEADER, "")
            if clock_path.startswith("/"):
                self._clock = ServedClock(self._chosen, clock_path)

    def _refused(self, status: int, content: bytes) -> CameraError:
        if status in (401, 403):
            return CameraError(
                localized(QT_TR_NOOP("The camera at {name} rejected the token."), name=self._chosen.name),
                QT_TR_NOOP(
                    "Set the environment variable named in its address (#token-env=NAME) to the token that "
                    "the camera server was started with."
                ),
            )
        body_text = content[:200].decode("utf-8", "replace").strip()
        return CameraError(
            localized(
                QT_TR_NOOP("The camera at {name} refused the connection ({status} {said})."),
                name=self._chosen.name,
                status=status,
                said=body_text,
            ),
            QT_TR_NOOP("Check the camera address."),
        )

    def _on_track(self, track: Any) -> None:
        if track.kind == "audio":
            if self._chosen.sound and self._listening is None:
                self._listening = self._loop.create_task(self._receive_sound(track))
        elif self._reading is None:
            self._reading = self._loop.create_task(self._read_all(track))

    async def _receive_sound(self, track: Any) -> None:
        import av
        from aiortc.mediastreams import MediaStreamError

        resampler = av.AudioResampler("s16", "mono", SOUND_RATE_HZ)
        sound_clock = SoundClock()
        with contextlib.suppress(MediaStreamError):
            while True:
                for part in resampler.resample(await track.recv()):
                    samples = part.to_ndarray().reshape(-1, 1)
                    length_ns = len(samples) * 1_000_000_000 // SOUND_RATE_HZ
                    arrival_ns = clock.now_ns() - _BUFFERED_NS
                    stamp_ns, _missing_ns = sound_clock.stamp(arrival_ns=arrival_ns, length_ns=length_ns)
                    self.on_sound(stamp_ns, samples)

    async def _read_all(self, track: Any) -> None:
        """Receive all frames, retaining the newest."""
        from aiortc.mediastreams import MediaStreamError

        with contextlib.suppress(MediaStreamError):
            while True:
                self._newest = await track.recv()
                self._moments.note(self._newest.pts)
                self._came.set()
        self._newest = None
        self._came.set()

    def _next(self, within_s: float) -> Any:
        async def wait() -> Any:
            await asyncio.wait_for(self._came.wait(), within_s)
            self._came.clear()
            return self._newest

        try:
            frame = self._loop.run_until_complete(wait())
        except TimeoutError:
            frame = None
        if frame is None:
            raise stopped_sending(self._chosen.name)
        return frame

    def _capture_time(self, frame: Any) -> tuple[int, int] | None:
        if self._clock is None:
            return None
        now_ns = clock.now_ns()
        if not self._moments.known and now_ns - self._stamps_requested_ns >= _STAMPS_EVERY_NS:
            self._stamps_requested_ns = now_ns
            try:
                with CameraConnection(self._chosen) as connection:
                    self._moments.match(parse_json(connection.ask("GET", f"{self._resource}/stamps")[1]))
            except (CameraError, ValueError, TypeError):
                _log.info("when %s took its pictures was not told", self._chosen.name, exc_info=True)
        far_ns = self._moments.captured_ns(frame.pts)
        return None if far_ns is None else self._clock.here(far_ns)


class CaptureMoments:
    """Mapping of RTP times to capture times of the remote clock.

    Frame times count from an unknown origin. The server lists the capture times of recent frames; only one origin
    matches the intervals between the received frames.
    """

    def __init__(self) -> None:
        self._recent: deque[int] = deque(maxlen=8)
        self._beginning: int | None = None

    @property
    def known(self) -> bool:
        return self._beginning is not None

    def note(self, pts: int) -> None:
        self._recent.append(pts)

    def match(self, reported_ticks: Sequence[int]) -> None:
        """Match the server's list of capture times."""
        if len(self._recent) < 4:
            return
        in_order = sorted(reported_ticks)
        beginnings = [tick - self._recent[-1] for tick in in_order]
        fitting = [begun for begun in beginnings if all(_holds(in_order, begun + pts) for pts in self._recent)]
        if len(fitting) == 1:
            self._beginning = fitting[0]

    def captured_ns(self, pts: int) -> int | None:
        return None if self._beginning is None else (self._beginning + pts) * 100_000 // 9


def _holds(ticks: Sequence[int], tick: int) -> bool:
    """True if one of the times equals ``tick`` within rounding."""
    at = bisect.bisect_left(ticks, tick - _ROUNDED_TICKS)
    return at < len(ticks) and ticks[at] <= tick + _ROUNDED_TICKS
