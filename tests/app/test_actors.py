"""Actor of each request: from the intent through robot, speech, model and recorder to event, file and export.

One console with its real link, recorder and simulated robot gets every request from another wizard; actions of this
computer's wizard and of the console are attributed to them.
"""

import asyncio
import csv
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

import pytest
from PySide6.QtCore import QCoreApplication
from PySide6.QtWidgets import QApplication

from caris_desktop.app import composition
from caris_desktop.conversation.models.endpoint import ModelEndpoint
from caris_desktop.domain import clock, events, intents
from caris_desktop.domain.actor import CONSOLE, MODEL, WIZARD
from caris_desktop.domain.events import TrialDetails
from caris_desktop.domain.geometry import ZERO_TWIST, Pose2D
from caris_desktop.domain.intents import INTENTS, Intent
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.console import Console
from caris_desktop.live.services.practice_service import PracticeAdapters
from caris_desktop.live.services.robot_service import RobotConnection
from caris_desktop.live.services.scenario_service import Imported
from caris_desktop.live.state import LiveValue
from caris_desktop.recording.session.session_data import read_data
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import ExportContext, export_session
from caris_desktop.robot.profile import load_profile, save_profile
from caris_desktop.scenario.scenario_model import AssistanceSettings, Scenario
from caris_desktop.study.unfinished_trial import UnfinishedTrial
from tests.live import bodies
from tests.support.crashed_trial import save_crashed_trial
from tests.support.polling import wait_for
from tests.support.simulated_robot import SimulatedRobot

pytestmark = pytest.mark.logs(r"live\.bus: ")

OTHER = "wizard:b"
HERE = Pose2D(9.0, 5.0, 0.0)
_STAYS_NS = 400_000_000
LEAVES_NOTHING = {
    intents.UseMicrophone,
    intents.TryMicrophone,
    intents.DraftSpeech,
    intents.HearRobot,
    intents.ShareScenario,
    intents.ConfirmFile,
    intents.LookUpPerson,
    intents.MoveQueued,
    intents.LeaveTrial,
    intents.BeginPractice,
    intents.AddModel,
}
"""Intents without a recorded event of their own.

The microphone in use is recorded as sound. Reading about a person, listening and testing a microphone change nothing.
Utterances are recorded when they are spoken, typed text is not. A file's permissions are settings, and its effect is
recorded. A trial that is not resumed has ended. Practice has a recording of its own.
"""

WRITTEN_ELSEWHERE = {events.PersonForgotten, events.PracticeStepEnded, events.PracticeEnded}
"""Erasure is not possible during a recording, and practice is recorded in a separate file."""


def confirmed(profile: Path) -> RobotConnection:
    """Connection as after the user's confirmation of the file's references."""
    composition.confirm_robot(str(profile), accept_named=True)
    return composition.robot_connection(str(profile))


class SavedElsewhere:
    """Implements LayoutFiles without files: there is always something to undo."""

    def save(self, scenario: Scenario, _asked: intents.SaveLayout) -> Path:
        return scenario.path or Path()

    def note_saved(self, path: Path, asked: intents.SaveLayout, *, replaced: Scenario) -> None: ...

    def as_before(self, scenario: Scenario) -> Scenario:
        return replace(scenario, title="Before")

    def reset(self, scenario: Scenario, _before: Scenario) -> Path:
        return scenario.path or Path()

    def note_reset(self, path: Path) -> None: ...


