"""Suggested replies: displayed while they are generated, spoken by a key or a visible countdown, recorded once."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
from PySide6.QtCore import QCoreApplication
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, MODEL, WIZARD
from caris_desktop.domain.events import LevelChanged, Marked, SuggestionChanged, UtteranceChanged, UtteranceCorrected
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import RobotPose
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE, Hearing
from caris_desktop.live.status import ProtocolStatus
from caris_desktop.people.presence import PersonRow
from caris_desktop.scenario.scenario_model import AssistanceSettings, AssistantSettings, Permissions, Place
from tests.live.services.suggestions_desk import EVERYTHING, MS, REPLIES, Desk, desk_on_its_own_clock


@pytest.fixture
def desk(qapp: QCoreApplication, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    with desk_on_its_own_clock(monkeypatch) as made:
        yield made


def test_the_first_is_shown_before_the_last_is_written(desk: Desk) -> None:
    question = desk.question()
    assert desk.state.suggestions.value.state == "asking"
    question.write('{"answer": "It stops at once.", "ask": "Shall')
    assert desk.cards == ["It stops at once."]
    desk.wait(100)
    question.answer(REPLIES)
    assert desk.cards == ["It stops at once.", "Shall we go there?", "There is a zone around it."]
    assert desk.state.suggestions.value.model == "small" and desk.state.suggestions.value.turns == 1
    assert [event.latency_ms for event in desk.of(SuggestionChanged)] == [250.0, 350.0, 350.0]
    desk.wait(5_000)
    assert desk.voice.spoken == []


def test_a_key_says_the_one_that_was_read_and_no_other(desk: Desk) -> None:
    desk.question().answer(REPLIES)
    card = desk.state.suggestions.value.cards[1]
    assert desk.do(intents.SaySuggestion(1, card.suggestion_id)) == "That suggestion is no longer available."
    assert desk.do(intents.SaySuggestion(2, card.suggestion_id)) == ""
    assert desk.do(intents.SaySuggestion(2, card.suggestion_id)) != ""
    assert desk.voice.spoken == ["Shall we go there?"]
    utterance = next(event for event in desk.of(UtteranceChanged) if event.speaker == "robot")
    assert (utterance.origin, utterance.actor) == ("suggestion", WIZARD)
    assert desk.fates() == [(2, "taken"), (1, "superseded"), (3, "superseded")]
    assert desk.of(SuggestionChanged)[3].utterance_id == utterance.utterance_id


def test_an_edited_reply_is_spoken_as_edited_and_later_as_typed(desk: Desk) -> None:
    desk.question().answer(REPLIES)
    first = desk.state.suggestions.value.cards[0]
    desk.do(intents.SayEditedSuggestion(first.suggestion_id, "It stops right away."))
    edited = next(event for event in desk.of(SuggestionChanged) if event.state == "edited")
    assert edited.edit_distance == 8 and desk.voice.spoken == ["It stops right away."]
    desk.do(intents.SayEditedSuggestion(first.suggestion_id, "And it is safe."))
    origins = [event.origin for event in desk.of(UtteranceChanged) if event.speaker == "robot"]
    assert origins == ["suggestion", "typed"], "no text of the wizard's is lost"
    assert len([event for event in desk.of(SuggestionChanged) if event.suggestion_id == first.suggestion_id]) == 2


def test_resumed_speech_ends_question_and_cards(desk: Desk) -> None:
    question = desk.question()
    question.write('{"answer": "It stops at once.",')
    desk.speak_on()
    assert question.over and desk.cards == [] and desk.fates() == [(1, "superseded")]
    question.answer(REPLIES)
    assert desk.cards == []


def test_the_history_is_read_while_the_participant_still_speaks(desk: Desk) -> None:
    desk.model.embedded = True
    desk.question("Where is the kitchen?").answer(REPLIES)
    card = desk.state.suggestions.value.cards[0]
    desk.do(intents.SaySuggestion(1, card.suggestion_id))
    utterance = next(event for event in desk.of(UtteranceChanged) if event.speaker == "robot")
    desk.publish(replace(utterance, state="started"))
    desk.speak_on()
    desk.speak_on()
    assert len(desk.model.read) == 1, "once in each turn"
    asked = desk.question("And how far is it?")
    *before, last_message = asked.messages
    *read, open_end = desk.model.read[-1]
    assert read == before and "It stops at once." in read[-1].content, "the robot's reply, which is new to the model"
    assert last_message.content == f'{open_end.content[:-1]}And how far is it?"', (
        "nothing but the words themselves is missing"
    )


def test_of_one_who_says_more_and_more_only_the_newest_words_are_still_to_be_read(desk: Desk) -> None:
    desk.model.embedded = True
    for text in ("Hello there.", "I am looking for the kitchen."):
        desk.question(text)
    desk.speak_on()
    desk.question("It must be near.")
    asked = desk.model.of("replies")[-1]
    *_, open_end = desk.model.read[-1]
    assert asked.messages[-1].content == f'{open_end.content[:-1]}It must be near."'


def test_a_model_that_is_new_reads_how_a_question_begins_where_one_may_be_asked(desk: Desk) -> None:
    desk.model.model_changed.emit()
    desk.speak_on()
    assert desk.model.read == [], "one that answers elsewhere is sent nothing before there is a question"
    desk.model.embedded = True
    desk.model.model_changed.emit()
    assert len(desk.model.read) == 1
    desk.use(assistance=AssistanceSettings("off", "off", "off"))
    desk.model.model_changed.emit()
    desk.turns += 1
    desk.speak_on()
    assert len(desk.model.read) == 1


def test_a_pause_within_a_turn_is_enough(desk: Desk) -> None:
    hearing = Hearing(desk.now_ns, ROBOT_MICROPHONE, False, "participant", "t-9", "where is", "the kitchen", revision=4)
    desk.hear(replace(hearing, silent_since_ns=desk.now_ns))
    desk.wait(150)
    assert desk.model.asked == []
    desk.wait(100)
    assert [question.told["revision"] for question in desk.model.asked] == [4]
    assert '"where is the kitchen"' in desk.model.asked[0].messages[-1].content


def test_a_pause_that_is_over_before_the_clock_is_looked_at_again_is_one(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, qtbot: QtBot
) -> None:
    def now_ns() -> int:
        """Clock of a busy computer."""
        desk.now_ns += 30 * MS
        return desk.now_ns

    monkeypatch.setattr(clock, "now_ns", now_ns)
    for number, ago_ms in enumerate((60, 90, 120, 150, 180), start=1):
        published_ns = desk.now_ns - ago_ms * MS
        desk.publish(
            UtteranceChanged(published_ns, f"t-{number}", "participant", f"Take {number}.", "heard", "finished")
        )
        qtbot.waitUntil(lambda number=number: len(desk.model.asked) == number, timeout=5_000)  # type: ignore[misc]


@pytest.mark.parametrize("told_while_written", [True, False])
def test_replies_that_were_reasoning_are_gone_and_others_are_requested(desk: Desk, *, told_while_written: bool) -> None:
    question = desk.question()
    question.write('{"answer": "I could say this.", "ask": "Or this?", "more": "')
    assert len(desk.cards) == 2
    if told_while_written:
        question.write('{"answer": "It')
    else:
        question.answer(REPLIES)
    assert desk.cards == [] and len(desk.model.of("replies")) == 2
    desk.model.of("replies")[-1].answer(REPLIES)
    assert desk.cards[0] == "It stops at once." and len(desk.cards) == 3


def test_a_correction_of_the_words_asks_again_and_one_of_the_speaker_not(desk: Desk) -> None:
    desk.question("Can it heat people?").answer(REPLIES)
    desk.publish(UtteranceCorrected(desk.now_ns, "t-1", text="Can it hurt people?"))
    assert '"Can it hurt people?"' in desk.model.of("replies")[-1].messages[-1].content
    desk.publish(UtteranceCorrected(desk.now_ns, "t-1", speaker="wizard"))
    desk.wait(1_000)
    assert desk.model.of("replies")[-1].over and len(desk.model.of("replies")) == 2


def test_the_sources_of_a_reply_are_reported(desk: Desk) -> None:
    desk.use(places=(Place("Kitchen", Pose2D(1.0, 2.0, 0.0)), Place("Door", Pose2D(9.0, 2.0, 0.0))))
    desk.state.places.set(desk.scenario.places)
    desk.state.add(RobotPose(desk.now_ns, None, Pose2D(1.2, 2.1, 0.0)))
    desk.state.persons.set((PersonRow("p-1", 4, "Person 1", True, 0, 0, number=1),))
    desk.question("Hello!").answer("{}")
    question = desk.question("What is that?")
    contents = [message.content for message in question.messages if message.role == "user"]
    assert contents[-1].endswith('(place: "Kitchen"; here: "person 1") "What is that?"') and '"Hello!"' in contents[-1]
    status = desk.state.suggestions.value
    assert (status.turns, status.place, status.person_id) == (2, "Kitchen", "p-1")


def test_names_are_shown_and_spoken_and_stay_out_of_the_record(desk: Desk) -> None:
    desk.use(assistant=AssistantSettings(model="openai:big", people="names"))
    desk.state.persons.set((PersonRow("p-1", 4, "Mara Lind", True, 0, 0, known=True),))
    question = desk.question("What is that?")
    assert "Mara Lind" in question.messages[-1].content
    assert "Mara" not in repr(question.told["recorded"])
    question.answer('["That is our robot arm, Mara Lind."]')
    assert desk.cards == ["That is our robot arm, {p-1}."]
    desk.do(intents.SaySuggestion(1, desk.state.suggestions.value.cards[0].suggestion_id))
    assert desk.voice.spoken == ["That is our robot arm, Mara Lind."]
    assert "Mara" not in repr(
        [event for event in desk.told if isinstance(event, (UtteranceChanged, SuggestionChanged))]
    )


def test_a_repeated_sentence_is_no_reply(desk: Desk) -> None:
    desk.question("It stops at once!").answer(REPLIES)
    assert desk.cards == ["Shall we go there?", "There is a zone around it."]


def test_a_model_that_is_not_there_or_fails_says_so_and_costs_nothing_else(desk: Desk) -> None:
    desk.model.there = False
    desk.finish()
    desk.wait(250)
    status = desk.state.suggestions.value
    assert (status.state, status.detail) == ("failed", "It is starting.")
    desk.model.there = True
    desk.question("And now?").fail()
    assert desk.state.suggestions.value.detail == "It is busy. Wait."
    desk.question("And now again?").answer(REPLIES)
    assert len(desk.cards) == 3


def test_a_question_that_another_model_cut_off_is_put_to_that(desk: Desk) -> None:
    desk.question().cancel("another model was chosen")
    QCoreApplication.processEvents()
    again = desk.model.of("replies")
    assert len(again) == 2
    again[1].answer(REPLIES)
    assert len(desk.cards) == 3
    desk.question("And now?").cancel("another model was chosen")
    desk.speak_on()
    QCoreApplication.processEvents()
    assert len(desk.model.of("replies")) == 3


def test_a_permitted_first_reply_is_spoken_after_a_visible_countdown(desk: Desk) -> None:
    desk.use(assistance=EVERYTHING)
    desk.question().answer(REPLIES)
    says_ns = desk.state.suggestions.value.says_ns
    assert says_ns == desk.now_ns + 2_000 * MS
    desk.wait(1_950)
    assert desk.voice.spoken == ["Let me think."]
    desk.wait(100)
    assert desk.voice.spoken == ["Let me think."], "the voice still has the filler"
    utterances = [event for event in desk.of(UtteranceChanged) if event.origin == "suggestion"]
    assert [(event.text, event.actor) for event in utterances] == [("It stops at once.", CONSOLE)]
    assert desk.fates()[0] == (1, "taken")


@pytest.mark.parametrize("veto", ["dismissed", "speaks", "level", "typed"])
def test_a_countdown_can_be_stopped(desk: Desk, veto: str) -> None:
    desk.use(assistance=replace(EVERYTHING, fillers="off"))
    desk.question().answer(REPLIES)
    desk.wait(1_000)
    match veto:
        case "dismissed":
            desk.do(intents.DismissSuggestions())
        case "speaks":
            desk.speak_on()
        case "level":
            desk.do(intents.SetLevel("replies", "suggest"))
            assert len(desk.cards) == 3
        case "typed":
            desk.publish(UtteranceChanged(desk.now_ns, "u-9", "robot", "It does.", "typed", "requested"))
    desk.wait(5_000)
    assert desk.voice.spoken == []


def test_a_filler_bridges_a_late_reply_only_where_the_scenario_lets_it(desk: Desk) -> None:
    desk.use(assistance=AssistanceSettings(fillers="suggest", filler_after_s=1.0))
    desk.finish("Why?")
    due_ns = desk.state.suggestions.value.filler_ns
    assert due_ns == desk.now_ns + 1_000 * MS
    desk.wait(3_000)
    assert desk.voice.spoken == [] and desk.state.suggestions.value.filler_ns == due_ns, "it points at the key"
    desk.use(assistance=AssistanceSettings(fillers="act", filler_after_s=1.0))
    desk.finish("Why not?")
    desk.wait(950)
    assert desk.voice.spoken == []
    desk.wait(3_000)
    utterances = [event for event in desk.of(UtteranceChanged) if event.speaker == "robot"]
    assert [(event.text, event.origin, event.actor) for event in utterances] == [("Let me think.", "filler", CONSOLE)]
    desk.finish("Well?")
    desk.wait(500)
    desk.publish(UtteranceChanged(desk.now_ns, "u-9", "robot", "Because.", "typed", "requested"))
    desk.wait(3_000)
    assert len([event for event in desk.of(UtteranceChanged) if event.origin == "filler"]) == 1, (
        "the reply came in time"
    )


def test_a_level_goes_down_and_up_again_and_never_above_the_scenarios(desk: Desk) -> None:
    assert desk.do(intents.SetLevel("replies", "act")) != ""
    assert desk.do(intents.SetLevel("actions", "suggest")) != ""
    desk.question().answer(REPLIES)
    desk.do(intents.SetLevel("replies", "off"))
    assert desk.cards == [] and desk.fates() == [(rank, "superseded") for rank in (1, 2, 3)]
    desk.finish("Anything else?")
    desk.wait(1_000)
    assert len(desk.model.asked) == 1
    assert desk.do(intents.SetLevel("replies", "suggest")) == ""
    changed = [(event.function, event.level, event.actor) for event in desk.of(LevelChanged)]
    assert changed == [("replies", "suggest", CONSOLE), ("replies", "off", WIZARD), ("replies", "suggest", WIZARD)]


def test_a_level_that_was_lowered_stays_so_when_a_place_is_saved(desk: Desk) -> None:
    desk.question().answer(REPLIES)
    desk.use(places=(Place("Kitchen", Pose2D(1.0, 2.0, 0.0)),))
    assert len(desk.cards) == 3
    desk.do(intents.SetLevel("replies", "off"))
    desk.use(places=())
    assert desk.state.levels.value.replies == "off"
    desk.use(title="Another", assistance=AssistanceSettings(countdown_s=5.0))
    assert desk.state.levels.value.replies == "suggest"


def test_the_prompt_has_the_protocol_step_or_the_last_mark(desk: Desk) -> None:
    desk.publish(Marked(desk.now_ns, "Asks a question"))
    desk.publish(Marked(desk.now_ns, "Typed wrong", "wizard_error"))
    assert '(now: "Asks a question")' in desk.question("What is that?").messages[-1].content
    desk.state.protocol.set(ProtocolStatus("robot-arm", "Robot arm", 3, 6))
    assert '(now: "Robot arm")' in desk.question("And that?").messages[-1].content
    assert desk.state.suggestions.value.doing == "Robot arm"


def test_without_the_permission_the_model_is_never_asked(desk: Desk) -> None:
    desk.use(permissions=Permissions(assistant=False), assistance=EVERYTHING)
    levels = desk.state.levels.value
    assert (levels.replies, levels.fillers, levels.actions) == ("off", "act", "off")
    desk.finish()
    desk.wait(1_000)
    assert desk.model.asked == []
    assert desk.do(intents.SetLevel("replies", "suggest")) == "This scenario does not allow the assistant."


def test_another_participant_finds_nothing_of_the_one_before(desk: Desk) -> None:
    question = desk.question()
    question.write('{"answer": "It stops at once.",')
    desk.suggestions.forget()
    assert question.over and desk.cards == [] and desk.fates() == [(1, "expired")]
    assert desk.of(SuggestionChanged)[0].actor == MODEL


def test_replies_in_a_numbered_list_are_said_without_their_numbers(desk: Desk) -> None:
    desk.question().answer("1. It stops at once.\n2) You are safe.\n3. Stay behind the line.")
    assert desk.cards == ["It stops at once.", "You are safe.", "Stay behind the line."]
