"""Makes the overview of a session: all that its timeline shows, read once."""

from collections.abc import Callable

from caris_desktop.recording.annotation.overview import SessionOverview
from caris_desktop.recording.session_reader import Session


def build_overview(session: Session, progress: Callable[[float], None] | None = None) -> SessionOverview:
    """Any thread; ``progress`` takes 0..1. What it raises ends the work. Raises SessionError."""
    raise NotImplementedError
