"""Speaking service: template values, placeholder questions, edits of the queue, and gestures of utterances."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from caris_desktop.conversation.spoken_text import NAME, PLACE, Words, fill_placeholders, missing
from caris_desktop.domain import intents
from caris_desktop.domain.actor import WIZARD, Actor
from caris_desktop.domain.events import PersonForgotten, PersonRenamed, UtteranceChanged
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.person_marks import mark_of
from caris_desktop.domain.sound_values import PlayedSound
from caris_desktop.domain.translation import tr
from caris_desktop.live.service import ContextService, Follows, Handlers, ServiceContext
from caris_desktop.live.speech_history import SpeechHistory
from caris_desktop.live.speech_queue import SpeechQueue, addressee
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import OpenGap
from caris_desktop.people.presence import PersonRow, is_unnamed_label
from caris_desktop.scenario.phrases import LOOK, NOD, PhraseEntry
from caris_desktop.scenario.scenario_model import Scenario

# Template values of the robot's utterances: addressee's name, place.

_IN_PROGRESS = ("requested", "active")
_AT_PLACE_M = 4.0
"""Maximum distance at which the robot counts as being at a place."""


def name_of(state: LiveState, person_id: str, *, naming: bool) -> str:
    """Name given by the wizard; empty if there is none or naming is not permitted."""
    rows: tuple[PersonRow, ...] = (*state.persons.value, *state.everybody.value)
    row = next((row for row in rows if row.person_id == person_id), None)
    return row.name if naming and row is not None and not is_unnamed_label(row.name) else ""


def words_now(state: LiveState, person_id: str, *, naming: bool) -> dict[str, Words]:
    """Template values for an utterance to this person."""
    found = {}
    name, place = name_of(state, person_id, naming=naming), current_place(state)
    if name:
        found[NAME] = Words(name, mark_of(person_id))
    if place:
        found[PLACE] = Words(place, place)
    return found


def given_words(gap: str, value: str, person_id: str) -> Words:
    """Template value typed by the wizard. A name is not recorded, even if it belongs to no known person."""
    if gap != NAME:
        return Words(value, value)
    return Words(value, mark_of(person_id) if person_id else f"{{{NAME}}}")


def current_place(state: LiveState) -> str:
    """Name of the goal's place, else of the nearest place; empty if unknown."""
    goal = state.goal.value
    if goal is not None and goal.state in _IN_PROGRESS and goal.place:
        return str(goal.place)
    if state.pose.value is None or state.pose.freshness == "lost":
        return ""
    at = state.pose.value.pose_in_map
    away = [
        (math.hypot(place.pose_in_map.x_m - at.x_m, place.pose_in_map.y_m - at.y_m), place.name)
        for place in state.places.value
    ]
    distance_m, nearest = min(away, default=(math.inf, ""))
    return nearest if distance_m <= _AT_PLACE_M else ""


