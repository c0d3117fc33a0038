"""Rehearsal as of ``caris-desktop rehearse``, in which the wizard names a person, types and says the name.

``python -m tests.app.naming_rehearsal NAME SCENARIO --out DIR``
"""

import sys

from caris_desktop.app import rehearse_command
from caris_desktop.app.command_table import run
from caris_desktop.domain import intents
from caris_desktop.people.presence import PersonRow


class NamingRehearsal(rehearse_command.Rehearsal):
    """Rehearsal with a name: in People, in a sentence, in a question and in a note."""

    name = ""

    def _meet(self) -> rehearse_command.Script:
        yield from super()._meet()
        person = next(row.person_id for row in self._state.persons.value if row.here)
        self._console.do(intents.NamePerson(person, self.name))
        yield rehearse_command.Until("they are named", lambda: any(row.name == self.name for row in self._everybody()))
        person = next(row.person_id for row in self._everybody() if row.name == self.name)
        self._console.do(intents.NotePerson(person, f"{self.name} came by bicycle."))

    def _everybody(self) -> tuple[PersonRow, ...]:
        everybody: tuple[PersonRow, ...] = self._state.everybody.value
        return everybody

    def _greet(self) -> rehearse_command.Script:
        yield from super()._greet()
        yield from self._say_by_typing(f"Nice to meet you, {self.name}.")
        speech = self._state.speech
        yield rehearse_command.Until("the name is spoken", lambda: speech.value.now is not None)
        yield rehearse_command.Until("the name was said", lambda: speech.value.now is None, 30.0)


if __name__ == "__main__":
    NamingRehearsal.name = sys.argv[1]
    rehearse_command.Rehearsal = NamingRehearsal  # type: ignore[misc]
    sys.exit(run(["rehearse", *sys.argv[2:]]))
