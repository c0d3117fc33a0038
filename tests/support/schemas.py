"""The shipped JSON Schemas as applied by editors and other programs."""

import functools
import json
from pathlib import Path
from typing import Any

import jsonschema
from referencing import Registry, Resource

from caris_desktop.domain.shipped import resources_dir


@functools.cache
def schema_validator(file_name: str) -> jsonschema.Draft202012Validator:
    """Validator for a file in ``resources/schemas``; schemas may refer to one another by name."""

    def read(path: Path) -> Any:
        return json.loads(path.read_text(encoding="utf-8"))

    folder = resources_dir() / "schemas"
    registry: Registry[Any] = Registry().with_resources(
        (path.name, Resource.from_contents(read(path))) for path in folder.glob("*.schema.json")
    )
    schema = read(folder / file_name)
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema, registry=registry)
