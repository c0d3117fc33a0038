"""Face embeddings: aligned faces through an ArcFace network (ONNX, 112 x 112) that the study supplies.

With eyes and nose from the detector, the face is rotated and scaled to the network's reference positions. Without them,
the middle of the head area is used, with a lower quality.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.person_values import PersonLooks
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.perception.appearance_embedding import EmbeddingModel
from caris_desktop.perception.inference_messages import DetectionRequest
from caris_desktop.perception.tracker import TrackedBox

SIDE_PX = 112
# Reference positions of eyes and nose in the networks' training data (insightface, arcface_src).
_PLACES = np.array([[56.0252, 71.7366], [73.5318, 51.5014], [38.2946, 51.6963]])
_NOSE, _LEFT_EYE, _RIGHT_EYE = 0, 1, 2
"""Of COCO's keypoints, in the order of ``_PLACES``: somebody's left eye is on the right of the picture."""
_VISIBLE = 0.5
_LEAST_EYES_PX, _LEAST_HEAD_PX = 10.0, 36.0
_HEAD_OF_WIDTH = 0.6
_BY_GUESS = 0.5
_NOT_SOONER_NS = 500_000_000
_MAX_FACES = 500


class FaceModel(EmbeddingModel):
    """Face network. Raises EmbeddingModelError."""

    def __init__(self, path: Path, *, threads: int = 1) -> None:
        super().__init__(
            path,
            threads=threads,
            size_px=(SIDE_PX, SIDE_PX),
            unreadable=QT_TR_NOOP("The face recognition model {name} cannot be read."),
            unloadable=QT_TR_NOOP("The face recognition model {name} could not be loaded."),
            wrong_input=QT_TR_NOOP("{name} is not a face recognition model: its input is not 3 x 112 x 112."),
        )
        self.embed(np.zeros((SIDE_PX, SIDE_PX, 3), np.uint8))  # warm-up: the first run is the slowest

    def embed(self, face_bgr: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Embedding of unit length. ``face_bgr``: uint8, shape (112, 112, 3)."""
        rgb = face_bgr[:, :, ::-1].astype(np.float32)
        batch = np.ascontiguousarray(((rgb - 127.5) / 127.5).transpose(2, 0, 1)[np.newaxis])
        vector = np.asarray(self._session.run(None, {self._input: batch})[0], np.float32).reshape(-1)
        return np.asarray(vector / max(1e-12, float(np.linalg.norm(vector))), np.float32)


class FaceCrop(Value):
    """``image_bgr`` is uint8, shape (112, 112, 3); ``quality`` is 0..1."""

    image_bgr: NDArray[np.uint8]
    quality: float


class StudyFaces:
    """Face embeddings where the scenario permits them, with the study's network if it has one. For one thread.

    The network is opened on the first permitted use. At most two faces per second and track, and one per image: the
    track that waited longest.
    """

    def __init__(self, path: Path | None, *, threads: int = 1) -> None:
        self._path = path
        self._threads = threads
        self._model: FaceModel | None = None
        self._detected_ns: dict[int, int] = {}

    def extract(
        self,
        image_bgr: NDArray[np.uint8],
        request: DetectionRequest,
        boxes: Sequence[TrackedBox],
        keypoints: NDArray[np.float64] | None,
    ) -> list[PersonLooks]:
        """Embedding of a due face, if any; empty if faces are not permitted. Raises EmbeddingModelError, once.

        ``keypoints`` are the detector's, shape (detections, 17, 3), or None.
        """
        if not request.faces:
            return []
        path, self._path = self._path, None
        if path is not None and path.is_file():
            self._model = FaceModel(path, threads=self._threads)
        model, frame = self._model, request.frame
        if model is None:
            return []
        due = [
            box
            for box in boxes
            if frame.stamp_ns - self._detected_ns.get(box.track, frame.stamp_ns - _NOT_SOONER_NS) >= _NOT_SOONER_NS
        ]
        for box in sorted(due, key=lambda one: self._detected_ns.get(one.track, 0)):
            face = face_of(image_bgr, box, None if keypoints is None else keypoints[box.detection])
            if face is None:
                continue
            self._detected_ns.pop(box.track, None)
            self._detected_ns[box.track] = frame.stamp_ns
            if len(self._detected_ns) > _MAX_FACES:
                del self._detected_ns[next(iter(self._detected_ns))]
            vector = model.embed(face.image_bgr)
            return [PersonLooks(frame.stamp_ns, frame.camera, box.track, "face", model.name, vector, face.quality)]
        return []


def face_of(image_bgr: NDArray[np.uint8], box: TrackedBox, keypoints: NDArray[np.float64] | None) -> FaceCrop | None:
    """Aligned face of a person; None if it is too small or turned away.

    ``keypoints`` are those of this person, shape (17, 3): x, y in pixels, visibility.
    """
    if keypoints is None:
        # Middle of the upper end of the box, in the usual ratio of head to shoulder width.
        side = min(_HEAD_OF_WIDTH * box.width_px, box.height_px)
        left, top = box.left_px + (box.width_px - side) / 2, box.top_px
        height, width = image_bgr.shape[:2]
        if side < _LEAST_HEAD_PX or left < 0 or top < 0 or left + side > width or top + side > height:
            return None
        crop = image_bgr[round(top) : round(top + side), round(left) : round(left + side)]
        image = cv2.resize(crop, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_LINEAR).astype(np.uint8)
        return FaceCrop(image, _BY_GUESS * box.quality)
    points = keypoints[[_NOSE, _LEFT_EYE, _RIGHT_EYE]]
    eyes_px = float(np.linalg.norm(points[1, :2] - points[2, :2]))
    if points[:, 2].min() < _VISIBLE or eyes_px < _LEAST_EYES_PX:
        return None
    turned = _similarity(points[:, :2], _PLACES)
    image = cv2.warpAffine(image_bgr, turned, (SIDE_PX, SIDE_PX), flags=cv2.INTER_LINEAR).astype(np.uint8)
    return FaceCrop(image, box.quality * min(1.0, eyes_px / (2.5 * _LEAST_EYES_PX)))


def _similarity(points: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Similarity transform of the points to the reference positions, shape (2, 3): Umeyama 1991, least squares."""
    middle, goal = points.mean(axis=0), places.mean(axis=0)
    away, centred_places = points - middle, places - goal
    u, stretch, vt = np.linalg.svd(centred_places.T @ away)
    mirror = np.array([1.0, np.sign(np.linalg.det(u @ vt))])
    turn = u @ np.diag(mirror) @ vt
    scale = float((stretch * mirror).sum() / (away**2).sum())
    return np.hstack([scale * turn, (goal - scale * turn @ middle)[:, np.newaxis]])
