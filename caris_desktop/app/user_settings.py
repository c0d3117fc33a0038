"""Settings of this user's windows: version, migrations, and recovery from unreadable files.

Every key belongs to a group: ``appearance/``, ``gamepad/``, ``layout/``, ``scenario/``, ``sound/``, ``window/``,
``replay/``, ``wizards/``.
"""

import logging
import shutil
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

from PySide6.QtCore import QByteArray, QSettings, QStandardPaths

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.translation import QT_TR_NOOP, localized, tr

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
_TYPES: dict[str, type] = {"window/geometry": QByteArray, "replay/geometry": QByteArray}


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
    wrong = [
        key for key, kind in _TYPES.items() if settings.contains(key) and not isinstance(settings.value(key), kind)
    ]
    for key in wrong:
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
    copy = _unused(folder / f"{stem} {datetime.now():%Y-%m-%d %H-%M-%S}{ending}")
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


def _unused(path: Path) -> Path:
    number = 2
    free = path
    while free.exists():
        free = path.with_name(f"{path.stem} ({number}){path.suffix}")
        number += 1
    return free
