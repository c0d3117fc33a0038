"""Endpoints of language models: provider, address, model and key names."""

import os
import re
import unicodedata
from collections.abc import Mapping
from typing import Literal
from urllib.parse import urlsplit

from caris_desktop.domain.address import before_port, is_loopback
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value


class LanguageModelError(UserFacingError):
    """A language model did not answer."""


def shortened(text: str, characters: int = 200) -> str:
    """External text as one readable line."""
    line = " ".join("".join(c if unicodedata.category(c)[0] != "C" else " " for c in text[: 4 * characters]).split())
    return line if len(line) <= characters else line[: characters - 1] + "…"


def without(api_key: str | None, text: str) -> str:
    """``text`` without the key, which some servers repeat."""
    return text.replace(api_key, "[key]") if api_key else text


PLUGIN = "plugin"
MODEL_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}")

Provider = Literal["embedded", "openai", "ollama", "gemini"]

OPENAI_URL = "https://api.openai.com/v1"
GEMINI_URL = "https://generativelanguage.googleapis.com"
OLLAMA_URL = "http://127.0.0.1:11434"
EMBEDDED_KEY = "CARIS_EMBEDDED_MODEL_KEY"
"""Environment variable with the embedded server's key, for this run."""
KEYED_BY = {"openai": ("OPENAI_API_KEY",), "gemini": ("GEMINI_API_KEY", "GOOGLE_API_KEY")}
"""The environment variables that hold a provider's key, the first that is set counts."""


class ModelEndpoint(Value):
    """Endpoint of a model.

    ``base_url`` is the server; for OpenAI-compatible servers with a path such as ``/v1``, which is added if missing.
    ``key_names`` are environment variables (and keyring entries), of which the first existing one holds the key, so
    that the key is never in a value that could be logged or recorded.
    """

    provider: Provider
    base_url: str
    model: str
    key_names: tuple[str, ...] = ()

    @property
    def server(self) -> str:
        """Host with port, without credentials."""
        return urlsplit(self.base_url).netloc.rpartition("@")[2]

    @property
    def place(self) -> str:
        """Name as the subject of a sentence."""
        match self.provider:
            case "embedded" if self.is_plugin:
                return localized(QT_TR_NOOP("The language model {name}"), name=self.model)
            case "embedded":
                return QT_TR_NOOP("The embedded language model")
            case "ollama":
                return localized(QT_TR_NOOP("Ollama at {server}"), server=self.server)
            case "gemini":
                return localized(QT_TR_NOOP("Gemini at {server}"), server=self.server)
        return localized(QT_TR_NOOP("The language model server at {server}"), server=self.server)

    @property
    def is_plugin(self) -> bool:
        """True for a plug-in, which a process of this program serves as it does the embedded model."""
        return self.provider == "embedded" and self.model.startswith(f"{PLUGIN}:")

    @property
    def is_openai(self) -> bool:
        """True for OpenAI's own server."""
        return urlsplit(self.base_url).hostname == urlsplit(OPENAI_URL).hostname

    @property
    def takes_seed(self) -> bool:
        """True if the server accepts a seed. Some OpenAI-compatible servers refuse unknown fields."""
        return self.provider != "openai" or is_loopback(self.base_url) or self.is_openai

    @property
    def leaves_computer(self) -> bool:
        """True if requests leave this computer: by the address, Ollama's cloud, or perhaps a plug-in."""
        if self.is_plugin:
            return True
        named_cloud = any(part.endswith("cloud") for part in self.model.lower().split(":"))
        return not is_loopback(self.base_url) or (self.provider == "ollama" and named_cloud)


def served_name(model: str) -> str | None:
    """Name under which a process of this program serves the model: NAME of ``embedded:NAME``, empty for the built-in
    one, and ``plugin:NAME``; None for a model of another server.
    """
    provider, colon, name = (part.strip() for part in model.partition(":"))
    if provider == PLUGIN and MODEL_NAME.fullmatch(name):
        return f"{PLUGIN}:{name}"
    if provider != "embedded" or (colon and not MODEL_NAME.fullmatch(name)):
        return None
    return name


