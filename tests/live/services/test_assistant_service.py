"""Requests to the assistant: model, text, images and context."""

from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import QObject
from pytestqt.qtbot import QtBot

from caris_desktop.app.composition import find_scenario
from caris_desktop.conversation.conversation_transcript import Turn
from caris_desktop.conversation.embedded_server import EmbeddedFailed, EmbeddedReady, ModelAdded
from caris_desktop.conversation.models.endpoint import ModelEndpoint, resolve_endpoint
from caris_desktop.domain import intents
from caris_desktop.domain.events import AnswerUsed, AssistantChanged, ChatMessage, LlmExchange, Marked, Problem
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.intents import PromptPart
from caris_desktop.domain.plugins import Plugin, PluginCall, PluginFailed
from caris_desktop.live.background_worker import AsyncioThread
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.services.assistant_service import AssistantAdapters, AssistantService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import AssistantSetup, AssistantStatus, ExchangeStatus, ProtocolStatus
from caris_desktop.people.presence import PersonRow
from caris_desktop.scenario.scenario_model import AssistantSettings, NamedText
from tests.support.service_context import context_of

SETTINGS = AssistantSettings(
    model="ollama:small",
    models=("openai:large",),
    system_prompt="You are a guide.",
    roles=(NamedText("Expert", "You know every robot."),),
    styles=(NamedText("Short", "Use ten words."), NamedText("Formal", "Be formal.")),
    notes="The arm is being repaired.",
    people="names",
)
NOBODY: Any = None


class NothingToSay:
    """Speech queue, for a text without words."""

    def say(self, _text: str, _origin: str, _actor: str) -> str:
        return ""


SERVER = ProcessSpec("language-model", lambda *_: None)
ADDITION = ProcessSpec("model-addition", lambda *_: None)


class Child:
    """A started process; the test sends its messages."""

    def __init__(self, body: ProcessSpec, ended: Any, on_message: Any) -> None:
        self.body, self.send, self._ended = body, on_message, ended
        self.running = True

    def die(self) -> None:
        self.running = False
        self._ended(self)

    def ask_to_end(self) -> None:
        self.running = False

    kill = ask_to_end


class Children:
    def __init__(self) -> None:
        self.started: list[Child] = []

    def start(self, body: ProcessSpec, *, ended: Any, on_message: Any, **_reads: object) -> Child:
        self.started.append(Child(body, ended, on_message))
        return self.started[-1]

    def dismiss(self, child: Child, *, grace_s: float, **_then: object) -> None:
        child.ask_to_end()


class Desk:
    """The service with a model that answers at once and records the questions."""

    def __init__(self, asyncio_thread: AsyncioThread, settings: AssistantSettings, **permissions: bool) -> None:
        self.owner = QObject()
        self.state = LiveState(self.owner)
        self.state.close()
        self.children = Children()
        self.asked: list[tuple[ModelEndpoint, Sequence[ChatMessage], dict[str, Any]]] = []
        self.published: list[Any] = []
        self.listed: tuple[str, ...] = ("ollama:found", "ollama:passed-on:cloud")
        bus = Bus(self.state, self.owner)
        bus.publish = self.published.append  # type: ignore[method-assign,assignment]
        tour = find_scenario("tour-guide")
        self.scenario = replace(tour, assistant=settings, permissions=replace(tour.permissions, **permissions))
        parts = AssistantAdapters(SERVER, ADDITION, self._stream, lambda model, url: resolve_endpoint(
            model, embedded_url=url, environment={}
        ), self._list)  # fmt: skip
        self.service = AssistantService(
            context_of(self.state, bus, self.owner, children=self.children), parts, asyncio_thread=asyncio_thread,
            speech=NOBODY, scenario=self.scenario,
        )  # fmt: skip
        self.service.client._ask_version = _no_version

    async def _stream(
        self, endpoint: ModelEndpoint, messages: Sequence[ChatMessage], **given: Any
    ) -> AsyncIterator[str]:
        self.asked.append((endpoint, messages, given))
        yield "Well."

    async def _list(self) -> tuple[str, ...]:
        return self.listed

    def do(self, intent: Any) -> None:
        self.service.handlers()[type(intent)](intent)

    @property
    def setup(self) -> AssistantSetup:
        setup: AssistantSetup = self.state.assistant_setup.value
        return setup

    @property
    def rows(self) -> tuple[ExchangeStatus, ...]:
        status: AssistantStatus = self.state.assistant.value
        return status.exchanges

    @property
    def prompt(self) -> str:
        """The complete last prompt."""
        return "\n".join(f"{message.role}: {message.content}" for message in self.asked[-1][1])


