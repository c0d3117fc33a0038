"""roslibpy's API on a transport that is safe for driving.

``RosbridgeClient`` and ``RosbridgeTopic`` are a ``roslibpy.Ros`` and a ``roslibpy.Topic``; ``roslibpy.Service``,
``roslibpy.Param``, ``roslibpy.ActionClient`` and even an unmodified ``roslibpy.Topic`` work on a ``RosbridgeClient``.
Underneath is our own factory and protocol over :mod:`caris_desktop.robot.bridge_wire`, on one asyncio loop. Where
roslibpy 2.1 says "once the connection is established" this means "now, or not at all". What the stock transport does,
and what holds here instead:

1. It queues everything while disconnected and flushes it on reconnect, so velocity commands arrive seconds late.
   Here a publish, call or goal without a connection is dropped and counted (``dropped``); a call's errback is called at
   once. Only standing things survive: what is subscribed or advertised is established again in the moment of
   reconnection, in the order in which it was asked for, and not a second later.
2. It never pings. Here the peer is pinged, any byte counts as a sign of life, silence is reported as trouble and then
   ends the connection (``bridge_wire.Timings``).
3. Its back-off grows to an hour. Here it grows from 0.2 s to 1 s, also when a server keeps closing the connection.
4. It knows no CBOR, fragments or status. Here subscriptions ask for CBOR where the type can be sent in it, and accept
   either as an answer; when binary messages come but none of them decodes, everything is subscribed again in JSON, and
   a topic can be asked for in the other encoding. Fragments are put together, status messages are logged.
5. ``unsubscribe()`` of one Topic silences all others of that name, and a Topic used in both directions loses its
   subscription on reconnect. A ``RosbridgeTopic`` has its own callback and its own ids; what a Topic asked for is
   remembered by id and not in the Topic.
6. A blocking call inside a callback freezes the transport. Here it raises RuntimeError; use
   :meth:`RosbridgeClient.ask`.
7. Pending calls never fail. Here they fail in the moment of disconnection, and after a timeout.
   ``roslibpy.actionlib.ActionClient`` still blocks in its constructor, so goals are sent through topics
   (:mod:`caris_desktop.robot.navigation_client`). A ``roslibpy.ActionClient`` (ROS 2) does not, and is used.
8. Its reactor cannot be restarted. Here the loop is the caller's.
9. It has one websocket. rosbridge 2.0 and 2.1 handle the operations of one websocket one after another by default
   (``send_action_goals_in_new_thread`` and ``call_services_in_new_thread`` false): a goal holds everything behind it
   until it ends, and one that is refused holds it for good, while pings are still answered. Where there are motion
   topics (``RosbridgeTopic(..., motion=True)``) they have a separate websocket here, which carries nothing that can
   wait. Goals and service calls then have one for each in progress, questions to rosapi another, and subscriptions and
   everything else the main one.

Beyond that: ``wss://`` and rosauth as the profile's security settings say; every arrival is counted per topic
(:mod:`caris_desktop.robot.traffic`); a message that is malformed, unknown or too large is refused and reported, and
never ends the read loop; when messages come faster than they are handled, the newest of each topic win (a
``RosbridgeTopic`` can ask for every one) and what they replaced is counted; an exception in one callback reaches the
log and nothing else.

Long because all of the API of roslibpy that is replaced is here.
"""

import asyncio
import itertools
import logging
import re
import ssl
import threading
from collections import Counter, deque
from collections.abc import Callable, Mapping
from typing import Any, Literal

import roslibpy
from roslibpy.core import GoalStatus
from websockets.exceptions import InvalidHandshake, InvalidURI

from caris_desktop.domain.address import plugin_address
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.robot.bridge_process import BridgeProcess
from caris_desktop.robot.bridge_security import LinkError
from caris_desktop.robot.bridge_socket import (
    HEAD_BYTES,
    BridgeSocket,
    Callback,
    LargeAnswer,
    NoAnswer,
    Operation,
    RosbridgeProtocol,
    WaitingOperation,
)
from caris_desktop.robot.bridge_wire import CONTROL_TIMINGS, Timings, Wire, explain_failure
from caris_desktop.robot.profile_model import SecuritySettings
from caris_desktop.robot.traffic import TrafficMeter
from caris_desktop.ros.definitions import cbor_carries
from caris_desktop.ros.dialect import Dialect, package_and_name, type_name
from caris_desktop.ros.message_fields import MessageError

logger = logging.getLogger(__name__)

_REPEATED = {"subscribe", "advertise", "advertise_service"}
_ENDING = {"unsubscribe": "subscribe", "unadvertise": "advertise", "unadvertise_service": "advertise_service"}
_JSON_PUBLISH = re.compile(rb'"op"\s*:\s*"publish"')
_JSON_TOPIC = re.compile(rb'"topic"\s*:\s*"([^"\\]+)"')
_CBOR_PUBLISH = b"\x62op\x67publish"
_CBOR_TOPIC = re.compile(rb"\x65topic(?:([\x61-\x77])|\x78(.))", re.DOTALL)
_UNDECODABLE_BEFORE_JSON = 3
_MOST_WAITING = 5_000
# A pause of 0.2 s loses no scan and no odometry, since these few are handled quickly. Images and maps take long, so
# only the newest waits.
_SMALL_BYTES, _SMALL_WAITING = 32 * 1024, 5
# A shorter connection means that the server refuses us.
_SHORT_LIVED_S = 1.0
_QUESTIONS = "/rosapi/"
# A hanging rosapi never answers. A new websocket for queries costs the robot another thread.
_LINK_LOST_WITHIN_S = 0.3
_NEW_QUESTIONS_SOCKET_AFTER_S = 30.0
# Maximum pending calls and goals, with a few more for those that stop the robot.
MOST_CALLS, MOST_URGENT_CALLS = 8, 16


