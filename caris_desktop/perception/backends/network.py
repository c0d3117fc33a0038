"""Detector around a network: scales the image to its input, decodes its output, and maps boxes back."""

import ast
import json
import logging
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Literal, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.perception.detector import Detections
from caris_desktop.perception.weights import Weights

log = logging.getLogger(__name__)

UNDECODED = "caris_undecoded"
"""Metadata of models exported by this program: true if the caller has to decode the boxes."""
_MOST_CLASSES = 10_000
_EMPTY = Detections(np.zeros((0, 4)), np.zeros(0), np.zeros(0, np.int64))


class UnknownFormError(Exception):
    """Intact network with unknown input or output format."""


class ModelFacts(Value):
    """Metadata of a model file. ``class_names`` is empty if unnamed; other fields may be missing too."""

    class_names: tuple[str, ...] = ()
    keypoint_values: int = 0
    detects: bool = True
    undecoded: bool = False
    """The nodes that compute boxes are left out; they are computed here, for the few places that matter."""


def facts_of(metadata: Mapping[str, object]) -> ModelFacts:
    """Parse the metadata of ultralytics' exports, without evaluating it."""
    names = parsed_metadata(metadata.get("names"))
    if isinstance(names, Mapping):
        numbered = {int(number): str(name) for number, name in names.items()}
        names = [numbered.get(number, "") for number in range(min(max(numbered, default=-1) + 1, _MOST_CLASSES))]
    shape = parsed_metadata(metadata.get("kpt_shape"))
    values = shape[0] * shape[1] if isinstance(shape, list | tuple) and len(shape) == 2 else 0
    task = str(metadata.get("task", "detect"))
    return ModelFacts(
        class_names=tuple(str(name) for name in names) if isinstance(names, list | tuple) else (),
        keypoint_values=int(values) if task == "pose" else 0,
        detects=task in ("detect", "pose"),
        undecoded=metadata.get(UNDECODED) == "true",
    )


def parsed_metadata(text: object) -> object:
    """Value of a metadata text in JSON or as a Python literal; None if it is neither."""
    if not isinstance(text, str):
        return text
    try:
        return json.loads(text)
    except ValueError:
        pass
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return None


