"""Suggestion service: replies requested at each pause of a participant, streamed, and said by key."""

import re
import secrets
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal, get_args

from PySide6.QtCore import QTimer

from caris_desktop.conversation.conversation_transcript import Turn
from caris_desktop.conversation.suggestions import prompt, proposable_actions
from caris_desktop.conversation.suggestions.prompt import fit_to_say, replies_in, same_words
from caris_desktop.conversation.suggestions.suggestion_cycle import (
    Card,
    FillerWait,
    Proposals,
    Round,
    Suggested,
    SuggestionCycle,
)
from caris_desktop.domain import clock, intents, person_marks
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import (
    AssistanceLevel,
    AssistedFunction,
    ChatMessage,
    LevelChanged,
    LlmExchange,
    Marked,
    UtteranceChanged,
    UtteranceCorrected,
)
from caris_desktop.domain.failure import RefusedError, UserFacingError
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.sound_values import PARTICIPANT_SOURCES, Hearing
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.model_client import ModelClient
from caris_desktop.live.service import ContextService, Follows, Handlers, ServiceContext
from caris_desktop.live.services.assistant_service import describe_person
from caris_desktop.live.services.speaking_service import current_place
from caris_desktop.live.speech_queue import SpeechQueue, addressee
from caris_desktop.live.status import DisplayedReply, LevelsStatus, ProposalStatus, SuggestionsStatus
from caris_desktop.people.presence import PersonRow
from caris_desktop.scenario.scenario_model import AssistantPeople, Scenario, levels_up_to

# Proposal service: actions proposed by the language model, run after the wizard's confirmation.

# The most likely action is wanted; there is no wording to vary.
_TEMPERATURE = 0.0


