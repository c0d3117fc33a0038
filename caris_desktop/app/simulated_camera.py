"""Simulated camera in the simulated rooms, alongside real ones: practice with several cameras, or without any."""

import time

from caris_desktop.perception.cameras.camera_source import ChosenCamera, Picture

_SEED = 11


class SimulatedCamera:
    """Camera at the simulated robot's start position, in its own rooms, without a moving robot."""

    def __init__(self, _chosen: ChosenCamera) -> None:
        from caris_desktop.simulator.picture import Painter
        from caris_desktop.simulator.robot_simulation import HEIGHT_PX, RATE_HZ, WIDTH_PX, Robot

        self.width_px, self.height_px = WIDTH_PX, HEIGHT_PX
        self.fps: float | None = RATE_HZ
        self._period_s = 1.0 / RATE_HZ
        self._painter = Painter()
        self._rooms = Robot(_SEED)
        self._began_s = self._due_s = time.monotonic()

    def read(self) -> Picture | None:
        now_s = time.monotonic()
        time.sleep(max(0.0, self._due_s - now_s))
        self._due_s = max(self._due_s, now_s) + self._period_s
        while self._rooms.now_s < time.monotonic() - self._began_s:
            self._rooms.step()
        return Picture(self._painter.paint(self._rooms.view()), taken_ns=time.monotonic_ns(), taken_uncertainty_ns=0)

    def close(self) -> None:
        """Nothing to release."""
