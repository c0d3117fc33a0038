"""Memory use of perception with people who come and go: worker and inference process, over minutes of video.

Ten simulated people enter and leave in front of a camera of 30 Hz in real time, with the console's thread and child
process. Resident memory is read once a second; growth is the median of the last tenth minus that of the tenth after the
warm-up, in which everybody has been detected once. Prints one JSON object.
"""

import argparse
import json
import statistics
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import psutil
from PySide6.QtCore import QCoreApplication, QThread

from caris_desktop.app import composition, process_entry_points
from caris_desktop.domain import clock
from caris_desktop.domain.events import PersonAppeared
from caris_desktop.domain.sensing import People
from caris_desktop.live.child_process import ProcessSpec, RingsToRead
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.live.services.people_service import PerceptionWorker
from caris_desktop.perception.inference_messages import InferenceSettings
from caris_desktop.simulator.simulated_people import Visit
from tests.support.walkers import film

RATE_HZ = 30.0
_PEOPLE, _COME_EVERY_S, _WARM_UP = 10, 4.0, 0.25
_MB = 1e6


def visits(seconds: float) -> list[Visit]:
    """Consecutive visits, with three people present at a time."""
    return [
        Visit(person=number % _PEOPLE, comes_s=number * _COME_EVERY_S, stays_s=4.0)
        for number in range(max(1, round(seconds / _COME_EVERY_S) - 2))
    ]


class _Memory:
    """Memory of this process and its child, once a second."""

    def __init__(self) -> None:
        self.console: list[float] = []
        self.inference: list[float] = []

    def look(self, child_pid: int) -> None:
        self.console.append(psutil.Process().memory_info().rss / _MB)
        self.inference.append(psutil.Process(child_pid).memory_info().rss / _MB)


def grown(megabytes: list[float]) -> float:
    """Growth from the tenth after the warm-up to the last one."""
    begin, tenth = round(len(megabytes) * _WARM_UP), max(1, len(megabytes) // 10)
    return statistics.median(megabytes[-tenth:]) - statistics.median(megabytes[begin : begin + tenth])


def measure(seconds: float, *, model: Path | None) -> dict[str, Any]:
    application = QCoreApplication.instance() or QCoreApplication([])
    ring = FrameRing.create()
    values: list[Any] = []
    counts = {"looks": 0, "boxes": 0}
    ready = threading.Event()

    def publish(value: Any) -> None:
        if isinstance(value, People):
            counts["looks"] += 1
            counts["boxes"] += len(value.boxes)
        elif isinstance(value, PersonAppeared):
            values.append(value)

    with tempfile.TemporaryDirectory() as folder:
        parts = composition.parts(study=composition.open_study(Path(folder) / "study"), cameras=())
        settings = InferenceSettings(weights_path=model)
        worker = PerceptionWorker(parts.people.open_presence, publish)
        worker.use_body(ProcessSpec("inference", process_entry_points.inference, (RingsToRead((ring.name,)), settings)))
        worker.status_changed.connect(lambda status: ready.set() if status.state == "ready" else None)
        thread = QThread()
        worker.moveToThread(thread)
        thread.started.connect(worker.run)
        thread.start()
        try:
            if not ready.wait(60.0):
                raise SystemExit("the detector did not become ready")
            memory = _Memory()
            began_s = time.monotonic()
            for number, frame in enumerate(film(visits(seconds), rate_hz=RATE_HZ)):
                due_s = number / RATE_HZ
                if due_s > seconds:
                    break
                time.sleep(max(0.0, began_s + due_s - time.monotonic()))
                worker.offer(ring.write(frame.image_bgr, stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera="front"))
                if number % round(RATE_HZ) == 0 and worker.child is not None and worker.child.pid is not None:
                    memory.look(worker.child.pid)
                    application.processEvents()
        finally:
            worker.stop()
            thread.wait(10_000)
            ring.close()
    return {
        "seconds": seconds,
        "visits": len(visits(seconds)),
        "people_appeared": len(values),
        **counts,
        "console_mb": [round(memory.console[0], 1), round(memory.console[-1], 1)],
        "inference_mb": [round(memory.inference[0], 1), round(memory.inference[-1], 1)],
        "console_grew_mb": round(grown(memory.console), 1),
        "inference_grew_mb": round(grown(memory.inference), 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--model", type=Path, help="detector (default: the same as the console)")
    arguments = parser.parse_args()
    print(json.dumps(measure(arguments.seconds, model=arguments.model)))


if __name__ == "__main__":
    main()
