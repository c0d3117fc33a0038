"""Action goals of ROS 1 (actionlib) and ROS 2 (through rosbridge), in particular navigation."""

from typing import Any, Literal

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.value_class import Value
from caris_desktop.ros.dialect import Dialect, encode_time
from caris_desktop.ros.message_conversion import decode_pose_stamped, encode_pose_stamped
from caris_desktop.ros.message_fields import (
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
    time_of,
    truth,
)

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
ROS2_ENDINGS: dict[int, Ending] = {ROS2_SUCCEEDED: "reached", ROS2_CANCELED: "cancelled", ROS2_ABORTED: "failed"}


class GoalStatus(Value):
    """State of one actionlib goal; ``status`` is a number of actionlib_msgs/GoalStatus."""

    goal_id: str
    status: int
    detail: str = ""

    @property
    def ending(self) -> Ending | None:
        """Outcome of the goal, None while it is active."""
        return _ENDINGS.get(self.status)


class GoalFeedback(Value):
    """Progress of a navigation goal; values are None if not reported."""

    pose_in_map: Pose2D | None
    distance_left_m: float | None


class GoalResult(Value):
    """Outcome of a ROS 2 goal."""

    ending: Ending
    detail: str = ""


def encode_goal_id(dialect: Dialect, goal_id: str, *, stamp_ns: int = 0) -> Message:
    """Encode actionlib_msgs/GoalID. On the cancel topic an empty id with zero time cancels every goal."""
    return {"stamp": encode_time(dialect, stamp_ns), "id": goal_id}


def decode_goal_id(message: Any) -> str:
    """Id of an actionlib_msgs/GoalID, possibly empty."""
    return text(message_of(message, "GoalID"), "id", "GoalID", most=_MAX_GOAL_ID_CHARS)


def encode_action_goal(goal_id: str, goal: Message, *, stamp_ns: int) -> Message:
    """Encode the ActionGoal of any ROS 1 action."""
    return {
        "header": encode_header(Dialect.ROS1, stamp_ns=stamp_ns, frame_id=""),
        "goal_id": encode_goal_id(Dialect.ROS1, goal_id, stamp_ns=stamp_ns),
        "goal": goal,
    }


def encode_action_feedback(status: GoalStatus, feedback: Message, *, stamp_ns: int) -> Message:
    """Encode the ActionFeedback of any ROS 1 action."""
    return {**_actionlib_envelope(status, stamp_ns), "feedback": feedback}


def decode_action_feedback(message: Any, what: str) -> tuple[GoalStatus, Message]:
    """Status and feedback of any ROS 1 action's ActionFeedback."""
    action_feedback = message_of(message, what)
    status = _decode_status(part(action_feedback, "status", what), f"{what}.status")
    return status, part(action_feedback, "feedback", what)


def encode_action_result(status: GoalStatus, result: Message, *, stamp_ns: int) -> Message:
    """Encode the ActionResult of any ROS 1 action."""
    return {**_actionlib_envelope(status, stamp_ns), "result": result}


def decode_action_result(message: Any, what: str) -> tuple[GoalStatus, Message]:
    """Final status and result of any ROS 1 action's ActionResult."""
    action_result = message_of(message, what)
    status = _decode_status(part(action_result, "status", what), f"{what}.status")
    return status, part(action_result, "result", what) if "result" in action_result else {}


def encode_move_base_target(target_in_map: Pose2D, *, stamp_ns: int, frame_id: str = "map") -> Message:
    """Encode move_base_msgs/MoveBaseGoal."""
    return {"target_pose": encode_pose_stamped(Dialect.ROS1, target_in_map, stamp_ns=stamp_ns, frame_id=frame_id)}


def decode_move_base_feedback(feedback: Any) -> GoalFeedback:
    """Decode move_base_msgs/MoveBaseFeedback, which has a pose and no distance."""
    base_position = part(message_of(feedback, "MoveBaseFeedback"), "base_position", "MoveBaseFeedback")
    return GoalFeedback(decode_pose_stamped(base_position, stamp_ns=0).pose_in_map, None)


def encode_goal_status_array(statuses: list[GoalStatus], *, stamp_ns: int) -> Message:
    """Encode actionlib_msgs/GoalStatusArray."""
    return {
        "header": encode_header(Dialect.ROS1, stamp_ns=stamp_ns, frame_id=""),
        "status_list": [_encode_status(status, stamp_ns) for status in statuses],
    }


def decode_goal_status_array(message: Any) -> tuple[GoalStatus, ...]:
    """Decode actionlib_msgs/GoalStatusArray."""
    what = "GoalStatusArray"
    entries = objects(message_of(message, what), "status_list", what, most=_MAX_GOALS)
    return tuple(_decode_status(entry, f"{what}.status_list[{index}]") for index, entry in enumerate(entries))


