"""Transcription by a server: good and bad answers, and their handling."""

import io
import json
import time
import wave
from collections.abc import Iterator

import httpx
import numpy as np
import pytest

from caris_desktop.conversation.listening import server_engine
from caris_desktop.conversation.listening.engines import EngineUnavailableError, NoEngineError
from caris_desktop.conversation.listening.recogniser_messages import RecogniserSettings
from caris_desktop.conversation.listening.server_engine import KEY_NAME, SERVER_NAME, ServerEngine
from tests.conversation.listening.transcription_server import Server, serving

SOUND = np.full(16_000, 0.25, np.float32)


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    monkeypatch.setenv(KEY_NAME, "sk-secret")
    with serving() as running:
        monkeypatch.setenv(SERVER_NAME, running.address)
        yield running


_OPENED: list[ServerEngine] = []


def engine(
    address: str, *, cloud_models: bool = True, model: str = "whisper-large", language: str = "en"
) -> ServerEngine:
    opened = ServerEngine(
        RecogniserSettings("server", model=model, server=address, language=language, cloud_models=cloud_models)
    )
    _OPENED.append(opened)
    return opened


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    yield
    while _OPENED:
        _OPENED.pop().close()


def test_words_have_times_and_hallucinations_are_removed(server: Server) -> None:
    text = engine(server.address).transcribe(np.tile(SOUND, 3), "We came in.", careful=True)
    assert [(word.text, round(word.start_s, 2), round(word.end_s, 2)) for word in text.words] == [
        ("Where", 0.0, 0.67), ("is", 0.67, 1.0), ("the", 1.0, 1.44), ("lab?", 1.44, 2.0),
    ]  # fmt: skip
    assert text.language == "en"


def test_the_request_is_the_one_that_openai_takes(server: Server) -> None:
    engine(server.address).transcribe(SOUND, "We came in.", careful=True)
    ((path, headers, body),) = server.asked
    assert path == "/v1/audio/transcriptions"
    assert headers["Authorization"] == "Bearer sk-secret"
    for name, value in (("model", "whisper-large"), ("language", "en"), ("prompt", "We came in.")):
        assert f'name="{name}"\r\n\r\n{value}\r\n'.encode() in body
    with wave.open(io.BytesIO(body[body.index(b"RIFF") :])) as sent:
        assert (sent.getframerate(), sent.getnchannels(), sent.getnframes()) == (16_000, 1, len(SOUND))


def test_a_server_that_reports_the_text_alone_will_do(server: Server) -> None:
    server.body = b'{"text": "Where is the lab?"}'
    text = engine(server.address).transcribe(SOUND, "", careful=False)
    assert [word.text for word in text.words] == ["Where", "is", "the", "lab?"]
    assert text.words[-1].end_s == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("status", "body", "words"),
    [
        (401, b'{"error": {"message": "bad key sk-secret"}}', r"401 \(bad key \[key\]\)"),
        (429, b"slow down", "429"),
        (500, b"", "500 .no reason given"),
        (200, b"<html>", "an invalid transcription"),
        (200, b"[]", "an invalid transcription"),
        (200, b'{"segments": [[0, 1, "x"]]}', "an invalid transcription"),
        (200, b" " * 1_100_000, "cannot be reached"),
    ],
)
def test_a_server_error_is_reported_without_the_key(server: Server, status: int, body: bytes, words: str) -> None:
    asked = engine(server.address)
    server.status, server.body = status, body
    with pytest.raises(EngineUnavailableError, match=words) as told:
        asked.transcribe(SOUND, "", careful=True)
    assert "sk-secret" not in str(told.value)
    server.status, server.body = 200, b'{"text": "Hello."}'
    assert asked.transcribe(SOUND, "", careful=True).words[0].text == "Hello.", "it is asked again"


