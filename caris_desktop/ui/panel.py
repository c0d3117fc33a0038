"""Base class of dock panels: title, status text, title bar controls; the edge of a card over a picture."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from inspect import Parameter, signature
from itertools import product
from operator import attrgetter
from typing import Any, Literal

from PySide6.QtCore import QObject, QPointF, QRect, QRectF, QSize, QSizeF, Qt, QTimer, Signal, SignalInstance
from PySide6.QtGui import QAccessible, QPainter, QPainterPath, QPen, QResizeEvent
from PySide6.QtWidgets import QBoxLayout, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.scenario_model import PanelSettings, Scenario
from caris_desktop.ui import tokens
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.input.drive_input_filter import DriveInputFilter
from caris_desktop.ui.theme import Theme, draw_cached

TITLE_HEIGHT_PX = 38
PAUSE_MS = 1
"""Interval in ms between steps of longer work. A repeating timer with interval 0 would starve other events."""
WindowName = Literal["start", "export", "sessions", "face"]
"""Windows that a panel can request: start recording, export the last session, all sessions, edit the face."""


class PanelContext(Value):
    """Dependencies shared by all panels."""

    console: WizardConsole
    theme: Theme
    actions: Actions
    hold: DriveInputFilter
    discreet: bool = False
    """Whether a participant may see the screen: the wizard's notes on people and turns are hidden."""
    observed: bool = False
    """Whether it is for the observer window, which has signs of its own."""


class Panel(QWidget):
    """Content of a panel below its title bar. Subclasses add widgets and a status text.

    A hidden panel (closed, or behind another tab) does no work: it connects what it shows with ``watch``, and
    ``update_view`` refreshes it once it is visible again.
    """

    accessible_role = QAccessible.Role.Grouping

    title = ""
    preferred_size, least_size = QSize(), QSize()  # invalid: as the layout says
    drives = False  # bare drive keys work while this panel has the focus
    reads: tuple[str, ...] | None = None
    """Scenario fields (dotted names) that require a rebuild, because ``show_scenario`` cannot apply their change; None:
    always rebuild.
    """
    fact_changed = Signal(str, str)  # text, colour role
    active_changed = Signal(bool)
    title_changed = Signal(str)
    controls_changed = Signal()  # title_widgets returns others now; the receiver deletes dropped ones
    window_requested = Signal(str)  # WindowName
    choices_changed = Signal()  # the wizard changed ``choices``
    moment_requested = Signal(object)  # session clock in nanoseconds: seek a replay there

    def __init__(self, context: PanelContext) -> None:
        super().__init__()
        self.console = context.console
        self._scenario = context.console.scenario
        self.state = context.console.state
        self.theme = context.theme
        self.table = context.actions
        self.hold = context.hold
        self.active = False
        self.covered = QRect()  # by a banner
        self._goes_by_itself = 0
        self.in_view = True
        """Whether the panel is visible, as set by the panel manager."""
        self._ticking: list[QTimer] = []
        self.fact = ("", "")
        self.fact_lead = 0
        """Number of leading characters of the status text in its colour; the rest is dimmed."""
        self.title = tr(type(self).title)
        self.shown_title = self.title
        """Current text of the title bar; menus use ``title``."""
        self.setAccessibleName(self.title)
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self.setProperty("role", "panel")

    def sizeHint(self) -> QSize:
        return self.preferred_size if self.preferred_size.isValid() else super().sizeHint()

    def minimumSizeHint(self) -> QSize:
        return self.least_size if self.least_size.isValid() else super().minimumSizeHint()

    def title_widgets(self) -> list[QWidget]:
        """Controls at the right end of the title bar."""
        return []

    def picture(self) -> QWidget | None:
        """Picture that reaches the upper edge of the card: in a dock the controls of the title bar lie on it, the first
        at the left end.
        """
        return None

    def show_title(self, text: str) -> None:
        if text != self.shown_title:
            self.shown_title = text
            self.setAccessibleName(text)
            self.title_changed.emit(text)

    def set_in_view(self, in_view: bool) -> None:
        if in_view == self.in_view:
            return
        self.in_view = in_view
        for timer in self._ticking:
            if in_view:
                timer.start()
            else:
                timer.stop()
        if in_view:
            self.update_view()

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self.fit()

    def fit(self) -> None:
        """Adapt the contents to the size of the panel."""

    def watch(self, slot: Callable[..., object], *signals: SignalInstance) -> None:
        """Call the slot while the panel is in view; ``update_view`` makes up for what it missed."""
        watch = _Watch(self, slot)
        for signal in signals:
            signal.connect(watch.call)

    def update_view(self) -> None:
        """Refresh everything after the panel becomes visible again."""

    def can_reuse(self, scenario: Scenario) -> bool:
        """Whether the panel can be reused for another scenario, whose ``reads`` are unchanged; ``show_scenario``
        follows.

        The same scenario again means that something else has changed: rebuild.
        """
        before, self._scenario = self._scenario, scenario
        if self.reads is None or scenario == before:
            return False
        return all(attrgetter(name)(scenario) == attrgetter(name)(before) for name in self.reads)

    def complete(self) -> None:
        """Create now what is otherwise created over several turns of the event loop."""

    def show_scenario(self) -> None:
        """Show a new scenario in a reused panel, after the action table was rebuilt; drop the contents of the former
        one.
        """
        if self.in_view:
            self.update_view()

    def use_settings(self, settings: PanelSettings) -> None:
        """Apply these panel settings in full; panels without settings ignore them."""

    def save_state(self) -> Any:
        """State to pass to the next panel of this kind after a rebuild; None for none."""
        return None

    def restore_state(self, lasting: Any) -> None:
        """Restore ``save_state`` of the former panel."""

    def choices(self) -> dict[str, Any]:
        """View preferences as JSON data, persisted between runs. ``choices_changed`` reports changes."""
        return {}

    def report_choices(self) -> None:
        """Report changed preferences."""
        if not self._goes_by_itself:
            self.choices_changed.emit()

    @contextmanager
    def preferences_blocked(self) -> Iterator[None]:
        """Context in which changes are not saved as preferences."""
        self._goes_by_itself += 1
        try:
            yield
        finally:
            self._goes_by_itself -= 1

    def use_choices(self, stored: Mapping[str, Any]) -> None:
        """Restore ``choices``. Entries may be missing or of another type."""

    def edit_first(self, text: str, say: Callable[[str], bool]) -> None:
        """Let the wizard edit ``text`` before ``say`` receives it; does nothing in a panel without such a field."""

    def focus_list(self) -> None:
        """Focus the panel's list instead of its main field."""

    def show_person(self, person_id: str, *, rename: bool = False, card: bool = False) -> None:
        """Reveal a person in a list of people; open the name field or the person's popup."""

    def open_search(self) -> None:
        """Focus the search field."""

    def use_library(self, *, present: bool) -> None:
        """Set whether a session library is available."""

    def every(self, interval_ms: int, slot: Callable[[], None]) -> QTimer:
        """Call ``slot`` periodically while the panel is in view."""
        timer = QTimer(self, interval=interval_ms)
        timer.timeout.connect(slot)
        self._ticking.append(timer)
        if self.in_view:
            timer.start()
        return timer

    def set_fact(self, text: str, role: str = "dim", *, rest: str = "") -> None:
        """Set the status text on the right of the title bar; ``rest`` is dimmed."""
        full_text, self.fact_lead = f"{text} {rest}".strip(), len(text)
        if (full_text, role) != self.fact:
            self.fact = (full_text, role)
            self.fact_changed.emit(full_text, role)

    def set_active(self, active: bool) -> None:
        """Set whether the keyboard focus is inside."""
        if active != self.active:
            self.active = active
            self.active_changed.emit(active)

    def focus_target(self) -> QWidget:
        """Widget to focus when the wizard goes to this panel."""
        return self


