"""Disk access does not block the GUI thread, and pending work is finished when the program exits."""

import threading
from collections.abc import Callable, Iterator

import pytest
from PySide6.QtCore import QObject, QTimer
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.live.background_worker import BackgroundWorker
from tests.support.slow_disk import SlowDisk


class Bench:
    def __init__(self) -> None:
        self.owner = QObject()
        self.work = BackgroundWorker(self.owner)
        self.disk = SlowDisk()
        self.told: list[object] = []
        self.threads: set[threading.Thread] = set()

    def ask(self, work: Callable[[], object]) -> None:
        self.work.do(self.disk.delayed(work), self._notify, lambda failure: self._notify(failure.what))

    def _notify(self, outcome: object) -> None:
        self.told.append(outcome)
        self.threads.add(threading.current_thread())

    def finish(self) -> None:
        self.work.finish(lambda _what, work: work())


@pytest.fixture
def bench(qapp: QApplication) -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.disk.release()
    bench.finish()


def _raise(failure: Exception) -> object:
    raise failure


def test_the_gui_thread_continues_and_hears_of_all_in_order(bench: Bench, qtbot: QtBot) -> None:
    bench.disk.hold()
    bench.ask(lambda: 1)
    bench.ask(lambda: _raise(UserFacingError("The disk is full.", "Nothing is kept.", "Make room.")))
    bench.ask(lambda: threading.current_thread() is threading.main_thread())
    ticks: list[int] = []
    timer = QTimer(bench.owner, interval=1)
    timer.timeout.connect(lambda: ticks.append(1))
    timer.start()
    qtbot.waitUntil(lambda: len(ticks) >= 5, timeout=20_000)
    timer.stop()
    assert bench.told == []
    bench.disk.release()
    qtbot.waitUntil(lambda: bench.told == [1, "The disk is full.", False], timeout=20_000)
    assert bench.threads == {threading.main_thread()}


@pytest.mark.logs(r"live\.background_worker: .* failed")
def test_an_unexpected_error_is_reported_and_does_not_end_the_work(bench: Bench, qtbot: QtBot) -> None:
    bench.ask(lambda: _raise(KeyError("x")))
    bench.ask(lambda: "next")
    qtbot.waitUntil(lambda: bench.told == ["A background task failed.", "next"], timeout=20_000)


def test_at_the_end_what_was_asked_is_done_and_what_follows_from_it(bench: Bench) -> None:
    bench.disk.hold()
    bench.work.do(bench.disk.delayed(lambda: "first"), lambda _: bench.ask(lambda: "second"), bench.told.append)
    named: list[str] = []

    def during(what: str, work: Callable[[], None]) -> None:
        named.append(what)
        bench.disk.release()
        work()

    bench.work.finish(during)
    assert bench.told == ["second"]
    assert set(named) == {"The last changes are being written to disk."}
    bench.ask(lambda: "too late")
    bench.finish()
    assert bench.told == ["second"]


def test_nothing_is_waited_for_where_nothing_was_asked(bench: Bench) -> None:
    bench.work.finish(lambda what, _work: pytest.fail(what))
