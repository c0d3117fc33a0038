"""Console with its real parts, without child processes."""

import asyncio
import os
import signal
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from pytestqt.qtbot import QtBot

from caris_desktop.app import composition
from caris_desktop.conversation.models.endpoint import ModelEndpoint
from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, MODEL, SCRIPT, WIZARD, Actor
from caris_desktop.domain.events import ChatMessage, GoalChanged, Problem, TrialDetails, UtteranceChanged
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import FrameRef, People, ThingBox
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.console import Console
from caris_desktop.live.services.assistant_service import AssistantService
from caris_desktop.live.services.cameras_service import CameraSelection, OwnCamera
from caris_desktop.live.services.robot_service import RobotConnection
from caris_desktop.live.status import PerceptionStatus
from caris_desktop.people.presence import PersonRow
from caris_desktop.recording.annotation.session_tiers import session_tiers
from caris_desktop.recording.measures.session_measures import measure, read_facts
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.robot.profile_model import CameraTopic, RobotProfile
from caris_desktop.scenario.scenario_model import Scenario
from tests.live import bodies


@dataclass
class Asked:
    """Console with a language model that records the questions."""

    console: Console
    prompts: list[str]

    def ask(self, qtbot: QtBot, question: str) -> str:
        before = len(self.prompts)
        assert self.console.do(intents.Ask(question)) == ""
        qtbot.waitUntil(lambda: len(self.prompts) > before)
        return self.prompts[-1]


@pytest.fixture
def asked(qtbot: QtBot, tmp_path: Path) -> Iterator[Asked]:
    prompts: list[str] = []

    async def note(_endpoint: object, messages: Sequence[ChatMessage], **_: object) -> AsyncIterator[str]:
        prompts.append("\n".join(message.content for message in messages))
        yield "Well."

    scenario = composition.find_scenario("tour-guide")
    scenario = replace(scenario, assistant=replace(scenario.assistant, model="openai:small"))
    parts = composition.parts(study=composition.open_study(tmp_path / "study"))
    parts = replace(
        parts,
        assistant=replace(
            parts.assistant,
            stream_chat=note,
            resolve_endpoint=lambda _model, _url: ModelEndpoint("openai", "http://127.0.0.1:1/v1", "small"),
        ),
    )
    console = Console(parts, scenario)
    # Only this service is needed.
    next(service for service in console._services if isinstance(service, AssistantService)).start()
    yield Asked(console, prompts)
    console.shutdown()


@pytest.mark.logs(r"live\.bus: ", r"live\.services\.recording_service: the recorder is gone")
def test_the_model_gets_no_conversation_of_an_earlier_participant(qtbot: QtBot, asked: Asked) -> None:
    utterance = UtteranceChanged(clock.now_ns(), "u-1", "participant", "I sleep badly.", "heard", "finished")
    asked.console._bus.publish(utterance)
    qtbot.waitUntil(lambda: bool(asked.console.state.transcript.value))
    assert "I sleep badly." in asked.ask(qtbot, "What now?")
    asked.console.do(intents.StartRecording(TrialDetails(participant="P2"), anyway=True))
    assert "I sleep badly." not in asked.ask(qtbot, "What now?")


@pytest.mark.logs(r"live\.bus: ", r"live\.services\.recording_service: the recorder is gone")
@pytest.mark.parametrize("actor", [WIZARD, "wizard:Ada", SCRIPT, MODEL, CONSOLE])
def test_no_actor_starts_a_recording_without_the_required_checks(qtbot: QtBot, asked: Asked, actor: Actor) -> None:
    """Requests of the gamepad and the palette are those of this wizard."""
    console, told = asked.console, list[Problem]()
    utterance = UtteranceChanged(clock.now_ns(), "u-1", "participant", "I sleep badly.", "heard", "finished")
    console._bus.publish(utterance)
    qtbot.waitUntil(lambda: bool(console.state.transcript.value))
    console.state.event_happened.connect(lambda event: told.append(event) if isinstance(event, Problem) else None)
    start = intents.StartRecording(TrialDetails(participant="P2"), actor=actor)
    refusal = console.do(start)
    waits = [check.title for check in console.state.preflight.value if check.asks_first]
    if actor == MODEL:
        assert refusal, "a model starts none at all"
    else:
        assert waits
        assert refusal == f"The recording did not start. Not ready: {', '.join(waits)}."
    assert console.state.recording.value.state == "idle"
    qtbot.waitUntil(lambda: [problem.what for problem in told] == [refusal])
    assert "I sleep badly." in asked.ask(qtbot, "What now?"), "nothing was put away for a session that is none"
    if actor == MODEL:
        return
    assert console.do(replace(start, anyway=True)) == "", "who was told of it may begin in spite of it"
    assert console.state.recording.value.state == "starting"


