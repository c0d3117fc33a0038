"""Utterances of a rehearsal's participant, none of which is lost."""

import pytest

from caris_desktop.app.rehearse_command import RehearsedParticipant
from caris_desktop.live.background_worker import AsyncioThread
from tests.support.polling import wait_for
from tests.support.simulated_robot import SimulatedRobot

SENTENCES = ["Hello.", "Yes.", "Goodbye."]


@pytest.mark.long
def test_nothing_of_what_they_are_notified_to_say_is_lost() -> None:
    thread = AsyncioThread()
    try:
        with SimulatedRobot("--empty") as robot:
            participant = RehearsedParticipant(thread, lambda: robot.address)
            participant.prepare(SENTENCES)
            for sentence in SENTENCES:
                participant.say(sentence)

            def said() -> list[str]:
                return [each["text"] for each in robot.state()["sound"]["said"]]

            wait_for(lambda: sorted(said()) == sorted(SENTENCES), "every sentence", timeout_s=110.0)
    finally:
        thread.stop()
