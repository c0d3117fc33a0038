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
        FieldSpec("The robot stays in the middle, from near; else the whole map is shown.", title="Follows the robot"),
    ] = False
    up: Annotated[
        Literal["north", "robot"],
        FieldSpec("What is up: north, or where the robot looks: then the map turns with it.", title="Up is"),
    ] = "north"
    trail: Annotated[bool, FieldSpec("Where the robot has driven is drawn.", title="Shows where it has driven")] = True


@dataclass(frozen=True, slots=True)
class VideoSettings:
    """The Video panel."""

    camera: Annotated[
        str,
        FieldSpec(
            "The name of the camera that is on show, as soon as it is there; the first one if not given.",
            longest=40,
        ),
    ] = ""


@dataclass(frozen=True, slots=True)
class DriveSettings:
    """The Drive panel."""

    first: Annotated[
        Literal["arrows", "stick", "head"],
        FieldSpec("What is shown where there is not room for all three.", title="Shown first"),
    ] = "arrows"


@dataclass(frozen=True, slots=True)
class LogSettings:
    """The log in the Session panel."""

    shows: Annotated[
        Literal["everything", "said", "moved", "people", "session", "problems"],
        FieldSpec("Which kind of events is listed."),
    ] = "everything"


@dataclass(frozen=True, slots=True)
class QuestionSettings:
    """The Assistant panel."""

    left_out: Annotated[
        tuple[PromptPart, ...],
        FieldSpec("What does not go along with a question, unless the wizard adds it.", longest=6, unique=True),
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
