"""Texts that a replay looks up in the record, extracted from the sources: it imports few of the packages that write
them.
"""

import ast
import json
from collections.abc import Iterator
from pathlib import Path

from caris_desktop.domain.recorded_messages import TEXTS_PATH

_ROOMS = ("domain", "live", "robot", "perception", "people", "conversation", "recording", "study")
_LEAST_LETTERS = 4
"""A text with fewer letters besides its values would match any sentence."""


def reference_files() -> dict[Path, str]:
    """Generated content of the file."""
    package = Path(__file__).resolve().parents[1]
    sources = (path for room in _ROOMS for path in sorted((package / room).rglob("*.py")))
    texts = sorted({text for path in sources for text in _marked(path.read_text("utf-8"))})
    return {TEXTS_PATH: json.dumps(texts, indent=0, ensure_ascii=False) + "\n"}


def _marked(source: str) -> Iterator[str]:
    for call in ast.walk(ast.parse(source)):
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "QT_TR_NOOP":
            text = ast.literal_eval(call.args[0])
            own = text.replace("%n", "")
            while "{" in own:
                own = own.partition("{")[0] + own.partition("}")[2]
            if sum(map(str.isalpha, own)) >= _LEAST_LETTERS:
                yield text
