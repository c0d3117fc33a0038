"""Type hints as their readers need them, in whichever form a library or a Python version gives them."""

import types
import typing
from typing import Any, get_args, get_origin


def without_alias(hint: Any) -> Any:
    """The hint that an alias stands for; ``NDArray[np.float32]`` is one since numpy 2.5."""
    # Not by its class: Python has one since 3.12, and typing_extensions one of its own before.
    if hasattr(get_origin(hint), "__value__"):
        return without_alias(get_origin(hint).__value__[get_args(hint)])
    return without_alias(hint.__value__) if hasattr(hint, "__value__") else hint


def union_members(hint: Any) -> tuple[Any, ...]:
    """What a value may be where there is a choice, None as ``NoneType``; empty where there is none."""
    hint = without_alias(hint)
    if get_origin(hint) not in (types.UnionType, typing.Union):
        return ()
    members = (union_members(member) or (without_alias(member),) for member in get_args(hint))
    return tuple(dict.fromkeys(member for several in members for member in several))
