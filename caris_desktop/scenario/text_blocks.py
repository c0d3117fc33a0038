"""YAML representations of multi-line text: literal blocks, folded blocks, or one quoted line."""

import re
import textwrap

import yaml

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
        said = yaml.safe_load("\n".join((f"a: {mark}", *lines, "b:", "")))
    except yaml.YAMLError:
        return None
    return (mark, lines) if isinstance(said, dict) and said.get("a") == text else None
