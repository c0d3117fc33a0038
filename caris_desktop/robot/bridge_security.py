"""Link security: certificates for ``wss://``, and rosbridge's ``auth`` operation (rosauth).

The secret is in an environment variable. It is read on use, goes into one SHA-512 and is not stored.
"""

import asyncio
import hashlib
import os
import secrets
import ssl
import time
from typing import Any

from caris_desktop.domain.certificates import (
    OtherCertificateError,
    certificate_of,
    client_context,
    confirmed_context,
    fingerprint_of,
    why_refused,
)
from caris_desktop.domain.translation import QT_TR_NOOP, joined, localized
from caris_desktop.robot.profile_model import SecuritySettings

_AUTHORIZED_FOR_S = 3600
_LEVEL = "user"


class LinkError(Exception):
    """The link cannot be opened. ``what`` and ``advice`` are for the wizard."""

    def __init__(self, what: str, advice: str) -> None:
        super().__init__(what)
        self.what = what
        self.advice = advice


class SecurityError(LinkError):
    """The link cannot be secured as the profile demands."""


async def tls_context(settings: SecuritySettings, host: str, port: int) -> ssl.SSLContext:
    """TLS context that trusts only the certificate confirmed in the profile; without one, the system's and the
    profile's own file, with host name verification.

    Raises
    ------
    SecurityError
        When the profile's file cannot be used, or the server has another certificate than the confirmed one.
    OSError
        When the server does not answer.
    """
    fingerprint = settings.certificate_sha256
    try:
        if fingerprint is None:
            return client_context(settings.ca_file)
        return await asyncio.to_thread(confirmed_context, fingerprint, host, port)
    except OtherCertificateError as error:
        raise SecurityError(
            localized(
                QT_TR_NOOP("The certificate of {host} is not the one that was confirmed. Nothing was sent."), host=host
            ),
            QT_TR_NOOP(
                "If the robot got a new certificate, correct the fingerprint under Security "
                "('certificate_sha256' in the robot profile). Otherwise, another computer may be "
                "impersonating the robot."
            ),
        ) from error
    except ValueError as error:
        if fingerprint is None:
            raise
        raise SecurityError(
            QT_TR_NOOP("The fingerprint of the robot's certificate is not a SHA-256 fingerprint."),
            QT_TR_NOOP(
                "Correct the fingerprint under Security ('certificate_sha256' in the robot profile): 64 "
                "digits, 0-9 and A-F."
            ),
        ) from error
    except OSError as error:
        if fingerprint is not None:
            raise
        # ssl.SSLError is an OSError with its own numbers.
        reason = (
            "it contains no certificate" if isinstance(error, ssl.SSLError) or not error.strerror else error.strerror
        )
        raise SecurityError(
            localized(
                QT_TR_NOOP("The file with trusted certificates cannot be used: {ca_file} ({reason})."),
                ca_file=settings.ca_file,
                reason=reason,
            ),
            QT_TR_NOOP(
                "Correct the certificate file under Security ('ca_file' in the robot profile); it must be a PEM file."
            ),
        ) from error


async def certificate_refusal(error: ssl.SSLCertVerificationError, host: str, port: int) -> SecurityError:
    """Error for a refused certificate, with its fingerprint for comparison."""
    try:
        certificate = await asyncio.to_thread(certificate_of, host, port)
    except (OSError, ValueError):
        certificate = None
    what, advice = why_refused(error, host, certificate)
    advice = (
        *advice,
        QT_TR_NOOP(
            "If the certificate is the robot's own, enter its file under Security ('ca_file' in the robot profile)."
        ),
    )
    if certificate is not None:
        confirm = QT_TR_NOOP(
            "Or confirm its SHA-256 fingerprint there ('certificate_sha256') if the robot itself has the "
            "same one: {fingerprint}"
        )
        advice = (*advice, localized(confirm, fingerprint=fingerprint_of(certificate)))
    return SecurityError(joined(what), joined(advice))


def secret_is_missing(settings: SecuritySettings) -> bool:
    """True if the environment lacks the secret that the profile names."""
    return settings.rosauth_secret_env is not None and not os.environ.get(settings.rosauth_secret_env)


def auth_operation(settings: SecuritySettings, *, client: str, server: str) -> dict[str, Any] | None:
    """``auth`` operation for now, as rosauth's ``ros_mac_authentication`` verifies it; None without a secret.

    Parameters
    ----------
    client, server
        The two ends of the connection; rosauth hashes them and does not look at them otherwise.

    Raises
    ------
    SecurityError
        When the environment variable is not set.
    """
    if settings.rosauth_secret_env is None:
        return None
    if secret_is_missing(settings):
        raise SecurityError(
            localized(
                QT_TR_NOOP(
                    "The robot requires a secret, but the environment variable {rosauth_secret_env} is not set."
                ),
                rosauth_secret_env=settings.rosauth_secret_env,
            ),
            QT_TR_NOOP("Set the variable to the robot's rosauth secret before starting the console."),
        )
    begin_s = int(time.time())
    end_s = begin_s + _AUTHORIZED_FOR_S
    noise = secrets.token_hex(16)
    hashed = f"{os.environ[settings.rosauth_secret_env]}{client}{server}{noise}{begin_s}{_LEVEL}{end_s}"
    return {
        "op": "auth",
        "mac": hashlib.sha512(hashed.encode()).hexdigest(),
        "client": client,
        "dest": server,
        "rand": noise,
        "t": begin_s,
        "level": _LEVEL,
        "end": end_s,
    }


def no_tls(address: str) -> tuple[str, str]:
    """Problem and advice for a server that does not answer TLS."""
    return (
        localized(QT_TR_NOOP("The server at {address} does not use TLS."), address=address),
        "If the robot's rosbridge is not secured, use an address that starts with ws:// instead of wss://.",
    )


def explain_tls_failure(error: ssl.SSLError, name: str, address: str) -> tuple[str, str]:
    """Problem and advice for a failed TLS connection to ``name``."""
    if error.reason in ("WRONG_VERSION_NUMBER", "HTTP_REQUEST", "PACKET_LENGTH_TOO_LONG"):
        return no_tls(address)
    return (
        localized(
            QT_TR_NOOP("A secure connection to {name} could not be established ({error})."),
            name=name,
            error=error.reason or error,
        ),
        QT_TR_NOOP("Check the TLS settings of the robot's rosbridge (certfile, keyfile)."),
    )
