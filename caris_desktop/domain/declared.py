"""Files that people write are declared once: a frozen dataclass says what may stand in one, and all else follows.

Its fields are ``Annotated`` with a :class:`Rule`. From that come the check and its sentences (``declared_check``), the
values and what is written back (here), the JSON Schema for editors (``declared_schema``) and the guide's tables
(``declared_page``). A file may hold true, false, whole numbers, numbers, text, one of several words, lists, groups of
keys, and one of several groups.

No library: msgspec tells the first mistake only, sorts the allowed words and takes no union of dataclasses; pydantic
takes them, but its imports and schemas cost the first window 0.3 to 0.45 s on two slow cores, and these files 0.03.
"""

import functools
import math
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from typing import Annotated, Any, Literal, TypeAlias, get_args, get_origin

from caris_desktop.domain.yaml_source import KeyPath

Problem = tuple[KeyPath, str]
# A frozen dataclass that says which keys stand together.
Group: TypeAlias = Any


@dataclass(frozen=True, slots=True)
class Rule:
    """What holds at one place of a file beside its type, and what people are told of it.

    ``noun`` is what one of these is called in messages. Numbers are bounded by ``at_least``, ``more_than`` and
    ``at_most``; text (in characters) and lists (in entries) by ``shortest`` and ``longest``. ``allowed`` says in words
    what ``pattern`` means, ``needs`` what one of several groups must have. An entry of a ``unique`` list stands there
    once. A ``quiet`` value is not written while it is the default; ``wanted`` asks for a key that has one, in editors.
    Keys are written by ``order``, then as declared.
    """

    text: str = ""
    noun: str = ""
    unit: str = ""
    at_least: float | None = None
    more_than: float | None = None
    at_most: float | None = None
    shortest: int = 0
    longest: int | None = None
    pattern: str = ""
    allowed: str = ""
    needs: str = ""
    unique: bool = False
    quiet: bool = False
    wanted: bool = False
    order: int = 0


@dataclass(frozen=True, slots=True)
class Spread:
    """A value that stands in the file as the ``keys`` of another declaration, among those of its group."""

    keys: Group
    read: Callable[[Any], Any]
    write: Callable[[Any], Any]


@dataclass(frozen=True, slots=True)
class Foreign:
    """A value with a schema of its own; ``page`` is where the guide explains it."""

    schema: str
    page: str
    problems: Callable[[Any, KeyPath], Iterator[Problem]]
    read: Callable[[Any], Any]
    write: Callable[[Any], Any]


class NotInFile:
    """Marks what the program knows of a file and the file does not say."""


