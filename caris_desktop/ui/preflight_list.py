"""List of preflight checks: title, state, advice, and a check box for manual checks; its popup and button."""

from collections.abc import Mapping
from functools import partial

from PySide6.QtCore import Qt
from PySide6.QtGui import QAccessible, QShowEvent
from PySide6.QtWidgets import QFrame, QLabel, QScrollArea, QVBoxLayout, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import IN_SESSION, PreflightCheck
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.event_messages import (
    CHECK_ICONS,
    CHECK_ROLES,
    CHECK_STATES,
    check_state,
    checks_summary,
    worst_check,
)
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton, StatusButton
from caris_desktop.ui.widgets.inputs import TEXT_LEFT_PX, CheckBox
from caris_desktop.ui.widgets.labels import IconLabel, label, named, restyle
from caris_desktop.ui.widgets.rows import show_rows

_ICON_PX = 20


class PreflightList(QScrollArea):
    """Follows ``console.state.preflight`` while visible; accessors bring it up to date."""

    accessible_role = QAccessible.Role.List

    def __init__(self, theme: Theme, console: WizardConsole) -> None:
        super().__init__()
        named(self, "preflight_list", tr("Preflight checks"))
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setWidgetResizable(True)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._theme = theme
        self._console = console
        self._inner = QWidget()
        column = layouts.vbox(self._inner, margins_px=(0, 0, tokens.GRID_PX, 0), spacing_px=0)
        self._sections: list[tuple[bool, QLabel, QVBoxLayout, dict[str, PreflightRow]]] = []
        for manual, text in ((True, tr("Check yourself")), (False, tr("Checked by the console"))):
            heading, rows = label(text, "caption"), layouts.vbox(spacing_px=0)
            heading.setContentsMargins(0, 8, 0, 2)
            layouts.fill(column, heading, rows)
            self._sections.append((manual, heading, rows, {}))
        column.addStretch(1)
        self.setWidget(self._inner)
        console.state.preflight.changed.connect(self._on_changed)

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        self._update_rows()

    def _on_changed(self, _checks: object) -> None:
        if self.isVisible():
            self._update_rows()

    @property
    def rows(self) -> dict[str, "PreflightRow"]:
        """Rows by check id, in order."""
        self._update_rows()
        return {check_id: row for *_section, rows in self._sections for check_id, row in rows.items()}

    def height_px(self, width_px: int) -> int:
        """Height with all rows at this width."""
        self._update_rows()
        inner = self._inner
        return inner.heightForWidth(width_px) if inner.hasHeightForWidth() else inner.sizeHint().height()

    def _update_rows(self) -> None:
        """Show the checks, manual ones first; their headings only if there are any of those."""
        checks: tuple[PreflightCheck, ...] = self._console.state.preflight.value
        for manual, heading, column, rows in self._sections:
            of_section = {check.id: check for check in checks if check.manual is manual}
            heading.setVisible(bool(of_section) and any(check.manual for check in checks))
            show_rows(column, rows, tuple(of_section), partial(self._new_row, of_section))
            for check_id, row in rows.items():
                row.show_check(of_section[check_id])

    def _new_row(self, checks: Mapping[str, PreflightCheck], check_id: str) -> "PreflightRow":
        return PreflightRow(self._theme, self._console, checks[check_id], self._inner)


