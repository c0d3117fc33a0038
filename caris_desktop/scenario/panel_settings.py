"""Initial panel settings of a scenario; the wizard's own changes are stored separately."""

from dataclasses import field
from typing import Annotated, Literal

from caris_desktop.domain.intents import PromptPart
from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class MapSettings:
    """The Map panel."""

    follow: Annotated[
        bool,
        FieldSpec(
            "The robot stays in the centre, zoomed in; otherwise the whole map is shown.", title="Follows the robot"
        ),
    ] = False
    up: Annotated[
        Literal["north", "robot"],
        FieldSpec(
            "Direction that points up: north, or the robot's heading. With the heading, the map rotates with the "
            "robot.",
            title="Up is",
        ),
    ] = "north"
    trail: Annotated[bool, FieldSpec("The robot's driven path is drawn.", title="Shows the driven path")] = True


@dataclass(frozen=True, slots=True)
class VideoSettings:
    """The Video panel."""

    camera: Annotated[
        str,
        FieldSpec("Name of the camera to show, as soon as it is available; the first one if not given.", longest=40),
    ] = ""


@dataclass(frozen=True, slots=True)
class DriveSettings:
    """The Drive panel."""

    first: Annotated[
        Literal["arrows", "stick", "head"],
        FieldSpec("Control to show if there is not enough room for all three.", title="Shown first"),
    ] = "arrows"


@dataclass(frozen=True, slots=True)
class LogSettings:
    """The log in the Session panel."""

    shows: Annotated[
        Literal["everything", "said", "moved", "people", "session", "problems"], FieldSpec("Kind of events to list.")
    ] = "everything"


@dataclass(frozen=True, slots=True)
class QuestionSettings:
    """The Assistant panel."""

    left_out: Annotated[
        tuple[PromptPart, ...],
        FieldSpec("Context that is not sent with a question, unless the wizard adds it.", longest=6, unique=True),
    ] = ()


@dataclass(frozen=True, slots=True)
class PanelSettings:
    """How panels are when the scenario is opened. The wizard can change each of it, and finds it so the next time;
    another scenario has its own.
    """

    map: Annotated[MapSettings, FieldSpec(quiet=True)] = field(default_factory=MapSettings)
    video: Annotated[VideoSettings, FieldSpec(quiet=True)] = field(default_factory=VideoSettings)
    drive: Annotated[DriveSettings, FieldSpec(quiet=True)] = field(default_factory=DriveSettings)
    session: Annotated[LogSettings, FieldSpec(quiet=True)] = field(default_factory=LogSettings)
    assistant: Annotated[QuestionSettings, FieldSpec(quiet=True)] = field(default_factory=QuestionSettings)
