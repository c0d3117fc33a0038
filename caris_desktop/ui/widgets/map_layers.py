"""Map layers: scan, trail, path and footprint as arrays, and drawing of their marks."""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QPointF, Qt
from PySide6.QtGui import QColor, QPainter, QPen, QPolygonF, QTransform

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import LaserScan

TRAIL_STEP_M = 0.05
TRAIL_POINTS = 4000
"""Maximum points of the trail: two hundred metres."""

_TRAIL_JUMP_M = 1.0
_TRAIL_SHADES = 8
_DOT_PX = 2
ROBOT_RADIUS_PX = 9


def scan_points_in_map(scan: LaserScan, map_from_robot: Pose2D) -> NDArray[np.float64]:
    """End points of the beams, float64 of shape (returns, 2), metres in the map; empty if the pose of the laser is
    unknown.
    """
    if scan.robot_from_laser is None:
        return np.zeros((0, 2))
    return scan.points(map_from_robot @ scan.robot_from_laser)


def distinct_dots(points_px: NDArray[np.float64], width_px: int, height_px: int) -> NDArray[np.int64]:
    """Points inside the view, merged to spots of two by two pixels: int64 of shape (spots, 2), px.

    On a map of a whole building, most beams end on the same few pixels.
    """
    inside = ((points_px >= 0) & (points_px < (width_px, height_px))).all(axis=1)
    cells = points_px[inside].astype(np.int64) // _DOT_PX
    columns = width_px // _DOT_PX + 1
    numbers = np.unique(cells[:, 1] * columns + cells[:, 0])
    return np.column_stack((numbers % columns, numbers // columns)) * _DOT_PX + _DOT_PX // 2


class Trail:
    """Driven path: a point every five centimetres, the newest ``TRAIL_POINTS``."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, float]] = deque(maxlen=TRAIL_POINTS)

    def __len__(self) -> int:
        return len(self._points)

    def add(self, pose: Pose2D) -> None:
        if self._points:
            moved_m = math.dist(self._points[-1], (pose.x_m, pose.y_m))
            if moved_m < TRAIL_STEP_M:
                return
            if moved_m > _TRAIL_JUMP_M and not math.isnan(self._points[-1][0]):
                # A jump of the localization, which the robot did not drive.
                self._points.append((math.nan, math.nan))
        self._points.append((pose.x_m, pose.y_m))

    def clear(self) -> None:
        self._points.clear()

    def pieces(self) -> list[tuple[float, NDArray[np.float64]]]:
        """Pieces as (strength 0..1, points of shape (n, 2) in metres), oldest first."""
        points = np.array(self._points, np.float64).reshape(-1, 2)
        pieces: list[tuple[float, NDArray[np.float64]]] = []
        per_shade = max(2, math.ceil(len(points) / _TRAIL_SHADES))
        for shade, first in enumerate(range(0, len(points), per_shade), start=1):
            part = points[first : first + per_shade + 1]
            gaps = np.flatnonzero(np.isnan(part[:, 0]))
            for run in np.split(part, gaps):
                known = run[~np.isnan(run[:, 0])]
                if len(known) > 1:
                    pieces.append((shade / _TRAIL_SHADES, known))
        return pieces


def polygon(points: NDArray[np.float64] | list[tuple[float, float]], to_view: QTransform) -> QPolygonF:
    """Map points as a polyline in the view."""
    m11, m12, m21, m22 = to_view.m11(), to_view.m12(), to_view.m21(), to_view.m22()
    dx, dy = to_view.dx(), to_view.dy()
    array = np.asarray(points, np.float64)
    xs = array[:, 0] * m11 + array[:, 1] * m21 + dx
    ys = array[:, 0] * m12 + array[:, 1] * m22 + dy
    return QPolygonF([QPointF(x, y) for x, y in zip(xs.tolist(), ys.tolist(), strict=True)])


def thinned(points: NDArray[np.float32], at_most: int = 400) -> NDArray[np.float64]:
    """Line reduced to at most this many points, keeping its end."""
    step = max(1, math.ceil(len(points) / at_most))
    fewer = points[::step]
    if len(points) and step > 1:
        fewer = np.concatenate((fewer, points[-1:]))
    return fewer.astype(np.float64)


def outline_in_map(outline_m: tuple[tuple[float, float], ...], pose: Pose2D) -> list[tuple[float, float]]:
    """Footprint at a pose."""
    cos, sin = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    return [(pose.x_m + cos * x - sin * y, pose.y_m + sin * x + cos * y) for x, y in outline_m]


def draw_robot(
    painter: QPainter, at: QPointF, heading_rad: float, *, color: QColor, ground: QColor, hollow: bool
) -> None:
    """Draw the robot as a disc with a nose towards ``heading_rad`` in the view (counter-clockwise from right).

    ``hollow``: dashed outline for an unknown pose.
    """
    heading = QPointF(math.cos(heading_rad), -math.sin(heading_rad))
    side = QPointF(-heading.y(), heading.x())
    nose = QPolygonF([at + heading * 19, at + heading * 5 + side * 8, at + heading * 5 - side * 8])
    pen = QPen(color if hollow else ground, 2 if hollow else 1.5)
    if hollow:
        pen.setDashPattern([3, 2])
    painter.setPen(pen)
    painter.setBrush(ground if hollow else color)
    painter.drawPolygon(nose)
    painter.drawEllipse(at, ROBOT_RADIUS_PX, ROBOT_RADIUS_PX)


def draw_arrow(painter: QPainter, at: QPointF, heading_rad: float, *, color: QColor, length_px: float) -> None:
    """Draw an arrow from ``at`` towards ``heading_rad`` in the view, with a ring at its base."""
    heading = QPointF(math.cos(heading_rad), -math.sin(heading_rad))
    side = QPointF(-heading.y(), heading.x())
    end = at + heading * length_px
    painter.setPen(QPen(color, 3, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
    painter.setBrush(Qt.BrushStyle.NoBrush)
    painter.drawEllipse(at, 9, 9)
    painter.drawLine(at + heading * 9, end - heading * 8)
    painter.setPen(Qt.PenStyle.NoPen)
    painter.setBrush(color)
    painter.drawPolygon(QPolygonF([end, end - heading * 12 + side * 7, end - heading * 12 - side * 7]))
