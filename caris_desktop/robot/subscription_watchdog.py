"""Subscription watchdog: renews silent subscriptions, also in the other encoding, until messages arrive."""

import asyncio
import logging
from collections.abc import Callable
from typing import Any, Literal

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import Problem
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.robot.transport import RosbridgeClient, RosbridgeTopic, ServiceCallError
from caris_desktop.ros.dialect import Dialect

logger = logging.getLogger(__name__)

FIRST_CHECK_S = 3.0
LONGEST_PAUSE_S = 60.0
_ENCODINGS = {"cbor": "compact encoding (CBOR)", "none": "plain text (JSON)"}


# Messages that the server sent before it read the new encoding.
_IN_FLIGHT_S = 1.0


class _Listener:
    """One subscription, and whether it received anything in this connection.

    ``encoding``: usual for its type; other, as a trial; usual again, to confirm the cause; or settled on the other.
    """

    def __init__(
        self, topic: RosbridgeTopic, take: Callable[[Any], None], on_received: Callable[["_Listener"], None]
    ) -> None:
        self.topic = topic
        self.received = False
        self.resubscriptions = 0
        self.encoding: Literal["usual", "other", "back", "settled"] = "usual"
        self._take = take
        self._on_received = on_received

    def on_message(self, message: Any) -> None:
        if not self.received:
            self._on_received(self)
        self._take(message)


class SubscriptionWatchdog:
    """Renews subscriptions that are silent although the robot has a publisher.

    Two causes are possible. rosbridge silently drops messages that it cannot encode as requested: the other encoding is
    tried. If messages then arrive, the first is tried once more, as the robot may only have been slow, and ``report``
    gets a Problem if it was not. And ROS 2's rosbridge copies its quality of service from the publishers known at
    subscription: if too early, it is volatile, and a message published once before never arrives.

    Topics with essential messages and normal silence do not belong here: in ROS 2 a message may be lost between old and
    new subscription.
    """

    def __init__(self, ros: RosbridgeClient, *, report: Callable[[Problem], None]) -> None:
        self._ros = ros
        self._report = report
        # Several listeners of one topic have separate subscriptions.
        self._known: list[_Listener] = []
        self._back_since_s: dict[str, float] = {}
        self._watch: asyncio.Task[None] | None = None

    def subscribe(self, topic: RosbridgeTopic, take: Callable[[Any], None]) -> None:
        """Subscribe to ``topic`` and watch it."""
        listener = _Listener(topic, take, self._on_first_message)
        self._known.append(listener)
        topic.subscribe(listener.on_message)
        if self._ros.is_connected:
            self._begin()

    def unsubscribe(self, topic: RosbridgeTopic) -> None:
        """End a subscription made here."""
        self._known = [listener for listener in self._known if listener.topic is not topic]
        topic.unsubscribe()

    def link_connected(self) -> None:
        for listener in self._known:
            listener.received = False
            listener.resubscriptions = 0
        self._begin()

    def link_lost(self) -> None:
        """Also to be called when the link ends."""
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None
        for listener in self._known:
            # Undecided trials restart in the next connection.
            if listener.encoding == "other":
                self._resubscribe(listener, other_encoding=True)
            if listener.encoding != "settled":
                listener.encoding = "usual"

    def _begin(self) -> None:
        if self._known and (self._watch is None or self._watch.done()):
            self._watch = asyncio.get_running_loop().create_task(self._supervise())

    async def _supervise(self) -> None:
        pause_s = FIRST_CHECK_S
        while True:
            await asyncio.sleep(pause_s)
            silent = {listener.topic.name: listener for listener in self._known if not listener.received}
            if not silent:
                return
            for name, listener in silent.items():
                if await self._is_published(name) and not listener.received:
                    self._change_subscription(listener)
            # A map in progress arrives later anyway; frequent requests cost the robot time.
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)

    async def _is_published(self, topic: str) -> bool:
        try:
            return bool(await self._ros.nodes("publishers", topic))
        except ServiceCallError as error:
            logger.debug("Who publishes %s is not known: %s", topic, error)
            return False

    def _change_subscription(self, listener: _Listener) -> None:
        if listener.encoding == "back":
            return  # that is decided soon
        # In ROS 2 the quality of service is the likelier reason: it comes first.
        other = self._ros.dialect is Dialect.ROS1 or listener.resubscriptions % 2 == 1
        listener.resubscriptions += 1
        if other and listener.encoding != "settled":
            listener.encoding = "other" if listener.encoding == "usual" else "usual"
            self._resubscribe(listener, other_encoding=True)
        else:
            self._resubscribe(listener, other_encoding=False)

    def _resubscribe(self, listener: _Listener, *, other_encoding: bool) -> str:
        name = listener.topic.name
        # In ROS 2 only a new subscription has a new quality of service; ROS 1 changes one without a gap.
        encoding = self._ros.factory.resubscribe(
            name, other_encoding=other_encoding, leave_first=self._ros.dialect is Dialect.ROS2
        )
        logger.info("Subscribing anew to %s, encoding %s", name, encoding)
        return str(encoding)

    def _on_first_message(self, listener: _Listener) -> None:
        loop = asyncio.get_running_loop()
        if listener.encoding == "other":
            listener.encoding = "back"
            self._back_since_s[listener.topic.name] = loop.time()
            self._resubscribe(listener, other_encoding=True)
            loop.call_later(FIRST_CHECK_S, self._settle, listener)
        elif listener.encoding == "back":
            usual = "cbor" if listener.topic.compression == "cbor" else "json"
            waited_s = loop.time() - self._back_since_s[listener.topic.name]
            if self._ros.factory.traffic.encoding_of(listener.topic.name) == usual or waited_s > _IN_FLIGHT_S:
                listener.encoding, listener.received = "usual", True
        else:
            listener.received = True

    def _settle(self, listener: _Listener) -> None:
        if listener.encoding != "back" or listener not in self._known:
            return
        listener.encoding, listener.received = "settled", True
        encoding = self._resubscribe(listener, other_encoding=True)
        if encoding not in _ENCODINGS:
            return
        name = listener.topic.name
        [before] = _ENCODINGS.keys() - {encoding}
        self._report(
            Problem(
                now_ns(),
                "info",
                localized(
                    QT_TR_NOOP("The robot sent nothing on {name} in {before}, but it does in {now}."),
                    name=name,
                    before=_ENCODINGS[before],
                    now=_ENCODINGS[encoding],
                ),
                QT_TR_NOOP("Messages are now received. Earlier messages are missing."),
                QT_TR_NOOP("No action is needed; the rosbridge log on the robot may show the reason."),
            )
        )
