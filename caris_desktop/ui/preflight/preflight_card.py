"""Preflight popup, and the status bar button that opens it."""

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.live.status import IN_SESSION, PreflightCheck
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.preflight.preflight_list import PreflightList
from caris_desktop.ui.preflight.preflight_words import ICONS, ROLES, STATES, summary, worst
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import StatusButton
from caris_desktop.ui.widgets.labels import label

_WIDTH_PX, _CHROME_PX, _SIDES_PX = 680, 96, 32


class PreflightCard(Overlay):
    """List of checks with the number of open ones. The robot can be driven and stopped meanwhile."""

    def __init__(self, theme: Theme, window: QWidget, console: WizardConsole) -> None:
        super().__init__(theme, window, width_px=_WIDTH_PX)
        self.setObjectName("preflight_card")
        self._console = console
        self._summary = label("", "note", wraps=True, objectName="preflight_summary")
        heading = label(tr("Before a recording"), "heading")
        head = layouts.hbox(None, heading, 1, self.close_button("preflight_close"))
        self.list = PreflightList(theme, console)
        layouts.vbox(self.card, head, self._summary, (self.list, 1), margins_px=(20, 14, 12, 16), spacing_px=6)
        console.state.preflight.changed.connect(self._show)
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
