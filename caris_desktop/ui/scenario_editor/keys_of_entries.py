"""Key bindings of list entries in the console, for display in the form."""

from typing import Any

from caris_desktop.domain.key_path import KeyPath
from caris_desktop.domain.schema_paths import value_at
from caris_desktop.ui.action_rows import ACTIONS

_KEYS = {spec.id: spec.keys[0] for spec in ACTIONS if spec.keys}


def key_of_entry(data: Any, path: KeyPath) -> str:
    """Key of the entry; empty if none."""
    match path:
        case ("phrases", int(index)):
            entries = value_at(data, ("phrases",))
            if not isinstance(entries, list) or not 0 <= index < len(entries) or "group" in _keys_in(entries[index]):
                return ""
            return _KEYS.get(f"phrase_{sum('group' not in _keys_in(each) for each in entries[: index + 1])}", "")
        case ("phrases", int(), "phrases", int(index)):
            return _KEYS.get(f"phrase_{index + 1}", "")
        case ("recording", "labels", int(index)):
            return _KEYS.get(f"label_{index + 1}", "")
        case ("gestures", int(index)):
            own = _keys_in(value_at(data, path)).get("key")
            return str(own) if own else _KEYS.get(f"gesture_{index + 1}", "")
        case ("places", int(index)):
            return _KEYS.get(f"place_{index + 1}", "")
    return ""


def _keys_in(entry: Any) -> Any:
    return entry if isinstance(entry, dict) else {}
