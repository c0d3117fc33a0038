"""Person popup: identity, notes, consents and history of one person, merging and erasing.

Part of the main window, not a separate window: driving continues, and Esc still stops the robot.
"""

from collections.abc import Callable, Collection, Sequence
from datetime import datetime
from functools import partial
from typing import Any, Literal, NamedTuple, get_args

from PySide6.QtCore import QPoint, QRect, QSignalBlocker, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QFocusEvent, QMouseEvent, QStandardItem, QStandardItemModel
from PySide6.QtWidgets import (
    QCompleter,
    QGridLayout,
    QHeaderView,
    QLabel,
    QLineEdit,
    QPlainTextEdit,
    QStackedWidget,
    QVBoxLayout,
    QWidget,
)

from caris_desktop.domain import intents
from caris_desktop.domain.events import ConsentKind
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import PersonHistory
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.people.people_store import HistoryEntry
from caris_desktop.people.presence import PersonRow
from caris_desktop.ui import event_messages, layouts, text_formatting, tokens
from caris_desktop.ui.panel import show_part
from caris_desktop.ui.people.portraits import PortraitPixmaps, PortraitView
from caris_desktop.ui.people.shown_people import found, in_order, is_identified, what_is_seen
from caris_desktop.ui.theme import Theme, icon
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import FlowRow, Scrolled
from caris_desktop.ui.widgets.inputs import CheckBox, SubmitLineEdit, add_clear_button
from caris_desktop.ui.widgets.labels import ElidedLabel, label, named
from caris_desktop.ui.widgets.popups import FloatingCard
from caris_desktop.ui.widgets.rows import FastTableView

WIDTH_PX = 400
_BELOW_TOP_BAR_PX = 62
_ABOVE_STATUS_BAR_PX = 38
_PORTRAIT_PX = 56
_COMPARED_PORTRAIT_PX = 120
_OFFERED = 8
_SEARCH_AFTER_MS = 250
_HISTORY_ROWS = 6
_HISTORY_ROW_PX = 26
_MOST_SUGGESTED = 2
_ICONS = {"visit": "user", "said": "robot", "heard": "chat-text", "photo": "camera", "note": "note-pencil"}

PageName = Literal["about", "merge", "forget"]


