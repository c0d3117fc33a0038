"""Where Tab goes: through a window as it is read, one part after the other, as everything lies at that moment."""

from collections.abc import Callable

from PySide6.QtCore import QRect, Qt
from PySide6.QtWidgets import QScrollArea, QWidget

from caris_desktop.ui.give_keys import pass_keys_on
from caris_desktop.ui.overlay import Overlay

_TOUCH_PX = 3  # parts of a row may overlap by so much, and rows by as much

_Part = tuple[QRect, list[QWidget]]
"""Where a widget lies in what holds it, and the stops in it."""


class TabAsRead:
    """Comes before the Qt class of a window. Qt goes through widgets in the order in which they were made; panels are
    moved, and buttons come and go.
    """

    def focusNextPrevChild(self, forward: bool, /) -> bool:
        return isinstance(self, QWidget) and move_focus(self, forward=forward)


class PanelWindow(TabAsRead):
    """The same for a window with panels, in which keys drive, speak and switch: Qt asks for the next one also where the
    one that had the keys is hidden or disabled, and there nobody gets them whom the wizard did not choose.
    """

    def focusNextPrevChild(self, forward: bool, /) -> bool:
        if isinstance(self, QWidget):
            focused = self.focusWidget()
            if focused is not None and focused is not self and not (focused.isVisible() and focused.isEnabled()):
                pass_keys_on(self, focused)
                return True
        return super().focusNextPrevChild(forward)


def move_focus(window: QWidget, *, forward: bool) -> bool:
    """Give the keys to the next stop of the window, and bring it into sight; whether there is another one."""
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


def tab_stops(window: QWidget, focused: QWidget | None = None) -> list[QWidget]:
    """Everything that Tab stops at, in this order; with it what has the keys now, be it a stop or not."""
    return _below(window, focused)


def _below(holder: QWidget, focused: QWidget | None) -> list[QWidget]:
    parts: list[_Part] = []
    shown = [child for child in holder.children() if isinstance(child, QWidget) and _is_shown(child)]
    over = next((child for child in reversed(shown) if isinstance(child, Overlay)), None)
    for child in shown:
        if over is not None and child is not over and child.geometry().intersects(over.geometry()):
            continue  # nobody sees what it would stop at
        own = [child] if child is focused or _is_stop(child) else []
        stops = [*own, *_below(child, focused)]
        if stops:
            parts.append((child.geometry(), stops))
    return [stop for _place, stops in _as_read(parts) for stop in stops]


def _is_shown(widget: QWidget) -> bool:
    return not (widget.isHidden() or widget.isWindow()) and widget.isEnabled()


def _is_stop(widget: QWidget) -> bool:
    by_tab = widget.focusPolicy() & Qt.FocusPolicy.TabFocus
    return bool(by_tab) and widget.focusProxy() is None


def _as_read(parts: list[_Part]) -> list[_Part]:
    """Cut into rows as far as that goes, else into columns, and each of those again."""
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
