"""Schema of scenarios: layout, permissions, phrases, prompts, places. Plain data, never code.

Settings are declared only here. Validation, messages, the JSON Schema for editors and the guide page derive from these
declarations; ``python -m caris_desktop.app.generated_reference`` rewrites the latter two.
"""

import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from caris_desktop.domain.camera_projection import CameraModel, CameraModelKeys
from caris_desktop.domain.control_definitions import CONTROL
from caris_desktop.domain.events import AssistanceLevel, AssistedFunction
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.intents import Permission, PromptPart, SizeClass
from caris_desktop.domain.plugins import NAME_PATTERN
from caris_desktop.domain.schema_fields import (
    Excluded,
    FieldSpec,
    Flattened,
    KeyPath,
    Problem,
    StoredAs,
    data_of,
    value_from,
)
from caris_desktop.domain.schema_validation import allowed_words, problems
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value, setting
from caris_desktop.scenario.phrases import MOST_GESTURES, Gesture, PhraseEntry, Sentence
from caris_desktop.scenario.protocol_steps import ProtocolSettings

CheckTitle = Annotated[str, FieldSpec(shortest=1, longest=80)]


class ManualCheck(Value):
    """A check with what to do about it."""

    check: CheckTitle
    """Condition to check, as shown to the wizard."""
    advice: str = setting(default="", longest=300, quiet=True)
    """What to do if the condition is not met."""
    needed: bool = setting(default=True, quiet=True)
    """`false`: a recording starts without asking, even if this check is not ticked."""


PreflightEntry = CheckTitle | ManualCheck


def manual_checks(entries: tuple[PreflightEntry, ...]) -> tuple[ManualCheck, ...]:
    """Checks in full form, without duplicate titles."""
    full = (entry if isinstance(entry, ManualCheck) else ManualCheck(entry) for entry in entries)
    return tuple({each.check: each for each in full}.values())


ERROR_KEYS = "FGHRUX"
"""Keys near the driving hand, or without another function: a digit that comes too late would send the robot to a
place."""

_ErrorName = Annotated[str, FieldSpec(shortest=1, longest=40)]


class ErrorKind(Value):
    """A kind of wizard error with what is meant by it."""

    kind: _ErrorName
    """Word that is recorded and shown on its button."""
    meaning: str = setting(default="", longest=200)
    """Meaning, for the person who marks it."""


ErrorEntry = _ErrorName | ErrorKind
USUAL_ERRORS = (
    ErrorKind(QT_TR_NOOP("slip"), QT_TR_NOOP("You did something unintended: a wrong key, a wrong phrase.")),
    ErrorKind(QT_TR_NOOP("late"), QT_TR_NOOP("You did the right thing too late.")),
    ErrorKind(QT_TR_NOOP("wrong branch"), QT_TR_NOOP("You continued with the wrong step or answer.")),
)
"""The recorded words stay English; what is shown of them is translated."""


class RecordingSettings(Value):
    """Recording settings of this scenario."""

    labels: tuple[Annotated[str, FieldSpec(shortest=1, longest=40)], ...] = setting(
        default=(), title="Mark labels", longest=8, unique=True, quiet=True
    )
    """Mark labels, on Shift+F1 to Shift+F8 in this order."""
    errors: tuple[ErrorEntry, ...] = setting(
        default=(), title="Kinds of wizard error", longest=len(ERROR_KEYS), unique=True, quiet=True
    )
    """Kinds of wizard error, offered on F, G, H, R, U and X in this order when an error is marked: plain, or with a
    meaning. If not given: slip, late, wrong branch."""
    lsl: bool = setting(default=False, title="Send marks to the lab's network (LSL)", external="network", quiet=True)
    """Marks with their labels, and the steps of the protocol, are also sent to a Lab Streaming Layer outlet, for
    anybody on the network."""
    lsl_words: bool = setting(default=False, title="Send every word too", external="network", quiet=True)
    """With `lsl`: all events are sent, with every spoken and written word. Anybody on the network can read them."""

    @property
    def error_kinds(self) -> tuple[ErrorKind, ...]:
        """Error kinds in the order of their keys."""
        given = (each if isinstance(each, ErrorKind) else ErrorKind(each) for each in self.errors)
        return tuple(given) or USUAL_ERRORS


