"""Validation of outgoing messages against their type definitions, as reported by the robot."""

import asyncio
import logging
import math
from collections.abc import Mapping
from typing import Any, Literal

from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.robot.transport import RosbridgeClient, ServiceCallError
from caris_desktop.ros.action_messages import action_package_and_name
from caris_desktop.ros.definitions import (
    FLOATS,
    INTEGER_RANGES,
    TEXTS,
    TIMES,
    TRUTHS,
    Definition,
    FieldType,
    shipped_definition,
)
from caris_desktop.ros.dialect import Dialect, action_type_name, plain_name, service_type_name, type_name

logger = logging.getLogger(__name__)

TypeKind = Literal["message", "service", "goal"]

LARGEST_FLOAT32 = 3.4028235e38
LONGEST_TEXT = 20_000
LONGEST_LIST = 10_000
_MOST_TYPEDEFS = 500
_MOST_FIELDS = 1_000
_DEEPEST = 20


class MessageMismatchError(ValueError):
    """Message that does not fit its type; the text names the field, its value and the requirement."""


class MessageTypes:
    """Type definitions of one robot: queried once per connection, else the known standard ones."""

    def __init__(self, ros: RosbridgeClient, dialect: Dialect) -> None:
        self._ros = ros
        self._dialect = dialect
        self._learnt: dict[tuple[TypeKind, str], asyncio.Task[Definition | None]] = {}

    def forget(self) -> None:
        """Clear all, since another robot may answer after a link loss."""
        # Pending queries fail, and their callers continue then.
        self._learnt.clear()

    def known(self, kind: TypeKind, type_: str) -> bool:
        """True if :meth:`definition` returns at once."""
        task = self._learnt.get((kind, type_))
        return task is not None and task.done() and not task.cancelled()

    def definition_now(self, kind: TypeKind, type_: str) -> Definition | None:
        """Known definition, or None."""
        task = self._learnt.get((kind, type_))
        return task.result() if task is not None and task.done() and not task.cancelled() else None

    async def definition(self, kind: TypeKind, type_: str) -> Definition | None:
        """Fields of a message, service request or action goal; None if unknown."""
        task = self._learnt.get((kind, type_))
        if task is None:
            task = asyncio.get_running_loop().create_task(self._learn(kind, type_))
            self._learnt[kind, type_] = task
        return await asyncio.shield(task)

    async def _learn(self, kind: TypeKind, type_: str) -> Definition | None:
        package, name = action_package_and_name(type_) if kind == "goal" else _package_and_name(type_)
        service, spelled = "message_details", type_name(self._dialect, package, name)
        if kind == "service":
            service, spelled = "service_request_details", service_type_name(self._dialect, package, name)
        elif kind == "goal" and self._dialect is Dialect.ROS1:
            spelled = type_name(self._dialect, package, f"{name}Goal")
        elif kind == "goal":
            service, spelled = "action_goal_details", action_type_name(self._dialect, package, name)
        try:
            answer = await self._ros.ask(f"/rosapi/{service}", f"rosapi/{service}", {"type": spelled})
            return definition_from_rosapi(answer.get("typedefs"))
        except (ServiceCallError, ValueError, TypeError) as error:
            logger.debug("%s: %s", spelled, error)
        return shipped_definition(f"{package}/{name}Goal" if kind == "goal" else f"{package}/{name}")


def definition_from_rosapi(typedefs: Any) -> Definition:
    """Definition from rosapi's message_details and similar; the first typedef is the requested type.

    Raises
    ------
    ValueError, TypeError
        When it is not such an answer, or an empty one.
    """
    if not isinstance(typedefs, list) or not 0 < len(typedefs) <= _MOST_TYPEDEFS:
        raise ValueError("rosapi reports no fields")
    nested: dict[str, tuple[FieldType, ...]] = {}
    first: tuple[FieldType, ...] | None = None
    for typedef in typedefs:
        if not isinstance(typedef, dict) or not isinstance(typedef.get("type"), str):
            raise TypeError("rosapi's response is not a list of types")
        names, types, lengths = (typedef.get(key) for key in ("fieldnames", "fieldtypes", "fieldarraylen"))
        lists = [names, types, lengths]
        if not all(isinstance(items, list) and len(items) <= _MOST_FIELDS for items in lists):
            raise ValueError(localized(QT_TR_NOOP("rosapi does not report the fields of {type}"), type=typedef["type"]))
        fields = tuple(
            FieldType(str(name), str(kind), None if length == -1 else max(0, int(length)))
            for name, kind, length in zip(*lists, strict=True)
        )
        nested[plain_name(typedef["type"])] = fields
        first = fields if first is None else first
    return Definition(first or (), nested)


