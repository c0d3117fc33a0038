"""Versions and migrations of scenario files."""

from collections.abc import Mapping
from typing import Any

from caris_desktop.domain.file_migrations import Migration, migrated
from caris_desktop.domain.translation import tr
from caris_desktop.scenario.scenario_model import SCENARIO_VERSION


def _number_the_version(data: dict[str, Any]) -> dict[str, Any]:
    """Version 0 is a file without a version; nothing else differs."""
    return data


MIGRATIONS: Mapping[int, Migration] = {0: _number_the_version}


def migrate(
    data: dict[str, Any], *, migrations: Mapping[int, Migration] = MIGRATIONS, newest: int = SCENARIO_VERSION
) -> dict[str, Any]:
    """``data`` migrated to the newest version; the argument is unchanged.

    Raises
    ------
    ValueError
        If the version is no whole number, or newer than ``newest``.
    """
    version = data.get("version", 0)
    if isinstance(version, bool) or not isinstance(version, int) or version < 0:
        raise ValueError(
            tr("the version must be a whole number, found {version}. Allowed: {newest}").format(
                version=repr(version), newest=newest
            )
        )
    if version > newest:
        raise ValueError(
            tr(
                "the file has version {version}, this program reads up to version {newest}. Update CARIS Desktop, or "
                "open an older copy of the file."
            ).format(version=version, newest=newest)
        )
    return migrated(data, migrations, version=version, newest=newest)
