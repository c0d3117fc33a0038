"""Camera process: writes images to a frame ring and reports the camera's state."""

import contextlib
import logging
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import clock
from caris_desktop.domain.events import Problem
from caris_desktop.domain.media_checks import PictureError, fitted
from caris_desktop.domain.plugins import find, load
from caris_desktop.domain.ports import FrameWriter
from caris_desktop.domain.sensing import AudioChunk, CameraState, DepthGrid
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.perception.cameras.camera_source import (
    SOUND_RATE_HZ,
    CameraError,
    CameraSource,
    CameraSwitchedOffError,
    CameraWithMicrophone,
    ChosenCamera,
    Picture,
)

log = logging.getLogger(__name__)

# Start of a video file without ``PlayVideo``: a detector is usually ready by then.
PLAY_AFTER_S = 6.0
_RETRY_AFTER_S = (1.0, 2.0, 5.0)
# After a longer delay, playback continues from the present position instead of catching up.
_CATCH_UP_AT_MOST_S = 1.0
# After this many unusable images in a row the camera counts as lost.
_REFUSED_AT_MOST = 100
_DEPTH_COLUMNS = 80


class StreamSound(Value):
    """Sent to the process: start or stop sending the audio of the camera's microphone."""

    on: bool


class PlayVideo(Value):
    """Sent to the process: start the playback of a recorded video, since its viewers are ready."""


def run_camera(
    connection: Connection,
    chosen: ChosenCamera,
    frames: FrameWriter,
    *,
    open_one: Callable[[ChosenCamera], CameraSource] | None = None,
) -> None:
    """Process entry point: write the camera's images to ``frames`` and send a ``FrameRef`` for each.

    While ``StreamSound`` is on, it sends an ``AudioChunk`` for the camera's microphone, if there is one. It sends a
    ``CameraState`` at each change (connected, lost, ended), a ``Problem`` once per outage, and one for unusable images.
    A lost camera is retried forever. It returns when the connection closes, and after the end of a recorded video.

    A video file starts on ``PlayVideo`` or after ``PLAY_AFTER_S``, at its own rate, or with ``fast`` as fast as
    possible. In a fresh ring its n-th image has sequence n, without gaps.
    """
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        _Running(connection, chosen, frames, open_one or open_camera).serve()


