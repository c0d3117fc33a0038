"""Phrases of a scenario (plain, with options, or in titled groups), its gestures, and their keys."""

from collections.abc import Iterable, Iterator
from typing import Annotated, Any

from caris_desktop.domain.schema_fields import FieldSpec, Problem
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value, setting

_OF_TEXT_FIELDS = "ACVXYZ"
_PATTERN = rf"^(Ctrl\+(?![{_OF_TEXT_FIELDS}]$)(Shift\+)?[A-Z0-9])?$"
_ALLOWED = "Ctrl or Ctrl+Shift with a letter or digit, such as Ctrl+G; not the keys for editing text."


def own_key() -> Any:
    """Field with a combination of keys; none by default."""
    return setting(default="", pressed=True, pattern=_PATTERN, allowed=_ALLOWED, quiet=True)


KEYS_OF_A_GROUP = 8
"""F1 to F8."""

Sentence = Annotated[str, FieldSpec(shortest=1, longest=500)]


class Phrase(Value):
    """A sentence with what goes along with it."""

    say: Sentence = setting(title="Sentence")
    """Text that the robot says."""
    key: str = own_key()
    """Its own key, which works whichever group is selected."""
    gesture: str = setting(default="", knows="gestures", longest=80, quiet=True)
    """Action of the robot when the sentence starts: the id of a control of the Robot panel, `nod`, or `look` to turn
    the head to the person addressed."""
    face: str = setting(default="", knows="expressions", longest=40, quiet=True)
    """Expression of the robot's face when the sentence starts."""


class PhraseGroup(Value):
    """Phrases for one part of the session, on F1 to F8 while their group is chosen. F10 chooses the next group."""

    group: str = setting(title="Title of the group", shortest=1, longest=40)
    """Title by which the wizard selects the group, with F10."""
    phrases: tuple[Sentence | Phrase, ...] = setting(title="Sentences", shortest=1, longest=KEYS_OF_A_GROUP)
    """Sentences on F1 to F8 while the group is selected, in this order."""


PhraseEntry = Sentence | Phrase | PhraseGroup


class PhraseKeys(Value):
    """Phrases on F1 to F8 while a group is selected. ``title`` is empty for ungrouped phrases."""

    title: str
    phrases: tuple[Phrase, ...]


class _Grouped:
    """Cache of the last result: the same scenario is queried repeatedly, and may have thousands of phrases."""

    last: tuple[Iterable[PhraseEntry], tuple[PhraseKeys, ...]] = ((), ())


def phrase_groups(entries: Iterable[PhraseEntry]) -> tuple[PhraseKeys, ...]:
    """Groups in order; ungrouped phrases first."""
    if not isinstance(entries, tuple):
        return _grouped(tuple(entries))
    last = _Grouped.last
    if entries is not last[0]:
        last = _Grouped.last = (entries, _grouped(entries))
    return last[1]


def _grouped(entries: tuple[PhraseEntry, ...]) -> tuple[PhraseKeys, ...]:
    loose = tuple(_as_phrase(entry) for entry in entries if not isinstance(entry, PhraseGroup))
    groups = [
        PhraseKeys(entry.group, tuple(map(_as_phrase, entry.phrases)))
        for entry in entries
        if isinstance(entry, PhraseGroup)
    ]
    return (*([PhraseKeys("", loose)] if loose else []), *groups)


def sentences(entries: Iterable[PhraseEntry]) -> tuple[str, ...]:
    """Sentences of all groups."""
    return tuple(phrase.say for group in phrase_groups(entries) for phrase in group.phrases)


def _as_phrase(entry: str | Phrase) -> Phrase:
    return Phrase(entry) if isinstance(entry, str) else entry


def phrase_problems(entries: Iterable[PhraseEntry]) -> Iterator[Problem]:
    """Conflicts between phrases; paths are relative to their list."""
    entries = tuple(entries)
    loose = [index for index, entry in enumerate(entries) if not isinstance(entry, PhraseGroup)]
    for index in loose[KEYS_OF_A_GROUP : KEYS_OF_A_GROUP + 1]:
        yield (
            (index,),
            tr("more than {most} phrases without a group: there are only keys for {most}.").format(
                most=KEYS_OF_A_GROUP
            ),
        )
    titles: set[str] = set()
    phrase_by_key: dict[str, str] = {}
    for index, entry in enumerate(entries):
        if isinstance(entry, PhraseGroup):
            if entry.group.casefold() in titles:
                yield (index, "group"), tr("duplicate group '{group}'.").format(group=entry.group)
            titles.add(entry.group.casefold())
            inside: list[tuple[tuple[int | str, ...], str | Phrase]] = [
                ((index, "phrases", place), phrase) for place, phrase in enumerate(entry.phrases)
            ]
        else:
            inside = [((index,), entry)]
        for path, phrase in inside:
            if isinstance(phrase, Phrase) and phrase.key:
                if phrase.key in phrase_by_key:
                    taken = tr("the key {key} is already assigned to '{phrase}'.")
                    yield (*path, "key"), taken.format(key=phrase.key, phrase=phrase_by_key[phrase.key])
                phrase_by_key.setdefault(phrase.key, phrase.say)


NOD, LOOK = "nod", "look"
MOST_GESTURES = 6
KEYS_BY_PLACE = tuple(f"Ctrl+{number}" for number in range(4, 4 + MOST_GESTURES))
"""Of those that have no key of their own."""


class Gesture(Value):
    """A gesture with the name shown to the wizard."""

    title: str = setting(shortest=1, longest=40)
    """Text shown to the wizard."""
    does: str = setting(knows="gestures", shortest=1, longest=80)
    """`nod`, `look` to turn the head to the person addressed, or the id of a control of the Robot panel."""
    key: str = own_key()
    """Its own key, instead of the default key for its position."""


def gesture_problems(gestures: Iterable[Gesture], of_phrases: Iterable[str]) -> Iterator[Problem]:
    """Duplicate keys, including those ``of_phrases``; paths are relative to their list."""
    gestures = tuple(gestures)
    by_place = tr("the key {key} is already assigned to the gesture '{title}' by its position.")
    taken_text = tr("the key {key} is already assigned to the gesture '{title}'.")
    taken = {
        key: by_place.format(key=key, title=gesture.title)
        for key, gesture in zip(KEYS_BY_PLACE, gestures, strict=False)
        if not gesture.key
    }
    taken |= {key: tr("the key {key} is already assigned to a phrase.").format(key=key) for key in of_phrases}
    for index, gesture in enumerate(gestures):
        if gesture.key and gesture.key in taken:
            yield (index, "key"), taken[gesture.key]
        taken[gesture.key] = taken_text.format(key=gesture.key, title=gesture.title)
