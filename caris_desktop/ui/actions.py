"""The one table of actions and keys, and what binds it to the window.

A row carries the intent that it asks the console for. Only what is purely of the window names a callback. A permission
that a scenario switches off removes the action: no button, no menu entry, no shortcut.
"""

import logging
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from PySide6.QtCore import QObject, Qt, Signal
from PySide6.QtGui import QAction, QKeySequence, QShortcut
from PySide6.QtWidgets import QAbstractButton, QAbstractItemView, QApplication, QComboBox, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.intents import Intent, Permission
from caris_desktop.live.state import LiveState
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.model import Permissions, Scenario
from caris_desktop.ui.key_positions import modifier_name
from caris_desktop.ui.speed_steps import fraction_after

logger = logging.getLogger(__name__)

Kind = Literal["command", "hold", "safety", "mark"]
Condition = Literal["always", "recording", "video", "photo", "cameras", "answer", "asked"]
Feature = Literal["sideways", "head"]
IntentNow = Callable[[Scenario, LiveState, Any], Intent | None]
"""What is asked for where that depends on the scenario, on what is so now and on the row's argument; None: nothing."""

PHRASE_COUNT = 8
LABEL_COUNT = 8
PLACE_COUNT = 9
CODE_COUNT = 9


@dataclass(frozen=True, slots=True)
class ActionSpec:
    """One row. ``keys`` work anywhere in the window, ``driving_keys`` also while Drive, Video or Map has the focus.

    ``kind`` says who listens for the keys: ``command`` is a shortcut, ``hold`` belongs to hold-to-drive and
    ``safety`` to the application event filter that also works over dialogs. ``mark`` keys are a shortcut too, whose
    press and release the window hears of, also while Alt is down to drive. ``intent`` is what the console is asked
    for, or a function that finds it from ``argument``. A row without one is of the window alone: ``callback`` names the
    method that is called, with ``argument`` if there is one. ``by_position``: letters and digits among the keys mean
    the places of those keys on a US keyboard, whatever the present layout types there; hold-to-drive listens for them.
    ``needs`` is what the robot must have. ``within`` names the part of the window that listens for the keys itself
    while it has the focus; empty for keys that work anywhere.
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
    within: Literal["", "timeline"] = ""

    @property
    def runs(self) -> bool:
        """Whether it does something by itself; what is held drives, and that is another matter."""
        return self.intent is not None or bool(self.callback)


def say_phrase(scenario: Scenario, _state: LiveState, number: int) -> Intent:
    return intents.Say(scenario.phrases[number - 1], "phrase")


def say_filler(scenario: Scenario, _state: LiveState, _argument: None) -> Intent:
    return intents.Say(scenario.filler, "filler")


def change_speed(_scenario: Scenario, state: LiveState, direction: int) -> Intent:
    """One of the three steps up (1) or down (-1)."""
    return intents.SetSpeed(fraction_after(state.drive.value.speed_fraction, direction))


def go_to_nth_place(_scenario: Scenario, state: LiveState, number: int) -> Intent | None:
    places = state.places.value
    return intents.GoToPlace(places[number - 1].name) if number <= len(places) else None


def answer_suggestion(_scenario: Scenario, state: LiveState, yes: bool) -> Intent | None:
    """Yes or no to the one question about a person that is asked now; nothing while that has only just come up."""
    asked = state.asked_person.value
    if asked is None or state.present.now_ns() < asked.from_ns:
        return None
    answer = intents.ConfirmPerson if yes else intents.RejectPerson
    return answer(asked.person_id, asked.is_person_id)


def _held(action_id: str, text: str, icon: str, letter: str, arrow: str = "", **more: Any) -> ActionSpec:
    bare = tuple(key for key in (letter, arrow) if key)
    return ActionSpec(
        action_id, text, icon, tuple(f"Alt+{key}" for key in bare), bare, "driving", "hold", by_position=True, **more
    )


ACTIONS: tuple[ActionSpec, ...] = (
    ActionSpec("stop", "Stop the robot", "hand-palm", ("Esc",), kind="safety", intent=intents.Stop(), group="Safety"),
    ActionSpec(
        "emergency_stop", "Emergency stop", "warning-octagon", ("Esc, Esc", "Pause"), kind="safety",
        intent=intents.EmergencyStop(), group="Safety",
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
        "slower", "Slower", "minus", ("Alt+Q",), ("Q",), "driving", intent=change_speed, argument=-1,
        group="Driving", by_position=True,
    ),
    ActionSpec(
        "faster", "Faster", "plus", ("Alt+E",), ("E",), "driving", intent=change_speed, argument=1,
        group="Driving", by_position=True,
    ),
    _held("look_up", "Look up", "caret-up", "I", group="Head (hold)", needs="head"),
    _held("look_down", "Look down", "caret-down", "K", group="Head (hold)", needs="head"),
    _held("look_left", "Look left", "caret-left", "J", group="Head (hold)", needs="head"),
    _held("look_right", "Look right", "caret-right", "L", group="Head (hold)", needs="head"),
    ActionSpec(
        "look_ahead", "Look ahead", "crosshair-simple", ("Alt+O",), ("O",), "driving",
        intent=intents.LookAt(0.0, 0.0), group="Head (hold)", by_position=True, needs="head",
    ),
    ActionSpec(
        "nod", "Nod", "arrows-down-up", ("Alt+N",), ("N",), "driving",
        intent=intents.Nod(), group="Head (hold)", by_position=True, needs="head",
    ),
    *(
        ActionSpec(
            f"place_{number}", f"Go to place {number}", "flag", (f"Alt+{number}",), (str(number),), "driving",
            intent=go_to_nth_place, argument=number, group="Places", by_position=True,
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
            f"phrase_{number}", f"Say phrase {number}", "chat-text", (f"F{number}",), intent=say_phrase,
            argument=number, group="Speaking",
        )
        for number in range(1, PHRASE_COUNT + 1)
    ),
    ActionSpec("filler", "Say the filler", "dots-three", ("F9",), intent=say_filler, group="Speaking"),
    ActionSpec("silence", "Silence", "speaker-slash", ("F12",), intent=intents.Silence(), group="Speaking"),
    ActionSpec(
        "person_yes", "Yes, that is who it is", "check", ("Ctrl+Return",), ("Y",), "naming_people",
        enabled_when="asked", intent=answer_suggestion, argument=True, group="People",
    ),
    ActionSpec(
        "person_no", "No, it is somebody else", "x", ("Ctrl+Shift+Return",), ("Shift+Y",), "naming_people",
        enabled_when="asked", intent=answer_suggestion, argument=False, group="People",
    ),
    ActionSpec(
        "photo", "Photo", "camera", ("Ctrl+P",), ("P",), "photos", enabled_when="photo",
        intent=intents.TakePhoto(), group="Session",
    ),
    ActionSpec(
        "mark", "Mark", "bookmark-simple", ("Ctrl+M",), ("M",), kind="mark", enabled_when="recording",
        callback="mark_moment", group="Marks",
    ),
    *(
        ActionSpec(
            f"label_{number}", f"Mark with label {number}", "bookmark-simple", (f"Shift+F{number}",), kind="mark",
            enabled_when="recording", callback="mark_label", argument=number, group="Marks",
        )
        for number in range(1, LABEL_COUNT + 1)
    ),
    ActionSpec(
        "stretch", "Start or end a stretch", "brackets-square", ("Ctrl+R",), kind="mark", enabled_when="recording",
        callback="toggle_stretch", group="Marks",
    ),
    ActionSpec(
        "mark_earlier", "That mark was 3 s earlier", "rewind", ("Ctrl+J",), kind="mark", enabled_when="recording",
        callback="mark_earlier", group="Marks",
    ),
    ActionSpec(
        "mark_undo", "Take the last mark back", "arrow-u-up-left", ("Ctrl+Shift+J",), kind="mark",
        enabled_when="recording", callback="withdraw_mark", group="Marks",
    ),
    ActionSpec(
        "note", "Write a note", "note-pencil", ("Ctrl+N",), kind="mark", enabled_when="recording",
        callback="write_note", group="Marks",
    ),
    ActionSpec(
        "wizard_error", "Wizard error", "warning", ("Ctrl+Shift+M",), ("Shift+M",), kind="mark",
        enabled_when="recording", callback="mark_wizard_error", group="Marks",
    ),
    ActionSpec(
        "next_camera", "Show the next camera", "video-camera", ("Ctrl+Shift+V",), ("V",), enabled_when="cameras",
        callback="show_next_camera", group="Window",
    ),
    ActionSpec(
        "find", "Find anything", "magnifying-glass", ("Ctrl+K",), ("/",), callback="show_command_palette",
        group="Window",
    ),
    ActionSpec(
        "shortcuts", "All shortcuts", "keyboard", ("Ctrl+/",), ("?",), callback="show_shortcuts", group="Window",
    ),
)  # fmt: skip

REPLAY_ACTIONS: tuple[ActionSpec, ...] = (
    ActionSpec("replay_play", "Play or pause", "play", ("Space",), callback="toggle_playing", group="Replay"),
    ActionSpec("frame_back", "One frame back", "caret-left", (",",), callback="step", argument=-1, group="Replay"),
    ActionSpec("frame_on", "One frame on", "caret-right", (".",), callback="step", argument=1, group="Replay"),
    ActionSpec(
        "previous_mark", "To the previous mark", "skip-back", ("Ctrl+Left",), callback="jump", argument=("mark", -1),
        group="Replay",
    ),
    ActionSpec(
        "next_mark", "To the next mark", "skip-forward", ("Ctrl+Right",), callback="jump", argument=("mark", 1),
        group="Replay",
    ),
    ActionSpec(
        "previous_utterance", "To the previous utterance", "chat-text", ("Ctrl+Shift+Left",), callback="jump",
        argument=("utterance", -1), group="Replay",
    ),
    ActionSpec(
        "next_utterance", "To the next utterance", "chat-text", ("Ctrl+Shift+Right",), callback="jump",
        argument=("utterance", 1), group="Replay",
    ),
    ActionSpec("replay_slower", "Play slower", "minus", ("<",), callback="change_rate", argument=-1, group="Replay"),
    ActionSpec("replay_faster", "Play faster", "plus", (">",), callback="change_rate", argument=1, group="Replay"),
)  # fmt: skip
"""What a replay brings along. Keys without Ctrl or Alt never take anything from a text field."""


def _on_timeline(action_id: str, text: str, icon: str, *keys: str, **more: Any) -> ActionSpec:
    return ActionSpec(action_id, text, icon, keys, group="Timeline", within="timeline", **more)


TIMELINE_ACTIONS: tuple[ActionSpec, ...] = (
    ActionSpec("focus_timeline", "Into the timeline", "rows", ("Ctrl+T",), callback="focus_timeline", group="Timeline"),
    ActionSpec("undo", "Undo", "arrow-u-up-left", ("Ctrl+Z",), callback="undo", group="Timeline"),
    ActionSpec("redo", "Redo", "arrow-u-up-right", ("Ctrl+Shift+Z", "Ctrl+Y"), callback="redo", group="Timeline"),
    *(
        _on_timeline(
            f"code_{number}", f"Start or end label {number}", "tag", str(number), callback="code", argument=number
        )
        for number in range(1, CODE_COUNT + 1)
    ),
    _on_timeline("annotation_new", "New annotation at the playhead", "plus", "N", callback="add_at_playhead"),
    _on_timeline("annotation_split", "Split at the playhead", "scissors", "S", callback="split_at_playhead"),
    _on_timeline("annotation_rename", "Rename", "pencil-simple", "Return", callback="rename_selected"),
    _on_timeline("annotation_remove", "Remove", "trash", "Del", "Backspace", callback="remove_selected"),
    _on_timeline("annotation_begin", "Begin at the playhead", "arrow-line-left", "B", callback="begin_at_playhead"),
    _on_timeline("annotation_end", "End at the playhead", "arrow-line-right", "E", callback="end_at_playhead"),
    _on_timeline(
        "annotation_earlier", "Move a little earlier", "arrow-left", "Shift+Left", callback="nudge", argument=-1
    ),
    _on_timeline("annotation_later", "Move a little later", "arrow-right", "Shift+Right", callback="nudge", argument=1),
    _on_timeline(
        "annotation_previous", "Previous annotation", "caret-double-left", "PgUp", callback="select_next", argument=-1
    ),
    _on_timeline(
        "annotation_next", "Next annotation", "caret-double-right", "PgDown", callback="select_next", argument=1
    ),
    _on_timeline("second_back", "One second back", "caret-left", "Left", callback="seek_by", argument=-1.0),
    _on_timeline("second_on", "One second on", "caret-right", "Right", callback="seek_by", argument=1.0),
    _on_timeline("tier_above", "Tier above", "caret-up", "Up", callback="select_tier", argument=-1),
    _on_timeline("tier_below", "Tier below", "caret-down", "Down", callback="select_tier", argument=1),
    _on_timeline("timeline_larger", "Zoom in", "magnifying-glass-plus", "+", "=", callback="zoom", argument=1),
    _on_timeline("timeline_smaller", "Zoom out", "magnifying-glass-minus", "-", callback="zoom", argument=-1),
    _on_timeline("timeline_fit", "Show the whole session", "arrows-out-line-horizontal", "F", callback="fit"),
)  # fmt: skip


def permitted(specs: Iterable[ActionSpec], permissions: Permissions) -> tuple[ActionSpec, ...]:
    return tuple(spec for spec in specs if spec.permission is None or getattr(permissions, spec.permission))


def actions_for(scenario: Scenario) -> tuple[ActionSpec, ...]:
    """The rows that exist in this scenario, with its phrases as texts."""
    rows = []
    for spec in permitted(ACTIONS, scenario.permissions):
        if spec.intent is say_phrase:
            if spec.argument > len(scenario.phrases):
                continue
            spec = _with_text(spec, scenario.phrases[spec.argument - 1])  # noqa: PLW2901
        elif spec.callback == "mark_label":
            if spec.argument > len(scenario.recording.labels):
                continue
            spec = _with_text(spec, f"Mark: {scenario.recording.labels[spec.argument - 1]}")  # noqa: PLW2901
        elif spec.id == "filler":
            if not scenario.filler:
                continue
            spec = _with_text(spec, scenario.filler)  # noqa: PLW2901
        rows.append(spec)
    return tuple(rows)


def _with_text(spec: ActionSpec, text: str) -> ActionSpec:
    return replace(spec, text=text)


def conflicts(specs: Iterable[ActionSpec]) -> list[tuple[str, tuple[str, ...]]]:
    """Keys that more than one action would answer to while a driving panel has the focus (where all keys of the window
    work), or the part of the window that some rows belong to.
    """
    owners: dict[str, list[str]] = {}
    elsewhere: dict[str, list[str]] = {}
    for spec in specs:
        for key in {normalized(key) for key in (*spec.keys, *spec.driving_keys)}:
            if not spec.within:
                owners.setdefault(key, []).append(spec.id)
            if spec.within or key in {normalized(key) for key in spec.keys}:
                elsewhere.setdefault(key, []).append(spec.id)
    for key, ids in elsewhere.items():
        owners[key] = list(dict.fromkeys((*owners.get(key, ()), *ids))) if len(ids) > 1 else owners.get(key, ids)
    return sorted((key, tuple(ids)) for key, ids in owners.items() if len(ids) > 1)


def normalized(key: str) -> str:
    """One spelling for a key sequence. Raises ValueError for one that Qt does not know."""
    sequence = QKeySequence(key, QKeySequence.SequenceFormat.PortableText)
    text = sequence.toString(QKeySequence.SequenceFormat.PortableText)
    if not text:
        raise ValueError(f"no such key: {key!r}")
    return text


def _types_something(key: str) -> bool:
    return not normalized(key).startswith(("Ctrl+", "Alt+", "Meta+", "Shift+", "F")) or normalized(key) in "<>"


_CAP_TEXTS = {"Return": "Enter", "Shift": "⇧", "Up": "↑", "Down": "↓", "Left": "←", "Right": "→", "Del": "Delete"}


def cap_text(key: str, letters: Mapping[str, str] | None = None, *, platform: str = sys.platform) -> str:
    """What is printed on the key cap: ``Ctrl+Shift+M`` reads ``⇧Ctrl M``.

    ``letters`` gives what the present layout types at a position.
    """
    words = []
    for chord in key.split(", "):
        # The plus key itself is written "+" and "Ctrl++".
        parts = [part for part in chord.split("+") if part] + (["+"] if chord.endswith("+") else [])
        shift = "⇧" if "Shift" in parts else ""
        named = [
            _CAP_TEXTS.get(part, (letters or {}).get(part, modifier_name(platform, part)))
            for part in parts
            if part != "Shift"
        ]
        words.append(shift + " ".join(named))
    return " ".join(words)


class Actions(QObject):
    """The table as it stands: runs actions, binds shortcuts, and knows which key works now.

    ``handlers`` has the callbacks of every row that nobody else brings along or answers for.
    """

    asking = Signal(object)  # Intent; it is about to be asked for
    rebuilt = Signal()
    rows_changed = Signal()  # robot or places have other rows now
    keys_changed = Signal()
    availability_changed = Signal()

    def __init__(self, window: QWidget, console: WizardConsole, handlers: object) -> None:
        super().__init__(window)
        self._window = window
        self._console = console
        self._handlers = handlers
        self._answering: dict[str, object] = {}
        self._specs: dict[str, ActionSpec] = {}
        self._shortcuts: list[QAction] = []
        self._panel_shortcuts: list[QShortcut] = []
        self._conditions: dict[Condition, bool] = {"always": True}
        self._features: frozenset[Feature] = frozenset()
        self._places: tuple[str, ...] = ()
        self._letters: dict[str, str] = {}
        self._driving_focus = False
        self._brought: dict[str, tuple[ActionSpec, object]] = {}
        self._groups: frozenset[str] | None = None
        self._bare: list[QAction] = []

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
        if spec.intent is go_to_nth_place:
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
        self._bare.clear()
        self._specs = {
            spec.id: spec for spec in actions_for(scenario) if self._groups is None or spec.group in self._groups
        }
        self._specs |= {action_id: spec for action_id, (spec, _) in self._brought.items()}
        for key, ids in conflicts(self._specs.values()):
            logger.error("the key %s is bound more than once: %s", key, ", ".join(ids))
        for spec in self._specs.values():
            self._bind(spec)
        self.rebuilt.emit()

    def keep_only(self, groups: Iterable[str]) -> None:
        """From the next ``rebuild`` on only rows of these groups are there, besides those that were brought along."""
        self._groups = frozenset(groups)

    def answer_for(self, group: str, handlers: object) -> None:
        """Rows of this group call methods of ``handlers``."""
        self._answering[group] = handlers

    def add_rows(self, specs: Iterable[ActionSpec], handlers: object) -> None:
        """Rows that a part of the window brings along, whatever the scenario; ``handlers`` has their callbacks."""
        app = QApplication.instance()
        if not self._brought and isinstance(app, QApplication):
            app.focusChanged.connect(self._on_focus_changed)
        for spec in specs:
            self._brought[spec.id] = (spec, handlers)
            self._specs[spec.id] = spec
            self._bind(spec)
        for key, ids in conflicts(self._specs.values()):
            logger.error("the key %s is bound more than once: %s", key, ", ".join(ids))
        self.rows_changed.emit()

    def _bind(self, spec: ActionSpec) -> None:
        if spec.kind != "command" or spec.by_position or not spec.keys or spec.within:
            return
        action = QAction(spec.text, self)
        action.setShortcuts([QKeySequence(key) for key in spec.keys])
        action.setAutoRepeat(False)
        action.triggered.connect(self._runner(spec.id))
        self._window.addAction(action)
        self._shortcuts.append(action)
        if any(_types_something(key) for key in spec.keys):
            self._bare.append(action)

    def _on_focus_changed(self, _old: QWidget | None, new: QWidget | None) -> None:
        """A key that types something belongs to what has the focus, where that knows what to do with it."""
        for action in self._bare:
            presses = isinstance(new, QAbstractButton) and QKeySequence(Qt.Key.Key_Space) in action.shortcuts()
            action.setEnabled(not presses and not isinstance(new, (QComboBox, QAbstractItemView)))

    def bind_driving_panels(self, panels: Sequence[QWidget]) -> None:
        """Let the bare keys work inside these widgets."""
        for shortcut in self._panel_shortcuts:
            shortcut.deleteLater()
        self._panel_shortcuts.clear()
        for panel in panels:
            for spec in self._specs.values():
                if spec.kind not in ("command", "mark") or spec.by_position:
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
        if spec is None or not self.available(action_id):
            return
        intent = self.intent_of(spec)
        if intent is not None:
            self.asking.emit(intent)
            self._console.do(intent)
        elif spec.callback:
            self._call(spec)

    def intent_of(self, spec: ActionSpec) -> Intent | None:
        """What the row would ask the console for now."""
        if spec.intent is None or isinstance(spec.intent, Intent):
            return spec.intent
        return spec.intent(self._console.scenario, self._console.state, spec.argument)

    def _call(self, spec: ActionSpec) -> None:
        if spec.id in self._brought:
            handlers = self._brought[spec.id][1]
        else:
            handlers = self._answering.get(spec.group, self._handlers)
        handler = getattr(handlers, spec.callback)
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