def coerce_to_definition(
    message: Mapping[str, Any], definition: Definition | None, *, rounds: bool = False
) -> dict[str, Any]:
    """``message`` in a form that can be sent, with integers where required. Fields may be omitted.

    ``definition`` None checks only that it can be encoded. ``rounds`` rounds to integers instead of refusing.

    Raises
    ------
    MessageMismatchError
        For an unknown field, a value of the wrong kind and one out of range.
    """
    if definition is None:
        _check_plain(message, _named(""), 0)
        return dict(message)
    return _message(message, definition.fields, definition, "", rounds)


def _message(
    value: Any, fields: tuple[FieldType, ...], definition: Definition, where: str, rounds: bool
) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise MessageMismatchError(
            localized(
                QT_TR_NOOP("{where} must be a group of fields, but it is {value}"),
                where=_named(where),
                value=_described(value),
            )
        )
    if where.count(".") > _DEEPEST:
        raise MessageMismatchError(localized(QT_TR_NOOP("{where} is nested too deeply"), where=_named(where)))
    by_name = {field.name: field for field in fields}
    sent = {}
    for name, item in value.items():
        field = by_name.get(name)
        inside = f"{where}.{name}" if where else str(name)
        if field is None:
            allowed = ", ".join(sorted(by_name)[:12]) or QT_TR_NOOP("none")
            raise MessageMismatchError(
                localized(QT_TR_NOOP("unknown field {field}; known fields: {known}"), field=repr(inside), known=allowed)
            )
        sent[name] = _field(item, field, definition, inside, rounds)
    return sent


def _field(value: Any, field: FieldType, definition: Definition, where: str, rounds: bool) -> Any:
    if field.length is None:
        return _single(value, field.type, definition, where, rounds)
    if field.type in ("uint8", "char", "byte", "octet") and isinstance(value, (str, bytes)):
        return value
    if not isinstance(value, (list, tuple)):
        raise MessageMismatchError(
            localized(
                QT_TR_NOOP("{where} must be a list, but it is {value}"), where=_named(where), value=_described(value)
            )
        )
    if field.length and len(value) != field.length:
        raise MessageMismatchError(
            localized(
                QT_TR_NOOP("{where} must have {length} entries, but it has {number}"),
                where=_named(where),
                length=field.length,
                number=len(value),
            )
        )
    if len(value) > LONGEST_LIST:
        raise MessageMismatchError(
            localized(
                QT_TR_NOOP("{where} has {number} entries, which is too many"), where=_named(where), number=len(value)
            )
        )
    return [_single(item, field.type, definition, f"{where}[{index}]", rounds) for index, item in enumerate(value)]


def _single(value: Any, type_: str, definition: Definition, where: str, rounds: bool) -> Any:
    plain = plain_name(type_)
    base = plain.partition("<")[0]
    if base in INTEGER_RANGES:
        return _whole_number(value, INTEGER_RANGES[base], where, rounds)
    if base in FLOATS:
        return _number(value, base, where)
    if base in TRUTHS:
        if not isinstance(value, bool):
            raise MessageMismatchError(
                localized(
                    QT_TR_NOOP("{where} must be true or false, but it is {value}"),
                    where=_named(where),
                    value=_described(value),
                )
            )
        return value
    if base in TEXTS:
        if not isinstance(value, str):
            raise MessageMismatchError(
                localized(
                    QT_TR_NOOP("{where} must be text, but it is {value}"), where=_named(where), value=_described(value)
                )
            )
        if len(value) > LONGEST_TEXT:
            raise MessageMismatchError(
                localized(
                    QT_TR_NOOP("{where} is longer than {most} characters"), where=_named(where), most=LONGEST_TEXT
                )
            )
        return value
    if plain in TIMES:
        return _time(value, where)
    fields = definition.nested.get(plain) or definition.nested.get("std_msgs/Header" if plain == "Header" else plain)
    if fields is None:
        # Unknown nested type: the robot will refuse it if invalid.
        _check_plain(value, _named(where), 0)
        return value
    return _message(value, fields, definition, where, rounds)


