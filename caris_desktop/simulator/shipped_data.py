"""Data files of the simulator."""

from dataclasses import is_dataclass
from enum import EnumType
from itertools import cycle
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

import yaml

from caris_desktop.domain.schema_fields import union_members
from caris_desktop.domain.shipped import resources_dir

# Some 20 times as fast as parse_yaml, which is for texts of users and refuses references.
_Fastest: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def shipped_file(name: str) -> Path:
    """Path of a file of ``resources/simulator``."""
    return resources_dir() / "simulator" / name


def shipped_data(name: str) -> Any:
    """Content of a YAML file of ``resources/simulator``."""
    return yaml.load(shipped_file(name).read_text("utf-8"), _Fastest)  # noqa: S506 - a safe loader


def built(kind: Any, data: Any) -> Any:
    """Value of ``kind`` from plain data; a dataclass from a mapping, or from a list in the order of its fields."""
    if data is None:
        return None
    members = [member for member in union_members(kind) if member is not NoneType]
    if members and isinstance(data, dict):
        kind = next(member for member in members if data.keys() <= get_type_hints(member).keys())
    elif members:
        (kind,) = members
    if get_origin(kind) is tuple:
        kinds = [each for each in get_args(kind) if each is not Ellipsis]
        return tuple(built(item_kind, item) for item_kind, item in zip(cycle(kinds), data, strict=False))
    if isinstance(kind, type) and is_dataclass(kind):
        hints = get_type_hints(kind)
        if isinstance(data, list) and len(data) > len(hints):
            raise ValueError(f"{kind.__name__} has {len(hints)} fields: {data}")
        named = dict(zip(hints, data, strict=False)) if isinstance(data, list) else data
        return kind(**{name: built(hints[name], value) for name, value in named.items()})
    return kind(data) if isinstance(kind, EnumType) else data
