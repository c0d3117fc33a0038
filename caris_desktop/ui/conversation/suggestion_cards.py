"""Suggested replies below the newest turn, each with its key at a fixed position."""

from PySide6.QtCore import QRectF, Qt, QTimer
from PySide6.QtGui import QFontMetricsF, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QAbstractButton, QSizePolicy, QWidget

from caris_desktop.conversation.suggestions.suggestion_cycle import MOST_REPLIES
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import DisplayedReply, SuggestionsStatus
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.panel import PanelContext
from caris_desktop.ui.people.shown_people import name_of
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.labels import draw_key_cap, key_cap_width, label, restyle

_ROW_PX, _LOW_ROW_PX = 40, 28
LOW_BELOW_PX = 300
"""Panel height below which suggestions are compact, so that the transcript stays visible."""
_COUNT_EVERY_MS = 100


class SuggestionCards(QWidget):
    """Up to three replies. Their space is reserved when they are requested, so that none moves once shown. A click says
    one, as its key does.
    """

    def __init__(self, context: PanelContext, parent: QWidget) -> None:
        super().__init__(parent)
        self.setObjectName("suggestion_cards")
        self._context = context
        self._state = context.console.state
        self.cards = [_Card(context, rank) for rank in range(1, MOST_REPLIES + 1)]
        self._from = label("", "small", objectName="suggestions_from")
        self._from.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        self._dismiss = ActionButton(
            context.theme, tr("Dismiss all"), role="ghost", height_px=24, text_px=tokens.STATUS_PX
        )
        self._dismiss.setObjectName("suggestions_dismiss")
        self._dismiss.bind(context.actions, "no_suggestion")
        foot = layouts.hbox(None, (self._from, 1), self._dismiss, spacing_px=tokens.GRID_PX)
        column = layouts.vbox(self, margins_px=(0, 2, 0, 0), spacing_px=4)
        for card in self.cards:
            column.addWidget(card)
        column.addLayout(foot)
        self._low = False
        self._counting = QTimer(self, interval=_COUNT_EVERY_MS)
        self._counting.timeout.connect(self._count)
        self._state.suggestions.changed.connect(self._refresh)
        self._state.levels.changed.connect(self._refresh)
        context.actions.keys_changed.connect(self._refresh)
        self._refresh()

    def fit(self, panel_px: int) -> None:
        """Adapt to the panel's height."""
        self._low = panel_px < LOW_BELOW_PX
        for card in self.cards:
            card.setFixedHeight(_LOW_ROW_PX if self._low else _ROW_PX)
        self._count()

    def _refresh(self, _value: object = None) -> None:
        status: SuggestionsStatus = self._state.suggestions.value
        replies = status.state in ("asking", "shown")
        by_rank = {card.rank: card for card in status.cards}
        for card in self.cards:
            card.setVisible(replies)
            card.show_reply(by_rank.get(card.rank), self._shown(by_rank.get(card.rank)))
        self._count()
        counts = self._state.present.live and (status.says_ns is not None or status.filler_ns is not None)
        if counts and not self._counting.isActive():
            self._counting.start()
        elif not counts:
            self._counting.stop()

    def _shown(self, card: DisplayedReply | None) -> str:
        console = self._context.console
        return (
            "" if card is None else text_formatting.with_names(card.text, lambda person_id: name_of(console, person_id))
        )

    def _count(self) -> None:
        """Update what depends on time alone: the line below the cards, and the first card's countdown."""
        status: SuggestionsStatus = self._state.suggestions.value
        now_ns = self._state.present.now_ns()
        self.cards[0].show_countdown(None if status.says_ns is None else max(0.0, (status.says_ns - now_ns) / 1e9))
        late = self._late(status, now_ns)
        text = late or self._made_from(status)
        self._from.setText(text)
        self._from.setToolTip(text)
        restyle(self._from, tone="amber" if late or status.state == "failed" else "dim")
        self._from.setVisible(bool(text) and (not self._low or bool(late) or status.state == "failed"))
        dismissable = bool(status.cards) or (bool(late) and self._state.levels.value.fillers == "act")
        self._dismiss.setVisible(dismissable and not self._low)
        self.setVisible(bool(text) or status.state in ("asking", "shown"))

    def _late(self, status: SuggestionsStatus, now_ns: int) -> str:
        """Text while no reply has arrived: the filler that follows."""
        filler = self._context.console.scenario.next_filler(self._state.fillers_spoken.value)
        if status.filler_ns is None or not filler or not self._state.present.live:
            return ""
        wait_s = (status.filler_ns - now_ns) / 1e9
        if self._state.levels.value.fillers == "act":
            template = tr("“{filler}” will be said in {time:.1f} s")
            return template.format(filler=text_formatting.shortened(filler, 30), time=max(0.0, wait_s))
        key = self._context.actions.key_text("filler")
        late = tr("The reply is late: press {key} to say “{filler}”").format(
            key=key, filler=text_formatting.shortened(filler, 30)
        )
        return late if wait_s <= 0 else ""

    def _made_from(self, status: SuggestionsStatus) -> str:
        if status.state == "failed":
            return tr("No suggestions: {detail}").format(detail=tr(status.detail))
        if status.state not in ("asking", "shown"):
            return ""
        turns = tr("the last turn") if status.turns <= 1 else tr("the last %n turns", "", status.turns)
        who = name_of(self._context.console, status.person_id) if status.person_id else ""
        grounds = ", ".join(filter(None, (turns, status.doing, status.place, who)))
        if status.state == "asking":
            return tr("{model} is writing suggestions based on {grounds}").format(model=status.model, grounds=grounds)
        edit = self._context.actions.key_text("edit_suggestion_1")
        # The key comes first, because the end is cut off where room is short.
        parts = [tr("{key} edit first").format(key=edit)] if edit else []
        parts.append(tr("Suggested by {model}, based on {grounds}").format(model=status.model, grounds=grounds))
        return " · ".join(parts)