@dataclass(frozen=True, slots=True)
class Form:
    """What stands at one place: its type without annotations, the rules that hold there, and how it is written."""

    kind: Any
    rule: Rule = Rule()
    spread: Spread | None = None
    foreign: Foreign | None = None
    in_file: bool = True


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a group. ``default`` is ``dataclasses.MISSING`` where the key must be given."""

    name: str
    form: Form
    default: Any = MISSING

    @property
    def required(self) -> bool:
        return self.default is MISSING


def form_of(hint: Any) -> Form:
    """What an annotation declares. Outer rules go before inner ones; None means that the key is left out."""
    if get_origin(hint) is Annotated:
        inner, *marks = get_args(hint)
        return functools.reduce(_with_mark, marks, form_of(inner))
    if get_origin(hint) in (typing.Union, types.UnionType):
        members = [member for member in get_args(hint) if member is not type(None)]
        if len(members) == 1:
            return form_of(members[0])
    return Form(hint)


def _with_mark(form: Form, mark: Any) -> Form:
    match mark:
        case Rule():
            given = {each.name: getattr(mark, each.name) for each in fields(Rule)}
            said = {name: value for name, value in given.items() if value != getattr(_NO_RULE, name)}
            return replace(form, rule=replace(form.rule, **said))
        case Spread():
            return replace(form, spread=mark)
        case Foreign():
            return replace(form, foreign=mark)
        case NotInFile():
            return replace(form, in_file=False)
    return form


_NO_RULE = Rule()


def is_group(kind: Any) -> bool:
    """Whether it stands in the file as keys with values."""
    return isinstance(kind, type) and is_dataclass(kind)


def groups_of(kind: Any) -> tuple[Group, ...]:
    """The groups that may stand at one place; none where ``kind`` is not one of several groups."""
    members = get_args(kind) if get_origin(kind) in (typing.Union, types.UnionType) else ()
    return members if all(is_group(member) for member in members) else ()


def choices_of(kind: Any) -> tuple[Any, ...]:
    """The values of a Literal, in their order; else none."""
    return get_args(kind) if get_origin(kind) is Literal else ()


def item_of(kind: Any) -> Form | None:
    """What the entries of a list are; None where it is no list."""
    return form_of(get_args(kind)[0]) if get_origin(kind) is tuple else None


@functools.cache
def _attributes(group: Group) -> tuple[Key, ...]:
    """The attributes of a declaration that files know, in the order in which they are written."""
    hints = typing.get_type_hints(group, include_extras=True)
    found = []
    for each in fields(group):
        form = form_of(hints[each.name])
        default = each.default if each.default_factory is MISSING else each.default_factory()
        if form.in_file:
            found.append(Key(each.name, form, default))
    return tuple(sorted(found, key=lambda attribute: attribute.form.rule.order))


@functools.cache
def keys_of(group: Group) -> tuple[Key, ...]:
    """The keys of a group, in the order in which they are written."""
    found: list[Key] = []
    for attribute in _attributes(group):
        spread = attribute.form.spread
        found += [attribute] if spread is None else keys_of(spread.keys)
    return tuple(found)


def group_meant(groups: tuple[Group, ...], data: Mapping[str, Any]) -> Group | None:
    """Which of several groups has the keys of ``data``: by a required key if there is one, else by any."""
    for required in (True, False):
        for group in groups:
            if any(key.name in data and (key.required or not required) for key in keys_of(group)):
                return group
    return None


def value_from(hint: Any, data: Any) -> Any:
    """The value that checked ``data`` describe."""
    return _value(form_of(hint), data)


def _value(form: Form, data: Any) -> Any:
    if form.foreign is not None:
        return form.foreign.read(data)
    if is_group(form.kind):
        return _group_value(form.kind, data)
    if groups := groups_of(form.kind):
        meant = group_meant(groups, data)
        return _group_value(meant or groups[0], data)
    if (item := item_of(form.kind)) is not None:
        return tuple(_value(item, entry) for entry in data)
    return form.kind(data) if form.kind in (int, float) else data


def _group_value(group: Group, data: Mapping[str, Any]) -> Any:
    values = {}
    for attribute in _attributes(group):
        spread = attribute.form.spread
        if spread is not None:
            values[attribute.name] = spread.read(_group_value(spread.keys, data))
        elif attribute.name in data:
            values[attribute.name] = _value(attribute.form, data[attribute.name])
    return group(**values)


def data_of(hint: Any, value: Any) -> Any:
    """What a file says of ``value``, in plain data: the reverse of :func:`value_from`."""
    return _data(form_of(hint), value)


def _data(form: Form, value: Any) -> Any:
    if form.foreign is not None:
        return form.foreign.write(value)
    if is_group(type(value)):
        return _group_data(value)
    if (item := item_of(form.kind)) is not None:
        return [_data(item, entry) for entry in value]
    return plain_number(value) if isinstance(value, float) else value


def _group_data(value: Any) -> dict[str, Any]:
    data: dict[str, Any] = {}
    for attribute in _attributes(value.__class__):
        item, form = getattr(value, attribute.name), attribute.form
        if form.spread is not None:
            data |= _group_data(form.spread.write(item))
        elif item is not None and not (form.rule.quiet and item == attribute.default):
            data[attribute.name] = _data(form, item)
    return data


def plain_number(number: float) -> float | int:
    """Whole numbers without a point."""
    return int(number) if math.isfinite(number) and number == int(number) else number
