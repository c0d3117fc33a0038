"""Navigation goals: move_base by its actionlib topics (ROS 1), NavigateToPose by rosbridge actions (ROS 2)."""

import asyncio
import itertools
import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol
from uuid import uuid4

import roslibpy

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import GoalChanged, GoalState
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.robot.profile import NavigationServer
from caris_desktop.robot.transport import SafeRos, SafeTopic
from caris_desktop.ros.actions import (
    ACTIVE,
    PREEMPTING,
    Ending,
    GoalFeedback,
    decode_goal_status_array,
    decode_move_base_feedback,
    decode_move_base_result,
    decode_navigate_to_pose_feedback,
    decode_navigate_to_pose_result,
    encode_cancel_every_goal,
    encode_goal_id,
    encode_move_base_goal,
    encode_navigate_to_pose_goal,
)
from caris_desktop.ros.dialect import Dialect, action_type_name, type_name

logger = logging.getLogger(__name__)

NO_ANSWER_S = 4.0
UNCONFIRMED_CANCEL_S = 1.5
PROGRESS_EVERY_NS = 500_000_000
# A publisher that was just advertised reaches its subscribers only after a moment.
CANCEL_AGAIN_S = (0.3, 1.0)

NO_NAVIGATION = "this robot's profile names no navigation"


@dataclass(frozen=True, slots=True)
class _Goal:
    """The goal under way. ``wire_id`` is its name on the robot."""

    goal_id: str
    wire_id: str
    target_in_map: Pose2D
    place: str | None
    state: GoalState = "requested"
    distance_left_m: float | None = None
    cancelling: str | None = None
    told_ns: int = 0


class GoalListener(Protocol):
    """What a goal server reports. ``wire_id`` says of which goal."""

    def goal_active(self, wire_id: str) -> None: ...

    def goal_feedback(self, wire_id: str, feedback: GoalFeedback) -> None: ...

    def goal_ended(self, wire_id: str, ending: Ending, detail: str) -> None: ...


class GoalServer(Protocol):
    """How goals reach the robot. None of the calls waits, and none of them is kept for later."""

    def send(self, goal_id: str, target_in_map: Pose2D) -> str | None:
        """Ask for a goal. Its name on the robot, or None when it could not be sent."""

    def cancel(self, wire_id: str) -> None:
        """Cancel one goal."""

    def cancel_all(self) -> None:
        """Cancel whatever goal the robot has."""


class MoveBase:
    """move_base's actionlib topics. Subscriptions stand, so the goal is followed without polling."""

    def __init__(self, ros: SafeRos, name: str, listener: GoalListener) -> None:
        def topic(leaf: str, package: str, message: str) -> SafeTopic:
            message_type = type_name(Dialect.ROS1, package, message)
            return SafeTopic(ros, f"{name}/{leaf}", message_type, queue_length=10, every_message=True)

        self._listener = listener
        self._goal = topic("goal", "move_base_msgs", "MoveBaseActionGoal")
        self._cancel = topic("cancel", "actionlib_msgs", "GoalID")
        self._status = topic("status", "actionlib_msgs", "GoalStatusArray")
        self._feedback = topic("feedback", "move_base_msgs", "MoveBaseActionFeedback")
        self._result = topic("result", "move_base_msgs", "MoveBaseActionResult")
        self._goal.advertise()
        self._cancel.advertise()
        self._status.subscribe(self._take_status)
        self._feedback.subscribe(self._take_feedback)
        self._result.subscribe(self._take_result)

    def send(self, goal_id: str, target_in_map: Pose2D) -> str | None:
        wire_id = f"{goal_id}-{uuid4().hex[:8]}"
        # Stamp zero: the robot's clock may differ from ours, and actionlib drops goals that seem too old.
        goal = encode_move_base_goal(wire_id, target_in_map, stamp_ns=0)
        return wire_id if self._goal.publish(goal) else None

    def cancel(self, wire_id: str) -> None:
        self._cancel.publish(encode_goal_id(Dialect.ROS1, wire_id))

    def cancel_all(self) -> None:
        self._cancel.publish(encode_goal_id(Dialect.ROS1, ""))

    def _take_status(self, message: Any) -> None:
        for status in decode_goal_status_array(message):
            if status.ending is not None:
                self._listener.goal_ended(status.goal_id, status.ending, status.detail)
            elif status.status in (ACTIVE, PREEMPTING):
                self._listener.goal_active(status.goal_id)

    def _take_feedback(self, message: Any) -> None:
        feedback = decode_move_base_feedback(message)
        self._listener.goal_feedback(feedback.goal_id, feedback)

    def _take_result(self, message: Any) -> None:
        status = decode_move_base_result(message)
        if status.ending is not None:
            self._listener.goal_ended(status.goal_id, status.ending, status.detail)


