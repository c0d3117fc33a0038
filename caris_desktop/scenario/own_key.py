"""A key that a scenario gives to one of its phrases or gestures."""

from caris_desktop.domain.declared import Rule

_OF_TEXT_FIELDS = "ACVXYZ"
_PATTERN = rf"^(Ctrl\+(?![{_OF_TEXT_FIELDS}]$)(Shift\+)?[A-Z0-9])?$"
_ALLOWED = "Ctrl or Ctrl+Shift with a letter or digit, as Ctrl+G; not the keys with which text is edited."


def own_key(meaning: str) -> Rule:
    """How it is declared; ``meaning`` is what the key does there."""
    return Rule(meaning, pressed=True, pattern=_PATTERN, allowed=_ALLOWED, quiet=True)
