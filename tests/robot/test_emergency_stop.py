"""Every kind of emergency stop interface of a robot."""

from dataclasses import replace

import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import EmergencyStopChanged, Problem
from caris_desktop.domain.link_commands import SetEmergencyStop
from caris_desktop.domain.sensing import BatteryState
from caris_desktop.robot import emergency_stop
from caris_desktop.robot.profile_model import EmergencyStopInterface, RobotProfile, TopicSource
from tests.robot.loop_bench import Bridge, LoopBench, inventory, with_link


def robot(interface: EmergencyStopInterface, ros: int = 1) -> RobotProfile:
    return RobotProfile("test", "Test", ros=ros, emergency_stop=interface)  # type: ignore[arg-type]


def latched(bench: LoopBench) -> list[tuple[bool, str]]:
    return [(change.latched, change.by) for change in bench.of(EmergencyStopChanged)]


def test_an_inverted_topic_is_read_the_other_way_round() -> None:
    async def test(bench: LoopBench) -> None:
        await bench.bridge.publish("/motors_on", {"data": True})
        await bench.bridge.publish("/motors_on", {"data": False})
        await bench.until(lambda: latched(bench) == [(True, "robot")], "latched")
        # The console cannot reset a stop that only the robot can reset.
        bench.send(SetEmergencyStop(now_ns(), False))
        assert latched(bench) == [(True, "robot")] * 2
        assert bench.of(Problem)[-1].what == "The robot's own emergency stop is still active."
        await bench.bridge.publish("/motors_on", {"data": True})
        await bench.until(lambda: latched(bench)[-1] == (False, "robot"), "released")

    with_link(robot(EmergencyStopInterface(topic="/motors_on", inverted=True)), test)


@pytest.mark.parametrize("ros", [1, 2])
def test_a_service_to_set_and_one_to_clear(ros: int) -> None:
    interface = EmergencyStopInterface(set_service="/stop", clear_service="/release", service_type="std_srvs/Empty")

    def prepare(bridge: Bridge) -> None:
        bridge.answers = {"/stop": {}, "/release": {}, **inventory(services=("/stop", "/release"))}

    async def test(bench: LoopBench) -> None:
        bench.send(SetEmergencyStop(now_ns(), True))
        [call] = await bench.until(lambda: bench.bridge.operations("call_service", "/stop"), "the call")
        assert call["args"] == {}
        assert latched(bench) == [], "who pressed it has told it"
        bench.send(SetEmergencyStop(now_ns(), False))
        assert latched(bench) == []
        await bench.until(lambda: latched(bench) == [(False, "wizard")], "cleared once the robot has answered")
        assert [problem for problem in bench.of(Problem) if "emergency stop" in problem.what] == []

    with_link(robot(interface, ros), test, prepare=prepare)


@pytest.mark.logs(r"robot\.emergency_stop: ")
def test_a_trigger_that_refuses_to_clear_keeps_it_set() -> None:
    interface = EmergencyStopInterface(set_service="/stop", clear_service="/release")

    def prepare(bridge: Bridge) -> None:
        bridge.answers = {
            "/stop": {"success": True, "message": ""},
            "/release": {"success": False, "message": "the button is pressed"},
        }

    async def test(bench: LoopBench) -> None:
        bench.send(SetEmergencyStop(now_ns(), True), SetEmergencyStop(now_ns(), False))
        [problem] = await bench.until(lambda: bench.of(Problem), "a problem")
        assert "the button is pressed" in problem.what
        assert latched(bench)[-1] == (True, "robot")

    with_link(robot(interface), test, prepare=prepare)


def test_the_wizards_last_word_counts_when_the_robot_is_slow() -> None:
    interface = EmergencyStopInterface(service="/estop")

    async def test(bench: LoopBench) -> None:
        bench.send(SetEmergencyStop(now_ns(), True), SetEmergencyStop(now_ns(), False))
        bench.send(SetEmergencyStop(now_ns(), True))
        await bench.until(lambda: len(bench.bridge.operations("call_service", "/estop")) == 3, "three calls")
        # Messages published after the answers arrive after them.
        await bench.bridge.publish("/battery", {"percentage": 0.5})
        await bench.until(lambda: bench.of(BatteryState), "what came after the answers")
        assert latched(bench) == []

    def prepare(bridge: Bridge) -> None:
        bridge.answers = {"/estop": {"success": True, "message": ""}}

    with_link(replace(robot(interface), battery=TopicSource("/battery")), test, prepare=prepare)


def test_a_command_topic_is_published_again_to_a_robot_that_comes_back() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(SetEmergencyStop(now_ns(), True))
        assert await bench.until(lambda: bench.bridge.published("/e_stop"), "the stop") == [{"data": True}]
        bench.bridge.lines.clear()
        await bench.bridge.drop()
        assert await bench.until(lambda: bench.bridge.published("/e_stop"), "the stop again") == [{"data": True}]
        [advertised] = bench.bridge.operations("advertise", "/e_stop")
        assert advertised["latch"] is True
        bench.send(SetEmergencyStop(now_ns(), False))
        await bench.until(lambda: bench.bridge.published("/e_stop")[1:] == [{"data": False}], "cleared")
        assert latched(bench) == [(False, "wizard")]
        bench.bridge.lines.clear()
        await bench.bridge.drop()
        await bench.until(lambda: bench.bridge.operations("advertise", "/e_stop"), "the link again")
        assert bench.bridge.published("/e_stop") == []

    with_link(robot(EmergencyStopInterface(command_topic="/e_stop")), test)


