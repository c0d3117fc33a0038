"""HTTP requests to network cameras, with authentication."""

import base64
import contextlib
import http.client
import ssl
import urllib.parse
from collections.abc import Mapping

from caris_desktop.domain.address import is_encrypted_or_local
from caris_desktop.domain.certificates import (
    OtherCertificateError,
    certificate_of,
    client_context,
    confirmed_context,
    fingerprint_of,
    why_refused,
)
from caris_desktop.domain.translation import QT_TR_NOOP, joined, localized
from caris_desktop.perception.cameras.camera_source import (
    OPEN_TIMEOUT_S,
    SILENCE_S,
    CameraError,
    ChosenCamera,
    camera_token,
    cannot_be_reached,
)

_LONGEST_ANSWER_BYTES = 1_000_000


class CameraConnection:
    """Connection to a camera's host for sequential requests. Use as a context, or close it."""

    def __init__(self, chosen: ChosenCamera) -> None:
        """Raises CameraError if the token is missing or would be sent unencrypted, or the certificate is another."""
        self._chosen = chosen
        self._parts = urllib.parse.urlsplit(chosen.target)
        self._head = _authorization(chosen, self._parts)
        host, port = self._parts.hostname or "", self._parts.port
        if self._parts.scheme == "https":
            self._connection: http.client.HTTPConnection = http.client.HTTPSConnection(
                host, port, timeout=OPEN_TIMEOUT_S, context=self._trusted(host, port or 443)
            )
        else:
            self._connection = http.client.HTTPConnection(host, port, timeout=OPEN_TIMEOUT_S)

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
        own_path = (self._parts.path or "/") + (f"?{self._parts.query}" if self._parts.query else "")
        try:
            self._connection.request(method, path or own_path, body, {**self._head, **(head or {})})
            self._connection.sock.settimeout(SILENCE_S)
            return self._connection.getresponse()
        except (OSError, http.client.HTTPException) as error:
            self.close()
            raise self._not_reached(error) from error

    def _trusted(self, host: str, port: int) -> ssl.SSLContext:
        confirmed = self._chosen.certificate_sha256
        try:
            return confirmed_context(confirmed, host, port) if confirmed else client_context()
        except OSError as error:
            raise self._not_reached(error) from error

    def _not_reached(self, error: Exception) -> CameraError:
        name = self._chosen.name
        if isinstance(error, OtherCertificateError):
            other = QT_TR_NOOP("The certificate of the camera at {name} does not match the fingerprint in its address.")
            return CameraError(
                localized(other, name=name),
                QT_TR_NOOP(
                    "Find out why on the camera's computer. Do not use the camera until then: the connection may "
                    "be intercepted."
                ),
            )
        if isinstance(error, ssl.SSLError):
            host, certificate = self._parts.hostname or "", None
            with contextlib.suppress(OSError, ValueError):
                certificate = certificate_of(host, self._parts.port or 443)
            reason, advice = why_refused(error, host, certificate)
            if certificate is not None:
                confirm = QT_TR_NOOP(
                    "If this is the right certificate, append its SHA-256 fingerprint to the address: "
                    "#certificate-sha256={fingerprint}"
                )
                advice = (*advice, localized(confirm, fingerprint=fingerprint_of(certificate)))
            return CameraError(joined(reason), joined(advice))
        return cannot_be_reached(name)

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
    if token and not is_encrypted_or_local(chosen.target):
        raise CameraError(
            localized(
                QT_TR_NOOP("The token for the camera at {name} is not sent: others could read it in transit."),
                name=chosen.name,
            ),
            QT_TR_NOOP("Start its camera server with --cert and --key and use https://, or use an SSH tunnel."),
        )
    if token:
        return {"Authorization": f"Bearer {token}"}
    if parts.username is None:
        return {}
    pair = f"{urllib.parse.unquote(parts.username)}:{urllib.parse.unquote(parts.password or '')}"
    return {"Authorization": f"Basic {base64.b64encode(pair.encode()).decode()}"}
