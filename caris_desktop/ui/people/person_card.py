"""Person popup: identity, notes, consents and history of one person.

Part of the main window, not a separate window: driving continues, and Esc still stops the robot.
"""

from collections.abc import Callable, Sequence
from typing import Literal

from PySide6.QtCore import QEvent, QObject, QPoint, QRect, Qt, Signal
from PySide6.QtGui import QMouseEvent, QPaintEvent
from PySide6.QtWidgets import QHBoxLayout, QLabel, QScrollArea, QStackedWidget, QVBoxLayout, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import PersonHistory
from caris_desktop.people.presence import PersonRow
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.focus_widget import give_focus_back
from caris_desktop.ui.people.about_page import AboutPage
from caris_desktop.ui.people.portrait_pixmaps import PortraitPixmaps
from caris_desktop.ui.people.portrait_view import PortraitView
from caris_desktop.ui.people.shown_people import found, in_order, what_is_seen
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.elided_label import ElidedLabel
from caris_desktop.ui.widgets.submit_line_edit import SubmitLineEdit

WIDTH_PX = 400
_BELOW_TOP_BAR_PX = 62
_ABOVE_STATUS_BAR_PX = 38
_PORTRAIT_PX = 56

PageName = Literal["about", "merge", "forget"]


class PersonCard(QWidget):
    """Person popup. ``do`` sends intents; ``everyone`` returns candidates for a merger, ``recording`` whether a session
    is being recorded. ``recognise``: the scenario's setting.
    """

    def __init__(
        self,
        theme: Theme,
        window: QWidget,
        *,
        do: Callable[[Intent], object],
        pixmaps: PortraitPixmaps,
        everyone: Callable[[], Sequence[PersonRow]],
        recognise: str,
        recording: Callable[[], bool],
    ) -> None:
        super().__init__(window)
        self.setObjectName("person_card")
        self.setAttribute(Qt.WidgetAttribute.WA_NoMousePropagation)
        self._theme = theme
        self._window = window
        self._everyone = everyone
        self._recording = recording
        self._person: PersonRow | None = None
        self._now_ns = 0
        self._beside = QRect()
        self._dragged: QPoint | None = None
        self._focus_before: QWidget | None = None
        self._face = PortraitView(theme, pixmaps, _PORTRAIT_PX)
        self._name = ElidedLabel()
        self._name.setObjectName("person_card_name")
        self._last_seen = ElidedLabel()
        self._last_seen.setObjectName("person_card_seen")
        close = ActionButton(theme, "", icon="x", role="ghost", height_px=30)
        close.setObjectName("person_card_close")
        close.setAccessibleName(tr("Close the card"))
        close.clicked.connect(self.close_card)
        self.about = AboutPage(theme, do, recognise=recognise)
        self.about.merge_requested.connect(lambda: self.show_page("merge"))
        self.about.forget_requested.connect(lambda: self.show_page("forget"))
        self.merge = MergePage(theme, pixmaps)
        self.merge.back.connect(lambda: self.show_page("about"))
        self.merge.merged.connect(lambda one, into: self._decide(do, intents.MergePeople(one, into), into))
        self.forget = ForgetPage(theme)
        self.forget.back.connect(lambda: self.show_page("about"))
        self.forget.forgotten.connect(lambda person_id: self._decide(do, intents.ForgetPerson(person_id), ""))
        self._pages = QStackedWidget()
        for page in (self.about, self.merge, self.forget):
            scroll = QScrollArea(widgetResizable=True)
            scroll.setFocusPolicy(Qt.FocusPolicy.NoFocus)
            scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
            scroll.setWidget(page)
            self._pages.addWidget(scroll)
        self._arrange(close)
        window.installEventFilter(self)
        theme.restyle_on_change(self._style)
        self.hide()

    def _arrange(self, close: QWidget) -> None:
        texts = layouts.vbox(spacing_px=2)
        texts.addStretch(1)
        texts.addWidget(self._name)
        texts.addWidget(self._last_seen)
        texts.addStretch(1)
        head = layouts.hbox(margins_px=(14, 0, 8, 0), spacing_px=12)
        head.addWidget(self._face)
        head.addLayout(texts, 1)
        head.addWidget(close, 0, Qt.AlignmentFlag.AlignTop)
        column = layouts.vbox(self, margins_px=(1, 12, 1, 10), spacing_px=8)
        column.addLayout(head)
        column.addWidget(self._pages, 1)

    # ---- person

    @property
    def person_id(self) -> str:
        """Person of the open popup; empty if closed."""
        return "" if self.isHidden() or self._person is None else self._person.person_id

    @property
    def page(self) -> PageName:
        names: tuple[PageName, ...] = ("about", "merge", "forget")
        return names[self._pages.currentIndex()]

    def open_for(self, person: PersonRow, now_ns: int, beside: QRect) -> None:
        """Open next to the list at ``beside``, in window coordinates. Opening by click does not take the focus from
        driving.
        """
        if self.isHidden():
            self._focus_before = self._window.focusWidget()
        self._person = None
        self._beside = beside
        self.show()
        self.show_person(person, now_ns)
        self.show_page("about")
        self.raise_()

    def show_person(self, person: PersonRow, now_ns: int) -> None:
        """Refresh the person, or switch to another one."""
        newly = self._person is None or self._person.person_id != person.person_id
        if newly:
            self.about.begin_with(person)
        self._person = person
        self._now_ns = now_ns
        self._face.show_person(person)
        self._name.setText(text_formatting.person_name(person))
        self._last_seen.setText(" · ".join(what_is_seen(person, now_ns)))
        self.about.show_person(person, self._groups())
        if newly:
            self.about.request_history()
        if self.page == "merge":
            self.merge.show_person(person, self._everyone())

    def show_history(self, history: PersonHistory) -> None:
        self.about.show_history(history.person_id, history.entries, history.text)
        self._place()

    def _groups(self) -> list[str]:
        return sorted({person.group for person in self._everyone() if person.group})

    def show_page(self, name: PageName) -> None:
        person = self._person
        if person is None:
            return
        if name == "merge":
            self.merge.begin_with(person, self._everyone())
        elif name == "forget":
            self.forget.begin_with(person, recording=self._recording())
        self._pages.setCurrentIndex(("about", "merge", "forget").index(name))
        self._place()

    def _decide(self, do: Callable[[Intent], object], intent: Intent, stays: str) -> None:
        """Send a decision. Close the popup if its person no longer exists; after a merger show the remaining one."""
        do(intent)
        left = next((person for person in self._everyone() if person.person_id == stays), None)
        if left is None:
            self.close_card()
        else:
            self.show_person(left, self._now_ns)
            self.show_page("about")

    def step_back(self) -> None:
        """Esc: leave a question page first, then close. Unfinished input is discarded."""
        if self.isHidden():
            return
        if self.page != "about":
            self.show_page("about")
        else:
            self.about.give_up()
            self.close_card()

    def close_card(self) -> None:
        if self.isHidden():
            return
        held_focus = self.isAncestorOf(self._window.focusWidget()) if self._window.focusWidget() else False
        self.hide()
        if held_focus:
            give_focus_back(self._focus_before)

    # ---- placement and style

    def _place(self) -> None:
        """Cover the list's column only, so that video, speech and the red button stay visible.

        As tall as the current page, upwards from the list's lower edge.
        """
        room = self._window.rect().adjusted(8, _BELOW_TOP_BAR_PX, -8, -_ABOVE_STATUS_BAR_PX)
        width = min(WIDTH_PX, room.width())
        page = (self.about, self.merge, self.forget)[self._pages.currentIndex()]
        layout = page.layout()
        needed_px = 0 if layout is None else max(layout.heightForWidth(width - 16), layout.sizeHint().height())
        height = min(needed_px + _PORTRAIT_PX + 44, room.height())
        left = min(max(room.left(), self._beside.right() - width), room.right() - width)
        top = min(max(room.top(), self._beside.bottom() - height), room.bottom() - height)
        self.setGeometry(left, top, width, height)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if watched is self._window and event.type() == QEvent.Type.Resize and self.isVisible():
            room = self._window.rect().adjusted(8, _BELOW_TOP_BAR_PX, -8, -_ABOVE_STATUS_BAR_PX)
            height = min(self.height(), room.height())
            self.setGeometry(
                max(room.left(), min(self.x(), room.right() - self.width())),
                max(room.top(), min(self.y(), room.bottom() - height)), self.width(), height,
            )  # fmt: skip
        return False

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton and event.position().y() < _PORTRAIT_PX + 16:
            self._dragged = event.position().toPoint()

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        if self._dragged is not None:
            room = self._window.rect().adjusted(0, _BELOW_TOP_BAR_PX, 0, 0)
            at = self.mapToParent(event.position().toPoint()) - self._dragged
            self.move(
                max(room.left(), min(at.x(), room.right() - self.width())),
                max(room.top(), min(at.y(), room.bottom() - _PORTRAIT_PX)),
            )

    def mouseReleaseEvent(self, _event: QMouseEvent) -> None:
        self._dragged = None

    def _style(self) -> None:
        self._name.setFont(self._theme.font(tokens.BODY_PX + 2, tokens.WEIGHT_SEMIBOLD))
        self._theme.style_text(self._last_seen, "dim", tokens.STATUS_PX)
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        self._theme.paint_box(self, ground="panel", line="line_strong", radius_px=tokens.PANEL_RADIUS_PX)