class MapSettings(Value):
    """The Map panel."""

    follow: bool = setting(default=False, title="Follows the robot")
    """The robot stays in the centre, zoomed in; otherwise the whole map is shown."""
    up: Literal["north", "robot"] = setting(default="north", title="Up is")
    """Direction that points up: north, or the robot's heading. With the heading, the map rotates with the robot."""
    trail: bool = setting(default=True, title="Shows the driven path")
    """The robot's driven path is drawn."""


class VideoSettings(Value):
    """The Video panel."""

    camera: str = setting(default="", longest=40)
    """Name of the camera to show, as soon as it is available; the first one if not given."""


class DriveSettings(Value):
    """The Drive panel."""

    first: Literal["arrows", "stick", "head"] = setting(default="arrows", title="Shown first")
    """Control to show if there is not enough room for all three."""


class LogSettings(Value):
    """The log in the Session panel."""

    shows: Literal["everything", "said", "moved", "people", "session", "problems"] = "everything"
    """Kind of events to list."""


class QuestionSettings(Value):
    """The Assistant panel."""

    left_out: tuple[PromptPart, ...] = setting(default=(), longest=6, unique=True)
    """Context that is not sent with a question, unless the wizard adds it."""


class PanelSettings(Value):
    """How panels are when the scenario is opened. The wizard can change each of it, and finds it so the next time;
    another scenario has its own.
    """

    map: MapSettings = setting(default_factory=MapSettings, quiet=True)
    video: VideoSettings = setting(default_factory=VideoSettings, quiet=True)
    drive: DriveSettings = setting(default_factory=DriveSettings, quiet=True)
    session: LogSettings = setting(default_factory=LogSettings, quiet=True)
    assistant: QuestionSettings = setting(default_factory=QuestionSettings, quiet=True)


def levels_up_to(highest: AssistanceLevel) -> tuple[AssistanceLevel, ...]:
    """Levels that a scenario with that maximum permits, from off upwards."""
    levels: tuple[AssistanceLevel, ...] = get_args(AssistanceLevel)
    return levels[: levels.index(highest) + 1]


class AssistanceSettings(Value):
    """Automation level of each function: `off`, `suggest` (the wizard's key carries it out) or `act` (carried out after
    a countdown that the wizard sees and can stop). During a session, the wizard can lower each level, and raise it
    again to the level in the scenario. Actions that move the robot always wait for the wizard's key.
    """

    replies: AssistanceLevel = "suggest"
    """Replies to participants, from the language model. With `act`, the first reply is said."""
    fillers: AssistanceLevel = "off"
    """The filler when no reply arrives in time: `suggest` highlights its key, `act` says it."""
    actions: AssistanceLevel = "off"
    """Next actions of the robot, from the language model: places, gestures, controls, photos. With `act`, actions
    without motion are carried out."""
    countdown_s: float = setting(default=3.0, title="Countdown", unit="seconds", at_least=1, at_most=30)
    """Time for the wizard to stop an automatic action."""
    filler_after_s: float = setting(
        default=1.5, title="A reply is late after", unit="seconds", at_least=0.5, at_most=30
    )
    """Time after a participant's last word from which a reply is late."""


PROMPT_CHARACTERS, TEXT_CHARACTERS = 8000, 4000
"""The longest system prompt, and the longest of the other texts: in the file and as the wizard changes them."""
MODEL_PATTERN = "^((embedded|plugin):[A-Za-z0-9][A-Za-z0-9._-]*|embedded|ollama:.+|openai:.+|gemini:.+)$"
MODEL_ALLOWED = "embedded, embedded:NAME, ollama:NAME, openai:NAME, gemini:NAME or plugin:NAME."


class NamedText(Value):
    """A text that is selected by its name."""

    name: str = setting(shortest=1, longest=40)
    """Name shown to the wizard."""
    text: str = setting(prose=True, longest=TEXT_CHARACTERS)
    """The text itself."""


AssistantPeople = Literal["numbers", "names", "history"]


