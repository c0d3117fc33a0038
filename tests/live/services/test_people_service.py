"""Perception service: another scenario may require another detector."""

from dataclasses import replace

import pytest
from PySide6.QtCore import QObject
from pytestqt.qtbot import QtBot

from caris_desktop.app.composition import find_scenario
from caris_desktop.domain import intents
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ProcessSpec, RingsToRead
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.live.services.people_service import PeopleAdapters, PeopleService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import CrashRecoveryStatus
from caris_desktop.people.known import KnownPeople
from caris_desktop.people.people_store import About
from caris_desktop.people.presence import PresenceTracker
from caris_desktop.scenario.scenario_model import Scenario
from tests.live import bodies
from tests.support.service_context import context_of


def _by_model(body: ProcessSpec, scenario: Scenario) -> ProcessSpec:
    return replace(body, arguments=(scenario.perception.model,))


@pytest.mark.logs(r"live\.bus: ")
def test_inference_starts_again_for_a_scenario_that_wants_another_detector_and_for_no_other(qtbot: QtBot) -> None:
    owner, ring = QObject(), FrameRing.create(max_frame_bytes=64 * 48 * 3)
    state = LiveState(owner)
    parts = PeopleAdapters(ProcessSpec("inference", bodies.brightness), lambda: (PresenceTracker(), []), _by_model)
    service = PeopleService(
        context_of(state, Bus(state, owner), owner), parts, rings=RingsToRead((ring.name,)), who_speaks=lambda _said: ""
    )
    shipped = find_scenario("tour-guide")
    first, second = (replace(shipped, perception=replace(shipped.perception, model=name)) for name in ("one", "two"))
    service.use_scenario(first)
    service.start()
    try:
        qtbot.waitUntil(lambda: state.perception.value.model == "brightness one", timeout=30_000)
        child = service.processes()["inference"].pid
        service.use_scenario(replace(first, title="Another"))
        service.use_scenario(second)
        qtbot.waitUntil(lambda: state.perception.value.model == "brightness two", timeout=30_000)
        assert service.processes()["inference"].pid != child
    finally:
        service.stop()
        service.end()
        ring.close()


@pytest.mark.logs(r"live\.bus: ")
def test_consents_count_only_once_confirmed_after_an_interrupted_trial(qtbot: QtBot) -> None:
    owner, ring = QObject(), FrameRing.create(max_frame_bytes=64 * 48 * 3)
    state, known = LiveState(owner), KnownPeople()
    for person, kind in (("p-1", "photo"), ("p-2", "video")):
        known.describe(person, About(name=person))
        known.note_consent(person, kind, given=True)  # type: ignore[arg-type]
    known.note_consent("p-1", "video", given=True)
    parts = PeopleAdapters(ProcessSpec("inference", bodies.brightness, ("",)), lambda: (PresenceTracker(known), []))
    service = PeopleService(
        context_of(state, Bus(state, owner), owner), parts, rings=RingsToRead((ring.name,)), who_speaks=lambda _said: ""
    )

    def agreed() -> dict[str, tuple[str, ...]]:
        return {row.person_id: row.consents for row in state.everybody.value}

    before = {"p-1": ("photo", "video"), "p-2": ("video",)}
    service.use_scenario(find_scenario("tour-guide"))
    service.start()
    try:
        qtbot.waitUntil(lambda: agreed() == before, timeout=30_000)
        going_on = CrashRecoveryStatus("unconfirmed", unconfirmed=("map", "consent"))
        state.going_on.set(going_on)
        qtbot.waitUntil(lambda: agreed() == {"p-1": (), "p-2": ()})
        service.decide(intents.NoteConsent("p-1", "photo", given=True))
        qtbot.waitUntil(lambda: agreed() == {"p-1": ("photo",), "p-2": ()})
        state.going_on.set(replace(going_on, unconfirmed=("consent",)))
        service.decide(intents.NoteConsent("p-2", "face", given=True))
        qtbot.waitUntil(lambda: agreed() == {"p-1": ("photo",), "p-2": ("face",)})
        state.going_on.set(replace(going_on, unconfirmed=(), state="confirmed"))
        qtbot.waitUntil(lambda: agreed() == {"p-1": ("photo", "video"), "p-2": ("video", "face")})
    finally:
        service.stop()
        service.end()
        ring.close()
