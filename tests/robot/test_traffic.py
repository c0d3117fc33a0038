"""Traffic report of a link."""

import json
import os
import signal
import time
import timeit
from collections.abc import Iterator

import pytest

from caris_desktop.domain.events import OVERTAKEN, Gap, LinkQuality, TopicTraffic, TrafficMeasured
from caris_desktop.domain.sensing import Odometry
from caris_desktop.robot.clock_offset import OffsetEstimate
from caris_desktop.robot.traffic import TrafficMeter, stamp_of
from tests.robot.bridge_double import ODOMETRY
from tests.robot.link_bench import BridgeDouble, LinkProcess
from tests.support.polling import wait_for

S = 1_000_000_000


@pytest.fixture
def bridge() -> Iterator[BridgeDouble]:
    double = BridgeDouble()
    yield double
    double.kill()


def test_rate_size_age_and_refusals_are_counted_by_topic() -> None:
    meter = TrafficMeter("control")
    meter.listens("/scan", "sensor_msgs/LaserScan")
    meter.listens("/silent", "std_msgs/Empty")
    meter.measure(10 * S)
    for number in range(20):
        meter.arrived("/scan", size_bytes=1000, arrival_ns=10 * S + number * S // 10)
    meter.decoded("/scan", {"header": {"stamp": {"secs": 111, "nsecs": 850_000_000}}}, binary=True)
    meter.refused("/scan")
    meter.refused(None)
    measured = meter.measure(12 * S, lambda _: OffsetEstimate(100 * S, 1))
    assert (measured.link, measured.encoding, measured.refused) == ("control", "cbor", 2)
    assert measured.topics == (
        TopicTraffic("/scan", "sensor_msgs/LaserScan", 10.0, 10_000.0, 0.1, pytest.approx(50.0), 1, "cbor"),
        TopicTraffic("/silent", "std_msgs/Empty", 0.0, 0.0, None, None, 0),
    )
    # Nothing has arrived since, so its age grows.
    assert meter.measure(13 * S).topics[0] == TopicTraffic(
        "/scan", "sensor_msgs/LaserScan", 0.0, 0.0, pytest.approx(1.1), None, 1, "cbor"
    )


def test_a_link_that_uses_both_encodings_says_so() -> None:
    meter = TrafficMeter("control")
    for topic in ("/scan", "/odom"):
        meter.listens(topic, "")
        meter.arrived(topic, size_bytes=1, arrival_ns=0)
    meter.decoded("/scan", {}, binary=True)
    assert meter.measure(S).encoding == "cbor"
    meter.decoded("/odom", {}, binary=False)
    assert meter.measure(2 * S).encoding == "both"
    assert [topic.encoding for topic in meter.measure(3 * S).topics] == ["json", "cbor"]


def test_a_server_that_invents_topics_fills_no_memory() -> None:
    meter = TrafficMeter("media")
    for number in range(10_000):
        meter.arrived(f"/invented/{number}", size_bytes=1, arrival_ns=0)
    assert len(meter.measure(S).topics) <= 200


def test_stamps_are_read_in_either_dialect_and_never_believed_blindly() -> None:
    assert stamp_of({"header": {"stamp": {"secs": 1, "nsecs": 5}}}) == S + 5
    assert stamp_of({"header": {"stamp": {"sec": 1, "nanosec": 5}}}) == S + 5
    assert stamp_of({"transforms": [{"header": {"stamp": {"sec": 2, "nanosec": 0}}}]}) == 2 * S
    for message in (None, [], "x", {}, {"header": 5}, {"header": {"stamp": "now"}}, {"transforms": []}):
        assert stamp_of(message) is None
    assert stamp_of({"header": {"stamp": {"secs": 0, "nsecs": 0}}}) is None


def test_counting_costs_microseconds() -> None:
    meter = TrafficMeter("control")
    message = {"header": {"stamp": {"secs": 1, "nsecs": 5}}, "ranges": [1.0] * 720}

    def one_message() -> None:
        meter.arrived("/scan", size_bytes=5000, arrival_ns=1)
        meter.decoded("/scan", message, binary=True)

    # The best of several, without the influence of other programs.
    assert min(timeit.repeat(one_message, number=1000, repeat=5)) / 1000 < 50e-6


def test_a_link_reports_traffic_round_trip_and_clock_once_a_second(bridge: BridgeDouble) -> None:
    link = LinkProcess(bridge.address)
    try:
        link.wait_for_state("connected")

        def scan_traffic() -> list[TopicTraffic]:
            events = link.of(TrafficMeasured)
            return [topic for event in events for topic in event.topics if topic.topic == "/scan"]

        traffic = wait_for(lambda: [topic for topic in scan_traffic() if 5.0 < topic.rate_hz < 15.0], "scans counted")
        assert traffic[-1].type == "sensor_msgs/LaserScan"
        assert traffic[-1].bytes_per_s > 1_000
        assert link.of(TrafficMeasured)[-1].encoding == "json"
        quality = wait_for(lambda: [q for q in link.of(LinkQuality) if q.clock_offset_ms is not None], "the clock")[-1]
        # The double's clock is ahead by a round number of seconds.
        assert quality.clock_uncertainty_ms is not None
        assert abs(quality.clock_offset_ms - 1_700_000_000e3) <= quality.clock_uncertainty_ms
        assert quality.clock_uncertainty_ms < 500.0
        refused = link.of(TrafficMeasured)[-1].refused
        bridge.tell(text=json.dumps({"op": "publish", "topic": "/scan", "msg": {"ranges": "x"}}))
        wait_for(lambda: link.of(TrafficMeasured)[-1].refused == refused + 1, "the refusal is counted")
        assert scan_traffic()[-1].refused == 1
    finally:
        link.close()


def test_values_replaced_by_newer_ones_are_counted(bridge: BridgeDouble) -> None:
    link = LinkProcess(bridge.address)
    try:
        link.wait_for_state("connected")
        wait_for(lambda: link.of(Odometry), "odometry")

        def told_after_a_pause() -> bool:
            os.kill(link.process.pid, signal.SIGSTOP)
            for _ in range(30):
                bridge.publish("/odom", ODOMETRY)
            time.sleep(0.1)  # received meanwhile; otherwise another pause follows
            os.kill(link.process.pid, signal.SIGCONT)
            return any(gap.stream == "odometry" and gap.reason == OVERTAKEN for gap in link.of(Gap))

        wait_for(told_after_a_pause, "what is missing is told", timeout_s=30.0)
    finally:
        link.close()
