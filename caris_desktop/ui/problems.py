"""Notifications: popups over a panel with room to spare, or a line in the status bar: what happened, what it means,
what to do. Never a modal dialog.
"""

from collections.abc import Callable, Sequence

from PySide6.QtCore import QEvent, QObject, QPoint, QRect, QRectF, Qt, QTimer, Signal
from PySide6.QtGui import QAccessible, QMouseEvent, QPaintEvent
from PySide6.QtWidgets import QLabel, QWidget

from caris_desktop.domain.events import ANSWER, Problem, Severity
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.alarm_causes import cause_among
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import Alarm
from caris_desktop.scenario.scenario_model import PanelName
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.announcing import announce
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.layout.dock_area import DockArea
from caris_desktop.ui.layout.dock_geometry import TITLE_PX, GroupPlace
from caris_desktop.ui.layout.layout_rect import Rect
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.status_button import StatusButton
from caris_desktop.ui.window_above import PLACE_CHANGES, InSight, windows_above
from caris_desktop.ui.wrapped_tip import wrapped_tip

SHOWN_AT_ONCE = 3
_GOES_AWAY_AFTER_MS = {"info": 8_000, "warning": 20_000}
LOOKS: dict[Severity, tuple[str, str, str]] = {
    "info": ("info", "blue", QT_TR_NOOP("Note")),
    "warning": ("warning", "amber", QT_TR_NOOP("Problem")),
    "error": ("warning-octagon", "red", QT_TR_NOOP("Serious problem")),
}
"""Icon, colour and label of each severity."""

_RANK: dict[Severity, int] = {"info": 0, "warning": 1, "error": 2}


