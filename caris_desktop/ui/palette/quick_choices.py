"""Quick choices: a key that lists options, and the digit that selects one."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from caris_desktop.domain.translation import tr
from caris_desktop.people.presence import PersonRow
from caris_desktop.ui import text_formatting
from caris_desktop.ui.action_rows import PEOPLE_GROUP, PLACES_GROUP, SCENARIO_GROUP
from caris_desktop.ui.app_context import AppContext
from caris_desktop.ui.palette.command_palette import CommandPalette
from caris_desktop.ui.palette.palette_entries import PaletteEntries
from caris_desktop.ui.palette.palette_item import PaletteItem


class QuickChoices:
    """Commands of the action table to choose places, scenarios and wizards, and to name a person."""

    def __init__(self, parts: AppContext, entries: PaletteEntries, palette: CommandPalette) -> None:
        self._parts = parts
        self._entries = entries
        self._palette = palette
        self._awaits_scenarios = False
        parts.scenarios.changed.connect(self._on_scenarios_read)
        for group in (PLACES_GROUP, SCENARIO_GROUP, PEOPLE_GROUP):
            parts.actions.answer_for(group, self)

    def choose_place(self) -> None:
        self._palette.choose_from(
            tr("Where should the robot go? Press a digit, or type."), self._with_digits(self._entries.of_places())
        )

    def choose_scenario(self) -> None:
        entries = self._entries.of_scenarios()
        self._awaits_scenarios = not entries
        self._palette.choose_from(tr("Which scenario? Press a digit, or type."), self._with_digits(entries))

    def _on_scenarios_read(self) -> None:
        if self._awaits_scenarios and self._palette.isVisible():
            self.choose_scenario()
        self._awaits_scenarios = False

    def choose_wizard(self) -> None:
        """Choose a known wizard or enter a new name."""
        wizards = self._parts.wizards

        def chosen(name: str, text: str) -> PaletteItem:
            return PaletteItem(text, tr("Wizard"), "user-gear", lambda: wizards.choose(name), id=f"Wizard: {name}")

        known = [chosen(name, name) for name in wizards.names if name != wizards.current]
        self._palette.ask(
            tr("Your name or initials"), known, lambda typed: chosen(typed, tr("New wizard: {name}").format(name=typed))
        )

    def name_person(self) -> str:
        """Edit the name of the person in front of the robot; Enter saves it."""
        state, panels = self._parts.console.state, self._parts.panels
        person = nearest_person(state.persons.value, selected=state.selected_person.value)
        if person is None:
            return tr("Nobody is in view, so nobody can be named.")
        panels.open("people")
        panel = panels.panels.get("people")
        if panel is not None:
            panel.show_person(person.person_id, rename=True)
        return ""

    def _with_digits(self, entries: Sequence[PaletteItem]) -> Sequence[PaletteItem]:
        letter = self._parts.actions.letter
        return [
            replace(entry, key=letter(str(number)) if number <= CommandPalette.DIGITS else "")
            for number, entry in enumerate(entries, start=1)
        ]


def nearest_person(persons: Iterable[PersonRow], *, selected: str = "") -> PersonRow | None:
    """Nearest person in front of the robot.

    The selected person if present; else the nearest unnamed person, else the nearest.

    Without distances: the one most straight ahead, then the one present longest.
    """
    here = [person for person in persons if person.here]
    chosen = next((person for person in here if person.person_id == selected), None)
    return chosen or min(here, key=_how_far, default=None)


def _how_far(person: PersonRow) -> tuple[bool, float, float, int]:
    aside = math.inf if person.bearing_rad is None else abs(math.remainder(person.bearing_rad, math.tau))
    distance_m = math.inf if person.distance_m is None else person.distance_m
    return text_formatting.has_given_name(person), distance_m, aside, person.since_ns
