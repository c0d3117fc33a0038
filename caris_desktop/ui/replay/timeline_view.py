"""Annotation timeline of a replay: recorded events and coders' tiers on one ruler."""

import sys
from collections.abc import Callable

from PySide6.QtCore import QEvent, QKeyCombination, QObject, QPoint, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QAccessible, QKeyEvent, QKeySequence, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import QGridLayout, QLabel, QMenu, QScrollBar, QSizePolicy, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr, tr_filled
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import PlaybackStatus
from caris_desktop.live.wizard_console import ReplayControls
from caris_desktop.recording.annotation import annotation_editing
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument, Vocabulary
from caris_desktop.recording.annotation.timeline_overview import SessionOverview
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_rows import CODE_COUNT, TIMELINE_ACTIONS
from caris_desktop.ui.key_choices import normalized
from caris_desktop.ui.key_positions import key_code, position_of
from caris_desktop.ui.panel import TITLE_HEIGHT_PX, draw_card, show_part
from caris_desktop.ui.replay.thumbnails import Thumbnails
from caris_desktop.ui.replay.timeline_canvas import TimelineCanvas
from caris_desktop.ui.replay.timeline_commands import TimelineCommands
from caris_desktop.ui.replay.timeline_drawing import NAMES_PX, RULER_PX
from caris_desktop.ui.replay.timeline_model import (
    Row,
    Track,
    all_rows,
    exact_text,
    length_text,
    tracks_of,
    vocabulary_named,
)
from caris_desktop.ui.replay.timeline_overlay import OpenInterval
from caris_desktop.ui.replay.timeline_rows import TimelineRows
from caris_desktop.ui.text_formatting import in_menu
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.accessible_description import ThrottledAccessibleDescription
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.elided_label import ElidedLabel

LOW_PX = 168
"""Below this height there is no room for the coding strip."""

_NO_LIMIT_PX = 16_777_215
# Commands that repeat while their key is held.
_REPEATED = ("seek_by", "nudge", "select_next", "select_tier", "zoom")
_NOT_A_MODIFIER = Qt.KeyboardModifier.KeypadModifier | Qt.KeyboardModifier.GroupSwitchModifier


