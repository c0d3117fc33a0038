"""Training data: boxes match their images, and turns contain what was known."""

import configparser
import csv
import json
import re
from bisect import bisect_right
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from caris_desktop.domain.events import AnswerUsed, CommandSent, UtteranceChanged
from caris_desktop.domain.geometry import Twist2D
from caris_desktop.domain.sensing import People
from caris_desktop.recording.exporters.frames import write_frames
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import ExportContext, export_session
from tests.support.recorded_session import RecordedSession, make_session, number_in, rerecorded


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> RecordedSession:
    """Session in which people have the stamps of their frames, as real perception gives them."""
    made = make_session(
        tmp_path_factory.mktemp("sessions") / "one", seconds=16.0, cameras=("front",), people_hz=7.5, keep=True,
        utterance_every_s=2.0, llm_every_s=5.0,
    )  # fmt: skip
    stamps_ns = made.plan.frame_stamps_ns("front").tolist()
    values: list[tuple[int, Any]] = []
    for arrived_ns, value in made.values:
        changed = value
        if isinstance(value, People):
            at = bisect_right(stamps_ns, value.stamp_ns) - 1
            changed = replace(value, stamp_ns=stamps_ns[max(at, 0)], frame_sequence=max(at, 0) + 1)
            if 3.0 < (value.stamp_ns - made.plan.started_ns) / 1e9 < 5.0:
                changed = replace(changed, boxes=())
        elif isinstance(value, CommandSent) and 5.0 < (value.stamp_ns - made.plan.started_ns) / 1e9 < 8.0:
            changed = replace(value, twist=Twist2D())
        values.append((arrived_ns, changed))
    used_ns = next(v.stamp_ns for _, v in values if isinstance(v, UtteranceChanged) and v.utterance_id == "u3")
    values.append(
        (
            values[-1][0],
            AnswerUsed(used_ns, "x1", "edited", "This is a robot arm. It can pick up a cup without breaking it."),
        )
    )
    return rerecorded(made, values)


