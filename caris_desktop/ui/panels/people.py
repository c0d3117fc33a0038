"""People: who is in front of the robot, and what they are called."""

from PySide6.QtCore import QSize, Qt, QTimer
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QHBoxLayout, QLabel, QLineEdit, QScrollArea, QStackedLayout, QVBoxLayout, QWidget

from caris_desktop.live.intents import WizardIntents
from caris_desktop.live.status import PerceptionStatus
from caris_desktop.people.presence import PersonRow
from caris_desktop.ui import tokens, words
from caris_desktop.ui.panel import Panel, PanelContext
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.avatar import Avatar
from caris_desktop.ui.widgets.buttons import ActionButton


class PeoplePanel(Panel):
    """One row for each person who is or just was here; names are typed right into the row."""

    title = "People"

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("people_panel")
        self._can_name = self.console.scenario.permissions.naming_people
        self._rows: dict[str, PersonEntry] = {}
        self._empty = QLabel()
        self._empty.setObjectName("people_empty")
        self._empty.setWordWrap(True)
        self._empty.setAlignment(Qt.AlignmentFlag.AlignCenter)
        body = QWidget()
        self._list = QVBoxLayout(body)
        self._list.setContentsMargins(6, 6, 6, 6)
        self._list.setSpacing(2)
        self._list.addStretch(1)
        scroll = QScrollArea()
        scroll.setWidgetResizable(True)
        scroll.setWidget(body)
        scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        holder = QWidget()
        self._stack = QStackedLayout(holder)
        centered = QWidget()
        column = QVBoxLayout(centered)
        column.setContentsMargins(24, 8, 24, 8)
        column.addWidget(self._empty)
        self._stack.addWidget(centered)
        self._stack.addWidget(scroll)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(2, 0, 2, 2)
        layout.addWidget(holder)
        self.state.persons.changed.connect(self._on_persons_changed)
        self.state.perception.changed.connect(self._on_perception_changed)
        self.state.frame.freshness_changed.connect(self._on_freshness_changed)
        self._ages = QTimer(self, interval=1000)
        self._ages.timeout.connect(self._refresh)
        self._ages.start()
        self._on_persons_changed(self.state.persons.value)

    def sizeHint(self) -> QSize:
        return QSize(340, 220)

    def minimumSizeHint(self) -> QSize:
        return QSize(220, 60)

    def row(self, person_id: str) -> "PersonEntry | None":
        return self._rows.get(person_id)

    def _on_persons_changed(self, persons: tuple[PersonRow, ...]) -> None:
        wanted = {person.person_id for person in persons}
        for person_id in [known for known in self._rows if known not in wanted]:
            row = self._rows.pop(person_id)
            self._list.removeWidget(row)
            row.deleteLater()
        # In order of appearance, so that nothing jumps away under the pointer; those who left go to the end.
        for place, person in enumerate(sorted(persons, key=lambda person: (not person.here, person.since_ns))):
            known_row = self._rows.get(person.person_id)
            if known_row is None:
                known_row = PersonEntry(self.theme, self.console, person, can_name=self._can_name)
                self._rows[person.person_id] = known_row
                self._list.insertWidget(place, known_row)
            elif self._list.indexOf(known_row) != place:
                self._list.removeWidget(known_row)
                self._list.insertWidget(place, known_row)
            known_row.show_person(person)
        self._refresh()

    def _on_perception_changed(self, _status: PerceptionStatus) -> None:
        self._refresh()

    def _on_freshness_changed(self, _freshness: str) -> None:
        self._refresh()

    def _refresh(self) -> None:
        persons: tuple[PersonRow, ...] = self.state.persons.value
        here = sum(person.here for person in persons)
        blind = self.state.frame.freshness == "lost"
        self.set_fact("no picture" if blind else f"{here} here" if here else "nobody here", "dim")
        self._stack.setCurrentIndex(1 if persons else 0)
        perception: PerceptionStatus = self.state.perception.value
        match perception.state:
            case "ready" if blind:
                text = "No picture, so nobody can be seen."
            case "ready":
                text = "Nobody in view.\nPeople appear here as soon as the camera sees them."
            case "loading":
                text = "Getting ready to find people.\nEverything else works meanwhile."
            case "failed":
                text = f"People are not being found.\n{perception.detail}"
            case _:
                text = "Finding people is off."
        self._empty.setText(text)
        palette = self._empty.palette()
        palette.setColor(self._empty.foregroundRole(), self.theme.color("dim"))
        self._empty.setPalette(palette)
        for row in self._rows.values():
            row.refresh_age()


