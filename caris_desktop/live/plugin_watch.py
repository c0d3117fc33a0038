"""Watch over a plug-in that a child process calls."""

from caris_desktop.domain import clock
from caris_desktop.domain.plugins import Plugin, PluginCall
from caris_desktop.domain.translation import QT_TR_NOOP, localized


class PluginWatch:
    """The call in progress, from the messages of one child process. ``note`` may be called in its reader thread."""

    def __init__(self) -> None:
        self._called = (PluginCall(), 0)

    def note(self, call: PluginCall) -> None:
        self._called = (call, clock.now_ns())

    @property
    def called(self) -> Plugin | None:
        """Plug-in that has not returned."""
        return self._called[0].plugin

    @property
    def overdue(self) -> bool:
        """Whether it should have returned: its process must be ended."""
        call, since_ns = self._called
        return call.plugin is not None and clock.now_ns() - since_ns >= call.within_s * 1e9

    @property
    def blame(self) -> str:
        """Why the plug-in is to blame for the end of the process, as a clause."""
        if not self.overdue:
            return QT_TR_NOOP("it ended its process")
        seconds = f"{self._called[0].within_s:g}"
        return localized(QT_TR_NOOP("it did not return within {seconds} s"), seconds=seconds)
