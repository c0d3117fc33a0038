"""rosbridge server: relaying, throttling, latching, CBOR, fragments, services of clients, and foreign input."""

import base64
import json
import time
from typing import Any

import cv2
import numpy as np
import pytest

from caris_desktop.ros import message_conversion, rosbridge
from caris_desktop.ros.dialect import Dialect
from tests.support.polling import wait_for
from tests.support.simulated_robot import RosbridgeClient, SimulatedRobot


def test_another_client_sees_every_velocity_command(robot: SimulatedRobot, client: RosbridgeClient) -> None:
    with RosbridgeClient(robot.address) as listener:
        listener.subscribe("/cmd_vel", type="geometry_msgs/Twist")
        wait_for(lambda: "/rosbridge" in str(robot.call("/rosapi/subscribers", topic="/cmd_vel")), "it is subscribed")
        sent = [round(0.001 * number, 3) for number in range(200)]
        for turn in sent:
            client.drive(0.0, turn)
        seen = [message["angular"]["z"] for message in listener.wait_for_messages("/cmd_vel", len(sent))]
        assert seen == sent
    client.drive(0.0)


def test_a_latched_map_comes_at_once_to_a_late_subscriber(robot: SimulatedRobot, client: RosbridgeClient) -> None:
    client.subscribe("/map")
    first = client.wait_for_messages("/map")[0]
    grid = message_conversion.decode_occupancy_grid(first, stamp_ns=0)
    assert grid.cells.shape == (first["info"]["height"], first["info"]["width"])
    assert {-1, 0, 100} <= set(np.unique(grid.cells).tolist())
    with RosbridgeClient(robot.address) as late:
        late.subscribe("/map")
        late.subscribe("/emergency_stop")
        assert late.wait_for_messages("/map")
        assert late.wait_for_messages("/emergency_stop") == [{"data": False}]


def test_cbor_brings_typed_arrays_and_infinity(client: RosbridgeClient) -> None:
    client.subscribe("/scan", compression="cbor")
    content = wait_for(lambda: next((item for item in client.received if isinstance(item, bytes)), None), "a scan")
    operation = rosbridge.decode_cbor(content or b"")
    assert operation["topic"] == "/scan"
    assert operation["msg"]["ranges"].dtype == np.float32
    scan = message_conversion.decode_laser_scan(operation["msg"], stamp_ns=0)
    assert len(scan.ranges_m) == 720
    assert np.isfinite(scan.ranges_m).any()


def test_a_throttled_subscription_gets_the_newest_at_its_own_pace(client: RosbridgeClient) -> None:
    client.subscribe("/odom", throttle_rate=200, queue_length=1)
    start_s = time.monotonic()
    received = client.wait_for_messages("/odom", 6)
    assert time.monotonic() - start_s > 0.9
    stamps = [message["header"]["stamp"]["secs"] + message["header"]["stamp"]["nsecs"] * 1e-9 for message in received]
    assert abs(stamps[-1] - time.time()) < 1.0


def test_two_subscriptions_of_one_client_share_the_stream(client: RosbridgeClient) -> None:
    client.send(op="subscribe", topic="/cmd_vel", id="one")
    client.send(op="subscribe", topic="/cmd_vel", id="two")
    client.drive(0.0, 0.01)
    client.wait_for_messages("/cmd_vel")
    client.send(op="unsubscribe", topic="/cmd_vel", id="one")
    client.drive(0.0, 0.02)
    assert [twist["angular"]["z"] for twist in client.wait_for_messages("/cmd_vel", 2)] == [0.01, 0.02]
    client.send(op="unsubscribe", topic="/cmd_vel")
    client.drive(0.0, 0.03)
    client.call("/rosapi/get_time")
    assert len(client.messages("/cmd_vel")) == 2


