"""Pan-tilt head with joint limits and motor speeds."""

from caris_desktop.domain.value_class import dataclass

DEFAULT_SPEED_RADPS = 0.8


@dataclass(frozen=True, slots=True)
class HeadModel:
    """Range and speed of a head: pan left positive, tilt down positive, from straight ahead."""

    pan_range_rad: tuple[float, float] = (-1.2, 1.2)
    tilt_range_rad: tuple[float, float] = (-0.5, 0.7)
    fastest_radps: float = 1.5


FIXED = HeadModel((0.0, 0.0), (0.0, 0.0))
MOVABLE = HeadModel()


@dataclass(slots=True)
class _Joint:
    range_rad: tuple[float, float]
    fastest_radps: float
    angle_rad: float = 0.0
    target_rad: float = 0.0
    speed_radps: float = DEFAULT_SPEED_RADPS

    def turn_to(self, target_rad: float, speed_radps: float) -> None:
        lowest, highest = self.range_rad
        self.target_rad = min(max(target_rad, lowest), highest)
        self.speed_radps = min(max(speed_radps, 0.01), self.fastest_radps)

    def step(self, dt_s: float) -> None:
        most = self.speed_radps * dt_s
        self.angle_rad += min(max(self.target_rad - self.angle_rad, -most), most)


class Head:
    """Turns towards its newest target; joints are independent."""

    def __init__(self, model: HeadModel = MOVABLE) -> None:
        self._pan = _Joint(model.pan_range_rad, model.fastest_radps)
        self._tilt = _Joint(model.tilt_range_rad, model.fastest_radps)

    @property
    def pan_rad(self) -> float:
        return self._pan.angle_rad

    @property
    def tilt_rad(self) -> float:
        return self._tilt.angle_rad

    def pan_to(self, angle_rad: float, *, speed_radps: float = DEFAULT_SPEED_RADPS) -> None:
        """Start panning left (positive) or right, within the joint limits."""
        self._pan.turn_to(angle_rad, speed_radps)

    def tilt_to(self, angle_rad: float, *, speed_radps: float = DEFAULT_SPEED_RADPS) -> None:
        """Start tilting down (positive) or up, within the joint limits."""
        self._tilt.turn_to(angle_rad, speed_radps)

    def step(self, dt_s: float) -> None:
        """Advance the simulation by ``dt_s``."""
        self._pan.step(dt_s)
        self._tilt.step(dt_s)
