"""YAML files: read with line numbers, evaluating nothing; written for people, with few quotation marks."""

import math
import re
from dataclasses import field
from typing import Any

import yaml
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from caris_desktop.domain.schema_fields import KeyPath
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value

MAX_DEPTH = 40
_SHOWN_DIGITS = 20
_REFUSED = re.compile("[\0\ud800-\udfff]")
_MOST_BITS = 64  # of ROS messages; Python cannot convert integers of many more to floats or text

_TAG = "tag:yaml.org,2002:"
# As in YAML 1.2: yes, on and off are words, as are 12:30 and dates, and 1e-3 is a number.
_SCALARS = (
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("int", r"[-+]?(?:0|[1-9][0-9]*)|0x[0-9a-fA-F]+", "-+0123456789"),
    ("float", r"[-+]?(?:(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|\.inf)|\.nan", "-+.0123456789"),
    ("null", r"~|null|Null|NULL|", "~nN"),
)


class YamlSourceError(ValueError):
    """Problem in the text, with its line (counted from 1)."""

    def __init__(self, message: str, line: int) -> None:
        super().__init__(message)
        self.line = line


class LocatedData(Value):
    """Plain data and the line at which each key or list item begins, counted from 1."""

    data: Any
    lines: dict[KeyPath, int] = field(default_factory=dict)

    def line_of(self, path: KeyPath) -> int:
        """Line of ``path``, or of its nearest container."""
        while path and path not in self.lines:
            path = path[:-1]
        return self.lines.get(path, 1)


class PlainScalars:
    """Resolver for a loader or dumper: which words are numbers or booleans, and so which need quotation marks."""

    yaml_implicit_resolvers: dict[Any, Any] = {}  # noqa: RUF012 - the declaration of the base class


class _PlainLoader(PlainScalars, yaml.SafeLoader):
    """Loader that refuses aliases and nesting beyond ``MAX_DEPTH``."""

    depth = 0

    def compose_node(self, parent: Node | None, index: int) -> Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]  # the stubs leave it untyped
        line = event.start_mark.line + 1
        if isinstance(event, yaml.events.AliasEvent):
            raise YamlSourceError(tr("references (*name) are not allowed. Write the value out."), line)
        if self.depth >= MAX_DEPTH:
            raise YamlSourceError(tr("nested more than {most} levels deep").format(most=MAX_DEPTH), line)
        self.depth += 1
        try:
            node: Node | None = super().compose_node(parent, index)
        finally:
            self.depth -= 1
        return node


def know_scalars(kind: Any) -> None:
    """Add the scalar rules of :func:`parse_yaml` to a class of loaders or dumpers."""
    for name, form, first in _SCALARS:
        first_characters = [*first, ""] if name == "null" else list(first)
        kind.add_implicit_resolver(_TAG + name, re.compile(f"(?:{form})\\Z"), first_characters)


know_scalars(_PlainLoader)


def parse_yaml(text: str, *, finite: bool = True) -> LocatedData:
    """Mappings, lists, text, numbers and booleans of one YAML document; nothing is evaluated or constructed.

    ``finite`` refuses numbers that are not.

    Raises YamlSourceError on a syntax error, a duplicate key, a reference, or a tag.
    """
    try:
        loader = _PlainLoader(text)
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise YamlSourceError(
            tr("the character #x{character} is not allowed").format(character=f"{error.character:04x}"), line
        ) from error
    try:
        root = loader.get_single_node()
        if root is None:
            raise YamlSourceError(tr("the file is empty"), 1)
        return located(root, finite=finite)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise YamlSourceError(
            tr("not valid YAML: {problem}").format(problem=error.problem or error.context), mark.line + 1 if mark else 1
        ) from error
    except yaml.YAMLError as error:
        raise YamlSourceError(tr("not valid YAML: {error}").format(error=error), 1) from error
    finally:
        loader.dispose()


def located(root: Node, *, finite: bool = True) -> LocatedData:
    """Data of composed nodes, with their lines. Raises YamlSourceError."""
    lines: dict[KeyPath, int] = {}
    return LocatedData(_plain(root, (), lines, finite), lines)


