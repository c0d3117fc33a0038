"""Controls of the Robot panel against a rosbridge: operations sent, refused and read."""

import json
from typing import Any

import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.control_definitions import (
    CallService,
    Choice,
    ControlValue,
    PublishMessage,
    Reading,
    RobotControl,
    SendActionGoal,
    decided,
)
from caris_desktop.domain.events import ControlUsed, Problem
from caris_desktop.domain.link_commands import OfferControls, SetEmergencyStop, StopMotion, UseControl
from caris_desktop.domain.sensing import ControlReadings
from caris_desktop.robot import control_interfaces
from caris_desktop.robot.control_interfaces import parse_path, value_at
from caris_desktop.robot.profile_model import (
    EmergencyStopInterface,
    HeadInterface,
    NavigationServer,
    RobotProfile,
    interface_names,
)
from caris_desktop.ros.message_fields import MessageError
from tests.robot.loop_bench import Bridge, LoopBench, with_link

VOLUME = RobotControl(
    "volume",
    "Volume",
    "slider",
    PublishMessage("/volume", "std_msgs/UInt8", {"data": "$value"}),
    Reading("/volume/state", "std_msgs/Float32", "data", scale=100.0),
    range=(0.0, 300.0),
)
LIGHT = RobotControl(
    "light",
    "Light",
    "choice",
    PublishMessage("/leds", "robot_msgs/Light", {"pattern": "$value", "speed": 1}),
    choices=(Choice("Slow", "slow"), Choice("Broken", 3.0)),
)
EYES = RobotControl("eyes", "Eyes", "toggle", CallService("/eyes/set", "std_srvs/SetBool", {"data": "$value"}))
WAVE = RobotControl("wave", "Wave", "button", SendActionGoal("/play", "motion_msgs/PlayAction", {"name": "wave"}))
STATUS = RobotControl(
    "status", "Status", "readout", None, Reading("/diagnostics", "diagnostic_msgs/DiagnosticArray", "status[1].level")
)
ROBOT = RobotProfile("test", "Test", controls=(VOLUME, EYES, WAVE, STATUS))


def use(control: str, value: ControlValue, request_id: str = "r") -> UseControl:
    return UseControl(now_ns(), request_id, control, value)


def status(goal_id: str, number: int) -> dict[str, Any]:
    return {"goal_id": {"stamp": {"secs": 0, "nsecs": 0}, "id": goal_id}, "status": number, "text": ""}


async def ended(bench: LoopBench, request_id: str = "r") -> ControlUsed:
    def last() -> ControlUsed | None:
        told = [event for event in bench.of(ControlUsed) if event.request_id == request_id]
        return told[-1] if told and told[-1].state != "requested" else None

    found = await bench.until(last, f"the end of {request_id}")
    assert found is not None
    return found


def test_a_slider_is_published_and_its_state_comes_back() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(use("volume", 54.6))
        assert [event.state for event in (bench.of(ControlUsed)[0], await ended(bench))] == ["requested", "succeeded"]
        await bench.until(lambda: bench.bridge.published("/volume") == [{"data": 55}], "the volume")
        await bench.bridge.publish("/volume/state", {"data": 0.25})
        readings = await bench.until(lambda: bench.of(ControlReadings), "a reading")
        assert readings[0].values == {"volume": 25.0}

    with_link(ROBOT, test)


@pytest.mark.logs(r"robot\.control_interfaces: ")
def test_a_value_that_does_not_fit_the_type_is_explained_and_not_sent() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(use("volume", 300.0))
        refused = await ended(bench)
        assert refused.state == "failed"
        assert "must be a whole number from 0 to 255, but it is 300" in refused.detail
        bench.send(use("eyes", "open", "text"))
        assert "must be true or false, but it is the text 'open'" in (await ended(bench, "text")).detail
        assert bench.bridge.published("/volume") + bench.bridge.operations("call_service", "/eyes/set") == []

    with_link(ROBOT, test)


