"""Navigation goals as ROS 1 (actionlib on move_base) and ROS 2 (NavigateToPose through rosbridge) carry them."""

from dataclasses import dataclass
from typing import Any, Literal

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.ros.dialect import Dialect, decode_time, encode_time
from caris_desktop.ros.fields import (
    Message,
    MessageError,
    blob,
    count,
    encode_header,
    message_of,
    number_or_none,
    objects,
    part,
    text,
    text_or_empty,
    truth,
)
from caris_desktop.ros.messages import decode_pose_stamped, encode_pose_stamped

Ending = Literal["reached", "cancelled", "failed"]

PENDING, ACTIVE, PREEMPTED, SUCCEEDED, ABORTED, REJECTED, PREEMPTING, RECALLING, RECALLED, LOST = range(10)
"""actionlib_msgs/GoalStatus."""

ROS2_ACCEPTED, ROS2_EXECUTING, ROS2_CANCELING, ROS2_SUCCEEDED, ROS2_CANCELED, ROS2_ABORTED = range(1, 7)
"""action_msgs/GoalStatus."""

CANCEL_ACCEPTED, CANCEL_REJECTED, CANCEL_UNKNOWN_GOAL = range(3)
"""return_code of action_msgs/srv/CancelGoal."""

_UUID_BYTES = 16
_MAX_GOALS = 1_000
_MAX_GOAL_ID_CHARS = 500
_ENDINGS: dict[int, Ending] = {
    PREEMPTED: "cancelled",
    RECALLED: "cancelled",
    SUCCEEDED: "reached",
    ABORTED: "failed",
    REJECTED: "failed",
    LOST: "failed",
}
_ROS2_ENDINGS: dict[int, Ending] = {
    ROS2_SUCCEEDED: "reached",
    ROS2_CANCELED: "cancelled",
    ROS2_ABORTED: "failed",
}


@dataclass(frozen=True, slots=True)
class GoalStatus:
    """Where one actionlib goal stands; ``status`` is a number of actionlib_msgs/GoalStatus."""

    goal_id: str
    status: int
    detail: str = ""

    @property
    def ending(self) -> Ending | None:
        """How the goal ended, or None while it has not."""
        return _ENDINGS.get(self.status)


@dataclass(frozen=True, slots=True)
class GoalFeedback:
    """Progress of a goal; each value is None where the robot does not tell it."""

    goal_id: str
    pose_in_map: Pose2D | None
    distance_left_m: float | None


@dataclass(frozen=True, slots=True)
class GoalResult:
    """How a ROS 2 goal ended."""

    goal_id: str
    ending: Ending
    detail: str = ""


def encode_goal_id(dialect: Dialect, goal_id: str, *, stamp_ns: int = 0) -> Message:
    """actionlib_msgs/GoalID. On the cancel topic an empty id with the zero time cancels every goal."""
    return {"stamp": encode_time(dialect, stamp_ns), "id": goal_id}


def decode_goal_id(message: Any) -> str:
    """The id of an actionlib_msgs/GoalID, possibly empty."""
    return text(message_of(message, "GoalID"), "id", "GoalID", most=_MAX_GOAL_ID_CHARS)


def encode_move_base_goal(goal_id: str, target_in_map: Pose2D, *, stamp_ns: int) -> Message:
    """move_base_msgs/MoveBaseActionGoal."""
    return {
        "header": encode_header(Dialect.ROS1, stamp_ns=stamp_ns, frame_id=""),
        "goal_id": encode_goal_id(Dialect.ROS1, goal_id, stamp_ns=stamp_ns),
        "goal": {"target_pose": encode_pose_stamped(Dialect.ROS1, target_in_map, stamp_ns=stamp_ns)},
    }


def decode_move_base_goal(message: Any) -> tuple[str, Pose2D]:
    """Goal id and target of a move_base_msgs/MoveBaseActionGoal."""
    what = "MoveBaseActionGoal"
    action_goal = message_of(message, what)
    goal_id = decode_goal_id(part(action_goal, "goal_id", what))
    target = part(part(action_goal, "goal", what), "target_pose", f"{what}.goal")
    return goal_id, decode_pose_stamped(target, stamp_ns=0).pose_in_map


def encode_move_base_feedback(status: GoalStatus, pose_in_map: Pose2D, *, stamp_ns: int) -> Message:
    """move_base_msgs/MoveBaseActionFeedback."""
    return {
        **_actionlib_envelope(status, stamp_ns),
        "feedback": {"base_position": encode_pose_stamped(Dialect.ROS1, pose_in_map, stamp_ns=stamp_ns)},
    }


def decode_move_base_feedback(message: Any) -> GoalFeedback:
    """move_base_msgs/MoveBaseActionFeedback, which tells the pose and no distance."""
    what = "MoveBaseActionFeedback"
    feedback = message_of(message, what)
    status = _decode_status(part(feedback, "status", what), f"{what}.status")
    base_position = part(part(feedback, "feedback", what), "base_position", f"{what}.feedback")
    return GoalFeedback(status.goal_id, decode_pose_stamped(base_position, stamp_ns=0).pose_in_map, None)


def encode_move_base_result(status: GoalStatus, *, stamp_ns: int) -> Message:
    """move_base_msgs/MoveBaseActionResult."""
    return {**_actionlib_envelope(status, stamp_ns), "result": {}}


def decode_move_base_result(message: Any) -> GoalStatus:
    """move_base_msgs/MoveBaseActionResult, whose whole content is the final status."""
    result = message_of(message, "MoveBaseActionResult")
    return _decode_status(part(result, "status", "MoveBaseActionResult"), "MoveBaseActionResult.status")


