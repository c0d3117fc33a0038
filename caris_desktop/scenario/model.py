"""What a scenario decides: layout, permissions, phrases, prompts, places. Plain data, never code.

These declarations are the only place where a setting is added. The check and its messages, the JSON Schema for editors
and the page of the guide follow from them; ``python -m caris_desktop.app.reference`` writes the latter two anew.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from caris_desktop.domain.camera import CameraModel
from caris_desktop.domain.camera_keys import CameraModelKeys
from caris_desktop.domain.controls import CONTROL
from caris_desktop.domain.declared import NotInFile, Rule, Spread, WrittenAs
from caris_desktop.domain.geometry import Pose2D

SCENARIO_VERSION: Literal[1] = 1
DEFAULT_ROBOT = "simulated"

PanelName = Literal[
    "video", "map", "drive", "people", "speak", "assistant", "session", "robot", "motion", "diagnostics", "photos"
]  # fmt: skip

BlurWho = Literal["nobody", "everybody", "without_consent"]
_Panel = Annotated[PanelName, Rule(noun="panel")]
_Label = Annotated[str, Rule(shortest=1, longest=80)]
_Sentence = Annotated[str, Rule(shortest=1, longest=500)]
_Coordinate = Annotated[float, Rule(unit="metres", at_least=-10_000, at_most=10_000)]


@dataclass(frozen=True, slots=True)
class PanelLeaf:
    """One panel."""

    panel: Annotated[_Panel, Rule("Its name.")]


@dataclass(frozen=True, slots=True)
class TabNode:
    """Panels on top of one another."""

    tabs: Annotated[tuple[_Panel, ...], Rule("The panels, from left to right.", shortest=1)]
    current: Annotated[_Panel | None, Rule("The tab that is shown first.")] = None


@dataclass(frozen=True, slots=True)
class SplitNode:
    """Parts side by side or on top of one another."""

    split: Annotated[
        Literal["horizontal", "vertical"], Rule("`horizontal`: side by side; `vertical`: on top of one another.")
    ]
    children: Annotated[tuple["LayoutNode", ...], Rule("The parts, from left or top.", shortest=2, order=1)]
    weights: Annotated[
        tuple[Annotated[float, Rule(more_than=0)], ...],
        Rule("The size of each part in relation to the others; all the same where they are not given."),
    ] = ()

    def __post_init__(self) -> None:
        if not self.weights:
            object.__setattr__(self, "weights", (1.0,) * len(self.children))


LayoutNode = Annotated[
    PanelLeaf | TabNode | SplitNode,
    Rule(
        "One panel, tabs on top of one another, or a split into parts sized by weights.",
        noun="layout part",
        needs="a layout part needs 'panel: NAME', 'tabs: [NAMES]', or 'split' with 'children'.",
    ),
]


@dataclass(frozen=True, slots=True)
class Permissions:
    """What the wizard may do in this scenario. Whatever is false has no button, no shortcut and no effect."""

    photos: Annotated[bool, Rule("Photos of what the robot sees, kept as files.")] = True
    video_recording: Annotated[bool, Rule("Recordings hold the robot's pictures.")] = True
    audio_recording: Annotated[bool, Rule("Recordings hold microphones and the robot's voice; off unless set.")] = False
    driving: Annotated[bool, Rule("Keys, gamepad, places and whatever else moves the robot.")] = True
    assistant: Annotated[bool, Rule("Questions to a language model.")] = True
    naming_people: Annotated[bool, Rule("Names for the people that the robot sees.")] = True
    robot_controls: Annotated[bool, Rule("The Robot panel: gestures, lights, volume and the like.")] = True


@dataclass(frozen=True, slots=True)
class _PoseKeys:
    """A pose as people write it, with its heading in degrees."""

    x_m: Annotated[_Coordinate, Rule("Along x of the map.")]
    y_m: Annotated[_Coordinate, Rule("Along y of the map.")]
    heading_deg: Annotated[
        float,
        Rule(
            "Where the robot looks on arrival: 0 along x, 90 along y, counter-clockwise.",
            unit="degrees",
            at_least=-360,
            at_most=360,
        ),
    ] = 0.0

    def pose(self) -> Pose2D:
        return Pose2D(self.x_m, self.y_m, math.radians(self.heading_deg))


def _pose_keys(pose: Pose2D) -> _PoseKeys:
    return _PoseKeys(round(pose.x_m, 4), round(pose.y_m, 4), round(math.degrees(pose.heading_rad), 3))


@dataclass(frozen=True, slots=True)
class Place:
    """A named place in the map."""

    name: Annotated[_Label, Rule("How the wizard finds it; each name once.")]
    pose_in_map: Annotated[Pose2D, Spread(_PoseKeys, _PoseKeys.pose, _pose_keys)]


AssistantPeople = Literal["numbers", "names", "history"]


@dataclass(frozen=True, slots=True)
class AssistantSettings:
    """How the language model is asked."""

    model: Annotated[
        str,
        Rule(
            "The model of this program, or one of an Ollama or OpenAI-compatible server.",
            pattern="^(embedded|ollama:.+|openai:.+)$",
            allowed="embedded, ollama:NAME or openai:NAME.",
        ),
    ] = "embedded"
    system_prompt: Annotated[str, Rule("What the model is told before the conversation.", longest=8000)] = ""
    max_tokens: Annotated[int, Rule("The longest answer, in tokens.", at_least=1, at_most=8192)] = 96
    temperature: Annotated[float, Rule("0: always the likeliest word; more: more varied.", at_least=0, at_most=2)] = 0.4
    people: Annotated[
        AssistantPeople,
        Rule(
            "What the model is told of who is here: `person 3`; their names; or with their names also group, tags, "
            "note and what there was before. Names go to the model's computer, and never into the recording.",
            quiet=True,
        ),
    ] = "numbers"
    pictures: Annotated[
        bool,
        Rule("Photos may be given to the model with a question. `embedded` sees none.", quiet=True),
    ] = False


@dataclass(frozen=True, slots=True)
class DrivingLimits:
    """Speeds at the full speed setting; the robot profile's own limits still apply."""

    max_forward_mps: Annotated[float, Rule("Forwards.", unit="metres a second", more_than=0, at_most=3)] = 0.5
    max_turn_radps: Annotated[float, Rule("Turning.", unit="radians a second", more_than=0, at_most=6)] = 1.0


