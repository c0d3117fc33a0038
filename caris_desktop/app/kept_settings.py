"""This user's settings while the window stands: read at once, written by a thread of their own."""

import threading
from typing import Any

from PySide6.QtCore import QObject, QSettings, Signal

from caris_desktop.domain.failure import ToldFailure
from caris_desktop.domain.translation import tr
from caris_desktop.live.slow_work import SlowWork


class KeptSettings(QObject):
    """What QSettings has, all of it in memory, without ever waiting for the disk. GUI thread.

    QSettings by itself writes in the GUI thread, and waits until the disk has it. What another window of this user has
    written meanwhile stays: only what was set here is written.
    """

    failed = Signal(object)  # ToldFailure: something could not be written; told once until it works again

    def __init__(self, settings: QSettings, parent: QObject | None = None) -> None:
        super().__init__(parent)
        settings.sync()
        self._file, self._format = settings.fileName(), settings.format()
        self._values = {key: settings.value(key) for key in settings.allKeys()}
        self._work = SlowWork(self)
        self._changed = threading.Lock()
        self._unwritten: dict[str, Any] = {}
        self._failing = False

    @property
    def file(self) -> str:
        """Where they are: a file, or a place in the system's registry."""
        return self._file

    def value(self, key: str, defaultValue: Any = None) -> Any:  # noqa: N803 - as QSettings has it
        return self._values.get(key, defaultValue)

    def setValue(self, key: str, value: Any) -> None:  # noqa: N802 - as QSettings has it
        if key in self._values and self._values[key] == value:
            return
        self._values[key] = value
        with self._changed:
            waiting = bool(self._unwritten)
            self._unwritten[key] = value
        if not waiting:
            self._work.do(self._write, self._on_written, self._on_failed)

    def finish(self) -> None:
        """Write what is left; nothing is kept any more. Blocks, half a minute at most."""
        self._work.finish(lambda _what, work: work())

    def _write(self) -> None:  # any thread
        with self._changed:
            unwritten, self._unwritten = self._unwritten, {}
        settings = QSettings(self._file, self._format)
        for key, value in unwritten.items():
            settings.setValue(key, value)
        settings.sync()
        if settings.status() != QSettings.Status.NoError:
            raise ToldFailure(
                tr("Your settings could not be kept."),
                tr("What you change in the window is forgotten when it closes. The session is not affected."),
                tr("See to it that {file} can be written to.").format(file=self._file),
                severity="warning",
            )

    def _on_written(self, _nothing: None) -> None:
        self._failing = False

    def _on_failed(self, failure: ToldFailure) -> None:
        if not self._failing:
            self._failing = True
            self.failed.emit(failure)
