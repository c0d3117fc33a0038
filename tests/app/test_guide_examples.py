"""Examples of README, documentation and guides: readable files and valid commands."""

import argparse
import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

import pytest
import yaml

from caris_desktop.app.arguments import build_parser
from caris_desktop.app.command_table import COMMANDS, parser_of
from caris_desktop.conversation.face.face_file import parse_face
from caris_desktop.domain.shipped import resources_dir
from caris_desktop.recording.study_file import read_study_file
from caris_desktop.robot.profile import parse_profile
from caris_desktop.scenario.scenario_file import parse_scenario

GUIDE = resources_dir() / "guide"
REPOSITORY = Path(__file__).parents[2]
_FILES = (*REPOSITORY.glob("*.md"), *(REPOSITORY / "docs").glob("*.md"), *(REPOSITORY / "examples").glob("*.md"))
PAGES = {
    page.relative_to(page.parents[1] if page.parent.name == "examples" else page.parent).as_posix(): page.read_text(
        "utf-8"
    )
    for page in (*sorted(page for page in _FILES if not page.is_symlink()), *sorted(GUIDE.glob("*.md")))
}
KINDS = ("yaml", "sh", "text", "python", "r", "jinja")
"""Languages of code blocks; text is for lists. tests/test_documentation.py runs Python blocks, test_templates.py the
template."""

SMALLEST = {
    "version": "version: 1",
    "title": "title: My study",
    "layout": "layout: {tabs: [video, speak, conversation, map, people]}",
    "places": "places:\n  - {name: Robot arm, x_m: 1, y_m: 2}",
}
SMALLEST_PROFILE = {"version": "version: 1", "ros": "ros: 1", "velocity": "velocity: {topic: /cmd_vel}"}


def blocks() -> Iterator[tuple[str, str, str]]:
    """Position, language and content of each block."""
    for page, text in PAGES.items():
        found = re.finditer(r"^ *```(\w*)\n(.*?)^ *```$", text, re.DOTALL | re.MULTILINE)
        for number, block in enumerate(found, start=1):
            yield f"{page}, example {number}", block[1], block[2]


EXAMPLES = {where: text for where, kind, text in blocks() if kind == "yaml"}


def whole(text: str, smallest: dict[str, str]) -> str:
    """Part of a file, completed with required keys."""
    given = yaml.safe_load(text)
    return "\n".join([*(line for key, line in smallest.items() if key not in given), text])


def read_scenario(text: str, folder: Path) -> object:
    scenario = parse_scenario(whole(text, SMALLEST), path=folder / "example.yaml")
    assert scenario.title == "My study"
    return scenario


def read_profile(text: str, folder: Path) -> object:
    (folder / "lab-certificates.pem").write_text("")
    return parse_profile(whole(text, SMALLEST_PROFILE), file_name=str(folder / "robot.yaml"), name="robot")


def read_face(text: str, folder: Path) -> object:
    return parse_face(text, file_name=str(folder / "face.yaml"), name="face")


def read_study(text: str, folder: Path) -> object:
    (folder / "study.yaml").write_text(text)
    return read_study_file(folder / "study.yaml")


OF_OTHER_FILES: dict[str, Callable[[str, Path], object]] = {
    "robot-profiles.md": read_profile, "face.md": read_face, "sharing.md": read_study,
}  # fmt: skip


def test_each_block_is_marked_as_what_it_is() -> None:
    assert [where for where, kind, _ in blocks() if kind not in KINDS] == []
    assert 2 * len(list(blocks())) == sum(text.count("```") for text in PAGES.values())
    assert len(EXAMPLES) > 30


@pytest.mark.parametrize("where", EXAMPLES)
def test_an_example_can_be_read(where: str, tmp_path: Path) -> None:
    read = OF_OTHER_FILES.get(where.partition(",")[0], read_scenario)
    assert read(EXAMPLES[where], tmp_path) is not None


# Commands

_OURS = re.compile(r"(?:[A-Z_]+=\S+ +)*(?:\S*/)?caris-desktop(?P<words> .*|)")
_FILLED_IN = {"FORMAT": "csv"}
_PLACEHOLDER = re.compile(r"[A-Z][A-Z_]*|\w+\.txt")


def commands() -> Iterator[tuple[str, str, bool]]:
    """Position, arguments, and completeness of each command; within a sentence it may contain just an option."""
    for page, text in PAGES.items():
        outside = re.sub(r"^ *```.*?^ *```$", "", text, flags=re.DOTALL | re.MULTILINE)
        for code in re.findall(r"`([^`\n]+)`", outside):
            if ours := _OURS.fullmatch(code):
                yield page, ours["words"], False
        for line in re.findall(r"^ {4}(\S.*)$", outside, re.MULTILINE):
            if ours := _OURS.fullmatch(line):
                yield page, ours["words"], True
    for where, kind, text in blocks():
        for line in re.sub(r" *\\\n *", " ", text).splitlines() if kind != "yaml" else ():
            if ours := _OURS.fullmatch(line):
                yield where, re.split(r" {2,}", ours["words"])[0], True


COMMAND_LINES = sorted(set(commands()))


class NotUnderstoodError(Exception):
    """Error message of the program."""


def refusal_of(words: str, *, needs_all: bool) -> str:
    """Reason why the program would refuse the command; empty if it is valid.

    ``[`` and ``]`` mark optional parts, ``|`` alternatives, and capitals placeholders.
    """
    given = [re.split(r"(?<=\w)\|", word)[0] for word in shlex.split(re.sub(r"\.\.\.|\[,[^]]*\]|[][]", " ", words))]
    parser = parser_of(given.pop(0)) if given and given[0] in COMMANDS else build_parser()

    def refuse(message: str) -> NoReturn:
        raise NotUnderstoodError(message)

    parser.error = refuse  # type: ignore[method-assign]
    for number, word in enumerate(given):
        if _PLACEHOLDER.fullmatch(word):
            given[number] = _filled_in(word, parser, given[number - 1] if number else "")
    try:
        parser.parse_args(given)
    except NotUnderstoodError as refused:
        if needs_all or "required" not in str(refused):
            return str(refused)
    except SystemExit as ended:  # --version and --help exit
        return str(ended.code or "")
    return ""


def _filled_in(word: str, parser: argparse.ArgumentParser, option: str) -> str:
    """Valid value of the option: the first of its choices, else a number or the word."""
    action: Any = next((one for one in parser._actions if option in one.option_strings), None)
    if action is None:
        return word
    if action.choices:
        return str(next(iter(action.choices)))
    return "1" if action.type in (int, float) else _FILLED_IN.get(word, word)


def test_there_are_commands_of_every_kind_on_the_pages() -> None:
    assert len(COMMAND_LINES) > 40
    named = {words.split()[0] for _, words, _ in COMMAND_LINES if words.split()}
    assert set(COMMANDS) <= named, "each command of the program stands somewhere"


@pytest.mark.parametrize(("where", "words", "needs_all"), COMMAND_LINES)
def test_a_command_is_understood(where: str, words: str, needs_all: bool) -> None:
    assert refusal_of(words, needs_all=needs_all) == "", where


@pytest.mark.parametrize(
    "words",
    [
        "--nonsense",
        "--theme red",
        "nonsense",
        "simulate --port many",
        "rehearse SCENARIO",
        "replay SESSION --att 3",
        "track VIDEO --out RESULT.txt --tracker nobody",
    ],
)
def test_a_refused_example_is_found(words: str) -> None:
    assert refusal_of(words, needs_all=True) != ""