class AssistantSettings(Value):
    """Settings of the language model."""

    model: str = setting(default="embedded", pattern=MODEL_PATTERN, allowed=MODEL_ALLOWED, external="language_model")
    """The built-in model, one that was added to this program, a plug-in, or one of Ollama, of an OpenAI-compatible
    server or of Gemini."""
    system_prompt: str = setting(default="", prose=True, longest=PROMPT_CHARACTERS)
    """Instructions to the model before the conversation."""
    max_tokens: int = setting(default=96, title="Longest answer", at_least=1, at_most=8192)
    """Maximum length of an answer, in tokens."""
    temperature: float = setting(default=0.4, at_least=0, at_most=2)
    """0: always the most likely word; higher: more varied."""
    people: AssistantPeople = setting(default="numbers", title="Information about people", quiet=True)
    """Information for the model about the people present: `person 3`; their names; or their names with group, tags,
    note and history. Names are sent to the model's computer, and never saved in the recording."""
    pictures: bool = setting(default=False, quiet=True)
    """Pictures may be sent to the model with a question. `embedded` models do not accept pictures."""
    models: tuple[
        Annotated[str, FieldSpec(pattern=MODEL_PATTERN, allowed=MODEL_ALLOWED, external="language_model")], ...
    ] = setting(default=(), title="Further models", longest=20, unique=True, quiet=True)
    """Further models that the wizard may choose, in addition to the built-in one and those listed by Ollama and an
    OpenAI-compatible server on this computer."""
    roles: tuple[NamedText, ...] = setting(default=(), longest=20, quiet=True)
    """Roles of the model that the wizard can choose, one at a time; sent after `system_prompt`."""
    styles: tuple[NamedText, ...] = setting(default=(), longest=20, quiet=True)
    """Styles of the answers that the wizard can choose, one at a time; sent after the role."""
    templates: tuple[NamedText, ...] = setting(default=(), longest=20, quiet=True)
    """Prepared questions for the field; `{said}` stands for the participant's last utterance."""
    notes: str = setting(default="", prose=True, longest=4000, quiet=True)
    """Notes for the model, which the wizard can change."""


SCENARIO_VERSION: Literal[1] = 1
DEFAULT_ROBOT = "simulated"

BuiltInPanel = Literal[
    "video", "map", "drive", "people", "speak", "assistant", "session", "robot", "motion", "diagnostics", "photos",
    "conversation",
    "face", "notes",
]  # fmt: skip
PanelName = BuiltInPanel | str
"""``plugin:NAME`` for the panel of a plug-in."""
BlurWho = Literal["nobody", "everybody", "without_consent"]
_Panel = Annotated[
    PanelName,
    FieldSpec(noun="panel", pattern=rf"^plugin:{NAME_PATTERN[1:]}", allowed="plugin:NAME", external="panel"),
]
_Label = Annotated[str, FieldSpec(shortest=1, longest=80)]
_Coordinate = Annotated[float, FieldSpec(unit="metres", at_least=-10_000, at_most=10_000)]


class PanelLeaf(Value):
    """One panel."""

    panel: _Panel
    """Name of the panel."""


class TabNode(Value):
    """Panels on top of one another."""

    tabs: tuple[_Panel, ...] = setting(shortest=1)
    """The panels, from left to right."""
    current: _Panel | None = None
    """The tab that is shown first."""


class SplitNode(Value):
    """Parts side by side or on top of one another."""

    split: Literal["horizontal", "vertical"]
    """`horizontal`: side by side; `vertical`: one above the other."""
    children: tuple["LayoutNode", ...] = setting(shortest=2, order=1)
    """The parts, from the left or top."""
    weights: tuple[Annotated[float, FieldSpec(more_than=0)], ...] = ()
    """Relative size of each part; all equal if not given."""

    def __post_init__(self) -> None:
        if not self.weights:
            object.__setattr__(self, "weights", (1.0,) * len(self.children))


LayoutNode = Annotated[
    PanelLeaf | TabNode | SplitNode,
    FieldSpec(
        "One panel, a set of tabs, or a split into parts sized by weights.",
        noun="layout part",
        needs="a layout part requires 'panel: NAME', 'tabs: [NAMES]', or 'split' with 'children'.",
    ),
]


