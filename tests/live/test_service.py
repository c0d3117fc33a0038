"""Restart policy of services: restart, report, and giving up after repeated failures."""

from types import SimpleNamespace
from typing import Any

from PySide6.QtCore import QObject
from pytestqt.qtbot import QtBot

from caris_desktop.live.child_process import ChildProcess
from caris_desktop.live.service import Restarts, Service
from caris_desktop.live.services.load_shedding_service import HealthService
from caris_desktop.live.state import LiveState


class Voice(Service):
    """Service whose end is controlled by the test."""

    def __init__(self, parent: QObject | None = None, *, after_ms: int | None = None) -> None:
        super().__init__(parent)
        self.after_ms = after_ms
        self.happened: list[str] = []
        self.child: Any = None
        self.counted = Restarts()

    def begin(self) -> None:
        self.child = SimpleNamespace()
        self.happened.append("begun")

    def crash(self) -> None:
        self.child = None
        self.counted.after_end(self.happened.append, self.begin, after_ms=self.after_ms, within=self)

    def processes(self) -> dict[str, ChildProcess]:
        return {} if self.child is None else {"speech": self.child}

    def restarts(self) -> dict[str, Restarts]:
        return {"speech": self.counted}


AGAIN, GIVEN_UP = "It is being restarted.", "It failed too often: restart the program."


def test_the_wizard_is_notified_and_then_it_is_begun_again_three_times(qtbot: QtBot) -> None:
    voice = Voice()
    for _ in range(4):
        voice.crash()
    assert voice.happened == [AGAIN, "begun"] * 3 + [GIVEN_UP]


def test_the_state_of_a_process_can_be_read(qtbot: QtBot) -> None:
    state, voice = LiveState(), Voice(after_ms=50)
    service = HealthService(state, lambda: (voice,), voice)

    def health() -> dict[str, str]:
        service.update()
        return dict(state.health.value)

    assert health() == {}, "nothing needs it yet"
    voice.begin()
    assert health() == {"speech": "running"}
    for _ in range(3):
        voice.crash()
        assert health() == {"speech": "restarting"}
        qtbot.waitUntil(lambda: health() == {"speech": "running"}, timeout=5000)
    voice.crash()
    assert health() == {"speech": "failed"}
    state.close()


def test_a_pending_restart_ends_with_its_owner(qtbot: QtBot) -> None:
    owner = QObject()
    restarts, begun = Restarts(), list[str]()
    restarts.after_end(lambda _advice: None, lambda: begun.append("begun"), after_ms=20, within=owner)
    kept = Restarts()
    kept.after_end(lambda _advice: None, lambda: begun.append("other"), after_ms=60, within=(other := QObject()))
    owner.deleteLater()
    qtbot.waitUntil(lambda: bool(begun), timeout=5000)
    assert begun == ["other"] and other is not None
