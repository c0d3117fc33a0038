"""Detection of a stalled rosbridge queue on the motion websocket."""

import asyncio
import itertools
import secrets
from collections.abc import Callable
from typing import Any

from caris_desktop.robot.bridge_socket import NoAnswer
from caris_desktop.robot.transport import RosbridgeClient, RosbridgeTopic
from caris_desktop.ros.message_fields import message_of, text

HANDLED_TOPIC = "/caris_desktop/handled"
# A nonexistent service is refused in the queue, without waiting.
NO_SERVICE = "/caris_desktop/no_such_service"
UNHANDLED_AFTER_S = 1.0
_CONFIRMED_AFTER_S = 0.3
_REQUEST_EVERY_S = 0.5
_SECOND_QUESTION_AFTER_S = 0.1
_WAITED_FOR_AT_MOST_S = 3.0
_MOST_UNHANDLED = 4


class HandledOperations:
    """Requests, behind the commands, a sign that everything before was handled.

    rosbridge answers a ping as soon as it is read, while operations may wait in their websocket's queue. A message of
    our own on a topic that the same websocket subscribes comes back in order. Before the first one, and when one is
    late, a nonexistent service is called as well: rosbridge refuses it in the same queue, but logs an error each time,
    and topics may be restricted where services are not. A server that gives neither sign (both restricted) is judged by
    pings alone, see :attr:`unproven`.

    ``handled`` gets the time since the request, in seconds.
    """

    def __init__(self, ros: RosbridgeClient, *, handled: Callable[[float], None]) -> None:
        self._loop = asyncio.get_running_loop()
        self._ros = ros
        self._handled = handled
        self._sender_id = secrets.token_hex(4)
        self._numbers = itertools.count(1)
        self._requested_s: dict[int, float] = {}
        self._last_request_s = 0.0
        self._connected_s = 0.0
        self._offered = False
        self._comes_back = False
        self._proven_once = False
        self._read_to_s = 0.0
        self._unhandled_since_s: float | None = None
        self._topic = RosbridgeTopic(
            ros, HANDLED_TOPIC, "std_msgs/String", compression="none", queue_length=0, every_message=True, motion=True
        )
        self._topic.advertise()
        self._topic.subscribe(self._on_answer)

    @property
    def counts(self) -> bool:
        """True if this server has given such a sign; until then pings count."""
        return self._proven_once

    @property
    def unproven(self) -> bool:
        """True if the first sign is overdue."""
        return not self._proven_once and self._loop.time() - self._connected_s >= _WAITED_FOR_AT_MOST_S

    def link_connected(self) -> None:
        self._connected_s = self._read_to_s = self._loop.time()
        self._offered = True
        self.request()

    def link_lost(self) -> None:
        self._requested_s.clear()
        self._offered = False
        self._comes_back = False
        self._unhandled_since_s = None

    def read(self, round_trip_s: float) -> None:
        """A ping came back: everything sent before has been read."""
        self._read_to_s = max(self._read_to_s, self._loop.time() - round_trip_s)

    def request(self) -> None:
        """Send a request behind the latest commands."""
        now_s = self._last_request_s = self._loop.time()
        late = any(now_s - requested_s > _SECOND_QUESTION_AFTER_S for requested_s in self._requested_s.values())
        number = next(self._numbers)
        self._requested_s[number] = now_s
        if self._offered:
            self._topic.publish({"data": f"{self._sender_id} {number}"})
        protocol = self._ros.factory.motion_protocol
        if protocol is not None and (late or not self._comes_back):

            def answer(reason: Any) -> None:
                if not isinstance(reason, NoAnswer):
                    self._answered(number)

            question = {"op": "call_service", "id": f"{NO_SERVICE}:{self._sender_id}:{number}", "service": NO_SERVICE}
            protocol.send_ros_service_request(question, answer, answer, _WAITED_FOR_AT_MOST_S)

    def request_periodically(self) -> None:
        """Send periodic requests, so that the state is known before the next command."""
        if self._loop.time() - self._last_request_s >= _REQUEST_EVERY_S and len(self._requested_s) < _MOST_UNHANDLED:
            self.request()

    def stuck(self) -> bool:
        """True if rosbridge reads messages but has not handled older ones."""
        now_s = self._loop.time()
        oldest_s = next(iter(self._requested_s.values()), now_s)
        if not self._proven_once or self._read_to_s - oldest_s < UNHANDLED_AFTER_S:
            self._unhandled_since_s = None
            return False
        if self._unhandled_since_s is None:
            # A suspended server answers all pings first when it wakes up.
            self._unhandled_since_s = now_s
        return now_s - self._unhandled_since_s >= _CONFIRMED_AFTER_S

    def _on_answer(self, message: Any) -> None:
        sender, _, number = text(message_of(message, "String"), "data", "String").partition(" ")
        if sender == self._sender_id and number.isdecimal() and int(number) in self._requested_s:
            self._comes_back = True
            self._answered(int(number))

    def _answered(self, number: int) -> None:
        requested_s = self._requested_s.get(number)
        if requested_s is None:
            return
        self._proven_once = True
        self._requested_s = {later: at_s for later, at_s in self._requested_s.items() if later > number}
        self._handled(self._loop.time() - requested_s)
