"""Typing, driving and speaking with real keys in a real window during faults of a language model server.

The results are counted in keys, positions and events.
"""

import asyncio
import contextlib
import json
import ssl
import subprocess
from collections.abc import Iterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.background_worker import AsyncioThread
from tests.app.test_misbehaving_model import WAYS
from tests.conversation.models.served import Served, sends, serving
from tests.support.certificates import Authority
from tests.support.console_process import without_models
from tests.support.polling import wait_for
from tests.support.simulated_robot import RosbridgeClient, SimulatedRobot
from tests.support.virtual_desktop import MISSING_TOOLS, VirtualDesktop

pytestmark = [
    pytest.mark.alone,
    pytest.mark.skipif(bool(MISSING_TOOLS), reason=f"needs {', '.join(MISSING_TOOLS)}"),
]

LINE = "We saw a wasp: was it sad?"
DRAFT = "Ask Zack, as always; 2 wads wait"
_TURNS_AT_LEAST = 20
_FAILURES_AT_LEAST = 2
_TRIES = 4


class Servers:
    """A server that behaves as the last word of the question says, and one with an untrusted certificate."""

    def __init__(self, folder: Path) -> None:
        self._thread = AsyncioThread()
        self._stack = AsyncExitStack()
        self.plain, self.secured = self._thread.submit(self._start(folder)).result(10.0)

    async def _start(self, folder: Path) -> tuple[Served, Served]:
        async def misbehave(writer: asyncio.StreamWriter) -> None:
            if plain.heads[-1].startswith("GET"):
                await sends(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n")(writer)
                return
            messages: Any = plain.bodies[-1]["messages"]
            answer, _, _ = WAYS[messages[-1]["content"].rpartition(" ")[2]]
            await answer(writer)

        plain = await self._stack.enter_async_context(serving(misbehave))
        files = Authority(folder).issue("127.0.0.1")
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        context.load_cert_chain(files.certificate, files.key)
        secured = await self._stack.enter_async_context(serving(sends(then_waits=True), tls=context))
        return plain, secured

    def close(self) -> None:
        self._thread.submit(self._stack.aclose()).result(10.0)
        self._thread.stop()


class Desk:
    """Console on its screen, robot, and input of the wizard."""

    def __init__(self, robot: SimulatedRobot, desktop: VirtualDesktop) -> None:
        self.desktop = desktop
        self._odometry = RosbridgeClient(robot.address)
        self._odometry.subscribe("/odom")

    def close(self) -> None:
        self._odometry.close()

    def shown(self) -> dict[str, Any]:
        """Last displayed state."""
        for line in reversed(self.desktop.lines()):
            # The last line may be incomplete.
            with contextlib.suppress(json.JSONDecodeError):
                if line.startswith("{"):
                    return dict(json.loads(line))
        return {}

    def turns(self) -> list[float]:
        """Turn rates of the robot so far, rad/s."""
        return [
            item["msg"]["twist"]["twist"]["angular"]["z"]
            for item in list(self._odometry.received)
            if isinstance(item, dict) and "msg" in item
        ]

    def type(self, text: str) -> None:
        seen = len(self.desktop.lines())
        subprocess.run(["xdotool", "type", "--delay", "35", text], env=self.desktop.environment, check=True, timeout=60)
        self.desktop.wait_for(f"TEXT {text}", after=seen)

    def field(self) -> str:
        return next(line for line in reversed(self.desktop.lines()) if line.startswith("TEXT"))[5:]

    def wait(self, seen: Any, what: str) -> None:
        try:
            wait_for(seen, what, timeout_s=40.0)
        except AssertionError as error:
            raise AssertionError(f"{error}; last: {self.shown()}") from error


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Desk]:
    folder = tmp_path_factory.mktemp("desk")
    scenario = without_models(layouts_dir() / "tour-guide.yaml", folder)
    text = scenario.read_text("utf-8").replace("\n  assistant: false\n", "\n  assistant: true\n")
    assert text.count("\n  model: embedded\n") == 1
    models = "\n  model: openai:unsteady\n  models: [ollama:unproven]\n"
    text = text.replace("\n  model: embedded\n", models)
    assert text.count("current: people\n") == 1
    scenario.write_text(text.replace("current: people\n", "current: assistant\n"), "utf-8")
    servers = Servers(folder)
    addresses = {
        "OPENAI_BASE_URL": f"{servers.plain.url}/v1",
        "OPENAI_API_KEY": "sk-test",
        "OLLAMA_HOST": servers.secured.url,
    }
    with SimulatedRobot("--empty") as robot:
        desktop = VirtualDesktop(
            folder, "tests.app.asking_child", robot.address, str(folder / "study"), str(scenario),
            size="1920x1080", environment=addresses,
        )  # fmt: skip
        desk = None
        try:
            desktop.wait_for("{", timeout_s=90)
            desk = Desk(robot, desktop)
            expected = {"link": "connected", "drive_allowed": True, "assistant": "ready"}
            wait_for(lambda: expected.items() <= desk.shown().items(), "the console is ready", timeout_s=90)
            desktop.do("key", "ctrl+l")
            desktop.wait_for("KEYS typing")
            yield desk
        finally:
            if desk is not None:
                desk.close()
            desktop.close()
            servers.close()


