"""Timeline commands by key and mouse: code, split, move and name annotations."""

from collections.abc import Callable, Sequence

from PySide6.QtCore import QObject, QPoint, QPointF, QRectF, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QAccessible, QKeyEvent
from PySide6.QtWidgets import QLabel, QListWidget, QListWidgetItem, QWidget

from caris_desktop.domain.translation import tr, tr_filled
from caris_desktop.live.replay_console import ReplayConsole
from caris_desktop.live.status import PlaybackStatus
from caris_desktop.recording.annotation import annotation_editing
from caris_desktop.recording.annotation.annotation_model import Annotation, AnnotationDocument, Tier, VocabularyEntry
from caris_desktop.ui import layouts
from caris_desktop.ui.accessibility import has_role
from caris_desktop.ui.replay.replay_bar import SeekThrottle
from caris_desktop.ui.replay.timeline_canvas import OpenInterval, TimelineCanvas
from caris_desktop.ui.replay.timeline_items import (
    NAMES_PX,
    RULER_PX,
    Track,
    exact_text,
    vocabulary_named,
)
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.inputs import KeyCommandEdit
from caris_desktop.ui.widgets.labels import named
from caris_desktop.ui.widgets.popups import FloatingCard

NEW_MS = 1000
NUDGE_MS = 50
_ZOOM_STEP = 1.5
_REFUSAL_MS = 7000
_REFUSAL_PX = 420


