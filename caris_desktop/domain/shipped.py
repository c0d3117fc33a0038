"""Where the files that come with the program are: beside the package in a checkout, inside it in a wheel."""

import functools
import json
from pathlib import Path
from typing import Any

_PACKAGE = Path(__file__).resolve().parents[1]


def _shipped(name: str) -> Path:
    inside_wheel = _PACKAGE / "_data" / name
    return inside_wheel if inside_wheel.is_dir() else _PACKAGE.parent / name


def resources_dir() -> Path:
    return _shipped("resources")


def layouts_dir() -> Path:
    return _shipped("layouts")


@functools.cache
def schema_validator(file_name: str) -> Any:
    """The jsonschema validator of a file in ``resources/schemas``; schemas there may refer to one another by name."""
    import jsonschema
    from referencing import Registry, Resource

    def read(path: Path) -> Any:
        return json.loads(path.read_text(encoding="utf-8"))

    folder = resources_dir() / "schemas"
    registry: Registry[Any] = Registry().with_resources(
        (path.name, Resource.from_contents(read(path))) for path in folder.glob("*.schema.json")
    )
    return jsonschema.Draft202012Validator(read(folder / file_name), registry=registry)
