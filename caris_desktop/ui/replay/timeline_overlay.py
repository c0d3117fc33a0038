"""Dynamic content over the timeline: selection, open interval, drag, playhead."""

from PySide6.QtCore import QPointF, QRect, QRectF, Qt
from PySide6.QtGui import QColor, QFontMetricsF, QPainter, QPen, QPolygonF

from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation.annotation_model import Annotation
from caris_desktop.ui import tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.replay.timeline_drawing import (
    MENU_PX,
    NAMES_PX,
    RULER_PX,
    TEXT_FROM_PX,
    TimelineDrawing,
    TimelineState,
)
from caris_desktop.ui.replay.timeline_geometry import Drag, Hit, TimelineGeometry
from caris_desktop.ui.replay.timeline_model import exact_text, length_text
from caris_desktop.ui.theme import Theme


class OpenInterval(Value):
    """Open interval of a label, begun by its key and ended by the next press."""

    tier_id: str
    value: str
    start_ms: int


class TimelineOverlay:
    """Paints over the static layers on each repaint. ``refused``: the drag cannot be dropped there."""

    def __init__(
        self, theme: Theme, state: TimelineState, geometry: TimelineGeometry, drawing: TimelineDrawing
    ) -> None:
        self._theme = theme
        self._state = state
        self._geometry = geometry
        self._drawing = drawing
        self.selected: Annotation | None = None
        self.open: OpenInterval | None = None
        self.drag: Drag | None = None
        self.refused = False
        self.hover: Hit | None = None

    def paint(self, painter: QPainter) -> None:
        painter.save()
        painter.setClipRect(QRect(NAMES_PX, RULER_PX, self._state.room_px, self._state.height_px - RULER_PX))
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
        if item is None or (self.drag is not None and self.drag.moving and self.drag.kind != "seek"):
            return
        rect = self._geometry.rect_of(item)
        if rect is None:
            return
        painter.setPen(QPen(self._theme.color("text"), 2))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.drawRoundedRect(rect.adjusted(0, 0, 0, -0.5), 3, 3)
        own = next(
            (row.own for row in self._state.rows if row.tier is not None and row.tier.tier_id == item.tier_id), False
        )
        if own and rect.width() >= 24:
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(self._theme.color("text"))
            for x in (rect.left(), rect.right()):
                painter.drawRoundedRect(QRectF(x - 2.5, rect.center().y() - 6, 5, 12), 2, 2)

    def _paint_open(self, painter: QPainter) -> None:
        stretch = self.open
        if stretch is None:
            return
        index = self._geometry.index_of(f"tier {stretch.tier_id}")
        if index is None:
            return
        end_ms = max(self._state.position_ms, stretch.start_ms + 2 / self._state.scale.px_per_ms)
        rect = self._geometry.interval_rect(index, stretch.start_ms, end_ms)
        self._paint_ghost(
            painter, rect, self._drawing.color_of(self._state, self._state.rows[index].coder), stretch.value
        )

    def _paint_drag(self, painter: QPainter) -> None:
        drag = self.drag
        if drag is None or not drag.moving or drag.kind not in ("create", "move", "start", "end"):
            return
        index = drag.target if drag.kind == "move" else drag.row
        rect = self._geometry.interval_rect(index, drag.start_ms, drag.end_ms)
        color = (
            self._theme.color("amber")
            if self.refused
            else self._drawing.color_of(self._state, self._state.rows[index].coder)
        )
        value = "" if drag.annotation is None else drag.annotation.value
        before = None if drag.annotation is None else self._geometry.rect_of(drag.annotation)
        if before is not None:
            ground = self._theme.color("window")
            ground.setAlpha(150)
            painter.fillRect(before, ground)
        self._paint_ghost(painter, rect, color, value)
        text = f"{exact_text(drag.start_ms)} – {exact_text(drag.end_ms)} · {length_text(drag.end_ms - drag.start_ms)}"
        if self.refused:
            text = tr("{stretch} · already occupied").format(stretch=text)
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
        """Paint the times of a drag, above or below it."""
        font = self._theme.font(tokens.KEY_CAP_PX)
        width = QFontMetricsF(font).horizontalAdvance(text) + 14
        left = min(max(NAMES_PX + 4.0, rect.left()), self._state.width_px - width - 4)
        top = rect.top() - 23 if rect.top() - 23 > RULER_PX else rect.bottom() + 4
        note = QRectF(left, top, width, 20)
        painter.setPen(QPen(self._theme.color("line_strong"), 1))
        painter.setBrush(self._theme.color("panel"))
        painter.drawRoundedRect(note, 5, 5)
        painter.setFont(font)
        painter.setPen(self._theme.color("text"))
        painter.drawText(note, int(Qt.AlignmentFlag.AlignCenter), text)

    def _paint_hovered_row(self, painter: QPainter) -> None:
        if self.hover is None or self.hover.part != "names" or self.hover.row >= len(self._state.rows):
            return
        row, top = self._state.rows[self.hover.row], self._state.row_top(self.hover.row)
        rect = QRectF(NAMES_PX - MENU_PX, top + row.height_px / 2 - 8, 16, 16)
        if top >= RULER_PX - row.height_px / 2:
            draw_icon(painter, rect, "dots-three", self._theme.color("text"))

    def _paint_row_slot(self, painter: QPainter) -> None:
        drag = self.drag
        if drag is None or drag.kind != "row" or not drag.moving:
            return
        y = RULER_PX + self._state.tops[min(drag.target, len(self._state.rows))] - self._state.scroll_y
        painter.fillRect(QRectF(0, y - 1.5, self._state.width_px, 3), self._theme.color("blue"))

    def _paint_position(self, painter: QPainter) -> None:
        """Paint the playhead's time in the corner, to the millisecond."""
        painter.setClipping(False)
        painter.setFont(self._theme.font(tokens.STATUS_PX))
        painter.setPen(self._theme.color("dim"))
        place = QRectF(14, 0, NAMES_PX - 28, RULER_PX - 1)
        painter.drawText(
            place, int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft), exact_text(self._state.position_ms)
        )

    def _paint_playhead(self, painter: QPainter) -> None:
        x = self._state.scale.to_px(self._state.position_ms)
        if not -6 <= x <= self._state.room_px + 6:
            return
        painter.setClipRect(NAMES_PX - 6, 0, self._state.room_px + 6, self._state.height_px)
        at = NAMES_PX + x
        color = self._theme.color("blue")
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(color)
        painter.drawRect(QRectF(at - 0.75, RULER_PX - 9, 1.5, self._state.height_px))
        top = RULER_PX - 15
        painter.drawPolygon(QPolygonF([
            QPointF(at - 6, top), QPointF(at + 6, top), QPointF(at + 6, top + 6), QPointF(at, top + 13),
            QPointF(at - 6, top + 6),
        ]))  # fmt: skip
