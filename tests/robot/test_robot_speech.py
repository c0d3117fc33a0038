"""Robot speech as an action: its result is the end of the utterance."""

import json
from typing import Any

import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import Problem, UtteranceChanged
from caris_desktop.domain.link_commands import Say, Silence
from caris_desktop.robot import robot_speech
from caris_desktop.robot.profile_model import RobotProfile, SpeechAction, SpeechInterface
from tests.robot.loop_bench import LoopBench, with_link

TTS = SpeechInterface(
    action=SpeechAction("/tts", "pal_interaction_msgs/TtsAction", {"rawtext": {"text": "$value", "lang_id": "en_GB"}})
)
ROBOT = RobotProfile("test", "Test", speech=TTS)


def status(goal_id: str, number: int, text: str = "") -> dict[str, Any]:
    return {"goal_id": {"stamp": {"secs": 0, "nsecs": 0}, "id": goal_id}, "status": number, "text": text}


def states(bench: LoopBench) -> list[tuple[str, str]]:
    return [(event.utterance_id, event.state) for event in bench.of(UtteranceChanged)]


async def goal_ids(bench: LoopBench, count: int) -> list[str]:
    await bench.until(lambda: len(bench.bridge.published("/tts/goal")) >= count, f"{count} goals")
    return [goal["goal_id"]["id"] for goal in bench.bridge.published("/tts/goal")]


def test_one_sentence_after_the_other_by_the_robots_own_word() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "Hello"), Say(now_ns(), "u2", "Goodbye"))
        [first] = await goal_ids(bench, 1)
        assert bench.bridge.published("/tts/goal")[0]["goal"] == {"rawtext": {"text": "Hello", "lang_id": "en_GB"}}
        await bench.bridge.publish("/tts/status", {"status_list": [status(first, 1)]})
        await bench.until(lambda: states(bench) == [("u1", "started")], "started")
        assert len(await goal_ids(bench, 1)) == 1
        await bench.bridge.publish("/tts/result", {"status": status(first, 3), "result": {"text": "Hello"}})
        _, second = await goal_ids(bench, 2)
        await bench.bridge.publish("/tts/result", {"status": status(second, 4, "no sound"), "result": {}})
        await bench.until(lambda: len(states(bench)) == 3, "the end")
        assert states(bench)[1:] == [("u1", "finished"), ("u2", "failed")]
        assert bench.of(UtteranceChanged)[-1].detail == "no sound"

    with_link(ROBOT, test)


@pytest.mark.parametrize("begins", [True, False])
def test_a_goal_that_waits_while_the_robot_says_something_else_has_as_long_as_that_takes(
    monkeypatch: pytest.MonkeyPatch, *, begins: bool
) -> None:
    monkeypatch.setattr(robot_speech, "STARTS_WITHIN_S", 600.0)
    monkeypatch.setattr(robot_speech, "LONGEST_UTTERANCE_S", 600.0 if begins else 0.01)

    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "Hello"))
        [first] = await goal_ids(bench, 1)
        await bench.bridge.publish("/tts/status", {"status_list": [status(first, 0)]})
        if begins:
            await bench.bridge.publish("/tts/status", {"status_list": [status(first, 1)]})
            await bench.bridge.publish("/tts/result", {"status": status(first, 3), "result": {}})
        told = [("u1", "started"), ("u1", "finished")] if begins else [("u1", "failed")]
        await bench.until(lambda: states(bench) == told, "it has its turn, or not in all that time")

    with_link(ROBOT, test)


def test_a_word_that_is_over_before_it_began_has_both_states() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "Hi", origin="phrase"))
        [first] = await goal_ids(bench, 1)
        await bench.bridge.publish("/tts/result", {"status": status(first, 3), "result": {}})
        await bench.until(lambda: states(bench) == [("u1", "started"), ("u1", "finished")], "both")
        assert [event.origin for event in bench.of(UtteranceChanged)] == ["phrase", "phrase"]

    with_link(ROBOT, test)


def test_silence_cancels_the_goal() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "A long story"), Say(now_ns(), "u2", "and another"))
        [first] = await goal_ids(bench, 1)
        bench.send(Silence(now_ns()))
        [cancel] = await bench.until(lambda: bench.bridge.published("/tts/cancel"), "the cancellation")
        assert cancel["id"] == first
        assert states(bench) == [("u1", "interrupted"), ("u2", "interrupted")]
        await bench.bridge.publish("/tts/result", {"status": status(first, 2), "result": {}})
        bench.send(Say(now_ns(), "u3", "Yes"))
        await goal_ids(bench, 2)
        assert len(states(bench)) == 2
        assert bench.of(Problem) == []

    with_link(ROBOT, test)


def test_a_robot_that_does_not_begin_to_speak(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_speech, "STARTS_WITHIN_S", 0.1)

    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "Hello"))
        await bench.until(lambda: states(bench) == [("u1", "failed")], "given up")
        await bench.until(lambda: bench.bridge.published("/tts/cancel"), "and cancelled")

    with_link(ROBOT, test)


