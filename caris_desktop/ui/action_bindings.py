"""Runtime of the action table: QActions, shortcuts and availability in the window.

A row carries the intent that it sends to the console. Only commands that concern the window alone name a callback. A
permission that a scenario switches off removes the action: no button, no menu entry, no shortcut.
"""

import logging
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

from PySide6.QtCore import QObject, Qt, Signal
from PySide6.QtGui import QAction, QKeyEvent, QKeySequence, QShortcut
from PySide6.QtWidgets import QAbstractButton, QAbstractItemView, QComboBox, QWidget

from caris_desktop.domain.intents import Intent, Permission
from caris_desktop.domain.translation import tr
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import FaceStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.phrases import LOOK, NOD, Phrase, phrase_groups
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui.action_rows import (
    ACTIONS,
    ALWAYS,
    SPEAKING_GROUP,
    ActionSpec,
    EnabledWhen,
    go_to_nth_place,
    has_head,
    mark_with_label,
    perform_nth_gesture,
    phrases_on_keys,
    say_filler,
    say_keyed_phrase,
    say_phrase,
    show_nth_expression,
)
from caris_desktop.ui.focus_widget import application
from caris_desktop.ui.key_choices import (
    Choices,
    ResolvedBindings,
    conflicts,
    modifier_name,
    normalized,
    settle,
    spellings,
    types_something,
)
from caris_desktop.ui.panel_table import possible_panels

logger = logging.getLogger(__name__)


def offered(specs: Iterable[ActionSpec], scenario: Scenario) -> tuple[ActionSpec, ...]:
    """Rows whose permissions, panel and assistance the scenario provides."""
    panels, assisted = possible_panels(scenario), set(scenario.assisted)
    return tuple(
        spec
        for spec in specs
        if scenario.permissions.withheld(spec.permissions) is None
        and (spec.panel is None or spec.panel in panels)
        and (not spec.assists or not assisted.isdisjoint(spec.assists))
    )


def actions_for(scenario: Scenario) -> tuple[ActionSpec, ...]:
    """Rows of this scenario, with its phrases as texts and the default key bindings."""
    return settle(rows_of(scenario), {}).rows


def rows_of(scenario: Scenario) -> tuple[ActionSpec, ...]:
    """Rows of this scenario, including phrases whose own key conflicts with another row."""
    rows = (_in_scenario(spec.in_words(), scenario) for spec in offered(ACTIONS, scenario))
    keyed = keyed_phrases(scenario) if scenario.permissions.speech else []
    keyed_rows = (_of_keyed_phrase(number, phrase) for number, phrase in enumerate(keyed, start=1))
    return (*(row for row in rows if row is not None), *keyed_rows)


def _in_scenario(spec: ActionSpec, scenario: Scenario) -> ActionSpec | None:
    """The row with its text from the scenario; None where the scenario has nothing for it."""
    if not spec.applies(scenario):
        return None
    if spec.intent is say_phrase:
        groups = phrase_groups(scenario.phrases)
        longest = max((group.phrases for group in groups), key=len, default=())
        first = groups[0].phrases if groups else ()
        return _numbered(spec, [phrase.say for phrase in (*first, *longest[len(first) :])])
    if spec.intent is mark_with_label:
        return _numbered(spec, [tr("Mark: {label}").format(label=label) for label in scenario.recording.labels])
    if spec.intent is perform_nth_gesture:
        return _of_gesture(spec, scenario)
    return replace(spec, text=scenario.filler) if spec.intent is say_filler else spec


def _numbered(spec: ActionSpec, texts: Sequence[str]) -> ActionSpec | None:
    """The row with the text of its number; None if there are fewer texts."""
    return replace(spec, text=texts[spec.argument - 1]) if spec.argument <= len(texts) else None


