"""Reads annotations from tables: CSV, and the tab-delimited text that ELAN exports."""

from pathlib import Path

from caris_desktop.recording.annotation.model import AnnotationDocument


def read_csv(path: Path, *, coder: str = "") -> AnnotationDocument:
    """Tiers and annotations of a table. ``coder`` is whose the tiers are that name none.

    Raises AnnotationError, which names the line.
    """
    raise NotImplementedError
