"""Suggestion and proposal services with a simulated clock and a scripted model."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from PySide6.QtCore import QObject, Signal

from caris_desktop.domain import clock
from caris_desktop.domain.events import ChatMessage, LlmExchange, SuggestionChanged, UtteranceChanged
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE, Hearing
from caris_desktop.live.bus import Bus
from caris_desktop.live.gate import Gate
from caris_desktop.live.services.people_service import TranscriptService
from caris_desktop.live.services.suggestions_service import ProposalsService, SuggestionsService
from caris_desktop.live.speech_queue import SpeechQueue
from caris_desktop.live.state import LiveState, PresentClock
from caris_desktop.scenario.scenario_model import AssistanceSettings, PanelLeaf, Scenario
from tests.support.service_context import context_of

MS = 1_000_000
REPLIES = json.dumps({"answer": "It stops at once.", "ask": "Shall we go there?", "more": "There is a zone around it."})
EVERYTHING = AssistanceSettings("act", "act", "act", countdown_s=2.0, filler_after_s=1.0)


class Question:
    """One question to the model, answered by the test."""

    def __init__(self, messages: Any, told: dict[str, Any], exchange_id: str) -> None:
        self.messages = messages
        self.told = told
        self.exchange_id = exchange_id
        self.over = False

    def cancel(self, _why: str) -> None:
        self._end("", "cancelled")

    def write(self, text: str) -> None:
        if not self.over:
            self.told["on_text"](text)

    def answer(self, text: str) -> None:
        self._end(text, "answered")

    def fail(self) -> None:
        self._end("", "failed")

    def _end(self, text: str, outcome: Any) -> None:
        if not self.over:
            self.over = True
            self.told["on_end"](
                LlmExchange(0, self.exchange_id, "fake", "small", (), text, outcome, 0, 1, {}, "It is busy. Wait.")
            )


class FakeModel(QObject):
    """Model double that records questions and leaves the answers to the test. ``read`` are the prompts to preload."""

    model_changed = Signal()
    model = "small"
    embedded = False

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[Question] = []
        self.read: list[tuple[ChatMessage, ...]] = []
        self.there = True

    def warm_up(self, messages: Any, purpose: str) -> None:
        assert purpose == "replies"
        self.read.append(messages)

    def warm_up_soon(self, messages: Any, purpose: str) -> None:
        if messages():
            self.warm_up(messages(), purpose)

    def ask(self, messages: Any, **told: Any) -> str:
        if not self.there:
            raise UserFacingError("The assistant cannot answer now.", "No question was sent.", "It is starting.")
        self.asked.append(Question(messages, told, f"x-{len(self.asked)}"))
        return self.asked[-1].exchange_id

    def cancel(self, exchange_id: str, reason: str) -> None:
        for question in self.asked:
            if question.exchange_id == exchange_id:
                question.cancel(reason)

    def of(self, purpose: str) -> list[Question]:
        return [question for question in self.asked if question.told["purpose"] == purpose]


class FakeVoice:
    held_up = False

    def __init__(self) -> None:
        self.spoken: list[str] = []

    def say(self, _utterance: UtteranceChanged, spoken: str) -> bool:
        self.spoken.append(spoken)
        return True

    def silence(self, _actor: str) -> bool:
        return True


@dataclass
class Desk:
    """The two services with their environment. ``done`` are the intents executed after passing the gate."""

    now_ns: int
    state: LiveState
    bus: Bus
    suggestions: SuggestionsService
    proposals: ProposalsService
    model: FakeModel
    voice: FakeVoice
    gate: Gate
    scenario: Scenario
    done: list[Intent] = field(default_factory=list)
    told: list[Any] = field(default_factory=list)
    by_kind: dict[type[Any], list[Any]] = field(default_factory=dict)
    turns: int = 0

    def of(self, kind: type[Any]) -> list[Any]:
        return self.by_kind.get(kind, [])

    def take_down(self, value: Any) -> None:
        self.told.append(value)
        self.by_kind.setdefault(type(value), []).append(value)

    def fates(self) -> list[tuple[int, str]]:
        return [(event.rank, event.state) for event in self.of(SuggestionChanged) if event.state != "displayed"]

    @property
    def cards(self) -> list[str]:
        return [card.text for card in self.state.suggestions.value.cards]

    def do(self, intent: Intent) -> str:
        """Execute an intent if the gate permits it, as the console does."""
        refusal = self.gate.refusal(intent)
        if refusal is not None:
            return refusal.what
        for service in (self.suggestions, self.proposals):
            handler = service.handlers().get(type(intent))
            if handler is not None:
                try:
                    handler(intent)
                except UserFacingError as failure:
                    return failure.what
                self.bus.take_in()
                return ""
        self.done.append(intent)
        return ""

    def use(self, **changes: Any) -> None:
        self.scenario = replace(self.scenario, **changes)
        self.state.scenario.set(self.scenario)
        self.proposals.use_scenario(self.scenario)
        self.suggestions.use_scenario(self.scenario)
        self.bus.take_in()

    def wait(self, milliseconds: float) -> None:
        """Advance the clock and fire the timers of both services when due."""
        end_ns = self.now_ns + round(milliseconds * MS)
        while self.now_ns < end_ns:
            self.now_ns = min(end_ns, self.now_ns + 50 * MS)
            self.suggestions._on_time()
            self.proposals._on_time()
            self.bus.take_in()

    def hear(self, hearing: Hearing) -> None:
        self.bus.publish(hearing)
        self.bus.take_in()

    def speak_on(self) -> None:
        self.hear(Hearing(self.now_ns, ROBOT_MICROPHONE, True, "participant", f"t-{self.turns}", revision=self.turns))

    def finish(self, text: str = "Can it hurt people?", person_id: str = "") -> None:
        """End a participant's turn whose last word is spoken now."""
        self.turns += 1
        self.hear(Hearing(self.now_ns, ROBOT_MICROPHONE, False))
        self.publish(
            UtteranceChanged(
                self.now_ns, f"t-{self.turns}", "participant", text, "heard", "finished", person_id=person_id
            )
        )

    def publish(self, event: Any) -> None:
        self.bus.publish(event)
        self.bus.take_in()

    def question(self, text: str = "Can it hurt people?") -> Question:
        """Question for replies to a turn that has just ended."""
        before = len(self.model.asked)
        self.finish(text)
        self.wait(250)
        return self.model.asked[before]


