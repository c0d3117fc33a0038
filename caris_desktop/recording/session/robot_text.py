"""Data from a recorded robot profile, which need not be installed any more."""

from typing import Literal

from caris_desktop.domain.events import RobotChosen
from caris_desktop.recording.session.scenario_text import parsed_yaml

VelocityType = Literal["Twist", "TwistStamped"]


def velocity_type(event: RobotChosen) -> VelocityType:
    """Type of the velocity message; the common one if the profile lacks it."""
    profile = parsed_yaml(event.profile, "robot profile")
    velocity = profile.get("velocity") if isinstance(profile, dict) else None
    stamped = isinstance(velocity, dict) and velocity.get("type") == "TwistStamped"
    return "TwistStamped" if stamped else "Twist"
