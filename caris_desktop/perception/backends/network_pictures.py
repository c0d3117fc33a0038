"""Image scaling to a network's input, and mapping of its results back."""

import cv2
import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import dataclass

STRIDE_PX = 32
_GREY = 114


@dataclass(frozen=True, slots=True)
class Fit:
    """Placement of an image in the input: scale factors, then offset in pixels."""

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
