"""Data from the recorded scenario text of a session."""

import logging
import math
from collections.abc import Iterator
from dataclasses import field
from typing import Any

from caris_desktop.domain.events import ScenarioOpened
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.value_class import Value
from caris_desktop.domain.yaml_source import YamlSourceError, parse_yaml

_log = logging.getLogger(__name__)
_MAX_CHARACTERS = 256 * 1024


class ScenarioText(Value):
    """Scenario data for readers of a recording. ``permissions`` contains only what the file says."""

    title: str
    file_name: str
    sha256: str
    description: str = ""
    phrases: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()
    places: tuple[tuple[str, Pose2D], ...] = ()
    permissions: dict[str, bool] = field(default_factory=dict)
    panels: tuple[str, ...] = ()


def read_scenario(event: ScenarioOpened) -> ScenarioText:
    """Parse the scenario. Missing or invalid fields stay empty: the recording may be older than this program."""
    content = _mapping(parsed_yaml(event.content, "scenario"))
    recording = _mapping(content.get("recording"))
    return ScenarioText(
        title=event.title,
        file_name=event.file_name,
        sha256=event.sha256,
        description=_string(content.get("description")),
        phrases=tuple(_sentences(content.get("phrases"))),
        labels=_strings(recording.get("labels")),
        places=tuple(place for entry in _list(content.get("places")) if (place := _place(_mapping(entry))) is not None),
        permissions={
            str(name): value for name, value in _mapping(content.get("permissions")).items() if isinstance(value, bool)
        },
        panels=tuple(dict.fromkeys(_panels(content.get("layout")))),
    )


def parsed_yaml(text: str, what: str) -> Any:
    """Parsed YAML; an empty mapping if unreadable. ``what`` names it in the log."""
    if not text:
        return {}
    if len(text) > _MAX_CHARACTERS:
        _log.warning("the recorded %s is not read: %d characters", what, len(text))
        return {}
    try:
        return parse_yaml(text, finite=False).data
    except YamlSourceError as error:
        _log.warning("the recorded %s cannot be read: %s", what, error)
        return {}


def _place(entry: dict[Any, Any]) -> tuple[str, Pose2D] | None:
    name, x_m, y_m = entry.get("name"), _metres(entry.get("x_m")), _metres(entry.get("y_m"))
    return (name, Pose2D(x_m, y_m, 0.0)) if isinstance(name, str) and x_m is not None and y_m is not None else None


def _metres(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _sentences(phrases: Any) -> Iterator[str]:
    """Sentences of phrases: plain ones, those with options, and groups."""
    for entry in _list(phrases):
        group = _mapping(entry)
        yield from (sentence for sentence in (_string(entry), _string(group.get("say"))) if sentence)
        for inner in _list(group.get("phrases")):
            yield from (sentence for sentence in (_string(inner), _string(_mapping(inner).get("say"))) if sentence)


def _panels(node: Any, depth: int = 0) -> list[str]:
    if not isinstance(node, dict) or depth > 20:
        return []
    found = [_string(node.get("panel")), *_strings(node.get("tabs"))]
    for child in _list(node.get("children")):
        found += _panels(child, depth + 1)
    return [name for name in found if name]


def _mapping(value: Any) -> dict[Any, Any]:
    return value if isinstance(value, dict) else {}


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _string(value: Any) -> str:
    return value.strip() if isinstance(value, str) else ""


def _strings(value: Any) -> tuple[str, ...]:
    return tuple(item for item in _list(value) if isinstance(item, str))
