"""First page of the person popup: identification, notes, consents, history."""

from collections.abc import Callable, Collection, Sequence
from datetime import datetime
from typing import Any, get_args

from PySide6.QtCore import (
    QAbstractListModel,
    QModelIndex,
    QObject,
    QPersistentModelIndex,
    QRect,
    QRectF,
    Qt,
    QTimer,
    Signal,
)
from PySide6.QtGui import QFocusEvent, QFontMetrics, QPainter
from PySide6.QtWidgets import (
    QCompleter,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QPlainTextEdit,
    QStyledItemDelegate,
    QStyleOptionViewItem,
    QWidget,
)

from caris_desktop.domain import intents
from caris_desktop.domain.events import ConsentKind
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.translation import tr
from caris_desktop.people.people_store import HistoryEntry
from caris_desktop.people.presence import PersonRow
from caris_desktop.ui import event_messages, layouts, text_formatting, tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.panel import show_part
from caris_desktop.ui.people.shown_people import is_identified
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.check_box import CheckBox
from caris_desktop.ui.widgets.clear_button import add_clear_button
from caris_desktop.ui.widgets.fast_table_view import FastTableView
from caris_desktop.ui.widgets.flow_layout import FlowRow
from caris_desktop.ui.widgets.submit_line_edit import SubmitLineEdit

_SEARCH_AFTER_MS = 250
_HISTORY_ROWS = 6
MOST_SUGGESTED = 2


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


