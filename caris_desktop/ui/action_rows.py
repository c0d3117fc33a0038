"""The rows of the table of actions: what there is to be done, by which keys.

A row carries the intent that it asks the console for. Only what is purely of the window names a callback.
"""

from typing import Any

from caris_desktop.conversation.transcript import newest_heard, next_speaker
from caris_desktop.domain import intents
from caris_desktop.domain.intents import Intent
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.model import Scenario
from caris_desktop.scenario.phrases import KEYS_OF_A_GROUP, Phrase, phrase_groups
from caris_desktop.ui.action_spec import ActionSpec
from caris_desktop.ui.speed_steps import fraction_after
from caris_desktop.ui.step_acts import PROTOCOL_ACTIONS

PHRASE_COUNT = KEYS_OF_A_GROUP
SUGGESTION_COUNT = 3
LABEL_COUNT = 8
PLACE_COUNT = 9
CODE_COUNT = 9
EXPRESSION_COUNT = 8
QUEUE_GROUP = "What is said next"


def phrases_on_keys(scenario: Scenario, group: int) -> tuple[Phrase, ...]:
    """What F1 to F8 say while this group is chosen."""
    groups = phrase_groups(scenario.phrases)
    return groups[group % len(groups)].phrases if groups else ()


def say(phrase: Phrase) -> Intent:
    return intents.Say(phrase.say, "phrase", gesture=phrase.gesture, face=phrase.face)


def say_phrase(scenario: Scenario, state: LiveState, number: int) -> Intent | None:
    phrases = phrases_on_keys(scenario, state.phrase_group.value)
    return say(phrases[number - 1]) if number <= len(phrases) else None


def say_keyed_phrase(_scenario: Scenario, _state: LiveState, phrase: Phrase) -> Intent:
    return say(phrase)


def say_filler(scenario: Scenario, state: LiveState, _argument: None) -> Intent | None:
    filler = scenario.next_filler(state.fillers_said.value)
    return intents.Say(filler, "filler") if filler else None


def change_speed(_scenario: Scenario, state: LiveState, direction: int) -> Intent:
    """One of the three steps up (1) or down (-1)."""
    return intents.SetSpeed(fraction_after(state.drive.value.speed_fraction, direction))


def go_to_nth_place(_scenario: Scenario, state: LiveState, number: int) -> Intent | None:
    places = state.places.value
    return intents.GoToPlace(places[number - 1].name) if number <= len(places) else None


def show_nth_expression(_scenario: Scenario, state: LiveState, number: int) -> Intent | None:
    expressions = state.face.value.expressions
    return intents.ShowExpression(expressions[number - 1]) if number <= len(expressions) else None


def answer_asked(scenario: Scenario, state: LiveState, yes: bool) -> Intent | None:
    """Yes or no to what is asked now: about a person first, else about what the language model proposes to do. Nothing
    while that has only just come up.
    """
    asked, proposal, now_ns = state.asked_person.value, state.proposal.value, state.present.now_ns()
    if asked is not None and scenario.permissions.naming_people:
        if now_ns < asked.from_ns:
            return None
        answer = intents.ConfirmPerson if yes else intents.RejectPerson
        return answer(asked.person_id, asked.is_person_id)
    if proposal.proposal_id and scenario.permissions.assistant and not (yes and now_ns < proposal.from_ns):
        return (intents.ConfirmProposal if yes else intents.VetoProposal)(proposal.proposal_id)
    return None


def say_nth_suggestion(_scenario: Scenario, state: LiveState, rank: int) -> Intent | None:
    """Say the suggested reply at that place; nothing while it has only just come up there."""
    card = next((card for card in state.suggestions.value.cards if card.rank == rank), None)
    if card is None or state.present.now_ns() < card.from_ns:
        return None
    return intents.SaySuggestion(rank, card.suggestion_id)


