"""Gestures of a scenario: robot actions on one key (nod, look, or a control)."""

from collections.abc import Iterable, Iterator
from typing import Annotated

from caris_desktop.domain.key_path import Problem
from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import dataclass
from caris_desktop.scenario.own_key import own_key

NOD, LOOK = "nod", "look"
MOST_GESTURES = 6
KEYS_BY_PLACE = tuple(f"Ctrl+{number}" for number in range(4, 4 + MOST_GESTURES))
"""Of those that have no key of their own."""


@dataclass(frozen=True, slots=True)
class Gesture:
    """A gesture with the name shown to the wizard."""

    title: Annotated[str, FieldSpec("Text shown to the wizard.", shortest=1, longest=40)]
    does: Annotated[
        str,
        FieldSpec(
            "`nod`, `look` to turn the head to the person addressed, or the id of a control of the Robot panel.",
            knows="gestures",
            shortest=1,
            longest=80,
        ),
    ]
    key: Annotated[str, own_key("Its own key, instead of the default key for its position.")] = ""


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