class PreflightRow(QWidget):
    """One check."""

    accessible_role = QAccessible.Role.ListItem

    def __init__(self, theme: Theme, console: WizardConsole, check: PreflightCheck, parent: QWidget) -> None:
        super().__init__(parent)
        self.setObjectName(f"preflight_{check.id}")
        self._console = console
        self._check = check
        self.box: CheckBox | None = None
        title = label(tr(check.title), wraps=True)
        self._mark = IconLabel(theme, size_px=_ICON_PX)
        self._detail, self._advice = label("", "note", wraps=True), label("", "small", wraps=True)
        self._state = label("", "small")
        words = layouts.vbox(None, title, self._detail, self._advice, spacing_px=2)
        if check.manual:
            self.box = CheckBox(
                theme, tr(check.title), wraps=True, objectName=f"tick_{check.id}", clicked=self._on_ticked
            )
            title.hide()
            words.insertWidget(0, self.box)
            for text in (self._detail, self._advice):
                text.setContentsMargins(TEXT_LEFT_PX, 0, 0, 0)
        row = layouts.hbox(self, margins_px=(0, 5, 0, 5), spacing_px=10)
        row.addWidget(self._mark, 0, Qt.AlignmentFlag.AlignTop)
        self._mark.setVisible(not check.manual)  # its box says so
        row.addLayout(words, 1)
        self.try_button: ActionButton | None = None
        if check.id == "microphone" and console.scenario.permissions.audio_recording:
            self.try_button = ActionButton(
                theme, tr("Test"), icon="microphone", height_px=30, objectName="preflight_try_microphone",
                accessibleName=tr("Test the microphone"), clicked=lambda: console.do(intents.TryMicrophone()),
            )  # fmt: skip
            row.addWidget(self.try_button, 0, Qt.AlignmentFlag.AlignTop)
        row.addWidget(self._state, 0, Qt.AlignmentFlag.AlignTop)

    def show_check(self, check: PreflightCheck, *, in_full: bool = False) -> None:
        """Update the row; ``in_full``: with the state even if passed."""
        self._check = check
        detail = check_state(check, self._console.state.present.anchor)
        advice = "" if check.state in ("passed", "pending") and check.id != "microphone" else tr(check.advice)
        self._detail.setText(detail)
        # A passed check takes one line.
        self._detail.setVisible(bool(detail) and (check.state != "passed" or check.manual or in_full))
        self.setToolTip(detail if self._detail.isHidden() else "")
        self._advice.setText(advice)
        self._advice.setVisible(bool(advice))
        self._state.setText(tr(CHECK_STATES[check.state]))
        restyle(self._state, tone=CHECK_ROLES[check.state])
        self._mark.show_icon(CHECK_ICONS[check.state], CHECK_ROLES[check.state])
        if self.box is not None:
            self.box.setChecked(check.state == "passed")
            self.box.setEnabled(self._console.state.present.live)
        if self.try_button is not None:
            opened = self._console.state.microphone.value.state in ("starting", "on")
            self.try_button.setVisible(check.state != "passed" and not opened and self._console.state.present.live)
        self.setAccessibleName(f"{tr(check.title)}: {self._state.text()}")
        self.setAccessibleDescription(" ".join(part for part in (detail, advice) if part))

    def _on_ticked(self, checked: bool) -> None:
        self._console.do(intents.TickCheck(self._check.id, checked))
        if self.box is not None:
            self.box.setChecked(self._check.state == "passed")  # undo a refused tick


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
        console.state.preflight.follow(self._show)

    def open(self) -> None:
        super().open()
        still_open = (row.box for row in self.list.rows.values() if row.box is not None and not row.box.isChecked())
        (next(still_open, None) or self).setFocus(Qt.FocusReason.TabFocusReason)

    def card_height_px(self) -> int:
        words_px = min(_WIDTH_PX, self.width() - 32) - _SIDES_PX
        return self.list.height_px(words_px) + _CHROME_PX + self._summary.heightForWidth(words_px)

    def _show(self, checks: tuple[PreflightCheck, ...]) -> None:
        live = self._console.state.present.live
        if live:
            text = tr("{summary}. Everything is checked again when the connection to the robot is lost.")
        else:
            text = tr("{summary} when this recording started.")
        self._summary.setText(text.format(summary=checks_summary(checks, past=not live)))


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
        state, text = worst_check(checks), checks_summary(checks, past=not live) if checks else ""
        if self._console.state.recording.value.state in IN_SESSION and live:
            text = ""
        spoken = tr("{summary}. Worst state: {state}").format(summary=text, state=tr(CHECK_STATES[state]))
        self.show_words(text, CHECK_ICONS[state], CHECK_ROLES[state], spoken=spoken)
