"""Check of camera images: displayed, or refused with a message."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from caris_desktop.domain.media_checks import PictureError, decode_compressed, fitted, fitting_size
from caris_desktop.domain.sensing import DepthGrid


def test_large_pictures_keep_their_shape() -> None:
    assert fitting_size(1920, 1080) == (1920, 1080)
    assert fitting_size(1080, 1920) == (1080, 1920)
    assert fitting_size(3840, 2160) == (1920, 1080)
    width_px, height_px = fitting_size(7680, 1000)
    assert width_px * height_px <= 1920 * 1080 and abs(width_px / height_px - 7.68) < 0.01


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (np.zeros((1, 1, 3), np.uint8), "1 x 1 pixels, which is too small"),
        (np.zeros((0, 64, 3), np.uint8), "too small"),
        (np.zeros((2, 4_000_000), np.uint8), "too small"),
        (np.broadcast_to(np.uint8(0), (10_000, 10_000)), "too large"),
        (np.zeros((48, 64, 2), np.uint8), "not a greyscale or colour image"),
        (np.zeros((48, 64, 3), np.float64), "float64"),
        (np.zeros(64, np.uint8), "64"),
    ],
)
def test_an_undisplayable_image_is_refused(image: np.ndarray, said: str) -> None:
    with pytest.raises(PictureError, match=said):
        fitted(image)


def test_a_fitting_image_is_not_copied() -> None:
    image = np.zeros((48, 64, 3), np.uint8)
    assert np.shares_memory(fitted(image), image)


def test_no_byte_of_a_broken_picture_is_shown_and_none_breaks_the_program() -> None:
    rng = np.random.default_rng(3)
    whole = cv2.imencode(".jpg", rng.integers(0, 256, (48, 64, 3), np.uint8))[1].tobytes()
    assert decode_compressed(whole).shape == (48, 64, 3)
    for end in range(0, len(whole) - 2, 97):
        with pytest.raises(PictureError):
            decode_compressed(whole[:end])
    for _ in range(200):
        broken = bytearray(whole)
        broken[int(rng.integers(2, 600))] ^= int(rng.integers(1, 256))
        try:
            assert decode_compressed(bytes(broken)).ndim == 3
        except PictureError:
            continue


@pytest.mark.parametrize("kind", [b"zTXt", b"iTXt"])
def test_a_png_of_very_many_packed_texts_is_refused_before_it_costs_seconds(kind: bytes) -> None:
    whole = cv2.imencode(".png", np.zeros((48, 64, 3), np.uint8))[1].tobytes()
    content = b"key\0" + (b"\0" if kind == b"zTXt" else b"\1\0\0\0") + zlib.compress(bytes(1000))
    text = struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
    assert decode_compressed(whole[:-12] + 9 * text + whole[-12:]).shape == (48, 64, 3)
    with pytest.raises(PictureError):
        decode_compressed(whole[:-12] + 1000 * text + whole[-12:])


def test_a_jpeg_of_very_many_scans_is_refused_before_it_costs_minutes() -> None:
    image = np.full((48, 64, 3), 128, np.uint8)
    whole = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    assert decode_compressed(whole).shape == (48, 64, 3)
    with pytest.raises(PictureError):
        decode_compressed(whole[:-2] + 1000 * whole[whole.rindex(b"\xff\xda") : -2] + whole[-2:])


def test_the_distance_of_a_part_of_the_picture_is_the_middle_one_of_those_known() -> None:
    depths = np.full((45, 80), 5000, np.uint16)
    depths[10:30, 20:40] = 2000
    depths[10:14, 20:40] = 0
    grid = DepthGrid(1, "oak", depths)
    assert grid.median_m(0.25, 0.25, 0.5, 0.65) == 2.0
    assert grid.median_m(0.6, 0.0, 1.0, 1.0) == 5.0
    assert grid.median_m(-0.5, -0.5, 1.5, 1.5) == 5.0
    assert grid.median_m(0.25, 0.23, 0.5, 0.3) is None, "mostly unknown"
    assert grid.median_m(1.2, 0.0, 1.5, 1.0) is None
