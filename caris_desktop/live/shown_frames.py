"""The pictures as the window gets them: where the scenario says so, with people covered there too."""

import threading
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.ports import FrameReader
from caris_desktop.domain.sensing import FrameRef, People
from caris_desktop.live.state import LiveState
from caris_desktop.people.presence import PersonRow
from caris_desktop.perception import blur
from caris_desktop.recording.recorder.blurring import NEAR_NS, parts_at
from caris_desktop.recording.recorder.messages import BlurDemand
from caris_desktop.scenario.model import Scenario

_SEEN_WITHIN_NS = 500_000_000
"""Nobody waits for the picture on show, so its people are where they were seen last and probably went since; after
this long nobody knows, and the whole picture is covered."""
_KEPT_LOOKS = 12


class ShownFrames:
    """Reads frames for the GUI thread. What is kept goes another way, and waits to know more."""

    def __init__(self, frames: FrameReader, state: LiveState) -> None:
        self._frames = frames
        self._demand: BlurDemand | None = None
        self._consenting: frozenset[str] = frozenset()
        self._looks: dict[str, deque[People]] = {}
        self._lock = threading.Lock()
        state.scenario.changed.connect(self._on_scenario_changed)
        state.persons.changed.connect(self._on_persons_changed)
        self._on_scenario_changed(state.scenario.value)

    def take(self, people: People, _raw: Any = None) -> None:
        """Who is in a frame. Any thread."""
        if self._demand is not None:
            with self._lock:
                self._looks.setdefault(people.camera, deque(maxlen=_KEPT_LOOKS)).append(people)

    def read(self, ref: FrameRef) -> NDArray[np.uint8] | None:
        image_bgr = self._frames.read(ref)
        demand = self._demand
        if image_bgr is None or demand is None:
            return image_bgr
        with self._lock:
            looks = [each for each in self._looks.get(ref.camera, ()) if abs(ref.stamp_ns - each.stamp_ns) <= NEAR_NS]
        if looks and ref.stamp_ns - looks[-1].stamp_ns <= _SEEN_WITHIN_NS:
            blur.cover(image_bgr, parts_at(ref.stamp_ns, looks, demand, self._consenting, blur), demand.what)
        else:
            blur.cover_all(image_bgr)
        return image_bgr

    def _on_scenario_changed(self, scenario: Scenario | None) -> None:
        wanted = None if scenario is None else scenario.blur
        demanded = wanted is not None and wanted.shown and wanted.who != "nobody"
        self._demand = BlurDemand(wanted.who, wanted.what) if wanted is not None and demanded else None

    def _on_persons_changed(self, persons: tuple[PersonRow, ...]) -> None:
        self._consenting = frozenset(person.person_id for person in persons if "video" in person.consents)
