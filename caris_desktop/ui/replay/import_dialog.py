"""Import dialog for annotations from an .eaf or CSV file, with the coder's name."""

from collections.abc import Callable, Sequence
from pathlib import Path

from PySide6.QtCore import QSize, Qt
from PySide6.QtWidgets import QDialog, QFileDialog, QFormLayout, QHBoxLayout, QLabel, QLineEdit, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.recording.annotation.annotation_editing import LONGEST_NAME
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.tab_order import VisualTabOrderMixin
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.drop_down import DropDown

_FORMATS = "*.eaf *.csv *.tsv *.txt"


class ImportDialog(VisualTabOrderMixin, QDialog):
    """Stays open with the reason if ``import_file`` refuses after reading the file."""

    def __init__(
        self,
        theme: Theme,
        parent: QWidget,
        *,
        coders: Sequence[str],
        import_file: Callable[[Path, str, Callable[[str], None]], None],
    ) -> None:
        super().__init__(parent)
        self.setObjectName("import_dialog")
        self.setWindowTitle(tr("Import annotations"))
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self._import_file = import_file
        self._asked = 0
        self.finished.connect(self._forget)
        heading = QLabel(tr("Choose the file and its coder"))
        heading.setFont(theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        hint = QLabel(
            tr(
                "ELAN files (.eaf) and CSV tables with tier, start, end and label. They are imported as "
                "separate tiers; existing annotations do not change."
            )
        )
        hint.setWordWrap(True)
        self.path_field = QLineEdit()
        self.path_field.setObjectName("import_path")
        self.path_field.setAccessibleName(tr("File"))
        self.path_field.setMinimumHeight(36)
        self.path_field.returnPressed.connect(self._on_import)
        browse = ActionButton(theme, tr("Browse"), icon="folder-open", height_px=36)
        browse.setObjectName("import_browse")
        browse.clicked.connect(self.browse)
        path = layouts.hbox(spacing_px=8)
        path.addWidget(self.path_field, 1)
        path.addWidget(browse)
        self._coder = DropDown(theme, "import_coder", tr("Coder"))
        self._coder.setEditable(True)
        self._coder.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self._coder.setMinimumHeight(36)
        self._coder.addItems(list(coders))
        self._coder.setCurrentText("")
        line = self._coder.lineEdit()
        if line is not None:
            line.setPlaceholderText(tr("name or initials; empty: taken from the file"))
            line.setMaxLength(LONGEST_NAME)
        form = QFormLayout()
        form.setHorizontalSpacing(16)
        form.setVerticalSpacing(8)
        form.setLabelAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        form.addRow(tr("File"), path)
        form.addRow(tr("Coder"), self._coder)
        self._refusal = QLabel(textFormat=Qt.TextFormat.PlainText, wordWrap=True)
        self._refusal.setObjectName("import_refusal")
        for label, role in ((hint, "dim"), (self._refusal, "amber")):
            theme.style_text(label, role, tokens.STATUS_PX)
        take = ActionButton(theme, tr("Import"), icon="check", key="Enter", look="primary", height_px=40)
        take.setObjectName("import_take")
        take.clicked.connect(self._on_import)
        cancel = ActionButton(theme, tr("Cancel"), look="ghost", height_px=40)
        cancel.clicked.connect(self.reject)
        buttons = QHBoxLayout()
        buttons.addWidget(cancel)
        buttons.addStretch(1)
        buttons.addWidget(take)
        layout = layouts.vbox(self, margins_px=24, spacing_px=16)
        layout.addWidget(heading)
        layout.addWidget(hint)
        layout.addLayout(form)
        layout.addWidget(self._refusal)
        layout.addStretch(1)
        layout.addLayout(buttons)
        self._refusal.hide()

    def sizeHint(self) -> QSize:
        return QSize(560, 300)

    def browse(self) -> None:
        chooser = QFileDialog(self, tr("Annotations to import"), self.path_field.text())
        kinds = ((tr("Annotations ({files})"), _FORMATS), (tr("All files ({files})"), "*"))
        chooser.setNameFilters([kind.format(files=files) for kind, files in kinds])
        chooser.setFileMode(QFileDialog.FileMode.ExistingFile)
        chooser.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        chooser.fileSelected.connect(self.path_field.setText)
        chooser.open()

    def _on_import(self) -> None:
        text = self.path_field.text().strip()
        if not text:
            self._say(tr("Choose a file first."))
            return
        self._asked += 1
        asked = self._asked
        self._say(tr("Reading the file."))

        def on_imported(refusal: str) -> None:
            if asked != self._asked:
                return  # cancelled, or another file was chosen meanwhile
            self._say(refusal)
            if not refusal:
                self.accept()

        self._import_file(Path(text).expanduser(), " ".join(self._coder.currentText().split()), on_imported)

    def _forget(self) -> None:
        self._asked = -1

    def _say(self, text: str) -> None:
        self._refusal.setText(text)
        self._refusal.setVisible(bool(text))
