"""Drawing of the packages and their layers: ``python docs/architecture_drawing.py`` writes docs/architecture.svg.

Layers come from the import contract in pyproject.toml, texts from the packages' docstrings and imports.
"""

import ast
import tomllib
from collections.abc import Iterator
from html import escape
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
DRAWING = REPOSITORY / "docs" / "architecture.svg"
_PACKAGE = "caris_desktop"
_WIDTH_PX = 1080
_LINE_PX = 15
_GAP_PX = 14
_LETTER_PX = 6.8
"""About the width of a letter at 12 px."""


def layers() -> list[list[str]]:
    """The packages, the highest layer first."""
    contracts = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
    (contract,) = (contract for contract in contracts if contract["type"] == "layers")
    rows = [[name.strip() for name in layer.split("|")] for layer in contract["layers"]]
    return [row for row in rows if (REPOSITORY / _PACKAGE / row[0]).is_dir()]


def imports_between(rows: list[list[str]]) -> set[tuple[str, str]]:
    """The packages that import another one, with that."""
    names = {name for row in rows for name in row}
    found = set()
    for name in names:
        for path in (REPOSITORY / _PACKAGE / name).rglob("*.py"):
            found |= {(name, other) for other in _imported(path) if other in names and other != name}
    return found


def _imported(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.module:
            modules = [f"{node.module}.{alias.name}" for alias in node.names]
        for module in modules:
            if module.startswith(f"{_PACKAGE}."):
                yield module.split(".")[1]


def drawing(rows: list[list[str]]) -> str:
    """The SVG: a box for each package, with its purpose and the packages that it imports."""
    imports = imports_between(rows)
    parts, y = [], _GAP_PX
    for row in rows:
        width = (_WIDTH_PX - _GAP_PX) / len(row) - _GAP_PX
        texts = {name: _text_of(name, imports, width) for name in row}
        height = 40 + _LINE_PX * max(map(len, texts.values()))
        for column, (name, lines) in enumerate(texts.items()):
            parts += _box(name, lines, _GAP_PX + column * (width + _GAP_PX), y, (width, height))
        y += height + _GAP_PX
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH_PX} {y}" font-family="sans-serif">',
        "<title>Packages of CARIS Desktop: a package imports only from layers below its own</title>",
        f'<rect width="{_WIDTH_PX}" height="{y}" fill="#ffffff"/>',
    )
    return "\n".join([*head, *parts, "</svg>", ""])


def _text_of(name: str, imports: set[tuple[str, str]], width: float) -> list[str]:
    source = (REPOSITORY / _PACKAGE / name / "__init__.py").read_text("utf-8")
    purpose = (ast.get_docstring(ast.parse(source)) or "").partition("\n\n")[0]
    used = sorted(other for importing, other in imports if importing == name)
    return [*_wrapped(purpose, width), *(_wrapped("Imports: " + ", ".join(used), width) if used else ())]


def _box(name: str, lines: list[str], x: float, y: float, size: tuple[float, float]) -> Iterator[str]:
    width, height = size
    frame = 'rx="6" fill="#e8f0f8" stroke="#35608c"'
    yield f'<g id="{name}"><rect x="{x:.0f}" y="{y}" width="{width:.0f}" height="{height}" {frame}/>'
    yield f'<text x="{x + 8:.0f}" y="{y + 21}" font-size="14" font-weight="bold" fill="#16324f">{name}</text>'
    for number, line in enumerate(lines):
        at = f'x="{x + 8:.0f}" y="{y + 40 + _LINE_PX * number}"'
        yield f'<text {at} font-size="12" fill="#222222">{escape(line)}</text>'
    yield "</g>"


def _wrapped(text: str, width: float) -> list[str]:
    lines = [""]
    for word in text.split():
        if lines[-1] and (len(lines[-1]) + len(word) + 1) * _LETTER_PX > width - 16:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


if __name__ == "__main__":
    DRAWING.write_text(drawing(layers()), encoding="utf-8")
