"""Server of rosbridge's protocol on loopback, for one robot plug-in, in the plug-in's process.

It needs the standard library of Python 3.10 alone, since it also runs as a program in the Python of a plug-in with an
environment of its own (``interpreter`` of the plug-in): ``bridge_server.py FILE:CLASS TARGET DESCRIPTOR`` serves on the
listening socket of that descriptor. The token comes over standard input, whose end is the end of the program.

Long-running requests have a thread each, so that velocities and stops never wait. The server itself holds the robot
when nobody else can: a velocity that is not renewed for ``LAPSE_S``, and one whose connection ended, is followed by
zero for ``ZERO_REPEAT_S``; goals of a connection that ended are cancelled; velocities from before a suspension of this
process are dropped.
"""

import base64
import contextlib
import hashlib
import importlib.util
import itertools
import json
import logging
import math
import os
import queue
import secrets
import socket
import struct
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, Protocol

logger = logging.getLogger("caris_desktop.bridge")

READY, UNUSABLE = "caris-bridge ready", "caris-bridge unusable "
"""Beginnings of its lines on standard output; behind the second one is JSON: [what, advice]."""
LAPSE_S = 0.4
"""The link renews a velocity at 5 Hz or more."""
ZERO_REPEAT_S, _WATCHED_EVERY_S, _STALE_S = 0.5, 0.05, 0.1
_PRESENT_EVERY_S, _ABSENT_AFTER_S = 0.5, 3.0
_SENT_WITHIN_S, _RECEIVED_WITHIN_S = 5.0, 0.03
_MOST_WAITING, _MOST_THREADS = 1_000, 32
_MOST_BYTES, _HEAD_BYTES = 16 * 2**20, 16 * 2**10
_OWN_TOPICS, _NOBODY = "/caris_desktop/", "/caris_desktop/no_such_service"
VELOCITIES = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
_ANSWERED_QUESTIONS = "/rosapi/"
_SUCCEEDED = 4
_KEY_SUFFIX = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"  # of RFC 6455
_TEXT, _BINARY, _CLOSE, _PING, _PONG = 1, 2, 8, 9, 10
_CBOR_TAGS = {"b": 72, "H": 69, "I": 70, "L": 71, "Q": 71, "h": 77, "i": 78, "l": 79, "q": 79, "f": 85, "d": 86}
"""Of RFC 8746, by format of the buffer; long integers have eight bytes where ROS 2 runs."""

Message = dict[str, Any]


class Robot(Protocol):
    """Interface of a robot plug-in, version 1: robots that are reached without a rosbridge.

    The entry point of the group ``caris_desktop.robots`` is a class. The program makes one instance in a process that
    serves one link, and calls its methods from several threads at once. Messages are dictionaries of ROS 2 form:
    ``{"linear": {"x": 0.2}}``; fields may be missing and have their default then. Lists of numbers may be
    ``array.array`` or NumPy arrays, those of bytes ``bytes``. Names and types are those of ROS 2:
    ``/cmd_vel``, ``geometry_msgs/msg/Twist``.

    Motion lease, obstacle guard, emergency stop and zero are the program's. The plug-in passes on what it gets, at
    once, and queues nothing: velocities come as Twist or TwistStamped, and zero is one of them.

    Optional: ``interpreter(target)``, a static method that returns the command of the Python which runs the plug-in,
    and its environment; that Python needs no package of this program, so the module of the class imports none.
    ``ask(question, arguments)`` answers further questions of rosapi, or raises LookupError. ``is_present()`` is False
    while the robot is not there; ``absent`` is what to say then, and an advice. ``received(timeout_s)`` is False if the
    robot has not received the last velocities within that time.
    """

    caris_interface: int

    def __init__(self, target: str) -> None:
        """Connect to ``target``: the part of the robot's address behind the first colon, possibly empty.

        Raises OSError with a text for the user if that is not possible.
        """

    def interfaces(self) -> dict[str, dict[str, str]]:
        """``topics``, ``services`` and ``actions``: type by name. At most a few milliseconds."""

    def subscribe(
        self, topic: str, type_name: str, deliver: Callable[[Message], None], queue_length: int
    ) -> Callable[[], None]:
        """Call ``deliver`` with each message, from any thread, until the returned function is called."""

    def publish(self, topic: str, type_name: str, message: Message | None, *, latch: bool) -> None:
        """Send one message without waiting; None as ``message`` only prepares for it. Raises ValueError."""

    def call(self, service: str, request: Message, timeout_s: float) -> Message:
        """Answer of a service. In a thread of its own. Raises an exception with a text if it fails."""

    def run_goal(
        self,
        action: str,
        type_name: str,
        goal: Message,
        feedback: Callable[[Message], None],
        cancelled: threading.Event,
    ) -> tuple[int, Message]:
        """Send a goal and wait for its end: status of action_msgs/GoalStatus (4 to 6) and result.

        In a thread of its own. Cancels the goal once ``cancelled`` is set. Raises an exception with a text if the goal
        is refused.
        """

    def close(self) -> None:
        """Disconnect."""


