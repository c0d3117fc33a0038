"""Paths in a declared file: value, form, title and default at each."""

import inspect
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import MISSING
from typing import Any

from caris_desktop.domain.schema_fields import (
    FieldSpec,
    Group,
    Key,
    KeyPath,
    ValueForm,
    data_of,
    form_of,
    is_group,
    keys_of,
    leaves,
)
from caris_desktop.domain.schema_json import description_of
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value

_UNIT = re.compile(r"_(s|ms|m|mps|radps|px|deg|rad)$")


def title_of(key: Key) -> str:
    """Title of the key in a form."""
    title = _title(key)
    return tr(title)


def said_of(form: ValueForm) -> str:
    """Description; empty without one."""
    description = description_of(form)
    return tr(description)


def allowed_by(form: ValueForm) -> str:
    """Allowed values in words; empty without them."""
    return tr(form.rule.allowed)


def unit_of(form: ValueForm) -> str:
    return tr(form.rule.unit)


def section_of(key: Key) -> str:
    return tr(key.form.rule.section)


def noun_of(group: Group) -> str:
    """Noun for such a group."""
    noun = _noun(group)
    return tr(noun)


def words_of(group: Group) -> str:
    """Short description of such a group."""
    words = _first_words(group)
    return tr(words)


def word_of(choice: Any) -> str:
    """Selectable word for people."""
    word = _word(choice)
    return tr(word)


def texts_of(declaration: Group) -> list[str]:
    """All texts above of a declaration, untranslated."""
    return list(dict.fromkeys(text for text in _texts(form_of(declaration), set()) if text))


def _texts(form: ValueForm, seen: set[Any]) -> Iterator[str]:
    yield from (description_of(form), form.rule.allowed, form.rule.unit, form.rule.needs, form.rule.noun)
    yield from (_word(choice) for choice in (*form.choices, *form.rule.else_one_of))
    if (item := form.item) is not None:
        yield from _texts(item, seen)
    for group in form.groups:
        if group not in seen:
            seen.add(group)
            yield from (_noun(group), _first_words(group))
            for key in keys_of(group):
                yield from (_title(key), key.form.rule.section)
                yield from _texts(key.form, seen)


def _title(key: Key) -> str:
    words = _UNIT.sub("", key.name).replace("_", " ")
    return key.form.rule.title or words[:1].upper() + words[1:]


def _noun(group: Group) -> str:
    name = re.sub(r"(Settings|Keys|Node|Leaf|Entry)$", "", group.__name__).strip("_")
    return re.sub(r"(?<!^)(?=[A-Z])", " ", name).lower()


def _first_words(group: Group) -> str:
    docstring = " ".join((inspect.getdoc(group) or "").split())
    return re.split(r"[.,;:]", docstring)[0]


def _word(choice: Any) -> str:
    words = str(choice).replace("_", " ")
    return words[:1].upper() + words[1:]


ABSENT = MISSING
"""Marker of a missing value."""
_NAMING_KEYS = ("title", "name", "group", "say", "id", "source", "text")


class Difference(Value):
    """Difference of two files at one place; ``ABSENT`` if one has no value."""

    path: KeyPath
    before: Any
    after: Any


def text_key(group: Group) -> str:
    """Key that a text in place of the group represents: the first."""
    return keys_of(group)[0].name


def form_at(hint: Any, data: Any, path: KeyPath) -> ValueForm:
    """Form declared at ``path``, given the ``data`` of the whole file. Raises KeyError if there is none."""
    form = form_of(hint)
    for part in path:
        if isinstance(part, int):
            if form.item is None:
                raise KeyError(part)
            form = form.item
        else:
            form = key_of(form, data, part).form
        data = value_at(data, (part,))
    return form


def key_of(form: ValueForm, data: Any, name: str) -> Key:
    """Key of that name in a group. Raises KeyError."""
    groups = [group] if (group := form.group_at(data)) is not None else list(form.alternatives)
    for group in groups:
        for key in keys_of(group):
            if key.name == name:
                return key
    raise KeyError(name)


def value_at(data: Any, path: KeyPath) -> Any:
    """Value at ``path``; ABSENT if missing."""
    for part in path:
        listed = isinstance(data, list) and isinstance(part, int) and 0 <= part < len(data)
        if not (listed or (isinstance(data, Mapping) and part in data)):
            return ABSENT
        data = data[part]
    return data


def default_of(key: Key) -> Any:
    """Default of a missing key, as data; ABSENT without one."""
    if key.default is MISSING or key.default is None:
        return ABSENT
    return data_of(key.form, key.default)


