"""ROS 2 without rosbridge: the robot plug-in ``ros2``, on rclpy.

It runs in the Python of a ROS 2 installation, which may be 3.10, and imports nothing of this program: see
:class:`caris_desktop.robot.bridge_server.Robot`.
"""

import base64
import contextlib
import functools
import importlib
import importlib.util
import json
import math
import os
import re
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

Message = dict[str, Any]
PYTHON_VARIABLE = "CARIS_ROS2_PYTHON"
_FROM = "Start this program in a terminal with a sourced ROS 2, or run packaging/ros2.sh, which installs one for it."
_OWN_NODES = "caris_desktop_"
_VELOCITIES = ("Twist", "TwistStamped")
_GRAPH_EVERY_S = 0.5
_SERVER_WITHIN_S, _POLLED_EVERY_S = 2.0, 0.02
_HEARD_WITHIN_S, _ASKED_EVERY_S = 0.3, 0.003
_CANCELLED, _LAST_STATUS = 5, 6
_TYPE_NAME = re.compile(r"([a-z][a-z0-9_]*)/(?:(msg|srv|action)/)?([A-Za-z][A-Za-z0-9_]*)")
_ROS2_VALUES = ("", "bool_value", "integer_value", "double_value", "string_value")


class Ros2Robot:
    """Node of one link. ``target`` is the domain; empty for that of the environment (``ROS_DOMAIN_ID``), or 0."""

    caris_interface = 1

    @staticmethod
    def interpreter(_target: str) -> tuple[list[str], dict[str, str]]:
        """Python with rclpy and its environment: of ``CARIS_ROS2_PYTHON``, the sourced ROS 2, or packaging/ros2.sh.

        Raises OSError if there is none.
        """
        environment = dict(os.environ)
        named = os.environ.get(PYTHON_VARIABLE)
        if not named and os.environ.get("ROS_DISTRO"):
            # Python of the system, for which ROS 2 is built: not that of an environment which is active.
            found = ("/usr/bin/python3", shutil.which("python3"))
            python = next((each for each in found if each is not None and Path(each).exists()), None)
            if python is None:
                raise OSError("The Python of the sourced ROS 2 was not found.", f"Set {PYTHON_VARIABLE} to it.")
            return [python], environment
        installed = ros2_folder() / "bin" / "python"
        python = named or str(installed)
        if not named and not installed.exists():
            raise OSError("No ROS 2 was found on this computer.", _FROM)
        if shutil.which(python) is None:
            raise OSError(f"{PYTHON_VARIABLE} names {python}, which cannot be run.", "Correct it, or unset it.")
        environment.pop("PYTHONPATH", None)  # the console's
        return [python], environment

    def __init__(self, target: str) -> None:
        if target and not (target.isdecimal() and int(target) <= 232):
            raise OSError(f"{target!r} is not a ROS 2 domain.", "A domain is a number from 0 to 232: ros2:5.")
        if target:
            os.environ["ROS_DOMAIN_ID"] = target
        try:
            import rclpy
            from rclpy.executors import SingleThreadedExecutor
        except ImportError as error:
            raise OSError(f"{sys.executable} has no ROS 2 ({error}).", _FROM) from error
        self._rclpy: Any = rclpy
        try:
            rclpy.init(args=[])
            self._node: Any = rclpy.create_node(
                f"{_OWN_NODES}{os.getpid()}", enable_rosout=False, start_parameter_services=False
            )
        except Exception as error:
            raise OSError(
                f"ROS 2 could not be started ({error}).", "Check ROS_DOMAIN_ID and RMW_IMPLEMENTATION."
            ) from error
        domain = os.environ.get("ROS_DOMAIN_ID") or "0"
        self.absent = (
            f"No robot was found in ROS 2 domain {domain}.",
            "Check that the robot is turned on and on the same network, and that its ROS_DOMAIN_ID is the same "
            "(ros2:DOMAIN). ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_LOCALHOST_ONLY may hide it.",
        )
        self._lock = threading.RLock()
        self._publishers: dict[str, _Publisher] = {}
        self._subscriptions: list[_Subscription] = []
        self._clients: dict[tuple[str, str], Any] = {}
        self._heard_s = 0.0
        self._closed = threading.Event()
        executor = SingleThreadedExecutor()
        executor.add_node(self._node)
        threading.Thread(target=executor.spin, name="executor", daemon=True).start()
        threading.Thread(target=self._watch_graph, name="graph", daemon=True).start()

    def close(self) -> None:
        self._closed.set()
        with contextlib.suppress(Exception):  # the process ends
            self._rclpy.try_shutdown()

    # The graph

    def is_present(self) -> bool:
        """Whether anything but consoles and tools is there."""
        return any(not name.startswith(("_", _OWN_NODES)) for name in self._node.get_node_names())

    def interfaces(self) -> dict[str, dict[str, str]]:
        """Of other nodes: a name that only consoles use is none of the robot."""
        with self._lock:
            ours = {*self._publishers, *(subscription.topic for subscription in self._subscriptions)}
        topics = {
            name: types[0]
            for name, types in self._node.get_topic_names_and_types()
            if name not in ours or self._has_others(name)
        }
        services = {name: types[0] for name, types in self._node.get_service_names_and_types()}
        suffix, ending = "/_action/send_goal", "_SendGoal"
        actions = {
            name[: -len(suffix)]: kind[: -len(ending)]
            for name, kind in services.items()
            if name.endswith(suffix) and kind.endswith(ending)
        }
        return {"topics": topics, "services": services, "actions": actions}

    def _has_others(self, topic: str) -> bool:
        found = (*self._node.get_publishers_info_by_topic(topic), *self._node.get_subscriptions_info_by_topic(topic))
        return any(not end.node_name.startswith(_OWN_NODES) for end in found)

    def ask(self, question: str, arguments: Message) -> Message:
        """Answer a question of rosapi. Raises LookupError."""
        if question == "publishers":
            return {question: self._nodes(self._node.get_publishers_info_by_topic(arguments["topic"]))}
        if question == "subscribers":
            return {question: self._nodes(self._node.get_subscriptions_info_by_topic(arguments["topic"]))}
        if question == "message_details":
            return {"typedefs": _typedefs(_type(arguments["type"]))}
        if question == "service_request_details":
            return {"typedefs": _typedefs(_type(arguments["type"]).Request)}
        if question == "action_goal_details":
            return {"typedefs": _typedefs(_type(arguments["type"]).Goal)}
        if question == "get_param":
            node, _, name = arguments["name"].partition(":")
            (value,) = self.call(f"{node}/get_parameters", {"names": [name]}, _SERVER_WITHIN_S)["values"]
            kind = value["type"]
            return {"value": json.dumps(value[_ROS2_VALUES[kind]]) if 0 < kind < len(_ROS2_VALUES) else ""}
        raise LookupError(f"Service /rosapi/{question} does not exist")

    def _nodes(self, ends: Iterable[Any]) -> list[str]:
        own = self._node.get_name()
        return [f"{end.node_namespace.rstrip('/')}/{end.node_name}" for end in ends if end.node_name != own]

    def _watch_graph(self) -> None:
        """Renew what does not fit the quality of service of the other side."""
        while not self._closed.wait(_GRAPH_EVERY_S):
            with self._lock:
                each: list[_Publisher | _Subscription] = [*self._publishers.values(), *self._subscriptions]
            for one in each:
                with self._lock:
                    one.renew()

    # Topics

    def subscribe(
        self, topic: str, type_name: str, deliver: Callable[[Message], None], queue_length: int
    ) -> Callable[[], None]:
        def on_message(message: Any) -> None:
            if topic not in self._publishers:  # where our own messages come back
                self._heard_s = time.monotonic()
            deliver(_to_dict(message))

        subscription = _Subscription(self._node, topic, _type(type_name), on_message, queue_length or 100)
        with self._lock:
            subscription.renew()
            self._subscriptions.append(subscription)

        def stop() -> None:
            with self._lock:
                self._subscriptions.remove(subscription)
                subscription.close()

        return stop

    def publish(self, topic: str, type_name: str, message: Message | None, *, latch: bool) -> None:
        publisher = self._publishers.get(topic)
        if publisher is None:
            with self._lock:
                publisher = self._publishers.setdefault(topic, _Publisher(self._node, topic, _type(type_name), latch))
                publisher.renew()
        if message is not None:
            publisher.send(message)

    def received(self, timeout_s: float) -> bool:
        """Whether the subscribers have acknowledged the velocities. One that has crashed does not count while the robot
        is heard: DDS waits for it for 20 s.
        """
        velocities = [each for each in list(self._publishers.values()) if each.moves]
        until_s = time.monotonic() + timeout_s
        while not all(each.is_acknowledged() for each in velocities):
            now_s = time.monotonic()
            if now_s >= until_s:
                return now_s - self._heard_s < _HEARD_WITHIN_S
            time.sleep(_ASKED_EVERY_S)
        return True

    # Services and actions

    def call(self, service: str, request: Message, timeout_s: float) -> Message:
        type_name = self.interfaces()["services"].get(service)
        if type_name is None:
            raise LookupError(f"Service {service} does not exist")
        kind = _type(type_name)
        filled = _fill(kind.Request(), request, self._now)
        with self._lock:
            client = self._clients.get((service, type_name)) or self._node.create_client(kind, service)
            self._clients[service, type_name] = client
        _wait_until(client.service_is_ready, f"{service} does not respond")
        future = client.call_async(filled)
        try:
            return _to_dict(_result(future, timeout_s))  # type: ignore[no-any-return]
        except TimeoutError as error:
            client.remove_pending_request(future)
            raise TimeoutError(f"no response within {timeout_s:g} s") from error

    def run_goal(
        self,
        action: str,
        type_name: str,
        goal: Message,
        feedback: Callable[[Message], None],
        cancelled: threading.Event,
    ) -> tuple[int, Message]:
        from rclpy.action import ActionClient

        kind = _type(type_name)
        filled = _fill(kind.Goal(), goal, self._now)
        with self._lock:
            client = self._clients.get((action, type_name)) or ActionClient(self._node, kind, action)
            self._clients[action, type_name] = client
        _wait_until(client.server_is_ready, f"the action server {action} does not respond", cancelled)
        if cancelled.is_set():
            return _CANCELLED, {}
        sent = client.send_goal_async(filled, feedback_callback=lambda message: feedback(_to_dict(message.feedback)))
        handle = _result(sent, math.inf)
        if not handle.accepted:
            raise RuntimeError("the robot refused the goal")
        result = handle.get_result_async()
        while not result.done() and not cancelled.wait(_POLLED_EVERY_S):
            pass
        if not result.done():
            handle.cancel_goal_async()
        ended = _result(result, math.inf)
        return min(int(ended.status), _LAST_STATUS), _to_dict(ended.result)

    def _now(self) -> Any:
        return self._node.get_clock().now().to_msg()


