"""Face section of a scenario."""

from typing import Annotated, Literal

from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class FaceSettings:
    """The robot's face, where `permissions` have `face`: in a window of its own, or as a page on the robot."""

    face: Annotated[
        str,
        FieldSpec(
            "The face that it begins with: a file of the folder `faces`, by its name.",
            pattern=r"^[A-Za-z0-9_-]{1,60}$",
            allowed="letters, digits, - and _.",
            knows="faces",
        ),
    ] = "calm"
    captions: Annotated[bool, FieldSpec("What the robot says is written below its mouth.")] = True
    live_picture: Annotated[
        bool, FieldSpec("What the robot sees can be shown to whoever stands before it.", quiet=True)
    ] = False
    page: Annotated[
        Literal["this_computer", "network"],
        FieldSpec(
            "Who can open the page with the face, while it is served: this computer alone, or whoever is on its "
            "network and has the address with its secret part.",
            external="network",
            quiet=True,
        ),
    ] = "this_computer"
