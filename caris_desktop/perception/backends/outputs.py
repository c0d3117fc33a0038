"""Decoders of detection network outputs, for each output format in use. Plain arrays, no runtime."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import Value

STRIDES_PX = [8, 16, 32]
# Ultralytics' values: boxes of one class with more overlap are duplicates; maximum boxes per image.
_SAME_OVERLAP = 0.7
_BOXES_AT_MOST = 300
_CANDIDATES_AT_MOST = 5000
_FINAL_ROWS_AT_MOST = 1000
KEYPOINTS = 17
BINS = 16

Form = Literal["raw", "final", "yolox", "undecoded"]


class Found(Value, eq=False):
    """Boxes in input pixels: left, top, right, bottom; ``keypoints`` as in ``Detections``."""

    corners: NDArray[np.float64]
    confidences: NDArray[np.float64]
    classes: NDArray[np.int64]
    keypoints: NDArray[np.float64] | None = None

    def at(self, rows: Any) -> "Found":
        """Subset by row numbers or mask."""
        keypoints = None if self.keypoints is None else self.keypoints[rows]
        return Found(self.corners[rows], self.confidences[rows], self.classes[rows], keypoints)


def form_of(
    shape: tuple[int, ...], input_size: tuple[int, int], *, class_count: int | None, keypoint_values: int = 0
) -> Form | None:
    """Format of an output by its shape; None if unknown.

    ``raw``: (1, 4 + classes, anchors), boxes as centre and size. ``final``: (1, boxes, 6), after suppression.
    ``yolox``: (1, anchors, 5 + classes), relative to the anchors. ``class_count`` is None if the file names no classes;
    in the first two, ``keypoint_values`` pose values follow.
    """
    if len(shape) != 3 or shape[0] != 1:
        return None
    rows, columns = shape[1:]
    if columns == 6 + keypoint_values and rows <= _FINAL_ROWS_AT_MOST:
        return "final"
    places = sum(input_size[0] // stride * (input_size[1] // stride) for stride in STRIDES_PX)
    if class_count is not None:
        if rows == 4 + class_count + keypoint_values:
            return "raw"
        return "yolox" if (rows, columns) == (places, 5 + class_count) else None
    if columns == places and rows > 4:
        return "raw"
    return "yolox" if rows == places and columns > 5 else None


def reader(form: Form, *, keypoint_values: int = 0) -> Callable[[NDArray[np.float32], tuple[int, int], float], Found]:
    """Decoder of a format: function of output, input size and confidence threshold."""
    if form == "yolox":
        return read_yolox
    if form == "undecoded":
        return lambda output, size, confidence: read_raw(decode(output, size, confidence), confidence)
    if form == "final":
        return lambda output, _size, confidence: read_final(output, confidence, keypoint_values=keypoint_values)
    return lambda output, _size, confidence: read_raw(output, confidence, keypoint_values=keypoint_values)


def read_raw(output: NDArray[np.float32], confidence: float, *, keypoint_values: int = 0) -> Found:
    """Decode YOLOv8, 11 and similar: every anchor with a box and class probabilities."""
    values = output[0]
    last_class = len(values) - keypoint_values
    best = values[4:last_class].max(axis=0)
    indices = np.flatnonzero(best > confidence)
    few = values[:, indices].T.astype(np.float64)
    centres, halves = few[:, :2], few[:, 2:4] / 2.0
    return _finite(
        Found(
            np.concatenate([centres - halves, centres + halves], axis=1),
            few[:, 4:last_class].max(axis=1, initial=0.0),
            few[:, 4:last_class].argmax(axis=1).astype(np.int64),
            _keypoints(few[:, last_class:]),
        )
    )


def read_final(output: NDArray[np.float32], confidence: float, *, keypoint_values: int = 0) -> Found:
    """Decode networks with built-in suppression: corners, confidence and class per box, then key points."""
    rows = output[0]
    rows = rows[rows[:, 4] > confidence].astype(np.float64)
    return _finite(
        Found(
            rows[:, :4], rows[:, 4], np.rint(rows[:, 5]).astype(np.int64), _keypoints(rows[:, 6:][:, :keypoint_values])
        )
    )


def read_yolox(output: NDArray[np.float32], size: tuple[int, int], confidence: float) -> Found:
    """Decode YOLOX: offset and log size in strides relative to the anchor, objectness, class probabilities."""
    values = output[0]
    best = values[:, 4] * values[:, 5:].max(axis=1)
    indices = np.flatnonzero(best > confidence)
    few = values[indices].astype(np.float64)
    corners_xy, stride_px = places(*size)
    centres = (few[:, :2] + corners_xy[:, indices].T - 0.5) * stride_px[indices, np.newaxis]
    halves = np.exp(np.minimum(few[:, 2:4], 20.0)) * stride_px[indices, np.newaxis] / 2.0
    return _finite(
        Found(
            np.concatenate([centres - halves, centres + halves], axis=1),
            best[indices].astype(np.float64),
            few[:, 5:].argmax(axis=1).astype(np.int64),
        )
    )


def _keypoints(values: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Key points; exports without visibility count all as visible."""
    if values.shape[1] == KEYPOINTS * 3:
        return values.reshape(-1, KEYPOINTS, 3)
    if values.shape[1] == KEYPOINTS * 2:
        points = values.reshape(-1, KEYPOINTS, 2)
        return np.concatenate([points, np.ones((len(points), KEYPOINTS, 1))], axis=2)
    return None


