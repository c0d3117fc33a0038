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


class LatchedTopics:
    """Subscribes anew to latched topics that stay silent although the robot lists them. ROS 2 only.

    rosbridge of ROS 2 takes its quality of service from the publishers that it knows when a subscription is made. Made
    too early it is volatile, and a message that was published once, before that, never comes.
    """

    def __init__(self, ros: SafeRos, dialect: Dialect) -> None:
        self._ros = ros
        self._dialect = dialect
        self._silent: dict[str, tuple[SafeTopic, Callable[[Any], None]]] = {}
        self._known: dict[str, tuple[SafeTopic, Callable[[Any], None]]] = {}
        self._watch: asyncio.Task[None] | None = None

    def subscribe(self, topic: SafeTopic, take: Callable[[Any], None]) -> None:
        """Subscribe to ``topic``, and see to it that it is heard."""

        def heard(message: Any) -> None:
            self._silent.pop(topic.name, None)
            take(message)

        self._known[topic.name] = (topic, heard)
        topic.subscribe(heard)

        if self._dialect is Dialect.ROS2 and self._ros.is_connected:
            self._silent[topic.name] = (topic, heard)
            self._begin()

    def unsubscribe(self, topic: SafeTopic) -> None:
        """End a subscription that was made here."""
        self._known.pop(topic.name, None)
        self._silent.pop(topic.name, None)
        topic.unsubscribe()

    def link_connected(self) -> None:
        self.link_lost()
        if self._dialect is Dialect.ROS2 and self._known:
            self._silent = dict(self._known)
            self._begin()

    def link_lost(self) -> None:
        """Also to be called when the link ends."""
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None

    def _begin(self) -> None:
        if self._watch is None or self._watch.done():
            self._watch = asyncio.get_running_loop().create_task(self._look_after())

    async def _look_after(self) -> None:
        pause_s = FIRST_LOOK_S
        while True:
            await asyncio.sleep(pause_s)
            if not self._silent:
                return
            try:
                answer = await self._ros.ask("/rosapi/topics", "rosapi_msgs/srv/Topics")
            except ServiceCallError as error:
                logger.debug("Latched topics: %s", error)
                return
            listed = answer.get("topics")
            for name, (topic, heard) in list(self._silent.items()):
                if isinstance(listed, list) and name in listed:
                    logger.info("Nothing came on the latched topic %s; subscribing anew", name)
                    topic.unsubscribe()
                    topic.subscribe(heard)
            # A map that is still being made comes later by itself; asking on and on costs the robot something.
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)
