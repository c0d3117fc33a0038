"""``caris-desktop perceive-again``: derived data next to an unchanged recording."""

import argparse
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from numpy.typing import NDArray

from caris_desktop.app import perceive_again_command
from caris_desktop.domain.sensing import People
from caris_desktop.perception.backends.runtime_selection import Chosen
from caris_desktop.perception.detector import Detections
from caris_desktop.perception.perceiver import Perceiver
from caris_desktop.perception.tracker import PersonTracker
from caris_desktop.recording.session.manifest import verify_manifest
from caris_desktop.recording.session.session_reader import value_reader
from tests.perception.served import Bright
from tests.perception.shared_data import INT8_WEIGHTS, bus_picture, needs_int8_weights
from tests.support import recorded_session
from tests.support.recorded_session import make_session

SIZE_PX = (320, 240)


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Study with a session whose camera shows a street with people for a second, and none in between."""
    import cv2

    photo = np.asarray(cv2.resize(bus_picture()[350:950], SIZE_PX, interpolation=cv2.INTER_AREA), np.uint8)
    nobody = np.full_like(photo, 114)

    def picture_of(_camera: int, number: int, _size_px: tuple[int, int]) -> NDArray[np.uint8]:
        return nobody if number == 5 else photo

    study = tmp_path_factory.mktemp("study")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorded_session, "picture_of", picture_of)
        make_session(study / "sessions" / "one", seconds=1.0, fps=10.0, cameras=("front",), size_px=SIZE_PX)
    return study


def perceive_again(capsys: pytest.CaptureFixture[str], recording: Path, *words: str) -> tuple[int, str, str]:
    parser = argparse.ArgumentParser()
    perceive_again_command.add_arguments(parser)
    status = perceive_again_command.run(parser.parse_args([str(recording), *words]))
    printed = capsys.readouterr()
    return status, printed.out, printed.err


def people_in(layer: Path) -> list[People]:
    read = value_reader(layer)
    with (layer / "people.mcap").open("rb") as stream:
        found: list[Any] = [
            read(channel.topic, message.data) for _, channel, message in make_reader(stream).iter_messages()
        ]
    return [value for each in found if each is not None for value in each[1:] if isinstance(value, People)]


def contents(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file() and "derived" not in path.relative_to(folder).parts
    }


@needs_int8_weights
def test_a_layer_is_made_next_to_the_recording_and_never_twice(
    street: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = street / "sessions" / "one"
    before = contents(session)
    status, printed, told = perceive_again(capsys, street, "--model", str(INT8_WEIGHTS), "--name", "better")
    assert status == 0, told
    layer = session / "derived" / "better"
    about = json.loads((layer / "layer.json").read_text(encoding="utf-8"))
    assert json.loads(printed) == about
    people = people_in(layer)
    assert about["cameras"]["front"]["pictures"] == len(people) > 6
    assert [each.frame_sequence for each in people] == list(range(len(people)))
    assert [each.boxes == () for each in people] == [number == 5 for number in range(len(people))]
    assert len({box.track for each in people for box in each.boxes}) == about["cameras"]["front"]["people"] >= 2
    assert all(box.person_id == "" for each in people for box in each.boxes)
    assert contents(session) == before
    assert verify_manifest(session) == []

    made_ns = (layer / "people.mcap").stat().st_mtime_ns
    status, printed, told = perceive_again(capsys, session, "--model", str(INT8_WEIGHTS), "--name", "better")
    assert (status, json.loads(printed), told) == (0, about, "")
    assert (layer / "people.mcap").stat().st_mtime_ns == made_ns
    status, printed, told = perceive_again(
        capsys, session, "--model", str(INT8_WEIGHTS), "--name", "better", "--tracker", "bytetrack"
    )
    assert (status, printed) == (1, "")
    assert "a layer better with other settings already exists" in told
    assert people_in(layer) == people


def test_poses_are_in_the_layer_where_the_model_knows_them(
    street: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class OrNobody(Bright):
        def detect(self, image_bgr: NDArray[np.uint8]) -> Detections:
            if image_bgr.max() > 128:
                return super().detect(image_bgr)
            return Detections(np.zeros((0, 4)), np.zeros(0), np.zeros(0, np.int64), np.zeros((0, 17, 3)))

    def open_bright(*_words: object, **_more: object) -> Perceiver:
        return Perceiver(Chosen(OrNobody(), (1,), None), PersonTracker((1,), tracker="own"), "")

    monkeypatch.setattr(perceive_again_command, "open_perceiver", open_bright)
    status, _, told = perceive_again(capsys, street, "--name", "poses")
    assert status == 0, told
    *_, last = people_in(street / "sessions" / "one" / "derived" / "poses")
    # Constant for more than half a second; keypoints are the same in each frame.
    assert [(box.hand_raised, box.facing) for box in last.boxes] == [(False, False)]


@needs_int8_weights
def test_looking_back_fills_what_was_missed(street: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, printed, told = perceive_again(capsys, street, "--model", str(INT8_WEIGHTS), "--offline-quality")
    assert status == 0, told
    name = json.loads(printed)["layer"]
    assert name == "yolov8n_int8-own-offline"
    people = people_in(street / "sessions" / "one" / "derived" / name)
    filled = people[5].boxes
    assert {box.track for box in filled} == {box.track for box in people[4].boxes}
    assert all(box.confidence == 0.0 for box in filled)


def test_a_wrong_command_is_reported_and_leaves_nothing(
    street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "is not a session or a study" in perceive_again(capsys, tmp_path)[2]
    status, _, told = perceive_again(capsys, street, "--model", str(tmp_path / "none.onnx"))
    assert status == 1
    assert "none.onnx does not exist" in told
    status, _, told = perceive_again(capsys, street, "--name", "../other")
    assert status == 2
    assert "--name" in told
    for name in ("tables", "transcripts"):
        status, _, told = perceive_again(capsys, street, "--name", name)
        assert status == 2 and name in told, "the erasure of a person deletes this folder"
    assert not any(path.name.endswith(".unfinished") for path in street.rglob("*"))
