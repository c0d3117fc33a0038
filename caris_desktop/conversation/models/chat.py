"""Streaming requests to language models, with timeouts, and retries before the answer begins."""

import asyncio
import contextlib
import email.utils
import logging
import random
import re
import time
from collections.abc import AsyncGenerator, Callable, Iterable, Sequence
from contextlib import aclosing
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NoReturn

from caris_desktop.conversation.models import failures
from caris_desktop.conversation.models.connection import api_key, check_model_is_here, check_place, connected, send
from caris_desktop.conversation.models.dialects import DIALECTS, refuses_schema
from caris_desktop.conversation.models.endpoint import LanguageModelError, ModelEndpoint, shortened, without
from caris_desktop.conversation.models.question import (
    Chunk,
    Cut,
    Question,
    Request,
    check_type,
    documents,
    json_object,
    object_in,
    small_body,
)
from caris_desktop.conversation.models.reasoning import SpokenPart, Withdrawn
from caris_desktop.domain.address import is_loopback
from caris_desktop.domain.events import ChatMessage
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value, dataclass

if TYPE_CHECKING:
    import httpx

_log = logging.getLogger(__name__)
MAX_ANSWER_CHARACTERS = 200_000
_MAX_ERROR_BODY_BYTES = 65_536
_BUSY = (429, 500, 502, 503, 504, 529)
_REFUSED = (400, 422)
_CHARACTERS_PER_TOKEN = 5
"""Of usual models and languages, where the answer is held to its limit here."""
_DRAINED_WITHIN_S = 0.2


class ChatTimeouts(Value):
    """Timeouts of each step. Once a model has begun to reason, it may do so for another ``first_token_s``."""

    connect_s: float = 5.0
    first_token_s: float = 60.0
    between_tokens_s: float = 20.0


class Retries(Value):
    """Retry policy for a busy or unreachable server, before it begins to answer.

    Waits begin at ``first_s`` and double; a server's own wait (Retry-After) is respected up to ``most_s``, beyond which
    the request fails at once.
    """

    at_most: int = 2
    first_s: float = 0.5
    most_s: float = 10.0

    def wait_s(self, tried: int, retry_after_s: float | None) -> float | None:
        """Wait after the ``tried``-th attempt, None to give up."""
        if tried > self.at_most or (retry_after_s is not None and retry_after_s > self.most_s):
            return None
        # Jitter, so that a lab's consoles do not retry simultaneously.
        backed_off_s: float = min(self.first_s * 2.0 ** (tried - 1), self.most_s) * random.uniform(0.8, 1.2)  # noqa: S311
        return max(retry_after_s or 0.0, backed_off_s)


@dataclass(slots=True)
class AnswerNotes:
    """Findings about an answer in progress. ``left_out`` are parameters that the server refused."""

    cut: Cut = ""
    reasoned: bool = False
    left_out: tuple[str, ...] = ()


@dataclass(slots=True)
class _Habits:
    """Observed behaviour of a server, valid while the program runs."""

    left_out: tuple[str, ...] = ()
    begins_within: bool = False


_HABITS: dict[ModelEndpoint, _Habits] = {}


class _OtherSchemaError(Exception):
    """The server expects the schema in its other format."""


class _LeaveOutError(Exception):
    """The server refuses this parameter, or does not answer because of it."""

    def __init__(self, parameter: str) -> None:
        super().__init__(parameter)
        self.parameter = parameter


class _TryAgainError(Exception):
    """A retry may succeed, after ``retry_after_s`` if given. ``failure`` is the present error."""

    def __init__(self, failure: LanguageModelError, retry_after_s: float | None = None) -> None:
        super().__init__(failure.what)
        self.failure = failure
        self.retry_after_s = retry_after_s


