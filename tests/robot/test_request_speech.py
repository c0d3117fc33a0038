"""Robot speech by a service or over HTTP, and unprompted robot speech."""

import asyncio
import json
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import Problem, UtteranceChanged
from caris_desktop.domain.link_commands import Say, Silence
from caris_desktop.robot import robot_speech
from caris_desktop.robot.action_client import FATE_UNKNOWN
from caris_desktop.robot.profile_model import RobotProfile, SpeechInterface, SpeechService, SpeechWeb
from caris_desktop.robot.speaking_time import estimated_duration_s
from tests.robot.loop_bench import Bridge, LoopBench, with_link

SERVICE = SpeechService("/say", "my_msgs/Say", {"sentence": {"text": "$value"}})


def robot(**speech: Any) -> RobotProfile:
    return RobotProfile("test", "Test", speech=SpeechInterface(**speech))


def told(bench: LoopBench) -> list[tuple[str, str, bool]]:
    return [(event.utterance_id, event.state, event.estimated) for event in bench.of(UtteranceChanged)]


@pytest.fixture(autouse=True)
def _short_sentences(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_speech, "estimated_duration_s", lambda *_: 0.02)


@pytest.mark.parametrize("answers_at_end", [True, False])
def test_a_service_says_one_sentence_after_the_other(*, answers_at_end: bool) -> None:
    asked: list[Any] = []

    def answer(request: dict[str, Any]) -> dict[str, Any]:
        asked.append(request)
        return {"success": len(asked) != 2, "message": "too loud"}

    async def test(bench: LoopBench) -> None:
        bench.send(*(Say(now_ns(), f"u{number}", f"Number {number}") for number in (1, 2, 3)))
        await bench.until(lambda: told(bench)[-1:] and told(bench)[-1][:2] == ("u3", "finished"), "all of it")
        assert asked == [{"sentence": {"text": f"Number {number}"}} for number in (1, 2, 3)]
        end = not answers_at_end
        second = [("u2", "started", True)] * answers_at_end + [("u2", "failed", False)]
        assert told(bench) == [
            ("u1", "started", True), ("u1", "finished", end), *second, ("u3", "started", True), ("u3", "finished", end)
        ]  # fmt: skip
        assert "too loud" in [event.detail for event in bench.of(UtteranceChanged)]

    def prepare(bridge: Bridge) -> None:
        bridge.answers["/say"] = answer

    with_link(robot(service=replace(SERVICE, answers_at_end=answers_at_end)), test, prepare=prepare)


def test_by_its_speaking_topic_the_times_are_the_robots_own(monkeypatch: pytest.MonkeyPatch) -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "Hello"))
        await bench.until(lambda: bench.bridge.operations("call_service", "/say"), "it is asked")
        for speaking in (True, False):
            await bench.bridge.publish("/speaking", {"data": speaking})
        await bench.until(lambda: told(bench) == [("u1", "started", False), ("u1", "finished", False)], "its times")
        monkeypatch.setattr(robot_speech, "STARTS_WITHIN_S", 0.05)
        bench.send(Say(now_ns(), "u2", "Hello"))
        await bench.until(lambda: told(bench)[2:] == [("u2", "failed", False)], "what it does not begin has failed")

    def prepare(bridge: Bridge) -> None:
        bridge.answers["/say"] = {"success": True}

    with_link(robot(service=SERVICE, speaking="/speaking"), test, prepare=prepare)


