"""Saved layouts of a wizard: working copies, lock, and adaptation to screen size."""

import json
import logging
from typing import Any

from caris_desktop.domain.intents import SizeClass
from caris_desktop.domain.value_class import dataclass
from caris_desktop.scenario.layout import layout_data
from caris_desktop.scenario.scenario_model import LayoutNode
from caris_desktop.ui.layout.dock_layout import DockLayout, arrangement_data, arrangement_from
from caris_desktop.ui.wizard_profiles import WizardProfiles

_WORKING, _ASIDE, _LOCKED, _ADAPTS = "layout/working", "layout/working_aside", "layout/locked", "layout/adapts"
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class WorkingCopy:
    """A working copy. ``of_another``: made from a layout that the scenario file no longer has."""

    arrangement: DockLayout
    of_another: bool


class LayoutFile:
    """Saved layouts of the current wizard, by scenario file and screen size class."""

    def __init__(self, values: WizardProfiles) -> None:
        self._values = values

    def working(self, scenario: str, kind: SizeClass, file_tree: LayoutNode) -> WorkingCopy | None:
        """The working copy, or None. Raises ValueError if unreadable; it is then set aside."""
        text = str(self._values.value(_WORKING, "{}"))
        everything = _read(text)
        if not isinstance(everything, dict) or not isinstance(everything.get(scenario, {}), dict):
            self._put_aside(scenario, text)
            rest = everything | {scenario: {}} if isinstance(everything, dict) else {}
            self._values.set_value(_WORKING, json.dumps(rest))
            raise ValueError("the saved layouts are not a JSON object")  # noqa: TRY004
        entry = everything.get(scenario, {}).get(kind)
        if entry is None:
            return None
        try:
            if not isinstance(entry, dict):
                raise ValueError("it is not a JSON object")  # noqa: TRY004, TRY301
            return WorkingCopy(arrangement_from(entry.get("arrangement")), entry.get("of") != layout_data(file_tree))
        except (ValueError, RecursionError) as error:
            self._put_aside(scenario, json.dumps({scenario: {kind: entry}}))
            self._write(scenario, kind, None)
            raise ValueError(str(error)) from error

    def save_working_copy(
        self, scenario: str, kind: SizeClass, file_tree: LayoutNode, arrangement: DockLayout | None
    ) -> None:
        """Save a working copy; None if the layout equals the file's."""
        entry = None
        if arrangement is not None:
            entry = {"of": layout_data(file_tree), "arrangement": arrangement_data(arrangement)}
        self._write(scenario, kind, entry)

    def forget(self, scenario: str) -> None:
        self._values.set_value(
            _WORKING, json.dumps({name: each for name, each in self._all().items() if name != scenario})
        )

    @property
    def adapts(self) -> bool:
        """Whether small and large screens get a layout of their own."""
        return str(self._values.value(_ADAPTS, "yes")) != "no"

    def set_adapts(self, adapts: bool) -> None:
        self._values.set_value(_ADAPTS, "yes" if adapts else "no")

    def is_locked(self, scenario: str) -> bool:
        return scenario in self._locked()

    def set_locked(self, scenario: str, locked: bool) -> None:
        names = [name for name in self._locked() if name != scenario]
        self._values.set_value(_LOCKED, json.dumps([*names, scenario] if locked else names))

    def _locked(self) -> list[str]:
        names = _read(self._values.value(_LOCKED, "[]"))
        return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []

    def _of(self, scenario: str) -> dict[str, Any]:
        entries = self._all().get(scenario)
        return entries if isinstance(entries, dict) else {}

    def _write(self, scenario: str, kind: SizeClass, entry: dict[str, Any] | None) -> None:
        known = self._all()
        entries = {name: each for name, each in self._of(scenario).items() if name != kind}
        if entry is not None:
            entries[kind] = entry
        if known.get(scenario, {}) != entries:
            self._values.set_value(_WORKING, json.dumps(known | {scenario: entries}))

    def _all(self) -> dict[str, Any]:
        known = _read(self._values.value(_WORKING, "{}"))
        return known if isinstance(known, dict) else {}

    def _put_aside(self, scenario: str, text: str) -> None:
        """Keep unreadable data under another settings key for inspection."""
        _log.warning("the arrangement that was kept for %s cannot be read, and is put aside", scenario)
        self._values.set_value(_ASIDE, text)


def _read(text: Any) -> Any:
    try:
        return json.loads(str(text))
    except (ValueError, RecursionError):
        return None