class SizeLimits(Value):
    """Messages above ``message_bytes`` are refused; one above ``frame_bytes`` ends the connection before it is read."""

    message_bytes: int
    frame_bytes: int


# Decoding shares the loop with the motion lease, so messages must be small.
CONTROL_SIZES = SizeLimits(message_bytes=4 * 2**20, frame_bytes=64 * 2**20)
MEDIA_SIZES = SizeLimits(message_bytes=64 * 2**20, frame_bytes=256 * 2**20)


class LinkObserver:
    """Receiver of connection events, of which it overrides what it needs. All calls come on the loop."""

    def link_connected(self) -> None:
        """Connected, and all subscriptions and advertisements are re-established."""

    def link_silent(self) -> None:
        """The robot has been silent for a moment."""

    def link_recovered(self) -> None:
        """The robot is heard again."""

    def link_lost(self, reason: str) -> None:
        """The connection is over; pending calls have failed. It reconnects."""

    def link_unreachable(self, what: str, advice: str) -> None:
        """One attempt to connect failed. Repeated with each attempt."""

    def link_round_trip(self, round_trip_s: float) -> None:
        """A ping came back."""

    def link_refused(self, detail: str) -> None:
        """A message was discarded."""


class ServiceCallError(Exception):
    """A service call failed, timed out, or the link was lost. ``answer`` is the robot's answer."""

    def __init__(self, text: str, answer: str = "") -> None:
        super().__init__(text)
        self.answer = answer


class AnswerTooLargeError(ServiceCallError):
    """The service's answer exceeds the size limit."""

    def __init__(self, service: str, answer: LargeAnswer) -> None:
        super().__init__(f"{service}: {answer}")
        self.tail = answer.tail


class LoopManager:
    """roslibpy's event loop manager, for a loop run by the caller."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self.thread_id = threading.get_ident()

    def run(self) -> None:
        """Do nothing: the loop is the caller's."""

    def run_forever(self) -> None:
        raise RuntimeError("this connection lives on an asyncio loop that is already running")

    def terminate(self) -> None:
        """Do nothing: the loop is the caller's."""

    def call_later(self, delay: float, callback: Callable[[], Any]) -> None:
        if threading.get_ident() == self.thread_id:
            self.loop.call_later(delay, callback)
        else:
            self.loop.call_soon_threadsafe(self.loop.call_later, delay, callback)

    def call_in_thread(self, callback: Callable[[], Any]) -> None:
        self.loop.call_soon_threadsafe(self.loop.run_in_executor, None, callback)

    def blocking_call_from_thread(self, callback: Callable[[Any], Any], timeout: float | None) -> Any:
        """As roslibpy's; raises RuntimeError on the loop's own thread instead of a deadlock."""
        if threading.get_ident() == self.thread_id:
            raise RuntimeError(
                "a blocking call on the loop's own thread would freeze the connection; use RosbridgeClient.ask"
            )

        async def call() -> Any:
            placeholder = self.loop.create_future()
            callback(placeholder)
            return await placeholder

        try:
            return asyncio.run_coroutine_threadsafe(call(), self.loop).result(timeout)
        except TimeoutError as error:
            raise roslibpy.core.RosTimeoutError("No service response received") from error

    def get_inner_callback(self, result_placeholder: "asyncio.Future[Any]") -> Callback:
        def inner_callback(result: Any) -> None:
            if not result_placeholder.done():
                result_placeholder.set_result({"result": result})

        return inner_callback

    def get_inner_errback(self, result_placeholder: "asyncio.Future[Any]") -> Callback:
        def inner_errback(error: Any) -> None:
            if not result_placeholder.done():
                result_placeholder.set_result({"exception": error})

        return inner_errback


@dataclass(slots=True, eq=False)
class _Arrival:
    """Queued message; a ``replaceable`` one may be replaced by a newer one of its topic."""

    payload: bytes
    stamp_ns: int
    topic: str | None
    replaceable: bool
    protocol: RosbridgeProtocol