class _Watch(QObject):
    """Calls ``slot`` while ``panel`` is in view. Stays connected: PySide crashes when a slot that was disconnected and
    connected again is deleted.
    """

    def __init__(self, panel: Panel, slot: Callable[..., object]) -> None:
        super().__init__(panel)
        self._panel = panel
        self._slot = slot
        kinds = [parameter.kind for parameter in signature(slot).parameters.values()]
        self._most = None if Parameter.VAR_POSITIONAL in kinds else len(kinds)

    def call(self, *values: object) -> None:
        if self._panel.in_view:
            self._slot(*values[: self._most])


def show_part(part: QWidget, visible: bool) -> None:
    """Show or hide a widget that may have no parent yet: shown without one, it would briefly be a window and take the
    focus from driving. It appears with its parent.
    """
    if not visible:
        part.hide()
    elif part.parentWidget() is not None:
        part.show()


def draw_card_edge(painter: QPainter, theme: Theme, rect: QRectF, *, active: bool, whole: bool = False) -> None:
    """Round corners and outline of a card, or (not ``whole``) of its lower half, over content that reaches its edge.

    Clipping the content would cost a hundred times as much.
    """
    radius = float(tokens.PANEL_RADIUS_PX)
    line = theme.color("blue" if active else "line")
    above = radius if whole else 0.0
    straight = rect.height() - radius - above
    painter.fillRect(QRectF(rect.left(), rect.top() + above, 1, straight), line)
    painter.fillRect(QRectF(rect.right() - 1, rect.top() + above, 1, straight), line)
    painter.fillRect(QRectF(rect.left() + radius, rect.bottom() - 1, rect.width() - 2 * radius, 1), line)
    if whole:
        painter.fillRect(QRectF(rect.left() + radius, rect.top(), rect.width() - 2 * radius, 1), line)
    lefts, tops = {0.0: rect.left(), 3 * radius: rect.right() - radius}, {3 * radius: rect.bottom() - radius}
    if whole:
        tops[0.0] = rect.top()
    for (inside_x, left), (inside_y, top) in product(lefts.items(), tops.items()):

        def paint(onto: QPainter, inside_x: float = inside_x, inside_y: float = inside_y) -> None:
            outline = QRectF(-inside_x, -inside_y, 4 * radius, 4 * radius)
            card, outside = QPainterPath(), QPainterPath()
            card.addRoundedRect(outline.adjusted(0.5, 0.5, -0.5, -0.5), radius, radius)
            outside.addRect(outline)
            onto.fillPath(outside.subtracted(card), theme.color("window"))
            onto.strokePath(card, QPen(line, 1))

        corner = ("corner", inside_x, inside_y, active)
        draw_cached(painter, QPointF(left, top), QSizeF(radius, radius), corner, paint)


def card_margins(layout: QBoxLayout) -> None:
    """Set the margins between a card's edge and its content."""
    layout.setContentsMargins(14, 12, 14, 12)
    layout.setSpacing(tokens.GRID_PX)
