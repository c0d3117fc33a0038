"""Foxglove's schemas (https://docs.foxglove.dev/docs/sdk/schemas), and conversion of our values to them.

Foxglove, Lichtblick and others display channels with these schema names without configuration. A message has the
schema's fields, and also those of our value that the schema lacks: nothing large is duplicated, and the
recording reads back exactly.

JSON has no infinity, so numbers beyond float32 replace it (:data:`INFINITE`): viewers read them as infinite and draw
nothing.
"""

import base64
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import events, sensing
from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.schema import PLAIN_BYTES, Base64, in_few_digits
from caris_desktop.domain.value_class import Value

MAP, BASE = "map", "base_link"  # REP 105
INFINITE, INVALID = 1e39, 2e39
_NUMERIC_INT8, _LINE_LOOP = 2, 2
_DEBUG, _INFO, _WARNING, _ERROR = 1, 2, 3, 4
_LEVELS: dict[events.Severity, int] = {"info": _INFO, "warning": _WARNING}
_LABEL_PX, _LINE_PX = 14.0, 2.0


Message = dict[str, Any]
Shape = Mapping[str, Any]
"""Fields of a schema: each a plain type, another shape, or a list with one of these."""
Time = dict[str, int]
TIME: Shape = {"sec": int, "nsec": int}
_FRAME: Shape = {"timestamp": TIME, "frame_id": str}
_VECTOR2, _VECTOR3, _QUATERNION, _COLOR = (dict.fromkeys(names, float) for names in ("xy", "xyz", "xyzw", "rgba"))
_POSE: Shape = {"position": _VECTOR3, "orientation": _QUATERNION}
_METADATA: Shape = {"metadata": [{"key": str, "value": str}]}
# With our name for the frame of the laser, in addition to that of ``pose``.
_LASER_SCAN: Shape = {
    **_FRAME, "pose": _POSE, "start_angle": float, "end_angle": float, "ranges": [float], "intensities": [float],
    "laser_frame_id": str,
}  # fmt: skip
# With our count of rows, which others know from the amount of data.
_GRID: Shape = {
    **_FRAME, "pose": _POSE, "column_count": int, "cell_size": _VECTOR2, "row_stride": int, "cell_stride": int,
    "fields": [{"name": str, "offset": int, "type": int}], "data": Base64, "row_count": int,
}  # fmt: skip
_TRANSFORM: Shape = {
    "timestamp": TIME, "parent_frame_id": str, "child_frame_id": str, "translation": _VECTOR3, "rotation": _QUATERNION,
}  # fmt: skip
TRANSFORMS: Shape = {"transforms": [_TRANSFORM]}
_CIRCLE: Shape = {
    "timestamp": TIME, "position": _VECTOR2, "diameter": float, "thickness": float, "fill_color": _COLOR,
    "outline_color": _COLOR, **_METADATA,
}  # fmt: skip
_POINTS: Shape = {
    "timestamp": TIME, "type": int, "points": [_VECTOR2], "outline_color": _COLOR, "outline_colors": [_COLOR],
    "fill_color": _COLOR, "thickness": float, **_METADATA,
}  # fmt: skip
_TEXT: Shape = {
    "timestamp": TIME, "position": _VECTOR2, "text": str, "font_size": float, "text_color": _COLOR,
    "background_color": _COLOR, **_METADATA,
}  # fmt: skip
_ANNOTATIONS: Shape = {"timestamp": TIME, "circles": [_CIRCLE], "points": [_POINTS], "texts": [_TEXT], **_METADATA}
_CALIBRATION: Shape = {
    **_FRAME, "width": int, "height": int, "distortion_model": str, "D": [float], "K": [float], "R": [float],
    "P": [float],
}  # fmt: skip
_LOG: Shape = {"timestamp": TIME, "level": int, "message": str, "name": str, "file": str, "line": int}


class WellKnown(Value, eq=False):
    """A schema that other programs know, and how a value of ours fills it.

    ``fill`` is given the value and its moment in UTC. ``holds`` names the fields of ours that the filled message holds
    already, and ``restore`` makes those, in the form of :func:`schema.to_jsonable`, of a message; nothing of one that
    an older version wrote, which has our own fields only.
    """

    name: str
    shape: Shape
    fill: Callable[[Any, Time], Message]
    holds: frozenset[str] = frozenset()
    restore: Callable[[Message], Message] = lambda _message: {}


def time_of(utc_ns: int) -> Time:
    """Foxglove time of nanoseconds since 1970; earlier times are clamped."""
    seconds, nanoseconds = divmod(max(0, utc_ns), 1_000_000_000)
    return {"sec": seconds, "nsec": nanoseconds}


