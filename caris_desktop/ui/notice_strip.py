"""Strip under the top bar: four status indicators, and banners that last until the wizard decides. Of
constant height.
"""

from PySide6.QtCore import QEvent, QObject, Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QSizePolicy, QWidget

from caris_desktop.domain.events import GoalChanged
from caris_desktop.live.status import DriveStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.banners import Banner
from caris_desktop.ui.focus_widget import Bar
from caris_desktop.ui.status_indicators import StatusIndicators
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.elided_label import ElidedLabel

HEIGHT_PX = 38
_ROOM_FOR_WORDS_PX, _ROOM_FOR_BANDS_PX = 1200, 1850


class NoticeStrip(Bar, QWidget):
    """Strip of fixed height. Banners share its width; without any it shows the robot's current activity."""

    def __init__(self, theme: Theme, console: WizardConsole, bands: dict[Banner, int]) -> None:
        """``bands`` from left to right, with their share of the width."""
        super().__init__()
        self.setObjectName("notice_strip")
        self.setFixedHeight(HEIGHT_PX)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self._theme = theme
        self._console = console
        self._bands = tuple(bands)
        self._now = ElidedLabel()
        self._now.setObjectName("robot_now")
        row = layouts.hbox(self, margins_px=(8, 4, 8, 0), spacing_px=tokens.GRID_PX)
        self._signs = StatusIndicators(theme, console.state)
        row.addWidget(self._signs)
        row.addWidget(self._now, 1)
        for band, share in bands.items():
            row.addWidget(band, share)
            band.installEventFilter(self)
        state = console.state
        for value in (state.drive, state.goal, state.robot, state.link):
            value.changed.connect(self._on_changed)
        theme.restyle_on_change(self._style)
        self._make_room()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if event.type() in (QEvent.Type.ShowToParent, QEvent.Type.HideToParent):
            self._make_room()
        return super().eventFilter(watched, event)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._make_room()

    def _make_room(self) -> None:
        alone = all(band.isHidden() for band in self._bands)
        self._now.setVisible(alone)
        compact = self.width() < (_ROOM_FOR_WORDS_PX if alone else _ROOM_FOR_BANDS_PX)
        self._signs.use_room(self.width() - 2 * tokens.GRID_PX, compact=compact)

    def _on_changed(self, _value: object) -> None:
        self._say()

    def _say(self) -> None:
        drive: DriveStatus = self._console.state.drive.value
        goal: GoalChanged | None = self._console.state.goal.value
        self._now.setText(text_formatting.robot_now(drive, goal, self._console.state.robot.value))

    def _style(self) -> None:
        self._theme.style_text(self._now, "dim", tokens.STATUS_PX)
        self._now.setAlignment(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft)
        self._now.setContentsMargins(14, 0, 8, 0)
        self._say()
