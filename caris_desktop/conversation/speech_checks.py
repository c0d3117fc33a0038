"""Pre-session checks of the language model and of speech output."""

import asyncio
import logging
import queue
import time
from contextlib import aclosing
from typing import Any

from caris_desktop.conversation.embedded_server import INSTALL_EMBEDDED, SLOTS, missing_for_embedded
from caris_desktop.conversation.models.chat import AnswerNotes, ChatTimeouts, Retries, stream_chat
from caris_desktop.conversation.models.embedded_models import find_added
from caris_desktop.conversation.models.endpoint import (
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
