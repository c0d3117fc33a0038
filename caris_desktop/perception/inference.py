"""The process body of inference: newest camera frame in, people out."""

from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Literal

from caris_desktop.domain.events import Problem
from caris_desktop.domain.ports import FrameReader

TrackerName = Literal["bytetrack", "botsort"]


@dataclass(frozen=True, slots=True)
class InferenceSettings:
    """What a run of inference needs; picklable.

    ``weights_path`` is what the user configured, None to search (weights.find_weights, done in the child).
    """

    weights_path: Path | None = None
    allow_download: bool = True
    tracker: TrackerName = "bytetrack"
    confidence: float = 0.1
    max_hz: float = 30.0
    threads: int = 2
    niceness: int = 10


@dataclass(frozen=True, slots=True)
class InferenceReady:
    """The model is loaded and warm; sent once, before the first ``People``."""

    stamp_ns: int
    model: str
    load_s: float


@dataclass(frozen=True, slots=True)
class InferenceFailed:
    """Inference cannot run; the process ends after sending this."""

    stamp_ns: int
    problem: Problem


def run_inference(connection: Connection, frames: FrameReader, settings: InferenceSettings) -> None:
    """Receives ``FrameRef``s, sends ``InferenceReady`` or ``InferenceFailed``, then ``People`` per processed frame."""
