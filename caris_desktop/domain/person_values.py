"""Appearance of people: from perception, and the input of identification.

Never recorded and in no stream table: passed from perception to the study's people only.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import Value

LooksKind = Literal["clothing", "face"]
"""Clothing distinguishes people on one day, a face across days. A face is used only with consent."""


class PersonLooks(Value, eq=False):
    """Appearance of a person in one frame.

    ``vector`` is float32 of unit length. ``model`` is the network that made it: vectors of different ones are never
    compared. ``quality`` is 0..1: surely a person, large enough, and not covered by another box.
    """

    stamp_ns: int
    camera: str
    track: int
    kind: LooksKind
    model: str
    vector: NDArray[np.float32]
    quality: float


class PersonPortrait(Value):
    """Best view of a person so far, as JPEG. ``quality`` is as in :class:`PersonLooks`."""

    stamp_ns: int
    camera: str
    track: int
    jpeg: bytes
    quality: float