@pytest.mark.logs(r"live\.bus: ")
def test_the_model_gets_the_objects_of_the_cameras_once(qtbot: QtBot, asked: Asked) -> None:
    now_ns = clock.now_ns()
    for camera, labels in (("front", ("chair", "chair")), ("desk", ("chair", "dog"))):
        things = tuple(ThingBox(label, 0.0, 0.0, 5.0, 5.0, 0.9) for label in labels)
        asked.console.state.add(FrameRef(now_ns, None, camera, "", 0, 1, 64, 48))
        asked.console.state.add(People(now_ns, camera, 1, 64, 48, (), 1.0, things))
    assert 'In view: "2 chairs, 1 dog".' in asked.ask(qtbot, "What is there?")


@pytest.mark.logs(r"live\.bus: ")
def test_a_scenario_that_does_not_drive_refuses_every_way_to_move_the_robot(qtbot: QtBot, tmp_path: Path) -> None:
    scenario = composition.find_scenario("tour-guide")
    scenario = replace(scenario, permissions=replace(scenario.permissions, driving=False))
    parts = composition.parts(study=composition.open_study(tmp_path / "study"))
    console = Console(replace(parts, scenario=replace(parts.scenario, save_places=lambda changed: changed)), scenario)
    here = Pose2D(1.0, 2.0, 0.0)
    try:
        told: list[str] = []
        console.state.event_happened.connect(
            lambda event: told.append(event.what) if isinstance(event, Problem) else None
        )
        console.do(intents.GoToPoint(here))
        console.do(intents.GoToPlace(scenario.places[0].name))
        console.do(intents.SetInitialPose(here))
        console.do(intents.SavePlace("Here", here))
        console.do(intents.RemovePlace(scenario.places[0].name))
        console.do(intents.SaveMap("lab"))
        console.do(intents.LoadMap("lab"))
        console.do(intents.SetMapping(mapping=True))
        console.do(intents.LookAt(pan_rad=0.1, tilt_rad=0.0))
        console.do(intents.SetGuard(on=False))
        qtbot.waitUntil(lambda: len(told) >= 10)
        assert set(told) == {"This scenario does not allow driving."}
        assert console.state.places.value == scenario.places
        assert console.state.scenario.value == console.scenario == scenario
    finally:
        console.shutdown()