class PersonCard(FloatingCard):
    """Person popup. ``everyone`` returns candidates for a merger."""

    def __init__(
        self,
        theme: Theme,
        window: QWidget,
        console: WizardConsole,
        portraits: PortraitPixmaps,
        everyone: Callable[[], Sequence[PersonRow]],
    ) -> None:
        super().__init__(theme, window)
        self.setObjectName("person_card")
        self.theme = theme
        self.console = console
        self.portraits = portraits
        self.everyone = everyone
        self.person: PersonRow | None = None
        self._beside = QRect()
        self._dragged: QPoint | None = None
        self._face = PortraitView(theme, portraits, _PORTRAIT_PX)
        self._name = ElidedLabel(objectName="person_card_name")
        self._last_seen = ElidedLabel(role="note", objectName="person_card_seen")
        close = ActionButton(theme, "", icon="x", role="ghost", height_px=30, objectName="person_card_close")
        close.setAccessibleName(tr("Close the card"))
        close.clicked.connect(self.close_card)
        self.about, self._merge, self._forget = AboutPage(self), MergePage(self), ForgetPage(self)
        self._pages = QStackedWidget()
        for page in (self.about, self._merge, self._forget):
            self._pages.addWidget(Scrolled(page))
        texts = layouts.vbox(None, 1, self._name, self._last_seen, 1, spacing_px=2)
        head = layouts.hbox(None, self._face, (texts, 1), margins_px=(14, 0, 8, 0), spacing_px=12)
        head.addWidget(close, 0, Qt.AlignmentFlag.AlignTop)
        layouts.vbox(self, head, (self._pages, 1), margins_px=(1, 12, 1, 10), spacing_px=8)
        self.follow_parent()

    # ---- person

    @property
    def person_id(self) -> str:
        """Person of the open popup; empty if closed."""
        return "" if self.isHidden() or self.person is None else self.person.person_id

    @property
    def page(self) -> PageName:
        names: tuple[PageName, ...] = get_args(PageName)
        return names[self._pages.currentIndex()]

    def open_for(self, person: PersonRow, beside: QRect) -> None:
        """Open next to the list at ``beside``, in window coordinates. Opening by click does not take the focus from
        driving.
        """
        self.person = None
        self._beside = beside
        self.show()
        self.show_person(person)
        self.show_page("about")
        self.raise_()

    def show_person(self, person: PersonRow) -> None:
        """Refresh the person, or switch to another one."""
        newly = self.person is None or self.person.person_id != person.person_id
        if newly:
            self.about.discard()
            self.about.show_history((), "")
        self.person = person
        self._face.show_person(person)
        self._name.setText(text_formatting.person_name(person))
        self._last_seen.setText(" · ".join(what_is_seen(person, self.console.state.present.now_ns())))
        self.about.show_person(person)
        if newly:
            self.about.request_history()
        if self.page == "merge":
            self._merge.refresh()

    def show_history(self, history: PersonHistory) -> None:
        self.about.show_history(history.entries, history.text)
        self._place()

    def show_page(self, name: PageName) -> None:
        if self.person is None:
            return
        if name == "merge":
            self._merge.begin()
        elif name == "forget":
            self._forget.begin_with(self.person)
        self._pages.setCurrentIndex(get_args(PageName).index(name))
        self._place()

    def decide(self, intent: Intent, stays: str = "") -> None:
        """Send a decision. Close the popup if its person no longer exists; after a merger show the remaining one."""
        self.console.do(intent)
        left = next((person for person in self.everyone() if person.person_id == stays), None)
        if left is None:
            self.close_card()
        else:
            self.show_person(left)
            self.show_page("about")

    def step_back(self) -> None:
        """Esc: leave a question page first, then close. Unfinished input is discarded."""
        if self.isHidden():
            return
        if self.page != "about":
            self.show_page("about")
        else:
            self.about.discard()
            self.close_card()

    # ---- placement and style

    def _move_to(self, at: QPoint, size: QSize, *, seen_px: int | None = None) -> None:
        """Place the popup between the bars of the window; dragged, it may go down until ``seen_px`` are left."""
        room = self._room.rect().adjusted(8, _BELOW_TOP_BAR_PX, -8, -_ABOVE_STATUS_BAR_PX)
        size = size.boundedTo(room.size())
        bottom = room.bottom() - (size.height() if seen_px is None else seen_px)
        left = max(room.left(), min(at.x(), room.right() - size.width()))
        self.setGeometry(QRect(QPoint(left, max(room.top(), min(at.y(), bottom))), size))

    def _place(self) -> None:
        """Cover the list's column only, so that video, speech and the red button stay visible.

        As tall as the current page, upwards from the list's lower edge.
        """
        layout = (self.about, self._merge, self._forget)[self._pages.currentIndex()].layout()
        needed_px = 0 if layout is None else max(layout.heightForWidth(WIDTH_PX - 16), layout.sizeHint().height())
        size = QSize(WIDTH_PX, needed_px + _PORTRAIT_PX + 44)
        self._move_to(self._beside.bottomRight() - QPoint(size.width(), size.height()), size)

    def place(self) -> None:
        self._move_to(self.pos(), self.size())

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton and event.position().y() < _PORTRAIT_PX + 16:
            self._dragged = event.position().toPoint()

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        if self._dragged is not None:
            at = self.mapToParent(event.position().toPoint()) - self._dragged
            self._move_to(at, self.size(), seen_px=_PORTRAIT_PX)

    def mouseReleaseEvent(self, _event: QMouseEvent) -> None:
        self._dragged = None


