"""Sound through the whole console with the real processes: participant to recording, wizard to robot."""

import shutil
import wave
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QCoreApplication
from PySide6.QtWidgets import QApplication

from caris_desktop.app import composition
from caris_desktop.domain import intents
from caris_desktop.domain.events import TrialDetails, UtteranceChanged
from caris_desktop.live.console import Console
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.scenario.scenario_model import Permissions
from tests.conversation.sound_server import SoundServer, require_pulseaudio
from tests.support.polling import wait_for
from tests.support.simulated_robot import SimulatedRobot

pytestmark = [pytest.mark.long, pytest.mark.logs(r"live\.bus: ")]


@pytest.fixture
def sound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SoundServer]:
    require_pulseaudio()
    if shutil.which("espeak-ng") is None:
        pytest.skip("espeak-ng is not installed")
    server = SoundServer(tmp_path / "server")
    monkeypatch.setenv("PULSE_SERVER", server.address)
    yield server
    server.kill()


def _until(observe: Callable[[], Any], what: str) -> Any:
    def look() -> Any:
        QCoreApplication.processEvents()
        return observe()

    return wait_for(look, what, timeout_s=60.0)


def _loud_s(path: Path) -> float:
    with wave.open(str(path)) as file:
        samples = np.frombuffer(file.readframes(file.getnframes()), np.int16).astype(float)
        return float(np.count_nonzero(np.abs(samples) > 500) / file.getframerate())


def test_the_participant_is_recorded_and_the_wizard_is_heard_by_the_robot(
    qapp: QApplication, tmp_path: Path, sound: SoundServer
) -> None:
    scenario = replace(
        composition.find_scenario("tour-guide"),
        permissions=Permissions(audio_recording=True, own_voice=True, video_recording=False, assistant=False),
    )
    parts = composition.parts(
        study=composition.open_study(tmp_path / "study"),
        microphone=composition.microphones(lambda _role: "", lambda _role, _name: None),
    )
    utterances: list[UtteranceChanged] = []
    with SimulatedRobot("--empty") as robot:
        console = Console(parts, scenario)
        state = console.state
        state.event_happened.connect(
            lambda event: utterances.append(event) if isinstance(event, UtteranceChanged) else None
        )
        try:
            console.connect_robot(composition.robot_connection("simulated", address=robot.address))
            console.start()
            _until(lambda: state.link.value.state == "connected" and state.map.value, "the robot")
            assert console.do(intents.StartRecording(TrialDetails(participant="P1"), anyway=True)) == ""
            _until(lambda: state.recording.value.state == "recording", "the recording")
            folder = Path(state.recording.value.folder)
            assert state.microphone.value.source == "robot microphone"
            robot.call("/simulator/say", text="Where is the kitchen?")
            _until(lambda: [one for one in robot.state()["sound"]["said"] if one["ended_s"] is not None], "a sentence")
            assert console.do(intents.PushToTalk(on=True)) == ""
            _until(lambda: robot.state()["sound"]["own_voice_s"] > 0.5, "the wizard at the robot's loudspeaker")
            assert console.do(intents.PushToTalk(on=False)) == ""
            _until(lambda: [one.state for one in utterances] == ["requested", "started", "finished"], "its end")
            assert console.do(intents.StopRecording()) == ""
            _until(lambda: state.recording.value.state == "idle", "the end of the recording")
            assert state.microphone.value.state == "off", "nothing needs it any more"
        finally:
            console.shutdown()
    assert _loud_s(folder / "audio-robot-microphone.wav") > 0.3
    assert (folder / "audio-wizard-microphone.wav").is_file()
    recorded = [value for _, value in open_session(folder).values("event/utterance_changed")]
    assert [(one.origin, one.state) for one in recorded] == [
        ("own_voice", "requested"),
        ("own_voice", "started"),
        ("own_voice", "finished"),
    ]
