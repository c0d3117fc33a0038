"""``desktop_child`` that asks a language model repeatedly.

Further commands: ``choose MODEL``, ``ask_on QUESTION`` (and again whenever an answer has ended), ``ask_off``, and
``clear_field``. Further reports: ``told`` (text below the newest question in the Assistant panel), ``asking``,
``failures`` (number of failed questions) and ``spoken`` (completed utterances).
"""

import sys
from pathlib import Path

from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QLabel, QPlainTextEdit

from caris_desktop.app.console_command import ConsoleRun
from caris_desktop.domain import intents
from caris_desktop.domain.events import LlmExchange, UtteranceChanged
from caris_desktop.live import model_client
from tests.app.console_child import main
from tests.app.desktop_child import DesktopDriver
from tests.app.test_misbehaving_model import WAIT

_ASK_AGAIN_MS = 200


class AskingDriver(DesktopDriver):
    def __init__(self, run: ConsoleRun) -> None:
        self._question = ""
        self._failures = 0
        self._spoken: list[str] = []
        super().__init__(run)
        self._again = QTimer(self, singleShot=True, interval=_ASK_AGAIN_MS)
        self._again.timeout.connect(self._ask)

    def _on_line(self, line: str) -> None:
        word, _, rest = line.partition(" ")
        if word == "choose":
            self._run.console.do(intents.ChooseModel(rest))
        elif word == "ask_on":
            self._question = rest
            self._ask()
        elif word == "ask_off":
            self._question = ""
        elif word == "clear_field":
            self._run.window.findChild(QPlainTextEdit, "speak_field").clear()
        else:
            super()._on_line(line)

    def _ask(self) -> None:
        if self._question:
            self._run.console.do(intents.Ask(self._question))

    def _on_event(self, event: object) -> None:
        super()._on_event(event)
        if isinstance(event, LlmExchange) and event.purpose == "question":
            self._failures += event.outcome == "failed"
            self._again.start()
        elif isinstance(event, UtteranceChanged) and event.state == "finished":
            self._spoken.append(event.text)

    def _state(self) -> dict[str, object]:
        assistant = self._run.console.state.assistant.value
        return {
            **super()._state(),
            "model": assistant.model,
            "told": self._run.window.findChild(QLabel, "assistant_note").text(),
            "asking": any(row.is_pending for row in assistant.exchanges),
            "failures": self._failures,
            "spoken": list(self._spoken),
        }


if __name__ == "__main__":
    # Short timeouts, so that they expire while keys are held.
    model_client._TIMEOUTS["question"] = WAIT
    sys.exit(main(sys.argv[1], Path(sys.argv[2]), AskingDriver, scenario=sys.argv[3]))
