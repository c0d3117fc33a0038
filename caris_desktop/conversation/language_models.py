"""Streaming chat with language models over HTTP: OpenAI-compatible servers and Ollama.

Long because two dialects of one API are told apart in one place.
"""

import asyncio
import base64
import importlib
import json
import logging
import os
import unicodedata
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Mapping, Sequence
from contextlib import aclosing, asynccontextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NoReturn
from urllib.parse import urlsplit

from caris_desktop.domain.address import is_loopback
from caris_desktop.domain.events import ChatMessage
from caris_desktop.domain.failure import ToldFailure

if TYPE_CHECKING:
    import httpx

_log = logging.getLogger(__name__)

Provider = Literal["embedded", "openai", "ollama"]

OPENAI_URL = "https://api.openai.com/v1"
OLLAMA_URL = "http://127.0.0.1:11434"
KEYRING_SERVICE = "caris-desktop"
MAX_LINE_BYTES = 1_000_000
MAX_ANSWER_CHARACTERS = 200_000
_MAX_ERROR_BODY_BYTES = 65_536
_MAX_LIST_BYTES = 1_000_000
_LIST_TIMEOUT_S = 5.0
_DIGEST_DIGITS = 12
_KEYRING_TIMEOUT_S = 5.0


class LanguageModelError(ToldFailure):
    """A language model did not answer."""


@dataclass(frozen=True, slots=True)
class ModelEndpoint:
    """Where a model is asked.

    ``base_url`` is the server; for OpenAI-compatible servers it may end with a path such as ``/v1``, which is added
    where there is none. ``api_key_env`` names the environment variable (and keyring entry) that holds the key, so that
    the key itself is never part of a value that could be logged or recorded.
    """

    provider: Provider
    base_url: str
    model: str
    api_key_env: str | None = None


@dataclass(frozen=True, slots=True)
class ChatTimeouts:
    """How long each step may take before the exchange counts as failed."""

    connect_s: float = 5.0
    first_token_s: float = 60.0
    between_tokens_s: float = 20.0


@dataclass(frozen=True, slots=True)
class _Chunk:
    """What one message of the stream said. ``alive`` is True for text the wizard does not see (a model's reasoning)."""

    text: str = ""
    alive: bool = False
    ended: bool = False
    version: str = ""


def resolve_endpoint(
    model: str, *, embedded_url: str | None, environment: Mapping[str, str] | None = None
) -> ModelEndpoint:
    """Turn a scenario's ``embedded``, ``ollama:NAME`` or ``openai:NAME`` into an endpoint.

    ``embedded_url`` is the address of the embedded server, None while there is none. ``OLLAMA_HOST`` and
    ``OPENAI_BASE_URL`` in ``environment`` (default: the process environment) move the other two.

    Raises
    ------
    LanguageModelError
        If the text is none of these, an address is unusable, or the embedded server is not running.
    """
    environment = os.environ if environment is None else environment
    provider, _, name = model.strip().partition(":")
    name = name.strip()
    if provider == "embedded" and not name:
        if embedded_url is None:
            raise LanguageModelError(
                "The embedded language model is not running.",
                "The assistant cannot answer.",
                "Wait until it has started; if it failed, the Session log says why.",
            )
        return ModelEndpoint("embedded", _checked_url(embedded_url, "the embedded server's address"), "embedded")
    if provider == "ollama" and name:
        host = environment.get("OLLAMA_HOST", "").strip()
        return ModelEndpoint("ollama", _ollama_url(host) if host else OLLAMA_URL, name)
    if provider == "openai" and name:
        base_url = environment.get("OPENAI_BASE_URL", "").strip() or OPENAI_URL
        return ModelEndpoint("openai", _checked_url(base_url, "OPENAI_BASE_URL"), name, "OPENAI_API_KEY")
    raise LanguageModelError(
        f"“{_shortened(model)}” names no language model.",
        "The assistant cannot answer in this scenario.",
        "Set assistant.model to embedded, ollama:NAME or openai:NAME.",
    )


