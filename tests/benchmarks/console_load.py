"""CPU use of the console: by process, idle and recording, and by panel.

Processes are measured with the layout of the scenario. A panel is measured in the GUI thread, in a window with only
that panel, while the console records; for comparison, in the same run, a bare widget of the video view's size that only
draws each frame, in a window with the cheapest panel. All values are percent of one core. Prints one JSON object.
"""

import argparse
import json
import os
import time
from dataclasses import replace
from typing import get_args

import psutil
from PySide6.QtCore import Qt
from PySide6.QtGui import QImage, QPainter, QPaintEvent
from PySide6.QtWidgets import QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.events import TrialDetails
from caris_desktop.scenario.scenario_model import BuiltInPanel, PanelLeaf, PanelName
from caris_desktop.ui.widgets.frame_view import FrameView
from tests.benchmarks.console_under_load import ConsoleUnderLoad
from tests.benchmarks.screen_and_statistics import on_a_screen

_SETTLED_S = 4.0


class BareVideo(QWidget):
    """Draws each frame of the displayed camera, and nothing else."""

    def __init__(self, load: ConsoleUnderLoad) -> None:
        super().__init__()
        self._load = load
        self.pictures = 0
        self.setAttribute(Qt.WidgetAttribute.WA_OpaquePaintEvent)
        load.state.frame.changed.connect(self.update)

    def paintEvent(self, event: QPaintEvent) -> None:
        frame = self._load.state.frame.value
        image_bgr = None if frame is None else self._load.console.frames.read(frame)
        if image_bgr is None:
            return
        height, width = image_bgr.shape[:2]
        painter = QPainter(self)
        painter.drawImage(self.rect(), QImage(image_bgr.data, width, height, 3 * width, QImage.Format.Format_BGR888))
        painter.end()
        self.pictures += 1


def processes(load: ConsoleUnderLoad) -> dict[str, int]:
    """Process ids by purpose."""
    found = {"console": os.getpid(), **load.console.child_pids}
    robot = load.run.demo_robot
    if robot is not None and robot.process.pid is not None:
        found["simulated robot"] = robot.process.pid
    return found


def percent_by_process(load: ConsoleUnderLoad, seconds: float) -> dict[str, float]:
    """Percent of one core by process, including its child processes."""
    pids = processes(load)
    before, began_s, thread_s = _cpu_by_process_s(pids), time.monotonic(), time.thread_time()
    load.let_qt_run(seconds)
    elapsed_s, after = time.monotonic() - began_s, _cpu_by_process_s(pids)
    shares = {name: round(100 * (after[name] - before[name]) / elapsed_s, 1) for name in pids}
    shares["console's GUI thread"] = round(100 * (time.thread_time() - thread_s) / elapsed_s, 1)
    return shares


def _cpu_by_process_s(pids: dict[str, int]) -> dict[str, float]:
    return {name: _cpu_s(psutil.Process(pid), set(pids.values())) for name, pid in pids.items()}


def _cpu_s(process: psutil.Process, counted_apart: set[int]) -> float:
    try:
        times, children = process.cpu_times(), process.children()
    except psutil.Error:
        return 0.0
    own_s = float(times.user + times.system)
    return own_s + sum(_cpu_s(child, counted_apart) for child in children if child.pid not in counted_apart)


def gui_percent(load: ConsoleUnderLoad, seconds: float) -> float:
    """Percent of one core used by the GUI thread."""
    began_s, thread_s = time.monotonic(), time.thread_time()
    load.let_qt_run(seconds)
    return round(100 * (time.thread_time() - thread_s) / (time.monotonic() - began_s), 2)


def _frame_view(load: ConsoleUnderLoad) -> FrameView:
    view = load.window.findChild(FrameView)
    if view is None:
        raise SystemExit("the scenario shows no video")
    return view


def measure(seconds: float) -> dict[str, object]:
    load = ConsoleUnderLoad(record=False)
    load.let_qt_run(_SETTLED_S)
    idle = percent_by_process(load, 2 * seconds)
    load.console.do(intents.StartRecording(TrialDetails(participant="benchmark"), anyway=True))
    load.wait_for(lambda: load.state.recording.value.state == "recording", "recording", 60.0)
    load.let_qt_run(_SETTLED_S)
    recording = percent_by_process(load, 2 * seconds)
    view_size = _frame_view(load).size()
    alone: dict[PanelName, float] = {}
    for name in get_args(BuiltInPanel):
        load.window.show_scenario(replace(load.console.scenario, layout=PanelLeaf(name)))
        load.let_qt_run(_SETTLED_S)
        alone[name] = gui_percent(load, seconds)
    cheapest: PanelName = min(alone, key=lambda name: alone[name])
    load.window.show_scenario(replace(load.console.scenario, layout=PanelLeaf(cheapest)))
    load.let_qt_run(_SETTLED_S)
    bare = BareVideo(load)
    bare.resize(view_size)
    bare.show()
    load.let_qt_run(1.0)
    pictures = bare.pictures
    with_bare = gui_percent(load, seconds)
    pictures = bare.pictures - pictures
    bare.close()
    without = gui_percent(load, seconds)
    load.window.show_scenario(replace(load.console.scenario, layout=PanelLeaf("video")))
    load.let_qt_run(_SETTLED_S)
    _frame_view(load).setFixedSize(view_size)
    video = gui_percent(load, seconds)
    load.close()
    return {
        "benchmark": "console_load",
        "cpu_count": os.cpu_count(),
        "percent_of_a_core_idle": idle,
        "percent_of_a_core_recording": recording,
        "gui_thread_percent_with_this_panel_alone": alone,
        "of_the_same_size": {
            "size_px": [view_size.width(), view_size.height()],
            "video_panel": round(video - without, 2),
            "bare_draw_image": round(with_bare - without, 2),
            "pictures_per_s": round(pictures / seconds, 1),
        },
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=8.0, help="for each panel; twice that for the processes")
    arguments = parser.parse_args()
    on_a_screen()
    print(json.dumps(measure(arguments.seconds)))
