"""Alarm list over the window, and the status bar button that opens it."""

from PySide6.QtCore import QRectF, Qt, QTimer, Signal
from PySide6.QtGui import QAccessible, QPainter, QPaintEvent
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QScrollArea, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import Alarm
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.accessible_roles import has_role
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_rows import ALARMS_GROUP
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.problems import LOOKS
from caris_desktop.ui.text_formatting import ESC_CLOSES
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.status_button import StatusButton

_WIDTH_PX = 680
_CHROME_PX = 88
_FOLDED_SHOWN = 5


class AlarmsButton(StatusButton):
    """Number of alarms; visible only while there are any."""

    def __init__(self, theme: Theme, console: WizardConsole) -> None:
        super().__init__(theme, "alarms_button", tr("Active alarms and what to do about them. Click for the list."))
        console.state.alarms.changed.connect(self._show)
        self._show(console.state.alarms.value)

    def _show(self, alarms: tuple[Alarm, ...]) -> None:
        count = len(alarms)
        icon, role, _word = LOOKS[alarms[0].severity if alarms else "info"]
        text = "" if not count else tr("1 alarm") if count == 1 else tr("%n alarms", "", count)
        gravest = alarms[0].what if alarms else ""
        self.show_words(text, icon, role, spoken=tr("{alarms}: {what}").format(alarms=text, what=gravest))


