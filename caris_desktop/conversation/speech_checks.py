"""Pre-session checks of language models and of speech output, and the process that adds a model of the user."""

import asyncio
import logging
import os
import queue
import secrets
import time
from contextlib import aclosing
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from caris_desktop.conversation.embedded_server import (
    INSTALL_EMBEDDED,
    SLOTS,
    EmbeddedFailed,
    ModelAdded,
    embedded_problem,
    missing_for_embedded,
    serve_model,
)
from caris_desktop.conversation.models.chat import AnswerNotes, ChatTimeouts, Retries, stream_chat
from caris_desktop.conversation.models.embedded_models import (
    NOT_ADDED,
    find_added,
    inspect_model,
    model_name,
    store_model,
)
from caris_desktop.conversation.models.endpoint import (
    EMBEDDED_KEY,
    LanguageModelError,
    ModelEndpoint,
    resolve_endpoint,
    served_name,
    shortened,
)
from caris_desktop.conversation.models.reasoning import Withdrawn
from caris_desktop.conversation.spoken_text import spoken
from caris_desktop.conversation.synthesis import VoiceEngine
from caris_desktop.conversation.synthesis_messages import SynthesisSettings
from caris_desktop.domain.events import ChatMessage
from caris_desktop.domain.process_settings import step_back
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value

_log = logging.getLogger(__name__)

_PROBE_TIMEOUTS = ChatTimeouts(first_token_s=30.0)
_QUESTION = "What is the capital of France? Answer in one short sentence."
_ANSWER_TOKENS = 128
_ANSWERS_WITHIN_S = 60.0
_SOUND_WITHIN_S = 15.0
SOUND_ADVICE = (
    "Connect loudspeakers or start the sound server (Debian, Ubuntu: libportaudio2, and libasound2-plugins for "
    "PulseAudio or PipeWire)."
)


class ProbeResult(Value):
    """One line of a check; ``advice`` is empty when ``ok``."""

    ok: bool
    text: str
    advice: str = ""


def probe_language_model(model: str, *, local_only: bool, embedded_url: str | None = None) -> ProbeResult:
    """Ask ``model`` a question and read its complete answer. Blocks, for a minute at most.

    An embedded model without an address is only looked up, since nothing serves it yet.
    """
    try:
        added = served_name(model)
        if added is not None and embedded_url is None:
            if missing := missing_for_embedded(added):
                return ProbeResult(False, missing, INSTALL_EMBEDDED)
            if added:
                find_added(added)
            return ProbeResult(True, f"{model.strip()}, installed")
        endpoint = resolve_endpoint(model, embedded_url=embedded_url)
        return asyncio.run(_probe_answer(model, endpoint, local_only=local_only))
    except LanguageModelError as error:
        return ProbeResult(False, error.what, error.advice)
    except TimeoutError:
        return ProbeResult(False, f"{model} did not finish its answer in time", "Choose a faster model.")


async def _probe_answer(model: str, endpoint: ModelEndpoint, *, local_only: bool) -> ProbeResult:
    notes = AnswerNotes()
    requested_s, first_s = time.monotonic(), 0.0
    pieces: list[str] = []
    stream = stream_chat(
        endpoint, [ChatMessage("user", _QUESTION)],
        local_only=local_only, max_tokens=_ANSWER_TOKENS, temperature=0.0, timeouts=_PROBE_TIMEOUTS, retries=Retries(0),
        slot=SLOTS - 1,  # a separate slot, which preserves the cached prompts of others
        notes=notes,
    )  # fmt: skip
    async with asyncio.timeout(_ANSWERS_WITHIN_S), aclosing(stream):
        async for piece in stream:
            first_s = first_s or time.monotonic() - requested_s
            if isinstance(piece, Withdrawn):
                pieces.clear()
            pieces.append(piece)
    reply, all_s = spoken("".join(pieces)), time.monotonic() - requested_s
    answer = shortened(reply or "".join(pieces), 60)
    text = f"{model} answers “{answer}” (first word after {first_s:.1f} s, complete after {all_s:.1f} s)"
    found = []
    if notes.reasoned:
        found.append("it reasons first, and its reasoning is not spoken")
    if notes.left_out:
        found.append(f"not accepted by the model: {', '.join(notes.left_out)}")
    if notes.cut:
        found.append("its answer is cut off")
    text = "; ".join((text, *found))
    if not reply:
        return ProbeResult(False, text, "None of this answer can be spoken: choose another model.")
    advice = {"": "", "length": "Choose a model that gives short answers.", "filter": "Choose another model."}
    return ProbeResult(not notes.cut, text, advice[notes.cut])


def probe_sound() -> ProbeResult:
    """Check for a voice and an output device. Plays nothing."""
    inbox: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()
    engine = VoiceEngine(SynthesisSettings(), inbox, number=1, look=True)
    deadline_s = time.monotonic() + _SOUND_WITHIN_S
    voice = ""
    try:
        while True:
            try:
                _, event = inbox.get(timeout=max(0.0, deadline_s - time.monotonic()))
            except queue.Empty:
                return ProbeResult(False, "the sound system does not respond", "Restart the sound server.")
            match event:
                case None:
                    return ProbeResult(False, "the voice stopped unexpectedly", "See the log for details.")
                case {"event": "broken", "detail": detail}:
                    return ProbeResult(False, f"no voice ({detail})", "Install espeak-ng.")
                case {"event": "ready", "voice": found}:
                    voice = str(found)
                case {"event": "device", "audible": True}:
                    return ProbeResult(True, f"voice {voice}, sound output found")
                case {"event": "device", "detail": detail}:
                    return ProbeResult(False, f"voice {voice}, but no sound output ({detail})", SOUND_ADVICE)
                case _:
                    _log.error("the voice engine sent %r", event)
    finally:
        engine.close()


_NICENESS = 10


def run_model_addition(connection: Connection, file: Path, name: str = "") -> None:
    """Process entry point: check the file, ask the model a question and copy it.

    It sends ModelAdded or EmbeddedFailed once, and ends at once with the server's threads. It is a process of its own,
    since a file from elsewhere may end the library that reads it.
    """
    step_back(_NICENESS)
    message: ModelAdded | EmbeddedFailed
    try:
        message = _add(file, name)
    except LanguageModelError as error:
        _log.info("%s was not added: %s", file, error)
        message = EmbeddedFailed(embedded_problem(error))
    except Exception as error:
        _log.exception("%s was not added", file)
        message = EmbeddedFailed(embedded_problem(error))
    try:
        connection.send(message)
        connection.close()
    except OSError:
        _log.info("the console is gone")
    logging.shutdown()
    os._exit(0)


def _add(file: Path, name: str) -> ModelAdded:
    name = model_name(file, name)
    found = inspect_model(file)
    key = os.environ[EMBEDDED_KEY] = secrets.token_urlsafe(32)
    try:
        server = serve_model(key, name, file)
    except RuntimeError as error:
        raise LanguageModelError(
            localized(QT_TR_NOOP("{name} cannot be loaded ({error})."), name=file.name, error=error), NOT_ADDED,
            QT_TR_NOOP("Its kind of model may be newer than this program: update it, or choose another model."),
        ) from error  # fmt: skip
    answer = probe_language_model(f"embedded:{name}", local_only=True, embedded_url=str(server.listening_address))
    if not answer.ok:
        raise LanguageModelError(answer.text, NOT_ADDED, answer.advice)
    model, checksum = store_model(file, name)
    return ModelAdded(model.name, found.title, found.size_bytes, found.memory_bytes, checksum, answer.text)
