"""Command palette: items, usage history, matching and ranking, and the window over the content."""

import json
import re
import sys
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import field
from difflib import SequenceMatcher
from itertools import accumulate, chain
from typing import Any

from PySide6.QtCore import QModelIndex, QRect, QRectF, QSize, QStringListModel, Qt
from PySide6.QtGui import QFocusEvent, QKeyEvent, QPainter
from PySide6.QtWidgets import QLineEdit, QListView, QStyle, QStyleOptionViewItem, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.key_choices import key_code, position_of
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.preferences import WizardProfiles
from caris_desktop.ui.theme import Theme, draw_icon
from caris_desktop.ui.widgets.labels import draw_key_cap, key_cap_width, label
from caris_desktop.ui.widgets.rows import Index, RowDelegate

RECENT = 5
OFTEN = 6
_OFTEN_FROM = 3  # uses
_KEPT = 200
_KEY = "palette/used"
_MEANS_NOTHING = frozenset({"the", "a", "an", "to", "please", "into"})
_ALIKE = 0.75
_LONG_ENOUGH_TO_GUESS = 4
_LEAST_OF_A_NAME = 3
_ENOUGH = 30
"""Fuzzy matches are skipped if there are this many exact ones."""
_LONGEST_QUERY = 200
"""Characters. Each key searches for every word, so a pasted paragraph would stall the window."""


class PaletteItem(Value):
    """Item that can be found and run; ``also``: synonyms.

    ``acts``: speaks or moves the robot, so only exact words find it, never fuzzy matching. ``ends``: ends or pauses
    something. ``deliberate``: disables a protection, so it is never preselected and needs Enter or a click twice;
    ``again`` is the prompt in between. ``first``: sorted before all other results. ``named``: name of the object; a
    query that only contains the name does not preselect an item that ``acts`` or ``ends``, unless ``by_name``, as for
    a place, which has a single command. ``id``: stable key of the usage history, independent of language and without
    personal data. ``common``: listed as frequently used until there is a history.
    """

    text: str
    kind: str
    icon: str
    do: Callable[[], object]
    key: str = ""
    also: str = ""
    acts: bool = False
    ends: bool = False
    deliberate: bool = False
    again: str = ""
    first: bool = False
    common: bool = False
    named: str = ""
    by_name: bool = False
    id: str = field(kw_only=True)

    @property
    def spoken(self) -> str:
        """The line as text for a screen reader: name, kind, key."""
        return ", ".join(part for part in (self.text, self.kind, self.key) if part)


class Used(Value):
    """Usage history by ``PaletteItem.id``: recent, newest first, and frequently used."""

    recent: tuple[str, ...] = ()
    often: tuple[str, ...] = ()


class PaletteMemory:
    """Saved in the wizard profile. Items that disable a protection are not recorded: they must be searched for."""

    def __init__(self, wizards: WizardProfiles) -> None:
        self._wizards = wizards

    @property
    def used(self) -> Used:
        recent, counts = self._read()
        often = [name for name, times in counts.most_common() if times >= _OFTEN_FROM and name not in recent[:RECENT]]
        return Used(tuple(recent[:RECENT]), tuple(often[:OFTEN]))

    def note(self, entry: PaletteItem) -> None:
        """Record a use."""
        if entry.deliberate:
            return
        recent, counts = self._read()
        name = entry.id
        counts[name] += 1
        recent = [name, *(known for known in recent if known != name)][:_KEPT]
        recent_counts = {known: counts[known] for known in recent}
        self._wizards.set_value(_KEY, json.dumps({"recent": recent, "counts": recent_counts}))

    def _read(self) -> tuple[list[str], Counter[str]]:
        try:
            stored: Any = json.loads(str(self._wizards.value(_KEY, "{}")))
        except (ValueError, RecursionError):
            stored = {}
        if not isinstance(stored, dict):
            stored = {}
        recent, counts = stored.get("recent"), stored.get("counts")
        return (
            [name for name in recent if isinstance(name, str)] if isinstance(recent, list) else [],
            Counter({name: times for name, times in counts.items() if isinstance(times, int)})
            if isinstance(counts, dict)
            else Counter(),
        )