def _plain(node: Node, path: KeyPath, lines: dict[KeyPath, int], finite: bool) -> Any:
    line = node.start_mark.line + 1
    lines.setdefault(path, line)
    kind = node.tag.removeprefix(_TAG)
    if isinstance(node, MappingNode) and kind == "map":
        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key_line = key_node.start_mark.line + 1
            key = key_node.value if isinstance(key_node, ScalarNode) else None
            if not isinstance(key, str):
                raise YamlSourceError(tr("a key must be plain text"), key_line)
            _check_characters(key, key_line)
            if key in result:
                raise YamlSourceError(
                    tr("duplicate key '{key}' (first in line {lines})").format(key=key, lines=lines[(*path, key)]),
                    key_line,
                )
            lines[(*path, key)] = key_line
            result[key] = _plain(value_node, (*path, key), lines, finite)
        return result
    if isinstance(node, SequenceNode) and kind == "seq":
        return [_plain(item, (*path, index), lines, finite) for index, item in enumerate(node.value)]
    if not isinstance(node, ScalarNode) or kind not in ("str", "bool", "null", "int", "float"):
        raise YamlSourceError(
            tr("the tag {tag} is not allowed. Allowed: text, numbers, true, false").format(tag=node.tag), line
        )
    _check_characters(node.value, line)
    value = _scalar(kind, node.value, line)
    if isinstance(value, int) and value.bit_length() > _MOST_BITS:
        if finite:
            raise YamlSourceError(tr("{value}... is too large a number").format(value=node.value[:_SHOWN_DIGITS]), line)
        value = math.inf
    if finite and isinstance(value, float) and not math.isfinite(value):
        raise YamlSourceError(tr("{value} is not a finite number").format(value=node.value), line)
    return value


def _check_characters(text: str, line: int) -> None:
    """Refuse escapes such as ``\\0`` and ``\\ud800``: no path and no encoding of text can hold them."""
    refused = _REFUSED.search(text)
    if refused is not None:
        character = f"{ord(refused[0]):04x}"
        raise YamlSourceError(tr("the character #x{character} is not allowed").format(character=character), line)


def _scalar(kind: str, text: str, line: int) -> str | bool | int | float | None:
    try:
        if kind == "int":
            return int(text, 16 if text.startswith("0x") else 10)
        if kind == "float":
            return float(text.replace(".inf", "inf").replace(".nan", "nan"))
    except ValueError as error:
        raise YamlSourceError(tr("{text} is not a number").format(text=repr(text)), line) from error
    if kind == "bool" and text.lower() not in ("true", "false"):
        raise YamlSourceError(tr("{text} is neither true nor false").format(text=repr(text)), line)
    return text if kind == "str" else None if kind == "null" else text.lower() == "true"


# YAML writer for people: keys in the given order, few quotation marks.


class _ReadableDumper(yaml.SafeDumper):
    """Dumper that indents list items under their key, as people do, and quotes what YAML 1.1 readers would misread."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        super().increase_indent(flow, False)


class _PlainDumper(PlainScalars, yaml.SafeDumper):
    """Dumper with as few quotation marks as our own reader needs: a key of robot profiles is ``on``."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _plain_text(dumper: yaml.SafeDumper, text: str) -> yaml.Node:
    """Plain text, also of a translatable text."""
    return dumper.represent_str("".join(text))


for _dumper in (_ReadableDumper, _PlainDumper):
    know_scalars(_dumper)
    _dumper.add_multi_representer(str, _plain_text)


def yaml_text(data: Any) -> str:
    """Text of a whole file."""
    return dumped(data, default_flow_style=False, width=110)


def dumped(value: Any, *, default_flow_style: bool | None, width: int, plain: bool = False) -> str:
    """Text of a part of a file; ``plain`` as robot profiles are written."""
    text: str = yaml.dump(
        value,
        Dumper=_PlainDumper if plain else _ReadableDumper,
        sort_keys=False,
        allow_unicode=True,
        default_flow_style=default_flow_style,
        width=width,
    )
    return text
