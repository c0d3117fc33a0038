"""Complete transcript and notes of a recorded session."""

import logging

from PySide6.QtCore import QObject

from caris_desktop.conversation.conversation_transcript import Turn, turns_of
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.state import LiveState
from caris_desktop.recording.session.session_marks import FinalMark, final_marks, notes_among
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session.utterances import UTTERANCE_STREAMS

_log = logging.getLogger(__name__)


class ReplayTranscript(QObject):
    """Sets ``state.transcript`` and ``state.notes`` once, including later corrections.

    Both are read in a background thread.
    """

    def __init__(self, session: Session, state: LiveState, parent: QObject) -> None:
        super().__init__(parent)
        self._session = session
        self._state = state
        self._slow_work = BackgroundWorker(self)

    def start(self) -> None:
        self._slow_work.do(self._read_turns, self._state.transcript.reset_value, self._on_failed)
        self._slow_work.do(self._read_notes, self._state.notes.reset_value, self._on_failed)

    def close(self) -> None:
        self._slow_work.finish(lambda _what, work: work())

    def _read_turns(self) -> tuple[Turn, ...]:
        turns = turns_of(value for _, value in self._session.values(*UTTERANCE_STREAMS))
        # An empty heard turn whose speaker was never determined, because the record ended or has a gap, is dropped.
        return tuple(turn for turn in turns if turn.text or turn.over or turn.origin != "heard")

    def _read_notes(self) -> tuple[FinalMark, ...]:
        return notes_among(final_marks(self._session))

    def _on_failed(self, failure: UserFacingError) -> None:
        _log.warning("%s %s", failure.what, failure.meaning)
