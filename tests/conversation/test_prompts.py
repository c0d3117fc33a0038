"""Prompts and transcript: what a model is told, and how events become turns."""

from caris_desktop.conversation import prompts
from caris_desktop.conversation.prompts import build_messages
from caris_desktop.conversation.transcript import Turn, turns_of
from caris_desktop.domain.events import Speaker, UtteranceChanged, UtteranceState


def event(
    utterance_id: str, state: UtteranceState, text: str = "Hello.", *, at_ns: int = 0, speaker: Speaker = "robot"
) -> UtteranceChanged:
    return UtteranceChanged(at_ns, utterance_id, speaker, text, "typed", state)


def test_a_bare_question_is_one_message() -> None:
    messages = build_messages(" Where is the lab? ", system_prompt="")
    assert [(message.role, message.content) for message in messages] == [("user", "Where is the lab?")]


def test_the_model_learns_what_is_in_view() -> None:
    things = ["chair", "dog", "chair", "couch", "couch"]
    system, _ = build_messages("What is there?", system_prompt="Be brief.", people=["P1"], things=things)
    assert system.content == "Be brief.\n\nPeople here now: P1.\n\nIn view: 2 chairs, 2 couches, 1 dog."
    (bare,) = build_messages("What is there?", system_prompt="", things=[])
    assert bare.role == "user"


def test_the_model_learns_who_is_here_and_what_was_said() -> None:
    said = [
        event("u1", "requested", "Hello."),
        event("u1", "started", "Hello.", at_ns=1),
        event("u1", "finished", "Hello.", at_ns=2),
        event("u2", "finished", "Where is\nthe arm?", speaker="participant", at_ns=3),
        event("u3", "started", "It is", at_ns=4),
        event("u3", "interrupted", "It is", at_ns=5),
        event("u4", "requested", "Never said."),
        event("u5", "failed", "Not said either."),
    ]
    messages = build_messages("Answer.", system_prompt="Be brief.", conversation=said, people=["P1", " P2 ", ""])
    assert [(message.role, message.content) for message in messages] == [
        ("system", "Be brief.\n\nPeople here now: P1, P2."),
        ("assistant", "Hello."),
        ("user", "Where is the arm?"),
        ("assistant", "It is"),
        ("user", "Answer."),
    ]


def test_turns_of_one_side_are_one_message() -> None:
    said = [event("u1", "finished", "Hello."), event("u2", "finished", "Follow me.")]
    said.append(event("u3", "finished", "Wait.", speaker="participant"))
    messages = build_messages("And now?", system_prompt="", conversation=said)
    assert [(message.role, message.content) for message in messages] == [
        ("assistant", "Hello.\nFollow me."),
        ("user", "Wait.\nAnd now?"),
    ]


def test_prompts_stay_small_and_keep_the_newest() -> None:
    said = [event(f"u{number}", "finished", f"{number} " + "word " * 200) for number in range(100)]
    messages = build_messages(
        "q" * 9000, system_prompt="s" * 9000, conversation=said, people=[f"P{n}" for n in range(50)]
    )
    assert sum(len(message.content) for message in messages) < 5500
    assert "99 word" in messages[1].content
    assert "\n10 word" not in messages[1].content
    assert "P8 and 42 more" not in messages[0].content
    assert messages[0].content.endswith("P7 and 42 more.")
    assert len(messages[0].content) < prompts.MAX_SYSTEM_CHARACTERS + 500


def test_turns_carry_their_times_and_do_not_go_back() -> None:
    turns = turns_of(
        [
            event("u1", "requested", at_ns=1),
            event("u2", "requested", at_ns=2),
            event("u1", "started", at_ns=3),
            event("u1", "finished", at_ns=4),
            event("u1", "started", at_ns=5),
        ]
    )
    assert turns == (
        Turn("u1", "robot", "Hello.", "typed", "finished", started_ns=3, ended_ns=4),
        Turn("u2", "robot", "Hello.", "typed", "requested"),
    )


def test_an_utterance_silenced_before_it_began_was_not_said() -> None:
    (turn,) = turns_of([event("u1", "requested"), event("u1", "interrupted", at_ns=2)])
    assert not turn.said
