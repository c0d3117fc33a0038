"""Speech recognition by a server with OpenAI's transcription API (POST /v1/audio/transcriptions)."""

import asyncio
import io
import itertools
import math
import os
import re
import wave
from collections.abc import Iterator
from typing import Any, TypeVar
from urllib.parse import urlsplit

import httpx
import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.listening.engines import EngineUnavailableError, NoEngineError, Recognised
from caris_desktop.conversation.listening.recognised_words import (
    RecognisedWord,
    is_nothing,
    language_code,
    words_only,
)
from caris_desktop.conversation.listening.recogniser_messages import RecogniserSettings
from caris_desktop.conversation.models.connection import api_key, connected, send
from caris_desktop.conversation.models.endpoint import LanguageModelError, ModelEndpoint, shortened, without
from caris_desktop.conversation.models.failures import NO_REASON, error_in
from caris_desktop.conversation.models.question import object_in, small_body
from caris_desktop.domain.address import is_encrypted_or_local, is_same_server, without_credentials
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.translation import QT_TR_NOOP, localized

KEY_NAME = "CARIS_TRANSCRIPTION_KEY"
SERVER_NAME = "CARIS_TRANSCRIPTION_SERVER"
"""The server that the key is for: the user names it, since a scenario must not choose where a key goes."""
_RATE_HZ = 16_000
_USUAL_MODEL = "whisper-1"
_TIMEOUT = httpx.Timeout(12.0, connect=4.0)
_ANSWER_WITHIN_S = 20.0
_ANSWER_AT_MOST_BYTES = 1_000_000
_REFUSED = (400, 422)
_NOT_IMPLEMENTED = (500, 501)
_PATH = "/audio/transcriptions"
_OPTIONAL = ("response_format", "temperature", "language", "prompt")
_NO_TEXT = QT_TR_NOOP("Speech is not transcribed; everything else works.")


class ServerEngine:
    """Each interval is a separate request, so that an unavailable server is retried with the next."""

    every_s = 2.0  # a growing turn is sent repeatedly, and some servers charge by the minute

    def __init__(self, settings: RecogniserSettings) -> None:
        """Sends nothing. Raises NoEngineError."""
        if not settings.server:
            raise NoEngineError(
                QT_TR_NOOP("The scenario does not specify a transcription server."),
                _NO_TEXT,
                QT_TR_NOOP("Set listening.server."),
            )
        if not is_encrypted_or_local(settings.server):
            raise NoEngineError(
                localized(
                    QT_TR_NOOP(
                        "Participants' speech is not sent to {server}, because others could read it in transit."
                    ),
                    server=without_credentials(settings.server),
                ),
                _NO_TEXT,
                QT_TR_NOOP("Give listening.server an https:// address, or run the server on this computer."),
            )
        self._endpoint = ModelEndpoint(
            "openai",
            settings.server.rstrip("/").removesuffix(_PATH),
            settings.model or _USUAL_MODEL,
            _key_names(settings.server),
        )
        self._local_only = not settings.cloud_models
        self._runner = asyncio.Runner()  # reuses its connection
        self._refused: dict[str, str] = {}
        self.language = settings.language
        self.model = f"{self._endpoint.model} at {self._endpoint.server}"
        try:
            self._key = self._runner.run(self._check())
        except LanguageModelError as error:
            self.close()
            raise NoEngineError(error.what, _NO_TEXT, error.advice) from error

    def transcribe(self, sound: NDArray[np.float32], before: str, *, careful: bool, voice_s: float = 0.0) -> Recognised:
        """See Engine."""
        fields = {"model": self._endpoint.model, "response_format": "verbose_json", "temperature": "0"}
        if self.language:
            fields["language"] = self.language
        if before:
            fields["prompt"] = before
        try:
            file = io.BytesIO()
            with wave.open(file, "wb") as writer:
                writer.setnchannels(1)
                writer.setsampwidth(2)
                writer.setframerate(_RATE_HZ)
                writer.writeframes((np.clip(sound, -1.0, 1.0) * 32767).astype("<i2").tobytes())
            status, body = self._ask(fields, file.getvalue())
        except (httpx.HTTPError, TimeoutError, OSError, LanguageModelError) as error:
            late = isinstance(error, (TimeoutError, httpx.TimeoutException))
            detail = shortened(without(self._key, str(error))) or type(error).__name__
            what = (
                QT_TR_NOOP("The transcription server at {server} timed out.")
                if late
                else QT_TR_NOOP("The transcription server at {server} cannot be reached ({detail}).")
            )
            again = QT_TR_NOOP("The console tries again with the next utterance.")
            raise self._away(what, again, detail=detail) from error
        if status != 200:
            refused = QT_TR_NOOP("The transcription server at {server} returned the status {status} ({reason}).")
            raise self._away(refused, _advice(status), status=status, reason=_reason(body, self._key))
        try:
            answer = parse_json(body)
            if not answer.get("segments") and "text" not in answer and (reason := error_in(answer)) != NO_REASON:
                # whisper.cpp reports errors with the status of success.
                failed = QT_TR_NOOP("The transcription server at {server} reported an error ({reason}).")
                raise self._away(failed, _advice(status), reason=without(self._key, reason))
            language = language_code(str(answer.get("language") or self.language))
            return Recognised(tuple(_words(answer, len(sound) / _RATE_HZ, self.language or language)), language)
        except (ValueError, TypeError, AttributeError, LookupError) as error:
            what = QT_TR_NOOP("The transcription server at {server} returned an invalid transcription.")
            raise self._away(what, QT_TR_NOOP("Correct listening.server.")) from error

    def close(self) -> None:
        """Close the connection."""
        self._runner.close()

    @property
    def request_form(self) -> str:
        """Fields that the server refuses, as text; empty for none."""
        instead = {
            "json": "json requested, because the server does not support verbose_json",
            "": "{name} not sent, because the server rejects it",
        }
        return "; ".join(instead[value].format(name=name) for name, value in self._refused.items())

    def _ask(self, fields: dict[str, str], wav: bytes) -> tuple[int, bytes]:
        """Send a request without refused fields; gpt-4o-transcribe and others do not know ``verbose_json``."""
        guessed = False
        while True:
            sent = {name: value for name, value in (fields | self._refused).items() if name in fields and value}
            status, body = self._runner.run(self._post(sent, wav))
            refused = _refused_field(sent, body) if status in (*_REFUSED, *_NOT_IMPLEMENTED) else ""
            if status in _NOT_IMPLEMENTED and sent.get(refused) != "verbose_json":
                refused = ""
            if status in _REFUSED and not refused and sent.get("response_format") == "verbose_json":
                # The least supported field, if the server names none.
                refused, guessed = "response_format", True
            elif guessed and status != 200:
                del self._refused["response_format"]
                return status, body
            if not refused:
                return status, body
            self._refused[refused] = "json" if sent[refused] == "verbose_json" else ""

    async def _check(self) -> str | None:
        async with connected(self._endpoint, local_only=self._local_only):
            return await api_key(self._endpoint)

    async def _post(self, fields: dict[str, str], wav: bytes) -> tuple[int, bytes]:
        headers = {"Authorization": f"Bearer {self._key}"} if self._key else {}
        path = ("" if urlsplit(self._endpoint.base_url).path else "/v1") + _PATH
        async with asyncio.timeout(_ANSWER_WITHIN_S), connected(self._endpoint, local_only=self._local_only) as client:
            request = client.build_request(
                "POST", path.removeprefix("/"),
                data=fields, files={"file": ("speech.wav", wav, "audio/wav")}, headers=headers, timeout=_TIMEOUT,
            )  # fmt: skip
            response = await send(client, request)
            try:
                body = await small_body(response, _ANSWER_AT_MOST_BYTES)
            finally:
                await response.aclose()
        if len(body) > _ANSWER_AT_MOST_BYTES:
            raise httpx.DecodingError("the answer is too long")
        return response.status_code, body

    def _away(self, what: str, advice: str, **values: object) -> EngineUnavailableError:
        return EngineUnavailableError(localized(what, server=self._endpoint.server, **values), _NO_TEXT, advice)


