"""Consequences of a permission, derived from the tables of intents, actions and panels."""

from collections.abc import Iterator
from functools import cache
from typing import Any, Literal

from caris_desktop.domain.intents import INTENTS, Intent
from caris_desktop.domain.value_class import dataclass
from caris_desktop.scenario.scenario_model import Permissions
from caris_desktop.ui.action_rows import ACTIONS
from caris_desktop.ui.action_spec import ActionSpec
from caris_desktop.ui.panel_table import PANELS

Sort = Literal["panel", "key", "act"]


@dataclass(frozen=True, slots=True)
class Consequence:
    """Feature that requires a permission."""

    sort: Sort
    words: str
    key: str = ""


@cache
def consequences(permission: str) -> tuple[Consequence, ...]:
    """Features that this permission alone removes: panels, commands with keys, other intents."""
    return tuple(dict.fromkeys(_found(permission)))


def _found(permission: str) -> Iterator[Consequence]:
    for panel in PANELS.values():
        if panel.permission == permission:
            yield Consequence("panel", panel.title)
    asked_by_key = set()
    for spec in ACTIONS:
        intent = _intent_of(spec)
        needed = INTENTS[intent].permissions if intent is not None else ()
        if spec.permission == permission or permission in needed:
            asked_by_key.add(intent)
            yield Consequence("key", spec.text, spec.keys[0] if spec.keys else "")
    for intent, line in INTENTS.items():
        if permission in line.permissions and intent not in asked_by_key:
            yield Consequence("act", line.words)


def _intent_of(spec: ActionSpec) -> type[Intent] | None:
    return type(spec.intent) if isinstance(spec.intent, Intent) else None


def changed_permissions(before: Permissions, after: Permissions) -> list[tuple[str, bool]]:
    """Changed permissions with their new values."""
    names: Any = Permissions.__dataclass_fields__
    return [(name, getattr(after, name)) for name in names if getattr(before, name) != getattr(after, name)]
