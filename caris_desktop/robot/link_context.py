"""Link context: connection, statistics, watched subscriptions, and reports, shared by the parts of one link."""

import asyncio
import logging
import statistics
from collections import deque
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, Literal

from caris_desktop.domain import clock
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import LOST_ON_THE_WAY, OVERTAKEN, Gap, LinkQuality
from caris_desktop.robot.clock_offset import ClockOffset, OffsetEstimate
from caris_desktop.robot.link_process import ConsoleSender, LinkReporter
from caris_desktop.robot.profile_model import RobotProfile, TopicSource
from caris_desktop.robot.subscription_watchdog import SubscriptionWatchdog
from caris_desktop.robot.traffic import TrafficMeter
from caris_desktop.robot.transport import LinkObserver, RosbridgeClient, RosbridgeTopic, ServiceCallError
from caris_desktop.ros.dialect import Dialect, decode_time

logger = logging.getLogger(__name__)

MEASURE_EVERY_S = 1.0
_POLL_EVERY_S = 0.1
_ROUND_TRIPS = 10
_PERIODS = 40
_LONGEST_GAP_NS = 1_000_000_000
_UNKNOWN_DELAY_S = 0.1
_SIMULATION_TIME_EVERY_NS = 50_000_000


class MessageLossCounter:
    """Counts missing messages of one topic, by the robot's stamps.

    rosbridge and the network do not report drops. For a sender with a constant rate, such as a LIDAR or base, gaps
    between stamps are whole numbers of periods. Pauses of over a second are covered by the stream's age.
    """

    def __init__(self) -> None:
        self._before_ns: int | None = None
        self._periods_ns: deque[int] = deque(maxlen=_PERIODS)
        self._count = 0
        self._overtaken = 0

    def add(self, robot_stamp_ns: int | None) -> None:
        before_ns, self._before_ns = self._before_ns, robot_stamp_ns
        if before_ns is None or robot_stamp_ns is None:
            return
        apart_ns = robot_stamp_ns - before_ns
        if not 0 < apart_ns <= _LONGEST_GAP_NS:
            return
        if len(self._periods_ns) == _PERIODS:
            periods = sorted(self._periods_ns)
            usual_ns = periods[_PERIODS // 2]
            # Without a constant rate, or with an unsuitable throttle, drops cannot be detected.
            steady = periods[_PERIODS * 9 // 10] < 1.3 * usual_ns
            if steady and apart_ns > 1.7 * usual_ns:
                self._count += round(apart_ns / usual_ns) - 1
        self._periods_ns.append(apart_ns)

    def pop(self, *, overtaken: int) -> int:
        """Missing messages since the last call, except known ``overtaken`` ones."""
        self._overtaken += overtaken
        known = min(self._count, self._overtaken)
        lost, self._count = self._count - known, 0
        self._overtaken -= known
        return lost


class LinkMeasurement:
    """Queries the robot's time once per second and reports measurements. Lives on the link's loop.

    Parameters
    ----------
    link
        Which link it is. Only the control link sends LinkQuality; both send TrafficMeasured.
    streams
        Recorded stream of each topic whose missing messages are to be reported.
    simulation_time
        The robot's stamps come from a simulated clock, set with :meth:`add_simulation_time`.
    """

    def __init__(
        self,
        ros: RosbridgeClient,
        traffic: TrafficMeter,
        put: Callable[[Any], None],
        *,
        link: Literal["control", "media"],
        streams: Mapping[str, str],
        simulation_time: bool = False,
    ) -> None:
        self._ros = ros
        self._traffic = traffic
        self._put = put
        self._link = link
        self._streams = streams
        self._simulation_time = simulation_time
        self._clock = ClockOffset.of_simulation_time() if simulation_time else ClockOffset()
        self._simulation_time_ns = 0
        self._round_trips_s: deque[float] = deque(maxlen=_ROUND_TRIPS)
        self._lost = {topic: MessageLossCounter() for topic in streams}

    def offset_at(self, session_ns: int) -> OffsetEstimate | None:
        """Robot clock minus session clock at a time not before the last sample."""
        return self._clock.at(session_ns)

    def measured_ns(self, robot_stamp_ns: int | None, arrival_ns: int) -> tuple[int | None, int]:
        """Session time of a robot's stamp, None if unusable, and its uncertainty in ns."""
        offset = self._clock.at(arrival_ns)
        if offset is None:
            return None, 0
        measured_ns = clock.measured_ns(
            robot_stamp_ns, arrival_ns=arrival_ns, offset_ns=offset.offset_ns, uncertainty_ns=offset.uncertainty_ns
        )
        return measured_ns, offset.uncertainty_ns

    def add_round_trip(self, round_trip_s: float) -> None:
        """Add a ping's round trip."""
        self._round_trips_s.append(round_trip_s)

    def add_message(self, topic: str, robot_stamp_ns: int | None) -> None:
        """Add a message of one of the ``streams``, with the robot's stamp."""
        self._lost[topic].add(robot_stamp_ns)

    def add_stamp(self, robot_stamp_ns: int | None) -> None:
        """Add the stamp of the present message, if it is never ahead of the robot's clock."""
        if robot_stamp_ns is not None and not self._simulation_time:
            self._clock.add_stamp(robot_stamp_ns=robot_stamp_ns, arrival_ns=self._ros.arrival_ns)

    def add_simulation_time(self, robot_ns: int) -> None:
        """Add a message of ``/clock``. Its network delay is only known from the pings."""
        arrival_ns = self._ros.arrival_ns
        if arrival_ns - self._simulation_time_ns < _SIMULATION_TIME_EVERY_NS:
            # Gazebo publishes it a thousand times per second.
            return
        self._simulation_time_ns = arrival_ns
        delay_s = max(self._round_trips_s, default=_UNKNOWN_DELAY_S)
        self._clock.add_exchange(sent_ns=arrival_ns - int(delay_s * 1e9), answered_ns=arrival_ns, robot_ns=robot_ns)

    def link_lost(self) -> None:
        """Drop round trips; the clock estimate continues."""
        self._round_trips_s.clear()
        self._lost = {topic: MessageLossCounter() for topic in self._streams}

    async def run(self) -> None:
        """Measure until cancelled."""
        # An unresponsive robot must not delay other reports.
        await asyncio.gather(self._report(), self._follow_clock())

    async def _report(self) -> None:
        while True:
            await asyncio.sleep(MEASURE_EVERY_S)
            at_ns = now_ns()
            overtaken = self._ros.factory.pop_overtaken()
            for topic, stream in self._streams.items():
                if count := overtaken.get(topic, 0):
                    self._put(Gap(at_ns, stream, count, OVERTAKEN))
                # Values dropped here are missing among the stamps as well.
                if lost := self._lost[topic].pop(overtaken=count):
                    self._put(Gap(at_ns, stream, lost, LOST_ON_THE_WAY))
            if not self._ros.is_connected:
                continue
            self._put(self._traffic.measure(at_ns, self._clock.at))
            if self._link == "control" and self._round_trips_s:
                offset = self._clock.at(at_ns)
                self._put(
                    LinkQuality(
                        at_ns,
                        statistics.median(self._round_trips_s) * 1e3,
                        None if offset is None else offset.offset_ms,
                        None if offset is None else offset.uncertainty_ms,
                    )
                )

    async def _follow_clock(self) -> None:
        while not self._simulation_time:
            connected = self._ros.is_connected
            if connected:
                await self._ask_for_time()
            await asyncio.sleep(MEASURE_EVERY_S if connected else _POLL_EVERY_S)

    async def _ask_for_time(self) -> None:
        sent_ns = now_ns()
        try:
            answer = await self._ros.ask("/rosapi/get_time", "rosapi/GetTime")
            robot_ns = decode_time(answer.get("time"))
        except (ServiceCallError, ValueError) as error:
            logger.debug("The robot does not tell its time: %s", error)
            return
        if robot_ns is not None:
            self._clock.add_exchange(sent_ns=sent_ns, answered_ns=now_ns(), robot_ns=robot_ns)


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
