"""Schema of scenarios: layout, permissions, phrases, prompts, places. Plain data, never code.

Settings are declared only here. Validation, messages, the JSON Schema for editors and the guide page derive from these
declarations; ``python -m caris_desktop.app.generated_reference`` rewrites the latter two.
"""

import math
from collections.abc import Iterable
from dataclasses import field
from pathlib import Path
from typing import Annotated, Literal, get_args

from caris_desktop.domain.camera_keys import CameraModelKeys
from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.control_definitions import CONTROL
from caris_desktop.domain.events import AssistanceLevel, AssistedFunction
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.intents import Permission
from caris_desktop.domain.schema_fields import Excluded, FieldSpec, Flattened, StoredAs
from caris_desktop.domain.value_class import dataclass
from caris_desktop.scenario.assistance import AssistanceSettings
from caris_desktop.scenario.assistant_settings import AssistantSettings
from caris_desktop.scenario.checklist_settings import PreflightEntry
from caris_desktop.scenario.face_settings import FaceSettings
from caris_desktop.scenario.gestures import MOST_GESTURES, Gesture
from caris_desktop.scenario.listening_settings import ListeningSettings
from caris_desktop.scenario.panel_settings import PanelSettings
from caris_desktop.scenario.phrases import PhraseEntry, Sentence
from caris_desktop.scenario.protocol_steps import ProtocolSettings
from caris_desktop.scenario.recording_settings import RecordingSettings
from caris_desktop.scenario.sound_settings import SoundSettings
from caris_desktop.scenario.voice_settings import VoiceSettings

SCENARIO_VERSION: Literal[1] = 1
DEFAULT_ROBOT = "simulated"

PanelName = Literal[
    "video", "map", "drive", "people", "speak", "assistant", "session", "robot", "motion", "diagnostics", "photos",
    "conversation",
    "face", "notes",
]  # fmt: skip

BlurWho = Literal["nobody", "everybody", "without_consent"]
_Panel = Annotated[PanelName, FieldSpec(noun="panel")]
_Label = Annotated[str, FieldSpec(shortest=1, longest=80)]
_Coordinate = Annotated[float, FieldSpec(unit="metres", at_least=-10_000, at_most=10_000)]


@dataclass(frozen=True, slots=True)
class PanelLeaf:
    """One panel."""

    panel: Annotated[_Panel, FieldSpec("Its name.")]


@dataclass(frozen=True, slots=True)
class TabNode:
    """Panels on top of one another."""

    tabs: Annotated[tuple[_Panel, ...], FieldSpec("The panels, from left to right.", shortest=1)]
    current: Annotated[_Panel | None, FieldSpec("The tab that is shown first.")] = None


@dataclass(frozen=True, slots=True)
class SplitNode:
    """Parts side by side or on top of one another."""

    split: Annotated[
        Literal["horizontal", "vertical"], FieldSpec("`horizontal`: side by side; `vertical`: on top of one another.")
    ]
    children: Annotated[tuple["LayoutNode", ...], FieldSpec("The parts, from left or top.", shortest=2, order=1)]
    weights: Annotated[
        tuple[Annotated[float, FieldSpec(more_than=0)], ...],
        FieldSpec("The size of each part in relation to the others; all the same where they are not given."),
    ] = ()

    def __post_init__(self) -> None:
        if not self.weights:
            object.__setattr__(self, "weights", (1.0,) * len(self.children))


LayoutNode = Annotated[
    PanelLeaf | TabNode | SplitNode,
    FieldSpec(
        "One panel, tabs on top of one another, or a split into parts sized by weights.",
        noun="layout part",
        needs="a layout part needs 'panel: NAME', 'tabs: [NAMES]', or 'split' with 'children'.",
    ),
]


