"""Reads and writes scenario files; whatever is wrong is told with file, line and what is allowed."""

import difflib
import hashlib
import math
import os
import re
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import yaml

from caris_desktop.domain.controls import control_data, control_from_data, control_problems
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.shipped import layouts_dir, resources_dir, schema_validator
from caris_desktop.scenario.layout import layout_data, layout_from_data, plain_number
from caris_desktop.scenario.migrations import migrate
from caris_desktop.scenario.model import (
    DEFAULT_ROBOT,
    SCENARIO_VERSION,
    AssistantSettings,
    DrivingLimits,
    Permissions,
    Place,
    RecordingSettings,
    Scenario,
)
from caris_desktop.scenario.yaml_source import KeyPath, LocatedData, YamlSourceError, parse_yaml

MAX_FILE_BYTES = 256 * 1024
MAX_REPORTED_PROBLEMS = 5
_SCHEMA_ON_THIS_COMPUTER = re.compile(
    r"""^[ \t]*\#[ \t]*yaml-language-server:[^\n]*\$schema[ \t]*=[ \t"']*(?:file:|/|\\|~|[a-z]:[/\\])[^\n]*(?:\n|\Z)""",
    re.MULTILINE | re.IGNORECASE,
)


class ScenarioError(Exception):
    """A scenario file that cannot be used. The text names file, line, what is wrong and what is allowed."""


def schema_path() -> Path:
    """The JSON Schema of scenario files, for the loader and for editors."""
    return resources_dir() / "schemas" / "scenario.schema.json"


def load_scenario(path: Path, velocity_topic_of: Callable[[str], str | None] = lambda _robot: None) -> Scenario:
    """Read, migrate and check one scenario file.

    ``velocity_topic_of`` tells where a robot takes velocities, by its name in the file: no control may publish there.

    Raises
    ------
    ScenarioError
        If the file cannot be read, or says something that a scenario may not say.
    """
    raw = _read(path)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ScenarioError(f"{_shown(path)}: not UTF-8 text ({error.reason} at byte {error.start}).") from error
    scenario = parse_scenario(text, path=path.resolve(), velocity_topic_of=velocity_topic_of)
    return replace(scenario, sha256=hashlib.sha256(raw).hexdigest())


def save_scenario(scenario: Scenario, path: Path) -> None:
    """Write ``scenario`` to ``path``, whole or not at all, keys always in the same order.

    Raises
    ------
    ScenarioError
        If the file cannot be written, or the scenario would not load again.
    """
    data = scenario_data(scenario)
    problems = [*_schema_problems(data), *_meaning_problems(data)]
    if problems:
        raise ScenarioError(f"{_shown(path)} was not written: {problems[0][1]}")
    text = f"# yaml-language-server: $schema={_schema_reference(path)}\n" + _text(data)
    try:
        _write_atomically(path, text)
    except OSError as error:
        raise ScenarioError(
            f"{_shown(path)} was not written ({error.strerror or error}). The file on disk is as it was before."
        ) from error


def save_places(scenario: Scenario, path: Path) -> Scenario:
    """Write the places of ``scenario`` into the file ``path``, leaving every other line as its author wrote it.

    A file that does not exist yet is written whole. Gives the scenario as it loads from ``path`` now.

    Raises
    ------
    ScenarioError
        If the file cannot be written or would not load again; it is then as it was before.
    """
    if not path.is_file():
        save_scenario(scenario, path)
        return load_scenario(path)
    before = _read(path).decode("utf-8")
    text = with_places(before, scenario.places)
    try:
        _write_atomically(path, text)
    except OSError as error:
        raise ScenarioError(
            f"{_shown(path)} was not written ({error.strerror or error}). The file on disk is as it was before."
        ) from error
    try:
        return load_scenario(path)
    except ScenarioError:
        _write_atomically(path, before)
        raise