async def stream_chat(
    endpoint: ModelEndpoint,
    messages: Sequence[ChatMessage],
    *,
    max_tokens: int,
    temperature: float,
    seed: int | None = None,
    told_version: Callable[[str], None] | None = None,
    timeouts: ChatTimeouts = ChatTimeouts(),
    jpeg: bytes | None = None,
) -> AsyncGenerator[str]:
    """Yield the answer piece by piece as the model writes it.

    ``seed`` makes the same model answer the same question alike; it is sent only to servers of which
    :func:`takes_seed` knows that they take it. ``told_version`` is called with what the server tells of the model in
    the stream, when it does and differently from before; Ollama tells nothing there, see `model_version`. ``jpeg`` is a
    picture that goes with the last message; the embedded model takes none.

    Closing the generator, or cancelling the task that iterates it, closes the HTTP stream, which makes the servers
    stop generating.

    Raises
    ------
    LanguageModelError
        For every failure, including an answer that breaks off after some pieces were yielded.
    """
    import httpx

    loop = asyncio.get_running_loop()
    api_key = await _api_key(endpoint)
    url, body = _request(endpoint, messages, max_tokens=max_tokens, temperature=temperature, seed=seed, jpeg=jpeg)
    headers = {"Accept-Encoding": "identity"} | ({"Authorization": f"Bearer {api_key}"} if api_key else {})
    limits = httpx.Timeout(connect=timeouts.connect_s, read=None, write=timeouts.connect_s, pool=timeouts.connect_s)
    parse = _parse_ollama if endpoint.provider == "ollama" else _parse_openai
    deadline_s = loop.time() + timeouts.connect_s + timeouts.first_token_s
    answer_started = ended = False
    characters = 0
    version = ""
    try:
        async with _client(url) as client:
            request = client.build_request("POST", url, json=body, headers=headers, timeout=limits)
            async with asyncio.timeout_at(deadline_s):
                response = await client.send(request, stream=True)
            try:
                if response.status_code != 200:
                    async with asyncio.timeout_at(deadline_s):
                        detail = await _error_body(response)
                    _raise_status(endpoint, response.status_code, _without(api_key, detail))
                async with aclosing(_documents(endpoint, response)) as documents:
                    while not ended:
                        try:
                            async with asyncio.timeout_at(deadline_s):
                                document = await anext(documents)
                        except StopAsyncIteration:
                            break
                        chunk = parse(endpoint, document, api_key)
                        ended = chunk.ended
                        if chunk.version and chunk.version != version:
                            version = chunk.version
                            if told_version is not None:
                                told_version(version)
                        if chunk.text or chunk.alive:
                            answer_started = True
                            deadline_s = loop.time() + timeouts.between_tokens_s
                        if chunk.text:
                            characters += len(chunk.text)
                            if characters > MAX_ANSWER_CHARACTERS:
                                _raise_nonsense(endpoint, "the answer does not end")
                            before_s = loop.time()
                            yield chunk.text
                            deadline_s += loop.time() - before_s
            finally:
                await response.aclose()
    except httpx.HTTPError as error:
        raise _from_httpx(endpoint, error, answer_started=answer_started) from error
    except httpx.InvalidURL as error:
        raise _bad_address(endpoint.base_url, "the endpoint") from error
    except TimeoutError as error:
        raise _too_slow(endpoint, timeouts, answer_started=answer_started) from error
    if not ended:
        raise _broke_off(endpoint)


async def model_version(endpoint: ModelEndpoint) -> str:
    """What the server tells of its model outside of a question; empty where it tells nothing or does not answer.

    Ollama lists the digest of each model, the embedded server the weights it has loaded. Other servers tell it with
    every answer.
    """
    if endpoint.provider == "openai":
        return ""
    import httpx

    path = "/api/tags" if endpoint.provider == "ollama" else "/v1/models"
    url = endpoint.base_url.rstrip("/") + path
    try:
        async with (
            asyncio.timeout(_LIST_TIMEOUT_S),
            _client(url) as client,
            client.stream("GET", url, headers={"Accept-Encoding": "identity"}) as response,
        ):
            listed = await _small_object(response, _MAX_LIST_BYTES) if response.status_code == 200 else {}
    except (httpx.HTTPError, httpx.InvalidURL, LanguageModelError, TimeoutError) as error:
        _log.info("%s does not tell the version of its model: %r", _place(endpoint), error)
        return ""
    if endpoint.provider == "ollama":
        return _listed_digest(endpoint, listed)
    loaded = listed.get("data")
    first = loaded[0] if isinstance(loaded, list) and loaded else None
    return _told_name(endpoint, first.get("id")) if isinstance(first, dict) else ""


