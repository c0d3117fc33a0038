"""Timeline geometry: hit testing, snapping and dragging."""

from dataclasses import replace
from typing import Literal

import numpy as np
from PySide6.QtCore import QPointF, QRectF

from caris_desktop.domain.translation import tr, tr_filled
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation.annotation_model import Annotation
from caris_desktop.ui.replay.timeline_drawing import NAMES_PX, PAD_PX, RULER_PX, TimelineState
from caris_desktop.ui.replay.timeline_model import (
    SHORTEST_MS,
    Track,
    exact_text,
    length_text,
    snapped,
    vocabulary_title,
)

_SNAP_PX = 6
_EDGE_PX = 6

Part = Literal["corner", "names", "ruler", "row", "below"]
DragKind = Literal["create", "move", "start", "end", "seek", "pan", "row"]


class Hit(Value):
    """Item under a point."""

    part: Part
    row: int = -1
    annotation: Annotation | None = None
    edge: Literal["", "start", "end"] = ""


class Drag(Value):
    """Mouse drag. ``moving`` once it exceeds the distance of a click."""

    kind: DragKind
    origin: QPointF
    origin_ms: float
    row: int = -1
    annotation: Annotation | None = None
    start_ms: float = 0.0
    end_ms: float = 0.0
    target: int = -1
    moving: bool = False


