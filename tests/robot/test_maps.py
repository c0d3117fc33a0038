"""Maps: saving, loading and switching, and the initial pose for the localization."""

import json
from dataclasses import replace
from typing import Any

import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import InitialPoseSet, MappingChanged, MapRequestChanged, Problem
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.link_commands import RequestMap, SetInitialPose
from caris_desktop.robot.maps import map_name_refusal
from caris_desktop.robot.profile_model import MapServices, RobotProfile, TopicSource, TransformFrames
from tests.robot.loop_bench import Bridge, LoopBench, inventory, with_link

SLAM = ("/slam_toolbox/serialize_map", "/slam_toolbox/deserialize_map", "/slam_toolbox/pause_new_measurements")
ROBOT = RobotProfile(
    "test",
    "Test",
    ros=2,
    map=TopicSource("/map"),
    initial_pose="/initialpose",
    frames=TransformFrames(map="world"),
    maps=MapServices(slam_toolbox="/slam_toolbox", map_server="/map_server", map_saver="/map_saver", folder="/maps/"),
)


class SlamToolbox:
    """Toggles, and exposes its state as a parameter, as slam_toolbox does."""

    def __init__(self, *, paused: bool = False, tells: bool = True) -> None:
        self.paused = paused
        self.tells = tells

    def toggle(self, _: dict[str, Any]) -> dict[str, Any]:
        self.paused = not self.paused
        return {"status": True}

    def parameter(self, request: dict[str, Any]) -> dict[str, Any] | str:
        if not self.tells or request["name"].replace(":", "/") != "/slam_toolbox/paused_new_measurements":
            return "there is no such parameter"
        return {"value": json.dumps(self.paused)}

    def fit_out(self, bridge: Bridge, *services: str) -> None:
        bridge.answers = {
            **inventory(services=services or (*SLAM, "/map_saver/save_map")),
            "/slam_toolbox/pause_new_measurements": self.toggle,
            "/slam_toolbox/serialize_map": {"result": 0},
            "/slam_toolbox/deserialize_map": {},
            "/map_saver/save_map": {"result": True},
            "/map_server/load_map": {"result": 1},
            "/rosapi/get_param": self.parameter,
        }


async def ended(bench: LoopBench, request_id: str) -> MapRequestChanged:
    def last() -> MapRequestChanged | None:
        told = [change for change in bench.of(MapRequestChanged) if change.request_id == request_id]
        return told[-1] if told and told[-1].state != "requested" else None

    found = await bench.until(last, f"the end of {request_id}")
    assert found is not None
    return found


async def first_mapping(bench: LoopBench) -> MappingChanged:
    return (await bench.until(lambda: bench.of(MappingChanged), "what the robot offers"))[0]


@pytest.mark.parametrize("name", ["lab", "Lab 3", "étage-2", "a.b"])
def test_names_that_maps_may_have(name: str) -> None:
    assert map_name_refusal(name) == ""


@pytest.mark.parametrize(
    "name", ["", " ", "../x", "a/b", "a\\b", ".hidden", "a..b", "x" * 101, " a", "a\n", "-rf", "a\x00b", "~"]
)
def test_names_that_could_leave_the_folder_or_are_none(name: str) -> None:
    assert map_name_refusal(name)


def test_a_map_is_saved_as_pose_graph_and_as_picture() -> None:
    async def test(bench: LoopBench) -> None:
        offered = await first_mapping(bench)
        assert (offered.mapping, offered.can_save, offered.can_load, offered.can_switch) == (True, True, True, True)
        # The console has discarded the state during the trouble.
        bench.link.link_recovered()
        assert [replace(change, stamp_ns=0) for change in bench.of(MappingChanged)] == [
            replace(offered, stamp_ns=0)
        ] * 2
        bench.send(RequestMap(now_ns(), "r", "save", "lab"))
        assert (await ended(bench, "r")).state == "succeeded"
        [serialize] = bench.bridge.operations("call_service", "/slam_toolbox/serialize_map")
        assert serialize["args"] == {"filename": "/maps/lab"}
        [save] = bench.bridge.operations("call_service", "/map_saver/save_map")
        assert (save["args"]["map_url"], save["args"]["map_topic"]) == ("/maps/lab", "/map")

    with_link(ROBOT, test, prepare=SlamToolbox().fit_out)


def test_switching_toggles_only_when_it_has_to() -> None:
    slam = SlamToolbox(paused=True)

    async def test(bench: LoopBench) -> None:
        assert (await first_mapping(bench)).mapping is False
        bench.send(RequestMap(now_ns(), "same", "start_localization"))
        assert (await ended(bench, "same")).state == "succeeded"
        assert slam.paused
        bench.send(RequestMap(now_ns(), "other", "start_mapping"))
        assert (await ended(bench, "other")).state == "succeeded"
        assert not slam.paused
        assert [change.mapping for change in bench.of(MappingChanged)] == [False, False, True]

    with_link(ROBOT, test, prepare=slam.fit_out)


