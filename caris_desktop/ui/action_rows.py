"""The action table: every command of the window with its key bindings.

A row carries the intent that it sends to the console. Only commands that concern the window alone name a callback.
"""

from typing import Any

from caris_desktop.conversation.conversation_transcript import newest_heard, next_speaker
from caris_desktop.domain import intents
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.live.addressee import addressee
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.phrases import (
    KEYS_BY_PLACE,
    KEYS_OF_A_GROUP,
    LOOK,
    MOST_GESTURES,
    NOD,
    Phrase,
    phrase_groups,
)
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui.action_spec import ActionSpec, gives
from caris_desktop.ui.mark_intents import (
    begin_or_end_interval,
    mark_moment,
    mark_with_label,
    mark_wizard_error,
    move_last_mark_back,
    withdraw_last_mark,
)
from caris_desktop.ui.speed_steps import fraction_after
from caris_desktop.ui.step_intents import PROTOCOL_ACTIONS

PHRASE_COUNT = KEYS_OF_A_GROUP
SUGGESTION_COUNT = 3
LABEL_COUNT = 8
PLACE_COUNT = 9
CODE_COUNT = 9
EXPRESSION_COUNT = 8
QUEUE_GROUP = QT_TR_NOOP("Speech queue")
SAFETY_GROUP = QT_TR_NOOP("Safety")
DRIVING_HOLD_GROUP = QT_TR_NOOP("Driving (hold)")
DRIVING_GROUP = QT_TR_NOOP("Driving")
HEAD_HOLD_GROUP = QT_TR_NOOP("Head (hold)")
PLACES_GROUP = QT_TR_NOOP("Places")
SPEAKING_GROUP = QT_TR_NOOP("Speaking")
CONVERSATION_GROUP = QT_TR_NOOP("Conversation")
PEOPLE_GROUP = QT_TR_NOOP("People")
FACE_GROUP = QT_TR_NOOP("Face")
SESSION_GROUP = QT_TR_NOOP("Session")
MARKS_GROUP = QT_TR_NOOP("Marks")
SCENARIO_GROUP = QT_TR_NOOP("Scenario")
ALARMS_GROUP = QT_TR_NOOP("Alarms")
WINDOW_GROUP = QT_TR_NOOP("Window")
REPLAY_GROUP = QT_TR_NOOP("Replay")
TIMELINE_GROUP = QT_TR_NOOP("Timeline")


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
    return intents.SetSpeed(fraction_after(state.drive.value.speed_fraction, direction))


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


def _held(action_id: str, text: str, icon: str, letter: str, arrow: str = "", **more: Any) -> ActionSpec:
    bare = tuple(key for key in (letter, arrow) if key)
    return ActionSpec(
        action_id, text, icon, tuple(f"Alt+{key}" for key in bare), bare, "driving", "hold", by_position=True, **more
    )


def _in_queue(action_id: str, text: str, icon: str, *keys: str, **more: Any) -> ActionSpec:
    return ActionSpec(
        action_id, text, icon, keys, enabled_when="in_queue", group=QUEUE_GROUP, within="queue", panel="speak", **more
    )


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


