"""Codecs of ROS messages in rosbridge's form, to and from domain values.

Encoders return plain messages with numpy arrays and bytes; ``rosbridge.encode_json`` and ``rosbridge.encode_cbor``
convert them to either format. Decoders accept both and raise only :class:`MessageError` for malformed input. A
decoder's ``stamp_ns`` is the arrival in session time; an encoder's is the ROS stamp.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from caris_desktop.domain.geometry import Pose2D, Pose3D, Twist2D
from caris_desktop.domain.sensing import BatteryState, LaserScan, OccupancyGrid, Odometry, RobotPose
from caris_desktop.domain.translation import QT_TR_NOOP
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


class Lens(Value):
    """Pinhole part of sensor_msgs/CameraInfo: focal lengths and principal point, in pixels of that image."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    robot_stamp_ns: int | None = None


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
    dialect: Dialect, pose_in_map: Pose2D, *, stamp_ns: int, frame_id: str = "map"
) -> Message:
    """Encode geometry_msgs/PoseWithCovarianceStamped."""
    return {
        "header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=frame_id),
        "pose": {"pose": encode_pose(pose_in_map), "covariance": [0.0] * 36},
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
            pose = _decode_transform(part(entry, "transform", what), what)
        except MessageError as error:
            if unusable is None:
                raise MessageError(f"the transform from '{parent}' to '{child}': {error}") from error
            unusable(parent, child, str(error))
            continue
        transforms.append(Transform(parent, child, pose, stamp_of(entry, what)))
    return tuple(transforms)


def _decode_transform(transform: Message, what: str) -> Pose3D:
    translation = part(transform, "translation", what)
    x_m, y_m, z_m = (number(translation, axis, f"{what}.translation") for axis in "xyz")
    return Pose3D(x_m, y_m, z_m, *decode_rotation(part(transform, "rotation", what), f"{what}.rotation"))


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


def encode_camera_info(dialect: Dialect, lens: Lens, *, stamp_ns: int, frame_id: str = "camera") -> Message:
    """Encode sensor_msgs/CameraInfo of a lens without distortion; matrix names are lower case in ROS 2."""
    fx_px, fy_px, cx_px, cy_px = lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px
    matrices = {
        "d": [0.0] * 5,
        "k": [fx_px, 0.0, cx_px, 0.0, fy_px, cy_px, 0.0, 0.0, 1.0],
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [fx_px, 0.0, cx_px, 0.0, 0.0, fy_px, cy_px, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
    return {
        "header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=frame_id),
        "height": lens.height_px,
        "width": lens.width_px,
        "distortion_model": "plumb_bob",
        **{name.upper() if dialect is Dialect.ROS1 else name: matrix for name, matrix in matrices.items()},
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


def decode_camera_info(message: Any) -> Lens | None:
    """Decode sensor_msgs/CameraInfo; None for an uncalibrated camera, whose values are zero."""
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
    return Lens(
        width_px, height_px, fx_px, fy_px, float(intrinsic[2]), float(intrinsic[5]), stamp_of(info, "CameraInfo")
    )


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
