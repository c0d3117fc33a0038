"""Export dialog: formats, destination, licence and progress."""

from collections.abc import Sequence
from pathlib import Path

import shiboken6
from PySide6.QtCore import QSize, Qt, QUrl, Signal
from PySide6.QtGui import QCloseEvent, QDesktopServices, QPainter, QPaintEvent, QShowEvent
from PySide6.QtWidgets import QFileDialog, QLabel, QLineEdit, QProgressBar, QScrollArea, QSizePolicy, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import ExportStatus
from caris_desktop.live.wizard_console import SessionLibrary
from caris_desktop.recording.csv_cells import CsvStyle
from caris_desktop.recording.session_export import FORMATS
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.tab_order import VisualTabOrderMixin
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.check_box import TEXT_LEFT_PX, CheckBox
from caris_desktop.ui.widgets.drop_down import DropDown
from caris_desktop.ui.widgets.scroll_areas import Scrolled

_LICENCES = (
    (QT_TR_NOOP("No licence chosen"), ""),
    (QT_TR_NOOP("CC0 1.0: no restrictions"), "CC0-1.0"),
    (QT_TR_NOOP("CC BY 4.0: credit the authors"), "CC-BY-4.0"),
    (QT_TR_NOOP("CC BY-NC 4.0: credit the authors, non-commercial"), "CC-BY-NC-4.0"),
)
_LEAST_FORMATS_PX = 160
_FIRST_CHOICE = ("csv", "html")


