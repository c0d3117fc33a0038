"""The one table of actions and keys, and what binds it to the window.

A permission that a scenario switches off removes the action: no button, no menu entry, no shortcut.
"""

import logging
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from PySide6.QtCore import QObject, Qt, Signal
from PySide6.QtGui import QAction, QKeySequence, QShortcut
from PySide6.QtWidgets import QWidget

from caris_desktop.scenario.model import Permissions, Scenario
from caris_desktop.ui.key_positions import modifier_name

logger = logging.getLogger(__name__)

Permission = Literal["photos", "video_recording", "driving", "assistant", "naming_people"]
Kind = Literal["command", "hold", "safety"]
Condition = Literal["always", "recording", "video", "answer"]
Feature = Literal["sideways", "head"]

PHRASE_COUNT = 8
PLACE_COUNT = 9


@dataclass(frozen=True, slots=True)
class ActionSpec:
    """One row. ``keys`` work anywhere in the window, ``driving_keys`` also while Drive, Video or Map has the focus.

    ``kind`` says who listens for the keys: ``command`` is a shortcut, ``hold`` belongs to hold-to-drive and
    ``safety`` to the application event filter that also works over dialogs. ``callback`` names the handler
    that a command calls, with ``argument`` if there is one. ``by_position``: letters and digits among the keys mean the
    places of those keys on a US keyboard, whatever the present layout types there; hold-to-drive listens for them.
    ``needs`` is what the robot must have.
    """

    id: str
    text: str
    icon: str = ""
    keys: tuple[str, ...] = ()
    driving_keys: tuple[str, ...] = ()
    permission: Permission | None = None
    kind: Kind = "command"
    enabled_when: Condition = "always"
    callback: str = ""
    argument: Any = None
    group: str = ""
    by_position: bool = False
    needs: Feature | None = None


def _held(action_id: str, text: str, icon: str, letter: str, arrow: str = "", **more: Any) -> ActionSpec:
    bare = tuple(key for key in (letter, arrow) if key)
    return ActionSpec(
        action_id, text, icon, tuple(f"Alt+{key}" for key in bare), bare, "driving", "hold", by_position=True, **more
    )


ACTIONS: tuple[ActionSpec, ...] = (
    ActionSpec("stop", "Stop the robot", "hand-palm", ("Esc",), kind="safety", callback="stop", group="Safety"),
    ActionSpec(
        "emergency_stop", "Emergency stop", "warning-octagon", ("Esc, Esc", "Pause"), kind="safety",
        callback="emergency_stop", group="Safety",
    ),
    _held("drive_forward", "Drive forward", "arrow-up", "W", "Up", group="Driving (hold)"),
    _held("drive_back", "Drive backward", "arrow-down", "S", "Down", group="Driving (hold)"),
    _held("turn_left", "Turn left", "arrow-left", "A", "Left", group="Driving (hold)"),
    _held("turn_right", "Turn right", "arrow-right", "D", "Right", group="Driving (hold)"),
    _held(
        "strafe_left", "Move sideways to the left", "arrow-line-left", "Z", group="Driving (hold)", needs="sideways"
    ),
    _held(
        "strafe_right", "Move sideways to the right", "arrow-line-right", "C", group="Driving (hold)", needs="sideways"
    ),
    ActionSpec(
        "slower", "Slower", "minus", ("Alt+Q",), ("Q",), "driving", callback="change_speed", argument=-1,
        group="Driving", by_position=True,
    ),
    ActionSpec(
        "faster", "Faster", "plus", ("Alt+E",), ("E",), "driving", callback="change_speed", argument=1,
        group="Driving", by_position=True,
    ),
    _held("look_up", "Look up", "caret-up", "I", group="Head (hold)", needs="head"),
    _held("look_down", "Look down", "caret-down", "K", group="Head (hold)", needs="head"),
    _held("look_left", "Look left", "caret-left", "J", group="Head (hold)", needs="head"),
    _held("look_right", "Look right", "caret-right", "L", group="Head (hold)", needs="head"),
    ActionSpec(
        "look_ahead", "Look ahead", "crosshair-simple", ("Alt+O",), ("O",), "driving", callback="look_ahead",
        group="Head (hold)", by_position=True, needs="head",
    ),
    *(
        ActionSpec(
            f"place_{number}", f"Go to place {number}", "flag", (f"Alt+{number}",), (str(number),), "driving",
            callback="go_to_nth_place", argument=number, group="Places", by_position=True,
        )
        for number in range(1, PLACE_COUNT + 1)
    ),
    ActionSpec(
        "focus_driving", "Back to driving", "game-controller", ("Ctrl+D",), (), "driving", callback="focus_driving",
        group="Driving",
    ),
    ActionSpec(
        "focus_speak", "Into the Speak field", "text-aa", ("Ctrl+L",), ("Return",), callback="focus_speak",
        group="Speaking",
    ),
    *(
        ActionSpec(
            f"phrase_{number}", f"Say phrase {number}", "chat-text", (f"F{number}",), callback="say_phrase",
            argument=number, group="Speaking",
        )
        for number in range(1, PHRASE_COUNT + 1)
    ),
    ActionSpec("filler", "Say the filler", "dots-three", ("F9",), callback="say_filler", group="Speaking"),
    ActionSpec("silence", "Silence", "speaker-slash", ("F12",), callback="silence", group="Speaking"),
    ActionSpec(
        "photo", "Photo", "camera", ("Ctrl+P",), ("P",), "photos", enabled_when="video", callback="take_photo",
        group="Session",
    ),
    ActionSpec(
        "mark", "Mark", "bookmark-simple", ("Ctrl+M",), ("M",), enabled_when="recording", callback="mark_moment",
        group="Session",
    ),
    ActionSpec(
        "wizard_error", "Wizard error", "warning", ("Ctrl+Shift+M",), ("Shift+M",), enabled_when="recording",
        callback="mark_wizard_error", group="Session",
    ),
    ActionSpec(
        "find", "Find anything", "magnifying-glass", ("Ctrl+K",), ("/",), callback="show_command_palette",
        group="Window",
    ),
    ActionSpec(
        "shortcuts", "All shortcuts", "keyboard", ("Ctrl+/",), ("?",), callback="show_shortcuts", group="Window",
    ),
)  # fmt: skip