class ProblemCards(InSight):
    """Notification popups for alarms and refused commands, newest first, over the video or another view-only panel.

    An alarm's popup closes with the alarm. A dismissed alarm, or a warning after a while, remains in the alarm list,
    and reappears when it blocks a command. Other notifications close after a while unless serious. Where no panel has
    room, ``line`` shows the most severe one, and a click on it opens the popups.
    """

    def __init__(self, theme: Theme, over: DockArea, state: LiveState, line: "ProblemLine") -> None:
        super().__init__(over)
        self.line = line
        self._open_requested = False
        self._clear_of: set[QWidget] = set()
        line.clicked.connect(self._on_line_clicked)
        self.setObjectName("problem_cards")
        self._theme = theme
        self._over = over
        self._cards: list[ProblemCard] = []
        self._opened: ProblemCard | None = None
        self._seen: dict[str, tuple[int, Severity, int]] = {}
        self._column = layouts.vbox(self, margins_px=0, spacing_px=tokens.GRID_PX)
        over.installEventFilter(self)
        over.laid_out.connect(self._on_laid_out)
        self._state = state
        state.alarms.changed.connect(self._on_alarms_changed)
        self.hide()
        self._on_alarms_changed(state.alarms.value)

    @property
    def cards(self) -> tuple["ProblemCard", ...]:
        return tuple(self._cards)

    def stay_clear_of(self, card: QWidget) -> None:
        """Never cover this popup, which asks a question or is read."""
        self._clear_of.add(card)
        card.installEventFilter(self)
        self._on_laid_out()

    def add(self, problem: Problem) -> None:
        """Show a refusal, unless an alarm already gives the reason."""
        if problem.cause == ANSWER and cause_among(problem, self._state.alarms.value) is None:
            self.show_problem(problem)

    def show_problem(self, problem: Problem) -> None:
        """Add a popup, or update the one with the same message."""
        known = next((card for card in self._cards if not card.alarm_id and card.problem.what == problem.what), None)
        if known is not None:
            known.show_problem(problem, again=True)
            announce(self._over, known.accessibleName())
            self._place()
        else:
            self._add(ProblemCard(self._theme, problem, self))

    def _on_alarms_changed(self, alarms: tuple[Alarm, ...]) -> None:
        current = {alarm.alarm_id: alarm for alarm in alarms}
        for card in [card for card in self._cards if card.alarm_id and card.alarm_id not in current]:
            self._dismiss(card)
        cards = {card.alarm_id: card for card in self._cards if card.alarm_id}
        self._seen = {alarm_id: seen for alarm_id, seen in self._seen.items() if alarm_id in current}
        for alarm in sorted(alarms, key=lambda alarm: alarm.began_ns):
            news = (alarm.times, alarm.severity, alarm.asked_ns)
            if alarm.alarm_id in cards:
                cards[alarm.alarm_id].show_alarm(alarm)
                if self._seen.get(alarm.alarm_id, news)[1:] != news[1:]:
                    announce(self._over, cards[alarm.alarm_id].accessibleName())
            elif self._seen.get(alarm.alarm_id) != news:
                self._add(ProblemCard(self._theme, _as_problem(alarm), self, alarm))
            self._seen[alarm.alarm_id] = news
        self._place()

    def _add(self, card: "ProblemCard") -> None:
        card.dismissed.connect(self._dismiss)
        card.opened.connect(self._open_whole)
        self._opened = None
        card.start_going_away()
        self._cards.append(card)
        self._column.addWidget(card)
        card.show()
        announce(self._over, card.accessibleName())
        if len(self._cards) > SHOWN_AT_ONCE:
            self._dismiss(self._cards[0])
        self._place()

    def _dismiss(self, card: "ProblemCard") -> None:
        if card in self._cards:
            self._cards.remove(card)
            self._opened = None if self._opened is card else self._opened
            self._column.removeWidget(card)
            card.hide()
            card.deleteLater()
            self._place()

    def _place(self) -> None:
        place = self._free_place() if self._cards else None
        self._open_requested = self._open_requested and bool(self._cards) and place is None
        problem = gravest(self._cards).problem if self._cards and place is None else None
        self.line.show_problem(problem, len(self._cards), opened=self._open_requested)
        if place is None and self._open_requested:
            place = in_the_corner(Rect(0, 0, self._over.width(), self._over.height()), self._height_for)
        self.setVisible(place is not None)
        if place is None:
            return
        self.setFixedWidth(place.width)
        self.resize(place.width, place.height)
        self._column.activate()
        self.move(QPoint(place.left, place.top))
        self.raise_()

    def _on_line_clicked(self) -> None:
        self._open_requested = not self._open_requested
        self._place()

    def _free_place(self) -> Rect | None:
        """Place for the popups. One is expanded, the newest of the most severe or the clicked one; the others are
        collapsed.
        """
        open_card = self._opened or gravest(self._cards)
        for card in self._cards:
            card.fold(card is not open_card)
        if not self._over.isVisibleTo(self._over.window()):
            return None
        clear_of = (card for card in self._clear_of if card.isVisible())
        taken = [_rect(QRect(self._over.mapFromGlobal(card.mapToGlobal(QPoint())), card.size())) for card in clear_of]
        taken += [_rect(window.place_in(self._over)) for window in windows_above(self._over.window())]
        return card_place(self._over.placing.groups, self._height_for, taken)

    def _open_whole(self, card: "ProblemCard") -> None:
        self._opened = card
        self._place()

    def _height_for(self, width_px: int) -> int:
        self._column.invalidate()
        return self._column.heightForWidth(width_px) if self._column.hasHeightForWidth() else self.sizeHint().height()

    def _on_laid_out(self) -> None:
        if self._cards:
            self._place()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if event.type() in PLACE_CHANGES and (watched is self._over or watched in self._clear_of):
            self._on_laid_out()
        return False


def _rect(place: QRect) -> Rect:
    return Rect(place.x(), place.y(), place.width(), place.height())


def gravest(cards: Sequence["ProblemCard"]) -> "ProblemCard":
    """Newest of the most severe."""
    return max(reversed(cards), key=lambda card: _RANK[card.problem.severity])