class ProposalsService(ContextService):
    """Maintains ``state.proposal``. ``do`` sends intents to the console, as a key does."""

    def __init__(self, context: ServiceContext, model: ModelClient, *, do: Callable[[Intent], str]) -> None:
        super().__init__(context)
        self._model = model
        self._do = do
        self._asking = ""
        self._proposals = Proposals(self._bus.publish, lambda: f"a-{secrets.token_hex(4)}")
        self._timer = new_timer(self, self._on_time, single_shot=True, precise=True)
        self._state.levels.changed.connect(self._on_levels_changed)

    def handlers(self) -> Handlers:
        return {intents.ConfirmProposal: self._confirm, intents.VetoProposal: self._veto}

    def use_scenario(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self.drop(QT_TR_NOOP("another scenario was opened"))

    def _on_levels_changed(self, levels: LevelsStatus) -> None:
        if levels.actions == "off":
            self.drop(QT_TR_NOOP("the wizard turned off proposals"))
        elif levels.actions == "suggest":
            self._proposals.wait_for_key()
            self._show()

    def stop(self) -> None:
        self.drop(QT_TR_NOOP("the program is closing"))

    def ask_about(
        self, begun: Round, messages: Sequence[ChatMessage], recorded: Sequence[ChatMessage], replies: str
    ) -> None:
        """Ask which actions fit, after the model was asked for ``replies``."""
        offer = self._offer()
        if self._state.levels.value.actions == "off" or not offer.actions:
            return
        self._cancel(QT_TR_NOOP("a newer question was asked"))
        try:
            self._asking = self._model.ask(
                prompt.action_messages(messages, replies, offer),
                recorded=prompt.action_messages(recorded, replies, offer),
                purpose="actions",
                max_tokens=prompt.ACTION_TOKENS,
                temperature=_TEMPERATURE,
                schema=proposable_actions.schema_of(offer),
                turn_id=begun.turn_id,
                revision=begun.revision,
                on_text=lambda _text: None,
                on_end=lambda exchange: self._on_answer(begun, offer, exchange),
            )
        except UserFacingError:
            self._asking = ""  # a missing model is reported with the replies

    def drop(self, reason: str) -> None:
        """Drop proposals whose subject is over."""
        self._cancel(reason)
        self._proposals.lapse(clock.now_ns(), reason)
        self._show()

    def _offer(self) -> proposable_actions.Offer:
        state, robot = self._state, self._state.robot.value
        head = robot.head if robot is not None else None
        return proposable_actions.proposable_here(
            self._scenario.permissions,
            places=[place.name for place in state.places.value],
            controls=state.controls.value,
            pan_range_rad=head.pan_range_rad if head is not None else None,
            tilt_range_rad=head.tilt_range_rad if head is not None else None,
        )

    def _cancel(self, reason: str) -> None:
        asking, self._asking = self._asking, ""
        self._model.cancel(asking, reason)

    def _on_answer(self, begun: Round, offer: proposable_actions.Offer, exchange: LlmExchange) -> None:
        if self._asking != exchange.exchange_id:
            return  # no longer needed
        self._asking = ""
        if exchange.outcome != "answered":
            return
        now_ns = clock.now_ns()
        try:
            proposed = proposable_actions.proposed_in(exchange.answer, offer)
        except proposable_actions.NotOfferedError as refused:
            self._proposals.refuse(begun, exchange.model, str(refused), now_ns)
            return
        if proposed is not None:
            acts = self._state.levels.value.actions == "act"
            countdown_ns = int(self._scenario.assistance.countdown_s * 1e9)
            self._proposals.offer(begun, proposed, exchange.model, now_ns, acts_after_ns=countdown_ns if acts else None)
            self._show()

    def _confirm(self, intent: intents.ConfirmProposal) -> None:
        card = self._proposals.answered(intent.proposal_id, clock.now_ns())
        if card is None:
            self._show()
            raise UserFacingError(
                tr("That proposal is no longer available."), tr("Nothing was done."),
                tr("Do it yourself if it is still needed."),
                severity="info",
            )  # fmt: skip
        self._carry_out(card, intent.actor)

    def _veto(self, intent: intents.VetoProposal) -> None:
        if self._proposals.answered(intent.proposal_id, clock.now_ns(), readable=False) is not None:
            self._proposals.end("vetoed", clock.now_ns(), intent.actor)
        self._show()

    def _carry_out(self, card: Card, actor: Actor) -> None:
        refused = self._do(replace(card.proposed.intent, actor=actor))
        self._proposals.end("refused" if refused else "confirmed", clock.now_ns(), actor, refused)
        self._show()

    def _on_time(self) -> None:
        now_ns = clock.now_ns()
        card = self._proposals.due(now_ns)
        if card is not None:
            self._carry_out(card, CONSOLE)
        self._proposals.pass_time(now_ns)
        self._show()

    def _show(self) -> None:
        card = self._proposals.card
        self._state.proposal.set(
            ProposalStatus()
            if card is None
            else ProposalStatus(
                card.proposal_id, card.proposed.words, card.proposed.moves, card.model,
                card.from_ns, card.lapses_ns, card.acts_ns,
            )
        )  # fmt: skip
        next_ns = self._proposals.next_ns
        if next_ns is None:
            self._timer.stop()
        else:
            self._timer.start(max(0, -(-(next_ns - clock.now_ns()) // 1_000_000)))


# The robot's last utterances are no replies to what followed.
_NOT_AGAIN = 2
_NUMBER = re.compile(r"^\s*\(?\d[.):]\s+")  # of a reply in a list
_FUNCTIONS: tuple[AssistedFunction, ...] = get_args(AssistedFunction)


class _Request(Value):
    """The model's prompt, for the wizard."""

    begun: Round
    messages: tuple[ChatMessage, ...]
    recorded: tuple[ChatMessage, ...]
    status: SuggestionsStatus


class SuggestionsService(ContextService):
    """Maintains ``state.suggestions`` and ``state.levels``, and says fillers when a reply is late."""

    def __init__(
        self,
        context: ServiceContext,
        model: ModelClient,
        *,
        speech: SpeechQueue,
        proposals: ProposalsService,
        scenario: Scenario,
    ) -> None:
        super().__init__(context)
        self._model = model
        self._speech = speech
        self._proposals = proposals
        self._scenario = scenario
        self._used: Scenario | None = None
        self._doing = ""
        self._rounds = SuggestionCycle(
            self._bus.publish, lambda: f"s-{secrets.token_hex(4)}", ask=self._ask, drop=self._drop
        )
        self._filler = FillerWait()
        self._request: _Request | None = None
        self._asking = ""
        self._read, self._written = 0, ""
        self._read_ahead_of = ""
        self._detail = ""
        self._timer = new_timer(self, self._on_time, single_shot=True, precise=True)
        model.model_changed.connect(self._on_model_changed)
        for source in PARTICIPANT_SOURCES:
            self._state.hearing_of(source).changed.connect(self._on_hearing)

    def handlers(self) -> Handlers:
        return {
            intents.SaySuggestion: self._say,
            intents.SayEditedSuggestion: self._say_edited,
            intents.DismissSuggestions: self._dismiss,
            intents.SetLevel: self._set_level,
        }

    def follows(self) -> Follows:
        return {UtteranceChanged: self._on_utterance, UtteranceCorrected: self._on_correction, Marked: self._on_marked}

    def use_scenario(self, scenario: Scenario) -> None:
        before, self._scenario = self._used, scenario
        self._used = scenario
        if before is not None and _assisted_alike(before, scenario):
            return  # as when a place was saved: the wizard's levels stay
        self.forget()
        for function in _FUNCTIONS:
            self._use_level(function, scenario.highest_level(function), CONSOLE)

    def stop(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Discard everything: another participant comes, or the recording pauses."""
        self._doing = ""
        self._filler.spoken()
        self._rounds.forget(clock.now_ns())
        self._proposals.drop(QT_TR_NOOP("the conversation is over"))
        self._show()

    # Conversation events

    def _on_hearing(self, hearing: Hearing) -> None:
        if hearing.speaking and hearing.speaker in ("", "participant"):
            self._filler.spoken()
            self._proposals.drop(QT_TR_NOOP("the participant continues speaking"))
        if self._listens:
            self._rounds.add(hearing)
            if hearing.speaking and hearing.utterance_id != self._read_ahead_of:
                self._read_ahead_of = hearing.utterance_id
                if self._model.embedded:  # it preloads the conversation while the participant speaks
                    self._model.warm_up(self._earlier_messages(), "replies")
        self._show()

    def _on_utterance(self, utterance: UtteranceChanged) -> None:
        now_ns = clock.now_ns()
        if utterance.speaker == "robot":
            self._rounds.on_robot(utterance, now_ns)
            self._filler.spoken()
        elif utterance.speaker == "participant":
            if self._listens:
                self._rounds.on_participant(utterance, now_ns)
            if self._state.levels.value.fillers != "off" and self._scenario.filler:
                self._filler.turn_over(utterance, int(self._scenario.assistance.filler_after_s * 1e9))
        self._show()

    def _on_correction(self, correction: UtteranceCorrected) -> None:
        """Handle a correction of the turn that was replied to."""
        current = self._rounds.round
        if current is None or current.turn_id != correction.utterance_id:
            return
        if correction.speaker not in (None, "participant"):
            self._rounds.withdraw(QT_TR_NOOP("the participant did not speak"), clock.now_ns())
        elif correction.text is not None:
            self._rounds.reword(correction.text, clock.now_ns())
        self._show()

    def _on_marked(self, mark: Marked) -> None:
        if mark.state != "withdrawn" and mark.kind == "mark":
            self._doing = mark.label

    @property
    def _listens(self) -> bool:
        levels: LevelsStatus = self._state.levels.value
        return levels.replies != "off" or levels.actions != "off"

    # Callbacks of Rounds

    def _ask(self, begun: Round) -> None:
        """Callback of the rounds: a cycle begins."""
        self._read, self._written, self._detail = 0, "", ""
        self._proposals.drop(QT_TR_NOOP("the participant said more"))
        self._request = request = self._question(begun)
        settings = self._scenario.assistant
        if self._state.levels.value.replies == "off":
            self._proposals.ask_about(begun, request.messages, request.recorded, "")
            return
        try:
            self._asking = self._model.ask(
                request.messages,
                recorded=request.recorded,
                purpose="replies",
                max_tokens=prompt.REPLY_TOKENS,
                temperature=settings.temperature,
                schema=prompt.replies_schema(whole_sentences=self._model.embedded),
                turn_id=begun.turn_id,
                revision=begun.revision,
                on_text=lambda written: self._on_text(begun, written),
                on_end=lambda exchange: self._on_end(request, exchange),
            )
        except UserFacingError as failure:
            self._detail = failure.advice or failure.what

    def _on_model_changed(self) -> None:
        if self._model.embedded:
            self._model.warm_up_soon(lambda: self._earlier_messages() if self._listens else (), "replies")

    def _earlier_messages(self) -> Sequence[ChatMessage]:
        return self._question(Round("", 0, "", 0)).messages

    def _drop(self, reason: str) -> None:
        """Callback of the rounds: these replies are no longer needed."""
        asking, self._asking = self._asking, ""
        self._model.cancel(asking, reason)

    def _question(self, begun: Round) -> _Request:
        settings = self._scenario.assistant
        turns = prompt.reported_turns(
            turn for turn in self._state.transcript.value if turn.utterance_id != begun.turn_id
        )
        person_id = begun.person_id or addressee(self._state)
        place = current_place(self._state)
        doing = self._state.protocol.value.title or self._doing

        def messages(detail: AssistantPeople) -> tuple[ChatMessage, ...]:
            rows: list[PersonRow] = [row for row in self._state.persons.value if row.here]
            # The addressee comes first: of many people only some are listed.
            rows.sort(key=lambda row: row.person_id != person_id)
            labels = {row.person_id: describe_person(row, detail) for row in rows}

            def labelled(marked: str) -> str:
                return labels.get(marked, "somebody")

            return prompt.reply_messages(
                prompt.ReplyGrounds(
                    settings.system_prompt,
                    begun.text,
                    [replace(turn, text=person_marks.with_names(turn.text, labelled)) for turn in turns],
                    place,
                    doing,
                    list(labels.values()),
                ),
                with_examples=self._model.embedded,
            )

        naming = self._scenario.permissions.naming_people
        recorded = messages("numbers")
        return _Request(
            begun,
            messages(settings.people) if naming and settings.people != "numbers" else recorded,
            recorded,
            SuggestionsStatus(
                "asking", begun.turn_id, begun.revision, model=self._model.model,
                turns=len(turns) + 1, place=place, doing=doing, person_id=person_id,
            ),
        )  # fmt: skip

    def _goes_on(self, written: str) -> bool:
        """False if earlier text was the model's reasoning: replies offered from it are withdrawn."""
        before, self._written = self._written.strip(), written
        if written.startswith(before):
            return True
        self._rounds.ask_again(QT_TR_NOOP("it was the model's reasoning"), clock.now_ns())
        self._show()
        return False

    def _on_text(self, begun: Round, written: str) -> None:
        if not self._goes_on(written):
            return
        complete = replies_in(written)
        self._offer(begun, complete[self._read :])
        self._read = max(self._read, len(complete))
        self._show()

    def _on_end(self, request: _Request, exchange: LlmExchange) -> None:
        if self._asking != exchange.exchange_id:
            return  # this event reports its own cancellation
        if exchange.outcome == "answered" and not self._goes_on(exchange.answer):
            return
        self._asking = ""
        if exchange.outcome == "answered":
            # A server that ignores the schema writes one reply per line.
            self._offer(request.begun, replies_in(exchange.answer)[self._read :] or self._lines(exchange))
            self._detail = exchange.detail if exchange.cut else ""
            self._proposals.ask_about(request.begun, request.messages, request.recorded, exchange.answer)
        elif exchange.outcome == "cancelled" and not self._read:
            # The model was changed; the new one is set after this returns.
            QTimer.singleShot(0, self, lambda: self._ask_again(request))
        else:
            self._detail = exchange.detail
        self._show()

    def _ask_again(self, request: _Request) -> None:
        if self._request is request and self._rounds.round is not None and not self._asking:
            self._ask(request.begun)
            self._show()

    def _lines(self, exchange: LlmExchange) -> Sequence[str]:
        answer = exchange.answer
        if self._read or "{" in answer or "[" in answer:
            return ()
        return [_NUMBER.sub("", line) for line in answer.splitlines()[: -1 if exchange.cut else None]]

    def _offer(self, begun: Round, texts: Sequence[str]) -> None:
        """Show replies that can be spoken and do not repeat what was just said."""
        turns: tuple[Turn, ...] = self._state.transcript.value
        recent = [turn.text for turn in turns if turn.speaker == "robot" and turn.said][-_NOT_AGAIN:]
        for text in texts:
            fit = fit_to_say(text)
            if fit and not any(same_words(fit, each) for each in (begun.text, *recent)):
                self._rounds.offer(begun, self._with_marks(fit), self._model.model, clock.now_ns())

    def _with_marks(self, text: str) -> str:
        """Replace names by ids for the record."""
        for row in self._people():
            text = person_marks.marked(text, row.name, row.person_id) if row.known else text
        return text

    def _people(self) -> tuple[PersonRow, ...]:
        return (*self._state.persons.value, *self._state.everybody.value)

    # Intents

    def _say(self, intent: intents.SaySuggestion) -> None:
        card = self._rounds.card(intent.suggestion_id, clock.now_ns())
        if card is None or card.rank != intent.rank:
            self._show()
            raise UserFacingError(
                tr("That suggestion is no longer available."), tr("Nothing was said."),
                tr("Use one of the current suggestions, or type what to say."), severity="info",
            )  # fmt: skip
        self._say_card(card, card.text, intent.actor)

    def _say_edited(self, intent: intents.SayEditedSuggestion) -> None:
        card = self._rounds.card(intent.suggestion_id, clock.now_ns())
        recorded = self._with_marks(" ".join(intent.text.split()))
        if card is not None and recorded:
            self._say_card(card, recorded, intent.actor)
        else:
            # The conversation moved on during editing: the text now counts as the wizard's own.
            self._speech.say(intent.text, "typed", intent.actor, recorded=recorded)

    def _say_card(self, card: Suggested, recorded: str, actor: Actor) -> None:
        names = {row.person_id: row.name for row in self._people() if row.known}
        current = self._rounds.round
        person_id = current.person_id if current is not None else ""
        try:
            spoken = person_marks.with_names(recorded, names.__getitem__)
        except KeyError:
            raise RefusedError(
                tr("The name in that suggestion is no longer known."), tr("Nothing was said."),
                tr("Use another suggestion, or type what to say."),
            ) from None  # fmt: skip
        utterance_id = self._speech.say(spoken, "suggestion", actor, person_id=person_id, recorded=recorded)
        self._rounds.accept(card, recorded, utterance_id, actor, clock.now_ns())
        self._filler.spoken()
        self._show()

    def _dismiss(self, intent: intents.DismissSuggestions) -> None:
        self._filler.spoken()
        self._rounds.dismiss(intent.actor, clock.now_ns())
        self._show()

    # Autonomy levels

    def _set_level(self, intent: intents.SetLevel) -> None:
        highest = self._scenario.highest_level(intent.function)
        if intent.level not in levels_up_to(highest):
            raise RefusedError(
                tr("This scenario does not allow a level above “{highest}” for {function}.").format(
                    highest=highest, function=intent.function
                ),
                tr("The level is unchanged."),
                tr("Change the highest level under assistance in the scenario."),
            )
        self._use_level(intent.function, intent.level, intent.actor)

    def _use_level(self, function: AssistedFunction, level: AssistanceLevel, actor: Actor) -> None:
        levels: LevelsStatus = self._state.levels.value
        if getattr(levels, function) == level:
            return
        self._bus.publish(LevelChanged(clock.now_ns(), function, level, actor))
        self._state.levels.update(**{function: level})
        if function == "replies" and level == "off":
            self._rounds.withdraw(QT_TR_NOOP("the wizard turned off suggestions"), clock.now_ns())
        if function == "fillers" and level == "off":
            self._filler.spoken()
        self._show()

    # Timer

    def _on_time(self) -> None:
        now_ns = clock.now_ns()
        self._rounds.pass_time(now_ns)
        card = self._rounds.due(now_ns)
        if card is not None:
            self._say_card(card, card.text, CONSOLE)
        if self._state.levels.value.fillers == "act" and self._filler.due(now_ns):
            filler = self._scenario.next_filler(self._state.fillers_spoken.value)
            self._speech.say(filler, "filler", CONSOLE)
        self._show()

    def _show(self) -> None:
        levels, now_ns = self._state.levels.value, clock.now_ns()
        rounds = self._rounds
        acts = levels.replies == "act"
        rounds.acts_after_ns = int(self._scenario.assistance.countdown_s * 1e9) if acts else None
        says_ns = rounds.says_ns
        status = SuggestionsStatus("off" if levels.replies == "off" else "idle", detail=self._detail)
        if rounds.round is not None and self._request is not None and levels.replies != "off":
            cards = tuple(
                DisplayedReply(card.suggestion_id, card.rank, card.text, card.from_ns) for card in rounds.cards
            )
            status = replace(
                self._request.status,
                state=self._progress(cards),
                cards=cards,
                says_ns=says_ns,
                detail=self._detail,
            )
        self._state.suggestions.set(replace(status, filler_ns=self._filler.due_ns))
        moments = [rounds.next_ns, self._filler.due_ns if levels.fillers == "act" else None]
        if says_ns is not None and (says_ns >= now_ns or rounds.due(now_ns) is not None):
            moments.append(says_ns)
        next_ns = min((moment for moment in moments if moment is not None), default=None)
        if next_ns is not None:
            # A deadline that passed since the last check is due now.
            self._timer.start(max(0, (next_ns - now_ns) // 1_000_000 + 1))
        else:
            self._timer.stop()

    def _progress(self, cards: Sequence[DisplayedReply]) -> Literal["asking", "shown", "failed", "idle"]:
        if cards:
            return "shown"
        if self._asking:
            return "asking"
        return "failed" if self._detail else "idle"


def _assisted_alike(before: Scenario, now: Scenario) -> bool:
    """Whether language model and levels are unchanged."""
    return (before.path, before.permissions, before.assistance, before.assistant) == (
        now.path,
        now.permissions,
        now.assistance,
        now.assistant,
    )
