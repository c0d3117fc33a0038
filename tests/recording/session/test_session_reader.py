"""Reading of complete and interrupted sessions, and of other folders."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from caris_desktop.domain.events import Marked, SessionEnded
from caris_desktop.domain.schema import to_jsonable
from caris_desktop.domain.sensing import LaserScan
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.live.frame_ring import FrameRings
from caris_desktop.recording.recorder.disk_watch import DiskLimits
from caris_desktop.recording.recorder.session_recorder import SessionRecorder
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session.manifest import MANIFEST_NAME
from caris_desktop.recording.session.session_header import RecordedRobot, SessionError, SessionHeader
from caris_desktop.recording.session.session_reader import open_session, value_reader
from tests.recording.driving import command, header, mark, pose, scan, start
from tests.recording.told_session import at, exchange, tell
from tests.support.recorded_session import RecordedSession

LIMITS = DiskLimits(reserve_bytes=4096)


def record(folder: Path, values: list[Any], *, head: SessionHeader | None = None) -> list[Any]:
    """Record a whole session in this process; returns the recorder's messages."""
    said: list[Any] = []
    begin = start(folder)
    if head is not None:
        begin = type(begin)(folder, head)
    recorder = SessionRecorder(begin, frames=FrameRings(()), report=said.append, limits=LIMITS)
    for value in values:
        recorder.write(value)
        recorder._log.flush()
    recorder.close("wizard")
    recorder.finish()
    return said


def test_values_come_back_as_they_were(tmp_path: Path) -> None:
    values = [scan(90), pose(1.0), command(1), mark("Ünïcode \U0001f916 \ud800 lone"), pose(2.0)]
    record(tmp_path / "s", values)
    session = open_session(tmp_path / "s")
    read = [value for _, value in session.values()][1:-1]
    assert [type(value) for value in read] == [type(value) for value in values]
    assert read[1:] == values[1:]
    assert np.array_equal(read[0].ranges_m, values[0].ranges_m)
    assert [value.pose_in_map.x_m for _, value in session.values("pose")] == [1.0, 2.0]
    assert [spec.name for spec, _ in session.values("pose", "scan")] == ["scan", "pose", "pose"]
    assert session.closed_properly
    assert session.reason == "wizard"
    assert session.trial["participant"] == "P07"
    with pytest.raises(KeyError):
        session.values("no such stream")


def test_a_session_is_read_up_to_where_it_breaks_off(tmp_path: Path) -> None:
    record(tmp_path / "s", [value for number in range(30) for value in (mark(str(number)), scan(60))])
    whole = (tmp_path / "s" / "events.mcap").read_bytes()
    head = json.loads((tmp_path / "s" / "session.json").read_text())
    (tmp_path / "s" / "session.json").write_text(json.dumps({**head, "ended_ns": None, "reason": None}))
    # The session contains its end even if only the indexes were written.
    session = open_session(tmp_path / "s", repair=False)
    assert (session.closed_properly, session.reason) == (True, "wizard")

    previous = 0
    rng = np.random.default_rng(7)
    for cut in sorted(rng.integers(0, len(whole), 30)):
        (tmp_path / "s" / "events.mcap").write_bytes(whole[:cut])
        session = open_session(tmp_path / "s", repair=False)
        labels = [value.label for _, value in session.values("event/marked")]
        assert labels == [str(number) for number in range(len(labels))]
        assert len(labels) >= previous
        previous = len(labels)
        ended = any(isinstance(value, SessionEnded) for _, value in session.values())
        assert session.closed_properly is ended
        assert session.duration_s >= 0
    assert previous == 30


@pytest.mark.logs(r"session\.events_file: ", r"session\.session_reader: ")
def test_damage_inside_costs_what_comes_after_it_and_nothing_else(tmp_path: Path) -> None:
    record(tmp_path / "s", [mark(str(number)) for number in range(50)])
    path = tmp_path / "s" / "events.mcap"
    whole = path.read_bytes()
    rng = np.random.default_rng(3)
    for _ in range(30):
        damaged = bytearray(whole)
        at = int(rng.integers(8, len(whole) - 40))
        damaged[at : at + 32] = rng.bytes(32)
        path.write_bytes(damaged)
        labels = [value.label for _, value in open_session(tmp_path / "s", repair=False).values("event/marked")]
        assert [label for label in labels if label.isdigit()] == sorted(
            (label for label in labels if label.isdigit()), key=int
        )


