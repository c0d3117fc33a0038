"""Timeline widget: row names, ruler, rows and mouse input, with one hit test for all of it.

Static content is painted once into layers; a moving playhead repaints a narrow strip.
"""

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Literal

import numpy as np
from PySide6.QtCore import QEvent, QPoint, QPointF, QRect, QRectF, Qt, Signal
from PySide6.QtGui import (
    QAccessible,
    QColor,
    QContextMenuEvent,
    QFocusEvent,
    QFontMetricsF,
    QHelpEvent,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPen,
    QPolygonF,
    QWheelEvent,
)
from PySide6.QtWidgets import QSizePolicy, QToolTip

from caris_desktop.domain.translation import tr, tr_filled
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.recording.annotation.annotation_model import Annotation
from caris_desktop.ui import tokens
from caris_desktop.ui.replay.timeline_items import (
    CENTER,
    LEFT,
    MENU_PX,
    NAMES_PX,
    PAD_PX,
    RULER_PX,
    SHORTEST_MS,
    TEXT_FROM_PX,
    GetPicture,
    Row,
    TimelineItems,
    Track,
    exact_text,
    length_text,
    snapped,
    vocabulary_title,
)
from caris_desktop.ui.theme import Theme, draw_icon

_DRAG_PX = 4
_SNAP_PX = 6
_EDGE_PX = 6
_ZOOM_PER_NOTCH = 1.25


class Hit(Value):
    """Item under a point: the menu or the rest of a row's name, the free part of a row, an annotation or its edge."""

    part: Literal["corner", "menu", "name", "ruler", "row", "annotation", "start", "end", "below"]
    row: int = -1
    annotation: Annotation | None = None


_CURSORS = {
    "ruler": Qt.CursorShape.PointingHandCursor,
    "start": Qt.CursorShape.SizeHorCursor,
    "end": Qt.CursorShape.SizeHorCursor,
}


@dataclass(slots=True)
class _Drag:
    """Mouse drag. ``moving`` once it exceeds the distance of a click; ``target``: row to drop it on."""

    kind: Literal["create", "annotation", "start", "end", "seek", "pan", "name"]
    origin: QPointF
    origin_ms: float
    row: int = -1
    annotation: Annotation | None = None
    start_ms: float = 0.0
    end_ms: float = 0.0
    target: int = -1
    moving: bool = False
    refused: bool = False


class OpenInterval(Value):
    """Open interval of a label, begun by its key and ended by the next press."""

    tier_id: str
    value: str
    start_ms: int


