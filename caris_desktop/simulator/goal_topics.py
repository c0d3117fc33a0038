"""Navigation goals on ROS: actionlib on move_base (ROS 1), the NavigateToPose action (ROS 2), and the path topic."""

import itertools
import logging
import secrets
from collections.abc import Callable

import numpy as np

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.ros import action_messages, message_conversion
from caris_desktop.ros.action_messages import GoalStatus
from caris_desktop.ros.dialect import Dialect, action_type_name, encode_time, service_type_name
from caris_desktop.ros.message_conversion import encode_pose_stamped
from caris_desktop.ros.message_fields import Message as Fields
from caris_desktop.ros.message_fields import MessageError, message_of, part
from caris_desktop.ros.navigation_messages import encode_path
from caris_desktop.ros.speed_limits import NO_LIMIT, decode_reconfigured, decode_speed_limit, encode_reconfigure
from caris_desktop.simulator.actionlib import ActionlibServer
from caris_desktop.simulator.robot_interface import Navigation
from caris_desktop.simulator.ros_context import RosContext
from caris_desktop.simulator.server import Action, Message, SimulatedService
from caris_desktop.simulator.simulated_navigation import CRUISE_MPS, GoalEnded

logger = logging.getLogger(__name__)

_STATUS_EVERY_STEPS = 10
_FINISHED_LISTED_S = 5.0
_ROS1_STATUS = {
    "reached": action_messages.SUCCEEDED,
    "cancelled": action_messages.PREEMPTED,
    "preempted": action_messages.PREEMPTED,
    "aborted": action_messages.ABORTED,
}
_ROS2_STATUS = {
    "reached": action_messages.ROS2_SUCCEEDED,
    "cancelled": action_messages.ROS2_CANCELED,
    "preempted": action_messages.ROS2_ABORTED,
    "aborted": action_messages.ROS2_ABORTED,
}
_PLANNER_SPEEDS = ("max_vel_x", "max_vel_trans")
_STOPPED = "the emergency stop is active"


class PathTopic:
    """nav_msgs/Path: on each new plan, and empty at its end."""

    def __init__(self, ros: RosContext, name: str) -> None:
        self._ros = ros
        self._topic = ros.publishes(name, "nav_msgs", "Path")
        self._published = 0
        self._published_goal: str | None = None
        ros.every(1, self._publish_change)

    def _publish_change(self) -> None:
        robot = self._ros.robot
        now = (robot.plans_made, robot.goal_id)
        if now == (self._published, self._published_goal):
            return
        self._published, self._published_goal = now
        points = np.array(robot.path_in_map, dtype=np.float32).reshape(-1, 2)
        frame = self._ros.frame(self._ros.model.map_frame)
        message = encode_path(self._ros.dialect, points, stamp_ns=self._ros.stamp_ns(), frame_id=frame)
        self._ros.publish(self._topic, message)