class Finder:
    """Search index over items: each keystroke only compares.

    ``order``: order without a query: mandatory, recent, common, other items; ``breaks``: where these sections begin.
    """

    def __init__(self, entries: Sequence[PaletteItem], used: Used | None = None) -> None:
        self.order, self.breaks = _in_order(entries, used or Used())
        self._texts = [entry.text.casefold() for entry in self.order]
        self._own_texts = [f"{entry.text} {entry.kind}".casefold() for entry in self.order]
        self._words = [f"{entry.text} {entry.kind} {entry.also}".casefold() for entry in self.order]
        self._vocabulary: _Vocabulary | None = None

    def matching(self, query: str) -> list[PaletteItem]:
        """Items that contain all words of the query, prefix matches first, otherwise in the index order.

        An item of that name ranks before recently used items that match by a synonym: Enter must run what was typed.
        Articles are ignored. Fuzzy matches follow, but never items that speak or move the robot: "diagnotics" finds a
        panel, "drive to the kichen" nothing.
        """
        typed = query.casefold().split()
        query_words = [word for word in typed if word not in _MEANS_NOTHING] or typed
        found: Sequence[int] = range(len(self.order))
        for word in query_words:
            found = [place for place in found if word in self._words[place]]
        if not query_words:
            return list(self.order)
        exact = sorted(found, key=lambda place: self._rank(place, " ".join(typed), query_words))
        alike = self._alike(query_words, set(found)) if len(found) < _ENOUGH else []
        return [self.order[place] for place in (*exact, *alike)]

    def _rank(self, place: int, query: str, query_words: Sequence[str]) -> tuple[bool | int, ...]:
        """Sort key: items that act without their verb in the query last; exact names and places first; then contiguous
        matches before scattered ones; then the sections, each with the items first that begin with the query.
        """
        entry, text = self.order[place], self._texts[place]
        called = {text, text.rpartition(": ")[2], entry.named.casefold()}
        return (
            not entry.first,
            not says_what_to_do(entry, query),
            query not in called,
            not (entry.by_name and _begin_words_of(entry.named, query_words)),
            " " in query and query not in text,
            not all(word in self._own_texts[place] for word in query_words),
            bisect_right(self.breaks, place),
            not text.startswith(query),
        )

    def _alike(self, query_words: Sequence[str], exact: set[int]) -> list[int]:
        if not any(len(word) >= _LONG_ENOUGH_TO_GUESS for word in query_words):
            return []
        if self._vocabulary is None:
            guessable = [place for place, entry in enumerate(self.order) if not (entry.acts or entry.deliberate)]
            self._vocabulary = _Vocabulary({place: self._words[place] for place in guessable})
        each = [self._vocabulary.distances(word) for word in query_words]
        everywhere = set(each[0]).intersection(*each[1:]) - exact
        far = sorted((sum(distances[place] for distances in each), place) for place in everywhere)
        return [place for _far, place in far]


def enter_runs_first(found: Sequence[PaletteItem], query: str) -> bool:
    """Whether Enter may run the first result. A guess must be chosen: "charge" is like the last change, which can be
    undone. An item that acts or ends something needs its verb or, if ``by_name``, some letters of its name, and no
    other result may fit as well.
    """
    first, *others = found
    words = f"{first.text} {first.kind} {first.also}".casefold()
    if any(word not in words for word in _meaningful(query)):
        return False
    if not (first.acts or first.ends) or not says_what_to_do(first, query):
        return says_what_to_do(first, query)
    fit, typed = _fit(first, query), _meaningful(query)
    if fit == 1 and _object_of(first, query) == typed and len(" ".join(typed)) < _LEAST_OF_A_NAME:
        return False
    rivals = (other for other in others if says_what_to_do(other, query))
    return not any(_fit(other, query) >= (fit if other.acts or other.ends else max(fit, 1)) for other in rivals)


def says_what_to_do(entry: PaletteItem, query: str) -> bool:
    """Whether the query names what the item does, or equals its whole text."""
    query_words = _meaningful(query)
    if not entry.named or not (entry.acts or entry.ends):
        return True
    if entry.by_name and _begin_words_of(entry.named, query_words):
        return True
    same = " ".join(query.casefold().split()) == entry.text.casefold()
    return same or len(_object_of(entry, query)) < len(query_words)


def _fit(entry: PaletteItem, query: str) -> int:
    """How well the typed object fits the item: 2 for its name, 1 for the beginning of its name or of a word in it."""
    words = _object_of(entry, query)
    typed, names = " ".join(words), (entry.text.casefold(), entry.named.casefold())
    if not typed:
        return 0
    begins = any(name.startswith(typed) for name in names) or (entry.by_name and _begin_words_of(entry.named, words))
    return 2 if typed in names else int(begins)


def _object_of(entry: PaletteItem, query: str) -> list[str]:
    """Words of the query that are not words for what the item does."""
    names = set(_words_of(entry.named or entry.text))
    verbs = [word for word in _words_of(f"{entry.text} {entry.kind} {entry.also}") if word not in names]
    return [word for word in _meaningful(query) if len(word) < 2 or not any(verb.startswith(word) for verb in verbs)]