@dataclass
class Story:
    """Requests and resulting events. ``traces``: for each intent the event that names the actor, or None."""

    console: Console
    happened: list[Any] = field(default_factory=list)
    traces: dict[type[Intent], Any] = field(default_factory=dict)
    folder: Path = Path()

    def until(self, observe: Callable[[], Any], what: str, *, timeout_s: float = 60.0) -> Any:
        def look() -> Any:
            QCoreApplication.processEvents()
            return observe()

        return wait_for(look, what, timeout_s=timeout_s)

    def seen(self, kind: type[Any], since: int, **fields: Any) -> Any:
        return next(
            (
                event
                for event in self.happened[since:]
                if type(event) is kind and all(getattr(event, name) == value for name, value in fields.items())
            ),
            None,
        )

    def ask(self, intent: Intent, kind: type[Any], actor: str = OTHER, **fields: Any) -> None:
        """Request of the other wizard; an event of that kind with these fields must follow."""
        since = len(self.happened)
        assert self.console.do(replace(intent, actor=OTHER)) == "", intent
        try:
            self.traces[type(intent)] = self.until(
                lambda: self.seen(kind, since, actor=actor, **fields), f"what follows from {intent}", timeout_s=15.0
            )
        except AssertionError:
            self.traces[type(intent)] = None

    def do(self, intent: Intent, kind: type[Any], **fields: Any) -> None:
        """Request of this computer's wizard, to provide something that the other one can end or change."""
        since = len(self.happened)
        assert self.console.do(intent) == "", intent
        self.until(lambda: self.seen(kind, since, actor=WIZARD, **fields), f"what follows from {intent}")

    def hold_a_key(self, actor: str) -> Any:
        """Hold until the robot turns; press again if this machine was too busy to renew the lease."""
        since, pressed_s = len(self.happened), 0.0

        def turning() -> Any:
            nonlocal pressed_s
            if time.monotonic() - pressed_s > 0.5:
                pressed_s = time.monotonic()
                assert self.console.do(intents.Drive(0.0, 0.0, 1.0, "keyboard", actor=actor)) == ""
            commands = (event for event in self.happened[since:] if isinstance(event, events.CommandSent))
            return next((command for command in commands if command.twist.moving and command.actor == actor), None)

        return self.until(turning, f"a velocity of {actor}")


