"""People: who is in front of the robot, and what they are called."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

from PySide6.QtCore import (
    QAbstractListModel,
    QEvent,
    QModelIndex,
    QObject,
    QPersistentModelIndex,
    QRect,
    QRectF,
    QSize,
    Qt,
    Signal,
)
from PySide6.QtGui import QCursor, QFontMetrics, QHideEvent, QKeyEvent, QMouseEvent, QPainter, QPen, QResizeEvent
from PySide6.QtWidgets import (
    QLabel,
    QStackedLayout,
    QStyle,
    QStyledItemDelegate,
    QStyleOptionViewItem,
    QVBoxLayout,
    QWidget,
)

from caris_desktop.domain import intents
from caris_desktop.live.state import PresentClock
from caris_desktop.live.status import PerceptionStatus
from caris_desktop.people.presence import PersonRow
from caris_desktop.ui import tokens, words
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.panel import Panel, PanelContext
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets import avatar
from caris_desktop.ui.widgets.enter_field import EnterField
from caris_desktop.ui.widgets.row_list import RowList

_ROW_PX = 52
_SIDE_PX = 14
_GAP_PX = 12
_BUTTON_SIZE = QSize(96, 30)
_NAME_HINT = "Name, then Enter"
_NOBODY_HINT = "Nobody is named: this person is gone"
_PERSON_ROLE = int(Qt.ItemDataRole.UserRole)
_Index = QModelIndex | QPersistentModelIndex


class PeoplePanel(Panel):
    """One row for each person in the picture on show who is or just was here; names are typed right into the row."""

    title = "People"

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("people_panel")
        self._empty = QLabel()
        self._empty.setObjectName("people_empty")
        self._empty.setWordWrap(True)
        self._empty.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.model = PeopleModel(self.state.present, self)
        self.list = PeopleList(self.theme, self.model, can_name=self.console.scenario.permissions.naming_people)
        self.list.setObjectName("people_list")
        self.list.named.connect(lambda person_id, name: self.console.do(intents.NamePerson(person_id, name)))
        self.list.let_go.connect(self.catch_up)
        self.hold.escape_pressed.connect(self.list.give_up_naming)
        holder = QWidget()
        self._stack = QStackedLayout(holder)
        centered = QWidget()
        column = QVBoxLayout(centered)
        column.setContentsMargins(24, 8, 24, 8)
        column.addWidget(self._empty)
        self._stack.addWidget(centered)
        self._stack.addWidget(self.list)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(2, 6, 2, 8)
        layout.addWidget(holder)
        self.state.persons.changed.connect(self._on_persons_changed)
        self.state.camera.changed.connect(self.catch_up)
        self.state.perception.changed.connect(self._refresh)
        self.state.frame.freshness_changed.connect(self._refresh)
        self.theme.changed.connect(self._refresh)
        self.every(1000, self.model.refresh_ages)
        self.catch_up()

    def sizeHint(self) -> QSize:
        return QSize(340, 220)

    def minimumSizeHint(self) -> QSize:
        return QSize(220, 60)

    def catch_up(self) -> None:
        self._on_persons_changed(self.state.persons.value)

    def _in_picture(self, person: PersonRow) -> bool:
        return self.state.camera.value in ("", person.camera) or not person.camera

    def _on_persons_changed(self, persons: tuple[PersonRow, ...]) -> None:
        if self.in_view:
            in_picture = tuple(filter(self._in_picture, persons))
            known = frozenset(person.person_id for person in persons)
            self.model.show_persons(in_picture, known=known, in_place=self.list.held)
            self.list.look_whose_name_it_is()
            self._refresh()

    def _refresh(self) -> None:
        if not self.in_view:
            return
        everybody: tuple[PersonRow, ...] = self.state.persons.value
        persons = tuple(filter(self._in_picture, everybody))
        here = sum(person.here for person in persons)
        elsewhere = sum(person.here for person in everybody) - here
        blind = self.state.frame.freshness == "lost"
        fact = "no picture" if blind else f"{here} here" if here else "nobody here"
        self.set_fact(fact + (f" · {elsewhere} in another camera" if elsewhere else ""), "dim")
        self._stack.setCurrentIndex(1 if self.model.rowCount() else 0)
        if self.model.rowCount():
            return
        perception: PerceptionStatus = self.state.perception.value
        match perception.state:
            case _ if not self.state.present.live:
                text = "Nobody was seen at this moment."
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
        self.theme.color_text(self._empty, "dim")


def in_order(persons: Iterable[PersonRow]) -> list[PersonRow]:
    """In order of appearance, so that nothing jumps away under the pointer; those who left go to the end."""
    return sorted(persons, key=lambda person: (not person.here, person.since_ns))


class PeopleModel(QAbstractListModel):
    """The persons in the order of their rows. Tells the view of what a person could see, and of nothing else."""

    def __init__(self, present: PresentClock, parent: QObject) -> None:
        super().__init__(parent)
        self._present = present
        self._persons: list[PersonRow] = []
        self._told: list[tuple[object, ...]] = []
        self._known: frozenset[str] = frozenset()

    @property
    def persons(self) -> Sequence[PersonRow]:
        return self._persons

    def row_of(self, person_id: str) -> int | None:
        """Where this person stands; None for somebody who is in no row."""
        return next((row for row, person in enumerate(self._persons) if person.person_id == person_id), None)

    def knows(self, person_id: str) -> bool:
        """Whether this person can still be named."""
        return person_id in self._known

    def show_persons(self, persons: Sequence[PersonRow], *, known: frozenset[str], in_place: bool) -> None:
        """``in_place``: every row stays where it is, those of people who are gone too; who is new comes last.
        ``known`` are the ids of all who can be named.
        """
        self._known = known
        ordered = self._in_place(persons) if in_place else in_order(persons)
        if [person.person_id for person in ordered] != [person.person_id for person in self._persons]:
            self._arrange(ordered)
        self._persons = ordered
        self.refresh_ages()

    def _in_place(self, persons: Sequence[PersonRow]) -> list[PersonRow]:
        newest = {person.person_id: person for person in persons}
        stay = [newest.pop(row.person_id, replace(row, here=False)) for row in self._persons]
        return stay + in_order(newest.values())

    def _arrange(self, ordered: Sequence[PersonRow]) -> None:
        """Take out, move and put in rows, so that the others stay the rows that they are."""
        root, wanted = QModelIndex(), {person.person_id for person in ordered}
        for row in reversed(range(len(self._persons))):
            if self._persons[row].person_id not in wanted:
                self.beginRemoveRows(root, row, row)
                del self._persons[row], self._told[row]
                self.endRemoveRows()
        known = {person.person_id for person in self._persons}
        for place, person in enumerate(ordered):
            if person.person_id not in known:
                self.beginInsertRows(root, place, place)
                self._persons.insert(place, person)
                self._told.insert(place, ())
                self.endInsertRows()
            elif self._persons[place].person_id != person.person_id:
                came_from = self.row_of(person.person_id)
                if came_from is not None and self.beginMoveRows(root, came_from, came_from, root, place):
                    self._persons.insert(place, self._persons.pop(came_from))
                    self._told.insert(place, self._told.pop(came_from))
                    self.endMoveRows()

    def refresh_ages(self) -> None:
        """Ages grow by themselves; only rows that read otherwise than before are drawn again."""
        for row, person in enumerate(self._persons):
            seen = words.person_name(person), person.here, self.since(person), self.knows(person.person_id)
            if seen != self._told[row]:
                self._told[row] = seen
                self.dataChanged.emit(self.index(row), self.index(row))

    def since(self, person: PersonRow) -> str:
        """How long somebody has been here, or gone."""
        now_ns = self._present.now_ns()
        if person.here:
            return f"here {words.since((now_ns - person.since_ns) / 1e9)}"
        return f"left, last seen {words.age((now_ns - person.last_seen_ns) / 1e9)} ago"

    def rowCount(self, parent: _Index = QModelIndex()) -> int:  # noqa: B008 (Qt's own default)
        return 0 if parent.isValid() else len(self._persons)

    def data(self, index: _Index, role: int = int(Qt.ItemDataRole.DisplayRole)) -> Any:
        person = self._persons[index.row()]
        if role == Qt.ItemDataRole.DisplayRole:
            return words.person_name(person)
        if role == Qt.ItemDataRole.AccessibleTextRole:
            return f"{words.person_name(person)}, {self.since(person)}"
        return person if role == _PERSON_ROLE else None


class PeopleList(RowList):
    """The rows, and the field for a name in place of the name that it changes.

    ``held`` while the mouse is over it or a name is typed: rows must not move then. ``let_go`` when they may again.
    """

    named = Signal(str, str)  # person id, name
    let_go = Signal()

    def __init__(self, theme: Theme, model: PeopleModel, *, can_name: bool) -> None:
        super().__init__(row_px=_ROW_PX)
        self._people = model
        self._can_name = can_name
        self._naming = ""  # the person whose name is being typed
        self._under_mouse = False
        self._pressed = ""
        self.setAccessibleName("People in front of the robot")
        self.setModel(model)
        self.setItemDelegate(PersonDelegate(theme, model, self, can_name=can_name))
        self.setMouseTracking(True)
        self._field = EnterField(self.viewport())
        self._field.setObjectName("person_name_field")
        self._field.setMaxLength(60)
        self._field.hide()
        self._field.returnPressed.connect(self._on_name_entered)
        # Left without Enter, an unfinished name changes nothing.
        self._field.editingFinished.connect(self._close_field)
        self.verticalScrollBar().valueChanged.connect(self._place_field)
        for changed in (model.rowsInserted, model.rowsRemoved, model.rowsMoved):
            changed.connect(self._place_field)

    @property
    def held(self) -> bool:
        return self._under_mouse or bool(self._naming)

    def viewportEvent(self, event: QEvent) -> bool:
        if event.type() in (QEvent.Type.Enter, QEvent.Type.Leave):
            self._under_mouse = event.type() == QEvent.Type.Enter
            self._maybe_let_go()
        return super().viewportEvent(event)

    def hideEvent(self, event: QHideEvent) -> None:
        # A hidden widget is not told that the mouse left.
        self._under_mouse = False
        self._close_field()
        super().hideEvent(event)

    def _maybe_let_go(self) -> None:
        if not self.held:
            self.let_go.emit()

    @property
    def naming(self) -> str:
        """The person whose name is being typed; empty while none is."""
        return self._naming

    def button_rect(self, row: int) -> QRect:
        """Where the row's button for the name is, in the viewport."""
        return _button_rect(self.visualRect(self._people.index(row)))

    def name(self, person_id: str) -> None:
        """Open the field for this person's name."""
        row = self._people.row_of(person_id)
        if row is None or not self._can_name or not self._people.knows(person_id):
            return
        person = self._people.persons[row]
        self._field.setReadOnly(False)
        self._field.setPlaceholderText(_NAME_HINT)
        self.scrollTo(self._people.index(row))
        self._naming = person_id
        self._field.setAccessibleName(f"Name of {words.person_name(person)}")
        self._field.setText(person.name if words.has_given_name(person) else "")
        self._place_field()
        self._field.show()
        self._field.selectAll()
        self._field.setFocus(Qt.FocusReason.OtherFocusReason)

    def _place_field(self) -> None:
        if not self._naming:
            return
        row = self._people.row_of(self._naming)
        if row is None:
            self._close_field()
            return
        rect = self.visualRect(self._people.index(row))
        left = rect.left() + _SIDE_PX + avatar.SIZE_PX + _GAP_PX - 6
        self._field.setGeometry(left, rect.top() + 8, max(80, rect.right() - _SIDE_PX - left), rect.height() - 16)

    def look_whose_name_it_is(self) -> None:
        """Letters for the name of somebody who is no more go nowhere: not to another row, nor to another field."""
        if self._naming and not self._people.knows(self._naming) and not self._field.isReadOnly():
            self._field.clear()
            self._field.setReadOnly(True)
            self._field.setPlaceholderText(_NOBODY_HINT)

    def give_up_naming(self) -> None:
        """Nothing is named."""
        self._close_field()

    def _on_name_entered(self) -> None:
        name, person_id = " ".join(self._field.text().split()), self._naming
        known = self._people.knows(person_id)
        self._close_field()
        if name and known:
            self.named.emit(person_id, name)

    def _close_field(self) -> None:
        if self._field.isHidden():
            return
        if self._field.hasFocus():
            # Else Qt gives it to whatever comes next, which may be what the robot says, or driving.
            self.setFocus(Qt.FocusReason.OtherFocusReason)
        self._naming = ""
        self._field.hide()
        self._maybe_let_go()

    def _button_at(self, event: QMouseEvent) -> str:
        """The person whose button the mouse is on."""
        at = event.position().toPoint()
        index = self.indexAt(at)
        if not (self._can_name and index.isValid() and _button_rect(self.visualRect(index)).contains(at)):
            return ""
        person_id = self._people.persons[index.row()].person_id
        return person_id if self._people.knows(person_id) else ""

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton:
            self._pressed = self._button_at(event)
        super().mousePressEvent(event)

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        pressed, self._pressed = self._pressed, ""
        super().mouseReleaseEvent(event)
        if pressed and pressed == self._button_at(event):
            self.name(pressed)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        super().mouseMoveEvent(event)
        self.viewport().update()  # the button under the mouse looks as if it can be pressed

    def leaveEvent(self, event: QEvent) -> None:
        super().leaveEvent(event)
        self.viewport().update()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        row = self.currentIndex().row()
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter, Qt.Key.Key_F2) and row >= 0:
            self.name(self._people.persons[row].person_id)
        else:
            super().keyPressEvent(event)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._place_field()


