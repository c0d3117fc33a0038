"""ROS messages that only a robot publishes: transforms and camera info."""

import math
from typing import Any

from caris_desktop.domain.geometry import Pose2D, Pose3D
from caris_desktop.domain.value_class import dataclass
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.message_fields import encode_header

Message = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Placement:
    """Pose of a frame in its parent: in space, or on the floor with height and tilt (down positive)."""

    parent: str
    child: str
    pose: Pose2D | Pose3D
    z_m: float = 0.0
    tilt_rad: float = 0.0

    @property
    def in_space(self) -> Pose3D:
        if isinstance(self.pose, Pose3D):
            return self.pose
        half_rad = self.tilt_rad / 2.0
        tilted = Pose3D(0.0, 0.0, self.z_m, 0.0, math.sin(half_rad), 0.0, math.cos(half_rad))
        return Pose3D.on_floor(self.pose) @ tilted


def transforms(dialect: Dialect, placements: list[Placement], *, stamp_ns: int) -> Message:
    """Encode tf2_msgs/TFMessage."""
    return {
        "transforms": [
            {
                "header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=placed.parent),
                "child_frame_id": placed.child,
                "transform": {
                    "translation": {"x": pose.x_m, "y": pose.y_m, "z": pose.z_m},
                    "rotation": {"x": pose.qx, "y": pose.qy, "z": pose.qz, "w": pose.qw},
                },
            }
            for placed, pose in ((placed, placed.in_space) for placed in placements)
        ]
    }


def camera_info(
    dialect: Dialect, *, width_px: int, height_px: int, focal_px: float, stamp_ns: int, frame_id: str
) -> Message:
    """Encode sensor_msgs/CameraInfo of a pinhole without distortion; matrix names are lower case in ROS 2."""
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
