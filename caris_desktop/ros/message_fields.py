"""Field access for rosbridge messages, with a clear error for each kind of mistake."""

import base64
import binascii
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.geometry import Pose2D, Pose3D
from caris_desktop.ros.dialect import Dialect, decode_time, encode_time

Message = dict[str, Any]

MAX_TEXT_CHARS = 1_000_000


class MessageError(ValueError):
    """Malformed message; the text names the field."""


def message_of(value: Any, what: str) -> Message:
    """``value`` as a message (an object)."""
    if not isinstance(value, dict):
        raise MessageError(f"{what} must be an object, but it is {_kind(value)}")
    return value


def part(message: Message, name: str, what: str) -> Message:
    """Nested message ``name``."""
    return message_of(field(message, name, what), f"{what}.{name}")


def field(message: Message, name: str, what: str) -> Any:
    """Value of field ``name``."""
    if name not in message:
        raise MessageError(f"{what} has no field '{name}'")
    return message[name]


def number(message: Message, name: str, what: str) -> float:
    """Finite number."""
    return _finite(field(message, name, what), f"{what}.{name}")


def number_or_none(message: Message, name: str, what: str) -> float | None:
    """Finite number, or None for unknown (null, NaN or infinite)."""
    value = field(message, name, what)
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return None
    return _finite(value, f"{what}.{name}")


def count(message: Message, name: str, what: str, *, most: int) -> int:
    """Integer from 0 to ``most``."""
    value = field(message, name, what)
    if isinstance(value, np.integer):
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int):
        raise MessageError(f"{what}.{name} must be an integer, but it is {_kind(value)}")
    if not 0 <= value <= most:
        raise MessageError(f"{what}.{name} must be between 0 and {most}")
    return value


def text(message: Message, name: str, what: str, *, most: int = MAX_TEXT_CHARS) -> str:
    """Text of at most ``most`` characters."""
    value = field(message, name, what)
    if not isinstance(value, str):
        raise MessageError(f"{what}.{name} must be a string, but it is {_kind(value)}")
    if len(value) > most:
        raise MessageError(f"{what}.{name} is longer than {most} characters")
    return value


def text_or_empty(message: Message, name: str, what: str) -> str:
    """Optional text."""
    return text(message, name, what) if name in message else ""


def truth(message: Message, name: str, what: str) -> bool:
    """Boolean."""
    value = field(message, name, what)
    if not isinstance(value, (bool, np.bool_)):
        raise MessageError(f"{what}.{name} must be true or false, but it is {_kind(value)}")
    return bool(value)


def objects(message: Message, name: str, what: str, *, most: int) -> list[Message]:
    """List of at most ``most`` nested messages."""
    value = field(message, name, what)
    if not isinstance(value, list):
        raise MessageError(f"{what}.{name} must be a list, but it is {_kind(value)}")
    if len(value) > most:
        raise MessageError(f"{what}.{name} has {len(value)} entries; at most {most} are accepted")
    return [message_of(item, f"{what}.{name}[{index}]") for index, item in enumerate(value)]


def floats(message: Message, name: str, what: str, *, most: int) -> NDArray[np.float32]:
    """float32, shape (n,). JSON's null becomes ``inf`` (rosbridge's form of inf and NaN); CBOR preserves both."""
    value = field(message, name, what)
    where = f"{what}.{name}"
    _check_length(value, where, most)
    if isinstance(value, np.ndarray):
        if value.ndim != 1 or value.dtype.kind not in "iuf":
            raise MessageError(f"{where} must be a list of numbers")
        with np.errstate(over="ignore"):
            return value.astype(np.float32)
    cleaned = [math.inf if item is None else item for item in value]
    if not all(type(item) in (int, float) for item in cleaned):
        raise MessageError(f"{where} must contain only numbers")
    try:
        with np.errstate(over="ignore"):
            return np.array(cleaned, dtype=np.float64).astype(np.float32)
    except (OverflowError, ValueError) as error:
        raise MessageError(f"{where} contains a number that is too large") from error


def floats_or_empty(message: Message, name: str, what: str, *, most: int) -> NDArray[np.float32]:
    """Optional numbers."""
    return floats(message, name, what, most=most) if name in message else np.zeros(0, np.float32)


def int8s(message: Message, name: str, what: str, *, most: int) -> NDArray[np.int8]:
    """int8, shape (n,), from a list, a typed array or bytes."""
    value = field(message, name, what)
    where = f"{what}.{name}"
    _check_length(value, where, most)
    if isinstance(value, bytes):
        return np.frombuffer(value, dtype=np.int8).copy()
    if isinstance(value, list):
        try:
            value = np.array(value) if value else np.zeros(0, dtype=np.int8)
        except (OverflowError, ValueError) as error:
            raise MessageError(f"{where} must contain only integers") from error
    if value.ndim != 1 or value.dtype.kind not in "iu":
        raise MessageError(f"{where} must contain only integers")
    if value.dtype != np.int8 and value.size and (value.min() < -128 or value.max() > 127):
        raise MessageError(f"{where} must contain numbers between -128 and 127")
    cells: NDArray[np.int8] = value.astype(np.int8)
    return cells


