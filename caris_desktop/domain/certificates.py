"""TLS certificates of servers: acceptance, fingerprints, and reasons for a refusal.

Acceptance does not depend on the Python version: 3.13 refuses certificates without extensions, which most self-signed
ones lack (``VERIFY_X509_STRICT``). That adds no protection from an impostor; signer, name and dates are checked.
"""

import contextlib
import datetime
import functools
import hashlib
import ipaddress
import ssl
from pathlib import Path
from typing import TYPE_CHECKING

from caris_desktop.domain.foreign_text import typed_path
from caris_desktop.domain.translation import QT_TR_NOOP, localized

if TYPE_CHECKING:
    from cryptography import x509

_NO_CHECK_TIME = 0x200000  # X509_V_FLAG_NO_CHECK_TIME of OpenSSL, which the ssl module does not name
_EXPIRED, _NOT_YET_VALID = 10, 9
_OTHER_NAME = (62, 64)
_SELF_SIGNED = 18
_UNTRUSTED = (_SELF_SIGNED, 19, 20, 21)
_LOOK_WITHIN_S = 3.0
_MOST_NAMES, _LONGEST_NAME = 5, 80


class OtherCertificateError(ssl.SSLError):
    """The server has another certificate than the one that the user confirmed."""


def client_context(ca_file: str | None = None) -> ssl.SSLContext:
    """TLS context that trusts the system's authorities and each certificate in a file, whoever
    signed it.

    Raises OSError if the file cannot be used; its subclass ``ssl.SSLError`` if it contains no certificate.
    """
    context = as_on_every_python(ssl.create_default_context())
    if ca_file is not None:
        context.load_verify_locations(typed_path(ca_file))
    return context


class WrongFilesError(Exception):
    """Files with which a server cannot prove its identity; the text says why."""


def server_context(certificate: Path | None, key: Path | None) -> ssl.SSLContext | None:
    """For a server with these PEM files, None without any. Raises WrongFilesError."""
    if certificate is None and key is None:
        return None
    if certificate is None or key is None:
        raise WrongFilesError("A certificate (--cert) and its key (--key) must be given together.")
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(certificate, key)
    except OSError as error:
        raise WrongFilesError(f"The certificate {certificate} and the key {key} cannot be used: {error}.") from error
    return context


def as_on_every_python(context: ssl.SSLContext) -> ssl.SSLContext:
    """Same context with the checks of Python before 3.13."""
    context.verify_flags = (context.verify_flags | ssl.VERIFY_X509_PARTIAL_CHAIN) & ~ssl.VERIFY_X509_STRICT
    return context


def confirmed_context(fingerprint: str, host: str, port: int) -> ssl.SSLContext:
    """TLS context that trusts one certificate only, whatever its name, dates and signer.

    Blocks, since it requests the certificate from the server; OpenSSL verifies that the actual connection has the same.

    Raises OtherCertificateError if the server has another one. Raises OSError if the server does not answer.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_flags = as_on_every_python(context).verify_flags | _NO_CHECK_TIME
    context.load_verify_locations(cadata=_confirmed(fingerprint_bytes(fingerprint), host, port))
    return context


@functools.lru_cache(maxsize=16)
def _confirmed(fingerprint: bytes, host: str, port: int) -> bytes:
    certificate = certificate_of(host, port)
    if hashlib.sha256(certificate).digest() != fingerprint:
        raise OtherCertificateError("another certificate")
    return certificate


def certificate_of(host: str, port: int) -> bytes:
    """Unverified certificate (DER) of a server. Raises OSError if it does not answer with one."""
    return ssl.PEM_cert_to_DER_cert(ssl.get_server_certificate((host, port), timeout=_LOOK_WITHIN_S))


def fingerprint_bytes(fingerprint: str) -> bytes:
    """Bytes of a SHA-256 fingerprint as people copy it. Raises ValueError for anything else."""
    digest = bytes.fromhex(fingerprint.replace(":", ""))
    if len(digest) != hashlib.sha256().digest_size:
        raise ValueError("no SHA-256")
    return digest


def fingerprint_of(certificate: bytes) -> str:
    """Fingerprint as ``openssl x509 -noout -fingerprint -sha256`` writes it."""
    return hashlib.sha256(certificate).digest().hex(":").upper()


def trusted_context(confirmed: str, host: str, port: int) -> ssl.SSLContext:
    """Context for clients of a server, with the only fingerprint that the user ``confirmed``, if any. Raises OSError,
    and ValueError where it is no fingerprint.
    """
    return confirmed_context(confirmed, host, port) if confirmed else client_context()


def refusal_of(error: ssl.SSLError, host: str, port: int) -> tuple[tuple[str, ...], tuple[str, ...], str]:
    """Reasons and advice as :func:`why_refused`, with the fingerprint of the server's certificate, empty if unknown."""
    certificate = None
    with contextlib.suppress(OSError, ValueError):
        certificate = certificate_of(host, port)
    return (*why_refused(error, host, certificate), "" if certificate is None else fingerprint_of(certificate))


