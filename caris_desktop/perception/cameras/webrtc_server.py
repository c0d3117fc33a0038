"""WebRTC server of a camera's newest frame, and its audio on request, by aiortc."""

import asyncio
import fractions
import logging
import secrets
from collections import deque
from typing import Any

from caris_desktop.perception.cameras.newest_frame import NewestFrame
from caris_desktop.perception.cameras.served_sound import ServedSound

_log = logging.getLogger(__name__)

MOST_CONNECTIONS = 4
"""Each encodes for itself, which costs the small computer on a robot about half a core."""
CLOCK_RATE_HZ = 90_000
_STAMPS_KEPT = 300


class WebRtcError(Exception):
    """Failed connection; ``status`` is the HTTP status."""

    def __init__(self, status: int, what: str) -> None:
        super().__init__(what)
        self.status = status


class WebRtcServer:
    """One connection for each client. In one event loop."""

    def __init__(self, frames: NewestFrame, sound: ServedSound | None = None) -> None:
        self._frames = frames
        self._sound = sound
        self._connections: dict[str, Any] = {}
        self._stamps: dict[str, deque[int]] = {}

    async def connect(self, offer_sdp: str) -> tuple[str, str]:
        """Accept an offer; return the key of the connection and the answer.

        Raises WebRtcError, and ValueError for an invalid offer.
        """
        try:
            import aiortc
        except ImportError as error:
            raise WebRtcError(501, "WebRTC requires the package aiortc: pip install aiortc") from error
        if len(self._connections) >= MOST_CONNECTIONS:
            raise WebRtcError(503, "Too many clients.")
        # Without external STUN or TURN servers: clients are in the same network.
        connection = aiortc.RTCPeerConnection(aiortc.RTCConfiguration(iceServers=[]))
        key = secrets.token_urlsafe(12)
        stamps: deque[int] = deque(maxlen=_STAMPS_KEPT)
        self._connections[key], self._stamps[key] = connection, stamps

        async def on_state_change() -> None:
            if connection.connectionState in ("failed", "closed"):
                await self.end(key)

        connection.on("connectionstatechange", on_state_change)
        try:
            await connection.setRemoteDescription(aiortc.RTCSessionDescription(sdp=offer_sdp, type="offer"))
            connection.addTrack(_track(self._frames, stamps))
            if self._sound is not None and any(each.kind == "audio" for each in connection.getTransceivers()):
                try:
                    connection.addTrack(self._sound.track())
                except OSError as error:
                    _log.warning("the microphone cannot be heard: %s", error)
            await connection.setLocalDescription(await connection.createAnswer())
        except Exception as error:
            await self.end(key)
            # aiortc raises many kinds of errors for an unusable offer.
            raise ValueError("the offer cannot be used") from error
        return key, connection.localDescription.sdp

    def stamps(self, key: str) -> list[int] | None:
        """Capture times of the connection's recent frames, in ticks of its frame clock."""
        stamps = self._stamps.get(key)
        return None if stamps is None else list(stamps)

    async def end(self, key: str) -> bool:
        """Close a connection; False if there was none."""
        connection = self._connections.pop(key, None)
        self._stamps.pop(key, None)
        if connection is not None:
            for sender in connection.getSenders():
                if sender.track is not None:
                    sender.track.stop()
            await connection.close()
        return connection is not None

    async def close(self) -> None:
        await asyncio.gather(*(self.end(key) for key in tuple(self._connections)))


def ticks_of(monotonic_ns: int) -> int:
    return monotonic_ns * 9 // 100_000


def _track(frames: NewestFrame, stamps: deque[int]) -> Any:
    import aiortc
    import av

    class CameraTrack(aiortc.MediaStreamTrack):  # type: ignore[misc]
        """Video track whose frame times are capture times."""

        kind = "video"

        def __init__(self) -> None:
            super().__init__()
            self._sequence = 0

        async def recv(self) -> Any:
            frame = await frames.after(self._sequence)
            self._sequence = frame.sequence
            height_px, width_px = (length_px // 2 * 2 for length_px in frame.image_bgr.shape[:2])
            video = av.VideoFrame.from_ndarray(frame.image_bgr[:height_px, :width_px], format="bgr24")
            video.pts = ticks_of(frame.captured_ns)
            video.time_base = fractions.Fraction(1, CLOCK_RATE_HZ)
            stamps.append(video.pts)
            return video

    return CameraTrack()
