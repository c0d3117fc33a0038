"""Thumbnail cache of a replay: few requests at a time, with a signal on arrival."""

import time
from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QObject, QTimer, Signal
from PySide6.QtGui import QImage

from caris_desktop.live.wizard_console import ReplayControls

KEPT = 400
_AT_ONCE = 3
_GIVE_UP_S = 1.0

Moment = tuple[str, int]
"""Camera and session clock in ns."""


class Thumbnails(QObject):
    """Thumbnail cache; ``made`` reports a new image.

    Few requests are in flight, so that after fast scrolling only thumbnails that are still needed are made: the pointed
    one first, then visible ones. A time without an image gets no answer; its request times out after a second.
    """

    made = Signal(str, object)  # camera, at_ns

    def __init__(self, replay: ReplayControls, parent: QObject) -> None:
        super().__init__(parent)
        self._replay = replay
        self._cache: OrderedDict[Moment, QImage] = OrderedDict()
        self._first: Moment | None = None
        self._visible: list[Moment] = []
        self._requested: dict[Moment, float] = {}
        self._given_up: set[Moment] = set()
        self._patience = QTimer(self, interval=round(_GIVE_UP_S * 500))
        self._patience.timeout.connect(self._give_up)
        replay.thumbnail_made.connect(self._on_made)

    def picture(self, camera: str, at_ns: int) -> QImage | None:
        """The thumbnail if cached; a null image if there was none."""
        moment = (camera, at_ns)
        found = self._cache.get(moment)
        if found is not None:
            self._cache.move_to_end(moment)
        return found

    def want(self, camera: str, at_ns: int) -> None:
        """Request next, before visible ones."""
        self._first = (camera, at_ns)
        self._ask()

    def want_shown(self, moments: Sequence[Moment]) -> None:
        """Set the visible thumbnails, replacing the former ones."""
        self._visible = [moment for moment in moments if moment not in self._cache]
        self._ask()

    def _ask(self) -> None:
        waiting = [self._first, *self._visible] if self._first is not None else self._visible
        for moment in waiting:
            if len(self._requested) >= _AT_ONCE and moment is not self._first:
                break
            if moment is None or moment in self._cache or moment in self._given_up or moment in self._requested:
                continue
            self._requested[moment] = time.monotonic()
            self._replay.request_thumbnail(*moment)
        if self._requested and not self._patience.isActive():
            self._patience.start()

    def _on_made(self, camera: str, at_ns: int, image_bgr: NDArray[np.uint8] | None) -> None:
        moment = (camera, int(at_ns))
        self._cache[moment] = _as_image(image_bgr)
        while len(self._cache) > KEPT:
            self._cache.popitem(last=False)
        self._given_up.discard(moment)
        if moment in self._visible:
            self._visible.remove(moment)
        self._requested.pop(moment, None)
        self.made.emit(*moment)
        self._ask()

    def _give_up(self) -> None:
        now_s = time.monotonic()
        late = {moment for moment, requested_s in self._requested.items() if now_s - requested_s > _GIVE_UP_S}
        self._given_up |= late
        self._requested = {moment: requested_s for moment, requested_s in self._requested.items() if moment not in late}
        self._ask()
        if not self._requested:
            self._patience.stop()


def _as_image(image_bgr: NDArray[np.uint8] | None) -> QImage:
    if image_bgr is None or not image_bgr.size:
        return QImage()
    height, width = image_bgr.shape[:2]
    rows = np.ascontiguousarray(image_bgr)
    # QImage does not copy the array, which may be freed.
    return QImage(rows.data, width, height, 3 * width, QImage.Format.Format_BGR888).copy()
