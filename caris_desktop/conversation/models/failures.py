"""Every way in which a language model fails, as the wizard reads it."""

import logging
import ssl
from typing import TYPE_CHECKING, Any

from caris_desktop.conversation.models.endpoint import ModelEndpoint
from caris_desktop.conversation.models.words import LanguageModelError, shortened, without
from caris_desktop.domain.translation import QT_TR_NOOP, tr

if TYPE_CHECKING:
    import httpx

_log = logging.getLogger(__name__)
_NO_ANSWER = QT_TR_NOOP("The assistant cannot answer.")
_HALF = QT_TR_NOOP("The answer is missing or incomplete.")


def nonsense(endpoint: ModelEndpoint, why: str) -> LanguageModelError:
    return LanguageModelError(
        tr("{place} sent something that is no answer: {why}.").format(place=endpoint.place, why=shortened(why)),
        tr(_HALF),
        tr("Check that the address belongs to a language model server."),
    )


def blocked(endpoint: ModelEndpoint, why: str) -> LanguageModelError:
    return LanguageModelError(
        tr("{place} refused to answer this ({why}).").format(place=endpoint.place, why=shortened(why, 60)),
        tr(_HALF),
        tr("Ask in other words, take something out of what goes along, or choose another model."),
    )


def broke_off(endpoint: ModelEndpoint) -> LanguageModelError:
    return LanguageModelError(
        tr("{place} broke off.").format(place=endpoint.place),
        tr("The answer is incomplete."),
        tr("Use what is there, or ask again."),
    )


def nothing(endpoint: ModelEndpoint) -> LanguageModelError:
    """Servers end the stream like this for a question beyond the model's context, and for one dropped for the next."""
    return LanguageModelError(
        tr("{place} ended its answer before the first word.").format(place=endpoint.place),
        tr(_NO_ANSWER),
        tr(
            "Ask again when no other question is under way; if it happens again, shorten the question or what goes"
            " along."
        ),
    )


def too_slow(endpoint: ModelEndpoint, *, seconds: float, answer_started: bool) -> LanguageModelError:
    if answer_started:
        return LanguageModelError(
            tr("{place} fell silent for {seconds} s in the middle of the answer.").format(
                place=endpoint.place, seconds=f"{seconds:g}"
            ),
            tr("The answer is incomplete."),
            tr("Use what is there, or ask again."),
        )
    return LanguageModelError(
        tr("{place} did not begin to answer within {seconds} s.").format(place=endpoint.place, seconds=f"{seconds:g}"),
        tr("The assistant cannot answer now."),
        tr("Ask again; a model that is being loaded needs longer the first time."),
    )


def error_in(message: dict[str, Any]) -> str:
    """The reason that a server gives, in any of the ways in which they do."""
    error = message.get("error", message.get("message", ""))
    if isinstance(error, dict):
        error = error.get("message", "")
    return shortened(str(error)) if error else "no reason given"


def raise_error_object(endpoint: ModelEndpoint, message: dict[str, Any], key: str | None) -> None:
    """Some servers answer with an error in a stream that began well."""
    if message.get("error"):
        _log.warning("%s reported an error in the stream", endpoint.place)
        raise LanguageModelError(
            tr("{place} stopped with an error: {error}").format(
                place=endpoint.place, error=without(key, error_in(message))
            ),
            tr(_HALF),
            tr("Ask again; if it happens again, choose another model or shorten the question."),
        )


def of_status(endpoint: ModelEndpoint, status: int, detail: str) -> LanguageModelError:
    """``detail`` is what the server said, without the key."""
    said = f" ({detail})" if detail else ""
    place = endpoint.place
    _log.warning("%s answered with HTTP status %d", place, status)
    if status in (401, 403) or (status == 400 and endpoint.provider == "gemini" and "api key" in detail.lower()):
        where = " or ".join(endpoint.key_names) or tr("the server's access rules")
        return LanguageModelError(
            tr("{place} refused access{said}.").format(place=place, said=said),
            tr(_NO_ANSWER),
            tr("Check {where}.").format(where=where),
        )
    if status == 404:
        advice = (
            tr("Run “ollama pull {model}”, or choose another model.").format(model=endpoint.model)
            if endpoint.provider == "ollama"
            else tr("Check the model's name and the server's address.")
        )
        return LanguageModelError(
            tr("{place} does not know the model {model}{said}.").format(place=place, model=endpoint.model, said=said),
            tr(_NO_ANSWER),
            advice,
        )
    if status == 429:
        return LanguageModelError(
            tr("{place} takes no more questions now{said}.").format(place=place, said=said),
            tr(_NO_ANSWER),
            tr("Wait a little, then ask again."),
        )
    if status >= 500:
        return LanguageModelError(
            tr("{place} failed (HTTP status {status}){said}.").format(place=place, status=status, said=said),
            tr(_NO_ANSWER),
            tr("Ask again in a moment."),
        )
    if 300 <= status < 400:
        return LanguageModelError(
            tr(
                "{place} sends the question on to another address (HTTP status {status}), which is not followed."
            ).format(place=place, status=status),
            tr(_NO_ANSWER),
            tr("Give the model's own address."),
        )
    return LanguageModelError(
        tr("{place} refused the question (HTTP status {status}){said}.").format(place=place, status=status, said=said),
        tr(_NO_ANSWER),
        tr("Check the model's name and the assistant settings of the scenario."),
    )


def of_httpx(endpoint: ModelEndpoint, error: "httpx.HTTPError", *, answer_started: bool) -> LanguageModelError:
    import httpx

    place = endpoint.place
    # Whoever asked is told; where nobody did, as at the end of the program, nobody needs to be warned.
    _log.info("exchange with %s failed: %s %s", place, type(error).__name__, error)
    if is_about_tls(error):
        return LanguageModelError(
            tr("{place} cannot prove who it is: its certificate is not accepted.").format(place=place),
            tr("Nothing was sent to it."),
            tr(
                "Check the address and this computer's clock; a server of the lab needs a certificate that this"
                " computer trusts."
            ),
        )
    if isinstance(error, httpx.ConnectError | httpx.ConnectTimeout):
        advice = {
            "ollama": tr("Start it with “ollama serve”, or set OLLAMA_HOST."),
            "openai": tr("Check the network and OPENAI_BASE_URL."),
            "gemini": tr("Check the network."),
            "embedded": tr("It is restarted by opening the scenario again."),
        }[endpoint.provider]
        return LanguageModelError(tr("{place} cannot be reached.").format(place=place), tr(_NO_ANSWER), advice)
    if isinstance(error, httpx.RemoteProtocolError | httpx.ReadError) and answer_started:
        return broke_off(endpoint)
    return LanguageModelError(
        tr("The connection to {place} failed.").format(place=place), tr(_NO_ANSWER), tr("Ask again; check the network.")
    )


def is_about_tls(error: BaseException | None) -> bool:
    """Whether it is the server's certificate or the handshake that failed."""
    while error is not None:
        if isinstance(error, ssl.SSLError):
            return True
        error = error.__cause__ or error.__context__
    return False
