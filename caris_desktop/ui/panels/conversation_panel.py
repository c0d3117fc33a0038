"""Conversation panel: transcript, speakers, suggested replies, and the participant's waiting time."""

from bisect import bisect_right
from functools import partial

from PySide6.QtCore import QRectF, QSize, Qt, QTimer
from PySide6.QtGui import QFontMetricsF, QKeyEvent, QPainter, QPaintEvent, QPen, QResizeEvent
from PySide6.QtWidgets import QAbstractButton, QSizePolicy, QWidget

from caris_desktop.conversation.conversation_transcript import LATE_S, Turn, in_order, next_speaker, waiting
from caris_desktop.conversation.suggestions.suggestion_cycle import MOST_REPLIES
from caris_desktop.domain import intents
from caris_desktop.domain.events import AssistedFunction
from caris_desktop.domain.sound_values import PARTICIPANT_SOURCES, Hearing
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import DisplayedReply, LevelsStatus, PhotoEntry, ProposalStatus, SuggestionsStatus
from caris_desktop.scenario.scenario_model import levels_up_to
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.banners import Banner
from caris_desktop.ui.conversation.transcript_view import RowMaker, TranscriptView, found_in
from caris_desktop.ui.event_messages import FUNCTIONS, LEVELS
from caris_desktop.ui.focus_widget import focus_widget
from caris_desktop.ui.menus import add_choices
from caris_desktop.ui.panel import Panel, PanelContext
from caris_desktop.ui.people.shown_people import as_permitted, name_of
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.top_bar import as_menu
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.inputs import SubmitLineEdit
from caris_desktop.ui.widgets.labels import ElidedLabel, draw_key_cap, key_cap_width, label, named, restyle
from caris_desktop.ui.widgets.pictures import PhotoThumbnail, image_of

_ROW_PX, _LOW_ROW_PX = 40, 28
LOW_BELOW_PX = 300
"""Panel height below which suggestions are compact, so that the transcript stays visible."""
_COUNT_EVERY_MS = 100
_ROOMY_CARD_PX = 400


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
        self._from = ElidedLabel(role="small", objectName="suggestions_from")
        self._dismiss = ActionButton(
            context.theme, tr("Dismiss all"), role="ghost", height_px=24, text_px=tokens.STATUS_PX
        )
        self._dismiss.setObjectName("suggestions_dismiss")
        self._dismiss.bind(context.actions, "no_suggestion")
        foot = layouts.hbox(None, (self._from, 1), self._dismiss, spacing_px=tokens.GRID_PX)
        layouts.vbox(self, *self.cards, foot, margins_px=(0, 2, 0, 0), spacing_px=4)
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
            reply = by_rank.get(card.rank)
            name = partial(name_of, self._context.console)
            card.show_reply(reply, "" if reply is None else text_formatting.with_names(reply.text, name))
        self._count()
        counts = self._state.present.live and (status.says_ns is not None or status.filler_ns is not None)
        if counts and not self._counting.isActive():
            self._counting.start()
        elif not counts:
            self._counting.stop()

    def _count(self) -> None:
        """Update what depends on time alone: the line below the cards, and the first card's countdown."""
        status: SuggestionsStatus = self._state.suggestions.value
        now_ns = self._state.present.now_ns()
        self.cards[0].show_countdown(None if status.says_ns is None else max(0.0, (status.says_ns - now_ns) / 1e9))
        late = self._late(status, now_ns)
        text = late or self._made_from(status)
        self._from.setText(text)
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
        self.clicked.connect(lambda: self._table.press(f"suggestion_{rank}"))

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
        """Draw on one line, or on two where they fit; a longer text is elided."""
        font = self._theme.font(tokens.BODY_PX)
        metrics = QFontMetricsF(font)
        # A break between words costs a part of the first line.
        lines = 1.0 if room.height() < 2 * metrics.lineSpacing() else 1.8
        text = metrics.elidedText(self.text(), Qt.TextElideMode.ElideRight, lines * room.width())
        painter.setFont(font)
        painter.setPen(self._theme.color("text"))
        flags = Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft
        painter.drawText(room, int(flags) | int(Qt.TextFlag.TextWordWrap), text)


_EMPTY = QT_TR_NOOP("The conversation appears here.")
_TICK_MS = 100
_PHOTO_AFTER_NS = 2_000_000_000
_RECENT = 60
"""Number of newest turns that matter to the live display."""


