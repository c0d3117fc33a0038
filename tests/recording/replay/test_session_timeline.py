"""State at any time of a session: equal to sequential reading, whatever the state of the recording."""

import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import CommandSent, Marked, ScenarioOpened, UtteranceChanged
from caris_desktop.domain.schema import to_jsonable
from caris_desktop.domain.sensing import FrameRef, LaserScan, OccupancyGrid, StatusShown
from caris_desktop.domain.streams import BY_TYPE, Delivery
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.recorder.event_log import EventLog
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.session import events_file
from caris_desktop.recording.session.session_header import SessionClock
from caris_desktop.recording.session.session_reader import Session, open_session
from tests.support.recorded_session import RecordedSession

Arrived = tuple[int, Any]


@pytest.fixture
def timeline(whole_session: RecordedSession) -> Iterator[SessionTimeline]:
    with SessionTimeline(open_session(whole_session.folder)) as timeline:
        yield timeline


def plain(values: list[Any]) -> list[Any]:
    """Comparable values, including arrays."""
    return [(type(value).__name__, to_jsonable(value)) for value in values]


def state_by_reading(values: tuple[Arrived, ...], at_ns: int) -> list[Any]:
    """The newest value of each topic, by sequential search."""
    newest: dict[str, tuple[int, Any]] = {}
    for number, (arrived_ns, value) in enumerate(values):
        spec = BY_TYPE[type(value)]
        if arrived_ns <= at_ns and spec.delivery is Delivery.LATEST:
            newest[spec.topic_of(value)] = (number, value)
    return [value for _, value in sorted(newest.values(), key=lambda pair: pair[0])]


def moments(made: RecordedSession, count: int) -> list[int]:
    chosen = random.Random(5)  # noqa: S311 - a test, not cryptography
    arrivals = [arrived_ns for arrived_ns, _ in made.values]
    anywhere = [chosen.randrange(made.plan.started_ns, made.plan.ended_ns) for _ in range(count)]
    exactly = [arrived_ns + by for arrived_ns in chosen.sample(arrivals, count) for by in (-1, 0)]
    return [made.plan.started_ns - 1, made.plan.started_ns, made.plan.ended_ns, 2**60, *anywhere, *exactly]


def test_the_state_of_any_moment_is_what_was_newest_then(
    timeline: SessionTimeline, whole_session: RecordedSession
) -> None:
    for at_ns in moments(whole_session, 25):
        assert plain(timeline.state_at(at_ns)) == plain(state_by_reading(whole_session.values, at_ns))
    late = timeline.state_at(whole_session.plan.ended_ns)
    assert sum(isinstance(value, OccupancyGrid) for value in late) == 1, "told once, before everything else"
    assert {value.name for value in late if isinstance(value, StatusShown)} == {"link", "speech", "drive"}


def test_long_lasting_states_are_built_once(timeline: SessionTimeline) -> None:
    grids = [
        next(value for value in timeline.state_at(at_ns) if isinstance(value, OccupancyGrid))
        for at_ns in (timeline.start_ns + 10**9, timeline.end_ns)
    ]
    assert grids[0] is grids[1]


def test_intervals_that_follow_one_another_give_everything_once(
    timeline: SessionTimeline, whole_session: RecordedSession
) -> None:
    bounds = sorted(moments(whole_session, 20))
    read: list[Arrived] = []
    for after_ns, until_ns in zip([-(2**60), *bounds], [*bounds, 2**60], strict=True):
        part = list(timeline.between(after_ns, until_ns))
        assert all(after_ns < arrived_ns <= until_ns for arrived_ns, _ in part)
        read += part
    assert [arrived_ns for arrived_ns, _ in read] == [arrived_ns for arrived_ns, _ in whole_session.values]
    assert plain([value for _, value in read]) == plain([value for _, value in whole_session.values])
    scans = list(timeline.between(-(2**60), 2**60, types=(LaserScan, FrameRef)))
    assert {type(value) for _, value in scans} == {LaserScan, FrameRef}
    assert len(scans) == sum(isinstance(value, (LaserScan, FrameRef)) for _, value in whole_session.values)
    assert list(timeline.between(timeline.end_ns, timeline.start_ns)) == []


