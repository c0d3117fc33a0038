"""Command palette item."""

from collections.abc import Callable
from dataclasses import field

from caris_desktop.domain.value_class import Value


class PaletteItem(Value):
    """Item that can be found and run; ``also``: synonyms.

    ``acts``: speaks or moves the robot, so only exact words find it, never fuzzy matching. ``deliberate``: disables a
    protection, so it is never preselected and needs Enter or a click twice; ``again`` is the prompt in between.
    ``first``: sorted before all other results. ``named``: name of the object; a query that only contains the name does
    not preselect the item unless ``by_name``, as for a place, which has a single command. ``id``: stable key of the
    usage history, independent of language and without personal data. ``common``: listed as frequently used until there
    is a history.
    """

    text: str
    kind: str
    icon: str
    do: Callable[[], object]
    key: str = ""
    also: str = ""
    acts: bool = False
    deliberate: bool = False
    again: str = ""
    first: bool = False
    common: bool = False
    named: str = ""
    by_name: bool = False
    id: str = field(kw_only=True)

    @property
    def spoken(self) -> str:
        """The line as text for a screen reader: name, kind, key."""
        return ", ".join(part for part in (self.text, self.kind, self.key) if part)
