"""Problems as cards in a corner: what happened, what it means, what to do. Never a box in the way."""

from PySide6.QtCore import QEvent, QObject, QPoint, QRectF, Qt, QTimer, Signal
from PySide6.QtGui import QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QHBoxLayout, QLabel, QVBoxLayout, QWidget

from caris_desktop.domain.events import Problem, ProblemEnd
from caris_desktop.live.state import LiveState
from caris_desktop.ui import tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton

SHOWN_AT_ONCE = 3
WIDTH_PX = 400
_GOES_AWAY_AFTER_MS = {"info": 8_000, "warning": 20_000}
_LOOKS = {
    "info": ("info", "blue", "Note"),
    "warning": ("warning", "amber", "Problem"),
    "error": ("warning-octagon", "red", "Serious problem"),
}


def endings(state: LiveState) -> frozenset[ProblemEnd]:
    """What is so now, of all that can end a problem."""
    now: dict[ProblemEnd, bool] = {
        "connected": state.link.value.state == "connected",
        "released": not state.drive.value.emergency_stop,
        "picture": state.frame.freshness == "fresh",
        # From its start on: what goes wrong while it begins is about it. Going on after a pause is the same recording.
        "recording": state.recording.value.state in ("starting", "recording", "paused"),
        "voice": state.speech.value.ready and not state.speech.value.detail,
        "assistant": state.assistant.value.state in ("ready", "answering"),
        "people": state.perception.value.state == "ready",
        "microphone": state.microphone.value.state == "on",
    }
    return frozenset(end for end, true in now.items() if true)


class ProblemCards(QWidget):
    """The newest few problems over the lower right of the dock area.

    Errors stay until they are dismissed; any problem goes away once ``state`` shows that it is over.
    """

    def __init__(self, theme: Theme, over: QWidget, state: LiveState) -> None:
        super().__init__(over)
        self.setObjectName("problem_cards")
        self._theme = theme
        self._over = over
        self._cards: list[ProblemCard] = []
        self._column = QVBoxLayout(self)
        self._column.setContentsMargins(0, 0, 0, 0)
        self._column.setSpacing(tokens.GRID_PX)
        over.installEventFilter(self)
        self._state = state
        self._past = endings(state)
        for value in (
            state.link,
            state.drive,
            state.recording,
            state.speech,
            state.assistant,
            state.perception,
            state.microphone,
        ):
            value.changed.connect(self._on_state_changed)
        state.frame.freshness_changed.connect(self._on_state_changed)
        self.hide()

    @property
    def cards(self) -> tuple["ProblemCard", ...]:
        return tuple(self._cards)

    def show_problem(self, problem: Problem) -> None:
        """Add it, or renew the card that says the same."""
        known = next((card for card in self._cards if card.problem.what == problem.what), None)
        if known is not None:
            known.show_problem(problem, again=True)
        else:
            card = ProblemCard(self._theme, problem)
            card.dismissed.connect(self._dismiss)
            card.start_going_away()
            self._cards.append(card)
            self._column.addWidget(card)
            card.show()
            if len(self._cards) > SHOWN_AT_ONCE:
                self._dismiss(self._cards[0])
        self._place()

    def _on_state_changed(self, _value: object) -> None:
        """What has come to be so since the last look ends the problems that waited for it."""
        present = endings(self._state)
        begun, self._past = present - self._past, present
        for card in [card for card in self._cards if card.problem.until in begun]:
            self._dismiss(card)

    def _dismiss(self, card: "ProblemCard") -> None:
        if card in self._cards:
            self._cards.remove(card)
            self._column.removeWidget(card)
            card.hide()
            card.deleteLater()
            self._place()

    def _place(self) -> None:
        self.setVisible(bool(self._cards))
        width = min(WIDTH_PX, self._over.width() - 32)
        self.setFixedWidth(max(200, width))
        height = (
            self._column.heightForWidth(self.width()) if self._column.hasHeightForWidth() else self.sizeHint().height()
        )
        self.resize(self.width(), height)
        self._column.activate()
        self.move(QPoint(self._over.width() - self.width() - 20, self._over.height() - height - 20))
        self.raise_()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if watched is self._over and event.type() == QEvent.Type.Resize and self._cards:
            self._place()
        return False


class ProblemCard(QWidget):
    """One problem."""

    dismissed = Signal(object)  # the card itself

    def __init__(self, theme: Theme, problem: Problem) -> None:
        super().__init__()
        self.problem = problem
        self._theme = theme
        self._count = 1
        self._what = QLabel()
        self._meaning = QLabel()
        self._advice = QLabel()
        for label in (self._what, self._meaning, self._advice):
            label.setWordWrap(True)
            label.setTextFormat(Qt.TextFormat.PlainText)
            label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        close = ActionButton(theme, "", icon="x", look="ghost", height_px=28)
        close.setObjectName("problem_dismiss")
        close.setAccessibleName("Dismiss")
        close.clicked.connect(lambda: self.dismissed.emit(self))
        column = QVBoxLayout()
        column.setSpacing(3)
        column.addWidget(self._what)
        column.addWidget(self._meaning)
        column.addWidget(self._advice)
        row = QHBoxLayout(self)
        row.setContentsMargins(48, 12, 8, 14)
        row.addLayout(column, 1)
        row.addWidget(close, 0, Qt.AlignmentFlag.AlignTop)
        self._timer = QTimer(self, singleShot=True)
        self._timer.timeout.connect(lambda: self.dismissed.emit(self))
        theme.changed.connect(self._style)
        self._style()

    def show_problem(self, problem: Problem, *, again: bool = False) -> None:
        self.problem = problem
        self._count += again
        self._style()
        self.start_going_away()

    def start_going_away(self) -> None:
        after_ms = _GOES_AWAY_AFTER_MS.get(self.problem.severity)
        if after_ms is not None:
            self._timer.start(after_ms)
        else:
            self._timer.stop()

    def _style(self) -> None:
        _, _, word = _LOOKS[self.problem.severity]
        times = f" ({self._count} times)" if self._count > 1 else ""
        self._what.setText(f"{self.problem.what}{times}")
        self._meaning.setText(self.problem.meaning)
        self._advice.setText(self.problem.advice)
        self._meaning.setVisible(bool(self.problem.meaning))
        self._advice.setVisible(bool(self.problem.advice))
        self.setAccessibleName(f"{word}: {self.problem.what}. {self.problem.meaning} {self.problem.advice}")
        self._what.setFont(self._theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD))
        for label, role in ((self._what, "text"), (self._meaning, "dim"), (self._advice, "text")):
            self._theme.color_text(label, role)
        for label in (self._meaning, self._advice):
            label.setFont(self._theme.font(tokens.STATUS_PX + 1))
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        icon, role, _ = _LOOKS[self.problem.severity]
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(QPen(self._theme.color(role), 1.2))
        painter.setBrush(self._theme.color("panel"))
        painter.drawRoundedRect(
            QRectF(self.rect()).adjusted(1, 1, -1, -1), tokens.PANEL_RADIUS_PX, tokens.PANEL_RADIUS_PX
        )
        draw_icon(painter, QRectF(14, 13, 22, 22), icon, self._theme.color(role))