class TimelineCanvas(TimelineItems):
    """Timeline with input: emits requests and changes nothing itself."""

    accessible_role = QAccessible.Role.Chart

    seek_requested = Signal(float)  # session time in ms
    create_requested = Signal(str, int, int)  # tier, start and end in ms
    move_requested = Signal(str, int, int, str)  # annotation, start and end in ms, tier
    rename_requested = Signal(str)
    row_menu_requested = Signal(str, QPoint)  # row, global position
    row_opened = Signal(str)
    row_moved = Signal(str, int)  # row, new index among visible rows
    selection_changed = Signal()

    def __init__(self, theme: Theme, picture: GetPicture, named: Callable[[str], str]) -> None:
        super().__init__(theme, picture, named)
        self.setObjectName("timeline_canvas")
        self.setAccessibleName(tr("Timeline"))
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setMouseTracking(True)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.selected: Annotation | None = None
        self.open: OpenInterval | None = None
        self._drag: _Drag | None = None
        self._hover: Hit | None = None

    # ---- display

    def show_tracks(self, tracks: Mapping[str, Track]) -> None:
        """Set the annotations of each tier, by row key."""
        self.tracks = tracks
        if self.selected is not None:
            self.selected = self._find(self.selected.annotation_id)
            self.selection_changed.emit()
        self._repaint()

    def show_position(self, position_ms: float, *, playing: bool) -> None:
        """Move the playhead. The view scrolls when the playhead leaves it, also after a jump."""
        before, self.position_ms = self.position_ms, position_ms
        was_visible = 0 <= self.scale.to_px(before) <= self.room_px
        if not 0 <= self.scale.to_px(position_ms) <= self.room_px and self._drag is None:
            jumped = abs(position_ms - before) > 1500
            if jumped or was_visible:
                share = 0.1 if playing and was_visible and not jumped else 0.5
                self.scroll_across_to(position_ms - share * self.room_px / self.scale.px_per_ms)
        if self.open is not None:
            self.update()
            return
        self.update(0, 0, NAMES_PX, RULER_PX)
        for at_ms in (before, position_ms):
            self.update(NAMES_PX + round(self.scale.to_px(at_ms)) - 8, 0, 16, self.height())

    # ---- selection

    def select(self, annotation_id: str) -> None:
        before, self.selected = self.selected, self._find(annotation_id)
        if (before and before.annotation_id) != (self.selected and self.selected.annotation_id):
            self.update()
            self.selection_changed.emit()

    @property
    def active(self) -> Row | None:
        """The coder's active tier."""
        index = self.index_of(self._active)
        return None if index is None else self.rows[index]

    def activate(self, key: str) -> None:
        if key != self._active:
            self._active = key
            self._repaint()
            self.selection_changed.emit()

    # ---- geometry

    def _find(self, annotation_id: str) -> Annotation | None:
        found = (item for track in self.tracks.values() for item in track.annotations)
        return next((item for item in found if item.annotation_id == annotation_id), None) if annotation_id else None

    def _row_of(self, annotation: Annotation) -> int | None:
        tiers = (None if row.tier is None else row.tier.tier_id for row in self.rows)
        return next((number for number, tier_id in enumerate(tiers) if tier_id == annotation.tier_id), None)

    def rect_of(self, annotation: Annotation) -> QRectF | None:
        """Rectangle of an annotation; None if its row is hidden."""
        index = self._row_of(annotation)
        return None if index is None else self._interval_rect(index, annotation.start_ms, annotation.end_ms)

    def _interval_rect(self, index: int, start_ms: float, end_ms: float) -> QRectF:
        left, right = self.scale.to_px(start_ms), self.scale.to_px(end_ms)
        top = self.row_top(index) + PAD_PX
        return QRectF(NAMES_PX + left, top, max(2.0, right - left), self.rows[index].height_px - 2 * PAD_PX)

    def hit(self, point: QPointF) -> Hit:
        """Item under a point. Pointer, clicks, drags, menus and tooltips all ask here."""
        x = point.x() - NAMES_PX
        if point.y() < RULER_PX:
            return Hit("ruler" if x >= 0 else "corner")
        index = int(np.searchsorted(self._tops, point.y() - RULER_PX + self.scroll_y, "right")) - 1
        if not 0 <= index < len(self.rows):
            return Hit("below")
        if x < 0:
            return Hit("menu" if x >= -MENU_PX else "name", index)
        row, at_ms, near_ms = self.rows[index], self.scale.to_ms(x), 3 / self.scale.px_per_ms
        track = self.track_of(row)
        found = track.at(at_ms) or track.at(at_ms - near_ms) or track.at(at_ms + near_ms)
        if found is None:
            return Hit("row", index)
        left, right = self.scale.to_px(found.start_ms), self.scale.to_px(found.end_ms)
        zone = min(_EDGE_PX, (right - left) / 3)
        if row.own and x <= left + zone:
            return Hit("start", index, found)
        return Hit("end" if row.own and x >= right - zone else "annotation", index, found)

    def _tip(self, hit: Hit) -> str:
        """Full text of the item."""
        if hit.annotation is not None:
            item = hit.annotation
            times = tr("{start} to {end}").format(start=exact_text(item.start_ms), end=exact_text(item.end_ms))
            label = tr_filled(item.value) or tr("No label yet")
            return f"{label}\n{times} · {length_text(item.end_ms - item.start_ms)}"
        if hit.part not in ("name", "menu"):
            return ""
        row = self.rows[hit.row]
        if not row.own:
            return tr("{row}, from the recording").format(row=row.name)
        vocabulary = vocabulary_title(row.tier.vocabulary) if row.tier is not None else ""
        words = tr("{tier} of {coder} · labels of {vocabulary}") if vocabulary else tr("{tier} of {coder} · free text")
        return words.format(tier=row.name, coder=row.coder, vocabulary=vocabulary)

    def _ms_at(self, point: QPointF) -> float:
        return self.scale.to_ms(point.x() - NAMES_PX)

    def _bounded(self, at_ms: float) -> float:
        return min(max(0.0, at_ms), self._duration_ms)

    def _snap(self, at_ms: float, row: int, *, without: Annotation | None = None) -> float:
        """Snap to the playhead or to the edges of annotations in the row."""
        reach_ms = _SNAP_PX / self.scale.px_per_ms
        moments = [self.position_ms]
        for item in self._others(row, at_ms - reach_ms - 1, at_ms + reach_ms + 1, without):
            moments += [item.start_ms, item.end_ms]
        return snapped(at_ms, moments, within_ms=reach_ms)

    def _others(self, row: int, first_ms: float, last_ms: float, without: Annotation | None) -> list[Annotation]:
        """Annotations of the row in an interval, without one of them."""
        track = self.track_of(self.rows[row])
        found = (track.annotations[index] for index in track.between(first_ms, last_ms))
        return [item for item in found if without is None or item.annotation_id != without.annotation_id]

    def _free_around(self, row: int, at_ms: float, without: Annotation | None = None) -> tuple[float, float]:
        """Free interval around a time."""
        others = self._others(row, -1, self._duration_ms + 1, without)
        ends = [float(item.end_ms) for item in others if item.start_ms < at_ms]
        starts = [float(item.start_ms) for item in others if item.start_ms >= at_ms]
        return ends[-1] if ends else 0.0, starts[0] if starts else self._duration_ms

    # ---- mouse

    def mousePressEvent(self, event: QMouseEvent) -> None:
        point = event.position()
        hit, at_ms = self.hit(point), self._ms_at(point)
        if event.button() == Qt.MouseButton.MiddleButton:
            self._drag = _Drag("pan", point, at_ms, start_ms=self.scale.start_ms)
        if event.button() != Qt.MouseButton.LeftButton or self._drag is not None or hit.part == "corner":
            return
        row = self.rows[hit.row] if hit.row >= 0 else None
        own, item = row is not None and row.own, hit.annotation
        if row is not None and own:
            self.activate(row.key)
        if row is not None and hit.part == "menu":
            self.row_menu_requested.emit(row.key, event.globalPosition().toPoint())
        elif hit.part == "name":
            self._drag = _Drag("name", point, at_ms, hit.row, target=hit.row)
        elif item is not None:
            self.select(item.annotation_id)
            if own:
                kind = hit.part if hit.part in ("start", "end") else "annotation"
                self._drag = _Drag(kind, point, at_ms, hit.row, item, item.start_ms, item.end_ms, hit.row)
            else:
                self.seek_requested.emit(float(item.start_ms))
        else:
            if row is not None and row.kind == "tier":
                self.select("")
            if own:
                self._drag = _Drag("create", point, at_ms, hit.row)
            else:
                self._drag = _Drag("seek", point, at_ms, moving=True)
                self.seek_requested.emit(self._bounded(at_ms))

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        point, drag = event.position(), self._drag
        if drag is None:
            self._show_hover(self.hit(point))
            return
        if not drag.moving and (point - drag.origin).manhattanLength() < _DRAG_PX:
            return
        drag.moving = True
        # Dragging beyond an edge scrolls.
        over = min(0.0, point.x() - NAMES_PX) + max(0.0, point.x() - (self.width() - 2))
        if over and drag.kind not in ("pan", "name"):
            self.scroll_across_to(self.scale.start_ms + min(40.0, max(-40.0, over)) / self.scale.px_per_ms)
        match drag.kind:
            case "seek":
                self.seek_requested.emit(self._bounded(self._ms_at(point)))
            case "pan":
                self.scroll_across_to(drag.start_ms - (point.x() - drag.origin.x()) / self.scale.px_per_ms)
            case "name":
                inside, tops = point.y() - RULER_PX + self.scroll_y, self._tops
                drag.target = sum(inside > (top + below) / 2 for top, below in pairwise(tops))
            case "create":
                anchor_ms = self._snap(drag.origin_ms, drag.row)
                other_ms = self._bounded(self._snap(self._ms_at(point), drag.row))
                before, after = self._free_around(drag.row, anchor_ms)
                drag.start_ms, drag.end_ms = max(min(anchor_ms, other_ms), before), min(max(anchor_ms, other_ms), after)
            case _:
                self._drag_annotation(drag, point)
        self.update()

    def _drag_annotation(self, drag: _Drag, point: QPointF) -> None:
        item, moved_ms = drag.annotation, self._ms_at(point) - drag.origin_ms
        if item is None:
            return
        if drag.kind == "annotation":
            length = item.end_ms - item.start_ms
            start_ms = self._snap(item.start_ms + moved_ms, drag.row, without=item)
            if start_ms == item.start_ms + moved_ms:
                start_ms = self._snap(item.end_ms + moved_ms, drag.row, without=item) - length
            drag.start_ms = min(max(0.0, start_ms), self._duration_ms - length)
            drag.end_ms = drag.start_ms + length
            # To another tier of the same coder only.
            under = self.hit(point).row
            same = under >= 0 and self.rows[under].coder == self.rows[drag.row].coder
            drag.target = under if same else drag.row
            others = self._others(drag.target, drag.start_ms, drag.end_ms, item)
            drag.refused = any(
                other.end_ms > round(drag.start_ms) and other.start_ms < round(drag.end_ms) for other in others
            )
            return
        before, after = self._free_around(drag.row, (item.start_ms + item.end_ms) / 2, item)
        edge_ms = (item.start_ms if drag.kind == "start" else item.end_ms) + moved_ms
        edge_ms = self._bounded(self._snap(edge_ms, drag.row, without=item))
        if drag.kind == "start":
            drag.start_ms = min(max(edge_ms, before), item.end_ms - SHORTEST_MS)
        else:
            drag.end_ms = max(min(edge_ms, after), item.start_ms + SHORTEST_MS)

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        drag, self._drag = self._drag, None
        if drag is None:
            return
        self.update()
        item, times = drag.annotation, (round(drag.start_ms), round(drag.end_ms))
        tier = self.rows[drag.target if drag.kind == "annotation" else drag.row].tier if drag.row >= 0 else None
        if not drag.moving:
            if drag.kind == "create":
                self.seek_requested.emit(self._bounded(self._ms_at(event.position())))
        elif drag.kind == "name":
            if drag.target not in (drag.row, drag.row + 1):
                self.row_moved.emit(self.rows[drag.row].key, drag.target - (drag.target > drag.row))
        elif tier is not None and item is not None:
            if (*times, tier.tier_id) != (item.start_ms, item.end_ms, item.tier_id):
                self.move_requested.emit(item.annotation_id, *times, tier.tier_id)
        elif tier is not None and drag.end_ms - drag.start_ms >= SHORTEST_MS:
            self.create_requested.emit(tier.tier_id, *times)

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        hit = self.hit(event.position())
        if event.button() != Qt.MouseButton.LeftButton:
            return
        if hit.part == "name":
            self._drag = None
            self.row_opened.emit(self.rows[hit.row].key)
        elif hit.annotation is not None and self.rows[hit.row].own:
            self._drag = None
            self.rename_requested.emit(hit.annotation.annotation_id)
        else:
            self.mousePressEvent(event)

    def cancel_drag(self) -> bool:
        """Cancel a drag; False if there is none."""
        dragging, self._drag = self._drag is not None, None
        self.update()
        return dragging

    def contextMenuEvent(self, event: QContextMenuEvent) -> None:
        if event.reason() == QContextMenuEvent.Reason.Keyboard:
            row, index = self.active, self.index_of(self._active)
            if row is not None and index is not None:
                below = QPoint(NAMES_PX - MENU_PX, self.row_top(index) + row.height_px)
                self.row_menu_requested.emit(row.key, self.mapToGlobal(below))
            return
        hit = self.hit(QPointF(event.pos()))
        if hit.row >= 0:
            if self.rows[hit.row].own:
                self.activate(self.rows[hit.row].key)
            if hit.annotation is not None:
                self.select(hit.annotation.annotation_id)
            self.row_menu_requested.emit(self.rows[hit.row].key, event.globalPos())

    def wheelEvent(self, event: QWheelEvent) -> None:
        pixels, turned = event.pixelDelta(), event.angleDelta()
        across = pixels.x() if not pixels.isNull() else turned.x() / 2
        down = pixels.y() if not pixels.isNull() else turned.y() / 2
        if event.modifiers() & Qt.KeyboardModifier.ControlModifier:
            self.zoom(_ZOOM_PER_NOTCH ** (turned.y() / 120), event.position().x() - NAMES_PX)
        else:
            if event.modifiers() & Qt.KeyboardModifier.ShiftModifier or self.rows_height_px <= self.height() - RULER_PX:
                across, down = across + down, 0
            if across:
                self.scroll_across_to(self.scale.start_ms - across / self.scale.px_per_ms)
            self.scroll_to(round(self.scroll_y - down))
        event.accept()

    def leaveEvent(self, _event: QEvent) -> None:
        self._show_hover(None)

    def focusInEvent(self, event: QFocusEvent) -> None:
        super().focusInEvent(event)
        self.selection_changed.emit()

    def focusOutEvent(self, event: QFocusEvent) -> None:
        super().focusOutEvent(event)
        self.selection_changed.emit()

    def event(self, event: QEvent) -> bool:
        if event.type() == QEvent.Type.ToolTip and isinstance(event, QHelpEvent):
            QToolTip.showText(event.globalPos(), self._tip(self.hit(QPointF(event.pos()))), self)
            return True
        return super().event(event)

    def _show_hover(self, hit: Hit | None) -> None:
        if hit == self._hover:
            return
        self._hover = hit
        shape = Qt.CursorShape.ArrowCursor
        if hit is not None:
            free = hit.part == "row" and self.rows[hit.row].own
            shape = Qt.CursorShape.CrossCursor if free else _CURSORS.get(hit.part, shape)
        self.setCursor(shape)
        self.update()

    # ---- painting

    def paintEvent(self, event: QPaintEvent) -> None:
        super().paintEvent(event)
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setClipRect(QRect(NAMES_PX, RULER_PX, self.room_px, self.height() - RULER_PX))
        self._paint_selection(painter)
        index = None if self.open is None else self.index_of(f"tier {self.open.tier_id}")
        if self.open is not None and index is not None:
            end_ms = max(self.position_ms, self.open.start_ms + 2 / self.scale.px_per_ms)
            rect = self._interval_rect(index, self.open.start_ms, end_ms)
            self._paint_ghost(painter, rect, self._color_of(self.rows[index].coder), self.open.value)
        self._paint_drag(painter)
        painter.setClipping(False)
        self._paint_names(painter)
        x = self.scale.to_px(self.position_ms)
        if -6 <= x <= self.room_px + 6:
            painter.setClipRect(NAMES_PX - 6, 0, self.room_px + 6, self.height())
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(self._theme.color("blue"))
            painter.translate(NAMES_PX + x, RULER_PX - 15)
            painter.drawRect(QRectF(-0.75, 6, 1.5, self.height()))
            head = ((-6, 0), (6, 0), (6, 6), (0, 13), (-6, 6))
            painter.drawPolygon(QPolygonF([QPointF(*corner) for corner in head]))

    def _paint_selection(self, painter: QPainter) -> None:
        item = self.selected
        rect = None if item is None else self.rect_of(item)
        if item is None or rect is None or (self._drag is not None and self._drag.moving and self._drag.kind != "seek"):
            return
        painter.setPen(QPen(self._theme.color("text"), 2))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.drawRoundedRect(rect.adjusted(0, 0, 0, -0.5), 3, 3)
        index = self._row_of(item)
        if index is not None and self.rows[index].own and rect.width() >= 24:
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(self._theme.color("text"))
            for x in (rect.left(), rect.right()):
                painter.drawRoundedRect(QRectF(x - 2.5, rect.center().y() - 6, 5, 12), 2, 2)

    def _paint_drag(self, painter: QPainter) -> None:
        drag = self._drag
        if drag is None or not drag.moving or drag.kind not in ("create", "annotation", "start", "end"):
            return
        index = drag.target if drag.kind == "annotation" else drag.row
        rect = self._interval_rect(index, drag.start_ms, drag.end_ms)
        before = None if drag.annotation is None else self.rect_of(drag.annotation)
        if before is not None:
            ground = self._theme.color("window")
            ground.setAlpha(150)
            painter.fillRect(before, ground)
        color = self._theme.color("amber") if drag.refused else self._color_of(self.rows[index].coder)
        self._paint_ghost(painter, rect, color, "" if drag.annotation is None else drag.annotation.value)
        text = f"{exact_text(drag.start_ms)} – {exact_text(drag.end_ms)} · {length_text(drag.end_ms - drag.start_ms)}"
        if drag.refused:
            text = tr("{stretch} · already occupied").format(stretch=text)
        font = self._theme.font(tokens.KEY_CAP_PX)
        width = QFontMetricsF(font).horizontalAdvance(text) + 14
        left = min(max(NAMES_PX + 4.0, rect.left()), self.width() - width - 4)
        note = QRectF(left, rect.top() - 23 if rect.top() - 23 > RULER_PX else rect.bottom() + 4, width, 20)
        painter.setPen(self._theme.color("line_strong"))
        painter.setBrush(self._theme.color("panel"))
        painter.drawRoundedRect(note, 5, 5)
        painter.setFont(font)
        painter.setPen(self._theme.color("text"))
        painter.drawText(note, CENTER, text)

    def _paint_ghost(self, painter: QPainter, rect: QRectF, color: QColor, value: str) -> None:
        ground = QColor(color)
        ground.setAlpha(90)
        painter.setPen(QPen(color, 1.5, Qt.PenStyle.DashLine))
        painter.setBrush(ground)
        painter.drawRoundedRect(rect, 3, 3)
        if value and rect.width() > TEXT_FROM_PX:
            painter.setFont(self._theme.font(tokens.STATUS_PX))
            painter.setPen(self._theme.color("text"))
            painter.drawText(rect.adjusted(6, 0, -2, 0), LEFT, value)

    def _paint_names(self, painter: QPainter) -> None:
        """Menu of the row under the pointer, place of a dragged row, and the playhead's time to the millisecond."""
        hover, drag = self._hover, self._drag
        if hover is not None and hover.part in ("name", "menu") and hover.row < len(self.rows):
            middle = self.row_top(hover.row) + self.rows[hover.row].height_px / 2
            if middle >= RULER_PX:
                rect = QRectF(NAMES_PX - MENU_PX, middle - 8, 16, 16)
                draw_icon(painter, rect, "dots-three", self._theme.color("text"))
        if drag is not None and drag.kind == "name" and drag.moving:
            y = RULER_PX + self._tops[min(drag.target, len(self.rows))] - self.scroll_y
            painter.fillRect(QRectF(0, y - 1.5, self.width(), 3), self._theme.color("blue"))
        painter.setFont(self._theme.font(tokens.STATUS_PX))
        painter.setPen(self._theme.color("dim"))
        painter.drawText(QRectF(14, 0, NAMES_PX - 28, RULER_PX - 1), LEFT, exact_text(self.position_ms))
