"""Latency from a participant's last word to readable suggested replies, with the embedded model.

``python -m tests.benchmarks.suggestion_latency [--sentences N]`` prints one JSON object. The same sentences, spoken by
a local voice, are processed in real time by three systems: the recogniser and the model alone, with the console's
prompt; an idle console; and one with video, detection and recording. All use temperature 0, so that reply lengths do
not differ by chance.

``first_ms`` is from the end of speech to the first reply that is not withdrawn, ``all_three_ms`` to the completion of
all. ``alone`` is the time until the recogniser has the last words and the pause has passed, and then the model's time
for the same messages; ``console_adds_ms`` is the median of the additional time of an idle console per sentence.
"""

import argparse
import asyncio
import json
import multiprocessing
import re
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.app import process_entry_points
from caris_desktop.conversation.embedded_server import EmbeddedReady
from caris_desktop.conversation.listening.recogniser_messages import RecogniserReady, RecogniserSettings
from caris_desktop.conversation.models.chat import stream_chat
from caris_desktop.conversation.models.endpoint import ModelEndpoint, resolve_endpoint
from caris_desktop.conversation.suggestions import prompt
from caris_desktop.conversation.suggestions.prompt import replies_in
from caris_desktop.conversation.suggestions.suggestion_cycle import SuggestionCycle
from caris_desktop.domain import clock, intents
from caris_desktop.domain.events import ChatMessage, LlmExchange, SuggestionChanged, UtteranceChanged
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.domain.sound_values import MICROPHONE, Hearing
from tests.benchmarks.console_under_load import ConsoleUnderLoad
from tests.benchmarks.screen_and_statistics import on_a_screen, percentiles
from tests.conversation.listening.speech import RATE_HZ, room, spoken

SENTENCES = (
    "Can it hurt people when it moves?",
    "Where is the kitchen?",
    "How many kilos can the robot arm lift?",
    "I think that is really impressive.",
    "Who built you?",
    "What can we see here today?",
    "Could you show me the older robots?",
    "I am a little tired, can we sit down?",
)
_CHUNK = RATE_HZ // 50
_BEFORE_S, _AFTER_S = 0.4, 3.0
_LIMIT_S = 60.0


def speak(sound: NDArray[np.int16], hear: Any) -> int:
    """Play a sentence to ``hear`` in real time, surrounded by room noise; returns the end of its speech."""
    whole = np.concatenate((room(_BEFORE_S), sound, room(_AFTER_S)))
    begun_ns = clock.now_ns()

    def feed() -> None:
        for at in range(0, len(whole) - _CHUNK + 1, _CHUNK):
            due_ns = begun_ns + round((at + _CHUNK) * 1e9 / RATE_HZ)
            time.sleep(max(0.0, (due_ns - clock.now_ns()) / 1e9))
            stamp_ns = begun_ns + round(at * 1e9 / RATE_HZ)
            hear(AudioChunk(stamp_ns, MICROPHONE, RATE_HZ, whole[at : at + _CHUNK, np.newaxis]))

    threading.Thread(target=feed, name="voice").start()
    return begun_ns + round((_BEFORE_S + len(sound) / RATE_HZ) * 1e9)


@dataclass(slots=True)
class Figures:
    """Milliseconds of each sentence, and the suggestions."""

    first_ms: list[float] = field(default_factory=list)
    all_three_ms: list[float] = field(default_factory=list)
    prompts: list[tuple[ChatMessage, ...]] = field(default_factory=list)
    replies: list[list[str]] = field(default_factory=list)
    missed: int = 0

    def told(self) -> dict[str, object]:
        return {
            "first_ms": percentiles(self.first_ms),
            "all_three_ms": percentiles(self.all_three_ms),
            "missed": self.missed,
        }


def of_console(load: ConsoleUnderLoad, sounds: Sequence[NDArray[np.int16]]) -> Figures:
    """Process each sentence in turn; its replies are dismissed once all of them are displayed."""
    state, happened = load.state, list[Any]()
    state.event_happened.connect(happened.append)
    load.wait_for(lambda: state.assistant.value.state == "ready", "language model", 120.0)
    # The sound comes from this benchmark, not from a microphone of the machine.
    load.console.do(intents.UseMicrophone(None))
    load.let_qt_run(1.0)
    state.microphone.set(replace(state.microphone.value, state="on"))
    load.wait_for(lambda: state.listening.value.state == "ready", "recogniser", 180.0)
    figures = Figures()
    for number, sound in enumerate((sounds[0], *sounds)):
        happened.clear()
        voice_ended_ns = speak(sound, load.console._bus.publish)
        load.let_qt_run((voice_ended_ns - clock.now_ns()) / 1e9 + _AFTER_S)
        until_ns = clock.now_ns() + round(_LIMIT_S * 1e9)
        while answered(happened) is None and clock.now_ns() < until_ns:
            load.let_qt_run(0.05)
        exchange = answered(happened)
        if exchange is None:
            figures.missed += 1
            continue
        shown = [event for event in happened if isinstance(event, SuggestionChanged) and event.state == "displayed"]
        stand = [event for event in shown if (event.turn_id, event.revision) == (exchange.turn_id, exchange.revision)]
        if number and stand:  # the first one is a warm-up
            figures.first_ms.append((stand[0].stamp_ns - voice_ended_ns) / 1e6)
            figures.all_three_ms.append((exchange.stamp_ns - voice_ended_ns) / 1e6)
            figures.prompts.append(exchange.messages)
            figures.replies.append([event.text for event in stand])
        load.console.do(intents.DismissSuggestions())
        load.let_qt_run(0.3)
    return figures


