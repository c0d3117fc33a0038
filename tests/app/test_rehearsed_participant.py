"""Utterances of a rehearsal's participant, none of which is lost."""

import pytest

from caris_desktop.app.demo_robot import PREPARE, SAY, call_simulator
from caris_desktop.live.background_worker import AsyncioThread
from tests.support.polling import wait_for
from tests.support.simulated_robot import SimulatedRobot

SENTENCES = ["Hello.", "Yes.", "Goodbye."]


@pytest.mark.long
def test_nothing_of_what_they_are_notified_to_say_is_lost() -> None:
    thread = AsyncioThread()
    try:
        with SimulatedRobot("--empty") as robot:
            texts = [{"text": sentence} for sentence in SENTENCES]
            thread.submit(call_simulator(robot.address, PREPARE, texts))
            for text in texts:
                thread.submit(call_simulator(robot.address, SAY, [text]))

            def said() -> list[str]:
                return [each["text"] for each in robot.state()["sound"]["said"]]

            wait_for(lambda: sorted(said()) == sorted(SENTENCES), "every sentence", timeout_s=110.0)
    finally:
        thread.stop()
