"""Sessions of earlier versions: opening, replay and export are unchanged.

``tests/recording/formats/format-N`` was written by the recorder of that version, ``format-N.exported.json`` by the
exporters of the last program that wrote version 2; descriptions that were reworded later have the present wording.
"""

import csv
import io
import json
import re
import shutil
from pathlib import Path

import pytest

from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import SessionStarted, UtteranceChanged
from caris_desktop.domain.schema import to_jsonable
from caris_desktop.domain.sensing import LaserScan, OccupancyGrid, People, RobotPose
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.recorder.event_log import EventLog
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session import events_file
from caris_desktop.recording.session.session_header import FORMAT_VERSION, SessionError
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import export_session
from tests.support.recorded_session import number_in

NOON_NS = 1_790_000_000_000_000_000
FORMATS = Path(__file__).parents[1] / "formats"
_WHEN_EXPORTED = re.compile(r' DATE="[^"]*"')
_FIELD = re.compile(r'(?P<field>"(?:[^"]|"")*"|[^,\r\n]*)(?P<end>,|\r\n|\n|\r|\Z)')
_ENTRY = re.compile(r" *<CV_ENTRY_ML .*?</CV_ENTRY_ML>\n", re.DOTALL)


@pytest.fixture(params=[1, 2])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A copy, as opening may repair a session."""
    return Path(shutil.copytree(FORMATS / f"format-{request.param}", tmp_path / f"format-{request.param}"))


GONE = {"taken_uncertainty_session_s"}
"""An uncertainty as a point in time."""


def exported(folder: Path, out: Path) -> dict[str, str]:
    """Exported texts of a session, by file name."""
    written = [path for kind in ("csv", "eaf") for path in export_session(folder, kind, out / kind)]
    return {path.name: path.read_bytes().decode() for path in written if path.suffix in (".csv", ".eaf")}


def as_it_was(name: str, now: str, then: str) -> str:
    """``now`` without columns and vocabulary entries that were added later, and without the export time."""
    if name.endswith(".eaf"):
        now = _ENTRY.sub(lambda entry: entry[0] if entry[0] in then else "", now)
        return _WHEN_EXPORTED.sub(_WHEN_EXPORTED.findall(then)[0], now)
    rows, kept = raw_rows(now), raw_rows(then)[0][0]
    return _with_columns(rows, kept)


def _with_columns(rows: list[tuple[list[str], str]], columns: list[str]) -> str:
    at = [rows[0][0].index(column) for column in columns]
    return "".join(",".join(row[each] for each in at) + end for row, end in rows)


def without_gone(name: str, then: str) -> str:
    """``then`` without the columns that are no longer exported."""
    rows = raw_rows(then) if name.endswith(".csv") else []
    columns = [column for column in rows[0][0] if column not in GONE] if rows else []
    return _with_columns(rows, columns) if GONE & set(rows[0][0] if rows else ()) else then


def raw_rows(text: str) -> list[tuple[list[str], str]]:
    """Rows of a CSV file with quotation marks and line ends."""
    rows: list[tuple[list[str], str]] = []
    row: list[str] = []
    for found in _FIELD.finditer(text):
        row.append(found["field"])
        if found["end"] != ",":
            rows.append((row, found["end"]))
            row = []
    return rows if rows[-1] != ([""], "") else rows[:-1]  # nothing after the last line end


def assert_exports_as_before(folder: Path, out: Path) -> None:
    then = json.loads((FORMATS / f"{folder.name}.exported.json").read_text(encoding="utf-8"))
    now = exported(folder, out)
    assert set(then) <= set(now)
    assert len(then) > 40
    for name, text in then.items():
        before = without_gone(name, text)
        assert as_it_was(name, now[name], before) == before, name


def test_only_later_columns_are_left_out_of_the_comparison() -> None:
    then = 'name,said\r\nAda,"Well, yes ""so"""\r\n,\r\n'
    later = 'name,actor,said\r\nAda,,"Well, yes ""so"""\r\n,wizard,\r\n'
    assert as_it_was("turns.csv", later, then) == then == as_it_was("turns.csv", then, then)
    for other in (later.replace("Ada", '"Ada"'), later.replace("\r\n", "\n"), later[:-2]):
        assert as_it_was("turns.csv", other, then) != then


