"""Banners over the upper edge of the panels, which last until the wizard decides. They move nothing."""

from collections.abc import Mapping

from PySide6.QtCore import QEvent, QObject, QRect, Signal
from PySide6.QtWidgets import QWidget

from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.banners import Banner
from caris_desktop.ui.focus_widget import Bar

_HEIGHT_PX, _EDGE_PX, _TEXT_PX = 38, 4, 4


class NoticeStrip(Bar, QWidget):
    """Visible banners side by side, as wide as their texts if there is room. ``placed``: they came, changed or went."""

    placed = Signal()

    def __init__(self, over: QWidget, bands: Mapping[Banner, int]) -> None:
        """``bands`` from left to right, with their share of the width where it is short."""
        super().__init__(over)
        self.setObjectName("notice_strip")
        self._over = over
        self._bands = tuple(bands)
        row = layouts.hbox(self, margins_px=0, spacing_px=tokens.GRID_PX)
        for band, share in bands.items():
            row.addWidget(band, share)
            band.installEventFilter(self)
        over.installEventFilter(self)
        self.hide()

    def use_replay(self) -> None:
        """Stay hidden: what the banners tell was then."""
        for watched in (self._over, *self._bands):
            watched.removeEventFilter(self)
        self.hide()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        kinds = QEvent.Type.ShowToParent, QEvent.Type.HideToParent, QEvent.Type.LayoutRequest
        if event.type() in kinds if watched is not self._over else event.type() == QEvent.Type.Resize:
            self._place()
        return super().eventFilter(watched, event)

    def _place(self) -> None:
        shown = [band for band in self._bands if not band.isHidden()]
        needed = sum(band.needed_px for band in shown) + tokens.GRID_PX * (len(shown) - 1)
        width = min(needed, self._over.width() - 2 * _EDGE_PX)
        self.setGeometry(_EDGE_PX, _EDGE_PX, width, _HEIGHT_PX)
        self.setVisible(bool(shown))
        self.raise_()
        self.placed.emit()

    @property
    def covered(self) -> QRect:
        """What is covered of the panels."""
        return QRect() if self.isHidden() else self.geometry()
