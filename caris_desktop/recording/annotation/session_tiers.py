"""Tiers made from the record of a session: what was said, driven, marked and seen, and every other kind of event."""

from collections.abc import Callable

from caris_desktop.recording.annotation.model import AnnotationDocument
from caris_desktop.recording.session_reader import Session


def session_tiers(session: Session, progress: Callable[[float], None] | None = None) -> AnnotationDocument:
    """The record as tiers that nobody edits (``coder`` is empty). Raises SessionError."""
    raise NotImplementedError
