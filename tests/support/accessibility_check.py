"""Asks the accessibility interface for what a screen reader would say of a window, and finds what it could not."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

from PySide6.QtCore import QPoint, QRect
from PySide6.QtGui import QAccessible, QAccessibleInterface
from PySide6.QtWidgets import QAbstractScrollArea, QScrollBar, QWidget

from caris_desktop.ui.layout.dock_area import DockArea
from caris_desktop.ui.overlay import Overlay

Role = QAccessible.Role

_NO_ROLE = (Role.NoRole, Role.Client, Role.Pane, Role.Window, Role.Border, Role.Whitespace, Role.Separator)
"""Of a part of which a screen reader says only that there is something."""

_MAY_BE_ALIKE = (Role.Cell, Role.StaticText)
"""The same value may stand in many lines of a table, where row and column tell which it is; text does nothing."""

_ACTS = ("Press", "Toggle", "Increase", "ShowMenu")
_SPARE_PX = 2


@dataclass(frozen=True, slots=True)
class Told:
    """What a screen reader says of one control that can be focused or pressed, and the panel that it stands in."""

    name: str
    about: str
    role: QAccessible.Role
    place: QRect
    widget: QWidget
    own: bool
    """Whether it is a widget itself, not a row or cell of one."""
    panel: QWidget

    @property
    def spot(self) -> str:
        """For whoever has to find it in the code."""
        return (
            f"{type(self.widget).__name__} {self.widget.objectName()!r} ({self.role.name}) in {self.panel.objectName()}"
        )


def told_flaws(part: QWidget) -> list[str]:
    """One line for each control of ``part`` that cannot be told, or not from another one; empty if all can be."""
    found, alike = list[str](), defaultdict[tuple[object, ...], list[Told]](list)
    window = part.window()
    room = QRect(window.mapToGlobal(QPoint()), window.size()).adjusted(-_SPARE_PX, -_SPARE_PX, _SPARE_PX, _SPARE_PX)
    for one in controls(part):
        if one.role == Role.PageTab and one.place.isEmpty():
            continue  # in the list behind the button at the end of its tabs
        if not one.name.strip():
            found.append(f"{one.spot} has no name")
        elif one.name == one.widget.objectName() or one.name == type(one.widget).__name__:
            found.append(f"{one.spot} is called as the program calls it: {one.name!r}")
        if one.role in _NO_ROLE:
            found.append(f"{one.spot}, {one.name!r}, does not say what it is")
        if one.place.isEmpty() or not (room.contains(one.place) or _scrolled(one)):
            found.append(f"{one.spot}, {one.name!r}, lies at {one.place.getRect()}, outside of {room.getRect()}")
        if one.role not in _MAY_BE_ALIKE:
            # Qt on Linux calls a drop-down by what is chosen in it; which one it is stands in its description.
            about = one.about if one.role == Role.ComboBox else ""
            alike[one.panel, one.role.name, one.name, about].append(one)
    found += [
        f"{len(controls_)} controls are called {name!r}: {', '.join(one.spot for one in controls_)}"
        for (_panel, _role, name, _about), controls_ in alike.items()
        if len(controls_) > 1
    ]
    return [*found, *unknown_to_qt(part), *told_as_html(part)]


def told_as_html(part: QWidget) -> list[str]:
    """Widgets whose tooltip is told with its tags, as Qt does where there is no description."""
    told = [
        (widget, heard.text(QAccessible.Text.Description))
        for widget in (part, *part.findChildren(QWidget))
        if widget.isVisible() and (heard := QAccessible.queryAccessibleInterface(widget)) is not None
    ]
    return [
        f"{type(widget).__name__} {widget.objectName()!r} is told with tags: {words!r}"
        for widget, words in told
        if any(tag in words for tag in ("<p>", "<br>", "<b>"))
    ]


def unknown_to_qt(part: QWidget) -> list[str]:
    """Widgets that have a name, a description or the focus, and are nothing to Qt: what they are is for us to say."""
    shown = [widget for widget in (part, *part.findChildren(QWidget)) if widget.isVisible()]
    met = [each for each in shown if each.accessibleName() or each.accessibleDescription() or each.focusPolicy().value]
    return [
        f"{type(widget).__name__} {widget.objectName()!r}, {widget.accessibleName()!r}, has no accessible_role"
        for widget in met
        if (told := QAccessible.queryAccessibleInterface(widget)) is not None and told.role() == Role.Client
    ]


def controls(part: QWidget) -> list[Told]:
    """Everything within ``part`` that can be focused or pressed, as far as it is shown."""
    root = QAccessible.queryAccessibleInterface(part)
    assert root is not None
    return list(_below(root, part))


def _below(node: QAccessibleInterface, holder: QWidget) -> Iterator[Told]:
    for number in range(node.childCount()):
        child = node.child(number)
        if child is None or not child.isValid() or child.state().invisible:
            continue
        thing = child.object()
        widget = thing if isinstance(thing, QWidget) else holder
        if widget.window() is not holder.window():
            continue
        acts = child.actionInterface()
        pressable = acts is not None and any(act in _ACTS for act in acts.actionNames())
        if (child.state().focusable or pressable) and not isinstance(widget, QScrollBar):
            name, about = child.text(QAccessible.Text.Name), child.text(QAccessible.Text.Description)
            yield Told(name, about, child.role(), child.rect(), widget, widget is thing, panel_of(widget))
        yield from _below(child, widget)


def panel_of(widget: QWidget) -> QWidget:
    """The part of the window in which a name has to tell one control from another: a panel, the tabs above it, a card,
    a strip, a dialog.
    """
    at = widget
    while not at.isWindow():
        holder = at.parentWidget()
        if holder is None or isinstance(at, Overlay) or holder.objectName() in ("main_window", "middle"):
            break
        if isinstance(holder, DockArea):
            break
        at = holder
    return at


def _scrolled(one: Told) -> bool:
    """Whether it can be brought in by scrolling."""
    parent = one.widget if not one.own else one.widget.parentWidget()
    while parent is not None and not parent.isWindow():
        if isinstance(parent, QAbstractScrollArea):
            return True
        parent = parent.parentWidget()
    return False