@pytest.fixture(scope="module")
def out(made: RecordedSession, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("frames") / "out"
    written = export_session(made.folder, "frames", out)
    assert {path for path in out.rglob("*") if path.is_file()} == set(written)
    return out


def recorded_people(made: RecordedSession) -> dict[int, People]:
    return {value.frame_sequence - 1: value for _, value in made.values if isinstance(value, People)}


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


@pytest.mark.long
def test_yolo_boxes_lie_on_the_pictures_they_were_found_in(made: RecordedSession, out: Path) -> None:
    folder = out / "yolo"
    described = yaml.safe_load((folder / "data.yaml").read_text())
    assert described == {"train": "images/train", "val": "images/val", "names": {0: "person"}}
    people = recorded_people(made)
    width, height = made.plan.size_px
    seen, empty = 0, 0
    for part in ("train", "val"):
        images = sorted((folder / described[part]).glob("*.jpg"))
        assert images
        for image in images:
            found = people[number_in(cv2.imread(str(image)))]
            labels = (folder / "labels" / part / f"{image.stem}.txt").read_text().splitlines()
            assert len(labels) == len(found.boxes)
            empty += not labels
            for label, box in zip(labels, found.boxes, strict=True):
                kind, x, y, wide, high = (float(number) for number in label.split())
                assert kind == 0
                assert (x * width, y * height) == pytest.approx(
                    (box.left_px + box.width_px / 2, box.top_px + box.height_px / 2), abs=0.01
                )
                assert (wide * width, high * height) == pytest.approx((box.width_px, box.height_px), abs=0.01)
            seen += 1
    assert seen == pytest.approx(2.0 * made.plan.seconds, rel=0.15)
    assert empty
    with (folder / "boxes.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["camera"] for row in rows} == {"front"}
    assert all((folder / row["image"]).is_file() for row in rows)
    assert {row["person_id"] for row in rows} == {box.person_id for found in people.values() for box in found.boxes}


def test_mot_sequences_are_complete_and_say_who_made_them(made: RecordedSession, out: Path) -> None:
    (folder,) = (out / "mot").iterdir()
    assert folder.name == "front-machine-made"
    assert "They have not been corrected" in (folder / "gt" / "MACHINE-MADE.txt").read_text()
    seqinfo = configparser.ConfigParser()
    seqinfo.read(folder / "seqinfo.ini")
    about = seqinfo["Sequence"]
    images = sorted((folder / about["imDir"]).iterdir())
    assert [image.name for image in images] == [f"{n:06d}.jpg" for n in range(1, int(about["seqLength"]) + 1)]
    assert (int(about["imWidth"]), int(about["imHeight"])) == made.plan.size_px
    assert int(about["frameRate"]) == 5
    people = recorded_people(made)
    tracks = np.loadtxt(folder / "gt" / "gt.txt", delimiter=",")
    detections = np.loadtxt(folder / "det" / "det.txt", delimiter=",")
    assert tracks.shape[1] == 9
    assert detections.shape[1] == 10
    assert set(detections[:, 1]) == {-1.0}
    for frame, image in enumerate(images, start=1):
        found = people[number_in(cv2.imread(str(image)))]
        mine = tracks[tracks[:, 0] == frame]
        assert len(mine) == len(found.boxes)
        assert [row[2] for row in mine] == pytest.approx([box.left_px + 1 for box in found.boxes], abs=0.01)
    with (folder / "tracks.csv").open(newline="") as file:
        by_id = {int(row["id"]): row for row in csv.DictReader(file)}
    assert set(by_id) == {int(row[1]) for row in tracks}
    with (folder / "frames.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) == len(images)


def test_turns_hold_what_the_wizard_could_know(made: RecordedSession, out: Path) -> None:
    turns = lines(out / "dialogue" / "turns.jsonl")
    asked = {
        value.utterance_id: value
        for _, value in made.values
        if isinstance(value, UtteranceChanged) and value.speaker == "robot" and value.state == "requested"
    }
    assert [turn["utterance_id"] for turn in turns] == list(asked)
    for turn in turns:
        decided_s = turn["decided_s"]
        assert decided_s == pytest.approx((asked[turn["utterance_id"]].stamp_ns - made.plan.started_ns) / 1e9, abs=1e-3)
        for line in turn["context"]["transcript"]:
            assert line["started_s"] < decided_s
            assert line["ended_s"] is None or line["ended_s"] <= decided_s
        for exchange in turn["context"]["assistant"]:
            assert exchange["answered_s"] <= decided_s
            assert exchange["messages"][0]["role"] == "system"
    third = next(turn for turn in turns if turn["utterance_id"] == "u3")
    assert third["action"]["origin"] == "edited"
    assert [line["speaker"] for line in third["context"]["transcript"]] == ["robot", "participant"]
    transcribed_turn = third["context"]["transcript"][1]
    assert third["response_time_s"] == pytest.approx(
        third["action"]["started_s"] - transcribed_turn["ended_s"], abs=1e-3
    )
    assert third["context"]["people_in_view"] in ({"front": 3}, {"front": 0})


def test_the_card_describes_every_field(out: Path) -> None:
    card = (out / "README.md").read_text()
    turn = lines(out / "dialogue" / "turns.jsonl")[0]
    features = json.loads((out / "lerobot" / "meta" / "info.json").read_text())["features"]
    own = [name for name in features if "images" not in name and "index" not in name and name != "timestamp"]
    for name in (*own, *turn, *turn["context"], *turn["action"]):
        told = name in card or name in ("turn", "utterance_id", "voice")
        assert told or name.endswith(("_s", "utc")), name
    assert "machine-made" in card
    assert "monotonic" in card
    assert re.search(r"accurate to \d\.\d ms \(16 measurements\)", card)
    assert "&" not in card


def test_sessions_without_video_or_driving_are_exported_too(tmp_path: Path) -> None:
    made = make_session(tmp_path / "s", seconds=2.0, cameras=(), odometry_hz=0.0)
    fractions: list[float] = []
    (tmp_path / "out").mkdir()
    written = write_frames(open_session(made.folder), tmp_path / "out", ExportContext(progress=fractions.append))
    assert all(path.is_file() for path in written)
    assert "without a frame in the video" in (tmp_path / "out" / "README.md").read_text()
    assert fractions == sorted(fractions)
    assert fractions[-1] == pytest.approx(0.95)
