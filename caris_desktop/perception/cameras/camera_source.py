"""Camera interface: an open source of images, and errors as user texts."""

import os
import re
import urllib.parse
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import clock
from caris_desktop.domain.certificates import fingerprint_bytes
from caris_desktop.domain.free_names import free_name
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value

OPEN_TIMEOUT_S = 5.0
SILENCE_S = 3.0
"""A camera that sends nothing for so long is lost."""
SOUND_RATE_HZ = 16_000
_DRIVER_WITHIN_NS = 1_000_000_000
_DRIVER_UNCERTAINTY_NS = 2_000_000
DEVICE_SIZE_PX = (1280, 720)
DEVICE_FPS = 30


class CameraError(Exception):
    """The source cannot be opened or stopped delivering. Text and ``advice`` are for the wizard."""

    def __init__(self, what: str, advice: str) -> None:
        super().__init__(what)
        self.advice = advice


class CameraSwitchedOffError(CameraError):
    """A plug-in failed, so that its camera is not tried again."""


def cannot_be_reached(name: str) -> CameraError:
    """Error for an unreachable network camera."""
    return CameraError(
        localized(QT_TR_NOOP("The camera at {name} cannot be reached."), name=name),
        QT_TR_NOOP("Check the camera's address and password, and that it is on the same network."),
    )


def stopped_sending(name: str) -> CameraError:
    """Error for a network camera that was connected."""
    return CameraError(
        localized(QT_TR_NOOP("The camera at {name} stopped sending images."), name=name),
        QT_TR_NOOP("Check the camera and its network connection."),
    )


class Picture(Value, eq=False):
    """One frame as the camera delivers it: grey, BGR or BGRA, of 8 or 16 bits.

    ``due_s`` is its time from the start of a recorded video. ``taken_ns`` is the capture in session time within
    ``taken_uncertainty_ns``; None if unknown. ``depth_mm`` is uint16, shape (rows, columns): the same view in its own
    resolution, 0 if unknown; None without a depth camera.
    """

    image: NDArray[Any]
    due_s: float | None = None
    taken_ns: int | None = None
    taken_uncertainty_ns: int | None = None
    depth_mm: NDArray[np.uint16] | None = None


def picture_of(image: NDArray[Any], *, device_ns: int, depth_mm: NDArray[np.uint16] | None = None) -> Picture:
    """Picture with the driver's time, if that is in session time, as on Linux."""
    ago_ns = clock.now_ns() - device_ns
    if not 0 <= ago_ns <= _DRIVER_WITHIN_NS:
        return Picture(image, depth_mm=depth_mm)
    return Picture(image, taken_ns=device_ns, taken_uncertainty_ns=_DRIVER_UNCERTAINTY_NS, depth_mm=depth_mm)


class CameraSource(Protocol):
    """Open camera. For one thread. Another kind of camera of the program needs a class like this that takes the
    ChosenCamera, a keyword in this module and an entry point of the group ``caris_desktop.cameras``.
    """

    width_px: int
    height_px: int
    fps: float | None  # None if unknown

    def read(self) -> Picture | None:
        """Wait for the newest image; None at the end of a recorded video.

        Raises CameraError if the camera is lost, and PictureError if only this image is unusable.
        """

    def close(self) -> None:
        """Close the camera; called once in any state."""


@runtime_checkable
class CameraWithMicrophone(Protocol):
    """Camera with a microphone. ``on_sound`` gets the session time of the first sample and the samples, int16, shape
    (samples, 1), at ``SOUND_RATE_HZ``, in the thread that waits for an image.
    """

    on_sound: Callable[[int, NDArray[np.int16]], None]


# Parser of the string that selects a camera.

Kind = Literal["robot", "simulated", "file", "device", "oak", "stream", "http", "whep", "webrtc", "plugin"]
_SCHEMES: dict[str, Kind] = {
    "rtsp": "stream", "rtsps": "stream", "http": "http", "https": "http",
    "whep+http": "whep", "whep+https": "whep", "webrtc+http": "webrtc", "webrtc+https": "webrtc",
}  # fmt: skip
_PLAY_WORDS = frozenset({"loop", "fast"})
# Scenarios may come from others, who must not read other environment variables.
_TOKEN_ENV = re.compile(r"[A-Za-z0-9_]*CAMERA[A-Za-z0-9_]*")
FORMS = (
    "robot, robot:NAME, simulated, oak, oak:ID, plugin:NAME, plugin:NAME:TARGET, a number, /dev/videoN, a video file, "
    "or an address that starts with one of " + ", ".join(f"{scheme}://" for scheme in _SCHEMES)
)
"""Everything that can be given, for messages."""


class ChosenCamera(Value):
    """``target`` locates the camera for its kind. ``name`` is safe for file names and never contains a password.

    ``token_env`` names the environment variable with the camera's token, so that no file has to contain it. ``sound``:
    use its microphone, over WebRTC. ``certificate_sha256``: the only certificate accepted, with any issuer.
    """

    kind: Kind
    target: str
    name: str
    loop: bool = False
    fast: bool = False
    token_env: str = ""
    sound: bool = False
    certificate_sha256: str = ""

    @property
    def recorded(self) -> bool:
        return self.kind == "file"


