"""Action servers of a robot: actionlib's topics in ROS 1, rosbridge's action operations in ROS 2."""

import secrets
from collections.abc import Callable
from typing import Protocol

from caris_desktop.ros import action_messages
from caris_desktop.ros.action_messages import GoalStatus
from caris_desktop.ros.dialect import Dialect, action_type_name, encode_time, service_type_name
from caris_desktop.ros.message_fields import MessageError, message_of
from caris_desktop.simulator.ros_context import RosContext
from caris_desktop.simulator.server import Action, Message, SimulatedService

_STATUS_EVERY_STEPS = 10
_FINISHED_LISTED_S = 5.0
_ROS2_STATUS = {
    action_messages.ACTIVE: action_messages.ROS2_EXECUTING,
    action_messages.SUCCEEDED: action_messages.ROS2_SUCCEEDED,
    action_messages.PREEMPTED: action_messages.ROS2_CANCELED,
    action_messages.ABORTED: action_messages.ROS2_ABORTED,
    action_messages.REJECTED: action_messages.ROS2_ABORTED,
}

OnGoal = Callable[[str, Message], None]
"""Receives id and goal; it calls ``accept``, and ``finish`` at the end. Raises MessageError for a malformed goal."""
OnCancel = Callable[[str], None]
"""Receives the id to cancel, empty for all goals."""


class ActionServer(Protocol):
    """Server of one action. Statuses are those of actionlib_msgs/GoalStatus in either ROS."""

    def accept(self, goal_id: str) -> None:
        """Mark the goal as active."""

    def progress(self, status: GoalStatus, feedback: Message) -> None:
        """Publish the goal's feedback."""

    def finish(self, status: GoalStatus, result: Message) -> None:
        """Finish the goal with a result."""


class ActionlibServer:
    """Action server of ROS 1: goal and cancel in, status, feedback and result out.

    ``name``, ``package`` and ``kind`` are such as ``/tts``, ``pal_interaction_msgs``, ``Tts``.
    """

    def __init__(
        self, ros: RosContext, name: str, package: str, kind: str, *, on_goal: OnGoal, on_cancel: OnCancel
    ) -> None:
        self._ros = ros
        self._on_goal = on_goal
        self._on_cancel = on_cancel
        self._statuses: dict[str, tuple[GoalStatus, float]] = {}
        self._goals = 0
        self._name = ros.model.absolute(name)
        ros.obeys(f"{self._name}/goal", package, f"{kind}ActionGoal", self._on_goal_message)
        ros.obeys(f"{self._name}/cancel", "actionlib_msgs", "GoalID", self._on_cancel_message)
        self._status = ros.publishes(f"{self._name}/status", "actionlib_msgs", "GoalStatusArray")
        self._feedback = ros.publishes(f"{self._name}/feedback", package, f"{kind}ActionFeedback")
        self._result = ros.publishes(f"{self._name}/result", package, f"{kind}ActionResult")
        ros.every(_STATUS_EVERY_STEPS, self._publish_status)

    def accept(self, goal_id: str) -> None:
        self._set_status(GoalStatus(goal_id, action_messages.ACTIVE))

    def progress(self, status: GoalStatus, feedback: Message) -> None:
        message = action_messages.encode_action_feedback(status, feedback, stamp_ns=self._ros.stamp_ns())
        self._ros.publish(self._feedback, message)

    def finish(self, status: GoalStatus, result: Message) -> None:
        # the status first: for a client a goal is finished once it has both
        self._set_status(status)
        message = action_messages.encode_action_result(status, result, stamp_ns=self._ros.stamp_ns())
        self._ros.publish(self._result, message)

    def _on_goal_message(self, message: Message) -> None:
        goal = message_of(message.get("goal", {}), "ActionGoal.goal")
        # ROS fills omitted fields
        goal_id = message_of(message.get("goal_id", {}), "ActionGoal.goal_id").get("id")
        if not goal_id:
            self._goals += 1
            goal_id = f"{self._name.strip('/')}-{self._goals}"
        if not isinstance(goal_id, str):
            raise MessageError("ActionGoal.goal_id.id must be a string")
        self._on_goal(goal_id, goal)

    def _on_cancel_message(self, message: Message) -> None:
        goal_id = message.get("id") or ""
        if not isinstance(goal_id, str):
            raise MessageError("GoalID.id must be a string")
        # an empty id means every goal, as does the empty message of actionlib clients
        self._on_cancel(goal_id)

    def _set_status(self, status: GoalStatus) -> None:
        self._statuses[status.goal_id] = (status, self._ros.robot.now_s)
        self._publish_status()

    def _publish_status(self) -> None:
        now_s = self._ros.robot.now_s
        self._statuses = {
            goal_id: (status, since_s)
            for goal_id, (status, since_s) in self._statuses.items()
            if status.ending is None or now_s - since_s < _FINISHED_LISTED_S
        }
        statuses = [status for status, _ in self._statuses.values()]
        array = action_messages.encode_goal_status_array(statuses, stamp_ns=self._ros.stamp_ns())
        self._ros.publish(self._status, array)


