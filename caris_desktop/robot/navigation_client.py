"""Navigation goals, move_base (ROS 1) and NavigateToPose (ROS 2), and the speed limit of the robot's navigation."""

import asyncio
import itertools
import logging
import math
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import GoalChanged, GoalState, NavigationSpeedChanged, Problem
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.link_commands import GoTo, LimitGoals
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.robot.action_client import FATE_UNKNOWN, FATE_WITHIN_S, ActionClient, make_action_client
from caris_desktop.robot.link_context import LinkContext
from caris_desktop.robot.transport import RosbridgeTopic, ServiceCallError
from caris_desktop.ros.action_messages import (
    Ending,
    decode_move_base_feedback,
    decode_navigate_to_pose_feedback,
    encode_move_base_target,
    encode_navigate_to_pose_goal,
)
from caris_desktop.ros.message_conversion import NO_LIMIT, decode_reconfigured, encode_reconfigure, encode_speed_limit
from caris_desktop.ros.message_fields import Message, MessageError

NO_ANSWER_S = 4.0
UNCONFIRMED_CANCEL_S = 1.5
PROGRESS_EVERY_NS = 500_000_000
# A newly advertised publisher reaches its subscribers with a delay.
CANCEL_AGAIN_S = (0.3, 1.0)

NO_NAVIGATION = QT_TR_NOOP("this robot's profile does not define navigation")


class _Goal(Value):
    """Present goal. ``wire_id`` is its id on the robot."""

    command: GoTo
    wire_id: str
    state: GoalState = "requested"
    distance_left_m: float | None = None
    cancelling: str | None = None
    cancelled_by: Actor = ""
    reported_ns: int = 0