def _turns(count: int) -> str:
    return tr("1 turn") if count == 1 else tr("%n turns", "", count)


class ConversationPanel(Panel):
    """Transcript, suggested replies below it, and a search field."""

    title = QT_TR_NOOP("Conversation")
    preferred_size, least_size = QSize(420, 300), QSize(240, 110)
    reads = ("permissions.assistant", "assisted")

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("conversation_panel")
        self._maker = RowMaker(self.state.present.anchor, with_tags=not context.discreet)
        self._names: dict[str, str] = {}
        self._ordered_from: tuple[Turn, ...] = ()
        self._ordered: list[Turn] = []
        self._under_way: dict[str, Hearing] = {}
        self._matches: list[int] = []
        self._match = -1
        self.view = TranscriptView(self.theme, may_change=self.state.present.live, empty=tr(_EMPTY))
        self.view.setObjectName("transcript")
        self.view.setMinimumHeight(1)  # a low panel is for what can be said next
        self._photo = PhotoThumbnail(self.theme, self.view)
        self.view.picked.connect(self._on_picked)
        self.view.action_requested.connect(self._on_action_requested)
        self.view.given.connect(self._on_given)
        self.hold.escape_pressed.connect(self.view.give_up_writing)
        self.hold.escape_pressed.connect(self.close_search)
        tip = tr("Search the transcript")
        self._find = ActionButton(self.theme, icon="magnifying-glass", height_px=30, toolTip=tip)
        self._find.setObjectName("transcript_find")
        self._find.bind(self.table, "find_said")
        self._search = _SearchLine(self)
        self._search.hide()
        # Autonomy levels apply to the language model only.
        levels = context.console.scenario.permissions.assistant and context.console.scenario.assisted
        self._title_widgets: list[QWidget] = [LevelsButton(context), self._find] if levels else [self._find]
        assisted = context.console.scenario.assisted
        self._could_follow: list[SuggestionCards | ProposalCard] = []
        if "replies" in assisted or "fillers" in assisted:
            self._could_follow.append(SuggestionCards(context, self))
        if "actions" in assisted:
            self._could_follow.append(ProposalCard(context, self))
        under_newest = layouts.vbox(None, *self._could_follow, margins_px=(14, 0, 14, 0), spacing_px=6)
        layouts.vbox(self, self._search, (self.view, 1_000), under_newest, 1, margins_px=(1, 6, 1, 8), spacing_px=4)
        self.watch(self._refresh, self.state.transcript.changed, self.state.stream("hearing").changed)
        self.watch(self._on_persons_changed, self.state.persons.changed, self.state.everybody.changed)
        self.state.time_jumped.connect(self._on_time_jumped)
        self.every(_TICK_MS, self._tick)
        self.update_view()

    def title_widgets(self) -> list[QWidget]:
        return self._title_widgets

    def focus_target(self) -> QWidget:
        return self.view

    def accessible_parts(self) -> list[QWidget]:
        return self.view.parts()

    def fit(self) -> None:
        for widget in self._could_follow:
            widget.fit(self.height())

    # ---- display

    def update_view(self) -> None:
        self._take_names()
        self._refresh()
        self._tick()

    def show_scenario(self) -> None:
        self._on_persons_changed(None)

    def _on_persons_changed(self, _persons: object) -> None:
        if self.in_view and self._take_names():
            self._refresh()

    def _take_names(self) -> bool:
        """Update the names; returns whether any changed."""
        naming = self.console.scenario.permissions.naming_people
        persons = as_permitted((*self.state.everybody.value, *self.state.persons.value), naming=naming)
        names = {person.person_id: text_formatting.person_name(person) for person in persons if person.person_id}
        changed = names != self._names
        self._names = names
        return changed

    def _heard(self) -> dict[str, Hearing]:
        """Partial results of current turns by utterance id, without the robot's own speech, which has its transcript
        already.
        """
        now_ns = self.state.present.now_ns()
        newest = (self.state.hearing_of(source).value for source in PARTICIPANT_SOURCES)
        hearings = {
            hearing.utterance_id: hearing
            for hearing in newest
            if hearing is not None and hearing.utterance_id and hearing.speaker != "robot"
        }
        over = {turn.utterance_id for turn in self._turns_until(now_ns) if turn.ended_ns and turn.ended_ns <= now_ns}
        return {turn_id: hearing for turn_id, hearing in hearings.items() if turn_id not in over}

    def _turns_until(self, now_ns: int) -> list[Turn]:
        """Newest turns that had begun by then; a replay has later ones."""
        turns = self._turns()
        until = bisect_right(turns, now_ns, key=lambda turn: turn.begins_ns)
        return turns[max(0, until - _RECENT) : until]

    def _turns(self) -> list[Turn]:
        """Turns sorted by start; cached per transcript."""
        if self.state.transcript.value is not self._ordered_from:
            self._ordered_from = self.state.transcript.value
            self._ordered = in_order(self._ordered_from)
        return self._ordered

    def _refresh(self, _value: object = None) -> None:
        if not self.in_view:
            return
        self._under_way = self._heard()
        self.view.show_rows(self._maker.rows(self._turns(), self._names, self._under_way))
        self._find.set_quiet(not self.view.rows)
        if self._search.isVisible():
            self._check_again()
        self._tick()

    def _on_time_jumped(self, _events: object) -> None:
        self._refresh()
        self.view.follow()

    def _tick(self) -> None:
        now_ns = self.state.present.now_ns()
        if not self.state.present.live:
            if self._under_way != self._heard():  # the turn ended without an event
                self._refresh()
            self.view.show_now(bisect_right(self.view.rows, now_ns, key=lambda row: row.begins_ns) - 1)
        self._report_waiting(now_ns)

    def _report_waiting(self, now_ns: int) -> None:
        stands = waiting(self._turns_until(now_ns), self._under_way.values(), now_ns)
        if stands is None:
            count = len(self.view.rows)
            turns = _turns(count) if count else ""
            if not self.state.present.live:
                self.set_fact(turns)
            elif self.state.microphone.value.state == "on":
                self.set_fact(tr("listening"), "green", rest=turns)
            else:
                self.set_fact(tr("not listening"), rest=turns)
            return
        name = self._names.get(stands.person_id, "")
        assistance = self.console.scenario.assistance
        late_s = LATE_S if assistance.fillers == "off" else assistance.filler_after_s
        match stands.state:
            case "talking":
                named = tr("{name} is talking").format(name=f"{name[:1].upper()}{name[1:]}")
                self.set_fact(named if name else tr("The participant is talking"), "green")
            case "waiting":
                role = "amber" if stands.seconds > late_s else "green"
                rest = tr("since {name} stopped talking").format(name=name)
                rest = rest if name else tr("since the participant stopped talking")
                self.set_fact(text_formatting.age(max(0.1, stands.seconds)), role, rest=rest)
            case "answered":
                late = stands.seconds > late_s
                if stands.seconds < 0:
                    rest = tr("before {name} finished").format(name=name)
                    rest = rest if name else tr("before the participant finished")
                    self.set_fact(f"{-stands.seconds:.1f} s", "amber", rest=rest)
                else:
                    self.set_fact(f"{stands.seconds:.1f} s", "amber" if late else "dim", rest=tr("until the answer"))

    # ---- search

    def open_search(self) -> None:
        """Show and focus the search field."""
        self._search.show()
        focus_widget(self._search.field)
        self._search.field.selectAll()
        self._check_again()

    def close_search(self) -> None:
        if self._search.isVisible():
            had_focus = self._search.field.hasFocus()
            self._search.hide()
            self.view.show_found((), "")
            self._matches, self._match = [], -1
            if had_focus:
                self.view.setFocus(Qt.FocusReason.OtherFocusReason)

    def search(self, query: str) -> None:
        """Search the transcript and go to the newest match."""
        self._matches, self._match = found_in(self.view.rows, query), -1
        self.view.show_found(self._matches, query)
        self.go_to_match(-1)

    def _check_again(self) -> None:
        query = self._search.field.text()
        self._matches = found_in(self.view.rows, query)
        self._match = min(self._match, len(self._matches) - 1)
        self.view.show_found(self._matches, query)
        self._search.show_count(self._match, len(self._matches), query)

    def go_to_match(self, step: int) -> None:
        """Go to the next or previous match."""
        if self._matches:
            self._match = (self._match + step) % len(self._matches) if self._match >= 0 else len(self._matches) - 1
            self.view.show_turn(self._matches[self._match])
        self._search.show_count(self._match, len(self._matches), self._search.field.text())

    # ---- commands

    def _turn(self, utterance_id: str) -> Turn | None:
        return next((turn for turn in reversed(self._turns()) if turn.utterance_id == utterance_id), None)

    def _on_picked(self, utterance_id: str) -> None:
        turn = self._turn(utterance_id)
        if turn is None:
            return
        if not self.state.present.live:
            self.moment_requested.emit(turn.begins_ns)
            return
        photo = self._photo_of(turn)
        if photo is None:
            self._photo.hide()
        else:
            self._photo.show_photo(image_of(photo.thumbnail_jpeg), tr("Photo of this moment"), photo.file_name)

    def _photo_of(self, turn: Turn) -> PhotoEntry | None:
        """First photo taken during the turn or right after it."""
        from_ns = self.state.present.anchor.utc_ns_at(turn.begins_ns)
        lasted_ns = (turn.ended_ns or self.state.present.now_ns()) - turn.begins_ns
        photos: tuple[PhotoEntry, ...] = self.state.photos.value
        taken = (photo for photo in photos[::-1] if 0 <= photo.utc_ns - from_ns <= lasted_ns + _PHOTO_AFTER_NS)
        return next((photo for photo in taken if photo.thumbnail_jpeg and not photo.deleted), None)

    def _on_action_requested(self, act: str, utterance_id: str) -> None:
        turn = self._turn(utterance_id)
        if turn is None:
            return
        if act == "who":
            speaker, person_id = next_speaker(
                turn, [person.person_id for person in self.state.persons.value if person.here]
            )
            self.console.do(intents.CorrectUtterance(utterance_id, speaker=speaker, person_id=person_id))
        else:
            earlier_s = max(0.0, (self.state.present.now_ns() - turn.begins_ns) / 1e9)
            self.console.do(intents.Mark("", earlier_s=min(86_400.0, earlier_s)))

    def _on_given(self, act: str, utterance_id: str, text: str) -> None:
        if act == "text":
            self.console.do(intents.CorrectUtterance(utterance_id, text=text))
        else:
            tags = tuple(dict.fromkeys(tag for part in text.split(",") if (tag := part.strip())))
            self.console.do(intents.CorrectUtterance(utterance_id, tags=tags))


