"""List view of the People panel: painting, mouse input, names edited in place."""

from PySide6.QtCore import QEvent, QPoint, QRect, QRectF, Qt, Signal
from PySide6.QtGui import (
    QCursor,
    QEnterEvent,
    QFont,
    QFontMetrics,
    QHelpEvent,
    QHideEvent,
    QKeyEvent,
    QMouseEvent,
    QPainter,
    QPen,
    QResizeEvent,
)
from PySide6.QtWidgets import QStyle, QStyledItemDelegate, QStyleOptionViewItem, QToolTip

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.people.presence import PersonRow
from caris_desktop.ui import text_formatting, tokens
from caris_desktop.ui.focus_widget import focus_widget
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.people.people_model import PERSON_ROLE, Index, PeopleModel
from caris_desktop.ui.people.portrait_pixmaps import PortraitPixmaps
from caris_desktop.ui.people.shown_people import SPEAKING, UNCONFIRMED, RowButton, buttons_of
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets import avatar
from caris_desktop.ui.widgets.accessible_regions import AccessibleRegion
from caris_desktop.ui.widgets.fast_table_view import FastTableView
from caris_desktop.ui.widgets.key_cap import draw_key_cap, key_cap_width
from caris_desktop.ui.widgets.submit_line_edit import SubmitLineEdit
from caris_desktop.ui.wrapped_tip import wrapped_tip

ROW_PX = 52
CAPTION_PX = 26
_SIDE_PX = 14
_GAP_PX = 12
_BUTTON_PX = 30
_ICON_PX = 17
_TEXT_AT_LEAST_PX = 96
_ENTER = (Qt.Key.Key_Return, Qt.Key.Key_Enter)
_NAME_HINT = QT_TR_NOOP("Name, then Enter")
_NOBODY_HINT = QT_TR_NOOP("Cannot be named: this person has left")


