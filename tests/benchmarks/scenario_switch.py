"""Duration of a switch between the shipped scenarios in full operation, and its side effects.

The real console in a real window with the simulated robot, recording. A switch ends when the panels of the next
scenario are placed and painted. Also reported: the longest stall of the GUI thread in each, the delay of the services
(from which the next scenario's permissions apply), interruptions of link or recording, and missing frames in the link's
sequence. CPU time of the GUI thread is given in addition to elapsed time: it is the time on an idle machine. Between
switches it waits until models have processed their prompts and recognisers are loaded; ``--between-s 0.5`` simulates a
wizard who skips through all. Prints one JSON object.
"""

import argparse
import itertools
import json
import time

from caris_desktop.domain import intents
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.shipped import layouts_dir
from tests.benchmarks.console_under_load import ConsoleUnderLoad
from tests.benchmarks.screen_and_statistics import on_a_screen, percentiles
from tests.benchmarks.ui_stalls import LatenessMeter

PATHS = [
    layouts_dir() / f"{name}.yaml" for name in ("mental-health-check", "reception", "tour-guide", "practice", "blank")
]


def measure(rounds: int, between_s: float) -> dict[str, object]:
    load = ConsoleUnderLoad()
    console, window, state = load.console, load.window, load.state
    frames: list[int] = []
    console._bus.tap(lambda frame, _raw: frames.append(frame.sequence), (FrameRef,))
    link, recorder = console.child_pids["control"], console.child_pids["recorder"]
    load.let_qt_run(5.0)  # late imports are completed by then
    meter = LatenessMeter()
    took_ms, computed_ms, slices_ms, followed_ms = [], [], [], []
    of_each_ms: dict[str, list[float]] = {path.stem: [] for path in PATHS}
    apply = console._apply

    def timed(scenario: object) -> None:
        began_s = time.thread_time()
        apply(scenario)  # type: ignore[arg-type]
        followed_ms.append((time.thread_time() - began_s) * 1e3)

    console._scenario._apply = timed
    for number in range(rounds * len(PATHS)):
        path = PATHS[number % len(PATHS)]
        meter.late_ms.clear()
        began_s, began_computing_s = time.perf_counter(), time.thread_time()
        console.do(intents.OpenScenario(path))
        load.wait_for(
            lambda path=path: state.scenario.value.path == path and not window.board.building,
            "the next scenario",
            30.0,
        )
        took_ms.append((time.perf_counter() - began_s) * 1e3)
        of_each_ms[path.stem].append(round(took_ms[-1]))
        computed_ms.append((time.thread_time() - began_computing_s) * 1e3)
        load.let_qt_run(0.3)
        slices_ms.append(max(meter.late_ms))
        load.let_qt_run(between_s)
    report = {
        "benchmark": "scenario_switch",
        "switches": len(took_ms),
        "complete_ms": percentiles(took_ms),
        "complete_ms_of_each": of_each_ms,
        "gui_thread_computed_ms": percentiles(computed_ms),
        "longest_slice_ms": percentiles(slices_ms),
        "services_computed_ms": percentiles(followed_ms),
        "same_link": console.child_pids["control"] == link,
        "same_recorder": console.child_pids["recorder"] == recorder,
        "recording": state.recording.value.state,
        "frames": len(frames),
        "frames_missing": sum(after - before - 1 for before, after in itertools.pairwise(frames)),
    }
    load.close()
    return report


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--between-s", type=float, default=8.0, help="from one switch to the next (default: 8)")
    arguments = parser.parse_args()
    on_a_screen()
    print(json.dumps(measure(arguments.rounds, arguments.between_s)))
