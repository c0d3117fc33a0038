"""Settings of this user's windows: version, migrations, and recovery from unreadable files.

Every key belongs to a group: ``appearance/``, ``gamepad/``, ``layout/``, ``scenario/``, ``sound/``, ``window/``,
``replay/``, ``wizards/``.
"""

import json
import logging
import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

from PySide6.QtCore import QByteArray, QObject, QSettings, QStandardPaths, Signal

from caris_desktop.domain.failure import RefusedError, UserFacingError
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.free_names import free_name, free_path
from caris_desktop.domain.intents import SaveLayout, SizeClass
from caris_desktop.domain.translation import QT_TR_NOOP, localized, tr
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.confirmed_files import carry
from caris_desktop.scenario.scenario_file import LAYOUTS, ScenarioError, own_file, own_file_called, save_scenario
from caris_desktop.scenario.scenario_model import (
    LayoutNode,
    Scenario,
    checked_layout,
    layout_data,
    own_layout,
    with_layout,
)
from caris_desktop.ui.window_place import Settings

VERSION = 1
VERSION_KEY = "version"
_log = logging.getLogger(__name__)

_GROUPED = {
    "theme": "appearance/theme",
    "scenario": "scenario/last",
    "microphone": "sound/microphone",
    "wizard_microphone": "sound/wizard_microphone",
    "gamepads": "gamepad/mappings",
    "layouts_before_saving": "layout/before_saving",
}


def _into_groups(settings: QSettings) -> None:
    """Migrate version 0, of the first releases, which had no version and its keys at the top level."""
    for old, new in _GROUPED.items():
        if settings.contains(old):
            value = settings.value(old)
            settings.remove(old)  # first, since it also removes keys below a group of that name
            settings.setValue(new, value)


_MIGRATIONS: tuple[Callable[[QSettings], None], ...] = (_into_groups,)
"""The one at place N makes version N + 1 of version N."""


def own_settings() -> QSettings:
    """Settings shared by console and replay."""
    return QSettings("CARIS", "CARIS Desktop")


def bring_up_to_date(settings: QSettings) -> UserFacingError | None:
    """Migrate ``settings`` to the present version.

    Newer or unreadable ones are copied aside and reset. Returns what the wizard must know, if anything: in English,
    since the settings contain the wizard's language.
    """
    settings.allKeys()  # reads the file
    if settings.status() == QSettings.Status.AccessError:
        _log.warning("the settings in %s cannot be read or written", settings.fileName())
        return UserFacingError(
            QT_TR_NOOP("Your settings cannot be read or saved."),
            QT_TR_NOOP("The window starts with default settings, and your changes are lost when it closes."),
            localized(QT_TR_NOOP("Make sure that {file} is writable."), file=settings.fileName()),
            severity="warning",
        )
    version = _version(settings)
    if settings.status() != QSettings.Status.NoError or version is None:
        return _restart(settings, QT_TR_NOOP("Your settings could not be read."))
    if version > VERSION:
        return _restart(settings, QT_TR_NOOP("Your settings are from a newer version of this program."))
    for number in range(version, VERSION):
        _MIGRATIONS[number](settings)
    if version < VERSION:
        settings.setValue(VERSION_KEY, VERSION)
    for key in ("window/geometry", "replay/geometry"):
        if settings.contains(key) and not isinstance(settings.value(key), QByteArray):
            _log.warning("the setting %s is not what belongs there, and is forgotten", key)
            settings.remove(key)
    return None


def retranslated_failure(failure: UserFacingError) -> UserFacingError:
    """Result of ``bring_up_to_date`` in the language that the window meanwhile uses."""
    return UserFacingError(tr(failure.what), tr(failure.meaning), tr(failure.advice), severity=failure.severity)


def _version(settings: QSettings) -> int | None:
    """Stored version; None if it is no number."""
    try:
        version = int(str(settings.value(VERSION_KEY, 0)))
    except ValueError:
        return None
    return version if version >= 0 else None


def _restart(settings: QSettings, what: str) -> UserFacingError:
    try:
        copy = _copy_aside(settings)
    except OSError as error:
        _log.warning("the settings could not be copied: %s", error)
        return UserFacingError(
            what,
            localized(QT_TR_NOOP("They could not be copied either ({why}) and were left unchanged."), why=error),
            localized(
                QT_TR_NOOP("Free some disk space or move the file {file} elsewhere, then start again."),
                file=settings.fileName(),
            ),
            severity="warning",
        )
    _log.warning("%s They are kept in %s", what, copy)
    settings.clear()
    settings.setValue(VERSION_KEY, VERSION)
    return UserFacingError(
        what,
        QT_TR_NOOP("Theme, keys, panel layout and devices were reset to their defaults. A copy was saved."),
        localized(QT_TR_NOOP("Set what you need again. The copy is {file}."), file=copy),
        severity="warning",
    )


