"""Generator of the key tables in the guide, from the action table.

Run by ``python -m caris_desktop.app.generated_reference``; writes to ``resources/``.
"""

import re
from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path

from caris_desktop.domain.shipped import resources_dir
from caris_desktop.ui.action_rows import ACTIONS, QUEUE_GROUP, REPLAY_ACTIONS, TIMELINE_ACTIONS, ActionSpec

_TABLES: dict[str, Sequence[ActionSpec]] = {"window": ACTIONS, "replay": (*REPLAY_ACTIONS, *TIMELINE_ACTIONS)}
_PLACE = re.compile(r"(<!-- shortcuts of (\w+) -->\n).*?(?=\n<!-- end of shortcuts -->)", re.DOTALL)
_NUMBERED = re.compile(r"_\d+$")
_WORDS = {"Return": "Enter", "Del": "Delete", "PgUp": "Page Up", "PgDown": "Page Down"}


def reference_files() -> dict[Path, str]:
    """Path and contents of the page; text between its tables stays."""
    page = resources_dir() / "guide" / "keys.md"
    return {page: _PLACE.sub(lambda found: found[1] + _table(_TABLES[found[2]]), page.read_text(encoding="utf-8"))}


def _table(specs: Iterable[ActionSpec]) -> str:
    groups: dict[str, list[ActionSpec]] = {}
    for spec in (spec.in_words() for spec in specs):
        groups.setdefault(spec.group, []).append(spec)
    return "\n\n".join(_part(group, rows) for group, rows in groups.items())


def _part(group: str, rows: Iterable[ActionSpec]) -> str:
    where = "in the list" if group == QUEUE_GROUP else "anywhere"
    lines = [f"**{group}**", "", f"| | {where} | while driving |", "| --- | --- | --- |"]
    lines += [_line(list(same)) for _stem, same in groupby(rows, key=lambda spec: _NUMBERED.sub("_", spec.id))]
    return "\n".join(lines)


def _line(rows: list[ActionSpec]) -> str:
    """Table line of one row, or of several that differ in their number."""
    first, last = rows[0], rows[-1]
    if len(rows) == 1:
        return f"| {first.text} | {_keys(first.keys)} | {_keys(first.driving_keys)} |"
    ends = last.id.rpartition("_")[2]
    text = re.sub(r"\b1\b", f"1 to {ends}", first.text)
    columns = ((first.keys, last.keys), (first.driving_keys, last.driving_keys))
    keys = (f"{_keys(begin)} to {_keys(end)}" if begin else "" for begin, end in columns)
    return f"| {text} | {' | '.join(keys)} |"


def _keys(keys: Iterable[str]) -> str:
    written = [f"`{' '.join(map(_chord, key.split(', ')))}`" for key in keys]
    return " or ".join(dict.fromkeys(written))


def _chord(chord: str) -> str:
    begin, plus, last = chord.rpartition("+") if not chord.endswith("+") else (chord[:-2], "+" * (len(chord) > 1), "+")
    return f"{begin}{plus if begin else ''}{_WORDS.get(last, last)}"
