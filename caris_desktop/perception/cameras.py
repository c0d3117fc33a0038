"""Camera sources of this computer, and the process body that feeds their frames into the frame ring."""

import contextlib
import datetime
import logging
import re
import urllib.parse
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import clock
from caris_desktop.domain.events import Problem
from caris_desktop.domain.ports import FrameWriter

log = logging.getLogger(__name__)

MAX_FRAME_PIXELS = 1920 * 1080
# Without being told, a video file begins once a detector usually is ready.
PLAY_AFTER_S = 6.0
_URL_SCHEMES = ("rtsp", "rtsps", "http", "https")
_OPEN_TIMEOUT_S = 5.0
_SILENCE_S = 3.0
_RETRY_AFTER_S = (1.0, 2.0, 5.0)
# A file that could not be played in time for this long continues from where it is instead of rushing after.
_CATCH_UP_AT_MOST_S = 1.0
_DEVICE_SIZE_PX = (1280, 720)
_DEVICE_FPS = 30


@dataclass(frozen=True, slots=True)
class CameraReady:
    """The source delivers. Sent again after each successful retry. ``fps`` is None where the source does not tell."""

    stamp_ns: int
    camera: str
    width_px: int
    height_px: int
    fps: float | None


@dataclass(frozen=True, slots=True)
class CameraEnded:
    """A video file played to its end, or cannot be played; the process ends after sending this."""

    stamp_ns: int
    camera: str


@dataclass(frozen=True, slots=True)
class PlayVideo:
    """Sent to the process: begin to play a recorded video, since whoever shall see it from its start is ready."""


class CameraError(Exception):
    """The source cannot be opened or stopped delivering. Text and ``advice`` are for the wizard."""

    def __init__(self, what: str, advice: str) -> None:
        super().__init__(what)
        self.advice = advice


