"""What a row of the table of actions says."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal, Self, TypeVar

from caris_desktop.domain.events import AssistedFunction
from caris_desktop.domain.intents import INTENTS, Intent, Permission
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import dataclass
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.model import PanelName, Scenario

Kind = Literal["command", "hold", "safety", "mark", "talk"]
Condition = Literal[
    "always", "recording", "video", "photo", "cameras", "answer", "asked", "suggested", "queued", "in_queue",
    "step", "step_ahead", "step_back", "step_branches", "step_says", "step_goes",
]  # fmt: skip
Feature = Literal["sideways", "head"]
IntentNow = Callable[[Scenario, LiveState, Any], Intent | None]
"""What is asked for where that depends on the scenario, on what is so now and on the row's argument; None: nothing."""
_Find = TypeVar("_Find", bound=IntentNow)
_given: dict[Any, tuple[type[Intent], ...]] = {}


def gives(*kinds: type[Intent]) -> Callable[[_Find], _Find]:
    """Declares which intents a function of a row gives; what the row needs follows from their lines of the table."""

    def declare(find: _Find) -> _Find:
        _given[find] = kinds
        return find

    return declare


@dataclass(frozen=True, slots=True)
class ActionSpec:
    """One row. ``keys`` work anywhere in the window, ``driving_keys`` also while Drive, Video or Map has the focus.

    ``kind`` says who listens for the keys: ``command`` is a shortcut, ``hold`` belongs to hold-to-drive and
    ``safety`` to the application event filter that also works over dialogs. ``mark`` keys are a shortcut too, whose
    press and release the window hears of, also while Alt is down to drive, and ``talk`` keys are held to speak.
    ``intent`` is what the console is asked for, or a function that finds it from ``argument``, which says what it gives
    (:func:`gives`). A row without one is
    of the window alone: ``callback`` names the method that is called, with ``argument`` if there is one.
    ``by_position``: letters and digits among the keys mean the places of those keys on a US keyboard, whatever the
    present layout types there; hold-to-drive listens for them.
    ``permission`` is what it needs beside what its intents need, by their lines of the table. ``panel``: what it does
    happens in that panel. ``needs`` is what the robot must have. ``within`` names the part of the window that listens
    for the keys itself while it has the focus; empty for keys that work anywhere. ``own_key``: its key is the
    scenario's, and gives way where it is that of another row. ``assists``: what it answers is done or suggested by one
    of these, where the scenario has that. ``text`` and ``group`` stand here as ``tr`` looks them up; {number} in the
    text is ``argument``.
    """

    id: str
    text: str
    icon: str = ""
    keys: tuple[str, ...] = ()
    driving_keys: tuple[str, ...] = ()
    permission: Permission | None = None
    kind: Kind = "command"
    enabled_when: Condition = "always"
    intent: Intent | IntentNow | None = None
    callback: str = ""
    argument: Any = None
    group: str = ""
    by_position: bool = False
    needs: Feature | None = None
    within: Literal["", "timeline", "queue"] = ""
    panel: PanelName | None = None
    own_key: bool = False
    assists: tuple[AssistedFunction, ...] = ()

    @property
    def kinds(self) -> tuple[type[Intent], ...]:
        """What it may ask the console for; empty for a row that is of the window alone."""
        if self.intent is None:
            return ()
        return (type(self.intent),) if isinstance(self.intent, Intent) else _given[self.intent]

    @property
    def permissions(self) -> tuple[Permission, ...]:
        """All that the scenario must allow: what the row says, and what each of its intents needs, whichever it is."""
        named = () if self.permission is None else (self.permission,)
        needed = [INTENTS[kind].permissions for kind in self.kinds]
        shared = tuple(each for each in needed[0] if all(each in one for one in needed)) if needed else ()
        return tuple(dict.fromkeys((*named, *shared)))

    @property
    def runs(self) -> bool:
        """Whether it does something by itself; what is held drives, and that is another matter."""
        return self.intent is not None or bool(self.callback)

    def in_words(self) -> Self:
        """The row with its text in the wizard's language; the group, by which rows are found, stays as it is."""
        text = tr(self.text).replace("{number}", str(self.argument))
        return self if text == self.text else replace(self, text=text)
