"""The action table: every command of the window with its key bindings.

A row carries the intent that it sends to the console. Only commands that concern the window alone name a callback.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from operator import attrgetter
from typing import Any, Literal, Self, TypeVar

from caris_desktop.conversation.conversation_transcript import newest_heard, next_speaker
from caris_desktop.domain import intents
from caris_desktop.domain.events import AssistedFunction, Marked
from caris_desktop.domain.intents import INTENTS, Intent, Permission
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.speech_queue import addressee
from caris_desktop.live.state import LiveState
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.scenario.phrases import (
    KEYS_BY_PLACE,
    KEYS_OF_A_GROUP,
    LOOK,
    MOST_GESTURES,
    NOD,
    Phrase,
    phrase_groups,
)
from caris_desktop.scenario.protocol_steps import Branch, ProtocolStep, step_named
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


SPEED_FRACTIONS = (0.3, 0.6, 1.0)
SPEED_NAMES = (QT_TR_NOOP("Slow"), QT_TR_NOOP("Normal"), QT_TR_NOOP("Fast"))


def speed_step(fraction: float) -> int:
    """Index of the step nearest to a speed setting."""
    return min(range(len(SPEED_FRACTIONS)), key=lambda index: abs(SPEED_FRACTIONS[index] - fraction))


def speed_after(fraction: float, direction: int) -> float:
    """The next step up (1) or down (-1); unchanged at the end."""
    return SPEED_FRACTIONS[max(0, min(len(SPEED_FRACTIONS) - 1, speed_step(fraction) + direction))]


PHRASE_COUNT = KEYS_OF_A_GROUP
SUGGESTION_COUNT = 3
LABEL_COUNT = 8
PLACE_COUNT = 9
CODE_COUNT = 9
EXPRESSION_COUNT = 8
STEP_BACK_S = 3.0
QUEUE_GROUP = QT_TR_NOOP("Speech queue")
SAFETY_GROUP = QT_TR_NOOP("Safety")
PLACES_GROUP = QT_TR_NOOP("Places")
SPEAKING_GROUP = QT_TR_NOOP("Speaking")
PEOPLE_GROUP = QT_TR_NOOP("People")
PROTOCOL_GROUP = QT_TR_NOOP("Protocol")
MARKS_GROUP = QT_TR_NOOP("Marks")
SCENARIO_GROUP = QT_TR_NOOP("Scenario")
ALARMS_GROUP = QT_TR_NOOP("Alarms")
WINDOW_GROUP = QT_TR_NOOP("Window")
_DRIVING_HOLD_GROUP = QT_TR_NOOP("Driving (hold)")
_HEAD_HOLD_GROUP = QT_TR_NOOP("Head (hold)")
_TIMELINE_GROUP = QT_TR_NOOP("Timeline")


def phrases_on_keys(scenario: Scenario, group: int) -> tuple[Phrase, ...]:
    """Phrases on F1 to F8 while this phrase group is selected."""
    groups = phrase_groups(scenario.phrases)
    return groups[group % len(groups)].phrases if groups else ()


def say(phrase: Phrase) -> Intent:
    return intents.Say(phrase.say, "phrase", gesture=phrase.gesture, face=phrase.face)


@gives(intents.Say)
def say_phrase(scenario: Scenario, state: LiveState, number: int) -> Intent | None:
    phrases = phrases_on_keys(scenario, state.phrase_group.value)
    return say(phrases[number - 1]) if number <= len(phrases) else None


@gives(intents.Say)
def say_keyed_phrase(_scenario: Scenario, _state: LiveState, phrase: Phrase) -> Intent:
    return say(phrase)


@gives(intents.Say)
def say_filler(scenario: Scenario, state: LiveState, _argument: None) -> Intent | None:
    filler = scenario.next_filler(state.fillers_spoken.value)
    return intents.Say(filler, "filler") if filler else None


@gives(intents.Nod, intents.LookAt, intents.UseControl)
def perform_nth_gesture(scenario: Scenario, state: LiveState, number: int) -> Intent | None:
    """Perform the gesture without speech. LOOK targets the addressee, or straight ahead if there is none."""
    if number > len(scenario.gestures):
        return None
    does = scenario.gestures[number - 1].does
    if does == NOD:
        return intents.Nod()
    if does == LOOK:
        whom = addressee(state)
        bearing_rad = next((row.bearing_rad for row in state.persons.value if row.person_id == whom), None)
        return intents.LookAt(bearing_rad or 0.0, 0.0)
    return intents.UseControl(does, True)


@gives(intents.SetSpeed)
def change_speed(_scenario: Scenario, state: LiveState, direction: int) -> Intent:
    """Change the speed by one of the three steps, up (1) or down (-1)."""
    return intents.SetSpeed(speed_after(state.drive.value.speed_fraction, direction))


@gives(intents.GoToPlace)
def go_to_nth_place(_scenario: Scenario, state: LiveState, number: int) -> Intent | None:
    places = state.places.value
    return intents.GoToPlace(places[number - 1].name) if number <= len(places) else None


@gives(intents.ShowExpression)
def show_nth_expression(_scenario: Scenario, state: LiveState, number: int) -> Intent | None:
    expressions = state.face.value.expressions
    return intents.ShowExpression(expressions[number - 1]) if number <= len(expressions) else None


@gives(intents.ConfirmPerson, intents.RejectPerson, intents.ConfirmProposal, intents.VetoProposal)
def answer_asked(scenario: Scenario, state: LiveState, yes: bool) -> Intent | None:
    """Answer yes or no to the pending question: one about a person first, else the language model's proposed action.
    None while the question is too new to have been read.
    """
    question, proposal, now_ns = state.asked_person.value, state.proposal.value, state.present.now_ns()
    if question is not None and scenario.permissions.naming_people:
        if now_ns < question.from_ns:
            return None
        answer = intents.ConfirmPerson if yes else intents.RejectPerson
        return answer(question.person_id, question.is_person_id)
    if proposal.proposal_id and "actions" in scenario.assisted and not (yes and now_ns < proposal.from_ns):
        return (intents.ConfirmProposal if yes else intents.VetoProposal)(proposal.proposal_id)
    return None


@gives(intents.SaySuggestion)
def say_nth_suggestion(_scenario: Scenario, state: LiveState, rank: int) -> Intent | None:
    """Say the suggested reply at this rank; None while it is too new to have been read."""
    card = next((card for card in state.suggestions.value.cards if card.rank == rank), None)
    if card is None or state.present.now_ns() < card.from_ns:
        return None
    return intents.SaySuggestion(rank, card.suggestion_id)


@gives(intents.CorrectUtterance)
def correct_newest_speaker(_scenario: Scenario, state: LiveState, _argument: None) -> Intent | None:
    """Correct the speaker of the newest heard turn to the next candidate."""
    turn = newest_heard(state.transcript.value)
    if turn is None:
        return None
    speaker, person_id = next_speaker(turn, [person.person_id for person in state.persons.value if person.here])
    return intents.CorrectUtterance(turn.utterance_id, speaker=speaker, person_id=person_id)


@gives(intents.HearRobot)
def toggle_hearing(_scenario: Scenario, state: LiveState, _argument: None) -> Intent:
    """Toggle playback of the participant's microphone to the wizard."""
    sound = state.sound.value
    return intents.HearRobot(on=not sound.hearing, volume=sound.volume)


