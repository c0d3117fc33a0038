"""Latency from the Enter key to the first sound, and from the silence key to silence, in recorded sound.

The real console in its window, a warm Piper voice, new sentences, and a PulseAudio null sink whose monitor is recorded:
each value is measured from the key event to the recorded sound, without events of the console. Typed as people do, with
about a sixth of a second between the last keys and before Enter, so that synthesis can start early; and, for
comparison, inserted as a whole with Enter at once, which leaves no time. Each on an idle machine and with a program
that uses a core completely. Prints one JSON object.
"""

import argparse
import itertools
import json
import os
import random
import tempfile
from collections.abc import Iterator
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QPlainTextEdit

from caris_desktop.domain import clock, intents
from tests.benchmarks.burners import Burners
from tests.benchmarks.console_under_load import ConsoleUnderLoad
from tests.benchmarks.screen_and_statistics import on_a_screen, percentiles
from tests.conversation.sound_server import SoundServer, StampedSound

VOICE = "piper:en_US-joe-medium"
_SUBJECTS = ("The robot", "Our visitor", "This machine", "The new arm", "My colleague", "The camera")
_VERBS = ("lifts", "watches", "finds", "carries", "measures", "repairs", "shows", "follows")
_OBJECTS = ("five small boxes", "the long corridor", "a cup of tea", "every step", "the old printer", "blue cubes")
_ENDS = ("today.", "in the lab.", "every morning.", "as you can see.", "if you like, of course.")
_HEARD_AT_LEAST = 200
_SPOKEN_BEFORE_SILENCE_S = 0.6
_PAUSE_S = 0.4
_KEYS_AT_A_TIME = 6
_BETWEEN_KEYS_S = (0.11, 0.25)
_RIGHT_BEHIND_S = 0.02


def sentences(count: int) -> list[str]:
    """Distinct sentences of a typical typed length."""
    every = itertools.product(_SUBJECTS, _VERBS, _OBJECTS, _ENDS)
    return [" ".join(parts) for parts in random.Random(11).sample(list(every), count)]  # noqa: S311 - a benchmark, not cryptography


def measure(load: ConsoleUnderLoad, recording: StampedSound, texts: list[str], *, typed: bool) -> dict[str, object]:
    field = load.window.findChild(QPlainTextEdit, "speak_field")
    rhythm = random.Random(12)  # noqa: S311 - a benchmark, not cryptography
    to_sound_ms: list[float] = []
    to_silence_ms: list[float] = []
    for text in texts:
        field.setFocus()
        field.clear()
        by_key = text[-_KEYS_AT_A_TIME:] if typed else ""
        field.insertPlainText(text.removesuffix(by_key))
        for key in by_key:
            load.let_qt_run(rhythm.uniform(*_BETWEEN_KEYS_S))
            QTest.keyClicks(field, key)
        load.let_qt_run(rhythm.uniform(*_BETWEEN_KEYS_S) if typed else _RIGHT_BEHIND_S)
        entered_ns = clock.now_ns()
        QTest.keyClick(field, Qt.Key.Key_Return)
        load.wait_for(lambda: _is_started(load), "the sentence", 30.0)
        load.let_qt_run(_SPOKEN_BEFORE_SILENCE_S)
        silenced_ns = clock.now_ns()
        QTest.keyClick(load.window, Qt.Key.Key_F12)
        load.wait_for(lambda: load.state.speech.value.now is None, "silence", 30.0)
        load.let_qt_run(_PAUSE_S)
        began_ns, _ = recording.loud_between(entered_ns, silenced_ns, least=_HEARD_AT_LEAST)
        to_sound_ms.append((began_ns - entered_ns) / 1e6)
        _, ended_ns = recording.loud_between(entered_ns, clock.now_ns(), least=_HEARD_AT_LEAST)
        to_silence_ms.append(max(0.0, (ended_ns - silenced_ns) / 1e6))
    return {"enter_to_sound_ms": percentiles(to_sound_ms), "silence_ms": percentiles(to_silence_ms)}


def _both(load: ConsoleUnderLoad, recording: StampedSound, texts: Iterator[str], count: int) -> dict[str, object]:
    typed = measure(load, recording, list(itertools.islice(texts, count)), typed=True)
    return typed | {"at_once": measure(load, recording, list(itertools.islice(texts, count)), typed=False)}


def _is_started(load: ConsoleUnderLoad) -> bool:
    now = load.state.speech.value.now
    return now is not None and now.state == "started"


def report(count: int) -> dict[str, object]:
    with tempfile.TemporaryDirectory(prefix="caris-sound-") as folder:
        sound = SoundServer(Path(folder) / "server")
        os.environ["PULSE_SERVER"] = sound.address
        load = ConsoleUnderLoad(robot=None, record=False)
        try:
            load.console.do(intents.SetVoice("computer", VOICE))
            load.wait_for(lambda: bool(load.state.voice.value.used), "voice", 120.0)
            used = load.state.voice.value.used
            with sound.stamped() as recording:
                texts = iter(sentences(4 * count + 2))
                measure(load, recording, [next(texts), next(texts)], typed=True)
                quiet = _both(load, recording, texts, count)
                burners = Burners(1)
                try:
                    busy = _both(load, recording, texts, count)
                finally:
                    burners.end()
        finally:
            load.close()
            sound.kill()
    return {"benchmark": "speech_latency", "voice": used, **quiet, "beside_a_burner": busy, "cpu_count": os.cpu_count()}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=40, help="sentences each of the four times")
    arguments = parser.parse_args()
    on_a_screen()
    print(json.dumps(report(arguments.count)))