@pytest.mark.parametrize("answers_at_end", [True, False])
@pytest.mark.parametrize("told_again", [True, False])
def test_a_link_that_is_lost_in_mid_sentence_does_not_hold_the_voice(
    monkeypatch: pytest.MonkeyPatch, *, answers_at_end: bool, told_again: bool
) -> None:
    # Long enough for a reconnect where the robot reports the end, short otherwise.
    monkeypatch.setattr(robot_speech, "FATE_WITHIN_S", 20.0 if told_again else 0.05)

    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "A long story"))
        await bench.until(lambda: bench.bridge.operations("call_service", "/say"), "it is asked")
        await bench.bridge.publish("/speaking", {"data": True})
        await bench.until(lambda: told(bench), "it speaks")
        bench.bridge.lines.clear()
        await bench.bridge.drop()
        if told_again:
            await bench.until(lambda: bench.bridge.operations("subscribe", "/speaking"), "the link is back")
            await bench.bridge.publish("/speaking", {"data": False})
        end = "finished" if told_again else "failed"
        await bench.until(lambda: told(bench)[1:] == [("u1", end, False)], "its end is told")
        assert told_again or bench.of(UtteranceChanged)[-1].detail == FATE_UNKNOWN
        await bench.until(lambda: bench.state == "connected", "the link is back")
        bench.send(Say(now_ns(), "u2", "Hello again"))
        await bench.until(lambda: bench.bridge.operations("call_service", "/say"), "the next is asked for")

    def prepare(bridge: Bridge) -> None:
        bridge.answers["/say"] = (lambda _: None) if answers_at_end else {"success": True}

    service = replace(SERVICE, answers_at_end=answers_at_end)
    with_link(robot(service=service, speaking="/speaking"), test, prepare=prepare)


@pytest.mark.parametrize("stop", [None, "/hush"])
def test_silence_is_not_refused_while_the_link_is_lost(stop: str | None) -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "A long story"))
        await bench.until(lambda: bench.bridge.operations("call_service", "/say"), "it is asked")
        await bench.bridge.publish("/speaking", {"data": True})
        await bench.until(lambda: told(bench), "it speaks")
        await bench.bridge.close()
        await bench.until(lambda: bench.state == "lost", "the link is lost")
        bench.send(Silence(now_ns(), "wizard:b"))
        await bench.until(lambda: told(bench)[1:] == [("u1", "failed", False)], "it is given up at once")
        assert bench.of(UtteranceChanged)[-1].detail == FATE_UNKNOWN
        await bench.bridge.open()
        await bench.until(lambda: bench.state == "connected", "the link is back")
        if stop is not None:
            await bench.until(lambda: bench.bridge.operations("call_service", stop), "the robot is told to be quiet")
        assert not [problem for problem in bench.of(Problem) if "interrupted" in problem.what]

    def prepare(bridge: Bridge) -> None:
        bridge.answers |= {"/say": {"success": True}, "/hush": {"success": True}}

    with_link(robot(service=replace(SERVICE, stop=stop), speaking="/speaking"), test, prepare=prepare)


@pytest.mark.parametrize("speech", [{"topic": "/say"}, {"service": SERVICE}])
@pytest.mark.parametrize("begins_again", [True, False])
def test_a_robot_that_speaks_already_has_not_failed(
    monkeypatch: pytest.MonkeyPatch, *, speech: dict[str, Any], begins_again: bool
) -> None:
    monkeypatch.setattr(robot_speech, "STARTS_WITHIN_S", 0.05)
    monkeypatch.setattr(robot_speech, "STARTED_UNTOLD_S", 20.0 if begins_again else 0.05)

    async def test(bench: LoopBench) -> None:
        await bench.until(lambda: bench.bridge.operations("subscribe", "/speaking"), "it listens")
        await bench.bridge.publish("/speaking", {"data": True})
        await bench.bridge.publish("/says", {"data": "My own words"})
        await bench.until(lambda: bench.of(UtteranceChanged), "the robot speaks by itself")
        bench.send(Say(now_ns(), "u1", "Hello"))

        def mine() -> list[tuple[str, str, bool]]:
            return [one for one in told(bench) if one[0] == "u1"]

        await bench.until(lambda: mine() == [("u1", "started", True)], "it is said in the same breath, or behind it")
        for speaking in (False, True, False) if begins_again else (False,):
            await bench.bridge.publish("/speaking", {"data": speaking})
        await bench.until(lambda: mine()[1:] == [("u1", "finished", not begins_again)], "and ends with it")

    def prepare(bridge: Bridge) -> None:
        bridge.answers["/say"] = {"success": True}

    with_link(robot(speaking="/speaking", says="/says", **speech), test, prepare=prepare)


