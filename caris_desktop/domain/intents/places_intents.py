"""Intents of navigation, places and maps."""

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class GoToPlace(Intent):
    """Navigate to a place of the scenario."""

    place: str


@dataclass(frozen=True, slots=True)
class GoToPoint(Intent):
    """Navigate to a point with a heading."""

    target_in_map: Pose2D


@dataclass(frozen=True, slots=True)
class CancelGoal(Intent):
    """Cancel the navigation goal."""

    @property
    def reduces_motion(self) -> bool:
        return True


@dataclass(frozen=True, slots=True)
class SetInitialPose(Intent):
    """Set the robot's pose for localization."""

    pose_in_map: Pose2D


@dataclass(frozen=True, slots=True)
class SavePlace(Intent):
    """Add a place, or move the one of that name, in the wizard's copy of the scenario."""

    place: str
    pose_in_map: Pose2D


@dataclass(frozen=True, slots=True)
class RemovePlace(Intent):
    """Remove a place."""

    place: str


@dataclass(frozen=True, slots=True)
class SaveMap(Intent):
    """Save the map on the robot, by name."""

    name: str


@dataclass(frozen=True, slots=True)
class LoadMap(Intent):
    """Load a map saved on the robot."""

    name: str


@dataclass(frozen=True, slots=True)
class SetMapping(Intent):
    """Continue mapping, or only localize in the map."""

    mapping: bool


PLACES: IntentTable = {
    GoToPlace: IntentSpec(
        QT_TR_NOOP("Driving to the place"), "driving", moves="base", needs_link=True, proposable=True
    ),
    GoToPoint: IntentSpec(QT_TR_NOOP("Driving there"), "driving", moves="base", needs_link=True, proposable=True),
    CancelGoal: IntentSpec(QT_TR_NOOP("Cancelling the goal")),
    SetInitialPose: IntentSpec(QT_TR_NOOP("Setting the robot's position"), "driving", needs_link=True),
    SavePlace: IntentSpec(QT_TR_NOOP("Saving the place"), "driving"),
    RemovePlace: IntentSpec(QT_TR_NOOP("Removing the place"), "driving"),
    SaveMap: IntentSpec(QT_TR_NOOP("Saving the map"), "driving", needs_link=True),
    LoadMap: IntentSpec(QT_TR_NOOP("Loading the map"), "driving", needs_link=True),
    SetMapping: IntentSpec(QT_TR_NOOP("Turning mapping on or off"), "driving", needs_link=True),
}
