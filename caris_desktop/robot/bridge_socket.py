"""Websocket to a rosbridge server: operations, pending answers, and authentication."""

import asyncio
import logging
import math
import re
import threading
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import roslibpy
from roslibpy.comm import RosBridgeProtocol
from roslibpy.core import GoalStatus

from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.robot.bridge_security import SecurityError, auth_operation
from caris_desktop.robot.bridge_wire import Wire, open_wire
from caris_desktop.robot.profile_model import SecuritySettings
from caris_desktop.robot.real_time import LARGE_BYTES, drop_realtime_priority
from caris_desktop.ros.rosbridge import FragmentAssembler, ProtocolError, decode_cbor, decode_json, encode_json

if TYPE_CHECKING:  # its factory creates instances of this
    from caris_desktop.robot.transport import RosbridgeFactory

logger = logging.getLogger(__name__)

Operation = dict[str, Any]
Callback = Callable[..., Any]

HEAD_BYTES = 400
_TAIL_BYTES = 400
_LONGEST_REASON = 500
_JSON_ANSWER = re.compile(rb'"op"\s*:\s*"service_response"')
_JSON_ID = re.compile(rb'"id"\s*:\s*"(call_service:[^"\\]+)"')
_ADMISSION_S = 3.0
_ADMISSION_SERVICE = "/rosapi/get_time"


class NoAnswer(str):
    """Reason for a failed call without the robot's answer."""

    __slots__ = ()


class LargeAnswer(Value):
    """Answer too large to decode; ``tail`` is its raw end."""

    size_bytes: int
    tail: bytes

    def __str__(self) -> str:
        return f"its response of {self.size_bytes / 2**20:.0f} MB is too large"


