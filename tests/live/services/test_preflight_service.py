"""Preflight checks: evaluated, ticked, reset, and recorded."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from PySide6.QtWidgets import QApplication

from caris_desktop.domain import intents
from caris_desktop.domain.actor import WIZARD
from caris_desktop.domain.events import LinkChanged, LinkState, PreflightChecked, RobotChosen, SessionEnded
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.services.preflight_service import PreflightService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import DriveStatus, LinkStatus, MicrophoneStatus, PreflightCheck, RecordingStatus
from caris_desktop.scenario.scenario_model import Permissions, Scenario
from tests.support.service_context import context_of
from tests.ui.samples import TOUR

SIGNED = "by hand: Consent form signed"
STUDY = replace(
    TOUR, permissions=Permissions(audio_recording=True), preflight=("Consent form signed", "Emergency button in reach")
)


class Bench:
    def __init__(self) -> None:
        self.state = LiveState()
        self.told: list[Any] = []
        self.free_bytes = 10**12
        self.slow_work = BackgroundWorker()
        bus = SimpleNamespace(publish=self.told.append)
        self.service = PreflightService(
            context_of(self.state, bus, None, slow_work=self.slow_work),  # type: ignore[arg-type]
            disk=self.disk, microphone_chosen=lambda: True,
        )  # fmt: skip
        self.state.link.set(LinkStatus("connected", "TIAGo"))
        self.service.use_scenario(STUDY)

    def disk(self, _scenario: Scenario) -> tuple[int | None, float | None]:
        return self.free_bytes, 1e9

    def check(self, check_id: str) -> PreflightCheck:
        return next(check for check in self.state.preflight.value if check.id == check_id)

    def tick(self, done: bool = True) -> None:
        self.service.handlers()[intents.TickCheck](intents.TickCheck(SIGNED, done))

    def link(self, state: LinkState) -> None:
        self.state.link.set(replace(self.state.link.value, state=state))
        self.service.follows()[LinkChanged](LinkChanged(1, "control", state, "ws://x"))

    def speak(self) -> None:
        self.state.microphone.set(MicrophoneStatus("on", level=0.3))


@pytest.fixture
def bench(qapp: QApplication) -> Any:
    made = Bench()
    yield made
    made.service.stop()
    made.slow_work.finish(lambda _what, work: work())
    made.state.close()


def test_a_tick_says_who_and_when_and_can_be_taken_back(bench: Bench) -> None:
    bench.tick()
    signed = bench.check(SIGNED)
    assert (signed.state, signed.actor) == ("passed", WIZARD)
    assert signed.checked_ns == bench.told[-1].checked_ns
    assert (bench.told[-1].title, bench.told[-1].state, bench.told[-1].actor) == (
        "Consent form signed",
        "passed",
        WIZARD,
    )
    bench.tick(done=False)
    assert bench.check(SIGNED).state == bench.told[-1].state == "not checked"
    with pytest.raises(UserFacingError, match="does not exist or cannot be ticked"):
        bench.service.handlers()[intents.TickCheck](intents.TickCheck("robot"))


def test_changed_states_are_checked_again(bench: Bench) -> None:
    assert bench.check("emergency_stop").state == "passed"
    bench.state.drive.set(DriveStatus(emergency_stop=True))
    assert bench.check("emergency_stop").state == "major"
    assert bench.check("microphone").state == "not checked"
    bench.state.microphone.set(MicrophoneStatus("on", level=0.01))
    bench.service.evaluate()
    assert bench.check("microphone").state == "pending"
    bench.speak()
    bench.state.microphone.set(MicrophoneStatus())
    bench.service.evaluate()
    assert bench.check("microphone").state == "passed", "it was heard before it was closed"


@pytest.mark.parametrize("gone", ["lost", "closed"])
def test_a_lost_link_takes_everything_back_and_reports_it(bench: Bench, gone: LinkState) -> None:
    bench.tick()
    bench.speak()
    bench.link("trouble")
    assert bench.check(SIGNED).state == "passed", "trouble is not loss"
    bench.link(gone)
    assert bench.check(SIGNED).state == "not checked"
    assert "connection to the robot was lost" in bench.check(SIGNED).detail
    assert bench.check("robot").state == "major"
    bench.link("connected")
    assert bench.check(SIGNED).state == "not checked", "it is looked after again"
    bench.state.microphone.set(MicrophoneStatus())
    bench.service.evaluate()
    assert bench.check("microphone").state == "not checked"


def test_another_robot_is_looked_after_again(bench: Bench) -> None:
    bench.tick()
    bench.service.follows()[RobotChosen](RobotChosen(1, "pepper", "Pepper", "ws://pepper:9090"))
    assert bench.check(SIGNED).state == "not checked"
    assert "another robot" in bench.check(SIGNED).detail


def test_a_recording_begins_with_the_state_of_the_checks(bench: Bench) -> None:
    bench.state.drive.set(DriveStatus(emergency_stop=True))
    bench.tick()
    told = {event.check_id: event for event in bench.service.state_events(accepted=True)}
    assert set(told) == {check.id for check in bench.state.preflight.value}
    assert all(isinstance(event, PreflightChecked) and event.at_start for event in told.values())
    assert (told["emergency_stop"].state, told["emergency_stop"].accepted) == ("major", True)
    assert (told[SIGNED].state, told[SIGNED].actor, told[SIGNED].accepted) == ("passed", WIZARD, False)
    assert told["by hand: Emergency button in reach"].accepted, "it was not ticked, and the wizard knew"
    assert not any(event.accepted for event in bench.service.state_events(accepted=False))


def test_while_a_recording_runs_the_checks_stand_and_the_next_one_begins_again(bench: Bench) -> None:
    bench.tick()
    bench.state.recording.set(RecordingStatus("recording"))
    bench.state.drive.set(DriveStatus(emergency_stop=True))
    assert bench.check("emergency_stop").state == "passed", "as it was when the recording began"
    bench.state.recording.set(RecordingStatus("idle"))
    bench.service.follows()[SessionEnded](SessionEnded(1, "folder", "wizard"))
    assert bench.check("emergency_stop").state == "major"
    assert bench.check(SIGNED).state == "not checked"
    assert "next recording" in bench.check(SIGNED).detail


def test_another_scenario_has_checks_of_its_own(bench: Bench) -> None:
    bench.tick()
    bench.service.use_scenario(replace(STUDY, title="The same file, changed"))
    assert bench.check(SIGNED).state == "passed"
    assert STUDY.path is not None
    bench.service.use_scenario(replace(STUDY, path=STUDY.path.with_name("another.yaml")))
    assert (bench.check(SIGNED).state, bench.check(SIGNED).detail) == ("not checked", "")


def test_the_disk_is_looked_at_next_to_the_window(bench: Bench) -> None:
    assert bench.check("disk").state == "pending"
    bench.free_bytes = 10
    bench.service.start()
    bench.slow_work.finish(lambda _what, work: work())
    assert bench.check("disk").state == "major"
