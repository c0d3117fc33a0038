"""Messages between console and inference process, in addition to values of the stream table."""

from caris_desktop.domain.events import Problem
from caris_desktop.domain.person_values import LooksKind
from caris_desktop.domain.plugins import Plugin
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.value_class import Value

USUAL_FOCAL_PER_WIDTH = 0.87
"""Of a camera that sees 60 degrees."""


class DetectionRequest(Value):
    """Detection request for a frame. ``direction`` is the camera's direction at capture: heading (left positive, not
    wrapped) and tilt (down positive) in radians; None if unknown. ``focal_per_width`` is its focal length relative to
    the width. ``faces``: face embeddings are permitted. ``to_cover``: people must be blurred in this camera's images,
    so that possible people are reported too.
    """

    frame: FrameRef
    direction: tuple[float, float] | None = None
    focal_per_width: float = USUAL_FOCAL_PER_WIDTH
    faces: bool = False
    to_cover: bool = False


class InferenceReady(Value):
    """The model is loaded and warm; sent once, before the first ``People``.

    ``server`` is the machine that runs the detector and gets the images; empty for this one. ``recognises`` lists the
    available kinds of embeddings, ``plugins`` those in use.
    """

    stamp_ns: int
    model: str
    load_s: float
    server: str = ""
    recognises: tuple[LooksKind, ...] = ()
    plugins: tuple[Plugin, ...] = ()


class InferenceFailed(Value):
    """Inference cannot run; no more messages follow. A restart would fail in the same way."""

    stamp_ns: int
    problem: Problem


class DetectorAway(Value):
    """The remote detector does not answer: no ``People`` until it does."""

    stamp_ns: int
    problem: Problem


class FrameSkipped(Value):
    """The frame was overwritten before it could be read, or could not be processed: no ``People``."""

    stamp_ns: int
    camera: str
    frame_sequence: int