def _of_gesture(spec: ActionSpec, scenario: Scenario) -> ActionSpec | None:
    """The row with the requirements of its gesture; None where the scenario has or permits no gesture at this index."""
    if spec.argument > len(scenario.gestures):
        return None
    gesture = scenario.gestures[spec.argument - 1]
    moves_head = gesture.does in (NOD, LOOK)
    permission: Permission = "driving" if moves_head else "robot_controls"
    if scenario.permissions.withheld((permission,)) is not None:
        return None
    text = tr("Gesture: {gesture}").format(gesture=gesture.title)
    spec = replace(spec, text=text, permission=permission, needs=has_head if moves_head else None)
    return replace(spec, keys=(gesture.key,), own_key=True) if gesture.key else spec


def keyed_phrases(scenario: Scenario) -> list[Phrase]:
    """Phrases with a key of their own, from all groups."""
    return [phrase for group in phrase_groups(scenario.phrases) for phrase in group.phrases if phrase.key]


def _of_keyed_phrase(number: int, phrase: Phrase) -> ActionSpec:
    return ActionSpec(
        f"keyed_phrase_{number}", phrase.say, "chat-text", (phrase.key,), intent=say_keyed_phrase,
        argument=phrase, group=SPEAKING_GROUP, own_key=True,
    )  # fmt: skip


_CAP_TEXTS = {"Return": "Enter", "Shift": "⇧", "Up": "↑", "Down": "↓", "Left": "←", "Right": "→", "Del": "Delete"}