@pytest.mark.logs(r"robot\.control_interfaces: ")
def test_the_robots_own_types_are_requested_once() -> None:
    def details(request: dict[str, Any]) -> dict[str, Any] | str:
        if request["type"] != "robot_msgs/Light":
            return "no such type"
        fields = {"fieldnames": ["pattern", "speed"], "fieldtypes": ["string", "uint8"], "fieldarraylen": [-1, -1]}
        return {"typedefs": [{"type": "robot_msgs/Light", **fields}]}

    def prepare(bridge: Bridge) -> None:
        bridge.answers["/rosapi/message_details"] = details

    async def test(bench: LoopBench) -> None:
        bench.send(OfferControls(now_ns(), (LIGHT,)))
        bench.send(use("light", "slow"), use("light", 3.0, "broken"))
        assert (await ended(bench)).state == "succeeded"
        assert "the field 'pattern' must be text, but it is 3.0" in (await ended(bench, "broken")).detail
        assert bench.bridge.published("/leds") == [{"pattern": "slow", "speed": 1}]
        asked = [line["args"]["type"] for line in bench.bridge.operations("call_service", "/rosapi/message_details")]
        assert sorted(asked) == sorted(set(asked))

    with_link(ROBOT, test, prepare=prepare)


def test_a_service_that_refuses_says_why() -> None:
    def prepare(bridge: Bridge) -> None:
        bridge.answers["/eyes/set"] = lambda request: {"success": request["data"], "message": "no eyelids"}

    async def test(bench: LoopBench) -> None:
        bench.send(use("eyes", True), use("eyes", False, "off"))
        assert (await ended(bench)).state == "succeeded"
        refused = await ended(bench, "off")
        assert (refused.state, refused.detail) == ("failed", "no eyelids")

    with_link(ROBOT, test, prepare=prepare)


def test_an_action_goal_is_followed_to_its_end_and_the_emergency_stop_cancels_it() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(use("wave", True))
        [goal] = await bench.until(lambda: bench.bridge.published("/play/goal"), "a goal")
        assert goal["goal"] == {"name": "wave"}
        [advertised] = bench.bridge.operations("advertise", "/play/goal")
        assert advertised["type"] == "motion_msgs/PlayActionGoal"
        await bench.bridge.publish("/play/result", {"status": status(goal["goal_id"]["id"], 3), "result": {}})
        assert (await ended(bench)).state == "succeeded"
        bench.send(use("wave", True, "second"))
        await bench.until(lambda: len(bench.bridge.published("/play/goal")) == 2, "another goal")
        bench.send(SetEmergencyStop(now_ns(), True), use("wave", True, "third"))
        assert (await ended(bench, "second")).detail == "the emergency stop was activated"
        assert (await ended(bench, "third")).detail == "the emergency stop is active"
        await bench.until(lambda: bench.bridge.published("/play/cancel"), "the cancellation")

    with_link(ROBOT, test)


def test_the_emergency_stop_holds_for_every_control_that_may_move_the_robot() -> None:
    arm = RobotControl("arm", "Arm", "button", PublishMessage("/arm", "std_msgs/String", {"data": "up"}))
    lamp = RobotControl("lamp", "Lamp", "button", PublishMessage("/lamp", "std_msgs/String", {}), moves=False)
    blink = RobotControl("blink", "Blink", "button", SendActionGoal("/blink", "a_msgs/BlinkAction", {}), moves=False)

    async def test(bench: LoopBench) -> None:
        bench.send(SetEmergencyStop(now_ns(), True))
        for control in ("arm", "eyes", "wave", "lamp", "blink"):
            bench.send(use(control, True, control))
        for control in ("arm", "eyes", "wave"):
            refused = await ended(bench, control)
            assert (refused.state, refused.detail) == ("failed", "the emergency stop is active")
        assert (await ended(bench, "lamp")).state == "succeeded"
        await bench.until(lambda: bench.bridge.published("/blink/goal"), "what does not move is obeyed")
        # A request together with the stop is discarded too.
        bench.send(SetEmergencyStop(now_ns(), False))
        bench.send(use("eyes", True, "late"), SetEmergencyStop(now_ns(), True))
        assert (await ended(bench, "late")).detail == "the emergency stop is active"
        assert bench.bridge.published("/arm") + bench.bridge.published("/play/goal") == []
        assert bench.bridge.operations("call_service", "/eyes/set") == []

    with_link(RobotProfile("test", "Test", controls=(arm, EYES, WAVE, lamp, blink)), test)