async def stream_chat(
    endpoint: ModelEndpoint,
    messages: Sequence[ChatMessage],
    *,
    local_only: bool,
    max_tokens: int,
    temperature: float,
    seed: int | None = None,
    jpegs: Sequence[bytes] = (),
    schema: dict[str, Any] | None = None,
    slot: int | None = None,
    on_version: Callable[[str], None] = lambda _version: None,
    on_wait: Callable[[str], None] = lambda _reason: None,
    notes: AnswerNotes | None = None,
    timeouts: ChatTimeouts = ChatTimeouts(),
    retries: Retries = Retries(),
) -> AsyncGenerator[str]:
    """Yield the answer piece by piece without reasoning. A piece that is ``Withdrawn`` marks the pieces before it as
    reasoning.

    With ``local_only`` nothing leaves this computer. ``seed`` makes answers reproducible; it is sent only if
    `ModelEndpoint.takes_seed`. ``on_version`` is called with the model version in the stream at each change; Ollama
    sends none, see `model_version`. ``on_wait`` is called with the reason for a wait before a retry, as text.
    ``jpegs`` are images for the last message; the embedded model accepts none. ``schema`` is a JSON schema for the
    answer. ``slot`` selects a cache of the embedded server. ``notes`` are filled in progressively. A parameter that the
    server refuses by name is omitted from then on, while the program runs.

    Closing the generator, or cancelling the task that iterates it, closes the HTTP stream, which makes the server stop
    generating; before the first piece it also ends the waiting.

    Raises
    ------
    LanguageModelError
        For every failure, including an answer that breaks off after some pieces were yielded.
    """
    check_place(endpoint, local_only=local_only)
    question = Question(messages, max_tokens, temperature, seed, jpegs, schema, slot=slot)
    notes = AnswerNotes() if notes is None else notes
    habits = _HABITS.setdefault(endpoint, _Habits())
    key = await api_key(endpoint)
    give_up_s = asyncio.get_running_loop().time() + timeouts.connect_s + timeouts.first_token_s
    tried = 0
    while True:
        tried += 1
        if SYSTEM_ROLE in habits.left_out:
            question = replace(question, messages=without_system_role(question.messages))
        request = leave_out(DIALECTS[endpoint.provider][0](endpoint, question), habits.left_out)
        notes.left_out = habits.left_out
        try:
            answer = _one_try(
                endpoint, request, question, key, give_up_s, timeouts,
                local_only=local_only, on_version=on_version, notes=notes, habits=habits,
            )  # fmt: skip
            async with aclosing(answer) as pieces:
                async for piece in pieces:
                    yield piece
        except _OtherSchemaError:
            question = replace(question, schema_in_object=True)
            tried -= 1
        except _LeaveOutError as refused:
            _log.info("%s is asked without %s", endpoint.place, refused.parameter)
            habits.left_out = (*habits.left_out, refused.parameter)
            tried -= 1
        except _TryAgainError as again:
            wait_s = retries.wait_s(tried, again.retry_after_s)
            if wait_s is None or asyncio.get_running_loop().time() + wait_s >= give_up_s:
                raise _with_time(again) from again
            _log.info("%s is asked again in %.1f s: %s", endpoint.place, wait_s, again.failure.what)
            on_wait(
                localized(
                    QT_TR_NOOP("{what} The console tries again in {seconds} s."),
                    what=again.failure.what,
                    seconds=max(1, round(wait_s)),
                )
            )
            await asyncio.sleep(wait_s)
        else:
            return


def _with_time(again: _TryAgainError) -> LanguageModelError:
    failure, retry_after_s = again.failure, again.retry_after_s
    if not retry_after_s:
        return failure
    return LanguageModelError(
        failure.what,
        failure.meaning,
        localized(
            QT_TR_NOOP("The server accepts no questions for {seconds} s: ask again after that."),
            seconds=f"{retry_after_s:.0f}",
        ),
    )


