"""Viewport of the map: conversion between metres in the map and px of the view."""

import math

from PySide6.QtCore import QPointF, QRectF
from PySide6.QtGui import QTransform
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.geometry import wrap_angle

_MIN_SCALE, _MAX_SCALE = 2.0, 400.0  # pixels per metre
_FOLLOWING_SCALE = 45.0


class MapViewport:
    """``center`` is the map point in the middle of ``view``, ``scale`` is in px per metre; the map is rotated by
    ``turn_rad``, counter-clockwise.
    """

    def __init__(self, view: QWidget) -> None:
        self._view = view
        self.center = QPointF(0.0, 0.0)  # metres in the map
        self.scale = 40.0
        self.turn_rad = 0.0

    def transform(self) -> QTransform:
        """Transform from metres in the map to px of the view."""
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
        """Map point after the rotation, in metres."""
        cos, sin = math.cos(self.turn_rad), math.sin(self.turn_rad)
        return QPointF(cos * x_m - sin * y_m, sin * x_m + cos * y_m)

    def turn_up(self, heading_rad: float | None) -> None:
        """Rotate this map direction up; north if None."""
        self.turn_rad = 0.0 if heading_rad is None else wrap_angle(math.pi / 2 - heading_rad)

    def come_near(self) -> None:
        """Zoom in far enough to follow the robot."""
        self.scale = max(self.scale, _FOLLOWING_SCALE)

    def zoom(self, factor: float, about: QPointF) -> None:
        """Zoom around the point ``about`` of the view."""
        before = self.to_map(about)
        self.scale = min(max(self.scale * factor, _MIN_SCALE), _MAX_SCALE)
        self.center += before - self.to_map(about)

    def drag(self, before: QPointF, now: QPointF) -> None:
        """Pan by a drag between two points of the view."""
        self.center += self.to_map(before) - self.to_map(now)

    def show(self, bounds: QRectF, *, left_px: int) -> None:
        """Fit bounds of the rotated map into the view, right of its covered left edge."""
        width, height = self._view.width(), self._view.height()
        fitting = min((width - left_px - 24) / bounds.width(), (height - 24) / bounds.height())
        self.scale = min(max(fitting, _MIN_SCALE), _MAX_SCALE)
        middle = bounds.center() - QPointF(left_px / 2 / self.scale, 0.0)
        cos, sin = math.cos(self.turn_rad), math.sin(self.turn_rad)
        self.center = QPointF(cos * middle.x() + sin * middle.y(), -sin * middle.x() + cos * middle.y())