class _SearchLine(QWidget):
    """Search field with match count. Enter goes to the previous match, with Shift to the next."""

    def __init__(self, panel: ConversationPanel) -> None:
        super().__init__()
        self._panel = panel
        self.field = named(_SearchField(panel), "transcript_search", tr("Search the transcript"))
        self.field.setPlaceholderText(tr("Search the transcript"))
        self.field.textChanged.connect(panel.search)
        self._found = label("", "note", objectName="transcript_found")
        close = ActionButton(panel.theme, "", icon="x", height_px=30, accessibleName=tr("Close the search"))
        close.clicked.connect(panel.close_search)
        layouts.hbox(self, (self.field, 1), self._found, close, margins_px=(14, 2, 8, 2), spacing_px=8)

    def show_count(self, match: int, count: int, query: str) -> None:
        if not query.strip():
            self._found.setText("")
        else:
            place = tr("{number} of {count}").format(number=match + 1, count=count)
            self._found.setText(place if count and match >= 0 else _turns(count))


class _SearchField(SubmitLineEdit):
    def __init__(self, panel: ConversationPanel) -> None:
        super().__init__()
        self._panel = panel

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter, Qt.Key.Key_Up):
            self._panel.go_to_match(1 if event.modifiers() & Qt.KeyboardModifier.ShiftModifier else -1)
        elif event.key() == Qt.Key.Key_Down:
            self._panel.go_to_match(1)
        else:
            super().keyPressEvent(event)