def why_refused(error: ssl.SSLError, name: str, certificate: bytes | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """All problems of the certificate of ``name`` and the advice for them, as sentences.

    OpenSSL reports the first problem only; the others are found in the server's ``certificate``.
    """
    if not isinstance(error, ssl.SSLCertVerificationError):
        message = QT_TR_NOOP("No secure connection to {name} could be established ({reason}).")
        return (localized(message, name=name, reason=error.reason or error),), ()
    code = error.verify_code
    certificate_fields = None if certificate is None else _read(certificate)
    now = datetime.datetime.now(datetime.UTC)
    messages: list[str] = []
    advice: list[str] = []
    if code in _UNTRUSTED:
        by_itself = code == _SELF_SIGNED or (
            certificate_fields is not None and certificate_fields.issuer == certificate_fields.subject
        )
        messages.append(
            QT_TR_NOOP("The certificate of {name} is not trusted: it is self-signed.")
            if by_itself
            else QT_TR_NOOP("The certificate of {name} is not trusted: this computer does not know its issuer.")
        )
    if code == _EXPIRED or (certificate_fields is not None and now > certificate_fields.not_valid_after_utc):
        messages.append(QT_TR_NOOP("The certificate of {name} has expired."))
        advice.append(QT_TR_NOOP("Renew it on the server. If it is still valid, check this computer's date."))
    if code == _NOT_YET_VALID or (certificate_fields is not None and now < certificate_fields.not_valid_before_utc):
        messages.append(QT_TR_NOOP("The certificate of {name} is not valid yet."))
        advice.append(QT_TR_NOOP("Check the date of this computer and of the server."))
    names = None if certificate_fields is None else _names_of(certificate_fields)
    if code in _OTHER_NAME or (names is not None and not any(_is_name_of(each, name) for each in names)):
        message = QT_TR_NOOP("The server that responds as {name} has a certificate for another name: {names}.")
        if names == ():
            message = QT_TR_NOOP(
                "The certificate of {name} does not name a server: the extension subjectAltName is missing."
            )
        elif names is None:
            message = QT_TR_NOOP("The server that responds as {name} has a certificate for another name.")
        messages.append(localized(message, names=", ".join(names or ())))
        advice.append(
            QT_TR_NOOP(
                "Use a name from the certificate as the address, or give the server a certificate for this address."
            )
        )
    if not messages:
        message = QT_TR_NOOP("The certificate of {name} was not accepted ({reason}).")
        messages.append(localized(message, reason=error.verify_message))
        advice.append(QT_TR_NOOP("Check the certificate on the server."))
    return tuple(localized(sentence, name=name) for sentence in messages), tuple(advice)


def _read(certificate: bytes) -> "x509.Certificate | None":
    from cryptography import x509

    try:
        return x509.load_der_x509_certificate(certificate)
    except ValueError:
        return None


def _names_of(certificate: "x509.Certificate") -> tuple[str, ...] | None:
    """Names and addresses of servers, as plain text; None if unreadable."""
    from cryptography import x509

    try:
        held = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return ()
    except ValueError:
        return None
    found = [*held.get_values_for_type(x509.DNSName), *map(str, held.get_values_for_type(x509.IPAddress))]
    return tuple("".join(filter(str.isprintable, name))[:_LONGEST_NAME] for name in found[:_MOST_NAMES])


def _is_name_of(given: str, name: str) -> bool:
    """Whether a name of the certificate matches, for the explanation only; OpenSSL decides on acceptance."""
    try:
        return ipaddress.ip_address(given) == ipaddress.ip_address(name)
    except ValueError:
        given, name = given.lower(), name.lower().rstrip(".")
        return given == name or (given.startswith("*.") and given[1:] == name[name.find(".") :])
