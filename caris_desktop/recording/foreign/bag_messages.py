"""ROS messages in bags: bytes to and from the plain form of :mod:`caris_desktop.ros`.

Types are those of the standard packages. Definitions in a bag are compared with them and never turned into code.
"""

import dataclasses
import json
import logging
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.recording.foreign.bag_files import BagChannel
from caris_desktop.ros.message_fields import Message, MessageError

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

_log = logging.getLogger(__name__)
Ros = Literal[1, 2]
_MAX_DEFINITION_CHARS = 200_000
# Not in rosbags' tables; in ROS 1, tf is a separate package.
_MORE_OF_ROS1 = {"tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms"}
_MORE_OF_ROS2 = {
    "foxglove_msgs/msg/CompressedVideo": "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\n"
    "string format"
}
# Definitions up to ROS 1 Melodic.
_OLDER_OF_ROS1 = {
    "sensor_msgs/msg/BatteryState": "Header header\nfloat32 voltage\nfloat32 current\nfloat32 charge\n"
    "float32 capacity\nfloat32 design_capacity\nfloat32 percentage\nuint8 power_supply_status\n"
    "uint8 power_supply_health\nuint8 power_supply_technology\nbool present\nfloat32[] cell_voltage\n"
    "string location\nstring serial_number"
}
_ALIASES = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}


class NotUnderstoodError(ValueError):
    """Topic whose messages cannot be read, with the reason as user text."""


@lru_cache(maxsize=2)
def typestore(ros: Ros) -> "Typestore":
    """Standard messages of ROS 1 (Noetic) or ROS 2 (Jazzy), and Foxglove's video."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_JAZZY)
    for name, text in (_MORE_OF_ROS1 if ros == 1 else _MORE_OF_ROS2).items():
        store.register(get_types_from_msg(text, name))
    return store


@lru_cache(maxsize=1)
def _older_of_ros1() -> "Typestore":
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store, newer = get_typestore(Stores.EMPTY), typestore(1).fielddefs
    store.register({name: newer[name] for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header")})
    for name, text in _OLDER_OF_ROS1.items():
        store.register(get_types_from_msg(text, name))
    return store


def typed(ros: Ros, type_name: str, plain: Message) -> Any:
    """rosbags message of a plain one; missing fields are zero or empty.

    The case of single-letter fields is ignored: CameraInfo has ``K`` in ROS 1 and ``k`` in ROS 2.
    """
    return _builder(ros, type_name)(plain)


def plain(message: Any) -> Any:
    """Plain form of a rosbags message; arrays stay arrays."""
    if dataclasses.is_dataclass(message) and not isinstance(message, type):
        names = [field.name for field in dataclasses.fields(message) if not field.name.startswith("__")]
        return {name: plain(getattr(message, name)) for name in names}
    if isinstance(message, list):
        return [plain(item) for item in message]
    return message.item() if isinstance(message, np.generic) else message


class MessageReader:
    """Decodes the bytes of one channel to plain messages."""

    def __init__(self, channel: BagChannel) -> None:
        """Raises NotUnderstoodError if the channel's messages cannot be read."""
        self._encoding = channel.encoding
        self._type = _ALIASES.get(channel.type, channel.type)
        if self._encoding == "json":
            return
        if self._encoding not in ("ros1", "cdr"):
            raise NotUnderstoodError(f"its messages are encoded as '{self._encoding or 'unknown'}'")
        self._store = typestore(1 if self._encoding == "ros1" else 2)
        if self._type not in self._store.fielddefs:
            raise NotUnderstoodError("its type is unknown")
        if not channel.definition or _is_standard(self._store, self._type, channel):
            return
        older = _older_of_ros1() if self._encoding == "ros1" and self._type in _OLDER_OF_ROS1 else None
        if older is not None and _is_standard(older, self._type, channel):
            self._store = older
        else:
            raise NotUnderstoodError(f"its definition of {channel.type} differs from the standard")

    def read(self, data: bytes) -> Message:
        """Decode one message. Raises MessageError if malformed."""
        try:
            if self._encoding == "json":
                message = json.loads(data)
            elif self._encoding == "ros1":
                message = plain(self._store.deserialize_ros1(data, self._type))
            else:
                message = plain(self._store.deserialize_cdr(data, self._type))
        except Exception as error:
            # Generated readers raise many kinds of errors for malformed bytes.
            _log.debug("a message of %s", self._type, exc_info=True)
            raise MessageError(f"{self._type} cannot be decoded ({error})") from error
        if not isinstance(message, dict):
            raise MessageError(f"{self._type} must be an object")
        return message


