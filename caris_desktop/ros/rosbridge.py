"""rosbridge operations as JSON text and CBOR bytes, and fragments of large ones.

CBOR arrays are RFC 8746 typed arrays and become numpy arrays, without interpreter time per element.
"""

import base64
import contextlib
import json
import math
import re
import secrets
import warnings
from collections.abc import Callable
from typing import Any

import cbor2
import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.foreign_text import parse_json

MAX_MESSAGE_BYTES = 128 * 1024 * 1024
MAX_DEPTH = 60
_MAX_FRAGMENTS = 100_000
_MAX_PENDING_MESSAGES = 16

# RFC 8746, section 2.1: the bits of a tag are its kind, byte order and size. 76 and 83 are none of its types here.
_DTYPE_OF_TAG = {
    tag: f"{'<' if tag & 4 else '>'}{'f' if tag & 16 else 'i' if tag & 8 else 'u'}{(2 if tag & 16 else 1) << (tag & 3)}"
    for tag in range(64, 87)
    if tag not in (76, 83)
}
# Little-endian. 68 is uint8 as well, clamped.
_TAG_OF_DTYPE = {
    np.dtype(form).name: tag for tag, form in _DTYPE_OF_TAG.items() if tag != 68 and (form[0] == "<" or form[2] == "1")
}
_LONG_TEXT = 200_000
_MAP_DATA = re.compile(r'"data"\s*:\s*\[(?=\s*-?[0-9])')
# cbor2 would build dates, regular expressions, addresses, shared (cyclic) references ... from these
_TAGS_NEVER_SENT = (0, 1, 2, 3, 4, 5, 25, 28, 29, 30, 35, 36, 37, 100, 256, 258, 260, 261, 1004, 43000, 55799)


class ProtocolError(ValueError):
    """Received data that is not a rosbridge operation; the text is the reason."""


def decode_json(text: str, *, max_bytes: int = MAX_MESSAGE_BYTES) -> dict[str, Any]:
    """Decode one operation from JSON text.

    Raises
    ------
    ProtocolError
        For bad JSON, anything but an object with a text ``op``, and texts beyond ``max_bytes``.
    """
    if len(text) > max_bytes:
        raise ProtocolError(f"the message is larger than {max_bytes} bytes")
    try:
        operation = _loads(text)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"the message is not valid JSON: {error}") from error
    return _operation(operation)