def cap_text(key: str, letters: Mapping[str, str] | None = None, *, platform: str = sys.platform) -> str:
    """Label of a key binding as printed on the key caps: ``Ctrl+Shift+M`` reads ``⇧Ctrl M``.

    ``letters`` maps key positions to the letters of the current keyboard layout.
    """
    words = []
    for chord in key.split(", "):
        # Qt writes the plus key itself as "+" and "Ctrl++".
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
    """The action table of a window: runs actions, binds shortcuts, and knows which key works now.

    ``handlers`` has the callbacks of all rows that neither ``add_rows`` nor ``answer_for`` assigned to other handlers.
    """

    # Reason why a key's command was refused; whether following keystrokes may belong to what it would have opened.
    not_done = Signal(str, bool)
    asking = Signal(object)  # Intent, about to be sent
    intent_sent = Signal(object)  # Intent, sent to the console and possibly refused
    rebuilt = Signal()
    rebound = Signal()  # same rows, different keys
    rows_changed = Signal()  # robot or places changed the set of rows
    keys_changed = Signal()
    availability_changed = Signal()

    def __init__(self, window: QWidget, console: WizardConsole, handlers: object) -> None:
        super().__init__(window)
        self._window = window
        self._console = console
        self._handlers = handlers
        self._scenario = console.scenario
        self._as_they_are: dict[str, ActionSpec | None] = {}
        # Connected first: every other receiver then reads the updated rows.
        self.rows_changed.connect(self._as_they_are.clear)
        self._expressions: tuple[str, ...] = ()
        self._follow(console.state)
        self._answering: dict[str, object] = {}
        self._standard: list[ActionSpec] = []
        self._choices: Choices = {}
        self.settled = ResolvedBindings()
        self._specs: dict[str, ActionSpec] = {}
        self._driving_panels: tuple[QWidget, ...] = ()
        self._shortcuts: dict[str, QAction] = {}
        self._panel_shortcuts: list[QShortcut] = []
        self._bound: dict[str, ActionSpec] | None = None
        self._conditions: dict[EnabledWhen, bool] = {}
        self._focused_part = ""
        self.letters: dict[str, str] = {}
        """Letters of the current keyboard layout by position, as far as known."""
        self.driving_focus = False
        self._brought: list[ActionSpec] = []
        self._groups: frozenset[str] | None = None
        self._bare: list[QAction] = []

    def _follow(self, state: LiveState) -> None:
        """Follow what the rows, and whether they are available, depend on."""
        for rows_value in (state.phrase_group, state.fillers_spoken, state.robot, state.places, state.controls):
            rows_value.changed.connect(self.rows_changed)
        state.face.changed.connect(self._on_face_changed)
        state.frame.freshness_changed.connect(self._check_conditions)
        for value in (
            state.recording, state.cameras, state.asked_person, state.proposal, state.suggestions, state.speech,
            state.protocol, state.scenario,
        ):  # fmt: skip
            value.changed.connect(self._check_conditions)

    def _on_face_changed(self, face: FaceStatus) -> None:
        if face.expressions != self._expressions:
            self._expressions = face.expressions
            self.rows_changed.emit()

    def _check_conditions(self) -> None:
        now = {condition: condition.holds(self._console.state) for condition in self._conditions}
        if now != self._conditions:
            self._conditions = now
            self.availability_changed.emit()

    @property
    def specs(self) -> tuple[ActionSpec, ...]:
        """Rows available now, for this scenario, robot and places."""
        return tuple(row for action_id in self._specs if (row := self.spec(action_id)) is not None)

    @property
    def all_specs(self) -> tuple[ActionSpec, ...]:
        """Rows of this scenario, for any robot and places."""
        return tuple(self._specs.values())

    def spec(self, action_id: str) -> ActionSpec | None:
        """The row, or None where scenario, robot or places do not have it."""
        if action_id not in self._as_they_are:
            spec = self._specs.get(action_id)
            self._as_they_are[action_id] = None if spec is None else self._as_it_is(spec)
        return self._as_they_are[action_id]

    def _as_it_is(self, spec: ActionSpec) -> ActionSpec | None:
        state = self._console.state
        if spec.needs is not None and (state.robot.value is None or not spec.needs(state.robot.value)):
            return None
        if spec.intent is go_to_nth_place:
            return _numbered(spec, [tr("Go to {place}").format(place=place.name) for place in state.places.value])
        if spec.id == "choose_place":
            return spec if state.places.value else None
        if spec.intent is show_nth_expression:
            names = state.face.value.expressions
            return _numbered(spec, [tr("Face: {expression}").format(expression=name) for name in names])
        if spec.intent is perform_nth_gesture and spec.permission == "robot_controls":
            does = self._scenario.gestures[spec.argument - 1].does
            return spec if any(control.id == does for control in state.controls.value) else None
        if spec.intent is say_phrase:
            phrases = phrases_on_keys(self._scenario, state.phrase_group.value)
            if spec.argument > len(phrases):
                return None
            phrase = phrases[spec.argument - 1]
            keyed = (row for row in self._specs.values() if row.intent is say_keyed_phrase and row.argument == phrase)
            phrase_keys = next((row.keys for row in keyed), ())
            return replace(spec, text=phrase.say, keys=(*spec.keys, *phrase_keys))
        if spec.intent is say_filler:
            return replace(spec, text=self._scenario.next_filler(state.fillers_spoken.value))
        return spec

    def use_letters(self, letters: Mapping[str, str]) -> None:
        """Set the letters that the current keyboard layout types at each position, for the key caps."""
        if letters != self.letters:
            self.letters = dict(letters)
            self.keys_changed.emit()

    def letter(self, position: str) -> str:
        return self.letters.get(position, position)

    def caps(self, spec: ActionSpec, keys: Sequence[str]) -> list[str]:
        """Key cap labels of some keys of a row, for this keyboard."""
        return [cap_text(key, self.letters if spec.by_position else None) for key in keys]

    def rebuild(self, scenario: Scenario) -> None:
        """Load the rows of a scenario and drop the shortcuts of the former one."""
        self._scenario = scenario
        rows = rows_of(scenario)
        self._standard = [spec for spec in rows if self._groups is None or spec.group in self._groups] + self._brought
        self._settle()
        self.rebuilt.emit()

    def use_choices(self, choices: Choices) -> None:
        """Apply the wizard's own key bindings in place of the defaults."""
        self._choices = dict(choices)
        self._settle()
        self.bind_driving_panels(self._driving_panels)
        self.rebound.emit()
        self.rows_changed.emit()
        self.keys_changed.emit()

    def _settle(self) -> None:
        self.settled = settle(self._standard, self._choices)
        self._specs = {spec.id: spec for spec in self.settled.rows}
        self._conditions = {spec.enabled: spec.enabled.holds(self._console.state) for spec in self.settled.rows}
        self._as_they_are.clear()
        for key, ids in conflicts(self._specs.values()):
            logger.error("the key %s is bound more than once: %s", key, ", ".join(ids))
        before, self._shortcuts = self._shortcuts, {}
        self._bare.clear()
        for spec in self._specs.values():
            if spec.kind == "command" and spec.keys and not spec.by_position and not spec.within:
                self._bind(spec, before.pop(spec.id, None))
        for action in before.values():
            self._window.removeAction(action)
            action.deleteLater()

    def standard_row(self, action_id: str) -> ActionSpec:
        """The row with its default key binding, from the table or the scenario."""
        return next(spec for spec in self._standard if spec.id == action_id)

    def pressed_in(self, part: str, event: QKeyEvent) -> ActionSpec | None:
        """Row of a pressed key, among those whose keys this part of the window handles itself."""
        pressed = spellings(event)
        rows = (spec for spec in self._specs.values() if spec.within == part)
        return next((row for row in rows if not pressed.isdisjoint(map(normalized, row.keys))), None)

    def drop_all_but(self, groups: Iterable[str]) -> None:
        """Restrict rows to these groups from the next ``rebuild`` on; rows added by ``add_rows`` remain."""
        self._groups = frozenset(groups)

    def answer_for(self, group: str, handlers: object) -> None:
        """Route callbacks of this group to methods of ``handlers``."""
        self._answering[group] = handlers

    def add_rows(self, specs: Iterable[ActionSpec], handlers: object) -> None:
        """Add rows of a part of the window, independent of the scenario; ``handlers`` has the callbacks of their
        groups.
        """
        if not self._brought:
            application().focusChanged.connect(self._on_focus_changed)
        rows = [spec.in_words() for spec in specs]
        self._brought += rows
        self._standard += rows
        self._answering |= {spec.group: handlers for spec in rows}
        self._settle()
        self.rows_changed.emit()

    def _bind(self, spec: ActionSpec, action: QAction | None) -> None:
        """Set the row's shortcuts. QActions are reused: recreating all of them causes a visible stall on a scenario
        change.
        """
        if action is None:
            action = QAction(self)
            action.setAutoRepeat(False)
            action.triggered.connect(self._runner(spec.id))
            self._window.addAction(action)
        keys = [QKeySequence(key) for key in spec.keys]
        if action.text() != spec.text:
            action.setText(spec.text)
        if action.shortcuts() != keys:
            action.setShortcuts(keys)
        self._shortcuts[spec.id] = action
        if any(types_something(key) for key in spec.keys):
            self._bare.append(action)

    def _on_focus_changed(self, _old: QWidget | None, new: QWidget | None) -> None:
        """Disable bare-key actions while the focused widget handles those keys itself."""
        for action in self._bare:
            presses = isinstance(new, QAbstractButton) and QKeySequence(Qt.Key.Key_Space) in action.shortcuts()
            action.setEnabled(not presses and not isinstance(new, (QComboBox, QAbstractItemView)))

    def bind_driving_panels(self, panels: Sequence[QWidget]) -> None:
        """Bind the bare keys within these widgets."""
        if tuple(panels) == self._driving_panels and self._bound is self._specs:
            return
        self._driving_panels, self._bound = tuple(panels), self._specs
        for shortcut in self._panel_shortcuts:
            shortcut.setKey(QKeySequence())  # effective now, not only once the object is deleted
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
                    shortcut.activated.connect(self._runner(spec.id, opens=False))
                    self._panel_shortcuts.append(shortcut)

    def _runner(self, action_id: str, *, opens: bool | None = None) -> Callable[[], None]:
        return lambda: self.press(action_id, opens=opens)

    def press(self, action_id: str, *, opens: bool | None = None) -> None:
        """Run the action for a key, button or palette item and report a refusal. ``opens``: following keystrokes may
        belong to what the action would have opened; by default true if its key is a chord, false for a single key.
        """
        if reason := self.run(action_id):
            spec = self._specs.get(action_id)
            chord = spec is not None and any("+" in key for key in spec.keys)
            self.not_done.emit(reason, chord if opens is None else opens)

    def run(self, action_id: str) -> str:
        """Run the action if the scenario has it and it is available; returns the reason if it was not run."""
        spec = self.spec(action_id)
        if spec is None:
            return tr(ALWAYS.otherwise)
        if not self.available(action_id):
            return tr(spec.enabled.otherwise)
        intent = self.intent_of(spec)
        if intent is not None:
            self.ask(intent)
            return ""
        return self._call(spec) if spec.callback else tr(spec.enabled.otherwise)

    def on_key(self, keys: QKeySequence, *, bare: bool) -> str | None:
        """Id of the command bound to these keys; ``bare``: keys that work in the driving panels."""
        rows = (spec for spec in self._specs.values() if spec.kind == "command" and not spec.within)
        return next(
            (
                spec.id
                for spec in rows
                if keys in [QKeySequence(key) for key in (spec.driving_keys if bare else spec.keys)]
            ),
            None,
        )

    def absent(self, event_key: QKeySequence) -> str:
        """Message about a key that is in the table but not in this scenario; empty otherwise."""
        if self._groups is not None:
            return ""
        rows = (row for row in ACTIONS if row.kind in ("command", "mark", "talk") and row.id not in self._specs)
        row = next((row for row in rows if event_key in [QKeySequence(key) for key in row.keys]), None)
        return "" if row is None else tr("“{act}” is not available in this scenario.").format(act=row.in_words().text)

    def ask(self, intent: Intent) -> None:
        """Send the intent to the console, with the signals of a row."""
        self.asking.emit(intent)
        self._console.do(intent)
        self.intent_sent.emit(intent)

    def intent_of(self, spec: ActionSpec) -> Intent | None:
        """Intent that the row would send now."""
        if spec.intent is None or isinstance(spec.intent, Intent):
            return spec.intent
        scenario = self._console.scenario
        if scenario != self._console.state.scenario.value:
            # During a scenario change the window still shows the former scenario, so the intent would not match what is
            # read there.
            return None
        intent = spec.intent(scenario, self._console.state, spec.argument)
        if intent is not None and type(intent) not in spec.kinds:
            raise TypeError(f"the row {spec.id} gives {type(intent).__name__}, which it does not say")
        return intent

    def _call(self, spec: ActionSpec) -> str:
        """Call the handler; returns the reason if it refused."""
        handler = getattr(self._answering.get(spec.group, self._handlers), spec.callback)
        refusal = handler() if spec.argument is None else handler(spec.argument)
        return refusal if isinstance(refusal, str) else ""

    def available(self, action_id: str) -> bool:
        spec = self.spec(action_id)
        if spec is None or (spec.within == "queue" and self._focused_part != "queue"):
            return False
        return spec.enabled.holds(self._console.state)

    def set_focused_part(self, part: str) -> None:
        """Set the part of the window that has the focus and handles the keys of its rows itself; empty for none."""
        if part != self._focused_part:
            self._focused_part = part
            self.availability_changed.emit()

    def set_driving_focus(self, driving_focus: bool) -> None:
        """Set whether Drive, Video or Map has the focus, so that the bare keys work."""
        if driving_focus != self.driving_focus:
            self.driving_focus = driving_focus
            self.keys_changed.emit()

    def key_text(self, action_id: str) -> str:
        """Key cap of the binding that works now; empty if none."""
        spec = self.spec(action_id)
        if spec is None:
            return ""
        return self._key_text(spec, driving=self.driving_focus)

    def key_texts(self, action_id: str) -> tuple[str, ...]:
        """Key caps of the binding while typing and while driving."""
        spec = self.spec(action_id)
        return () if spec is None else (self._key_text(spec, driving=False), self._key_text(spec, driving=True))

    def _key_text(self, spec: ActionSpec, *, driving: bool) -> str:
        own = [key for key in spec.driving_keys if spec.by_position or not self._moves(key)] if driving else []
        keys = own or spec.keys
        return " · ".join(self.caps(spec, keys if spec.intent is say_phrase else keys[:1]))

    def _moves(self, key: str) -> bool:
        """Whether the current layout types this letter at the position of a drive key, which comes first."""
        letter, rows = key.removeprefix("Shift+"), (row for row in self.specs if row.by_position)
        return any(self.letters.get(position, "") == letter for row in rows for position in row.driving_keys)
