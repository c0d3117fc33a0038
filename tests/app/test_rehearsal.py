"""The scripted wizard plays the shipped scenarios in the real console; other programs look at what it leaves."""

import csv
import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import av
import pytest
from mcap.reader import make_reader


def _rehearse(scenario: str, out: Path) -> Path:
    """Play it and give the session folder."""
    done = subprocess.run(
        [sys.executable, "-m", "caris_desktop", "rehearse", scenario, "--out", str(out)],
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


@pytest.mark.timeout(300)
def test_the_tour_leaves_a_whole_session(tmp_path: Path) -> None:
    session = _rehearse("tour-guide", tmp_path)
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
    assert len(list((tmp_path / "screenshots").glob("*.png"))) >= 6


@pytest.mark.timeout(300)
def test_the_mental_health_check_takes_no_pictures(tmp_path: Path) -> None:
    session = _rehearse("mental-health-check", tmp_path)
    messages = _messages(session)
    assert messages["/event/llm_exchange"] and messages["/people"]
    assert "/event/photo_taken" not in messages
    assert not list(session.rglob("*.png")) and not list(session.glob("*.mp4"))