def permitted(specs: Iterable[ActionSpec], permissions: Permissions) -> tuple[ActionSpec, ...]:
    return tuple(spec for spec in specs if spec.permission is None or getattr(permissions, spec.permission))


def actions_for(scenario: Scenario) -> tuple[ActionSpec, ...]:
    """The rows that exist in this scenario, with its phrases as texts."""
    rows = []
    for spec in permitted(ACTIONS, scenario.permissions):
        if spec.callback == "say_phrase":
            if spec.argument > len(scenario.phrases):
                continue
            spec = _with_text(spec, scenario.phrases[spec.argument - 1])  # noqa: PLW2901
        elif spec.id == "filler":
            if not scenario.filler:
                continue
            spec = _with_text(spec, scenario.filler)  # noqa: PLW2901
        rows.append(spec)
    return tuple(rows)


def _with_text(spec: ActionSpec, text: str) -> ActionSpec:
    return replace(spec, text=text)


def conflicts(specs: Iterable[ActionSpec]) -> list[tuple[str, tuple[str, ...]]]:
    """Keys that more than one action would answer to while a driving panel has the focus (where all keys work)."""
    owners: dict[str, list[str]] = {}
    for spec in specs:
        for key in {normalized(key) for key in (*spec.keys, *spec.driving_keys)}:
            owners.setdefault(key, []).append(spec.id)
    return sorted((key, tuple(ids)) for key, ids in owners.items() if len(ids) > 1)


def normalized(key: str) -> str:
    """One spelling for a key sequence. Raises ValueError for one that Qt does not know."""
    sequence = QKeySequence(key, QKeySequence.SequenceFormat.PortableText)
    text = sequence.toString(QKeySequence.SequenceFormat.PortableText)
    if not text:
        raise ValueError(f"no such key: {key!r}")
    return text


_CAP_TEXTS = {"Return": "Enter", "Shift": "⇧", "Up": "↑", "Down": "↓", "Left": "←", "Right": "→"}


def cap_text(key: str, letters: Mapping[str, str] | None = None, *, platform: str = sys.platform) -> str:
    """What is printed on the key cap: ``Ctrl+Shift+M`` reads ``⇧Ctrl M``.

    ``letters`` gives what the present layout types at a position.
    """
    words = []
    for chord in key.split(", "):
        parts = chord.split("+")
        shift = "⇧" if "Shift" in parts else ""
        named = [
            _CAP_TEXTS.get(part, (letters or {}).get(part, modifier_name(platform, part)))
            for part in parts
            if part != "Shift"
        ]
        words.append(shift + " ".join(named))
    return " ".join(words)