class _Publisher:
    """Publisher that every subscriber of its topic accepts."""

    def __init__(self, node: Any, topic: str, kind: Any, latch: bool) -> None:
        self._node = node
        self._topic = topic
        self._kind = kind
        self._latch = latch
        self._made: Any = None
        self._lasting = latch
        self.moves = kind.__name__ in _VELOCITIES

    def renew(self) -> None:
        """Create it, and again once a subscriber asks for what was sent before."""
        from rclpy.qos import DurabilityPolicy, QoSProfile

        asked = (end.qos_profile.durability for end in self._node.get_subscriptions_info_by_topic(self._topic))
        lasting = self._latch or (not self.moves and DurabilityPolicy.TRANSIENT_LOCAL in asked)
        if self._made is not None and lasting <= self._lasting:
            return
        policy = DurabilityPolicy.TRANSIENT_LOCAL if lasting else DurabilityPolicy.VOLATILE
        # Of velocities only the newest: an older one must never be sent again.
        quality = QoSProfile(depth=1 if self.moves or lasting else 10, durability=policy)
        before, self._lasting = self._made, lasting
        self._made = self._node.create_publisher(self._kind, self._topic, quality)
        if before is not None:
            self._node.destroy_publisher(before)

    def send(self, message: Message) -> None:
        self._made.publish(_fill(self._kind(), message, lambda: self._node.get_clock().now().to_msg()))

    def is_acknowledged(self) -> bool:
        """Whether every subscriber has what was sent. Without waiting, which would hold all threads of Python."""
        from rclpy.duration import Duration

        return bool(self._made.wait_for_all_acked(Duration()))


