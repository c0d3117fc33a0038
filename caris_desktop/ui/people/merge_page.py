"""Page of the person popup that merges two people, with both portraits for comparison."""

from collections.abc import Sequence

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QHBoxLayout, QLabel, QVBoxLayout, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.people.presence import PersonRow
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.people.portrait_pixmaps import PortraitPixmaps
from caris_desktop.ui.people.portrait_view import PortraitView
from caris_desktop.ui.people.shown_people import found, in_order
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.submit_line_edit import SubmitLineEdit

_PORTRAIT_PX = 120
_OFFERED = 8


def who_stays(person: PersonRow, other: PersonRow) -> tuple[PersonRow, PersonRow]:
    """Direction of a merger: into the named person, else the known one."""
    rank = [(text_formatting.has_given_name(each), each.known, each is person) for each in (person, other)]
    return (other, person) if rank[0] >= rank[1] else (person, other)


class MergePage(QWidget):
    """Merge page. ``merged``: ids of the merged and the remaining person."""

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
        self._faces = (PortraitView(theme, pixmaps, _PORTRAIT_PX), PortraitView(theme, pixmaps, _PORTRAIT_PX))
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
        self._do = ActionButton(theme, tr("Same person"), icon="check", look="primary")
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
