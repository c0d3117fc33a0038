"""Another valid value for each value of a scenario file, and a check of the text changes that setting it causes."""

import difflib
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import pytest
import yaml

from caris_desktop.domain.schema_fields import KeyPath, ValueForm, form_of, is_group, keys_of
from caris_desktop.domain.schema_paths import ABSENT, blank_of, default_of, value_at
from caris_desktop.domain.schema_validation import problems
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui.scenario_editor.saving import EditedDocument

T = TypeVar("T")
WORDS = (
    "Other words", "other_words", "Ctrl+Shift+Q", "fr", "ollama:llama3", "espeak:fr", "none", "ab" * 32, "https://a.org/v1",
    "wss://robot:9090", "Kitchen", "welcome", "/other_topic", "std_msgs/String", "data[1]",
)  # fmt: skip


@pytest.fixture
def sampled(request: pytest.FixtureRequest) -> Callable[[Sequence[T]], Sequence[T]]:
    """A few of many, evenly spaced; all with ``--long``."""
    if request.config.getoption("--long"):
        return lambda many: many
    return lambda many: many[3 :: max(1, len(many) // 5)]


def leaves(hint: Any, data: Any) -> Iterator[tuple[KeyPath, ValueForm]]:
    """All values of the file in its present structure: those in the file and those left at their default."""
    yield from _leaves(form_of(hint), data, ())


def _leaves(form: ValueForm, data: Any, path: KeyPath) -> Iterator[tuple[KeyPath, ValueForm]]:
    group = form.group_at(data)
    if group is not None:
        for key in keys_of(group):
            stands = value_at(data, (key.name,))
            if stands is ABSENT:
                stands = default_of(key)
            if stands is ABSENT and key.form.group_at(stands) is not None:
                # It is either absent or complete.
                yield (*path, key.name), key.form
            else:
                yield from _leaves(key.form, stands, (*path, key.name))
    elif (item := form.item) is not None:
        for number, entry in enumerate(data if isinstance(data, list) else ()):
            yield from _leaves(item, entry, (*path, number))
    else:
        yield path, form


def edited_leaves(document: EditedDocument) -> list[tuple[KeyPath, ValueForm]]:
    """All leaves except the version, which cannot be edited."""
    return [(path, form) for path, form in leaves(Scenario, document.data) if len(form.choices) != 1]


def other_value(document: EditedDocument, path: KeyPath, form: ValueForm) -> Any:
    """Another value valid at ``path`` in this file; ABSENT if there is none."""
    present = document.value(path)
    candidates = _names(document, form.rule.refers) if form.rule.refers else list(_candidates(form, present))
    for candidate in candidates:
        same = candidate == present and type(candidate) is type(present)
        if same or any(problems(form, candidate, path)):
            continue
        document.set(path, candidate)
        fits = not document.mistakes
        document.undo()
        if fits:
            return candidate
    return ABSENT


def _names(document: EditedDocument, refers: tuple[str, ...]) -> list[str]:
    """Valid values of a reference: the names defined elsewhere in the file."""
    return [entry[refers[-1]] for entry in document.value(refers[:-1]) or ()]


def _candidates(form: ValueForm, present: Any) -> Iterator[Any]:
    if is_group(form.kind) or form.alternatives:
        yield blank_of(form)
        return
    if form.rule.prose:
        yield 'First paragraph.\nSecond paragraph: with "marks", and more than one line can hold.\n\nThe last one.'
    if form.is_free:
        yield {"data": "$value", "more": [1, True, {"deep": "text"}]}
        return
    if choices := form.choices:
        yield from choices
        return
    for kind in form.scalars:
        if kind is bool:
            yield present is not True
        elif kind is str:
            yield from (f"{present}, really", *WORDS) if isinstance(present, str) and present else WORDS
        else:
            yield from (1, 2, 7, 100, 0.75, 1.5, 500)


@cache
def _composed(text: str) -> Any:
    return yaml.compose(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))


@cache
def comments(text: str) -> list[str]:
    """All comments of a text, in order."""
    whole = yaml.scan(text, Loader=getattr(yaml, "CLoader", yaml.Loader))
    ends = [(token.start_mark.index, token.end_mark.index) for token in whole]
    found, at = [], 0
    for start, end in sorted(ends):
        between = text[at:start]
        found += [f"#{part}".strip() for line in between.splitlines() for part in line.split("#")[1:2]]
        at = max(at, end)
    return found


def lines_of(text: str, path: KeyPath) -> tuple[int, int] | None:
    """First and last line of the value, counted from 0; None if it is absent."""
    node = _composed(text)
    start = None
    for part in path:
        if isinstance(node, yaml.MappingNode):
            found = next(((key, value) for key, value in node.value if key.value == part), None)
            if found is None:
                return None
            key, node = found
            start = key.start_mark.line
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
            node = node.value[part]
            start = node.start_mark.line
        else:
            # A text instead of a group.
            break
    assert start is not None
    last = node.end_mark.line - (1 if node.end_mark.column == 0 and node.end_mark.line > start else 0)
    return start, last


@cache
def _values_of(text: str, path: Path) -> dict[KeyPath, Any]:
    """Value of each leaf, from the file or its default."""
    document = EditedDocument(text, path)
    return {path: document.value(path) for path, _form in edited_leaves(document)}


def _referring(document: EditedDocument, path: KeyPath) -> list[KeyPath]:
    """Leaves that refer to the entry whose name or id is at ``path``."""
    return [
        each
        for each, form in edited_leaves(document)
        if document.value(path)
        and form.rule.refers
        and form.rule.refers[:-1] == path[:-2]
        and path[-1] in (form.rule.refers[-1], "id")
        and document.value(each) == document.value(path)
    ]


def assert_only_that_field_changed(before: EditedDocument, after: str, path: KeyPath, value: Any) -> None:
    """Assert that ``after`` has ``value`` at ``path``, references included, and otherwise the values, comments and text
    of ``before``.
    """
    text, values = before.saved_text, _values_of(before.saved_text, before.path)
    along = _referring(before, path)
    values = values | dict.fromkeys(along, value)
    read = EditedDocument(after, before.path)
    assert not read.mistakes, path
    assert read.value(path) == value, path
    assert {each: read.value(each) for each in values if each != path} == {
        each: value for each, value in values.items() if each != path
    }, path
    assert comments(after) == comments(text), path
    old, new = text.splitlines(), after.splitlines()
    blocks = [
        block for block in difflib.SequenceMatcher(None, old, new, autojunk=False).get_opcodes() if block[0] != "equal"
    ]
    assert blocks, path
    # A new value gets lines of its own or is written into the one line of its parent.
    there = lines_of(text, path)
    if there is None:
        above = next((found for cut in range(len(path) - 1, 0, -1) if (found := lines_of(text, path[:cut]))), None)
        gone = [line for _what, start, end, _from, _to in blocks for line in range(start, end)]
        assert len(gone) <= 1, (path, gone)
        assert not gone or (above is not None and above[0] <= gone[0] <= above[1]), (path, gone)
        return
    may = {line for each in (path, *along) if (lines := lines_of(text, each)) for line in range(lines[0], lines[1] + 2)}
    for _what, start, end, _from, _to in blocks:
        assert {start, end} <= may, (path, old[start:end])


def lists_of(document: EditedDocument) -> list[tuple[KeyPath, ValueForm]]:
    """All lists that the file may contain, also within entries."""
    found: dict[KeyPath, ValueForm] = {}

    def look(path: KeyPath, form: ValueForm) -> None:
        value = document.value(path) if path else document.data
        group = form.group_at(value)
        if group is not None:
            for key in keys_of(group):
                look((*path, key.name), key.form)
        elif (item := form.item) is not None:
            found[path] = form
            for number in range(len(value) if isinstance(value, list) else 0):
                look((*path, number), item)

    look((), form_of(Scenario))
    return list(found.items())
