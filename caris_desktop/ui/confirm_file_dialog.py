"""Confirmation dialog for a scenario or robot profile that references other files, devices or servers."""

from typing import Literal

from PySide6.QtCore import QSize, Qt
from PySide6.QtWidgets import QDialog, QFrame, QGridLayout, QHBoxLayout, QLabel, QScrollArea, QVBoxLayout, QWidget

from caris_desktop.domain.printable import printable
from caris_desktop.domain.translation import tr
from caris_desktop.live.confirmed_files import KIND_TITLES, FileQuestion, FileReference
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.tab_order import VisualTabOrderMixin
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton


class ConfirmFileDialog(VisualTabOrderMixin, QDialog):
    """Non-modal dialog: the robot can be driven and stopped meanwhile. Cancel has the focus, so Enter means no."""

    def __init__(self, theme: Theme, parent: QWidget, question: FileQuestion) -> None:
        super().__init__(parent)
        self.setObjectName("confirm_file_dialog")
        self.setWindowTitle(tr("Confirm before use"))
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self._theme = theme
        heading = (
            tr("“{title}” has changed. May it use this?") if question.is_changed else tr("May “{title}” use this?")
        )
        self._heading = QLabel(heading.format(title=printable(question.title)), wordWrap=True)
        self._heading.setFont(theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        file = QLabel(_broken(str(question.path)), wordWrap=True)
        file.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        theme.color_text(file, "dim")
        hint = QLabel(
            tr(
                "Nothing in the file is used until you allow it. You will be asked again if the file refers to "
                "something new."
            ),
            wordWrap=True,
        )
        buttons = QHBoxLayout()
        cancel = ActionButton(theme, tr("Do not allow"), height_px=40)
        cancel.setObjectName("confirm_file_cancel")
        cancel.clicked.connect(self.reject)
        allow = ActionButton(theme, tr("Allow all"), height_px=40)
        allow.setObjectName("confirm_file_allow")
        allow.clicked.connect(self.accept)
        buttons.addStretch(1)
        buttons.addWidget(cancel)
        buttons.addWidget(allow)
        layout = layouts.vbox(self, margins_px=(24, 20, 24, 20), spacing_px=12)
        for widget in (self._heading, file, hint):
            layout.addWidget(widget)
        layout.addWidget(self._list(question), 1)
        layout.addLayout(buttons)
        cancel.setFocus()
        self.resize(self.sizeHint())  # Qt limits a dialog to two thirds of the screen; the list needs more

    def sizeHint(self) -> QSize:
        screen = self.screen()
        return QSize(860, 720 if screen is None else min(720, screen.availableGeometry().height() - 80))

    def _list(self, question: FileQuestion) -> QScrollArea:
        """List of references, unconfirmed ones first."""
        holder = QWidget()
        column = layouts.vbox(holder, margins_px=(0, 4, 8, 4), spacing_px=10)
        new = [one for one in question.named if one not in question.known]
        if question.is_changed:
            column.addWidget(self._caption(tr("New in this file"), "amber"))
        self._add_groups(column, new)
        if question.is_changed and len(new) < len(question.named):
            column.addWidget(self._caption(tr("Confirmed before"), "dim"))
            self._add_groups(column, [one for one in question.named if one in question.known])
        column.addStretch(1)
        scroll = QScrollArea(widgetResizable=True)
        scroll.setObjectName("confirm_file_list")
        scroll.setAccessibleName(tr("Items the file refers to"))
        scroll.setFrameShape(QFrame.Shape.NoFrame)
        scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        scroll.setWidget(holder)
        return scroll

    def _caption(self, text: str, color: Literal["amber", "dim"]) -> QLabel:
        caption = QLabel(text, wordWrap=True)
        self._theme.color_text(caption, color)
        return caption

    def _add_groups(self, column: QVBoxLayout, references: list[FileReference]) -> None:
        for kind, title in KIND_TITLES.items():
            of_kind = [one for one in references if one.kind == kind]
            if of_kind:
                column.addWidget(self._group(tr(title), of_kind))

    def _group(self, title: str, references: list[FileReference]) -> QWidget:
        group = QWidget()
        grid = QGridLayout(group)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setHorizontalSpacing(16)
        grid.setVerticalSpacing(2)
        grid.setColumnStretch(0, 3)
        grid.setColumnStretch(1, 2)
        heading = QLabel(title, wordWrap=True)
        heading.setFont(self._theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD))
        grid.addWidget(heading, 0, 0, 1, 2)
        for row, reference in enumerate(references, start=1):
            named = QLabel(_broken(reference.text), wordWrap=True)
            named.setObjectName("confirm_file_named")
            named.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            purpose = QLabel(reference.purpose, wordWrap=True)
            self._theme.color_text(purpose, "dim")
            grid.addWidget(named, row, 0, 1, 1 if reference.purpose else 2, Qt.AlignmentFlag.AlignTop)
            if reference.purpose:
                grid.addWidget(purpose, row, 1, Qt.AlignmentFlag.AlignTop)
        return group


def _broken(text: str) -> str:
    """Insert zero-width break opportunities into a long address or path."""
    text = printable(text)
    return "\u200b".join(text[start : start + 24] for start in range(0, len(text), 24))
