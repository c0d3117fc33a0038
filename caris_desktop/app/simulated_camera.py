"""Simulated camera in the simulated rooms, alongside real ones: practice with several cameras, or without any."""

import time

from caris_desktop.perception.cameras.camera_source import CameraSource, Picture
from caris_desktop.perception.cameras.chosen_camera import ChosenCamera
from caris_desktop.perception.cameras.open_camera import open_camera

_SEED = 11


def open_any_camera(chosen: ChosenCamera) -> CameraSource:
    """Open any camera of :func:`open_camera`, or the simulated one. Raises CameraError."""
    return SimulatedCamera() if chosen.kind == "simulated" else open_camera(chosen)


class SimulatedCamera:
    """Camera at the simulated robot's start position, in its own rooms, without a moving robot."""

    def __init__(self) -> None:
        from caris_desktop.simulator.camera_model import HEIGHT_PX, RATE_HZ, WIDTH_PX
        from caris_desktop.simulator.picture import Painter
        from caris_desktop.simulator.robot_simulation import Robot

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
