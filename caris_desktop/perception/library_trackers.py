"""Ultralytics' trackers, for the boxes of any detector."""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

LibraryName = Literal["bytetrack", "botsort"]


class LibraryTracker:
    """Tracker of one camera. Track numbers count from 1 for each. ``with_looks``: it is given embeddings of all boxes,
    which BoT-SORT uses.
    """

    def __init__(self, name: LibraryName, *, with_looks: bool = False) -> None:
        from caris_desktop.perception.backends.ultralytics_setup import prepare_ultralytics

        prepare_ultralytics(threads=1)
        from ultralytics.trackers.track import TRACKER_MAP
        from ultralytics.utils import YAML, IterableSimpleNamespace
        from ultralytics.utils.checks import check_yaml

        settings = IterableSimpleNamespace(**YAML.load(check_yaml(f"{name}.yaml")))
        self.uses_looks = settings.with_reid = with_looks and name == "botsort"
        self._tracker: Any = TRACKER_MAP[name](settings)

    def follow(
        self,
        corners_px: NDArray[np.float64],
        confidences: NDArray[np.float64],
        image_bgr: NDArray[np.uint8],
        looks: NDArray[np.float64] | None = None,
    ) -> list[tuple[int, int]]:
        """Add the next frame; return the track number and row of each assigned box."""
        from ultralytics.engine.results import Boxes

        rows = np.column_stack([corners_px, confidences, np.zeros(len(confidences))]).astype(np.float32)
        boxes = Boxes(rows.reshape(-1, 6), image_bgr.shape[:2])
        found = self._tracker.update(boxes, image_bgr, None if looks is None else looks.astype(np.float32))
        return [(int(row[4]), int(row[7])) for row in found]
