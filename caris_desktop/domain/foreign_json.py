"""Parser for JSON from other sources."""

import json
from typing import Any


def parse_json(text: str | bytes | bytearray) -> Any:
    """``json.loads`` that raises ValueError for too deeply nested text as well."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