async def _no_version(_endpoint: ModelEndpoint, *, local_only: bool) -> str:
    return ""


@pytest.fixture
def new_desk(qtbot: QtBot) -> Iterator[Callable[..., Desk]]:
    thread = AsyncioThread()
    desks: list[Desk] = []

    def new(settings: AssistantSettings = SETTINGS, **permissions: bool) -> Desk:
        desks.append(Desk(thread, settings, **permissions))
        desks[-1].service.start()
        return desks[-1]

    yield new
    for desk in desks:
        desk.service.stop()
    thread.stop()


def answered(desk: Desk, qtbot: QtBot, asked: intents.Ask) -> LlmExchange:
    desk.do(asked)
    qtbot.waitUntil(lambda: not desk.rows[0].is_pending)
    exchange = desk.published[-1]
    assert isinstance(exchange, LlmExchange)
    return exchange


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (AssistantSettings(model="embedded", pictures=True), "embedded language model cannot process pictures"),
        (AssistantSettings(model="openai:m"), "does not allow sending pictures to a language model"),
        (AssistantSettings(model="ollama:m"), "does not allow sending pictures to a language model"),
    ],
)
def test_a_picture_goes_to_no_model_that_cannot_or_may_not_see_it(
    qtbot: QtBot, settings: AssistantSettings, expected: str
) -> None:
    desk = Desk(NOBODY, settings)
    with pytest.raises(UserFacingError, match=expected):
        desk.do(intents.Ask("What is this?", pictures=("camera robot",)))
    assert desk.rows == ()


def test_pictures_are_read_and_go_along(new_desk: Callable[..., Desk], qtbot: QtBot) -> None:
    desk = new_desk(replace(SETTINGS, pictures=True))
    read: list[Sequence[str]] = []

    def read_pictures(names: Sequence[str], done: Callable[[list[bytes]], None], _failed: object) -> None:
        read.append(names)
        done([b"one", b"two"])

    desk.service.use_pictures(read_pictures)
    exchange = answered(desk, qtbot, intents.Ask("What is this?", pictures=("camera robot", "photos/1.png")))
    assert read == [("camera robot", "photos/1.png")]
    assert desk.asked[-1][2]["jpegs"] == (b"one", b"two")
    assert exchange.photo == "camera robot, photos/1.png"


def test_a_picture_that_cannot_be_read_leaves_the_question_with_the_reason(
    new_desk: Callable[..., Desk], qtbot: QtBot
) -> None:
    desk = new_desk(replace(SETTINGS, pictures=True))

    def gone(_names: object, _done: object, failed: Callable[[UserFacingError], None]) -> None:
        failed(UserFacingError("The photo does not exist.", "It was deleted.", "Choose another one."))

    desk.service.use_pictures(gone)
    desk.do(intents.Ask("What is this?", pictures=("photos/1.png",)))
    assert (desk.rows[0].question, desk.rows[0].state) == ("What is this?", "failed")
    assert "photo does not exist" in desk.rows[0].detail
    assert desk.asked == []


def test_the_wizards_words_hold_for_the_session_and_are_put_back(new_desk: Callable[..., Desk], qtbot: QtBot) -> None:
    desk = new_desk()
    desk.do(intents.ChoosePrompt("role", "Expert"))
    desk.do(intents.ChoosePrompt("style", "Short", actor="wizard:b"))
    desk.do(intents.EditPrompt("style", "Use five words.", "Short"))
    desk.do(intents.EditPrompt("notes", "The arm works again."))
    answered(desk, qtbot, intents.Ask("Where?"))
    assert "system: You are a guide.\n\nYou know every robot.\n\nUse five words." in desk.prompt
    assert 'Notes: "The arm works again."' in desk.prompt
    assert (desk.setup.edited, desk.setup.style, desk.setup.styles[0].text) == (True, "Short", "Use five words.")
    told = [event for event in desk.published if isinstance(event, AssistantChanged)]
    assert [(event.setting, event.name, event.actor) for event in told] == [
        ("role", "Expert", "wizard"), ("style", "Short", "wizard:b"), ("style", "Short", "wizard"),
        ("notes", "", "wizard"),
    ]  # fmt: skip
    desk.service.use_scenario(replace(desk.scenario, title="A place was saved"))
    assert desk.setup.edited, "the scenario says the same of the assistant"
    desk.do(intents.ResetPrompts())
    assert (desk.setup.edited, desk.setup.role, desk.setup.notes) == (False, "", "The arm is being repaired.")
    with pytest.raises(UserFacingError, match="no role with that name"):
        desk.do(intents.ChoosePrompt("role", "Pirate"))
    with pytest.raises(UserFacingError, match="characters too long"):
        desk.do(intents.EditPrompt("notes", "x" * 5000))