def test_a_service_is_silenced_where_it_can_be() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "A long story"), Say(now_ns(), "u2", "and another"))
        await bench.until(lambda: bench.bridge.operations("call_service", "/say"), "it is asked")
        bench.send(Silence(now_ns(), "wizard:b"))
        await bench.until(lambda: bench.bridge.operations("call_service", "/hush"), "and told to be quiet")
        ends = [(event.utterance_id, event.state, event.actor) for event in bench.of(UtteranceChanged)]
        assert [end for end in ends if end[1] != "started"] == [
            ("u1", "interrupted", "wizard:b"),
            ("u2", "interrupted", "wizard:b"),
        ]
        assert bench.of(Problem) == []

    def prepare(bridge: Bridge) -> None:
        bridge.answers |= {"/say": lambda _: None, "/hush": {"success": True}}

    with_link(robot(service=replace(SERVICE, answers_at_end=True, stop="/hush")), test, prepare=prepare)


def test_a_service_that_cannot_be_silenced_says_so() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "Hello"))
        await bench.until(lambda: bench.bridge.operations("call_service", "/say"), "it is asked")
        bench.send(Silence(now_ns()))
        await bench.until(lambda: bench.of(Problem), "the wizard is told")
        assert "cannot be interrupted" in bench.of(Problem)[0].what

    def prepare(bridge: Bridge) -> None:
        bridge.answers["/say"] = lambda _: None

    with_link(robot(service=SERVICE), test, prepare=prepare)


class Web:
    """HTTP server of a robot: records requests and answers with ``status``, or not at all if that is 0."""

    def __init__(self, status: int = 200) -> None:
        self.asked: list[tuple[str, str, Any]] = []
        self.status = status
        self.gone = asyncio.Event()

    async def serve(self, test: Callable[[str], Awaitable[None]]) -> None:
        server = await asyncio.start_server(self._answer, "127.0.0.1", 0)
        async with server:
            await test(f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}")
            self.gone.set()

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = (await reader.readuntil(b"\r\n\r\n")).decode()
        method, path, _ = head.split(" ", 2)
        lengths = [int(line.split(":")[1]) for line in head.lower().splitlines() if line.startswith("content-length")]
        body = await reader.readexactly(lengths[0]) if lengths else b""
        self.asked.append((method, path, json.loads(body) if body else None))
        if not self.status:
            await self.gone.wait()
        moved = "Location: http://127.0.0.1:9/\r\n" if self.status == 302 else ""
        writer.write(f"HTTP/1.1 {self.status} Well\r\n{moved}Content-Length: 0\r\nConnection: close\r\n\r\n".encode())
        writer.close()


def with_web(
    web: Web,
    test: Callable[[robot_speech.RequestSpeech, list[UtteranceChanged], str], Awaitable[None]],
    **told: Any,
) -> None:
    """HTTP speech, which needs no link."""

    async def run(address: str) -> None:
        spoken = SpeechWeb(
            **{key: value.replace("ROBOT", address) if isinstance(value, str) else value for key, value in told.items()}
        )
        events: list[UtteranceChanged] = []
        speech = SpeechInterface(web=spoken)
        no_link: Any = None
        one = robot_speech.RequestSpeech(
            no_link,
            speech,
            robot_speech.WebSpeaker(spoken),
            answers_at_end=spoken.answers_at_end,
            emit=events.append,
        )
        try:
            await test(one, events, address)
        finally:
            await one.close()

    asyncio.run(web.serve(run))


async def until(observe: Callable[[], Any]) -> None:
    async with asyncio.timeout(20.0):
        while not observe():  # noqa: ASYNC110 - changed by other tasks of this loop
            await asyncio.sleep(0.002)