def blank_of(form: ValueForm) -> Any:
    """Initial content of a new list entry or group: required keys with minimal values."""
    if form.text is not None:
        return ""
    if form.groups:
        return blank_group(form.groups[0], form.rule.some_of[:1])
    if form.item is not None:
        return [blank_of(form.item) for _ in range(form.size[0])]
    if form.is_free:
        return {}
    if choices := form.choices:
        return choices[0]
    kind = form.scalars[0]
    if kind in (int, float):
        at_least = form.rule.at_least if form.rule.more_than is None else form.rule.more_than + 1
        return max(0, math.ceil(at_least or 0))
    return False if kind is bool else ""


def blank_group(group: Group, besides: tuple[str, ...] = ()) -> dict[str, Any]:
    """Group with its required keys and ``besides`` only."""
    return {
        key.name: blank_of(key.form) if (default := default_of(key)) is ABSENT else default
        for key in keys_of(group)
        if key.required or key.name in besides
    }


def with_value_at(data: Any, path: KeyPath, value: Any) -> Any:
    """Copy of ``data`` with ``value`` at ``path``; missing groups are created."""
    if not path:
        return value
    part, *rest = path
    if isinstance(data, list):
        return [with_value_at(each, tuple(rest), value) if number == part else each for number, each in enumerate(data)]
    known = dict(data) if isinstance(data, Mapping) else {}
    known[str(part)] = with_value_at(known.get(str(part)), tuple(rest), value)
    return known


def without_at(data: Any, path: KeyPath) -> Any:
    """Copy of ``data`` without the value at ``path``."""
    part, *rest = path
    if rest:
        return with_value_at(data, (part,), without_at(value_at(data, (part,)), tuple(rest)))
    if isinstance(data, list):
        return [each for number, each in enumerate(data) if number != part]
    return {name: each for name, each in data.items() if name != part}


def differences(hint: Any, before: Any, after: Any, path: KeyPath = ()) -> Iterator[Difference]:
    """Differences of two files at the level that a person would name: keys, and entries of lists of equal length, else
    the whole list. A missing key equals its default.
    """
    form = form_of(hint)
    if before == after and before is not ABSENT:
        return
    if form.text is not None and isinstance(before, Mapping) is not isinstance(after, Mapping):
        before, after = (_as_group(form, each) for each in (before, after))
    item, groups = form.item, (form.group_at(before), form.group_at(after))
    if isinstance(before, Mapping) and isinstance(after, Mapping) and groups[0] is groups[1] and groups[0] is not None:
        for key in keys_of(groups[0]):
            old, new = before.get(key.name, ABSENT), after.get(key.name, ABSENT)
            if is_group(key.form.kind) and not key.form.written_as:
                old, new = ({} if each is ABSENT else each for each in (old, new))
            yield from _key_differences(key, old, new, (*path, key.name))
    elif item is not None and isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for number, (old, new) in enumerate(zip(before, after, strict=True)):
            yield from differences(item, old, new, (*path, number))
    else:
        yield Difference(path, before, after)


def _as_group(form: ValueForm, data: Any) -> Any:
    """Group form of a text in its place."""
    group = form.group_at(data)
    return {text_key(group): data} if isinstance(data, str) and group is not None else data


def _key_differences(key: Key, before: Any, after: Any, path: KeyPath) -> Iterator[Difference]:
    default = default_of(key)
    # Empty text and an empty list equal a missing key.
    old, new = (default if each is ABSENT else each for each in (before, after))
    if old == new:
        return
    if before is not ABSENT and after is not ABSENT:
        yield from differences(key.form, before, after, path)
    else:
        yield Difference(path, before, after)


def references(hint: Any, data: Any) -> Iterator[tuple[KeyPath, FieldSpec, str]]:
    """References to entries of the file's own lists: path, rule and name."""
    for path, form, value in leaves(hint, data):
        if form.rule.refers and isinstance(value, str):
            yield path, form.rule, value


def called(hint: Any, data: Any, path: KeyPath) -> list[str]:
    """Breadcrumbs of a path for people: titles of keys and names of entries."""
    form, labels = form_of(hint), []
    for part in path:
        try:
            if isinstance(part, int):
                form = form.item or form
                labels.append(entry_name(value_at(data, (part,))) or str(part + 1))
            else:
                key = key_of(form, data, part)
                labels.append(title_of(key))
                form = key.form
        except KeyError:
            labels.append(str(part))
        data = value_at(data, (part,))
    return labels


def entry_name(entry: Any) -> str:
    """Name that distinguishes an entry of a list."""
    if isinstance(entry, Mapping):
        found = next((entry[name] for name in _NAMING_KEYS if name in entry), "")
        return str(found)
    return "" if entry is ABSENT or isinstance(entry, list) else str(entry)
