"""Frames in shared memory: the requested frame or none."""

from collections.abc import Iterator

import numpy as np
import pytest

from caris_desktop.live.frame_ring import SLOT_COUNT, FrameRing, FrameRings


@pytest.fixture
def ring() -> Iterator[FrameRing]:
    ring = FrameRing.create(max_frame_bytes=64 * 48 * 3)
    yield ring
    ring.close()


def _image(value: int) -> np.ndarray:
    return np.full((48, 64, 3), value, np.uint8)


def test_a_written_frame_is_read_by_every_reader(ring: FrameRing) -> None:
    reader = FrameRing.attach(ring.name)
    ref = ring.write(_image(7), stamp_ns=1, robot_stamp_ns=None, camera="front")
    image = reader.read(ref)
    assert image is not None and (image == 7).all() and image.shape == (48, 64, 3)
    image[:] = 0
    again = reader.read(ref)
    assert again is not None and (again == 7).all(), "readers get copies"
    reader.close()


def test_an_overwritten_frame_is_gone_rather_than_wrong(ring: FrameRing) -> None:
    first = ring.write(_image(1), stamp_ns=1, robot_stamp_ns=None, camera="front")
    for value in range(SLOT_COUNT - 1):
        ring.write(_image(value), stamp_ns=2, robot_stamp_ns=None, camera="front")
    assert ring.read(first) is not None
    ring.write(_image(9), stamp_ns=3, robot_stamp_ns=None, camera="front")
    assert ring.read(first) is None


def test_frames_of_unknown_rings_are_gone(ring: FrameRing) -> None:
    ref = ring.write(_image(1), stamp_ns=1, robot_stamp_ns=None, camera="front")
    assert FrameRings([]).read(ref) is None
    assert FrameRings([ring]).read(ref) is not None


@pytest.mark.parametrize(
    "image", [np.zeros((480, 640, 3), np.uint8), np.zeros((48, 64), np.uint8), np.zeros((48, 64, 3), np.float32)]
)
def test_an_oversized_frame_is_refused(ring: FrameRing, image: np.ndarray) -> None:
    with pytest.raises(ValueError, match="image"):
        ring.write(image, stamp_ns=1, robot_stamp_ns=None, camera="front")


def test_a_writer_that_is_begun_again_continues_counting(ring: FrameRing) -> None:
    """A reference to an old frame must not return a new one."""
    before = [ring.write(_image(value), stamp_ns=value, robot_stamp_ns=None, camera="a") for value in range(1, 31)]
    again = FrameRing.attach(ring.name)
    first = again.write(_image(99), stamp_ns=99, robot_stamp_ns=None, camera="a")
    assert first.sequence == before[-1].sequence + 1
    read = [(ref.stamp_ns, ring.read(ref)) for ref in before]
    assert all(image is None or int(image[0, 0, 0]) == stamp_ns for stamp_ns, image in read)
    assert ring.read(before[-1]) is not None, "and those that are not overwritten stay"
    # Killed while writing: the number of that frame is used up too.
    again._set_slot_sequence((first.sequence + 1) % SLOT_COUNT, 2 * (first.sequence + 1) - 1)
    third = FrameRing.attach(ring.name)
    assert third.write(_image(1), stamp_ns=1, robot_stamp_ns=None, camera="a").sequence == first.sequence + 2
    third.close()
    again.close()
