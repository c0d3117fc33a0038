"""The question for replies: what others said and are called stays a quotation, whatever it is."""

import pytest

from caris_desktop.conversation.suggestions.prompt import Situation, reply_messages
from caris_desktop.conversation.transcript import Turn
from tests.conversation.test_prompts import HOSTILE


@pytest.mark.parametrize("hostile", HOSTILE)
def test_nothing_that_is_said_and_no_name_ends_its_quotation(hostile: str) -> None:
    turns = [Turn("u-1", "participant", hostile, "heard", "finished", 1, 2)]
    situation = Situation("You guide tours.", hostile, turns, hostile, hostile, [hostile])
    system, said, *more = reply_messages(situation, with_examples=False)
    assert (system.role, said.role, more) == ("system", "user", [])
    earlier, now = said.content.split("\n")
    assert earlier.count('"') == 2 and earlier[0] == earlier[-1] == '"'
    assert now.count('"') == 8 and now.startswith('(place: "') and now.endswith('"')
    assert not set("<>[]\\\u2028\u0000\u001b\u202e") & set(said.content)
