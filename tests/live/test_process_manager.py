"""Process manager: unused processes end in the background, and none remains when the program exits."""

import os
import signal
import threading
from collections.abc import Iterator

import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.domain.events import Marked
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ChildProcess, ProcessSpec
from caris_desktop.live.service import ProcessManager
from caris_desktop.live.state import LiveState
from tests.live import bodies

_LONG_S = 60.0


class Bench:
    def __init__(self) -> None:
        self.owner = QObject()
        self.state = LiveState(self.owner)
        self.bus = Bus(self.state, self.owner)
        self.children = ProcessManager(self.bus, self.owner)
        self.heard: list[str] = []
        self.unexpected: list[ChildProcess] = []
        self.bus.tap(lambda mark, _raw: self.heard.append(mark.label), (Marked,))

    def start(self, name: str) -> ChildProcess:
        body = ProcessSpec(name, getattr(bodies, name))
        return self.children.start(body, ended=self.unexpected.append, on_message=lambda _message: None)


@pytest.fixture
def bench(qapp: QApplication) -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.children.close()
    bench.children.end()
    bench.bus.end()
    bench.state.close()


def test_one_that_does_not_end_holds_neither_the_caller_nor_another_end_up(bench: Bench, qtbot: QtBot) -> None:
    deaf, echo = bench.start("deaf"), bench.start("echo")
    qtbot.waitUntil(lambda: bench.heard == ["deaf"], timeout=30_000)
    gone, echo_gone = threading.Event(), threading.Event()
    bench.children.dismiss(deaf, grace_s=_LONG_S, then=gone.set)
    bench.children.dismiss(echo, grace_s=_LONG_S, then=echo_gone.set)
    assert echo_gone.wait(30.0), "its end stood behind that of one that does not end"
    assert bench.heard == ["deaf", "farewell"], "its last words are heard"
    assert not gone.is_set()
    assert deaf.pid is not None
    os.kill(deaf.pid, signal.SIGKILL)
    bench.children.end()
    assert gone.is_set(), "the program ends when all have ended"
    assert bench.unexpected == [], "an end that was asked for is not an accident"