def test_events_before_a_moment(timeline: SessionTimeline, whole_session: RecordedSession) -> None:
    for at_ns in moments(whole_session, 6):
        for limit, types in ((1, (ScenarioOpened,)), (7, (Marked, UtteranceChanged)), (40, None), (0, None)):
            expected = [
                (arrived_ns, value)
                for arrived_ns, value in whole_session.values
                if arrived_ns <= at_ns
                and (type(value) in types if types else BY_TYPE[type(value)].delivery is Delivery.LOSSLESS)
            ]
            assert timeline.events_before(at_ns, limit, types) == expected[len(expected) - min(limit, len(expected)) :]


def test_all_events_of_a_kind(timeline: SessionTimeline, whole_session: RecordedSession) -> None:
    for kinds in ((Marked,), (UtteranceChanged, CommandSent)):
        expected = [(arrived_ns, value) for arrived_ns, value in whole_session.values if isinstance(value, kinds)]
        assert timeline.events(*kinds) == expected


def test_without_an_index_everything_is_found_all_the_same(killed_session: RecordedSession) -> None:
    with SessionTimeline(open_session(killed_session.folder, repair=False)) as timeline:
        for at_ns in moments(killed_session, 10):
            assert plain(timeline.state_at(at_ns)) == plain(state_by_reading(killed_session.values, at_ns))
        assert len(timeline.events(Marked)) == sum(isinstance(value, Marked) for _, value in killed_session.values)
        assert timeline.end_ns == killed_session.values[-1][0]


@pytest.mark.logs(r"replay\.session_timeline: ")
def test_a_damaged_block_is_left_out(whole_session: RecordedSession, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    shutil.copytree(whole_session.folder, folder)
    index = events_file.read_index(folder / "events.mcap")
    content = bytearray((folder / "events.mcap").read_bytes())
    at = int(index.offsets[index.count // 3]) + 100
    content[at : at + 64] = bytes(64)
    (folder / "events.mcap").write_bytes(content)
    with SessionTimeline(open_session(folder)) as timeline:
        read = list(timeline.between(-(2**60), 2**60))
        assert 0.8 < len(read) / len(whole_session.values) < 1.0
        for at_ns in moments(whole_session, 10):
            timeline.state_at(at_ns)


def test_times_that_jump_back_do_not_hide_or_repeat_anything(tmp_path: Path) -> None:
    """Recordings of version 1 contain the measurement time of a value instead of its arrival."""
    anchor = ClockAnchor(0, 10**18)
    log = EventLog(DiskFile(tmp_path / "events.mcap"), anchor=anchor, metadata={})
    chosen = random.Random(3)  # noqa: S311 - a test, not cryptography
    for number in range(400):
        stamp_ns = number * 10**7 - chosen.choice((0, 0, 3 * 10**8))
        log.write(BY_TYPE[Marked], Marked(stamp_ns, str(number)), max(0, stamp_ns))
        if number % 10 == 9:
            log.flush()
    log.close()
    session = Session(tmp_path, {}, SessionClock(anchor, 0), 4 * 10**9, True, "wizard")
    with SessionTimeline(session) as timeline:
        read: list[Arrived] = []
        for after_ns in range(-(10**8), 5 * 10**9, 77 * 10**6):
            read += timeline.between(after_ns, after_ns + 77 * 10**6)
        assert [value.label for _, value in read] == [str(number) for number in range(400)]
        assert [arrived_ns for arrived_ns, _ in read] == sorted(arrived_ns for arrived_ns, _ in read)
        before = timeline.events_before(2 * 10**9, 1000)
        assert [value.label for _, value in before] == [str(number) for number in range(len(before))]
