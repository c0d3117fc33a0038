"""Drive service: teleoperation input to drive commands with a lease, under the safety rules. GUI thread.

Each change is sent at once, and the lease is renewed every 50 ms by a GUI timer, so that a stalled GUI stops renewing.
Ramping, repeating and sending zero is the link process's task.
"""

from collections.abc import Callable
from dataclasses import replace

from PySide6.QtCore import QObject

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, WIZARD, Actor
from caris_desktop.domain.events import (
    CommandSource,
    DriveEnded,
    EmergencyStopChanged,
    Event,
    GuardChanged,
    MovementChanged,
    NavigationSpeedChanged,
    StopRequested,
)
from caris_desktop.domain.geometry import Twist2D
from caris_desktop.domain.link_commands import (
    Drive,
    LimitGoals,
    MoveHead,
    Release,
    RenewLease,
    SetEmergencyStop,
    SetGuard,
    StopMotion,
)
from caris_desktop.domain.ports import ReportProblem, RobotPort
from caris_desktop.domain.translation import QT_TR_NOOP, localized, tr
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.service import Follows, Handlers, Service
from caris_desktop.live.state import LiveState, LiveStream
from caris_desktop.live.status import HeadStatus
from caris_desktop.robot.profile_model import HeadInterface, MotionLimits, RobotProfile
from caris_desktop.scenario.scenario_model import Scenario

RENEW_EVERY_MS = 50
LEASE_NS = 150_000_000
STALE_CAP_FRACTION = 0.3
_WORTH_RENEWING_NS = 15_000_000
_AGE_SHOWN_EVERY_MS = 500
# A link in trouble still counts as connected.
_LINKED = ("connected", "trouble")
_ANY_SPEED = MotionLimits(forward_mps=float("inf"), backward_mps=float("inf"), left_mps=0.0, turn_radps=float("inf"))