def _meaningful(query: str) -> list[str]:
    words = query.casefold().split()
    return [word for word in words if word not in _MEANS_NOTHING] or words


def _begin_words_of(name: str, query_words: Sequence[str]) -> bool:
    """Whether each word is a prefix of a word in the name."""
    return all(any(part.startswith(word) for part in _words_of(name)) for word in query_words)


def _words_of(text: str) -> list[str]:
    return [word for word in re.split(r"[\W_]+", text.casefold()) if word]


class _Vocabulary:
    """Words of the items that fuzzy matching may find."""

    def __init__(self, texts: dict[int, str]) -> None:
        self._texts = texts
        self._known = set().union(*map(str.split, texts.values()))

    def distances(self, word: str) -> dict[int, float]:
        """Distance per item: 0 for an exact match, up to 10 for a similar word."""
        near: dict[int, float] = {place: 0.0 for place, text in self._texts.items() if word in text}
        if len(word) < _LONG_ENOUGH_TO_GUESS:
            return near
        for known, ratio in _like(word, self._known):
            for place, text in self._texts.items():
                if known in text:
                    near[place] = min(near.get(place, 10.0), 1.0 + 9.0 * (1.0 - ratio))
        return near


def _like(word: str, known_words: set[str]) -> list[tuple[str, float]]:
    pairs = {word[at : at + 2] for at in range(len(word) - 1)}
    matcher = SequenceMatcher(None, "", word)  # SequenceMatcher caches data about its second sequence
    found = []
    for known in known_words:
        # Comparing costs a hundred times more: only words with the same first letter or a common bigram.
        if known[0] != word[0] and not any(pair in known for pair in pairs):
            continue
        ratio = _ratio(matcher, known)
        if ratio < _ALIKE and len(known) > len(word) + 1 and known[0] == word[0]:
            ratio = _ratio(matcher, known[: len(word)])  # the word may be incomplete
        if ratio >= _ALIKE:
            found.append((known, ratio))
    return found


def _ratio(matcher: "SequenceMatcher[str]", known: str) -> float:
    """Similarity; 0.0 below the threshold."""
    matcher.set_seq1(known)
    if matcher.real_quick_ratio() < _ALIKE or matcher.quick_ratio() < _ALIKE:
        return 0.0
    return matcher.ratio()


def _in_order(entries: Sequence[PaletteItem], used: Used) -> tuple[tuple[PaletteItem, ...], tuple[int, ...]]:
    by_name: dict[str, PaletteItem] = {}
    for entry in entries:
        by_name.setdefault(entry.id, entry)
    placed: set[int] = set()
    parts: list[list[PaletteItem]] = []
    often = [by_name[name] for name in used.often if name in by_name]
    for part in (
        [entry for entry in entries if entry.first],
        [by_name[name] for name in used.recent if name in by_name],
        often or [entry for entry in entries if entry.common],
        entries,
    ):
        parts.append([entry for entry in part if id(entry) not in placed])
        placed |= {id(entry) for entry in part}
    ends = list(accumulate(map(len, parts)))
    return tuple(chain(*parts)), tuple(ends[:-1])


_ROW_PX = 40
_ROWS = 9
_ENTER = (Qt.Key.Key_Return, Qt.Key.Key_Enter)


