"""Text files for readers without a program: movement, speech, people."""

import json
from pathlib import Path

import numpy as np

from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import (
    CommandSent,
    PersonAppeared,
    UtteranceChanged,
    UtteranceCorrected,
    UtteranceState,
)
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import People, PersonBox, RobotPose
from caris_desktop.recording.recorder.plain_files import PlainFiles
from caris_desktop.recording.session.session_header import SessionClock

SECOND = 1_000_000_000
CLOCK = SessionClock(ClockAnchor(monotonic_ns=0, utc_ns=1_795_000_000 * SECOND), started_ns=10 * SECOND)


def at(session_s: float) -> int:
    return int((10 + session_s) * SECOND)


def lines(path: Path) -> list[str]:
    return [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]


def remarks(path: Path) -> list[str]:
    return [line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("#")]


def test_movement_shows_changes_of_command_and_where_the_robot_was(tmp_path: Path) -> None:
    files = PlainFiles(tmp_path, CLOCK, on_full=lambda: False)
    for tick in range(20):
        files.add(RobotPose(at(tick * 0.1), None, Pose2D(tick * 0.05, 2.0, 0.0)))
        files.add(CommandSent(at(tick * 0.1), tick, Twist2D(0.5 if tick < 10 else 0.0), "keyboard"))
    for tick in range(20, 60):
        files.add(RobotPose(at(tick * 0.1), None, Pose2D(0.95, 2.0, 0.0)))
    # Flushed continuously: read here before the files are closed.
    rows = [line.split() for line in lines(tmp_path / "movement.txt")][1:]
    assert [(row[1], row[2], row[3]) for row in rows if row[2] == "command"] == [
        ("0.000", "command", "0.500"),
        ("1.000", "command", "0.000"),
    ]
    assert [(row[1], row[3]) for row in rows if row[2] == "pose"] == [
        ("0.000", "0.000"),
        ("1.000", "0.500"),
        ("2.000", "0.950"),
    ]
    files.close()


def test_a_robot_that_stands_writes_no_lines_however_its_place_trembles(tmp_path: Path) -> None:
    files = PlainFiles(tmp_path, CLOCK, on_full=lambda: False)
    tremble = np.random.default_rng(4)
    for tick in range(1200):
        x_m, y_m, heading_rad = tremble.normal((1.0, 2.0, 0.0), (0.008, 0.008, 0.004)).tolist()
        files.add(RobotPose(at(tick * 0.1), None, Pose2D(x_m, y_m, heading_rad)))
    for tick in range(1200, 1220):
        files.add(RobotPose(at(tick * 0.1), None, Pose2D(1.0 + (tick - 1199) * 0.03, 2.0, 0.0)))
    files.close()
    rows = [line.split() for line in lines(tmp_path / "movement.txt")][1:]
    assert [(row[1], row[2]) for row in rows] == [("0.000", "pose"), ("120.100", "pose"), ("121.100", "pose")]


def test_speech_shows_each_sentence_once_and_what_became_of_it(tmp_path: Path) -> None:
    files = PlainFiles(tmp_path, CLOCK, on_full=lambda: False)

    def say(session_s: float, number: str, state: UtteranceState, text: str, speaker: str = "robot") -> None:
        files.add(UtteranceChanged(at(session_s), number, speaker, text, "typed", state))  # type: ignore[arg-type]

    say(1, "a", "requested", "Hello\nthere")
    say(2, "a", "started", "Hello\nthere")
    say(3, "a", "finished", "Hello\nthere")
    say(4, "b", "finished", "Can it hurt people? ö", "participant")
    say(5, "c", "started", "It is sa")
    say(6, "c", "interrupted", "It is sa")
    say(7, "d", "requested", "never said")
    files.close()
    assert [line.split(maxsplit=1)[1].strip() for line in lines(tmp_path / "speech.txt")] == [
        "2.000 robot: Hello there  [typed]",
        "4.000 participant: Can it hurt people? ö  [typed]",
        "5.000 robot: It is sa  [typed]",
    ], "a line per utterance"
    assert "6.000 robot: It is sa  [interrupted]" in remarks(tmp_path / "speech.txt")[-1]


def test_speech_has_the_participants_utterances_and_corrections(tmp_path: Path) -> None:
    files = PlainFiles(tmp_path, CLOCK, on_full=lambda: False)

    def hear(session_s: float, number: str, state: UtteranceState, text: str = "", person_id: str = "") -> None:
        files.add(UtteranceChanged(at(session_s), number, "participant", text, "heard", state, person_id=person_id))

    hear(1, "a", "started")
    hear(2.5, "a", "finished", "Hello robber.", "p-1")
    hear(3, "b", "started")
    hear(3.5, "b", "failed")
    files.add(UtteranceCorrected(at(5), "a", text="Hello robot."))
    files.add(UtteranceCorrected(at(6), "a", speaker=""))
    files.add(UtteranceCorrected(at(7), "a", tags=("greets",)))
    files.close()
    assert [line.split(maxsplit=1)[1].strip() for line in lines(tmp_path / "speech.txt")] == [
        "1.000 participant (p-1): Hello robber.  [heard]"
    ]
    first, second = remarks(tmp_path / "speech.txt")[-2:]
    assert "5.000 participant: Hello robot.  [corrected, before: Hello robber.]" in first
    assert "6.000 unknown speaker: Hello robot.  [corrected]" in second


def test_people_are_opaque_ids_with_times_and_tracks(tmp_path: Path) -> None:
    files = PlainFiles(tmp_path, CLOCK, on_full=lambda: False)
    files.add(PersonAppeared(at(1), "p-1", 4))
    files.add(People(at(3), "front", 1, 640, 480, (PersonBox(9, "p-1", 0, 0, 1, 1, 0.9),), 5.0))
    files.add(People(at(4), "front", 2, 640, 480, (PersonBox(11, "", 0, 0, 1, 1, 0.9),), 5.0))
    files.close()
    (person,) = json.loads((tmp_path / "people.json").read_text())["people"]
    assert (person["person_id"], person["tracks"]) == ("p-1", [4, 9])
    assert (person["first_seen_s"], person["last_seen_s"]) == (1.0, 3.0)
    assert person["first_seen_utc"].endswith("Z")
