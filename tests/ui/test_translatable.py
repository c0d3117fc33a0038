"""Texts can be translated: Qt's tool finds each of them, and none is glued from pieces."""

import ast
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "caris_desktop"
MARKS = ("tr", "QT_TR_NOOP")


def _sources() -> Iterator[tuple[Path, ast.Module]]:
    for path in sorted(PACKAGE.rglob("*.py")):
        text = path.read_text("utf-8")
        if any(f"{mark}(" in text for mark in MARKS) and path.name != "translation.py":
            yield path, ast.parse(text)


def _marked(tree: ast.AST) -> Iterator[ast.Call]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in MARKS:
            yield node


def test_lupdate_finds_every_text(tmp_path: Path) -> None:
    written, files = set(), []
    for path, tree in _sources():
        files.append(path)
        for call in _marked(tree):
            if isinstance(call.args[0], ast.Constant):
                written.add(call.args[0].value)
    found = tmp_path / "found.ts"
    lupdate = Path(sys.executable).with_name("pyside6-lupdate")
    subprocess.run([lupdate, *files, "-ts", found], check=True, capture_output=True)
    told = {source.text for source in ET.parse(found).iter("source")}  # noqa: S314 - our own tool wrote it
    assert len(written) > 300
    assert {" ".join(text.split()) for text in written} == {" ".join((text or "").split()) for text in told}


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