@gives(intents.CancelQueued)
def cancel_queued(_scenario: Scenario, state: LiveState, _argument: None) -> Intent | None:
    chosen = state.chosen_utterance.value
    return intents.CancelQueued(chosen) if chosen in _waiting(state) else None


@gives(intents.MoveQueued)
def move_queued(_scenario: Scenario, state: LiveState, step: int) -> Intent | None:
    """Move one position later (1) or earlier (-1)."""
    chosen, waiting = state.chosen_utterance.value, _waiting(state)
    if chosen not in waiting:
        return None
    place = waiting.index(chosen) + step
    return intents.MoveQueued(chosen, place) if 0 <= place < len(waiting) else None


def _waiting(state: LiveState) -> list[str]:
    return [utterance.utterance_id for utterance in state.speech.value.waiting]


@gives(intents.Mark)
def mark_moment(_scenario: Scenario, _state: LiveState, _argument: None) -> Intent:
    return intents.Mark("")


@gives(intents.Mark)
def mark_with_label(scenario: Scenario, _state: LiveState, number: int) -> Intent:
    labels = scenario.recording.labels
    return intents.Mark(labels[number - 1] if number <= len(labels) else "")


@gives(intents.Mark)
def mark_wizard_error(_scenario: Scenario, _state: LiveState, _argument: None) -> Intent:
    return intents.Mark("", "wizard_error")


