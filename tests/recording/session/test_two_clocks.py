"""Robot with a clock two seconds ahead and drifting: a session through the real link compared with the robot's log."""

import csv
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from caris_desktop.domain.events import LinkQuality
from caris_desktop.recording.recorder.recorder_messages import RecorderReport
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import export_session
from tests.recording.driving import RecorderUnderTest, start
from tests.robot.link_bench import LinkProcess
from tests.support.polling import wait_for
from tests.support.simulated_robot import SimulatedRobot

AHEAD_NS = 2_000_000_000
DRIFT = 50e-3 / 60.0
ALIGNED_S = 0.020
TOPIC_OF = {"odometry": "/odom", "scan": "/scan"}


@dataclass(frozen=True, slots=True)
class Recorded:
    """A session, the log of the robot, and the UTC time at which the clock error starts."""

    folder: Path
    sent: list[dict[str, int]]
    wrong_from_ns: float

    def truth_ns(self, robot_stamp_ns: int) -> float:
        """True time of a robot stamp, in UTC of this computer."""
        return self.wrong_from_ns + (robot_stamp_ns - AHEAD_NS - self.wrong_from_ns) / (1.0 + DRIFT)


def record(folder: Path, *, seconds: float) -> Recorded:
    log = folder / "sent.jsonl"
    with SimulatedRobot("--log", str(log), "--empty") as robot:
        robot.fault(f"clock_offset:{AHEAD_NS / 1e9}")
        before_ns = time.time_ns()
        robot.fault(f"clock_drift:{DRIFT * 1e6}")
        wrong_from_ns = (before_ns + time.time_ns()) / 2
        link, recorder = LinkProcess(robot.address), RecorderUnderTest()
        try:
            wait_for(lambda: any(q.clock_offset_ms is not None for q in link.of(LinkQuality)), "an estimate")
            recorder.send(start(folder / "session"))
            recorder.wait_for(RecorderReport, state="recording")
            passed_on, until_s = len(link.values), time.monotonic() + seconds
            while time.monotonic() < until_s:
                fresh = link.values[passed_on:]
                recorder.send(*fresh)
                passed_on += len(fresh)
                recorder.drain()
                time.sleep(0.02)
            recorder.stop_session()
        finally:
            recorder.close()
            link.close()
    sent = [json.loads(line) for line in log.read_text().splitlines()]
    return Recorded(folder / "session", sent, wrong_from_ns)


def rows(path: Path) -> Iterator[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        yield from csv.DictReader(file)


@pytest.mark.parametrize("seconds", [10.0, pytest.param(300.0, marks=[pytest.mark.long, pytest.mark.timeout(400)])])
@pytest.mark.long("10.0")
def test_two_clocks_that_disagree_are_aligned_and_the_uncertainty_is_stated(tmp_path: Path, seconds: float) -> None:
    recorded = record(tmp_path, seconds=seconds)
    session = open_session(recorded.folder)
    started_ns = session.clock.anchor.utc_ns_at(session.started_ns)
    export_session(recorded.folder, "csv", tmp_path / "csv")
    for name, topic in TOPIC_OF.items():
        sent_at_ns = {line["stamp_ns"]: line["at_ns"] for line in recorded.sent if line["topic"] == topic}
        exported = list(rows(tmp_path / "csv" / f"{name}.csv"))
        assert len(exported) > 5 * seconds
        off_s, stated_s = [], []
        for row in exported:
            stamp_ns, measured_s = int(row["robot_stamp_ns"]), float(row["measured_session_s"])
            uncertainty_s = float(row["measured_uncertainty_s"])
            stated_s.append(uncertainty_s)
            off_s.append(measured_s - (recorded.truth_ns(stamp_ns) - started_ns) / 1e9)
            # By the robot's log, written after sending, and by the recorded arrival.
            sent_s = (sent_at_ns[stamp_ns] - started_ns) / 1e9
            assert measured_s - uncertainty_s <= min(sent_s, float(row["session_s"]))
        print(f"{name}: {len(off_s)} rows, off by {max(map(abs, off_s)) * 1e3:.2f} ms at most")
        print(f"{name}: stated {max(stated_s) * 1e3:.2f} ms at most")
        assert max(map(abs, off_s)) < ALIGNED_S
        assert all(abs(off) <= stated + 0.001 for off, stated in zip(off_s, stated_s, strict=True))
        assert max(stated_s) < ALIGNED_S
    told = {row["key"]: row["value"] for row in rows(tmp_path / "csv" / "session.csv")}
    assert abs(float(told["robot_clock.utc_offset_s"]) - 2.0) < 0.1 + DRIFT * 60
    assert abs(float(told["robot_clock.drift_ms_per_min"]) - 50.0) < 60.0 / (seconds / 10.0)
    assert 0.0 < float(told["robot_clock.uncertainty_ms"]) < ALIGNED_S * 1e3
    export_session(recorded.folder, "parquet", tmp_path / "parquet")
    table = pq.read_table(tmp_path / "parquet" / "scan.parquet").to_pylist()
    assert [row["measured_session_s"] for row in table] == [
        float(row["measured_session_s"]) for row in rows(tmp_path / "csv" / "scan.csv")
    ]
    assert isinstance(table[0]["utc"], datetime)