class AboutPage(QWidget):
    """First page of the person popup. ``history_requested``: person id and search text."""

    merge_requested = Signal()
    forget_requested = Signal()
    history_requested = Signal(str, str)

    def __init__(self, theme: Theme, do: Callable[[Intent], object], *, recognise: str) -> None:
        super().__init__()
        self._theme = theme
        self._do = do
        self._recognise = recognise
        self._recognises: tuple[str, ...] = ()
        self._person: PersonRow | None = None
        self._headings: list[QLabel] = []
        self._how = QLabel(wordWrap=True)
        self._how.setObjectName("person_how")
        self._not = self._button("person_not", "", "user-minus", self._on_not)
        self._suggested = [self._suggestion_row(number) for number in range(MOST_SUGGESTED)]
        self._name = self._field("person_card_name_field", tr("Name"), tr("Name"), self._store_name)
        self._group = self._field("person_group", tr("Group"), tr("Group"), self._store_group)
        self._tags = self._field("person_tags", tr("Tags"), tr("Tags, separated by commas"), self._store_tags)
        self._note = NoteField()
        self._note.setObjectName("person_note")
        self._note.setAccessibleName(tr("Note"))
        self._note.setPlaceholderText(tr("Notes about this person"))
        self._note.left.connect(self._store_note)
        self._consents: dict[ConsentKind, CheckBox] = {}
        for kind in get_args(ConsentKind):
            box = self._consents[kind] = CheckBox(theme, event_messages.CONSENTS[kind])
            box.setObjectName(f"consent_{kind}")
            box.clicked.connect(lambda given, kind=kind: self._on_consent(kind, given))
        self._search = SubmitLineEdit()
        self._search.setObjectName("person_history_search")
        self._search.setPlaceholderText(tr("Find in the history"))
        self._search.setAccessibleName(tr("Find in the history"))
        add_clear_button(self._search)
        self._looking = QTimer(self, singleShot=True, interval=_SEARCH_AFTER_MS)
        self._looking.timeout.connect(self.request_history)
        self._search.textChanged.connect(lambda _text: self._looking.start())
        self.history = HistoryList(theme)
        self._no_history = QLabel(wordWrap=True)
        self._no_history.setObjectName("person_no_history")
        self._merge = self._button("person_merge", tr("Merge…"), "git-merge", self.merge_requested.emit)
        self._split = self._button("person_split", tr("Split"), "users", self._on_split)
        self._forget = self._button("person_forget", tr("Erase…"), "trash", self.forget_requested.emit)
        self._arrange()
        theme.restyle_on_change(self._style)

    def _button(self, name: str, text: str, icon: str, act: Callable[[], object]) -> ActionButton:
        button = ActionButton(self._theme, text, icon=icon, height_px=30, text_px=tokens.STATUS_PX + 1)
        button.setObjectName(name)
        button.clicked.connect(lambda _checked=False: act())
        return button

    def _field(self, name: str, title: str, hint: str, keep: Callable[[], None]) -> SubmitLineEdit:
        field = SubmitLineEdit()
        field.setObjectName(name)
        field.setAccessibleName(title)
        field.setPlaceholderText(hint)
        field.setMaxLength(80)
        field.editingFinished.connect(keep)
        return field

    def _suggestion_row(self, number: int) -> tuple[QWidget, QLabel, ActionButton, ActionButton]:
        row = QWidget()
        row.setObjectName(f"person_suggestion_{number}")
        text = QLabel()
        yes = self._button(
            f"person_suggestion_yes_{number}", tr("Yes"), "check", lambda: self._answer(number, yes=True)
        )
        no = self._button(f"person_suggestion_no_{number}", tr("No"), "x", lambda: self._answer(number, yes=False))
        line = layouts.hbox(row, margins_px=0)
        line.addWidget(text, 1)
        line.addWidget(yes)
        line.addWidget(no)
        return row, text, yes, no

    def _heading(self, text: str) -> QLabel:
        label = QLabel(text)
        self._headings.append(label)
        return label

    def _arrange(self) -> None:
        form = QGridLayout()
        form.setHorizontalSpacing(10)
        form.setVerticalSpacing(6)
        for row, (text, field) in enumerate(
            ((tr("Name"), self._name), (tr("Group"), self._group), (tr("Tags"), self._tags), (tr("Note"), self._note))
        ):
            form.addWidget(self._heading(text), row, 0)
            form.addWidget(field, row, 1)
        agreed = FlowRow(gap_px=6)
        for box in self._consents.values():
            agreed.add(box)
        past = QHBoxLayout()
        past.addWidget(self._heading(tr("History")))
        past.addWidget(self._search, 1)
        acts = FlowRow(gap_px=6)
        for button in (self._merge, self._split, self._forget):
            acts.add(button)
        column = layouts.vbox(self, margins_px=(14, 2, 14, 4), spacing_px=tokens.GRID_PX)
        for suggested, *_ in self._suggested:
            column.addWidget(suggested)
        known = layouts.hbox(spacing_px=tokens.GRID_PX)
        known.addWidget(self._how, 1)
        known.addWidget(self._not)
        column.addLayout(known)
        column.addLayout(form)
        column.addWidget(self._heading(tr("Agrees to")))
        column.addWidget(agreed)
        column.addLayout(past)
        column.addWidget(self._no_history)
        column.addWidget(self.history)
        column.addStretch(1)
        column.addWidget(acts)
        self._note.setFixedHeight(58)

    # ---- person

    def begin_with(self, person: PersonRow) -> None:
        """Switch to another person, discarding unfinished input."""
        self._person = None
        self._looking.stop()
        for field in (self._name, self._group, self._tags, self._note):
            field.clearFocus()
        self._search.blockSignals(True)
        self._search.clear()
        self._search.blockSignals(False)
        self.show_history(person.person_id, (), "")

    def use_networks(self, recognises: tuple[str, ...]) -> None:
        """Set the available networks: clothing, face."""
        self._recognises = recognises

    def show_person(self, person: PersonRow, groups: Sequence[str]) -> None:
        """Refresh the fields, except the one being edited."""
        self._person = person
        name = text_formatting.person_name(person)
        for field, text in (
            (self._name, person.name if text_formatting.has_given_name(person) else ""),
            (self._group, person.group),
            (self._tags, ", ".join(person.tags)),
        ):
            if not field.hasFocus() and field.text() != text:
                field.setText(text)
        if not self._note.hasFocus() and self._note.toPlainText() != person.note:
            self._note.setPlainText(person.note)
        self._complete(groups)
        self._how.setText(how_known(person, self._recognise, self._recognises))
        show_part(self._not, is_identified(person) and person.here)
        self._not.set_label(tr("Not {name}").format(name=text_formatting.shortened(name, 18)))
        for number, (row, question_label, _yes, _no) in enumerate(self._suggested):
            there = number < len(person.suggestions)
            show_part(row, there)
            if there:
                suggestion = person.suggestions[number]
                sure = text_formatting.percent(suggestion.confidence)
                could = tr("or {name} ({sure})") if number else tr("Maybe {name} ({sure})")
                question_label.setText(could.format(name=text_formatting.name_in_words(suggestion.name), sure=sure))
        for kind, box in self._consents.items():
            box.setChecked(kind in person.consents)
        self._split.setEnabled(person.here)
        self._merge.setToolTip(tr("{name} is the same person as another one in the list").format(name=name))
        self._split.setToolTip(tr("The person here now is not the {name} seen before").format(name=name))

    def _complete(self, groups: Sequence[str]) -> None:
        """Inline completion of known groups, without a list over the window."""
        completer = self._group.completer()
        if completer is not None and completer.property("groups") == list(groups):
            return
        completer = QCompleter(list(groups), self._group)
        completer.setProperty("groups", list(groups))
        completer.setCompletionMode(QCompleter.CompletionMode.InlineCompletion)
        completer.setCaseSensitivity(Qt.CaseSensitivity.CaseInsensitive)
        self._group.setCompleter(completer)

    def show_history(self, person_id: str, entries: Sequence[HistoryEntry], text: str) -> None:
        """Show the search results."""
        if self._person is not None and person_id != self._person.person_id:
            return
        self.history.entries.show_entries(entries)
        self._no_history.setText(tr("No matches in the history.") if text else tr("No earlier entries."))
        show_part(self._no_history, not entries)
        self.history.setFixedHeight(min(len(entries), _HISTORY_ROWS) * HISTORY_ROW_PX + 4)
        show_part(self.history, bool(entries))

    def give_up(self) -> None:
        """Discard unfinished input."""
        person, self._person = self._person, None
        for field in (self._name, self._group, self._tags, self._note):
            field.clearFocus()
        if person is not None:
            self.show_person(person, [])

    # ---- decisions

    def _store_name(self) -> None:
        person, name = self._person, " ".join(self._name.text().split())
        if person is not None and name and name != person.name:
            self._do(intents.NamePerson(person.person_id, name))

    def _store_group(self) -> None:
        person, group = self._person, " ".join(self._group.text().split())
        if person is not None and group != person.group:
            self._do(intents.SetPersonGroup(person.person_id, group))

    def _store_tags(self) -> None:
        person, tags = self._person, tags_of(self._tags.text())
        if person is not None and tags != person.tags:
            self._do(intents.TagPerson(person.person_id, tags))

    def _store_note(self) -> None:
        person, note = self._person, self._note.toPlainText().strip()
        if person is not None and note != person.note:
            self._do(intents.NotePerson(person.person_id, note))

    def _on_consent(self, kind: ConsentKind, given: bool) -> None:
        if self._person is not None:
            self._do(intents.NoteConsent(self._person.person_id, kind, given))

    def _answer(self, number: int, *, yes: bool) -> None:
        person = self._person
        if person is not None and number < len(person.suggestions):
            answer = intents.ConfirmPerson if yes else intents.RejectPerson
            self._do(answer(person.person_id, person.suggestions[number].person_id))

    def _on_not(self) -> None:
        if self._person is not None:
            self._do(intents.RejectPerson(self._person.person_id, self._person.person_id))

    def _on_split(self) -> None:
        if self._person is not None:
            self._do(intents.SplitPerson(self._person.person_id))

    def request_history(self) -> None:
        """Request the history of the person."""
        if self._person is not None:
            self.history_requested.emit(self._person.person_id, self._search.text())

    def _style(self) -> None:
        small = self._theme.font(tokens.STATUS_PX)
        for label in (*self._headings, self._how, self._no_history):
            label.setFont(small)
            self._theme.color_text(label, "dim")
        for _row, text, _yes, _no in self._suggested:
            self._theme.style_text(text, "amber", tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD)
        self._note.setFont(self._theme.font(tokens.STATUS_PX + 1))


