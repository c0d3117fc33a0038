"""Link context: connection, measurement, watched subscriptions, and reports, shared by the parts of one link."""

import asyncio
import logging
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, Literal

from caris_desktop.robot.link_measurement import LinkMeasurement
from caris_desktop.robot.link_process import ConsoleSender, LinkReporter
from caris_desktop.robot.profile_model import RobotProfile, TopicSource
from caris_desktop.robot.subscription_watchdog import SubscriptionWatchdog
from caris_desktop.robot.traffic import TrafficMeter
from caris_desktop.robot.transport import LinkObserver, RosbridgeClient, RosbridgeTopic
from caris_desktop.ros.dialect import Dialect

logger = logging.getLogger(__name__)


class LinkContext:
    """Shared by the parts of a link, on its loop. ``put`` sends a value to the console.

    Parameters
    ----------
    streams
        Recorded stream of each topic whose missing messages are to be reported.
    options
        Further options of :class:`RosbridgeClient`.
    """

    def __init__(
        self,
        link: Literal["control", "media"],
        profile: RobotProfile,
        address: str,
        outbox: ConsoleSender,
        observer: LinkObserver,
        *,
        streams: Mapping[str, str],
        **options: Any,
    ) -> None:
        self.profile = profile
        self.put = outbox.put
        self.report = LinkReporter(link, address, outbox)
        traffic, dialect = TrafficMeter(link), Dialect(profile.ros)
        self.ros = RosbridgeClient(
            address, observer, security=profile.security, traffic=traffic, dialect=dialect, **options
        )
        self.measurement = LinkMeasurement(
            self.ros, traffic, self.put, link=link, streams=streams, simulation_time=profile.simulation_time
        )
        self.watched = SubscriptionWatchdog(self.ros, report=self.put)
        self._tasks: set[asyncio.Task[None]] = set()

    def start(self) -> None:
        """Connect, and measure."""
        self.report.changed("connecting")
        self.ros.connect()
        self.in_background(self.measurement.run())

    def listen(
        self,
        source: TopicSource | None,
        message_type: str,
        take: Callable[[Any], None],
        *,
        queue_length: int = 1,
        watched: bool = True,
    ) -> None:
        """Subscribe, if the profile has such a topic. Above a ``queue_length`` of 1, every message is delivered."""
        if source is None:
            return
        topic = RosbridgeTopic(
            self.ros,
            source.topic,
            message_type,
            throttle_rate=source.throttle_ms,
            queue_length=queue_length,
            every_message=queue_length > 1,
        )
        if watched or source.latched:
            self.watched.subscribe(topic, take)
        else:
            topic.subscribe(take)

    def in_background(self, work: Coroutine[Any, Any, None]) -> None:
        """Run a coroutine until its end or :meth:`cancel`; its exceptions are logged."""
        self.begin(work)

    def begin(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        """As :meth:`in_background`; returns the task."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._finished)
        return task

    def cancel(self) -> None:
        """Cancel what runs in the background."""
        for task in self._tasks:
            task.cancel()

    def _finished(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and task.exception() is not None:
            logger.error("Something in the background failed", exc_info=task.exception())
