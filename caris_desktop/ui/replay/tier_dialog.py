"""Tier dialog: coder, name and labels of a new or existing tier."""

from collections.abc import Callable, Sequence

from PySide6.QtCore import QSize, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QComboBox, QDialog, QFormLayout, QHBoxLayout, QLabel, QLineEdit, QPlainTextEdit, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr, tr_filled
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation import annotation_editing
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument, Tier, Vocabulary, VocabularyEntry
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.replay.timeline_model import SCENARIO_LABELS, vocabulary_named, vocabulary_title
from caris_desktop.ui.tab_order import VisualTabOrderMixin
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.drop_down import DropDown

FREE_TEXT = QT_TR_NOOP("Free text")
OWN_LIST = QT_TR_NOOP("A list of labels…")


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


def with_tier(document: AnnotationDocument, wish: TierRequest, tier: Tier | None) -> AnnotationDocument:
    """The document with a new tier, or ``tier`` changed. Raises AnnotationError."""
    name = ""
    if wish.vocabulary is not None:
        name = wish.vocabulary.name
        present = vocabulary_named(document, name)
        if present is None:
            document = annotation_editing.add_vocabulary(document, wish.vocabulary)
        elif present.entries != wish.vocabulary.entries:
            renamed = renamed_labels(present, wish.vocabulary)
            document = annotation_editing.change_vocabulary(document, name, wish.vocabulary, renamed=renamed)
    if tier is None:
        return annotation_editing.add_tier(document, wish.name, wish.coder, name)
    document = annotation_editing.rename_tier(document, tier.tier_id, wish.name)
    return annotation_editing.set_tier_vocabulary(document, tier.tier_id, name) if name != tier.vocabulary else document


class TierDialog(VisualTabOrderMixin, QDialog):
    """Stays open with the reason if ``apply`` refuses."""

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
        super().__init__(parent)
        self.setObjectName("tier_dialog")
        self.setWindowTitle(tr("Add a tier") if tier is None else tr("Change the tier"))
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self._document = document
        self._tier = tier
        self._apply = apply
        self._scenario_labels = tuple(dict.fromkeys(label.strip() for label in scenario_labels if label.strip()))
        heading = QLabel(
            tr("What will be coded?")
            if tier is None
            else tr("Tier {tier} of {coder}").format(tier=tr_filled(tier.title), coder=tier.coder)
        )
        heading.setFont(theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        self._coder = DropDown(theme, "tier_coder", tr("Coder"))
        self._coder.setEditable(True)
        self._coder.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self._coder.setMinimumHeight(36)
        self._coder.setInsertPolicy(QComboBox.InsertPolicy.NoInsert)
        self._coder.addItems(annotation_editing.coders_of(document))
        self._coder.setCurrentText(coder or (tier.coder if tier is not None else ""))
        line = self._coder.lineEdit()
        if line is not None:
            line.setPlaceholderText(tr("your name or initials"))
            line.setMaxLength(annotation_editing.LONGEST_NAME)
        self._name = QLineEdit("" if tier is None else tr_filled(tier.title), placeholderText=tr("for example Stance"))
        self._name.setObjectName("tier_name")
        self._name.setAccessibleName(tr("Name of the tier"))
        self._name.setMinimumHeight(36)
        self._name.setMaxLength(annotation_editing.LONGEST_NAME)
        self._labels = DropDown(theme, "tier_vocabulary", tr("Labels"))
        self._labels.setMinimumHeight(36)
        self._labels.addItem(tr(FREE_TEXT))
        for vocabulary in document.vocabularies:
            title = vocabulary_title(vocabulary.name)
            words = tr("{vocabulary} (%n labels)", "", len(vocabulary.entries)).format(vocabulary=title)
            self._labels.addItem(words, vocabulary.name)
        if self._scenario_labels and vocabulary_named(document, SCENARIO_LABELS) is None:
            self._labels.addItem(tr(SCENARIO_LABELS))
        self._labels.addItem(tr(OWN_LIST))
        if tier is not None and tier.vocabulary:
            self._labels.setCurrentIndex(self._labels.findData(tier.vocabulary))
        self._labels.currentIndexChanged.connect(self._on_labels_chosen)
        self._list = QPlainTextEdit(tabChangesFocus=True)
        self._list.setObjectName("tier_labels")
        self._list.setAccessibleName(tr("Labels, one per line"))
        self._list.setPlaceholderText(
            tr("One label per line, with its meaning after a colon:\ncurious: leans in, asks")
        )
        self._list.setMinimumHeight(120)
        self._refusal = QLabel(wordWrap=True)
        self._refusal.setObjectName("tier_refusal")
        theme.style_text(self._refusal, "amber", tokens.STATUS_PX)
        form = QFormLayout()
        form.setHorizontalSpacing(16)
        form.setVerticalSpacing(8)
        form.setLabelAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        if tier is None:
            form.addRow(_form_label(tr("Coder")), self._coder)
        else:
            self._coder.setParent(self)
            self._coder.hide()
        form.addRow(_form_label(tr("Tier")), self._name)
        form.addRow(_form_label(tr("Labels")), self._labels)
        form.addRow("", self._list)
        self._save = ActionButton(
            theme,
            tr("Add tier") if tier is None else tr("Change"),
            icon="check",
            key="Enter",
            role="primary",
            height_px=40,
        )
        self._save.setObjectName("tier_save")
        self._save.clicked.connect(self._on_save)
        cancel = ActionButton(theme, tr("Cancel"), role="ghost", height_px=40)
        cancel.setObjectName("tier_cancel")
        cancel.clicked.connect(self.reject)
        buttons = QHBoxLayout()
        buttons.addWidget(cancel)
        buttons.addStretch(1)
        buttons.addWidget(self._save)
        layout = layouts.vbox(self, margins_px=24, spacing_px=16)
        layout.addWidget(heading)
        layout.addLayout(form)
        layout.addWidget(self._refusal)
        layout.addStretch(1)
        layout.addLayout(buttons)
        self._name.returnPressed.connect(self._on_save)
        if line is not None:
            line.returnPressed.connect(self._on_save)
        self._refusal.hide()
        self._on_labels_chosen()
        (self._name if self._coder.currentText() else self._coder).setFocus(Qt.FocusReason.OtherFocusReason)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Enter accepts the dialog, except in the list of labels, where it adds a line."""
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter) and not self._list.hasFocus():
            self._on_save()
            return
        super().keyPressEvent(event)

    def sizeHint(self) -> QSize:
        return QSize(480, super().sizeHint().height())

    def requested_tier(self) -> TierRequest:
        coder, name = " ".join(self._coder.currentText().split()), " ".join(self._name.text().split())
        if self._tier is not None and self._name.text() == tr_filled(self._tier.title):
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
        name, number = tier_name, 2
        while vocabulary_named(self._document, name) is not None:
            name, number = f"{tier_name} {number}", number + 1
        return Vocabulary(name, entries)

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
        wish = self.requested_tier()
        if wish.vocabulary is not None and not wish.vocabulary.entries:
            refusal = tr("Write at least one label, or choose free text.")
        else:
            refusal = self._apply(wish)
        self._refusal.setText(refusal)
        self._refusal.setVisible(bool(refusal))
        if not refusal:
            self.accept()


def _form_label(text: str) -> QLabel:
    """Label as high as its field, for a common baseline."""
    label = QLabel(text)
    label.setMinimumHeight(36)
    return label
