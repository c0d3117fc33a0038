"""What a scenario decides: layout, permissions, phrases, prompts, places. Plain data, never code."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from caris_desktop.domain.controls import RobotControl
from caris_desktop.domain.geometry import Pose2D

SCENARIO_VERSION = 1
DEFAULT_ROBOT = "simulated"

PanelName = Literal[
    "video", "map", "drive", "people", "speak", "assistant", "session", "robot", "motion", "diagnostics"
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class PanelLeaf:
    """One panel."""

    panel: PanelName


@dataclass(frozen=True, slots=True)
class TabNode:
    """Panels on top of one another; ``current`` is shown first."""

    tabs: tuple[PanelName, ...]
    current: PanelName | None = None


@dataclass(frozen=True, slots=True)
class SplitNode:
    """Children side by side (horizontal) or on top of one another (vertical), sized by ``weights``."""

    split: Literal["horizontal", "vertical"]
    children: tuple["LayoutNode", ...]
    weights: tuple[float, ...]


LayoutNode = PanelLeaf | TabNode | SplitNode


@dataclass(frozen=True, slots=True)
class Permissions:
    """What the wizard may do in this scenario. Whatever is False has no button, no shortcut and no code path."""

    photos: bool = True
    video_recording: bool = True
    audio_recording: bool = False
    driving: bool = True
    assistant: bool = True
    naming_people: bool = True
    robot_controls: bool = True


@dataclass(frozen=True, slots=True)
class Place:
    """A named place in the map."""

    name: str
    pose_in_map: Pose2D


@dataclass(frozen=True, slots=True)
class AssistantSettings:
    """How the language model is asked. ``model`` is ``embedded``, ``ollama:NAME`` or ``openai:NAME``."""

    model: str = "embedded"
    system_prompt: str = ""
    max_tokens: int = 96
    temperature: float = 0.4


@dataclass(frozen=True, slots=True)
class DrivingLimits:
    """Speeds at the full speed setting; the robot profile's own limits still apply."""

    max_forward_mps: float = 0.5
    max_turn_radps: float = 1.0


@dataclass(frozen=True, slots=True)
class RecordingSettings:
    """``labels`` are those of the mark keys, in this order. With ``lsl`` marks go to Lab Streaming Layer too.

    ``lsl_words`` lets everything that is said go there with them, for the whole network to hear.
    """

    labels: tuple[str, ...] = ()
    lsl: bool = False
    lsl_words: bool = False


@dataclass(frozen=True, slots=True)
class Scenario:
    """One scenario file. ``phrases`` sit on F1..F8 in order, ``filler`` on F9, ``controls`` come after the robot's."""

    title: str
    layout: LayoutNode
    description: str = ""
    robot: str = DEFAULT_ROBOT
    phrases: tuple[str, ...] = ()
    filler: str = ""
    places: tuple[Place, ...] = ()
    controls: tuple[RobotControl, ...] = ()
    permissions: Permissions = field(default_factory=Permissions)
    assistant: AssistantSettings = field(default_factory=AssistantSettings)
    driving: DrivingLimits = field(default_factory=DrivingLimits)
    recording: RecordingSettings = field(default_factory=RecordingSettings)
    voice: Literal["robot", "computer"] = "robot"
    path: Path | None = None
    sha256: str = ""
