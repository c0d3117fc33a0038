"""Definition of a row of the action table: command, intent, key bindings, permissions."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal, Self, TypeVar

from caris_desktop.domain.events import AssistedFunction
from caris_desktop.domain.intents import INTENTS, Intent, Permission
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.state import LiveState
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.scenario.scenario_model import PanelName, Scenario

Kind = Literal["command", "hold", "safety", "mark", "talk"]
IntentNow = Callable[[Scenario, LiveState, Any], Intent | None]
"""Function that computes the intent from the scenario, the live state and the row's argument; None for no intent."""
_Find = TypeVar("_Find", bound=IntentNow)
_given: dict[Any, tuple[type[Intent], ...]] = {}


def gives(*kinds: type[Intent]) -> Callable[[_Find], _Find]:
    """Decorator that declares which intents a row's function returns; the row's permissions follow from the intent
    table.
    """

    def declare(find: _Find) -> _Find:
        _given[find] = kinds
        return find

    return declare


class EnabledWhen(Value):
    """Whether the state allows a command now; ``otherwise`` is the marked text for the wizard while it does not."""

    holds: Callable[[LiveState], bool]
    otherwise: str


ALWAYS = EnabledWhen(lambda _state: True, QT_TR_NOOP("This action is not available now."))


class ActionSpec(Value):
    """One row of the action table. ``keys`` work anywhere in the window, ``driving_keys`` also while Drive, Video or
    Map has the focus.

    ``kind`` says who handles the keys: ``command`` is a shortcut, ``hold`` belongs to hold-to-drive and ``safety`` to
    the application event filter that also works over dialogs. ``mark`` keys are shortcuts whose press and release both
    count, also while Alt is down to drive; ``talk`` keys are held to speak. ``intent`` is what the console receives, or
    a function of ``argument`` that computes it and declares its types (:func:`gives`). A row without an intent concerns
    the window alone: ``callback`` names the method that is called, with ``argument`` if there is one. ``by_position``:
    letters and digits mean key positions on a US keyboard, whatever the layout types there; hold-to-drive handles them.
    ``enabled``: condition on the live state. ``applies``: whether a scenario has the row, besides its permissions.
    ``permission`` is required in addition to the permissions of the intents. ``panel``: the panel that the command
    belongs to. ``needs``: whether a connected robot has what the row requires. ``within`` names the part of the window
    that handles the keys itself while it has the focus; empty for keys that work anywhere. ``own_key``: the key comes
    from the scenario and yields to another row with the same key. ``assists``: assistance levels of the scenario that
    the row depends on.
    ``also``: other words that find it in the palette, which lists ``common`` rows first until there is a history.
    ``text`` and ``group`` are source texts for ``tr``; {number} in the text is ``argument``.
    """

    id: str
    text: str
    icon: str = ""
    keys: tuple[str, ...] = ()
    driving_keys: tuple[str, ...] = ()
    permission: Permission | None = None
    kind: Kind = "command"
    enabled: EnabledWhen = ALWAYS
    intent: Intent | IntentNow | None = None
    callback: str = ""
    argument: Any = None
    group: str = ""
    by_position: bool = False
    needs: Callable[[RobotProfile], bool] | None = None
    within: Literal["", "timeline", "queue"] = ""
    panel: PanelName | None = None
    own_key: bool = False
    assists: tuple[AssistedFunction, ...] = ()
    applies: Callable[[Scenario], bool] = lambda _scenario: True
    also: str = ""
    common: bool = False

    @property
    def kinds(self) -> tuple[type[Intent], ...]:
        """Intents that the row may send to the console; empty for a row that concerns the window alone."""
        if self.intent is None:
            return ()
        return (type(self.intent),) if isinstance(self.intent, Intent) else _given[self.intent]

    @property
    def permissions(self) -> tuple[Permission, ...]:
        """Permissions required of the scenario: the row's own, and those that all its intents share."""
        named = () if self.permission is None else (self.permission,)
        needed = [INTENTS[kind].permissions for kind in self.kinds]
        shared = tuple(each for each in needed[0] if all(each in one for one in needed)) if needed else ()
        return tuple(dict.fromkeys((*named, *shared)))

    @property
    def runs(self) -> bool:
        """Whether the row runs something when triggered; False for held keys, which drive."""
        return self.intent is not None or bool(self.callback)

    def in_words(self) -> Self:
        """The row with its text translated; ``group`` stays untranslated because rows are looked up by it."""
        text = tr(self.text).replace("{number}", str(self.argument))
        return self if text == self.text else replace(self, text=text)