@gives(intents.BeginMark, intents.EndMark)
def begin_or_end_interval(_scenario: Scenario, state: LiveState, _argument: None) -> Intent:
    """End the newest open interval that no key holds, or begin one."""
    going_on: tuple[Marked, ...] = state.marks.value.open
    held = state.held_marks.value
    stretch = next((mark for mark in reversed(going_on) if mark.mark_id not in held), None)
    return intents.BeginMark("") if stretch is None else intents.EndMark(stretch.mark_id)


@gives(intents.ChangeMark)
def move_last_mark_back(_scenario: Scenario, state: LiveState, _argument: None) -> Intent | None:
    last: Marked | None = state.marks.value.last
    return None if last is None else intents.ChangeMark(last.mark_id, earlier_s=STEP_BACK_S)


@gives(intents.WithdrawMark)
def withdraw_last_mark(_scenario: Scenario, state: LiveState, _argument: None) -> Intent | None:
    last: Marked | None = state.marks.value.last
    return None if last is None else intents.WithdrawMark(last.mark_id)


def present_step(scenario: Scenario, state: LiveState) -> ProtocolStep | None:
    """Current step, from the scenario."""
    step_id = state.protocol.value.step_id
    return step_named(scenario.protocol.steps, step_id) if step_id else None


def target_of(scenario: Scenario, branch: Branch) -> ProtocolStep:
    """Target step of a branch."""
    target = step_named(scenario.protocol.steps, branch.to)
    if target is None:
        raise ValueError(f"no scenario with a branch to nowhere is opened: {branch.to}")
    return target


@gives(intents.Say)
def say_step(scenario: Scenario, state: LiveState, _argument: None) -> Intent | None:
    """Say the sentence of the current step, with the gesture and expression of a matching phrase."""
    step = present_step(scenario, state)
    if step is None or not step.say:
        return None
    phrases = (phrase for group in phrase_groups(scenario.phrases) for phrase in group.phrases)
    phrase = next((phrase for phrase in phrases if phrase.say == step.say), Phrase(step.say))
    return intents.Say(step.say, "phrase", gesture=phrase.gesture, face=phrase.face)


@gives(intents.GoToPlace)
def go_to_step_place(scenario: Scenario, state: LiveState, _argument: None) -> Intent | None:
    step = present_step(scenario, state)
    return intents.GoToPlace(step.go_to) if step is not None and step.go_to else None


def _step(state: LiveState) -> ProtocolStep | None:
    scenario = state.scenario.value
    return None if scenario is None else present_step(scenario, state)


def _can_photograph(state: LiveState) -> bool:
    """Not while the recording is paused: nothing about people may be saved then."""
    return state.frame.freshness == "fresh" and state.recording.value.state != "paused"


def _has_previous_step(state: LiveState) -> bool:
    status = state.protocol.value
    return status.ended or status.number > 1 or bool(status.done or status.skipped)


_RECORDING = EnabledWhen(
    lambda state: state.recording.value.state == "recording",
    QT_TR_NOOP("No recording is running, so marks and notes cannot be added."),
)
_PHOTO = EnabledWhen(_can_photograph, QT_TR_NOOP("There is no picture to save now."))
_CAMERAS = EnabledWhen(lambda state: len(state.cameras.value) > 1, QT_TR_NOOP("There is no other camera."))
_ASKED = EnabledWhen(
    lambda state: state.asked_person.value is not None or bool(state.proposal.value.proposal_id),
    QT_TR_NOOP("No question is pending."),
)
_SUGGESTED = EnabledWhen(
    lambda state: bool(state.suggestions.value.cards) or state.suggestions.value.filler_ns is not None,
    QT_TR_NOOP("This suggestion is not available now."),
)
_QUEUED = EnabledWhen(lambda state: bool(state.speech.value.waiting), QT_TR_NOOP("The speech queue is empty."))
_STEP = EnabledWhen(lambda state: _step(state) is not None, QT_TR_NOOP("No protocol step is active."))
_STEP_AHEAD = EnabledWhen(
    lambda state: bool(state.protocol.value.steps) and not state.protocol.value.ended,
    QT_TR_NOOP("The protocol has no next step."),
)
_STEP_BACK = EnabledWhen(_has_previous_step, QT_TR_NOOP("The protocol has no previous step."))
_STEP_BRANCHES = EnabledWhen(
    lambda state: (step := _step(state)) is not None and bool(step.branches),
    QT_TR_NOOP("This protocol step has no branches."),
)
_STEP_SAYS = EnabledWhen(
    lambda state: (step := _step(state)) is not None and bool(step.say),
    QT_TR_NOOP("This protocol step has no text to say."),
)
_STEP_GOES = EnabledWhen(
    lambda state: (step := _step(state)) is not None and bool(step.go_to),
    QT_TR_NOOP("This protocol step has no place to go to."),
)