def with_places(text: str, places: Sequence[Place]) -> str:
    """The text of a scenario file with other places and nothing else changed."""
    lines = [f"  - {_on_one_line(_place_data(place))}\n" for place in places]
    block = "places:\n" + "".join(lines) if lines else "places: []\n"
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    entries = node.value if isinstance(node, yaml.MappingNode) else []
    at = next((index for index, (key, _value) in enumerate(entries) if key.value == "places"), None)
    if at is None:
        return text + ("" if text.endswith("\n") or not text else "\n") + block
    key, value = entries[at]
    end = value.end_mark.index
    # A block ends where the next token begins; comments before that belong to what follows.
    kept = text[:end].rstrip()
    while kept.rsplit("\n", 1)[-1].lstrip().startswith("#"):
        kept = kept.rsplit("\n", 1)[0].rstrip()
    return text[: key.start_mark.index] + block + text[len(kept) :].lstrip("\n")


def _on_one_line(data: dict[str, Any]) -> str:
    text: str = yaml.safe_dump(data, default_flow_style=True, sort_keys=False, allow_unicode=True, width=1000)
    return text.strip()


def scenario_data(scenario: Scenario) -> dict[str, Any]:
    """The content of a scenario file for ``scenario``, in the order in which it is written."""
    return {
        "version": SCENARIO_VERSION,
        "title": scenario.title,
        "description": scenario.description,
        "robot": scenario.robot,
        "voice": scenario.voice,
        "phrases": list(scenario.phrases),
        "filler": scenario.filler,
        "places": [_place_data(place) for place in scenario.places],
        **({"controls": [control_data(control) for control in scenario.controls]} if scenario.controls else {}),
        "permissions": asdict(scenario.permissions),
        **({"recording": recording} if (recording := _recording_data(scenario.recording)) else {}),
        "driving": asdict(scenario.driving),
        "assistant": asdict(scenario.assistant),
        "layout": layout_data(scenario.layout),
    }


def scenario_text(scenario: Scenario) -> str:
    """The text of the file that ``scenario`` was read from, or would be written to where that has changed.

    It goes into recordings: the comment that tells editors where the schema lies on this computer is not in it.
    ``scenario.sha256`` is that of the whole file.
    """
    if scenario.path is not None:
        try:
            raw = _read(scenario.path)
        except ScenarioError:
            raw = b""
        if hashlib.sha256(raw).hexdigest() == scenario.sha256:
            return _SCHEMA_ON_THIS_COMPUTER.sub("", raw.decode("utf-8-sig"))
    return _text(scenario_data(scenario))


def parse_scenario(
    text: str, *, path: Path, velocity_topic_of: Callable[[str], str | None] = lambda _robot: None
) -> Scenario:
    """The scenario that a text describes, as if it stood in ``path``. Raises ScenarioError."""
    try:
        source = parse_yaml(text)
    except YamlSourceError as error:
        raise ScenarioError(f"{_shown(path)}, line {error.line}: {error}") from error
    if not isinstance(source.data, dict):
        raise ScenarioError(
            f"{_shown(path)}, line 1: a scenario is a list of 'key: value' lines, found something else."
        )
    try:
        data = migrate(source.data)
    except ValueError as error:
        raise ScenarioError(f"{_shown(path)}, line {source.line_of(('version',))}: {error}") from error
    problems = list(_schema_problems(data))
    if not problems:
        problems = list(_meaning_problems(data, velocity_topic_of))
    if problems:
        raise ScenarioError(_problem_text(path, source, problems))
    return _scenario(data, path=path, sha256=hashlib.sha256(text.encode("utf-8")).hexdigest())


def _text(data: dict[str, Any]) -> str:
    return yaml.dump(data, Dumper=_ReadableDumper, sort_keys=False, allow_unicode=True, width=110)


Problem = tuple[KeyPath, str]


def _read(path: Path) -> bytes:
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ScenarioError(
                f"{_shown(path)}: {path.stat().st_size} bytes is too large for a scenario. "
                f"Allowed: {MAX_FILE_BYTES} bytes."
            )
        with path.open("rb") as file:
            raw = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise ScenarioError(f"{_shown(path)} cannot be read: {error.strerror or error}.") from error
    if len(raw) > MAX_FILE_BYTES:
        raise ScenarioError(f"{_shown(path)}: too large for a scenario. Allowed: {MAX_FILE_BYTES} bytes.")
    return raw


