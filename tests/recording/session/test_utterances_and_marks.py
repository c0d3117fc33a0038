"""Utterances and marks assembled from events."""

from dataclasses import replace
from pathlib import Path

from caris_desktop.domain import clock
from caris_desktop.domain.events import (
    Marked,
    RecordingPaused,
    UtteranceChanged,
    UtteranceCorrected,
    UtteranceState,
)
from caris_desktop.recording.session.session_conversation import spoken_utterances
from caris_desktop.recording.session.session_data import read_data, spoken
from caris_desktop.recording.session.session_marks import FinalMark, final_marks_of
from caris_desktop.recording.session.session_reader import open_session
from tests.recording.session.test_session_reader import record


def said(stamp_ns: int, utterance_id: str, state: UtteranceState, **fields: str) -> UtteranceChanged:
    event = UtteranceChanged(stamp_ns, utterance_id, "robot", f"text of {utterance_id}", "typed", state)
    return replace(event, **fields)  # type: ignore[arg-type] # tests name the fields


def times(events: list[UtteranceChanged], **more: object) -> list[tuple[object, ...]]:
    return [
        (one.utterance_id, one.requested_ns, one.start_ns, one.end_ns, one.state)
        for one in spoken_utterances(events, **{"ended_ns": 1000, **more})  # type: ignore[arg-type] # as above
    ]


def test_an_utterance_has_the_exact_times_at_which_it_began_and_ended() -> None:
    events = [
        said(10, "a", "requested", voice="robot"),
        said(12, "b", "requested"),
        said(20, "a", "started"),
        said(50, "a", "finished"),
        said(51, "b", "started"),
        said(70, "b", "interrupted", detail="silenced"),
    ]
    assert times(events) == [("a", 10, 20, 50, "finished"), ("b", 12, 51, 70, "interrupted")]
    first, second = spoken_utterances(events, ended_ns=1000)
    assert (first.voice, first.text, first.said) == ("robot", "text of a", True)
    assert second.detail == "silenced"


def test_unreported_times_are_marked_as_estimated() -> None:
    events = [
        said(10, "a", "requested"),
        said(20, "a", "started", estimated=True),
        said(50, "a", "finished"),
        said(60, "b", "started"),
        said(70, "b", "finished"),
    ]
    assert [one.estimated for one in spoken_utterances(events, ended_ns=1000)] == [True, False]


def test_an_unspoken_utterance_has_no_times() -> None:
    events = [
        said(10, "dropped", "requested"),
        said(11, "failed", "requested"),
        said(12, "waiting", "requested"),
        said(15, "failed", "failed"),
        said(20, "dropped", "interrupted"),
    ]
    assert times(events) == [
        ("dropped", 10, None, None, "interrupted"),
        ("failed", 11, None, None, "failed"),
        ("waiting", 12, None, None, "requested"),
    ]
    assert not any(one.said for one in spoken_utterances(events, ended_ns=1000))


def test_an_end_that_was_not_recorded_is_when_the_record_breaks_off_or_the_speaker_continues() -> None:
    last = [said(10, "a", "started")]
    assert times(last) == [("a", None, 10, 1000, "started")]
    assert times(last, paused_ns=[5, 400]) == [("a", None, 10, 400, "started")]
    assert times([*last, said(90, "b", "started")], paused_ns=[400])[0] == ("a", None, 10, 90, "started")
    utterance = said(90, "b", "started", speaker="participant")
    assert times([*last, utterance])[0] == ("a", None, 10, 1000, "started")


def test_an_utterance_may_arrive_in_one_piece() -> None:
    utterance = said(30, "h", "finished", speaker="participant", origin="heard")
    assert times([utterance]) == [("h", None, 30, 30, "finished")]


def test_a_transcribed_turn_without_a_recorded_verdict_was_not_spoken() -> None:
    begun = replace(said(900, "echo", "started", speaker="participant", origin="heard"), text="")
    before = said(100, "p", "started", speaker="participant", origin="heard", text="")
    spoken_before = [before, replace(before, stamp_ns=200, state="finished", text="Where is the lab?")]
    lost_inside = replace(begun, stamp_ns=300, utterance_id="lost")
    told = [*spoken_before, lost_inside, begun]
    assert [one.utterance_id for one in spoken_utterances(told, ended_ns=1000) if one.said] == ["p"]
    # A listener transcribed it.
    corrected = UtteranceCorrected(950, "lost", text="Hello.")
    assert [one.utterance_id for one in spoken_utterances([*told, corrected], ended_ns=1000) if one.said] == [
        "p",
        "lost",
    ]
    # An unfinished utterance of a robot or a wizard counts as spoken.
    own = said(950, "own", "started", speaker="wizard", origin="own_voice", text="")
    assert [one.utterance_id for one in spoken_utterances([own], ended_ns=1000) if one.said] == ["own"]


def test_the_newest_of_a_mark_counts_and_withdrawn_ones_are_gone() -> None:
    marks = final_marks_of(
        [
            Marked(10, "laughs", mark_id="m1"),
            Marked(20, "slip", "wizard_error", mark_id="m2"),
            Marked(30, "laughs", mark_id="m1", start_ns=7, note="both"),
            Marked(31, "slip", "wizard_error", mark_id="m2", state="withdrawn"),
            Marked(40, "talks", mark_id="m3", state="open"),
            Marked(45, "talks a lot", mark_id="m3", state="open"),
            Marked(60, "talks a lot", mark_id="m3", start_ns=40, end_ns=60),
            Marked(70, "waits", mark_id="m4", start_ns=65, state="open"),
            Marked(80, "looks", mark_id="m5", state="open"),
            Marked(85, "looks", mark_id="m5"),
        ],
        ended_ns=100,
    )
    assert marks == (
        FinalMark("m1", "laughs", "mark", 7, None, "both", 10),
        FinalMark("m3", "talks a lot", "mark", 40, 60, "", 40),
        FinalMark("m4", "waits", "mark", 65, 100, "", 70, open_at_end=True),
        FinalMark("m5", "looks", "mark", 80, 85, "", 80),
    )


def test_both_are_read_from_a_session(tmp_path: Path) -> None:
    now_ns = clock.now_ns()
    record(
        tmp_path / "s",
        [
            said(now_ns + 1, "a", "started"),
            Marked(now_ns + 2, "old"),
            Marked(now_ns + 3, "old"),
            RecordingPaused(now_ns + 5, paused=True),
            RecordingPaused(now_ns + 9, paused=False),
        ],
    )
    session = open_session(tmp_path / "s")
    assert [(one.text, one.end_ns) for one in spoken(session)] == [("text of a", now_ns + 5)]
    assert [(mark.mark_id, mark.start_ns) for mark in read_data(session, (Marked,)).marks] == [
        ("mark-1", now_ns + 2),
        ("mark-2", now_ns + 3),
    ]
