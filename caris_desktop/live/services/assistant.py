"""The language model: which one is asked, what it is told, and the process of the one that comes with the program."""

from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from PySide6.QtCore import QObject

from caris_desktop.conversation.embedded_messages import EmbeddedFailed, EmbeddedReady
from caris_desktop.conversation.language_models import LanguageModelError, ModelEndpoint
from caris_desktop.conversation.prompts import MAX_QUESTION_CHARACTERS, characters_too_long
from caris_desktop.domain import intents
from caris_desktop.domain.actor import Actor, in_words
from caris_desktop.domain.events import ChatMessage, UtteranceChanged
from caris_desktop.domain.failure import ToldFailure
from caris_desktop.domain.sensing import People
from caris_desktop.live.asyncio_thread import AsyncioThread
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ChildProcess, ProcessBody
from caris_desktop.live.children import Children
from caris_desktop.live.exchanges import Exchanges, StreamChat
from caris_desktop.live.service import Follows, Handlers, Restarts, Service
from caris_desktop.live.speech_queue import SpeechQueue
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import AssistantStatus
from caris_desktop.people.presence import PersonRow
from caris_desktop.scenario.model import AssistantPeople, Scenario

_UTTERANCES_KEPT = 200
_EMBEDDED_MODEL_SHOWN = "SmolLM2 on this computer"


@dataclass(frozen=True, slots=True)
class AssistantParts:
    """``server`` runs the embedded model. ``resolve_endpoint(model, its address)`` raises LanguageModelError."""

    server: ProcessBody
    stream_chat: StreamChat
    resolve_endpoint: Callable[[str, str | None], ModelEndpoint]
    build_prompt: Callable[
        [Scenario, Sequence[UtteranceChanged], Sequence[str], Sequence[str], str], tuple[ChatMessage, ...]
    ]


