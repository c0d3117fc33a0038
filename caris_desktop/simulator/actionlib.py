"""actionlib server on plain topics: goal and cancel in, status, feedback and result out."""

from collections.abc import Callable

from caris_desktop.ros import action_messages
from caris_desktop.ros.action_messages import GoalStatus
from caris_desktop.ros.message_fields import MessageError, message_of
from caris_desktop.simulator.ros_context import RosContext
from caris_desktop.simulator.server import Message

_STATUS_EVERY_STEPS = 10
_FINISHED_LISTED_S = 5.0


class ActionlibServer:
    """One action server of ROS 1.

    Parameters
    ----------
    name, package, kind
        Such as ``/tts``, ``pal_interaction_msgs``, ``Tts``.
    on_goal
        Receives id and goal; it calls :meth:`accept`, and :meth:`finish` at the end.
    on_cancel
        Receives the id to cancel, empty for all goals.
    """

    def __init__(
        self,
        ros: RosContext,
        name: str,
        package: str,
        kind: str,
        *,
        on_goal: Callable[[str, Message], None],
        on_cancel: Callable[[str], None],
    ) -> None:
        self._ros = ros
        self._on_goal = on_goal
        self._on_cancel = on_cancel
        self._statuses: dict[str, tuple[GoalStatus, float]] = {}
        self._goals = 0
        self.name = ros.model.absolute(name)
        ros.obeys(f"{self.name}/goal", package, f"{kind}ActionGoal", self._on_goal_message)
        ros.obeys(f"{self.name}/cancel", "actionlib_msgs", "GoalID", self._on_cancel_message)
        self._status = ros.publishes(f"{self.name}/status", "actionlib_msgs", "GoalStatusArray")
        self._feedback = ros.publishes(f"{self.name}/feedback", package, f"{kind}ActionFeedback")
        self._result = ros.publishes(f"{self.name}/result", package, f"{kind}ActionResult")
        ros.every(_STATUS_EVERY_STEPS, self._publish_status)

    def new_id(self) -> str:
        """Id for a goal without one."""
        self._goals += 1
        return f"{self.name.strip('/')}-{self._goals}"

    def accept(self, goal_id: str) -> None:
        """Mark the goal as active."""
        self._statuses[goal_id] = (GoalStatus(goal_id, action_messages.ACTIVE), self._ros.robot.now_s)
        self._publish_status()

    def finish(self, status: GoalStatus, result: Message) -> None:
        """Finish the goal with a result."""
        self._statuses[status.goal_id] = (status, self._ros.robot.now_s)
        # the status first: for a client a goal is finished once it has both
        self._publish_status()
        stamp_ns = self._ros.stamp_ns()
        self._ros.publish(self._result, action_messages.encode_action_result(status, result, stamp_ns=stamp_ns))

    def progress(self, status: GoalStatus, feedback: Message) -> None:
        """Publish the goal's feedback."""
        stamp_ns = self._ros.stamp_ns()
        self._ros.publish(self._feedback, action_messages.encode_action_feedback(status, feedback, stamp_ns=stamp_ns))

    def _on_goal_message(self, message: Message) -> None:
        goal = message_of(message.get("goal", {}), "ActionGoal.goal")
        # ROS fills omitted fields
        goal_id = message_of(message.get("goal_id", {}), "ActionGoal.goal_id").get("id") or self.new_id()
        if not isinstance(goal_id, str):
            raise MessageError("ActionGoal.goal_id.id must be a string")
        self._on_goal(goal_id, goal)

    def _on_cancel_message(self, message: Message) -> None:
        goal_id = message.get("id") or ""
        if not isinstance(goal_id, str):
            raise MessageError("GoalID.id must be a string")
        # an empty id means every goal, as does the empty message of actionlib clients
        self._on_cancel(goal_id)

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
