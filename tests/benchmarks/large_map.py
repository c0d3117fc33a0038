"""Arrival of a 4000x4000 map while driving: Twist latency and GUI stalls with and without it.

The whole console runs, including recording. It drives the simulated robot; images and maps come from a server of the
benchmark, so that a robot busy with its map does not disturb the measurement. Each encoding has a separate console;
periods with and without a map alternate. Prints one JSON object.
"""

import argparse
import json
import random
import subprocess
import sys
import time
from dataclasses import dataclass, field, replace

from PySide6.QtCore import QEvent, QObject, QSocketNotifier, Qt
from PySide6.QtTest import QTest

from caris_desktop.app import composition
from caris_desktop.app.demo_robot import DemoRobot
from caris_desktop.domain.events import CommandSent
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.console import Console
from caris_desktop.robot.link import LinkSettings, run_media_link
from caris_desktop.robot.profile_model import TopicSource
from caris_desktop.ui.map.map_view import MapView
from tests.benchmarks.console_under_load import ConsoleUnderLoad, stop_process
from tests.benchmarks.screen_and_statistics import on_a_screen, percentiles
from tests.benchmarks.teleop_latency import first_after, moving, start_program
from tests.benchmarks.ui_stalls import LatenessMeter

ENCODINGS = ("cbor", "json")
STALL_AIM_MS = 16.0
SHOWN_AIM_S = 0.6
CELLS = 4000
MAP_WITHIN_S = 20.0


class RobotWithMapsFromElsewhere(DemoRobot):
    """Simulated robot with images and maps from the benchmark's server."""

    def __init__(self, console: Console, media_address: str) -> None:
        super().__init__(console, seed=7)
        self._driven = console
        self._media_address = media_address

    def _on_ready(self, address: str) -> None:
        connection = composition.robot_connection("simulated", address=address)
        profile = replace(connection.profile, map=TopicSource("/map"), map_updates=None)
        media = ProcessSpec("media", run_media_link, (LinkSettings(profile, self._media_address),))
        self._driven.connect_robot(replace(connection, media=media))


class PaintWatch(QObject):
    """Records paint events of the map view."""

    def __init__(self, view: MapView) -> None:
        super().__init__()
        self.painted_grid: object = None
        self.painted_ns = 0
        self._view = view
        view.viewport().installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if event.type() is QEvent.Type.Paint and self._view.grid.displayed_grid is not self.painted_grid:
            self.painted_grid = self._view.grid.displayed_grid
            self.painted_ns = time.monotonic_ns()
        return super().eventFilter(watched, event)


@dataclass
class Period:
    """Key presses with or without a map in transfer."""

    pressed_ns: list[int] = field(default_factory=list)
    released_ns: list[int] = field(default_factory=list)
    ends_ns: list[int] = field(default_factory=list)
    stalls_ms: list[float] = field(default_factory=list)