class CommandPalette(Overlay):
    """Search field with a result list; Enter runs the selected result."""

    DIGITS = 9

    def __init__(self, theme: Theme, window: QWidget, memory: PaletteMemory) -> None:
        super().__init__(theme, window, width_px=620)
        self.setObjectName("command_palette")
        self._memory = memory
        self._finder = Finder(())
        self._new: Callable[[str], PaletteItem] | None = None
        self._by_digit: Sequence[PaletteItem] = ()
        self.field = _PaletteField(self)
        self.field.setObjectName("palette_field")
        self.field.setMinimumHeight(46)
        self.field.setMaxLength(_LONGEST_QUERY)
        self.field.textChanged.connect(self._on_text_changed)
        self.list = _ItemList(theme, self)
        self._nothing = label(tr("No matching entries."), alignment=Qt.AlignmentFlag.AlignCenter, enabled=False)
        layouts.vbox(self.card, self.field, (self.list, 1), (self._nothing, 1), margins_px=12, spacing_px=8)

    def card_height_px(self) -> int:
        return 46 + 32 + _ROWS * _ROW_PX

    def open_with(self, entries: Sequence[PaletteItem]) -> None:
        """Search these items, recently used ones first."""
        self._new, self._by_digit = None, ()
        self._open(
            Finder(entries, self._memory.used), tr("Find an action, phrase, place, person, setting or session…"),
            tr("Find anything"),
        )  # fmt: skip

    def ask(self, question: str, entries: Sequence[PaletteItem], new: Callable[[str], PaletteItem]) -> None:
        """Choose one of ``entries`` or type a new one, created by ``new``."""
        self._new, self._by_digit = new, ()
        self._open(Finder(entries), question, question)

    def choose_from(self, question: str, entries: Sequence[PaletteItem]) -> None:
        """Choose one of ``entries``; while nothing is typed, digit N selects the Nth."""
        self._new, self._by_digit = None, entries[: self.DIGITS]
        self._open(Finder(entries), question, question)

    def takes_digit(self, digit: str) -> bool:
        """Run the item of a digit; returns whether there was one."""
        if self.field.text() or not 1 <= int(digit) <= len(self._by_digit):
            return False
        self.choose(self._by_digit[int(digit) - 1])
        return True

    def _open(self, finder: Finder, placeholder: str, name: str) -> None:
        self._finder = finder
        self.field.setPlaceholderText(placeholder)
        self.field.setAccessibleName(name)
        self.field.clear()
        self._on_text_changed("")
        self.open()
        self.field.setFocus(Qt.FocusReason.OtherFocusReason)

    def renew(self, entries: Sequence[PaletteItem]) -> None:
        """Replace the items after the available commands changed."""
        if self._new is None and not self._by_digit:
            self._finder = Finder(entries, self._memory.used)
            self._on_text_changed(self.field.text())

    def choose(self, entry: PaletteItem | None) -> None:
        if entry is None:
            return
        if entry.deliberate and self.list.pending_entry != entry:
            self.list.ask_again(entry)
            return
        self.close_overlay()
        if self._new is None:
            self._memory.note(entry)
        entry.do()

    def _on_text_changed(self, text: str) -> None:
        typed = " ".join(text.split())
        found = self._finder.matching(typed)
        if self._new is not None and typed:
            found.append(self._new(typed))
        breaks = () if typed else self._finder.breaks
        if not found or not typed:
            selected = bool(found) and not (found[0].acts or self._by_digit)
        else:  # a list of choices was opened by its verb
            selected = says_what_to_do(found[0], typed) if self._by_digit else enter_runs_first(found, typed)
        self.list.setVisible(bool(found))
        self._nothing.setHidden(bool(found))
        self.list.show_entries(found, breaks=breaks, selected=selected)


class _PaletteField(QLineEdit):
    def __init__(self, palette: CommandPalette) -> None:
        super().__init__()
        self._owner = palette
        self._enter_down = False

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() in (Qt.Key.Key_Up, Qt.Key.Key_Down):
            self._owner.list.move_by(1 if event.key() == Qt.Key.Key_Down else -1)
        elif event.key() in _ENTER:
            # One Enter per key press: Qt does not always mark auto-repeat.
            if not self._enter_down:
                self._enter_down = True
                self._owner.choose(self._owner.list.current)
        else:
            digit = _digit_of(event)
            if not digit or event.isAutoRepeat() or not self._owner.takes_digit(digit):
                super().keyPressEvent(event)

    def keyReleaseEvent(self, event: QKeyEvent) -> None:
        if event.key() in _ENTER and not event.isAutoRepeat():
            self._enter_down = False
        super().keyReleaseEvent(event)

    def focusOutEvent(self, event: QFocusEvent) -> None:
        self._enter_down = False
        super().focusOutEvent(event)


def _digit_of(event: QKeyEvent) -> str:
    """Digit of a key by position, whatever the layout types without Shift; empty for other keys."""
    if event.modifiers() & ~Qt.KeyboardModifier.KeypadModifier:
        return ""
    code = key_code(sys.platform, scan_code=event.nativeScanCode(), virtual_key=event.nativeVirtualKey())
    digit = position_of(sys.platform, code) or event.text()
    return digit if digit in tuple("123456789") else ""


