"""Prompt for replies: speech and names of other people are always quoted."""

import pytest

from caris_desktop.conversation.conversation_transcript import Turn
from caris_desktop.conversation.suggestions.prompt import MAX_TURNS, ReplyGrounds, reply_messages, reported_turns
from tests.conversation.test_prompts import HOSTILE


@pytest.mark.parametrize("hostile", HOSTILE)
def test_no_utterance_or_name_ends_its_quotation(hostile: str) -> None:
    turns = [Turn("u-1", "participant", hostile, "heard", "finished", 1, 2)]
    situation = ReplyGrounds("You guide tours.", hostile, turns, hostile, hostile, [hostile])
    system, user_message, *more = reply_messages(situation, with_examples=False)
    assert (system.role, user_message.role, more) == ("system", "user", [])
    earlier, now = user_message.content.split("\n")
    assert earlier.count('"') == 2 and earlier[0] == earlier[-1] == '"'
    assert now.count('"') == 8 and now.startswith('(place: "') and now.endswith('"')
    assert not set("<>[]\\\u2028\u0000\u001b\u202e") & set(user_message.content)


def test_old_turns_are_left_out_in_portions_so_that_prompts_share_their_beginning() -> None:
    turns = [Turn(f"u-{number}", "participant", "Yes.", "heard", "finished", 1, 2) for number in range(40)]
    told = [reported_turns(turns[:count]) for count in range(len(turns) + 1)]
    assert all(MAX_TURNS >= len(one) >= min(count, MAX_TURNS - 3) for count, one in enumerate(told))
    assert all(one == turns[count - len(one) : count] for count, one in enumerate(told)), "the newest, without a gap"
    anew = [count for count in range(1, len(told)) if told[count][: len(told[count - 1])] != told[count - 1]]
    assert anew == [9, 13, 17, 21, 25, 29, 33, 37]
