"""Base class of intents, and their table's line."""

from collections.abc import Mapping
from dataclasses import field
from typing import Literal

from caris_desktop.domain.actor import WIZARD, Actor
from caris_desktop.domain.value_class import dataclass

Permission = Literal[
    "photos",
    "video_recording",
    "audio_recording",
    "driving",
    "assistant",
    "naming_people",
    "robot_controls",
    "transcription",
    "own_voice",
    "cloud_models",
    "face",
    "speech",
    "notes",
]
"""What a scenario can switch off."""

AsBefore = Literal["map", "people", "permissions", "consent"]
"""What holds as before only once somebody has looked: where the robot is, who is there, what is recorded and what a
language model may do, and that they agree to it.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Intent:
    """Something that somebody asks the console for."""

    actor: Actor = WIZARD

    @property
    def reduces_motion(self) -> bool:
        """Whether it can only reduce motion or increase caution. Such intents are never refused."""
        return False

    @property
    def needs_permissions(self) -> tuple[Permission, ...]:
        """Permissions required where they differ within the type; empty: those of the table."""
        return ()


Bounds = tuple[float, float]
Moves = Literal["base", "head"]


@dataclass(frozen=True, slots=True)
class IntentSpec:
    """One line of the table.

    ``words`` say what is asked for, as the subject of a sentence ("Driving is not possible: ..."). ``permission`` is
    what the scenario must allow, and ``also`` another one that it must allow too. ``moves`` is what of the robot may
    move of it, so the emergency stop refuses it; while somebody drives by hand, what moves its base is refused to
    others. ``needs_link``: it is for the robot, so nothing waits for one that is not there. ``in_replay``: a replay
    does it too. ``quiet``: it is refused so often, as while a key is held, that nobody is told each time; the window
    shows the reason all the while. ``proposable``: a language model may propose it. ``bounds`` are the least and the
    greatest value of numbers among its fields. ``confirmed`` is what has to be confirmed before, where a trial goes on
    that broke off with the program.
    """

    words: str
    permission: Permission | None = None
    also: Permission | None = None
    moves: Moves | None = None
    needs_link: bool = False
    in_replay: bool = False
    quiet: bool = False
    proposable: bool = False
    bounds: Mapping[str, Bounds] = field(default_factory=dict)
    confirmed: tuple[AsBefore, ...] = ()

    @property
    def permissions(self) -> tuple[Permission, ...]:
        """All permissions required of the scenario."""
        return tuple(one for one in (self.permission, self.also) if one is not None)


IntentTable = Mapping[type[Intent], IntentSpec]
