"""Sensor values and robot state.

``stamp_ns`` is the session clock when the value reached this machine; ``robot_stamp_ns`` is the robot's own timestamp
(nanoseconds of its clock), if sent.
"""

import math
import zlib
from dataclasses import field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.control_definitions import ControlValue
from caris_desktop.domain.geometry import Pose2D, Pose3D, Twist2D
from caris_desktop.domain.value_class import Value

MOST_LIDAR_TILT_RAD = math.radians(5.0)
"""Up to this tilt a LIDAR measures walls to 4 mm in 1 m. It meets the floor at least 3 m away (mounted 0.25 m high).
Beyond it floor and ceiling become obstacles.
"""
_LEAST_RANGE_M = 1e-3  # drivers write 0 for a beam without a return, even if their range_min is 0

LidarMounting = Literal["upright", "upside_down", "tilted"]


def lidar_mounting(robot_from_laser: Pose3D) -> LidarMounting:
    """Mounting of a LIDAR, from its rotation in the robot frame."""
    if robot_from_laser.tilt_rad <= MOST_LIDAR_TILT_RAD:
        return "upright"
    return "upside_down" if robot_from_laser.tilt_rad >= math.pi - MOST_LIDAR_TILT_RAD else "tilted"


class LaserScan(Value, eq=False):
    """One planar scan. ``ranges_m`` is float32, shape (beams,); ``inf``: no return, ``nan``: invalid.

    ``robot_from_laser`` is None if the mounting is unknown; the scan then has no position and is not shown.
    ``map_from_laser`` is the pose of the laser in the map when it measured, since left by a turning robot; None if
    unknown. ``intensities`` are float32, one per beam in the device's own unit; empty if it sends none.
    """

    stamp_ns: int
    robot_stamp_ns: int | None
    frame_id: str
    angle_min_rad: float
    angle_increment_rad: float
    range_min_m: float
    range_max_m: float
    ranges_m: NDArray[np.float32] = field(metadata={"shape": (-1,)})
    robot_from_laser: Pose2D | None
    map_from_laser: Pose2D | None = None
    intensities: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32), metadata={"shape": (-1,)})

    def returned(self) -> NDArray[np.bool_]:
        """Mask of the beams with a return in range, shape (beams,)."""
        ranges = self.ranges_m
        least_m = max(self.range_min_m, _LEAST_RANGE_M)
        returned: NDArray[np.bool_] = np.isfinite(ranges) & (ranges >= least_m) & (ranges <= self.range_max_m)
        return returned

    def mounted(self, robot_from_laser: Pose2D | None, *, upside_down: bool = False) -> "LaserScan":
        """Scan of a LIDAR mounted there. ``upside_down``: it turns clockwise as seen from above, so its beams are
        reversed to match an upright one with the same x axis.
        """
        if not upside_down:
            return replace(self, robot_from_laser=robot_from_laser)
        last_rad = self.angle_min_rad + (len(self.ranges_m) - 1) * self.angle_increment_rad
        return replace(
            self,
            robot_from_laser=robot_from_laser,
            angle_min_rad=-last_rad,
            ranges_m=np.ascontiguousarray(self.ranges_m[::-1]),
            intensities=np.ascontiguousarray(self.intensities[::-1]),
        )

    def points(self, laser: Pose2D, *, behind_m: float = 0.0) -> NDArray[np.float64]:
        """End points of the returned beams, or ``behind_m`` beyond: float64, shape (returns, 2), metres, in the frame
        of the pose ``laser``.
        """
        returned = self.returned()
        angles = self.angle_min_rad + self.angle_increment_rad * np.flatnonzero(returned) + laser.heading_rad
        distances = self.ranges_m[returned].astype(np.float64) + behind_m
        return np.column_stack((laser.x_m + distances * np.cos(angles), laser.y_m + distances * np.sin(angles)))


class Odometry(Value):
    """Dead reckoning: pose in the drifting odometry frame, velocity in the robot frame."""

    stamp_ns: int
    robot_stamp_ns: int | None
    pose_in_odom: Pose2D
    twist: Twist2D


