"""List of people: model, painted rows with real buttons over them, names edited in place."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from PySide6.QtCore import (
    QAbstractListModel,
    QEvent,
    QModelIndex,
    QObject,
    QRect,
    QRectF,
    Qt,
    Signal,
)
from PySide6.QtGui import QCursor, QKeyEvent, QPainter, QPen, QResizeEvent
from PySide6.QtWidgets import QAbstractItemDelegate, QPushButton, QStyleOptionViewItem, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.live.state import PresentClock
from caris_desktop.people.presence import PersonRow
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.focus_widget import focus_widget, focused_widget
from caris_desktop.ui.people.portraits import AVATAR_PX, PortraitPixmaps, draw_avatar
from caris_desktop.ui.people.shown_people import (
    SPEAKING,
    UNCONFIRMED,
    RowButton,
    buttons_of,
    captions,
    in_order,
    presence_of,
    what_is_seen,
)
from caris_desktop.ui.text_formatting import wrapped_tip
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton, ButtonRole
from caris_desktop.ui.widgets.inputs import SubmitLineEdit
from caris_desktop.ui.widgets.rows import FastTableView, Index, RowDelegate

ROW_PX = 52
CAPTION_PX = 26
_SIDE_PX = 14
_GAP_PX = 12
_BUTTON_PX = 30
_BETWEEN_PX = 6
_TEXT_LEFT_PX = _SIDE_PX + AVATAR_PX + _GAP_PX
_TEXT_AT_LEAST_PX = 96
_ENTER = (Qt.Key.Key_Return, Qt.Key.Key_Enter)

PERSON_ROLE = int(Qt.ItemDataRole.UserRole)
_MANY = 20
"""Number of inserted or removed rows from which the model is reset, as on a search."""


class PeopleModel(QAbstractListModel):
    """Persons in row order: present, former, known. ``captions`` are above the first row of a group.

    Decisions need ``may_decide``: not without naming permission, and not in a replay.
    """

    changed = Signal()  # after all signals about single rows

    def __init__(self, present: PresentClock, parent: QObject) -> None:
        super().__init__(parent)
        self._present = present
        self._camera = ""
        self._known: frozenset[str] = frozenset()
        self._unconfirmed: frozenset[str] = frozenset()
        self._shown_states: dict[str, tuple[object, ...]] = {}
        self.persons: list[PersonRow] = []
        self.captions: dict[int, str] = {}
        self.may_decide = False

    def row_of(self, person_id: str) -> int | None:
        """Row of this person; None if there is none."""
        return next((row for row, person in enumerate(self.persons) if person.person_id == person_id), None)

    def knows(self, person_id: str) -> bool:
        """Whether this person can still be named."""
        return person_id in self._known

    def is_unconfirmed(self, person_id: str) -> bool:
        """Whether their identity has not been confirmed since a crash."""
        return person_id in self._unconfirmed

    def show_unconfirmed(self, person_ids: frozenset[str]) -> None:
        if person_ids != self._unconfirmed:
            self._unconfirmed = person_ids
            self.refresh_ages()
            self.changed.emit()

    def show_persons(
        self, persons: Sequence[PersonRow], *, known: frozenset[str], held_rows: int = 0, camera: str = "",
        may_reset: bool = True,
    ) -> None:  # fmt: skip
        """Set the persons. The first ``held_rows`` stay in place, even for people who left, and their captions too.
        ``known``: ids that can be named; ``camera``: the one on display. A reset would close the name field.
        """
        self._known, self._camera = known, camera
        newest = {person.person_id: person for person in persons}
        held = [newest.pop(row.person_id, replace(row, here=False)) for row in self.persons[:held_rows]]
        ordered = held + in_order(newest.values())
        moved = [person.person_id for person in ordered] != [person.person_id for person in self.persons]
        if moved:
            self._arrange(ordered, may_reset=may_reset)
        self.persons = ordered
        before, now = self.captions, captions(ordered)
        stay = {row: text for row, text in before.items() if row < len(held)}
        self.captions = stay | {row: text for row, text in now.items() if row >= len(held)}
        if self.refresh_ages() or moved or self.captions != before:
            self.changed.emit()

    def _arrange(self, ordered: list[PersonRow], *, may_reset: bool) -> None:
        """Remove, move and insert rows individually, so that the others persist, with the name field in one of them."""
        root, ids = QModelIndex(), {person.person_id for person in ordered}
        if may_reset and len({person.person_id for person in self.persons} ^ ids) > _MANY:
            self.beginResetModel()
            self.persons = ordered
            self.endResetModel()
            return
        for row in reversed(range(len(self.persons))):
            if self.persons[row].person_id not in ids:
                self.beginRemoveRows(root, row, row)
                del self.persons[row]
                self.endRemoveRows()
        for place, person in enumerate(ordered):
            rows = range(place, len(self.persons))
            came_from = next((row for row in rows if self.persons[row].person_id == person.person_id), None)
            if came_from is None:
                self.beginInsertRows(root, place, place)
                self.persons.insert(place, person)
                self.endInsertRows()
            elif came_from != place and self.beginMoveRows(root, came_from, came_from, root, place):
                self.persons.insert(place, self.persons.pop(came_from))
                self.endMoveRows()

    def refresh_ages(self) -> bool:
        """Refresh ages; only rows with changed text are repainted. Returns whether there were any."""
        shown, self._shown_states, any_changed = self._shown_states, {}, False
        for row, person in enumerate(self.persons):
            # Five hundred known people, whose rows have no age, cost nothing per second. The rest change continually.
            known = presence_of(person) == "known"
            lasting = person if known else replace(person, last_seen_ns=0, distance_m=None, bearing_rad=None)
            state = (lasting, self.knows(person.person_id), self.seen(person))
            self._shown_states[person.person_id] = state
            if state != shown.get(person.person_id):
                self.dataChanged.emit(self.index(row), self.index(row))
                any_changed = True
        return any_changed

    def seen(self, person: PersonRow) -> str:
        """Second line of the row."""
        parts = what_is_seen(person, self._present.now_ns(), camera_on_show=self._camera)
        return " · ".join([tr(UNCONFIRMED), *parts] if self.is_unconfirmed(person.person_id) else parts)

    def rowCount(self, parent: Index = QModelIndex()) -> int:  # noqa: B008 (Qt's own default)
        return 0 if parent.isValid() else len(self.persons)

    def flags(self, index: Index) -> Qt.ItemFlag:
        editable = self.may_decide and self.knows(self.persons[index.row()].person_id)
        return super().flags(index) | (Qt.ItemFlag.ItemIsEditable if editable else Qt.ItemFlag.NoItemFlags)

    def data(self, index: Index, role: int = int(Qt.ItemDataRole.DisplayRole)) -> Any:
        person = self.persons[index.row()]
        if role == Qt.ItemDataRole.DisplayRole:
            return text_formatting.person_name(person)
        if role in (Qt.ItemDataRole.AccessibleTextRole, Qt.ItemDataRole.ToolTipRole):
            name, maybe = text_formatting.person_name(person), text_formatting.maybe(person)
            text = ", ".join(filter(None, (name, maybe, person.group, *person.tags, self.seen(person))))
            if role == Qt.ItemDataRole.AccessibleTextRole:
                return text
            hint = tr("{person}. Click to select this person.") if self.may_decide else "{person}"
            return wrapped_tip(hint.format(person=text))
        return person if role == PERSON_ROLE else None


class PeopleList(FastTableView):
    """Rows with an in-place name field.

    Rows up to the mouse or the name field must not move: the first ``held_rows``; ``let_go`` ends that. New people
    appear below them at once.
    """

    named = Signal(str, str)  # person id, name
    naming_changed = Signal(str)  # person id, empty once editing ends
    let_go = Signal()
    action_requested = Signal(str, str)  # yes, no, same, not or card, pick for a click on the row; person id

    def __init__(self, theme: Theme, model: PeopleModel, portraits: PortraitPixmaps) -> None:
        super().__init__(row_px=ROW_PX)
        self._theme = theme
        self._people = model
        self.naming = ""  # the person whose name is being edited
        self._question_id = ""
        self._not_seen_yet = ""
        self._keys = ("", "")
        self.selected = ""
        self.controls: dict[str, RowControls] = {}
        self.setAccessibleName(tr("People"))
        self.setModel(model)
        self.name_field = SubmitLineEdit(self.viewport(), objectName="person_name_field", maxLength=60)
        self.name_field.hide()
        self.name_field.returnPressed.connect(self._on_name_entered)
        self.name_field.editingFinished.connect(self._on_name_left)
        self.setItemDelegate(PersonDelegate(theme, model, self, self.name_field, portraits))
        self.clicked.connect(lambda index: self.action_requested.emit("pick", model.persons[index.row()].person_id))
        self.doubleClicked.connect(lambda index: self.act("card", model.persons[index.row()].person_id))
        self.verticalScrollBar().valueChanged.connect(self._place_controls)
        model.changed.connect(self._on_changed)

    def let_decide(self, may_decide: bool) -> None:
        """Enable decisions about people: identity and selection."""
        self._people.may_decide = may_decide
        self.give_up_naming()
        self._place_controls()

    # ---- display

    def highlight_selected(self, person_id: str) -> None:
        if person_id != self.selected:
            self.selected = person_id
            self._place_controls()
            self.viewport().update()

    def show_asked(self, person_id: str, yes_key: str, no_key: str) -> None:
        """Set the row of the pending question, and its keys."""
        if (person_id, (yes_key, no_key)) != (self._question_id, self._keys):
            if person_id != self._question_id:
                self._not_seen_yet = person_id
            self._question_id, self._keys = person_id, (yes_key, no_key)
            self._place_controls()
            self._bring_question()

    def _bring_question(self) -> None:
        """Scroll a new question into view, once per list size; otherwise only the wizard scrolls."""
        row = self._people.row_of(self._not_seen_yet)
        # The rows may not be updated yet.
        if row is not None and self._people.persons[row].here and not self.held_rows:
            self._not_seen_yet = ""
            self.scrollTo(self._people.index(row))

    def bring_into_view(self, person_id: str) -> None:
        row = self._people.row_of(person_id)
        if row is not None:
            self.setCurrentIndex(self._people.index(row))
            self.scrollTo(self._people.index(row))

    def _on_changed(self) -> None:
        """Make room for captions: inserted or removed rows shift the heights of others."""
        rows = self.verticalHeader()
        for row in range(self._people.rowCount()):
            height_px = ROW_PX + CAPTION_PX if row in self._people.captions else ROW_PX
            if rows.sectionSize(row) != height_px:
                rows.resizeSection(row, height_px)
        self.updateEditorGeometries()
        self._place_controls()
        self._bring_question()

    def row_rect(self, row: int) -> QRect:
        """Rectangle of a row in the viewport, without the caption above."""
        rect = self.visualRect(self._people.index(row))
        return rect.adjusted(0, CAPTION_PX, 0, 0) if row in self._people.captions else rect

    def buttons(self, row: int) -> tuple[RowButton, ...]:
        """Buttons of a row, which exist while it is in view."""
        person = self._people.persons[row]
        if not self._people.may_decide or person.person_id == self.naming:
            return ()
        yes_key, no_key = self._keys if person.person_id == self._question_id else ("", "")
        return buttons_of(
            person,
            unconfirmed=self._people.is_unconfirmed(person.person_id),
            can_be_named=self._people.knows(person.person_id),
            yes_key=yes_key,
            no_key=no_key,
        )

    def _place_controls(self) -> None:
        """Put real buttons over the rows in view, and on no others, as there may be hundreds."""
        before, self.controls = self.controls, {}
        last = self.rowAt(self.viewport().height() - 1)
        in_view = range(max(0, self.rowAt(0)), (last if last >= 0 else self._people.rowCount() - 1) + 1)
        for row in in_view if self._people.may_decide else ():
            person = self._people.persons[row]
            controls = before.pop(person.person_id, None) or RowControls(self._theme, self, person.person_id)
            controls.show_row(person, self.buttons(row), selected=person.person_id == self.selected)
            controls.setGeometry(self.row_rect(row))
            controls.show()
            self.controls[person.person_id] = controls
        for gone in before.values():
            layouts.discard(gone)

    # ---- rows held in place

    @property
    def held_rows(self) -> int:
        rows = [self._people.row_of(self.naming)] if self.naming else []
        if self.viewport().underMouse():
            rows.append(self.rowAt(self.viewport().mapFromGlobal(QCursor.pos()).y()))
        return 1 + max((row for row in rows if row is not None), default=-1)

    def viewportEvent(self, event: QEvent) -> bool:
        if event.type() == QEvent.Type.Leave:
            self.let_go.emit()
        return super().viewportEvent(event)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._not_seen_yet = self._question_id
        self._bring_question()
        self._place_controls()

    # ---- name field

    def name(self, person_id: str) -> None:
        """Edit this person's name. A name being typed for this person stays."""
        if person_id and person_id == self.naming:
            focus_widget(self.name_field, Qt.FocusReason.OtherFocusReason)
            return
        self.give_up_naming()
        row = self._people.row_of(person_id)
        if row is None or not self._people.flags(self._people.index(row)) & Qt.ItemFlag.ItemIsEditable:
            return
        self.scrollTo(self._people.index(row))
        self.naming = person_id
        self.naming_changed.emit(person_id)
        self._place_controls()
        self.edit(self._people.index(row))
        self.name_field.selectAll()
        focus_widget(self.name_field, Qt.FocusReason.OtherFocusReason)

    def discard_orphaned_name(self) -> None:
        """Discard typing for a person who no longer exists: it must not reach another row or field."""
        if self.naming and not self._people.knows(self.naming) and not self.name_field.isReadOnly():
            self.name_field.clear()
            self.name_field.setReadOnly(True)
            self.name_field.setPlaceholderText(tr("Cannot be named: this person has left"))

    def _on_name_entered(self) -> None:
        name, person_id = " ".join(self.name_field.text().split()), self.naming
        self.give_up_naming()
        if name and self._people.knows(person_id):
            self.named.emit(person_id, name)

    def _on_name_left(self) -> None:
        """Discard a name that is left without Enter, but not one whose panel is moved or hidden."""
        if self.name_field.isVisible() and focused_widget() is not None:
            self.give_up_naming()

    def give_up_naming(self) -> None:
        self.closeEditor(self.name_field, QAbstractItemDelegate.EndEditHint.NoHint)

    def closeEditor(self, editor: QWidget, hint: QAbstractItemDelegate.EndEditHint) -> None:
        """Close the name field, which puts the focus on the list: never on the robot's speech field or driving."""
        if self.naming:
            self.naming = ""
            super().closeEditor(editor, hint)
            self.naming_changed.emit("")
            self._place_controls()
            self.viewport().update()
            self.let_go.emit()

    # ---- mouse and keyboard

    def act(self, act: str, person_id: str, _checked: bool = False) -> None:
        """Do what a button of the row is for, or with "pick" a click on the row itself."""
        row = self._people.row_of(person_id)
        if row is None or not self._people.may_decide:
            return
        # The current row changes as by a click, which does not scroll.
        self.setAutoScroll(False)
        self.setCurrentIndex(self._people.index(row))
        self.setAutoScroll(True)
        if act == "name":
            self.name(person_id)
        else:
            self.action_requested.emit(act, person_id)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        row, key = self.currentIndex().row(), event.key()
        person_id = self._people.persons[row].person_id if row >= 0 else ""
        if person_id and key in _ENTER and self._people.is_unconfirmed(person_id):
            self.act("same", person_id)
        elif person_id and key in (*_ENTER, Qt.Key.Key_F2):
            self.name(person_id)
        elif person_id and key == Qt.Key.Key_Space:
            self.action_requested.emit("pick", person_id)
        elif person_id and key == Qt.Key.Key_Right:
            self.act("card", person_id)
        else:
            super().keyPressEvent(event)


