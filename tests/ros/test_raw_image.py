"""Raw images in every encoding of drivers, packed by the test."""

import base64
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from caris_desktop.ros.message_conversion import FAR_M, NEAR_M, decode_image
from caris_desktop.ros.message_fields import MessageError

WIDTH, HEIGHT = 6, 4
BLUE, GREEN, RED = (250, 10, 20), (15, 240, 25), (30, 40, 230)  # BGR
# Two columns of each: YUV encodings share colours between two pixels.
SHOWN = np.array([[BLUE, BLUE, GREEN, GREEN, RED, RED]] * HEIGHT, np.uint8)


def message(encoding: str, rows: NDArray[Any], *, padding: int = 0, big: bool = False) -> dict[str, Any]:
    """Image message; ``rows`` has the shape (height, bytes of a row) as uint8."""
    packed = np.ascontiguousarray(rows).view(np.uint8).reshape(HEIGHT, -1)
    packed = np.pad(packed, ((0, 0), (0, padding)), constant_values=77)
    return {
        "header": {"stamp": {"secs": 3, "nsecs": 4}},
        "encoding": encoding,
        "width": WIDTH,
        "height": HEIGHT,
        "step": packed.shape[1],
        "is_bigendian": int(big),
        "data": packed.tobytes(),
    }


