"""Detector run by ultralytics: .pt weights, and networks with an unknown output format."""

import logging
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.perception.backends.outputs import KEYPOINTS, Found, person_groups, suppress
from caris_desktop.perception.backends.ultralytics_setup import prepare_ultralytics, torch_device
from caris_desktop.perception.detector import Detections
from caris_desktop.perception.weights import Weights

log = logging.getLogger(__name__)


class UltralyticsDetector:
    """``Detector`` by ultralytics. Raises what torch, onnxruntime or tflite raise for a bad file."""

    def __init__(self, weights: Weights, *, confidence: float, threads: int, device: str = "auto") -> None:
        prepare_ultralytics(threads=threads)
        where = torch_device(device)
        self._arguments: dict[str, Any] = {
            "conf": confidence,
            "imgsz": weights.input_px,
            "device": where,
            "verbose": False,
        }
        self._model = load_model(weights)
        # Warm-up: the first frame is much slower, and includes loading.
        self._model.predict(np.full((480, 640, 3), 114, np.uint8), **self._arguments)
        names: dict[int, str] = self._model.predictor.model.names
        self.class_names = tuple(names.get(number, "") for number in range(max(names, default=-1) + 1))
        runtime = "torch" if weights.path.suffix == ".pt" else "ultralytics"
        self.label = f"{weights.label}, {runtime} on {_SHOWN[where.split(':', maxsplit=1)[0]]}, {weights.input_px} px"
        self._groups = person_groups(self.class_names, weights.person_class_names)

    def detect(self, image_bgr: NDArray[np.uint8]) -> Detections:
        if not image_bgr.size:
            return Detections(np.zeros((0, 4)), np.zeros(0), np.zeros(0, np.int64))
        result = self._model.predict(image_bgr, **self._arguments)[0]
        boxes = result.boxes
        points = None if result.keypoints is None else result.keypoints.data.numpy(force=True).astype(np.float64)
        height_px, width_px = image_bgr.shape[:2]
        found = suppress(
            Found(
                boxes.xyxy.numpy(force=True).astype(np.float64).clip(0, [width_px, height_px, width_px, height_px]),
                boxes.conf.numpy(force=True).astype(np.float64),
                boxes.cls.numpy(force=True).astype(np.int64),
                points if points is not None and points.shape[1:] == (KEYPOINTS, 3) else None,
            ),
            self._groups,
        )
        return Detections(found.corners, found.confidences, found.classes, found.keypoints)


_SHOWN = {"cpu": "CPU", "cuda": "CUDA", "mps": "MPS"}


def load_model(weights: Weights) -> Any:
    """Load weights as ultralytics' ``YOLO``, after :func:`prepare_ultralytics`.

    A .pt is a pickle. It is restricted to the classes that such models consist of; only a file that the user named on
    the command line may contain other code.
    """
    from ultralytics import YOLO
    from ultralytics.nn import tasks

    if weights.path.suffix.lower() != ".pt":
        return YOLO(str(weights.path), task="detect")
    if not weights.may_run_code and not tasks._SafeLoad.SUPPORTED:
        raise RuntimeError("this version of torch cannot load a .pt file without running its code")
    # An import of ultralytics without its environment variable left this False.
    tasks.SAFE_LOAD = True
    try:
        return YOLO(str(weights.path))
    except Exception:
        if not weights.may_run_code:
            raise
    log.warning("%s brings code of its maker. It is run, because the command line names this file", weights.path)
    tasks.SAFE_LOAD = False
    try:
        return YOLO(str(weights.path))
    finally:
        tasks.SAFE_LOAD = True