async def _one_try(  # noqa: PLR0917 - all of one call
    endpoint: ModelEndpoint,
    request: Request,
    question: Question,
    key: str | None,
    deadline_s: float,
    timeouts: ChatTimeouts,
    *,
    local_only: bool,
    on_version: Callable[[str], None],
    notes: AnswerNotes,
    habits: _Habits,
) -> AsyncGenerator[str]:
    """One attempt. Raises LanguageModelError; before the first piece _TryAgainError if a retry may help,
    _OtherSchemaError and _LeaveOutError.
    """
    import httpx

    loop = asyncio.get_running_loop()
    limits = httpx.Timeout(connect=timeouts.connect_s, read=None, write=timeouts.connect_s, pool=timeouts.connect_s)
    began = ended = unfinished = closed = False
    read_characters = written_characters = 0
    most_characters = None if request.bounded else question.max_tokens * _CHARACTERS_PER_TOKEN
    version = reason = answered_in = ""
    useless: LanguageModelError | None = None
    answers_by_s = 0.0
    part = SpokenPart(within=habits.begins_within)
    try:
        async with connected(endpoint, local_only=local_only) as client:
            if local_only:
                await check_model_is_here(client, endpoint)
            headers = _key_header(endpoint, key)
            built = client.build_request("POST", request.path, json=request.body, headers=headers, timeout=limits)
            async with asyncio.timeout_at(deadline_s):
                response = await send(client, built)
            try:
                if not response.is_success:
                    async with asyncio.timeout_at(deadline_s):
                        await _raise_status(endpoint, request, response, key)
                check_type(endpoint, response)
                async with aclosing(documents(endpoint, response)) as messages:
                    while not closed:
                        try:
                            async with asyncio.timeout_at(deadline_s):
                                document = await anext(messages)
                            chunk = _chunk_of(endpoint, document, key)
                        except StopAsyncIteration:
                            break
                        except failures.UnusableError as error:
                            useless = useless or error
                            continue
                        except (TimeoutError, LanguageModelError, httpx.HTTPError):
                            if ended:  # the answer is whole, whatever follows it
                                break
                            raise
                        if chunk.text:
                            answered_in = answered_in or chunk.choice
                        if chunk.choice != answered_in:
                            chunk = replace(chunk, text="")  # another answer
                        closed = chunk.closed
                        unfinished = unfinished or chunk.unfinished
                        # If the server marks finished answers, closing the stream without a mark means an unfinished
                        # one.
                        ended = ended or chunk.ended or (closed and not unfinished)
                        notes.cut, reason = chunk.cut or notes.cut, chunk.why or reason
                        if chunk.version and chunk.version != version:
                            version = chunk.version
                            on_version(version)
                        if chunk.text or chunk.alive:
                            answers_by_s = answers_by_s or loop.time() + timeouts.first_token_s
                            began = True
                            deadline_s = loop.time() + timeouts.between_tokens_s
                        read_characters += len(chunk.text) + chunk.alive
                        if read_characters > MAX_ANSWER_CHARACTERS:
                            raise failures.nonsense(endpoint, QT_TR_NOOP("the answer is too long"))
                        notes.reasoned = notes.reasoned or chunk.alive
                        for piece in part.process(chunk.text):
                            if isinstance(piece, Withdrawn):
                                habits.begins_within = part.begins_within
                                answers_by_s = loop.time() + timeouts.first_token_s
                                written_characters = 0
                            written_characters += len(piece)
                            before_s = loop.time()
                            yield piece
                            deadline_s += loop.time() - before_s
                        notes.reasoned = notes.reasoned or part.reasoned
                        if ended:
                            # Some servers mark each piece as the end.
                            deadline_s = min(deadline_s, loop.time() + _DRAINED_WITHIN_S)
                        elif began and not written_characters:
                            deadline_s = min(deadline_s, answers_by_s)
                        if most_characters is not None and written_characters >= most_characters and not ended:
                            notes.cut, ended = "length", True
                            break
                    else:
                        await _drain(messages)
                for piece in part.end(whole=notes.cut != "length") if ended or closed else ():
                    written_characters += len(piece)
                    yield piece
            finally:
                await response.aclose()
    except httpx.HTTPError as error:
        failure = failures.of_httpx(endpoint, error, answer_started=began)
        # A local program that is not running will not be in a second either; a remote server may be.
        refused_here = isinstance(error, httpx.ConnectError) and is_loopback(endpoint.base_url)
        hopeless = failures.tls_error(error) is not None or not isinstance(error, httpx.TransportError)
        if began or refused_here or hopeless:
            raise failure from error
        raise _TryAgainError(failure) from error
    except TimeoutError as error:
        if began and not written_characters and loop.time() >= answers_by_s:
            raise failures.only_reasoned(endpoint, seconds=timeouts.first_token_s) from error
        waited_s = timeouts.between_tokens_s if began else timeouts.first_token_s
        raise failures.too_slow(endpoint, seconds=waited_s, answer_started=began) from error
    if not written_characters:
        _raise_empty_answer(endpoint, request, notes, reason, useless)
    if not ended:
        raise failures.broke_off(endpoint)


