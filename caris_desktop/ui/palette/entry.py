"""What can be found."""

from collections.abc import Callable
from dataclasses import field

from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class Entry:
    """Something that can be found and done; ``also`` are other words for it.

    ``acts``: it speaks or moves the robot, so it is found by its own words only and never by a guess at misspelt ones.
    ``deliberate``: it takes a protection away, so it is never chosen beforehand and wants Enter, or a click, twice;
    ``again`` is what it says between the two. ``first``: it stands before everything else that is found.
    ``named`` is what the thing is called that it acts on: those words alone say nothing of what is to be done, so Enter
    does not choose it by them, unless ``by_name``, as with a place, to which there is only one thing to do.
    ``id`` is by what it is known again when it was used, so it is the same in every language of the window, and tells
    nothing of who a person is. ``common``: it stands among what is often used, until the wizard has shown what that is.
    """

    text: str
    kind: str
    icon: str
    key: str
    do: Callable[[], object]
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
        """The whole line, as a screen reader says it: what it is called, of what kind it is, its key."""
        return ", ".join(part for part in (self.text, self.kind, self.key) if part)