class _Page(QWidget):
    """Page of the popup; makes its buttons."""

    def __init__(self, card: PersonCard) -> None:
        super().__init__()
        self._card = card

    def _button(self, name: str, text: str, icon_name: str, act: Callable[[], object], **more: Any) -> ActionButton:
        more = {"icon": icon_name, "objectName": name, "clicked": lambda _checked=False: act(), **more}
        return ActionButton(self._card.theme, text, **more)


def how_known(person: PersonRow, recognise: str, recognises: Collection[str]) -> str:
    """Basis of the person's identification, and its limits.

    ``recognise``: the scenario's setting; ``recognises``: available networks (clothing, face).
    """
    if recognise == "nobody":
        return tr("People are not recognised in this scenario: identify them yourself.")
    faces = recognise == "faces" and "face" in recognises
    by_face = faces and "face" in person.consents
    if is_identified(person) and person.confidence:
        clothing = tr("Recognised by clothing, today only ({sure}).")
        how = tr("Recognised by face or clothing ({sure}).") if by_face else clothing
        return how.format(sure=text_formatting.percent(person.confidence))
    if is_identified(person):
        return tr("Identified by you.")
    if by_face:
        return tr("Can be recognised by face, also on other days.")
    if "clothing" not in recognises and not faces:
        return tr("People are not recognised: this computer has no recognition model. Identify them yourself.")
    if recognise == "faces" and not faces:
        return tr(
            "Can be recognised by clothing, today only. The study has no face recognition model, so nobody "
            "is recognised on other days."
        )
    if faces:
        return tr(
            "Can be recognised by clothing, today only. Recognition by face on other days requires consent below."
        )
    return tr("Can be recognised by clothing, today only. Nobody is recognised on other days.")


def tags_of(text: str) -> tuple[str, ...]:
    """Unique tags from comma-separated text."""
    return tuple(dict.fromkeys(tag for each in text.split(",") if (tag := " ".join(each.split()))))


def _one_line(text: str) -> str:
    return " ".join(text.split())


class NoteField(QPlainTextEdit):
    """Multi-line field with the interface of a line edit."""

    editingFinished = Signal()
    text = QPlainTextEdit.toPlainText
    setText = QPlainTextEdit.setPlainText

    def __init__(self) -> None:
        super().__init__()
        self.setTabChangesFocus(True)
        self.setFixedHeight(58)

    def focusOutEvent(self, event: QFocusEvent) -> None:
        super().focusOutEvent(event)
        self.editingFinished.emit()


class _Field(NamedTuple):
    name: str
    title: str
    hint: str
    value: Callable[[str], Any]
    intent: Callable[[str, Any], Intent]


_FIELDS = {
    "name": _Field("person_card_name_field", QT_TR_NOOP("Name"), QT_TR_NOOP("Name"), _one_line, intents.NamePerson),
    "group": _Field("person_group", QT_TR_NOOP("Group"), QT_TR_NOOP("Group"), _one_line, intents.SetPersonGroup),
    "tags": _Field(
        "person_tags", QT_TR_NOOP("Tags"), QT_TR_NOOP("Tags, separated by commas"), tags_of, intents.TagPerson
    ),
    "note": _Field(
        "person_note", QT_TR_NOOP("Note"), QT_TR_NOOP("Notes about this person"), str.strip, intents.NotePerson
    ),
}
"""Editable fields by attribute of a PersonRow."""


