"""Model lists and versions from servers."""

import asyncio
import logging
from typing import Any

from caris_desktop.conversation.models.connection import api_key, connected
from caris_desktop.conversation.models.endpoint import ModelEndpoint
from caris_desktop.conversation.models.failure_texts import LanguageModelError
from caris_desktop.conversation.models.question import recorded_name
from caris_desktop.conversation.models.stream import small_object

_log = logging.getLogger(__name__)
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
        return _listed_digest(endpoint, listed)
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


def _listed_digest(endpoint: ModelEndpoint, listed: dict[str, Any]) -> str:
    # Ollama resolves a name without a tag to latest.
    names = (endpoint.model, f"{endpoint.model}:latest")
    models = listed.get("models")
    for model in models if isinstance(models, list) else ():
        if isinstance(model, dict) and (model.get("name") in names or model.get("model") in names):
            digest = str(model.get("digest", "")).removeprefix("sha256:")
            if len(digest) >= _DIGEST_DIGITS and set(digest.lower()) <= set("0123456789abcdef"):
                return f"sha256:{digest[:_DIGEST_DIGITS]}"
    return ""