class Permissions(Value):
    """Permissions of the wizard in this scenario. A permission that is false has no button, no shortcut and no
    effect.
    """

    photos: bool = True
    """Photos of what the robot sees, saved as files."""
    video_recording: bool = True
    """Recordings include the robot's video."""
    audio_recording: bool = False
    """Recordings include microphones and the robot's voice; off by default."""
    driving: bool = True
    """Keys, gamepad, places and everything else that moves the robot."""
    assistant: bool = True
    """Questions to a language model."""
    naming_people: bool = setting(default=True, title="Names for people")
    """Names for the people that the robot sees."""
    robot_controls: bool = True
    """The Robot panel: gestures, lights, volume and similar controls."""
    transcription: bool = setting(default=False, quiet=True)
    """Speech near the robot is transcribed; off by default."""
    own_voice: bool = setting(default=False, quiet=True)
    """The wizard speaks through the robot; off by default."""
    cloud_models: bool = setting(default=True, quiet=True)
    """Models on other computers: language models, transcription, person detection. `false`: nothing leaves this
    computer."""
    face: bool = setting(default=False, quiet=True)
    """A face for the robot, in a separate window or on a web page; off by default."""
    speech: bool = setting(default=True, quiet=True)
    """The robot speaks: typed text, phrases, fillers, answers of the language model."""
    notes: bool = setting(default=True, quiet=True)
    """Notes of the wizard, saved with the session."""

    def withheld(self, needed: Iterable[Permission]) -> Permission | None:
        """First missing permission; None if all are granted."""
        return next((permission for permission in needed if not getattr(self, permission)), None)


class _PoseKeys(Value):
    """A pose as people write it, with its heading in degrees."""

    x_m: _Coordinate = setting(title="x")
    """Position along the x axis of the map."""
    y_m: _Coordinate = setting(title="y")
    """Position along the y axis of the map."""
    heading_deg: float = setting(default=0.0, title="Heading", unit="degrees", at_least=-360, at_most=360)
    """Heading of the robot on arrival: 0 along x, 90 along y, counter-clockwise."""

    def pose(self) -> Pose2D:
        return Pose2D(self.x_m, self.y_m, math.radians(self.heading_deg))


def _pose_keys(pose: Pose2D) -> _PoseKeys:
    return _PoseKeys(round(pose.x_m, 4), round(pose.y_m, 4), round(math.degrees(pose.heading_rad), 3))


class Place(Value):
    """A named place in the map."""

    name: _Label
    """Name shown to the wizard; must be unique."""
    pose_in_map: Annotated[Pose2D, Flattened(_PoseKeys, _PoseKeys.pose, _pose_keys)]


class DrivingLimits(Value):
    """Speeds at the full speed setting; the robot profile's own limits still apply."""

    max_forward_mps: float = setting(
        default=0.5, title="Top forward speed", unit="metres per second", more_than=0, at_most=3
    )
    """Forward speed."""
    max_turn_radps: float = setting(
        default=1.0, title="Top turn speed", unit="radians per second", more_than=0, at_most=6
    )
    """Turning speed."""


class PerceptionSettings(Value):
    """Detection of people in the camera pictures, and their recognition."""

    model: str = setting(default="", title="Detector", external="model", longest=1000, quiet=True)
    """The detector: a .pt, .onnx or .tflite file or an OpenVINO folder. Give its path, its name next to the scenario or
    in a models folder, or an `https://` address; `plugin:NAME` for a plug-in; the default one if empty."""
    sha256: str = setting(
        default="",
        title="Checksum (SHA-256)",
        pattern="^([0-9a-fA-F]{64})?$",
        allowed="the 64 digits that sha256sum prints.",
        quiet=True,
    )
    """Checksum of that file; required for an address and for a .pt file."""
    input_px: int = setting(
        default=416, title="Detector image size", unit="pixels", at_least=160, at_most=1920, quiet=True
    )
    """Longer side of the detector's input image, if its file does not fix the size. A larger image finds people farther
    away but takes longer."""
    device: Literal["auto", "cpu", "cuda", "mps"] = setting(default="auto", title="Compute device", quiet=True)
    """Device for detection: `auto` is a graphics processor if one can be used, otherwise the CPU."""
    server: str = setting(
        default="",
        pattern="^(wss?://.+)?$",
        external="address",
        allowed="wss://HOST:PORT, or ws://HOST:PORT on this computer.",
        longest=300,
        quiet=True,
    )
    """Address of a `caris-desktop perceive --serve` that detects people instead of this computer. Its token is in the
    environment variable CARIS_PERCEPTION_TOKEN and is sent only to the server in CARIS_PERCEPTION_SERVER."""
    tracker: str = setting(
        default="own",
        pattern=NAME_PATTERN,
        allowed="own, deepsort, bytetrack, botsort, or the name of a plug-in that is installed.",
        knows="trackers",
        external="tracker",
        quiet=True,
    )
    """Tracker that follows people from frame to frame: the built-in one (`own`), `deepsort`, `bytetrack` or `botsort`
    for comparison, or a plug-in that is installed, by its name."""
    classes: tuple[Annotated[str, FieldSpec(shortest=1, longest=40)], ...] = setting(
        default=(), longest=80, unique=True, quiet=True
    )
    """Objects other than people that are boxed, recorded and reported to the assistant, by the detector's class
    names."""

    recognise: Literal["nobody", "clothing", "faces"] = "clothing"
    """People who return are recognised by their clothing until midnight. With `faces`, people with noted consent are
    also recognised by face, if the study has a network for faces. Requires `naming_people`."""
    ask_at: float = setting(default=0.7, title="Ask from", at_least=0.7, at_most=1, quiet=True)
    """Minimum likelihood of a known person at which the wizard is asked to confirm the identity."""
    confirm_at: float = setting(default=0.95, title="Decide from", at_least=0.5, at_most=1)
    """Minimum confidence, over several detections, at which the console decides automatically who the person is; at 1
    it never does."""