def test_over_http_the_text_goes_into_the_body_or_into_the_address() -> None:
    web = Web()

    async def test(one: robot_speech.RequestSpeech, events: list[UtteranceChanged], _: str) -> None:
        one.say(Say(now_ns(), "u1", 'Say "hi" & $value', recorded="Say"))
        await until(lambda: [event.state for event in events] == ["started", "finished"])
        assert {event.text for event in events} == {"Say"}
        assert all(event.estimated for event in events)

    with_web(web, test, url="ROBOT/speak", body={"text": "$value", "volume": 3})
    assert web.asked == [("POST", "/speak", {"text": 'Say "hi" & $value', "volume": 3})]
    web.asked.clear()
    with_web(web, test, url="ROBOT/speak?text=$value")
    assert web.asked == [("GET", "/speak?text=Say%20%22hi%22%20%26%20%24value", None)]


@pytest.mark.parametrize(
    ("status", "detail"), [(500, "responded with 500"), (302, "responded with 302"), (0, "does not respond")]
)
def test_over_http_a_failure_is_reported_and_the_next_sentence_is_spoken(
    status: int, detail: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robot_speech, "SPEECH_ANSWERS_WITHIN_S", 0.2)
    web = Web(status)

    async def test(one: robot_speech.RequestSpeech, events: list[UtteranceChanged], _: str) -> None:
        one.say(Say(now_ns(), "u1", "Hello"))
        await until(lambda: events)
        assert (events[0].state, detail in events[0].detail) == ("failed", True), events
        web.status = 200
        one.say(Say(now_ns(), "u2", "Hello"))
        await until(lambda: [event.state for event in events[1:]] == ["started", "finished"])

    with_web(web, test, url="ROBOT/speak", body={"text": "$value"})


def test_over_http_nobody_there_is_reported_and_silence_is_requested(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_speech, "estimated_duration_s", lambda *_: 60.0)
    web = Web()

    async def test(one: robot_speech.RequestSpeech, events: list[UtteranceChanged], _: str) -> None:
        one.say(Say(now_ns(), "u1", "Hello"))
        await until(lambda: [event.state for event in events] == ["started"])
        assert one.silence("wizard:b")
        await until(lambda: len(web.asked) == 2)
        assert [(event.state, event.actor) for event in events[1:]] == [("interrupted", "wizard:b")]

    with_web(web, test, url="ROBOT/speak", body={"text": "$value"}, stop="ROBOT/hush")
    assert web.asked[1] == ("POST", "/hush", None)

    async def nobody(one: robot_speech.RequestSpeech, events: list[UtteranceChanged], _: str) -> None:
        one.say(Say(now_ns(), "u1", "Hello"))
        await until(lambda: events)
        assert "cannot be reached" in events[0].detail

    with_web(web, nobody, url="http://127.0.0.1:9/", body={"text": "$value"})


def test_unprompted_speech_is_distinguished_from_requested_speech() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(Say(now_ns(), "u1", "Hello Ada, follow me please!", "wizard:a", recorded="Hello {p-1}"))
        await bench.bridge.publish("/says", {"data": "hello ada follow me please"})
        await bench.bridge.publish("/says", {"data": "follow me"})
        await bench.bridge.publish("/says", {"data": " My battery\nis low. "})
        await bench.bridge.publish("/says", {"data": ""})
        await bench.until(
            lambda: "finished" in [event.state for event in bench.of(UtteranceChanged) if not event.actor], "it"
        )
        own = [event for event in bench.of(UtteranceChanged) if event.utterance_id != "u1"]
        assert [
            (event.text, event.state, event.speaker, event.origin, event.actor, event.estimated) for event in own
        ] == [("My battery is low.", state, "robot", "heard", "", True) for state in ("started", "finished")]

    with_link(robot(topic="/say", says="/says"), test)


def test_an_estimate_knows_that_some_scripts_say_more_with_a_character() -> None:
    assert estimated_duration_s("你好，欢迎光临", "zh-CN") > 2 * estimated_duration_s("Hello..", "en") - 0.4
    assert estimated_duration_s("a" * 150) == pytest.approx(10.4)
