"""Every example that the guide gives of a scenario file is one, by itself or in the smallest scenario."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from caris_desktop.domain.shipped import resources_dir
from caris_desktop.scenario.file import parse_scenario

SMALLEST = "version: 1\ntitle: My study\nlayout:\n  panel: video\n"


PAGES = ("scenarios.md", "scenario-file.md")


def examples() -> Iterator[tuple[str, str]]:
    for page in PAGES:
        text = (resources_dir() / "guide" / page).read_text(encoding="utf-8")
        for number, block in enumerate(re.findall(r"^```yaml\n(.*?)^```$", text, re.DOTALL | re.MULTILINE), start=1):
            yield f"{page}, example {number}", block


EXAMPLES = dict(examples())


def test_there_are_as_many_as_the_pages_have() -> None:
    fences = sum((resources_dir() / "guide" / page).read_text("utf-8").count("```") for page in PAGES)
    assert len(EXAMPLES) * 2 == fences > 10, "each is marked as yaml"


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_a_scenario(name: str, tmp_path: Path) -> None:
    text = EXAMPLES[name]
    whole = text if "layout:" in text else SMALLEST + text
    scenario = parse_scenario(whole, path=tmp_path / "example.yaml")
    assert scenario.title == "My study"
