"""Reads annotations from ELAN files."""

from pathlib import Path

from caris_desktop.recording.annotation.model import AnnotationDocument


def read_eaf(path: Path, *, coder: str = "") -> AnnotationDocument:
    """Tiers, vocabularies and annotations of an .eaf. ``coder`` is whose the tiers are that name no annotator.

    Raises AnnotationError, for people.
    """
    raise NotImplementedError