class TimelineGeometry:
    """Read-only geometry of ``shown``."""

    def __init__(self, state: TimelineState) -> None:
        self._state = state

    def index_of(self, key: str) -> int | None:
        return next((number for number, row in enumerate(self._state.rows) if row.key == key), None)

    def find(self, annotation_id: str) -> Annotation | None:
        return next(
            (
                item
                for track in self._state.tracks.values()
                for item in track.annotations
                if item.annotation_id == annotation_id
            ),
            None,
        )

    def rect_of(self, annotation: Annotation) -> QRectF | None:
        """Rectangle of an annotation; None if its row is hidden."""
        for index, row in enumerate(self._state.rows):
            if row.tier is not None and row.tier.tier_id == annotation.tier_id:
                return self.interval_rect(index, annotation.start_ms, annotation.end_ms)
        return None

    def interval_rect(self, index: int, start_ms: float, end_ms: float) -> QRectF:
        left, right = self._state.scale.to_px(start_ms), self._state.scale.to_px(end_ms)
        top = self._state.row_top(index) + PAD_PX
        return QRectF(NAMES_PX + left, top, max(2.0, right - left), self._state.rows[index].height_px - 2 * PAD_PX)

    def hit(self, point: QPointF) -> Hit:
        if point.y() < RULER_PX:
            return Hit("ruler" if point.x() >= NAMES_PX else "corner")
        y = point.y() - RULER_PX + self._state.scroll_y
        index = int(np.searchsorted(self._state.tops, y, "right")) - 1
        if not 0 <= index < len(self._state.rows):
            return Hit("below")
        if point.x() < NAMES_PX:
            return Hit("names", index)
        row = self._state.rows[index]
        if row.kind != "tier":
            return Hit("row", index)
        at_ms = self._state.scale.to_ms(point.x() - NAMES_PX)
        track = self._state.track_of(row)
        found = track.at(at_ms)
        if found is None:
            near_ms = 3 / self._state.scale.px_per_ms
            found = track.at(at_ms - near_ms) or track.at(at_ms + near_ms)
            if found is None:
                return Hit("row", index)
        if not row.own:
            return Hit("row", index, found)
        left, right = self._state.scale.to_px(found.start_ms), self._state.scale.to_px(found.end_ms)
        x, zone = point.x() - NAMES_PX, min(_EDGE_PX, (right - left) / 3)
        if x <= left + zone:
            return Hit("row", index, found, "start")
        return Hit("row", index, found, "end" if x >= right - zone else "")

    def tip_at(self, point: QPointF) -> str:
        """Full text of the item under the point."""
        hit = self.hit(point)
        if hit.annotation is not None:
            item = hit.annotation
            times = tr("{start} to {end}").format(start=exact_text(item.start_ms), end=exact_text(item.end_ms))
            line = f"{times} · {length_text(item.end_ms - item.start_ms)}"
            label = tr_filled(item.value) or tr("No label yet")
            return f"{label}\n{line}"
        if hit.part == "names":
            row = self._state.rows[hit.row]
            if not row.own:
                return tr("{row}, from the recording").format(row=row.name)
            vocabulary = vocabulary_title(row.tier.vocabulary) if row.tier is not None else ""
            words = tr("{tier} of {coder} · free text")
            if vocabulary:
                words = tr("{tier} of {coder} · labels of {vocabulary}")
            return words.format(tier=row.name, coder=row.coder, vocabulary=vocabulary)
        return ""

    def row_slot(self, y: float) -> int:
        """Insertion index of a dragged row."""
        inside = y - RULER_PX + self._state.scroll_y
        middles = [(top + bottom) / 2 for top, bottom in zip(self._state.tops, self._state.tops[1:], strict=False)]
        return sum(1 for middle in middles if inside > middle)

    def ms_at(self, point: QPointF) -> float:
        return self._state.scale.to_ms(point.x() - NAMES_PX)

    def bounded(self, at_ms: float) -> float:
        return min(max(0.0, at_ms), self._state.duration_ms)

    def snap(self, at_ms: float, row: int, *, without: Annotation | None = None) -> float:
        """Snap to the playhead or to the edges of annotations in the row."""
        reach_ms = _SNAP_PX / self._state.scale.px_per_ms
        track = self._state.track_of(self._state.rows[row])
        moments = [self._state.position_ms]
        for index in track.between(at_ms - reach_ms - 1, at_ms + reach_ms + 1):
            item = track.annotations[index]
            if without is None or item.annotation_id != without.annotation_id:
                moments += [item.start_ms, item.end_ms]
        return snapped(at_ms, moments, within_ms=reach_ms)

    def dragged(self, drag: Drag, point: QPointF, at_ms: float) -> Drag:
        """The drag with its new or changed annotation."""
        track, item = self._state.track_of(self._state.rows[drag.row]), drag.annotation
        if drag.kind == "create":
            anchor_ms = self.snap(drag.origin_ms, drag.row)
            other_ms = self.bounded(self.snap(at_ms, drag.row))
            before, after = self._free_around(track, anchor_ms)
            low, high = min(anchor_ms, other_ms), max(anchor_ms, other_ms)
            return replace(drag, start_ms=max(low, before), end_ms=min(high, after))
        if item is None:
            return drag
        moved_ms = at_ms - drag.origin_ms
        if drag.kind == "move":
            length = item.end_ms - item.start_ms
            start_ms = self.snap(item.start_ms + moved_ms, drag.row, without=item)
            if start_ms == item.start_ms + moved_ms:
                start_ms = self.snap(item.end_ms + moved_ms, drag.row, without=item) - length
            start_ms = min(max(0.0, start_ms), self._state.duration_ms - length)
            return replace(drag, start_ms=start_ms, end_ms=start_ms + length, target=self._target_row(drag, point))
        edge_ms = self.bounded(
            self.snap((item.start_ms if drag.kind == "start" else item.end_ms) + moved_ms, drag.row, without=item)
        )
        before, after = self._free_around(track, (item.start_ms + item.end_ms) / 2, without=item)
        if drag.kind == "start":
            return replace(drag, start_ms=min(max(edge_ms, before), item.end_ms - SHORTEST_MS))
        return replace(drag, end_ms=max(min(edge_ms, after), item.start_ms + SHORTEST_MS))

    def _target_row(self, drag: Drag, point: QPointF) -> int:
        """Target row of a dragged annotation: another tier of the same coder, or its own."""
        under = self.hit(QPointF(NAMES_PX + 1, point.y())).row
        if (
            under >= 0
            and self._state.rows[under].own
            and self._state.rows[under].coder == self._state.rows[drag.row].coder
        ):
            return under
        return drag.row

    def _free_around(self, track: Track, at_ms: float, *, without: Annotation | None = None) -> tuple[float, float]:
        """Free interval around a time."""
        items = track.annotations
        index = int(np.searchsorted(track.starts_ms, at_ms, "left"))
        skip = "" if without is None else without.annotation_id
        earlier = next((items[n] for n in range(index - 1, -1, -1) if items[n].annotation_id != skip), None)
        later = next((items[n] for n in range(index, len(items)) if items[n].annotation_id != skip), None)
        return (
            0.0 if earlier is None else float(earlier.end_ms),
            self._state.duration_ms if later is None else float(later.start_ms),
        )

    def overlaps(self, drag: Drag) -> bool:
        if drag.kind != "move" or drag.annotation is None:
            return False
        track = self._state.track_of(self._state.rows[drag.target])
        return any(
            track.annotations[index].annotation_id != drag.annotation.annotation_id
            and track.annotations[index].end_ms > round(drag.start_ms)
            and track.annotations[index].start_ms < round(drag.end_ms)
            for index in track.between(drag.start_ms, drag.end_ms)
        )
