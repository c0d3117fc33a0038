"""What tells people about face files: their JSON Schema and the tables of the guide's page, from the declaration.

``python -m caris_desktop.app.reference`` writes them into ``resources/``.
"""

from pathlib import Path

from caris_desktop.conversation.face.file import Face
from caris_desktop.domain.declared_page import with_tables
from caris_desktop.domain.declared_schema import schema_text
from caris_desktop.domain.shipped import resources_dir


def reference_files() -> dict[Path, str]:
    """What each of these files says; the words between the tables of the page stay as they are."""
    page = resources_dir() / "guide" / "face.md"
    return {
        resources_dir() / "schemas" / "face.schema.json": schema_text(Face, title="CARIS Desktop face"),
        page: with_tables(page.read_text(encoding="utf-8"), {"face": Face}),
    }
