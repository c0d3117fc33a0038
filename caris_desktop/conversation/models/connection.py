"""Connections to language models, all opened here, their API keys, model lists and versions."""

import asyncio
import importlib
import logging
import os
import socket
import ssl
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from functools import cache
from typing import TYPE_CHECKING, Any, TypeAlias
from urllib.parse import urlsplit
from weakref import WeakKeyDictionary

from caris_desktop.conversation.models.endpoint import LanguageModelError, ModelEndpoint, bad_address, shortened
from caris_desktop.conversation.models.question import recorded_name, small_object
from caris_desktop.domain.address import is_encrypted_or_local, is_loopback, is_loopback_host
from caris_desktop.domain.certificates import as_on_every_python
from caris_desktop.domain.translation import QT_TR_NOOP, localized

if TYPE_CHECKING:
    import httpx

_log = logging.getLogger(__name__)
KEYRING_SERVICE = "caris-desktop"
_KEYRING_TIMEOUT_S = 5.0
_SHOWS_WITHIN_S = 5.0
# Includes licence, template and all tensors.
_MAX_SHOWN_BYTES = 20_000_000


def check_place(endpoint: ModelEndpoint, *, local_only: bool) -> None:
    """Raises LanguageModelError, with ``local_only``, for a model that is known to be on another computer."""
    if local_only and endpoint.leaves_computer:
        raise _elsewhere(endpoint)


def _elsewhere(endpoint: ModelEndpoint) -> LanguageModelError:
    return LanguageModelError(
        localized(
            QT_TR_NOOP("{place} is not on this computer, and this scenario allows only local models."),
            place=endpoint.place,
        ),
        QT_TR_NOOP("Nothing was sent."),
        QT_TR_NOOP("Choose the embedded model, or one that runs on this computer."),
    )


async def check_model_is_here(client: "httpx.AsyncClient", endpoint: ModelEndpoint) -> None:
    """Raises LanguageModelError for an Ollama model that is an alias of a cloud model.

    https://docs.ollama.com/api: ``show`` names where such a model is; an Ollama that does not know it has no cloud.
    """
    if endpoint.provider != "ollama":
        return
    request = client.build_request("POST", "api/show", json={"model": endpoint.model}, timeout=_SHOWS_WITHIN_S)
    response = await send(client, request)
    try:
        details = await small_object(response, _MAX_SHOWN_BYTES) if response.status_code == 200 else {}
    finally:
        await response.aclose()
    if details.get("remote_host") or details.get("remote_model"):
        raise _elsewhere(endpoint)


@asynccontextmanager
async def connected(endpoint: ModelEndpoint, *, local_only: bool) -> "AsyncIterator[httpx.AsyncClient]":
    """Client for this server. It follows no redirects, so that a server cannot forward it to another one.

    Raises LanguageModelError, with ``local_only`` also for other computers, before anything is sent or resolved.
    """
    check_place(endpoint, local_only=local_only)
    if local_only and not await _is_here(endpoint):
        raise _elsewhere(endpoint)
    yield await _client(endpoint)


_Clients: TypeAlias = "dict[str, tuple[httpx.AsyncClient, AsyncGenerator[None]]]"
_CLIENTS: WeakKeyDictionary[asyncio.AbstractEventLoop, _Clients] = WeakKeyDictionary()
_IDLE_S = 90.0
"""So long an open connection waits for the next question: people speak in turns, and to open one takes round trips."""