def pose_of(pose: Pose2D | None) -> Message:
    """Foxglove pose of a pose on the floor; the origin for None."""
    x_m, y_m, half_rad = (0.0, 0.0, 0.0) if pose is None else (pose.x_m, pose.y_m, pose.heading_rad / 2.0)
    half_rad = _finite(half_rad)
    return {
        "position": {"x": _finite(x_m), "y": _finite(y_m), "z": 0.0},
        # The exact value is added; more digits here would only take space.
        "orientation": {"x": 0.0, "y": 0.0, "z": round(math.sin(half_rad), 9), "w": round(math.cos(half_rad), 9)},
    }


def transforms_of(value: Any, at: Time) -> Message | None:
    """Coordinate frames known from this value: robot in the map, fixed camera on the robot."""
    match value:
        case sensing.RobotPose():
            pose = pose_of(value.pose_in_map)
            return {"transforms": [_transform(at, MAP, BASE, pose["position"], pose["orientation"])]}
        case sensing.CameraLens() if not value.model.on_head:
            model = value.model
            x, y, z, w = map(_finite, model.optical_rotation())
            position = {"x": _finite(model.x_m), "y": _finite(model.y_m), "z": _finite(model.z_m)}
            rotation = {"x": x, "y": y, "z": z, "w": w}
            return {"transforms": [_transform(at, BASE, optical_frame(value.camera), position, rotation)]}
    return None


def _transform(at: Time, parent: str, child: str, translation: Message, rotation: Message) -> Message:
    return {
        "timestamp": at,
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": translation,
        "rotation": rotation,
    }


def _finite(number: float) -> float:
    return number if math.isfinite(number) else 0.0


def optical_frame(camera: str) -> str:
    """Name of the frame that a camera's images are in."""
    return f"{camera}_optical_frame"


# Scans


def _fill_scan(scan: sensing.LaserScan, at: Time) -> Message:
    """Scan in the map at the time of measurement: a turning robot has moved on when its pose arrives."""
    frame, pose = scan.frame_id, None
    if scan.map_from_laser is not None:
        frame, pose = MAP, scan.map_from_laser
    elif scan.robot_from_laser is not None:
        frame, pose = BASE, scan.robot_from_laser
    last_rad = scan.angle_min_rad + scan.angle_increment_rad * max(0, len(scan.ranges_m) - 1)
    return {
        "timestamp": at,
        "frame_id": frame,
        "pose": pose_of(pose),
        "start_angle": _finite(scan.angle_min_rad),
        "end_angle": _finite(last_rad),
        "ranges": _numbers(scan.ranges_m),
        "intensities": _numbers(scan.intensities),
        "laser_frame_id": scan.frame_id,
    }


def _restore_scan(message: Message) -> Message:
    if "ranges" not in message:
        return {}
    return {
        "frame_id": message.get("laser_frame_id"),
        "ranges_m": _with_invalid(message["ranges"]),
        "intensities": _with_invalid(message.get("intensities")),
    }


def _numbers(array: NDArray[np.float32]) -> list[float]:
    """Finite numbers, with stand-ins for those that JSON lacks."""
    numbers: list[float] = np.nan_to_num(in_few_digits(array), nan=INVALID, posinf=INFINITE, neginf=-INFINITE).tolist()
    return numbers


def _with_invalid(numbers: Any) -> Any:
    """Restore invalid numbers; infinite ones need nothing, since they overflow float32."""
    if not isinstance(numbers, list) or INVALID not in numbers:
        return numbers
    return ["nan" if number == INVALID else number for number in numbers]


# The map


def _fill_grid(grid: sensing.OccupancyGrid, at: Time) -> Message:
    rows, columns = grid.cells.shape
    size_m = _finite(grid.resolution_m)
    return {
        "timestamp": at,
        "frame_id": MAP,
        "pose": pose_of(grid.origin_in_map),
        "column_count": columns,
        "cell_size": {"x": size_m, "y": size_m},
        "row_stride": columns,
        "cell_stride": 1,
        "fields": [{"name": "occupancy", "offset": 0, "type": _NUMERIC_INT8}],
        # Uncompressed, as other programs require; the file's own compression saves as much as deflating did.
        "data": Base64(base64.b64encode(np.ascontiguousarray(grid.cells).data).decode("ascii")),
        "row_count": rows,
    }


def _restore_grid(message: Message) -> Message:
    if "data" not in message:
        return {}
    shape = [message.get("row_count"), message.get("column_count")]
    return {"cells": {"encoding": PLAIN_BYTES, "dtype": "int8", "shape": shape, "data": message["data"]}}


# Poses, cameras, people


def _fill_pose(pose: sensing.RobotPose, at: Time) -> Message:
    return {"timestamp": at, "frame_id": MAP, "pose": pose_of(pose.pose_in_map)}


_AHEAD = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


def _fill_path(path: sensing.PlannedPath, at: Time) -> Message:
    """Points of the path; orientations are unknown."""
    points: Any = _numbers(path.points_in_map)
    poses = [{"position": {"x": x, "y": y, "z": 0.0}, "orientation": _AHEAD} for x, y in points]
    return {"timestamp": at, "frame_id": MAP, "poses": poses}


