"""Number of people counted by the console on an overloaded machine, compared with the true number of visits.

The real console records and detects people while foreign programs use every core and, optionally, the robot turns; the
simulated robot logs who is visible to its camera. A true visit is an interval of visibility of at least a second;
intervals less than ``presence.LEAVE_AFTER_S`` apart are one. Prints one JSON object.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from caris_desktop.app.demo_robot import DemoRobot
from caris_desktop.domain.events import PersonAppeared
from caris_desktop.live.console import Console
from caris_desktop.people.presence import LEAVE_AFTER_S
from tests.benchmarks.burners import Burners
from tests.benchmarks.console_under_load import ConsoleUnderLoad
from tests.benchmarks.screen_and_statistics import on_a_screen

_SEEN_AT_LEAST_S = 1.0


class _RobotWithVisits(DemoRobot):
    def __init__(self, console: Console, log: Path) -> None:
        command = ("-m", "tests.benchmarks.robot_with_visits", str(log), "--port", "0", "--end-with-stdin")
        super().__init__(console, seed=7, python_arguments=command)


def true_visits(stretches: list[dict[str, float]]) -> int:
    """Number of visits in the intervals of visibility."""
    visits = 0
    for person in {each["person"] for each in stretches}:
        spans = sorted((each["from_s"], each["until_s"]) for each in stretches if each["person"] == person)
        joined: list[list[float]] = []
        for begin_s, end_s in spans:
            if joined and begin_s - joined[-1][1] < LEAVE_AFTER_S:
                joined[-1][1] = end_s
            else:
                joined.append([begin_s, end_s])
        visits += sum(end_s - begin_s >= _SEEN_AT_LEAST_S for begin_s, end_s in joined)
    return visits


def measure(seconds: float, *, burners: int, language_model: bool, turning: bool) -> dict[str, object]:
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "in_sight.jsonl"
        load = ConsoleUnderLoad(language_model=language_model, robot=lambda console: _RobotWithVisits(console, log))
        foreign = Burners(burners)
        pad = load.focus_driving()
        appeared: set[str] = {row.person_id for row in load.state.persons.value if row.here}
        load.state.event_happened.connect(
            lambda event: appeared.add(event.person_id) if isinstance(event, PersonAppeared) else None
        )
        looks = load.state.people.arrivals
        before = log.read_text().count("\n")
        until_s = time.monotonic() + seconds
        turn = 0
        while time.monotonic() < until_s:
            if turning:
                key = (Qt.Key.Key_A, Qt.Key.Key_D)[turn % 2]
                turn += 1
                QTest.keyPress(pad, key)
                load.let_qt_run(1.0)
                QTest.keyRelease(pad, key)
            load.let_qt_run(4.0)
        counted, looks = len(appeared), load.state.people.arrivals - looks
        report = load.load()
        foreign.end()
        load.close()
        # People visible at the start are counted, as the console counts them too.
        stretches = [json.loads(line) for line in log.read_text().splitlines()[before:]]
    visits = true_visits(stretches)
    return {
        "benchmark": "people_counted",
        "seconds": seconds,
        "burners": burners,
        "turning": turning,
        "people_walking": len({each["person"] for each in stretches}),
        "true_visits": visits,
        "counted": counted,
        "counted_per_visit": round(counted / max(1, visits), 2),
        "looks_per_s": round(looks / seconds, 1),
        "load": report,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--burners", type=int, default=4)
    parser.add_argument("--language-model", action="store_true", help="it answers one question after the other as well")
    parser.add_argument("--turning", action="store_true", help="the robot turns a little to and fro")
    arguments = parser.parse_args()
    on_a_screen()
    print(
        json.dumps(
            measure(
                arguments.seconds,
                burners=arguments.burners,
                language_model=arguments.language_model,
                turning=arguments.turning,
            )
        )
    )