def resolve_endpoint(
    model: str, *, embedded_url: str | None, environment: Mapping[str, str] | None = None
) -> ModelEndpoint:
    """Resolve a scenario's ``embedded``, ``embedded:NAME``, ``plugin:NAME``, ``ollama:NAME``, ``openai:NAME`` or
    ``gemini:NAME``.

    ``embedded_url`` is the address of the embedded server of this model, None without one. ``OLLAMA_HOST``,
    ``OPENAI_BASE_URL`` and ``GOOGLE_GEMINI_BASE_URL`` in ``environment`` (default: the process environment) override
    addresses.

    Raises
    ------
    LanguageModelError
        If the text is none of these, an address is unusable, or the embedded server is not running.
    """
    environment = os.environ if environment is None else environment
    provider, _, name = model.strip().partition(":")
    name = name.strip()
    embedded = served_name(model)
    if embedded is not None:
        if embedded_url is None:
            raise LanguageModelError(
                QT_TR_NOOP("The language model's process is not running.")
                if embedded.startswith(f"{PLUGIN}:")
                else QT_TR_NOOP("The embedded language model is not running."),
                QT_TR_NOOP("The assistant cannot answer."),
                QT_TR_NOOP("Wait until it has started; if it failed, the Session log shows why."),
            )
        url = _checked_url(embedded_url, QT_TR_NOOP("the embedded server's address"))
        return ModelEndpoint("embedded", url, embedded or "embedded", (EMBEDDED_KEY,))
    if provider == "ollama" and name:
        return ModelEndpoint("ollama", ollama_url(environment), name)
    if provider == "openai" and name:
        return ModelEndpoint("openai", openai_url(environment), name, KEYED_BY["openai"])
    if provider == "gemini" and name:
        base_url = environment.get("GOOGLE_GEMINI_BASE_URL", "").strip() or GEMINI_URL
        url = _checked_url(base_url, "GOOGLE_GEMINI_BASE_URL")
        return ModelEndpoint("gemini", url, name.removeprefix("models/"), KEYED_BY["gemini"])
    raise LanguageModelError(
        localized(QT_TR_NOOP("“{model}” is not a valid language model."), model=shortened(model)),
        QT_TR_NOOP("The assistant cannot answer in this scenario."),
        QT_TR_NOOP(
            "Set assistant.model to embedded, embedded:NAME, ollama:NAME, openai:NAME, gemini:NAME or plugin:NAME."
        ),
    )


def openai_url(environment: Mapping[str, str]) -> str:
    """Address of OpenAI-compatible models. Raises LanguageModelError."""
    url = _checked_url(environment.get("OPENAI_BASE_URL", "").strip() or OPENAI_URL, "OPENAI_BASE_URL")
    return url.removesuffix("/chat/completions")


def ollama_url(environment: Mapping[str, str]) -> str:
    """``OLLAMA_HOST``, parsed as by Ollama: scheme and port are optional, 0.0.0.0 means this computer.

    Raises LanguageModelError.
    """
    host = environment.get("OLLAMA_HOST", "").strip()
    if not host:
        return OLLAMA_URL
    url = host if "://" in host else f"http://{host}"
    parts = urlsplit(_checked_url(url if urlsplit(url).hostname else f"http://127.0.0.1{host}", "OLLAMA_HOST"))
    name = parts.hostname or "127.0.0.1"
    if name in ("0.0.0.0", "::"):  # noqa: S104 - read, not bound
        name = "127.0.0.1"
    default_port = 11434 if "://" not in host else {"http": 80, "https": 443}[parts.scheme]
    return f"{parts.scheme}://{before_port(name)}:{parts.port or default_port}{parts.path.rstrip('/')}"


def bad_address(url: str, source: str) -> LanguageModelError:
    """Error for an invalid ``url`` from ``source``."""
    address = "it" if "@" in url else f"“{shortened(url)}”"
    return LanguageModelError(
        f"Invalid address of the language model in {source}: {address} does not have the form http://HOST:PORT.",
        QT_TR_NOOP("The assistant cannot answer."),
        localized(QT_TR_NOOP("Correct {source}; keys do not belong in the address."), source=source),
    )


def _checked_url(url: str, source: str) -> str:
    try:
        parts = urlsplit(url)
        usable = parts.scheme in ("http", "https") and parts.hostname and parts.username is None and not parts.query
        _ = parts.port
    except ValueError:
        usable = False
    if not usable or any(unicodedata.category(character)[0] in "CZ" for character in url):
        raise bad_address(url, source)
    return url.rstrip("/")
