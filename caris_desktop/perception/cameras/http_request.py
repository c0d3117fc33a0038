"""HTTP requests to network cameras, with authentication."""

import base64
import http.client
import urllib.parse
from collections.abc import Mapping

from caris_desktop.perception.cameras.camera_source import OPEN_TIMEOUT_S, SILENCE_S, cannot_be_reached
from caris_desktop.perception.cameras.chosen_camera import ChosenCamera, camera_token

_LONGEST_ANSWER_BYTES = 1_000_000


class CameraConnection:
    """Connection to a camera's host for sequential requests. Use as a context, or close it."""

    def __init__(self, chosen: ChosenCamera) -> None:
        """Raises CameraError if the token is missing."""
        self._chosen = chosen
        self._parts = urllib.parse.urlsplit(chosen.target)
        self._head = _authorization(chosen, self._parts)
        kind = http.client.HTTPSConnection if self._parts.scheme == "https" else http.client.HTTPConnection
        self._connection = kind(self._parts.hostname or "", self._parts.port, timeout=OPEN_TIMEOUT_S)

    def __enter__(self) -> "CameraConnection":
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        self._connection.close()

    def request(
        self, method: str, path: str = "", body: bytes | None = None, head: Mapping[str, str] | None = None
    ) -> http.client.HTTPResponse:
        """Send a request; return the response after its headers. ``path`` defaults to the camera's.
        Raises CameraError.
        """
        own = (self._parts.path or "/") + (f"?{self._parts.query}" if self._parts.query else "")
        try:
            self._connection.request(method, path or own, body, {**self._head, **(head or {})})
            self._connection.sock.settimeout(SILENCE_S)
            return self._connection.getresponse()
        except (OSError, http.client.HTTPException) as error:
            self.close()
            raise cannot_be_reached(self._chosen.name) from error

    def ask(
        self, method: str, path: str = "", body: bytes | None = None, head: Mapping[str, str] | None = None
    ) -> tuple[http.client.HTTPResponse, bytes]:
        """Send a request; return the response and its body. Raises CameraError."""
        response = self.request(method, path, body, head)
        try:
            return response, response.read(_LONGEST_ANSWER_BYTES)
        except (OSError, http.client.HTTPException) as error:
            self.close()
            raise cannot_be_reached(self._chosen.name) from error


def _authorization(chosen: ChosenCamera, parts: urllib.parse.SplitResult) -> dict[str, str]:
    token = camera_token(chosen)
    if token:
        return {"Authorization": f"Bearer {token}"}
    if parts.username is None:
        return {}
    pair = f"{urllib.parse.unquote(parts.username)}:{urllib.parse.unquote(parts.password or '')}"
    return {"Authorization": f"Basic {base64.b64encode(pair.encode()).decode()}"}