class NavigateToPose:
    """Nav2's action through rosbridge's send_action_goal."""

    def __init__(self, ros: SafeRos, name: str, listener: GoalListener) -> None:
        self._ros = ros
        self._listener = listener
        self._name = name
        action_type = action_type_name(Dialect.ROS2, "nav2_msgs", "NavigateToPose")
        self._client = roslibpy.ActionClient(ros, name, action_type)

    def send(self, _: str, target_in_map: Pose2D) -> str | None:
        if not self._ros.is_connected:
            return None
        wire_ids: list[str] = []

        def feedback(values: Mapping[str, Any]) -> None:
            self._listener.goal_feedback(wire_ids[0], decode_navigate_to_pose_feedback({"values": dict(values)}))

        def ended(results: Mapping[str, Any], *, worked: bool) -> None:
            operation = {"status": results["status"].value or None, "values": results["values"], "result": worked}
            result = decode_navigate_to_pose_result(operation)
            self._listener.goal_ended(wire_ids[0], result.ending, result.detail)

        goal = encode_navigate_to_pose_goal(target_in_map, stamp_ns=0)
        wire_ids.append(
            self._client.send_goal(
                goal,
                lambda results: ended(results, worked=True),
                feedback,
                lambda results: ended(results, worked=False),
            )
        )
        return wire_ids[0]

    def cancel(self, wire_id: str) -> None:
        self._client.cancel_goal(wire_id)

    def cancel_all(self) -> None:
        # rosbridge cancels only what this very connection asked for. The action's own service knows every goal.
        service = roslibpy.Service(self._ros, f"{self._name}/_action/cancel_goal", "action_msgs/srv/CancelGoal")
        service.call(
            roslibpy.ServiceRequest(encode_cancel_every_goal()),
            lambda _: None,
            lambda reason: logger.info("The robot did not cancel all its goals: %s", reason),
        )


