"""List of preflight checks: title, state, advice, and a check box for manual checks."""

from PySide6.QtCore import QRectF, QSize, Qt
from PySide6.QtGui import QAccessible, QPainter, QPaintEvent, QShowEvent
from PySide6.QtWidgets import QFrame, QLabel, QScrollArea, QSizePolicy, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import PreflightCheck
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.preflight.preflight_words import ICONS, ROLES, STATES, state_words
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.check_box import CheckBox

_ICON_PX = 20


class PreflightList(QScrollArea):
    """Follows ``console.state.preflight`` while visible; accessors bring it up to date."""

    accessible_role = QAccessible.Role.List

    def __init__(self, theme: Theme, console: WizardConsole) -> None:
        super().__init__()
        self.setObjectName("preflight_list")
        self.setAccessibleName(tr("Preflight checks"))
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setWidgetResizable(True)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._theme = theme
        self._console = console
        self._inner = QWidget()
        self._column = layouts.vbox(self._inner, margins_px=(0, 0, tokens.GRID_PX, 0), spacing_px=0)
        self._by_hand = self._heading(tr("For you to check"))
        self._by_itself = self._heading(tr("Checked by the console"))
        self._column.addStretch(1)
        self.setWidget(self._inner)
        self._rows: dict[str, PreflightRow] = {}
        self._outdated = True
        console.state.preflight.changed.connect(self._on_changed)

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        self._update_rows()

    def _on_changed(self, _checks: object) -> None:
        self._outdated = True
        if self.isVisible():
            self._update_rows()

    def _update_rows(self) -> None:
        if self._outdated:
            self._outdated = False
            self._show(self._console.state.preflight.value)

    def _heading(self, text: str) -> QLabel:
        heading = QLabel(text)
        heading.setFont(self._theme.font(tokens.STATUS_PX, tokens.WEIGHT_SEMIBOLD))
        heading.setContentsMargins(0, 8, 0, 2)
        self._column.addWidget(heading)
        return heading

    @property
    def rows(self) -> dict[str, "PreflightRow"]:
        """Rows by check id, in order."""
        self._update_rows()
        return self._rows

    def height_px(self) -> int:
        """Height with all rows."""
        self._update_rows()
        inner = self._inner
        return inner.heightForWidth(self.width()) if inner.hasHeightForWidth() else inner.sizeHint().height()

    def _show(self, checks: tuple[PreflightCheck, ...]) -> None:
        if {check.id for check in checks} != set(self._rows):
            self._build(checks)
        for check in checks:
            self._rows[check.id].show_check(check)

    def _build(self, checks: tuple[PreflightCheck, ...]) -> None:
        """Create the rows, manual checks first."""
        for row in self._rows.values():
            self._column.removeWidget(row)
            row.hide()
            row.deleteLater()
        self._rows = {}
        for heading, manual in ((self._by_hand, True), (self._by_itself, False)):
            section_checks = [check for check in checks if check.manual is manual]
            heading.setVisible(bool(section_checks) and any(check.manual for check in checks))
            for place, check in enumerate(section_checks, start=self._column.indexOf(heading) + 1):
                row = self._rows[check.id] = PreflightRow(self._theme, self._console, check, self._inner)
                self._column.insertWidget(place, row)
                row.show()


