"""Who the robot's server is, and who we are: certificates for ``wss://``, and rosbridge's ``auth`` operation (rosauth).

The secret lies in an environment variable. It is read at the moment of use, goes into one SHA-512 and is kept nowhere.
"""

import hashlib
import os
import secrets
import ssl
import time
from pathlib import Path
from typing import Any

from caris_desktop.domain.translation import QT_TR_NOOP, filled
from caris_desktop.robot.profile import SecuritySettings

_AUTHORIZED_FOR_S = 3600
_LEVEL = "user"

_EXPIRED, _NOT_YET_VALID = 10, 9
_WRONG_NAME, _WRONG_IP = 62, 64
_UNTRUSTED = (18, 19, 20, 21)


class SecurityError(Exception):
    """The link cannot be secured as the profile asks. ``what`` and ``advice`` are for the wizard."""

    def __init__(self, what: str, advice: str) -> None:
        super().__init__(what)
        self.what = what
        self.advice = advice


def tls_context(settings: SecuritySettings) -> ssl.SSLContext:
    """Trusts what the system trusts, and the profile's own file; checks the server's name.

    Raises
    ------
    SecurityError
        When the profile's file cannot be used.
    """
    context = ssl.create_default_context()
    if settings.ca_file is not None:
        try:
            context.load_verify_locations(Path(settings.ca_file).expanduser())
        except (OSError, ssl.SSLError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else "no certificate is in it"
            raise SecurityError(
                filled(
                    QT_TR_NOOP("The file with trusted certificates cannot be used: {ca_file} ({reason})."),
                    ca_file=settings.ca_file,
                    reason=reason,
                ),
                QT_TR_NOOP(
                    "Correct the certificate file under Security ('ca_file' in the robot profile); it is a PEM file."
                ),
            ) from error
    return context


def secret_is_missing(settings: SecuritySettings) -> bool:
    """Whether the profile names a secret that the environment does not hold."""
    return settings.rosauth_secret_env is not None and not os.environ.get(settings.rosauth_secret_env)


def auth_operation(settings: SecuritySettings, *, client: str, server: str) -> dict[str, Any] | None:
    """The ``auth`` operation of this moment, as rosauth's ``ros_mac_authentication`` checks it; None without a secret.

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
            filled(
                QT_TR_NOOP("The robot demands a secret, and the environment variable {rosauth_secret_env} is not set."),
                rosauth_secret_env=settings.rosauth_secret_env,
            ),
            QT_TR_NOOP("Set it to the robot's rosauth secret before the console is started."),
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
    """What to tell of a server that does not understand the offer of a secured connection."""
    return (
        filled(QT_TR_NOOP("What answers at {address} does not speak TLS."), address=address),
        "If the robot's rosbridge is not secured, its address begins with ws:// instead of wss://.",
    )


def explain_tls_failure(error: ssl.SSLError, name: str, address: str) -> tuple[str, str]:
    """Why the secured connection to ``name`` did not come about, and what to do, for the wizard."""
    if not isinstance(error, ssl.SSLCertVerificationError):
        if error.reason in ("WRONG_VERSION_NUMBER", "HTTP_REQUEST", "PACKET_LENGTH_TOO_LONG"):
            return no_tls(address)
        return (
            filled(
                QT_TR_NOOP("No secured connection to {name} came about ({error})."),
                name=name,
                error=error.reason or error,
            ),
            QT_TR_NOOP("Check the TLS settings of the robot's rosbridge (certfile, keyfile)."),
        )
    code = error.verify_code
    if code == _EXPIRED:
        return (
            filled(QT_TR_NOOP("The certificate of {name} has expired."), name=name),
            QT_TR_NOOP("Renew it on the robot. If it is still valid, check this computer's date."),
        )
    if code == _NOT_YET_VALID:
        return (
            filled(QT_TR_NOOP("The certificate of {name} is not valid yet."), name=name),
            QT_TR_NOOP("Check the date of this computer and of the robot."),
        )
    if code in (_WRONG_NAME, _WRONG_IP):
        return (
            filled(
                QT_TR_NOOP("The certificate of what answers at {address} is for another name than {name}."),
                address=address,
                name=name,
            ),
            QT_TR_NOOP(
                "Use the name that stands in the certificate as the address, or give the robot a certificate for"
                " this one."
            ),
        )
    if code in _UNTRUSTED:
        return (
            filled(
                QT_TR_NOOP("The certificate of {name} is not trusted: nobody known to this computer signed it."),
                name=name,
            ),
            QT_TR_NOOP("If it is the robot's own, name its file under Security ('ca_file' in the robot profile)."),
        )
    return (
        filled(
            QT_TR_NOOP("The certificate of {name} was not accepted ({verify_message})."),
            name=name,
            verify_message=error.verify_message,
        ),
        QT_TR_NOOP("Check the certificate on the robot."),
    )
