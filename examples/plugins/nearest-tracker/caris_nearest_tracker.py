"""Tracker for CARIS Desktop: each box belongs to the nearest person of the last picture."""

import numpy as np

SURE = 0.5
LOST_S = 1.0


class NearestTracker:
    """Tracker of one camera; the contract is ``caris_desktop.perception.tracker_plugins.Tracker``."""

    caris_interface = 1

    def __init__(self, *, appearance):
        self._people = {}  # number: (centre of the box, height, when seen)
        self._last_number = 0

    def follow(self, corners_px, confidences, frame):
        self._forget(frame.stamp_s)
        centres = (corners_px[:, :2] + corners_px[:, 2:]) / 2
        heights = corners_px[:, 3] - corners_px[:, 1]
        # The surest box chooses first.
        rows = [row for row in np.argsort(-confidences) if confidences[row] >= SURE]
        found, taken = [], set()
        for row in rows:
            number = self._nearest(centres[row] - frame.shift_px, heights[row], taken)
            if number is None:
                self._last_number += 1
                number = self._last_number
            taken.add(number)
            self._people[number] = (centres[row], heights[row], frame.stamp_s)
            found.append((number, row))
        return found

    def _nearest(self, centre, height, taken):
        """Person within half of a box's height who is nearest and in no other box."""
        distances = {
            number: np.linalg.norm(centre - seen)
            for number, (seen, _, _) in self._people.items()
            if number not in taken
        }
        nearest = min(distances, key=distances.get, default=None)
        return nearest if nearest is not None and distances[nearest] < height / 2 else None

    def _forget(self, now_s):
        self._people = {number: each for number, each in self._people.items() if now_s - each[2] < LOST_S}