def _listed_digest(endpoint: ModelEndpoint, listed: dict[str, Any]) -> str:
    # Ollama takes a name without a tag for the latest.
    names = {endpoint.model, f"{endpoint.model}:latest"}
    models = listed.get("models")
    for model in models if isinstance(models, list) else ():
        if isinstance(model, dict) and (model.get("name") in names or model.get("model") in names):
            digest = str(model.get("digest", "")).removeprefix("sha256:")
            if len(digest) >= _DIGEST_DIGITS and set(digest.lower()) <= set("0123456789abcdef"):
                return f"sha256:{digest[:_DIGEST_DIGITS]}"
    return ""


def _told_version(endpoint: ModelEndpoint, message: dict[str, Any], api_key: str | None) -> str:
    """The model and its fingerprint as a message of the stream tells them."""
    told = [_told_name(endpoint, message.get("model"), api_key)]
    if endpoint.provider != "embedded":  # the fingerprint of this program's own build says nothing
        told.append(_told_name(endpoint, message.get("system_fingerprint"), api_key))
    return " ".join(part for part in told if part)


def _told_name(endpoint: ModelEndpoint, told: object, api_key: str | None = None) -> str:
    """A name that a server told, fit for the record: no key, no address, of a path of its computer the last part."""
    if not isinstance(told, str) or "://" in told or urlsplit(endpoint.base_url).netloc.lower() in told.lower():
        return ""
    if told.startswith(("/", "~", ".")) or "\\" in told:
        told = told.replace("\\", "/").rstrip("/").rpartition("/")[2]
    return _shortened(_without(api_key, told), 100)


async def _api_key(endpoint: ModelEndpoint) -> str | None:
    name = endpoint.api_key_env
    if name is None:
        return None
    key = os.environ.get(name, "").strip()
    if not key:
        try:
            async with asyncio.timeout(_KEYRING_TIMEOUT_S):
                key = await asyncio.to_thread(_key_from_keyring, name)
        except TimeoutError:
            _log.warning("the system keyring did not answer within %.0f s", _KEYRING_TIMEOUT_S)
    if not key and _is_openai(endpoint):
        raise LanguageModelError(
            "OpenAI answers only with a key, and there is none.",
            "The assistant cannot answer.",
            f"Set the environment variable {name} before starting the console, or choose another model.",
        )
    if key and not (key.isascii() and key.isprintable()):
        raise LanguageModelError(
            f"The key in {name} has characters that no key has.",
            "The assistant cannot answer.",
            f"Set {name} again, without line breaks or quotation marks.",
        )
    if key and urlsplit(endpoint.base_url).scheme == "http" and not is_loopback(endpoint.base_url):
        _log.warning("the key in %s goes unencrypted to %s", name, _place(endpoint))
    return key or None


def _key_from_keyring(name: str) -> str:
    try:
        keyring = importlib.import_module("keyring")
    except ImportError:
        return ""
    try:
        return str(keyring.get_password(KEYRING_SERVICE, name) or "").strip()
    except keyring.errors.KeyringError:
        _log.warning("the system keyring cannot be read", exc_info=True)
        return ""


def takes_seed(endpoint: ModelEndpoint) -> bool:
    """Whether the server takes a seed. Some that only copy OpenAI's API refuse a question with a field too many."""
    return endpoint.provider != "openai" or is_loopback(endpoint.base_url) or _is_openai(endpoint)


def server_of(endpoint: ModelEndpoint) -> str:
    """The host that is asked, with its port; nothing that gives access to it."""
    return urlsplit(endpoint.base_url).netloc.rpartition("@")[2]


def _is_openai(endpoint: ModelEndpoint) -> bool:
    return urlsplit(endpoint.base_url).hostname == urlsplit(OPENAI_URL).hostname


