"""Table of intents and the console: each request passes the gate, and each refusal is a sentence.

Generated from the table: a new intent is tested without a change here, once it has a sample.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import get_args

import pytest
from PySide6.QtCore import QCoreApplication
from PySide6.QtWidgets import QApplication

from caris_desktop.app import composition
from caris_desktop.domain import intents
from caris_desktop.domain.actor import CONSOLE, MODEL, SCRIPT, WIZARD
from caris_desktop.domain.control_definitions import CallService, RobotControl
from caris_desktop.domain.events import Problem, TrialDetails
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.intents import INTENTS, Intent, Permission
from caris_desktop.live.console import Console
from caris_desktop.live.gate import Gate
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import CrashRecoveryStatus
from caris_desktop.scenario.scenario_model import Permissions
from tests.support.polling import wait_for

HERE = Pose2D(1.0, 2.0, 0.0)
WAVE = RobotControl("wave", "Wave", "button", CallService("/wave", "std_srvs/Trigger", {}))
LIGHT = RobotControl("light", "Light", "button", CallService("/light", "std_srvs/Trigger", {}), moves=False)
SAMPLES: tuple[Intent, ...] = (
    intents.Drive(1.0, 0.0, 0.0, "keyboard"),
    intents.ReleaseDrive(),
    intents.SetSpeed(0.5),
    intents.Stop(),
    intents.EmergencyStop(),
    intents.ReleaseEmergencyStop(),
    intents.SetGuard(on=False),
    intents.LookAt(0.1, 0.0),
    intents.TurnHead(1.0, 0.0),
    intents.Nod(),
    intents.GoToPlace("Kitchen"),
    intents.GoToPoint(HERE),
    intents.CancelGoal(),
    intents.SetInitialPose(HERE),
    intents.SavePlace("Here", HERE),
    intents.RemovePlace("Kitchen"),
    intents.SaveMap("lab"),
    intents.LoadMap("lab"),
    intents.SetMapping(mapping=True),
    intents.UseControl("wave", True),
    intents.UseRobot("simulated"),
    intents.UseSimulatedRobot(),
    intents.Say("Hello", "typed"),
    intents.DraftSpeech("Hello there."),
    intents.FillGap("Ada"),
    intents.MoveQueued("u-1", 0),
    intents.EditQueued("u-1", "Hello"),
    intents.CancelQueued("u-1"),
    intents.Silence(),
    intents.SetVoice("computer", rate=1.2),
    intents.PushToTalk(on=True),
    intents.HearRobot(on=True),
    intents.UseMicrophone(None),
    intents.CorrectUtterance("u-1", text="Hello"),
    intents.Ask("What now?"),
    intents.CancelAnswer(),
    intents.SayAnswer("This."),
    intents.DismissAnswer("x-1"),
    intents.AskAboutPhoto("photos/0001.png", "What is this?"),
    intents.AddModel(Path("model.gguf")),
    intents.ChooseModel("embedded"),
    intents.ChoosePrompt("style", "Formal"),
    intents.EditPrompt("notes", "The arm is being repaired."),
    intents.ResetPrompts(),
    intents.UseFace("calm"),
    intents.KeepFace("mine", "version: 1\ntitle: Mine\n"),
    intents.ShowExpression("calm"),
    intents.ShowOnFace("text", "Back in a moment"),
    intents.ShowFaceWindow(on=False),
    intents.ServeFace(on=False),
    intents.SaySuggestion(1, "s-1"),
    intents.SayEditedSuggestion("s-1", "Hello there"),
    intents.DismissSuggestions(),
    intents.ConfirmProposal("a-1"),
    intents.VetoProposal("a-1"),
    intents.SetLevel("replies", "suggest"),
    intents.NamePerson("p-1", "Ada"),
    intents.AttendPerson("p-1"),
    intents.ConfirmPerson("p-1", "p-2"),
    intents.RejectPerson("p-1", "p-2"),
    intents.SetPersonGroup("p-1", "Control"),
    intents.TagPerson("p-1", ("shy",)),
    intents.NotePerson("p-1", "Likes trains"),
    intents.MergePeople("p-1", "p-2"),
    intents.SplitPerson("p-1"),
    intents.NoteConsent("p-1", "photo", given=True),
    intents.UndoPeople(),
    intents.LookUpPerson("p-1", "arm"),
    intents.ForgetPerson("p-1"),
    intents.StartRecording(TrialDetails(), anyway=True),
    intents.StopRecording(),
    intents.PauseRecording(paused=True),
    intents.TakePhoto(),
    intents.TagPhoto("photos/0001.png", ("robot arm",)),
    intents.DeletePhoto("photos/0001.png"),
    intents.RestorePhoto("photos/0001.png"),
    intents.KeepLayout("{}"),
    intents.SaveLayout('{"panel": "video"}'),
    intents.ResetLayout(),
    intents.OpenScenario(Path("tour-guide.yaml")),
    intents.SaveScenario("title: A", Path("a.yaml")),
    intents.ImportScenario(Path("a.caris")),
    intents.ConfirmFile("a" * 64, accepted=True),
    intents.ShareScenario(Path("a.caris")),
    intents.DismissAlarm("a-1"),
    intents.GoOnWithTrial(),
    intents.LeaveTrial(),
    intents.ConfirmAsBefore("people"),
    intents.TickCheck("by hand: Consent form signed"),
    intents.TryMicrophone(),
    intents.Mark("Laughs"),
    intents.BeginMark("Laughs"),
    intents.StretchMark("m-1"),
    intents.EndMark("m-1"),
    intents.ChangeMark("m-1", label="Laughs"),
    intents.WithdrawMark("m-1"),
    intents.AddNote("Asks twice #confused"),
    intents.ChangeNote("m-1", "Asks twice"),
    intents.RemoveNote("m-1"),
    intents.RestoreNote("m-1"),
    intents.NextStep(),
    intents.PreviousStep(),
    intents.SkipStep(),
    intents.TakeBranch("Wants to leave"),
    intents.GoToStep("greet"),
    intents.TickItem("Visitor knows about the recording"),
    intents.BeginPractice(),
    intents.SkipPracticeStep(),
    intents.EndPractice(),
)
_NAMES = [type(sample).__name__ for sample in SAMPLES]


@dataclass
class Bench:
    """Console with service doubles that record requests."""

    console: Console
    done: list[Intent]
    sent: list[object]

    def connected(self) -> None:
        state = self.console.state
        state.link.set(replace(state.link.value, state="connected"))
        state.drive.set(replace(state.drive.value, emergency_stop=False, driver=""))
        state.controls.set((WAVE, LIGHT))
        self.done.clear()
        self.sent.clear()

    def permit(self, **permissions: bool) -> None:
        everything = Permissions(**dict.fromkeys((each.name for each in fields(Permissions)), True))
        self.console._scenario.current = replace(self.console.scenario, permissions=replace(everything, **permissions))


@pytest.fixture(scope="module")
def shared_bench(qapp: QApplication, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    scenario = composition.find_scenario("tour-guide")
    study = composition.open_study(tmp_path_factory.mktemp("gate") / "study")
    console = Console(composition.parts(study=study), scenario)
    bench = Bench(console, [], [])
    bench.console._handlers = dict.fromkeys(console._handlers, bench.done.append)
    console._robot.send = lambda command: not bench.sent.append(command)  # type: ignore[method-assign]
    # Its background thread, and work of the first event loop pass, belong to no single test.
    told: list[None] = []
    console._slow_work.do(lambda: None, told.append, pytest.fail)
    wait_for(lambda: QCoreApplication.processEvents() or told, "the thread for slow work")
    yield bench
    console.shutdown()


@pytest.fixture
def bench(shared_bench: Bench) -> Iterator[Bench]:
    shared_bench.permit()
    shared_bench.connected()
    yield shared_bench
    state = shared_bench.console.state
    state.going_on.set(CrashRecoveryStatus())
    state.link.set(replace(state.link.value, state="closed"))


def is_a_sentence(words: str) -> bool:
    return bool(re.fullmatch(r"[A-Z][^_{}]*\.", words))


def words_for(asked: Intent) -> str:
    """Subject of a refusal: the title for a control."""
    return "Using “Wave”" if isinstance(asked, intents.UseControl) else INTENTS[type(asked)].words


def test_the_words_of_every_intent_are_the_subject_of_a_sentence() -> None:
    unfit = [spec.words for spec in INTENTS.values() if not re.fullmatch(r"[A-Z][a-z]+ing( [a-z' ]+)?", spec.words)]
    assert unfit == []
    assert len({spec.words for spec in INTENTS.values()}) == len(INTENTS), "no two are called the same"


def test_every_intent_has_a_line_of_the_table_a_handler_and_a_sample(bench: Bench) -> None:
    declared = [each for each in vars(intents).values() if isinstance(each, type) and issubclass(each, Intent)]
    assert set(INTENTS) == set(declared) - {Intent}
    assert set(bench.console._handlers) == set(INTENTS)
    assert [type(sample) for sample in SAMPLES] == list(INTENTS)
    assert {each.name for each in fields(Permissions)} == set(get_args(Permission))


@pytest.mark.parametrize("asked", SAMPLES, ids=_NAMES)
def test_permitted_and_possible_intents_run(bench: Bench, asked: Intent) -> None:
    assert bench.console.do(asked) == ""
    assert bench.done == [asked]


@pytest.mark.logs(r"live\.bus: ")
@pytest.mark.parametrize("asked", SAMPLES, ids=_NAMES)
def test_without_its_permission_it_is_refused(bench: Bench, asked: Intent) -> None:
    for permission in get_args(Permission):
        bench.done.clear()
        bench.permit(**{permission: False})
        needed = permission in INTENTS[type(asked)].permissions and not asked.reduces_motion
        refused = bench.console.do(asked)
        assert is_a_sentence(refused) if needed else refused == "", permission
        assert bench.done == ([] if needed else [asked]), permission
    assert bench.sent == []


@pytest.mark.logs(r"live\.bus: ")
def test_dictation_becomes_text_and_its_end_is_never_refused(bench: Bench) -> None:
    dictate = intents.PushToTalk(on=True, to="dictation")
    bench.permit(own_voice=False)
    assert bench.console.do(dictate) == ""
    bench.permit(transcription=False)
    assert bench.console.do(dictate) == "This scenario does not allow transcription."
    assert bench.console.do(replace(dictate, on=False)) == ""
    bench.permit(speech=False)
    assert bench.console.do(dictate) == "This scenario does not allow robot speech."


@pytest.mark.logs(r"live\.bus: ")
@pytest.mark.parametrize("asked", SAMPLES, ids=_NAMES)
def test_under_the_emergency_stop_nothing_that_moves_is_done(bench: Bench, asked: Intent) -> None:
    state = bench.console.state
    state.drive.set(replace(state.drive.value, emergency_stop=True))
    bench.sent.clear()
    moves = (INTENTS[type(asked)].moves or isinstance(asked, intents.UseControl)) and not asked.reduces_motion
    refused = bench.console.do(asked)
    assert refused == (f"{words_for(asked)} is not possible: the emergency stop is active." if moves else "")
    assert bench.done == ([] if moves else [asked])
    assert bench.sent == []


@pytest.mark.logs(r"live\.bus: ")
def test_a_language_model_requests_nothing_automatically(bench: Bench) -> None:
    for asked in SAMPLES:
        refused = bench.console.do(replace(asked, actor=MODEL))
        assert refused.endswith(" is not possible: a language model cannot do this directly."), asked
    assert bench.done == [] and bench.sent == []


@pytest.mark.logs(r"live\.bus: ")
@pytest.mark.parametrize("asked", SAMPLES, ids=_NAMES)
def test_nothing_is_recorded_before_what_may_have_changed_is_confirmed(bench: Bench, asked: Intent) -> None:
    """After a crash, for every actor and key."""
    state, needed = bench.console.state, INTENTS[type(asked)].confirmed
    for what in get_args(intents.AsBefore):
        state.going_on.set(CrashRecoveryStatus("unconfirmed", unconfirmed=(what,)))
        bench.done.clear()
        refused = bench.console.do(asked)
        assert is_a_sentence(refused) if what in needed else refused == "", what
        assert bench.done == ([] if what in needed else [asked]), what
    for state_of_trial in ("offered", "confirmed"):
        state.going_on.set(CrashRecoveryStatus(state_of_trial))
        assert bench.console.do(asked) == ""
    assert needed == get_args(intents.AsBefore) or not isinstance(asked, intents.StartRecording)


@pytest.mark.logs(r"live\.bus: ")
@pytest.mark.parametrize("asked", SAMPLES, ids=_NAMES)
def test_while_one_drives_the_base_is_refused_to_others_but_this_computers_wizard(bench: Bench, asked: Intent) -> None:
    state = bench.console.state
    base = (INTENTS[type(asked)].moves == "base" or isinstance(asked, intents.UseControl)) and not asked.reduces_motion
    for driver, who in ((WIZARD, "the wizard"), ("wizard:b", "another wizard"), (SCRIPT, "a script")):
        state.drive.set(replace(state.drive.value, driver=driver))
        for actor in (WIZARD, "wizard:a", "wizard:b", SCRIPT, CONSOLE):
            refuses = base and actor not in (driver, WIZARD)
            bench.done.clear()
            refused = bench.console.do(replace(asked, actor=actor))
            what = f"{words_for(asked)} is not possible: {who} is driving manually."
            assert refused == (what if refuses else ""), (driver, actor)
            assert bench.done == ([] if refuses else [replace(asked, actor=actor)]), (driver, actor)
    assert bench.sent == []


def test_a_light_is_no_motion(bench: Bench) -> None:
    state = bench.console.state
    state.drive.set(replace(state.drive.value, emergency_stop=True))
    assert bench.console.do(intents.UseControl("light", True)) == ""


@pytest.mark.logs(r"live\.bus: ")
@pytest.mark.parametrize("asked", SAMPLES, ids=_NAMES)
def test_without_a_link_nothing_is_asked_of_the_robot(bench: Bench, asked: Intent) -> None:
    state = bench.console.state
    needs = INTENTS[type(asked)].needs_link and not asked.reduces_motion
    for link in ("connecting", "trouble", "lost", "closed"):
        state.link.set(replace(state.link.value, state=link))
        bench.done.clear()
        bench.sent.clear()
        refused = bench.console.do(asked)
        assert refused == (f"{words_for(asked)} is not possible: the robot is not connected." if needs else ""), link
        assert bench.done == ([] if needs else [asked]), link
        assert bench.sent == [], link


def test_a_replay_does_nothing_but_stop_the_live_robot(qapp: QApplication) -> None:
    gate = Gate(LiveState(), Permissions, replay=True)
    refusals = {type(asked): gate.refusal(asked) for asked in SAMPLES}
    done = {kind for kind, refusal in refusals.items() if refusal is None}
    assert done == {intents.Stop, intents.EmergencyStop, intents.ReleaseDrive}
    assert {refusal.what for refusal in refusals.values() if refusal is not None} == {"This is a replay."}


@pytest.mark.logs(r"live\.bus: ")
def test_a_value_that_cannot_be_is_refused(bench: Bench) -> None:
    for asked in SAMPLES:
        for name, (least, greatest) in INTENTS[type(asked)].bounds.items():
            for value in (least - 0.1, greatest + 0.1, float("nan"), float("inf")):
                refused = bench.console.do(replace(asked, **{name: value}))
                assert refused == f"{words_for(asked)} is not possible: {value:g} is out of range for {name}.", asked
    assert bench.done == [] and bench.sent == []


@pytest.mark.logs(r"live\.bus: ")
def test_the_wizard_is_notified_of_a_refusal_but_not_while_a_key_is_held(bench: Bench, qapp: QApplication) -> None:
    told: list[object] = []
    bench.console.state.event_happened.connect(told.append)
    bench.permit(driving=False)
    assert bench.console.do(intents.Drive(1.0, 0.0, 0.0, "keyboard"))
    assert bench.console.do(intents.GoToPlace("Kitchen")) == "This scenario does not allow driving."
    qapp.processEvents()
    assert [event.what for event in told if isinstance(event, Problem)] == ["This scenario does not allow driving."]


def test_a_language_model_may_propose_no_driving_no_release_and_nothing_about_its_own_rights() -> None:
    proposable = {kind.__name__ for kind, spec in INTENTS.items() if spec.proposable}
    assert proposable == {"LookAt", "Nod", "GoToPlace", "GoToPoint", "UseControl", "Say", "TakePhoto", "ShowExpression"}
