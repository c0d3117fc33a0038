"""Real microphone process with a sound server that hangs: it is killed and replaced."""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.app import process_entry_points
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import MICROPHONE
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.service import ProcessManager
from caris_desktop.live.services.microphone_service import LocalMicrophone, MicrophoneChoice
from caris_desktop.live.state import LiveState
from tests.conversation.sound_server import SoundServer, require_pulseaudio
from tests.support.service_context import context_of

pytestmark = [pytest.mark.long, pytest.mark.logs(r"live\.(bus|child_process): |conversation\.sound_devices: ")]


@pytest.fixture
def sound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SoundServer]:
    require_pulseaudio()
    server = SoundServer(tmp_path / "server")
    monkeypatch.setenv("PULSE_SERVER", server.address)
    yield server
    server.kill()


def test_a_sound_server_that_hangs_costs_some_seconds_of_sound(
    qapp: QApplication, qtbot: QtBot, sound: SoundServer
) -> None:
    owner = QObject()
    state = LiveState(owner)
    bus, chunks = Bus(state, owner), list[AudioChunk]()
    bus.tap(lambda chunk, _raw: chunks.append(chunk), (AudioChunk,))
    body = ProcessSpec("microphone", process_entry_points.microphone, (MICROPHONE,))
    choice = MicrophoneChoice(body, lambda: "", lambda _name: None)
    children = ProcessManager(bus, owner)
    microphone = LocalMicrophone(state.microphone, MICROPHONE, context_of(state, bus, owner, children=children), choice)
    try:
        microphone.open()
        qtbot.waitUntil(lambda: state.microphone.value.state == "on" and len(chunks) > 5, timeout=30_000)
        assert microphone.process.child is not None
        stuck = microphone.process.child.pid
        sound.signal(signal.SIGSTOP)
        qtbot.waitUntil(
            lambda: microphone.process.child is not None and microphone.process.child.pid != stuck, timeout=30_000
        )
        sound.signal(signal.SIGCONT)
        chunks.clear()
        qtbot.waitUntil(lambda: state.microphone.value.state == "on" and len(chunks) > 5, timeout=60_000)
    finally:
        children.close()
        microphone.close()
        microphone.ask_to_end()
        microphone.process.end()
        state.close()