def _request(
    endpoint: ModelEndpoint,
    messages: Sequence[ChatMessage],
    *,
    max_tokens: int,
    temperature: float,
    seed: int | None,
    jpeg: bytes | None = None,
) -> tuple[str, dict[str, Any]]:
    seeded: dict[str, Any] = {"seed": seed} if seed is not None and takes_seed(endpoint) else {}
    written: list[dict[str, Any]] = [{"role": message.role, "content": message.content} for message in messages]
    if jpeg is not None:
        _attach(endpoint, written[-1], jpeg)
    if endpoint.provider == "ollama":
        return endpoint.base_url.rstrip("/") + "/api/chat", {
            "model": endpoint.model,
            "messages": written,
            "stream": True,
            "options": {"num_predict": max_tokens, "temperature": temperature, **seeded},
        }
    base_url = endpoint.base_url.rstrip("/")
    parts = urlsplit(base_url)
    # OpenAI's newer models refuse the old name, the servers that copy its API often know no other.
    limit_name = "max_completion_tokens" if _is_openai(endpoint) else "max_tokens"
    return base_url + ("" if parts.path else "/v1") + "/chat/completions", {
        "model": endpoint.model,
        "messages": written,
        "stream": True,
        limit_name: max_tokens,
        "temperature": temperature,
        **seeded,
    }


def _attach(endpoint: ModelEndpoint, message: dict[str, Any], jpeg: bytes) -> None:
    """Put a picture to a message, as each of the two dialects has it. Raises LanguageModelError."""
    if endpoint.provider == "embedded":
        raise LanguageModelError(
            "The language model of this program cannot see pictures.",
            "The assistant cannot answer.",
            "Ask without the photo, or choose another model in the scenario.",
        )
    picture = base64.b64encode(jpeg).decode("ascii")
    if endpoint.provider == "ollama":
        message["images"] = [picture]
    else:
        message["content"] = [
            {"type": "text", "text": message["content"]},
            {"type": "image_url", "image_url": {"url": f"data:image/jpeg;base64,{picture}"}},
        ]


@asynccontextmanager
async def _client(url: str) -> "AsyncIterator[httpx.AsyncClient]":
    import httpx

    try:
        # A proxy from the environment must not see what is meant for this machine.
        opened = httpx.AsyncClient(trust_env=not is_loopback(url))
    except (ImportError, ValueError) as error:
        raise LanguageModelError(
            f"The proxy settings of this computer cannot be used ({_shortened(str(error))}).",
            "The assistant cannot answer.",
            "Correct HTTP_PROXY, HTTPS_PROXY or ALL_PROXY, or choose a local model.",
        ) from error
    async with opened:
        yield opened


async def _documents(endpoint: ModelEndpoint, response: "httpx.Response") -> AsyncGenerator[str]:
    """The JSON texts of the stream: lines for Ollama, the data of server-sent events otherwise."""
    data: list[str] = []
    size = 0
    async with aclosing(_lines(endpoint, response)) as lines:
        async for line in lines:
            if endpoint.provider == "ollama":
                if line.strip():
                    yield line
            elif line.startswith("data:"):
                data.append(line[5:].removeprefix(" "))
                size += len(line)
                if size > MAX_LINE_BYTES:
                    _raise_nonsense(endpoint, "one message is over a megabyte")
            elif line.lstrip().startswith("{"):
                # Some servers answer with a bare JSON error in a stream that began well.
                yield line
            elif not line and data:
                yield "\n".join(data)
                data, size = [], 0
    if data:
        yield "\n".join(data)


async def _lines(endpoint: ModelEndpoint, response: "httpx.Response") -> AsyncGenerator[str]:
    """Lines without their ends; unlike httpx's own, bounded in length."""
    pending = bytearray()
    async with aclosing(response.aiter_bytes()) as blocks:  # type: ignore[type-var]  # typed as an iterator
        async for block in blocks:
            *whole, rest = block.split(b"\n")
            for part in whole:
                pending += part
                if len(pending) > MAX_LINE_BYTES:
                    break
                yield _decoded(endpoint, bytes(pending).removesuffix(b"\r"))
                pending.clear()
            else:
                pending += rest
            if len(pending) > MAX_LINE_BYTES:
                _raise_nonsense(endpoint, "one line is over a megabyte")
    if pending:
        yield _decoded(endpoint, bytes(pending))


def _decoded(endpoint: ModelEndpoint, line: bytes) -> str:
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        _raise_nonsense(endpoint, "it is not UTF-8 text")


