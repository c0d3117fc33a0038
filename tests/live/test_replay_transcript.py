"""Transcript of a recorded session: every turn, with corrections, in each format version."""

from pathlib import Path

import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication

from caris_desktop.conversation.conversation_transcript import in_order, turns_of
from caris_desktop.domain.events import Marked, UtteranceChanged, UtteranceCorrected
from caris_desktop.live.replay_console import ReplayTranscript
from caris_desktop.live.state import LiveState
from caris_desktop.recording.session.session_conversation import UTTERANCE_STREAMS
from caris_desktop.recording.session.session_data import spoken
from caris_desktop.recording.session.session_reader import open_session
from tests import recording
from tests.recording.told_session import at, tell
from tests.support.polling import wait_for


def test_all_turns_are_there_as_they_were_corrected(qapp: QApplication, tmp_path: Path) -> None:
    begun = UtteranceChanged(at(1.0), "p", "participant", "", "heard", "started", source="robot microphone")
    events = [
        begun, UtteranceChanged(at(2.0), "p", "participant", "Hello robber.", "heard", "finished"),
        UtteranceChanged(at(3.0), "r", "robot", "Hello.", "phrase", "started"),
        UtteranceCorrected(at(9.0), "p", text="Hello robot.", person_id="p-1", tags=("greets",)),
        Marked(at(4.0), "", "note", "n", at(3.5), note="Smiles #happy"),
        Marked(at(4.0), "Laughs", mark_id="m"),
    ]  # fmt: skip
    folder = tmp_path / "study" / "sessions" / "s"
    tell(folder, events, lasts_s=10)
    owner = QObject()
    state = LiveState(owner)
    transcript = ReplayTranscript(open_session(folder), state, owner)
    transcript.start()

    def read() -> bool:
        QApplication.processEvents()
        return bool(state.transcript.value and state.notes.value)

    try:
        wait_for(read, "the transcript", timeout_s=10.0)
        visitor_turn, robot_turn = state.transcript.value
        assert (visitor_turn.text, visitor_turn.heard_text, visitor_turn.person_id, visitor_turn.tags) == (
            "Hello robot.", "Hello robber.", "p-1", ("greets",),
        )  # fmt: skip
        assert (visitor_turn.started_ns, visitor_turn.ended_ns) == (at(1.0), at(2.0))
        (note,) = state.notes.value
        assert (note.start_ns, note.note, note.tags) == (at(3.5), "Smiles #happy", ("happy",))
        assert (robot_turn.text, robot_turn.started_ns, robot_turn.ended_ns) == ("Hello.", at(3.0), None)
    finally:
        transcript.close()
        state.close()


@pytest.mark.parametrize("version", [1, 2])
def test_sessions_of_earlier_versions_have_their_conversation(version: int) -> None:
    session = open_session(Path(recording.__file__).parent / "formats" / f"format-{version}", repair=False)
    turns = turns_of(value for _, value in session.values(*UTTERANCE_STREAMS))
    told = [(turn.speaker, turn.text) for turn in in_order(turns)]
    assert told
    assert told == [(item.speaker, item.text) for item in spoken(session) if item.said]
