"""Top bar: scenario, trial, recording, marks, and the emergency stop button, which is always visible,
also over modal dialogs.
"""

from PySide6.QtCore import QObject, QPoint, QRect, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QApplication, QMenu, QSizePolicy, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.events import Marked, RecordingPaused, TrialDetails
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.state import LiveValue
from caris_desktop.live.status import IN_SESSION, DriveStatus, LiveRobotsStatus, MarksStatus, RecordingStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.focus_widget import Bar
from caris_desktop.ui.input.drive_input_filter import STOPS, DriveInputFilter
from caris_desktop.ui.text_formatting import set_wrapped_tip
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.labels import ElidedLabel, label

HEIGHT_PX = 44
ROOMY_PX = 1500
_SIDE_PX, _GAP_PX = 8, 8
_FRAME_PX = 4  # of a window, which a dialog that just opens has not got yet
_LEAST_PX = 640
# Maximum characters per name in a narrow and a wide window; the tooltip has the rest.
_PART_CHARACTERS, _TIP_CHARACTERS = (24, 40), 1000
_SCENARIO_PX, _STRETCH_PX = 160, 110
_TRIAL_PX = (150, 70)
# Levels of shrinking at which each part shrinks or disappears; the text of Find is the first. Whole names of scenario
# and trial are worth more than the words of a button with an icon and a key.
_FIND_SHRINKS, _ERROR_SHRINKS, _NAMES_SHRINK, _TRIAL_SHRINKS, _MARK_SHRINKS = 2, 3, 4, 5, 6
_TRIAL_GOES, _ERROR_GOES, _FIND_GOES, _MARK_GOES, _ALL_GIVE_WAY = 7, 8, 9, 10, 11

_RECORD_TIPS = {
    "recording": QT_TR_NOOP("Pause or stop the recording"),
    "paused": QT_TR_NOOP("The recording is paused. Click to resume or stop."),
}


def trial_words(details: TrialDetails | None, *, at_most: int) -> str:
    """Trial as text: P07 · condition B · trial 2 of 4 · practice; each part limited to ``at_most`` characters."""
    if details is None:
        return ""
    participant, condition, trial, purpose = (
        text_formatting.shortened(part, at_most)
        for part in (details.participant, details.condition, details.trial, details.purpose)
    )
    parts = (
        participant,
        condition and tr("condition {condition}").format(condition=condition),
        trial and tr("trial {trial}").format(trial=trial),
        tr(purpose),
    )
    return " · ".join(part for part in parts if part)


class TrialLabel(ElidedLabel):
    """Trial label, elided if space is short."""

    def __init__(self) -> None:
        super().__init__()
        self.setSizePolicy(QSizePolicy.Policy.Maximum, QSizePolicy.Policy.Preferred)

    def show_details(self, details: TrialDetails | None, *, roomy: bool) -> None:
        text = trial_words(details, at_most=_PART_CHARACTERS[roomy])
        full = trial_words(details, at_most=_TIP_CHARACTERS)
        if (text, full) != (self.text(), self.accessibleName()):
            self.setText(text)
            set_wrapped_tip(self, full)
            self.setAccessibleName(full)

    def sizeHint(self) -> QSize:
        metrics = self.fontMetrics()
        return QSize(metrics.horizontalAdvance(self.text()) + 2, metrics.height())

    def minimumSizeHint(self) -> QSize:
        full = self.sizeHint()
        return QSize(min(full.width(), _TRIAL_PX[1]), full.height())


