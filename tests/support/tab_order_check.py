"""Check of the tab order of a window: controls that are skipped or reached in the wrong order."""

from dataclasses import dataclass
from itertools import combinations

from PySide6.QtCore import QPoint, QRect, Qt
from PySide6.QtGui import QAccessible
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QAbstractButton, QAbstractScrollArea, QApplication, QWidget

from tests.support.accessibility_check import AccessibleControl, controls, panel_of

_MAX_TAB_PRESSES = 600
_SPARE_PX = 4
"""Permitted overlap with the adjacent row or column."""

_CONTROLLED_BY_FIELD = ("command_palette",)
"""Panels in which the arrow keys of the field select a row and Enter activates it."""


def tab_order(window: QWidget) -> list[QWidget]:
    """Focused widgets after each Tab for one cycle, starting with the first in reading order."""
    window.activateWindow()
    QApplication.processEvents()
    started = QApplication.focusWidget()
    if started is None or started.window() is not window:
        window.setFocus()
    reached: list[QWidget] = []
    for _ in range(_MAX_TAB_PRESSES):
        now = _press(window, Qt.Key.Key_Tab)
        if now is None or now in reached:
            break
        reached.append(now)
    places = [_position(widget, window) for widget in reached]
    begins = (at for at, one in enumerate(places) if not any(_is_read_before(other, one) for other in places))
    first = min(begins, key=lambda at: places[at].rect.top(), default=0)
    return [*reached[first:], *reached[:first]]


def tab_order_flaws(part: QWidget) -> list[str]:
    """One line for each control out of reading order, each panel left too early, and each unreachable control."""
    window = part.window()
    reached = tab_order(window)
    panels = [panel_of(widget) for widget in reached]
    found = [
        f"{panels[at].objectName()} loses the focus before {_named(widget)} gets it"
        for at, widget in enumerate(reached)
        if at and panels[at] is not panels[at - 1] and panels[at] in panels[:at]
    ]
    if _press(window, Qt.Key.Key_Tab) not in reached or _press(window, Qt.Key.Key_Backtab) not in reached:
        found.append(f"Tab and Shift+Tab do not lead back from {_named(QApplication.focusWidget())}")
    places = [_position(widget, window) for widget in reached]
    for before, after in combinations(range(len(reached)), 2):
        if panels[before] is panels[after] and _is_read_before(places[after], places[before]):
            where = panels[after].objectName()
            found.append(f"{_named(reached[after])} comes after {_named(reached[before])} in {where}")
    missed = [one for one in controls(part) if one.is_widget and one.widget.isEnabled() and one.widget not in reached]
    missed = [one for one in missed if one.role != QAccessible.Role.StaticText]
    return found + [
        f"{one.location}, {one.name!r}, is not reachable by keyboard"
        for one in missed
        if not _reached_by_arrow_keys(one, reached)
    ]


def _press(window: QWidget, key: Qt.Key) -> QWidget | None:
    QTest.keyClick(QApplication.focusWidget() or window, key)
    return QApplication.focusWidget()


def _named(widget: QWidget | None) -> str:
    return "nothing" if widget is None else f"{type(widget).__name__} {widget.objectName()!r}"


@dataclass(frozen=True, slots=True)
class _Position:
    """Rectangle of a widget in the window, and the scroll areas that contain it, outermost first."""

    rect: QRect
    areas: dict[QWidget, QRect]

    def rect_outside_common_areas(self, other: "_Position") -> QRect:
        """Rectangle of the outermost scroll area that does not also contain ``other``; else of the widget."""
        return next((rect for area, rect in self.areas.items() if area not in other.areas), self.rect)


def _position(widget: QWidget, window: QWidget) -> _Position:
    def rect_of(part: QWidget) -> QRect:
        return QRect(part.mapTo(window, QPoint()), part.size())

    holders, holder = list[QWidget](), widget.parentWidget()
    while holder is not None and holder is not window:
        if isinstance(holder, QAbstractScrollArea):
            holders.append(holder)
        holder = holder.parentWidget()
    return _Position(rect_of(widget), {area: rect_of(area) for area in reversed(holders)})


def _is_read_before(one: _Position, other: _Position) -> bool:
    """True if it is above the other in the same column, or to the left of it in the same row."""
    a, b = one.rect_outside_common_areas(other), other.rect_outside_common_areas(one)
    above, left_of = a.bottom() < b.top() + _SPARE_PX, a.right() < b.left() + _SPARE_PX
    same_column = a.right() > b.left() + _SPARE_PX and b.right() > a.left() + _SPARE_PX
    same_row = a.bottom() > b.top() + _SPARE_PX and b.bottom() > a.top() + _SPARE_PX
    return (above and same_column) or (left_of and same_row)


def _reached_by_arrow_keys(one: AccessibleControl, reached: list[QWidget]) -> bool:
    """True if the keys of a focusable container, or of another button of its exclusive group, reach the control."""
    if one.panel.objectName() in _CONTROLLED_BY_FIELD:
        return True
    group = one.widget.group() if isinstance(one.widget, QAbstractButton) else None
    if group is not None and group.exclusive():
        return any(button in reached for button in group.buttons())
    return any(
        holder.isAncestorOf(one.widget)
        or (
            isinstance(holder, QAbstractScrollArea)
            and QRect(holder.mapToGlobal(QPoint()), holder.size()).contains(one.place.center())
        )
        for holder in reached
    )