@pytest.mark.logs(r"live\.bus: The emergency stop could not be sent")
def test_a_recording_begins_with_what_is_in_progress_and_shows_what_the_closing_of_the_program_ended(
    qtbot: QtBot, tmp_path: Path
) -> None:
    async def never_answers(*_: object, **__: object) -> AsyncIterator[str]:
        yield "Well"
        await asyncio.sleep(1000.0)

    scenario = composition.find_scenario("tour-guide")
    scenario = replace(
        scenario,
        permissions=replace(scenario.permissions, audio_recording=False),
        assistant=replace(scenario.assistant, model="openai:small"),
    )
    parts = composition.parts(study=composition.open_study(tmp_path / "study"))
    parts = replace(
        parts,
        people=replace(parts.people, inference=None),
        assistant=replace(
            parts.assistant,
            stream_chat=never_answers,
            resolve_endpoint=lambda _model, _url: ModelEndpoint("openai", "http://127.0.0.1:1/v1", "small"),
        ),
    )
    console = Console(parts, scenario)
    state = console.state
    try:
        console.start()
        cancelled = GoalChanged(clock.now_ns(), "g-1", "cancelled", Pose2D(1.0, 2.0, 0.0), "Kitchen")
        state.goal.set(cancelled)
        # Persons 1 and 2 have left, 3 has a name.
        state.persons.set(
            (
                PersonRow("p-3", 5, "Ada", True, 10, 20, number=3),
                PersonRow("p-4", 6, "Person 4", True, 10, 20, number=4),
            )
        )
        console.do(intents.StartRecording(TrialDetails(participant="P1"), anyway=True))
        qtbot.waitUntil(lambda: state.recording.value.state == "recording", timeout=60_000)
        folder = Path(state.recording.value.folder)
        console.do(intents.EmergencyStop())
        console.do(intents.PauseRecording(paused=True))
        qtbot.waitUntil(lambda: state.recording.value.state == "paused", timeout=60_000)
        console.do(intents.ReleaseEmergencyStop())
        console.do(intents.PauseRecording(paused=False))
        qtbot.waitUntil(lambda: state.recording.value.state == "recording", timeout=60_000)
        console.do(intents.Ask("What is this?"))
        qtbot.waitUntil(lambda: state.assistant.value.answer == "Well", timeout=60_000)
    finally:
        console.shutdown()
    session = open_session(folder)
    (exchange,) = [event for _, event in session.values("event/llm_exchange")]
    assert (exchange.outcome, exchange.detail) == ("cancelled", "cancelled because the program closed")
    assert session.reason == "console_closed"
    appeared = [event for _, event in session.values("event/person_appeared")]
    assert [(event.person_id, event.number) for event in appeared] == 2 * [("p-3", 3), ("p-4", 4)]
    tiers = session_tiers(session)
    assert {tier.name for tier in tiers.tiers if tier.name.startswith("Person ")} == {"Person 3", "Person 4"}
    # The goal ended before the recording and is recorded once, after the pause.
    assert [event.state for _, event in session.values("event/goal_changed")] == ["cancelled"]
    assert "Navigation goals" not in {tier.name for tier in tiers.tiers}
    assert measure(read_facts(session)).of("goals") == {}
    # Its release in the pause is known afterwards, so that the next activation counts.
    emergency = [event.latched for _, event in session.values("event/emergency_stop_changed")]
    assert emergency == [True, False]


def _robot(camera: str) -> RobotConnection:
    profile = RobotProfile(camera, camera, cameras=(CameraTopic(camera, f"/{camera}"),))
    control, media = (
        ProcessSpec("control", bodies.silent_link),
        ProcessSpec("media", bodies.link_with_camera, (camera,)),
    )
    return RobotConnection(camera, "ws://127.0.0.1:9", profile, control, media)


def test_the_camera_of_another_robot_is_shown_despite_late_frames(qtbot: QtBot, tmp_path: Path) -> None:
    scenario = composition.find_scenario("tour-guide")
    parts = composition.parts(study=composition.open_study(tmp_path / "study"))
    console = Console(replace(parts, people=replace(parts.people, inference=None)), scenario)
    state = console.state
    try:
        console.connect_robot(_robot("front"))
        qtbot.waitUntil(lambda: state.frame.value is not None, timeout=20_000)
        assert state.camera.value == "front"
        shown: list[str] = []
        state.robot.changed.connect(
            # From the switch to the new robot on.
            lambda _robot: state.frame.changed.connect(lambda frame: shown.append(frame.camera))
        )
        console.connect_robot(_robot("head"))
        assert state.frame.value is None
        qtbot.waitUntil(lambda: len(shown) >= 5, timeout=20_000)
        assert set(shown) == {"head"}
        assert (state.cameras.value, state.camera.value) == (("head",), "head")
    finally:
        console.shutdown()


