"""Intercoder agreement dialog: measures for two tiers, and their differences."""

from PySide6.QtCore import QModelIndex, QPersistentModelIndex, QSize, Qt
from PySide6.QtGui import QBrush, QPainter
from PySide6.QtWidgets import (
    QAbstractItemView,
    QApplication,
    QDialog,
    QGridLayout,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QSizePolicy,
    QStyledItemDelegate,
    QStyleOptionViewItem,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from caris_desktop.domain.translation import QT_TR_NOOP, tr, tr_filled
from caris_desktop.recording.annotation.annotation_editing import AnnotationError
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument, Tier
from caris_desktop.recording.annotation.coder_agreement import Agreement, TierAgreement, compare_tiers, report
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.tab_order import VisualTabOrderMixin
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.drop_down import DropDown
from caris_desktop.ui.widgets.scroll_areas import Scrolled

TOLERANCES_MS = (100, 250, 500, 1000, 2000)
UNIT_MS = 100
_USUAL_MS = 500
_LEAST_TABLE_PX = 140
_FITTING_COLUMNS = 7
# Landis and Koch (1977), the usual verbal scale.
_STRENGTHS = (
    (0.0, QT_TR_NOOP("slight")),
    (0.2, QT_TR_NOOP("fair")),
    (0.4, QT_TR_NOOP("moderate")),
    (0.6, QT_TR_NOOP("substantial")),
    (0.8, QT_TR_NOOP("almost perfect")),
)


def strength(kappa: float) -> str:
    """Landis and Koch's label of a kappa value."""
    if kappa < 0:
        return tr("poor")
    word = next(word for floor, word in reversed(_STRENGTHS) if kappa >= floor)
    return tr(word)


def kappa_words(result: Agreement) -> str:
    if result.kappa is None:
        return tr("not defined") if result.observed is None else tr("not defined: only one label used")
    return f"{result.kappa:.2f}, {strength(result.kappa)}"


def likely_pair(tiers: list[Tier]) -> tuple[int, int]:
    """Two coders' tiers of the same name, else the first two."""
    for first, one in enumerate(tiers):
        for second, other in enumerate(tiers[first + 1 :], start=first + 1):
            if one.name == other.name and one.coder != other.coder:
                return first, second
    return 0, min(1, len(tiers) - 1)


class AgreementDialog(VisualTabOrderMixin, QDialog):
    """Compares two tiers in their state at opening, again on each selection."""

    def __init__(self, theme: Theme, document: AnnotationDocument, parent: QWidget) -> None:
        super().__init__(parent)
        self.setObjectName("agreement_dialog")
        self.setWindowTitle(tr("Agreement between two coders"))
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self._theme = theme
        self._document = document
        self._tiers = [tier for tier in document.tiers if tier.coder]
        self._result: TierAgreement | None = None
        self._first = DropDown(theme, "agreement_first", tr("First tier"))
        self._second = DropDown(theme, "agreement_second", tr("Second tier"))
        self._tolerance = DropDown(theme, "agreement_tolerance", tr("Timing tolerance"))
        for tier in self._tiers:
            for choice in (self._first, self._second):
                choice.addItem(
                    tr("{tier} of {coder}").format(tier=tr_filled(tier.title), coder=tier.coder), tier.tier_id
                )
        for milliseconds in TOLERANCES_MS:
            self._tolerance.addItem(f"± {milliseconds} ms", milliseconds)
        self._tolerance.setCurrentIndex(TOLERANCES_MS.index(_USUAL_MS))
        first, second = likely_pair(self._tiers)
        self._first.setCurrentIndex(first)
        self._second.setCurrentIndex(second)
        for choice in (self._first, self._second, self._tolerance):
            choice.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
            choice.currentIndexChanged.connect(self._compare)
        self._kappa = QLabel()
        self._kappa.setObjectName("agreement_kappa")
        self._kappa.setFont(theme.font(28, tokens.WEIGHT_SEMIBOLD))
        self._lines = QLabel(wordWrap=True)
        self._lines.setObjectName("agreement_lines")
        self._lines.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._table_words = QLabel(
            tr("Confusion matrix in tenths of a second: first coder in rows, second coder in columns")
        )
        self._table_words.setFont(theme.font(tokens.STATUS_PX))
        self._table_words.setWordWrap(True)
        theme.color_text(self._table_words, "dim")
        self._table = QTableWidget()
        self._table.setObjectName("agreement_table")
        self._table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self._table.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self._table.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._table.setItemDelegate(_TintedCells(self._table))
        self._table.setFont(theme.font(tokens.STATUS_PX))
        choices = QGridLayout()
        choices.setHorizontalSpacing(16)
        choices.setVerticalSpacing(8)
        for row, (words, choice) in enumerate(
            ((tr("First"), self._first), (tr("Second"), self._second), (tr("Timing tolerance"), self._tolerance))
        ):
            choices.addWidget(QLabel(words), row, 0)
            choices.addWidget(choice, row, 1)
        choices.setColumnStretch(1, 1)
        copy = ActionButton(theme, tr("Copy report"), icon="copy", height_px=40)
        copy.setObjectName("agreement_copy")
        copy.clicked.connect(self._on_copy)
        close = ActionButton(theme, tr("Close"), role="ghost", height_px=40)
        close.clicked.connect(self.reject)
        buttons = QHBoxLayout()
        buttons.addWidget(close)
        buttons.addStretch(1)
        buttons.addWidget(copy)
        content = QWidget()
        layout = layouts.vbox(content, margins_px=0, spacing_px=12)
        layout.addLayout(choices)
        layout.addWidget(self._kappa)
        layout.addWidget(self._lines)
        layout.addWidget(self._table_words)
        layout.addWidget(self._table, 1)
        self._table.setMinimumHeight(_LEAST_TABLE_PX)
        self._table.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Ignored)
        outer = layouts.vbox(self, margins_px=24, spacing_px=12)
        outer.addWidget(Scrolled(content), 1)
        outer.addLayout(buttons)
        self._copy = copy
        self._compare()

    def sizeHint(self) -> QSize:
        return QSize(640, 620)

    @property
    def agreement(self) -> TierAgreement | None:
        """Current comparison."""
        return self._result

    def _compare(self) -> None:
        first, second = self._first.currentData(), self._second.currentData()
        self._result = None
        refusal = tr("Choose two different tiers.")
        try:
            if first != second:
                self._result = compare_tiers(
                    self._document, first, second, unit_ms=UNIT_MS, tolerance_ms=self._tolerance.currentData()
                )
        except AnnotationError as error:
            refusal = str(error)
            refusal = tr(refusal)
        if self._result is None:
            self._lines.setText(refusal)
        else:
            self._show(self._result)
        for part in (self._kappa, self._table, self._table_words):
            part.setVisible(self._result is not None)
        self._copy.setEnabled(self._result is not None)

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
        if self._result is not None:
            QApplication.clipboard().setText(report(self._result))


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
