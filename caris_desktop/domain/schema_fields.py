"""Declared files: a frozen dataclass per file format, from which checks, schema and tables follow.

Fields are made by ``setting``, and explained by the docstring that follows them, or ``Annotated`` with a
:class:`FieldSpec`. They determine the check and its sentences (``schema_validation``),
values and write-back (here), the JSON Schema for editors (``schema_json``) and the guide's tables (``schema_docs``). A
file may contain booleans, whole numbers, numbers, text, one of several words, lists of any or fixed length, groups of
keys, one of several groups, text or one of several groups, and groups with undeclared keys (messages of a robot).

No library: msgspec reports the first problem only, sorts the allowed words and accepts no union of dataclasses;
pydantic does, but its imports and schemas delay the first window by 0.3 to 0.45 s on two slow cores, this module by
0.03.
"""

import functools
import math
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from typing import Annotated, Any, Literal, TypeAlias, get_args, get_origin

from caris_desktop.domain.value_class import Value

KeyPath = tuple[str | int, ...]
Problem = tuple[KeyPath, str]
"""Path of a problem in a file, and its sentence."""


def name_of(path: KeyPath) -> str:
    """Path as in messages: ``'places[2].x_m'``, counted from 1."""
    text = ""
    for part in path:
        text += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if text else part
    return f"'{text}'"


# Type hints, normalised across libraries and Python versions.


def without_alias(hint: Any) -> Any:
    """Hint behind an alias; ``NDArray[np.float32]`` is one since numpy 2.5."""
    # Not by its class: Python has one since 3.12, and typing_extensions its own before.
    if hasattr(get_origin(hint), "__value__"):
        return without_alias(get_origin(hint).__value__[get_args(hint)])
    return without_alias(hint.__value__) if hasattr(hint, "__value__") else hint


def union_members(hint: Any) -> tuple[Any, ...]:
    """Members of a union, None as ``NoneType``; empty if it is none."""
    hint = without_alias(hint)
    if get_origin(hint) not in (types.UnionType, typing.Union):
        return ()
    members = (union_members(member) or (without_alias(member),) for member in get_args(hint))
    return tuple(dict.fromkeys(member for several in members for member in several))


@functools.cache
def literals_of(kind: Any) -> Mapping[str, frozenset[str]]:
    """Fields of a value, and of the values in it, each with the words of the program that it may have."""
    found: dict[str, frozenset[str]] = {}
    waiting, seen = [kind], set[type[Any]]()
    while waiting:
        one = waiting.pop()
        if one in seen:
            continue
        seen.add(one)
        for name, hint in typing.get_type_hints(one).items():
            found.setdefault(name, frozenset())
            hints = [without_alias(hint)]
            while hints:
                each = hints.pop()
                if get_origin(each) is Literal:
                    found[name] |= set(map(str, get_args(each)))
                elif isinstance(each, type) and issubclass(each, Value):
                    waiting.append(each)
                else:
                    hints += union_members(each) or get_args(each)
    return found


Known = Literal["gestures", "expressions", "robots", "faces", "trackers"]
External = Literal[
    "address", "camera", "language_model", "model", "network", "panel", "path", "robot", "recogniser", "tracker",
    "variable", "voice",
]  # fmt: skip
"""How a value refers to something outside its file, which the user confirms before use."""

# A frozen dataclass of the keys in one group.
Group: TypeAlias = Any


