"""Movement check: commanded velocity against odometry. Pure logic; time is an argument."""

import math
from collections import deque

from caris_desktop.domain.events import MovementState
from caris_desktop.domain.geometry import ZERO_TWIST, Pose2D, Twist2D, moves, wrap_angle
from caris_desktop.domain.sensing import Odometry
from caris_desktop.robot.profile_model import RobotProfile

# Above the thresholds of motion, so that a base at rest never raises an alarm.
_ALARMING_MPS, _ALARMING_RADPS = 0.03, 0.06
# Position noise requires larger speeds over a longer time.
_DRIFTS_MPS, _DRIFTS_RADPS = 0.05, 0.10
_WINDOW_S, _SHORTEST_WINDOW_S = 0.8, 0.4
_JUMP_M, _JUMP_RAD = 0.5, 0.8
# Slower or shorter commands prove nothing: motors have a dead band, and bases ramp.
_COMMANDED_MPS, _COMMANDED_RADPS, _FOLLOWS_WITHIN_S = 0.05, 0.15, 1.2
_FOLLOWS_SHARE = 0.1
_SILENT_AFTER_S, _SILENT_PERIODS, _FIRST_WITHIN_S = 1.0, 3.0, 3.0
# Command delay, the base's own ramp, and odometry delay.
_REACTION_S, _BY_ITSELF_GRACE_S, _LONGEST_GRACE_S = 0.7, 1.5, 4.0
_CONTROL_MOVES_WITHIN_S = 3.0
_FOREIGN_COUNTS_S, _ECHO_WITHIN_S = 0.6, 3.0
_MOVES_IN_A_ROW, _STILL_AFTER_S = 2, 0.3


