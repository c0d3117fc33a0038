"""The console composed from its real parts, without its child processes."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pytestqt.qtbot import QtBot

from caris_desktop.app import composition
from caris_desktop.domain.events import ChatMessage, UtteranceChanged
from caris_desktop.live.console import Console
from caris_desktop.scenario.model import Scenario
from caris_desktop.study.trial import TrialDetails


def test_what_was_said_with_one_participant_is_not_told_to_the_model_about_the_next(
    qtbot: QtBot, tmp_path: Path
) -> None:
    told: list[list[str]] = []

    def note_prompt(
        _scenario: Scenario, conversation: Sequence[UtteranceChanged], _people: Sequence[str], question: str
    ) -> tuple[ChatMessage, ...]:
        told.append([event.text for event in conversation])
        return (ChatMessage("user", question),)

    scenario = composition.find_scenario("tour-guide")
    parts = composition.parts(scenario, study=composition.open_study(tmp_path / "study"), camera=None)
    console = Console(replace(parts, build_prompt=note_prompt), scenario)
    try:
        happened: list[object] = []
        console.state.event_happened.connect(happened.append)
        console.say("You told me that you sleep badly.", "typed")
        qtbot.waitUntil(lambda: any(isinstance(event, UtteranceChanged) for event in happened))
        console.ask_assistant("What now?")
        console.start_session(TrialDetails(participant="P2"))
        console.ask_assistant("What now?")
    finally:
        console.shutdown()
    assert told[0] and set(told[0]) == {"You told me that you sleep badly."}
    assert told[1] == []