def test_the_models_to_choose_from_are_the_scenarios_and_what_is_found_here(
    new_desk: Callable[..., Desk], qtbot: QtBot
) -> None:
    desk = new_desk()
    desk.service._lists._query()
    qtbot.waitUntil(lambda: len(desk.setup.models) > 3)
    assert [(choice.model, choice.where) for choice in desk.setup.models] == [
        ("ollama:small", "on this computer"), ("openai:large", "api.openai.com"), ("embedded", "on this computer"),
        ("ollama:found", "on this computer"), ("ollama:passed-on:cloud", "127.0.0.1:11434"),
    ]  # fmt: skip
    desk.do(intents.ChooseModel("ollama:found"))
    exchange = answered(desk, qtbot, intents.Ask("Where?"))
    assert (exchange.model, exchange.provider) == ("found", "ollama")
    with pytest.raises(UserFacingError, match="cannot be chosen"):
        desk.do(intents.ChooseModel("openai:somewhere-else"))


def test_with_local_models_only_no_other_is_offered_or_asked(new_desk: Callable[..., Desk], qtbot: QtBot) -> None:
    desk = new_desk(cloud_models=False)
    desk.service._lists._query()
    qtbot.waitUntil(lambda: len(desk.setup.models) > 2)
    assert [choice.model for choice in desk.setup.models] == ["ollama:small", "embedded", "ollama:found"]
    with pytest.raises(UserFacingError, match="cannot be chosen"):
        desk.do(intents.ChooseModel("openai:large"))
    answered(desk, qtbot, intents.Ask("Where?"))
    assert desk.asked[-1][2]["local_only"] is True
    elsewhere = new_desk(replace(SETTINGS, model="gemini:large"), cloud_models=False)
    assert "allows only local models" in elsewhere.state.assistant.value.detail
    with pytest.raises(UserFacingError, match="still in the field"):
        elsewhere.do(intents.Ask("Where?"))


def gather(desk: Desk) -> None:
    desk.state.transcript.set((
        Turn("u-1", "robot", "Hello, {p-1}.", "typed", "finished", 1, 2),
        Turn("u-2", "participant", "Where is the arm?", "heard", "finished", 3, 4),
    ))  # fmt: skip
    desk.state.persons.set((PersonRow("p-1", 1, "Ada", True, 1, 2, number=7, known=True),))
    desk.state.protocol.set(ProtocolStatus("robot-arm", "Robot arm", 3, 6))
    desk.service.follows()[Marked](Marked(5, "Laughs", mark_id="m-1", note="She likes the arm"))


def test_context_is_counted_and_can_be_left_out(new_desk: Callable[..., Desk], qtbot: QtBot) -> None:
    desk = new_desk()
    gather(desk)
    desk.service._show_setup()
    assert [(part.kind, part.count) for part in desk.setup.parts] == [
        ("conversation", 2), ("step", 1), ("people", 1), ("notes", 2),
    ]  # fmt: skip
    assert all(part.words > 0 for part in desk.setup.parts)
    exchange = answered(desk, qtbot, intents.Ask("Where?"))
    assert "assistant: Hello, Ada." in desk.prompt and '"Where is the arm?"' in desk.prompt
    assert 'Step of the study now: "Robot arm".' in desk.prompt
    assert 'People here now: "Ada".' in desk.prompt and '"Laughs: She likes the arm"' in desk.prompt
    recorded = " ".join(message.content for message in exchange.messages)
    assert "Ada" not in recorded and "Hello, person 7." in recorded, "names never enter the record"
    everything: tuple[PromptPart, ...] = ("conversation", "step", "people", "history", "things", "notes")
    answered(desk, qtbot, intents.Ask("Where?", leave_out=everything))
    assert desk.prompt == "system: You are a guide.\nuser: Where?"


