"""Frames for the window, blurred if the scenario requires it; and for a language model, blurred as in recordings."""

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
from caris_desktop.recording.recorder.recorder_messages import BlurDemand
from caris_desktop.scenario.scenario_model import Scenario

_BOXES_WITHIN_NS = 500_000_000
"""Blur at the last known positions, as a live frame cannot wait for its detection; after this time positions are
unknown and the whole frame is blurred.
"""
_MAX_DETECTIONS = 12


class DisplayFrames:
    """FrameReader for the GUI thread. Recordings are blurred elsewhere, with complete detections."""

    def __init__(self, frames: FrameReader, state: LiveState) -> None:
        self._frames = frames
        self._shown: BlurDemand | None = None
        self._given: BlurDemand | None = None
        self._visible_people: frozenset[str] = frozenset()
        self._to_be_given: frozenset[str] = frozenset()
        self._detections: dict[str, deque[People]] = {}
        self._lock = threading.Lock()
        state.scenario.changed.connect(self._on_scenario_changed)
        state.persons.changed.connect(self._on_persons_changed)
        self._on_scenario_changed(state.scenario.value)

    def add(self, people: People, _raw: Any = None) -> None:
        """Add detected people of a frame. Any thread."""
        if self._given is not None:
            with self._lock:
                self._detections.setdefault(people.camera, deque(maxlen=_MAX_DETECTIONS)).append(people)

    def read(self, ref: FrameRef) -> NDArray[np.uint8] | None:
        return self._covered(ref, self._shown, self._visible_people)

    def read_to_give(self, ref: FrameRef) -> NDArray[np.uint8] | None:
        """Frame for use outside the window, as for a language model: people without photo consent are blurred if the
        scenario blurs recordings.
        """
        return self._covered(ref, self._given, self._to_be_given)

    def _covered(
        self, ref: FrameRef, demand: BlurDemand | None, consenting: frozenset[str]
    ) -> NDArray[np.uint8] | None:
        image_bgr = self._frames.read(ref)
        if image_bgr is None or demand is None:
            return image_bgr
        with self._lock:
            detections = [
                each for each in self._detections.get(ref.camera, ()) if abs(ref.stamp_ns - each.stamp_ns) <= NEAR_NS
            ]
        if detections and ref.stamp_ns - detections[-1].stamp_ns <= _BOXES_WITHIN_NS:
            blur.cover(image_bgr, parts_at(ref.stamp_ns, detections, demand, consenting, blur), demand.what)
        else:
            blur.cover_all(image_bgr)
        return image_bgr

    def _on_scenario_changed(self, scenario: Scenario | None) -> None:
        blur_settings = None if scenario is None else scenario.blur
        self._given = (
            BlurDemand(blur_settings.who, blur_settings.what)
            if blur_settings is not None and blur_settings.who != "nobody"
            else None
        )
        self._shown = self._given if blur_settings is not None and blur_settings.shown else None

    def _on_persons_changed(self, persons: tuple[PersonRow, ...]) -> None:
        self._visible_people = frozenset(person.person_id for person in persons if "video" in person.consents)
        self._to_be_given = frozenset(person.person_id for person in persons if "photo" in person.consents)
