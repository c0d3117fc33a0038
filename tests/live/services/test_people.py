"""The service that runs perception: another scenario may want people to be found in another way."""

from dataclasses import replace

import pytest
from PySide6.QtCore import QObject
from pytestqt.qtbot import QtBot

from caris_desktop.app.composition import find_scenario
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ProcessBody, RingsToRead
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.live.services.people import PeopleParts, PeopleService
from caris_desktop.live.state import LiveState
from caris_desktop.people.presence import Presence
from caris_desktop.scenario.model import Scenario
from tests.live import bodies


def _by_model(body: ProcessBody, scenario: Scenario) -> ProcessBody:
    return replace(body, arguments=(scenario.perception.model,))


@pytest.mark.logs(r"live\.bus: ")
def test_inference_starts_anew_for_a_scenario_that_wants_another_detector_and_for_no_other(qtbot: QtBot) -> None:
    owner, ring = QObject(), FrameRing.create(max_frame_bytes=64 * 48 * 3)
    state = LiveState(owner)
    parts = PeopleParts(ProcessBody("inference", bodies.brightness), lambda: (Presence(), []), _by_model)
    service = PeopleService(
        state, Bus(state, owner), parts, rings=RingsToRead((ring.name,)), who_speaks=lambda _said: "", parent=owner
    )
    shipped = find_scenario("tour-guide")
    first, second = (replace(shipped, perception=replace(shipped.perception, model=name)) for name in ("one", "two"))
    service.use_scenario(first)
    service.start()
    try:
        qtbot.waitUntil(lambda: state.perception.value.model == "brightness one", timeout=30_000)
        child = service.inference_pid
        service.use_scenario(replace(first, title="Another"))
        service.use_scenario(second)
        qtbot.waitUntil(lambda: state.perception.value.model == "brightness two", timeout=30_000)
        assert service.inference_pid != child
    finally:
        service.stop()
        service.end()
        ring.close()