def _whole_number(value: Any, range_: tuple[int, int], where: str, rounds: bool) -> int:
    lowest, highest = range_
    if isinstance(value, float) and math.isfinite(value) and (rounds or value.is_integer()):
        value = round(value)
    if isinstance(value, bool) or not isinstance(value, int) or not lowest <= value <= highest:
        raise MessageMismatchError(
            localized(
                QT_TR_NOOP("{where} must be a whole number from {lowest} to {highest}, but it is {value}"),
                where=_named(where),
                lowest=lowest,
                highest=highest,
                value=_described(value),
            )
        )
    return value


def _number(value: Any, type_: str, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise MessageMismatchError(
            localized(
                QT_TR_NOOP("{where} must be a number, but it is {value}"), where=_named(where), value=_described(value)
            )
        )
    try:
        number = float(value)
    except OverflowError as error:
        raise MessageMismatchError(localized(QT_TR_NOOP("{where} is too large"), where=_named(where))) from error
    if not math.isfinite(number) or (type_ in ("float32", "float") and abs(number) > LARGEST_FLOAT32):
        raise MessageMismatchError(
            localized(
                QT_TR_NOOP("{where} must be a finite number, but it is {value}"),
                where=_named(where),
                value=_described(value),
            )
        )
    return number


def _time(value: Any, where: str) -> Any:
    names = ({"secs", "nsecs"}, {"sec", "nanosec"})
    parts = value if isinstance(value, Mapping) else {}
    integers = all(isinstance(part, int) and not isinstance(part, bool) for part in parts.values())
    # ROS 1's rosbridge replaces this word by the robot's time.
    if value != "now" and not (parts and integers and any(set(parts) <= allowed for allowed in names)):
        raise MessageMismatchError(
            localized(QT_TR_NOOP("{where} must be a time in whole seconds and nanoseconds"), where=_named(where))
        )
    return value


def _check_plain(value: Any, where: str, depth: int) -> None:
    """Check that the value can be encoded as JSON."""
    if depth > _DEEPEST:
        raise MessageMismatchError(localized(QT_TR_NOOP("{where} is nested too deeply"), where=where))
    if isinstance(value, Mapping):
        for item in value.values():
            _check_plain(item, where, depth + 1)
    elif isinstance(value, (list, tuple)):
        if len(value) > LONGEST_LIST:
            raise MessageMismatchError(
                localized(
                    QT_TR_NOOP("{where} has a list of {number} entries, which is too many"),
                    where=where,
                    number=len(value),
                )
            )
        for item in value:
            _check_plain(item, where, depth + 1)
    elif isinstance(value, float) and not math.isfinite(value):
        raise MessageMismatchError(localized(QT_TR_NOOP("{where} has a number that is not finite"), where=where))
    elif value is not None and not isinstance(value, (bool, int, float, str)):
        raise MessageMismatchError(
            localized(
                QT_TR_NOOP("{where} has a value that cannot be sent: {value}"), where=where, value=_described(value)
            )
        )


def _package_and_name(type_: str) -> tuple[str, str]:
    package, _, name = plain_name(type_).partition("/")
    return package, name


def _named(where: str) -> str:
    return localized(QT_TR_NOOP("the field {field}"), field=repr(where)) if where else QT_TR_NOOP("the message")


def _described(value: Any) -> str:
    if value is None:
        return QT_TR_NOOP("nothing")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return localized(QT_TR_NOOP("the text {said}"), said=repr(value[:40]))
    if isinstance(value, (int, float)):
        return str(value)[:40]
    a_list = isinstance(value, (list, tuple))
    return QT_TR_NOOP("a list") if a_list else QT_TR_NOOP("a group of fields")