class FieldSpec(Value):
    """Constraints of one place of a file in addition to its type, and its texts for people.

    ``noun`` is the name of one such value in messages. Numbers are bounded by ``at_least``, ``more_than`` and
    ``at_most``; text (in characters) and lists (in entries) by ``shortest`` and ``longest``. ``allowed`` says in words
    what ``pattern`` means; beside words of a Literal, what else is allowed. An entry of a ``unique`` list occurs
    once. A ``quiet`` value is not written while it is the default; a ``wanted`` one must be given despite its
    default. Keys are written by ``order``, then as declared, and called ``key`` if the file has another word than
    the program. Forms use its ``title`` (else its key), in its ``section``. ``prose`` may have paragraphs; a
    ``pressed`` value is a combination of keys. A value that ``refers`` is a name in a list of the file (its keys,
    and that of the name), or one of the words ``else_one_of``. A value that ``knows`` names something the program
    knows from elsewhere, and offers; an ``external`` one names something outside the file.

    Keys of one group: this one is allowed only ``beside`` another. It is ``needed`` if another is present (``(key,)``,
    or ``(key, *words)``: with one of these words). It is used ``instead_of`` others, which are then not needed either.
    A group must have ``some_of`` its keys. ``needs`` says in words what is missing there, or in one of several groups.
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
    key: str = ""
    title: str = ""
    section: str = ""
    prose: bool = False
    pressed: bool = False
    refers: tuple[str, ...] = ()
    else_one_of: tuple[str, ...] = ()
    knows: Known | None = None
    external: External | None = None
    beside: tuple[str, ...] = ()
    needed: tuple[str, ...] = ()
    instead_of: tuple[str, ...] = ()
    some_of: tuple[str, ...] = ()


class Flattened(Value):
    """Value stored in the file as the ``keys`` of another declaration, among those of its group."""

    keys: Group
    read: Callable[[Any], Any]
    write: Callable[[Any], Any]


class StoredAs(Value):
    """Value stored in the file as ``kind``, which is another declaration."""

    kind: Any
    read: Callable[[Any], Any]
    write: Callable[[Any], Any]


class ExternalSchema(Value):
    """Value explained elsewhere, because several files have it: in a schema and on a page."""

    schema: str
    page: str


class Excluded:
    """Marker of attributes that are not in the file."""


class ValueForm(Value):
    """Form of one place: its type without annotations, the rules that apply there, and how it is written.

    ``place`` is the attribute that declares it.
    """

    kind: Any
    rule: FieldSpec = FieldSpec()
    spread: Flattened | None = None
    written_as: StoredAs | None = None
    elsewhere: ExternalSchema | None = None
    in_file: bool = True
    place: tuple[Group, str] | None = None

    @property
    def groups(self) -> tuple[Group, ...]:
        """The group, or alternative ones, alone or with :attr:`text`; empty for other values."""
        return (self.kind,) if is_group(self.kind) else self.alternatives

    @property
    def alternatives(self) -> tuple[Group, ...]:
        """Alternative groups; empty if there is no choice."""
        members = [form_of(member).kind for member in union_members(self.kind)]
        groups = tuple(member for member in members if is_group(member))
        return groups if len(groups) == len([member for member in members if member is not str]) else ()

    @property
    def text(self) -> "ValueForm | None":
        """Form of the text that may replace groups; None unless both are allowed."""
        members = union_members(self.kind) if self.alternatives else ()
        return next((form for member in members if (form := form_of(member)).kind is str), None)

    @property
    def choices(self) -> tuple[Any, ...]:
        """Values of a Literal, alone or beside other text, in their order; else empty."""
        members = union_members(self.kind) or (self.kind,)
        return next((get_args(member) for member in members if get_origin(member) is Literal), ())

    @property
    def scalars(self) -> tuple[Any, ...]:
        """Types of a single value, the most specific first; empty for a list or group."""
        members = union_members(self.kind) or (self.kind,)
        return members if all(member in (bool, int, float, str) for member in members) else ()

    @property
    def is_free(self) -> bool:
        """Whether it is a group of undeclared keys."""
        return get_origin(self.kind) is Mapping

    @property
    def item(self) -> "ValueForm | None":
        """Form of a list's entries; None if it is no list."""
        return form_of(get_args(self.kind)[0]) if get_origin(self.kind) is tuple else None

    @property
    def size(self) -> tuple[int, int | None]:
        """Minimum and maximum count of characters or entries."""
        if get_origin(self.kind) is tuple and get_args(self.kind)[-1] is not Ellipsis:
            return len(get_args(self.kind)), len(get_args(self.kind))
        return self.rule.shortest, self.rule.longest

    @property
    def is_known(self) -> bool:
        """Whether values of this form can be checked, read and written."""
        if self.item is not None:
            return len(set(get_args(self.kind)) - {...}) == 1 and self.item.is_known
        return bool(self.choices or self.scalars or self.is_free or self.groups)

    def group_at(self, data: Any) -> Group | None:
        """Group of the keys of ``data``; the first one for a text in its place. None if there are none."""
        if is_group(self.kind):
            return self.kind
        if isinstance(data, Mapping) and self.alternatives:
            return matching_group(self.alternatives, data) or self.alternatives[0]
        return self.alternatives[0] if self.text is not None else None