class PeopleList(FastTableView):
    """Rows with an in-place name field.

    Rows up to the mouse or the name field must not move: the first ``held_rows``; ``let_go`` ends that. New people
    appear below them at once. Decisions need ``let_decide``: not without naming permission, and not in a replay.
    """

    named = Signal(str, str)  # person id, name
    naming_changed = Signal(str)  # person id, empty once editing ends
    let_go = Signal()
    picked = Signal(str)  # person id: a click on the row
    action_requested = Signal(str, str)  # yes, no, same, not or card; person id

    def __init__(self, theme: Theme, model: PeopleModel, portraits: PortraitPixmaps) -> None:
        super().__init__(row_px=ROW_PX)
        self._theme = theme
        self._people = model
        self._may_decide = False
        self._naming = ""  # the person whose name is being edited
        self._under_mouse: QPoint | None = None
        self._pressed: tuple[str, str] | None = None
        self._selected = ""
        self._question_id = ""
        self._not_seen_yet = ""
        self._keys = ("", "")
        self.setAccessibleName(tr("People"))
        self.setModel(model)
        self.setItemDelegate(PersonDelegate(theme, model, self, portraits))
        self.setMouseTracking(True)
        self._field = SubmitLineEdit(self.viewport())
        self._field.setObjectName("person_name_field")
        self._field.setMaxLength(60)
        self._field.hide()
        self._field.returnPressed.connect(self._on_name_entered)
        # Leaving without Enter discards the name.
        self._field.editingFinished.connect(self._close_field)
        self.verticalScrollBar().valueChanged.connect(self._place_field)
        for changed in (model.rowsInserted, model.rowsRemoved, model.rowsMoved, model.modelReset):
            changed.connect(self._place_field)
        model.arranged.connect(self._make_room_for_captions)

    def let_decide(self, may_decide: bool) -> None:
        """Enable decisions about people: identity and selection."""
        self._may_decide = may_decide
        self.give_up_naming()
        self.viewport().update()

    # ---- display

    def highlight_selected(self, person_id: str) -> None:
        """Highlight the selected person."""
        if person_id != self._selected:
            self._selected = person_id
            self.viewport().update()

    def show_asked(self, person_id: str, yes_key: str, no_key: str) -> None:
        """Set the row of the pending question, and its keys."""
        if (person_id, (yes_key, no_key)) != (self._question_id, self._keys):
            if person_id != self._question_id:
                self._not_seen_yet = person_id
            self._question_id, self._keys = person_id, (yes_key, no_key)
            self.viewport().update()
            self._bring_question()

    def _bring_question(self) -> None:
        """Scroll a new question into view, once per list size; otherwise only the wizard scrolls."""
        row = self._people.row_of(self._not_seen_yet)
        # The rows may not be updated yet.
        if row is not None and self._people.persons[row].here and not self.held_rows:
            self._not_seen_yet = ""
            self.scrollTo(self._people.index(row))

    @property
    def selected(self) -> str:
        return self._selected

    def bring_into_view(self, person_id: str) -> None:
        row = self._people.row_of(person_id)
        if row is not None:
            self.setCurrentIndex(self._people.index(row))
            self.scrollTo(self._people.index(row))

    def _make_room_for_captions(self) -> None:
        rows, tall = self.verticalHeader(), self._people.captions
        for row in range(self._people.rowCount()):
            height_px = ROW_PX + CAPTION_PX if row in tall else ROW_PX
            # Inserted or removed rows shift the heights of others.
            if rows.sectionSize(row) != height_px:
                rows.resizeSection(row, height_px)
        self._place_field()
        self._bring_question()

    def row_rect(self, row: int) -> QRect:
        """Rectangle of a row in the viewport, without the caption above."""
        rect = self.visualRect(self._people.index(row))
        return rect.adjusted(0, CAPTION_PX, 0, 0) if row in self._people.captions else rect

    def buttons(self, row: int) -> list[tuple[RowButton, QRect]]:
        """Buttons of a row with their rectangles in the viewport."""
        person = self._people.persons[row]
        if not self._may_decide:
            return []
        yes_key, no_key = self._keys if person.person_id == self._question_id else ("", "")
        buttons = buttons_of(
            person,
            unconfirmed=self._people.is_unconfirmed(person.person_id) and person.person_id != self._naming,
            can_be_named=person.person_id != self._naming and self._people.knows(person.person_id),
            yes_key=yes_key,
            no_key=no_key,
        )
        rect = self.row_rect(row)
        room = rect.width() - 2 * _SIDE_PX - avatar.SIZE_PX - _GAP_PX - _TEXT_AT_LEAST_PX
        for with_keys, with_texts in ((True, True), (False, True), (False, False)):
            widths = [self._width(button, with_key=with_keys, with_text=with_texts) for button in buttons]
            if sum(widths) + 6 * len(widths) <= room:
                break
        placed = []
        right = rect.right() - _SIDE_PX + 4
        for button, width in zip(reversed(buttons), reversed(widths), strict=True):
            right -= width
            placed.append((button, QRect(right, rect.center().y() - _BUTTON_PX // 2, width, _BUTTON_PX)))
            right -= 6
        return placed[::-1]

    def accessible_spots(self) -> list[AccessibleRegion]:
        """Accessible regions for clicks in visible rows; the row text is in the table's cells."""
        spots = []
        for row, person in enumerate(self._people.persons):
            rect = self.row_rect(row)
            if not rect.intersects(self.viewport().rect()):
                continue
            selected = tr("Selected") if person.person_id == self._selected else ""
            name = text_formatting.person_name(person)
            if self._may_decide:
                spots.append(
                    AccessibleRegion(("pick", person.person_id), tr("Select {name}").format(name=name), rect, selected)
                )
            for button, place in self.buttons(row):
                spots.append(AccessibleRegion((button.act, person.person_id), button.tip, place, button.key))
        return spots

    def press_accessible(self, key: tuple[str, ...]) -> None:
        """Handle an accessible press like a click."""
        act, person_id = key
        if self._people.row_of(person_id) is not None:
            self._act(act, person_id)

    def button_rect(self, row: int, act: str = "name") -> QRect:
        """Rectangle of a row's button in the viewport; empty without such a button."""
        return next((rect for button, rect in self.buttons(row) if button.act == act), QRect())

    def _width(self, button: RowButton, *, with_key: bool, with_text: bool) -> int:
        if not button.text or (button.icon and not with_text):
            return _BUTTON_PX
        width = QFontMetrics(self._theme.font(tokens.STATUS_PX + 1)).horizontalAdvance(button.text) + 20
        width += _ICON_PX + 6 if button.icon else 0
        return width + (round(key_cap_width(self._theme, button.key)) + 6 if button.key and with_key else 0)

    # ---- rows held in place

    @property
    def held_rows(self) -> int:
        rows = [self._people.row_of(self._naming)] if self._naming else []
        if self._under_mouse is not None:
            rows.append(self.indexAt(self._under_mouse).row())
        return 1 + max((row for row in rows if row is not None), default=-1)

    def viewportEvent(self, event: QEvent) -> bool:
        if isinstance(event, QEnterEvent | QMouseEvent):
            self._under_mouse = event.position().toPoint()
        elif event.type() == QEvent.Type.Leave:
            self._on_mouse_away()
        if event.type() == QEvent.Type.ToolTip and isinstance(event, QHelpEvent):
            self._show_tip(event)
            return True
        return super().viewportEvent(event)

    def _show_tip(self, event: QHelpEvent) -> None:
        row = self.indexAt(event.pos()).row()
        if row < 0:
            QToolTip.hideText()
            return
        button = self._button_at(event.pos())
        text = str(self._people.index(row).data(Qt.ItemDataRole.AccessibleTextRole))
        if self._may_decide:
            text = tr("{person}. Click to select this person.").format(person=text)
        QToolTip.showText(event.globalPos(), wrapped_tip(button[0].tip if button else text), self)

    def hideEvent(self, event: QHideEvent) -> None:
        # A hidden widget receives no leave event.
        self._under_mouse = None
        self._close_field()
        super().hideEvent(event)

    def _on_mouse_away(self) -> None:
        self._under_mouse = None
        self.let_go.emit()

    # ---- name field

    @property
    def naming(self) -> str:
        """Person whose name is being edited; empty if none."""
        return self._naming

    def name(self, person_id: str) -> None:
        """Edit this person's name."""
        row = self._people.row_of(person_id)
        if row is None or not self._may_decide or not self._people.knows(person_id):
            return
        person = self._people.persons[row]
        self._field.setReadOnly(False)
        self._field.setPlaceholderText(tr(_NAME_HINT))
        self.scrollTo(self._people.index(row))
        self._naming = person_id
        self.naming_changed.emit(person_id)
        self.viewport().update()
        self._field.setAccessibleName(tr("Name of {name}").format(name=text_formatting.person_name(person)))
        self._field.setText(person.name if text_formatting.has_given_name(person) else "")
        self._place_field()
        self._field.show()
        self._field.selectAll()
        focus_widget(self._field, Qt.FocusReason.OtherFocusReason)

    def _place_field(self) -> None:
        if not self._naming:
            return
        row = self._people.row_of(self._naming)
        if row is None:
            self._close_field()
            return
        rect = self.row_rect(row)
        left = rect.left() + _SIDE_PX + avatar.SIZE_PX + _GAP_PX - 6
        self._field.setGeometry(left, rect.top() + 8, max(80, rect.right() - _SIDE_PX - left), rect.height() - 16)

    def discard_orphaned_name(self) -> None:
        """Discard typing for a person who no longer exists: it must not reach another row or field."""
        if self._naming and not self._people.knows(self._naming) and not self._field.isReadOnly():
            self._field.clear()
            self._field.setReadOnly(True)
            self._field.setPlaceholderText(tr(_NOBODY_HINT))

    def give_up_naming(self) -> None:
        """Cancel editing the name."""
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
            # Qt would focus the next widget, which may be the robot's speech field or driving.
            self.setFocus(Qt.FocusReason.OtherFocusReason)
        self._naming = ""
        self._field.hide()
        self.naming_changed.emit("")
        self.viewport().update()
        self.let_go.emit()

    # ---- mouse and keyboard

    def _button_at(self, at: QPoint) -> tuple[RowButton, str] | None:
        """Button at a point, with its person."""
        row = self.indexAt(at).row()
        if row < 0:
            return None
        person_id = self._people.persons[row].person_id
        return next(((button, person_id) for button, rect in self.buttons(row) if rect.contains(at)), None)

    def _spot(self, event: QMouseEvent) -> tuple[str, str]:
        """Action and person of a click: a button's, else picking the row."""
        at = event.position().toPoint()
        button = self._button_at(at)
        if button is not None:
            return button[0].act, button[1]
        row = self.indexAt(at).row()
        return ("pick", self._people.persons[row].person_id) if row >= 0 else ("", "")

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton:
            self._pressed = self._spot(event)
        super().mousePressEvent(event)

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        pressed, self._pressed = self._pressed, None
        super().mouseReleaseEvent(event)
        if pressed is not None and pressed == self._spot(event):
            self._act(*pressed)

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        act, person_id = self._spot(event)
        if act == "pick" and self._may_decide:
            self.action_requested.emit("card", person_id)

    def _act(self, act: str, person_id: str) -> None:
        if act == "name":
            self.name(person_id)
        elif act == "pick":
            self.picked.emit(person_id)
        elif act:
            self.action_requested.emit(act, person_id)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        super().mouseMoveEvent(event)
        self.viewport().update()  # hover highlight of buttons

    def leaveEvent(self, event: QEvent) -> None:
        super().leaveEvent(event)
        self.viewport().update()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        row = self.currentIndex().row()
        person_id = self._people.persons[row].person_id if row >= 0 else ""
        key = event.key()
        if not person_id:
            super().keyPressEvent(event)
        elif key in _ENTER and self._may_decide and self._people.is_unconfirmed(person_id):
            self.action_requested.emit("same", person_id)
        elif key in (*_ENTER, Qt.Key.Key_F2):
            self.name(person_id)
        elif key == Qt.Key.Key_Space:
            self.picked.emit(person_id)
        elif key == Qt.Key.Key_Right and self._may_decide:
            self.action_requested.emit("card", person_id)
        else:
            super().keyPressEvent(event)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._place_field()
        self._not_seen_yet = self._question_id
        self._bring_question()


class PersonDelegate(QStyledItemDelegate):
    """Row with portrait, identity, state and buttons."""

    def __init__(self, theme: Theme, model: PeopleModel, view: PeopleList, portraits: PortraitPixmaps) -> None:
        super().__init__(view)
        self._theme = theme
        self._people = model
        self._view = view
        self._portraits = portraits

    def paint(self, painter: QPainter, option: QStyleOptionViewItem, index: Index) -> None:
        theme, rect = self._theme, self._view.row_rect(index.row())
        person: PersonRow = index.data(PERSON_ROLE)
        named = text_formatting.has_given_name(person)
        painter.save()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        caption = self._people.captions.get(index.row())
        if caption:
            self._paint_caption(painter, QRect(rect.left(), rect.top() - CAPTION_PX, rect.width(), CAPTION_PX), caption)
        naming = person.person_id == self._view.naming
        if naming or person.person_id == self._view.selected:
            painter.fillRect(rect.adjusted(2, 1, -2, -1), theme.color("blue_soft"))
            painter.fillRect(QRect(rect.left() + 2, rect.top() + 1, 3, rect.height() - 2), theme.color("blue"))
        if self._view.hasFocus() and index.row() == self._view.currentIndex().row():
            painter.setPen(QPen(theme.color("blue"), 2))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(QRectF(rect).adjusted(3, 1, -3, -1), 6, 6)
        mark = QRect(rect.left() + _SIDE_PX, rect.center().y() - avatar.SIZE_PX // 2, avatar.SIZE_PX, avatar.SIZE_PX)
        if not self._portraits.draw(painter, mark, person.portrait, may_wait=True):
            avatar.draw_avatar(painter, theme, mark.toRectF(), person.name, known=named, here=person.here)
        if naming:
            painter.setPen(QPen(theme.color("blue"), 2.5))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawEllipse(QRectF(mark).adjusted(-3, -3, 3, 3))
        if self._people.is_unconfirmed(person.person_id):
            pen = QPen(theme.color("amber"), 2)
            pen.setDashPattern([2.5, 2.0])
            painter.setPen(pen)
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawEllipse(QRectF(mark).adjusted(-3, -3, 3, 3))
        buttons = self._view.buttons(index.row())
        left = mark.right() + _GAP_PX
        right = buttons[0][1].left() - 8 if buttons else rect.right() - _SIDE_PX
        if person.person_id != self._view.naming:
            self._paint_words(painter, QRect(left, rect.center().y() - 20, right - left, 40), person)
            hovered = bool(option.state & QStyle.StateFlag.State_MouseOver)
            for button, place in buttons:
                self._paint_button(painter, place, button, hovered=hovered)
        painter.restore()

    def _paint_caption(self, painter: QPainter, rect: QRect, text: str) -> None:
        theme = self._theme
        painter.setPen(QPen(theme.color("line"), 1))
        painter.drawLine(rect.left() + _SIDE_PX, rect.top() + 3, rect.right() - _SIDE_PX, rect.top() + 3)
        painter.setFont(theme.font(tokens.STATUS_PX - 1, tokens.WEIGHT_SEMIBOLD))
        painter.setPen(theme.color("dim"))
        painter.drawText(
            rect.adjusted(_SIDE_PX, 5, -_SIDE_PX, 0), int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter),
            text,
        )  # fmt: skip

    def _paint_words(self, painter: QPainter, rect: QRect, person: PersonRow) -> None:
        """Paint the identity with group and tags, and the state below. A suggestion replaces the name."""
        theme = self._theme
        suggested = text_formatting.maybe(person)
        head = theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD)
        small = theme.font(tokens.STATUS_PX)
        role = "amber" if suggested else "text" if person.here else "dim"
        upper = QRect(rect.left(), rect.top(), rect.width(), 20)
        used = self._paint_cut(painter, upper, suggested or text_formatting.person_name(person), head, role)
        rest = upper.adjusted(used + 8, 1, 0, 1)
        if person.group and not suggested:
            used = self._paint_cut(painter, rest, person.group, small, "dim")
            rest = rest.adjusted(used + 8, 0, 0, 0)
        for tag in person.tags if not suggested else ():
            width = QFontMetrics(small).horizontalAdvance(tag) + 12
            if width > rest.width():
                break
            painter.setPen(QPen(theme.color("line_strong"), 1))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(QRectF(rest.left() + 0.5, rest.top() + 1.5, width, 17), 5, 5)
            painter.setFont(small)
            painter.setPen(theme.color("dim"))
            painter.drawText(QRect(rest.left(), rest.top(), width + 1, 20), Qt.AlignmentFlag.AlignCenter, tag)
            rest = rest.adjusted(width + 6, 0, 0, 0)
        last_seen = self._people.seen(person)
        below = f"{text_formatting.person_name(person)} · {last_seen}" if suggested else last_seen
        lower = QRect(rect.left(), rect.top() + 20, rect.width(), 20)
        if self._people.is_unconfirmed(person.person_id):
            mark = tr(UNCONFIRMED)
            used = self._paint_cut(painter, lower, mark, small, "amber")
            lower, below = lower.adjusted(used, 0, 0, 0), below.removeprefix(mark)
        speaking = tr(SPEAKING)
        if person.speaking and last_seen.startswith(speaking) and not suggested:
            used = self._paint_cut(painter, lower, speaking, small, "green")
            lower, below = lower.adjusted(used, 0, 0, 0), below.removeprefix(speaking)
        self._paint_cut(painter, lower, below, small, "dim")

    def _paint_cut(self, painter: QPainter, rect: QRect, text: str, font: QFont, role: str) -> int:
        """Paint elided text; returns its width."""
        painter.setFont(font)
        painter.setPen(self._theme.color(role))
        metrics = QFontMetrics(font)
        cut = metrics.elidedText(text, Qt.TextElideMode.ElideRight, max(0, rect.width()))
        painter.drawText(rect, int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter), cut)
        return metrics.horizontalAdvance(cut)

    def _paint_button(self, painter: QPainter, rect: QRect, button: RowButton, *, hovered: bool) -> None:
        theme = self._theme
        under = hovered and rect.contains(self._view.viewport().mapFromGlobal(QCursor.pos()))
        asks = button.act in ("yes", "same")
        bare = not button.text or rect.width() == _BUTTON_PX
        painter.setPen(QPen(theme.color("amber" if asks else "line"), 1) if not bare or under else Qt.PenStyle.NoPen)
        ground = "raised_hover" if under else "amber_soft" if asks else "raised"
        painter.setBrush(theme.color(ground) if not bare or under else Qt.BrushStyle.NoBrush)
        painter.drawRoundedRect(
            QRectF(rect).adjusted(0.5, 0.5, -0.5, -0.5), tokens.CONTROL_RADIUS_PX, tokens.CONTROL_RADIUS_PX
        )
        if bare:
            color = theme.color("text" if under else "dim")
            draw_icon(painter, QRectF(rect.center().x() - 8, rect.center().y() - 8, 17, 17), button.icon, color)
            return
        font = theme.font(tokens.STATUS_PX + 1)
        left = rect.left() + 10
        if button.icon:
            draw_icon(painter, QRectF(left, rect.center().y() - 8, 17, 17), button.icon, theme.color("text"))
            left += _ICON_PX + 6
        painter.setFont(font)
        painter.setPen(theme.color("text"))
        width = QFontMetrics(font).horizontalAdvance(button.text)
        painter.drawText(
            QRect(left, rect.top(), width + 2, rect.height()),
            int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter), button.text,
        )  # fmt: skip
        left += width + 6
        if button.key and left + key_cap_width(theme, button.key) < rect.right():
            draw_key_cap(painter, theme, button.key, left, rect.center().y())
