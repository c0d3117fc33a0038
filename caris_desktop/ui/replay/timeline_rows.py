"""Row management of the timeline: order, visibility, coders' tiers, import."""

from collections.abc import Callable, Sequence
from pathlib import Path

from PySide6.QtCore import QObject, QPoint, QSize, Qt, Signal
from PySide6.QtWidgets import QDialog, QFileDialog, QFormLayout, QHBoxLayout, QLabel, QLineEdit, QMenu, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.live.state import LiveState
from caris_desktop.live.wizard_console import ReplayControls
from caris_desktop.recording.annotation import annotation_editing
from caris_desktop.recording.annotation.annotation_editing import LONGEST_NAME
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument, Tier
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.replay.agreement_dialog import AgreementDialog
from caris_desktop.ui.replay.tier_dialog import TierDialog, TierRequest, with_tier
from caris_desktop.ui.replay.timeline_canvas import TimelineCanvas
from caris_desktop.ui.replay.timeline_commands import TimelineCommands
from caris_desktop.ui.replay.timeline_model import Row, all_rows, arranged, moved_key
from caris_desktop.ui.tab_order import VisualTabOrderMixin
from caris_desktop.ui.text_formatting import in_menu
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.clear_button import add_clear_button
from caris_desktop.ui.widgets.drop_down import DropDown


