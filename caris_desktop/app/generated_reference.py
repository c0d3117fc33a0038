"""Generator of derived files: ``python -m caris_desktop.app.generated_reference``.

It writes the JSON Schemas, the guide's tables of file keys, shortcuts, commands and data, the translators' texts of the
scenario form, and the texts that a replay translates. A test fails if one of them is outdated.
"""

from pathlib import Path

from caris_desktop.app import commands_page
from caris_desktop.conversation.face import face_reference as face
from caris_desktop.domain import recorded_text_index as domain
from caris_desktop.recording.annotation import coding_file
from caris_desktop.recording.exporters import tables_page
from caris_desktop.robot import profile_reference as robot
from caris_desktop.scenario import scenario_reference as scenario
from caris_desktop.ui.scenario_editor import schema_texts as scenario_editor
from caris_desktop.ui.shortcuts import shortcut_reference as shortcuts


def reference_files() -> dict[Path, str]:
    """Content of each generated file."""
    rooms = (domain, scenario, robot, coding_file, face, shortcuts, scenario_editor, commands_page, tables_page)
    return {path: text for room in rooms for path, text in room.reference_files().items()}


def main() -> None:
    """Write all generated files."""
    for path, text in reference_files().items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
