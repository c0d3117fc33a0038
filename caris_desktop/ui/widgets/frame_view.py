"""Camera view: frame scaled to fit, with boxes around people, labels and messages; clicked floor points."""

import math
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QEvent, QPoint, QPointF, QRect, QRectF, QSizeF, Qt, Signal
from PySide6.QtGui import (
    QAccessible,
    QColor,
    QFont,
    QFontMetricsF,
    QImage,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPen,
    QPolygonF,
)
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.sensing import CameraState, FrameRef, HeadState, People, PersonBox
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.ui import text_formatting, tokens
from caris_desktop.ui.panel import Panel, draw_card_edge
from caris_desktop.ui.theme import Theme, draw_cached, draw_icon
from caris_desktop.ui.widgets.buttons import ActionButton

FARTHEST_M = 8.0
"""Beyond this a pixel covers half a metre or more of floor."""

RING_M = 0.25


class FloorSpot(Value):
    """Floor point in the robot frame."""

    x_m: float
    y_m: float

    @property
    def distance_m(self) -> float:
        return math.hypot(self.x_m, self.y_m)


def model_for(robot: RobotProfile | None, frame: FrameRef, head: HeadState | None) -> CameraModel | None:
    """Model of the frame's camera, scaled to the frame; None if the profile has none."""
    cameras = robot.cameras if robot is not None else ()
    model = next((camera.model for camera in cameras if camera.name == frame.camera), None)
    if model is None:
        return None
    if model.on_head and head is None:
        return None  # the direction of a head camera is unknown without the head's state
    if head is not None:
        model = model.with_head_at(pan_rad=head.pan_rad, tilt_rad=head.tilt_rad)
    return model.scaled_to(frame.width_px, frame.height_px)


def spot_at(model: CameraModel, u_px: float, v_px: float) -> FloorSpot | str:
    """Floor point under a pixel, or the reason why there is none to drive to."""
    point = model.floor_point(u_px, v_px)
    if point is None:
        return tr("That is not on the floor")
    spot = FloorSpot(*point)
    if spot.distance_m > FARTHEST_M:
        return tr("Too far away to select in the picture: more than {distance:.0f} m").format(distance=FARTHEST_M)
    return spot


def ring_px(model: CameraModel, spot: FloorSpot) -> list[tuple[float, float]]:
    """Circle on the floor around a point, in px; empty if part of it is behind the camera."""
    corners = []
    for step in range(32):
        angle = 2 * math.pi * step / 32
        corner = model.pixel_of(spot.x_m + RING_M * math.cos(angle), spot.y_m + RING_M * math.sin(angle), 0.0)
        if corner is None:
            return []
        corners.append(corner)
    return corners


BOXES_SOLID_S = 0.25
BOXES_GONE_S = 0.8
"""Between these ages relative to the frame, boxes fade out."""

_FORESEEN_S = 0.25
_STILL_PER_S = 0.08  # shares of the picture per second; slower motion is tracker jitter
_CHIP_COLORS = {
    "hint": "box_unnamed", "moving": "box_unnamed", "still": "box_named", "warning": "box_warning",
    "good": "box_named", "blocked": "box_warning", "slowing": "box_warning", "override": "box_warning",
    "unknown": "box_warning",
}  # fmt: skip
_CHIP_ICONS = {
    "moving": "arrow-fat-up", "still": "anchor-simple", "unknown": "question",
    "warning": "warning", "good": "check", "blocked": "prohibit", "slowing": "shield-warning",
    "override": "shield-slash",
}  # fmt: skip
_CLICK_PX = 6
_LIT_ALPHA = 60  # white over the person being named, who stays recognisable
_DASH_PATTERN = (5.0, 4.0)  # in widths of the pen


def detections_fit(people: People | None, frame: FrameRef | None) -> bool:
    """Whether the boxes belong to about the frame on display.

    By time stamp: frame numbers are shared by all cameras.
    """
    if people is None or frame is None:
        return False
    return people.camera == frame.camera and abs(frame.stamp_ns - people.stamp_ns) < BOXES_GONE_S * 1e9


