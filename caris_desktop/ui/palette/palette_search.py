"""Items of the command palette: usage history, matching and ranking."""

import json
import re
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import field
from difflib import SequenceMatcher
from itertools import accumulate, chain
from typing import Any

from caris_desktop.domain.value_class import Value
from caris_desktop.ui.preferences import WizardProfiles

RECENT = 5
OFTEN = 6
_OFTEN_FROM = 3  # uses
_KEPT = 200
_KEY = "palette/used"
_MEANS_NOTHING = frozenset({"the", "a", "an", "to", "please", "into"})
_ALIKE = 0.75
_LONG_ENOUGH_TO_GUESS = 4
_ENOUGH = 30
"""Fuzzy matches are skipped if there are this many exact ones."""


class PaletteItem(Value):
    """Item that can be found and run; ``also``: synonyms.

    ``acts``: speaks or moves the robot, so only exact words find it, never fuzzy matching. ``deliberate``: disables a
    protection, so it is never preselected and needs Enter or a click twice; ``again`` is the prompt in between.
    ``first``: sorted before all other results. ``named``: name of the object; a query that only contains the name does
    not preselect the item unless ``by_name``, as for a place, which has a single command. ``id``: stable key of the
    usage history, independent of language and without personal data. ``common``: listed as frequently used until there
    is a history.
    """

    text: str
    kind: str
    icon: str
    do: Callable[[], object]
    key: str = ""
    also: str = ""
    acts: bool = False
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


def says_what_to_do(entry: PaletteItem, query: str) -> bool:
    """Whether the query names what the item does, or equals its whole text."""
    words = query.casefold().split()
    query_words = [word for word in words if word not in _MEANS_NOTHING] or words
    if not (entry.acts and entry.named):
        return True
    if (entry.by_name and _begin_words_of(entry.named, query_words)) or " ".join(words) == entry.text.casefold():
        return True
    names = set(_words_of(entry.named))
    verbs = [word for word in _words_of(f"{entry.text} {entry.kind} {entry.also}") if word not in names]
    return any(len(word) > 1 and verb.startswith(word) for word in query_words for verb in verbs)


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