def tell(story: Story) -> None:
    """All possible requests, in a feasible order."""
    console, state, ask, do = story.console, story.console.state, story.ask, story.do
    ask(intents.EmergencyStop(), events.EmergencyStopChanged)
    # No erasure during a recording.
    stranger = story.until(lambda: state.persons.value, "somebody is here")[0].person_id
    ask(intents.ForgetPerson(stranger), events.PersonForgotten)
    story.until(lambda: state.going_on.value.state == "offered", "the trial that broke off")
    ask(intents.GoOnWithTrial(), events.TrialResumed, folder="broken-off")
    for what in get_args(intents.AsBefore):
        ask(intents.ConfirmAsBefore(what), events.ConfirmedAsBefore, what=what)
    ask(intents.StartRecording(TrialDetails(participant="P1"), anyway=True), events.SessionStarted)
    story.until(lambda: state.recording.value.state == "recording", "the recording")
    story.folder = Path(state.recording.value.folder)

    by_hand = next(check.id for check in state.preflight.value if check.manual)
    ask(intents.TickCheck(by_hand), events.PreflightChecked, state="passed")
    ask(intents.ReleaseEmergencyStop(), events.EmergencyStopChanged, latched=False)
    story.until(lambda: state.drive.value.allowed, "the robot may be driven")

    story.hold_a_key(WIZARD)
    console.do(intents.ReleaseDrive())
    story.traces[intents.Drive] = story.hold_a_key(OTHER)
    ask(intents.SetSpeed(0.5), events.NavigationSpeedChanged)
    story.hold_a_key(OTHER)
    ask(intents.ReleaseDrive(), events.CommandSent, twist=ZERO_TWIST)
    ask(intents.SetGuard(on=False), events.GuardChanged, state="overridden")
    do(intents.SetGuard(on=True), events.GuardChanged)
    ask(intents.LookAt(0.3, 0.0), events.HeadMoved)
    ask(intents.TurnHead(1.0, 0.0), events.HeadMoved)
    console.do(intents.TurnHead(0.0, 0.0))
    ask(intents.Nod(), events.HeadMoved)

    place = "Kitchen"  # the robot starts at the other end of the building
    ask(intents.GoToPlace(place), events.GoalChanged, state="requested")
    ask(intents.GoToPoint(HERE), events.GoalChanged, state="active")
    do(intents.GoToPlace(place), events.GoalChanged, state="active")
    ask(intents.CancelGoal(), events.GoalChanged, state="cancelled", place=place)
    ask(intents.SetInitialPose(HERE), events.InitialPoseSet)
    ask(intents.SaveMap("lab"), events.MapRequestChanged, state="succeeded")
    ask(intents.LoadMap("lab"), events.MapRequestChanged, state="succeeded")
    ask(intents.SetMapping(mapping=True), events.MapRequestChanged, state="succeeded")
    ask(intents.UseControl("eyes", True), events.ControlUsed, state="succeeded")
    ask(intents.SavePlace("Here", HERE), events.PlacesChanged)
    ask(intents.RemovePlace("Here"), events.PlacesChanged)

    ask(intents.Say("Hello, how are you today?", "typed"), events.UtteranceChanged, state="finished")
    utterance_id = state.transcript.value[-1].utterance_id
    ask(
        intents.CorrectUtterance(utterance_id, tags=("greeting",)), events.UtteranceCorrected, utterance_id=utterance_id
    )
    do(intents.Say("I would like to show you around.", "typed"), events.UtteranceChanged, state="started")
    for text in ("This is not said.", "Nor is this."):
        do(intents.Say(text, "typed"), events.UtteranceChanged, state="requested", text=text)
    later = state.speech.value.waiting[-1].utterance_id
    assert console.do(intents.MoveQueued(later, 0, actor=OTHER)) == ""
    ask(intents.EditQueued(later, "Nor that."), events.UtteranceChanged, text="Nor that.")
    ask(intents.CancelQueued(later), events.UtteranceChanged, state="interrupted", utterance_id=later)
    ask(intents.Silence(), events.UtteranceChanged, state="interrupted")
    ask(intents.PushToTalk(on=True), events.UtteranceChanged, origin="own_voice", state="requested")
    console.do(intents.PushToTalk(on=False))
    ask(intents.SetVoice("robot", rate=1.2), events.VoiceChanged)
    assert console.do(intents.Say("On {day}.", "typed")) == ""
    ask(intents.FillGap("Monday"), events.UtteranceChanged, WIZARD, text="On Monday.", state="finished")
    ask(intents.Ask("Short?"), events.LlmExchange, outcome="answered")
    ask(intents.SayAnswer("Yes."), events.AnswerUsed)
    assert console.do(intents.Ask("Endless?")) == ""
    story.until(lambda: state.assistant.value.answer, "the beginning of an answer")
    # The exchange belongs to the author of the question.
    ask(intents.CancelAnswer(), events.LlmExchange, WIZARD, detail="cancelled by another wizard")
    do(intents.Ask("Short?"), events.LlmExchange, outcome="answered")
    ask(intents.DismissAnswer(state.assistant.value.exchange_id), events.AnswerUsed, use="dismissed")
    ask(intents.EditPrompt("notes", "The arm is being repaired."), events.AssistantChanged, setting="notes")
    ask(intents.ChoosePrompt("style", ""), events.AssistantChanged, setting="style")
    ask(intents.ChooseModel("openai:other"), events.AssistantChanged, name="openai:other")
    ask(intents.ResetPrompts(), events.AssistantChanged, setting="reset")

    story.until(lambda: state.face.value.expressions, "the face")
    ask(intents.UseFace("lively"), events.FaceChanged, expression="friendly")
    ask(intents.KeepFace("mine", "version: 1\ntitle: Mine\n"), events.FaceChanged, expression="calm")
    ask(intents.ShowExpression("happy"), events.FaceChanged, expression="happy")
    ask(intents.ShowOnFace("text", "One moment"), events.FaceChanged, text="One moment")
    ask(intents.ShowFaceWindow(on=True), events.FaceChanged, screens=1)
    ask(intents.ServeFace(on=True), events.FaceChanged)

    tell_of_suggestions(story)

    persons = story.until(lambda: state.persons.value, "somebody is here")
    here = persons[0].person_id
    ask(intents.NamePerson(here, "Ada"), events.PersonRenamed)
    ask(intents.AttendPerson(here), events.PersonAttended)
    ask(intents.SetPersonGroup(here, "Control"), events.PersonDescribed, detail="group")
    ask(intents.TagPerson(here, ("shy",)), events.PersonDescribed, detail="tags")
    ask(intents.NotePerson(here, "Likes trains"), events.PersonDescribed, detail="note")
    ask(intents.NoteConsent(here, "photo", given=True), events.ConsentNoted)
    ask(intents.SplitPerson(here), events.PersonSplit)
    other = story.until(lambda: next((row for row in state.persons.value if row.person_id != here), None), "another")
    ask(intents.RejectPerson(other.person_id, here), events.PersonRejected)
    ask(intents.ConfirmPerson(other.person_id, here), events.PersonIdentified)
    ask(intents.UndoPeople(), events.PeopleUndone)
    ask(intents.MergePeople(other.person_id, here), events.PeopleMerged)
    ask(intents.TakePhoto(), events.PhotoTaken)
    photo = story.until(lambda: state.photos.value, "the photo")[0].file_name
    ask(intents.TagPhoto(photo, ("robot arm",)), events.PhotoTagged)
    ask(intents.DeletePhoto(photo), events.PhotoDeleted, restored=False)
    ask(intents.RestorePhoto(photo), events.PhotoDeleted, restored=True)
    ask(intents.AskAboutPhoto(photo, "Who is there?"), events.LlmExchange, outcome="answered", photo=photo)
    ask(intents.KeepLayout("{}"), events.LayoutChanged)

    ask(intents.Mark("Laughs", mark_id="m-1"), events.Marked)
    ask(intents.StretchMark("m-1"), events.Marked)
    ask(intents.EndMark("m-1"), events.Marked)
    do(intents.Mark("Confused", mark_id="m-2"), events.Marked)
    ask(intents.ChangeMark("m-2", label="Laughs"), events.Marked)
    ask(intents.WithdrawMark("m-2"), events.Marked)
    ask(intents.BeginMark("Waits"), events.Marked)
    console.problem("warning", "Something is wrong.", "", "")
    wrong = story.until(lambda: [each for each in state.alarms.value if "Something" in each.what], "an alarm")
    ask(intents.DismissAlarm(wrong[0].alarm_id), events.AlarmChanged, state="ended")
    ask(intents.AddNote("Asks twice", note_id="m-3"), events.Marked)
    ask(intents.ChangeNote("m-3", "Asks again"), events.Marked)
    ask(intents.RemoveNote("m-3"), events.Marked)
    ask(intents.RestoreNote("m-3"), events.Marked)

    ask(intents.TickItem("Visitor knows about the recording"), events.StepTicked, step_id="greet")
    ask(intents.NextStep(), events.StepEntered, step_id="invite")
    ask(intents.PreviousStep(), events.StepEntered, step_id="greet")
    ask(intents.SkipStep(), events.StepEntered, how="skipped")
    ask(intents.TakeBranch("Has no time for a tour"), events.StepEntered, step_id="farewell")
    ask(intents.GoToStep("kitchen"), events.StepEntered, how="chosen")

    ask(intents.Stop(), events.StopRequested)
    ask(intents.PauseRecording(paused=True), events.RecordingPaused)
    story.until(lambda: state.recording.value.state == "paused", "the pause")
    do(intents.PauseRecording(paused=False), events.RecordingPaused)
    story.until(lambda: state.recording.value.state == "recording", "the recording again")
    ask(intents.SaveLayout('{"panel": "video"}'), events.ScenarioOpened)
    ask(intents.ResetLayout(), events.ScenarioOpened)
    ask(intents.OpenScenario(Path("another.yaml")), events.ScenarioOpened)
    ask(intents.ImportScenario(Path("another.caris")), events.ScenarioOpened)
    ask(intents.SaveScenario("title: Another tour", console.scenario.path), events.ScenarioOpened)
    ask(intents.UseRobot("another"), events.RobotChosen)
    ask(intents.UseSimulatedRobot(), events.RobotChosen)
    ask(intents.StopRecording(), events.SessionEnded)
    story.until(lambda: state.recording.value.state == "idle", "the end of the recording")

    assert console.do(intents.BeginPractice(actor=OTHER)) == ""
    story.until(lambda: state.practice.value.state == "running", "the practice")
    ask(intents.SkipPracticeStep(), events.PracticeStepEnded, done=False)
    ask(intents.EndPractice(), events.PracticeEnded, done=0)
    story.until(lambda: state.recording.value.state == "idle", "the end of its recording")