class BlurSettings(Value):
    """Pixelation of people in all stored pictures: videos, photos and everything derived from them.

    A picture is pixelated as a whole if detection is too late for it.
    """

    who: BlurWho = "nobody"
    """`without_consent`: everybody except people whose consent is noted in the People panel. Videos require consent to
    filming, photos consent to photos."""
    what: Literal["faces", "persons"] = "persons"
    """Heads only, or whole bodies."""
    shown: bool = setting(default=False, title="In the window too")
    """The pictures in the window are pixelated too, in case other people see it."""


class CameraSettings(Value):
    """One camera that the console shows, uses for perception and records."""

    source: str = setting(shortest=1, longest=1000, external="camera")
    """`robot` for all cameras of the robot, `robot:NAME` for one of them; `oak`, a device number, `/dev/videoN`, a
    video file, `simulated`, `plugin:NAME` or `plugin:NAME:TARGET` for a plug-in, or an address that starts with
    `rtsp://`, `http://`, `whep+http://` or `webrtc+http://`."""
    name: str = setting(default="", longest=40, quiet=True)
    """Name in the window and in file names; if not given, derived from the source. The robot's cameras have the names
    in its profile."""
    mount: Annotated[CameraModel | None, StoredAs(CameraModelKeys, CameraModelKeys.model, CameraModelKeys.of)] = (
        setting(
            default=None,
            some_of=("horizontal_fov_deg", "fx_px"),
            needs="a mount requires either horizontal_fov_deg or fx_px.",
            quiet=True,
        )
    )
    """Position on the robot and field of view, as in a robot profile. With it, people seen by this camera are placed in
    the map."""
    place: str = setting(default="", refers=("places", "name"), longest=80, quiet=True, beside=("mount",))
    """Name of one of the `places` where the camera stands, for example on a desk, instead of on the robot. The camera
    faces the heading of the place. Requires `mount`, which is relative to the place."""


class FaceSettings(Value):
    """The robot's face, if `permissions` include `face`: in a separate window, or as a web page on the robot."""

    face: str = setting(
        default="calm", pattern=r"^[A-Za-z0-9_-]{1,60}$", allowed="letters, digits, - and _.", knows="faces"
    )
    """Initial face: the name of a file in the folder `faces`."""
    captions: bool = True
    """The robot's speech is shown as text below its mouth."""
    live_picture: bool = setting(default=False, quiet=True)
    """The robot's live picture can be shown to people in front of it."""
    page: Literal["this_computer", "network"] = setting(default="this_computer", external="network", quiet=True)
    """Access to the page with the face, while it is served: this computer only, or anyone on its network who has the
    address with its secret part."""