class RobotPose(Value):
    """Robot's estimated pose in the map."""

    stamp_ns: int
    robot_stamp_ns: int | None
    pose_in_map: Pose2D


class OccupancyGrid(Value, eq=False):
    """A map. ``cells`` is int8, shape (height, width), row 0 at the origin; -1 unknown, 0 free ... 100 occupied."""

    stamp_ns: int
    robot_stamp_ns: int | None
    resolution_m: float
    origin_in_map: Pose2D
    cells: NDArray[np.int8] = field(metadata={"shape": (-1, -1)})

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle with deflated cells: a 16 MB map is sent between processes as 1 MB, which blocks neither."""
        fields = (self.stamp_ns, self.robot_stamp_ns, self.resolution_m, self.origin_in_map)
        cells = np.ascontiguousarray(self.cells)
        sample = cells.reshape(-1)[: cells.size // 2][-_SAMPLE_CELLS:].tobytes()
        if cells.size < _SAMPLE_CELLS or len(zlib.compress(sample, 1)) > len(sample) // 2:
            return OccupancyGrid, (*fields, cells)
        return _inflated_grid, (fields, cells.shape, zlib.compress(cells.data, 1))


_SAMPLE_CELLS = 100_000


def _inflated_grid(
    fields: tuple[int, int | None, float, Pose2D], shape: tuple[int, int], deflated: bytes
) -> OccupancyGrid:
    content = zlib.decompress(deflated, bufsize=shape[0] * shape[1])
    return OccupancyGrid(*fields, np.frombuffer(content, dtype=np.int8).reshape(shape))


class PlannedPath(Value, eq=False):
    """Planned path of the navigation. ``points_in_map`` is float32, shape (points, 2), metres; may be empty."""

    stamp_ns: int
    robot_stamp_ns: int | None
    points_in_map: NDArray[np.float32] = field(metadata={"shape": (-1, 2)})


class HeadState(Value):
    """Head angles: pan left positive, tilt down positive, both from straight ahead."""

    stamp_ns: int
    robot_stamp_ns: int | None
    pan_rad: float
    tilt_rad: float


class ControlReadings(Value):
    """Newest value of each control in the Robot panel that the robot reports, by control id."""

    stamp_ns: int
    values: dict[str, ControlValue]


class BatteryState(Value):
    """Battery charge: ``charge_fraction`` is 0..1, None if not reported."""

    stamp_ns: int
    charge_fraction: float | None


class FrameRef(Value):
    """A camera frame whose pixels are in the shared frame ring named ``ring``.

    The pixels are uint8 BGR, shape (height_px, width_px, 3). They are overwritten after a while; the ring shows a
    reader whether they were still the ones meant. ``taken_ns`` is when the camera took the frame: on the session clock,
    by the robot's timestamp and clock, to within ``taken_uncertainty_ns``; None if unknown.
    """

    stamp_ns: int
    robot_stamp_ns: int | None
    camera: str
    ring: str
    slot: int
    sequence: int
    width_px: int
    height_px: int
    taken_ns: int | None = None
    taken_uncertainty_ns: int | None = None

    @property
    def shown_ns(self) -> int:
        """Time in a video: when the frame was taken, else when it arrived."""
        return self.stamp_ns if self.taken_ns is None else self.taken_ns


class CameraState(Value):
    """Connection of a camera of this computer. ``detail`` and ``advice`` explain a failure to the wizard.

    ``ended``: a video was played to its end, or the camera is no longer used. ``fps`` is None if not reported.
    """

    stamp_ns: int
    camera: str
    state: Literal["connecting", "connected", "lost", "ended"]
    detail: str = ""
    advice: str = ""
    width_px: int = 0
    height_px: int = 0
    fps: float | None = None


class DepthGrid(Value, eq=False):
    """Depth in front of a camera, along its axis.

    ``depths_mm`` is uint16, shape (rows, columns): the frame in that many parts; 0 if unknown.
    """

    stamp_ns: int
    camera: str
    depths_mm: NDArray[np.uint16] = field(metadata={"shape": (-1, -1)})

    def median_m(self, left: float, top: float, right: float, bottom: float) -> float | None:
        """Median depth within a region, given in fractions of the frame (0 to 1); None if too few pixels are known."""
        rows, columns = self.depths_mm.shape
        across = slice(max(0, math.floor(left * columns)), max(0, math.ceil(right * columns)))
        down = slice(max(0, math.floor(top * rows)), max(0, math.ceil(bottom * rows)))
        inside = self.depths_mm[down, across]
        known = inside[inside > 0]
        return float(np.median(known)) / 1000.0 if known.size * 4 >= max(inside.size, 1) else None


class AudioChunk(Value, eq=False):
    """Sound of one source for the recorder, which writes it to a file and records an :class:`AudioBlock`.

    ``samples`` is int16, shape (samples, channels); ``stamp_ns`` is the time of the first. ``source`` is a plain name
    such as microphone or robot voice.
    """

    stamp_ns: int
    source: str
    sample_rate_hz: int
    samples: NDArray[np.int16] = field(metadata={"shape": (-1, -1)})


class AudioBlock(Value):
    """Recorded sound: ``sample_count`` samples of ``file_name`` from ``first_sample`` on.

    ``stamp_ns`` is the time of the first of them on the session clock.
    """

    stamp_ns: int
    source: str
    file_name: str
    first_sample: int
    sample_count: int
    sample_rate_hz: int


class StatusShown(Value):
    """Status that the console's panels show from this time on, so that a replay shows the same.

    ``name`` is the value's name in LiveState, ``content`` its plain JSON form.
    """

    stamp_ns: int
    name: str
    content: Any


class CameraLens(Value):
    """Lens data that a camera sends. ``model`` contains them in place of the robot profile's."""

    stamp_ns: int
    robot_stamp_ns: int | None
    camera: str
    model: CameraModel


