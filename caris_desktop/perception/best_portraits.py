"""Portraits: the best view of each person so far, as a small image."""

import cv2
import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.person_values import PersonPortrait
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.value_class import dataclass
from caris_desktop.perception.tracker import TrackedBox

_NOT_SOONER_NS = 1_000_000_000
_BETTER = 1.2
_LEAST_QUALITY = 0.15
_TALL_PX = 320
_MARGIN = 0.05
_KEPT = 500


@dataclass(frozen=True, slots=True)
class _Best:
    stamp_ns: int
    worth: float


class PortraitTaker:
    """For one thread. At most one per second and track, and only if clearly better than the last."""

    def __init__(self) -> None:
        self._best: dict[int, _Best] = {}

    def taken(self, image_bgr: NDArray[np.uint8], frame: FrameRef, boxes: list[TrackedBox]) -> list[PersonPortrait]:
        """New best views in an image: uint8 BGR, shape (height, width, 3)."""
        portraits = []
        for box in boxes:
            # Closer people show more detail, even where a network would not benefit.
            worth = box.quality * min(1.0, box.height_px / _TALL_PX) ** 0.5
            best = self._best.get(box.track)
            if box.quality < _LEAST_QUALITY or (
                best is not None and (worth < _BETTER * best.worth or frame.stamp_ns - best.stamp_ns < _NOT_SOONER_NS)
            ):
                continue
            jpeg = _jpeg(image_bgr, box)
            if jpeg is None:
                continue
            self._best.pop(box.track, None)
            self._best[box.track] = _Best(frame.stamp_ns, worth)
            if len(self._best) > _KEPT:
                del self._best[next(iter(self._best))]
            portraits.append(PersonPortrait(frame.stamp_ns, frame.camera, box.track, jpeg, box.quality))
        return portraits


def _jpeg(image_bgr: NDArray[np.uint8], box: TrackedBox) -> bytes | None:
    height, width = image_bgr.shape[:2]
    margin = _MARGIN * box.height_px
    left, top = max(0, round(box.left_px - margin)), max(0, round(box.top_px - margin))
    right = min(width, round(box.left_px + box.width_px + margin))
    bottom = min(height, round(box.top_px + box.height_px + margin))
    if right - left < 2 or bottom - top < 2:
        return None
    crop = image_bgr[top:bottom, left:right]
    if bottom - top > _TALL_PX:
        smaller = (max(1, round((right - left) * _TALL_PX / (bottom - top))), _TALL_PX)
        crop = cv2.resize(crop, smaller, interpolation=cv2.INTER_AREA).astype(np.uint8)
    done, encoded = cv2.imencode(".jpg", crop, (cv2.IMWRITE_JPEG_QUALITY, 88))
    return encoded.tobytes() if done else None
