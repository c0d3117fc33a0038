"""Navigation goals on ROS: actionlib on ``/move_base`` for ROS 1, the ``/navigate_to_pose`` action for ROS 2."""

import itertools
import logging
import time
from collections.abc import Callable

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.ros import actions, messages
from caris_desktop.ros.actions import GoalStatus
from caris_desktop.ros.dialect import Dialect, action_type_name, service_type_name, type_name
from caris_desktop.ros.fields import MessageError, message_of
from caris_desktop.simulator.navigation import CRUISE_MPS, GoalEnded, Progress
from caris_desktop.simulator.robot import Robot
from caris_desktop.simulator.server import Action, BridgeServer, Message, Service, Topic

logger = logging.getLogger(__name__)

_STATUS_EVERY_STEPS = 10
_FINISHED_LISTED_S = 5.0
_ROS1_STATUS = {
    "reached": actions.SUCCEEDED,
    "cancelled": actions.PREEMPTED,
    "preempted": actions.PREEMPTED,
    "aborted": actions.ABORTED,
}
_ROS2_STATUS = {
    "reached": actions.ROS2_SUCCEEDED,
    "cancelled": actions.ROS2_CANCELED,
    "preempted": actions.ROS2_ABORTED,
    "aborted": actions.ROS2_ABORTED,
}
_STOPPED = "the emergency stop is pressed"


class MoveBaseTopics:
    """The actionlib topics of move_base."""

    def __init__(self, robot: Robot, server: BridgeServer) -> None:
        self._robot = robot
        self._server = server
        self._statuses: dict[str, tuple[GoalStatus, float]] = {}
        self._numbers = itertools.count(1)
        self._steps = 0
        kind = type_name(Dialect.ROS1, "move_base_msgs", "MoveBaseAction")
        server.topics["/move_base/goal"] = Topic(f"{kind}Goal", on_message=self._on_goal)
        server.topics["/move_base/cancel"] = Topic("actionlib_msgs/GoalID", on_message=self._on_cancel)
        server.topics["/move_base/status"] = Topic("actionlib_msgs/GoalStatusArray")
        server.topics["/move_base/feedback"] = Topic(f"{kind}Feedback")
        server.topics["/move_base/result"] = Topic(f"{kind}Result")
        server.topics["/move_base_simple/goal"] = Topic("geometry_msgs/PoseStamped", on_message=self._on_simple_goal)

    def publish_due(self) -> None:
        """Publish results, feedback and status. Called once after every step of the robot."""
        self._steps += 1
        for ended in self._robot.take_ended_goals():
            self._finish(GoalStatus(ended.goal_id, _ROS1_STATUS[ended.ending], ended.detail))
        if self._steps % _STATUS_EVERY_STEPS == 0:
            self._publish_feedback(self._robot.progress())
            self._publish_status()

    def _publish_feedback(self, progress: Progress | None) -> None:
        if progress is not None:
            status = GoalStatus(progress.goal_id, actions.ACTIVE, f"{progress.distance_left_m:.2f} m left")
            feedback = actions.encode_move_base_feedback(status, self._robot.pose_in_map, stamp_ns=time.time_ns())
            self._server.publish("/move_base/feedback", feedback)

    def _publish_status(self) -> None:
        now_s = self._robot.now_s
        self._statuses = {
            goal_id: (status, since_s)
            for goal_id, (status, since_s) in self._statuses.items()
            if status.ending is None or now_s - since_s < _FINISHED_LISTED_S
        }
        statuses = [status for status, _ in self._statuses.values()]
        array = actions.encode_goal_status_array(statuses, stamp_ns=time.time_ns())
        self._server.publish("/move_base/status", array)

    def _finish(self, status: GoalStatus) -> None:
        self._statuses[status.goal_id] = (status, self._robot.now_s)
        # the status first: a client counts a goal as finished once it has both
        self._publish_status()
        self._server.publish("/move_base/result", actions.encode_move_base_result(status, stamp_ns=time.time_ns()))

    def _on_goal(self, message: Message) -> None:
        goal_id, target = actions.decode_move_base_goal(_with_goal_id(message))
        self._start(goal_id, target)

    def _on_simple_goal(self, message: Message) -> None:
        self._start("", messages.decode_pose_stamped(message, stamp_ns=0).pose_in_map)

    def _start(self, goal_id: str, target: Pose2D) -> None:
        goal_id = goal_id or f"goal-{next(self._numbers)}"
        logger.info("Goal %s: %s", goal_id, target)
        if not self._robot.go(goal_id, target):
            self._finish(GoalStatus(goal_id, actions.REJECTED, _STOPPED))
            return
        if self._robot.goal_id == goal_id:
            self._statuses[goal_id] = (GoalStatus(goal_id, actions.ACTIVE), self._robot.now_s)
            self._publish_status()

    def _on_cancel(self, message: Message) -> None:
        wanted = message.get("id") or ""
        if not isinstance(wanted, str):
            raise MessageError("GoalID.id must be a text")
        # an empty id means every goal, as does the empty message that actionlib clients send
        if wanted in ("", self._robot.goal_id):
            self._robot.cancel_goal()