def test_a_client_that_reads_nothing_holds_nobody_up(robot: SimulatedRobot, client: RosbridgeClient) -> None:
    import socket

    lazy = socket.create_connection(("127.0.0.1", robot.port))
    lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    lazy.sendall(
        f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{robot.port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    assert lazy.recv(12) == b"HTTP/1.1 101"
    for topic, kind in (("/relayed", "std_msgs/String"), ("/scan", "sensor_msgs/LaserScan")):
        content = json.dumps({"op": "subscribe", "topic": topic, "type": kind, "queue_length": 1}).encode()
        lazy.sendall(bytes([0x81, 0x80 | len(content)]) + b"\0\0\0\0" + content)
    wait_for(lambda: robot.call("/rosapi/subscribers", topic="/relayed")["subscribers"], "the lazy one is subscribed")
    for _ in range(100):
        client.publish("/relayed", {"data": "x" * 100_000})
    client.call("/rosapi/get_time")
    first = robot.state()["time_s"]
    wait_for(lambda: robot.state()["time_s"] > first + 0.5, "time goes on", timeout_s=5.0)
    lazy.close()


def test_large_messages_come_in_fragments_to_who_wants_them(robot: SimulatedRobot, client: RosbridgeClient) -> None:
    client.subscribe("/relayed/large", type="std_msgs/String", fragment_size=1000)
    client.publish("/relayed/large", {"data": "y" * 5000})
    client.wait_for_operation(lambda operation: operation["op"] == "fragment" and operation["num"] == 5, "all of it")
    parts = [part for part in client.operations() if part["op"] == "fragment"]
    assembler = rosbridge.FragmentAssembler()
    results = [assembler.add(part) for part in parts]
    assert results[-1] == {"op": "publish", "topic": "/relayed/large", "msg": {"data": "y" * 5000}}
    # A total that is not an integer, and the same id for every message of a topic.
    assert {(part["id"], 6 < part["total"] < 7) for part in parts} == {(0, True)}
    # It applies to everything from then on, answers too; binary messages are not sent at all then.
    client.send(op="call_service", service="/rosapi/topics", id="long")
    answer = client.wait_for_operation(
        lambda operation: operation["op"] == "fragment" and operation["id"] == "long", ""
    )
    assert len(answer["data"]) == 1000
    client.subscribe("/scan", compression="cbor")
    wait_for(lambda: any("/scan" in refusal for refusal in robot.state()["refusals"]), "it was not sent")
    assert not [content for content in client.received if isinstance(content, bytes)]


def test_fragments_from_a_client_are_put_together(client: RosbridgeClient) -> None:
    text = json.dumps({"op": "call_service", "service": "/rosapi/topics", "id": "whole"})
    parts = rosbridge.fragments_of(text, message_id="f", size=20)
    for part in parts:
        client.send(**{**part, "total": len(parts)})
    answer = client.wait_for_operation(lambda operation: operation.get("id") == "whole", "an answer")
    assert "/scan" in answer["values"]["topics"]


def test_a_client_can_offer_a_service_to_others(robot: SimulatedRobot, client: RosbridgeClient) -> None:
    client.send(op="advertise_service", service="/add", type="std_srvs/SetBool")
    with RosbridgeClient(robot.address) as caller:
        wait_for(lambda: "/add" in caller.call("/rosapi/services")["services"], "the service is listed")
        caller.send(op="call_service", service="/add", args={"a": 1}, id="mine")
        request = client.wait_for_operation(lambda operation: operation["op"] == "call_service", "the request")
        assert request["args"] == {"a": 1}
        client.send(op="service_response", service="/add", id=request["id"], values={"sum": 2}, result=True)
        answer = caller.wait_for_operation(lambda operation: operation.get("id") == "mine", "the answer")
        assert (answer["values"], answer["result"]) == ({"sum": 2}, True)


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        '{"op": "set_level", "level": "info"}',
        '{"op": "subscribe", "topic": "/scan", "throttle_rate": 200.0}',
        '{"op": "subscribe", "topic": "/scan", "fragment_size": null}',
        '{"op": "subscribe", "topic": "/scan", "type": "std_msgs/String"}',
        '{"op": "subscribe", "topic": "/nobody/publishes/it"}',
        '{"op": "subscribe", "topic": "/new", "type": "nobody_msgs/Knows"}',
        '{"op": "advertise", "topic": "/new", "type": "nobody_msgs/Knows"}',
        '{"op": "advertise", "topic": "/new"}',
        '{"op": "publish", "topic": "/never/advertised", "msg": {"data": ""}}',
        '{"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": null}}}',
        '{"op": "send_action_goal", "action": "/move_base", "id": "g"}',
        '{"op": "explode"}',
        '{"op": "subscribe"}',
        '{"op": "subscribe", "topic": 3}',
        '{"op": "subscribe", "topic": "/scan", "queue_length": -1}',
        '{"op": "subscribe", "topic": "/scan", "throttle_rate": "fast"}',
        '{"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": "fast"}}}',
        '{"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": NaN}}}',
        '{"op": "publish", "topic": "/cmd_vel", "msg": 5}',
        '{"op": "publish", "topic": "/move_base/goal", "msg": {"goal": {}}}',
        '{"op": "publish", "topic": "/simulator/fault", "msg": {"data": "set fire"}}',
        '{"op": "fragment", "id": "1", "num": 9, "total": 2, "data": ""}',
        '{"op": "service_response", "id": "nobody", "values": {}}',
        '{"op": "cancel_action_goal", "action": "/nothing"}',
    ],
)
def test_a_refused_client_gets_no_reply_and_nothing_happens(client: RosbridgeClient, text: str) -> None:
    before = client.call("/simulator/state")
    client.send_text(text)
    after = client.call("/simulator/state")
    assert after["refusals"][-1] != before["refusals"][-1:] and "/rosbridge_client_" in after["refusals"][-1]
    assert after["speed_mps"] == 0.0
    assert {operation["op"] for operation in client.operations()} == {"service_response"}