def _finite(found: Found) -> Found:
    """Drop boxes with infinite or NaN corners, from a network that overflows."""
    return found.at(np.isfinite(found.corners).all(axis=1))


def suppress(found: Found, groups: NDArray[np.int64]) -> Found:
    """Non-maximum suppression within groups. ``groups`` has the group of each class.

    Classes of equal meaning share a group, so that one person does not get a box from each.
    """
    order = np.argsort(-found.confidences, kind="stable")[:_CANDIDATES_AT_MOST]
    found = found.at(order)
    group = groups[found.classes]
    left, top, right, bottom = found.corners.T
    area = (right - left) * (bottom - top)
    indices: list[int] = []
    rest = np.arange(len(order))
    while len(rest) and len(indices) < _BOXES_AT_MOST:
        first, rest = int(rest[0]), rest[1:]
        indices.append(first)
        width = np.minimum(right[rest], right[first]) - np.maximum(left[rest], left[first])
        height = np.minimum(bottom[rest], bottom[first]) - np.maximum(top[rest], top[first])
        shared = np.maximum(width, 0.0) * np.maximum(height, 0.0)
        same = shared > _SAME_OVERLAP * (area[rest] + area[first] - shared)
        rest = rest[~(same & (group[rest] == group[first]))]
    return found.at(np.array(indices, dtype=np.intp))


def person_groups(class_names: tuple[str, ...], person_class_names: tuple[str, ...]) -> NDArray[np.int64]:
    """Group of each class for :func:`suppress`: person classes share one."""
    lowered = {name.lower() for name in person_class_names}
    groups = np.arange(len(class_names), dtype=np.int64)
    groups[[name.lower() in lowered for name in class_names]] = -1
    return groups


def decode(raw: NDArray[np.float32], size: tuple[int, int], confidence: float) -> NDArray[np.float32]:
    """Decode a raw head in place of its removed nodes, for anchors above ``confidence``.

    Parameters
    ----------
    raw
        Shape (1, 64 + classes, places): for each side of the box the logits of its distance from the place, in 16
        bins of one stride, then the logits of the classes.
    size
        Height and width of the network's input, multiples of 32.

    Returns
    -------
    Shape (1, 4 + classes, selected places): centre x and y, width and height in input pixels, class probabilities.
    """
    floor = min(max(confidence, 1e-6), 0.5)
    class_logits = raw[0, 4 * BINS :]
    indices = np.flatnonzero(class_logits.max(axis=0) > np.log(floor / (1.0 - floor)))
    places_xy, stride_px = places(*size)
    places_xy, stride_px = places_xy[:, indices], stride_px[indices]
    weights = raw[0, : 4 * BINS, indices].T.reshape(4, BINS, len(indices))
    weights = np.exp(weights - weights.max(axis=1, keepdims=True))
    bins = np.arange(BINS, dtype=np.float32)[:, np.newaxis]
    distances = (weights * bins).sum(axis=1) / weights.sum(axis=1)
    near, far = places_xy - distances[:2], places_xy + distances[2:]
    boxes = np.concatenate([(near + far) / 2.0, far - near]) * stride_px
    probabilities = 1.0 / (1.0 + np.exp(-class_logits[:, indices]))
    return np.concatenate([boxes, probabilities])[np.newaxis].astype(np.float32)


@lru_cache(maxsize=4)
def places(height_px: int, width_px: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Anchor centres of a detection head in units of their stride, shape (2, anchors), and the strides."""
    centres, strides = [], []
    for stride_px in STRIDES_PX:
        rows, columns = np.mgrid[0 : height_px // stride_px, 0 : width_px // stride_px]
        centres.append(np.stack([columns.ravel(), rows.ravel()]) + 0.5)
        strides.append(np.full(rows.size, stride_px))
    return np.concatenate(centres, axis=1).astype(np.float32), np.concatenate(strides).astype(np.float32)