def has_head(robot: RobotProfile) -> bool:
    return robot.head is not None


def _asks(scenario: Scenario) -> bool:
    return scenario.permissions.naming_people or "actions" in scenario.assisted


def _held(
    group: str, action_id: str, text: str, icon: str, *keys: str, needs: Callable[[RobotProfile], bool] | None = None
) -> ActionSpec:
    chords = tuple(f"Alt+{key}" for key in keys)
    return ActionSpec(
        action_id, text, icon, chords, keys, "driving", "hold", group=group, by_position=True, needs=needs
    )


def _numbers(count: int) -> range:
    return range(1, count + 1)


_safety = partial(ActionSpec, group=SAFETY_GROUP, kind="safety")
_driving = partial(ActionSpec, group=QT_TR_NOOP("Driving"))
_head = partial(ActionSpec, group=_HEAD_HOLD_GROUP, by_position=True, needs=has_head)
_places = partial(ActionSpec, group=PLACES_GROUP)
_speaking = partial(ActionSpec, group=SPEAKING_GROUP)
_queue = partial(ActionSpec, group=QUEUE_GROUP, within="queue", panel="speak", enabled=_QUEUED)
_conversation = partial(ActionSpec, group=QT_TR_NOOP("Conversation"), panel="conversation")
_people = partial(ActionSpec, group=PEOPLE_GROUP)
_protocol = partial(ActionSpec, group=PROTOCOL_GROUP, applies=lambda scenario: bool(scenario.protocol.steps))
_session = partial(ActionSpec, group=QT_TR_NOOP("Session"))
_marks = partial(ActionSpec, group=MARKS_GROUP, kind="mark", enabled=_RECORDING)
_window = partial(ActionSpec, group=WINDOW_GROUP)
_replay = partial(ActionSpec, group=QT_TR_NOOP("Replay"))
_timeline = partial(ActionSpec, group=_TIMELINE_GROUP, within="timeline")

_SPEED = QT_TR_NOOP("speed")