def parse_camera(text: str, *, name: str = "") -> ChosenCamera:
    """Parse one string; ``name`` replaces the derived name.

    Raises
    ------
    CameraError
        When it is none of the forms. That a file or device is there is seen only when it is opened.
    """
    chosen = _parsed(text.strip())
    return replace(chosen, name=safe_name(name)) if name else chosen


def with_distinct_names(cameras: Iterable[ChosenCamera]) -> tuple[ChosenCamera, ...]:
    """Number cameras of the same name, since data is stored by name."""
    taken: set[str] = set()
    distinct = []
    for camera in cameras:
        name = camera.name if camera.kind == "robot" else free_name(camera.name, "", taken.__contains__)
        taken.add(name)
        distinct.append(replace(camera, name=name))
    return tuple(distinct)


def camera_token(chosen: ChosenCamera) -> str:
    """Token for the camera, empty if none is configured. Raises CameraError."""
    if not chosen.token_env:
        return ""
    token = os.environ.get(chosen.token_env, "").strip()
    if not token:
        raise CameraError(
            localized(
                QT_TR_NOOP(
                    "The environment variable {token_env}, which holds the token of the camera at {name}, is not set."
                ),
                token_env=chosen.token_env,
                name=chosen.name,
            ),
            QT_TR_NOOP("Set the variable before starting the program."),
        )
    return token


def safe_name(text: str) -> str:
    return re.sub(r"[^\w.-]+", "-", text).strip("-.") or "camera"


def _parsed(text: str) -> ChosenCamera:
    word, _, rest = text.partition(":")
    if text in ("robot", "oak", "simulated") or (word in ("robot", "oak") and rest and "//" not in rest):
        kind: Kind = "robot" if word == "robot" else "oak" if word == "oak" else "simulated"
        return ChosenCamera(kind, rest, rest if word == "robot" and rest else word)
    if word == "plugin" and rest:
        return ChosenCamera("plugin", rest, safe_name(rest.partition(":")[0]))
    if text.isdecimal() or text.startswith("/dev/video"):
        return ChosenCamera("device", text, safe_name(f"camera-{text.removeprefix('/dev/video')}"))
    if "://" in text:
        return _address(text)
    if not text:
        raise CameraError(
            QT_TR_NOOP("The camera source is empty."), localized(QT_TR_NOOP("Enter {forms}."), forms=FORMS)
        )
    path, _, words = text.rpartition("?")
    options = frozenset(words.split("&"))
    if not path or not options <= _PLAY_WORDS:
        path, options = text, frozenset()
    return ChosenCamera("file", path, safe_name(Path(path).stem), loop="loop" in options, fast="fast" in options)


def _address(text: str) -> ChosenCamera:
    try:
        parts = urllib.parse.urlsplit(text)
        host, _port = parts.hostname, parts.port
    except ValueError as error:
        raise CameraError(
            localized(QT_TR_NOOP("The camera address is invalid: {error}."), error=error),
            localized(QT_TR_NOOP("Enter {forms}."), forms=FORMS),
        ) from error
    if parts.scheme not in _SCHEMES or not host:
        raise CameraError(
            localized(
                QT_TR_NOOP("The camera address starts with {scheme}://, which is not supported."), scheme=parts.scheme
            ),
            localized(
                QT_TR_NOOP("Use an address that starts with one of {schemes}."),
                schemes=", ".join(f"{scheme}://" for scheme in _SCHEMES),
            ),
        )
    # The fragment after # is for us and never sent.
    ours = urllib.parse.parse_qs(parts.fragment)
    token_env = ours.get("token-env", [""])[0]
    fingerprint = ours.get("certificate-sha256", [""])[0]
    if fingerprint:
        try:
            fingerprint_bytes(fingerprint)
        except ValueError as error:
            raise CameraError(
                localized(
                    QT_TR_NOOP("The certificate-sha256 of the camera at {host} is not a SHA-256 fingerprint."),
                    host=host,
                ),
                QT_TR_NOOP("Enter the 64 digits that openssl prints."),
            ) from error
    if token_env and not _TOKEN_ENV.fullmatch(token_env):
        raise CameraError(
            localized(
                QT_TR_NOOP("The camera at {host} asks for the environment variable {token_env}."),
                host=host,
                token_env=token_env[:40],
            ),
            QT_TR_NOOP(
                "Only environment variables with CAMERA in their name are sent to a camera: rename it to CAMERA_TOKEN."
            ),
        )
    target = text.removesuffix(f"#{parts.fragment}").removeprefix("whep+").removeprefix("webrtc+")
    return ChosenCamera(
        _SCHEMES[parts.scheme], target, safe_name(host), token_env=token_env, certificate_sha256=fingerprint
    )