class _Running:
    def __init__(
        self,
        connection: Connection,
        chosen: ChosenCamera,
        frames: FrameWriter,
        open_one: Callable[[ChosenCamera], CameraSource],
    ) -> None:
        self._connection = connection
        self._chosen = chosen
        self._frames = frames
        self._open = open_one
        self._refusals_reported: set[str] = set()
        self._streams_sound = False

    def serve(self) -> None:
        """Run until a recorded video ends. Raises EOFError when the connection closes."""
        name = self._chosen.name
        failures = 0
        self._report_state("connecting")
        while True:
            camera: CameraSource | None = None
            try:
                camera = self._open(self._chosen)
                if isinstance(camera, CameraWithMicrophone):
                    camera.on_sound = self._send_sound
                first = self._read(camera)
                log.info("camera %s: %dx%d at %s fps", name, camera.width_px, camera.height_px, camera.fps)
                self._connection.send(
                    CameraState(
                        clock.now_ns(),
                        name,
                        "connected",
                        width_px=camera.width_px,
                        height_px=camera.height_px,
                        fps=camera.fps,
                    )
                )
                failures = 0
                if self._chosen.recorded:
                    self._wait(PLAY_AFTER_S)
                self._play(camera, first)
                self._report_state("ended", QT_TR_NOOP("Playback of the video has ended."))
                break
            except CameraError as error:
                if failures == 0:
                    # The libraries' texts have the address, with its password.
                    cause = str(error.__cause__ or "").replace(self._chosen.target, name)
                    log.warning("camera %s: %s %s", name, error, cause)
                if self._chosen.recorded or isinstance(error, CameraSwitchedOffError):
                    self._report_problem(error, "error", QT_TR_NOOP("No images are available from this camera."))
                    self._report_state("ended", str(error), error.advice)
                    break
                if failures == 0:
                    self._report_problem(
                        error,
                        "warning",
                        QT_TR_NOOP(
                            "No video is available until this camera is connected again. The console keeps "
                            "trying to connect."
                        ),
                    )
                    self._report_state("lost", str(error), error.advice)
            finally:
                if camera is not None:
                    camera.close()
            self._wait(_RETRY_AFTER_S[min(failures, len(_RETRY_AFTER_S) - 1)])
            failures += 1

    def _read(self, camera: CameraSource) -> Picture | None:
        """Next usable image. Raises CameraError."""
        for _ in range(_REFUSED_AT_MOST):
            try:
                picture = camera.read()
                return None if picture is None else replace(picture, image=fitted(picture.image))
            except PictureError as refused:
                self._report_refused(refused)
        raise CameraError(
            localized(QT_TR_NOOP("The camera {name} only sends images that cannot be shown."), name=self._chosen.name),
            QT_TR_NOOP("Check the camera settings."),
        )

    def _play(self, camera: CameraSource, first: Picture | None) -> None:
        """Play until a recorded video ends."""
        started_ns: int | None = None
        picture = first
        while picture is not None:
            wait_s = 0.0
            if picture.due_s is not None and not self._chosen.fast:
                now_ns = clock.now_ns()
                due_ns = round(picture.due_s * 1e9)
                if started_ns is None or now_ns - started_ns - due_ns > _CATCH_UP_AT_MOST_S * 1e9:
                    if started_ns is not None:
                        log.warning("%s is %.1f s late", self._chosen.name, (now_ns - started_ns - due_ns) / 1e9)
                    started_ns = now_ns - due_ns
                wait_s = max(0.0, (started_ns + due_ns - now_ns) / 1e9)
            self._wait(wait_s)
            ref = self._frames.write(
                picture.image, stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera=self._chosen.name
            )
            if picture.taken_ns is not None:
                ref = replace(ref, taken_ns=picture.taken_ns, taken_uncertainty_ns=picture.taken_uncertainty_ns)
            self._connection.send(ref)
            if picture.depth_mm is not None:
                self._connection.send(DepthGrid(ref.stamp_ns, self._chosen.name, _coarse(picture.depth_mm)))
            picture = self._read(camera)

    def _wait(self, seconds: float) -> None:
        """Wait for the time or ``PlayVideo``. Raises EOFError when the connection closes."""
        if self._connection.poll(seconds):
            message = self._connection.recv()
            if isinstance(message, StreamSound):
                self._streams_sound = message.on

    def _send_sound(self, stamp_ns: int, samples: NDArray[np.int16]) -> None:
        if self._streams_sound:
            self._connection.send(AudioChunk(stamp_ns, ROBOT_MICROPHONE, SOUND_RATE_HZ, samples))

    def _report_state(self, state: Literal["connecting", "lost", "ended"], detail: str = "", advice: str = "") -> None:
        self._connection.send(CameraState(clock.now_ns(), self._chosen.name, state, detail, advice))

    def _report_problem(self, error: CameraError, severity: Literal["warning", "error"], meaning: str) -> None:
        self._connection.send(Problem(clock.now_ns(), severity, str(error), meaning, error.advice, until="picture"))

    def _report_refused(self, refused: PictureError) -> None:
        log.info("camera %s: a picture %s", self._chosen.name, refused)
        if str(refused) in self._refusals_reported or len(self._refusals_reported) > 3:
            return
        self._refusals_reported.add(str(refused))
        self._connection.send(
            Problem(
                clock.now_ns(),
                "warning",
                localized(
                    QT_TR_NOOP("A frame from the camera {name} was skipped: it {refused}."),
                    name=self._chosen.name,
                    refused=refused,
                ),
                QT_TR_NOOP("The video stays frozen until a valid frame arrives."),
                QT_TR_NOOP("If this continues, check the camera's settings and its cable or network."),
                until="picture",
            )
        )


def _coarse(depth_mm: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Subsampled depth image, ``_DEPTH_COLUMNS`` wide: enough for people, and small to send."""
    step = max(1, depth_mm.shape[1] // _DEPTH_COLUMNS)
    return np.ascontiguousarray(depth_mm[step // 2 :: step, step // 2 :: step])


def open_camera(chosen: ChosenCamera) -> CameraSource:
    """Open a camera; may take some seconds. Raises CameraError."""
    if chosen.kind == "plugin":
        from caris_desktop.perception.cameras.plugin_camera import PluginCamera

        return PluginCamera(chosen)
    if chosen.kind == "robot":
        raise CameraError(
            localized(QT_TR_NOOP("Cameras of the kind {kind} cannot be opened here."), kind=chosen.kind),
            QT_TR_NOOP("Choose it in the console, with --camera."),
        )
    camera: CameraSource = load(find("cameras", chosen.kind))(chosen)
    return camera


def open_http(chosen: ChosenCamera) -> CameraSource:
    """Open an HTTP camera, of whatever it sends. Raises CameraError."""
    from caris_desktop.perception.cameras.http_camera import HttpCamera, NotMultipartError

    try:
        return HttpCamera(chosen)
    except NotMultipartError:
        # A video over HTTP, or another authentication.
        from caris_desktop.perception.cameras.stream_camera import StreamCamera

        return StreamCamera(chosen)
