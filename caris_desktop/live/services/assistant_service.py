"""Assistant service: choice of language model, prompts, questions, and the process of the embedded model."""

import os
import secrets
from collections import Counter
from collections.abc import Callable, Container, Sequence
from dataclasses import replace
from typing import Any, Literal

from PySide6.QtCore import QObject

from caris_desktop.conversation.conversation_transcript import Turn
from caris_desktop.conversation.embedded_server import EmbeddedFailed, EmbeddedReady, ModelAdded
from caris_desktop.conversation.models.connection import check_place
from caris_desktop.conversation.models.endpoint import (
    EMBEDDED_KEY,
    PLUGIN,
    LanguageModelError,
    ModelEndpoint,
    served_name,
)
from caris_desktop.conversation.prompts import (
    MAX_HISTORY_CHARACTERS,
    MAX_LABEL_CHARACTERS,
    MAX_QUESTION_CHARACTERS,
    ContextPart,
    build_messages,
    characters_too_long,
    context_lines,
    conversation_words,
    system_text,
)
from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, Actor, cancelled_by
from caris_desktop.domain.events import ANSWER, AnswerUsed, AssistantChanged, ChatMessage, Marked
from caris_desktop.domain.failure import RefusedError, UserFacingError
from caris_desktop.domain.plugins import Plugin, PluginCall, PluginFailed, switched_off
from caris_desktop.domain.ports import ValueSink
from caris_desktop.domain.sensing import People
from caris_desktop.domain.translation import QT_TR_NOOP, joined, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import AsyncioThread, new_timer
from caris_desktop.live.child_process import ChildProcess, ProcessSpec
from caris_desktop.live.model_client import ListModels, ModelClient, ModelLists, StreamChat
from caris_desktop.live.service import (
    ContextService,
    Follows,
    Handlers,
    PluginWatch,
    ServiceContext,
    SupervisedProcess,
    localize_problem,
)
from caris_desktop.live.speech_queue import SpeechQueue
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import AssistantSetup, AssistantStatus, ContextPartStatus, ExchangeStatus, ModelChoice
from caris_desktop.people.presence import PersonRow
from caris_desktop.scenario.scenario_model import (
    PROMPT_CHARACTERS,
    TEXT_CHARACTERS,
    AssistantPeople,
    AssistantSettings,
    NamedText,
    Scenario,
)

# Prompt context of a question to the language model, and its size. GUI thread.