class Ros2ActionServer:
    """Action server of ROS 2. With ``lists_goals`` it has the status topic and cancel service of every ROS action."""

    def __init__(
        self,
        ros: RosContext,
        name: str,
        package: str,
        kind: str,
        *,
        on_goal: OnGoal,
        on_cancel: OnCancel,
        lists_goals: bool = False,
    ) -> None:
        self._ros = ros
        self._on_goal = on_goal
        self._on_cancel = on_cancel
        self._replies: dict[str, Callable[[Message], None]] = {}
        self._statuses: dict[str, tuple[int, float]] = {}
        self._uuids: dict[str, bytes] = {}
        self._status: str | None = None
        absolute = ros.model.absolute(name)
        ros.server.actions[absolute] = Action(action_type_name(Dialect.ROS2, package, kind), self._start, self._cancel)
        if lists_goals:
            cancel_type = service_type_name(Dialect.ROS2, "action_msgs", "CancelGoal")
            ros.server.services[f"{absolute}/_action/cancel_goal"] = SimulatedService(cancel_type, self._cancel_service)
            self._status = ros.publishes(f"{absolute}/_action/status", "action_msgs", "GoalStatusArray", latched=True)

    def accept(self, goal_id: str) -> None:
        self._set_status(GoalStatus(goal_id, action_messages.ACTIVE))

    def progress(self, status: GoalStatus, feedback: Message) -> None:
        if status.goal_id in self._replies:
            self._replies[status.goal_id]({"op": "action_feedback", "values": feedback})

    def finish(self, status: GoalStatus, result: Message) -> None:
        self._set_status(status)
        reply = self._replies.pop(status.goal_id, None)
        if reply is not None:
            reply({"op": "action_result", "values": result, "status": _ROS2_STATUS[status.status], "result": True})

    def _start(self, goal_id: str, goal: Message, reply: Callable[[Message], None]) -> None:
        if goal_id in self._replies:
            raise MessageError(f"a goal with the id '{goal_id}' is already active")
        self._replies[goal_id] = reply
        try:
            self._on_goal(goal_id, goal)
        except MessageError:
            del self._replies[goal_id]
            raise

    def _cancel(self, goal_id: str) -> None:
        if goal_id:
            self._on_cancel(goal_id)

    def _cancel_service(self, arguments: Message) -> Message:
        """action_msgs/CancelGoal, for every goal or for one by the UUID of the status topic."""
        running = self._ros.robot.navigation.goal_id
        if not action_messages.means_every_goal(arguments) and _uuid_in(arguments) != self._uuids.get(running or ""):
            return {"return_code": action_messages.CANCEL_UNKNOWN_GOAL, "goals_canceling": []}
        self._on_cancel(running or "")
        canceling = [self._goal_info(running)] if running is not None else []
        return {"return_code": action_messages.CANCEL_ACCEPTED, "goals_canceling": canceling}

    def _set_status(self, status: GoalStatus) -> None:
        if self._status is None:
            return
        now_s = self._ros.robot.now_s
        self._uuids.setdefault(status.goal_id, secrets.token_bytes(16))
        self._statuses[status.goal_id] = (_ROS2_STATUS[status.status], now_s)
        for old, (old_status, since_s) in list(self._statuses.items()):
            if old_status >= action_messages.ROS2_SUCCEEDED and now_s - since_s > _FINISHED_LISTED_S:
                del self._statuses[old], self._uuids[old]
        entries = [
            {"goal_info": self._goal_info(listed), "status": listed_status}
            for listed, (listed_status, _) in self._statuses.items()
        ]
        self._ros.publish(self._status, {"status_list": entries})

    def _goal_info(self, goal_id: str) -> Message:
        uuid = list(self._uuids.get(goal_id, bytes(16)))
        return {"goal_id": {"uuid": uuid}, "stamp": encode_time(Dialect.ROS2, self._ros.stamp_ns())}


def _uuid_in(arguments: Message) -> bytes | None:
    info = message_of(arguments.get("goal_info", {}), "CancelGoal.goal_info")
    uuid = message_of(info.get("goal_id", {}), "CancelGoal.goal_info.goal_id").get("uuid")
    if isinstance(uuid, list) and all(isinstance(octet, int) and 0 <= octet <= 255 for octet in uuid):
        return bytes(uuid)
    return uuid if isinstance(uuid, bytes) else None
