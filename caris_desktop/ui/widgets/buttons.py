"""Buttons with icon, text and key cap, painted from the design tokens."""

from collections.abc import Callable, Hashable
from functools import partial
from typing import Any, Literal

from PySide6.QtCore import QEvent, QPointF, QRectF, QSize, QSizeF, Qt, Signal, SignalInstance
from PySide6.QtGui import QColor, QFontMetricsF, QHelpEvent, QMouseEvent, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QAbstractButton, QSizePolicy, QToolTip, QWidget

from caris_desktop.ui import tokens
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.theme import Theme, draw_cached, draw_icon
from caris_desktop.ui.widgets.labels import draw_key_cap, key_cap_width

ButtonRole = Literal["plain", "primary", "danger", "ghost", "outline_danger", "amber", "bare"]

Badge = Literal["", "dot", "lock"]

_ICON_PX = 17
_BADGE_PX = 11
_MOST_WIDTHS = 16


class ActionButton(QAbstractButton):
    """Button with icon, text and key cap. A click does not take the focus, so that it interrupts neither typing nor
    driving.
    """

    def __init__(
        self,
        theme: Theme,
        text: str = "",
        *,
        icon: str = "",
        key: str = "",
        role: ButtonRole = "plain",
        key_first: bool = False,
        height_px: int = tokens.CONTROL_HEIGHT_PX,
        text_px: int = tokens.BODY_PX,
        menu_arrow: bool = False,
        may_shrink: bool = False,
        may_lose_words: bool = False,
        semibold: bool = False,
        once: bool = False,
        parent: QWidget | None = None,
        clicked: Callable[..., object] | SignalInstance | None = None,
        **qt: Any,
    ) -> None:
        """``once``: a double click is one click, so that nothing is said twice, and the next item is not taken for this
        one. ``clicked``: slot, or signal to emit. ``qt``: properties and other signals, such as objectName. Without
        text the accessible name is the toolTip.
        """
        super().__init__(parent, **qt)
        if clicked is not None:
            self.clicked.connect(clicked)
        self._theme = theme
        self._icon_name = icon
        self._dot: str | None = None
        self.badge: Badge = ""
        self.key = key
        self._keys_later: tuple[str, ...] = ()
        self._key_shown = True
        self._quiet = self._pointed = False
        self._role: ButtonRole = role
        self._key_first = key_first
        self._height_px = height_px
        self._text_px = text_px
        self._menu_arrow = menu_arrow
        self._may_shrink = may_shrink
        self._may_lose_words = may_lose_words
        self._semibold = semibold
        self._once = once
        self._weight = self._weight_for(role)
        self._widths: dict[Hashable, int] = {}
        self.setText(text)
        self.setAccessibleName(self.accessibleName() or text or self.toolTip())
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setSizePolicy(QSizePolicy.Policy.Maximum, QSizePolicy.Policy.Fixed)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)

    @property
    def may_shrink(self) -> bool:
        """Whether its text may be elided or hidden; tooltip and accessible name have it."""
        return self._may_shrink or self._may_lose_words

    def set_key(self, key: str, later: tuple[str, ...] = ()) -> None:
        """Set the key cap; with room for those of ``later``, so that nothing moves when they replace it."""
        if (key, later) != (self.key, self._keys_later):
            before, self.key, self._keys_later = self._cap_px, key, later
            if before != self._cap_px:
                self.updateGeometry()
            self.update()

    def set_key_shown(self, shown: bool) -> None:
        """Set whether the key cap is shown on the button or only in the tooltip."""
        if shown != self._key_shown:
            self._key_shown = shown
            self.updateGeometry()
            self.update()

    def set_quiet(self, quiet: bool) -> None:
        """Set whether it is painted only while the pointer is over its panel, or Tab has reached it. It keeps its
        place.
        """
        if quiet != self._quiet:
            self._quiet = quiet
            self.updateGeometry()
            self.update()

    def set_pointed(self, pointed: bool) -> None:
        """Set whether the pointer is over its panel."""
        if pointed != self._pointed:
            self._pointed = pointed
            self.update()

    @property
    def is_seen(self) -> bool:
        return not self._quiet or self._pointed or self.hasFocus()

    @property
    def _cap(self) -> str:
        return self.key if self._key_shown else ""

    @property
    def _cap_px(self) -> float:
        """Width of the widest key cap that it may have."""
        caps = (self.key, *self._keys_later) if self._key_shown else ()
        return max((key_cap_width(self._theme, cap) for cap in caps), default=0.0)

    def set_size(self, *, height_px: int, text_px: int) -> None:
        if (height_px, text_px) != (self._height_px, self._text_px):
            self._height_px, self._text_px = height_px, text_px
            self.updateGeometry()
            self.update()

    def set_label(
        self, text: str, *, icon: str | None = None, dot: str | None = None, role: ButtonRole | None = None,
        name: str = "", tip: str | None = None,
    ) -> None:  # fmt: skip
        """Set text and look; ``dot``: colour role of a dot in place of the icon. ``name``: accessible name, if it is
        not the text.
        """
        if tip is not None:
            self.setToolTip(tip)
        label = (text, self._icon_name if icon is None else icon, dot, self._role if role is None else role)
        if label == (self.text(), self._icon_name, self._dot, self._role) and name in ("", self.accessibleName()):
            return
        self.setText(text)
        self.setAccessibleName(name or text)
        self._dot = dot
        if icon is not None:
            self._icon_name = icon
        if role is not None:
            self._role = role
            self._weight = self._weight_for(role)
        self.updateGeometry()
        self.update()

    def set_badge(self, badge: Badge) -> None:
        """Set a corner mark; tooltip and accessible name explain it."""
        if badge != self.badge:
            self.badge = badge
            self.update()

    def _weight_for(self, role: ButtonRole) -> int:
        bold = self._semibold or role in ("danger", "primary", "outline_danger")
        return tokens.WEIGHT_SEMIBOLD if bold else tokens.WEIGHT_NORMAL

    def bind(self, actions: Actions, action_id: str) -> None:
        """Run an action of the table on click, say a refusal, and follow its key, name and availability."""
        self._bound = actions, action_id
        self.clicked.connect(lambda: actions.press(action_id))
        for change in (actions.keys_changed, actions.availability_changed, actions.rebuilt):
            change.connect(self._follow_action)
        self._follow_action()

    def _follow_action(self) -> None:
        actions, action_id = self._bound
        self.set_key(actions.key_text(action_id), actions.key_texts(action_id))
        self.setEnabled(actions.available(action_id))

    def sizeHint(self) -> QSize:
        return QSize(self.width_with(self.text()), self._height_px)

    def width_with(self, text: str) -> int:
        """Width with this text, and the current icon and key."""
        has_icon = bool(self._icon_name) or self._dot is not None
        measured = (text, self._cap_px, has_icon, self._menu_arrow, self._height_px, self._text_px, self._weight)
        width = self._widths.get(measured)
        if width is None:
            width = round(self._content_width(text) + 2 * self._side_px(text) + 0.5)
            if len(self._widths) >= _MOST_WIDTHS:
                self._widths.clear()
            self._widths[measured] = width
        return width

    def minimumSizeHint(self) -> QSize:
        # A long label may be elided (tooltip: full text), its key never.
        full = self.sizeHint()
        if self._may_lose_words:
            return QSize(self.width_with(""), full.height())
        if not self._may_shrink:
            return full
        return QSize(min(full.width(), round(self._cap_px) + 72), full.height())

    def _side_px(self, text: str) -> int:
        if not text:
            return max(4, (self._height_px - _ICON_PX) // 2)
        return 10 if self._height_px < 36 else 16

    def _content_width(self, text: str) -> float:
        width = QFontMetricsF(self._theme.font(self._text_px, self._weight)).horizontalAdvance(text)
        spaces = -8
        for present, part in (
            (bool(self._icon_name) or self._dot is not None, float(_ICON_PX)),
            (self._cap_px > 0, self._cap_px),
            (self._menu_arrow, 12.0),
            (bool(text), 0.0),
        ):
            if present:
                width += part
                spaces += 8
        return width + max(0, spaces)

    def _inks(self) -> tuple[QColor | None, QColor | None, QColor, str]:
        """Background, outline and text colour, and the role of a key cap on a coloured background."""
        theme, hover = self._theme, self.underMouse() and self.isEnabled()
        down = self.isDown()
        if self._role == "danger":
            return theme.color("red_hover" if hover or down else "red_fill"), None, theme.color("on_red"), "on_red"
        if self._role == "primary" and self.isEnabled():
            ground = theme.color("blue")
            return (ground.darker(112) if down else ground), None, theme.color("on_blue"), "on_blue"
        if self._role == "outline_danger":
            return theme.color("red_soft"), theme.color("red"), theme.color("text"), ""
        if self._role == "amber":
            return theme.color("amber_soft"), theme.color("amber"), theme.color("text"), ""
        ink = theme.color("text" if self.isEnabled() else "dim")
        if self._role == "bare" and not (hover or down):
            return None, None, theme.color("dim"), ""
        if self._role == "ghost":
            return (theme.color("raised") if hover or self.isChecked() else None), None, ink, ""
        if self.isChecked():
            return theme.color("blue_soft"), theme.color("blue"), ink, ""
        ground = theme.color("raised_hover" if (hover or down) else "raised")
        return ground, theme.color("line"), ink, ""

    def paintEvent(self, _event: QPaintEvent) -> None:
        if not self.is_seen:
            return
        ground, line, ink, on = self._inks()
        colors = tuple(
            None if color is None else color.name(QColor.NameFormat.HexArgb) for color in (ground, line, ink)
        )
        marks = (self._icon_name, self._dot, self.badge, self._cap, self._cap_px, self._key_first, self._menu_arrow)
        font = (self._height_px, self._text_px, self._weight, self._may_lose_words)
        now = (self.isEnabled(), self.hasFocus(), on)
        key = ("button", self.text(), colors, marks, font, now)
        paint = partial(self._paint, ground=ground, line=line, ink=ink, on=on)
        draw_cached(QPainter(self), QPointF(), QSizeF(self.size()), key, paint)

    def _paint(self, painter: QPainter, ground: QColor | None, line: QColor | None, ink: QColor, on: str) -> None:
        theme = self._theme
        rect = QRectF(self.rect()).adjusted(0.5, 0.5, -0.5, -0.5)
        if not self.isEnabled():
            painter.setOpacity(0.75)
        painter.setPen(QPen(line, 1) if line is not None else Qt.PenStyle.NoPen)
        painter.setBrush(ground if ground is not None else Qt.BrushStyle.NoBrush)
        painter.drawRoundedRect(rect, tokens.CONTROL_RADIUS_PX, tokens.CONTROL_RADIUS_PX)
        if self.hasFocus():
            painter.setPen(QPen(theme.color("text" if on else "blue"), 2))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(
                rect.adjusted(1, 1, -1, -1), tokens.CONTROL_RADIUS_PX - 1, tokens.CONTROL_RADIUS_PX - 1
            )
        self._draw_content(painter, ink, on)
        if self.badge:
            corner = QRectF(self.width() - _BADGE_PX - 3, 3, _BADGE_PX, _BADGE_PX)
            if self.badge == "lock":
                draw_icon(painter, corner, "lock-simple", theme.color("amber"))
            else:
                painter.setPen(QPen(theme.color("panel"), 2))
                painter.setBrush(theme.color("amber"))
                painter.drawEllipse(corner)

    def _draw_content(self, painter: QPainter, ink: QColor, on: str) -> None:
        theme, center = self._theme, self.height() / 2
        text = self.text()
        if self._may_lose_words and self.width() < self.width_with(text) - 1:
            text = ""
        side = float(self._side_px(text))
        cap = key_cap_width(theme, self._cap)
        left = max(side, (self.width() - self._content_width(text) + self._cap_px - cap) / 2)
        right_end = self.width() - side
        if self._dot is not None:
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(theme.color(self._dot))
            painter.drawEllipse(QRectF(left + 3, center - 5, 10, 10))
            left += _ICON_PX + 8
        elif self._icon_name:
            draw_icon(painter, QRectF(left, center - _ICON_PX / 2, _ICON_PX, _ICON_PX), self._icon_name, ink)
            left += _ICON_PX + 8
        if cap and self._key_first:
            draw_key_cap(painter, theme, self._cap, left, center, on=on)
            left += cap + 8
        after = (cap + 8 if cap and not self._key_first else 0.0) + (20.0 if self._menu_arrow else 0.0)
        if text:
            font = theme.font(self._text_px, self._weight)
            painter.setFont(font)
            painter.setPen(ink)
            metrics = QFontMetricsF(font)
            room = right_end - left - after
            elided = metrics.elidedText(text, Qt.TextElideMode.ElideRight, room + 1)
            painter.drawText(
                QRectF(left, 0, room + 2, self.height()),
                int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft),
                elided,
            )
            left += min(room, metrics.horizontalAdvance(elided)) + 8
        if cap and not self._key_first:
            draw_key_cap(painter, theme, self._cap, left, center, on=on)
            left += cap + 8
        if self._menu_arrow:
            draw_icon(painter, QRectF(left, center - 6, 12, 12), "caret-down", ink)

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        if self._once:
            event.accept()
        else:
            super().mouseDoubleClickEvent(event)

    def event(self, event: QEvent) -> bool:
        """Add a key that is not shown to the tooltip."""
        if isinstance(event, QHelpEvent) and event.type() == QEvent.Type.ToolTip and self.key and not self._key_shown:
            QToolTip.showText(event.globalPos(), f"{self.toolTip()} ({self.key})".strip(), self)
            return True
        return super().event(event)


