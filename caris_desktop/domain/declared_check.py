"""Data against their declaration: for each mistake where it is, what was found, and what is allowed."""

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from caris_desktop.domain.declared import (
    Form,
    Group,
    Problem,
    choices_of,
    form_of,
    group_meant,
    groups_of,
    is_group,
    item_of,
    keys_of,
)
from caris_desktop.domain.yaml_source import KeyPath

_KIND_WORDS = {str: "text", float: "a number", int: "a whole number", bool: "true or false"}
_GROUP_WORDS = "a group of 'key: value' lines"


def problems(hint: Any, data: Any, path: KeyPath = ()) -> Iterator[Problem]:
    """Every mistake in ``data``, which stand at ``path`` of their file."""
    return _problems(form_of(hint), data, path)


def _problems(form: Form, data: Any, path: KeyPath) -> Iterator[Problem]:
    groups = (form.kind,) if is_group(form.kind) else groups_of(form.kind)
    if form.foreign is not None:
        yield from form.foreign.problems(data, path)
    elif groups and not isinstance(data, dict):
        yield path, wrong_kind(_GROUP_WORDS, data, path)
    elif groups:
        yield from _group_problems(groups, data, path, form.rule.needs)
    elif (item := item_of(form.kind)) is not None:
        yield from _list_problems(form, item, data, path)
    elif sentence := _value_problem(form, data, path):
        yield path, sentence


def _group_problems(groups: tuple[Group, ...], data: Mapping[str, Any], path: KeyPath, needs: str) -> Iterator[Problem]:
    meant = group_meant(groups, data)
    keys = {key.name: key for group in (groups if meant is None else (meant,)) for key in keys_of(group)}
    misspelled = set()
    for name in data:
        if name not in keys:
            yield (*path, name), unknown_key(name, keys, data, path)
            misspelled.add(_key_meant(name, keys, data))
    missing = [key.name for key in keys.values() if key.required and key.name not in data]
    # A key that is there under a wrong name is told once.
    if missing and not misspelled.intersection(missing):
        yield path, needs or missing_keys(missing, path)
    for name, key in keys.items():
        if name in data:
            yield from _problems(key.form, data[name], (*path, name))


def _list_problems(form: Form, item: Form, data: Any, path: KeyPath) -> Iterator[Problem]:
    if not isinstance(data, (list, tuple)):
        yield path, wrong_kind("a list", data, path)
        return
    if sentence := _length_problem(form, data, "entries", path):
        yield path, sentence
    for index, entry in enumerate(data):
        if form.rule.unique and entry in data[:index]:
            yield (*path, index), f"{name_of(path)} lists {quoted(entry)} twice."
        yield from _problems(item, entry, (*path, index))


def _value_problem(form: Form, value: Any, path: KeyPath) -> str | None:
    name, rule = name_of(path), form.rule
    if choices := choices_of(form.kind):
        if any(value == choice and type(value) is type(choice) for choice in choices):
            return None
        noun = rule.noun or next((part for part in reversed(path) if isinstance(part, str)), "value")
        return f"unknown {noun} {quoted(value)}. {allowed_words(str(value), [str(choice) for choice in choices])}"
    if not _is_a(form.kind, value):
        return wrong_kind(_KIND_WORDS[form.kind], value, path)
    if isinstance(value, str):
        if rule.pattern and not re.search(rule.pattern, value):
            return f"{name} is {quoted(value)}. Allowed: {rule.allowed or rule.pattern}"
        return _length_problem(form, value, "characters", path)
    for limit, kept, words in (
        (rule.at_least, rule.at_least is None or value >= rule.at_least, "at least"),
        (rule.more_than, rule.more_than is None or value > rule.more_than, "more than"),
        (rule.at_most, rule.at_most is None or value <= rule.at_most, "at most"),
    ):
        if not kept:
            return f"{name} is {value}. Allowed: {words} {limit}."
    return None


def _length_problem(form: Form, data: Sequence[Any], unit: str, path: KeyPath) -> str | None:
    rule, name = form.rule, name_of(path)
    if len(data) < rule.shortest:
        found = "is empty" if not data else f"has {len(data)} {unit}"
        return f"{name} {found}." + (f" Allowed: at least {rule.shortest}." if rule.shortest > 1 else "")
    if rule.longest is not None and len(data) > rule.longest:
        return f"{name} has {len(data)} {unit}. Allowed: at most {rule.longest}."
    return None


def _is_a(kind: type[Any], value: Any) -> bool:
    if isinstance(value, bool) or kind is bool:
        return kind is bool and isinstance(value, bool)
    if kind is int:
        return isinstance(value, int) or (isinstance(value, float) and value.is_integer())
    return isinstance(value, (int, float) if kind is float else kind)


def wrong_kind(words: str, found: Any, path: KeyPath) -> str:
    """Something else stands where ``words`` were expected."""
    return f"{name_of(path)} must be {words}, found {quoted(found)}."


def unknown_key(name: str, known: Iterable[str], data: Mapping[str, Any], path: KeyPath) -> str:
    """A key that the group at ``path``, which holds ``data``, does not have."""
    known = sorted(known)
    return f"unknown key '{name}'{_within(path)}. Allowed: {', '.join(known)}.{_hint(_key_meant(name, known, data))}"


def _key_meant(name: str, known: Iterable[str], data: Mapping[str, Any]) -> str | None:
    """One that is not given yet, if any of those is near."""
    known = sorted(known)
    return _nearest(name, [key for key in known if key not in data]) or _nearest(name, known)


def missing_keys(names: list[str], path: KeyPath) -> str:
    """Keys that the group at ``path`` must have."""
    listed = " and ".join(f"'{name}'" for name in names)
    return f"{listed} {'is' if len(names) == 1 else 'are'} missing{_within(path)}."


def allowed_words(found: str, allowed: list[str]) -> str:
    """The allowed words, and which of them was probably meant."""
    return f"Allowed: {', '.join(allowed)}.{_hint(_nearest(found, allowed))}"


def _hint(meant: str | None) -> str:
    return "" if meant is None else f" Did you mean '{meant}'?"


def _nearest(found: str, allowed: list[str]) -> str | None:
    return next(iter(difflib.get_close_matches(found, allowed, n=1)), None)


def _within(path: KeyPath) -> str:
    return f" in {name_of(path)}" if path else ""


def name_of(path: KeyPath) -> str:
    """A place in a file as messages call it: ``'places[2].x_m'``, counted from 1."""
    text = ""
    for part in path:
        text += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if text else part
    return f"'{text}'"


def quoted(value: Any) -> str:
    """A value of a file as messages show it."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    text = repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."
