"""Parser of the string that selects a camera."""

import os
import re
import urllib.parse
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Literal

from caris_desktop.domain.certificates import fingerprint_bytes
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.perception.cameras.camera_source import CameraError

Kind = Literal["robot", "simulated", "file", "device", "oak", "stream", "http", "whep", "webrtc"]
_SCHEMES: dict[str, Kind] = {
    "rtsp": "stream", "rtsps": "stream", "http": "http", "https": "http",
    "whep+http": "whep", "whep+https": "whep", "webrtc+http": "webrtc", "webrtc+https": "webrtc",
}  # fmt: skip
_PLAY_WORDS = frozenset({"loop", "fast"})
# Scenarios may come from others, who must not read other environment variables.
_TOKEN_ENV = re.compile(r"[A-Za-z0-9_]*CAMERA[A-Za-z0-9_]*")
FORMS = (
    "robot, robot:NAME, simulated, oak, oak:ID, a number, /dev/videoN, a video file, "
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
        name, number = camera.name, 2
        while name in taken and camera.kind != "robot":
            name, number = f"{camera.name}-{number}", number + 1
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