class ProblemLine(StatusButton):
    """Most severe notification and the number of all, in the status bar; covers and moves nothing."""

    def __init__(self, theme: Theme) -> None:
        super().__init__(theme, "problem_line", "")
        self.setCheckable(True)
        self.hide()

    def show_problem(self, one: Problem | None, number: int, *, opened: bool) -> None:
        """Show one of ``number``, or none; ``opened``: the popups are open."""
        self.setChecked(opened)
        if one is None:
            self.show_words("", "", "dim", spoken="")
            return
        icon, role, word = LOOKS[one.severity]
        text = one.what
        if number > 1:
            text = tr("{number} · {problem}").format(number=number, problem=text)
        spoken = tr("{severity}: {what}").format(severity=tr(word), what=text)
        self.show_words(text, icon, role, spoken=spoken)
        explanation = " ".join(part for part in (one.meaning, one.advice) if part)
        self.setAccessibleDescription(explanation)
        self.setToolTip(wrapped_tip(one.what, explanation, tr("Click to show or hide it.")))


class ProblemCard(QWidget):
    """Popup of one notification: a problem, or an alarm made from it."""

    accessible_role = QAccessible.Role.AlertMessage

    dismissed = Signal(object)  # this popup
    opened = Signal(object)

    def __init__(self, theme: Theme, problem: Problem, parent: QWidget, alarm: Alarm | None = None) -> None:
        super().__init__(parent)
        self.problem = problem
        self.alarm_id = "" if alarm is None else alarm.alarm_id
        self._theme = theme
        self._only_called = False
        self._count = 1 if alarm is None else alarm.times
        self._folded = () if alarm is None else alarm.folded
        self._shown_why = "" if alarm is None else alarm.why
        self._what = QLabel()
        self._meaning = QLabel()
        self._advice = QLabel()
        self._why = QLabel()
        self._also = QLabel()
        self._labels = (self._what, self._meaning, self._advice, self._why, self._also)
        for label in self._labels:
            label.setWordWrap(True)
            label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        close = ActionButton(theme, "", icon="x", role="ghost", height_px=28)
        close.setObjectName("problem_dismiss")
        close.setAccessibleName(tr("Dismiss"))
        close.clicked.connect(lambda: self.dismissed.emit(self))
        column = layouts.vbox(spacing_px=3)
        for label in self._labels:
            column.addWidget(label)
        row = self._row = layouts.hbox(self, margins_px=(48, 12, 8, 14))
        row.addLayout(column, 1)
        row.addWidget(close, 0, Qt.AlignmentFlag.AlignTop)
        self._timer = QTimer(self, singleShot=True)
        self._timer.timeout.connect(lambda: self.dismissed.emit(self))
        theme.restyle_on_change(self._style)

    def show_problem(self, problem: Problem, *, again: bool = False) -> None:
        self.problem = problem
        self._count += again
        self._style()
        self.start_going_away()

    def fold(self, folded: bool) -> None:
        """Collapse to the title; the rest is in the tooltip, and a click expands it."""
        if folded != self._only_called:
            self._only_called = folded
            self._style()
            self._row.invalidate()
            self.updateGeometry()

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if self._only_called:
            self.opened.emit(self)
        event.accept()

    def show_alarm(self, alarm: Alarm) -> None:
        problem = _as_problem(alarm)
        before = (self.problem, self._count, self._folded, self._shown_why)
        if (problem, alarm.times, alarm.folded, alarm.why) == before:
            return
        self._count, self._folded, self._shown_why = alarm.times, alarm.folded, alarm.why
        self.show_problem(problem)

    def start_going_away(self) -> None:
        after_ms = _GOES_AWAY_AFTER_MS.get(self.problem.severity)
        if after_ms is not None:
            self._timer.start(after_ms)
        else:
            self._timer.stop()

    def _style(self) -> None:
        word = tr(LOOKS[self.problem.severity][2])
        what = self.problem.what
        if self._count > 1:
            what = tr("{problem} ({number} times)").format(problem=what, number=self._count)
        also = ""
        if self._folded:
            also = tr("Caused by this: {what}").format(what=" ".join(self._folded[-2:]))
        texts = (what, self.problem.meaning, self.problem.advice, self._shown_why, also)
        small = self._theme.font(tokens.STATUS_PX + 1)
        large = self._theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD)
        for label, text, role in zip(self._labels, texts, ("text", "dim", "text", "dim", "dim"), strict=True):
            label.setText(text)
            label.setVisible(bool(text) and (label is self._what or not self._only_called))
            label.setFont(large if label is self._what else small)
            self._theme.color_text(label, role)
        self.setToolTip("\n".join(text for text in texts if text) if self._only_called else "")
        self.setAccessibleName(f"{word}: {' '.join(text for text in texts if text)}")
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        icon, role, _ = LOOKS[self.problem.severity]
        painter = self._theme.paint_box(
            self, ground="panel", line=role, radius_px=tokens.PANEL_RADIUS_PX, line_px=1.2, inset_px=(1, 1)
        )
        draw_icon(painter, QRectF(14, 13, 22, 22), icon, self._theme.color(role))


