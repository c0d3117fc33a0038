"""What a photo may be asked about, and of whom."""

from dataclasses import replace
from typing import Any

import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication

from caris_desktop.app.composition import find_scenario
from caris_desktop.domain.failure import ToldFailure
from caris_desktop.live.bus import Bus
from caris_desktop.live.services.assistant import AssistantService
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.model import AssistantSettings


def assistant_with(settings: AssistantSettings, owner: QObject) -> AssistantService:
    state = LiveState(owner)
    state.close()
    nothing: Any = None
    tour = replace(find_scenario("tour-guide"), assistant=settings)
    return AssistantService(
        state, Bus(state, owner), nothing, _Parts(), asyncio_thread=nothing, speech=nothing,  # type: ignore[arg-type]
        scenario=tour, parent=owner,
    )  # fmt: skip


class _Parts:
    stream_chat = None


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (AssistantSettings(model="embedded", pictures=True), "of this program cannot see pictures"),
        (AssistantSettings(model="openai:m"), "gives no photos to a language model"),
        (AssistantSettings(model="ollama:m"), "gives no photos to a language model"),
    ],
)
def test_a_photo_goes_to_no_model_that_cannot_or_may_not_see_it(
    qapp: QApplication, settings: AssistantSettings, expected: str
) -> None:
    owner = QObject()
    service = assistant_with(settings, owner)
    with pytest.raises(ToldFailure, match=expected):
        service.check_picture()
    with pytest.raises(ToldFailure, match=expected):
        service.ask_about_photo("What is this?", "photos/0001.png", b"jpeg", "wizard")


def test_a_model_that_may_see_photos_is_asked(qapp: QApplication) -> None:
    owner = QObject()
    assistant_with(AssistantSettings(model="openai:m", pictures=True), owner).check_picture()
