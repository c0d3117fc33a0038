"""Cuts an ONNX graph at one of its tensors, on the wire format itself.

A detector that was exported for one input size has that size baked into the constants of its last few nodes only.
Without those nodes the network takes any size, and smaller is faster. Message and field numbers: onnx.proto of
https://github.com/onnx/onnx; wire format: https://protobuf.dev/programming-guides/encoding. ``onnx.utils`` gives the
same graph, for 33 MB more to install and a quarter of a second more before the first person is found.
"""

from collections.abc import Iterator
from dataclasses import dataclass

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_MODEL_GRAPH = 7
_GRAPH_NODE, _GRAPH_INITIALIZER, _GRAPH_INPUT, _GRAPH_OUTPUT, _GRAPH_VALUE_INFO = 1, 5, 11, 12, 13
_NODE_INPUT, _NODE_OUTPUT = 1, 2
_TENSOR_NAME = 8
_VALUE_NAME, _VALUE_TYPE = 1, 2
_TYPE_TENSOR, _TENSOR_ELEMENT, _TENSOR_SHAPE = 1, 1, 2
_SHAPE_DIM, _DIM_VALUE, _DIM_NAME = 1, 1, 2
_FLOAT = 1


@dataclass(frozen=True, slots=True)
class _Field:
    """``payload`` is the content of a length-delimited field, ``raw`` the whole field as it stands in the file."""

    number: int
    payload: memoryview
    raw: memoryview


def cut_graph(model: bytes, *, output: str, input_dims: tuple[int | str, ...]) -> bytes:
    """The model with the tensor ``output`` as its only result and nothing behind it.

    ``input_dims`` replaces the shape of its only input (float32); a text names a size that is open.

    Raises
    ------
    ValueError
        When this is no ONNX model with one input, or no node computes ``output``.
    """
    top = list(_fields(memoryview(model)))
    graphs = [field for field in top if field.number == _MODEL_GRAPH]
    if len(graphs) != 1:
        raise ValueError("not an ONNX model")
    graph = _cut(list(_fields(graphs[0].payload)), output, input_dims)
    return b"".join(_message(_MODEL_GRAPH, graph) if field is graphs[0] else bytes(field.raw) for field in top)


def _cut(graph: list[_Field], output: str, input_dims: tuple[int | str, ...]) -> bytes:
    initializers = {_text(field, _TENSOR_NAME): field for field in graph if field.number == _GRAPH_INITIALIZER}
    inputs = [_text(field, _VALUE_NAME) for field in graph if field.number == _GRAPH_INPUT]
    inputs = [name for name in inputs if name not in initializers]
    if len(inputs) != 1:
        raise ValueError(f"expected one input, found {len(inputs)}")
    needed, kept_nodes = {output}, []
    # Nodes are stored in the order of computation, so one pass from the end finds all that lead to the output.
    for node in reversed([field for field in graph if field.number == _GRAPH_NODE]):
        if needed.intersection(_texts(node, _NODE_OUTPUT)):
            needed.update(_texts(node, _NODE_INPUT))
            kept_nodes.append(node)
    if not kept_nodes:
        raise ValueError(f"no node computes {output}")
    replaced = (_GRAPH_NODE, _GRAPH_INITIALIZER, _GRAPH_INPUT, _GRAPH_OUTPUT, _GRAPH_VALUE_INFO)
    return b"".join(
        [
            *(bytes(node.raw) for node in reversed(kept_nodes)),
            *(bytes(field.raw) for field in graph if field.number not in replaced),
            *(bytes(field.raw) for name, field in initializers.items() if name in needed),
            _message(_GRAPH_INPUT, _value(inputs[0], input_dims)),
            _message(_GRAPH_OUTPUT, _value(output, None)),
        ]
    )


def _value(name: str, dims: tuple[int | str, ...] | None) -> bytes:
    tensor = _number(_TENSOR_ELEMENT, _FLOAT)
    if dims is not None:
        shape = b"".join(
            _message(
                _SHAPE_DIM, _message(_DIM_NAME, dim.encode()) if isinstance(dim, str) else _number(_DIM_VALUE, dim)
            )
            for dim in dims
        )
        tensor += _message(_TENSOR_SHAPE, shape)
    return _message(_VALUE_NAME, name.encode()) + _message(_VALUE_TYPE, _message(_TYPE_TENSOR, tensor))


def _text(field: _Field, number: int) -> str:
    return next(_texts(field, number), "")


def _texts(field: _Field, number: int) -> Iterator[str]:
    return (str(inner.payload, "utf-8") for inner in _fields(field.payload) if inner.number == number)


def _fields(message: memoryview) -> Iterator[_Field]:
    position = 0
    while position < len(message):
        start = position
        tag, position = _read_varint(message, position)
        kind, payload = tag & 7, message[:0]
        if kind == _VARINT:
            _, position = _read_varint(message, position)
        elif kind == _FIXED64:
            position += 8
        elif kind == _FIXED32:
            position += 4
        elif kind == _BYTES:
            length, position = _read_varint(message, position)
            payload = message[position : position + length]
            position += length
        else:
            raise ValueError("not a protobuf message")
        if position > len(message):
            raise ValueError("a protobuf message is cut off")
        yield _Field(tag >> 3, payload, message[start:position])


def _read_varint(message: memoryview, position: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        if position >= len(message):
            raise ValueError("a protobuf message is cut off")
        byte = message[position]
        position += 1
        value |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            return value, position


def _varint(value: int) -> bytes:
    encoded = bytearray()
    while value >= 0x80:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    encoded.append(value)
    return bytes(encoded)


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3 | _VARINT) + _varint(value)


def _message(field: int, content: bytes) -> bytes:
    return _varint(field << 3 | _BYTES) + _varint(len(content)) + content
