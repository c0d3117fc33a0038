"""Codecs of ROS messages in rosbridge's form, to and from domain values.

Encoders return plain messages with numpy arrays and bytes; ``rosbridge.encode_json`` and ``rosbridge.encode_cbor``
convert them to either format. Decoders accept both and raise only :class:`MessageError` for malformed input. A
decoder's ``stamp_ns`` is the arrival in session time; an encoder's is the ROS stamp.
"""

import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.geometry import Pose2D, Pose3D, Twist2D
from caris_desktop.domain.sensing import BatteryState, LaserScan, OccupancyGrid, Odometry, RobotPose
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.ros.dialect import Dialect, encode_time
from caris_desktop.ros.message_fields import (
    Message,
    MessageError,
    blob,
    count,
    decode_pose,
    decode_rotation,
    encode_header,
    encode_pose,
    field,
    floats,
    floats_or_empty,
    frame_of,
    int8s,
    is_zero_quaternion,
    message_of,
    number,
    number_or_none,
    objects,
    part,
    stamp_of,
    text,
    text_or_empty,
    time_of,
    truth,
)

MAX_BEAMS = 100_000
MAX_MAP_CELLS = 64_000_000
MAX_IMAGE_BYTES = 32_000_000
MAX_IMAGE_SIDE_PX = 65_535
MAX_TRANSFORMS = 1_000


class Transform(Value):
    """One geometry_msgs/TransformStamped: pose of the child frame in the parent frame, in space or on the floor."""

    parent_frame: str
    child_frame: str
    parent_from_child: Pose3D | Pose2D
    robot_stamp_ns: int | None


class CompressedImage(Value):
    """Compressed camera image. ``encoding`` is the robot's name, usually ``jpeg`` or ``png``."""

    encoding: str
    content: bytes
    robot_stamp_ns: int | None


def encode_twist(twist: Twist2D) -> Message:
    """Encode geometry_msgs/Twist."""
    return {
        "linear": {"x": twist.forward_mps, "y": twist.left_mps, "z": 0.0},
        "angular": {"x": 0.0, "y": 0.0, "z": twist.turn_radps},
    }


def decode_twist(message: Any) -> Twist2D:
    """Decode geometry_msgs/Twist; NaN and infinity are refused."""
    twist = message_of(message, "Twist")
    linear, angular = part(twist, "linear", "Twist"), part(twist, "angular", "Twist")
    return Twist2D(
        number(linear, "x", "Twist.linear"),
        number(linear, "y", "Twist.linear") if "y" in linear else 0.0,
        number(angular, "z", "Twist.angular"),
    )


