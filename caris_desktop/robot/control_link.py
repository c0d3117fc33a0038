"""Control link: motion, navigation, speech, emergency stop and small sensor streams."""

import asyncio
import itertools
import logging
import math
from dataclasses import replace
from typing import Any

from caris_desktop.domain import link_commands
from caris_desktop.domain.actor import CONSOLE, Actor, cancelled_by, in_words
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import (
    ANSWER,
    CommandSent,
    CommandSource,
    DriveEnded,
    GoalChanged,
    MovementChanged,
    Problem,
)
from caris_desktop.domain.geometry import ZERO_TWIST, Twist2D
from caris_desktop.domain.sensing import LaserScan, Odometry, RobotPose
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.robot.control_interfaces import RobotControls
from caris_desktop.robot.emergency_stop import EmergencyStop
from caris_desktop.robot.guard import GuardChangeDetector, GuardLimit, ObstacleGuard
from caris_desktop.robot.handled_operations import HANDLED_TOPIC, HandledOperations
from caris_desktop.robot.head_control import RobotHead
from caris_desktop.robot.lease import EXPIRY_S, ZERO_REPEAT_S, LeasedTwist, MotionLease
from caris_desktop.robot.link_context import LinkContext
from caris_desktop.robot.link_process import GOODBYE_S, ConsoleSender
from caris_desktop.robot.maps import RobotMaps
from caris_desktop.robot.movement_check import MovementCheck
from caris_desktop.robot.navigation_client import NavigationSpeed, Navigator
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.robot.robot_checks import list_inventory, missing_from, nothing_is_missing, problem_of_missing
from caris_desktop.robot.robot_speech import robot_voice
from caris_desktop.robot.sensors import Sensors
from caris_desktop.robot.transport import LinkObserver, RosbridgeTopic, ServiceCallError
from caris_desktop.robot.unread import UnreadCommands
from caris_desktop.ros.message_conversion import decode_twist, decode_twist_stamped, encode_twist, encode_twist_stamped
from caris_desktop.ros.message_fields import MessageError

logger = logging.getLogger(__name__)

# A newly started rosbridge reaches the base only after DDS discovery, 2.5 s after it has accepted the first zeros
# (measured with Fast DDS), later on a busy computer; its odometry arrives from then on.
ZERO_AGAIN_S = (1.0, 2.0)
# Ten per second while the odometry shows motion or has not arrived yet, so that the base gets one as soon as it can be
# reached. More while nothing moves would conflict with navigation.
ZERO_WHILE_MOVING_S = tuple(tenth / 10 for tenth in range(6, 31))
# Afterwards one per second, unless the odometry shows that the robot stands.
ZERO_UNLESS_STILL_S = tuple(map(float, range(3, 11)))
_STILL_BELOW_MPS, _STILL_BELOW_RADPS = 0.01, 0.02
_ODOMETRY_COUNTS_S = 1.0
OLDEST_DRIVE_S = 0.25
"""No older command moves the robot, even if the console went on holding the lease."""
GUARD_WATCHED_EVERY_S = 0.25
HANDLING_WATCHED_EVERY_S = 0.1
NOT_HANDLED = QT_TR_NOOP("its rosbridge receives commands but does not execute them")
INVENTORY_AGAIN_S = (3.0, 5.0, 10.0, 20.0, 30.0)
"""Pauses before a robot that lacks something is asked again: nodes start one after another."""