def _shown(path: Path) -> str:
    """The path as a person wrote it, shortened for shipped files."""
    try:
        return str(Path(layouts_dir().name) / path.resolve().relative_to(layouts_dir().resolve()))
    except (ValueError, OSError):
        return str(path)


def _problem_text(path: Path, source: LocatedData, problems: list[Problem]) -> str:
    located = sorted((source.line_of(key_path), message) for key_path, message in problems)
    lines = [f"{_shown(path)}, line {line}: {message}" for line, message in located[:MAX_REPORTED_PROBLEMS]]
    if len(located) > MAX_REPORTED_PROBLEMS:
        lines.append(f"... and {len(located) - MAX_REPORTED_PROBLEMS} more.")
    return "\n".join(lines)


def _schema_problems(data: dict[str, Any]) -> Iterator[Problem]:
    for error in schema_validator("scenario.schema.json").iter_errors(data):
        path: KeyPath = tuple(error.absolute_path)
        if error.validator == "additionalProperties":
            allowed = sorted(error.schema.get("properties", {}))
            for key in error.instance:
                if key not in allowed:
                    yield (*path, key), f"unknown key '{key}'{_within(path)}. {_allowed(key, allowed)}"
        elif error.validator == "required":
            # jsonschema tells the missing key only inside its message, so it is worked out again here.
            missing = [key for key in error.validator_value if key not in error.instance]
            if path[:1] == ("layout",):
                yield path, "a layout part needs 'panel: NAME', 'tabs: [NAMES]', or 'split' with 'children'."
            elif error.message.startswith(repr(missing[0])):
                yield path, f"{_listed(missing)} missing{_within(path)}."
        else:
            yield path, _value_problem(error, path)


def _value_problem(error: Any, path: KeyPath) -> str:
    value, limit, name = error.instance, error.validator_value, _name(path)
    match error.validator:
        case "enum":
            allowed = [str(item) for item in limit]
            return f"unknown {error.schema.get('title', name)} {_quoted(value)}. {_allowed(str(value), allowed)}"
        case "type":
            return f"{name} must be {_TYPE_WORDS.get(str(limit), str(limit))}, found {_quoted(value)}."
        case "minimum":
            return f"{name} is {value}. Allowed: at least {limit}."
        case "maximum":
            return f"{name} is {value}. Allowed: at most {limit}."
        case "exclusiveMinimum":
            return f"{name} is {value}. Allowed: more than {limit}."
        case "minLength":
            return f"{name} is empty."
        case "maxLength":
            return f"{name} has {len(value)} characters. Allowed: at most {limit}."
        case "minItems":
            return f"{name} has {len(value)} entries. Allowed: at least {limit}."
        case "maxItems":
            return f"{name} has {len(value)} entries. Allowed: at most {limit}."
        case "pattern":
            return f"{name} is {_quoted(value)}. Allowed: {error.schema.get('description', limit)}"
        case _:
            return f"{name}: {error.message}."


_TYPE_WORDS = {
    "string": "text",
    "number": "a number",
    "integer": "a whole number",
    "boolean": "true or false",
    "array": "a list",
    "object": "a group of 'key: value' lines",
}


def _meaning_problems(
    data: dict[str, Any], velocity_topic_of: Callable[[str], str | None] = lambda _robot: None
) -> Iterator[Problem]:
    """What a schema cannot say."""
    seen_places: set[str] = set()
    for index, place in enumerate(data.get("places", [])):
        name = place["name"].casefold()
        if name in seen_places:
            yield ("places", index), f"the place '{place['name']}' is listed twice."
        seen_places.add(name)
    robot = data.get("robot", DEFAULT_ROBOT)
    for index, problem in control_problems(data.get("controls", []), lambda: velocity_topic_of(robot)):
        yield ("controls", index), problem
    yield from _layout_problems(data["layout"], ("layout",), set())