@dataclass(frozen=True, slots=True)
class Permissions:
    """What the wizard may do in this scenario. Whatever is false has no button, no shortcut and no effect."""

    photos: Annotated[bool, FieldSpec("Photos of what the robot sees, kept as files.")] = True
    video_recording: Annotated[bool, FieldSpec("Recordings hold the robot's pictures.")] = True
    audio_recording: Annotated[
        bool, FieldSpec("Recordings hold microphones and the robot's voice; off unless set.")
    ] = False
    driving: Annotated[bool, FieldSpec("Keys, gamepad, places and whatever else moves the robot.")] = True
    assistant: Annotated[bool, FieldSpec("Questions to a language model.")] = True
    naming_people: Annotated[bool, FieldSpec("Names for the people that the robot sees.", title="Names for people")] = (
        True
    )
    robot_controls: Annotated[bool, FieldSpec("The Robot panel: gestures, lights, volume and the like.")] = True
    transcription: Annotated[
        bool, FieldSpec("What is said near the robot is turned into text; off unless set.", quiet=True)
    ] = False
    own_voice: Annotated[bool, FieldSpec("The wizard speaks through the robot; off unless set.", quiet=True)] = False
    cloud_models: Annotated[
        bool,
        FieldSpec(
            "Models on other computers: language models, transcription, detection of people. `false`: nothing leaves "
            "this one.",
            quiet=True,
        ),
    ] = True
    face: Annotated[
        bool, FieldSpec("A face of the robot, in a window or on a page of its own; off unless set.", quiet=True)
    ] = False
    speech: Annotated[
        bool,
        FieldSpec("The robot speaks: what is typed, phrases, fillers, answers of the language model.", quiet=True),
    ] = True
    notes: Annotated[bool, FieldSpec("Notes of the wizard, kept with the session.", quiet=True)] = True

    def withheld(self, needed: Iterable[Permission]) -> Permission | None:
        """First missing permission; None if all are granted."""
        return next((permission for permission in needed if not getattr(self, permission)), None)


