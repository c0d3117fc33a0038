"""Check of data against their declaration: location, finding and allowed values of each problem."""

import difflib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from caris_desktop.domain.schema_fields import (
    Group,
    Key,
    KeyPath,
    Problem,
    ValueForm,
    form_of,
    keys_of,
    matching_group,
    name_of,
)
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.yaml_files import LocatedData

MOST_TOLD = 5
_KIND_WORDS = {
    str: QT_TR_NOOP("text"), float: QT_TR_NOOP("a number"), int: QT_TR_NOOP("a whole number"),
    bool: QT_TR_NOOP("true or false"),
}  # fmt: skip
_GROUP_WORDS = QT_TR_NOOP("a group of 'key: value' lines")


def problem_lines(file_name: str, source: LocatedData, found: Iterable[Problem]) -> str:
    """First problems of a file with their lines, one per line."""
    located = sorted((source.line_of(path), message) for path, message in found)
    each = tr("{file}, line {line}: {problem}")
    lines = [each.format(file=file_name, line=line, problem=message) for line, message in located[:MOST_TOLD]]
    if len(located) > MOST_TOLD:
        lines.append(tr("... and {count} more.").format(count=len(located) - MOST_TOLD))
    return "\n".join(lines)


def problems(hint: Any, data: Any, path: KeyPath = ()) -> Iterator[Problem]:
    """Problems of ``data``, located at ``path`` in their file."""
    form = form_of(hint)
    if (text := form.text) is not None and not isinstance(data, dict):
        yield from problems(text, data, path)
        return
    groups = form.groups
    if (groups or form.is_free) and not isinstance(data, dict):
        yield path, _wrong_kind(tr(_GROUP_WORDS), data, path, form)
    elif groups:
        yield from _group_problems(groups, data, path, form)
    elif (item := form.item) is not None:
        yield from _list_problems(form, item, data, path)
    elif not form.is_free and (sentence := _value_problem(form, data, path)):
        yield path, sentence


def _group_problems(
    groups: tuple[Group, ...], data: Mapping[str, Any], path: KeyPath, form: ValueForm
) -> Iterator[Problem]:
    meant = matching_group(groups, data)
    keys = {key.name: key for group in (groups if meant is None else (meant,)) for key in keys_of(group)}
    misspelled = set()
    for name in data:
        if name not in keys:
            yield (*path, name), _unknown_key(name, keys, data, path)
            misspelled.add(_similar_key(name, keys, data))
    missing = [key.name for key in keys.values() if key.required and key.name not in data]
    some_of, needs = form.rule.some_of, form.rule.needs
    # A misspelled key is reported once.
    if missing and not misspelled.intersection(missing):
        yield path, tr(needs) if needs and not some_of else _missing_keys(missing, path)
    if some_of and not any(name in data for name in some_of) and not misspelled.intersection(some_of):
        yield path, tr(needs)
    for name, key in keys.items():
        if name in data:
            yield from problems(key.form, data[name], (*path, name))
        if name not in misspelled:
            yield from _neighbour_problems(key, keys, data, path, misspelled)


def _neighbour_problems(
    key: Key, keys: Mapping[str, Key], data: Mapping[str, Any], path: KeyPath, misspelled: set[str | None]
) -> Iterator[Problem]:
    """Problems of a key, or of its absence, with respect to other keys of its group."""
    name, rule, place = key.name, key.form.rule, (*path, key.name)
    if name in data:
        for other in rule.instead_of:
            if other in data:
                both = tr("{key} cannot be combined with '{other}': remove one of the two.")
                yield place, both.format(key=name_of(place), other=other)
        if rule.beside and rule.beside[0] not in misspelled and not _stands(rule.beside, keys, data):
            other = rule.beside[0]
            belongs = tr("{key} is allowed only with '{beside}', found {found}.")
            belongs = belongs if other in data else tr("{key} is allowed only with '{beside}', which is missing.")
            if other in data or not keys[other].required:
                found = quoted(data.get(other))
                yield place, belongs.format(key=name_of(place), beside=condition(rule.beside), found=found)
    elif rule.needed and _stands(rule.needed, keys, data, unsure=False):
        instead = [other.name for other in keys.values() if name in other.form.rule.instead_of]
        if not any(other in data or other in misspelled for other in instead):
            other, *words = rule.needed
            needed = either([f"'{each}'" for each in (name, *instead)])
            needs = tr("{key}: {found} also requires {needed}.") if words else ""
            needs = (needs or tr("{key} also requires {needed}.")).format(
                key=name_of((*path, other)), found=quoted(data[other]), needed=needed
            )
            yield (*path, other), f"{needs} {tr(rule.needs)}".rstrip()