_REFUSED = "response_format 'verbose_json' is not compatible with model 'gpt-4o-transcribe'. Use 'json' instead."
REFUSALS: dict[str, object] = {
    "openai": {"error": {"message": _REFUSED, "param": "response_format", "code": "unsupported_value"}},
    "vllm": {"object": "error", "message": "Currently do not support verbose_json for response_format", "code": 400},
    "says nothing": {"error": "Bad Request"},
    "fastapi": {"detail": [{"loc": ["body", "response_format"], "msg": "Input should be json or text"}]},
}
TEXT = b'{"text": "Where is the lab?"}'


@pytest.mark.parametrize("refusal", REFUSALS)
def test_a_server_without_verbose_json_is_requested_json_from_then_on(server: Server, refusal: str) -> None:
    refused = json.dumps(REFUSALS[refusal]).encode()
    server.answers = lambda fields: (400, refused) if fields["response_format"] == "verbose_json" else (200, TEXT)
    asked = engine(server.address, model="gpt-4o-transcribe")
    for _ in range(2):
        assert [word.text for word in asked.transcribe(SOUND, "", careful=True).words] == ["Where", "is", "the", "lab?"]
    assert [fields["response_format"] for fields in server.fields] == ["verbose_json", "json", "json"]
    assert "json" in asked.request_form


def test_fields_that_a_server_refuses_are_left_out(server: Server) -> None:
    def answers(fields: dict[str, str]) -> tuple[int, bytes]:
        refused = next((name for name in ("temperature", "prompt") if name in fields), "")
        return (422, json.dumps({"error": f"{refused} is not supported"}).encode()) if refused else (200, TEXT)

    server.answers = answers
    asked = engine(server.address)
    assert asked.transcribe(SOUND, "We came in.", careful=True).words[0].text == "Where"
    assert asked.transcribe(SOUND, "We came in.", careful=True).words[0].text == "Where"
    assert len(server.fields) == 4 and "prompt" not in server.fields[-1]
    server.answers = lambda _fields: (400, b'{"error": "the model is unknown"}')
    asked = engine(server.address)
    with pytest.raises(EngineUnavailableError, match="the model is unknown"):
        asked.transcribe(SOUND, "", careful=True)
    server.answers = None
    assert asked.transcribe(SOUND, "", careful=True).words
    assert server.fields[-1]["response_format"] == "verbose_json", "that was not what it refused"


def test_one_connection_serves_every_interval(server: Server) -> None:
    asked = engine(server.address)
    for _ in range(3):
        asked.transcribe(SOUND, "", careful=True)
    assert server.connections == 1
    server.drop_connections()
    assert asked.transcribe(SOUND, "", careful=True).words, "one that the server closed is opened again"
    assert server.connections == 2


def test_one_that_never_answers_is_abandoned(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_engine, "_TIMEOUT", httpx.Timeout(0.2))
    server.wait_s = 5.0
    asked, began_s = engine(server.address), time.monotonic()
    with pytest.raises(EngineUnavailableError, match="timed out"):
        asked.transcribe(SOUND, "", careful=True)
    assert time.monotonic() - began_s < 4


def test_one_that_is_not_there_is_reported() -> None:
    with pytest.raises(EngineUnavailableError, match="cannot be reached"):
        engine("http://127.0.0.1:1/v1").transcribe(SOUND, "", careful=True)


def test_without_cloud_models_no_other_computer_gets_sound(server: Server) -> None:
    with pytest.raises(NoEngineError, match="not on this computer"):
        engine("https://transcriptions.example.org/v1", cloud_models=False)
    assert engine(server.address, cloud_models=False).transcribe(SOUND, "", careful=True).words
    with pytest.raises(NoEngineError, match="does not specify a transcription server"):
        engine("")