def _button_rect(row: QRect) -> QRect:
    left = row.right() - _SIDE_PX - _BUTTON_SIZE.width()
    return QRect(left, row.center().y() - _BUTTON_SIZE.height() // 2, _BUTTON_SIZE.width(), _BUTTON_SIZE.height())


class PersonDelegate(QStyledItemDelegate):
    """Mark, name, since when, and the button that opens the field for the name."""

    def __init__(self, theme: Theme, model: PeopleModel, view: PeopleList, *, can_name: bool) -> None:
        super().__init__(view)
        self._theme = theme
        self._people = model
        self._view = view
        self._can_name = can_name

    def paint(self, painter: QPainter, option: QStyleOptionViewItem, index: _Index) -> None:
        theme, rect = self._theme, option.rect
        person: PersonRow = index.data(_PERSON_ROLE)
        known = words.has_given_name(person)
        painter.save()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self._view.hasFocus() and index.row() == self._view.currentIndex().row():
            painter.setPen(QPen(theme.color("blue"), 2))
            painter.drawRoundedRect(QRectF(rect).adjusted(3, 1, -3, -1), 6, 6)
        mark = QRect(rect.left() + _SIDE_PX, rect.center().y() - avatar.SIZE_PX // 2, avatar.SIZE_PX, avatar.SIZE_PX)
        avatar.draw_avatar(painter, theme, mark.toRectF(), person.name, known=known, here=person.here)
        left = mark.right() + _GAP_PX
        right = (_button_rect(rect).left() - 8) if self._can_name else rect.right() - _SIDE_PX
        middle = rect.center().y()
        name, since = QRect(left, middle - 20, right - left, 20), QRect(left, middle, right - left, 20)
        for box, text, font, role in (
            (name, words.person_name(person), theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD),
             "text" if person.here else "dim"),
            (since, self._people.since(person), theme.font(tokens.STATUS_PX), "dim"),
        ):  # fmt: skip
            painter.setFont(font)
            painter.setPen(theme.color(role))
            cut = QFontMetrics(font).elidedText(text, Qt.TextElideMode.ElideRight, box.width())
            painter.drawText(box, int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter), cut)
        if self._can_name and person.person_id != self._view.naming and self._people.knows(person.person_id):
            hovered = bool(option.state & QStyle.StateFlag.State_MouseOver)
            self._paint_button(painter, _button_rect(rect), "Rename" if known else "Name", hovered=hovered)
        painter.restore()

    def _paint_button(self, painter: QPainter, rect: QRect, text: str, *, hovered: bool) -> None:
        theme = self._theme
        under = hovered and rect.contains(self._view.viewport().mapFromGlobal(QCursor.pos()))
        painter.setPen(QPen(theme.color("line"), 1))
        painter.setBrush(theme.color("raised_hover" if under else "raised"))
        painter.drawRoundedRect(
            QRectF(rect).adjusted(0.5, 0.5, -0.5, -0.5), tokens.CONTROL_RADIUS_PX, tokens.CONTROL_RADIUS_PX
        )
        font = theme.font(tokens.STATUS_PX + 1)
        width = 17 + 8 + QFontMetrics(font).horizontalAdvance(text)
        left = rect.left() + (rect.width() - width) // 2
        draw_icon(painter, QRectF(left, rect.center().y() - 8, 17, 17), "pencil-simple", theme.color("text"))
        painter.setFont(font)
        painter.setPen(theme.color("text"))
        words_rect = QRect(left + 25, rect.top(), rect.right() - left - 25, rect.height())
        painter.drawText(words_rect, int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter), text)