class TimelineCommands(QObject):
    """Callbacks of the timeline's rows in the action table. A refusal is shown at its place.

    ``view``: the whole timeline; ``canvas``: its painted part.
    """

    timeline_requested = Signal()  # open the drawer
    open_changed = Signal()  # a label was begun or ended

    def __init__(self, theme: Theme, replay: ReplayConsole, canvas: TimelineCanvas, view: QWidget) -> None:
        super().__init__(view)
        self._theme = theme
        self._replay = replay
        self._canvas = canvas
        self._view = view
        self._refusal = QLabel(canvas, wordWrap=True, margin=9, textFormat=Qt.TextFormat.PlainText)
        self._refusal.setObjectName("words_bubble")
        self._refusal.setProperty("role", "refusal")
        self._refusal.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        has_role(self._refusal, QAccessible.Role.HelpBalloon)
        self._refusal.hide()
        self._refusal_end = QTimer(self, singleShot=True, interval=_REFUSAL_MS)
        self._refusal_end.timeout.connect(self._refusal.hide)
        self._card: LabelCard | None = None
        self._named = ""
        self._seeks = SeekThrottle(self)
        self._seeks.due.connect(replay.seek)
        canvas.seek_requested.connect(
            lambda at_ms: self._seeks.want(self._replay.session.started_ns + round(at_ms * 1e6))
        )
        canvas.create_requested.connect(self._on_create_requested)
        canvas.move_requested.connect(self._on_move_requested)
        canvas.rename_requested.connect(self._rename)
        canvas.view_changed.connect(self._refusal.hide)

    @property
    def document(self) -> AnnotationDocument:
        """Annotations of all coders."""
        document: AnnotationDocument = self._replay.coding.value
        return document

    @property
    def position_ms(self) -> int:
        """Current time in whole milliseconds of the session."""
        return round(self.ms_of(self._replay.playback.value.position_ns))

    @property
    def words(self) -> str:
        """Refusal on display."""
        return self._refusal.text() if self._refusal.isVisible() else ""

    def ms_of(self, at_ns: int) -> float:
        return (at_ns - self._replay.session.started_ns) / 1e6

    def duration_ms(self) -> float:
        playback: PlaybackStatus = self._replay.playback.value
        return max(self.ms_of(playback.end_ns), float(self.document.duration_ms), 1.0)

    # ---- callbacks of the action table

    def focus_timeline(self) -> None:
        if not self._canvas.isVisible():
            self.timeline_requested.emit()
        self._canvas.setFocus(Qt.FocusReason.ShortcutFocusReason)

    def undo(self) -> None:
        if not self._replay.undo():
            self.say(tr("There is nothing to undo."))

    def redo(self) -> None:
        if not self._replay.redo():
            self.say(tr("There is nothing to redo."))

    def zoom(self, direction: int) -> None:
        self._canvas.zoom(_ZOOM_STEP**direction)

    def fit(self) -> None:
        self._canvas.fit()

    def seek_by(self, seconds: float) -> None:
        self._seek(self.position_ms + 1000 * seconds)

    def select_tier(self, direction: int) -> None:
        """Select the coder's next (1) or previous (-1) tier."""
        tiers = [row.key for row in self._canvas.rows if row.own]
        active = self._canvas.active
        if tiers:
            index = tiers.index(active.key) + direction if active is not None and active.key in tiers else 0
            key = tiers[min(max(0, index), len(tiers) - 1)]
            self._canvas.activate(key)
            self._canvas.select("")
            self._canvas.show_row(key)

    def select_next(self, direction: int) -> None:
        """Select the next (1) or previous (-1) annotation of the tier."""
        active, selected = self._canvas.active, self._canvas.selected
        if active is None:
            return
        from_ms = self.position_ms if selected is None else selected.start_ms
        found = self._canvas.track_of(active).neighbour(from_ms, direction)
        if found is None:
            none = tr("No later annotation on {tier}.") if direction > 0 else tr("No earlier annotation on {tier}.")
            self.say(none.format(tier=active.name))
            return
        self._canvas.select(found.annotation_id)
        self._canvas.show_interval(found.start_ms, found.end_ms)
        self._seek(found.start_ms)

    def code(self, number: int) -> None:
        """Label key: rename the selected annotation, else begin or end the label at the playhead."""
        tier = self._own_tier(tr("Add a tier for coding first."))
        if tier is None:
            return
        title = tr_filled(tier.title)
        vocabulary = vocabulary_named(self.document, tier.vocabulary)
        if vocabulary is None:
            words = tr("{tier} holds free text. Choose labels for the tier to code with keys.")
            self.say(words.format(tier=title))
            return
        if number > len(vocabulary.entries):
            self.say(tr("{tier} has %n labels.", "", len(vocabulary.entries)).format(tier=title))
            return
        value = vocabulary.entries[number - 1].value
        selected, ended = self._canvas.selected, self._canvas.open
        playing = self._replay.playback.value.playing
        if ended is None and selected is not None and selected.tier_id == tier.tier_id and not playing:
            self._set_label(selected.annotation_id, value)
            return
        if ended is not None and not self._end_open(ended):
            return
        same = ended is not None and (ended.value, ended.tier_id) == (value, tier.tier_id)
        if not same and self._is_free(tier):
            self._canvas.select("")
            self.set_open(OpenInterval(tier.tier_id, value, self.position_ms))

    def _end_open(self, interval: OpenInterval) -> bool:
        """End the open label at the playhead, or at the next annotation."""
        self.set_open(None)
        end_ms = self.position_ms
        track = self._canvas.tracks.get(f"tier {interval.tier_id}", Track(()))
        following = track.neighbour(interval.start_ms, 1)
        if following is not None:
            end_ms = min(end_ms, following.start_ms)
        if end_ms <= interval.start_ms:
            self.say(tr("“{label}” starts after this position and was discarded.").format(label=interval.value))
            return False
        return self.edit(
            lambda document: annotation_editing.add_annotation(
                document, interval.tier_id, interval.start_ms, end_ms, interval.value
            )
        )

    def set_open(self, interval: OpenInterval | None) -> None:
        self._canvas.open = interval
        self._canvas.update()
        self.open_changed.emit()

    def add_at_playhead(self) -> None:
        """Add an annotation of a second, or of the free time if shorter."""
        tier = self._own_tier(tr("Add a tier for coding first."))
        if tier is not None and self._is_free(tier):
            start_ms = self.position_ms
            free = annotation_editing.free_interval(self.document, tier.tier_id, start_ms, start_ms + NEW_MS)
            end_ms = free[1] if free is not None and free[0] == start_ms else start_ms + NEW_MS
            self._on_create_requested(tier.tier_id, start_ms, end_ms)

    def split_at_playhead(self) -> None:
        item = self._chosen()
        if item is not None:
            at_ms = self.position_ms
            if self.edit(lambda all_: annotation_editing.split_annotation(all_, item.annotation_id, at_ms), item):
                self._select_at(item.tier_id, at_ms)

    def rename_selected(self) -> None:
        item = self._chosen()
        if item is not None:
            self._rename(item.annotation_id)

    def remove_selected(self) -> None:
        if self._canvas.open is not None:
            self.set_open(None)
            return
        item = self._canvas.selected
        if item is None:
            self.say(tr("Select an annotation first."))
        elif self._is_own(item):
            self.edit(lambda document: annotation_editing.remove_annotation(document, item.annotation_id), item)

    def begin_at_playhead(self) -> None:
        self._reshape(lambda item: (self.position_ms, item.end_ms))

    def end_at_playhead(self) -> None:
        self._reshape(lambda item: (item.start_ms, self.position_ms))

    def nudge(self, direction: int) -> None:
        """Move the annotation a little later (1) or earlier (-1)."""
        self._reshape(lambda item: (item.start_ms + direction * NUDGE_MS, item.end_ms + direction * NUDGE_MS))

    def _reshape(self, times: Callable[[Annotation], tuple[int, int]]) -> None:
        item = self._chosen()
        if item is not None:
            self._on_move_requested(item.annotation_id, *times(item), item.tier_id)

    def give_up(self) -> None:
        """Esc: cancel the current operation. The window connects it to ``escape_pressed``."""
        self._refusal.hide()
        if (self._card is not None and self._card.cancel()) or self._canvas.cancel_drag():
            return
        if self._canvas.open is not None:
            self.set_open(None)
        else:
            self._canvas.select("")

    # ---- edits and refusals

    def edit(self, edit: Callable[[AnnotationDocument], AnnotationDocument], near: Annotation | None = None) -> bool:
        """Apply an edit, or show the refusal at ``near``."""
        refusal = self._replay.edit(edit)
        if refusal:
            self.say(refusal, near)
        else:
            self._refusal.hide()
        return not refusal

    def say(self, words: str, near: Annotation | None = None) -> None:
        """Show a text below ``near`` or at the playhead, or above if there is no room."""
        label, canvas, active = self._refusal, self._canvas, self._canvas.active
        place = None if near is None else canvas.rect_of(near)
        if place is None:
            index = None if active is None else canvas.index_of(active.key)
            top = RULER_PX if index is None else canvas.row_top(index)
            x = NAMES_PX + min(max(0.0, canvas.scale.to_px(self.position_ms)), canvas.room_px)
            place = QRectF(x, top, 2, 0 if active is None else active.height_px)
        label.setText(words)
        label.setAccessibleName(words)
        label.ensurePolished()
        width = label.fontMetrics().horizontalAdvance(words) + 2 * label.margin() + 4
        label.resize(min(_REFUSAL_PX, canvas.width() - 16, width), 0)
        label.resize(label.width(), label.heightForWidth(label.width()))
        top = round(place.bottom()) + 6
        if top + label.height() > canvas.height() - 4:
            top = round(place.top()) - 6 - label.height()
        label.move(min(max(8, round(place.left())), canvas.width() - label.width() - 8), max(4, top))
        label.show()
        label.raise_()
        self._refusal_end.start()

    def _own_tier(self, otherwise: str) -> Tier | None:
        """The coder's active tier; shows ``otherwise`` if there is none."""
        active = self._canvas.active
        if active is None or not active.own:
            self.say(otherwise)
            return None
        return active.tier

    def _chosen(self) -> Annotation | None:
        """The selected annotation, else the one at the playhead on the active tier."""
        item = self._canvas.selected
        if item is None:
            tier = self._own_tier(tr("Select an annotation first."))
            if tier is None:
                return None
            item = annotation_editing.annotation_at(self.document, tier.tier_id, self.position_ms)
            if item is None:
                self.say(tr("No annotation here. Select an annotation first."))
                return None
        return item if self._is_own(item) else None

    def _is_own(self, item: Annotation) -> bool:
        """Whether a coder made the annotation; shows a refusal for a recorded one."""
        found = any(tier.tier_id == item.tier_id for tier in self.document.tiers)
        if not found:
            self.say(tr("This comes from the recording and cannot be changed. Code it on your own tier."), item)
        return found

    def _is_free(self, tier: Tier) -> bool:
        """Whether the tier has no annotation at the playhead; shows a refusal if it has."""
        taken = annotation_editing.annotation_at(self.document, tier.tier_id, self.position_ms)
        if taken is not None:
            words = tr("“{label}” is already here, until {time}.")
            self.say(words.format(label=taken.value, time=exact_text(taken.end_ms)), taken)
        return taken is None

    def _select_at(self, tier_id: str, at_ms: int) -> None:
        item = annotation_editing.annotation_at(self.document, tier_id, at_ms)
        if item is not None:
            self._canvas.select(item.annotation_id)

    def _on_create_requested(self, tier_id: str, start_ms: int, end_ms: int) -> None:
        if self.edit(lambda document: annotation_editing.add_annotation(document, tier_id, start_ms, end_ms)):
            self._select_at(tier_id, start_ms)
            self.rename_selected()

    def _on_move_requested(self, annotation_id: str, start_ms: int, end_ms: int, tier_id: str) -> None:
        self.edit(
            lambda document: annotation_editing.move_annotation(document, annotation_id, start_ms, end_ms, tier_id),
            self._canvas.selected,
        )

    def _rename(self, annotation_id: str) -> None:
        """Ask for the label next to the annotation."""
        self._canvas.select(annotation_id)
        item = self._canvas.selected
        if item is None:
            return
        self._refusal.hide()
        rect = self._canvas.rect_of(item)
        tier = next((tier for tier in self.document.tiers if tier.tier_id == item.tier_id), None)
        if rect is None or tier is None:
            self._is_own(item)
            return
        window = self._view.window()
        if self._card is None or self._card.parent() is not window:
            self._card = LabelCard(self._theme, window)
            self._card.chosen.connect(lambda value: self._set_label(self._named, value))
            self._card.closed.connect(lambda: self._canvas.setFocus(Qt.FocusReason.OtherFocusReason))
        self._named = annotation_id
        vocabulary = vocabulary_named(self.document, tier.vocabulary)
        left = min(max(NAMES_PX + 120.0, rect.left() + 120), self._canvas.width() - 20.0)
        at = self._canvas.mapTo(window, QPoint(round(left), round(rect.bottom()) - 12))
        self._card.ask(QPointF(at), item.value, None if vocabulary is None else vocabulary.entries)

    def _set_label(self, annotation_id: str, value: str) -> None:
        self.edit(
            lambda document: annotation_editing.rename_annotation(document, annotation_id, value),
            self._canvas.selected,
        )

    def _seek(self, at_ms: float) -> None:
        at_ms = min(max(0.0, at_ms), self.duration_ms())
        self._replay.seek(self._replay.session.started_ns + round(at_ms * 1e6))