class Actions(QObject):
    """The table as it stands: runs actions, binds shortcuts, and knows which key works now."""

    rebuilt = Signal()
    rows_changed = Signal()  # robot or places have other rows now
    keys_changed = Signal()
    availability_changed = Signal()

    def __init__(self, window: QWidget, handlers: object) -> None:
        super().__init__(window)
        self._window = window
        self._handlers = handlers
        self._specs: dict[str, ActionSpec] = {}
        self._shortcuts: list[QAction] = []
        self._panel_shortcuts: list[QShortcut] = []
        self._conditions: dict[Condition, bool] = {"always": True}
        self._features: frozenset[Feature] = frozenset()
        self._places: tuple[str, ...] = ()
        self._letters: dict[str, str] = {}
        self._driving_focus = False

    @property
    def specs(self) -> tuple[ActionSpec, ...]:
        """The rows that there are now, with this scenario, this robot and these places."""
        return tuple(row for spec in self._specs.values() if (row := self._as_it_is(spec)) is not None)

    @property
    def all_specs(self) -> tuple[ActionSpec, ...]:
        """The rows of this scenario, whatever robot and places there are."""
        return tuple(self._specs.values())

    def spec(self, action_id: str) -> ActionSpec | None:
        """The row, or None where scenario, robot or places do not have it."""
        spec = self._specs.get(action_id)
        return None if spec is None else self._as_it_is(spec)

    def _as_it_is(self, spec: ActionSpec) -> ActionSpec | None:
        if spec.needs is not None and spec.needs not in self._features:
            return None
        if spec.callback == "go_to_nth_place":
            if spec.argument > len(self._places):
                return None
            return _with_text(spec, f"Go to {self._places[spec.argument - 1]}")
        return spec

    def use_features(self, features: Iterable[Feature]) -> None:
        """What the connected robot has."""
        self._features = frozenset(features)
        self.rows_changed.emit()

    def use_places(self, names: Sequence[str]) -> None:
        """The places in their order, for the keys 1 to 9."""
        self._places = tuple(names[:PLACE_COUNT])
        self.rows_changed.emit()

    def use_letters(self, letters: Mapping[str, str]) -> None:
        """What the present keyboard layout types at each position, for the key caps."""
        if letters != self._letters:
            self._letters = dict(letters)
            self.keys_changed.emit()

    @property
    def letters(self) -> Mapping[str, str]:
        """What the present layout types at each position, as far as that is known."""
        return self._letters

    def letter(self, position: str) -> str:
        return self._letters.get(position, position)

    def caps(self, spec: ActionSpec, keys: Sequence[str]) -> list[str]:
        """Key caps of some keys of a row, as they read on this keyboard."""
        return [cap_text(key, self._letters if spec.by_position else None) for key in keys]

    def rebuild(self, scenario: Scenario) -> None:
        """Take the scenario's rows; shortcuts of the former ones are gone."""
        for action in self._shortcuts:
            self._window.removeAction(action)
            action.deleteLater()
        self._shortcuts.clear()
        self._specs = {spec.id: spec for spec in actions_for(scenario)}
        for key, ids in conflicts(self._specs.values()):
            logger.error("the key %s is bound more than once: %s", key, ", ".join(ids))
        for spec in self._specs.values():
            if spec.kind != "command" or spec.by_position or not spec.keys:
                continue
            action = QAction(spec.text, self)
            action.setShortcuts([QKeySequence(key) for key in spec.keys])
            action.setAutoRepeat(False)
            action.triggered.connect(self._runner(spec.id))
            self._window.addAction(action)
            self._shortcuts.append(action)
        self.rebuilt.emit()

    def bind_driving_panels(self, panels: Sequence[QWidget]) -> None:
        """Let the bare keys work inside these widgets."""
        for shortcut in self._panel_shortcuts:
            shortcut.deleteLater()
        self._panel_shortcuts.clear()
        for panel in panels:
            for spec in self._specs.values():
                if spec.kind != "command" or spec.by_position:
                    continue
                for key in spec.driving_keys:
                    shortcut = QShortcut(QKeySequence(key), panel)
                    shortcut.setContext(Qt.ShortcutContext.WidgetWithChildrenShortcut)
                    shortcut.setAutoRepeat(False)
                    shortcut.activated.connect(self._runner(spec.id))
                    self._panel_shortcuts.append(shortcut)

    def forget_driving_panels(self) -> None:
        """The panels are about to be deleted, and their shortcuts with them."""
        self._panel_shortcuts.clear()

    def _runner(self, action_id: str) -> Callable[[], None]:
        return lambda: self.run(action_id)

    def run(self, action_id: str) -> None:
        """Do it, if the scenario has it and it is available now."""
        spec = self.spec(action_id)
        if spec is None or not spec.callback or not self.available(action_id):
            return
        handler = getattr(self._handlers, spec.callback)
        if spec.argument is None:
            handler()
        else:
            handler(spec.argument)

    def available(self, action_id: str) -> bool:
        spec = self.spec(action_id)
        return spec is not None and self._conditions.get(spec.enabled_when, False)

    def set_condition(self, condition: Condition, holds: bool) -> None:
        if self._conditions.get(condition, False) != holds:
            self._conditions[condition] = holds
            self.availability_changed.emit()

    @property
    def driving_focus(self) -> bool:
        return self._driving_focus

    def set_driving_focus(self, driving_focus: bool) -> None:
        """Whether Drive, Video or Map has the focus, so that the bare keys work."""
        if driving_focus != self._driving_focus:
            self._driving_focus = driving_focus
            self.keys_changed.emit()

    def key_text(self, action_id: str) -> str:
        """The cap of the binding that works now; empty where there is none."""
        spec = self.spec(action_id)
        if spec is None:
            return ""
        keys = spec.driving_keys if self._driving_focus and spec.driving_keys else spec.keys
        return self.caps(spec, keys[:1])[0] if keys else ""