class LevelsButton(ActionButton):
    """Autonomy levels of the language model: display, and change up to the scenario's limit.

    Button with a menu section per function; amber while any function acts without confirmation.
    """

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context.theme, icon="sliders-horizontal", role="ghost", height_px=30)
        self.setObjectName("levels_button")
        self._context = context
        self._state = context.console.state
        self._menu = as_menu(context.theme, self, "levels_menu")
        self._menu.aboutToShow.connect(self.fill)
        self.clicked.connect(lambda: self._menu.popup(self.mapToGlobal(self.rect().bottomLeft())))
        self._state.levels.changed.connect(self._refresh)
        self._refresh()

    def _refresh(self, _levels: object = None) -> None:
        levels: LevelsStatus = self._state.levels.value
        acting = any(getattr(levels, function) == "act" for function in FUNCTIONS)
        self.set_label(tr("Automatic") if acting else "", role="amber" if acting else "ghost")
        self.set_quiet(not acting)
        lines = [f"{tr(FUNCTIONS[each])}: {tr(LEVELS[getattr(levels, each)])}" for each in self._assisted]
        self.setToolTip("\n".join((tr("Assistance levels"), *lines)))
        self.setAccessibleName(tr("Assistance levels"))
        self.setEnabled(self._state.present.live)

    @property
    def _assisted(self) -> tuple[AssistedFunction, ...]:
        return self._context.console.scenario.assisted

    def fill(self) -> None:
        """Fill the menu with the levels that the scenario permits."""
        self._menu.clear()
        for function in self._assisted:
            self._menu.addSection(tr(FUNCTIONS[function]))
            levels = levels_up_to(self._context.console.scenario.highest_level(function))
            now = getattr(self._state.levels.value, function)
            uses = [partial(self._context.console.do, intents.SetLevel(function, level)) for level in levels]
            choices = [(tr(LEVELS[level]), level == now, use) for level, use in zip(levels, uses, strict=True)]
            add_choices(self._menu, choices)


