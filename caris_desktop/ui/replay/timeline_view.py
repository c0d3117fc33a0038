"""The timeline of a replay: what happened and what coders make of it, in tiers under one ruler."""

import sys
from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import QEvent, QKeyCombination, QObject, QPoint, QPointF, QRectF, QSize, Qt
from PySide6.QtGui import QKeyEvent, QKeySequence, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import (
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QMenu,
    QScrollBar,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from caris_desktop.live.state import LiveState
from caris_desktop.live.status import PlaybackStatus
from caris_desktop.live.wizard_console import ReplayControls
from caris_desktop.recording.annotation import editing
from caris_desktop.recording.annotation.editing import AnnotationError
from caris_desktop.recording.annotation.model import Annotation, AnnotationDocument, Tier, Vocabulary
from caris_desktop.recording.annotation.overview import SessionOverview
from caris_desktop.ui import tokens
from caris_desktop.ui.actions import TIMELINE_ACTIONS, Actions, normalized
from caris_desktop.ui.key_positions import key_code, position_of
from caris_desktop.ui.panel import TITLE_HEIGHT_PX, draw_card
from caris_desktop.ui.replay.agreement_dialog import AgreementDialog
from caris_desktop.ui.replay.coding_strip import CodingStrip
from caris_desktop.ui.replay.import_dialog import ImportDialog
from caris_desktop.ui.replay.label_card import LabelCard
from caris_desktop.ui.replay.plain_tip import plain_tip
from caris_desktop.ui.replay.seek_throttle import SeekThrottle
from caris_desktop.ui.replay.thumbnails import Thumbnails
from caris_desktop.ui.replay.tier_dialog import TierDialog, TierWish, with_tier
from caris_desktop.ui.replay.timeline_canvas import OpenStretch, TimelineCanvas
from caris_desktop.ui.replay.timeline_drawing import NAMES_PX, RULER_PX
from caris_desktop.ui.replay.timeline_model import (
    Row,
    Track,
    all_rows,
    arranged,
    exact_text,
    length_text,
    moved_key,
    tracks_of,
    vocabulary_named,
)
from caris_desktop.ui.replay.words_bubble import WordsBubble
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton

NEW_MS = 1000
NUDGE_MS = 50
_ZOOM_STEP = 1.5
_LOW_PX = 168
# These go on while their key is held.
_REPEATED = ("seek_by", "nudge", "select_next", "select_tier", "zoom")
_NOT_A_MODIFIER = Qt.KeyboardModifier.KeypadModifier | Qt.KeyboardModifier.GroupSwitchModifier


class TimelineView(QWidget):
    """Shows the record and edits annotations; ``actions`` gets the keys of the timeline."""

    def __init__(self, theme: Theme, replay: ReplayControls, state: LiveState, actions: Actions) -> None:
        super().__init__()
        self.setObjectName("timeline_view")
        self.setAccessibleName("Timeline of the session")
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Expanding)
        self._theme = theme
        self._replay = replay
        self._state = state
        self._actions = actions
        actions.add_rows(TIMELINE_ACTIONS, self)
        self._rows: list[Row] = []
        self._order: list[str] = []
        self._hidden: set[str] = set()
        self._tracks: dict[str, Track] = {}
        self._own_tracks: dict[str, Track] = {}
        self._record_tracks: dict[str, Track] = {}
        self._open: OpenStretch | None = None
        self._card: LabelCard | None = None
        self._named = ""
        self.canvas = TimelineCanvas(theme, Thumbnails(replay, self))
        self.canvas.installEventFilter(self)
        self._bubble = WordsBubble(theme, self.canvas)
        self._seeks = SeekThrottle(self)
        self._seeks.due.connect(self._on_seek_due)
        self._across = QScrollBar(Qt.Orientation.Horizontal)
        self._across.valueChanged.connect(self._on_scrolled_across)
        self._down = QScrollBar(Qt.Orientation.Vertical)
        self._down.valueChanged.connect(self.canvas.scroll_to)
        self.strip = CodingStrip(theme, actions)
        self.strip.add_tier_wanted.connect(self.open_tier_dialog)
        self._header = self._make_header()
        middle = QGridLayout()
        middle.setContentsMargins(1, 0, 1, 0)
        middle.setSpacing(0)
        middle.addWidget(self.canvas, 0, 0)
        middle.addWidget(self._down, 0, 1)
        under = QHBoxLayout()
        under.setContentsMargins(NAMES_PX, 0, 0, 0)
        under.addWidget(self._across)
        middle.addLayout(under, 1, 0)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 1)
        column.setSpacing(0)
        column.addWidget(self._header)
        column.addLayout(middle, 1)
        column.addWidget(self.strip)
        self._connect_canvas()
        replay.overview.changed.connect(self._on_overview_changed)
        replay.coding.changed.connect(self._on_coding_changed)
        replay.playback.changed.connect(self._on_playback_changed)
        theme.changed.connect(self._style)
        self._show_session()
        self._on_overview_changed(replay.overview.value)
        self._on_coding_changed(replay.coding.value)
        self._on_playback_changed(replay.playback.value)
        self.setFocusProxy(self.canvas)
        QWidget.setTabOrder(self.canvas, self._filter)
        self._style()

    def _connect_canvas(self) -> None:
        canvas = self.canvas
        canvas.seek_wanted.connect(self._on_seek_wanted)
        canvas.create_wanted.connect(self._on_create_wanted)
        canvas.move_wanted.connect(self._on_move_wanted)
        canvas.rename_wanted.connect(self._rename)
        canvas.row_menu_wanted.connect(self.open_row_menu)
        canvas.row_opened.connect(self._on_row_opened)
        canvas.row_moved.connect(self.move_row)
        canvas.selection_changed.connect(self._on_selection_changed)
        canvas.view_changed.connect(self._on_view_changed)

    def _make_header(self) -> QWidget:
        theme, actions = self._theme, self._actions
        header = QWidget()
        header.setFixedHeight(TITLE_HEIGHT_PX)
        self._title = QLabel("Timeline")
        self._fact = QLabel()
        self._fact.setObjectName("timeline_fact")
        self._fact.setTextFormat(Qt.TextFormat.PlainText)
        self._fact.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        self._filter = QLineEdit()
        self._filter.setObjectName("tier_filter")
        self._filter.setPlaceholderText("Filter tiers")
        self._filter.setAccessibleName("Show only tiers with these words")
        self._filter.setClearButtonEnabled(True)
        self._filter.setFixedWidth(136)
        self._filter.setFixedHeight(30)
        self._filter.textChanged.connect(self._show_rows)
        self._named_buttons: list[tuple[ActionButton, str]] = []
        row = QHBoxLayout(header)
        row.setContentsMargins(14, 3, 6, 3)
        row.setSpacing(4)
        row.addWidget(self._title)
        row.addSpacing(8)
        row.addWidget(self._fact, 1)
        row.addWidget(self._filter)
        for name, icon, text, tip, act in (
            ("rows_menu_button", "eye", "Rows", "Which rows are shown", self.open_rows_menu),
            ("add_tier", "plus", "Tier", "Add a tier, also for another coder", self.open_tier_dialog),
            ("agreement", "scales", "Agreement", "How far two coders agree", self.open_agreement),
            (
                "import_annotations",
                "download-simple",
                "Import",
                "From ELAN or a CSV table",
                self.open_import,
            ),
        ):
            button = ActionButton(theme, text, icon=icon, height_px=30, text_px=tokens.STATUS_PX + 1)
            button.setObjectName(name)
            button.setToolTip(tip)
            button.clicked.connect(act)
            row.addWidget(button)
            self._named_buttons.append((button, text))
        for action_id in ("undo", "redo", "timeline_smaller", "timeline_larger", "timeline_fit"):
            spec = actions.spec(action_id)
            if spec is None:
                continue
            button = ActionButton(theme, "", icon=spec.icon, look="ghost", height_px=30)
            button.setObjectName(action_id)
            button.setAccessibleName(spec.text)
            button.setToolTip(f"{spec.text} ({actions.key_text(action_id)})")
            button.clicked.connect(self._runner(action_id))
            row.addWidget(button)
        return header

    def _runner(self, action_id: str) -> Callable[[], None]:
        return lambda: self._actions.run(action_id)

    def sizeHint(self) -> QSize:
        return QSize(900, 300)

    def minimumSizeHint(self) -> QSize:
        return QSize(480, TITLE_HEIGHT_PX + RULER_PX + 32)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        low = self.height() < _LOW_PX
        self.strip.setVisible(not low)
        self._across.setVisible(not low)
        roomy = self.width() >= 1040
        for button, text in self._named_buttons:
            if button.text() != (text if roomy else ""):
                button.set_label(text if roomy else "")
                button.setAccessibleName(text)

    # ---- what is on show

    @property
    def document(self) -> AnnotationDocument:
        """The annotations of all coders."""
        document: AnnotationDocument = self._replay.coding.value
        return document

    @property
    def position_ms(self) -> int:
        """The moment on show, in whole milliseconds of the session."""
        return round(self._ms_of(self._replay.playback.value.position_ns))

    @property
    def words(self) -> str:
        """Why the last thing was refused, while that is shown."""
        return self._bubble.text

    def _ms_of(self, at_ns: int) -> float:
        return (at_ns - self._replay.session.started_ns) / 1e6

    def _duration_ms(self) -> float:
        playback: PlaybackStatus = self._replay.playback.value
        return max(self._ms_of(playback.end_ns), float(self.document.duration_ms), 1.0)

    def _show_session(self) -> None:
        self._shown_end_ns: int = self._replay.playback.value.end_ns
        self.canvas.show_session(self._replay.session.started_ns, self._duration_ms())

    def _on_overview_changed(self, overview: SessionOverview | None) -> None:
        self._record_tracks = {}
        if overview is not None:
            self._record_tracks = {f"record {key}": track for key, track in tracks_of(overview.tiers).items()}
        self.canvas.show_overview(overview)
        self._show_rows()
        self._show_tracks()

    def _on_coding_changed(self, document: AnnotationDocument) -> None:
        rows_before = self._rows
        self._own_tracks = tracks_of(document, self._own_tracks)
        self._tracks = {f"tier {key}": track for key, track in self._own_tracks.items()}
        self._show_tracks()
        if [row.tier for row in rows_before if row.own] != [tier for tier in document.tiers if tier.coder]:
            self._show_rows()
        if self._open is not None and self._open.tier_id not in {tier.tier_id for tier in document.tiers}:
            self._set_open(None)
        self._show_session()
        self._on_selection_changed()

    def _show_tracks(self) -> None:
        self.canvas.show_tracks({**self._tracks, **self._record_tracks})

    def _show_rows(self) -> None:
        overview: SessionOverview | None = self._replay.overview.value
        rows = all_rows(overview, self.document)
        self._rows = arranged(rows, self._order, self._hidden, self._filter.text())
        words = "Looking through the session…" if overview is None else "Nothing was recorded that has a place here."
        if rows and not self._rows:
            words = "No row has these words." if self._filter.text().strip() else "All rows are hidden."
        self.canvas.show_rows(self._rows, editing.coders_of(self.document), words=words)
        own = [row for row in self._rows if row.own]
        if self.canvas.active is None and own:
            self.canvas.activate(own[0].key)
        self._on_selection_changed()

    def _on_playback_changed(self, playback: PlaybackStatus) -> None:
        if playback.end_ns != self._shown_end_ns:
            self._show_session()
        self.canvas.show_position(self._ms_of(playback.position_ns), playing=playback.playing)

    def _on_selection_changed(self) -> None:
        active = self.canvas.active
        own = active is not None and active.own
        vocabulary = self._vocabulary_of(active) if own else None
        stretch = self._open if own and active is not None and self._open_on(active) else None
        tiers = sum(1 for tier in self.document.tiers if tier.coder)
        self.strip.show_tier(active, vocabulary, stretch, tiers=tiers)
        self._fact.setText(self._fact_text())
        self._fact.setToolTip(plain_tip(self._fact.text()))
        self.canvas.setAccessibleDescription(self._fact.text())
        self.update()

    def _open_on(self, row: Row) -> bool:
        return self._open is not None and row.tier is not None and row.tier.tier_id == self._open.tier_id

    def _fact_text(self) -> str:
        item = self.canvas.selected
        if item is not None:
            times = f"{exact_text(item.start_ms)} – {exact_text(item.end_ms)}"
            return f"{item.value or 'No label yet'} · {times} · {length_text(item.end_ms - item.start_ms)}"
        if self._replay.overview.value is None:
            return "looking through the session…"
        count, coders = len(self.document.annotations), len(editing.coders_of(self.document))
        if not coders:
            return ""
        return f"{count:,} annotation{'' if count == 1 else 's'} by {coders} coder{'' if coders == 1 else 's'}"

    def _vocabulary_of(self, row: Row | None) -> Vocabulary | None:
        if row is None or row.tier is None or not row.tier.vocabulary:
            return None
        return vocabulary_named(self.document, row.tier.vocabulary)

    def _on_view_changed(self) -> None:
        canvas, scale = self.canvas, self.canvas.scale
        shown_ms, shown_px = canvas.room_px / scale.px_per_ms, canvas.height() - RULER_PX
        for bar, maximum, page, value in (
            (self._across, self._duration_ms() - shown_ms, shown_ms, scale.start_ms),
            (self._down, canvas.rows_height_px - shown_px, shown_px, canvas.scroll_y),
        ):
            bar.blockSignals(True)
            bar.setRange(0, max(0, round(maximum)))
            bar.setPageStep(max(1, round(page)))
            bar.setSingleStep(max(1, round(page / 10)))
            bar.setValue(round(value))
            bar.blockSignals(False)
        self._bubble.hide()

    def _on_scrolled_across(self, start_ms: int) -> None:
        self.canvas.scroll_across_to(float(start_ms))

    # ---- keys

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if watched is self.canvas and event.type() == QEvent.Type.KeyPress and isinstance(event, QKeyEvent):
            return self._press_key(event)
        return super().eventFilter(watched, event)

    def _press_key(self, event: QKeyEvent) -> bool:
        if event.key() == Qt.Key.Key_Escape:
            self.give_up()
            return True
        texts = _texts_of(event)
        for spec in TIMELINE_ACTIONS:
            if spec.within == "timeline" and any(normalized(key) in texts for key in spec.keys):
                if not event.isAutoRepeat() or spec.callback in _REPEATED:
                    self._actions.run(spec.id)
                return True
        return False

    def give_up(self) -> None:
        """Esc: whatever was begun in the timeline is forgotten. The window connects it to ``escape_pressed``."""
        self._bubble.hide()
        if self._card is not None and self._card.give_up():
            return
        if self.canvas.give_up():
            return
        if self._open is not None:
            self._set_open(None)
        else:
            self.canvas.select("")

    # ---- what the table's actions do

    def focus_timeline(self) -> None:
        self.canvas.setFocus(Qt.FocusReason.ShortcutFocusReason)

    def undo(self) -> None:
        if not self._replay.undo():
            self._say("There is nothing to undo.")

    def redo(self) -> None:
        if not self._replay.redo():
            self._say("There is nothing to redo.")

    def zoom(self, direction: int) -> None:
        self.canvas.zoom(_ZOOM_STEP**direction)

    def fit(self) -> None:
        self.canvas.fit()

    def seek_by(self, seconds: float) -> None:
        self._seek(self.position_ms + 1000 * seconds)

    def select_tier(self, direction: int) -> None:
        """The coder's tier below (1) or above (-1)."""
        tiers = [row.key for row in self._rows if row.own]
        active = self.canvas.active
        if not tiers:
            return
        index = tiers.index(active.key) + direction if active is not None and active.key in tiers else 0
        key = tiers[min(max(0, index), len(tiers) - 1)]
        self.canvas.activate(key)
        self.canvas.select("")
        self.canvas.show_row(key)

    def select_next(self, direction: int) -> None:
        """The next annotation of the tier (1), or the one before (-1)."""
        active, selected = self.canvas.active, self.canvas.selected
        if active is None:
            return
        from_ms = self.position_ms if selected is None else selected.start_ms
        found = self.canvas.track_of(active).beside(from_ms, direction)
        if found is None:
            self._say(f"No {'later' if direction > 0 else 'earlier'} annotation on {active.name}.")
            return
        self.canvas.select(found.annotation_id)
        self.canvas.show_stretch(found.start_ms, found.end_ms)
        self._seek(found.start_ms)

    def code(self, number: int) -> None:
        """The key of a label: names what is selected, else starts the label at the playhead, or ends it there."""
        tier = self._own_tier("Add a tier to code on first.")
        if tier is None:
            return
        vocabulary = vocabulary_named(self.document, tier.vocabulary) if tier.vocabulary else None
        if vocabulary is None:
            self._say(f"{tier.name} holds free text. Choose labels for it to code by keys.")
            return
        if number > len(vocabulary.entries):
            self._say(f"{tier.name} has {len(vocabulary.entries)} labels.")
            return
        value = vocabulary.entries[number - 1].value
        selected = self.canvas.selected
        if self._open is None and selected is not None and selected.tier_id == tier.tier_id and not self._playing:
            self._edit(_renaming(selected.annotation_id, value), selected)
            return
        ended = self._open
        if ended is not None and not self._end_open():
            return
        if ended is None or ended.value != value or ended.tier_id != tier.tier_id:
            taken = editing.annotation_at(self.document, tier.tier_id, self.position_ms)
            if taken is not None:
                self._say(f"“{taken.value}” lies here already, until {exact_text(taken.end_ms)}.", taken)
                return
            self.canvas.select("")
            self._set_open(OpenStretch(tier.tier_id, value, self.position_ms))

    @property
    def _playing(self) -> bool:
        return bool(self._replay.playback.value.playing)

    def _end_open(self) -> bool:
        """The open label ends at the playhead, or where the next annotation begins."""
        stretch = self._open
        if stretch is None:
            return True
        self._set_open(None)
        end_ms = self.position_ms
        following = self._tracks.get(f"tier {stretch.tier_id}", Track(())).beside(stretch.start_ms, 1)
        if following is not None:
            end_ms = min(end_ms, following.start_ms)
        if end_ms <= stretch.start_ms:
            self._say(f"“{stretch.value}” was begun later than here. It was dropped.")
            return False
        return self._edit(
            lambda document: editing.add_annotation(document, stretch.tier_id, stretch.start_ms, end_ms, stretch.value)
        )

    def _set_open(self, stretch: OpenStretch | None) -> None:
        self._open = stretch
        self.canvas.show_open(stretch)
        self._on_selection_changed()

    def add_at_playhead(self) -> None:
        """A second, or as much of it as is free."""
        tier = self._own_tier("Add a tier to code on first.")
        if tier is None:
            return
        start_ms = self.position_ms
        taken = editing.annotation_at(self.document, tier.tier_id, start_ms)
        if taken is not None:
            self._say(f"“{taken.value}” lies here already, until {exact_text(taken.end_ms)}.", taken)
            return
        free = editing.free_stretch(self.document, tier.tier_id, start_ms, start_ms + NEW_MS)
        end_ms = free[1] if free is not None and free[0] == start_ms else start_ms + NEW_MS
        self._on_create_wanted(tier.tier_id, start_ms, end_ms)

    def split_at_playhead(self) -> None:
        item = self._chosen()
        if item is not None:
            at_ms = self.position_ms
            tier = editing.tier_of(self.document, item.tier_id)
            second = editing.next_annotation_id(self.document, tier.coder)
            if self._edit(lambda document: editing.split_annotation(document, item.annotation_id, at_ms), item):
                self.canvas.select(second)

    def rename_selected(self) -> None:
        item = self._chosen()
        if item is not None:
            self._rename(item.annotation_id)

    def remove_selected(self) -> None:
        if self._open is not None:
            self._set_open(None)
            return
        item = self.canvas.selected
        if item is None:
            self._say("Select an annotation first.")
        elif self._is_own(item):
            self._edit(lambda document: editing.remove_annotation(document, item.annotation_id), item)

    def begin_at_playhead(self) -> None:
        item = self._chosen()
        if item is not None:
            self._on_move_wanted(item.annotation_id, self.position_ms, item.end_ms, item.tier_id)

    def end_at_playhead(self) -> None:
        item = self._chosen()
        if item is not None:
            self._on_move_wanted(item.annotation_id, item.start_ms, self.position_ms, item.tier_id)

    def nudge(self, direction: int) -> None:
        """A little later (1) or earlier (-1)."""
        item = self._chosen()
        if item is not None:
            by_ms = direction * NUDGE_MS
            self._on_move_wanted(item.annotation_id, item.start_ms + by_ms, item.end_ms + by_ms, item.tier_id)

    # ---- tiers and rows

    def open_tier_dialog(self) -> None:
        """A new tier, of a coder that is there already or of another one."""
        self._open_tier_dialog(None)

    def _open_tier_dialog(self, tier: Tier | None) -> None:
        active = self.canvas.active
        scenario = self._state.scenario.value
        dialog = TierDialog(
            self._theme,
            self.document,
            self,
            apply=lambda wish: self._apply_tier(wish, tier),
            tier=tier,
            coder="" if active is None else active.coder,
            scenario_labels=() if scenario is None else scenario.recording.labels,
        )
        dialog.open()

    def _apply_tier(self, wish: TierWish, tier: Tier | None) -> str:
        before = {item.tier_id for item in self.document.tiers}
        refusal = self._replay.edit(lambda document: with_tier(document, wish, tier))
        if not refusal:
            added = [item for item in self.document.tiers if item.tier_id not in before]
            for item in added:
                self._filter.clear()
                self.canvas.activate(f"tier {item.tier_id}")
                self.canvas.show_row(f"tier {item.tier_id}")
            self.canvas.setFocus(Qt.FocusReason.OtherFocusReason)
        return refusal

    def open_agreement(self) -> None:
        own = [tier for tier in self.document.tiers if tier.coder]
        if len(own) < 2:
            self._say("Agreement compares two tiers. Add the other coder’s tier, or import it.")
            return
        AgreementDialog(self._theme, self.document, self).open()

    def open_import(self) -> None:
        ImportDialog(self._theme, self, coders=editing.coders_of(self.document), take_over=self._take_over).open()

    def _take_over(self, path: Path, coder: str) -> str:
        before = self.document
        refusal = self._replay.import_annotations(path, coder)
        if not refusal:
            self._say(imported_words(before, self.document))
        return refusal

    def move_row(self, key: str, position: int) -> None:
        """Put the row at that place among those on show. The order of a coder's own tiers is kept with them."""
        shown = moved_key([row.key for row in self._rows], key, position)
        everything = [row.key for row in arranged(self._every_row(), self._order, (), "")]
        # Hidden rows stay behind the one that they follow.
        order = list(shown)
        for index, other in enumerate(everything):
            if other not in shown:
                before = everything[index - 1] if index else ""
                order.insert(order.index(before) + 1 if before in order else 0, other)
        self._order = order
        own = [other.removeprefix("tier ") for other in order if other.startswith("tier ")]
        tier_id = key.removeprefix("tier ")
        if tier_id in own and own != [tier.tier_id for tier in self.document.tiers if tier.coder]:
            self._edit(lambda document: editing.move_tier(document, tier_id, own.index(tier_id)))
        self._show_rows()
        self.canvas.show_row(key)

    def _every_row(self) -> list[Row]:
        return all_rows(self._replay.overview.value, self.document)

    def set_row_shown(self, key: str, *, shown: bool) -> None:
        (self._hidden.discard if shown else self._hidden.add)(key)
        self._show_rows()

    def open_rows_menu(self) -> None:
        """Every row, to show or hide."""
        menu = self._menu("rows_menu")
        for row in arranged(self._every_row(), self._order, (), ""):
            action = menu.addAction(f"{row.name} · {row.coder}" if row.own else row.name)
            action.setCheckable(True)
            action.setChecked(row.key not in self._hidden)
            action.toggled.connect(self._row_shower(row.key))
        menu.addSeparator()
        menu.addAction("Show all rows").triggered.connect(self._show_all_rows)
        button = self._named_buttons[0][0]
        menu.popup(button.mapToGlobal(QPoint(0, button.height() + 4)))

    def _row_shower(self, key: str) -> Callable[[bool], None]:
        return lambda shown: self.set_row_shown(key, shown=shown)

    def _show_all_rows(self) -> None:
        self._hidden.clear()
        self._show_rows()

    def open_row_menu(self, key: str, at: QPoint) -> None:
        """What can be done with a row, and with what is selected on it."""
        index = self.canvas.index_of(key)
        if index is None:
            return
        row, menu = self._rows[index], self._menu("row_menu")
        selected = self.canvas.selected
        if row.own and row.tier is not None and selected is not None and selected.tier_id == row.tier.tier_id:
            for action_id in ("annotation_rename", "annotation_split", "annotation_remove"):
                spec = self._actions.spec(action_id)
                if spec is not None:
                    menu.addAction(f"{spec.text}\t{self._actions.key_text(action_id)}").triggered.connect(
                        self._runner(action_id)
                    )
            menu.addSeparator()
        if row.own and row.tier is not None:
            menu.addAction("Change the tier…").triggered.connect(self._tier_changer(row.tier))
        up, down = menu.addAction("Move up"), menu.addAction("Move down")
        up.setEnabled(index > 0)
        down.setEnabled(index < len(self._rows) - 1)
        up.triggered.connect(self._row_mover(key, index - 1))
        down.triggered.connect(self._row_mover(key, index + 1))
        menu.addAction("Hide").triggered.connect(lambda: self.set_row_shown(key, shown=False))
        if row.own and row.tier is not None:
            count = len(self.canvas.track_of(row).annotations)
            menu.addSeparator()
            words = f"Remove the tier with its {count} annotations" if count else "Remove the tier"
            menu.addAction(words).triggered.connect(self._tier_remover(row.tier.tier_id))
        menu.popup(at)

    def _menu(self, name: str) -> QMenu:
        menu = QMenu(self)
        menu.setObjectName(name)
        menu.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        return menu

    def _tier_changer(self, tier: Tier) -> Callable[[], None]:
        return lambda: self._open_tier_dialog(tier)

    def _tier_remover(self, tier_id: str) -> Callable[[], None]:
        return lambda: self._remove_tier(tier_id)

    def _remove_tier(self, tier_id: str) -> None:
        self._edit(lambda document: editing.remove_tier(document, tier_id))

    def _row_mover(self, key: str, position: int) -> Callable[[], None]:
        return lambda: self.move_row(key, position)

    def _on_row_opened(self, key: str) -> None:
        index = self.canvas.index_of(key)
        tier = None if index is None else self._rows[index].tier
        if tier is not None and tier.coder:
            self._open_tier_dialog(tier)

    # ---- edits

    def _edit(self, edit: Callable[[AnnotationDocument], AnnotationDocument], near: Annotation | None = None) -> bool:
        """Do it, or say beside ``near`` why not."""
        refusal = self._replay.edit(edit)
        if refusal:
            self._say(refusal, near)
        else:
            self._bubble.hide()
        return not refusal

    def _say(self, words: str, near: Annotation | None = None) -> None:
        place = None if near is None else self.canvas.rect_of(near)
        if place is None:
            active = self.canvas.active
            index = None if active is None else self.canvas.index_of(active.key)
            top = RULER_PX if index is None or active is None else self.canvas.row_top(index)
            x = NAMES_PX + min(max(0.0, self.canvas.scale.to_px(self.position_ms)), self.canvas.room_px)
            place = QRectF(x, top, 2, 0 if active is None else active.height_px)
        self._bubble.say(words, place)

    def _own_tier(self, otherwise: str) -> Tier | None:
        """The coder's tier that keys act on; says ``otherwise`` where there is none."""
        active = self.canvas.active
        if active is None or not active.own or active.tier is None:
            self._say(otherwise)
            return None
        return active.tier

    def _chosen(self) -> Annotation | None:
        """What is selected, else what lies at the playhead on the tier that keys act on."""
        item = self.canvas.selected
        if item is None:
            tier = self._own_tier("Select an annotation first.")
            if tier is None:
                return None
            item = editing.annotation_at(self.document, tier.tier_id, self.position_ms)
            if item is None:
                self._say("Nothing is here. Select an annotation first.")
                return None
        return item if self._is_own(item) else None

    def _is_own(self, item: Annotation) -> bool:
        """Whether a coder made it; says so where it comes from the record."""
        own = any(tier.tier_id == item.tier_id for tier in self.document.tiers)
        if not own:
            self._say("This comes from the record and stays as it is. Code it on a tier of your own.", item)
        return own

    def _on_create_wanted(self, tier_id: str, start_ms: int, end_ms: int) -> None:
        try:
            tier = editing.tier_of(self.document, tier_id)
        except AnnotationError as gone:
            self._say(str(gone))
            return
        new = editing.next_annotation_id(self.document, tier.coder)
        if self._edit(lambda document: editing.add_annotation(document, tier_id, start_ms, end_ms)):
            self.canvas.select(new)
            self._rename(new)

    def _on_move_wanted(self, annotation_id: str, start_ms: int, end_ms: int, tier_id: str) -> None:
        item = self.canvas.selected
        self._edit(lambda document: editing.move_annotation(document, annotation_id, start_ms, end_ms, tier_id), item)

    def _rename(self, annotation_id: str) -> None:
        """Ask for the label, beside the annotation."""
        self.canvas.select(annotation_id)
        item = self.canvas.selected
        if item is None:
            return
        self._bubble.hide()
        rect = self.canvas.rect_of(item)
        tier = next((tier for tier in self.document.tiers if tier.tier_id == item.tier_id), None)
        if rect is None or tier is None:
            self._is_own(item)
            return
        window = self.window()
        if self._card is None or self._card.parent() is not window:
            self._card = LabelCard(self._theme, window)
            self._card.chosen.connect(self._on_label_chosen)
            self._card.closed.connect(self._on_card_closed)
        self._named = annotation_id
        vocabulary = vocabulary_named(self.document, tier.vocabulary) if tier.vocabulary else None
        left = min(max(NAMES_PX + 120.0, rect.left() + 120), self.canvas.width() - 20.0)
        at = self.canvas.mapTo(window, QPoint(round(left), round(rect.bottom()) - 12))
        self._card.ask(QPointF(at), item.value, None if vocabulary is None else vocabulary.entries)

    def _on_label_chosen(self, value: str) -> None:
        named = self._named
        item = self.canvas.selected
        self._edit(_renaming(named, value), item)

    def _on_card_closed(self) -> None:
        self.canvas.setFocus(Qt.FocusReason.OtherFocusReason)

    # ---- moving through the session

    def _on_seek_wanted(self, at_ms: float) -> None:
        self._seeks.want(self._replay.session.started_ns + round(at_ms * 1e6))

    def _on_seek_due(self, at_ns: int) -> None:
        self._replay.seek(at_ns)

    def _seek(self, at_ms: float) -> None:
        at_ms = min(max(0.0, at_ms), self._duration_ms())
        self._replay.seek(self._replay.session.started_ns + round(at_ms * 1e6))

    # ---- drawing

    def _style(self) -> None:
        theme = self._theme
        self._title.setFont(theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD))
        self._fact.setFont(theme.font(tokens.STATUS_PX))
        self._filter.setFont(theme.font(tokens.STATUS_PX))
        palette = self._fact.palette()
        palette.setColor(self._fact.foregroundRole(), theme.color("dim"))
        self._fact.setPalette(palette)
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        active = self.canvas.hasFocus()
        whole = QRectF(self.rect())
        draw_card(painter, self._theme, whole.adjusted(0, TITLE_HEIGHT_PX, 0, 0), top=False, active=active)
        draw_card(painter, self._theme, QRectF(0, 0, self.width(), TITLE_HEIGHT_PX), top=True, active=active)


