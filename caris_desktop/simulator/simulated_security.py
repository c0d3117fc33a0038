"""Access control: rosauth's signed authentication, and TLS certificates."""

import hashlib
import hmac
import ssl
from pathlib import Path
from typing import Any

from caris_desktop.ros.message_fields import MessageError, number, text

SECRET_CHARS = 16
"""The length that rosauth demands of its secret."""
_CLOCKS_DIFFER_AT_MOST_S = 5.0


def authentication_code(secret: str, *, client: str, dest: str, rand: str, time_s: int, level: str, end_s: int) -> str:
    """rosauth's MAC: SHA-512 of the concatenated fields, in hexadecimal."""
    return hashlib.sha512(f"{secret}{client}{dest}{rand}{time_s}{level}{end_s}".encode()).hexdigest()


def introduces_itself(operation: dict[str, Any], secret: str, *, now_s: float) -> bool:
    """True if an ``auth`` operation is signed with ``secret``, current, and not expired.

    Raises
    ------
    MessageError
        When a field is missing or is no text or number.
    """
    what = "auth"
    time_s, end_s = number(operation, "t", what), number(operation, "end", what)
    code = authentication_code(
        secret,
        client=text(operation, "client", what),
        dest=text(operation, "dest", what),
        rand=text(operation, "rand", what),
        time_s=int(time_s),
        level=text(operation, "level", what),
        end_s=int(end_s),
    )
    given = text(operation, "mac", what)
    if not given.isascii():
        raise MessageError("auth.mac must be hexadecimal digits")
    of_this_moment = abs(now_s - time_s) <= _CLOCKS_DIFFER_AT_MOST_S and time_s < end_s
    return hmac.compare_digest(code, given.lower()) and of_this_moment


def tls_context(certificate: Path, key: Path) -> ssl.SSLContext:
    """TLS context of the server.

    Raises
    ------
    OSError, ssl.SSLError
        When the files cannot be read, or are no certificate and its key.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    return context
