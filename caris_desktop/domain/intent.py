"""Base class of intents, and their table line."""

from collections.abc import Mapping
from dataclasses import field
from typing import Literal

from caris_desktop.domain.actor import WIZARD, Actor
from caris_desktop.domain.value_class import Value

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
"""Functions a scenario can disable."""

AsBefore = Literal["map", "people", "permissions", "consent"]
"""Conditions that a person must confirm before a trial resumes: the robot's position, who is there, what is recorded
and what a language model may do, and the consent.
"""


class Intent(Value, kw_only=True):
    """Request to the console from an actor."""

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


class IntentSpec(Value):
    """One line of the table.

    ``words`` name the request, as the subject of a sentence ("Driving is not possible: ..."). ``permission`` is what
    the scenario must allow, and ``also`` another one that it must allow too. ``moves`` is the part of the robot that it
    may move, so the emergency stop refuses it. While somebody drives by hand, intents that move the base are refused to
    others. ``needs_link``: it is for the robot and never waits for a missing one. ``in_replay``: a replay does it too.
    ``quiet``: refusals are frequent, as while a key is held, and not reported each time; the window shows the reason.
    ``proposable``: a language model may propose it. ``bounds`` are the least and the greatest value of its numeric
    fields. ``confirmed``: conditions to confirm first when a trial resumes after the program ended.
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
