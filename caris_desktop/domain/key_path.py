"""Paths of keys in a file, and their text."""

KeyPath = tuple[str | int, ...]
Problem = tuple[KeyPath, str]
"""Path of a problem in a file, and its sentence."""


def name_of(path: KeyPath) -> str:
    """Path as in messages: ``'places[2].x_m'``, counted from 1."""
    text = ""
    for part in path:
        text += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if text else part
    return f"'{text}'"
