"""Preflight: does a language model answer, can this computer speak?"""

import asyncio
import logging
import queue
import time
from contextlib import aclosing
from typing import Any

from caris_desktop.conversation.embedded_messages import SLOTS
from caris_desktop.conversation.embedded_server import INSTALL_EMBEDDED, missing_for_embedded
from caris_desktop.conversation.models.chat import ChatTimeouts, Retries, stream_chat
from caris_desktop.conversation.models.endpoint import ModelEndpoint, resolve_endpoint
from caris_desktop.conversation.models.words import LanguageModelError
from caris_desktop.conversation.synthesis_messages import SynthesisSettings
from caris_desktop.conversation.voices.engine_process import VoiceEngine
from caris_desktop.domain.events import ChatMessage
from caris_desktop.domain.value_class import dataclass

_log = logging.getLogger(__name__)

_PROBE_TIMEOUTS = ChatTimeouts(first_token_s=30.0)
_SOUND_WITHIN_S = 15.0
SOUND_ADVICE = (
    "Connect loudspeakers or start the sound server (Debian, Ubuntu: libportaudio2, and libasound2-plugins for "
    "PulseAudio or PipeWire)."
)


@dataclass(frozen=True, slots=True)
class ProbeResult:
    """One line of a preflight; ``advice`` is empty when ``ok``."""

    ok: bool
    text: str
    advice: str = ""


def probe_language_model(model: str, *, local_only: bool, embedded_url: str | None = None) -> ProbeResult:
    """Ask ``model`` for one word. Blocks, for half a minute at the most.

    ``embedded`` without an address is only looked for, since nothing serves it yet.
    """
    if model.strip() == "embedded" and embedded_url is None:
        missing = missing_for_embedded()
        return ProbeResult(False, missing, INSTALL_EMBEDDED) if missing else ProbeResult(True, "embedded, installed")
    try:
        endpoint = resolve_endpoint(model, embedded_url=embedded_url)
        seconds = asyncio.run(_seconds_to_answer(endpoint, local_only=local_only))
    except LanguageModelError as error:
        return ProbeResult(False, error.what, error.advice)
    if seconds is None:
        return ProbeResult(False, f"{model} answers with nothing", "Choose another model.")
    return ProbeResult(True, f"{model} began to answer after {seconds:.1f} s")


async def _seconds_to_answer(endpoint: ModelEndpoint, *, local_only: bool) -> float | None:
    asked_s = time.monotonic()
    question = [ChatMessage("user", "Say yes.")]
    answer = stream_chat(
        endpoint, question,
        local_only=local_only, max_tokens=64, temperature=0.0, timeouts=_PROBE_TIMEOUTS, retries=Retries(0),
        slot=SLOTS - 1,  # what those are told who wait for an answer is not to be read anew because of this
    )  # fmt: skip
    async with aclosing(answer):
        async for _ in answer:
            return time.monotonic() - asked_s
    return None


def probe_sound() -> ProbeResult:
    """Whether there is a voice and an output device. Plays nothing."""
    inbox: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()
    engine = VoiceEngine(SynthesisSettings(), inbox, number=1, look=True)
    deadline_s = time.monotonic() + _SOUND_WITHIN_S
    voice = ""
    try:
        while True:
            try:
                _, event = inbox.get(timeout=max(0.0, deadline_s - time.monotonic()))
            except queue.Empty:
                return ProbeResult(False, "the sound system does not answer", "Restart the sound server.")
            match event:
                case None:
                    return ProbeResult(False, "the voice ended unexpectedly", "Look into the log.")
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