def _layout_problems(node: dict[str, Any], path: KeyPath, seen: set[str]) -> Iterator[Problem]:
    if "children" in node:
        weights = node.get("weights")
        if weights is not None and len(weights) != len(node["children"]):
            yield (
                (*path, "weights"),
                f"{len(weights)} weights for {len(node['children'])} children. Allowed: one weight for each child.",
            )
        for index, child in enumerate(node["children"]):
            yield from _layout_problems(child, (*path, "children", index), seen)
        return
    panels: list[tuple[KeyPath, str]] = [((*path, "panel"), node["panel"])] if "panel" in node else []
    panels += [((*path, "tabs", index), panel) for index, panel in enumerate(node.get("tabs", []))]
    for place, panel in panels:
        if panel in seen:
            yield place, f"the panel '{panel}' is placed twice. Allowed: each panel once."
        seen.add(panel)
    if "current" in node and node["current"] not in node["tabs"]:
        yield (
            (*path, "current"),
            f"'{node['current']}' is not one of these tabs. {_allowed(node['current'], node['tabs'])}",
        )


def _allowed(value: str, allowed: list[str]) -> str:
    close = difflib.get_close_matches(value, allowed, n=1)
    hint = f" Did you mean '{close[0]}'?" if close else ""
    return f"Allowed: {', '.join(allowed)}.{hint}"


def _within(path: KeyPath) -> str:
    return f" in {_name(path)}" if path else ""


def _name(path: KeyPath) -> str:
    text = ""
    for part in path:
        text += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if text else part
    return f"'{text}'"


def _listed(keys: list[str]) -> str:
    return " and ".join(f"'{key}'" for key in keys) + (" is" if len(keys) == 1 else " are")


def _quoted(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    text = repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _scenario(data: dict[str, Any], *, path: Path, sha256: str) -> Scenario:
    defaults = {key: data[key] for key in ("description", "robot", "filler", "voice") if key in data}
    return Scenario(
        title=data["title"],
        layout=layout_from_data(data["layout"]),
        phrases=tuple(data.get("phrases", ())),
        places=tuple(
            Place(
                name=place["name"],
                pose_in_map=Pose2D(
                    float(place["x_m"]), float(place["y_m"]), math.radians(place.get("heading_deg", 0.0))
                ),
            )
            for place in data.get("places", ())
        ),
        controls=tuple(control_from_data(control) for control in data.get("controls", ())),
        permissions=Permissions(**data.get("permissions", {})),
        recording=_recording_from_data(data.get("recording", {})),
        assistant=AssistantSettings(**data.get("assistant", {})),
        driving=DrivingLimits(**{key: float(value) for key, value in data.get("driving", {}).items()}),
        path=path,
        sha256=sha256,
        **defaults,
    )


def _recording_from_data(data: dict[str, Any]) -> RecordingSettings:
    return RecordingSettings(**{**data, "labels": tuple(data.get("labels", ()))})


def _recording_data(recording: RecordingSettings) -> dict[str, Any]:
    data: dict[str, Any] = {"labels": list(recording.labels)} if recording.labels else {}
    return data | {name: True for name in ("lsl", "lsl_words") if getattr(recording, name)}


def _place_data(place: Place) -> dict[str, Any]:
    pose = place.pose_in_map
    return {
        "name": place.name,
        "x_m": plain_number(round(pose.x_m, 4)),
        "y_m": plain_number(round(pose.y_m, 4)),
        "heading_deg": plain_number(round(math.degrees(pose.heading_rad), 3)),
    }


class _ReadableDumper(yaml.SafeDumper):
    """Indents list items under their key, as people write them."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        super().increase_indent(flow, False)


def _schema_reference(path: Path) -> str:
    if path.resolve().parent == layouts_dir().resolve():
        return "../resources/schemas/scenario.schema.json"
    return schema_path().as_uri()


def _write_atomically(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".tmp")
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