class BridgeServer:
    """Connections to one robot; all of them are the link's."""

    def __init__(self, robot: Robot, listener: socket.socket, token: str, notify: Callable[[str], None]) -> None:
        self.robot = robot
        self._listener = listener
        self._path = f"/{token}"
        self._notify = notify
        self._lock = threading.Lock()
        self._clients: dict[_Client, None] = {}
        self._goals: dict[str, tuple[_Client, threading.Event]] = {}
        self._velocities: dict[str, _Velocity] = {}
        self._awake_s = time.monotonic()
        self._stale_until_s = 0.0
        self._present = False
        self._ended, self._closed = threading.Event(), threading.Event()
        self._threads = threading.Semaphore(_MOST_THREADS)

    def start(self) -> None:
        """Serve in threads."""
        for work in (self._watch_velocities, self._watch_robot, self._accept):
            threading.Thread(target=work, name=work.__name__, daemon=True).start()

    def close(self) -> None:
        """Leave the robot safe: zero, and no goal of this link."""
        self._ended.set()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._disconnect_all()
        until_s = time.monotonic() + ZERO_REPEAT_S
        while time.monotonic() < until_s and (self._goals or any(each.is_unsafe for each in self._velocities.values())):
            time.sleep(_WATCHED_EVERY_S)
        self._closed.set()
        self.robot.close()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return  # closed
            client = _Client(self, connection, self._path)
            threading.Thread(target=client.serve, args=(self._admit,), name="client", daemon=True).start()

    def _admit(self, client: "_Client") -> bool:
        with self._lock:
            if self._present and not self._ended.is_set():
                self._clients[client] = None
            return client in self._clients

    def _disconnect_all(self) -> None:
        with self._lock:
            clients = list(self._clients)
        for client in clients:
            client.end()
            self.on_disconnected(client)

    def on_disconnected(self, client: "_Client") -> None:
        """The connection is over: nobody stops any more what it set in motion."""
        with self._lock:
            self._clients.pop(client, None)
            goals = [cancelled for owner, cancelled in self._goals.values() if owner is client]
            velocities = [velocity for velocity in self._velocities.values() if velocity.client is client]
        for cancelled in goals:
            cancelled.set()
        for velocity in velocities:
            velocity.lapse()

    def in_thread(self, work: Callable[[], None]) -> bool:
        """Run a request that may take long; False if too many do."""
        if not self._threads.acquire(blocking=False):
            return False

        def run() -> None:
            try:
                work()
            finally:
                self._threads.release()

        threading.Thread(target=run, name="request", daemon=True).start()
        return True

    # Velocities

    def publish(self, client: "_Client", topic: str, type_name: str, message: Message, *, latch: bool) -> None:
        """Pass a message on; a velocity has to be renewed from now on."""
        if type_name not in VELOCITIES:
            self.robot.publish(topic, type_name, message, latch=latch)
            return
        with self._lock:
            velocity = self._velocities.setdefault(topic, _Velocity(self.robot, topic, type_name))
        now_s = time.monotonic()
        if _moves(message) and (now_s - self._awake_s > LAPSE_S or now_s < self._stale_until_s):
            velocity.lapse()  # this process was suspended, and the velocity is from before
        else:
            velocity.send(client, message)

    def _watch_velocities(self) -> None:
        while not self._closed.wait(_WATCHED_EVERY_S):
            now_s = time.monotonic()
            if now_s - self._awake_s > LAPSE_S:
                self._stale_until_s = now_s + _STALE_S
            self._awake_s = now_s
            with self._lock:
                velocities = list(self._velocities.values())
            for velocity in velocities:
                velocity.watch()

    # The robot

    def _watch_robot(self) -> None:
        is_present = getattr(self.robot, "is_present", lambda: True)
        present_s = time.monotonic()
        while not self._ended.wait(_PRESENT_EVERY_S if self._present else _WATCHED_EVERY_S):
            now_s = time.monotonic()
            if is_present():
                present_s = now_s
                if not self._present:
                    self._present = True
                    self._notify(READY)
            elif now_s - present_s >= _ABSENT_AFTER_S:
                present_s = now_s
                self._present = False
                self._notify(UNUSABLE + json.dumps(list(self.robot.absent)))  # type: ignore[attr-defined]
                self._disconnect_all()

    # Goals

    def begin_goal(self, client: "_Client", goal_id: str) -> threading.Event:
        cancelled = threading.Event()
        with self._lock:
            self._goals[goal_id] = client, cancelled
        return cancelled

    def end_goal(self, goal_id: str) -> None:
        with self._lock:
            self._goals.pop(goal_id, None)

    def cancel_goal(self, goal_id: str) -> None:
        with self._lock:
            found = self._goals.get(goal_id)
        if found is not None:
            found[1].set()