class AssistantContext:
    """Collects the context from the state, and the wizard's notes from marks."""

    def __init__(self, state: LiveState) -> None:
        self._state = state
        self._notes: dict[str, Marked] = {}
        self._forgotten: frozenset[str] = frozenset()

    def take_mark(self, mark: Marked) -> None:
        """Add a mark with a note; withdrawn or empty ones are removed."""
        if mark.state == "withdrawn" or not mark.note.strip():
            self._notes.pop(mark.mark_id, None)
        else:
            self._notes[mark.mark_id] = mark

    def forget(self) -> None:
        """Start a new participant: earlier turns and notes are excluded."""
        self._notes.clear()
        self._forgotten = frozenset(turn.utterance_id for turn in self._turns())

    def included(self, detail: AssistantPeople, notes: str, leave_out: Container[str] = ()) -> ContextPart:
        """Context without the parts left out. ``detail``: permitted data about people; ``notes``: the notes as text."""
        if detail == "history" and "history" in leave_out:
            detail = "names"
        rows: Sequence[PersonRow] = self._state.persons.value
        labels = {row.person_id: describe_person(row, "names" if detail == "history" else detail) for row in rows}
        noted = [f"{mark.label}: {mark.note}" if mark.label else mark.note for mark in self._notes.values()]
        return ContextPart(
            conversation=() if "conversation" in leave_out else self._turns(),
            step="" if "step" in leave_out else self._state.protocol.value.title,
            people=() if "people" in leave_out else [describe_person(row, detail) for row in rows if row.here],
            things=() if "things" in leave_out else self._things_in_view(),
            notes=() if "notes" in leave_out else [*filter(str.strip, [notes]), *noted],
            label_characters=MAX_HISTORY_CHARACTERS if detail == "history" else MAX_LABEL_CHARACTERS,
            label_of=labels.get,
        )

    def parts(self, detail: AssistantPeople, notes: str) -> tuple[ContextPartStatus, ...]:
        """Available parts with their size."""
        along = self.included(detail, notes)
        turns, words = conversation_words(along.conversation)
        lines = context_lines(along)
        found = [ContextPartStatus("conversation", QT_TR_NOOP("Conversation"), turns, words)]
        if "step" in lines:
            found.append(ContextPartStatus("step", QT_TR_NOOP("Step"), 1, _words(lines["step"])))
        if "people" in lines:
            plain = lines["people"]
            if detail == "history":
                plain = context_lines(self.included("names", notes))["people"]
            found.append(ContextPartStatus("people", QT_TR_NOOP("People"), len(along.people), _words(plain)))
            if lines["people"] != plain:
                more = _words(lines["people"]) - _words(plain)
                found.append(ContextPartStatus("history", QT_TR_NOOP("Person history"), len(along.people), more))
        if "things" in lines:
            things = len(list(along.things))
            found.append(ContextPartStatus("things", QT_TR_NOOP("Objects in view"), things, _words(lines["things"])))
        if "notes" in lines:
            found.append(ContextPartStatus("notes", QT_TR_NOOP("Notes"), len(along.notes), _words(lines["notes"])))
        return tuple(part for part in found if part.count)

    def _turns(self) -> Sequence[Turn]:
        turns: Sequence[Turn] = self._state.transcript.value
        return [turn for turn in turns if turn.utterance_id not in self._forgotten]

    def _things_in_view(self) -> list[str]:
        """Objects detected by the cameras. Cameras may see the same object, so the maximum of their counts is used."""
        most: Counter[str] = Counter()
        for camera in self._state.cameras.value:
            stream = self._state.people_of(camera)
            if stream.freshness == "fresh" and isinstance(stream.value, People):
                most |= Counter(thing.label for thing in stream.value.things)
        return sorted(most.elements())


def describe_person(person: PersonRow, detail: AssistantPeople) -> str:
    """A person as described to the language model."""
    if detail == "numbers" or not person.known:
        return f"person {person.number}"
    if detail == "names":
        return person.name
    details = (person.group and f"group {person.group}", ", ".join(person.tags), person.note, person.summary)
    known = "; ".join(filter(None, details))
    return f"{person.name} ({known})" if known else person.name


def _words(text: str) -> int:
    return len(text.split())


EMBEDDED = "embedded"
_COUNT_EVERY_MS = 1000
MOST_PICTURES = 4
Setting = Literal["model", "role", "style", "system_prompt", "notes", "reset"]
ReadPictures = Callable[[Sequence[str], Callable[[list[bytes]], None], Callable[[UserFacingError], None]], None]
"""Reads images of these names as JPEG, scaled for a model, in a background thread. Raises UserFacingError."""


class AssistantAdapters(Value):
    """``server`` runs the built-in model, and with its name one that the user added; ``addition`` adds a file as one.

    ``resolve_endpoint(model, address)`` raises LanguageModelError.
    """

    server: ProcessSpec
    addition: ProcessSpec
    stream_chat: StreamChat
    resolve_endpoint: Callable[[str, str | None], ModelEndpoint]
    list_models: ListModels


