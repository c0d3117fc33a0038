"""Action clients: actionlib's topics in ROS 1, rosbridge's goal operations in ROS 2."""

import asyncio
import logging
import time
from collections.abc import Mapping
from typing import Any, Protocol
from uuid import uuid4

import roslibpy

from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.robot.transport import RosbridgeClient, RosbridgeTopic
from caris_desktop.ros.action_messages import (
    ACTIVE,
    PENDING,
    PREEMPTING,
    ROS2_ACCEPTED,
    ROS2_CANCELING,
    ROS2_ENDINGS,
    ROS2_EXECUTING,
    Ending,
    action_package_and_name,
    decode_action_feedback,
    decode_action_result,
    decode_goal_status_array,
    decode_ros2_goal_status_array,
    decode_ros2_result,
    encode_action_goal,
    encode_cancel_every_goal,
    encode_cancel_goal,
    encode_goal_id,
)
from caris_desktop.ros.dialect import Dialect, action_type_name, service_type_name
from caris_desktop.ros.message_fields import Message, MessageError

logger = logging.getLogger(__name__)

FATE_WITHIN_S = 5.0
"""How long a goal may be without news after a lost link, and after its return: actionlib lists for five seconds what is
over, so who was away for longer does not learn of it any more."""
FATE_UNKNOWN = QT_TR_NOOP("the link to the robot was lost, and the outcome is unknown")
_REMEMBERED_GOALS = 20
_ADOPTED_WITHIN_S = 2.0
"""A goal of ours turns up on the status topic within this time; what turns up later is somebody else's."""
_PROVEN_WITHIN_S = 0.3
_CANCELLED_WITHIN_S = 4.0
"""Then the websocket of a cancelled goal is closed: rosbridge does not say that one was refused."""
_ENDED_WITHOUT_REASON: dict[Ending, str] = {
    "reached": "",
    "cancelled": "",
    "failed": QT_TR_NOOP("the robot aborted without giving a reason"),
}


class GoalListener(Protocol):
    """Receiver of an action server's reports. ``wire_id`` identifies the goal; goals of other clients are reported too.

    A lost link ends no goal. An outcome in the meantime is reported after reconnection, if the robot still has it.
    """

    def goal_pending(self, wire_id: str) -> None: ...

    def goal_active(self, wire_id: str) -> None: ...

    def goal_feedback(self, wire_id: str, feedback: Message) -> None: ...

    def goal_ended(self, wire_id: str, ending: Ending, detail: str) -> None: ...


class ActionClient(Protocol):
    """Interface for sending goals. No call waits, and nothing is queued for later."""

    def send(self, goal_id: str, goal: Message) -> str | None:
        """Send a goal; return its id on the robot, or None if it could not be sent."""

    def cancel(self, wire_id: str) -> None:
        """Cancel one goal."""

    def give_up(self, wire_id: str) -> None:
        """Cancel one goal without any response, and expect none."""

    def cancel_all(self) -> None:
        """Cancel all goals of the action server, from any client."""

    def close(self) -> None:
        """Unsubscribe."""


def make_action_client(
    ros: RosbridgeClient, name: str, action_type: str, listener: GoalListener, *, motion: bool = False
) -> ActionClient:
    """Client of the action server ``name``; ``action_type`` may be spelled as in either dialect.

    ``motion``: goals that are topics go over the motion websocket, which has no slow operations, like their cancels.
    """
    package, type_ = action_package_and_name(action_type)
    if ros.dialect is Dialect.ROS1:
        return ActionlibClient(ros, name, package, type_, listener, motion=motion)
    return BridgedActionClient(
        ros, name, action_type_name(Dialect.ROS2, package, type_), listener, proven_by_feedback=motion
    )