ACTIONS: tuple[ActionSpec, ...] = (
    _safety("stop", QT_TR_NOOP("Stop the robot"), "hand-palm", ("Esc",), intent=intents.Stop()),
    _safety("emergency_stop", QT_TR_NOOP("Emergency stop"), "warning-octagon", ("Esc, Esc", "Pause"),
            intent=intents.EmergencyStop()),
    _held(_DRIVING_HOLD_GROUP, "drive_forward", QT_TR_NOOP("Drive forward"), "arrow-up", "W", "Up"),
    _held(_DRIVING_HOLD_GROUP, "drive_back", QT_TR_NOOP("Drive backward"), "arrow-down", "S", "Down"),
    _held(_DRIVING_HOLD_GROUP, "turn_left", QT_TR_NOOP("Turn left"), "arrow-left", "A", "Left"),
    _held(_DRIVING_HOLD_GROUP, "turn_right", QT_TR_NOOP("Turn right"), "arrow-right", "D", "Right"),
    _held(_DRIVING_HOLD_GROUP, "strafe_left", QT_TR_NOOP("Move sideways to the left"), "arrow-line-left", "Z",
          needs=attrgetter("holonomic")),
    _held(_DRIVING_HOLD_GROUP, "strafe_right", QT_TR_NOOP("Move sideways to the right"), "arrow-line-right", "C",
          needs=attrgetter("holonomic")),
    _driving("slower", QT_TR_NOOP("Slower"), "minus", ("Alt+Q",), ("Q",), intent=change_speed, argument=-1,
             by_position=True, also=_SPEED),
    _driving("faster", QT_TR_NOOP("Faster"), "plus", ("Alt+E",), ("E",), intent=change_speed, argument=1,
             by_position=True, also=_SPEED),
    _held(_HEAD_HOLD_GROUP, "look_up", QT_TR_NOOP("Look up"), "caret-up", "I", needs=has_head),
    _held(_HEAD_HOLD_GROUP, "look_down", QT_TR_NOOP("Look down"), "caret-down", "K", needs=has_head),
    _held(_HEAD_HOLD_GROUP, "look_left", QT_TR_NOOP("Look left"), "caret-left", "J", needs=has_head),
    _held(_HEAD_HOLD_GROUP, "look_right", QT_TR_NOOP("Look right"), "caret-right", "L", needs=has_head),
    _head("look_ahead", QT_TR_NOOP("Look ahead"), "crosshair-simple", ("Alt+O",), ("O",),
          intent=intents.LookAt(0.0, 0.0)),
    _head("nod", QT_TR_NOOP("Nod"), "arrows-down-up", ("Alt+N",), ("N",), intent=intents.Nod()),
    *(_places(f"place_{n}", QT_TR_NOOP("Go to place {number}"), "flag", (f"Alt+{n}",), (str(n),), by_position=True,
              intent=go_to_nth_place, argument=n) for n in _numbers(PLACE_COUNT)),
    _places("choose_place", QT_TR_NOOP("Go to a place…"), "flag", ("Ctrl+Shift+G",), permission="driving", common=True,
            callback="choose_place"),
    _driving("focus_driving", QT_TR_NOOP("Back to driving"), "game-controller", ("Ctrl+D",), permission="driving",
             callback="focus_driving"),
    _speaking("focus_speak", QT_TR_NOOP("Focus the Speak field"), "text-aa", ("Ctrl+L",), ("Return",), panel="speak",
              callback="focus_speak"),
    _speaking("focus_queue", QT_TR_NOOP("Edit the speech queue"), "list-numbers", ("Ctrl+Shift+L",), panel="speak",
              enabled=_QUEUED, callback="focus_queue"),
    _queue("queued_above", QT_TR_NOOP("Previous item"), "caret-up", ("Up",), callback="go", argument=-1),
    _queue("queued_below", QT_TR_NOOP("Next item"), "caret-down", ("Down",), callback="go", argument=1),
    _queue("queued_earlier", QT_TR_NOOP("Move earlier"), "arrow-up", ("Shift+Up",), intent=move_queued, argument=-1),
    _queue("queued_later", QT_TR_NOOP("Move later"), "arrow-down", ("Shift+Down",), intent=move_queued, argument=1),
    _queue("queued_edit", QT_TR_NOOP("Edit the text"), "pencil-simple", ("Return", "Enter"), callback="edit"),
    _queue("queued_cancel", QT_TR_NOOP("Remove from queue"), "x", ("Del", "Backspace"), intent=cancel_queued),
    *(_speaking(f"phrase_{n}", QT_TR_NOOP("Say phrase {number}"), "chat-text", (f"F{n}",), intent=say_phrase,
                argument=n) for n in _numbers(PHRASE_COUNT)),
    _speaking("next_phrases", QT_TR_NOOP("Next group of phrases"), "stack", ("F10",), permission="speech",
              callback="show_next_phrases", applies=lambda scenario: len(phrase_groups(scenario.phrases)) > 1),
    _speaking("filler", QT_TR_NOOP("Say the filler"), "dots-three", ("F9",), intent=say_filler,
              applies=lambda scenario: bool(scenario.filler)),
    *(_speaking(f"suggestion_{n}", QT_TR_NOOP("Say suggestion {number}"), "chat-text", (f"Ctrl+{n}",),
                enabled=_SUGGESTED, intent=say_nth_suggestion, argument=n, assists=("replies",))
      for n in _numbers(SUGGESTION_COUNT)),
    *(_speaking(f"edit_suggestion_{n}", QT_TR_NOOP("Edit suggestion {number} first"), "pencil-simple",
                (f"Ctrl+Shift+{n}",), permission="assistant", enabled=_SUGGESTED, callback="edit_suggestion",
                argument=n, panel="speak", assists=("replies",)) for n in _numbers(SUGGESTION_COUNT)),
    _speaking("no_suggestion", QT_TR_NOOP("Dismiss the suggestions"), "x", ("Ctrl+0",), permission="speech",
              enabled=_SUGGESTED, intent=intents.DismissSuggestions(), assists=("replies", "fillers")),
    *(_speaking(f"gesture_{n}", QT_TR_NOOP("Gesture {number}"), "hand-waving", (KEYS_BY_PLACE[n - 1],),
                intent=perform_nth_gesture, argument=n) for n in _numbers(MOST_GESTURES)),
    _speaking("silence", QT_TR_NOOP("Silence"), "speaker-slash", ("F12",), permission="speech", common=True,
              intent=intents.Silence()),
    _speaking("push_to_talk", QT_TR_NOOP("Speak through the robot (hold)"), "microphone", ("Ctrl+Space",), ("T",),
              permission="own_voice", kind="talk", argument="robot"),
    _speaking("dictate", QT_TR_NOOP("Dictate into the Speak field (hold)"), "headset", ("Ctrl+Shift+Space",),
              ("Shift+T",), permission="transcription", kind="talk", argument="dictation", panel="speak"),
    _speaking("hear", QT_TR_NOOP("Hear the robot"), "headphones", ("Ctrl+H",), intent=toggle_hearing,
              applies=lambda scenario: scenario.sound.hear),
    _conversation("correct_speaker", QT_TR_NOOP("Correct the last speaker"), "user-focus", ("Ctrl+Shift+S",),
                  intent=correct_newest_speaker),
    _people("answer_yes", QT_TR_NOOP("Answer yes"), "check", ("Ctrl+Return",), ("Y",), enabled=_ASKED,
            intent=answer_asked, argument=True, applies=_asks),
    _people("answer_no", QT_TR_NOOP("Answer no"), "x", ("Ctrl+Shift+Return",), ("Shift+Y",), enabled=_ASKED,
            intent=answer_asked, argument=False, applies=_asks),
    _people("name_person", QT_TR_NOOP("Name the nearest person"), "user-plus", ("Ctrl+I",), panel="people",
            permission="naming_people", common=True, callback="name_person"),
    _protocol("next_step", QT_TR_NOOP("Next step"), "arrow-right", ("Ctrl+PgDown",), ("PgDown",), enabled=_STEP_AHEAD,
              common=True, intent=intents.NextStep()),
    _protocol("branch", QT_TR_NOOP("Choose a branch"), "git-branch", ("Ctrl+B",), ("B",), enabled=_STEP_BRANCHES,
              callback="choose_branch"),
    _protocol("previous_step", QT_TR_NOOP("Back to the previous step"), "arrow-left", ("Ctrl+PgUp",), ("PgUp",),
              enabled=_STEP_BACK, intent=intents.PreviousStep()),
    _protocol("skip_step", QT_TR_NOOP("Skip this step"), "skip-forward", ("Ctrl+Shift+PgDown",), ("Shift+PgDown",),
              enabled=_STEP, intent=intents.SkipStep()),
    _protocol("say_step", QT_TR_NOOP("Say the text of this step"), "chat-text", ("F11",), permission="speech",
              enabled=_STEP_SAYS, intent=say_step),
    _protocol("go_to_step_place", QT_TR_NOOP("Go to the place of this step"), "flag", ("Alt+0",), ("0",),
              permission="driving", enabled=_STEP_GOES, intent=go_to_step_place, by_position=True),
    _protocol("all_steps", QT_TR_NOOP("All steps of the protocol"), "list-numbers", ("Ctrl+Shift+PgUp",),
              callback="show_steps"),
    *(ActionSpec(f"expression_{n}", QT_TR_NOOP("Face: expression {number}"), "smiley", (f"Ctrl+Shift+F{n}",),
                 intent=show_nth_expression, argument=n, group=QT_TR_NOOP("Face")) for n in _numbers(EXPRESSION_COUNT)),
    _session("photo", QT_TR_NOOP("Photo"), "camera", ("Ctrl+P",), ("P",), enabled=_PHOTO, common=True,
             intent=intents.TakePhoto()),
    _marks("mark", QT_TR_NOOP("Mark"), "bookmark-simple", ("Ctrl+M",), ("M",), common=True, intent=mark_moment),
    *(_marks(f"label_{n}", QT_TR_NOOP("Mark with label {number}"), "bookmark-simple", (f"Shift+F{n}",),
             intent=mark_with_label, argument=n) for n in _numbers(LABEL_COUNT)),
    _marks("stretch", QT_TR_NOOP("Start or end an interval"), "brackets-square", ("Ctrl+R",),
           intent=begin_or_end_interval),
    _marks("mark_earlier", QT_TR_NOOP("Move the last mark 3 s earlier"), "rewind", ("Ctrl+J",),
           intent=move_last_mark_back),
    _marks("mark_undo", QT_TR_NOOP("Undo the last mark"), "arrow-u-up-left", ("Ctrl+Shift+J",),
           intent=withdraw_last_mark),
    _marks("note", QT_TR_NOOP("Write a note"), "note-pencil", ("Ctrl+N",), permission="notes", common=True,
           also=QT_TR_NOOP("comment remark"), callback="write_note"),
    _marks("wizard_error", QT_TR_NOOP("Wizard error"), "warning", ("Ctrl+Shift+M",), ("Shift+M",),
           intent=mark_wizard_error),
    ActionSpec("choose_scenario", QT_TR_NOOP("Open a scenario…"), "map-trifold", ("Ctrl+O",), group=SCENARIO_GROUP,
               common=True, callback="choose_scenario"),
    ActionSpec("choose_wizard", QT_TR_NOOP("Another wizard…"), "user-gear", group=SCENARIO_GROUP,
               callback="choose_wizard"),
    ActionSpec("alarms", QT_TR_NOOP("Active alarms"), "warning-octagon", group=ALARMS_GROUP,
               also=QT_TR_NOOP("problems errors warnings trouble"), callback="show_alarms"),
    _window("next_camera", QT_TR_NOOP("Show the next camera"), "video-camera", ("Ctrl+Shift+V",), ("V",), panel="video",
            enabled=_CAMERAS, callback="show_next_camera"),
    _window("find", QT_TR_NOOP("Find anything"), "magnifying-glass", ("Ctrl+K",), ("/",),
            callback="show_command_palette"),
    _window("find_said", QT_TR_NOOP("Search the transcript"), "chats", ("Ctrl+F",), panel="conversation",
            callback="search_said"),
    _session("preflight", QT_TR_NOOP("Preflight checks"), "clipboard-text", ("Ctrl+Shift+C",),
             also=QT_TR_NOOP("preflight checklist ready"), callback="show_preflight"),
    _session("set_up", QT_TR_NOOP("Set up robot, camera, sound and language model"), "wrench",
             also=QT_TR_NOOP("help settings preferences microphone begin welcome connect"), callback="show_set_up"),
    _window("layout_undo", QT_TR_NOOP("Undo the last layout change"), "arrow-u-up-left", ("Ctrl+Shift+D",),
            callback="undo_layout"),
    _window("shortcuts", QT_TR_NOOP("All shortcuts"), "keyboard", ("Ctrl+/",), ("?",), common=True,
            also=QT_TR_NOOP("help keys keyboard hotkeys"), callback="show_shortcuts"),
    _window("help", QT_TR_NOOP("Help"), "question", ("Ctrl+F1",), callback="show_help"),
)  # fmt: skip

