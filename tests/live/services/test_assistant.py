"""What the language model is told of who is here, and what the record has of that."""

from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import QObject
from pytestqt.qtbot import QtBot

from caris_desktop.app import composition
from caris_desktop.conversation.language_models import ModelEndpoint
from caris_desktop.domain.events import ChatMessage, LlmExchange
from caris_desktop.domain.intents import Ask
from caris_desktop.live.asyncio_thread import AsyncioThread
from caris_desktop.live.bus import Bus
from caris_desktop.live.children import Children
from caris_desktop.live.services.assistant import AssistantService
from caris_desktop.live.speech_queue import SpeechQueue
from caris_desktop.live.state import LiveState
from caris_desktop.people.presence import PersonRow
from caris_desktop.scenario.model import AssistantPeople

HERE = (
    PersonRow(
        "p-1", 1, "Wilhelmina", True, 0, 0, number=3, known=True, group="Control", tags=("tall",),
        note="Likes trains", summary="was here once before",
    ),
    PersonRow("p-2", 2, "Person 4", True, 0, 0, number=4),
)  # fmt: skip


@pytest.mark.parametrize(
    ("people", "naming", "wanted"),
    [
        ("numbers", True, "person 3, person 4."),
        ("names", True, "Wilhelmina, person 4."),
        (
            "history",
            True,
            "Wilhelmina (group Control; tall; Likes trains; was here once before), person 4.",
        ),
        ("history", False, "person 3, person 4."),
    ],
)
def test_the_model_is_told_what_the_scenario_allows_and_the_record_numbers_alone(
    qtbot: QtBot, tmp_path: Path, people: AssistantPeople, naming: bool, wanted: str
) -> None:
    asked: list[Any] = []

    async def answer(_endpoint: object, messages: Any, **_: object) -> AsyncIterator[str]:
        asked.append(messages)
        yield "Yes."

    owner, asyncio_thread = QObject(), AsyncioThread()
    state = LiveState(owner)
    bus = Bus(state, owner)
    parts = replace(
        composition.parts(study=composition.open_study(tmp_path / "study")).assistant,
        stream_chat=answer,
        resolve_endpoint=lambda _model, _url: ModelEndpoint("openai", "http://127.0.0.1:1/v1", "small"),
    )
    scenario = composition.find_scenario("tour-guide")
    scenario = replace(
        scenario,
        permissions=replace(scenario.permissions, naming_people=naming),
        assistant=replace(scenario.assistant, model="openai:small", people=people),
    )
    service = AssistantService(
        state, bus, Children(bus, owner), parts,
        asyncio_thread=asyncio_thread, speech=SpeechQueue(state, {}, bus.publish, owner), scenario=scenario,
        parent=owner,
    )  # fmt: skip
    told: list[LlmExchange] = []
    bus.tap(lambda event, _raw: told.append(event), (LlmExchange,))
    try:
        service.use_scenario(scenario)
        service.start()
        state.persons.set(HERE)
        service.handlers()[Ask](Ask("Who is here?"))
        qtbot.waitUntil(lambda: bool(told), timeout=10_000)
    finally:
        service.stop()
        service.end()
        asyncio_thread.stop()
        state.close()
        bus.end()
    (messages,) = asked
    assert here(messages) == wanted
    assert here(told[0].messages) == "person 3, person 4."
    assert "Wilhelmina" not in repr(told)


def here(messages: tuple[ChatMessage, ...]) -> str:
    return messages[0].content.rpartition("People here now: ")[2]
