"""``safety_child`` that also reports stop keys, and displayed states that contradict the odometry.

Further commands: ``act stop``, ``act estop``, ``act release KEY`` (real keys), ``speak WORDS``. Further reports:
``acted`` (number of key actions and time of the last one) and ``contradictions`` (duration of each, and whether one
exists now).
"""

import sys
import time
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication

from caris_desktop.app.console_command import ConsoleRun
from caris_desktop.domain import intents
from caris_desktop.domain.geometry import moves
from caris_desktop.ui.banners import EmergencyBanner
from caris_desktop.ui.robot_motion import RobotMotion
from caris_desktop.ui.widgets.frame_view import FrameView
from tests.app.console_child import main
from tests.app.safety_child import SafetyDriver


class StopsDriver(SafetyDriver):
    def __init__(self, run: ConsoleRun) -> None:
        super().__init__(run)
        self._acted: tuple[int, int] = (0, 0)
        self._contradictions: list[dict[str, object]] = []
        self._contradicts_since_ns = 0
        self._motion = run.window.findChild(RobotMotion)
        self._view = run.window.findChild(FrameView)
        self._band = run.window.findChild(EmergencyBanner)

    def _on_line(self, line: str) -> None:
        word, _, rest = line.partition(" ")
        if word == "act":
            act, _, key = rest.partition(" ")
            window = self._run.window
            target = QApplication.activeModalWidget() or QApplication.focusWidget() or window
            if act == "estop":
                QTest.keyClick(target, Qt.Key.Key_Escape)
            at_ns = time.monotonic_ns()
            if act == "release":
                QTest.keyRelease(target, Qt.Key(getattr(Qt.Key, f"Key_{key}")))
            else:
                QTest.keyClick(target, Qt.Key.Key_Escape)
            self._acted = (self._acted[0] + 1, at_ns)
        elif word == "speak":
            self._run.console.do(intents.Say(rest, "typed"))
        else:
            super()._on_line(line)

    def _state(self) -> dict[str, object]:
        self._look_for_contradictions()
        return {
            **super()._state(),
            "acted": list(self._acted),
            "contradictions": list(self._contradictions),
            "contradicts": self._contradicts_since_ns != 0,
        }

    def _look_for_contradictions(self) -> None:
        state = self._run.console.state
        sign = self._motion.sign.word
        now = "" if self._view is None else self._view.chips[0][0] if self._view.chips else ""
        band = self._band.accessibleName() if self._band.isVisibleTo(self._run.window) else ""
        stands = sign == "Still" or now == "Still" or "The robot is standing still" in band
        known = state.odometry.value is not None and state.odometry.freshness in ("fresh", "stale")
        odometry = state.odometry.value if known else None
        wrong = odometry is not None and (stands if moves(odometry.twist) else sign == "Moving")
        now_ns = time.monotonic_ns()
        if not wrong:
            self._contradicts_since_ns = 0
        elif not self._contradicts_since_ns:
            self._contradicts_since_ns = now_ns
            twist = odometry.twist
            speeds = [round(twist.forward_mps, 3), round(twist.turn_radps, 3)]
            self._contradictions.append({"sign": sign, "now": now, "band": band, "speeds": speeds, "lasted_ms": 0})
        else:
            self._contradictions[-1]["lasted_ms"] = (now_ns - self._contradicts_since_ns) // 1_000_000


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2]), StopsDriver))
