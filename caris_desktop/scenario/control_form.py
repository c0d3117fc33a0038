"""A control of the Robot panel in a scenario file: robot profiles have the same, and one schema says what they are."""

from collections.abc import Iterator
from typing import Any

from caris_desktop.domain.controls import control_data, control_from_data
from caris_desktop.domain.declared import Foreign, Problem
from caris_desktop.domain.declared_check import (
    allowed_words,
    missing_keys,
    name_of,
    quoted,
    unknown_key,
    wrong_kind,
)
from caris_desktop.domain.shipped import schema_validator
from caris_desktop.domain.yaml_source import KeyPath

_SCHEMA = "robot-control.schema.json"
_TYPE_WORDS = {
    "string": "text",
    "number": "a number",
    "integer": "a whole number",
    "boolean": "true or false",
    "array": "a list",
    "object": "a group of 'key: value' lines",
}


def _problems(data: Any, path: KeyPath) -> Iterator[Problem]:
    errors = [(error, (*path, *error.absolute_path)) for error in schema_validator(_SCHEMA).iter_errors(data)]
    # Where a key is misspelled, what seems to be missing is probably there.
    misspelled = {place for error, place in errors if error.validator == "additionalProperties"}
    for error, place in errors:
        if error.validator == "additionalProperties":
            known = error.schema["properties"]
            for key in error.instance:
                if key not in known:
                    yield (*place, key), unknown_key(key, known, error.instance, place)
        elif error.validator in ("required", "oneOf", "not") and place in misspelled:
            continue
        elif error.validator == "required":
            # jsonschema tells the missing key only inside its message, so it is worked out again here.
            missing = [key for key in error.validator_value if key not in error.instance]
            if error.message.startswith(repr(missing[0])):
                yield place, missing_keys(missing, place)
        else:
            yield place, _value_problem(error, place)


def _value_problem(error: Any, path: KeyPath) -> str:
    value, limit, name = error.instance, error.validator_value, name_of(path)
    match error.validator:
        case "enum":
            return f"unknown {name} {quoted(value)}. {allowed_words(str(value), [str(item) for item in limit])}"
        case "type":
            return wrong_kind(_TYPE_WORDS.get(str(limit), str(limit)), value, path)
        case "minimum":
            return f"{name} is {value}. Allowed: at least {limit}."
        case "maximum":
            return f"{name} is {value}. Allowed: at most {limit}."
        case "minLength" | "minItems":
            return f"{name} is empty." if not value else f"{name}: {error.message}."
        case "maxLength" | "maxItems":
            return f"{name} is too long. Allowed: at most {limit}."
        case "pattern":
            return f"{name} is {quoted(value)}. Allowed: {error.schema.get('description', limit)}"
        case "oneOf" | "not":
            return f"{name} must do exactly one thing: a readout has 'shows', others one of publish, call and action."
        case _:
            return f"{name}: {error.message}."


CONTROL_FORM = Foreign(_SCHEMA, "robot-profiles.md#the-robot-panel", _problems, control_from_data, control_data)
