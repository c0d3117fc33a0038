"""Remote microphone of the participant, on the robot or a camera. GUI thread."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from PySide6.QtCore import QObject, QTimer

from caris_desktop.domain import clock
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.bus import Bus
from caris_desktop.live.state import LiveValue
from caris_desktop.live.status import MicrophoneStatus
from caris_desktop.robot.profile import RobotProfile
from caris_desktop.scenario.scenario_model import Scenario

_POLL_EVERY_MS = 200
_SILENT_NS = 3_000_000_000
_OFF = MicrophoneStatus()


def participant_microphone(scenario: Scenario, robot: RobotProfile | None) -> str:
    """Microphone of the participant with this robot: ``robot``, ``computer``, ``camera:NAME`` or ``none``."""
    hears = robot is not None and robot.audio is not None and robot.audio.topic is not None
    return scenario.sound.resolve_microphone(robot_hears=hears)


class RemoteMicrophone(QObject):
    """Requests audio, maintains ``status``, and reports missing audio."""

    def __init__(self, status: LiveValue, bus: Bus, *, settled: Callable[[], None], parent: QObject) -> None:
        """``settled`` is called when audio arrives, or when none can be expected for now."""
        super().__init__(parent)
        self._status = status
        self._bus = bus
        self._settled = settled
        self._reachable: Callable[[], bool] = lambda: True
        self._ask: Callable[[bool], object] | None = None
        self._robot_name = ""
        self._received_ns = self._requested_ns = self._unreachable_ns = 0
        self._peak = 0
        self._silence_reported = False
        self._check_timer = QTimer(self, interval=_POLL_EVERY_MS)
        self._check_timer.timeout.connect(self.update_status)
        bus.tap(self._on_sound, (AudioChunk,))

    def open(self, whose: str, ask: Callable[[bool], object], *, reachable: Callable[[], bool] = lambda: True) -> None:
        """Start listening. ``whose``: name of the microphone; ``ask`` requests or ends its audio.

        While the source is not ``reachable``, missing audio is not reported, as its cause is known.
        """
        if self._robot_name == whose:
            return
        self.close()
        self._robot_name, self._ask, self._reachable = whose, ask, reachable
        self._requested_ns, self._silence_reported = clock.now_ns(), False
        self._show("starting")
        self._check_timer.start()
        ask(True)

    def ask_again(self) -> None:
        """Request again after a restart of the source."""
        if self._ask is not None:
            self._ask(True)

    def close(self) -> None:
        ask, self._ask, self._robot_name = self._ask, None, ""
        self._check_timer.stop()
        if ask is not None:
            ask(False)
            self._status.set(_OFF)

    def _on_sound(self, chunk: AudioChunk, _raw: bytes | None) -> None:  # any thread
        if chunk.source == ROBOT_MICROPHONE:
            self._received_ns = clock.now_ns()
            self._peak = max(self._peak, int(np.abs(chunk.samples.astype(np.int32)).max(initial=0)))

    def update_status(self) -> None:
        """Update the status from the audio received so far."""
        now_ns = clock.now_ns()
        before: MicrophoneStatus = self._status.value
        if not self._reachable():
            self._unreachable_ns = now_ns
        if self._received_ns > self._requested_ns and now_ns - self._received_ns < _SILENT_NS:
            peak, self._peak = self._peak, 0
            self._silence_reported = False
            self._show("on", level=round(peak / 32768, 3))
            if before.state != "on":
                self._settled()
        elif now_ns - max(self._received_ns, self._requested_ns) >= _SILENT_NS and not self._silence_reported:
            if before.state != "failed":
                self._show("failed", detail=QT_TR_NOOP("It sends no sound."))
                self._settled()
            if now_ns - self._unreachable_ns <= _SILENT_NS:
                return
            self._silence_reported = True
            self._bus.problem(
                "warning",
                tr("An open microphone sends no sound: {microphone}.").format(microphone=self._robot_name),
                tr("Speech there is not heard, recorded or transcribed until the microphone works again."),
                tr("Check its connection, and check that the robot publishes its sound as specified in the profile."),
                until="microphone",
                cause="robot_sound",
            )

    def _show(self, state: Any, *, level: float = 0.0, detail: str = "") -> None:
        self._status.set(
            replace(_OFF, state=state, name=self._robot_name, level=level, detail=detail, source=ROBOT_MICROPHONE)
        )