class SpeakingService(ContextService):
    """Front end of the queue: no placeholder is spoken, and no name is recorded."""

    def __init__(
        self, context: ServiceContext, queue: SpeechQueue, history_path: Path, *, do: Callable[[Intent], str]
    ) -> None:
        """``do`` sends the gesture of an utterance to the console, through the gate."""
        super().__init__(context)
        self._queue = queue
        self._do = do
        self._pending: intents.Say | None = None
        self._given: dict[str, str] = {}
        self._gestures: dict[str, UtteranceChanged] = {}
        self._faces: dict[str, str] = {}
        self._phrases: tuple[PhraseEntry, ...] = ()
        self._bus.tap(queue.on_played, (PlayedSound,))
        self._speech_history = SpeechHistory(self._state, history_path, self._slow_work, self._names)

    def handlers(self) -> Handlers:
        return {
            intents.Say: lambda intent: self._say(intent, {}),
            intents.FillGap: self._fill_gap,
            intents.MoveQueued: lambda intent: self._in_queue(self._queue.move(intent.utterance_id, intent.place)),
            intents.EditQueued: self._edit,
            intents.CancelQueued: lambda intent: self._in_queue(self._queue.cancel(intent.utterance_id, intent.actor)),
            intents.Silence: lambda intent: self._queue.silence(intent.actor),
        }

    def follows(self) -> Follows:
        return {
            UtteranceChanged: self._on_utterance,
            PersonRenamed: lambda _event: self._speech_history.write(),
            PersonForgotten: lambda _event: self._speech_history.forget(),
        }

    def use_scenario(self, scenario: Scenario) -> None:
        self._scenario = scenario
        if scenario.phrases != self._phrases:
            self._phrases = scenario.phrases
            self._state.choose_phrases(0)
            self._ask_for(None, "")

    def start(self) -> None:
        self._speech_history.read()

    def _say(self, intent: intents.Say, given: dict[str, str]) -> None:
        person_id = intent.person_id or addressee(self._state)
        words = self._words(person_id, given)
        lacking = missing(intent.text, words)
        if lacking and intent.actor == WIZARD:
            self._given = given
            self._ask_for(replace(intent, person_id=person_id), lacking[0])
            return
        if lacking:
            raise _nobody_knows(lacking[0])
        filled = self._filled(intent.text, words)
        utterance_id = self._queue.say(
            filled.spoken, intent.origin, intent.actor,
            person_id=person_id, gesture=intent.gesture, recorded=filled.recorded,
        )  # fmt: skip
        if intent.face:
            self._faces[utterance_id] = intent.face
        if intent.origin in ("typed", "dictated") and intent.actor == WIZARD:
            self._speech_history.add(" ".join(intent.text.split()))

    def _fill_gap(self, intent: intents.FillGap) -> None:
        waiting, gap = self._pending, self._state.speech.value.gap
        self._ask_for(None, "")
        value = " ".join(intent.words.split())
        if waiting is not None and gap is not None and value:
            self._say(waiting, self._given | {gap.gap: value})

    def _ask_for(self, intent: intents.Say | None, gap: str) -> None:
        self._pending = intent
        self._state.speech.update(gap=None if intent is None else OpenGap(intent.text, gap))

    def _edit(self, intent: intents.EditQueued) -> None:
        event = self._queue.waiting(intent.utterance_id)
        if event is None:
            raise _already_spoken()
        words = self._words(event.person_id, {})
        lacking = missing(intent.text, words)
        if lacking:
            raise _nobody_knows(lacking[0])
        filled = self._filled(intent.text, words)
        self._in_queue(self._queue.edit(intent.utterance_id, filled.spoken, intent.actor, recorded=filled.recorded))

    def _in_queue(self, done: bool) -> None:
        if not done:
            raise _already_spoken()

    def _words(self, person_id: str, given: dict[str, str]) -> dict[str, Words]:
        known = words_now(self._state, person_id, naming=self._scenario.permissions.naming_people)
        return known | {gap: given_words(gap, value, person_id) for gap, value in given.items()}

    def _filled(self, text: str, words: dict[str, Words]) -> Words:
        def named(person_id: str) -> str:
            name = name_of(self._state, person_id, naming=self._scenario.permissions.naming_people)
            if not name:
                raise _nobody_knows(NAME)
            return name

        return fill_placeholders(text, words, named)

    def _names(self) -> list[str]:
        rows = (*self._state.persons.value, *self._state.everybody.value)
        return [row.name for row in rows if row.name and not is_unnamed_label(row.name)]

    def _on_utterance(self, event: UtteranceChanged) -> None:
        if event.speaker != "robot":
            return
        if event.state == "requested":
            if event.gesture:
                self._gestures[event.utterance_id] = event
            if event.origin == "filler":
                self._state.fillers_spoken.set(self._state.fillers_spoken.value + 1)
            return
        gesture = self._gestures.pop(event.utterance_id, None)
        face = self._faces.pop(event.utterance_id, "")
        if event.state == "started":
            if gesture is not None:
                self._gesture(gesture)
            if face:
                self._do(intents.ShowExpression(face, actor=event.actor))

    def _gesture(self, event: UtteranceChanged) -> None:
        """Perform the gesture; a refusal by the gate does not stop the speech."""
        actor: Actor = event.actor
        if event.gesture == NOD:
            self._do(intents.Nod(actor=actor))
        elif event.gesture == LOOK:
            bearing = next(
                (row.bearing_rad for row in self._state.persons.value if row.person_id == event.person_id), None
            )
            if bearing is not None:
                self._do(intents.LookAt(bearing, 0.0, actor=actor))
        else:
            self._do(intents.UseControl(event.gesture, True, actor=actor))


def _already_spoken() -> UserFacingError:
    return UserFacingError(
        tr("That utterance has already started or ended."),
        tr("The utterance is unchanged."),
        tr("Use Silence to interrupt it."),
        severity="info",
    )


def _nobody_knows(gap: str) -> UserFacingError:
    who = tr("No person here has a name.") if gap == NAME else tr("There is no text for {{{gap}}}.").format(gap=gap)
    return UserFacingError(who, tr("The phrase was not said."), tr("Write it out, without braces."), severity="info")
