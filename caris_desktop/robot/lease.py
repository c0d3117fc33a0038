"""Motion lease: which velocity is sent to the robot, and when. Pure logic; time is an argument."""

import math
from collections.abc import Callable
from enum import Enum

from caris_desktop.domain.events import CommandSource
from caris_desktop.domain.geometry import ZERO_TWIST, Twist2D
from caris_desktop.domain.value_class import Value
from caris_desktop.robot.profile_model import MotionLimits

EXPIRY_S = 0.15
ZERO_REPEAT_S = 0.5
# A timer that fires slightly early must not delay the step by a whole period.
_EARLY_S = 0.0005


class _Phase(Enum):
    IDLE = "idle"  # silent
    HELD = "held"  # ramping to the target and repeating it
    ZEROING = "zeroing"  # repeating zero, then silent


class LeasedTwist(Value):
    """Velocity due now, and its source."""

    twist: Twist2D
    source: CommandSource


class MotionLease:
    """Decides on every velocity command.

    A Twist is sent only while the lease is held. ``drive`` takes it, ``renew`` extends it; it expires 150 ms after the
    last of them: zero at once (not ramped), repeated for 0.5 s, then silence, since endless zeros would conflict with
    navigation. All times are seconds on one monotonic clock, and ``now_s`` never runs backwards by more than the age of
    a command. After each call use :meth:`next_twist`, and again no later than :meth:`due_s`.

    ``allow`` returns the fraction of a velocity that the obstacle guard permits. It slows the robot at once; speeding
    up again follows the limits, on the same arc.
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
        # State of the ramp, and the part of it that the guard permitted.
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
        """True while the emergency stop forbids motion."""
        return self._latched

    def drive(self, target: Twist2D, source: CommandSource, now_s: float) -> bool:
        """Take the lease or change its target. False if the emergency stop refuses it (and zeros are sent again)."""
        if self._latched:
            self._begin_zeros(now_s, "stop")
            return False
        bounded = bounded_twist(target, self._limits)
        if not bounded.moving:
            self.release(now_s)
            return True
        if not self.held:
            # The first ramp step is sent at once, as large as one period's.
            self._sent_s = now_s - self._period_s
            self._current = self._ramped = ZERO_TWIST
        changed = not self.held or bounded != self._target
        if changed:
            # From the velocity really sent, whatever the guard removed.
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
        """Extend the lease. False if it is not held, or had expired before."""
        if not self.held or now_s - self._renewed_s > EXPIRY_S:
            return False
        self._renewed_s = max(self._renewed_s, now_s)
        return True

    def release(self, now_s: float) -> bool:
        """Release the lease: zero at once. False, and nothing is sent, if it was not held."""
        if not self.held:
            return False
        self._begin_zeros(now_s, self._holder)
        return True

    def reconsider(self, now_s: float) -> None:
        """Apply new guard limits now instead of at the next tick."""
        if self.held and self._current.moving and self._allow(self._current, now_s) < 1.0:
            self._due_s = min(self._due_s, now_s)

    def stop(self, now_s: float, source: CommandSource = "stop") -> None:
        """Send zero at once, with or without a lease: something else may be moving the robot."""
        self._begin_zeros(now_s, source)

    def set_sent(self, twist: Twist2D) -> None:
        """Set the velocity sent instead of the due one; the ramp continues from it."""
        if self.held:
            self._current = self._ramped = twist

    def end(self, now_s: float) -> bool:
        """End the lease for an internal reason: zero at once. False if it was not held."""
        if not self.held:
            return False
        self._begin_zeros(now_s, "lease")
        return True

    def emergency(self, latched: bool, now_s: float) -> None:
        """Latch (zero at once, then refuse every drive) or clear. Clearing alone moves nothing."""
        self._latched = latched
        if latched:
            self._begin_zeros(now_s, "stop")

    def forget(self) -> None:
        """Reset on link loss: silence, and nothing pending. The emergency stop stays."""
        self._phase = _Phase.IDLE
        self._current = self._ramped = ZERO_TWIST
        self._target = ZERO_TWIST
        self._due_s = math.inf

    def due_s(self) -> float:
        """Time for the next :meth:`next_twist`; ``inf`` while silent."""
        return min(self._due_s, self._renewed_s + EXPIRY_S) if self.held else self._due_s

    def pop_expired(self) -> bool:
        """True once after the lease expired."""
        expired, self._expired = self._expired, False
        return expired

    def next_twist(self, now_s: float) -> LeasedTwist | None:
        """Velocity to send at ``now_s``, or None if none is due. Each is returned once."""
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
        """Fraction of the ramped velocity that respects the acceleration limit after a guard reduction."""
        limits = self._limits
        return min(
            _reachable(self._current.forward_mps, self._ramped.forward_mps, limits.acceleration_mps2 * elapsed_s),
            _reachable(self._current.left_mps, self._ramped.left_mps, limits.acceleration_mps2 * elapsed_s),
            _reachable(self._current.turn_radps, self._ramped.turn_radps, limits.turn_acceleration_radps2 * elapsed_s),
        )

    def _next_due_s(self, now_s: float) -> float:
        # From the planned time, so that the rate holds despite late timers.
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
    """``target`` within the robot's speed limits; values that are not finite become zero."""
    return Twist2D(
        _bounded(target.forward_mps, -limits.backward_mps, limits.forward_mps),
        _bounded(target.left_mps, -limits.left_mps, limits.left_mps),
        _bounded(target.turn_radps, -limits.turn_radps, limits.turn_radps),
    )


def ramp(current: Twist2D, target: Twist2D, limits: MotionLimits, elapsed_s: float) -> Twist2D:
    """One ramp step from ``current`` towards ``target``: acceleration is slower than deceleration, reversal goes
    through zero.
    """
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


def _reachable(current: float, target: float, step: float) -> float:
    """Largest fraction (at most 1) of ``target`` reachable in one acceleration step."""
    reach = (abs(current) if current * target > 0.0 else 0.0) + step
    return 1.0 if abs(target) <= reach else reach / abs(target)


def _bounded(value: float, lowest: float, highest: float) -> float:
    # Adding 0.0 turns -0.0, which a robot without sideways motion would get, into 0.0.
    return min(max(value, lowest), highest) + 0.0 if math.isfinite(value) else 0.0


def _ramped(current: float, target: float, speeding_up: float, slowing_down: float, elapsed_s: float) -> float:
    if current * target < 0.0:
        step = slowing_down * elapsed_s
        return 0.0 if abs(current) <= step else current - math.copysign(step, current)
    rate = speeding_up if abs(target) > abs(current) else slowing_down
    step = rate * elapsed_s
    return target if abs(target - current) <= step else current + math.copysign(step, target - current)