class MovementCheck:
    """Checks that the robot moves as commanded by this console, and only then.

    Input: every velocity sent, every odometry, and every velocity on the command topic from any sender. Times are
    seconds on the session clock.
    """

    def __init__(self, profile: RobotProfile) -> None:
        self._limits = profile.limits
        self._has_odometry = profile.odometry is not None
        self._sent: deque[tuple[float, Twist2D]] = deque(maxlen=128)
        self.forget(0.0)

    def forget(self, now_s: float) -> None:
        """Reset for a new connection: earlier motion may still be stopping."""
        self._since_s = now_s
        self._odometry_s: float | None = None
        self._period_s = 0.0
        self._poses: deque[tuple[float, Pose2D]] = deque(maxlen=64)
        self._twist = ZERO_TWIST
        self._odometry_has_speed = False
        self._moves_in_a_row = 0
        self._commanded_since_s: float | None = None
        self._followed_s = now_s
        self._foreign_s = -math.inf
        self._may_move_until_s = now_s + _BY_ITSELF_GRACE_S
        self.stood_since_s: float | None = None
        self._control_s: float | None = None

    def sent(self, twist: Twist2D, now_s: float) -> None:
        """Note a velocity that was sent."""
        before = self._sent[-1][1] if self._sent else ZERO_TWIST
        self._sent.append((now_s, twist))
        speed_mps = math.hypot(twist.forward_mps, twist.left_mps)
        if not (speed_mps >= _COMMANDED_MPS or abs(twist.turn_radps) >= _COMMANDED_RADPS):
            self._commanded_since_s = None
        elif self._commanded_since_s is None or _direction(twist) != _direction(before):
            self._commanded_since_s = self._followed_s = now_s
        if twist.moving:
            braking_s = max(
                math.hypot(twist.forward_mps, twist.left_mps) / self._limits.deceleration_mps2,
                abs(twist.turn_radps) / self._limits.turn_deceleration_radps2,
            )
            braking_s += 0.0 if self._odometry_has_speed else _WINDOW_S
            self._may_move_until_s = now_s + min(_REACTION_S + braking_s, _LONGEST_GRACE_S)

    def moves_by_itself(self, now_s: float) -> None:
        """Allow motion on behalf of this console: a goal or a control is active."""
        self._may_move_until_s = max(self._may_move_until_s, now_s + _BY_ITSELF_GRACE_S)

    def control_used(self, now_s: float) -> None:
        """Allow motion after a control that may move the robot, until it has stood still for a while."""
        self._control_s = now_s
        self.moves_by_itself(now_s)

    def stopped(self) -> None:
        """The robot's own activity was stopped from here."""
        self._control_s = None

    def commanded(self, twist: Twist2D, now_s: float) -> None:
        """A velocity on the command topic: an echo of ours, or another sender's."""
        if not twist.moving or any(
            # A rosbridge that was stopped obeys what lay in it of the connection before.
            now_s - max(at_s, self._since_s) <= _ECHO_WITHIN_S and _same(twist, sent_twist)
            for at_s, sent_twist in reversed(self._sent)
        ):
            return
        self._foreign_s = now_s

    def add_odometry(self, odometry: Odometry) -> None:
        now_s = odometry.stamp_ns / 1e9
        if self._odometry_s is not None:
            period_s = min(now_s - self._odometry_s, 2.0)
            self._period_s = period_s if not self._period_s else 0.8 * self._period_s + 0.2 * period_s
        self._odometry_s = now_s
        self._twist = odometry.twist
        self._odometry_has_speed = self._odometry_has_speed or odometry.twist.moving
        self._note_pose(odometry.pose_in_odom, now_s)
        drifts_mps, drifts_radps = self._drift()
        drifts = drifts_mps > _DRIFTS_MPS or drifts_radps > _DRIFTS_RADPS
        alarming = math.hypot(odometry.twist.forward_mps, odometry.twist.left_mps) > _ALARMING_MPS
        alarming = alarming or abs(odometry.twist.turn_radps) > _ALARMING_RADPS or drifts
        self._moves_in_a_row = self._moves_in_a_row + 1 if alarming else 0
        if drifts or moves(odometry.twist):
            self.stood_since_s = None
            return
        if self.stood_since_s is None:
            self.stood_since_s = now_s
        # Braking is over. A recent command may not have reached the wheels.
        last_s = next((at_s for at_s, twist in reversed(self._sent) if twist.moving), -math.inf)
        if now_s - last_s > _REACTION_S:
            self._may_move_until_s = min(self._may_move_until_s, now_s)

    def state(self, now_s: float) -> MovementState:
        """Present state."""
        if self._control_s is not None:
            stands = self.stood_since_s is not None or self._odometry_s is None
            if stands and now_s - max(self._control_s, self.stood_since_s or 0.0) > _CONTROL_MOVES_WITHIN_S:
                self._control_s = None
            else:
                self.moves_by_itself(now_s)
        foreign = now_s - self._foreign_s <= _FOREIGN_COUNTS_S and now_s > self._may_move_until_s
        if self._odometry_s is None:
            silent = self._has_odometry and now_s - self._since_s > _FIRST_WITHIN_S
            return "commanded_elsewhere" if foreign else "silent" if silent else "unknown"
        if now_s - self._odometry_s > max(_SILENT_AFTER_S, _SILENT_PERIODS * self._period_s):
            return "commanded_elsewhere" if foreign else "silent"
        if self._moves_in_a_row >= _MOVES_IN_A_ROW and now_s > self._may_move_until_s:
            return "uncommanded"
        if foreign:
            return "commanded_elsewhere"
        if self._commanded_since_s is not None and now_s - self._sent[-1][0] <= _FOREIGN_COUNTS_S:
            if self._follows():
                self._followed_s = now_s
            if now_s - max(self._commanded_since_s, self._followed_s) > _FOLLOWS_WITHIN_S:
                return "not_following"
        stands = self.stood_since_s is not None and now_s - self.stood_since_s >= _STILL_AFTER_S
        return "standing" if stands else "moving"

    def _follows(self) -> bool:
        """True if the odometry shows a tenth of the last velocity in its main direction."""
        sent, measured = self._sent[-1][1], self._twist
        drifts_mps, drifts_radps = self._drift()
        turns = _direction(sent)[0] == "turn"
        if turns:
            expected, least = abs(sent.turn_radps), 0.02
            along = max(measured.turn_radps * math.copysign(1.0, sent.turn_radps), drifts_radps)
        else:
            expected, least = math.hypot(sent.forward_mps, sent.left_mps), 0.01
            along = (measured.forward_mps * sent.forward_mps + measured.left_mps * sent.left_mps) / expected
            along = max(along, drifts_mps)
        return along >= max(_FOLLOWS_SHARE * expected, least)

    def _note_pose(self, pose: Pose2D, now_s: float) -> None:
        if self._poses:
            newest = self._poses[-1][1]
            turned_rad = abs(wrap_angle(pose.heading_rad - newest.heading_rad))
            if math.hypot(pose.x_m - newest.x_m, pose.y_m - newest.y_m) > _JUMP_M or turned_rad > _JUMP_RAD:
                self._poses.clear()  # the odometry was reset
        self._poses.append((now_s, pose))
        while now_s - self._poses[0][0] > _WINDOW_S:
            self._poses.popleft()

    def _drift(self) -> tuple[float, float]:
        """Speeds from poses alone, for odometry without velocities."""
        if self._odometry_has_speed or not self._poses:
            return 0.0, 0.0
        (begin_s, begin), (end_s, end) = self._poses[0], self._poses[-1]
        lasted_s = end_s - begin_s
        if lasted_s < _SHORTEST_WINDOW_S:
            return 0.0, 0.0
        way_m = math.hypot(end.x_m - begin.x_m, end.y_m - begin.y_m)
        return way_m / lasted_s, abs(wrap_angle(end.heading_rad - begin.heading_rad)) / lasted_s


def _direction(twist: Twist2D) -> tuple[str, int, int]:
    """Dominant component of a twist, and its sign."""
    speed_mps = math.hypot(twist.forward_mps, twist.left_mps)
    if speed_mps / _COMMANDED_MPS < abs(twist.turn_radps) / _COMMANDED_RADPS:
        return "turn", 0, -1 if twist.turn_radps < 0.0 else 1
    return "way", _sign(twist.forward_mps), _sign(twist.left_mps)


def _sign(value: float) -> int:
    return (value > 0.0) - (value < 0.0)


def _same(one: Twist2D, other: Twist2D) -> bool:
    return (
        abs(one.forward_mps - other.forward_mps) < 1e-4
        and abs(one.left_mps - other.left_mps) < 1e-4
        and abs(one.turn_radps - other.turn_radps) < 1e-4
    )
