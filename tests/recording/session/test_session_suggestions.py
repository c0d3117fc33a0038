"""Outcome of every displayed suggestion, from the files of the session alone: exactly one."""

import os
import signal
from collections import Counter
from dataclasses import replace
from pathlib import Path

from caris_desktop.domain import clock
from caris_desktop.domain.events import SuggestionChanged
from caris_desktop.recording.recorder.recorder_messages import RecorderReport
from caris_desktop.recording.session.session_conversation import replies_of
from caris_desktop.recording.session.session_data import read_data
from caris_desktop.recording.session.session_reader import open_session
from tests.recording.driving import RecorderUnderTest, start
from tests.support.polling import wait_for

SHOWN = SuggestionChanged(10, "s-1", "displayed", "t-1", 1, 1, "It stops.", "small", 420.0, actor="model")
FATES = ("taken", "edited", "dismissed", "superseded", "expired")


def test_each_fate_is_read_as_it_was_reported() -> None:
    changes = []
    for number, fate in enumerate(FATES):
        shown = replace(SHOWN, suggestion_id=f"s-{number}", stamp_ns=10 + number)
        changes += [shown, replace(shown, state=fate, stamp_ns=100 + number, edit_distance=3, actor="wizard")]
    replies = replies_of(changes, ends_ns=(1000,))
    assert [(reply.fate, reply.ended_ns, reply.told) for reply in replies] == [
        (fate, 100 + number, True) for number, fate in enumerate(FATES)
    ]
    assert (replies[1].edit_distance, replies[1].latency_ms, replies[1].actor) == (3, 420.0, "wizard")


def test_undisplayed_suggestions_and_second_fates_are_left_out() -> None:
    taken = replace(SHOWN, state="taken", stamp_ns=20)
    assert replies_of([taken], ends_ns=(1000,)) == ()
    replies = replies_of([SHOWN, taken, replace(taken, state="expired")], ends_ns=(1000,))
    assert [reply.fate for reply in replies] == ["taken"]


def test_open_suggestions_expire_at_a_pause_or_the_end_as_unreported() -> None:
    later = replace(SHOWN, suggestion_id="s-2", stamp_ns=600)
    replies = replies_of([SHOWN, later], ends_ns=(500, 1000))
    assert [(reply.fate, reply.ended_ns, reply.told) for reply in replies] == [
        ("expired", 500, False),
        ("expired", 1000, False),
    ]


def test_after_kill_9_each_still_has_one(tmp_path: Path) -> None:
    recorder, folder = RecorderUnderTest(), tmp_path / "session"
    try:
        recorder.send(start(folder))
        recorder.wait_for(RecorderReport, state="recording")
        for number in range(30):
            shown = replace(SHOWN, suggestion_id=f"s-{number}", stamp_ns=clock.now_ns())
            recorder.send(shown)
            if number < 27:
                recorder.send(replace(shown, state=FATES[number % 5], stamp_ns=clock.now_ns()))
        wait_for(
            lambda: len(read_data(open_session(folder, repair=False)).suggestions) == 30,
            "what was shown is on the disk",
        )
        assert recorder.process.pid is not None
        os.kill(recorder.process.pid, signal.SIGKILL)
        recorder.process.join()
    finally:
        recorder.close()
    session = open_session(folder)
    replies = read_data(session).suggestions
    assert session.reason == "recovered"
    assert len(replies) == 30 and len({reply.suggestion_id for reply in replies}) == 30
    assert Counter(reply.told for reply in replies) == {True: 27, False: 3}
    assert all(reply.fate == "expired" and reply.ended_ns == session.ended_ns for reply in replies if not reply.told)