def _as_problem(alarm: Alarm) -> Problem:
    return Problem(
        alarm.began_ns, alarm.severity, alarm.what, alarm.meaning, alarm.advice, alarm.until, alarm.cause
    )  # fmt: skip


CARD_WIDEST_PX = 400
_NARROWEST_PX, _LEAST_PX, _BESIDE_PX, _FROM_EDGE_PX = 280, 200, 12, 20
# Least important panels first. Speak and Drive are never covered: they are in constant use.
_GIVES_WAY: tuple[PanelName, ...] = (
    "face", "session", "diagnostics", "motion", "photos", "notes", "robot", "people", "map",
)  # fmt: skip
_LAST: tuple[PanelName, ...] = ("conversation", "assistant", "video")
_WIDE_PX = 700
_SHARE = 0.6
"""Maximum covered share of a panel's height: controls are at its top, and in the video the path ahead
is at the bottom.
"""


def card_place(
    groups: Sequence[GroupPlace], height_for: Callable[[int], int], taken: Sequence[Rect] = ()
) -> Rect | None:
    """Rectangle over the least important panel with enough room; None if there is none.

    At the upper end of video and transcript, because the ground ahead and the newest words are further down; at the
    lower end elsewhere. ``groups``: tab groups as laid out, in px of the dock area. ``height_for``: height of the
    popups for a width. ``taken``: areas of popups that ask a question and must not be covered.
    """
    rooms = {group.current: _below_title(group) for group in groups}
    tries = [(name, 1.0 if name == "face" else _SHARE) for name in _GIVES_WAY]
    if "video" in rooms and rooms["video"].width >= _WIDE_PX:
        tries.append(("video", 1.0))  # next to its centre
    for name, share in [*tries, *((name, _SHARE) for name in _LAST)]:
        room = rooms.get(name)
        if room is None:
            continue
        width = min(CARD_WIDEST_PX, room.width - 2 * _BESIDE_PX)
        height = height_for(width) if width >= _NARROWEST_PX else room.height
        if height + 2 * _BESIDE_PX <= room.height * share:
            top = room.top + _BESIDE_PX if name in _LAST else room.bottom - height - _BESIDE_PX
            found = Rect(room.right - width - _BESIDE_PX, top, width, height)
            if not any(found.overlap(each) for each in taken):
                return found
    return None


def in_the_corner(area: Rect, height_for: Callable[[int], int]) -> Rect:
    """Lower right corner of ``area``, the fallback."""
    width = max(_LEAST_PX, min(CARD_WIDEST_PX, area.width - 32))
    height = height_for(width)
    top = max(area.top, area.bottom - height - _FROM_EDGE_PX)
    return Rect(area.right - width - _FROM_EDGE_PX, top, width, height)


def _below_title(group: GroupPlace) -> Rect:
    body = group.body
    return Rect(body.left, body.top + TITLE_PX, body.width, max(0, body.height - TITLE_PX))
