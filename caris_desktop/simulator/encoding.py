"""ROS messages that only a robot sends: frames in space, and what a camera is like."""

import math
from typing import Any

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.value_class import dataclass
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.fields import encode_header

Message = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Placement:
    """Where a frame lies in its parent: on the floor, at a height, and tilted (down positive)."""

    parent: str
    child: str
    pose: Pose2D
    z_m: float = 0.0
    tilt_rad: float = 0.0


def transforms(dialect: Dialect, placements: list[Placement], *, stamp_ns: int) -> Message:
    """tf2_msgs/TFMessage."""
    return {
        "transforms": [
            {
                "header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=placed.parent),
                "child_frame_id": placed.child,
                "transform": {
                    "translation": {"x": placed.pose.x_m, "y": placed.pose.y_m, "z": placed.z_m},
                    "rotation": _rotation(placed.pose.heading_rad, placed.tilt_rad),
                },
            }
            for placed in placements
        ]
    }


def camera_info(
    dialect: Dialect, *, width_px: int, height_px: int, focal_px: float, stamp_ns: int, frame_id: str
) -> Message:
    """sensor_msgs/CameraInfo of a pinhole without distortion; ROS 2 writes the matrices in small letters."""
    middle_x, middle_y = width_px / 2.0, height_px / 2.0
    matrices = {
        "d": [0.0] * 5,
        "k": [focal_px, 0.0, middle_x, 0.0, focal_px, middle_y, 0.0, 0.0, 1.0],
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [focal_px, 0.0, middle_x, 0.0, 0.0, focal_px, middle_y, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
    return {
        "header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=frame_id),
        "height": height_px,
        "width": width_px,
        "distortion_model": "plumb_bob",
        **{name.upper() if dialect is Dialect.ROS1 else name: matrix for name, matrix in matrices.items()},
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


def _rotation(heading_rad: float, tilt_rad: float) -> dict[str, float]:
    half_heading, half_tilt = heading_rad / 2.0, tilt_rad / 2.0
    return {
        "x": -math.sin(half_heading) * math.sin(half_tilt),
        "y": math.cos(half_heading) * math.sin(half_tilt),
        "z": math.sin(half_heading) * math.cos(half_tilt),
        "w": math.cos(half_heading) * math.cos(half_tilt),
    }
