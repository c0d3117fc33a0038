"""Recorded texts of the console are English: ``tr`` is applied only for display."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import pytest

import caris_desktop
from caris_desktop.domain import events
from caris_desktop.live.state import STATUS_TYPES
from tests.support.parsed_sources import parsed

_ROOT = Path(caris_desktop.__file__).parent
_AS_READ = ("Problem", "AlarmChanged")
"""Recorded in the wizard's language."""

_NOT_RECORDED = ("ExportStatus", "LibraryStatus", "PlaybackStatus")
_TOLD = ("detail", "reason", "cap_reason", "guard_detail")
_IN_WIZARDS_LANGUAGE = ("tr", "told_here")


def _recorded() -> frozenset[str]:
    """Names of all recorded types."""
    kinds = [*events.EVENTS]
    for kind in STATUS_TYPES.values():
        kinds += get_args(kind) or [kind]
    return frozenset(kind.__name__ for kind in kinds if isinstance(kind, type)).difference(_AS_READ)


def test_the_check_knows_what_is_recorded() -> None:
    assert {"PerceptionStatus", "LlmExchange", "ControlStatus", "GoalChanged"} <= _recorded()


def test_no_recorded_value_is_made_in_the_wizards_language() -> None:
    found = [
        f"{path.relative_to(_ROOT)}:{line}"
        for path in sorted((_ROOT / "live").rglob("*.py"))
        if path.name != "session_library.py"  # texts of exports and lists, which are in no session
        for line in _translated(parsed(path.read_text("utf-8")))
    ]
    assert found == []


@pytest.mark.parametrize(
    ("source", "lines"),
    [
        ('PerceptionStatus("failed", detail=tr("Gone"))', [1]),
        ('ListeningStatus("failed", "", "", told_here(problem).what)', [1]),
        ('self.show(replace(status, detail=tr("Gone: {why}").format(why=why)))', [1]),
        ('def f():\n    why = tr("Gone")\n    self._show("failed", detail=why)', [3]),
        ('PerceptionStatus("failed", detail=QT_TR_NOOP("Gone"))', []),
        ('Problem(0, "error", tr("Gone"), "", "")', []),
        ('ExportStatus("failed", detail=tr("Gone"))', []),
        ('tr("Gone: {detail}").format(detail=tr(detail))', []),
    ],
)
def test_the_check_finds_it(source: str, lines: list[int]) -> None:
    assert list(_translated(ast.parse(source))) == lines


def _translated(tree: ast.Module) -> Iterator[int]:
    """Lines of calls that pass translated text to a recorded value or to a detail."""
    recorded = _recorded()
    for scope in ast.walk(tree):
        if not isinstance(scope, ast.Module | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        inside = [each for part in scope.body for each in _own(part)]
        named = frozenset(
            target.id
            for each in inside
            if isinstance(each, ast.Assign) and _says_tr(each.value)
            for target in each.targets
            if isinstance(target, ast.Name)
        )
        for call in inside:
            if not isinstance(call, ast.Call) or (name := _name(call.func)) in (*_AS_READ, *_NOT_RECORDED, "format"):
                continue
            given = [keyword.value for keyword in call.keywords if name in recorded or keyword.arg in _TOLD]
            given += call.args if name in recorded else []
            if any(_says_tr(value, named) for value in given):
                yield call.lineno


def _own(node: ast.AST) -> Iterator[ast.AST]:
    """Nodes of a scope without those of nested functions."""
    if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        yield node
        for part in ast.iter_child_nodes(node):
            yield from _own(part)


def _says_tr(value: ast.AST, named: frozenset[str] = frozenset()) -> bool:
    return any(
        (isinstance(part, ast.Call) and _name(part.func) in _IN_WIZARDS_LANGUAGE)
        or (isinstance(part, ast.Name) and part.id in named)
        for part in ast.walk(value)
    )


def _name(called: ast.AST) -> str:
    return called.id if isinstance(called, ast.Name) else called.attr if isinstance(called, ast.Attribute) else ""
