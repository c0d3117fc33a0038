"""Video of a recorded session, decoded in background threads."""

import logging
import threading
from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.ports import FrameReader
from caris_desktop.domain.sensing import FrameRef, People
from caris_desktop.live.state import LiveState
from caris_desktop.people.presence import PersonRow
from caris_desktop.perception import blur
from caris_desktop.recording.recorder.blurring import NEAR_NS, parts_at
from caris_desktop.recording.recorder.recorder_messages import BlurDemand
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.scenario.scenario_model import Scenario

_log = logging.getLogger(__name__)
_MAX_FRAMES = 12
KEY_FRAMES_FROM_RATE = 3.0
THUMBNAIL_WIDTH_PX = 160
_MOST_THUMBNAILS = 200
R = TypeVar("R")
_PICTURE_HOLDS_NS = 2_000_000_000
_EMPTY: NDArray[np.uint8] = np.zeros((0, 0, 3), np.uint8)


class ReplayFrames:
    """FrameReader of a replay: cache of the last decoded frames."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._images: OrderedDict[tuple[str, int], NDArray[np.uint8]] = OrderedDict()

    def add(self, ref: FrameRef, image_bgr: NDArray[np.uint8]) -> None:
        with self._lock:
            self._images[(ref.camera, ref.sequence)] = image_bgr
            while len(self._images) > _MAX_FRAMES:
                self._images.popitem(last=False)

    def read(self, ref: FrameRef) -> NDArray[np.uint8] | None:
        with self._lock:
            return self._images.get((ref.camera, ref.sequence))


class ReplayVideo:
    """Decodes the newest requested frame of each camera, with a thread per camera.

    ``shown(generation, ref)`` is called in that thread.
    """

    def __init__(self, session: Session, frames: ReplayFrames, on_frame: Callable[[int, FrameRef], None]) -> None:
        self._session = session
        self._frames = frames
        self._on_frame = on_frame
        self._decoders: dict[str, _VideoThread[tuple[int, FrameRef, bool]]] = {}
        self._closed = False

    def show(self, generation: int, ref: FrameRef, *, nearest_key: bool = False) -> None:
        """Request a frame. ``nearest_key`` decodes key frames only: for high rates and thumbnails. GUI thread."""
        if self._closed:
            return
        if ref.camera not in self._decoders:
            self._decoders[ref.camera] = _VideoThread(self._session, "replay-video", self._decode, 1)
            self._decoders[ref.camera].start()
        self._decoders[ref.camera].request(None, (generation, ref, nearest_key))

    def _decode(self, reader: VideoReader, request: tuple[int, FrameRef, bool]) -> None:
        generation, ref, nearest_key = request
        try:
            picture = reader.frame_at(ref.camera, ref.stamp_ns, nearest_key=nearest_key)
        except Exception:
            _log.exception("the video of %s cannot be read", ref.camera)
            return
        if picture is not None:
            self._frames.add(ref, picture.image_bgr)
            self._on_frame(generation, ref)

    def close(self) -> None:
        self._closed = True
        for decoder in self._decoders.values():
            decoder.close()


class _VideoThread(Generic[R]):
    """Thread with a video reader of its own, which answers the newest request of each key first."""

    def __init__(self, session: Session, name: str, answer: Callable[[VideoReader, R], None], at_most: int) -> None:
        self._session = session
        self._answer = answer
        self._at_most = at_most
        self._changed = threading.Condition()
        self._pending: OrderedDict[Any, R] = OrderedDict()
        self._ended = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self.start = self._thread.start

    def request(self, key: Any, request: R) -> None:
        with self._changed:
            self._pending[key] = request
            self._pending.move_to_end(key)
            while len(self._pending) > self._at_most:
                self._pending.popitem(last=False)
            self._changed.notify()

    def close(self) -> None:
        with self._changed:
            self._ended = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join(5.0)

    def _run(self) -> None:
        reader = VideoReader(self._session)
        try:
            while True:
                with self._changed:
                    while not self._pending and not self._ended:
                        self._changed.wait()
                    if self._ended:
                        return
                    request = self._pending.popitem(last=True)[1]
                self._answer(reader, request)
        finally:
            reader.close()


class ReplayThumbnails:
    """Thumbnails, newest request first. ``made(camera, at_ns, image_bgr)`` is called in a thread; the image is empty
    if there is none.
    """

    def __init__(self, session: Session, made: Callable[[str, int, NDArray[np.uint8]], None]) -> None:
        self._made = made
        self._thread = _VideoThread(session, "replay-thumbnails", self._make, _MOST_THUMBNAILS)
        self.start, self.close = self._thread.start, self._thread.close

    def request(self, camera: str, at_ns: int) -> None:
        self._thread.request((camera, at_ns), (camera, at_ns))

    def _make(self, reader: VideoReader, place: tuple[str, int]) -> None:
        camera, at_ns = place
        try:
            found = reader.info_at(camera, at_ns)
            # No image long after a frame, as in a pause or after the end of the video.
            there = found is not None and at_ns - found.stamp_ns < _PICTURE_HOLDS_NS
            image_bgr = reader.thumbnail(camera, at_ns, THUMBNAIL_WIDTH_PX) if there else None
        except Exception:
            _log.exception("a thumbnail of %s cannot be made", camera)
            image_bgr = None
        self._made(camera, at_ns, _EMPTY if image_bgr is None else image_bgr)


# Frames for the window, blurred if the scenario requires it; and for a language model, blurred as in recordings.

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
        self._given = self._shown = None
        if scenario is not None and scenario.blur.who != "nobody":
            self._given = BlurDemand(scenario.blur.who, scenario.blur.what)
            self._shown = self._given if scenario.blur.shown else None

    def _on_persons_changed(self, persons: tuple[PersonRow, ...]) -> None:
        self._visible_people = frozenset(person.person_id for person in persons if "video" in person.consents)
        self._to_be_given = frozenset(person.person_id for person in persons if "photo" in person.consents)
