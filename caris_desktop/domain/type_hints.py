"""Type hints, normalised across libraries and Python versions."""

import types
import typing
from typing import Any, get_args, get_origin


def without_alias(hint: Any) -> Any:
    """Hint behind an alias; ``NDArray[np.float32]`` is one since numpy 2.5."""
    # Not by its class: Python has one since 3.12, and typing_extensions its own before.
    if hasattr(get_origin(hint), "__value__"):
        return without_alias(get_origin(hint).__value__[get_args(hint)])
    return without_alias(hint.__value__) if hasattr(hint, "__value__") else hint


def union_members(hint: Any) -> tuple[Any, ...]:
    """Members of a union, None as ``NoneType``; empty if it is none."""
    hint = without_alias(hint)
    if get_origin(hint) not in (types.UnionType, typing.Union):
        return ()
    members = (union_members(member) or (without_alias(member),) for member in get_args(hint))
    return tuple(dict.fromkeys(member for several in members for member in several))
