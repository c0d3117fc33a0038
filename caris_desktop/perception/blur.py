"""Blurring of people: pixelates image areas irreversibly.

A face is reduced to at most six blocks across, a body to ten, each a coarse average: too little for recognition, even
over many frames.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.sensing import PersonBox

What = Literal["faces", "persons"]
Corners = tuple[float, float, float, float]
"""Left, top, right and bottom of a part of the picture, in pixels."""

BLOCKS_ACROSS: dict[What, int] = {"faces": 6, "persons": 10}
WHOLE_BLOCKS_ACROSS = 16
_SHADES = 16
_LEAST_BLOCK_PX = 4
_HEAD_HEIGHT = 1 / 3
_HEAD_OF_WIDTH = 0.9
"""A box that ends at the waist, as of somebody close by, shows a head of about this share of its width."""
_WIDER = 0.15
_VISIBLE = 0.5
_LEAST_HEAD_OF_HEIGHT = 0.07


def part_to_cover(box: PersonBox, what: What) -> Corners:
    """Area of the face in a person's box, or the whole box.

    The head is the upper third, or more if the box is wide for its height: sitting, cropped, or bent.
    """
    left, top = box.left_px, box.top_px
    right, bottom = left + box.width_px, top + box.height_px
    if what == "faces":
        head_px = min(box.height_px, max(box.height_px * _HEAD_HEIGHT, box.width_px * _HEAD_OF_WIDTH))
        bottom = top + head_px
        left, right = left - _WIDER * box.width_px, right + _WIDER * box.width_px
        top -= _WIDER * head_px
    return left, top, right, bottom


def head_of(keypoints: NDArray[np.float64], height_px: float) -> Corners | None:
    """Area of the head by nose, eyes and ears, wherever it is in the box: bent, lying, an arm above it.

    ``keypoints`` are COCO's of one person, shape (17, 3): x, y in pixels, visibility; ``height_px`` is that of the box.
    None if fewer than two of them are visible.
    """
    visible = keypoints[:5][keypoints[:5, 2] >= _VISIBLE]
    if len(visible) < 2:
        return None
    low, high = visible[:, :2].min(axis=0), visible[:, :2].max(axis=0)
    half_px = max(float((high - low).max()), _LEAST_HEAD_OF_HEIGHT * height_px)
    x, y = ((low + high) / 2).tolist()
    return x - half_px, y - half_px, x + half_px, y + half_px


def cover(image_bgr: NDArray[np.uint8], parts: Sequence[Corners], what: What) -> None:
    """Pixelate these areas in place. ``image_bgr``: uint8, shape (height, width, 3)."""
    height_px, width_px = image_bgr.shape[:2]
    for left, top, right, bottom in parts:
        x0, y0 = max(0, int(np.floor(left))), max(0, int(np.floor(top)))
        x1, y1 = min(width_px, int(np.ceil(right))), min(height_px, int(np.ceil(bottom)))
        if x0 < x1 and y0 < y1:
            # Block size by the whole area, even if most of it is outside the image.
            block_px = max(_LEAST_BLOCK_PX, (right - left) / BLOCKS_ACROSS[what])
            _pixelate(image_bgr[y0:y1, x0:x1], block_px)


def cover_all(image_bgr: NDArray[np.uint8]) -> None:
    """Pixelate the whole image in place, so that a face of a third of it has at most six blocks."""
    _pixelate(image_bgr, max(_LEAST_BLOCK_PX, image_bgr.shape[1] / WHOLE_BLOCKS_ACROSS))


def _pixelate(part_bgr: NDArray[np.uint8], block_px: float) -> None:
    import cv2  # heavy, and not needed by every process that imports this

    height_px, width_px = part_bgr.shape[:2]
    across, down = max(1, int(width_px / block_px)), max(1, int(height_px / block_px))
    few = cv2.resize(part_bgr, (across, down), interpolation=cv2.INTER_AREA)
    step = 256 // _SHADES
    few = few // step * step + step // 2
    part_bgr[:] = cv2.resize(few, (width_px, height_px), interpolation=cv2.INTER_NEAREST)
