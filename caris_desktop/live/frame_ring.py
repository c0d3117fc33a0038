"""Ring buffer of camera frames in shared memory: one writer, any number of readers in any process.

Each slot has a sequence number that is odd during a write (a seqlock): a reader that was overtaken by the writer
detects it and reports the frame as lost instead of torn.
"""

import struct
from collections.abc import Iterable
from multiprocessing import shared_memory
from typing import cast

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.sensing import FrameRef

SLOT_COUNT = 24
MAX_FRAME_BYTES = 1920 * 1080 * 3
_SLOT_HEADER_BYTES = 16
_SEQUENCE = struct.Struct("<q")


class FrameRing:
    """Writer and reader end. Created by the console, attached by name in child processes."""

    def __init__(self, memory: shared_memory.SharedMemory, *, owner: bool) -> None:
        self._memory = memory
        self._buffer = cast(memoryview, memory.buf)
        self._owner = owner
        self._next_sequence = 0
        self._slot_bytes = memory.size // SLOT_COUNT // 4096 * 4096

    @classmethod
    def create(cls, max_frame_bytes: int = MAX_FRAME_BYTES) -> "FrameRing":
        slot_bytes = (max_frame_bytes + _SLOT_HEADER_BYTES + 4095) // 4096 * 4096
        return cls(shared_memory.SharedMemory(create=True, size=slot_bytes * SLOT_COUNT), owner=True)

    @classmethod
    def attach(cls, name: str) -> "FrameRing":
        # Children share the console's resource tracker: registering again on attach is a no-op, and the segment is
        # removed once, even if the console is killed.
        return cls(shared_memory.SharedMemory(name=name), owner=False)

    @property
    def name(self) -> str:
        return self._memory.name

    def write(
        self, image_bgr: NDArray[np.uint8], *, stamp_ns: int, robot_stamp_ns: int | None, camera: str
    ) -> FrameRef:
        """Write a frame. Raises ValueError if the image exceeds a slot or is not uint8 BGR."""
        if image_bgr.dtype != np.uint8 or image_bgr.ndim != 3 or image_bgr.shape[2] != 3:
            raise ValueError(f"expected a uint8 BGR image, got {image_bgr.dtype} {image_bgr.shape}")
        if image_bgr.nbytes > self._slot_bytes - _SLOT_HEADER_BYTES:
            raise ValueError(f"a {image_bgr.shape[1]}x{image_bgr.shape[0]} image does not fit a frame slot")
        sequence = self._next_sequence or self._sequence_after_all()
        self._next_sequence = sequence + 1
        slot = sequence % SLOT_COUNT
        self._set_slot_sequence(slot, 2 * sequence - 1)
        np.copyto(self._pixels(slot, image_bgr.shape[0], image_bgr.shape[1]), image_bgr)
        self._set_slot_sequence(slot, 2 * sequence)
        return FrameRef(
            stamp_ns=stamp_ns,
            robot_stamp_ns=robot_stamp_ns,
            camera=camera,
            ring=self.name,
            slot=slot,
            sequence=sequence,
            width_px=image_bgr.shape[1],
            height_px=image_bgr.shape[0],
        )

    def read(self, ref: FrameRef) -> NDArray[np.uint8] | None:
        if ref.ring != self.name or self._slot_sequence(ref.slot) != 2 * ref.sequence:
            return None
        image_bgr = self._pixels(ref.slot, ref.height_px, ref.width_px).copy()
        return image_bgr if self._slot_sequence(ref.slot) == 2 * ref.sequence else None

    def close(self) -> None:
        del self._buffer
        self._memory.close()
        if self._owner:
            self._memory.unlink()

    def _pixels(self, slot: int, height_px: int, width_px: int) -> NDArray[np.uint8]:
        offset = slot * self._slot_bytes + _SLOT_HEADER_BYTES
        return np.ndarray((height_px, width_px, 3), np.uint8, self._buffer, offset)

    def _sequence_after_all(self) -> int:
        """Next sequence number. A restarted writer continues the count, so that a reference to an older frame never
        finds a newer one.
        """
        return max((self._slot_sequence(slot) + 1) // 2 for slot in range(SLOT_COUNT)) + 1

    def _slot_sequence(self, slot: int) -> int:
        return int(_SEQUENCE.unpack_from(self._buffer, slot * self._slot_bytes)[0])

    def _set_slot_sequence(self, slot: int, value: int) -> None:
        _SEQUENCE.pack_into(self._buffer, slot * self._slot_bytes, value)


class FrameRings:
    """Reads from the ring that a :class:`FrameRef` names.

    With ``attach``, an unknown ring is attached on first use: a scenario may add cameras while readers run.
    """

    def __init__(self, rings: Iterable[FrameRing], *, attach: bool = False) -> None:
        self._rings = {ring.name: ring for ring in rings}
        self._attach = attach

    def add(self, ring: FrameRing) -> None:
        """Add a ring; it is closed with the others."""
        self._rings[ring.name] = ring

    def read(self, ref: FrameRef) -> NDArray[np.uint8] | None:
        ring = self._rings.get(ref.ring)
        if ring is None:
            if not self._attach:
                return None
            try:
                ring = self._rings[ref.ring] = FrameRing.attach(ref.ring)
            except (FileNotFoundError, ValueError):
                return None
        return ring.read(ref)

    def close(self) -> None:
        for ring in self._rings.values():
            ring.close()
