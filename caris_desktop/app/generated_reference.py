"""Generator of derived files: ``python -m caris_desktop.app.generated_reference``.

It writes the JSON Schemas, the guide's tables of file keys, shortcuts, commands and data, and the texts that a replay
translates. A test fails if one of them is outdated.
"""

import argparse
import ast
import json
from collections.abc import Iterator
from pathlib import Path

from caris_desktop.app.arguments import build_parser
from caris_desktop.app.command_table import COMMANDS, parser_of
from caris_desktop.conversation.face.face_file import Face
from caris_desktop.domain.control_definitions import RobotControl
from caris_desktop.domain.recorded_messages import TEXTS_PATH
from caris_desktop.domain.schema_json import reference, schema_text, with_tables
from caris_desktop.domain.shipped import resources_dir
from caris_desktop.recording.annotation.annotation_store import Coding
from caris_desktop.recording.study_file import StudyFile
from caris_desktop.recording.tables import derived
from caris_desktop.robot.profile_model import ProfileFile
from caris_desktop.scenario.scenario_file import schema_path
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui import shortcut_reference

_PACKAGE = Path(__file__).resolve().parents[1]

_SCENARIO_PAGE_HEAD = """\
<!-- Written by `python -m caris_desktop.app.generated_reference` from
caris_desktop/scenario/scenario_model.py: change it there. -->
# The scenario file

A scenario is a YAML file that configures the console for a study: the layout of the panels, the permissions of the
wizard, the prepared phrases of the robot and the places it can go to. It contains only data; nothing in it is executed.
For examples, see [Writing a scenario](scenarios.md).

The scenarios shipped with the program are in `layouts`. Your own can be anywhere
(`caris-desktop --scenario my-study.yaml`), or in the folder `scenarios` of your configuration folder
(`~/.config/caris-desktop/scenarios` on Linux), where the console lists them. A file there replaces a shipped one with
the same name. `caris-desktop check --scenario my-study.yaml` reports the file, the line and the allowed values for each
mistake.

```yaml
version: 1
title: My study
layout:
  split: horizontal
  weights: [60, 40]
  children:
    - panel: video
    - tabs: [speak, map]
```

Everything else is optional. Editors with YAML schema support complete and check every key if the first line is
`# yaml-language-server: $schema=PATH/scenario.schema.json`; the schema is in `resources/schemas`. When the console
saves a place or a panel layout, your comments, the order of your keys and all other lines stay unchanged.

## The file

"""

_RECORDING_PACKAGES = ("domain", "live", "robot", "ros", "perception", "people", "conversation", "recording", "study")
_LEAST_LETTERS = 4
"""A text with fewer letters besides its values would match any sentence."""


def reference_files() -> dict[Path, str]:
    """Content of each generated file; text between the tables of a guide page is preserved."""
    schemas, guide = resources_dir() / "schemas", resources_dir() / "guide"
    face, profiles, sharing = guide / "face.md", guide / "robot-profiles.md", guide / "sharing.md"
    # Texts that a replay looks up in the record, extracted from the sources: it imports few of the packages that write
    # them.
    sources = (path for name in _RECORDING_PACKAGES for path in sorted((_PACKAGE / name).rglob("*.py")))
    texts = sorted({text for path in sources for text in _marked(path.read_text("utf-8"))})
    # Guide page of all commands and their options, from the argument parsers.
    parts = [_COMMANDS_HEAD, *_section("The console", build_parser())]
    for command in COMMANDS:
        parts += _section(command, parser_of(command))
    return {
        schema_path(): schema_text(Scenario, schema_id="caris-desktop:scenario", title="CARIS Desktop scenario"),
        schemas / "robot-profile.schema.json": schema_text(ProfileFile, title="CARIS Desktop robot profile"),
        schemas / "robot-control.schema.json": schema_text(RobotControl, title="A control of the Robot panel"),
        schemas / "face.schema.json": schema_text(Face, title="CARIS Desktop face"),
        schemas / "annotations.schema.json": schema_text(Coding, title="CARIS Desktop annotations"),
        schemas / "study.schema.json": schema_text(StudyFile, title="CARIS Desktop study"),
        guide / "scenario-file.md": _SCENARIO_PAGE_HEAD + reference(Scenario),
        profiles: with_tables(profiles.read_text("utf-8"), {"profile": ProfileFile, "control": RobotControl}),
        face: with_tables(face.read_text("utf-8"), {"face": Face}),
        sharing: with_tables(sharing.read_text("utf-8"), {"study": StudyFile}),
        TEXTS_PATH: json.dumps(texts, indent=0, ensure_ascii=False) + "\n",
        guide / "commands.md": "\n".join(parts),
        **derived.reference_files(),
        **shortcut_reference.reference_files(),
    }


def _marked(source: str) -> Iterator[str]:
    for call in ast.walk(ast.parse(source)):
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "QT_TR_NOOP":
            text = ast.literal_eval(call.args[0])
            plain = text.replace("%n", "")
            while "{" in plain:
                plain = plain.partition("{")[0] + plain.partition("}")[2]
            if sum(map(str.isalpha, plain)) >= _LEAST_LETTERS:
                yield text


_COMMANDS_HEAD = """<!-- Generated by `python -m caris_desktop.app.generated_reference` from the argument parsers. -->
# Commands

`caris-desktop` without a command opens the console. `--help` after a command prints the same text as this page.
"""


def _section(title: str, parser: argparse.ArgumentParser) -> Iterator[str]:
    # Whether a list that may be empty is "required" depends on the version of Python.
    needed = "".join(f" {_default_text(each)}" for each in parser._actions if each.required or each.nargs == "*")
    yield f"## {title}\n\n{parser.description}\n\n    {parser.prog}{needed}\n"
    yield "| argument or option | meaning |\n| --- | --- |"
    for action in parser._actions:
        if not isinstance(action, argparse._HelpAction):
            meaning = (action.help or "") % {**vars(action), "prog": parser.prog}
            meaning = meaning.replace("|", r"\|")
            yield f"| `{_default_text(action)}` | {meaning} |"
    yield ""


def _default_text(action: argparse.Action) -> str:
    name = action.metavar if isinstance(action.metavar, str) else action.dest.upper()
    if not action.option_strings:
        return f"[{name} ...]" if action.nargs == "*" else name
    if action.nargs == 0:
        return action.option_strings[0]
    value = " or ".join(map(str, action.choices)) if action.choices else name
    return f"{action.option_strings[0]} {value}".replace("|", " or ")


def main() -> None:
    """Write all generated files."""
    for path, text in reference_files().items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
