"""Derived documentation of robot profiles: JSON Schemas and the tables of the guide page.

``python -m caris_desktop.app.generated_reference`` writes them into ``resources/``.
"""

from pathlib import Path

from caris_desktop.domain.control_definitions import RobotControl
from caris_desktop.domain.schema_docs import with_tables
from caris_desktop.domain.schema_json import schema_text
from caris_desktop.domain.shipped import resources_dir
from caris_desktop.robot.profile_model import ProfileFile


def reference_files() -> dict[Path, str]:
    """Content of each derived file; text between the page's tables is preserved."""
    schemas, page = resources_dir() / "schemas", resources_dir() / "guide" / "robot-profiles.md"
    return {
        schemas / "robot-profile.schema.json": schema_text(ProfileFile, title="CARIS Desktop robot profile"),
        schemas / "robot-control.schema.json": schema_text(RobotControl, title="A control of the Robot panel"),
        page: with_tables(page.read_text(encoding="utf-8"), {"profile": ProfileFile, "control": RobotControl}),
    }
