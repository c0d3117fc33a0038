"""Two scenarios similar to the shipped ones, and values of a running session."""

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import clock
from caris_desktop.domain.events import (
    GoalChanged,
    LinkChanged,
    Marked,
    PersonAppeared,
    PhotoTaken,
    ScenarioOpened,
    SessionStarted,
    Speaker,
    UtteranceChanged,
    UtteranceCorrected,
    UtteranceOrigin,
)
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import (
    BatteryState,
    HeadState,
    LaserScan,
    OccupancyGrid,
    Odometry,
    People,
    PeopleInMap,
    PersonBox,
    PersonPlace,
    PlannedPath,
    RobotPose,
)
from caris_desktop.live.status import (
    AssistantStatus,
    DisplayedReply,
    DriveStatus,
    LevelsStatus,
    LinkStatus,
    PerceptionStatus,
    ProposalStatus,
    RecordingStatus,
    SpeechStatus,
    SuggestionsStatus,
)
from caris_desktop.people.presence import PersonRow
from caris_desktop.scenario.scenario_model import (
    AssistanceSettings,
    AssistantSettings,
    DrivingLimits,
    PanelLeaf,
    Permissions,
    Place,
    Scenario,
    SplitNode,
    TabNode,
)
from tests.ui.fake_console import FakeConsole

TOUR_LAYOUT = SplitNode(
    "horizontal",
    (
        SplitNode("vertical", (PanelLeaf("video"), PanelLeaf("speak")), (0.68, 0.32)),
        SplitNode(
            "vertical",
            (PanelLeaf("map"), PanelLeaf("drive"), TabNode(("assistant", "session"), "assistant"), PanelLeaf("people")),
            (0.32, 0.24, 0.24, 0.2),
        ),
    ),
    (0.62, 0.38),
)
TOUR = Scenario(
    title="Tour guide",
    layout=TOUR_LAYOUT,
    phrases=(
        "Hello! Welcome to the lab.", "Please follow me.", "We have arrived.", "Let me think…",
        "Could you say that again?", "Do you have any questions?", "Goodbye, and thank you for visiting!",
    ),
    filler="Hmm, good question.",
    places=(
        Place("Reception", Pose2D(1.5, 6.4, 0)), Place("Lab bench", Pose2D(6.2, 6.4, 0)),
        Place("Robot arm", Pose2D(12.6, 5.0, 0)), Place("Kitchen", Pose2D(12.0, 1.5, 0)),
    ),
    assistant=AssistantSettings(),
    assistance=AssistanceSettings(actions="suggest"),
    permissions=Permissions(face=True),
    path=Path("/layouts/tour_guide.yaml"),
)  # fmt: skip

MENTAL_LAYOUT = SplitNode(
    "horizontal",
    (
        SplitNode("vertical", (PanelLeaf("video"), PanelLeaf("people")), (0.62, 0.38)),
        SplitNode("vertical", (PanelLeaf("assistant"), PanelLeaf("speak")), (0.55, 0.45)),
        SplitNode("vertical", (PanelLeaf("drive"), PanelLeaf("session")), (0.42, 0.58)),
    ),
    (0.3, 0.44, 0.26),
)
MENTAL = Scenario(
    title="Mental health check",
    layout=MENTAL_LAYOUT,
    phrases=(
        "I’m listening.", "Take your time.", "Thank you for sharing that.", "Let me think…",
        "I’ll pass this to the wellness team. They can follow up with you.", "We can stop at any time.",
    ),
    filler="Mm-hm.",
    permissions=Permissions(photos=False, video_recording=False),
    driving=DrivingLimits(max_forward_mps=0.2),
    path=Path("/layouts/mental_health_check.yaml"),
)  # fmt: skip

_WALLS = (
    (0, 0, 15, 0), (15, 0, 15, 8), (15, 8, 0, 8), (0, 8, 0, 0),
    (4, 8, 4, 5), (4, 3, 4, 0), (9, 8, 9, 5.6), (9, 3.8, 9, 0),
    (9, 3.0, 10.6, 3.0), (12.2, 3.0, 15, 3.0), (5.4, 7.0, 7.4, 7.0), (13.4, 6.2, 14.2, 6.2),
)  # fmt: skip


def floor_plan(*, resolution_m: float = 0.05) -> OccupancyGrid:
    cells = np.full((200, 340), -1, np.int8)

    def fill(x0: float, y0: float, x1: float, y1: float, value: int) -> None:
        columns = sorted((round((x0 + 1) / resolution_m), round((x1 + 1) / resolution_m)))
        rows = sorted((round((y0 + 1) / resolution_m), round((y1 + 1) / resolution_m)))
        cells[rows[0] : rows[1] + 2, columns[0] : columns[1] + 2] = value

    fill(0, 0, 15, 8, 0)
    cells[20:70, 285:320] = -1
    for wall in _WALLS:
        fill(*wall, 100)
    return OccupancyGrid(clock.now_ns(), None, resolution_m, Pose2D(-1.0, -1.0, 0.0), cells)