class NoteField(QPlainTextEdit):
    """Multi-line field; ``left`` on losing the focus."""

    left = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.setTabChangesFocus(True)

    def focusOutEvent(self, event: QFocusEvent) -> None:
        super().focusOutEvent(event)
        self.left.emit()


HISTORY_ROW_PX = 26
_ICONS = {"visit": "user", "said": "robot", "heard": "chat-text", "photo": "camera", "note": "note-pencil"}
_ENTRY_ROLE = int(Qt.ItemDataRole.UserRole)
_Index = QModelIndex | QPersistentModelIndex


def when(utc_ns: int, today: datetime) -> str:
    """Time as 14:02; 21 Nov, 14:02 on another day; 21 Nov 2025, 14:02 in another year."""
    at = datetime.fromtimestamp(utc_ns / 1e9)
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


class HistoryModel(QAbstractListModel):
    """History of a person over all sessions: time and one line per entry."""

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self._entries: Sequence[HistoryEntry] = ()

    @property
    def times(self) -> list[str]:
        """Unique times shown before the entries."""
        today = datetime.now()
        return list(dict.fromkeys(when(entry.utc_ns, today) for entry in self._entries))

    def show_entries(self, entries: Sequence[HistoryEntry]) -> None:
        self.beginResetModel()
        self._entries = entries
        self.endResetModel()

    def rowCount(self, parent: _Index = QModelIndex()) -> int:  # noqa: B008 (Qt's own default)
        return 0 if parent.isValid() else len(self._entries)

    def data(self, index: _Index, role: int = int(Qt.ItemDataRole.DisplayRole)) -> Any:
        entry = self._entries[index.row()]
        if role == Qt.ItemDataRole.DisplayRole:
            return what(entry)
        if role in (Qt.ItemDataRole.ToolTipRole, Qt.ItemDataRole.AccessibleTextRole):
            session = f" · {entry.session}" if entry.session else ""
            return f"{when(entry.utc_ns, datetime.now())}{session}\n{what(entry)}"
        return entry if role == _ENTRY_ROLE else None


