"""Palette items for people, and for the pending question about one."""

from functools import partial

from caris_desktop.domain import intents
from caris_desktop.domain.translation import tr
from caris_desktop.people.presence import PersonRow
from caris_desktop.ui import text_formatting
from caris_desktop.ui.app_context import AppContext
from caris_desktop.ui.palette.palette_item import PaletteItem
from caris_desktop.ui.people.pending_identity_question import is_asked
from caris_desktop.ui.people.shown_people import everyone


class PersonEntries:
    def __init__(self, parts: AppContext) -> None:
        self._parts = parts
        self._console = parts.console
        self._state = parts.console.state

    def now(self) -> list[PaletteItem]:
        """Items to select, rename, view and annotate each person; and the pending question."""
        table, state = self._parts.actions, self._state
        persons = everyone(state.persons.value, state.everybody.value, state.present.now_ns())
        entries = []
        asked = next((person for person in persons if is_asked(person, state.asked_person.value)), None)
        if asked is not None and asked.suggestion is not None:
            named = {
                "person": text_formatting.person_name(asked),
                "other": text_formatting.name_in_words(asked.suggestion.name),
            }
            for action_id, text, icon in (
                ("answer_yes", tr("Yes, {person} is {other}").format(**named), "check"),
                ("answer_no", tr("No, {person} is not {other}").format(**named), "x"),
            ):
                entries.append(
                    PaletteItem(
                        text,
                        tr("Person"),
                        icon,
                        table.key_text(action_id),
                        partial(table.run, action_id),
                        also=tr("confirm reject"),
                        acts=True,
                        id=f"row {action_id}",
                    )
                )
        for person in persons:
            name, also = text_formatting.person_name(person), " ".join((tr("person"), person.group, *person.tags))
            # The usage history must not contain names.
            known_as = person.person_id
            entries.append(
                PaletteItem(
                    name,
                    tr("Select"),
                    "user",
                    "",
                    partial(self._select, person),
                    also=also,
                    acts=True,
                    id=f"person {known_as} select",
                )
            )
            if "people" not in self._parts.panels.possible():
                continue
            entries.append(
                PaletteItem(
                    tr("Details of {person}").format(person=name),
                    tr("Person"),
                    "identification-card",
                    "",
                    partial(self._show, person, card=True),
                    acts=True,
                    id=f"person {known_as} card",
                )
            )
            if person.here:
                entries.append(
                    PaletteItem(
                        tr("Rename {person}").format(person=name),
                        tr("Person"),
                        "pencil-simple",
                        "",
                        partial(self._show, person, rename=True),
                        acts=True,
                        id=f"person {known_as} rename",
                    )
                )
        if state.everybody.value or state.persons.value:
            entries.append(
                PaletteItem(
                    tr("Undo the last change to people"),
                    tr("Do"),
                    "arrow-u-up-left",
                    "",
                    partial(self._console.do, intents.UndoPeople()),
                    also=tr("take back name merge"),
                    id="Do: Undo the last change to people",
                )
            )
        return entries

    def _select(self, person: PersonRow) -> None:
        self._console.do(intents.AttendPerson(person.person_id))
        panel = self._parts.panels.panels.get("people")
        if panel is not None:
            panel.show_person(person.person_id)

    def _show(self, person: PersonRow, *, rename: bool = False, card: bool = False) -> None:
        panels = self._parts.panels
        panels.open("people")
        panel = panels.panels.get("people")
        if panel is not None:
            panel.show_person(person.person_id, rename=rename, card=card)