class AssistantService(Service):
    """Asks, remembers what was said, and has answers said."""

    def __init__(
        self,
        state: LiveState,
        bus: Bus,
        children: Children,
        parts: AssistantParts,
        *,
        asyncio_thread: AsyncioThread,
        speech: SpeechQueue,
        scenario: Scenario,
        parent: QObject,
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._bus = bus
        self._children = children
        self._parts = parts
        self._speech = speech
        self._scenario = scenario
        self._conversation: deque[UtteranceChanged] = deque(maxlen=_UTTERANCES_KEPT)
        self._exchanges = Exchanges(state, asyncio_thread, parts.stream_chat, bus.publish, self)
        self._server: ChildProcess | None = None
        self._server_url: str | None = None
        self._restarts = Restarts()
        self._started = False

    def handlers(self) -> Handlers:
        return {
            intents.Ask: lambda asked: self._ask(asked.question.strip(), asked.actor),
            intents.CancelAnswer: lambda asked: self._exchanges.cancel(f"cancelled by {in_words(asked.actor)}"),
            intents.SayAnswer: self._say_answer,
        }

    def follows(self) -> Follows:
        return {UtteranceChanged: self._conversation.append}

    def processes(self) -> dict[str, ChildProcess]:
        return {} if self._server is None else {self._parts.server.name: self._server}

    def use_scenario(self, scenario: Scenario) -> None:
        self._scenario = scenario
        if self._started:
            self._choose_model()

    def start(self) -> None:
        self._started = True
        self._choose_model()

    def stop(self) -> None:
        self._exchanges.cancel("cancelled as the program closed")
        if self._server is not None:
            self._server.ask_to_end()

    def end(self) -> None:
        if self._server is not None:
            self._server.stop(grace_s=1.5)

    def forget(self, *, conversation: bool = False) -> None:
        """Put question and answer away; with ``conversation`` what was said too, as another participant comes."""
        if conversation:
            self._conversation.clear()
        self._exchanges.forget()

    def check_picture(self) -> None:
        """Raises ToldFailure where a picture cannot go with a question."""
        settings = self._scenario.assistant
        meaning = "The assistant was not asked; the photo stays where it is."
        if settings.model == "embedded":
            raise ToldFailure(
                "The language model of this program cannot see pictures.", meaning,
                "Ask about photos in a scenario whose model can: assistant.model with assistant.pictures.",
                severity="warning",
            )  # fmt: skip
        if not settings.pictures:
            raise ToldFailure(
                "This scenario gives no photos to a language model.", meaning,
                "Set assistant.pictures in the scenario where participants agreed to it.", severity="warning",
            )  # fmt: skip

    def ask_about_photo(self, question: str, photo: str, jpeg: bytes, actor: Actor) -> None:
        """Ask with a picture; ``photo`` is its file name, for the record. Raises ToldFailure."""
        self.check_picture()
        self._ask(question.strip() or "What is in this picture?", actor, photo=photo, jpeg=jpeg)

    def _ask(self, question: str, actor: Actor, *, photo: str = "", jpeg: bytes | None = None) -> None:
        if not question:
            return
        too_long = characters_too_long(question)
        if too_long:
            raise ToldFailure(
                f"The question is {too_long} characters too long.",
                "The assistant was not asked; half a question would get an answer to something else.",
                f"Ask in {MAX_QUESTION_CHARACTERS:,} characters at most.",
                severity="warning",
            )
        things = self._things_in_view()
        settings = self._scenario.assistant
        conversation = tuple(self._conversation)

        def told(what: AssistantPeople) -> tuple[ChatMessage, ...]:
            people = [who_is_here(row, what) for row in self._state.persons.value if row.here]
            return self._parts.build_prompt(self._scenario, conversation, people, things, question)

        what: AssistantPeople = settings.people if self._scenario.permissions.naming_people else "numbers"
        if not self._exchanges.ask(
            question,
            told(what),
            recorded=None if what == "numbers" else told("numbers"),
            max_tokens=settings.max_tokens,
            temperature=settings.temperature,
            actor=actor,
            photo=photo,
            jpeg=jpeg,
        ):
            status: AssistantStatus = self._state.assistant.value
            starting = status.state == "starting"
            raise ToldFailure(
                "The assistant cannot answer now.",
                "Your question is kept in the field.",
                "Its model is still starting: ask again in a moment."
                if starting
                else (status.detail or "Check the scenario's model."),
                severity="warning",
            )

    def _things_in_view(self) -> list[str]:
        """What the cameras see now beside people. What two of them see may be the same, so the most that one sees."""
        most: Counter[str] = Counter()
        for camera in self._state.cameras.value:
            stream = self._state.people_of(camera)
            if stream.freshness == "fresh" and isinstance(stream.value, People):
                most |= Counter(thing.label for thing in stream.value.things)
        return sorted(most.elements())

    def _say_answer(self, asked: intents.SayAnswer) -> None:
        utterance_id = self._speech.say(asked.text, "assistant", asked.actor)
        self._exchanges.note_use(asked.text, utterance_id, asked.actor)

    # The model

    def _choose_model(self) -> None:
        if not self._scenario.permissions.assistant:
            self._exchanges.show_status(AssistantStatus(state="off"))
        elif self._scenario.assistant.model == "embedded" and self._server_url is None:
            self._exchanges.show_status(AssistantStatus(state="starting", model=_EMBEDDED_MODEL_SHOWN))
            if self._server is None:
                self._server = self._children.start(
                    self._parts.server, ended=self._on_server_ended, heard=self._on_heard
                )
        else:
            self._use_model()

    def _use_model(self) -> None:
        if not self._scenario.permissions.assistant:
            return
        model = self._scenario.assistant.model
        try:
            endpoint = self._parts.resolve_endpoint(model, self._server_url)
        except LanguageModelError as error:
            self._exchanges.show_status(AssistantStatus(state="failed", detail=f"{error.what} {error.advice}"))
            return
        self._exchanges.use_endpoint(
            endpoint, shown_as=_EMBEDDED_MODEL_SHOWN if model == "embedded" else endpoint.model
        )

    def _on_heard(self, message: Any) -> None:
        match message:
            case EmbeddedReady(url):
                self._server_url = url
                self._use_model()
            case EmbeddedFailed(problem):
                self._bus.publish(problem)
                self._exchanges.show_status(AssistantStatus(state="failed", detail=problem.what))

    def _on_server_ended(self, child: ChildProcess) -> None:
        if child is not self._server:
            return  # it was replaced while the news of its end was on its way
        self._server = self._server_url = None
        again = self._restarts.another()
        if self._scenario.permissions.assistant and self._scenario.assistant.model == "embedded":
            self._exchanges.show_status(AssistantStatus(state="failed", detail="The language model stopped."))
            self._bus.problem(
                "warning",
                "The language model stopped unexpectedly.",
                "The assistant gives no answers; everything else works.",
                self._restarts.advice,
                until="assistant",
            )
            if again:
                self._choose_model()


def who_is_here(person: PersonRow, what: AssistantPeople) -> str:
    """A person as a language model is told of them."""
    if what == "numbers" or not person.known:
        return f"person {person.number}"
    if what == "names":
        return person.name
    details = (person.group and f"group {person.group}", ", ".join(person.tags), person.note, person.summary)
    known = "; ".join(filter(None, details))
    return f"{person.name} ({known})" if known else person.name