@pytest.mark.logs(r"session\.session_header: ")
@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("session.json", "[]", "is not the header of a CARIS Desktop session"),
        ("session.json", '{"format": "caris-desktop session", "format_version": 99}', "Update CARIS Desktop"),
        ("session.json", '{"format": "caris-desktop session", "format_version": 1}', "does not contain the start time"),
        ("events.mcap", None, "does not contain events.mcap"),
    ],
)
def test_a_folder_that_is_no_session_is_reported(tmp_path: Path, name: str, content: str | None, expected: str) -> None:
    record(tmp_path / "s", [])
    if content is None:
        (tmp_path / "s" / name).unlink()
    else:
        (tmp_path / "s" / name).write_text(content)
    with pytest.raises(SessionError, match=expected):
        open_session(tmp_path / "s")


def test_a_folder_that_is_not_there_is_reported(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match="is not a folder"):
        open_session(tmp_path / "none")


@pytest.mark.logs(r"session\.session_reader: ")
def test_values_of_a_neighbouring_version_are_read_as_far_as_they_fit(tmp_path: Path) -> None:
    record(tmp_path / "s", [scan(10)])
    read = next(value for _, value in open_session(tmp_path / "s").values("scan"))
    assert isinstance(read, LaserScan)
    shutil.rmtree(tmp_path / "s")
    record(tmp_path / "s", [mark("x")])
    path = tmp_path / "s" / "events.mcap"
    from mcap.writer import Writer  # a writer of another version

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("x", "jsonschema", b"{}")
        for topic, data in (
            ("/not/known", b"{}"),
            ("/event/marked", b'{"stamp_ns": 5, "label": "kept", "colour": "red"}'),
            ("/event/marked", b'{"stamp_ns": 6}'),
            ("/event/marked", b'{"stamp_ns": 7, "label": "x", "kind": "new kind"}'),
            ("/event/marked", b"not json"),
        ):
            channel = writer.register_channel(topic, "json", schema)
            writer.add_message(channel, 0, data, 0)
        writer.finish()
    assert [value.label for _, value in open_session(tmp_path / "s").values()] == ["kept"]


@pytest.mark.logs(r"values of event/marked are left out")
def test_a_message_is_one_json_value_with_or_without_spaces_around_it() -> None:
    read, spec = value_reader(Path("events.mcap")), BY_TYPE[Marked]
    data = json.dumps(to_jsonable(mark("here"))).encode()
    whole = read(f"/{spec.name}", data)
    assert whole is not None
    assert whole[1].note == mark("here").note
    assert read(f"/{spec.name}", b"\r\n\t " + data + b" \n") == whole
    assert read(f"/{spec.name}", data + b"{}") is None


def test_no_credentials_reach_the_session(tmp_path: Path) -> None:
    record(
        tmp_path / "s", [], head=header(robot=RecordedRobot(address="ws://user:secret@robot.local:9090/x?token=abc"))
    )
    written = json.loads((tmp_path / "s" / "session.json").read_text())
    assert written["robot"]["address"] == "ws://robot.local:9090/x"


@pytest.mark.logs(r"session\.session_header: ")
@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"clock": {"monotonic_ns": 10**400, "utc_ns": 0}}, "does not contain the start time"),
        ({"clock": {"monotonic_ns": 0, "utc_ns": 2**80}}, "does not contain the start time"),
        ({"started_ns": "soon"}, "does not contain the start time"),
        ({"clock": "noon"}, "does not contain the start time"),
        ({"format_version": "2"}, "Update CARIS Desktop"),
        ({"format": "another program"}, "is not the header of a CARIS Desktop session"),
        ({"padding": "x" * 17_000_000}, "far too large"),
    ],
)
def test_a_header_that_makes_no_sense_is_reported(tmp_path: Path, changes: dict[str, Any], expected: str) -> None:
    record(tmp_path / "s", [])
    path = tmp_path / "s" / "session.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))
    before = path.read_bytes()
    with pytest.raises(SessionError, match=expected):
        open_session(tmp_path / "s")
    assert path.read_bytes() == before


