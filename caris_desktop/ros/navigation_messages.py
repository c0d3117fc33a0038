"""Navigation messages: paths, map updates, initial poses and the simulated clock.

Encoders and decoders keep the rules of :mod:`caris_desktop.ros.message_conversion`.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.value_class import Value
from caris_desktop.ros.dialect import Dialect, decode_time, encode_time
from caris_desktop.ros.message_conversion import MAX_MAP_CELLS
from caris_desktop.ros.message_fields import (
    Message,
    MessageError,
    count,
    encode_header,
    encode_pose,
    field,
    frame_of,
    int8s,
    message_of,
    number,
    part,
    stamp_of,
)

MAX_PATH_POSES = 50_000


class Path(Value, eq=False):
    """nav_msgs/Path: ``points_m`` is float32, shape (poses, 2), in ``frame_id``."""

    frame_id: str
    robot_stamp_ns: int | None
    points_m: NDArray[np.float32]


class GridUpdate(Value, eq=False):
    """map_msgs/OccupancyGridUpdate: int8 ``cells``, shape (height, width), for column ``x``, row ``y``."""

    robot_stamp_ns: int | None
    x: int
    y: int
    cells: NDArray[np.int8]


def encode_path(dialect: Dialect, points_m: NDArray[np.float32], *, stamp_ns: int, frame_id: str = "map") -> Message:
    """Encode nav_msgs/Path."""
    header = encode_header(dialect, stamp_ns=stamp_ns, frame_id=frame_id)
    return {
        "header": header,
        "poses": [{"header": header, "pose": encode_pose(Pose2D(float(x), float(y), 0.0))} for x, y in points_m],
    }


def decode_path(message: Any, *, most_points: int = MAX_PATH_POSES) -> Path:
    """Decode nav_msgs/Path without headings.

    Of more than ``most_points`` poses, that many are read at even intervals, including the first and the last.
    """
    path = message_of(message, "Path")
    poses = field(path, "poses", "Path")
    if not isinstance(poses, list) or len(poses) > MAX_PATH_POSES:
        raise MessageError(f"Path.poses must be a list of at most {MAX_PATH_POSES} poses")
    chosen = np.linspace(0, len(poses) - 1, min(len(poses), most_points)).round().astype(int).tolist()
    points = np.empty((len(chosen), 2), dtype=np.float32)
    with np.errstate(over="ignore"):
        for row, index in enumerate(chosen):
            what = f"Path.poses[{index}]"
            position = part(part(message_of(poses[index], what), "pose", what), "position", what)
            points[row] = number(position, "x", what), number(position, "y", what)
    if not np.isfinite(points).all():
        raise MessageError("Path has a point that is too far away")
    return Path(frame_of(path, "Path").lstrip("/"), stamp_of(path, "Path"), points)


def encode_occupancy_grid_update(
    dialect: Dialect, cells: NDArray[np.int8], *, x: int, y: int, stamp_ns: int, frame_id: str = "map"
) -> Message:
    """Encode map_msgs/OccupancyGridUpdate of ``cells``, int8, shape (height, width)."""
    height, width = cells.shape
    return {
        "header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=frame_id),
        "x": x,
        "y": y,
        "width": width,
        "height": height,
        "data": np.ascontiguousarray(cells, dtype=np.int8).ravel(),
    }


def decode_occupancy_grid_update(message: Any) -> GridUpdate:
    """Decode map_msgs/OccupancyGridUpdate; the number of cells must be width times height."""
    what = "OccupancyGridUpdate"
    update = message_of(message, what)
    x, y, width, height = (count(update, name, what, most=MAX_MAP_CELLS) for name in ("x", "y", "width", "height"))
    cells = int8s(update, "data", what, most=MAX_MAP_CELLS)
    if len(cells) != width * height:
        raise MessageError(f"{what}.data has {len(cells)} cells, but its size is {width} x {height}")
    return GridUpdate(stamp_of(update, what), x, y, cells.reshape(height, width))


def encode_initial_pose(
    dialect: Dialect, pose_in_map: Pose2D, *, spread_m: float, spread_rad: float, stamp_ns: int, frame_id: str = "map"
) -> Message:
    """Encode geometry_msgs/PoseWithCovarianceStamped with standard deviations of position and heading."""
    covariance = [0.0] * 36
    covariance[0] = covariance[7] = spread_m**2
    covariance[35] = spread_rad**2
    return {
        "header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=frame_id),
        "pose": {"pose": encode_pose(pose_in_map), "covariance": covariance},
    }


def encode_clock(dialect: Dialect, time_ns: int) -> Message:
    """Encode rosgraph_msgs/Clock."""
    return {"clock": encode_time(dialect, time_ns)}


def decode_clock(message: Any) -> int:
    """Nanoseconds of a rosgraph_msgs/Clock."""
    try:
        return decode_time(field(message_of(message, "Clock"), "clock", "Clock")) or 0
    except ValueError as error:
        if isinstance(error, MessageError):
            raise
        raise MessageError(f"Clock.clock: {error}") from error