class RosbridgeProtocol(RosBridgeProtocol):  # type: ignore[misc]  # roslibpy has no types
    """rosbridge operations of one websocket."""

    _pending_service_requests: dict[str, tuple[Callback | None, Callback | None]]
    _pending_action_requests: dict[str, tuple[Callback | None, Callback | None, Callback | None]]

    def __init__(self, factory: "RosbridgeFactory", wire: Wire) -> None:
        super().__init__()
        self.factory = factory
        self.wire = wire
        self.began_s = factory.manager.loop.time()
        self._fragments = FragmentAssembler(max_bytes=factory.sizes.message_bytes)
        self._binary = False
        self._message_handlers["status"] = self._handle_status
        self._message_handlers["fragment"] = self._handle_fragment

    @property
    def waits(self) -> bool:
        """True while a call or goal of this websocket is unanswered."""
        return bool(self._pending_service_requests or self._pending_action_requests)

    def has_goal(self, goal_id: str | None = None) -> bool:
        """True if this goal, or any, was sent here and has not ended."""
        goals = self._pending_action_requests
        return bool(goals) if goal_id is None else goal_id in goals

    def on_message(self, payload: bytes) -> None:
        """Decode and handle one message. Never raises."""
        factory = self.factory
        if len(payload) > LARGE_BYTES:
            drop_realtime_priority()
        if len(payload) > factory.sizes.message_bytes:
            if not self._receive_large_answer(payload):
                factory.refuse(
                    localized(
                        QT_TR_NOOP("a message of {payload} MB, which is too large"),
                        payload=f"{len(payload) / 2**20:.0f}",
                    )
                )
            return
        # Some servers mix up frame types. A CBOR map begins above 0x80, and JSON never does.
        binary = payload[:1] >= b"\x80"
        try:
            operation = decode_cbor(payload) if binary else decode_json(str(payload, "utf-8"))
        except (ProtocolError, UnicodeDecodeError) as error:
            factory.refuse(str(error))
            if binary:
                factory.binary_failed()
            return
        if binary:
            factory.binary_worked()
        self._binary = binary
        self._handle(operation)

    def _receive_large_answer(self, payload: bytes) -> bool:
        """True if it answers a call, which fails then: the whole message is never decoded."""
        ends = payload[:HEAD_BYTES], payload[-_TAIL_BYTES:]
        if not any(_JSON_ANSWER.search(end) for end in ends):
            return False
        found = next((found for end in ends if (found := _JSON_ID.search(end))), None)
        request_id = "" if found is None else found[1].decode("utf-8", "replace")
        _, errback = self._pending_service_requests.pop(request_id, (None, None))
        if errback is None:
            return False
        self.factory.run_safely(errback, LargeAnswer(len(payload), ends[1]))
        return True

    def _handle(self, operation: Operation) -> None:
        handler = self._message_handlers.get(operation["op"])
        if handler is None:
            self.factory.refuse(
                localized(QT_TR_NOOP("an unknown operation {operation}"), operation=f"{operation['op']!r}")
            )
            return
        try:
            handler(operation)
        except Exception as error:
            # Callbacks are guarded one by one: an error here means a malformed operation.
            self.factory.refuse(
                localized(
                    QT_TR_NOOP("a malformed {operation}: {name}: {error}"),
                    operation=operation["op"],
                    name=type(error).__name__,
                    error=error,
                )
            )

    def send_message(self, payload: bytes) -> bool:
        """Send one encoded operation. Any thread; False if it was not sent by this call itself."""
        if threading.get_ident() == self.factory.manager.thread_id:
            return self.wire.send_text(payload)
        self.factory.manager.loop.call_soon_threadsafe(self.wire.send_text, payload)
        return False

    def send_close(self) -> None:
        self.factory.stop()

    def send_operation(self, operation: Mapping[str, Any]) -> bool:
        try:
            payload = encode_json(dict(operation)).encode()
        except ProtocolError:
            logger.exception("A message to the robot could not be written and was dropped")
            return False
        return self.send_message(payload)

    def send_ros_message(self, message: Mapping[str, Any]) -> bool:
        return self.send_operation(message)

    def send_ros_service_request(
        self, message: Mapping[str, Any], callback: Callback, errback: Callback, timeout_s: float | None = None
    ) -> None:
        wait_s = self.factory.service_timeout_s if timeout_s is None else timeout_s
        self._pending_service_requests[message["id"]] = (callback, errback)
        self.send_operation(message)
        self.factory.manager.call_later(wait_s, lambda: self._time_out(message["id"], wait_s))

    def send_ros_action_goal(
        self, message: Mapping[str, Any], resultback: Callback, feedback: Callback, errback: Callback
    ) -> None:
        self._pending_action_requests[message["id"]] = (resultback, feedback, errback)
        self.send_operation(message)

    def forget_goal(self, goal_id: str) -> None:
        self._pending_action_requests.pop(goal_id, None)

    def fail_everything(self, reason: str) -> None:
        """Fail all pending operations, as the connection is over."""
        services, self._pending_service_requests = self._pending_service_requests, {}
        actions, self._pending_action_requests = self._pending_action_requests, {}
        for _, errback in services.values():
            self.factory.run_safely(errback, reason)
        for _, _, errback in actions.values():
            self.factory.run_safely(errback, {"status": GoalStatus.UNKNOWN, "values": {"error_msg": reason}})
        self._fragments.clear()

    def _time_out(self, request_id: str, waited_s: float) -> None:
        _, errback = self._pending_service_requests.pop(request_id, (None, None))
        if errback is None:
            return
        self.factory.not_answered(self)
        self.factory.run_safely(
            errback, NoAnswer(localized(QT_TR_NOOP("no response within {waited_s} s"), waited_s=f"{waited_s:g}"))
        )

    def _handle_publish(self, message: Operation) -> None:
        if not isinstance(message["topic"], str):
            raise TypeError("the topic is not a string")
        self.factory.queue_publish(message["topic"], message["msg"], binary=self._binary)

    def _handle_service_response(self, message: Operation) -> None:
        callback, errback = self._pending_service_requests.pop(message["id"], (None, None))
        if callback is None and errback is None:
            logger.info("An answer came that nobody waits for any more: %r", message["id"])
        elif message.get("result") is False:
            self.factory.run_safely(errback, message.get("values"))
        else:
            self.factory.run_safely(callback, roslibpy.ServiceResponse(message.get("values") or {}))

    def _handle_action_feedback(self, message: Operation) -> None:
        _, feedback, _ = self._pending_action_requests.get(message["id"], (None, None, None))
        self.factory.run_safely(feedback, roslibpy.Feedback(message["values"]))

    def _handle_action_result(self, message: Operation) -> None:
        resultback, _, errback = self._pending_action_requests.pop(message["id"], (None, None, None))
        values = message.get("values")
        # A call that never reached the action server is answered with a text.
        values = values if isinstance(values, dict) else {"error_msg": str(values or "")}
        status = message.get("status", values.get("status"))
        try:
            known = GoalStatus(status)
        except ValueError:
            known = GoalStatus.UNKNOWN
        results = {"status": known, "values": values}
        if message.get("result") is False:
            self.factory.run_safely(errback, results)
        else:
            self.factory.run_safely(resultback, roslibpy.Result(results))

    def _handle_status(self, message: Operation) -> None:
        levels = {"error": logging.ERROR, "warning": logging.WARNING}
        level = levels.get(str(message.get("level")), logging.INFO)
        logger.log(level, "rosbridge says: %.500s", message.get("msg"))
        if level == logging.ERROR:
            # Some servers report a failed call only in this way.
            request_id = str(message.get("id"))
            _, errback = self._pending_service_requests.pop(request_id, (None, None))
            self.factory.run_safely(errback, str(message.get("msg"))[:_LONGEST_REASON])

    def _handle_fragment(self, message: Operation) -> None:
        message_bytes = self._fragments.add(message)
        if message_bytes is None:
            return
        if message_bytes["op"] == "fragment":
            raise ProtocolError("a fragment must not contain fragments")
        self._handle(message_bytes)


