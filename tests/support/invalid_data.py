"""Random mistakes in data of a YAML or JSON file."""

import copy
import random
from collections.abc import Sequence
from typing import Any

ODD_VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 1.5, 1e9, "", "robot", "/topic", "slider", "readout", "x" * 9000, [], ["a"], ["a", "a"],
    ["a"] * 200, [1, 2], [1, 2, 3], {}, {"panel": "map"}, {"tabs": ["map"], "current": "map"}, {"topic": "/a"},
    {"name": "a", "x_m": 0, "y_m": 0},
)  # fmt: skip


def with_mistake(data: dict[str, Any], rng: random.Random, more: Sequence[str]) -> dict[str, Any]:
    """Copy of ``data`` with one odd value, one removed key, or one of the ``more`` keys added at a random place."""
    data = copy.deepcopy(data)
    group: Any = data
    while True:
        key = rng.choice([*group]) if isinstance(group, dict) else rng.randrange(len(group))
        inner = group[key]
        if not isinstance(inner, (dict, list)) or not inner or rng.random() < 0.3:
            break
        group = inner
    mistake = rng.choice(["odd", "odd", "less", "more"])
    if mistake == "odd":
        group[key] = rng.choice(ODD_VALUES)
    elif mistake == "less":
        del group[key]
    elif isinstance(group, dict):
        group[rng.choice(more)] = rng.choice(ODD_VALUES)
    return data