def correct_newest_speaker(_scenario: Scenario, state: LiveState, _argument: None) -> Intent | None:
    """Who said the newest turn that was heard: the next of those who may have."""
    turn = newest_heard(state.transcript.value)
    if turn is None:
        return None
    speaker, person_id = next_speaker(turn, [person.person_id for person in state.persons.value if person.here])
    return intents.CorrectUtterance(turn.utterance_id, speaker=speaker, person_id=person_id)


def toggle_hearing(_scenario: Scenario, state: LiveState, _argument: None) -> Intent:
    """What the participant's microphone hears is played to the wizard, or no longer."""
    sound = state.sound.value
    return intents.HearRobot(on=not sound.hearing, volume=sound.volume)


def _held(action_id: str, text: str, icon: str, letter: str, arrow: str = "", **more: Any) -> ActionSpec:
    bare = tuple(key for key in (letter, arrow) if key)
    return ActionSpec(
        action_id, text, icon, tuple(f"Alt+{key}" for key in bare), bare, "driving", "hold", by_position=True, **more
    )


def _in_queue(action_id: str, text: str, icon: str, *keys: str, **more: Any) -> ActionSpec:
    return ActionSpec(
        action_id, text, icon, keys, enabled_when="in_queue", group=QUEUE_GROUP, within="queue", panel="speak", **more
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
        "choose_place", "Go to a place…", "flag", ("Ctrl+Shift+G",), permission="driving", callback="choose_place",
        group="Places",
    ),
    ActionSpec(
        "focus_driving", "Back to driving", "game-controller", ("Ctrl+D",), (), "driving", callback="focus_driving",
        group="Driving",
    ),
    ActionSpec(
        "focus_speak", "Into the Speak field", "text-aa", ("Ctrl+L",), ("Return",), callback="focus_speak",
        group="Speaking", panel="speak",
    ),
    ActionSpec(
        "focus_queue", "Change what is said next", "list-numbers", ("Ctrl+Shift+L",), enabled_when="queued",
        callback="focus_queue", group="Speaking", panel="speak",
    ),
    _in_queue("queued_above", "The one before", "caret-up", "Up", callback="go_up"),
    _in_queue("queued_below", "The one after", "caret-down", "Down", callback="go_down"),
    _in_queue("queued_earlier", "Say it earlier", "arrow-up", "Shift+Up", callback="move_earlier"),
    _in_queue("queued_later", "Say it later", "arrow-down", "Shift+Down", callback="move_later"),
    _in_queue("queued_edit", "Say it differently", "pencil-simple", "Return", "Enter", callback="edit"),
    _in_queue("queued_cancel", "Do not say it", "x", "Del", "Backspace", callback="cancel"),
    *(
        ActionSpec(
            f"phrase_{number}", f"Say phrase {number}", "chat-text", (f"F{number}",), permission="speech",
            intent=say_phrase, argument=number, group="Speaking",
        )
        for number in range(1, PHRASE_COUNT + 1)
    ),
    ActionSpec(
        "next_phrases", "Next group of phrases", "stack", ("F10",), permission="speech", callback="show_next_phrases",
        group="Speaking",
    ),
    ActionSpec(
        "filler", "Say the filler", "dots-three", ("F9",), permission="speech", intent=say_filler, group="Speaking"
    ),
    *(
        ActionSpec(
            f"suggestion_{number}", f"Say suggestion {number}", "chat-text", (f"Ctrl+{number}",),
            permission="assistant", also="speech", enabled_when="suggested", intent=say_nth_suggestion,
            argument=number, group="Speaking",
        )
        for number in range(1, SUGGESTION_COUNT + 1)
    ),
    *(
        ActionSpec(
            f"edit_suggestion_{number}", f"Edit suggestion {number} first", "pencil-simple", (f"Ctrl+Shift+{number}",),
            permission="assistant", enabled_when="suggested", callback="edit_suggestion", argument=number,
            group="Speaking", panel="speak",
        )
        for number in range(1, SUGGESTION_COUNT + 1)
    ),
    ActionSpec(
        "no_suggestion", "Dismiss the suggestions", "x", ("Ctrl+0",), permission="speech",
        enabled_when="suggested", intent=intents.DismissSuggestions(), group="Speaking",
    ),
    ActionSpec(
        "silence", "Silence", "speaker-slash", ("F12",), permission="speech", intent=intents.Silence(), group="Speaking"
    ),
    ActionSpec(
        "push_to_talk", "Speak through the robot (hold)", "microphone", ("Ctrl+Space",), ("T",), "own_voice", "talk",
        argument="robot", group="Speaking",
    ),
    ActionSpec(
        "dictate", "Dictate into the Speak field (hold)", "headset", ("Ctrl+Shift+Space",), ("Shift+T",),
        "transcription", "talk", argument="dictation", group="Speaking", panel="speak",
    ),
    ActionSpec(
        "hear", "Hear the robot", "headphones", ("Ctrl+H",), intent=toggle_hearing, group="Speaking",
    ),
    ActionSpec(
        "correct_speaker", "Somebody else said that", "user-focus", ("Ctrl+Shift+S",), intent=correct_newest_speaker,
        group="Conversation", panel="conversation",
    ),
    ActionSpec(
        "answer_yes", "Yes, to what is asked", "check", ("Ctrl+Return",), ("Y",),
        enabled_when="asked", intent=answer_asked, argument=True, group="People",
    ),
    ActionSpec(
        "answer_no", "No, to what is asked", "x", ("Ctrl+Shift+Return",), ("Shift+Y",),
        enabled_when="asked", intent=answer_asked, argument=False, group="People",
    ),
    ActionSpec(
        "name_person", "Name who is in front", "user-plus", ("Ctrl+I",), permission="naming_people",
        callback="name_person", group="People", panel="people",
    ),
    *PROTOCOL_ACTIONS,
    *(
        ActionSpec(
            f"expression_{number}", f"Face: expression {number}", "smiley", (f"Ctrl+Shift+F{number}",),
            permission="face", intent=show_nth_expression, argument=number, group="Face",
        )
        for number in range(1, EXPRESSION_COUNT + 1)
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
        "note", "Write a note", "note-pencil", ("Ctrl+N",), permission="notes", kind="mark", enabled_when="recording",
        callback="write_note", group="Marks",
    ),
    ActionSpec(
        "wizard_error", "Wizard error", "warning", ("Ctrl+Shift+M",), ("Shift+M",), kind="mark",
        enabled_when="recording", callback="mark_wizard_error", group="Marks",
    ),
    ActionSpec(
        "choose_scenario", "Open a scenario…", "map-trifold", ("Ctrl+O",), callback="choose_scenario",
        group="Scenario",
    ),
    ActionSpec("choose_wizard", "Another wizard…", "user-gear", callback="choose_wizard", group="Scenario"),
    ActionSpec("alarms", "What is wrong now", "warning-octagon", callback="show_alarms", group="Alarms"),
    ActionSpec(
        "next_camera", "Show the next camera", "video-camera", ("Ctrl+Shift+V",), ("V",), enabled_when="cameras",
        callback="show_next_camera", group="Window", panel="video",
    ),
    ActionSpec(
        "find", "Find anything", "magnifying-glass", ("Ctrl+K",), ("/",), callback="show_command_palette",
        group="Window",
    ),
    ActionSpec(
        "find_said", "Search what was said", "chats", ("Ctrl+F",), callback="search_said", group="Window",
        panel="conversation",
    ),
    ActionSpec(
        "preflight", "Checks before a recording", "clipboard-text", ("Ctrl+Shift+C",),
        callback="show_preflight", group="Session",
    ),
    ActionSpec(
        "set_up", "Set up robot, camera, sound and language model", "wrench", callback="show_set_up", group="Session",
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
