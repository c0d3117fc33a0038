"""Texts can be translated: lupdate finds each of them, and none is concatenated."""

import ast
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import TypeGuard, cast

import pytest

from caris_desktop.domain.schema_paths import texts_of
from caris_desktop.scenario.scenario_model import Scenario
from tests.support import untranslated
from tests.support.parsed_sources import parse_all, parsed

PACKAGE = Path(__file__).parents[2] / "caris_desktop"
MARKS = ("tr", "QT_TR_NOOP")


@pytest.fixture(autouse=True, scope="module")
def all_parsed() -> None:
    parse_all(PACKAGE)


@cache
def _sources() -> tuple[tuple[Path, ast.Module], ...]:
    files = ((path, path.read_text("utf-8")) for path in sorted(PACKAGE.rglob("*.py")) if path.name != "translation.py")
    return tuple((path, parsed(text)) for path, text in files if any(f"{mark}(" in text for mark in MARKS))


def _marked(tree: ast.AST) -> Iterator[ast.Call]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in MARKS:
            yield node


@pytest.mark.long
def test_lupdate_finds_every_text(tmp_path: Path) -> None:
    written, files = set(), []
    for path, tree in _sources():
        files.append(path)
        for call in _marked(tree):
            if isinstance(call.args[0], ast.Constant):
                written.add(call.args[0].value)
    assert len(written) > 300
    assert {" ".join(text.split()) for text in written} == found_by_lupdate(files, tmp_path)


def found_by_lupdate(files: list[Path], folder: Path) -> set[str]:
    """Texts in the catalogue that lupdate makes of these sources."""
    catalogue = folder / "found.ts"
    lupdate = Path(sys.executable).with_name("pyside6-lupdate")
    subprocess.run([lupdate, *files, "-ts", catalogue], check=True, capture_output=True)
    sources = ET.parse(catalogue).iter("source")  # noqa: S314 - written by lupdate
    return {" ".join((source.text or "").split()) for source in sources}


def test_the_texts_of_the_scenario_form_reach_the_translators(tmp_path: Path) -> None:
    """The form shows the texts of the schema; the script that makes a catalogue extracts them from there."""
    script, source = PACKAGE.parent / "packaging" / "scenario_texts.py", tmp_path / "schema_texts.py"
    assert f"packaging/{script.name}" in script.with_name("translations.sh").read_text("utf-8")
    subprocess.run([sys.executable, script, source], check=True, env={**os.environ, "PYTHONPATH": str(PACKAGE.parent)})
    declared = {" ".join(text.split()) for text in texts_of(Scenario)}
    assert len(declared) > 300
    assert found_by_lupdate([source], tmp_path) == declared


def test_no_text_is_glued_from_pieces() -> None:
    glued = []
    for path, tree in _sources():
        for call in _marked(tree):
            if isinstance(call.args[0], (ast.JoinedStr, ast.BinOp, ast.Call)):
                glued.append(f"{path.relative_to(PACKAGE)}:{call.lineno} translates what is put together")
        for node in ast.walk(tree):
            if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
                pieces = [side for side in (node.left, node.right) if isinstance(side, ast.Call)]
                if any(isinstance(side.func, ast.Name) and side.func.id == "tr" for side in pieces):
                    glued.append(f"{path.relative_to(PACKAGE)}:{node.lineno} adds something to a translated text")
    assert glued == []


_PLACED = re.compile(r"\{([^{}]*)\}")


def test_nothing_is_translated_before_the_language_is_known() -> None:
    """Modules and their classes are loaded before the wizard's language is known."""
    early = [
        f"{path.relative_to(PACKAGE)}:{call.lineno} calls tr as it is imported: QT_TR_NOOP there, tr where it is shown"
        for path, tree in _sources()
        for call in _at_import(tree)
    ]
    assert early == []


def test_placeholders_have_names_and_values() -> None:
    wrong = []
    for path, tree in _sources():
        formatted = {id(node.func.value): node for node in ast.walk(tree) if _is_format(node)}
        for call in _marked(tree):
            if isinstance(call.args[0], ast.Constant):
                wrong += [
                    f"{path.relative_to(PACKAGE)}:{call.lineno} {flaw}"
                    for flaw in _flaws(call, formatted.get(id(call)))
                ]
    assert wrong == []


def test_every_text_of_the_window_can_be_translated() -> None:
    """The list of untranslated texts by file may only become shorter."""
    now, listed = untranslated.counts_by_file(), untranslated.listed_counts()
    wrong = [
        f"{file} has {now.get(file, 0)}, the list says {listed.get(file, 0)}"
        for file in sorted(now.keys() | listed.keys())
        if now.get(file, 0) != listed.get(file, 0)
    ]
    assert wrong == [], (
        "Texts that do not go through tr: `python -m tests.support.untranslated ui/FILE` shows them. More than listed:"
        " give them to tr (one whole sentence, {names} filled by format). Fewer: thank you,"
        " `python -m tests.support.untranslated --write` makes the list shorter."
    )