ACTIONS: tuple[ActionSpec, ...] = (
    ActionSpec("stop", QT_TR_NOOP("Stop the robot"), "hand-palm", ("Esc",), kind="safety", intent=intents.Stop(),
    group=SAFETY_GROUP),
    ActionSpec(
        "emergency_stop", QT_TR_NOOP("Emergency stop"), "warning-octagon", ("Esc, Esc", "Pause"), kind="safety",
        intent=intents.EmergencyStop(), group=SAFETY_GROUP,
    ),
    _held("drive_forward", QT_TR_NOOP("Drive forward"), "arrow-up", "W", "Up", group=DRIVING_HOLD_GROUP),
    _held("drive_back", QT_TR_NOOP("Drive backward"), "arrow-down", "S", "Down", group=DRIVING_HOLD_GROUP),
    _held("turn_left", QT_TR_NOOP("Turn left"), "arrow-left", "A", "Left", group=DRIVING_HOLD_GROUP),
    _held("turn_right", QT_TR_NOOP("Turn right"), "arrow-right", "D", "Right", group=DRIVING_HOLD_GROUP),
    _held(
        "strafe_left", QT_TR_NOOP("Move sideways to the left"), "arrow-line-left", "Z", group=DRIVING_HOLD_GROUP,
        needs="sideways"
    ),
    _held(
        "strafe_right", QT_TR_NOOP("Move sideways to the right"), "arrow-line-right", "C", group=DRIVING_HOLD_GROUP,
        needs="sideways"
    ),
    ActionSpec(
        "slower", QT_TR_NOOP("Slower"), "minus", ("Alt+Q",), ("Q",), intent=change_speed, argument=-1,
        group=DRIVING_GROUP, by_position=True,
    ),
    ActionSpec(
        "faster", QT_TR_NOOP("Faster"), "plus", ("Alt+E",), ("E",), intent=change_speed, argument=1,
        group=DRIVING_GROUP, by_position=True,
    ),
    _held("look_up", QT_TR_NOOP("Look up"), "caret-up", "I", group=HEAD_HOLD_GROUP, needs="head"),
    _held("look_down", QT_TR_NOOP("Look down"), "caret-down", "K", group=HEAD_HOLD_GROUP, needs="head"),
    _held("look_left", QT_TR_NOOP("Look left"), "caret-left", "J", group=HEAD_HOLD_GROUP, needs="head"),
    _held("look_right", QT_TR_NOOP("Look right"), "caret-right", "L", group=HEAD_HOLD_GROUP, needs="head"),
    ActionSpec(
        "look_ahead", QT_TR_NOOP("Look ahead"), "crosshair-simple", ("Alt+O",), ("O",),
        intent=intents.LookAt(0.0, 0.0), group=HEAD_HOLD_GROUP, by_position=True, needs="head",
    ),
    ActionSpec(
        "nod", QT_TR_NOOP("Nod"), "arrows-down-up", ("Alt+N",), ("N",),
        intent=intents.Nod(), group=HEAD_HOLD_GROUP, by_position=True, needs="head",
    ),
    *(
        ActionSpec(
            f"place_{number}", QT_TR_NOOP("Go to place {number}"), "flag", (f"Alt+{number}",), (str(number),),
            intent=go_to_nth_place, argument=number, group=PLACES_GROUP, by_position=True,
        )
        for number in range(1, PLACE_COUNT + 1)
    ),
    ActionSpec(
        "choose_place", QT_TR_NOOP("Go to a place…"), "flag", ("Ctrl+Shift+G",), permission="driving",
        callback="choose_place",
        group=PLACES_GROUP,
    ),
    ActionSpec(
        "focus_driving", QT_TR_NOOP("Back to driving"), "game-controller", ("Ctrl+D",), (), "driving",
        callback="focus_driving",
        group=DRIVING_GROUP,
    ),
    ActionSpec(
        "focus_speak", QT_TR_NOOP("Focus the Speak field"), "text-aa", ("Ctrl+L",), ("Return",), callback="focus_speak",
        group=SPEAKING_GROUP, panel="speak",
    ),
    ActionSpec(
        "focus_queue", QT_TR_NOOP("Edit the speech queue"), "list-numbers", ("Ctrl+Shift+L",), enabled_when="queued",
        callback="focus_queue", group=SPEAKING_GROUP, panel="speak",
    ),
    _in_queue("queued_above", QT_TR_NOOP("Previous item"), "caret-up", "Up", callback="go_up"),
    _in_queue("queued_below", QT_TR_NOOP("Next item"), "caret-down", "Down", callback="go_down"),
    _in_queue("queued_earlier", QT_TR_NOOP("Move earlier"), "arrow-up", "Shift+Up", intent=move_queued, argument=-1),
    _in_queue("queued_later", QT_TR_NOOP("Move later"), "arrow-down", "Shift+Down", intent=move_queued, argument=1),
    _in_queue("queued_edit", QT_TR_NOOP("Edit the text"), "pencil-simple", "Return", "Enter", callback="edit"),
    _in_queue("queued_cancel", QT_TR_NOOP("Remove from queue"), "x", "Del", "Backspace", intent=cancel_queued),
    *(
        ActionSpec(
            f"phrase_{number}", QT_TR_NOOP("Say phrase {number}"), "chat-text", (f"F{number}",),
            intent=say_phrase, argument=number, group=SPEAKING_GROUP,
        )
        for number in range(1, PHRASE_COUNT + 1)
    ),
    ActionSpec(
        "next_phrases", QT_TR_NOOP("Next group of phrases"), "stack", ("F10",), permission="speech",
        callback="show_next_phrases",
        group=SPEAKING_GROUP,
    ),
    ActionSpec(
        "filler", QT_TR_NOOP("Say the filler"), "dots-three", ("F9",), intent=say_filler,
        group=SPEAKING_GROUP
    ),
    *(
        ActionSpec(
            f"suggestion_{number}", QT_TR_NOOP("Say suggestion {number}"), "chat-text", (f"Ctrl+{number}",),
            enabled_when="suggested", intent=say_nth_suggestion,
            argument=number, group=SPEAKING_GROUP, assists=("replies",),
        )
        for number in range(1, SUGGESTION_COUNT + 1)
    ),
    *(
        ActionSpec(
            f"edit_suggestion_{number}", QT_TR_NOOP("Edit suggestion {number} first"), "pencil-simple",
            (f"Ctrl+Shift+{number}",),
            permission="assistant", enabled_when="suggested", callback="edit_suggestion", argument=number,
            group=SPEAKING_GROUP, panel="speak", assists=("replies",),
        )
        for number in range(1, SUGGESTION_COUNT + 1)
    ),
    ActionSpec(
        "no_suggestion", QT_TR_NOOP("Dismiss the suggestions"), "x", ("Ctrl+0",), permission="speech",
        enabled_when="suggested", intent=intents.DismissSuggestions(), group=SPEAKING_GROUP,
        assists=("replies", "fillers"),
    ),
    *(
        ActionSpec(
            f"gesture_{number}", QT_TR_NOOP("Gesture {number}"), "hand-waving",
            (KEYS_BY_PLACE[number - 1],), intent=perform_nth_gesture, argument=number,
            group=SPEAKING_GROUP,
        )
        for number in range(1, MOST_GESTURES + 1)
    ),
    ActionSpec(
        "silence", QT_TR_NOOP("Silence"), "speaker-slash", ("F12",), permission="speech", intent=intents.Silence(),
        group=SPEAKING_GROUP
    ),
    ActionSpec(
        "push_to_talk", QT_TR_NOOP("Speak through the robot (hold)"), "microphone", ("Ctrl+Space",), ("T",),
        "own_voice", "talk",
        argument="robot", group=SPEAKING_GROUP,
    ),
    ActionSpec(
        "dictate", QT_TR_NOOP("Dictate into the Speak field (hold)"), "headset", ("Ctrl+Shift+Space",), ("Shift+T",),
        "transcription", "talk", argument="dictation", group=SPEAKING_GROUP, panel="speak",
    ),
    ActionSpec(
        "hear", QT_TR_NOOP("Hear the robot"), "headphones", ("Ctrl+H",), intent=toggle_hearing, group=SPEAKING_GROUP,
    ),
    ActionSpec(
        "correct_speaker", QT_TR_NOOP("Correct the last speaker"), "user-focus", ("Ctrl+Shift+S",),
        intent=correct_newest_speaker,
        group=CONVERSATION_GROUP, panel="conversation",
    ),
    ActionSpec(
        "answer_yes", QT_TR_NOOP("Answer yes"), "check", ("Ctrl+Return",), ("Y",),
        enabled_when="asked", intent=answer_asked, argument=True, group=PEOPLE_GROUP,
    ),
    ActionSpec(
        "answer_no", QT_TR_NOOP("Answer no"), "x", ("Ctrl+Shift+Return",), ("Shift+Y",),
        enabled_when="asked", intent=answer_asked, argument=False, group=PEOPLE_GROUP,
    ),
    ActionSpec(
        "name_person", QT_TR_NOOP("Name the nearest person"), "user-plus", ("Ctrl+I",), permission="naming_people",
        callback="name_person", group=PEOPLE_GROUP, panel="people",
    ),
    *PROTOCOL_ACTIONS,
    *(
        ActionSpec(
            f"expression_{number}", QT_TR_NOOP("Face: expression {number}"), "smiley", (f"Ctrl+Shift+F{number}",),
            intent=show_nth_expression, argument=number, group=FACE_GROUP,
        )
        for number in range(1, EXPRESSION_COUNT + 1)
    ),
    ActionSpec(
        "photo", QT_TR_NOOP("Photo"), "camera", ("Ctrl+P",), ("P",), enabled_when="photo",
        intent=intents.TakePhoto(), group=SESSION_GROUP,
    ),
    ActionSpec(
        "mark", QT_TR_NOOP("Mark"), "bookmark-simple", ("Ctrl+M",), ("M",), kind="mark", enabled_when="recording",
        intent=mark_moment, group=MARKS_GROUP,
    ),
    *(
        ActionSpec(
            f"label_{number}", QT_TR_NOOP("Mark with label {number}"), "bookmark-simple", (f"Shift+F{number}",),
            kind="mark",
            enabled_when="recording", intent=mark_with_label, argument=number, group=MARKS_GROUP,
        )
        for number in range(1, LABEL_COUNT + 1)
    ),
    ActionSpec(
        "stretch", QT_TR_NOOP("Start or end an interval"), "brackets-square", ("Ctrl+R",), kind="mark",
        enabled_when="recording",
        intent=begin_or_end_interval, group=MARKS_GROUP,
    ),
    ActionSpec(
        "mark_earlier", QT_TR_NOOP("Move the last mark 3 s earlier"), "rewind", ("Ctrl+J",), kind="mark",
        enabled_when="recording",
        intent=move_last_mark_back, group=MARKS_GROUP,
    ),
    ActionSpec(
        "mark_undo", QT_TR_NOOP("Undo the last mark"), "arrow-u-up-left", ("Ctrl+Shift+J",), kind="mark",
        enabled_when="recording", intent=withdraw_last_mark, group=MARKS_GROUP,
    ),
    ActionSpec(
        "note", QT_TR_NOOP("Write a note"), "note-pencil", ("Ctrl+N",), permission="notes", kind="mark",
        enabled_when="recording",
        callback="write_note", group=MARKS_GROUP,
    ),
    ActionSpec(
        "wizard_error", QT_TR_NOOP("Wizard error"), "warning", ("Ctrl+Shift+M",), ("Shift+M",), kind="mark",
        enabled_when="recording", intent=mark_wizard_error, group=MARKS_GROUP,
    ),
    ActionSpec(
        "choose_scenario", QT_TR_NOOP("Open a scenario…"), "map-trifold", ("Ctrl+O",), callback="choose_scenario",
        group=SCENARIO_GROUP,
    ),
    ActionSpec("choose_wizard", QT_TR_NOOP("Another wizard…"), "user-gear", callback="choose_wizard",
    group=SCENARIO_GROUP),
    ActionSpec("alarms", QT_TR_NOOP("Active alarms"), "warning-octagon", callback="show_alarms",
    group=ALARMS_GROUP),
    ActionSpec(
        "next_camera", QT_TR_NOOP("Show the next camera"), "video-camera", ("Ctrl+Shift+V",), ("V",),
        enabled_when="cameras",
        callback="show_next_camera", group=WINDOW_GROUP, panel="video",
    ),
    ActionSpec(
        "find", QT_TR_NOOP("Find anything"), "magnifying-glass", ("Ctrl+K",), ("/",), callback="show_command_palette",
        group=WINDOW_GROUP,
    ),
    ActionSpec(
        "find_said", QT_TR_NOOP("Search the transcript"), "chats", ("Ctrl+F",), callback="search_said",
        group=WINDOW_GROUP,
        panel="conversation",
    ),
    ActionSpec(
        "preflight", QT_TR_NOOP("Preflight checks"), "clipboard-text", ("Ctrl+Shift+C",),
        callback="show_preflight", group=SESSION_GROUP,
    ),
    ActionSpec(
        "set_up", QT_TR_NOOP("Set up robot, camera, sound and language model"), "wrench", callback="show_set_up",
        group=SESSION_GROUP,
    ),
    ActionSpec(
        "layout_undo", QT_TR_NOOP("Undo the last layout change"), "arrow-u-up-left", ("Ctrl+Shift+D",),
        callback="undo_layout", group=WINDOW_GROUP,
    ),
    ActionSpec(
        "shortcuts", QT_TR_NOOP("All shortcuts"), "keyboard", ("Ctrl+/",), ("?",), callback="show_shortcuts",
        group=WINDOW_GROUP,
    ),
    ActionSpec("help", QT_TR_NOOP("Help"), "question", ("Ctrl+F1",), callback="show_help", group=WINDOW_GROUP),
)  # fmt: skip