class _Subscription:
    """Subscription with the quality of service of the topic's publishers."""

    def __init__(self, node: Any, topic: str, kind: Any, on_message: Callable[[Any], None], depth: int) -> None:
        self._node = node
        self.topic = topic
        self._kind = kind
        self._on_message = on_message
        self._depth = depth
        self._made: Any = None
        self._asked: tuple[bool, bool] | None = None

    def renew(self) -> None:
        """Create it, and again once the publishers offer something else."""
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        offered = [end.qos_profile for end in self._node.get_publishers_info_by_topic(self.topic)]
        if not offered and self._asked is not None:
            return
        # What all publishers offer: a subscription that asks for more gets nothing from the others.
        reliable = bool(offered) and all(each.reliability == ReliabilityPolicy.RELIABLE for each in offered)
        lasting = bool(offered) and all(each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in offered)
        if (reliable, lasting) == self._asked:
            return
        self.close()
        self._asked = reliable, lasting
        quality = QoSProfile(
            depth=self._depth,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if lasting else DurabilityPolicy.VOLATILE,
        )
        self._made = self._node.create_subscription(self._kind, self.topic, self._on_message, quality)

    def close(self) -> None:
        if self._made is not None:
            self._node.destroy_subscription(self._made)
            self._made = None


def ros2_folder() -> Path:
    """Where packaging/ros2.sh installs a ROS 2 for this program."""
    data = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    return Path(data) / "caris-desktop" / "ros2"