def test_the_emergency_stop_counts_also_while_a_type_is_requested() -> None:
    answers: list[dict[str, Any]] = []

    def prepare(bridge: Bridge) -> None:
        # Answered below, after the stop.
        bridge.answers["/rosapi/message_details"] = lambda request: answers.append(request)

    async def test(bench: LoopBench) -> None:
        bench.send(OfferControls(now_ns(), (LIGHT,)), use("light", "slow"))
        await bench.until(lambda: answers, "the question")
        bench.send(SetEmergencyStop(now_ns(), True))
        for asked in bench.bridge.operations("call_service", "/rosapi/message_details"):
            fields = {"fieldnames": ["pattern", "speed"], "fieldtypes": ["string", "uint8"], "fieldarraylen": [-1, -1]}
            values = {"typedefs": [{"type": asked["args"]["type"], **fields}]}
            answer = {"op": "service_response", "id": asked["id"], "values": values, "result": True}
            await bench.bridge.send(json.dumps(answer))
        assert (await ended(bench)).detail == "the emergency stop is active"
        assert bench.bridge.published("/leds") == []

    with_link(ROBOT, test, prepare=prepare)


def test_without_permission_to_drive_no_control_moves_the_robot() -> None:
    lamp = RobotControl("lamp", "Lamp", "button", PublishMessage("/lamp", "std_msgs/String", {}), moves=False)

    async def test(bench: LoopBench) -> None:
        bench.send(use("wave", True, "under way"))
        await bench.until(lambda: bench.bridge.published("/play/goal"), "a goal")
        bench.send(OfferControls(now_ns(), (lamp,), driving_permitted=False))
        bench.send(use("wave", True), use("lamp", True, "lamp"))
        assert (await ended(bench, "under way")).detail == "the scenario does not permit driving"
        await bench.until(lambda: bench.bridge.published("/play/cancel"), "the cancellation")
        assert "does not permit driving" in (await ended(bench)).detail
        assert (await ended(bench, "lamp")).state == "succeeded"
        assert len(bench.bridge.published("/play/goal")) == 1
        bench.send(OfferControls(now_ns(), (lamp,)), use("wave", True, "permitted again"))
        await bench.until(lambda: len(bench.bridge.published("/play/goal")) == 2, "a goal again")

    with_link(ROBOT, test)