class RowControls(QPushButton):
    """Buttons over a painted row. Pressed by a screen reader, it selects the person; clicks reach the list below."""

    def __init__(self, theme: Theme, view: PeopleList, person_id: str) -> None:
        super().__init__(view.viewport())
        self._theme = theme
        self._view = view
        self._person_id = person_id
        self._shown: tuple[RowButton, ...] = ()
        self.buttons: dict[str, ActionButton] = {}
        self.setFlat(True)  # the row below is painted already
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.clicked.connect(partial(view.act, "pick", person_id))

    def show_row(self, person: PersonRow, buttons: tuple[RowButton, ...], *, selected: bool) -> None:
        self.setAccessibleName(tr("Select {name}").format(name=text_formatting.person_name(person)))
        self.setAccessibleDescription(tr("Selected") if selected else "")
        if buttons == self._shown:
            return
        self._shown = buttons
        self._view.viewport().update()
        before, self.buttons = self.buttons, {}
        for button in buttons:
            # A button keeps its act, so that a click that was begun does nothing else.
            control = before.pop(button.act) if button.act in before else self._new_button(button.act)
            self.buttons[button.act] = control
            role: ButtonRole = "amber" if button.act in ("yes", "same") else "plain" if button.text else "bare"
            control.set_label(button.text, icon=button.icon, role=role, name=button.tip, tip=wrapped_tip(button.tip))
            control.set_key(button.key)
            control.show()
        for gone in before.values():
            layouts.discard(gone)
        self._arrange()

    def _new_button(self, act: str) -> ActionButton:
        button = ActionButton(
            self._theme, height_px=_BUTTON_PX, text_px=tokens.STATUS_PX + 1, may_lose_words=True, parent=self
        )
        button.setObjectName(f"person_{act}")
        button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        button.clicked.connect(partial(self._view.act, act, self._person_id))
        return button

    def hitButton(self, _at: object) -> bool:
        return False

    def resizeEvent(self, _event: QResizeEvent) -> None:
        self._arrange()

    def _arrange(self) -> None:
        """Place the buttons, without key caps and without texts beside icons where they would hide the name."""
        room_px = self.width() - _TEXT_LEFT_PX - _SIDE_PX - _TEXT_AT_LEAST_PX
        for button in self.buttons.values():
            button.set_key_shown(True)
        fits = sum(button.sizeHint().width() + _BETWEEN_PX for button in self.buttons.values()) <= room_px
        right = self.width() - _SIDE_PX + 4
        for shown, button in zip(reversed(self._shown), reversed(self.buttons.values()), strict=True):
            button.set_key_shown(fits)
            width = (button.minimumSizeHint() if shown.icon and not fits else button.sizeHint()).width()
            right -= width
            button.setGeometry(right, self.rect().center().y() - _BUTTON_PX // 2, width, _BUTTON_PX)
            right -= _BETWEEN_PX
        self.words_end_px = right + _BETWEEN_PX - 8 if self.buttons else self.width() - _SIDE_PX


class PersonDelegate(RowDelegate):
    """Painted row with portrait, identity and state, and the name field."""

    def __init__(
        self, theme: Theme, model: PeopleModel, view: PeopleList, field: SubmitLineEdit, portraits: PortraitPixmaps
    ) -> None:
        super().__init__(theme, view)
        self._people = model
        self._view = view
        self._field = field
        self._portraits = portraits

    # ---- name field, one for all rows: what is typed in it survives changes of the rows

    def createEditor(self, _parent: QWidget, _option: QStyleOptionViewItem, index: Index) -> QWidget:
        person: PersonRow = index.data(PERSON_ROLE)
        self._field.setReadOnly(False)
        self._field.setPlaceholderText(tr("Name, then Enter"))
        self._field.setAccessibleName(tr("Name of {name}").format(name=text_formatting.person_name(person)))
        self._field.setText(person.name if text_formatting.has_given_name(person) else "")
        return self._field

    def destroyEditor(self, editor: QWidget, _index: Index) -> None:
        editor.hide()

    def setEditorData(self, _editor: QWidget, _index: Index) -> None:
        """Keep what is typed: Qt asks at each change of the row."""

    def setModelData(self, _editor: QWidget, _model: object, _index: Index) -> None:
        """Only Enter names: Qt would do so at a change of the current row, too."""

    def updateEditorGeometry(self, editor: QWidget, _option: QStyleOptionViewItem, index: Index) -> None:
        rect = self._view.row_rect(index.row())
        left = rect.left() + _TEXT_LEFT_PX - 6
        editor.setGeometry(left, rect.top() + 8, max(80, rect.right() - _SIDE_PX - left), rect.height() - 16)

    def eventFilter(self, _editor: QObject, _event: QEvent) -> bool:
        """Leave the keys to the field: Ctrl+Enter answers a question."""
        return False

    # ---- painting

    def paint_row(self, painter: QPainter, _rect: QRect, index: Index) -> None:
        theme, rect = self._theme, self._view.row_rect(index.row())
        person: PersonRow = index.data(PERSON_ROLE)
        naming = person.person_id == self._view.naming
        if caption := self._people.captions.get(index.row()):
            above = QRect(rect.left() + _SIDE_PX, rect.top() - CAPTION_PX, rect.width() - 2 * _SIDE_PX, CAPTION_PX)
            painter.setPen(QPen(theme.color("line"), 1))
            painter.drawLine(above.left(), above.top() + 3, above.right(), above.top() + 3)
            font = theme.font(tokens.STATUS_PX - 1, tokens.WEIGHT_SEMIBOLD)
            self.paint_text(painter, above.adjusted(0, 5, 0, 0), caption, font, "dim")
        if naming or person.person_id == self._view.selected:
            painter.fillRect(rect.adjusted(2, 1, -2, -1), theme.color("blue_soft"))
            painter.fillRect(QRect(rect.left() + 2, rect.top() + 1, 3, rect.height() - 2), theme.color("blue"))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        if self._view.hasFocus() and index.row() == self._view.currentIndex().row():
            painter.setPen(QPen(theme.color("blue"), 2))
            painter.drawRoundedRect(QRectF(rect).adjusted(3, 1, -3, -1), 6, 6)
        mark = QRect(rect.left() + _SIDE_PX, rect.center().y() - AVATAR_PX // 2, AVATAR_PX, AVATAR_PX)
        if not self._portraits.draw(painter, mark, person.portrait, may_wait=True):
            named = text_formatting.has_given_name(person)
            draw_avatar(painter, theme, mark.toRectF(), person.name, known=named, here=person.here)
        if naming or self._people.is_unconfirmed(person.person_id):
            pen = QPen(theme.color("blue"), 2.5)
            if self._people.is_unconfirmed(person.person_id):
                pen = QPen(theme.color("amber"), 2)
                pen.setDashPattern([2.5, 2.0])
            painter.setPen(pen)
            painter.drawEllipse(QRectF(mark).adjusted(-3, -3, 3, 3))
        if not naming:
            controls = self._view.controls.get(person.person_id)
            right = controls.words_end_px if controls else rect.right() - _SIDE_PX
            left = rect.left() + _TEXT_LEFT_PX
            self._paint_words(painter, QRect(left, rect.center().y() - 20, right - left, 20), person)

    def _paint_words(self, painter: QPainter, upper: QRect, person: PersonRow) -> None:
        """Paint the identity with group and tags, and the state below. A suggestion replaces the name."""
        small = self._theme.font(tokens.STATUS_PX)
        head = self._theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD)
        name, suggested = text_formatting.person_name(person), text_formatting.maybe(person)
        lower, below, lead, lead_role = upper.translated(0, 20), self._people.seen(person), "", ""
        if suggested:
            self.paint_text(painter, upper, suggested, head, "amber")
            below = f"{name} · {below}"
        else:
            used = self.paint_text(painter, upper, name, head, "text" if person.here else "dim") + 8
            rest = upper.adjusted(used, 1, 0, 1)
            if person.group:
                rest.setLeft(rest.left() + self.paint_text(painter, rest, person.group, small, "dim") + 8)
            self.paint_tags(painter, rest, person.tags)
            if self._people.is_unconfirmed(person.person_id):
                lead, lead_role = tr(UNCONFIRMED), "amber"
            elif person.speaking and below.startswith(tr(SPEAKING)):
                lead, lead_role = tr(SPEAKING), "green"
        if lead:
            lower.setLeft(lower.left() + self.paint_text(painter, lower, lead, small, lead_role))
        self.paint_text(painter, lower, below.removeprefix(lead), small, "dim")
