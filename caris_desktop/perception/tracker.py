"""Finds people in camera frames and follows them, with ultralytics' detectors and trackers."""

import logging
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.perception.weights import Weights, WeightsError

log = logging.getLogger(__name__)

TrackerName = Literal["bytetrack", "botsort"]
_COCO_CLASS_COUNT = 80


@dataclass(frozen=True, slots=True)
class TrackedBox:
    """One person in one frame; ``track`` stays the same as long as the tracker follows that person."""

    track: int
    left_px: float
    top_px: float
    width_px: float
    height_px: float
    confidence: float


class PersonTracker:
    """A detector with one tracker for each camera behind it. For one thread; load time is seconds.

    Track numbers start at 1 and never mean two people, of whichever cameras.

    Raises
    ------
    WeightsError
        When the file cannot be loaded or knows no class that means a person.
    """

    def __init__(self, weights: Weights, *, tracker: TrackerName, confidence: float, threads: int) -> None:
        from caris_desktop.perception.ultralytics_setup import prepare_ultralytics

        prepare_ultralytics(threads=threads)
        from ultralytics import YOLO

        self.weights = weights
        self._arguments: dict[str, Any] = {
            "persist": True,
            "tracker": f"{tracker}.yaml",
            "conf": confidence,
            "imgsz": weights.input_px,
            # A model may have several classes that mean a person; one person must not get a box from each.
            "agnostic_nms": True,
            "device": None,
            "verbose": False,
        }
        self._trackers: dict[str, Any] = {}
        self._numbers: dict[tuple[str, int], int] = {}
        try:
            self._model = YOLO(str(weights.path), task="detect")
            self._warm_up()
            self._arguments["classes"] = self._person_classes()
        except WeightsError:
            raise
        except Exception as error:  # torch, onnxruntime and tflite each raise types of their own for a bad file
            log.exception("could not load %s", weights.path)
            raise WeightsError(
                f"The detector {weights.path.name} could not be loaded",
                searched=(str(weights.path),),
                advice="Replace the file by an intact YOLO detector; the log has the details",
            ) from error

    def track(self, image_bgr: NDArray[np.uint8], camera: str) -> list[TrackedBox]:
        """People in this camera's next frame: uint8 BGR, shape (height, width, 3). Boxes lie inside the image."""
        known = self._trackers.get(camera)
        # Where there is none, ultralytics makes a new one.
        self._model.predictor.trackers = [] if known is None else [known]
        boxes = self._model.track(image_bgr, **self._arguments)[0].boxes
        self._trackers[camera] = self._model.predictor.trackers[0]
        if boxes is None or boxes.id is None:
            return []
        height_px, width_px = image_bgr.shape[:2]
        corners = boxes.xyxy.numpy(force=True).clip(0, [width_px, height_px, width_px, height_px]).tolist()
        numbers = boxes.id.numpy(force=True).astype(int).tolist()
        confidences = boxes.conf.numpy(force=True).tolist()
        tracked = []
        for (left, top, right, bottom), number, confidence in zip(corners, numbers, confidences, strict=True):
            track = self._numbers.setdefault((camera, number), len(self._numbers) + 1)
            if right > left and bottom > top:
                tracked.append(TrackedBox(track, left, top, right - left, bottom - top, confidence))
        return tracked

    def _warm_up(self) -> None:
        """The first frame is many times slower than the rest, and loading happens in it."""
        self._model.track(np.full((480, 640, 3), 114, np.uint8), **self._arguments)

    def _person_classes(self) -> list[int]:
        names: dict[int, str] = self._model.predictor.model.names
        wanted = {name.lower() for name in self.weights.person_class_names}
        classes = [number for number, name in names.items() if name.lower() in wanted]
        if classes:
            return classes
        unnamed = all(name == f"class{number}" for number, name in names.items())
        if unnamed and len(names) >= _COCO_CLASS_COUNT:
            return [0]
        raise WeightsError(
            f"The detector {self.weights.path.name} does not detect people",
            searched=(str(self.weights.path),),
            advice="Choose a detector with a class named person",
        )
