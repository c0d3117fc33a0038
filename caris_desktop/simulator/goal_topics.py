"""Navigation on ROS: goals of move_base (ROS 1) or NavigateToPose (ROS 2), the simple goal topic, and the path."""

import itertools
import logging

import numpy as np

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.ros import action_messages, message_conversion
from caris_desktop.ros.action_messages import GoalStatus
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.message_conversion import NO_LIMIT, decode_reconfigured, decode_speed_limit, encode_reconfigure
from caris_desktop.ros.message_fields import part
from caris_desktop.ros.navigation_messages import encode_path
from caris_desktop.simulator.action_servers import ActionlibServer, ActionServer, Ros2ActionServer
from caris_desktop.simulator.robot_interface import Navigation
from caris_desktop.simulator.ros_context import RosContext
from caris_desktop.simulator.server import Message
from caris_desktop.simulator.simulated_navigation import CRUISE_MPS, Progress

logger = logging.getLogger(__name__)

_PROGRESS_EVERY_STEPS = 10
_STATUS = {
    "reached": action_messages.SUCCEEDED,
    "cancelled": action_messages.PREEMPTED,
    "preempted": action_messages.PREEMPTED,
    "aborted": action_messages.ABORTED,
}
_PLANNER_SPEEDS = ("max_vel_x", "max_vel_trans")


class NavigationTopics:
    """Navigation interfaces of the model."""

    def __init__(self, ros: RosContext, navigation: Navigation) -> None:
        self._ros = ros
        self._robot = ros.robot
        self._is_ros1 = ros.dialect is Dialect.ROS1
        self._numbers = itertools.count(1)
        self._server: ActionServer | None = None
        ros.every(1, self._finish_ended)
        if navigation.path:
            self._path = ros.publishes(navigation.path, "nav_msgs", "Path")
            self._path_of: tuple[int, str | None] = (0, None)
            ros.every(1, self._publish_new_path)
        if navigation.name is not None:
            ros.every(_PROGRESS_EVERY_STEPS, self._publish_progress)
            if self._is_ros1:
                self._server = ActionlibServer(
                    ros, navigation.name, "move_base_msgs", "MoveBase", on_goal=self._on_goal, on_cancel=self._on_cancel
                )
            else:
                self._server = Ros2ActionServer(
                    ros,
                    navigation.name,
                    "nav2_msgs",
                    "NavigateToPose",
                    on_goal=self._on_goal,
                    on_cancel=self._on_cancel,
                    lists_goals=True,
                )
        ros.obeys(navigation.simple_goal, "geometry_msgs", "PoseStamped", self._on_simple_goal)
        if navigation.planner is not None:
            ros.serves(f"{navigation.planner}/set_parameters", "dynamic_reconfigure", "Reconfigure", self._reconfigure)
        if navigation.speed_limit is not None:
            ros.obeys(navigation.speed_limit, "nav2_msgs", "SpeedLimit", self._on_speed_limit)

    def _reconfigure(self, request: Message) -> Message:
        """Speed parameters of a DWAPlannerROS, of which the lower applies."""
        speeds = decode_reconfigured(request, _PLANNER_SPEEDS)
        if speeds:
            self._robot.navigation.limit(min(speeds.values()))
        return encode_reconfigure(dict.fromkeys(_PLANNER_SPEEDS, self._robot.navigation.top_mps))

    def _on_speed_limit(self, message: Message) -> None:
        limit, percentage = decode_speed_limit(message)
        if limit == NO_LIMIT:
            self._robot.navigation.limit(CRUISE_MPS)
        else:
            self._robot.navigation.limit(limit / 100.0 * CRUISE_MPS if percentage else limit)

    def _publish_new_path(self) -> None:
        """Publish the path on each new plan, and an empty one at its end."""
        now = (self._robot.navigation.plans_made, self._robot.navigation.goal_id)
        if now != self._path_of:
            self._path_of = now
            points = np.array(self._robot.path_in_map, dtype=np.float32).reshape(-1, 2)
            self._ros.publish_stamped(self._path, encode_path, points, frame=self._ros.model.map_frame)

    def _publish_progress(self) -> None:
        progress = self._robot.navigation.progress(self._robot.now_s)
        if self._server is not None and progress is not None:
            status = GoalStatus(progress.goal_id, action_messages.ACTIVE, f"{progress.distance_left_m:.2f} m left")
            self._server.progress(status, self._feedback(progress))

    def _feedback(self, progress: Progress) -> Message:
        pose, stamp_ns = self._robot.pose_in_map, self._ros.stamp_ns()
        if self._is_ros1:
            return {"base_position": message_conversion.encode_pose_stamped(Dialect.ROS1, pose, stamp_ns=stamp_ns)}
        return action_messages.encode_navigate_to_pose_feedback(
            pose,
            distance_left_m=progress.distance_left_m,
            time_left_s=progress.distance_left_m / CRUISE_MPS,
            elapsed_s=progress.elapsed_s,
            stamp_ns=stamp_ns,
        )

    def _finish_ended(self) -> None:
        for ended in self._robot.take_ended_goals():
            status = _STATUS[ended.ending]
            if ended.ending == "preempted" and not self._is_ros1:
                status = action_messages.ABORTED
            self._finish(GoalStatus(ended.goal_id, status, ended.detail))

    def _finish(self, status: GoalStatus) -> None:
        if self._server is not None:
            code = 0 if status.status == action_messages.SUCCEEDED else 100
            self._server.finish(status, {} if self._is_ros1 else {"error_code": code, "error_msg": status.detail})

    def _on_goal(self, goal_id: str, goal: Message) -> None:
        if self._is_ros1:
            pose = part(goal, "target_pose", "MoveBaseGoal")
            target = message_conversion.decode_pose_stamped(pose, stamp_ns=0).pose_in_map
        else:
            target = action_messages.decode_navigate_to_pose_goal(goal)
        self._start(goal_id, target)

    def _on_simple_goal(self, message: Message) -> None:
        goal_id = f"{'simple' if self._is_ros1 else 'goal_pose'}-{next(self._numbers)}"
        self._start(goal_id, message_conversion.decode_pose_stamped(message, stamp_ns=0).pose_in_map)

    def _start(self, goal_id: str, target: Pose2D) -> None:
        logger.info("Goal %s: %s", goal_id, target)
        if not self._robot.go(goal_id, target):
            self._finish(GoalStatus(goal_id, action_messages.REJECTED, "the emergency stop is active"))
        elif self._server is not None and self._robot.navigation.goal_id == goal_id:
            self._server.accept(goal_id)

    def _on_cancel(self, goal_id: str) -> None:
        if goal_id in ("", self._robot.navigation.goal_id):
            self._robot.cancel_goal()