@pytest.mark.logs(r"live\.bus: ")
def test_a_question_that_is_too_long_is_refused_in_words(qtbot: QtBot, tmp_path: Path) -> None:
    scenario = composition.find_scenario("tour-guide")
    parts = composition.parts(study=composition.open_study(tmp_path / "study"))
    console = Console(replace(parts, people=replace(parts.people, inference=None)), scenario)
    told: list[str] = []
    console.state.event_happened.connect(lambda event: told.append(event.what) if isinstance(event, Problem) else None)
    try:
        console.do(intents.Ask("y" * 1503))
        qtbot.waitUntil(lambda: told == ["The question is 3 characters too long."])
    finally:
        console.shutdown()


def _without_models() -> Scenario:
    """The tour without models, which saves six processes."""
    scenario = composition.find_scenario("tour-guide")
    return replace(scenario, permissions=replace(scenario.permissions, assistant=False, transcription=False))


def test_a_recorded_video_is_told_to_play_once(qtbot: QtBot, tmp_path: Path) -> None:
    scenario = _without_models()
    parts = composition.parts(study=composition.open_study(tmp_path / "study"))
    notes = tmp_path / "notes"
    camera = OwnCamera("computer", ProcessSpec("camera computer", bodies.camera_that_notes, (notes,)))
    inference = ProcessSpec("inference", bodies.brightness, ("test",))
    people = replace(parts.people, inference=inference, as_configured=lambda body, _scenario: body)
    console = Console(replace(parts, people=people, cameras=lambda _scenario: CameraSelection((camera,))), scenario)
    statuses: list[PerceptionStatus] = []
    console.state.perception.changed.connect(statuses.append)
    try:
        console.start()
        qtbot.waitUntil(lambda: console.state.people.arrivals >= 30, timeout=60_000)
        assert len(notes.read_text().splitlines()) == 1, "and not with each picture in which people were looked for"
        assert len(statuses) < 15, "nor does the pace of it change with each"
    finally:
        console.shutdown()


def test_slow_work_at_the_end_is_named_while_it_runs(tmp_path: Path) -> None:
    scenario = composition.find_scenario("tour-guide")
    parts = composition.parts(study=composition.open_study(tmp_path / "study"))
    console = Console(replace(parts, people=replace(parts.people, inference=None)), scenario)
    told: list[str] = []

    def during(what: str, work: Callable[[], None]) -> None:
        told.append(what)
        work()

    console.shutdown(during)
    # Pending disk requests come before them: opening the scenario reads the face.
    assert [what.split()[0] for what in told][-2:] == ["Voice,", "The"]
    assert "recording is being completed" in told[-1]


@pytest.mark.logs(r"live\.bus: ", r"live\.child_process: camera desk ended")
def test_a_camera_whose_process_dies_is_back_and_the_other_continues(qtbot: QtBot, tmp_path: Path) -> None:
    scenario = _without_models()
    parts = composition.parts(study=composition.open_study(tmp_path / "study"))
    own = tuple(
        OwnCamera(name, ProcessSpec(f"camera {name}", bodies.link_with_camera, (name,))) for name in ("desk", "door")
    )
    people = replace(parts.people, inference=None)
    console = Console(replace(parts, people=people, cameras=lambda _scenario: CameraSelection(own)), scenario)
    state = console.state
    try:
        console.start()
        qtbot.waitUntil(lambda: sorted(state.cameras.value) == ["desk", "door"], timeout=60_000)
        for name in ("desk", "door"):
            assert console.frames.read(state.frame_of(name).value) is not None
        desk, door = (console.child_pids[f"camera {name}"] for name in ("desk", "door"))
        os.kill(desk, signal.SIGKILL)
        qtbot.waitUntil(lambda: state.state_of("desk").value is not None, timeout=30_000)
        lost = state.state_of("desk").value
        assert (lost.state, lost.detail) == ("lost", "It stopped unexpectedly.")
        qtbot.waitUntil(lambda: state.frame_of("desk").value.stamp_ns > lost.stamp_ns, timeout=60_000)
        assert console.child_pids["camera desk"] != desk
        assert console.child_pids["camera door"] == door
        assert state.frame_of("door").freshness == "fresh"
    finally:
        console.shutdown()
