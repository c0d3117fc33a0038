"""Editing of YAML text by ruamel.yaml, which preserves comments, order and quotation marks.

It writes only the sections that change (keys of the file with their values), and only the lines that change are taken
from it: the other ones keep their own columns and indentation.
"""

import difflib
import io
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import yaml
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import YAMLError
from ruamel.yaml.scalarstring import (
    DoubleQuotedScalarString,
    FoldedScalarString,
    LiteralScalarString,
    PlainScalarString,
    SingleQuotedScalarString,
)
from ruamel.yaml.util import load_yaml_guess_indent

from caris_desktop.domain.schema_fields import KeyPath
from caris_desktop.domain.yaml_files import (
    LocatedData,
    PlainScalars,
    YamlSourceError,
    dumped,
    know_scalars,
    located,
    yaml_text,
)

Context = Literal["flow", "map", "list"]
"""What a value stands in: brackets, or lines of a group or list."""
_LINE_WIDTH = 120
_FOLDED_WIDTH = 110
_SHORT = 60
"""Characters that stand behind their key, also where a block was."""
_ABSENT = object()
_COMMENT_BEHIND = re.compile(r"[ \t]+#.*")
_NOT_FOLDABLE = re.compile(r"^ |[\t\r]| $", re.MULTILINE)

# libyaml's composer, if available, returns the same nodes twenty times as fast.
_Fastest: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_FastLoader: Any = type("_FastLoader", (PlainScalars, _Fastest), {"yaml_implicit_resolvers": {}})
know_scalars(_FastLoader)


def quick_data(text: str) -> LocatedData:
    """Data of trusted text, written by the program; ``parse_yaml`` is for all other text.

    Raises YamlSourceError.
    """
    loader = _FastLoader(text)
    try:
        root = loader.get_single_node()
    except yaml.YAMLError as error:
        raise YamlSourceError(str(error), 1) from error
    finally:
        loader.dispose()
    if not isinstance(root, yaml.MappingNode):
        raise YamlSourceError("no list of keys", 1)
    return located(root)