class PersonEntry(QWidget):
    """A person: mark, name, since when; and a field to name them in place."""

    def __init__(self, theme: Theme, console: WizardIntents, person: PersonRow, *, can_name: bool) -> None:
        super().__init__()
        self._theme = theme
        self._console = console
        self._person = person
        self._avatar = Avatar(theme)
        self._name = QLabel()
        self._name.setTextFormat(Qt.TextFormat.PlainText)
        self._since = QLabel()
        self._field = _NameField()
        self._field.setObjectName("person_name_field")
        self._field.setPlaceholderText("Name, then Enter")
        self._field.setMaxLength(60)
        self._field.hide()
        self._field.returnPressed.connect(self._on_name_entered)
        # Left without Enter, an unfinished name changes nothing.
        self._field.editingFinished.connect(self._close_field)
        self._rename = ActionButton(theme, "Name", icon="pencil-simple", height_px=30, text_px=tokens.STATUS_PX + 1)
        self._rename.setObjectName("person_rename_button")
        self._rename.clicked.connect(self._open_field)
        column = QVBoxLayout()
        column.setSpacing(1)
        column.addWidget(self._name)
        column.addWidget(self._field)
        column.addWidget(self._since)
        row = QHBoxLayout(self)
        row.setContentsMargins(8, 6, 8, 6)
        row.setSpacing(12)
        row.addWidget(self._avatar)
        row.addLayout(column, 1)
        row.addWidget(self._rename)
        # Only now: shown before it has a parent, it would be a window of its own and take the keys from driving.
        self._rename.setVisible(can_name)
        theme.changed.connect(self.refresh_age)

    @property
    def name_text(self) -> str:
        return self._name.text()

    def show_person(self, person: PersonRow) -> None:
        self._person = person
        self._name.setText(words.person_name(person))
        known = words.has_given_name(person)
        self._avatar.show_person(person.name, known=known, here=person.here)
        self._rename.set_label("Rename" if known else "Name", icon="pencil-simple")
        self._rename.setAccessibleName(f"Name {words.person_name(person)}")
        self.refresh_age()

    def refresh_age(self) -> None:
        person, now_ns = self._person, self._console.state.present.now_ns()
        if person.here:
            text = f"here {words.since((now_ns - person.since_ns) / 1e9)}"
        else:
            text = f"left, last seen {words.age((now_ns - person.last_seen_ns) / 1e9)} ago"
        self._since.setText(text)
        self._name.setFont(self._theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD))
        self._since.setFont(self._theme.font(tokens.STATUS_PX))
        for label, role in ((self._name, "text" if person.here else "dim"), (self._since, "dim")):
            palette = label.palette()
            palette.setColor(label.foregroundRole(), self._theme.color(role))
            label.setPalette(palette)

    def _open_field(self) -> None:
        self._field.setText(self._person.name if words.has_given_name(self._person) else "")
        self._name.hide()
        self._field.show()
        self._field.selectAll()
        self._field.setFocus(Qt.FocusReason.OtherFocusReason)

    def _on_name_entered(self) -> None:
        name = " ".join(self._field.text().split())
        if name:
            self._console.rename_person(self._person.person_id, name)
        self._close_field()

    def _close_field(self) -> None:
        if not self._field.isHidden():
            self._field.hide()
            self._name.show()


class _NameField(QLineEdit):
    """Enter in it says nothing to the rest of the window."""

    def keyPressEvent(self, event: QKeyEvent) -> None:
        super().keyPressEvent(event)
        event.accept()