@dataclass(frozen=True, slots=True)
class RecordingSettings:
    """What recordings of this scenario need."""

    labels: Annotated[
        tuple[Annotated[str, Rule(shortest=1, longest=40)], ...],
        Rule("Labels of marks, on Shift+F1 to Shift+F8 in this order.", longest=8, unique=True, quiet=True),
    ] = ()
    lsl: Annotated[
        bool,
        Rule(
            "Marks with their labels also go out on a Lab Streaming Layer outlet, for anybody on the network.",
            quiet=True,
        ),
    ] = False
    lsl_words: Annotated[
        bool,
        Rule(
            "With `lsl`: all events go out, with every word that was said and written. Anybody on the network can hear "
            "them.",
            quiet=True,
        ),
    ] = False


@dataclass(frozen=True, slots=True)
class PerceptionSettings:
    """How people are found in the pictures of the cameras, and what is found out about them."""

    model: Annotated[
        str,
        Rule(
            "The detector: a .pt, .onnx or .tflite file or a folder for OpenVINO, by its path, beside the scenario or "
            "in a models folder, or an `https://` address; the usual one if empty.",
            longest=1000,
            quiet=True,
        ),
    ] = ""
    sha256: Annotated[
        str,
        Rule(
            "The checksum of that file, without which no address and no .pt file is used.",
            pattern="^([0-9a-fA-F]{64})?$",
            allowed="the 64 digits that sha256sum prints.",
            quiet=True,
        ),
    ] = ""
    input_px: Annotated[
        int,
        Rule(
            "The longer side of what the detector sees, where its file leaves that open: more finds people farther "
            "away, and takes longer.",
            unit="pixels",
            at_least=160,
            at_most=1920,
            quiet=True,
        ),
    ] = 416
    device: Annotated[
        Literal["auto", "cpu", "cuda", "mps"],
        Rule(
            "What computes: `auto` is a graphics processor that is here and can be used, or else the processor.",
            quiet=True,
        ),
    ] = "auto"
    server: Annotated[
        str,
        Rule(
            "Address of a `caris-desktop perceive --serve` that finds people in this computer's place; its token is in "
            "the environment variable CARIS_PERCEPTION_TOKEN.",
            pattern="^(wss?://.+)?$",
            allowed="wss://HOST:PORT, or ws://HOST:PORT on this computer.",
            longest=300,
            quiet=True,
        ),
    ] = ""
    tracker: Annotated[
        Literal["own", "deepsort", "bytetrack", "botsort"],
        Rule(
            "What follows people from picture to picture: this program's own, or one of others to compare with.",
            quiet=True,
        ),
    ] = "own"
    classes: Annotated[
        tuple[Annotated[str, Rule(shortest=1, longest=40)], ...],
        Rule(
            "Things beside people that are boxed, recorded and told to the assistant, by the detector's names.",
            longest=80,
            unique=True,
            quiet=True,
        ),
    ] = ()

    recognise: Annotated[
        Literal["nobody", "clothing", "faces"],
        Rule(
            "Who returns is recognised by their clothes until midnight; with `faces` also by the face of those for "
            "whom consent is noted, where the study has a network for faces. Never without `naming_people`."
        ),
    ] = "clothing"
    confirm_at: Annotated[
        float,
        Rule(
            "How sure the console has to be, over several looks, to decide by itself who it is; at 1 it never does.",
            at_least=0.5,
            at_most=1,
        ),
    ] = 0.95