def decode_ros2_goal_status_array(message: Any) -> tuple[tuple[str, int], ...]:
    """Decode action_msgs/GoalStatusArray: UUID of each goal as 32 hexadecimal digits, and its status."""
    what = "GoalStatusArray"
    entries = objects(message_of(message, what), "status_list", what, most=_MAX_GOALS)
    return tuple(
        (
            _uuid_of(part(part(entry, "goal_info", what), "goal_id", f"{what}.goal_info"), f"{what}.goal_info").hex(),
            count(entry, "status", what, most=255),
        )
        for entry in entries
    )


def encode_cancel_goal(uuid_hex: str) -> Message:
    """Encode the request of action_msgs/srv/CancelGoal for one goal."""
    stamp = encode_time(Dialect.ROS2, 0)
    return {"goal_info": {"goal_id": {"uuid": list(bytes.fromhex(uuid_hex))}, "stamp": stamp}}


def encode_navigate_to_pose_goal(target_in_map: Pose2D, *, stamp_ns: int, frame_id: str = "map") -> Message:
    """Encode the goal (``args`` of ``send_action_goal``) of nav2_msgs/action/NavigateToPose."""
    pose = encode_pose_stamped(Dialect.ROS2, target_in_map, stamp_ns=stamp_ns, frame_id=frame_id)
    return {"pose": pose, "behavior_tree": ""}


def encode_cancel_every_goal() -> Message:
    """Encode the request of action_msgs/srv/CancelGoal for every goal: zero id and zero time."""
    stamp = encode_time(Dialect.ROS2, 0)
    return {"goal_info": {"goal_id": {"uuid": [0] * _UUID_BYTES}, "stamp": stamp}}


def means_every_goal(message: Any) -> bool:
    """True if a request of action_msgs/srv/CancelGoal is for every goal; ROS fills omitted fields with zero."""
    what = "CancelGoal.goal_info"
    info = message_of(message_of(message, "CancelGoal").get("goal_info", {}), what)
    goal_id = message_of(info.get("goal_id", {}), f"{what}.goal_id")
    octets = _uuid_of(goal_id, f"{what}.goal_id") if "uuid" in goal_id else b""
    stamp_ns = time_of(info, "stamp", what) if "stamp" in info else None
    return stamp_ns is None and not any(octets)


def decode_navigate_to_pose_goal(message: Any) -> Pose2D:
    """Target of a NavigateToPose goal."""
    goal = message_of(message, "NavigateToPose goal")
    return decode_pose_stamped(part(goal, "pose", "NavigateToPose goal"), stamp_ns=0).pose_in_map


def encode_navigate_to_pose_feedback(
    pose_in_map: Pose2D, *, distance_left_m: float, time_left_s: float, elapsed_s: float, stamp_ns: int
) -> Message:
    """Encode the ``values`` of NavigateToPose's ``action_feedback``."""
    return {
        "current_pose": encode_pose_stamped(Dialect.ROS2, pose_in_map, stamp_ns=stamp_ns),
        "navigation_time": encode_time(Dialect.ROS2, int(elapsed_s * 1e9)),
        "estimated_time_remaining": encode_time(Dialect.ROS2, int(time_left_s * 1e9)),
        "number_of_recoveries": 0,
        "distance_remaining": distance_left_m,
    }


def decode_navigate_to_pose_feedback(feedback: Any) -> GoalFeedback:
    """Decode the ``values`` of NavigateToPose's ``action_feedback``."""
    what = "NavigateToPose feedback"
    values = message_of(feedback, what)
    pose = None
    if "current_pose" in values:
        pose = decode_pose_stamped(values["current_pose"], stamp_ns=0).pose_in_map
    distance_m = number_or_none(values, "distance_remaining", what) if "distance_remaining" in values else None
    return GoalFeedback(pose, distance_m)


def decode_ros2_result(operation: Any) -> GoalResult:
    """Decode a whole rosbridge ``action_result`` operation.

    A failed call has ``result: false`` and a text instead of values.
    """
    what = "action_result"
    envelope = message_of(operation, what)
    status = count(envelope, "status", what, most=255) if envelope.get("status") is not None else None
    values = envelope.get("values")
    detail = values.get("error_msg", "") if isinstance(values, dict) else values
    detail = detail if isinstance(detail, str) else ""
    if status in ROS2_ENDINGS:
        return GoalResult(ROS2_ENDINGS[status], detail)
    succeeded = truth(envelope, "result", what) if "result" in envelope else False
    return GoalResult("reached" if succeeded and status is None else "failed", detail)


def action_package_and_name(action_type: str) -> tuple[str, str]:
    """Package and name of an action type in either dialect: ``pal_interaction_msgs/TtsAction``,
    ``nav2_msgs/action/NavigateToPose``.
    """
    package, _, name = action_type.partition("/")
    name = name.removeprefix("action/")
    return package, name.removesuffix("Action") or name


def _uuid_of(goal_id: Message, what: str) -> bytes:
    uuid = goal_id.get("uuid")
    # A list, or rosbridge's form of uint8[]: base64 text in JSON, bytes in CBOR.
    if isinstance(uuid, list):
        try:
            return bytes(uuid)
        except (TypeError, ValueError) as error:
            raise MessageError(f"{what}.uuid must contain bytes") from error
    return blob(goal_id, "uuid", what, most=_UUID_BYTES)


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
