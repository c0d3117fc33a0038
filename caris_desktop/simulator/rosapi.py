"""Query services of rosapi, for a :class:`BridgeServer`."""

import json
from collections.abc import Callable

from caris_desktop.ros.dialect import Dialect, encode_time, same_type, service_type_name
from caris_desktop.ros.message_fields import text
from caris_desktop.simulator import typedefs
from caris_desktop.simulator.ros_context import RobotClock
from caris_desktop.simulator.server import BRIDGE_NODE, ROBOT_NODE, BridgeServer, CallFailed, Message, SimulatedService


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
