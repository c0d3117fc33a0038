"""Timeline of a session, and its place with the replay bar in the main window."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from PySide6.QtCore import QEvent, QObject, QPoint, QSignalBlocker, Qt, Signal
from PySide6.QtGui import QAccessible, QKeyEvent, QResizeEvent
from PySide6.QtWidgets import (
    QFrame,
    QGridLayout,
    QLineEdit,
    QMenu,
    QScrollArea,
    QScrollBar,
    QSizePolicy,
    QSplitter,
    QVBoxLayout,
    QWidget,
)

from caris_desktop.domain.translation import QT_TR_NOOP, tr, tr_filled
from caris_desktop.live.replay_console import ReplayConsole
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import PlaybackStatus
from caris_desktop.recording.annotation import annotation_editing
from caris_desktop.recording.annotation.annotation_editing import coders_of
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument, Tier, Vocabulary
from caris_desktop.recording.annotation.timeline_overview import SessionOverview
from caris_desktop.scenario.scenario_model import LayoutNode, PanelLeaf, PanelName, TabNode
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_rows import CODE_COUNT, TIMELINE_ACTIONS
from caris_desktop.ui.dock_host import DockHost
from caris_desktop.ui.event_watch import EventWatch
from caris_desktop.ui.panel import TITLE_HEIGHT_PX, show_part
from caris_desktop.ui.replay.replay_bar import ReplayBar, Thumbnails
from caris_desktop.ui.replay.replay_dialogs import AgreementDialog, ImportDialog, TierDialog, TierRequest, with_tier
from caris_desktop.ui.replay.timeline_canvas import OpenInterval, TimelineCanvas
from caris_desktop.ui.replay.timeline_commands import TimelineCommands
from caris_desktop.ui.replay.timeline_items import (
    NAMES_PX,
    RULER_PX,
    Row,
    all_rows,
    arranged,
    exact_text,
    length_text,
    moved_key,
    tracks_of,
    vocabulary_named,
)
from caris_desktop.ui.text_formatting import in_menu
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.accessible_descriptions import ThrottledAccessibleDescription
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.inputs import add_clear_button
from caris_desktop.ui.widgets.labels import ElidedLabel, label, named, restyle

LOW_PX = 168
"""Below this height there is no room for the coding strip."""

_NARROWEST_PX, _LOWEST_PX = 480, TITLE_HEIGHT_PX + RULER_PX + 32
_NO_LIMIT_PX = 16_777_215
# Commands that repeat while their key is held.
_REPEATED = ("seek_by", "nudge", "select_next", "select_tier", "zoom")


class TimelineView(QWidget):
    """Shows the record and edits annotations; ``actions`` gets the timeline's keys.

    If there is no room below the panels it becomes a drawer with a title that opens it.
    """

    accessible_role = QAccessible.Role.Grouping

    open_requested = Signal(bool)

    def __init__(self, theme: Theme, replay: ReplayConsole, state: LiveState, actions: Actions) -> None:
        super().__init__()
        named(self, "timeline_view", tr("Timeline of the session"))
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Expanding)
        self.setMinimumSize(_NARROWEST_PX, _LOWEST_PX)
        self._theme = theme
        self._replay = replay
        self._state = state
        self._actions = actions
        self._opened: bool | None = None
        thumbnails = Thumbnails(replay, self)
        self.canvas = TimelineCanvas(theme, thumbnails.picture, replay.with_names)
        thumbnails.made.connect(self.canvas.refresh_pictures)
        self._description = ThrottledAccessibleDescription(self.canvas, self._accessible_text)
        self.acts = TimelineCommands(theme, replay, self.canvas, self)
        self.acts.open_changed.connect(self._on_selection_changed)
        self.acts.timeline_requested.connect(lambda: self.open_requested.emit(True))
        actions.add_rows(TIMELINE_ACTIONS, self.acts)
        self._order: list[str] = []
        self._hidden: set[str] = set()
        self.canvas.row_menu_requested.connect(self.open_row_menu)
        self.canvas.row_opened.connect(self._on_row_opened)
        self.canvas.row_moved.connect(self.move_row)
        self._across = QScrollBar(Qt.Orientation.Horizontal)
        self._across.valueChanged.connect(self.canvas.scroll_across_to)
        self._down = QScrollBar(Qt.Orientation.Vertical)
        self._down.valueChanged.connect(self.canvas.scroll_to)
        self.strip = CodingStrip(theme, actions)
        self.strip.add_tier_requested.connect(self.open_tier_dialog)
        middle = QGridLayout()
        middle.setContentsMargins(1, 0, 1, 0)
        middle.setSpacing(0)
        middle.addWidget(self.canvas, 0, 0)
        middle.addWidget(self._down, 0, 1)
        under = layouts.hbox(None, self._across, margins_px=(NAMES_PX, 0, 0, 0))
        middle.addLayout(under, 1, 0)
        self._card = self._make_header(), QWidget()
        layouts.vbox(self._card[1], (middle, 1), self.strip, margins_px=(0, 0, 0, 1), spacing_px=0)
        layouts.vbox(self, self._card[0], (self._card[1], 1), margins_px=0, spacing_px=0)
        for part, role in zip(self._card, ("panel_title", "panel"), strict=True):
            part.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
            part.setProperty("role", role)
        self.canvas.selection_changed.connect(self._on_selection_changed)
        self.canvas.view_changed.connect(self._on_view_changed)
        replay.coding.changed.connect(self._on_coding_changed)
        self._show_session()
        replay.overview.follow(self._on_overview_changed)
        replay.playback.follow(self._on_playback_changed)
        self.setFocusProxy(self.canvas)

    def _make_header(self) -> QWidget:
        header = QWidget()
        header.setFixedHeight(TITLE_HEIGHT_PX)
        title = label(tr("Timeline"), "title")
        self._fact = ElidedLabel(role="note", objectName="timeline_fact")
        row = layouts.hbox(header, title, margins_px=(14, 3, 6, 3), spacing_px=4)
        row.addSpacing(8)
        row.addWidget(self._fact, 1)
        self.filter = named(QLineEdit(placeholderText=tr("Filter tiers")), "tier_filter")
        self.filter.setAccessibleName(tr("Show only tiers that contain these words"))
        add_clear_button(self.filter)
        self.filter.setFixedSize(136, 30)
        self.filter.textChanged.connect(self._show_rows)
        self._named_buttons: list[ActionButton] = []
        for name, icon, text, tip, open_it in (
            ("rows_menu_button", "eye", tr("Rows"), tr("Show or hide rows"), self.open_rows_menu),
            ("add_tier", "plus", tr("Tier"), tr("Add a tier for yourself or another coder"), self.open_tier_dialog),
            ("agreement", "scales", tr("Agreement"), tr("Agreement between two coders"), self.open_agreement),
            (
                "import_annotations", "download-simple", tr("Import"), tr("Import from ELAN or a CSV table"),
                self.open_import,
            ),
        ):  # fmt: skip
            button = ActionButton(self._theme, text, icon=icon, height_px=30, text_px=tokens.STATUS_PX + 1, toolTip=tip)
            button.setObjectName(name)
            button.clicked.connect(open_it)
            self._named_buttons.append(button)
        icons = []
        for action_id in ("undo", "redo", "timeline_smaller", "timeline_larger", "timeline_fit"):
            spec = self._actions.standard_row(action_id)
            button = ActionButton(self._theme, icon=spec.icon, role="ghost", height_px=30, toolTip=spec.text)
            button.setObjectName(action_id)
            button.set_key_shown(False)
            button.bind(self._actions, action_id)
            icons.append(button)
        self._drawer = ActionButton(self._theme, height_px=30, text_px=tokens.STATUS_PX + 1)
        self._drawer.setObjectName("timeline_drawer")
        self._drawer.clicked.connect(lambda: self.open_requested.emit(not self._opened))
        self._drawer.hide()
        self._undo, self._redo = icons[:2]
        self._in_header = (self.filter, *self._named_buttons, *icons)
        for widget in (*self._in_header, self._drawer):
            row.addWidget(widget)
        return header

    def show_as_drawer(self, opened: bool | None) -> None:
        """Open or close the drawer; None if it is not one."""
        self._opened = opened
        shut = opened is False
        for widget in (self.canvas, self._down, *self._in_header):
            show_part(widget, not shut)
        show_part(self._drawer, opened is not None)
        name = tr("Back to the picture and the panels") if opened else tr("Open the timeline")
        icon = "caret-double-down" if opened else "caret-double-up"
        tip = name if opened else tr("Open the timeline over the panels: not enough room for both")
        self._drawer.set_label("" if opened else tr("Open"), icon=icon, role="amber", name=name, tip=tip)
        self.setMinimumHeight(TITLE_HEIGHT_PX if shut else _LOWEST_PX)
        self.setMaximumHeight(TITLE_HEIGHT_PX if shut else _NO_LIMIT_PX)
        self._use_room()

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._use_room()

    def _use_room(self) -> None:
        low = self.height() < LOW_PX or self._opened is False
        self.strip.setVisible(not low)
        self._across.setVisible(not low)
        for button in self._named_buttons:
            name = button.accessibleName()
            button.set_label(name if self.width() >= 1040 else "", name=name)

    # ---- display

    def _show_session(self) -> None:
        self._shown_end_ns: int = self._replay.playback.value.end_ns
        self.canvas.show_session(self._replay.session.started_ns, self.acts.duration_ms())

    def _on_overview_changed(self, overview: SessionOverview | None) -> None:
        self.canvas.show_overview(overview)
        self._show_tracks()
        self._show_rows()

    def _on_coding_changed(self, document: AnnotationDocument) -> None:
        self._show_tracks()
        self._show_rows()
        if self.canvas.open is not None and self.canvas.open.tier_id not in {tier.tier_id for tier in document.tiers}:
            self.acts.set_open(None)
        self._show_session()
        for button, step in zip((self._undo, self._redo), self._replay.undo_steps(), strict=True):
            tip = tr("{command}: {step}").format(command=button.accessibleName(), step=step)
            button.setToolTip(tip if step else button.accessibleName())

    def _show_tracks(self) -> None:
        overview: SessionOverview | None = self._replay.overview.value
        before = self.canvas.tracks
        recorded = {} if overview is None else tracks_of(overview.tiers, "record", before)
        self.canvas.show_tracks({**tracks_of(self.acts.document, "tier", before), **recorded})

    def _show_rows(self) -> None:
        every_row, words = self._all_rows(), tr("The recording contains nothing to show here.")
        rows = arranged(every_row, self._order, self._hidden, self.filter.text())
        if every_row:
            filtered = bool(self.filter.text().strip())
            words = tr("No row contains these words.") if filtered else tr("All rows are hidden.")
        elif self._replay.overview.value is None:
            words = tr("Reading the session…")
        self.canvas.show_rows(rows, coders_of(self.acts.document), words=words)
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
        active, interval = self.canvas.active, self.canvas.open
        tier = None if active is None or not active.own else active.tier
        vocabulary = (
            None if tier is None or not tier.vocabulary else vocabulary_named(self.acts.document, tier.vocabulary)
        )
        here = interval if tier is not None and interval is not None and interval.tier_id == tier.tier_id else None
        self.strip.show_tier(active, vocabulary, here, tiers=sum(bool(tier.coder) for tier in self.acts.document.tiers))
        self._fact.setText(self._fact_text())
        self._description.changed()
        for part in self._card:
            restyle(part, active=self.canvas.hasFocus())

    def _accessible_text(self) -> str:
        """Accessible description: position, visible part, number of marks, selection."""
        scale, overview = self.canvas.scale, self._replay.overview.value
        total_ms = self.acts.duration_ms()
        end_ms = min(total_ms, scale.to_ms(self.canvas.room_px))
        sentences = [
            tr("At {now} of {total}.").format(now=exact_text(self.canvas.position_ms), total=exact_text(total_ms)),
            tr("Shown from {start} to {end}.").format(
                start=exact_text(max(0.0, scale.start_ms)), end=exact_text(end_ms)
            ),
        ]
        if overview is not None:
            marks = sum(moment.kind == "mark" for moment in overview.moments)
            sentences.append(tr("1 mark.") if marks == 1 else tr("%n marks.", "", marks))
        return " ".join([*sentences, self._fact.text()]).strip()

    def _fact_text(self) -> str:
        item = self.canvas.selected
        if item is not None:
            times = f"{exact_text(item.start_ms)} – {exact_text(item.end_ms)}"
            value = self._replay.with_names(tr_filled(item.value)) or tr("No label yet")
            return f"{value} · {times} · {length_text(item.end_ms - item.start_ms)}"
        if self._replay.overview.value is None:
            return tr("reading the session…")
        count, coders = len(self.acts.document.annotations), len(coders_of(self.acts.document))
        if not coders:
            return ""
        of_count = tr("1 annotation") if count == 1 else tr("{count} annotations").format(count=f"{count:,}")
        of_coders = tr("1 coder") if coders == 1 else tr("%n coders", "", coders)
        return tr("{annotations} by {coders}").format(annotations=of_count, coders=of_coders)

    def _on_view_changed(self) -> None:
        canvas, scale = self.canvas, self.canvas.scale
        visible_ms, visible_px = canvas.room_px / scale.px_per_ms, canvas.height() - RULER_PX
        for bar, maximum, page, value in (
            (self._across, self.acts.duration_ms() - visible_ms, visible_ms, scale.start_ms),
            (self._down, canvas.rows_height_px - visible_px, visible_px, canvas.scroll_y),
        ):
            with QSignalBlocker(bar):
                bar.setRange(0, max(0, round(maximum)))
                bar.setPageStep(max(1, round(page)))
                bar.setSingleStep(max(1, round(page / 10)))
                bar.setValue(round(value))
        self._description.changed()

    # ---- rows and tiers

    def _all_rows(self) -> list[Row]:
        """All rows in the user's order."""
        return arranged(all_rows(self._replay.overview.value, self.acts.document), self._order, (), "")

    def open_tier_dialog(self) -> None:
        """Add a tier of an existing or new coder."""
        self._open_tier_dialog(None)

    def _open_tier_dialog(self, tier: Tier | None) -> None:
        active = self.canvas.active
        scenario = self._state.scenario.value
        TierDialog(
            self._theme,
            self.acts.document,
            self,
            apply=lambda request: self._apply_tier(request, tier),
            tier=tier,
            coder="" if active is None else active.coder,
            scenario_labels=() if scenario is None else scenario.recording.labels,
        ).open()

    def _apply_tier(self, request: TierRequest, tier: Tier | None) -> str:
        before = {item.tier_id for item in self.acts.document.tiers}
        refusal = self._replay.edit(lambda document: with_tier(document, request, tier))
        if not refusal:
            for item in self.acts.document.tiers:
                if item.tier_id not in before:
                    self.filter.clear()
                    self.canvas.activate(f"tier {item.tier_id}")
                    self.canvas.show_row(f"tier {item.tier_id}")
            self.canvas.setFocus(Qt.FocusReason.OtherFocusReason)
        return refusal

    def open_agreement(self) -> None:
        if sum(bool(tier.coder) for tier in self.acts.document.tiers) < 2:
            self.acts.say(tr("Agreement compares two tiers. Add the other coder’s tier, or import it."))
        else:
            AgreementDialog(self._theme, self.acts.document, self).open()

    def open_import(self) -> None:
        coders = coders_of(self.acts.document)
        ImportDialog(self._theme, self, coders=coders, import_file=self._import_file).open()

    def _import_file(self, path: Path, coder: str, on_result: Callable[[str], None]) -> None:
        before = self.acts.document

        def on_imported(refusal: str) -> None:
            if not refusal:
                self.acts.say(imported_words(before, self.acts.document))
            on_result(refusal)

        self._replay.import_annotations(path, coder, on_imported)

    def move_row(self, key: str, position: int) -> None:
        """Move a visible row. The order of a coder's own tiers is saved with them."""
        order = moved_key([row.key for row in self.canvas.rows], key, position)
        before = ""
        for row in self._all_rows():  # hidden rows stay behind their predecessor
            if row.key not in order:
                order.insert(order.index(before) + 1 if before in order else 0, row.key)
            before = row.key
        self._order = order
        tier_ids = [other.removeprefix("tier ") for other in order if other.startswith("tier ")]
        tier_id = key.removeprefix("tier ")
        if tier_id in tier_ids and tier_ids != [tier.tier_id for tier in self.acts.document.tiers if tier.coder]:
            self.acts.edit(lambda document: annotation_editing.move_tier(document, tier_id, tier_ids.index(tier_id)))
        self._show_rows()
        self.canvas.show_row(key)

    def set_row_shown(self, key: str, *, shown: bool) -> None:
        (self._hidden.discard if shown else self._hidden.add)(key)
        self._show_rows()

    def open_rows_menu(self) -> None:
        """Menu to show and hide rows."""
        button = self._named_buttons[0]
        menu = self._menu("rows_menu")
        for row in self._all_rows():
            action = menu.addAction(in_menu(f"{row.name} · {row.coder}" if row.own else row.name))
            action.setCheckable(True)
            action.setChecked(row.key not in self._hidden)
            action.toggled.connect(lambda shown, key=row.key: self.set_row_shown(key, shown=shown))
        menu.addSeparator()
        menu.addAction(tr("Show all rows"), self._show_all_rows)
        menu.popup(button.mapToGlobal(QPoint(0, button.height() + 4)))

    def _show_all_rows(self) -> None:
        self._hidden.clear()
        self._show_rows()

    def open_row_menu(self, key: str, at: QPoint) -> None:
        """Menu of a row and its selection."""
        index = self.canvas.index_of(key)
        if index is None:
            return
        row, selected, menu = self.canvas.rows[index], self.canvas.selected, self._menu("row_menu")
        tier = row.tier if row.own else None
        if tier is not None and selected is not None and selected.tier_id == tier.tier_id:
            for action_id in ("annotation_rename", "annotation_split", "annotation_remove"):
                text = f"{self._actions.standard_row(action_id).text}\t{self._actions.key_text(action_id)}"
                menu.addAction(text).triggered.connect(lambda _on, name=action_id: self._actions.run(name))
            menu.addSeparator()
        if tier is not None:
            menu.addAction(tr("Change the tier…"), lambda: self._open_tier_dialog(tier))
        menu.addAction(tr("Move up"), lambda: self.move_row(key, index - 1)).setEnabled(index > 0)
        down = menu.addAction(tr("Move down"), lambda: self.move_row(key, index + 1))
        down.setEnabled(index < len(self.canvas.rows) - 1)
        menu.addAction(tr("Hide"), lambda: self.set_row_shown(key, shown=False))
        if tier is not None:
            count = len(self.canvas.track_of(row).annotations)
            menu.addSeparator()
            words = tr("Remove the tier with its %n annotations", "", count) if count else tr("Remove the tier")
            remove = partial(annotation_editing.remove_tier, tier_id=tier.tier_id)
            menu.addAction(words, lambda: self.acts.edit(remove))
        menu.popup(at)

    def _menu(self, name: str) -> QMenu:
        menu = named(QMenu(self), name)
        menu.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        return menu

    def _on_row_opened(self, key: str) -> None:
        tiers = (tier for tier in self.acts.document.tiers if f"tier {tier.tier_id}" == key)
        for tier in tiers:
            self._open_tier_dialog(tier)

    # ---- keys

    def keyPressEvent(self, event: QKeyEvent) -> None:
        spec = self._actions.pressed_in("timeline", event) if self.canvas.hasFocus() else None
        if event.key() == Qt.Key.Key_Escape and self.canvas.hasFocus():
            self.acts.give_up()
        elif spec is None:
            super().keyPressEvent(event)
        elif not event.isAutoRepeat() or spec.callback in _REPEATED:
            self._actions.run(spec.id)


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