@pytest.mark.parametrize(("number", "state"), [(3, "finished"), (4, "failed"), (2, "interrupted")])
def test_the_fate_of_a_sentence_in_a_lost_link_is_reported_by_its_status(number: int, state: str) -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "A long story"), Say(now_ns(), "u2", "again"))
        [first] = await goal_ids(bench, 1)
        await bench.bridge.publish("/tts/status", {"status_list": [status(first, 1)]})
        await bench.until(lambda: states(bench) == [("u1", "started")], "started")
        await bench.bridge.drop()
        # An utterance that was never sent is not sent later.
        await bench.until(lambda: states(bench)[1:] == [("u2", "failed")], "the other failed")
        await bench.until(lambda: bench.state == "connected", "the link")
        await bench.bridge.publish("/tts/status", {"status_list": [status(first, 1)]})
        await bench.bridge.publish("/tts/status", {"status_list": [status(first, number)]})
        await bench.until(lambda: states(bench)[2:] == [("u1", state)], state)
        bench.send(Say(now_ns(), "u3", "now"))
        await goal_ids(bench, 2)
        assert len(bench.bridge.published("/tts/goal")) == 2

    with_link(ROBOT, test)


def test_a_sentence_of_which_nobody_reports_afterwards_has_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_speech, "FATE_WITHIN_S", 0.4)

    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "Hello"))
        await goal_ids(bench, 1)
        await bench.bridge.close()
        await bench.until(lambda: states(bench) == [("u1", "failed")], "failed")
        assert "outcome is unknown" in bench.of(UtteranceChanged)[-1].detail
        bench.send(Say(now_ns(), "u2", "now"))
        assert bench.of(UtteranceChanged)[-1].detail == "the robot is not connected"

    with_link(ROBOT, test)


def test_silence_that_finds_no_link_is_retained_for_the_robot() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "A long story"))
        [first] = await goal_ids(bench, 1)
        await bench.bridge.drop()
        await bench.until(lambda: bench.state == "lost", "the loss")
        bench.link.process_commands([Silence(now_ns())])
        [cancel] = await bench.until(lambda: bench.bridge.published("/tts/cancel"), "the cancellation")
        assert cancel["id"] == first
        await bench.until(lambda: states(bench) == [("u1", "interrupted")], "interrupted")

    with_link(ROBOT, test)


ON_TOPICS = RobotProfile("test", "Test", speech=SpeechInterface(topic="/say", speaking="/speaking"))


def test_sentences_on_a_topic_are_spoken_to_their_end_despite_a_lost_link() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "One"), Say(now_ns(), "u2", "Two"))
        await bench.until(lambda: len(bench.bridge.published("/say")) == 2, "both are asked for")
        await bench.bridge.publish("/speaking", {"data": True})
        await bench.until(lambda: states(bench) == [("u1", "started")], "started")
        await bench.bridge.drop()
        await bench.until(lambda: bench.state == "lost", "the loss")
        await bench.until(lambda: bench.state == "connected", "the link")
        for speaking in (True, False, True, False):
            await bench.bridge.publish("/speaking", {"data": speaking})
        await bench.until(
            lambda: states(bench)[1:] == [("u1", "finished"), ("u2", "started"), ("u2", "finished")], "both are over"
        )
        assert len(bench.bridge.published("/say")) == 2

    with_link(ON_TOPICS, test)


def test_an_action_of_ros2(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_speech, "STARTED_UNTOLD_S", 0.05)

    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "Hello"))
        [goal] = await bench.until(lambda: bench.bridge.operations("send_action_goal"), "a goal")
        assert (goal["action"], goal["action_type"]) == ("/tts", "pal_interaction_msgs/action/Tts")
        await bench.until(lambda: states(bench) == [("u1", "started")], "started")
        result = {"op": "action_result", "id": goal["id"], "action": "/tts", "status": 4, "result": True, "values": {}}
        await bench.bridge.send(json.dumps(result))
        await bench.until(lambda: states(bench)[1:] == [("u1", "finished")], "finished")

    with_link(RobotProfile("test", "Test", ros=2, speech=TTS), test)


def test_an_action_of_ros2_reports_its_fate_after_the_link_was_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_speech, "STARTED_UNTOLD_S", 0.05)

    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "A long story"))
        await bench.until(lambda: bench.bridge.operations("send_action_goal"), "a goal")

        async def tell(number: int) -> None:
            goal_id = {"goal_id": {"uuid": list(range(16))}, "stamp": {"sec": 1, "nanosec": 0}}
            message = {"status_list": [{"goal_info": goal_id, "status": number}]}
            await bench.bridge.publish("/tts/_action/status", message)

        await tell(2)
        await bench.until(lambda: states(bench) == [("u1", "started")], "started")
        await bench.bridge.drop()
        await bench.until(lambda: bench.state == "lost", "the loss")
        await bench.until(lambda: bench.state == "connected", "the link")
        await tell(2)
        await tell(4)
        await bench.until(lambda: states(bench)[1:] == [("u1", "finished")], "finished")

    with_link(RobotProfile("test", "Test", ros=2, speech=TTS), test)
