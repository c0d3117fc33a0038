"""Errors of language models as user texts."""

import logging
import re
import ssl
from typing import TYPE_CHECKING, Any

from caris_desktop.conversation.models.endpoint import LanguageModelError, ModelEndpoint, shortened, without
from caris_desktop.domain.certificates import why_refused
from caris_desktop.domain.translation import QT_TR_NOOP, LocalizedText, joined, localized

if TYPE_CHECKING:
    import httpx

_log = logging.getLogger(__name__)
_NO_ANSWER = QT_TR_NOOP("The assistant cannot answer.")
_HALF = QT_TR_NOOP("The answer is missing or incomplete.")


class UnusableError(LanguageModelError):
    """One message of a stream is unusable; others may be usable."""


def unusable(endpoint: ModelEndpoint, reason: str) -> UnusableError:
    """Error if no better message follows."""
    failure = nonsense(endpoint, reason)
    return UnusableError(failure.what, failure.meaning, failure.advice)


def nonsense(endpoint: ModelEndpoint, reason: str) -> LanguageModelError:
    return LanguageModelError(
        localized(
            QT_TR_NOOP("{place} sent an invalid answer: {why}."),
            place=endpoint.place,
            why=reason if isinstance(reason, LocalizedText) else shortened(reason),
        ),
        _HALF,
        QT_TR_NOOP("Check that the address belongs to a language model server."),
    )


def blocked(endpoint: ModelEndpoint, reason: str) -> LanguageModelError:
    return LanguageModelError(
        localized(
            QT_TR_NOOP("{place} refused to answer this ({why})."), place=endpoint.place, why=shortened(reason, 60)
        ),
        _HALF,
        QT_TR_NOOP("Rephrase the question, remove something from its context, or choose another model."),
    )


def broke_off(endpoint: ModelEndpoint) -> LanguageModelError:
    return LanguageModelError(
        localized(QT_TR_NOOP("{place} stopped in the middle of the answer."), place=endpoint.place),
        QT_TR_NOOP("The answer is incomplete."),
        QT_TR_NOOP("Use the partial answer, or ask again."),
    )


def nothing(endpoint: ModelEndpoint) -> LanguageModelError:
    """Error for an empty answer: servers end the stream like this if the question exceeds the context, or was dropped
    for the next one.
    """
    return LanguageModelError(
        localized(QT_TR_NOOP("{place} returned an empty answer."), place=endpoint.place),
        _NO_ANSWER,
        QT_TR_NOOP(
            "Ask again when no other question is in progress. If it happens again, shorten the question or its context."
        ),
    )


def called_tool(endpoint: ModelEndpoint) -> LanguageModelError:
    """Error for an answer that is a call of a tool, which no question offers."""
    return LanguageModelError(
        localized(QT_TR_NOOP("{place} called a tool instead of answering."), place=endpoint.place),
        _NO_ANSWER,
        QT_TR_NOOP("Turn off the tools of the model on its server, or choose another model."),
    )


def only_reasoned(endpoint: ModelEndpoint, *, cut: bool = False, seconds: float | None = None) -> LanguageModelError:
    """Error for an answer with reasoning only: ``cut`` at the limit, or after ``seconds``."""
    if seconds is not None:
        what = QT_TR_NOOP("{place} reasoned for {seconds} s without starting to answer.")
    elif cut:
        what = QT_TR_NOOP("{place} reached its answer length limit while it was still reasoning.")
    else:
        what = QT_TR_NOOP("{place} reasoned but gave no answer.")
    return LanguageModelError(
        localized(what, place=endpoint.place, seconds=f"{seconds:g}" if seconds is not None else ""),
        _NO_ANSWER,
        QT_TR_NOOP("Choose a model that does not reason, or turn off its reasoning on the server."),
    )