class AssistantService(ContextService):
    """Handles questions, setup and spoken answers. ``client`` serves other users of the model."""

    def __init__(
        self,
        context: ServiceContext,
        parts: AssistantAdapters,
        *,
        asyncio_thread: AsyncioThread,
        speech: SpeechQueue,
        scenario: Scenario,
    ) -> None:
        super().__init__(context)
        self._parts = parts
        self._speech = speech
        self._scenario = scenario
        self._setup = AssistantSetupState(scenario.assistant)
        self._context = AssistantContext(self._state)
        self.client = ModelClient(asyncio_thread, parts.stream_chat, self._bus.publish, self)
        self._exchanges = Exchanges(self._state, self.client, self._bus.publish, self)
        self._lists = ModelLists(asyncio_thread, parts.list_models, self)
        self._lists.found.connect(self._show_setup)
        self._read_pictures: ReadPictures | None = None
        self._counting = new_timer(self, self._show_setup, _COUNT_EVERY_MS)
        self._server = SupervisedProcess(
            self._children,
            ended=self._on_server_ended,
            on_message=self._on_server_message,
            grace_s=2.0,
            name=parts.server.name,
        )
        self._server_url: str | None = None
        self._served = ""
        self._addition: ChildProcess | None = None
        self._watch = PluginWatch()
        self._watching = new_timer(self, self._end_overdue, single_shot=True, precise=True)
        self._plugins_off: set[str] = set()
        self._serving: Plugin | None = None
        self._started = False

    def handlers(self) -> Handlers:
        return {
            intents.Ask: self.ask,
            intents.CancelAnswer: lambda intent: self._exchanges.cancel(cancelled_by(intent.actor), intent.exchange_id),
            intents.SayAnswer: self._say_answer,
            intents.DismissAnswer: lambda intent: self._exchanges.dismiss(
                intent.exchange_id, cancelled_by(intent.actor), intent.actor
            ),
            intents.ChooseModel: self._choose,
            intents.AddModel: self._add_model,
            intents.ChoosePrompt: self._choose_prompt,
            intents.EditPrompt: self._edit_prompt,
            intents.ResetPrompts: self._reset,
        }

    def follows(self) -> Follows:
        return {Marked: self._context.take_mark}

    def supervised(self) -> tuple[SupervisedProcess, ...]:
        return (self._server,)

    def use_scenario(self, scenario: Scenario) -> None:
        if scenario.assistant != self._scenario.assistant:
            self._setup = AssistantSetupState(scenario.assistant)
        self._scenario = scenario
        if self._started:
            self._begin()

    def start(self) -> None:
        self._started = True
        self._begin()

    def _begin(self) -> None:
        if self._scenario.permissions.assistant:
            self._lists.start()
            self._counting.start()
        else:
            self._lists.stop()
            self._counting.stop()
            self.client.cancel_all(QT_TR_NOOP("cancelled because the scenario was changed"))
            self._end_server()
        self._use_chosen()
        self._show_setup()

    def stop(self) -> None:
        self._lists.stop()
        self._counting.stop()
        self.client.cancel_all(QT_TR_NOOP("cancelled because the program closed"))
        self._server.ask_to_end()
        if self._addition is not None:
            self._addition.ask_to_end()

    def end(self) -> None:
        super().end()
        if self._addition is not None:
            self._addition.stop(grace_s=1.5)

    def forget(self, *, conversation: bool = False) -> None:
        """Remove questions and answers; with ``conversation`` also the context, for another participant."""
        if conversation:
            self._context.forget()
        self._exchanges.forget()

    # Questions

    def use_pictures(self, read: ReadPictures) -> None:
        """Set the reader for images of questions."""
        self._read_pictures = read

    def check_picture(self) -> None:
        """Raise UserFacingError if a question cannot include images."""
        meaning = tr("The assistant was not asked; the picture is still attached.")
        if (name := served_name(self._setup.model)) is not None:
            raise RefusedError(
                tr("A plug-in cannot process pictures.")
                if _is_plugin(name)
                else tr("The embedded language model cannot process pictures."),
                meaning,
                tr(
                "Choose a model that can process pictures, in a scenario with "
                "assistant.pictures."),
            )  # fmt: skip
        if not self._scenario.assistant.pictures:
            raise RefusedError(
                tr("This scenario does not allow sending pictures to a language model."), meaning,
                tr("If participants have agreed, set assistant.pictures in the scenario."),
            )  # fmt: skip

    def ask(self, intent: intents.Ask) -> None:
        """Ask a question. Raises UserFacingError if refused; later failures are shown in its row."""
        question = intent.question.strip()
        if not question:
            return
        if too_long := characters_too_long(question):
            raise RefusedError(
                tr("The question is {too_long} characters too long.").format(too_long=too_long),
                tr("The assistant was not asked; a shortened question could get a wrong answer."),
                tr("Use at most {most} characters.").format(most=f"{MAX_QUESTION_CHARACTERS:,}"),
            )
        if len(intent.pictures) > MOST_PICTURES:
            raise RefusedError(
                tr("A question can have at most {most} pictures.").format(most=MOST_PICTURES),
                tr("The assistant was not asked."), tr("Remove some pictures."),
            )  # fmt: skip
        if intent.pictures:
            self.check_picture()
        exchange_id = self._exchanges.prepare(question)
        if intent.pictures and self._read_pictures is not None:
            try:
                self._read_pictures(
                    intent.pictures,
                    lambda jpegs: self._send(exchange_id, question, intent, jpegs),
                    lambda failure: self._exchanges.fail(exchange_id, joined((failure.what, failure.advice))),
                )
            except UserFacingError as failure:
                self._exchanges.fail(exchange_id, joined((failure.what, failure.advice)))
        else:
            self._send(exchange_id, question, intent, [])

    def _send(self, exchange_id: str, question: str, intent: intents.Ask, jpegs: Sequence[bytes]) -> None:
        detail = self._may_report()
        settings = self._scenario.assistant
        self._exchanges.ask(
            exchange_id,
            self._messages(question, detail, intent.leave_out),
            recorded=None if detail == "numbers" else self._messages(question, "numbers", intent.leave_out),
            max_tokens=settings.max_tokens,
            temperature=settings.temperature,
            actor=intent.actor,
            photo=", ".join(intent.pictures),
            jpegs=jpegs,
        )

    def _may_report(self) -> AssistantPeople:
        return self._scenario.assistant.people if self._scenario.permissions.naming_people else "numbers"

    def _messages(
        self, question: str, detail: AssistantPeople, leave_out: Container[str] = ()
    ) -> tuple[ChatMessage, ...]:
        along = self._context.included(detail, self._setup.text_of("notes"), leave_out)
        return build_messages(question, system_prompt=self._setup.prompt, along=along)

    def _say_answer(self, intent: intents.SayAnswer) -> None:
        utterance_id = self._speech.say(intent.text, "assistant", intent.actor)
        if not utterance_id:
            raise RefusedError(
                tr("This answer contains nothing that can be spoken."),
                tr("Nothing was said."),
                tr("Edit the answer, or ask again."),
            )
        self._exchanges.note_use(intent.text, utterance_id, intent.exchange_id, intent.actor)

    # Setup

    def _choose(self, intent: intents.ChooseModel) -> None:
        if intent.model not in (choice.model for choice in self._offered()):
            raise RefusedError(
                tr("That language model cannot be chosen here."),
                tr("{model} stays selected.").format(model=self.client.model or self._setup.model),
                tr("Add it to assistant.models of the scenario, or start its server."),
            )
        if intent.model != self._setup.model:
            self._setup.model = intent.model
            self._notify("model", intent.model, "", intent.actor)
            self._use_chosen()

    def _choose_prompt(self, intent: intents.ChoosePrompt) -> None:
        self._check_prompt(intent.kind, intent.name)
        self._setup.choose(intent.kind, intent.name)
        self._notify(intent.kind, intent.name, self._setup.text_of(intent.kind, intent.name), intent.actor)

    def _edit_prompt(self, intent: intents.EditPrompt) -> None:
        if intent.kind in ("role", "style"):
            self._check_prompt("role" if intent.kind == "role" else "style", intent.name)
        text = intent.text.strip()
        most = most_characters(intent.kind)
        if len(text) > most:
            raise RefusedError(
                tr("The text is {count} characters too long.").format(count=f"{len(text) - most:,}"),
                tr("The assistant's settings are unchanged."),
                tr("Shorten it to {most} characters.").format(most=f"{most:,}"),
            )  # fmt: skip
        self._setup.edit(intent.kind, intent.name, text)
        self._notify(intent.kind, intent.name, text, intent.actor)

    def _check_prompt(self, kind: Literal["role", "style"], name: str) -> None:
        if not self._setup.has(kind, name):
            raise RefusedError(
                tr("This scenario has no role with that name.")
                if kind == "role"
                else tr("This scenario has no style with that name."),
                tr("The assistant's settings are unchanged."), tr("Choose another one."),
            )  # fmt: skip

    def _reset(self, intent: intents.ResetPrompts) -> None:
        before = self._setup.model
        self._setup.reset()
        self._notify("reset", "", "", intent.actor)
        if self._setup.model != before:
            self._use_chosen()

    def _notify(self, setting: Setting, name: str, text: str, actor: Actor) -> None:
        self._bus.publish(AssistantChanged(clock.now_ns(), setting, name, text, actor))
        self._show_setup()

    def _show_setup(self) -> None:
        if not self._scenario.permissions.assistant:
            return
        setup = self._setup.shown()
        pictures = served_name(self._setup.model) is None and self._scenario.assistant.pictures
        models = self._offered()
        where = next((choice.where for choice in models if choice.model == setup.model), _here())
        self._state.assistant_setup.set(
            replace(
                setup,
                server="" if where == _here() else where,
                models=models,
                pictures=pictures,
                parts=self._context.parts(self._may_report(), setup.notes),
            )
        )

    def _offered(self) -> tuple[ModelChoice, ...]:
        """Models to choose from: the scenario's, the embedded one, and those of local servers."""
        settings = self._scenario.assistant
        names = dict.fromkeys((settings.model, *settings.models, EMBEDDED, *self._lists.models))
        choices = (self._choice(name) for name in names)
        return tuple(choice for choice in choices if choice is not None)

    def _choice(self, model: str) -> ModelChoice | None:
        """Model as a choice; None if unknown or not permitted."""
        if (name := served_name(model)) is not None and _is_plugin(name):
            usable = self._scenario.permissions.cloud_models and name not in self._plugins_off
            return ModelChoice(model, name.partition(":")[2], tr("a plug-in")) if usable else None
        if name is not None:
            return ModelChoice(model, name or tr("SmolLM2, practice quality"), _here())
        try:
            endpoint = self._parts.resolve_endpoint(model, None)
        except LanguageModelError:
            return None
        if not endpoint.leaves_computer:
            return ModelChoice(model, endpoint.model, _here())
        if not self._scenario.permissions.cloud_models:
            return None
        return ModelChoice(model, endpoint.model, endpoint.server)

    def _add_model(self, intent: intents.AddModel) -> None:
        """Check a model file and add it in a process of its own. Raises UserFacingError while another is added."""
        if self._addition is not None:
            raise UserFacingError(
                tr("Another model is being added."), tr("This one was not added."), tr("Wait until it is done."),
                severity="info",
            )  # fmt: skip
        self._bus.inform(
            tr("{name} is checked, and its model is asked a question.").format(name=intent.file.name),
            tr("Large models take a minute; everything else goes on."),
        )  # fmt: skip
        addition = self._parts.addition
        self._addition = self._children.start(
            replace(addition, arguments=(intent.file,)), ended=self._on_addition_ended, on_message=self._on_addition
        )

    def _on_addition(self, message: Any) -> None:
        self._addition = None
        match message:
            case ModelAdded(name=name, memory_bytes=memory, sha256=sha256, answer=answer):
                self._lists.refresh()
                self._bus.inform(
                    tr("{name} is added, and can be chosen in the list of models.").format(name=name),
                    tr("It needs about {memory} GB of memory. {answer}. SHA-256 {sha256}.").format(
                        memory=f"{memory / 1e9:.1f}", answer=answer, sha256=sha256[:12]
                    ),
                )
            case EmbeddedFailed(problem):
                failed = localize_problem(problem)
                self._bus.problem("warning", failed.what, failed.meaning, failed.advice, cause=ANSWER)

    def _on_addition_ended(self, _child: ChildProcess) -> None:
        if self._addition is not None:
            self._addition = None
            self._bus.problem(
                "warning", tr("Reading the model file ended its process."), tr("The model was not added."),
                tr("The file may be damaged; the log has details."), cause=ANSWER,
            )  # fmt: skip

    # Model

    def _use_chosen(self) -> None:
        if served_name(self._setup.model) in self._plugins_off:
            self._setup.model = EMBEDDED
            self._notify("model", EMBEDDED, "", CONSOLE)
        if not self._scenario.permissions.assistant:
            self._exchanges.show_status(AssistantStatus(state="off"))
        elif _is_plugin(served_name(self._setup.model)) and not self._scenario.permissions.cloud_models:
            detail = QT_TR_NOOP(
                "A plug-in may send questions to other computers, and this scenario allows only local models. "
                "Choose the embedded model."
            )
            self._exchanges.show_status(AssistantStatus(state="failed", detail=detail))
        elif (name := served_name(self._setup.model)) is not None and not self._serves(name):
            self._exchanges.show_status(AssistantStatus(state="starting", model=_embedded_title(self._setup.model)))
            if self._server.child is None:
                server = self._parts.server
                self._served, self._watch = name, PluginWatch()
                self._server.start(replace(server, arguments=(*server.arguments, name)))
        else:
            self._use_endpoint()

    def _serves(self, name: str) -> bool:
        """Whether the server runs this model. One that runs another is ended: two might not fit into the memory."""
        if self._served != name:
            self._end_server()
        return self._server_url is not None

    def _end_server(self) -> None:
        self._server_url = self._serving = None
        self._watching.stop()
        self._server.dismiss()

    def _use_endpoint(self) -> None:
        model, local_only = self._setup.model, not self._scenario.permissions.cloud_models
        try:
            endpoint = self._parts.resolve_endpoint(model, self._server_url)
            check_place(endpoint, local_only=local_only)
        except LanguageModelError as error:
            self._exchanges.show_status(AssistantStatus(state="failed", detail=joined((error.what, error.advice))))
            return
        display_name = endpoint.model if served_name(model) is None else _embedded_title(model)
        self._exchanges.use_endpoint(endpoint, display_name=display_name, local_only=local_only)
        self.client.warm_up_soon(lambda: self._messages("Hello.", "numbers"), "question")

    def _on_server_message(self, message: Any) -> None:
        match message:
            case PluginCall(plugin=plugin, within_s=within_s):
                self._watch.note(message)
                self._watching.stop()
                if plugin is not None:
                    self._watching.start(round(within_s * 1000) + 20)
            case PluginFailed(plugin=plugin, reason=reason):
                self._end_server()
                self._switch_off(plugin, reason)
            case EmbeddedReady(url=url, key=key, plugin=plugin):
                self._serving = plugin
                os.environ[EMBEDDED_KEY] = key
                self._server_url = url
                if self._asks_embedded():
                    self._use_endpoint()
            case EmbeddedFailed(problem):
                self._bus.publish(localize_problem(problem))
                if self._asks_embedded():
                    self._exchanges.show_status(AssistantStatus(state="failed", detail=problem.what))

    def _asks_embedded(self) -> bool:
        return self._scenario.permissions.assistant and served_name(self._setup.model) == self._served

    def _on_server_ended(self) -> None:
        plugin = self._watch.called or self._serving
        self._server_url = self._serving = None
        self._watching.stop()
        if plugin is not None:
            self._switch_off(plugin, self._watch.blame)
        elif self._asks_embedded():
            self._server.restarts.after_end(self._report_server_ended, self._use_chosen)
        else:
            self._server.restarts.another()

    def _end_overdue(self) -> None:
        if self._watch.overdue:
            self._server.kill()

    def _switch_off(self, plugin: Plugin, reason: str) -> None:
        """Use the embedded model instead of this plug-in until the program ends."""
        self._plugins_off.add(f"{PLUGIN}:{plugin.name}")
        self._bus.publish(localize_problem(switched_off(clock.now_ns(), plugin.name, plugin.package, reason)))
        self._use_chosen()

    @property
    def plugins(self) -> dict[str, str]:
        """Plug-in that answers, with its package and version."""
        return {} if self._serving is None else {self._serving.title: self._serving.package}

    def _report_server_ended(self, advice: str) -> None:
        self._exchanges.show_status(AssistantStatus(state="failed", detail=QT_TR_NOOP("The language model stopped.")))
        self._bus.problem(
            "warning",
            tr("The language model stopped unexpectedly."),
            tr("The assistant gives no answers; everything else works."),
            advice,
            until="assistant",
        )


