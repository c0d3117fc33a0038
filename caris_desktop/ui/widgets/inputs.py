"""Line edits, text fields, check boxes and drop-downs that interrupt neither typing nor driving."""

import math
from collections.abc import Callable, Sequence
from typing import Any

from PySide6.QtCore import QEvent, QRect, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QFocusEvent, QFontMetricsF, QHelpEvent, QKeyEvent, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QLineEdit,
    QPlainTextEdit,
    QSizePolicy,
    QStyle,
    QStyleOptionComboBox,
    QToolButton,
    QToolTip,
    QWidget,
)

from caris_desktop.domain.translation import tr
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.theme import Theme, draw_icon
from caris_desktop.ui.widgets.labels import IconLabel, named

_ENTER = (Qt.Key.Key_Return, Qt.Key.Key_Enter)


class SubmitLineEdit(QLineEdit):
    """The field handles Enter even if it is a window shortcut. Unused keys are consumed, except Esc."""

    def __init__(self, parent: QWidget | None = None, **qt: Any) -> None:
        """``qt``: properties and signals of Qt, such as objectName and returnPressed."""
        super().__init__(parent, **qt)

    def event(self, event: QEvent) -> bool:
        if event.type() == QEvent.Type.ShortcutOverride and isinstance(event, QKeyEvent):
            with_ctrl = event.modifiers() & Qt.KeyboardModifier.ControlModifier
            if event.key() in _ENTER and not with_ctrl:
                event.accept()
                return True
        return super().event(event)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        super().keyPressEvent(event)
        if event.key() != Qt.Key.Key_Escape:
            event.accept()


class KeyCommandEdit(QLineEdit):
    """Field in which some keys are commands of its owner: ``command_of`` returns theirs, and something false for all
    other keys.
    """

    commanded = Signal(object)
    left = Signal()

    def __init__(self, command_of: Callable[[QKeyEvent], object], **qt: Any) -> None:
        """``qt``: properties and signals of Qt."""
        super().__init__(**qt)
        self._command_of = command_of

    def event(self, event: QEvent) -> bool:
        pressed = event.type() in (QEvent.Type.ShortcutOverride, QEvent.Type.KeyPress)
        if pressed and isinstance(event, QKeyEvent) and (command := self._command_of(event)):
            event.accept()
            if event.type() == QEvent.Type.KeyPress:
                self.commanded.emit(command)
            return True
        return super().event(event)

    def focusOutEvent(self, event: QFocusEvent) -> None:
        super().focusOutEvent(event)
        self.left.emit()


class SubmitTextEdit(QPlainTextEdit):
    """The field handles Enter even if it is a window shortcut; Ctrl+Enter goes to the window."""

    entered = Signal()
    left = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.setTabChangesFocus(True)
        self.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAsNeeded)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)

    def means_enter(self, event: QKeyEvent) -> bool:
        """Whether this key submits."""
        return event.key() in _ENTER and not event.modifiers() & Qt.KeyboardModifier.ControlModifier

    def event(self, event: QEvent) -> bool:
        if event.type() == QEvent.Type.ShortcutOverride and isinstance(event, QKeyEvent) and self.means_enter(event):
            event.accept()
            return True
        return super().event(event)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if self.means_enter(event):
            # Auto-repeat does not submit again.
            if not event.isAutoRepeat():
                self.entered.emit()
            event.accept()
            return
        super().keyPressEvent(event)
        if not self.isReadOnly():
            # Unused keys are consumed, except Esc.
            event.setAccepted(event.key() != Qt.Key.Key_Escape)

    def focusOutEvent(self, event: QFocusEvent) -> None:
        super().focusOutEvent(event)
        self.left.emit()


def add_clear_button(field: QLineEdit) -> None:
    field.setClearButtonEnabled(True)
    for button in field.findChildren(QToolButton):
        button.setAccessibleName(tr("Clear the field: {field}").format(field=field.accessibleName()))


BOX_PX = 18
TEXT_LEFT_PX = BOX_PX + 10
_LEAST_WRAPPED_PX = 200