class RosbridgeFactory:
    """Maintains one link: subscriptions, dispatch, reconnection.

    The link is connected while its main websocket and, if there are motion topics, theirs are; it is lost when one of
    them is, or one with an active goal.
    """

    def __init__(
        self,
        url: str,
        observer: LinkObserver,
        *,
        timings: Timings,
        sizes: SizeLimits,
        service_timeout_s: float,
        security: SecuritySettings,
        traffic: TrafficMeter,
    ) -> None:
        self.url = url
        self._bridge = BridgeProcess(url) if plugin_address(url) else None
        self.sizes = sizes
        self.service_timeout_s = service_timeout_s
        self.manager = LoopManager(asyncio.get_running_loop())
        self.dropped = 0
        self.refused = 0
        self._overtaken: Counter[str] = Counter()
        self._observer = observer
        self.timings = timings
        self.security = security
        self.traffic = traffic
        self.admission_numbers = itertools.count(1)
        self.motion_topics: set[str] = set()
        self.urgent_services: set[str] = set()
        self.motion_round_trip: Callback = observer.link_round_trip
        self._main = BridgeSocket(self)
        self._motion: BridgeSocket | None = None
        self._questions: BridgeSocket | None = None
        self._calls: list[BridgeSocket] = []
        self._opening: set[asyncio.Task[None]] = set()
        self._ask_first = security.rosauth_secret_env is not None
        self._at_once = False
        self._silent = False
        self._stopping = False
        self._listeners: dict[str, list[Callback]] = {}
        self._repeated: dict[str, Operation] = {}
        self._retired: set[str] = set()
        self._established: set[str] = set()
        self._every_message: set[str] = set()
        self._in_other_encoding: set[str] = set()
        self.arrival_ns = 0
        self._arrived: deque[_Arrival] = deque()
        self._newest: dict[str, list[_Arrival]] = {}
        self._handled: _Arrival | None = None
        self._handling = False
        self._cbor_works = True
        self._binary_failures = 0
        self._keeper: asyncio.Task[None] | None = None
        self._lost: asyncio.Future[Wire] | None = None
        self._left_open: list[Wire] = []
        self._first_topic = ""
        self._say_first: Callback | None = None

    @property
    def is_connected(self) -> bool:
        return self._main.is_open and (self._motion is None or self._motion.is_open)

    @property
    def protocol(self) -> RosbridgeProtocol | None:
        """Protocol of the main websocket."""
        return self._main.protocol

    @property
    def motion_protocol(self) -> RosbridgeProtocol | None:
        """Protocol of the motion websocket, without slow operations."""
        return (self._motion or self._main).protocol

    def _sockets(self) -> list[BridgeSocket]:
        sockets = (self._main, self._motion, self._questions, *self._calls)
        return [socket for socket in sockets if socket is not None]

    def _protocols(self) -> list[RosbridgeProtocol]:
        return [socket.protocol for socket in self._sockets() if socket.protocol is not None]

    def server_received_s(self) -> float:
        """When anything last came from the server, over any of the websockets."""
        return max(socket.received_s for socket in self._sockets())

    def connect(self) -> None:
        if self._keeper is None or self._keeper.done():
            self._stopping = False
            self._keeper = self.manager.loop.create_task(self._stay_connected())

    def stop(self) -> None:
        """Close the connection properly and stop reconnecting."""
        self._stopping = True
        if self._keeper is not None:
            self._keeper.cancel()
        for task in self._opening:
            task.cancel()
        for wire in self._left_open:
            wire.drop()
        for protocol in self._protocols():
            protocol.wire.close()

    async def closed(self, timeout_s: float) -> None:
        """Wait up to ``timeout_s`` until the peer has received everything and closed."""
        if self._lost is not None and not self._lost.done():
            await asyncio.wait([self._lost], timeout=timeout_s)
        for protocol in self._protocols():
            protocol.wire.abort(QT_TR_NOOP("closed by this program"))
        if self._bridge is not None:
            await self._bridge.close()

    def on_ready(self, callback: Callback) -> None:
        """Call ``callback`` with the protocol now, or at the next connection."""
        if self.protocol is not None:
            callback(self.protocol)
        else:
            self.once("ready", callback)

    # Remembered and one-time operations

    def send(self, message: Mapping[str, Any]) -> bool:
        """Send one operation now. Subscriptions and advertisements are remembered, everything else is dropped when
        disconnected.
        """
        operation = dict(message)
        op = operation.get("op")
        if op in _REPEATED:
            key = _key_of(operation)
            if key in self._retired or key in self._established:
                # A stock Topic repeats itself a second after a disconnection; we were faster.
                return self.is_connected
            self._repeated[key] = operation
            if op == "subscribe":
                self.traffic.listens(operation["topic"], str(operation.get("type", "")))
            return self._establish(key, operation)
        if op in _ENDING:
            key = _key_of({**operation, "op": _ENDING[op]})
            self._repeated.pop(key, None)
            self._established.discard(key)
            if "id" in operation:
                self._retired.add(key)
            if op == "unsubscribe" and not self._subscribed(operation["topic"]):
                self.traffic.stops_listening(operation["topic"])
        if op == "cancel_action_goal":
            return self._cancel_goal(operation)
        protocol = self._protocol_for(operation)
        if protocol is None or not protocol.send_operation(operation):
            self.dropped += 1
            return False
        return True

    def _protocol_for(self, operation: Mapping[str, Any]) -> RosbridgeProtocol | None:
        """Protocol for an operation: topics of motion have their own websocket."""
        return self.motion_protocol if operation.get("topic") in self.motion_topics else self.protocol

    def _cancel_goal(self, operation: Operation) -> bool:
        """Cancel over the goal's websocket, which servers with per-client goals require, and over the main one, as a
        goal blocks its own websocket if goals are not sent in new threads.
        """
        for socket in self._calls:
            for waiting in [waiting for waiting in socket.waiting if waiting.id == operation.get("id")]:
                # Not sent yet.
                socket.waiting.remove(waiting)
                waiting.fail(QT_TR_NOOP("it was cancelled before it was sent"))
                return True
        goals = [socket.protocol for socket in self._calls]
        having = [protocol for protocol in goals if protocol is not None and protocol.has_goal(operation.get("id"))]
        sent = [protocol.send_operation(operation) for protocol in (self.protocol, *having) if protocol is not None]
        self.dropped += not any(sent)
        return any(sent)

    def _subscribed(self, topic: str) -> bool:
        repeated = self._repeated.values()
        return any(operation["op"] == "subscribe" and operation["topic"] == topic for operation in repeated)

    def on_connect_send(self, topic: str, words: Callback) -> None:
        """On each connection, advertise ``topic`` and call ``words`` before anything else."""
        self._first_topic, self._say_first = topic, words

    def request_every_message(self, topic: str) -> None:
        """Deliver every message of this topic instead of the newest only."""
        self._every_message.add(topic)

    def _establish(self, key: str, operation: Operation) -> bool:
        protocol = self._protocol_for(operation)
        if protocol is None:
            return False
        if operation.get("compression") in ("cbor", "none"):
            operation = {**operation, "compression": self._encoding_of(operation)}
        self._established.add(key)
        return protocol.send_operation(operation)

    def _encoding_of(self, subscription: Operation) -> str:
        binary = (subscription["compression"] == "cbor") is not (subscription["topic"] in self._in_other_encoding)
        return "cbor" if binary and self._cbor_works else "none"

    def resubscribe(self, topic: str, *, other_encoding: bool, leave_first: bool) -> str:
        """Renew subscriptions of a topic, optionally in the other encoding; return the encoding.

        ``leave_first`` ends the previous subscriptions. Without it, the server changes them without a gap.
        """
        if other_encoding:
            self._in_other_encoding ^= {topic}
        repeated = [
            (key, operation)
            for key, operation in self._repeated.items()
            if operation["op"] == "subscribe" and operation["topic"] == topic
        ]
        for _, operation in repeated:
            if leave_first and (protocol := self._protocol_for(operation)) is not None:
                protocol.send_operation({"op": "unsubscribe", "id": operation.get("id"), "topic": topic})
        for key, operation in repeated:
            self._establish(key, operation)
        return self._encoding_of(repeated[0][1]) if repeated else ""

    def binary_worked(self) -> None:
        self._binary_failures = -1

    def binary_failed(self) -> None:
        """Request JSON after several undecodable binary messages without a decodable one."""
        if self._binary_failures < 0 or not self._cbor_works:
            return
        self._binary_failures += 1
        if self._binary_failures < _UNDECODABLE_BEFORE_JSON:
            return
        logger.warning("The robot's binary messages cannot be read; asking for JSON instead")
        self._cbor_works = False
        for key, operation in self._repeated.items():
            if operation.get("compression") == "cbor" and (protocol := self._protocol_for(operation)) is not None:
                protocol.send_operation({"op": "unsubscribe", "id": operation["id"], "topic": operation["topic"]})
                self._establish(key, operation)

    # The websockets

    async def _stay_connected(self) -> None:
        delay_s = self.timings.first_retry_s
        lost_s = self.manager.loop.time()
        while True:
            if self.motion_topics and self._motion is None:
                self._motion = BridgeSocket(self)
            sockets = [socket for socket in (self._motion, self._main) if socket is not None]
            try:
                if self._bridge is not None:
                    self.url = await self._bridge.url()
                await self._open_all(sockets)
            except (OSError, TimeoutError, ValueError, InvalidHandshake, InvalidURI, LinkError) as error:
                what, advice = explain_failure(error, self.url)
                logger.debug("%s (%s)", what, type(error).__name__)
                self.run_safely(self._observer.link_unreachable, what, advice)
                await asyncio.sleep(delay_s)
                # Quickly only while nothing answers there: a server that refuses us is not to be flooded.
                quickly = isinstance(error, OSError) and not isinstance(error, ssl.SSLError)
                if not quickly or self.manager.loop.time() - lost_s > self.timings.quick_retries_s:
                    delay_s = min(delay_s * 1.7, self.timings.longest_retry_s)
                continue
            begun = [socket.begin() for socket in sockets]
            if all(begun):
                began_s = self.manager.loop.time()
                self._lost = self.manager.loop.create_future()
                self._begin()
                wire = await asyncio.shield(self._lost)
                lost_s = self.manager.loop.time()
                if wire.broken_by_size:
                    # A large latched message would come again at once.
                    delay_s = self.timings.longest_retry_s
                elif wire.parted_by_peer and self.manager.loop.time() - began_s < _SHORT_LIVED_S:
                    # Rapid reconnection to a refusing server is useless; first check whether it accepts us.
                    self._ask_first = True
                    delay_s = min(delay_s * 1.7, self.timings.longest_retry_s)
                else:
                    delay_s = self.timings.first_retry_s
            else:
                for socket in sockets:
                    socket.pop_protocol()
                    socket.abort(QT_TR_NOOP("the other connection was lost"))
            at_once, self._at_once = self._at_once, False
            await asyncio.sleep(0.0 if at_once else delay_s)

    async def _open_all(self, sockets: list[BridgeSocket]) -> None:
        """Open in parallel, all or none. Raises what :meth:`BridgeSocket.open` does."""
        opening = [asyncio.ensure_future(socket.open(ask_first=self._ask_first)) for socket in sockets]
        try:
            await asyncio.gather(*opening)
        except BaseException:
            for task in opening:
                task.cancel()
            await asyncio.gather(*opening, return_exceptions=True)
            for socket in sockets:
                socket.abort(QT_TR_NOOP("the other connection could not be established"))
            raise

    def _begin(self) -> None:
        self._established.clear()
        self._silent = False
        repeated = list(self._repeated.items())
        if self._say_first is not None:
            for key, operation in repeated:
                if operation["op"] == "advertise" and operation["topic"] == self._first_topic:
                    self._establish(key, operation)
            self.run_safely(self._say_first)
        for key, operation in repeated:
            if key not in self._established:
                self._establish(key, operation)
        self.emit("ready", self.protocol)
        self.run_safely(self._observer.link_connected)
        if self._motion is not None:
            self._ensure_one_free()

    def reconnect(self, reason: str) -> None:
        """Drop the link with everything that the server has not handled, and reconnect at once."""
        protocol = self.motion_protocol
        if protocol is not None:
            self._at_once = True
            protocol.wire.abort(reason)

    # Calls and goals

    def call(
        self, request_id: str, service: str, send: Callable[[RosbridgeProtocol], None], fail: Callable[[str], None]
    ) -> None:
        """Send a call or goal over a websocket where it neither waits nor blocks others.

        ``service`` is empty for a goal. ``fail`` is called if it cannot be sent.
        """
        if not self.is_connected:
            self.dropped += 1
            self.run_safely(fail, NoAnswer(QT_TR_NOOP("the robot is not connected")))
            return
        if self._motion is None:
            socket: BridgeSocket | None = self._main
        elif service.startswith(_QUESTIONS):
            socket = self._questions = self._questions or self._open_call_socket()
        else:
            socket = self._free_socket(urgent=service in self.urgent_services)
        if socket is None:
            under_way = QT_TR_NOOP("the robot has not yet responded to {count} other requests")
            self.run_safely(fail, NoAnswer(localized(under_way, count=len(self._calls))))
        elif socket.protocol is not None:
            send(socket.protocol)
        else:
            socket.waiting.append(WaitingOperation(request_id, send, fail))
        if self._motion is not None:
            self._ensure_one_free()

    def _free_socket(self, *, urgent: bool) -> BridgeSocket | None:
        free = [socket for socket in self._calls if socket.is_free]
        if not urgent and len(self._calls) - len(free) >= MOST_CALLS:
            return None
        if free:
            return next((socket for socket in free if socket.is_open), free[0])
        if len(self._calls) >= MOST_URGENT_CALLS:
            return None
        self._calls.append(self._open_call_socket())
        return self._calls[-1]

    def _ensure_one_free(self) -> None:
        """Open a spare websocket, so that stop calls need not wait for one."""
        if not any(socket.is_free for socket in self._calls) and len(self._calls) < MOST_URGENT_CALLS:
            self._calls.append(self._open_call_socket())

    def _open_call_socket(self) -> BridgeSocket:
        socket = BridgeSocket(self)
        task = self.manager.loop.create_task(self._open_for_calls(socket))
        self._opening.add(task)
        task.add_done_callback(self._opening.discard)
        return socket

    async def _open_for_calls(self, socket: BridgeSocket) -> None:
        reason = QT_TR_NOOP("the connection to the robot was lost")
        try:
            await socket.open(ask_first=self._ask_first)
        except (OSError, TimeoutError, ValueError, InvalidHandshake, InvalidURI, LinkError) as error:
            reason, _ = explain_failure(error, self.url)
            logger.debug("No further connection: %s", reason)
        needed = self._questions is socket or socket in self._calls
        waiting, socket.waiting = socket.waiting, []
        if needed and socket.begin() and socket.protocol is not None:
            for each in waiting:
                each.send(socket.protocol)
            return
        self._forget_socket(socket)
        socket.abort(reason)
        for each in waiting:
            self.run_safely(each.fail, NoAnswer(reason))

    def _forget_socket(self, socket: BridgeSocket) -> None:
        if self._questions is socket:
            self._questions = None
        if socket in self._calls:
            self._calls.remove(socket)

    def not_answered(self, protocol: RosbridgeProtocol) -> None:
        """A call timed out: abandon its websocket with whatever it blocks in the server."""
        questions = self._questions
        if questions is not None and questions.protocol is protocol:
            if self.manager.loop.time() - protocol.began_s >= _NEW_QUESTIONS_SOCKET_AFTER_S:
                self._questions = None
                questions.close()
            return
        for socket in [socket for socket in self._calls if socket.protocol is protocol and socket.is_free]:
            self._calls.remove(socket)
            socket.close()

    def has_goal(self, goal_id: str) -> bool:
        """Whether this goal was sent and has not ended yet."""
        return any(protocol.has_goal(goal_id) for protocol in self._protocols())

    def give_up_goal(self, goal_id: str) -> None:
        """Abandon a goal and its websocket."""
        for socket in list(self._calls):
            if socket.protocol is not None and socket.protocol.has_goal(goal_id):
                socket.protocol.forget_goal(goal_id)
                self._calls.remove(socket)
                socket.close()

    # Incoming messages

    def receive(self, payload: bytes, protocol: RosbridgeProtocol) -> None:
        if len(self._arrived) >= _MOST_WAITING:
            self.refuse(QT_TR_NOOP("more messages at once than can be handled"))
            return
        stamp_ns = now_ns()
        found = topic_of_publish(payload)
        topic = None if found is None else found.decode("utf-8", "replace")
        if topic is not None:
            self.traffic.arrived(topic, size_bytes=len(payload), arrival_ns=stamp_ns)
        if topic is None or topic in self._every_message:
            self._arrived.append(_Arrival(payload, stamp_ns, topic, replaceable=False, protocol=protocol))
        else:
            waiting = self._newest.setdefault(topic, [])
            if len(waiting) >= (_SMALL_WAITING if len(payload) <= _SMALL_BYTES else 1):
                # Each moves up to its predecessor's place, so that no topic waits longer than before.
                for place, following in itertools.pairwise(waiting):
                    place.payload, place.stamp_ns = following.payload, following.stamp_ns
                waiting[-1].payload, waiting[-1].stamp_ns = payload, stamp_ns
                self._overtaken[topic] += 1
                return
            arrival = _Arrival(payload, stamp_ns, topic, replaceable=True, protocol=protocol)
            waiting.append(arrival)
            self._arrived.append(arrival)
        if not self._handling:
            self._handling = True
            self.manager.loop.call_soon(self._handle_next)

    def _handle_next(self) -> None:
        # One message per turn, so that timers and commands run in between.
        if self._arrived:
            arrival = self._arrived.popleft()
            if arrival.replaceable and arrival.topic is not None:
                self._newest[arrival.topic].remove(arrival)
            self.arrival_ns = arrival.stamp_ns
            self._handled = arrival
            self.run_safely(arrival.protocol.on_message, arrival.payload)
            self._handled = None
        self._handling = bool(self._arrived)
        if self._handling:
            self.manager.loop.call_soon(self._handle_next)

    def pop_overtaken(self) -> Counter[str]:
        """Messages per topic replaced by newer ones before handling, since the last call."""
        overtaken, self._overtaken = self._overtaken, Counter()
        return overtaken

    def queue_publish(self, topic: str, message: Any, *, binary: bool) -> None:
        """Dispatch a decoded message."""
        if self._handled is not None and self._handled.topic != topic:
            # Its topic was not in the first bytes, or it came in fragments.
            self._handled.topic = topic
            self.traffic.arrived(topic, size_bytes=len(self._handled.payload), arrival_ns=self.arrival_ns)
        self.traffic.decoded(topic, message, binary=binary)
        self.emit(topic, message)

    def _is_main(self, socket: BridgeSocket) -> bool:
        return socket is self._main or socket is self._motion

    def socket_silent(self, socket: BridgeSocket) -> None:
        if self._is_main(socket) and not self._silent:
            self._silent = True
            self.run_safely(self._observer.link_silent)

    def socket_recovered(self) -> None:
        silent = self._main.silent or (self._motion is not None and self._motion.silent)
        if self._silent and not silent:
            self._silent = False
            self.run_safely(self._observer.link_recovered)

    def socket_round_trip(self, socket: BridgeSocket, round_trip_s: float) -> None:
        if socket is self._main:
            self.run_safely(self._observer.link_round_trip, round_trip_s)
        elif socket is self._motion:
            self.run_safely(self.motion_round_trip, round_trip_s)

    def socket_lost(self, socket: BridgeSocket, reason: str) -> None:
        protocol = socket.protocol
        if protocol is None:
            return
        if self._stopping and self._protocols() != [protocol]:
            # Data sent over the others still arrives.
            socket.pop_protocol()
            protocol.fail_everything(NoAnswer(QT_TR_NOOP("the connection to the robot was lost")))
        elif self._is_main(socket) or protocol.has_goal() or self._stopping:
            self._link_lost(socket, protocol, reason)
        else:
            socket.pop_protocol()
            self._forget_socket(socket)
            # Often the first of a link that is lost as a whole, which is then reported.
            lost = NoAnswer(QT_TR_NOOP("the connection to the robot was lost"))
            self.manager.loop.call_later(_LINK_LOST_WITHIN_S, protocol.fail_everything, lost)

    def _link_lost(self, ended: BridgeSocket, protocol: RosbridgeProtocol, reason: str) -> None:
        # Messages from before the gap are not delivered after it.
        self._arrived.clear()
        self._newest.clear()
        if protocol.wire.broken_by_size:
            self.refuse(
                localized(
                    QT_TR_NOOP("a message of more than {frame_bytes} MB, which ended the connection"),
                    frame_bytes=f"{self.sizes.frame_bytes / 2**20:.0f}",
                )
            )
        protocols = self._protocols()
        calls, self._calls = self._calls, []
        questions, self._questions = self._questions, None
        others = [socket for socket in (self._main, self._motion) if socket is not None and socket is not ended]
        for socket in (ended, *others, *calls, *([questions] if questions is not None else [])):
            over = socket.pop_protocol()
            if over is not None and socket in others:
                over.wire.give_up(reason)
            elif over is not None and socket is not ended:
                # What a suspended server has not read is lost with it.
                over.wire.abort(reason)
        wires = [*self._left_open, *(each.wire for each in protocols)]
        self._left_open = [wire for wire in wires if wire.left_open]
        self._established.clear()
        no_answer = NoAnswer(QT_TR_NOOP("the connection to the robot was lost"))
        for each in protocols:
            each.fail_everything(no_answer)
        for socket in (*calls, *([questions] if questions is not None else [])):
            waiting, socket.waiting = socket.waiting, []
            for unsent in waiting:
                self.run_safely(unsent.fail, no_answer)
        self.emit("close", protocol)
        self.run_safely(self._observer.link_lost, reason)
        if self._lost is not None and not self._lost.done():
            self._lost.set_result(protocol.wire)

    def refuse(self, detail: str) -> None:
        self.refused += 1
        self.traffic.refused(None if self._handled is None else self._handled.topic)
        logger.debug("Refused: %.300s", detail)
        self._observer.link_refused(detail)

    # The event emitter that roslibpy's Ros and Topic expect

    def on(self, event: str, callback: Callback) -> None:
        self._listeners.setdefault(event, []).append(callback)

    def once(self, event: str, callback: Callback) -> None:
        def call_once(*arguments: Any) -> None:
            self.off(event, call_once)
            callback(*arguments)

        self.on(event, call_once)

    def off(self, event: str, callback: Callback) -> None:
        listeners = self._listeners.get(event, [])
        if callback in listeners:
            listeners.remove(callback)

    def remove_all_listeners(self, event: str) -> None:
        self._listeners.pop(event, None)

    def emit(self, event: str, *arguments: Any) -> None:
        for callback in list(self._listeners.get(event, ())):
            self.run_safely(callback, *arguments)

    def run_safely(self, callback: Callback | None, *arguments: Any) -> None:
        """Run a callback; its exceptions are logged."""
        if callback is None:
            return
        try:
            callback(*arguments)
        except MessageError as error:
            self.refuse(str(error))
        except Exception:
            logger.exception("A callback failed")


