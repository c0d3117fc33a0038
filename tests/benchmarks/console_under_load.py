"""Real console in a real window for benchmarks, with simulated robot, video, perception and recording.

Optionally the embedded language model answers continuously.
"""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import psutil
from PySide6.QtCore import QEventLoop, QSettings, Qt, QTimer
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget

from caris_desktop.app.console_command import ConsoleRun, default_arguments
from caris_desktop.app.demo_robot import DemoRobot
from caris_desktop.domain import clock, intents
from caris_desktop.domain.events import LlmExchange, TrialDetails
from caris_desktop.live.console import Console

_NOBODY_THERE = "ws://127.0.0.1:9"


class ConsoleUnderLoad:
    """Start everything, wait until it runs, and record meanwhile; ``close`` ends all.

    ``cameras`` are as with ``--camera``, None: those of the ``scenario``. Without a ``robot`` it is an idle console
    without video and person detection.
    """

    def __init__(
        self,
        *,
        record: bool = True,
        language_model: bool = False,
        perception_timeout_s: float = 120.0,
        robot: Callable[[Console], DemoRobot] | None = lambda console: DemoRobot(console, seed=7),
        cameras: Sequence[str] | None = None,
        scenario: str = "tour-guide",
    ) -> None:
        self._began = (time.monotonic(), _cpu_of_machine_s(), _cpu_of_program_s())
        self._asking = QTimer()
        self._folder = tempfile.TemporaryDirectory(prefix="caris-benchmark-")
        root = Path(self._folder.name)
        self.run = ConsoleRun(
            default_arguments(
                scenario=scenario,
                study=root / "study",
                robot=None if robot is not None else _NOBODY_THERE,
                camera=cameras,
            ),
            settings=QSettings(str(root / "settings.ini"), QSettings.Format.IniFormat),
            robot=robot,
        )
        self.console, self.window = self.run.console, self.run.window
        self.state = self.console.state
        self.window.resize(1600, 900)
        self.run.show()
        if robot is not None:
            self.wait_for(lambda: self.state.link.value.state == "connected", "link", 120.0)
            self.wait_for(lambda: self.state.frame.freshness == "fresh", "video", 60.0)
            self.wait_for(lambda: self.state.perception.value.state == "ready", "perception", perception_timeout_s)
            self.wait_for(lambda: self.state.people.value is not None, "people", 60.0)
        if record:
            self.console.do(intents.StartRecording(TrialDetails(participant="benchmark"), anyway=True))
            self.wait_for(lambda: self.state.recording.value.state == "recording", "recording", 60.0)
        self._answers = self._answered_characters = 0
        self._asking.timeout.connect(self._keep_asking)
        if language_model:
            self.wait_for(lambda: self.state.assistant.value.state == "ready", "language model", 60.0)
            self.state.event_happened.connect(self._count_answer)
            self._asking.start(20)

    def _keep_asking(self) -> None:
        if self.state.assistant.value.state == "ready":
            self.console.do(intents.Ask("What is there to see in this lab? Tell me all of it."))

    def _count_answer(self, event: object) -> None:
        if isinstance(event, LlmExchange):
            self._answers += 1
            self._answered_characters += len(event.answer)

    def focus_driving(self) -> QWidget:
        """Start the measurements: focus driving as a wizard does, and return the focus widget."""
        self.window.activateWindow()
        self.wait_for(self.window.isActiveWindow, "active window", 10.0)
        QTest.keyClick(self.window, Qt.Key.Key_D, Qt.KeyboardModifier.ControlModifier)
        self.wait_for(lambda: self.window.actions_table.driving_focus, "driving focus", 5.0)
        self._began = (time.monotonic(), _cpu_of_machine_s(), _cpu_of_program_s())
        focused = QApplication.focusWidget()
        if focused is None:
            sys.exit("nothing has the focus")
        return focused

    @property
    def address(self) -> str:
        return str(self.state.link.value.address)

    def wait_for(self, condition: Callable[[], bool], what: str, timeout_s: float) -> None:
        """Run Qt until ``condition``; exits the benchmark after the timeout."""
        until_ns = clock.now_ns() + int(timeout_s * 1e9)
        while not condition():
            if clock.now_ns() > until_ns:
                self.close()
                sys.exit(f"no {what} within {timeout_s:.0f} s")
            self.let_qt_run(0.02)

    def let_qt_run(self, seconds: float) -> None:
        """Run the event loop as the program does (``processEvents`` with a time limit would spin)."""
        loop = QEventLoop()
        timer = QTimer(singleShot=True, timerType=Qt.TimerType.PreciseTimer)
        timer.timeout.connect(loop.quit)
        timer.start(max(1, round(seconds * 1000)))
        loop.exec()

    def load(self) -> dict[str, object]:
        """Running components, for the report."""
        return {
            "video_frames": self.state.frame.arrivals,
            "people_updates": self.state.people.arrivals,
            "scans": self.state.scan.arrivals,
            "perception_model": self.state.perception.value.model,
            "recording": self.state.recording.value.state,
            "answers": self._answers,
            "answered_characters": self._answered_characters,
            "cpu_count": os.cpu_count(),
            **self._cpu_percent(),
        }

    def _cpu_percent(self) -> dict[str, float]:
        """Percent of one core since :meth:`focus_driving`; other programs can make the results worse."""
        began_s, machine_s, ours_s = self._began
        elapsed_s = max(0.001, time.monotonic() - began_s)
        all_percent = 100.0 * (_cpu_of_machine_s() - machine_s) / elapsed_s
        ours_percent = 100.0 * (_cpu_of_program_s() - ours_s) / elapsed_s
        return {
            "cpu_percent": round(ours_percent),
            "cpu_percent_of_others": round(max(0.0, all_percent - ours_percent)),
        }

    def close(self) -> None:
        self._asking.stop()
        self.run.close()
        self._folder.cleanup()


def _cpu_of_machine_s() -> float:
    times = psutil.cpu_times()
    return float(sum(times) - times.idle - getattr(times, "iowait", 0.0))


def _cpu_of_program_s() -> float:
    """CPU time of this process and all child processes, including the robot and clients of the benchmark."""
    this = psutil.Process()
    total_s = 0.0
    for process in (this, *this.children(recursive=True)):
        with contextlib.suppress(psutil.Error):
            times = process.cpu_times()
            total_s += times.user + times.system
    return total_s


def stop_process(process: "subprocess.Popen[str]") -> str:
    """Send SIGTERM and return the output."""
    process.send_signal(signal.SIGTERM)
    try:
        return process.communicate(timeout=5)[0]
    except subprocess.TimeoutExpired:
        process.kill()
        return process.communicate()[0]
