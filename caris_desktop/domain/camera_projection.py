"""Pinhole camera model: projection between pixels and the floor, and its keys in a file."""

import math
from dataclasses import replace
from typing import Annotated, Any

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.schema_fields import FieldSpec
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


# File keys of cameras and poses: from a data sheet, in degrees or radians.

_FOV_DEG = (5.0, 170.0)

Radians = Annotated[float, FieldSpec(unit="radians", at_least=-7, at_most=7)]
Offset = Annotated[float, FieldSpec(unit="metres", at_least=-5, at_most=5)]
_HeadingDeg = Annotated[
    float, FieldSpec("Angle to the left of straight ahead; 0 if not given.", unit="degrees", at_least=-360, at_most=360)
]
_HeadingRad = Annotated[
    float,
    # Within the range of degrees that it is written back as.
    FieldSpec("The same in radians.", unit="radians", at_least=-6.2831, at_most=6.2831, instead_of=("heading_deg",)),
]


class CameraModelKeys(Value):
    """Where a camera is and what it sees, as its data sheet or its calibration says."""

    width_px: Annotated[
        int, FieldSpec("Picture width that the other values refer to.", unit="pixels", at_least=16, at_most=16_384)
    ]
    height_px: Annotated[int, FieldSpec("Picture height.", unit="pixels", at_least=16, at_most=16_384)]
    horizontal_fov_deg: Annotated[float | None, FieldSpec(
        "Angle from the left to the right edge.", unit="degrees", at_least=_FOV_DEG[0], at_most=_FOV_DEG[1],
    )] = None  # fmt: skip
    fx_px: Annotated[float | None, FieldSpec(
        "Horizontal focal length, from a calibration.", unit="pixels", more_than=0, instead_of=("horizontal_fov_deg",),
    )] = None  # fmt: skip
    fy_px: Annotated[
        float | None,
        FieldSpec("Vertical focal length; same as fx_px if not given.", unit="pixels", more_than=0, beside=("fx_px",)),
    ] = None
    cx_px: Annotated[
        float | None,
        FieldSpec("Column of the optical axis; the centre if not given.", unit="pixels", beside=("fx_px",)),
    ] = None
    cy_px: Annotated[
        float | None, FieldSpec("Row of the optical axis; the centre if not given.", unit="pixels", beside=("fx_px",))
    ] = None
    x_m: Annotated[Offset, FieldSpec("Distance in front of the robot's centre.")] = 0.0
    y_m: Annotated[Offset, FieldSpec("Distance to the left of the robot's centre.")] = 0.0
    z_m: Annotated[float, FieldSpec("Height above the floor.", unit="metres", at_least=0.02, at_most=5)] = 1.0
    heading_deg: Annotated[_HeadingDeg | None, FieldSpec()] = None
    heading_rad: Annotated[_HeadingRad | None, FieldSpec()] = None
    tilt_deg: Annotated[
        float | None, FieldSpec("Downward angle; 0 if not given.", unit="degrees", at_least=-90, at_most=90)
    ] = None
    tilt_rad: Annotated[float | None, FieldSpec(
        "The same in radians.", unit="radians", at_least=-1.5708, at_most=1.5708, instead_of=("tilt_deg",),
    )] = None  # fmt: skip
    on_head: Annotated[bool, FieldSpec("`true` if it turns with the robot's head.", quiet=True)] = False

    def model(self) -> CameraModel:
        if self.fx_px is None:
            model = _seen_from(self.width_px, self.height_px, self.horizontal_fov_deg or 0.0)
        else:
            model = CameraModel(
                self.width_px,
                self.height_px,
                self.fx_px,
                self.fx_px if self.fy_px is None else self.fy_px,
                self.width_px / 2.0 if self.cx_px is None else self.cx_px,
                self.height_px / 2.0 if self.cy_px is None else self.cy_px,
            )
        return replace(
            model,
            x_m=self.x_m,
            y_m=self.y_m,
            z_m=self.z_m,
            heading_rad=_radians(self.heading_deg, self.heading_rad),
            tilt_rad=_radians(self.tilt_deg, self.tilt_rad),
            on_head=self.on_head,
        )

    @classmethod
    def of(cls, model: CameraModel) -> "CameraModelKeys":
        lens = {key: getattr(model, key) for key in ("fx_px", "fy_px", "cx_px", "cy_px")}
        degrees = _degrees(2.0 * math.atan2(model.width_px / 2.0, model.fx_px))
        if degrees is not None and _FOV_DEG[0] <= degrees <= _FOV_DEG[1]:
            from_angle = _seen_from(model.width_px, model.height_px, degrees)
            if all(getattr(from_angle, key) == value for key, value in lens.items()):
                lens = {"horizontal_fov_deg": degrees}
        return cls(
            model.width_px,
            model.height_px,
            **lens,
            **{key: getattr(model, key) for key in ("x_m", "y_m", "z_m", "on_head")},
            **_angle("heading", model.heading_rad),
            **_angle("tilt", model.tilt_rad),
        )


class PoseKeys(Value):
    """A place in the robot frame."""

    x_m: Annotated[float, FieldSpec("Distance in front of the robot's centre.", unit="metres")] = 0.0
    y_m: Annotated[float, FieldSpec("Distance to the left of the robot's centre.", unit="metres")] = 0.0
    heading_deg: Annotated[_HeadingDeg | None, FieldSpec()] = None
    heading_rad: Annotated[_HeadingRad | None, FieldSpec()] = None

    @classmethod
    def of(cls, pose: Pose2D) -> "PoseKeys":
        return cls(pose.x_m, pose.y_m, **_angle("heading", pose.heading_rad))

    def pose(self) -> Pose2D:
        return Pose2D(self.x_m, self.y_m, _radians(self.heading_deg, self.heading_rad))


def _seen_from(width_px: int, height_px: int, horizontal_deg: float) -> CameraModel:
    return CameraModel.from_field_of_view(
        width_px=width_px, height_px=height_px, horizontal_rad=math.radians(horizontal_deg)
    )


def _radians(degrees: float | None, radians: float | None) -> float:
    return math.radians(degrees) if degrees is not None else radians or 0.0


def _angle(axis: str, angle_rad: float) -> dict[str, Any]:
    """Key with the angle in degrees where that is exact, else in radians."""
    degrees = _degrees(angle_rad)
    if degrees is None or math.radians(degrees) != angle_rad:
        return {f"{axis}_rad": angle_rad}
    return {f"{axis}_deg": degrees}


def _degrees(angle_rad: float) -> float | None:
    """Shortest number of degrees that is nearly this angle; None if there is none."""
    exact = math.degrees(angle_rad)
    rounded = (round(exact, digits) for digits in range(16))
    return next((degrees for degrees in rounded if math.isclose(math.radians(degrees), angle_rad, rel_tol=1e-15)), None)
