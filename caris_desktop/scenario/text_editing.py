"""Editing of YAML text that preserves every character outside of the changed values.

ruamel.yaml is not used, since it rewrites the whole file: comments stay, but columns, indentation and blank lines
change, and a comment after a list is lost with the list.
"""

import difflib
import json
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import yaml
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from caris_desktop.domain.key_path import KeyPath
from caris_desktop.domain.yaml_source import LocatedData, PlainScalars, know_scalars, located
from caris_desktop.domain.yaml_writing import dumped

_ABSENT = object()
_SHORT = 60
"""Characters that stand behind their key, also where a block was."""


class UnusualLayoutError(Exception):
    """Layout that cannot be edited in place; the whole text must be rewritten."""


class _Edit(NamedTuple):
    """``text`` replaces ``start`` to ``end``."""

    start: int
    end: int
    text: str


# libyaml's composer, if available, returns the same nodes twenty times as fast.
_Fastest: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_FastLoader: Any = type("_FastLoader", (PlainScalars, _Fastest), {"yaml_implicit_resolvers": {}})
know_scalars(_FastLoader)


def quick_data(text: str) -> LocatedData:
    """Data of trusted text, written by the program; ``parse_yaml`` is for all other text."""
    return located(_root(text))


def edited(text: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """Change ``text``, whose content is ``old``, to ``new``.

    ``old`` may have keys that the text omits as defaults. Comments within replaced or removed parts are lost.

    Raises
    ------
    UnusualLayoutError
        If the layout of the text is too unusual for that.
    """
    ended = _ended(text)
    return _applied(text, ended, _Editor(ended).mapping(_root(ended), old, new))


def with_value(text: str, path: KeyPath, value: Any, behind: Sequence[str] = ()) -> str:
    """Set ``value`` at ``path``. Missing keys on the path are added: the first one after the last of those named
    ``behind``, or before all others.

    Raises UnusualLayoutError.
    """
    ended = _ended(text)
    return _applied(text, ended, _Editor(ended).value_at(_root(ended), path, value, behind))


def without(text: str, path: KeyPath) -> str:
    """Remove the key or entry at ``path``; an emptied group or list stays.

    Raises UnusualLayoutError.
    """
    ended = _ended(text)
    return _applied(text, ended, _Editor(ended).removed_at(_root(ended), path))


def with_entry(text: str, path: KeyPath, value: Any) -> str:
    """Insert an entry into a list, at the index at the end of ``path``. Raises UnusualLayoutError."""
    ended = _ended(text)
    return _applied(text, ended, _Editor(ended).entry_added_at(_root(ended), path, value))


def with_entry_moved(text: str, path: KeyPath, place: int) -> str:
    """Move the entry at ``path`` within its list, including its comments.

    Raises UnusualLayoutError.
    """
    ended = _ended(text)
    return _applied(text, ended, _Editor(ended).entry_moved(_root(ended), path, place))


def _ended(text: str) -> str:
    return text if text.endswith("\n") else text + "\n"


def _root(text: str) -> MappingNode:
    try:
        loader = _FastLoader(text)
        try:
            root = loader.get_single_node()
        finally:
            loader.dispose()
    except yaml.YAMLError as error:
        raise UnusualLayoutError from error
    if not isinstance(root, MappingNode):
        raise UnusualLayoutError
    return root


def _applied(text: str, ended: str, edits: list[_Edit]) -> str:
    if not edits:
        return text
    parts, position = [], 0
    for edit in sorted(edits, key=lambda edit: (edit.start, edit.end)):
        if edit.start < position:
            raise UnusualLayoutError
        parts += [ended[position : edit.start], edit.text]
        position = edit.end
    return "".join(parts) + ended[position:]


class _Editor:
    """Computes the edits of one text."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._brackets: list[tuple[int, int]] | None = None
        self._line_end = "\r\n" if "\r\n" in text else "\n"

    # ---- at one place

    def value_at(self, root: MappingNode, path: KeyPath, value: Any, behind: Sequence[str]) -> list[_Edit]:
        *above, last = path
        parent: Node = root
        for number, part in enumerate(above):
            found = _child(parent, part)
            if found is None or _is_nothing(found):
                nested = _nest(path[number + 1 :], value)
                return self._set_in(parent, part, nested, behind)
            parent = found
        return self._set_in(parent, last, value, behind)

    def _set_in(self, parent: Node, part: str | int, value: Any, behind: Sequence[str]) -> list[_Edit]:
        if isinstance(parent, SequenceNode) and isinstance(part, int) and 0 <= part < len(parent.value):
            node = parent.value[part]
            return self._item(node, located(node).data, value)
        if not isinstance(parent, MappingNode) or not isinstance(part, str):
            raise UnusualLayoutError
        entries = {key.value: (key, node) for key, node in parent.value}
        if part in entries:
            key, node = entries[part]
            return self._entry(key, node, located(node).data, value)
        before = [node for name, (_key, node) in entries.items() if name in behind]
        return [self._added_key(parent, before[-1] if before else None, part, value)]

    def removed_at(self, root: MappingNode, path: KeyPath) -> list[_Edit]:
        *above, last = path
        parent: Node = root
        for part in above:
            found = _child(parent, part)
            if found is None:
                return []
            parent = found
        if isinstance(parent, SequenceNode) and isinstance(last, int) and 0 <= last < len(parent.value):
            if len(parent.value) == 1:
                return self.value_at(root, path[:-1], [], ())
            item = parent.value[last]
            return [self._removed(parent, item.start_mark, item, introduced_by="-")]
        entries = {key.value: (key, node) for key, node in parent.value} if isinstance(parent, MappingNode) else {}
        if last not in entries:
            return []
        if len(entries) == 1:
            return self.value_at(root, path[:-1], {}, ())
        key, node = entries[last]
        return [self._removed(parent, key.start_mark, node, introduced_by="")]

    def entry_added_at(self, root: MappingNode, path: KeyPath, value: Any) -> list[_Edit]:
        parent, place = _list_and_place(root, path)
        if not parent.value:
            raise UnusualLayoutError
        if parent.flow_style and len(self._line_at(parent)) + len(_flow(value)) > LINE_WIDTH:
            raise UnusualLayoutError
        return [self._added_item(parent, parent.value[place - 1] if place else None, value)]

    def entry_moved(self, root: MappingNode, path: KeyPath, place: int) -> list[_Edit]:
        parent, index = _list_and_place(root, path)
        ranges = [self._span(parent, number) for number in range(len(parent.value))]
        pieces = [self._text[start:end] for start, end in ranges]
        pieces.insert(place, pieces.pop(index))
        return [
            _Edit(start, end, piece)
            for (start, end), piece in zip(ranges, pieces, strict=True)
            if self._text[start:end] != piece
        ]

    def _span(self, parent: SequenceNode, number: int) -> tuple[int, int]:
        """Span of an entry to move: its lines with its own comments, if it has its own lines."""
        node = parent.value[number]
        if parent.flow_style:
            return node.start_mark.index, self._end(node)
        column, start = parent.start_mark.column, self._line_start(node.start_mark.index)
        if self._text[start : node.start_mark.index].strip(" ") != "-":
            raise UnusualLayoutError
        while start and self._comment_column(above := self._line_start(start - 1)) == column:
            start = above
        end = self._after_line(self._end(node))
        while self._comment_column(end) > column:
            end = self._after_line(end)
        return start, end

    # ---- what differs

    def mapping(self, node: MappingNode, old: Mapping[str, Any], new: Mapping[str, Any]) -> list[_Edit]:
        """Edits for changed, removed and added keys."""
        entries = {key.value: (key, value) for key, value in node.value}
        if not any(name in entries for name in new):
            # Different content altogether.
            raise UnusualLayoutError
        edits: list[_Edit] = []
        before: Node | None = None
        for name in new:
            new_value, old_value = new[name], old.get(name, _ABSENT)
            if name in entries:
                key, value = entries[name]
                if new_value != old_value:
                    edits += self._entry(key, value, old_value, new_value)
                before = value
            elif new_value != old_value:
                edits.append(self._added_key(node, before, name, new_value))
        for name, (key, value) in entries.items():
            if name in old and name not in new:
                edits.append(self._removed(node, key.start_mark, value, introduced_by=""))
        return edits

    def _entry(self, key: Node, value: Node, old: Any, new: Any) -> list[_Edit]:
        try:
            return self._within(value, old, new)
        except UnusualLayoutError:
            pass
        between = self._text[key.end_mark.index : value.start_mark.index]
        if "#" in between or not between.lstrip().startswith(":"):
            # A comment before the value: it stays, and what follows preserves its column.
            return [self._replaced(value, new)]
        start = key.end_mark.index + between.index(":") + 1
        column = key.start_mark.column + 2
        if isinstance(new, str) and self._starts_line(key):
            return [self._text_edit(start, value, new, column)]
        if _nested(new, column):
            replacement = self._line_end + " " * column + self._block(new, column)
        else:
            replacement = " " + _flow(new)
        return [_Edit(start, self._end(value), replacement)]

    def _text_edit(self, start: int, value: Node, new: str, column: int) -> _Edit:
        """Edit of a text value, as a block if it was one or has several lines. A trailing comment stays."""
        end = self._end(value)
        style = value.style if isinstance(value, ScalarNode) else None
        in_block = "\n" in new or (style in ("|", ">") and len(new) > _SHORT)
        if style in ("|", ">"):
            first_line_end = self._text.index("\n", value.start_mark.index)
            header = self._text[value.start_mark.index : first_line_end].rstrip("\r")
            comment = header[header.index("#") :] if "#" in header else ""
            gap = header[: header.index("#")] if comment else ""
            gap = gap[len(gap.rstrip()) :]
            body = body_of(self._text[first_line_end + 1 : end])
            replacement = folded_again(new, column, body) if style == ">" and in_block else None
        else:
            rest_end = self._text.index("\n", end)
            rest = self._text[end:rest_end].rstrip("\r")
            comment = rest.lstrip() if rest.lstrip().startswith("#") else ""
            gap, replacement = rest[: len(rest) - len(rest.lstrip())], None
            end = end + len(rest) if comment else end
        if replacement is None and in_block:
            replacement = written_block(new, column, folded=style != "|")
        behind = f"{gap}{comment}" if comment else ""
        if replacement is None:
            return _Edit(start, end, f" {_plain(new)}{behind}")
        mark, lines = replacement
        return _Edit(start, end, self._line_end.join((f" {mark}{behind}", *lines)))

    def _in_brackets(self, node: Node) -> bool:
        """True inside a flow list or mapping, where commas and brackets are syntax."""
        if self._brackets is None:
            self._brackets = list(_brackets(_root(self._text)))
        return any(start < node.start_mark.index < end for start, end in self._brackets)

    def _starts_line(self, key: Node) -> bool:
        """True if a key is in a block: text inside brackets has no separate lines."""
        before = self._text[self._line_start(key.start_mark.index) : key.start_mark.index]
        return not before.strip(" -")

    def _within(self, node: Node, old: Any, new: Any) -> list[_Edit]:
        """Edits inside a mapping, list or scalar; UnusualLayoutError if it must be replaced."""
        if isinstance(node, MappingNode) and isinstance(old, dict) and isinstance(new, dict) and node.value:
            return self.mapping(node, old, new)
        if isinstance(node, SequenceNode) and isinstance(old, list) and isinstance(new, list):
            return self._sequence(node, old, new)
        if isinstance(node, ScalarNode) and not isinstance(new, (dict, list)) and node.style not in ("|", ">"):
            if isinstance(new, str) and "\n" in new:
                raise UnusualLayoutError
            replacement = _flow(new) if self._in_brackets(node) else _plain(new)
            if node.style == '"' and isinstance(new, str):
                replacement = one_line(new)
            return [_Edit(node.start_mark.index, node.end_mark.index, replacement)]
        raise UnusualLayoutError

    def _sequence(self, node: SequenceNode, old_items: Sequence[Any], new_items: Sequence[Any]) -> list[_Edit]:
        if len(node.value) != len(old_items) or not new_items:
            raise UnusualLayoutError
        edits: list[_Edit] = []
        old, new = [_identity(item) for item in old_items], [_identity(item) for item in new_items]
        matcher = difflib.SequenceMatcher(None, old, new, autojunk=False)
        for _tag, start, end, new_start, new_end in matcher.get_opcodes():
            common = min(end - start, new_end - new_start)
            for index in range(common):
                item = node.value[start + index]
                edits += self._item(item, old_items[start + index], new_items[new_start + index])
            for item in node.value[start + common : end]:
                edits.append(self._removed(node, item.start_mark, item, introduced_by="-"))
            before = start + common - 1
            for item in new_items[new_start + common : new_end]:
                edits.append(self._added_item(node, node.value[before] if before >= 0 else None, item))
        return edits

    def _item(self, node: Node, old: Any, new: Any) -> list[_Edit]:
        if old == new:
            return []
        try:
            return self._within(node, old, new)
        except UnusualLayoutError:
            return [self._replaced(node, new)]

    def _replaced(self, node: Node, new: Any) -> _Edit:
        """Replace a whole value, from its start."""
        column = node.start_mark.column
        flow = not _nested(new, column) or getattr(node, "flow_style", False)
        return _Edit(node.start_mark.index, self._end(node), _flow(new) if flow else self._block(new, column))

    def _removed(self, parent: Node, start: Any, value: Node, *, introduced_by: str) -> _Edit:
        """Remove a key with its value, or an item: its lines, or its part between brackets."""
        if getattr(parent, "flow_style", False):
            return self._removed_between(parent, start.index, value)
        line_start = self._line_start(start.index)
        lead = self._text[line_start : start.index].strip(" ")
        if lead == introduced_by:
            return _Edit(line_start, self._after_line(self._end(value)), "")
        if lead.strip("- ") == "" and isinstance(parent, MappingNode) and parent.value[0][1] is value:
            # The first key of an entry: the next one moves behind the dash.
            return _Edit(start.index, parent.value[1][0].start_mark.index, "")
        raise UnusualLayoutError

    def _removed_between(self, parent: Node, start: int, value: Node) -> _Edit:
        starts = [_start(each) for each in parent.value]
        ends = [self._end(each[1] if isinstance(each, tuple) else each) for each in parent.value]
        number = starts.index(start)
        if number:
            return _Edit(ends[number - 1], ends[number], "")
        if len(starts) == 1:
            return _Edit(start, self._end(value), "")
        return _Edit(start, starts[1], "")

    def _added_key(self, parent: MappingNode, before: Node | None, name: str, value: Any) -> _Edit:
        if not parent.value:
            raise UnusualLayoutError
        if parent.flow_style:
            return self._added_between(parent, before, f"{_flow(name)}: {_flow(value)}")
        column = parent.start_mark.column
        replacement = self._behind_key(value, column + 2)
        if before is None:
            first = parent.value[0][0].start_mark.index
            at = self._line_start(first)
            if self._text[at:first].strip(" "):
                # After the dash of an entry, or at the start of the file.
                return _Edit(first, first, f"{_flow(name)}:{replacement}{self._line_end}{' ' * column}")
            return _Edit(at, at, f"{' ' * column}{_flow(name)}:{replacement}{self._line_end}")
        at = self._after_line(self._end(before))
        while self._comment_column(at) > column:
            # The comment belongs to the entry above.
            at = self._after_line(at)
        return _Edit(at, at, " " * column + f"{_flow(name)}:{replacement}{self._line_end}")

    def _behind_key(self, value: Any, column: int) -> str:
        if isinstance(value, str) and (block := written_block(value, column, folded=True)) and "\n" in value:
            mark, lines = block
            return self._line_end.join((f" {mark}", *lines))
        if _nested(value, column):
            return self._line_end + " " * column + self._block(value, column)
        return f" {_plain(value)}"

    def _added_item(self, parent: SequenceNode, before: Node | None, value: Any) -> _Edit:
        if parent.flow_style:
            return self._added_between(parent, before, _flow(value))
        column = parent.start_mark.column
        if before is None:
            at = self._line_start(parent.start_mark.index)
            if self._text[at : parent.start_mark.index].strip(" "):
                raise UnusualLayoutError
            while self._comment_column(above := self._line_start(at - 1)) == column:
                # The comment belongs to the item that was first.
                at = above
        else:
            at = self._after_line(self._end(before))
        replacement = self._block(value, column + 2) if _nested(value, column + 2) else _plain(value)
        return _Edit(at, at, f"{' ' * column}- {replacement}{self._line_end}")

    def _added_between(self, parent: Node, before: Node | None, replacement: str) -> _Edit:
        """Insertion within brackets."""
        if before is not None:
            end = self._end(before)
            return _Edit(end, end, f", {replacement}")
        if not parent.value:
            raise UnusualLayoutError
        start = _start(parent.value[0])
        return _Edit(start, start, f"{replacement}, ")

    def _end(self, node: Node) -> int:
        """End of the content: block nodes themselves extend over following comments and empty lines."""
        if isinstance(node, (MappingNode, SequenceNode)) and not node.flow_style and node.value:
            last = node.value[-1]
            return self._end(last[1] if isinstance(last, tuple) else last)
        end: int = node.end_mark.index
        if isinstance(node, ScalarNode) and node.style in ("|", ">"):
            start: int = node.start_mark.index
            return start + len(self._text[start:end].rstrip())
        return end

    def _comment_column(self, line_start: int) -> int:
        """Column of the comment in a comment line; else -1."""
        line = self._text[line_start : self._after_line(line_start)] if line_start < len(self._text) else ""
        return line.index("#") if line.lstrip().startswith("#") else -1

    def _line_start(self, index: int) -> int:
        return self._text.rfind("\n", 0, max(index, 0)) + 1

    def _after_line(self, index: int) -> int:
        return self._text.index("\n", index) + 1

    def _line_at(self, node: Node) -> str:
        start = self._line_start(node.start_mark.index)
        return self._text[start : self._after_line(start)]

    def _block(self, value: Any, column: int) -> str:
        """Lines at ``column``, the first without indentation. Short values go on one line."""
        return (self._line_end + " " * column).join(_block_lines(value, column))


def _list_and_place(root: Node, path: KeyPath) -> tuple[SequenceNode, int]:
    """List and index of the place. Raises UnusualLayoutError if there is none."""
    *above, place = path
    parent: Node | None = root
    for part in above:
        parent = None if parent is None else _child(parent, part)
    if not isinstance(parent, SequenceNode) or not isinstance(place, int):
        raise UnusualLayoutError
    return parent, place


def _child(node: Node, part: str | int) -> Node | None:
    if isinstance(node, SequenceNode) and isinstance(part, int):
        return node.value[part] if 0 <= part < len(node.value) else None
    if isinstance(node, MappingNode):
        return next((value for key, value in node.value if key.value == part), None)
    return None


def _is_nothing(node: Node) -> bool:
    """True for ``key:`` without a value, or a group without keys."""
    return (isinstance(node, ScalarNode) and node.tag.endswith(":null")) or (
        isinstance(node, MappingNode) and not node.value
    )


def _nest(path: KeyPath, value: Any) -> Any:
    for part in reversed(path):
        value = {part: value} if isinstance(part, str) else [value]
    return value


def _start(entry: Any) -> int:
    start: int = (entry[0] if isinstance(entry, tuple) else entry).start_mark.index
    return start


def _identity(item: Any) -> str:
    """Identity of an entry: its name if it has one."""
    return str(item["name"]) if isinstance(item, dict) and "name" in item else json.dumps(item)


def _nested(value: Any, column: int) -> bool:
    """True if the value needs several lines: nested, too long, or multi-line."""
    if not isinstance(value, (dict, list)) or not value:
        return False
    items = list(value.values()) if isinstance(value, dict) else value
    if any(isinstance(item, (dict, list)) and item for item in items):
        return True
    if any(isinstance(item, str) and "\n" in item for item in items):
        return True
    return column + len(_flow(value)) > LINE_WIDTH


def _block_lines(value: Any, column: int) -> list[str]:
    """``value`` in lines, without indentation of the first."""
    if not _nested(value, column):
        return [_plain(value)]
    lines: list[str] = []
    if isinstance(value, list):
        for item in value:
            first, *others = _block_lines(item, column + 2)
            lines += [f"- {first}", *(f"  {line}" for line in others)]
        return lines
    for name, item in value.items():
        key = f"{_flow(name)}:"
        if _nested(item, column + 2):
            lines += [key, *(f"  {line}" for line in _block_lines(item, column + 2))]
        elif isinstance(item, str) and "\n" in item and (block := written_block(item, 2, folded=True)):
            mark, body = block
            lines += [f"{key} {mark}", *body]
        else:
            lines.append(f"{key} {_plain(item)}")
    return lines


def _brackets(node: Node) -> Iterator[tuple[int, int]]:
    """Spans of brackets."""
    if isinstance(node, (MappingNode, SequenceNode)):
        if node.flow_style:
            yield node.start_mark.index, node.end_mark.index
            return
        for entry in node.value:
            yield from _brackets(entry[1] if isinstance(entry, tuple) else entry)


def _plain(value: Any) -> str:
    """One line in block context, where texts need fewer quotation marks."""
    if not isinstance(value, str) or "\n" in value:
        return _flow(value)
    return dumped([value], default_flow_style=False, width=10_000).rstrip("\n").removeprefix("- ")


def _flow(value: Any) -> str:
    """One line in flow context, quoted as necessary."""
    if isinstance(value, str) and "\n" in value:
        return one_line(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_flow(name)}: {_flow(item)}" for name, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_flow(item) for item in value) + "]"
    return dumped([value], default_flow_style=True, width=10_000).rstrip("\n")[1:-1]


LINE_WIDTH = 120
_FOLDED_WIDTH = 112
_FOLDABLE = re.compile(r"(?!\s)[^\n\r\t]*(?<! )")

Block = tuple[str, list[str]]
"""The mark behind the key, and the lines below it with their indentation."""


def one_line(text: str) -> str:
    """Quoted, with escaped line ends."""
    written: str = yaml.safe_dump("".join(text), default_style='"', allow_unicode=True, width=float("inf"))
    return written.rstrip("\n")


def written_block(text: str, column: int, *, folded: bool) -> Block | None:
    """Block lines of ``text``; None if no block can represent it. ``folded``: long lines are wrapped."""
    if folded and (block := folded_again(text, column, [])):
        return block
    body = text.rstrip("\n")
    ends = len(text) - len(body)
    mark = "|" + ("-" if ends == 0 else "" if ends == 1 else "+")
    lines = [" " * column + line if line else "" for line in body.split("\n")] + [""] * max(0, ends - 1)
    return _checked(text, mark, lines)


def body_of(lines: str) -> list[str]:
    """Lines of a block without indentation."""
    return textwrap.dedent(lines.replace("\r\n", "\n")).split("\n")


def folded_again(text: str, column: int, body: list[str]) -> Block | None:
    """``text`` in folded lines, preserving equal ones of ``body``; None if impossible."""
    known = {" ".join(lines): lines for lines in _paragraphs(body)}
    lines: list[str] = []
    for number, part in enumerate(text.split("\n")):
        if part and not _FOLDABLE.fullmatch(part):
            return None
        lines += [""] if number else []
        if part:
            lines += known.get(part) or _wrapped(part, _FOLDED_WIDTH - column)
    return _checked(text, ">-", [" " * column + line if line else "" for line in lines])


def _paragraphs(lines: list[str]) -> list[list[str]]:
    found: list[list[str]] = [[]]
    for line in lines:
        if line.strip():
            found[-1].append(line)
        elif found[-1]:
            found.append([])
    return [lines for lines in found if lines]


def _wrapped(text: str, width: int) -> list[str]:
    """Wrap at single spaces only: a line break replaces one."""
    lines = [""]
    for word in re.split(r"(?<! ) (?! )", text):
        if lines[-1] and len(lines[-1]) + 1 + len(word) > width:
            lines.append(word)
        else:
            lines[-1] = f"{lines[-1]} {word}" if lines[-1] else word
    return lines


def _checked(text: str, mark: str, lines: list[str]) -> Block | None:
    """The block, if it parses to ``text``: leading blanks or special characters may prevent that."""
    try:
        parsed = yaml.safe_load("\n".join((f"a: {mark}", *lines, "b:", "")))
    except yaml.YAMLError:
        return None
    return (mark, lines) if isinstance(parsed, dict) and parsed.get("a") == text else None