def too_slow(endpoint: ModelEndpoint, *, seconds: float, answer_started: bool) -> LanguageModelError:
    if answer_started:
        what = QT_TR_NOOP("{place} sent nothing for {seconds} s in the middle of the answer.")
        meaning = QT_TR_NOOP("The answer is incomplete.")
        advice = QT_TR_NOOP("Use the partial answer, or ask again.")
    else:
        what = QT_TR_NOOP("{place} did not start to answer within {seconds} s.")
        meaning = QT_TR_NOOP("The assistant cannot answer now.")
        advice = QT_TR_NOOP("Ask again; the first answer takes longer while the model is loading.")
    return LanguageModelError(localized(what, place=endpoint.place, seconds=f"{seconds:g}"), meaning, advice)


NO_REASON = "no reason given"
_ERROR_TEXTS = ("message", "detail", "msg", "errors")
_DEEPEST = 5


def error_in(message: dict[str, Any]) -> str:
    """Error reason in a server's message, in any of the common formats."""
    return shortened(_reason_of(message)) or NO_REASON


def _reason_of(error: object, depth: int = 0) -> str:
    if isinstance(error, str):
        return error
    if isinstance(error, list) and depth < _DEEPEST:
        return "; ".join(filter(None, (_reason_of(each, depth + 1) for each in error)))
    if not isinstance(error, dict) or depth == _DEEPEST:
        return ""
    # FastAPI names the field.
    where = error.get("loc")
    parts = [str(part) for part in where if part != "body"] if isinstance(where, list) else []
    parts.append(next(filter(None, (_reason_of(error.get(name), depth + 1) for name in ("error", *_ERROR_TEXTS))), ""))
    # OpenRouter quotes the model's own server.
    metadata = error.get("metadata")
    parts.append(_reason_of(metadata.get("raw") if isinstance(metadata, dict) else "", depth + 1))
    return ": ".join(filter(None, parts)) or (_reason_of(error.get("type"), depth + 1) if depth else "")


def raise_error_object(endpoint: ModelEndpoint, message: dict[str, Any], key: str | None) -> None:
    """Raise an error object, which some servers send within a stream, or with the status of success."""
    without_answer = not any(message.get(name) for name in ("choices", "candidates"))
    texts = [message.get(name) for name in _ERROR_TEXTS]
    if message.get("error") or (without_answer and any(text and isinstance(text, str | list) for text in texts)):
        _log.warning("%s reported an error in the stream", endpoint.place)
        raise LanguageModelError(
            localized(
                QT_TR_NOOP("{place} stopped with an error: {error}"),
                place=endpoint.place,
                error=without(key, error_in(message)),
            ),
            _HALF,
            QT_TR_NOOP("Ask again; if it happens again, choose another model or shorten the question."),
        )


def of_status(endpoint: ModelEndpoint, status: int, detail: str) -> LanguageModelError:
    """Error of an HTTP status. ``detail`` is the server's text without the key."""
    _log.warning("%s answered with HTTP status %d", endpoint.place, status)
    what = QT_TR_NOOP("{place} refused the question (HTTP status {status}){said}.")
    advice = _advice_for(detail) or QT_TR_NOOP(
        "Correct the setting that the reason names under assistant in the scenario, or choose another model."
    )
    if status in (401, 403) or (status == 400 and endpoint.provider == "gemini" and "api key" in detail.lower()):
        where = " or ".join(endpoint.key_names) or QT_TR_NOOP("the server's access rules")
        what, advice = QT_TR_NOOP("{place} refused access{said}."), localized(QT_TR_NOOP("Check {where}."), where=where)
    elif status == 404 and detail and not re.search(r"model|deployment|engine", detail, re.IGNORECASE):
        what = QT_TR_NOOP("{place} does not answer questions at this address (HTTP status {status}){said}.")
        advice = QT_TR_NOOP("Check the server's address: most end in /v1.")
    elif status == 404:
        what, advice = (
            QT_TR_NOOP("{place} does not have the model {model}{said}."),
            localized(QT_TR_NOOP("Run “ollama pull {model}”, or choose another model."), model=endpoint.model)
            if endpoint.provider == "ollama"
            else QT_TR_NOOP("Check the model's name and the server's address."),
        )
    elif status == 429:
        what = QT_TR_NOOP("{place} is not accepting questions now{said}.")
        advice = QT_TR_NOOP("Wait a moment, then ask again; the account may have no credit left.")
    elif status == 402:
        advice = QT_TR_NOOP("Check the credit of the account, or choose another model.")
    elif status >= 500:
        what = QT_TR_NOOP("{place} failed (HTTP status {status}){said}.")
        advice = _advice_for(detail) or QT_TR_NOOP("Ask again in a moment.")
    elif 300 <= status < 400:
        what = QT_TR_NOOP(
            "{place} redirects the question to another address (HTTP status {status}). Redirects are not followed."
        )
        advice = QT_TR_NOOP("Use the model's own address.")
    said = f" ({detail})" if detail else ""
    known = {"place": endpoint.place, "status": status, "model": endpoint.model, "said": said}
    return LanguageModelError(localized(what, **known), _NO_ANSWER, advice)