def scan_at(pose: Pose2D, *, beams: int = 720) -> LaserScan:
    """Scan by ray casting in the floor plan, with some noise."""
    increment = 2 * math.pi / beams
    angles = -math.pi + increment * np.arange(beams) + pose.heading_rad
    best = np.full(beams, np.inf)
    direction = np.stack((np.cos(angles), np.sin(angles)))
    for x0, y0, x1, y1 in _WALLS:
        ex, ey = x1 - x0, y1 - y0
        cross = direction[0] * ey - direction[1] * ex
        with np.errstate(divide="ignore", invalid="ignore"):
            along = ((x0 - pose.x_m) * ey - (y0 - pose.y_m) * ex) / cross
            share = ((x0 - pose.x_m) * direction[1] - (y0 - pose.y_m) * direction[0]) / cross
        hit = (along > 0.05) & (share >= 0) & (share <= 1)
        best = np.where(hit, np.minimum(best, along), best)
    noise = np.random.default_rng(3).normal(0, 0.012, beams)
    ranges = np.where(best < 8.0, best + noise, np.inf).astype(np.float32)
    return LaserScan(clock.now_ns(), None, "laser", -math.pi, increment, 0.05, 8.0, ranges, Pose2D(0, 0, 0))


def corridor(width_px: int = 640, height_px: int = 480) -> NDArray[np.uint8]:
    """Synthetic room, used without video data."""
    image = np.zeros((height_px, width_px, 3), np.uint8)
    rows = np.linspace(0, 1, height_px)[:, None]
    image[:] = (np.array([150, 150, 145]) - 60 * rows[..., None]).astype(np.uint8)
    image[height_px * 6 // 10 :] = (120, 130, 140)
    return image


def video_frames() -> Iterator[tuple[NDArray[np.uint8], list[tuple[float, float, float, float]]]]:
    """A street with its people's boxes if the shared data exists next to the repository, else a synthetic room."""
    data = Path(__file__).resolve().parents[3] / "shared" / "data" / "TUD-Campus"
    video, truth = data / "TUD-Campus.mp4", data / "gt.txt"
    if video.is_file():
        import cv2

        boxes: dict[int, list[tuple[float, float, float, float]]] = {}
        if truth.is_file():
            for line in truth.read_text().splitlines():
                values = [float(value) for value in line.split(",")]
                boxes.setdefault(int(values[0]), []).append((values[2], values[3], values[4], values[5]))
        capture = cv2.VideoCapture(str(video))
        number = 0
        while True:
            read, image = capture.read()
            if not read:
                break
            number += 1
            yield image.astype(np.uint8), boxes.get(number, [])
    else:
        yield corridor(), [(250.0, 120.0, 110.0, 300.0)]


@functools.cache
def first_frames() -> tuple[tuple[NDArray[np.uint8], list[tuple[float, float, float, float]]], ...]:
    """Cached frames for every window; reading them again would take a tenth of its time."""
    return tuple(itertools.islice(video_frames(), 4))


def fill_console(console: FakeConsole) -> None:
    """Set the state to the middle of a session."""
    state = console.state
    now_ns = clock.now_ns()
    pose = Pose2D(6.6, 3.4, 0.55)
    image, boxes = first_frames()[-1]
    state.link.set(LinkStatus("connected", "Simulated robot", "ws://127.0.0.1:9090", "", 12.0))
    state.drive.set(
        DriveStatus(
            allowed=True, reason="", speed_fraction=0.7, target_forward_mps=0.35,
            max_forward_mps=console.scenario.driving.max_forward_mps,
            max_turn_radps=console.scenario.driving.max_turn_radps,
        )
    )  # fmt: skip
    state.recording.set(
        RecordingStatus(
            "recording", Path("/sessions/2026-11-21_14-02_P07"), now_ns - 763_000_000_000, 184_000_000, 41_300_000_000
        )
    )
    now = UtteranceChanged(now_ns, "u1", "robot", "Over there is our robot arm. We built it.", "typed", "started")
    later = UtteranceChanged(now_ns, "u2", "robot", "It can lift five kilos.", "typed", "requested")
    state.speech.set(SpeechStatus(True, "robot", now, (later,)))
    state.assistant.set(
        AssistantStatus(
            "ready", "SmolLM2 (local)", "x1", "Can the robot arm hurt people when it moves?",
            "It stops as soon as it touches something, and there is a safety zone around it.",
        )
    )  # fmt: skip
    state.perception.set(PerceptionStatus("ready", "yolov8n", "", 31.0, recognises=("clothing",)))
    state.persons.set(
        (
            PersonRow("p1", 1, "Luis", True, now_ns - 190_000_000_000, now_ns),
            PersonRow("p2", 2, "Ana Torres", True, now_ns - 64_000_000_000, now_ns),
            PersonRow("p3", 4, "Person 3", True, now_ns - 12_000_000_000, now_ns),
            PersonRow("p4", 3, "Person 4", False, now_ns - 300_000_000_000, now_ns - 41_000_000_000),
        )
    )
    if console.scenario.places:
        target = console.scenario.places[2]
        state.goal.set(GoalChanged(now_ns, "g", "active", target.pose_in_map, place=target.name, distance_left_m=6.2))
    for event in (
        ScenarioOpened(now_ns, "tour_guide.yaml", console.scenario.title, ""),
        LinkChanged(now_ns, "robot", "connected", "ws://127.0.0.1:9090"),
        SessionStarted(now_ns, "2026-11-21_14-02_P07"),
        PersonAppeared(now_ns, "p1", 1),
        UtteranceChanged(now_ns, "u0", "robot", "Hello! Welcome to the lab.", "phrase", "started"),
        PersonAppeared(now_ns, "p3", 4),
        Marked(now_ns, ""),
        PhotoTaken(now_ns, "front", 3, "photos/photo-0003.png"),
        now,
    ):
        state.add(event)
    state.add(floor_plan())
    state.add(BatteryState(clock.now_ns(), 0.78))
    refresh_streams(console, pose)
    show_frame(console, image, boxes)


def converse(console: FakeConsole) -> None:
    """A question, its answer, and the present utterance."""
    now_ns = clock.now_ns()

    def at(seconds_ago: float) -> int:
        return now_ns - round(seconds_ago * 1e9)

    def told(turn_id: str, speaker: Speaker, text: str, lasted_s: tuple[float, float], who: str = "") -> None:
        origin: UtteranceOrigin = "heard" if speaker == "participant" else "typed"
        begun = UtteranceChanged(at(lasted_s[0]), turn_id, speaker, text, origin, "started", person_id=who)
        console.say_turn(begun, dataclasses.replace(begun, stamp_ns=at(lasted_s[1]), state="finished"))

    told("t1", "participant", "Hi, is this where the tour begins?", (31.0, 29.4), "p1")
    told("t2", "robot", "Hello! Welcome to our lab. I am going to show you around.", (28.8, 25.0))
    told("t3", "participant", "Oh nice, it talks.", (24.0, 22.6))
    told("t4", "robot", "Over there is our robot arm.", (20.2, 17.9))
    told("t5", "participant", "Can it hurt people when it moves?", (3.1, 1.4), "p1")
    console.say_turn(UtteranceCorrected(at(15.0), "t3", tags=("amused",)))


def suggest(console: FakeConsole) -> None:
    """Suggested replies to the question, and a proposed action."""
    replies = (
        "It stops as soon as it touches something.", "Good question! There is a safety zone around it.",
        "No, and we can watch it from here if you like.",
    )  # fmt: skip
    state = console.state
    state.levels.set(LevelsStatus("suggest", "suggest", "suggest"))
    state.suggestions.set(
        SuggestionsStatus(
            "shown", "t5", 1, tuple(DisplayedReply(f"s-{rank}", rank, text) for rank, text in enumerate(replies, 1)),
            "SmolLM2 (local)", 3, "Robot arm", person_id="p1",
        )
    )  # fmt: skip
    state.proposal.set(
        ProposalStatus("a-1", "Go to Kitchen", True, "SmolLM2 (local)", 0, clock.now_ns() + 12_000_000_000)
    )


def show_frame(console: FakeConsole, image: NDArray[np.uint8], boxes: list[tuple[float, float, float, float]]) -> None:
    frame = console.frames.add(image)
    console.state.add(frame)
    console.state.add(people_for(frame.sequence, image.shape[1], image.shape[0], boxes))


def people_for(sequence: int, width_px: int, height_px: int, boxes: list[tuple[float, float, float, float]]) -> People:
    found = tuple(
        PersonBox(index, f"p{index}", left, top, width, height, 0.9)
        for index, (left, top, width, height) in enumerate(boxes[:4], start=1)
    )
    return People(clock.now_ns(), "front", sequence, width_px, height_px, found, 31.0)


def refresh_streams(console: FakeConsole, pose: Pose2D) -> None:
    state = console.state
    state.add(RobotPose(clock.now_ns(), None, pose))
    state.add(dataclasses.replace(scan_at(pose), stamp_ns=clock.now_ns()))
    state.add(Odometry(clock.now_ns(), None, pose, Twist2D(0.35, 0.0, 0.07)))


def drive_along(console: FakeConsole) -> None:
    """A trail behind the robot and a path ahead."""
    state = console.state
    for share in np.linspace(0.0, 1.0, 120):
        state.add(RobotPose(clock.now_ns(), None, Pose2D(2.0 + 4.6 * share, 2.0 + 1.4 * math.sin(1.57 * share), 0.4)))
    goal = state.goal.value
    if goal is not None:
        target, share = goal.target_in_map, np.linspace(0.0, 1.0, 100)
        points = np.column_stack((6.6 + (target.x_m - 6.6) * share, 3.4 + (target.y_m - 3.4) * share**2))
        state.add(PlannedPath(clock.now_ns(), None, points.astype(np.float32)))


def refresh_people_in_map(console: FakeConsole) -> None:
    places = (PersonPlace("p1", 8.4, 5.0, 0.15, "lidar"), PersonPlace("p3", 5.0, 2.0, 0.4, "depth"))
    console.state.add(PeopleInMap(clock.now_ns(), places))
    console.state.add(HeadState(clock.now_ns(), None, 0.0, 0.0))
