"""Who gets the keys: the part that the wizard went to by a key, a click or a tab; never one that Qt chose."""

from PySide6.QtCore import Qt
from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import QApplication, QWidget


class Bar:
    """Comes before the Qt class of a bar. Nothing in it takes the keys but by Tab, and a click in it sends them nowhere
    else; bare keys no longer drive after it.
    """


class KeyPlace(QWidget):
    """A part that has a main field: a click on the part gives the keys to that."""

    def focus_target(self) -> QWidget:
        """What gets the focus when the wizard goes to this part."""
        raise NotImplementedError


def give_keys(widget: QWidget, reason: Qt.FocusReason = Qt.FocusReason.ShortcutFocusReason) -> None:
    """Give the focus to ``widget`` and the keys to its window.

    Panels have windows of their own, and a focus in a window without the keys gets nothing of what is typed.
    """
    widget.setFocus(reason)
    bring_keys_to(window_of(widget))


def bring_keys_to(window: QWidget) -> None:
    """Only between the main window and the panels in windows of their own: no other program loses the keys, no dialog
    that has to be answered, and no editor or list beside the console, in which somebody types.
    """
    active = QApplication.activeWindow()
    if active is window or QApplication.activeModalWidget() is not None:
        return
    if active is None:
        # A panel's own window has just gone, and the window manager has not given the keys to another one yet.
        ours = QGuiApplication.applicationState() == Qt.ApplicationState.ApplicationActive
    else:
        ours = _main_of(active) is _main_of(window)
    if ours:
        window.activateWindow()


def _main_of(window: QWidget) -> QWidget:
    """The main window of a panel's own window; any other window is its own."""
    parent = window.parentWidget()
    return window_of(parent) if window.windowType() == Qt.WindowType.Tool and parent is not None else window


def window_of(widget: QWidget) -> QWidget:
    """As ``widget.window()``, after which PySide would take the widget for gone once a panel's own window is."""
    parent = None if widget.isWindow() else widget.parentWidget()
    return widget if parent is None else window_of(parent)


def key_place_of(widget: QWidget) -> KeyPlace | None:
    """The part with a main field that ``widget`` is, or lies in."""
    found = _first(widget, KeyPlace)
    return found if isinstance(found, KeyPlace) else None


def bar_of(widget: QWidget) -> QWidget | None:
    """The bar that ``widget`` is, or lies in."""
    return _first(widget, Bar)


def _first(widget: QWidget | None, kind: type) -> QWidget | None:
    while widget is not None and not isinstance(widget, kind):
        widget = None if widget.isWindow() else widget.parentWidget()
    return widget


def pass_keys_on(window: QWidget, gone: QWidget) -> None:
    """``gone`` had the keys and can be seen or used no longer: its part keeps them, else nobody has them, which is to
    say ``window`` itself. Qt would give them to whatever stands first in the window.
    """
    place = key_place_of(gone)
    target = place.focus_target() if place is not None and place.isVisible() else window
    usable = target.isVisible() and target.isEnabled() and target is not gone
    (target if usable else window).setFocus(Qt.FocusReason.OtherFocusReason)


def follow_click(pressed: QWidget, *, drives: bool) -> None:
    """Give the keys to the main field of the part that was clicked, unless something in it has them already. Beside all
    parts a click takes them from nobody but from driving: ``drives`` says whether bare keys drive in that window.
    """
    window, place = window_of(pressed), key_place_of(pressed)
    focused = window.focusWidget()
    if place is None:
        if drives:
            window.setFocus(Qt.FocusReason.MouseFocusReason)
    elif focused is None or not (place is focused or place.isAncestorOf(focused)):
        place.focus_target().setFocus(Qt.FocusReason.MouseFocusReason)
