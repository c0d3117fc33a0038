"""Wizard profiles: settings per wizard, such as key bindings, recent palette items, dock layouts and
training results.
"""

import json
from typing import Any
from urllib.parse import quote

from PySide6.QtCore import QObject, Signal

from caris_desktop.ui.window_place import Settings

_NAMES_KEY = "wizards/names"
_CURRENT_KEY = "wizards/current"
_NOBODY = "*"  # not the quoted form of any name
LONGEST_NAME = 120


class WizardProfiles(QObject):
    """``current`` is the wizard's name, empty for the default profile; ``changed`` reports a switch.

    Values that a wizard has not set come from the default profile, so that naming a wizard loses no settings. Names are
    case-insensitive. Without ``settings``, values last for this run.
    """

    changed = Signal()

    def __init__(self, settings: Settings | None, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._settings: Settings = settings if settings is not None else _Forgetful()
        self._names = _read_names(self._settings)
        self._current = self._known(_tidied(str(self._settings.value(_CURRENT_KEY, "") or "")))

    @property
    def current(self) -> str:
        return self._current

    @property
    def names(self) -> tuple[str, ...]:
        """All known wizards, in alphabetical order."""
        return tuple(sorted(self._names, key=str.casefold))

    def choose(self, name: str) -> None:
        """Switch to a wizard, adding a new name; empty for the default profile."""
        chosen = self._known(_tidied(name))
        if chosen and chosen not in self._names:
            self._names.append(chosen)
            self._settings.setValue(_NAMES_KEY, json.dumps(self._names))
        if chosen != self._current:
            self._current = chosen
            self._settings.setValue(_CURRENT_KEY, chosen)
            self.changed.emit()

    def value(self, key: str, default: Any = None) -> Any:
        """Value set by this wizard, else that of the default profile."""
        value = self._settings.value(self._place(key))
        return value if value is not None else self._settings.value(f"wizards/{_NOBODY}/{key}", default)

    def own_value(self, key: str, default: Any = None) -> Any:
        """Value set by this wizard only, for personal data such as training results."""
        return self._settings.value(self._place(key), default)

    def set_value(self, key: str, value: Any) -> None:
        self._settings.setValue(self._place(key), value)

    def _place(self, key: str) -> str:
        # Settings treat a slash as a group, and some systems ignore case.
        return f"wizards/{quote(self._current.casefold(), safe=' ') or _NOBODY}/{key}"

    def _known(self, name: str) -> str:
        return next((known for known in self._names if known.casefold() == name.casefold()), name)


class _Forgetful:
    def __init__(self) -> None:
        self._values: dict[str, Any] = {}

    def value(self, key: str, defaultValue: Any = None) -> Any:  # noqa: N803
        return self._values.get(key, defaultValue)

    def setValue(self, key: str, value: Any) -> None:
        self._values[key] = value


def _tidied(name: str) -> str:
    return " ".join(name.split())[:LONGEST_NAME].strip()


def _read_names(settings: Settings) -> list[str]:
    try:
        names = json.loads(str(settings.value(_NAMES_KEY, "[]")))
    except (ValueError, RecursionError):
        return []
    known: dict[str, str] = {}
    for name in names if isinstance(names, list) else ():
        if isinstance(name, str) and _tidied(name):
            known.setdefault(_tidied(name).casefold(), _tidied(name))
    return list(known.values())
