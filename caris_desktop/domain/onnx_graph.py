"""Inspection and cutting of ONNX graphs at their tensors, and added metadata.

A detector exported for one input size has that size as constants in its last few nodes only. Without those nodes the
network accepts any size, and smaller is faster. protobuf, which onnxruntime needs anyway, parses what is declared here
and copies the rest unparsed. ``onnx.utils`` gives the same graph, for 32 MB more to install.
"""

import functools
from collections.abc import Mapping
from typing import Any

from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass

from caris_desktop.domain.value_class import Value

_FLOAT = 1
# Subset that is cut or read: field names, numbers and types as in onnx.proto of https://github.com/onnx/onnx.
_MESSAGES = {
    # Some programs recognise ONNX by its first fields only, and undeclared fields are written last.
    "Model": {
        "ir_version": (1, "int64"), "graph": (7, "Graph"), "opset_import": (8, "Opset[]"),
        "metadata_props": (14, "Entry[]"),
    },
    "Opset": {"domain": (1, "string"), "version": (2, "int64")},
    "Entry": {"key": (1, "string"), "value": (2, "string")},
    "Graph": {
        "node": (1, "Node[]"), "initializer": (5, "Tensor[]"), "input": (11, "Value[]"), "output": (12, "Value[]"),
        "value_info": (13, "Value[]"),
    },
    "Node": {"input": (1, "string[]"), "output": (2, "string[]")},
    "Tensor": {"name": (8, "string")},
    "Value": {"name": (1, "string"), "type": (2, "Type")},
    "Type": {"tensor_type": (1, "TensorType")},
    "TensorType": {"elem_type": (1, "int64"), "shape": (2, "Shape")},
    "Shape": {"dim": (1, "Dim[]")},
    "Dim": {"dim_value": (1, "int64"), "dim_param": (2, "string")},
}  # fmt: skip
_PLAIN = {"string": FieldDescriptorProto.TYPE_STRING, "int64": FieldDescriptorProto.TYPE_INT64}


class GraphFacts(Value):
    """``input_dims`` has None for a size that is open. ``tensors`` are the names of all that nodes compute."""

    input_dims: tuple[int | None, ...]
    tensors: frozenset[str]
    metadata: Mapping[str, str]


def describe(content: bytes) -> GraphFacts:
    """Facts of a graph. Raises ValueError unless this is an ONNX model with one input."""
    model = _parsed(content)
    dims = _single_input(model.graph).type.tensor_type.shape.dim
    return GraphFacts(
        tuple(dim.dim_value if dim.HasField("dim_value") else None for dim in dims),
        frozenset(name for node in model.graph.node for name in node.output),
        {entry.key: entry.value for entry in model.metadata_props},
    )


def with_metadata(content: bytes, metadata: Mapping[str, str]) -> bytes:
    """Model with these entries added."""
    added = _model_class()()
    for key, value in metadata.items():
        added.metadata_props.add(key=key, value=value)
    # Concatenated protobuf messages are merged.
    extended: bytes = content + added.SerializeToString()
    return extended


def cut_graph(content: bytes, *, output: str, input_dims: tuple[int | str, ...]) -> bytes:
    """Model with the tensor ``output`` as its only result, without the nodes behind it.

    ``input_dims`` replaces the shape of its only input (float32); a text names an open size.

    Raises ValueError if this is no ONNX model with one input, or no node computes ``output``.
    """
    model = _parsed(content)
    graph = model.graph
    taken_name = _single_input(graph).name
    _prune_to({output}, graph)
    del graph.input[:], graph.output[:]
    graph.output.add(name=output).type.tensor_type.elem_type = _FLOAT
    _take(graph, taken_name, input_dims)
    cut: bytes = model.SerializeToString()
    return cut


def taken_by(content: bytes, computed: str) -> tuple[str, ...]:
    """Input tensors, weights included, of the node that computes ``computed``.

    Raises ValueError if this is no ONNX model, or no node computes it.
    """
    for node in _parsed(content).graph.node:
        if computed in node.output:
            return tuple(node.input)
    raise ValueError(f"no node computes {computed}")


def part_of_graph(
    content: bytes, *, given: Mapping[str, tuple[int | str, ...]], outputs: tuple[str, ...] = ()
) -> bytes:
    """Model from the tensors ``given`` (float32, with their shapes) to ``outputs``, or to its own outputs if empty.

    The model's own inputs remain if they are still needed.

    Raises ValueError if this is no ONNX model, or no node computes one of the ``outputs``.
    """
    model = _parsed(content)
    graph = model.graph
    if outputs:
        del graph.output[:]
        for name in outputs:
            graph.output.add(name=name).type.tensor_type.elem_type = _FLOAT
    needed = _prune_to({value.name for value in graph.output}, graph, given=frozenset(given))
    for number in reversed(range(len(graph.input))):
        if graph.input[number].name not in needed:
            del graph.input[number]
    for name, dims in given.items():
        _take(graph, name, dims)
    part: bytes = model.SerializeToString()
    return part


def _prune_to(outputs: set[str], graph: Any, *, given: frozenset[str] = frozenset()) -> set[str]:
    """Remove all other nodes, and those that only compute ``given`` tensors. Returns the names of
    all tensors needed.
    """
    needed = set(outputs)
    # Nodes are stored in the order of computation, so one pass from the end finds all that the output depends on.
    for at in reversed(range(len(graph.node))):
        computed = graph.node[at].output
        if (needed - given).intersection(computed):
            needed.update(graph.node[at].input)
        else:
            del graph.node[at]
    missing = outputs - {name for node in graph.node for name in node.output}
    if missing:
        raise ValueError(f"no node computes {', '.join(sorted(missing))}")
    for at in reversed(range(len(graph.initializer))):
        if graph.initializer[at].name not in needed:
            del graph.initializer[at]
    del graph.value_info[:]
    return needed


def _take(graph: Any, name: str, dims: tuple[int | str, ...]) -> None:
    taken = graph.input.add(name=name).type.tensor_type
    taken.elem_type = _FLOAT
    for dim in dims:
        taken.shape.dim.add(**{"dim_param" if isinstance(dim, str) else "dim_value": dim})


def _parsed(content: bytes) -> Any:
    model = _model_class()()
    try:
        model.ParseFromString(content)
    except DecodeError as error:
        raise ValueError(f"not an ONNX model: {error}") from error
    if not model.HasField("graph"):
        raise ValueError("not an ONNX model")
    return model


def _single_input(graph: Any) -> Any:
    constants = {tensor.name for tensor in graph.initializer}
    inputs = [value for value in graph.input if value.name not in constants]
    if len(inputs) != 1:
        raise ValueError(f"expected one input, found {len(inputs)}")
    return inputs[0]


@functools.cache
def _model_class() -> Any:
    file = FileDescriptorProto(name="caris_desktop/onnx_graph.proto", package="caris_desktop.onnx")
    for name, fields in _MESSAGES.items():
        message = file.message_type.add(name=name)
        for field, (number, kind) in fields.items():
            one = kind.removesuffix("[]")
            message.field.add(
                name=field,
                number=number,
                label=FieldDescriptorProto.LABEL_OPTIONAL if one == kind else FieldDescriptorProto.LABEL_REPEATED,
                type=_PLAIN.get(one, FieldDescriptorProto.TYPE_MESSAGE),
                type_name=None if one in _PLAIN else f".{file.package}.{one}",
            )
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(f"{file.package}.Model"))
