"""Goes through a window with the Tab key as a person does, and finds what is left out or comes at the wrong place."""

from dataclasses import dataclass
from itertools import combinations

from PySide6.QtCore import QPoint, QRect, Qt
from PySide6.QtGui import QAccessible
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QAbstractButton, QAbstractScrollArea, QApplication, QWidget

from tests.support.accessibility_check import Told, controls, panel_of

_MOST = 600
_SPARE_PX = 4
"""So far one part may reach into the row or column of another."""

_CHOSEN_FROM_ITS_FIELD = ("command_palette",)
"""There the arrow keys of the field go through the lines, and Enter presses one."""


def gone_through(window: QWidget) -> list[QWidget]:
    """What has the focus after each Tab until it comes round again, beginning with what is read first."""
    window.activateWindow()
    QApplication.processEvents()
    started = QApplication.focusWidget()
    if started is None or started.window() is not window:
        window.setFocus()
    reached: list[QWidget] = []
    for _ in range(_MOST):
        now = _press(window, Qt.Key.Key_Tab)
        if now is None or now in reached:
            break
        reached.append(now)
    places = [_place(widget, window) for widget in reached]
    begins = (at for at, one in enumerate(places) if not any(_is_read_before(other, one) for other in places))
    first = min(begins, key=lambda at: places[at].rect.top(), default=0)
    return [*reached[first:], *reached[:first]]


def tab_flaws(part: QWidget) -> list[str]:
    """One line for each control that comes after one that is read later, for each panel that is left before all of it
    was visited, and for what cannot be reached; empty for what can be used without a mouse.
    """
    window = part.window()
    reached = gone_through(window)
    panels = [panel_of(widget) for widget in reached]
    found = [
        f"{panels[at].objectName()} was left before {_named(widget)} was visited"
        for at, widget in enumerate(reached)
        if at and panels[at] is not panels[at - 1] and panels[at] in panels[:at]
    ]
    if _press(window, Qt.Key.Key_Tab) not in reached or _press(window, Qt.Key.Key_Backtab) not in reached:
        found.append(f"it does not come back from {_named(QApplication.focusWidget())}")
    places = [_place(widget, window) for widget in reached]
    for before, after in combinations(range(len(reached)), 2):
        if panels[before] is panels[after] and _is_read_before(places[after], places[before]):
            where = panels[after].objectName()
            found.append(f"{_named(reached[after])} comes after {_named(reached[before])} in {where}")
    missed = [one for one in controls(part) if one.own and one.widget.isEnabled() and one.widget not in reached]
    missed = [one for one in missed if one.role != QAccessible.Role.StaticText]
    return found + [f"{one.spot}, {one.name!r}, is not reached" for one in missed if not _by_keys_of(one, reached)]


def _press(window: QWidget, key: Qt.Key) -> QWidget | None:
    QTest.keyClick(QApplication.focusWidget() or window, key)
    return QApplication.focusWidget()


def _named(widget: QWidget | None) -> str:
    return "nothing" if widget is None else f"{type(widget).__name__} {widget.objectName()!r}"


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a widget lies in the window, and what it is scrolled in, outermost first."""

    rect: QRect
    areas: dict[QWidget, QRect]

    def beside(self, other: "_Place") -> QRect:
        """The whole of what it is scrolled in, for what is outside of that."""
        return next((rect for area, rect in self.areas.items() if area not in other.areas), self.rect)


def _place(widget: QWidget, window: QWidget) -> _Place:
    def rect_of(part: QWidget) -> QRect:
        return QRect(part.mapTo(window, QPoint()), part.size())

    holders, holder = list[QWidget](), widget.parentWidget()
    while holder is not None and holder is not window:
        if isinstance(holder, QAbstractScrollArea):
            holders.append(holder)
        holder = holder.parentWidget()
    return _Place(rect_of(widget), {area: rect_of(area) for area in reversed(holders)})


def _is_read_before(one: _Place, other: _Place) -> bool:
    """Whether it stands above the other in its column, or to the left of it in its row."""
    a, b = one.beside(other), other.beside(one)
    above, beside = a.bottom() < b.top() + _SPARE_PX, a.right() < b.left() + _SPARE_PX
    below_one_another = a.right() > b.left() + _SPARE_PX and b.right() > a.left() + _SPARE_PX
    in_one_row = a.bottom() > b.top() + _SPARE_PX and b.bottom() > a.top() + _SPARE_PX
    return (above and below_one_another) or (beside and in_one_row)


def _by_keys_of(one: Told, reached: list[QWidget]) -> bool:
    """Whether the list, plan or picture that it stands on is reached, or the field that it is a part of, whose keys
    choose and do it; or another one of its group, from which the arrow keys go on to it.
    """
    if one.panel.objectName() in _CHOSEN_FROM_ITS_FIELD:
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
