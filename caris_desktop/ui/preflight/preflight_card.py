"""Preflight popup, and the status bar button that opens it."""

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QHBoxLayout, QLabel, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.live.status import IN_SESSION, PreflightCheck
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.preflight.preflight_list import PreflightList
from caris_desktop.ui.preflight.preflight_words import ICONS, ROLES, STATES, summary, worst
from caris_desktop.ui.text_formatting import ESC_CLOSES
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.status_button import StatusButton

_WIDTH_PX, _CHROME_PX, _SIDES_PX = 680, 96, 32


class PreflightCard(Overlay):
    """List of checks with the number of open ones. The robot can be driven and stopped meanwhile."""

    def __init__(self, theme: Theme, window: QWidget, console: WizardConsole) -> None:
        super().__init__(theme, window, width_px=_WIDTH_PX)
        self.setObjectName("preflight_card")
        self._console = console
        self._heading = QLabel(tr("Before a recording"))
        self._heading.setFont(theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        self._summary = QLabel(wordWrap=True, textFormat=Qt.TextFormat.PlainText)
        self._summary.setObjectName("preflight_summary")
        self._summary.setFont(theme.font(tokens.STATUS_PX))
        close = ActionButton(theme, tr("Close"), icon="x", key="Esc", role="ghost")
        close.setToolTip(tr(ESC_CLOSES))
        close.setObjectName("preflight_close")
        close.clicked.connect(self.close_overlay)
        head = QHBoxLayout()
        head.addWidget(self._heading)
        head.addStretch(1)
        head.addWidget(close)
        self.list = PreflightList(theme, console)
        column = layouts.vbox(self.card, margins_px=(20, 14, 12, 16), spacing_px=6)
        column.addLayout(head)
        column.addWidget(self._summary)
        column.addWidget(self.list, 1)
        console.state.preflight.changed.connect(self._show)
        theme.restyle_on_change(self._style)
        self._show(console.state.preflight.value)

    def open(self) -> None:
        super().open()
        still_open = (row.box for row in self.list.rows.values() if row.box is not None and not row.box.isChecked())
        (next(still_open, None) or self).setFocus(Qt.FocusReason.TabFocusReason)

    def card_height_px(self) -> int:
        words_px = min(_WIDTH_PX, self.width() - 32) - _SIDES_PX
        return self.list.height_px() + _CHROME_PX + self._summary.heightForWidth(words_px)

    def _show(self, checks: tuple[PreflightCheck, ...]) -> None:
        live = self._console.state.present.live
        if live:
            text = tr("{summary}. Everything is checked again when the connection to the robot is lost.")
        else:
            text = tr("{summary} when this recording started.")
        self._summary.setText(text.format(summary=summary(checks, past=not live)))

    def _style(self) -> None:
        self._theme.color_text(self._summary, "dim")


class PreflightButton(StatusButton):
    """Number of open checks; hidden while recording."""

    def __init__(self, theme: Theme, console: WizardConsole) -> None:
        tip = tr("Checks by the console and by you before a recording. Click for the list.")
        super().__init__(theme, "preflight_button", tip)
        self._console = console
        console.state.preflight.changed.connect(self._show)
        console.state.recording.changed.connect(self._show)
        self._show()

    def _show(self, _changed: object = None) -> None:
        checks, live = self._console.state.preflight.value, self._console.state.present.live
        state, text = worst(checks), summary(checks, past=not live) if checks else ""
        if self._console.state.recording.value.state in IN_SESSION and live:
            text = ""
        spoken = tr("{summary}. Worst state: {state}").format(summary=text, state=tr(STATES[state]))
        self.show_words(text, ICONS[state], ROLES[state], spoken=spoken)
