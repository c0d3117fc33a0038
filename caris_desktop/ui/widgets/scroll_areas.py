"""Scroll areas without a horizontal bar."""

from PySide6.QtCore import QSize, Qt
from PySide6.QtWidgets import QFrame, QScrollArea, QSizePolicy, QWidget

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