class CheckBox(QCheckBox):
    """A click does not take the focus from typing or driving.

    With ``wraps`` the text wraps. ``qt``: properties and signals of Qt, such as objectName and toggled.
    """

    def __init__(self, theme: Theme, text: str = "", *, wraps: bool = False, **qt: Any) -> None:
        super().__init__(text, **qt)
        self._theme = theme
        self._wraps = wraps
        if wraps:
            policy = QSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Minimum)
            policy.setHeightForWidth(True)
            self.setSizePolicy(policy)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setMinimumHeight(BOX_PX + 6)

    def sizeHint(self) -> QSize:
        width = QFontMetricsF(self.font()).horizontalAdvance(self.text())
        return QSize(round(TEXT_LEFT_PX + width + 4), max(BOX_PX + 6, self.fontMetrics().height() + 4))

    def minimumSizeHint(self) -> QSize:
        size = self.sizeHint()
        return QSize(min(size.width(), _LEAST_WRAPPED_PX), size.height()) if self._wraps else size

    def heightForWidth(self, width: int) -> int:
        if not self._wraps:
            return self.sizeHint().height()
        room = QRect(0, 0, max(1, width - TEXT_LEFT_PX), 2000)
        wrapped = self.fontMetrics().boundingRect(room, int(Qt.TextFlag.TextWordWrap), self.text())
        return max(BOX_PX + 6, wrapped.height() + 4)

    def hitButton(self, _pos: object) -> bool:
        return True  # the whole area

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme, checked = self._theme, self.isChecked()
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if not self.isEnabled():
            painter.setOpacity(0.6)
        box = QRectF(1.5, self.height() / 2 - BOX_PX / 2 + 0.5, BOX_PX - 1, BOX_PX - 1)
        painter.setPen(QPen(theme.color("blue" if checked or self.hasFocus() else "dim"), 1.4))
        painter.setBrush(theme.color("blue" if checked else "field"))
        painter.drawRoundedRect(box, 4, 4)
        if checked:
            draw_icon(painter, box.adjusted(2, 2, -2, -2), "check-bold", theme.color("on_blue"))
        if self.hasFocus():
            painter.setPen(QPen(theme.color("blue"), 1.4))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(box.adjusted(-1.5, -1.5, 1.5, 1.5), 5, 5)
        painter.setPen(theme.color("text"))
        painter.setFont(self.font())
        rect = QRectF(TEXT_LEFT_PX, 0, self.width() - TEXT_LEFT_PX, self.height())
        flags = int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft)
        painter.drawText(rect, flags | int(Qt.TextFlag.TextWordWrap) if self._wraps else flags, self.text())


_ARROW_PX, _BESIDE_PX = 22, 12


class DropDown(QComboBox):
    """A click does not take the focus from driving.

    Long text is elided, with the whole in the tooltip; the popup list is as wide as its entries.
    """

    def __init__(self, theme: Theme, name: str, accessible_name: str, **qt: Any) -> None:
        """``qt``: properties and signals of Qt, such as toolTip and activated."""
        super().__init__(**qt)
        # A style sheet with a border removes the style's arrow.
        arrow = IconLabel(theme, "caret-down", "text", size_px=12)
        arrow.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        layouts.hbox(self, 1, arrow, margins_px=(0, 0, 10, 0))
        self._widest_px = 0
        named(self, name, accessible_name)
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

    def fill(self, items: Sequence[tuple[str, Any]], current: object) -> None:
        """Offer texts with their data, and select the one of ``current``. The same items leave an open list open."""
        if [(self.itemText(at), self.itemData(at)) for at in range(self.count())] != list(items):
            self.clear()
            for text, data in items:
                self.addItem(text, data)
        self.setCurrentIndex(next((at for at, (_text, data) in enumerate(items) if data == current), -1))

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

    def initStyleOption(self, option: QStyleOptionComboBox) -> None:
        super().initStyleOption(option)
        text, right = self.currentText(), Qt.TextElideMode.ElideRight
        option.currentText = self.fontMetrics().elidedText(text, right, self._room_px())

    def _room_px(self) -> int:
        option = QStyleOptionComboBox()
        super().initStyleOption(option)
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