class AlarmList(Overlay):
    """List of alarms with meaning, advice and consequences. Ended alarms disappear."""

    log_requested = Signal()

    def __init__(self, theme: Theme, window: QWidget, console: WizardConsole, actions: Actions) -> None:
        super().__init__(theme, window, width_px=_WIDTH_PX)
        self.setObjectName("alarm_list")
        self._console = console
        actions.answer_for(ALARMS_GROUP, self)
        self._rows: dict[str, AlarmRow] = {}
        self._heading = QLabel(tr("Active alarms"))
        self._nothing = QLabel(tr("No active alarms. Past alarms are in the Session log."), wordWrap=True)
        self._nothing.setObjectName("no_alarm")
        log = ActionButton(theme, tr("History"), icon="list-bullets", role="ghost")
        log.setObjectName("alarms_log")
        log.setToolTip(tr("Open the Session log"))
        log.clicked.connect(self.log_requested)
        close = ActionButton(theme, tr("Close"), icon="x", key="Esc", role="ghost")
        close.setToolTip(tr(ESC_CLOSES))
        close.setObjectName("alarms_close")
        close.clicked.connect(self.close_overlay)
        head = QHBoxLayout()
        head.addWidget(self._heading)
        head.addStretch(1)
        head.addWidget(log)
        head.addWidget(close)
        self._inner = QWidget()
        self._column = layouts.vbox(self._inner, margins_px=(0, 0, 8, 0), spacing_px=tokens.GRID_PX)
        self._column.addWidget(self._nothing)
        self._column.addStretch(1)
        area = QScrollArea(widgetResizable=True)
        has_role(area, QAccessible.Role.List)
        area.setAccessibleName(tr("Active alarms"))
        area.setFrameShape(QFrame.Shape.NoFrame)
        area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        area.setWidget(self._inner)
        area.viewport().setAutoFillBackground(False)
        self._inner.setAutoFillBackground(False)
        column = layouts.vbox(self.card, margins_px=(20, 14, 12, 16), spacing_px=10)
        column.addLayout(head)
        column.addWidget(area, 1)
        self._ages = QTimer(self, interval=1000)
        self._ages.timeout.connect(self._show_ages)
        console.state.alarms.changed.connect(self._on_alarms_changed)
        theme.restyle_on_change(self._style)

    def show_alarms(self) -> None:
        """Open the list."""
        self._show_rows(self._console.state.alarms.value)
        self._ages.start()
        super().open()
        self.setFocus(Qt.FocusReason.OtherFocusReason)

    def close_overlay(self) -> None:
        self._ages.stop()
        super().close_overlay()

    def card_height_px(self) -> int:
        width = min(_WIDTH_PX, self.width() - 32) - 40
        inner = self._inner
        return _CHROME_PX + (inner.heightForWidth(width) if inner.hasHeightForWidth() else inner.sizeHint().height())

    @property
    def rows(self) -> tuple["AlarmRow", ...]:
        return tuple(self._rows.values())

    def _on_alarms_changed(self, alarms: tuple[Alarm, ...]) -> None:
        if self.isVisible():
            self._show_rows(alarms)
            self._place()

    def _show_rows(self, alarms: tuple[Alarm, ...]) -> None:
        standing = {alarm.alarm_id for alarm in alarms}
        for alarm_id in [each for each in self._rows if each not in standing]:
            row = self._rows.pop(alarm_id)
            self._column.removeWidget(row)
            row.hide()
            row.deleteLater()
        for place, alarm in enumerate(alarms):
            known = self._rows.get(alarm.alarm_id)
            if known is None:
                known = self._rows[alarm.alarm_id] = AlarmRow(self._theme, self._console, self._inner)
            self._column.insertWidget(place, known)
            known.show_alarm(alarm)
            known.show()
        self._nothing.setVisible(not alarms)
        self._show_ages()
        self._column.activate()

    def _show_ages(self) -> None:
        for row in self._rows.values():
            row.show_age(self._console.state.present.now_ns())

    def _style(self) -> None:
        self._heading.setFont(self._theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        self._theme.style_text(self._nothing, "dim", tokens.BODY_PX)


class AlarmRow(QWidget):
    """One alarm."""

    accessible_role = QAccessible.Role.ListItem

    def __init__(self, theme: Theme, console: WizardConsole, parent: QWidget) -> None:
        super().__init__(parent)
        self._theme = theme
        self._console = console
        self._alarm: Alarm | None = None
        self._what, self._meaning, self._advice, self._why, self._folded, self._age = (QLabel() for _ in range(6))
        self._labels = (self._what, self._meaning, self._advice, self._why, self._folded, self._age)
        column = layouts.vbox(spacing_px=3)
        for label in self._labels:
            label.setWordWrap(True)
            label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            column.addWidget(label)
        self._dismiss_button = ActionButton(theme, tr("Dismiss"), icon="check", height_px=30)
        self._dismiss_button.setObjectName("alarm_seen_to")
        self._dismiss_button.setToolTip(tr("This alarm does not clear automatically"))
        self._dismiss_button.clicked.connect(self._on_seen_to)
        row = layouts.hbox(self, margins_px=(34, 4, 0, 8))
        row.addLayout(column, 1)
        row.addWidget(self._dismiss_button, 0, Qt.AlignmentFlag.AlignTop)
        theme.restyle_on_change(self._style)

    def _on_seen_to(self) -> None:
        if self._alarm is not None:
            self._console.do(intents.DismissAlarm(self._alarm.alarm_id))

    def show_alarm(self, alarm: Alarm) -> None:
        self._alarm = alarm
        what = alarm.what
        if alarm.times > 1:
            what = tr("{problem} ({number} times)").format(problem=what, number=alarm.times)
        folded = ""
        if alarm.folded:
            folded = tr("Caused by this: {what}").format(what=" ".join(alarm.folded[-_FOLDED_SHOWN:]))
        texts = (what, alarm.meaning, alarm.advice, alarm.why, folded)
        for label, text in zip(self._labels[:5], texts, strict=True):
            label.setText(text)
            label.setVisible(bool(text))
        self._dismiss_button.setVisible(not alarm.ends_by_itself)
        self._dismiss_button.setAccessibleName(tr("Dismiss: {problem}").format(problem=what))
        word = tr(LOOKS[alarm.severity][2])
        self.setAccessibleName(tr("{severity}: {what}").format(severity=word, what=what))
        self.setAccessibleDescription(" ".join(text for text in texts[1:] if text))
        self.update()

    def show_age(self, now_ns: int) -> None:
        alarm = self._alarm
        if alarm is not None:
            since = tr("For {time}").format(time=text_formatting.age(max(0.0, (now_ns - alarm.began_ns) / 1e9)))
            ends = tr("clears automatically") if alarm.ends_by_itself else tr("until you dismiss it")
            self._age.setText(f"{since} · {ends}")

    def _style(self) -> None:
        roles = ("text", "dim", "text", "dim", "dim", "dim")
        small = self._theme.font(tokens.STATUS_PX + 1)
        large = self._theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD)
        for label, role in zip(self._labels, roles, strict=True):
            label.setFont(large if label is self._what else small)
            self._theme.color_text(label, role)
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        if self._alarm is not None:
            icon, role, _word = LOOKS[self._alarm.severity]
            painter = QPainter(self)
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            draw_icon(painter, QRectF(2, 4, 22, 22), icon, self._theme.color(role))