def encode_twist_stamped(dialect: Dialect, twist: Twist2D, *, stamp_ns: int, frame_id: str = "base_link") -> Message:
    """Encode geometry_msgs/TwistStamped."""
    return {"header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=frame_id), "twist": encode_twist(twist)}


def decode_twist_stamped(message: Any) -> tuple[Twist2D, int | None]:
    """Decode geometry_msgs/TwistStamped: twist, and sender's stamp in ns."""
    stamped = message_of(message, "TwistStamped")
    return decode_twist(field(stamped, "twist", "TwistStamped")), stamp_of(stamped, "TwistStamped")


def encode_laser_scan(dialect: Dialect, scan: LaserScan, *, stamp_ns: int, scan_time_s: float = 0.1) -> Message:
    """Encode sensor_msgs/LaserScan."""
    beams = len(scan.ranges_m)
    return {
        "header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=scan.frame_id),
        "angle_min": scan.angle_min_rad,
        "angle_max": scan.angle_min_rad + scan.angle_increment_rad * max(beams - 1, 0),
        "angle_increment": scan.angle_increment_rad,
        "time_increment": 0.0,
        "scan_time": scan_time_s,
        "range_min": scan.range_min_m,
        "range_max": scan.range_max_m,
        "ranges": np.asarray(scan.ranges_m, dtype=np.float32),
        "intensities": np.asarray(scan.intensities, dtype=np.float32),
    }


def decode_laser_scan(message: Any, *, stamp_ns: int) -> LaserScan:
    """Decode sensor_msgs/LaserScan. JSON's null in ``ranges`` and ``intensities`` becomes ``inf``."""
    scan = message_of(message, "LaserScan")
    range_max_m = number_or_none(scan, "range_max", "LaserScan")
    return LaserScan(
        stamp_ns=stamp_ns,
        robot_stamp_ns=stamp_of(scan, "LaserScan"),
        frame_id=frame_of(scan, "LaserScan"),
        angle_min_rad=number(scan, "angle_min", "LaserScan"),
        angle_increment_rad=number(scan, "angle_increment", "LaserScan"),
        range_min_m=number(scan, "range_min", "LaserScan"),
        range_max_m=math.inf if range_max_m is None else range_max_m,
        ranges_m=floats(scan, "ranges", "LaserScan", most=MAX_BEAMS),
        robot_from_laser=None,
        intensities=floats_or_empty(scan, "intensities", "LaserScan", most=MAX_BEAMS),
    )


def encode_odometry(
    dialect: Dialect, odometry: Odometry, *, stamp_ns: int, frame_id: str = "odom", child_frame_id: str = "base_link"
) -> Message:
    """Encode nav_msgs/Odometry."""
    return {
        "header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=frame_id),
        "child_frame_id": child_frame_id,
        "pose": {"pose": encode_pose(odometry.pose_in_odom), "covariance": [0.0] * 36},
        "twist": {"twist": encode_twist(odometry.twist), "covariance": [0.0] * 36},
    }


def decode_odometry(message: Any, *, stamp_ns: int, pose_of: Callable[[Twist2D], Pose2D] | None = None) -> Odometry:
    """Decode nav_msgs/Odometry. ``pose_of`` supplies the pose for messages without a rotation, which are refused
    otherwise.
    """
    odometry = message_of(message, "Odometry")
    pose, twist = part(odometry, "pose", "Odometry"), part(odometry, "twist", "Odometry")
    velocity = decode_twist(part(twist, "twist", "Odometry.twist"))
    placed = part(pose, "pose", "Odometry.pose")
    no_rotation = pose_of is not None and is_zero_quaternion(placed.get("orientation"))
    return Odometry(
        stamp_ns=stamp_ns,
        robot_stamp_ns=stamp_of(odometry, "Odometry"),
        pose_in_odom=pose_of(velocity) if pose_of and no_rotation else decode_pose(placed, "Odometry.pose.pose"),
        twist=velocity,
    )


def encode_pose_with_covariance_stamped(
    dialect: Dialect,
    pose_in_map: Pose2D,
    *,
    spread_m: float = 0.0,
    spread_rad: float = 0.0,
    stamp_ns: int,
    frame_id: str = "map",
) -> Message:
    """Encode geometry_msgs/PoseWithCovarianceStamped with standard deviations of position and heading."""
    covariance = [0.0] * 36
    covariance[0] = covariance[7] = spread_m**2
    covariance[35] = spread_rad**2
    return {
        "header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=frame_id),
        "pose": {"pose": encode_pose(pose_in_map), "covariance": covariance},
    }


def decode_pose_with_covariance_stamped(message: Any, *, stamp_ns: int) -> RobotPose:
    """Decode geometry_msgs/PoseWithCovarianceStamped, assumed to be in the map frame."""
    what = "PoseWithCovarianceStamped"
    stamped = message_of(message, what)
    pose = part(part(stamped, "pose", what), "pose", f"{what}.pose")
    return RobotPose(stamp_ns, stamp_of(stamped, what), decode_pose(pose, f"{what}.pose.pose"))


def encode_pose_stamped(dialect: Dialect, pose_in_map: Pose2D, *, stamp_ns: int, frame_id: str = "map") -> Message:
    """Encode geometry_msgs/PoseStamped."""
    return {"header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=frame_id), "pose": encode_pose(pose_in_map)}


def decode_pose_stamped(message: Any, *, stamp_ns: int) -> RobotPose:
    """Decode geometry_msgs/PoseStamped, assumed to be in the map frame."""
    stamped = message_of(message, "PoseStamped")
    pose = part(stamped, "pose", "PoseStamped")
    return RobotPose(stamp_ns, stamp_of(stamped, "PoseStamped"), decode_pose(pose, "PoseStamped.pose"))


def encode_occupancy_grid(dialect: Dialect, grid: OccupancyGrid, *, stamp_ns: int, frame_id: str = "map") -> Message:
    """Encode nav_msgs/OccupancyGrid; ``data`` is row-major, int8."""
    height, width = grid.cells.shape
    return {
        "header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=frame_id),
        "info": {
            "map_load_time": encode_header(dialect, stamp_ns=stamp_ns, frame_id="")["stamp"],
            "resolution": grid.resolution_m,
            "width": width,
            "height": height,
            "origin": encode_pose(grid.origin_in_map),
        },
        "data": np.ascontiguousarray(grid.cells, dtype=np.int8).ravel(),
    }


def decode_occupancy_grid(message: Any, *, stamp_ns: int) -> OccupancyGrid:
    """Decode nav_msgs/OccupancyGrid; the number of cells must be width times height."""
    grid = message_of(message, "OccupancyGrid")
    info = part(grid, "info", "OccupancyGrid")
    width = count(info, "width", "OccupancyGrid.info", most=MAX_MAP_CELLS)
    height = count(info, "height", "OccupancyGrid.info", most=MAX_MAP_CELLS)
    resolution_m = number(info, "resolution", "OccupancyGrid.info")
    if resolution_m <= 0.0:
        raise MessageError("OccupancyGrid.info.resolution must be above zero")
    if width * height > MAX_MAP_CELLS:
        raise MessageError(f"OccupancyGrid has {width} x {height} cells; at most {MAX_MAP_CELLS} are accepted")
    cells = int8s(grid, "data", "OccupancyGrid", most=MAX_MAP_CELLS)
    if len(cells) != width * height:
        raise MessageError(f"OccupancyGrid.data has {len(cells)} cells, but its size is {width} x {height}")
    return OccupancyGrid(
        stamp_ns=stamp_ns,
        robot_stamp_ns=stamp_of(grid, "OccupancyGrid"),
        resolution_m=resolution_m,
        origin_in_map=decode_pose(part(info, "origin", "OccupancyGrid.info"), "OccupancyGrid.info.origin"),
        cells=cells.reshape(height, width),
    )


def encode_tf_message(
    dialect: Dialect, transforms: Iterable[tuple[str, str, Pose2D | Pose3D]], *, stamp_ns: int
) -> Message:
    """Encode tf2_msgs/TFMessage from (parent frame, child frame, parent from child)."""
    return {
        "transforms": [
            {
                "header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=parent),
                "child_frame_id": child,
                "transform": {
                    "translation": {"x": pose.x_m, "y": pose.y_m, "z": pose.z_m},
                    "rotation": {"x": pose.qx, "y": pose.qy, "z": pose.qz, "w": pose.qw},
                },
            }
            for parent, child, given in transforms
            for pose in (Pose3D.on_floor(given) if isinstance(given, Pose2D) else given,)
        ]
    }


def decode_tf_message(
    message: Any, *, unusable: Callable[[str, str, str], None] | None = None
) -> tuple[Transform, ...]:
    """Decode tf2_msgs/TFMessage. A leading slash of a frame name (an old convention) is dropped.

    ``unusable`` gets parent, child and reason of each omitted transform with invalid numbers; without it the message is
    refused.
    """
    entries = objects(message_of(message, "TFMessage"), "transforms", "TFMessage", most=MAX_TRANSFORMS)
    transforms = []
    for index, entry in enumerate(entries):
        what = f"TFMessage.transforms[{index}]"
        parent, child = frame_of(entry, what).lstrip("/"), text(entry, "child_frame_id", what).lstrip("/")
        try:
            transform = part(entry, "transform", what)
            translation = part(transform, "translation", what)
            x_m, y_m, z_m = (number(translation, axis, f"{what}.translation") for axis in "xyz")
            pose = Pose3D(x_m, y_m, z_m, *decode_rotation(part(transform, "rotation", what), f"{what}.rotation"))
        except MessageError as error:
            if unusable is None:
                raise MessageError(f"the transform from '{parent}' to '{child}': {error}") from error
            unusable(parent, child, str(error))
            continue
        transforms.append(Transform(parent, child, pose, stamp_of(entry, what)))
    return tuple(transforms)


def encode_battery_state(dialect: Dialect, battery: BatteryState, *, stamp_ns: int, voltage_v: float = 24.0) -> Message:
    """Encode sensor_msgs/BatteryState; unknown values are NaN, as its definition demands."""
    return {
        "header": encode_header(dialect, stamp_ns=stamp_ns, frame_id="base_link"),
        "voltage": voltage_v,
        "current": math.nan,
        "charge": math.nan,
        "capacity": math.nan,
        "design_capacity": math.nan,
        "percentage": math.nan if battery.charge_fraction is None else battery.charge_fraction,
        "power_supply_status": 2,  # discharging
        "power_supply_health": 1,
        "power_supply_technology": 3,
        "present": True,
        "cell_voltage": [],
        "location": "",
        "serial_number": "",
    }


def decode_battery_state(message: Any, *, stamp_ns: int) -> BatteryState:
    """Decode sensor_msgs/BatteryState. Values above 1 up to 100 are percentages, as some robots send."""
    fraction = number_or_none(message_of(message, "BatteryState"), "percentage", "BatteryState")
    if fraction is not None and 1.0 < fraction <= 100.0:
        fraction /= 100.0
    if fraction is not None and not 0.0 <= fraction <= 1.0:
        raise MessageError("BatteryState.percentage must be between 0 and 1")
    return BatteryState(stamp_ns, fraction)


def encode_compressed_image(
    dialect: Dialect, content: bytes, *, stamp_ns: int, encoding: str = "jpeg", frame_id: str = "camera"
) -> Message:
    """Encode sensor_msgs/CompressedImage."""
    return {"header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=frame_id), "format": encoding, "data": content}


def decode_compressed_image(message: Any) -> CompressedImage:
    """Decode sensor_msgs/CompressedImage: base64 text in JSON, bytes in CBOR. The image itself stays encoded."""
    image = message_of(message, "CompressedImage")
    encoding = text_or_empty(image, "format", "CompressedImage")
    if "compresseddepth" in encoding.lower():
        # Twelve bytes of parameters before a PNG of distances, which no image decoder accepts.
        raise MessageError(
            QT_TR_NOOP("it is a depth image (compressedDepth), which cannot be shown: use a colour image")
        )
    return CompressedImage(
        encoding=encoding,
        content=blob(image, "data", "CompressedImage", most=MAX_IMAGE_BYTES),
        robot_stamp_ns=stamp_of(image, "CompressedImage"),
    )


def encode_camera_info(dialect: Dialect, model: CameraModel, *, stamp_ns: int, frame_id: str = "camera") -> Message:
    """Encode sensor_msgs/CameraInfo of a camera without distortion; matrix names are lower case in ROS 2."""
    fx_px, fy_px, cx_px, cy_px = model.fx_px, model.fy_px, model.cx_px, model.cy_px
    matrices = {
        "d": [0.0] * 5,
        "k": [fx_px, 0.0, cx_px, 0.0, fy_px, cy_px, 0.0, 0.0, 1.0],
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [fx_px, 0.0, cx_px, 0.0, 0.0, fy_px, cy_px, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
    return {
        "header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=frame_id),
        "height": model.height_px,
        "width": model.width_px,
        "distortion_model": "plumb_bob",
        **{name.upper() if dialect is Dialect.ROS1 else name: matrix for name, matrix in matrices.items()},
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


def decode_camera_info(message: Any) -> tuple[CameraModel, int | None] | None:
    """Decode sensor_msgs/CameraInfo: the camera without its place, and robot's stamp in ns; None for an uncalibrated
    one, whose values are zero.
    """
    info = message_of(message, "CameraInfo")
    name = "K" if "K" in info else "k"
    intrinsic = floats(info, name, "CameraInfo", most=9)
    if len(intrinsic) != 9 or not np.isfinite(intrinsic).all():
        raise MessageError(f"CameraInfo.{name} must contain nine numbers")
    fx_px, fy_px = float(intrinsic[0]), float(intrinsic[4])
    width_px = count(info, "width", "CameraInfo", most=MAX_IMAGE_SIDE_PX)
    height_px = count(info, "height", "CameraInfo", most=MAX_IMAGE_SIDE_PX)
    if fx_px <= 0.0 or fy_px <= 0.0 or not width_px or not height_px:
        return None
    model = CameraModel(width_px, height_px, fx_px, fy_px, float(intrinsic[2]), float(intrinsic[5]))
    return model, stamp_of(info, "CameraInfo")


def encode_string(value: str) -> Message:
    """Encode std_msgs/String."""
    return {"data": value}


def decode_string(message: Any) -> str:
    """Decode std_msgs/String."""
    return text(message_of(message, "String"), "data", "String")


def encode_bool(value: bool) -> Message:
    """Encode std_msgs/Bool."""
    return {"data": value}


def decode_bool(message: Any) -> bool:
    """Decode std_msgs/Bool."""
    return truth(message_of(message, "Bool"), "data", "Bool")


# Speed limit messages for navigation: nav2_msgs/SpeedLimit (ROS 2) and dynamic_reconfigure/Reconfigure (ROS 1).

NO_LIMIT = 0.0
"""``speed_limit`` of nav2_msgs/SpeedLimit that lifts an earlier one."""


def encode_speed_limit(limit_mps: float) -> Message:
    """Encode nav2_msgs/SpeedLimit, absolute in m/s; :data:`NO_LIMIT` lifts it. Nav2's controllers never exceed their
    own.
    """
    header = {"stamp": encode_time(Dialect.ROS2, 0), "frame_id": ""}
    return {"header": header, "percentage": False, "speed_limit": limit_mps}


def decode_speed_limit(message: Message) -> tuple[float, bool]:
    """Limit, and whether it is a percentage."""
    percentage = message.get("percentage", False)
    if not isinstance(percentage, bool):
        raise MessageError("SpeedLimit.percentage must be true or false")
    return number(message, "speed_limit", "SpeedLimit"), percentage


def encode_reconfigure(doubles: dict[str, float]) -> Message:
    """Request of dynamic_reconfigure/Reconfigure that sets only these parameters."""
    values = [{"name": name, "value": value} for name, value in doubles.items()]
    return {"config": {"bools": [], "ints": [], "strs": [], "doubles": values, "groups": []}}


def decode_reconfigured(answer: Any, names: Sequence[str]) -> dict[str, float]:
    """Present values of the named parameters in the answer of dynamic_reconfigure/Reconfigure."""
    config = message_of(message_of(answer, "Reconfigure").get("config", {}), "Reconfigure.config")
    doubles = config.get("doubles", [])
    if not isinstance(doubles, list):
        raise MessageError("Reconfigure.config.doubles must be a list")
    parameters = [message_of(double, "DoubleParameter") for double in doubles]
    return {str(one["name"]): number(one, "value", "DoubleParameter") for one in parameters if one.get("name") in names}


# Paths, map updates and the simulated clock.

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


def encode_clock(dialect: Dialect, time_ns: int) -> Message:
    """Encode rosgraph_msgs/Clock."""
    return {"clock": encode_time(dialect, time_ns)}


def decode_clock(message: Any) -> int:
    """Nanoseconds of a rosgraph_msgs/Clock."""
    return time_of(message_of(message, "Clock"), "clock", "Clock") or 0


# Joints: states, trajectories and angles with speed.

MAX_JOINTS = 1_000
_MAX_POINTS = 10_000


class JointPositions(Value):
    """Position of each named joint, in radians or metres."""

    robot_stamp_ns: int | None
    positions: dict[str, float]


def encode_joint_state(dialect: Dialect, positions: Mapping[str, float], *, stamp_ns: int) -> Message:
    """Encode sensor_msgs/JointState."""
    return {
        "header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=""),
        "name": list(positions),
        "position": np.array(list(positions.values()), dtype=np.float64),
        "velocity": [],
        "effort": [],
    }


def decode_joint_state(message: Any) -> JointPositions:
    """Decode sensor_msgs/JointState. Joints without a finite position are omitted."""
    state = message_of(message, "JointState")
    names = _names(state, "name", "JointState")
    positions = floats(state, "position", "JointState", most=MAX_JOINTS) if "position" in state else ()
    known = {name: float(position) for name, position in zip(names, positions, strict=False) if np.isfinite(position)}
    return JointPositions(stamp_of(state, "JointState"), known)


def encode_joint_trajectory(dialect: Dialect, positions: Mapping[str, float], *, duration_s: float) -> Message:
    """Encode trajectory_msgs/JointTrajectory with one point, starting at once."""
    return {
        "header": encode_header(dialect, stamp_ns=0, frame_id=""),
        "joint_names": list(positions),
        "points": [
            {
                "positions": list(positions.values()),
                "velocities": [],
                "accelerations": [],
                "effort": [],
                "time_from_start": encode_time(dialect, int(duration_s * 1e9)),
            }
        ],
    }


def decode_joint_trajectory(message: Any) -> tuple[dict[str, float], float]:
    """Last point of a trajectory_msgs/JointTrajectory, and its time in seconds."""
    what = "JointTrajectory"
    trajectory = message_of(message, what)
    names = _names(trajectory, "joint_names", what)
    points = objects(trajectory, "points", what, most=_MAX_POINTS)
    if not points:
        return {}, 0.0
    last = f"{what}.points[{len(points) - 1}]"
    positions = floats(points[-1], "positions", last, most=MAX_JOINTS)
    if len(positions) != len(names) or not np.isfinite(positions).all():
        raise MessageError(f"{last}.positions must contain one number for each of the {len(names)} joints")
    duration_ns = time_of(points[-1], "time_from_start", last) if "time_from_start" in points[-1] else None
    return dict(zip(names, positions.tolist(), strict=True)), (duration_ns or 0) / 1e9


def encode_joint_angles_with_speed(
    dialect: Dialect, positions: Mapping[str, float], *, speed_fraction: float
) -> Message:
    """Encode naoqi_bridge_msgs/JointAnglesWithSpeed; ``speed_fraction`` of the motors' maximum, 0..1."""
    return {
        "header": encode_header(dialect, stamp_ns=0, frame_id=""),
        "joint_names": list(positions),
        "joint_angles": list(positions.values()),
        "speed": speed_fraction,
        "relative": 0,
    }


def decode_joint_angles_with_speed(message: Any) -> tuple[dict[str, float], float]:
    """Angles and speed fraction of a naoqi_bridge_msgs/JointAnglesWithSpeed."""
    what = "JointAnglesWithSpeed"
    angles = message_of(message, what)
    names = _names(angles, "joint_names", what)
    positions = floats(angles, "joint_angles", what, most=MAX_JOINTS)
    if len(positions) != len(names) or not np.isfinite(positions).all():
        raise MessageError(f"{what}.joint_angles must contain one number for each of the {len(names)} joints")
    return dict(zip(names, positions.tolist(), strict=True)), number(angles, "speed", what)


def _names(message: Message, name: str, what: str) -> list[str]:
    value = field(message, name, what)
    if not isinstance(value, list) or len(value) > MAX_JOINTS or not all(isinstance(item, str) for item in value):
        raise MessageError(f"{what}.{name} must be a list of at most {MAX_JOINTS} names")
    return value


# Map services: slam_toolbox, and Nav2's map server and map saver.

START_AT_FIRST_NODE = 1
START_AT_GIVEN_POSE = 2
LOCALIZE_AT_POSE = 3
"""match_type of slam_toolbox/DeserializePoseGraph."""

_LOADING_FAILED = {
    1: "the robot has no such map",
    2: "the map's data cannot be read",
    3: "the map's description cannot be read",
    255: "the robot gave no reason",
}
_SERIALIZING_FAILED = {1: "the robot has no map yet", 255: "the file cannot be written"}


def encode_serialize_map(file_name: str) -> Message:
    """Request of slam_toolbox/SerializePoseGraph; ``file_name`` is without a suffix."""
    return {"filename": file_name}


def encode_deserialize_map(file_name: str, *, match_type: int, at: Pose2D | None = None) -> Message:
    """Request of slam_toolbox/DeserializePoseGraph. ``at`` is the robot's pose, for match types that need it."""
    pose = at or Pose2D(0.0, 0.0, 0.0)
    return {
        "filename": file_name,
        "match_type": match_type,
        "initial_pose": {"x": pose.x_m, "y": pose.y_m, "theta": pose.heading_rad},
    }


def encode_load_map(map_url: str) -> Message:
    """Request of nav2_msgs/LoadMap, and of nav_msgs/LoadMap of ROS 1."""
    return {"map_url": map_url}


def encode_save_map(map_url: str, *, map_topic: str) -> Message:
    """Request of nav2_msgs/SaveMap, with the usual thresholds."""
    return {
        "map_topic": map_topic,
        "map_url": map_url,
        "image_format": "pgm",
        "map_mode": "trinary",
        "free_thresh": 0.25,
        "occupied_thresh": 0.65,
    }


def serialize_failure(answer: Any) -> str:
    """Reason of a failed slam_toolbox/SerializePoseGraph; empty on success. Old versions return nothing."""
    result = message_of(answer, "SerializePoseGraph").get("result", 0)
    code = count({"result": result}, "result", "SerializePoseGraph", most=255)
    return "" if code == 0 else _SERIALIZING_FAILED.get(code, f"the robot responded with error {code}")


def load_failure(answer: Any) -> str:
    """Reason of a failed LoadMap; empty on success."""
    code = count(message_of(answer, "LoadMap"), "result", "LoadMap", most=255)
    return "" if code == 0 else _LOADING_FAILED.get(code, f"the robot responded with error {code}")


def save_failure(answer: Any) -> str:
    """Reason of a failed nav2_msgs/SaveMap; empty on success."""
    return "" if truth(message_of(answer, "SaveMap"), "result", "SaveMap") else "the robot gave no reason"


# Audio (audio_common_msgs), of audio_common in ROS 1 and its ROS 2 branch.

MAX_AUDIO_BYTES = 1_000_000
MOST_CHANNELS = 16
LEAST_RATE_HZ, MOST_RATE_HZ = 4_000, 192_000

Coding = Literal["wave", "mp3"]


class AudioPacket(Value):
    """Content of one message: raw samples, or a piece of an mp3 stream."""

    content: bytes
    robot_stamp_ns: int | None


class AudioForm(Value):
    """Audio format of a topic."""

    coding: Coding
    rate_hz: int
    channels: int


def decode_audio_data(message: Any) -> AudioPacket:
    """Decode audio_common_msgs/AudioData, or AudioDataStamped, whose stamp is that of its first sample."""
    audio = message_of(message, "AudioData")
    if "audio" in audio:
        data = part(audio, "audio", "AudioDataStamped")
        content = blob(data, "data", "AudioDataStamped.audio", most=MAX_AUDIO_BYTES)
        return AudioPacket(content, stamp_of(audio, "AudioDataStamped"))
    return AudioPacket(blob(audio, "data", "AudioData", most=MAX_AUDIO_BYTES), None)


def encode_audio_data(samples: NDArray[np.int16]) -> Message:
    """Encode audio_common_msgs/AudioData as wave; ``samples`` has the shape (samples, channels)."""
    return {"data": np.ascontiguousarray(samples, dtype="<i2").tobytes()}


def decode_audio_info(message: Any) -> AudioForm:
    """Decode audio_common_msgs/AudioInfo."""
    info = message_of(message, "AudioInfo")
    coding = text(info, "coding_format", "AudioInfo", most=40).lower()
    if coding not in ("wave", "mp3"):
        raise MessageError(f"audio encoded as '{coding}' is not supported; wave and mp3 are")
    sample_format = text(info, "sample_format", "AudioInfo", most=40)
    if coding == "wave" and sample_format.upper() != "S16LE":
        raise MessageError(f"samples in the format '{sample_format}' are not supported; S16LE is")
    rate_hz = count(info, "sample_rate", "AudioInfo", most=MOST_RATE_HZ)
    channels = count(info, "channels", "AudioInfo", most=MOST_CHANNELS)
    if rate_hz < LEAST_RATE_HZ or not channels:
        raise MessageError(f"audio with {rate_hz} samples per second and {channels} channels")
    return AudioForm("wave" if coding == "wave" else "mp3", rate_hz, channels)


def samples_of(content: bytes, channels: int) -> NDArray[np.int16]:
    """S16LE as int16, shape (samples, channels). Raises MessageError for incomplete samples."""
    if len(content) % (2 * channels):
        raise MessageError(f"{len(content)} bytes of audio are not complete samples of {channels} channel(s)")
    return np.frombuffer(content, "<i2").astype(np.int16).reshape(-1, channels)


# Uncompressed images: sensor_msgs/Image in the camera driver's formats.

MOST_PIXELS = 64_000_000
NEAR_M, FAR_M = 0.3, 6.0
"""The distances between which a depth picture goes from white to black; nearer is white, and unknown is black."""

# Channels, and OpenCV's name of the conversion to BGR
_COLOURS = {"bgr": (3, ""), "rgb": (3, "RGB2BGR"), "rgba": (4, "RGBA2BGR"), "bgra": (4, "BGRA2BGR"),
            "mono": (1, "GRAY2BGR")}  # fmt: skip
_BITS: dict[str, np.dtype[Any]] = {"8": np.dtype(np.uint8), "16": np.dtype(np.uint16)}
# OpenCV names a pattern by its second row.
_BAYER = {"bayer_rggb": "BayerBG", "bayer_bggr": "BayerRG", "bayer_gbrg": "BayerGR", "bayer_grbg": "BayerGB"}
# uyvy and yuyv are the names since ROS 2 Iron.
_YUV = {"yuv422": "UYVY", "uyvy": "UYVY", "yuv422_yuy2": "YUY2", "yuyv": "YUY2"}
_DEPTHS: dict[str, np.dtype[Any]] = {"16UC1": np.dtype(np.uint16), "32FC1": np.dtype(np.float32)}
_OF_OPENCV = {"8UC1": "mono8", "8UC3": "bgr8", "8UC4": "bgra8"}


class RawImage(Value, eq=False):
    """``image_bgr`` is uint8, shape (height, width, 3)."""

    image_bgr: NDArray[np.uint8]
    robot_stamp_ns: int | None


class _Layout(Value):
    """Memory layout: ``channels`` values of ``dtype`` per pixel. ``conversion`` is OpenCV's name of the conversion to
    BGR, empty for none; ``depth``: a depth image.
    """

    dtype: np.dtype[Any]
    channels: int
    conversion: str
    depth: bool = False


def decode_image(message: Any) -> RawImage:
    """Decode colours, grey, Bayer and YUV patterns, and depth (16UC1 in millimetres, 32FC1 in metres: REP 118) as grey.

    Raises
    ------
    MessageError
        Also where step and size do not agree with the data: what is torn is not shown.
    """
    import cv2

    image = message_of(message, "Image")
    encoding = text(image, "encoding", "Image")
    layout = _layout_of(encoding)
    pixels = _pixels(image, layout)
    if layout.depth:
        grey = depth_as_grey(pixels[:, :, 0].astype(np.float32) * (0.001 if layout.dtype.kind == "u" else 1.0))
        return RawImage(np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), np.uint8), stamp_of(image, "Image"))
    if layout.dtype.itemsize == 2:
        pixels = (pixels >> 8).astype(np.uint8)
    try:
        if layout.conversion:
            # Two colours of a YUV pattern require an even width, which OpenCV checks.
            pixels = cv2.cvtColor(np.ascontiguousarray(pixels), getattr(cv2, f"COLOR_{layout.conversion}"))
    except cv2.error as error:
        raise MessageError(f"an image that cannot be converted ({encoding[:20]})") from error
    return RawImage(np.ascontiguousarray(pixels, np.uint8), stamp_of(image, "Image"))


def depth_as_grey(depth_m: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Grey image of depth: near is bright, far is dark, unknown (0, NaN, infinite) is black."""
    known = np.isfinite(depth_m) & (depth_m > 0.0)
    share = (FAR_M - np.where(known, depth_m, FAR_M)) / (FAR_M - NEAR_M)
    return (np.clip(share, 0.0, 1.0) * 255.0).astype(np.uint8)


def republish_advice(raw_topic: str) -> str:
    """Advice for compressed images from the robot."""
    return localized(
        QT_TR_NOOP(
            "run 'image_transport republish raw compressed' for {raw_topic} on the robot, or install the "
            "plugin for compressed images there, and use {raw_topic}/compressed in the profile"
        ),
        raw_topic=raw_topic,
    )


def _layout_of(encoding: str) -> _Layout:
    name = _OF_OPENCV.get(encoding, encoding)
    if name in _DEPTHS:
        return _Layout(_DEPTHS[name], 1, "", depth=True)
    if name in _YUV:
        return _Layout(_BITS["8"], 2, f"YUV2BGR_{_YUV[name]}")
    colours = name.rstrip("0123456789")
    dtype = _BITS.get(name.removeprefix(colours))
    if dtype is not None and colours in _BAYER:
        return _Layout(dtype, 1, f"{_BAYER[colours]}2BGR")
    if dtype is not None and colours in _COLOURS:
        channels, conversion = _COLOURS[colours]
        return _Layout(dtype, channels, conversion)
    raise MessageError(f"images encoded as '{encoding[:40]}' are not supported")


def _pixels(image: Message, layout: _Layout) -> NDArray[Any]:
    """Shape (height, width, channels), in native byte order."""
    width, height = (count(image, name, "Image", most=MAX_IMAGE_SIDE_PX) for name in ("width", "height"))
    step = count(image, "step", "Image", most=2**31)
    if not width or not height or width * height > MOST_PIXELS:
        raise MessageError(f"an image of {width} x {height} pixels")
    data = np.frombuffer(blob(image, "data", "Image", most=16 * MOST_PIXELS), np.uint8)
    row_bytes = width * layout.channels * layout.dtype.itemsize
    if step < row_bytes:
        raise MessageError(f"rows of {step} bytes, too few for {width} pixels")
    if len(data) != step * height:
        raise MessageError(f"{len(data)} bytes for {height} rows of {step}")
    rows = np.ascontiguousarray(data.reshape(height, step)[:, :row_bytes])
    values = rows.view(layout.dtype).reshape(height, width, layout.channels)
    foreign = bool(image.get("is_bigendian")) != (sys.byteorder == "big")
    return values.byteswap() if foreign and layout.dtype.itemsize > 1 else values
