"""Observer window: video, conversation and, unless a participant may see the screen, map and log. Read-only, with
status indicators readable from two metres.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from itertools import zip_longest
from typing import Any, Literal, cast

from PySide6.QtCore import QByteArray, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QAccessible, QCloseEvent, QFontMetricsF, QGuiApplication, QResizeEvent
from PySide6.QtWidgets import QFrame, QLabel, QSizePolicy, QSplitter, QVBoxLayout, QWidget

from caris_desktop.domain.intents import Intent
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.state import LiveState
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.scenario_model import PanelName, Scenario
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.dock_area import PanelTitleBar
from caris_desktop.ui.focus_widget import VisualTabOrderMixin
from caris_desktop.ui.input.drive_input_filter import DriveInputFilter
from caris_desktop.ui.panel import PAUSE_MS, Panel, PanelContext
from caris_desktop.ui.panel_table import PANELS, possible_panels
from caris_desktop.ui.robot_motion import MOTION_SIGNS, RobotMotion, Sign
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.labels import IconLabel, named, restyle
from caris_desktop.ui.window_place import Settings

SignName = Literal["moving", "speaking", "recording", "listening"]
_SIDE_PX, _GAP_PX, _BETWEEN_PX = 12, 8, 8

_SIGNS: Mapping[tuple[SignName, str], Sign] = {
    **{("moving", kind): sign for kind, sign in MOTION_SIGNS.items()},
    ("speaking", "yes"): Sign("on", "speaker-high", QT_TR_NOOP("Speaking")),
    ("speaking", "no"): Sign("off", "speaker-slash", QT_TR_NOOP("Silent")),
    ("recording", "yes"): Sign("on", "record", QT_TR_NOOP("Recording")),
    ("recording", "paused"): Sign("half", "pause-circle", QT_TR_NOOP("Paused")),
    ("recording", "no"): Sign("off", "circle-dashed", QT_TR_NOOP("Not recorded")),
    ("listening", "yes"): Sign("on", "ear", QT_TR_NOOP("Listening")),
    ("listening", "no"): Sign("off", "ear-slash", QT_TR_NOOP("Not listening")),
}
_COLORS: Mapping[SignName, str] = {"moving": "blue", "speaking": "blue", "recording": "green", "listening": "green"}


def signs_of(state: LiveState, moving: Sign) -> dict[SignName, Sign]:
    """The four indicators."""
    speaks = state.speech.value.now is not None or state.sound.value.talking == "robot"
    recorded = {"recording": "yes", "paused": "paused"}.get(state.recording.value.state, "no")
    return {
        "moving": moving,
        "speaking": _SIGNS["speaking", "yes" if speaks else "no"],
        "recording": _SIGNS["recording", recorded],
        "listening": _SIGNS["listening", "yes" if state.microphone.value.state == "on" else "no"],
    }


_INKS: Mapping[str, str] = {"on": "panel", "half": "text", "off": "dim"}


class StatusIndicators(QWidget):
    """Status indicators with icon and word at fixed positions; repainted only on a change."""

    accessible_role = QAccessible.Role.StaticText

    def __init__(self, theme: Theme, state: LiveState) -> None:
        super().__init__()
        self.setObjectName("glance")
        self._theme = theme
        self._state = state
        self._compact = False
        self._named = True
        self._motion = RobotMotion(state, self)
        self.signs: dict[SignName, Sign] = {}
        self._widths: list[int] = []
        self._boxes = [named(QFrame(), "sign") for _name in _COLORS]
        self._icons = [IconLabel(theme, size_px=tokens.GLANCE_ICON_PX) for _box in self._boxes]
        self._words = [named(QLabel(), "sign_word") for _box in self._boxes]
        for box, icon, word in zip(self._boxes, self._icons, self._words, strict=True):
            # The edge is 3 px wide.
            layouts.hbox(box, icon, (word, 1), margins_px=(_SIDE_PX - 3, 0, _SIDE_PX - 3, 0), spacing_px=_GAP_PX)
        layouts.hbox(self, *self._boxes, margins_px=0, spacing_px=_BETWEEN_PX)
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Expanding)
        self._motion.changed.connect(self._on_changed)
        for value in (state.speech, state.sound, state.recording, state.microphone):
            value.changed.connect(self._on_changed)
        theme.restyle_on_change(self._measure)
        self._on_changed()

    def use_room(self, room_px: int, *, compact: bool) -> None:
        """Shrink the words, or hide them where there is still no room: tooltip and accessible name have them. Icon size
        stays.
        """
        named = not compact or sum(self._widths_with(tokens.BODY_PX)) + _BETWEEN_PX * (len(_COLORS) - 1) <= room_px
        if (compact, named) != (self._compact, self._named):
            self._compact, self._named = compact, named
            self._measure()

    def sizeHint(self) -> QSize:
        return QSize(sum(self._widths) + _BETWEEN_PX * (len(self._widths) - 1), 34)

    def minimumSizeHint(self) -> QSize:
        return self.sizeHint()

    def _on_changed(self, _value: object = None) -> None:
        signs = signs_of(self._state, self._motion.sign)
        if signs != self.signs:
            self.signs = signs
            self.setAccessibleName(tr("Robot status: {signs}").format(signs=", ".join(map(_word, signs.values()))))
            self.setToolTip(self.accessibleName())
            parts = zip(signs.items(), self._boxes, self._icons, self._words, strict=True)
            for (name, sign), box, icon, word in parts:
                restyle(box, tone=_COLORS[name] if sign.lit == "on" else sign.lit)
                icon.show_icon(sign.icon, _INKS[sign.lit])
                word.setText(_word(sign))
                restyle(word, tone=_INKS[sign.lit])

    def _font_px(self) -> int:
        return tokens.BODY_PX if self._compact else tokens.GLANCE_PX

    def _measure(self) -> None:
        around_px = 2 * _SIDE_PX + tokens.GLANCE_ICON_PX
        self._widths = self._widths_with(self._font_px()) if self._named else [around_px] * len(_COLORS)
        self.setFixedWidth(self.sizeHint().width())
        for box, word, width in zip(self._boxes, self._words, self._widths, strict=True):
            box.setFixedWidth(width)
            word.setFont(self._theme.font(self._font_px(), tokens.WEIGHT_SEMIBOLD))
            word.setVisible(self._named)

    def _widths_with(self, font_px: int) -> list[int]:
        """Widths for the longest word of each indicator, so that nothing shifts on a change."""
        metrics = QFontMetricsF(self._theme.font(font_px, tokens.WEIGHT_SEMIBOLD))
        around_px = 2 * _SIDE_PX + tokens.GLANCE_ICON_PX + _GAP_PX
        return [
            math.ceil(max(metrics.horizontalAdvance(_word(sign)) for (each, _), sign in _SIGNS.items() if each == name))
            + around_px
            for name in _COLORS
        ]


def _word(sign: Sign) -> str:
    return tr(sign.word)


Sees = Literal["everything", "no_names"]
"""``no_names``: without names, suggestions, tags, notes and log, for a screen that a participant can see."""

SEES_WORDS: dict[Sees, str] = {
    "everything": QT_TR_NOOP("Observer window: everything"),
    "no_names": QT_TR_NOOP("Observer window: no names, suggestions or notes"),
}
_COLUMNS: dict[Sees, tuple[tuple[PanelName, ...], tuple[PanelName, ...]]] = {
    "everything": (("video", "map"), ("conversation", "session")),
    "no_names": (("video",), ("conversation",)),
}
_SEES_KEY, _GEOMETRY_KEY = "observer/sees", "observer/geometry"
_SIZE_PX = (1100, 700)
_LEAST_PX, _BOTH_FROM_PX = (480, 280), 480


class ObserverWindow(VisualTabOrderMixin, QWidget):
    """Window without input: it ignores clicks and does not take the focus from driving."""

    accessible_role = QAccessible.Role.Window

    closed = Signal()

    def __init__(
        self, theme: Theme, console: WizardConsole, hold: DriveInputFilter, beside: QWidget, sees: Sees
    ) -> None:
        super().__init__(None, Qt.WindowType.Window | Qt.WindowType.WindowDoesNotAcceptFocus)
        self.setObjectName("observer_window")
        self.setWindowTitle(tr("Observer · CARIS Desktop"))
        self.setAttribute(Qt.WidgetAttribute.WA_ShowWithoutActivating)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.sees: Sees = sees
        view_console = watched(console, discreet=sees == "no_names")
        actions = Actions(self, view_console, self)
        actions.drop_all_but(())
        self._context = PanelContext(view_console, theme, actions, hold, discreet=sees == "no_names", observed=True)
        self._column = layouts.vbox(self, margins_px=8)
        # An observer cannot scroll: content that does not fit is clipped.
        self._column.setSizeConstraint(QVBoxLayout.SizeConstraint.SetNoConstraint)
        self.setMinimumSize(*_LEAST_PX)
        self._signs = StatusIndicators(theme, console.state)
        self._whole_signs_px = self._signs.width()
        self._column.addWidget(self._signs)
        self._splitter: QSplitter | None = None
        self._lower: list[QWidget] = []
        self._panels: dict[PanelName, Panel] = {}
        self._lasting: dict[PanelName, Any] = {}
        self._missing: deque[tuple[QSplitter, PanelName]] = deque()
        self._turn = QTimer(self, singleShot=True, interval=PAUSE_MS)
        self._turn.timeout.connect(self._make_next)
        self.resize(*_SIZE_PX)
        self._place(beside)
        self.show_scenario()

    def show_scenario(self) -> None:
        """Rebuild for a scenario: forbidden content disappears at once; panels follow, one per event loop turn."""
        scenario = self._context.console.scenario
        self._context.actions.rebuild(scenario)
        if self._splitter is not None:
            self._lasting.update((name, panel.save_state()) for name, panel in self._panels.items())
            self._panels.clear()
            self._splitter.hide()
            self._splitter.setParent(None)
            self._splitter.deleteLater()
        self._lower.clear()
        self._splitter = QSplitter(Qt.Orientation.Horizontal)
        # An observer clicks nothing: everything is transparent to the mouse.
        self._splitter.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        columns = [QSplitter(Qt.Orientation.Vertical) for _names in _COLUMNS[self.sees]]
        for column in columns:
            self._splitter.addWidget(column)
        possible = possible_panels(scenario)
        rows = zip_longest(*(filter(possible.__contains__, names) for names in _COLUMNS[self.sees]))
        self._missing = deque((column, name) for row in rows for column, name in zip(columns, row, strict=True) if name)
        self._splitter.setSizes([60, 40])
        self._column.addWidget(self._splitter, 1)
        self._splitter.show()
        self._column.activate()
        self._turn.start()

    def complete(self) -> None:
        """Create all missing panels now."""
        while self._missing:
            self._make_next()

    def _make_next(self) -> None:
        column, name = self._missing.popleft()
        card = self._panel(name)
        lower = column.count() > 0
        column.addWidget(card)
        if lower:
            self._lower.append(card)
            card.setVisible(self.height() >= _BOTH_FROM_PX)
        if self._missing:
            self._turn.start()
        else:
            self._turn.stop()

    def _panel(self, name: PanelName) -> QWidget:
        panel = PANELS[name].load()(self._context)
        card = QWidget()
        rows = layouts.vbox(card, margins_px=0, spacing_px=0)
        rows.addWidget(PanelTitleBar(panel, looked_at=True))
        rows.addWidget(panel, 1)
        for part in (card, *card.findChildren(QWidget)):
            part.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._panels[name] = panel
        lasting = self._lasting.pop(name, None)
        if lasting is not None:
            panel.restore_state(lasting)
        panel.set_in_view(True)
        return card

    def _place(self, beside: QWidget) -> None:
        """Place it on another screen, if there is one."""
        other = next((one for one in QGuiApplication.screens() if one is not beside.screen()), None)
        if other is not None:
            self.setGeometry(other.availableGeometry())

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        room_px = self.width() - 16
        self._signs.use_room(room_px, compact=room_px < self._whole_signs_px)
        for card in self._lower:
            card.setVisible(self.height() >= _BOTH_FROM_PX)

    def closeEvent(self, event: QCloseEvent) -> None:
        super().closeEvent(event)
        self.closed.emit()


class ObserverWindows:
    """Owner of at most one observer window. It follows scenario changes, and a window that was open when the program
    ended, even by a crash, reopens at the next start.
    """

    def __init__(
        self, theme: Theme, console: WizardConsole, hold: DriveInputFilter, window: QWidget, settings: Settings | None
    ) -> None:
        self._settings = settings
        self._theme = theme
        self._console = console
        self._hold = hold
        self._window = window
        self.open_window: ObserverWindow | None = None

    def open(self, sees: Sees, geometry: QByteArray | None = None) -> None:
        """Open with this ``geometry``, else on another screen if there is one."""
        self.close()
        self.open_window = ObserverWindow(self._theme, self._console, self._hold, self._window, sees)
        if geometry is not None:
            self.open_window.restoreGeometry(geometry)
        self.open_window.closed.connect(self._on_closed)
        self._persist(sees)
        self.open_window.show()

    def restore(self) -> None:
        """Reopen the window of the last run with the same content."""
        if self._settings is None or self.open_window is not None:
            return
        stored, geometry = self._settings.value(_SEES_KEY), self._settings.value(_GEOMETRY_KEY)
        for sees in SEES_WORDS:
            if sees == stored:
                self.open(sees, geometry if isinstance(geometry, QByteArray) else None)

    def end(self) -> None:
        """Close on quitting, so that it reopens at the next start."""
        if self.open_window is not None:
            sees = self.open_window.sees
            self.close()
            self._persist(sees)

    def _persist(self, sees: Sees | Literal[""]) -> None:
        if self._settings is not None:
            self._settings.setValue(_SEES_KEY, sees)

    def close(self) -> None:
        if self.open_window is not None:
            self.open_window.close()

    def show_scenario(self) -> None:
        if self.open_window is not None:
            self.open_window.show_scenario()

    def complete(self) -> None:
        if self.open_window is not None:
            self.open_window.complete()

    def _on_closed(self) -> None:
        if self.open_window is not None:
            if self._settings is not None:
                self._settings.setValue(_GEOMETRY_KEY, self.open_window.saveGeometry())
            self._persist("")
            self.open_window.deleteLater()
            self.open_window = None


class WatchedConsole:
    """Read-only view of ``console`` for observer panels.

    ``discreet``: hides names and the language model, so that neither names nor suggestions appear.
    """

    def __init__(self, console: WizardConsole, *, discreet: bool) -> None:
        self._console = console
        self._discreet = discreet

    def __getattr__(self, name: str) -> Any:
        return getattr(self._console, name)

    @property
    def scenario(self) -> Scenario:
        scenario = self._console.scenario
        if not self._discreet:
            return scenario
        return replace(
            scenario, permissions=replace(scenario.permissions, naming_people=False, assistant=False, notes=False)
        )

    def do(self, _intent: Intent) -> str:
        return ""


def watched(console: WizardConsole, *, discreet: bool) -> WizardConsole:
    return cast("WizardConsole", WatchedConsole(console, discreet=discreet))
