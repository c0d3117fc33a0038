"""The motion lease: what velocity goes to the robot, and when. Pure logic, time comes in as an argument."""

import math
from collections.abc import Callable
from enum import Enum

from caris_desktop.domain.events import CommandSource
from caris_desktop.domain.geometry import ZERO_TWIST, Twist2D
from caris_desktop.domain.value_class import dataclass
from caris_desktop.robot.profile import MotionLimits

EXPIRY_S = 0.15
ZERO_REPEAT_S = 0.5
# A timer that fires a hair early must not make the step wait for another whole period.
_EARLY_S = 0.0005


class _Phase(Enum):
    IDLE = "idle"  # silent
    HELD = "held"  # ramping to the target and repeating it
    ZEROING = "zeroing"  # repeating zero, then silent


@dataclass(frozen=True, slots=True)
class LeasedTwist:
    """A velocity that is due now, and who is responsible for it."""

    twist: Twist2D
    source: CommandSource


class MotionLease:
    """Decides about every velocity command.

    A Twist is sent only while something holds the lease. ``drive`` takes it, ``renew`` keeps it; 150 ms after the last
    of them it is gone: zero at once (not ramped), repeated for 0.5 s, then silence. Endless zeros would fight
    navigation. All times are seconds on one monotonic clock, and ``now_s`` never runs backwards by more than the age
    of a command. After each call ask :meth:`next_twist`, and again no later than :meth:`due_s` tells.

    ``allow`` is asked before each velocity: what fraction of it the obstacle guard allows at that time. The robot is
    slowed by it at once and speeds up again as the limits say, on the same arc.
    """

    def __init__(
        self,
        limits: MotionLimits,
        *,
        rate_hz: float = 20.0,
        allow: Callable[[Twist2D, float], float] = lambda _twist, _now_s: 1.0,
    ) -> None:
        self._limits = limits
        self._allow = allow
        self._period_s = 1.0 / rate_hz
        self._phase = _Phase.IDLE
        self._target = ZERO_TWIST
        # Where the ramp to the target has come, and what of it the guard let pass.
        self._ramped = ZERO_TWIST
        self._current = ZERO_TWIST
        self._holder: CommandSource = "none"
        self._zero_source: CommandSource = "none"
        self._renewed_s = -math.inf
        self._sent_s = -math.inf
        self._zeros_end_s = -math.inf
        self._due_s = math.inf
        self._latched = False
        self._expired = False

    @property
    def held(self) -> bool:
        return self._phase is _Phase.HELD

    @property
    def latched(self) -> bool:
        """Whether the emergency stop forbids motion."""
        return self._latched

    def drive(self, target: Twist2D, source: CommandSource, now_s: float) -> bool:
        """Take the lease or change its target. False when the emergency stop refuses it (and zeros go out again)."""
        if self._latched:
            self._begin_zeros(now_s, "stop")
            return False
        bounded = bounded_twist(target, self._limits)
        if not bounded.moving:
            self.release(now_s)
            return True
        if not self.held:
            # The first step of the ramp goes out at once, as large as one period of it.
            self._sent_s = now_s - self._period_s
            self._current = self._ramped = ZERO_TWIST
        changed = not self.held or bounded != self._target
        if changed:
            # From what the robot was really told, however much the guard took away.
            self._ramped = self._current
        self._phase = _Phase.HELD
        self._expired = False
        self._target = bounded
        self._holder = source
        self._renewed_s = max(self._renewed_s, now_s)
        if changed:
            self._due_s = now_s
        return True

    def renew(self, now_s: float) -> bool:
        """Keep the lease. False when nothing holds it, or when it had run out before this came."""
        if not self.held or now_s - self._renewed_s > EXPIRY_S:
            return False
        self._renewed_s = max(self._renewed_s, now_s)
        return True

    def release(self, now_s: float) -> bool:
        """Give the lease back: zero at once. False, and nothing is sent, when nothing held it."""
        if not self.held:
            return False
        self._begin_zeros(now_s, self._holder)
        return True

    def reconsider(self, now_s: float) -> None:
        """The surroundings are known anew: what is no longer allowed is corrected now, not at the next tick."""
        if self.held and self._current.moving and self._allow(self._current, now_s) < 1.0:
            self._due_s = min(self._due_s, now_s)

    def stop(self, now_s: float, source: CommandSource = "stop") -> None:
        """Zero at once, whether or not anything held the lease: something else may be moving the robot."""
        self._begin_zeros(now_s, source)

    def told(self, twist: Twist2D) -> None:
        """What was due did not go out; the robot was last told this instead, and the ramp goes on from there."""
        if self.held:
            self._current = self._ramped = twist

    def end(self, now_s: float) -> bool:
        """Take the lease away for a reason of our own: zero at once. False when nothing held it."""
        if not self.held:
            return False
        self._begin_zeros(now_s, "lease")
        return True

    def emergency(self, latched: bool, now_s: float) -> None:
        """Latch (zero at once, then refuse every drive) or clear. Clearing moves nothing by itself."""
        self._latched = latched
        if latched:
            self._begin_zeros(now_s, "stop")

    def forget(self) -> None:
        """The link is down: silence, and nothing is left that could be sent later. The emergency stop stays."""
        self._phase = _Phase.IDLE
        self._current = self._ramped = ZERO_TWIST
        self._target = ZERO_TWIST
        self._due_s = math.inf

    def due_s(self) -> float:
        """When :meth:`next_twist` must be asked again; ``inf`` while silent."""
        return min(self._due_s, self._renewed_s + EXPIRY_S) if self.held else self._due_s

    def take_expired(self) -> bool:
        """True once after the lease ran out by itself."""
        expired, self._expired = self._expired, False
        return expired

    def next_twist(self, now_s: float) -> LeasedTwist | None:
        """The velocity to send at ``now_s``, or None when none is due. Each due one is returned once."""
        if self.held and now_s - self._renewed_s >= EXPIRY_S - _EARLY_S:
            self._expired = True
            self._begin_zeros(now_s, "lease")
        if now_s < self._due_s - _EARLY_S:
            return None
        if self._phase is _Phase.HELD:
            elapsed_s = min(max(now_s - self._sent_s, 0.0), self._period_s)
            self._ramped = ramp(self._ramped, self._target, self._limits, elapsed_s)
            fraction = min(self._allow(self._ramped, now_s), self._speeding_up(elapsed_s))
            self._current = scaled(self._ramped, fraction)
            leased = LeasedTwist(self._current, self._holder)
            self._due_s = self._next_due_s(now_s)
        elif self._phase is _Phase.ZEROING:
            leased = LeasedTwist(ZERO_TWIST, self._zero_source)
            self._due_s = self._next_due_s(now_s)
            if self._due_s > self._zeros_end_s + _EARLY_S:
                self._phase = _Phase.IDLE
                self._due_s = math.inf
        else:
            return None
        self._sent_s = now_s
        return leased

    def _speeding_up(self, elapsed_s: float) -> float:
        """The fraction of the ramped velocity that is not too sudden after the one before, which the guard had cut."""
        limits = self._limits
        return min(
            _reachable(self._current.forward_mps, self._ramped.forward_mps, limits.acceleration_mps2 * elapsed_s),
            _reachable(self._current.left_mps, self._ramped.left_mps, limits.acceleration_mps2 * elapsed_s),
            _reachable(self._current.turn_radps, self._ramped.turn_radps, limits.turn_acceleration_radps2 * elapsed_s),
        )

    def _next_due_s(self, now_s: float) -> float:
        # From the planned time, so that the rate holds however late the timer was.
        return max(self._due_s, now_s - self._period_s / 2.0) + self._period_s

    def _begin_zeros(self, now_s: float, source: CommandSource) -> None:
        self._phase = _Phase.ZEROING
        self._zero_source = source
        self._current = self._ramped = ZERO_TWIST
        self._target = ZERO_TWIST
        self._renewed_s = -math.inf
        self._due_s = now_s
        self._zeros_end_s = now_s + ZERO_REPEAT_S