@contextmanager
def desk_on_its_own_clock(monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    parent = QObject()
    monkeypatch.setattr(clock, "now_ns", lambda: desk.now_ns if desk is not None else 0)
    desk: Desk | None = None
    state = LiveState(parent, present=PresentClock(lambda: clock.now_ns()))
    state.close()
    bus = Bus(state, parent)
    model, voice = FakeModel(), FakeVoice()
    speech = SpeechQueue(state, {"robot": voice, "computer": voice}, bus.publish, parent)
    scenario = Scenario("Tour", PanelLeaf("speak"), filler="Let me think.")
    context = context_of(state, bus, parent)
    proposals = ProposalsService(context, model, do=lambda intent: made.do(intent))
    suggestions = SuggestionsService(context, model, speech=speech, proposals=proposals, scenario=scenario)
    gate = Gate(state, lambda: made.scenario.permissions)
    made = desk = Desk(1_000_000 * MS, state, bus, suggestions, proposals, model, voice, gate, scenario)
    bus.tap(lambda value, _raw: made.take_down(value))
    for service in (suggestions, TranscriptService(context)):
        bus.follow(service.follows())
    made.use()
    state.link.set(replace(state.link.value, state="connected"))
    try:
        yield made
    finally:
        suggestions.stop()
        proposals.stop()
        bus.end()
        parent.deleteLater()
