"""Scripted rehearsal of the shipped scenarios in the real console, with files checked by other programs."""

import csv
import json
import os
import re
import shutil
import statistics
import subprocess
import sys
from argparse import Namespace
from collections import Counter
from pathlib import Path
from typing import Any

import av
import jiwer
import pytest
from mcap.reader import make_reader
from PySide6.QtCore import QSettings
from pytestqt.qtbot import QtBot

from caris_desktop.app.rehearse_command import SAYS
from caris_desktop.app.replay_command import ReplayRun
from caris_desktop.domain.sensing import StatusShown
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.state import LiveState
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.session.session_reader import open_session
from tests.app.shown_state import differences, shown_state
from tests.app.test_calls_home import SWITCHES

# One without --long: the wizard answers the second by a phrase, and the third by typing.
SENTENCES = 3 if os.environ.get("CARIS_TEST_LONG") else 1


def _rehearse(scenario: str, out: Path, *, sentences: int = 3, seconds: int = 0, tracer: tuple[str, ...] = ()) -> Path:
    """Run for at least ``seconds`` under ``tracer``, and return the session folder.

    ``sentences`` is their number for the participant.
    """
    program = (*tracer, sys.executable, "-m", "tests.support.run_module", "tests.app.watched_rehearsal")
    # As from a terminal: the program itself must set the switches against telemetry.
    environment = {name: value for name, value in os.environ.items() if name not in SWITCHES}
    # A session bus that is started on demand never ends, and the tracer waits for it.
    environment.setdefault("DBUS_SESSION_BUS_ADDRESS", "disabled:")
    done = subprocess.run(
        [*program, out.with_suffix(".samples"), str(sentences), scenario, "--out", out, "--seconds", str(seconds)],
        capture_output=True,
        text=True,
        env=environment,
        timeout=280 + seconds,
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
    """Session of one rehearsal of the tour guide in its study, shared by several tests."""
    out = tmp_path_factory.mktemp("tour") / "out"
    return _rehearse("tour-guide", out, sentences=SENTENCES, tracer=_network_tracer(out.with_suffix(".trace")))


@pytest.mark.timeout(300)
def test_the_tour_leaves_a_whole_session(tour: Path) -> None:
    session, out = tour, tour.parents[2]
    messages = _messages(session)
    for topic in ("/scan", "/pose", "/odometry", "/map", "/people", "/battery"):
        assert len(messages[topic]) > 3, topic
    driven = [message["twist"]["forward_mps"] for message in messages["/event/command_sent"]]
    assert max(driven) > 0.1 and driven[-1] == 0
    assert any(message["boxes"] for message in messages["/people"])
    by_origin = Counter(message["origin"] for message in messages["/event/utterance_changed"])
    assert {"phrase", "typed", "assistant"} <= set(by_origin)
    (exchange,) = (each for each in messages["/event/llm_exchange"] if each["purpose"] == "question")
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

    with (out / "exports" / "csv" / "event_command_sent.csv").open(newline="", encoding="utf-8") as table:
        assert len(list(csv.DictReader(table))) == len(driven)
    assert len(list((out / "screenshots").glob("*.png"))) >= 6


MOST_ALARMS = 3
"""Limit for a session without faults; more alarms would be ignored."""


def _alarms(session: Path) -> list[str]:
    return [told["what"] for told in _messages(session).get("/event/alarm_changed", ()) if told["state"] == "raised"]


@pytest.mark.timeout(300)
def test_a_session_in_which_all_goes_well_raises_few_alarms(tour: Path) -> None:
    raised = _alarms(tour)
    assert len(raised) <= MOST_ALARMS, raised


@pytest.mark.long
@pytest.mark.timeout(400)
@pytest.mark.parametrize("scenario", ["blank", "reception", "practice", "nothing"])
def test_any_scenario_can_be_rehearsed_with_what_it_has(tmp_path: Path, scenario: str) -> None:
    """Without phrases, without the Assistant panel in the layout, or without permissions."""
    name = scenario
    if scenario == "nothing":
        text = (layouts_dir() / "blank.yaml").read_text("utf-8").replace(": true\n", ": false\n")
        (tmp_path / "nothing.yaml").write_text(text, "utf-8")
        name = str(tmp_path / "nothing.yaml")
    session = _rehearse(name, tmp_path / "out")
    spoken = "/event/utterance_changed" in _messages(session)
    assert spoken == (scenario != "nothing")


@pytest.mark.long
@pytest.mark.timeout(2400)
def test_half_an_hour_in_which_all_goes_well_raises_few_alarms(tmp_path: Path) -> None:
    session = _rehearse("tour-guide", tmp_path / "out", seconds=1800)
    raised = _alarms(session)
    assert len(raised) <= MOST_ALARMS, raised
    reader = open_session(session)
    assert reader.ended_ns - reader.started_ns > 1700e9


@pytest.mark.timeout(300)
def test_utterances_responses_and_suggestions_are_complete(tour: Path) -> None:
    _is_whole_conversation(tour, SAYS["tour-guide"][:SENTENCES])


def _is_whole_conversation(session: Path, said: tuple[str, ...]) -> None:
    messages = _messages(session)
    utterances = messages["/event/utterance_changed"]
    turns = [each for each in utterances if each["speaker"] == "participant" and each["state"] == "finished"]
    assert turns
    wrong = jiwer.wer(_plain(" ".join(said)), _plain(" ".join(each["text"] for each in turns)))
    assert wrong <= 0.3 or _tells_of_lost_sound(messages), turns
    began = {each["utterance_id"]: each for each in utterances if each["state"] == "started"}
    ended = Counter(
        each["utterance_id"] for each in utterances if each["state"] in ("finished", "interrupted", "failed")
    )
    assert set(began) <= set(ended) and set(ended.values()) == {1}, "each turn begins and ends once"
    replies = messages["/event/response_timed"]
    means = {reply["means"] for reply in replies}
    assert means and means <= {"typed", "phrase", "suggestion"}
    assert len(said) < 3 or {"typed", "phrase"} <= means
    for reply in replies:
        assert reply["voice_ended_ns"] < reply["asked_ns"] < reply["first_sound_ns"], "nobody was interrupted"
        assert reply["turn_id"] in began and reply["reply_id"] in began
    displayed = [each for each in messages.get("/event/suggestion_changed", ()) if each["state"] == "displayed"]
    fates = Counter(
        each["suggestion_id"] for each in messages.get("/event/suggestion_changed", ()) if each["state"] != "displayed"
    )
    assert fates == Counter(each["suggestion_id"] for each in displayed), "exactly one fate"
    texts = (session / "speech.txt").read_text("utf-8")
    assert all(f"participant: {each['text']}" in texts for each in turns)


def _tells_of_lost_sound(messages: dict[str, list[dict[str, Any]]]) -> bool:
    """True if the session reports lost speech, as on a computer too busy for real-time sound."""
    broke_off = any(each["cause"] == "missing sound" for each in messages.get("/event/problem", ()))
    return broke_off or any(each["stream"] == "transcription" for each in messages.get("/event/gap", ()))


def _plain(text: str) -> str:
    return " ".join(re.sub(r"[^a-z ]", " ", text.lower()).split())


def _network_tracer(trace: Path) -> tuple[str, ...]:
    """Command that logs connections of a program and its children; empty if that is not possible."""
    calls = "connect,sendto,sendmsg,sendmmsg"
    if shutil.which("strace") is None:
        return ()
    tracer = ("strace", "-f", "--seccomp-bpf", "-e", f"trace={calls}", "-e", "signal=none", "-s", "0", "-o")
    probe = subprocess.run([*tracer, os.devnull, "true"], capture_output=True, check=False)
    return () if probe.returncode else (*tracer, str(trace))


_NAME_LOOKUP = re.compile(r"port=htons\((?:53|853|5353)\)")
_ADDRESS = re.compile(r'inet_addr\("([^"]+)"\)|inet_pton\(AF_INET6, "([^"]+)"')


@pytest.mark.timeout(300)
def test_a_whole_session_calls_nobody_outside(tour: Path) -> None:
    """Robot, language model and speech of the rehearsal run on this computer."""
    trace = tour.parents[2].with_suffix(".trace")
    if not trace.is_file():
        pytest.skip("needs strace, and the permission to use it, to see whom the console calls")
    assert not _NAME_LOOKUP.search(trace.read_text("utf-8", "replace")), (
        "also a resolver on this computer is asked nothing"
    )
    called = {ipv4 or ipv6 for ipv4, ipv6 in _ADDRESS.findall(trace.read_text("utf-8", "replace"))}
    assert called, "the robot at least is called"
    assert {address for address in called if not re.fullmatch(r"127\..*|::1|::ffff:127\..*", address)} == set()


@pytest.mark.timeout(300)
def test_a_replay_shows_what_the_panels_showed(tour: Path, qtbot: QtBot, tmp_path: Path) -> None:
    lines = tour.parents[2].with_suffix(".samples").read_text("utf-8").splitlines()
    samples = [json.loads(line) for line in lines]
    assert len(samples) > 20
    frames_ns = [sample["shown"]["streams"]["frame"][0] for sample in samples]
    settings = QSettings(str(tmp_path / "settings.ini"), QSettings.Format.IniFormat)
    replay = ReplayRun(Namespace(session=tour, at=None, at_ns=None, theme="dark", language=None), settings=settings)
    qtbot.addWidget(replay.window)
    console = replay.console
    console.start()
    started_ns = json.loads((tour / "session.json").read_text("utf-8"))["started_ns"]

    def shown_at(at_ns: int) -> dict[str, Any]:
        # At its very start a replay shows values that arrived a moment later.
        console.seek(max(at_ns, started_ns + 1))
        qtbot.waitUntil(lambda: console.settled, timeout=10_000)
        return shown_state(console.state)

    timeline = SessionTimeline(open_session(tour))

    def told_between(name: str, after_ns: int, until_ns: int) -> list[int]:
        told = timeline.between(after_ns, until_ns, types=(StatusShown,))
        return [arrived_ns for arrived_ns, status in told if status.name == name]

    try:
        found = []
        for sample in samples[:: max(1, len(samples) // 12)]:
            streams = sample["shown"]["streams"]
            del streams["frame"]  # decoded asynchronously; compared below
            for name, (stamp_ns, *_) in list(streams.items()):
                if stamp_ns is not None and stamp_ns < started_ns:
                    del streams[name]  # displayed since before the recording, with a rare update
            at_s = (sample["at_ns"] - started_ns) / 1e9
            found += [f"after {at_s:.1f} s: {each}" for each in differences(sample, shown_at, told_between)]
        assert not found, "\n".join(found)
        at_ns = samples[len(samples) // 2]["at_ns"]
        live_ns = frames_ns[len(samples) // 2]
        shown_at(at_ns)
        qtbot.waitUntil(lambda: _shows_frame(console.state, live_ns - _FRAMES_APART_NS, at_ns), timeout=5_000)
    finally:
        timeline.close()
        replay.close()


# A busy computer records fewer frames than it displays.
_FRAMES_APART_NS = 1_000_000_000


def _shows_frame(state: LiveState, earliest_ns: int, latest_ns: int) -> bool:
    return state.frame.value is not None and earliest_ns <= state.frame.value.stamp_ns <= latest_ns


@pytest.mark.timeout(300)
@pytest.mark.long  # recording/recorder/test_blurring tests the covered areas
@pytest.mark.parametrize("sentences", [0, 3])
def test_the_mental_health_check_films_nobody_recognisably(tmp_path: Path, sentences: int) -> None:
    session = _rehearse("mental-health-check", tmp_path, sentences=sentences)
    messages = _messages(session)
    if sentences:
        _is_whole_conversation(session, SAYS["mental-health-check"])
    assert messages["/event/llm_exchange"] and messages["/people"]
    assert "/event/photo_taken" not in messages and not list(session.rglob("*.png"))

    frames: dict[int, Any] = {}
    for video in session.glob("video-*.mp4"):
        with video.with_suffix(".frames.csv").open(newline="", encoding="utf-8") as lines, av.open(str(video)) as film:
            stamps_ns = [int(line["stamp_ns"]) for line in csv.DictReader(lines)]
            frames |= zip(stamps_ns, (each.to_ndarray(format="bgr24") for each in film.decode(video=0)), strict=False)
    assert len(frames) > 100
    flat: dict[bool, list[float]] = {True: [], False: []}
    for people in messages["/people"]:
        for box in people["boxes"]:
            if people["stamp_ns"] in frames and box["width_px"] > 20:
                near = box["height_px"] > _NEAR_PX
                flat[near].append(_flat_share(frames[people["stamp_ns"]], box))
    assert len(flat[True]) > 20 and min(flat[True]) > 0.85, "people are seen as flat blocks only"
    # Blocks of a distant person are so small that every eighth pixel is at an edge; a single box varies.
    assert len(flat[False]) < 5 or statistics.fmean(flat[False]) > 0.75


_NEAR_PX = 200
"""Height in the image from which a person could be recognised."""


def _flat_share(image_bgr: Any, box: dict[str, float]) -> float:
    """Share of pixels in the box equal to their left neighbour. In unblurred video of the same people 0.6."""
    left, top = max(0, round(box["left_px"])), max(0, round(box["top_px"]))
    right, bottom = round(box["left_px"] + box["width_px"]), round(box["top_px"] + box["height_px"])
    part = image_bgr[top:bottom, left:right].astype(int).sum(axis=2)
    return float((abs(part[:, 1:] - part[:, :-1]) <= 9).mean())
