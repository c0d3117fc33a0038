"""The line below the timeline: the labels of the tier that is coded on, each with its key, and what can be done."""

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QHBoxLayout, QLabel, QSizePolicy, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.recording.annotation.model import Vocabulary
from caris_desktop.ui import tokens
from caris_desktop.ui.action_rows import CODE_COUNT
from caris_desktop.ui.actions import Actions
from caris_desktop.ui.panel import show_part
from caris_desktop.ui.replay.plain_tip import plain_tip
from caris_desktop.ui.replay.timeline_model import Row, exact_text
from caris_desktop.ui.replay.timeline_overlay import OpenStretch
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton

_ACTS = (
    ("annotation_new", QT_TR_NOOP("New")),
    ("annotation_split", QT_TR_NOOP("Split")),
    ("annotation_rename", QT_TR_NOOP("Rename")),
    ("annotation_remove", QT_TR_NOOP("Remove")),
)


class CodingStrip(QWidget):
    """``add_tier_wanted`` where there is nothing to code on yet; everything else runs the table's actions."""

    add_tier_wanted = Signal()

    def __init__(self, theme: Theme, actions: Actions) -> None:
        super().__init__()
        self.setObjectName("coding_strip")
        self.setFixedHeight(40)
        self._theme = theme
        self._shown: tuple[object, ...] | None = None
        self._words = QLabel()
        self._words.setObjectName("coding_words")
        self._words.setTextFormat(Qt.TextFormat.PlainText)
        self._words.setSizePolicy(QSizePolicy.Policy.Maximum, QSizePolicy.Policy.Preferred)
        self._add = ActionButton(theme, tr("Add a tier"), icon="plus", look="primary", height_px=30)
        self._add.setObjectName("coding_add_tier")
        self._add.clicked.connect(self.add_tier_wanted)
        self._labels: list[ActionButton] = []
        for number in range(1, CODE_COUNT + 1):
            button = ActionButton(theme, "", key_first=True, height_px=30, text_px=tokens.STATUS_PX, may_shrink=True)
            button.setObjectName(f"code_{number}")
            button.setCheckable(True)
            button.bind(actions, f"code_{number}")
            self._labels.append(button)
        self._acts: list[ActionButton] = []
        for action_id, text in _ACTS:
            button = ActionButton(theme, tr(text), look="ghost", height_px=30, text_px=tokens.STATUS_PX)
            button.setObjectName(action_id)
            button.bind(actions, action_id)
            self._acts.append(button)
        row = QHBoxLayout(self)
        row.setContentsMargins(16, 4, 8, 4)
        row.setSpacing(8)
        row.addWidget(self._words)
        row.addWidget(self._add)
        for button in self._labels:
            row.addWidget(button)
        row.addStretch(1)
        for button in self._acts:
            row.addWidget(button)
        theme.changed.connect(self._style)
        self._style()

    def show_tier(
        self, row: Row | None, vocabulary: Vocabulary | None, stretch: OpenStretch | None, *, tiers: int
    ) -> None:
        """``row`` is the tier that keys act on, ``tiers`` how many there are to choose from."""
        shown = (row, vocabulary, stretch, tiers)
        if shown == self._shown:
            return
        self._shown = shown
        own = row is not None and row.own
        entries = () if vocabulary is None or not own else vocabulary.entries
        if not tiers:
            words = tr("Nothing is coded in this session yet.")
        elif row is None or not own:
            words = tr("Every coder’s tier is hidden.")
        elif stretch is not None:
            words = tr("{tier}: since {time}").format(tier=row.name, time=exact_text(stretch.start_ms)[:-2])
        elif entries:
            words = tr("{tier} of {coder}").format(tier=row.name, coder=row.coder)
        else:
            words = tr("{tier} of {coder} · drag on the tier to add an annotation")
            words = words.format(tier=row.name, coder=row.coder)
        self._words.setText(words)
        show_part(self._add, not tiers)
        for number, button in enumerate(self._labels):
            present = number < len(entries)
            if present:
                entry = entries[number]
                open_now = stretch is not None and stretch.value == entry.value
                button.set_label(tr("End {label}").format(label=entry.value) if open_now else entry.value)
                button.setChecked(open_now)
                button.setToolTip(
                    plain_tip(entry.description) or tr("Starts at the playhead; the second press ends it")
                )
            show_part(button, present)
        for button in self._acts:
            show_part(button, own)

    def _style(self) -> None:
        self._words.setFont(self._theme.font(tokens.STATUS_PX))
        self._theme.color_text(self._words, "dim")
