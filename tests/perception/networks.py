"""Small ONNX networks written byte by byte, so that tests need no weights and no package for the format."""

from collections.abc import Sequence

_FLOAT, _INTS = 1, 7


def colours_of_places(*, height: int = 256, width: int = 128, batch: str | int = "batch") -> bytes:
    """Network in the form of a re-identification network: mean colour of each field of 32 x 32.

    People in different clothes are far apart.
    """
    pool = _text(1, "images") + _text(2, "pooled") + _text(4, "AveragePool")
    pool += _part(5, _ints("kernel_shape", [32, 32])) + _part(5, _ints("strides", [32, 32]))
    flat = _text(1, "pooled") + _text(2, "vector") + _text(4, "Flatten")
    graph = _part(1, pool) + _part(1, flat) + _text(2, "colours")
    graph += _part(11, _value("images", [batch, 3, height, width]))
    graph += _part(12, _value("vector", [batch, 3 * (height // 32) * (width // 32)]))
    return _number(1, 8) + _part(8, _number(2, 13)) + _part(7, graph)


def _value(name: str, shape: Sequence[str | int]) -> bytes:
    dims = b"".join(_part(1, _number(1, size) if isinstance(size, int) else _text(2, size)) for size in shape)
    return _text(1, name) + _part(2, _part(1, _number(1, _FLOAT) + _part(2, dims)))


def _ints(name: str, values: Sequence[int]) -> bytes:
    return _text(1, name) + b"".join(_number(8, value) for value in values) + _number(20, _INTS)


def _text(field: int, value: str) -> bytes:
    return _part(field, value.encode())


def _part(field: int, content: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(content)) + content


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _varint(value: int) -> bytes:
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*encoded, value])