def test_an_unknown_mode_begins_by_mapping() -> None:
    slam = SlamToolbox(tells=False)

    async def test(bench: LoopBench) -> None:
        assert (await first_mapping(bench)).mapping is None
        bench.send(RequestMap(now_ns(), "r", "start_localization"))
        assert (await ended(bench, "r")).state == "succeeded"
        assert slam.paused

    with_link(ROBOT, test, prepare=slam.fit_out)


def test_a_saved_map_is_loaded_where_the_robot_is() -> None:
    robot = replace(ROBOT, pose=TopicSource("/amcl_pose"))

    async def test(bench: LoopBench) -> None:
        await first_mapping(bench)
        pose = {
            "position": {"x": 1.0, "y": 2.0, "z": 0.0},
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        }
        await bench.bridge.publish("/amcl_pose", {"header": {}, "pose": {"pose": pose}})
        bench.send(RequestMap(now_ns(), "l", "start_localization"))
        await ended(bench, "l")
        bench.send(RequestMap(now_ns(), "r", "load", "lab"))
        assert (await ended(bench, "r")).state == "succeeded"
        [load] = bench.bridge.operations("call_service", "/slam_toolbox/deserialize_map")
        assert load["args"] == {
            "filename": "/maps/lab",
            "match_type": 3,
            "initial_pose": {"x": 1.0, "y": 2.0, "theta": 0.0},
        }

    with_link(robot, test, prepare=SlamToolbox().fit_out)


def test_the_map_server_says_why_it_does_not_load() -> None:
    async def test(bench: LoopBench) -> None:
        offered = await first_mapping(bench)
        assert (offered.mapping, offered.can_save, offered.can_load, offered.can_switch) == (None, False, True, False)
        bench.send(RequestMap(now_ns(), "r", "load", "cellar"))
        change = await ended(bench, "r")
        assert (change.state, change.detail) == ("failed", "the robot has no such map")
        [load] = bench.bridge.operations("call_service", "/map_server/load_map")
        assert load["args"] == {"map_url": "/maps/cellar.yaml"}

    with_link(ROBOT, test, prepare=lambda bridge: SlamToolbox().fit_out(bridge, "/map_server/load_map"))


@pytest.mark.parametrize(("result", "state"), [(0, "succeeded"), (2, "failed")])
def test_a_map_server_that_answers_with_a_huge_map(result: int, state: str) -> None:
    def prepare(bridge: Bridge) -> None:
        SlamToolbox().fit_out(bridge, "/map_server/load_map")
        bridge.answers["/map_server/load_map"] = lambda _: {"map": {"data": [0] * 2_000_000}, "result": result}

    async def test(bench: LoopBench) -> None:
        await first_mapping(bench)
        bench.send(RequestMap(now_ns(), "r", "load", "hall"))
        assert (await ended(bench, "r")).state == state
        assert not [problem for problem in bench.of(Problem) if "cannot be used" in problem.what]

    with_link(ROBOT, test, prepare=prepare)


def test_impossible_operations_are_refused_and_nothing_is_sent() -> None:
    async def test(bench: LoopBench) -> None:
        await first_mapping(bench)
        bench.send(RequestMap(now_ns(), "a", "load", "../etc/passwd"), RequestMap(now_ns(), "b", "start_mapping"))
        assert "can only contain letters" in (await ended(bench, "a")).detail
        assert (await ended(bench, "b")).detail == "the robot offers no service for it"
        called = {line["service"] for line in bench.bridge.operations("call_service")}
        assert not any(name.startswith(("/slam_toolbox", "/map_server")) for name in called)

    with_link(ROBOT, test, prepare=lambda bridge: SlamToolbox().fit_out(bridge, "/map_server/load_map"))


@pytest.mark.logs(r"robot\.maps: ")
def test_a_request_does_not_outlive_the_link() -> None:
    def prepare(bridge: Bridge) -> None:
        SlamToolbox().fit_out(bridge)
        bridge.answers["/slam_toolbox/serialize_map"] = lambda _: None

    async def test(bench: LoopBench) -> None:
        await first_mapping(bench)
        bench.send(RequestMap(now_ns(), "r", "save", "lab"))
        await bench.until(lambda: bench.bridge.operations("call_service", "/slam_toolbox/serialize_map"), "the call")
        bench.send(RequestMap(now_ns(), "second", "save", "lab"))
        assert "still running" in (await ended(bench, "second")).detail
        await bench.bridge.close()
        assert "connection to the robot was lost" in (await ended(bench, "r")).detail

    with_link(ROBOT, test, prepare=prepare)


def test_the_robot_gets_its_pose() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(SetInitialPose(now_ns(), Pose2D(1.0, 2.0, 0.5), spread_m=0.3))
        [message] = await bench.until(lambda: bench.bridge.published("/initialpose"), "the pose")
        assert message["header"]["frame_id"] == "world"
        assert message["pose"]["pose"]["position"]["y"] == 2.0
        assert message["pose"]["covariance"][7] == pytest.approx(0.09)
        assert [told.pose_in_map for told in bench.of(InitialPoseSet)] == [Pose2D(1.0, 2.0, 0.5)]
        bench.send(SetInitialPose(now_ns(), Pose2D(float("nan"), 2.0, 0.5)))
        assert "the position on the map is invalid" in bench.of(Problem)[-1].what

    with_link(ROBOT, test)