def _copy_aside(settings: QSettings) -> Path:
    """Copy the settings file aside. Raises OSError."""
    source = Path(settings.fileName())
    # On Windows the settings are in the registry.
    folder = Path(QStandardPaths.writableLocation(QStandardPaths.StandardLocation.AppConfigLocation))
    stem, ending = (source.stem, source.suffix) if source.is_file() else ("CARIS Desktop", ".ini")
    folder = source.parent if source.is_file() else folder
    stem = f"{stem} {datetime.now():%Y-%m-%d %H-%M-%S}"
    copy = folder / free_name(stem, ending, lambda name: (folder / name).exists(), number_as=" ({})")
    if source.is_file():
        shutil.copyfile(source, copy)
        return copy
    folder.mkdir(parents=True, exist_ok=True)
    written = QSettings(str(copy), QSettings.Format.IniFormat)
    for key in settings.allKeys():
        written.setValue(key, settings.value(key))
    written.sync()
    if written.status() != QSettings.Status.NoError:
        raise OSError(f"{copy} cannot be written")
    return copy


# Panel layouts saved in scenario files, and their previous versions for a reset.


_KEY = "layout/before_saving"
_KINDS: tuple[SizeClass, ...] = ("usual", "compact", "large")


class OwnLayoutFiles:
    """Implementation of LayoutFiles. ``keep_scenario`` is called with the file that is open from then on.

    Previous layouts are in the user's settings, per scenario file and size class.
    """

    def __init__(self, settings: Settings, keep_scenario: Callable[[Path], None]) -> None:
        self._settings = settings
        self._keep_scenario = keep_scenario

    def save(self, scenario: Scenario, intent: SaveLayout) -> Path:
        changed = with_layout(scenario, intent.size_class, _tree_of(intent))
        return _rewritten(replace(changed, title=intent.title)) if intent.title else _written(changed)

    def note_saved(self, path: Path, intent: SaveLayout, *, replaced: Scenario) -> None:
        if not intent.title:
            kind = intent.size_class
            before = own_layout(self.as_before(replaced), kind)
            entry = {
                "before": None if before is None else layout_data(before),
                "saved": layout_data(_tree_of(intent)),
            }
            self._persist(self._all() | {_name(path, kind): entry})
        self._keep_scenario(path)

    def reset(self, scenario: Scenario, before: Scenario) -> Path:
        for kind in _KINDS:
            scenario = with_layout(scenario, kind, own_layout(before, kind))
        return _written(scenario)

    def note_reset(self, path: Path) -> None:
        names = {_name(path, kind) for kind in _KINDS}
        self._persist({known: layouts for known, layouts in self._all().items() if known not in names})

    def as_before(self, scenario: Scenario) -> Scenario:
        """Scenario with the layouts that this program's saving replaced."""
        for kind in _KINDS:
            known = self._all().get(_name(scenario.path, kind))
            present = own_layout(scenario, kind)
            # A layout that was since edited in the file takes precedence.
            if present is None or not isinstance(known, dict) or known.get("saved") != layout_data(present):
                continue
            try:
                before = known.get("before")
                tree = None if before is None and kind != "usual" else checked_layout(before)
                scenario = with_layout(scenario, kind, tree)
            except ValueError as error:
                _log.warning("the arrangement of %s before it was saved cannot be had back: %s", scenario.path, error)
        return scenario

    def _all(self) -> dict[str, Any]:
        try:
            known = parse_json(str(self._settings.value(_KEY, "{}")))
        except ValueError:
            known = None
        return known if isinstance(known, dict) else {}

    def _persist(self, known: dict[str, Any]) -> None:
        self._settings.setValue(_KEY, json.dumps(known))


def _name(path: Path | None, kind: SizeClass) -> str:
    return str(path) if kind == "usual" else f"{path}#{kind}"


def _tree_of(intent: SaveLayout) -> LayoutNode:
    """Checked layout of the request. Raises UserFacingError."""
    try:
        return checked_layout(parse_json(intent.layout))
    except ValueError as error:
        raise UserFacingError(
            tr("The panel layout was not saved."),
            tr("The layout cannot be read: {why}.").format(why=error),
            tr("Arrange the panels again, or reset them, then save again."),
        ) from error


def _written(scenario: Scenario) -> Path:
    """Write the scenario to the user's own file. Raises UserFacingError."""
    path = own_file(scenario.path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        carry(scenario, save_scenario(scenario, path, only=LAYOUTS))
    except (OSError, ScenarioError) as error:
        raise _not_saved(path, error) from error
    return path


def _rewritten(scenario: Scenario) -> Path:
    """Write the scenario to a new file named by its title, never over an existing one. Raises UserFacingError."""
    path = own_file_called(scenario.title)
    path = free_path(path, path.suffix)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        carry(scenario, save_scenario(scenario, path))
    except (OSError, ScenarioError) as error:
        raise _not_saved(path, error) from error
    return path


def _not_saved(path: Path, error: Exception) -> UserFacingError:
    reason = error.strerror if isinstance(error, OSError) and error.strerror else error
    return UserFacingError(
        tr("The panel layout was not saved."),
        tr("{path} cannot be written ({why}).").format(path=path, why=reason),
        tr(
            "Your panel layout is saved on this computer and is restored with the scenario. To save it in "
            "the file, make this folder writable and save again."
        ),
    )


# Settings of this user in memory, written by a background thread.


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
            raise RefusedError(
                tr("Your settings could not be saved."),
                tr("Changes to the window are lost when it closes. The session is not affected."),
                tr("Make sure that {file} is writable.").format(file=self._file),
            )

    def _on_written(self, _nothing: None) -> None:
        self._failing = False

    def _on_failed(self, failure: UserFacingError) -> None:
        if not self._failing:
            self._failing = True
            self.failed.emit(failure)