def _wait_until(ready: Callable[[], bool], problem: str, cancelled: threading.Event | None = None) -> None:
    until_s = time.monotonic() + _SERVER_WITHIN_S
    while not ready() and not (cancelled is not None and cancelled.is_set()):
        if time.monotonic() > until_s:
            raise TimeoutError(problem)
        time.sleep(_POLLED_EVERY_S)


def _result(future: Any, timeout_s: float) -> Any:
    done = threading.Event()
    future.add_done_callback(lambda _future: done.set())
    if not done.wait(None if math.isinf(timeout_s) else timeout_s):
        raise TimeoutError
    return future.result()


# Messages as dictionaries


@functools.cache
def _type(name: str) -> Any:
    """Class of a type such as ``geometry_msgs/msg/Twist``. Raises LookupError.

    Only generated packages of messages are imported, since the name comes from a file or the network: importing any
    other module would run its code.
    """
    found = _TYPE_NAME.fullmatch(name)
    package, kind, plain = found.groups() if found is not None else ("", "", "")
    try:
        spec = importlib.util.find_spec(package) if package else None
        places = [] if spec is None else spec.submodule_search_locations or []
        if any(True for place in places for _ in Path(place).glob(f"{package}_s__rosidl_typesupport_c*")):
            return getattr(importlib.import_module(f"{package}.{kind or 'msg'}"), plain)
    except (ImportError, AttributeError, ValueError) as error:
        raise LookupError(f"the type {name} is not installed in this ROS 2") from error
    raise LookupError(f"the type {name} is not installed in this ROS 2")


def _to_dict(value: Any) -> Any:
    if hasattr(value, "get_fields_and_field_types"):
        return {name: _to_dict(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, list):
        return b"".join(value) if value and isinstance(value[0], bytes) else [_to_dict(each) for each in value]
    return value[0] if isinstance(value, bytes) and len(value) == 1 else value


def _fill(message: Any, values: Message, now: Callable[[], Any]) -> Any:
    """``message`` with these fields, and the time in a header without one. Raises ValueError, TypeError."""
    kinds = message.get_fields_and_field_types()
    for name, value in values.items():
        if name not in kinds:
            raise ValueError(f"{type(message).__name__} has no field {name!r}")
        try:
            setattr(message, name, _from_plain(kinds[name], value, now))
        except AssertionError as error:
            raise ValueError(f"{type(message).__name__}.{name}: {error}") from error
    if kinds.get("header") == "std_msgs/Header" and "stamp" not in (values.get("header") or {}):
        message.header.stamp = now()
    return message


def _from_plain(kind: str, value: Any, now: Callable[[], Any]) -> Any:
    """Value of a field of this kind, such as ``sequence<double>``, from JSON."""
    base, length = _split(kind)
    if length is not None:
        if isinstance(value, str):
            value = base64.b64decode(value)
        return [_from_plain(base, each, now) for each in value]
    if base in ("float", "double"):
        return math.nan if value is None else float(value)
    if base == "boolean":
        return bool(value)
    if base in ("string", "wstring"):
        return str(value)
    if base == "octet":
        return bytes((value,))
    if "/" not in base:
        return int(value)
    return _fill(_type(base)(), value, now)


def _split(kind: str) -> tuple[str, int | None]:
    """Kind of a field's values, and how many: None for a single one, 0 for any number."""
    found = re.fullmatch(r"sequence<(.+?)(?:, \d+)?>|(.+)\[(\d+)\]", kind)
    base, length = (kind, None) if found is None else (found[1] or found[2], int(found[3] or 0))
    return base.partition("<")[0], length


def _typedefs(kind: Any) -> list[Message]:
    """Fields of a message class and of those in it, as rosapi reports them."""
    found: dict[str, Message] = {}
    waiting = [("", kind)]
    while waiting:
        name, each = waiting.pop(0)
        fields = {field: _split(of) for field, of in each.get_fields_and_field_types().items()}
        found[name] = {
            "type": name or each.__name__,
            "fieldnames": list(fields),
            "fieldtypes": [base for base, _ in fields.values()],
            "fieldarraylen": [-1 if length is None else length for _, length in fields.values()],
        }
        inner = {base for base, _ in fields.values() if "/" in base}
        waiting += [(base, _type(base)) for base in sorted(inner) if base not in found]
    return list(found.values())
