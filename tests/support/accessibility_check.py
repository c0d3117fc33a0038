"""Check of a window's accessibility tree for controls that a screen reader cannot name, describe or tell apart."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

from PySide6.QtCore import QPoint, QRect
from PySide6.QtGui import QAccessible, QAccessibleInterface
from PySide6.QtWidgets import QAbstractScrollArea, QScrollBar, QWidget

from caris_desktop.ui.dock_area import DockArea
from caris_desktop.ui.overlay import Overlay

Role = QAccessible.Role

_NO_ROLE = (Role.NoRole, Role.Client, Role.Pane, Role.Window, Role.Border, Role.Whitespace, Role.Separator)
"""Roles without any information about the control."""

_MAY_SHARE_NAME = (Role.Cell, Role.StaticText)
"""Cells are identified by row and column, and static text has no action."""

_ACTIONS = ("Press", "Toggle", "Increase", "ShowMenu")
_SPARE_PX = 2


@dataclass(frozen=True, slots=True)
class AccessibleControl:
    """Accessible name, description, role and rectangle of a control that can be focused or pressed, and its panel."""

    name: str
    description: str
    role: QAccessible.Role
    place: QRect
    widget: QWidget
    is_widget: bool
    """True for a widget, False for a row or cell of one."""
    panel: QWidget

    @property
    def location(self) -> str:
        """Widget class, object name, role and panel, for error messages."""
        return (
            f"{type(self.widget).__name__} {self.widget.objectName()!r} ({self.role.name}) in {self.panel.objectName()}"
        )


def accessibility_flaws(part: QWidget) -> list[str]:
    """One line for each control of ``part`` without a name, without a role, or with the name of another one."""
    found, by_name = list[str](), defaultdict[tuple[object, ...], list[AccessibleControl]](list)
    window = part.window()
    window_rect = QRect(window.mapToGlobal(QPoint()), window.size()).adjusted(
        -_SPARE_PX, -_SPARE_PX, _SPARE_PX, _SPARE_PX
    )
    for one in controls(part):
        if one.role == Role.PageTab and one.place.isEmpty():
            continue  # hidden in the overflow list of the tab bar
        if not one.name.strip():
            found.append(f"{one.location} has no name")
        elif one.name == one.widget.objectName() or one.name == type(one.widget).__name__:
            found.append(f"{one.location} has an internal name as accessible name: {one.name!r}")
        if one.role in _NO_ROLE:
            found.append(f"{one.location}, {one.name!r}, has no role")
        if one.place.isEmpty() or not (window_rect.contains(one.place) or _scrolled(one)):
            found.append(
                f"{one.location}, {one.name!r}, is at {one.place.getRect()}, outside of {window_rect.getRect()}"
            )
        if one.role not in _MAY_SHARE_NAME:
            # On Linux Qt uses the current item as the name of a combo box; the description identifies it.
            description = one.description if one.role == Role.ComboBox else ""
            by_name[one.panel, one.role.name, one.name, description].append(one)
    found += [
        f"{len(controls_)} controls share the accessible name {name!r}: {', '.join(one.location for one in controls_)}"
        for (_panel, _role, name, _description), controls_ in by_name.items()
        if len(controls_) > 1
    ]
    return [*found, *widgets_without_role(part), *html_descriptions(part)]


def html_descriptions(part: QWidget) -> list[str]:
    """Widgets whose tooltip, Qt's fallback for a missing description, contains HTML tags."""
    described = [
        (widget, interface.text(QAccessible.Text.Description))
        for widget in (part, *part.findChildren(QWidget))
        if widget.isVisible() and (interface := QAccessible.queryAccessibleInterface(widget)) is not None
    ]
    return [
        f"{type(widget).__name__} {widget.objectName()!r} has HTML tags in its accessible description: {words!r}"
        for widget, words in described
        if any(tag in words for tag in ("<p>", "<br>", "<b>"))
    ]


def widgets_without_role(part: QWidget) -> list[str]:
    """Focusable or named widgets that Qt gives no specific role, so that they need an ``accessible_role``."""
    shown = [widget for widget in (part, *part.findChildren(QWidget)) if widget.isVisible()]
    met = [each for each in shown if each.accessibleName() or each.accessibleDescription() or each.focusPolicy().value]
    return [
        f"{type(widget).__name__} {widget.objectName()!r}, {widget.accessibleName()!r}, has no accessible_role"
        for widget in met
        if (interface := QAccessible.queryAccessibleInterface(widget)) is not None and interface.role() == Role.Client
    ]


def controls(part: QWidget) -> list[AccessibleControl]:
    """All visible controls within ``part`` that can be focused or pressed."""
    root = QAccessible.queryAccessibleInterface(part)
    assert root is not None
    return list(_below(root, part))


def _below(node: QAccessibleInterface, holder: QWidget) -> Iterator[AccessibleControl]:
    for number in range(node.childCount()):
        child = node.child(number)
        if child is None or not child.isValid() or child.state().invisible:
            continue
        thing = child.object()
        widget = thing if isinstance(thing, QWidget) else holder
        if widget.window() is not holder.window():
            continue
        actions = child.actionInterface()
        pressable = actions is not None and any(action in _ACTIONS for action in actions.actionNames())
        if (child.state().focusable or pressable) and not isinstance(widget, QScrollBar):
            name, description = child.text(QAccessible.Text.Name), child.text(QAccessible.Text.Description)
            yield AccessibleControl(
                name, description, child.role(), child.rect(), widget, widget is thing, panel_of(widget)
            )
        yield from _below(child, widget)


def panel_of(widget: QWidget) -> QWidget:
    """The part of the window in which accessible names must be unique: a panel, its tab bar, a card, a strip or a
    dialog.
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


def _scrolled(one: AccessibleControl) -> bool:
    """True if a scroll area can bring the control into view."""
    parent = one.widget if not one.is_widget else one.widget.parentWidget()
    while parent is not None and not parent.isWindow():
        if isinstance(parent, QAbstractScrollArea):
            return True
        parent = parent.parentWidget()
    return False
