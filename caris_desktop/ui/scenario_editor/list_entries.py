"""List entries: names, kinds that can be added, and which fit into a row."""

from collections.abc import Callable
from typing import Any

from caris_desktop.domain.schema_fields import (
    Group,
    ValueForm,
    groups_of,
    is_free,
    is_group,
    keys_of,
    scalars_of,
    text_of,
)
from caris_desktop.domain.schema_labels import noun_of
from caris_desktop.domain.schema_paths import blank_group, blank_of, entry_name
from caris_desktop.domain.translation import tr

_MOST_IN_A_ROW = 5


def card_name(entry: Any) -> str:
    """Title of a folded entry: its name, else its contents, as for a part of the dock layout."""
    if not isinstance(entry, dict):
        return entry if isinstance(entry, str) else ""
    if entry_name(entry):
        return entry_name(entry)
    inside = [card_name(each) for value in entry.values() if isinstance(value, list) for each in value]
    return ", ".join(name for name in inside if name) or next(
        (str(value) for value in entry.values() if isinstance(value, str)), ""
    )


def in_one_row(group: Group) -> bool:
    """Whether the keys are few and short enough for one row."""
    keys = keys_of(group)
    return len(keys) <= _MOST_IN_A_ROW and all(
        scalars_of(key.form.kind) and not key.form.rule.prose and not is_free(key.form.kind) for key in keys
    )


def kinds_of_entries(item: ValueForm) -> list[tuple[str, Callable[[], Any]]]:
    """Kinds of entries that can be added, with factories of initial values."""
    groups = (item.kind,) if is_group(item.kind) else groups_of(item.kind)
    if not groups:
        return [(tr("an entry"), lambda: blank_of(item))]
    text = text_of(item.kind)
    kinds: list[tuple[str, Callable[[], Any]]] = []
    for number, group in enumerate(groups):
        blank: Callable[[], Any] = (lambda: "") if text is not None and number == 0 else _blank_of_group(item, group)
        kinds.append((noun_of(group), blank))
    return kinds


def _blank_of_group(item: ValueForm, group: Group) -> Callable[[], Any]:
    return (lambda: blank_of(item)) if is_group(item.kind) else (lambda: blank_group(group))
