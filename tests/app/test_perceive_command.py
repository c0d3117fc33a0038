"""``caris-desktop perceive --serve``: permitted clients, and error messages."""

import argparse
import signal
import subprocess
import sys

import httpx
import pytest

from caris_desktop.app import perceive_command
from caris_desktop.perception.backends.remote_detector import SERVER_VARIABLE, TOKEN_VARIABLE, RemoteDetector
from tests.perception.shared_data import INT8_WEIGHTS, bus_picture, needs_int8_weights

TOKEN = "a token of enough characters"


def perceive(*words: str) -> int:
    parser = argparse.ArgumentParser()
    perceive_command.add_arguments(parser)
    return perceive_command.run(parser.parse_args(["--serve", *words]))


@pytest.mark.parametrize(
    ("token", "words", "said"),
    [
        ("", ("--host", "0.0.0.0"), "put a token of at least 16 characters"),
        (TOKEN, ("--host", "0.0.0.0"), "could intercept the images"),
        (TOKEN, ("--host", "an-address"), "could intercept the images"),
        ("short", (), "is too short"),
        ("", ("--cert", "cert.pem"), "must be given together"),
        ("", ("--cert", "missing.pem", "--key", "missing.pem"), "cannot be used"),
        ("", ("--model", "missing.onnx"), "missing.onnx does not exist"),
        ("", ("--model", "https://example.org/yolo.onnx"), "has no checksum"),
    ],
)
def test_an_unsafe_or_missing_input_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], token: str, words: tuple[str, ...], said: str
) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, token)
    assert perceive(*words) == 1
    assert said in capsys.readouterr().err


@needs_int8_weights
def test_a_console_finds_the_people_of_its_pictures_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
    words = [sys.executable, "-m", "caris_desktop", "perceive", "--serve", "--port", "0", "--model", str(INT8_WEIGHTS)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        assert "yolov8n_int8.tflite, LiteRT on CPU, 320x320 px is available at ws://127.0.0.1:" in first
        address = first.split(" is available at ")[1].split(";")[0]
        health = httpx.get(address.replace("ws://", "http://"), headers={"Authorization": f"Bearer {TOKEN}"})
        assert "yolov8n_int8.tflite" in health.json()["label"]
        monkeypatch.setenv(SERVER_VARIABLE, address)
        detector = RemoteDetector(address, confidence=0.25)
        found = detector.detect(bus_picture())
        assert [detector.class_names[row] for row in found.classes].count("person") >= 3
        detector.close()
        process.send_signal(signal.SIGINT)
        rest, wrong = process.communicate(timeout=60)
    assert process.returncode == 0
    assert " connected" in rest
    assert "Traceback" not in wrong
    assert TOKEN not in first + rest + wrong
