"""Failures that are reported to the wizard."""

from collections.abc import Iterator
from contextlib import contextmanager

from caris_desktop.domain.events import Severity


class UserFacingError(Exception):
    """Failure as the wizard needs it: what happened, what it means for the session, what to do."""

    usual_severity: Severity = "error"

    def __init__(self, what: str, meaning: str, advice: str, *, severity: Severity | None = None) -> None:
        super().__init__(f"{what} {meaning} {advice}")
        self.what = what
        self.meaning = meaning
        self.advice = advice
        self.severity: Severity = severity or self.usual_severity


class RefusedError(UserFacingError):
    """Refused command, a warning: the user can change what it needs."""

    usual_severity = "warning"


@contextmanager
def reported(errors: type[Exception] | tuple[type[Exception], ...], what: str, advice: str) -> Iterator[None]:
    """Raise UserFacingError instead of these errors, whose own text says what the failure means."""
    try:
        yield
    except errors as error:
        raise UserFacingError(what, str(error), advice) from error