class ProposalCard(Banner):
    """Proposed action of the language model, with the keys that confirm and reject it.

    Visible while an action is proposed. Shows the keys only while they apply: a question about a person takes
    precedence.
    """

    def __init__(self, context: PanelContext, parent: QWidget) -> None:
        super().__init__(context.theme, "proposal_card", role="amber", text=ElidedLabel(role="medium"))
        self.setParent(parent)
        self._context = context
        self._state = context.console.state
        self.yes = ActionButton(context.theme, tr("Do it"), role="primary", height_px=32, objectName="proposal_yes")
        self.yes.clicked.connect(lambda: self._answer(intents.ConfirmProposal))
        self.no = ActionButton(context.theme, tr("No"), height_px=32, objectName="proposal_no")
        self.no.clicked.connect(lambda: self._answer(intents.VetoProposal))
        layouts.fill(self.row, self.yes, self.no)
        self._counting = QTimer(self, interval=_COUNT_EVERY_MS)
        self._counting.timeout.connect(self._count)
        for value in (self._state.proposal, self._state.asked_person):
            value.changed.connect(self._refresh)
        for changed in (context.actions.keys_changed, context.actions.rebuilt):
            changed.connect(self._refresh)
        self._refresh()

    def fit(self, panel_px: int) -> None:
        """Adapt to the panel's height."""
        low = panel_px < LOW_BELOW_PX
        self.setFixedHeight(34 if low else 44)
        for button in (self.yes, self.no):
            button.set_size(height_px=26 if low else 32, text_px=tokens.STATUS_PX if low else tokens.BODY_PX)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        for button in (self.yes, self.no):  # the question is worth more than the key caps
            button.set_key_shown(self.width() >= _ROOMY_CARD_PX)

    def _answer(self, answer: type[intents.ConfirmProposal] | type[intents.VetoProposal]) -> None:
        proposal: ProposalStatus = self._state.proposal.value
        if proposal.proposal_id:
            self._context.console.do(answer(proposal.proposal_id))

    def _refresh(self, _value: object = None) -> None:
        proposal: ProposalStatus = self._state.proposal.value
        permissions, live = self._context.console.scenario.permissions, self._state.present.live
        stands = bool(proposal.proposal_id)
        person_first = self._state.asked_person.value is not None and permissions.naming_people
        table = self._context.actions
        self.yes.set_key("" if person_first else table.key_text("answer_yes"))
        self.no.set_key("" if person_first else table.key_text("answer_no"))
        for button in (self.yes, self.no):
            button.setEnabled(live)
        self.setVisible(stands)
        self._count()
        if stands and live and not self._counting.isActive():
            self._counting.start()
        elif not stands or not live:
            self._counting.stop()

    def _count(self) -> None:
        proposal: ProposalStatus = self._state.proposal.value
        now_ns = self._state.present.now_ns()
        waits_s = max(0, proposal.lapses_ns - now_ns) / 1e9
        if proposal.acts_ns is not None and self._state.present.live:
            acts_s = max(0, proposal.acts_ns - now_ns) / 1e9
            self.say(tr("{what}: starts in {time:.1f} s").format(what=tr(proposal.words), time=acts_s))
        elif self._state.present.live:
            lapses = tr("{what}? · proposed by {model}, expires in {time:.0f} s")
            self.say(lapses.format(what=tr(proposal.words), model=proposal.model, time=waits_s))
        else:
            self.say(tr("{what}? · proposed by {model}").format(what=tr(proposal.words), model=proposal.model))
        self.setToolTip(tr("This moves the robot.") if proposal.moves else "")
