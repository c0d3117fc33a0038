"""What a dock panel is: a title, one live fact, a few controls in its title bar, and a card to draw on."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from operator import attrgetter
from typing import Any, Literal

from PySide6.QtCore import QPointF, QRectF, QSizeF, QTimer, Signal
from PySide6.QtGui import QAccessible, QPainter, QPainterPath, QPaintEvent, QPen
from PySide6.QtWidgets import QBoxLayout, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import dataclass
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.model import Scenario
from caris_desktop.scenario.panel_settings import PanelSettings
from caris_desktop.ui import tokens
from caris_desktop.ui.actions import Actions
from caris_desktop.ui.drive_keys import HoldToDrive
from caris_desktop.ui.painted_once import PaintedOnce
from caris_desktop.ui.theme import Theme

TITLE_HEIGHT_PX = 38
PAUSE_MS = 1
"""From one turn of longer work to the next. A timer that repeats without any interval comes first again and again."""
WindowName = Literal["start", "export", "sessions", "face"]
"""Windows that a panel can ask for: start recording, export the last session, all sessions, edit the face."""


@dataclass(frozen=True, slots=True)
class PanelContext:
    """What every panel gets to work with."""

    console: WizardConsole
    theme: Theme
    actions: Actions
    hold: HoldToDrive
    discreet: bool = False
    """Whether a participant may look on: what a wizard noted of people and turns is not shown."""


class Panel(QWidget):
    """Lower part of a panel's card. Subclasses fill it and say their live fact.

    A panel that nobody sees (closed, or behind another tab) costs nothing: what comes meanwhile is left out by asking
    ``in_view`` first, and ``catch_up`` shows it once the panel is seen again.
    """

    accessible_role = QAccessible.Role.Grouping

    title = ""
    drives = False  # bare drive keys work while this panel has the focus
    reads: tuple[str, ...] | None = None
    """Of the scenario, by dotted names, what it is built from and ``show_scenario`` cannot change; None: built anew."""
    fact_changed = Signal(str, str)  # text, colour role
    active_changed = Signal(bool)
    title_changed = Signal(str)
    controls_changed = Signal()  # title_widgets gives others now; who shows them deletes those that it gives no more
    window_wanted = Signal(str)  # WindowName
    choices_changed = Signal()  # ``choices`` are others, as the wizard wanted it
    moment_wanted = Signal(object)  # nanoseconds of the session clock: a replay goes there

    def __init__(self, context: PanelContext) -> None:
        super().__init__()
        self.console = context.console
        self._scenario = context.console.scenario
        self.state = context.console.state
        self.theme = context.theme
        self.table = context.actions
        self.hold = context.hold
        self._active = False
        self._goes_by_itself = 0
        self._in_view = True
        self._ticking: list[QTimer] = []
        self._fact = ("", "")
        self._fact_lead = 0
        self.title = tr(type(self).title)
        self._shown_title = self.title
        self.setAccessibleName(self.title)
        self.theme.changed.connect(self.update)

    def title_widgets(self) -> list[QWidget]:
        """Controls at the right end of the title bar."""
        return []

    @property
    def shown_title(self) -> str:
        """What the title bar says now; ``title`` is what menus call the panel."""
        return self._shown_title

    def show_title(self, text: str) -> None:
        if text != self._shown_title:
            self._shown_title = text
            self.setAccessibleName(text)
            self.title_changed.emit(text)

    @property
    def in_view(self) -> bool:
        """Whether the panel can be seen, as far as whoever arranges the panels has told."""
        return self._in_view

    def set_in_view(self, in_view: bool) -> None:
        if in_view == self._in_view:
            return
        self._in_view = in_view
        for timer in self._ticking:
            if in_view:
                timer.start()
            else:
                timer.stop()
        if in_view:
            self.catch_up()

    def catch_up(self) -> None:
        """The panel is seen again: show everything as it is now."""

    def follow(self, scenario: Scenario) -> bool:
        """Whether it goes on with another scenario, as that says the same of all that it was built from: then
        ``show_scenario`` comes next.

        The same scenario once more means that something else has changed: the panel is built anew.
        """
        before, self._scenario = self._scenario, scenario
        if self.reads is None or scenario == before:
            return False
        return all(attrgetter(name)(scenario) == attrgetter(name)(before) for name in self.reads)

    def complete(self) -> None:
        """Make now what it makes in several turns of the event loop."""

    def show_scenario(self) -> None:
        """It goes on with another scenario, whose rows the table has by now: show what that says of it, and nothing of
        the one before.
        """
        if self.in_view:
            self.catch_up()

    def use_settings(self, settings: PanelSettings) -> None:
        """Be as these have it, whatever it was like before; nothing in a panel of which they say nothing."""

    def what_lasts(self) -> Any:
        """What the next panel of this kind takes over, when all are built anew; None for nothing."""
        return None

    def take_over(self, lasting: Any) -> None:
        """Go on from ``what_lasts`` of the panel before."""

    def choices(self) -> dict[str, Any]:
        """How the wizard wants to see it, as JSON has it: kept from one run to the next. ``choices_changed`` tells."""
        return {}

    def tell_choices(self) -> None:
        """Something of them has changed."""
        if not self._goes_by_itself:
            self.choices_changed.emit()

    @contextmanager
    def by_itself(self) -> Iterator[None]:
        """What changes meanwhile is not what the wizard chose."""
        self._goes_by_itself += 1
        try:
            yield
        finally:
            self._goes_by_itself -= 1

    def use_choices(self, kept: Mapping[str, Any]) -> None:
        """As ``choices`` were last time. Whatever is in it may be missing, or of another type."""

    def edit_first(self, text: str, say: Callable[[str], bool]) -> None:
        """Let the wizard change ``text`` before ``say`` takes it; nothing in a panel without such a field."""

    def focus_list(self) -> None:
        """Put the focus into the list beside what usually has it."""

    def show_person(self, person_id: str, *, rename: bool = False, card: bool = False) -> None:
        """Bring somebody into view where people are listed; open the field for the name, or the card."""

    def open_search(self) -> None:
        """Put the keys where it is searched in what the panel shows."""

    def use_library(self, *, present: bool) -> None:
        """Whether there is a list of all sessions to open."""

    def every(self, interval_ms: int, slot: Callable[[], None]) -> QTimer:
        """Call ``slot`` again and again while the panel is in view."""
        timer = QTimer(self, interval=interval_ms)
        timer.timeout.connect(slot)
        self._ticking.append(timer)
        if self._in_view:
            timer.start()
        return timer

    @property
    def fact(self) -> tuple[str, str]:
        return self._fact

    @property
    def fact_lead(self) -> int:
        """How many characters of the fact have its colour; what follows them is dim."""
        return self._fact_lead

    def set_fact(self, text: str, role: str = "dim", *, rest: str = "") -> None:
        """The one live fact on the right of the title bar; ``rest`` of it is said less loudly."""
        whole, self._fact_lead = f"{text} {rest}".strip(), len(text)
        if (whole, role) != self._fact:
            self._fact = (whole, role)
            self.fact_changed.emit(whole, role)

    @property
    def active(self) -> bool:
        return self._active

    def set_active(self, active: bool) -> None:
        """Whether the keyboard focus is inside."""
        if active != self._active:
            self._active = active
            self.active_changed.emit(active)
            self.update()

    def focus_target(self) -> QWidget:
        """What gets the focus when the wizard goes to this panel."""
        return self

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        draw_card(painter, self.theme, QRectF(self.rect()), top=False, active=self._active)


def show_part(part: QWidget, shown: bool) -> None:
    """Show or hide a part that may have no parent yet: shown then, it would be a window of its own for a moment, and
    take the keys from driving. It appears with its parent.
    """
    if not shown:
        part.hide()
    elif part.parentWidget() is not None:
        part.show()


def draw_card(painter: QPainter, theme: Theme, rect: QRectF, *, top: bool, active: bool) -> None:
    """Half a card: rounded above (``top``) or below, with a line all round that is blue where the focus is."""
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    painter.setPen(QPen(theme.color("blue" if active else "line"), 1))
    painter.setBrush(theme.color("panel"))
    painter.drawPath(_card_path(rect, top=top))
    if top:
        painter.setPen(QPen(theme.color("line"), 1))
        painter.drawLine(QPointF(rect.left() + 1, rect.bottom() - 0.5), QPointF(rect.right() - 1, rect.bottom() - 0.5))


def draw_card_edge(painter: QPainter, theme: Theme, rect: QRectF, painted: PaintedOnce, *, active: bool) -> None:
    """The round corners and the line of the lower half of a card, over what reaches its edge.

    Clipping that to the corners would cost a hundred times as much. ``painted`` is cleared when the theme changes.
    """
    radius = float(tokens.PANEL_RADIUS_PX)
    line = theme.color("blue" if active else "line")
    straight = rect.height() - radius
    painter.fillRect(QRectF(rect.left(), rect.top(), 1, straight), line)
    painter.fillRect(QRectF(rect.right() - 1, rect.top(), 1, straight), line)
    painter.fillRect(QRectF(rect.left() + radius, rect.bottom() - 1, rect.width() - 2 * radius, 1), line)
    corners = {"left": rect.left(), "right": rect.right() - radius}
    for side, left in corners.items():

        def paint(onto: QPainter, side: str = side) -> None:
            whole = QRectF(0 if side == "left" else -3 * radius, -3 * radius, 4 * radius, 4 * radius)
            card = _card_path(whole, top=False)
            outside = QPainterPath()
            outside.addRect(whole)
            onto.fillPath(outside.subtracted(card), theme.color("window"))
            onto.strokePath(card, QPen(line, 1))

        painted.draw(
            painter, QPointF(left, rect.bottom() - radius), QSizeF(radius, radius), ("corner", side, active), paint
        )


def _card_path(rect: QRectF, *, top: bool) -> QPainterPath:
    radius = float(tokens.PANEL_RADIUS_PX)
    inner = rect.adjusted(0.5, 0.5 if top else 0.0, -0.5, 0.0 if top else -0.5)
    path = QPainterPath()
    if top:
        path.moveTo(inner.bottomLeft())
        path.lineTo(inner.left(), inner.top() + radius)
        path.quadTo(inner.topLeft(), inner.topLeft() + QPointF(radius, 0))
        path.lineTo(inner.right() - radius, inner.top())
        path.quadTo(inner.topRight(), inner.topRight() + QPointF(0, radius))
        path.lineTo(inner.bottomRight())
    else:
        path.moveTo(inner.topLeft())
        path.lineTo(inner.left(), inner.bottom() - radius)
        path.quadTo(inner.bottomLeft(), inner.bottomLeft() + QPointF(radius, 0))
        path.lineTo(inner.right() - radius, inner.bottom())
        path.quadTo(inner.bottomRight(), inner.bottomRight() + QPointF(0, -radius))
        path.lineTo(inner.topRight())
    return path


def card_margins(layout: QBoxLayout) -> None:
    """The room between a card's edge and what is in it."""
    layout.setContentsMargins(14, 12, 14, 12)
    layout.setSpacing(tokens.GRID_PX)