@dataclass(frozen=True, slots=True)
class CameraSource:
    """What a ``--camera`` text means. ``name`` is fit for file names and never holds a password."""

    kind: Literal["file", "device", "url", "oak"]
    target: str
    name: str
    loop: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One frame: uint8 BGR, shape (height, width, 3). ``due_s`` is its time since the start of a recorded video."""

    image_bgr: NDArray[np.uint8]
    due_s: float | None = None


class OpenCamera(Protocol):
    """An open source. For one thread."""

    width_px: int
    height_px: int
    fps: float | None

    def read(self) -> Picture | None:
        """The next picture, waiting for it; None at the end of a recorded video. Raises CameraError when lost."""

    def close(self) -> None: ...


def parse_source(source: str) -> CameraSource:
    """Understand a source: video file (``?loop`` plays it forever), device number, ``/dev/videoN``, URL, ``oak[:ID]``.

    Raises
    ------
    CameraError
        When it is none of these. That a file or device is there is seen only when it is opened.
    """
    source = source.strip()
    if source.isdecimal() or source.startswith("/dev/video"):
        number = source.removeprefix("/dev/video")
        return CameraSource("device", source, _safe_name(f"camera-{number}"))
    if source == "oak" or source.startswith("oak:"):
        return CameraSource("oak", source.removeprefix("oak").removeprefix(":"), "oak")
    if "://" in source:
        parts = urllib.parse.urlsplit(source)
        if parts.scheme not in _URL_SCHEMES or not parts.hostname:
            raise CameraError(
                f"The camera address starts with {parts.scheme}://, which is not understood.",
                f"Use an address that starts with one of {', '.join(f'{scheme}://' for scheme in _URL_SCHEMES)}.",
            )
        return CameraSource("url", source, _safe_name(parts.hostname))
    if not source:
        raise CameraError(
            "The camera source is empty.", "Give a video file, a device number, /dev/videoN, an rtsp:// address or oak."
        )
    path = source.removesuffix("?loop")
    return CameraSource("file", path, _safe_name(Path(path).stem), loop=path != source)


def open_camera(source: CameraSource) -> OpenCamera:
    """Open a source; may take some seconds. Raises CameraError."""
    if source.kind == "device":
        return DeviceCamera(source.target)
    if source.kind == "oak":
        return OakCamera(source.target)
    return StreamCamera(source)


def run_camera(connection: Connection, source: str, frames: FrameWriter) -> None:
    """Process body: writes the source's pictures to ``frames`` and sends a ``FrameRef`` for each.

    Also sends ``CameraReady`` when the source delivers (again after a retry), a ``Problem`` once per outage, and
    ``CameraEnded`` when there is nothing more to come. A source that is lost is retried for ever. Returns when the
    connection ends.

    A video file begins when ``PlayVideo`` arrives, or after ``PLAY_AFTER_S``, and plays at its own rate. In a fresh
    ring its n-th picture gets sequence n; none is left out.
    """
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        try:
            parsed = parse_source(source)
        except CameraError as error:
            connection.send(_problem(error, "error", "There is no picture from this camera."))
            connection.send(CameraEnded(clock.now_ns(), source))
            return
        _serve(connection, parsed, frames)


def _serve(connection: Connection, source: CameraSource, frames: FrameWriter) -> None:
    failures = 0
    while True:
        camera: OpenCamera | None = None
        try:
            camera = open_camera(source)
            first = camera.read()
            log.info("camera %s: %dx%d at %s fps", source.name, camera.width_px, camera.height_px, camera.fps)
            connection.send(CameraReady(clock.now_ns(), source.name, camera.width_px, camera.height_px, camera.fps))
            failures = 0
            if source.kind == "file":
                _wait(connection, PLAY_AFTER_S)
            _play(connection, source, camera, first, frames)
            connection.send(CameraEnded(clock.now_ns(), source.name))
            break
        except CameraError as error:
            log.warning("camera %s: %s", source.name, error, exc_info=error.__cause__)
            if source.kind == "file":
                connection.send(_problem(error, "error", "There is no picture from this video."))
                connection.send(CameraEnded(clock.now_ns(), source.name))
                break
            if failures == 0:
                connection.send(
                    _problem(error, "warning", "There is no picture from this camera until it is back; it is retried.")
                )
        finally:
            if camera is not None:
                camera.close()
        _wait(connection, _RETRY_AFTER_S[min(failures, len(_RETRY_AFTER_S) - 1)])
        failures += 1


def _wait(connection: Connection, seconds: float) -> None:
    """Until the time is over or ``PlayVideo`` came. Raises EOFError when the connection ends."""
    if connection.poll(seconds):
        connection.recv()


def _play(
    connection: Connection, source: CameraSource, camera: OpenCamera, first: Picture | None, frames: FrameWriter
) -> None:
    """Until a recorded video ends."""
    started_ns: int | None = None
    picture = first
    while picture is not None:
        wait_s = 0.0
        if picture.due_s is not None:
            now_ns = clock.now_ns()
            due_ns = round(picture.due_s * 1e9)
            if started_ns is None or now_ns - started_ns - due_ns > _CATCH_UP_AT_MOST_S * 1e9:
                if started_ns is not None:
                    log.warning("%s is %.1f s late", source.name, (now_ns - started_ns - due_ns) / 1e9)
                started_ns = now_ns - due_ns
            wait_s = max(0.0, (started_ns + due_ns - now_ns) / 1e9)
        _wait(connection, wait_s)
        connection.send(
            frames.write(picture.image_bgr, stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera=source.name)
        )
        picture = camera.read()


class StreamCamera:
    """Video files and network streams, through PyAV. What has a duration is played at its own rate."""

    def __init__(self, source: CameraSource) -> None:
        import av

        self._errors: tuple[type[Exception], ...] = (av.FFmpegError, OSError)
        self._source = source
        live = source.kind == "url"
        options = {"rtsp_transport": "tcp", "fflags": "nobuffer", "flags": "low_delay"} if live else {}
        try:
            self._container = av.open(
                source.target, options=options, timeout=(_OPEN_TIMEOUT_S, _SILENCE_S) if live else None
            )
        except self._errors as error:
            raise self._cannot_open() from error
        if not self._container.streams.video:
            self._container.close()
            raise self._cannot_open()
        self._stream = self._container.streams.video[0]
        self._recorded = source.kind == "file" or self._container.duration is not None
        # Decoding on several frames at once is faster, but holds back as many frames.
        self._stream.thread_type = "AUTO" if self._recorded else "SLICE"
        self.width_px, self.height_px = fitting_size(self._stream.width, self._stream.height)
        self.fps = float(self._stream.average_rate) if self._stream.average_rate else None
        self._frames: Iterator[Any] = iter(self._container.decode(self._stream))
        self._first_pts_s: float | None = None
        self._last_due_s = 0.0
        self._round_began_s = 0.0
        self._pictures_in_round = 0

    def read(self) -> Picture | None:
        try:
            frame = next(self._frames, None)
            if frame is None and self._source.loop and self._pictures_in_round:
                self._rewind()
                frame = next(self._frames, None)
        except self._errors as error:
            raise CameraError(
                f"The video {self._source.name} broke off.", "Check the file, or the camera's network connection."
            ) from error
        if frame is None:
            if self._recorded and self._pictures_in_round:
                return None
            raise CameraError(
                f"The video {self._source.name} has no pictures (any more).",
                "Check the file, or the camera's network connection.",
            )
        self._pictures_in_round += 1
        width_px, height_px = fitting_size(frame.width, frame.height)
        image_bgr = frame.reformat(width=width_px, height=height_px, format="bgr24").to_ndarray()
        return Picture(image_bgr, self._due_s(frame) if self._recorded else None)

    def close(self) -> None:
        self._container.close()

    def _due_s(self, frame: Any) -> float:
        period_s = 1.0 / (self.fps or 25.0)
        if frame.time is None:
            due_s = self._last_due_s + period_s
        else:
            if self._first_pts_s is None:
                self._first_pts_s = frame.time
            due_s = self._round_began_s + frame.time - self._first_pts_s
        self._last_due_s = max(due_s, self._last_due_s)
        return self._last_due_s

    def _rewind(self) -> None:
        self._container.seek(0)
        self._frames = iter(self._container.decode(self._stream))
        self._round_began_s = self._last_due_s + 1.0 / (self.fps or 25.0)
        self._pictures_in_round = 0

    def _cannot_open(self) -> CameraError:
        if self._source.kind == "url":
            return CameraError(
                f"The camera at {self._source.name} cannot be reached.",
                "Check its address, its password and that it is on the same network.",
            )
        path = Path(self._source.target)
        if not path.exists():
            return CameraError(f"The video file {path} does not exist.", "Check the path after --camera.")
        return CameraError(f"{path} is not a video file that can be played.", "Choose another file.")


class DeviceCamera:
    """A camera of this computer, through OpenCV. ``target`` is a number or a device path."""

    def __init__(self, target: str) -> None:
        import cv2

        self._target = target
        # A missing device is reported as a Problem; OpenCV would add lines of its own at every retry.
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        self._capture = cv2.VideoCapture(int(target) if target.isdecimal() else target)
        if not self._capture.isOpened():
            raise CameraError(
                f"Camera {target} cannot be opened.",
                "Check that it is plugged in, that no other program uses it, and that you may use cameras.",
            )
        # Motion-JPEG, since uncompressed pictures of this size come slowly over USB 2.
        self._capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
        self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, _DEVICE_SIZE_PX[0])
        self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, _DEVICE_SIZE_PX[1])
        self._capture.set(cv2.CAP_PROP_FPS, _DEVICE_FPS)
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        self.width_px = int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        self.height_px = int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        self.fps = float(self._capture.get(cv2.CAP_PROP_FPS)) or None

    def read(self) -> Picture | None:
        delivered, image_bgr = self._capture.read()
        if not delivered:
            raise CameraError(f"Camera {self._target} stopped delivering pictures.", "Check its cable.")
        return Picture(_fit(image_bgr))

    def close(self) -> None:
        self._capture.release()


class OakCamera:
    """A Luxonis OAK camera through depthai 3. ``device_id`` is its id, name or address; empty: any that is there."""

    def __init__(self, device_id: str = "") -> None:
        import depthai

        # Looking costs nothing; connecting to a device that is not there waits for twelve seconds.
        if not device_id and not depthai.Device.getAllAvailableDevices():
            raise CameraError("No OAK camera was found.", "Check its cable, and that USB devices may be used.")
        try:
            self._pipeline = depthai.Pipeline(depthai.Device(device_id) if device_id else depthai.Device())
            camera = self._pipeline.create(depthai.node.Camera).build()
            output = camera.requestOutput(_DEVICE_SIZE_PX, type=depthai.ImgFrame.Type.BGR888i, fps=_DEVICE_FPS)
            self._begin(output)
        except RuntimeError as error:
            raise CameraError(
                f"The OAK camera {device_id or ''} cannot be opened.".replace("  ", " "),
                "Check its cable, and that no other program uses it.",
            ) from error
        self.width_px, self.height_px = _DEVICE_SIZE_PX
        self.fps: float | None = float(_DEVICE_FPS)

    def _begin(self, output: Any) -> None:
        # One slot that the newest picture overwrites: what waits here would be shown late.
        self._queue = output.createOutputQueue(maxSize=1, blocking=False)
        self._pipeline.start()

    def read(self) -> Picture | None:
        import depthai

        try:
            frame = self._queue.get(datetime.timedelta(seconds=_SILENCE_S))
        except (RuntimeError, depthai.MessageQueue.QueueException) as error:
            raise self._lost() from error
        if frame is None:
            raise self._lost()
        return Picture(_fit(frame.getCvFrame()))

    def close(self) -> None:
        try:
            self._pipeline.stop()
        except RuntimeError:
            log.info("the OAK camera was gone before it was closed", exc_info=True)

    def _lost(self) -> CameraError:
        return CameraError("The OAK camera stopped delivering pictures.", "Check its cable.")


def fitting_size(width_px: int, height_px: int) -> tuple[int, int]:
    """The size itself, or a smaller one of the same shape that fits a slot of the frame ring."""
    pixels = width_px * height_px
    if pixels <= MAX_FRAME_PIXELS:
        return width_px, height_px
    scale = (MAX_FRAME_PIXELS / pixels) ** 0.5
    return int(width_px * scale), int(height_px * scale)


def _fit(image_bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height_px, width_px = image_bgr.shape[:2]
    size_px = fitting_size(width_px, height_px)
    if size_px == (width_px, height_px):
        return image_bgr
    import cv2

    return np.asarray(cv2.resize(image_bgr, size_px, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _safe_name(text: str) -> str:
    return re.sub(r"[^\w.-]+", "-", text).strip("-.") or "camera"


def _problem(error: CameraError, severity: Literal["warning", "error"], meaning: str) -> Problem:
    return Problem(clock.now_ns(), severity, str(error), meaning, error.advice, until="picture")