def test_nothing_of_one_participant_is_notified_about_the_next(new_desk: Callable[..., Desk], qtbot: QtBot) -> None:
    desk = new_desk()
    gather(desk)
    desk.service.forget(conversation=True)
    answered(desk, qtbot, intents.Ask("Where?", leave_out=("people",)))
    assert "arm?" not in desk.prompt and "likes" not in desk.prompt
    desk.service.follows()[Marked](Marked(6, "", mark_id="m-2", note="New here"))
    answered(desk, qtbot, intents.Ask("Where?"))
    assert '"New here"' in desk.prompt
    desk.service.follows()[Marked](Marked(7, "", mark_id="m-2", note="New here", state="withdrawn"))
    answered(desk, qtbot, intents.Ask("Where?"))
    assert "New here" not in desk.prompt


def test_several_questions_are_asked_in_parallel(new_desk: Callable[..., Desk], qtbot: QtBot) -> None:
    desk = new_desk()
    for number in range(3):
        desk.do(intents.Ask(f"Question {number}?"))
    qtbot.waitUntil(lambda: not any(row.is_pending for row in desk.rows))
    assert [(row.question, row.answer) for row in desk.rows] == [
        (f"Question {number}?", "Well.") for number in (2, 1, 0)
    ]
    assert len({exchange.exchange_id for exchange in desk.published}) == 3


def test_one_server_runs_the_chosen_embedded_model(new_desk: Callable[..., Desk]) -> None:
    desk = new_desk(replace(SETTINGS, model="embedded:large", models=("embedded:small",)))
    (large,) = desk.children.started
    assert large.body.arguments == ("large",)
    large.send(EmbeddedReady("http://127.0.0.1:5001", "large", "key"))
    assert desk.service.client.model == "large on this computer"

    desk.do(intents.ChooseModel("embedded:small"))
    small = desk.children.started[-1]
    assert small.body.arguments == ("small",) and not large.running, "two might not fit into the memory"
    assert not desk.service.client.ready
    large.send(EmbeddedReady("http://127.0.0.1:5001", "large", "key"))  # was on its way
    assert not desk.service.client.ready
    small.send(EmbeddedReady("http://127.0.0.1:5002", "small", "key"))
    assert desk.service.client.model == "small on this computer"

    desk.do(intents.ChooseModel("embedded"))
    assert [child.body.arguments for child in desk.children.started if child.running] == [("",)]


def test_a_model_that_this_computer_lacks_is_named(new_desk: Callable[..., Desk]) -> None:
    desk = new_desk(replace(SETTINGS, model="embedded:absent"))
    (server,) = desk.children.started
    server.send(EmbeddedFailed(Problem(1, "warning", "This computer has no model named “absent”.", "", "")))
    status: AssistantStatus = desk.state.assistant.value
    assert (status.state, status.detail) == ("failed", "This computer has no model named “absent”.")


@pytest.mark.logs("Reading the model file ended its process")
def test_a_model_file_is_added_in_a_process_of_its_own(
    new_desk: Callable[..., Desk], qtbot: QtBot, tmp_path: Path
) -> None:
    desk = new_desk()
    desk.do(intents.AddModel(tmp_path / "qwen.gguf"))
    (addition,) = desk.children.started
    assert addition.body.arguments == (tmp_path / "qwen.gguf",)
    with pytest.raises(UserFacingError, match="Another model is being added"):
        desk.do(intents.AddModel(tmp_path / "other.gguf"))
    desk.listed = ("embedded:qwen",)
    addition.send(ModelAdded("qwen", "Qwen", 10**9, 2 * 10**9, "a" * 64, "embedded:qwen answers “Paris.”"))
    addition.die()
    added = desk.published[-1]
    assert isinstance(added, Problem) and "qwen is added" in added.what and "2.0 GB" in added.meaning
    qtbot.waitUntil(lambda: "embedded:qwen" in [choice.model for choice in desk.setup.models])

    desk.do(intents.AddModel(tmp_path / "hostile.gguf"))
    desk.children.started[-1].die()
    assert "ended its process" in desk.published[-1].what


LAB = Plugin("lab", "language_models", "lab-model", "2.1", "lab_model:Plugin")


def with_lab_model(new_desk: Callable[..., Desk], **permissions: bool) -> Desk:
    return new_desk(replace(SETTINGS, model="plugin:lab", models=()), **permissions)