class ActionlibClient:
    """actionlib's topics, permanently subscribed, so that goals need no polling."""

    def __init__(
        self, ros: RosbridgeClient, name: str, package: str, type_: str, listener: GoalListener, *, motion: bool
    ) -> None:
        def topic(leaf: str, package: str, message: str, *, motion: bool = False) -> RosbridgeTopic:
            kind = f"{package}/{message}"
            return RosbridgeTopic(ros, f"{name}/{leaf}", kind, queue_length=10, every_message=True, motion=motion)

        self._listener = listener
        self._type = f"{type_}Action"
        self._goal = topic("goal", package, f"{self._type}Goal", motion=motion)
        self._cancel = topic("cancel", "actionlib_msgs", "GoalID", motion=motion)
        self._status = topic("status", "actionlib_msgs", "GoalStatusArray")
        self._feedback = topic("feedback", package, f"{self._type}Feedback")
        self._result = topic("result", package, f"{self._type}Result")
        self._goal.advertise()
        self._cancel.advertise()
        self._status.subscribe(self._on_status)
        self._feedback.subscribe(self._on_feedback)
        self._result.subscribe(self._on_result)

    def send(self, goal_id: str, goal: Message) -> str | None:
        wire_id = f"{goal_id}-{uuid4().hex[:8]}"
        # Stamp zero: the clocks may differ, and actionlib drops goals that seem too old.
        return wire_id if self._goal.publish(encode_action_goal(wire_id, goal, stamp_ns=0)) else None

    def cancel(self, wire_id: str) -> None:
        self._cancel.publish(encode_goal_id(Dialect.ROS1, wire_id))

    def give_up(self, wire_id: str) -> None:
        self.cancel(wire_id)

    def cancel_all(self) -> None:
        self._cancel.publish(encode_goal_id(Dialect.ROS1, ""))

    def close(self) -> None:
        for topic in (self._status, self._feedback, self._result):
            topic.unsubscribe()
        for topic in (self._goal, self._cancel):
            topic.unadvertise()

    def _on_status(self, message: Any) -> None:
        for status in decode_goal_status_array(message):
            if status.ending is not None:
                self._ended(status.goal_id, status.ending, status.detail)
            elif status.status in (ACTIVE, PREEMPTING):
                self._listener.goal_active(status.goal_id)
            elif status.status == PENDING:
                self._listener.goal_pending(status.goal_id)

    def _on_feedback(self, message: Any) -> None:
        status, feedback = decode_action_feedback(message, f"{self._type}Feedback")
        self._listener.goal_feedback(status.goal_id, feedback)

    def _on_result(self, message: Any) -> None:
        status, _ = decode_action_result(message, f"{self._type}Result")
        if status.ending is not None:
            self._ended(status.goal_id, status.ending, status.detail)

    def _ended(self, goal_id: str, ending: Ending, detail: str) -> None:
        self._listener.goal_ended(goal_id, ending, detail or _ENDED_WITHOUT_REASON[ending])