_EDITS = (
    ("annotation_new", "plus", QT_TR_NOOP("New")),
    ("annotation_split", "scissors", QT_TR_NOOP("Split")),
    ("annotation_rename", "pencil-simple", QT_TR_NOOP("Rename")),
    ("annotation_remove", "trash", QT_TR_NOOP("Remove")),
)
_NARROW_BELOW_PX = 1000
_LEAST_LABEL_PX, _LEAST_WORDS_PX, _MOST_WORDS_PX = 112, 72, 640


class CodingStrip(QWidget):
    """Coding strip below the timeline: labels of the active tier with their keys, and commands.

    ``add_tier_requested``: no tier yet; all else runs actions of the table. In a narrow strip commands show icons only,
    and labels that do not fit are in a menu.
    """

    add_tier_requested = Signal()

    def __init__(self, theme: Theme, actions: Actions) -> None:
        super().__init__()
        self.setObjectName("coding_strip")
        self.setFixedHeight(40)
        self._contents: tuple[object, ...] | None = None
        self._actions = actions
        self._present = 0
        self._words = ElidedLabel(role="note", objectName="coding_words")
        self._add = ActionButton(theme, tr("Add a tier"), icon="plus", role="primary", height_px=30)
        self._add.setObjectName("coding_add_tier")
        self._add.clicked.connect(self.add_tier_requested)
        self._labels: list[ActionButton] = []
        for number in range(1, CODE_COUNT + 1):
            button = ActionButton(theme, key_first=True, height_px=30, text_px=tokens.STATUS_PX, may_shrink=True)
            button.setObjectName(f"code_{number}")
            button.setCheckable(True)
            button.bind(actions, button.objectName())
            self._labels.append(button)
        self._more = ActionButton(theme, icon="caret-double-right", role="amber", height_px=30, clicked=self._open_more)
        self._more.setObjectName("coding_more")
        self._more.setAccessibleName(tr("More labels"))
        self._more.setToolTip(tr("More labels: their keys also work"))
        self._more.hide()
        self._edits: list[ActionButton] = []
        for action_id, _icon, text in _EDITS:
            button = ActionButton(theme, role="ghost", height_px=30, text_px=tokens.STATUS_PX, objectName=action_id)
            button.setToolTip(tr(text))
            button.bind(actions, action_id)
            self._edits.append(button)
        self._row = layouts.hbox(
            self, (self._words, 1), self._add, *self._labels, self._more, 1, *self._edits,
            margins_px=(16, 4, 8, 4), spacing_px=8,
        )  # fmt: skip

    def show_tier(
        self, row: Row | None, vocabulary: Vocabulary | None, interval: OpenInterval | None, *, tiers: int
    ) -> None:
        """``row``: the active tier; ``tiers``: the number of tiers."""
        contents = (row, vocabulary, interval, tiers)
        if contents == self._contents:
            return
        self._contents = contents
        own = row if row is not None and row.own else None
        entries = () if vocabulary is None or own is None else vocabulary.entries
        if not tiers:
            words = tr("Nothing is coded in this session yet.")
        elif own is None:
            words = tr("All coders’ tiers are hidden.")
        elif interval is not None:
            words = tr("{tier}: since {time}").format(tier=own.name, time=exact_text(interval.start_ms)[:-2])
        else:
            words = tr("{tier} of {coder} · drag on the tier to add an annotation")
            words = (tr("{tier} of {coder}") if entries else words).format(tier=own.name, coder=own.coder)
        self._words.setText(words)
        show_part(self._add, not tiers)
        for entry, button in zip(entries, self._labels, strict=False):
            open_now = interval is not None and interval.value == entry.value
            button.set_label(tr("End {label}").format(label=entry.value) if open_now else entry.value)
            button.setMinimumWidth(min(button.sizeHint().width(), _LEAST_LABEL_PX))
            button.setChecked(open_now)
            button.setToolTip(entry.description or tr("Press once to start at the playhead, again to end"))
        self._present = min(len(entries), len(self._labels))
        for button in self._edits:
            show_part(button, own is not None)
        self._fit()

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._fit()

    def _fit(self) -> None:
        narrow = self.width() < _NARROW_BELOW_PX
        for button, (_, icon, text) in zip(self._edits, _EDITS, strict=True):
            button.set_label("" if narrow else tr(text), icon=icon if narrow else "", name=tr(text))
            button.set_key_shown(not narrow)
        words_px = min(_MOST_WORDS_PX, self._words.sizeHint().width() + 2)
        self._words.setMaximumWidth(words_px)
        self._words.setMinimumWidth(min(words_px, _LEAST_WORDS_PX) if self._present else 0)
        for count in range(self._present, -1, -1):
            for number, button in enumerate(self._labels):
                show_part(button, number < count)
            show_part(self._more, count < self._present)
            if count <= 1 or self._row.minimumSize().width() <= self.width():
                break

    def _open_more(self) -> None:
        menu = named(QMenu(self), "more_codes_menu")
        for button in self._labels[: self._present]:
            if button.isHidden():
                action = menu.addAction(in_menu(f"{button.key}  {button.text()}"))
                action.triggered.connect(lambda _on, button=button: self._actions.run(button.objectName()))
        menu.aboutToHide.connect(menu.deleteLater)
        menu.popup(self._more.mapToGlobal(QPoint(0, -menu.sizeHint().height())))