class MoveBaseTopics:
    """move_base, or only its simple goal topic."""

    def __init__(self, ros: RosContext, navigation: Navigation) -> None:
        self._ros = ros
        self._robot = ros.robot
        self._numbers = itertools.count(1)
        self._server: ActionlibServer | None = None
        ros.every(1, self._finish_ended)
        if navigation.path:
            PathTopic(ros, navigation.path)
        if navigation.name is not None:
            ros.every(_STATUS_EVERY_STEPS, self._publish_progress)
            self._server = ActionlibServer(
                ros, navigation.name, "move_base_msgs", "MoveBase", on_goal=self._on_goal, on_cancel=self._on_cancel
            )
        ros.obeys(navigation.simple_goal, "geometry_msgs", "PoseStamped", self._on_simple_goal)
        if navigation.planner is not None:
            ros.serves(f"{navigation.planner}/set_parameters", "dynamic_reconfigure", "Reconfigure", self._reconfigure)

    def _reconfigure(self, request: Message) -> Message:
        """Speed parameters of a DWAPlannerROS, of which the lower applies."""
        speeds = decode_reconfigured(request, _PLANNER_SPEEDS)
        if speeds:
            self._robot.limit_goals(min(speeds.values()))
        return encode_reconfigure(dict.fromkeys(_PLANNER_SPEEDS, self._robot.goals_at_most_mps))

    def _finish_ended(self) -> None:
        for ended in self._robot.take_ended_goals():
            self._finish(GoalStatus(ended.goal_id, _ROS1_STATUS[ended.ending], ended.detail))

    def _publish_progress(self) -> None:
        progress = self._robot.progress()
        if self._server is not None and progress is not None:
            status = GoalStatus(progress.goal_id, action_messages.ACTIVE, f"{progress.distance_left_m:.2f} m left")
            pose = encode_pose_stamped(Dialect.ROS1, self._robot.pose_in_map, stamp_ns=self._ros.stamp_ns())
            self._server.progress(status, {"base_position": pose})

    def _finish(self, status: GoalStatus) -> None:
        if self._server is not None:
            self._server.finish(status, {})

    def _on_goal(self, goal_id: str, goal: Message) -> None:
        target = part(goal, "target_pose", "MoveBaseGoal")
        self._start(goal_id, message_conversion.decode_pose_stamped(target, stamp_ns=0).pose_in_map)

    def _on_simple_goal(self, message: Message) -> None:
        goal_id = f"simple-{next(self._numbers)}"
        self._start(goal_id, message_conversion.decode_pose_stamped(message, stamp_ns=0).pose_in_map)

    def _start(self, goal_id: str, target: Pose2D) -> None:
        logger.info("Goal %s: %s", goal_id, target)
        if not self._robot.go(goal_id, target):
            self._finish(GoalStatus(goal_id, action_messages.REJECTED, _STOPPED))
        elif self._server is not None and self._robot.goal_id == goal_id:
            self._server.accept(goal_id)

    def _on_cancel(self, goal_id: str) -> None:
        if goal_id in ("", self._robot.goal_id):
            self._robot.cancel_goal()


