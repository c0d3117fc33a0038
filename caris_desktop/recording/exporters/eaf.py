"""A session as a project of ELAN: annotations, and beside them the media that they are about."""

from pathlib import Path

from caris_desktop.recording.annotation.model import AnnotationDocument
from caris_desktop.recording.export import ExportContext
from caris_desktop.recording.session_reader import Session


def write_eaf(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Fill the folder ``out`` (it exists and is empty). Raises OSError, SessionError."""
    raise NotImplementedError


def eaf_text(document: AnnotationDocument) -> str:
    """The document as the text of an .eaf file, without media."""
    raise NotImplementedError