class _Velocity:
    """Last velocity of one topic, followed by zero if nobody renews it."""

    def __init__(self, robot: Robot, topic: str, type_name: str) -> None:
        self.topic = topic
        self.client: _Client | None = None
        self._robot = robot
        self._type = type_name
        self._lock = threading.Lock()  # no velocity of the link comes after a zero of the watch that it preceded
        self._renewed_s = 0.0
        self._moving = False
        self._zeros_until_s = 0.0

    @property
    def is_unsafe(self) -> bool:
        """Whether zero has not been sent for long enough."""
        return self._moving or time.monotonic() < self._zeros_until_s

    def send(self, client: "_Client", message: Message) -> None:
        with self._lock:
            if not client.is_open:
                return  # its zero has been sent
            self.client, self._renewed_s, self._moving = client, time.monotonic(), _moves(message)
            self._zeros_until_s = 0.0
            self._robot.publish(self.topic, self._type, message, latch=False)

    def lapse(self) -> None:
        """Send zero, if it was moving, and go on for a moment."""
        with self._lock:
            if self._moving:
                self._moving = False
                self._zeros_until_s = time.monotonic() + ZERO_REPEAT_S
                self._send_zero()

    def watch(self) -> None:
        if self._moving and time.monotonic() - self._renewed_s >= LAPSE_S:
            self.lapse()
        with self._lock:
            if time.monotonic() < self._zeros_until_s:
                self._send_zero()

    def _send_zero(self) -> None:
        try:
            self._robot.publish(self.topic, self._type, {}, latch=False)
        except Exception:
            logger.exception("zero was not sent to %s", self.topic)


