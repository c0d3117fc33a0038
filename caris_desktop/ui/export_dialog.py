"""Export dialog: formats, destination, licence and progress."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import shiboken6
from PySide6.QtCore import QSize, Qt, QUrl, Signal
from PySide6.QtGui import QCloseEvent, QDesktopServices, QShowEvent
from PySide6.QtWidgets import QFileDialog, QLabel, QProgressBar, QScrollArea, QWidget

from caris_desktop.domain.foreign_text import typed_path
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.session_library import LiveSessionLibrary
from caris_desktop.live.status import ExportStatus
from caris_desktop.recording.csv_cells import CsvStyle
from caris_desktop.recording.session_export import all_formats
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.focus_widget import VisualTabOrderMixin
from caris_desktop.ui.form_dialog import file_dialog, lay_out_form, resize_to
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import list_area
from caris_desktop.ui.widgets.inputs import TEXT_LEFT_PX, CheckBox, DropDown
from caris_desktop.ui.widgets.labels import label, line_edit, named, restyle

_LICENCES = (
    (QT_TR_NOOP("No licence chosen"), ""),
    (QT_TR_NOOP("CC0 1.0: no restrictions"), "CC0-1.0"),
    (QT_TR_NOOP("CC BY 4.0: credit the authors"), "CC-BY-4.0"),
    (QT_TR_NOOP("CC BY-NC 4.0: credit the authors, non-commercial"), "CC-BY-NC-4.0"),
    (QT_TR_NOOP("Another licence…"), None),
)
_LEAST_FORMATS_PX = 160
_FIRST_CHOICE = ("csv", "html")


class ExportDialog(VisualTabOrderMixin, QWidget):
    """Window owned by the main window: driving, talking and stopping continue meanwhile."""

    closed = Signal()

    def __init__(self, theme: Theme, library: LiveSessionLibrary, sessions: Sequence[Path], parent: QWidget) -> None:
        super().__init__(parent, Qt.WindowType.Window)
        self.setObjectName("export_dialog")
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self._theme = theme
        self._library = library
        self._sessions = tuple(sessions)
        self._out: Path | None = None
        self._heading = label("", "heading")
        self._which = label("", "note", wraps=True, objectName="export_sessions")
        self._folder = line_edit("export_folder", tr("Export folder"), textChanged=self._show_state)
        self._browse = self._button("choose", tr("Choose…"), self._choose_folder, icon="folder-open", height_px=36)
        self._licence = DropDown(theme, "export_licence", tr("Licence"))
        self._licence.setMinimumHeight(36)
        self._licence.fill([(tr(text), value) for text, value in _LICENCES], "")
        self._licence.currentIndexChanged.connect(self._show_state)
        self._other = line_edit(
            "export_other_licence", tr("Name or URL of the licence"), maxLength=200,
            placeholderText=tr("name or URL of the licence"),
        )  # fmt: skip
        self._names = CheckBox(
            theme, tr("Include the names of wizards and coders and the robot’s address instead of W1, C1 …"),
            wraps=True, objectName="export_with_names",
            toolTip=tr("Only for recipients who may know these identities. Transcripts are exported unchanged."),
        )  # fmt: skip
        self._plain_csv = CheckBox(
            theme, tr("CSV for programs: no apostrophe before text that starts like a formula"), wraps=True,
            objectName="export_plain_csv",
            toolTip=tr(
                "Not for spreadsheets: they would treat such text as formulas, and some formulas send data elsewhere."
            ),
        )  # fmt: skip
        self._csv_bom = CheckBox(
            theme, tr("CSV with a UTF-8 byte order mark"), wraps=True, objectName="export_csv_bom",
            toolTip=tr("For spreadsheets that show letters such as ü or é incorrectly."),
        )  # fmt: skip
        self._boxes: dict[str, CheckBox] = {}
        self._bar = named(QProgressBar(textVisible=False), "export_progress")
        self._bar.setRange(0, 1000)
        self._description = label(tone="dim", wraps=True, objectName="export_what")
        self._description.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._close = self._button("close", tr("Close"), self.close, role="ghost")
        self._open = self._button("open", tr("Open folder"), self._open_folder, icon="folder-open")
        self._cancel = self._button("cancel", tr("Cancel export"), library.cancel_export, icon="x")
        self._start = self._button("start", tr("Export"), self._on_start, icon="export", role="primary")
        lay_out_form(
            self,
            layouts.vbox(None, self._heading, self._which, spacing_px=2),
            (self._make_formats(), 1),
            label(tr("Export to"), "note"),
            layouts.hbox(None, (self._folder, 1), self._browse, spacing_px=8),
            label(tr("Licence, if the data will be shared"), "note"),
            layouts.hbox(None, (self._licence, 1), (self._other, 1), spacing_px=8),
            self._names,
            self._bar,
            self._description,
            buttons=(self._close, 1, self._open, self._cancel, self._start),
        )
        self._mine = library.export.value.state == "running"
        library.export.changed.connect(self._on_export_changed)
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

    def _button(self, name: str, text: str, run: Callable[[], object], **more: Any) -> ActionButton:
        return ActionButton(self._theme, text, objectName=f"export_{name}", clicked=run, **{"height_px": 38, **more})

    def _make_formats(self) -> QScrollArea:
        rows = QWidget()
        column = layouts.vbox(rows, margins_px=(0, 0, 8, 0), spacing_px=6)
        for fmt in all_formats().values():
            box = self._boxes[fmt.name] = CheckBox(self._theme, tr(fmt.title), objectName=f"export_format_{fmt.name}")
            box.setAccessibleDescription(tr(fmt.description))
            box.setFont(self._theme.font(tokens.BODY_PX, tokens.WEIGHT_MEDIUM))
            box.setChecked(fmt.name in _FIRST_CHOICE)
            box.toggled.connect(self._show_state)
            column.addLayout(layouts.vbox(None, box, _Description(tr(fmt.description), box), spacing_px=0))
            if fmt.name == "csv":
                options = layouts.vbox(None, self._plain_csv, self._csv_bom, margins_px=(TEXT_LEFT_PX, 0, 0, 0))
                column.addLayout(options)
        column.addStretch(1)
        area = list_area(rows, least_px=_LEAST_FORMATS_PX)
        area.setObjectName("export_formats")
        return area

    # ---- behaviour

    def _choose_folder(self) -> None:
        """Propose a new subfolder in a folder that is not empty, so that nothing is mixed or overwritten."""
        folder = typed_path(self._folder.text().strip())
        there = next((path for path in (folder, *folder.parents) if path.is_dir()), Path.home())
        title, mode = tr("Choose the export folder"), QFileDialog.FileMode.Directory
        dialog = file_dialog(self, "export_folder_dialog", title, self._propose_folder, folder=there, mode=mode)
        dialog.setOption(QFileDialog.Option.ShowDirsOnly)
        dialog.show()

    def _on_start(self) -> None:
        out = typed_path(self._folder.text().strip()).absolute()
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
        text, tone = "", "dim"
        if running:
            text = f"{status.fraction:.0%}".replace("%", " %") + (f" · {status.what}" if status.what else "")
        elif ended:
            text, tone = self._outcome(status)
        elif not count:
            text = tr("Choose at least one format.")
        self._description.setText(text)
        self._description.setVisible(bool(text))
        restyle(self._description, tone=tone)

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

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        resize_to(self, self.size())
        next(iter(self._boxes.values())).setFocus(Qt.FocusReason.OtherFocusReason)

    def closeEvent(self, event: QCloseEvent) -> None:
        # A running export continues and is shown again when the window reopens.
        super().closeEvent(event)
        self.closed.emit()


class _Description(QLabel):
    """Description below a check box; clicking it toggles the box."""

    def __init__(self, text: str, box: CheckBox) -> None:
        super().__init__(text)
        self.setProperty("role", "note")
        self._box = box
        self.setWordWrap(True)
        self.setContentsMargins(TEXT_LEFT_PX, 0, 0, 0)

    def mouseReleaseEvent(self, event: object) -> None:
        if self._box.isEnabled() and self.rect().contains(event.position().toPoint()):  # type: ignore[attr-defined]
            self._box.toggle()