class ExportDialog(VisualTabOrderMixin, QWidget):
    """Window owned by the main window: driving, talking and stopping continue meanwhile."""

    closed = Signal()

    def __init__(self, theme: Theme, library: SessionLibrary, sessions: Sequence[Path], parent: QWidget) -> None:
        super().__init__(parent, Qt.WindowType.Window)
        self.setObjectName("export_dialog")
        self._theme = theme
        self._library = library
        self._sessions = tuple(sessions)
        self._out: Path | None = None
        self._heading = QLabel()
        self._heading.setFont(theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        self._which = QLabel(wordWrap=True)
        self._which.setObjectName("export_sessions")
        self._boxes: dict[str, CheckBox] = {}
        self._dim: list[QLabel] = [self._which]
        self._folder = QLineEdit()
        self._folder.setObjectName("export_folder")
        self._folder.setAccessibleName(tr("Export folder"))
        self._folder.setMinimumHeight(36)
        self._folder.textChanged.connect(self._show_state)
        self._browse = ActionButton(theme, tr("Choose…"), icon="folder-open", height_px=36)
        self._browse.setObjectName("export_choose")
        self._browse.clicked.connect(self._choose_folder)
        self._licence = DropDown(theme, "export_licence", tr("Licence"))
        self._licence.setMinimumHeight(36)
        for text, value in _LICENCES:
            self._licence.addItem(tr(text), value)
        self._licence.addItem(tr("Another licence…"), None)
        self._licence.currentIndexChanged.connect(self._show_state)
        self._other = QLineEdit(placeholderText=tr("name or URL of the licence"), maxLength=200)
        self._other.setObjectName("export_other_licence")
        self._other.setAccessibleName(tr("Name or URL of the licence"))
        self._other.setMinimumHeight(36)
        self._names = CheckBox(
            theme, tr("Include the names of wizards and coders and the robot’s address instead of W1, C1 …"), wraps=True
        )
        self._names.setObjectName("export_with_names")
        self._names.setToolTip(
            tr("Only for recipients who may know these identities. Transcripts are exported unchanged.")
        )
        self._plain_csv = CheckBox(
            theme, tr("CSV for programs: no apostrophe before text that starts like a formula"), wraps=True
        )
        self._plain_csv.setObjectName("export_plain_csv")
        self._plain_csv.setToolTip(
            tr("Not for spreadsheets: they would treat such text as formulas, and some formulas send data elsewhere.")
        )
        self._csv_bom = CheckBox(theme, tr("CSV with a UTF-8 byte order mark"), wraps=True)
        self._csv_bom.setObjectName("export_csv_bom")
        self._csv_bom.setToolTip(tr("For spreadsheets that show letters such as ü or é incorrectly."))
        self._bar = QProgressBar(textVisible=False)
        self._bar.setObjectName("export_progress")
        self._bar.setRange(0, 1000)
        self._description = QLabel(wordWrap=True)
        self._description.setObjectName("export_what")
        self._description.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._close = ActionButton(theme, tr("Close"), role="ghost", height_px=38)
        self._close.setObjectName("export_close")
        self._close.clicked.connect(self.close)
        self._open = ActionButton(theme, tr("Open folder"), icon="folder-open", height_px=38)
        self._open.setObjectName("export_open")
        self._open.clicked.connect(self._open_folder)
        self._cancel = ActionButton(theme, tr("Cancel export"), icon="x", height_px=38)
        self._cancel.setObjectName("export_cancel")
        self._cancel.clicked.connect(library.cancel_export)
        self._start = ActionButton(theme, tr("Export"), icon="export", role="primary", height_px=38)
        self._start.setObjectName("export_start")
        self._start.clicked.connect(self._on_start)
        self._lay_out()
        self._mine = library.export.value.state == "running"
        library.export.changed.connect(self._on_export_changed)
        theme.restyle_on_change(self._style)
        self.show_sessions(sessions)
        self.resize(self.sizeHint())  # Qt limits a first window to two thirds of the screen

    def sizeHint(self) -> QSize:
        return QSize(640, 800)

    def show_sessions(self, sessions: Sequence[Path]) -> None:
        """Offer these sessions for export, unless an export is running."""
        if self._library.export.value.state != "running":
            self._sessions = tuple(sessions)
            self._mine = False
            self._propose_folder()
        count = len(self._sessions)
        title = tr("Export 1 session") if count == 1 else tr("Export %n sessions", "", count)
        self._heading.setText(title)
        self.setWindowTitle(tr("{title} · CARIS Desktop").format(title=title))
        names = [folder.name for folder in self._sessions]
        named = ", ".join(names[:3])
        self._which.setText(tr("{some} and %n more", "", count - 3).format(some=named) if count > 3 else named)
        self._which.setToolTip("\n".join(names[:40]))
        self._show_state()

    def _propose_folder(self, chosen: Path | None = None) -> None:
        """Propose a destination folder; text typed before the disk responds stays."""
        sessions, before = self._sessions, self._folder.text()

        def on_folder(folder: Path) -> None:
            if shiboken6.isValid(self) and (sessions, before) == (self._sessions, self._folder.text()):
                self._folder.setText(str(folder))

        self._library.choose_export_folder(sessions, on_folder, chosen=chosen)

    @property
    def formats(self) -> tuple[str, ...]:
        """Selected formats, in list order."""
        return tuple(name for name, box in self._boxes.items() if box.isChecked())

    @property
    def licence(self) -> str:
        chosen = self._licence.currentData()
        return " ".join(self._other.text().split()) if chosen is None else str(chosen)

    # ---- layout

    def _lay_out(self) -> None:
        content = QWidget()
        layout = layouts.vbox(content, margins_px=0, spacing_px=12)
        head = layouts.vbox(spacing_px=2)
        head.addWidget(self._heading)
        head.addWidget(self._which)
        layout.addLayout(head)
        layout.addWidget(self._make_formats(), 1)
        layout.addWidget(self._label(tr("Export to")))
        where = layouts.hbox(spacing_px=8)
        where.addWidget(self._folder, 1)
        where.addWidget(self._browse)
        layout.addLayout(where)
        layout.addWidget(self._label(tr("Licence, if the data will be shared")))
        licence = layouts.hbox(spacing_px=8)
        licence.addWidget(self._licence, 1)
        licence.addWidget(self._other, 1)
        layout.addLayout(licence)
        layout.addWidget(self._names)
        layout.addSpacing(2)
        layout.addWidget(self._bar)
        layout.addWidget(self._description)
        outer = layouts.vbox(self, margins_px=(24, 20, 24, 20), spacing_px=12)
        outer.addWidget(Scrolled(content), 1)
        buttons = layouts.hbox(spacing_px=8)
        buttons.addWidget(self._close)
        buttons.addStretch(1)
        for button in (self._open, self._cancel, self._start):
            buttons.addWidget(button)
        outer.addLayout(buttons)

    def _label(self, text: str) -> QLabel:
        label = QLabel(text)
        label.setFont(self._theme.font(tokens.STATUS_PX))
        self._dim.append(label)
        return label

    def _make_formats(self) -> QScrollArea:
        rows = QWidget()
        column = layouts.vbox(rows, margins_px=(0, 0, 8, 0), spacing_px=6)
        for fmt in FORMATS:
            box = CheckBox(self._theme, tr(fmt.title))
            box.setObjectName(f"export_format_{fmt.name}")
            box.setAccessibleDescription(tr(fmt.description))
            box.setFont(self._theme.font(tokens.BODY_PX, tokens.WEIGHT_MEDIUM))
            box.setChecked(fmt.name in _FIRST_CHOICE)
            box.toggled.connect(self._show_state)
            description = _Description(tr(fmt.description), box)
            description.setFont(self._theme.font(tokens.STATUS_PX))
            self._dim.append(description)
            row = layouts.vbox(spacing_px=0)
            row.addWidget(box)
            row.addWidget(description)
            column.addLayout(row)
            self._boxes[fmt.name] = box
            if fmt.name == "csv":
                column.addWidget(self._plain_csv)
                column.addWidget(self._csv_bom)
        column.addStretch(1)
        area = QScrollArea(widgetResizable=True)
        area.setObjectName("export_formats")
        area.setWidget(rows)
        area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        area.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        area.setMinimumHeight(_LEAST_FORMATS_PX)
        area.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Ignored)
        return area

    # ---- behaviour

    def _choose_folder(self) -> None:
        # Qt's non-modal dialog: a system file dialog would take the keys that stop the robot.
        folder = Path(self._folder.text().strip()).expanduser()
        there = next((path for path in (folder, *folder.parents) if path.is_dir()), Path.home())
        dialog = QFileDialog(self, tr("Choose the export folder"), str(there))
        dialog.setObjectName("export_folder_dialog")
        dialog.setFileMode(QFileDialog.FileMode.Directory)
        dialog.setOptions(QFileDialog.Option.DontUseNativeDialog | QFileDialog.Option.ShowDirsOnly)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        dialog.setModal(False)
        dialog.fileSelected.connect(self._on_folder_chosen)
        dialog.show()

    def _on_folder_chosen(self, text: str) -> None:
        """Propose a new subfolder in a folder that is not empty, so that nothing is mixed or overwritten."""
        self._propose_folder(Path(text))

    def _on_start(self) -> None:
        out = Path(self._folder.text().strip()).expanduser()
        self._mine = True
        self._out = out
        # Move the focus off the widgets that are disabled now, or it would wander through the list.
        self._cancel.show()
        self._cancel.setFocus(Qt.FocusReason.OtherFocusReason)
        style = CsvStyle(self._plain_csv.isChecked(), self._csv_bom.isChecked())
        self._library.start_export(
            self._sessions, self.formats, out, licence=self.licence, with_names=self._names.isChecked(), csv=style
        )

    def _open_folder(self) -> None:
        status: ExportStatus = self._library.export.value
        folder = self._out
        if folder is None and status.written:
            folder = status.written[0].parent
        if folder is not None:
            QDesktopServices.openUrl(QUrl.fromLocalFile(str(folder)))

    def _on_export_changed(self, status: ExportStatus) -> None:
        if status.state == "done" and self._mine:
            self._propose_folder()  # for the next export
        self._show_state()

    def _show_state(self, _value: object = None) -> None:
        status: ExportStatus = self._library.export.value
        running = status.state == "running"
        ended = status.state in ("done", "failed", "cancelled") and self._mine
        choices = (*self._boxes.values(), self._names, self._plain_csv, self._csv_bom)
        for part in (*choices, self._folder, self._browse, self._licence, self._other):
            part.setEnabled(not running)
        self._other.setVisible(self._licence.currentData() is None)
        self._bar.setVisible(running)
        self._bar.setValue(round(status.fraction * 1000))
        self._open.setVisible(ended and bool(status.written))
        self._cancel.setVisible(running)
        self._start.setVisible(not running)
        ready = bool(self.formats) and bool(self._folder.text().strip())
        self._start.setEnabled(ready)
        count = len(self.formats)
        self._start.set_label(tr("Export"), role="plain" if ended and status.state == "done" else "primary")
        text, role = "", "dim"
        if running:
            text = f"{status.fraction:.0%}".replace("%", " %") + (f" · {status.what}" if status.what else "")
        elif ended:
            text, role = self._outcome(status)
        elif not count:
            text = tr("Choose at least one format.")
        self._description.setText(text)
        self._description.setVisible(bool(text))
        self._theme.color_text(self._description, role)

    def _outcome(self, status: ExportStatus) -> tuple[str, str]:
        written = len(status.written)
        exports = tr("1 export") if written == 1 else tr("%n exports", "", written)
        remaining = tr("Finished exports remain ({exports}).").format(exports=exports) if written else ""
        match status.state:
            case "done":
                if self._out is None:
                    text = tr("Done: {exports}.").format(exports=exports)
                else:
                    text = tr("Done: {exports} in {folder}.").format(exports=exports, folder=self._out)
                return (f"{text} {status.detail}".strip(), "amber" if status.detail else "green")
            case "cancelled":
                return " ".join((tr("Cancelled."), remaining or tr("Nothing was saved."))), "dim"
            case _:
                reason = status.detail or tr("The export failed; see the program’s log for the reason.")
                return f"{reason} {remaining}".strip(), "red"

    # ---- style

    def _style(self) -> None:
        for label in self._dim:
            self._theme.color_text(label, "dim")
        self._which.setFont(self._theme.font(tokens.STATUS_PX))
        self._description.setFont(self._theme.font(tokens.STATUS_PX + 1))
        self._show_state()
        self.update()

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        room = self.screen().availableSize()
        self.resize(self.size().boundedTo(QSize(room.width() - 40, room.height() - 60)))
        next(iter(self._boxes.values())).setFocus(Qt.FocusReason.OtherFocusReason)

    def closeEvent(self, event: QCloseEvent) -> None:
        # A running export continues and is shown again when the window reopens.
        super().closeEvent(event)
        self.closed.emit()

    def paintEvent(self, _event: QPaintEvent) -> None:
        QPainter(self).fillRect(self.rect(), self._theme.color("panel"))


class _Description(QLabel):
    """Description below a check box; clicking it toggles the box."""

    def __init__(self, text: str, box: CheckBox) -> None:
        super().__init__(text)
        self._box = box
        self.setWordWrap(True)
        self.setContentsMargins(TEXT_LEFT_PX, 0, 0, 0)

    def mouseReleaseEvent(self, event: object) -> None:
        if self._box.isEnabled() and self.rect().contains(event.position().toPoint()):  # type: ignore[attr-defined]
            self._box.toggle()