@pytest.mark.logs("Emergency stop: /stop/set: there is no such service")
def test_a_motion_interface_is_held_despite_the_scenario_and_a_stop_passes() -> None:
    stop = EmergencyStopInterface(service="/stop/set")
    robot = RobotProfile(
        "test", "Test", initial_pose="/here", emergency_stop=stop,
        navigation=NavigationServer("move_base", "/move_base"),
        head=HeadInterface("joint_trajectory", "/neck", "pan", "tilt"),
    )  # fmt: skip
    bool_of = {"data": False}
    effects = {
        "goal": PublishMessage("/move_base/goal", "move_base_msgs/MoveBaseActionGoal", {}),
        "action": SendActionGoal("move_base", "move_base_msgs/MoveBaseAction", {}),
        "here": PublishMessage("/here", "std_msgs/String", {}),
        "neck": PublishMessage("/neck", "trajectory_msgs/JointTrajectory", {}),
        "speed": CallService("/dwa/set_parameters", "dynamic_reconfigure/Reconfigure", {}),
    }
    unknown = CallService("/quiz/next", "std_srvs/Trigger", {})
    release = CallService("/stop/set", "std_srvs/SetBool", bool_of)
    cancel = PublishMessage("/move_base/cancel", "actionlib_msgs/GoalID", {})
    controls = tuple(
        RobotControl(name, name, "button", effect, moves=False)
        for name, effect in {**effects, "unknown": unknown, "release": release, "cancel": cancel}.items()
    )

    async def test(bench: LoopBench) -> None:
        bench.send(OfferControls(now_ns(), controls, driving_permitted=False))
        for name in effects:
            bench.send(use(name, True, f"driving {name}"))
            assert "does not permit driving" in (await ended(bench, f"driving {name}")).detail
        bench.send(OfferControls(now_ns(), controls), SetEmergencyStop(now_ns(), True))
        for name in (*effects, "unknown"):
            bench.send(use(name, True, f"held {name}"))
            assert (await ended(bench, f"held {name}")).detail == "the emergency stop is active"
        bench.send(use("release", True, "release"), use("cancel", True, "cancel"))
        assert "which only the wizard may do" in (await ended(bench, "release")).detail
        assert (await ended(bench, "cancel")).state == "succeeded"
        sent = [line["topic"] for line in bench.bridge.operations("publish")]
        assert not {"/move_base/goal", "/here", "/neck"} & set(sent)
        assert "/move_base/cancel" in sent
        called = [(line["service"], line.get("args")) for line in bench.bridge.operations("call_service")]
        assert ("/dwa/set_parameters", {}) not in called
        assert not [one for one in called if one[0] in ("/quiz/next",) or one == ("/stop/set", bool_of)]

    with_link(robot, test)


def test_motion_interfaces_of_the_profile_are_motion_in_a_scenario_too() -> None:
    wave = RobotControl("wave", "Wave", "button", CallService("/quiz/next", "std_srvs/Trigger", {}))
    lamp = RobotControl("lamp", "Lamp", "button", PublishMessage("/lamp", "std_msgs/Bool", {"data": True}))
    robot = RobotProfile(
        "test", "Test", head=HeadInterface("joint_trajectory", "/lights", "pan", "tilt"), controls=(wave, lamp)
    )
    claims = {
        "head": PublishMessage("/lights", "std_msgs/Float64", {"data": 1.0}),
        "below": PublishMessage("lights/level", "std_msgs/Float64", {"data": 1.0}),
        "again": CallService("quiz/next", "std_srvs/Trigger", {}),
        "lamp": PublishMessage("/lamp", "std_msgs/Bool", {"data": True}),
    }
    for name, effect in claims.items():
        claimed = decided(RobotControl(name, name, "button", effect, moves=False), interface_names(robot))
        assert claimed.is_motion == (name != "lamp"), name


@pytest.mark.parametrize(
    ("topic", "type_"),
    [("/other", "geometry_msgs/Twist"), ("/other", "geometry_msgs/TwistStamped"), ("cmd_vel", "std_msgs/String")],
)
def test_a_control_that_publishes_velocities_sends_nothing(topic: str, type_: str) -> None:
    spin = RobotControl("spin", "Spin", "button", PublishMessage(topic, type_, {}), moves=False)

    async def test(bench: LoopBench) -> None:
        bench.send(OfferControls(now_ns(), (spin,)), use("spin", True))
        assert "only driving may send" in (await ended(bench)).detail
        bench.send(use("volume", 1.0, "after"))
        await ended(bench, "after")
        assert bench.bridge.published(topic) == []
        assert [line["type"] for line in bench.bridge.operations("advertise", topic)] == []

    with_link(ROBOT, test)


