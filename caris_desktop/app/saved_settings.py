"""Settings of this user in memory, written by a background thread."""

import threading
from typing import Any

from PySide6.QtCore import QObject, QSettings, Signal

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.translation import tr
from caris_desktop.live.background_worker import BackgroundWorker


class SavedSettings(QObject):
    """QSettings interface that never waits for the disk. GUI thread.

    QSettings itself writes in the GUI thread and waits for the disk. Only keys set here are written, so that changes by
    the user's other windows remain.
    """

    failed = Signal(object)  # UserFacingError: a write failed; emitted once until writing works again

    def __init__(self, settings: QSettings, parent: QObject | None = None) -> None:
        super().__init__(parent)
        settings.sync()
        self._file, self._format = settings.fileName(), settings.format()
        self._values = {key: settings.value(key) for key in settings.allKeys()}
        self._work = BackgroundWorker(self)
        self._changed = threading.Lock()
        self._unwritten: dict[str, Any] = {}
        self._failing = False

    @property
    def file(self) -> str:
        """Location: a file, or a key of the system's registry."""
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
        """Write what is left; later changes are not stored. Blocks for at most half a minute."""
        self._work.finish(lambda _what, work: work())

    def _write(self) -> None:  # any thread
        with self._changed:
            unwritten, self._unwritten = self._unwritten, {}
        settings = QSettings(self._file, self._format)
        for key, value in unwritten.items():
            settings.setValue(key, value)
        settings.sync()
        if settings.status() != QSettings.Status.NoError:
            raise UserFacingError(
                tr("Your settings could not be saved."),
                tr("Changes to the window are lost when it closes. The session is not affected."),
                tr("Make sure that {file} is writable.").format(file=self._file),
                severity="warning",
            )

    def _on_written(self, _nothing: None) -> None:
        self._failing = False

    def _on_failed(self, failure: UserFacingError) -> None:
        if not self._failing:
            self._failing = True
            self.failed.emit(failure)