class TimelineRows(QObject):
    """Dialogs and menus for tiers; ``filter``: search field over row names."""

    changed = Signal()  # visible rows changed

    def __init__(
        self,
        view: QWidget,
        canvas: TimelineCanvas,
        acts: TimelineCommands,
        *,
        theme: Theme,
        replay: ReplayControls,
        state: LiveState,
        actions: Actions,
    ) -> None:
        super().__init__(view)
        self._theme = theme
        self._replay = replay
        self._state = state
        self._actions = actions
        self._acts = acts
        self._canvas = canvas
        self._view = view
        self._order: list[str] = []
        self._hidden: set[str] = set()
        self.filter = QLineEdit(placeholderText=tr("Filter tiers"))
        self.filter.setObjectName("tier_filter")
        self.filter.setAccessibleName(tr("Show only tiers that contain these words"))
        add_clear_button(self.filter)
        self.filter.setFixedWidth(136)
        self.filter.setFixedHeight(30)
        self.filter.textChanged.connect(lambda _text: self.changed.emit())
        canvas.row_menu_requested.connect(self.open_row_menu)
        canvas.row_opened.connect(self._on_row_opened)
        canvas.row_moved.connect(self.move_row)

    def shown(self) -> list[Row]:
        """Visible rows, in order."""
        return arranged(self._every_row(), self._order, self._hidden, self.filter.text())

    def words(self) -> str:
        """Text shown while no row is visible."""
        return tr("No row contains these words.") if self.filter.text().strip() else tr("All rows are hidden.")

    def _runner(self, action_id: str) -> Callable[[], object]:
        return lambda: self._actions.run(action_id)

    def open_tier_dialog(self) -> None:
        """Add a tier of an existing or new coder."""
        self._open_tier_dialog(None)

    def _open_tier_dialog(self, tier: Tier | None) -> None:
        active = self._canvas.active
        scenario = self._state.scenario.value
        dialog = TierDialog(
            self._theme,
            self._acts.document,
            self._view,
            apply=lambda wish: self._apply_tier(wish, tier),
            tier=tier,
            coder="" if active is None else active.coder,
            scenario_labels=() if scenario is None else scenario.recording.labels,
        )
        dialog.open()

    def _apply_tier(self, wish: TierRequest, tier: Tier | None) -> str:
        before = {item.tier_id for item in self._acts.document.tiers}
        refusal = self._replay.edit(lambda document: with_tier(document, wish, tier))
        if not refusal:
            added = [item for item in self._acts.document.tiers if item.tier_id not in before]
            for item in added:
                self.filter.clear()
                self._canvas.activate(f"tier {item.tier_id}")
                self._canvas.show_row(f"tier {item.tier_id}")
            self._canvas.setFocus(Qt.FocusReason.OtherFocusReason)
        return refusal

    def open_agreement(self) -> None:
        own_tiers = [tier for tier in self._acts.document.tiers if tier.coder]
        if len(own_tiers) < 2:
            self._acts.say(tr("Agreement compares two tiers. Add the other coder’s tier, or import it."))
            return
        AgreementDialog(self._theme, self._acts.document, self._view).open()

    def open_import(self) -> None:
        coders = annotation_editing.coders_of(self._acts.document)
        ImportDialog(self._theme, self._view, coders=coders, import_file=self._import_file).open()

    def _import_file(self, path: Path, coder: str, on_result: Callable[[str], None]) -> None:
        before = self._acts.document

        def taken(refusal: str) -> None:
            if not refusal:
                self._acts.say(imported_words(before, self._acts.document))
            on_result(refusal)

        self._replay.import_annotations(path, coder, taken)

    def move_row(self, key: str, position: int) -> None:
        """Move a visible row. The order of a coder's own tiers is saved with them."""
        keys = moved_key([row.key for row in self._canvas.rows], key, position)
        everything = [row.key for row in arranged(self._every_row(), self._order, (), "")]
        # Hidden rows stay behind their predecessor.
        order = list(keys)
        for index, other in enumerate(everything):
            if other not in keys:
                before = everything[index - 1] if index else ""
                order.insert(order.index(before) + 1 if before in order else 0, other)
        self._order = order
        tier_ids = [other.removeprefix("tier ") for other in order if other.startswith("tier ")]
        tier_id = key.removeprefix("tier ")
        if tier_id in tier_ids and tier_ids != [tier.tier_id for tier in self._acts.document.tiers if tier.coder]:
            self._acts.edit(lambda document: annotation_editing.move_tier(document, tier_id, tier_ids.index(tier_id)))
        self.changed.emit()
        self._canvas.show_row(key)

    def _every_row(self) -> list[Row]:
        return all_rows(self._replay.overview.value, self._acts.document)

    def set_row_shown(self, key: str, *, shown: bool) -> None:
        (self._hidden.discard if shown else self._hidden.add)(key)
        self.changed.emit()

    def open_rows_menu(self, button: QWidget) -> None:
        """Menu to show and hide rows."""
        menu = self._menu("rows_menu")
        for row in arranged(self._every_row(), self._order, (), ""):
            action = menu.addAction(in_menu(f"{row.name} · {row.coder}" if row.own else row.name))
            action.setCheckable(True)
            action.setChecked(row.key not in self._hidden)
            action.toggled.connect(self._row_shower(row.key))
        menu.addSeparator()
        menu.addAction(tr("Show all rows")).triggered.connect(self._show_all_rows)
        menu.popup(button.mapToGlobal(QPoint(0, button.height() + 4)))

    def _row_shower(self, key: str) -> Callable[[bool], None]:
        return lambda shown: self.set_row_shown(key, shown=shown)

    def _show_all_rows(self) -> None:
        self._hidden.clear()
        self.changed.emit()

    def open_row_menu(self, key: str, at: QPoint) -> None:
        """Menu of a row and its selection."""
        index = self._canvas.places.index_of(key)
        if index is None:
            return
        row, menu = self._canvas.rows[index], self._menu("row_menu")
        selected = self._canvas.selected
        if row.own and row.tier is not None and selected is not None and selected.tier_id == row.tier.tier_id:
            for action_id in ("annotation_rename", "annotation_split", "annotation_remove"):
                spec = self._actions.spec(action_id)
                if spec is not None:
                    menu.addAction(f"{spec.text}\t{self._actions.key_text(action_id)}").triggered.connect(
                        self._runner(action_id)
                    )
            menu.addSeparator()
        if row.own and row.tier is not None:
            menu.addAction(tr("Change the tier…")).triggered.connect(self._tier_changer(row.tier))
        up, down = menu.addAction(tr("Move up")), menu.addAction(tr("Move down"))
        up.setEnabled(index > 0)
        down.setEnabled(index < len(self._canvas.rows) - 1)
        up.triggered.connect(self._row_mover(key, index - 1))
        down.triggered.connect(self._row_mover(key, index + 1))
        menu.addAction(tr("Hide")).triggered.connect(lambda: self.set_row_shown(key, shown=False))
        if row.own and row.tier is not None:
            count = len(self._canvas.state.track_of(row).annotations)
            menu.addSeparator()
            words = tr("Remove the tier with its %n annotations", "", count) if count else tr("Remove the tier")
            menu.addAction(words).triggered.connect(self._tier_remover(row.tier.tier_id))
        menu.popup(at)

    def _menu(self, name: str) -> QMenu:
        menu = QMenu(self._view)
        menu.setObjectName(name)
        menu.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        return menu

    def _tier_changer(self, tier: Tier) -> Callable[[], None]:
        return lambda: self._open_tier_dialog(tier)

    def _tier_remover(self, tier_id: str) -> Callable[[], None]:
        return lambda: self._remove_tier(tier_id)

    def _remove_tier(self, tier_id: str) -> None:
        self._acts.edit(lambda document: annotation_editing.remove_tier(document, tier_id))

    def _row_mover(self, key: str, position: int) -> Callable[[], None]:
        return lambda: self.move_row(key, position)

    def _on_row_opened(self, key: str) -> None:
        index = self._canvas.places.index_of(key)
        tier = None if index is None else self._canvas.rows[index].tier
        if tier is not None and tier.coder:
            self._open_tier_dialog(tier)


