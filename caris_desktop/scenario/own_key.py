"""Keys assigned to phrases and gestures in a scenario."""

from caris_desktop.domain.schema_fields import FieldSpec

_OF_TEXT_FIELDS = "ACVXYZ"
_PATTERN = rf"^(Ctrl\+(?![{_OF_TEXT_FIELDS}]$)(Shift\+)?[A-Z0-9])?$"
_ALLOWED = "Ctrl or Ctrl+Shift with a letter or digit, such as Ctrl+G; not the keys for editing text."


def own_key(meaning: str) -> FieldSpec:
    """Field declaration; ``meaning`` is the key's function."""
    return FieldSpec(meaning, pressed=True, pattern=_PATTERN, allowed=_ALLOWED, quiet=True)