def bounded_twist(target: Twist2D, limits: MotionLimits) -> Twist2D:
    """``target`` within the robot's speed limits; anything that is not a finite number is zero."""
    return Twist2D(
        _bounded(target.forward_mps, -limits.backward_mps, limits.forward_mps),
        _bounded(target.left_mps, -limits.left_mps, limits.left_mps),
        _bounded(target.turn_radps, -limits.turn_radps, limits.turn_radps),
    )


def ramp(current: Twist2D, target: Twist2D, limits: MotionLimits, elapsed_s: float) -> Twist2D:
    """One step from ``current`` towards ``target``: slower to speed up than to slow down, reversal through zero."""
    return Twist2D(
        _ramped(current.forward_mps, target.forward_mps, limits.acceleration_mps2, limits.deceleration_mps2, elapsed_s),
        _ramped(current.left_mps, target.left_mps, limits.acceleration_mps2, limits.deceleration_mps2, elapsed_s),
        _ramped(
            current.turn_radps,
            target.turn_radps,
            limits.turn_acceleration_radps2,
            limits.turn_deceleration_radps2,
            elapsed_s,
        ),
    )


def scaled(twist: Twist2D, fraction: float) -> Twist2D:
    """The same arc at a ``fraction`` (0..1) of the speed."""
    if fraction >= 1.0:
        return twist
    if not fraction > 0.0:
        return ZERO_TWIST
    return Twist2D(twist.forward_mps * fraction, twist.left_mps * fraction, twist.turn_radps * fraction)


def _reachable(current: float, wanted: float, step: float) -> float:
    """The largest fraction (at most 1) of ``wanted`` that one step of speeding up reaches."""
    reach = (abs(current) if current * wanted > 0.0 else 0.0) + step
    return 1.0 if abs(wanted) <= reach else reach / abs(wanted)


def _bounded(value: float, lowest: float, highest: float) -> float:
    # Adding 0.0 turns -0.0, which a robot without side motion would get, into 0.0.
    return min(max(value, lowest), highest) + 0.0 if math.isfinite(value) else 0.0


def _ramped(current: float, target: float, speeding_up: float, slowing_down: float, elapsed_s: float) -> float:
    if current * target < 0.0:
        step = slowing_down * elapsed_s
        return 0.0 if abs(current) <= step else current - math.copysign(step, current)
    rate = speeding_up if abs(target) > abs(current) else slowing_down
    step = rate * elapsed_s
    return target if abs(target - current) <= step else current + math.copysign(step, target - current)