async def _client(endpoint: ModelEndpoint) -> "httpx.AsyncClient":
    """One client per server, with its connections, until the event loop ends. Raises LanguageModelError."""
    import httpx

    clients = _CLIENTS.setdefault(asyncio.get_running_loop(), {})
    if endpoint.base_url in clients:
        return clients[endpoint.base_url][0]
    try:
        client = httpx.AsyncClient(
            base_url=endpoint.base_url.rstrip("/") + "/",
            headers={"Accept-Encoding": "identity"},
            # A proxy from the environment must not receive requests to this computer.
            trust_env=not is_loopback(endpoint.base_url),
            follow_redirects=False,
            verify=_certificates() if urlsplit(endpoint.base_url).scheme == "https" else _no_certificates(),
            limits=httpx.Limits(keepalive_expiry=_IDLE_S),
        )
    except httpx.InvalidURL as error:
        raise bad_address(endpoint.base_url, QT_TR_NOOP("the endpoint")) from error
    except (ImportError, ValueError) as error:
        raise LanguageModelError(
            localized(
                QT_TR_NOOP("The proxy settings of this computer are invalid ({error})."), error=shortened(str(error))
            ),
            QT_TR_NOOP("The assistant cannot answer."),
            QT_TR_NOOP("Correct HTTP_PROXY, HTTPS_PROXY or ALL_PROXY, or choose a local model."),
        ) from error
    held = _until_the_loop_ends(client)
    await anext(held)
    clients[endpoint.base_url] = client, held
    return client


async def _until_the_loop_ends(client: "httpx.AsyncClient") -> AsyncGenerator[None]:
    """Close the client when the event loop shuts down its unfinished generators."""
    try:
        yield
    finally:
        await client.aclose()


async def send(client: "httpx.AsyncClient", request: "httpx.Request") -> "httpx.Response":
    """Send a request and return the response after its headers; reconnects if the server closed the connection."""
    import httpx

    opened: list[str] = []

    async def trace(event: str, _info: object) -> None:
        if event.startswith("connection.connect"):
            opened.append(event)

    request.extensions["trace"] = trace
    while True:
        try:
            return await client.send(request, stream=True)
        except (httpx.RemoteProtocolError, httpx.ReadError, httpx.WriteError):
            if opened:
                raise


@cache
def _certificates() -> ssl.SSLContext:
    """Trusted certificate authorities, cached, since reading them takes longer than connecting."""
    import httpx

    return as_on_every_python(httpx.create_ssl_context())


@cache
def _no_certificates() -> ssl.SSLContext:
    """Context without trusted authorities, for unencrypted addresses."""
    return ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)


async def _is_here(endpoint: ModelEndpoint) -> bool:
    """True if every address of the host is on this computer; "localhost" is only a name."""
    host = urlsplit(endpoint.base_url).hostname or ""
    try:
        found = await asyncio.get_running_loop().getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except OSError:
        return False
    return bool(found) and all(is_loopback_host(str(address[0])) for *_, address in found)


async def api_key(endpoint: ModelEndpoint) -> str | None:
    """API key, None if there is none. Raises LanguageModelError if it is required or unusable."""
    if not endpoint.key_names:
        return None
    name, key = "", ""
    for name in endpoint.key_names:
        key = os.environ.get(name, "").strip()
        if key:
            break
    if not key and endpoint.provider != "embedded":
        try:
            async with asyncio.timeout(_KEYRING_TIMEOUT_S):
                name, key = await asyncio.to_thread(_key_from_keyring, endpoint.key_names)
        except TimeoutError:
            _log.warning("the system keyring did not answer within %.0f s", _KEYRING_TIMEOUT_S)
    if not key and (endpoint.is_openai or endpoint.provider == "gemini"):
        raise LanguageModelError(
            QT_TR_NOOP("Gemini requires a key, and none is set.")
            if endpoint.provider == "gemini"
            else QT_TR_NOOP("OpenAI requires a key, and none is set."),
            QT_TR_NOOP("The assistant cannot answer."),
            localized(
                QT_TR_NOOP(
                    "Set the environment variable {name} before starting the console, save the key in the "
                    "system keyring (keyring set {service} {name}), or choose another model."
                ),
                name=endpoint.key_names[0],
                service=KEYRING_SERVICE,
            ),
        )
    if key and not (key.isascii() and key.isprintable()):
        raise LanguageModelError(
            localized(QT_TR_NOOP("The key in {name} contains invalid characters."), name=name),
            QT_TR_NOOP("The assistant cannot answer."),
            localized(QT_TR_NOOP("Set {name} again, without line breaks or quotation marks."), name=name),
        )
    if key and not is_encrypted_or_local(endpoint.base_url):
        raise LanguageModelError(
            localized(
                QT_TR_NOOP("The key in {name} would be sent unencrypted to {place}."), name=name, place=endpoint.place
            ),
            QT_TR_NOOP("Nothing was sent."),
            localized(
                QT_TR_NOOP("Give the server an https:// address, or remove {name} if it needs no key."), name=name
            ),
        )
    return key or None