class _Subscription:
    """Subscription of one connection: several subscribers of a topic get each message once, as from rosbridge."""

    def __init__(self, topic: str, put: Callable[[Any, Callable[[], tuple[int, bytes]]], None]) -> None:
        self.requests: dict[str, Message] = {}
        self.stop: Callable[[], None] = lambda: None
        self._topic = topic
        self._put = put
        self._numbers = itertools.count()
        self._next_s = 0.0

    @property
    def queue_length(self) -> int:
        """Most messages that wait: 1 if the newest is enough for all, 0 for no limit."""
        lengths = [int(request.get("queue_length", 0)) for request in list(self.requests.values())]
        return 0 if 0 in lengths else max(lengths, default=1)

    def deliver(self, message: Message) -> None:
        """Queue a message, if it is due. Any thread."""
        requests = list(self.requests.values())
        now_s = time.monotonic()
        least_s = min((float(request.get("throttle_rate", 0)) for request in requests), default=0.0) / 1000.0
        if not requests or now_s < self._next_s:
            return
        # Steady on average, whatever the rate of the messages.
        self._next_s = max(self._next_s + least_s, now_s - least_s) if least_s else 0.0
        published = {"op": "publish", "topic": self._topic, "msg": message}
        binary = any(request.get("compression") == "cbor" for request in requests)
        key = self._topic if self.queue_length == 1 else (self._topic, next(self._numbers))
        self._put(key, lambda: (_BINARY, _cbor(published)) if binary else (_TEXT, _json(published)))