def test_an_action_of_ros2() -> None:
    async def test(bench: LoopBench) -> None:
        async def react(operation: dict[str, Any]) -> None:
            if operation["op"] == "send_action_goal":
                assert (operation["action_type"], operation["args"]) == ("motion_msgs/action/Play", {"name": "wave"})
                result = {"op": "action_result", "id": operation["id"], "action": "/play", "status": 6, "result": True}
                await bench.bridge.send(json.dumps({**result, "values": {"error_msg": "no arm"}}))

        bench.bridge.on_operation = react
        bench.send(use("wave", True))
        refused = await ended(bench)
        assert (refused.state, refused.detail) == ("failed", "no arm")

    with_link(RobotProfile("test", "Test", ros=2, controls=(WAVE,)), test)


def test_an_action_of_ros2_that_is_refused_is_abandoned(monkeypatch: pytest.MonkeyPatch) -> None:
    """rosbridge sends no result for a goal that is refused or accepted by nobody."""
    monkeypatch.setattr(control_interfaces, "NO_ANSWER_S", 0.1)

    async def test(bench: LoopBench) -> None:
        bench.send(use("wave", True))
        assert "did not respond" in (await ended(bench)).detail

    with_link(RobotProfile("test", "Test", ros=2, controls=(WAVE,)), test)


def test_an_action_that_nobody_offers_is_abandoned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control_interfaces, "NO_ANSWER_S", 0.1)

    async def test(bench: LoopBench) -> None:
        bench.send(use("wave", True))
        assert "did not respond" in (await ended(bench)).detail

    with_link(ROBOT, test)


def test_without_a_link_every_use_fails_and_none_comes_later(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control_interfaces, "FATE_WITHIN_S", 0.3)

    async def test(bench: LoopBench) -> None:
        bench.send(use("wave", True, "under way"))
        await bench.until(lambda: bench.bridge.published("/play/goal"), "a goal")
        await bench.bridge.close()
        assert "link" in (await ended(bench, "under way")).detail
        await bench.until(lambda: bench.state == "lost", "the loss")
        bench.send(use("volume", 1.0), use("nonsense", True, "unknown"))
        assert (await ended(bench)).detail == "the robot is not connected"
        assert "no such control" not in (await ended(bench)).detail
        assert "has this control" in (await ended(bench, "unknown")).detail
        await bench.bridge.open()
        await bench.until(lambda: bench.state == "connected", "the link")
        await bench.until(lambda: len(bench.bridge.operations("advertise", "/volume")) == 2, "restored")
        [goal] = bench.bridge.published("/play/goal")
        [cancel] = await bench.until(lambda: bench.bridge.published("/play/cancel"), "what was under way is cancelled")
        assert cancel["id"] == goal["goal_id"]["id"]
        assert bench.bridge.published("/volume") == []

    with_link(ROBOT, test)


def test_a_goal_of_a_control_is_cancelled_after_a_lost_link_and_reports_its_end() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(use("wave", True, "under way"))
        [goal] = await bench.until(lambda: bench.bridge.published("/play/goal"), "a goal")
        await bench.bridge.drop()
        await bench.until(lambda: bench.state == "lost", "the loss")
        [cancel, *_] = await bench.until(lambda: bench.bridge.published("/play/cancel"), "the cancellation")
        assert cancel["id"] == goal["goal_id"]["id"]
        await bench.bridge.publish("/play/status", {"status_list": [status(cancel["id"], 3)]})
        assert (await ended(bench, "under way")).state == "succeeded"

    with_link(ROBOT, test)


def test_readings_are_reported_together_and_not_too_often() -> None:
    async def test(bench: LoopBench) -> None:
        for number in range(40):
            await bench.bridge.publish("/volume/state", {"data": float(number)})
            levels = [{"level": 0}, {"level": number}]
            await bench.bridge.publish("/diagnostics", {"status": levels}, cbor=bool(number % 2))
        last = {"volume": 3900.0, "status": 39.0}
        await bench.until(lambda: [told for told in bench.of(ControlReadings) if told.values == last], "all")
        assert len(bench.of(ControlReadings)) <= 3

    with_link(ROBOT, test)


