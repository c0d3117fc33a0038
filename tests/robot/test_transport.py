"""API of roslibpy on the safe transport, against a rosbridge double."""

import asyncio
import contextlib
import json
import math
import signal
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import cbor2
import psutil
import pytest
import roslibpy

from caris_desktop.robot import transport
from caris_desktop.robot.bridge_wire import Timings
from caris_desktop.robot.link import check_robot
from caris_desktop.robot.profile import load_profile
from caris_desktop.robot.transport import RosbridgeClient, RosbridgeTopic, ServiceCallError, topic_of_publish
from tests.robot.link_bench import BridgeDouble
from tests.robot.loop_bench import Bridge


class Observer:
    """Records the reports of the transport."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.refused: list[str] = []

    def link_connected(self) -> None:
        self.told.append("connected")

    def link_silent(self) -> None:
        self.told.append("silent")

    def link_recovered(self) -> None:
        self.told.append("heard")

    def link_lost(self, reason: str) -> None:
        self.told.append("lost")

    def link_unreachable(self, what: str, advice: str) -> None:
        self.told.append("unreachable")

    def link_round_trip(self, round_trip_s: float) -> None:
        """Not tested here."""

    def link_refused(self, detail: str) -> None:
        self.refused.append(detail)


@pytest.fixture(scope="module")
def running_bridge() -> Iterator[BridgeDouble]:
    double = BridgeDouble()
    yield double
    double.kill()


@pytest.fixture
def bridge(running_bridge: BridgeDouble) -> BridgeDouble:
    running_bridge.lines.clear()
    return running_bridge


@pytest.fixture
def own_bridge() -> Iterator[BridgeDouble]:
    """Bridge for tests that stop it."""
    double = BridgeDouble()
    yield double
    double.kill()


async def until(observe: Callable[[], Any], what: str, timeout_s: float = 10.0) -> Any:
    deadline = asyncio.get_running_loop().time() + timeout_s
    while not (observed := observe()):
        assert asyncio.get_running_loop().time() < deadline, what
        await asyncio.sleep(0.01)
    return observed


def connected(
    bridge: BridgeDouble, use: Callable[[RosbridgeClient, Observer], Awaitable[None]], **options: Any
) -> None:
    async def run() -> None:
        observer = Observer()
        ros = RosbridgeClient(bridge.address, observer, **options)
        ros.connect()
        await until(lambda: "connected" in observer.told, "connected")
        await use(ros, observer)
        await ros.aclose(1.0)

    asyncio.run(run())


def test_messages_while_disconnected_are_dropped_and_subscriptions_restored(
    bridge: BridgeDouble,
) -> None:
    async def run() -> None:
        observer = Observer()
        ros = RosbridgeClient(bridge.address, observer)
        listening = RosbridgeTopic(ros, "/a", "std_msgs/String")
        listening.subscribe(lambda _: None)
        velocity = RosbridgeTopic(ros, "/cmd_vel", "geometry_msgs/Twist")
        assert [velocity.publish({"n": number}) for number in range(5)] == [False] * 5
        failures: list[Any] = []
        roslibpy.Service(ros, "/s", "t").call(roslibpy.ServiceRequest(), print, failures.append)
        assert failures == ["the robot is not connected"]
        ros.connect()
        await until(lambda: ros.is_connected, "connected")
        assert velocity.publish({"n": 99})
        await until(lambda: bridge.operations("publish"), "the publish")
        assert [line["msg"]["n"] for line in bridge.operations("publish")] == [99]
        assert [line["topic"] for line in bridge.lines if line.get("op") in ("subscribe", "advertise")] == [
            "/a",
            "/cmd_vel",
        ]
        assert ros.factory.dropped == 6
        await ros.aclose(1.0)

    asyncio.run(run())


def test_topics_of_one_name_are_independent(bridge: BridgeDouble) -> None:
    async def use(ros: RosbridgeClient, observer: Observer) -> None:
        first: list[Any] = []
        second: list[Any] = []
        one, other = RosbridgeTopic(ros, "/a", "std_msgs/String"), RosbridgeTopic(ros, "/a", "std_msgs/String")
        one.subscribe(first.append)
        other.subscribe(second.append)
        one.unsubscribe()
        await until(lambda: bridge.operations("unsubscribe"), "unsubscribed")
        bridge.publish("/a", {"data": "x"})
        await until(lambda: second, "the message")
        assert (first, second) == ([], [{"data": "x"}])

    connected(bridge, use)


@pytest.mark.logs(r"robot\.(transport|bridge_socket): ")
def test_a_callback_that_fails_hurts_nobody(bridge: BridgeDouble, caplog: pytest.LogCaptureFixture) -> None:
    async def use(ros: RosbridgeClient, observer: Observer) -> None:
        messages: list[Any] = []

        def fail(message: Any) -> None:
            raise RuntimeError("broken callback")

        RosbridgeTopic(ros, "/a", "std_msgs/String").subscribe(fail)
        RosbridgeTopic(ros, "/a", "std_msgs/String").subscribe(messages.append)
        for _ in range(2):
            bridge.publish("/a", {"data": "x"})
            await until(lambda: messages, "the message")
            messages.clear()

    connected(bridge, use)
    assert "broken callback" in caplog.text


def test_a_service_answers_fails_in_time_and_is_never_waited_for_in_the_loop(bridge: BridgeDouble) -> None:
    async def use(ros: RosbridgeClient, observer: Observer) -> None:
        assert (await ros.ask("/rosapi/services", "rosapi/Services"))["services"] == ["/emergency_stop/set"]
        with pytest.raises(ServiceCallError, match="no response within"):
            await ros.ask("/nobody", "std_srvs/Empty")
        with pytest.raises(RuntimeError, match="freeze"):
            ros.get_topics()
        # Blocking calls of roslibpy work from another thread.
        assert "/scan" in await asyncio.to_thread(ros.get_topics)

    connected(bridge, use, service_timeout_s=0.3)


def test_pending_calls_and_goals_fail_when_the_link_is_lost() -> None:
    bridge = BridgeDouble()

    async def use(ros: RosbridgeClient, observer: Observer) -> None:
        goals: list[Any] = []
        action = roslibpy.ActionClient(ros, "/navigate_to_pose", "nav2_msgs/action/NavigateToPose")
        action.send_goal({}, goals.append, goals.append, goals.append)
        call = asyncio.ensure_future(ros.ask("/nobody", "std_srvs/Empty"))
        await until(lambda: bridge.operations("call_service"), "the call")
        bridge.kill()
        with pytest.raises(ServiceCallError, match="lost"):
            await call
        assert "lost" in goals[0]["values"]["error_msg"]

    connected(bridge, use, service_timeout_s=30.0)


def test_an_unmodified_topic_comes_back_too_and_only_once() -> None:
    bridge = BridgeDouble()

    async def use(ros: RosbridgeClient, observer: Observer) -> None:
        messages: list[Any] = []
        topic = roslibpy.Topic(ros, "/a", "std_msgs/String")
        topic.subscribe(messages.append)
        topic.publish({"data": "both directions"})
        await until(lambda: bridge.operations("publish"), "published")
        bridge.kill()
        await until(lambda: "lost" in observer.told, "lost")
        bridge.lines.clear()
        bridge.start()
        await until(lambda: bridge.operations("subscribe") and bridge.operations("advertise"), "established")
        await asyncio.sleep(1.2)  # roslibpy retries a second after the loss
        assert len(bridge.operations("subscribe")) == len(bridge.operations("advertise")) == 1
        bridge.publish("/a", {"data": "x"})
        await until(lambda: messages, "the message")
        bridge.kill()

    connected(bridge, use)


def test_a_service_that_we_offer_is_offered_again_after_a_reconnect_and_answers() -> None:
    bridge = BridgeDouble()

    async def use(ros: RosbridgeClient, observer: Observer) -> None:
        def answer(request: Any, response: Any) -> bool:
            response["sum"] = request["a"] + 1
            return True

        roslibpy.Service(ros, "/ours", "test/Sum").advertise(answer)
        await until(lambda: bridge.operations("advertise_service"), "offered")
        bridge.kill()
        await until(lambda: "lost" in observer.told, "lost")
        bridge.lines.clear()
        bridge.start()
        [offered] = await until(lambda: bridge.operations("advertise_service"), "offered again")
        assert offered["service"] == "/ours"
        bridge.tell(text=json.dumps({"op": "call_service", "service": "/ours", "id": "c1", "args": {"a": 4}}))
        [response] = await until(lambda: bridge.operations("service_response"), "the answer")
        assert (response["id"], response["values"], response["result"]) == ("c1", {"sum": 5}, True)
        bridge.kill()

    connected(bridge, use)


def test_a_server_that_accepts_and_says_nothing_is_left_and_tried_again() -> None:
    async def run() -> None:
        accepted = 0

        async def silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            nonlocal accepted
            accepted += 1
            # The end of the loop cancels it; a stream server reports that as an error.
            with contextlib.suppress(asyncio.CancelledError, OSError):
                await reader.read()
            writer.close()

        async with await asyncio.start_server(silent, "127.0.0.1", 0) as server:
            observer = Observer()
            timings = Timings(handshake_s=0.2, first_retry_s=0.05, longest_retry_s=0.1)
            ros = RosbridgeClient(f"ws://127.0.0.1:{server.sockets[0].getsockname()[1]}", observer, timings=timings)
            ros.connect()
            await until(lambda: accepted >= 3, "three attempts")
            assert observer.told[:2] == ["unreachable", "unreachable"]
            await ros.aclose(0.2)

    asyncio.run(run())


@pytest.mark.parametrize(
    ("quick_retries_s", "refuses", "pauses_s"),
    [
        (60.0, False, [0.01] * 4),
        (0.0, False, [0.01, 0.017, 0.02, 0.02]),
        (60.0, True, [0.01, 0.017, 0.02, 0.02]),
    ],
)
def test_a_lost_server_is_tried_quickly_at_first_unless_it_refuses(
    monkeypatch: pytest.MonkeyPatch, quick_retries_s: float, refuses: bool, pauses_s: list[float]
) -> None:
    paused_s: list[float] = []

    async def sleep(delay_s: float) -> None:
        paused_s.append(round(delay_s, 6))
        await real_sleep(delay_s)

    async def refuse(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
        writer.close()

    async def run() -> None:
        server = await asyncio.start_server(refuse, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        if not refuses:
            server.close()
        timings = Timings(first_retry_s=0.01, quick_retries_s=quick_retries_s, longest_retry_s=0.02)
        ros = RosbridgeClient(f"ws://127.0.0.1:{port}", Observer(), timings=timings)
        ros.connect()
        while len(paused_s) < 4:
            await real_sleep(0.005)
        await ros.aclose(0.2)
        server.close()

    real_sleep = asyncio.sleep
    monkeypatch.setattr(transport.asyncio, "sleep", sleep)  # type: ignore[attr-defined]
    asyncio.run(run())
    assert paused_s[:4] == pauses_s


def test_when_handling_lags_the_newest_of_each_topic_wins(bridge: BridgeDouble) -> None:
    async def use(ros: RosbridgeClient, observer: Observer) -> None:
        newest: list[Any] = []
        every: list[Any] = []
        pictures: list[Any] = []
        RosbridgeTopic(ros, "/large", "std_msgs/String").subscribe(pictures.append)
        RosbridgeTopic(ros, "/newest", "std_msgs/String").subscribe(newest.append)
        RosbridgeTopic(ros, "/every", "std_msgs/String", every_message=True).subscribe(every.append)
        await until(lambda: len(bridge.operations("subscribe")) == 3, "subscribed")
        for number in range(50):
            for topic in ("/newest", "/every"):
                text = json.dumps({"op": "publish", "topic": topic, "msg": {"data": number}})
                # All in one iteration of the loop, as after a stall.
                ros.factory.receive(text.encode(), ros.factory.protocol)
            large = json.dumps({"op": "publish", "topic": "/large", "msg": {"data": f"{number:_>40000}"}})
            ros.factory.receive(large.encode(), ros.factory.protocol)
        await until(lambda: len(every) == 50 and newest and pictures, "all")
        assert [message["data"] for message in newest] == [45, 46, 47, 48, 49], "a short pause costs nothing small"
        assert [message["data"].strip("_") for message in pictures] == ["49"], (
            "what is worked on for long is the newest"
        )
        assert [message["data"] for message in every] == list(range(50))
        assert ros.factory.pop_overtaken() == {"/newest": 45, "/large": 49}
        assert not ros.factory.pop_overtaken(), "each is told once"

    connected(bridge, use)


def test_the_topic_is_read_from_the_first_bytes_of_either_encoding() -> None:
    message = {"op": "publish", "topic": "/camera/image_raw/compressed", "msg": {"topic": "/x", "op": "publish"}}
    assert topic_of_publish(json.dumps(message).encode()) == b"/camera/image_raw/compressed"
    assert topic_of_publish(cbor2.dumps(message)) == b"/camera/image_raw/compressed"
    assert topic_of_publish(cbor2.dumps({**message, "topic": "/a"})) == b"/a"
    for other in ({"op": "status", "msg": "x"}, {"msg": message}, {"op": "service_response", "topic": "/x"}):
        assert topic_of_publish(json.dumps(other).encode()) is None
        assert topic_of_publish(cbor2.dumps(other)) is None
    assert topic_of_publish(b"") is None


def test_a_preflight_names_what_the_robot_lacks(bridge: BridgeDouble) -> None:
    sentences = check_robot(load_profile("simulated"), bridge.address)
    assert "Map: the robot has no topic /map." in sentences
    assert "Camera front: the robot has no topic /camera/image_raw/compressed." in sentences
    assert not [sentence for sentence in sentences if "/scan" in sentence or "/emergency_stop/set" in sentence]


def test_a_preflight_of_a_robot_that_is_not_there_says_what_to_do() -> None:
    [sentence] = check_robot(load_profile("simulated"), "ws://127.0.0.1:9")
    assert "no rosbridge is running at ws://127.0.0.1:9" in sentence
    assert "Start rosbridge" in sentence


def test_a_peer_that_is_abandoned_may_obey_what_it_has_taken_before_it_learns_of_our_end(
    own_bridge: BridgeDouble,
) -> None:
    timings = Timings(trouble_after_s=0.2, dead_after_s=0.4, unanswered_trouble_after_s=0.2, first_retry_s=0.1)

    async def use(ros: RosbridgeClient, observer: Observer) -> None:
        velocity = RosbridgeTopic(ros, "/cmd_vel", "geometry_msgs/Twist")
        velocity.advertise()
        await until(lambda: own_bridge.operations("advertise"), "advertised")
        own_bridge.signal(signal.SIGSTOP)
        for number in range(5):
            assert velocity.publish({"n": number})
        await until(lambda: "lost" in observer.told, "given up")
        # Disconnecting now would discard the commands that the server has not executed yet.
        assert len(_established(own_bridge.port)) >= 1
        own_bridge.signal(signal.SIGCONT)
        await until(lambda: len(own_bridge.operations("publish")) == 5, "every word of before is obeyed")
        await until(lambda: observer.told[-1] == "connected", "connected again")
        ended = [line["at"] for line in own_bridge.lines if line.get("event") == "disconnected"]
        await until(
            lambda: [line for line in own_bridge.lines if line.get("event") == "disconnected"], "the old one ends"
        )
        assert ended == [], "not before it had time to obey"
        await until(lambda: len(_established(own_bridge.port)) == 1, "one connection is left")

    connected(own_bridge, use, timings=timings)


def _established(port: int) -> list[Any]:
    """Connections of this process to a port of this machine."""
    return [
        connection
        for connection in psutil.Process().net_connections("tcp")
        if connection.raddr and connection.raddr.port == port and connection.status == psutil.CONN_ESTABLISHED
    ]


def test_a_server_that_is_busy_with_one_websocket_is_not_silent_on_the_other() -> None:
    """A flood on the main websocket delays answers on the one for motion."""
    timings = Timings(
        ping_every_s=0.02, trouble_after_s=0.1, dead_after_s=0.2,
        unanswered_trouble_after_s=math.inf, unanswered_dead_after_s=math.inf,
    )  # fmt: skip

    async def run() -> None:
        loop = asyncio.get_running_loop()
        bridge = Bridge()
        await bridge.open()
        observer = Observer()
        ros = RosbridgeClient(f"ws://127.0.0.1:{bridge.port}", observer, timings=timings)
        came: list[Any] = []
        RosbridgeTopic(ros, "/a", "std_msgs/String", every_message=True).subscribe(came.append)
        RosbridgeTopic(ros, "/cmd_vel", "geometry_msgs/Twist", motion=True).advertise()
        ros.connect()
        await until(lambda: "connected" in observer.told and len(bridge.clients) >= 2, "connected")
        for client, topics in bridge.clients.items():
            if not topics:
                client.transport.pause_reading()
        until_s = loop.time() + 3 * timings.dead_after_s
        while loop.time() < until_s:
            await bridge.publish("/a", {"data": "x"})
            await asyncio.sleep(0.005)
        assert came
        assert observer.told == ["connected"]
        for client in bridge.clients:
            client.transport.pause_reading()
        await until(lambda: "lost" in observer.told, "without anything over either it is lost")
        assert observer.told[:3] == ["connected", "silent", "lost"]
        await ros.aclose(0.0)
        await bridge.close()

    asyncio.run(run())