class WaitingOperation(Value):
    """Operation for a websocket that is being opened."""

    id: str
    send: Callable[[RosbridgeProtocol], None]
    fail: Callable[[str], None]


class BridgeSocket:
    """One of the websockets of a :class:`RosbridgeFactory`. A ``WireOwner``."""

    def __init__(self, factory: "RosbridgeFactory") -> None:
        self._factory = factory
        self._admission: asyncio.Future[None] | None = None
        self._wire: Wire | None = None
        self.protocol: RosbridgeProtocol | None = None
        self.silent = False
        self.waiting: list[WaitingOperation] = []

    @property
    def is_open(self) -> bool:
        return self.protocol is not None and self.protocol.wire.is_open

    @property
    def received_s(self) -> float:
        """When anything last came over it."""
        return -math.inf if self._wire is None else self._wire.received_s

    @property
    def is_free(self) -> bool:
        """True if no operation is queued or pending."""
        return not self.waiting and (self.protocol is None or not self.protocol.waits)

    async def open(self, *, ask_first: bool) -> None:
        """Connect. Raises what ``open_wire`` does, and SecurityError if the server refuses access."""
        factory = self._factory
        self._wire = await open_wire(
            factory.url, self, factory.timings, largest_frame_bytes=factory.sizes.frame_bytes, security=factory.security
        )
        if ask_first:
            await self._ask_for_admission(self._wire)

    def begin(self) -> bool:
        """Start sending. False if the connection has ended meanwhile."""
        self.silent = False
        if self._wire is not None and self._wire.is_open:
            self.protocol = RosbridgeProtocol(self._factory, self._wire)
        return self.protocol is not None

    def abort(self, reason: str) -> None:
        if self._wire is not None:
            self._wire.abort(reason)

    def close(self) -> None:
        if self._wire is not None:
            self._wire.close()

    def pop_protocol(self) -> RosbridgeProtocol | None:
        """Return and clear the finished protocol."""
        protocol, self.protocol = self.protocol, None
        return protocol

    async def _ask_for_admission(self, wire: Wire) -> None:
        """Authenticate if the profile says so, and wait for any answer of the server.

        A rosbridge with rosauth is silent on success and closes the connection on failure.

        Raises
        ------
        SecurityError
            When it does not answer.
        """
        factory = self._factory
        self._admission = factory.manager.loop.create_future()
        try:
            authorization = auth_operation(factory.security, client=wire.own_host, server=wire.peer_host)
            question = {
                "op": "call_service",
                "service": _ADMISSION_SERVICE,
                "args": {},
                "id": f"admission:{next(factory.admission_numbers)}",
            }
            for operation in (authorization, question):
                if operation is not None:
                    wire.send_text(encode_json(operation).encode())
            async with asyncio.timeout(_ADMISSION_S):
                await self._admission
        except (ConnectionError, TimeoutError) as error:
            raise _refusal(factory.security) from error
        finally:
            admission, self._admission = self._admission, None
            if not admission.done() or admission.cancelled() or admission.exception() is not None:
                wire.abort(QT_TR_NOOP("access denied"))

    def wire_received(self, payload: bytes) -> None:
        if self._admission is not None:
            if not self._admission.done() and b"service_response" in payload[:HEAD_BYTES]:
                self._admission.set_result(None)
        elif self.protocol is not None:
            self._factory.receive(payload, self.protocol)

    def server_received_s(self) -> float:
        return self._factory.server_received_s()

    def wire_recovered(self) -> None:
        self.silent = False
        if self.protocol is not None:
            self._factory.socket_recovered()

    def wire_silent(self) -> None:
        self.silent = True
        if self.protocol is not None:
            self._factory.socket_silent(self)

    def wire_round_trip(self, round_trip_s: float) -> None:
        if self.protocol is not None:
            self._factory.socket_round_trip(self, round_trip_s)

    def wire_lost(self, reason: str) -> None:
        if self._admission is not None and not self._admission.done():
            self._admission.set_exception(ConnectionError(reason))
        if self.protocol is not None:
            self._factory.socket_lost(self, reason)


def _refusal(security: SecuritySettings) -> SecurityError:
    name = security.rosauth_secret_env
    if name is None:
        return SecurityError(
            QT_TR_NOOP("The robot's rosbridge closes every connection immediately."),
            QT_TR_NOOP(
                "If rosbridge requires a secret (rosauth), put it into an environment variable and enter the "
                "variable's name under Security ('rosauth_secret_env' in the robot profile). See the "
                "rosbridge log for details."
            ),
        )
    return SecurityError(
        QT_TR_NOOP("The robot's rosbridge refused this console: the secret was not accepted."),
        localized(
            QT_TR_NOOP(
                "Check that the environment variable {name} contains the robot's rosauth secret and that "
                "rosauth is running on the robot. Also check that the clocks of this computer and the robot "
                "differ by less than 5 s."
            ),
            name=name,
        ),
    )
