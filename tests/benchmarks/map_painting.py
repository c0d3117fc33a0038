"""Time to show a LIDAR scan on a map of 4000x4000 cells, in overview, following the robot, and turning with it.

Each step delivers a pose and a scan to the map panel and paints its view; ten of them are due a second. Times are those
of the processor in the GUI thread, which other programs disturb less. Prints one JSON object, with the memory that the
map takes.
"""

import json
import sys
import time

import numpy as np
import psutil
from PySide6.QtCore import QSize
from PySide6.QtWidgets import QApplication, QWidget

from caris_desktop.domain import clock
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import OccupancyGrid, RobotPose
from caris_desktop.ui.main_window import MainWindow
from tests.benchmarks.screen_and_statistics import percentiles
from tests.ui import samples
from tests.ui.fake_console import FakeConsole

CELLS = 4000
STEPS = 100
SIZES = ((500, 260), (1400, 900))


def grid() -> OccupancyGrid:
    cells = np.full((CELLS, CELLS), -1, np.int8)
    cells[500:3500, 500:3500] = 0
    for every in (slice(500, 3500, 100), slice(501, 3500, 100)):
        cells[every, 500:3500] = 100
        cells[500:3500, every] = 100
    return OccupancyGrid(clock.now_ns(), None, 0.05, Pose2D(-100.0, -100.0, 0.0), cells)


def measure() -> dict[str, object]:
    application = QApplication(sys.argv[:1])
    console = FakeConsole(samples.TOUR)
    window = MainWindow(console)
    window.resize(1920, 1080)
    window.show()
    samples.fill_console(console)
    console.state.goal.set(None)
    window.open_panel("map")
    view = window.panels["map"].view  # type: ignore[attr-defined]
    process = psutil.Process()
    before_bytes = process.memory_info().rss
    large = grid()
    console.state.add(large)
    while view.grid.displayed_grid is not large:
        application.processEvents()
    results: dict[str, object] = {}
    for width, height in SIZES:
        view.setFixedSize(QSize(width, height))
        application.processEvents()
        for way in ("overview", "following", "turning"):
            view.set_follow(False)
            view.set_rotate(way == "turning")
            view.fit()
            view.set_follow(way != "overview")
            times_ms = []
            for step in range(STEPS):
                pose = Pose2D(3.0 + 0.03 * step, 3.4, 0.02 * step)
                scan = samples.scan_at(pose)
                began = time.thread_time()
                console.state.add(RobotPose(clock.now_ns(), None, pose))
                console.state.add(scan)
                QWidget.grab(view)
                times_ms.append((time.thread_time() - began) * 1e3)
            results[f"{way} {width}x{height}"] = percentiles(times_ms)
    results["memory_of_map_mb"] = round((process.memory_info().rss - before_bytes) / 1e6)
    window.close()
    return results


if __name__ == "__main__":
    print(json.dumps({"benchmark": "map_painting", "cells": CELLS, "scan_shown_ms": measure()}))
