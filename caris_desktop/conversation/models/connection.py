"""The one place that opens a connection to a language model, and the keys that go over it."""

import asyncio
import importlib
import logging
import os
import socket
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from caris_desktop.conversation.models.endpoint import ModelEndpoint, bad_address
from caris_desktop.conversation.models.words import LanguageModelError, shortened
from caris_desktop.domain.address import is_encrypted_or_local, is_loopback, is_loopback_host
from caris_desktop.domain.certificates import as_on_every_python
from caris_desktop.domain.translation import QT_TR_NOOP, filled

if TYPE_CHECKING:
    import httpx

_log = logging.getLogger(__name__)
KEYRING_SERVICE = "caris-desktop"
_KEYRING_TIMEOUT_S = 5.0


def check_place(endpoint: ModelEndpoint, *, local_only: bool) -> None:
    """Raises LanguageModelError, with ``local_only``, for a model that says itself that it is not on this computer."""
    if local_only and endpoint.leaves_computer:
        raise _elsewhere(endpoint)


def _elsewhere(endpoint: ModelEndpoint) -> LanguageModelError:
    return LanguageModelError(
        filled(
            QT_TR_NOOP("{place} is not on this computer, and this scenario permits only models that are."),
            place=endpoint.place,
        ),
        QT_TR_NOOP("Nothing was sent."),
        QT_TR_NOOP("Choose the embedded model, or one that runs here."),
    )


@asynccontextmanager
async def connected(endpoint: ModelEndpoint, *, local_only: bool) -> "AsyncIterator[httpx.AsyncClient]":
    """A client for this server. It follows no redirect, so nobody can send it on to another one.

    Raises LanguageModelError, with ``local_only`` also for whatever is not this computer, before anything is sent or
    looked up.
    """
    import httpx

    check_place(endpoint, local_only=local_only)
    if local_only and not await _is_here(endpoint):
        raise _elsewhere(endpoint)
    here = is_loopback(endpoint.base_url)
    try:
        # A proxy from the environment must not see what is meant for this machine.
        opened = httpx.AsyncClient(
            base_url=endpoint.base_url.rstrip("/") + "/",
            headers={"Accept-Encoding": "identity"},
            trust_env=not here,
            follow_redirects=False,
            verify=_certificates() if urlsplit(endpoint.base_url).scheme == "https" else _no_certificates(),
        )
    except httpx.InvalidURL as error:
        raise bad_address(endpoint.base_url, QT_TR_NOOP("the endpoint")) from error
    except (ImportError, ValueError) as error:
        raise LanguageModelError(
            filled(
                QT_TR_NOOP("The proxy settings of this computer cannot be used ({error})."), error=shortened(str(error))
            ),
            QT_TR_NOOP("The assistant cannot answer."),
            QT_TR_NOOP("Correct HTTP_PROXY, HTTPS_PROXY or ALL_PROXY, or choose a local model."),
        ) from error
    async with opened:
        yield opened


@cache
def _certificates() -> ssl.SSLContext:
    """Who may vouch for a server. To read them takes longer than to open a connection, so they are read once."""
    import httpx

    return as_on_every_python(httpx.create_ssl_context())


@cache
def _no_certificates() -> ssl.SSLContext:
    """For addresses that are not encrypted: nobody is trusted, should one turn out to be so after all."""
    return ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)


async def _is_here(endpoint: ModelEndpoint) -> bool:
    """Whether every address of its host is this computer's; "localhost" is only a name."""
    host = urlsplit(endpoint.base_url).hostname or ""
    try:
        found = await asyncio.get_running_loop().getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except OSError:
        return False
    return bool(found) and all(is_loopback_host(str(address[0])) for *_, address in found)


async def api_key(endpoint: ModelEndpoint) -> str | None:
    """The key to send along, None where there is none. Raises LanguageModelError where it is needed or unusable."""
    if not endpoint.key_names:
        return None
    name, key = "", ""
    for name in endpoint.key_names:
        key = os.environ.get(name, "").strip()
        if key:
            break
    if not key:
        try:
            async with asyncio.timeout(_KEYRING_TIMEOUT_S):
                name, key = await asyncio.to_thread(_key_from_keyring, endpoint.key_names)
        except TimeoutError:
            _log.warning("the system keyring did not answer within %.0f s", _KEYRING_TIMEOUT_S)
    if not key and (endpoint.is_openai or endpoint.provider == "gemini"):
        raise LanguageModelError(
            QT_TR_NOOP("Gemini answers only with a key, and there is none.")
            if endpoint.provider == "gemini"
            else QT_TR_NOOP("OpenAI answers only with a key, and there is none."),
            QT_TR_NOOP("The assistant cannot answer."),
            filled(
                QT_TR_NOOP(
                    "Set the environment variable {name} before starting the console, keep the key in the system"
                    " keyring (keyring set {service} {name}), or choose another model."
                ),
                name=endpoint.key_names[0],
                service=KEYRING_SERVICE,
            ),
        )
    if key and not (key.isascii() and key.isprintable()):
        raise LanguageModelError(
            filled(QT_TR_NOOP("The key in {name} has characters that no key has."), name=name),
            QT_TR_NOOP("The assistant cannot answer."),
            filled(QT_TR_NOOP("Set {name} again, without line breaks or quotation marks."), name=name),
        )
    if key and not is_encrypted_or_local(endpoint.base_url):
        raise LanguageModelError(
            filled(QT_TR_NOOP("The key in {name} would go unencrypted to {place}."), name=name, place=endpoint.place),
            QT_TR_NOOP("Nothing was sent."),
            filled(QT_TR_NOOP("Give the server an https:// address, or remove {name} if it needs no key."), name=name),
        )
    return key or None


def _key_from_keyring(names: tuple[str, ...]) -> tuple[str, str]:
    """The name of the first entry that is there, and what it holds."""
    try:
        keyring = importlib.import_module("keyring")
    except ImportError:
        return names[0], ""
    for name in names:
        try:
            key = str(keyring.get_password(KEYRING_SERVICE, name) or "").strip()
        except keyring.errors.NoKeyringError:
            _log.info("this computer has no system keyring")
            break
        except keyring.errors.KeyringError:
            _log.warning("the system keyring cannot be read", exc_info=True)
            break
        if key:
            return name, key
    return names[0], ""
