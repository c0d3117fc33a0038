"""Messages between console and inference process, in addition to values of the stream table."""

import os
from dataclasses import field
from pathlib import Path
from typing import Literal

from caris_desktop.domain.events import Problem
from caris_desktop.domain.person_values import LooksKind
from caris_desktop.domain.plugins import Plugin
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.value_class import Value
from caris_desktop.perception.weights import DetectorChoice

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


# Settings of an inference run, without heavy imports.

Device = Literal["auto", "cpu", "cuda", "mps"]
OWN_TRACKER = "own"
LEAST_CONFIDENCE = 0.1
"""Minimum for a report. A tracked person may be hardly visible for a while, a new one may not."""


def default_threads() -> int:
    """Half of the cores, at most four: more gain little, and the console needs some.

    On two busy cores a second thread was measured to slow a frame down, since the threads wait for each other.
    """
    return max(1, min(4, (os.cpu_count() or 2) // 2))


class DetectorSettings(Value):
    """Detector settings of a scenario; picklable.

    ``things``: reported classes other than people. ``server`` is the address of a remote detector, empty for none;
    without ``other_computers`` it must be on this computer.
    """

    model: DetectorChoice = field(default_factory=DetectorChoice)
    device: Device = "auto"
    things: tuple[str, ...] = ()
    server: str = ""
    other_computers: bool = True


class InferenceSettings(Value):
    """Settings of an inference run; picklable.

    ``weights_path`` is the user's file, None for ``detector``, which may have to be downloaded: the search runs in the
    process. ``recognise_appearance``: re-identify people with an appearance network next to the detector or in a models
    folder, if there is one. Of the trackers, ``own`` is :mod:`caris_desktop.perception.kalman_tracker`; the others
    are for comparison. ``max_hz`` limits the frame rate, ``max_load`` the busy fraction, so that a slow model leaves
    CPU time to others. ``niceness`` is added to the process's own (where supported). ``face_model`` is the study's face
    network, if any, used for requests with ``faces``.
    """

    weights_path: Path | None = None
    detector: DetectorSettings = field(default_factory=DetectorSettings)
    recognise_appearance: bool = True
    allow_download: bool = True
    tracker: str = OWN_TRACKER
    confidence: float = LEAST_CONFIDENCE
    max_hz: float = 30.0
    max_load: float = 0.8
    threads: int = field(default_factory=default_threads)
    niceness: int = 10
    face_model: Path | None = None
    plugins_off: tuple[Plugin, ...] = ()