class TimelineView(QWidget):
    """Shows the record and edits annotations; ``actions`` gets the timeline's keys.

    If there is no room below the panels it becomes a drawer with a title that opens it.
    """

    accessible_role = QAccessible.Role.Grouping

    open_requested = Signal(bool)

    def __init__(self, theme: Theme, replay: ReplayControls, state: LiveState, actions: Actions) -> None:
        super().__init__()
        self.setObjectName("timeline_view")
        self.setAccessibleName(tr("Timeline of the session"))
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Expanding)
        self._theme = theme
        self._replay = replay
        self._actions = actions
        self._opened: bool | None = None
        self._tracks: dict[str, Track] = {}
        self._own_tracks: dict[str, Track] = {}
        self._record_tracks: dict[str, Track] = {}
        self.canvas = TimelineCanvas(theme, Thumbnails(replay, self), replay.with_names)
        self.canvas.installEventFilter(self)
        self._description = ThrottledAccessibleDescription(self.canvas, self._accessible_text)
        self.acts = TimelineCommands(theme, replay, self.canvas, self)
        self.acts.open_changed.connect(self._on_selection_changed)
        self.acts.timeline_requested.connect(lambda: self.open_requested.emit(True))
        actions.add_rows(TIMELINE_ACTIONS, self.acts)
        self.rows = TimelineRows(self, self.canvas, self.acts, theme=theme, replay=replay, state=state, actions=actions)
        self.rows.changed.connect(self._show_rows)
        self._across = QScrollBar(Qt.Orientation.Horizontal)
        self._across.valueChanged.connect(self._on_scrolled_across)
        self._down = QScrollBar(Qt.Orientation.Vertical)
        self._down.valueChanged.connect(self.canvas.scroll_to)
        self.strip = CodingStrip(theme, actions)
        self.strip.add_tier_requested.connect(self.rows.open_tier_dialog)
        self._header = self._make_header()
        middle = QGridLayout()
        middle.setContentsMargins(1, 0, 1, 0)
        middle.setSpacing(0)
        middle.addWidget(self.canvas, 0, 0)
        middle.addWidget(self._down, 0, 1)
        under = layouts.hbox(margins_px=(NAMES_PX, 0, 0, 0))
        under.addWidget(self._across)
        middle.addLayout(under, 1, 0)
        column = layouts.vbox(self, margins_px=(0, 0, 0, 1), spacing_px=0)
        column.addWidget(self._header)
        column.addLayout(middle, 1)
        column.addWidget(self.strip)
        self.canvas.selection_changed.connect(self._on_selection_changed)
        self.canvas.view_changed.connect(self._on_view_changed)
        replay.overview.changed.connect(self._on_overview_changed)
        replay.coding.changed.connect(self._on_coding_changed)
        replay.playback.changed.connect(self._on_playback_changed)
        theme.changed.connect(self._style)
        self._show_session()
        self._on_overview_changed(replay.overview.value)
        self._on_coding_changed(replay.coding.value)
        self._on_playback_changed(replay.playback.value)
        self.setFocusProxy(self.canvas)
        self._style()

    def _make_header(self) -> QWidget:
        theme, actions = self._theme, self._actions
        header = QWidget()
        header.setFixedHeight(TITLE_HEIGHT_PX)
        self._title = QLabel(tr("Timeline"))
        self._fact = ElidedLabel()
        self._fact.setObjectName("timeline_fact")
        self._named_buttons: list[tuple[ActionButton, str]] = []
        row = layouts.hbox(header, margins_px=(14, 3, 6, 3), spacing_px=4)
        row.addWidget(self._title)
        row.addSpacing(8)
        row.addWidget(self._fact, 1)
        row.addWidget(self.rows.filter)
        self._in_header: list[QWidget] = [self.rows.filter]
        for name, icon, text, tip, act in (
            ("rows_menu_button", "eye", tr("Rows"), tr("Show or hide rows"), self._open_rows_menu),
            (
                "add_tier",
                "plus",
                tr("Tier"),
                tr("Add a tier for yourself or another coder"),
                self.rows.open_tier_dialog,
            ),
            ("agreement", "scales", tr("Agreement"), tr("Agreement between two coders"), self.rows.open_agreement),
            (
                "import_annotations",
                "download-simple",
                tr("Import"),
                tr("Import from ELAN or a CSV table"),
                self.rows.open_import,
            ),
        ):
            button = ActionButton(theme, text, icon=icon, height_px=30, text_px=tokens.STATUS_PX + 1)
            button.setObjectName(name)
            button.setToolTip(tip)
            button.clicked.connect(act)
            row.addWidget(button)
            self._named_buttons.append((button, text))
            self._in_header.append(button)
        for action_id in ("undo", "redo", "timeline_smaller", "timeline_larger", "timeline_fit"):
            spec = actions.spec(action_id)
            if spec is None:
                continue
            button = ActionButton(theme, "", icon=spec.icon, role="ghost", height_px=30)
            button.setObjectName(action_id)
            button.setAccessibleName(spec.text)
            button.setToolTip(f"{spec.text} ({actions.key_text(action_id)})")
            button.clicked.connect(self._runner(action_id))
            row.addWidget(button)
            self._in_header.append(button)
        self._drawer = ActionButton(theme, "", height_px=30, text_px=tokens.STATUS_PX + 1)
        self._drawer.setObjectName("timeline_drawer")
        self._drawer.clicked.connect(lambda: self.open_requested.emit(not self._opened))
        self._drawer.hide()
        row.addWidget(self._drawer)
        return header

    def show_as_drawer(self, opened: bool | None) -> None:
        """Open or close the drawer; None if it is not one."""
        self._opened = opened
        shut = opened is False
        for widget in (self.canvas, self._down, *self._in_header):
            show_part(widget, not shut)
        show_part(self._drawer, opened is not None)
        if opened:
            self._drawer.set_label("", icon="caret-double-down", role="amber")
            self._drawer.setToolTip(tr("Back to the picture and the panels"))
            self._drawer.setAccessibleName(tr("Back to the picture and the panels"))
        else:
            self._drawer.set_label(tr("Open"), icon="caret-double-up", role="amber")
            self._drawer.setToolTip(tr("Open the timeline over the panels: not enough room for both"))
            self._drawer.setAccessibleName(tr("Open the timeline"))
        if shut:
            self.setFixedHeight(TITLE_HEIGHT_PX)
        else:
            self.setMinimumHeight(0)
            self.setMaximumHeight(_NO_LIMIT_PX)
        self._use_room()

    def _open_rows_menu(self) -> None:
        self.rows.open_rows_menu(self._named_buttons[0][0])

    def _runner(self, action_id: str) -> Callable[[], object]:
        return lambda: self._actions.run(action_id)

    def sizeHint(self) -> QSize:
        return QSize(900, 300)

    def minimumSizeHint(self) -> QSize:
        return QSize(480, TITLE_HEIGHT_PX + RULER_PX + 32)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._use_room()

    def _use_room(self) -> None:
        low = self.height() < LOW_PX or self._opened is False
        self.strip.setVisible(not low)
        self._across.setVisible(not low)
        roomy = self.width() >= 1040
        for button, text in self._named_buttons:
            if button.text() != (text if roomy else ""):
                button.set_label(text if roomy else "")
                button.setAccessibleName(text)

    # ---- display

    @property
    def document(self) -> AnnotationDocument:
        """Annotations of all coders."""
        return self.acts.document

    @property
    def words(self) -> str:
        """Refusal on display."""
        return self.acts.words

    def _show_session(self) -> None:
        self._shown_end_ns: int = self._replay.playback.value.end_ns
        self.canvas.show_session(self._replay.session.started_ns, self.acts.duration_ms())

    def _on_overview_changed(self, overview: SessionOverview | None) -> None:
        self._record_tracks = {}
        if overview is not None:
            self._record_tracks = {f"record {key}": track for key, track in tracks_of(overview.tiers).items()}
        self.canvas.show_overview(overview)
        self._show_rows()
        self._show_tracks()

    def _on_coding_changed(self, document: AnnotationDocument) -> None:
        rows_before = self.canvas.rows
        self._own_tracks = tracks_of(document, self._own_tracks)
        self._tracks = {f"tier {key}": track for key, track in self._own_tracks.items()}
        self._show_tracks()
        if [row.tier for row in rows_before if row.own] != [tier for tier in document.tiers if tier.coder]:
            self._show_rows()
        stretch = self.acts.open
        if stretch is not None and stretch.tier_id not in {tier.tier_id for tier in document.tiers}:
            self.acts.set_open(None)
        self._show_session()
        self._on_selection_changed()

    def _show_tracks(self) -> None:
        self.canvas.show_tracks({**self._tracks, **self._record_tracks})

    def _show_rows(self) -> None:
        overview: SessionOverview | None = self._replay.overview.value
        rows = self.rows.shown()
        words = tr("Reading the session…") if overview is None else tr("The recording contains nothing to show here.")
        if not rows and all_rows(overview, self.document):
            words = self.rows.words()
        self.canvas.show_rows(rows, annotation_editing.coders_of(self.document), words=words)
        own_rows = [row for row in rows if row.own]
        if self.canvas.active is None and own_rows:
            self.canvas.activate(own_rows[0].key)
        self._on_selection_changed()

    def _on_playback_changed(self, playback: PlaybackStatus) -> None:
        if playback.end_ns != self._shown_end_ns:
            self._show_session()
        self.canvas.show_position(self.acts.ms_of(playback.position_ns), playing=playback.playing)
        self._description.changed()

    def _on_selection_changed(self) -> None:
        active = self.canvas.active
        is_own = active is not None and active.own
        vocabulary = self._vocabulary_of(active) if is_own else None
        stretch = self._open_on(active) if is_own and active is not None else None
        tiers = sum(1 for tier in self.document.tiers if tier.coder)
        self.strip.show_tier(active, vocabulary, stretch, tiers=tiers)
        self._fact.setText(self._fact_text())
        self._fact.setToolTip(self._fact.text())
        self._description.changed()
        self.update()

    def _accessible_text(self) -> str:
        """Accessible description: position, visible part, number of marks, selection."""
        scale, overview = self.canvas.scale, self._replay.overview.value
        start_ms, end_ms = scale.start_ms, scale.start_ms + self.canvas.room_px / scale.px_per_ms
        total_ms = self.acts.duration_ms()
        sentences = [
            tr("At {now} of {total}.").format(
                now=exact_text(self.canvas.state.position_ms), total=exact_text(total_ms)
            ),
            tr("Shown from {start} to {end}.").format(
                start=exact_text(max(0.0, start_ms)), end=exact_text(min(total_ms, end_ms))
            ),
        ]
        if overview is not None:
            marks = sum(moment.kind == "mark" for moment in overview.moments)
            sentences.append(tr("1 mark.") if marks == 1 else tr("%n marks.", "", marks))
        return " ".join([*sentences, self._fact.text()]).strip()

    def _open_on(self, row: Row) -> OpenInterval | None:
        """Open interval on this row."""
        stretch = self.acts.open
        here = stretch is not None and row.tier is not None and row.tier.tier_id == stretch.tier_id
        return stretch if here else None

    def _fact_text(self) -> str:
        item = self.canvas.selected
        if item is not None:
            times = f"{exact_text(item.start_ms)} – {exact_text(item.end_ms)}"
            label = self._replay.with_names(tr_filled(item.value)) or tr("No label yet")
            return f"{label} · {times} · {length_text(item.end_ms - item.start_ms)}"
        if self._replay.overview.value is None:
            return tr("reading the session…")
        count, coders = len(self.document.annotations), len(annotation_editing.coders_of(self.document))
        if not coders:
            return ""
        of_count = tr("1 annotation") if count == 1 else tr("{count} annotations").format(count=f"{count:,}")
        of_coders = tr("1 coder") if coders == 1 else tr("%n coders", "", coders)
        return tr("{annotations} by {coders}").format(annotations=of_count, coders=of_coders)

    def _vocabulary_of(self, row: Row | None) -> Vocabulary | None:
        if row is None or row.tier is None or not row.tier.vocabulary:
            return None
        return vocabulary_named(self.document, row.tier.vocabulary)

    def _on_view_changed(self) -> None:
        canvas, scale = self.canvas, self.canvas.scale
        visible_ms, visible_px = canvas.room_px / scale.px_per_ms, canvas.height() - RULER_PX
        for bar, maximum, page, value in (
            (self._across, self.acts.duration_ms() - visible_ms, visible_ms, scale.start_ms),
            (self._down, canvas.rows_height_px - visible_px, visible_px, canvas.scroll_y),
        ):
            bar.blockSignals(True)
            bar.setRange(0, max(0, round(maximum)))
            bar.setPageStep(max(1, round(page)))
            bar.setSingleStep(max(1, round(page / 10)))
            bar.setValue(round(value))
            bar.blockSignals(False)
        self._description.changed()

    def _on_scrolled_across(self, start_ms: int) -> None:
        self.canvas.scroll_across_to(float(start_ms))

    # ---- keys

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if watched is self.canvas and event.type() == QEvent.Type.KeyPress and isinstance(event, QKeyEvent):
            return self._press_key(event)
        return super().eventFilter(watched, event)

    def _press_key(self, event: QKeyEvent) -> bool:
        if event.key() == Qt.Key.Key_Escape:
            self.acts.give_up()
            return True
        texts = _texts_of(event)
        for spec in self._actions.listening_in("timeline"):
            if any(normalized(key) in texts for key in spec.keys):
                if not event.isAutoRepeat() or spec.callback in _REPEATED:
                    self._actions.run(spec.id)
                return True
        return False

    # ---- painting

    def _style(self) -> None:
        theme = self._theme
        self._title.setFont(theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD))
        self._fact.setFont(theme.font(tokens.STATUS_PX))
        self.rows.filter.setFont(theme.font(tokens.STATUS_PX))
        theme.color_text(self._fact, "dim")
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        active = self.canvas.hasFocus()
        bounds = QRectF(self.rect())
        draw_card(painter, self._theme, bounds.adjusted(0, TITLE_HEIGHT_PX, 0, 0), top=False, active=active)
        draw_card(painter, self._theme, QRectF(0, 0, self.width(), TITLE_HEIGHT_PX), top=True, active=active)


