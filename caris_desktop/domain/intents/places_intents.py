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
    """Go no further towards the goal."""

    @property
    def reduces_motion(self) -> bool:
        return True


@dataclass(frozen=True, slots=True)
class SetInitialPose(Intent):
    """Tell the localization where the robot is."""

    pose_in_map: Pose2D


@dataclass(frozen=True, slots=True)
class SavePlace(Intent):
    """Add a place, or move the one of that name, in the wizard's copy of the scenario."""

    place: str
    pose_in_map: Pose2D


@dataclass(frozen=True, slots=True)
class RemovePlace(Intent):
    """Forget a place."""

    place: str


@dataclass(frozen=True, slots=True)
class SaveMap(Intent):
    """Let the robot keep its map under a name."""

    name: str


@dataclass(frozen=True, slots=True)
class LoadMap(Intent):
    """Let the robot use a map that it has."""

    name: str


@dataclass(frozen=True, slots=True)
class SetMapping(Intent):
    """Build the map on, or only find the place in it."""

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
