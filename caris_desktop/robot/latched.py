"""Latched topics: their one message must arrive, also where rosbridge subscribed before the publisher was there."""

import asyncio
import logging
from collections.abc import Callable
from typing import Any

from caris_desktop.robot.transport import SafeRos, SafeTopic, ServiceCallError
from caris_desktop.ros.dialect import Dialect

logger = logging.getLogger(__name__)

FIRST_LOOK_S = 3.0
LONGEST_PAUSE_S = 60.0


class _Listener:
    """One subscription, and whether anything came on it in this connection."""

    def __init__(self, topic: SafeTopic, take: Callable[[Any], None]) -> None:
        self.topic = topic
        self.heard = False
        self._take = take

    def hear(self, message: Any) -> None:
        self.heard = True
        self._take(message)


class LatchedTopics:
    """Subscribes anew to latched topics that stay silent although the robot lists them. ROS 2 only.

    rosbridge of ROS 2 takes its quality of service from the publishers that it knows when a subscription is made. Made
    too early it is volatile, and a message that was published once, before that, never comes.
    """

    def __init__(self, ros: SafeRos, dialect: Dialect) -> None:
        self._ros = ros
        self._dialect = dialect
        # Several may listen to a topic of one name, each with a subscription of its own.
        self._known: list[_Listener] = []
        self._watch: asyncio.Task[None] | None = None

    def subscribe(self, topic: SafeTopic, take: Callable[[Any], None]) -> None:
        """Subscribe to ``topic``, and see to it that it is heard."""
        listener = _Listener(topic, take)
        self._known.append(listener)
        topic.subscribe(listener.hear)
        if self._ros.is_connected:
            self._begin()

    def unsubscribe(self, topic: SafeTopic) -> None:
        """End a subscription that was made here."""
        self._known = [listener for listener in self._known if listener.topic is not topic]
        topic.unsubscribe()

    def link_connected(self) -> None:
        for listener in self._known:
            listener.heard = False
        self._begin()

    def link_lost(self) -> None:
        """Also to be called when the link ends."""
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None

    def _begin(self) -> None:
        if self._dialect is Dialect.ROS2 and self._known and (self._watch is None or self._watch.done()):
            self._watch = asyncio.get_running_loop().create_task(self._look_after())

    async def _look_after(self) -> None:
        pause_s = FIRST_LOOK_S
        while True:
            await asyncio.sleep(pause_s)
            silent = [listener for listener in self._known if not listener.heard]
            if not silent:
                return
            try:
                answer = await self._ros.ask("/rosapi/topics", "rosapi_msgs/srv/Topics")
            except ServiceCallError as error:
                logger.debug("Latched topics: %s", error)
                return
            listed = answer.get("topics")
            for listener in silent:
                if isinstance(listed, list) and listener.topic.name in listed:
                    logger.info("Nothing came on the latched topic %s; subscribing anew", listener.topic.name)
                    listener.topic.unsubscribe()
                    listener.topic.subscribe(listener.hear)
            # A map that is still being made comes later by itself; asking on and on costs the robot something.
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)
