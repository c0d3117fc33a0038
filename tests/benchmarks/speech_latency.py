"""From the Enter key to the first sound, and from the key that silences to silence, in what a listener hears.

The real console in its window, a warm Piper voice, sentences that were not made ahead of time, and a PulseAudio null
sink whose monitor is recorded: both ends of each figure are the key event and the recorded sound, none of the console's
own events. Once with nothing else running and once with a program that burns a core. Prints one JSON object.
"""

import argparse
import json
import os
import random
import tempfile
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


def sentences(count: int) -> list[str]:
    """Different ones of the length that people type."""
    words = random.Random(11)  # noqa: S311 - sentences
    parts = (_SUBJECTS, _VERBS, _OBJECTS, _ENDS)
    return [" ".join(words.choice(part) for part in parts) for _ in range(count)]


def measure(load: ConsoleUnderLoad, heard: StampedSound, texts: list[str]) -> dict[str, dict[str, float]]:
    field = load.window.findChild(QPlainTextEdit, "speak_field")
    to_sound_ms: list[float] = []
    to_silence_ms: list[float] = []
    for text in texts:
        field.setFocus()
        field.clear()
        QTest.keyClicks(field, text)
        load.let_qt_run(0.05)
        entered_ns = clock.now_ns()
        QTest.keyClick(field, Qt.Key.Key_Return)
        load.wait_for(lambda: _is_started(load), "the sentence", 30.0)
        load.let_qt_run(_SPOKEN_BEFORE_SILENCE_S)
        silenced_ns = clock.now_ns()
        QTest.keyClick(load.window, Qt.Key.Key_F12)
        load.wait_for(lambda: load.state.speech.value.now is None, "silence", 30.0)
        load.let_qt_run(_PAUSE_S)
        began_ns, _ = heard.loud_between(entered_ns, silenced_ns, least=_HEARD_AT_LEAST)
        to_sound_ms.append((began_ns - entered_ns) / 1e6)
        _, ended_ns = heard.loud_between(entered_ns, clock.now_ns(), least=_HEARD_AT_LEAST)
        to_silence_ms.append(max(0.0, (ended_ns - silenced_ns) / 1e6))
    return {"enter_to_sound_ms": percentiles(to_sound_ms), "silence_ms": percentiles(to_silence_ms)}


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
            with sound.stamped() as heard:
                texts = sentences(2 * count)
                measure(load, heard, sentences(2 * count + 2)[-2:])
                quiet = measure(load, heard, texts[:count])
                burners = Burners(1)
                try:
                    busy = measure(load, heard, texts[count:])
                finally:
                    burners.end()
        finally:
            load.close()
            sound.kill()
    return {"benchmark": "speech_latency", "voice": used, **quiet, "beside_a_burner": busy, "cpu_count": os.cpu_count()}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=60, help="sentences each time")
    arguments = parser.parse_args()
    on_a_screen()
    print(json.dumps(report(arguments.count)))
