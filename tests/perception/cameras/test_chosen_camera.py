"""Parsing of a camera specification."""

import pytest

from caris_desktop.perception.cameras.camera_source import (
    CameraError,
    ChosenCamera,
    camera_token,
    parse_camera,
    with_distinct_names,
)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("robot", ChosenCamera("robot", "", "robot")),
        ("robot:front", ChosenCamera("robot", "front", "front")),
        ("simulated", ChosenCamera("simulated", "", "simulated")),
        ("0", ChosenCamera("device", "0", "camera-0")),
        ("/dev/video2", ChosenCamera("device", "/dev/video2", "camera-2")),
        ("oak", ChosenCamera("oak", "", "oak")),
        ("oak:14442C10D13EABCE00", ChosenCamera("oak", "14442C10D13EABCE00", "oak")),
        ("videos/walk 1.mp4", ChosenCamera("file", "videos/walk 1.mp4", "walk-1")),
        ("walk.mp4?loop", ChosenCamera("file", "walk.mp4", "walk", loop=True)),
        ("walk.mp4?fast&loop", ChosenCamera("file", "walk.mp4", "walk", loop=True, fast=True)),
        ("what?.mp4", ChosenCamera("file", "what?.mp4", "what-.mp4".removesuffix(".mp4").strip("-"))),
        (
            "rtsp://user:secret@10.0.0.7:554/main",
            ChosenCamera("stream", "rtsp://user:secret@10.0.0.7:554/main", "10.0.0.7"),
        ),
        ("https://hall.example/v.mjpg", ChosenCamera("http", "https://hall.example/v.mjpg", "hall.example")),
        ("whep+http://pi:8090/whep", ChosenCamera("whep", "http://pi:8090/whep", "pi")),
        (
            "webrtc+https://pi/offer#token-env=MY_CAMERA_1",
            ChosenCamera("webrtc", "https://pi/offer", "pi", token_env="MY_CAMERA_1"),
        ),
        (
            "http://pi:8090/video.mjpg#token-env=PI_CAMERA",
            ChosenCamera("http", "http://pi:8090/video.mjpg", "pi", token_env="PI_CAMERA"),
        ),
    ],
)
def test_sources_are_understood(text: str, expected: ChosenCamera) -> None:
    assert parse_camera(text) == expected


@pytest.mark.parametrize(
    "text", ["", "ftp://host/file.mp4", "rtsp://", "http://[::1", "gopher://camera", "http://pi/v#token-env=AWS_SECRET"]
)
def test_other_sources_are_refused_in_words(text: str) -> None:
    with pytest.raises(CameraError) as caught:
        parse_camera(text)
    assert caught.value.advice


def test_a_name_can_be_given_and_stands_once() -> None:
    assert parse_camera("0", name="desk / left").name == "desk-left"
    cameras = with_distinct_names([parse_camera("oak"), parse_camera("oak:1"), parse_camera("oak:2")])
    assert [camera.name for camera in cameras] == ["oak", "oak-2", "oak-3"]


def test_a_token_is_read_from_the_environment_and_its_absence_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = parse_camera("http://pi/v#token-env=PI_CAMERA")
    monkeypatch.setenv("PI_CAMERA", " secret\n")
    assert camera_token(chosen) == "secret"
    monkeypatch.delenv("PI_CAMERA")
    with pytest.raises(CameraError, match="PI_CAMERA"):
        camera_token(chosen)