_PANELS_AND_TIMELINE_PX = (600, 260)
_SMALL_BELOW_PX = (880, 600)
"""Below this window size, the bar has a single line and the panels are lower."""

_LOWEST_WINDOW_PX = 380
_LEAST_PANELS_PX = 120
DRAWER_BELOW_PX = _LEAST_PANELS_PX + 8 + LOW_PX
"""Below this total height, only one of panels and timeline is open at a time."""


class ReplayWidgets(QObject):
    """Timeline and replay bar with their keys; ``arrange`` places them in the window."""

    def __init__(self, theme: Theme, replay: ReplayConsole, state: LiveState, actions: Actions) -> None:
        super().__init__()
        self.timeline = TimelineView(theme, replay, state, actions)
        self.timeline.open_requested.connect(self._open_timeline)
        self._bar = ReplayBar(theme, replay, actions)
        self._small: bool | None = None
        self._drawer = self._timeline_open = False

    def arrange(self, docks: DockHost, middle: QSplitter, column: QVBoxLayout, status_bar: QWidget) -> None:
        """Place the timeline below ``docks`` in the ``middle`` of the window, and the bar above the status bar."""
        self._panels, self._middle, self._window = ReplayPanels(docks), middle, middle.window()
        middle.insertWidget(0, self._panels)
        middle.addWidget(self.timeline)
        middle.setStretchFactor(0, 1)
        middle.setStretchFactor(1, 0)
        middle.setSizes(list(_PANELS_AND_TIMELINE_PX))
        column.insertWidget(column.indexOf(status_bar), self._bar)
        for watched, use_size in ((self._window, self._use_window_size), (middle, self._use_room)):
            EventWatch(self, use_size, QEvent.Type.Resize).add(watched)
        # Otherwise the window could be shrunk only in steps.
        self._window.setMinimumHeight(_LOWEST_WINDOW_PX)
        self._use_window_size()

    def fit(self) -> None:
        """Adjust after the panels were rebuilt."""
        self._panels.fit()

    def show_panels(self) -> None:
        """Close the timeline if it is a drawer over the panels."""
        if self._drawer and self._timeline_open:
            self._open_timeline(False)

    def take_focus(self) -> None:
        """Take the focus: no field gets typed keys in a replay, and Space plays."""
        taker = self._window if self._drawer and not self._timeline_open else self.timeline
        taker.setFocus(Qt.FocusReason.OtherFocusReason)

    def _use_window_size(self) -> None:
        small = self._window.width() < _SMALL_BELOW_PX[0] or self._window.height() < _SMALL_BELOW_PX[1]
        if small != self._small:
            self._small = small
            self._bar.set_one_line(small)
            self._panels.setMinimumHeight(_LEAST_PANELS_PX if small else PANELS_LEAST_PX)

    def _use_room(self) -> None:
        drawer = self._middle.height() < DRAWER_BELOW_PX
        if drawer != self._drawer:
            self._drawer = drawer
            had_focus = self._window.focusWidget() is self.timeline.canvas
            self._show_drawer()
            if had_focus:
                self.take_focus()

    def _open_timeline(self, opened: bool) -> None:
        self._timeline_open = opened
        self._show_drawer()
        self.take_focus()

    def _show_drawer(self) -> None:
        """Show the panels with the timeline's title below, or the timeline."""
        self.timeline.show_as_drawer(None if not self._drawer else self._timeline_open)
        self._panels.setVisible(not (self._drawer and self._timeline_open))
        timeline_px = _PANELS_AND_TIMELINE_PX[1]
        if self._drawer:
            timeline_px = TITLE_HEIGHT_PX
        elif self._small:
            timeline_px = LOW_PX
        self._middle.setSizes([max(1, self._middle.height() - timeline_px), timeline_px])


