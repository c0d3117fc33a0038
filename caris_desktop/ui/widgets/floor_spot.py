"""Clicked floor point in the video: position, distance, and why the robot cannot be sent there."""

import math

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.sensing import FrameRef, HeadState
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.robot.profile_model import RobotProfile

FARTHEST_M = 8.0
"""Beyond this a pixel covers half a metre or more of floor."""

RING_M = 0.25


class FloorSpot(Value):
    """Floor point in the robot frame."""

    x_m: float
    y_m: float

    @property
    def distance_m(self) -> float:
        return math.hypot(self.x_m, self.y_m)


def model_for(robot: RobotProfile | None, frame: FrameRef, head: HeadState | None) -> CameraModel | None:
    """Model of the frame's camera, scaled to the frame; None if the profile has none."""
    cameras = robot.cameras if robot is not None else ()
    model = next((camera.model for camera in cameras if camera.name == frame.camera), None)
    if model is None:
        return None
    if model.on_head and head is None:
        return None  # the direction of a head camera is unknown without the head's state
    if head is not None:
        model = model.with_head_at(pan_rad=head.pan_rad, tilt_rad=head.tilt_rad)
    return model.scaled_to(frame.width_px, frame.height_px)


def spot_at(model: CameraModel, u_px: float, v_px: float) -> FloorSpot | str:
    """Floor point under a pixel, or the reason why there is none to drive to."""
    point = model.floor_point(u_px, v_px)
    if point is None:
        return tr("That is not on the floor")
    spot = FloorSpot(*point)
    if spot.distance_m > FARTHEST_M:
        return tr("Too far away to select in the picture: more than {distance:.0f} m").format(distance=FARTHEST_M)
    return spot


def ring_px(model: CameraModel, spot: FloorSpot) -> list[tuple[float, float]]:
    """Circle on the floor around a point, in px; empty if part of it is behind the camera."""
    corners = []
    for step in range(32):
        angle = 2 * math.pi * step / 32
        corner = model.pixel_of(spot.x_m + RING_M * math.cos(angle), spot.y_m + RING_M * math.sin(angle), 0.0)
        if corner is None:
            return []
        corners.append(corner)
    return corners