class RosbridgeClient(roslibpy.Ros):  # type: ignore[misc]  # roslibpy has no types
    """Connection to one rosbridge server, on the running asyncio loop.

    Create and use it on that loop's thread; roslibpy's blocking calls work from other threads.
    """

    def __init__(
        self,
        address: str,
        observer: LinkObserver,
        *,
        timings: Timings = CONTROL_TIMINGS,
        sizes: SizeLimits = CONTROL_SIZES,
        service_timeout_s: float = 3.0,
        security: SecuritySettings | None = None,
        traffic: TrafficMeter | None = None,
        dialect: Dialect | None = None,
    ) -> None:
        """``dialect`` is that of the robot, None if it is not known yet: then types are spelled as given."""
        # Not Ros's constructor, which would choose a stock transport.
        self._id_counter = 0
        self.is_connecting = False
        self._dialect = dialect
        self.factory = RosbridgeFactory(
            address,
            observer,
            timings=timings,
            sizes=sizes,
            service_timeout_s=service_timeout_s,
            security=security or SecuritySettings(),
            traffic=traffic or TrafficMeter(""),
        )

    @property
    def dialect(self) -> Dialect:
        return self._dialect or Dialect.ROS1

    def spelled(self, type_: str) -> str:
        """Message type as the robot spells it, from either dialect."""
        return type_ if self._dialect is None else type_name(self._dialect, *package_and_name(type_))

    def connect(self) -> None:
        """Connect, and reconnect until :meth:`close`."""
        self.factory.connect()

    def close(self, timeout: float = 0.0) -> None:
        """Start closing. :meth:`aclose` also waits for it."""
        self.emit("closing")
        self.factory.stop()

    async def aclose(self, timeout_s: float) -> None:
        """Close, with up to ``timeout_s`` for sent data to arrive."""
        self.close()
        await self.factory.closed(timeout_s)

    def send_now(self, message: Mapping[str, Any]) -> bool:
        """Send one operation. True if it was handed to the socket; otherwise it is dropped."""
        return self.factory.send(message)

    def send_on_ready(self, message: Mapping[str, Any]) -> None:
        manager = self.factory.manager
        if threading.get_ident() == manager.thread_id:
            self.factory.send(message)
        else:
            manager.loop.call_soon_threadsafe(self.factory.send, message)

    def call_async_service(
        self, message: Mapping[str, Any], callback: Callback, errback: Callback, timeout_s: float | None = None
    ) -> None:
        self.factory.call(
            message["id"],
            message["service"],
            lambda protocol: protocol.send_ros_service_request(message, callback, errback, timeout_s),
            errback,
        )

    def call_async_action(
        self, message: Mapping[str, Any], resultback: Callback, feedback: Callback, errback: Callback
    ) -> None:
        self.factory.call(
            message["id"],
            "",
            lambda protocol: protocol.send_ros_action_goal(message, resultback, feedback, errback),
            lambda reason: errback({"status": GoalStatus.UNKNOWN, "values": {"error_msg": reason}}),
        )

    def ask(
        self,
        service: str,
        service_type: str,
        arguments: Mapping[str, Any] | None = None,
        *,
        timeout_s: float | None = None,
    ) -> asyncio.Future[Operation]:
        """Call a service at once; return a future for its answer, with a timeout (None: the connection's).

        rosbridge finds the type by the service's name; ``service_type`` is for readers and the log.

        Raises
        ------
        ServiceCallError
            When it fails, does not answer in time, or the link is lost meanwhile.
        """
        answer: asyncio.Future[Operation] = self.factory.manager.loop.create_future()

        def succeed(values: Any) -> None:
            if not answer.done():
                answer.set_result(dict(values))

        def fail(reason: Any) -> None:
            if not answer.done():
                logger.debug("%s (%s) failed: %s", service, service_type, reason)
                large = isinstance(reason, LargeAnswer)
                message = "" if isinstance(reason, NoAnswer) else str(reason)
                error = (
                    AnswerTooLargeError(service, reason) if large else ServiceCallError(f"{service}: {reason}", message)
                )
                answer.set_exception(error)

        operation: Operation = {
            "op": "call_service",
            "id": f"call_service:{service}:{self.id_counter}",
            "service": service,
            "args": dict(arguments or {}),
        }
        if timeout_s is not None:
            # ROS 2's rosbridge has its own timeout.
            operation["timeout"] = timeout_s
        self.call_async_service(operation, succeed, fail, timeout_s)
        return answer

    async def nodes(self, kind: Literal["publishers", "subscribers"], topic: str) -> list[str]:
        """Nodes at a topic, as rosapi reports them. Raises ServiceCallError."""
        names = (await self.ask(f"/rosapi/{kind}", f"rosapi/{kind.capitalize()}", {"topic": topic})).get(kind)
        return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []

    @property
    def arrival_ns(self) -> int:
        """Session time at which the message being handled arrived."""
        return int(self.factory.arrival_ns)

    @property
    def unsent_bytes(self) -> int:
        """Unsent bytes on the motion websocket; above zero the network does not keep up."""
        protocol = self.factory.motion_protocol
        return 0 if protocol is None else protocol.wire.unsent_bytes


