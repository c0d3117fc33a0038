"""Person trackers of several cameras, with our tracker or ultralytics', for the boxes of any detector."""

import itertools
from collections.abc import Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.value_class import dataclass
from caris_desktop.perception.appearance_embedding import AppearanceModel
from caris_desktop.perception.box_motion import overlaps
from caris_desktop.perception.deep_sort import DeepSort
from caris_desktop.perception.detector import Detections
from caris_desktop.perception.inference_messages import DetectionRequest
from caris_desktop.perception.inference_settings import TrackerName
from caris_desktop.perception.kalman_tracker import AppearanceOf, CameraTracker, Followed, view_qualities
from caris_desktop.perception.library_trackers import LibraryName, LibraryTracker

_SAME_PERSON = 0.7


@dataclass(frozen=True, slots=True)
class TrackedBox:
    """One person in one frame; ``track`` is constant while the person is tracked.

    ``detection`` is the row of the detection. ``quality`` is the view quality, 0..1, and ``looks`` the embedding of
    unit length, if computed in this frame.
    """

    track: int
    left_px: float
    top_px: float
    width_px: float
    height_px: float
    confidence: float
    detection: int
    quality: float = 0.0
    looks: NDArray[np.float64] | None = field(default=None, compare=False)


class PersonTracker:
    """One tracker for each camera. For one thread.

    Track numbers start at 1 and are unique across cameras. ``person_classes`` are the class rows that mean a person.
    Without ``appearance``, tracks are matched by motion alone.
    """

    def __init__(
        self, person_classes: Sequence[int], *, tracker: TrackerName, appearance: AppearanceModel | None = None
    ) -> None:
        self._person_classes = tuple(person_classes)
        self._tracker = tracker
        self._appearance = appearance
        self._theirs: dict[str, LibraryTracker] = {}
        self._ours: dict[str, _Followed] = {}
        self._numbers: dict[tuple[str, int], int] = {}
        self._new_number = itertools.count(1).__next__
        if tracker == "bytetrack" or tracker == "botsort":  # noqa: PLR1714 - mypy narrows only so
            LibraryTracker(tracker)  # load the library before the first frame, since it takes seconds

    def track(self, detections: Detections, image_bgr: NDArray[np.uint8], look: DetectionRequest) -> list[TrackedBox]:
        """Tracked people among the detections in the next frame of a camera: uint8 BGR, shape (height, width, 3)."""
        rows = _people(detections, self._person_classes)
        corners_px, confidences = detections.corners_px[rows], detections.confidences[rows]
        if self._tracker == "own" or self._tracker == "deepsort":  # noqa: PLR1714 - mypy narrows only so
            camera = look.frame.camera
            if camera not in self._ours:
                kind = CameraTracker if self._tracker == "own" else DeepSort
                self._ours[camera] = _Followed(kind(self._new_number))
            appearance_of = self._embeddings_in(image_bgr, corners_px)
            found = self._ours[camera].follow(corners_px, confidences, look, appearance_of)
        else:
            found = self._follow_with(self._tracker, corners_px, confidences, image_bgr, look.frame.camera)
        qualities = view_qualities(corners_px, confidences, _size_px(look.frame))
        tracked = []
        for each in found:
            left, top, right, bottom = corners_px[each.box].tolist()
            tracked.append(
                TrackedBox(
                    each.number,
                    left,
                    top,
                    right - left,
                    bottom - top,
                    float(confidences[each.box]),
                    int(rows[each.box]),
                    float(qualities[each.box]),
                    each.looks,
                )
            )
        return tracked

    def _embeddings_in(self, image_bgr: NDArray[np.uint8], corners_px: NDArray[np.float64]) -> AppearanceOf | None:
        appearance = self._appearance
        if appearance is None:
            return None
        return lambda boxes: appearance.embed(image_bgr, [corners_px[box] for box in boxes])

    def _follow_with(
        self,
        name: LibraryName,
        corners_px: NDArray[np.float64],
        confidences: NDArray[np.float64],
        image_bgr: NDArray[np.uint8],
        camera: str,
    ) -> list[Followed]:
        theirs = self._theirs.pop(camera, None) or LibraryTracker(name, with_looks=self._appearance is not None)
        self._theirs[camera] = theirs
        looks = None
        if theirs.uses_looks and self._appearance is not None and len(corners_px):
            looks = self._appearance.embed(image_bgr, list(corners_px))
        found = theirs.follow(corners_px, confidences, image_bgr, looks)
        return [
            Followed(self._numbers.setdefault((camera, number), len(self._numbers) + 1), row) for number, row in found
        ]


@dataclass(slots=True)
class _Followed:
    """Our tracker for one camera, and the camera's last direction."""

    follower: CameraTracker | DeepSort
    looked: tuple[float, float] | None = None

    def follow(
        self,
        corners_px: NDArray[np.float64],
        confidences: NDArray[np.float64],
        look: DetectionRequest,
        appearance_of: AppearanceOf | None,
    ) -> list[Followed]:
        stamp_s, shift_px = look.frame.shown_ns / 1e9, self._shift_px(look)
        if isinstance(self.follower, DeepSort):
            return self.follower.follow(
                corners_px, confidences, stamp_s, shift_px=shift_px, appearance_of=appearance_of
            )
        return self.follower.follow(
            corners_px,
            confidences,
            stamp_s,
            shift_px=shift_px,
            picture_px=_size_px(look.frame),
            appearance_of=appearance_of,
        )

    def _shift_px(self, look: DetectionRequest) -> tuple[float, float]:
        """Image shift by the camera's rotation since the last frame; for small angles, in pixels."""
        before, self.looked = self.looked, look.looked
        if before is None or look.looked is None:
            return 0.0, 0.0
        focal_px = look.focal_per_width * look.frame.width_px
        return focal_px * (look.looked[0] - before[0]), focal_px * (before[1] - look.looked[1])


def _size_px(frame: FrameRef) -> tuple[float, float]:
    return float(frame.width_px), float(frame.height_px)


def _people(detections: Detections, classes: Sequence[int]) -> NDArray[np.int64]:
    """Rows of the people, without duplicates from several person classes."""
    has_size = (detections.corners_px[:, 2:] > detections.corners_px[:, :2]).all(axis=1)
    rows = np.flatnonzero(np.isin(detections.classes, classes) & has_size)
    if len(classes) < 2 or len(rows) < 2:
        return rows
    surest_first = rows[np.argsort(-detections.confidences[rows], kind="stable")]
    together = overlaps(detections.corners_px[surest_first], detections.corners_px[surest_first])
    kept: list[int] = []
    for each in range(len(surest_first)):
        if not kept or together[each, kept].max() <= _SAME_PERSON:
            kept.append(each)
    return surest_first[kept]
