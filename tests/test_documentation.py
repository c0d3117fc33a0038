"""Documentation and project files: the site builds, generated pages are current, and paths and examples exist."""

import ast
import importlib
import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import pytest
import yaml

from caris_desktop import __version__

REPOSITORY = Path(__file__).resolve().parents[1]
DOCS = REPOSITORY / "docs"
ROOT_PAGES = sorted(REPOSITORY.glob("*.md"))
PAGES = [*ROOT_PAGES, REPOSITORY / "examples" / "README.md", *sorted(DOCS.glob("*.md"))]


def script(name: str) -> ModuleType:
    """Import a script of docs/, which is not a package."""
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_site_builds_without_a_warning_or_a_broken_link(tmp_path: Path) -> None:
    if importlib.util.find_spec("material") is None or importlib.util.find_spec("mkdocs") is None:
        pytest.skip("mkdocs-material is not installed: pip install '.[docs]'")
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")]
    built = subprocess.run(build, cwd=REPOSITORY, capture_output=True, text=True, timeout=100, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    for page in ("index", "tutorial", "guide/wizard", "guide/tables", "architecture"):
        html = (tmp_path / "site" / f"{page}.html").read_text("utf-8")
        assert not re.search(r'(?:src|href)="(?:https?:)?//[^"]+\.(?:js|css|woff2?)"', html), (
            "loads nothing from elsewhere"
        )


def links(page: Path) -> list[str]:
    text = re.sub(r"^ *```.*?^ *```$", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    return [link for link in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in link]


@pytest.mark.parametrize("page", [*ROOT_PAGES, REPOSITORY / "examples" / "README.md"], ids=lambda page: page.name)
def test_links_of_the_pages_that_repositories_show_lead_to_files(page: Path) -> None:
    assert [link for link in links(page) if not (page.parent / link.partition("#")[0]).exists()] == []


def test_the_readme_is_short() -> None:
    assert 500 <= len((REPOSITORY / "README.md").read_text("utf-8").split()) <= 900


@pytest.mark.parametrize("name", ["ARCHITECTURE.md", "CONTRIBUTING.md"])
def test_paths_that_a_page_names_exist(name: str) -> None:
    text = re.sub(r"\b(?:FILE|NAME)\b", "", (REPOSITORY / name).read_text("utf-8"))
    named = re.findall(r"`((?:[\w.-]+/)+[\w.-]*)`", text)
    assert len(named) > 10
    places = (REPOSITORY, REPOSITORY / "caris_desktop")
    assert [path for path in named if not any((place / path).exists() for place in places)] == []


@pytest.mark.long
def test_the_drawing_shows_the_packages_and_imports_that_there_are() -> None:
    drawing = script("architecture_drawing")
    rows = drawing.layers()
    shown = (DOCS / "architecture.svg").read_text("utf-8")
    assert re.findall(r'<g id="(\w+)">', shown) == [name for row in rows for name in row]
    packages = {path.name for path in (REPOSITORY / "caris_desktop").iterdir() if (path / "__init__.py").is_file()}
    assert packages == {name for row in rows for name in row}
    between = drawing.imports_between(rows)
    words = re.sub(r"</text>\s*<text[^>]*>", " ", shown)
    for name in packages:
        imports = sorted(other for importing, other in between if importing == name)
        box = words.partition(f'<g id="{name}">')[2].partition("</g>")[0]
        imports_in_box = re.findall(r"Imports: ([\w, ]+)", box)
        assert imports_in_box == ([", ".join(imports)] if imports else []), "run: python docs/architecture_drawing.py"


def test_every_dependency_is_in_the_table_of_licences() -> None:
    licences = script("third_party")
    shown = dict(re.findall(r"^\| ([\w.-]+) \| [\w-]* \| (.+) \|$", licences.PAGE.read_text("utf-8"), re.MULTILINE))
    for package in licences.dependencies():
        assert shown.get(package), f"{package}: run python docs/third_party.py"
        if importlib.util.find_spec(package.replace("-", "_").lower()) is not None:
            assert shown[package] == licences.licence_of(package), f"{package}: run python docs/third_party.py"


def test_every_shipped_model_is_in_the_table_of_licences() -> None:
    rows = script("third_party")._MODELS
    pinned = re.findall(r"^([\w-]+)==", (REPOSITORY / "packaging" / "models.txt").read_text("utf-8"), re.MULTILINE)
    assert {row[0] for row in rows} >= set(pinned)
    assert all(row[2] for row in rows)


def test_project_files_agree_on_version_and_licence() -> None:
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text("utf-8"))
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]
    reuse = tomllib.loads((REPOSITORY / "REUSE.toml").read_text("utf-8"))["annotations"]
    assert citation["version"] == __version__
    assert f"## [{__version__}]" in (REPOSITORY / "CHANGELOG.md").read_text("utf-8")
    assert {citation["license"], project["license"], *(one["SPDX-License-Identifier"] for one in reuse)} == {
        "AGPL-3.0-or-later"
    }
    assert citation["authors"] == project["authors"]


@pytest.mark.parametrize(
    "form", sorted((REPOSITORY / ".github" / "ISSUE_TEMPLATE").glob("*.yml")), ids=lambda path: path.name
)
def test_an_issue_form_is_one(form: Path) -> None:
    read = yaml.safe_load(form.read_text("utf-8"))
    if form.name != "config.yml":
        assert read["name"] and read["description"]
        ids = [field["id"] for field in read["body"] if field["type"] != "markdown"]
        assert ids and len(set(ids)) == len(ids)


def python_blocks() -> dict[str, str]:
    return {
        f"{page.name}, example {number}": code
        for page in PAGES
        for number, code in enumerate(
            re.findall(r"^```python\n(.*?)^```$", page.read_text("utf-8"), re.DOTALL | re.MULTILINE)
        )
    }


@pytest.mark.parametrize("where", python_blocks())
def test_python_in_the_documentation_compiles(where: str) -> None:
    ast.parse(python_blocks()[where])