def tell_of_suggestions(story: Story) -> None:
    """Uses of suggestions and proposals of the language model, each for another turn of a participant."""
    state, ask = story.console.state, story.ask

    def readable(value: LiveValue, of: Callable[[Any], Any]) -> Any:
        """Displayed value after a participant's next turn."""
        number, before = len(story.happened), of(value.value)
        text = f"Can you show me {number} things?"
        story.console._bus.publish(
            events.UtteranceChanged(clock.now_ns(), f"t-{number}", "participant", text, "heard", "finished")
        )

        def stays() -> Any:
            stands = of(value.value)
            # This turn dismisses the result of an earlier one, possibly only now.
            return stands if stands and stands != before and clock.now_ns() > stands.from_ns + _STAYS_NS else None

        return story.until(stays, "what the model writes, to be read")

    def card() -> str:
        return str(readable(state.suggestions, lambda status: next(iter(status.cards), None)).suggestion_id)

    def proposal() -> str:
        return str(readable(state.proposal, lambda status: status if status.proposal_id else None).proposal_id)

    ask(intents.SaySuggestion(1, card()), events.SuggestionChanged, state="taken")
    ask(intents.SayEditedSuggestion(card(), "Of course."), events.SuggestionChanged, state="edited")
    card()
    ask(intents.DismissSuggestions(), events.SuggestionChanged, state="dismissed")
    ask(intents.ConfirmProposal(proposal()), events.ProposalChanged, state="confirmed")
    ask(intents.VetoProposal(proposal()), events.ProposalChanged, state="vetoed")
    ask(intents.SetLevel("actions", "off"), events.LevelChanged)


