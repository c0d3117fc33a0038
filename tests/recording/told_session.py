"""Synthetic session folders from events at chosen times, as the recorder would have written them."""

import dataclasses
import json
import math
import random
from collections.abc import Iterable
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer

from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import (
    AnswerUsed,
    ChatMessage,
    CommandSent,
    CommandSource,
    EmergencyStopChanged,
    Gap,
    GoalChanged,
    GuardChanged,
    LinkChanged,
    LinkQuality,
    LlmExchange,
    Marked,
    PersonAppeared,
    PersonLeft,
    PlannedStep,
    Problem,
    ProtocolOpened,
    RecordingPaused,
    RobotChosen,
    ScenarioOpened,
    SessionEnded,
    SessionStarted,
    StepEntered,
    StepHow,
    StopRequested,
    UtteranceChanged,
    UtteranceOrigin,
)
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.schema import json_schema, to_jsonable
from caris_desktop.domain.sensing import OccupancyGrid, Odometry, RobotPose
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.domain.streams import BY_TYPE

ANCHOR = ClockAnchor(monotonic_ns=5_000_000_000_000, utc_ns=1_795_255_200_000_000_000)
# Robot minus session clock: the robot has UTC, two seconds ahead.
_ROBOT_AHEAD_MS = (ANCHOR.utc_ns - ANCHOR.monotonic_ns) / 1e6 + 2000.0
STARTED_NS = ANCHOR.monotonic_ns + 3_000_000_000
TRIAL = {
    "study": "Tour",
    "participant": "P07",
    "condition": "humour",
    "trial": "3",
    "wizard": "Mia",
    "purpose": "study",
}


def at(session_s: float) -> int:
    return STARTED_NS + round(session_s * 1e9)