def test_a_robot_without_the_service_leaves_the_stop_to_the_console() -> None:
    interface = EmergencyStopInterface(service="/estop")

    async def test(bench: LoopBench) -> None:
        await bench.until(lambda: bench.of(Problem), "what is missing")
        bench.send(SetEmergencyStop(now_ns(), True), SetEmergencyStop(now_ns(), False))
        assert latched(bench) == [(False, "wizard")]

    with_link(robot(interface), test, prepare=lambda bridge: bridge.answers.update(inventory()))


def test_a_stop_that_nobody_took_is_reported_and_sent_when_the_service_appears_also_after_a_reconnect(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(emergency_stop, "TRIED_AGAIN_AFTER_S", 0.05)

    async def test(bench: LoopBench) -> None:
        await bench.until(lambda: bench.of(Problem), "what is missing")
        bench.send(SetEmergencyStop(now_ns(), True))
        [told] = await bench.until(
            lambda: [problem for problem in bench.of(Problem) if problem.cause == "emergency_stop"], "the alarm"
        )
        assert "/estop is missing" in told.what
        assert "the robot itself is not stopped" in told.meaning
        bench.bridge.lines.clear()
        bench.bridge.answers.update({**inventory(services=("/estop",)), "/estop": {"success": True}})
        [call] = await bench.until(lambda: bench.bridge.operations("call_service", "/estop"), "the stop")
        assert call["args"] == {"data": True}
        bench.bridge.lines.clear()
        await bench.bridge.drop()
        [again] = await bench.until(lambda: bench.bridge.operations("call_service", "/estop"), "the stop again")
        assert again["args"] == {"data": True}
        bench.send(SetEmergencyStop(now_ns(), False))
        await bench.until(lambda: latched(bench)[-1:] == [(False, "wizard")], "cleared by the robot")
        assert [call["args"] for call in bench.bridge.operations("call_service", "/estop")][-1] == {"data": False}

    interface = EmergencyStopInterface(service="/estop")
    with_link(robot(interface), test, prepare=lambda bridge: bridge.answers.update(inventory()))


@pytest.mark.logs(r"robot\.emergency_stop: ")
def test_a_service_that_does_not_answer_is_asked_again_and_reported_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(emergency_stop, "TRIED_AGAIN_AFTER_S", 0.05)

    async def test(bench: LoopBench) -> None:
        bench.send(SetEmergencyStop(now_ns(), True))
        calls = await bench.until(lambda: bench.bridge.operations("call_service", "/estop")[2:], "a third call")
        assert calls[0]["args"] == {"data": True}
        assert len([problem for problem in bench.of(Problem) if problem.cause == "emergency_stop"]) == 1

    # No rosapi, and a missing service.
    with_link(robot(EmergencyStopInterface(service="/estop")), test)


def test_a_command_topic_that_nobody_takes_is_reported_and_published_again_to_who_comes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(emergency_stop, "TRIED_AGAIN_AFTER_S", 0.05)

    async def test(bench: LoopBench) -> None:
        bench.bridge.answers["/rosapi/subscribers"] = {"subscribers": []}
        bench.send(SetEmergencyStop(now_ns(), True))
        await bench.until(lambda: [p for p in bench.of(Problem) if "/e_stop is missing" in p.what], "the alarm")
        published = len(bench.bridge.published("/e_stop"))
        bench.bridge.answers["/rosapi/subscribers"] = {"subscribers": ["/base"]}
        await bench.until(lambda: len(bench.bridge.published("/e_stop")) > published, "the stop again")
        assert bench.bridge.published("/e_stop")[-1] == {"data": True}

    with_link(robot(EmergencyStopInterface(command_topic="/e_stop")), test)


def test_missing_interfaces_are_reported_again_when_they_change() -> None:
    async def test(bench: LoopBench) -> None:
        def lacking() -> list[str]:
            return [problem.what for problem in bench.of(Problem) if problem.cause == "robot_lacks"]

        def without_estop() -> list[str]:
            return [what for what in lacking() if "/estop" in what]

        await bench.until(without_estop, "what is missing")
        bench.bridge.answers.update(inventory(services=("/estop",)))
        await bench.bridge.drop()
        await bench.until(lambda: "/estop" not in lacking()[-1], "less is missing")
        bench.bridge.answers.update(inventory())
        await bench.bridge.drop()
        await bench.until(lambda: without_estop()[1:], "it is missing again")

    interface = EmergencyStopInterface(service="/estop")
    with_link(robot(interface), test, prepare=lambda bridge: bridge.answers.update(inventory()))