def test_reports_of_every_package_can_be_translated() -> None:
    """In child processes too: texts in QT_TR_NOOP, with their values, translated by the console."""
    told = [f"{found.file}:{found.line}: {found.text!r}" for found in untranslated.untranslated_errors()]
    assert told == []


def test_excepted_texts_are_still_used() -> None:
    assert untranslated.unused_exemptions() == []


@pytest.mark.parametrize(
    ("source", "texts"),
    [
        ('button = ActionButton(tr("Stop"), icon="hand-palm", role="ghost")', []),
        ('button = ActionButton("Stop", icon="hand-palm")', ["Stop"]),
        ('label.setText("moving")', ["moving"]),
        ('self.set_fact("quiet", "dim")', ["quiet"]),
        ('label.setText(f"{count} people")', ["{} people"]),
        ('label.setText(tr("{count} of {all}").format(count=f"{n} people", all=3))', ["{} people"]),
        ('TABLE = {"Some key": "The robot is unreachable"}', ["The robot is unreachable"]),
        ('raise UserFacingError("It stays.", *more)', ["It stays."]),
        ('raise ValueError("that is out of bounds")', []),
        ('_log.warning("the robot is %s", name)\nlogging.getLogger("x").error("no way out of it")', []),
        ('def f(kind: Literal["Some kind of it"]) -> None:\n    """The docstring of it."""', []),
        ('widget.setObjectName("some name of it")\nif word == "not this one":\n    keys = ("Ctrl+K", "Up", "Esc")', []),
        ('widget.setStyleSheet(f"color: {color}; border: 1px solid {line};")', []),
        ('label.setText(f"{speed:.1f} m/s, {size_mb} MB")', []),
        ('match event:\n    case Happened(state="out of reach"):\n        return "Session", "The robot is lost"',
         ["Session", "The robot is lost"]),
        ('parser.add_argument("--all", help="Every one of them")\nprint("It is done now.")', []),
        ('say(words if words else "no answer")', ["no answer"]),
    ],
)  # fmt: skip
def test_text_that_counts_as_one(source: str, texts: list[str]) -> None:
    assert [found.text for found in untranslated.texts_in(source)] == texts


@pytest.mark.parametrize(
    ("source", "early"),
    [
        ('TITLE = tr("Stop")', 1),
        ('class Panel:\n    title = tr("Stop")', 1),
        ('def shown(text=tr("Stop")):\n    return tr("Go")', 1),
        ('def shown():\n    return tr("Stop")\n\n\nlater = lambda: tr("Go")\nTABLE = {1: QT_TR_NOOP("Go")}', 0),
    ],
)
def test_early_translation_is_found(source: str, early: int) -> None:
    assert len(list(_at_import(ast.parse(source)))) == early


@pytest.mark.parametrize(
    ("source", "flaws"),
    [
        ('tr("Go to {place}").format(place=name)', 0),
        ('tr("Go to {place}").format(name=name)', 1),
        ('tr("Go to {}").format(name)', 2),
        ('tr("%n people", "", count)', 0),
        ('tr("%n people")', 1),
        ('tr("People", "", count)', 1),
        ('QT_TR_NOOP("%n people", "", count)', 0),
        ('QT_TR_NOOP("People", "", count)', 1),
    ],
)
def test_wrong_placeholders_are_found(source: str, flaws: int) -> None:
    tree = ast.parse(source)
    formatted = next((node for node in ast.walk(tree) if _is_format(node)), None)
    assert len([flaw for call in _marked(tree) for flaw in _flaws(call, formatted)]) == flaws


def _at_import(tree: ast.Module) -> Iterator[ast.Call]:
    """Calls of tr at import time: function bodies run later, default values do not."""
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "tr":
            yield node
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            waiting += [*node.decorator_list, node.args]
        elif not isinstance(node, ast.Lambda):
            waiting += ast.iter_child_nodes(node)


def _is_format(node: ast.AST) -> TypeGuard[ast.Call]:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "format"


def _flaws(call: ast.Call, formatted: ast.Call | None) -> Iterator[str]:
    """Errors of one text: placeholder names, and the number for the plural."""
    marked = cast(ast.Name, call.func).id
    text = str(cast(ast.Constant, call.args[0]).value)
    names = {
        name.partition(":")[0].partition("!")[0] for name in _PLACED.findall(text.replace("{{", "").replace("}}", ""))
    }
    if (marked == "tr" or len(call.args) > 1) and ("%n" in text) != (len(call.args) > 2):
        yield f"has %n without a number, or a number without %n: {text!r}"
    if formatted is None:
        return
    if not all(name.isidentifier() for name in names):
        yield f"fills in what has no name: {text!r}"
    given = {keyword.arg for keyword in formatted.keywords}
    if None not in given and (formatted.args or given != names):
        yield f"is given {sorted(map(str, given))} and has places for {sorted(names)}: {text!r}"
