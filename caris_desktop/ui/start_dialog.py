"""The dialog before a recording: who takes part in what. All of it may be left empty."""

from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtWidgets import QDialog, QFormLayout, QHBoxLayout, QLabel, QLineEdit, QVBoxLayout, QWidget

from caris_desktop.study.trial import TrialDetails
from caris_desktop.ui import tokens
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton

_FIELDS = (
    ("study", "Study", "for example Lab visit"),
    ("participant", "Participant", "for example P07"),
    ("condition", "Condition", "for example B"),
    ("trial", "Trial", "for example 2 of 4"),
    ("wizard", "Wizard", "your name or initials"),
)


class StartDialog(QDialog):
    """``begin(TrialDetails)`` once the wizard starts, with empty details after Skip."""

    begin = Signal(object)

    def __init__(self, theme: Theme, prefilled: TrialDetails, parent: QWidget) -> None:
        super().__init__(parent)
        self.setObjectName("start_dialog")
        self.setWindowTitle("Start recording")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        heading = QLabel("Who takes part?")
        heading.setFont(theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        hint = QLabel("This heads the recording. Use codes rather than names for participants; empty fields are fine.")
        hint.setWordWrap(True)
        hint.setFont(theme.font(tokens.STATUS_PX))
        palette = hint.palette()
        palette.setColor(hint.foregroundRole(), theme.color("dim"))
        hint.setPalette(palette)
        form = QFormLayout()
        form.setHorizontalSpacing(16)
        form.setVerticalSpacing(10)
        form.setLabelAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        self._fields: dict[str, QLineEdit] = {}
        for name, label, placeholder in _FIELDS:
            field = QLineEdit(str(getattr(prefilled, name)))
            field.setObjectName(f"start_{name}")
            field.setPlaceholderText(placeholder)
            field.setAccessibleName(label)
            field.setMinimumHeight(36)
            field.setMaxLength(120)
            field.returnPressed.connect(self._on_begin)
            form.addRow(label, field)
            self._fields[name] = field
        begin = ActionButton(theme, "Start recording", icon="record", key="Enter", look="primary", height_px=38)
        begin.setObjectName("start_dialog_begin")
        begin.clicked.connect(self._on_begin)
        skip = ActionButton(theme, "Start without details", height_px=38)
        skip.setObjectName("start_dialog_skip")
        skip.clicked.connect(self._on_skip)
        cancel = ActionButton(theme, "Cancel", look="ghost", height_px=38)
        cancel.setObjectName("start_dialog_cancel")
        cancel.clicked.connect(self.reject)
        buttons = QHBoxLayout()
        buttons.setSpacing(8)
        buttons.addWidget(cancel)
        buttons.addStretch(1)
        buttons.addWidget(skip)
        buttons.addWidget(begin)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(24, 20, 24, 20)
        layout.setSpacing(14)
        layout.addWidget(heading)
        layout.addWidget(hint)
        layout.addLayout(form)
        layout.addSpacing(4)
        layout.addLayout(buttons)
        # What changes from session to session.
        self._fields["participant"].setFocus(Qt.FocusReason.OtherFocusReason)
        self._fields["participant"].selectAll()

    def sizeHint(self) -> QSize:
        return QSize(540, 400)

    def details(self) -> TrialDetails:
        return TrialDetails(**{name: " ".join(field.text().split()) for name, field in self._fields.items()})

    def _on_begin(self) -> None:
        if self.isVisible():
            details = self.details()
            self.accept()
            self.begin.emit(details)

    def _on_skip(self) -> None:
        self.accept()
        self.begin.emit(TrialDetails())