class NavigateToPoseAction:
    """The NavigateToPose action of ROS 2, as rosbridge carries it."""

    def __init__(self, robot: Robot, server: BridgeServer) -> None:
        self._robot = robot
        self._replies: dict[str, Callable[[Message], None]] = {}
        self._numbers = itertools.count(1)
        self._steps = 0
        kind = action_type_name(Dialect.ROS2, "nav2_msgs", "NavigateToPose")
        server.actions["/navigate_to_pose"] = Action(kind, self._start, self._cancel)
        cancel_type = service_type_name(Dialect.ROS2, "action_msgs", "CancelGoal")
        server.services["/navigate_to_pose/_action/cancel_goal"] = Service(cancel_type, self._cancel_service)
        pose_type = type_name(Dialect.ROS2, "geometry_msgs", "PoseStamped")
        server.topics["/goal_pose"] = Topic(pose_type, on_message=self._on_goal_pose)

    def publish_due(self) -> None:
        """Send results and feedback. Called once after every step of the robot."""
        self._steps += 1
        for ended in self._robot.take_ended_goals():
            self._finish(ended)
        progress = self._robot.progress()
        if self._steps % _STATUS_EVERY_STEPS == 0 and progress is not None and progress.goal_id in self._replies:
            values = actions.encode_navigate_to_pose_feedback(
                self._robot.pose_in_map,
                distance_left_m=progress.distance_left_m,
                time_left_s=progress.distance_left_m / CRUISE_MPS,
                elapsed_s=progress.elapsed_s,
                stamp_ns=time.time_ns(),
            )
            self._replies[progress.goal_id]({"op": "action_feedback", "values": values})

    def _finish(self, ended: GoalEnded) -> None:
        reply = self._replies.pop(ended.goal_id, None)
        if reply is not None:
            values = {"error_code": 0 if ended.ending == "reached" else 100, "error_msg": ended.detail}
            reply({"op": "action_result", "values": values, "status": _ROS2_STATUS[ended.ending], "result": True})

    def _start(self, goal_id: str, goal: Message, reply: Callable[[Message], None]) -> None:
        target = actions.decode_navigate_to_pose_goal(goal)
        if goal_id in self._replies:
            raise MessageError(f"a goal with the id '{goal_id}' is under way already")
        logger.info("Goal %s: %s", goal_id, target)
        self._replies[goal_id] = reply
        if not self._robot.go(goal_id, target):
            self._finish(GoalEnded(goal_id, "aborted", _STOPPED))

    def _cancel(self, goal_id: str) -> None:
        if goal_id == self._robot.goal_id:
            self._robot.cancel_goal()

    def _cancel_service(self, arguments: Message) -> Message:
        """action_msgs/CancelGoal, for every goal: who asks through rosbridge never learns the uuid of one."""
        if not actions.means_every_goal(arguments):
            return {"return_code": actions.CANCEL_UNKNOWN_GOAL, "goals_canceling": []}
        self._robot.cancel_goal()
        return {"return_code": actions.CANCEL_ACCEPTED, "goals_canceling": []}

    def _on_goal_pose(self, message: Message) -> None:
        target = messages.decode_pose_stamped(message, stamp_ns=0).pose_in_map
        self._robot.go(f"goal_pose-{next(self._numbers)}", target)


def _with_goal_id(message: Message) -> Message:
    """ROS itself fills what a client leaves out; a goal without an id gets one here."""
    goal_id = {"id": "", **message_of(message.get("goal_id", {}), "MoveBaseActionGoal.goal_id")}
    return {**message, "goal_id": goal_id}