class ForgetPage(QWidget):
    """Page of the person popup that confirms erasing a person.

    Confirmation page; ``forgotten`` carries the person id.
    """

    forgotten = Signal(str)
    back = Signal()

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._theme = theme
        self._person_id = ""
        self._title = QLabel()
        self._title.setObjectName("forget_title")
        self._details = QLabel()
        self._details.setObjectName("forget_what")
        self._not_now = QLabel(tr("A session is being recorded. Stop the recording first."))
        self._not_now.setObjectName("forget_not_now")
        for label in (self._title, self._details, self._not_now):
            label.setWordWrap(True)
        self._do = ActionButton(theme, tr("Erase permanently"), icon="trash", role="outline_danger")
        self._do.setObjectName("forget_do")
        self._do.clicked.connect(lambda: self.forgotten.emit(self._person_id))
        keep = ActionButton(theme, tr("Cancel"))
        keep.setObjectName("forget_keep")
        keep.clicked.connect(self.back)
        row = layouts.hbox(spacing_px=tokens.GRID_PX)
        row.addWidget(keep)
        row.addWidget(self._do)
        row.addStretch(1)
        column = layouts.vbox(self, margins_px=(14, 6, 14, 6), spacing_px=10)
        column.addWidget(self._title)
        column.addWidget(self._details)
        column.addWidget(self._not_now)
        column.addLayout(row)
        column.addStretch(1)
        theme.restyle_on_change(self._style)

    def begin_with(self, person: PersonRow, *, recording: bool) -> None:
        """Show the page; erasing is refused while a session is ``recording``, because the file being written cannot
        change.
        """
        name = text_formatting.person_name(person)
        self._person_id = person.person_id
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
        self._do.setEnabled(not recording)

    def _style(self) -> None:
        self._title.setFont(self._theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD))
        for label in (self._details, self._not_now):
            label.setFont(self._theme.font(tokens.STATUS_PX + 1))
        self._theme.color_text(self._not_now, "amber")


