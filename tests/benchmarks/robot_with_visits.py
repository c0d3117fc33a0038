"""Simulated robot that also logs who is visible to its camera, as ground truth for a count.

    python -m tests.benchmarks.robot_with_visits FILE [arguments of simulate]

One JSON line per person and interval of visibility: ``person``, ``from_s`` and ``until_s`` of simulated time.
"""

import argparse
import json
import sys
from pathlib import Path

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.simulator import simulate_command
from caris_desktop.simulator.robot_simulation import Robot, sees


class _Watch:
    """Logs each interval at its end, so that a kill loses nothing."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w", encoding="utf-8", buffering=1)
        self._since_s: dict[int, float] = {}

    def look(self, robot: Robot) -> None:
        camera: Pose2D = robot.view().map_from_camera
        for number, person in enumerate(robot.people):
            if sees(camera, person.x_m, person.y_m):
                self._since_s.setdefault(number, robot.now_s)
            elif number in self._since_s:
                self._note(number, robot.now_s)

    def end(self, now_s: float) -> None:
        for number in list(self._since_s):
            self._note(number, now_s)
        self._file.close()

    def _note(self, number: int, now_s: float) -> None:
        line = {"person": number, "from_s": self._since_s.pop(number), "until_s": now_s}
        self._file.write(json.dumps(line) + "\n")


def main() -> int:
    watch = _Watch(Path(sys.argv[1]))
    parser = argparse.ArgumentParser()
    simulate_command.add_arguments(parser)
    arguments = parser.parse_args(sys.argv[2:])
    step = Robot.step
    last_s = [0.0]

    def watched_step(robot: Robot) -> None:
        step(robot)
        watch.look(robot)
        last_s[0] = robot.now_s

    Robot.step = watched_step  # type: ignore[method-assign]
    try:
        return simulate_command.run(arguments)
    finally:
        watch.end(last_s[0])


if __name__ == "__main__":
    sys.exit(main())