def imported_words(before: AnnotationDocument, after: AnnotationDocument) -> str:
    """Summary of an import."""
    if before == after:
        return tr("Everything in that file is already here.")
    tiers = len({tier.tier_id for tier in after.tiers} - {tier.tier_id for tier in before.tiers})
    annotations = len(set(after.annotations) - set(before.annotations))
    of_tiers = tr("1 tier") if tiers == 1 else tr("%n tiers", "", tiers)
    of_annotations = tr("1 annotation") if annotations == 1 else tr("%n annotations", "", annotations)
    if tiers and annotations:
        return tr("Imported: {tiers} and {annotations}.").format(tiers=of_tiers, annotations=of_annotations)
    if tiers or annotations:
        return tr("Imported: {what}.").format(what=of_tiers if tiers else of_annotations)
    return tr("Imported. Nothing was added; some annotations were changed or removed.")


_FORMATS = "*.eaf *.csv *.tsv *.txt"


class ImportDialog(VisualTabOrderMixin, QDialog):
    """Import dialog for annotations from an .eaf or CSV file, with the coder's name.

    Stays open with the reason if ``import_file`` refuses after reading the file.
    """

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
        self._request_number = 0
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
        self._refusal = QLabel(wordWrap=True)
        self._refusal.setObjectName("import_refusal")
        for label, role in ((hint, "dim"), (self._refusal, "amber")):
            theme.style_text(label, role, tokens.STATUS_PX)
        take = ActionButton(theme, tr("Import"), icon="check", key="Enter", role="primary", height_px=40)
        take.setObjectName("import_take")
        take.clicked.connect(self._on_import)
        cancel = ActionButton(theme, tr("Cancel"), role="ghost", height_px=40)
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
        self._request_number += 1
        request_number = self._request_number
        self._say(tr("Reading the file."))

        def on_imported(refusal: str) -> None:
            if request_number != self._request_number:
                return  # cancelled, or another file was chosen meanwhile
            self._say(refusal)
            if not refusal:
                self.accept()

        self._import_file(Path(text).expanduser(), " ".join(self._coder.currentText().split()), on_imported)

    def _forget(self) -> None:
        self._request_number = -1

    def _say(self, text: str) -> None:
        self._refusal.setText(text)
        self._refusal.setVisible(bool(text))