def blob(message: Message, name: str, what: str, *, most: int) -> bytes:
    """Bytes: base64 text in JSON, a byte string in CBOR."""
    value = field(message, name, what)
    where = f"{what}.{name}"
    if isinstance(value, str):
        if len(value) > most * 4 // 3 + 4:
            raise MessageError(f"{where} is larger than {most} bytes")
        try:
            return base64.b64decode(value, validate=True)
        except (binascii.Error, ValueError) as error:
            raise MessageError(f"{where} is not valid base64") from error
    if isinstance(value, np.ndarray) and value.dtype.itemsize == 1 and value.nbytes <= most:
        return value.tobytes()
    if not isinstance(value, bytes):
        raise MessageError(f"{where} must be a base64 string or bytes, but it is {_kind(value)}")
    if len(value) > most:
        raise MessageError(f"{where} is larger than {most} bytes")
    return value


def encode_header(dialect: Dialect, *, stamp_ns: int, frame_id: str) -> Message:
    """Encode std_msgs/Header."""
    header: Message = {"stamp": encode_time(dialect, stamp_ns), "frame_id": frame_id}
    if dialect is Dialect.ROS1:
        header["seq"] = 0
    return header


def stamp_of(message: Message, what: str) -> int | None:
    """Robot's stamp in ns, or None if header or stamp is missing or zero."""
    if "header" not in message:
        return None
    header = part(message, "header", what)
    return time_of(header, "stamp", f"{what}.header") if "stamp" in header else None


def time_of(message: Message, name: str, what: str) -> int | None:
    """ROS time in ns; None for zero, which means unstamped."""
    value = field(message, name, what)
    try:
        return decode_time(value)
    except ValueError as error:
        raise MessageError(f"{what}.{name}: {error}") from error


def stamp_or_none(message: Any) -> int | None:
    """Robot's stamp in ns of any message; None if it has none, or not a usable one."""
    try:
        return stamp_of(message, "") if isinstance(message, dict) else None
    except MessageError:
        return None


def frame_of(message: Message, what: str) -> str:
    """Frame of reference in the header; empty without one."""
    return text_or_empty(part(message, "header", what), "frame_id", what) if "header" in message else ""


def encode_heading(heading_rad: float) -> dict[str, float]:
    """Encode geometry_msgs/Quaternion of a rotation about the vertical axis."""
    return {"x": 0.0, "y": 0.0, "z": math.sin(heading_rad / 2.0), "w": math.cos(heading_rad / 2.0)}


def decode_rotation(quaternion: Message, what: str) -> tuple[float, float, float, float]:
    """Decode a geometry_msgs/Quaternion to unit length (x, y, z, w)."""
    x, y, z, w = (number(quaternion, axis, what) for axis in "xyzw")
    longest = max(abs(x), abs(y), abs(z), abs(w))
    if longest < 1e-9:
        raise MessageError(f"{what} is the zero quaternion, which is not a rotation")
    x, y, z, w = x / longest, y / longest, z / longest, w / longest
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return x / norm, y / norm, z / norm, w / norm


def is_zero_quaternion(quaternion: Any) -> bool:
    """True for an unset quaternion."""
    if not isinstance(quaternion, dict):
        return False
    values = [quaternion.get(axis) for axis in "xyzw"]
    return all(isinstance(value, (int, float)) and abs(value) < 1e-9 for value in values)


def decode_heading(quaternion: Message, what: str) -> float:
    """Heading in radians (-pi, pi] of a quaternion of any length."""
    return Pose3D(0.0, 0.0, 0.0, *decode_rotation(quaternion, what)).heading_rad


def encode_pose(pose: Pose2D) -> Message:
    """Encode geometry_msgs/Pose on the floor."""
    return {"position": {"x": pose.x_m, "y": pose.y_m, "z": 0.0}, "orientation": encode_heading(pose.heading_rad)}


def decode_pose(pose: Message, what: str) -> Pose2D:
    """Decode the floor part of a geometry_msgs/Pose."""
    position = part(pose, "position", what)
    return Pose2D(
        number(position, "x", f"{what}.position"),
        number(position, "y", f"{what}.position"),
        decode_heading(part(pose, "orientation", what), f"{what}.orientation"),
    )


def _finite(value: Any, where: str) -> float:
    if isinstance(value, (np.integer, np.floating)):
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise MessageError(f"{where} must be a number, but it is {_kind(value)}")
    try:
        as_float = float(value)
    except OverflowError as error:
        raise MessageError(f"{where} is too large") from error
    if not math.isfinite(as_float):
        raise MessageError(f"{where} must be a finite number")
    return as_float


def _check_length(value: Any, where: str, most: int) -> None:
    if not isinstance(value, (list, bytes, np.ndarray)):
        raise MessageError(f"{where} must be a list, but it is {_kind(value)}")
    if len(value) > most:
        raise MessageError(f"{where} has {len(value)} entries; at most {most} are accepted")


def _kind(value: Any) -> str:
    if value is None:
        return "null"
    names = {bool: "a Boolean", int: "a number", float: "a number", str: "a text", list: "a list"}
    return names.get(type(value), "an object" if isinstance(value, dict) else type(value).__name__)