_COMPARED_PORTRAIT_PX = 120
_OFFERED = 8


def who_stays(person: PersonRow, other: PersonRow) -> tuple[PersonRow, PersonRow]:
    """Direction of a merger: into the named person, else the known one."""
    rank = [(text_formatting.has_given_name(each), each.known, each is person) for each in (person, other)]
    return (other, person) if rank[0] >= rank[1] else (person, other)


class MergePage(QWidget):
    """Page of the person popup that merges two people, with both portraits for comparison.

    Merge page. ``merged``: ids of the merged and the remaining person.
    """

    merged = Signal(str, str)
    back = Signal()

    def __init__(self, theme: Theme, pixmaps: PortraitPixmaps) -> None:
        super().__init__()
        self._theme = theme
        self._person: PersonRow | None = None
        self._other_id = ""
        self._everyone: Sequence[PersonRow] = ()
        self._title = QLabel(wordWrap=True)
        self._title.setObjectName("merge_title")
        self._field = SubmitLineEdit()
        self._field.setObjectName("merge_field")
        self._field.setPlaceholderText(tr("Name, group or tag"))
        self._field.setAccessibleName(tr("Find the person"))
        self._field.textChanged.connect(self._offer)
        self._field.returnPressed.connect(self._choose_first)
        self._offered = [ActionButton(theme, "", may_shrink=True, height_px=32) for _ in range(_OFFERED)]
        self._ids = [""] * _OFFERED
        self._faces = (
            PortraitView(theme, pixmaps, _COMPARED_PORTRAIT_PX),
            PortraitView(theme, pixmaps, _COMPARED_PORTRAIT_PX),
        )
        self._names = (QLabel(), QLabel())
        self._both = QWidget()
        both = layouts.hbox(self._both, margins_px=0)
        for face, name in zip(self._faces, self._names, strict=True):
            side = QVBoxLayout()
            name.setAlignment(Qt.AlignmentFlag.AlignHCenter)
            side.addWidget(face, 0, Qt.AlignmentFlag.AlignHCenter)
            side.addWidget(name)
            both.addLayout(side, 1)
        self._consequence = QLabel(wordWrap=True)
        self._consequence.setObjectName("merge_told")
        back = ActionButton(theme, tr("Back"), icon="caret-left")
        back.setObjectName("merge_back")
        back.clicked.connect(self._on_back)
        self._do = ActionButton(theme, tr("Same person"), icon="check", role="primary")
        self._do.setObjectName("merge_do")
        self._do.clicked.connect(self._on_do)
        row = QHBoxLayout()
        row.addWidget(back)
        row.addWidget(self._do)
        row.addStretch(1)
        column = layouts.vbox(self, margins_px=(14, 6, 14, 6), spacing_px=tokens.GRID_PX)
        for widget in (self._title, self._field):
            column.addWidget(widget)
        for number, button in enumerate(self._offered):
            button.setObjectName(f"merge_with_{number}")
            button.clicked.connect(lambda _checked=False, index=number: self._choose(self._ids[index]))
            column.addWidget(button)
        column.addWidget(self._both)
        column.addWidget(self._consequence)
        column.addLayout(row)
        column.addStretch(1)
        theme.restyle_on_change(self._style)

    def begin_with(self, person: PersonRow, everyone: Sequence[PersonRow]) -> None:
        self._other_id = ""
        self._field.clear()
        self.show_person(person, everyone)

    def show_person(self, person: PersonRow, everyone: Sequence[PersonRow]) -> None:
        self._person, self._everyone = person, everyone
        self._offer()

    def _other(self) -> PersonRow | None:
        return next((each for each in self._everyone if each.person_id == self._other_id), None)

    def _offer(self, _text: str = "") -> None:
        person, other = self._person, self._other()
        if person is None:
            return
        name = text_formatting.person_name(person)
        comparing = other is not None
        who = tr("Who is the same person as {name}?").format(name=name)
        self._title.setText(tr("Are these the same person?") if comparing else who)
        self._field.setVisible(not comparing)
        self._both.setVisible(comparing)
        self._consequence.setVisible(comparing)
        self._do.setVisible(comparing)
        fits = [] if comparing else self._who_fits(person)
        for number, button in enumerate(self._offered):
            button.setVisible(number < len(fits))
            if number < len(fits):
                self._ids[number] = fits[number].person_id
                button.set_label(
                    " · ".join(filter(None, (text_formatting.person_name(fits[number]), fits[number].group)))
                )
        if other is not None:
            self._compare(person, other)

    def _who_fits(self, person: PersonRow) -> list[PersonRow]:
        """Candidates, suggested ones first."""
        likely = [suggestion.person_id for suggestion in person.suggestions]
        others = [each for each in in_order(self._everyone) if each.person_id != person.person_id]
        others.sort(key=lambda each: likely.index(each.person_id) if each.person_id in likely else len(likely))
        return [each for each in others if found(each, self._field.text())][:_OFFERED]

    def _compare(self, person: PersonRow, other: PersonRow) -> None:
        for face, name, each in zip(self._faces, self._names, (person, other), strict=True):
            face.show_person(each)
            name.setText(text_formatting.person_name(each))
        goes, stays = who_stays(person, other)
        self._consequence.setText(
            tr("The visits, photos and notes of {goes} are moved to {stays}. You can undo this.").format(
                goes=text_formatting.person_name(goes), stays=text_formatting.person_name(stays)
            )
        )

    def _choose(self, person_id: str) -> None:
        self._other_id = person_id
        self._offer()

    def _choose_first(self) -> None:
        if self._person is not None and (fits := self._who_fits(self._person)):
            self._choose(fits[0].person_id)

    def _on_back(self) -> None:
        if self._other() is None:
            self.back.emit()
        else:
            self._choose("")

    def _on_do(self) -> None:
        person, other = self._person, self._other()
        if person is not None and other is not None:
            goes, stays = who_stays(person, other)
            self.merged.emit(goes.person_id, stays.person_id)

    def _style(self) -> None:
        self._title.setFont(self._theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD))
        self._consequence.setFont(self._theme.font(tokens.STATUS_PX + 1))
        for name in self._names:
            name.setFont(self._theme.font(tokens.STATUS_PX + 1))
