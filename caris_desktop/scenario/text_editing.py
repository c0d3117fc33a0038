"""YAML that people wrote: some values change, every other character stays.

Not by ruamel.yaml, which writes the whole file anew: comments stay, but columns, indentation and blanks become its own,
and the comment below a list goes with the list when that is replaced.
"""

import difflib
import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import yaml
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from caris_desktop.domain.yaml_source import know_scalars

_ABSENT = object()


class UnusualLayoutError(Exception):
    """The text is laid out in a way that cannot be changed here and there; it has to be written whole."""


class _Edit(NamedTuple):
    """``text`` in place of what stands from ``start`` to ``end``."""

    start: int
    end: int
    text: str


class _ReadableDumper(yaml.SafeDumper):
    """Indents list items under their key, as people write them, and quotes what readers of old YAML would mistake."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        super().increase_indent(flow, False)


know_scalars(_ReadableDumper)


def yaml_text(data: Any) -> str:
    """A whole file."""
    return _dumped(data, default_flow_style=False, width=110)


def edited(text: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """``text``, which says ``old``, so that it says ``new``.

    ``old`` may have keys that the text leaves out because they have their default. Comments within what is replaced or
    removed go with it.

    Raises
    ------
    UnusualLayoutError
        If the layout of the text is too unusual for that.
    """
    whole = text if text.endswith("\n") else text + "\n"
    root = yaml.compose(whole, Loader=yaml.SafeLoader)
    if not isinstance(root, MappingNode):
        raise UnusualLayoutError
    edits = sorted(_Editor(whole).mapping(root, old, new), key=lambda edit: (edit.start, edit.end))
    if not edits:
        return text
    parts, position = [], 0
    for edit in edits:
        if edit.start < position:
            raise UnusualLayoutError
        parts += [whole[position : edit.start], edit.text]
        position = edit.end
    return "".join(parts) + whole[position:]


class _Editor:
    """Finds the edits of one text."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._line_end = "\r\n" if "\r\n" in text else "\n"

    def mapping(self, node: MappingNode, old: Mapping[str, Any], new: Mapping[str, Any]) -> list[_Edit]:
        """Keys that changed, went or came."""
        entries = {key.value: (key, value) for key, value in node.value}
        edits: list[_Edit] = []
        before: Node | None = None
        for name in new:
            wanted, said = new[name], old.get(name, _ABSENT)
            if name in entries:
                key, value = entries[name]
                if wanted != said:
                    edits += self._entry(key, value, said, wanted)
                before = value
            elif wanted != said:
                edits.append(self._added_key(node, before, name, wanted))
        for name, (key, value) in entries.items():
            if name in old and name not in new:
                edits.append(self._removed(node, key.start_mark, value, introduced_by=""))
        return edits

    def _entry(self, key: Node, value: Node, said: Any, wanted: Any) -> list[_Edit]:
        try:
            return self._within(value, said, wanted)
        except UnusualLayoutError:
            pass
        between = self._text[key.end_mark.index : value.start_mark.index]
        if "#" in between or not between.lstrip().startswith(":"):
            # A comment stands before the value: it stays, and what follows keeps its column.
            return [self._replaced(value, wanted)]
        start = key.end_mark.index + between.index(":") + 1
        if _nested(wanted):
            column = key.start_mark.column + 2
            replacement = self._line_end + " " * column + self._block(wanted, column)
        else:
            replacement = " " + _flow(wanted)
        return [_Edit(start, self._end(value), replacement)]

    def _within(self, node: Node, said: Any, wanted: Any) -> list[_Edit]:
        """Edits inside of a mapping or list, or of a scalar; UnusualLayoutError where it must be replaced whole."""
        if isinstance(node, MappingNode) and isinstance(said, dict) and isinstance(wanted, dict):
            return self.mapping(node, said, wanted)
        if isinstance(node, SequenceNode) and isinstance(said, list) and isinstance(wanted, list):
            return self._sequence(node, said, wanted)
        if isinstance(node, ScalarNode) and not isinstance(wanted, (dict, list)) and node.style not in ("|", ">"):
            return [_Edit(node.start_mark.index, node.end_mark.index, _flow(wanted))]
        raise UnusualLayoutError

    def _sequence(self, node: SequenceNode, said: Sequence[Any], wanted: Sequence[Any]) -> list[_Edit]:
        if len(node.value) != len(said) or not wanted:
            raise UnusualLayoutError
        edits: list[_Edit] = []
        old, new = [_identity(item) for item in said], [_identity(item) for item in wanted]
        matcher = difflib.SequenceMatcher(None, old, new, autojunk=False)
        for _tag, start, end, new_start, new_end in matcher.get_opcodes():
            kept = min(end - start, new_end - new_start)
            for index in range(kept):
                item = node.value[start + index]
                edits += self._item(item, said[start + index], wanted[new_start + index])
            for item in node.value[start + kept : end]:
                edits.append(self._removed(node, item.start_mark, item, introduced_by="-"))
            before = start + kept - 1
            for item in wanted[new_start + kept : new_end]:
                edits.append(self._added_item(node, node.value[before] if before >= 0 else None, item))
        return edits

    def _item(self, node: Node, said: Any, wanted: Any) -> list[_Edit]:
        if said == wanted:
            return []
        try:
            return self._within(node, said, wanted)
        except UnusualLayoutError:
            return [self._replaced(node, wanted)]

    def _replaced(self, node: Node, wanted: Any) -> _Edit:
        """All of a value, beginning where it began."""
        column = node.start_mark.column
        flow = not _nested(wanted) or getattr(node, "flow_style", False)
        return _Edit(node.start_mark.index, self._end(node), _flow(wanted) if flow else self._block(wanted, column))

    def _removed(self, parent: MappingNode | SequenceNode, start: Any, value: Node, *, introduced_by: str) -> _Edit:
        """A key with its value, or an item, with its lines."""
        line_start = self._line_start(start.index)
        if parent.flow_style or self._text[line_start : start.index].strip(" ") != introduced_by:
            raise UnusualLayoutError
        return _Edit(line_start, self._after_line(self._end(value)), "")

    def _added_key(self, parent: MappingNode, before: Node | None, name: str, value: Any) -> _Edit:
        column = parent.start_mark.column
        if parent.flow_style or before is None:
            raise UnusualLayoutError
        shown = f" {_flow(value)}"
        if _nested(value):
            shown = self._line_end + " " * (column + 2) + self._block(value, column + 2)
        at = self._after_line(self._end(before))
        while self._comment_column(at) > column:
            # It belongs to what stands above.
            at = self._after_line(at)
        return _Edit(at, at, " " * column + f"{_flow(name)}:{shown}{self._line_end}")

    def _added_item(self, parent: SequenceNode, before: Node | None, value: Any) -> _Edit:
        if parent.flow_style:
            raise UnusualLayoutError
        column = parent.start_mark.column
        if before is None:
            at = self._line_start(parent.start_mark.index)
            if self._text[at : parent.start_mark.index].strip(" "):
                raise UnusualLayoutError
            while self._comment_column(above := self._line_start(at - 1)) == column:
                # It belongs to the item that is first until now.
                at = above
        else:
            at = self._after_line(self._end(before))
        shown = self._block(value, column + 2) if _nested(value) else _flow(value)
        return _Edit(at, at, f"{' ' * column}- {shown}{self._line_end}")

    def _end(self, node: Node) -> int:
        """Where its content ends: blocks themselves reach to whatever follows, comments and empty lines included."""
        if isinstance(node, (MappingNode, SequenceNode)) and not node.flow_style and node.value:
            last = node.value[-1]
            return self._end(last[1] if isinstance(last, tuple) else last)
        end: int = node.end_mark.index
        if isinstance(node, ScalarNode) and node.style in ("|", ">"):
            start: int = node.start_mark.index
            return start + len(self._text[start:end].rstrip())
        return end

    def _comment_column(self, line_start: int) -> int:
        """Where the comment begins of which the line consists; -1 if it is something else."""
        line = self._text[line_start : self._after_line(line_start)] if line_start < len(self._text) else ""
        return line.index("#") if line.lstrip().startswith("#") else -1

    def _line_start(self, index: int) -> int:
        return self._text.rfind("\n", 0, max(index, 0)) + 1

    def _after_line(self, index: int) -> int:
        return self._text.index("\n", index) + 1

    def _block(self, value: Any, column: int) -> str:
        """Lines that stand at ``column``; the first has no indentation. What is short goes on one line."""
        text = _dumped(value, default_flow_style=None, width=10_000).rstrip("\n")
        return text.replace("\n", self._line_end + " " * column)


def _identity(item: Any) -> str:
    """By which an entry is found again: its name if it has one."""
    return str(item["name"]) if isinstance(item, dict) and "name" in item else json.dumps(item)


def _nested(value: Any) -> bool:
    """Whether it is too much for one line: something in it holds something else."""
    items = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return any(isinstance(item, (dict, list)) and item for item in items)


def _flow(value: Any) -> str:
    """On one line, with the quotation marks that it needs within brackets."""
    return _dumped([value], default_flow_style=True, width=10_000).rstrip("\n")[1:-1]


def _dumped(value: Any, *, default_flow_style: bool | None, width: int) -> str:
    text: str = yaml.dump(
        value,
        Dumper=_ReadableDumper,
        sort_keys=False,
        allow_unicode=True,
        default_flow_style=default_flow_style,
        width=width,
    )
    return text