class NavigateToPoseAction:
    """NavigateToPose action of ROS 2, as rosbridge carries it, and the status topic of every ROS action."""

    def __init__(self, ros: RosContext, navigation: Navigation) -> None:
        if navigation.name is None:
            raise ValueError("a robot of ROS 2 navigates by an action")
        self._ros = ros
        self._robot = ros.robot
        self._replies: dict[str, Callable[[Message], None]] = {}
        self._statuses: dict[str, tuple[int, float]] = {}
        self._uuids: dict[str, bytes] = {}
        self._numbers = itertools.count(1)
        ros.every(1, self._finish_ended)
        if navigation.path:
            PathTopic(ros, navigation.path)
        ros.every(_STATUS_EVERY_STEPS, self._publish_progress)
        name = ros.model.absolute(navigation.name)
        kind = action_type_name(Dialect.ROS2, "nav2_msgs", "NavigateToPose")
        ros.server.actions[name] = Action(kind, self._start, self._cancel)
        cancel_type = service_type_name(Dialect.ROS2, "action_msgs", "CancelGoal")
        ros.server.services[f"{name}/_action/cancel_goal"] = SimulatedService(cancel_type, self._cancel_service)
        self._status = ros.publishes(f"{name}/_action/status", "action_msgs", "GoalStatusArray", latched=True)
        ros.obeys(navigation.simple_goal, "geometry_msgs", "PoseStamped", self._on_goal_pose)
        if navigation.speed_limit is not None:
            ros.obeys(navigation.speed_limit, "nav2_msgs", "SpeedLimit", self._on_speed_limit)

    def _on_speed_limit(self, message: Message) -> None:
        limit, percentage = decode_speed_limit(message)
        if limit == NO_LIMIT:
            self._robot.limit_goals(CRUISE_MPS)
        else:
            self._robot.limit_goals(limit / 100.0 * CRUISE_MPS if percentage else limit)

    def _finish_ended(self) -> None:
        for ended in self._robot.take_ended_goals():
            self._finish(ended)

    def _publish_progress(self) -> None:
        progress = self._robot.progress()
        if progress is not None and progress.goal_id in self._replies:
            values = action_messages.encode_navigate_to_pose_feedback(
                self._robot.pose_in_map,
                distance_left_m=progress.distance_left_m,
                time_left_s=progress.distance_left_m / CRUISE_MPS,
                elapsed_s=progress.elapsed_s,
                stamp_ns=self._ros.stamp_ns(),
            )
            self._replies[progress.goal_id]({"op": "action_feedback", "values": values})

    def _finish(self, ended: GoalEnded) -> None:
        self._set_status(ended.goal_id, _ROS2_STATUS[ended.ending])
        reply = self._replies.pop(ended.goal_id, None)
        if reply is not None:
            values = {"error_code": 0 if ended.ending == "reached" else 100, "error_msg": ended.detail}
            reply({"op": "action_result", "values": values, "status": _ROS2_STATUS[ended.ending], "result": True})

    def _start(self, goal_id: str, goal: Message, reply: Callable[[Message], None]) -> None:
        target = action_messages.decode_navigate_to_pose_goal(goal)
        if goal_id in self._replies:
            raise MessageError(f"a goal with the id '{goal_id}' is already active")
        logger.info("Goal %s: %s", goal_id, target)
        self._replies[goal_id] = reply
        self._go(goal_id, target)

    def _go(self, goal_id: str, target: Pose2D) -> None:
        if not self._robot.go(goal_id, target):
            self._finish(GoalEnded(goal_id, "aborted", _STOPPED))
        elif self._robot.goal_id == goal_id:
            self._set_status(goal_id, action_messages.ROS2_EXECUTING)

    def _cancel(self, goal_id: str) -> None:
        if goal_id == self._robot.goal_id:
            self._robot.cancel_goal()

    def _cancel_service(self, arguments: Message) -> Message:
        """action_msgs/CancelGoal, for every goal or for one by the UUID of the status topic."""
        running = self._robot.goal_id
        if not action_messages.means_every_goal(arguments) and _uuid_in(arguments) != self._uuids.get(running or ""):
            return {"return_code": action_messages.CANCEL_UNKNOWN_GOAL, "goals_canceling": []}
        self._robot.cancel_goal()
        canceling = [self._goal_info(running)] if running is not None else []
        return {"return_code": action_messages.CANCEL_ACCEPTED, "goals_canceling": canceling}

    def _on_goal_pose(self, message: Message) -> None:
        target = message_conversion.decode_pose_stamped(message, stamp_ns=0).pose_in_map
        self._go(f"goal_pose-{next(self._numbers)}", target)

    def _set_status(self, goal_id: str, status: int) -> None:
        now_s = self._robot.now_s
        self._uuids.setdefault(goal_id, secrets.token_bytes(16))
        self._statuses[goal_id] = (status, now_s)
        for old, (old_status, since_s) in list(self._statuses.items()):
            if old_status >= action_messages.ROS2_SUCCEEDED and now_s - since_s > _FINISHED_LISTED_S:
                del self._statuses[old], self._uuids[old]
        entries = [
            {"goal_info": self._goal_info(listed), "status": listed_status}
            for listed, (listed_status, _) in self._statuses.items()
        ]
        self._ros.publish(self._status, {"status_list": entries})

    def _goal_info(self, goal_id: str) -> Fields:
        uuid = list(self._uuids.get(goal_id, bytes(16)))
        return {"goal_id": {"uuid": uuid}, "stamp": encode_time(Dialect.ROS2, self._ros.stamp_ns())}


def _uuid_in(arguments: Message) -> bytes | None:
    info = message_of(arguments.get("goal_info", {}), "CancelGoal.goal_info")
    uuid = message_of(info.get("goal_id", {}), "CancelGoal.goal_info.goal_id").get("uuid")
    if isinstance(uuid, list) and all(isinstance(octet, int) and 0 <= octet <= 255 for octet in uuid):
        return bytes(uuid)
    return uuid if isinstance(uuid, bytes) else None
