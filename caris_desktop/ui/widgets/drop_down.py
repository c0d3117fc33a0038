"""Combo box with a visible arrow that ignores the wheel."""

import math

from PySide6.QtCore import QEvent, QRectF, Qt
from PySide6.QtGui import QHelpEvent, QPaintEvent, QWheelEvent
from PySide6.QtWidgets import QComboBox, QStyle, QStyleOptionComboBox, QStylePainter, QToolTip

from caris_desktop.ui import tokens
from caris_desktop.ui.theme import Theme, draw_icon

_ARROW_PX, _BESIDE_PX = 22, 12


class DropDown(QComboBox):
    """A click does not take the focus from driving, and scrolling changes nothing.

    Long text is elided, with the whole in the tooltip; the popup list is as wide as its entries.
    """

    def __init__(self, theme: Theme, name: str, accessible_name: str) -> None:
        super().__init__()
        self._theme = theme
        self._widest_px = 0
        self.setObjectName(name)
        self.setAccessibleName(accessible_name)
        # Qt on Linux reports the value instead of the name, with this description.
        self.setAccessibleDescription(accessible_name)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setMinimumHeight(tokens.CONTROL_HEIGHT_PX - 4)
        self.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)

    def setEditable(self, editable: bool) -> None:
        super().setEditable(editable)
        line = self.lineEdit()
        if line is not None:
            line.setAccessibleName(self.accessibleName())

    def show_whole(self, *, up_to_px: int) -> None:
        """Fit the width to the current text, up to this limit."""
        self._widest_px = up_to_px
        self.currentTextChanged.connect(self._be_wide_enough)
        self._be_wide_enough(self.currentText())

    def lacks_px(self) -> int:
        """Width missing to show the current text in full."""
        self.ensurePolished()
        return max(0, math.ceil(self.fontMetrics().horizontalAdvance(self.currentText())) - self._room_px())

    def _be_wide_enough(self, text: str) -> None:
        self.ensurePolished()
        needed_px = self.fontMetrics().horizontalAdvance(text) + self.width() - self._room_px() + 2
        self.setMinimumWidth(min(needed_px, self._widest_px))

    def _room_px(self) -> int:
        option = QStyleOptionComboBox()
        self.initStyleOption(option)
        part = QStyle.SubControl.SC_ComboBoxEditField
        field = self.style().subControlRect(QStyle.ComplexControl.CC_ComboBox, option, part, self)
        return min(field.right() - 1, self.width() - _ARROW_PX) - max(field.left(), _BESIDE_PX // 2)

    def showPopup(self) -> None:
        view = self.view()
        view.setMinimumWidth(view.sizeHintForColumn(0) + 2 * _BESIDE_PX)
        super().showPopup()

    def event(self, event: QEvent) -> bool:
        if isinstance(event, QHelpEvent) and event.type() == QEvent.Type.ToolTip and self.lacks_px():
            lines = filter(None, [self.currentText(), self.toolTip()])
            QToolTip.showText(event.globalPos(), "\n".join(lines), self)
            return True
        return super().event(event)

    def wheelEvent(self, event: QWheelEvent) -> None:
        event.ignore()

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QStylePainter(self)
        option = QStyleOptionComboBox()
        self.initStyleOption(option)
        option.currentText = self.fontMetrics().elidedText(
            self.currentText(), Qt.TextElideMode.ElideRight, self._room_px()
        )
        painter.drawComplexControl(QStyle.ComplexControl.CC_ComboBox, option)
        painter.drawControl(QStyle.ControlElement.CE_ComboBoxLabel, option)
        # A style sheet with a border removes the style's arrow.
        painter.setRenderHint(QStylePainter.RenderHint.Antialiasing)
        rect = QRectF(self.width() - 22, self.height() / 2 - 6, 12, 12)
        draw_icon(painter, rect, "caret-down", self._theme.color("text" if self.isEnabled() else "dim"))
