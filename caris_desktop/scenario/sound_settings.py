"""Sound section of a scenario: the participant's microphone, and the wizard's audio."""

from typing import Annotated, Literal

from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class SoundSettings:
    """Microphones and loudspeakers. A microphone is open only while a permitted function needs it."""

    ear: Annotated[
        str,
        FieldSpec(
            "Microphone for the participant: `robot` is the one in its profile, `computer` one of this "
            "computer, `camera:NAME` the one of a camera in `cameras` over WebRTC. `auto` is the robot's if "
            "it has one, otherwise this computer's.",
            pattern="^(auto|robot|computer|none|camera:.+)$",
            allowed="auto, robot, computer, camera:NAME or none.",
            title="Participant microphone",
            longest=60,
            quiet=True,
        ),
    ] = "auto"

    hear: Annotated[
        bool,
        FieldSpec(
            "The wizard may listen to the participant microphone, best with headphones.", title="Listen in", quiet=True
        ),
    ] = False
    own_voice: Annotated[
        Literal["auto", "robot", "computer", "both"],
        FieldSpec(
            "Loudspeaker for the wizard's own voice, with the permission `own_voice`: the robot's, this "
            "computer's, or both. `auto` is the robot's if its profile has one, otherwise this computer's.",
            quiet=True,
        ),
    ] = "auto"

    def resolve_microphone(self, *, robot_hears: bool) -> str:
        """Resolve ``auto`` for this robot: ``robot``, ``computer``, ``camera:NAME`` or ``none``."""
        if self.ear == "auto":
            return "robot" if robot_hears else "computer"
        return self.ear