@dataclass(frozen=True, slots=True)
class _PoseKeys:
    """A pose as people write it, with its heading in degrees."""

    x_m: Annotated[_Coordinate, FieldSpec("Along x of the map.", title="x")]
    y_m: Annotated[_Coordinate, FieldSpec("Along y of the map.", title="y")]
    heading_deg: Annotated[
        float,
        FieldSpec(
            "Where the robot looks on arrival: 0 along x, 90 along y, counter-clockwise.",
            title="Heading",
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

    name: Annotated[_Label, FieldSpec("How the wizard finds it; each name once.")]
    pose_in_map: Annotated[Pose2D, Flattened(_PoseKeys, _PoseKeys.pose, _pose_keys)]


@dataclass(frozen=True, slots=True)
class DrivingLimits:
    """Speeds at the full speed setting; the robot profile's own limits still apply."""

    max_forward_mps: Annotated[
        float, FieldSpec("Forwards.", title="Fastest forwards", unit="metres a second", more_than=0, at_most=3)
    ] = 0.5
    max_turn_radps: Annotated[
        float, FieldSpec("Turning.", title="Fastest turn", unit="radians a second", more_than=0, at_most=6)
    ] = 1.0


@dataclass(frozen=True, slots=True)
class PerceptionSettings:
    """How people are found in the pictures of the cameras, and what is found out about them."""

    model: Annotated[
        str,
        FieldSpec(
            title="Detector",
            external="model",
            text="The detector: a .pt, .onnx or .tflite file or a folder for OpenVINO, by its path, beside the "
            "scenario or in a models folder, or an `https://` address; the usual one if empty.",
            longest=1000,
            quiet=True,
        ),
    ] = ""
    sha256: Annotated[
        str,
        FieldSpec(
            "The checksum of that file, without which no address and no .pt file is used.",
            title="Checksum (SHA-256)",
            pattern="^([0-9a-fA-F]{64})?$",
            allowed="the 64 digits that sha256sum prints.",
            quiet=True,
        ),
    ] = ""
    input_px: Annotated[
        int,
        FieldSpec(
            "The longer side of what the detector sees, where its file leaves that open: more finds people farther "
            "away, and takes longer.",
            title="Picture size for finding",
            unit="pixels",
            at_least=160,
            at_most=1920,
            quiet=True,
        ),
    ] = 416
    device: Annotated[
        Literal["auto", "cpu", "cuda", "mps"],
        FieldSpec(
            title="Computed by",
            text="What computes: `auto` is a graphics processor that is here and can be used, or else the processor.",
            quiet=True,
        ),
    ] = "auto"
    server: Annotated[
        str,
        FieldSpec(
            "Address of a `caris-desktop perceive --serve` that finds people in this computer's place; its token is in "
            "the environment variable CARIS_PERCEPTION_TOKEN, and goes only to the server in CARIS_PERCEPTION_SERVER.",
            pattern="^(wss?://.+)?$",
            external="address",
            allowed="wss://HOST:PORT, or ws://HOST:PORT on this computer.",
            longest=300,
            quiet=True,
        ),
    ] = ""
    tracker: Annotated[
        Literal["own", "deepsort", "bytetrack", "botsort"],
        FieldSpec(
            "What follows people from picture to picture: this program's own, or one of others to compare with.",
            quiet=True,
        ),
    ] = "own"
    classes: Annotated[
        tuple[Annotated[str, FieldSpec(shortest=1, longest=40)], ...],
        FieldSpec(
            "Things beside people that are boxed, recorded and told to the assistant, by the detector's names.",
            longest=80,
            unique=True,
            quiet=True,
        ),
    ] = ()

    recognise: Annotated[
        Literal["nobody", "clothing", "faces"],
        FieldSpec(
            "Who returns is recognised by their clothes until midnight; with `faces` also by the face of those for "
            "whom consent is noted, where the study has a network for faces. Never without `naming_people`."
        ),
    ] = "clothing"
    ask_at: Annotated[
        float,
        FieldSpec(
            "How likely somebody has to be a known person for the wizard to be asked whether it is them.",
            title="Ask from",
            at_least=0.7,
            at_most=1,
            quiet=True,
        ),
    ] = 0.7
    confirm_at: Annotated[
        float,
        FieldSpec(
            "How sure the console has to be, over several looks, to decide by itself who it is; at 1 it never does.",
            title="Sure enough at",
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
        FieldSpec(
            "`without_consent`: everybody but those for whom consent is noted in the People panel: to be filmed in "
            "videos, to photos in photos."
        ),
    ] = "nobody"
    what: Annotated[Literal["faces", "persons"], FieldSpec("Heads alone, or whole bodies.")] = "persons"
    shown: Annotated[
        bool,
        FieldSpec(
            "The pictures in the window are pixelated too, for whoever else looks at it.", title="In the window, too"
        ),
    ] = False


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """One camera that the console shows, perceives and records."""

    source: Annotated[str, FieldSpec(
        "`robot` for all that the robot has, `robot:NAME` for one of them; `oak`, a device number, `/dev/videoN`, a "
        "video file, `simulated`, or an address that begins with `rtsp://`, `http://`, `whep+http://` or "
        "`webrtc+http://`.",
        shortest=1, longest=1000, external="camera",
    )]  # fmt: skip
    name: Annotated[str, FieldSpec(
        "What it is called in the window and in file names; if not given, what follows from the source. Those of the "
        "robot are called as in its profile.",
        longest=40, quiet=True,
    )] = ""  # fmt: skip
    mount: Annotated[CameraModel | None,
                     StoredAs(CameraModelKeys, CameraModelKeys.model, CameraModelKeys.of), FieldSpec(
        "Where it is on the robot and what it sees, as in a robot profile: then its people have places in the map.",
        some_of=("horizontal_fov_deg", "fx_px"), needs="a mount has either horizontal_fov_deg or fx_px.", quiet=True,
    )] = None  # fmt: skip
    place: Annotated[str, FieldSpec(
        "The name of one of the `places`: the camera stands there, as on a desk, rather than on the robot, and looks "
        "the way the place does. Together with `mount`, which is seen from there.",
        refers=("places", "name"),
        longest=80, quiet=True, beside=("mount",),
    )] = ""  # fmt: skip


@dataclass(frozen=True, slots=True)
class Scenario:
    """What one kind of study needs of the console: layout, permissions, phrases, prompts and places. Never code."""

    title: Annotated[_Label, FieldSpec("Shown in the window and in the scenario menu.", section="About")]
    layout: Annotated[LayoutNode, FieldSpec("Where the panels are.", title="Arrangement", section="Panels", order=1)]
    layout_compact: Annotated[
        LayoutNode | None,
        FieldSpec(
            "Where they are on a small screen; if not given, the least important of the layout become tabs there.",
            title="Arrangement on a small screen",
            section="Panels",
            order=1,
            quiet=True,
        ),
    ] = None
    layout_large: Annotated[
        LayoutNode | None,
        FieldSpec(
            "Where they are on a large screen; if not given, tabs of the layout are spread as far as there is room.",
            title="Arrangement on a large screen",
            section="Panels",
            order=1,
            quiet=True,
        ),
    ] = None
    description: Annotated[
        str,
        FieldSpec(
            "What the study is about, for whoever chooses a scenario.", section="About", prose=True, longest=2000
        ),
    ] = ""
    robot: Annotated[
        str,
        FieldSpec(
            "Name of a robot profile, or the address of a rosbridge: `ws://HOST:PORT`.",
            section="Robot and cameras",
            knows="robots",
            external="robot",
            shortest=1,
            longest=300,
        ),
    ] = DEFAULT_ROBOT
    voice: Annotated[
        Literal["robot", "computer", "both"],
        FieldSpec("Who speaks: the robot's own voice, this computer, or both at once.", section="Voice and sound"),
    ] = "robot"
    speech: Annotated[
        VoiceSettings, FieldSpec(title="This computer's voice", section="Voice and sound", quiet=True)
    ] = field(default_factory=VoiceSettings)
    phrases: Annotated[
        tuple[PhraseEntry, ...],
        FieldSpec(
            "One-click sentences, on F1 to F8 in this order: plain, with what goes along with them, or in groups. "
            "`{name}` stands for whom it is said to and `{place}` for where the robot goes or stands; other words in "
            "braces, and what is not known, are asked for before anything is said.",
            section="Phrases",
            longest=24,
        ),
    ] = ()
    cameras: Annotated[
        tuple[CameraSettings, ...],
        FieldSpec(
            "The cameras to show, perceive and record: the robot's own if not given.",
            section="Robot and cameras",
            longest=6,
            quiet=True,
        ),
    ] = (CameraSettings("robot"),)
    filler: Annotated[
        str, FieldSpec("What the robot says while the wizard thinks, on F9.", section="Phrases", longest=500)
    ] = ""
    fillers: Annotated[
        tuple[Sentence, ...],
        FieldSpec(
            "More of them: F9 takes the next one each time.",
            title="More fillers",
            section="Phrases",
            longest=20,
            quiet=True,
            beside=("filler",),
        ),
    ] = ()
    gestures: Annotated[
        tuple[Gesture, ...],
        FieldSpec(
            "What the robot does without a word, on Ctrl+4 to Ctrl+9 in this order or on keys of their own. What the "
            "robot at hand cannot do is not shown.",
            section="Phrases",
            longest=MOST_GESTURES,
            quiet=True,
        ),
    ] = ()
    places: Annotated[tuple[Place, ...], FieldSpec("Named places in the map.", section="Places", longest=100)] = ()
    preflight: Annotated[
        tuple[PreflightEntry, ...],
        FieldSpec(
            "What the wizard ticks by hand before a recording, after what the console checks by itself.",
            title="Checks by hand before a recording",
            section="Recording",
            longest=20,
            quiet=True,
        ),
    ] = ()
    protocol: Annotated[ProtocolSettings, FieldSpec(section="Protocol", quiet=True)] = field(
        default_factory=ProtocolSettings
    )
    controls: Annotated[
        tuple[CONTROL, ...],
        FieldSpec(
            "Controls that this scenario adds to the Robot panel, after the robot's own.",
            title="More controls",
            section="Robot and cameras",
            longest=100,
            quiet=True,
        ),
    ] = ()
    notes: Annotated[
        str,
        FieldSpec(
            "What the wizard wants to have at hand in a session, shown in the Notes panel.",
            title="Notes for the wizard",
            section="About",
            prose=True,
            longest=4000,
            quiet=True,
        ),
    ] = ""
    permissions: Annotated[Permissions, FieldSpec(section="What is allowed")] = field(default_factory=Permissions)
    panels_off: Annotated[
        tuple[_Panel, ...],
        FieldSpec(
            "Panels that are not offered in this scenario: not in the layout, in no menu, by no key.",
            title="Panels that are left out",
            section="What is allowed",
            longest=len(get_args(PanelName)),
            unique=True,
            quiet=True,
        ),
    ] = ()
    panels: Annotated[PanelSettings, FieldSpec(title="What panels show at first", section="Panels", quiet=True)] = (
        field(default_factory=PanelSettings)
    )
    recording: Annotated[RecordingSettings, FieldSpec(section="Recording", quiet=True)] = field(
        default_factory=RecordingSettings
    )
    perception: Annotated[PerceptionSettings, FieldSpec(title="Finding people", section="People", quiet=True)] = field(
        default_factory=PerceptionSettings
    )
    sound: Annotated[
        SoundSettings, FieldSpec(title="Microphone and loudspeaker", section="Voice and sound", quiet=True)
    ] = field(default_factory=SoundSettings)
    blur: Annotated[BlurSettings, FieldSpec(title="Making people unrecognisable", section="People", quiet=True)] = (
        field(default_factory=BlurSettings)
    )
    face: Annotated[FaceSettings, FieldSpec(title="The robot's face", section="Robot and cameras", quiet=True)] = field(
        default_factory=FaceSettings
    )
    listening: Annotated[ListeningSettings, FieldSpec(section="Listening", quiet=True)] = field(
        default_factory=ListeningSettings
    )
    driving: Annotated[DrivingLimits, FieldSpec(section="Robot and cameras")] = field(default_factory=DrivingLimits)
    assistant: Annotated[AssistantSettings, FieldSpec(section="Assistant")] = field(default_factory=AssistantSettings)
    assistance: Annotated[
        AssistanceSettings, FieldSpec(title="What it does by itself", section="Assistant", quiet=True)
    ] = field(default_factory=AssistanceSettings)
    path: Annotated[Path | None, Excluded()] = None
    sha256: Annotated[str, Excluded()] = ""
    version: Annotated[Literal[1], FieldSpec("Version of this file format.", wanted=True, order=-1)] = SCENARIO_VERSION

    @property
    def every_filler(self) -> tuple[str, ...]:
        return (self.filler, *self.fillers) if self.filler else ()

    def next_filler(self, said: int) -> str:
        """Fillers in rotation, after ``said`` of them; empty without any."""
        return self.every_filler[said % len(self.every_filler)] if self.filler else ""

    def highest_level(self, function: AssistedFunction) -> AssistanceLevel:
        """Highest permitted automation level: off without permission for the language model or for speech, as
        applicable.
        """
        if function != "fillers" and not self.permissions.assistant:
            return "off"
        if function != "actions" and not self.permissions.speech:
            return "off"
        level: AssistanceLevel = getattr(self.assistance, function)
        return level

    @property
    def assisted(self) -> tuple[AssistedFunction, ...]:
        """Functions with automation or suggestions."""
        functions: tuple[AssistedFunction, ...] = get_args(AssistedFunction)
        return tuple(function for function in functions if self.highest_level(function) != "off")

    @property
    def covers_people(self) -> bool:
        """True if people must be detected in time to be blurred in stored or displayed images."""
        pictures = self.permissions.video_recording or self.permissions.photos or self.blur.shown
        return self.blur.who != "nobody" and pictures