def _renaming(annotation_id: str, value: str) -> Callable[[AnnotationDocument], AnnotationDocument]:
    return lambda document: editing.rename_annotation(document, annotation_id, value)


def _texts_of(event: QKeyEvent) -> set[str]:
    """How the table may spell this key. Plus is plus, whether it takes Shift or not; a digit is known by its place."""
    bare = event.modifiers() & ~_NOT_A_MODIFIER
    shift = Qt.KeyboardModifier.ShiftModifier
    key = Qt.Key(event.key())
    texts = {_spelled(bare, key)}
    if bare & shift and key in (Qt.Key.Key_Plus, Qt.Key.Key_Minus, Qt.Key.Key_Equal):
        texts.add(_spelled(bare & ~shift, key))
    code = key_code(sys.platform, scan_code=event.nativeScanCode(), virtual_key=event.nativeVirtualKey())
    position = position_of(sys.platform, code)
    if position is not None and position.isdigit() and not bare & ~shift:
        texts.add(position)
    if key == Qt.Key.Key_Enter:
        texts.add(_spelled(bare, Qt.Key.Key_Return))
    return texts


def _spelled(modifiers: Qt.KeyboardModifier, key: Qt.Key) -> str:
    return QKeySequence(QKeyCombination(modifiers, key)).toString(QKeySequence.SequenceFormat.PortableText)


def imported_words(before: AnnotationDocument, after: AnnotationDocument) -> str:
    """What an import brought."""
    if before == after:
        return "Everything in that file is here already."
    tiers = len({tier.tier_id for tier in after.tiers} - {tier.tier_id for tier in before.tiers})
    annotations = len(set(after.annotations) - set(before.annotations))
    parts = [
        f"{count} {name}{'s' if count != 1 else ''}"
        for count, name in ((tiers, "tier"), (annotations, "annotation"))
        if count
    ]
    return f"Imported: {' and '.join(parts)}." if parts else "Imported. Nothing is new; some was changed or removed."
