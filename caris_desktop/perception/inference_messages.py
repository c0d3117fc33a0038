"""What the console and the process of inference tell each other, besides values of the stream table."""

from caris_desktop.domain.events import Problem
from caris_desktop.domain.people import LooksKind
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.value_class import dataclass

USUAL_FOCAL_PER_WIDTH = 0.87
"""Of a camera that sees 60 degrees."""


@dataclass(frozen=True, slots=True)
class Look:
    """A picture to find people in. ``looked`` is where its camera pointed when it was taken: heading (left positive,
    not wrapped) and tilt (down positive) in radians; None where nobody told. ``focal_per_width`` is its lens.
    ``faces``: faces may be looked at, too. ``to_cover``: people have to be covered in this camera's pictures, so
    whoever may be one is to be told of.
    """

    frame: FrameRef
    looked: tuple[float, float] | None = None
    focal_per_width: float = USUAL_FOCAL_PER_WIDTH
    faces: bool = False
    to_cover: bool = False


@dataclass(frozen=True, slots=True)
class InferenceReady:
    """The model is loaded and warm; sent once, before the first ``People``.

    ``server`` is the other machine that looks in this one's place, and gets the pictures; empty for none.
    ``recognises`` says by what people can be known again: for what there is a network.
    """

    stamp_ns: int
    model: str
    load_s: float
    server: str = ""
    recognises: tuple[LooksKind, ...] = ()


@dataclass(frozen=True, slots=True)
class InferenceFailed:
    """Inference cannot run (any more); the process sends nothing more. Starting it again would fail in the same way."""

    stamp_ns: int
    problem: Problem


@dataclass(frozen=True, slots=True)
class DetectorAway:
    """The machine that looks in this one's place does not answer: no ``People`` until it does, and then again."""

    stamp_ns: int
    problem: Problem


@dataclass(frozen=True, slots=True)
class FrameSkipped:
    """The frame's pixels were overwritten before they could be read, or could not be processed: no ``People``."""

    stamp_ns: int
    camera: str
    frame_sequence: int