async def answers(
    _endpoint: object, messages: Any, schema: dict[str, Any] | None = None, **_: object
) -> AsyncIterator[str]:
    if schema is not None:
        asked = "".join(filter(str.isdigit, messages[-1].content))
        yield '{"action": "photo"}' if "action" in schema["properties"] else f'{{"answer": "Yes, all {asked}."}}'
        return
    yield "Well"
    if "Endless?" in messages[-1].content:
        await asyncio.sleep(1000.0)


async def no_models() -> tuple[str, ...]:
    return ()


@pytest.fixture(scope="module")
def story(qapp: QApplication, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Story]:
    folder = tmp_path_factory.mktemp("actors")
    scenario = composition.find_scenario("tour-guide")
    scenario = replace(
        scenario,
        permissions=replace(scenario.permissions, audio_recording=False, transcription=False),
        assistance=AssistanceSettings(actions="suggest"),
        assistant=replace(scenario.assistant, model="openai:small", models=("openai:other",), pictures=True),
    )
    parts = composition.parts(study=composition.open_study(folder / "study"))
    with SimulatedRobot("--empty") as robot:
        profile = replace(load_profile("simulated"), address=robot.address)
        for name in ("another", "third"):
            save_profile(replace(profile, title=f"{name.title()} robot"), folder / f"{name}.yaml")
        headset = replace(
            parts.microphone.wizard,
            body=ProcessSpec("wizard microphone", bodies.quiet_microphone),
            chosen=lambda: "Headset",
        )
        parts = replace(
            parts,
            microphone=replace(parts.microphone, wizard=headset),
            people=replace(
                parts.people,
                inference=ProcessSpec("inference", bodies.somebody),
                as_configured=lambda body, _scenario: body,
            ),
            assistant=replace(
                parts.assistant,
                stream_chat=answers,
                list_models=no_models,
                resolve_endpoint=lambda _model, _url: ModelEndpoint("openai", "http://127.0.0.1:1/v1", "small"),
            ),
            scenario=replace(
                parts.scenario,
                load=lambda _path: replace(scenario, title="Another tour"),
                save_places=lambda changed: changed,
                save_text=lambda text, *_where: text,
                unpack=lambda path, _decided: Imported(path),
                conflicts=lambda _path: (),
                layouts=SavedElsewhere(),
            ),
            practice=PracticeAdapters(scenario.path, lambda _actor: None, lambda _seconds: None),
            robots=replace(
                parts.robots,
                connect_to=lambda name: confirmed(folder / f"{name}.yaml"),
                simulated=lambda actor: console.use_robot(lambda: confirmed(folder / "third.yaml"), actor),
            ),
        )
        broken_off = parts.session.study / "sessions" / "broken-off"
        broken_off.mkdir(parents=True)
        save_crashed_trial(parts.going_on.folder, UnfinishedTrial(broken_off))
        console = Console(parts, scenario)
        story = Story(console)
        console.state.event_happened.connect(story.happened.append)
        try:
            console.connect_robot(composition.robot_connection("simulated", address=robot.address))
            console.start()
            state = console.state
            story.until(lambda: state.drive.value.allowed and state.frame.value and state.scan.value, "the robot")
            story.until(lambda: state.mapping.value.can_save and state.pose.value, "what the robot offers")
            tell(story)
        finally:
            console.shutdown()
    yield story


@pytest.mark.parametrize("kind", INTENTS, ids=lambda kind: kind.__name__)
@pytest.mark.long("Drive")
def test_events_name_the_actor_that_requested_them(story: Story, kind: type[Intent]) -> None:
    assert (kind in story.traces) != (kind in LEAVES_NOTHING), "tell() has to ask for it, and say what follows"
    if kind not in LEAVES_NOTHING:
        assert story.traces[kind] is not None, f"nothing that followed names {OTHER}"