def test_a_plug_in_is_served_by_a_process_and_known_with_its_package(
    new_desk: Callable[..., Desk], qtbot: QtBot
) -> None:
    desk = with_lab_model(new_desk)
    (server,) = desk.children.started
    assert server.body.arguments == ("plugin:lab",)
    server.send(EmbeddedReady("http://127.0.0.1:5001", "plugin:lab", "key", LAB))
    assert answered(desk, qtbot, intents.Ask("Where?")).answer == "Well."
    assert desk.service.client.model == "plugin:lab"
    assert not desk.service.client.embedded, "what the small model needs is not sent to another one"
    assert [choice.where for choice in desk.setup.models if choice.model == "plugin:lab"] == ["a plug-in"]
    assert desk.service.plugins == {"language model lab": "lab-model 2.1"}
    with pytest.raises(UserFacingError, match="A plug-in cannot process pictures"):
        desk.service.check_picture()


def test_a_plug_in_that_fails_is_named_and_the_embedded_model_takes_over(
    new_desk: Callable[..., Desk], qtbot: QtBot
) -> None:
    desk = with_lab_model(new_desk)
    (server,) = desk.children.started
    server.send(EmbeddedReady("http://127.0.0.1:5001", "plugin:lab", "key", LAB))
    server.send(PluginFailed(LAB, "it raised KeyError: 'who'"))
    (problem,) = [event for event in desk.published if isinstance(event, Problem)]
    assert problem.what == "The plug-in lab (lab-model 2.1) was switched off: it raised KeyError: 'who'."
    assert [child.body.arguments for child in desk.children.started if child.running] == [("",)]
    assert desk.service.plugins == {}
    assert (desk.setup.model, desk.published[-1].name) == ("embedded", "embedded"), "the change is in the record"
    with pytest.raises(UserFacingError, match="cannot be chosen"):
        desk.do(intents.ChooseModel("plugin:lab"))
    desk.do(intents.ResetPrompts())
    assert desk.setup.model == "embedded", "also when the scenario's model is asked for again"


@pytest.mark.parametrize(("within_s", "reason"), [(60.0, "it ended its process"), (0.05, "it did not return within")])
def test_a_plug_in_that_ends_its_process_or_hangs_is_named(
    within_s: float, reason: str, new_desk: Callable[..., Desk], qtbot: QtBot
) -> None:
    desk = with_lab_model(new_desk)
    (server,) = desk.children.started
    server.send(PluginCall(LAB, within_s))
    if within_s < 1:
        qtbot.waitUntil(lambda: not server.running, timeout=5000)
    server.die()
    assert next(event.what for event in desk.published if isinstance(event, Problem)).startswith(
        f"The plug-in lab (lab-model 2.1) was switched off: {reason}"
    )
    assert desk.children.started[-1].body.arguments == ("",)


def test_a_plug_in_whose_process_ends_between_two_answers_is_named(new_desk: Callable[..., Desk]) -> None:
    desk = with_lab_model(new_desk)
    (server,) = desk.children.started
    server.send(EmbeddedReady("http://127.0.0.1:5001", "plugin:lab", "key", LAB))
    server.die()
    (problem,) = [event for event in desk.published if isinstance(event, Problem)]
    assert problem.what == "The plug-in lab (lab-model 2.1) was switched off: it ended its process."


def test_a_plug_in_that_answers_in_time_goes_on(new_desk: Callable[..., Desk], qtbot: QtBot) -> None:
    desk = with_lab_model(new_desk)
    (server,) = desk.children.started
    server.send(PluginCall(LAB, 0.05))
    server.send(PluginCall())
    qtbot.wait(150)
    assert server.running


def test_a_plug_in_is_not_used_where_nothing_may_leave_this_computer(new_desk: Callable[..., Desk]) -> None:
    desk = with_lab_model(new_desk, cloud_models=False)
    assert not desk.children.started
    status: AssistantStatus = desk.state.assistant.value
    assert status.state == "failed" and "only local models" in status.detail
    assert "plugin:lab" not in [choice.model for choice in desk.setup.models]


def test_an_answer_without_words_is_refused_and_not_recorded_as_said(new_desk: Callable[..., Desk]) -> None:
    made = new_desk()
    made.service._speech = NothingToSay()  # type: ignore[assignment]
    with pytest.raises(UserFacingError, match="nothing that can be spoken"):
        made.do(intents.SayAnswer("👍"))
    assert not any(isinstance(event, AnswerUsed) for event in made.published)
