"""Pan-tilt head with joint limits and motor speeds."""

from caris_desktop.domain.value_class import Value, dataclass

DEFAULT_SPEED_RADPS = 0.8


class HeadModel(Value):
    """Range and speed of a head: pan left positive, tilt down positive, from straight ahead."""

    pan_range_rad: tuple[float, float] = (-1.2, 1.2)
    tilt_range_rad: tuple[float, float] = (-0.5, 0.7)
    fastest_radps: float = 1.5


MOVABLE = HeadModel()


@dataclass(slots=True)
class Joint:
    """One motor, which turns towards its newest target."""

    range_rad: tuple[float, float]
    fastest_radps: float
    angle_rad: float = 0.0
    target_rad: float = 0.0
    speed_radps: float = DEFAULT_SPEED_RADPS

    def turn_to(self, target_rad: float, speed_radps: float = DEFAULT_SPEED_RADPS) -> None:
        """Start turning, within the limits of range and speed."""
        lowest, highest = self.range_rad
        self.target_rad = min(max(target_rad, lowest), highest)
        self.speed_radps = min(max(speed_radps, 0.01), self.fastest_radps)

    def step(self, dt_s: float) -> None:
        most = self.speed_radps * dt_s
        self.angle_rad += min(max(self.target_rad - self.angle_rad, -most), most)


class Head:
    """Pan joint (left positive) and tilt joint (down positive); they are independent."""

    def __init__(self, model: HeadModel = MOVABLE) -> None:
        self.pan = Joint(model.pan_range_rad, model.fastest_radps)
        self.tilt = Joint(model.tilt_range_rad, model.fastest_radps)

    def step(self, dt_s: float) -> None:
        """Advance the simulation by ``dt_s``."""
        self.pan.step(dt_s)
        self.tilt.step(dt_s)
