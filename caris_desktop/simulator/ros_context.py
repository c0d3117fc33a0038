"""Simulated robot on ROS: topics, services, action servers and rosapi."""

import json
import secrets
import time
from collections.abc import Callable
from dataclasses import field
from typing import Any

from caris_desktop.domain.value_class import dataclass
from caris_desktop.ros import action_messages
from caris_desktop.ros.action_messages import GoalStatus
from caris_desktop.ros.dialect import Dialect, action_type_name, encode_time, same_type, service_type_name, type_name
from caris_desktop.ros.message_fields import MessageError, message_of, text
from caris_desktop.simulator import typedefs
from caris_desktop.simulator.faults import Faults
from caris_desktop.simulator.robot_models import RobotInterface
from caris_desktop.simulator.robot_simulation import Robot
from caris_desktop.simulator.server import (
    BRIDGE_NODE,
    ROBOT_NODE,
    Action,
    BridgeServer,
    CallFailed,
    Message,
    SimulatedService,
    Topic,
)

# Clock of the simulated robot: this computer's, one with offset and drift, or simulation time.

_NS_PER_S = 1_000_000_000


class RobotClock:
    """Robot time.

    Parameters
    ----------
    simulated_s
        Simulation time, where the robot goes by that; None for this computer's clock.
    """

    def __init__(self, simulated_s: Callable[[], float] | None = None) -> None:
        self._simulated_s = simulated_s
        self._offset_ns = 0
        self._drift = 0.0
        self._drifts_from_ns = 0

    def now_ns(self) -> int:
        """Time for stamps."""
        true_ns = self._true_ns()
        return true_ns + self._offset_ns + round((true_ns - self._drifts_from_ns) * self._drift)

    def now_s(self) -> float:
        return self.now_ns() / _NS_PER_S

    def disagree(self, *, offset_s: float = 0.0, drift_ppm: float = 0.0) -> None:
        """Set an offset of ``offset_s`` and a drift of ``drift_ppm``."""
        self._offset_ns = round(offset_s * _NS_PER_S)
        self._drift = drift_ppm * 1e-6
        self._drifts_from_ns = self._true_ns()

    def _true_ns(self) -> int:
        return time.time_ns() if self._simulated_s is None else round(self._simulated_s() * _NS_PER_S)


_WRONG_FRAME = "nowhere"


@dataclass(slots=True)
class RosContext:
    """``faults`` are the present ones. Names are those of the model: relative ones are in its namespace."""

    robot: Robot
    server: BridgeServer
    model: RobotInterface
    clock: RobotClock
    faults: Faults = field(default_factory=Faults)
    _steps: int = 0
    _periodic: list[tuple[int, str, Callable[[], None]]] = field(default_factory=list)

    @property
    def dialect(self) -> Dialect:
        return self.model.dialect

    def stamp_ns(self) -> int:
        return self.clock.now_ns()

    def frame(self, name: str) -> str:
        """Frame for a header: the true one, unless that fault is injected."""
        return _WRONG_FRAME if self.faults.frames_wrong else name

    def publishes(self, name: str, package: str, kind: str, *, latched: bool = False) -> str:
        """Register a topic that the robot publishes; return its absolute name."""
        absolute = self.model.absolute(name)
        self.server.topics[absolute] = Topic(type_name(self.dialect, package, kind), latched, publishers={ROBOT_NODE})
        return absolute

    def obeys(
        self,
        name: str,
        package: str,
        kind: str,
        on_message: Callable[[Message], None],
        *,
        other_types: tuple[str, ...] = (),
    ) -> None:
        """Register a topic that the robot subscribes to, with type checks as in rosbridge."""
        type_ = type_name(self.dialect, package, kind)
        self.server.topics[self.model.absolute(name)] = Topic(type_, on_message=on_message, other_types=other_types)

    def serves(self, name: str, package: str, kind: str, call: Callable[[Message], Message]) -> None:
        """Register a service, with type checks as in rosbridge."""
        self.server.services[self.model.absolute(name)] = SimulatedService(
            service_type_name(self.dialect, package, kind), call
        )

    def every(self, steps: int, publish: Callable[[], None], topic: str = "") -> None:
        """Call ``publish`` every ``steps`` simulation steps; with a ``topic``, only while that has subscribers."""
        self._periodic.append((steps, topic, publish))

    def publish_due(self) -> None:
        """Publish due messages, in the order of :meth:`every`; called after every simulation step."""
        self._steps += 1
        for steps, topic, publish in self._periodic:
            if self._steps % steps == 0 and (not topic or self.wanted(topic)):
                publish()

    def wanted(self, name: str) -> bool:
        """True if the topic (absolute name) has subscribers."""
        return self.server.has_subscribers(name)

    def publish(self, name: str, message: Message) -> None:
        """Publish by absolute name."""
        self.server.publish(name, message)

    def publish_stamped(
        self, name: str, encode: Callable[..., Message], content: Any, *, frame: str = "", **options: Any
    ) -> None:
        """Publish ``content`` as an encoder of :mod:`caris_desktop.ros` writes it, stamped with the present time."""
        header = {"stamp_ns": self.stamp_ns(), "frame_id": self.frame(frame)}
        self.publish(name, encode(self.dialect, content, **header, **options))


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
        """Mark the goal as active."""
        self._set_status(GoalStatus(goal_id, action_messages.ACTIVE))

    def progress(self, status: GoalStatus, feedback: Message) -> None:
        """Publish the goal's feedback."""
        message = action_messages.encode_action_feedback(status, feedback, stamp_ns=self._ros.stamp_ns())
        self._ros.publish(self._feedback, message)

    def finish(self, status: GoalStatus, result: Message) -> None:
        """Finish the goal with a result."""
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