class _ItemList(QListView):
    """Results. The field keeps the focus and moves the current row."""

    def __init__(self, theme: Theme, owner: CommandPalette) -> None:
        super().__init__()
        self._owner = owner
        self.entries: tuple[PaletteItem, ...] = ()
        self.breaks: Sequence[int] = ()
        self.pending_entry: PaletteItem | None = None
        self._double_click = False
        self._spoken = QStringListModel(self)
        self.setModel(self._spoken)
        self.setItemDelegate(_ItemDelegate(theme, self))
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setEditTriggers(QListView.EditTrigger.NoEditTriggers)
        self.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setUniformItemSizes(True)
        # The pointer only lights a row: bumped while the hands type, it must not change what Enter runs.
        self.viewport().setAttribute(Qt.WidgetAttribute.WA_Hover)
        self.selectionModel().selectionChanged.connect(self._on_selected)
        # One command, however often the button is pressed.
        self.pressed.connect(lambda: self._set_double_click(False))
        self.doubleClicked.connect(lambda: self._set_double_click(True))
        self.clicked.connect(self._on_clicked)

    @property
    def current(self) -> PaletteItem | None:
        """Item that Enter runs; None if none is selected."""
        row = self.currentIndex().row()
        return self.entries[row] if row >= 0 else None

    def show_entries(self, entries: Sequence[PaletteItem], *, breaks: Sequence[int], selected: bool) -> None:
        """Show results. ``breaks``: indices of divider lines. ``selected``: Enter runs the first one."""
        self.entries, self.breaks = tuple(entries), breaks
        self._spoken.setStringList([entry.spoken for entry in entries])
        # A dangerous item is never preselected, so that a quick Enter runs neither it nor another one.
        can_be_chosen = selected and not entries[0].deliberate
        self._choose_row(self._spoken.index(0) if can_be_chosen else QModelIndex())

    def ask_again(self, entry: PaletteItem) -> None:
        """Ask for confirmation: choosing the same item again runs it."""
        self.pending_entry = entry
        self._spoken.setData(self.currentIndex(), entry.again)

    def move_by(self, step: int) -> None:
        if self.entries:
            row = self.currentIndex().row()
            before = row if row >= 0 or step > 0 else 0
            self._choose_row(self._spoken.index((before + step) % len(self.entries)))

    def _choose_row(self, index: QModelIndex) -> None:
        self.setCurrentIndex(index)
        if self.pending_entry is not None and self.current is not self.pending_entry:
            if self.pending_entry in self.entries:
                row = self.entries.index(self.pending_entry)
                self._spoken.setData(self._spoken.index(row), self.pending_entry.spoken)
            self.pending_entry = None
        # The field is the only widget that a screen reader follows.
        self._owner.field.setAccessibleDescription("" if self.current is None else self.current.spoken)

    def _on_selected(self) -> None:
        """Follow a selection by a screen reader."""
        for index in self.selectedIndexes():
            if index != self.currentIndex():
                self._choose_row(index)

    def _set_double_click(self, double_click: bool) -> None:
        self._double_click = double_click

    def _on_clicked(self, index: QModelIndex) -> None:
        if not self._double_click:
            self._choose_row(index)
            self._owner.choose(self.current)


class _ItemDelegate(RowDelegate):
    def __init__(self, theme: Theme, items: _ItemList) -> None:
        super().__init__(theme, items)
        self._items = items

    def sizeHint(self, _option: QStyleOptionViewItem, _index: Index) -> QSize:
        return QSize(0, _ROW_PX)

    def paint(self, painter: QPainter, option: QStyleOptionViewItem, index: Index) -> None:
        if option.state & QStyle.StateFlag.State_MouseOver:
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(self._theme.color("raised_hover"))
            painter.drawRoundedRect(option.rect, 8, 8)
        super().paint(painter, option, index)

    def paint_row(self, painter: QPainter, row: QRect, index: Index) -> None:
        theme, entry, rect = self._theme, self._items.entries[index.row()], QRectF(row)
        again = entry == self._items.pending_entry
        if index.row() and index.row() in self._items.breaks:
            painter.setPen(theme.color("line"))
            painter.drawLine(rect.topLeft(), rect.topRight())
        if index == self._items.currentIndex():
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(theme.color("amber_soft" if again else "blue_soft"))
            painter.drawRoundedRect(rect, 8, 8)
        draw_icon(painter, QRectF(12, rect.center().y() - 9, 18, 18), entry.icon, theme.color("dim"))
        cap = key_cap_width(theme, entry.key)
        draw_key_cap(painter, theme, entry.key, rect.width() - cap - 12, rect.center().y())
        painter.setFont(theme.font(tokens.STATUS_PX))
        painter.setPen(theme.color("dim"))
        kind_rect = rect.adjusted(0, 0, -cap - 24, 0)
        painter.drawText(kind_rect, int(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter), entry.kind)
        room = QRect(row.left() + 42, row.top(), int(rect.width() - cap - 160), row.height())
        self.paint_text(painter, room, entry.again if again else entry.text, theme.font(tokens.BODY_PX), "text")