def _restore_path(message: Message) -> Message:
    if "poses" not in message:
        return {}
    points = [_with_invalid([pose["position"]["x"], pose["position"]["y"]]) for pose in message["poses"]]
    return {"points_in_map": points}


def _fill_lens(lens: sensing.CameraLens, at: Time) -> Message:
    model: CameraModel = lens.model
    fx, fy, cx, cy = map(_finite, (model.fx_px, model.fy_px, model.cx_px, model.cy_px))
    return {
        "timestamp": at,
        "frame_id": optical_frame(lens.camera),
        "width": model.width_px,
        "height": model.height_px,
        "distortion_model": "plumb_bob",
        "D": [0.0] * 5,
        "K": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }


_OUTLINE = {"r": 0.2, "g": 0.6, "b": 1.0, "a": 1.0}
_NOTHING = {"r": 0.0, "g": 0.0, "b": 0.0, "a": 0.0}
_LETTERS = {"r": 1.0, "g": 1.0, "b": 1.0, "a": 1.0}
_BEHIND = {"r": 0.0, "g": 0.0, "b": 0.0, "a": 0.6}


def _fill_people(people: sensing.People, at: Time) -> Message:
    return {
        "timestamp": at,
        "circles": [],
        "points": [_box_around(box, at) for box in people.boxes],
        "texts": [
            {
                "timestamp": at,
                "position": {"x": _pixel(box.left_px), "y": _pixel(box.top_px)},
                "text": box.person_id or f"track {box.track}",
                "font_size": _LABEL_PX,
                "text_color": _LETTERS,
                "background_color": _BEHIND,
                "metadata": [],
            }
            for box in people.boxes
        ],
        "metadata": [],
    }


def _box_around(box: sensing.PersonBox, at: Time) -> Message:
    left, top = _pixel(box.left_px), _pixel(box.top_px)
    right, bottom = _pixel(box.left_px + box.width_px), _pixel(box.top_px + box.height_px)
    return {
        "timestamp": at,
        "type": _LINE_LOOP,
        "points": [{"x": left, "y": top}, {"x": right, "y": top}, {"x": right, "y": bottom}, {"x": left, "y": bottom}],
        "outline_color": _OUTLINE,
        "outline_colors": [],
        "fill_color": _NOTHING,
        "thickness": _LINE_PX,
        "metadata": [],
    }


def _pixel(place_px: float) -> float:
    return round(_finite(place_px), 1)


# Words


def _fill_utterance(utterance: events.UtteranceChanged, at: Time) -> Message:
    """Log entry of an utterance, once at level info: at its start for speech, at its end for recognition. A recognition
    that is discarded is not a failure.
    """
    from_participant = utterance.speaker == "participant"
    if utterance.state == ("finished" if from_participant else "started"):
        level = _INFO
    elif utterance.state in ("interrupted", "failed") and not from_participant:
        level = _WARNING
    else:
        level = _DEBUG
    return _log(at, level, utterance.text, utterance.speaker)


def _fill_correction(corrected: events.UtteranceCorrected, at: Time) -> Message:
    changes = (corrected.text, corrected.speaker, corrected.person_id, *(corrected.tags or ()))
    has_times = corrected.start_ns is not None or corrected.end_ns is not None
    words = ", ".join(filter(None, changes)) or ("time of the utterance" if has_times else "not sure")
    return _log(at, _INFO, f"corrected: {words}", corrected.speaker or "")


def _fill_problem(problem: events.Problem, at: Time) -> Message:
    words = " ".join(part for part in (problem.what, problem.meaning, problem.advice) if part)
    return _log(at, _LEVELS.get(problem.severity, _ERROR), words, "console")


def _log(at: Time, level: int, message: str, name: str) -> Message:
    return {"timestamp": at, "level": level, "message": message, "name": name, "file": "", "line": 0}


LASER_SCAN = WellKnown(
    "foxglove.LaserScan", _LASER_SCAN, _fill_scan, frozenset({"frame_id", "ranges_m", "intensities"}), _restore_scan
)
GRID = WellKnown("foxglove.Grid", _GRID, _fill_grid, frozenset({"cells"}), _restore_grid)
POSE = WellKnown("foxglove.PoseInFrame", {**_FRAME, "pose": _POSE}, _fill_pose)
PATH = WellKnown(
    "foxglove.PosesInFrame", {**_FRAME, "poses": [_POSE]}, _fill_path, frozenset({"points_in_map"}), _restore_path
)
CALIBRATION = WellKnown("foxglove.CameraCalibration", _CALIBRATION, _fill_lens)
ANNOTATIONS = WellKnown("foxglove.ImageAnnotations", _ANNOTATIONS, _fill_people)
UTTERANCE_LOG = WellKnown("foxglove.Log", _LOG, _fill_utterance)
CORRECTION_LOG = WellKnown("foxglove.Log", _LOG, _fill_correction)
PROBLEM_LOG = WellKnown("foxglove.Log", _LOG, _fill_problem)
