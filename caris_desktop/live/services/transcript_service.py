"""Transcript service: turns of the session, with the wizard's corrections."""

from collections import OrderedDict, deque

from PySide6.QtCore import QObject

from caris_desktop.conversation.conversation_transcript import Transcript, UtteranceReport
from caris_desktop.conversation.listening.speaker_attribution import Here, PeopleHere, WizardsVoice, is_wizards
from caris_desktop.conversation.response_timing import ResponseTimes
from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE
from caris_desktop.domain.events import SessionStarted, SuggestionChanged, UtteranceChanged, UtteranceCorrected
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.sound_values import WIZARD_MICROPHONE, Hearing
from caris_desktop.domain.translation import tr
from caris_desktop.live.bus import Bus
from caris_desktop.live.service import Follows, Handlers, Service
from caris_desktop.live.state import LiveState
from caris_desktop.people.presence import PersonRow


class TranscriptService(Service):
    """Maintains ``state.transcript``, and applies corrections."""

    def __init__(self, state: LiveState, bus: Bus, parent: QObject) -> None:
        super().__init__(parent)
        self._state = state
        self._bus = bus
        self._transcript = Transcript()

    def handlers(self) -> Handlers:
        return {intents.CorrectUtterance: self._correct}

    def follows(self) -> Follows:
        return {UtteranceChanged: self._take, UtteranceCorrected: self._take, SessionStarted: self._restart}

    def _take(self, event: UtteranceReport) -> None:
        self._transcript.add(event)
        self._state.transcript.reset_value(self._transcript.turns)

    def _restart(self, event: SessionStarted) -> None:
        self._transcript.forget_before(event.stamp_ns)
        self._state.transcript.reset_value(self._transcript.turns)

    def _correct(self, intent: intents.CorrectUtterance) -> None:
        if self._transcript.turn(intent.utterance_id) is None:
            raise UserFacingError(
                tr("That utterance belongs to another session."), tr("Nothing was corrected."),
                tr("Correct it in the session in which it was said."), severity="warning",
            )  # fmt: skip
        text = None if intent.text is None else " ".join(intent.text.split())
        self._bus.publish(
            UtteranceCorrected(
                clock.now_ns(), intent.utterance_id, text, intent.speaker, intent.person_id, intent.tags, intent.actor
            )
        )


class ResponseTimeService(Service):
    """Response time service: the participant's waiting time per turn, published once known.

    Publishes ResponseTimed.
    """

    def __init__(self, bus: Bus, parent: QObject) -> None:
        super().__init__(parent)
        self._bus = bus
        self._times = ResponseTimes()

    def follows(self) -> Follows:
        return dict.fromkeys((UtteranceChanged, UtteranceCorrected, SuggestionChanged), self._take)

    def _take(self, event: UtteranceReport | SuggestionChanged) -> None:
        for timed in self._times.add(event, clock.now_ns()):
            self._bus.publish(timed)


_TURNS_AT_MOST = 20


class SpeakersService(Service):
    """Speaker service: assigns a participant's turns to people present; the wizard's are detected separately. GUI
    thread.

    Publishes assignments as corrections by the console, which the wizard can change with one key; nothing is learnt
    from them.
    """

    def __init__(self, state: LiveState, bus: Bus, parent: QObject) -> None:
        super().__init__(parent)
        self._state = state
        self._bus = bus
        self._here = PeopleHere()
        self._began: OrderedDict[str, int] = OrderedDict()
        self._wizards: deque[WizardsVoice] = deque(maxlen=_TURNS_AT_MOST)
        state.persons.changed.connect(self._on_people_changed)
        state.selected_person.changed.connect(self._on_people_changed)
        state.hearing_of(WIZARD_MICROPHONE).changed.connect(self._on_wizard_heard)

    def follows(self) -> Follows:
        return {UtteranceChanged: self._on_utterance}

    def who_speaks(self, utterance: UtteranceChanged) -> str:
        """Person id of the speaker; empty if uncertain."""
        return utterance.person_id or self._who_spoke(utterance)[0]

    def _who_spoke(self, utterance: UtteranceChanged) -> tuple[str, float]:
        started_ns = self._began.get(utterance.utterance_id, utterance.stamp_ns)
        return self._here.who_spoke(started_ns, max(started_ns + 1, utterance.stamp_ns))

    def _on_people_changed(self, _value: object) -> None:
        attended = self._state.selected_person.value
        rows: list[PersonRow] = self._state.persons.value
        self._here.note(
            clock.now_ns(),
            (Here(row.person_id, row.facing, row.distance_m, row.person_id == attended) for row in rows if row.here),
        )

    def _on_wizard_heard(self, hearing: Hearing) -> None:
        if hearing.speech_started_ns is None:
            return
        text = f"{hearing.committed} {hearing.tentative}"
        voice = WizardsVoice(hearing.speech_started_ns, hearing.silent_since_ns, text)
        if self._wizards and self._wizards[-1].started_ns == voice.started_ns:
            self._wizards.pop()
        self._wizards.append(voice)

    def _on_utterance(self, utterance: UtteranceChanged) -> None:
        if utterance.speaker != "participant" or utterance.origin != "heard":
            return
        if utterance.state == "started":
            self._began[utterance.utterance_id] = utterance.stamp_ns
            if len(self._began) > _TURNS_AT_MOST:
                self._began.popitem(last=False)
        if utterance.state != "finished":
            return
        started_ns = self._began.get(utterance.utterance_id, utterance.stamp_ns)
        wizards = is_wizards(utterance.text, started_ns, utterance.stamp_ns, self._wizards)
        person_id, confidence = ("", 0.0) if wizards or utterance.person_id else self._who_spoke(utterance)
        if wizards or person_id:
            self._bus.publish(
                UtteranceCorrected(
                    clock.now_ns(),
                    utterance.utterance_id,
                    speaker="wizard" if wizards else None,
                    person_id=person_id,
                    actor=CONSOLE,
                    person_confidence=round(confidence, 3) if person_id else None,
                )
            )