REPLAY_ACTIONS: tuple[ActionSpec, ...] = (
    ActionSpec(
        "replay_play", QT_TR_NOOP("Play or pause"), "play", ("Space",), callback="toggle_playing", group=REPLAY_GROUP
    ),
    ActionSpec(
        "frame_back",
        QT_TR_NOOP("Previous frame"),
        "caret-left",
        (",",),
        callback="step",
        argument=-1,
        group=REPLAY_GROUP,
    ),
    ActionSpec(
        "frame_on", QT_TR_NOOP("Next frame"), "caret-right", (".",), callback="step", argument=1, group=REPLAY_GROUP
    ),
    ActionSpec(
        "previous_mark",
        QT_TR_NOOP("Previous mark"),
        "skip-back",
        ("Ctrl+Left",),
        callback="jump",
        argument=("mark", -1),
        group=REPLAY_GROUP,
    ),
    ActionSpec(
        "next_mark",
        QT_TR_NOOP("Next mark"),
        "skip-forward",
        ("Ctrl+Right",),
        callback="jump",
        argument=("mark", 1),
        group=REPLAY_GROUP,
    ),
    ActionSpec(
        "previous_utterance",
        QT_TR_NOOP("Previous utterance"),
        "chat-text",
        ("Ctrl+Shift+Left",),
        callback="jump",
        argument=("utterance", -1),
        group=REPLAY_GROUP,
    ),
    ActionSpec(
        "next_utterance",
        QT_TR_NOOP("Next utterance"),
        "chat-text",
        ("Ctrl+Shift+Right",),
        callback="jump",
        argument=("utterance", 1),
        group=REPLAY_GROUP,
    ),
    ActionSpec(
        "replay_slower",
        QT_TR_NOOP("Play slower"),
        "minus",
        ("<",),
        callback="change_rate",
        argument=-1,
        group=REPLAY_GROUP,
    ),
    ActionSpec(
        "replay_faster",
        QT_TR_NOOP("Play faster"),
        "plus",
        (">",),
        callback="change_rate",
        argument=1,
        group=REPLAY_GROUP,
    ),
)
"""Rows that a replay adds. Keys without Ctrl or Alt never take input from a text field."""