def test_a_scenario_does_not_choose_where_the_key_goes(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    for named in ("", "https://api.openai.com/v1", "http://127.0.0.1:1", "http://127.0.0.1", "[::"):
        monkeypatch.setenv(SERVER_NAME, named)
        engine(server.address).transcribe(SOUND, "", careful=True)
    assert len(server.asked) == 5
    assert not any("Authorization" in headers for _path, headers, _body in server.asked)


@pytest.mark.parametrize(
    "address", ["http://192.0.2.1/v1", "http://localhost.example.org", "http://127.0.0.1@192.0.2.1/"]
)
def test_speech_is_not_sent_where_others_can_read_it(address: str) -> None:
    with pytest.raises(NoEngineError, match="is not sent to"):
        engine(address)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ({"text": None}, ""),
        ({"text": " [BLANK_AUDIO]\n [MUSIC PLAYING]\n"}, ""),
        ({"text": "[Music] Where is the lab? [BLANK_AUDIO]"}, "Where is the lab?"),
        ({"text": "(upbeat music)\n- Where is the lab? (laughs)"}, "Where is the lab?"),
        ({"text": "[00:00:00.000 --> 00:00:02.000]  [SPEAKER_00]: Where is the lab?"}, "Where is the lab?"),
        ({"text": "<|en|><|0.00|> Where is the lab?<|2.00|>"}, "Where is the lab?"),
        ({"text": "Where (in the world) is it?"}, "Where (in the world) is it?"),
        ({"text": "Thank you for watching!"}, ""),
        ({"text": "ご視聴ありがとうございました"}, ""),
        ({"text": "Thank you."}, "Thank you."),
        ({"text": "Hello", "segments": [{"text": None}, {"text": ""}]}, "Hello"),
        ({"text": "Hello", "segments": [[0, 0.0, 1.0, "Hello"]]}, "Hello"),
        ({"text": "Hello", "segments": [{"text": "Hello"}]}, "Hello"),
        ({"text": "Hello", "segments": [{"text": "Hello", "avg_logprob": -2.0, "start": 0, "end": 1}]}, ""),
    ],
)
def test_what_a_recogniser_writes_besides_words_was_not_said(server: Server, answer: object, said: str) -> None:
    server.body = json.dumps(answer).encode()
    words = engine(server.address, language="").transcribe(SOUND, "", careful=True).words
    assert " ".join(word.text for word in words) == said


@pytest.mark.parametrize(
    "times", [{"start": 0.0, "end": 30.0}, {"start": None, "end": None}, {"start": -1, "end": float("inf")}]
)
def test_times_outside_the_sound_lose_no_word(server: Server, times: dict[str, object]) -> None:
    server.body = json.dumps({"segments": [{"text": "Where is the lab?", **times}]}).encode()
    words = engine(server.address).transcribe(SOUND, "", careful=True).words
    assert len(words) == 4 and words[0].start_s == 0.0 and words[-1].end_s == 1.0


def test_an_error_with_the_status_of_success_is_reported(server: Server) -> None:
    server.body = b'{"error": "failed to read audio data"}'
    with pytest.raises(EngineUnavailableError, match="failed to read audio data"):
        engine(server.address).transcribe(SOUND, "", careful=True)


def test_a_form_that_is_not_implemented_is_requested_in_the_other(server: Server) -> None:
    def answers(fields: dict[str, str]) -> tuple[int, bytes]:
        if fields.get("response_format") == "verbose_json":
            return 501, b'{"error": "verbose_json is not implemented"}'
        return 200, b'{"text": "Hello."}'

    server.answers = answers
    assert engine(f"{server.address}/audio/transcriptions").transcribe(SOUND, "", careful=True).words
    assert server.asked[0][0] == "/v1/audio/transcriptions"
    server.answers = lambda _fields: (500, b'{"error": "language detection failed"}')
    with pytest.raises(EngineUnavailableError, match="500"):
        engine(server.address).transcribe(SOUND, "", careful=True)
    assert len(server.asked) == 3


@pytest.mark.parametrize(
    ("reported", "code"), [("english", "en"), ("German", "de"), ("pt-BR", "pt"), ("welsh", "welsh"), (None, "fr")]
)
def test_the_language_is_recorded_as_a_code(server: Server, reported: str | None, code: str) -> None:
    server.body = json.dumps({"text": "Hello", "language": reported}).encode()
    assert engine(server.address, language="fr").transcribe(SOUND, "", careful=True).language == code
