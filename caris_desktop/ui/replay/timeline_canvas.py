"""The drawn part of the timeline: names, ruler and rows, and what the pointer does to them.

Everything that stays while the replay plays is drawn once into a layer; a moving playhead repaints a narrow stripe.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from PySide6.QtCore import QEvent, QPoint, QPointF, QRect, QRectF, QSize, Qt, Signal
from PySide6.QtGui import (
    QColor,
    QContextMenuEvent,
    QFocusEvent,
    QFontMetricsF,
    QHelpEvent,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPen,
    QPixmap,
    QPolygonF,
    QResizeEvent,
    QWheelEvent,
)
from PySide6.QtWidgets import QSizePolicy, QToolTip, QWidget

from caris_desktop.recording.annotation.model import Annotation
from caris_desktop.recording.annotation.overview import SessionOverview
from caris_desktop.ui import tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.replay.plain_tip import plain_tip
from caris_desktop.ui.replay.thumbnails import Thumbnails
from caris_desktop.ui.replay.timeline_drawing import (
    MENU_PX,
    NAMES_PX,
    PAD_PX,
    RULER_PX,
    TEXT_FROM_PX,
    Shown,
    TimelineDrawing,
)
from caris_desktop.ui.replay.timeline_model import (
    SHORTEST_MS,
    Row,
    TimeScale,
    Track,
    exact_text,
    length_text,
    snapped,
    whole_session,
)
from caris_desktop.ui.theme import Theme

_DRAG_PX = 4
_SNAP_PX = 6
_EDGE_PX = 6
_ZOOM_PER_NOTCH = 1.25

Part = Literal["corner", "names", "ruler", "row", "below"]
DragKind = Literal["create", "move", "start", "end", "seek", "pan", "row"]


@dataclass(frozen=True, slots=True)
class Hit:
    """What lies under a point."""

    part: Part
    row: int = -1
    annotation: Annotation | None = None
    edge: Literal["", "start", "end"] = ""


@dataclass(frozen=True, slots=True)
class Drag:
    """What the pointer is doing. ``moving`` once it went far enough to be no click."""

    kind: DragKind
    origin: QPointF
    origin_ms: float
    row: int = -1
    annotation: Annotation | None = None
    start_ms: float = 0.0
    end_ms: float = 0.0
    target: int = -1
    moving: bool = False


@dataclass(frozen=True, slots=True)
class OpenStretch:
    """A label that was begun by its key and goes on until it is pressed again."""

    tier_id: str
    value: str
    start_ms: int


class TimelineCanvas(QWidget):
    """Draws rows and tells what is wanted; holds no annotations of its own and changes none."""

    seek_wanted = Signal(float)  # milliseconds of the session
    create_wanted = Signal(str, int, int)  # tier, start and end in milliseconds
    move_wanted = Signal(str, int, int, str)  # annotation, start and end in milliseconds, tier
    rename_wanted = Signal(str)
    row_menu_wanted = Signal(str, QPoint)  # row, global position
    row_opened = Signal(str)
    row_moved = Signal(str, int)  # row, its place among the others on show
    selection_changed = Signal()
    view_changed = Signal()  # zoom or scroll

    def __init__(self, theme: Theme, thumbnails: Thumbnails) -> None:
        super().__init__()
        self.setObjectName("timeline_canvas")
        self.setAccessibleName("Timeline")
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setMouseTracking(True)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self._theme = theme
        self._thumbnails = thumbnails
        self._shown = Shown()
        self._drawing = TimelineDrawing(theme, thumbnails)
        self._fits = True
        self._position_ms = 0.0
        self._selected = ""
        self._selected_item: Annotation | None = None
        self._open: OpenStretch | None = None
        self._drag: Drag | None = None
        self._refused = False
        self._hover: Hit | None = None
        self._layer: QPixmap | None = None
        self._names: QPixmap | None = None
        thumbnails.made.connect(self._on_picture_made)
        theme.changed.connect(self._forget_everything)

    def sizeHint(self) -> QSize:
        return QSize(900, 240)

    def minimumSizeHint(self) -> QSize:
        return QSize(NAMES_PX + 160, RULER_PX + 32)

    # ---- what it shows

    def show_session(self, started_ns: int, duration_ms: float) -> None:
        self._shown.started_ns, self._shown.duration_ms = started_ns, max(1.0, duration_ms)
        self.set_scale(whole_session(self.room_px, self._shown.duration_ms) if self._fits else self.scale)

    def show_rows(self, rows: Sequence[Row], coders: Sequence[str], *, words: str = "") -> None:
        """The rows in their order; ``words`` stand where there are none."""
        self._shown.rows, self._shown.coders, self._shown.words = list(rows), coders, words
        self._shown.tops = [0]
        for row in self.rows:
            self._shown.tops.append(self._shown.tops[-1] + row.height_px)
        self.scroll_to(self._shown.scroll_y)
        self._forget_everything()

    def show_tracks(self, tracks: Mapping[str, Track]) -> None:
        """The annotations of each tier, by the key of its row."""
        self._shown.tracks = tracks
        if self._selected:
            self._selected_item = self._find(self._selected)
            if self._selected_item is None:
                self._selected = ""
            self.selection_changed.emit()
        self.forget_layer()

    def show_overview(self, overview: SessionOverview | None) -> None:
        self._shown.show_overview(overview)
        self._forget_everything()

    def show_position(self, position_ms: float, *, playing: bool) -> None:
        """Move the playhead. The view follows it over its edge, and to where somebody jumped."""
        before, self._position_ms = self._position_ms, position_ms
        was_visible = 0 <= self.scale.to_px(before) <= self.room_px
        x = self.scale.to_px(position_ms)
        if not 0 <= x <= self.room_px and self._drag is None:
            jumped = abs(position_ms - before) > 1500
            if playing and was_visible and not jumped:
                self.set_scale(replace(self.scale, start_ms=position_ms - 0.1 * self.room_px / self.scale.px_per_ms))
            elif jumped or was_visible:
                self.set_scale(replace(self.scale, start_ms=position_ms - 0.5 * self.room_px / self.scale.px_per_ms))
        if self._open is not None:
            self.update()
            return
        self.update(0, 0, NAMES_PX, RULER_PX)
        for at_ms in (before, position_ms):
            left = NAMES_PX + round(self.scale.to_px(at_ms))
            self.update(left - 8, 0, 16, self.height())

    def show_open(self, stretch: OpenStretch | None) -> None:
        self._open = stretch
        self.update()

    def forget_layer(self) -> None:
        """Something that stays has changed under the ruler: draw it again."""
        self._layer = None
        self.update()

    def _forget_everything(self) -> None:
        self._names = None
        self.forget_layer()

    @property
    def rows(self) -> Sequence[Row]:
        return self._shown.rows

    @property
    def scale(self) -> TimeScale:
        return self._shown.scale

    @property
    def room_px(self) -> int:
        """Width of the part under the ruler."""
        return self._shown.room_px

    @property
    def rows_height_px(self) -> int:
        return self._shown.tops[-1]

    @property
    def scroll_y(self) -> int:
        return self._shown.scroll_y

    def set_scale(self, scale: TimeScale) -> None:
        scale = scale.bounded(self.room_px, self._shown.duration_ms)
        self._fits = scale.px_per_ms <= whole_session(self.room_px, self._shown.duration_ms).px_per_ms * 1.0001
        if scale != self.scale:
            self._shown.scale = scale
            self.forget_layer()
        self.view_changed.emit()

    def zoom(self, factor: float, around_px: float | None = None) -> None:
        """Around a pixel of the rows; around the playhead, where it is in view, without one."""
        if around_px is None:
            playhead = self.scale.to_px(self._position_ms)
            around_px = playhead if 0 <= playhead <= self.room_px else self.room_px / 2
        self.set_scale(self.scale.zoomed(factor, around_px, width_px=self.room_px, duration_ms=self._shown.duration_ms))

    def fit(self) -> None:
        self.set_scale(whole_session(self.room_px, self._shown.duration_ms))

    def scroll_across_to(self, start_ms: float) -> None:
        """Let the visible part begin there."""
        self.set_scale(replace(self.scale, start_ms=start_ms))

    def scroll_to(self, y: int) -> None:
        y = min(max(0, y), max(0, self.rows_height_px - (self.height() - RULER_PX)))
        if y != self._shown.scroll_y:
            self._shown.scroll_y = y
            self._forget_everything()
        self.view_changed.emit()

    def show_row(self, key: str) -> None:
        """Scroll so that the row is in view."""
        index = self.index_of(key)
        if index is None:
            return
        top, bottom, room = self._shown.tops[index], self._shown.tops[index + 1], self.height() - RULER_PX
        if top < self._shown.scroll_y:
            self.scroll_to(top)
        elif bottom > self._shown.scroll_y + room:
            self.scroll_to(bottom - room)

    def show_stretch(self, start_ms: float, end_ms: float) -> None:
        """Scroll so that the stretch is in view."""
        if not 0 <= self.scale.to_px(start_ms) <= self.room_px - 40 or self.scale.to_px(end_ms) > self.room_px:
            self.set_scale(replace(self.scale, start_ms=start_ms - 0.2 * self.room_px / self.scale.px_per_ms))

    def index_of(self, key: str) -> int | None:
        return next((number for number, row in enumerate(self.rows) if row.key == key), None)

    # ---- what is chosen

    @property
    def selected(self) -> Annotation | None:
        return self._selected_item

    def select(self, annotation_id: str) -> None:
        if annotation_id != self._selected:
            self._selected_item = self._find(annotation_id) if annotation_id else None
            self._selected = "" if self._selected_item is None else annotation_id
            self.update()
            self.selection_changed.emit()

    def _find(self, annotation_id: str) -> Annotation | None:
        return next(
            (
                item
                for track in self._shown.tracks.values()
                for item in track.annotations
                if item.annotation_id == annotation_id
            ),
            None,
        )

    @property
    def active(self) -> Row | None:
        """The coder's tier that keys act on."""
        index = self.index_of(self._shown.active)
        return None if index is None else self.rows[index]

    def activate(self, key: str) -> None:
        if key != self._shown.active:
            self._shown.active = key
            self._forget_everything()
            self.selection_changed.emit()

    def track_of(self, row: Row) -> Track:
        return self._shown.track_of(row)

    def rect_of(self, annotation: Annotation) -> QRectF | None:
        """Where it is drawn; None where its row is not on show."""
        for index, row in enumerate(self.rows):
            if row.tier is not None and row.tier.tier_id == annotation.tier_id:
                return self._stretch_rect(index, annotation.start_ms, annotation.end_ms)
        return None

    def row_top(self, index: int) -> int:
        return self._shown.row_top(index)

    def _stretch_rect(self, index: int, start_ms: float, end_ms: float) -> QRectF:
        left, right = self.scale.to_px(start_ms), self.scale.to_px(end_ms)
        top = self.row_top(index) + PAD_PX
        return QRectF(NAMES_PX + left, top, max(2.0, right - left), self.rows[index].height_px - 2 * PAD_PX)

    # ---- what lies where

    def hit(self, point: QPointF) -> Hit:
        if point.y() < RULER_PX:
            return Hit("ruler" if point.x() >= NAMES_PX else "corner")
        y = point.y() - RULER_PX + self._shown.scroll_y
        index = int(np.searchsorted(self._shown.tops, y, "right")) - 1
        if not 0 <= index < len(self.rows):
            return Hit("below")
        if point.x() < NAMES_PX:
            return Hit("names", index)
        row = self.rows[index]
        if row.kind != "tier":
            return Hit("row", index)
        at_ms = self.scale.to_ms(point.x() - NAMES_PX)
        track = self.track_of(row)
        found = track.at(at_ms)
        if found is None:
            near_ms = 3 / self.scale.px_per_ms
            found = track.at(at_ms - near_ms) or track.at(at_ms + near_ms)
            if found is None:
                return Hit("row", index)
        if not row.own:
            return Hit("row", index, found)
        left, right = self.scale.to_px(found.start_ms), self.scale.to_px(found.end_ms)
        x, zone = point.x() - NAMES_PX, min(_EDGE_PX, (right - left) / 3)
        if x <= left + zone:
            return Hit("row", index, found, "start")
        return Hit("row", index, found, "end" if x >= right - zone else "")

    # ---- pointer

    def mousePressEvent(self, event: QMouseEvent) -> None:
        point = event.position()
        hit = self.hit(point)
        if event.button() == Qt.MouseButton.MiddleButton:
            self._drag = Drag("pan", point, self._ms_at(point), start_ms=self.scale.start_ms)
            return
        if event.button() != Qt.MouseButton.LeftButton or self._drag is not None:
            return
        at_ms = self._ms_at(point)
        if hit.part == "names":
            row = self.rows[hit.row]
            if row.own:
                self.activate(row.key)
            if point.x() >= NAMES_PX - MENU_PX:
                self.row_menu_wanted.emit(row.key, event.globalPosition().toPoint())
            else:
                self._drag = Drag("row", point, at_ms, hit.row, target=hit.row)
        elif hit.part == "row" and self.rows[hit.row].kind == "tier":
            if self.rows[hit.row].own:
                self.activate(self.rows[hit.row].key)
            self._press_tier(hit, point, at_ms)
        elif hit.part in ("ruler", "row", "below"):
            self._drag = Drag("seek", point, at_ms, moving=True)
            self.seek_wanted.emit(self._bounded(at_ms))

    def _press_tier(self, hit: Hit, point: QPointF, at_ms: float) -> None:
        item = hit.annotation
        if item is not None:
            self.select(item.annotation_id)
            if not self.rows[hit.row].own:
                self.seek_wanted.emit(float(item.start_ms))
                return
            kind: DragKind = "start" if hit.edge == "start" else "end" if hit.edge == "end" else "move"
            self._drag = Drag(kind, point, at_ms, hit.row, item, item.start_ms, item.end_ms, target=hit.row)
            return
        self.select("")
        if self.rows[hit.row].own:
            start_ms = self._snap(at_ms, hit.row)
            self._drag = Drag("create", point, at_ms, hit.row, None, start_ms, start_ms)
        else:
            self._drag = Drag("seek", point, at_ms, moving=True)
            self.seek_wanted.emit(self._bounded(at_ms))

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        point, drag = event.position(), self._drag
        if drag is None:
            self._hover_over(self.hit(point))
            return
        if not drag.moving and (point - drag.origin).manhattanLength() < _DRAG_PX:
            return
        if drag.kind not in ("pan", "row"):
            self._scroll_at_edge(point.x())
        at_ms = self._ms_at(point)
        match drag.kind:
            case "seek":
                self.seek_wanted.emit(self._bounded(at_ms))
            case "pan":
                moved_px = point.x() - drag.origin.x()
                self.set_scale(replace(self.scale, start_ms=drag.start_ms - moved_px / self.scale.px_per_ms))
            case "row":
                self._drag = replace(drag, moving=True, target=self._row_slot(point.y()))
                self.update()
            case _:
                self._drag = self._dragged(replace(drag, moving=True), point, at_ms)
                self._refused = self._overlaps(self._drag)
                self.update()

    def _scroll_at_edge(self, x: float) -> None:
        """Who drags over an edge of the rows sees on."""
        over = min(0.0, x - NAMES_PX) + max(0.0, x - (self.width() - 2))
        if over:
            self.scroll_across_to(self.scale.start_ms + min(40.0, max(-40.0, over)) / self.scale.px_per_ms)

    def _dragged(self, drag: Drag, point: QPointF, at_ms: float) -> Drag:
        """What a drag has made of a new or an existing annotation."""
        track, item = self.track_of(self.rows[drag.row]), drag.annotation
        if drag.kind == "create":
            anchor_ms = self._snap(drag.origin_ms, drag.row)
            other_ms = self._bounded(self._snap(at_ms, drag.row))
            before, after = self._free_around(track, anchor_ms)
            low, high = min(anchor_ms, other_ms), max(anchor_ms, other_ms)
            return replace(drag, start_ms=max(low, before), end_ms=min(high, after))
        if item is None:
            return drag
        moved_ms = at_ms - drag.origin_ms
        if drag.kind == "move":
            length = item.end_ms - item.start_ms
            start_ms = self._snap(item.start_ms + moved_ms, drag.row, without=item)
            if start_ms == item.start_ms + moved_ms:
                start_ms = self._snap(item.end_ms + moved_ms, drag.row, without=item) - length
            start_ms = min(max(0.0, start_ms), self._shown.duration_ms - length)
            return replace(drag, start_ms=start_ms, end_ms=start_ms + length, target=self._target_row(drag, point))
        edge_ms = self._bounded(
            self._snap((item.start_ms if drag.kind == "start" else item.end_ms) + moved_ms, drag.row, without=item)
        )
        before, after = self._free_around(track, (item.start_ms + item.end_ms) / 2, without=item)
        if drag.kind == "start":
            return replace(drag, start_ms=min(max(edge_ms, before), item.end_ms - SHORTEST_MS))
        return replace(drag, end_ms=max(min(edge_ms, after), item.start_ms + SHORTEST_MS))

    def _target_row(self, drag: Drag, point: QPointF) -> int:
        """The row that an annotation is dragged to: another tier of the same coder, or its own."""
        under = self.hit(QPointF(NAMES_PX + 1, point.y())).row
        if under >= 0 and self.rows[under].own and self.rows[under].coder == self.rows[drag.row].coder:
            return under
        return drag.row

    def _free_around(self, track: Track, at_ms: float, *, without: Annotation | None = None) -> tuple[float, float]:
        """How far the free room around a moment reaches."""
        items = track.annotations
        index = int(np.searchsorted(track.starts_ms, at_ms, "left"))
        skip = "" if without is None else without.annotation_id
        earlier = next((items[n] for n in range(index - 1, -1, -1) if items[n].annotation_id != skip), None)
        later = next((items[n] for n in range(index, len(items)) if items[n].annotation_id != skip), None)
        return (
            0.0 if earlier is None else float(earlier.end_ms),
            self._shown.duration_ms if later is None else float(later.start_ms),
        )

    def _overlaps(self, drag: Drag) -> bool:
        if drag.kind != "move" or drag.annotation is None:
            return False
        track = self.track_of(self.rows[drag.target])
        return any(
            track.annotations[index].annotation_id != drag.annotation.annotation_id
            and track.annotations[index].end_ms > round(drag.start_ms)
            and track.annotations[index].start_ms < round(drag.end_ms)
            for index in track.between(drag.start_ms, drag.end_ms)
        )

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        drag, self._drag = self._drag, None
        if drag is None:
            return
        self._refused = False
        self.update()
        if drag.kind == "row" and drag.moving:
            if drag.target not in (drag.row, drag.row + 1):
                place = drag.target - 1 if drag.target > drag.row else drag.target
                self.row_moved.emit(self.rows[drag.row].key, place)
        elif drag.kind == "create":
            if drag.moving and drag.end_ms - drag.start_ms >= SHORTEST_MS:
                tier = self.rows[drag.row].tier
                if tier is not None:
                    self.create_wanted.emit(tier.tier_id, round(drag.start_ms), round(drag.end_ms))
            elif not drag.moving:
                self.seek_wanted.emit(self._bounded(self._ms_at(event.position())))
        elif drag.kind in ("move", "start", "end") and drag.moving and drag.annotation is not None:
            tier = self.rows[drag.target if drag.kind == "move" else drag.row].tier
            times = (round(drag.start_ms), round(drag.end_ms))
            item = drag.annotation
            if tier is not None and (*times, tier.tier_id) != (item.start_ms, item.end_ms, item.tier_id):
                self.move_wanted.emit(item.annotation_id, *times, tier.tier_id)

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        hit = self.hit(event.position())
        if event.button() != Qt.MouseButton.LeftButton:
            return
        if hit.part == "names" and event.position().x() < NAMES_PX - MENU_PX:
            self._drag = None
            self.row_opened.emit(self.rows[hit.row].key)
        elif hit.annotation is not None and self.rows[hit.row].own:
            self._drag = None
            self.rename_wanted.emit(hit.annotation.annotation_id)
        else:
            self.mousePressEvent(event)

    def give_up(self) -> bool:
        """Forget what is being dragged; False where nothing is."""
        dragging, self._drag = self._drag is not None, None
        self._refused = False
        self.update()
        return dragging

    def contextMenuEvent(self, event: QContextMenuEvent) -> None:
        if event.reason() == QContextMenuEvent.Reason.Keyboard:
            row, index = self.active, self.index_of(self._shown.active)
            if row is not None and index is not None:
                below = QPoint(NAMES_PX - MENU_PX, self.row_top(index) + row.height_px)
                self.row_menu_wanted.emit(row.key, self.mapToGlobal(below))
            return
        hit = self.hit(QPointF(event.pos()))
        if hit.row >= 0:
            if self.rows[hit.row].own:
                self.activate(self.rows[hit.row].key)
            if hit.annotation is not None:
                self.select(hit.annotation.annotation_id)
            self.row_menu_wanted.emit(self.rows[hit.row].key, event.globalPos())

    def wheelEvent(self, event: QWheelEvent) -> None:
        pixels, turned = event.pixelDelta(), event.angleDelta()
        across = pixels.x() if not pixels.isNull() else turned.x() / 2
        down = pixels.y() if not pixels.isNull() else turned.y() / 2
        if event.modifiers() & Qt.KeyboardModifier.ControlModifier:
            self.zoom(_ZOOM_PER_NOTCH ** (turned.y() / 120), event.position().x() - NAMES_PX)
        elif event.modifiers() & Qt.KeyboardModifier.ShiftModifier or self.rows_height_px <= self.height() - RULER_PX:
            self._scroll_across(across + down)
        else:
            if across:
                self._scroll_across(across)
            self.scroll_to(round(self._shown.scroll_y - down))
        event.accept()

    def _scroll_across(self, pixels: float) -> None:
        self.set_scale(replace(self.scale, start_ms=self.scale.start_ms - pixels / self.scale.px_per_ms))

    def leaveEvent(self, _event: QEvent) -> None:
        self._hover = None
        self.update()

    def focusInEvent(self, event: QFocusEvent) -> None:
        super().focusInEvent(event)
        self.selection_changed.emit()

    def focusOutEvent(self, event: QFocusEvent) -> None:
        super().focusOutEvent(event)
        self.selection_changed.emit()

    def event(self, event: QEvent) -> bool:
        if event.type() == QEvent.Type.ToolTip and isinstance(event, QHelpEvent):
            text = self.tip_at(QPointF(event.pos()))
            if text:
                QToolTip.showText(event.globalPos(), plain_tip(text), self)
            else:
                QToolTip.hideText()
            return True
        return super().event(event)

    def tip_at(self, point: QPointF) -> str:
        """What is under the point, in full."""
        hit = self.hit(point)
        if hit.annotation is not None:
            item = hit.annotation
            times = f"{exact_text(item.start_ms)} to {exact_text(item.end_ms)}"
            line = f"{times} · {length_text(item.end_ms - item.start_ms)}"
            return f"{item.value or 'No label yet'}\n{line}"
        if hit.part == "names":
            row = self.rows[hit.row]
            if not row.own:
                return f"{row.name}, from the record"
            vocabulary = row.tier.vocabulary if row.tier is not None else ""
            return f"{row.name} of {row.coder} · " + (f"labels of {vocabulary}" if vocabulary else "free text")
        return ""

    def _hover_over(self, hit: Hit) -> None:
        shape = Qt.CursorShape.ArrowCursor
        if hit.part == "ruler":
            shape = Qt.CursorShape.PointingHandCursor
        elif hit.part == "row" and self.rows[hit.row].own:
            if hit.edge:
                shape = Qt.CursorShape.SizeHorCursor
            elif hit.annotation is None:
                shape = Qt.CursorShape.CrossCursor
        self.setCursor(shape)
        if hit != self._hover:
            self._hover = hit
            self.update()

    def _row_slot(self, y: float) -> int:
        """Between which rows a dragged one would be put."""
        inside = y - RULER_PX + self._shown.scroll_y
        middles = [(top + bottom) / 2 for top, bottom in zip(self._shown.tops, self._shown.tops[1:], strict=False)]
        return sum(1 for middle in middles if inside > middle)

    def _ms_at(self, point: QPointF) -> float:
        return self.scale.to_ms(point.x() - NAMES_PX)

    def _bounded(self, at_ms: float) -> float:
        return min(max(0.0, at_ms), self._shown.duration_ms)

    def _snap(self, at_ms: float, row: int, *, without: Annotation | None = None) -> float:
        """To the playhead, or to where a neighbour on the row begins or ends."""
        reach_ms = _SNAP_PX / self.scale.px_per_ms
        track = self.track_of(self.rows[row])
        moments = [self._position_ms]
        for index in track.between(at_ms - reach_ms - 1, at_ms + reach_ms + 1):
            item = track.annotations[index]
            if without is None or item.annotation_id != without.annotation_id:
                moments += [item.start_ms, item.end_ms]
        return snapped(at_ms, moments, within_ms=reach_ms)

    # ---- drawing

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._shown.width_px, self._shown.height_px = self.width(), self.height()
        self._forget_everything()
        self.set_scale(whole_session(self.room_px, self._shown.duration_ms) if self._fits else self.scale)
        self.scroll_to(self._shown.scroll_y)

    def _on_picture_made(self, _camera: str, _at_ns: object) -> None:
        if any(row.kind == "pictures" for row in self.rows):
            self.forget_layer()

    def color_of(self, coder: str) -> QColor:
        return self._drawing.color_of(self._shown, coder)

    def paintEvent(self, event: QPaintEvent) -> None:
        ratio = self.devicePixelRatioF()
        if self._layer is None:
            self._layer = self._drawing.rows(self._shown, ratio)
        if self._names is None:
            self._names = self._drawing.names(self._shown, ratio)
        painter = QPainter(self)
        for layer, left in ((self._layer, NAMES_PX), (self._names, 0)):
            area = event.rect() & QRect(left, 0, round(layer.width() / ratio), self.height())
            if not area.isEmpty():
                inside = QRectF(area.translated(-left, 0))
                source = QRectF(inside.topLeft() * ratio, inside.size() * ratio)
                painter.drawPixmap(QRectF(area), layer, source)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.save()
        painter.setClipRect(QRect(NAMES_PX, RULER_PX, self.room_px, self.height() - RULER_PX))
        self._paint_selection(painter)
        self._paint_open(painter)
        self._paint_drag(painter)
        painter.restore()
        self._paint_hovered_row(painter)
        self._paint_row_slot(painter)
        self._paint_playhead(painter)
        self._paint_position(painter)

    def _paint_selection(self, painter: QPainter) -> None:
        item = self.selected
        if item is None or (self._drag is not None and self._drag.moving and self._drag.kind != "seek"):
            return
        rect = self.rect_of(item)
        if rect is None:
            return
        painter.setPen(QPen(self._theme.color("text"), 2))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.drawRoundedRect(rect.adjusted(0, 0, 0, -0.5), 3, 3)
        own = next((row.own for row in self.rows if row.tier is not None and row.tier.tier_id == item.tier_id), False)
        if own and rect.width() >= 24:
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(self._theme.color("text"))
            for x in (rect.left(), rect.right()):
                painter.drawRoundedRect(QRectF(x - 2.5, rect.center().y() - 6, 5, 12), 2, 2)

    def _paint_open(self, painter: QPainter) -> None:
        stretch = self._open
        if stretch is None:
            return
        index = self.index_of(f"tier {stretch.tier_id}")
        if index is None:
            return
        end_ms = max(self._position_ms, stretch.start_ms + 2 / self.scale.px_per_ms)
        rect = self._stretch_rect(index, stretch.start_ms, end_ms)
        self._paint_ghost(painter, rect, self.color_of(self.rows[index].coder), stretch.value)

    def _paint_drag(self, painter: QPainter) -> None:
        drag = self._drag
        if drag is None or not drag.moving or drag.kind not in ("create", "move", "start", "end"):
            return
        index = drag.target if drag.kind == "move" else drag.row
        rect = self._stretch_rect(index, drag.start_ms, drag.end_ms)
        color = self._theme.color("amber") if self._refused else self.color_of(self.rows[index].coder)
        value = "" if drag.annotation is None else drag.annotation.value
        before = None if drag.annotation is None else self.rect_of(drag.annotation)
        if before is not None:
            ground = self._theme.color("window")
            ground.setAlpha(150)
            painter.fillRect(before, ground)
        self._paint_ghost(painter, rect, color, value)
        text = f"{exact_text(drag.start_ms)} – {exact_text(drag.end_ms)} · {length_text(drag.end_ms - drag.start_ms)}"
        if self._refused:
            text += " · taken there"
        self._paint_note(painter, rect, text)

    def _paint_ghost(self, painter: QPainter, rect: QRectF, color: QColor, value: str) -> None:
        ground = QColor(color)
        ground.setAlpha(90)
        painter.setPen(QPen(color, 1.5, Qt.PenStyle.DashLine))
        painter.setBrush(ground)
        painter.drawRoundedRect(rect, 3, 3)
        if value and rect.width() > TEXT_FROM_PX:
            painter.setFont(self._theme.font(tokens.STATUS_PX))
            painter.setPen(self._theme.color("text"))
            flags = int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft)
            painter.drawText(rect.adjusted(6, 0, -2, 0), flags, value)

    def _paint_note(self, painter: QPainter, rect: QRectF, text: str) -> None:
        """The times of what is dragged, above it or below."""
        font = self._theme.font(tokens.KEY_CAP_PX)
        width = QFontMetricsF(font).horizontalAdvance(text) + 14
        left = min(max(NAMES_PX + 4.0, rect.left()), self.width() - width - 4)
        top = rect.top() - 23 if rect.top() - 23 > RULER_PX else rect.bottom() + 4
        note = QRectF(left, top, width, 20)
        painter.setPen(QPen(self._theme.color("line_strong"), 1))
        painter.setBrush(self._theme.color("panel"))
        painter.drawRoundedRect(note, 5, 5)
        painter.setFont(font)
        painter.setPen(self._theme.color("text"))
        painter.drawText(note, int(Qt.AlignmentFlag.AlignCenter), text)

    def _paint_hovered_row(self, painter: QPainter) -> None:
        if self._hover is None or self._hover.part != "names" or self._hover.row >= len(self.rows):
            return
        row, top = self.rows[self._hover.row], self.row_top(self._hover.row)
        rect = QRectF(NAMES_PX - MENU_PX, top + row.height_px / 2 - 8, 16, 16)
        if top >= RULER_PX - row.height_px / 2:
            draw_icon(painter, rect, "dots-three", self._theme.color("text"))

    def _paint_row_slot(self, painter: QPainter) -> None:
        drag = self._drag
        if drag is None or drag.kind != "row" or not drag.moving:
            return
        y = RULER_PX + self._shown.tops[min(drag.target, len(self.rows))] - self._shown.scroll_y
        painter.fillRect(QRectF(0, y - 1.5, self.width(), 3), self._theme.color("blue"))

    def _paint_position(self, painter: QPainter) -> None:
        """Where the playhead is, to the millisecond, in the corner."""
        painter.setClipping(False)
        painter.setFont(self._theme.font(tokens.STATUS_PX))
        painter.setPen(self._theme.color("dim"))
        place = QRectF(14, 0, NAMES_PX - 28, RULER_PX - 1)
        painter.drawText(
            place, int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft), exact_text(self._position_ms)
        )

    def _paint_playhead(self, painter: QPainter) -> None:
        x = self.scale.to_px(self._position_ms)
        if not -6 <= x <= self.room_px + 6:
            return
        painter.setClipRect(NAMES_PX - 6, 0, self.room_px + 6, self.height())
        at = NAMES_PX + x
        color = self._theme.color("blue")
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(color)
        painter.drawRect(QRectF(at - 0.75, RULER_PX - 9, 1.5, self.height()))
        top = RULER_PX - 15
        painter.drawPolygon(QPolygonF([
            QPointF(at - 6, top), QPointF(at + 6, top), QPointF(at + 6, top + 6), QPointF(at, top + 13),
            QPointF(at - 6, top + 6),
        ]))  # fmt: skip