def _texts_of(event: QKeyEvent) -> set[str]:
    """Spellings of this key in the table. Plus matches with and without Shift; digits match by position."""
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
    """Coding strip below the timeline: labels of the active tier with their keys, and commands.

    Coding strip. ``add_tier_requested``: no tier yet; all else runs actions of the table.

    In a narrow strip commands show icons only, and labels that do not fit are in a menu.
    """

    add_tier_requested = Signal()

    def __init__(self, theme: Theme, actions: Actions) -> None:
        super().__init__()
        self.setObjectName("coding_strip")
        self.setFixedHeight(40)
        self._theme = theme
        self._contents: tuple[object, ...] | None = None
        self._actions = actions
        self._present = 0
        self._narrow = False
        self._words = ElidedLabel()
        self._words.setObjectName("coding_words")
        self._add = ActionButton(theme, tr("Add a tier"), icon="plus", role="primary", height_px=30)
        self._add.setObjectName("coding_add_tier")
        self._add.clicked.connect(self.add_tier_requested)
        self._labels: list[ActionButton] = []
        for number in range(1, CODE_COUNT + 1):
            button = ActionButton(theme, "", key_first=True, height_px=30, text_px=tokens.STATUS_PX, may_shrink=True)
            button.setObjectName(f"code_{number}")
            button.setCheckable(True)
            button.bind(actions, f"code_{number}")
            self._labels.append(button)
        self._more = ActionButton(theme, "", icon="caret-double-right", role="amber", height_px=30)
        self._more.setObjectName("coding_more")
        self._more.setAccessibleName(tr("More labels"))
        self._more.setToolTip(tr("More labels: their keys also work"))
        self._more.clicked.connect(self._open_more)
        self._more.hide()
        self._acts: list[ActionButton] = []
        for action_id, _icon, text in _ACTS:
            button = ActionButton(theme, tr(text), role="ghost", height_px=30, text_px=tokens.STATUS_PX)
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
        contents = (row, vocabulary, stretch, tiers)
        if contents == self._contents:
            return
        self._contents = contents
        is_own = row is not None and row.own
        entries = () if vocabulary is None or not is_own else vocabulary.entries
        if not tiers:
            words = tr("Nothing is coded in this session yet.")
        elif row is None or not is_own:
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
            show_part(button, is_own)
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
        count = self._present
        if narrow and sum(each) > room_px:
            room_px -= self._more.sizeHint().width() + _GAP_PX
            count = max(1, sum(sum(each[: number + 1]) <= room_px for number in range(self._present)))
        for number, button in enumerate(self._labels):
            show_part(button, number < count)
        show_part(self._more, count < self._present)

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