def edited(text: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """Change ``text``, whose content is ``old``, to ``new``. A text of unusual layout is written anew.

    ``old`` may have keys that the text omits as defaults. Comments within replaced or removed parts are lost.
    """
    lines = text.replace("\r\n", "\n").removesuffix("\n").split("\n")
    try:
        for names, start, end in reversed(_sections(lines, old, new)):
            before, after = ({name: data[name] for name in data if name in names} for data in (old, new))
            if _differ(before, after):
                lines[start:end] = _rewritten(lines[start:end], before, after)
    except (YAMLError, ValueError):
        return yaml_text(new)
    return ("\r\n" if "\r\n" in text else "\n").join((*lines, ""))


def with_entry_moved(text: str, path: KeyPath, place: int) -> str:
    """Move the entry at ``path`` within its list, with its comments; unchanged if the entries have no lines of their
    own.
    """
    lines, found = text.split("\n"), quick_data(text).lines
    above, index = path[:-1], int(path[-1])
    starts = [line - 1 for each, line in found.items() if len(each) == len(path) and each[:-1] == above]
    dashes = {lines[start].find("- ") if lines[start].lstrip().startswith("- ") else -1 for start in starts}
    if len(dashes) > 1 or -1 in dashes:
        return text
    (column,) = dashes
    after = (line - 1 for each, line in found.items() if line - 1 > starts[-1] and each[: len(above)] != above)
    end = min(after, default=len(lines))
    while not lines[end - 1].strip() or -1 < _comment_column(lines[end - 1]) <= column:
        end -= 1
    for number in range(len(starts)):
        while starts[number] > 0 and _comment_column(lines[starts[number] - 1]) == column:
            starts[number] -= 1
    pieces = [lines[start:stop] for start, stop in zip(starts, [*starts[1:], end], strict=True)]
    pieces.insert(place, pieces.pop(index))
    lines[starts[0] : end] = [line for piece in pieces for line in piece]
    return "\n".join(lines)


def _comment_column(line: str) -> int:
    """Column of the comment in a comment line; else -1."""
    return line.index("#") if line.lstrip().startswith("#") else -1


def _sections(lines: Sequence[str], old: Mapping[str, Any], new: Mapping[str, Any]) -> list[tuple[set[str], int, int]]:
    """Keys and lines of each section. A new key belongs to the section that it follows."""
    found = quick_data("\n".join(lines)).lines
    starts = {str(path[0]): line - 1 for path, line in found.items() if len(path) == 1}
    if not all(re.match(rf"(['\"]?){re.escape(name)}\1 *:", lines[start]) for name, start in starts.items()):
        return [({*old, *new}, 0, len(lines))]
    names = {name: {name} for name in starts}
    last = next(iter(names))
    for name in new:
        last = name if name in names else last
        names[last].add(name)
    return list(zip(names.values(), starts.values(), [*list(starts.values())[1:], len(lines)], strict=True))


def _rewritten(lines: list[str], old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """Section with another content."""
    source = "\n".join((*lines, ""))
    writer = YAML()
    writer.preserve_quotes = True
    writer.width = 100_000  # what is folded stays so, and nothing else is folded
    root, indent, offset = load_yaml_guess_indent(source, yaml=writer)
    writer.indent(mapping=2, sequence=indent if offset is not None else 4, offset=2 if offset is None else offset)

    def written() -> list[str]:
        stream = io.StringIO()
        writer.dump(root, stream)
        return stream.getvalue().removesuffix("\n").split("\n") if root else []

    before = written()
    _update(root, old, new)
    after = written()
    result = _carried_over(lines, before, after)
    same = not after or quick_data("\n".join((*result, ""))).data == quick_data("\n".join((*after, ""))).data
    return result if same else after


def _carried_over(lines: list[str], before: list[str], after: list[str]) -> list[str]:
    """``lines`` with the change from ``before``, which differs from them in formatting only, to ``after``."""
    first, last = _places(lines, before)
    alone, behind = _comments(lines)
    result: list[str] = []
    done = 0
    for what, start, end, new_start, new_end in _matcher(before, after).get_opcodes():
        if what == "equal":
            continue
        # Parts of other formatting are replaced as a whole.
        earlier = next(number for number in range(start + 1) if first[start - number] is not None)
        later = next(number for number in range(len(last) - end) if last[end + number] is not None)
        begin, stop = first[start - earlier] or 0, last[end + later] or 0
        added = after[new_start - earlier : new_end + later]
        if begin < done:
            return after
        if start - earlier == end + later:
            # An insertion: a comment belongs to what follows, unless it is further right.
            stop = begin
            column = len(added[0]) - len(added[0].lstrip())
            while begin - 1 in alone and begin > max(done, 1) and _comment_column(lines[begin - 1]) <= column:
                begin -= 1
            result += [*lines[done:begin], *added, *lines[begin:stop]]
        else:
            content = stop
            while content > begin and content - 1 in alone:
                content -= 1
            for number, line in enumerate(added):
                comment = behind.get(begin + number, "") if begin + number < content else ""
                if comment and line.endswith(comment.lstrip()):
                    added[number] = line.removesuffix(comment.lstrip()).rstrip() + comment
                elif number == 0:
                    added[number] += comment
            kept = begin + 1
            while added and kept < content and kept in alone:
                kept += 1
            result += [*lines[done:begin], *added, *lines[begin + 1 : kept], *lines[content:stop]]
        done = stop
    return result + lines[done:]


def _matcher(one: Sequence[str], other: Sequence[str]) -> difflib.SequenceMatcher[str]:
    """Differences; empty lines are equal only beside others that are."""
    return difflib.SequenceMatcher(lambda line: not line, one, other, autojunk=False)


def _places(lines: list[str], before: list[str]) -> tuple[list[int | None], list[int | None]]:
    """Place in ``lines`` of the start and of the end at each place of ``before``; None within parts that differ."""
    first: list[int | None] = [None] * (len(before) + 1)
    last = list(first)
    for _what, start, end, own_start, own_end in _matcher(before, lines).get_opcodes():
        first[start], last[end] = own_start, own_end
        if end - start == own_end - own_start:
            first[start : end + 1] = last[start : end + 1] = range(own_start, own_end + 1)
    first[0], last[-1] = 0, len(lines)
    return first, last


def _comments(lines: list[str]) -> tuple[set[int], dict[int, str]]:
    """Lines that contain only a comment or nothing; comments behind something else, with the space before them."""
    inside: set[int] = set()
    ends: dict[int, int] = {}
    for token in yaml.scan("\n".join((*lines, "")), Loader=_Fastest):
        start, end = token.start_mark, token.end_mark
        in_lines = isinstance(token, yaml.ScalarToken) and token.style in ("|", ">")
        ends |= {start.line: start.column + 1} if in_lines else {end.line: end.column}
        if isinstance(token, yaml.ScalarToken):
            inside |= set(range(start.line + 1, end.line + (end.column > 0)))
    comments = {number for number, line in enumerate(lines) if line.lstrip().startswith("#")} - inside
    alone = comments | {number for number, line in enumerate(lines) if not line.strip()}
    found = {number: _COMMENT_BEHIND.search(lines[number], at) for number, at in ends.items() if number < len(lines)}
    return alone, {number: comment[0] for number, comment in found.items() if comment and number not in alone}


def _differ(one: Any, other: Any) -> bool:
    """True also for ``1`` and ``1.0``."""
    return repr(one) != repr(other)


def _update(node: CommentedMap, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    for name in [name for name in node if name in old and name not in new]:
        del node[name]
    place, column, within = 0, node.lc.col + 2, _context(node)
    for name, value in new.items():
        before = old.get(name, _ABSENT)
        if name in node:
            if _differ(before, value):
                _replace(node, name, _updated(node[name], before, value, column, within))
            place = list(node).index(name) + 1
        elif _differ(before, value):
            node.insert(place, _fresh(name, 0, within), _fresh(value, column, within))
            place += 1


def _replace(parent: CommentedMap | CommentedSeq, place: Any, node: Any) -> None:
    """Put ``node`` in a place; the comments of another one are carried over as lines."""
    if parent[place] is not node:
        parent.ca.items.pop(place, None)
        parent[place] = node


def _context(node: CommentedMap | CommentedSeq) -> Context:
    return "flow" if node.fa.flow_style() else "map" if isinstance(node, CommentedMap) else "list"


def _updated(node: Any, old: Any, new: Any, column: int, within: Context) -> Any:
    """Node of another value, the same one where possible."""
    if (
        isinstance(node, CommentedMap)
        and isinstance(old, dict)
        and isinstance(new, dict)
        and any(map(node.__contains__, new))
    ):
        _update(node, old, new)
        return node
    if isinstance(node, CommentedSeq) and isinstance(old, list) and isinstance(new, list) and len(node) == len(old):
        too_long = len(new) > len(old) and node.fa.flow_style() and _is_nested(new, column)
        if node and new and not too_long:
            _update_list(node, old, new)
            return node
    if isinstance(new, str) and within == "map" and ("\n" in new or len(new) > _SHORT):
        if isinstance(node, FoldedScalarString):
            return _folded(new, column, node)
        if isinstance(node, LiteralScalarString):
            return LiteralScalarString(new)
    if isinstance(new, str) and isinstance(node, DoubleQuotedScalarString) and "\n" not in new:
        return DoubleQuotedScalarString(new)
    return _fresh(new, column, within)


def _update_list(node: CommentedSeq, old: Sequence[Any], new: Sequence[Any]) -> None:
    matcher = _matcher([_identity(item) for item in old], [_identity(item) for item in new])
    column, within = node.lc.col + 2, _context(node)
    for _what, start, end, new_start, new_end in reversed(matcher.get_opcodes()):
        common = min(end - start, new_end - new_start)
        del node[start + common : end]
        for item in reversed(new[new_start + common : new_end]):
            node.insert(start + common, _fresh(item, column, within))
        for number in range(common):
            place, before, item = start + number, old[start + number], new[new_start + number]
            if _differ(before, item):
                _replace(node, place, _updated(node[place], before, item, column, within))


def _identity(item: Any) -> str:
    """Identity of an entry: its name if it has one."""
    return str(item["name"]) if isinstance(item, dict) and "name" in item else json.dumps(item)


def _fresh(value: Any, column: int, within: Context) -> Any:
    """Node of a new value at ``column``."""
    if isinstance(value, str):
        if "\n" in value:
            return _folded(value, column) if within == "map" else DoubleQuotedScalarString(value)
        written = dumped([value], default_flow_style=within == "flow", width=100_000)
        mark = written.removeprefix("[").removeprefix("- ")[0]
        # A plain str would get the style of the text that it replaces.
        return {"'": SingleQuotedScalarString, '"': DoubleQuotedScalarString}.get(mark, PlainScalarString)(value)
    if not isinstance(value, dict | list):
        return value
    node: Any = CommentedMap() if isinstance(value, dict) else CommentedSeq()
    (node.fa.set_block_style if within != "flow" and _is_nested(value, column) else node.fa.set_flow_style)()
    within = _context(node)
    if isinstance(value, dict):
        for name, item in value.items():
            node[_fresh(name, 0, within)] = _fresh(item, column + 2, within)
    else:
        node.extend(_fresh(item, column + 2, within) for item in value)
    return node


def _is_nested(value: Any, column: int) -> bool:
    """True if the value needs several lines: nested, too long, or multi-line."""
    items = list(value.values()) if isinstance(value, dict) else value
    return bool(value) and (
        any(isinstance(item, dict | list) and item for item in items)
        or any(isinstance(item, str) and "\n" in item for item in items)
        or column + len(dumped(value, default_flow_style=True, width=100_000).rstrip()) > _LINE_WIDTH
    )


def _folded(text: str, column: int, before: str = "") -> Any:
    """Text in wrapped lines, except where it cannot be wrapped; paragraphs of ``before`` keep theirs."""
    if _NOT_FOLDABLE.search(text):
        return LiteralScalarString(text)
    known = dict(_folds(before, getattr(before, "fold_pos", ())))
    node, start = FoldedScalarString(text), 0
    node.fold_pos = []
    for paragraph in text.split("\n"):
        folds = known[paragraph] if paragraph in known else _wrapped(paragraph, _FOLDED_WIDTH - column)
        node.fold_pos += [start + fold for fold in folds]
        start += len(paragraph) + 1
    return node


def _folds(text: str, places: Sequence[int]) -> Iterator[tuple[str, list[int]]]:
    """Paragraphs of a text and the folds of each."""
    start = 0
    for paragraph in text.split("\n"):
        yield paragraph, [place - start for place in places if start <= place < start + len(paragraph)]
        start += len(paragraph) + 1


def _wrapped(text: str, width: int) -> list[int]:
    """Single spaces at which lines end."""
    folds: list[int] = []
    start = last = 0
    for place in [*(found.start() for found in re.finditer(r"(?<! ) (?! )", text)), len(text)]:
        if place - start > width and last > start:
            folds.append(last)
            start = last + 1
        last = place
    return folds
