"""Confirmation dialog for a scenario or robot profile that references other files, devices or servers."""

from PySide6.QtCore import QSize, Qt
from PySide6.QtWidgets import QGridLayout, QScrollArea, QVBoxLayout, QWidget

from caris_desktop.domain.printable import printable
from caris_desktop.domain.translation import tr
from caris_desktop.live.confirmed_files import KIND_TITLES, FileQuestion, FileReference
from caris_desktop.ui import layouts
from caris_desktop.ui.form_dialog import FormDialog, lay_out_form
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import list_area
from caris_desktop.ui.widgets.labels import label

_SELECTABLE = Qt.TextInteractionFlag.TextSelectableByMouse


class ConfirmFileDialog(FormDialog):
    """Non-modal dialog: the robot can be driven and stopped meanwhile. Cancel has the focus, so Enter means no."""

    def __init__(self, theme: Theme, parent: QWidget, question: FileQuestion) -> None:
        super().__init__(theme, parent, "confirm_file_dialog", tr("Confirm before use"))
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        heading = (
            tr("“{title}” has changed. May it use this?") if question.is_changed else tr("May “{title}” use this?")
        )
        hint = tr(
            "Nothing in the file is used until you allow it. You will be asked again if the file refers to something "
            "new."
        )
        cancel, allow = (
            ActionButton(theme, text, height_px=40, objectName=f"confirm_file_{name}", clicked=run)
            for name, text, run in (
                ("cancel", tr("Do not allow"), self.reject),
                ("allow", tr("Allow all"), self.accept),
            )
        )
        lay_out_form(
            self,
            label(heading.format(title=printable(question.title)), "heading", wraps=True),
            label(_broken(str(question.path)), tone="dim", wraps=True, textInteractionFlags=_SELECTABLE),
            label(hint, wraps=True),
            (self._list(question), 1),
            buttons=(1, cancel, allow),
            scrolls=False,
        )
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
            column.addWidget(label(tr("New in this file"), tone="amber", wraps=True))
        self._add_groups(column, new)
        if question.is_changed and len(new) < len(question.named):
            column.addWidget(label(tr("Confirmed before"), tone="dim", wraps=True))
            self._add_groups(column, [one for one in question.named if one in question.known])
        column.addStretch(1)
        scroll = list_area(holder, framed=False)
        scroll.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        scroll.setObjectName("confirm_file_list")
        scroll.setAccessibleName(tr("Items the file refers to"))
        return scroll

    def _add_groups(self, column: QVBoxLayout, references: list[FileReference]) -> None:
        for kind, title in KIND_TITLES.items():
            of_kind = [one for one in references if one.kind == kind]
            if of_kind:
                column.addWidget(self._group(tr(title), of_kind))

    def _group(self, title: str, references: list[FileReference]) -> QWidget:
        group = QWidget()
        grid = QGridLayout(group)
        grid.setHorizontalSpacing(16)
        grid.setVerticalSpacing(2)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setColumnStretch(0, 3)
        grid.setColumnStretch(1, 2)
        grid.addWidget(label(title, "title", wraps=True), 0, 0, 1, 2)
        for row, reference in enumerate(references, start=1):
            named = label(
                _broken(reference.text), wraps=True, objectName="confirm_file_named", textInteractionFlags=_SELECTABLE
            )
            grid.addWidget(named, row, 0, 1, 1 if reference.purpose else 2, Qt.AlignmentFlag.AlignTop)
            if reference.purpose:
                purpose = label(reference.purpose, tone="dim", wraps=True)
                grid.addWidget(purpose, row, 1, Qt.AlignmentFlag.AlignTop)
        return group


def _broken(text: str) -> str:
    """Insert zero-width break opportunities into a long address or path."""
    text = printable(text)
    return "\u200b".join(text[start : start + 24] for start in range(0, len(text), 24))
