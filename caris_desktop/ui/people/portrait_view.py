"""Portrait widget, with a placeholder for a missing portrait."""

from PySide6.QtCore import QRectF
from PySide6.QtGui import QAccessible, QPainter, QPaintEvent
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.people.presence import PersonRow
from caris_desktop.ui import text_formatting
from caris_desktop.ui.people.portrait_pixmaps import PortraitPixmaps
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets import avatar


class PortraitView(QWidget):
    accessible_role = QAccessible.Role.Graphic

    def __init__(self, theme: Theme, pixmaps: PortraitPixmaps, size_px: int) -> None:
        super().__init__()
        self._theme = theme
        self._pixmaps = pixmaps
        self._person: PersonRow | None = None
        self.setFixedSize(size_px, size_px)
        theme.changed.connect(self.update)

    def show_person(self, person: PersonRow | None) -> None:
        if person != self._person:
            self._person = person
            name = "" if person is None else text_formatting.person_name(person)
            self.setAccessibleName(tr("Portrait of {name}").format(name=name) if name else "")
            self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        person = self._person
        if person is None:
            return
        painter = QPainter(self)
        if not self._pixmaps.draw(painter, self.rect(), person.portrait):
            named = text_formatting.has_given_name(person)
            avatar.draw_avatar(painter, self._theme, QRectF(self.rect()), person.name, known=named, here=person.here)