def _stands(
    condition_words: tuple[str, ...], keys: Mapping[str, Key], data: Mapping[str, Any], *, unsure: bool = True
) -> bool:
    """Whether the key ``wanted[0]`` is present with one of the words after it; ``unsure`` if its
    value is not a word.
    """
    other, *words = condition_words
    if other not in data or not words:
        return other in data
    return data[other] in words if data[other] in keys[other].form.choices else unsure


def condition(condition_words: tuple[str, ...]) -> str:
    """A key, or a key with its possible words, for people."""
    other, *words = condition_words
    return f"{other}: {either(words)}" if words else other


def either(words: Sequence[str]) -> str:
    """Alternatives as running text."""
    *first, last = words
    return tr("{first} or {last}").format(first=", ".join(first), last=last) if first else last


def _list_problems(form: ValueForm, item: ValueForm, data: Any, path: KeyPath) -> Iterator[Problem]:
    if not isinstance(data, (list, tuple)):
        yield path, _wrong_kind(tr("a list"), data, path, form)
        return
    if sentence := _length_problem(form, data, tr("{key} has {count} entries."), path):
        yield path, sentence
    for index, entry in enumerate(data):
        if form.rule.unique and entry in data[:index]:
            yield (*path, index), tr("{key}: duplicate entry {entry}.").format(key=name_of(path), entry=quoted(entry))
        yield from problems(item, entry, (*path, index))


def _value_problem(form: ValueForm, value: Any, path: KeyPath) -> str | None:
    name, rule = name_of(path), form.rule
    if choices := form.choices:
        if any(value == choice and type(value) is type(choice) for choice in choices):
            return None
        if rule.pattern and isinstance(value, str) and re.search(rule.pattern, value):
            return None
        noun = rule.noun or next((part for part in reversed(path) if isinstance(part, str)), "value")
        unknown = tr("unknown {noun} {value}.").format(noun=tr(noun), value=quoted(value))
        words = [*map(str, choices), *([tr(rule.allowed)] if rule.pattern else ())]
        return f"{unknown} {allowed_words(str(value), words)}"
    kinds = form.scalars
    if not any(_is_a(kind, value) for kind in kinds):
        return _wrong_kind(either([tr(_KIND_WORDS[kind]) for kind in kinds]), value, path, form)
    if isinstance(value, str):
        if rule.pattern and not re.search(rule.pattern, value):
            return f"{_found(name, quoted(value))} {_allowed(tr(rule.allowed) or rule.pattern)}"
        return _length_problem(form, value, tr("{key} has {count} characters."), path)
    for limit, satisfied, allowed in (
        (rule.at_least, rule.at_least is None or value >= rule.at_least, tr("Allowed: at least {limit}.")),
        (rule.more_than, rule.more_than is None or value > rule.more_than, tr("Allowed: more than {limit}.")),
        (rule.at_most, rule.at_most is None or value <= rule.at_most, tr("Allowed: at most {limit}.")),
    ):
        if not satisfied:
            return f"{_found(name, str(value))} {allowed.format(limit=limit)}"
    return None


def _found(key: str, value: str) -> str:
    return tr("{key} is {value}.").format(key=key, value=value)


def _allowed(words: str) -> str:
    """Allowed values; ``words`` may be the end of a sentence or lack its full stop."""
    return tr("Allowed: {words}").format(words=words)


