"""YAML that remembers its lines and refuses everything a scenario has no use for."""

import math
from dataclasses import dataclass, field
from typing import Any

import yaml
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

MAX_DEPTH = 40
KeyPath = tuple[str | int, ...]


class YamlSourceError(ValueError):
    """What is wrong in the text, and at which line (counted from 1)."""

    def __init__(self, message: str, line: int) -> None:
        super().__init__(message)
        self.line = line


@dataclass(frozen=True, slots=True)
class LocatedData:
    """Plain data and the line at which each key or list item begins, counted from 1."""

    data: Any
    lines: dict[KeyPath, int] = field(default_factory=dict)

    def line_of(self, path: KeyPath) -> int:
        """The line of ``path``, or of its nearest container."""
        while path and path not in self.lines:
            path = path[:-1]
        return self.lines.get(path, 1)


class _PlainLoader(yaml.SafeLoader):
    """Composes nodes without aliases, and not deeper than ``MAX_DEPTH``."""

    depth = 0

    def compose_node(self, parent: Node | None, index: int) -> Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]  # the stubs leave it untyped
        line = event.start_mark.line + 1
        if isinstance(event, yaml.events.AliasEvent):
            raise YamlSourceError("references (*name) are not allowed. Write the value out.", line)
        if self.depth >= MAX_DEPTH:
            raise YamlSourceError(f"nested more than {MAX_DEPTH} levels deep", line)
        self.depth += 1
        try:
            node: Node | None = super().compose_node(parent, index)
        finally:
            self.depth -= 1
        return node


def parse_yaml(text: str) -> LocatedData:
    """Mappings, lists, text, numbers and booleans of one YAML document; nothing is evaluated or constructed.

    Raises
    ------
    YamlSourceError
        On a syntax error, a duplicate key, a reference, a tag, or a number that is not finite.
    """
    try:
        loader = _PlainLoader(text)
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise YamlSourceError(f"the character #x{error.character:04x} is not allowed", line) from error
    try:
        root = loader.get_single_node()
        if root is None:
            raise YamlSourceError("the file is empty", 1)
        lines: dict[KeyPath, int] = {}
        return LocatedData(_plain(loader, root, (), lines), lines)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise YamlSourceError(
            f"not valid YAML: {error.problem or error.context}", mark.line + 1 if mark else 1
        ) from error
    except yaml.YAMLError as error:
        raise YamlSourceError(f"not valid YAML: {error}", 1) from error
    finally:
        loader.dispose()


def _plain(loader: _PlainLoader, node: Node, path: KeyPath, lines: dict[KeyPath, int]) -> Any:
    line = node.start_mark.line + 1
    lines.setdefault(path, line)
    if isinstance(node, MappingNode):
        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key_line = key_node.start_mark.line + 1
            key = key_node.value if isinstance(key_node, ScalarNode) else None
            if not isinstance(key, str):
                raise YamlSourceError("a key must be a plain word", key_line)
            if key in result:
                raise YamlSourceError(f"'{key}' is given twice (first in line {lines[(*path, key)]})", key_line)
            lines[(*path, key)] = key_line
            result[key] = _plain(loader, value_node, (*path, key), lines)
        return result
    if isinstance(node, SequenceNode):
        return [_plain(loader, item, (*path, index), lines) for index, item in enumerate(node.value)]
    return _scalar(loader, node, line)


def _scalar(loader: _PlainLoader, node: Node, line: int) -> Any:
    kind = str(node.tag).removeprefix("tag:yaml.org,2002:")
    if kind in ("str", "timestamp", "value", "merge"):
        return node.value
    if (kind == "bool" and node.value.lower() not in ("true", "false")) or (kind != "bool" and ":" in node.value):
        # YAML 1.1 reads yes and off as booleans and 12:30 as a number; in a list of phrases they are words.
        return node.value
    if kind not in ("int", "float", "bool", "null"):
        raise YamlSourceError(f"the tag {node.tag} is not allowed. Allowed: text, numbers, true, false", line)
    try:
        value = loader.construct_object(node)
    except ValueError as error:
        raise YamlSourceError(f"{node.value!r} is not a number", line) from error
    if isinstance(value, float) and not math.isfinite(value):
        raise YamlSourceError(f"{node.value} is not a usable number", line)
    return value