def _parse_openai(endpoint: ModelEndpoint, document: str, api_key: str | None) -> _Chunk:
    if document.strip() == "[DONE]":
        return _Chunk(ended=True)
    message = _json_object(endpoint, document)
    _raise_error_object(endpoint, message, api_key)
    choices = message.get("choices")
    if not isinstance(choices, list):
        _raise_nonsense(endpoint, "a message has no choices")
    version = _told_version(endpoint, message, api_key)
    if not choices:
        return _Chunk(version=version)
    choice = choices[0]
    delta = choice.get("delta") if isinstance(choice, dict) else None
    if not isinstance(delta, dict):
        _raise_nonsense(endpoint, "a choice has no delta")
    text = delta.get("content") or ""
    if not isinstance(text, str):
        _raise_nonsense(endpoint, "the content is not text")
    alive = bool(delta.get("reasoning_content") or delta.get("reasoning"))
    return _Chunk(text=text, alive=alive, ended=bool(choice.get("finish_reason")), version=version)


def _parse_ollama(endpoint: ModelEndpoint, document: str, api_key: str | None) -> _Chunk:
    message = _json_object(endpoint, document)
    _raise_error_object(endpoint, message, api_key)
    ended = message.get("done") is True
    inner = message.get("message")
    if inner is None and ended:
        return _Chunk(ended=True)
    if not isinstance(inner, dict) or not isinstance(inner.get("content", ""), str):
        _raise_nonsense(endpoint, "a message has no content")
    return _Chunk(text=inner.get("content", ""), alive=bool(inner.get("thinking")), ended=ended)


def _json_object(endpoint: ModelEndpoint, document: str) -> dict[str, Any]:
    try:
        message = json.loads(document)
    except (ValueError, RecursionError):
        _raise_nonsense(endpoint, f"“{_shortened(document, 60)}” is not JSON")
    if not isinstance(message, dict):
        _raise_nonsense(endpoint, "a message is not a JSON object")
    return message


def _raise_error_object(endpoint: ModelEndpoint, message: dict[str, Any], api_key: str | None) -> None:
    if message.get("error"):
        _log.warning("%s reported an error in the stream", _place(endpoint))
        raise LanguageModelError(
            f"{_place(endpoint)} stopped with an error: {_without(api_key, _error_text(message))}",
            "The answer is missing or incomplete.",
            "Ask again; if it happens again, choose another model or shorten the question.",
        )


def _error_text(message: dict[str, Any]) -> str:
    error = message.get("error", message.get("message", ""))
    if isinstance(error, dict):
        error = error.get("message", "")
    return _shortened(str(error)) if error else "no reason given"


async def _error_body(response: "httpx.Response") -> str:
    message = await _small_object(response, _MAX_ERROR_BODY_BYTES)
    return _error_text(message) if message else ""


async def _small_object(response: "httpx.Response", limit_bytes: int) -> dict[str, Any]:
    """The JSON object of a whole reply; empty when it is something else or longer."""
    body = bytearray()
    async for block in response.aiter_bytes():
        body += block
        if len(body) > limit_bytes:
            break
    try:
        message = json.loads(bytes(body))
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}


def _raise_status(endpoint: ModelEndpoint, status: int, detail: str) -> NoReturn:
    place = _place(endpoint)
    said = f" ({detail})" if detail else ""
    meaning = "The assistant cannot answer."
    _log.warning("%s answered with HTTP status %d", place, status)
    if status in (401, 403):
        key = endpoint.api_key_env or "the server's access rules"
        raise LanguageModelError(f"{place} refused access{said}.", meaning, f"Check {key}.")
    if status == 404:
        advice = (
            f"Run “ollama pull {endpoint.model}”, or choose another model."
            if endpoint.provider == "ollama"
            else "Check the model's name and the server's address."
        )
        raise LanguageModelError(f"{place} does not know the model {endpoint.model}{said}.", meaning, advice)
    if status == 429:
        raise LanguageModelError(
            f"{place} takes no more questions now{said}.", meaning, "Wait a little, then ask again."
        )
    if status >= 500:
        raise LanguageModelError(f"{place} failed (HTTP status {status}){said}.", meaning, "Ask again in a moment.")
    raise LanguageModelError(
        f"{place} refused the question (HTTP status {status}){said}.",
        meaning,
        "Check the model's name and the assistant settings of the scenario.",
    )