def test_a_restarted_server_is_notified_again() -> None:
    async def test(bench: LoopBench) -> None:
        await bench.bridge.publish("/volume/state", {"data": 0.5})
        await bench.until(lambda: bench.of(ControlReadings), "a reading")
        bench.send(OfferControls(now_ns(), ()))
        await bench.until(lambda: len(bench.of(ControlReadings)) == 2, "the same again")
        assert bench.of(ControlReadings)[1].values == {"volume": 50.0}

    with_link(ROBOT, test)


def test_stop_cancels_what_a_control_has_begun() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(use("wave", True))
        await bench.until(lambda: bench.bridge.published("/play/goal"), "a goal")
        bench.send(StopMotion(now_ns()))
        await bench.until(lambda: bench.bridge.published("/play/cancel"), "the cancellation")
        assert (await ended(bench)).detail == "stopped by the wizard"

    with_link(ROBOT, test)


def test_goals_of_a_control_do_not_outlive_the_console() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(use("wave", True))
        await bench.until(lambda: bench.bridge.published("/play/goal"), "a goal")
        await bench.link.finish()
        await bench.until(lambda: bench.bridge.published("/play/cancel"), "the cancellation")

    with_link(ROBOT, test)


def test_a_reading_that_is_not_there_is_one_problem() -> None:
    async def test(bench: LoopBench) -> None:
        for _ in range(5):
            await bench.bridge.publish("/diagnostics", {"status": [{"level": 0}]})
        await bench.bridge.publish("/volume/state", {"data": 0.5})
        await bench.until(lambda: bench.of(ControlReadings), "the other reading")
        [problem] = bench.of(Problem)
        assert "cannot be shown as Status: there is no field 1" in problem.what

    with_link(ROBOT, test)


def test_a_scenario_changes_what_is_listened_to() -> None:
    async def test(bench: LoopBench) -> None:
        door = RobotControl("door", "Door", "readout", None, Reading("/door", "std_msgs/Bool", "data"))
        bench.send(OfferControls(now_ns(), (door,)))
        await bench.until(lambda: bench.bridge.operations("subscribe", "/door"), "a subscription")
        await bench.bridge.publish("/door", {"data": True})
        await bench.until(lambda: bench.of(ControlReadings), "a reading")
        bench.send(OfferControls(now_ns(), ()))
        await bench.until(lambda: bench.bridge.operations("unsubscribe", "/door"), "the end of it")
        bench.send(use("volume", 1.0))
        assert (await ended(bench)).state == "succeeded"

    with_link(ROBOT, test)


@pytest.mark.parametrize(
    ("text", "path"),
    [("data", ("data",)), ("status[0].level", ("status", 0, "level")), ("a.b[1][2].c", ("a", "b", 1, 2, "c"))],
)
def test_paths_to_fields(text: str, path: tuple[str | int, ...]) -> None:
    assert parse_path(text) == path


@pytest.mark.parametrize("text", ["", ".", "a.", "a[", "a[-1]", "a[b]", "a b", "__import__('os')", "a[99999999]"])
def test_invalid_paths(text: str) -> None:
    with pytest.raises(ValueError, match="not a path"):
        parse_path(text)


def test_values_at_paths() -> None:
    message = {"a": [1, {"b": "x"}], "inf": float("inf"), "null": None, "huge": 10**400}
    assert value_at(message, ("a", 0), 2.0) == 2.0
    assert value_at(message, ("a", 1, "b"), 2.0) == "x"
    assert [value_at(message, (name,), 1.0) for name in ("inf", "null", "huge")] == [None] * 3
    for path in (("b",), ("a", 5), ("a", "b"), ("a",), ("inf", 0)):
        with pytest.raises(MessageError):
            value_at(message, path, 1.0)