class ListeningSettings(Value):
    """How what is said near the robot is turned into text, and when somebody has finished. Used with the permission
    `transcription`.
    """

    language: str = setting(default="en", pattern="^([a-z]{2,3})?$", allowed="a code such as en, es, fr or de.")
    """Spoken language, as two or three letters; if empty, the model detects it automatically, if it knows several."""
    engine: Literal["local", "server"] = setting(default="local", quiet=True)
    """`local`: this computer; `server`: a server that accepts OpenAI transcription requests."""
    model: str = setting(default="", longest=1000, external="recogniser", quiet=True)
    """The recogniser: a faster-whisper folder. Give its path, its name next to the scenario or in a models folder, or
    the `https://` address of one as a .zip; `plugin:NAME` for a plug-in; the default one if empty. With `server`, the
    name of its model."""
    sha256: str = setting(
        default="",
        title="Checksum (SHA-256)",
        pattern="^([0-9a-fA-F]{64})?$",
        allowed="the 64 digits that sha256sum prints.",
        quiet=True,
    )
    """Checksum of the folder's model.bin, or of the .zip; required for an address."""
    server: str = setting(
        default="",
        pattern="^(https?://.+)?$",
        external="address",
        allowed="https://HOST/v1, or http://HOST:PORT/v1 on this computer.",
        longest=300,
        quiet=True,
    )
    """With `engine: server`: its address. Its key, if required, is CARIS_TRANSCRIPTION_KEY in the environment, for the
    server in CARIS_TRANSCRIPTION_SERVER, or CARIS_TRANSCRIPTION_KEY@HOST in the system's keyring."""
    silence_at_least_s: float = setting(
        default=0.3, title="Shortest silence", unit="seconds", at_least=0.2, at_most=3, quiet=True
    )
    """A turn never ends before this much silence, however certain the console is."""
    silence_at_most_s: float = setting(
        default=3.0, title="Longest silence", unit="seconds", at_least=0.5, at_most=10, quiet=True
    )
    """A turn always ends after this much silence. Between the two limits, the console learns from each participant's
    pauses."""


class SoundSettings(Value):
    """Microphones and loudspeakers. A microphone is open only while a permitted function needs it."""

    ear: str = setting(
        default="auto",
        pattern="^(auto|robot|computer|none|camera:.+)$",
        allowed="auto, robot, computer, camera:NAME or none.",
        title="Participant microphone",
        longest=60,
        quiet=True,
    )
    """Microphone for the participant: `robot` is the one in its profile, `computer` one of this computer, `camera:NAME`
    the one of a camera in `cameras` over WebRTC. `auto` is the robot's if it has one, otherwise this computer's."""

    hear: bool = setting(default=False, title="Listen in", quiet=True)
    """The wizard may listen to the participant microphone, best with headphones."""
    own_voice: Literal["auto", "robot", "computer", "both"] = setting(default="auto", quiet=True)
    """Loudspeaker for the wizard's own voice, with the permission `own_voice`: the robot's, this computer's, or both.
    `auto` is the robot's if its profile has one, otherwise this computer's."""

    def resolve_microphone(self, *, robot_hears: bool) -> str:
        """Resolve ``auto`` for this robot: ``robot``, ``computer``, ``camera:NAME`` or ``none``."""
        if self.ear == "auto":
            return "robot" if robot_hears else "computer"
        return self.ear


class VoiceSettings(Value):
    """Speech output of this computer."""

    name: str = setting(
        default="",
        pattern="^((piper|espeak|plugin):.+)?$",
        allowed="piper:NAME, espeak:NAME or plugin:NAME.",
        external="voice",
        longest=200,
    )
    """`piper:NAME` or `espeak:NAME`, as listed by the console, or `plugin:NAME` for a plug-in; if empty, the best voice
    for the language, or the system voice if no language is given."""
    language: str = setting(
        default="",
        pattern="^([A-Za-z]{2,3}([-_][A-Za-z0-9]{2,8})*)?$",
        allowed="a language such as en or de-AT.",
        longest=20,
    )
    """Spoken language: `en`, `de-AT`."""
    rate: float = setting(default=1.0, at_least=0.5, at_most=2)
    """Speaking rate; 1 is normal."""
    volume: float = setting(default=1.0, at_least=0, at_most=1)
    """Speech volume, before the computer's own volume."""
    device: str = setting(default="", longest=200)
    """Part of the name of the loudspeaker; the default one if empty."""