def test_it_exports_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    assert_exports_as_before(folder, tmp_path / "out")


def test_it_opens_and_replays(folder: Path) -> None:
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    session = open_session(folder)
    assert (session.closed_properly, session.notices, session.losses) == (True, (), ())
    with SessionTimeline(session) as timeline, VideoReader(session) as videos:
        state = {type(value): value for value in timeline.state_at(timeline.start_ns + 5_000_000_000)}
        assert state[OccupancyGrid].cells.shape == (10, 16)
        assert state[OccupancyGrid].cells[0].tolist() == [100] * 16
        assert len(state[LaserScan].ranges_m) == 24
        assert state[RobotPose].pose_in_map.x_m == pytest.approx(11.5, abs=1.0)
        assert [box.person_id for box in state[People].boxes] == ["p-3", "p-2"]
        assert [event.text for _, event in timeline.events(UtteranceChanged) if event.state == "finished"]
        picture = videos.frame("front", 10)
        assert picture is not None
        assert number_in(picture.image_bgr) == 10
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before


def test_an_old_record_names_nobody_who_requested_its_contents(folder: Path, tmp_path: Path) -> None:
    """The actor was added in version 3."""
    asked = [value for _, value in open_session(folder).values() if hasattr(value, "actor")]
    assert len({type(value) for value in asked}) > 10
    assert {value.actor for value in asked} == {""}
    tables = {
        name: list(csv.DictReader(io.StringIO(text))) for name, text in exported(folder, tmp_path / "out").items()
    }
    actors = [row["actor"] for rows in tables.values() for row in rows if "actor" in row]
    assert len(actors) > len(asked)
    assert set(actors) == {""}


def test_recorded_again_it_is_the_same_in_this_version(folder: Path, tmp_path: Path) -> None:
    """Every value and export is unchanged after recording with the present version."""
    session = open_session(folder)
    recorded = list(session.arrivals())
    again = tmp_path / "again" / folder.name
    shutil.copytree(folder, again)
    (again / "events.mcap").unlink()
    log = EventLog(DiskFile(again / "events.mcap"), anchor=session.clock.anchor, metadata={})
    for arrived_ns, _, value in recorded:
        log.write(BY_TYPE[type(value)], value, arrived_ns)
    log.close()
    header = json.loads((again / "session.json").read_text())
    (again / "session.json").write_text(json.dumps(header | {"format_version": FORMAT_VERSION, "files": []}))
    assert FORMAT_VERSION == 3
    channels = events_file.read_index(again / "events.mcap").channels.values()
    assert [b"foxglove.LaserScan" in channel.schema for channel in channels if channel.topic == "/scan"] == [True]
    same = open_session(again, repair=False).arrivals()
    assert [(at_ns, to_jsonable(value)) for at_ns, _, value in same] == [
        (at_ns, to_jsonable(value)) for at_ns, _, value in recorded
    ]
    then, now = exported(folder, tmp_path / "then"), exported(again, tmp_path / "now")
    # session.csv describes the files themselves.
    for name in set(then) - {"session.csv"}:
        assert as_it_was(name, now[name], then[name]) == then[name], name


@pytest.mark.logs(r"session_header|recovery|header_rebuilding")
def test_a_record_reports_its_version_where_its_head_is_lost(folder: Path, tmp_path: Path) -> None:
    (folder / "session.json").unlink()
    assert open_session(folder).header.to_json()["format_version"] == 2
    for version, told in (("3", 3), ("4", None), ("none", 2)):
        lost = tmp_path / version
        lost.mkdir()
        log = EventLog(
            DiskFile(lost / "events.mcap"), anchor=ClockAnchor(0, NOON_NS), metadata={"format_version": version}
        )
        log.write(BY_TYPE[SessionStarted], SessionStarted(5, "s"), 5)
        log.close()
        if told is None:
            with pytest.raises(SessionError, match="version 4; this program reads up to version 3"):
                open_session(lost)
        else:
            assert open_session(lost).header.to_json()["format_version"] == told


def test_a_newer_version_is_refused_and_reported(folder: Path) -> None:
    path = folder / "session.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"format_version": FORMAT_VERSION + 1}))
    with pytest.raises(SessionError, match=r"version 4; this program reads up to version 3. Update CARIS Desktop"):
        open_session(folder)