def _key_names(server: str) -> tuple[str, ...]:
    """Names of keys that may be sent to this server, which a scenario names: those that the user gave for it."""
    names = (f"{KEY_NAME}@{urlsplit(server).hostname}",)
    return (KEY_NAME, *names) if is_same_server(os.environ.get(SERVER_NAME, ""), server) else names


def _refused_field(fields: dict[str, str], body: bytes) -> str:
    """Optional field that a refusal names; the server can do without each of them."""
    body_text = body.decode("utf-8", "replace")
    words = {"response_format": "response_format|verbose_json"}
    return next(
        (
            name for name in _OPTIONAL
            if name in fields and re.search(rf"(?<![A-Za-z])(?:{words.get(name, name)})(?![A-Za-z])", body_text)
        ),
        "",
    )  # fmt: skip


def _words(answer: Any, seconds: float, language: str) -> Iterator[RecognisedWord]:
    """Words of the segments, or of the whole text without segments, at times within the sound."""
    # Some servers give segments as lists, or without times.
    given = [segment for segment in answer.get("segments") or () if isinstance(segment, dict)]
    segments = [segment for segment in given if segment.get("text")]
    for segment in segments or [{"text": answer["text"] or "", "start": 0.0, "end": seconds}]:
        text = str(segment["text"])
        no_speech = _number(segment.get("no_speech_prob"), None)
        likely = _number(segment.get("avg_logprob"), 0.0)
        if not is_nothing(text, no_speech=no_speech, log_probability=likely, language=language):
            # Some servers pad the sound, to 30 s, and place the last words there.
            start_s = min(max(_number(segment.get("start"), 0.0), 0.0), seconds)
            end_s = min(max(_number(segment.get("end"), seconds), start_s), seconds)
            yield from _spread(words_only(text).split(), start_s, end_s)


_Otherwise = TypeVar("_Otherwise", float, None)


def _number(value: Any, otherwise: _Otherwise) -> float | _Otherwise:
    """Finite number, ``otherwise`` for anything else."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        return otherwise
    return number if math.isfinite(number) else otherwise


def _spread(words: list[str], start_s: float, end_s: float) -> Iterator[RecognisedWord]:
    """Words with estimated times, proportional to their length."""
    ends = list(itertools.accumulate(len(word) + 1 for word in words))
    for word, end in zip(words, ends, strict=True):
        per_s = (end_s - start_s) / ends[-1]
        yield RecognisedWord(word, start_s + (end - len(word) - 1) * per_s, start_s + end * per_s)


def _reason(body: bytes, key: str | None) -> str:
    answer = object_in(body)
    message = error_in(answer) if answer else body.decode("utf-8", "replace")
    return shortened(without(key, message), 100) or QT_TR_NOOP("no reason given")


def _advice(status: int) -> str:
    match status:
        case 401 | 403:
            return localized(
                QT_TR_NOOP(
                    "Before starting the console, set {name} to a key that this server accepts and "
                    "{server_name} to its address."
                ),
                name=KEY_NAME,
                server_name=SERVER_NAME,
            )
        case 404:
            return QT_TR_NOOP("Correct listening.server and listening.model.")
        case 429:
            return QT_TR_NOOP(
                "The server is overloaded, or your account has no credit left. The console tries again automatically."
            )
    return QT_TR_NOOP("The console tries again with the next utterance.")
