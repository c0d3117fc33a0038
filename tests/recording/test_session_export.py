"""Exports: content of the tables, a description of each column, and no overwritten file."""

import csv
import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from caris_desktop.domain import clock
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import (
    ChatMessage,
    LinkQuality,
    LlmExchange,
    PhotoTaken,
    PlacesChanged,
    UtteranceChanged,
)
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import (
    AudioBlock,
    BatteryState,
    OccupancyGrid,
    People,
    PersonBox,
    PlannedPath,
    RobotPose,
)
from caris_desktop.domain.streams import BY_TYPE, STREAMS
from caris_desktop.recording.session.robot_clock_mapping import RobotClock
from caris_desktop.recording.session.session_header import SessionClock
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import ExportError, ExportRequest, export_all, export_session
from caris_desktop.recording.tables.catalog import Moment, RowTimes, tables_of
from tests.recording.driving import command, mark, pose, scan
from tests.recording.session.test_session_reader import record, write_raw
from tests.recording.told_session import at, exchange, tell


@pytest.fixture
def session(tmp_path: Path) -> Path:
    now_ns = clock.now_ns()
    boxes = tuple(PersonBox(track, f"p-{track}", 1.5, 2, 3, 4, 0.5) for track in (7, 9))
    record(
        tmp_path / "s",
        [
            replace(scan(4), ranges_m=np.array([1.25, np.inf, 0.1, 3], dtype=np.float32)),
            pose(1.5),
            command(1),
            mark('a "quoted", label\nin two lines'),
            People(now_ns, "front", 3, 640, 480, boxes, 12.0),
            People(now_ns, "front", 4, 640, 480, (), 12.0),
            BatteryState(now_ns, None),
            PlannedPath(now_ns, None, np.array([[1.0, 2.5], [3.0, -4.0]], np.float32)),
            OccupancyGrid(now_ns, None, 0.05, Pose2D(0, 0, 0), np.zeros((3, 5), dtype=np.int8)),
            LlmExchange(
                stamp_ns=now_ns,
                exchange_id="x",
                provider="embedded",
                model="m",
                messages=(ChatMessage("system", "Be brief."), ChatMessage("user", "Hi")),
                answer="Hello.",
                outcome="answered",
                asked_ns=now_ns - 2_000_000_000,
                first_token_ns=None,
                parameters={"temperature": 0.4, "model": "m"},
            ),
        ],
    )
    return tmp_path / "s"


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_each_stream_becomes_a_tidy_table(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    written = export_session(session, "csv", out)
    assert sorted(written) == sorted(out.iterdir())
    (row,) = table(out / "scan.csv")
    assert (row["ranges_m"], row["ranges_m_min"], row["ranges_m_shape"]) == ("1.25;inf;0.1;3.0", "0.1", "4")
    assert row["robot_from_laser_x_m"] == "0.1"
    (row,) = table(out / "pose.csv")
    assert (row["pose_in_map_x_m"], row["robot_stamp_ns"]) == ("1.5", "")
    opened = open_session(session)
    _, value = next(opened.values("pose"))
    assert float(row["session_s"]) == pytest.approx(opened.clock.session_s(value.stamp_ns), abs=1e-6)
    assert row["utc"] == opened.clock.utc(value.stamp_ns)
    assert row["stamp_ns"] == str(value.stamp_ns)
    (row,) = table(out / "event_command_sent.csv")
    assert (row["twist_forward_mps"], row["source"]) == ("0.3", "keyboard")
    (row,) = table(out / "event_marked.csv")
    assert row["label"] == 'a "quoted", label\nin two lines'
    assert [row["boxes_count"] for row in table(out / "people.csv")] == ["2", "0"]
    assert [(row["number"], row["track"], row["left_px"]) for row in table(out / "people_boxes.csv")] == [
        ("1", "7", "1.5"),
        ("2", "9", "1.5"),
    ]
    (row,) = table(out / "battery.csv")
    assert row["charge_fraction"] == ""
    (row,) = table(out / "map.csv")
    assert (row["cells_shape"], row["cells"]) == ("3x5", "")
    (row,) = table(out / "path.csv")
    assert (row["points_in_map"], row["points_in_map_shape"]) == ("1.0 2.5;3.0 -4.0", "2x2")
    (row,) = table(out / "event_llm_exchange.csv")
    assert (row["parameters"], row["first_token_session_s"]) == ('{"model": "m", "temperature": 0.4}', "")
    assert float(row["session_s"]) - float(row["asked_session_s"]) == pytest.approx(2.0, abs=1e-5)
    assert [row["content"] for row in table(out / "event_llm_exchange_messages.csv")] == ["Be brief.", "Hi"]
    about = {row["key"]: row["value"] for row in table(out / "session.csv")}
    assert (about["trial.participant"], about["reason"], about["closed_properly"]) == ("P07", "wizard", "true")


def test_tables_of_several_sessions_can_be_put_under_one_another(session: Path, tmp_path: Path) -> None:
    other = tmp_path / "another session"
    shutil.copytree(session, other)
    head = json.loads((other / "session.json").read_text())
    head["trial"] |= {"participant": 'P"08"', "condition": "B", "trial": "2"}
    (other / "session.json").write_text(json.dumps(head))
    rows: dict[str, list[dict[str, str]]] = {}
    for folder in (session, other):
        written = export_session(folder, "csv", tmp_path / f"csv-{folder.name}")
        for path in written:
            rows.setdefault(path.name, []).extend(table(path))
            assert path.read_text(encoding="utf-8").startswith("session,participant,condition,trial,")
    for name, mixed in rows.items():
        whose = {(row["session"], row["participant"], row["condition"], row["trial"]) for row in mixed}
        assert {one[:2] for one in whose} == {(session.name, "P07"), (other.name, 'P"08"')}, name
        assert (other.name, 'P"08"', "B", "2") in whose
        assert len(whose) == 2
    # The session column relates rows of several tables.
    poses = {row["session"]: row["pose_in_map_x_m"] for row in rows["pose.csv"]}
    assert {row["session"] for row in rows["scan.csv"]} == set(poses)


def test_every_column_of_every_table_is_described(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    export_session(session, "csv", out)
    described = table(out / "data_dictionary.csv")
    columns = {(row["table"], row["column"]) for row in described}
    for path in out.iterdir():
        with path.open(encoding="utf-8", newline="") as file:
            head = next(csv.reader(file))
        assert {(path.stem, name) for name in ["", *head]} <= columns
        assert len(set(head)) == len(head)
    assert {name for name, _ in columns} == {path.stem for path in out.iterdir()}, "kinds that occur, and no others"
    assert all(row["description"] for row in described)
    told = {(row["table"], row["column"]): (row["unit"], row["clock"]) for row in described}
    assert told["event_command_sent", "twist_turn_radps"] == ("rad/s", "")
    assert told["pose", "pose_in_map_x_m"] == ("m", "")
    assert told["pose", "robot_stamp_ns"] == ("ns", "robot")
    assert told["pose", "measured_session_s"] == ("s", "session")
    assert told["pose", "utc"] == ("", "UTC")


def test_no_stream_has_two_columns_of_one_name_or_one_without_a_description() -> None:
    tables = [table for spec in STREAMS for table in tables_of(spec)]
    assert len({table.name for table in tables}) == len(tables)
    for table_ in tables:
        names = [column.name for column in table_.columns]
        assert len(set(names)) == len(names), table_.name
        assert all(column.description for column in table_.columns)
    units = {(table_.name, column.name): column.unit for table_ in tables for column in table_.columns}
    assert units["event_traffic_measured_topics", "bytes_per_s"] == "bytes/s"


def test_a_broken_off_session_is_exported_as_far_as_it_goes(session: Path, tmp_path: Path) -> None:
    path = session / "events.mcap"
    path.write_bytes(path.read_bytes()[:-4000])
    export_session(session, "csv", tmp_path / "out")
    assert table(tmp_path / "out" / "scan.csv")


@pytest.mark.logs(r"session\.session_reader: ")
def test_values_with_impossible_stamps_are_left_out(tmp_path: Path) -> None:
    from mcap.writer import Writer  # a damaged file

    record(tmp_path / "s", [])
    stamps_ns = [10**30, -(10**30), open_session(tmp_path / "s").started_ns]
    with (tmp_path / "s" / "events.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/event/marked", "json", writer.register_schema("x", "jsonschema", b"{}"))
        for stamp_ns in stamps_ns:
            data = json.dumps({"stamp_ns": stamp_ns, "label": "x", "start_ns": stamp_ns}).encode()
            writer.add_message(channel, 0, data, 0)
        writer.finish()
    export_session(tmp_path / "s", "csv", tmp_path / "out")
    (row,) = table(tmp_path / "out" / "event_marked.csv")
    assert row["session_s"] == "0.0"
    assert sum(bool(mark["utc"]) for mark in table(tmp_path / "out" / "marks.csv")) == 1
    export_session(tmp_path / "s", "parquet", tmp_path / "parquet")


def test_the_header_is_reported_with_its_media(session: Path, tmp_path: Path) -> None:
    path = session / "session.json"
    header = json.loads(path.read_text())
    header["videos"] = [{"file_name": "video-front.mp4", "frames": 7}, {"file_name": "video-up.mp4"}]
    header["audio"] = [{"file_name": "audio-microphone.wav", "sample_rate_hz": 16000}]
    path.write_text(json.dumps(header))
    export_session(session, "csv", tmp_path / "out")
    about = {row["key"]: row["value"] for row in table(tmp_path / "out" / "session.csv")}
    assert (about["videos.1.frames"], about["videos.2.file_name"]) == ("7", "video-up.mp4")
    assert about["audio.1.sample_rate_hz"] == "16000"
    assert about["robot_clock.estimates"] == "0"


def test_nothing_is_overwritten(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    export_session(session, "csv", out)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    with pytest.raises(ExportError, match="is not empty"):
        export_session(session, "csv", out)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    with pytest.raises(ExportError, match=r"Unknown format 'xls'\. Allowed: csv"):
        export_session(session, "xls", tmp_path / "other")
    (tmp_path / "file").write_text("")
    with pytest.raises(ExportError, match="Its partial files were deleted"):
        export_session(session, "csv", tmp_path / "file" / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "out", "s"]


def rows(value: Any) -> list[dict[str, Any]]:
    """Rows of a value in the table of its stream, without the time columns."""
    table_ = tables_of(BY_TYPE[type(value)])[0]
    times = RowTimes(SessionClock(ClockAnchor(0, 0), 0), RobotClock(()))
    names = [column.name for column in table_.columns]
    cells = table_.cells([(Moment(value.stamp_ns), item) for item in table_.items(value)], times)
    return [dict(zip(names, row, strict=True)) for row in zip(*cells, strict=True)]


def test_missing_values_are_empty() -> None:
    (row,) = rows(PlacesChanged(1, "Kitchen", Pose2D(1.0, 2.0, 3.0)))
    assert list(row.values())[4:] == ["Kitchen", 1.0, 2.0, 3.0, ""]
    (row,) = rows(PlacesChanged(1, "Kitchen", None))
    assert list(row.values())[4:] == ["Kitchen", None, None, None, ""]


@pytest.mark.logs(r"session\.session_reader: ", r"tables\.build: ", r"exporters\.html: ")
def test_tampered_values_cost_themselves_and_no_export(tmp_path: Path) -> None:
    bent: Any = exchange(1, 1.0, 2.0, "never read")
    values = [
        replace(bent, parameters="x"),
        replace(bent, messages="a text"),
        replace(mark("stamped by nobody"), stamp_ns=2**70),
        replace(mark("at the end of time"), stamp_ns=2**63 - 1),
        PhotoTaken(at(1), "front", 1, "photos/\ud800\0.jpg"),
        PhotoTaken(at(1), "front", 2, "x" * 5000),
        AudioBlock(at(1), "microphone", "x" * 5000 + ".wav", 0, 1, 16000),
        UtteranceChanged(at(2), "u", "participant", "half a \ud800 character", "heard", "finished"),
        LinkQuality(at(1), -1e308, 1e308, 1e308),
        pose(math.inf),
        RobotPose(at(1), None, Pose2D(0.0, 0.0, math.inf)),
        replace(mark("kept"), stamp_ns=at(3)),
    ]
    folder = tell(tmp_path / "s", [], lasts_s=9)
    write_raw(folder / "events.mcap", values)
    formats = ("csv", "html", "eaf", "textgrid", "vtt", "rosbag2", "frames", "methods")
    done = export_all(ExportRequest((folder,), formats, tmp_path / "out", folder_per_session=False))
    assert all("were skipped" in problem for problem in done.problems), done.problems
    labels = [row["label"] for row in table(tmp_path / "out" / "csv" / "event_marked.csv")]
    assert labels == ["kept"]
    assert not (tmp_path / "out" / "csv" / "event_llm_exchange.csv").exists()