PANELS_LEAST_PX = 200
_LEAST_PANEL_PX = 56


def lower_edge(node: LayoutNode, panel: PanelName) -> float | None:
    """Lower edge of the panel as a share of the tree's height; None if it is not in the tree."""
    if isinstance(node, PanelLeaf):
        return 1.0 if node.panel == panel else None
    if isinstance(node, TabNode):
        return 1.0 if panel in node.tabs else None
    above, total = 0.0, sum(node.weights)
    for child, weight in zip(node.children, node.weights, strict=True):
        edge = lower_edge(child, panel)
        if edge is not None:
            return edge if node.split == "horizontal" else (above + edge * weight) / total
        above += weight
    return None


class ReplayPanels(QScrollArea):
    """Scroll area for the panels of a replay, above the timeline. They only display.

    On a low screen the panels scroll, at a height that shows the whole video without scrolling.
    """

    def __init__(self, docks: DockHost) -> None:
        super().__init__()
        self.setObjectName("replay_panels")
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setMinimumHeight(PANELS_LEAST_PX)
        self._docks = docks
        self.setWidget(docks)
        docks.layout_changed.connect(self.fit)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self.fit()

    def fit(self) -> None:
        """Set the height at which the video ends at the bottom of the view."""
        tree = self._docks.tree
        edge = lower_edge(tree, "video") if tree is not None else None
        for dock in self._docks.docks.values():
            # Panels' own minimum sizes are for operating them, which a replay does not.
            dock.panel.setMinimumHeight(_LEAST_PANEL_PX)
        self._docks.setMinimumHeight(round(self.viewport().height() / edge) if edge else 0)