class RosbridgeTopic(roslibpy.Topic):  # type: ignore[misc]  # roslibpy has no types
    """Topic independent of other Topics of its name.

    ``every_message`` delivers each message where they do not replace one another (results, transforms). ``compression``
    None requests CBOR if rosbridge supports it for the type. ``motion`` puts it on the motion websocket. The type may
    be spelled as in either dialect.
    """

    SUPPORTED_COMPRESSION_TYPES = ("none", "cbor")
    _subscribe_id: str | None
    _advertise_id: str | None

    def __init__(
        self,
        ros: RosbridgeClient,
        name: str,
        message_type: str,
        *,
        compression: str | None = None,
        latch: bool = False,
        throttle_rate: int = 0,
        queue_size: int = 10,
        queue_length: int = 1,
        every_message: bool = False,
        motion: bool = False,
    ) -> None:
        super().__init__(
            ros,
            name,
            ros.spelled(message_type),
            compression=compression or ("cbor" if cbor_carries(message_type) else "none"),
            latch=latch,
            throttle_rate=throttle_rate,
            queue_size=queue_size,
            queue_length=queue_length,
        )
        self._callback: Callback | None = None
        if every_message:
            ros.factory.request_every_message(name)
        if motion:
            ros.factory.motion_topics.add(name)

    def unsubscribe(self) -> None:
        if not self._subscribe_id:
            return
        self.ros.off(self.name, self._callback)
        self.ros.send_on_ready({"op": "unsubscribe", "id": self._subscribe_id, "topic": self.name})
        self._subscribe_id = None
        self._callback = None

    def subscribe(self, callback: Callback) -> None:
        if self._subscribe_id:
            return
        self._callback = callback
        super().subscribe(callback)

    def publish(self, message: Mapping[str, Any]) -> bool:
        """Send now. False without a connection: the message is dropped."""
        if not self.is_advertised:
            self.advertise()
        operation = {"op": "publish", "topic": self.name, "msg": dict(message), "latch": self.latch}
        return bool(self.ros.send_now(operation))

    def unadvertise(self) -> None:
        if not self.is_advertised:
            return
        self.ros.send_on_ready({"op": "unadvertise", "id": self._advertise_id, "topic": self.name})
        self._advertise_id = None

    def _connect_topic(self, message: Mapping[str, Any]) -> None:
        # The connection remembers subscriptions, so that no loss handler is needed.
        self.ros.send_on_ready(message)


def topic_of_publish(payload: bytes) -> bytes | None:
    """Topic of an encoded publish, from its first bytes; None if unclear."""
    head = payload[:HEAD_BYTES]
    if head[:1] == b"{":
        head = head.partition(b'"msg"')[0]
        found = _JSON_TOPIC.search(head)
        return found[1] if found and _JSON_PUBLISH.search(head) else None
    head = head.partition(b"\x63msg")[0]
    if _CBOR_PUBLISH not in head:
        return None
    found = _CBOR_TOPIC.search(head)
    if found is None:
        return None
    length = found[1][0] - 0x60 if found[1] else found[2][0]
    return head[found.end() : found.end() + length]


def _key_of(operation: Mapping[str, Any]) -> str:
    if "id" in operation:
        return f"{operation['op']} {operation['id']}"
    return f"{operation['op']} {operation.get('service', operation.get('topic'))}"