def _chunk_of(endpoint: ModelEndpoint, document: str, key: str | None) -> Chunk:
    """Parse a message of the stream, or a complete answer without streaming. Raises LanguageModelError."""
    if document.strip() == "[DONE]":
        return Chunk(closed=True)
    message = json_object(endpoint, document)
    failures.raise_error_object(endpoint, message, key)
    return DIALECTS[endpoint.provider][1](endpoint, message, key)


def _raise_empty_answer(
    endpoint: ModelEndpoint, request: Request, notes: AnswerNotes, reason: str, useless: LanguageModelError | None
) -> NoReturn:
    limit = next((name for name in TOKEN_LIMITS if name in parameters_sent(request)), "")
    if notes.cut == "length" and limit and endpoint.provider != "embedded":
        # Reasoning used up the limit, reported or not.
        raise _LeaveOutError(limit)
    if notes.cut == "filter":
        raise failures.blocked(endpoint, reason)
    if reason in ("tool_calls", "tool_use", "function_call"):
        raise failures.called_tool(endpoint)
    if notes.reasoned or notes.cut:
        raise failures.only_reasoned(endpoint, cut=notes.cut == "length")
    raise useless or failures.nothing(endpoint)


async def _drain(messages: AsyncGenerator[str]) -> None:
    """Read the rest after an answer, so that the connection can be reused."""
    import httpx

    with contextlib.suppress(TimeoutError, LanguageModelError, httpx.HTTPError):
        async with asyncio.timeout(_DRAINED_WITHIN_S):
            async for _ in messages:
                pass


def _key_header(endpoint: ModelEndpoint, key: str | None) -> dict[str, str]:
    if not key:
        return {}
    return {"x-goog-api-key": key} if endpoint.provider == "gemini" else {"Authorization": f"Bearer {key}"}


async def _raise_status(endpoint: ModelEndpoint, request: Request, response: "httpx.Response", key: str | None) -> None:
    raw = await small_body(response, _MAX_ERROR_BODY_BYTES)
    body = object_in(raw)
    detail = without(key, failures.error_in(body)) if body else ""
    if not body and "text/plain" in response.headers.get("content-type", ""):
        detail = without(key, shortened(raw.decode("utf-8", "replace")))
    if refuses_schema(request, response.status_code, str(body)):
        _log.info("%s is asked for a JSON object in the other way", endpoint.place)
        raise _OtherSchemaError
    refused = named_parameter(request, body, detail)
    # llama.cpp reports what a model's template does not support as a fault of its own.
    if refused and (response.status_code in _REFUSED or (response.status_code == 500 and refused == SYSTEM_ROLE)):
        raise _LeaveOutError(refused)
    failure = failures.of_status(endpoint, response.status_code, detail)
    if response.status_code in _BUSY:
        raise _TryAgainError(failure, _reported_wait_s(response.headers.get("retry-after", ""), body))
    raise failure


def _reported_wait_s(header: str, body: dict[str, Any]) -> float | None:
    """Server's wait in seconds: from a header in seconds or as a date, or from Gemini's error details."""
    if header.strip().isdecimal():
        return float(header)
    if header:
        try:
            return max(0.0, email.utils.parsedate_to_datetime(header).timestamp() - time.time())
        except (ValueError, OverflowError):
            return None
    error = body.get("error")
    details = error.get("details", ()) if isinstance(error, dict) else ()
    for detail in details if isinstance(details, list) else ():
        delay = detail.get("retryDelay", "") if isinstance(detail, dict) else ""
        number = str(delay).removesuffix("s")
        if number.replace(".", "", 1).isdecimal():
            return float(number)
    return None