class AboutPage(_Page):
    """Identification, notes, consents, history."""

    def __init__(self, card: PersonCard) -> None:
        super().__init__(card)
        self._groups: Sequence[str] = ()
        small = partial(self._button, height_px=30, text_px=tokens.STATUS_PX + 1)
        dim = partial(label, role="small", tone="dim", wraps=True)
        self._suggested: list[tuple[QWidget, QLabel]] = []
        for number in range(_MOST_SUGGESTED):
            row, text = QWidget(), label("", "title", tone="amber")
            row.setObjectName(f"person_suggestion_{number}")
            answer = partial(partial, self._answer, number)
            yes = small(f"person_suggestion_yes_{number}", tr("Yes"), "check", answer(intents.ConfirmPerson))
            no = small(f"person_suggestion_no_{number}", tr("No"), "x", answer(intents.RejectPerson))
            layouts.hbox(row, (text, 1), yes, no, margins_px=0)
            self._suggested.append((row, text))
        self._how = dim(objectName="person_how")
        self._not = small("person_not", "", "user-minus", partial(self._do, lambda one: intents.RejectPerson(one, one)))
        form = QGridLayout()
        form.setHorizontalSpacing(10)
        form.setVerticalSpacing(6)
        self._fields: dict[str, SubmitLineEdit | NoteField] = {}
        for row_number, (attribute, field) in enumerate(_FIELDS.items()):
            editor = self._fields[attribute] = NoteField() if attribute == "note" else SubmitLineEdit()
            editor.setObjectName(field.name)
            editor.setAccessibleName(tr(field.title))
            editor.setPlaceholderText(tr(field.hint))
            editor.editingFinished.connect(partial(self._store, attribute))
            if isinstance(editor, QLineEdit):
                editor.setMaxLength(80)
            form.addWidget(dim(tr(field.title), wraps=False), row_number, 0)
            form.addWidget(editor, row_number, 1)
        self._consents: dict[ConsentKind, CheckBox] = {}
        for kind in get_args(ConsentKind):
            box = CheckBox(card.theme, event_messages.CONSENTS[kind], objectName=f"consent_{kind}")
            box.clicked.connect(lambda given, kind=kind: self._do(intents.NoteConsent, kind, given))
            self._consents[kind] = box
        self._search = SubmitLineEdit(objectName="person_history_search", placeholderText=tr("Find in the history"))
        self._search.setAccessibleName(tr("Find in the history"))
        add_clear_button(self._search)
        self._looking = QTimer(self, singleShot=True, interval=_SEARCH_AFTER_MS)
        self._looking.timeout.connect(self.request_history)
        self._search.textChanged.connect(lambda _text: self._looking.start())
        last = form.rowCount()
        form.addWidget(dim(tr("Agrees to"), wraps=False), last, 0, 1, 2)
        form.addWidget(FlowRow(*self._consents.values(), gap_px=6), last + 1, 0, 1, 2)
        form.addWidget(dim(tr("History"), wraps=False), last + 2, 0)
        form.addWidget(self._search, last + 2, 1)
        self._no_history = dim(objectName="person_no_history")
        self.history = HistoryList(card.theme)
        self._split = small("person_split", tr("Split"), "users", partial(self._do, intents.SplitPerson))
        self._merge = small("person_merge", tr("Merge…"), "git-merge", partial(card.show_page, "merge"))
        forget = small("person_forget", tr("Erase…"), "trash", partial(card.show_page, "forget"))
        layouts.vbox(
            self,
            *(row for row, _text in self._suggested),
            layouts.hbox(None, (self._how, 1), self._not, spacing_px=tokens.GRID_PX),
            form,
            self._no_history,
            self.history,
            1,
            FlowRow(self._merge, self._split, forget, gap_px=6),
            margins_px=(14, 2, 14, 4),
            spacing_px=tokens.GRID_PX,
        )

    # ---- person

    def discard(self) -> None:
        """Discard unfinished input, which would be saved on leaving its field."""
        self._card.person = None
        self._looking.stop()
        for editor in self._fields.values():
            editor.clearFocus()
        with QSignalBlocker(self._search):
            self._search.clear()

    def show_person(self, person: PersonRow) -> None:
        """Refresh the fields, except the one being edited."""
        name = text_formatting.person_name(person)
        for attribute, editor in self._fields.items():
            text = ", ".join(person.tags) if attribute == "tags" else getattr(person, attribute)
            if attribute == "name" and not text_formatting.has_given_name(person):
                text = ""
            if not editor.hasFocus() and editor.text() != text:
                editor.setText(text)
        self._complete()
        console = self._card.console
        recognises = console.state.perception.value.recognises
        self._how.setText(how_known(person, console.scenario.perception.recognise, recognises))
        show_part(self._not, is_identified(person) and person.here)
        self._not.set_label(tr("Not {name}").format(name=text_formatting.shortened(name, 18)))
        for number, (row, text) in enumerate(self._suggested):
            show_part(row, number < len(person.suggestions))
            for suggestion in person.suggestions[number : number + 1]:
                sure = text_formatting.percent(suggestion.confidence)
                could = tr("or {name} ({sure})") if number else tr("Maybe {name} ({sure})")
                text.setText(could.format(name=text_formatting.name_in_words(suggestion.name), sure=sure))
        for kind, box in self._consents.items():
            box.setChecked(kind in person.consents)
        self._split.setEnabled(person.here)
        self._merge.setToolTip(tr("{name} is the same person as another one in the list").format(name=name))
        self._split.setToolTip(tr("The person here now is not the {name} seen before").format(name=name))

    def _complete(self) -> None:
        """Inline completion of known groups, without a list over the window."""
        groups = sorted({each.group for each in self._card.everyone() if each.group})
        field = self._fields["group"]
        if isinstance(field, QLineEdit) and self._groups != groups:
            self._groups = groups
            completer = QCompleter(groups, field, caseSensitivity=Qt.CaseSensitivity.CaseInsensitive)
            completer.setCompletionMode(QCompleter.CompletionMode.InlineCompletion)
            field.setCompleter(completer)

    def show_history(self, entries: Sequence[HistoryEntry], text: str) -> None:
        """Show the search results."""
        self.history.show_entries(entries)
        self._no_history.setText(tr("No matches in the history.") if text else tr("No earlier entries."))
        show_part(self._no_history, not entries)
        show_part(self.history, bool(entries))

    # ---- decisions

    def _do(self, intent: Callable[..., Intent], *details: object) -> None:
        """Send a decision about the person."""
        if self._card.person is not None:
            self._card.console.do(intent(self._card.person.person_id, *details))

    def _store(self, attribute: str) -> None:
        person, field = self._card.person, _FIELDS[attribute]
        value = field.value(self._fields[attribute].text())
        if person is not None and value != getattr(person, attribute) and (value or attribute != "name"):
            self._do(field.intent, value)

    def _answer(self, number: int, intent: Callable[[str, str], Intent]) -> None:
        person = self._card.person
        if person is not None and number < len(person.suggestions):
            self._do(intent, person.suggestions[number].person_id)

    def request_history(self) -> None:
        self._do(intents.LookUpPerson, self._search.text())