_ROW_PX = 28
_MOST_ROWS = 8
_VALUE = int(Qt.ItemDataRole.UserRole)
_CARD_KEYS = (Qt.Key.Key_Return, Qt.Key.Key_Enter, Qt.Key.Key_Escape, Qt.Key.Key_Up, Qt.Key.Key_Down)


def _card_key(event: QKeyEvent) -> Qt.Key | None:
    return Qt.Key(event.key()) if event.key() in _CARD_KEYS else None


class LabelCard(FloatingCard):
    """Label popup of an annotation: free text, or a vocabulary value.

    ``chosen(str)`` with the label; not emitted on cancel. With a vocabulary, typing searches and digits select.
    """

    chosen = Signal(str)

    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(theme, parent)
        self.setObjectName("label_card")
        self._entries: tuple[VocabularyEntry, ...] | None = None
        self._before = ""
        self._done = True
        self.field = KeyCommandEdit(_card_key, maxLength=10_000, commanded=self._on_key, left=self._on_left)
        named(self.field, "label_field", tr("Label of the annotation"))
        self.field.setMinimumSize(240, 32)
        self.field.textEdited.connect(self._on_text_edited)
        self.list = named(QListWidget(), "label_list", tr("Labels of the vocabulary"))
        self.list.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.list.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.list.setUniformItemSizes(True)
        self.list.itemClicked.connect(lambda item: self._finish(str(item.data(_VALUE))))
        layouts.vbox(self, self.field, self.list, margins_px=8, spacing_px=4)

    def ask(self, where: QPointF, value: str, entries: Sequence[VocabularyEntry] | None) -> None:
        """Open next to ``where`` with the current label; ``entries``: permitted values, None for free text."""
        self._entries = None if entries is None else tuple(entries)
        self._before = value
        self._done = False
        self.list.setVisible(self._entries is not None)
        if self._entries is None:
            self.field.setText(value)
            self.field.setPlaceholderText(tr("Describe what happens"))
            self.field.selectAll()
        else:
            self.field.clear()
            self.field.setPlaceholderText(value or tr("Type or press a number"))
            self._fill("")
        self.open_at(where)
        self.field.setFocus(Qt.FocusReason.PopupFocusReason)

    def _fill(self, typed: str) -> None:
        self.list.clear()
        entries, query = self._entries or (), typed.casefold().strip()
        found = [item for item in enumerate(entries, start=1) if query in item[1].value.casefold()]
        found.sort(key=lambda item: not item[1].value.casefold().startswith(query))  # prefix matches first
        for number, entry in found:
            key = f"{number}  " if number <= 9 else ""
            meaning = f"  ·  {entry.description}" if entry.description else ""
            row = QListWidgetItem(f"{key}{entry.value}{meaning}", self.list)
            row.setData(_VALUE, entry.value)
            row.setToolTip(entry.description)
            row.setSizeHint(QSize(200, _ROW_PX))
        values = [entry.value for _, entry in found]
        self.list.setCurrentRow(values.index(self._before) if not query and self._before in values else 0)
        self.list.setFixedHeight(_ROW_PX * min(_MOST_ROWS, max(1, len(entries))) + 4)
        self.list.setMinimumWidth(min(360, max(240, self.list.sizeHintForColumn(0) + 24)))

    def _on_text_edited(self, text: str) -> None:
        if self._entries is None:
            return
        if text.isdigit() and 1 <= int(text) <= min(9, len(self._entries)):
            self._finish(self._entries[int(text) - 1].value)
        else:
            self._fill(text)

    def _on_key(self, key: Qt.Key) -> None:
        """Return selects, arrows move, Esc cancels."""
        row = self.list.currentItem()
        if key == Qt.Key.Key_Escape:
            self._finish(None)
        elif key in (Qt.Key.Key_Up, Qt.Key.Key_Down):
            step = 1 if key == Qt.Key.Key_Down else -1
            self.list.setCurrentRow(min(max(0, self.list.currentRow() + step), self.list.count() - 1))
        elif self._entries is None:
            self._finish(self.field.text())
        elif row is not None:
            self._finish(str(row.data(_VALUE)))

    def _on_left(self) -> None:
        # Free text is saved on losing the focus, as in any field; a vocabulary value must be chosen.
        self._finish(self.field.text() if self._entries is None else None)

    def cancel(self) -> bool:
        """Close without a label; False if it was not open."""
        was_open = not self._done
        self._finish(None)
        return was_open

    def _finish(self, value: str | None) -> None:
        if self._done:
            return
        self._done = True
        self.hide()
        if value is not None and value != self._before:
            self.chosen.emit(value)
