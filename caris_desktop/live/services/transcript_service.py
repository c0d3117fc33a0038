"""Transcript service: turns of the session, with the wizard's corrections."""

from PySide6.QtCore import QObject

from caris_desktop.conversation.conversation_transcript import Transcript, UtteranceReport
from caris_desktop.domain import clock, intents
from caris_desktop.domain.events import SessionStarted, UtteranceChanged, UtteranceCorrected
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.translation import tr
from caris_desktop.live.bus import Bus
from caris_desktop.live.service import Follows, Handlers, Service
from caris_desktop.live.state import LiveState


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
        self._transcript.take(event)
        self._state.transcript.reset_value(self._transcript.turns)

    def _restart(self, event: SessionStarted) -> None:
        self._transcript.forget_before(event.stamp_ns)
        self._state.transcript.reset_value(self._transcript.turns)

    def _correct(self, asked: intents.CorrectUtterance) -> None:
        if self._transcript.turn(asked.utterance_id) is None:
            raise UserFacingError(
                tr("That utterance belongs to another session."), tr("Nothing was corrected."),
                tr("Correct it in the session in which it was said."), severity="warning",
            )  # fmt: skip
        text = None if asked.text is None else " ".join(asked.text.split())
        self._bus.publish(
            UtteranceCorrected(
                clock.now_ns(), asked.utterance_id, text, asked.speaker, asked.person_id, asked.tags, asked.actor
            )
        )