def box_strength(people: People, frame: FrameRef) -> float:
    """Opacity of the boxes, 0 to 1: full while recent, decreasing with age."""
    behind_s = (frame.stamp_ns - people.stamp_ns) / 1e9
    return min(1.0, max(0.0, (BOXES_GONE_S - behind_s) / (BOXES_GONE_S - BOXES_SOLID_S)))


def moved_since(before: People | None, people: People, frame: FrameRef) -> dict[int, float]:
    """Predicted motion of each track from its box to the frame on display, in px to the right.

    Detection lags behind the video: while the robot turns, unpredicted boxes would trail. The motion between the last
    two detections is extrapolated by 0.25 s at most.
    """
    ahead_s = min((frame.stamp_ns - people.stamp_ns) / 1e9, _FORESEEN_S)
    between_s = (people.stamp_ns - before.stamp_ns) / 1e9 if before is not None else 0.0
    if before is None or ahead_s <= 0.0 or not 0.0 < between_s <= 2 * _FORESEEN_S:
        return {}
    earlier = {box.track: box for box in before.boxes}
    moved = {}
    for box in people.boxes:
        old = earlier.get(box.track)
        if old is None:
            continue
        right = (box.left_px + box.width_px / 2 - old.left_px - old.width_px / 2) / between_s
        if abs(right) > _STILL_PER_S * people.frame_width_px:
            moved[box.track] = right * ahead_s
    return moved


