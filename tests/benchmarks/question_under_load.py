"""Latency of the embedded language model during full operation with recording, compared with an idle console.

Both consoles alternate several times with the same questions, one at a time, first without and then with driving: time
to the first word and to the end of the answer. As answers differ in length, the end is also given per character. Prints
one JSON object.
"""

import argparse
import json
import statistics

from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from caris_desktop.domain import intents
from caris_desktop.domain.events import LlmExchange
from tests.benchmarks.console_under_load import ConsoleUnderLoad
from tests.benchmarks.screen_and_statistics import on_a_screen

QUESTIONS = (
    "What is there to see in this lab?",
    "How do I greet a visitor who has come late?",
    "Say in one sentence what a robot is.",
    "Where could we go next?",
)
_LONGEST_ANSWER_S = 180.0
_LOOK_S = 0.02
_HELD_S = 2.0


def answers_of(load: ConsoleUnderLoad, *, driving: bool) -> list[LlmExchange]:
    """Ask the questions in sequence, each after the previous answer."""
    answers: list[LlmExchange] = []
    load.state.event_happened.connect(lambda event: answers.append(event) if isinstance(event, LlmExchange) else None)
    pad = load.focus_driving() if driving else None
    load.wait_for(lambda: load.state.assistant.value.state == "ready", "language model", 120.0)
    for number, question in enumerate(QUESTIONS, 1):
        load.console.do(intents.Ask(question))
        waited_s = 0.0
        while len(answers) < number:
            if waited_s > _LONGEST_ANSWER_S:
                raise SystemExit(f"no answer within {_LONGEST_ANSWER_S:.0f} s")
            if pad is None:
                load.let_qt_run(_LOOK_S)
                waited_s += _LOOK_S
            else:
                key = (Qt.Key.Key_A, Qt.Key.Key_D)[number % 2]
                QTest.keyPress(pad, key)
                load.let_qt_run(_HELD_S)
                QTest.keyRelease(pad, key)
                load.let_qt_run(_LOOK_S)
                waited_s += _HELD_S
    return answers


def figures(answers: list[LlmExchange]) -> dict[str, float]:
    """Medians, in seconds."""
    first = [(each.first_token_ns - each.asked_ns) / 1e9 for each in answers if each.first_token_ns is not None]
    whole = [(each.stamp_ns - each.asked_ns) / 1e9 for each in answers]
    return {
        "first_word_s": round(statistics.median(first), 2),
        "whole_answer_s": round(statistics.median(whole), 2),
        "ms_per_character": round(1e3 * sum(whole) / max(1, sum(len(each.answer) for each in answers)), 2),
        "answers": len(answers),
    }


def measure(rounds: int) -> dict[str, object]:
    idle: list[LlmExchange] = []
    loaded: list[LlmExchange] = []
    driven: list[LlmExchange] = []
    load_report: dict[str, object] = {}
    for _ in range(rounds):
        console = ConsoleUnderLoad(robot=None, record=False)
        idle += answers_of(console, driving=False)
        console.close()
        console = ConsoleUnderLoad()
        loaded += answers_of(console, driving=False)
        driven += answers_of(console, driving=True)
        load_report = console.load()
        console.close()
    report = {"idle": figures(idle), "under_load": figures(loaded), "under_load_driving": figures(driven)}
    base = report["idle"]
    return {
        "benchmark": "question_under_load",
        **report,
        "times_idle": {
            name: {key: round(each[key] / max(1e-6, base[key]), 2) for key in base if key != "answers"}
            for name, each in report.items()
            if name != "idle"
        },
        "load": load_report,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=2)
    arguments = parser.parse_args()
    on_a_screen()
    print(json.dumps(measure(arguments.rounds)))
