"""Tab order by visual position: reading order of the current layout."""

from collections.abc import Callable

from PySide6.QtCore import QRect, Qt
from PySide6.QtWidgets import QScrollArea, QWidget

from caris_desktop.ui.focus_widget import pass_keys_on
from caris_desktop.ui.overlay import Overlay

_TOUCH_PX = 3  # tolerated overlap of widgets in a row, and of rows

_Part = tuple[QRect, list[QWidget]]
"""Geometry of a widget within its parent, and the tab stops inside."""


class VisualTabOrderMixin:
    """Mixin for a window, before its Qt class. Qt's tab order is creation order, but panels move, and buttons come and
    go.
    """

    def focusNextPrevChild(self, forward: bool, /) -> bool:
        return isinstance(self, QWidget) and move_focus(self, forward=forward)


class PanelWindow(VisualTabOrderMixin):
    """Tab order for a window with panels. Qt also moves the focus when the focused widget is hidden or disabled; here
    it is cleared instead, because keys drive, speak and switch.
    """

    def focusNextPrevChild(self, forward: bool, /) -> bool:
        if isinstance(self, QWidget):
            focused = self.focusWidget()
            if focused is not None and focused is not self and not (focused.isVisible() and focused.isEnabled()):
                pass_keys_on(self, focused)
                return True
        return super().focusNextPrevChild(forward)


def move_focus(window: QWidget, *, forward: bool) -> bool:
    """Focus the next tab stop of the window and scroll to it; False if there is no other."""
    focused = window.focusWidget()
    stops = tab_stops(window, focused)
    others = [stop for stop in stops if stop is not focused]
    if not others:
        return False
    at = stops.index(focused) if focused is not None and focused in stops else -1 if forward else 0
    target = stops[(at + (1 if forward else -1)) % len(stops)]
    target.setFocus(Qt.FocusReason.TabFocusReason if forward else Qt.FocusReason.BacktabFocusReason)
    holder = target.parentWidget()
    while holder is not None and holder is not window:
        if isinstance(holder, QScrollArea) and holder.isAncestorOf(target):
            holder.ensureWidgetVisible(target)
        holder = holder.parentWidget()
    return True


def tab_stops(holder: QWidget, focused: QWidget | None = None) -> list[QWidget]:
    """All tab stops below ``holder`` in visual order, with the focused widget even if it is not a tab stop."""
    parts: list[_Part] = []
    visible = [child for child in holder.children() if isinstance(child, QWidget) and _is_shown(child)]
    over = next((child for child in reversed(visible) if isinstance(child, Overlay)), None)
    for child in visible:
        if over is not None and child is not over and child.geometry().intersects(over.geometry()):
            continue  # covered
        own_stop = [child] if child is focused or _is_stop(child) else []
        stops = [*own_stop, *tab_stops(child, focused)]
        if stops:
            parts.append((child.geometry(), stops))
    return [stop for _place, stops in _as_read(parts) for stop in stops]


def _is_shown(widget: QWidget) -> bool:
    return not (widget.isHidden() or widget.isWindow()) and widget.isEnabled()


def _is_stop(widget: QWidget) -> bool:
    by_tab = widget.focusPolicy() & Qt.FocusPolicy.TabFocus
    return bool(by_tab) and widget.focusProxy() is None


def _as_read(parts: list[_Part]) -> list[_Part]:
    """Split recursively into rows if possible, else into columns."""
    if len(parts) < 2:
        return parts
    for first, last in ((QRect.top, QRect.bottom), (QRect.left, QRect.right)):
        groups = _cut(parts, first, last)
        if len(groups) > 1:
            return [part for group in groups for part in _as_read(group)]
    return sorted(parts, key=lambda part: (part[0].top(), part[0].left()))


def _cut(parts: list[_Part], first: Callable[[QRect], int], last: Callable[[QRect], int]) -> list[list[_Part]]:
    groups: list[list[_Part]] = []
    end = 0
    for part in sorted(parts, key=lambda part: first(part[0])):
        if groups and first(part[0]) <= end - _TOUCH_PX:
            groups[-1].append(part)
            end = max(end, last(part[0]))
        else:
            groups.append([part])
            end = last(part[0])
    return groups