@pytest.mark.parametrize("topic", ["/odom", "/amcl_pose", "/joint_states"])
def test_messages_without_cbor_are_not_sent(client: RosbridgeClient, topic: str) -> None:
    client.subscribe(topic, compression="cbor")
    client.subscribe("/scan", compression="cbor")
    wait_for(lambda: any(topic in refusal for refusal in client.call("/simulator/state")["refusals"]), "it failed")
    wait_for(lambda: len([content for content in client.received if isinstance(content, bytes)]) > 3, "scans")
    assert all(b"/scan" in content[:40] for content in client.received if isinstance(content, bytes))
    # A further plain subscription changes nothing: both share the stream, and CBOR wins.
    client.subscribe(topic)
    client.call("/rosapi/get_time")
    client.send(op="unsubscribe", topic=topic)
    client.subscribe(topic)
    client.wait_for_messages(topic)


def test_ros2_cannot_write_lists_of_fixed_length_either(robot_ros2: SimulatedRobot) -> None:
    with RosbridgeClient(robot_ros2.address) as client:
        client.subscribe("/odom", compression="cbor")
        client.subscribe("/joint_states", compression="cbor")
        wait_for(lambda: "/odom" in str(client.call("/simulator/state")["refusals"]), "it failed")
        joints = wait_for(lambda: next((c for c in client.received if isinstance(c, bytes)), None), "its joints") or b""
        assert "head_1_joint" in rosbridge.decode_cbor(joints)["msg"]["name"]


def test_a_text_may_come_as_a_picture(client: RosbridgeClient) -> None:
    client.subscribe("/tf_static", compression="png")
    packed = client.wait_for_operation(lambda operation: operation["op"] == "png", "a picture")
    image_bgr = cv2.imdecode(np.frombuffer(base64.b64decode(packed["data"]), np.uint8), cv2.IMREAD_COLOR)
    whole = json.loads(image_bgr[..., ::-1].tobytes())
    assert (whole["op"], whole["topic"]) == ("publish", "/tf_static")