class DriveService(Service):
    """Holds the current command, decides whether and how fast it may move the robot, and maintains ``state.drive``."""

    def __init__(
        self,
        state: LiveState,
        robot: RobotPort,
        scenario: Scenario,
        parent: QObject | None = None,
        *,
        publish: Callable[[Event], None],
        problem: ReportProblem,
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._robot = robot
        self._publish = publish
        self._problem = problem
        self._forward = self._left = self._turn = 0.0
        self._source: CommandSource = "none"
        self._actor: Actor = CONSOLE
        self._held = False
        self._drive_id = 0
        self._sent_target = Twist2D()
        self._renewed_ns = 0
        profile: RobotProfile | None = state.robot.value
        self._limits = profile.driving_limits if profile is not None else _ANY_SPEED
        self._frames_came = False
        self._guard_switched_off = False
        self._goals_limited_to_mps: float | None = None
        # While the speed is capped, the age in its reason keeps counting.
        self._aging = new_timer(self, self._on_condition_changed, _AGE_SHOWN_EVERY_MS)
        self._renewal = new_timer(self, self._renew, RENEW_EVERY_MS, precise=True)
        self.use_scenario(scenario)
        state.robot.changed.connect(self._on_robot_changed)
        state.link.changed.connect(self._on_condition_changed)
        state.scan.freshness_changed.connect(self._on_condition_changed)
        state.frame.freshness_changed.connect(self._on_condition_changed)

    def handlers(self) -> Handlers:
        return {
            intents.Drive: lambda intent: self.drive(
                forward=intent.forward, left=intent.left, turn=intent.turn, source=intent.source, actor=intent.actor
            ),
            intents.ReleaseDrive: lambda intent: self.let_go(intent.reason, intent.actor),
            intents.SetSpeed: lambda intent: self.set_speed_fraction(intent.fraction, intent.actor),
            intents.SetGuard: lambda intent: self.set_guard(on=intent.on, actor=intent.actor),
            intents.Stop: lambda intent: self._stop(intent.actor),
            intents.EmergencyStop: lambda intent: self._emergency_stop(intent.actor),
            intents.ReleaseEmergencyStop: lambda intent: self._release_emergency_stop(intent.actor),
        }

    def follows(self) -> Follows:
        events = (DriveEnded, EmergencyStopChanged, GuardChanged, MovementChanged, NavigationSpeedChanged)
        return dict.fromkeys(events, self.on_robot_event)

    def stop(self) -> None:
        self.release(QT_TR_NOOP("The console is closing"))

    def use_scenario(self, scenario: Scenario) -> None:
        self.release(QT_TR_NOOP("The scenario changed"))
        self._permitted = scenario.permissions.driving
        self._scenario_limits = scenario.driving
        if self._guard_switched_off:
            self.set_guard(on=True)
        self._apply_limits()
        self._on_condition_changed()

    def drive(self, *, forward: float, left: float, turn: float, source: CommandSource, actor: Actor = CONSOLE) -> None:
        """Drive; components of -1..1. Takes the lease, or updates its command."""
        if not (forward or left or turn):
            self.let_go("", actor)
            return
        self._forward, self._left, self._turn, self._source, self._actor = forward, left, turn, source, actor
        if not self._state.drive.value.allowed:
            self._held = False
            return
        if not self._held:
            self._drive_id += 1
        self._held = True
        self._send_target()
        self._renewal.start()

    def let_go(self, reason: str, actor: Actor) -> None:
        """Release by an actor. It does not end another actor's driving: that takes a stop."""
        if actor in (self._actor, WIZARD, CONSOLE):
            self.release(reason, actor)

    def release(self, reason: str = "", actor: Actor = CONSOLE) -> None:
        self._renewal.stop()
        if self._held:
            self._held = False
            self._robot.send(Release(clock.now_ns(), reason, actor))
        self._forward = self._left = self._turn = 0.0
        self._sent_target = Twist2D()
        self._show_target()

    def _stop(self, actor: Actor) -> None:
        self.halt(actor)
        self._publish(StopRequested(clock.now_ns(), actor))

    def _emergency_stop(self, actor: Actor) -> None:
        sent = self.set_emergency_stop(latched=True, actor=actor)
        self._publish(EmergencyStopChanged(clock.now_ns(), True, "wizard", actor))
        if not sent:
            self._problem(
                "error",
                tr("The emergency stop could not be sent to the robot."),
                tr("The console sends no drive commands. The robot stops automatically if it has a command timeout."),
                tr("Use the robot's own emergency stop button."),
                until="connected",
                cause="emergency_stop",
            )

    def _release_emergency_stop(self, actor: Actor) -> None:
        # The stop's owner reports whether it was released.
        if not self.set_emergency_stop(latched=False, actor=actor):
            self._publish(EmergencyStopChanged(clock.now_ns(), False, "wizard", actor))

    def halt(self, actor: Actor = CONSOLE) -> None:
        """Stop: zero velocity and cancel goals; sent even if nothing is held."""
        self.release(QT_TR_NOOP("Stop"), actor)
        self._robot.send(StopMotion(clock.now_ns(), actor))

    def set_emergency_stop(self, *, latched: bool, actor: Actor = CONSOLE) -> bool:
        """Latch or release the emergency stop. Latching works locally without a link; False if it could not be sent."""
        if latched:
            self.release(QT_TR_NOOP("Emergency stop"), actor)
        self._state.drive.update(emergency_stop=latched)
        sent = self._robot.send(SetEmergencyStop(clock.now_ns(), latched, actor))
        self._on_condition_changed()
        return sent

    def set_guard(self, *, on: bool, actor: Actor = CONSOLE) -> None:
        """Switch the link's obstacle guard. "Off" lasts until the link is lost or the scenario changes."""
        if self._robot.send(SetGuard(clock.now_ns(), on, actor)):
            self._guard_switched_off = not on

    def set_speed_fraction(self, fraction: float, actor: Actor = CONSOLE) -> None:
        fraction = min(1.0, max(0.1, fraction))
        self._state.drive.update(speed_fraction=fraction)
        self._limit_goals(actor)
        self._resend()

    def _limit_goals(self, actor: Actor = CONSOLE) -> None:
        """Apply the teleoperation speed limit to navigation too."""
        status = self._state.drive.value
        limit_mps = status.max_forward_mps * status.speed_fraction
        if self._state.link.value.state not in _LINKED or limit_mps == self._goals_limited_to_mps:
            return
        if self._robot.send(LimitGoals(clock.now_ns(), limit_mps, actor)):
            self._goals_limited_to_mps = limit_mps

    def on_robot_event(self, event: object) -> None:
        """Handle the end of a lease, a change of the guard, or the robot's emergency stop."""
        if isinstance(event, DriveEnded):
            if event.drive_id not in (0, self._drive_id):
                return  # of an earlier drive
            self._held = False
            self._renewal.stop()
            self._sent_target = Twist2D()
            self._show_target()
        elif isinstance(event, EmergencyStopChanged):
            self._state.drive.update(emergency_stop=event.latched)
            self._on_condition_changed()
        elif isinstance(event, NavigationSpeedChanged) and self._state.link.value.state in _LINKED:
            self._state.drive.update(goal_limit_mps=event.limit_mps)
        elif isinstance(event, MovementChanged) and self._state.link.value.state in _LINKED:
            self._state.drive.update(movement=event.state, stopped=event.stopped, velocity_publishers=event.publishers)
        elif isinstance(event, GuardChanged) and self._state.link.value.state in _LINKED:
            self._state.drive.update(guard=event.state, guard_distance_m=event.distance_m, guard_detail=event.detail)

    def _on_robot_changed(self, robot: RobotProfile | None) -> None:
        self.release(QT_TR_NOOP("Another robot is connected"))
        self._limits = robot.driving_limits if robot is not None else _ANY_SPEED
        self._frames_came = False
        self._apply_limits()
        self._on_condition_changed()

    def _apply_limits(self) -> None:
        forward_mps, turn_radps = self._scenario_limits.max_forward_mps, self._scenario_limits.max_turn_radps
        self._state.drive.update(
            max_forward_mps=min(forward_mps, self._limits.forward_mps),
            max_left_mps=min(forward_mps, self._limits.left_mps),
            max_turn_radps=min(turn_radps, self._limits.turn_radps),
        )
        self._limit_goals()

    def _on_condition_changed(self, _value: object = None) -> None:
        status = self._state.drive.value
        link = self._state.link.value
        reason = ""
        if not self._permitted:
            reason = QT_TR_NOOP("This scenario does not allow driving")
        elif status.emergency_stop:
            reason = QT_TR_NOOP("Emergency stop active")
        elif link.state == "trouble":
            reason = QT_TR_NOOP("The robot does not respond")
        elif link.state != "connected":
            reason = QT_TR_NOOP("Not connected to the robot")
        robot: RobotProfile | None = self._state.robot.value
        self._frames_came = self._frames_came or self._state.frame.freshness == "fresh"
        cap_reason = ""
        # Without a LIDAR or camera nothing can be stale (unless this computer's camera provides the video).
        if self._state.scan.freshness != "fresh" and (robot is None or robot.scan is not None):
            cap_reason = _missing(QT_TR_NOOP("LIDAR"), self._state.scan)
        elif self._state.frame.freshness != "fresh" and (robot is None or robot.cameras or self._frames_came):
            cap_reason = _missing(QT_TR_NOOP("video"), self._state.frame)
        if cap_reason and not reason:
            if not self._aging.isActive():
                self._aging.start()
        else:
            self._aging.stop()
        if link.state not in _LINKED:
            # Each connection starts with the guard setting of the profile.
            self._guard_switched_off = False
            status = replace(status, guard="absent", guard_distance_m=None, guard_detail="", goal_limit_mps=None)
            status = replace(status, movement="unknown", stopped=False, velocity_publishers=())
            self._goals_limited_to_mps = None
        self._state.drive.set(
            replace(
                status,
                allowed=not reason,
                reason=reason,
                cap_reason="" if reason else cap_reason,
                cap_fraction=STALE_CAP_FRACTION if cap_reason else 1.0,
            )
        )
        self._limit_goals()
        if reason:
            self.release(reason)
        else:
            self._resend()

    def _target(self) -> Twist2D:
        status = self._state.drive.value
        scale = status.speed_fraction * status.cap_fraction
        along_mps = status.max_forward_mps
        if self._forward < 0.0:
            along_mps = min(self._scenario_limits.max_forward_mps, self._limits.backward_mps)
        return Twist2D(
            forward_mps=self._forward * along_mps * scale,
            left_mps=self._left * status.max_left_mps * scale,
            turn_radps=self._turn * status.max_turn_radps * scale,
        )

    def _send_target(self) -> None:
        target = self._target()
        now_ns = clock.now_ns()
        if self._robot.send(Drive(now_ns, target, self._source, self._actor, self._drive_id)):
            self._sent_target, self._renewed_ns = target, now_ns
        else:
            self._held = False
            self._renewal.stop()
        self._show_target()

    def _resend(self) -> None:
        if self._held and self._target() != self._sent_target and self._lease_is_alive():
            self._send_target()

    def renew_before_work(self) -> None:
        """Renew the lease now if slow work follows.

        Painting precedes timers: otherwise a renewal could be late by a timer period plus a whole pass.
        """
        if self._renewal.isActive() and clock.now_ns() - self._renewed_ns >= _WORTH_RENEWING_NS:
            self._renew()

    def _renew(self) -> None:
        if not self._lease_is_alive():
            return
        now_ns = clock.now_ns()
        if self._robot.send(RenewLease(now_ns)):
            self._renewed_ns = now_ns
        else:
            self.release(QT_TR_NOOP("The connection does not accept commands"))

    def _lease_is_alive(self) -> bool:
        """After a stall the lease has expired at the link: only a new key press may drive again."""
        if clock.now_ns() - self._renewed_ns <= LEASE_NS:
            return True
        self.release(QT_TR_NOOP("The program stalled"))
        return False

    def _show_target(self) -> None:
        self._state.drive.update(
            target_forward_mps=self._sent_target.forward_mps,
            target_left_mps=self._sent_target.left_mps,
            target_turn_radps=self._sent_target.turn_radps,
            driver=self._actor if self._held else "",
        )


def _missing(stream_name: str, stream: LiveStream) -> str:
    age_s = stream.age_s()
    if age_s is None:
        never = QT_TR_NOOP("no fresh {stream}") if stream.arrivals else QT_TR_NOOP("no {stream} yet")
        return localized(never, stream=stream_name)
    late = stream.arrives_late
    seconds = age_s if late else stream.silent_s() or 0.0
    age = f"{seconds:.1f}" if seconds < 10.0 else f"{seconds:.0f}"
    template = QT_TR_NOOP("{stream} delayed by {age} s") if late else QT_TR_NOOP("no fresh {stream} for {age} s")
    return localized(template, stream=stream_name, age=age)


# Head service: input to joint targets within the neck's limits. GUI thread.

MOVE_EVERY_MS = 50
# A stalled GUI must not lead to one large motion.
_LONGEST_STEP_S = 0.1
_NOD_RAD, _NOD_MS = 0.25, 450


class HeadService(Service):
    """Maintains ``state.look``, and sends MoveHead at 20 Hz while input is held. The link reports the commanded
    angles.

    The head stops on release, under the emergency stop, without a link, and when the GUI stalls: each target is one
    step ahead, never the end of the range.
    """

    def __init__(self, state: LiveState, robot: RobotPort, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._state = state
        self._robot = robot
        self._head: HeadInterface | None = None
        self._pan = self._tilt = 0.0
        self._actor: Actor = CONSOLE
        self._stepped_ns = 0
        self._moving = new_timer(self, self._step, MOVE_EVERY_MS, precise=True)
        self._nodded_from = (0.0, 0.0)
        self._nodding = new_timer(self, self._end_nod, _NOD_MS, single_shot=True)
        self._on_robot_changed(state.robot.value)
        state.robot.changed.connect(self._on_robot_changed)
        state.link.changed.connect(self._on_condition_changed)
        state.drive.changed.connect(self._on_condition_changed)

    def handlers(self) -> Handlers:
        return {
            intents.LookAt: lambda intent: self.turn_to(
                pan_rad=intent.pan_rad, tilt_rad=intent.tilt_rad, actor=intent.actor
            ),
            intents.TurnHead: lambda intent: self.turn_head(pan=intent.pan, tilt=intent.tilt, actor=intent.actor),
            intents.Nod: lambda intent: self.nod(intent.actor),
        }

    def use_scenario(self, scenario: Scenario) -> None:
        if not scenario.permissions.driving:
            self.release()

    def stop(self) -> None:
        self._nodding.stop()
        self.release()

    def turn_to(self, *, pan_rad: float, tilt_rad: float, actor: Actor = CONSOLE) -> None:
        """Turn the head to these angles, clamped to its range; ends a held turn."""
        self._moving.stop()
        self._nodding.stop()
        self._pan = self._tilt = 0.0
        if self._may_move():
            self._actor = actor
            self._move_to(pan_rad, tilt_rad)

    def turn_head(self, *, pan: float, tilt: float, actor: Actor = CONSOLE) -> None:
        """Turn at -1..1 of the head's speed, pan left and tilt down positive; zero stops. Call on each change."""
        was_turning = self._moving.isActive()
        self._pan, self._tilt = _unit(pan), _unit(tilt)
        if not (self._pan or self._tilt):
            self._end_turn()
        elif self._may_move():
            self._nodding.stop()
            self._actor = actor
            if not was_turning:
                self._take_measured_angles()
                self._stepped_ns = clock.now_ns() - MOVE_EVERY_MS * 1_000_000
                self._moving.start()
                self._step()
        else:
            self._end_turn()

    def nod(self, actor: Actor = CONSOLE) -> None:
        """Nod down and back; any other head command ends it."""
        if self._moving.isActive() or self._nodding.isActive() or not self._may_move():
            return
        self._take_measured_angles()
        head = self._state.look.value
        self._actor = actor
        self._nodded_from = head.pan_rad, head.tilt_rad
        if self._move_to(head.pan_rad, head.tilt_rad + _NOD_RAD):
            self._nodding.start()

    def _end_nod(self) -> None:
        pan_rad, tilt_rad = self._nodded_from
        if self._may_move():
            self._move_to(pan_rad, tilt_rad)

    def release(self) -> None:
        """Stop turning: the head keeps its target."""
        self.turn_head(pan=0.0, tilt=0.0)

    def _on_robot_changed(self, robot: RobotProfile | None) -> None:
        self._end_turn()
        self._head = robot.head if robot is not None else None
        self._state.look.set(HeadStatus(present=self._head is not None))

    def _on_condition_changed(self, _value: object = None) -> None:
        if self._moving.isActive() and not self._may_move():
            self._end_turn()

    def _may_move(self) -> bool:
        return (
            self._head is not None
            and self._state.link.value.state == "connected"
            and not self._state.drive.value.emergency_stop
        )

    def _take_measured_angles(self) -> None:
        """Start from the measured angles: something else may have turned the head."""
        if self._state.head.freshness == "fresh":
            measured = self._state.head.value
            self._state.look.update(pan_rad=measured.pan_rad, tilt_rad=measured.tilt_rad)

    def _step(self) -> None:
        head = self._head
        if head is None:
            return
        now_ns = clock.now_ns()
        stretch_rad = head.speed_radps * min((now_ns - self._stepped_ns) / 1e9, _LONGEST_STEP_S)
        self._stepped_ns = now_ns
        commanded = self._state.look.value
        if not self._move_to(
            commanded.pan_rad + self._pan * stretch_rad, commanded.tilt_rad + self._tilt * stretch_rad
        ):
            self._end_turn()

    def _move_to(self, pan_rad: float, tilt_rad: float) -> bool:
        head = self._head
        if head is None:
            return False
        pan_rad = min(max(pan_rad, head.pan_range_rad[0]), head.pan_range_rad[1])
        tilt_rad = min(max(tilt_rad, head.tilt_range_rad[0]), head.tilt_range_rad[1])
        if not self._robot.send(MoveHead(clock.now_ns(), pan_rad, tilt_rad, self._actor)):
            return False
        self._state.look.update(pan_rad=pan_rad, tilt_rad=tilt_rad)
        return True

    def _end_turn(self) -> None:
        self._pan = self._tilt = 0.0
        self._moving.stop()


def _unit(value: float) -> float:
    return min(max(value, -1.0), 1.0)
