"""Data with a mistake in them, of every kind that somebody could make."""

import copy
import random
from collections.abc import Sequence
from typing import Any

ODD: tuple[Any, ...] = (
    None, True, 0, -1, 1.5, 1e9, "", "robot", "/topic", "slider", "readout", "x" * 9000, [], ["a"], ["a", "a"],
    ["a"] * 200, [1, 2], [1, 2, 3], {}, {"panel": "map"}, {"tabs": ["map"], "current": "map"}, {"topic": "/a"},
    {"name": "a", "x_m": 0, "y_m": 0},
)  # fmt: skip


def changed(data: dict[str, Any], chance: random.Random, more: Sequence[str]) -> dict[str, Any]:
    """``data`` with one odd value, one key less, or one of ``more`` keys somewhere."""
    data = copy.deepcopy(data)
    place: Any = data
    while True:
        key = chance.choice([*place]) if isinstance(place, dict) else chance.randrange(len(place))
        inner = place[key]
        if not isinstance(inner, (dict, list)) or not inner or chance.random() < 0.3:
            break
        place = inner
    what = chance.choice(["odd", "odd", "less", "more"])
    if what == "odd":
        place[key] = chance.choice(ODD)
    elif what == "less":
        del place[key]
    elif isinstance(place, dict):
        place[chance.choice(more)] = chance.choice(ODD)
    return data
