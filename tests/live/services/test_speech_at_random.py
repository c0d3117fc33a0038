"""Utterances that are queued, cancelled, interrupted and killed at random, with the real speech processes.

Invariants: nothing hangs, every utterance ends exactly once, no two overlap, no process remains.
"""

import itertools
import random
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.app import process_entry_points
from caris_desktop.conversation.synthesis_messages import SynthesisSettings
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.domain.link_commands import RobotCommand
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import ROBOT_VOICE
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.service import ProcessManager, Restarts
from caris_desktop.live.services.speech_service import SpeechService
from caris_desktop.live.state import LiveState
from tests.conversation.sound_server import SoundServer, require_pulseaudio
from tests.support.polling import wait_for
from tests.support.service_context import context_of

ENDS = ("finished", "interrupted", "failed")
SENTENCES = ("Yes.", "No.", "Please follow me.", "Stop here!", "One, two, three, four, five, six.", "Hm.")
WITHIN_MS = 60_000


class Bench:
    """The speech service with speech of this computer, and all its reports."""

    def __init__(self) -> None:
        self.owner = QObject()
        self.state = LiveState(self.owner)
        self.bus = Bus(self.state, self.owner)
        self.told: list[Any] = []
        self.bus.tap(lambda value, _raw: self.told.append(value))
        self.children = ProcessManager(self.bus, self.owner)
        body = ProcessSpec("speech", process_entry_points.speech)
        context = context_of(self.state, self.bus, self.owner, children=self.children)
        self.service = SpeechService(context, body, robot=self)
        self.service._process.restarts = Restarts(at_most=1000)
        self.bus.follow(self.service.follows())
        self.service._use("computer", SynthesisSettings(rate=2.0))
        self.service.start()
        self.processes: set[psutil.Process] = set()

    def send(self, _: RobotCommand) -> bool:
        return False

    def engines(self) -> list[psutil.Process]:
        child = self.service.processes().get("speech")
        if child is None or child.pid is None:
            return []
        try:
            process = psutil.Process(child.pid)
            found = process.children()
        except psutil.Error:
            return []
        self.processes |= {process, *found}
        return found

    @property
    def utterances(self) -> list[UtteranceChanged]:
        return [event for event in self.told if isinstance(event, UtteranceChanged)]

    def kill(self, process: psutil.Process) -> None:
        if process.is_running():
            process.kill()

    def close(self) -> None:
        self.children.close()
        self.service.stop()
        self.service.end()
        self.bus.end()
        self.state.close()


@pytest.fixture
def bench(qapp: QApplication, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    require_pulseaudio()
    sound = SoundServer(tmp_path / "server")
    monkeypatch.setenv("PULSE_SERVER", sound.address)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    bench = Bench()
    yield bench
    bench.close()
    sound.kill()
    wait_for(lambda: not any(map(lives, bench.processes)), "every process has ended")
    wait_for(lambda: not list(tmp_path.glob("caris-voice-*")), "no sound file is left behind")
    assert len(bench.processes) > 1


def lives(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def act(bench: Bench, choices: random.Random) -> int:
    """A random action of the wizard or a fault; returns the number of added utterances."""
    bench.engines()
    waiting = bench.state.speech.value.waiting
    match choices.choices(
        ["say", "cancel", "edit", "silence", "kill engine", "kill voice", "voice"], [60, 8, 6, 14, 2, 1, 1]
    )[0]:
        case "say":
            count = choices.randint(1, 3)
            for _ in range(count):
                bench.service.queue.say(choices.choice(SENTENCES), "typed", "wizard:a")
            return count
        case "cancel" if waiting:
            bench.service.queue.cancel(choices.choice(waiting).utterance_id)
        case "edit" if waiting:
            bench.service.queue.edit(choices.choice(waiting).utterance_id, choices.choice(SENTENCES))
        case "silence":
            bench.service.queue.silence("wizard:b")
        case "kill engine":
            for engine in bench.engines():
                bench.kill(engine)
        case "kill voice":
            child = bench.service.processes().get("speech")
            if child is not None and child.pid is not None:
                bench.kill(psutil.Process(child.pid))
        case "voice":
            bench.service._use("computer", SynthesisSettings(rate=choices.choice([1.8, 2.0])))
    return 0


@pytest.mark.logs(r"live\.(bus|child_process): ")
@pytest.mark.parametrize("sentences", [10, pytest.param(500, marks=pytest.mark.long)])
def test_each_has_one_end_and_nothing_hangs_overlaps_or_is_left(bench: Bench, qtbot: QtBot, sentences: int) -> None:
    choices = random.Random(sentences)  # noqa: S311 - a test, not cryptography
    qtbot.waitUntil(lambda: bench.state.speech.value.ready, timeout=WITHIN_MS)
    since, said_count = len(bench.told), 0
    while said_count < sentences:
        said_count += act(bench, choices)
        qtbot.wait(choices.choice([1, 20, 100, 400]))
    for engine in bench.engines():
        bench.kill(engine)
    qtbot.waitUntil(
        lambda: bench.state.speech.value.now is None and not bench.state.speech.value.waiting, timeout=WITHIN_MS
    )
    told = bench.told[since:]
    ends = Counter(event.utterance_id for event in told if isinstance(event, UtteranceChanged) and event.state in ENDS)
    asked = {event.utterance_id for event in told if isinstance(event, UtteranceChanged) and event.state == "requested"}
    assert len(asked) == said_count
    assert set(ends) == asked and set(ends.values()) == {1}, "each has one end"
    assert_nothing_overlaps(told)
    bench.service.queue.say("Yes.", "typed")
    qtbot.waitUntil(lambda: bench.utterances[-1].state == "finished", timeout=WITHIN_MS)


def assert_nothing_overlaps(told: list[Any]) -> None:
    starts: dict[str, int] = {}
    spoken: list[tuple[int, int]] = []
    for event in told:
        if isinstance(event, UtteranceChanged) and event.state == "started":
            starts[event.utterance_id] = event.stamp_ns
        elif isinstance(event, UtteranceChanged) and event.state in ENDS and event.utterance_id in starts:
            spoken.append((starts[event.utterance_id], event.stamp_ns))
    spoken.sort()
    assert all(end <= start for (_, end), (start, _) in itertools.pairwise(spoken)), "one after the other"
    chunks = [value for value in told if isinstance(value, AudioChunk) and value.source == ROBOT_VOICE]
    pieces = sorted(
        (piece.stamp_ns, piece.stamp_ns + len(piece.samples) * 10**9 // piece.sample_rate_hz) for piece in chunks
    )
    assert pieces, "something was heard"
    assert all(end <= start + 1_000_000 for (_, end), (start, _) in itertools.pairwise(pieces))