def when(utc_ns: int, today: datetime) -> str:
    """Time as 14:02; 21 Nov, 14:02 on another day; 21 Nov 2025, 14:02 in another year."""
    at = text_formatting.local_moment(utc_ns)
    if at.date() == today.date():
        return f"{at:%H:%M}"
    return f"{text_formatting.day_of(at, with_year=at.year != today.year)}, {at:%H:%M}"


def what(entry: HistoryEntry) -> str:
    """The entry as one line."""
    match entry.kind:
        case "visit":
            if entry.until_utc_ns is None:
                return tr("Visit")
            lasted = text_formatting.long_duration((entry.until_utc_ns - entry.utc_ns) / 1e9)
            return tr("Visit, {time}").format(time=lasted)
        case "said":
            return tr("Robot: “{text}”").format(text=entry.text)
        case "heard":
            return f"“{entry.text}”"
        case "photo":
            return tr("Photo {name}").format(name=entry.text.rsplit("/", 1)[-1])
        case _:
            return entry.text


class HistoryList(FastTableView):
    """History of a person over all sessions, newest entry first: time and one line per entry."""

    def __init__(self, theme: Theme) -> None:
        super().__init__(row_px=_HISTORY_ROW_PX)
        named(self, "person_history", tr("History"))
        self.entries = QStandardItemModel(0, 2, self)
        self.setModel(self.entries)
        columns = self.horizontalHeader()
        columns.moveSection(1, 0)  # the times are left of the texts
        columns.setSectionResizeMode(1, QHeaderView.ResizeMode.ResizeToContents)
        self._theme = theme
        self._shown: Sequence[HistoryEntry] = ()
        theme.restyle_on_change(self._style)

    def _style(self) -> None:
        self.show_entries(self._shown)

    def show_entries(self, entries: Sequence[HistoryEntry]) -> None:
        self._shown = entries
        self.entries.setRowCount(0)
        for entry in entries:
            text, time = QStandardItem(what(entry)), QStandardItem(when(entry.utc_ns, datetime.now()))
            text.setIcon(icon(_ICONS[entry.kind], self._theme.color("dim"), 15))
            session = f" · {entry.session}" if entry.session else ""
            text.setToolTip(f"{time.text()}{session}\n{what(entry)}")
            text.setAccessibleText(text.toolTip())
            time.setForeground(self._theme.color("dim"))
            self.entries.appendRow([text, time])
        self.setFixedHeight(min(len(entries), _HISTORY_ROWS) * _HISTORY_ROW_PX + 4)