ActionServer = ActionlibServer | Ros2ActionServer
"""Server of one action. Statuses are those of actionlib_msgs/GoalStatus in either ROS."""


def _uuid_in(arguments: Message) -> bytes | None:
    info = message_of(arguments.get("goal_info", {}), "CancelGoal.goal_info")
    uuid = message_of(info.get("goal_id", {}), "CancelGoal.goal_info.goal_id").get("uuid")
    if isinstance(uuid, list) and all(isinstance(octet, int) and 0 <= octet <= 255 for octet in uuid):
        return bytes(uuid)
    return uuid if isinstance(uuid, bytes) else None


def offer_rosapi(server: BridgeServer, dialect: Dialect, *, clock: RobotClock | None = None) -> None:
    """Add the ``/rosapi/...`` services to ``server``."""
    robot_clock = clock or RobotClock()
    package = "rosapi" if dialect is Dialect.ROS1 else "rosapi_msgs"

    def offer(path: str, type_: str, call: Callable[[Message], Message]) -> None:
        server.services[f"/rosapi/{path}"] = SimulatedService(service_type_name(dialect, package, type_), call)

    def name_in(arguments: Message, key: str) -> str:
        return text(arguments, key, "args", most=500)

    def topics(_: Message) -> Message:
        names = sorted(server.topics)
        answer = {"topics": names, "types": [server.topics[name].type for name in names]}
        return answer if dialect is Dialect.ROS1 else {**answer, "typedefs_full_text": []}

    def topic_type(arguments: Message) -> Message:
        topic = server.topics.get(name_in(arguments, "topic"))
        return {"type": topic.type if topic else ""}

    def topics_for_type(arguments: Message) -> Message:
        type_name = name_in(arguments, "type")
        return {"topics": [name for name, topic in sorted(server.topics.items()) if same_type(topic.type, type_name)]}

    def all_services() -> dict[str, str]:
        offered = {name: service.type for name, service in server.services.items()}
        for client in server.clients:
            offered.update(client.services)
        return offered

    def services_for_type(arguments: Message) -> Message:
        type_name = name_in(arguments, "type")
        return {"services": [name for name, type_ in sorted(all_services().items()) if same_type(type_, type_name)]}

    def service_node(arguments: Message) -> Message:
        service_name = name_in(arguments, "service")
        offered = any(service_name in client.services for client in server.clients)
        return {"node": ROBOT_NODE if service_name in server.services else BRIDGE_NODE if offered else ""}

    def node_details(arguments: Message) -> Message:
        node = name_in(arguments, "node")
        of_clients = sorted(name for client in server.clients for name in client.services)
        return {
            "subscribing": [name for name in sorted(server.topics) if node in listeners(name)],
            "publishing": [name for name in sorted(server.topics) if node in speakers(name)],
            "services": sorted(server.services) if node == ROBOT_NODE else of_clients if node == BRIDGE_NODE else [],
        }

    def speakers(name: str) -> list[str]:
        """Publishers of a topic; to ROS all clients are one node: the bridge."""
        topic = server.topics.get(name)
        return sorted({node if node == ROBOT_NODE else BRIDGE_NODE for node in topic.publishers}) if topic else []

    def listeners(name: str) -> list[str]:
        topic = server.topics.get(name)
        robot_listens = topic is not None and topic.on_message is not None
        return [BRIDGE_NODE] * server.has_subscribers(name) + [ROBOT_NODE] * robot_listens

    def action_servers(_: Message) -> Message:
        names = set(server.actions)
        # as rosapi finds ROS 1 actions: by their topics
        for topic in server.topics:
            base, leaf = topic.rsplit("/", 1)
            if leaf == "goal" and all(f"{base}/{other}" in server.topics for other in ("cancel", "status", "result")):
                names.add(base)
        return {"action_servers": sorted(names)}

    def action_type(arguments: Message) -> Message:
        name = name_in(arguments, "action")
        action, goal = server.actions.get(name), server.topics.get(f"{name}/goal")
        if action is not None:
            return {"type": action.type}
        return {"type": goal.type.removesuffix("Goal") if goal and goal.type.endswith("ActionGoal") else ""}

    def details(part: int) -> Callable[[Message], Message]:
        return lambda arguments: {"typedefs": typedefs.typedefs_of(dialect, installed(arguments), part)}

    def installed(arguments: Message) -> str:
        kind = name_in(arguments, "type")
        if not typedefs.is_known(dialect, kind):
            raise CallFailed(f"Unable to load the manifest for package {kind.partition('/')[0]}")
        return kind

    def get_param(arguments: Message) -> Message:
        name = name_in(arguments, "name")
        return {"value": json.dumps(server.params[name]() if name in server.params else None)}

    offer("topics", "Topics", topics)
    offer("topic_type", "TopicType", topic_type)
    offer("topics_for_type", "TopicsForType", topics_for_type)
    offer("services", "Services", lambda _: {"services": sorted(all_services())})
    offer("service_type", "ServiceType", lambda args: {"type": all_services().get(name_in(args, "service"), "")})
    offer("services_for_type", "ServicesForType", services_for_type)
    offer("service_node", "ServiceNode", service_node)
    offer("nodes", "Nodes", lambda _: {"nodes": [BRIDGE_NODE, ROBOT_NODE]})
    offer("node_details", "NodeDetails", node_details)
    offer("publishers", "Publishers", lambda args: {"publishers": speakers(name_in(args, "topic"))})
    offer("subscribers", "Subscribers", lambda args: {"subscribers": listeners(name_in(args, "topic"))})
    offer("get_time", "GetTime", lambda _: {"time": encode_time(dialect, robot_clock.now_ns())})
    offer("action_servers", "GetActionServers", action_servers)
    offer("get_param", "GetParam", get_param)
    offer("get_param_names", "GetParamNames", lambda _: {"names": sorted(server.params)})
    offer("has_param", "HasParam", lambda args: {"exists": name_in(args, "name") in server.params})
    offer("message_details", "MessageDetails", details(0))
    offer("service_request_details", "ServiceRequestDetails", details(0))
    offer("service_response_details", "ServiceResponseDetails", details(1))
    if dialect is Dialect.ROS2:
        offer("action_type", "ActionType", action_type)
        offer("get_ros_version", "GetROSVersion", lambda _: {"version": dialect.value, "distro": "jazzy"})
        offer("action_goal_details", "ActionGoalDetails", details(0))
        offer("action_result_details", "ActionResultDetails", details(1))
        offer("action_feedback_details", "ActionFeedbackDetails", details(2))