def answered(happened: Sequence[Any]) -> LlmExchange | None:
    """The last answered question for replies."""
    asked = [event for event in happened if isinstance(event, LlmExchange) and event.purpose == "replies"]
    return asked[-1] if asked and asked[-1].outcome == "answered" else None


@contextmanager
def process(target: Any, *arguments: Any) -> Iterator[Connection]:
    context = multiprocessing.get_context("spawn")
    connection, theirs = context.Pipe()
    child = context.Process(target=target, args=(theirs, *arguments), daemon=True)
    child.start()
    theirs.close()
    try:
        yield connection
    finally:
        connection.close()
        child.join(5)
        if child.is_alive():
            child.kill()
            child.join()


def rounds_alone(sounds: Sequence[NDArray[np.int16]]) -> list[float]:
    """Milliseconds from the end of each utterance to the recogniser's last words and the end of the pause."""
    waits_ms = []
    with process(process_entry_points.recogniser, RecogniserSettings()) as connection:
        while not isinstance(connection.recv(), RecogniserReady):
            pass
        lock = threading.Lock()

        def hear(chunk: AudioChunk) -> None:
            with lock:
                connection.send(chunk)

        for sound in (sounds[0], *sounds):
            begun_ns: list[int] = []
            rounds = SuggestionCycle(
                lambda _event: None,
                str,
                ask=lambda _round, begun_ns=begun_ns: begun_ns.append(clock.now_ns()),  # type: ignore[misc]
                drop=lambda _why: None,
            )
            voice_ended_ns = speak(sound, hear)
            until_ns = voice_ended_ns + round(_AFTER_S * 1e9)
            while clock.now_ns() < until_ns:
                match connection.recv() if connection.poll(0.005) else None:
                    case Hearing() as hearing:
                        rounds.add(hearing)
                    case UtteranceChanged(speaker="participant") as utterance:
                        rounds.on_participant(utterance, clock.now_ns())
                rounds.pass_time(clock.now_ns())
            waits_ms.append((begun_ns[-1] - voice_ended_ns) / 1e6)
    return waits_ms[1:]


def answers_alone(prompts: Sequence[tuple[ChatMessage, ...]]) -> list[tuple[float, float]]:
    """Milliseconds to the first reply and to all replies, for each question."""
    with process(process_entry_points.language_model) as connection:
        while not isinstance(ready := connection.recv(), EmbeddedReady):
            pass
        endpoint = resolve_endpoint("embedded", embedded_url=ready.url)
        return asyncio.run(_answers((prompts[0], *prompts), endpoint))[1:]


async def _answers(prompts: Sequence[tuple[ChatMessage, ...]], endpoint: ModelEndpoint) -> list[tuple[float, float]]:
    took_ms = []
    for messages in prompts:
        begun_ns, first_ns, written = clock.now_ns(), 0, ""
        async for piece in stream_chat(
            endpoint, messages, local_only=True, max_tokens=prompt.REPLY_TOKENS, temperature=0.0,
            schema=prompt.replies_schema(whole_sentences=True),
        ):  # fmt: skip
            written += piece
            if not first_ns and replies_in(written):
                first_ns = clock.now_ns()
        took_ms.append(((first_ns - begun_ns) / 1e6, (clock.now_ns() - begun_ns) / 1e6))
    return took_ms


def without_chance(folder: Path) -> str:
    """The tour guide with temperature 0."""
    as_shipped = (layouts_dir() / "tour-guide.yaml").read_text("utf-8")
    path = folder / "tour-guide.yaml"
    path.write_text(re.sub(r"(?<=\n  temperature:) [0-9.]+", " 0", as_shipped), "utf-8")
    return str(path)


def measure(sentences: int) -> dict[str, object]:
    sounds = [spoken(text) for text in SENTENCES[:sentences]]
    waits_ms = rounds_alone(sounds)
    with tempfile.TemporaryDirectory(prefix="caris-benchmark-") as folder:
        scenario = without_chance(Path(folder))
        console = ConsoleUnderLoad(robot=None, record=False, scenario=scenario)
        idle = of_console(console, sounds)
        console.close()
        took_ms = answers_alone(idle.prompts)
        console = ConsoleUnderLoad(scenario=scenario)
        loaded = of_console(console, sounds)
        running = console.load()
        console.close()
    alone = Figures(
        [wait + first for wait, (first, _) in zip(waits_ms, took_ms, strict=False)],
        [wait + whole for wait, (_, whole) in zip(waits_ms, took_ms, strict=False)],
    )

    def median(samples: Any) -> float:
        return float(np.median(samples)) if len(samples) else float("nan")

    whole = len(idle.first_ms) == len(sounds) == len(alone.first_ms)

    return {
        "benchmark": "suggestion_latency",
        "idle": idle.told(),
        "under_load": loaded.told(),
        "alone": {**alone.told(), "last_words_ms": percentiles(waits_ms)},
        # By sentence, as durations vary by a factor of two; unknown without an answer.
        "console_adds_ms": float(round(median(np.subtract(idle.first_ms, alone.first_ms)), 1)) if whole else None,
        "times_idle": float(round(median(loaded.first_ms) / median(idle.first_ms), 2)),
        "replies": dict(zip(SENTENCES, idle.replies, strict=False)),
        "load": running,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sentences", type=int, default=len(SENTENCES))
    arguments = parser.parse_args()
    on_a_screen()
    print(json.dumps(measure(arguments.sentences), ensure_ascii=False))