_ANY_PX = 16_777_215


class StatusButton(QAbstractButton):
    """Icon and coloured text; hidden while the text is empty."""

    words_changed = Signal()

    def __init__(self, theme: Theme, name: str, tip: str) -> None:
        super().__init__()
        self.setObjectName(name)
        self._theme = theme
        self._icon, self.role = "", "dim"
        self._most_px = _ANY_PX
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setCursor(Qt.CursorShape.PointingHandCursor)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Expanding)
        self.setToolTip(tip)

    def show_words(self, text: str, icon: str, role: str, *, spoken: str) -> None:
        """Set the text; ``spoken``: its accessible name."""
        if not text:
            self.hide()
            self.words_changed.emit()
        elif self.parentWidget() is not None:
            self.show()
        if (text, icon, role) == (self.text(), self._icon, self.role):
            return
        self._icon, self.role = icon, role
        self.setText(text)
        self.setAccessibleName(spoken)
        self.updateGeometry()
        self.update()
        self.words_changed.emit()

    def use_room(self, width_px: int) -> None:
        """Limit the width; the text is elided."""
        if width_px != self._most_px:
            self._most_px = width_px
            self.updateGeometry()
            self.update()

    @property
    def full_px(self) -> int:
        """Width in px with its whole text."""
        return round(QFontMetricsF(self._theme.font(tokens.STATUS_PX)).horizontalAdvance(self.text())) + 24

    def sizeHint(self) -> QSize:
        return QSize(min(self.full_px, self._most_px), 24)

    def minimumSizeHint(self) -> QSize:
        return self.sizeHint()

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter, theme = QPainter(self), self._theme
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self.hasFocus():
            painter.setPen(QPen(theme.color("blue"), 1.4))
            painter.drawRoundedRect(QRectF(self.rect()).adjusted(0.7, 4.7, -0.7, -4.7), 6, 6)
        role = "dim" if self.role == "green" and not self.underMouse() else self.role
        draw_icon(painter, QRectF(2, self.height() / 2 - 7.5, 15, 15), self._icon, theme.color(self.role))
        painter.setFont(theme.font(tokens.STATUS_PX))
        painter.setPen(theme.color("text" if self.underMouse() else role))
        rect = QRectF(22, 0, self.width() - 22, self.height())
        text = self.text()
        if self.full_px > self._most_px:
            text = painter.fontMetrics().elidedText(text, Qt.TextElideMode.ElideRight, round(rect.width()))
        painter.drawText(rect, int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft), text)
