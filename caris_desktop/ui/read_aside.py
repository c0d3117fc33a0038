"""What a part of the window wants to know of files: read in another thread, and told as long as that part is there."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import shiboken6
from PySide6.QtCore import QObject, Signal

from caris_desktop.domain.failure import ToldFailure
from caris_desktop.live.wizard_console import WizardConsole

T = TypeVar("T")


def read_for(
    part: QObject,
    console: WizardConsole,
    read: Callable[[], T],
    done: Callable[[T], None],
    failed: Callable[[ToldFailure], None] | None = None,
) -> None:
    """As :meth:`WizardConsole.read_aside`, but nothing is told where ``part`` has gone meanwhile."""

    def tell(found: T) -> None:
        if shiboken6.isValid(part):
            done(found)

    def tell_failed(failure: ToldFailure) -> None:
        if failed is not None and shiboken6.isValid(part):
            failed(failure)

    console.read_aside(read, tell, None if failed is None else tell_failed)


class Remembered(QObject):
    """The list that files gave when they were last read. Whoever asks gets that at once, and has them read anew.

    ``changed`` comes where they say something else by now.
    """

    changed = Signal()

    def __init__(self, console: WizardConsole, read: Callable[[], Sequence[Any]], parent: QObject) -> None:
        """It is empty until they were read once."""
        super().__init__(parent)
        self._console = console
        self._read = read
        self._known: Sequence[Any] = ()
        self._reading = False

    def now(self) -> Sequence[Any]:
        self.renew()
        return self._known

    def renew(self) -> None:
        """Have them read, unless that is under way: a disk that does not answer is asked once."""
        if not self._reading:
            self._reading = True
            read_for(self, self._console, self._read, self._on_read, self._on_failed)

    def _on_read(self, found: Sequence[Any]) -> None:
        self._reading = False
        if found != self._known:
            self._known = found
            self.changed.emit()

    def _on_failed(self, _failure: ToldFailure) -> None:
        self._reading = False  # the log tells; what was known holds
