"""Slow link: late messages in order and without loss; other faults; and the log of sent messages."""

import asyncio
import json
import time
from collections import Counter
from pathlib import Path

import pytest

from caris_desktop.ros.rosbridge import ProtocolError, decode_cbor, decode_json
from caris_desktop.simulator.faults import malformed_messages
from caris_desktop.simulator.server import BUFFER_BYTES, ClientWire, Published
from tests.support.polling import wait_for
from tests.support.simulated_robot import RosbridgeClient, SimulatedRobot

CAMERA = "/camera/image_raw/compressed"


class Socket:
    def __init__(self) -> None:
        self.sent: list[tuple[float, str | bytes]] = []
        self.three = asyncio.Event()

    async def send(self, message: str | bytes) -> None:
        self.sent.append((time.monotonic(), message))
        if len(self.sent) == 3:
            self.three.set()


def test_a_slow_wire_delays_each_message_by_its_bytes_and_keeps_the_order() -> None:
    async def scenario() -> None:
        socket = Socket()
        delivered: list[tuple[int, int]] = []
        wire = ClientWire(
            socket, rate_bytes_s=lambda: 100_000.0, delivered=lambda of, size: delivered.append((of.sequence, size))
        )
        start_s = time.monotonic()
        for number in range(3):
            await wire.send(bytes([number]) * 10_000, Published("/t", {}, sequence=number))
        assert time.monotonic() - start_s < 0.1, "what the link holds is taken at once"
        await asyncio.wait_for(socket.three.wait(), 10.0)
        wire.close()
        assert [at_s - start_s for at_s, _ in socket.sent] == pytest.approx([0.1, 0.2, 0.3], abs=0.09)
        assert [message[0] for _, message in socket.sent] == [0, 1, 2]
        assert [sequence for sequence, _ in delivered] == [0, 1, 2]

    asyncio.run(scenario())


def test_a_full_wire_makes_its_sender_wait_and_a_fast_one_does_not() -> None:
    async def scenario() -> None:
        socket = Socket()
        rate: list[float | None] = [1000.0]
        wire = ClientWire(socket, rate_bytes_s=lambda: rate[0])
        await wire.send(b"x" * 40)
        await wire.send(b"x" * BUFFER_BYTES)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(wire.send(b"y"), 0.2)
        rate[0] = None
        await asyncio.wait_for(wire.send(b"z"), 5.0)
        await asyncio.wait_for(socket.three.wait(), 5.0)
        assert [len(message) for _, message in socket.sent] == [40, BUFFER_BYTES, 1]
        await wire.send(b"at once")
        assert socket.sent[-1][1] == b"at once"
        wire.close()

    asyncio.run(scenario())


def test_an_error_of_the_socket_reaches_the_sender() -> None:
    class Broken:
        async def send(self, message: str | bytes) -> None:
            raise ConnectionResetError("gone")

    async def scenario() -> None:
        wire = ClientWire(Broken(), rate_bytes_s=lambda: 1e6)
        with pytest.raises(ConnectionResetError):
            for _ in range(10):
                await wire.send(b"x")
                await asyncio.sleep(0.02)

    asyncio.run(scenario())


@pytest.mark.long
def test_pictures_come_late_over_one_megabit_and_the_log_knows_each_of_them(tmp_path: Path) -> None:
    log = tmp_path / "sent.jsonl"
    with SimulatedRobot("--log", str(log), "--empty") as robot, RosbridgeClient(robot.address) as client:
        robot.fault("throttle_kbps:1000")
        for topic in (CAMERA, "/scan"):
            client.subscribe(topic, queue_length=1)

        def age_s() -> float:
            messages = client.messages(CAMERA)
            stamp = messages[-1]["header"]["stamp"] if messages else {"secs": time.time(), "nsecs": 0}
            return time.time() - stamp["secs"] - stamp["nsecs"] * 1e-9

        wait_for(lambda: age_s() > 1.0, "pictures are a second late")
        received = len(client.messages(CAMERA))
        clear_s = time.monotonic()
        client.send(op="call_service", service="/simulator/fault", args={"command": "clear"}, id="clear")
        client.wait_for_operation(lambda operation: operation.get("id") == "clear", "the answer")
        assert time.monotonic() - clear_s < 10.0
        wait_for(lambda: len(client.messages(CAMERA)) > received + 5 and age_s() < 0.5, "pictures are fresh again")
        client.send(op="unsubscribe", topic=CAMERA)
        client.send(op="unsubscribe", topic="/scan")
        client.call("/rosapi/get_time")
        counts = Counter(json.loads(line)["topic"] for line in log.read_text().splitlines())
        assert counts == {topic: len(client.messages(topic)) for topic in (CAMERA, "/scan")}
        entries = [json.loads(line) for line in log.read_text().splitlines()]
        sequences = [entry["sequence"] for entry in entries if entry["topic"] == CAMERA]
        assert sequences == sorted(set(sequences))
        for entry, message in zip(
            (entry for entry in entries if entry["topic"] == CAMERA), client.messages(CAMERA), strict=True
        ):
            stamp = message["header"]["stamp"]
            assert entry["stamp_ns"] == stamp["secs"] * 10**9 + stamp["nsecs"]
            assert entry["bytes"] > len(message["data"])


