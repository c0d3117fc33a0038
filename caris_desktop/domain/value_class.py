"""Faster ``dataclass``, compatible with the standard library's, for hundreds of classes before the first window.

The standard library compiles six to eight functions per class from text; for the console's classes that was a third of
the time until it accepts a key, and a share of each child process's start. Here it still finds and checks the fields
and makes the slots; comparison, repr and immutability are shared, and only ``__init__`` is compiled.
"""

import dataclasses
import reprlib
from collections.abc import Callable, Iterable, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any, ClassVar, dataclass_transform

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass  # noqa: PLC0414 - given on
else:

    def dataclass(cls=None, /, *, eq=True, frozen=False, slots=False, kw_only=False):
        """Same as ``dataclasses.dataclass``; ``fields``, ``replace`` and ``asdict`` of that module
        accept such classes.
        """

        def make(plain: type[Any]) -> type[Any]:
            return _made(plain, eq=eq, frozen=frozen, slots=slots, kw_only=kw_only)

        return make if cls is None else make(cls)


class _Factory:
    """Placeholder in a signature for a default made for each instance."""

    def __repr__(self) -> str:
        return "<factory>"


_FACTORY = _Factory()
_Fields = Sequence["dataclasses.Field[Any]"]
_Values = Callable[[Any], tuple[Any, ...]]


def _made(plain: type[Any], *, eq: bool, frozen: bool, slots: bool, kw_only: bool) -> type[Any]:
    set_names = {name for name, value in vars(plain).items() if value is not None}
    if plain.__doc__ is None:
        plain.__doc__ = plain.__name__  # otherwise the library computes the whole signature
    cls: type[Any] = dataclasses.dataclass(init=False, repr=False, eq=False, slots=slots, kw_only=kw_only)(plain)
    fields = dataclasses.fields(cls)
    methods: dict[str, Any] = {"__init__": _init(cls, fields, frozen), "__repr__": _repr(fields)}
    if eq:
        methods["__eq__"] = _eq(_values(field.name for field in fields if field.compare))
        hashed = _values(field.name for field in fields if (field.compare if field.hash is None else field.hash))
        methods["__hash__"] = _hash(hashed) if frozen else None
    if frozen:
        methods["__setattr__"], methods["__delattr__"] = _refuse_to_set, _refuse_to_delete
        if slots:
            methods["__getstate__"], methods["__setstate__"] = _state(fields)
    for name, method in methods.items():
        if name not in set_names:
            setattr(cls, name, method)
    return cls


def _init(cls: type[Any], fields: _Fields, frozen: bool) -> Callable[..., None]:
    """``__init__`` with parameters in field order, keyword-only ones last; then ``__post_init__`` if present."""
    names: dict[str, Any] = {"_set": object.__setattr__, "_FACTORY": _FACTORY}
    parameters, by_name, lines = ["self"], list[str](), list[str]()
    for field in fields:
        name, value = field.name, field.name
        default, factory = field.default, field.default_factory
        parameter = name
        if factory is not dataclasses.MISSING:
            names[f"_new_{name}"] = factory
            parameter = f"{name}=_FACTORY"
            value = f"_new_{name}() if {name} is _FACTORY else {name}" if field.init else f"_new_{name}()"
        elif default is not dataclasses.MISSING:
            names[f"_default_{name}"] = default
            parameter = f"{name}=_default_{name}"
            value = name if field.init else f"_default_{name}"
        elif not field.init:
            continue  # set by the code that creates it
        if field.init:
            (by_name if field.kw_only else parameters).append(parameter)
        lines.append(f"_set(self, {name!r}, {value})" if frozen else f"self.{name} = {value}")
    if hasattr(cls, "__post_init__"):
        lines.append("self.__post_init__()")
    listed = ", ".join((*parameters, "*", *by_name) if by_name else parameters)
    body = "\n ".join(lines or ("pass",))
    exec(f"def __init__({listed}):\n {body}", names)  # noqa: S102 - made of names that Python itself took already
    init: Callable[..., None] = names["__init__"]
    init.__qualname__ = f"{cls.__qualname__}.__init__"
    init.__annotations__ = {**{field.name: field.type for field in fields if field.init}, "return": None}
    return init


def _values(names_of_fields: Iterable[str]) -> _Values:
    names = tuple(names_of_fields)
    if len(names) > 1:
        return attrgetter(*names)
    if names:
        only = attrgetter(*names)
        return lambda self: (only(self),)
    return lambda _self: ()


def _eq(values: _Values) -> Callable[[Any, Any], Any]:
    def equal(self: Any, other: Any) -> Any:
        return values(self) == values(other) if other.__class__ is self.__class__ else NotImplemented

    return equal


def _hash(values: _Values) -> Callable[[Any], int]:
    def hashed(self: Any) -> int:
        return hash(values(self))

    return hashed


def _repr(fields: _Fields) -> Callable[[Any], str]:
    names = tuple(field.name for field in fields if field.repr)

    @reprlib.recursive_repr()
    def shown(self: Any) -> str:
        return f"{self.__class__.__qualname__}({', '.join(f'{name}={getattr(self, name)!r}' for name in names)})"

    return shown


def _state(fields: _Fields) -> tuple[_Values, Callable[[Any, Sequence[Any]], None]]:
    """State getter and setter for pickle and copy of frozen classes with slots."""
    names = tuple(field.name for field in fields)
    values = _values(names)

    def state_of(self: Any) -> tuple[Any, ...]:
        return values(self)

    def fill(self: Any, state: Sequence[Any]) -> None:
        for name, value in zip(names, state, strict=True):
            object.__setattr__(self, name, value)

    return state_of, fill


def _refuse_to_set(_self: Any, name: str, _value: Any) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")


def _refuse_to_delete(_self: Any, name: str) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")


def setting(*, default: Any = dataclasses.MISSING, default_factory: Any = dataclasses.MISSING, **rule: Any) -> Any:
    """Field with a rule of ``schema_fields.FieldSpec``, whose ``text`` is the docstring that follows in the source."""
    return dataclasses.field(default=default, default_factory=default_factory, metadata={"rule": rule})


if TYPE_CHECKING:

    @dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field, setting))
    class Value:
        """Base class of values: its subclasses are frozen dataclasses with slots."""

        __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]

        def __init_subclass__(cls, *, eq: bool = True, kw_only: bool = False) -> None: ...

else:

    class _ValueClass(type):
        def __new__(cls, name, bases, namespace, *, eq=True, kw_only=False):
            made = super().__new__(cls, name, bases, namespace)
            # The library makes the class with slots by another call of this.
            return made if "__slots__" in namespace else _made(made, eq=eq, frozen=True, slots=True, kw_only=kw_only)

    class Value(metaclass=_ValueClass, eq=False):
        """Base class of values: its subclasses are frozen dataclasses with slots."""
