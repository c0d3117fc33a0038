"""Switched-off permissions: no process, no recorded data and no connection.

``tests/ui/test_permissions.py`` tests the controls in the window, ``tests/app/test_intents.py`` the refusal of
requests; both are generated from the table of intents. Here each permission lists its further effects.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, get_args

import pytest
from PySide6.QtCore import QCoreApplication
from PySide6.QtWidgets import QApplication

from caris_desktop.app import composition
from caris_desktop.conversation.models.endpoint import ModelEndpoint
from caris_desktop.domain import intents
from caris_desktop.domain.actor import WIZARD
from caris_desktop.domain.intents import Permission
from caris_desktop.domain.sound_values import Role
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.console import Console
from caris_desktop.live.services.assistant_service import AssistantService
from caris_desktop.live.services.listening_service import ListeningService
from caris_desktop.live.services.microphone_service import MicrophoneService
from caris_desktop.live.services.sound_service import SoundService
from caris_desktop.live.services.speech_service import SpeechService
from caris_desktop.recording.recorder.recorder_messages import SetRecordingPermissions
from caris_desktop.scenario.scenario_model import Permissions, Scenario, SoundSettings
from tests.support.polling import wait_for

PERMISSIONS: tuple[Permission, ...] = get_args(Permission)
EVERYTHING = Permissions(**dict.fromkeys((each.name for each in fields(Permissions)), True))
WITH_PROCESSES = (SpeechService, MicrophoneService, SoundService, ListeningService, AssistantService)


class Child:
    """Process double without function."""

    def __init__(self, body: ProcessSpec) -> None:
        self.body = body
        self.pid = None

    def send(self, _message: object) -> bool:
        return True

    send_raw = send_raw_waiting = send

    def ask_to_end(self) -> None: ...

    def stop(self, *, grace_s: float) -> None: ...


@dataclass
class Bench:
    console: Console
    scenario: Scenario
    told_recorder: list[Any] = field(default_factory=list)

    def show(self, *off: Permission) -> None:
        permissions = replace(EVERYTHING, **dict.fromkeys(off, False))
        self.console._scenario.current = replace(self.scenario, permissions=permissions)
        self.told_recorder.clear()
        self.console._apply(self.console.scenario)

    def processes(self) -> set[str]:
        services = [service for service in self.console._services if isinstance(service, WITH_PROCESSES)]
        return {name for service in services for name in service.processes()}

    def recorded(self) -> SetRecordingPermissions:
        return next(each for each in self.told_recorder if isinstance(each, SetRecordingPermissions))

    def models(self) -> set[str]:
        return {choice.model for choice in self.console.state.assistant_setup.value.models}


@pytest.fixture
def bench(qapp: QApplication, tmp_path: Path) -> Iterator[Bench]:
    parts = composition.parts(study=composition.open_study(tmp_path / "study"))
    assert parts.assistant is not None

    def endpoint(model: str, _url: object) -> ModelEndpoint:
        host = "127.0.0.1" if model == "openai:here" else "models.example"
        return ModelEndpoint("openai", f"http://{host}:1/v1", model.partition(":")[2])

    microphone = replace(
        parts.microphone,
        participant=replace(parts.microphone.participant, chosen=lambda: "Table"),
        wizard=replace(parts.microphone.wizard, chosen=lambda: "Headset"),
    )
    parts = replace(
        parts,
        microphone=microphone,
        assistant=replace(parts.assistant, resolve_endpoint=endpoint, list_models=no_models),
    )
    tour = composition.find_scenario("tour-guide")
    tour = replace(
        tour,
        voice="computer",
        sound=SoundSettings(ear="computer", own_voice="computer"),
        assistant=replace(tour.assistant, models=("openai:here", "openai:far")),
        permissions=EVERYTHING,
    )
    console = Console(parts, tour)
    bench = Bench(console, tour)
    console._children.start = lambda body, **_: Child(body)  # type: ignore[method-assign,assignment,return-value]
    recording = console._recording
    recording._started = True
    recording._feed.request = bench.told_recorder.append  # type: ignore[method-assign,assignment]
    state = console.state
    for service in console._services:
        if isinstance(service, WITH_PROCESSES):
            service.start()
    yield bench
    recording._started = False
    state.recording.set(replace(state.recording.value, state="idle"))
    console.shutdown()


async def no_models() -> tuple[str, ...]:
    return ()


def without_process(permission: Permission, *names: str) -> Callable[[Bench], None]:
    def show(bench: Bench) -> None:
        bench.show()
        assert set(names) <= bench.processes()
        bench.show(permission)
        assert bench.processes().isdisjoint(names)
        bench.show()
        wait_for(
            lambda: QCoreApplication.processEvents() or set(names) <= bench.processes(),
            "it runs again where it is permitted again, once the panels stand",
        )

    return show


def in_recordings(permission: Permission, name: str) -> Callable[[Bench], None]:
    def show(bench: Bench) -> None:
        state = bench.console.state
        state.recording.set(replace(state.recording.value, state="recording"))
        bench.show()
        assert getattr(bench.recorded(), name) is True
        bench.show(permission)
        assert getattr(bench.recorded(), name) is False
        state.recording.set(replace(state.recording.value, state="idle"))

    return show


def no_far_model(bench: Bench) -> None:
    bench.show()
    assert {"openai:here", "openai:far"} <= bench.models()
    bench.show("cloud_models")
    assert "openai:here" in bench.models() and "openai:far" not in bench.models()


def no_face(bench: Bench) -> None:
    state = bench.console.state
    bench.show()
    wait_for(lambda: QCoreApplication.processEvents() or state.face.value.expressions, "the face")
    bench.show("face")
    assert not state.face.value.expressions and state.face_drawing.value is None


def nothing_else(_bench: Bench) -> None:
    """The permission has no effect besides its intents."""


PROOFS: dict[Permission, tuple[Callable[[Bench], None], ...]] = {
    "photos": (in_recordings("photos", "photos"),),
    "video_recording": (in_recordings("video_recording", "video"),),
    "audio_recording": (in_recordings("audio_recording", "audio"),),
    "driving": (nothing_else,),
    "assistant": (without_process("assistant", "language-model"),),
    "naming_people": (nothing_else,),
    "robot_controls": (nothing_else,),
    "transcription": (without_process("transcription", "recogniser"),),
    "own_voice": (without_process("own_voice", "own voice"),),
    "cloud_models": (no_far_model,),
    "face": (no_face,),
    "speech": (without_process("speech", "speech"),),
    "notes": (nothing_else,),
}


@pytest.mark.logs(r"live\.bus: ")
def test_without_its_permission_nothing_of_it_continues(bench: Bench) -> None:
    assert set(PROOFS) == set(PERMISSIONS), "a new permission says here what it stands for"
    for proofs in PROOFS.values():
        for proof in proofs:
            proof(bench)


@pytest.mark.logs(r"live\.bus: ")
def test_a_withdrawn_permission_refuses_before_any_service_follows(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    console = bench.console
    first, refused = console._services[0], []
    follow = first.use_scenario

    def noting(scenario: Scenario) -> None:
        refused.append(console.do(intents.TakePhoto()))
        follow(scenario)

    monkeypatch.setattr(first, "use_scenario", noting)
    strict = replace(bench.scenario, permissions=replace(EVERYTHING, photos=False))
    console._scenario._use((strict, "the text of its file"), WIZARD)
    assert refused == ["This scenario does not allow photos."]


@pytest.mark.logs(r"live\.bus: ")
def test_a_microphone_that_nothing_permitted_needs_has_no_process(bench: Bench) -> None:
    assert len([name for name in bench.processes() if "microphone" in name]) == 2
    bench.show("transcription", "own_voice", "audio_recording")
    assert [name for name in bench.processes() if "microphone" in name] == []
    assert {role: microphone.state for role, microphone in microphones(bench).items()} == {
        "participant": "off", "wizard": "off"
    }  # fmt: skip


def microphones(bench: Bench) -> dict[Role, Any]:
    state = bench.console.state
    return {"participant": state.microphone.value, "wizard": state.wizard_microphone.value}
