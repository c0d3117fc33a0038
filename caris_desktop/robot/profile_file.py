"""The text of a robot profile: YAML with its lines, checked against the schema, and written for people to read."""

import difflib
import re
from collections.abc import Iterable, Mapping
from typing import Any

import jsonschema
import yaml

from caris_desktop.domain.migrations import Migration, migrated
from caris_desktop.domain.shipped import schema_validator
from caris_desktop.domain.yaml_source import KeyPath, PlainScalars, YamlSourceError, know_scalars, parse_yaml
from caris_desktop.robot.profile_model import ProfileError

PROFILE_VERSION = 1
MIGRATIONS: Mapping[int, Migration] = {}
SCHEMA = "robot-profile.schema.json"
MAX_BYTES = 2**20


_TYPE_WORDS = {
    "number": "a number",
    "integer": "a whole number",
    "string": "text",
    "boolean": "true or false",
    "array": "a list",
    "object": "made of 'name: value' pairs",
}


class _Dumper(PlainScalars, yaml.SafeDumper):
    """Short mappings and lists on one line, and as few quotation marks as the reader needs."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


know_scalars(_Dumper)


class ProfileText:
    """The data of one profile, and where in the file each part of it is written."""

    def __init__(self, text: str, file_name: str) -> None:
        """Read ``text``; ``file_name`` is used in messages only. Raises ProfileError."""
        self.file_name = file_name
        if len(text) > MAX_BYTES:
            raise ProfileError(f"{file_name}: this is larger than 1 MB and no robot profile.")
        try:
            self._source = parse_yaml(text)
        except YamlSourceError as error:
            raise ProfileError(f"{file_name}, line {error.line}: {error}.") from error
        if not isinstance(self._source.data, dict):
            raise ProfileError(f"{file_name}: a robot profile is a list of 'name: value' lines; this file is not.")
        self.data: dict[str, Any] = self._source.data

    def check(self) -> None:
        """Version and schema; the data are those of the newest version from then on. Raises ProfileError."""
        version = self._known_version()
        self.data = migrated(self.data, MIGRATIONS, version=version, newest=PROFILE_VERSION)
        problem = jsonschema.exceptions.best_match(schema_validator(SCHEMA).iter_errors(self.data))
        if problem is not None:
            raise self._explained(problem)

    def mistake(self, path: KeyPath, message: str) -> ProfileError:
        """The error to raise for what is written at ``path``."""
        return ProfileError(f"{self._place(path)}: {_dotted(path)}: {message}")

    def _place(self, path: KeyPath) -> str:
        return f"{self.file_name}, line {self._source.line_of(path)}"

    def _known_version(self) -> int:
        version = self.data.get("version")
        place = self._place(("version",))
        if not isinstance(version, int) or isinstance(version, bool) or version < 1:
            raise ProfileError(
                f"{place}: 'version' is missing or not a whole number; write 'version: {PROFILE_VERSION}'."
            )
        if version > PROFILE_VERSION:
            raise ProfileError(
                f"{place}: this profile has version {version}, made for a newer CARIS Desktop; "
                f"this one reads version {PROFILE_VERSION}. Update the program or use an older profile."
            )
        return version

    def _explained(self, problem: jsonschema.ValidationError) -> ProfileError:
        path: KeyPath = tuple(problem.absolute_path)
        where = _dotted(path)
        place = self._place(path)
        found: Any = problem.instance
        rule: Any = problem.validator_value
        schema: dict[str, Any] = problem.schema if isinstance(problem.schema, dict) else {}
        hint = schema.get("description", "")
        match problem.validator:
            case "additionalProperties":
                allowed = sorted(schema.get("properties", {}))
                unknown = next(str(key) for key in found if key not in allowed)
                return ProfileError(
                    f"{self._place((*path, unknown))}: {unknown!r} is not known in {where}."
                    f"{did_you_mean(unknown, allowed)} Allowed are: {', '.join(allowed)}."
                )
            case "required":
                return ProfileError(f"{place}: {where} lacks {next(key for key in rule if key not in found)!r}.")
            case "enum":
                allowed = [str(value) for value in rule]
                return ProfileError(
                    f"{place}: {where} is {found!r}; allowed are: {', '.join(allowed)}.{did_you_mean(found, allowed)}"
                )
            case "oneOf" | "anyOf" | "not" if "$comment" in schema:
                return ProfileError(f"{place}: {where}: {schema['$comment']}.")
            case "oneOf" | "anyOf" | "not" if isinstance(found, dict) and "kind" in found:
                return ProfileError(f"{place}: {where}: {_control_rule(found)}.")
            case "type" if found is None:
                words = " is empty"
            case "type":
                words = f" is {_shown(found)}, which is not {_TYPE_WORDS.get(str(rule), rule)}"
            case "pattern":
                words = f": {_shown(found)} cannot be used"
            case _:
                words = f": {problem.message}"
        return ProfileError(f"{place}: {where}{words}." + (f" Expected: {hint}." if hint else ""))


def _shown(found: Any) -> str:
    """What is in the file, short; a password in an address is not repeated in a log."""
    text = re.sub(r"//[^/@\s]*@", "//...@", repr(found))
    return text if len(text) <= 60 else f"{text[:56]} ..."


def did_you_mean(word: Any, allowed: Iterable[str]) -> str:
    """A suggestion to put behind a message, or nothing."""
    near = difflib.get_close_matches(str(word), list(allowed), n=1, cutoff=0.6)
    return f" Did you mean {near[0]!r}?" if near else ""


def profile_yaml(data: Mapping[str, Any]) -> str:
    """A profile's content as text: sections apart, what is short on one line."""
    chunks = [
        "# A robot profile of CARIS Desktop. The guide of robot profiles explains every line.\n",
    ]
    previous = ""
    for key, value in data.items():
        chunk = _section(key, value, default_flow_style=None)
        if isinstance(value, Mapping) and chunk.count("\n") > 1 and chunk.startswith(f"{key}: {{"):
            # too long for one line
            chunk = _section(key, value, default_flow_style=False)
        if previous and (chunk.count("\n") > 1 or previous.count("\n") > 1):
            chunks.append("\n")
        chunks.append(chunk)
        previous = chunk
    return "".join(chunks)


def _section(key: str, value: Any, *, default_flow_style: bool | None) -> str:
    text: str = yaml.dump(
        {key: value},
        Dumper=_Dumper,
        sort_keys=False,
        allow_unicode=True,
        default_flow_style=False if not isinstance(value, (Mapping, list)) else default_flow_style,
        width=110,
    )
    return text


def _dotted(path: KeyPath) -> str:
    return ".".join(str(step) for step in path) or "the profile"


def _control_rule(control: Mapping[str, Any]) -> str:
    if control["kind"] == "readout":
        return "a readout only shows something: it has 'shows' and none of publish, call, action"
    return f"a {control['kind']} does exactly one thing: give one of publish, call, action"
