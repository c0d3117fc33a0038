"""Interface of person trackers for plug-ins of the group ``caris_desktop.trackers``, and the built-in ones."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.perception.box_motion import Floats
from caris_desktop.perception.deep_sort import DeepSort
from caris_desktop.perception.kalman_tracker import CameraTracker


class TrackerFrame:
    """One picture of a camera, as a tracker gets it.

    ``image_bgr``: uint8, shape (height, width, 3), read-only. ``stamp_s``: when it was taken, in seconds that only
    grow. ``shift_px``: by how much everything has moved to the right and down since the camera's last picture because
    the robot or its head turned; zeros if unknown.
    """

    def __init__(
        self,
        image_bgr: NDArray[np.uint8],
        stamp_s: float,
        shift_px: tuple[float, float] = (0.0, 0.0),
        embedder: Callable[[Sequence[int]], Floats] | None = None,
    ) -> None:
        self.image_bgr = image_bgr
        self.stamp_s = stamp_s
        self.shift_px = shift_px
        self._embedder = embedder
        self.embeddings: dict[int, Floats] = {}
        """Computed so far, by the row of the box. People are recognised by them, so more are not better but dearer."""

    def embed(self, rows: Sequence[int]) -> Floats:
        """Appearance embeddings of unit length of the boxes in ``rows``: float64, shape (rows, dimensions).

        A few milliseconds a box. Raises RuntimeError without an appearance network.
        """
        if self._embedder is None:
            raise RuntimeError("there is no appearance network: the tracker was made with appearance=False")
        wanted = [row for row in dict.fromkeys(rows) if row not in self.embeddings]
        if wanted:
            self.embeddings |= dict(zip(wanted, self._embedder(wanted), strict=True))
        return np.array([self.embeddings[row] for row in rows], np.float64)


class Tracker(Protocol):
    """Tracker of one camera: a class with the attribute ``caris_interface = 1``, called as
    ``Tracker(appearance=True)`` if there is a network for appearance embeddings, else with False.

    One instance is made for each camera, in the process that detects people (the console's, or that of a command), and
    called in one thread of it, in the order of the camera's pictures, which come at 5 to 30 Hz with gaps. The process
    is not the window's, the robot link's or the recorder's: none of them waits for a tracker. People are shown and
    recorded once :meth:`follow` has returned: 10 ms are good, and after five seconds the process is ended. The first
    instance is made before the first picture, within a minute with the import.

    A tracker that raises, is too slow, prints, ends its process, or returns anything else than what is described here
    is switched off until the program is started again, and the wizard is told its name; the built-in tracker begins
    in its place. Log with :mod:`logging`.
    """

    caris_interface: ClassVar[int]

    def follow(self, corners_px: Floats, confidences: Floats, frame: TrackerFrame) -> list[tuple[int, int]]:
        """Add the next picture, and return ``(track number, row)`` for each box that belongs to a person now.

        ``corners_px`` is left, top, right, bottom of each box, float64 of shape (n, 4); ``confidences`` has shape (n,),
        from 0.1 to 1. There may be no box. Both are read-only.

        A track number is a whole number from 1 up, and that of one person while they are followed; another person never
        gets it. A row, from 0 to n-1, and a number occur once. Boxes in no pair are not shown: do not return a
        box before somebody is surely there.
        """
        ...


class OwnTracker:
    """Our tracker (:mod:`caris_desktop.perception.kalman_tracker`)."""

    caris_interface: ClassVar[int] = 1

    def __init__(self, *, appearance: bool) -> None:
        self._appearance = appearance
        self._tracker = CameraTracker()

    def follow(self, corners_px: Floats, confidences: Floats, frame: TrackerFrame) -> list[tuple[int, int]]:
        height_px, width_px = frame.image_bgr.shape[:2]
        found = self._tracker.follow(
            corners_px,
            confidences,
            frame.stamp_s,
            shift_px=frame.shift_px,
            picture_px=(width_px, height_px),
            appearance_of=frame.embed if self._appearance else None,
        )
        return [(each.number, each.box) for each in found]


class DeepSortTracker:
    """DeepSORT (:mod:`caris_desktop.perception.deep_sort`)."""

    caris_interface: ClassVar[int] = 1

    def __init__(self, *, appearance: bool) -> None:
        self._appearance = appearance
        self._tracker = DeepSort(itertools.count(1).__next__)

    def follow(self, corners_px: Floats, confidences: Floats, frame: TrackerFrame) -> list[tuple[int, int]]:
        found = self._tracker.follow(
            corners_px,
            confidences,
            frame.stamp_s,
            shift_px=frame.shift_px,
            appearance_of=frame.embed if self._appearance else None,
        )
        return [(each.number, each.box) for each in found]


class _UltralyticsTracker:
    """Ultralytics' trackers, for the boxes of any detector. BoT-SORT uses appearance embeddings."""

    caris_interface: ClassVar[int] = 1
    name: ClassVar[Literal["bytetrack", "botsort"]]

    def __init__(self, *, appearance: bool) -> None:
        from caris_desktop.perception.backends.ultralytics_setup import prepare_ultralytics

        prepare_ultralytics(threads=1)
        from ultralytics.trackers.track import TRACKER_MAP
        from ultralytics.utils import YAML, IterableSimpleNamespace
        from ultralytics.utils.checks import check_yaml

        settings = IterableSimpleNamespace(**YAML.load(check_yaml(f"{self.name}.yaml")))
        self._appearance = settings.with_reid = appearance and self.name == "botsort"
        self._tracker: Any = TRACKER_MAP[self.name](settings)

    def follow(self, corners_px: Floats, confidences: Floats, frame: TrackerFrame) -> list[tuple[int, int]]:
        from ultralytics.engine.results import Boxes

        rows = np.column_stack([corners_px, confidences, np.zeros(len(confidences))]).astype(np.float32)
        boxes = Boxes(rows.reshape(-1, 6), frame.image_bgr.shape[:2])
        embeddings = None
        if self._appearance and len(corners_px):
            embeddings = frame.embed(range(len(corners_px))).astype(np.float32)
        found = self._tracker.update(boxes, frame.image_bgr, embeddings)
        return [(int(row[4]), int(row[7])) for row in found]


class ByteTrack(_UltralyticsTracker):
    name = "bytetrack"


class BotSort(_UltralyticsTracker):
    name = "botsort"