class Navigator:
    """The console's single navigation goal, from request to end.

    ``emit`` gets a GoalChanged for each change of state and, while active, for its progress twice per second.
    ``unconfirmed`` is called if a cancellation is not confirmed in time.
    """

    def __init__(
        self,
        link: LinkContext,
        *,
        emit: Callable[[GoalChanged], None],
        unconfirmed: Callable[[], None],
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._ros = link.ros
        server = link.profile.navigation
        self._emit = emit
        self._unconfirmed = unconfirmed
        self._goal: _Goal | None = None
        self._lost_wire_id: str | None = None
        self._fate: asyncio.TimerHandle | None = None
        self._epochs = itertools.count(1)
        self._epoch = 0
        self._map_frame = link.profile.frames.map
        self._pose_in_map: Pose2D | None = None
        self._robot_reports_distance = False
        self._server: ActionClient | None = None
        self._moves_base = server is not None and server.kind == "move_base"
        if server is not None:
            action_type = "move_base_msgs/MoveBase" if self._moves_base else "nav2_msgs/NavigateToPose"
            self._server = make_action_client(self._ros, server.name, action_type, self, motion=True)

    @property
    def has_goal(self) -> bool:
        """True while the robot has, or may have, a goal of ours."""
        return self._goal is not None

    def go(self, command: GoTo) -> None:
        """Request a goal; replaces the present one."""
        if self._goal is not None:
            # Navigation itself preempts the old goal; its late answers are ignored.
            self._goal = replace(self._goal, cancelled_by=command.actor)
            self._end("cancelled", QT_TR_NOOP("replaced by another goal"))
        target_in_map = command.target_in_map
        if self._server is None:
            self.refuse(command, NO_NAVIGATION)
            return
        if not all(math.isfinite(value) for value in (target_in_map.x_m, target_in_map.y_m, target_in_map.heading_rad)):
            self.refuse(command, QT_TR_NOOP("the target on the map is invalid"))
            return
        self._epoch = next(self._epochs)
        # Stamp zero: use the newest transforms, as the clocks may differ.
        encode = encode_move_base_target if self._moves_base else encode_navigate_to_pose_goal
        wire_id = self._server.send(command.goal_id, encode(target_in_map, stamp_ns=0, frame_id=self._map_frame))
        if wire_id is None:
            self.refuse(command, QT_TR_NOOP("the robot is not connected"))
            return
        self._robot_reports_distance = False
        self._goal = _Goal(command, wire_id, distance_left_m=self._beeline_m(target_in_map))
        self._notify()
        epoch = self._epoch
        self._loop.call_later(NO_ANSWER_S, lambda: self._give_up(epoch))

    def refuse(self, command: GoTo, detail: str) -> None:
        """Report a goal as failed that was never sent."""
        self._emit(
            GoalChanged(
                now_ns(),
                command.goal_id,
                "failed",
                command.target_in_map,
                command.place,
                detail=detail,
                actor=command.actor,
            )
        )

    def cancel(self, detail: str, actor: Actor) -> None:
        """Cancel our goal, if any. It is reported when the robot confirms."""
        if self._goal is None or self._server is None or self._goal.cancelling is not None:
            return
        self._goal = replace(self._goal, cancelling=detail, cancelled_by=actor)
        self._server.cancel(self._goal.wire_id)
        epoch = self._epoch
        self._loop.call_later(UNCONFIRMED_CANCEL_S, lambda: self._give_up_cancelling(epoch))

    def cancel_all(self, detail: str, actor: Actor) -> None:
        """Cancel all goals that the robot may have."""
        self.cancel(detail, actor)
        if self._server is not None and self._ros.is_connected:
            self._server.cancel_all()

    def link_lost(self) -> None:
        """Cancel the goal after reconnection, which shows whether it was reached before."""
        self._pose_in_map = None
        if self._goal is not None:
            self._lost_wire_id = self._goal.wire_id
            if self._goal.cancelling is None:
                self._goal = replace(
                    self._goal, cancelling=QT_TR_NOOP("the connection to the robot was lost"), cancelled_by=CONSOLE
                )
            self._notify(
                QT_TR_NOOP(
                    "the link to the robot was lost; the goal will be cancelled when the robot is connected again"
                )
            )
            self._await_fate()

    def link_connected(self) -> None:
        lost, self._lost_wire_id = self._lost_wire_id, None
        if lost is None or self._server is None:
            return
        if self._goal is not None:
            self._await_fate()
        self._server.cancel(lost)
        self.cancel_left_goal()

    def cancel_left_goal(self) -> None:
        """Cancel goals that the robot may still have from a disconnected period."""
        if self._server is None:
            return
        self._server.cancel_all()
        epoch = self._epoch
        for delay_s in CANCEL_AGAIN_S:
            self._loop.call_later(delay_s, lambda: self._cancel_again(epoch))

    def goal_pending(self, wire_id: str) -> None:
        """Reported when it begins."""

    def goal_active(self, wire_id: str) -> None:
        if self._goal is not None and self._goal.wire_id == wire_id and self._goal.state == "requested":
            self._goal = replace(self._goal, state="active")
            self._notify()

    def robot_moved(self, pose_in_map: Pose2D) -> None:
        """Set the robot's pose; the straight-line distance is used if the robot reports none."""
        self._pose_in_map = pose_in_map
        if self._goal is not None and not self._robot_reports_distance:
            self._progress(self._beeline_m(self._goal.command.target_in_map))

    def goal_feedback(self, wire_id: str, feedback: Message) -> None:
        goal = self._goal
        if goal is None or goal.wire_id != wire_id:
            return
        decode = decode_move_base_feedback if self._moves_base else decode_navigate_to_pose_feedback
        decoded = decode(feedback)
        if decoded.pose_in_map is not None:
            self._pose_in_map = decoded.pose_in_map
        self._robot_reports_distance = decoded.distance_left_m is not None
        self.goal_active(wire_id)
        self._progress(
            decoded.distance_left_m if self._robot_reports_distance else self._beeline_m(goal.command.target_in_map)
        )

    def _progress(self, distance_left_m: float | None) -> None:
        goal = self._goal
        if goal is not None:
            self._goal = replace(goal, distance_left_m=distance_left_m)
            if goal.state == "active" and now_ns() - goal.reported_ns >= PROGRESS_EVERY_NS:
                self._notify()

    def _beeline_m(self, target_in_map: Pose2D) -> float | None:
        here = self._pose_in_map
        return None if here is None else math.hypot(target_in_map.x_m - here.x_m, target_in_map.y_m - here.y_m)

    def goal_ended(self, wire_id: str, ending: Ending, detail: str) -> None:
        if self._goal is None or self._goal.wire_id != wire_id:
            return
        if ending == "cancelled" and self._goal.cancelling is None:
            detail = detail or QT_TR_NOOP("the robot cancelled it")
        elif self._goal.cancelling is not None and ending != "reached":
            ending, detail = "cancelled", self._goal.cancelling
        self._end(ending, detail)

    def _notify(self, detail: str = "") -> None:
        goal = self._goal
        if goal is not None:
            self._goal = replace(goal, reported_ns=now_ns())
            self._emit(
                GoalChanged(
                    now_ns(),
                    goal.command.goal_id,
                    goal.state,
                    goal.command.target_in_map,
                    goal.command.place,
                    goal.distance_left_m,
                    detail,
                    goal.cancelled_by if goal.state == "cancelled" else goal.command.actor,
                )
            )

    def _end(self, state: GoalState, detail: str) -> None:
        if self._goal is not None:
            self._goal = replace(self._goal, state=state)
            self._notify(detail)
            self._goal = None
        if self._fate is not None:
            self._fate.cancel()
            self._fate = None

    def _give_up(self, epoch: int) -> None:
        if self._goal is None or self._epoch != epoch or self._goal.state != "requested" or self._server is None:
            return
        if self._fate is not None or self._goal.cancelling is not None:
            return
        self._server.give_up(self._goal.wire_id)
        late = QT_TR_NOOP("the robot's navigation did not respond within {seconds} s")
        self._end("failed", localized(late, seconds=f"{NO_ANSWER_S:g}"))

    def _await_fate(self) -> None:
        if self._fate is not None:
            self._fate.cancel()
        self._fate = self._loop.call_later(FATE_WITHIN_S, self._give_up_fate)

    def _give_up_fate(self) -> None:
        self._end("failed", FATE_UNKNOWN)
        if self._ros.is_connected:
            self._unconfirmed()

    def _give_up_cancelling(self, epoch: int) -> None:
        if self._goal is None or self._epoch != epoch or self._goal.cancelling is None or self._server is None:
            return
        if self._fate is not None:
            return
        self._server.give_up(self._goal.wire_id)
        self._server.cancel_all()
        unconfirmed = QT_TR_NOOP("{why}; the robot did not confirm it")
        self._end("cancelled", localized(unconfirmed, why=localized(self._goal.cancelling)))
        self._unconfirmed()

    def _cancel_again(self, epoch: int) -> None:
        if self._epoch == epoch and self._server is not None and self._ros.is_connected:
            self._server.cancel_all()


logger = logging.getLogger(__name__)
RESTORED_WITHIN_S = 0.5
# Some planners store parameters with few decimals.
_SAME_MPS = 0.005


class NavigationSpeed:
    """Sends the wizard's limit to navigation: on connection, before each goal and at each change.

    It sends a NavigationSpeedChanged when the effective limit is known, and one Problem per connection if it
    cannot be set. A goal does not wait for the answer: the limit is sent first and arrives sooner than the robot can
    exceed it from standstill.
    """

    def __init__(self, link: LinkContext) -> None:
        self._ros = link.ros
        self._emit = link.put
        self._in_background = link.in_background
        self._server = server = link.profile.navigation
        self._requested_mps: float | None = None
        self._requested_by: Actor = CONSOLE
        self._limit_mps: float | None = None
        self._reported_failure = False
        self._attempt = 0
        self._topic: RosbridgeTopic | None = None
        interface = server.speed_limit if server is not None else None
        self._reconfigure = interface.reconfigure if interface is not None else None
        self._parameters = interface.parameters if interface is not None else ()
        if interface is not None and interface.topic is not None:
            self._topic = RosbridgeTopic(self._ros, interface.topic, "nav2_msgs/SpeedLimit", queue_size=1)
            self._topic.advertise()

    def limit(self, command: LimitGoals) -> None:
        """Apply the limit of manual driving to goals too."""
        if math.isfinite(command.forward_mps) and command.forward_mps > 0.0:
            self._requested_mps, self._requested_by = command.forward_mps, command.actor
            self.apply()

    def link_connected(self) -> None:
        self._reported_failure = False
        self.apply()

    def link_lost(self) -> None:
        # Others may set the robot's limit meanwhile.
        self._attempt += 1
        self._persist(None, CONSOLE)

    def apply(self) -> None:
        """Send the limit, if the robot is connected."""
        if self._requested_mps is None or not self._ros.is_connected:
            return
        self._attempt += 1
        limit_mps = self._requested_mps
        if self._server is not None and self._server.max_mps is not None:
            limit_mps = min(limit_mps, self._server.max_mps)
        if self._topic is not None:
            self._topic.publish(encode_speed_limit(limit_mps))
            self._in_background(self._check_listeners(limit_mps, self._topic.name, attempt=self._attempt))
        elif self._reconfigure is not None:
            answer = self._ask_for(limit_mps, self._reconfigure)
            self._in_background(self._await_answer(answer, limit_mps, self._reconfigure, attempt=self._attempt))

    async def restore(self) -> None:
        """Restore the robot's own limit when the console leaves."""
        self._attempt += 1
        if self._limit_mps is None or not self._ros.is_connected:
            return
        if self._topic is not None:
            self._topic.publish(encode_speed_limit(NO_LIMIT))
        elif self._reconfigure is not None and self._server is not None and self._server.max_mps is not None:
            try:
                async with asyncio.timeout(RESTORED_WITHIN_S):
                    await self._ask_for(self._server.max_mps, self._reconfigure)
            except (TimeoutError, ServiceCallError) as error:
                logger.info("The navigation's speed stays as it was told: %s", error)

    async def _check_listeners(self, limit_mps: float, topic: str, *, attempt: int) -> None:
        try:
            listeners = await self._ros.nodes("subscribers", topic)
            reason = "" if listeners else localized(QT_TR_NOOP("nothing subscribes to {topic}"), topic=topic)
        except ServiceCallError as error:
            unknown = QT_TR_NOOP("the subscribers of {topic} are unknown: {why}")
            reason = localized(unknown, topic=topic, why=error)
        self._settle(limit_mps, reason, attempt=attempt)

    async def _await_answer(self, answer: Awaitable[Any], limit_mps: float, node: str, *, attempt: int) -> None:
        try:
            now = decode_reconfigured(await answer, self._parameters)
        except (ServiceCallError, MessageError) as error:
            self._settle(limit_mps, str(error), attempt=attempt)
            return
        fastest = max(now.values(), default=math.inf)
        refused = localized(QT_TR_NOOP("{node} did not accept {names}"), node=node, names=", ".join(self._parameters))
        reason = "" if fastest <= limit_mps + _SAME_MPS else refused
        self._settle(limit_mps, reason, attempt=attempt)

    def _ask_for(self, limit_mps: float, node: str) -> Awaitable[Any]:
        request = encode_reconfigure(dict.fromkeys(self._parameters, limit_mps))
        return self._ros.ask(f"{node}/set_parameters", "dynamic_reconfigure/Reconfigure", request)

    def _settle(self, limit_mps: float, reason: str, *, attempt: int) -> None:
        if attempt != self._attempt:
            return  # a newer limit was sent meanwhile; its answer counts
        self._persist(None if reason else limit_mps, self._requested_by)
        if not reason or self._reported_failure:
            return
        self._reported_failure = True
        logger.warning("The navigation's speed: %s", reason)
        profile_max_mps = self._server.max_mps if self._server is not None else None
        self._emit(
            Problem(
                now_ns(),
                "warning",
                localized(
                    QT_TR_NOOP("The speed limit could not be sent to the robot's navigation: {reason}."), reason=reason
                ),
                QT_TR_NOOP(
                    "When navigating, the robot drives at its own configured speed, regardless of the limit in Drive."
                )
                if profile_max_mps is None
                else localized(
                    QT_TR_NOOP(
                        "When navigating, the robot drives at up to {speed} m/s, as set in its profile, "
                        "regardless of the limit in Drive."
                    ),
                    speed=f"{profile_max_mps:.2f}",
                ),
                QT_TR_NOOP(
                    "Watch the robot; press Esc to stop it. Correct 'speed_limit' under 'navigation' in the "
                    "robot profile."
                ),
                cause="robot_speed",
            )
        )

    def _persist(self, speed_mps: float | None, actor: Actor) -> None:
        if speed_mps != self._limit_mps:
            self._limit_mps = speed_mps
            self._emit(NavigationSpeedChanged(now_ns(), speed_mps, actor))
