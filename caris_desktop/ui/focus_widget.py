"""Keyboard focus: moves to the part that the wizard chose by key, click or tab, never by Qt's default;
and tab order by visual position, the reading order of the current layout.
"""

from collections.abc import Callable

import shiboken6
from PySide6.QtCore import QRect, Qt
from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import QApplication, QScrollArea, QWidget


class Bar:
    """Mixin for a bar, before the Qt class. Its widgets get the focus by Tab only, and a click in it does not move the
    focus elsewhere; bare keys no longer drive afterwards.
    """


class KeyPlace(QWidget):
    """Part of the window with a main field, which a click on the part focuses."""

    def focus_target(self) -> QWidget:
        """Widget to focus when the wizard goes to this part."""
        raise NotImplementedError


def focus_widget(widget: QWidget, reason: Qt.FocusReason = Qt.FocusReason.ShortcutFocusReason) -> None:
    """Focus ``widget`` and activate its window.

    Floating panels are windows of their own, and a focused widget in an inactive window receives no keys.
    """
    widget.setFocus(reason)
    scroll_to(widget)
    activate_window(window_of(widget))


def scroll_to(widget: QWidget) -> None:
    """Scroll all scroll areas around the widget so that it is visible."""
    holder = widget.parentWidget()
    while holder is not None and not holder.isWindow():
        if isinstance(holder, QScrollArea) and holder.isAncestorOf(widget):
            holder.ensureWidgetVisible(widget)
        holder = holder.parentWidget()


def application() -> QApplication:
    """The application, which exists before any widget."""
    app = QApplication.instance()
    if not isinstance(app, QApplication):
        raise TypeError("the window needs a QApplication")
    return app


def focused_widget() -> QWidget | None:
    """The application's focus widget, unless it is being deleted: PySide returns those too, and any call fails."""
    return existing(QApplication.focusWidget())


def existing(widget: QWidget | None) -> QWidget | None:
    """``widget`` unless it has been deleted, as a widget that is remembered may have been."""
    return widget if widget is not None and shiboken6.isValid(widget) else None


def give_focus_back(widget: QWidget | None) -> None:
    """Focus the widget that had the focus before a popup opened, if it still exists and is visible."""
    if (before := existing(widget)) is not None and before.isVisible():
        before.setFocus(Qt.FocusReason.PopupFocusReason)


def activate_window(window: QWidget) -> None:
    """Activate a window, only between the main window and its floating panels: never away from another program, a modal
    dialog, or an editor or list in which the user types.
    """
    active = QApplication.activeWindow()
    if active is window or QApplication.activeModalWidget() is not None:
        return
    if active is None:
        # A floating panel has just closed, and the window manager has not activated another window yet.
        ours = QGuiApplication.applicationState() == Qt.ApplicationState.ApplicationActive
    else:
        ours = main_of(active) is main_of(window)
    if ours:
        window.activateWindow()


def main_of(window: QWidget) -> QWidget:
    """The main window of a floating panel; any other window is its own."""
    parent = window.parentWidget()
    return window_of(parent) if window.windowType() == Qt.WindowType.Tool and parent is not None else window


def window_of(widget: QWidget) -> QWidget:
    """Like ``widget.window()``, after which PySide would treat the widget as deleted once a floating panel closes."""
    parent = None if widget.isWindow() else widget.parentWidget()
    return widget if parent is None else window_of(parent)


def key_place_of(widget: QWidget) -> KeyPlace | None:
    """The part with a main field that ``widget`` is or belongs to."""
    found = _first(widget, KeyPlace)
    return found if isinstance(found, KeyPlace) else None


def bar_of(widget: QWidget) -> QWidget | None:
    """The bar that ``widget`` is or belongs to."""
    return _first(widget, Bar)


def _first(widget: QWidget | None, kind: type) -> QWidget | None:
    while widget is not None and not isinstance(widget, kind):
        widget = None if widget.isWindow() else widget.parentWidget()
    return widget


def pass_keys_on(window: QWidget, lost: QWidget) -> None:
    """Move the focus from ``lost``, which was hidden or disabled, to its part, else to ``window`` itself, where no
    field has it. Qt would focus the first widget of the window.
    """
    place = key_place_of(lost)
    target = place.focus_target() if place is not None and place.isVisible() else window
    usable = target.isVisible() and target.isEnabled() and target is not lost
    (target if usable else window).setFocus(Qt.FocusReason.PopupFocusReason)


def follow_click(pressed: QWidget, *, drives: bool) -> None:
    """Focus the main field of the clicked part, unless the focus is already inside it. A click outside all parts clears
    the focus only if bare keys drive in that window (``drives``).
    """
    window, place = window_of(pressed), key_place_of(pressed)
    focused = window.focusWidget()
    if place is None:
        if drives:
            window.setFocus(Qt.FocusReason.MouseFocusReason)
    elif focused is None or not (place is focused or place.isAncestorOf(focused)):
        place.focus_target().setFocus(Qt.FocusReason.MouseFocusReason)


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
    scroll_to(target)
    return True


def tab_stops(holder: QWidget, focused: QWidget | None = None) -> list[QWidget]:
    """All tab stops below ``holder`` in visual order, with the focused widget even if it is not a tab stop."""
    parts: list[_Part] = []
    visible = [
        child
        for child in holder.children()
        if isinstance(child, QWidget) and (not (child.isHidden() or child.isWindow()) and child.isEnabled())
    ]
    over = next((child for child in reversed(visible) if getattr(child, "dims_window", False)), None)
    for child in visible:
        if over is not None and child is not over and child.geometry().intersects(over.geometry()):
            continue  # covered
        own_stop = [child] if child is focused or _is_stop(child) else []
        stops = [*own_stop, *tab_stops(child, focused)]
        if stops:
            parts.append((child.geometry(), stops))
    return [stop for _place, stops in _as_read(parts) for stop in stops]


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
