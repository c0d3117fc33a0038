"""From what a robot offers to a profile for it: candidates for each thing by type and name, with reasons in words."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from caris_desktop.domain.address import without_credentials
from caris_desktop.robot.profile import (
    CameraTopic,
    EmergencyStopInterface,
    GuardSettings,
    HeadInterface,
    MapServices,
    MotionLimits,
    NavigationServer,
    RobotProfile,
    SecuritySettings,
    SpeechAction,
    SpeechInterface,
    TopicSource,
    TransformFrames,
    VelocityTopic,
)
from caris_desktop.ros.dialect import Dialect, same_type

MOST_CAMERAS = 4
# Nobody knows yet how the robot drives: slow enough for a first try.
CAUTIOUS = MotionLimits(
    forward_mps=0.3, backward_mps=0.2, turn_radps=0.6, acceleration_mps2=0.5, deceleration_mps2=1.0,
    turn_acceleration_radps2=1.5, turn_deceleration_radps2=3.0,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Offer:
    """What a robot has. Types are spelt as the robot spells them; an empty one is not known.

    ``actions`` are the action servers. ``frames`` (of tf) and ``joints`` (of its joint states) are what was heard in
    a moment of listening. ``publishers`` and ``subscribers`` count the nodes at a topic, where rosapi tells.
    """

    topics: Mapping[str, str]
    services: Mapping[str, str] = field(default_factory=dict)
    actions: Mapping[str, str] = field(default_factory=dict)
    dialect: Dialect | None = None
    distribution: str = ""
    frames: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    publishers: Mapping[str, int] = field(default_factory=dict)
    subscribers: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Candidate:
    """One name that a field of the profile may get. ``confidence`` is 0..1; ``why`` says what speaks for it."""

    value: str
    type: str
    confidence: float
    why: str


@dataclass(frozen=True, slots=True)
class FieldProposal:
    """One line of the proposed mapping: the profile's ``field`` gets ``value`` ("" for none), one of ``candidates``.

    Candidates come best first. ``field`` is a key of the profile (``scan``, ``cameras.0``, ``speech.stop``).
    """

    field: str
    label: str
    value: str
    candidates: tuple[Candidate, ...]
    why: str


@dataclass(frozen=True, slots=True)
class Proposal:
    """A mapping for the whole robot. ``notes`` are what the person who saves it should know."""

    namespace: str
    namespaces: tuple[str, ...]
    fields: tuple[FieldProposal, ...]
    notes: tuple[str, ...] = ()

    @property
    def chosen(self) -> dict[str, str]:
        """The proposed value of each field; what :func:`profile_of` takes, with changes where wanted."""
        return {proposal.field: proposal.value for proposal in self.fields}


# def propose(offer: Offer, *, namespace: str | None = None) -> Proposal
# def profile_of(offer: Offer, chosen: Mapping[str, str], *, name: str, title: str, address: str,
#     security: SecuritySettings | None = None) -> RobotProfile