class Scenario(Value):
    """Setup of the console for one kind of study: layout, permissions, phrases, prompts and places. Never code."""

    title: _Label = setting(section="About")
    """Shown in the window and in the scenario menu."""
    layout: LayoutNode = setting(title="Layout", section="Panels", order=1)
    """Positions of the panels."""
    layout_compact: LayoutNode | None = setting(
        default=None, title="Layout on a small screen", section="Panels", order=1, quiet=True
    )
    """Positions on a small screen; if not given, the least important panels of the layout become tabs."""
    layout_large: LayoutNode | None = setting(
        default=None, title="Layout on a large screen", section="Panels", order=1, quiet=True
    )
    """Positions on a large screen; if not given, tabs of the layout are spread out as far as there is room."""
    description: str = setting(default="", section="About", prose=True, longest=2000)
    """Description of the study, for people who choose a scenario."""
    robot: str = setting(
        default=DEFAULT_ROBOT, section="Robot and cameras", knows="robots", external="robot", shortest=1, longest=300
    )
    """Name of a robot profile, the address of a rosbridge: `ws://HOST:PORT`, or `ros2:` for ROS 2 without rosbridge."""
    voice: Literal["robot", "computer", "both"] = setting(default="robot", section="Voice and sound")
    """Who speaks: the robot's own voice, this computer, or both at once."""
    speech: VoiceSettings = setting(
        default_factory=VoiceSettings, title="This computer's voice", section="Voice and sound", quiet=True
    )
    phrases: tuple[PhraseEntry, ...] = setting(default=(), section="Phrases", longest=24)
    """One-click sentences, on F1 to F8 in this order: plain, with options, or in groups. `{name}` stands for the person
    addressed and `{place}` for the robot's goal or current place. The wizard is asked for other words in braces, and
    for unknown values, before anything is said."""
    cameras: tuple[CameraSettings, ...] = setting(
        default=(CameraSettings("robot"),), section="Robot and cameras", longest=6, quiet=True
    )
    """The cameras to show, use for perception and record; the robot's own if not given."""
    filler: str = setting(default="", section="Phrases", longest=500)
    """Sentence that the robot says while the wizard thinks, on F9."""
    fillers: tuple[Sentence, ...] = setting(
        default=(), title="More fillers", section="Phrases", longest=20, quiet=True, beside=("filler",)
    )
    """More fillers: each press of F9 says the next one."""
    gestures: tuple[Gesture, ...] = setting(default=(), section="Phrases", longest=MOST_GESTURES, quiet=True)
    """Actions of the robot without speech, on Ctrl+4 to Ctrl+9 in this order or on their own keys. Gestures that the
    connected robot does not support are not shown."""
    places: tuple[Place, ...] = setting(default=(), section="Places", longest=100)
    """Named places in the map."""
    preflight: tuple[PreflightEntry, ...] = setting(
        default=(), title="Manual checks before a recording", section="Recording", longest=20, quiet=True
    )
    """Checks that the wizard ticks before a recording, after the automatic checks of the console."""
    protocol: ProtocolSettings = setting(default_factory=ProtocolSettings, section="Protocol", quiet=True)
    controls: tuple[CONTROL, ...] = setting(
        default=(), title="More controls", section="Robot and cameras", longest=100, quiet=True
    )
    """Controls that this scenario adds to the Robot panel, after the robot's own."""
    notes: str = setting(
        default="", title="Notes for the wizard", section="About", prose=True, longest=4000, quiet=True
    )
    """Information for the wizard during a session, shown in the Notes panel."""
    permissions: Permissions = setting(default_factory=Permissions, section="What is allowed")
    panels_off: tuple[_Panel, ...] = setting(
        default=(),
        title="Unavailable panels",
        section="What is allowed",
        longest=len(get_args(BuiltInPanel)),
        unique=True,
        quiet=True,
    )
    """Panels that are not available in this scenario: not in the layout, not in menus, not by key."""
    panels: PanelSettings = setting(
        default_factory=PanelSettings, title="Initial panel settings", section="Panels", quiet=True
    )
    recording: RecordingSettings = setting(default_factory=RecordingSettings, section="Recording", quiet=True)
    perception: PerceptionSettings = setting(
        default_factory=PerceptionSettings, title="Person detection", section="People", quiet=True
    )
    sound: SoundSettings = setting(
        default_factory=SoundSettings, title="Microphone and loudspeaker", section="Voice and sound", quiet=True
    )
    blur: BlurSettings = setting(default_factory=BlurSettings, title="Blurring people", section="People", quiet=True)
    face: FaceSettings = setting(
        default_factory=FaceSettings, title="The robot's face", section="Robot and cameras", quiet=True
    )
    listening: ListeningSettings = setting(default_factory=ListeningSettings, section="Listening", quiet=True)
    driving: DrivingLimits = setting(default_factory=DrivingLimits, section="Robot and cameras")
    assistant: AssistantSettings = setting(default_factory=AssistantSettings, section="Assistant")
    assistance: AssistanceSettings = setting(
        default_factory=AssistanceSettings, title="Automation", section="Assistant", quiet=True
    )
    path: Annotated[Path | None, Excluded()] = None
    sha256: Annotated[str, Excluded()] = ""
    version: Literal[1] = setting(default=SCENARIO_VERSION, wanted=True, order=-1)
    """Version of this file format."""

    @property
    def every_filler(self) -> tuple[str, ...]:
        return (self.filler, *self.fillers) if self.filler else ()

    def next_filler(self, spoken_count: int) -> str:
        """Fillers in rotation, after ``spoken_count`` of them; empty without any."""
        return self.every_filler[spoken_count % len(self.every_filler)] if self.filler else ""

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