def test_a_topic_of_clients_ends_with_them_and_may_then_have_another_type(robot: SimulatedRobot) -> None:
    with RosbridgeClient(robot.address) as first, RosbridgeClient(robot.address) as second:
        first.subscribe("/passing", type="std_msgs/String")
        second.send(op="subscribe", topic="/passing", type="std_msgs/Bool")
        assert second.call("/rosapi/topic_type", topic="/passing") == {"type": "std_msgs/String"}
        first.send(op="unsubscribe", topic="/passing")
        first.call("/rosapi/get_time")
        assert second.call("/rosapi/topic_type", topic="/passing") == {"type": ""}
        second.subscribe("/passing", type="std_msgs/Bool")
        assert second.call("/rosapi/topic_type", topic="/passing") == {"type": "std_msgs/Bool"}


def test_fields_that_are_left_out_are_zero_and_lists_of_arguments_are_taken_in_order(client: RosbridgeClient) -> None:
    client.subscribe("/passing/twist", type="geometry_msgs/Twist")
    client.publish("/passing/twist", {"angular": {"z": 0.5}})
    zero = {"x": 0, "y": 0, "z": 0}
    assert client.wait_for_messages("/passing/twist") == [{"linear": zero, "angular": {**zero, "z": 0.5}}]
    client.send(op="call_service", service="/simulator/fault", args=["clear"], id="f")
    answer = client.wait_for_operation(lambda operation: operation.get("id") == "f", "an answer")
    assert answer["result"], answer


def test_a_service_that_fails_says_why_as_ros_does(client: RosbridgeClient) -> None:
    client.send(op="call_service", service="/rosapi/message_details", args={"type": "no_msgs/Such"}, id="n")
    answer = client.wait_for_operation(lambda operation: operation.get("id") == "n", "an answer")
    assert not answer["result"]
    assert answer["values"].startswith("service [/rosapi/message_details] responded with an error: b'error processing")


def test_a_service_that_is_not_there_says_so(client: RosbridgeClient) -> None:
    client.send(op="call_service", service="/nothing", id="n")
    answer = client.wait_for_operation(lambda operation: operation.get("id") == "n", "an answer")
    assert (answer["result"], answer["values"]) == (False, "Service /nothing does not exist")


def test_a_message_beyond_the_limit_ends_only_its_own_client(robot: SimulatedRobot, client: RosbridgeClient) -> None:
    with RosbridgeClient(robot.address) as flood:
        flood.send_text('{"op": "publish", "topic": "/t", "msg": {"data": "' + "x" * 5_000_000 + '"}}')
        wait_for(lambda: flood.closed, "the flooding client is cut off")
    assert client.call("/rosapi/get_time")


def test_ros2_spells_types_and_time_its_own_way(robot_ros2: SimulatedRobot) -> None:
    with RosbridgeClient(robot_ros2.address) as client:
        topics: dict[str, Any] = client.call("/rosapi/topics")
        types = dict(zip(topics["topics"], topics["types"], strict=True))
        assert types["/cmd_vel"] == "geometry_msgs/msg/Twist"
        assert "/move_base/status" not in types
        client.subscribe("/scan", queue_length=1)
        assert set(client.wait_for_messages("/scan")[0]["header"]["stamp"]) == {"sec", "nanosec"}
        stamped = message_conversion.encode_twist_stamped(
            Dialect.ROS2,
            message_conversion.decode_twist({"linear": {"x": 0.0}, "angular": {"z": 0.5}}),
            stamp_ns=time.time_ns(),
        )
        client.publish("/cmd_vel", stamped)
        wait_for(lambda: client.call("/simulator/state")["speed_radps"] > 0.05, "it turns by TwistStamped")
