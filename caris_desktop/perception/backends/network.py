"""Detector around a network: scales the image to its input, decodes its output, and maps boxes back."""

import ast
import json
import logging
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import dataclass
from caris_desktop.perception.backends.network_pictures import fit, input_size, pixels_rgb, planes_bgr, planes_rgb
from caris_desktop.perception.backends.outputs import BINS, Form, form_of, person_groups, reader, suppress
from caris_desktop.perception.coco import COCO_NAMES
from caris_desktop.perception.detector import Detections
from caris_desktop.perception.weights import Weights

log = logging.getLogger(__name__)

UNDECODED = "caris_undecoded"
"""Metadata of models exported by this program: true if the caller has to decode the boxes."""
_NOTHING = Detections(np.zeros((0, 4)), np.zeros(0), np.zeros(0, np.int64))


class UnknownFormError(Exception):
    """Intact network with unknown input or output format."""


@dataclass(frozen=True, slots=True)
class ModelFacts:
    """Metadata of a model file. ``class_names`` is empty if unnamed; other fields may be missing too."""

    class_names: tuple[str, ...] = ()
    keypoint_values: int = 0
    detects: bool = True
    undecoded: bool = False
    """The nodes that compute boxes are left out; they are computed here, for the few places that matter."""


def facts_of(metadata: Mapping[str, object]) -> ModelFacts:
    """Parse the metadata of ultralytics' exports, without evaluating it."""
    names = _value(metadata.get("names"))
    if isinstance(names, Mapping):
        numbered = {int(number): str(name) for number, name in names.items()}
        names = [numbered.get(number, "") for number in range(max(numbered, default=-1) + 1)]
    shape = _value(metadata.get("kpt_shape"))
    values = shape[0] * shape[1] if isinstance(shape, list | tuple) and len(shape) == 2 else 0
    task = str(metadata.get("task", "detect"))
    return ModelFacts(
        class_names=tuple(str(name) for name in names) if isinstance(names, list | tuple) else (),
        keypoint_values=int(values) if task == "pose" else 0,
        detects=task in ("detect", "pose"),
        undecoded=metadata.get(UNDECODED) == "true",
    )


def _value(text: object) -> object:
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
        shown_size = f"{size[1]}x{size[0]}" if network.fixed_size else str(weights.input_px)
        self.label = f"{weights.label}, {network.runtime}, {shown_size} px"

    def detect(self, image_bgr: NDArray[np.uint8]) -> Detections:
        if not image_bgr.size:
            return _NOTHING
        network = self._network
        size = network.fixed_size or input_size(image_bgr.shape[:2], self._longest_px)
        fitted, how = fit(image_bgr, size, centred=self._centred)
        found = self._read(network.run(self._to_input(fitted)), size, self._confidence)
        known = (found.classes >= 0) & (found.classes < len(self._groups))
        found = found if known.all() else found.at(known)
        if not self._chosen:
            found = suppress(found, self._groups)
        corners, keypoints = found.corners.reshape(-1, 2, 2), found.keypoints
        if network.relative:
            sides = np.array([size[1], size[0]], np.float64)
            corners = corners * sides
            if keypoints is not None:
                keypoints = np.concatenate([keypoints[..., :2] * sides, keypoints[..., 2:]], axis=2)
        limits = np.array([how.picture_width_px, how.picture_height_px], np.float64)
        corners = how.to_picture(corners).clip(0.0, limits)
        if keypoints is not None:
            keypoints = np.concatenate([how.to_picture(keypoints[..., :2]), keypoints[..., 2:]], axis=2)
        seen = (corners[:, 1] > corners[:, 0]).all(axis=1)
        return Detections(
            corners.reshape(-1, 4)[seen],
            found.confidences[seen],
            found.classes[seen],
            None if keypoints is None else keypoints[seen],
        )


def _usual_names(class_count: int) -> tuple[str, ...]:
    if class_count == len(COCO_NAMES):
        return COCO_NAMES
    return tuple(f"class{number}" for number in range(class_count))
