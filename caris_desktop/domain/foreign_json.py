"""JSON that came from elsewhere."""

import json
from typing import Any


def parse_json(text: str | bytes | bytearray) -> Any:
    """As ``json.loads``; text that is nested without end is wrong like any other. Raises ValueError."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