def measure(encoding: str, maps: int) -> dict[str, object]:
    source_words = [
        "tests.benchmarks.rosbridge_source",
        "--scan-hz",
        "0",
        "--image-hz",
        "15",
        "--map-cells",
        str(CELLS),
    ]
    source = subprocess.Popen(
        [sys.executable, "-m", *source_words, *(["--json-only"] if encoding == "json" else [])],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        bufsize=1,
    )
    if source.stdin is None or source.stdout is None:
        sys.exit("the server has no pipe")
    media_address = f"ws://127.0.0.1:{int(source.stdout.readline())}"
    load = ConsoleUnderLoad(robot=lambda console: RobotWithMapsFromElsewhere(console, media_address))
    listener = start_program("tests.benchmarks.rosbridge_listener", load.address, "/cmd_vel=geometry_msgs/Twist")
    view = load.window.findChild(MapView)
    if not isinstance(view, MapView):
        sys.exit("there is no map view")
    watch = PaintWatch(view)
    sent: list[CommandSent] = []
    load.state.event_happened.connect(lambda event: sent.append(event) if isinstance(event, CommandSent) else None)
    last_bytes_ns: list[int] = []
    notifier = QSocketNotifier(source.stdout.fileno(), QSocketNotifier.Type.Read)
    notifier.activated.connect(lambda: last_bytes_ns.append(int(source.stdout.readline())))
    pad = load.focus_driving()
    meter = LatenessMeter()
    chance = random.Random(6)  # noqa: S311 (intervals, not secrets)
    without, with_map = Period(), Period()
    shown_s: list[float] = []
    number = 0

    def press_until(over: "object", period: Period) -> None:
        nonlocal number
        meter.late_ms.clear()
        until_s = time.monotonic() + MAP_WITHIN_S
        while not over():  # type: ignore[operator]
            if time.monotonic() > until_s:
                load.close()
                source.kill()
                sys.exit(f"the {encoding} map was not shown within {MAP_WITHIN_S:.0f} s")
            key = Qt.Key.Key_A if number % 2 else Qt.Key.Key_D
            number += 1
            period.pressed_ns.append(time.monotonic_ns())
            QTest.keyPress(pad, key)
            load.let_qt_run(chance.uniform(0.06, 0.12))
            period.released_ns.append(time.monotonic_ns())
            QTest.keyRelease(pad, key)
            load.let_qt_run(chance.uniform(0.06, 0.12))
            period.ends_ns.append(time.monotonic_ns())
        period.stalls_ms += meter.late_ms

    for done in range(maps):
        quiet_until_s = time.monotonic() + 3.0
        press_until(lambda until_s=quiet_until_s: time.monotonic() >= until_s, without)
        before = watch.painted_grid
        source.stdin.write("map\n")
        press_until(
            lambda before=before, done=done: len(last_bytes_ns) > done and watch.painted_grid is not before, with_map
        )
        shown_s.append((watch.painted_ns - last_bytes_ns[done]) / 1e9)
        meter.late_ms.clear()
        # Work after the image (the recorder's share, freed memory) counts too.
        after_s = time.monotonic() + 1.0
        press_until(lambda until_s=after_s: time.monotonic() >= until_s, with_map)
    load.let_qt_run(0.3)
    report = load.load()
    lines = [json.loads(line) for line in stop_process(listener).splitlines() if line.startswith("{")]
    notifier.setEnabled(False)
    load.close()
    source.kill()
    source.wait()
    twists = [(line["arrived_ns"], moving(line["msg"])) for line in lines]
    at_socket = [(event.stamp_ns, event.twist.moving) for event in sent]

    def told(period: Period) -> dict[str, object]:
        return {
            "key_to_twist_ms": percentiles(first_after(period.pressed_ns, period.released_ns, twists, moves=True)),
            "release_to_zero_ms": percentiles(first_after(period.released_ns, period.ends_ns, twists, moves=False)),
            "key_to_socket_ms": percentiles(first_after(period.pressed_ns, period.released_ns, at_socket, moves=True)),
            "gui_stall_ms": percentiles(period.stalls_ms),
        }

    return {
        "without_map": told(without),
        "with_map": told(with_map),
        "last_byte_to_shown_s": {"maps": [round(seconds, 3) for seconds in shown_s], "aim": SHOWN_AIM_S},
        "gui_stall_aim_ms": STALL_AIM_MS,
        "load": report,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--maps", type=int, default=6)
    parser.add_argument("--encoding", choices=ENCODINGS, help="only this one")
    arguments = parser.parse_args()
    on_a_screen()
    if arguments.encoding:
        print(json.dumps(measure(arguments.encoding, arguments.maps)))
    else:
        results = {}
        for each in ENCODINGS:
            words = [sys.executable, "-m", "tests.benchmarks.large_map", "--encoding", each]
            done = subprocess.run(
                [*words, "--maps", str(arguments.maps)], stdout=subprocess.PIPE, text=True, check=True
            )
            results[each] = json.loads(done.stdout.splitlines()[-1])
        print(json.dumps({"benchmark": "large_map", "cells": CELLS, **results}))