def _raise_nonsense(endpoint: ModelEndpoint, why: str) -> NoReturn:
    raise LanguageModelError(
        f"{_place(endpoint)} sent something that is no answer: {why}.",
        "The answer is missing or incomplete.",
        "Check that the address belongs to a language model server.",
    )


def _from_httpx(endpoint: ModelEndpoint, error: "httpx.HTTPError", *, answer_started: bool) -> LanguageModelError:
    import httpx

    place = _place(endpoint)
    _log.warning("exchange with %s failed: %s %s", place, type(error).__name__, error)
    if isinstance(error, httpx.ConnectError | httpx.ConnectTimeout):
        advice = {
            "ollama": "Start it with “ollama serve”, or set OLLAMA_HOST.",
            "openai": "Check the network and OPENAI_BASE_URL.",
            "embedded": "It is restarted by opening the scenario again.",
        }[endpoint.provider]
        return LanguageModelError(f"{place} cannot be reached.", "The assistant cannot answer.", advice)
    if isinstance(error, httpx.RemoteProtocolError | httpx.ReadError) and answer_started:
        return _broke_off(endpoint)
    return LanguageModelError(
        f"The connection to {place} failed.",
        "The assistant cannot answer.",
        "Ask again; check the network.",
    )


def _broke_off(endpoint: ModelEndpoint) -> LanguageModelError:
    return LanguageModelError(
        f"{_place(endpoint)} broke off.", "The answer is incomplete.", "Use what is there, or ask again."
    )


def _too_slow(endpoint: ModelEndpoint, timeouts: ChatTimeouts, *, answer_started: bool) -> LanguageModelError:
    place = _place(endpoint)
    if answer_started:
        return LanguageModelError(
            f"{place} fell silent for {timeouts.between_tokens_s:g} s in the middle of the answer.",
            "The answer is incomplete.",
            "Use what is there, or ask again.",
        )
    return LanguageModelError(
        f"{place} did not begin to answer within {timeouts.first_token_s:g} s.",
        "The assistant cannot answer now.",
        "Ask again; a model that is being loaded needs longer the first time.",
    )


def _ollama_url(host: str) -> str:
    """``OLLAMA_HOST`` as Ollama itself reads it: scheme and port may be missing, 0.0.0.0 means this machine."""
    url = host if "://" in host else f"http://{host}"
    parts = urlsplit(_checked_url(url if urlsplit(url).hostname else f"http://127.0.0.1{host}", "OLLAMA_HOST"))
    name = parts.hostname or "127.0.0.1"
    if name in ("0.0.0.0", "::"):  # noqa: S104 - read, not bound
        name = "127.0.0.1"
    default_port = 11434 if "://" not in host else {"http": 80, "https": 443}[parts.scheme]
    shown = f"[{name}]" if ":" in name else name
    return f"{parts.scheme}://{shown}:{parts.port or default_port}{parts.path.rstrip('/')}"


def _checked_url(url: str, source: str) -> str:
    try:
        parts = urlsplit(url)
        usable = parts.scheme in ("http", "https") and parts.hostname and parts.username is None
        _ = parts.port
    except ValueError:
        usable = False
    if not usable or any(unicodedata.category(character)[0] in "CZ" for character in url):
        raise _bad_address(url, source)
    return url.rstrip("/")


def _bad_address(url: str, source: str) -> LanguageModelError:
    shown = "it" if "@" in url else f"“{_shortened(url)}”"
    return LanguageModelError(
        f"The address of the language model in {source} is unusable: {shown} is not like http://HOST:PORT.",
        "The assistant cannot answer.",
        f"Correct {source}; keys do not belong into the address.",
    )


def _place(endpoint: ModelEndpoint) -> str:
    if endpoint.provider == "embedded":
        return "The embedded language model"
    name = "Ollama" if endpoint.provider == "ollama" else "The language model server"
    return f"{name} at {server_of(endpoint)}"


def _without(api_key: str | None, text: str) -> str:
    return text.replace(api_key, "[key]") if api_key else text


def _shortened(text: str, characters: int = 200) -> str:
    """One readable line of a text that came from outside."""
    line = " ".join("".join(c if unicodedata.category(c)[0] != "C" else " " for c in text[: 4 * characters]).split())
    return line if len(line) <= characters else line[: characters - 1] + "…"