_Build = Callable[[Any], Any]


@lru_cache(maxsize=256)
def _builder(ros: Ros, type_name: str) -> _Build:
    """Builder of messages of one type."""
    store = typestore(ros)
    kind = store.types[type_name]
    fields = [
        (name, name.swapcase() if len(name) == 1 else name, _field_builder(ros, description))
        for name, description in store.fielddefs[type_name][1]
    ]

    def build(plain: Any) -> Any:
        given = plain or {}
        return kind(*(make(given[name] if name in given else given.get(other)) for name, other, make in fields))

    return build


def _field_builder(ros: Ros, description: Any) -> _Build:
    from rosbags.interfaces import Nodetype

    kind, detail = description
    if kind == Nodetype.NAME:
        return _builder(ros, detail)
    if kind == Nodetype.BASE:
        empty: Any = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}.get(detail[0], 0)
        return lambda value: empty if value is None else value
    (inner_kind, inner), length = detail
    if inner_kind == Nodetype.NAME:
        build = _builder(ros, inner)
        return lambda value: [build(item) for item in value or ()]
    if inner[0] == "string":
        return lambda value: list(value or ())
    dtype = np.dtype({"bool": np.bool_, "byte": np.uint8, "char": np.uint8}.get(inner[0]) or inner[0])
    absent: NDArray[Any] = np.zeros(length if kind == Nodetype.ARRAY else 0, dtype)
    absent.flags.writeable = False

    def build_array(value: Any) -> NDArray[Any]:
        if value is None:
            return absent
        if isinstance(value, bytes):
            return np.frombuffer(value, np.uint8).view(dtype)
        return np.ascontiguousarray(value, dtype)

    return build_array


def _is_standard(store: "Typestore", type_name: str, channel: BagChannel) -> bool:
    from rosbags.typesys import TypesysError, get_types_from_idl, get_types_from_msg

    if len(channel.definition) > _MAX_DEFINITION_CHARS:
        return False
    try:
        if channel.definition_form in ("ros2idl", "omgidl"):
            carried: dict[str, Any] = {}
            for part in channel.definition.split("=" * 80 + "\n"):
                text = part.partition("\n")[2] if part.startswith("IDL: ") else part
                if text.strip():
                    carried.update(get_types_from_idl(text))
        else:
            carried = dict(get_types_from_msg(channel.definition, channel.type))
            if type_name != channel.type:
                carried[type_name] = carried.pop(channel.type)
        return _same_fields(store.fielddefs, carried, type_name, set())
    except (TypesysError, KeyError, ValueError, TypeError, AttributeError, AssertionError, RecursionError) as error:
        _log.info("the definition of %s cannot be read: %r", type_name, error)
        return False


def _same_fields(known: Any, carried: Any, type_name: str, seen: set[str]) -> bool:
    from rosbags.interfaces import Nodetype

    if type_name in seen or type_name.startswith("builtin_interfaces/"):
        return True
    seen.add(type_name)
    ours, theirs = known[type_name][1], carried[type_name][1]
    if [(name.lower(), description) for name, description in ours] != [
        (name.lower(), description) for name, description in theirs
    ]:
        return False
    for _, (kind, detail) in ours:
        inner_kind, inner = detail[0] if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (kind, detail)
        if inner_kind == Nodetype.NAME and not _same_fields(known, carried, inner, seen):
            return False
    return True