class ControlLink(LinkObserver):
    """Everything that must not wait for images. Lives on one asyncio loop; a ``link_process.Link``."""

    def __init__(
        self, profile: RobotProfile, address: str, outbox: ConsoleSender, *, follows_crash: bool = False
    ) -> None:
        self._profile = profile
        # Goals of the previous process, of navigation and of controls.
        self._goals_left = self._control_goals_left = follows_crash
        self._loop = asyncio.get_running_loop()
        self._put = outbox.put
        sources = {"scan": profile.scan, "odometry": profile.odometry}
        streams = {source.topic: stream for stream, source in sources.items() if source is not None}
        self._link = LinkContext("control", profile, address, outbox, self, streams=streams)
        self._report, self._ros, self._measurement = self._link.report, self._link.ros, self._link.measurement
        self._guard = ObstacleGuard(profile)
        self._guard_news = GuardChangeDetector()
        self._movement = MovementCheck(profile)
        self._reported_movement = MovementChanged(0, "unknown")
        # From Stop until the robot is stationary, or is driven from here again.
        self._stopping = False
        self._stop_ns = 0
        self._lease = MotionLease(profile.driving_limits, rate_hz=profile.command_rate_hz, allow=self._allow)
        self._unread = UnreadCommands(rate_hz=profile.command_rate_hz)
        # The last velocity on this connection.
        self._commanded = ZERO_TWIST
        self._zeros_again: list[asyncio.TimerHandle] = []
        # Last holder of the lease, who stopped, and who switched the guard.
        self._driver: Actor = CONSOLE
        self._drive_id = 0
        self._stopper: Actor = CONSOLE
        self._guard_switcher: Actor = CONSOLE
        self._odometry: Odometry | None = None
        self._odometry_before_connect: Odometry | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._sequence = 0
        self._connected = False
        self._silent = False
        self._drives_count_from_ns = 0
        self._reported_missing: list[str] = []
        self._reported_unproven = False
        self._looking_around: asyncio.Task[None] | None = None
        self._closing = False
        velocity_type = f"geometry_msgs/{profile.velocity.type}"
        self._velocity = RosbridgeTopic(self._ros, profile.velocity.topic, velocity_type, queue_size=1, motion=True)
        self._velocity.advertise()
        # Receives other publishers' velocities, and our own echoes.
        self._velocities = RosbridgeTopic(
            self._ros, profile.velocity.topic, velocity_type, queue_length=20, every_message=True
        )
        self._velocities.subscribe(self._on_velocity)
        self._ros.factory.on_connect_send(profile.velocity.topic, self._send_on_connect)
        self._ros.factory.motion_round_trip = self._motion_round_trip
        self._handled = HandledOperations(self._ros, handled=self._commands_answered)
        self._navigator = Navigator(self._link, emit=self._goal_changed, unconfirmed=self._report_unconfirmed_cancel)
        self._goal_speed = NavigationSpeed(self._link)
        self._voice = robot_voice(self._ros, profile.speech, emit=self._put)
        self._head = RobotHead(self._link)
        self._controls = RobotControls(self._link)
        self._maps = RobotMaps(self._link, pose=lambda: self._sensors.pose_in_map)
        self._emergency_stop = EmergencyStop(
            self._ros,
            self._ros.dialect,
            profile.emergency_stop,
            self,
            self._link.watched,
            emit=self._put,
            in_background=self._link.in_background,
        )
        self._sensors = Sensors(
            self._link, on_scan=self._process_scan, on_odometry=self._process_odometry, on_pose=self._process_pose
        )

    def start(self) -> None:
        self._link.start()
        self._link.in_background(self._watch_guard())
        self._link.in_background(self._watch_handling())

    def process_commands(self, received: list[link_commands.RobotCommand]) -> None:
        """Execute commands in order, then send what is due: one Twist per batch, within this call."""
        held_by = [c.stamp_ns for c in received if isinstance(c, (link_commands.Drive, link_commands.RenewLease))]
        newest_s = min(max(held_by, default=0) / 1e9, self._loop.time())
        for command in received:
            try:
                self._obey(command, newest_s)
            except Exception:
                # A single failed command must not stop the lease.
                logger.exception("The command %r failed", command)
        self._move()

    async def finish(self) -> None:
        """Stop the robot and disconnect."""
        moving = self._lease.held or self._lease.due_s() < self._loop.time() + 1.0 or self._navigator.has_goal
        self._controls.cancel_goals(QT_TR_NOOP("the console closed"))
        if self._connected and moving:
            self._navigator.cancel_all(QT_TR_NOOP("the console closed"), CONSOLE)
            self._stopper = CONSOLE
            self._lease.stop(self._loop.time())
            self._move()
            # The timer keeps sending zeros meanwhile.
            await asyncio.sleep(ZERO_REPEAT_S)
        await self._goal_speed.restore()
        self._closing = True
        self._forget_zeros()
        self._link.watched.link_lost()
        self._controls.close()
        self._emergency_stop.close()
        await self._voice.close()
        self._link.cancel()
        await self._ros.aclose(GOODBYE_S)
        self._report.changed("closed")

    # Commands

    def _obey(self, command: link_commands.RobotCommand, newest_s: float) -> None:
        """``newest_s`` is the newest known time at which the console held the lease."""
        now_s = self._loop.time()
        # A stamp from the future would extend a lease.
        given_s = min(command.stamp_ns / 1e9, now_s)
        match command:
            case link_commands.Drive():
                self._drive(command, given_s, now_s - newest_s)
            case link_commands.RenewLease():
                self._lease.renew(given_s)
            case link_commands.Release():
                self._driver = command.actor
                self._lease.release(now_s)
            case link_commands.StopMotion():
                self._stopper = command.actor
                self._lease.stop(now_s)
                self._send_zero_first()
                self._stopping = True
                self._stop_ns = now_ns()
                self._movement.stopped()
                reason = localized(QT_TR_NOOP("stopped by {who}"), who=localized(in_words(command.actor)))
                self._navigator.cancel_all(reason, command.actor)
                self._controls.cancel_goals(reason)
            case link_commands.SetEmergencyStop():
                self._emergency_stop.set(command)
            case link_commands.SetGuard(on=on):
                self._guard_switcher = command.actor
                self._guard.switch(on=on)
                self._lease.reconsider(now_s)
                if not self._lease.held:
                    self._report_guard(self._guard.limit(ZERO_TWIST, now_s), now_s)
            case link_commands.GoTo():
                self._go_to(command)
            case link_commands.LimitGoals():
                self._goal_speed.limit(command)
            case link_commands.CancelGoal():
                self._navigator.cancel(cancelled_by(command.actor), command.actor)
            case link_commands.SetInitialPose():
                self._refused(QT_TR_NOOP("The robot's pose was not set"), self._maps.set_initial_pose(command))
            case link_commands.RequestMap():
                self._maps.request(command)
            case link_commands.MoveHead():
                self._refused(QT_TR_NOOP("The head was not turned"), self._head.move(command))
            case link_commands.OfferControls(controls=controls, driving_permitted=driving_permitted):
                self._controls.offer(controls, driving_permitted=driving_permitted)
                if self._control_goals_left and self._connected:
                    self._control_goals_left = False
                    self._controls.cancel_left_goals()
            case link_commands.UseControl():
                self._controls.use(command)
                if self._controls.may_move(command.control):
                    self._movement.control_used(now_s)
            case link_commands.Say():
                self._voice.say(command)
            case link_commands.Silence():
                if not self._voice.silence(command.actor) and self._connected:
                    self._report.problems.count(
                        "silence", severity="info", cause=ANSWER,
                        what=QT_TR_NOOP("The robot's voice cannot be interrupted."),
                        meaning=QT_TR_NOOP("It finishes its sentence."),
                        advice=QT_TR_NOOP(
                            "If the robot has a stop topic, enter it under 'speech' in the robot "
                            "profile."),
                    )  # fmt: skip
            case link_commands.ListenToRobot() | link_commands.PlayOnRobot() | link_commands.CloseLink():
                pass

    def _refused(self, what: str, refusal: str) -> None:
        if refusal:
            self._report.problems.count(
                what, severity="warning", cause=ANSWER,
                what=localized("{what}: {refusal}.", what=localized(what), refusal=localized(refusal)),
                meaning=QT_TR_NOOP("Nothing was sent to the robot."),
                advice=QT_TR_NOOP("Try again when that has changed.")
                if self._connected
                else QT_TR_NOOP("Try again when the robot is connected again."),
            )  # fmt: skip

    def _drive(self, command: link_commands.Drive, given_s: float, age_s: float) -> None:
        refusal = self._drive_refusal(command, age_s)
        if refusal:
            self._lease.end(self._loop.time())
            if self._lease.latched:
                # A motion request during the emergency stop: send zero once more.
                self._lease.drive(command.target, command.source, self._loop.time())
            self._put(DriveEnded(now_ns(), refusal, CONSOLE, command.drive_id))
            return
        self._driver, self._drive_id = command.actor, command.drive_id
        self._stopping = False
        if command.target.moving:
            # Manual driving cancels navigation.
            who = localized(in_words(command.actor))
            self._navigator.cancel(localized(QT_TR_NOOP("{who} is driving"), who=who), command.actor)
        self._lease.drive(command.target, command.source, given_s)

    def _motion_refusal(self) -> str:
        if not self._connected:
            return QT_TR_NOOP("The robot is not connected")
        if self._lease.latched:
            return QT_TR_NOOP("The emergency stop is active")
        if self._silent:
            return QT_TR_NOOP("The link to the robot is interrupted")
        return ""

    def _drive_refusal(self, command: link_commands.Drive, age_s: float) -> str:
        refusal = self._motion_refusal()
        if refusal:
            return refusal
        if command.stamp_ns < self._drives_count_from_ns:
            return QT_TR_NOOP("The link was lost in the meantime; press the key again")
        if age_s > EXPIRY_S or self._is_too_late(command):
            return QT_TR_NOOP("The command arrived too late; press the key again")
        return ""

    def _is_too_late(self, command: link_commands.Drive | link_commands.GoTo) -> bool:
        return command.stamp_ns < self._drives_count_from_ns or (now_ns() - command.stamp_ns) / 1e9 > OLDEST_DRIVE_S

    def _go_to(self, command: link_commands.GoTo) -> None:
        refusal = self._motion_refusal()
        if not refusal and self._is_too_late(command):
            refusal = QT_TR_NOOP("The command arrived too late; send it again")
        if refusal:
            self._navigator.refuse(command, refusal)
            return
        if self._lease.end(self._loop.time()):
            self._put(DriveEnded(now_ns(), QT_TR_NOOP("The robot is navigating"), command.actor, self._drive_id))
        self._stopping = False
        # First, so that it applies from the start; overrides speeds set by others.
        self._goal_speed.apply()
        self._navigator.go(command)

    # Motion

    def _move(self) -> None:
        """Send all due velocities, and schedule the next call."""
        while (leased := self._lease.next_twist(self._loop.time())) is not None:
            self._pass_on(leased)
        if self._commanded.moving and self._unread.late(self._loop.time()):
            # If it was suspended, this is the last message that it reads on waking up.
            self._send_twist(ZERO_TWIST, "lease")
            self._lease.set_sent(ZERO_TWIST)
        if self._lease.pop_expired():
            reason = QT_TR_NOOP("The console stopped responding for a moment")
            self._put(DriveEnded(now_ns(), reason, CONSOLE, self._drive_id))
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        due_s = self._lease.due_s()
        if self._commanded.moving:
            due_s = min(due_s, self._unread.late_from_s())
        if due_s != float("inf"):
            self._timer = self._loop.call_at(due_s, self._move)

    def _pass_on(self, leased: LeasedTwist) -> None:
        """Send a due velocity, unless it would only queue behind others that the robot has not read."""
        full = self._unread.full(self._loop.time())
        if leased.twist.moving and self._ros.unsent_bytes > 0:
            # What the network does not accept now would arrive late.
            self._end_drive(QT_TR_NOOP("The commands cannot be sent over the network"))
        elif full and leased.twist.moving:
            self._lease.set_sent(self._commanded)
        elif not full or self._commanded.moving:
            # The first zero is always sent; more would queue up like velocities.
            self._send_twist(leased.twist, leased.source)

    def _send_on_connect(self) -> None:
        """First messages on a connection: the previous driver may have died while driving."""
        self._odometry_before_connect = self._odometry
        if not self._unread.acknowledged:
            self._stop_motion()
            for delay_s in ZERO_AGAIN_S:
                self._zeros_again.append(self._loop.call_later(delay_s, self._repeat_zero))
            for delay_s in ZERO_WHILE_MOVING_S:
                self._zeros_again.append(self._loop.call_later(delay_s, self._repeat_zero_while_moving))
            for delay_s in ZERO_UNLESS_STILL_S:
                self._zeros_again.append(self._loop.call_later(delay_s, self._repeat_zero_unless_still))

    def _stop_motion(self) -> None:
        """Send zero, unless the robot is known to have read one after our last velocity.

        For half a second: more would conflict with navigation.
        """
        if not self._unread.acknowledged:
            self._lease.stop(self._loop.time(), "lease")
            self._move()

    def _repeat_zero(self) -> None:
        if not self._lease.held and not self._navigator.has_goal and not self._unread.full(self._loop.time()):
            self._send_twist(ZERO_TWIST, "lease")

    def _repeat_zero_while_moving(self) -> None:
        arrived = self._profile.odometry is None or self._odometry is not self._odometry_before_connect
        if self._moves() or not arrived:
            self._repeat_zero()

    def _repeat_zero_unless_still(self) -> None:
        if self._moves() is not False:
            self._repeat_zero()

    def _moves(self) -> bool | None:
        """Whether the odometry shows motion; None without a recent one."""
        last = self._odometry
        if last is None or now_ns() - last.stamp_ns >= _ODOMETRY_COUNTS_S * 1e9:
            return None
        speed_mps = math.hypot(last.twist.forward_mps, last.twist.left_mps)
        return speed_mps > _STILL_BELOW_MPS or abs(last.twist.turn_radps) > _STILL_BELOW_RADPS

    def _send_zero_first(self) -> None:
        if self._connected:
            self._move()
        else:
            # Nothing may be sent after a reconnection.
            self._lease.forget()

    def _send_twist(self, twist: Twist2D, source: CommandSource) -> None:
        velocity = self._profile.velocity
        if velocity.type == "TwistStamped":
            # Robot time as far as known; zero means unstamped.
            at_ns = now_ns()
            offset = self._measurement.offset_at(at_ns)
            stamp_ns = 0 if offset is None else at_ns + offset.offset_ns
            message = encode_twist_stamped(self._ros.dialect, twist, stamp_ns=stamp_ns, frame_id=velocity.frame_id)
        else:
            message = encode_twist(twist)
        self._commanded = twist
        if self._velocity.publish(message):
            self._unread.sent(self._loop.time(), moving=twist.moving)
            self._handled.request()
            self._guard.note_sent(twist, self._loop.time())
            self._movement.sent(twist, self._loop.time())
            self._sequence += 1
            self._put(CommandSent(now_ns(), self._sequence, twist, source, self._actor_of(source)))

    def _actor_of(self, source: CommandSource) -> Actor:
        """Actor of a velocity; those of the lease alone are the console's."""
        return self._stopper if source == "stop" else CONSOLE if source == "lease" else self._driver

    def _forget_zeros(self) -> None:
        for timer in self._zeros_again:
            timer.cancel()
        self._zeros_again.clear()

    def _commands_answered(self, round_trip_s: float) -> None:
        self._unread.answered(round_trip_s, self._loop.time())

    async def _watch_handling(self) -> None:
        """Detect unhandled messages at the robot, also while nothing moves."""
        while True:
            await asyncio.sleep(HANDLING_WATCHED_EVERY_S)
            if not self._connected:
                continue
            self._handled.request_periodically()
            if self._handled.stuck():
                self._put(
                    Problem(
                        now_ns(),
                        "error",
                        QT_TR_NOOP(
                            "The robot's rosbridge receives commands from this console but does not execute them."
                        ),
                        QT_TR_NOOP(
                            "Stop and drive commands did not reach the robot, so it may be moving. The "
                            "console reconnects and first sends zero velocity and a cancel."
                        ),
                        QT_TR_NOOP("Watch the robot; use its own emergency stop if it moves."),
                        cause="not_handled",
                    )
                )
                self._ros.factory.reconnect(NOT_HANDLED)
            elif self._handled.unproven and not self._reported_unproven:
                self._reported_unproven = True
                self._put(
                    Problem(
                        now_ns(),
                        "warning",
                        QT_TR_NOOP("The robot's rosbridge does not show whether it executes commands."),
                        QT_TR_NOOP("If commands are delayed at the robot, this console detects it late or not at all."),
                        localized(
                            QT_TR_NOOP("If rosbridge restricts topics (topics_glob), allow {topic} as well."),
                            topic=HANDLED_TOPIC,
                        ),
                        cause="handling_unproven",
                    )
                )

    def _end_drive(self, reason: str) -> None:
        if self._lease.end(self._loop.time()):
            self._put(DriveEnded(now_ns(), reason, CONSOLE, self._drive_id))

    # The obstacle guard

    def _allow(self, twist: Twist2D, now_s: float) -> float:
        """Fraction of a velocity that may be sent."""
        try:
            limit = self._guard.limit(twist, now_s)
        except Exception:
            # A failing guard must not stop the lease, and nothing is driven unchecked.
            logger.exception("The obstacle guard failed on %r", twist)
            limit = GuardLimit(0.0, "blocked", detail=QT_TR_NOOP("the obstacle guard failed; see the log for details"))
        self._report_guard(limit, now_s)
        return limit.fraction

    def _report_guard(self, limit: GuardLimit, now_s: float) -> None:
        news = self._guard_news.of(limit, now_s, stamp_ns=now_ns()) if self._connected else None
        if news is not None:
            self._put(replace(news, actor=self._guard_switcher))
            if news.state != "overridden":
                self._guard_switcher = CONSOLE

    async def _watch_guard(self) -> None:
        """Report the state also without driving and without scans."""
        while True:
            await asyncio.sleep(GUARD_WATCHED_EVERY_S)
            self._check_movement()
            if self._connected and not self._lease.held:
                now_s = self._loop.time()
                self._report_guard(self._guard.limit(ZERO_TWIST, now_s), now_s)

    # Supervision of the actual motion

    def _check_movement(self) -> None:
        if not self._connected:
            return
        now_s, movement = self._loop.time(), self._movement
        if self._navigator.has_goal:
            movement.moves_by_itself(now_s)
        state = movement.state(now_s)
        if state == "standing" and (self._odometry is None or self._odometry.stamp_ns > self._stop_ns):
            self._stopping = False
        stopped = self._stopping or self._lease.latched
        reported = self._reported_movement
        if (state, stopped) != (reported.state, reported.stopped):
            self._report_movement(MovementChanged(now_ns(), state, stopped, reported.publishers))
            if state in ("uncommanded", "commanded_elsewhere") and reported.state != state:
                self._link.in_background(self._find_publishers())
        if stopped and state in ("uncommanded", "commanded_elsewhere") and self._lease.due_s() == math.inf:
            # Against another publisher: zero while it lasts.
            self._lease.stop(now_s, "stop")
            self._move()

    def _report_movement(self, movement: MovementChanged) -> None:
        self._reported_movement = movement
        self._put(movement)

    async def _find_publishers(self) -> None:
        try:
            names = await self._ros.nodes("publishers", self._profile.velocity.topic)
        except ServiceCallError as error:
            logger.info("Who publishes velocities is not known: %s", error)
            return
        found = tuple(sorted(names))
        if self._connected and found != self._reported_movement.publishers:
            self._report_movement(replace(self._reported_movement, stamp_ns=now_ns(), publishers=found[:10]))

    def _on_velocity(self, message: Any) -> None:
        stamped = self._profile.velocity.type == "TwistStamped"
        try:
            twist = decode_twist_stamped(message)[0] if stamped else decode_twist(message)
        except MessageError:
            return  # refused by the base, too
        self._movement.commanded(twist, self._loop.time())
        if self._lease.latched or self._stopping:
            self._check_movement()

    # Stoppable parts of the emergency stop

    def set_emergency_stop(self, held: bool, actor: Actor) -> None:
        self._lease.emergency(held, self._loop.time())
        self._movement.stopped()
        if held:
            self._stopper = actor
            self._send_zero_first()
        self._head.set_emergency_stop(held)
        self._controls.set_emergency_stop(held)

    def cancel_goals(self, reason: str, actor: Actor) -> None:
        self._navigator.cancel_all(reason, actor)

    # The connection

    def link_connected(self) -> None:
        self._connected = True
        self._silent = False
        self._drives_count_from_ns = now_ns()
        self._report.changed("connected")
        self._guard.forget()
        self._guard_news.forget()
        self._movement.forget(self._loop.time())
        self._stopping = False
        self._report_movement(MovementChanged(now_ns(), "unknown", self._lease.latched))
        self._guard_switcher = CONSOLE
        self._report_guard(self._guard.limit(ZERO_TWIST, self._loop.time()), self._loop.time())
        self._handled.link_connected()
        self._goal_speed.link_connected()
        self._navigator.link_connected()
        if self._goals_left:
            self._goals_left = False
            self._navigator.cancel_left_goal()
        self._voice.link_connected()
        self._emergency_stop.link_connected()
        self._link.watched.link_connected()
        self._controls.link_connected()
        self._looking_around = self._link.begin(self._explore_robot())

    def link_silent(self) -> None:
        self._silent = True
        if self._lease.due_s() < float("inf"):
            # One zero was or is sent after the last velocity; it is repeated when the robot responds again.
            self._end_drive(QT_TR_NOOP("No response from the robot for a moment"))
            self._move()
            self._lease.forget()
        self._report.changed("trouble", QT_TR_NOOP("No response from the robot for a moment"))

    def link_recovered(self) -> None:
        self._silent = False
        self._drives_count_from_ns = now_ns()
        self._stop_motion()
        self._report.changed("connected")
        self._maps.link_recovered()

    def link_lost(self, reason: str) -> None:
        self._connected = False
        self._silent = False
        if self._looking_around is not None:
            self._looking_around.cancel()
        self._commanded = ZERO_TWIST
        self._unread.forget()
        self._handled.link_lost()
        self._forget_zeros()
        if self._lease.held:
            self._put(DriveEnded(now_ns(), QT_TR_NOOP("The link to the robot was lost"), CONSOLE, self._drive_id))
        self._lease.forget()
        self._navigator.link_lost()
        self._emergency_stop.link_lost()
        self._goal_speed.link_lost()
        self._voice.link_lost()
        self._head.link_lost()
        self._controls.link_lost()
        self._maps.link_lost()
        self._link.watched.link_lost()
        self._sensors.link_lost()
        self._measurement.link_lost()
        if not self._closing:
            lost = QT_TR_NOOP("The link to the robot was lost: {reason}")
            self._report.changed("lost", localized(lost, reason=reason))

    def link_unreachable(self, what: str, advice: str) -> None:
        self._report.unreachable(what, advice)

    def link_round_trip(self, round_trip_s: float) -> None:
        self._measurement.add_round_trip(round_trip_s)
        self._guard.add_round_trip(round_trip_s)

    def _motion_round_trip(self, round_trip_s: float) -> None:
        self._guard.add_round_trip(round_trip_s)
        self._handled.read(round_trip_s)
        self._unread.read(round_trip_s, self._loop.time())
        if not self._handled.counts:
            self._commands_answered(round_trip_s)

    def link_refused(self, detail: str) -> None:
        self._report.refused(detail)

    # Sensor data

    def _process_scan(self, scan: LaserScan, delay_s: float) -> None:
        """Process a scan before the console gets it, and apply new restrictions at once."""
        self._guard.add_scan(scan, delay_s=delay_s)
        self._lease.reconsider(self._loop.time())
        self._move()

    def _process_odometry(self, odometry: Odometry) -> None:
        self._odometry = odometry
        self._guard.add_odometry(odometry)
        self._movement.add_odometry(odometry)
        self._check_movement()

    def _process_pose(self, pose: RobotPose) -> None:
        self._navigator.robot_moved(pose.pose_in_map)

    def _goal_changed(self, goal: GoalChanged) -> None:
        self._put(goal)
        if goal.state in ("reached", "cancelled", "failed"):
            self._sensors.clear_path()

    async def _explore_robot(self) -> None:
        """Take the robot's inventory and report missing parts of the profile; repeat while something is missing."""
        for pause_s in itertools.chain(INVENTORY_AGAIN_S, itertools.repeat(INVENTORY_AGAIN_S[-1])):
            try:
                inventory = await list_inventory(self._ros)
            except ServiceCallError as error:
                logger.info("The robot's inventory is not known: %s", error)
                self._maps.on_inventory(None)
            else:
                self._emergency_stop.on_inventory(inventory)
                self._maps.on_inventory(inventory)
                missing = missing_from(self._profile, inventory)
                if missing != self._reported_missing and (missing or self._reported_missing):
                    self._put(problem_of_missing(missing) if missing else nothing_is_missing())
                self._reported_missing = missing
                if not missing:
                    return
            await asyncio.sleep(pause_s)

    def _report_unconfirmed_cancel(self) -> None:
        self._put(
            Problem(
                now_ns(),
                "error",
                QT_TR_NOOP("The robot did not confirm that it cancelled its navigation goal."),
                QT_TR_NOOP("The robot may still be moving autonomously."),
                QT_TR_NOOP("Watch the robot; use its emergency stop if it moves."),
            )
        )
