"""Uncompressed images: sensor_msgs/Image in the camera driver's formats."""

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.ros.message_conversion import MAX_IMAGE_SIDE_PX
from caris_desktop.ros.message_fields import Message, MessageError, blob, count, message_of, stamp_of, text

MOST_PIXELS = 64_000_000
NEAR_M, FAR_M = 0.3, 6.0
"""The distances between which a depth picture goes from white to black; nearer is white, and unknown is black."""

# Channels, and OpenCV's name of the conversion to BGR
_COLOURS = {"bgr": (3, ""), "rgb": (3, "RGB2BGR"), "rgba": (4, "RGBA2BGR"), "bgra": (4, "BGRA2BGR"),
            "mono": (1, "GRAY2BGR")}  # fmt: skip
_BITS: dict[str, np.dtype[Any]] = {"8": np.dtype(np.uint8), "16": np.dtype(np.uint16)}
# OpenCV names a pattern by its second row.
_BAYER = {"bayer_rggb": "BayerBG", "bayer_bggr": "BayerRG", "bayer_gbrg": "BayerGR", "bayer_grbg": "BayerGB"}
# uyvy and yuyv are the names since ROS 2 Iron.
_YUV = {"yuv422": "UYVY", "uyvy": "UYVY", "yuv422_yuy2": "YUY2", "yuyv": "YUY2"}
_DEPTHS: dict[str, np.dtype[Any]] = {"16UC1": np.dtype(np.uint16), "32FC1": np.dtype(np.float32)}
_OF_OPENCV = {"8UC1": "mono8", "8UC3": "bgr8", "8UC4": "bgra8"}


class RawImage(Value, eq=False):
    """``image_bgr`` is uint8, shape (height, width, 3)."""

    image_bgr: NDArray[np.uint8]
    robot_stamp_ns: int | None


class _Layout(Value):
    """Memory layout: ``channels`` values of ``dtype`` per pixel. ``conversion`` is OpenCV's name of the conversion to
    BGR, empty for none; ``depth``: a depth image.
    """

    dtype: np.dtype[Any]
    channels: int
    conversion: str
    depth: bool = False


def decode_image(message: Any) -> RawImage:
    """Decode colours, grey, Bayer and YUV patterns, and depth (16UC1 in millimetres, 32FC1 in metres: REP 118) as grey.

    Raises
    ------
    MessageError
        Also where step and size do not agree with the data: what is torn is not shown.
    """
    import cv2

    image = message_of(message, "Image")
    encoding = text(image, "encoding", "Image")
    layout = _layout_of(encoding)
    pixels = _pixels(image, layout)
    if layout.depth:
        grey = depth_as_grey(pixels[:, :, 0].astype(np.float32) * (0.001 if layout.dtype.kind == "u" else 1.0))
        return RawImage(np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), np.uint8), stamp_of(image, "Image"))
    if layout.dtype.itemsize == 2:
        pixels = (pixels >> 8).astype(np.uint8)
    try:
        if layout.conversion:
            # Two colours of a YUV pattern require an even width, which OpenCV checks.
            pixels = cv2.cvtColor(np.ascontiguousarray(pixels), getattr(cv2, f"COLOR_{layout.conversion}"))
    except cv2.error as error:
        raise MessageError(f"an image that cannot be converted ({encoding[:20]})") from error
    return RawImage(np.ascontiguousarray(pixels, np.uint8), stamp_of(image, "Image"))


def depth_as_grey(depth_m: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Grey image of depth: near is bright, far is dark, unknown (0, NaN, infinite) is black."""
    known = np.isfinite(depth_m) & (depth_m > 0.0)
    share = (FAR_M - np.where(known, depth_m, FAR_M)) / (FAR_M - NEAR_M)
    return (np.clip(share, 0.0, 1.0) * 255.0).astype(np.uint8)


def republish_advice(raw_topic: str) -> str:
    """Advice for compressed images from the robot."""
    return localized(
        QT_TR_NOOP(
            "run 'image_transport republish raw compressed' for {raw_topic} on the robot, or install the "
            "plugin for compressed images there, and use {raw_topic}/compressed in the profile"
        ),
        raw_topic=raw_topic,
    )


def _layout_of(encoding: str) -> _Layout:
    name = _OF_OPENCV.get(encoding, encoding)
    if name in _DEPTHS:
        return _Layout(_DEPTHS[name], 1, "", depth=True)
    if name in _YUV:
        return _Layout(_BITS["8"], 2, f"YUV2BGR_{_YUV[name]}")
    colours = name.rstrip("0123456789")
    dtype = _BITS.get(name.removeprefix(colours))
    if dtype is not None and colours in _BAYER:
        return _Layout(dtype, 1, f"{_BAYER[colours]}2BGR")
    if dtype is not None and colours in _COLOURS:
        channels, conversion = _COLOURS[colours]
        return _Layout(dtype, channels, conversion)
    raise MessageError(f"images encoded as '{encoding[:40]}' are not supported")


def _pixels(image: Message, layout: _Layout) -> NDArray[Any]:
    """Shape (height, width, channels), in native byte order."""
    width, height = (count(image, name, "Image", most=MAX_IMAGE_SIDE_PX) for name in ("width", "height"))
    step = count(image, "step", "Image", most=2**31)
    if not width or not height or width * height > MOST_PIXELS:
        raise MessageError(f"an image of {width} x {height} pixels")
    data = np.frombuffer(blob(image, "data", "Image", most=16 * MOST_PIXELS), np.uint8)
    row_bytes = width * layout.channels * layout.dtype.itemsize
    if step < row_bytes:
        raise MessageError(f"rows of {step} bytes, too few for {width} pixels")
    if len(data) != step * height:
        raise MessageError(f"{len(data)} bytes for {height} rows of {step}")
    rows = np.ascontiguousarray(data.reshape(height, step)[:, :row_bytes])
    values = rows.view(layout.dtype).reshape(height, width, layout.channels)
    foreign = bool(image.get("is_bigendian")) != (sys.byteorder == "big")
    return values.byteswap() if foreign and layout.dtype.itemsize > 1 else values
