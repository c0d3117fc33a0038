"""Interfaces of the default robot model besides sensors and motion: path, map updates, initial pose, head, maps,
panel.
"""

import base64
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from caris_desktop.ros.dialect import decode_time
from tests.support.polling import wait_for
from tests.support.simulated_robot import RosbridgeClient, SimulatedRobot

CAMERA = "/camera/image_raw/compressed"


@pytest.fixture(scope="module")
def maps_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("maps")


@pytest.fixture(scope="module", params=[1, 2], ids=["ros1", "ros2"])
def robot(request: pytest.FixtureRequest, maps_folder: Path) -> Iterator[SimulatedRobot]:
    with SimulatedRobot("--maps-folder", str(maps_folder), "--empty", ros=request.param) as running:
        yield running


only_once = pytest.mark.parametrize("robot", [1], ids=["ros1"], indirect=True)


@pytest.fixture
def client(robot: SimulatedRobot) -> Iterator[RosbridgeClient]:
    with RosbridgeClient(robot.address) as connected:
        yield connected


def type_of(robot: SimulatedRobot, package: str, name: str) -> str:
    return f"{package}/{name}" if robot.ros == 1 else f"{package}/msg/{name}"


def pose(x: float, y: float, heading_deg: float) -> dict[str, Any]:
    half = math.radians(heading_deg) / 2
    position = {"x": x, "y": y, "z": 0.0}
    return {"position": position, "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)}}


def goal(client: RosbridgeClient, robot: SimulatedRobot, x: float, y: float) -> None:
    topic = "/move_base_simple/goal" if robot.ros == 1 else "/goal_pose"
    client.publish(topic, {"header": {"frame_id": "map"}, "pose": pose(x, y, 0.0)})


@pytest.mark.long
def test_the_path_is_reported_when_it_is_planned_and_emptied_when_it_is_over(
    robot: SimulatedRobot, client: RosbridgeClient
) -> None:
    robot.fault("pose:9,5,0")
    topic = "/move_base/NavfnROS/plan" if robot.ros == 1 else "/plan"
    client.subscribe(topic, type=type_of(robot, "nav_msgs", "Path"))
    goal(client, robot, 9.5, 5.0)
    way = [stop["pose"]["position"] for stop in client.wait_for_messages(topic)[0]["poses"]]
    assert math.dist((way[0]["x"], way[0]["y"]), (9.0, 5.0)) < 0.2
    assert math.dist((way[-1]["x"], way[-1]["y"]), (9.5, 5.0)) < 0.11
    wait_for(lambda: client.messages(topic)[-1]["poses"] == [], "no way is left")
    assert len(client.messages(topic)) == 2


@only_once
def test_a_map_put_together_from_its_updates_is_the_map(robot: SimulatedRobot, client: RosbridgeClient) -> None:
    cells: Any = None
    client.subscribe("/map", type=type_of(robot, "nav_msgs", "OccupancyGrid"))
    client.subscribe("/map_updates", type=type_of(robot, "map_msgs", "OccupancyGridUpdate"))
    client.wait_for_messages("/map")
    # move it, so that the map has new areas
    for spot in ("9,5,0", "9,5,90", "8,5,180", "3,5,0"):
        robot.fault(f"pose:{spot}")
        seen = len(client.messages("/map_updates")) + len(client.messages("/map"))
        wait_for(lambda seen=seen: len(client.messages("/map_updates")) + len(client.messages("/map")) > seen, "news")
        if client.messages("/map_updates"):
            break
    client.wait_for_messages("/map_updates")
    with RosbridgeClient(robot.address) as late:
        late.subscribe("/map")
        latched = late.wait_for_messages("/map")[0]
    for operation in client.operations():
        message = operation.get("msg", {})
        if operation.get("topic") == "/map":
            cells = np.array(message["data"]).reshape(message["info"]["height"], -1)
        elif operation.get("topic") == "/map_updates" and cells is not None:
            change = np.array(message["data"]).reshape(message["height"], message["width"])
            y, x = message["y"], message["x"]
            cells[y : y + message["height"], x : x + message["width"]] = change
        if cells is not None and decode_time(message.get("header", {}).get("stamp", {"sec": 0})) == decode_time(
            latched["header"]["stamp"]
        ):
            break
    late_cells = np.array(latched["data"]).reshape(latched["info"]["height"], -1)
    assert (cells != late_cells).sum() < 50
    assert (cells == 100).sum() > 200


@only_once
@pytest.mark.long("ros1")
def test_an_initial_pose_near_the_truth_is_corrected_and_one_far_away_stays(
    robot: SimulatedRobot, client: RosbridgeClient
) -> None:
    robot.fault("pose:9,5,0")

    def told(x: float, y: float, heading_deg: float) -> None:
        message = {"pose": pose(x, y, heading_deg), "covariance": [0.0] * 36}
        client.publish("/initialpose", {"header": {"frame_id": "map"}, "pose": message})

    def error() -> float:
        believed = client.call("/simulator/state")["believed_pose"]
        return math.dist((believed["x_m"], believed["y_m"]), (9.0, 5.0))

    told(9.5, 5.2, 10)
    assert error() > 0.2
    wait_for(lambda: error() < 0.05, "it finds itself")
    told(2.0, 7.0, 90)
    assert client.call("/simulator/state")["localised"] is False
    later_s = robot.state()["time_s"] + 0.5
    wait_for(lambda: robot.state()["time_s"] > later_s, "time goes on")
    assert error() > 6.0
    told(9.0, 5.0, 0)
    wait_for(lambda: error() < 0.05, "it is told where it is")


@only_once
@pytest.mark.long("ros1")
def test_the_head_turns_and_the_picture_with_it(robot: SimulatedRobot, client: RosbridgeClient) -> None:
    robot.fault("pose:9,5,0")
    client.subscribe("/joint_states", type=type_of(robot, "sensor_msgs", "JointState"), throttle_rate=50)
    client.subscribe(CAMERA, queue_length=1)
    client.subscribe("/tf", throttle_rate=50, queue_length=1)

    def joints() -> dict[str, float]:
        state = client.messages("/joint_states")[-1]
        return dict(zip(state["name"], state["position"], strict=True))

    def picture() -> Any:
        data = base64.b64decode(client.messages(CAMERA)[-1]["data"])
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).astype(int)

    def turn_to(pan: float, tilt: float) -> None:
        duration = {"secs": 0, "nsecs": 400_000_000} if robot.ros == 1 else {"sec": 0, "nanosec": 400_000_000}
        point = {"positions": [tilt, pan], "time_from_start": duration}
        message = {"joint_names": ["head_2_joint", "head_1_joint"], "points": [point]}
        client.publish("/head_controller/command", message)
        wait_for(lambda: joints()["head_1_joint"] == pytest.approx(pan, abs=1e-3), "the head is there")

    client.wait_for_messages("/joint_states")
    client.wait_for_messages(CAMERA)
    straight = picture()
    turn_to(0.5, 0.3)
    assert joints()["head_2_joint"] == pytest.approx(0.3, abs=0.02)
    seen = len(client.messages(CAMERA))
    client.wait_for_messages(CAMERA, seen + 2)
    assert np.abs(picture() - straight).mean() > 10
    head = next(t for t in client.messages("/tf")[-1]["transforms"] if t["child_frame_id"] == "head_1_link")
    assert 2 * math.asin(head["transform"]["rotation"]["z"]) == pytest.approx(0.5, abs=0.02)
    turn_to(0.0, 0.0)
    seen = len(client.messages(CAMERA))
    client.wait_for_messages(CAMERA, seen + 2)
    assert np.abs(picture() - straight).mean() < 3
    message = {"joint_names": ["arm_1_joint"], "points": [{"positions": [0.0]}]}
    client.publish("/head_controller/command", message)
    wait_for(lambda: "arm_1_joint" in str(client.call("/simulator/state")["refusals"]), "there is no such joint")