def _length_problem(form: ValueForm, data: Sequence[Any], found: str, path: KeyPath) -> str | None:
    """Problem of the length; ``found`` is a text with placeholders ``key`` and ``count``."""
    least, most = form.size
    if len(data) >= least and (most is None or len(data) <= most):
        return None
    found = (found if data else tr("{key} is empty.")).format(key=name_of(path), count=len(data))
    if not data and least <= 1:
        return found
    if least == most:
        return f"{found} {_allowed(f'{least}.')}"
    allowed = tr("Allowed: at least {limit}.") if len(data) < least else tr("Allowed: at most {limit}.")
    return f"{found} {allowed.format(limit=least if len(data) < least else most)}"


def _is_a(kind: type[Any], value: Any) -> bool:
    if isinstance(value, bool) or kind is bool:
        return kind is bool and isinstance(value, bool)
    if kind is int:
        return isinstance(value, int) or (isinstance(value, float) and value.is_integer())
    return isinstance(value, (int, float) if kind is float else kind)


def _wrong_kind(words: str, found: Any, path: KeyPath, form: ValueForm) -> str:
    must = tr("{key} must be {kind}, found {found}.").format(key=name_of(path), kind=words, found=quoted(found))
    return f"{must} {_allowed(tr(form.rule.allowed))}" if form.rule.allowed else must


def _unknown_key(name: str, known: Iterable[str], data: Mapping[str, Any], path: KeyPath) -> str:
    known = sorted(known)
    unknown = tr("unknown key '{name}' in {place}.") if path else tr("unknown key '{name}'.")
    allowed = _allowed(f"{', '.join(known)}.")
    return f"{unknown.format(name=name, place=name_of(path))} {allowed}{_hint(_similar_key(name, known, data))}"


def _similar_key(name: str, known: Iterable[str], data: Mapping[str, Any]) -> str | None:
    """Similar known key, preferably one that is missing."""
    known = sorted(known)
    return _nearest(name, [key for key in known if key not in data]) or _nearest(name, known)


def _missing_keys(names: list[str], path: KeyPath) -> str:
    *first, last = [f"'{name}'" for name in names]
    if not first:
        missing = tr("{name} is missing in {place}.") if path else tr("{name} is missing.")
        return missing.format(name=last, place=name_of(path))
    missing = tr("{first} and {last} are missing in {place}.") if path else tr("{first} and {last} are missing.")
    return missing.format(first=", ".join(first), last=last, place=name_of(path))


def allowed_words(found: str, allowed: list[str]) -> str:
    """Allowed words, and a suggestion of the one meant."""
    return f"{_allowed(', '.join(allowed) + '.')}{did_you_mean(found, allowed)}"


def did_you_mean(found: str, allowed: list[str]) -> str:
    """Suggestion to append to a message, or empty."""
    return _hint(_nearest(found, allowed))


def _hint(meant: str | None) -> str:
    return "" if meant is None else " " + tr("Did you mean '{word}'?").format(word=meant)


def _nearest(found: str, allowed: list[str]) -> str | None:
    return next(iter(difflib.get_close_matches(found, allowed, n=1)), None)


def quoted(value: Any) -> str:
    """Value of a file for messages; passwords in addresses are removed."""
    if value is None:
        return tr("nothing")
    if isinstance(value, bool):
        return "true" if value else "false"
    text = re.sub(r"//[^/@\s]*@", "//...@", repr(value) if isinstance(value, str) else str(value))
    return text if len(text) <= 60 else text[:57] + "..."


# Migration of files of older versions, one version at a time.

# Converts data of one version to the next. A released migration never changes.
Migration = Callable[[dict[str, Any]], dict[str, Any]]


def migrated(data: dict[str, Any], migrations: Mapping[int, Migration], *, version: int, newest: int) -> dict[str, Any]:
    """Copy of ``data`` migrated from ``version`` to ``newest``."""
    raised = dict(data)
    for step in range(version, newest):
        raised = migrations[step](dict(raised))
        raised["version"] = step + 1
    return raised