class HistoryList(FastTableView):
    """History list, newest entry first."""

    def __init__(self, theme: Theme) -> None:
        super().__init__(row_px=HISTORY_ROW_PX)
        self.setObjectName("person_history")
        self.setAccessibleName(tr("History"))
        self.entries = HistoryModel(self)
        self.setModel(self.entries)
        self.setItemDelegate(_EntryDelegate(theme, self))


class _EntryDelegate(QStyledItemDelegate):
    def __init__(self, theme: Theme, view: HistoryList) -> None:
        super().__init__(view)
        self._theme = theme
        self._entries = view.entries
        self._times_px = 0
        view.entries.modelReset.connect(self._measure)

    def _measure(self) -> None:
        """Width of the longest time."""
        metrics = QFontMetrics(self._theme.font(tokens.STATUS_PX))
        self._times_px = max((metrics.horizontalAdvance(time) for time in self._entries.times), default=0) + 12

    def paint(self, painter: QPainter, option: QStyleOptionViewItem, index: _Index) -> None:
        theme, rect = self._theme, option.rect
        entry: HistoryEntry = index.data(_ENTRY_ROLE)
        font = theme.font(tokens.STATUS_PX)
        metrics = QFontMetrics(font)
        time = when(entry.utc_ns, datetime.now())
        painter.save()
        painter.setFont(font)
        painter.setPen(theme.color("dim"))
        left = int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        wide = self._times_px
        painter.drawText(QRect(rect.left(), rect.top(), wide, rect.height()), left, time)
        icon = QRectF(rect.left() + wide, rect.center().y() - 7, 15, 15)
        draw_icon(painter, icon, _ICONS[entry.kind], theme.color("dim"))
        painter.setPen(theme.color("text"))
        room = rect.adjusted(wide + 22, 0, -4, 0)
        painter.drawText(room, left, metrics.elidedText(what(entry), Qt.TextElideMode.ElideRight, room.width()))
        painter.restore()