@pytest.mark.logs(r"session\.session_header: ")
@pytest.mark.parametrize("content", ["{", '{"format": ' + "[" * 200_000])
def test_a_head_that_cannot_be_read_without_events_to_make_it_from_is_reported(tmp_path: Path, content: str) -> None:
    record(tmp_path / "s", [])
    (tmp_path / "s" / "session.json").write_text(content)
    (tmp_path / "s" / "events.mcap").unlink()
    with pytest.raises(SessionError, match="is damaged, and there is no events") as told:
        open_session(tmp_path / "s")
    assert "line 1" not in str(told.value)


@pytest.mark.logs(r"session\.session_header: ")
def test_deep_nesting_is_reported_too(tmp_path: Path) -> None:
    record(tmp_path / "s", [])
    (tmp_path / "s" / "session.json").write_text('{"format": ' + "[" * 200_000)
    assert "session.json was damaged" in open_session(tmp_path / "s").losses[0]


def test_any_missing_file_is_reported_or_the_rest_opens(whole_session: RecordedSession, tmp_path: Path) -> None:
    names = [path.relative_to(whole_session.folder) for path in whole_session.folder.rglob("*") if path.is_file()]
    assert len(names) > 10
    for name in names:
        folder = tmp_path / "without" / name.name
        shutil.copytree(whole_session.folder, folder)
        (folder / name).unlink()
        if name.name == "events.mcap":
            with pytest.raises(SessionError, match=r"does not contain events\.mcap"):
                open_session(folder)
            continue
        session = open_session(folder)
        assert name.name == MANIFEST_NAME or any(name.as_posix() in loss for loss in session.losses)
        with SessionTimeline(session) as timeline, VideoReader(session) as videos:
            assert timeline.state_at(timeline.end_ns)
            shown = {camera: videos.frame(camera, 5) for camera in ("front", "rear")}
            assert videos.problems == ([f"{name.name} is missing."] if name.suffix == ".mp4" else [])
            assert sum(picture is not None for picture in shown.values()) == (1 if name.suffix == ".mp4" else 2)


@pytest.mark.logs(r"session\.session_reader: ")
def test_values_of_another_shape_are_left_out_and_reported_once_a_stream(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    bent: Any = exchange(1, 1.0, 2.0, "a")
    values = [
        *(replace(bent, stamp_ns=at(number), parameters="x") for number in (1, 2, 3)),
        replace(bent, stamp_ns=at(4), messages="a text"),
        replace(Marked(at(5), "huge"), stamp_ns=2**70 + at(5)),
        Marked(at(6), "kept"),
    ]
    folder = tmp_path / "s"
    tell(folder, [Marked(at(6), "kept")], lasts_s=9)
    (folder / "events.mcap").unlink()
    write_raw(folder / "events.mcap", values)
    session = open_session(folder)
    assert [value.label for _, value in session.values("event/marked", "event/llm_exchange")] == ["kept"]
    told = [record.getMessage() for record in caplog.records if "are left out" in record.getMessage()]
    assert len(told) == 2
    assert "event/llm_exchange" in told[0]


def write_raw(path: Path, values: list[Any]) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="caris-desktop")
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels: dict[str, int] = {}
        for value in values:
            topic = f"/{BY_TYPE[type(value)].name}"
            channel = channels.setdefault(topic, 0) or writer.register_channel(topic, "json", schema)
            channels[topic] = channel
            writer.add_message(
                channel, log_time=at(1), publish_time=at(1), data=json.dumps(to_jsonable(value)).encode()
            )
        writer.finish()
