"""``caris-desktop check`` for speech recognition, with the same result as in a session."""

import io
import wave
from dataclasses import replace
from pathlib import Path

import pytest

from caris_desktop.app import composition
from caris_desktop.app.check_command import recogniser_finding
from caris_desktop.scenario.scenario_model import ListeningSettings, Scenario
from tests.conversation.listening.transcription_server import serving


@pytest.fixture
def shipped() -> Scenario:
    return composition.find_scenario("mental-health-check")


def test_a_model_next_to_the_scenario_is_found_and_a_missing_one_is_reported(shipped: Scenario, tmp_path: Path) -> None:
    named = replace(shipped, path=tmp_path / "mine.yaml", listening=ListeningSettings(model="small"))
    missing = recogniser_finding(named)
    assert not missing.ok
    assert "not a faster-whisper model" in missing.text
    (tmp_path / "small").mkdir()
    (tmp_path / "small" / "model.bin").write_bytes(b"weights")
    found = recogniser_finding(named)
    assert (found.ok, found.text) == (True, str(tmp_path / "small"))


def test_a_server_that_may_not_be_used_is_reported(shipped: Scenario) -> None:
    listening = ListeningSettings(engine="server", model="whisper-1", server="https://lab.example.org/v1")
    refused = recogniser_finding(replace(shipped, listening=listening))
    assert not refused.ok
    assert "not on this computer" in refused.text
    here = replace(listening, server="http://127.0.0.1:9/v1")
    away = recogniser_finding(replace(shipped, listening=here))
    assert not away.ok and "127.0.0.1:9 cannot be reached" in away.text


def test_a_server_is_sent_a_second_of_sound_and_what_it_does_not_take_is_reported(shipped: Scenario) -> None:
    with serving() as server:
        server.answers = lambda fields: (
            (400, b'{"error": "no verbose_json here"}')
            if fields["response_format"] == "verbose_json"
            else (200, b'{"text": ""}')
        )
        listening = ListeningSettings(engine="server", model="whisper-1", server=server.address)
        found = recogniser_finding(replace(shipped, listening=listening))
        server.answers = lambda _fields: (404, b'{"error": "no such model"}')
        refused = recogniser_finding(replace(shipped, listening=listening))
    assert found.ok and "json requested" in found.text and "one second of audio" in found.text
    _path, _headers, body = server.asked[0]
    with wave.open(io.BytesIO(body[body.index(b"RIFF") :])) as sent:
        assert sent.getnframes() == sent.getframerate()
    assert not refused.ok and "no such model" in refused.text
