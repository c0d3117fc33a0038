"""What a scenario or robot profile names outside of its file: listed once, before anything of it is used."""

from PySide6.QtCore import QSize, Qt
from PySide6.QtWidgets import QDialog, QFrame, QGridLayout, QHBoxLayout, QLabel, QScrollArea, QWidget

from caris_desktop.domain.printable import printable
from caris_desktop.domain.translation import tr
from caris_desktop.live.confirmed_files import KIND_TITLES, FileQuestion, FileReference, ReferenceKind
from caris_desktop.ui import boxes, tokens
from caris_desktop.ui.tab_order import TabAsRead
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton


class ConfirmFileDialog(TabAsRead, QDialog):
    """Not modal: the robot can be driven and stopped meanwhile. Cancel has the focus, so Enter is a no."""

    def __init__(self, theme: Theme, parent: QWidget, question: FileQuestion) -> None:
        super().__init__(parent)
        self.setObjectName("confirm_file_dialog")
        self.setWindowTitle(tr("Before it is used"))
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self._theme = theme
        heading = (
            tr("“{title}” has changed. May it use this?") if question.is_changed else tr("May “{title}” use this?")
        )
        self._heading = _label(heading.format(title=printable(question.title)))
        self._heading.setFont(theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        file = _label(_broken(str(question.path)))
        file.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        theme.color_text(file, "dim")
        hint = _label(
            tr("Nothing of the file is used until you allow it. You are asked again if the file names something new.")
        )
        buttons = QHBoxLayout()
        cancel = ActionButton(theme, tr("Do not use it"), height_px=40)
        cancel.setObjectName("confirm_file_cancel")
        cancel.clicked.connect(self.reject)
        allow = ActionButton(theme, tr("Allow all of this"), look="primary", height_px=40)
        allow.setObjectName("confirm_file_allow")
        allow.clicked.connect(self.accept)
        buttons.addStretch(1)
        buttons.addWidget(cancel)
        buttons.addWidget(allow)
        layout = boxes.column(self, margins_px=(24, 20, 24, 20), spacing_px=12)
        for widget in (self._heading, file, hint):
            layout.addWidget(widget)
        layout.addWidget(self._list(question), 1)
        layout.addLayout(buttons)
        cancel.setFocus()

    def sizeHint(self) -> QSize:
        return QSize(720, 560)

    def _list(self, question: FileQuestion) -> QScrollArea:
        holder = QWidget()
        column = boxes.column(holder, margins_px=(0, 4, 8, 4), spacing_px=16)
        for kind in KIND_TITLES:
            of_kind = [one for one in question.named if one.kind == kind]
            if of_kind:
                column.addWidget(self._group(kind, of_kind, question))
        column.addStretch(1)
        scroll = QScrollArea(widgetResizable=True)
        scroll.setObjectName("confirm_file_list")
        scroll.setAccessibleName(tr("What the file names"))
        scroll.setFrameShape(QFrame.Shape.NoFrame)
        scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        scroll.setWidget(holder)
        return scroll

    def _group(self, kind: ReferenceKind, references: list[FileReference], question: FileQuestion) -> QWidget:
        group = QWidget()
        grid = QGridLayout(group)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setHorizontalSpacing(16)
        grid.setColumnStretch(0, 3)
        grid.setColumnStretch(1, 2)
        title = _label(tr(KIND_TITLES[kind]))
        title.setFont(self._theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD))
        grid.addWidget(title, 0, 0, 1, 3)
        for row, reference in enumerate(references, start=1):
            named = _label(_broken(reference.text))
            named.setObjectName("confirm_file_named")
            named.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            purpose = _label(reference.purpose)
            self._theme.color_text(purpose, "dim")
            grid.addWidget(named, row, 0, Qt.AlignmentFlag.AlignTop)
            grid.addWidget(purpose, row, 1, Qt.AlignmentFlag.AlignTop)
            if question.is_changed and reference not in question.known:
                new = _label(tr("new"))
                new.setWordWrap(False)
                self._theme.color_text(new, "amber")
                grid.addWidget(new, row, 2, Qt.AlignmentFlag.AlignTop)
        return group


def _broken(text: str) -> str:
    """With places where a long address or path may go on in the next line, which changes nothing of how it reads."""
    text = printable(text)
    return "\u200b".join(text[start : start + 24] for start in range(0, len(text), 24))


def _label(text: str) -> QLabel:
    label = QLabel(text, wordWrap=True)
    label.setTextFormat(Qt.TextFormat.PlainText)
    return label
