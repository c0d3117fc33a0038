"""Page of the person popup that confirms erasing a person."""

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QLabel, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.people.presence import PersonRow
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton


class ForgetPage(QWidget):
    """Confirmation page; ``forgotten`` carries the person id."""

    forgotten = Signal(str)
    back = Signal()

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._theme = theme
        self._person_id = ""
        self._title = QLabel()
        self._title.setObjectName("forget_title")
        self._what = QLabel()
        self._what.setObjectName("forget_what")
        self._not_now = QLabel(tr("A session is being recorded. Stop the recording first."))
        self._not_now.setObjectName("forget_not_now")
        for label in (self._title, self._what, self._not_now):
            label.setWordWrap(True)
        self._do = ActionButton(theme, tr("Erase permanently"), icon="trash", look="outline_danger")
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
        column.addWidget(self._what)
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
        self._what.setText(
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
        for label in (self._what, self._not_now):
            label.setFont(self._theme.font(tokens.STATUS_PX + 1))
        self._theme.color_text(self._not_now, "amber")
