"""The microphone is heard before a recording is called running, and whoever waits for it does not wait forever."""

from collections.abc import Iterator

import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.conversation.microphone_messages import (
    CloseMicrophone,
    MicrophoneFailed,
    MicrophoneList,
    MicrophoneOpened,
    OpenMicrophone,
)
from caris_desktop.domain.events import Problem
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ProcessBody
from caris_desktop.live.services import microphone
from caris_desktop.live.services.microphone import MicrophoneParts, MicrophoneService
from caris_desktop.live.state import LiveState
from tests.live.bodies import echo

HEADSET = MicrophoneOpened("Headset", 16000)


class FakeChild:
    """Stands for the microphone's process: keeps what it is asked."""

    def __init__(self) -> None:
        self.asked: list[object] = []
        self.send = self.asked.append


class FakeChildren:
    def __init__(self, child: FakeChild) -> None:
        self._child = child

    def start(self, _body: ProcessBody, **_told: object) -> FakeChild:
        return self._child


class Bench:
    def __init__(self, chosen: str | None) -> None:
        self.child = FakeChild()
        self.told: list[str] = []
        self.begun = 0
        self.owner = QObject()
        state = LiveState(self.owner)
        bus = Bus(state, self.owner)
        bus.tap(lambda value, _raw: self.told.append(value.what), (Problem,))
        self.service = MicrophoneService(
            state,
            bus,
            FakeChildren(self.child),  # type: ignore[arg-type]
            MicrophoneParts(ProcessBody("microphone", echo), chosen=lambda: chosen, keep=lambda _name: None),
            parent=self.owner,
        )

    def begin(self) -> None:
        self.begun += 1


@pytest.fixture
def bench(qapp: QApplication) -> Iterator[Bench]:
    bench = Bench(chosen="")
    yield bench
    bench.service.close()


def test_what_waits_for_the_sound_is_done_when_it_comes(bench: Bench) -> None:
    bench.service.open_and_then(bench.begin)
    bench.service.on_message(MicrophoneList(("Headset",)))
    assert bench.child.asked == [OpenMicrophone("")]
    assert bench.begun == 0
    bench.service.on_message(HEADSET)
    assert bench.begun == 1
    assert bench.told == []
    bench.service.close()
    bench.service.on_message(HEADSET)
    assert bench.begun == 1


def test_a_microphone_that_fails_keeps_nobody_waiting(bench: Bench) -> None:
    bench.service.open_and_then(bench.begin)
    bench.service.on_message(MicrophoneFailed(None))
    assert bench.begun == 1


def test_without_a_microphone_nothing_waits(qapp: QApplication) -> None:
    bench = Bench(chosen=None)
    bench.service.open_and_then(bench.begin)
    assert bench.begun == 1
    assert OpenMicrophone("") not in bench.child.asked


def test_whoever_changes_their_mind_starts_nothing(bench: Bench) -> None:
    bench.service.open_and_then(bench.begin)
    bench.service.close()
    bench.service.on_message(HEADSET)
    assert bench.begun == 0
    assert bench.child.asked[-1] == CloseMicrophone()


def test_sound_that_comes_too_late_is_told_with_what_is_missing(qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(microphone, "_OPENS_WITHIN_MS", 10)
    bench = Bench(chosen="")
    bench.service.open_and_then(bench.begin)
    qtbot.waitUntil(lambda: bench.begun == 1)
    assert bench.told == []
    bench.service.on_message(HEADSET)
    bench.service.on_message(HEADSET)
    assert bench.begun == 1
    assert len(bench.told) == 1
    assert "after the recording had begun" in bench.told[0]
    bench.service.close()