class FrameView(QWidget):
    """Shows the newest frame, scaled to fit, with boxes. An old frame is never shown as live."""

    accessible_role = QAccessible.Role.Graphic

    clicked = Signal()
    hovered = Signal(object)  # QPointF in pixels of the frame, None outside
    floor_clicked = Signal(QPointF, QPointF)  # pixels of the frame, of the view

    def __init__(self, theme: Theme, panel: Panel) -> None:
        super().__init__(panel)
        self._theme = theme
        self._panel = panel
        self._image: QImage | None = None
        self._pixels: NDArray[np.uint8] | None = None
        self._frame: FrameRef | None = None
        self._people: People | None = None
        self._people_before: People | None = None
        self._names: dict[str, tuple[str, bool]] = {}
        self._selected = ""
        self._naming = ""
        self._suggested: frozenset[str] = frozenset()
        self._freshness = "none"
        self._age_s: float | None = None
        self._late = False
        self._lost_reason = ""
        self._camera = ""
        self._camera_state: CameraState | None = None
        self.out_of_reach = False
        self.chips: list[tuple[str, str]] = []
        self._model: CameraModel | None = None
        self.spot: FloorSpot | None = None
        self._press: QPointF | None = None
        self.whole_card = False
        """Whether the picture is the whole card, without a title bar."""
        self.setMouseTracking(True)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setAccessibleName(tr("Picture from the robot's camera"))
        # Every pixel is painted, so Qt need not paint what lies below.
        self.setAttribute(Qt.WidgetAttribute.WA_OpaquePaintEvent)

    @property
    def frame(self) -> FrameRef | None:
        """Frame on display; None while a message is shown instead."""
        return self._frame if self._freshness in ("fresh", "stale") else None

    def show_frame(self, image_bgr: NDArray[np.uint8], frame: FrameRef) -> None:
        height, width = image_bgr.shape[:2]
        # QImage shares the array's memory, so the array must outlive it.
        self._pixels = image_bgr
        self._image = QImage(image_bgr.data, width, height, 3 * width, QImage.Format.Format_BGR888)
        self._frame = frame
        self.update()

    @property
    def model(self) -> CameraModel | None:
        """Camera model of the frame on display, for clicks that send the robot."""
        return self._model if self.frame is not None else None

    def show_model(self, model: CameraModel | None) -> None:
        self._model = model
        if model is None:
            self.spot = None

    def show_spot(self, spot: FloorSpot | None) -> None:
        """Show a marker on the floor."""
        if spot != self.spot:
            self.spot = spot
            self.setCursor(Qt.CursorShape.ArrowCursor if spot is None else Qt.CursorShape.PointingHandCursor)
            self.update()

    def to_frame(self, point: QPointF) -> QPointF | None:
        """Frame pixel at a point of the view; None outside the picture."""
        picture, frame = self.picture_rect(), self.frame
        if frame is None or not picture.contains(point):
            return None
        return QPointF(
            (point.x() - picture.left()) / picture.width() * frame.width_px,
            (point.y() - picture.top()) / picture.height() * frame.height_px,
        )

    def to_view(self, u_px: float, v_px: float) -> QPointF:
        """Point of the view for a frame pixel."""
        picture, frame = self.picture_rect(), self.frame
        if frame is None:
            return picture.center()
        return QPointF(
            picture.left() + u_px / frame.width_px * picture.width(),
            picture.top() + v_px / frame.height_px * picture.height(),
        )

    def show_people(self, people: People) -> None:
        self._people_before, self._people = self._people, people
        # With running video the next frame paints them, once instead of twice.
        if self._freshness != "fresh":
            self.update()

    def show_names(self, names: dict[str, tuple[str, bool]], suggested: frozenset[str] = frozenset()) -> None:
        """Set labels by person id, and whether each is a given name. Boxes with a ``suggested`` identity are amber."""
        self._names, self._suggested = names, suggested
        self.update()

    def show_selected(self, person_id: str) -> None:
        """Highlight the selected person's box; empty for none."""
        if person_id != self._selected:
            self._selected = person_id
            self.update()

    def show_naming(self, person_id: str) -> None:
        """Highlight the box of the person being named; empty for none."""
        if person_id != self._naming:
            self._naming = person_id
            self.update()

    def show_freshness(self, freshness: str) -> None:
        self._freshness = freshness
        if freshness in ("lost", "none"):
            self._image = self._pixels = self._frame = self.spot = None
        self.update()

    def show_camera(self, name: str) -> None:
        """Set the camera's name, empty if it is the only one."""
        self._camera = name
        # A frame of another camera must not be shown as this one's.
        if self._frame is not None and name and self._frame.camera != name:
            self._image = self._pixels = self._frame = self.spot = None
            self.update()

    def show_state(self, state: CameraState | None) -> None:
        """Set the reported state of this computer's camera."""
        self._camera_state = state

    def show_lost_reason(self, reason: str) -> None:
        """Set the text added when the video is lost."""
        self._lost_reason = reason

    def show_out_of_reach(self, out_of_reach: bool) -> None:
        """Set whether the robot is unreachable, so that no video can be expected."""
        if out_of_reach != self.out_of_reach:
            self.out_of_reach = out_of_reach
            self.update()

    def show_chips(self, chips: list[tuple[str, str]]) -> None:
        if chips != self.chips:
            self.chips = chips
            self.update()

    def show_age(self, age_s: float | None, *, late: bool = False) -> None:
        """Set the age; ``late``: frames arrive with this delay."""
        self._age_s, self._late = age_s, late
        if self._freshness != "fresh":
            self.update()

    def visible_detections(self) -> list[tuple[str, bool]]:
        """Labels of the visible boxes, and whether each person has a name."""
        if self._people is None or not detections_fit(self._people, self.frame):
            return []
        return [self._words_for(box) for box in self._people.boxes]

    def _words_for(self, box: PersonBox) -> tuple[str, bool]:
        return self._names.get(box.person_id, (tr("Person {number}").format(number=box.track), False))

    def picture_rect(self) -> QRectF:
        """Rectangle of the scaled picture, with its aspect ratio."""
        return QRectF(self.rect()) if self._image is None else fitted(self._image, QRectF(self.rect()))

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        bounds, ground = QRectF(self.rect()), self._theme.color("video_ground")
        if self._image is None or self._freshness in ("lost", "none"):
            painter.fillRect(bounds, ground)
            self._paint_words(painter)
        else:
            picture = self.picture_rect()
            if self._freshness == "stale":
                painter.fillRect(bounds, ground)
                painter.setOpacity(0.4)
            else:
                for beside in (
                    QRectF(bounds.left(), bounds.top(), bounds.width(), picture.top() - bounds.top()),
                    QRectF(bounds.left(), picture.bottom(), bounds.width(), bounds.bottom() - picture.bottom()),
                    QRectF(bounds.left(), picture.top(), picture.left() - bounds.left(), picture.height()),
                    QRectF(picture.right(), picture.top(), bounds.right() - picture.right(), picture.height()),
                ):
                    painter.fillRect(beside, ground)
            painter.drawImage(picture, self._image)
            painter.setOpacity(1.0)
            if self._freshness == "stale":
                self._paint_stale(painter)
            elif detections_fit(self._people, self._frame):
                self._paint_detections(painter)
            if self._freshness == "fresh":
                self._paint_spot(painter)
        for text, role, place in self._chip_places():
            paint = partial(self._paint_chip, text, role, place.width())
            draw_cached(painter, place.topLeft(), place.size(), ("chip", text, role), paint)
        # The card belongs to the panel: a camera strip may be next to the view.
        card = QRectF(self._panel.rect()).translated(-QPointF(self.pos()))
        draw_card_edge(painter, self._theme, card, active=self._panel.active, whole=self.whole_card)

    def words_without_picture(self) -> tuple[str, str]:
        """Message in place of the picture: title and explanation."""
        if not self._panel.state.present.live:
            return tr("No picture"), tr("No picture was recorded at this moment.")
        if self._freshness == "lost" and self._late:
            old = tr("Video latency is {age}. {reason}")
            return tr("No live picture"), old.format(
                age=text_formatting.age(self._age_s or 0.0), reason=self._lost_reason
            )
        if self._camera and (self._freshness == "lost" or self._camera_state is not None):
            silent = text_formatting.no_picture(self._age_s, self._camera_state)
            return text_formatting.camera_title(self._camera), f"{silent} {self._lost_reason}"
        if self._freshness == "lost":
            silent = text_formatting.age(self._age_s or 0.0)
            nothing = tr("The camera has sent nothing for {time}. {reason}")
            return tr("No picture"), nothing.format(time=silent, reason=self._lost_reason)
        if self.out_of_reach:
            return tr("No picture"), tr("The robot is out of reach. The console keeps trying.")
        return tr("Waiting for the camera"), tr("The picture appears here as soon as it arrives.")

    def _paint_words(self, painter: QPainter) -> None:
        theme = self._theme
        center = QRectF(self.rect()).center()
        head, sub = self.words_without_picture()
        draw_icon(
            painter, QRectF(center.x() - 20, center.y() - 66, 40, 40), "video-camera-slash", theme.color("video_dim")
        )
        painter.setPen(theme.color("video_text"))
        painter.setFont(theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        painter.drawText(QRectF(8, center.y() - 18, self.width() - 16, 28), Qt.AlignmentFlag.AlignCenter, head)
        painter.setPen(theme.color("video_dim"))
        painter.setFont(theme.font(tokens.BODY_PX))
        painter.drawText(
            QRectF(16, center.y() + 12, self.width() - 32, 48),
            int(Qt.AlignmentFlag.AlignHCenter | Qt.AlignmentFlag.AlignTop | Qt.TextFlag.TextWordWrap), sub,
        )  # fmt: skip

    def _paint_stale(self, painter: QPainter) -> None:
        text = tr("Picture is {age} old").format(age=text_formatting.age(self._age_s or 0.0))
        font = self._theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD)
        width = math.ceil(QFontMetricsF(font).horizontalAdvance(text)) + 32
        place = QRectF((self.width() - width) // 2, self.height() // 2 - 22, width, 44)
        ink, ground = self._theme.color("video_text"), self._theme.color("video_chip")
        paint_words(painter, place, text, font=font, ink=ink, ground=ground, radius_px=8)

    def _paint_detections(self, painter: QPainter) -> None:
        people, frame = self._people, self._frame
        if people is None or frame is None or people.frame_width_px <= 0:
            return
        moved = moved_since(self._people_before, people, frame)
        painter.setOpacity(box_strength(people, frame))
        picture = self.picture_rect()
        scale_x, scale_y = picture.width() / people.frame_width_px, picture.height() / people.frame_height_px
        for thing in people.things:
            left, top = picture.left() + thing.left_px * scale_x, picture.top() + thing.top_px * scale_y
            area = QRectF(left, top, thing.width_px * scale_x, thing.height_px * scale_y)
            self._paint_thing(painter, area.intersected(picture.adjusted(2, 2, -2, -2)), thing.label)
        rects, tags = [], []
        for box in people.boxes:
            label, named = self._words_for(box)
            label = " · ".join(part for part in (label, text_formatting.person_state(box)) if part)
            right_px = moved.get(box.track, 0.0)
            rect = QRectF(
                picture.left() + (box.left_px + right_px) * scale_x, picture.top() + box.top_px * scale_y,
                box.width_px * scale_x, box.height_px * scale_y,
            ).intersected(picture.adjusted(2, 2, -2, -2))  # fmt: skip
            if self._naming and box.person_id == self._naming:
                painter.fillRect(rect, QColor(255, 255, 255, _LIT_ALPHA))
            if box.person_id and box.person_id in (self._selected, self._naming):
                self._paint_selected(painter, rect)
            suggested = box.person_id in self._suggested
            role = "box_warning" if suggested else "box_named" if named else "box_unnamed"
            self._paint_box_edge(painter, rect, role, solid=named and not suggested)
            rects.append(rect)
            tags.append((label, role))
        sizes = [self._tag_size(label).toTuple() for label, _role in tags]
        controls = [part for part in self.findChildren(ActionButton) if part.isVisible() and part.is_seen]
        others = [*(place for _text, _role, place in self._chip_places()), QRectF(self._panel.covered)]
        others += [QRectF(QRect(part.mapTo(self, QPoint()), part.size())) for part in controls]
        for place, (label, role) in zip(tag_places(rects, sizes, picture, others), tags, strict=True):
            if place is not None:
                self._paint_tag(painter, place, label, role)
        painter.setOpacity(1.0)

    def _paint_thing(self, painter: QPainter, rect: QRectF, label: str) -> None:
        """Paint an object that is not a person: thin grey outline with the name inside."""
        for bar in _bars(rect.toRect(), 1):
            painter.fillRect(bar, self._theme.color("video_dim"))
        font = self._theme.font(tokens.STATUS_PX)
        size = QSizeF(math.ceil(QFontMetricsF(font).horizontalAdvance(label)) + 8, 18)
        if size.width() <= rect.width() and size.height() <= rect.height():
            ink, ground = self._theme.color("video_dim"), self._theme.color("video_chip")
            place = QRectF(rect.topLeft(), size)
            paint_words(painter, place, label, font=font, ink=ink, ground=ground, radius_px=0)

    def _paint_selected(self, painter: QPainter, rect: QRectF) -> None:
        """Paint a second, light-on-dark outline that is visible on any image."""
        edge = rect.toRect().adjusted(-4, -4, 4, 4)
        for role, outer in (("on_box", edge.adjusted(-1, -1, 1, 1)), ("video_text", edge)):
            for bar in _bars(outer, 3):
                painter.fillRect(bar, self._theme.color(role))

    def _paint_box_edge(self, painter: QPainter, rect: QRectF, role: str, *, solid: bool) -> None:
        """Paint a box, dashed for an unnamed person."""
        color = self._theme.color(role)
        dashes = QPen(color, 2, Qt.PenStyle.CustomDashLine, Qt.PenCapStyle.FlatCap)
        dashes.setDashPattern(_DASH_PATTERN)
        for bar in _bars(rect.toRect().adjusted(-1, -1, 1, 1), 2):
            if solid:
                painter.fillRect(bar, color)
            elif bar.width() == 2:
                painter.setPen(dashes)
                painter.drawLine(bar.left() + 1, bar.top(), bar.left() + 1, bar.bottom() + 1)
            else:
                painter.setPen(dashes)
                painter.drawLine(bar.left(), bar.top() + 1, bar.right() + 1, bar.top() + 1)

    def _tag_size(self, text: str) -> QSizeF:
        metrics = QFontMetricsF(self._theme.font(tokens.STATUS_PX, tokens.WEIGHT_SEMIBOLD))
        return QSizeF(math.ceil(metrics.horizontalAdvance(text)) + 14, 21)

    def _paint_tag(self, painter: QPainter, at: QPointF, text: str, role: str) -> None:
        """Paint a label, 21 px high, cached per text."""
        font = self._theme.font(tokens.STATUS_PX, tokens.WEIGHT_SEMIBOLD)
        ink, place = self._theme.color("on_box"), QRectF(at, self._tag_size(text))
        paint_words(painter, place, text, font=font, ink=ink, ground=self._theme.color(role))

    def _paint_spot(self, painter: QPainter) -> None:
        spot, model, theme = self.spot, self.model, self._theme
        corners = ring_px(model, spot) if spot is not None and model is not None else []
        if spot is None or not corners:
            return
        painter.save()
        painter.setClipRect(self.picture_rect())
        ring = QPolygonF([self.to_view(u_px, v_px) for u_px, v_px in corners])
        painter.setBrush(Qt.BrushStyle.NoBrush)
        for color, width in (("video_ground", 4.5), ("box_named", 2.5)):
            painter.setPen(QPen(theme.color(color), width))
            painter.drawPolygon(ring)
        text, bounds = f"{spot.distance_m:.1f} m", ring.boundingRect()
        middle = bounds.center().x() - self._tag_size(text).width() / 2
        self._paint_tag(painter, QPointF(middle, bounds.top() - 26), text, "box_named")
        painter.restore()

    def _chip_places(self) -> list[tuple[str, str, QRectF]]:
        """Texts, roles and rectangles of labels that fit: each in the lower of two rows if it has room there."""
        metrics = QFontMetricsF(self._theme.font(tokens.BODY_PX))
        lefts, places = [12.0, 12.0], []
        for text, role in self.chips:
            width = math.ceil(metrics.horizontalAdvance(text)) + 24.0 + (22 if role in _CHIP_ICONS else 0)
            row = next((row for row, left in enumerate(lefts) if left + width <= self.width() - 8), None)
            if row is not None:
                places.append((text, role, QRectF(lefts[row], self.height() - 46.0 - 40 * row, width, 34)))
                lefts[row] += width + 8
        return places

    def _paint_chip(self, text: str, role: str, width: float, painter: QPainter) -> None:
        theme = self._theme
        rect = QRectF(0, 0, width, 34)
        painter.setPen(QPen(theme.color("video_line"), 1))
        painter.setBrush(theme.color("video_chip"))
        painter.drawRoundedRect(rect.adjusted(0.5, 0.5, -0.5, -0.5), 8, 8)
        color = theme.color(_CHIP_COLORS.get(role, "video_text"))
        if role in _CHIP_ICONS:
            draw_icon(painter, QRectF(10, 8, 18, 18), _CHIP_ICONS[role], color)
            rect = rect.adjusted(22, 0, 0, 0)
        painter.setFont(theme.font(tokens.BODY_PX))
        painter.setPen(color)
        painter.drawText(rect, Qt.AlignmentFlag.AlignCenter, text)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self.setFocus(Qt.FocusReason.MouseFocusReason)
        self.clicked.emit()
        self._press = event.position() if event.button() == Qt.MouseButton.LeftButton else None
        super().mousePressEvent(event)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        if self._model is not None:
            self.hovered.emit(self.to_frame(event.position()))
        super().mouseMoveEvent(event)

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        press, self._press = self._press, None
        where = event.position()
        if press is not None and (where - press).manhattanLength() <= _CLICK_PX and self._model is not None:
            at = self.to_frame(where)
            if at is not None:
                self.floor_clicked.emit(at, where)
        super().mouseReleaseEvent(event)

    def leaveEvent(self, event: QEvent) -> None:
        self.hovered.emit(None)
        super().leaveEvent(event)


def paint_words(
    painter: QPainter, place: QRectF, text: str, *, font: QFont, ink: QColor, ground: QColor, radius_px: float = 4
) -> None:
    """Paint a text on a rounded ground, cached."""
    rect = QRectF(QPointF(0, 0), place.size())

    def paint(onto: QPainter) -> None:
        onto.setPen(Qt.PenStyle.NoPen)
        onto.setBrush(ground)
        onto.drawRoundedRect(rect, radius_px, radius_px)
        onto.setFont(font)
        onto.setPen(ink)
        onto.drawText(rect, Qt.AlignmentFlag.AlignCenter, text)

    key = ("words", text, font.key(), ink.name(), ground.name(QColor.NameFormat.HexArgb), radius_px)
    draw_cached(painter, place.topLeft(), place.size(), key, paint)


def _bars(edge: QRect, width: int) -> tuple[QRect, QRect, QRect, QRect]:
    """Outline of this width as four bars, which do not overlap."""
    inside = edge.adjusted(0, width, 0, -width)
    return (
        QRect(edge.left(), edge.top(), edge.width(), width),
        QRect(edge.left(), inside.bottom() + 1, edge.width(), width),
        QRect(edge.left(), inside.top(), width, inside.height()),
        QRect(edge.right() - width + 1, inside.top(), width, inside.height()),
    )


def fitted(picture: QImage, room: QRectF) -> QRectF:
    """Rectangle of the picture scaled to fit, in the middle of ``room``, with its aspect ratio."""
    size = picture.size().toSizeF().scaled(room.size(), Qt.AspectRatioMode.KeepAspectRatio)
    return QRectF(room.center() - QPointF(size.width() / 2, size.height() / 2), size)


_BETWEEN_PX = 1.0


def tag_places(
    boxes: Sequence[QRectF], tags: Sequence[tuple[float, float]], picture: QRectF, other_words: Sequence[QRectF] = ()
) -> list[QPointF | None]:
    """Placement of name labels over a picture without overlap.

    Top left corner of each box's label of that width and height, in order; all in px.

    A label is on top of its box, or inside its upper edge where the picture ends, and whole in the picture. If it
    would cover another label or ``other_words``, it moves up by one or more rows, or down into its box; larger boxes,
    which are closer people, come first. Without a free position it is None: overlapping names are illegible.
    """
    places: list[QPointF | None] = [None] * len(boxes)
    taken = list(other_words)
    for number in sorted(range(len(boxes)), key=lambda number: -boxes[number].height()):
        box, (width, height) = boxes[number], tags[number]
        left = max(picture.left(), min(box.left() - 1, picture.right() - width))
        for top in _rows(box, height, picture):
            tag = QRectF(left, top, width, height)
            if not any(tag.intersects(other) for other in taken):
                taken.append(tag)
                places[number] = tag.topLeft()
                break
    return places


def _rows(box: QRectF, height: float, picture: QRectF) -> Iterator[float]:
    """Candidate positions: on the box, above it, then inside."""
    top = box.top() - height
    while top >= picture.top():
        yield top
        top -= height + _BETWEEN_PX
    top = box.top() + 1
    while top + height <= picture.bottom() and (top < box.bottom() or top == box.top() + 1):
        yield top
        top += height + _BETWEEN_PX