class PersonBox(Value):
    """A person detected in a frame. ``track`` is the tracker's number, ``person_id`` the opaque identity.

    ``posture`` is empty, and ``hand_raised`` and ``facing`` (towards the camera) are None, if not visible or not
    evaluated.
    """

    track: int
    person_id: str
    left_px: float
    top_px: float
    width_px: float
    height_px: float
    confidence: float
    posture: Literal["", "standing", "sitting"] = ""
    hand_raised: bool | None = None
    facing: bool | None = None


class ThingBox(Value):
    """A thing detected in a frame, other than a person. ``label`` is the detector's name: chair, dog."""

    label: str
    left_px: float
    top_px: float
    width_px: float
    height_px: float
    confidence: float


class People(Value):
    """All people detected in one frame; ``stamp_ns`` is the timestamp of that frame.

    ``things`` are of the kinds that the scenario lists, and not tracked. ``unfollowed`` are boxes of possible people,
    detected too briefly or too poorly to be reported. They occur only if people must be blurred in images. Their
    ``track`` is 0.
    """

    stamp_ns: int
    camera: str
    frame_sequence: int
    frame_width_px: int
    frame_height_px: int
    boxes: tuple[PersonBox, ...]
    inference_ms: float
    things: tuple[ThingBox, ...] = ()
    unfollowed: tuple[PersonBox, ...] = ()


class PersonPlace(Value):
    """Position of one person. ``source`` is what measured the distance, ``floor`` by the feet in the frame.
    ``spread_m`` is one standard deviation. ``track`` is that of the box, -1 in older recordings.
    """

    person_id: str
    x_m: float
    y_m: float
    spread_m: float
    source: Literal["lidar", "depth", "floor"]
    track: int = -1


class PeopleInMap(Value):
    """People with a measured position in the map; ``stamp_ns`` is the timestamp of the camera frame.

    ``camera`` is empty for the combined people of several cameras.
    """

    stamp_ns: int
    people: tuple[PersonPlace, ...]
    camera: str = ""
