"""Parquet exports, read with pyarrow and DuckDB."""

import json
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from caris_desktop.domain import json_encoding
from caris_desktop.recording.session_export import ExportContext, ExportRequest, export_all, export_session
from caris_desktop.recording.table_files import delete_tables
from caris_desktop.recording.tables import build
from tests.recording.minute import S, everything, make_session


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sessions of a study as Parquet, one folder each."""
    folder = tmp_path_factory.mktemp("parquet")
    sessions = [folder / "study" / "sessions" / name for name in ("one", "two")]
    for number, session in enumerate(sessions):
        make_session(session, everything, trial={"participant": f"P{number}", "condition": "AB"[number], "trial": "1"})
    request = ExportRequest(tuple(sessions), ("parquet",), folder / "out", licence="CC-BY-4.0")
    assert export_all(request).problems == ()
    return folder / "out"


def rows(path: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = pq.read_table(path).to_pylist()
    return found


def test_columns_are_typed_and_say_their_units(out: Path) -> None:
    schema = pq.read_schema(out / "one" / "scan.parquet")
    assert {name: schema.field(name).type for name in ("session_s", "utc", "stamp_ns", "frame_id", "ranges_m")} == {
        "session_s": pa.float64(),
        "utc": pa.timestamp("us", tz="UTC"),
        "stamp_ns": pa.int64(),
        "frame_id": pa.string(),
        "ranges_m": pa.list_(pa.float32()),
    }
    assert schema.field("ranges_m").metadata[b"unit"] == b"m"
    assert schema.field("robot_stamp_ns").metadata[b"clock"] == b"robot"
    assert schema.metadata[b"session"] == b"one"
    assert schema.metadata[b"licence"] == b"CC-BY-4.0"
    assert b"planar scan" in schema.metadata[b"description"]
    assert pq.read_schema(out / "one" / "utterances.parquet").field("said").type == pa.bool_()
    for path in (out / "one").iterdir():
        for field in pq.read_schema(path):
            assert field.metadata[b"description"], f"{path.name}: {field.name}"


def test_values_are_those_that_were_recorded(out: Path) -> None:
    scans = rows(out / "one" / "scan.parquet")
    assert len(scans) == 60
    ranges_m = np.linspace(0.5, 8.0, 90, dtype=np.float32)
    ranges_m[::10] = np.inf
    assert np.array_equal(np.array(scans[0]["ranges_m"], np.float32), ranges_m)
    (status, robot) = rows(out / "one" / "status.parquet")
    assert json.loads(status["content"]) == {"rates": [1, 2.5], "state": "connected"}
    assert (robot["name"], robot["content"]) == ("robot", None)
    (grid,) = rows(out / "one" / "map.parquet")
    assert (grid["cells"], grid["cells_shape"]) == (list(range(-1, 14)), [3, 5])
    (depth,) = rows(out / "one" / "depth.parquet")
    assert (depth["camera"], depth["depths_mm"], depth["depths_mm_shape"]) == ("mast", [0, 700, 6553, 65535], [2, 2])
    (path,) = rows(out / "one" / "path.parquet")
    assert path["points_in_map"] == [[1.0, 2.5], [3.0, -4.0]]
    assert [row["boxes_count"] for row in rows(out / "one" / "people.parquet")] == [2, 0]
    (thing,) = rows(out / "one" / "people_things.parquet")
    assert (thing["label"], thing["top_px"], thing["number"]) == ("chair", 20.5, 1)
    assert [(row["number"], row["person_id"]) for row in rows(out / "one" / "people_boxes.parquet")] == [
        (1, "p-7"),
        (2, "p-9"),
    ]
    odometry = rows(out / "one" / "odometry.parquet")
    assert len(odometry) == 600
    first = odometry[0]
    assert (first["utc"].timestamp() * 1e6) % 1e6 == pytest.approx((odometry[10]["utc"].timestamp() * 1e6) % 1e6, abs=2)
    assert first["stamp_ns"] + 10 * S // 10 == odometry[10]["stamp_ns"]


def test_measurements_of_the_robot_are_on_the_session_clock(out: Path) -> None:
    for row in rows(out / "one" / "odometry.parquet"):
        measured_s, expected_s = row["measured_session_s"], row["pose_in_odom_x_m"] * 10
        assert abs(measured_s - expected_s) < 0.001, "the 30 ms on the way are taken out"
        assert row["session_s"] - expected_s == pytest.approx(0.03, abs=1e-6)
        assert abs(measured_s - expected_s) <= row["measured_uncertainty_s"] < 0.01
    (grid,) = rows(out / "one" / "map.parquet")
    assert (grid["measured_session_s"], grid["measured_uncertainty_s"]) == (None, None)


def test_utterances_and_marks_are_rows_of_their_own(out: Path) -> None:
    first, never, transcribed = rows(out / "one" / "utterances.parquet")
    assert (first["session_s"], first["duration_s"], first["start_session_s"], first["said"]) == (5.0, 2.5, 5.0, True)
    assert (never["said"], never["start_ns"], never["state"], never["session_s"]) == (False, None, "interrupted", 9.0)
    assert transcribed["text"] == "Ünïcode \U0001f916 \ufffd & <b>", "half a character has no place in UTF-8"
    marks = rows(out / "one" / "marks.parquet")
    assert [(mark["label"], mark["session_s"], mark["duration_s"], mark["open_at_end"]) for mark in marks] == [
        ("laughs", 17.0, None, False),
        ("talks", 30.0, 30.0, True),
    ]
    facts = {row["key"]: row["value"] for row in rows(out / "one" / "session.parquet")}
    assert float(facts["robot_clock.uncertainty_ms"]) == pytest.approx(1.5, abs=0.2)
    assert facts["trial.participant"] == "P0"


def test_one_query_reads_a_whole_study(out: Path) -> None:
    answer = duckdb.sql(
        f"""
        SELECT condition, participant, count(*) FILTER (said), sum(duration_s),
               abs(date_diff('minute', min(utc), now())) < 60
        FROM '{out}/*/utterances.parquet' GROUP BY ALL ORDER BY condition
        """  # noqa: S608 - the path is of this test
    ).fetchall()
    assert answer == [("A", "P0", 2, 3.5, True), ("B", "P1", 2, 3.5, True)]
    ((nearest_m,),) = duckdb.sql(f"SELECT min(list_min(ranges_m)) FROM '{out}/*/scan.parquet'").fetchall()  # noqa: S608
    assert nearest_m == pytest.approx(0.584, abs=1e-3), "the first beam of each ten returned nothing"
    described = duckdb.sql(
        f"SELECT unit FROM '{out}/one/data_dictionary.parquet' WHERE \"table\" = 'scan' AND \"column\" = 'ranges_m'"  # noqa: S608
    ).fetchall()
    assert described == [("m",)]


def test_row_groups_are_written_as_they_fill(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_session(tmp_path / "s", everything)
    export_session(tmp_path / "s", "parquet", tmp_path / "at once")
    monkeypatch.setattr(build, "_BATCH_ROWS", 50)
    monkeypatch.setattr(build, "_BYTES_AT_ONCE", 5_000)
    delete_tables([tmp_path / "s"])
    fractions: list[float] = []
    export_session(tmp_path / "s", "parquet", tmp_path / "out", ExportContext(progress=fractions.append))
    assert pq.ParquetFile(tmp_path / "out" / "odometry.parquet").metadata.num_row_groups >= 12
    assert pq.ParquetFile(tmp_path / "out" / "scan.parquet").metadata.num_row_groups >= 2, "by their size"
    assert len(rows(tmp_path / "out" / "odometry.parquet")) == 600
    for path in (tmp_path / "at once").iterdir():
        assert pq.read_table(path).equals(pq.read_table(tmp_path / "out" / path.name)), "the robot's clock is the same"
    assert fractions
    assert all(0.0 <= fraction <= 1.0 for fraction in fractions)


@pytest.mark.logs(r"session\.session_reader: ")
def test_values_that_fit_no_column_are_left_out_and_the_rest_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from caris_desktop.domain.events import CommandSent
    from caris_desktop.domain.geometry import Twist2D

    # As older versions wrote them, without a check for readability.
    monkeypatch.setattr(json_encoding, "_require_readable", lambda *_: None)
    odd: Any = "seven"
    make_session(
        tmp_path / "s",
        lambda begin_ns: [
            CommandSent(begin_ns, number, Twist2D(0.1, 0.0, 0.0), "keyboard") for number in (1, odd, 10**30, 2)
        ],
    )
    export_session(tmp_path / "s", "parquet", tmp_path / "out")
    assert [row["sequence"] for row in rows(tmp_path / "out" / "event_command_sent.parquet")] == [1, 2]
