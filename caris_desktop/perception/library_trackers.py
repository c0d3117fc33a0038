"""Ultralytics' trackers, fed with the boxes of whichever detector."""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

LibraryName = Literal["bytetrack", "botsort"]


class LibraryTracker:
    """One camera's. Numbers count from 1 for each."""

    def __init__(self, name: LibraryName) -> None:
        from caris_desktop.perception.backends.ultralytics_setup import prepare_ultralytics

        prepare_ultralytics(threads=1)
        from ultralytics.trackers.track import TRACKER_MAP
        from ultralytics.utils import YAML, IterableSimpleNamespace
        from ultralytics.utils.checks import check_yaml

        self._tracker: Any = TRACKER_MAP[name](IterableSimpleNamespace(**YAML.load(check_yaml(f"{name}.yaml"))))

    def follow(
        self, corners_px: NDArray[np.float64], confidences: NDArray[np.float64], image_bgr: NDArray[np.uint8]
    ) -> list[tuple[int, int]]:
        """Take in the next picture; number and row of each box that belongs to somebody."""
        from ultralytics.engine.results import Boxes

        rows = np.column_stack([corners_px, confidences, np.zeros(len(confidences))]).astype(np.float32)
        found = self._tracker.update(Boxes(rows.reshape(-1, 6), image_bgr.shape[:2]), image_bgr)
        return [(int(row[4]), int(row[7])) for row in found]
