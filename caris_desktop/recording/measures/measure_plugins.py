"""Measures of plug-ins of the group ``caris_desktop.measures``: interface, definitions, and values of a session."""

import logging
import math
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import ClassVar, Protocol

from caris_desktop.domain.plugin_process import call_apart
from caris_desktop.domain.plugins import LOAD_WITHIN_S, Plugin, PluginError, installed
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.measures.measure_definitions import MEASURES, Measure
from caris_desktop.recording.pseudonyms import Pseudonyms, pseudonymised
from caris_desktop.recording.session.session_header import SessionError
from caris_desktop.recording.session.session_reader import Session, open_session

_log = logging.getLogger(__name__)
MEASURED_WITHIN_S = 60.0
PLUGIN_TABLE = "plugin_measures"
_COLUMN_NAME = re.compile(r"[a-z][a-z0-9_]{0,62}")
_RESERVED = {"session", "participant", "condition", "trial", "wizard", "purpose", "scenario"}
_MOST_SENTENCE = 300


class SessionMeasure(Protocol):
    """Measure of a session: a class with the attribute ``caris_interface = 1``, called without arguments.

    The name of the entry point is that of the column: lower-case letters, digits and ``_``, with the unit at its end as
    in ``silence_s``. ``caris-desktop statistics`` and the export of study tables compute every installed measure, for
    each session in a process of its own, in its main thread. The process is not the window's, the robot link's or the
    recorder's; several sessions may be measured at a time. :meth:`measure` has a minute.

    ``description`` is a sentence in English on what the number is, ``empty`` one on what it means that there is none,
    empty if there always is one. ``values`` are all numbers that are allowed, empty for any.

    OSError and SessionError mean that this session cannot be measured: the user reads the text, and the next session
    may succeed. A measure that raises anything else, prints, is too slow, ends its process, or returns anything but a
    number of ``values`` or None is switched off for the rest of the run, and the user is told its name; the other
    measures are computed. Log with :mod:`logging`.
    """

    caris_interface: ClassVar[int]
    description: str
    empty: str
    values: Sequence[float]

    def measure(self, session: Session) -> float | None:
        """Value of the session, None if it cannot have one; the same each time.

        ``session`` has pseudonyms in its header, its values and its tables (``rows`` of
        :mod:`caris_desktop.recording.tables.build`). Its folder is only read.
        """
        ...


class PluginMeasure(Value):
    """Plug-in that can be loaded, and the definition of its measure."""

    plugin: Plugin
    definition: Measure


def plugin_measures(warn: Callable[[str], None]) -> tuple[PluginMeasure, ...]:
    """Measures of all installed plug-ins; ``warn`` gets a sentence on each that cannot be used."""
    found = []
    for plugin in installed("measures").values():
        try:
            definition = call_apart(plugin, _define, plugin, within_s=LOAD_WITHIN_S)
            found.append(PluginMeasure(plugin, definition))
        except PluginError as error:
            warn(_switched_off(error))
    return tuple(found)


def plugin_values(
    measures: Iterable[PluginMeasure], folder: Path, pseudonyms: Pseudonyms | None, warn: Callable[[str], None]
) -> dict[str, float]:
    """Values of the session in ``folder`` by name, without those that it does not have."""
    values = {}
    for one in measures:
        try:
            value = call_apart(one.plugin, _measure, folder, pseudonyms, one, within_s=MEASURED_WITHIN_S)
        except PluginError as error:
            warn(_switched_off(error))
            continue
        if isinstance(value, Exception):
            warn(localized(QT_TR_NOOP("{measure}: {why}"), measure=one.plugin.name, why=value))
        elif value is not None:
            values[one.plugin.name] = value
    return values


def _define(make: Callable[[], SessionMeasure], _report: object, plugin: Plugin) -> Measure:
    return checked_definition(plugin, make())


def _measure(
    make: Callable[[], SessionMeasure], _report: object, folder: Path, pseudonyms: Pseudonyms | None, one: PluginMeasure
) -> float | Exception | None:
    try:
        session = open_session(folder)
        value = make().measure(session if pseudonyms is None else pseudonymised(session, pseudonyms))
    except (OSError, SessionError) as error:
        return error
    return checked_value(one.plugin, one.definition, value)


def checked_definition(plugin: Plugin, made: SessionMeasure) -> Measure:
    """Definition of a plug-in's measure. Raises PluginError."""
    taken = _RESERVED | {one.name for one in MEASURES}
    if not _COLUMN_NAME.fullmatch(plugin.name) or plugin.name in taken:
        raise PluginError(plugin, QT_TR_NOOP("its name cannot be that of a column"))
    for text in (made.description, made.empty):
        if not isinstance(text, str) or not text.isprintable() or len(text) > _MOST_SENTENCE:
            raise PluginError(plugin, QT_TR_NOOP("its description is not a sentence"))
    if not made.description.endswith("."):
        raise PluginError(plugin, QT_TR_NOOP("its description is not a sentence"))
    values = tuple(f"{float(value):g}" for value in made.values)
    return Measure(plugin.name, made.description, "", plugin.package, made.empty, values)


def checked_value(plugin: Plugin, definition: Measure, value: object) -> float | None:
    """Value that a plug-in returned, as a number. Raises PluginError."""
    if value is None:
        return None
    try:
        number = float(value)  # type: ignore[arg-type] # numbers of numpy too
    except (TypeError, ValueError):
        number = math.nan
    allowed = not definition.values or f"{number:g}" in definition.values
    if isinstance(value, str) or not math.isfinite(number) or not allowed:
        raise PluginError(plugin, localized(QT_TR_NOOP("it returned {value}"), value=repr(value)[:_MOST_SENTENCE]))
    return number


def _switched_off(error: PluginError) -> str:
    return localized(
        QT_TR_NOOP("The measure {name} ({package}) was switched off: {reason}."),
        name=error.plugin.name,
        package=error.plugin.package,
        reason=error.reason,
    )


def added_columns(names: Sequence[str]) -> str:
    """SQL that adds these measures of plug-ins to the table measures."""
    lines = ["-- Measures of plug-ins."] if names else []
    for name in names:
        lines += [
            f'ALTER TABLE measures ADD COLUMN "{name}" DOUBLE;',
            f'UPDATE measures SET "{name}" = one.value FROM {PLUGIN_TABLE} one',  # noqa: S608 - a checked name
            f"WHERE one.session = measures.session AND one.measure = '{name}';",
        ]
    return "\n".join([*lines, ""])
