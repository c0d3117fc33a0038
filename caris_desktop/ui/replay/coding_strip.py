"""Coding strip below the timeline: labels of the active tier with their keys, and commands."""

from collections.abc import Callable

from PySide6.QtCore import QPoint, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QMenu, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.recording.annotation.annotation_model import Vocabulary
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_rows import CODE_COUNT
from caris_desktop.ui.panel import show_part
from caris_desktop.ui.replay.timeline_model import Row, exact_text
from caris_desktop.ui.replay.timeline_overlay import OpenInterval
from caris_desktop.ui.text_formatting import in_menu
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.elided_label import ElidedLabel

_ACTS = (
    ("annotation_new", "plus", QT_TR_NOOP("New")),
    ("annotation_split", "scissors", QT_TR_NOOP("Split")),
    ("annotation_rename", "pencil-simple", QT_TR_NOOP("Rename")),
    ("annotation_remove", "trash", QT_TR_NOOP("Remove")),
)
_NARROW_BELOW_PX = 1000
_SIDE_PX = 16
_LEAST_WORDS_PX, _MOST_WORDS_PX, _LABEL_PX, _GAP_PX = 72, 640, 112, 8


class CodingStrip(QWidget):
    """Coding strip. ``add_tier_wanted``: no tier yet; all else runs actions of the table.

    In a narrow strip commands show icons only, and labels that do not fit are in a menu.
    """

    add_tier_wanted = Signal()

    def __init__(self, theme: Theme, actions: Actions) -> None:
        super().__init__()
        self.setObjectName("coding_strip")
        self.setFixedHeight(40)
        self._theme = theme
        self._shown: tuple[object, ...] | None = None
        self._actions = actions
        self._present = 0
        self._narrow = False
        self._words = ElidedLabel()
        self._words.setObjectName("coding_words")
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
        self._more = ActionButton(theme, "", icon="caret-double-right", look="amber", height_px=30)
        self._more.setObjectName("coding_more")
        self._more.setAccessibleName(tr("More labels"))
        self._more.setToolTip(tr("More labels: their keys also work"))
        self._more.clicked.connect(self._open_more)
        self._more.hide()
        self._acts: list[ActionButton] = []
        for action_id, _icon, text in _ACTS:
            button = ActionButton(theme, tr(text), look="ghost", height_px=30, text_px=tokens.STATUS_PX)
            button.setObjectName(action_id)
            button.setToolTip(tr(text))
            button.bind(actions, action_id)
            self._acts.append(button)
        row = layouts.hbox(self, margins_px=(_SIDE_PX, 4, 8, 4), spacing_px=_GAP_PX)
        row.addWidget(self._words, 1)
        row.addWidget(self._add)
        for button in (*self._labels, self._more):
            row.addWidget(button)
        row.addStretch(1)
        for button in self._acts:
            row.addWidget(button)
        theme.restyle_on_change(self._style)

    def show_tier(
        self, row: Row | None, vocabulary: Vocabulary | None, stretch: OpenInterval | None, *, tiers: int
    ) -> None:
        """``row``: the active tier; ``tiers``: the number of tiers."""
        shown = (row, vocabulary, stretch, tiers)
        if shown == self._shown:
            return
        self._shown = shown
        own = row is not None and row.own
        entries = () if vocabulary is None or not own else vocabulary.entries
        if not tiers:
            words = tr("Nothing is coded in this session yet.")
        elif row is None or not own:
            words = tr("All coders’ tiers are hidden.")
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
            if number < len(entries):
                entry = entries[number]
                open_now = stretch is not None and stretch.value == entry.value
                button.set_label(tr("End {label}").format(label=entry.value) if open_now else entry.value)
                button.setChecked(open_now)
                button.setToolTip(entry.description or tr("Press once to start at the playhead, again to end"))
        self._present = min(len(entries), len(self._labels))
        for button in self._acts:
            show_part(button, own)
        self._fit()

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._fit()

    def _fit(self) -> None:
        narrow = self.width() < _NARROW_BELOW_PX
        if narrow != self._narrow:
            self._narrow = narrow
            for button, (_, icon, text) in zip(self._acts, _ACTS, strict=True):
                button.set_label("" if narrow else tr(text), icon=icon if narrow else "")
                button.setAccessibleName(tr(text))
                button.set_key_shown(not narrow)
        words_px = min(_MOST_WORDS_PX, self._words.sizeHint().width() + 2)
        least_words_px = min(words_px, _LEAST_WORDS_PX) if self._present else words_px
        self._words.setMaximumWidth(words_px)
        self._words.setMinimumWidth(min(least_words_px, max(0, self.width() - 2 * _SIDE_PX)) if narrow else 0)
        taken = [self._words.minimumWidth() if narrow else words_px]
        taken += [button.sizeHint().width() for button in self._acts if not button.isHidden()]
        if not self._add.isHidden():
            taken.append(self._add.sizeHint().width())
        room_px = self.width() - 2 * _SIDE_PX - sum(taken) - _GAP_PX * (len(taken) + 1)
        each = [min(button.sizeHint().width(), _LABEL_PX) + _GAP_PX for button in self._labels[: self._present]]
        shown = self._present
        if narrow and sum(each) > room_px:
            room_px -= self._more.sizeHint().width() + _GAP_PX
            shown = max(1, sum(sum(each[: number + 1]) <= room_px for number in range(self._present)))
        for number, button in enumerate(self._labels):
            show_part(button, number < shown)
        show_part(self._more, shown < self._present)

    def _open_more(self) -> None:
        menu = QMenu(self)
        menu.setObjectName("more_codes_menu")
        for number, button in enumerate(self._labels[: self._present]):
            if button.isHidden():
                text = in_menu(f"{button.key}  {button.text()}")
                menu.addAction(text, self._runner(number + 1))
        menu.aboutToHide.connect(menu.deleteLater)
        menu.popup(self._more.mapToGlobal(QPoint(0, -menu.sizeHint().height())))

    def _runner(self, number: int) -> Callable[[], object]:
        return lambda: self._actions.run(f"code_{number}")

    def _style(self) -> None:
        self._theme.style_text(self._words, "dim", tokens.STATUS_PX)
