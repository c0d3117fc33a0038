"""The scripted wizard plays the shipped scenarios in the real console; other programs look at what it leaves."""

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from argparse import Namespace
from collections import Counter
from pathlib import Path
from typing import Any

import av
import pytest
from mcap.reader import make_reader
from PySide6.QtCore import QSettings
from pytestqt.qtbot import QtBot

from caris_desktop.app.replay_command import ReplayRun
from caris_desktop.domain.streams import BY_NAME
from caris_desktop.live.state import LOST_AFTER_S, LiveState
from tests.app.shown_state import shown_state


def _rehearse(scenario: str, out: Path, *, tracer: tuple[str, ...] = ()) -> Path:
    """Play it, watched by ``tracer`` if any, and give the session folder."""
    program = (*tracer, sys.executable, "-m", "tests.support.late_main", "tests.app.watched_rehearsal")
    done = subprocess.run(
        [*program, out.with_suffix(".samples"), scenario, "--out", out],
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stderr + (out / "console.log").read_text("utf-8")
    (session,) = (out / "study" / "sessions").iterdir()
    return session


def _messages(session: Path) -> dict[str, list[dict[str, Any]]]:
    messages: dict[str, list[dict[str, Any]]] = {}
    with (session / "events.mcap").open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None and json.loads(schema.data)["type"] == "object"
            messages.setdefault(channel.topic, []).append(json.loads(message.data))
    return messages


@pytest.fixture(scope="module")
def tour(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The session of one rehearsal of the tour guide, in its study, for several tests to look at."""
    out = tmp_path_factory.mktemp("tour") / "out"
    return _rehearse("tour-guide", out, tracer=_network_tracer(out.with_suffix(".trace")))


@pytest.mark.timeout(300)
def test_the_tour_leaves_a_whole_session(tour: Path) -> None:
    session, out = tour, tour.parents[2]
    messages = _messages(session)
    for topic in ("/scan", "/pose", "/odometry", "/map", "/people", "/battery"):
        assert len(messages[topic]) > 3, topic
    driven = [message["twist"]["forward_mps"] for message in messages["/event/command_sent"]]
    assert max(driven) > 0.1 and driven[-1] == 0
    assert any(message["boxes"] for message in messages["/people"])
    said = Counter(message["origin"] for message in messages["/event/utterance_changed"])
    assert {"phrase", "typed", "assistant"} <= set(said)
    (exchange,) = messages["/event/llm_exchange"]
    assert exchange["outcome"] == "answered" and exchange["answer"]
    goals = [message["state"] for message in messages["/event/goal_changed"]]
    assert "active" in goals and goals[-1] in ("cancelled", "reached")
    assert messages["/event/photo_taken"] and messages["/event/marked"] and messages["/event/stop_requested"]
    header = json.loads((session / "session.json").read_text("utf-8"))
    assert header["trial"]["participant"] == "P07" and header["reason"] == "wizard"

    (video,) = session.glob("video-*.mp4")
    with av.open(str(video)) as container:
        frames = list(container.decode(video=0))
    assert len(frames) > 100
    assert all(frame.to_ndarray(format="bgr24").std() > 10 for frame in frames[::30]), "pictures, not plain colour"

    with (session / "export-csv" / "event_command_sent.csv").open(newline="", encoding="utf-8") as table:
        assert len(list(csv.DictReader(table))) == len(driven)
    assert len(list((out / "screenshots").glob("*.png"))) >= 6


def _network_tracer(trace: Path) -> tuple[str, ...]:
    """A command that writes down whom a program and its children call; empty where that is not possible."""
    calls = "connect,sendto,sendmsg,sendmmsg"
    if shutil.which("strace") is None:
        return ()
    tracer = ("strace", "-f", "--seccomp-bpf", "-e", f"trace={calls}", "-e", "signal=none", "-s", "0", "-o")
    probe = subprocess.run([*tracer, os.devnull, "true"], capture_output=True, check=False)
    return () if probe.returncode else (*tracer, str(trace))


_ADDRESS = re.compile(r'inet_addr\("([^"]+)"\)|inet_pton\(AF_INET6, "([^"]+)"')


@pytest.mark.timeout(300)
def test_a_whole_session_calls_nobody_outside(tour: Path) -> None:
    """Robot, language model and voice of the rehearsal are on this computer, so nothing else may be called."""
    trace = tour.parents[2].with_suffix(".trace")
    if not trace.is_file():
        pytest.skip("needs strace, and the permission to use it, to see whom the console calls")
    called = {ipv4 or ipv6 for ipv4, ipv6 in _ADDRESS.findall(trace.read_text("utf-8", "replace"))}
    assert called, "the robot at least is called"
    assert {address for address in called if not re.fullmatch(r"127\..*|::1|::ffff:127\..*", address)} == set()


@pytest.mark.timeout(300)
def test_a_replay_shows_what_the_panels_showed(tour: Path, qtbot: QtBot, tmp_path: Path) -> None:
    lines = tour.parents[2].with_suffix(".samples").read_text("utf-8").splitlines()
    samples = [json.loads(line) for line in lines]
    assert len(samples) > 20
    settings = QSettings(str(tmp_path / "settings.ini"), QSettings.Format.IniFormat)
    replay = ReplayRun(Namespace(session=tour, at=None, at_ns=None, theme="dark"), settings=settings)
    qtbot.addWidget(replay.window)
    console = replay.console
    console.start()
    started_ns = json.loads((tour / "session.json").read_text("utf-8"))["started_ns"]

    def shown_at(at_ns: int) -> dict[str, Any]:
        console.seek(at_ns)
        qtbot.waitUntil(lambda: console.settled, timeout=10_000)
        return shown_state(console.state)

    try:
        differences = []
        for sample in samples[:: max(1, len(samples) // 12)]:
            now, before = shown_at(sample["at_ns"]), shown_at(sample["at_ns"] - _ON_ITS_WAY_NS)
            live = sample["shown"]
            for name, (stamp_ns, freshness) in live["streams"].items():
                if name == "frame":
                    continue  # decoded in its own time; compared below
                if stamp_ns is not None and stamp_ns < started_ns:
                    continue  # on show since before the recording, where the next one is long in coming
                bounds = before["streams"][name][0], now["streams"][name][0]
                # One that waits for its turn is looked for once a second.
                every_ns = round(2.5 * BY_NAME[name].record_every_s * 1e9)
                if stamp_ns not in bounds and not _within(stamp_ns, *bounds, spare_ns=every_ns):
                    differences.append((sample["at_ns"], name, stamp_ns, bounds))
                # Of the same value, where it is not about to be called something else: that is looked at now and then.
                settled = not _about_to_age(name, sample["at_ns"] - (stamp_ns or 0))
                now_ns, now_called = now["streams"][name]
                if settled and stamp_ns == now_ns and freshness != now_called:
                    differences.append((sample["at_ns"], name, freshness, now_called))
            differences += [
                (sample["at_ns"], name, value, now["status"][name])
                for name, value in live["status"].items()
                if value != now["status"][name]
            ]
            assert (live["robot"], live["scenario"]) == (now["robot"], now["scenario"])
        assert differences == []
        at_ns = samples[len(samples) // 2]["at_ns"]
        live_ns = samples[len(samples) // 2]["shown"]["streams"]["frame"][0]
        shown_at(at_ns)
        qtbot.waitUntil(lambda: _frame_within(console.state, live_ns, at_ns), timeout=5_000)
    finally:
        replay.close()


# What arrives is recorded at once and shown as soon as the window has time for it.
_ON_ITS_WAY_NS = 250_000_000
_AGES_WITHIN_S = 0.5


def _about_to_age(name: str, age_ns: int) -> bool:
    moments_s = (BY_NAME[name].stale_after_s or 0.0, LOST_AFTER_S)
    return any(abs(age_ns / 1e9 - moment_s) < _AGES_WITHIN_S for moment_s in moments_s)


def _within(stamp_ns: int | None, earliest_ns: int | None, latest_ns: int | None, *, spare_ns: int) -> bool:
    """``spare_ns``: how long a new value may wait for its turn to be recorded."""
    if stamp_ns is None or latest_ns is None:
        return False
    return (earliest_ns or 0) <= stamp_ns <= latest_ns + spare_ns


def _frame_within(state: LiveState, live_ns: int, at_ns: int) -> bool:
    return state.frame.value is not None and live_ns <= state.frame.value.stamp_ns <= at_ns


@pytest.mark.timeout(300)
def test_the_mental_health_check_films_nobody_recognisably(tmp_path: Path) -> None:
    session = _rehearse("mental-health-check", tmp_path)
    messages = _messages(session)
    assert messages["/event/llm_exchange"] and messages["/people"]
    assert "/event/photo_taken" not in messages and not list(session.rglob("*.png"))

    frames: dict[int, Any] = {}
    for video in session.glob("video-*.mp4"):
        with video.with_suffix(".frames.csv").open(newline="", encoding="utf-8") as lines, av.open(str(video)) as film:
            stamps_ns = [int(line["stamp_ns"]) for line in csv.DictReader(lines)]
            frames |= zip(stamps_ns, (each.to_ndarray(format="bgr24") for each in film.decode(video=0)), strict=False)
    assert len(frames) > 100
    flat = [
        _flat_share(frames[people["stamp_ns"]], box)
        for people in messages["/people"]
        for box in people["boxes"]
        if people["stamp_ns"] in frames and box["width_px"] > 20
    ]
    assert len(flat) > 20 and min(flat) > 0.85, "people are seen as flat blocks only"


def _flat_share(image_bgr: Any, box: dict[str, float]) -> float:
    """How much of what is in the box is the same as what is left of it. In unblurred video of the same people 0.6."""
    left, top = max(0, round(box["left_px"])), max(0, round(box["top_px"]))
    right, bottom = round(box["left_px"] + box["width_px"]), round(box["top_px"] + box["height_px"])
    part = image_bgr[top:bottom, left:right].astype(int).sum(axis=2)
    return float((abs(part[:, 1:] - part[:, :-1]) <= 9).mean())