class _Client:
    """One websocket: a thread reads it, another one writes, so that a slow reader of images delays nobody."""

    def __init__(self, server: BridgeServer, connection: socket.socket, path: str) -> None:
        self._server = server
        self._robot = server.robot
        self._socket = connection
        self._path = path
        self._received = bytearray()
        self._written = threading.Condition()
        self._waiting: OrderedDict[Any, Callable[[], tuple[int, bytes]]] = OrderedDict()
        self._numbers = itertools.count()
        self._subscriptions: dict[str, _Subscription] = {}
        self._types: dict[str, str] = {}
        self._unproven: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self.is_open = True

    # The websocket

    def serve(self, admit: "Callable[[_Client], bool]") -> None:
        """Serve the connection until its end. A thread of its own."""
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if not self._shake_hands(admit):
                return
            for work in (self._write, self._prove):
                threading.Thread(target=work, name=work.__name__, daemon=True).start()
            while self._read_frame():
                pass
        except (OSError, ValueError) as error:
            logger.info("a connection ended: %s", error)
        finally:
            self.end()
            self._server.on_disconnected(self)
            for subscription in self._subscriptions.values():
                subscription.stop()
            self._socket.close()

    def end(self) -> None:
        """End the connection, from any thread."""
        with self._written:
            self.is_open = False
            self._written.notify_all()
        self._unproven.put(lambda: None)
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def _shake_hands(self, admit: "Callable[[_Client], bool]") -> bool:
        self._socket.settimeout(_SENT_WITHIN_S)
        while b"\r\n\r\n" not in self._received:
            if len(self._received) > _HEAD_BYTES:
                raise ValueError("a request that is too long")
            self._receive()
        head, _, rest = bytes(self._received).partition(b"\r\n\r\n")
        self._received = bytearray(rest)
        request, *lines = head.decode("latin-1").split("\r\n")
        fields = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
        path = request.partition(" ")[2].partition(" ")[0]
        if not secrets.compare_digest(path.encode(), self._path.encode()) or "sec-websocket-key" not in fields:
            self._socket.sendall(b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
            return False
        if not admit(self):
            self._socket.sendall(b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
            return False
        accepted = hashlib.sha1(fields["sec-websocket-key"].encode() + _KEY_SUFFIX).digest()  # noqa: S324 - RFC 6455
        self._socket.sendall(
            b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Accept: " + base64.b64encode(accepted) + b"\r\n\r\n"
        )
        self._socket.settimeout(None)
        return True

    def _receive(self) -> None:
        data = self._socket.recv(2**18)
        if not data:
            raise OSError("the other end closed it")
        self._received += data

    def _pop(self, size: int) -> bytes:
        while len(self._received) < size:
            self._receive()
        data = bytes(self._received[:size])
        del self._received[:size]
        return data

    def _read_frame(self) -> bool:
        """Handle one frame; False after the last one. A client masks its frames, and ours sends no fragments."""
        first, second = self._pop(2)
        length = second & 0x7F
        if length >= 126:
            length = int.from_bytes(self._pop(2 if length == 126 else 8), "big")
        if not first & 0x80 or not second & 0x80 or length > _MOST_BYTES:
            raise ValueError("a frame that is not allowed")
        mask = self._pop(4)
        masked = self._pop(length)
        key = int.from_bytes((mask * (length // 4 + 1))[:length], "big")
        payload = (int.from_bytes(masked, "big") ^ key).to_bytes(length, "big")
        kind = first & 0x0F
        if kind == _TEXT:
            self._handle(json.loads(payload))
        elif kind == _PING:
            self._put(next(self._numbers), lambda: (_PONG, payload))
        elif kind == _CLOSE:
            self._put(next(self._numbers), lambda: (_CLOSE, payload[:2]))
        return kind != _CLOSE

    def _put(self, key: Any, frame: Callable[[], tuple[int, bytes]]) -> None:
        """Queue a frame, which replaces a waiting one with the same key. Any thread."""
        with self._written:
            if len(self._waiting) >= _MOST_WAITING and key not in self._waiting:
                self.is_open = False  # it has not read for a long time
            self._waiting[key] = frame
            self._written.notify()

    def _write(self) -> None:
        try:
            while True:
                with self._written:
                    self._written.wait_for(lambda: self._waiting or not self.is_open)
                    if not self.is_open:
                        break
                    _, frame = self._waiting.popitem(last=False)
                kind, payload = frame()
                size = len(payload)
                long = struct.pack(">BH", 126, size) if size < 2**16 else struct.pack(">BQ", 127, size)
                self._socket.sendall(bytes((0x80 | kind,)) + (bytes((size,)) if size < 126 else long) + payload)
                if kind == _CLOSE:
                    break
        except OSError as error:
            logger.info("nothing more can be sent: %s", error)
        except Exception:
            logger.exception("a message could not be sent")
        self.end()

    def _send(self, operation: Message) -> None:
        self._put(next(self._numbers), lambda: (_TEXT, _json(operation)))

    # Operations

    def _handle(self, operation: Message) -> None:
        op = operation.get("op")
        try:
            getattr(self, f"_on_{op}")(operation)
        except Exception as error:
            expected = isinstance(error, (ValueError, LookupError, AttributeError))
            logger.info("%s: %s", op, error, exc_info=not expected)
            self._send({"op": "status", "level": "error", "msg": f"{op}: {error}", "id": operation.get("id")})

    def _on_advertise(self, operation: Message) -> None:
        topic, type_name = operation["topic"], operation["type"]
        self._types[topic] = type_name
        if not topic.startswith(_OWN_TOPICS):
            self._robot.publish(topic, type_name, None, latch=bool(operation.get("latch")))

    def _on_unadvertise(self, operation: Message) -> None:
        self._types.pop(operation["topic"], None)

    def _on_publish(self, operation: Message) -> None:
        topic, message = operation["topic"], operation.get("msg", {})
        if topic.startswith(_OWN_TOPICS):
            echo = {"op": "publish", "topic": topic, "msg": message}
            self._after_commands(lambda: self._send(echo))
            return
        type_name = self._types.get(topic) or self._robot.interfaces()["topics"].get(topic)
        if type_name is None:
            raise LookupError(f"the type of {topic} is unknown")
        self._server.publish(self, topic, type_name, message, latch=bool(operation.get("latch")))

    def _on_subscribe(self, operation: Message) -> None:
        topic, key = operation["topic"], str(operation.get("id") or operation["topic"])
        if topic.startswith(_OWN_TOPICS):
            return  # what is published there comes back in any case
        subscription = self._subscriptions.get(topic)
        if subscription is not None:
            subscription.requests[key] = operation
            return
        type_name = operation.get("type") or self._robot.interfaces()["topics"].get(topic)
        if not type_name:
            raise LookupError(f"the type of {topic} is unknown")
        subscription = _Subscription(topic, self._put)
        subscription.requests[key] = operation
        subscription.stop = self._robot.subscribe(topic, type_name, subscription.deliver, subscription.queue_length)
        self._subscriptions[topic] = subscription

    def _on_unsubscribe(self, operation: Message) -> None:
        subscription = self._subscriptions.get(operation["topic"])
        if subscription is None:
            return
        subscription.requests.pop(str(operation.get("id") or operation["topic"]), None)
        if not subscription.requests or "id" not in operation:
            del self._subscriptions[operation["topic"]]
            subscription.stop()

    def _on_call_service(self, operation: Message) -> None:
        service, request = operation["service"], operation.get("args") or {}

        def answer(values: Any, *, worked: bool) -> None:
            head = {"op": "service_response", "service": service, "id": operation.get("id")}
            self._send({**head, "values": values, "result": worked})

        def work() -> None:
            try:
                if service.startswith(_ANSWERED_QUESTIONS):
                    values = self._ask(service[len(_ANSWERED_QUESTIONS) :], request)
                else:
                    values = self._robot.call(service, request, float(operation.get("timeout") or 60.0))
            except Exception as error:
                logger.info("%s: %s", service, error)
                answer(str(error) or type(error).__name__, worked=False)
            else:
                answer(values, worked=True)

        if service == _NOBODY:
            self._after_commands(lambda: answer(f"Service {service} does not exist", worked=False))
        elif not self._server.in_thread(work):
            answer("too many requests are unanswered", worked=False)

    def _on_send_action_goal(self, operation: Message) -> None:
        goal_id, action = str(operation["id"]), operation["action"]
        cancelled = self._server.begin_goal(self, goal_id)
        head = {"action": action, "id": goal_id}

        def feedback(values: Message) -> None:
            self._send({"op": "action_feedback", **head, "values": values})

        def work() -> None:
            try:
                goal = operation.get("args") or {}
                status, values = self._robot.run_goal(action, operation["action_type"], goal, feedback, cancelled)
                result = {"values": values, "status": status, "result": status == _SUCCEEDED}
            except Exception as error:
                logger.info("%s: %s", action, error)
                result = {"values": str(error) or type(error).__name__, "status": 0, "result": False}
            self._server.end_goal(goal_id)
            self._send({"op": "action_result", **head, **result})

        if not self._server.in_thread(work):
            self._server.end_goal(goal_id)
            refused = {"values": "too many requests are unanswered", "status": 0, "result": False}
            self._send({"op": "action_result", **head, **refused})

    def _on_cancel_action_goal(self, operation: Message) -> None:
        self._server.cancel_goal(str(operation["id"]))

    def _ask(self, question: str, arguments: Message) -> Message:
        """Answer a question to rosapi. Raises LookupError."""
        interfaces = self._robot.interfaces
        if question == "topics":
            topics = interfaces()["topics"]
            return {"topics": list(topics), "types": list(topics.values())}
        if question == "services":
            return {"services": list(interfaces()["services"])}
        if question == "action_servers":
            return {"action_servers": list(interfaces()["actions"])}
        if question in ("topic_type", "service_type", "action_type"):
            kind = question[: -len("_type")]
            return {"type": interfaces()[f"{kind}s"].get(str(arguments.get(kind)), "")}
        if question == "get_time":
            seconds, nanoseconds = divmod(time.time_ns(), 10**9)
            return {"time": {"sec": seconds, "nanosec": nanoseconds}}
        if question == "get_ros_version":
            return {"version": 2, "distro": os.environ.get("ROS_DISTRO", "")}
        if hasattr(self._robot, "ask"):
            return self._robot.ask(question, arguments)  # type: ignore[no-any-return]
        raise LookupError(f"Service {_ANSWERED_QUESTIONS}{question} does not exist")

    # Proof of the commands before

    def _after_commands(self, answer: Callable[[], None]) -> None:
        """Answer once the robot has received all commands before, in order, without keeping the next ones waiting."""
        self._unproven.put(answer)

    def _prove(self) -> None:
        received = getattr(self._robot, "received", lambda _timeout_s: True)
        while self.is_open:
            answer = self._unproven.get()
            while self.is_open and not received(_RECEIVED_WITHIN_S):
                time.sleep(_RECEIVED_WITHIN_S)
            answer()


def _moves(value: Any) -> bool:
    """Whether any number of a Twist is not zero; the header of a TwistStamped has numbers too."""
    if isinstance(value, dict):
        return any(_moves(part) for name, part in value.items() if name != "header")
    return bool(value)


def _json(value: Any) -> bytes:
    """JSON of rosbridge's form: bytes as base64, ``inf`` and ``nan`` as null."""
    try:
        return json.dumps(value, default=_plain, allow_nan=False, separators=(",", ":")).encode()
    except ValueError:
        return json.dumps(_finite(value), separators=(",", ":")).encode()


def _plain(value: Any) -> Any:
    view = memoryview(value)
    return base64.b64encode(view).decode() if view.format == "B" else _finite(view.tolist())


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(part) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(part) for part in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, (str, int, type(None))) else _finite(_plain(value))


def _cbor(value: Any) -> bytes:
    pieces: list[bytes] = []
    _add_cbor(value, pieces)
    return b"".join(pieces)


def _add_cbor(value: Any, pieces: list[bytes]) -> None:
    """CBOR of rosbridge's form: arrays of numbers as typed arrays of RFC 8746, bytes as bytes."""
    if isinstance(value, dict):
        pieces.append(_cbor_head(5, len(value)))
        for name, part in value.items():
            _add_cbor(name, pieces)
            _add_cbor(part, pieces)
    elif isinstance(value, str):
        encoded = value.encode()
        pieces.append(_cbor_head(3, len(encoded)) + encoded)
    elif value is None or isinstance(value, bool):
        pieces.append({None: b"\xf6", True: b"\xf5", False: b"\xf4"}[value])
    elif isinstance(value, int):
        pieces.append(_cbor_head(0, value) if value >= 0 else _cbor_head(1, -1 - value))
    elif isinstance(value, float):
        pieces.append(b"\xfb" + struct.pack(">d", value))
    elif isinstance(value, (list, tuple)):
        pieces.append(_cbor_head(4, len(value)))
        for part in value:
            _add_cbor(part, pieces)
    else:
        view = memoryview(value)
        if view.format != "B":
            pieces.append(_cbor_head(6, _CBOR_TAGS[str(view.format)]))
        pieces.append(_cbor_head(2, view.nbytes))
        pieces.append(view.tobytes())


def _cbor_head(major: int, number: int) -> bytes:
    if number < 24:
        return bytes((major << 5 | number,))
    for code, form in ((24, ">BB"), (25, ">BH"), (26, ">BI"), (27, ">BQ")):
        if number < 2 ** (8 << (code - 24)):
            return struct.pack(form, major << 5 | code, number)
    raise ValueError("a number that is too large")


def serve(make: Callable[[str], Robot], target: str, descriptor: int) -> None:
    """Serve until standard input ends. Standard output is for the lines ``READY`` and ``UNUSABLE``."""
    lines = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what a library prints is no line of ours
    token = sys.stdin.readline().strip()

    def notify(line: str) -> None:
        with contextlib.suppress(OSError):  # nobody reads any more: standard input ends, too
            lines.write(f"{line}\n")

    try:
        robot = make(target)
    except Exception as error:
        logger.exception("the robot cannot be reached")
        what, advice = (*error.args, "")[:2] if isinstance(error, OSError) and error.args else (repr(error), "")
        notify(UNUSABLE + json.dumps([str(what), str(advice)]))
        raise SystemExit(1) from error
    server = BridgeServer(robot, socket.socket(fileno=descriptor), token, notify)
    server.start()
    while sys.stdin.readline():
        pass
    server.close()
    os._exit(0)  # threads of requests may still wait


def main() -> None:
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    place, target, descriptor = sys.argv[1:4]
    file, _, name = place.rpartition(":")
    spec = importlib.util.spec_from_file_location("caris_robot_plugin", file)
    if spec is None or spec.loader is None:
        raise SystemExit(f"{file} is no module")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    serve(getattr(module, name), target, int(descriptor))


if __name__ == "__main__":
    main()
