"""Timeline widget: row names, ruler, rows and mouse input.

Static content is drawn once into a layer; a moving playhead repaints a narrow strip.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from PySide6.QtCore import QEvent, QPoint, QPointF, QRect, QRectF, QSize, Qt, Signal
from PySide6.QtGui import (
    QAccessible,
    QContextMenuEvent,
    QFocusEvent,
    QHelpEvent,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPixmap,
    QResizeEvent,
    QWheelEvent,
)
from PySide6.QtWidgets import QSizePolicy, QToolTip, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.recording.annotation.annotation_model import Annotation
from caris_desktop.recording.annotation.timeline_overview import SessionOverview
from caris_desktop.ui.replay.thumbnails import Thumbnails
from caris_desktop.ui.replay.timeline_drawing import MENU_PX, NAMES_PX, RULER_PX, TimelineDrawing, TimelineState
from caris_desktop.ui.replay.timeline_geometry import Drag, DragKind, Hit, TimelineGeometry
from caris_desktop.ui.replay.timeline_model import SHORTEST_MS, Row, TimeScale, Track, whole_session
from caris_desktop.ui.replay.timeline_overlay import OpenInterval, TimelineOverlay
from caris_desktop.ui.theme import Theme

_DRAG_PX = 4
_ZOOM_PER_NOTCH = 1.25


class TimelineCanvas(QWidget):
    """Paints rows and emits requests; does not store or change annotations."""

    accessible_role = QAccessible.Role.Chart

    seek_requested = Signal(float)  # session time in ms
    create_requested = Signal(str, int, int)  # tier, start and end in ms
    move_requested = Signal(str, int, int, str)  # annotation, start and end in ms, tier
    rename_requested = Signal(str)
    row_menu_requested = Signal(str, QPoint)  # row, global position
    row_opened = Signal(str)
    row_moved = Signal(str, int)  # row, new index among visible rows
    selection_changed = Signal()
    view_changed = Signal()  # zoom or scroll

    def __init__(self, theme: Theme, thumbnails: Thumbnails, named: Callable[[str], str]) -> None:
        super().__init__()
        self.setObjectName("timeline_canvas")
        self.setAccessibleName(tr("Timeline"))
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setMouseTracking(True)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.state = TimelineState()
        self.places = TimelineGeometry(self.state)
        self._drawing = TimelineDrawing(theme, thumbnails, named)
        self._over = TimelineOverlay(theme, self.state, self.places, self._drawing)
        self._fits = True
        self._selected = ""
        self._layer: QPixmap | None = None
        self._names: QPixmap | None = None
        thumbnails.made.connect(self._on_picture_made)
        theme.changed.connect(self._forget_everything)

    def sizeHint(self) -> QSize:
        return QSize(900, 240)

    def minimumSizeHint(self) -> QSize:
        return QSize(NAMES_PX + 160, RULER_PX + 32)

    # ---- display

    def show_session(self, started_ns: int, duration_ms: float) -> None:
        self.state.started_ns, self.state.duration_ms = started_ns, max(1.0, duration_ms)
        self.set_scale(whole_session(self.room_px, self.state.duration_ms) if self._fits else self.scale)

    def show_rows(self, rows: Sequence[Row], coders: Sequence[str], *, words: str = "") -> None:
        """Set the rows, in order; ``words``: text shown if there are none."""
        self.state.rows, self.state.coders, self.state.words = list(rows), coders, words
        self.state.tops = [0]
        for row in self.rows:
            self.state.tops.append(self.state.tops[-1] + row.height_px)
        self.scroll_to(self.state.scroll_y)
        self._forget_everything()

    def show_tracks(self, tracks: Mapping[str, Track]) -> None:
        """Set the annotations of each tier, by row key."""
        self.state.tracks = tracks
        if self._selected:
            self._over.selected = self.places.find(self._selected)
            if self._over.selected is None:
                self._selected = ""
            self.selection_changed.emit()
        self.forget_layer()

    def show_overview(self, overview: SessionOverview | None) -> None:
        self.state.show_overview(overview)
        self._forget_everything()

    def show_position(self, position_ms: float, *, playing: bool) -> None:
        """Move the playhead. The view scrolls when the playhead leaves it, also after a jump."""
        before, self.state.position_ms = self.state.position_ms, position_ms
        was_visible = 0 <= self.scale.to_px(before) <= self.room_px
        x = self.scale.to_px(position_ms)
        if not 0 <= x <= self.room_px and self._over.drag is None:
            jumped = abs(position_ms - before) > 1500
            if playing and was_visible and not jumped:
                self.set_scale(replace(self.scale, start_ms=position_ms - 0.1 * self.room_px / self.scale.px_per_ms))
            elif jumped or was_visible:
                self.set_scale(replace(self.scale, start_ms=position_ms - 0.5 * self.room_px / self.scale.px_per_ms))
        if self._over.open is not None:
            self.update()
            return
        self.update(0, 0, NAMES_PX, RULER_PX)
        for at_ms in (before, position_ms):
            left = NAMES_PX + round(self.scale.to_px(at_ms))
            self.update(left - 8, 0, 16, self.height())

    def show_open(self, stretch: OpenInterval | None) -> None:
        self._over.open = stretch
        self.update()

    def forget_layer(self) -> None:
        """Redraw the static layer."""
        self._layer = None
        self.update()

    def _forget_everything(self) -> None:
        self._names = None
        self.forget_layer()

    @property
    def rows(self) -> Sequence[Row]:
        return self.state.rows

    @property
    def scale(self) -> TimeScale:
        return self.state.scale

    @property
    def room_px(self) -> int:
        """Width of the part below the ruler."""
        return self.state.room_px

    @property
    def rows_height_px(self) -> int:
        return self.state.tops[-1]

    @property
    def scroll_y(self) -> int:
        return self.state.scroll_y

    def set_scale(self, scale: TimeScale) -> None:
        scale = scale.bounded(self.room_px, self.state.duration_ms)
        self._fits = scale.px_per_ms <= whole_session(self.room_px, self.state.duration_ms).px_per_ms * 1.0001
        if scale != self.scale:
            self.state.scale = scale
            self.forget_layer()
        self.view_changed.emit()

    def zoom(self, factor: float, around_px: float | None = None) -> None:
        """Zoom around a pixel of the rows; without one around the playhead, if visible."""
        if around_px is None:
            playhead = self.scale.to_px(self.state.position_ms)
            around_px = playhead if 0 <= playhead <= self.room_px else self.room_px / 2
        self.set_scale(self.scale.zoomed(factor, around_px, width_px=self.room_px, duration_ms=self.state.duration_ms))

    def fit(self) -> None:
        self.set_scale(whole_session(self.room_px, self.state.duration_ms))

    def scroll_across_to(self, start_ms: float) -> None:
        """Set the start of the visible part."""
        self.set_scale(replace(self.scale, start_ms=start_ms))

    def scroll_to(self, y: int) -> None:
        y = min(max(0, y), max(0, self.rows_height_px - (self.height() - RULER_PX)))
        if y != self.state.scroll_y:
            self.state.scroll_y = y
            self._forget_everything()
        self.view_changed.emit()

    def show_row(self, key: str) -> None:
        """Scroll to the row."""
        index = self.places.index_of(key)
        if index is None:
            return
        top, bottom, room = self.state.tops[index], self.state.tops[index + 1], self.height() - RULER_PX
        if top < self.state.scroll_y:
            self.scroll_to(top)
        elif bottom > self.state.scroll_y + room:
            self.scroll_to(bottom - room)

    def show_interval(self, start_ms: float, end_ms: float) -> None:
        """Scroll to the interval."""
        if not 0 <= self.scale.to_px(start_ms) <= self.room_px - 40 or self.scale.to_px(end_ms) > self.room_px:
            self.set_scale(replace(self.scale, start_ms=start_ms - 0.2 * self.room_px / self.scale.px_per_ms))

    # ---- selection

    @property
    def selected(self) -> Annotation | None:
        return self._over.selected

    def select(self, annotation_id: str) -> None:
        if annotation_id != self._selected:
            self._over.selected = self.places.find(annotation_id) if annotation_id else None
            self._selected = "" if self._over.selected is None else annotation_id
            self.update()
            self.selection_changed.emit()

    @property
    def active(self) -> Row | None:
        """The coder's active tier."""
        index = self.places.index_of(self.state.active)
        return None if index is None else self.rows[index]

    def activate(self, key: str) -> None:
        if key != self.state.active:
            self.state.active = key
            self._forget_everything()
            self.selection_changed.emit()

    # ---- mouse

    def mousePressEvent(self, event: QMouseEvent) -> None:
        point = event.position()
        hit = self.places.hit(point)
        if event.button() == Qt.MouseButton.MiddleButton:
            self._over.drag = Drag("pan", point, self.places.ms_at(point), start_ms=self.scale.start_ms)
            return
        if event.button() != Qt.MouseButton.LeftButton or self._over.drag is not None:
            return
        at_ms = self.places.ms_at(point)
        if hit.part == "names":
            row = self.rows[hit.row]
            if row.own:
                self.activate(row.key)
            if point.x() >= NAMES_PX - MENU_PX:
                self.row_menu_requested.emit(row.key, event.globalPosition().toPoint())
            else:
                self._over.drag = Drag("row", point, at_ms, hit.row, target=hit.row)
        elif hit.part == "row" and self.rows[hit.row].kind == "tier":
            if self.rows[hit.row].own:
                self.activate(self.rows[hit.row].key)
            self._press_tier(hit, point, at_ms)
        elif hit.part in ("ruler", "row", "below"):
            self._over.drag = Drag("seek", point, at_ms, moving=True)
            self.seek_requested.emit(self.places.bounded(at_ms))

    def _press_tier(self, hit: Hit, point: QPointF, at_ms: float) -> None:
        item = hit.annotation
        if item is not None:
            self.select(item.annotation_id)
            if not self.rows[hit.row].own:
                self.seek_requested.emit(float(item.start_ms))
                return
            kind: DragKind = "start" if hit.edge == "start" else "end" if hit.edge == "end" else "move"
            self._over.drag = Drag(kind, point, at_ms, hit.row, item, item.start_ms, item.end_ms, target=hit.row)
            return
        self.select("")
        if self.rows[hit.row].own:
            start_ms = self.places.snap(at_ms, hit.row)
            self._over.drag = Drag("create", point, at_ms, hit.row, None, start_ms, start_ms)
        else:
            self._over.drag = Drag("seek", point, at_ms, moving=True)
            self.seek_requested.emit(self.places.bounded(at_ms))

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        point, drag = event.position(), self._over.drag
        if drag is None:
            self._hover_over(self.places.hit(point))
            return
        if not drag.moving and (point - drag.origin).manhattanLength() < _DRAG_PX:
            return
        if drag.kind not in ("pan", "row"):
            self._scroll_at_edge(point.x())
        at_ms = self.places.ms_at(point)
        match drag.kind:
            case "seek":
                self.seek_requested.emit(self.places.bounded(at_ms))
            case "pan":
                moved_px = point.x() - drag.origin.x()
                self.set_scale(replace(self.scale, start_ms=drag.start_ms - moved_px / self.scale.px_per_ms))
            case "row":
                self._over.drag = replace(drag, moving=True, target=self.places.row_slot(point.y()))
                self.update()
            case _:
                self._over.drag = self.places.dragged(replace(drag, moving=True), point, at_ms)
                self._over.refused = self.places.overlaps(self._over.drag)
                self.update()

    def _scroll_at_edge(self, x: float) -> None:
        """Scroll while dragging beyond an edge."""
        over = min(0.0, x - NAMES_PX) + max(0.0, x - (self.width() - 2))
        if over:
            self.scroll_across_to(self.scale.start_ms + min(40.0, max(-40.0, over)) / self.scale.px_per_ms)

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        drag, self._over.drag = self._over.drag, None
        if drag is None:
            return
        self._over.refused = False
        self.update()
        if drag.kind == "row" and drag.moving:
            if drag.target not in (drag.row, drag.row + 1):
                place = drag.target - 1 if drag.target > drag.row else drag.target
                self.row_moved.emit(self.rows[drag.row].key, place)
        elif drag.kind == "create":
            if drag.moving and drag.end_ms - drag.start_ms >= SHORTEST_MS:
                tier = self.rows[drag.row].tier
                if tier is not None:
                    self.create_requested.emit(tier.tier_id, round(drag.start_ms), round(drag.end_ms))
            elif not drag.moving:
                self.seek_requested.emit(self.places.bounded(self.places.ms_at(event.position())))
        elif drag.kind in ("move", "start", "end") and drag.moving and drag.annotation is not None:
            tier = self.rows[drag.target if drag.kind == "move" else drag.row].tier
            times = (round(drag.start_ms), round(drag.end_ms))
            item = drag.annotation
            if tier is not None and (*times, tier.tier_id) != (item.start_ms, item.end_ms, item.tier_id):
                self.move_requested.emit(item.annotation_id, *times, tier.tier_id)

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        hit = self.places.hit(event.position())
        if event.button() != Qt.MouseButton.LeftButton:
            return
        if hit.part == "names" and event.position().x() < NAMES_PX - MENU_PX:
            self._over.drag = None
            self.row_opened.emit(self.rows[hit.row].key)
        elif hit.annotation is not None and self.rows[hit.row].own:
            self._over.drag = None
            self.rename_requested.emit(hit.annotation.annotation_id)
        else:
            self.mousePressEvent(event)

    def give_up(self) -> bool:
        """Cancel a drag; False if there is none."""
        dragging, self._over.drag = self._over.drag is not None, None
        self._over.refused = False
        self.update()
        return dragging

    def contextMenuEvent(self, event: QContextMenuEvent) -> None:
        if event.reason() == QContextMenuEvent.Reason.Keyboard:
            row, index = self.active, self.places.index_of(self.state.active)
            if row is not None and index is not None:
                below = QPoint(NAMES_PX - MENU_PX, self.state.row_top(index) + row.height_px)
                self.row_menu_requested.emit(row.key, self.mapToGlobal(below))
            return
        hit = self.places.hit(QPointF(event.pos()))
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
        elif event.modifiers() & Qt.KeyboardModifier.ShiftModifier or self.rows_height_px <= self.height() - RULER_PX:
            self._scroll_across(across + down)
        else:
            if across:
                self._scroll_across(across)
            self.scroll_to(round(self.state.scroll_y - down))
        event.accept()

    def _scroll_across(self, pixels: float) -> None:
        self.set_scale(replace(self.scale, start_ms=self.scale.start_ms - pixels / self.scale.px_per_ms))

    def leaveEvent(self, _event: QEvent) -> None:
        self._over.hover = None
        self.update()

    def focusInEvent(self, event: QFocusEvent) -> None:
        super().focusInEvent(event)
        self.selection_changed.emit()

    def focusOutEvent(self, event: QFocusEvent) -> None:
        super().focusOutEvent(event)
        self.selection_changed.emit()

    def event(self, event: QEvent) -> bool:
        if event.type() == QEvent.Type.ToolTip and isinstance(event, QHelpEvent):
            text = self.places.tip_at(QPointF(event.pos()))
            if text:
                QToolTip.showText(event.globalPos(), text, self)
            else:
                QToolTip.hideText()
            return True
        return super().event(event)

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
        if hit != self._over.hover:
            self._over.hover = hit
            self.update()

    # ---- painting

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self.state.width_px, self.state.height_px = self.width(), self.height()
        self._forget_everything()
        self.set_scale(whole_session(self.room_px, self.state.duration_ms) if self._fits else self.scale)
        self.scroll_to(self.state.scroll_y)

    def _on_picture_made(self, _camera: str, _at_ns: object) -> None:
        if any(row.kind == "pictures" for row in self.rows):
            self.forget_layer()

    def paintEvent(self, event: QPaintEvent) -> None:
        ratio = self.devicePixelRatioF()
        if self._layer is None:
            self._layer = self._drawing.rows(self.state, ratio)
        if self._names is None:
            self._names = self._drawing.names(self.state, ratio)
        painter = QPainter(self)
        for layer, left in ((self._layer, NAMES_PX), (self._names, 0)):
            area = event.rect() & QRect(left, 0, round(layer.width() / ratio), self.height())
            if not area.isEmpty():
                inside = QRectF(area.translated(-left, 0))
                source = QRectF(inside.topLeft() * ratio, inside.size() * ratio)
                painter.drawPixmap(QRectF(area), layer, source)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        self._over.paint(painter)
