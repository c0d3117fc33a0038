"""Map painting: trail, scan, goal, places, people and robot over the grid, and the target being chosen."""

import math
from dataclasses import field
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QPointF, QRectF, QSizeF, Qt
from PySide6.QtGui import QFontMetricsF, QPainter, QPen, QPolygonF
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.events import GoalChanged
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import PersonPlace
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.scenario.scenario_model import Place
from caris_desktop.ui import tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.pixmap_cache import PixmapCache
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.map_grid import GridLayer
from caris_desktop.ui.widgets.map_layers import (
    Trail,
    distinct_dots,
    draw_arrow,
    draw_robot,
    outline_in_map,
    polygon,
    thinned,
)
from caris_desktop.ui.widgets.map_viewport import MapViewport

_CHIP_COLORS = {"warning": "amber", "good": "green", "bad": "red", "hint": "text"}
_CHIP_ICONS = {"warning": "warning", "good": "check", "bad": "warning-octagon", "hint": ""}

# Candidate label positions: px from mark to left edge, share of the width to subtract, px to the top.
_BESIDE_A_FLAG = ((11.0, 0.0, -10.0), (-11.0, 1.0, -10.0), (0.0, 0.5, -31.0), (0.0, 0.5, 11.0))
_BESIDE_A_PERSON = ((10.0, 0.0, -10.0), (-10.0, 1.0, -10.0), (10.0, 0.0, 11.0), (10.0, 0.0, -31.0), (-10.0, 1.0, 11.0))
# For a wider ring, the cached pixmap costs more memory than it saves time.
_KEPT_RING_PX = 48
_SYMBOL_PX, _LEGEND_GAP_PX = 15.0, 10.0
_SCALE_BAR_ROOM_PX = 120.0
_PeopleRects = list[tuple[QRectF, QRectF | None]]

Tool = Literal["look", "goal", "pose", "place"]


class Aim(Value):
    """Target being chosen on the map, with its heading as far as set."""

    at: QPointF  # metres in the map
    heading_rad: float | None
    anchored: bool  # position fixed, heading still open


@dataclass(slots=True)
class MapState:
    """Map state without the grid.

    ``people``: position, label, and whether it is a given name; ``meant``: id of the selected person. ``chips``: lines
    of (text, role) at the upper edge; roles: warning, good, bad, hint. ``mark``: point that a popup asks about.
    ``unconfirmed``: the pose was not confirmed after a crash.
    """

    places: tuple[Place, ...] = ()
    pose: Pose2D | None = None
    pose_freshness: str = "none"
    unconfirmed: bool = False
    scan_points_m: NDArray[np.float64] | None = None
    scan_freshness: str = "none"
    path_m: NDArray[np.float64] | None = None
    people: tuple[tuple[PersonPlace, str, bool], ...] = ()
    people_freshness: str = "none"
    meant: str = ""
    outline_m: tuple[tuple[float, float], ...] = ()
    guard: tuple[str, float | None] = ("absent", None)
    goal: GoalChanged | None = None
    chips: list[tuple[str, str]] = field(default_factory=list)
    hint: str = ""
    mark: QPointF | None = None
    waiting: str = field(default_factory=lambda: tr("Waiting for the map"))
    trail: Trail = field(default_factory=Trail)
    show_trail: bool = True
    rotate: bool = False
    tool: Tool = "look"
    aim: Aim | None = None
    pointer: QPointF | None = None
    hovered: str | None = None