SYSTEM_ROLE = "system role"
TOKEN_LIMITS = ("max_tokens", "max_completion_tokens", "maxOutputTokens", "num_predict")
# Spellings in servers' errors; a question is complete without any of these.
_NAMED_AS = {
    "temperature": r"temperature",
    "max_tokens": r"max_tokens",
    "max_completion_tokens": r"max_(?:completion_)?tokens",
    "maxOutputTokens": r"max_?output_?tokens",
    "num_predict": r"num_predict",
    "seed": r"seed",
    "reasoning_effort": r"reasoning(?:_effort|\.effort)?",
    "thinkingConfig": r"thinking\w*",
    "think": r"think(?:ing)?",
    "response_format": r"response_format|json_schema|json_object",
    "responseSchema": r"response_?schema",
    "format": r"[\"'`]format[\"'`]",
    "cache_prompt": r"cache_prompt",
    "id_slot": r"id_slot",
    "stream": r"^stream$|[\"'`]stream[\"'`]|to stream this|stream(?:ing)?(?= is not| not)|support stream(?:ing)?",
    SYSTEM_ROLE: r"(?:system|developer) (?:role|message|instruction|prompt)s?(?= (?:is |are )?not)|roles must alternate"
    r"|messages\[\d+\]\.role|role [\"'`]?system|got system",
}
_WITHIN = ("options", "generationConfig")


def parameters_sent(request: Request) -> tuple[str, ...]:
    """Optional parameters in the request."""
    places = (request.body, *(request.body[key] for key in _WITHIN if key in request.body))
    sent = tuple(name for name in _NAMED_AS if any(name in place for place in places))
    messages = request.body.get("messages") or [{}]
    has_system = messages[0].get("role") == "system" or "systemInstruction" in request.body
    return (*sent, SYSTEM_ROLE) if has_system else sent


def named_parameter(request: Request, answer: dict[str, Any], reason: str) -> str:
    """Parameter that a refusal names in ``param``, ``loc`` or its text; empty for none."""
    sent = parameters_sent(request)
    for text in (*_named_apart(answer), reason):
        found = [(match.start(), name) for name in sent if (match := _pattern(name).search(text))]
        if found:
            return min(found)[1]
    return ""


def _pattern(name: str) -> re.Pattern[str]:
    return re.compile(rf"(?<!\w)(?:{_NAMED_AS[name]})(?!\w)", re.IGNORECASE)


def _named_apart(answer: dict[str, Any]) -> Iterable[str]:
    error = answer.get("error")
    for fields in (error if isinstance(error, dict) else {}, answer):
        if isinstance(fields.get("param"), str):
            yield fields["param"]
    details = answer.get("detail")
    for detail in details if isinstance(details, list) else ():
        if isinstance(detail, dict) and isinstance(detail.get("loc"), list):
            yield " ".join(map(str, detail["loc"]))


def without_system_role(messages: Sequence[ChatMessage]) -> tuple[ChatMessage, ...]:
    """System prompt as the beginning of the first question, for models that know two roles only, such as Gemma's."""
    system = [message.content for message in messages if message.role == "system"]
    others = [message for message in messages if message.role != "system"]
    if others and others[0].role == "user":
        system.append(others.pop(0).content)
    return (ChatMessage("user", "\n\n".join(system)), *others) if system else tuple(others)


def leave_out(request: Request, names: Iterable[str]) -> Request:
    """Request without these parameters; without the limit, only the reader enforces it."""
    names = frozenset(names)
    body = {key: value for key, value in request.body.items() if key not in names}
    for key in _WITHIN:
        if key in body:
            body[key] = {name: value for name, value in body[key].items() if name not in names}
    return replace(request, body=body, bounded=request.bounded and names.isdisjoint(TOKEN_LIMITS))
