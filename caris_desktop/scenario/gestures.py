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
    """A gesture by the name that the wizard reads."""

    title: Annotated[str, FieldSpec("What the wizard reads.", shortest=1, longest=40)]
    does: Annotated[
        str,
        FieldSpec(
            "`nod`, `look` to turn the head to whom the robot speaks to, or a control of the Robot panel by its id.",
            knows="gestures",
            shortest=1,
            longest=80,
        ),
    ]
    key: Annotated[str, own_key("A key of its own, instead of the one that it has by its place.")] = ""


def gesture_problems(gestures: Iterable[Gesture], of_phrases: Iterable[str]) -> Iterator[Problem]:
    """Duplicate keys, including those ``of_phrases``; paths are relative to their list."""
    gestures = tuple(gestures)
    by_place = tr("the key {key} is already that of the gesture '{title}' by its place.")
    its_own = tr("the key {key} is already that of the gesture '{title}'.")
    taken = {
        key: by_place.format(key=key, title=gesture.title)
        for key, gesture in zip(KEYS_BY_PLACE, gestures, strict=False)
        if not gesture.key
    }
    taken |= {key: tr("the key {key} already says a phrase.").format(key=key) for key in of_phrases}
    for index, gesture in enumerate(gestures):
        if gesture.key and gesture.key in taken:
            yield (index, "key"), taken[gesture.key]
        taken[gesture.key] = its_own.format(key=gesture.key, title=gesture.title)