def _key_from_keyring(names: tuple[str, ...]) -> tuple[str, str]:
    """Name and content of the first existing entry."""
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


_MAX_LIST_BYTES = 1_000_000
_LIST_TIMEOUT_S = 5.0
_MOST_LISTED = 100
_DIGEST_DIGITS = 12


async def model_version(endpoint: ModelEndpoint, *, local_only: bool) -> str:
    """Model version from the server; empty if unknown or without an answer.

    Ollama lists a digest per model, the embedded server its loaded weights. Other servers send it with every answer.
    """
    if endpoint.provider not in ("ollama", "embedded"):
        return ""
    listed = await _listed(endpoint, local_only=local_only)
    if endpoint.provider == "ollama":
        # Ollama resolves a name without a tag to latest.
        names = (endpoint.model, f"{endpoint.model}:latest")
        models = listed.get("models")
        for model in models if isinstance(models, list) else ():
            if isinstance(model, dict) and (model.get("name") in names or model.get("model") in names):
                digest = str(model.get("digest", "")).removeprefix("sha256:")
                if len(digest) >= _DIGEST_DIGITS and set(digest.lower()) <= set("0123456789abcdef"):
                    return f"sha256:{digest[:_DIGEST_DIGITS]}"
        return ""
    loaded = listed.get("data")
    first = loaded[0] if isinstance(loaded, list) and loaded else None
    return recorded_name(endpoint, first.get("id")) if isinstance(first, dict) else ""


async def models_here(endpoint: ModelEndpoint) -> tuple[str, ...]:
    """Names of the models on a local server; empty if it is remote or does not answer.

    Remote servers are not asked: a list does not justify a request that leaves this computer.
    """
    if endpoint.leaves_computer:
        return ()
    listed = await _listed(endpoint, local_only=True)
    models = listed.get("models" if endpoint.provider == "ollama" else "data")
    key = "name" if endpoint.provider == "ollama" else "id"
    names = [
        recorded_name(endpoint, model.get(key))
        for model in (models if isinstance(models, list) else ())
        # Aliases of Ollama's cloud models are not local.
        if isinstance(model, dict) and not (model.get("remote_host") or model.get("remote_model"))
    ]
    return tuple(sorted({name for name in names if name}))[:_MOST_LISTED]


async def _listed(endpoint: ModelEndpoint, *, local_only: bool) -> dict[str, Any]:
    import httpx

    path = "api/tags" if endpoint.provider == "ollama" else "models"
    if endpoint.provider != "ollama" and not endpoint.base_url.rstrip("/").endswith("/v1"):
        path = f"v1/{path}"
    key = await api_key(endpoint) if endpoint.provider == "embedded" else None
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    try:
        async with (
            asyncio.timeout(_LIST_TIMEOUT_S),
            connected(endpoint, local_only=local_only) as client,
            client.stream("GET", path, headers=headers) as response,
        ):
            return await small_object(response, _MAX_LIST_BYTES) if response.status_code == 200 else {}
    except (httpx.HTTPError, httpx.InvalidURL, LanguageModelError, TimeoutError) as error:
        _log.info("%s does not list its models: %r", endpoint.place, error)
        return {}
