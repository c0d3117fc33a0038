"""Derived documentation of face files: JSON Schema and the tables of the guide page.

``python -m caris_desktop.app.generated_reference`` writes them into ``resources/``.
"""

from pathlib import Path

from caris_desktop.conversation.face.face_file import Face
from caris_desktop.domain.schema_docs import with_tables
from caris_desktop.domain.schema_json import schema_text
from caris_desktop.domain.shipped import resources_dir


def reference_files() -> dict[Path, str]:
    """Content of each derived file; text between the page's tables is preserved."""
    page = resources_dir() / "guide" / "face.md"
    return {
        resources_dir() / "schemas" / "face.schema.json": schema_text(Face, title="CARIS Desktop face"),
        page: with_tables(page.read_text(encoding="utf-8"), {"face": Face}),
    }
