"""Data of the session timeline apart from the coders' tiers: moments, waveforms, speed curve."""

from dataclasses import field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument
from caris_desktop.recording.session.session_protocol import StepRecord


class Moment(Value):
    """Seek target on the timeline."""

    kind: Literal["mark", "utterance"]
    at_ns: int
    text: str


class Waveform(Value, eq=False):
    """Waveform of one audio file: ``peaks`` is float32, shape (buckets, 2), min and max in -1..1,
    from ``first_ns`` on.
    """

    source: str
    first_ns: int
    bucket_ns: int
    peaks: NDArray[np.float32]


class SessionOverview(Value, eq=False):
    """``tiers`` are those derived from the recording. ``speed`` is float32, shape (n, 3): session seconds, m/s, rad/s.
    ``cameras`` are those with video, ``steps`` those of the protocol.
    """

    tiers: AnnotationDocument
    moments: tuple[Moment, ...]
    waveforms: tuple[Waveform, ...] = ()
    speed: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    cameras: tuple[str, ...] = ()
    steps: tuple[StepRecord, ...] = ()
