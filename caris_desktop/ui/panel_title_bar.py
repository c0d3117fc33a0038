"""Title bar of a panel, with elision and shrinking of its parts when space is short."""

from collections.abc import Sequence

from PySide6.QtCore import QEvent, QRectF, QSize, Qt
from PySide6.QtGui import QAccessible, QColor, QMouseEvent, QPainter, QPaintEvent
from PySide6.QtWidgets import QSizePolicy, QWidget

from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.focus_widget import Bar
from caris_desktop.ui.panel import TITLE_HEIGHT_PX, Panel, draw_card
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.labels import ElidedLabel

_LEAST_TITLE_PX, _ANY_PX = 40, 16_777_215


class PanelTitleBar(Bar, QWidget):
    """Upper part of a panel's card: title left, status text and controls right.

    When space is short, the status text is elided first, then buttons with an icon lose their text from right to left,
    and last the title is elided; tooltips show elided text. ``more``: controls of the dock area, after the panel's own.
    ``looked_at``: view-only, without controls. On a ``picture`` it is only the controls, the first at the left end.
    """

    def __init__(
        self, panel: Panel, more: Sequence[QWidget] = (), *, looked_at: bool = False, picture: QWidget | None = None
    ) -> None:
        super().__init__()
        self._picture = picture
        self._pointed = False
        self._unseen = QWidget(self) if looked_at else None
        if self._unseen is not None:
            self._unseen.hide()
        self._panel = panel
        self._theme = panel.theme
        self.setFixedHeight(TITLE_HEIGHT_PX)
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Fixed)
        self._title = ElidedLabel()
        self._title.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Preferred)
        self._title.setMinimumWidth(_LEAST_TITLE_PX)
        self._title.setText(panel.shown_title)
        self._fact = _ElidedLabel()
        self._fact.setObjectName("panel_fact")
        self._more = tuple(more)
        self._controls: tuple[QWidget, ...] = ()
        self._row = row = layouts.hbox(self, spacing_px=8)
        row.addWidget(self._title)
        row.addWidget(self._fact, 1)
        self._show_controls()
        self._title.setVisible(picture is None)
        # Clicks on the labels must reach the dock, which is dragged by its title.
        for label in (self._title, self._fact):
            label.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        panel.fact_changed.connect(self._show_fact)
        panel.title_changed.connect(self._title.setText)
        panel.controls_changed.connect(self._show_controls)
        panel.active_changed.connect(self._on_active_changed)
        self._theme.restyle_on_change(self._style)

    def _show_controls(self) -> None:
        own, more = self._panel.title_widgets(), self._more
        # What appears under the pointer only comes first, so that the others reach the edge.
        controls = (*more, *own) if self._picture is None else (*own[:1], *more, *own[1:])
        before, self._controls = self._controls, controls
        for widget in before:
            self._row.removeWidget(widget)
            if widget not in self._controls:
                widget.hide()
                widget.deleteLater()
        if self._unseen is not None:
            for widget in self._controls:
                widget.setParent(self._unseen)
            self._controls = ()
        over = self._picture is not None
        self._row.setContentsMargins(*((10, 6, 10, 2) if over else (14, 3, 6 if self._controls else 14, 3)))
        for number, widget in enumerate(self._controls):
            self._row.insertWidget(0 if over and number == 0 else self._row.count(), widget)
        self.set_pointed(self._pointed)

    def set_pointed(self, pointed: bool) -> None:
        """Set whether the pointer is over the panel, which shows its quiet buttons."""
        self._pointed = pointed
        for widget in self._controls:
            if isinstance(widget, ActionButton):
                widget.set_pointed(pointed)
        self._place_fact()

    def _place_fact(self) -> None:
        """Give the status text the place of quiet buttons, as long as they are not seen."""
        seen = [
            widget
            for widget in self._controls
            if not widget.isHidden() and (self._pointed or not isinstance(widget, ActionButton) or widget.is_seen)
        ]
        place = self._fact.geometry()
        edge = self.width() - self._row.contentsMargins().right() + self._row.spacing()
        place.setRight(min((widget.x() for widget in seen), default=min(edge, self.width() - 6)) - self._row.spacing())
        self._fact.setGeometry(place)

    def event(self, event: QEvent) -> bool:
        if event.type() in (QEvent.Type.Resize, QEvent.Type.LayoutRequest):
            self._fit()
            self._place_fact()
        return super().event(event)

    def _fit(self) -> None:
        """Hide button texts as far as the title needs their space."""
        row = self._row
        visible = [widget for widget in self._controls if not widget.isHidden()]
        widths = [self._title.sizeHint().width()] if not self._title.isHidden() else []
        widths += [widget.sizeHint().width() for widget in visible]
        margins = row.contentsMargins()
        missing_px = sum(widths) + row.spacing() * len(widths) + margins.left() + margins.right() - self.width()
        for button in reversed(visible):
            if not isinstance(button, ActionButton) or not button.may_shrink:
                continue
            full_px, least_px = button.sizeHint().width(), button.minimumSizeHint().width()
            button.setMaximumWidth(least_px if missing_px > 0 else _ANY_PX)
            missing_px -= full_px - least_px if missing_px > 0 else 0
        # The title ignores the mouse because it is the drag handle.
        self.setToolTip(self._panel.shown_title if missing_px > 0 and not self._title.isHidden() else "")

    def sizeHint(self) -> QSize:
        # A dock queries only this size of its title bar.
        return QSize(160, TITLE_HEIGHT_PX)

    def minimumSizeHint(self) -> QSize:
        return QSize(120, TITLE_HEIGHT_PX)

    def set_tabbed(self, tabbed: bool) -> None:
        """Hide the title in a tab group: the tab shows it."""
        self._title.setVisible(not tabbed and self._picture is None)

    def _style(self) -> None:
        self._title.setFont(self._theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD))
        self._fact.setFont(self._theme.font(tokens.STATUS_PX))
        self._show_fact(*self._panel.fact)
        self.update()

    def _show_fact(self, text: str, role: str) -> None:
        if self._picture is not None:
            return  # the picture says it
        self._fact.set_text(
            text, self._theme.color(role or "dim"), lead=self._panel.fact_lead, rest_color=self._theme.color("dim")
        )

    def _on_active_changed(self, _active: bool) -> None:
        self.update()

    def mousePressEvent(self, event: QMouseEvent) -> None:
        event.ignore()  # starts dragging the dock

    def paintEvent(self, _event: QPaintEvent) -> None:
        if self._picture is not None:
            return
        painter = QPainter(self)
        draw_card(painter, self._theme, QRectF(self.rect()), top=True, active=self._panel.active)


class _ElidedLabel(QWidget):
    """Right-aligned, elided single line; its beginning may be highlighted."""

    accessible_role = QAccessible.Role.StaticText

    def __init__(self) -> None:
        super().__init__()
        self._text = ""
        self._lead = 0
        self._color = QColor()
        self._rest_color = QColor()
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)

    def set_text(self, text: str, color: QColor, *, lead: int, rest_color: QColor) -> None:
        self._text, self._color, self._lead, self._rest_color = text, color, lead, rest_color
        self.setAccessibleName(text)
        self.setToolTip(text)
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        metrics = self.fontMetrics()
        text = metrics.elidedText(self._text, Qt.TextElideMode.ElideRight, self.width())
        place = self.rect()
        place.setLeft(place.right() + 1 - metrics.horizontalAdvance(text))
        middle = int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        for part, color in ((text[: self._lead], self._color), (text[self._lead :], self._rest_color)):
            painter.setPen(color)
            painter.drawText(place, middle | int(Qt.TextFlag.TextDontClip), part)
            place.setLeft(place.left() + metrics.horizontalAdvance(part))