class ForgetPage(_Page):
    """Confirmation of an erasure."""

    def __init__(self, card: PersonCard) -> None:
        super().__init__(card)
        self._title = label("", "title", wraps=True, objectName="forget_title")
        self._details = label("", "detail", wraps=True, objectName="forget_what")
        refused = tr("A session is being recorded. Stop the recording first.")
        self._not_now = label(refused, "detail", tone="amber", wraps=True, objectName="forget_not_now")
        self._erase = self._button(
            "forget_do", tr("Erase permanently"), "trash",
            lambda: card.decide(intents.ForgetPerson(card.person_id)), role="outline_danger",
        )  # fmt: skip
        keep = self._button("forget_keep", tr("Cancel"), "", partial(card.show_page, "about"))
        row = layouts.hbox(None, keep, self._erase, 1, spacing_px=tokens.GRID_PX)
        texts = (self._title, self._details, self._not_now)
        layouts.vbox(self, *texts, row, 1, margins_px=(14, 6, 14, 6), spacing_px=10)

    def begin_with(self, person: PersonRow) -> None:
        """Show the page; erasing is refused during a recording, because the file being written cannot change."""
        name = text_formatting.person_name(person)
        recording = self._card.console.state.recording.value.state in ("starting", "recording", "paused")
        self._title.setText(tr("Erase {name}?").format(name=name))
        self._details.setText(
            tr(
                "The name, group, tags, note, portrait, history and appearance of {name} are deleted from "
                "this study. In videos and photos {name} is pixelated; sound is muted where they speak or "
                "are named. Exports that show them are deleted.\n\nTexts that may name them are listed for "
                "you to decide on.\n\nThis takes a while; you can continue working in the meantime. It "
                "cannot be undone."
            ).format(name=name)
        )
        self._not_now.setVisible(recording)
        self._erase.setEnabled(not recording)


def who_stays(person: PersonRow, other: PersonRow) -> tuple[PersonRow, PersonRow]:
    """Direction of a merger: into the named person, else the known one."""
    rank = [(text_formatting.has_given_name(each), each.known, each is person) for each in (person, other)]
    return (other, person) if rank[0] >= rank[1] else (person, other)