def own_layout(scenario: Scenario, kind: SizeClass) -> LayoutNode | None:
    """Layout in the scenario's file for such a screen; None if it derives from the usual one."""
    if kind == "compact":
        return scenario.layout_compact
    return scenario.layout_large if kind == "large" else scenario.layout


def with_layout(scenario: Scenario, kind: SizeClass, tree: LayoutNode | None) -> Scenario:
    """Scenario with another layout for such a screen; only the usual one is mandatory."""
    if kind == "compact":
        return replace(scenario, layout_compact=tree)
    if kind == "large":
        return replace(scenario, layout_large=tree)
    return scenario if tree is None else replace(scenario, layout=tree)


def layout_from_data(node: dict[str, Any]) -> LayoutNode:
    """Layout from validated data."""
    layout: LayoutNode = value_from(LayoutNode, node)
    return layout


def checked_layout(node: Any) -> LayoutNode:
    """As :func:`layout_from_data`, for unvalidated data. Raises ValueError."""
    for _path, problem in problems(LayoutNode, node, ("layout",)):
        raise ValueError(tr("invalid panel layout: {problem}").format(problem=problem[:200]))
    return layout_from_data(node)


def layout_problems(node: dict[str, Any], path: KeyPath, seen: set[str]) -> Iterator[Problem]:
    """Problems that the schema cannot express. ``seen`` are panels used elsewhere."""
    if "children" in node:
        weights = node.get("weights")
        if weights is not None and len(weights) != len(node["children"]):
            yield (
                (*path, "weights"),
                tr("{weights} weights for {children} children. Allowed: one weight for each child.").format(
                    weights=len(weights), children=len(node["children"])
                ),
            )
        for index, child in enumerate(node["children"]):
            yield from layout_problems(child, (*path, "children", index), seen)
        return
    panels: list[tuple[KeyPath, str]] = [((*path, "panel"), node["panel"])] if "panel" in node else []
    panels += [((*path, "tabs", index), panel) for index, panel in enumerate(node.get("tabs", []))]
    for place, panel in panels:
        if panel in seen:
            yield place, tr("duplicate panel '{panel}'. Allowed: each panel once.").format(panel=panel)
        seen.add(panel)
    if "current" in node and node["current"] not in node["tabs"]:
        yield (
            (*path, "current"),
            tr("'{panel}' is not one of these tabs.").format(panel=node["current"])
            + " "
            + allowed_words(node["current"], node["tabs"]),
        )


def layout_data(node: LayoutNode) -> dict[str, Any]:
    """File content of the layout."""
    data: dict[str, Any] = data_of(LayoutNode, node)
    return data


def panels_in(node: LayoutNode) -> tuple[PanelName, ...]:
    if isinstance(node, PanelLeaf):
        return (node.panel,)
    if isinstance(node, TabNode):
        return node.tabs
    return tuple(panel for child in node.children for panel in panels_in(child))


def plugin_panels(scenario: Scenario) -> tuple[PanelName, ...]:
    """Panels of plug-ins in the layouts of the scenario."""
    layouts = (scenario.layout, scenario.layout_compact, scenario.layout_large)
    named = [panel for layout in layouts if layout is not None for panel in panels_in(layout)]
    return tuple(dict.fromkeys(panel for panel in named if panel.startswith("plugin:")))


def layout_text(node: LayoutNode) -> str:
    """Layout as one line of JSON, for recordings."""
    return json.dumps(layout_data(node))