REPLAY_ACTIONS: tuple[ActionSpec, ...] = (
    _replay("replay_play", QT_TR_NOOP("Play or pause"), "play", ("Space",), callback="toggle_playing"),
    _replay("frame_back", QT_TR_NOOP("Previous frame"), "caret-left", (",",), callback="step", argument=-1),
    _replay("frame_on", QT_TR_NOOP("Next frame"), "caret-right", (".",), callback="step", argument=1),
    _replay("previous_mark", QT_TR_NOOP("Previous mark"), "skip-back", ("Ctrl+Left",), callback="jump",
            argument=("mark", -1)),
    _replay("next_mark", QT_TR_NOOP("Next mark"), "skip-forward", ("Ctrl+Right",), callback="jump",
            argument=("mark", 1)),
    _replay("previous_utterance", QT_TR_NOOP("Previous utterance"), "chat-text", ("Ctrl+Shift+Left",), callback="jump",
            argument=("utterance", -1)),
    _replay("next_utterance", QT_TR_NOOP("Next utterance"), "chat-text", ("Ctrl+Shift+Right",), callback="jump",
            argument=("utterance", 1)),
    _replay("replay_slower", QT_TR_NOOP("Play slower"), "minus", ("<",), callback="change_rate", argument=-1,
            also=_SPEED),
    _replay("replay_faster", QT_TR_NOOP("Play faster"), "plus", (">",), callback="change_rate", argument=1,
            also=_SPEED),
)  # fmt: skip
"""Rows that a replay adds. Keys without Ctrl or Alt never take input from a text field."""