def _on_timeline(action_id: str, text: str, icon: str, *keys: str, **more: Any) -> ActionSpec:
    return ActionSpec(action_id, text, icon, keys, group=TIMELINE_GROUP, within="timeline", **more)


TIMELINE_ACTIONS: tuple[ActionSpec, ...] = (
    ActionSpec(
        "focus_timeline",
        QT_TR_NOOP("Go to the timeline"),
        "rows",
        ("Ctrl+T",),
        callback="focus_timeline",
        group=TIMELINE_GROUP,
    ),
    ActionSpec("undo", QT_TR_NOOP("Undo"), "arrow-u-up-left", ("Ctrl+Z",), callback="undo", group=TIMELINE_GROUP),
    ActionSpec(
        "redo",
        QT_TR_NOOP("Redo"),
        "arrow-u-up-right",
        ("Ctrl+Shift+Z", "Ctrl+Y"),
        callback="redo",
        group=TIMELINE_GROUP,
    ),
    *(
        _on_timeline(
            f"code_{number}",
            QT_TR_NOOP("Start or end label {number}"),
            "tag",
            str(number),
            callback="code",
            argument=number,
        )
        for number in range(1, CODE_COUNT + 1)
    ),
    _on_timeline(
        "annotation_new", QT_TR_NOOP("New annotation at the playhead"), "plus", "N", callback="add_at_playhead"
    ),
    _on_timeline(
        "annotation_split", QT_TR_NOOP("Split at the playhead"), "scissors", "S", callback="split_at_playhead"
    ),
    _on_timeline("annotation_rename", QT_TR_NOOP("Rename"), "pencil-simple", "Return", callback="rename_selected"),
    _on_timeline("annotation_remove", QT_TR_NOOP("Remove"), "trash", "Del", "Backspace", callback="remove_selected"),
    _on_timeline(
        "annotation_begin", QT_TR_NOOP("Start at the playhead"), "arrow-line-left", "B", callback="begin_at_playhead"
    ),
    _on_timeline(
        "annotation_end", QT_TR_NOOP("End at the playhead"), "arrow-line-right", "E", callback="end_at_playhead"
    ),
    _on_timeline(
        "annotation_earlier",
        QT_TR_NOOP("Move a little earlier"),
        "arrow-left",
        "Shift+Left",
        callback="nudge",
        argument=-1,
    ),
    _on_timeline(
        "annotation_later",
        QT_TR_NOOP("Move a little later"),
        "arrow-right",
        "Shift+Right",
        callback="nudge",
        argument=1,
    ),
    _on_timeline(
        "annotation_previous",
        QT_TR_NOOP("Previous annotation"),
        "caret-double-left",
        "PgUp",
        callback="select_next",
        argument=-1,
    ),
    _on_timeline(
        "annotation_next",
        QT_TR_NOOP("Next annotation"),
        "caret-double-right",
        "PgDown",
        callback="select_next",
        argument=1,
    ),
    _on_timeline("second_back", QT_TR_NOOP("1 second back"), "caret-left", "Left", callback="seek_by", argument=-1.0),
    _on_timeline("second_on", QT_TR_NOOP("1 second forward"), "caret-right", "Right", callback="seek_by", argument=1.0),
    _on_timeline("tier_above", QT_TR_NOOP("Tier above"), "caret-up", "Up", callback="select_tier", argument=-1),
    _on_timeline("tier_below", QT_TR_NOOP("Tier below"), "caret-down", "Down", callback="select_tier", argument=1),
    _on_timeline(
        "timeline_larger", QT_TR_NOOP("Zoom in"), "magnifying-glass-plus", "+", "=", callback="zoom", argument=1
    ),
    _on_timeline(
        "timeline_smaller", QT_TR_NOOP("Zoom out"), "magnifying-glass-minus", "-", callback="zoom", argument=-1
    ),
    _on_timeline(
        "timeline_fit", QT_TR_NOOP("Show the whole session"), "arrows-out-line-horizontal", "F", callback="fit"
    ),
)
