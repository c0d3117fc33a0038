"""Flow layout, which wraps items like words in a line, and scroll areas without a horizontal bar."""

from collections.abc import Sequence

from PySide6.QtCore import QMargins, QPoint, QRect, QSize, Qt
from PySide6.QtWidgets import QFrame, QLayout, QLayoutItem, QScrollArea, QSizePolicy, QWidget


class FlowRow(QWidget):
    """Widget with a FlowLayout, exactly as tall as its width requires."""

    def __init__(self, *widgets: QWidget, gap_px: int = 8) -> None:
        super().__init__()
        self._flow = FlowLayout(self, gap_px=gap_px)
        for widget in widgets:
            self.add(widget)
        policy = QSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Minimum)
        policy.setHeightForWidth(True)
        self.setSizePolicy(policy)

    def add(self, widget: QWidget) -> None:
        self._flow.addWidget(widget)

    def remove(self, widget: QWidget) -> None:
        self._flow.removeWidget(widget)
        widget.hide()

    def arrange(self, widgets: Sequence[QWidget]) -> None:
        """Reorder existing widgets; ``widgets`` lists all of them."""
        self._flow.arrange(widgets)

    def set_gap(self, gap_px: int) -> None:
        self._flow.set_gap(gap_px)

    # Without these, Qt reserves the height of the narrowest possible width.
    def sizeHint(self) -> QSize:
        return self._flow.minimumSize()

    def minimumSizeHint(self) -> QSize:
        return self._flow.minimumSize()

    def heightForWidth(self, width: int) -> int:
        return self._flow.heightForWidth(width)


class FlowLayout(QLayout):
    """Items from left to right at their preferred size, wrapped into lines."""

    def __init__(self, parent: QWidget | None = None, *, gap_px: int = 8) -> None:
        super().__init__(parent)
        self._items: list[QLayoutItem] = []
        self._gap_px = gap_px
        # Cached: Qt queries the same few widths repeatedly.
        self._heights: dict[int, int] = {}
        self._least: QSize | None = None
        self.setContentsMargins(QMargins(0, 0, 0, 0))

    def set_gap(self, gap_px: int) -> None:
        if gap_px != self._gap_px:
            self._gap_px = gap_px
            self.invalidate()

    def arrange(self, widgets: Sequence[QWidget]) -> None:
        """Reorder the items; ``widgets`` lists all of them."""
        place_of: dict[QWidget | None, int] = {widget: place for place, widget in enumerate(widgets)}
        self._items.sort(key=lambda item: place_of[item.widget()])
        self.invalidate()

    def invalidate(self) -> None:
        self._heights.clear()
        self._least = None
        super().invalidate()

    def addItem(self, item: QLayoutItem) -> None:
        self._items.append(item)
        self.invalidate()

    def count(self) -> int:
        return len(self._items)

    def itemAt(self, index: int) -> QLayoutItem | None:
        return self._items[index] if 0 <= index < len(self._items) else None

    def takeAt(self, index: int) -> QLayoutItem | None:
        if not 0 <= index < len(self._items):
            return None
        item = self._items.pop(index)
        self.invalidate()
        return item

    def expandingDirections(self) -> Qt.Orientation:
        return Qt.Orientation(0)

    def hasHeightForWidth(self) -> bool:
        return True

    def heightForWidth(self, width: int) -> int:
        height = self._heights.get(width)
        if height is None:
            height = self._heights[width] = self._arrange(QRect(0, 0, width, 0), move=False)
        return height

    def setGeometry(self, rect: QRect) -> None:
        super().setGeometry(rect)
        self._arrange(rect, move=True)

    def sizeHint(self) -> QSize:
        return self.minimumSize()

    def minimumSize(self) -> QSize:
        if self._least is None:
            self._least = QSize()
            for item in self._items:
                self._least = self._least.expandedTo(item.minimumSize())
        return self._least

    def _arrange(self, rect: QRect, *, move: bool) -> int:
        left, top, line_height = rect.x(), rect.y(), 0
        for item in self._items:
            widget = item.widget()
            if widget is not None and widget.isHidden():
                continue
            hint = item.sizeHint()
            width = min(hint.width(), max(rect.width(), item.minimumSize().width()))
            if left > rect.x() and left + width > rect.right() + 1:
                left, top, line_height = rect.x(), top + line_height + self._gap_px, 0
            if move:
                item.setGeometry(QRect(QPoint(left, top), QSize(width, hint.height())))
            left += width + self._gap_px
            line_height = max(line_height, hint.height())
        return top + line_height - rect.y()


_LEAST_PX = QSize(240, 120)


def list_area(rows: QWidget, *, framed: bool = True, least_px: int = 0) -> QScrollArea:
    """Scroll area around rows, which Tab reaches; with ``least_px`` it takes the height that is left, at least this."""
    area = QScrollArea(widgetResizable=True)
    area.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    area.setWidget(rows)
    if not framed:
        area.setFrameShape(QFrame.Shape.NoFrame)
    if least_px:
        area.setMinimumHeight(least_px)
        area.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Ignored)
    return area


class Scrolled(QScrollArea):
    """Scroll area with the preferred size of its ``content`` where there is room; Tab scrolls to hidden parts."""

    def __init__(self, content: QWidget) -> None:
        super().__init__()
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setWidgetResizable(True)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setWidget(content)

    def sizeHint(self) -> QSize:
        content = self.widget()
        return _LEAST_PX if content is None else content.sizeHint()

    def minimumSizeHint(self) -> QSize:
        return _LEAST_PX

    def focusNextPrevChild(self, next: bool) -> bool:  # noqa: A002 - Qt's name
        moved = super().focusNextPrevChild(next)
        focused = self.focusWidget()
        if moved and focused is not None:
            self.ensureWidgetVisible(focused)
        return moved
