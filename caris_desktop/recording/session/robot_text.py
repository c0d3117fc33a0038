"""What the profile of a recorded robot says; whoever reads an old record need not have that profile any more."""

from typing import Literal

from caris_desktop.domain.events import RobotChosen
from caris_desktop.recording.session.scenario_text import parsed_yaml

VelocityType = Literal["Twist", "TwistStamped"]


def velocity_type(event: RobotChosen) -> VelocityType:
    """Which message of geometry_msgs drives the robot; that of most robots where its profile does not tell."""
    profile = parsed_yaml(event.profile, "robot profile")
    velocity = profile.get("velocity") if isinstance(profile, dict) else None
    stamped = isinstance(velocity, dict) and velocity.get("type") == "TwistStamped"
    return "TwistStamped" if stamped else "Twist"
