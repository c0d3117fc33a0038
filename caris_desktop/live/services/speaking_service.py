"""Speaking service: template values, placeholder questions, edits of the queue, and gestures of utterances."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from PySide6.QtCore import QObject

from caris_desktop.conversation.placeholders import NAME, Words, fill_placeholders, missing
from caris_desktop.domain import intents
from caris_desktop.domain.actor import WIZARD, Actor
from caris_desktop.domain.events import PersonForgotten, PersonRenamed, UtteranceChanged
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.sound_values import PlayedSound
from caris_desktop.domain.translation import tr
from caris_desktop.live.addressee import addressee
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.bus import Bus
from caris_desktop.live.service import Follows, Handlers, Service
from caris_desktop.live.speech_history import SaidBefore
from caris_desktop.live.speech_queue import SpeechQueue
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import AskedGap
from caris_desktop.live.template_values import given_words, name_of, words_now
from caris_desktop.people.presence import is_unnamed_label
from caris_desktop.scenario.gestures import LOOK, NOD
from caris_desktop.scenario.phrases import PhraseEntry
from caris_desktop.scenario.scenario_model import Scenario


class SpeakingService(Service):
    """Front end of the queue: no placeholder is spoken, and no name is recorded."""

    def __init__(
        self,
        state: LiveState,
        bus: Bus,
        queue: SpeechQueue,
        said_before: Path,
        slow_work: BackgroundWorker,
        *,
        do: Callable[[Intent], str],
        parent: QObject,
    ) -> None:
        """``do`` sends the gesture of an utterance to the console, through the gate."""
        super().__init__(parent)
        self._state = state
        self._queue = queue
        self._do = do
        self._naming = False
        self._asked: intents.Say | None = None
        self._given: dict[str, str] = {}
        self._gestures: dict[str, UtteranceChanged] = {}
        self._faces: dict[str, str] = {}
        self._phrases: tuple[PhraseEntry, ...] = ()
        bus.tap(queue.on_played, (PlayedSound,))
        self._said_before = SaidBefore(state, said_before, slow_work, self._names)

    def handlers(self) -> Handlers:
        return {
            intents.Say: lambda asked: self._say(asked, {}),
            intents.FillGap: self._fill_gap,
            intents.MoveQueued: lambda asked: self._in_queue(self._queue.move(asked.utterance_id, asked.place)),
            intents.EditQueued: self._edit,
            intents.CancelQueued: lambda asked: self._in_queue(self._queue.cancel(asked.utterance_id, asked.actor)),
            intents.Silence: lambda asked: self._queue.silence(asked.actor),
        }

    def follows(self) -> Follows:
        return {
            UtteranceChanged: self._on_utterance,
            PersonRenamed: lambda _event: self._said_before.write(),
            PersonForgotten: lambda _event: self._said_before.forget(),
        }

    def use_scenario(self, scenario: Scenario) -> None:
        self._naming = scenario.permissions.naming_people
        if scenario.phrases != self._phrases:
            self._phrases = scenario.phrases
            self._state.choose_phrases(0)
            self._ask_for(None, "")

    def start(self) -> None:
        self._said_before.read()

    def _say(self, asked: intents.Say, given: dict[str, str]) -> None:
        person_id = asked.person_id or addressee(self._state)
        words = self._words(person_id, given)
        lacking = missing(asked.text, words)
        if lacking and asked.actor == WIZARD:
            self._given = given
            self._ask_for(replace(asked, person_id=person_id), lacking[0])
            return
        if lacking:
            raise _nobody_knows(lacking[0])
        said = self._filled(asked.text, words)
        utterance_id = self._queue.say(
            said.spoken, asked.origin, asked.actor,
            person_id=person_id, gesture=asked.gesture, recorded=said.recorded,
        )  # fmt: skip
        if asked.face:
            self._faces[utterance_id] = asked.face
        if asked.origin in ("typed", "dictated") and asked.actor == WIZARD:
            self._said_before.add(" ".join(asked.text.split()))

    def _fill_gap(self, asked: intents.FillGap) -> None:
        waiting, gap = self._asked, self._state.speech.value.gap
        self._ask_for(None, "")
        said = " ".join(asked.words.split())
        if waiting is not None and gap is not None and said:
            self._say(waiting, self._given | {gap.gap: said})

    def _ask_for(self, asked: intents.Say | None, gap: str) -> None:
        self._asked = asked
        speech = self._state.speech
        speech.set(replace(speech.value, gap=None if asked is None else AskedGap(asked.text, gap)))

    def _edit(self, asked: intents.EditQueued) -> None:
        event = self._queue.waiting(asked.utterance_id)
        if event is None:
            raise _said_already()
        words = self._words(event.person_id, {})
        lacking = missing(asked.text, words)
        if lacking:
            raise _nobody_knows(lacking[0])
        said = self._filled(asked.text, words)
        self._in_queue(self._queue.edit(asked.utterance_id, said.spoken, asked.actor, recorded=said.recorded))

    def _in_queue(self, done: bool) -> None:
        if not done:
            raise _said_already()

    def _words(self, person_id: str, given: dict[str, str]) -> dict[str, Words]:
        known = words_now(self._state, person_id, naming=self._naming)
        return known | {gap: given_words(gap, said, person_id) for gap, said in given.items()}

    def _filled(self, text: str, words: dict[str, Words]) -> Words:
        def named(person_id: str) -> str:
            name = name_of(self._state, person_id, naming=self._naming)
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
                self._state.fillers_said.set(self._state.fillers_said.value + 1)
            return
        gesture = self._gestures.pop(event.utterance_id, None)
        face = self._faces.pop(event.utterance_id, "")
        if event.state == "started":
            if gesture is not None:
                self._gesture(gesture)
            if face:
                self._do(intents.ShowExpression(face, actor=event.actor))

    def _gesture(self, asked: UtteranceChanged) -> None:
        """Perform the gesture; a refusal by the gate does not stop the speech."""
        actor: Actor = asked.actor
        if asked.gesture == NOD:
            self._do(intents.Nod(actor=actor))
        elif asked.gesture == LOOK:
            bearing = next(
                (row.bearing_rad for row in self._state.persons.value if row.person_id == asked.person_id), None
            )
            if bearing is not None:
                self._do(intents.LookAt(bearing, 0.0, actor=actor))
        else:
            self._do(intents.UseControl(asked.gesture, True, actor=actor))


def _said_already() -> UserFacingError:
    return UserFacingError(
        tr("That utterance has already started or ended."),
        tr("The utterance is unchanged."),
        tr("Use Silence to interrupt it."),
        severity="info",
    )


def _nobody_knows(gap: str) -> UserFacingError:
    who = tr("No person here has a name.") if gap == NAME else tr("There is no text for {{{gap}}}.").format(gap=gap)
    return UserFacingError(who, tr("The phrase was not said."), tr("Write it out, without braces."), severity="info")
