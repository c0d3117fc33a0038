"""Face section of a scenario."""

from typing import Annotated, Literal

from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class FaceSettings:
    """The robot's face, if `permissions` include `face`: in a separate window, or as a web page on the robot."""

    face: Annotated[
        str,
        FieldSpec(
            "Initial face: the name of a file in the folder `faces`.",
            pattern=r"^[A-Za-z0-9_-]{1,60}$",
            allowed="letters, digits, - and _.",
            knows="faces",
        ),
    ] = "calm"
    captions: Annotated[bool, FieldSpec("The robot's speech is shown as text below its mouth.")] = True
    live_picture: Annotated[
        bool, FieldSpec("The robot's live picture can be shown to people in front of it.", quiet=True)
    ] = False
    page: Annotated[
        Literal["this_computer", "network"],
        FieldSpec(
            "Access to the page with the face, while it is served: this computer only, or anyone on its "
            "network who has the address with its secret part.",
            external="network",
            quiet=True,
        ),
    ] = "this_computer"