class MapDrawing:
    """Paints ``map_state`` over the grid; ``place_rects`` then has the clickable rectangle of each place."""

    def __init__(self, theme: Theme, view: QWidget, viewport: MapViewport, grid: GridLayer) -> None:
        self._theme = theme
        self._view = view
        self._viewport = viewport
        self._grid = grid
        self.map_state = MapState()
        self.painted = PixmapCache()
        self.place_rects: dict[str, QRectF] = {}

    def paint(self, painter: QPainter) -> None:
        self._paint_trail(painter)
        self._paint_scan(painter)
        self._paint_goal(painter)
        people = self._people_rects()
        self._paint_places(painter, people)
        self._paint_people(painter, people)
        if self.map_state.pose is not None and self.map_state.pose_freshness != "none":
            self._paint_robot(painter, self.map_state.pose)
        if self._grid.newest is None:
            self._paint_waiting(painter)
        self._paint_aim(painter)
        self._paint_scale_bar(painter)
        self._paint_legend(painter)
        self._paint_chips(painter)

    def _paint_waiting(self, painter: QPainter) -> None:
        painter.setFont(self._theme.font())
        painter.setPen(self._theme.color("dim"))
        where = QRectF(self._view.rect())
        if self.map_state.pose is not None:
            where = QRectF(0, where.height() - 40, where.width(), 30)
        painter.drawText(where, Qt.AlignmentFlag.AlignCenter, self.map_state.waiting)

    def _paint_trail(self, painter: QPainter) -> None:
        if not self.map_state.show_trail or len(self.map_state.trail) < 2:
            return
        to_view = self._viewport.transform()
        color = self._theme.color("blue")
        painter.setRenderHint(QPainter.RenderHint.Antialiasing, False)
        for strength, points_m in self.map_state.trail.pieces():
            color.setAlpha(round(30 + 110 * strength))
            painter.setPen(QPen(color, 2))
            painter.drawPolyline(polygon(thinned(points_m.astype(np.float32), 160), to_view))
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)

    def _paint_scan(self, painter: QPainter) -> None:
        points_m = self.map_state.scan_points_m
        if points_m is None or self.map_state.scan_freshness not in ("fresh", "stale"):
            return
        to_view = self._viewport.transform()
        matrix = np.array([[to_view.m11(), to_view.m12()], [to_view.m21(), to_view.m22()]])
        points_px = points_m @ matrix + (to_view.dx(), to_view.dy())
        dots = distinct_dots(points_px, self._view.width(), self._view.height())
        dot = self.painted.picture(painter, QSizeF(3, 3), ("dot", self.map_state.scan_freshness), self._paint_dot)
        # Copying dots takes less than a third of the time of drawPoints with a pen of this width.
        for x, y in dots.tolist():
            painter.drawPixmap(x - 1, y - 1, dot)

    def _paint_dot(self, onto: QPainter) -> None:
        color = self._theme.color("lidar")
        color.setAlpha(230 if self.map_state.scan_freshness == "fresh" else 80)
        onto.setPen(Qt.PenStyle.NoPen)
        onto.setBrush(color)
        onto.drawEllipse(QRectF(0, 0, 3, 3))

    def _paint_goal(self, painter: QPainter) -> None:
        if self.map_state.goal is None:
            return
        goal, color = self.map_state.goal.target_in_map, self._theme.color("green")
        target = self._viewport.to_view(goal.x_m, goal.y_m)
        painter.setBrush(Qt.BrushStyle.NoBrush)
        if self.map_state.path_m is not None:
            painter.setPen(QPen(color, 2.5, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
            painter.drawPolyline(polygon(self.map_state.path_m, self._viewport.transform()))
        elif self.map_state.pose is not None:
            # Dashed straight line to the goal until the robot reports its path.
            pen = QPen(color, 2.5)
            pen.setDashPattern([4, 3])
            painter.setPen(pen)
            painter.drawLine(self._viewport.to_view(self.map_state.pose.x_m, self.map_state.pose.y_m), target)
        draw_arrow(painter, target, goal.heading_rad + self._viewport.turn_rad, color=color, length_px=30)

    def _paint_places(self, painter: QPainter, people: _PeopleRects) -> None:
        font = self._theme.font(tokens.STATUS_PX, tokens.WEIGHT_MEDIUM)
        metrics = QFontMetricsF(font)
        self.place_rects.clear()
        places = {place.name: place.pose_in_map for place in self.map_state.places}
        marks = {name: self._viewport.to_view(pose.x_m, pose.y_m) for name, pose in places.items()}
        taken = [QRectF(at.x() - 9, at.y() - 9, 18, 18) for at in marks.values()]
        taken += [*self._robot_rect(), self._legend_rect()]
        # People move, and take precedence over permanent items.
        for mark, label in people:
            taken += [mark] if label is None else [mark, label]
        goal_place = self.map_state.goal.place if self.map_state.goal is not None else None
        # Goal and hovered place are labelled first; a place without room keeps its flag.
        order = sorted(marks, key=lambda name: (name != goal_place, name != self.map_state.hovered))
        for name in order:
            at, width = marks[name], metrics.horizontalAdvance(name) + 12
            going = name == goal_place
            hit = QRectF(at.x() - 11, at.y() - 11, 22, 22)
            label = self._free_room(at, width, taken, _BESIDE_A_FLAG)
            if label is None and (going or name == self.map_state.hovered):
                label = QRectF(
                    min(max(4.0, at.x() - width / 2), self._view.width() - width - 4), at.y() - 32, width, 20
                )
            self.painted.draw(
                painter, at - QPointF(10, 10), QSizeF(20, 20), ("flag", going), partial(self._paint_flag, going)
            )
            if label is not None:
                taken.append(label)
                hit = hit.united(label)
                self._paint_label(painter, label, name, color="green" if going else "text", weight=tokens.WEIGHT_MEDIUM)
            self.place_rects[name] = hit

    def _paint_flag(self, going: bool, onto: QPainter) -> None:
        onto.setPen(QPen(self._theme.color("green" if going else "line_strong"), 1.5))
        onto.setBrush(self._theme.color("panel"))
        onto.drawEllipse(QPointF(10, 10), 9, 9)
        draw_icon(onto, QRectF(3.5, 3.5, 13, 13), "flag", self._theme.color("green" if going else "text"))

    def _paint_label(self, painter: QPainter, label: QRectF, name: str, *, color: str, weight: int) -> None:
        """Paint a name on a translucent background, cached per text."""

        def paint(onto: QPainter) -> None:
            bounds, ground = QRectF(QPointF(0, 0), label.size()), self._theme.color("panel")
            ground.setAlpha(220)
            onto.setPen(Qt.PenStyle.NoPen)
            onto.setBrush(ground)
            onto.drawRoundedRect(bounds, 5, 5)
            onto.setFont(self._theme.font(tokens.STATUS_PX, weight))
            onto.setPen(self._theme.color(color))
            onto.drawText(bounds, Qt.AlignmentFlag.AlignCenter, name)

        self.painted.draw(painter, label.topLeft(), label.size(), ("label", name, color, weight), paint)

    def _free_room(
        self, at: QPointF, width: float, taken: list[QRectF], sides: tuple[tuple[float, float, float], ...]
    ) -> QRectF | None:
        """First free label rectangle at one of these sides of a mark."""
        room = QRectF(self._view.rect()).adjusted(2, 2, -2, -2)
        for left_px, share_of_width, top_px in sides:
            label = QRectF(at.x() + left_px - share_of_width * width, at.y() + top_px, width, 20)
            if room.contains(label) and not any(label.intersects(other) for other in taken):
                return label
        return None

    def _robot_rect(self) -> list[QRectF]:
        """Rectangle of the robot's marker, if there is a pose."""
        if self.map_state.pose is None:
            return []
        robot = self._viewport.to_view(self.map_state.pose.x_m, self.map_state.pose.y_m)
        return [QRectF(robot.x() - 13, robot.y() - 13, 26, 26)]

    def _people_rects(self) -> _PeopleRects:
        """Marks and labels of people; in a crowd some have no room for a label."""
        if self.map_state.people_freshness not in ("fresh", "stale"):
            return []
        metrics = QFontMetricsF(self._theme.font(tokens.STATUS_PX, tokens.WEIGHT_SEMIBOLD))
        places = [self._viewport.to_view(person.x_m, person.y_m) for person, _, _ in self.map_state.people]
        marks = [QRectF(at.x() - 7, at.y() - 7, 14, 14) for at in places]
        taken, labels = [*self._robot_rect(), *marks], []
        for (_person, name, _named), at in zip(self.map_state.people, places, strict=True):
            label = self._free_room(at, metrics.horizontalAdvance(name) + 10, taken, _BESIDE_A_PERSON)
            labels.append(label)
            taken += [label] if label is not None else []
        return list(zip(marks, labels, strict=True))

    def _paint_people(self, painter: QPainter, rects: _PeopleRects) -> None:
        if not rects:
            return
        painter.save()
        if self.map_state.people_freshness == "stale":
            painter.setOpacity(0.45)
        for (person, name, named), (_, label) in zip(self.map_state.people, rects, strict=True):
            at = self._viewport.to_view(person.x_m, person.y_m)
            meant = bool(self.map_state.meant) and person.person_id == self.map_state.meant
            # Rounded to px: position uncertainty varies slightly with each detection.
            ring = max(9, round(person.spread_m * self._viewport.scale))
            if ring > _KEPT_RING_PX:
                self._paint_person(at, ring, painter, named=named, selected=meant)
            else:
                reach = max(ring, 10) + 2
                self.painted.draw(
                    painter, at - QPointF(reach, reach), QSizeF(2 * reach, 2 * reach), ("person", ring, named, meant),
                    partial(self._paint_person, QPointF(reach, reach), ring, named=named, selected=meant),
                )  # fmt: skip
            if label is not None:
                role = "green" if named else "text"
                self._paint_label(painter, label, name, color=role, weight=tokens.WEIGHT_SEMIBOLD)
        painter.restore()

    def _paint_person(self, at: QPointF, ring: int, onto: QPainter, *, named: bool, selected: bool) -> None:
        """Paint a person with a dashed ring of uncertainty; filled if named, as in the People panel."""
        color = self._theme.color("green" if named else "text")
        pen = QPen(color, 1.5)
        pen.setDashPattern([3, 3])
        onto.setPen(pen)
        onto.setBrush(Qt.BrushStyle.NoBrush)
        onto.drawEllipse(at, ring, ring)
        if selected:
            onto.setPen(QPen(self._theme.color("text"), 2.5))
            onto.drawEllipse(at, 10, 10)
        onto.setPen(QPen(self._theme.color("panel") if named else color, 1.5))
        onto.setBrush(color if named else self._theme.color("panel"))
        onto.drawEllipse(at, 6, 6)

    def _paint_robot(self, painter: QPainter, pose: Pose2D) -> None:
        tip = self._viewport.to_view(pose.x_m, pose.y_m)
        stale = self.map_state.pose_freshness in ("stale", "lost")
        doubtful = stale or self.map_state.unconfirmed
        color = self._theme.color("dim" if stale else "amber" if self.map_state.unconfirmed else "blue")
        if self.map_state.outline_m:
            outline = polygon(outline_in_map(self.map_state.outline_m, pose), self._viewport.transform())
            ground = self._theme.color("blue")
            ground.setAlpha(0 if doubtful else 40)
            pen = QPen(color, 1.5, Qt.PenStyle.DashLine if doubtful else Qt.PenStyle.SolidLine)
            painter.setPen(pen)
            painter.setBrush(ground)
            painter.drawPolygon(outline)
        state, distance_m = self.map_state.guard
        if not stale and state in ("slowing", "blocked") and distance_m is not None:
            # Remaining clearance around the footprint, in any direction of motion.
            reach_m = max((math.hypot(x, y) for x, y in self.map_state.outline_m), default=0.25) + distance_m
            radius = reach_m * self._viewport.scale
            role = "red" if state == "blocked" else "amber"
            painter.setPen(QPen(self._theme.color(role), 2, Qt.PenStyle.DotLine))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawEllipse(tip, radius, radius)
        draw_robot(
            painter, tip, pose.heading_rad + self._viewport.turn_rad, color=color, ground=self._theme.color("panel"),
            hollow=doubtful,
        )  # fmt: skip

    def _paint_aim(self, painter: QPainter) -> None:
        state, aim = self.map_state, self.map_state.aim
        if state.tool == "look":
            if state.mark is not None:
                refused = bool(self._grid.refusal_at(state.mark))
                painter.setPen(QPen(self._theme.color("amber" if refused else "green"), 2.5))
                painter.setBrush(Qt.BrushStyle.NoBrush)
                painter.drawEllipse(self._viewport.to_view(state.mark.x(), state.mark.y()), 9, 9)
            return
        at = None if state.pointer is None else self._viewport.to_map(state.pointer)
        if aim is not None:
            at = aim.at
        if at is None:
            return
        heading_rad = aim.heading_rad if aim is not None else None
        role = "amber" if self._grid.refusal_at(at) else "green" if state.tool == "goal" else "blue"
        color = self._theme.color(role)
        point = self._viewport.to_view(at.x(), at.y())
        if heading_rad is not None:
            draw_arrow(painter, point, heading_rad + self._viewport.turn_rad, color=color, length_px=46)
            return
        pen = QPen(color, 2)
        pen.setDashPattern([3, 2])
        painter.setPen(pen)
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.drawEllipse(point, 9, 9)

    def _paint_scale_bar(self, painter: QPainter) -> None:
        if self._grid.newest is None and self.map_state.pose is None:
            return
        metres = next((length for length in (0.5, 1, 2, 5, 10, 20, 50) if length * self._viewport.scale >= 44), 100)
        right, bottom = self._view.width() - 14.0, self._view.height() - 12.0
        painter.setPen(QPen(self._theme.color("dim"), 1.5))
        left = right - metres * self._viewport.scale
        painter.drawPolyline(QPolygonF([
            QPointF(left, bottom - 4), QPointF(left, bottom), QPointF(right, bottom), QPointF(right, bottom - 4),
        ]))  # fmt: skip
        painter.setFont(self._theme.font(tokens.STATUS_PX - 1))
        painter.drawText(
            QRectF(left - 40, bottom - 20, right - left + 80, 16), Qt.AlignmentFlag.AlignCenter, f"{metres:g} m"
        )
        if self.map_state.rotate:
            north = self._viewport.turn_rad + math.pi / 2
            at = QPointF(self._view.width() - 30.0, bottom - 50)
            out = QPointF(math.cos(north), -math.sin(north))
            side = QPointF(-out.y(), out.x())
            painter.drawText(QRectF(at.x() - 9, at.y() - 9, 18, 18), Qt.AlignmentFlag.AlignCenter, "N")
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(self._theme.color("dim"))
            painter.drawPolygon(QPolygonF([at + out * 19, at + out * 11 + side * 5, at + out * 11 - side * 5]))

    def _legend(self) -> list[tuple[str, str]]:
        """Colour role and word of each kind of thing that is shown without a label of its own."""
        state = self.map_state
        robot = state.pose is not None and state.pose_freshness != "none"
        scan = state.scan_points_m is not None and len(state.scan_points_m) > 0
        shown = (
            (robot, "blue", tr("robot")),
            (scan and state.scan_freshness in ("fresh", "stale"), "lidar", tr("LIDAR")),
            (self._grid.newest is not None, "map_wall", tr("wall")),
            (self._grid.newest is not None, "map_unknown", tr("unknown")),
            (state.goal is not None, "green", tr("goal")),
        )
        return [(role, words) for is_shown, role, words in shown if is_shown]

    def _legend_rect(self) -> QRectF:
        """Place of the legend at the lower edge, left of the scale bar; empty if there is no room for it."""
        metrics = QFontMetricsF(self._theme.font(tokens.STATUS_PX - 1))
        width = sum(_SYMBOL_PX + _LEGEND_GAP_PX + metrics.horizontalAdvance(words) for _, words in self._legend()) + 8
        if self.map_state.hint or width > self._view.width() - _SCALE_BAR_ROOM_PX or self._view.height() < 200:
            return QRectF()
        return QRectF(6, self._view.height() - 26.0, width, 20)

    def _paint_legend(self, painter: QPainter) -> None:
        rect = self._legend_rect()
        if rect.isEmpty():
            return
        ground = self._theme.color("panel")
        ground.setAlpha(220)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(ground)
        painter.drawRoundedRect(rect, 5, 5)
        font = self._theme.font(tokens.STATUS_PX - 1)
        painter.setFont(font)
        left = rect.left() + 6
        for role, words in self._legend():
            symbol = QRectF(left, rect.center().y() - 5, 10, 10)
            color = self._theme.color(role)
            match role:
                case "blue":
                    painter.setPen(Qt.PenStyle.NoPen)
                    painter.setBrush(color)
                    painter.drawEllipse(symbol)
                case "lidar":
                    painter.setPen(Qt.PenStyle.NoPen)
                    painter.setBrush(color)
                    for at in (0, 4, 8):
                        painter.drawEllipse(QRectF(left + at, symbol.center().y() - 1.5, 3, 3))
                case "green":
                    painter.setPen(QPen(color, 2))
                    painter.setBrush(Qt.BrushStyle.NoBrush)
                    painter.drawEllipse(symbol.adjusted(1, 1, -1, -1))
                case _:
                    painter.setPen(QPen(self._theme.color("line_strong"), 1))
                    painter.setBrush(color)
                    painter.drawRect(symbol if role == "map_unknown" else symbol.adjusted(0, 3, 0, -3))
            painter.setPen(self._theme.color("text"))
            width = QFontMetricsF(font).horizontalAdvance(words)
            room = QRectF(left + _SYMBOL_PX, rect.top(), width + 2, rect.height())
            painter.drawText(room, Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft, words)
            left += _SYMBOL_PX + width + _LEGEND_GAP_PX

    def _paint_chips(self, painter: QPainter) -> None:
        font = self._theme.font(tokens.STATUS_PX, tokens.WEIGHT_MEDIUM)
        metrics = QFontMetricsF(font)
        painter.setFont(font)
        top = 8.0
        left_room = 48.0  # space of the tool buttons
        for text, role in self.map_state.chips:
            self._paint_chip(painter, metrics, text, role, left_room=left_room, top=top)
            top += 28
        if self.map_state.hint:
            self._paint_chip(
                painter, metrics, self.map_state.hint, "hint", left_room=left_room, top=self._view.height() - 34.0
            )

    def _paint_chip(
        self, painter: QPainter, metrics: QFontMetricsF, text: str, role: str, *, left_room: float, top: float
    ) -> None:
        icon = _CHIP_ICONS.get(role, "")
        extra = 38.0 if icon else 20.0
        elided = metrics.elidedText(
            text, Qt.TextElideMode.ElideRight, max(40.0, self._view.width() - left_room - 12 - extra)
        )
        width = metrics.horizontalAdvance(elided) + extra
        middle = left_room + (self._view.width() - left_room - 12) / 2
        chip = QRectF(middle - width / 2, top, width, 24)
        color = self._theme.color(_CHIP_COLORS.get(role, "text"))
        painter.setPen(QPen(color if role != "hint" else self._theme.color("line_strong"), 1))
        painter.setBrush(self._theme.color("panel"))
        painter.drawRoundedRect(chip.adjusted(0.5, 0.5, -0.5, -0.5), 8, 8)
        if icon:
            draw_icon(painter, QRectF(chip.left() + 9, chip.top() + 4, 16, 16), icon, color)
            chip.adjust(18, 0, 0, 0)
        painter.setPen(color)
        painter.drawText(chip, Qt.AlignmentFlag.AlignCenter, elided)