@dataclass(frozen=True, slots=True)
class BlurSettings:
    """Who is made unrecognisable, by flat blocks, in every picture that is kept: videos, photos, what is made of them.

    A picture in which it is not known in time where people are is pixelated as a whole.
    """

    who: Annotated[
        BlurWho,
        Rule(
            "`without_consent`: everybody but those for whom consent is noted in the People panel: to be filmed in "
            "videos, to photos in photos."
        ),
    ] = "nobody"
    what: Annotated[Literal["faces", "persons"], Rule("Heads alone, or whole bodies.")] = "persons"
    shown: Annotated[bool, Rule("The pictures in the window are pixelated too, for whoever else looks at it.")] = False


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """One camera that the console shows, perceives and records."""

    source: Annotated[str, Rule(
        "`robot` for all that the robot has, `robot:NAME` for one of them; `oak`, a device number, `/dev/videoN`, a "
        "video file, `simulated`, or an address that begins with `rtsp://`, `http://`, `whep+http://` or "
        "`webrtc+http://`.",
        shortest=1, longest=1000,
    )]  # fmt: skip
    name: Annotated[str, Rule(
        "What it is called in the window and in file names; if not given, what follows from the source. Those of the "
        "robot are called as in its profile.",
        longest=40, quiet=True,
    )] = ""  # fmt: skip
    mount: Annotated[CameraModel | None, WrittenAs(CameraModelKeys, CameraModelKeys.model, CameraModelKeys.of), Rule(
        "Where it is on the robot and what it sees, as in a robot profile: then its people have places in the map.",
        some_of=("horizontal_fov_deg", "fx_px"), needs="a mount has either horizontal_fov_deg or fx_px.", quiet=True,
    )] = None  # fmt: skip
    place: Annotated[str, Rule(
        "The name of one of the `places`: the camera stands there, as on a desk, rather than on the robot, and looks "
        "the way the place does. Together with `mount`, which is seen from there.",
        longest=80, quiet=True, beside=("mount",),
    )] = ""  # fmt: skip


@dataclass(frozen=True, slots=True)
class Scenario:
    """What one kind of study needs of the console: layout, permissions, phrases, prompts and places. Never code."""

    title: Annotated[_Label, Rule("Shown in the window and in the scenario menu.")]
    layout: Annotated[LayoutNode, Rule("Where the panels are.", order=1)]
    description: Annotated[str, Rule("What the study is about, for whoever chooses a scenario.", longest=2000)] = ""
    robot: Annotated[
        str,
        Rule(
            "Name of a robot profile, or the address of a rosbridge: `ws://HOST:PORT`.",
            shortest=1,
            longest=300,
        ),
    ] = DEFAULT_ROBOT
    voice: Annotated[Literal["robot", "computer"], Rule("Who speaks: the robot's own voice, or this computer.")] = (
        "robot"
    )
    phrases: Annotated[tuple[_Sentence, ...], Rule("One-click sentences, on F1 to F8 in this order.", longest=8)] = ()
    cameras: Annotated[
        tuple[CameraSettings, ...],
        Rule("The cameras to show, perceive and record: the robot's own if not given.", longest=6, quiet=True),
    ] = (CameraSettings("robot"),)
    filler: Annotated[str, Rule("What the robot says while the wizard thinks, on F9.", longest=500)] = ""
    places: Annotated[tuple[Place, ...], Rule("Named places in the map.", longest=100)] = ()
    controls: Annotated[
        tuple[CONTROL, ...],
        Rule("Controls that this scenario adds to the Robot panel, after the robot's own.", longest=100, quiet=True),
    ] = ()
    permissions: Permissions = field(default_factory=Permissions)
    recording: Annotated[RecordingSettings, Rule(quiet=True)] = field(default_factory=RecordingSettings)
    perception: Annotated[PerceptionSettings, Rule(quiet=True)] = field(default_factory=PerceptionSettings)
    blur: Annotated[BlurSettings, Rule(quiet=True)] = field(default_factory=BlurSettings)
    driving: DrivingLimits = field(default_factory=DrivingLimits)
    assistant: AssistantSettings = field(default_factory=AssistantSettings)
    path: Annotated[Path | None, NotInFile()] = None
    sha256: Annotated[str, NotInFile()] = ""
    version: Annotated[Literal[1], Rule("Version of this file format.", wanted=True, order=-1)] = SCENARIO_VERSION

    @property
    def covers_people(self) -> bool:
        """Whether people have to be found in time, so that they can be covered in pictures that are kept or shown."""
        pictures = self.permissions.video_recording or self.permissions.photos or self.blur.shown
        return self.blur.who != "nobody" and pictures