def _types_drives_and_speaks(desk: Desk) -> str:
    """Type, drive and speak while a drive key is held; returns the reason if the drive ended."""
    desktop = desk.desktop
    desktop.send_command("clear_field")
    before = desk.shown()

    def ended() -> list[str]:
        reasons: list[str] = desk.shown()["drive_ended"]
        return reasons[len(before["drive_ended"]) :]

    desktop.do("keydown", "KP_Left")
    try:
        begun = len(desk.turns())
        desk.wait(lambda: ended() or max(desk.turns()[begun:], default=0.0) > 0.1, "the robot turns")
        if ended():
            return "; ".join(ended())
        begun += next(at for at, turn in enumerate(desk.turns()[begun:]) if turn > 0.1)
        desk.type(LINE)
        desktop.do("key", "Return")
        desk.wait(lambda: not desk.field(), "the field is free for the next sentence")
        desk.type(DRAFT)
        desk.wait(lambda: len(desk.shown()["spoken"]) > len(before["spoken"]), "the sentence is spoken to its end")
        desk.wait(lambda: desk.shown()["failures"] >= before["failures"] + _FAILURES_AT_LEAST, "it has misbehaved")
        desk.wait(lambda: len(desk.turns()) >= begun + _TURNS_AT_LEAST, "the robot tells how it moves")
        turned = desk.turns()[begun:]
        ends = ended()
    finally:
        desktop.do("keyup", "KP_Left")
    assert desk.shown()["spoken"][len(before["spoken"]) :] == [LINE]
    if not ends and min(turned) < 0.05:
        ends = ["the robot stood still"]
    return "; ".join(ends)


_IN_EVERY_RUN = ("never", "tls")
"""For the others, test_misbehaving_model runs the whole console without a window manager."""


@pytest.mark.parametrize(
    "way", [pytest.param(way, marks=[] if way in _IN_EVERY_RUN else [pytest.mark.long]) for way in (*WAYS, "tls")]
)
@pytest.mark.long("never")
def test_next_to_it_every_key_arrives_the_robot_moves_on_and_speaks(desk: Desk, way: str) -> None:
    model, expected = ("ollama:unproven", "is not trusted")
    if way in WAYS:
        model, expected = "openai:unsteady", WAYS[way][1]
    desk.desktop.send_command(f"choose {model}")
    desk.wait(lambda: desk.shown()["model"] == model.partition(":")[2], "the model is chosen")
    failures = desk.shown()["failures"]
    desk.desktop.send_command(f"ask_on What of {way}")
    desk.wait(lambda: desk.shown()["asking"] or desk.shown()["failures"] > failures, "the question is asked")
    # A machine too busy for the motion lease also ends a drive; an effect of the server would end every one.
    ends: list[str] = []
    while (end := _types_drives_and_speaks(desk)) and len(ends) < _TRIES:
        ends.append(end)
    assert not end, f"none of {len(ends) + 1} drives lasted: {ends}, {end}"
    desk.desktop.send_command("ask_off")
    desk.wait(lambda: not desk.shown()["asking"], "the last question has ended")
    assert expected in desk.shown()["told"]
    assert desk.field() == DRAFT
