"""``python -m caris_desktop.app.reference`` writes what follows from the declarations of files.

Those are their JSON Schemas and the tables of the guide, those of keys from the table of actions, and the texts of the
scenario's form for translators, and those that a replay finds again in the record. A test tells when they are to be
written anew.
"""

from pathlib import Path

from caris_desktop.conversation.face import reference as face
from caris_desktop.domain import reference as domain
from caris_desktop.recording.annotation import coding_file
from caris_desktop.robot import reference as robot
from caris_desktop.scenario import reference as scenario
from caris_desktop.ui.scenario_editor import reference as scenario_editor
from caris_desktop.ui.shortcuts import reference as shortcuts


def reference_files() -> dict[Path, str]:
    """What each file that follows from a declaration says."""
    rooms = (domain, scenario, robot, coding_file, face, shortcuts, scenario_editor)
    return {path: text for room in rooms for path, text in room.reference_files().items()}


def main() -> None:
    """Write them all."""
    for path, text in reference_files().items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