class TopBar(Bar, QWidget):
    """Top bar. Emits requests for the window; reads the session's state itself."""

    start_requested = Signal()
    scenario_menu_requested = Signal()
    window_menu_requested = Signal()

    def __init__(self, theme: Theme, console: WizardConsole, actions: Actions) -> None:
        super().__init__()
        self.setObjectName("top_bar")
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self.setFixedHeight(HEIGHT_PX)
        self._theme = theme
        self._console = console
        self._actions = actions
        self.scenario_button = ActionButton(
            theme, menu_arrow=True, role="ghost", text_px=tokens.SPEECH_PX - 1, may_shrink=True, semibold=True,
            objectName="scenario_button", clicked=self.scenario_menu_requested,
        )  # fmt: skip
        self._trial = TrialLabel()
        self._trial.setObjectName("trial_label")
        self._trial.setProperty("tone", "dim")
        self._details: TrialDetails | None = None
        self.record_button = ActionButton(
            theme, tr("Start recording"), icon="record", objectName="record_button", clicked=self._on_record_clicked
        )
        self._record_menu = QMenu(self)
        self._record_menu.setObjectName("record_menu")
        self._pause = self._record_menu.addAction(tr("Pause recording"))
        self._pause.triggered.connect(self._on_pause)
        self._record_menu.addAction(tr("Stop recording"), lambda: console.do(intents.StopRecording()))
        self._paused_ns: int | None = None
        self.mark_button = ActionButton(theme, tr("Mark"), icon="bookmark-simple", objectName="mark_button")
        self.mark_button.bind(actions, "mark")
        self.stretch_button = ActionButton(
            theme, icon="brackets-square", objectName="stretch_button", checkable=True, clicked=self._on_end_interval
        )
        self.stretch_button.setChecked(True)  # while the interval is open
        self.stretch_button.hide()
        self._unmark = QTimer(self, singleShot=True, interval=1500)
        self._unmark.timeout.connect(self._on_mark_shown)
        self._in_replay = False
        error = self._error = ActionButton(
            theme, tr("Wizard error"), icon="warning", objectName="wizard_error_button",
            toolTip=tr("Mark a mistake on the wizard's side, for the analysis"),
        )  # fmt: skip
        error.bind(actions, "wizard_error")
        self._find = ActionButton(
            theme, tr("Find anything"), icon="magnifying-glass", objectName="find_button",
            toolTip=tr("Find anything: actions, phrases, places, panels"),
        )  # fmt: skip
        self._find.bind(actions, "find")
        self.window_button = ActionButton(
            theme, tr("Window"), menu_arrow=True, objectName="window_menu_button", clicked=self.window_menu_requested,
            accessibleName=tr("Panels and appearance"), toolTip=tr("Panels and appearance"),
        )  # fmt: skip
        self.emergency = ActionButton(
            theme, tr("Emergency stop"), key="Esc Esc", role="danger", objectName="emergency_stop",
            pressed=self._on_emergency_pressed,
            toolTip=tr("Stops the robot and holds it until you release the stop. The Pause key also works."),
        )  # fmt: skip
        self.emergency.setProperty(STOPS, True)
        self._replay_badge = label(
            tr("REPLAY"), objectName="replay_badge", accessibleName=tr("REPLAY"),
            toolTip=tr("This is a recorded session. Nothing you do here reaches a robot, except a stop."),
        )  # fmt: skip
        self._replay_badge.setFixedHeight(30)
        self._replay_badge.hide()
        marks = self.mark_button, self.stretch_button, error
        layouts.hbox(
            self, self._replay_badge, self.scenario_button, self._trial, self.record_button, *marks, self._find, 1,
            self.window_button, self.emergency, margins_px=(_SIDE_PX, 0, _SIDE_PX, 0), spacing_px=_GAP_PX,
        )  # fmt: skip
        console.state.recording.changed.connect(self._refresh)
        console.state.marks.changed.connect(self._show_interval)
        actions.keys_changed.connect(self._show_interval)
        actions.keys_changed.connect(self._make_room)
        console.state.event_happened.connect(self._on_event)
        self._clock = QTimer(self, interval=500)
        self._clock.timeout.connect(self._refresh)
        self._clock.timeout.connect(self._show_interval)
        self._clock.start()
        self.show_scenario()
        console.state.drive.follow(self._on_drive_changed)

    def show_replay(self, live_robots: LiveValue) -> None:
        """Switch to a replay. The red button is that of the robot driven now, and says so."""
        self._in_replay = True
        self._replay_badge.show()
        self.scenario_button.setEnabled(False)
        for button in (self.record_button, self.mark_button, self.stretch_button, self._error):
            button.hide()
        live_robots.follow(self._on_live_robots_changed)

    def _on_live_robots_changed(self, live: LiveRobotsStatus) -> None:
        self.emergency.setVisible(bool(live.robots))
        several = len(live.robots) > 1
        whose = (
            tr("%n robots", "", len(live.robots)) if several else text_formatting.shortened("".join(live.robots), 24)
        )
        if live.emergency_stop:
            self.emergency.set_label(tr("Emergency stop active (live)"), role="outline_danger")
        else:
            self.emergency.set_label(tr("Stop {robot} (live)").format(robot=whose), role="danger")
        stops = (
            tr("Emergency stop for the robots driven by the live consoles:")
            if several
            else tr("Emergency stop for the robot driven by the live console:")
        )
        too = tr("The Pause key also works. Esc stops the robot too. Release the stop in the live window.")
        self.emergency.setToolTip("\n".join((stops, *live.robots, too)))
        self._make_room()

    def show_layout(self, *, changed: bool, locked: bool) -> None:
        """Show whether the dock layout has unsaved changes or is locked."""
        name = tr("Panels and appearance")
        if locked:
            name = tr("Panels and appearance. The layout is locked.")
        elif changed:
            name = tr("Panels and appearance. The layout has unsaved changes.")
        self.window_button.set_badge("lock" if locked else "dot" if changed else "")
        self.window_button.setAccessibleName(name)
        self.window_button.setToolTip(name)

    def show_scenario(self) -> None:
        title = text_formatting.shortened(self._console.scenario.title, _TIP_CHARACTERS)
        self.scenario_button.set_label(text_formatting.shortened(title, _PART_CHARACTERS[0]))
        self.scenario_button.setMinimumWidth(min(self.scenario_button.sizeHint().width(), _SCENARIO_PX))
        self.scenario_button.setAccessibleName(tr("Scenario: {title}").format(title=title))
        set_wrapped_tip(self.scenario_button, title, tr("Switch the scenario. The robot stays connected."))
        self._refresh()

    def show_details(self, details: TrialDetails | None) -> None:
        self._details = details
        self._refresh()

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._make_room()

    def minimumSizeHint(self) -> QSize:
        # Shrinking parts must not make the window wider than its screen.
        return QSize(_LEAST_PX, HEIGHT_PX)

    def _make_room(self) -> None:
        """Shrink parts until the bar fits. Recording, an open interval and the red button never shrink."""
        level = 0 if self.width() >= ROOMY_PX else 1
        while level < _ALL_GIVE_WAY and self._needed_px(level) > self.width():
            level += 1
        trial = self._trial.text() if level < _TRIAL_GOES else ""
        for button, text, name, visible in self._shrinking(level):
            button.set_label(text, name=name)
            button.setVisible(visible)
        self._trial.setVisible(bool(trial))
        self.scenario_button.setVisible(level < _ALL_GIVE_WAY)

    def _needed_px(self, level: int) -> int:
        """Minimum width of the bar at this level of shrinking."""
        always = (self._replay_badge, self.record_button, self.stretch_button, self.window_button, self.emergency)
        widths = [max(part.sizeHint().width(), part.minimumWidth()) for part in always if not part.isHidden()]
        title_px, trial_px = self.scenario_button.sizeHint().width(), self._trial.sizeHint().width()
        if level < _ALL_GIVE_WAY:
            widths.append(title_px if level < _NAMES_SHRINK else min(title_px, _SCENARIO_PX))
        if self._trial.text() and level < _TRIAL_GOES:
            widths.append(trial_px if level < _NAMES_SHRINK else min(trial_px, _TRIAL_PX[level >= _TRIAL_SHRINKS]))
        widths += [button.width_with(text) for button, text, _name, visible in self._shrinking(level) if visible]
        return sum(widths) + _GAP_PX * len(widths) + 2 * _SIDE_PX

    def _shrinking(self, level: int) -> tuple[tuple[ActionButton, str, str, bool], ...]:
        """Buttons that shrink: text at this level, accessible name, and whether each is visible."""
        find = tr("Find anything") if level == 0 else tr("Find") if level < _FIND_SHRINKS else ""
        mark = "" if level >= _MARK_SHRINKS else tr("Marked") if self._unmark.isActive() else tr("Mark")
        error = tr("Wizard error") if level < _ERROR_SHRINKS else ""
        # Whether there is a session to mark: the buttons for marks come with the recording.
        marks = not self._in_replay and self._console.state.recording.value.state in IN_SESSION
        return (
            (self._find, find, tr("Find anything"), level < _FIND_GOES),
            (self.mark_button, mark, tr("Mark"), marks and level < _MARK_GOES),
            (self._error, error, tr("Wizard error"), marks and level < _ERROR_GOES),
        )

    def popup_below(self, menu: QMenu, button: ActionButton) -> None:
        menu.popup(button.mapToGlobal(QPoint(0, button.height() + 4)))
        if menu is self._record_menu:
            menu.setActiveAction(menu.actions()[0])

    # On press, not on click: a stop must not wait for the release.
    def _on_emergency_pressed(self) -> None:
        self._console.do(intents.EmergencyStop())

    def _on_record_clicked(self) -> None:
        state = self._console.state.recording.value.state
        if state in ("recording", "paused", "starting"):
            self._pause.setText(tr("Resume recording") if state == "paused" else tr("Pause recording"))
            self._pause.setEnabled(state != "starting")
            self.popup_below(self._record_menu, self.record_button)
        else:
            self.start_requested.emit()

    def _on_pause(self) -> None:
        self._console.do(intents.PauseRecording(paused=self._console.state.recording.value.state == "recording"))

    def _on_event(self, event: object) -> None:
        if isinstance(event, Marked) and event.kind == "mark" and event.state != "withdrawn":
            self._unmark.start()
            self.mark_button.set_label(self.mark_button.text(), icon="check")
            self._make_room()
        elif isinstance(event, RecordingPaused):
            self._paused_ns = event.stamp_ns if event.paused else None
            self._refresh()

    def _on_end_interval(self) -> None:
        going_on = self._console.state.marks.value.open
        if going_on:
            self._console.do(intents.EndMark(going_on[-1].mark_id))
        self.stretch_button.setChecked(True)

    def _show_interval(self) -> None:
        """Show the newest open interval as a reminder to close it."""
        status: MarksStatus = self._console.state.marks.value
        if self.stretch_button.isHidden() == bool(status.open):
            self.stretch_button.setVisible(bool(status.open) and not self._in_replay)
            self._make_room()
        if not status.open:
            return
        newest = status.open[-1]
        metrics = self.stretch_button.fontMetrics()
        label = metrics.elidedText(
            text_formatting.shortened(newest.label, 20), Qt.TextElideMode.ElideRight, _STRETCH_PX
        )
        lasts = text_formatting.duration((self._console.state.present.now_ns() - newest.moment_ns) / 1e9)
        others = f" +{len(status.open) - 1}" if len(status.open) > 1 else ""
        label, end = label or tr("Interval"), tr("End")
        before = self.stretch_button.sizeHint().width()
        self.stretch_button.set_label(f"{label}{others} · {lasts} · {end}")
        self.stretch_button.set_key(self._actions.key_text("stretch"), self._actions.key_texts("stretch"))
        self.stretch_button.setToolTip(tr("This interval of the session is being marked. Click to end it."))
        if self.stretch_button.sizeHint().width() > before:
            self._make_room()

    def _on_mark_shown(self) -> None:
        self.mark_button.set_label(self.mark_button.text(), icon="bookmark-simple")
        self._make_room()

    def _refresh(self) -> None:
        status: RecordingStatus = self._console.state.recording.value
        permissions = self._console.scenario.permissions
        match status.state:
            case "recording":
                seconds = (self._console.state.present.now_ns() - status.started_ns) / 1e9
                limits = [] if permissions.video_recording else [tr("no video")]
                limits += [] if permissions.photos else [tr("no photos")]
                roomy = bool(limits) and self.width() >= ROOMY_PX
                suffix = f" · {', '.join(limits)}" if roomy else ""
                going_on = tr("Recording {time}").format(time=text_formatting.elapsed(seconds))
                self.record_button.set_label(f"{going_on}{suffix}", dot="red_fill")
            case "paused":
                # Without the event (a replay that begins in a pause) its start is unknown.
                since_ns = self._paused_ns
                now_ns = self._console.state.present.now_ns()
                lasts = "" if since_ns is None else text_formatting.elapsed((now_ns - since_ns) / 1e9)
                paused = tr("Paused {time}").format(time=lasts) if lasts else tr("Paused")
                self.record_button.set_label(paused, icon="pause", role="amber")
            case "starting":
                self.record_button.set_label(tr("Starting…"), icon="record")
            case "stopping":
                self.record_button.set_label(tr("Saving…"), icon="record")
            case "failed":
                self.record_button.set_label(tr("Recording failed"), icon="warning", role="amber")
            case _:
                self.record_button.set_label(tr("Start recording"), icon="record", role="plain")
        if status.state == "recording":
            self.record_button.set_label(self.record_button.text(), dot="red_fill", role="plain")
        tip = _RECORD_TIPS.get(status.state, "")
        self.record_button.setToolTip(tr(tip))
        self.record_button.setEnabled(status.state not in ("starting", "stopping"))
        details = self._details if status.state in IN_SESSION else None
        self._trial.show_details(details, roomy=self.width() >= ROOMY_PX)
        self._make_room()

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        if self._in_replay:
            return  # that was recorded
        if drive.emergency_stop:
            self.emergency.set_label(tr("Emergency stop active"), role="outline_danger")
        else:
            self.emergency.set_label(tr("Emergency stop"), role="danger")