def encode_goal_status_array(statuses: list[GoalStatus], *, stamp_ns: int) -> Message:
    """actionlib_msgs/GoalStatusArray."""
    return {
        "header": encode_header(Dialect.ROS1, stamp_ns=stamp_ns, frame_id=""),
        "status_list": [_encode_status(status, stamp_ns) for status in statuses],
    }


def decode_goal_status_array(message: Any) -> tuple[GoalStatus, ...]:
    """actionlib_msgs/GoalStatusArray."""
    what = "GoalStatusArray"
    entries = objects(message_of(message, what), "status_list", what, most=_MAX_GOALS)
    return tuple(_decode_status(entry, f"{what}.status_list[{index}]") for index, entry in enumerate(entries))


def encode_navigate_to_pose_goal(target_in_map: Pose2D, *, stamp_ns: int) -> Message:
    """The goal (``args`` of ``send_action_goal``) of nav2_msgs/action/NavigateToPose."""
    return {"pose": encode_pose_stamped(Dialect.ROS2, target_in_map, stamp_ns=stamp_ns), "behavior_tree": ""}


def encode_cancel_every_goal() -> Message:
    """The request of action_msgs/srv/CancelGoal for which a zero id with the zero time means every goal."""
    stamp = encode_time(Dialect.ROS2, 0)
    return {"goal_info": {"goal_id": {"uuid": [0] * _UUID_BYTES}, "stamp": stamp}}


def means_every_goal(message: Any) -> bool:
    """Whether a request of action_msgs/srv/CancelGoal is for every goal; ROS fills fields left out with zero."""
    what = "CancelGoal.goal_info"
    info = message_of(message_of(message, "CancelGoal").get("goal_info", {}), what)
    goal_id = message_of(info.get("goal_id", {}), f"{what}.goal_id")
    uuid = goal_id.get("uuid", [])
    # A list, or what rosbridge makes of uint8[]: base64 text in JSON, a byte string in CBOR.
    octets = uuid if isinstance(uuid, list) else blob(goal_id, "uuid", f"{what}.goal_id", most=_UUID_BYTES)
    try:
        stamp_ns = decode_time(info["stamp"]) if "stamp" in info else None
    except ValueError as error:
        raise MessageError(f"{what}.stamp: {error}") from error
    return stamp_ns is None and not any(octets)


def decode_navigate_to_pose_goal(message: Any) -> Pose2D:
    """The target of a NavigateToPose goal."""
    goal = message_of(message, "NavigateToPose goal")
    return decode_pose_stamped(part(goal, "pose", "NavigateToPose goal"), stamp_ns=0).pose_in_map


def encode_navigate_to_pose_feedback(
    pose_in_map: Pose2D, *, distance_left_m: float, time_left_s: float, elapsed_s: float, stamp_ns: int
) -> Message:
    """The ``values`` of an ``action_feedback`` of NavigateToPose."""
    return {
        "current_pose": encode_pose_stamped(Dialect.ROS2, pose_in_map, stamp_ns=stamp_ns),
        "navigation_time": encode_time(Dialect.ROS2, int(elapsed_s * 1e9)),
        "estimated_time_remaining": encode_time(Dialect.ROS2, int(time_left_s * 1e9)),
        "number_of_recoveries": 0,
        "distance_remaining": distance_left_m,
    }


def decode_navigate_to_pose_feedback(operation: Any) -> GoalFeedback:
    """A whole rosbridge ``action_feedback`` operation."""
    what = "action_feedback"
    envelope = message_of(operation, what)
    values = part(envelope, "values", what)
    pose = None
    if "current_pose" in values:
        pose = decode_pose_stamped(values["current_pose"], stamp_ns=0).pose_in_map
    distance_m = number_or_none(values, "distance_remaining", what) if "distance_remaining" in values else None
    return GoalFeedback(text_or_empty(envelope, "id", what), pose, distance_m)


def decode_navigate_to_pose_result(operation: Any) -> GoalResult:
    """A whole rosbridge ``action_result`` operation.

    A failed call carries ``result: false`` and a text instead of values.
    """
    what = "action_result"
    envelope = message_of(operation, what)
    goal_id = text_or_empty(envelope, "id", what)
    status = count(envelope, "status", what, most=255) if envelope.get("status") is not None else None
    detail = envelope.get("values")
    if isinstance(detail, dict):
        detail = detail.get("error_msg", "")
    detail = detail if isinstance(detail, str) else ""
    if status in _ROS2_ENDINGS:
        return GoalResult(goal_id, _ROS2_ENDINGS[status], detail)
    succeeded = truth(envelope, "result", what) if "result" in envelope else False
    return GoalResult(goal_id, "reached" if succeeded and status is None else "failed", detail)


def _actionlib_envelope(status: GoalStatus, stamp_ns: int) -> Message:
    return {
        "header": encode_header(Dialect.ROS1, stamp_ns=stamp_ns, frame_id=""),
        "status": _encode_status(status, stamp_ns),
    }


def _encode_status(status: GoalStatus, stamp_ns: int) -> Message:
    return {
        "goal_id": encode_goal_id(Dialect.ROS1, status.goal_id, stamp_ns=stamp_ns),
        "status": status.status,
        "text": status.detail,
    }


def _decode_status(message: Message, what: str) -> GoalStatus:
    status = count(message, "status", what, most=255)
    if status > LOST:
        raise MessageError(f"{what}.status {status} is not a state of an actionlib goal")
    return GoalStatus(decode_goal_id(part(message, "goal_id", what)), status, text_or_empty(message, "text", what))