def tell(
    folder: Path,
    values: Iterable[Any],
    *,
    lasts_s: float,
    trial: dict[str, str] | None = None,
    closed: bool = True,
    later_s: float = 0.0,
    **header: Any,
) -> Path:
    """Write ``folder``; ``later_s`` moves the whole session in UTC only.

    A value that reached the console later than its stamp is a pair: ``(arrived_ns, value)``.
    """
    folder.mkdir(parents=True)
    ended_ns = at(lasts_s)
    anchor = ClockAnchor(ANCHOR.monotonic_ns, ANCHOR.utc_ns + round(later_s * 1e9))
    arrivals = [each if isinstance(each, tuple) else (each.stamp_ns, each) for each in values]
    everything = [(STARTED_NS, SessionStarted(STARTED_NS, folder.name)), *sorted(arrivals, key=itemgetter(0))]
    if closed:
        everything.append((ended_ns, SessionEnded(ended_ns, folder.name, "wizard")))
    with (folder / "events.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="caris-desktop")
        channels: dict[str, int] = {}
        for number, (arrived_ns, value) in enumerate(everything):
            spec = BY_TYPE[type(value)]
            topic = spec.topic_of(value)
            if topic not in channels:
                schema = writer.register_schema(
                    f"caris.{type(value).__name__}", "jsonschema", json.dumps(json_schema(type(value))).encode()
                )
                channels[topic] = writer.register_channel(topic, "json", schema)
            utc_ns = anchor.utc_ns_at(arrived_ns)
            writer.add_message(
                channels[topic],
                log_time=utc_ns,
                publish_time=utc_ns,
                data=json.dumps(to_jsonable(value)).encode(),
                sequence=number,
            )
        writer.finish()
    head = {
        "format": "caris-desktop session",
        "format_version": 1,
        "program_version": "0.test",
        "scenario": {"title": "Tour guide", "file": "tour-guide.yaml", "sha256": "0" * 64},
        "robot": {"profile": "simulated", "address": "ws://127.0.0.1:9090"},
        "trial": TRIAL if trial is None else trial,
        "clock": {"monotonic_ns": anchor.monotonic_ns, "utc_ns": anchor.utc_ns},
        "started_ns": STARTED_NS,
        "ended_ns": ended_ns if closed else None,
        "reason": "wizard" if closed else None,
        "dropped": {},
        "videos": [],
        **header,
    }
    (folder / "session.json").write_text(json.dumps(head, indent=2))
    return folder


def heard(number: int, start_s: float, end_s: float, text: str) -> list[UtteranceChanged]:
    """Utterance of a participant."""
    utterance_id = f"h-{number}"
    return [
        UtteranceChanged(at(start_s), utterance_id, "participant", text, "heard", "started"),
        UtteranceChanged(at(end_s), utterance_id, "participant", text, "heard", "finished"),
    ]


def said(
    number: int, asked_s: float, start_s: float, end_s: float, text: str, *, origin: UtteranceOrigin = "typed"
) -> list[UtteranceChanged]:
    """Utterance of the robot, requested by the wizard."""
    utterance_id = f"u-{number}"
    return [
        UtteranceChanged(at(asked_s), utterance_id, "robot", text, origin, "requested", "robot"),
        UtteranceChanged(at(start_s), utterance_id, "robot", text, origin, "started", "robot"),
        UtteranceChanged(at(end_s), utterance_id, "robot", text, origin, "finished", "robot"),
    ]


def silenced(
    number: int, asked_s: float, text: str, *, after_s: float = 0.006, origin: UtteranceOrigin = "assistant"
) -> list[UtteranceChanged]:
    """Robot utterance that is interrupted ``after_s`` after its start."""
    asked, started, _ = said(number, asked_s, asked_s + 0.1, asked_s + 1.0, text, origin=origin)
    return [asked, started, dataclasses.replace(started, stamp_ns=at(asked_s + 0.1 + after_s), state="interrupted")]


def exchange(number: int, asked_s: float, answered_s: float, answer: str, **fields: Any) -> LlmExchange:
    values: dict[str, Any] = {
        "stamp_ns": at(answered_s),
        "exchange_id": f"x-{number}",
        "provider": "embedded",
        "model": "smollm2-135m",
        "model_version": "q8_0",
        "messages": (
            ChatMessage("system", "You are a friendly robot guide.\nAnswer in one short sentence."),
            ChatMessage("user", "What is this?"),
        ),
        "answer": answer,
        "outcome": "answered",
        "asked_ns": at(asked_s),
        "first_token_ns": at(asked_s + 0.2),
        "parameters": {"temperature": 0.3, "max_tokens": 48},
    }
    return LlmExchange(**{**values, **fields})


STEPS = (
    PlannedStep("greet", "Greet", 10.0, ("Consent", "Coat")),
    PlannedStep("ask", "Ask", 5.0),
    PlannedStep("show", "Show"),
    PlannedStep("close", "Close", 20.0),
)


def stepped(*moves: tuple[float, str, StepHow]) -> list[Any]:
    """Run through a protocol of STEPS: time of each entered step, and how."""
    titles = {step.step_id: (number, step.title) for number, step in enumerate(STEPS, start=1)}
    told: list[Any] = [ProtocolOpened(at(0.0), STEPS)]
    left = ""
    for second, step_id, how in moves:
        number, title = titles[step_id]
        told.append(StepEntered(at(second), step_id, title, number, how, left, actor="wizard"))
        left = step_id
    return told


def drive(
    start_s: float, end_s: float, forward_mps: float, turn_radps: float = 0.0, source: CommandSource = "keyboard"
) -> list[CommandSent]:
    """Commands ten times a second, then a zero."""
    count = round((end_s - start_s) * 10)
    twist = Twist2D(forward_mps=forward_mps, turn_radps=turn_radps)
    return [
        *(CommandSent(at(start_s + number / 10), number, twist, source) for number in range(count)),
        CommandSent(at(end_s), count, Twist2D(), "none"),
    ]


_QUESTIONS = (
    "Hello, who are you?", "What does the robot arm do?", "Can you <b>really</b> lift five kilos?",
    "Where is the kitchen?",
    "How old are you?", "Do you like it here?", "That is funny!", "Could we see the exhibition?",
    "Wie bitte? Ich verstehe nicht.",
)  # fmt: skip
_ANSWERS = (
    "Hello! Welcome to our lab.", "It lifts five kilos and stops as soon as it touches something.",
    "Yes, and it never gets tired.", "Please follow me, it is over there.", "Students built me in 2024.",
    "We have arrived.", "Thank you! I practise every day.", "This way, please.", "Could you say that again?",
)  # fmt: skip
_PLACES = {
    "Reception": (1.0, 1.3), "Lab bench": (8.0, 1.6), "Robot arm": (10.9, 1.9), "Kitchen": (14.75, 2.0),
    "Corridor": (9.0, 5.0), "Exhibition": (12.9, 7.6), "Meeting room": (7.15, 6.65),
}  # fmt: skip


def tour(seed: int, *, minutes: float = 8.0, state_hz: float = 10.0, building: bool = True) -> list[Any]:
    """A plausible tour: talk, driving, navigation, marks, trouble. The same one for each ``seed``."""
    random_ = random.Random(seed)  # noqa: S311 - a test, not cryptography
    values: list[Any] = [
        ScenarioOpened(
            at(-1.0), "tour-guide.yaml", "Tour guide", "0" * 64, (layouts_dir() / "tour-guide.yaml").read_text()
        ),
        RobotChosen(at(-1.0), "simulated", "Simulated robot", "ws://127.0.0.1:9090"),
        LinkChanged(at(-0.5), "control", "connected", "ws://127.0.0.1:9090"),
        GuardChanged(at(-0.5), "clear"),
        PersonAppeared(at(2.0), "p-1", 1),
        LinkQuality(at(1.0), 3.1, _ROBOT_AHEAD_MS, 1.2),
        LinkQuality(at(minutes * 60 - 1), 4.0, _ROBOT_AHEAD_MS + 50.0 * minutes, 1.4),
    ]
    end_s = minutes * 60
    now_s, number = 4.0, 0
    stops: list[tuple[float, float, float]] = [(0.0, *_PLACES["Reception"])]
    here = _PLACES["Reception"]
    while now_s < end_s - 40.0:
        number += 1
        length_s = random_.uniform(0.8, 3.5)
        values += heard(number, now_s, now_s + length_s, random_.choice(_QUESTIONS))
        now_s += length_s
        thinks_s = random_.lognormvariate(0.6, 0.5)
        origin: UtteranceOrigin = random_.choice(["typed", "phrase", "phrase", "assistant", "suggestion"])
        answer = random_.choice(_ANSWERS)
        if thinks_s > 2.5:
            values += said(1000 + number, now_s + 0.8, now_s + 0.9, now_s + 1.6, "Let me think...", origin="filler")
        if origin == "assistant":
            values.append(exchange(number, now_s + 0.3, now_s + thinks_s * 0.6 + 0.4, answer))
            use = random_.choice(["said", "said", "edited", "dismissed", ""])
            if use in ("said", "edited"):
                values.append(AnswerUsed(at(now_s + thinks_s), f"x-{number}", use, answer))
            elif use:
                values.append(AnswerUsed(at(now_s + thinks_s), f"x-{number}", "dismissed", ""))
        length_s = random_.uniform(1.2, 4.0)
        values += said(
            number, now_s + thinks_s, now_s + thinks_s + 0.12, now_s + thinks_s + length_s, answer, origin=origin
        )
        now_s += thinks_s + length_s + random_.uniform(0.5, 4.0)
        if random_.random() < 0.45:
            place = random_.choice([name for name, spot in _PLACES.items() if spot != here])
            way_s = max(3.0, math.dist(here, _PLACES[place]) / 0.45)
            if random_.random() < 0.5:
                target = Pose2D(*_PLACES[place], 0.0)
                for state, moment_s in (("requested", 0.0), ("active", 0.2), ("reached", way_s)):
                    values.append(GoalChanged(at(now_s + moment_s), f"g-{number}", state, target, place))
            else:
                values += drive(now_s, now_s + way_s, 0.45, source=random_.choice(["keyboard", "gamepad"]))
            stops += [(now_s, *here), (now_s + way_s, *_PLACES[place])]
            here = _PLACES[place]
            if random_.random() < 0.4:
                values += [
                    GuardChanged(at(now_s + way_s / 2), "slowing", 0.6),
                    GuardChanged(at(now_s + way_s / 2 + 1.5), "clear"),
                ]
            now_s += way_s + 1.0
        if random_.random() < 0.3:
            label = random_.choice(["Interested", "Confused", "Laughs", "Steps back"])
            values.append(Marked(at(now_s), label, mark_id=f"m-{number}", start_ns=at(now_s - 2.0)))
        if random_.random() < 0.12:
            kind = random_.choice(["slip", "late", "wrong branch"])
            values.append(Marked(at(now_s), kind, "wizard_error", mark_id=f"e-{number}"))
    values += [
        Marked(at(end_s * 0.3), "Interested", mark_id="r-1", state="open"),
        Marked(at(end_s * 0.36), "Interested", mark_id="r-1", state="done", end_ns=at(end_s * 0.36)),
        Marked(at(end_s * 0.5), "Note", "note", mark_id="n-1", note="Wants to touch it & <try>."),
        StopRequested(at(end_s * 0.45)),
        EmergencyStopChanged(at(end_s * 0.8), True, "wizard"),
        EmergencyStopChanged(at(end_s * 0.8 + 4), False, "wizard"),
        LinkChanged(at(end_s * 0.6), "control", "trouble", "ws://127.0.0.1:9090", "no answer for 0.5 s"),
        LinkChanged(at(end_s * 0.6 + 2.5), "control", "connected", "ws://127.0.0.1:9090"),
        Problem(at(end_s * 0.6), "warning", "The robot does not respond.", "Driving has stopped.", "Wait for it."),
        Gap(at(end_s * 0.62), "frame", 12, "the video encoder could not keep up"),
        PersonAppeared(at(end_s * 0.4), "p-2", 7),
        PersonLeft(at(end_s * 0.7), "p-2", 7),
        RecordingPaused(at(end_s - 30), True),
        RecordingPaused(at(end_s - 20), False),
    ]  # fmt: skip
    stops.append((end_s, *here))
    values += _states(stops, end_s, state_hz)
    if building:
        values.append(_building())
    return values


def _states(stops: list[tuple[float, float, float]], end_s: float, state_hz: float) -> list[Any]:
    times_s = np.arange(0.0, end_s, 1.0 / state_hz)
    known_s, xs_m, ys_m = (np.array(column) for column in zip(*stops, strict=True))
    x_m, y_m = np.interp(times_s, known_s, xs_m), np.interp(times_s, known_s, ys_m)
    # Slightly off the straight line, as real paths are.
    y_m += 0.15 * np.sin(x_m * 1.7)
    speed_mps = np.hypot(np.gradient(x_m), np.gradient(y_m)) * state_hz
    heading_rad = np.arctan2(np.gradient(y_m), np.gradient(x_m))
    values: list[Any] = []
    for index, time_s in enumerate(times_s):
        pose = Pose2D(float(x_m[index]), float(y_m[index]), float(heading_rad[index]))
        values.append(Odometry(at(float(time_s)), None, pose, Twist2D(forward_mps=float(speed_mps[index]))))
        if index % max(1, round(state_hz / 5)) == 0:
            values.append(RobotPose(at(float(time_s)), None, pose))
    return values


def _building() -> OccupancyGrid:
    cells = np.zeros((200, 320), np.int8)
    cells[[0, 1, -2, -1], :] = 100
    cells[:, [0, 1, -2, -1]] = 100
    for x in (100, 190, 260):
        cells[0:80, x : x + 3] = 100
        cells[125:200, x : x + 3] = 100
    for y in (80, 122):
        cells[y : y + 3, :] = 100
        for door in (40, 140, 220, 290):
            cells[y : y + 3, door : door + 22] = 0
    cells[150:200, 280:] = -1
    return OccupancyGrid(at(0.5), None, 0.05, Pose2D(0.0, 0.0, 0.0), cells)
