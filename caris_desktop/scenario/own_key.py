"""A key that a scenario gives to one of its phrases or gestures."""

_OF_TEXT_FIELDS = "ACVXYZ"
PATTERN = rf"^(Ctrl\+(?![{_OF_TEXT_FIELDS}]$)(Shift\+)?[A-Z0-9])?$"
ALLOWED = "Ctrl or Ctrl+Shift with a letter or digit, as Ctrl+G; not the keys with which text is edited."
