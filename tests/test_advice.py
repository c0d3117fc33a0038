"""Advice in warnings, errors and alarms: none is shown without it."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import caris_desktop
from tests.support.parsed_sources import parse_all, parsed

ROOT = Path(caris_desktop.__file__).parent
SEVERITIES = ("info", "warning", "error")
ONLY_LOGGED = {"live/speech_history.py", "live/services/crash_recovery_service.py"}
"""Failures without effect on the session, which are only logged."""
_AFTER_SEVERITY = 3  # severity, what, meaning, advice
_OF_A_FAILURE = 2  # what, meaning, advice


def name_of(call: ast.Call) -> str:
    called = call.func
    return called.id if isinstance(called, ast.Name) else called.attr if isinstance(called, ast.Attribute) else ""


def names_of_failures(trees: dict[Path, ast.Module]) -> set[str]:
    """UserFacingError, its subclasses with the same arguments, and what raises it for other errors."""
    bases = {
        node.name: {ast.unparse(base).rsplit(".", 1)[-1] for base in node.bases}
        for tree in trees.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef) and not any(_is_init(part) for part in node.body)
    }
    found = {"UserFacingError", "reported"}
    while more := {name for name, of in bases.items() if of & found} - found:
        found |= more
    return found


def _is_init(part: ast.stmt) -> bool:
    return isinstance(part, ast.FunctionDef) and part.name == "__init__"


def told(call: ast.Call, failures: set[str]) -> tuple[str, ast.expr] | None:
    """Severity and advice of a call; None if it reports nothing."""
    given = {each.arg: each.value for each in call.keywords}
    words = [argument.value if isinstance(argument, ast.Constant) else None for argument in call.args]
    severity = given.get("severity")
    grave = next((word for word in words if word in SEVERITIES), None)
    if grave is not None:
        at = words.index(grave) + _AFTER_SEVERITY
    elif name_of(call) in failures:
        at = _OF_A_FAILURE
        grave = str(severity.value) if isinstance(severity, ast.Constant) else "error"
    else:
        return None
    advice = given.get("advice") or (call.args[at] if len(call.args) > at else None)
    return None if advice is None else (str(grave), advice)


def may_be_empty(advice: ast.expr) -> bool:
    match advice:
        case ast.Constant(value=value):
            return not value
        case ast.IfExp(body=one, orelse=other):
            return may_be_empty(one) or may_be_empty(other)
        case ast.BoolOp(values=several):
            return any(may_be_empty(each) for each in several)
    return False


@pytest.fixture(scope="module")
def trees() -> dict[Path, ast.Module]:
    parse_all(ROOT)
    return {path: parsed(path.read_text("utf-8")) for path in sorted(ROOT.rglob("*.py"))}


def everything_told(trees: dict[Path, ast.Module]) -> Iterator[tuple[str, str, ast.expr]]:
    """Place, severity and advice of each report."""
    failures = names_of_failures(trees)
    for path, tree in trees.items():
        for node in ast.walk(tree):
            found = told(node, failures) if isinstance(node, ast.Call) else None
            if found is not None:
                yield f"{path.relative_to(ROOT)}:{node.lineno}", *found  # type: ignore[attr-defined]


@pytest.mark.long
def test_no_warning_and_no_error_comes_without_advice(trees: dict[Path, ast.Module]) -> None:
    found = list(everything_told(trees))
    assert len(found) > 200, "they are found at all"
    assert {grave for _, grave, _ in found} == set(SEVERITIES)
    without = [where for where, grave, advice in found if grave != "info" and may_be_empty(advice)]
    assert {where.split(":")[0] for where in without} == ONLY_LOGGED, without


_NO_HELP = re.compile(r"(The log (has the details|tells why)|Nothing (is )?to (be )?do(ne)?|Check the \w+)\.")


@pytest.mark.long
def test_advice_says_what_to_do(trees: dict[Path, ast.Module]) -> None:
    """Advice must state more than the place of details."""
    told = [
        f"{where}: {node.value}"
        for where, grave, advice in everything_told(trees)
        for node in ast.walk(advice)
        if grave != "info" and isinstance(node, ast.Constant) and _NO_HELP.fullmatch(str(node.value))
    ]
    assert told == []


@pytest.mark.long
def test_the_wizard_reads_of_connections_and_not_of_links(trees: dict[Path, ast.Module]) -> None:
    """Consistent term in messages. A reason without a full stop is recorded, and its wording stays."""
    of_the_disk_or_the_air = (
        "a link to a location outside the session",
        "points outside the study",
        "a hard link",
        "wireless link",
    )
    marked = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {node.args[0].value}"
        for path, tree in trees.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and name_of(node) in ("tr", "QT_TR_NOOP") and node.args
        and isinstance(node.args[0], ast.Constant) and re.search(r"\blink\b.*[a-z]\.(\s|$)", str(node.args[0].value))
    ]  # fmt: skip
    assert [each for each in marked if not any(words in each for words in of_the_disk_or_the_air)] == []


@pytest.mark.parametrize(
    "call",
    [
        'bus.problem("warning", tr("It broke."), tr("Nothing is seen."), "")',
        'Problem(now_ns, "error", what, meaning, "")',
        'Condition("link", "error", what, meaning, tr("Look.") if one else "")',
        "UserFacingError(what, meaning, '')",
        "UserFacingError(what, meaning, advice='', severity='warning')",
    ],
)
def test_missing_advice_is_found(call: str) -> None:
    (found,) = [told(node, {"UserFacingError"}) for node in ast.walk(ast.parse(call)) if reported_here(node)]
    assert found is not None and found[0] != "info" and may_be_empty(found[1])


def reported_here(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and told(node, {"UserFacingError"}) is not None
