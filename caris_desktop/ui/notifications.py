"""Notifications: popups over a panel with room to spare, or a line in the status bar: what happened, what it means,
what to do; and the list of active alarms. Never a modal dialog.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from PySide6.QtCore import QPoint, QRect, Qt, QTimer, Signal
from PySide6.QtGui import QAccessible, QMouseEvent
from PySide6.QtWidgets import QAbstractButton, QComboBox, QLabel, QLineEdit, QVBoxLayout, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.events import ANSWER, Problem, Severity
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.alarm_causes import cause_among
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import Alarm
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.scenario_model import PanelName
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.accessibility import announce, has_role
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_rows import ALARMS_GROUP
from caris_desktop.ui.dock_area import DockArea
from caris_desktop.ui.dock_geometry import GroupPlace
from caris_desktop.ui.event_watch import EventWatch
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.panel import TITLE_HEIGHT_PX
from caris_desktop.ui.text_formatting import wrapped_tip
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton, StatusButton
from caris_desktop.ui.widgets.containers import list_area
from caris_desktop.ui.widgets.labels import IconLabel, label, restyle
from caris_desktop.ui.widgets.popups import Popup
from caris_desktop.ui.widgets.rows import show_rows
from caris_desktop.ui.window_place import PLACE_CHANGES, InSight, windows_above

_CONTROLS = QAbstractButton, QComboBox, QLineEdit
SHOWN_AT_ONCE = 3
_GOES_AWAY_AFTER_MS = {"info": 8_000, "warning": 20_000}
LOOKS: dict[Severity, tuple[str, str, str]] = {
    "info": ("info", "blue", QT_TR_NOOP("Note")),
    "warning": ("warning", "amber", QT_TR_NOOP("Problem")),
    "error": ("warning-octagon", "red", QT_TR_NOOP("Serious problem")),
}
"""Icon, colour and label of each severity."""

_RANK: dict[Severity, int] = {"info": 0, "warning": 1, "error": 2}


class NotificationText(QVBoxLayout):
    """What happened, what it means, what to do, why it is asked, and what it caused, where there is a text."""

    def __init__(self, *more: QLabel) -> None:
        super().__init__()
        self.setSpacing(3)
        self._labels = [
            label("", role, wraps=True, textInteractionFlags=Qt.TextInteractionFlag.TextSelectableByMouse)
            for role in ("title", "fine", "detail", "fine", "fine")
        ]
        layouts.fill(self, *self._labels, *more)

    def show_texts(self, texts: Sequence[str], *, title_only: bool = False) -> None:
        for number, (shown, text) in enumerate(zip(self._labels, texts, strict=True)):
            shown.setText(text)
            shown.setVisible(bool(text) and not (title_only and number))


def _texts(problem: Problem | Alarm, times: int, why: str, caused: Sequence[str]) -> tuple[str, str, str, str, str]:
    what = problem.what
    if times > 1:
        what = tr("{problem} ({number} times)").format(problem=what, number=times)
    also = tr("Caused by this: {what}").format(what=" ".join(caused)) if caused else ""
    return what, problem.meaning, problem.advice, why, also


class NotificationPopups(InSight):
    """Notification popups for alarms and refused commands, newest first, over the video or another view-only panel.

    An alarm's popup closes with the alarm. A dismissed alarm, or a warning after a while, remains in the alarm list,
    and reappears when it blocks a command. Other notifications close after a while unless serious. Where no panel has
    room, ``line`` shows the most severe one, and a click on it opens the popups.
    """

    def __init__(self, theme: Theme, over: DockArea, state: LiveState, line: "NotificationLine") -> None:
        super().__init__(over)
        self.line = line
        self._open_requested = False
        self._clear_of: set[QWidget] = set()
        line.clicked.connect(self._on_line_clicked)
        self.setObjectName("problem_cards")
        self._theme = theme
        self._over = over
        self._cards: list[NotificationPopup] = []
        self._opened: NotificationPopup | None = None
        self._seen: dict[str, tuple[int, Severity, int]] = {}
        self._column = layouts.vbox(self, margins_px=0, spacing_px=tokens.GRID_PX)
        self._moves = EventWatch(self, self._on_laid_out, *PLACE_CHANGES)
        self._moves.add(over)
        over.laid_out.connect(self._on_laid_out)
        self._state = state
        self.hide()
        state.alarms.follow(self._on_alarms_changed)

    @property
    def cards(self) -> tuple["NotificationPopup", ...]:
        return tuple(self._cards)

    def stay_clear_of(self, card: QWidget) -> None:
        """Never cover this popup, which asks a question or is read."""
        self._clear_of.add(card)
        self._moves.add(card)
        self._on_laid_out()

    def add(self, problem: Problem) -> None:
        """Show a refusal, unless an alarm already gives the reason."""
        if problem.cause == ANSWER and cause_among(problem, self._state.alarms.value) is None:
            self.show_problem(problem)

    def notify(self, what: str, meaning: str, advice: str, severity: Severity = "info") -> None:
        """Show a notification about the window, not the session."""
        self.show_problem(Problem(self._state.present.now_ns(), severity, what, meaning, advice))

    def show_problem(self, problem: Problem) -> None:
        """Add a popup, or update the one with the same message."""
        known = next((card for card in self._cards if not card.alarm_id and card.problem.what == problem.what), None)
        if known is not None:
            known.show_problem(problem, again=True)
            announce(self._over, known.accessibleName())
            self._place()
        else:
            self._add(NotificationPopup(self._theme, problem, self))

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
                self._add(NotificationPopup(self._theme, _as_problem(alarm), self, alarm))
            self._seen[alarm.alarm_id] = news
        self._place()

    def _add(self, card: "NotificationPopup") -> None:
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

    def _dismiss(self, card: "NotificationPopup") -> None:
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
            place = in_the_corner(self._seen_part(), self._height_for)
        self.setVisible(place is not None)
        if place is None:
            return
        self.setFixedWidth(place.width())
        self.resize(place.size())
        self._column.activate()
        self.move(place.topLeft())
        self.raise_()

    def _on_line_clicked(self) -> None:
        self._open_requested = not self._open_requested
        self._place()

    def _free_place(self) -> QRect | None:
        """Place for the popups. One is expanded, the newest of the most severe or the clicked one; the others are
        collapsed.
        """
        open_card = self._opened or gravest(self._cards)
        for card in self._cards:
            card.fold(card is not open_card)
        if not self._over.isVisibleTo(self._over.window()):
            return None
        taken = self._places_of(card for card in self._clear_of if card.isVisible())
        taken += [window.place_in(self._over) for window in windows_above(self._over.window())]
        parts = [part for kind in _CONTROLS for part in self._over.findChildren(kind)]
        controls = [part for part in parts if part.isVisible() and not self.isAncestorOf(part)]
        seen = self._seen_part()
        groups = [
            replace(group, rect=group.rect & seen) for group in self._over.placing.groups if group.rect.intersects(seen)
        ]
        return card_place(groups, self._height_for, taken, self._places_of(controls))

    def _seen_part(self) -> QRect:
        """Part of the panels that is not scrolled out of view, as in a replay."""
        around = self._over.parentWidget()
        seen = around.rect() if around is not None else self._over.rect()
        return seen.translated(-self._over.pos()) & self._over.rect()

    def _places_of(self, parts: Iterable[QWidget]) -> list[QRect]:
        return [QRect(self._over.mapFromGlobal(part.mapToGlobal(QPoint())), part.size()) for part in parts]

    def _open_whole(self, card: "NotificationPopup") -> None:
        self._opened = card
        self._place()

    def _height_for(self, width_px: int) -> int:
        self._column.invalidate()
        return self._column.heightForWidth(width_px) if self._column.hasHeightForWidth() else self.sizeHint().height()

    def _on_laid_out(self) -> None:
        if self._cards:
            self._place()


def gravest(cards: Sequence["NotificationPopup"]) -> "NotificationPopup":
    """Newest of the most severe."""
    return max(reversed(cards), key=lambda card: _RANK[card.problem.severity])


class NotificationLine(StatusButton):
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


class NotificationPopup(Popup):
    """Popup of one notification: a problem, or an alarm made from it."""

    accessible_role = QAccessible.Role.AlertMessage

    dismissed = Signal(object)  # this popup
    opened = Signal(object)

    def __init__(self, theme: Theme, problem: Problem, parent: QWidget, alarm: Alarm | None = None) -> None:
        super().__init__(theme, parent)
        self.problem = problem
        self.alarm_id = "" if alarm is None else alarm.alarm_id
        self._only_called = False
        self._count = 1 if alarm is None else alarm.times
        self._folded = () if alarm is None else alarm.folded
        self._shown_why = "" if alarm is None else alarm.why
        self._text = NotificationText()
        self._icon = IconLabel(theme, size_px=22)
        close = ActionButton(
            theme, icon="x", role="ghost", height_px=28, objectName="problem_dismiss", accessibleName=tr("Dismiss"),
            clicked=lambda: self.dismissed.emit(self),
        )  # fmt: skip
        parts = (self._icon, 0, layouts.TOP), (self._text, 1), (close, 0, layouts.TOP)
        self._row = layouts.hbox(self, *parts, margins_px=(14, 12, 8, 14), spacing_px=12)
        self._timer = QTimer(self, singleShot=True)
        self._timer.timeout.connect(lambda: self.dismissed.emit(self))
        self._show_text()

    def show_problem(self, problem: Problem, *, again: bool = False) -> None:
        self.problem = problem
        self._count += again
        self._show_text()
        self.start_going_away()

    def fold(self, folded: bool) -> None:
        """Collapse to the title; the rest is in the tooltip, and a click expands it."""
        if folded != self._only_called:
            self._only_called = folded
            self._show_text()

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

    def _show_text(self) -> None:
        icon, tone, word = LOOKS[self.problem.severity]
        self._icon.show_icon(icon, tone)
        restyle(self, tone=tone)
        texts = _texts(self.problem, self._count, self._shown_why, self._folded[-2:])
        self._text.show_texts(texts, title_only=self._only_called)
        said = [text for text in texts if text]
        self.setToolTip("\n".join(said) if self._only_called else "")
        self.setAccessibleName(f"{tr(word)}: {' '.join(said)}")
        # Both layouts keep the height of the former texts until the next event; the popup is placed before it.
        self._text.invalidate()
        self._row.invalidate()
        self.updateGeometry()


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


def _without_controls(room: QRect, controls: Sequence[QRect]) -> QRect:
    """Highest part of ``room`` above, between or below the controls."""
    found, top = QRect(), room.top()
    edges = sorted((each.top(), each.bottom() + 1) for each in controls if each.intersects(room))
    for upper, lower in (*edges, (room.bottom() + 1, 0)):
        if upper - top > found.height():
            found = QRect(room.left(), top, room.width(), upper - top)
        top = max(top, lower)
    return found


def card_place(
    groups: Sequence[GroupPlace],
    height_for: Callable[[int], int],
    taken: Sequence[QRect] = (),
    controls: Sequence[QRect] = (),
) -> QRect | None:
    """Rectangle over the least important panel with enough room; None if there is none.

    At the upper end of video and transcript, because the ground ahead and the newest words are further down; at the
    lower end elsewhere. ``groups``: tab groups as laid out, in px of the dock area. ``height_for``: height of the
    popups for a width. ``taken``: areas of popups that ask a question and must not be covered; ``controls``: of buttons
    and fields, which must not be covered either.
    """
    rooms = {group.current: group.body.adjusted(0, TITLE_HEIGHT_PX, 0, 0) for group in groups}
    tries = [(name, 1.0 if name == "face" else _SHARE) for name in _GIVES_WAY]
    if "video" in rooms and rooms["video"].width() >= _WIDE_PX:
        tries.append(("video", 1.0))  # next to its centre
    for name, share in [*tries, *((name, _SHARE) for name in _LAST)]:
        room = rooms.get(name)
        if room is None:
            continue
        width = min(CARD_WIDEST_PX, room.width() - 2 * _BESIDE_PX)
        height = height_for(width) if width >= _NARROWEST_PX else room.height()
        free = _without_controls(room, controls)
        if height + 2 * _BESIDE_PX <= min(free.height(), room.height() * share):
            top = free.top() + _BESIDE_PX if name in _LAST else free.bottom() + 1 - height - _BESIDE_PX
            found = QRect(room.right() + 1 - width - _BESIDE_PX, top, width, height)
            if not any(found.intersects(each) for each in taken):
                return found
    return None


def in_the_corner(area: QRect, height_for: Callable[[int], int]) -> QRect:
    """Lower right corner of ``area``, the fallback."""
    width = max(_LEAST_PX, min(CARD_WIDEST_PX, area.width() - 32))
    height = height_for(width)
    top = max(area.top(), area.bottom() + 1 - height - _FROM_EDGE_PX)
    return QRect(area.right() + 1 - width - _FROM_EDGE_PX, top, width, height)


_ALARMS_PX, _ALARMS_CHROME_PX = 680, 88
_FOLDED_SHOWN = 5


class AlarmsButton(StatusButton):
    """Number of alarms; visible only while there are any."""

    def __init__(self, theme: Theme, console: WizardConsole) -> None:
        super().__init__(theme, "alarms_button", tr("Active alarms and what to do about them. Click for the list."))
        console.state.alarms.follow(self._show)

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
        super().__init__(theme, window, width_px=_ALARMS_PX)
        self.setObjectName("alarm_list")
        self._console = console
        actions.answer_for(ALARMS_GROUP, self)
        self._rows: dict[str, AlarmRow] = {}
        self._nothing = label(
            tr("No active alarms. Past alarms are in the Session log."), tone="dim", wraps=True, objectName="no_alarm"
        )
        log = ActionButton(
            theme, tr("History"), icon="list-bullets", role="ghost", objectName="alarms_log",
            toolTip=tr("Open the Session log"), clicked=self.log_requested,
        )  # fmt: skip
        self._inner = QWidget()
        self._column = layouts.vbox(self._inner, self._nothing, 1, margins_px=(0, 0, 8, 0), spacing_px=tokens.GRID_PX)
        area = list_area(self._inner, framed=False)
        area.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        has_role(area, QAccessible.Role.List)
        area.setAccessibleName(tr("Active alarms"))
        area.viewport().setAutoFillBackground(False)
        self._inner.setAutoFillBackground(False)
        head = layouts.hbox(None, label(tr("Active alarms"), "heading"), 1, log, self.close_button("alarms_close"))
        layouts.vbox(self.card, head, (area, 1), margins_px=(20, 14, 12, 16), spacing_px=10)
        self.log_requested.connect(self.close_overlay)
        self._ages = QTimer(self, interval=1000)
        self._ages.timeout.connect(self._show_ages)
        console.state.alarms.changed.connect(self._on_alarms_changed)

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
        width = min(_ALARMS_PX, self.width() - 32) - 40
        inner = self._inner
        return _ALARMS_CHROME_PX + (
            inner.heightForWidth(width) if inner.hasHeightForWidth() else inner.sizeHint().height()
        )

    @property
    def rows(self) -> tuple["AlarmRow", ...]:
        return tuple(self._rows.values())

    def _on_alarms_changed(self, alarms: tuple[Alarm, ...]) -> None:
        if self.isVisible():
            self._show_rows(alarms)
            self._place()

    def _show_rows(self, alarms: tuple[Alarm, ...]) -> None:
        keys = [alarm.alarm_id for alarm in alarms]
        show_rows(self._column, self._rows, keys, lambda _key: AlarmRow(self._theme, self._console, self._inner))
        for alarm in alarms:
            self._rows[alarm.alarm_id].show_alarm(alarm)
        self._nothing.setVisible(not alarms)
        self._show_ages()
        self._column.activate()

    def _show_ages(self) -> None:
        for row in self._rows.values():
            row.show_age(self._console.state.present.now_ns())


class AlarmRow(QWidget):
    """One alarm."""

    accessible_role = QAccessible.Role.ListItem

    def __init__(self, theme: Theme, console: WizardConsole, parent: QWidget) -> None:
        super().__init__(parent)
        self._console = console
        self._alarm: Alarm | None = None
        self._icon = IconLabel(theme, size_px=22)
        self._age = label("", "fine", wraps=True)
        self._text = NotificationText(self._age)
        self._dismiss_button = ActionButton(
            theme, tr("Dismiss"), icon="check", height_px=30, objectName="alarm_seen_to",
            toolTip=tr("This alarm does not clear automatically"), clicked=self._on_seen_to,
        )  # fmt: skip
        parts = (self._icon, 0, layouts.TOP), (self._text, 1), (self._dismiss_button, 0, layouts.TOP)
        layouts.hbox(self, *parts, margins_px=(2, 4, 0, 8), spacing_px=10)

    def _on_seen_to(self) -> None:
        if self._alarm is not None:
            self._console.do(intents.DismissAlarm(self._alarm.alarm_id))

    def show_alarm(self, alarm: Alarm) -> None:
        self._alarm = alarm
        icon, tone, word = LOOKS[alarm.severity]
        self._icon.show_icon(icon, tone)
        what, *more = texts = _texts(alarm, alarm.times, alarm.why, alarm.folded[-_FOLDED_SHOWN:])
        self._text.show_texts(texts)
        self._dismiss_button.setVisible(not alarm.ends_by_itself)
        self._dismiss_button.setAccessibleName(tr("Dismiss: {problem}").format(problem=what))
        self.setAccessibleName(tr("{severity}: {what}").format(severity=tr(word), what=what))
        self.setAccessibleDescription(" ".join(text for text in more if text))

    def show_age(self, now_ns: int) -> None:
        alarm = self._alarm
        if alarm is not None:
            since = tr("For {time}").format(time=text_formatting.age(max(0.0, (now_ns - alarm.began_ns) / 1e9)))
            ends = tr("clears automatically") if alarm.ends_by_itself else tr("until you dismiss it")
            self._age.setText(f"{since} · {ends}")