class _Card(QAbstractButton):
    """Card of constant height for one reply or none."""

    def __init__(self, context: PanelContext, rank: int) -> None:
        super().__init__()
        self.setObjectName(f"suggestion_{rank}")
        self.rank = rank
        self._theme: Theme = context.theme
        self._table = context.actions
        self._countdown = ""
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setFixedHeight(_ROW_PX)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)
        self.clicked.connect(lambda: self._table.run(f"suggestion_{rank}"))

    def show_reply(self, card: DisplayedReply | None, text: str) -> None:
        self.setText(text)
        self.setAccessibleName(
            tr("Say suggestion {number}: {text}").format(number=self.rank, text=text) if text else ""
        )
        self.setToolTip(text)
        self.setEnabled(card is not None and self._table.spec(f"suggestion_{self.rank}") is not None)
        self.update()

    def show_countdown(self, left_s: float | None) -> None:
        countdown = "" if left_s is None else tr("said in {time:.1f} s").format(time=left_s)
        if countdown != self._countdown:
            self._countdown = countdown
            self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme, rect = self._theme, QRectF(self.rect()).adjusted(0.5, 0.5, -0.5, -0.5)
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        stands = bool(self.text())
        painter.setPen(QPen(theme.color("blue" if stands else "line"), 1))
        painter.setBrush(theme.color("blue_soft") if stands else Qt.BrushStyle.NoBrush)
        painter.drawRoundedRect(rect, tokens.CONTROL_RADIUS_PX, tokens.CONTROL_RADIUS_PX)
        if self.underMouse() and stands and self.isEnabled():
            painter.setPen(QPen(theme.color("blue"), 2))
            painter.drawRoundedRect(
                rect.adjusted(1, 1, -1, -1), tokens.CONTROL_RADIUS_PX - 1, tokens.CONTROL_RADIUS_PX - 1
            )
        key = self._table.key_text(f"suggestion_{self.rank}")
        if not stands:
            painter.setOpacity(0.45)
        draw_key_cap(painter, theme, key, 12, self.height() / 2)
        left = 12 + key_cap_width(theme, key) + (10 if key else 0)
        right = self.width() - 12.0
        if self._countdown and stands:
            font = theme.font(tokens.STATUS_PX, tokens.WEIGHT_SEMIBOLD)
            width = QFontMetricsF(font).horizontalAdvance(tr("said in {time:.1f} s").replace("{time:.1f}", "00.0"))
            painter.setFont(font)
            painter.setPen(theme.color("amber"))
            align = Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignRight
            painter.drawText(QRectF(right - width, 0, width, self.height()), int(align), self._countdown)
            right -= width + 10
        self._draw_text(painter, QRectF(left, 0, max(0.0, right - left), self.height()))

    def _draw_text(self, painter: QPainter, room: QRectF) -> None:
        """Draw on one line if it fits, else smaller, and on two lines if there is room."""
        font, text = self._theme.font(tokens.BODY_PX), self.text()
        if QFontMetricsF(font).horizontalAdvance(text) > room.width():
            font = self._theme.font(tokens.STATUS_PX)
            metrics = QFontMetricsF(font)
            if room.height() < 2 * metrics.lineSpacing():
                text = metrics.elidedText(text, Qt.TextElideMode.ElideRight, room.width())
        painter.setFont(font)
        painter.setPen(self._theme.color("text"))
        flags = Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft
        painter.drawText(room, int(flags) | int(Qt.TextFlag.TextWordWrap), text)
