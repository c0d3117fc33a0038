"""Background reading of files for widgets; the result is dropped if the widget was deleted."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import shiboken6
from PySide6.QtCore import QObject, Signal

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.live.wizard_console import WizardConsole

T = TypeVar("T")


def read_for(
    part: QObject,
    console: WizardConsole,
    read: Callable[[], T],
    done: Callable[[T], None],
    failed: Callable[[UserFacingError], None] | None = None,
) -> None:
    """Like :meth:`WizardConsole.run_in_background`, but without callback if ``part`` was deleted meanwhile."""

    def deliver(found: T) -> None:
        if shiboken6.isValid(part):
            done(found)

    def report_failed(failure: UserFacingError) -> None:
        if failed is not None and shiboken6.isValid(part):
            failed(failure)

    console.run_in_background(read, deliver, None if failed is None else report_failed)


class Remembered(QObject):
    """Cached list read from files. Each access returns the cached value and starts a refresh.

    ``changed`` follows if the files have changed.
    """

    changed = Signal()

    def __init__(self, console: WizardConsole, read: Callable[[], Sequence[Any]], parent: QObject) -> None:
        """Start empty; the first access reads the files."""
        super().__init__(parent)
        self._console = console
        self._read = read
        self._known: Sequence[Any] = ()
        self._reading = False

    def now(self) -> Sequence[Any]:
        self.renew()
        return self._known

    def renew(self) -> None:
        """Read again, unless already reading: an unresponsive disk is queried once."""
        if not self._reading:
            self._reading = True
            read_for(self, self._console, self._read, self._on_read, self._on_failed)

    def _on_read(self, found: Sequence[Any]) -> None:
        self._reading = False
        if found != self._known:
            self._known = found
            self.changed.emit()

    def _on_failed(self, _failure: UserFacingError) -> None:
        self._reading = False  # logged; the cached value stays