class MergePage(_Page):
    """Choice of the same person, and both portraits for comparison."""

    def __init__(self, card: PersonCard) -> None:
        super().__init__(card)
        self._other: PersonRow | None = None
        self._fits: list[PersonRow] = []
        self._title = label("", "title", wraps=True, objectName="merge_title")
        self._field = SubmitLineEdit(
            objectName="merge_field", placeholderText=tr("Name, group or tag"), accessibleName=tr("Find the person")
        )
        self._field.textChanged.connect(self.refresh)
        self._field.returnPressed.connect(partial(self._choose, 0))
        column = layouts.vbox(self, self._title, self._field, margins_px=(14, 6, 14, 6), spacing_px=tokens.GRID_PX)
        self._offered: list[ActionButton] = []
        for number in range(_OFFERED):
            button = ActionButton(card.theme, "", may_shrink=True, height_px=32, objectName=f"merge_with_{number}")
            button.clicked.connect(lambda _checked=False, number=number: self._choose(number))
            column.addWidget(button)
            self._offered.append(button)
        self._both = QWidget()
        both = layouts.hbox(self._both, margins_px=0)
        self._sides = [
            (PortraitView(card.theme, card.portraits, _COMPARED_PORTRAIT_PX), label("", "detail")) for _ in range(2)
        ]
        for face, name in self._sides:
            side = QVBoxLayout()
            for widget in (face, name):
                side.addWidget(widget, 0, Qt.AlignmentFlag.AlignHCenter)
            both.addLayout(side, 1)
        self._consequence = label("", "detail", wraps=True, objectName="merge_told")
        self._same = self._button("merge_do", tr("Same person"), "check", self._on_same, role="primary")
        row = layouts.hbox(None, self._button("merge_back", tr("Back"), "caret-left", self._on_back), self._same, 1)
        layouts.fill(column, self._both, self._consequence, row, 1)

    def begin(self) -> None:
        self._other = None
        self._field.clear()
        self.refresh()

    def refresh(self, _text: str = "") -> None:
        person, everyone, other = self._card.person, self._card.everyone(), self._other
        if person is None:
            return
        if other is not None:
            other = self._other = next((each for each in everyone if each.person_id == other.person_id), None)
        who = tr("Who is the same person as {name}?").format(name=text_formatting.person_name(person))
        self._title.setText(who if other is None else tr("Are these the same person?"))
        self._field.setVisible(other is None)
        for part in (self._both, self._consequence, self._same):
            part.setVisible(other is not None)
        # Suggested people first.
        likely = [suggestion.person_id for suggestion in person.suggestions]
        others = [each for each in in_order(everyone) if each.person_id != person.person_id]
        others.sort(key=lambda each: likely.index(each.person_id) if each.person_id in likely else len(likely))
        self._fits = [each for each in others if other is None and found(each, self._field.text())][:_OFFERED]
        for button in self._offered[len(self._fits) :]:
            button.hide()
        for button, each in zip(self._offered, self._fits, strict=False):
            button.set_label(" · ".join(filter(None, (text_formatting.person_name(each), each.group))))
            button.show()
        if other is None:
            return
        for (face, name), each in zip(self._sides, (person, other), strict=True):
            face.show_person(each)
            name.setText(text_formatting.person_name(each))
        goes, stays = map(text_formatting.person_name, who_stays(person, other))
        text = tr("The visits, photos and notes of {goes} are moved to {stays}. You can undo this.")
        self._consequence.setText(text.format(goes=goes, stays=stays))

    def _choose(self, number: int) -> None:
        if number < len(self._fits):
            self._other = self._fits[number]
            self.refresh()

    def _on_back(self) -> None:
        if self._other is None:
            self._card.show_page("about")
        else:
            self._other = None
            self.refresh()

    def _on_same(self) -> None:
        if self._card.person is not None and self._other is not None:
            goes, stays = who_stays(self._card.person, self._other)
            self._card.decide(intents.MergePeople(goes.person_id, stays.person_id), stays.person_id)
