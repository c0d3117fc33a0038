"""Pinhole camera model: projection between pixels and the floor."""

import math
from dataclasses import replace

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.value_class import Value


class CameraModel(Value):
    """A pinhole camera on the robot, without lens distortion.

    ``width_px`` and ``height_px`` are those of the image that the focal lengths ``fx_px``, ``fy_px`` and the principal
    point ``cx_px``, ``cy_px`` belong to. The optical centre lies at (x_m, y_m, z_m) in the robot frame (REP 103: x
    forward, y left, z up from the floor). The camera looks along ``heading_rad`` (left positive) and ``tilt_rad`` (down
    positive). ``on_head``: pan and tilt of the robot's head are added to these two.

    ``stands_in_map``: pose in the map of a camera in the room instead of on the robot; all of the above is relative to
    it.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 1.0
    heading_rad: float = 0.0
    tilt_rad: float = 0.0
    on_head: bool = False
    stands_in_map: Pose2D | None = None

    @classmethod
    def from_field_of_view(cls, *, width_px: int, height_px: int, horizontal_rad: float) -> "CameraModel":
        """Camera with square pixels and the principal point in the middle, as in a data sheet."""
        focal_px = width_px / 2.0 / math.tan(horizontal_rad / 2.0)
        return cls(width_px, height_px, focal_px, focal_px, width_px / 2.0, height_px / 2.0)

    def scaled_to(self, width_px: int, height_px: int) -> "CameraModel":
        """Same camera for an image of another size."""
        across, down = width_px / self.width_px, height_px / self.height_px
        return replace(
            self, width_px=width_px, height_px=height_px,
            fx_px=self.fx_px * across, cx_px=self.cx_px * across, fy_px=self.fy_px * down, cy_px=self.cy_px * down,
        )  # fmt: skip

    def with_head_at(self, *, pan_rad: float, tilt_rad: float) -> "CameraModel":
        """Camera with the head turned; unchanged if it is not on the head."""
        if not self.on_head:
            return self
        return replace(self, heading_rad=self.heading_rad + pan_rad, tilt_rad=self.tilt_rad + tilt_rad)

    def ray(self, u_px: float, v_px: float) -> tuple[float, float, float]:
        """Direction of the pixel's ray in the robot frame, not of unit length."""
        right, down = (u_px - self.cx_px) / self.fx_px, (v_px - self.cy_px) / self.fy_px
        cos_tilt, sin_tilt = math.cos(self.tilt_rad), math.sin(self.tilt_rad)
        forward, up = cos_tilt - down * sin_tilt, -sin_tilt - down * cos_tilt
        cos_heading, sin_heading = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return (cos_heading * forward + sin_heading * right, sin_heading * forward - cos_heading * right, up)

    def optical_rotation(self) -> tuple[float, float, float, float]:
        """Rotation from the optical frame (REP 103: z forward, x right, y down) to the robot frame: quaternion x, y, z,
        w.
        """
        cos_heading, sin_heading = math.cos(self.heading_rad / 2.0), math.sin(self.heading_rad / 2.0)
        cos_tilt, sin_tilt = math.cos(self.tilt_rad / 2.0), math.sin(self.tilt_rad / 2.0)
        # Heading and tilt, then the axes: their product with (0.5, -0.5, 0.5, -0.5).
        w, x = cos_heading * cos_tilt, -sin_heading * sin_tilt
        y, z = cos_heading * sin_tilt, sin_heading * cos_tilt
        return (-w + x - y - z) / 2.0, (w + x + y - z) / 2.0, (-w + x + y + z) / 2.0, (w + x - y + z) / 2.0

    def floor_point(self, u_px: float, v_px: float) -> tuple[float, float] | None:
        """(x_m, y_m) in the robot frame where the pixel's ray meets the floor; None at or above the horizon."""
        forward, left, up = self.ray(u_px, v_px)
        if up >= -1e-6:
            return None
        reach = self.z_m / -up
        return self.x_m + reach * forward, self.y_m + reach * left

    def bearing_rad(self, u_px: float) -> float:
        """Direction of a pixel column on the floor plane, positive to the left of the robot's forward direction."""
        forward, left, _up = self.ray(u_px, self.cy_px)
        return math.atan2(left, forward)

    def pixel_of(self, x_m: float, y_m: float, z_m: float) -> tuple[float, float] | None:
        """(u_px, v_px) of a point in the robot frame; None if it is not in front of the camera."""
        dx, dy, dz = x_m - self.x_m, y_m - self.y_m, z_m - self.z_m
        cos_heading, sin_heading = math.cos(self.heading_rad), math.sin(self.heading_rad)
        forward, right = cos_heading * dx + sin_heading * dy, sin_heading * dx - cos_heading * dy
        cos_tilt, sin_tilt = math.cos(self.tilt_rad), math.sin(self.tilt_rad)
        depth, down = forward * cos_tilt - dz * sin_tilt, -forward * sin_tilt - dz * cos_tilt
        if depth <= 1e-6:
            return None
        return self.cx_px + self.fx_px * right / depth, self.cy_px + self.fy_px * down / depth
