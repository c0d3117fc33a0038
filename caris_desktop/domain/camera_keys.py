"""File keys of cameras and poses: from a data sheet, in degrees or radians."""

import math
from dataclasses import replace
from typing import Annotated, Any

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.value_class import Value

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
