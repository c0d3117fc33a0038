"""Destruction of garbage with Qt objects in the GUI thread."""

import gc
import threading
import weakref

import shiboken6
from PySide6.QtCore import QObject, QTimer
from pytestqt.qtbot import QtBot

from caris_desktop.app.qt_application import GarbageCollector


class _Cycle(QObject):
    def __init__(self) -> None:
        super().__init__()
        self.itself = self
        self.timer = QTimer(self)
        self.timer.start(5)


def test_a_cycle_goes_in_the_gui_thread_however_much_another_allocates(qtbot: QtBot) -> None:
    was_enabled = gc.isenabled()
    gc.enable()
    owner = QObject()
    collector = GarbageCollector(owner)
    died_in: list[threading.Thread] = []
    try:
        for _ in range(20):
            weakref.finalize(_Cycle(), lambda: died_in.append(threading.current_thread()))
        ended = threading.Event()

        def allocate() -> None:
            while not ended.is_set():
                [[number] for number in range(500)]
                kept = [[] for _ in range(2000)]
                kept.clear()

        other = threading.Thread(target=allocate)
        other.start()
        qtbot.waitUntil(lambda: len(died_in) == 20, timeout=20_000)
        ended.set()
        other.join()
        assert set(died_in) == {threading.main_thread()}
    finally:
        collector.stop()
        shiboken6.delete(owner)
    assert gc.isenabled()
    if not was_enabled:
        gc.disable()