class Navigator:
    """The one navigation goal of the console, from request to end.

    ``emit`` gets a GoalChanged for each change of state and, while it is under way, for its progress twice a second.
    ``unconfirmed`` is called when the robot did not confirm a cancellation in time.
    """

    def __init__(
        self,
        ros: SafeRos,
        server: NavigationServer | None,
        *,
        emit: Callable[[GoalChanged], None],
        unconfirmed: Callable[[], None],
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._ros = ros
        self._emit = emit
        self._unconfirmed = unconfirmed
        self._goal: _Goal | None = None
        self._lost_wire_id: str | None = None
        self._epochs = itertools.count(1)
        self._epoch = 0
        self._server: GoalServer | None = None
        if server is not None and server.kind == "move_base":
            self._server = MoveBase(ros, server.name, self)
        elif server is not None:
            self._server = NavigateToPose(ros, server.name, self)

    @property
    def under_way(self) -> bool:
        """Whether the robot has a goal of ours, or may still have it."""
        return self._goal is not None

    def go(self, goal_id: str, target_in_map: Pose2D, place: str | None) -> None:
        """Ask for a goal; one that is under way is replaced."""
        if self._goal is not None:
            # The navigation itself preempts the old goal; its late answers no longer belong to anything here.
            self._end("cancelled", "replaced by another goal")
        if self._server is None:
            self.refuse(goal_id, target_in_map, place, NO_NAVIGATION)
            return
        if not all(math.isfinite(value) for value in (target_in_map.x_m, target_in_map.y_m, target_in_map.heading_rad)):
            self.refuse(goal_id, target_in_map, place, "the target is not a place in the map")
            return
        self._epoch = next(self._epochs)
        wire_id = self._server.send(goal_id, target_in_map)
        if wire_id is None:
            self.refuse(goal_id, target_in_map, place, "the robot is not connected")
            return
        self._goal = _Goal(goal_id, wire_id, target_in_map, place)
        self._tell()
        epoch = self._epoch
        self._loop.call_later(NO_ANSWER_S, lambda: self._give_up(epoch))

    def refuse(self, goal_id: str, target_in_map: Pose2D, place: str | None, detail: str) -> None:
        """Report a goal as failed that was never sent."""
        self._emit(GoalChanged(now_ns(), goal_id, "failed", target_in_map, place, detail=detail))

    def cancel(self, detail: str) -> None:
        """Cancel our goal, if there is one. It is reported when the robot confirms."""
        if self._goal is None or self._server is None or self._goal.cancelling is not None:
            return
        self._goal = replace(self._goal, cancelling=detail)
        self._server.cancel(self._goal.wire_id)
        epoch = self._epoch
        self._loop.call_later(UNCONFIRMED_CANCEL_S, lambda: self._give_up_cancelling(epoch))

    def cancel_all(self, detail: str) -> None:
        """Cancel our goal and every other that the robot may have."""
        self.cancel(detail)
        if self._server is not None and self._ros.is_connected:
            self._server.cancel_all()

    def link_lost(self) -> None:
        """The goal counts as failed, and will be cancelled when the robot is back."""
        if self._goal is not None:
            self._lost_wire_id = self._goal.wire_id
            self._end("failed", "the link to the robot was lost; the goal is cancelled when it is back")

    def link_connected(self) -> None:
        lost, self._lost_wire_id = self._lost_wire_id, None
        if lost is None or self._server is None:
            return
        self._server.cancel(lost)
        self._server.cancel_all()
        epoch = self._epoch
        for delay_s in CANCEL_AGAIN_S:
            self._loop.call_later(delay_s, lambda: self._cancel_again(epoch))

    def goal_active(self, wire_id: str) -> None:
        if self._goal is not None and self._goal.wire_id == wire_id and self._goal.state == "requested":
            self._goal = replace(self._goal, state="active")
            self._tell()

    def goal_feedback(self, wire_id: str, feedback: GoalFeedback) -> None:
        goal = self._goal
        if goal is None or goal.wire_id != wire_id:
            return
        distance_m = feedback.distance_left_m
        if distance_m is None and feedback.pose_in_map is not None:
            target = goal.target_in_map
            distance_m = math.hypot(target.x_m - feedback.pose_in_map.x_m, target.y_m - feedback.pose_in_map.y_m)
        news = goal.state == "requested" or now_ns() - goal.told_ns >= PROGRESS_EVERY_NS
        self._goal = replace(goal, state="active", distance_left_m=distance_m)
        if news:
            self._tell()

    def goal_ended(self, wire_id: str, ending: Ending, detail: str) -> None:
        if self._goal is None or self._goal.wire_id != wire_id:
            return
        if ending == "cancelled" and self._goal.cancelling is None:
            detail = detail or "the robot gave it up"
        elif self._goal.cancelling is not None and ending != "reached":
            ending, detail = "cancelled", self._goal.cancelling
        self._end(ending, detail)

    def _tell(self, detail: str = "") -> None:
        goal = self._goal
        if goal is not None:
            self._goal = replace(goal, told_ns=now_ns())
            self._emit(
                GoalChanged(
                    now_ns(), goal.goal_id, goal.state, goal.target_in_map, goal.place, goal.distance_left_m, detail
                )
            )

    def _end(self, state: GoalState, detail: str) -> None:
        if self._goal is not None:
            self._goal = replace(self._goal, state=state)
            self._tell(detail)
            self._goal = None

    def _give_up(self, epoch: int) -> None:
        if self._goal is None or self._epoch != epoch or self._goal.state != "requested" or self._server is None:
            return
        self._server.cancel(self._goal.wire_id)
        self._end("failed", f"the robot's navigation did not answer within {NO_ANSWER_S:g} s")

    def _give_up_cancelling(self, epoch: int) -> None:
        if self._goal is None or self._epoch != epoch or self._goal.cancelling is None or self._server is None:
            return
        self._server.cancel_all()
        self._end("cancelled", f"{self._goal.cancelling}; the robot did not confirm it")
        self._unconfirmed()

    def _cancel_again(self, epoch: int) -> None:
        if self._epoch == epoch and self._server is not None and self._ros.is_connected:
            self._server.cancel_all()