def test_a_pose_graph_is_saved_loaded_and_mapping_really_pauses(
    robot: SimulatedRobot, client: RosbridgeClient, maps_folder: Path
) -> None:
    robot.fault("pose:9,5,0")
    wait_for(lambda: robot.state()["known_map_share"] > 0.02, "something is known")
    assert client.call("/slam_toolbox/pause_new_measurements") == {"status": True}
    share = robot.state()["known_map_share"]
    assert robot.state()["mapping_paused"] is True
    parameter = f"/slam_toolbox{'/' if robot.ros == 1 else ':'}paused_new_measurements"
    assert client.call("/rosapi/get_param", name=parameter) == {"value": "true"}
    assert client.call("/slam_toolbox/serialize_map", filename=f"first floor/{robot.ros}")["result"] == 0
    assert (maps_folder / "first floor" / f"{robot.ros}.posegraph").is_file()
    robot.fault("pose:14.75,2,90")
    later_s = robot.state()["time_s"] + 0.5
    wait_for(lambda: robot.state()["time_s"] > later_s, "time goes on")
    assert robot.state()["known_map_share"] == share
    client.call("/slam_toolbox/pause_new_measurements")
    wait_for(lambda: robot.state()["known_map_share"] > share, "the map grows again")
    client.call("/slam_toolbox/deserialize_map", filename=f"first floor/{robot.ros}", match_type=3)
    state = robot.state()
    assert (state["known_map_share"], state["mapping_paused"]) == (share, True)
    client.call("/slam_toolbox/pause_new_measurements")


