"""Sound section of a scenario: the participant's microphone, and the wizard's audio."""

from typing import Annotated, Literal

from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class SoundSettings:
    """Microphones and loudspeakers. A microphone is open only while something that the scenario permits needs it."""

    ear: Annotated[
        str,
        FieldSpec(
            "Which microphone hears the participant: `robot` is that of its profile, `computer` one of this computer; "
            "`camera:NAME` that of one of the `cameras` over WebRTC; `auto` the robot's where it has one, or else this "
            "computer's.",
            pattern="^(auto|robot|computer|none|camera:.+)$",
            allowed="auto, robot, computer, camera:NAME or none.",
            title="Who is heard by",
            longest=60,
            quiet=True,
        ),
    ] = "auto"

    hear: Annotated[
        bool,
        FieldSpec("The wizard may hear along what it hears, best with headphones.", title="Hear along", quiet=True),
    ] = False
    own_voice: Annotated[
        Literal["auto", "robot", "computer", "both"],
        FieldSpec(
            "Where the wizard's own voice comes out, with the permission `own_voice`: of the robot's loudspeaker, of "
            "this computer's, or both; `auto` is the robot's where its profile has one, or else this computer's.",
            quiet=True,
        ),
    ] = "auto"

    def segmenter_with(self, *, robot_hears: bool) -> str:
        """Resolve ``auto`` for this robot: ``robot``, ``computer``, ``camera:NAME`` or ``none``."""
        if self.ear == "auto":
            return "robot" if robot_hears else "computer"
        return self.ear