class PreflightRow(QWidget):
    """One check."""

    accessible_role = QAccessible.Role.ListItem

    def __init__(self, theme: Theme, console: WizardConsole, check: PreflightCheck, parent: QWidget) -> None:
        super().__init__(parent)
        self.setObjectName(f"preflight_{check.id}")
        self._theme = theme
        self._console = console
        self._check = check
        row = layouts.hbox(self, margins_px=(0, 5, 0, 5), spacing_px=10)
        self.box: CheckBox | None = None
        self._title = self._label(tr(check.title), tokens.BODY_PX)
        self._mark = _StateMark(theme)
        row.addWidget(self._mark, 0, Qt.AlignmentFlag.AlignTop)
        words = layouts.vbox(spacing_px=2)
        if check.manual:
            self.box = CheckBox(theme, tr(check.title), wraps=True)
            self.box.setObjectName(f"tick_{check.id}")
            self.box.clicked.connect(self._on_ticked)
            self._title.hide()
            words.addWidget(self.box)
        words.addWidget(self._title)
        self._detail, self._advice = self._label(), self._label()
        words.addWidget(self._detail)
        words.addWidget(self._advice)
        row.addLayout(words, 1)
        self.try_button: ActionButton | None = None
        if check.id == "microphone" and console.scenario.permissions.audio_recording:
            self.try_button = ActionButton(theme, tr("Test"), icon="microphone", height_px=30)
            self.try_button.setObjectName("preflight_try_microphone")
            self.try_button.setAccessibleName(tr("Test the microphone"))
            self.try_button.clicked.connect(self._on_try)
            row.addWidget(self.try_button, 0, Qt.AlignmentFlag.AlignTop)
        self._state = self._label()
        self._state.setWordWrap(False)
        row.addWidget(self._state, 0, Qt.AlignmentFlag.AlignTop)
        theme.changed.connect(self._style)

    def _label(self, text: str = "", size_px: int = tokens.STATUS_PX) -> QLabel:
        label = QLabel(text, wordWrap=True)
        label.setFont(self._theme.font(size_px))
        return label

    def show_check(self, check: PreflightCheck, *, in_full: bool = False) -> None:
        """Update the row; ``in_full``: with the state even if passed."""
        self._check = check
        detail = state_words(check, self._console.state.present.anchor)
        advice = "" if check.state in ("passed", "pending") and check.id != "microphone" else tr(check.advice)
        self._detail.setText(detail)
        # A passed check takes one line.
        self._detail.setVisible(bool(detail) and (check.state != "passed" or check.manual or in_full))
        self.setToolTip(detail if self._detail.isHidden() else "")
        self._advice.setText(advice)
        self._advice.setVisible(bool(advice))
        self._state.setText(tr(STATES[check.state]))
        self._mark.show_state(ICONS[check.state], ROLES[check.state])
        if self.box is not None:
            self.box.setChecked(check.state == "passed")
            self.box.setEnabled(self._console.state.present.live)
        if self.try_button is not None:
            opened = self._console.state.microphone.value.state in ("starting", "on")
            self.try_button.setVisible(check.state != "passed" and not opened and self._console.state.present.live)
        self.setAccessibleName(f"{tr(check.title)}: {self._state.text()}")
        self.setAccessibleDescription(" ".join(part for part in (detail, advice) if part))
        self._style()

    def _on_ticked(self, checked: bool) -> None:
        self._console.do(intents.TickCheck(self._check.id, checked))
        if self.box is not None:
            self.box.setChecked(self._check.state == "passed")  # undo a refused tick

    def _on_try(self) -> None:
        self._console.do(intents.TryMicrophone())

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        self._style()  # within a dialog the style sheet resets colours

    def _style(self) -> None:
        state = self._check.state
        self._theme.color_text(self._title, "text")
        self._theme.color_text(self._detail, "dim")
        self._theme.color_text(self._advice, "text")
        self._theme.color_text(self._state, ROLES[state])


class _StateMark(QWidget):
    """Icon of a state, next to its text."""

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._theme = theme
        self._icon, self._role = "", "dim"
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)
        theme.changed.connect(self.update)

    def show_state(self, icon: str, role: str) -> None:
        if (icon, role) != (self._icon, self._role):
            self._icon, self._role = icon, role
            self.update()

    def sizeHint(self) -> QSize:
        return QSize(_ICON_PX, _ICON_PX + 2)

    def paintEvent(self, _event: QPaintEvent) -> None:
        draw_icon(QPainter(self), QRectF(0, 1, _ICON_PX, _ICON_PX), self._icon, self._theme.color(self._role))