@pytest.mark.parametrize("name", ["../outside", "/etc/passwd", "a/../../b", ".hidden", "", "x" * 300, "a\0b", "a\\b"])
@only_once
@pytest.mark.long
def test_no_map_leaves_its_folder(client: RosbridgeClient, maps_folder: Path, name: str) -> None:
    before = sorted(maps_folder.parent.rglob("*"))
    assert client.call("/slam_toolbox/serialize_map", filename=name)["result"] == 255
    assert sorted(maps_folder.parent.rglob("*")) == before


def test_the_map_server_saves_a_picture_and_loads_it(
    robot: SimulatedRobot, client: RosbridgeClient, maps_folder: Path
) -> None:
    if robot.ros == 1:
        assert "/map_saver/save_map" not in client.call("/rosapi/services")["services"]
        return
    assert client.call("/map_saver/save_map", map_topic="map", map_url="ground")["result"] is True
    picture = cv2.imread(str(maps_folder / "ground.pgm"), cv2.IMREAD_GRAYSCALE)
    assert set(np.unique(picture).tolist()) == {0, 205, 254}
    answer = client.call("/map_server/load_map", map_url="ground.yaml")
    assert answer["result"] == 0
    cells = np.array(answer["map"]["data"]).reshape(answer["map"]["info"]["height"], -1)
    assert np.array_equal(cells[::-1] == 100, picture == 0)
    assert np.array_equal(cells[::-1] == -1, picture == 205)
    assert client.call("/map_server/load_map", map_url="nowhere.yaml")["result"] == 1


@only_once
def test_the_panel_obeys_and_reports_it(robot: SimulatedRobot, client: RosbridgeClient) -> None:
    def panel() -> Any:
        return client.call("/simulator/state")["panel"]

    for topic in ("/volume/state", "/eyes/state", "/diagnostics/temperature"):
        client.subscribe(topic)
    assert client.wait_for_messages("/eyes/state") == [{"data": True}]
    client.publish("/leds/color", {"r": 1.0, "g": 0.5, "b": 7.0})
    client.publish("/volume", {"data": 35.0})
    client.publish("/screen/text", {"data": "Welcome"})
    assert client.call("/eyes/set", data=False)["success"] is True
    assert client.call("/gestures/wave")["success"] is True
    assert client.call("/gestures/wave")["success"] is False
    now = panel()
    assert now["leds"] == {"r": 1.0, "g": 0.5, "b": 1.0, "a": 0.0}
    assert (now["volume"], now["screen"], now["eyes_open"], now["waving"]) == (35.0, "Welcome", False, True)
    assert client.messages("/volume/state")[-1] == {"data": 35.0}
    assert client.messages("/eyes/state")[-1] == {"data": False}
    assert 30.0 < client.wait_for_messages("/diagnostics/temperature")[0]["data"] < 50.0
    wait_for(lambda: not panel()["waving"], "the arm is down again")
    client.call("/eyes/set", data=True)


def test_rosapi_reports_the_fields_of_every_type_that_is_offered(
    robot: SimulatedRobot, client: RosbridgeClient
) -> None:
    offered = client.call("/rosapi/topics")
    for kind in {*offered["types"]}:
        assert client.call("/rosapi/message_details", type=kind)["typedefs"], kind
    details = client.call("/rosapi/message_details", type=type_of(robot, "sensor_msgs", "LaserScan"))["typedefs"]
    scan = details[0]
    fields = dict(zip(scan["fieldnames"], zip(scan["fieldtypes"], scan["fieldarraylen"], strict=True), strict=True))
    assert fields["ranges"] == ("float32", 0) or fields["ranges"] == ["float32", 0]
    assert list(fields["header"]) == ["std_msgs/Header", -1]
    assert {typedef["type"] for typedef in details} >= {"sensor_msgs/LaserScan", "std_msgs/Header"}
    kind = client.call("/rosapi/service_type", service="/eyes/set")["type"]
    assert client.call("/rosapi/service_request_details", type=kind)["typedefs"][0]["fieldnames"] == ["data"]
    response = client.call("/rosapi/service_response_details", type=kind)["typedefs"][0]
    assert response["fieldnames"] == ["success", "message"]
    servers = client.call("/rosapi/action_servers")["action_servers"]
    assert servers == (["/move_base"] if robot.ros == 1 else ["/navigate_to_pose"])


@only_once
def test_a_topic_of_another_type_is_refused(client: RosbridgeClient) -> None:
    client.send(op="advertise", topic="/cmd_vel", type="std_msgs/String")
    assert "already established with type" in client.call("/simulator/state")["refusals"][-1]
    assert client.call("/rosapi/topic_type", topic="/cmd_vel")["type"] == "geometry_msgs/Twist"


@only_once
def test_the_static_frames_come_to_late_subscribers_with_laser_and_camera(client: RosbridgeClient) -> None:
    client.subscribe("/tf_static")
    frames = {t["child_frame_id"] for t in client.wait_for_messages("/tf_static")[0]["transforms"]}
    assert frames == {"laser", "camera"}