class Network(Protocol):
    """Interface of a runtime. ``fixed_size`` (height, width) is None for a network with dynamic input size."""

    runtime: str
    facts: ModelFacts
    fixed_size: tuple[int, int] | None
    channels_last: bool
    relative: bool
    """Its boxes are in parts of the input's size, not in pixels."""

    def run(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Run one image; return the first output."""
        ...


class NetworkDetector:
    """``Detector`` for a network.

    Raises
    ------
    UnknownFormError
        When the network's output has a form that is not known here.
    """

    def __init__(self, network: Network, weights: Weights, *, confidence: float) -> None:
        self._network = network
        self._confidence = confidence
        self._longest_px = weights.input_px
        facts = network.facts
        if not facts.detects:
            raise UnknownFormError(QT_TR_NOOP("it is not a bounding-box detector"))
        size = network.fixed_size or input_size((480, 640), weights.input_px)
        self._to_input: Callable[[NDArray[np.uint8]], NDArray[np.float32]] = (
            pixels_rgb if network.channels_last else planes_rgb
        )
        # Warm-up: the first image is much slower, and its output shows the format.
        output = network.run(self._to_input(np.full((*size, 3), 114, np.uint8)))
        class_count = len(facts.class_names) or None
        form: Form | None = "undecoded" if facts.undecoded else None
        if facts.undecoded and (class_count is None or output.shape[1:2] != (4 * BINS + class_count,)):
            raise UnknownFormError(
                localized(QT_TR_NOOP("its output shape {shape} does not match its classes"), shape=output.shape)
            )
        form = form or form_of(output.shape, size, class_count=class_count, keypoint_values=facts.keypoint_values)
        if form is None:
            raise UnknownFormError(
                localized(
                    QT_TR_NOOP("its output shape {shape} does not match any supported detector"), shape=output.shape
                )
            )
        self._read = reader(form, keypoint_values=facts.keypoint_values)
        self._centred = form != "yolox"
        if form == "yolox":
            self._to_input = planes_bgr
        if class_count is None:
            class_count = {"raw": output.shape[1] - 4, "yolox": output.shape[2] - 5, "final": len(COCO_NAMES)}[form]
        self.class_names = facts.class_names or _usual_names(class_count)
        self._groups = person_groups(self.class_names, weights.person_class_names)
        self._chosen = form == "final"
        size_text = f"{size[1]}x{size[0]}" if network.fixed_size else str(weights.input_px)
        self.label = f"{weights.label}, {network.runtime}, {size_text} px"

    def detect(self, image_bgr: NDArray[np.uint8]) -> Detections:
        if not image_bgr.size:
            return _EMPTY
        network = self._network
        size = network.fixed_size or input_size(image_bgr.shape[:2], self._longest_px)
        fitted, how = fit(image_bgr, size, centred=self._centred)
        found = self._read(network.run(self._to_input(fitted)), size, self._confidence)
        known = (found.classes >= 0) & (found.classes < len(self._groups))
        found = found if known.all() else found.at(known)
        if not self._chosen:
            found = suppress(found, self._groups)
        corners, keypoints = found.corners_px.reshape(-1, 2, 2), found.keypoints
        if network.relative:
            sides = np.array([size[1], size[0]], np.float64)
            corners = corners * sides
            if keypoints is not None:
                keypoints = np.concatenate([keypoints[..., :2] * sides, keypoints[..., 2:]], axis=2)
        limits = np.array([how.picture_width_px, how.picture_height_px], np.float64)
        corners = how.to_picture(corners).clip(0.0, limits)
        if keypoints is not None:
            keypoints = np.concatenate([how.to_picture(keypoints[..., :2]), keypoints[..., 2:]], axis=2)
        valid = (corners[:, 1] > corners[:, 0]).all(axis=1)
        return Detections(corners.reshape(-1, 4), found.confidences, found.classes, keypoints).at(valid)


def _usual_names(class_count: int) -> tuple[str, ...]:
    if class_count == len(COCO_NAMES):
        return COCO_NAMES
    return tuple(f"class{number}" for number in range(class_count))


STRIDE_PX = 32
_GREY = 114


class Fit(Value):
    """Image scaling to a network's input, and mapping of its results back.

    Placement of an image in the input: scale factors, then offset in pixels.
    """

    scale_x: float
    scale_y: float
    left_px: int
    top_px: int
    picture_width_px: int
    picture_height_px: int

    def to_picture(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map input points, shape (..., 2), to image points, which may lie outside of it."""
        offset = np.array([self.left_px, self.top_px], np.float64)
        return (points - offset) / np.array([self.scale_x, self.scale_y], np.float64)


def input_size(picture_size: tuple[int, int], longest_px: int) -> tuple[int, int]:
    """Height and width of the smallest input in whole strides for the image at this longest side."""
    height_px, width_px = _scaled(picture_size, (longest_px, longest_px))
    return _whole_strides(height_px), _whole_strides(width_px)


def fit(image_bgr: NDArray[np.uint8], size: tuple[int, int], *, centred: bool = True) -> tuple[NDArray[np.uint8], Fit]:
    """Scale the image into ``size`` (height, width) with its aspect ratio and grey padding.

    Centred as in ultralytics, else in the upper left corner as in YOLOX.
    """
    height_px, width_px = image_bgr.shape[:2]
    scaled_height_px, scaled_width_px = _scaled((height_px, width_px), size)
    left_px = top_px = 0
    if centred:
        left_px = max(0, round((size[1] - scaled_width_px) / 2 - 0.1))
        top_px = max(0, round((size[0] - scaled_height_px) / 2 - 0.1))
    if (scaled_height_px, scaled_width_px) == (height_px, width_px):
        scaled = image_bgr
    else:
        scaled = cv2.resize(image_bgr, (scaled_width_px, scaled_height_px), interpolation=cv2.INTER_LINEAR)
    if scaled.shape[:2] == size:
        fitted = scaled
    else:
        fitted = np.full((*size, 3), _GREY, np.uint8)
        fitted[top_px : top_px + scaled_height_px, left_px : left_px + scaled_width_px] = scaled
    return fitted, Fit(scaled_width_px / width_px, scaled_height_px / height_px, left_px, top_px, width_px, height_px)


def _scaled(picture_size: tuple[int, int], size: tuple[int, int]) -> tuple[int, int]:
    scale = min(size[0] / picture_size[0], size[1] / picture_size[1])
    return max(1, round(picture_size[0] * scale)), max(1, round(picture_size[1] * scale))


def _whole_strides(side_px: int) -> int:
    return -(-side_px // STRIDE_PX) * STRIDE_PX


def planes_rgb(fitted_bgr: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Input of ultralytics' networks: shape (1, 3, height, width), RGB, 0 to 1."""
    planes = np.empty((1, 3, *fitted_bgr.shape[:2]), np.float32)
    for plane, values in zip(planes[0], reversed(cv2.split(fitted_bgr)), strict=True):
        # Divided as in ultralytics: the last bit affects the rounding of an int8 network.
        np.divide(values, np.float32(255.0), out=plane)
    return planes


def pixels_rgb(fitted_bgr: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Input of channels-last networks: shape (1, height, width, 3), RGB, 0 to 1."""
    pixels: NDArray[np.float32] = np.divide(
        cv2.cvtColor(fitted_bgr, cv2.COLOR_BGR2RGB)[np.newaxis], np.float32(255.0), dtype=np.float32
    )
    return pixels


def planes_bgr(fitted_bgr: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Input of YOLOX: shape (1, 3, height, width), BGR, 0 to 255."""
    return np.stack(cv2.split(fitted_bgr))[np.newaxis].astype(np.float32)


COCO_NAMES = (
    "person", "bicycle", "car", "motorcycle", "airplane", "bus", "train", "truck", "boat", "traffic light",
    "fire hydrant", "stop sign", "parking meter", "bench", "bird", "cat", "dog", "horse", "sheep", "cow", "elephant",
    "bear", "zebra", "giraffe", "backpack", "umbrella", "handbag", "tie", "suitcase", "frisbee", "skis", "snowboard",
    "sports ball", "kite", "baseball bat", "baseball glove", "skateboard", "surfboard", "tennis racket", "bottle",
    "wine glass", "cup", "fork", "knife", "spoon", "bowl", "banana", "apple", "sandwich", "orange", "broccoli",
    "carrot", "hot dog", "pizza", "donut", "cake", "chair", "couch", "potted plant", "bed", "dining table", "toilet",
    "tv", "laptop", "mouse", "remote", "keyboard", "cell phone", "microwave", "oven", "toaster", "sink",
    "refrigerator", "book", "clock", "vase", "scissors", "teddy bear", "hair drier", "toothbrush",
)  # fmt: skip


# Decoders of detection network outputs, for each output format in use. Plain arrays, no runtime.

STRIDES_PX = [8, 16, 32]
# Ultralytics' values: boxes of one class with more overlap are duplicates; maximum boxes per image.
_SAME_OVERLAP = 0.7
_BOXES_AT_MOST = 300
_CANDIDATES_AT_MOST = 5000
_FINAL_ROWS_AT_MOST = 1000
KEYPOINTS = 17
BINS = 16

Form = Literal["raw", "final", "yolox", "undecoded"]


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


def reader(
    form: Form, *, keypoint_values: int = 0
) -> Callable[[NDArray[np.float32], tuple[int, int], float], Detections]:
    """Decoder of a format: function of output, input size and confidence threshold."""
    if form == "yolox":
        return read_yolox
    if form == "undecoded":
        return lambda output, size, confidence: read_raw(decode(output, size, confidence), confidence)
    if form == "final":
        return lambda output, _size, confidence: read_final(output, confidence, keypoint_values=keypoint_values)
    return lambda output, _size, confidence: read_raw(output, confidence, keypoint_values=keypoint_values)


def read_raw(output: NDArray[np.float32], confidence: float, *, keypoint_values: int = 0) -> Detections:
    """Decode YOLOv8, 11 and similar: every anchor with a box and class probabilities."""
    values = output[0]
    last_class = len(values) - keypoint_values
    best = values[4:last_class].max(axis=0)
    indices = np.flatnonzero(best > confidence)
    few = values[:, indices].T.astype(np.float64)
    centres, halves = few[:, :2], few[:, 2:4] / 2.0
    return _finite(
        Detections(
            np.concatenate([centres - halves, centres + halves], axis=1),
            few[:, 4:last_class].max(axis=1, initial=0.0),
            few[:, 4:last_class].argmax(axis=1).astype(np.int64),
            _keypoints(few[:, last_class:]),
        )
    )


def read_final(output: NDArray[np.float32], confidence: float, *, keypoint_values: int = 0) -> Detections:
    """Decode networks with built-in suppression: corners, confidence and class per box, then key points."""
    rows = output[0]
    rows = rows[rows[:, 4] > confidence].astype(np.float64)
    return _finite(
        Detections(
            rows[:, :4], rows[:, 4], np.rint(rows[:, 5]).astype(np.int64), _keypoints(rows[:, 6:][:, :keypoint_values])
        )
    )


def read_yolox(output: NDArray[np.float32], size: tuple[int, int], confidence: float) -> Detections:
    """Decode YOLOX: offset and log size in strides relative to the anchor, objectness, class probabilities."""
    values = output[0]
    best = values[:, 4] * values[:, 5:].max(axis=1)
    indices = np.flatnonzero(best > confidence)
    few = values[indices].astype(np.float64)
    corners_xy, stride_px = places(*size)
    centres = (few[:, :2] + corners_xy[:, indices].T - 0.5) * stride_px[indices, np.newaxis]
    halves = np.exp(np.minimum(few[:, 2:4], 20.0)) * stride_px[indices, np.newaxis] / 2.0
    return _finite(
        Detections(
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


def _finite(found: Detections) -> Detections:
    """Drop boxes with infinite or NaN corners, from a network that overflows."""
    return found.at(np.isfinite(found.corners_px).all(axis=1))


def suppress(found: Detections, groups: NDArray[np.int64]) -> Detections:
    """Non-maximum suppression within groups. ``groups`` has the group of each class.

    Classes of equal meaning share a group, so that one person does not get a box from each.
    """
    order = np.argsort(-found.confidences, kind="stable")[:_CANDIDATES_AT_MOST]
    found = found.at(order)
    group = groups[found.classes]
    left, top, right, bottom = found.corners_px.T
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
