"""What is done with two keys: one that shows what there is to choose from, and the digit that stands there."""

from collections.abc import Sequence
from dataclasses import replace

from caris_desktop.domain.translation import tr
from caris_desktop.ui.action_rows import PEOPLE_GROUP, PLACES_GROUP, SCENARIO_GROUP
from caris_desktop.ui.palette.command_palette import CommandPalette
from caris_desktop.ui.palette.entries import PaletteEntries
from caris_desktop.ui.palette.entry import Entry
from caris_desktop.ui.people.in_front import in_front
from caris_desktop.ui.window_parts import WindowParts


class QuickChoices:
    """Does what the rows of the table say about places, scenarios, wizards and naming somebody."""

    def __init__(self, parts: WindowParts, entries: PaletteEntries, palette: CommandPalette) -> None:
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
        """Somebody who is known, or a new name."""
        wizards = self._parts.wizards

        def chosen(name: str, text: str) -> Entry:
            return Entry(text, tr("Wizard"), "user-gear", "", lambda: wizards.choose(name), id=f"Wizard: {name}")

        known = [chosen(name, name) for name in wizards.names if name != wizards.current]
        self._palette.ask(
            tr("Your name or initials"), known, lambda typed: chosen(typed, tr("New wizard: {name}").format(name=typed))
        )

    def name_person(self) -> str:
        """Open the field for the name of who is in front of the robot; Enter keeps what is typed."""
        state, panels = self._parts.console.state, self._parts.panels
        person = in_front(state.persons.value, selected=state.selected_person.value)
        if person is None:
            return tr("Nobody is in view, so there is nobody to name.")
        panels.open("people")
        panel = panels.panels.get("people")
        if panel is not None:
            panel.show_person(person.person_id, rename=True)
        return ""

    def _with_digits(self, entries: Sequence[Entry]) -> Sequence[Entry]:
        letter = self._parts.actions.letter
        return [
            replace(entry, key=letter(str(number)) if number <= CommandPalette.DIGITS else "")
            for number, entry in enumerate(entries, start=1)
        ]