def test_the_file_has_it_all_and_of_everything_a_person_requested(story: Story) -> None:
    recorded = [value for _, value in open_session(story.folder).values() if hasattr(value, "actor")]
    by_other = {type(value) for value in recorded if value.actor == OTHER}
    traced = {type(event) for event in story.traces.values() if event.actor == OTHER}
    assert by_other >= traced - WRITTEN_ELSEWHERE
    asked_for = [value for value in recorded if getattr(value, "speaker", "") != "participant"]
    assert {value.actor for value in asked_for} == {OTHER, WIZARD, CONSOLE, MODEL}
    # The actor of a velocity holds the key; the actor of a mark made its last change.
    moving = [command.actor for command in recorded if isinstance(command, events.CommandSent) and command.twist.moving]
    assert {OTHER, WIZARD} <= set(moving)
    assert [mark.actor for mark in recorded if isinstance(mark, events.Marked)] == [*3 * [OTHER], WIZARD, *8 * [OTHER]]
    # The emergency stop was latched before; each change is recorded once.
    stops = [value for value in recorded if isinstance(value, events.EmergencyStopChanged)]
    assert [(stop.latched, stop.actor) for stop in stops] == [(True, OTHER), (False, OTHER)]
    # The previous state is at the start of the file, including pending questions.
    checked = [value for value in recorded if isinstance(value, events.PreflightChecked) and value.at_start]
    assert {("robot", "passed"), ("by hand: Consent form signed", "not checked")} <= {
        (check.check_id, check.state) for check in checked
    }
    # Everything was active at the start of the recording, by this computer's wizard alone.
    first = {type(value): value for value in reversed(recorded)}
    assert (first[events.ScenarioOpened].actor, first[events.RobotChosen].actor) == (WIZARD, WIZARD)


def test_the_file_has_the_protocol_from_its_head_on(story: Story) -> None:
    session = open_session(story.folder)
    opened = next(value for _, value in session.values("event/protocol_opened"))
    assert opened.steps[0].step_id == "greet" and opened.stamp_ns <= session.started_ns + 1_000_000_000
    data = read_data(session)
    visits, steps = data.step_visits, data.steps
    assert [(visit.step_id, visit.how, visit.left) for visit in visits[:6]] == [
        ("greet", "started", "next"), ("invite", "next", "back"), ("greet", "back", "skipped"),
        ("invite", "skipped", "branch"), ("farewell", "branch", "chosen"), ("kitchen", "chosen", ""),
    ]  # fmt: skip
    assert visits[0].actor == OTHER, "whoever began the recording"
    greet = steps[0]
    assert (greet.visits, greet.skipped, greet.ticked) == (1, 1, 1)
    assert len(visits) == 6, "the same file with another title leaves the wizard in their step"


def test_each_suggestion_that_was_displayed_has_one_fate_in_the_file(story: Story) -> None:
    session = open_session(story.folder)
    told = [value for _, value in session.values("event/suggestion_changed")]
    displayed = Counter(event.suggestion_id for event in told if event.state == "displayed")
    assert displayed == Counter(event.suggestion_id for event in told if event.state != "displayed")
    replies = read_data(session).suggestions
    assert len(replies) == len(displayed) and all(reply.told for reply in replies)
    assert {"taken", "edited", "dismissed"} <= {reply.fate for reply in replies}


def test_tables_and_tiers_name_the_actor_only_where_names_are_requested(story: Story, tmp_path: Path) -> None:
    export_session(story.folder, "csv", tmp_path / "named", ExportContext(with_names=True))
    export_session(story.folder, "csv", tmp_path / "csv")
    export_session(story.folder, "eaf", tmp_path / "eaf", ExportContext(with_names=True))

    def actors(folder: str, table: str) -> list[str]:
        """Actors in a table, without participants, who have none, and without the console, which requests
        suggestions.
        """
        with (tmp_path / folder / f"{table}.csv").open(encoding="utf-8", newline="") as file:
            return [row["actor"] for row in csv.DictReader(file) if row["actor"] not in ("", CONSOLE)]

    assert actors("named", "event_stop_requested") == [OTHER]
    assert actors("csv", "event_stop_requested") == ["wizard:another"]
    assert [actors("named", table) for table in ("utterances", "goals", "answers", "marks")] == [
        [OTHER, WIZARD, WIZARD, WIZARD, OTHER, WIZARD, OTHER, OTHER, OTHER],
        [OTHER, OTHER, WIZARD],
        [OTHER, WIZARD, WIZARD, OTHER],
        [OTHER, OTHER, OTHER],
    ]
    for path in (tmp_path / "csv").iterdir():
        assert OTHER not in path.read_text(encoding="utf-8").replace("wizard:another", ""), path.name
    eaf = (tmp_path / "eaf" / f"{story.folder.name}.eaf").read_text(encoding="utf-8")
    assert f"Stop requested (by {OTHER})" in eaf
    assert f"set by {OTHER}" in eaf
