"""Accessible regions: rows and buttons of self-painted lists, for screen readers."""

from collections.abc import Callable, Sequence

from PySide6.QtCore import QEvent, QObject, QPoint, QRect, Qt, QTimer
from PySide6.QtGui import QPaintEvent
from PySide6.QtWidgets import QAbstractButton, QWidget

from caris_desktop.domain.value_class import Value


class AccessibleRegion(Value):
    """Accessible region of a painted item. ``key`` identifies it.

    ``rect``: in the coordinates of the painting widget. ``name``: accessible name; ``about``: accessible description.
    """

    key: tuple[str, ...]
    name: str
    rect: QRect
    about: str = ""


class AccessibleRegions(QObject):
    """Keeps an invisible control over each painted item, so that the accessibility interface can find and press it.

    ``painted``: the painting widget; ``over``: it or an ancestor that gets the controls, because Qt exposes no children
    of a table except its cells. ``spots`` returns the visible regions, ``press`` is called with a pressed key. Controls
    ignore mouse and focus, which the painting widget handles.
    """

    def __init__(
        self,
        over: QWidget,
        painted: QWidget,
        spots: Callable[[], Sequence[AccessibleRegion]],
        press: Callable[[tuple[str, ...]], object],
    ) -> None:
        super().__init__(painted)
        self._over = over
        self._painted = painted
        self._spots = spots
        self._press = press
        self._controls: list[_Control] = []
        self._soon = QTimer(self, singleShot=True, interval=0)
        self._soon.timeout.connect(self.refresh)
        painted.installEventFilter(self)

    def eventFilter(self, _watched: QObject, event: QEvent) -> bool:
        # Any visible change causes a paint event: new rows, scrolling, resizing.
        if event.type() == QEvent.Type.Paint and not self._soon.isActive():
            self._soon.start()
        return False

    def refresh(self) -> None:
        """Update the controls to the visible regions."""
        room = self._painted.rect()
        visible = [spot for spot in self._spots() if spot.rect.intersects(room)] if self._painted.isVisible() else []
        while len(self._controls) < len(visible):
            control = _Control(self._over)
            control.clicked.connect(self._on_clicked)
            self._controls.append(control)
        origin = self._painted.mapTo(self._over, QPoint())
        for number, control in enumerate(self._controls):
            if number < len(visible):
                spot = visible[number]
                control.show_spot(spot, spot.rect.intersected(room).translated(origin))
            elif not control.isHidden():
                control.hide()

    def _on_clicked(self) -> None:
        control = self.sender()
        if isinstance(control, _Control):
            self._press(control.key)


class _Control(QAbstractButton):
    """Control for the accessibility interface only."""

    def __init__(self, over: QWidget) -> None:
        super().__init__(over)
        self.key: tuple[str, ...] = ()
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.hide()

    def show_spot(self, spot: AccessibleRegion, place: QRect) -> None:
        self.key = spot.key
        if self.accessibleName() != spot.name:
            self.setAccessibleName(spot.name)
        if self.accessibleDescription() != spot.about:
            self.setAccessibleDescription(spot.about)
        if self.geometry() != place:
            self.setGeometry(place)
        if self.isHidden():
            self.show()

    def paintEvent(self, _event: QPaintEvent) -> None:
        """Paint nothing: the item is painted already."""