class Key(Value):
    """One key of a group, ``attribute`` in the program; ``default`` may be ``dataclasses.MISSING``."""

    name: str
    attribute: str
    form: ValueForm
    default: Any = MISSING

    @property
    def required(self) -> bool:
        return self.default is MISSING or self.form.rule.wanted


def form_of(hint: Any) -> ValueForm:
    """Form that an annotation declares. Outer rules precede inner ones; None means that the key is left out."""
    return hint if isinstance(hint, ValueForm) else _form_of(hint)


@functools.cache
def _form_of(hint: Any) -> ValueForm:
    hint = without_alias(hint)
    if get_origin(hint) is Annotated:
        inner, *marks = get_args(hint)
        return functools.reduce(_with_mark, marks, form_of(inner))
    members = [member for member in union_members(hint) if member is not type(None)]
    return form_of(members[0]) if len(members) == 1 else ValueForm(hint)


def _with_mark(form: ValueForm, mark: Any) -> ValueForm:
    match mark:
        case FieldSpec():
            return replace(form, rule=_with_rule(form.rule, mark))
        case Flattened():
            return replace(form, spread=mark)
        case StoredAs():
            written = form_of(mark.kind)
            return replace(form, kind=written.kind, rule=_with_rule(form.rule, written.rule), written_as=mark)
        case ExternalSchema():
            return replace(form, elsewhere=mark)
        case Excluded():
            return replace(form, in_file=False)
    return form


def _with_rule(inner: FieldSpec, outer: FieldSpec) -> FieldSpec:
    given = ((each.name, getattr(outer, each.name), each.default) for each in fields(FieldSpec))
    return replace(inner, **{name: value for name, value, default in given if value != default})


def is_group(kind: Any) -> bool:
    """Whether it is a group of keys with values in the file."""
    return isinstance(kind, type) and is_dataclass(kind)


@functools.cache
def _attributes(group: Group) -> tuple[Key, ...]:
    """Declared attributes that are in files, in writing order."""
    hints = typing.get_type_hints(group, include_extras=True)
    found = []
    for each in fields(group):
        form = replace(form_of(hints[each.name]), place=(group, each.name))
        if "rule" in each.metadata:
            form = _with_mark(form, FieldSpec(**each.metadata["rule"]))
        default = each.default if each.default_factory is MISSING else each.default_factory()
        if form.in_file:
            if form.spread is None and not form.is_known:
                raise TypeError(f"{group.__name__}.{each.name}: no encoding is defined for {form.kind} in a file")
            found.append(Key(form.rule.key or each.name, each.name, form, default))
    return tuple(sorted(found, key=lambda attribute: attribute.form.rule.order))


@functools.cache
def keys_of(group: Group) -> tuple[Key, ...]:
    """Keys of a group, in writing order."""
    found: list[Key] = []
    for attribute in _attributes(group):
        spread = attribute.form.spread
        found += [attribute] if spread is None else keys_of(spread.keys)
    return tuple(found)


