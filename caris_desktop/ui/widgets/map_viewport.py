"""Which part of the map is in view: metres in the map to pixels of the view, and back."""

import math

from PySide6.QtCore import QPointF, QRectF
from PySide6.QtGui import QTransform
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.geometry import wrap_angle

_MIN_SCALE, _MAX_SCALE = 2.0, 400.0  # pixels per metre
_FOLLOWING_SCALE = 45.0


class MapViewport:
    """``center`` is in the middle of ``view``, ``scale`` pixels are a metre; the map is drawn turned by ``turn_rad``,
    counter-clockwise.
    """

    def __init__(self, view: QWidget) -> None:
        self._view = view
        self.center = QPointF(0.0, 0.0)  # metres in the map
        self.scale = 40.0
        self.turn_rad = 0.0

    def transform(self) -> QTransform:
        """From metres in the map to pixels in the view."""
        transform = QTransform()
        transform.translate(self._view.width() / 2, self._view.height() / 2)
        transform.scale(self.scale, -self.scale)
        transform.rotateRadians(self.turn_rad)
        transform.translate(-self.center.x(), -self.center.y())
        return transform

    def to_view(self, x_m: float, y_m: float) -> QPointF:
        return self.transform().map(QPointF(x_m, y_m))

    def to_map(self, point: QPointF) -> QPointF:
        inverted, _possible = self.transform().inverted()
        return inverted.map(point)

    def turned(self, x_m: float, y_m: float) -> QPointF:
        """A point of the map as it lies once the map is turned, still in metres."""
        cos, sin = math.cos(self.turn_rad), math.sin(self.turn_rad)
        return QPointF(cos * x_m - sin * y_m, sin * x_m + cos * y_m)

    def turn_up(self, heading_rad: float | None) -> None:
        """Let up be this direction of the map; north without one."""
        self.turn_rad = 0.0 if heading_rad is None else wrap_angle(math.pi / 2 - heading_rad)

    def come_near(self) -> None:
        """Near enough to follow a robot."""
        self.scale = max(self.scale, _FOLLOWING_SCALE)

    def zoom(self, factor: float, about: QPointF) -> None:
        """Show more or less, with the point ``about`` of the view staying where it is."""
        before = self.to_map(about)
        self.scale = min(max(self.scale * factor, _MIN_SCALE), _MAX_SCALE)
        self.center += before - self.to_map(about)

    def drag(self, before: QPointF, now: QPointF) -> None:
        """Move the map with a pointer that went from one point of the view to another."""
        self.center += self.to_map(before) - self.to_map(now)

    def show(self, bounds: QRectF, *, left_px: int) -> None:
        """Let these bounds of the turned map fill the view, beside what covers its left edge."""
        width, height = self._view.width(), self._view.height()
        fitting = min((width - left_px - 24) / bounds.width(), (height - 24) / bounds.height())
        self.scale = min(max(fitting, _MIN_SCALE), _MAX_SCALE)
        middle = bounds.center() - QPointF(left_px / 2 / self.scale, 0.0)
        cos, sin = math.cos(self.turn_rad), math.sin(self.turn_rad)
        self.center = QPointF(cos * middle.x() + sin * middle.y(), -sin * middle.x() + cos * middle.y())
