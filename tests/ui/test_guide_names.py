"""Names in bold within a sentence of README, documentation and guides exist in the window."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from caris_desktop.domain.shipped import layouts_dir, resources_dir
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.ui.action_rows import ACTIONS

PACKAGE = Path(__file__).parents[2] / "caris_desktop"
REPOSITORY = PACKAGE.parent
PAGES = (
    *sorted(REPOSITORY.glob("*.md")),
    *sorted(page for page in (REPOSITORY / "docs").glob("*.md") if not page.is_symlink()),
    *sorted((resources_dir() / "guide").glob("*.md")),
)
EMPHASISED = {
    "sessions.md": {"Identities"},  # in addition to the bold start of that line
}
"""Bold text within a sentence that is not a name."""

_BOLD = re.compile(r"\*\*([^*]+)\*\*")
_BLOCK = re.compile(r"^ *```.*?^ *```$", re.DOTALL | re.MULTILINE)
_AT_THE_START = re.compile(r"(?:\A|\n\n|[.:;]\n|\n *[-*] |\n *\d+\. |\| )$")
"""Start of a paragraph, list item, table cell or sentence on a separate line, where its subject may be bold."""
_PLACE = re.compile(r"\\\{\w+\\\}|%n")
_LEAST_LETTERS = 3
VERBS = {spec.text.split()[0] for spec in ACTIONS}


@cache
def said_by_the_window() -> tuple[frozenset[str], tuple[re.Pattern[str], ...]]:
    """Texts of the window, and patterns of those with placeholders, whose values do not start with a lower-case
    letter.
    """
    trees = (ast.parse(path.read_text("utf-8")) for path in PACKAGE.rglob("*.py"))
    calls = (node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Call) and node.args)
    marked = (
        call.args[0] for call in calls if isinstance(call.func, ast.Name) and call.func.id in ("tr", "QT_TR_NOOP")
    )
    texts = {node.value for node in marked if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    texts |= {load_scenario(path).title for path in layouts_dir().glob("*.yaml")}
    filled = [
        re.compile(_PLACE.sub("[^a-z].*", re.escape(bare(text))))
        for text in texts
        if ("{" in text or "%n" in text)
        and len(re.findall(r"[A-Za-z]", re.sub(r"\{\w+\}|%n", "", text))) >= _LEAST_LETTERS
    ]
    return frozenset(bare(text).casefold() for text in texts), tuple(filled)


def bare(text: str) -> str:
    """Text without dots at its end, in one line."""
    return re.sub(r"[ .…:?]+$", "", " ".join(text.split()))


def is_there(name: str) -> bool:
    texts, filled = said_by_the_window()
    return bare(name).casefold() in texts or any(pattern.fullmatch(bare(name)) for pattern in filled)


def names_in(text: str) -> Iterator[str]:
    """Bold texts within a sentence that start as names do, and bold texts at a start that start as commands do."""
    text = _BLOCK.sub("", text)
    for bold in _BOLD.finditer(text):
        words = " ".join(bold[1].split())
        starts = _AT_THE_START.search(text[: bold.start()]) and words.split()[0] not in VERBS
        if words[0].isupper() and not starts and not re.search(r"[^.]\.$", words):
            yield from words.split(" > ")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
@pytest.mark.long("CHANGELOG.md", "README.md")
def test_names_on_a_page_are_in_the_window(page: Path) -> None:
    names = dict.fromkeys(names_in(page.read_text("utf-8")))
    gone = [name for name in names if not is_there(name) and name not in EMPHASISED.get(page.name, ())]
    assert gone == [], "The window has nothing that is called so: name it as it is called there."


def test_each_exception_still_stands_on_its_page() -> None:
    for page in PAGES:
        assert EMPHASISED.get(page.name, set()) <= set(names_in(page.read_text("utf-8"))), page.name


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("It is in **Find anything** and **Robot >\nConnect another robot...** there.",
         ["Find anything", "Robot", "Connect another robot..."]),
        ("**Checksums.** They are kept.\n\n- **Piper** voices", []),
        ("**Go to** opens it.", ["Go to"]),
        ("Some are **coders**, and **this is loud**.", []),
        ("```\n**Not code**\n```\n", []),
    ],
)  # fmt: skip
def test_recognised_names(text: str, names: list[str]) -> None:
    assert list(names_in(text)) == names


@pytest.mark.parametrize(
    ("name", "there"),
    [
        ("Find anything", True),
        ("Go to ...", True),
        ("Wizard: Ana", True),
        ("Not Luis", True),
        ("Tour guide", True),
        ("Put the panels back", False),
        ("Save this panel layout", False),
    ],
)
def test_names_in_the_window(name: str, there: bool) -> None:
    assert is_there(name) is there
