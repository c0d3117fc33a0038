"""What a self-painted list shows, told to screen readers: each row and each of its buttons, where it is painted."""

from collections.abc import Callable, Sequence

from PySide6.QtCore import QEvent, QObject, QPoint, QRect, Qt, QTimer
from PySide6.QtGui import QPaintEvent
from PySide6.QtWidgets import QAbstractButton, QWidget

from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class ToldSpot:
    """One thing to press that is only painted. ``key`` stays the same as long as it is the same thing.

    ``rect`` is in the coordinates of the widget that paints it. ``name`` is what a screen reader says, ``about`` what
    it adds when asked.
    """

    key: tuple[str, ...]
    name: str
    rect: QRect
    about: str = ""


class ToldRows(QObject):
    """Keeps one unseen control over each painted spot, so that the accessibility interface finds it, its place and a
    way to press it.

    ``painted`` is the widget that paints, ``over`` it or an ancestor of it in which the controls are put: Qt tells of
    no children of a table but its cells. ``spots`` gives what is in view, ``press`` is called with the key of one that
    was pressed. Mouse and focus pass them by, as painting has both already.
    """

    def __init__(
        self,
        over: QWidget,
        painted: QWidget,
        spots: Callable[[], Sequence[ToldSpot]],
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
        # Whatever changes what can be seen is painted: rows that come, a scroll, another size.
        if event.type() == QEvent.Type.Paint and not self._soon.isActive():
            self._soon.start()
        return False

    def refresh(self) -> None:
        """Tell what is in view now."""
        room = self._painted.rect()
        seen = [spot for spot in self._spots() if spot.rect.intersects(room)] if self._painted.isVisible() else []
        while len(self._controls) < len(seen):
            control = _Control(self._over)
            control.clicked.connect(self._on_clicked)
            self._controls.append(control)
        origin = self._painted.mapTo(self._over, QPoint())
        for number, control in enumerate(self._controls):
            if number < len(seen):
                spot = seen[number]
                control.tell(spot, spot.rect.intersected(room).translated(origin))
            elif not control.isHidden():
                control.hide()

    def _on_clicked(self) -> None:
        control = self.sender()
        if isinstance(control, _Control):
            self._press(control.key)


class _Control(QAbstractButton):
    """There for the accessibility interface alone."""

    def __init__(self, over: QWidget) -> None:
        super().__init__(over)
        self.key: tuple[str, ...] = ()
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.hide()

    def tell(self, spot: ToldSpot, place: QRect) -> None:
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
        """What it stands for has been painted."""