def _is_plugin(name: str | None) -> bool:
    return name is not None and name.startswith(f"{PLUGIN}:")


def _here() -> str:
    """Location of a model whose data stays on this computer."""
    return tr("on this computer")


def _embedded_title(model: str) -> str:
    name = served_name(model)
    if _is_plugin(name):
        return model
    return tr("{model} on this computer").format(model=name) if name else tr("SmolLM2 on this computer")


Kind = Literal["system_prompt", "notes", "role", "style"]


def most_characters(kind: Kind) -> int:
    """Maximum length of an edited text, as in the scenario file."""
    return PROMPT_CHARACTERS if kind == "system_prompt" else TEXT_CHARACTERS


class AssistantSetupState:
    """Assistant setup: model and prompts, from the scenario with the wizard's changes.

    Choices and edits of this session; the scenario file is not changed.
    """

    def __init__(self, settings: AssistantSettings) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Reset to the scenario."""
        self._edited = self._settings
        self.model, self.role, self.style = self._settings.model, "", ""

    def has(self, kind: Literal["role", "style"], name: str) -> bool:
        return not name or any(each.name == name for each in self._named(kind))

    def choose(self, kind: Literal["role", "style"], name: str) -> None:
        setattr(self, kind, name)

    def edit(self, kind: Kind, name: str, text: str) -> None:
        """Replace a text of the scenario."""
        if kind in ("system_prompt", "notes"):
            changes: dict[str, Any] = {kind: text}
        else:
            texts = (replace(each, text=text) if each.name == name else each for each in self._named(kind))
            changes = {f"{kind}s": tuple(texts)}
        self._edited = replace(self._edited, **changes)

    def text_of(self, kind: Kind, name: str = "") -> str:
        """Current text; empty for an unknown role or style."""
        if kind in ("system_prompt", "notes"):
            return str(getattr(self._edited, kind))
        return next((each.text for each in self._named(kind) if each.name == name), "")

    @property
    def prompt(self) -> str:
        """Current complete system prompt."""
        return system_text(
            self.text_of("system_prompt"), self.text_of("role", self.role), self.text_of("style", self.style)
        )

    def shown(self) -> AssistantSetup:
        edited = self._edited
        return AssistantSetup(
            model=self.model,
            role=self.role,
            style=self.style,
            system_prompt=edited.system_prompt,
            roles=edited.roles,
            styles=edited.styles,
            templates=edited.templates,
            notes=edited.notes,
            edited=edited != self._settings or self.model != edited.model or bool(self.role or self.style),
        )

    def _named(self, kind: Kind) -> tuple[NamedText, ...]:
        return self._edited.roles if kind == "role" else self._edited.styles


MOST_EXCHANGES_SHOWN = 6
MOST_PENDING_EXCHANGES = 4


class Exchanges(QObject):
    """Questions of the wizard to the language model, several at a time. GUI thread.

    Maintains ``state.assistant``. ``publish`` receives the use of each answer, once.

    An unused answer counts as dismissed when it is removed: by the wizard, by newer ones, or with a change of model or
    participant.
    """

    def __init__(
        self, state: LiveState, client: ModelClient, publish: ValueSink, parent: QObject | None = None
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._client = client
        self._publish = publish
        self._rows: dict[str, ExchangeStatus] = {}  # in the order of asking
        self._none = AssistantStatus()

    # Model

    def use_endpoint(self, endpoint: ModelEndpoint, *, display_name: str, local_only: bool) -> None:
        """Switch the model, shown as ``display_name``. Pending questions end; existing answers remain usable."""
        self._client.use(endpoint, display_name=display_name, local_only=local_only)
        self._show()

    def show_status(self, status: AssistantStatus) -> None:
        """Run without a model; ``status`` has the reason."""
        self._cancel_all(QT_TR_NOOP("the model is no longer available"))
        self._client.use_none(status.detail or QT_TR_NOOP("The model is still starting: ask again in a moment."))
        self._none = status
        self._show()

    # Questions

    def check_room(self) -> None:
        """Raise UserFacingError if no question can be asked now."""
        if not self._client.ready:
            raise RefusedError(
                tr("The assistant cannot answer now."),
                tr("Your question is still in the field."),
                tr("The model is still starting: ask again in a moment.")
                if self._none.state == "starting"
                else (tr(self._none.detail) or tr("Check the scenario's model.")),
            )
        if sum(row.is_pending for row in self._rows.values()) >= MOST_PENDING_EXCHANGES:
            raise RefusedError(
                tr("%n questions are already in progress.", "", MOST_PENDING_EXCHANGES),
                tr("Your question is still in the field."),
                tr("Wait for an answer, or cancel one of them."),
            )

    def prepare(self, question: str) -> str:
        """Add a question whose pictures are being read; returns its id. Raises UserFacingError."""
        self.check_room()
        exchange_id = f"x-{secrets.token_hex(4)}"
        self._rows[exchange_id] = ExchangeStatus(exchange_id, question, "preparing", self._client.model)
        for row in tuple(self._rows.values())[:-MOST_EXCHANGES_SHOWN]:
            if not row.is_pending:
                self._put_away(row.exchange_id)
        self._show()
        return exchange_id

    def ask(self, exchange_id: str, messages: Sequence[ChatMessage], *, actor: Actor = CONSOLE, **how: Any) -> None:
        """Ask a prepared question unless cancelled; ``how`` as in `ModelClient.ask`."""
        row = self._rows.get(exchange_id)
        if row is None or row.state != "preparing":
            return
        self._change(exchange_id, state="answering")
        try:
            self._client.ask(
                messages,
                purpose="question",
                exchange_id=exchange_id,
                on_text=lambda answer: self._change(exchange_id, answer=answer, detail=""),
                on_wait=lambda reason: self._change(exchange_id, detail=reason),
                on_end=lambda exchange: self._change(
                    exchange.exchange_id, state=exchange.outcome, answer=exchange.answer, detail=exchange.detail
                ),
                actor=actor,
                **how,
            )
        except UserFacingError as failure:
            self.fail(exchange_id, joined((failure.what, failure.advice)))

    def fail(self, exchange_id: str, detail: str) -> None:
        """Mark a question as failed; the reason is shown with it."""
        self._change(exchange_id, state="failed", detail=detail)

    def cancel(self, reason: str, exchange_id: str = "") -> None:
        """End one question or all pending ones; each is published before this returns."""
        if not exchange_id:
            self._cancel_all(reason)
        elif exchange_id in self._rows:
            self._end(exchange_id, reason)

    def dismiss(self, exchange_id: str, reason: str, actor: Actor = CONSOLE) -> None:
        """Remove a question with its answer."""
        if exchange_id in self._rows:
            self._end(exchange_id, reason)
            self._put_away(exchange_id, actor)
            self._show()

    def forget(self) -> None:
        """Remove all questions and answers for the next participant or a pause.

        Everything about them is published before this returns, so that it does not enter a later recording.
        """
        self._cancel_all(QT_TR_NOOP("cancelled because the session started, paused or ended"))
        for exchange_id in tuple(self._rows):
            self._put_away(exchange_id)
        self._show()

    def note_use(self, text: str, utterance_id: str, exchange_id: str = "", actor: Actor = CONSOLE) -> None:
        """Record that the wizard used an answer, perhaps edited; the newest if none is named."""
        row = self._rows.get(exchange_id or next(reversed(self._rows), ""))
        if row is None or row.use or not row.answer:
            return
        use: Literal["said", "edited"] = "said" if text.split() == row.answer.split() else "edited"
        self._publish(AnswerUsed(clock.now_ns(), row.exchange_id, use, text, utterance_id, actor))
        self._change(row.exchange_id, use=use)

    def _cancel_all(self, reason: str) -> None:
        for exchange_id in tuple(self._rows):
            self._end(exchange_id, reason)

    def _end(self, exchange_id: str, reason: str) -> None:
        if self._rows[exchange_id].state == "preparing":
            self._change(exchange_id, state="cancelled", detail=reason)  # the model was not asked yet
        else:
            self._client.cancel(exchange_id, reason)

    def _put_away(self, exchange_id: str, actor: Actor = CONSOLE) -> None:
        row = self._rows.pop(exchange_id)
        if row.state == "answered" and not row.use:
            self._publish(AnswerUsed(clock.now_ns(), exchange_id, "dismissed", row.answer, actor=actor))

    def _change(self, exchange_id: str, **changes: Any) -> None:
        row = self._rows.get(exchange_id)
        if row is not None:
            self._rows[exchange_id] = replace(row, **changes)
            self._show()

    def _show(self) -> None:
        rows = tuple(reversed(self._rows.values()))
        newest = rows[0] if rows else ExchangeStatus("", "", "cancelled")
        state, detail = self._none.state, self._none.detail
        if self._client.ready:
            answering, failed = any(row.is_pending for row in rows), newest.state == "failed"
            state = "answering" if answering else "failed" if failed else "ready"
            detail = newest.detail
        self._state.assistant.set(
            AssistantStatus(
                state,
                self._client.model or self._none.model,
                newest.exchange_id,
                newest.question,
                newest.answer,
                detail,
                rows,
            )
        )