def as_menu(theme: Theme, parent: QWidget, name: str) -> QMenu:
    menu = QMenu(parent)
    menu.setObjectName(name)
    menu.setFont(theme.font())
    menu.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose, False)
    return menu


class EmergencyOverDialogs(QObject):
    """Shows a copy of the red button in a small window owned by the dialog, over the blocked one.

    A modal dialog blocks every window except its own children. Where the system does not let a program position its
    windows (Wayland), it appears where the compositor puts it.
    """

    pressed = Signal()

    def __init__(self, theme: Theme, button: ActionButton, hold: DriveInputFilter) -> None:
        super().__init__(button)
        self._theme = theme
        self._button = button
        self._copy: QWidget | None = None
        hold.windows_changed.connect(self._follow)

    def _follow(self) -> None:
        dialog = QApplication.activeModalWidget()
        if self._copy is not None and (dialog is None or self._copy.parentWidget() is not dialog):
            layouts.discard(self._copy)
            self._copy = None
        if dialog is not None and self._copy is None and self._button.isVisible():
            self._copy = self._copy_for(dialog)

    def _copy_for(self, dialog: QWidget) -> QWidget:
        flags = Qt.WindowType.Tool | Qt.WindowType.FramelessWindowHint | Qt.WindowType.WindowDoesNotAcceptFocus
        window = QWidget(dialog, flags)
        window.setObjectName("emergency_over_dialog")
        window.setAttribute(Qt.WidgetAttribute.WA_ShowWithoutActivating)
        window.setAttribute(Qt.WidgetAttribute.WA_TranslucentBackground)
        window.destroyed.connect(self._on_copy_destroyed)
        button = ActionButton(
            self._theme, self._button.text(), key=self._button.key, role="danger", height_px=self._button.height()
        )
        button.setObjectName("emergency_stop_copy")
        button.setMinimumWidth(1)  # its margin may give way
        button.setToolTip(self._button.toolTip())
        button.pressed.connect(self.pressed)
        layout = layouts.vbox(window, margins_px=0)
        layout.addWidget(button)
        place = QRect(self._button.mapToGlobal(QPoint()), self._button.size())
        beside = dialog.frameGeometry().adjusted(0, 0, _FRAME_PX, 0)
        if place.intersects(beside):  # it may lose its margin, so that it does not lie on the dialog's edge
            place.setLeft(min(beside.right() + 1, place.left() + _SIDE_PX))
        window.setGeometry(place)
        window.show()
        return window

    def _on_copy_destroyed(self) -> None:
        # Destroyed together with its dialog.
        self._copy = None