def encode_json(operation: dict[str, Any]) -> str:
    """JSON text in rosbridge's form: arrays as lists, ``inf`` and ``nan`` as null, bytes as base64."""
    try:
        return json.dumps(_plain(operation), separators=(",", ":"), allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise ProtocolError(f"the message cannot be written as JSON: {error}") from error


def decode_cbor(content: bytes, *, max_bytes: int = MAX_MESSAGE_BYTES) -> dict[str, Any]:
    """Decode one operation from CBOR; typed arrays become read-only numpy arrays.

    Raises
    ------
    ProtocolError
        For bad CBOR, unknown tags, anything but an object with a text ``op``, and content beyond ``max_bytes``.
    """
    if len(content) > max_bytes:
        raise ProtocolError(f"the message is larger than {max_bytes} bytes")
    try:
        operation = cbor2.loads(
            content, tag_hook=_typed_array, semantic_decoders=_REFUSING, max_depth=MAX_DEPTH, strict_hashable_types=True
        )
    except (cbor2.CBORError, ValueError, TypeError, OverflowError, MemoryError, RecursionError, EOFError) as error:
        raise ProtocolError(f"the message is not valid CBOR: {error}") from error
    return _operation(operation)


def encode_cbor(operation: dict[str, Any]) -> bytes:
    """CBOR bytes; one-dimensional numpy arrays become typed arrays, little-endian."""
    try:
        return cbor2.dumps(operation, default=_encode_numpy)
    except (cbor2.CBORError, TypeError, ValueError, RecursionError) as error:
        raise ProtocolError(f"the message cannot be written as CBOR: {error}") from error


class FragmentAssembler:
    """Reassembles ``fragment`` operations. Limited in bytes: the oldest unfinished message is dropped.

    Parameters
    ----------
    max_bytes
        Most that all unfinished messages together may hold.
    """

    def __init__(self, *, max_bytes: int = MAX_MESSAGE_BYTES) -> None:
        self._max_bytes = max_bytes
        self._pending: dict[str | int, tuple[float, dict[int, str]]] = {}
        self.held_bytes = 0

    def add(self, fragment: dict[str, Any]) -> dict[str, Any] | None:
        """Whole operation if ``fragment`` was the last missing one, else None.

        Raises
        ------
        ProtocolError
            For a malformed fragment, one that contradicts an earlier one, and a message beyond the limit.
        """
        key, number, total, data = _fragment_parts(fragment)
        if len(data) > self._max_bytes:
            raise ProtocolError(f"the fragment is larger than {self._max_bytes} bytes")
        expected, pieces = self._pending.setdefault(key, (total, {}))
        if expected != total or (number in pieces and pieces[number] != data):
            self._drop(key)
            raise ProtocolError("the fragment is inconsistent with an earlier one of the same message")
        if number not in pieces:
            pieces[number] = data
            self.held_bytes += len(data)
        text = _joined(pieces, total)
        if text is not None and len(pieces) == math.ceil(total):
            self._drop(key)
            return decode_json(text, max_bytes=self._max_bytes)
        if text is not None:
            with contextlib.suppress(ProtocolError):
                joined = decode_json(text, max_bytes=self._max_bytes)
                self._drop(key)
                return joined
        while self.held_bytes > self._max_bytes or len(self._pending) > _MAX_PENDING_MESSAGES:
            oldest = next(iter(self._pending))
            self._drop(oldest)
            if oldest == key:
                raise ProtocolError(f"the message in fragments is larger than {self._max_bytes} bytes")
        return None

    def clear(self) -> None:
        """Drop everything, as after a reconnection."""
        self._pending.clear()
        self.held_bytes = 0

    def _drop(self, key: str | int) -> None:
        _, pieces = self._pending.pop(key)
        self.held_bytes -= sum(len(piece) for piece in pieces.values())


def fragments_of(text: str, *, message_id: str | int, size: int) -> list[dict[str, Any]]:
    """Split ``text`` into ``fragment`` operations of at most ``size`` characters, with the total as written by
    rosbridge 0.11.17 and ROS 2's: three pieces may be 3.35.
    """
    if size < 1:
        raise ValueError("a fragment must contain at least one character")
    return [
        {
            "op": "fragment",
            "id": message_id,
            "data": text[begin : begin + size],
            "num": number,
            "total": (len(text) - 1) / size + 1,
        }
        for number, begin in enumerate(range(0, len(text), size))
    ]


def _loads(text: str) -> Any:
    """Parse JSON, except that the long integer list in a map's ``data`` becomes an array.

    It takes a tenth of the time and memory of 16 million Python objects.
    """
    if len(text) >= _LONG_TEXT and (begin := _MAP_DATA.search(text)) is not None:
        end = text.find("]", begin.end())
        numbers = _whole_numbers(text[begin.end() : end]) if end - begin.end() > _LONG_TEXT // 2 else None
        if numbers is not None:
            mark = secrets.token_hex(8)
            operation = parse_json(f'{text[: begin.end()]}"{mark}"{text[end:]}')
            message = operation.get("msg") if isinstance(operation, dict) else None
            if isinstance(message, dict) and message.get("data") == [mark]:
                message["data"] = numbers
                return operation
    return parse_json(text)


def _whole_numbers(text: str) -> NDArray[np.int32] | None:
    """Comma-separated integers; None for anything else. An empty item is read as zero."""
    try:
        with warnings.catch_warnings():
            # Unparsable input only causes a warning.
            warnings.simplefilter("error")
            numbers = np.fromstring(text, dtype=np.int32, sep=",")
    except (DeprecationWarning, ValueError):
        return None
    return numbers if len(numbers) == text.count(",") + 1 else None


def _operation(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ProtocolError("the message is not an object")
    if not isinstance(value.get("op"), str):
        raise ProtocolError("the message has no 'op' that states its type")
    return value


def _joined(pieces: dict[int, str], total: float) -> str | None:
    """Joined text, if the pieces may be complete.

    rosbridge divides without rounding, and its 4.2953 means four pieces; for other servers it may mean five.
    """
    if len(pieces) < max(1, math.floor(total)) or max(pieces) != len(pieces) - 1:
        return None
    return "".join(pieces[index] for index in range(len(pieces)))


def _fragment_parts(fragment: dict[str, Any]) -> tuple[str | int, int, float, str]:
    key, number, total, data = (fragment.get(name) for name in ("id", "num", "total", "data"))
    # rosbridge gives all topic messages the number 0.
    if not isinstance(key, (str, int)) or isinstance(key, bool) or not isinstance(data, str):
        raise ProtocolError("a fragment requires a string or a number as 'id' and a string 'data'")
    if isinstance(number, bool) or not isinstance(number, (int, float)) or not math.isfinite(number):
        raise ProtocolError("a fragment requires a number 'num'")
    if isinstance(total, bool) or not isinstance(total, (int, float)) or not 0 < total <= _MAX_FRAGMENTS:
        raise ProtocolError(f"a fragment's 'total' must be between 1 and {_MAX_FRAGMENTS}")
    if not 0 <= number < math.ceil(total) or number != int(number):
        raise ProtocolError(f"fragment {number} of {total} is not possible")
    return key, int(number), float(total), data


def _typed_array(tag: Any, immutable: bool = False) -> Any:
    dtype = _DTYPE_OF_TAG.get(tag.tag)
    if dtype is None:
        raise ValueError(f"tag {tag.tag} is not supported by rosbridge")
    if not isinstance(tag.value, bytes):
        raise TypeError(f"the typed array with tag {tag.tag} contains no bytes")
    array = np.frombuffer(tag.value, dtype=dtype)
    return array if array.dtype.isnative else array.astype(array.dtype.newbyteorder("="))


def _refuse(number: int) -> Callable[..., Any]:
    def refuse(*_: Any) -> Any:
        raise ValueError(f"tag {number} is not supported by rosbridge")

    return refuse


_REFUSING: Any = {number: _refuse(number) for number in _TAGS_NEVER_SENT}


def _encode_numpy(encoder: Any, value: Any) -> None:
    if isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.name in _TAG_OF_DTYPE:
        little = value.astype(value.dtype.newbyteorder("<"), copy=False)
        encoder.encode(cbor2.CBORTag(_TAG_OF_DTYPE[value.dtype.name], little.tobytes()))
    elif isinstance(value, np.ndarray):
        encoder.encode(value.tolist())
    elif isinstance(value, np.generic):
        encoder.encode(value.item())
    else:
        raise TypeError(f"{type(value).__name__} cannot be encoded for rosbridge")


def _plain(value: Any) -> Any:
    """JSON-compatible form."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        finite = value.dtype.kind != "f" or np.isfinite(value).all()
        return value.tolist() if finite else _plain(value.tolist())
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, (bytes, bytearray)):
        return base64.b64encode(value).decode("ascii")
    return value
