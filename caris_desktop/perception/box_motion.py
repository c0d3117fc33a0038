"""Motion model of boxes (Kalman filter in seconds), shared by our trackers."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import dataclass

Floats = NDArray[np.float64]

# In box heights: a detector's position error; people's acceleration; the rate of size changes.
_SEEN_WITHIN = 0.05
_ACCELERATION_PER_S2 = 2.0
_SPEED_AT_FIRST_PER_S = 0.7
_RESIZE_PER_S = 0.25
_VELOCITY_DECAY_S = 0.6


@dataclass(slots=True, eq=False)
class Motion:
    """Centre, width and height with their speeds in pixels and seconds; axes are independent.

    ``mean`` (4, 2): value and speed. ``covariance`` (4, 2, 2). ``stamp_s`` is the time of the state, ``seen_s`` and
    ``first_s`` the last and first detection.
    """

    mean: Floats
    covariance: Floats
    stamp_s: float
    seen_s: float
    first_s: float

    @property
    def height_px(self) -> float:
        return max(4.0, float(self.mean[3, 0]))

    def corners(self) -> Floats:
        x, y, width, height = self.mean[:, 0]
        return np.array([x - width / 2, y - height / 2, x + width / 2, y + height / 2])

    def advance(self, stamp_s: float, shift_px: tuple[float, float]) -> None:
        """Predict the state; the speed decays while the box is not detected.

        ``shift_px`` is the image motion by camera rotation since the last frame.
        """
        dt = stamp_s - self.stamp_s
        self.stamp_s = stamp_s
        self.mean[:2, 0] += shift_px
        if dt <= 0.0:
            return
        unseen_s = stamp_s - self.seen_s - dt
        self.mean[:, 0] += self.mean[:, 1] * dt
        self.mean[:, 1] *= np.exp(-dt / _VELOCITY_DECAY_S) if unseen_s > 0.0 else 1.0
        # Sizes have no speed: someone who came nearer does not go on growing.
        self.mean[2:, 1] = 0.0
        step = np.array([[1.0, dt], [0.0, 1.0]])
        self.covariance = step @ self.covariance @ step.T
        q = (_ACCELERATION_PER_S2 * self.height_px) ** 2
        self.covariance[:2] += q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        self.covariance[2:, 0, 0] += (_RESIZE_PER_S * self.height_px) ** 2 * dt

    def see(self, corners: Floats, stamp_s: float) -> None:
        measured = _measured(corners)
        total = self.covariance[:, 0, 0] + _variance(measured)
        gain = self.covariance[:, :, 0] / total[:, None]
        self.mean = self.mean + gain * (measured - self.mean[:, 0])[:, None]
        self.covariance = self.covariance - gain[:, :, None] * self.covariance[:, None, 0, :]
        self.seen_s = stamp_s

    def unlikeliness(self, corners: Floats) -> float:
        """Squared Mahalanobis distance of a box from the predicted one."""
        measured = _measured(corners)
        return float(((measured - self.mean[:, 0]) ** 2 / (self.covariance[:, 0, 0] + _variance(measured))).sum())


def first_seen(corners: Floats, stamp_s: float) -> tuple[Floats, Floats, float, float, float]:
    """Initial fields of a :class:`Motion`."""
    measured = _measured(corners)
    height = max(4.0, float(measured[3]))
    covariance = np.zeros((4, 2, 2))
    covariance[:, 0, 0] = _variance(measured)
    covariance[:2, 1, 1] = (_SPEED_AT_FIRST_PER_S * height) ** 2
    covariance[2:, 1, 1] = (_RESIZE_PER_S * height) ** 2
    return np.stack([measured, np.zeros(4)], axis=1), covariance, stamp_s, stamp_s, stamp_s


def corners_of(motions: Sequence[Motion]) -> Floats:
    return np.stack([motion.corners() for motion in motions])


def assigned(cost: Floats, limit: float) -> list[tuple[int, int]]:
    """Optimal assignment as (row, column) pairs; none costs more than ``limit``."""
    import lap  # the console imports this module for its types, without lap

    _, columns, _ = lap.lapjv(np.ascontiguousarray(cost), extend_cost=True, cost_limit=limit)
    return [(row, column) for row, column in enumerate(columns.tolist()) if column >= 0]


def overlaps(first: Floats, second: Floats, buffer: float = 0.0) -> Floats:
    """Intersection over union of all pairs, shape (first, second), after enlarging both by ``buffer``."""
    a, b = _blown_up(first, buffer), _blown_up(second, buffer)
    wide = np.minimum(a[:, None, 2], b[None, :, 2]) - np.maximum(a[:, None, 0], b[None, :, 0])
    high = np.minimum(a[:, None, 3], b[None, :, 3]) - np.maximum(a[:, None, 1], b[None, :, 1])
    both = np.clip(wide, 0.0, None) * np.clip(high, 0.0, None)
    area_a = (a[:, 2] - a[:, 0]) * (a[:, 3] - a[:, 1])
    area_b = (b[:, 2] - b[:, 0]) * (b[:, 3] - b[:, 1])
    return np.asarray(both / np.maximum(1e-9, area_a[:, None] + area_b[None, :] - both))


def _blown_up(corners: Floats, buffer: float) -> Floats:
    width, height = (corners[:, 2] - corners[:, 0]) * buffer, (corners[:, 3] - corners[:, 1]) * buffer
    return np.asarray(corners + np.stack([-width, -height, width, height], axis=1))


def _measured(corners: Floats) -> Floats:
    left, top, right, bottom = corners
    return np.array([(left + right) / 2, (top + bottom) / 2, right - left, bottom - top])


def _variance(measured: Floats) -> float:
    return (_SEEN_WITHIN * max(4.0, float(measured[3]))) ** 2
