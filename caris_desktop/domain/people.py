"""How somebody looks: what perception tells of a track, and what identities are made from.

Never recorded and in no table of streams: it goes from perception to the people of the study, and nowhere else.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import dataclass

LooksKind = Literal["clothing", "face"]
"""Clothing tells people apart on one day, a face across days. A face is looked at only with consent."""


@dataclass(frozen=True, slots=True, eq=False)
class PersonLooks:
    """How somebody looked in one frame.

    ``vector`` is float32 of unit length. ``model`` is the network that made it: vectors of different ones are never
    compared. ``quality`` is 0..1: sure to be a person, big enough, and not covered by another box.
    """

    stamp_ns: int
    camera: str
    track: int
    kind: LooksKind
    model: str
    vector: NDArray[np.float32]
    quality: float


@dataclass(frozen=True, slots=True)
class PersonPortrait:
    """The best view of somebody so far, as JPEG. ``quality`` is as that of :class:`PersonLooks`."""

    stamp_ns: int
    camera: str
    track: int
    jpeg: bytes
    quality: float