def matching_group(groups: tuple[Group, ...], data: Mapping[str, Any]) -> Group | None:
    """Group among several that has the keys of ``data``: by a required key if there is one, else by any."""
    for required in (True, False):
        for group in groups:
            if any(key.name in data and (key.required or not required) for key in keys_of(group)):
                return group
    return None


def value_from(hint: Any, data: Any) -> Any:
    """Value of checked ``data``."""
    form = form_of(hint)
    if (text := form.text) is not None and not isinstance(data, Mapping):
        value = value_from(text, data)
    elif (group := form.group_at(data)) is not None:
        value = _group_value(group, data)
    elif (item := form.item) is not None:
        value = tuple(value_from(item, entry) for entry in data)
    else:
        value = form.kind(data) if form.kind in (int, float) else data
    return value if form.written_as is None else form.written_as.read(value)


def _group_value(group: Group, data: Mapping[str, Any]) -> Any:
    values = {}
    for key in _attributes(group):
        spread = key.form.spread
        if spread is not None:
            values[key.attribute] = spread.read(_group_value(spread.keys, data))
        elif key.name in data:
            values[key.attribute] = value_from(key.form, data[key.name])
    return group(**values)


def data_of(hint: Any, value: Any) -> Any:
    """Plain data of ``value`` for a file: the reverse of :func:`value_from`."""
    form = form_of(hint)
    if form.written_as is not None:
        value = form.written_as.write(value)
    if is_group(type(value)):
        return _group_data(value)
    if (item := form.item) is not None:
        return [data_of(item, entry) for entry in value]
    if form.is_free:
        return dict(value)
    return plain_number(value) if form.kind is float else value


def _group_data(value: Any) -> dict[str, Any]:
    data: dict[str, Any] = {}
    for key in _attributes(value.__class__):
        item, form = getattr(value, key.attribute), key.form
        if form.spread is not None:
            data |= _group_data(form.spread.write(item))
        elif item is not None and not (form.rule.quiet and item == key.default):
            data[key.name] = data_of(form, item)
    return data


def replaced(hint: Any, data: Any, change: Callable[[ValueForm, Any, KeyPath], Any], path: KeyPath = ()) -> Any:
    """Checked ``data`` with ``change`` applied to each single value."""
    form = form_of(hint)
    if form.is_free or not isinstance(data, (Mapping, list)):
        return change(form.text or form, data, path)
    inside = {step: replaced(part, value, change, (*path, step)) for step, part, value in parts_of(form, data)}
    return inside if isinstance(data, Mapping) else list(inside.values())


def parts_of(form: ValueForm, data: Any) -> Iterator[tuple[str | int, ValueForm, Any]]:
    """Key or index, form and value of the declared keys of a group, or of the entries of a list."""
    if isinstance(data, Mapping) and (group := form.group_at(data)) is not None:
        forms = {key.name: key.form for key in keys_of(group)}
        yield from ((name, forms[name], value) for name, value in data.items() if name in forms)
    elif form.item is not None and isinstance(data, list):
        for index, entry in enumerate(data):
            yield index, form.item, entry


def leaves(hint: Any, data: Any, path: KeyPath = ()) -> Iterator[tuple[KeyPath, ValueForm, Any]]:
    """Path, form and value of each single value."""
    form = form_of(hint)
    if form.is_free or not isinstance(data, (Mapping, list)):
        yield path, form.text or form, data
    else:
        for step, part, value in parts_of(form, data):
            yield from leaves(part, value, (*path, step))


def externals_in(hint: Any, data: Any) -> list[tuple[External, Any, str]]:
    """Single values in checked ``data`` that name something outside the file, with their key path without indices."""
    return [
        (form.rule.external, value, ".".join(step for step in path if isinstance(step, str)))
        for path, form, value in leaves(hint, data)
        if form.rule.external is not None
    ]


def plain_number(number: float) -> float | int:
    """Number, without a decimal point if whole."""
    return int(number) if math.isfinite(number) and number == int(number) else number