TIMELINE_ACTIONS: tuple[ActionSpec, ...] = (
    ActionSpec("focus_timeline", QT_TR_NOOP("Go to the timeline"), "rows", ("Ctrl+T",), callback="focus_timeline",
               group=_TIMELINE_GROUP),
    ActionSpec("undo", QT_TR_NOOP("Undo"), "arrow-u-up-left", ("Ctrl+Z",), callback="undo", group=_TIMELINE_GROUP),
    ActionSpec("redo", QT_TR_NOOP("Redo"), "arrow-u-up-right", ("Ctrl+Shift+Z", "Ctrl+Y"), callback="redo",
               group=_TIMELINE_GROUP),
    *(_timeline(f"code_{n}", QT_TR_NOOP("Start or end label {number}"), "tag", (str(n),), callback="code", argument=n)
      for n in _numbers(CODE_COUNT)),
    _timeline("annotation_new", QT_TR_NOOP("New annotation at the playhead"), "plus", ("N",),
              callback="add_at_playhead"),
    _timeline("annotation_split", QT_TR_NOOP("Split at the playhead"), "scissors", ("S",),
              callback="split_at_playhead"),
    _timeline("annotation_rename", QT_TR_NOOP("Rename"), "pencil-simple", ("Return",), callback="rename_selected"),
    _timeline("annotation_remove", QT_TR_NOOP("Remove"), "trash", ("Del", "Backspace"), callback="remove_selected"),
    _timeline("annotation_begin", QT_TR_NOOP("Start at the playhead"), "arrow-line-left", ("B",),
              callback="begin_at_playhead"),
    _timeline("annotation_end", QT_TR_NOOP("End at the playhead"), "arrow-line-right", ("E",),
              callback="end_at_playhead"),
    _timeline("annotation_earlier", QT_TR_NOOP("Move a little earlier"), "arrow-left", ("Shift+Left",),
              callback="nudge", argument=-1),
    _timeline("annotation_later", QT_TR_NOOP("Move a little later"), "arrow-right", ("Shift+Right",), callback="nudge",
              argument=1),
    _timeline("annotation_previous", QT_TR_NOOP("Previous annotation"), "caret-double-left", ("PgUp",),
              callback="select_next", argument=-1),
    _timeline("annotation_next", QT_TR_NOOP("Next annotation"), "caret-double-right", ("PgDown",),
              callback="select_next", argument=1),
    _timeline("second_back", QT_TR_NOOP("1 second back"), "caret-left", ("Left",), callback="seek_by", argument=-1.0),
    _timeline("second_on", QT_TR_NOOP("1 second forward"), "caret-right", ("Right",), callback="seek_by", argument=1.0),
    _timeline("tier_above", QT_TR_NOOP("Tier above"), "caret-up", ("Up",), callback="select_tier", argument=-1),
    _timeline("tier_below", QT_TR_NOOP("Tier below"), "caret-down", ("Down",), callback="select_tier", argument=1),
    _timeline("timeline_larger", QT_TR_NOOP("Zoom in"), "magnifying-glass-plus", ("+", "="), callback="zoom",
              argument=1),
    _timeline("timeline_smaller", QT_TR_NOOP("Zoom out"), "magnifying-glass-minus", ("-",), callback="zoom",
              argument=-1),
    _timeline("timeline_fit", QT_TR_NOOP("Show the whole session"), "arrows-out-line-horizontal", ("F",),
              callback="fit"),
)  # fmt: skip
