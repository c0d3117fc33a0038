"""Guide of robot profiles: its examples work, and it explains every key."""

import json
import re
from collections.abc import Iterator
from typing import Any

import pytest
import yaml

from caris_desktop.domain.shipped import resources_dir
from caris_desktop.robot.profile import ProfileText, parse_profile, shipped_profiles

GUIDE = (resources_dir() / "guide" / "robot-profiles.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```yaml\n(.*?)```", GUIDE, re.DOTALL)
WHOLE = "version: 1\nros: 1\nvelocity: {topic: /cmd_vel}\n"


def _keys(schema: Any) -> Iterator[str]:
    if isinstance(schema, dict):
        for name, below in schema.get("properties", {}).items():
            yield name
            yield from _keys(below)
        for part, below in schema.items():
            if part != "properties":
                yield from _keys(below)
    elif isinstance(schema, list):
        for below in schema:
            yield from _keys(below)


def test_there_are_examples() -> None:
    assert len(EXAMPLES) >= 10


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_is_a_profile_or_a_part_of_one(example: str, tmp_path: Any) -> None:
    (tmp_path / "lab-certificates.pem").write_text("")
    given = ProfileText(example, "guide").data
    head = "".join(line + "\n" for line in WHOLE.splitlines() if line.split(":")[0] not in given)
    profile = parse_profile(head + example, file_name=str(tmp_path / "robot.yaml"), name="robot")
    assert profile.velocity.topic.startswith("/")
    # An ordinary YAML reader, as in editors, must read it alike; YAML 1.1 reads 'on' as a boolean.
    ordinary = yaml.safe_load(example)
    assert set(ordinary) == set(given)


@pytest.mark.parametrize("schema", ["robot-profile", "robot-control"])
def test_every_key_is_explained(schema: str) -> None:
    keys = set(_keys(json.loads((resources_dir() / "schemas" / f"{schema}.schema.json").read_text(encoding="utf-8"))))
    assert len(keys) > 15
    explained = set(re.findall(r"`([a-z_0-9]+)`", GUIDE))
    assert keys - explained == set()


def test_every_key_is_in_an_example() -> None:
    keys = set(
        _keys(json.loads((resources_dir() / "schemas" / "robot-profile.schema.json").read_text(encoding="utf-8")))
    )
    alternatives = {
        "footprint_radius_m", "radius_m", "heading_rad", "tilt_rad", "fy_px", "service_field", "service_type",
        "command_topic", "pan_sign", "simulation_time", "on_head",
    }  # fmt: skip
    shown = {word for example in EXAMPLES for word in re.findall(r"([a-z_0-9]+):", example)}
    assert keys - shown == alternatives


def test_every_key_has_a_description_for_editors() -> None:
    def undescribed(schema: Any, path: str, defs: Any) -> Iterator[str]:
        for name, below in schema.get("properties", {}).items():
            target = defs.get(below.get("$ref", "").rpartition("/")[2], {})
            if not (below.get("description") or target.get("description")):
                yield f"{path}.{name}"
            yield from undescribed(below, f"{path}.{name}", defs)
            yield from undescribed(below.get("items", {}), f"{path}.{name}[]", defs)

    schema = json.loads((resources_dir() / "schemas" / "robot-profile.schema.json").read_text(encoding="utf-8"))
    assert list(undescribed(schema, "", schema["$defs"])) == []


def test_every_shipped_profile_is_named() -> None:
    for name in shipped_profiles():
        assert f"`{name}`" in GUIDE