class BridgedActionClient:
    """ROS 2 action through rosbridge's send_action_goal.

    rosbridge reports neither acceptance nor UUID of a goal; the action's own status topic does. Nor can we choose the
    UUID: rosbridge cannot load the types of an action's services and topics, which rosidl does not export. So a goal
    on the status topic counts as ours only if no other goal can be; with ``proven_by_feedback`` only after feedback
    for ours, since ours may have been refused and the listed goal be another client's.
    """

    def __init__(
        self, ros: RosbridgeClient, name: str, action_type: str, listener: GoalListener, *, proven_by_feedback: bool
    ) -> None:
        self._ros = ros
        self._name = name
        self._listener = listener
        self._client = roslibpy.ActionClient(ros, name, action_type)
        self._known_uuids: set[str] = set()
        self._uuid_of: dict[str, str] = {}
        # Goal whose UUID is not known yet, and its sending time.
        self._unknown: str | None = None
        self._sent_s = 0.0
        self._adopted: str | None = None
        self._proven_by_feedback = proven_by_feedback
        self._with_feedback: str | None = None
        # Newly listed goal that may be ours.
        self._uuid_without_proof: tuple[str, str] | None = None
        # Their answers were lost with the link that they were requested over.
        self._unanswered: set[str] = set()
        # Times of the last cancel: one before the goal was accepted had no effect.
        self._cancelled: dict[str, float] = {}
        ros.factory.urgent_services.add(f"{name}/_action/cancel_goal")
        status_type = "action_msgs/GoalStatusArray"
        self._status = RosbridgeTopic(ros, f"{name}/_action/status", status_type, queue_length=10, every_message=True)
        self._status.subscribe(self._on_status)

    def send(self, goal_id: str, goal: Message) -> str | None:
        if not self._ros.is_connected:
            return None
        wire_ids: list[str] = []

        def feedback(values: Mapping[str, Any]) -> None:
            self._with_feedback = wire_ids[0]
            self._name_proven()
            self._cancel_again(wire_ids[0])
            self._listener.goal_feedback(wire_ids[0], dict(values))

        def failed(results: Mapping[str, Any]) -> None:
            if wire_ids:
                ended(results, worked=False)
            else:  # it cannot be sent, and has no id yet
                asyncio.get_running_loop().call_soon(failed, results)

        def ended(results: Mapping[str, Any], *, worked: bool) -> None:
            if self._unknown == wire_ids[0]:
                self._unknown = None  # refused, or over before it was listed: later goals are not ours
            if not self._ros.is_connected:
                self._unanswered.add(wire_ids[0])
                return
            operation = {"status": results["status"].value or None, "values": results["values"], "result": worked}
            try:
                result = decode_ros2_result(operation)
            except MessageError as error:
                # Whatever the answer, the goal is over.
                logger.info("%s: %s", self._name, error)
                self._listener.goal_ended(wire_ids[0], "failed", QT_TR_NOOP("the robot's response cannot be read"))
                return
            detail = result.detail or _ENDED_WITHOUT_REASON[result.ending]
            self._listener.goal_ended(wire_ids[0], result.ending, detail)

        wire_ids.append(
            self._client.send_goal(
                goal,
                lambda results: ended(results, worked=True),
                feedback,
                failed,
            )
        )
        self._unknown, self._adopted, self._sent_s = wire_ids[0], None, time.monotonic()
        self._uuid_without_proof = None
        return wire_ids[0]

    def cancel(self, wire_id: str) -> None:
        self._client.cancel_goal(wire_id)
        self._note_cancelled(wire_id)
        while len(self._cancelled) > _REMEMBERED_GOALS:
            del self._cancelled[next(iter(self._cancelled))]
        uuid_hex = self._uuid_of.get(wire_id)
        if uuid_hex is not None:
            # rosbridge before 2.1 accepts the operation above without effect.
            self._call_cancel(encode_cancel_goal(uuid_hex))
        elif self._uuid_without_proof is not None and self._uuid_without_proof[0] == wire_id:
            asyncio.get_running_loop().call_later(_PROVEN_WITHIN_S, self._cancel_without_proof, wire_id)

    def _note_cancelled(self, wire_id: str) -> None:
        self._cancelled[wire_id] = now_s = time.monotonic()
        asyncio.get_running_loop().call_later(_CANCELLED_WITHIN_S, self._abandon, wire_id, now_s)

    def _abandon(self, wire_id: str, cancelled_s: float) -> None:
        if self._cancelled.get(wire_id) == cancelled_s:
            self._ros.factory.give_up_goal(wire_id)

    def _cancel_again(self, wire_id: str) -> None:
        """End a goal that goes on after its cancel: a restarted rosbridge may lose its acceptance and its listing."""
        cancelled_s = self._cancelled.get(wire_id)
        if cancelled_s is not None and time.monotonic() - cancelled_s >= _PROVEN_WITHIN_S:
            self._note_cancelled(wire_id)
            if wire_id not in self._uuid_of:
                self.cancel_all()

    def _cancel_without_proof(self, wire_id: str) -> None:
        """For a server without feedback, behind a rosbridge that does not cancel: end whatever moves the robot."""
        unproven = self._uuid_without_proof is not None and self._uuid_without_proof[0] == wire_id
        if unproven and self._ros.is_connected and self._ros.factory.has_goal(wire_id):
            self.cancel_all()

    def give_up(self, wire_id: str) -> None:
        self.cancel(wire_id)
        self._ros.factory.give_up_goal(wire_id)

    def cancel_all(self) -> None:
        # rosbridge cancels only goals of this connection. The action's own service knows every goal.
        self._call_cancel(encode_cancel_every_goal())

    def close(self) -> None:
        self._status.unsubscribe()

    def _call_cancel(self, request: Message) -> None:
        kind = service_type_name(Dialect.ROS2, "action_msgs", "CancelGoal")
        roslibpy.Service(self._ros, f"{self._name}/_action/cancel_goal", kind).call(
            roslibpy.ServiceRequest(request),
            lambda _: None,
            lambda reason: logger.info("%s: the robot did not cancel: %s", self._name, reason),
        )

    def _on_status(self, message: Any) -> None:
        known, self._known_uuids = self._known_uuids, set()
        for uuid_hex, status in decode_ros2_goal_status_array(message):
            self._known_uuids.add(uuid_hex)
            self._report_unanswered(uuid_hex, status)
            if uuid_hex in known:
                continue
            if status not in (ROS2_ACCEPTED, ROS2_EXECUTING, ROS2_CANCELING):
                continue
            if time.monotonic() - self._sent_s > _ADOPTED_WITHIN_S:
                self._unknown = self._adopted = None
            if self._adopted is not None:
                # A second goal: either may be ours. Without its UUID, only rosbridge can cancel ours.
                self._uuid_of.pop(self._adopted, None)
                self._adopted = self._uuid_without_proof = None
            wire_id = self._unknown
            if wire_id is not None:
                # First goal listed after ours was sent.
                self._unknown, self._adopted = None, wire_id
                self._uuid_without_proof = wire_id, uuid_hex
                self._name_proven()
                self._listener.goal_active(wire_id)

    def _name_proven(self) -> None:
        """Accept the newly listed goal as ours once the required feedback has arrived."""
        if self._uuid_without_proof is None:
            return
        wire_id, uuid_hex = self._uuid_without_proof
        if self._proven_by_feedback and self._with_feedback != wire_id:
            return
        self._uuid_without_proof = None
        # Retained although it seems to have ended: after a lost link it continues, identified by this UUID only.
        self._uuid_of[wire_id] = uuid_hex
        while len(self._uuid_of) > _REMEMBERED_GOALS:
            del self._uuid_of[next(iter(self._uuid_of))]
        if wire_id in self._cancelled:
            self.cancel(wire_id)

    def _report_unanswered(self, uuid_hex: str, status: int) -> None:
        wire_id = next((name for name in self._unanswered if self._uuid_of.get(name) == uuid_hex), None)
        if wire_id is None:
            return
        ending = ROS2_ENDINGS.get(status)
        if ending is None:
            self._listener.goal_active(wire_id)
        else:
            self._unanswered.discard(wire_id)
            self._listener.goal_ended(wire_id, ending, _ENDED_WITHOUT_REASON[ending])
