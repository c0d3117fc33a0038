"""The drawn part of the timeline: names, ruler and rows, and what the pointer does to them.

Everything that stays while the replay plays is drawn once into a layer; a moving playhead repaints a narrow stripe.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QEvent, QPoint, QPointF, QRect, QRectF, QSize, Qt, Signal
from PySide6.QtGui import (
    QColor,
    QContextMenuEvent,
    QFocusEvent,
    QFontMetricsF,
    QHelpEvent,
    QImage,
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
from caris_desktop.ui.replay.thumbnails import Moment, Thumbnails
from caris_desktop.ui.replay.timeline_model import (
    SHORTEST_MS,
    Row,
    TimeScale,
    Track,
    exact_text,
    initials,
    length_text,
    picture_step_ms,
    ruler_ticks,
    runs,
    snapped,
    speed_columns,
    wave_columns,
    whole_session,
)
from caris_desktop.ui.theme import Theme

NAMES_PX = 208
RULER_PX = 28
_MENU_PX = 28
_DRAG_PX = 4
_SNAP_PX = 6
_EDGE_PX = 6
_TINY_PX = 3.0
_TEXT_FROM_PX = 22.0
_PAD_PX = 3
_ZOOM_PER_NOTCH = 1.25
_PICTURE_SHAPE = 16 / 9
_EMPTY_TRACK = Track(())
_RECORD_ICONS = (
    ("speech", "chat-text"), ("participant", "user"), ("said", "chat-text"), ("motion", "navigation-arrow"),
    ("goal", "flag"), ("people", "users"), ("person", "user"), ("mark", "bookmark-simple"), ("problem", "warning"),
    ("step", "list-numbers"), ("note", "note"), ("driv", "game-controller"),
)  # fmt: skip

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
        self._rows: list[Row] = []
        self._tops: list[int] = [0]
        self._tracks: Mapping[str, Track] = {}
        self._coders: Sequence[str] = ()
        self._overview: SessionOverview | None = None
        self._loudest: dict[str, float] = {}
        self._started_ns = 0
        self._duration_ms = 1.0
        self._scale = TimeScale(0.0, 0.01)
        self._fits = True
        self._scroll_y = 0
        self._position_ms = 0.0
        self._selected = ""
        self._selected_item: Annotation | None = None
        self._active = ""
        self._open: OpenStretch | None = None
        self._drag: Drag | None = None
        self._refused = False
        self._hover: Hit | None = None
        self._words = ""
        self._layer: QPixmap | None = None
        self._elided: dict[tuple[str, int], str] = {}
        thumbnails.made.connect(self._on_picture_made)
        theme.changed.connect(self.forget_layer)

    def sizeHint(self) -> QSize:
        return QSize(900, 240)

    def minimumSizeHint(self) -> QSize:
        return QSize(NAMES_PX + 160, RULER_PX + 40)

    # ---- what it shows

    def show_session(self, started_ns: int, duration_ms: float) -> None:
        self._started_ns, self._duration_ms = started_ns, max(1.0, duration_ms)
        self.set_scale(whole_session(self.room_px, self._duration_ms) if self._fits else self._scale)

    def show_rows(self, rows: Sequence[Row], coders: Sequence[str], *, words: str = "") -> None:
        """The rows in their order; ``words`` stand where there are none."""
        self._rows, self._coders, self._words = list(rows), coders, words
        self._tops = [0]
        for row in self._rows:
            self._tops.append(self._tops[-1] + row.height_px)
        self.scroll_to(self._scroll_y)
        self.forget_layer()

    def show_tracks(self, tracks: Mapping[str, Track]) -> None:
        """The annotations of each tier, by the key of its row."""
        self._tracks = tracks
        if self._selected:
            self._selected_item = self._find(self._selected)
            if self._selected_item is None:
                self._selected = ""
            self.selection_changed.emit()
        self.forget_layer()

    def show_overview(self, overview: SessionOverview | None) -> None:
        self._overview = overview
        waves = () if overview is None else overview.waveforms
        self._loudest = {wave.source: max(0.1, float(np.abs(wave.peaks).max(initial=0.0))) for wave in waves}
        self.forget_layer()

    def show_position(self, position_ms: float, *, playing: bool) -> None:
        """Move the playhead. The view follows it over its edge, and to where somebody jumped."""
        before, self._position_ms = self._position_ms, position_ms
        was_visible = 0 <= self._scale.to_px(before) <= self.room_px
        x = self._scale.to_px(position_ms)
        if not 0 <= x <= self.room_px and self._drag is None:
            jumped = abs(position_ms - before) > 1500
            if playing and was_visible and not jumped:
                self.set_scale(replace(self._scale, start_ms=position_ms - 0.1 * self.room_px / self._scale.px_per_ms))
            elif jumped or was_visible:
                self.set_scale(replace(self._scale, start_ms=position_ms - 0.5 * self.room_px / self._scale.px_per_ms))
        if self._open is not None:
            self.update()
            return
        for at_ms in (before, position_ms):
            left = NAMES_PX + round(self._scale.to_px(at_ms))
            self.update(left - 8, 0, 16, self.height())

    def show_open(self, stretch: OpenStretch | None) -> None:
        self._open = stretch
        self.update()

    def forget_layer(self) -> None:
        """Something that stays has changed: draw it again."""
        self._layer = None
        self.update()

    @property
    def rows(self) -> Sequence[Row]:
        return self._rows

    @property
    def scale(self) -> TimeScale:
        return self._scale

    @property
    def room_px(self) -> int:
        """Width of the part under the ruler."""
        return max(1, self.width() - NAMES_PX)

    @property
    def rows_height_px(self) -> int:
        return self._tops[-1]

    @property
    def scroll_y(self) -> int:
        return self._scroll_y

    def set_scale(self, scale: TimeScale) -> None:
        scale = scale.bounded(self.room_px, self._duration_ms)
        self._fits = scale.px_per_ms <= whole_session(self.room_px, self._duration_ms).px_per_ms * 1.0001
        if scale != self._scale:
            self._scale = scale
            self.forget_layer()
        self.view_changed.emit()

    def zoom(self, factor: float, around_px: float | None = None) -> None:
        """Around a pixel of the rows; around the playhead, where it is in view, without one."""
        if around_px is None:
            playhead = self._scale.to_px(self._position_ms)
            around_px = playhead if 0 <= playhead <= self.room_px else self.room_px / 2
        self.set_scale(self._scale.zoomed(factor, around_px, width_px=self.room_px, duration_ms=self._duration_ms))

    def fit(self) -> None:
        self.set_scale(whole_session(self.room_px, self._duration_ms))

    def scroll_to(self, y: int) -> None:
        y = min(max(0, y), max(0, self.rows_height_px - (self.height() - RULER_PX)))
        if y != self._scroll_y:
            self._scroll_y = y
            self.forget_layer()
        self.view_changed.emit()

    def show_row(self, key: str) -> None:
        """Scroll so that the row is in view."""
        index = self.index_of(key)
        if index is None:
            return
        top, bottom, room = self._tops[index], self._tops[index + 1], self.height() - RULER_PX
        if top < self._scroll_y:
            self.scroll_to(top)
        elif bottom > self._scroll_y + room:
            self.scroll_to(bottom - room)

    def show_stretch(self, start_ms: float, end_ms: float) -> None:
        """Scroll so that the stretch is in view."""
        if not 0 <= self._scale.to_px(start_ms) <= self.room_px - 40 or self._scale.to_px(end_ms) > self.room_px:
            self.set_scale(replace(self._scale, start_ms=start_ms - 0.2 * self.room_px / self._scale.px_per_ms))

    def index_of(self, key: str) -> int | None:
        return next((number for number, row in enumerate(self._rows) if row.key == key), None)

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
                for track in self._tracks.values()
                for item in track.annotations
                if item.annotation_id == annotation_id
            ),
            None,
        )

    @property
    def active(self) -> Row | None:
        """The coder's tier that keys act on."""
        index = self.index_of(self._active)
        return None if index is None else self._rows[index]

    def activate(self, key: str) -> None:
        if key != self._active:
            self._active = key
            self.forget_layer()
            self.selection_changed.emit()

    def track_of(self, row: Row) -> Track:
        return self._tracks.get(row.key, _EMPTY_TRACK)

    def rect_of(self, annotation: Annotation) -> QRectF | None:
        """Where it is drawn; None where its row is not on show."""
        for index, row in enumerate(self._rows):
            if row.tier is not None and row.tier.tier_id == annotation.tier_id:
                return self._stretch_rect(index, annotation.start_ms, annotation.end_ms)
        return None

    def row_top(self, index: int) -> int:
        return RULER_PX + self._tops[index] - self._scroll_y

    def _stretch_rect(self, index: int, start_ms: float, end_ms: float) -> QRectF:
        left, right = self._scale.to_px(start_ms), self._scale.to_px(end_ms)
        top = self.row_top(index) + _PAD_PX
        return QRectF(NAMES_PX + left, top, max(2.0, right - left), self._rows[index].height_px - 2 * _PAD_PX)

    # ---- what lies where

    def hit(self, point: QPointF) -> Hit:
        if point.y() < RULER_PX:
            return Hit("ruler" if point.x() >= NAMES_PX else "corner")
        y = point.y() - RULER_PX + self._scroll_y
        index = int(np.searchsorted(self._tops, y, "right")) - 1
        if not 0 <= index < len(self._rows):
            return Hit("below")
        if point.x() < NAMES_PX:
            return Hit("names", index)
        row = self._rows[index]
        if row.kind != "tier":
            return Hit("row", index)
        at_ms = self._scale.to_ms(point.x() - NAMES_PX)
        track = self.track_of(row)
        found = track.at(at_ms)
        if found is None:
            near_ms = 3 / self._scale.px_per_ms
            found = track.at(at_ms - near_ms) or track.at(at_ms + near_ms)
            if found is None:
                return Hit("row", index)
        if not row.own:
            return Hit("row", index, found)
        left, right = self._scale.to_px(found.start_ms), self._scale.to_px(found.end_ms)
        x, zone = point.x() - NAMES_PX, min(_EDGE_PX, (right - left) / 3)
        if x <= left + zone:
            return Hit("row", index, found, "start")
        return Hit("row", index, found, "end" if x >= right - zone else "")

    # ---- pointer

    def mousePressEvent(self, event: QMouseEvent) -> None:
        point = event.position()
        hit = self.hit(point)
        if event.button() == Qt.MouseButton.MiddleButton:
            self._drag = Drag("pan", point, start_ms=self._scale.start_ms)
            return
        if event.button() != Qt.MouseButton.LeftButton or self._drag is not None:
            return
        at_ms = self._ms_at(point)
        if hit.part == "names":
            row = self._rows[hit.row]
            if row.own:
                self.activate(row.key)
            if point.x() >= NAMES_PX - _MENU_PX:
                self.row_menu_wanted.emit(row.key, event.globalPosition().toPoint())
            else:
                self._drag = Drag("row", point, hit.row, target=hit.row)
        elif hit.part == "row" and self._rows[hit.row].kind == "tier":
            if self._rows[hit.row].own:
                self.activate(self._rows[hit.row].key)
            self._press_tier(hit, point, at_ms)
        elif hit.part in ("ruler", "row", "below"):
            self._drag = Drag("seek", point, moving=True)
            self.seek_wanted.emit(self._bounded(at_ms))

    def _press_tier(self, hit: Hit, point: QPointF, at_ms: float) -> None:
        item = hit.annotation
        if item is not None:
            self.select(item.annotation_id)
            if not self._rows[hit.row].own:
                self.seek_wanted.emit(float(item.start_ms))
                return
            kind: DragKind = "start" if hit.edge == "start" else "end" if hit.edge == "end" else "move"
            self._drag = Drag(kind, point, hit.row, item, item.start_ms, item.end_ms, target=hit.row)
            return
        self.select("")
        if self._rows[hit.row].own:
            start_ms = self._snap(at_ms, hit.row)
            self._drag = Drag("create", point, hit.row, None, start_ms, start_ms)
        else:
            self._drag = Drag("seek", point, moving=True)
            self.seek_wanted.emit(self._bounded(at_ms))

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        point, drag = event.position(), self._drag
        if drag is None:
            self._hover_over(self.hit(point))
            return
        if not drag.moving and (point - drag.origin).manhattanLength() < _DRAG_PX:
            return
        at_ms = self._ms_at(point)
        match drag.kind:
            case "seek":
                self.seek_wanted.emit(self._bounded(at_ms))
            case "pan":
                moved_px = point.x() - drag.origin.x()
                self.set_scale(replace(self._scale, start_ms=drag.start_ms - moved_px / self._scale.px_per_ms))
            case "row":
                self._drag = replace(drag, moving=True, target=self._row_slot(point.y()))
                self.update()
            case _:
                self._drag = self._dragged(replace(drag, moving=True), point, at_ms)
                self._refused = self._overlaps(self._drag)
                self.update()

    def _dragged(self, drag: Drag, point: QPointF, at_ms: float) -> Drag:
        """What a drag has made of a new or an existing annotation."""
        track, item = self.track_of(self._rows[drag.row]), drag.annotation
        if drag.kind == "create":
            anchor_ms = self._snap(self._ms_at(drag.origin), drag.row)
            other_ms = self._bounded(self._snap(at_ms, drag.row))
            before, after = self._free_around(track, anchor_ms)
            low, high = min(anchor_ms, other_ms), max(anchor_ms, other_ms)
            return replace(drag, start_ms=max(low, before), end_ms=min(high, after))
        if item is None:
            return drag
        moved_ms = at_ms - self._ms_at(drag.origin)
        if drag.kind == "move":
            length = item.end_ms - item.start_ms
            start_ms = self._snap(item.start_ms + moved_ms, drag.row, without=item)
            if start_ms == item.start_ms + moved_ms:
                start_ms = self._snap(item.end_ms + moved_ms, drag.row, without=item) - length
            start_ms = min(max(0.0, start_ms), self._duration_ms - length)
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
        if under >= 0 and self._rows[under].own and self._rows[under].coder == self._rows[drag.row].coder:
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
            self._duration_ms if later is None else float(later.start_ms),
        )

    def _overlaps(self, drag: Drag) -> bool:
        if drag.kind != "move" or drag.annotation is None:
            return False
        track = self.track_of(self._rows[drag.target])
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
                self.row_moved.emit(self._rows[drag.row].key, place)
        elif drag.kind == "create":
            if drag.moving and drag.end_ms - drag.start_ms >= SHORTEST_MS:
                tier = self._rows[drag.row].tier
                if tier is not None:
                    self.create_wanted.emit(tier.tier_id, round(drag.start_ms), round(drag.end_ms))
            elif not drag.moving:
                self.seek_wanted.emit(self._bounded(self._ms_at(event.position())))
        elif drag.kind in ("move", "start", "end") and drag.moving and drag.annotation is not None:
            tier = self._rows[drag.target if drag.kind == "move" else drag.row].tier
            times = (round(drag.start_ms), round(drag.end_ms))
            item = drag.annotation
            if tier is not None and (*times, tier.tier_id) != (item.start_ms, item.end_ms, item.tier_id):
                self.move_wanted.emit(item.annotation_id, *times, tier.tier_id)

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        hit = self.hit(event.position())
        if event.button() != Qt.MouseButton.LeftButton:
            return
        if hit.part == "names" and event.position().x() < NAMES_PX - _MENU_PX:
            self._drag = None
            self.row_opened.emit(self._rows[hit.row].key)
        elif hit.annotation is not None and self._rows[hit.row].own:
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
            row, index = self.active, self.index_of(self._active)
            if row is not None and index is not None:
                below = QPoint(NAMES_PX - _MENU_PX, self.row_top(index) + row.height_px)
                self.row_menu_wanted.emit(row.key, self.mapToGlobal(below))
            return
        hit = self.hit(QPointF(event.pos()))
        if hit.row >= 0:
            if self._rows[hit.row].own:
                self.activate(self._rows[hit.row].key)
            if hit.annotation is not None:
                self.select(hit.annotation.annotation_id)
            self.row_menu_wanted.emit(self._rows[hit.row].key, event.globalPos())

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
            self.scroll_to(round(self._scroll_y - down))
        event.accept()

    def _scroll_across(self, pixels: float) -> None:
        self.set_scale(replace(self._scale, start_ms=self._scale.start_ms - pixels / self._scale.px_per_ms))

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
                QToolTip.showText(event.globalPos(), text, self)
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
            row = self._rows[hit.row]
            if not row.own:
                return f"{row.name}, from the record"
            vocabulary = row.tier.vocabulary if row.tier is not None else ""
            return f"{row.name} of {row.coder} · " + (f"labels of {vocabulary}" if vocabulary else "free text")
        return ""

    def _hover_over(self, hit: Hit) -> None:
        shape = Qt.CursorShape.ArrowCursor
        if hit.part == "ruler":
            shape = Qt.CursorShape.PointingHandCursor
        elif hit.part == "row" and self._rows[hit.row].own:
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
        inside = y - RULER_PX + self._scroll_y
        middles = [(top + bottom) / 2 for top, bottom in zip(self._tops, self._tops[1:], strict=False)]
        return sum(1 for middle in middles if inside > middle)

    def _ms_at(self, point: QPointF) -> float:
        return self._scale.to_ms(point.x() - NAMES_PX)

    def _bounded(self, at_ms: float) -> float:
        return min(max(0.0, at_ms), self._duration_ms)

    def _snap(self, at_ms: float, row: int, *, without: Annotation | None = None) -> float:
        """To the playhead, or to where a neighbour on the row begins or ends."""
        reach_ms = _SNAP_PX / self._scale.px_per_ms
        track = self.track_of(self._rows[row])
        moments = [self._position_ms]
        for index in track.between(at_ms - reach_ms - 1, at_ms + reach_ms + 1):
            item = track.annotations[index]
            if without is None or item.annotation_id != without.annotation_id:
                moments += [item.start_ms, item.end_ms]
        return snapped(at_ms, moments, within_ms=reach_ms)

    # ---- drawing

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._layer = None
        self.set_scale(whole_session(self.room_px, self._duration_ms) if self._fits else self._scale)
        self.scroll_to(self._scroll_y)

    def _on_picture_made(self, _camera: str, _at_ns: object) -> None:
        if any(row.kind == "pictures" for row in self._rows):
            self.forget_layer()

    def color_of(self, coder: str) -> QColor:
        colors = self._theme.colors.coders
        return QColor(colors[self._coders.index(coder) % len(colors)] if coder in self._coders else colors[0])

    def paintEvent(self, event: QPaintEvent) -> None:
        if self._layer is None:
            self._layer = self.draw_layer()
        painter = QPainter(self)
        ratio = self._layer.devicePixelRatio()
        area = event.rect()
        source = QRectF(area.left() * ratio, area.top() * ratio, area.width() * ratio, area.height() * ratio)
        painter.drawPixmap(QRectF(area), self._layer, source)
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

    def draw_layer(self) -> QPixmap:
        """Everything but what moves."""
        theme, ratio = self._theme, self.devicePixelRatioF()
        layer = QPixmap(max(1, round(self.width() * ratio)), max(1, round(self.height() * ratio)))
        layer.setDevicePixelRatio(ratio)
        layer.fill(theme.color("window"))
        painter = QPainter(layer)
        room = QRect(NAMES_PX, RULER_PX, self.room_px, self.height() - RULER_PX)
        painter.setClipRect(room)
        self._draw_grid(painter)
        wanted: list[Moment] = []
        for index in self._visible_rows():
            self._draw_row(painter, index, wanted)
        if not self._rows and self._words:
            painter.setFont(theme.font())
            painter.setPen(theme.color("dim"))
            painter.drawText(room, int(Qt.AlignmentFlag.AlignCenter), self._words)
        painter.setClipping(False)
        self._draw_names(painter)
        self._draw_ruler(painter)
        painter.end()
        self._thumbnails.want_shown(wanted)
        return layer

    def _visible_rows(self) -> Iterator[int]:
        for index in range(len(self._rows)):
            top = self.row_top(index)
            if top + self._rows[index].height_px > RULER_PX and top < self.height():
                yield index

    def _draw_grid(self, painter: QPainter) -> None:
        painter.setPen(self._theme.color("line"))
        for tick in ruler_ticks(self._scale, self.room_px):
            if tick.label:
                x = NAMES_PX + round(self._scale.to_px(tick.at_ms))
                painter.drawLine(x, RULER_PX, x, self.height())

    def _draw_ruler(self, painter: QPainter) -> None:
        theme = self._theme
        painter.fillRect(0, 0, self.width(), RULER_PX, theme.color("panel"))
        painter.setPen(theme.color("line"))
        painter.drawLine(0, RULER_PX - 1, self.width(), RULER_PX - 1)
        painter.setClipRect(NAMES_PX, 0, self.room_px, RULER_PX)
        painter.setFont(theme.font(tokens.KEY_CAP_PX))
        for tick in ruler_ticks(self._scale, self.room_px):
            x = NAMES_PX + round(self._scale.to_px(tick.at_ms))
            painter.setPen(theme.color("line_strong"))
            painter.drawLine(x, RULER_PX - (10 if tick.label else 5), x, RULER_PX - 2)
            if tick.label:
                painter.setPen(theme.color("dim"))
                painter.drawText(x + 5, RULER_PX - 9, tick.label)
        painter.setClipping(False)

    def _draw_names(self, painter: QPainter) -> None:
        theme = self._theme
        painter.fillRect(0, RULER_PX, NAMES_PX, self.height() - RULER_PX, theme.color("panel"))
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setClipRect(0, RULER_PX, NAMES_PX, self.height() - RULER_PX)
        for index in self._visible_rows():
            self._draw_name(painter, index)
        painter.setClipping(False)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing, False)
        painter.setPen(theme.color("line"))
        painter.drawLine(NAMES_PX - 1, 0, NAMES_PX - 1, self.height())

    def _draw_name(self, painter: QPainter, index: int) -> None:
        theme, row, top = self._theme, self._rows[index], self.row_top(index)
        rect = QRectF(0, top, NAMES_PX - 1, row.height_px)
        active = row.key == self._active
        if active:
            painter.fillRect(rect, theme.color("blue_soft"))
            painter.fillRect(QRectF(0, top, 3, row.height_px), theme.color("blue"))
        painter.fillRect(QRectF(0, rect.bottom() - 1, NAMES_PX, 1), theme.color("line"))
        chip = QRectF(12, rect.center().y() - 9, 18, 18)
        if row.own:
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(self.color_of(row.coder))
            painter.drawEllipse(chip)
            painter.setPen(theme.color("panel"))
            painter.setFont(theme.font(9 if len(initials(row.coder)) > 1 else 11, tokens.WEIGHT_SEMIBOLD))
            painter.drawText(chip, int(Qt.AlignmentFlag.AlignCenter), initials(row.coder))
        else:
            draw_icon(painter, chip.adjusted(2, 2, -2, -2), _row_icon(row), theme.color("dim"))
        left, room = 38.0, NAMES_PX - 38.0 - _MENU_PX
        font = theme.font(tokens.STATUS_PX, tokens.WEIGHT_MEDIUM if row.own else tokens.WEIGHT_NORMAL)
        metrics = QFontMetricsF(font)
        flags = int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft)
        name = metrics.elidedText(row.name, Qt.TextElideMode.ElideRight, room)
        painter.setFont(font)
        painter.setPen(theme.color("text" if row.own else "dim"))
        painter.drawText(QRectF(left, top, room, row.height_px), flags, name)
        used = metrics.horizontalAdvance(name) + 8
        detail = self._detail_of(row)
        if detail and room - used > 24:
            small = theme.font(tokens.KEY_CAP_PX)
            painter.setFont(small)
            painter.setPen(theme.color("dim"))
            shown = QFontMetricsF(small).elidedText(detail, Qt.TextElideMode.ElideRight, room - used)
            painter.drawText(QRectF(left + used, top, room - used, row.height_px), flags, shown)

    def _detail_of(self, row: Row) -> str:
        """What stands beside a row's name."""
        if row.own and row.tier is not None:
            same = row.tier.vocabulary.casefold() in ("", row.name.casefold())
            return row.coder if same else f"{row.coder} · {row.tier.vocabulary}"
        if row.kind == "speed":
            return f"up to {self._fastest:.1f} m/s"
        return ""

    @property
    def _fastest(self) -> float:
        overview = self._overview
        return 0.1 if overview is None else max(0.1, float(np.abs(overview.speed[:, 1]).max(initial=0.0)))

    def _draw_row(self, painter: QPainter, index: int, wanted: list[Moment]) -> None:
        row, top = self._rows[index], self.row_top(index)
        theme = self._theme
        if row.key == self._active:
            painter.fillRect(QRect(NAMES_PX, top, self.room_px, row.height_px), theme.color("panel"))
        painter.fillRect(QRect(NAMES_PX, top + row.height_px - 1, self.room_px, 1), theme.color("line"))
        match row.kind:
            case "pictures":
                self._draw_pictures(painter, row, top, wanted)
            case "sound":
                self._draw_sound(painter, row, top)
            case "speed":
                self._draw_speed(painter, row, top)
            case _:
                self._draw_annotations(painter, index)

    def _draw_pictures(self, painter: QPainter, row: Row, top: int, wanted: list[Moment]) -> None:
        height = row.height_px - 5
        width = height * _PICTURE_SHAPE
        step_ms = picture_step_ms(self._scale.px_per_ms, width + 2)
        first = int(self._scale.start_ms // step_ms) * step_ms
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
        ground = self._theme.color("raised")
        for at_ms in range(first, int(min(self._scale.to_ms(self.room_px), self._duration_ms)) + 1, step_ms):
            moment = (row.source, self._started_ns + at_ms * 1_000_000)
            place = QRectF(NAMES_PX + self._scale.to_px(at_ms), top + 2, width, height)
            picture = self._thumbnails.picture(*moment)
            if picture is None:
                wanted.append(moment)
            if picture is None or picture.isNull():
                painter.fillRect(place, ground)
            else:
                size = picture.size().toSizeF().scaled(place.size(), Qt.AspectRatioMode.KeepAspectRatio)
                painter.drawImage(QRectF(place.topLeft(), size), picture)

    def _draw_sound(self, painter: QPainter, row: Row, top: int) -> None:
        waves = () if self._overview is None else self._overview.waveforms
        wave = next((wave for wave in waves if wave.source == row.source), None)
        if wave is None:
            return
        columns = wave_columns(
            wave,
            first_ns=self._started_ns + round(self._scale.start_ms * 1e6),
            ns_per_px=1e6 / self._scale.px_per_ms,
            width_px=self.room_px,
        )  # fmt: skip
        half = (row.height_px - 7) / 2
        loudest = self._loudest[row.source]
        middle = half + 3
        tops, bottoms = middle - columns[:, 1] / loudest * half, middle - columns[:, 0] / loudest * half
        color = self._theme.color("green")
        painter.drawImage(NAMES_PX, top, columns_image(tops, np.maximum(bottoms, tops + 1), row.height_px - 1, color))

    def _draw_speed(self, painter: QPainter, row: Row, top: int) -> None:
        if self._overview is None:
            return
        columns = speed_columns(self._overview.speed, self._scale, self.room_px)
        height = row.height_px - 1
        bottom = np.full(len(columns), height, np.float32)
        tops = height - columns[:, 0] / self._fastest * (height - 4)
        ground = self._theme.color("blue")
        ground.setAlpha(120)
        painter.drawImage(NAMES_PX, top, columns_image(tops, bottom, height, ground))
        painter.drawImage(NAMES_PX, top, columns_image(tops - 1, tops + 0.6, height, self._theme.color("blue")))

    def _draw_annotations(self, painter: QPainter, index: int) -> None:
        row, top = self._rows[index], self.row_top(index)
        track = self.track_of(row)
        found = track.between(self._scale.start_ms, self._scale.to_ms(self.room_px))
        if not found:
            return
        part = slice(found.start, found.stop)
        lefts = (track.starts_ms[part] - self._scale.start_ms) * self._scale.px_per_ms
        rights = (track.ends_ms[part] - self._scale.start_ms) * self._scale.px_per_ms
        tiny = rights - lefts < _TINY_PX
        theme = self._theme
        line = self.color_of(row.coder) if row.own else theme.color("line_strong")
        solid = line if row.own else theme.color("dim")
        ground = QColor(line) if row.own else theme.color("line")
        if row.own:
            ground.setAlpha(70)
        y, height = top + _PAD_PX, row.height_px - 2 * _PAD_PX - 1
        for left, right in runs(lefts[tiny], rights[tiny]):
            painter.fillRect(QRectF(NAMES_PX + left, y, right - left, height), solid)
        large = np.flatnonzero(~tiny)
        # A pixel of air keeps neighbours apart that meet.
        boxes = [
            QRect(NAMES_PX + int(lefts[number]), y, max(2, int(rights[number]) - int(lefts[number]) - 1), height)
            for number in large
        ]
        painter.setPen(line)
        painter.setBrush(ground)
        painter.drawRects(boxes)
        painter.setFont(theme.font(tokens.STATUS_PX if row.own else tokens.KEY_CAP_PX))
        painter.setPen(theme.color("text"))
        metrics = QFontMetricsF(painter.font())
        flags = int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft)
        # Beside a short one its label may take the room up to the next.
        ends = np.append(lefts[1:], self.room_px)
        for number, box in zip(large, boxes, strict=True):
            item = track.annotations[found.start + int(number)]
            if box.width() >= _TEXT_FROM_PX + 12 or not item.value:
                self._draw_label(painter, metrics, item.value, box, flags)
            else:
                room = NAMES_PX + int(ends[number]) - box.right() - 4
                if room >= _TEXT_FROM_PX + 12:
                    beside = QRect(box.right() - 1, box.top(), min(room, 240), box.height())
                    self._draw_label(painter, metrics, item.value, beside, flags)

    def _draw_label(self, painter: QPainter, metrics: QFontMetricsF, value: str, box: QRect, flags: int) -> None:
        # Of a long stretch that begins before the visible part the label still shows.
        left = max(box.left(), NAMES_PX) + 6
        room = box.right() - left - 3
        if room < _TEXT_FROM_PX - 10:
            return
        key = (value, room * 2 + (box.height() > RULER_PX - 4))
        shown = self._elided.get(key)
        if shown is None:
            if len(self._elided) > 20_000:
                self._elided.clear()
            shown = metrics.elidedText(value.replace("\n", " "), Qt.TextElideMode.ElideRight, room)
            self._elided[key] = shown
        painter.drawText(QRect(left, box.top(), room + 2, box.height()), flags, shown)

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
        own = next((row.own for row in self._rows if row.tier is not None and row.tier.tier_id == item.tier_id), False)
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
        end_ms = max(self._position_ms, stretch.start_ms + 2 / self._scale.px_per_ms)
        rect = self._stretch_rect(index, stretch.start_ms, end_ms)
        self._paint_ghost(painter, rect, self.color_of(self._rows[index].coder), stretch.value)

    def _paint_drag(self, painter: QPainter) -> None:
        drag = self._drag
        if drag is None or not drag.moving or drag.kind not in ("create", "move", "start", "end"):
            return
        index = drag.target if drag.kind == "move" else drag.row
        rect = self._stretch_rect(index, drag.start_ms, drag.end_ms)
        color = self._theme.color("amber") if self._refused else self.color_of(self._rows[index].coder)
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
        if value and rect.width() > _TEXT_FROM_PX:
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
        if self._hover is None or self._hover.part != "names" or self._hover.row >= len(self._rows):
            return
        row, top = self._rows[self._hover.row], self.row_top(self._hover.row)
        rect = QRectF(NAMES_PX - _MENU_PX, top + row.height_px / 2 - 8, 16, 16)
        if top >= RULER_PX - row.height_px / 2:
            draw_icon(painter, rect, "dots-three", self._theme.color("text"))

    def _paint_row_slot(self, painter: QPainter) -> None:
        drag = self._drag
        if drag is None or drag.kind != "row" or not drag.moving:
            return
        y = RULER_PX + self._tops[min(drag.target, len(self._rows))] - self._scroll_y
        painter.fillRect(QRectF(0, y - 1.5, self.width(), 3), self._theme.color("blue"))

    def _paint_playhead(self, painter: QPainter) -> None:
        x = self._scale.to_px(self._position_ms)
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


def columns_image(tops: NDArray[np.floating], bottoms: NDArray[np.floating], height_px: int, color: QColor) -> QImage:
    """One upright stroke for each column, from ``tops`` to ``bottoms`` in pixels from above; none where it is NaN."""
    ys = np.arange(height_px, dtype=np.float32)[:, None]
    with np.errstate(invalid="ignore"):
        filled = (ys >= np.floor(tops)[None, :]) & (ys < np.ceil(bottoms)[None, :])
    alpha = color.alpha() / 255
    ink = (
        (color.alpha() << 24)
        | (round(color.red() * alpha) << 16)
        | (round(color.green() * alpha) << 8)
        | round(color.blue() * alpha)
    )
    pixels = np.where(filled, np.uint32(ink), np.uint32(0))
    width = pixels.shape[1]
    image = QImage(pixels.data, width, height_px, 4 * width, QImage.Format.Format_ARGB32_Premultiplied)
    return image.copy()


def _row_icon(row: Row) -> str:
    match row.kind:
        case "pictures":
            return "film-strip"
        case "sound":
            return "speaker-high"
        case "speed":
            return "gauge"
        case _:
            name = row.name.casefold()
            return next((icon for word, icon in _RECORD_ICONS if word in name), "rows")
