"""Dialogs of the timeline: coder and labels of a tier, import of annotations, agreement between two coders."""

from collections.abc import Callable, Sequence
from pathlib import Path

import shiboken6
from PySide6.QtCore import QModelIndex, QPersistentModelIndex, QSize, Qt
from PySide6.QtGui import QBrush, QKeyEvent, QPainter
from PySide6.QtWidgets import (
    QAbstractItemView,
    QApplication,
    QComboBox,
    QFormLayout,
    QHeaderView,
    QLabel,
    QLineEdit,
    QPlainTextEdit,
    QSizePolicy,
    QStyledItemDelegate,
    QStyleOptionViewItem,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from caris_desktop.domain.foreign_text import typed_path
from caris_desktop.domain.free_names import free_name
from caris_desktop.domain.translation import QT_TR_NOOP, tr, tr_filled
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation import annotation_editing
from caris_desktop.recording.annotation.annotation_editing import LONGEST_NAME, AnnotationError
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument, Tier, Vocabulary, VocabularyEntry
from caris_desktop.recording.annotation.coder_agreement import Agreement, TierAgreement, compare_tiers, report
from caris_desktop.ui import layouts
from caris_desktop.ui.form_dialog import FormDialog, file_dialog
from caris_desktop.ui.replay.timeline_items import SCENARIO_LABELS, vocabulary_named, vocabulary_title
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import Scrolled
from caris_desktop.ui.widgets.inputs import DropDown
from caris_desktop.ui.widgets.labels import label, named

FREE_TEXT = QT_TR_NOOP("Free text")
OWN_LIST = QT_TR_NOOP("A list of labels…")
_FORMATS = "*.eaf *.csv *.tsv *.txt"


class _Dialog(FormDialog):
    """Dialog ``NAME_dialog`` with room for its content above a row of buttons: the first left, the last right."""

    def __init__(self, theme: Theme, parent: QWidget, name: str, title: str, size: QSize) -> None:
        super().__init__(theme, parent, f"{name}_dialog", title)
        self._name = name
        self._size = size
        self.column = layouts.vbox(self, margins_px=24, spacing_px=16)

    def sizeHint(self) -> QSize:
        return QSize(self._size.width(), self._size.height() or super().sizeHint().height())

    def labelled(self, text: str, name: str, role: str = "") -> QLabel:
        """Label ``NAME_name`` that wraps, added to the dialog."""
        made = label(text, role, wraps=True, textFormat=Qt.TextFormat.PlainText, objectName=f"{self._name}_{name}")
        self.column.addWidget(made)
        return made

    def add_form(self, *rows: tuple[str, QWidget]) -> QFormLayout:
        form = QFormLayout(horizontalSpacing=16, verticalSpacing=8)
        form.setLabelAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        for text, field in rows:
            field.setMinimumHeight(36)
            form.addRow(text, field)
        self.column.addLayout(form)
        return form

    def coder_field(self, coders: Sequence[str], coder: str, hint: str) -> DropDown:
        """Field for a coder's name that offers the known ones."""
        field = DropDown(self._theme, f"{self._name}_coder", tr("Coder"))
        field.setEditable(True)
        line = field.lineEdit()
        if line is not None:
            line.setPlaceholderText(hint)
            line.setMaxLength(LONGEST_NAME)
        field.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        field.setInsertPolicy(QComboBox.InsertPolicy.NoInsert)
        field.addItems(coders)
        field.setCurrentText(coder)
        return field

    def add_buttons(self, leave: str, button: ActionButton) -> None:
        """Add the refusal, ``button``, which runs the dialog, and one that leaves it."""
        self._refusal = self.labelled("", "refusal", "warning")
        self._refusal.hide()
        cancel = self.button(f"{self._name}_cancel", leave, self.reject, role="ghost", height_px=40)
        self.column.addLayout(layouts.hbox(None, cancel, 1, button))

    def _primary(self, name: str, text: str, run: Callable[[], object]) -> ActionButton:
        return self.button(name, text, run, icon="check", key="Enter", role="primary", height_px=40)

    def refuse(self, refusal: str) -> None:
        """Show the reason why the dialog stays open; close it if there is none."""
        self._refusal.setText(refusal)
        self._refusal.setVisible(bool(refusal))
        if not refusal:
            self.accept()


class TierRequest(Value):
    """Result of the dialog. ``vocabulary`` is None for free text."""

    coder: str
    name: str
    vocabulary: Vocabulary | None


def labels_of(text: str) -> tuple[VocabularyEntry, ...]:
    """Parse labels, one per line, with the meaning after a colon."""
    entries = []
    for line in text.splitlines():
        value, _, meaning = line.partition(":")
        if value.strip():
            entries.append(VocabularyEntry(" ".join(value.split()), meaning.strip()))
    return tuple(entries)


def text_of(vocabulary: Vocabulary) -> str:
    """Inverse of ``labels_of``."""
    return "\n".join(
        f"{entry.value}: {entry.description}" if entry.description else entry.value for entry in vocabulary.entries
    )


def renamed_labels(before: Vocabulary, after: Vocabulary) -> dict[str, str]:
    """Renamed labels by position: if the number of lines is unchanged, a new label replaces the old one on its line."""
    old, new = [entry.value for entry in before.entries], [entry.value for entry in after.entries]
    if len(old) != len(new):
        return {}
    return {was: now for was, now in zip(old, new, strict=True) if was not in new and now not in old}


def with_tier(document: AnnotationDocument, request: TierRequest, tier: Tier | None) -> AnnotationDocument:
    """The document with a new tier, or ``tier`` changed. Raises AnnotationError."""
    name = ""
    if request.vocabulary is not None:
        name = request.vocabulary.name
        present = vocabulary_named(document, name)
        if present is None:
            document = annotation_editing.add_vocabulary(document, request.vocabulary)
        elif present.entries != request.vocabulary.entries:
            renamed = renamed_labels(present, request.vocabulary)
            document = annotation_editing.change_vocabulary(document, name, request.vocabulary, renamed=renamed)
    if tier is None:
        return annotation_editing.add_tier(document, request.name, request.coder, name)
    document = annotation_editing.rename_tier(document, tier.tier_id, request.name)
    return annotation_editing.set_tier_vocabulary(document, tier.tier_id, name) if name != tier.vocabulary else document


class TierDialog(_Dialog):
    """Coder, name and labels of a new or existing tier. Stays open with the reason if ``apply`` refuses."""

    def __init__(
        self,
        theme: Theme,
        document: AnnotationDocument,
        parent: QWidget,
        *,
        apply: Callable[[TierRequest], str],
        tier: Tier | None = None,
        coder: str = "",
        scenario_labels: Sequence[str] = (),
    ) -> None:
        title = tr("Add a tier") if tier is None else tr("Change the tier")
        super().__init__(theme, parent, "tier", title, QSize(480, 0))
        self._document = document
        self._tier = tier
        self._apply = apply
        self._scenario_labels = tuple(dict.fromkeys(label.strip() for label in scenario_labels if label.strip()))
        heading = tr("What will be coded?")
        if tier is not None:
            heading = tr("Tier {tier} of {coder}").format(tier=tr_filled(tier.title), coder=tier.coder)
        self.labelled(heading, "heading", "heading")
        coders = annotation_editing.coders_of(document)
        self._coder = self.coder_field(coders, tier.coder if tier else coder, tr("your name or initials"))
        self._name_field = QLineEdit("" if tier is None else tr_filled(tier.title), maxLength=LONGEST_NAME)
        self._name_field.setObjectName("tier_name")
        self._name_field.setPlaceholderText(tr("for example Stance"))
        self._name_field.setAccessibleName(tr("Name of the tier"))
        self._labels = DropDown(theme, "tier_vocabulary", tr("Labels"))
        self._labels.addItem(tr(FREE_TEXT))
        for vocabulary in document.vocabularies:
            words = tr("{vocabulary} (%n labels)", "", len(vocabulary.entries))
            self._labels.addItem(words.format(vocabulary=vocabulary_title(vocabulary.name)), vocabulary.name)
        if self._scenario_labels and vocabulary_named(document, SCENARIO_LABELS) is None:
            self._labels.addItem(tr(SCENARIO_LABELS))
        self._labels.addItem(tr(OWN_LIST))
        if tier is not None and tier.vocabulary:
            self._labels.setCurrentIndex(self._labels.findData(tier.vocabulary))
        self._labels.currentIndexChanged.connect(self._on_labels_chosen)
        self._list = named(QPlainTextEdit(tabChangesFocus=True), "tier_labels", tr("Labels, one per line"))
        self._list.setPlaceholderText(
            tr("One label per line, with its meaning after a colon:\ncurious: leans in, asks")
        )
        fields = (
            (tr("Coder"), self._coder),
            (tr("Tier"), self._name_field),
            (tr("Labels"), self._labels),
            ("", self._list),
        )
        form = self.add_form(*fields)
        form.setRowVisible(self._coder, tier is None)
        self._list.setMinimumHeight(120)
        text = tr("Add tier") if tier is None else tr("Change")
        self.add_buttons(tr("Cancel"), self._primary("tier_save", text, self._on_save))
        self._on_labels_chosen()
        (self._name_field if self._coder.currentText() else self._coder).setFocus(Qt.FocusReason.OtherFocusReason)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Enter accepts the dialog, except in the list of labels, where it adds a line."""
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter) and not self._list.hasFocus():
            self._on_save()
        else:
            super().keyPressEvent(event)

    def requested_tier(self) -> TierRequest:
        coder, name = " ".join(self._coder.currentText().split()), " ".join(self._name_field.text().split())
        if self._tier is not None and self._name_field.text() == tr_filled(self._tier.title):
            name = self._tier.name
        return TierRequest(coder, name, self._vocabulary(name))

    def _chosen_name(self) -> str:
        """Selected existing vocabulary; empty for other choices."""
        return str(self._labels.currentData() or "")

    def _vocabulary(self, tier_name: str) -> Vocabulary | None:
        if self._labels.currentText() == tr(FREE_TEXT):
            return None
        entries = labels_of(self._list.toPlainText())
        chosen = self._chosen_name()
        if chosen:
            present = vocabulary_named(self._document, chosen)
            return Vocabulary(chosen, entries, "" if present is None else present.description)
        if self._labels.currentText() == tr(SCENARIO_LABELS):
            return Vocabulary(SCENARIO_LABELS, entries)
        taken = {vocabulary.name for vocabulary in self._document.vocabularies}
        return Vocabulary(free_name(tier_name, "", taken.__contains__, number_as=" {}"), entries)

    def _on_labels_chosen(self) -> None:
        present = vocabulary_named(self._document, self._chosen_name())
        if present is not None:
            self._list.setPlainText(text_of(present))
        elif self._labels.currentText() == tr(SCENARIO_LABELS):
            self._list.setPlainText("\n".join(self._scenario_labels))
        else:
            self._list.clear()
        self._list.setVisible(self._labels.currentText() != tr(FREE_TEXT))
        self.adjustSize()

    def _on_save(self) -> None:
        request = self.requested_tier()
        if request.vocabulary is not None and not request.vocabulary.entries:
            self.refuse(tr("Write at least one label, or choose free text."))
        else:
            self.refuse(self._apply(request))


class ImportDialog(_Dialog):
    """Annotations from an .eaf or CSV file, with the coder's name.

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
        super().__init__(theme, parent, "import", tr("Import annotations"), QSize(560, 300))
        self._import_file = import_file
        self.labelled(tr("Choose the file and its coder"), "heading", "heading")
        self.labelled(
            tr(
                "ELAN files (.eaf) and CSV tables with tier, start, end and label. They are imported as "
                "separate tiers; existing annotations do not change."
            ),
            "hint",
            "note",
        )
        self.path_field = named(QLineEdit(), "import_path", tr("File"))
        self.path_field.returnPressed.connect(self._on_import)
        browse = self.button("import_browse", tr("Browse"), self.browse, icon="folder-open", height_px=36)
        path = layouts.hbox(None, (self.path_field, 1), browse, spacing_px=8)
        self._coder = self.coder_field(coders, "", tr("initials; empty: from the file"))
        self.add_form((tr("Coder"), self._coder)).insertRow(0, tr("File"), path)
        self.column.addStretch(1)
        self.add_buttons(tr("Cancel"), self._primary("import_take", tr("Import"), self._on_import))

    def browse(self) -> None:
        kinds = ((tr("Annotations ({files})"), _FORMATS), (tr("All files ({files})"), "*"))
        files = ";;".join(kind.format(files=files) for kind, files in kinds)
        typed = self.path_field.text()
        file_dialog(
            self, "import_chooser", tr("Annotations to import"), self._on_file_chosen, files=files,
            folder=typed_path(typed) if typed else None,
        ).show()  # fmt: skip

    def _on_file_chosen(self, path: Path) -> None:
        self.path_field.setText(str(path))

    def _on_import(self) -> None:
        text = self.path_field.text().strip()
        if not text:
            self.refuse(tr("Choose a file first."))
            return
        self.refuse(tr("Reading the file."))

        def on_imported(refusal: str) -> None:
            # The dialog may have been closed or another file chosen meanwhile.
            if shiboken6.isValid(self) and self.isVisible() and self.path_field.text().strip() == text:
                self.refuse(refusal)

        self._import_file(typed_path(text), " ".join(self._coder.currentText().split()), on_imported)


TOLERANCES_MS = (100, 250, 500, 1000, 2000)
UNIT_MS = 100
_USUAL_MS = 500
_LEAST_TABLE_PX = 140
_FITTING_COLUMNS = 7
# Landis and Koch (1977), the usual verbal scale.
_STRENGTHS = (
    (0.8, QT_TR_NOOP("almost perfect")),
    (0.6, QT_TR_NOOP("substantial")),
    (0.4, QT_TR_NOOP("moderate")),
    (0.2, QT_TR_NOOP("fair")),
    (0.0, QT_TR_NOOP("slight")),
)


def kappa_words(result: Agreement) -> str:
    if result.kappa is None:
        return tr("not defined") if result.observed is None else tr("not defined: only one label used")
    strength = next((word for floor, word in _STRENGTHS if result.kappa >= floor), QT_TR_NOOP("poor"))
    return f"{result.kappa:.2f}, {tr(strength)}"


def likely_pair(tiers: list[Tier]) -> tuple[int, int]:
    """Two coders' tiers of the same name, else the first two."""
    for first, one in enumerate(tiers):
        for second, other in enumerate(tiers[first + 1 :], start=first + 1):
            if one.name == other.name and one.coder != other.coder:
                return first, second
    return 0, min(1, len(tiers) - 1)


class AgreementDialog(_Dialog):
    """Compares two tiers in their state at opening, again on each selection."""

    def __init__(self, theme: Theme, document: AnnotationDocument, parent: QWidget) -> None:
        super().__init__(theme, parent, "agreement", tr("Agreement between two coders"), QSize(640, 620))
        self._document = document
        self.agreement: TierAgreement | None = None
        tiers = [tier for tier in document.tiers if tier.coder]
        self._first = DropDown(theme, "agreement_first", tr("First tier"))
        self._second = DropDown(theme, "agreement_second", tr("Second tier"))
        for choice, index in zip((self._first, self._second), likely_pair(tiers), strict=True):
            for tier in tiers:
                text = tr("{tier} of {coder}").format(tier=tr_filled(tier.title), coder=tier.coder)
                choice.addItem(text, tier.tier_id)
            choice.setCurrentIndex(index)
        self._tolerance = DropDown(theme, "agreement_tolerance", tr("Timing tolerance"))
        self._tolerance.fill([(f"± {milliseconds} ms", milliseconds) for milliseconds in TOLERANCES_MS], _USUAL_MS)
        content = QWidget()
        outer, self.column = self.column, layouts.vbox(content, margins_px=0, spacing_px=12)
        choices = (
            (tr("First"), self._first), (tr("Second"), self._second), (tr("Timing tolerance"), self._tolerance),
        )  # fmt: skip
        self.add_form(*choices)
        for _, choice in choices:
            choice.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
            choice.currentIndexChanged.connect(self._compare)
        self._kappa = self.labelled("", "kappa")
        self._lines = self.labelled("", "lines")
        self._lines.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._table_words = self.labelled(
            tr("Confusion matrix in tenths of a second: first coder in rows, second coder in columns"),
            "table_words",
            "note",
        )
        self._table = named(QTableWidget(), "agreement_table")
        self._table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self._table.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self._table.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._table.setItemDelegate(_TintedCells(self._table))
        self._table.setMinimumHeight(_LEAST_TABLE_PX)
        self._table.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Ignored)
        self.column.addWidget(self._table, 1)
        self.column = outer
        self.column.addWidget(Scrolled(content), 1)
        self._copy = self.button("agreement_copy", tr("Copy report"), self._on_copy, icon="copy", height_px=40)
        self.add_buttons(tr("Close"), self._copy)
        self._compare()

    def _compare(self) -> None:
        first, second = self._first.currentData(), self._second.currentData()
        self.agreement = None
        refusal = tr("Choose two different tiers.")
        try:
            if first != second:
                self.agreement = compare_tiers(
                    self._document, first, second, unit_ms=UNIT_MS, tolerance_ms=self._tolerance.currentData()
                )
        except AnnotationError as error:
            refusal = str(error)
            refusal = tr(refusal)
        if self.agreement is None:
            self._lines.setText(refusal)
        else:
            self._show(self.agreement)
        for part in (self._kappa, self._table, self._table_words):
            part.setVisible(self.agreement is not None)
        self._copy.setEnabled(self.agreement is not None)

    def _show(self, result: TierAgreement) -> None:
        self._kappa.setText(f"κ {kappa_words(result.per_unit)}")
        lines = []
        if result.per_unit.observed is not None:
            share = 100 * result.per_unit.observed
            same = tr("Same label for {share} % of the time, in steps of {step} ms.")
            lines.append(same.format(share=f"{share:.0f}", step=UNIT_MS))
        lines.append(tr("Per annotation: κ {kappa}.").format(kappa=kappa_words(result.per_annotation)))
        if result.offsets is not None:
            offsets = result.offsets
            lines.append(
                tr("{count} annotations match. On average, {coder} starts them {start} and ends them {end}.").format(
                    count=offsets.matched,
                    coder=result.coders[1],
                    start=_shift(offsets.start_mean_ms),
                    end=_shift(offsets.end_mean_ms),
                )
            )
        self._lines.setText("\n".join(lines))
        names = [label or tr("nothing") for label in result.per_unit.labels]
        few = len(names) <= _FITTING_COLUMNS
        self._table.horizontalHeader().setSectionResizeMode(
            QHeaderView.ResizeMode.Stretch if few else QHeaderView.ResizeMode.ResizeToContents
        )
        self._table.setRowCount(len(names))
        self._table.setColumnCount(len(names))
        self._table.setHorizontalHeaderLabels(names)
        self._table.setVerticalHeaderLabels(names)
        for row, counts in enumerate(result.per_unit.matrix):
            for column, count in enumerate(counts):
                cell = QTableWidgetItem(f"{count:,}" if count else "·")
                cell.setTextAlignment(Qt.AlignmentFlag.AlignCenter)
                cell.setForeground(self._theme.color("text" if count else "dim"))
                if row == column:
                    cell.setBackground(self._theme.color("green_soft"))
                elif count:
                    cell.setBackground(self._theme.color("amber_soft"))
                self._table.setItem(row, column, cell)

    def _on_copy(self) -> None:
        if self.agreement is not None:
            QApplication.clipboard().setText(report(self.agreement))


class _TintedCells(QStyledItemDelegate):
    """Paints cell backgrounds, which Qt omits in an application with a style sheet."""

    def paint(
        self, painter: QPainter, option: QStyleOptionViewItem, index: QModelIndex | QPersistentModelIndex
    ) -> None:
        ground = index.data(int(Qt.ItemDataRole.BackgroundRole))
        if isinstance(ground, QBrush):
            painter.fillRect(option.rect, ground)
        super().paint(painter, option, index)


def _shift(milliseconds: float) -> str:
    if abs(milliseconds) < 0.5:
        return tr("at the same moment")
    shift = tr("{time} ms later") if milliseconds > 0 else tr("{time} ms earlier")
    return shift.format(time=f"{abs(milliseconds):.0f}")
