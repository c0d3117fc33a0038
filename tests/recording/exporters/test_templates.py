"""Researchers' own templates of the methods sheet and the report."""

import argparse
import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest
from markupsafe import Markup

from caris_desktop.app import export_command
from caris_desktop.recording.exporters import html, methods
from caris_desktop.recording.session_export import ExportContext, export_session
from tests.recording.told_session import TRIAL, heard, said, tell, tour

GUIDE = Path(__file__).parents[3] / "docs" / "guide" / "sessions.md"
EVIL = "<b>_P*1_</b>"


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("templates") / "sessions" / "s1"
    return tell(folder, tour(3, minutes=2.0, building=False), lasts_s=120.0, trial=TRIAL | {"participant": EVIL})


def run(*words: str | Path) -> int:
    parser = argparse.ArgumentParser()
    export_command.add_arguments(parser)
    return export_command.run(parser.parse_args([str(word) for word in words]))


def own(folder: Path, text: str, name: str = "my.md.j2") -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


@pytest.mark.parametrize(("fmt", "suffix"), [("methods", ".md"), ("methods", ".html"), ("html", ".html")])
def test_the_printed_template_makes_what_the_program_makes(
    fmt: str, suffix: str, session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        run("--print-template", fmt)
    assert not ended.value.code
    template = own(tmp_path, capsys.readouterr().out, f"my{suffix}.j2")
    assert run(session, "--to", fmt, "--template", template, tmp_path / "own") == 0
    export_session(session, fmt, tmp_path / "shipped")
    (written,) = (tmp_path / "own").iterdir()
    assert written.suffix == suffix
    assert written.read_bytes() == (tmp_path / "shipped" / written.name).read_bytes()


def test_the_example_of_the_guide_is_a_template(session: Path, tmp_path: Path) -> None:
    text = GUIDE.read_text("utf-8")
    (example,) = re.findall(r"```jinja\n(.*?)```", text, re.DOTALL)
    template = own(tmp_path, example, "journal.md.j2")
    assert run(session, "--to", "methods", "--template", template, tmp_path / "out") == 0
    made = (tmp_path / "out" / "methods.md").read_text("utf-8")
    assert "## Procedure\n\nOne participant met the robot (Simulated robot), which\none wizard drove for" in made
    assert re.search(r"answered after median \d\.\d\d s \(n = \d+, .*\), and\n\d+% of its utterances were", made)
    assert re.search(r"\| s1 \| humour \| \d+\.\d s \|", made)


@pytest.mark.parametrize(
    ("name", "escaped"), [("my.md.j2", r"\<b\>\_P\*1\_\</b\>"), ("my.html.j2", "&lt;b&gt;_P*1_&lt;/b&gt;")]
)
def test_values_are_escaped(name: str, escaped: str, session: Path, tmp_path: Path) -> None:
    template = own(tmp_path, '<i>{{ participants | join_words }}</i>{% include "part.j2" %}', name)
    own(tmp_path, "*{{ participants[0] }}*", "part.j2")
    assert run(session, "--to", "methods", "--template", template, tmp_path / "out") == 0
    made = (tmp_path / "out" / name.replace("my", "methods").removesuffix(".j2")).read_text("utf-8")
    assert made == f"<i>{escaped}</i>*{escaped}*"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a\n{{ nobody }}", "my.md.j2, line 2: 'nobody' is undefined"),
        ("a\n\n{% if x %}", "my.md.j2, line 3: Unexpected end of template"),
        ("{{ total.driven }}", "my.md.j2, line 1: 'dict object' has no attribute 'driven'"),
        ("\n{{ 1 / 0 }}", "my.md.j2, line 2: division by zero"),
        ('{% include "part.j2" %}', "part.j2, line 2: 'nobody' is undefined"),
        ('{% include "../secret.j2" %}', "line 1: there is no file ../secret.j2 in the folder of the template"),
        ('{% include "linked.j2" %}', "line 1: there is no file linked.j2 in the folder of the template"),
        ('{% include "/etc/hostname" %}', "line 1: there is no file /etc/hostname"),
        ("{{ sessions[0].name.__class__ }}", "line 1: access to attribute '__class__' of 'str' object is unsafe"),
        ("{% set _ = sessions.clear() %}", "line 1: "),
        ("{% for i in range(9999) %}{% for i in range(9999) %}{% endfor %}{% endfor %}", "does not come to an end"),
        ("{{ range(999999999) | list }}", "line 1: Range too big"),
        ("{{ 'x' * 10 ** 9 }}", "line 1: ** is for numbers that stay small"),
        ("{{ 'x' * 1000000000 }}", "line 1: * is for numbers that stay small"),
    ],
)
def test_a_mistake_is_told_with_file_and_line_and_nothing_is_written(
    text: str, told: str, session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "templates"
    folder.mkdir()
    own(folder, "a\n{{ nobody }}", "part.j2")
    (folder / "linked.j2").symlink_to(own(tmp_path, "secret", "secret.j2"))
    assert run(session, "--to", "methods", "--template", own(folder, text), tmp_path / "out") == 1
    message = capsys.readouterr().err
    assert told in message
    assert "Nothing was written; correct the template" in message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "to", "told"),
    [
        ("my.txt", "methods", "the name of a template ends with .md.j2 or .html.j2"),
        ("none.md.j2", "methods", "none.md.j2, line 1: there is no such file"),
        ("my.md.j2", "methods,html", "A template is for one format: methods, html."),
        ("my.md.j2", "csv", "A template is for one format"),
    ],
)
def test_a_template_that_cannot_be_used_is_told_at_once(
    name: str, to: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own(tmp_path, "text", name.replace("none", "another"))
    assert run(tmp_path / "no-session", "--to", to, "--template", tmp_path / name, tmp_path / "out") == 1
    assert told in capsys.readouterr().err


def test_templates_get_nothing_but_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A path or a session would let a template of somebody else change files."""
    values: dict[str, Any] = {}

    def write(out: Path, _name: str, _template: Path, /, **data: Any) -> Path:
        values.update(data)
        return out

    for module in (methods, html):
        monkeypatch.setattr(module, "write_own_page", write)
    folder = tell(tmp_path / "s", [*heard(1, 1.0, 2.0, "Hi"), *said(1, 3.0, 3.1, 4.0, "Ho")], lasts_s=9.0)
    for fmt in ("methods", "html"):
        export_session(folder, fmt, tmp_path / fmt, ExportContext(template=tmp_path / "my.md.j2"))
    assert {"total", "time_line"} <= set(values)

    def check(value: Any) -> None:
        if is_dataclass(value):
            for field in fields(value):
                check(getattr(value, field.name))
        elif isinstance(value, dict):
            assert all(isinstance(key, str) for key in value)
            for inner in value.values():
                check(inner)
        elif isinstance(value, list | tuple | set | frozenset):
            for inner in value:
                check(inner)
        else:
            assert value is None or isinstance(value, str | Markup | int | float), value

    check(values)