def with_alpha(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.dstack((image, np.full(image.shape[:2], 128, np.uint8)))


@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize(
    ("encoding", "rows"),
    [
        ("bgr8", SHOWN),
        ("8UC3", SHOWN),
        ("rgb8", SHOWN[:, :, ::-1]),
        ("bgra8", with_alpha(SHOWN)),
        ("8UC4", with_alpha(SHOWN)),
        ("rgba8", with_alpha(SHOWN[:, :, ::-1].copy())),
        ("bgr16", SHOWN.astype("<u2") * 256 + 99),
        ("rgb16", SHOWN[:, :, ::-1].astype("<u2") * 256),
    ],
)
def test_colours_are_what_they_were(encoding: str, rows: NDArray[Any], padding: int) -> None:
    image = decode_image(message(encoding, rows.reshape(HEIGHT, -1), padding=padding))
    assert image.image_bgr.tolist() == SHOWN.tolist()
    assert image.image_bgr.flags["C_CONTIGUOUS"]
    assert image.robot_stamp_ns == 3_000_000_004


def grey_of(image_bgr: NDArray[np.uint8]) -> list[list[int]]:
    assert (image_bgr[:, :, 0] == image_bgr[:, :, 1]).all()
    assert (image_bgr[:, :, 0] == image_bgr[:, :, 2]).all()
    return image_bgr[:, :, 0].tolist()  # type: ignore[no-any-return]


@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
def test_grey_is_grey(encoding: str) -> None:
    grey = np.arange(WIDTH * HEIGHT, dtype=np.uint8).reshape(HEIGHT, WIDTH) * 10
    assert grey_of(decode_image(message(encoding, grey, padding=2)).image_bgr) == grey.tolist()


@pytest.mark.parametrize("big", [False, True])
def test_sixteen_bits_are_read_in_the_order_that_the_message_says(big: bool) -> None:
    grey = np.arange(WIDTH * HEIGHT, dtype=np.uint16).reshape(HEIGHT, WIDTH) * 256 * 10 + 200
    rows = grey.astype(">u2" if big else "<u2")
    assert grey_of(decode_image(message("mono16", rows, big=big)).image_bgr) == (grey // 256).tolist()


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(("encoding", "kind", "unit"), [("16UC1", "u2", 1000.0), ("32FC1", "f4", 1.0)])
def test_depth_is_bright_near_and_dark_far_and_black_where_it_is_unknown(
    encoding: str, kind: str, unit: float, big: bool
) -> None:
    depth_m = np.full((HEIGHT, WIDTH), 2.0)
    depth_m[0] = [0.0, NEAR_M / 2, NEAR_M, 1.0, 3.0, 2 * FAR_M]
    if encoding == "32FC1":
        depth_m[1, :2] = [np.nan, np.inf]
    rows = (depth_m * unit).astype((">" if big else "<") + kind)
    grey = grey_of(decode_image(message(encoding, rows, big=big)).image_bgr)
    unknown, nearest, near, middle, farther, farthest = grey[0]
    assert (unknown, nearest, farthest) == (0, 255, 0)
    assert near >= 254
    assert near > middle > farther > 0
    if encoding == "32FC1":
        assert grey[1][:2] == [0, 0]


@pytest.mark.parametrize(
    ("encoding", "order"), [("yuv422", "uyvy"), ("uyvy", "uyvy"), ("yuv422_yuy2", "yuyv"), ("yuyv", "yuyv")]
)
def test_yuv_patterns_keep_their_colours(encoding: str, order: str) -> None:
    import cv2

    yuv = cv2.cvtColor(SHOWN, cv2.COLOR_BGR2YUV).astype(np.uint8)
    rows = np.zeros((HEIGHT, WIDTH, 2), np.uint8)
    at_luma, at_colour = (1, 0) if order == "uyvy" else (0, 1)
    # The video range of drivers, converted from the full range of OpenCV.
    rows[:, :, at_luma] = np.clip(yuv[:, :, 0] * 219.0 / 255.0 + 16.0, 0, 255)
    rows[:, 0::2, at_colour] = np.clip((yuv[:, 0::2, 1] - 128.0) * 1.14 + 128.0, 0, 255)
    rows[:, 1::2, at_colour] = np.clip((yuv[:, 0::2, 2] - 128.0) * 0.81 + 128.0, 0, 255)
    image = decode_image(message(encoding, rows.reshape(HEIGHT, -1), padding=1)).image_bgr
    assert [int(pixel.argmax()) for pixel in image[1]] == [0, 0, 1, 1, 2, 2], image[1]


@pytest.mark.parametrize(("pattern", "cells"), [("rggb", "RGGB"), ("bggr", "BGGR"), ("gbrg", "GBRG"), ("grbg", "GRBG")])
@pytest.mark.parametrize("bits", [8, 16])
def test_bayer_patterns_distinguish_red_from_blue(pattern: str, cells: str, bits: int) -> None:
    """A red surface: only red cells have values."""
    tile = np.array([[220 if cell == "R" else 0 for cell in cells[at : at + 2]] for at in (0, 2)])
    mosaic = np.tile(tile, (HEIGHT // 2, WIDTH // 2))
    rows = mosaic.astype(np.uint8) if bits == 8 else (mosaic * 256).astype("<u2")
    image = decode_image(message(f"bayer_{pattern}{bits}", rows)).image_bgr
    blue, green, red = image.reshape(-1, 3).mean(axis=0)
    assert red > 150
    assert blue == green == 0


def test_json_carries_the_same_as_text() -> None:
    packed = message("bgr8", SHOWN.reshape(HEIGHT, -1))
    packed["data"] = base64.b64encode(packed["data"]).decode()
    assert decode_image(packed).image_bgr.tolist() == SHOWN.tolist()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"data": b"\0" * 71}, "71 bytes for 4 rows of 18"),
        ({"data": b"\0" * 73}, "73 bytes for 4 rows of 18"),
        ({"data": b""}, "0 bytes"),
        ({"step": 17, "data": b"\0" * 68}, "rows of 17 bytes"),
        ({"step": 0, "data": b""}, "rows of 0 bytes"),
        ({"width": 0}, "0 x 4 pixels"),
        ({"height": 0, "data": b""}, "6 x 0 pixels"),
        ({"width": 70_000}, "Image.width"),
        ({"width": 16_000, "height": 16_000}, "16000 x 16000"),
        ({"encoding": "jpeg"}, "'jpeg'"),
        ({"encoding": "rgb32"}, "'rgb32'"),
        ({"encoding": ""}, "''"),
        ({"data": None}, "Image.data"),
        ({"data": [1, 2, 3]}, "Image.data"),
        ({"step": "18"}, "Image.step"),
    ],
)
def test_a_torn_image_is_refused(change: dict[str, Any], told: str) -> None:
    with pytest.raises(MessageError, match=told):
        decode_image({**message("bgr8", SHOWN.reshape(HEIGHT, -1)), **change})


def test_a_pattern_of_pairs_needs_pairs() -> None:
    odd = {**message("yuyv", np.zeros((HEIGHT, 10), np.uint8)), "width": 5}
    with pytest.raises(MessageError, match="converted"):
        decode_image(odd)


@given(
    st.fixed_dictionaries(
        {
            "encoding": st.sampled_from(["rgb8", "mono16", "32FC1", "bayer_rggb8", "yuv422", "16UC1"]) | st.text(),
            "width": st.integers(-1, 9),
            "height": st.integers(-1, 9),
            "step": st.integers(-1, 40),
            "is_bigendian": st.one_of(st.booleans(), st.none(), st.integers(), st.text()),
            "data": st.binary(max_size=300),
        }
    )
)
def test_nothing_that_a_robot_sends_is_more_than_a_refusal(sent: dict[str, Any]) -> None:
    try:
        image = decode_image(sent)
    except MessageError:
        return
    assert image.image_bgr.shape == (sent["height"], sent["width"], 3)
    assert image.image_bgr.dtype == np.uint8