def test_malformed_messages_are_malformed() -> None:
    kinds = malformed_messages(17, "/scan")
    broken = 0
    for content in kinds:
        try:
            decode_json(content) if isinstance(content, str) else decode_cbor(content)
        except ProtocolError:
            broken += 1
    assert broken >= 8
    assert len(malformed_messages(1000, "/scan")) == 1000


@pytest.mark.long
def test_a_clock_that_disagrees_wrong_frames_and_malformed_messages(tmp_path: Path) -> None:
    with SimulatedRobot("--empty") as robot, RosbridgeClient(robot.address) as client:
        client.subscribe("/scan", queue_length=1)

        def offset_s() -> float:
            stamp = client.messages("/scan")[-1]["header"]["stamp"]
            return float(stamp["secs"] + stamp["nsecs"] * 1e-9 - time.time())

        client.wait_for_messages("/scan")
        assert abs(offset_s()) < 1.0
        robot.fault("clock_offset:-3600")
        wait_for(lambda: abs(offset_s() + 3600) < 1.0, "stamps of an hour ago")
        clock = client.call("/rosapi/get_time")["time"]["secs"]
        assert abs(clock + 3600 - time.time()) < 3.0
        robot.fault("clock_drift:500000")
        wait_for(lambda: offset_s() > -3599.5, "the clock runs half as fast again")
        robot.fault("wrong_frame_ids")
        wait_for(lambda: client.messages("/scan")[-1]["header"]["frame_id"] == "nowhere", "the frame is wrong")
        robot.fault("clear")
        wait_for(lambda: client.messages("/scan")[-1]["header"]["frame_id"] == "laser", "the frame is right")
        assert abs(offset_s()) < 1.0
        before = len(client.received)
        robot.fault("malformed:34")
        strange = wait_for(
            lambda: [item for item in client.received[before:] if isinstance(item, bytes)], "strange messages"
        )
        assert strange
        assert client.call("/simulator/state")["time_s"] > 0.0


@pytest.mark.long
def test_the_robot_is_put_where_it_fits_and_touches_are_counted_from_there() -> None:
    with SimulatedRobot("--empty", "--holonomic") as robot, RosbridgeClient(robot.address) as client:
        assert client.call("/simulator/reset_pose", x=15.0, y=5.0, heading_deg=90.0)["success"] is True
        state = robot.state()
        assert (state["touches"], state["touching"]) == (0, False)
        assert state["min_gap_m"] == pytest.approx(5.8 - 0.06 - 5.0 - 0.25, abs=0.01)

        def push() -> bool:
            client.publish("/cmd_vel", {"linear": {"x": 0.0, "y": -0.5, "z": 0.0}, "angular": {"z": 0.0}})
            return bool(robot.state()["touching"])

        wait_for(push, "it touches the eastern wall sideways", every_s=0.05)
        state = robot.state()
        assert state["touches"] == 1
        assert state["min_gap_m"] == pytest.approx(0.0, abs=1e-6)
        robot.fault("pose:9,5,0")
        assert robot.state()["touches"] == 0
        with pytest.raises(AssertionError, match="does not fit"):
            robot.call("/simulator/reset_pose", x=0.1, y=0.1)
        for command in ("pose:1", "pose:a,b,c", "pose:1,2,inf"):
            with pytest.raises(AssertionError, match="three numbers"):
                robot.fault(command)


@pytest.mark.long
def test_simulation_time_is_reported_and_stamped() -> None:
    with SimulatedRobot("--simulation-time", ros=2) as robot, RosbridgeClient(robot.address) as client:
        for topic in ("/clock", "/scan"):
            client.subscribe(topic, throttle_rate=50, queue_length=1)
        told = client.wait_for_messages("/clock", 3)
        times = [message["clock"]["sec"] + message["clock"]["nanosec"] * 1e-9 for message in told]
        assert times == sorted(set(times))
        assert 0.0 < times[0] < 60.0
        stamp = client.wait_for_messages("/scan")[-1]["header"]["stamp"]
        assert abs(stamp["sec"] + stamp["nanosec"] * 1e-9 - robot.state()["time_s"]) < 1.0
        assert client.call("/rosapi/get_param", name="/use_sim_time") == {"value": "true"}
