"""``python -m caris_desktop.app.reference`` writes what follows from the declarations of files.

Those are their JSON Schemas and the tables of the guide. A test tells when they are to be written anew.
"""

from pathlib import Path

from caris_desktop.recording.annotation import coding_file
from caris_desktop.robot import reference as robot
from caris_desktop.scenario import reference as scenario


def reference_files() -> dict[Path, str]:
    """What each file that follows from a declaration says."""
    return {**scenario.reference_files(), **robot.reference_files(), **coding_file.reference_files()}


def main() -> None:
    """Write them all."""
    for path, text in reference_files().items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