def _advice_for(reason: str) -> str:
    """Advice by the server's reason; empty for unknown ones."""
    reason = reason.lower()
    if re.search(r"context|too long|too large|too many tokens|prompt.{0,20}long|exceed", reason):
        return QT_TR_NOOP("Shorten the system prompt, the question or its context, or choose a larger model.")
    if re.search(r"filter|moderat|content management|safety|policy", reason):
        return QT_TR_NOOP("Rephrase the question, remove something from its context, or choose another model.")
    if re.search(r"memory|overload", reason):
        return QT_TR_NOOP("Close other programs on the computer that runs the model, or choose a smaller model.")
    if re.search(
        r"\bmodel\b.*(not found|not exist|not loaded|unknown|invalid|not a|decommission)|invalid model", reason
    ):
        return QT_TR_NOOP("Check the model's name.")
    if re.search(r"image|picture|vision|multimodal", reason):
        return QT_TR_NOOP("Ask without the picture, or choose another model.")
    return ""


def of_httpx(endpoint: ModelEndpoint, error: "httpx.HTTPError", *, answer_started: bool) -> LanguageModelError:
    import httpx

    place = endpoint.place
    # The caller reports it; without one, as at exit, no warning is needed.
    _log.info("exchange with %s failed: %s %s", place, type(error).__name__, error)
    if (refused := tls_error(error)) is not None:
        reason, _ = why_refused(refused, place, None)
        return LanguageModelError(
            localized(QT_TR_NOOP("The identity of {place} cannot be verified. {why}"), place=place, why=joined(reason)),
            QT_TR_NOOP("Nothing was sent to it."),
            QT_TR_NOOP(
                "Check the address and this computer's clock. A lab server needs a certificate that this "
                "computer trusts."
            ),
        )
    if isinstance(error, httpx.ConnectError | httpx.ConnectTimeout):
        advice = {
            "ollama": QT_TR_NOOP("Start it with “ollama serve”, or set OLLAMA_HOST."),
            "openai": QT_TR_NOOP("Check the network and OPENAI_BASE_URL."),
            "gemini": QT_TR_NOOP("Check the network."),
            "embedded": QT_TR_NOOP("Open the scenario again to restart it."),
        }[endpoint.provider]
        return LanguageModelError(localized(QT_TR_NOOP("{place} cannot be reached."), place=place), _NO_ANSWER, advice)
    if isinstance(error, httpx.RemoteProtocolError | httpx.ReadError) and answer_started:
        return broke_off(endpoint)
    return LanguageModelError(
        localized(QT_TR_NOOP("The connection to {place} failed."), place=place),
        _NO_ANSWER,
        QT_TR_NOOP("Ask again; check the network."),
    )


def tls_error(error: BaseException | None) -> ssl.SSLError | None:
    """Certificate or handshake error, if that is the cause."""
    while error is not None and not isinstance(error, ssl.SSLError):
        error = error.__cause__ or error.__context__
    return error
